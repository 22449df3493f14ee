"""LLVM text to machine code: compiled at once, stored as an object file, loaded by digest.

Files that save a compilation are the user's own, written complete or not at all, and trusted only by a keyed digest.
What is read here is executed. A folder or file that anybody else owns or may write to is therefore never used, no
matter which variable named it. This is checked on the descriptors that are read, so that nothing can be exchanged
between check and use. Every file begins with the HMAC-SHA256 (RFC 2104) of its name and content under a secret of the
user, which lies beside the default folder and never in a folder that `$XDYNAMICS_CACHE` names: a file that somebody
else prepared is rejected even if the folder was once open.
"""

from __future__ import annotations

import ctypes
import hashlib
import hmac
import logging
import math
import os
import secrets
import shutil
import stat
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numpy as np
from numpy.typing import NDArray

from xdynamics.faults import escaped
from xdynamics.kernels.shared_storage import LACKING, note_refusal
from xdynamics.runtime.files import megabytes

ENVIRONMENT, LIMIT = "XDYNAMICS_CACHE", "XDYNAMICS_CACHE_LIMIT"
MOST_MEGABYTES = 256.0  # of all that is kept, unless $XDYNAMICS_CACHE_LIMIT is set
MOST_DAYS = 180.0  # since a file was last read or written
LOOKS = 32  # times the folder is looked through while as much is written as may be kept
ROOM = 8_000_000  # free bytes that keeping an engine requires
LARGEST = 500_000_000  # bytes; larger files are not read
ABANDONED = 3600.0  # seconds after which an unfinished part counts as abandoned
FRESH = 3600.0  # seconds for which a file that was read is not marked as used again
_FORMAT = "keyed digest in front"
_PART = ".part"
_SEAL = hashlib.sha256().digest_size
_OTHERS = stat.S_IWGRP | stat.S_IWOTH
_ADVISED: list[str] = []
# opening a pipe in place of a file would wait for its writer forever; a link may lead anywhere
_FLAGS = sum(getattr(os, name, 0) for name in ("O_NONBLOCK", "O_NOFOLLOW", "O_CLOEXEC", "O_BINARY"))
_POSIX = os.name == "posix"


def folder() -> Path:
    """Return the folder of compiled code: $XDYNAMICS_CACHE, or `xdynamics` in the user's cache folder."""
    if configured := os.environ.get(ENVIRONMENT):
        return _from_here(configured)
    return _default_folder()


def _default_folder() -> Path:
    if cache_home := os.environ.get("XDG_CACHE_HOME"):
        return _from_here(cache_home) / "xdynamics"
    try:
        return _from_here(str(Path.home())) / ".cache" / "xdynamics"
    except RuntimeError:  # a user without a home folder
        return Path(tempfile.gettempdir()) / f"xdynamics-{_user()}"


@lru_cache
def _from_here(path_text: str) -> Path:
    """Make a path absolute as of its first use, wherever the process changes its folder to later."""
    return Path(path_text).absolute()


def text_digest(*parts: str) -> str:
    """Return the SHA-256 digest of texts, separated by null characters."""
    return hashlib.sha256("\0".join([_FORMAT, *parts]).encode()).hexdigest()


def read(name: str) -> bytes | None:
    """Return the content of a file; None if it is missing, not the user's own, or fails its keyed digest.

    The bytes that were compared with the digest are the bytes returned: the file is read once.
    """
    try:
        with _open_folder(folder()) as directory:
            sealed = _read_content(directory, name)
    except OSError:
        return None
    if sealed is None:
        return None
    seal, content = sealed[:_SEAL], sealed[_SEAL:]
    try:
        return content if hmac.compare_digest(seal, _seal(name, content, create=False)) else None
    except OSError:
        return None


def write(name: str, content: bytes) -> None:
    """Keep a file with its digest in front; if that fails, warn once and go on."""
    try:
        sealed = _seal(name, content, create=True) + content
        with _open_folder(folder(), create=True) as directory:
            part = f"{name[:20]}-{secrets.token_hex(8)}{_PART}"
            try:
                with os.fdopen(
                    os.open(part, _FLAGS | os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600, **_dir_fd_argument(directory)),
                    "wb",
                ) as file:
                    file.write(sealed)
                _replace_file(directory, part, name)
            except BaseException:
                with suppress(OSError):
                    os.unlink(part, **_dir_fd_argument(directory))
                raise
            if _looks_through(len(sealed)):
                _prune(directory, name)
    except OSError as error:
        advise(_error_reason(error))


def caching_obstacle() -> str:
    """Return why no engine could be stored, before time is spent on compiling one; empty if it could."""
    try:
        _secret(create=True)
        with _open_folder(folder(), create=True), tempfile.NamedTemporaryFile(dir=folder(), suffix=_PART) as probe:
            # a full disk still takes an empty file: only bytes tell
            probe.write(bytes(ROOM))
            probe.flush()
    except OSError as error:
        return _error_reason(error)
    return ""


def advise(reason: str) -> None:
    """Warn once per process that nothing can be stored, with the remedy."""
    if _ADVISED:
        return
    _ADVISED.append(reason)
    logging.getLogger("xdynamics").warning(
        "xdynamics: compiled code cannot be kept in '%s' (%s), so every process compiles it again; set %s to a folder"
        " of your own that nobody else can write to and that has room",
        escaped(str(folder())),
        reason,
        ENVIRONMENT,
    )


def _error_reason(error: OSError) -> str:
    return error.strerror or str(error)


@contextmanager
def _open_folder(path: Path, *, create: bool = False) -> Iterator[int]:
    """Hold a folder open that belongs to the user and that nobody else can write to.

    Raises
    ------
    OSError
        If there is none, or it is somebody else's.
    """
    if create:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
    if not _POSIX:
        yield -1
        return
    flags = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC
    # in the shared temporary folder a link may be anybody's; elsewhere a user's own link to a larger disk is intended
    descriptor = os.open(path, flags | (os.O_NOFOLLOW if path.parent == Path(tempfile.gettempdir()) else 0))
    try:
        _check_ownership(os.fstat(descriptor), "folder")
        yield descriptor
    finally:
        os.close(descriptor)


def _check_ownership(status: os.stat_result, file_kind: str) -> None:
    if _POSIX and status.st_uid != _user():
        raise PermissionError(1, f"the {file_kind} belongs to user {status.st_uid}, not to user {_user()}")
    if _POSIX and status.st_mode & _OTHERS:
        raise PermissionError(1, f"others may write to the {file_kind}: take that from them by `chmod go-w`")


def _dir_fd_argument(directory: int) -> dict[str, int]:
    return {"dir_fd": directory} if _POSIX else {}


def _read_content(directory: int, name: str) -> bytes | None:
    """Return all bytes of a regular file of the user's own; renew its time of use, by which files are pruned."""
    with os.fdopen(
        os.open(name if _POSIX else folder() / name, _FLAGS | os.O_RDONLY, **_dir_fd_argument(directory)), "rb"
    ) as file:
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode) or status.st_size > LARGEST:
            return None
        _check_ownership(status, "file")
        content = file.read()
        if _POSIX and time.time() - status.st_mtime > FRESH:
            with suppress(OSError):
                os.utime(file.fileno())
    return content


def _replace_file(directory: int, part: str, name: str) -> None:
    """Rename a finished part to its file."""
    if not _POSIX:
        (folder() / part).replace(folder() / name)
        return
    with suppress(FileNotFoundError):
        if stat.S_ISDIR(os.stat(name, dir_fd=directory, follow_symlinks=False).st_mode):
            shutil.rmtree(name, dir_fd=directory)  # os.replace does not put a file over a folder
    # no fsync before: what a crash leaves torn fails its digest and is compiled again
    os.replace(part, name, src_dir_fd=directory, dst_dir_fd=directory)


def _seal(name: str, content: bytes, *, create: bool) -> bytes:
    return hmac.digest(_secret(create=create), name.encode() + b"\0" + content, "sha256")


def _secret(*, create: bool) -> bytes:
    """Return the user's secret, from a file of mode 600 beside the default folder.

    Raises
    ------
    OSError
        If there is none, or others may read or write it.
    """
    path = _default_folder().with_name(f"{_default_folder().name}.secret")
    try:
        handle = os.open(path, _FLAGS | os.O_RDONLY)
    except FileNotFoundError:
        if not create:
            raise
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        _found_secret(path)
        handle = os.open(path, _FLAGS | os.O_RDONLY)
    with os.fdopen(handle, "rb") as file:
        status = os.fstat(file.fileno())
        _check_ownership(status, f"secret '{path}'")
        if not stat.S_ISREG(status.st_mode) or (_POSIX and status.st_mode & 0o077):
            raise PermissionError(1, f"others may read '{path}': remove it, and a new secret is made")
        secret = file.read()
    if len(secret) != _SEAL:
        raise OSError(22, f"'{path}' holds no secret: remove it, and a new one is made")
    return secret


def _found_secret(path: Path) -> None:
    """Create a secret; of several processes at once, the first one's secret stays."""
    handle, part = tempfile.mkstemp(dir=path.parent, prefix=f"{path.name}-", suffix=_PART)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(secrets.token_bytes(_SEAL))
        try:
            # a link fails where a file stands already; a rename would replace another process's secret
            os.link(part, path, follow_symlinks=False)
        except FileExistsError:
            pass
        except OSError:  # a file system without links: the last one's stays
            Path(part).replace(path)
    finally:
        Path(part).unlink(missing_ok=True)


def _user() -> int:
    return os.geteuid() if hasattr(os, "geteuid") else 0


def _looks_through(size: int) -> bool:
    """Whether a file of this size is one after which the folder is pruned: by chance, `LOOKS` times while a full one is written.

    To look through ten thousand files takes longer than to compile a law. Chance needs no memory that processes share,
    and it is not Python's own generator, whose seed is the user's.
    """
    limit = int(1e6 * max_megabytes())
    return LOOKS * size >= limit or secrets.randbelow(limit) < LOOKS * size


def _prune(directory: int, written_name: str) -> None:
    """Remove old files, the least recently used beyond the limit, and parts of processes that died while writing."""
    now, kept_files, limit = time.time(), [], 1e6 * max_megabytes()
    # all entries before any is removed: what a scan yields of a folder that changes is left open by POSIX
    with os.scandir(directory if _POSIX else folder()) as scan:
        entries = list(scan)
    for entry in entries:
        try:
            status = entry.stat(follow_symlinks=False)
        except FileNotFoundError:  # another process has removed it since
            continue
        age = now - status.st_mtime
        if entry.name.endswith(_PART) and age > ABANDONED:
            _remove_entry(directory, entry)
        elif stat.S_ISREG(status.st_mode) and entry.name != written_name and not entry.name.endswith(_PART):
            kept_files.append((age, status.st_size, entry))
    total = 0
    for age, size, entry in sorted(kept_files, key=lambda row: (row[0], row[2].name)):
        total += size
        if total > limit or age > 86400.0 * MOST_DAYS:
            _remove_entry(directory, entry)


def _remove_entry(directory: int, entry: os.DirEntry[str]) -> None:
    with suppress(OSError):
        if entry.is_dir(follow_symlinks=False):
            shutil.rmtree(entry.name if _POSIX else entry.path, dir_fd=directory if _POSIX else None)
        else:
            os.unlink(entry.name if _POSIX else entry.path, **_dir_fd_argument(directory))


def max_megabytes() -> float:
    """Return the limit of the cache, MB: $XDYNAMICS_CACHE_LIMIT, or the default if that is not a valid number."""
    return megabytes(LIMIT, MOST_MEGABYTES)


# what the engine's texts call of the C library: functions whose results are exact, so that all libraries have one
HELPERS = {f"numba_{name}": name for name in ("nextafter", "frexp", "ldexp")}

AS_WRITTEN = "; loops as they are written"  # first line of a text whose loops LLVM is not to unroll
LINE = 8  # floats of a line of the cache
PATIENCE = 1.0  # seconds of compiling before a warning
# Lines of a text beyond which instructions are not scheduled: LLVM's time for one long block grows with its square,
# to 11 s for the forces of 3,000 masses. Steps of sums are then a tenth slower, those of elementary functions twice
# as slow. No bit changes.
LONG_TEXT = 12_000


def provide_helpers() -> None:
    """Make functions of the C library known to LLVM, by the names that numba's texts have for them."""
    library = ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None)
    for symbol, name in HELPERS.items():
        llvm.add_symbol(symbol, ctypes.cast(getattr(library, name), ctypes.c_void_p).value)


@lru_cache
def provide_refusal() -> None:
    """Register with LLVM the function that a program calls without memory."""
    llvm.add_symbol(LACKING, ctypes.cast(note_refusal, ctypes.c_void_p).value)


def address_of(array: Any) -> int:
    """Return where the first element of an array in C order is; 0 of one without elements, where nothing is read.

    A sixth of the time of ``array.ctypes.data``, which counts where a run of microseconds has a hundred arrays.
    """
    if not array.size:
        return 0
    try:
        return ctypes.addressof(ctypes.c_char.from_buffer(array))
    except (TypeError, ValueError, BufferError):  # only to be read, or a view in another order
        return int(array.ctypes.data)


def aligned_zeros(numbers: int) -> NDArray[np.float64]:
    """Return zeros that begin with a line of the cache: wide vectors that cross two of them take a third longer."""
    room = np.zeros(numbers + LINE)
    first = -address_of(room) // 8 % LINE
    return room[first : first + numbers]


class Code:
    """Machine code in memory, and the addresses of its functions.

    Parameters
    ----------
    content : bytes
        An object file.
    names : iterable of str
    """

    def __init__(self, content: bytes, names: Iterable[str]) -> None:
        provide_refusal()
        module = llvm.parse_assembly("")
        module.triple = llvm.get_process_triple()
        # kept as long as the addresses: an engine that is collected frees its code
        self._engine = llvm.create_mcjit_compiler(module, _target_machine())
        self._engine.add_object_file(llvm.ObjectFileRef.from_data(content))
        self._engine.finalize_object()
        self.addresses = {name: int(self._engine.get_function_address(name)) for name in names}


def compiled(text: str, names: Iterable[str], functions: Mapping[str, Callable[..., float]] | None = None) -> Code:
    """Compile LLVM text, or return its cached machine code.

    Parameters
    ----------
    text : str
    names : iterable of str
        The functions that are called from outside.
    functions : mapping of str to callable, optional
        Functions of floats that the text calls by these names, compiled by numba; nothing is kept of such a text.
    """
    if functions:
        symbols = _symbols(text, functions)
        return Code(_object(symbols), names)
    key = text_digest(text, *processor())
    content = read(f"law-{key}.o")
    if content is None:
        content = build_object(text)
        write(f"law-{key}.o", content)
    return Code(content, names)


def build_object(text: str) -> bytes:
    """Compile LLVM text to an object file; warn if that takes long."""
    with _warn_if_slow(text):
        return _object(text)


@contextmanager
def _warn_if_slow(text: str) -> Iterator[None]:
    """Warn if compiling takes longer than `PATIENCE`."""
    lines = text.count("\n")
    message = "xdynamics: compiling the model and its method, %d lines"
    timer = threading.Timer(PATIENCE, logging.getLogger("xdynamics").warning, (message, lines))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def _symbols(text: str, functions: Mapping[str, Callable[..., float]]) -> str:
    """Name the functions by their addresses in this process, which no later text can mean by accident."""
    for name, function in functions.items():
        address = ctypes.cast(_python_entry(function), ctypes.c_void_p).value
        symbol = f"xdynamics_function_{address:x}"
        llvm.add_symbol(symbol, address)
        text = text.replace(f"@{name}(", f"@{symbol}(")
    return text


def _python_entry(function: Any) -> Any:
    """Compile a Python function to one that takes and returns doubles; it lives as long as the process."""
    from numba import cfunc, njit, types

    from xdynamics.kernels.compiling import OPTIONS

    if function not in _KEPT:
        inner = function if hasattr(function, "py_func") else njit(**OPTIONS)(function)
        count = inner.py_func.__code__.co_argcount
        arguments = ", ".join(f"_{i}" for i in range(count))
        scope: dict[str, Any] = {"inner": inner, "nan": math.nan}
        # cfunc takes no *arguments: the text depends on their number alone. Machine code would go on with zero after an
        # exception; nan ends the run, and the search for its cause calls the function again and raises
        lines = (
            f"def called({arguments}):\n try:\n  return float(inner({arguments}))\n except Exception:\n  return nan\n"
        )
        exec(lines, scope)  # noqa: S102
        signature = types.float64(*[types.float64] * count)
        _KEPT[function] = cfunc(signature, error_model=OPTIONS["error_model"])(scope["called"])
    return _KEPT[function].ctypes


_KEPT: dict[Any, Any] = {}


def _object(text: str) -> bytes:
    module = _parse_module(text)
    module.triple = llvm.get_process_triple()
    # a machine of its own, as for every engine: an engine frees the one that it was given
    machine = _target_machine(0 if text.count("\n") > LONG_TEXT else 2)
    optimise(module, machine, 2, unrolling=not text.startswith(AS_WRITTEN))
    return bytes(machine.emit_object(module))


def emit_object(text: str) -> bytes:
    """Return the object file of a text that is optimised already, but for this processor."""
    return bytes(_target_machine().emit_object(_parse_module(text)))


def _parse_module(text: str) -> Any:
    # a context of its own, with which constants and types are freed: that of the process would grow by 0.1 MB a text
    module = llvm.parse_assembly(text, llvm.create_context())
    module.verify()
    return module


def optimise(module: Any, machine: Any, level: int, *, unrolling: bool = True) -> None:
    """Run LLVM's passes over a module; none changes the order of IEEE operations."""
    options = llvm.create_pipeline_tuning_options(speed_level=level)
    options.loop_unrolling = options.loop_vectorization = unrolling
    builder = llvm.create_pass_builder(machine, options)
    passes = builder.getModulePassManager()
    passes.run(module, builder)
    # left to itself it is never freed, 0.1 MB a text: llvmlite's class inherits an empty `_dispose` before its own
    llvm.newpassmanagers.NewPassManager._dispose(passes)  # noqa: SLF001
    passes.detach()


@lru_cache
def processor() -> tuple[str, str, str]:
    """Return the target that determines machine code besides its text: LLVM's version, processor and features."""
    version = ".".join(map(str, llvm.llvm_version_info))
    return version, llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()


@lru_cache
def fuses() -> bool:
    """Whether this processor has the fused multiply-add as an instruction."""
    if not llvm.get_process_triple().startswith(("x86_64", "i386", "i686")):
        return llvm.get_process_triple().startswith(("aarch64", "arm64"))
    return "+fma" in processor()[2].split(",")


@lru_cache
def vector_lanes() -> int:
    """Return how many runs go side by side on this processor: two of its widest vectors."""
    features = llvm.get_host_cpu_features()
    return 16 if features.get("avx512f") else 8 if features.get("avx") else 4


def plain_machine() -> Any:
    """Return a machine that every processor of the platform can do the work of."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm.Target.from_default_triple().create_target_machine(opt=2, jit=True)


def _target_machine(level: int = 2) -> Any:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    _, name, features = processor()
    # no contraction: LLVM fuses a product and a sum only where a text asks for it, and none does
    return llvm.Target.from_default_triple().create_target_machine(cpu=name, features=features, opt=level, jit=True)

"""LLVM text to machine code: compiled at once, kept as an object file, loaded by digest."""

from __future__ import annotations

import ctypes
import logging
import math
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

import llvmlite.binding as llvm
import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels import cache
from xdynamics.kernels.heap_arrays import LACKING, note_refusal

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
    """Make known to LLVM what a program calls that was given no memory."""
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
        self._engine = llvm.create_mcjit_compiler(module, _target_machine())
        self._engine.add_object_file(llvm.ObjectFileRef.from_data(content))
        self._engine.finalize_object()
        self.addresses = {name: int(self._engine.get_function_address(name)) for name in names}


def compiled(text: str, names: Iterable[str], functions: Mapping[str, Callable[..., float]] | None = None) -> Code:
    """Compile LLVM text, or return the machine code that was kept of it.

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
    key = cache.text_digest(text, *processor())
    content = cache.read(f"law-{key}.o")
    if content is None:
        content = build_object(text)
        cache.write(f"law-{key}.o", content)
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
    """Return what machine code depends on besides its text: LLVM's version, the processor and its features."""
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

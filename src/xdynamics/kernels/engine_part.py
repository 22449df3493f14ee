"""A part of the engine: compiled functions, from the text of the wheel, or by numba, once per installation.

A wheel carries the LLVM text of every part (`xdynamics.packaging` writes it), so that a first run makes machine code alone.
In a checkout, or with other versions of numba or LLVM, numba compiles the text, and it is kept in the user's cache. So
is the machine code of either.
"""

from __future__ import annotations

import logging
import lzma
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
from llvmlite.binding import ffi

from xdynamics.kernels import machine
from xdynamics.kernels.entry_points import Entry, Signature
from xdynamics.runtime.fork_safety import waited_for

PACKAGE = Path(__file__).parents[1]
FOLDER = PACKAGE / "kernels" / "text"  # of a wheel's texts
WHEEL, NUMBA = "of the wheel", "compiled by numba"  # where a text is from
# reentrant, as making a part may need another one
_LOCK = waited_for(threading.RLock())
_MAKERS: list[int] = []  # threads that make a part: the one that holds the lock, once for each part
waited_for(getattr(ffi.lib._lock, "_lock"))  # noqa: B009, SLF001 - LLVM's own, which a child needs to compile


class EnginePart:
    """Functions that are compiled together, when the first of them is needed.

    Parameters
    ----------
    name : str
        Of its files.
    words : str
        What is compiled, for a message.
    seconds : int
        That numba takes for it on a machine of 2026.
    functions : sequence of (function, Signature)
    """

    def __init__(self, name: str, words: str, seconds: int, functions: Sequence[tuple[Any, Signature]]) -> None:
        self.name, self.functions = name, functions
        self.file_name = f"{name}.ll.xz"  # of a wheel's text
        self.seconds, self._words = seconds, words
        self._entries: tuple[Entry, ...] = ()

    def entries(self) -> tuple[Entry, ...]:
        """Return the functions as machine code, in their order; the first call loads or makes it."""
        with _LOCK:
            if not self._entries:
                with _making():
                    self._entries = self._load_entries()
            return self._entries

    def _load_entries(self) -> tuple[Entry, ...]:
        text, reason = self._wheel_text()
        name = self.name_of_code(_text_origin(text))
        content = machine.read(name)
        if content is None:
            content = machine.emit_object(text or self._kept_text(reason))
            machine.write(name, content)
        machine.provide_helpers()
        code = machine.Code(content, [function.__name__ for function, _ in self.functions])
        return tuple(Entry(code, function.__name__, signature) for function, signature in self.functions)

    def origin(self) -> str:
        """Return where the text is from: `WHEEL` or `NUMBA`."""
        return _text_origin(self._wheel_text()[0])

    def name_of_code(self, origin: str) -> str:
        """Return the name of the cache's file of machine code."""
        return (
            f"{self.name}-{machine.text_digest(toolchain_versions(), source_digest(), origin, *machine.processor())}.o"
        )

    @property
    def name_of_text(self) -> str:
        """The name of the cache's file of a text that numba compiled."""
        return f"{self.name}-{machine.text_digest(toolchain_versions(), source_digest())}.ll.xz"

    def packed_text(self) -> bytes:
        """Return the text as a wheel carries it."""
        with _LOCK:
            return lzma.compress(self._kept_text("").encode())

    def _wheel_text(self) -> tuple[str, str]:
        """Return the wheel's text; if there is none that fits, an empty text and the reason, if there is one to tell."""
        path = FOLDER / self.file_name
        if not path.exists():
            return "", ""
        try:
            text = lzma.decompress(path.read_bytes()).decode()
        except (OSError, EOFError, lzma.LZMAError, UnicodeDecodeError) as error:
            return "", f": the installed text cannot be read ({error})"
        text_toolchain, text_sources, *_ = (line.removeprefix("; ") for line in f"{text}\n\n".split("\n", 2))
        if text_toolchain != toolchain_versions():
            return "", f": the installed text is by {text_toolchain}, and here is {toolchain_versions()}"
        if text_sources != source_digest():
            return "", ": the installed text is of other sources"
        return text, ""

    def _kept_text(self, reason: str) -> str:
        """Return the text that the cache holds, or compile it."""
        content = machine.read(self.name_of_text)
        if content is not None:
            return lzma.decompress(content).decode()
        obstacle = machine.caching_obstacle()
        often = "" if obstacle else ", once per installation"
        message = "xdynamics: compiling %s%s: about %d s%s"
        logging.getLogger("xdynamics").warning(message, self._words, often, self.seconds, reason)
        if obstacle:
            machine.advise(obstacle)
        # imports numba, which takes most of a second that only a process without kept code has to pay
        from xdynamics.kernels.numba_text import text_of

        text = f"; {toolchain_versions()}\n; {source_digest()}\n{text_of(self.functions)}"
        if not obstacle:
            machine.write(self.name_of_text, lzma.compress(text.encode()))
        return text


@contextmanager
def _making() -> Iterator[None]:
    """Mark this thread as making a part, inside of which another may be made."""
    _MAKERS.append(threading.get_ident())
    try:
        yield
    finally:
        _MAKERS.pop()


def is_being_made() -> bool:
    """Whether this thread is making a part of the engine, which numba may take a minute for."""
    return threading.get_ident() in _MAKERS


def _text_origin(carried: str) -> str:
    return WHEEL if carried else NUMBA


@lru_cache(maxsize=1)
def toolchain_versions() -> str:
    """Return the toolchain that determines a text besides its sources: versions of numba and LLVM, and platform."""
    version = ".".join(map(str, llvm.llvm_version_info))
    return f"numba {metadata.version('numba')}, LLVM {version}, {llvm.get_process_triple()}"


@lru_cache(maxsize=1)
def source_digest() -> str:
    """Return a digest of everything that is compiled into a part: modules, constants of methods, the schema's flags."""
    rooms = [path for room in ("elementary", "kernels", "march") for path in (PACKAGE / room).rglob("*.py")]
    constants = [
        PACKAGE / "dynamics" / "growth.py",
        PACKAGE / "methods" / "implicit.py",
        *(PACKAGE / "model" / f"{name}.py" for name in ("parts", "detectors", "reactions")),
    ]
    # sorted, as the order of rglob is that of the file system
    files = sorted([*rooms, PACKAGE / "schema.py", *constants])
    return machine.text_digest(*(path.read_text(encoding="utf-8") for path in files))

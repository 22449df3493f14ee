"""Standard streams that may be closed, full or cut off while a command works, without harm to its results."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, NamedTuple, TextIO

CLOSED = "it is closed"


class Stream:
    """A stream that never fails: after the first error nothing more is written, and the reason is kept.

    Parameters
    ----------
    stream : file of text, or None
        None where the process began without it.
    """

    def __init__(self, stream: TextIO | None) -> None:
        self._stream: TextIO = open(os.devnull, "w") if stream is None else stream  # noqa: PTH123, SIM115 - it lasts as long as the process
        self._closed = stream is None
        self.lost: str = ""
        self.cut_off = False  # by a reader that has seen enough, as in ``| head -1``

    def write(self, text: str) -> int:
        """Write a text, if possible."""
        if self._closed and text:
            self.lost = CLOSED
        if not self.lost:
            with self._failing():
                self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Flush what was written."""
        if not self.lost:
            with self._failing():
                self._stream.flush()

    def isatty(self) -> bool:
        """Whether it is a terminal."""
        return not self._closed and not self.lost and self._stream.isatty()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    @contextmanager
    def _failing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self.lost, self.cut_off = error.strerror or str(error), isinstance(error, BrokenPipeError)
            # what is still in the buffer would fail again when Python ends, with a traceback
            with suppress(OSError, ValueError):
                nowhere = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nowhere, self._stream.fileno())
                os.close(nowhere)


class Streams(NamedTuple):
    """Standard output and error of a command."""

    output: Stream
    error: Stream


@contextmanager
def surviving_streams() -> Iterator[Streams]:
    """Put streams that never fail in the place of standard output and error."""
    _reserve_descriptors()
    output, error = sys.stdout, sys.stderr
    streams = Streams(Stream(output), Stream(error))
    sys.stdout, sys.stderr = streams
    try:
        yield streams
    finally:
        for stream in streams:
            stream.flush()
        sys.stdout, sys.stderr = output, error


def _reserve_descriptors() -> None:
    """Point closed descriptors among 0 to 2 at the null device: otherwise an archive gets one, and messages go into it."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest that is free

"""Ctrl-C while a run is marched: the first ends it with what is recorded, the second raises."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from xdynamics.kernels.engine_part import is_being_made


@contextmanager
def ending_at_interrupt(end: Callable[[], None]) -> Iterator[None]:
    """Let the first Ctrl-C end the run as an outcome; a second one raises, and one while the engine is being made."""
    if not _is_main_thread():
        yield
        return

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        signal.signal(signal.SIGINT, previous)
        if is_being_made():  # by numba for a minute or longer, of which nothing is lost
            raise KeyboardInterrupt
        end()

    previous = signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    finally:  # of blocks that nobody closed, any thread that collects garbage comes here
        if _is_main_thread() and signal.getsignal(signal.SIGINT) is interrupt:
            signal.signal(signal.SIGINT, previous)


def _is_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()

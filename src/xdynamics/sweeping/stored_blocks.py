"""The blocks of a sweep that is marched into a store: cut once, by one process at a time, counted while they come."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress

from xdynamics.archive.place import Place
from xdynamics.archive.store import LockedError
from xdynamics.archive.stores import store_of, taking_name
from xdynamics.faults import InputError
from xdynamics.sweeping.members import Block, Plan
from xdynamics.sweeping.tasks import Chunks, measured_chunks

CUT = "blocks.json"  # sizes of the blocks along each axis
MAX_CUT_BYTES = 100_000_000  # bytes of it
Progress = Callable[[float, float, int], None]


@contextmanager
def lock_folder(work: Place, folder: Place) -> Iterator[None]:
    """Lock what is written while this process marches into a folder against other processes.

    Raises
    ------
    InputError
        If another process has it locked.
    """
    with ExitStack() as stack:
        try:
            stack.enter_context(store_of(work).locked(work))
        except LockedError as error:
            raise InputError(
                f"another process marches into '{folder}'; wait for it, or name another folder ({error})"
            ) from None
        yield


def saved_or_new_chunks(plan: Plan, members: int | None, work: Place) -> Chunks:
    """Return the chunks that a sweep was begun with, or choose and save them."""
    file = work / CUT
    with suppress(OSError, ValueError, TypeError, OverflowError, RecursionError):  # no such file, or a damaged one
        content = json.loads(store_of(file).content(file, MAX_CUT_BYTES))
        saved = tuple(tuple(map(int, widths)) for widths in content)
        if tuple(map(sum, saved)) == plan.grid.shape and all(width > 0 for widths in saved for width in widths):
            return saved
    chunks = measured_chunks(plan, members)
    with taking_name(file) as new:
        new.part.write_text(json.dumps(chunks))
    return chunks


def block_name(block: Block) -> str:
    """Name a block by the members along each axis."""
    return "_".join(f"{extent.start}-{extent.stop}" for extent in block)


class watch_blocks:  # noqa: N801 - used as a statement
    """Report how many blocks are done by counting their files, whichever process writes them."""

    def __init__(self, parts: list[Place], progress: Progress | None) -> None:
        import threading

        self.parts, self.progress, self.stopped = parts, progress, threading.Event()
        self.thread = threading.Thread(target=self._tell, daemon=True) if progress else None

    def __enter__(self) -> None:
        if self.thread:
            self.thread.start()

    def __exit__(self, *_: object) -> None:
        self.stopped.set()
        if self.thread:
            self.thread.join()

    def _tell(self) -> None:
        while not self.stopped.wait(1.0):
            present_names = {entry.name for entry in store_of(self.parts[0]).names(self.parts[0].parent)}
            finished_count = sum(part.name in present_names for part in self.parts)
            if self.progress:
                self.progress(finished_count / len(self.parts), 0.0, finished_count)

"""Files that the library may still have open: it takes one that was overwritten in place for the old one.

HDF5 knows a file by its inode. If another archive is copied over one that this process has open, or that the library
could not close because it is damaged, the old file's structure is read with the new one's bytes.
"""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from weakref import WeakSet

from xdynamics.faults import ArchiveError

Inode = tuple[int, int]
State = tuple[int, int]  # size, time of the last change


@dataclass(frozen=True)
class Opening:
    """One file of the disk, as it was when it was opened for reading."""

    state: State
    files: WeakSet[Any] = field(default_factory=WeakSet)


class Openings:
    """Files that were opened and not closed properly, by inode; used under the lock of the library."""

    def __init__(self) -> None:
        self._by_inode: dict[Inode, Opening] = {}

    def opening_of(self, path: Path) -> Opening:
        """Return the opening of a file that is about to be opened; close those from before it was overwritten.

        Raises
        ------
        ArchiveError
            If the library keeps the old one open nevertheless.
        """
        status = path.stat()
        inode, state = (status.st_dev, status.st_ino), (status.st_size, status.st_mtime_ns)
        earlier_opening = self._by_inode.get(inode)
        if earlier_opening and earlier_opening.state != state:
            for file in list(earlier_opening.files):
                with suppress(RuntimeError):
                    file.close()
            if _is_held(inode):
                self._by_inode[inode] = earlier_opening  # `closed` forgot it: whoever tries again is refused again
                raise ArchiveError(
                    f"'{path}' was overwritten while this process had it open, and the netCDF library would mix what it"
                    " was with what it is: copy it to another name, or read it in a new process"
                )
            self._by_inode.pop(inode, None)
        return self._by_inode.setdefault(inode, Opening(state))

    def closed(self, file: Any) -> None:
        """Forget a file that was closed properly."""
        for inode, opening in list(self._by_inode.items()):
            if file in opening.files:
                opening.files.discard(file)
                if not opening.files:
                    del self._by_inode[inode]


openings = Openings()


def _is_held(inode: Inode) -> bool:
    """Whether this process has a file open; False if the system does not say."""
    with suppress(OSError):
        for descriptor in Path("/dev/fd").iterdir():
            with suppress(OSError):
                status = os.fstat(int(descriptor.name))
                if (status.st_dev, status.st_ino) == inode:
                    return True
    return False

"""The records that a run is made from and made into."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, nullcontext
from typing import TYPE_CHECKING, Any

from xdynamics import archive, record
from xdynamics.archive.place import GIVEN, Given, location_of
from xdynamics.archive.stores import is_same
from xdynamics.evidence.runs import record_march
from xdynamics.faults import AccuracyWarning, InputError, warn
from xdynamics.march import March
from xdynamics.record.partial_records import kind_description

if TYPE_CHECKING:
    import xarray as xr


@contextmanager
def open_source_run(run: xr.Dataset | Given, path: Given | None, verb: str) -> Iterator[xr.Dataset]:
    """Open or check a run from which another is made at `path`; the verb is for messages.

    Raises
    ------
    InputError
        If it is no whole run, was edited, or is the file that the other run would replace.
    """
    participle = f"{verb.removesuffix('e')}ed"
    is_archive = isinstance(run, GIVEN)
    if isinstance(run, GIVEN) and path is not None and is_same(location_of(path), location_of(run)):
        raise InputError(f"'{path}' is the archive that is {participle}; name another file")
    with archive.open_run(run) if isinstance(run, GIVEN) else nullcontext(run) as source_run:
        record.check_kind(source_run)
        if not is_archive:
            archive.check_unchanged(source_run)
        if kind := kind_description(source_run.attrs):
            raise InputError(f"the run cannot be {participle}, it is {kind}; {verb} the run itself")
        yield source_run


def check_destination(path: Any, *, resume: bool) -> None:
    """Check where a run is to be kept, before anything is marched.

    Raises
    ------
    InputError
        If the path is no name of a file, or a run is to be resumed without one.
    """
    if path is not None and not isinstance(path, GIVEN):
        raise InputError(f"path is {path!r}, needs the name of a file")
    if resume and path is None:
        raise InputError("resume needs path=…, the file that the run was to be streamed to")


def marched_record(
    march: March,
    path: Given | None,
    earlier_rows: Iterable[tuple[str, Any]] = (),
    *,
    resume: bool = False,
    memory: str | float | None = None,
) -> xr.Dataset:
    """March, warn of what was not accurate, and return the record; see `record_march`."""
    run = record_march(march, path, earlier_rows, resume=resume, memory=memory)
    warn_of_accuracy(march)
    return run


def warn_of_accuracy(march: March) -> None:
    """Warn of what the tolerances of a finished march did not control."""
    for doubt in march.doubts:
        warn(f"{march.model.name}: {doubt}", AccuracyWarning)

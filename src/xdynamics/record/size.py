"""How large a run's record will be, and whether there is room for it."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

from xdynamics.faults import InputError
from xdynamics.kernels import Layout
from xdynamics.march import March
from xdynamics.march.equation_solvers import solver_of
from xdynamics.methods.steppers import NOTHING
from xdynamics.runtime.free_memory import ROOM, UNITS, free_memory, size_text
from xdynamics.units import TIME, unit_suffix

SMALL = 1e6  # bytes of a log that always fit, so that the free memory is not looked up


def bytes_of_row(layout: Layout, samples: int) -> int:
    """Return how many bytes a row of the log has, with its force samples."""
    return 8 * layout.row.size + layout.flags + samples * 8 * layout.sample.size


def bytes_of_rows(march: March, rows: float) -> float:
    """Return how many bytes so many rows of a march take."""
    return rows * bytes_of_row(march.layout, int(march.run.plan[0].samples))


def memory_asked(memory: str | float | None) -> float | None:
    """Read a size of memory: a number of bytes, or a text like ``"2 GB"``.

    Raises
    ------
    InputError
        If it is no positive size.

    Examples
    --------
    >>> memory_asked("2 GB"), memory_asked(1e6), memory_asked(None)
    (2000000000.0, 1000000.0, None)
    """
    if memory is None:
        return None
    match = re.fullmatch(r"\s*([0-9.eE+]+)\s*([kMGT]?B)?\s*", str(memory))
    try:
        size = float(match[1]) * UNITS[match[2] or "B"] if match and not isinstance(memory, bool) else 0.0
    except ValueError:
        size = 0.0
    if not 0.0 < size < float("inf"):
        raise InputError(f"memory is {memory!r}, needs a positive size like '2 GB', or a number of bytes")
    return size


def check_record_room(march: March, memory: str | float | None = None, path: Any = None) -> None:
    """Check before a march that its log will fit; rows of steps that are chosen, and of events, are judged as they come.

    Parameters
    ----------
    march : March
    memory : str or float, optional
        The most that a log kept in memory may take; by default four fifths of the free memory.
    path : str or Path, optional
        The file that the log is streamed to, in bounded memory.

    Raises
    ------
    InputError
        With the number of rows, the room that they take and the room that is available.
    """
    _check_march(march)
    allowed, rows = memory_asked(memory), march.expected_rows
    if rows is None:
        return
    kept_rows = rows / march.settings.keep_every
    needed = bytes_of_rows(march, kept_rows)
    need_text = f"the run makes {rows:.4g} rows, which take {size_text(needed)}"
    if march.settings.keep_every > 1:
        need_text = f"the run makes {rows:.4g} rows and keeps {kept_rows:.4g} of them, which take {size_text(needed)}"
    if path is not None:
        try:
            total, _, free = shutil.disk_usage(Path(path).absolute().parent)
        except (OSError, ValueError):  # no folder: refused by its name before anything is marched into it
            return
        if total and needed > free:  # of no size is a file system that keeps no files, like /proc, which says so itself
            raise InputError(
                f"{need_text}, and the disk of '{path}' has {size_text(free)} free; take a longer step or an earlier end"
            )
        return
    if allowed is None and needed < SMALL:
        return
    room = ROOM * free_memory() if allowed is None else allowed
    if needed > room:
        limit = f"{size_text(room)} of memory {'can be had' if allowed is None else 'were allowed'}"
        raise InputError(
            f"{need_text}, and {limit}; give path=… to stream them to a file, keep_every=n to keep one row in n, a longer"
            " step or an earlier end"
        )


def check_growth(march: March, bytes_taken: float, more: float, memory: str | float | None = None) -> None:
    """Check during a march that there is room for more of its record, whose rows could not be counted before.

    Parameters
    ----------
    march : March
    bytes_taken, more : float, bytes
        What its record takes so far, and what it will take beyond that.
    memory : str or float, optional
        The most that it may take; by default it may take four fifths of the memory that is left.

    Raises
    ------
    InputError
        With the time it has come to, its rows, the room that they take and the room that is available.
    """
    if memory is None and more < SMALL:
        return
    allowed = memory_asked(memory)
    room = ROOM * free_memory() if allowed is None else allowed
    if (more if allowed is None else bytes_taken + more) <= room:
        return
    limit = f"{size_text(room)} more can be had" if allowed is None else f"{size_text(room)} were allowed"
    rows, of_events, now = (
        int(march.now.rows),
        2 * march.event_pairs,
        march.now.t * march.settings.scales.si_factor(TIME),
    )
    reached = f"the march of '{march.model.name}' is at t = {now:.6g}{unit_suffix(march.model.time_unit)}"
    if 2 * of_events < rows:
        raise InputError(
            f"{reached} with {rows} rows, which take {size_text(bytes_taken)} of memory, and {limit}; give path=… to stream"
            " them to a file, keep_every=n to keep one row in n, larger tolerances or an earlier end"
        )
    raise InputError(
        f"{reached} with {rows} rows, {of_events} of them of events, which take {size_text(bytes_taken)} of memory, and"
        f" {limit}; each event has two rows of all elements: take one event for all of them, by max(…, dimension) or"
        " sum(…, dimension), name what is logged (log=['…']), or give path=… to stream them to a file"
    )


def sizes_of_march(march: March) -> dict[str, float]:
    """Return how many bytes a march writes to beside its record, by what stands there; made before any of it is.

    The law is written first, which takes less than its arrays.
    """
    layout, law = march.layout, march.law
    sizes = {
        "states at both ends of a step": 16.0 * layout.record.size,
        "errors, tolerances and sizes": (28.0 if march.settings.adaptive else 2.0) * layout.used.size,
        "a row of the log": 8.0 * layout.row.size,
    }
    return sizes | solver_of(march.settings.method).sizes(law)


def _check_march(march: March) -> None:
    """Check that a march itself has room: its states and two rows of its log, then what its method needs beside them."""
    layout, room = march.layout, ROOM * free_memory()
    solves = march.settings.method.solver != NOTHING
    minimum_bytes = 8.0 * (2 * layout.record.size + layout.row.size)
    if minimum_bytes + 24.0 * solves * layout.used.size**2 < SMALL:
        return
    try:
        sizes = sizes_of_march(march) if minimum_bytes <= room else {}
    except MemoryError:
        sizes = {"what its method solves": room}
    needed = max(minimum_bytes, sum(sizes.values()))
    if needed > room:
        largest = max(sizes, key=sizes.__getitem__, default="")
        of_it = f", {size_text(sizes[largest])} of it {largest}," if largest else ""
        remedy = "fewer elements" + ", or a method that solves no equations" * solves
        raise InputError(
            f"a march of {layout.used.size} numbers by {march.settings.method.name} takes about {size_text(needed)}{of_it}"
            f" beside its record, and {size_text(room)} of memory can be had; take {remedy}"
        )

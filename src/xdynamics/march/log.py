"""The log of a march: blocks of rows, filled by compiled code and read as columns."""

from __future__ import annotations

import mmap
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels.compiling import jit_inline, jit_separate
from xdynamics.kernels.law import ROW
from xdynamics.kernels.layout import Layout
from xdynamics.kernels.program import DEVIATION, NORM, TURNS, UNSOUND, H, T
from xdynamics.march.calls import call_row_writer
from xdynamics.march.force_evaluation import leaves_samples, set_time
from xdynamics.march.past import has_room_for_past
from xdynamics.march.phases import later
from xdynamics.march.run import BASE, EVENT_ROW, TRIAL_ROW, Run
from xdynamics.march.settings import Settings
from xdynamics.model.assemblies import max_simultaneous, slots_of

note_links = later("note_links")  # of assemblies
_HUGE = 1 << 22  # bytes from which numpy asks for huge pages
_WIDE = 100  # columns from which huge pages pay: a row then spans more pages than the processor's TLB holds
_WIDEST = 1 << 17  # columns from which a row more is a megabyte
_SHORT = 1 << 16
_POPULATE = 23  # MADV_POPULATE_WRITE of Linux 5.14
OF_CLOSED = (
    7  # numbers of a closed link in a row: the row, its number, gap, force, residual of it, friction, and its grip
)
LOG_COUNTS = (BASE.names or ())[:-1]  # of what is in a log
PIECES = 128  # of a table that one flag distinguishes
MOST_SUBSTEPS = 200  # of one event's bracket, for which halving alone needs 60, and of the event search in a step


class Log(NamedTuple):
    """Blocks of a log; a column of the record is one row of `rows` and `samples`, so that it is contiguous.

    `base` has the numbers of rows and so on before it, and the room for samples. Rows of many numbers of a model with
    dimensions stand one after the other instead, in Fortran's order: each number in a page of its own is two thirds of
    the time of a step.
    """

    base: NDArray[Any]
    rows: NDArray[np.float64]
    flags: NDArray[np.int8]
    samples: NDArray[np.float64]
    trials: NDArray[Any]
    events: NDArray[Any]
    rates: NDArray[np.float64]
    impulses: NDArray[np.float64]
    closed: NDArray[np.float64] = np.zeros((0, 0))
    links: NDArray[np.int64] = np.zeros(0, np.int64)

    def arrays_by_name(self) -> dict[str, NDArray[Any]]:
        """Return its arrays by the names that a run has for them."""
        return {f"log_{name}" if name != "base" else name: array for name, array in self._asdict().items()}

    def follow(self, *counts: int) -> None:
        """Start filling the log from its beginning, after given counts of rows, trials, events and samples."""
        self.base[0], self.links[:] = (*counts, self.base[0]["room"]), 0

    def lend(self, run: Run) -> None:
        """Let a run write to this log from now on."""
        run.put(**self.arrays_by_name())

    @property
    def closed_rows(self) -> NDArray[np.float64]:
        """The written rows of closed links, shape (numbers, rows)."""
        return self.closed[:, : int(self.links[0]) if self.links.size else 0]

    def make_ready(self, row: int, rows: int, sampled: int) -> None:
        """Let the system provide the memory of some future rows at once: page by page costs twice as much."""
        for array, first, count in ((self.rows, row, rows), (self.samples, sampled * row, sampled * rows)):
            memory = _memory_of(array)
            if memory is None or not count:
                continue
            for column in range(array.shape[0]):
                # madvise takes addresses of whole pages only
                begin = (column * array.shape[1] + first) * array.itemsize // mmap.PAGESIZE * mmap.PAGESIZE
                size = min(count * array.itemsize, len(memory) - begin)
                try:
                    memory.madvise(_POPULATE, begin, size)
                except (OSError, ValueError):  # a system without it provides memory on first write
                    return


@dataclass(frozen=True)
class LogBlock:
    """A filled part of the log.

    `rows`, `trials`, `events`, `samples` are counts. Where rows are left out, the log has places among those that are
    kept, `numbers` are the march's numbers of these, and `begin` is that of the first row which could have been kept.
    """

    log: Log
    rows: int
    trials: int
    events: int
    samples: int
    numbers: NDArray[np.int64] | None = None
    begin: int = 0

    def of_rows(self) -> NDArray[np.int64]:
        """Return the march's numbers of the block's rows."""
        first = int(self.log.base[0]["rows"])
        return np.arange(first, first + self.rows) if self.numbers is None else self.numbers

    def numbered(self, places: NDArray[Any]) -> NDArray[np.int64]:
        """Return the march's numbers of rows that the log names: of this block, or the last one before it."""
        places = places.astype(np.int64)
        if self.numbers is None:
            return places
        return np.append(self.begin - 1, self.numbers)[places - (int(self.log.base[0]["rows"]) - 1)]


class Room:
    """Memory that is reused: arrays taken from it before become invalid.

    A system provides memory page by page, which costs more than filling it.
    """

    def __init__(self) -> None:
        self._kept: dict[str, NDArray[Any]] = {}

    def take(self, name: str, shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
        """Return an uninitialised array, under a name of its own."""
        size = int(np.prod(shape))
        if name not in self._kept or self._kept[name].size < size:
            self._kept[name] = np.empty(size + size // 4, dtype)
        return self._kept[name][:size].reshape(shape)


@jit_inline
def most_trials(events: int) -> int:
    """Return the most rejected trials of a step: one; where substeps count, also border, search and brackets."""
    return 8 + 2 * MOST_SUBSTEPS + events * (MOST_SUBSTEPS + 3) if events > 0 else 1


@jit_inline
def has_room(run: Run) -> bool:
    """Whether one more step, with all its possible events and nodes, fits into the blocks."""
    now, base, events = run.now[0], run.base[0], run.detectors.shape[0]
    return (
        now.rows - base.rows + 2 <= run.log_flags.shape[1]
        and now.trials - base.trials + most_trials(events * run.plan[0].apart) <= run.log_trials.shape[0]
        and (events + run.plan[0].assemblies == 0 or has_room_for_events(run))
        and (run.delays.shape[0] == 0 or has_room_for_past(run))
        and (run.plan[0].samples == 0 or has_room_for_samples(run))
    )


@jit_inline
def has_room_for_events(run: Run) -> bool:
    """Whether all events of a step fit, and the rows of links that are closed in it."""
    return events_fit(run) and (run.plan[0].assemblies == 0 or has_room_for_links(run))


@jit_inline
def events_fit(run: Run) -> bool:
    """Whether all events of a step fit."""
    now, base, max_events = run.now[0], run.base[0], run.detectors.shape[0] + 2 * run.plan[0].together
    return bool(now.events - base.events + max_events <= run.log_events.shape[0])


@jit_separate
def is_empty(run: Run) -> bool:
    """Whether it has neither rows nor rejected trials since it was emptied."""
    now, base = run.now[0], run.base[0]
    return bool(now.rows == base.rows and now.trials == base.trials)


@jit_separate
def overwrite_log(run: Run) -> None:
    """Start the log from its beginning again, except for events."""
    now, base = run.now[0], run.base[0]
    base.rows, base.trials, base.samples = now.rows, now.trials, now.samples
    for i in range(run.log_links.shape[0]):
        run.log_links[i] = 0


@jit_inline
def has_room_for_samples(run: Run) -> bool:
    """Whether force samples fit, of a step and of a node in it."""
    now, base = run.now[0], run.base[0]
    return now.samples - base.samples + run.plan[0].samples + 2 <= base.room or leaves_samples(run)


@jit_inline
def has_room_for_links(run: Run) -> bool:
    """Whether rows of closed links fit, of a step and of an event in it."""
    return run.log_links[0] + 3 * (run.closed[0] + run.plan[0].together) <= run.log_closed.shape[1]


@jit_inline
def append_row(run: Run, kind: int, t: float, h: float, state: NDArray[Any]) -> bool:
    """Write one row of the log, and count it if its energies and observables are finite."""
    now, step_numbers = run.now[0], run.at
    row = now.rows - run.base[0].rows
    reached = h > 0.0  # by a step, so that there is an error
    step_numbers[H], step_numbers[NORM], step_numbers[TURNS] = (
        h,
        now.norm if reached else 0.0,
        run.trial[0].iterations if reached else 0,
    )
    if step_numbers.shape[0] > DEVIATION:
        step_numbers[DEVIATION] = run.trial[0].deviation if reached else 0.0
    set_time(run, T, t)
    call_row_writer(run.law[ROW], run, state, row)
    run.log_flags[0, row], run.log_flags[1, row] = kind, now.regime
    for k in range(run.touches.shape[0]):
        run.log_flags[2 + k, row] = run.touches[k].state
    if run.plan[0].switches > 0:
        note_sides(run, row)
    finite = step_numbers[UNSOUND] == 0.0
    if finite:
        if run.plan[0].assemblies > 0:
            note_links(run, t)
        now.rows += 1
    return finite


@jit_inline
def note_sides(run: Run, row: int) -> None:
    """Write the side of each hidden switch in a row; for a table, the number of the piece."""
    flag_row = 2 + run.touches.shape[0]
    for i in range(run.detectors.shape[0] - run.plan[0].switches, run.detectors.shape[0]):
        detector = run.detectors[i]
        if detector.drive < 0:
            run.log_flags[flag_row, row] = np.int8(run.modes[detector.to])
            flag_row += 1
        else:
            piece = run.places[3 * detector.drive + 2]
            for k in range(3):
                run.log_flags[flag_row + k, row] = piece % PIECES
                piece //= PIECES
            flag_row += 3


@jit_inline
def note_trial(run: Run, h: float, norm: float, reason: int) -> None:
    """Write one rejected trial."""
    now = run.now[0]
    row = run.log_trials[now.trials - run.base[0].trials]
    row.time, row.step_size, row.error_norm, row.step, row.reason = now.t, h, norm, now.rows - 1, reason
    now.trials += 1


@jit_separate
def first_of_group(run: Run, row: int) -> int:
    """Return the first of the newest events after a row; the log may also have events of earlier runs."""
    first, first_possible = run.now[0].events - run.base[0].events, max(0, -run.base[0].events)
    while first > first_possible and run.log_events[first - 1].row_before == row:
        first -= 1
    return first


@jit_inline
def note_samples(run: Run, row: int) -> None:
    """Store the force evaluations of the accepted trial that led to a row."""
    now, plan, samples = run.now[0], run.plan[0], run.log_samples
    width = samples.shape[0] - 2
    first = now.samples - run.base[0].samples
    now.samples += plan.samples
    if leaves_samples(run):
        return
    for stage in range(plan.samples):
        samples[0, first + stage] = run.samples[stage * width]
        samples[1, first + stage] = row
        samples[2, first + stage] = stage + 1
        for i in range(1, width):
            samples[2 + i, first + stage] = run.samples[stage * width + i]


@jit_separate
def note_sample(run: Run, t: float, state: NDArray[Any], row: int) -> None:
    """Store one force evaluation outside steps: at the start, or after a node of a drive."""
    now, plan, samples = run.now[0], run.plan[0], run.log_samples
    if plan.samples == 0:
        return
    column, used = now.samples - run.base[0].samples, plan.used
    now.samples += 1
    if leaves_samples(run):
        return
    samples[0, column], samples[1, column], samples[2, column] = t, row, 0
    for i in range(used):
        samples[3 + i, column] = state[i]
    evaluated = samples.shape[0] - 3 - used
    for i in range(evaluated):
        samples[3 + used + i, column] = state[state.shape[0] - evaluated + i]


def _memory_of(array: NDArray[Any]) -> mmap.mmap | None:
    """Return the memory map of an array made by `_plain_pages`, if it has one."""
    base: Any = array.base
    while isinstance(base, np.ndarray):
        base = base.base
    owner = base.obj if isinstance(base, memoryview) else base
    return owner if isinstance(owner, mmap.mmap) else None


def allocate(
    layout: Layout,
    rows: int,
    *,
    sampled: int,
    one_by_one: bool = False,
    samples_kept: bool = True,
    by_rows: bool = False,
) -> Log:
    """Return an empty log for `rows` rows, with `sampled` force samples a step, stored or counted alone.

    If `one_by_one`, substeps are trials too; if `by_rows`, numbers of a row stand side by side.
    """
    events = len(layout.watched)
    # an odd stride: columns a power of two apart would share one cache set
    rows = rows + 1 if layout.row.size > _WIDEST else (rows + 4) | 1
    samples = (sampled * rows + rows // 4 + 4) | 1 if sampled else 3
    samples = samples if samples_kept else 0
    # as plain Python: a call of the other would have numba compile it for this alone
    plain: Any = getattr(most_trials, "py_func", most_trials)
    trials = min(rows, 20_000) + int(plain(events * int(one_by_one)))
    links = max_simultaneous(layout.model) if layout.model.assemblies else 0
    event_rows = (min(rows, 4_000) if events else 0) + events + 2 * links
    link_arrays: tuple[NDArray[Any], ...] = ()  # of links
    if links:
        closed = rows * min(links, layout.coordinates.size) + 6 * links
        link_arrays = _plain_pages((OF_CLOSED, closed), np.float64), np.zeros(1, np.int64)
    base = np.zeros(1, BASE)
    base["room"] = samples
    return Log(
        base,
        _row_table(layout.row.size, rows, by_rows=by_rows),
        _plain_pages((layout.flags, rows), np.int8),
        _row_table(layout.sample.size, samples, by_rows=by_rows),
        np.empty(trials, TRIAL_ROW),
        np.empty(event_rows, EVENT_ROW),
        np.empty((layout.followed.size, event_rows)),
        np.empty((_effect_columns(layout), event_rows)),
        *link_arrays,
    )


def log_of(layout: Layout, settings: Settings, rows: int, sampled: int = 0) -> Log:
    """Return an empty log of a march with its settings; of no row, one that nothing is written to."""
    form = {
        "one_by_one": settings.locates_one_by_one,
        "samples_kept": settings.keeps_samples,
        "by_rows": is_wide(layout),
    }
    return allocate(layout, rows, sampled=sampled, **form)


def _row_table(numbers: int, rows: int, *, by_rows: bool) -> NDArray[np.float64]:
    """Return room for rows; where numbers of a row stand side by side, rows that are not written take no memory."""
    return np.empty((rows, numbers)).T if by_rows else _plain_pages((numbers, rows), np.float64)


def is_wide(layout: Layout) -> bool:
    """Whether rows of a log are to stand one after the other, since quantities with dimensions have many numbers."""
    return bool(layout.model.shapes.dims) and layout.row.size >= _WIDE


def misplaced_events(detectors: NDArray[Any], log: Log, count: int) -> NDArray[np.bool_]:
    """Return which of the first events of a log exceed their position tolerance."""
    events = log.events[:count]
    misplaced: NDArray[np.bool_] = np.abs(events["residual"]) > detectors["position"][events["detector"]]
    return misplaced


def _effect_columns(layout: Layout) -> int:
    """Return the number of columns for an event's effect: impulses and energy of contacts, offsets of positions."""
    n = layout.coordinates.size
    if layout.model.assemblies:  # at both ends of a link, the energy, and what is left unsolved
        return 2 * slots_of(layout.model, layout.coordinates)[1] + 2 + (n if layout.resets else 0)
    return 2 * n + 1 if layout.reactions else n if layout.resets else 0


def most_recycled(layout: Layout) -> int:
    """Return the most rows of a log whose memory the next one reuses; larger logs go back to the system."""
    return max(1 << 9, _HUGE // (8 * layout.row.size) - 8)


def _plain_pages(shape: tuple[int, int], dtype: type[Any]) -> NDArray[Any]:
    """Return an array on plain pages of memory, which are touched when it is filled.

    numpy asks the system for huge pages, and assembling those can stall a first run longer than it marches:
    198 ns a step instead of 60, measured on 10**7 steps of the oscillator. A row of many columns is better off with
    them: 16 ns a step and coordinate instead of 26 with 100 masses, 26 instead of 44 with 1,000.
    """
    size = shape[0] * shape[1] * np.dtype(dtype).itemsize
    wide = shape[0] >= _WIDE and shape[1] <= _SHORT  # a page holds some columns, not a part of one that is never filled
    if size < _HUGE or wide or not hasattr(mmap, "MAP_PRIVATE"):
        return np.empty(shape, dtype)
    return np.frombuffer(map_pages(size), dtype).reshape(shape)


def unwritten(count: int, dtype: type[Any] = np.float64) -> NDArray[Any]:
    """Return zeros of which many take no memory before they are written, and give it back to the system.

    Those of numpy may be on a heap that has been used: of up to 32 MB they are written at once, and kept when freed.
    """
    size = count * np.dtype(dtype).itemsize
    if size < _HUGE or not hasattr(mmap, "MAP_PRIVATE"):
        return np.zeros(count, dtype)
    return np.frombuffer(map_pages(size), dtype)


def map_pages(size: int) -> mmap.mmap:
    """Return pages of memory of their own, which take none before they are written."""
    return mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)

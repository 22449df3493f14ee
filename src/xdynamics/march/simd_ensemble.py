"""Many runs of one law: their inputs, logs and results, and which of them march side by side in `march.lanes`.

One thread marches a part of the runs. Runs that may slide along switches that are not located, and runs with a past,
are marched one after the other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels import Law, Layout
from xdynamics.kernels.collocation import KEPT
from xdynamics.kernels.compiling import PLAINLY
from xdynamics.kernels.interval_program import can_be_watched
from xdynamics.kernels.lane_step import LANE, lane_width, noted_width, of_collocation
from xdynamics.kernels.machine import aligned_zeros, vector_lanes
from xdynamics.kernels.program import TABLE, WORDS
from xdynamics.march.engine import lanes as side_by_side
from xdynamics.march.equation_solvers import solver_of
from xdynamics.march.events.departures import STRAYS
from xdynamics.march.initial_run import addresses_of, floor_of, pose_run, widened
from xdynamics.march.lanes import EVENTS, NONE, OF_LANE, OF_NOTED, OF_STATE, ROWS
from xdynamics.march.log import LOG_COUNTS, Log, Room, allocate, is_wide
from xdynamics.march.run import EVENT_ROW, NOW, Run
from xdynamics.march.runner import March
from xdynamics.march.settings import Settings
from xdynamics.model import Model
from xdynamics.model.motion import constants
from xdynamics.units import TIME

Floats = NDArray[np.float64]
Arrays = Mapping[tuple[str, str], Floats]  # by kind and name; one number for each run
# rows that many runs fill at a time, at most and at least; and the bytes of wide ones: a system provides memory in pages of
# some megabytes, of which a row of 10,000 numbers may touch all
LOG_ROWS, FEWEST_ROWS, LOG_BYTES = 1 << 14, 64, 1 << 24


@dataclass
class EnsemblePart:
    """The runs that one thread marched, in internal units, with the pieces of its log."""

    ends: NDArray[Any]
    lasts: Floats
    largest: Floats
    passed: Floats  # as for `engine_entries.march_in_turn`
    parameters: Floats
    logs: list[Log]

    @classmethod
    def empty(cls, runs: int, law: Law, parameters: Floats) -> EnsemblePart:
        """Return room for a number of runs."""
        used, row, smooth = law.layout.used.size, law.layout.row.size, len(law.layout.smooth)
        lasts, largest, passed = (np.zeros((runs, width)) for width in (row, used, 3 * smooth + 1))
        return cls(np.zeros(runs, NOW), lasts, largest, passed, parameters, [])


def inputs_of_runs(
    model: Model, settings: Settings, law: Law, run: Run, arrays: Arrays
) -> tuple[NDArray[Any], Floats, Floats, Floats]:
    """Return plan, start, parameters and absolute tolerances of every run, in internal units."""
    elements = model.elements
    n, scales, layout = len(next(iter(arrays.values()))), settings.scales, law.layout
    plans = np.repeat(run.plan, n)
    starts = np.tile(run.y[: layout.used.size], (n, 1))
    parameters, atols = np.tile(run.p, (n, 1)), np.tile(run.atol, (n, 1))
    places = {name: i for i, name in enumerate(constants(model))}
    for (kind, name), values in arrays.items():
        if kind == "parameter":
            parameters[:, places[name]] = values / scales.si_factor(elements.dimensions[name])
        elif kind == "initial value":
            starts[:, layout.used.offset_of(name)] = values / scales.si_factor(elements.dimensions[name])
        elif kind == "step":
            plans["first_step" if settings.adaptive else "step_size"] = values / scales.si_factor(TIME)
        elif settings.tolerances is not None:
            plans["rtol"] = [law.scheme.effective_rtol(value) for value in values.tolist()]
            factors = np.array([widened(law, value) for value in values.tolist()])
            plans["floor"] = [floor_of(rtol) for rtol in plans["rtol"].tolist()]
            for i, used in enumerate(layout.used):
                atol = settings.tolerances.atol_of(used)
                if atol is not None:
                    atols[:, i] = atol / scales.si_factor(elements.dimensions[used]) * factors
    return plans, starts, parameters, atols


def log_of_many(layout: Layout, settings: Settings) -> Log:
    """Return a log for many runs, which is filled repeatedly."""
    rows = rows_of_many(LOG_ROWS, layout.row.size)
    return allocate(layout, rows, sampled=0, one_by_one=settings.locates_one_by_one, by_rows=is_wide(layout))


def rows_of_many(max_rows: int, numbers: int) -> int:
    """Return how many rows of so many numbers many runs fill at a time: some megabytes, and a step at least."""
    return max(FEWEST_ROWS, min(max_rows, LOG_BYTES // (8 * max(1, numbers))))


def copy_log_start(log: Log, rows: int, events: int) -> Log:
    """Copy the first rows and events of a log, with closed links where there are rows."""
    return Log(
        log.base,
        log.rows[:, :rows].copy(),
        log.flags[:, :rows].copy(),
        log.samples[:, :0],
        log.trials[:0],
        log.events[:events].copy(),
        log.rates[:, :events].copy(),
        log.impulses[:, :events].copy(),
        log.closed_rows[:, : None if rows else 0].copy(),
    )


def take_out_log(run: Run, log: Log, *, logs: bool) -> Log:
    """Copy the recorded part of the log, and let it be filled from its beginning."""
    now, base = run.now[0], log.base[0]
    rows, events = int(now.rows - base.rows) if logs else 0, int(now.events - base.events)
    log_part = copy_log_start(log, rows, events)
    log.follow(*(int(now[count]) for count in LOG_COUNTS))
    return log_part


BLOCK_ROWS = 1 << 12  # of a log, of which two are filled in turn


def march_watched(
    model: Model, settings: Settings, law: Law, inputs: tuple[NDArray[Any], ...], *, logs: bool
) -> EnsemblePart:
    """March runs one after the other, each as if alone: those that slide along a switch are ended, delays have their past.

    Parameters
    ----------
    model : Model
    settings : Settings
    law : Law
    inputs : tuple of ndarray
        Plan, start, parameters and absolute tolerances of every run, in internal units; see `inputs_of_runs`.
    logs : bool
        Whether to keep every row, or only the last states and the events.
    """
    part = EnsemblePart.empty(len(inputs[0]), law, inputs[2])
    for k, (plan, start, parameters, atols) in enumerate(zip(*inputs, strict=True)):
        march = March(model, settings)
        march.run.plan[0], march.run.p[:], march.run.atol[:] = plan, parameters, atols
        march.run.y[: start.size] = start
        with closing(march.blocks(BLOCK_ROWS)) as blocks:
            for block in blocks:
                if block.rows:
                    part.lasts[k] = block.log.rows[:, block.rows - 1]
                part.logs.append(copy_log_start(block.log, block.rows if logs else 0, block.events))
                part.logs[-1].closed[:1] -= block.log.base[0]["rows"]
        run = march.run  # another one, if it slides in the end
        part.ends[k], part.largest[k] = run.now[0], run.largest[: part.largest.shape[1]]
        part.passed[k, :-1] = run.w[run.w.size - part.passed.shape[1] + 1 :]
        part.passed[k, -1] = np.count_nonzero(run.departures["goes_on"] & STRAYS) if run.departures.size else 0
    return part


LANE_ROWS = 1 << 5  # of a lane's log, to which the single march writes now and then
EVENT_ROOM = 1 << 16  # events that lanes hold before they are taken out
ROW_ROOM = 1 << 12  # rows of all lanes before they are taken out
FEWEST_A_LANE = 4  # runs from which lanes pay
LARGEST_ROW = (
    2048  # numbers up to which they do: of more, a run's own elements fill the processor, and lanes its caches
)


def lanes_for(law: Law, settings: Settings, runs: int, requested_lanes: int | None) -> int:
    """Return how many runs may go side by side: one where a step is more than a program, or nothing is gained."""
    method, layout = law.scheme.method, law.layout
    solved = solver_of(method).in_lanes(law, settings)
    plain = solved and method.stepper.locates and law.scheme.steps == 1 and not isinstance(settings.step, tuple)
    plain = plain and not (layout.model.python_functions or layout.model.assemblies or layout.model.controllers)
    plain = plain and not (layout.attitudes or any(event.every for event in layout.model.elements.events.values()))
    if not plain or PLAINLY or layout.is_doubled or not can_be_watched(layout):
        return 1
    if requested_lanes is not None:
        return max(1, requested_lanes)
    return vector_lanes() if runs >= FEWEST_A_LANE * vector_lanes() and layout.row.size <= LARGEST_ROW else 1


def march_abreast(
    model: Model, settings: Settings, law: Law, arrays: Arrays, lanes: int, columns: Sequence[str], room: Room
) -> EnsemblePart:
    """March runs side by side, and keep some columns of their logs in a room."""
    n, layout = len(next(iter(arrays.values()))), law.layout
    log = allocate(layout, LANE_ROWS, sampled=0, one_by_one=settings.locates_one_by_one, by_rows=is_wide(layout))
    template_run = pose_run(model, settings, law, log, addresses_of(law))
    twins, inputs = template_run.twins(lanes), inputs_of_runs(model, settings, law, template_run, arrays)
    part = EnsemblePart.empty(n, law, inputs[2])
    blocks = _lane_blocks(template_run, layout, law.memory, lanes)
    table = table_of(blocks | {"tables": template_run.tables})
    followers, weighs = tuple(map(bool, template_run.adaptive_atol)), bool(template_run.plan[0]["rounding"] > 0.0)
    stride = law.stride_address(lanes, adaptive=settings.adaptive, adaptive_atol=followers, weighs=weighs)
    state_blocks = [blocks[name] for name in ("at", "y", "before", "p", "pieces", "z", "w")]
    sources, rows = _column_sources(layout, columns), []
    event_log = _event_log(log, 2 * lanes * len(log.events) + min(n, EVENT_ROOM) if layout.watched else 0)
    owners, lane_counters = np.zeros(len(event_log.events), np.int64), np.array([lanes, 0, 0, 0])
    event_owners, members, reached, finished = [], np.full(lanes, NONE), np.zeros(lanes), False
    row_store, marks = _Rows.allocate(room, 0, sources, layout.flags, lanes), np.zeros((layout.flags, lanes), np.int8)
    while not finished:
        finished = side_by_side().march(
            twins.addresses,
            stride,
            table,
            *state_blocks,
            members,
            lane_counters,
            *inputs,
            part.ends,
            part.lasts,
            part.largest,
            part.passed,
            event_log.events,
            event_log.rates,
            event_log.impulses,
            owners,
            blocks["noted"],
            sources,
            *row_store,
            reached,
            marks,
        )
        count, lane_counters[EVENTS] = int(lane_counters[EVENTS]), 0
        part.logs.append(_events_at(event_log, np.arange(count)))
        event_owners.append(owners[:count].copy())
        if len(sources):
            rows.append(row_store.first(int(lane_counters[ROWS])))
            row_store, lane_counters[ROWS] = (
                row_store if finished else _Rows.allocate(room, len(rows), sources, layout.flags, lanes),
                0,
            )
    events = _sort_events(part.logs, event_owners)
    part.logs = [_merge_rows(events, layout, part.ends["rows"], sources, rows, room) if rows else events]
    return part


def _lane_blocks(run: Run, layout: Layout, memory: int, lanes: int) -> dict[str, NDArray[Any]]:
    """Return the arrays of a step in lanes."""
    sizes = {name: len(getattr(run, name)) for name in ("at", "y", "p", "z", "e")}
    sizes |= {"before": sizes["y"], "noted": noted_width(layout), "w": lane_width(layout, memory)}
    blocks = {name: aligned_zeros(size * lanes).reshape(size, lanes) for name, size in sizes.items()}
    return blocks | {"pieces": np.zeros((len(run.places), lanes), np.int64)}


class _Rows(NamedTuple):
    """Rows of many runs in the order of acceptance, and the run of each."""

    rows: NDArray[np.float64]
    flags: NDArray[np.int8]
    owners: NDArray[np.int64]

    @classmethod
    def allocate(cls, room: Room, number: int, sources: NDArray[np.int64], flags: int, lanes: int) -> _Rows:
        """Return room for rows, or for none where no columns are recorded."""
        count = rows_of_many(ROW_ROOM, lanes * len(sources)) if len(sources) else 0
        shapes = {"rows": (count, len(sources), lanes), "flags": (count, flags, lanes), "owners": (count, lanes)}
        kinds = {"rows": np.float64, "flags": np.int8, "owners": np.int64}
        return cls(**{name: room.take(f"{name} {number}", shape, kinds[name]) for name, shape in shapes.items()})

    def first(self, count: int) -> _Rows:
        """Return the first `count` rows, as views."""
        return _Rows(self.rows[:count], self.flags[:count], self.owners[:count])


def _column_sources(layout: Layout, columns: Sequence[str]) -> NDArray[np.int64]:
    """Return the numbers of columns of the log, and where a lane holds them."""
    state, errors = layout.row[2 : 2 + layout.state.size], len(LANE) + 2 * layout.used.size
    places = {"time": (OF_LANE, LANE.index("t")), "step_size": (OF_LANE, LANE.index("h"))}
    places |= {name: (OF_STATE, i) for i, name in enumerate(state)}
    places |= {name: (OF_NOTED, i) for i, name in enumerate(layout.derived)}
    places |= dict(
        zip(
            layout.errors,
            [(OF_LANE, LANE.index("norm")), *((OF_LANE, errors + i) for i in range(layout.used.size))],
            strict=False,
        )
    )
    places |= {name: (OF_LANE, of_collocation(layout) + KEPT.index("iterations")) for name in layout.effort}
    requested_columns = frozenset(columns)
    sources = [(i, *places[name]) for i, name in enumerate(layout.row) if name in requested_columns]
    return np.array(sources, np.int64).reshape(-1, 3)


def _merge_rows(
    log: Log, layout: Layout, counts: NDArray[np.int64], sources: NDArray[np.int64], pieces: list[_Rows], room: Room
) -> Log:
    """Merge the rows of all runs into a log, one run after the other; unrecorded columns are undefined."""
    places, total = np.concatenate([[0], np.cumsum(counts)[:-1]]), int(counts.sum())
    rows, flags = (
        room.take("log", (layout.row.size, total), np.float64),
        room.take("marks", (layout.flags, total), np.int8),
    )
    merged = log._replace(rows=rows, flags=flags)
    for piece in pieces:
        side_by_side().gather(piece.rows, piece.flags, piece.owners, sources, places, merged.rows, merged.flags)
    return merged


def _event_log(log: Log, events: int) -> Log:
    """Return a log with room for events alone."""
    return Log(
        log.base,
        log.rows[:, :0],
        log.flags[:, :0],
        log.samples[:, :0],
        log.trials[:0],
        np.zeros(events, EVENT_ROW),
        np.zeros((len(log.rates), events)),
        np.zeros((len(log.impulses), events)),
    )


def _sort_events(logs: Sequence[Log], owners: Sequence[NDArray[np.int64]]) -> Log:
    """Return a log with the events of several, one run after the other; those of a run keep their order."""
    events, rates, impulses = (
        np.concatenate(pieces, axis=-1)
        for pieces in zip(*((log.events, log.rates, log.impulses) for log in logs), strict=True)
    )
    order = np.argsort(np.concatenate(owners), kind="stable")
    return _events_at(logs[0]._replace(events=events, rates=rates, impulses=impulses), order)


def _events_at(log: Log, indices: NDArray[np.int64]) -> Log:
    """Return a log with some of the events."""
    return log._replace(events=log.events[indices], rates=log.rates[:, indices], impulses=log.impulses[:, indices])


def table_of(blocks: Mapping[str, NDArray[Any]]) -> NDArray[np.int64]:
    """Return the addresses of the arrays of a program in lanes."""
    table = np.zeros(WORDS * len(TABLE), np.int64)
    for i, name in enumerate(TABLE):
        if name in blocks:
            table[WORDS * i] = blocks[name].ctypes.data
    return table

"""Many runs of one model and method in one call of the engine: no Python for each run, no lock held."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass, replace
from itertools import chain, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.faults import InputError, Ledger
from xdynamics.kernels import Law, Layout, law_of
from xdynamics.march.engine import NoMemoryError, engine
from xdynamics.march.initial_run import addresses_of, pose_run
from xdynamics.march.log import Log, LogBlock, Room, allocate
from xdynamics.march.outcomes import AT_SWITCH, OUTCOMES
from xdynamics.march.run import Run
from xdynamics.march.settings import Settings, check_alone
from xdynamics.march.simd_ensemble import (
    EnsemblePart,
    inputs_of_runs,
    lanes_for,
    log_of_many,
    march_abreast,
    march_watched,
    take_out_log,
)
from xdynamics.march.tolerances import LEAST_RTOL
from xdynamics.march.unlocated_switches import may_slide
from xdynamics.model import Model
from xdynamics.units import TIME, Scales, spell, unit_suffix

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Runs:
    """The results of many runs, in their order.

    Attributes
    ----------
    layout : Layout
        Its `row` names the columns of the log.
    scales : Scales
        From internal units to SI.
    ends : ndarray of NOW, shape (n,)
        The final numbers of each march, in internal units.
    largest : ndarray, shape (n, m)
        The largest absolute value of each coordinate, velocity and state, in internal units, where steps are chosen.
    passed : ndarray of int, shape (n, k)
        How often each switch declared smooth was passed, in the order of `layout.smooth`.
    strayed : ndarray of int, shape (n,)
        How many events set the motion back when errors of steps had carried it through zero.
    log_block : LogBlock
        Rows of the logs of all runs, one run after the other: all rows, or the last of each. Always all events.
    parameters : ndarray, shape (n, …)
        Of each run, in internal units, in the order of `motion.constants`.
    first_event, first_row : ndarray of int, shape (n + 1,)
        First event and first row of each run; the last entry is the total.
    columns : tuple of str
        The columns of the log that were filled.
    """

    layout: Layout
    scales: Scales
    ends: NDArray[Any]
    largest: Floats
    passed: NDArray[np.int64]
    strayed: NDArray[np.int64]
    log_block: LogBlock
    parameters: Floats
    first_event: NDArray[np.int64]
    first_row: NDArray[np.int64]
    columns: tuple[str, ...]

    @property
    def time(self) -> Floats:
        """Final time of each run, s."""
        return np.array(self.ends["t"] * self.scales.si_factor(TIME))

    @property
    def state(self) -> Floats:
        """Final coordinates, velocities and first-order states, SI, shape (n, m), in the order of `layout.used`."""
        used = self.layout.used
        factors = np.array([self.scales.si_factor(self.layout.model.elements.dimensions[name]) for name in used])
        return np.ascontiguousarray(self.log_block.log.rows[2 : 2 + len(used), self.last_rows].T) * factors

    @property
    def status(self) -> NDArray[np.int64]:
        """Key of `march.OUTCOMES` of each run."""
        return np.array(self.ends["status"])

    @property
    def rows(self) -> NDArray[np.int64]:
        """Accepted states of each run."""
        return np.array(self.ends["rows"])

    @property
    def accepted(self) -> NDArray[np.int64]:
        """Accepted steps of each run; the second row of an event does not count."""
        runs = np.repeat(np.arange(len(self.ends)), np.diff(self.first_event))
        row_before, row_after = self.events["row_before"], self.events["row_after"]
        is_repeated = np.zeros(len(runs), bool)
        is_repeated[1:] = (row_after[1:] == row_after[:-1]) & (
            runs[1:] == runs[:-1]
        )  # events of one time share their rows
        pairs = np.bincount(runs[(row_after > row_before) & ~is_repeated], minlength=len(self.ends))
        return self.rows - 1 - pairs

    @property
    def trials(self) -> NDArray[np.int64]:
        """Rejected trials of each run."""
        return np.array(self.ends["trials"])

    @property
    def evaluations(self) -> NDArray[np.int64]:
        """Force evaluations of each run."""
        return np.array(self.ends["evaluations"])

    @property
    def events(self) -> NDArray[Any]:
        """Located events of all runs, one run after the other; times in internal units."""
        return self.log_block.log.events

    @property
    def outcomes(self) -> list[str]:
        """Outcome of each run, as a word."""
        return [OUTCOMES[status].word for status in self.ends["status"].tolist()]

    @property
    def last_rows(self) -> NDArray[np.int64]:
        """Index of each run's last row in the rows of all runs, shape (n,)."""
        return self.first_row[1:] - 1

    def events_of(self, run: int) -> NDArray[Any]:
        """Return the events of one run."""
        return self.events[self.first_event[run] : self.first_event[run + 1]]

    def log_of(self, run: int) -> Floats:
        """Return the log of one run; columns as `layout.row` names them, in internal units.

        Raises
        ------
        InputError
            If no logs were kept.
        """
        if self.log_block.rows != self.ends["rows"].sum():
            raise InputError("no logs were kept; run with logs=True")
        return self.log_block.log.rows[:, self.first_row[run] : self.first_row[run + 1]]


def march_many(
    model: Model,
    settings: Settings,
    *,
    parameters: Mapping[str, Any] | None = None,
    initial: Mapping[str, Any] | None = None,
    steps: Any = None,
    rtols: Any = None,
    logs: bool | Sequence[str] = False,
    threads: int = 1,
    lanes: int | None = None,
    room: Room | None = None,
) -> Runs:
    """March a model many times with different numbers; every run has, to the bit, the result of a single march.

    Parameters
    ----------
    model : Model
    settings : Settings
        Shared by all runs: method, end, tolerances, scales.
    parameters, initial : mapping of str to array_like of float, shape (n,), SI
        Values that replace the model's, one for each run; `initial` names coordinates, velocities, states. Those that
        the model gives by expressions of parameters follow these.
    steps : array_like of float, shape (n,), s
        Step of each run's grid; with chosen steps, the first step.
    rtols : array_like of float, shape (n,)
        Relative tolerance of each run.
    logs : bool or sequence of str
        Whether to keep every row of every run, or only the last states and the events; or the names of columns of
        `layout.row` to keep of every row, others being undefined.
    threads : int
        Threads that share the runs; the result does not depend on their number.
    lanes : int, optional
        Runs marched side by side in vector code, where the method, the model and what is kept allow it; by default
        as many as suit the processor. The result does not depend on it either.
    room : Room, optional
        Memory for the logs, which the next call with the same room reuses; for one thread.

    Returns
    -------
    Runs

    Raises
    ------
    InputError
        If an array has a different length, an unknown name or invalid values, with every fault; if the system gives no
        memory.
    """
    check_alone(model, settings)
    varied = {("parameter", name): values for name, values in (parameters or {}).items()}
    starts = model.started(parameters or {}, initial or {})
    varied |= {("initial value", name): values for name, values in starts.items()}
    varied |= {(kind, ""): values for kind, values in (("step", steps), ("rtol", rtols)) if values is not None}
    arrays = _read_run_arrays(model, settings, varied)
    n = len(next(iter(arrays.values())))
    law = law_of(settings.layout(model), sampled=False)
    addresses_of(law)
    cuts = np.linspace(0, n, max(1, min(threads, n)) + 1).astype(int)
    # where points of tables are passed at other times, a march lands elsewhere
    timed = {name: arrays["parameter", name] for name in sorted(model.read_by_points) if ("parameter", name) in arrays}
    changes = [1 + np.flatnonzero(np.diff(values)) for values in timed.values()]
    parts = [slice(a, b) for a, b in pairwise(np.unique(np.concatenate([cuts, *changes])).tolist())]

    needs_own_march = timed or may_slide(model, settings)
    side_by_side, keeps_logs = 1 if needs_own_march else lanes_for(law, settings, n, lanes), bool(logs)
    columns = (tuple(law.layout.row) if logs else ()) if isinstance(logs, bool) else tuple(logs)
    filled_columns = columns if keeps_logs and side_by_side > 1 else tuple(law.layout.row)

    def march_part(part: slice, room: Room | None, *, alone: bool = False) -> EnsemblePart:
        part_arrays = {key: array[part] for key, array in arrays.items()}
        if side_by_side > 1 and not alone:
            return march_abreast(model, settings, law, part_arrays, side_by_side, columns, room or Room())
        log = log_of_many(law.layout, settings)
        # written by repr, which loses no bit of a number
        slice_parameters = {name: f"{float(values[part.start])!r} {_si(model, name)}" for name, values in timed.items()}
        member = model.replace(parameters=slice_parameters) if slice_parameters else model, settings
        run = pose_run(*member, law, log, addresses_of(law))
        inputs = inputs_of_runs(model, settings, law, run, part_arrays)
        if alone:
            return march_watched(*member, law, inputs, logs=keeps_logs)
        return _march_part(member, run, log, law, inputs, logs=keeps_logs)

    def march_slice(part: slice) -> list[EnsemblePart]:
        try:
            found = march_part(part, room)
            pieces = _pieces_by_sliding(part, found.ends["status"] == AT_SWITCH)
            return [march_part(piece, None, alone=alone) for piece, alone in pieces] if pieces else [found]
        except NoMemoryError:
            raise NoMemoryError(f"the model '{model.name}'", f", in one of {n} runs") from None

    with ThreadPoolExecutor(min(threads, len(parts))) if len(parts) > 1 else nullcontext() as pool:
        marched = [*chain.from_iterable((pool.map if pool else map)(march_slice, parts))]
    return _join_parts(law, settings, marched, filled_columns, logs=keeps_logs)


def _pieces_by_sliding(part: slice, slide: NDArray[np.bool_]) -> list[tuple[slice, bool]]:
    """Return the runs of a slice that slide along switches and those that do not, apart; none if no run does."""
    borders = [0, *(1 + np.flatnonzero(np.diff(slide))).tolist(), len(slide)] if slide.any() else []
    return [(slice(part.start + a, part.start + b), bool(slide[a])) for a, b in pairwise(borders)]


def _si(model: Model, name: str) -> str:
    """Return the SI unit of a parameter."""
    return spell(model.elements.dimensions[name]).text


def march_each(members: Sequence[tuple[Model, Settings]], *, logs: bool = False) -> Runs:
    """March runs one after the other whose every number is the member's own: sums of two floats, or delays.

    Parameters
    ----------
    members : sequence of (Model, Settings)
        Which differ in numbers alone: parameters, starts, steps, tolerances.
    logs : bool
        Whether to keep every row of every run, or only the last states and the events.

    Returns
    -------
    Runs
        Every run is the same, to the bit, as when marched alone.

    Raises
    ------
    InputError
        If a member's settings are wrong, or the system gives no memory.
    """
    for model, settings in members:
        settings.check(model)
    model, settings = members[0]
    law = law_of(settings.layout(model), sampled=False)
    addresses, log = addresses_of(law), log_of_many(law.layout, settings)
    small = allocate(law.layout, 1, sampled=0)
    runs = [pose_run(*member, law, small, addresses) for member in members]
    inputs = (
        np.concatenate([run.plan for run in runs]),
        *(np.stack([getattr(run, name) for run in runs]) for name in ("y", "p", "atol")),
    )
    timed = [{name: model.parameters[name].quantity for name in sorted(model.read_by_points)} for model, _ in members]
    ends = [k for k in range(1, len(members)) if timed[k] != timed[k - 1] or model.delays]
    try:
        parts = []
        for a, b in pairwise([0, *ends, len(members)]):
            member, part_inputs = members[a], tuple(part[a:b] for part in inputs)
            part = _march_part(member, pose_run(*member, law, log, addresses), log, law, part_inputs, logs=logs)
            slide = (part.ends["status"] == AT_SWITCH).any()
            parts.append(march_watched(*member, law, part_inputs, logs=logs) if slide else part)
    except NoMemoryError:
        raise NoMemoryError(f"the model '{model.name}'", f", in one of {len(members)} runs") from None
    return _join_parts(law, settings, parts, tuple(law.layout.row), logs=logs)


def _march_part(
    member: tuple[Model, Settings], run: Run, log: Log, law: Law, inputs: tuple[NDArray[Any], ...], *, logs: bool
) -> EnsemblePart:
    if may_slide(*member) or member[0].delays:
        return march_watched(*member, law, inputs, logs=logs)
    n, first, reached = len(inputs[0]), 0, None
    part = EnsemblePart.empty(n, law, inputs[2])
    while True:
        first = engine().march_many(run, *inputs, part.ends, part.lasts, part.largest, part.passed, first, logs)
        part.logs.append(take_out_log(run, log, logs=logs))
        if first == n:
            return part
        now = run.now[0]
        stopped_before, reached = reached, (first, float(now.t), int(now.rows), int(now.trials), int(now.events))
        if reached == stopped_before:  # else it would be emptied for ever
            moment = f"at t = {reached[1]!r}{unit_suffix(member[0].time_unit)}"
            raise RuntimeError(f"{moment}: the empty log has no room for a step of run {first} of {n}")


def _join_parts(
    law: Law, settings: Settings, parts: list[EnsemblePart], columns: tuple[str, ...], *, logs: bool
) -> Runs:
    """Concatenate the pieces of the logs, or only the last rows."""
    ends, pieces = (
        _concatenate_blocks([piece.ends for piece in parts], 0),
        [piece for part in parts for piece in part.logs],
    )
    rows, flags, counts = [piece.rows for piece in pieces], [piece.flags for piece in pieces], ends["rows"]
    if not logs:
        rows, counts = [np.ascontiguousarray(piece.lasts.T) for piece in parts], np.ones(len(ends), np.int64)
        flags = [np.zeros((len(pieces[0].flags), len(ends)), np.int8)]
    for piece, first in zip(pieces, np.cumsum([0, *(piece.rows.shape[1] for piece in pieces)]).tolist(), strict=False):
        piece.closed[:1] += first  # their rows among those of all runs
    log = Log(
        pieces[0].base,
        _concatenate_blocks(rows),
        _concatenate_blocks(flags),
        pieces[0].samples,
        pieces[0].trials,
        np.concatenate([piece.events for piece in pieces]),
        np.hstack([piece.rates for piece in pieces]),
        np.hstack([piece.impulses for piece in pieces]),
        _concatenate_blocks([piece.closed for piece in pieces]),
    )
    passed = np.concatenate([piece.passed for piece in parts]).astype(np.int64)
    return Runs(
        law.layout,
        settings.scales,
        ends,
        _concatenate_blocks([piece.largest for piece in parts], 0),
        passed[:, 1:-1:3],
        passed[:, -1],
        LogBlock(log, log.rows.shape[1], 0, len(log.events), 0),
        _concatenate_blocks([piece.parameters for piece in parts], 0),
        np.concatenate([[0], np.cumsum(ends["events"])]),
        np.concatenate([[0], np.cumsum(counts)]),
        columns,
    )


def _concatenate_blocks(blocks: list[NDArray[Any]], axis: int = 1) -> NDArray[Any]:
    return blocks[0] if len(blocks) == 1 else np.concatenate(blocks, axis)


def _read_run_arrays(
    model: Model, settings: Settings, inputs: Mapping[tuple[str, str], Any]
) -> dict[tuple[str, str], Floats]:
    """Read the arrays, collecting every fault."""
    ledger = Ledger(f"many runs of '{model.name}'")
    arrays: dict[tuple[str, str], Floats] = {}
    allowed = {"parameter": tuple(model.elements.statement.parameters), "initial value": settings.layout(model).used}
    for (kind, name), values in inputs.items():
        label = f"{kind} '{name}'" if name else kind
        if kind in allowed and name not in allowed[kind]:
            ledger.note(f"{label} is none of {', '.join(allowed[kind])}")
            continue
        try:
            array = np.array(values, dtype=np.float64)
        except (TypeError, ValueError):
            ledger.note(f"{label} is {str(values)[:40]}, needs one number for each run")
            continue
        if array.ndim != 1 or not array.size:
            ledger.note(f"{label} has the shape {array.shape}, needs one number for each run")
            continue
        bad = ~np.isfinite(array) | (
            (array <= 0.0) if kind == "step" else ((array < LEAST_RTOL) | (array >= 1.0)) if kind == "rtol" else False
        )
        if bad.any():
            run = int(np.flatnonzero(bad)[0])
            needed = {"step": "a positive time", "rtol": f"a number from {LEAST_RTOL:.3g} to 1"}.get(
                kind, "a finite number"
            )
            ledger.note(f"{label} of run {run} is {float(array[run])!r}, needs {needed}")
        arrays[kind, name] = array
    sizes = {len(array) for array in arrays.values()}
    if len(sizes) > 1:
        ledger.note(f"arrays have {', '.join(map(str, sorted(sizes)))} numbers; all need the same, one for each run")
    if ("rtol", "") in inputs and settings.tolerances is None:
        ledger.note("rtols are for chosen or judged steps; give the settings tolerances")
    if ("step", "") in inputs and isinstance(settings.step, tuple):
        ledger.note("steps are for a grid or a first step, and the settings give every step")
    if not ledger.faults:
        _check_settings(model, settings, arrays, ledger)
    if not inputs:
        ledger.note("nothing varies; give parameters, initial, steps or rtols")
    ledger.raise_faults()
    return arrays


def _check_settings(model: Model, settings: Settings, arrays: Mapping[tuple[str, str], Floats], ledger: Ledger) -> None:
    """Check the least and the greatest step and tolerance, and starts at zero, as for a single run."""
    for (kind, name), values in arrays.items():
        for value in (float(values.min()), float(values.max())):
            varied = settings
            if kind == "step":
                varied = replace(settings, step=value)
            elif kind == "rtol" and settings.tolerances is not None:
                varied = replace(settings, tolerances=replace(settings.tolerances, rtol=value))
            with ledger.entry(f"a run with {kind} {value!r}"):
                varied.check(model)
        tolerances = settings.tolerances
        if (
            kind == "initial value"
            and tolerances is not None
            and tolerances.atol_of(name) == 0.0
            and (values == 0.0).any()
        ):
            ledger.note(
                f"atol of '{name}' is 0 and a run starts at {name} = 0: its error would have no scale; give it a"
                " positive one"
            )

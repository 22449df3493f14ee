"""Many runs of one model and method in one call of the engine: no Python for each run, no lock held."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.faults import InputError, Ledger
from xdynamics.kernels import Law, Layout, law_of
from xdynamics.march.engine import engine
from xdynamics.march.log import Log, allocate
from xdynamics.march.outcomes import OUTCOMES
from xdynamics.march.posing import addresses_of, posed, widened
from xdynamics.march.run import EVENT_ROW, NOW, Run
from xdynamics.march.settings import LEAST_RTOL, Settings
from xdynamics.model import Model
from xdynamics.model.motion import constants
from xdynamics.units import TIME

Floats = NDArray[np.float64]
LOG_ROWS = 1 << 14  # of the log that is filled again and again


@dataclass(frozen=True)
class Runs:
    """What became of many runs, in their order. Numbers are SI.

    Attributes
    ----------
    layout : Layout
        Its `used` names the columns of `state`, its `row` the columns of a log.
    time : ndarray, shape (n,), s
        Where each run ended.
    state : ndarray, shape (n, m)
        Coordinates, velocities and first-order states there.
    status : ndarray of int, shape (n,)
        Key of `march.OUTCOMES`.
    rows, trials, evaluations : ndarray of int, shape (n,)
        Accepted states, rejected trials, force evaluations of each.
    events : ndarray of records
        Located events of all runs, one run behind the other; times in internal units.
    first_event, first_row : ndarray of int, shape (n + 1,)
        Where each run's events begin, and its rows in `log`; the last is their number.
    log : ndarray, shape (columns, rows), or None
        Whole logs, one run behind the other, in internal units.
    """

    layout: Layout
    time: Floats
    state: Floats
    status: NDArray[np.int64]
    rows: NDArray[np.int64]
    trials: NDArray[np.int64]
    evaluations: NDArray[np.int64]
    events: NDArray[Any]
    first_event: NDArray[np.int64]
    first_row: NDArray[np.int64]
    log: Floats | None

    @property
    def outcomes(self) -> list[str]:
        """The word of each run's outcome."""
        return [OUTCOMES[one].word for one in self.status.tolist()]

    def events_of(self, run: int) -> NDArray[Any]:
        """Return the events of one run."""
        return self.events[self.first_event[run] : self.first_event[run + 1]]

    def log_of(self, run: int) -> Floats:
        """Return the log of one run; columns as `layout.row` names them."""
        if self.log is None:
            raise InputError("no logs were kept; march with logs=True")
        return self.log[:, self.first_row[run] : self.first_row[run + 1]]


def march_many(
    model: Model,
    settings: Settings,
    *,
    parameters: Mapping[str, Any] | None = None,
    initial: Mapping[str, Any] | None = None,
    steps: Any = None,
    rtols: Any = None,
    logs: bool = False,
    threads: int = 1,
) -> Runs:
    """March a model many times, each with numbers of its own; each run has the bits that it has when it is marched alone.

    Parameters
    ----------
    model : Model
    settings : Settings
        What all runs share: method, end, tolerances, scales.
    parameters, initial : mapping of str to array_like of float, shape (n,), SI
        Values that replace those of the model, one for each run; `initial` names coordinates, velocities, states.
    steps : array_like of float, shape (n,), s
        Step of each run's grid; with chosen steps, the first one.
    rtols : array_like of float, shape (n,)
        Relative tolerance of each run.
    logs : bool
        Whether to keep every row of every run, or the last states and the events alone.
    threads : int
        Threads that share the runs; the result does not depend on it.

    Returns
    -------
    Runs

    Raises
    ------
    InputError
        If an array has another length, names nothing, or holds what no march can use; with every fault.
    """
    settings.check(model)
    model.require_functions()
    given = {("parameter", name): values for name, values in (parameters or {}).items()}
    given |= {("initial value", name): values for name, values in (initial or {}).items()}
    given |= {(kind, ""): values for kind, values in (("step", steps), ("rtol", rtols)) if values is not None}
    arrays = _checked(model, settings, given)
    n = len(next(iter(arrays.values())))
    law = law_of(settings.layout(model), sampled=False)
    addresses_of(law)
    cuts = np.linspace(0, n, max(1, min(threads, n)) + 1).astype(int)
    parts = [slice(a, b) for a, b in pairwise(cuts.tolist())]

    def marched(part: slice) -> _Part:
        return _march(model, settings, law, {key: one[part] for key, one in arrays.items()}, logs=logs)

    if len(parts) == 1:
        return _joined(law, settings, [marched(parts[0])], logs=logs)
    with ThreadPoolExecutor(len(parts)) as pool:
        return _joined(law, settings, list(pool.map(marched, parts)), logs=logs)


@dataclass
class _Part:
    """What one thread marched, in internal units."""

    ends: NDArray[Any]
    states: Floats
    events: list[NDArray[Any]]
    rows: list[Floats]


def _march(
    model: Model, settings: Settings, law: Law, arrays: Mapping[tuple[str, str], Floats], *, logs: bool
) -> _Part:
    n, log = len(next(iter(arrays.values()))), allocate(law.layout, LOG_ROWS, sampled=0)
    run = posed(model, settings, law, log, addresses_of(law))
    inputs = _inputs(model, settings, law, run, arrays)
    part = _Part(np.zeros(n, NOW), np.zeros((n, len(law.layout.used))), [], [])
    first = 0
    while True:
        first = engine().march_many(run, *inputs, part.ends, part.states, first, logs)
        _empty(run, log, part, logs=logs)
        if first == n:
            return part


def _inputs(
    model: Model, settings: Settings, law: Law, run: Run, arrays: Mapping[tuple[str, str], Floats]
) -> tuple[NDArray[Any], Floats, Floats, Floats]:
    """Return plan, start, parameters and absolute tolerances of every run, in internal units."""
    n, scales, layout = len(next(iter(arrays.values()))), settings.scales, law.layout
    plans = np.repeat(run.plan, n)
    starts = np.tile(run.y[: len(layout.used)], (n, 1))
    parameters, atols = np.tile(run.p, (n, 1)), np.tile(run.atol, (n, 1))
    places = {name: i for i, name in enumerate(constants(model))}
    for (kind, name), values in arrays.items():
        if kind == "parameter":
            parameters[:, places[name]] = values / scales.of(model.dimensions[name])
        elif kind == "initial value":
            starts[:, layout.used.index(name)] = values / scales.of(model.dimensions[name])
        elif kind == "step":
            plans["first_step" if settings.adaptive else "step_size"] = values / scales.of(TIME)
        elif settings.tolerances is not None:
            plans["rtol"] = [law.scheme.inner(one) for one in values.tolist()]
            factors = np.array([widened(law, one) for one in values.tolist()])
            each = [replace(settings.tolerances, rtol=one) for one in values.tolist()]  # unnamed ones follow rtol
            for i, one in enumerate(layout.used):
                atols[:, i] = np.array([asked.of(one) for asked in each]) / scales.of(model.dimensions[one]) * factors
    return plans, starts, parameters, atols


def _empty(run: Run, log: Log, part: _Part, *, logs: bool) -> None:
    """Take out of the log what is kept, and let it be filled from its beginning."""
    now, base = run.now[0], log.base[0]
    part.events.append(log.events[: int(now.events - base.events)].copy())
    if logs:
        part.rows.append(log.rows[:, : int(now.rows - base.rows)].copy())
    base.rows, base.trials, base.events, base.samples = now.rows, now.trials, now.events, now.samples


def _joined(law: Law, settings: Settings, parts: list[_Part], *, logs: bool) -> Runs:
    ends, states = np.concatenate([one.ends for one in parts]), np.vstack([one.states for one in parts])
    layout, scales = law.layout, settings.scales
    factors = np.array([scales.of(layout.model.dimensions[name]) for name in layout.used])
    return Runs(
        layout,
        ends["t"] * scales.of(TIME),
        states * factors,
        ends["status"],
        ends["rows"],
        ends["trials"],
        ends["evaluations"],
        np.concatenate([np.zeros(0, EVENT_ROW), *(one for part in parts for one in part.events)]),
        np.concatenate([[0], np.cumsum(ends["events"])]),
        np.concatenate([[0], np.cumsum(ends["rows"])]),
        np.hstack([one for part in parts for one in part.rows]) if logs else None,
    )


def _checked(model: Model, settings: Settings, given: Mapping[tuple[str, str], Any]) -> dict[tuple[str, str], Floats]:
    """Read the arrays, gathering every fault."""
    ledger = Ledger(f"many runs of '{model.name}'")
    arrays: dict[tuple[str, str], Floats] = {}
    known = {"parameter": tuple(model.parameters), "initial value": settings.layout(model).used}
    for (kind, name), values in given.items():
        what = f"{kind} '{name}'" if name else kind
        if kind in known and name not in known[kind]:
            ledger.note(f"{what} is none of {', '.join(known[kind])}")
            continue
        try:
            one = np.array(values, dtype=np.float64)
        except (TypeError, ValueError):
            ledger.note(f"{what} is {str(values)[:40]}, needs one number for each run")
            continue
        if one.ndim != 1 or not one.size:
            ledger.note(f"{what} has the shape {one.shape}, needs one number for each run")
            continue
        bad = ~np.isfinite(one) | (
            (one <= 0.0) if kind == "step" else ((one < LEAST_RTOL) | (one >= 1.0)) if kind == "rtol" else False
        )
        if bad.any():
            at = int(np.flatnonzero(bad)[0])
            needed = {"step": "a positive time", "rtol": f"a number from {LEAST_RTOL:.3g} to 1"}.get(
                kind, "a finite number"
            )
            ledger.note(f"{what} of run {at} is {float(one[at])!r}, needs {needed}")
        arrays[kind, name] = one
    sizes = {len(one) for one in arrays.values()}
    if len(sizes) > 1:
        ledger.note(f"arrays have {', '.join(map(str, sorted(sizes)))} numbers; all need the same, one for each run")
    if ("rtol", "") in given and settings.tolerances is None:
        ledger.note("rtols are for chosen or judged steps; give the settings tolerances")
    if ("step", "") in given and isinstance(settings.step, tuple):
        ledger.note("steps are for a grid or a first step, and the settings give every step")
    if not ledger.faults:
        _check_settings(model, settings, arrays, ledger)
    if not given:
        ledger.note("nothing varies; give parameters, initial, steps or rtols")
    ledger.settle()
    return arrays


def _check_settings(model: Model, settings: Settings, arrays: Mapping[tuple[str, str], Floats], ledger: Ledger) -> None:
    """Hold the least and the greatest step and tolerance, and starts at zero, to what one run is held to."""
    for (kind, name), values in arrays.items():
        for value in (float(values.min()), float(values.max())):
            varied = settings
            if kind == "step":
                varied = replace(settings, step=value)
            elif kind == "rtol" and settings.tolerances is not None:
                varied = replace(settings, tolerances=replace(settings.tolerances, rtol=value))
            with ledger.entry(f"a run with {kind} {value!r}"):
                varied.check(model)
        asked = settings.tolerances
        if kind == "initial value" and asked is not None and asked.of(name) == 0.0 and (values == 0.0).any():
            ledger.note(
                f"atol of '{name}' is 0 and a run starts at {name} = 0: its error would have no scale; give it a positive one"
            )

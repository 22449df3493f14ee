"""Proven bounds of all motions of a model, from every start and with every constant that it may have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics.dynamics.wanted_times import wanted_times
from xdynamics.evidence.enclosing.enclosure_dataset import MODEL, enclosure_dataset
from xdynamics.evidence.enclosing.parts import join_tubes, split_box
from xdynamics.evidence.enclosing.tube import prove_tube, unproven
from xdynamics.evidence.stage_tasks import Task
from xdynamics.evidence.stages import Stage, lazy_stage, requested_count
from xdynamics.faults import InputError
from xdynamics.keywords import read_number
from xdynamics.model import Model, check_model
from xdynamics.schema import AT_TIME
from xdynamics.tubes import Flow, interval_problem_of
from xdynamics.units import time_in, unit_suffix

if TYPE_CHECKING:
    import xarray as xr

    from xdynamics.march.runner import Progress

DEFAULT_RTOL, LEAST_RTOL, LARGEST_RTOL = 1e-16, 1e-20, 1e-3
LEAST_ORDER, MOST_ORDER = 3, 60
MOST_STEPS = 100_000
MOST_PARTS = 10_000
Time = str | float


def enclose(
    model: Model,
    *,
    until: Time | None = None,
    at: Sequence[Time] | Time | None = None,
    rtol: float | None = None,
    order: int | None = None,
    max_steps: int | None = None,
    parts: int | None = None,
    occurrences: int | None = None,
    compute: bool = True,
    progress: Progress | None = None,
) -> xr.Dataset:
    """Prove bounds of every motion of a model.

    Parameters
    ----------
    model : Model
        Smooth between the points of its tables, which are of time, and of first or second order. Values at the start and
        parameters with a `half_width` are intervals, all others the numbers that are written; pieces of tables are the
        polynomials of floats that runs look up. Events may record, switch, reset or stop.
    until : str or float
        Time up to which to prove; by default the last of `at`, else that of the model's `[run]`.
    at : times, optional
        Times at which bounds are wanted, like ``["1 s", "2 s"]`` or ``"0:10:101 s"``; by default those after each step.
    rtol : float
        What a step may add by truncation, relative to the largest values so far; by default 1e-16, a rounding.
    order : int
        Of the Taylor polynomials, from 3 to 60; by default ceil(1 - ln(rtol)/2), as for `taylor`: 20.
    max_steps : int
        Steps after which the proof ends; 100,000 by default.
    parts : int, optional
        Into how many parts to cut a wide set of starts and parameters, each cut being through the middle of what is widest
        beside its size: bounds of each part are proven, which are narrower, and joined. It needs `at`; 1 by default.
    occurrences : int, optional
        How many zeros of events to list, the first ones; where fewer are proven, the last are nan. By default all.
    compute : bool
        Whether to prove at once. If False, the Dataset has dask arrays, with one task for the whole proof. It needs `at`
        then, and of a model with events that record `occurrences`.
    progress : callable, optional
        Called with the fraction done, the time and the number of steps.

    Returns
    -------
    xarray.Dataset
        Along `step`, or `at` where times are given: `lower_y` and `upper_y` of every coordinate, velocity, state, energy and
        observable, and `time`, or `at_time`. Along `event`, in order: `lower_event_time` and `upper_event_time` of every
        zero that all motions pass, `event_detector`, `event_direction`, and `lower_event_y` and `upper_event_y`, which hold
        each motion at its own zero. The attribute `proven` is 1; `summary` says what was proven, `proven_until` up to which
        time. Where no further step can be proven, `outcome` is `not_proven`, `outcome_text` says why, and bounds at later
        times are nan; `events_text` says where a zero could not be told from none, as of a function that touches zero.

    Raises
    ------
    InputError
        If the model has what no bounds are proven of: impacts, forces in Python, tables of the motion; or a setting is wrong.

    Notes
    -----
    Every operation is rounded outward, and every step proves that the motions exist and are unique: Taylor polynomials whose
    remainder is taken over a box that no motion leaves (Corliss and Rihm 1996), their dependence on the start by their
    derivatives over the whole set (Lohner 1987), the set as the image of the starts and a box in a frame that turns with
    the flow (Mrozek and Zgliczynski 2000; Nedialkov, Jackson, Corliss 1999, doi:10.1016/S0096-3003(98)10083-8).

    An event acts where every motion is proven to pass it once, in an interval of times. By its end the set has grown by the
    length of the interval times the jump of the rates. Where it is not proven that all pass, as of a set of which some
    motions turn back before, where a function touches zero, or where two events may act in either order, the proof ends, and
    says why. Events of the same function act together.

    Examples
    --------
    >>> import xdynamics as xd
    >>> model = xd.Model.from_toml("data/models/harmonic_oscillator.toml")
    >>> tube = enclose(model, at=["1 s"])
    >>> bool(tube.lower_x[0] < tube.upper_x[0]), float(tube.upper_x[0] - tube.lower_x[0]) < 1e-13
    (True, True)
    """
    request = enclosure_request(
        model, until=until, at=at, rtol=rtol, order=order, max_steps=max_steps, parts=parts, occurrences=occurrences
    )
    return request.computed(progress) if compute else lazy_stage(request.stage())


@dataclass(frozen=True)
class EnclosureRequest:
    """What proven bounds are asked for.

    Attributes
    ----------
    model : Model
    end : float, s
    times : tuple of float, s, optional
    order : int
    tolerance : float
    max_steps : int
        Steps.
    parts : int
        Of the set of starts.
    occurrences : int, optional
    """

    model: Model
    end: float
    times: tuple[float, ...] | None
    order: int
    tolerance: float
    max_steps: int
    parts: int
    occurrences: int | None

    def computed(self, progress: Progress | None = None) -> xr.Dataset:
        """Prove."""
        flow = Flow(interval_problem_of(self.model), self.order, self.tolerance)
        tubes = [
            prove_tube(self.model, flow.with_starts(start), self.end, self.times, self.max_steps, progress)
            for start in split_box(flow.problem.start, self.parts)
        ]
        return enclosure_dataset(self.model, join_tubes(tubes), self.order, self.tolerance, self.occurrences)

    def task(self) -> Task:
        """Return the task that proves."""
        request_words = (self.end, self.times, self.order, self.tolerance, self.max_steps, self.parts, self.occurrences)
        return Task.of("enclosure", self.computed, (), self.model.digest, request_words)

    def stage(self) -> Stage:
        """Return the bounds before they are proven.

        Raises
        ------
        InputError
            If their number is not known, or no bounds are proven of the model.
        """
        interval_problem_of(self.model)
        if self.times is None:
            raise InputError(
                "how many steps a proof takes is not known in advance; give the times of bounds, like at=['1 s']"
            )
        tube = unproven(self.model, self.times)
        if tube.events and self.occurrences is None:
            raise InputError(
                f"how often '{tube.events[0].name}' is met is not known in advance; give the number to list, like occurrences=10"
            )
        template = enclosure_dataset(self.model, tube, self.order, self.tolerance, self.occurrences)
        return Stage(template, self.task(), (AT_TIME, MODEL))


def enclosure_request(
    model: Model,
    *,
    until: Any = None,
    at: Any = None,
    rtol: Any = None,
    order: Any = None,
    max_steps: Any = None,
    parts: Any = None,
    occurrences: Any = None,
) -> EnclosureRequest:
    """Read and check the arguments of `enclose`.

    Raises
    ------
    InputError
        If one is wrong.
    """
    check_model(model)
    tolerance = _checked_tolerance(rtol)
    degree, step_limit = _taylor_order(order, tolerance), _max_steps(max_steps)
    start, times = model.statement.initial["t"].si, None if at is None else _bound_times(at, model)
    end = _proof_end(until, times, model)
    for time in times or ():
        if not start <= time <= end:
            suffix = unit_suffix(model.time_unit)
            raise InputError(
                f"at has {time!r}{suffix}, and the enclosure goes from {start!r}{suffix} to {end!r}{suffix}"
            )
    count = _part_count(parts, has_times=times is not None)
    listed_count = requested_count(occurrences, "occurrences")
    return EnclosureRequest(
        model, end, None if times is None else tuple(times), degree, tolerance, step_limit, count, listed_count
    )


def _checked_tolerance(rtol: Any) -> float:
    tolerance = DEFAULT_RTOL if rtol is None else read_number(rtol, "rtol")
    if not LEAST_RTOL <= tolerance <= LARGEST_RTOL:
        raise InputError(f"rtol is {rtol!r}, needs a number from {LEAST_RTOL:g} to {LARGEST_RTOL:g}")
    return tolerance


def _taylor_order(order: Any, tolerance: float) -> int:
    if order is None:
        return int(np.ceil(1.0 - np.log(tolerance) / 2.0))
    if (
        isinstance(order, bool)
        or not read_number(order, "order").is_integer()
        or not LEAST_ORDER <= order <= MOST_ORDER
    ):
        raise InputError(f"order is {order!r}, needs a whole number from {LEAST_ORDER} to {MOST_ORDER}")
    return int(order)


def _max_steps(steps: Any) -> int:
    if steps is None:
        return MOST_STEPS
    if isinstance(steps, bool) or not read_number(steps, "max_steps").is_integer() or steps < 1:
        raise InputError(f"max_steps is {steps!r}, needs a positive whole number")
    return int(steps)


def _part_count(parts: Any, *, has_times: bool) -> int:
    if parts is None:
        return 1
    if isinstance(parts, bool) or not read_number(parts, "parts").is_integer() or not 1 <= parts <= MOST_PARTS:
        raise InputError(f"parts is {parts!r}, needs a whole number from 1 to {MOST_PARTS}")
    if parts > 1 and not has_times:
        raise InputError("parts are joined at times that all of them have; give them, like at=['1 s']")
    return int(parts)


def _bound_times(requested_times: Any, model: Model) -> list[float]:
    """Read times; each keeps the decimal digits that it was written with."""
    if isinstance(requested_times, str) and ":" not in requested_times:
        requested_times = requested_times.split(",")
    if (
        isinstance(requested_times, list | tuple)
        and requested_times
        and all(isinstance(time, str) for time in requested_times)
    ):
        return [time_in(model.time_unit, time, "at") for time in requested_times]
    return [float(time) for time in wanted_times(requested_times, model.time_unit)]


def _proof_end(until: Any, times: list[float] | None, model: Model) -> float:
    """Return up to which time to prove."""
    start = model.statement.initial["t"].si
    if until is None and not times:
        until = model.run.get("until")
    if until is None and not times:
        raise InputError(f"model '{model.name}' has no until in its [run]; give until=… or at=…")
    end = max(times or ()) if until is None else time_in(model.time_unit, until, "until")
    if not start < end < np.inf and not (until is None and end == start):
        suffix = unit_suffix(model.time_unit)
        raise InputError(f"until is {end!r}{suffix}, needs a finite time after the start, {start!r}{suffix}")
    return end

"""The settings of a march, checked before anything is computed.

Settings of event location, and of event functions that are zero at an instant, are given by name, and recorded by name.

Settings that do not go with numbers that are sums of two floats, or with delayed values, are refused with a remedy.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary import NAME, SETS
from xdynamics.elementary.bounds import EPS
from xdynamics.expressions import expand, free_names, text_of
from xdynamics.faults import InputError, numbered_lines
from xdynamics.kernels import Layout, layout_of
from xdynamics.keywords import FULL, STATES
from xdynamics.march.past import delay_times
from xdynamics.march.tolerances import ATOL_FLOORS, OF_TERMS, Tolerances, least_rtol
from xdynamics.methods import Method
from xdynamics.methods.scheme import (
    COMPENSATED,
    DOUBLE_DOUBLE,
    EMBEDDED,
    ESTIMATORS,
    FLOAT64,
    INTERPOLANT,
    NO_ESTIMATE,
    PLAIN,
    PRECISIONS,
    SUMMATIONS,
    Scheme,
    updates,
)
from xdynamics.methods.steppers import EXACT, JACOBIANS
from xdynamics.model import Model
from xdynamics.model.controllers import actions, alarms, exact_time, faults_of_ticks
from xdynamics.model.drive_arguments import CLOCK
from xdynamics.model.motion import drive_pieces
from xdynamics.model.parts import MOST_REACTIONS
from xdynamics.model.regime_model import regime_model
from xdynamics.model.switches import LOCATED, LOCATED_EVERYWHERE, SWITCHES
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.schema import ENERGIES, sample_name
from xdynamics.units import NONE, UNSCALED, Quantity, Scales, unit_suffix
from xdynamics.units.unit import exact_value

EARLIEST_FIRST, ON_HERMITE, ONE_BY_ONE = "earliest first", "earliest first by Hermite", "one by one"
_EARLIEST_FIRST = (
    "the earliest of a step first, by inverse cubic Hermite interpolation of its function's values and rates, else ITP"
    " bracketing (Oliveira, Takahashi 2021, doi:10.1145/3423597), on re-integrated substeps; the right end is accepted"
)
ROOT_METHODS = {  # how events are located, as described in a record; version 0.2 had only the last, what followed it the second
    EARLIEST_FIRST: f"{_EARLIEST_FIRST}; steps that leave a polynomial are searched by its bounds",
    ON_HERMITE: _EARLIEST_FIRST,
    ONE_BY_ONE: (
        "ITP bracketing (Oliveira, Takahashi 2021, doi:10.1145/3423597) on re-integrated substeps; the right end is"
        " accepted"
    ),
}
# What becomes of an acting event whose function is zero where the motion starts or another event acts: it is judged by
# where the motion takes it, or, as in archives that do not say so, waits until its function has left zero.
FILIPPOV, ENDS = "Filippov", "ends"  # what becomes of a motion that both sides drive back to a switch
SLIDINGS = (FILIPPOV, ENDS)
JUDGED, WAITING = "judged", "waiting"
EVENT_STARTS = (JUDGED, WAITING)


def precision_faults(settings: Any, model: Model) -> list[str]:
    """List settings that numbers of their precision do not support."""
    if settings.precision not in PRECISIONS:
        return [f"precision is {settings.precision!r}; there are {', '.join(map(repr, PRECISIONS))}"]
    if settings.precision != DOUBLE_DOUBLE:
        return _of_sums(settings, model)
    faults = [why for holds, why in _beyond_float64(settings, model) if holds]
    return [f"precision = 'double_double' does not go with {why}" for why in faults]


def _of_sums(settings: Any, model: Model) -> list[str]:
    """Refuse to carry rounding errors along where impulses of constraints are added to sums as they are made."""
    if settings.summation != COMPENSATED or not (model.constraints and settings.method.constrained_update):
        return []
    owner = f"constraints under '{settings.method.name}', whose impulses change what is summed"
    return [f"summation = 'compensated' does not go with {owner}; leave it out"]


def _beyond_float64(settings: Any, model: Model) -> list[tuple[bool, str]]:
    """Return requested features that use single floats, each with a remedy."""
    elements = model.elements
    on_interpolant = [name for name, event in elements.events.items() if event.root_state == INTERPOLANT]
    return [
        (
            bool(settings.method.solves),
            f"method '{settings.method.name}', whose equations are solved in float64; take an explicit one, such as dop853",
        ),
        (
            settings.estimator not in (EMBEDDED, NO_ESTIMATE),
            (
                f"estimator = {settings.estimator!r}, a difference of single floats; take a method with an embedded formula, such as"
                " dop853, or a fixed step"
            ),
        ),
        (
            settings.summation == COMPENSATED,
            "summation = 'compensated': a rest is carried of every number; leave it out",
        ),
        (settings.scales != UNSCALED, "scales, which are single floats; leave them out"),
        (
            bool(model.python_functions),
            (
                f"functions in Python ({', '.join(sorted({f.name for f in model.python_functions}))}), which return a float; write"
                " them as expressions"
            ),
        ),
        (
            bool(elements.contacts or model.frictions or model.assemblies),
            (
                "contacts and frictions, whose impacts and forces are solved in float64; write an impact as an event with"
                " action = 'reset'"
            ),
        ),
        (
            bool(model.constraints),
            f"constraints ({', '.join(elements.constraints)}), which are held to 1e-12; take float64",
        ),
        (
            bool(on_interpolant),
            (
                f"root_state = 'interpolant' of event '{''.join(on_interpolant[:1])}'; leave it out: the state at an event is then"
                " that of a shortened step"
            ),
        ),
        (
            settings.event_root_method != EARLIEST_FIRST,
            f"event_root_method = {settings.event_root_method!r}; leave it out",
        ),
    ]


def check_alone(model: Model, settings: Any = None) -> None:
    """Check a model and settings for many runs at once: delayed values are refused, as a past belongs to one run.

    Raises
    ------
    InputError
    """
    if model.delays:
        raise InputError(
            f"the model '{model.name}' has delayed values, and many runs at once have no past of their own; simulate them one"
            " by one: simulate(model.replace(parameters={…}), …)"
        )
    if settings is not None:
        settings.check(model)
        model.require_functions()


def delay_faults(settings: Any, model: Model) -> list[str]:
    """List settings that a march with delayed values does not support."""
    if not model.delays:
        return []
    second = unit_suffix(model.time_unit)
    try:
        times = delay_times(model)
    except InputError as error:
        return [f"delays: {error}"]
    faults = [
        f"delay '{text_of(tree)}' is {float(time)!r}{second}, needs a positive time"
        for tree, time in zip(model.delays, times, strict=True)
        if not (np.isfinite(time) and time > 0.0)
    ]
    if faults:
        return faults
    return [
        *_long_step_faults(settings, float(times.min()), second),
        *_interpolation_faults(settings),
        *_state_change_faults(settings, model),
        *_short_table_faults(model, times, second),
    ]


def _long_step_faults(settings: Any, shortest: float, second: str) -> list[str]:
    """Refuse given steps beyond the shortest delay: they would read values of the step itself."""
    given_steps = settings.step if isinstance(settings.step, tuple) else (settings.step or 0.0,)
    longest = max((step for step in given_steps if isinstance(step, float | int)), default=0.0)
    if not longest > shortest * (1.0 + 1e-12):
        return []
    return [
        f"step is {longest!r}{second}, longer than the shortest delay of {shortest!r}{second}; take a step of at most that"
    ]


def _interpolation_faults(settings: Any) -> list[str]:
    """Refuse estimators that raise the order of steps above that of their interpolant."""
    method, scheme = settings.method, settings.scheme
    if scheme.order > scheme.interpolant.order + 1:
        estimated = f" with estimator = '{settings.estimator}'" if scheme.steps > 1 else ""
        left = f"errors of h**{scheme.interpolant.order + 1}, which would be all that is left of it"
        remedy = "take dop853 or dormand_prince with their embedded formulas, or a method of order 4 at most"
        subject = f"method '{method.name}'{estimated} is of order {scheme.order}"
        return [f"{subject}, and delayed values are interpolated with {left}; {remedy}"]
    return []


def _short_table_faults(model: Model, times: NDArray[np.float64], second: str) -> list[str]:
    """Refuse tables of time that end at their beginning, and do not reach back by their delays."""
    elements = model.elements
    faults, start, tables = (
        [],
        model.statement.initial["t"].si,
        dict(zip(elements.looked_up_at, drive_pieces(model), strict=True)),
    )
    for call in model.statement.delayed:
        delayed_tree, delay = (expand(part, elements.definitions) for part in call.arguments)
        for name in sorted(free_names(delayed_tree) & {*elements.drives}):
            first, earliest_time = float(tables[name][0][0]), start - float(times[model.delays.index(delay)])
            if (
                elements.drives[name].outside == "error"
                and elements.looked_up_at[name] == CLOCK
                and first > earliest_time
            ):
                faults.append(
                    f"the table of drive '{name}' begins at t = {first!r}{second}, and is read from t = {earliest_time!r}{second} on, by"
                    f" its delay '{text_of(delay)}'; begin it there, or give it outside = 'hold'"
                )
    return faults


def _state_change_faults(settings: Any, model: Model) -> list[str]:
    """Refuse delayed values where states are changed after steps, or numbers are sums of two floats."""
    faults = []
    if model.constraints or model.bodies:
        owner = (
            f"constraint '{next(iter(model.elements.constraints))}'"
            if model.constraints
            else f"body '{next(iter(model.bodies))}'"
        )
        faults.append(
            f"delayed values do not go with {owner}, by which states are moved after steps; write coordinates that need none"
        )
    if model.assemblies:
        faults.append(
            f"delayed values do not go with contact '{next(iter(model.assemblies))}' of many links; write single contacts"
        )
    if settings.precision != FLOAT64:
        faults.append(f"delayed values do not go with precision = {settings.precision!r}; take '{FLOAT64}'")
    return faults


TIME_TOLERANCE = 1e-12  # s
MOST_APART = 2**53  # rows from one that is kept to the next
SAFETY, GROWTH_LIMITS, MOST_STEPS = 0.9, (0.2, 10.0), 1_000_000


def given_times(start: float, steps: tuple[float, ...], end: float) -> list[float]:
    """Return the times that steps lead to, in turn; a time that differs from the end only by rounding is the end."""
    times, t = [], start
    slack = 4 * EPS * len(steps) * max(abs(start), abs(end))
    for step in steps:
        t = t + step
        times.append(end if abs(t - end) <= slack else t)
    return times


@dataclass(frozen=True)
class Pacing:
    """Limits of step control.

    Attributes
    ----------
    safety : float
        Factor on the step that the error estimate would allow.
    growth_limits : tuple of float
        Least and greatest ratio of a step to the one before.
    min_step, max_step : float
        s; by default the longest step is the span.
    max_steps : int
        Accepted and rejected steps after which the run ends as `step_limit`.
    """

    safety: float = SAFETY
    growth_limits: tuple[float, float] = GROWTH_LIMITS
    min_step: float = 0.0
    max_step: float = float("inf")
    max_steps: int = MOST_STEPS

    def faults(self, second: str) -> list[str]:
        """List invalid settings; `second` is the unit text that follows a time."""
        faults = []
        lowest_ratio, highest_ratio = self.growth_limits
        if not 0 < self.safety < 1:
            faults.append(f"safety is {self.safety!r}, needs a number between 0 and 1")
        if not (0 < lowest_ratio < 1 < highest_ratio and isfinite(highest_ratio)):
            faults.append(f"growth_limits are {self.growth_limits!r}, need 0 < least < 1 < greatest")
        if not (isfinite(self.min_step) and self.min_step >= 0):
            faults.append(f"min_step is {self.min_step!r}{second}, needs a non-negative time")
        if not self.max_step > 0:
            faults.append(f"max_step is {self.max_step!r}{second}, needs a positive time")
        elif self.min_step > self.max_step:
            faults.append(
                f"min_step is {self.min_step!r}{second}, needs to be at most max_step = {self.max_step!r}{second}"
            )
        if self.max_steps < 1:
            faults.append(f"max_steps is {self.max_steps!r}, needs a positive number")
        return faults


@dataclass(frozen=True)
class Settings:
    """The settings of a march.

    Attributes
    ----------
    method : Method
    until : float
        End, s.
    step : float or tuple of float, optional
        Step of the fixed grid t0 + n h, or each step of a given one, s; with tolerances, the first step.
    tolerances : Tolerances, optional
        With them the steps are chosen, unless they are given one by one.
    pacing : Pacing
    estimator : str
        How the local error is estimated.
    samples : bool
        Whether every force evaluation of an accepted step is logged.
    scales : Scales
        Scales of the nondimensional variables of the march.
    jacobian : str
        How `radau_iia` gets the derivatives of the forces: exactly, or by differences.
    summation : str
        Whether the rounding error of the state is carried along.
    switches : str
        Whether switches hidden in forces are located, or stepped over.
    nodes : tuple of float
        Times to land on besides the breakpoints of drives, s, ascending.
    time_tolerance : float
        Time tolerance of events, impacts and switches without one of their own, s.
    math_functions : str
        The set of elementary functions.
    keep_every : int
        Rows of the grid from one that is recorded to the next one.
    log : str or tuple of str
        Which columns are recorded: all, those of the state, or those named.
    compress : bool
        Whether the archive is compressed.
    event_root_method : str
        How events are located, one of `ROOT_METHODS`.
    order_given : bool
        Whether the order of the method was asked for, and does not follow from the tolerance.
    precision : str
        Whether a number is one float or the sum of two, one of `PRECISIONS`.
    event_start : str
        What becomes of acting events whose functions are zero at the start or where another acts, one of `EVENT_STARTS`.
    atol_floor : str
        What tolerances that follow are never less than, one of `ATOL_FLOORS`.
    sliding : str
        What becomes of a motion that both sides drive back to a switch, one of `SLIDINGS`.
    """

    method: Method
    until: float
    step: float | tuple[float, ...] | None = None
    tolerances: Tolerances | None = None
    pacing: Pacing = field(default_factory=Pacing)
    estimator: str = NO_ESTIMATE
    samples: bool = True
    scales: Scales = UNSCALED
    jacobian: str = EXACT
    summation: str = PLAIN
    nodes: tuple[float, ...] = ()
    switches: str = LOCATED
    time_tolerance: float = TIME_TOLERANCE
    math_functions: str = NAME
    keep_every: int = 1
    log: str | tuple[str, ...] = FULL
    compress: bool = False
    event_root_method: str = EARLIEST_FIRST
    order_given: bool = False
    precision: str = FLOAT64
    event_start: str = JUDGED
    atol_floor: str = OF_TERMS
    sliding: str = FILIPPOV

    @property
    def partial(self) -> bool:
        """Whether rows or columns of the log are left out of the record."""
        return self.keep_every > 1 or self.log != FULL

    @property
    def keeps_states(self) -> bool:
        """Whether the record has the state of every row."""
        return self.keep_every == 1 and self.log in (FULL, STATES)

    @property
    def keeps_samples(self) -> bool:
        """Whether the record may have columns of force samples."""
        return self.log == FULL or (self.log != STATES and any(name.startswith(sample_name("")) for name in self.log))

    @property
    def energies(self) -> bool:
        """Whether the record has columns of energies."""
        return self.log == FULL or (self.log != STATES and any(name in ENERGIES for name in self.log))

    def located_within(self, requested_tolerance: Quantity | None) -> float:
        """Return a time tolerance, s: the requested one, or by default that of all events."""
        return self.time_tolerance if requested_tolerance is None else requested_tolerance.si

    @property
    def adaptive(self) -> bool:
        """Whether steps are chosen by the error test."""
        return self.tolerances is not None and not isinstance(self.step, tuple)

    @property
    def locates_one_by_one(self) -> bool:
        """Whether events are located one by one, each substep a rejected trial."""
        return self.event_root_method == ONE_BY_ONE

    @cached_property
    def scheme(self) -> Scheme:
        """The method with its estimator."""
        by_hermite = self.event_root_method != EARLIEST_FIRST
        return Scheme(
            self.method, self.estimator, self.jacobian, self.summation, self.math_functions, by_hermite, self.precision
        )

    def layout(self, model: Model) -> Layout:
        """Return the layout of the march's numbers."""
        return layout_of(regime_model(model, self.switches, self.sliding == FILIPPOV), self.scheme)

    def _word_faults(self) -> Iterator[str]:
        words = {
            "math_functions": SETS,
            "event_root_method": ROOT_METHODS,
            "event_start": EVENT_STARTS,
            "sliding": SLIDINGS,
            "atol_floor": ATOL_FLOORS,
        }
        for name, known in words.items():
            if (word := getattr(self, name)) not in known:
                yield f"{name} is {word!r}; there are {', '.join(map(repr, known))}"

    def check(self, model: Model) -> None:
        """Refuse settings that a march could not use.

        Raises
        ------
        InputError
            If settings are invalid; with every fault, its value and what is needed.
        """
        start, second = model.statement.initial["t"].si, unit_suffix(model.time_unit)
        faults = [
            *self._grid_faults(start, second),
            *self._estimator_faults(),
            *self._jacobian_faults(),
            *self._summation_faults(),
            *self._switches_faults(),
            *precision_faults(self, model),
            *delay_faults(self, model),
            *self._tick_faults(model, start, second),
            *self.pacing.faults(second),
            *self._word_faults(),
        ]
        if self.tolerances is not None:
            faults += self.tolerances.faults(model, least_rtol(self.precision)) or self._inner_faults(
                self.tolerances.rtol
            )
        if not 1 <= self.keep_every <= MOST_APART:
            faults.append(f"keep_every is {self.keep_every!r}, needs a whole number from 1, every row, to 2**53")
        if not (isfinite(self.time_tolerance) and self.time_tolerance > 0):
            faults.append(f"time_tolerance is {self.time_tolerance!r}{second}, needs a positive time")
        if self.pacing.min_step > self.until - start > 0:
            faults.append(
                f"min_step is {self.pacing.min_step!r}{second}, needs to be at most the span of"
                f" {self.until - start!r}{second}"
            )
        if not isfinite(self.until) or self.until <= start:
            faults.append(f"until is {self.until!r}{second}, needs a time after the start at t = {start!r}{second}")
        faults += [
            f"nodes has {node!r}{second}, needs times between the start at t = {start!r}{second} and until ="
            f" {self.until!r}{second}"
            for node in self.nodes
            if not start < node < self.until
        ]
        if self.scheme.estimates:
            faults += self.method.stepper.faults_of_estimates(model, self.method.name)
        faults += self._faults_of_scales(model)
        if len(faults) > 1:
            raise InputError(f"the run of '{model.name}' cannot be set up:{numbered_lines(faults)}", tuple(faults))
        if faults:
            raise InputError(faults[0], tuple(faults))

    def _tick_faults(self, model: Model, start: float, second: str) -> list[str]:
        acting = (*actions(model.elements.controllers), *alarms(model.elements.events))
        if not (acting and isfinite(self.until) and self.until > start):
            return []
        if model.assemblies:
            many = next(iter(model.assemblies))
            goes = f"contact '{many}' has many links, which do not go with {acting[0].owner}, which acts at times of its own"
            return [f"{goes}; write single contacts, {MOST_REACTIONS} forces at most"]
        return faults_of_ticks(acting, exact_time(model.statement.initial["t"]), exact_value(self.until), second)

    def _faults_of_scales(self, model: Model) -> list[str]:
        faults = []
        if self.scales.time != 1.0 and model.time_unit.dimension == NONE:
            faults.append(
                f"the scale of time is {self.scales.time!r} s, and the model's time is a pure number: leave it out"
            )
        if self.scales != UNSCALED and model.python_functions:
            faults.append("scales do not go with functions in Python, which are written in SI units")
        return faults

    def _grid_faults(self, start: float, second: str) -> list[str]:
        if self.step is None:
            return []
        if isinstance(self.step, tuple):
            bad = [step for step in self.step if not (isfinite(step) and step > 0)]
            if not self.step or bad:
                return [f"step has {f'{bad[0]!r}{second}' if bad else 'no entry'}, needs positive times"]
            last = given_times(start, self.step, self.until)[-1]
            if last < self.until:
                return [
                    (
                        f"step has {len(self.step)} steps up to t = {last!r}{second}, needs to reach until ="
                        f" {self.until!r}{second}"
                    )
                ]
            return []
        if not isfinite(self.step) or self.step <= 0:
            return [f"step is {self.step!r}{second}, needs a positive time"]
        if self.adaptive and not self.pacing.min_step <= self.step <= self.pacing.max_step:
            return [
                (
                    f"step, the first one, is {self.step!r}{second}, needs to be from min_step ="
                    f" {self.pacing.min_step!r}{second} to max_step = {self.pacing.max_step!r}{second}"
                )
            ]
        if not self.adaptive and isfinite(self.until) and (self.until - start) / self.step > 2**53:
            return [f"step {self.step!r}{second} makes over 2**53 steps to {self.until!r}{second}; take a longer one"]
        return []

    def _inner_faults(self, rtol: float) -> list[str]:
        """Refuse a relative tolerance that step control could not keep: that of a step would be below rounding."""
        used = self.scheme.effective_rtol(rtol) if self.estimator in ESTIMATORS else rtol
        if used >= least_rtol(self.precision):
            return []
        lowest_rtol = least_rtol(self.precision) ** (self.method.order / self.scheme.error_order)
        needed = f"rtol is {rtol!r}, for which a step of '{self.method.name}' would need {used:.3g}, less than rounding"
        return [f"{needed}; take {lowest_rtol:.2g} or more, step_doubling_extrapolated or a method of higher order"]

    def _jacobian_faults(self) -> list[str]:
        if self.jacobian not in JACOBIANS:
            return [f"jacobian is {self.jacobian!r}; there are {', '.join(JACOBIANS)}"]
        if self.jacobian not in self.method.stepper.jacobians:
            return [f"jacobian = 'differences' is for radau_iia, and the method is '{self.method.name}'"]
        return []

    def _summation_faults(self) -> list[str]:
        if self.summation not in SUMMATIONS:
            return [f"summation is {self.summation!r}; there are {', '.join(SUMMATIONS)}"]
        if self.summation == COMPENSATED and not updates(self.method):
            return [
                f"summation = 'compensated' is for methods that add to the state, and '{self.method.name}' does not"
            ]
        return []

    def _switches_faults(self) -> list[str]:
        names = ", ".join(f"'{name}'" for name in SWITCHES)
        return (
            []
            if self.switches in (*SWITCHES, LOCATED_EVERYWHERE)
            else [f"switches is {self.switches!r}; there are {names}"]
        )

    def _estimator_faults(self) -> list[str]:
        if self.estimator not in ESTIMATORS:
            return [f"estimator is {self.estimator!r}; there are {', '.join(ESTIMATORS)}"]
        if self.estimator == EMBEDDED and not self.method.estimate:
            return [f"method '{self.method.name}' has no embedded formula; take estimator = 'step_doubling'"]
        if self.adaptive and self.estimator == NO_ESTIMATE:
            return ["tolerances need an error estimate; take estimator = 'step_doubling'"]
        return []

"""Numerical errors of a number: truncation, rounding, interpolation, location of events.

Runs that met different events are different motions, neither better nor worse: the events met before the number are
compared first.

Rounding is measured by the twin of a run: the same steps with numbers of 31 digits, whose number differs by rounding
alone. It is also measured by time reversal: a symmetric method undoes its own steps, except for rounding.
"""

from __future__ import annotations

from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics.archive import digest_of_run
from xdynamics.budgeting.measurand import TIME, Measurand, Target
from xdynamics.budgeting.term import BOUNDED, COMPARED, NUMBER, NUMERICAL, RUN, ErrorSource, Term
from xdynamics.elementary.arrays import exp, power
from xdynamics.elementary.bounds import EPS
from xdynamics.evidence.diagnosing.extremes import Extreme
from xdynamics.evidence.diagnosing.summits import INTERPOLATED, SAID
from xdynamics.evidence.kept_results import ResultForm
from xdynamics.evidence.refining.convergence import (
    CAUTION,
    CLOSE,
    EVENT_LIMITED,
    INTERPOLATION_LIMITED,
    SAFETY,
    Judged,
    judge,
    observed_orders,
)
from xdynamics.evidence.refining.levels import ALL, Levels, absolute_tolerances
from xdynamics.evidence.refining.readings import estimated_error
from xdynamics.evidence.runs import march_model
from xdynamics.evidence.stage_tasks import Task, march_task
from xdynamics.faults import InputError, ModelError, first_names
from xdynamics.keywords import PACING
from xdynamics.march.configuration import settings_for
from xdynamics.march.tolerances import LEAST_RTOL
from xdynamics.methods import METHODS
from xdynamics.methods.scheme import DOUBLE_DOUBLE, NO_ESTIMATE, PLAIN, Scheme
from xdynamics.model import Model, Trait, traits_of
from xdynamics.model.parts import Function
from xdynamics.record.flag_words import words_of_flag
from xdynamics.record.unfolding import get_column
from xdynamics.schema import velocity
from xdynamics.shapes.naming import display_text
from xdynamics.units import NONE, Quantity

if TYPE_CHECKING:
    import xarray as xr

REMEDY = "they are different motions, and no distance between them tells how far the number is off"


class MetEvents(NamedTuple):
    """How many events a run met.

    Attributes
    ----------
    counts_before : dict of str to int
        By detector, before the time of the number.
    compared : int
        By all together, as far as other runs are compared with it: up to the time that was asked for, or, where the number
        is at an event or an extreme, in the whole run, since equal extremes may be at different times.
    """

    counts_before: dict[str, int]
    compared: int

    @classmethod
    def from_run(cls, target: Target, run: xr.Dataset, model: Model) -> MetEvents:
        """Count the events of a run that has the number."""
        if not run.sizes.get("event", 0):
            return cls({}, 0)
        is_earlier = run["event_time"].values < target.moment_in(run, model)
        counts = Counter(
            name for name, is_met in zip(words_of_flag(run["event_detector"]), is_earlier, strict=True) if is_met
        )
        return cls(dict(counts), int(is_earlier.sum()) if target.at is not None else len(is_earlier))

    def are_apart(self, second_run: MetEvents) -> bool:
        """Whether the number is behind different events, as `refine` tells it: by how many there were."""
        return (
            sum(self.counts_before.values()) != sum(second_run.counts_before.values())
            and self.compared != second_run.compared
        )

    def in_words(self, second_run: MetEvents) -> str:
        """Describe the events that were met unequally often.

        Examples
        --------
        >>> MetEvents({"floor": 3, "discs": 7}, 10).in_words(MetEvents({"floor": 3, "discs": 9}, 12))
        'did not meet the same events (discs 7 and 9 times): they are different motions, and no distance between them tells how far the number is off'
        """
        names = dict.fromkeys((*self.counts_before, *second_run.counts_before))
        counts = {name: (self.counts_before.get(name, 0), second_run.counts_before.get(name, 0)) for name in names}
        unequal_text = first_names(
            f"{display_text(name)} {count} and {second_count}"
            for name, (count, second_count) in counts.items()
            if count != second_count
        )
        return f"did not meet the same events ({unequal_text} times): {REMEDY}"


CHOOSING = ("rtol", "atol", "order", *PACING)  # settings by which steps are chosen, which the twin takes as they are


def twin_distance(run: xr.Dataset, measurand: Measurand, value: float) -> float | None:
    """March a run again with 31 digits by its own steps; return how far its number is from the twin's, in its unit.

    None where there is no twin, as of implicit methods, contacts and forces in Python, and for what is computed in
    floats in the twin too: energies, observables, forces, and extremes inside steps.
    """
    target = measurand.target
    if target.extreme is not None or target.quantity not in (*measurand.model.elements.units, TIME):
        return None
    twin_settings = _twin_settings(run, measurand)
    with suppress(InputError):  # what a twin cannot have; the settings of the run itself are in order
        settings_for(measurand.model, **twin_settings)
        twin = march_model(measurand.model, **{"force_samples": "none"} | twin_settings)
        return abs(value - target.in_run(twin, measurand.model)[0])
    return None


def _twin_settings(run: xr.Dataset, measurand: Measurand) -> dict[str, Any]:
    """Return the settings of the twin: the run's own, with steps that are given where they were chosen."""
    settings = settings_for(measurand.model, **measurand.settings)
    twin_settings = measurand.settings | {"precision": DOUBLE_DOUBLE, "summation": PLAIN, "estimator": NO_ESTIMATE}
    if not settings.adaptive:
        return twin_settings
    steps, end_time = run["step_size"].values[run["step_size"].values > 0.0], float(run["time"][-1])
    if end_time < settings.until:  # stopped by an event, which the twin may meet a little later
        steps = np.append(steps, [steps.max(), settings.until - end_time])
    fixed_settings = {name: value for name, value in twin_settings.items() if name not in CHOOSING}
    order = {"order": settings.method.order} if settings.method.has_orders else {}
    return fixed_settings | {"step": steps} | order


def reversal_distance(run: xr.Dataset, measurand: Measurand) -> float | None:
    """March a run back to its start; return how far a coordinate or velocity ends from it, in its unit.

    None for runs that are not reversible: another method, chosen or given steps, forces that depend on velocity or
    time, first-order states, events, contacts, friction; also for other quantities (Hairer, Lubich, Wanner, section
    V.1).
    """
    model, target = measurand.model, measurand.target
    velocities = {velocity(name) for name in model.elements.statement.coordinates}
    if (
        target.at is None
        or target.quantity not in {*model.elements.statement.coordinates, *velocities}
        or not _is_reversible(run, model)
    ):
        return None
    time, step = run["time"].values, float(run["step_size"][1]) if run.sizes["step"] > 1 else 0.0
    whole_steps = np.flatnonzero((time <= target.at) & np.isin(run["step_size"].values, [0.0, step]))
    if len(whole_steps) < 2:
        return None
    reversed_start = {
        name: f"{_reversed_value(run, name, int(whole_steps[-1]), velocities)!r} {get_column(run, name).attrs['units']}"
        for name in (*model.elements.statement.coordinates, *velocities)
    }
    until = {"until": float(time[whole_steps[-1]]), "force_samples": "none"}
    reversed_run = march_model(model.replace(initial=reversed_start), **measurand.settings | until)
    return abs(
        _reversed_value(reversed_run, target.quantity, -1, velocities) - float(get_column(run, target.quantity)[0])
    )


def _reversed_value(run: xr.Dataset, name: str, row: int, velocities: set[str]) -> float:
    value = float(get_column(run, name)[row])
    return -value if name in velocities else value


def _is_reversible(run: xr.Dataset, model: Model) -> bool:
    """Return whether equal steps with reversed velocities undo the steps of a run."""
    elements = model.elements
    irreversible_parts = (
        elements.statement.states,
        elements.events,
        elements.contacts,
        model.assemblies,
        elements.frictions,
        model.regimes,
    )
    if (
        any(irreversible_parts)
        or model.delays
        or not METHODS[run.attrs["solver_method"]].symmetric
        or run.sizes.get("event", 0)
    ):
        return False
    terms = [tree for components in elements.force_components.values() for tree in components.values()]
    trees = [*terms, *elements.statement.mass_entries.values()]
    reads_time = any("t" in elements.reads(tree) or isinstance(tree, Function) for tree in trees)
    is_fixed_step = run.attrs["solver_step_control"] == "fixed"
    return is_fixed_step and not reads_time and Trait.VELOCITY_DEPENDENT not in traits_of(model)


Floats = NDArray[np.float64]

TRUNCATION, ROUNDOFF, INTERPOLATION, LOCATION = "truncation", "roundoff", "interpolation", "event_location"
LEVELS = 4  # the run's own and three finer ones
STEP_RATIO, RTOL_RATIO = 2.0, 10.0  # from one level to the next
LEAST_RATIO = 2.0  # of tolerances; closer levels tell nothing
COPIES = 8  # of the run, to estimate rounding
TRUSTED = 2.0  # times the largest distance, since copies are few
TIGHTER = 10.0  # factor by which events are located better, to see the effect of their location


class Estimate(NamedTuple):
    """The number in one run.

    Attributes
    ----------
    value : float
    interpolation, location : float
        How far it may be off by interpolation, and by the location of an event.
    steps : int
        Accepted steps of the run.
    digest : str
        Content digest of the run.
    estimated : float
        What its steps estimate to be off together, as a part of the size of the number.
    events : MetEvents
        Those before the number.
    """

    value: float
    interpolation: float
    location: float
    steps: int
    digest: str
    estimated: float = 0.0
    events: MetEvents = MetEvents({}, 0)

    @classmethod
    def from_run(cls, measurand: Measurand, run: xr.Dataset) -> Estimate:
        """Evaluate the number in a run, with its interpolation and location errors.

        Raises
        ------
        InputError
            If the run does not have it.
        """
        target, model = measurand.target, measurand.model
        value, interpolation, location = target.in_run(run, model)
        steps, events = int(run.attrs["run_accepted_steps"]), MetEvents.from_run(target, run, model)
        return cls(value, interpolation, location, steps, digest_of_run(run), estimated_error(run), events)


ESTIMATES = ResultForm(list, lambda entries: Estimate(*entries[:-1])._replace(events=MetEvents(*entries[-1])))
NOT_MARCHED = Estimate(np.nan, np.nan, np.nan, 0, "")  # before a run is marched


@dataclass(frozen=True)
class LevelComparison:
    """The number in the run and in finer levels of it.

    Attributes
    ----------
    levels : Levels
        The run's own step or tolerance, and finer ones.
    values : ndarray, shape (n,)
        The number in each level.
    judgement : Judged
        Of the levels together.
    digests : tuple of str
        Content digests of the runs.
    unequal_events : str
        Which events the two finest levels met unequally often before the number; empty where they met the same.
    """

    levels: Levels
    values: Floats
    judgement: Judged
    digests: tuple[str, ...]
    unequal_events: str = ""

    @classmethod
    def from_estimates(cls, levels: Levels, *estimates: Estimate) -> LevelComparison:
        """Compare the number in all levels."""
        values = np.array([estimate.value for estimate in estimates])
        coarser, finest = (estimate.events for estimate in estimates[-2:])
        unequal_events = coarser.in_words(finest) if coarser.are_apart(finest) else ""
        is_restrained = levels.are_restrained([estimate.steps for estimate in estimates])
        judgement = judge(
            values,
            levels.values,
            levels.formal,
            _rounding_noise(values),
            0.0,
            np.inf if unequal_events else max(estimate.interpolation + estimate.location for estimate in estimates),
            smooth=levels.varied.keyword == "steps",
            accepted=estimates[-1].steps,
            order=levels.order,
            estimated=estimates[-1].estimated * float(np.max(np.abs(values))) if is_restrained else 0.0,
        )
        if (
            judgement.verdict == EVENT_LIMITED
            and not unequal_events
            and all(e.interpolation >= e.location for e in estimates)
        ):
            judgement = replace(judgement, verdict=INTERPOLATION_LIMITED)  # what is more than the other is named
        return cls(levels, values, judgement, tuple(estimate.digest for estimate in estimates), unequal_events)

    @classmethod
    def blank(cls, levels: Levels) -> LevelComparison:
        """Return the comparison of levels before these are marched, with nan for their numbers."""
        return cls(levels, np.full(LEVELS, np.nan), Judged(0, np.nan, np.nan, ""), ("",) * LEVELS)


def _rounding_noise(values: Floats) -> float:
    return 4.0 * EPS * float(np.abs(values).max())


def numerical_sources(measurand: Measurand) -> list[ErrorSource]:
    """Return the errors of the march itself: truncation, rounding, interpolation, location of events."""
    return [
        ErrorSource.of_one(TRUNCATION, NUMERICAL, (COMPARED,), _truncation_term),
        rounding_source(measurand),
        ErrorSource.of_one(INTERPOLATION, NUMERICAL, (RUN, NUMBER), partial(_interpolation_term, measurand)),
        ErrorSource.of_one(LOCATION, NUMERICAL, (RUN, NUMBER), partial(_location_term, measurand)),
    ]


def rounding_source(measurand: Measurand) -> ErrorSource:
    """Return the error of rounding."""
    return ErrorSource.of_one(ROUNDOFF, NUMERICAL, (RUN, NUMBER), partial(_roundoff_term, measurand), measurand.seed)


def _interpolation_term(measurand: Measurand, run: xr.Dataset, number: Estimate) -> Term:
    """Return the term of interpolation inside a step."""
    rule = _inner_rule(measurand.target.extreme_in(run, measurand.model))
    return Term.bounded(INTERPOLATION, NUMERICAL, number.interpolation, rule)


def _inner_rule(extreme: Extreme | None) -> str:
    """Describe how a number inside a step was computed, and how its error is estimated."""
    step_rule = "a shortened step against two of half its length, extrapolated"
    if extreme is None:
        return step_rule
    if extreme.rule == INTERPOLATED:
        return f"{SAID[extreme.rule]}: {step_rule}"
    return (
        f"{SAID[extreme.rule]}; none between is beyond it"
        if not extreme.uncertainty
        else f"{SAID[extreme.rule]}: the parabola through it and its neighbours"
    )


def march_own_run(model: Model, settings: dict[str, Any]) -> xr.Dataset:
    """March the run of a number; force samples are recorded only if the settings ask for them."""
    return march_model(model, **{"force_samples": "none"} | settings)


def run_task(measurand: Measurand) -> Task:
    """Return the task that marches the run that a number is of."""
    return march_task(measurand.model, **{"force_samples": "none"} | measurand.settings)


def number_task(measurand: Measurand, run: Task) -> Task:
    """Return the task that takes the number out of a run."""
    task = Task.of("number", partial(Estimate.from_run, measurand.unkept), (run,), *measurand.inputs)
    return task if measurand.keep is None else measurand.keep.task(task, ESTIMATES)


def levels_task(measurand: Measurand, number: Task, levels: Levels) -> Task:
    """Return the task that compares the number in the run with that in finer levels."""
    finer_tasks = (number_task(measurand, levels.task(k)) for k in range(1, LEVELS))
    return Task.of("levels", partial(LevelComparison.from_estimates, levels), (number, *finer_tasks), *measurand.inputs)


def levels_of(measurand: Measurand) -> Levels:
    """Return levels: the run's own step or tolerance, and finer ones.

    Raises
    ------
    InputError
        If the steps are given one by one, or the tolerance is too small for three smaller ones.
    """
    model, settings = measurand.model, settings_for(measurand.model, **measurand.settings)
    other_settings = {name: value for name, value in measurand.settings.items() if name not in ("step", "rtol")}
    if not settings.adaptive:
        if not isinstance(settings.step, float):
            raise InputError(
                "a budget needs a step or a tolerance that can be made finer; these steps are given one by one"
            )
        steps = [settings.step / STEP_RATIO**k for k in range(LEVELS)]
        return Levels.of(model, _levels_by("steps", steps), other_settings, fewest=LEVELS)
    assert settings.tolerances is not None  # noqa: S101
    rtol = settings.tolerances.rtol
    ratio = min(RTOL_RATIO, (rtol / _least_rtol(settings.scheme)) ** (1.0 / (LEVELS - 1)))
    if ratio < LEAST_RATIO:
        raise InputError(
            f"rtol is {rtol!r}, and a budget needs three tolerances under it that differ; give a larger one, or a step"
        )
    return Levels.of(
        model, _levels_by("rtols", [rtol / ratio**k for k in range(LEVELS)]), other_settings, fewest=LEVELS
    )


def _levels_by(keyword: str, values: list[float]) -> dict[str, Any]:
    return dict.fromkeys((varied.keyword for varied in ALL), None) | {keyword: values}


def _least_rtol(scheme: Scheme) -> float:
    """Return the smallest tolerance that step control can meet."""
    return 2.0 * float(LEAST_RTOL ** (scheme.method.order / scheme.error_order))


def _truncation_term(compared: LevelComparison) -> Term:
    """Return the truncation term: the finest value's distance with an allowance, plus its uncertainty."""
    levels, values = compared.levels, compared.values
    if compared.unequal_events:
        finest = " and ".join(f"{size:.4g}" for size in levels.values[-2:])
        return Term.unknown(
            TRUNCATION, NUMERICAL, f"the runs with {levels.varied.name} {finest} {compared.unequal_events}"
        )
    factor = allowance(values, levels.values, levels.formal, _rounding_noise(values))
    bound = factor * abs(float(values[0] - values[-1])) + float(compared.judgement.uncertainty)
    sizes = ", ".join(f"{size:.4g}" for size in levels.values)
    rule = f"{levels.varied.name} {sizes}: {factor:.3g} times the finest value's distance, and its uncertainty"
    return Term.bounded(TRUNCATION, NUMERICAL, bound, rule)


def allowance(values: Floats, steps: Floats, formal: float, noise: float) -> float:
    """Return the safety factor for the distance of the coarsest value from the finest.

    It is the safety factor of the grid convergence index: 1.25 for three levels or more in the asymptotic range, 3 for
    two (Roache 1994, doi:10.1115/1.2910291). In between it grows with the spread of the orders of triples of levels: an
    order uncertain by d leaves the error of a level uncertain by the ratio of the steps to the power d.

    Parameters
    ----------
    values, steps : ndarray, shape (n,)
        From coarse to fine.
    formal : float
        The order of the method in the steps.
    noise : float
        Rounding error of the values: levels that differ by no more have no observed order.

    Examples
    --------
    >>> h = np.array([0.4, 0.2, 0.1, 0.05])
    >>> round(allowance(1.0 + h**2, h, 2.0, 1e-15), 12), allowance(1.0 + 1e-9 * h**2, h, 2.0, 1e-9)
    (1.25, 3.0)
    """
    distances = np.abs(np.diff(values))
    orders = observed_orders(values, steps)[1:-1]
    resolved_orders = orders[(distances[:-1] > noise) & (distances[1:] > noise) & np.isfinite(orders)]
    if not resolved_orders.size:
        return CAUTION
    spread = float(np.ptp(resolved_orders)) if resolved_orders.size > 1 else abs(float(resolved_orders[0]) - formal)
    return min(CAUTION, SAFETY * float(power(steps[0] / steps[1], max(spread - CLOSE, 0.0))))


def _roundoff_term(measurand: Measurand, run: xr.Dataset, number: Estimate) -> Term:
    """Return the term of rounding: how far the twin with 31 digits is or, where there is none, how far copies are."""
    value = number.value
    spacing = EPS * abs(value) / 2.0
    if settings_for(measurand.model, **measurand.settings).precision == DOUBLE_DOUBLE:
        rule = "the run has 31 digits: what is left is the spacing of floats, in which the value is given"
        return Term.bounded(ROUNDOFF, NUMERICAL, spacing, rule)
    if (distance := twin_distance(run, measurand, value)) is None:
        return _spread_of_copies(measurand, run, value)
    rule = (
        f"measured: the same run with 31 digits, by the same steps, is {distance:.2g} away; and half the spacing of"
        " floats"
    )
    return Term(ROUNDOFF, NUMERICAL, float(np.hypot(distance, spacing / BOUNDED)), distance + spacing, rule)


def _spread_of_copies(measurand: Measurand, run: xr.Dataset, value: float) -> Term:
    """Return the term of rounding from copies in which every operation is rounded differently, and by marching back.

    Copies are marched in random units, with parameters and starts moved by one spacing of numbers, as reading them may
    have done; so differences within an observable are rounded differently too. Only reversible runs are marched back.
    """
    model, spacing = measurand.model, EPS * abs(value) / 2.0
    rng, deviations = np.random.default_rng(measurand.seed), []
    tolerances = absolute_tolerances(model, measurand.settings)
    in_units = not model.python_functions
    for length, time, mass in exp(rng.uniform(-0.5, 0.5, (COPIES, 3))).tolist():
        scales = {"length": f"{length!r} m", "time": f"{time!r} s", "mass": f"{mass!r} kg"} if in_units else None
        if scales and model.time_unit.dimension == NONE:
            del scales["time"]
        deviations.append(value - measurand.number(_nudged(model, rng), **tolerances, scales=scales))
    distance_back = reversal_distance(run, measurand)
    standard = float(np.sqrt(np.mean(np.square(deviations)) + spacing**2 / 3.0))
    bound = TRUSTED * float(np.abs(deviations).max()) + spacing
    units_text = "in units drawn at random" if in_units else "in SI units, which forces in Python know alone"
    rule = f"{COPIES} copies {units_text}, from numbers a spacing beside: every operation is rounded in another way"
    if distance_back is not None:
        rule += f"; marched back by its own steps the run comes to {distance_back:.2g} of its start"
        standard, bound = max(standard, distance_back / BOUNDED), max(bound, distance_back)
    # the standard deviation of n normal numbers about a known mean is uncertain by 1/sqrt(2 n) of it
    return Term(ROUNDOFF, NUMERICAL, standard, bound, rule, standard_doubt=standard / float(np.sqrt(2.0 * COPIES)))


def _nudged(model: Model, rng: np.random.Generator) -> Model:
    """Return a model with numbers randomly one spacing smaller; the model itself if it tolerates no change."""
    numbers = {
        "parameters": {name: entry.quantity for name, entry in model.elements.statement.parameters.items()},
        "initial": dict(model.elements.statement.initial),
    }
    nudged_numbers = {
        section: {
            name: str(Quantity(entry.value * (1.0 - EPS * int(rng.integers(2))), entry.unit))
            for name, entry in entries.items()
        }
        for section, entries in numbers.items()
        if entries
    }
    try:
        return model.replace(**nudged_numbers)
    except ModelError:
        return model


def _location_term(measurand: Measurand, run: xr.Dataset, number: Estimate) -> Term:
    """Return the term of locating events: the one that the number is taken at, and those before it."""
    if not run.sizes.get("event", 0):
        return Term.bounded(LOCATION, NUMERICAL, 0.0, "no event was met")
    tolerance = settings_for(measurand.model, **measurand.settings).time_tolerance / TIGHTER
    tighter_run = _march_tighter(measurand.model, measurand.settings | {"time_tolerance": tolerance})
    location_shift = 0.0
    if tighter_run is not None:
        events = MetEvents.from_run(measurand.target, tighter_run, measurand.model)
        if number.events.are_apart(events):
            rule = f"the run and one with events located {TIGHTER:g} times as well {number.events.in_words(events)}"
            return Term.unknown(LOCATION, NUMERICAL, rule)
        location_shift = abs(number.value - measurand.target.in_run(tighter_run, measurand.model)[0])
    rule = f"its own uncertainty, and events located {TIGHTER:g} times as well"
    return Term.bounded(LOCATION, NUMERICAL, number.location + location_shift, rule)


def _march_tighter(model: Model, settings: dict[str, Any]) -> xr.Dataset | None:
    try:
        return march_model(model, **settings)
    except InputError:
        return None

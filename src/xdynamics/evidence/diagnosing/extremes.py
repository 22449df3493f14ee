"""The largest and the least value of a quantity over a run: sampled, interpolated, or located by an event."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.dynamics.path import steps_over_impacts
from xdynamics.dynamics.shortened_steps import StepInterpolator, sample_in_steps
from xdynamics.evidence.chunks import Chunks, with_roles
from xdynamics.evidence.diagnosing.summits import (
    INTERPOLATED,
    RULES,
    ElementExtremes,
    Heights,
    QuantitiesInside,
    StatesInside,
    Summits,
    consecutive_slices,
    variable_numbers,
)
from xdynamics.evidence.evidence_dataset import attrs_of
from xdynamics.evidence.observables import knows_state_rates, state_rates
from xdynamics.evidence.observed_quantities import widest
from xdynamics.kernels.layout import layout_of
from xdynamics.methods.scheme import REINTEGRATE
from xdynamics.model import Model
from xdynamics.reaction_names import contact_force, friction_force
from xdynamics.record.folding import model_dimensions
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.units import parse_unit

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
Functions = Mapping[str, Callable[..., float]]
Rows = NDArray[np.int64]

SOUGHT = (
    *schema.INTEGRATED,
    "energy",
    "observable",
    "force",
    "reaction",
    "joint",
)  # roles of what has its extremes sought
RULE_SAID = "where the extreme was found: at an accepted state, between two of them, or at a located event"
DOUBT_SAID = "error of {} by interpolation between accepted states; the error of the integration is not included"
MOST_NAMES = 200  # quantities, above which extremes of forces and observables are not sought
MOST_NUMBERS = 1 << 24  # of states inside steps of a model with dimensions, above which accepted ones alone are used


class Extreme(NamedTuple):
    """One extreme value.

    Attributes
    ----------
    value : float
        In the unit of the record.
    time : float, s
    rule : int
        Index into `RULES`: an accepted state, a state between accepted ones, or the state at an event.
    uncertainty : float
        Of the value, from interpolation alone: 0 for an accepted state that is known to be the largest.
    """

    value: float
    time: float
    rule: int
    uncertainty: float


def find_extreme(run: xr.Dataset | Chunks, name: str, sign: float, functions: Functions | None) -> Extreme:
    """Find the largest value of a quantity, or with a sign of -1 the least; see `find_extremes`."""
    values, times, rules, uncertainties = find_extremes(run, [(name, sign)], functions)[0]
    return Extreme(float(values[0]), float(times[0]), int(rules[0]), float(uncertainties[0]))


def find_extremes(
    run: xr.Dataset | Chunks, signed_names: Sequence[tuple[str, float]], functions: Functions | None
) -> list[ElementExtremes]:
    """Find the largest values of quantities, or with a sign of -1 the least: of those with dimensions of every element.

    A state at an event that is above all others is taken as it is. Otherwise the steps to and from each row that is not
    lower than its neighbours are searched for a zero of the quantity's rate, by steps of the run's own method to states
    between, on which forces, contact forces, energies and observables are evaluated; see `summits`. If a force is
    written in Python, only accepted states are used, except for states that steps integrate: the uncertainty is then
    how far the parabola through the largest value and its neighbours rises above it.

    Of models with dimensions these are used too where the states between, with all links and elements of each, have more than
    16 million numbers; the uncertainty is then no less than how far tangents at accepted states meet above them.

    Of quantities with dimensions the rates have to be known from states alone; see `knows_state_rates`.
    """
    rows = Chunks.of(run, functions)
    all_heights = [
        Heights.of(name, sign, int(np.prod(rows.run.variables[name].shape[1:]))) for name, sign in signed_names
    ]
    for part in rows.parts("time", "row_kind", *dict.fromkeys(name for name, _ in signed_names)):
        for heights in all_heights:
            heights.rise(part)
    near, places = rows.nearby_record(np.concatenate([heights.rows.ravel() for heights in all_heights]))
    evaluator: _ByTrees | _ByQuantities = (
        _ByQuantities(rows, near, all_heights) if model_dimensions(rows.run) else _ByTrees(rows, near, all_heights)
    )
    searches, interpolator = evaluator.searches(places), None
    while True:
        times = [search.places() for search in searches]
        state_count = sum(item.size for item in times)
        if not state_count:
            break
        if interpolator is None and rows.model.shapes.dims and takes_too_much(state_count, rows):
            return [_accepted_extremes(*pair) for pair in zip(all_heights, searches, strict=True)]
        interpolator = interpolator or StepInterpolator.of_run(near, functions, REINTEGRATE)
        states = interpolator.states_at(np.concatenate(times), after_event=False)
        evaluator.narrow(searches, states, [item.size for item in times])
    best_extremes = [
        _better_extremes(heights, search, searched=evaluator.is_searched(heights))
        for heights, search in zip(all_heights, searches, strict=True)
    ]
    members = [np.flatnonzero(result.rules == INTERPOLATED) for result in best_extremes]
    times = [result.times[between] for result, between in zip(best_extremes, members, strict=True)]
    if interpolator is not None and any(item.size for item in times):
        states = interpolator.states_at(np.concatenate(times), after_event=False)
        errors = evaluator.errors(states, members)
        for result, between, error in zip(best_extremes, members, errors, strict=True):
            result.uncertainties[between] = error
    return best_extremes


@dataclass(frozen=True)
class _ByTrees:
    """Evaluates quantities without dimensions by their expressions: forces, contact forces, energies and observables too."""

    rows: Chunks
    near: xr.Dataset
    all_heights: Sequence[Heights]

    @cached_property
    def quantities(self) -> QuantitiesInside:
        """What is evaluated at states inside steps."""
        names = [heights.name for heights in self.all_heights]
        return QuantitiesInside(self.near, self.rows.model, names, [_si_factor(self.rows.run, name) for name in names])

    def searches(self, places: Rows) -> list[Summits]:
        """Begin the searches of the steps around each hump, whose rows are at these places."""
        model, sizes = self.rows.model, [heights.rows.size for heights in self.all_heights]
        states = {variable: variable_numbers(self.near, variable)[places] for variable in model.elements.units}
        times = np.concatenate([heights.times.ravel() for heights in self.all_heights])
        unknown = [np.zeros(0)] * len(self.all_heights)
        inside = StatesInside(states, {}, times, places, consecutive_slices(sizes))
        rates = self.quantities.rates(inside, unknown)
        return [self._search(heights, rate) for heights, rate in zip(self.all_heights, rates, strict=True)]

    def is_searched(self, heights: Heights) -> bool:
        """Whether a quantity can be evaluated between rows: what steps integrate, and else what states alone give."""
        model = self.rows.model
        is_integrated = self.rows.run.variables[heights.name].attrs["role"] in schema.INTEGRATED
        return is_integrated or not (model.python_functions or model.delays)

    def _search(self, heights: Heights, rates: Floats) -> Summits:
        """Begin the search around the humps of a quantity; around none where it is not searched."""
        if not self.is_searched(heights):
            return heights.without_humps().search(None)
        return heights.search(rates.reshape(heights.values.shape) if rates.size else None)

    def narrow(self, searches: Sequence[Summits], states: xr.Dataset, sizes: Sequence[int]) -> None:
        """Continue each search with what is evaluated at its states."""
        inside = StatesInside.from_dataset(self.rows.model, states, sizes)
        values = self.quantities.values(inside, inside.variables)
        for search, value, rate in zip(searches, values, self.quantities.rates(inside, values), strict=True):
            if value.size:
                search.narrow(value, rate)

    def errors(self, states: xr.Dataset, members: Sequence[Rows]) -> list[Floats]:
        """Return the errors by interpolation of each at its states."""
        inside = StatesInside.from_dataset(self.rows.model, states, [item.size for item in members])
        return self.quantities.errors(inside, self.quantities.values(inside, inside.variables))


@dataclass(frozen=True)
class _ByQuantities:
    """Evaluates quantities that steps integrate, all elements side by side, and their rates from states alone."""

    rows: Chunks
    near: xr.Dataset
    all_heights: Sequence[Heights]

    def searches(self, places: Rows) -> list[Summits]:
        """Begin the searches of the steps around each hump of each element, whose rows are at these places."""
        distinct, inverse = np.unique(places, return_inverse=True)
        values_by_name = {
            heights.name: variable_numbers(self.near, heights.name)[distinct] for heights in self.all_heights
        }
        rates = self._rates(values_by_name, variable_numbers(self.near, "time")[distinct], distinct)
        parts = consecutive_slices([heights.rows.size for heights in self.all_heights])
        return [
            heights.search(rates[heights.name][heights.members, inverse[part].reshape(3, -1)])
            for heights, part in zip(self.all_heights, parts, strict=True)
        ]

    def is_searched(self, heights: Heights) -> bool:  # noqa: ARG002 - as of what expressions evaluate
        """Whether a quantity can be evaluated between rows."""
        return True

    def narrow(self, searches: Sequence[Summits], states: xr.Dataset, sizes: Sequence[int]) -> None:
        """Continue each search with what its elements are at its states."""
        blocks = layout_of(self.rows.model).used.blocks
        values_by_name = {block.name: variable_numbers(states, block.name) for block in blocks}
        rates = self._rates(values_by_name, variable_numbers(states, schema.AT_TIME), variable_numbers(states, "row"))
        for heights, search, part in zip(self.all_heights, searches, consecutive_slices(sizes), strict=True):
            if part.start < part.stop:
                members = search.place_members
                values = values_by_name[heights.name][part].reshape(members.size, search.best.size)
                rate = rates[heights.name][members, np.arange(part.start, part.stop)]
                search.narrow(values[np.arange(members.size), members], rate)

    def errors(self, states: xr.Dataset, members: Sequence[Rows]) -> list[Floats]:
        """Return the errors by interpolation of some elements, each at its state."""
        errors = []
        parts = consecutive_slices([item.size for item in members])
        for heights, between, part in zip(self.all_heights, members, parts, strict=True):
            numbers = variable_numbers(states, schema.error(heights.name))[part]
            of_elements = numbers.reshape(between.size, heights.best.size)
            errors.append(np.abs(of_elements[np.arange(between.size), between]))
        return errors

    def _rates(self, values_by_name: dict[str, Floats], times: Floats, numbers: Rows) -> dict[str, Floats]:
        """Return the rates of quantities at states, shape (elements, k), in recorded units."""
        rates = state_rates(self.near, self.rows.model, values_by_name, times, numbers)
        assert rates is not None  # noqa: S101 - asked before
        return {name: values / _si_factor(self.rows.run, name) for name, values in rates.items()}


def takes_too_much(states: int, rows: Chunks) -> bool:
    """Whether states inside steps are too many to compute: their values, their errors and all links, or impulses anew."""
    if rows.model.assemblies and steps_over_impacts(rows.run, rows.model):
        return True
    return states * (2 * len(rows.model.elements.units) + widest(rows.model)) > MOST_NUMBERS


def _accepted_extremes(heights: Heights, search: Summits) -> ElementExtremes:
    """Return the best accepted states, and how far parabolas and tangents exceed them."""
    best, above = heights.accepted(), search.open_heights
    return best._replace(uncertainties=np.where(above > best.uncertainties, above, best.uncertainties))


def _better_extremes(heights: Heights, search: Summits, *, searched: bool) -> ElementExtremes:
    """Return the results of the search where they are better than the best accepted states, which are returned elsewhere.

    Between the rows of what is not searched nothing is known: a parabola through the best may exceed it.
    """
    best, sign = heights.accepted(), heights.sign
    better = sign * search.best > sign * best.values
    return ElementExtremes(
        np.where(better, search.best, best.values),
        np.where(better, search.when, best.times),
        np.where(better, INTERPOLATED, best.rules),
        np.zeros(better.size) if searched else np.where(better, 0.0, best.uncertainties),
    )


def _si_factor(run: xr.Dataset, name: str) -> float:
    return float(parse_unit(str(run.variables[name].attrs["units"])).factor)


def values_between_rows(
    run: xr.Dataset, model: Model, name: str, times: Floats, functions: Functions | None
) -> tuple[Floats, Floats]:
    """Return a quantity at times inside steps, and its error by the interpolation of the state, shape (times,)."""
    states = StatesInside.from_dataset(
        model, sample_in_steps(run, times, after_event=False, rule=REINTEGRATE, functions=functions), [times.size]
    )
    quantity = QuantitiesInside(run, model, [name], [_si_factor(run, name)])
    values = quantity.values(states, states.variables)
    return values[0], quantity.errors(states, values)[0]


def sought_names(run: xr.Dataset, model: Model) -> list[str]:
    """Name the quantities whose extremes are sought; in large models only those that steps integrate, and no iterated forces."""
    by_iteration = tuple(name(contact) for contact in model.assemblies for name in (contact_force, friction_force))
    roles_by_name = {
        str(name): variable.attrs.get("role")
        for name in run.data_vars
        if (variable := run.variables[name]).dims == (schema.STEPS,)
    }
    names = [name for name, role in roles_by_name.items() if role in SOUGHT and not name.startswith(by_iteration)]
    return names if len(names) <= MOST_NAMES else [name for name in names if roles_by_name[name] in schema.INTEGRATED]


def extremes_of(rows: Chunks, names: Sequence[str], functions: Functions | None) -> dict[str, tuple[Any, ...]]:
    """Return the largest and the least value of quantities as variables of a Dataset."""
    variables: dict[str, tuple[Any, ...]] = {}
    signed_names = [(name, sign) for name in names for sign in (1.0, -1.0)]
    for (name, sign), result in zip(signed_names, find_extremes(rows, signed_names, functions), strict=True):
        variables |= extreme_variables(rows.run, name, sign, result)
    return variables


def extreme_variables(
    run: xr.Dataset, name: str, sign: float, result: tuple[Any, Any, Any, Any]
) -> dict[str, tuple[Any, ...]]:
    """Return an extreme as variables of a Dataset, along the dimensions of its quantity."""
    variable = run.variables[name]
    dims, shape, units = variable.dims[1:], variable.shape[1:], str(variable.attrs["units"])
    word, adjective = ("maximum", "largest") if sign > 0 else ("minimum", "least")
    extreme_name, time_unit = f"{word}_{name}", str(run.variables["time"].attrs["units"])
    numbers = [np.reshape(number, shape) for number in result]
    of_rule = attrs_of("1", RULE_SAID, "flag") | schema.flag_attributes(dict(enumerate(RULES)))
    described = {
        "": attrs_of(units, f"{adjective} {name} of the run", "diagnostic"),
        "_time": attrs_of(time_unit, f"when {name} was {adjective}", "diagnostic"),
        "_rule": of_rule,
        "_uncertainty": attrs_of(units, DOUBT_SAID.format(extreme_name), "error"),
    }
    patterns = {end: {schema.ELEMENT_NAME: f"{extreme_name}{{}}{end}"} if shape and end else {} for end in described}
    numbers[2] = numbers[2].astype(np.int8)
    return {
        f"{extreme_name}{end}": (dims, number, attributes | patterns[end])
        for (end, attributes), number in zip(described.items(), numbers, strict=True)
    }


def has_many_elements(run: xr.Dataset, model: Model) -> bool:
    """Whether a record of quantities has so many elements that extremes are sought of those alone that steps integrate.

    Of others elements are told apart: each force and observable is then evaluated where it is largest. So it is where
    rates are not known from states alone.
    """
    if not model_dimensions(run):
        return False
    elements = sum(int(np.prod(run.variables[name].shape[1:])) for name in with_roles(run, SOUGHT))
    return elements > MOST_NAMES and knows_state_rates(run, model)

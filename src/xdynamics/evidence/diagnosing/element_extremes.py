"""The largest and the least value of every element of quantities over a run: as `find_extremes`, all elements side by side."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.dynamics.shortened_steps import StepInterpolator
from xdynamics.evidence.chunks import Chunks, with_roles
from xdynamics.evidence.diagnosing.extremes import (
    MOST_NAMES,
    SOUGHT,
    STATES,
    Functions,
    extreme_variables,
    takes_too_much,
)
from xdynamics.evidence.diagnosing.heights import INTERPOLATED, ElementExtremes, Heights
from xdynamics.evidence.diagnosing.states_inside import consecutive_slices, variable_numbers
from xdynamics.evidence.diagnosing.summits import Summits
from xdynamics.evidence.observables import knows_state_rates, state_rates
from xdynamics.methods.scheme import REINTEGRATE
from xdynamics.model import Model
from xdynamics.record.folding import model_dimensions
from xdynamics.units import parse_unit

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]


def has_many_elements(run: xr.Dataset, model: Model) -> bool:
    """Whether a record of quantities has so many elements that extremes are sought of those alone that steps integrate.

    Of others elements are told apart: each force and observable is then evaluated where it is largest. So it is where
    rates are not known from states alone.
    """
    if not model_dimensions(run):
        return False
    elements = sum(int(np.prod(run.variables[name].shape[1:])) for name in with_roles(run, SOUGHT))
    return elements > MOST_NAMES and knows_state_rates(run, model)


def extremes_by_quantities(rows: Chunks, functions: Functions | None) -> dict[str, tuple[Any, ...]]:
    """Return the largest and the least value of all elements that steps integrate as variables of a Dataset."""
    run, variables = rows.run, dict[str, tuple[Any, ...]]()
    signed_names = [(name, sign) for name in with_roles(run, STATES) for sign in (1.0, -1.0)]
    for (name, sign), result in zip(signed_names, extremes_of_elements(rows, signed_names, functions), strict=True):
        variables |= extreme_variables(run, name, sign, result)
    return variables


def extremes_of_elements(
    rows: Chunks, signed_names: Sequence[tuple[str, float]], functions: Functions | None
) -> list[ElementExtremes]:
    """Find the largest values of quantities that steps integrate, or with a sign of -1 the least.

    The rates of these have to be known from states alone; see `knows_state_rates`.
    """
    all_heights = [
        Heights.of(name, sign, int(np.prod(rows.run.variables[name].shape[1:]))) for name, sign in signed_names
    ]
    for stretch in rows.parts("time", "row_kind", *dict.fromkeys(name for name, _ in signed_names)):
        for heights in all_heights:
            heights.rise(stretch)
    searches, interpolator = _begin_element_searches(rows, all_heights), None
    near, _ = rows.nearby_record(np.concatenate([heights.rows.ravel() for heights in all_heights]))
    while True:
        times = [search.places() for search in searches]
        state_count = sum(item.size for item in times)
        if not state_count:
            break
        if interpolator is None and takes_too_much(state_count, rows):
            return [_accepted_extremes(*pair) for pair in zip(all_heights, searches, strict=True)]
        interpolator = interpolator or StepInterpolator.of_run(near, functions, REINTEGRATE)
        states = interpolator.states_at(np.concatenate(times), after_event=False)
        values_by_name = {block.name: variable_numbers(states, block.name) for block in interpolator.layout.used.blocks}
        where = variable_numbers(states, schema.AT_TIME), variable_numbers(states, "row")
        rates, parts = (
            _quantity_rates(rows, near, values_by_name, *where),
            consecutive_slices([item.size for item in times]),
        )
        for heights, search, part in zip(all_heights, searches, parts, strict=True):
            if part.start < part.stop:
                members = search.place_members
                values = values_by_name[heights.name][part].reshape(members.size, search.best.size)[
                    np.arange(members.size), members
                ]
                search.narrow(values, rates[heights.name][members, np.arange(part.start, part.stop)])
    best_extremes = [_better_extremes(*pair) for pair in zip(all_heights, searches, strict=True)]
    return (
        best_extremes
        if interpolator is None
        else [*_with_interpolation_errors(all_heights, best_extremes, interpolator)]
    )


def _begin_element_searches(rows: Chunks, all_heights: Sequence[Heights]) -> list[Summits]:
    """Begin the searches of the steps around each hump of each element."""
    near, places = rows.nearby_record(np.concatenate([heights.rows.ravel() for heights in all_heights]))
    distinct, inverse = np.unique(places, return_inverse=True)
    values_by_name = {heights.name: variable_numbers(near, heights.name)[distinct] for heights in all_heights}
    rates = _quantity_rates(rows, near, values_by_name, variable_numbers(near, "time")[distinct], distinct)
    parts = consecutive_slices([heights.rows.size for heights in all_heights])
    return [
        heights.search(rates[heights.name][heights.members, inverse[part].reshape(3, -1)])
        for heights, part in zip(all_heights, parts, strict=True)
    ]


def _quantity_rates(
    rows: Chunks, near: object, values_by_name: dict[str, Floats], times: Floats, numbers: Rows
) -> dict[str, Floats]:
    """Return the rates of quantities at states, shape (elements, k), in recorded units."""
    rates = state_rates(near, rows.model, values_by_name, times, numbers)  # type: ignore[arg-type]
    assert rates is not None  # noqa: S101 - asked before
    units = {name: parse_unit(str(rows.run.variables[name].attrs["units"])) for name in rates}
    return {name: values / float(units[name].factor) for name, values in rates.items()}


def _accepted_extremes(heights: Heights, search: Summits) -> ElementExtremes:
    """Return the best accepted states, and how far parabolas and tangents exceed them."""
    best, above = heights.accepted(), search.open_heights
    return best._replace(uncertainties=np.where(above > best.uncertainties, above, best.uncertainties))


def _better_extremes(heights: Heights, search: Summits) -> ElementExtremes:
    """Return the results of the search where they are better than the best accepted states, which are returned elsewhere."""
    best, sign = heights.accepted(), heights.sign
    better = sign * search.best > sign * best.values
    return ElementExtremes(
        np.where(better, search.best, best.values),
        np.where(better, search.when, best.times),
        np.where(better, INTERPOLATED, best.rules),
        np.zeros(better.size),
    )


def _with_interpolation_errors(
    all_heights: Sequence[Heights], best_extremes: Sequence[ElementExtremes], interpolator: StepInterpolator
) -> Iterator[ElementExtremes]:
    """Yield extremes with the errors of those that are between accepted states by interpolation."""
    members = [np.flatnonzero(result.rules == INTERPOLATED) for result in best_extremes]
    times = np.concatenate(
        [result.times[interpolated] for result, interpolated in zip(best_extremes, members, strict=True)]
    )
    states = interpolator.states_at(times, after_event=False) if times.size else None
    for heights, result, interpolated, part in zip(
        all_heights,
        best_extremes,
        members,
        consecutive_slices([interpolated.size for interpolated in members]),
        strict=True,
    ):
        if states is not None:
            errors = variable_numbers(states, schema.error(heights.name))[part].reshape(
                interpolated.size, result.rules.size
            )
            result.uncertainties[interpolated] = np.abs(errors[np.arange(interpolated.size), interpolated])
        yield result

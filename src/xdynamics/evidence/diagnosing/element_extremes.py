"""The largest and the least value of every element of quantities over a run: as `extremes`, all elements side by side."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.dynamics.shortened_steps import Inside
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
from xdynamics.evidence.diagnosing.states_inside import column, parts_of
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
    wanted = [(name, sign) for name in with_roles(run, STATES) for sign in (1.0, -1.0)]
    for (name, sign), result in zip(wanted, extremes_of_elements(rows, wanted, functions), strict=True):
        variables |= extreme_variables(run, name, sign, result)
    return variables


def extremes_of_elements(
    rows: Chunks, wanted: Sequence[tuple[str, float]], functions: Functions | None
) -> list[ElementExtremes]:
    """Find the largest values of quantities that steps integrate, or with a sign of -1 the least.

    The rates of these have to be known from states alone; see `knows_state_rates`.
    """
    found = [Heights.of(name, sign, int(np.prod(rows.run.variables[name].shape[1:]))) for name, sign in wanted]
    for stretch in rows.parts("time", "row_kind", *dict.fromkeys(name for name, _ in wanted)):
        for heights in found:
            heights.rise(stretch)
    searches, inside = _begun(rows, found), None
    near, _ = rows.near(np.concatenate([heights.rows.ravel() for heights in found]))
    while True:
        times = [search.places() for search in searches]
        asked = sum(item.size for item in times)
        if not asked:
            break
        if inside is None and takes_too_much(asked, rows):
            return [_accepted(*pair) for pair in zip(found, searches, strict=True)]
        inside = inside or Inside.of(near, functions, REINTEGRATE)
        states = inside.at(np.concatenate(times), after=False)
        at = {block.name: column(states, block.name) for block in inside.layout.used.blocks}
        where = column(states, schema.AT_TIME), column(states, "row")
        rates, parts = _rates(rows, near, at, *where), parts_of([item.size for item in times])
        for heights, search, part in zip(found, searches, parts, strict=True):
            if part.start < part.stop:
                members = search.asked
                values = at[heights.name][part].reshape(members.size, search.best.size)[
                    np.arange(members.size), members
                ]
                search.narrow(values, rates[heights.name][members, np.arange(part.start, part.stop)])
    settled = [_settled(*pair) for pair in zip(found, searches, strict=True)]
    return settled if inside is None else [*_with_errors(found, settled, inside)]


def _begun(rows: Chunks, found: Sequence[Heights]) -> list[Summits]:
    """Begin the searches of the steps around each hump of each element."""
    near, places = rows.near(np.concatenate([heights.rows.ravel() for heights in found]))
    distinct, inverse = np.unique(places, return_inverse=True)
    at = {heights.name: column(near, heights.name)[distinct] for heights in found}
    rates = _rates(rows, near, at, column(near, "time")[distinct], distinct)
    parts = parts_of([heights.rows.size for heights in found])
    return [
        heights.search(rates[heights.name][heights.members, inverse[part].reshape(3, -1)])
        for heights, part in zip(found, parts, strict=True)
    ]


def _rates(rows: Chunks, near: object, at: dict[str, Floats], times: Floats, numbers: Rows) -> dict[str, Floats]:
    """Return the rates of quantities at states, shape (elements, k), in recorded units."""
    rates = state_rates(near, rows.model, at, times, numbers)  # type: ignore[arg-type]
    assert rates is not None  # noqa: S101 - asked before
    units = {name: parse_unit(str(rows.run.variables[name].attrs["units"])) for name in rates}
    return {name: own / float(units[name].factor) for name, own in rates.items()}


def _accepted(heights: Heights, search: Summits) -> ElementExtremes:
    """Return the best accepted states, and how far parabolas and tangents exceed them."""
    best, above = heights.accepted(), search.open_heights
    return best._replace(uncertainties=np.where(above > best.uncertainties, above, best.uncertainties))


def _settled(heights: Heights, search: Summits) -> ElementExtremes:
    """Return the results of the search where they are better than the best accepted states, which are returned elsewhere."""
    best, sign = heights.accepted(), heights.sign
    better = sign * search.best > sign * best.values
    return ElementExtremes(
        np.where(better, search.best, best.values),
        np.where(better, search.when, best.times),
        np.where(better, INTERPOLATED, best.rules),
        np.zeros(better.size),
    )


def _with_errors(
    found: Sequence[Heights], settled: Sequence[ElementExtremes], inside: Inside
) -> Iterator[ElementExtremes]:
    """Yield extremes with the errors of those that are between accepted states by interpolation."""
    members = [np.flatnonzero(result.rules == INTERPOLATED) for result in settled]
    times = np.concatenate([result.times[own] for result, own in zip(settled, members, strict=True)])
    states = inside.at(times, after=False) if times.size else None
    for heights, result, own, part in zip(
        found, settled, members, parts_of([own.size for own in members]), strict=True
    ):
        if states is not None:
            errors = column(states, schema.error(heights.name))[part].reshape(own.size, result.rules.size)
            result.uncertainties[own] = np.abs(errors[np.arange(own.size), own])
        yield result

"""Continuity of a record: whether each step, recomputed from the row it started from, leads to the row it led to."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.dynamics.shortened_steps import Inside
from xdynamics.evidence.chunks import Chunks, Unread, with_roles
from xdynamics.evidence.diagnosing.conservation import spans
from xdynamics.evidence.evidence_dataset import about, stated
from xdynamics.faults import InputError
from xdynamics.methods.scheme import INTERPOLANT, REINTEGRATE, UNIT_OF
from xdynamics.record.arguments import precision_of
from xdynamics.record.flag_words import time_unit
from xdynamics.schema import CONTINUITY, CONTINUITY_STEPS, CONTINUITY_TIME, CONTINUITY_VERDICT
from xdynamics.units import unit_suffix

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]
Functions = Any

PASSED, FAILED, NOT_CHECKED = range(3)
VERDICTS = ("passed", "failed", "not_checked")
OF_STEPS = ("coordinate", "velocity", "state")  # roles of what steps change; what controllers hold is set at ticks
MARGIN = 32.0  # spacings at the start and the end of a step that it may be off by
MOST_NUMBERS, FEWEST_STEPS = (
    1 << 20,
    16,
)  # states of the steps that are recomputed have no more numbers, and of how many at least
MOST_SOLVED = 1000  # steps that are recomputed where the forces of contacts of many are solved for in each


@dataclass
class Worst:
    """Of each element of a quantity the step that is furthest from its row, measured by its bound.

    Attributes
    ----------
    defects, bounds, times : ndarray, shape of the quantity
        In its recorded unit; times in that of the record.
    """

    defects: Floats
    bounds: Floats
    times: Floats

    @classmethod
    def of(cls, shape: tuple[int, ...]) -> Worst:
        """Begin without a step."""
        return cls(np.zeros(shape), np.zeros(shape), np.full(shape, np.nan))

    @property
    def ratios(self) -> Floats:
        """Defects over bounds; of a defect of 0 it is 0."""
        return _over(self.defects, self.bounds)

    def take(self, defects: Floats, bounds: Floats, times: Floats) -> None:
        """Take further steps: shape (k, ...)."""
        ratios = _over(defects, bounds)
        at = np.argmax(ratios, axis=0)[np.newaxis]  # the first nan, if there is one
        ratio, further = np.take_along_axis(ratios, at, 0)[0], self.ratios
        worse = ~(ratio <= further) & ~np.isnan(further) | np.isnan(self.times)
        for own, found in ((self.defects, defects), (self.bounds, bounds), (self.times, _spread(times, defects))):
            own[worse] = np.take_along_axis(found, at, 0)[0][worse]


def _over(defects: Floats, bounds: Floats) -> Floats:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(defects == 0.0, 0.0, defects / bounds)


def _spread(times: Floats, like: Floats) -> Floats:
    return np.broadcast_to(times.reshape(-1, *(1,) * (like.ndim - 1)), like.shape)


def continuity(rows: Chunks, functions: Functions) -> tuple[dict[str, Any], str]:
    """Recompute steps from the rows they started from, and compare them with the rows that they led to.

    Returns
    -------
    variables : dict
        Of a Dataset.
    rule : str
        Which steps were recomputed, or why none was.
    """
    names = with_roles(rows.run, OF_STEPS)
    worst = {name: Worst.of(rows.run.variables[name].shape[1:]) for name in names}
    steps, rule = 0, ""
    if not isinstance(rows, Unread):
        try:
            chosen, rule = _chosen(rows)
            largest = {name: np.fmax(-low, high) for name, (low, high) in spans(rows, names).items()}
            unsolved = sum(_judge(inside, places, largest, worst) for inside, places in _parts(rows, chosen, functions))
            steps, rule = chosen.size - unsolved, f"{rule}, {unsolved} could not be solved" if unsolved else rule
        except InputError as error:
            steps, rule = 0, f"no step was recomputed: {error}"
    return _variables(rows, worst, steps), rule


def _chosen(rows: Chunks) -> tuple[Rows, str]:
    """Choose the rows that steps are recomputed from: all, or as many as there is time for, evenly spread."""
    kinds, times = (rows.at(name, np.arange(rows.size)) for name in ("row_kind", "time"))
    starts = np.flatnonzero(np.diff(times) > 0.0)
    taken, left = starts, ""
    if any(event.root_state == INTERPOLANT for event in rows.model.events.values()):
        taken = starts[kinds[starts + 1] != schema.EVENT_BEFORE]
        left = ", but those to events on interpolants"
    if not taken.size:
        return taken, f"there is no step to recompute{left}"
    most = max(FEWEST_STEPS, MOST_NUMBERS // max(1, len(rows.model.units)))
    if schema.CLOSED_LINKS in rows.run.dims:
        most = min(most, MOST_SOLVED)
    if taken.size <= most:
        return taken, f"each of {starts.size} steps was recomputed{left}"
    taken = taken[np.unique(np.linspace(0, taken.size - 1, most).astype(np.int64))]
    return taken, f"{taken.size} of {starts.size} steps, evenly spread, were recomputed{left}"


def _parts(rows: Chunks, chosen: Rows, functions: Functions) -> Iterator[tuple[Inside, Rows]]:
    """Yield records in memory, and rows of theirs that steps are recomputed from."""
    size, near = max(1, MOST_NUMBERS // max(1, len(rows.model.units))), rows.run
    is_far = rows.is_stored and not rows.model.delays
    if rows.is_stored and not is_far:  # delayed values are of all rows before
        near = rows.whole(rows.run)
    for first in range(0, chosen.size, size):
        places = chosen[first : first + size]
        if is_far:
            near, found = rows.near(np.concatenate([places, places + 1]))
            places = found[: places.size]
        yield Inside.of(near, functions, REINTEGRATE, rows.model), places


def _judge(inside: Inside, places: Rows, largest: Mapping[str, Floats], worst: Mapping[str, Worst]) -> int:
    """Compare steps with their rows, and count those whose equations the iterations did not solve anew.

    The record rounds the state at a start, which the march may know better: what a spacing there makes of the step is
    found by a step from a state that is off by it. That of the largest number counts, as of a sum whose rest is carried along.
    """
    unit, time = UNIT_OF[precision_of(inside.run.attrs)], np.asarray(inside.run.variables["time"])
    shifts = {block.name: np.zeros((1, *block.shape)) for block in inside.quantities}
    first = 0
    for name, size in largest.items():
        numbers = first + np.arange(size.size).reshape(size.shape)  # of elements, however they are grouped
        shifts[name], first = (unit * size * (1 - 2 * (numbers % 2)))[np.newaxis], first + size.size
    defects, moved = inside.defects(places, 1), inside.defects(places, 1, shifts)
    solved = np.ones(places.size, bool)
    if inside.settings.method.stepper.has_memory:  # they went on from those of the step before
        for name in worst:
            both = np.abs(defects[name]) + np.abs(moved[name])
            solved &= ~np.isnan(both.reshape(places.size, -1)).any(axis=1)
    for name, entry in worst.items():
        rounding = MARGIN * (unit * largest[name] + np.abs(moved[name] - defects[name]))
        bounds = rounding + _tolerance(inside, name, largest[name])
        if solved.any():
            entry.take(np.abs(defects[name])[solved], bounds[solved], time[places[solved]])
    return int(np.count_nonzero(~solved))


def _tolerance(inside: Inside, name: str, largest: Floats) -> Any:
    """Return how far a step may be off whose equations are solved by iterations that go on from those of the step before."""
    if not inside.settings.method.stepper.has_memory:
        return 0.0
    attributes = inside.run.variables[name].attrs
    absolute = np.asarray(attributes.get("atol", 0.0), float)
    absolute = absolute.reshape(largest.shape) if absolute.size == largest.size else absolute.max()
    return absolute + float(inside.run.attrs.get("solver_rtol", 0.0)) * largest


def _variables(rows: Chunks, worst: dict[str, Worst], steps: int) -> dict[str, Any]:
    """Return what was found as variables of a Dataset."""
    variables: dict[str, Any] = {}
    ratios = {name: entry.ratios.ravel() for name, entry in worst.items() if entry.ratios.size}
    every = np.concatenate([*ratios.values()]) if steps and ratios else np.zeros(0)
    times = np.concatenate([worst[name].times.ravel() for name in ratios]) if every.size else every
    for name, entry in worst.items():
        described, dims = rows.run.variables[name].attrs, rows.run.variables[name].dims[1:]
        defect_said = (
            f"distance between recorded {name} and {name} recomputed by one step from the recorded state before; of"
            " the step where it is largest relative to its bound"
        )
        defect, bound = schema.continuity_defect(name)
        known = np.nan if not steps else 1.0
        variables[defect] = (
            dims,
            entry.defects * known,
            about(described["units"], defect_said, CONTINUITY),
        )
        told = f"largest {defect} that rounding explains: of the recorded state and of the arithmetic of the step"
        variables[bound] = (dims, entry.bounds * known, about(described["units"], told, CONTINUITY))
    verdict = NOT_CHECKED if not every.size else PASSED if (every <= 1.0).all() else FAILED
    when = times[int(np.argmax(every))] if every.size else np.nan
    unit, told = time_unit(rows.run).text, "start of the step whose defect is largest relative to its bound"
    variables[CONTINUITY_TIME] = ((), when, about(unit, told, CONTINUITY))
    variables[CONTINUITY_STEPS] = ((), np.int64(steps), about("1", "number of steps that were recomputed", CONTINUITY))
    told = "whether recomputed steps lead from each recorded state to the next one, within rounding"
    meanings = schema.flags(dict(enumerate(VERDICTS)))
    variables[CONTINUITY_VERDICT] = ((), np.int8(verdict), about("1", told, "flag") | meanings)
    return variables


def continuity_said(found: xr.Dataset) -> Iterator[str]:
    """Say in a line whether the steps of a diagnosed run lead to the rows that follow."""
    if CONTINUITY_VERDICT not in found:
        return  # of an older version
    rule, verdict = str(stated(found, "continuity_rule")), int(found[CONTINUITY_VERDICT])
    if verdict == NOT_CHECKED:
        yield f"continuity not checked: {rule}"
    elif verdict == PASSED:
        yield f"continuity passed: {rule}; the rows that follow were met to rounding"
    else:
        when = found[CONTINUITY_TIME]
        name, defect, bound = _worst_of(found)
        start = f"t = {float(when):.9g}{unit_suffix(when.attrs['units'])}"
        yield (
            f"attention: continuity failed: {rule}; that from {start} leads {defect} away from the next"
            f" row in {name}, where rounding explains {bound}: rows were changed, or states inside steps are not the march's"
        )


def _worst_of(found: xr.Dataset) -> tuple[str, str, str]:
    """Return the element that is furthest off by its bound, how far it is, and its bound."""
    ratio, worst = -1.0, ("", "", "")
    for key in found.data_vars:
        name = str(key).removeprefix(schema.continuity_defect("")[0])
        defects, bounds = (found.get(part) for part in schema.continuity_defect(name))
        if name == key or defects is None or bounds is None:
            continue
        ratios = _over(defects.values, bounds.values)
        most = ratios.max(initial=-1.0)
        if most > ratio or np.isnan(most):
            at, units = np.unravel_index(np.argmax(ratios), ratios.shape), unit_suffix(defects.attrs["units"])
            places = ", ".join(
                str(found[dim].values[k]) if dim in found.coords else str(k)
                for dim, k in zip(defects.dims, at, strict=True)
            )
            off, bound = (f"{part.values[at]:.3g}{units}" for part in (defects, bounds))
            ratio, worst = most, (f"{name}[{places}]" if places else name, off, bound)
    return worst

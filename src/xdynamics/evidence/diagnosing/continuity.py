"""Continuity of a record: whether each step, recomputed from its first row, leads to its last row."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.dynamics.shortened_steps import StepInterpolator
from xdynamics.evidence.chunks import Chunks, Unread, with_roles
from xdynamics.evidence.diagnosing.conservation import spans
from xdynamics.evidence.evidence_dataset import attrs_of, stated_value
from xdynamics.faults import InputError
from xdynamics.methods.scheme import INTERPOLANT, REINTEGRATE, UNIT_OF
from xdynamics.record.arguments import precision_of
from xdynamics.record.flag_words import time_unit_of
from xdynamics.schema import CONTINUITY, CONTINUITY_STEPS, CONTINUITY_TIME, CONTINUITY_VERDICT
from xdynamics.units import unit_suffix

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]
Functions = Any

PASSED, FAILED, NOT_CHECKED = range(3)
VERDICTS = ("passed", "failed", "not_checked")
MARGIN = 32.0  # spacings at the start and the end of a step that it may be off by
MOST_NUMBERS, FEWEST_STEPS = (
    1 << 20,
    16,
)  # states of the steps that are recomputed have no more numbers, and of how many at least
MOST_SOLVED = 1000  # steps that are recomputed where the forces of contacts of many are solved for in each


@dataclass
class Worst:
    """For each element of a quantity the step that is furthest from its row, relative to its bound.

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
        return _defect_ratios(self.defects, self.bounds)

    def add_steps(self, defects: Floats, bounds: Floats, times: Floats) -> None:
        """Include further steps: defects and bounds of shape (k, ...), times of shape (k,)."""
        ratios = _defect_ratios(defects, bounds)
        worst_index = np.argmax(ratios, axis=0)[np.newaxis]  # the first nan, if there is one
        ratio, further = np.take_along_axis(ratios, worst_index, 0)[0], self.ratios
        # negated, so that a ratio of nan is worse than any number; once it is there it stays
        worse = ~(ratio <= further) & ~np.isnan(further) | np.isnan(self.times)
        for worst_values, step_values in (
            (self.defects, defects),
            (self.bounds, bounds),
            (self.times, _broadcast_times(times, defects)),
        ):
            worst_values[worse] = np.take_along_axis(step_values, worst_index, 0)[0][worse]


def _defect_ratios(defects: Floats, bounds: Floats) -> Floats:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(defects == 0.0, 0.0, defects / bounds)


def _broadcast_times(times: Floats, like: Floats) -> Floats:
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
    names = with_roles(rows.run, schema.INTEGRATED)
    worst = {name: Worst.of(rows.run.variables[name].shape[1:]) for name in names}
    steps, rule = 0, ""
    if not isinstance(rows, Unread):
        try:
            chosen_rows, rule = _recomputed_rows(rows)
            largest = {name: np.fmax(-low, high) for name, (low, high) in spans(rows, names).items()}
            unsolved = sum(
                _compare_steps(interpolator, places, largest, worst)
                for interpolator, places in _interpolator_batches(rows, chosen_rows, functions)
            )
            steps, rule = chosen_rows.size - unsolved, f"{rule}, {unsolved} could not be solved" if unsolved else rule
        except InputError as error:
            steps, rule = 0, f"no step was recomputed: {error}"
    return _continuity_variables(rows, worst, steps), rule


def _recomputed_rows(rows: Chunks) -> tuple[Rows, str]:
    """Choose the rows that steps are recomputed from: all, or as many as there is time for, evenly spread."""
    kinds, times = (rows.values_at(name, np.arange(rows.size)) for name in ("row_kind", "time"))
    starts = np.flatnonzero(np.diff(times) > 0.0)
    chosen_rows, left = starts, ""
    if any(event.root_state == INTERPOLANT for event in rows.model.elements.events.values()):
        chosen_rows = starts[kinds[starts + 1] != schema.EVENT_BEFORE]
        left = ", but those to events on interpolants"
    if not chosen_rows.size:
        return chosen_rows, f"there is no step to recompute{left}"
    max_steps = max(FEWEST_STEPS, MOST_NUMBERS // max(1, len(rows.model.elements.units)))
    if schema.CLOSED_LINKS in rows.run.dims:
        max_steps = min(max_steps, MOST_SOLVED)
    if chosen_rows.size <= max_steps:
        return chosen_rows, f"each of {starts.size} steps was recomputed{left}"
    chosen_rows = chosen_rows[np.unique(np.linspace(0, chosen_rows.size - 1, max_steps).astype(np.int64))]
    return chosen_rows, f"{chosen_rows.size} of {starts.size} steps, evenly spread, were recomputed{left}"


def _interpolator_batches(
    rows: Chunks, chosen_rows: Rows, functions: Functions
) -> Iterator[tuple[StepInterpolator, Rows]]:
    """Yield records in memory, and rows of theirs that steps are recomputed from."""
    size, near = max(1, MOST_NUMBERS // max(1, len(rows.model.elements.units))), rows.run
    is_far = rows.is_stored and not rows.model.delays
    if rows.is_stored and not is_far:  # delayed values are of all rows before
        near = rows.load_variables(rows.run)
    for first in range(0, chosen_rows.size, size):
        places = chosen_rows[first : first + size]
        if is_far:
            near, near_rows = rows.nearby_record(np.concatenate([places, places + 1]))
            places = near_rows[: places.size]
        yield StepInterpolator.of_run(near, functions, REINTEGRATE, rows.model), places


def _compare_steps(
    interpolator: StepInterpolator, places: Rows, largest: Mapping[str, Floats], worst: Mapping[str, Worst]
) -> int:
    """Compare steps with their rows, and count those whose equations the iterations did not solve anew.

    The record rounds the state at a start, which the march may know better: what a spacing there makes of the step is
    found by a step from a state that is off by it. That of the largest number counts, as of a sum whose rest is carried along.
    """
    unit, time = UNIT_OF[precision_of(interpolator.run.attrs)], np.asarray(interpolator.run.variables["time"])
    shifts = {block.name: np.zeros((1, *block.shape)) for block in interpolator.quantities}
    first = 0
    for name, size in largest.items():
        numbers = first + np.arange(size.size).reshape(size.shape)  # of elements, however they are grouped
        shifts[name], first = (unit * size * (1 - 2 * (numbers % 2)))[np.newaxis], first + size.size
    defects, shifted_defects = interpolator.defects(places, 1), interpolator.defects(places, 1, shifts)
    solved = np.ones(places.size, bool)
    if interpolator.settings.method.stepper.has_memory:  # they went on from those of the step before
        for name in worst:
            both = np.abs(defects[name]) + np.abs(shifted_defects[name])
            solved &= ~np.isnan(both.reshape(places.size, -1)).any(axis=1)
    for name, entry in worst.items():
        rounding = MARGIN * (unit * largest[name] + np.abs(shifted_defects[name] - defects[name]))
        bounds = rounding + _solver_tolerance(interpolator, name, largest[name])
        if solved.any():
            entry.add_steps(np.abs(defects[name])[solved], bounds[solved], time[places[solved]])
    return int(np.count_nonzero(~solved))


def _solver_tolerance(interpolator: StepInterpolator, name: str, largest: Floats) -> Any:
    """Return how far a step may be off whose equations are solved by iterations that go on from those of the step before."""
    if not interpolator.settings.method.stepper.has_memory:
        return 0.0
    attributes = interpolator.run.variables[name].attrs
    absolute = np.asarray(attributes.get("atol", 0.0), float)
    absolute = absolute.reshape(largest.shape) if absolute.size == largest.size else absolute.max()
    return absolute + float(interpolator.run.attrs.get("solver_rtol", 0.0)) * largest


def _continuity_variables(rows: Chunks, worst: dict[str, Worst], steps: int) -> dict[str, Any]:
    """Return the worst defect of each quantity as variables of a Dataset."""
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
        known_factor = np.nan if not steps else 1.0
        variables[defect] = (dims, entry.defects * known_factor, attrs_of(described["units"], defect_said, CONTINUITY))
        long_name = f"largest {defect} that rounding explains: of the recorded state and of the arithmetic of the step"
        variables[bound] = (dims, entry.bounds * known_factor, attrs_of(described["units"], long_name, CONTINUITY))
    verdict = NOT_CHECKED if not every.size else PASSED if (every <= 1.0).all() else FAILED
    when = times[int(np.argmax(every))] if every.size else np.nan
    unit, long_name = time_unit_of(rows.run).text, "start of the step whose defect is largest relative to its bound"
    variables[CONTINUITY_TIME] = ((), when, attrs_of(unit, long_name, CONTINUITY))
    variables[CONTINUITY_STEPS] = (
        (),
        np.int64(steps),
        attrs_of("1", "number of steps that were recomputed", CONTINUITY),
    )
    long_name = "whether recomputed steps lead from each recorded state to the next one, within rounding"
    meanings = schema.flag_attributes(dict(enumerate(VERDICTS)))
    variables[CONTINUITY_VERDICT] = ((), np.int8(verdict), attrs_of("1", long_name, "flag") | meanings)
    return variables


def continuity_lines(diagnosis: xr.Dataset) -> Iterator[str]:
    """State in a line whether the steps of a diagnosed run lead to the rows that follow."""
    if CONTINUITY_VERDICT not in diagnosis:
        return  # of an older version
    rule, verdict = str(stated_value(diagnosis, "continuity_rule")), int(diagnosis[CONTINUITY_VERDICT])
    if verdict == NOT_CHECKED:
        yield f"continuity not checked: {rule}"
    elif verdict == PASSED:
        yield f"continuity passed: {rule}; the rows that follow were met to rounding"
    else:
        when = diagnosis[CONTINUITY_TIME]
        name, defect, bound = _worst_element(diagnosis)
        start = f"t = {float(when):.9g}{unit_suffix(when.attrs['units'])}"
        yield (
            f"attention: continuity failed: {rule}; that from {start} leads {defect} away from the next"
            f" row in {name}, where rounding explains {bound}: rows were changed, or states inside steps are not the march's"
        )


def _worst_element(diagnosis: xr.Dataset) -> tuple[str, str, str]:
    """Return the element that is furthest off by its bound, how far it is, and its bound."""
    ratio, worst = -1.0, ("", "", "")
    for key in diagnosis.data_vars:
        name = str(key).removeprefix(schema.continuity_defect("")[0])
        defects, bounds = (diagnosis.get(part) for part in schema.continuity_defect(name))
        if name == key or defects is None or bounds is None:
            continue
        ratios = _defect_ratios(defects.values, bounds.values)
        worst_ratio = ratios.max(initial=-1.0)
        # the maximum is nan if one ratio is, and then no comparison holds
        if worst_ratio > ratio or np.isnan(worst_ratio):
            worst_index, units = np.unravel_index(np.argmax(ratios), ratios.shape), unit_suffix(defects.attrs["units"])
            places = ", ".join(
                str(diagnosis[dim].values[k]) if dim in diagnosis.coords else str(k)
                for dim, k in zip(defects.dims, worst_index, strict=True)
            )
            off, bound = (f"{part.values[worst_index]:.3g}{units}" for part in (defects, bounds))
            ratio, worst = worst_ratio, (f"{name}[{places}]" if places else name, off, bound)
    return worst

"""Readings of a refinement level: the few numbers that a study takes from a run.

The run stays where it was marched. First every level is outlined by itself. All outlines together give what the levels
have in common: times that every run reaches, occurrences that correspond, levels of cycles. At these each run is read.

The local error of a step is its difference from many short steps in its place, as opposed to the error accumulated over
a run.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from xdynamics import archive
from xdynamics.archive.seals import slabs
from xdynamics.dynamics.shortened_steps import StepInterpolator
from xdynamics.evidence.diagnosing.cycles import Cycles, chosen_level, cycles
from xdynamics.evidence.evidence_dataset import Rows, event_rows_by_name
from xdynamics.evidence.observables import observe
from xdynamics.evidence.refining.subjects import ENERGY_RANGE, StudyQuantities
from xdynamics.faults import InputError, internal_text
from xdynamics.methods.scheme import REINTEGRATE
from xdynamics.record.named_rows import rows_named
from xdynamics.record.unfolding import get_column, whole_of
from xdynamics.schema import FIRST_PASSED, PASSED, acceleration, rate, velocity

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

DEFECT = "step_defect_"  # head of variables: the largest error of one step at each level
PARTS = 16  # steps in the place of one
LOOKED_AT = 256  # steps of a run, spread over it


def step_defects(
    run: xr.Dataset,
    names: Sequence[str] | None = None,
    *,
    functions: Mapping[str, Callable[..., float]] | None = None,
    max_steps: int = LOOKED_AT,
) -> dict[str, Floats]:
    """Return end states of steps spread over a run, less the end states of sixteen short steps instead.

    Parameters
    ----------
    run : xarray.Dataset
        A run record.
    names : sequence of str, optional
        Coordinates, velocities and states, or elements of these; by default all that the record has.
    functions : mapping of str to callable, optional
        The Python functions that the model's forces call.
    max_steps : int
        Steps to look at.

    Returns
    -------
    dict of str to ndarray, shape (steps, ...)
        By these names, in their recorded units.

    Raises
    ------
    InputError
        If the method carries memory from one step to the next, so that no step can be repeated alone.
    """
    interpolator = StepInterpolator.of_run(run, functions, REINTEGRATE)
    if interpolator.settings.method.stepper.has_memory:
        raise InputError(
            f"steps of '{interpolator.settings.method.name}' depend on those before: none of them is repeated alone"
        )
    rows = np.flatnonzero(np.diff(np.asarray(run["time"])) > 0.0)
    chosen_rows = rows[np.unique(np.linspace(0, len(rows) - 1, min(max_steps, len(rows))).astype(np.int64))]
    defects, used = interpolator.defects(chosen_rows, PARTS), interpolator.layout.used
    return {name: used.values_of(defects, name) for name in (defects if names is None else names)}


ENERGY = "total_energy"


@dataclass(frozen=True)
class RunSummary:
    """The numbers that a level's run gives independently of other levels.

    Attributes
    ----------
    begin, end : float, s
    outcome, outcome_text, digest : str
    accepted, rows : int
        Accepted steps, and rows of the record.
    row_bytes : float
        Size of a row.
    estimated : float
        What all steps estimate to be off together, as a part of the size of a number; 0 of steps without an estimate.
    event_times, event_uncertainties : ndarray, shape (events,), s
    event_rows : mapping of str to ndarray of int
        Which of the events are those of each name.
    passed : mapping of str to float, s
        The last row before each switch that a step went over, by its name.
    crossing_levels : mapping of str to float
        The level that cycles of a coordinate rise through, chosen by the finest run.
    """

    begin: float
    end: float
    outcome: str
    outcome_text: str
    digest: str
    accepted: int
    rows: int
    row_bytes: float
    estimated: float
    event_times: Floats
    event_uncertainties: Floats
    event_rows: Mapping[str, Rows]
    passed: Mapping[str, float]
    crossing_levels: Mapping[str, float]

    @classmethod
    def of(
        cls, run: xr.Dataset, cyclic: Sequence[str] = (), functions: Mapping[str, Callable[..., float]] | None = None
    ) -> RunSummary:
        """Outline the run of a level; of the finest with levels for cycles of coordinates."""
        nothing, events = np.zeros(0), event_rows_by_name(run)
        return cls(
            float(run.variables["time"][0]),
            float(run.variables["time"][-1]),
            str(run.attrs["run_outcome"]),
            str(run.attrs["run_outcome_text"]),
            archive.digest_of_run(run),
            int(run.attrs["run_accepted_steps"]),
            run.sizes["step"],
            float(sum(column.dtype.itemsize for column in run.variables.values() if column.dims[:1] == ("step",))),
            estimated_error(run),
            run.variables["event_time"].values if "event_time" in run.variables else nothing,
            run.variables["event_time_uncertainty"].values if "event_time_uncertainty" in run.variables else nothing,
            events,
            _switch_times_passed(run),
            {name: chosen_level(run, name, functions) for name in cyclic},
        )


def summary_of_finest(subjects: StudyQuantities) -> Callable[[xr.Dataset], RunSummary]:
    """Return what outlines the run of the finest level, with levels for cycles if these are compared."""
    if not subjects.cyclic:  # functions of the user go to a cluster only where they are needed
        return RunSummary.of
    return partial(RunSummary.of, cyclic=subjects.cyclic, functions=subjects.levels.model.functions)


def estimated_error(run: xr.Dataset) -> float:
    """Return the sum of the error estimates of all steps of a run, relative to the size of a number."""
    if "error_norm" not in run.variables or "solver_rtol" not in run.attrs:
        return 0.0
    return float(run.attrs["solver_rtol"]) * float(np.nansum(run.variables["error_norm"].values))


def _switch_times_passed(run: xr.Dataset) -> dict[str, float]:
    """Return the time of the last row before each switch that a step went over, of those after the start."""
    if PASSED.name not in run.variables:
        return {}
    times, rows = run.variables["time"].values, {}
    names = internal_text(str(run[PASSED.name].attrs["names"])).split()
    for name, first in zip(names, run[FIRST_PASSED.name].values.tolist(), strict=True):
        # nan, which is not equal to itself, stands for a switch that was never passed
        rows[name] = int(np.searchsorted(times, first)) if first == first else 0
    return {name: float(times[row - 1]) for name, row in rows.items() if row}


@dataclass(frozen=True)
class ComparisonPoints:
    """Where the runs of all levels are read.

    Attributes
    ----------
    times : ndarray, s
    crossing_levels : mapping of str to float
        By coordinate.
    places : mapping of str to sequence of (ndarray, ndarray)
        By the name of an event, for each level: those of its events that have a partner in the finest level, and the
        numbers of these.
    occurrences : int
        How many occurrences of every event are compared.
    """

    times: Floats
    crossing_levels: Mapping[str, float]
    places: Mapping[str, Sequence[tuple[Rows, Rows]]]
    occurrences: int = 0


@dataclass(frozen=True)
class Swings:
    """The cycles of a coordinate in one run.

    Attributes
    ----------
    mean : float, s
        The period; nan if there is no whole cycle.
    cycle_count : int
        How many there are, 1 at least.
    uncertainty : float, s
        The largest of a crossing.
    phases : ndarray, rad
        At the times of comparison.
    """

    mean: float
    cycle_count: int
    uncertainty: float
    phases: Floats

    @classmethod
    def of(cls, coordinate_cycles: Cycles, times: Floats) -> Swings:
        """Reduce the crossings of a coordinate to mean period, count, uncertainty and phases."""
        periods = coordinate_cycles.periods
        mean = float(periods.mean()) if periods.size else np.nan
        return cls(
            mean,
            max(1, periods.size),
            float(coordinate_cycles.uncertainties.max(initial=0.0)),
            coordinate_cycles.phase(times),
        )


@dataclass(frozen=True)
class Readings:
    """The numbers of one run that are compared with those of other levels.

    Attributes
    ----------
    observed : mapping of str to (ndarray, ndarray), shape (times, ...)
        Observables at the times of comparison, and their errors by interpolation; last the dimensions of quantities.
    swings : mapping of str to Swings
        By coordinate.
    states_after : mapping of str to mapping of str to (ndarray, ndarray)
        States after the common occurrences of each event by the names of their numbers, and what the location has them
        off by.
    energy_range : float
        nan if it is not asked for.
    defects : mapping of str to ndarray, shape (...)
        Largest local errors, if they are asked for.
    event_errors, largest : mapping of str to ndarray, shape (times, ...) and (...)
        Of the finest run alone: what the uncertain times of events before each time move an observable by, and the
        largest absolute value of each quantity.
    """

    observed: Mapping[str, tuple[Floats, Floats]]
    swings: Mapping[str, Swings]
    states_after: Mapping[str, Mapping[str, tuple[Floats, Floats]]]
    energy_range: float
    defects: Mapping[str, Floats]
    event_errors: Mapping[str, Floats]
    largest: Mapping[str, Floats]

    @classmethod
    def of(
        cls, run: xr.Dataset, subjects: StudyQuantities, common: ComparisonPoints, level: int, *, finest: bool
    ) -> Readings:
        """Read the run of a level.

        Raises
        ------
        InputError
            If an observable cannot be evaluated, or local errors are asked for and the method has a memory.
        """
        model, names, times = subjects.levels.model, subjects.observed, common.times
        observed = observe(run, model, names, times, subjects.levels.rule(level))
        ranged, functions = ENERGY_RANGE in subjects.names, model.functions
        cycles_by_name = {
            name: Swings.of(cycles(run, name, level=crossing, functions=functions), times)
            for name, crossing in common.crossing_levels.items()
        }
        states_by_event = {
            detector: _states_after(run, subjects, detector, places[level][0], common.occurrences)
            for detector, places in common.places.items()
        }
        defects = step_defects(run, subjects.stepped, functions=functions) if subjects.defects else {}
        sized = dict.fromkeys([*names, *subjects.after_events, *([ENERGY] if ranged else [])]) if finest else ()
        return cls(
            observed,
            cycles_by_name,
            states_by_event,
            _value_range(run, ENERGY) if ranged else np.nan,
            {name: np.max(np.abs(defects[name]), axis=0) for name in (subjects.stepped if defects else ())},
            {name: _event_time_errors(run, name, times) for name in names} if finest else {},
            {name: _largest_absolute(whole_of(run), name) for name in sized},
        )


def _states_after(
    run: xr.Dataset, subjects: StudyQuantities, event: str, events: Rows, occurrences: int
) -> dict[str, tuple[Floats, Floats]]:
    """Return states after events, and how far their location may have them off, by the names of the numbers compared."""
    rows_after, rows_before = (rows_named(run, name)[events] for name in ("event_row_after", "event_row_before"))
    uncertainty = run.variables["event_time_uncertainty"].values[events]
    (detector, event_index), full_record, values = subjects.event_place(event), whole_of(run), {}
    for state in subjects.compared_after(detector, occurrences):
        if state.has_value_at(event_index):
            selected = state.selection(event_index)
            states = get_column(full_record, state.state).isel(selected)[rows_after].values
            rate_name = _rate_name(full_record, state.state)
            rates = (
                np.zeros_like(states)
                if rate_name is None
                else get_column(full_record, rate_name).isel(selected)[rows_before].values
            )
            values[state.name] = states, (np.abs(rates).T * uncertainty).T
    return values


def _event_time_errors(run: xr.Dataset, name: str, times: Floats) -> Floats:
    """Return the error of an observable at each time by the uncertain times of events before it."""
    observable = get_column(run, name)
    if "event_time" not in run.variables or not run.sizes["event"]:
        return np.zeros((len(times), *observable.shape[1:]))
    counts = [int((run.variables["event_time"].values < time).sum()) for time in times]
    rates = _step_rates(run, observable, rows_named(run, "event_row_before")[: max(counts, default=0)])
    # contiguous along events, so that sums of an element have the bits that they have alone
    shifts = np.ascontiguousarray(np.abs(rates).T) * run.variables["event_time_uncertainty"].values[: rates.shape[0]]
    return np.array([np.sum(shifts[..., :count], axis=-1).T for count in counts])


def _step_rates(run: xr.Dataset, observable: xr.Variable, rows: NDArray[np.int64]) -> Floats:
    """Return the rate of change of an observable in the step to each row; 0 where a time of an event is repeated."""
    span, change = (
        variable[rows].values - variable[np.maximum(rows - 1, 0)].values
        for variable in (run.variables["time"], observable)
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        rates: Floats = np.where(span > 0.0, change.T / span, 0.0).T
    return rates


def _largest_absolute(run: xr.Dataset, name: str) -> Floats:
    """Return the largest absolute value of a quantity, of every element its own, reading files slab by slab."""
    largest: Floats = np.maximum.reduce([np.max(np.abs(part), axis=0) for part in slabs(get_column(run, name))])
    return largest


def _value_range(run: xr.Dataset, name: str) -> float:
    """Return the largest less the least value of a quantity."""
    ends = [(float(np.max(part)), float(np.min(part))) for part in slabs(run.variables[name])]
    return max(high for high, _ in ends) - min(low for _, low in ends)


def _rate_name(run: xr.Dataset, name: str) -> str | None:
    """Return the name of a variable's rate: of a coordinate, velocity or state; None for other roles."""
    rates = {"coordinate": velocity(name), "velocity": acceleration(name.removeprefix("v_")), "state": rate(name)}
    return rates.get(get_column(run, name).attrs["role"])

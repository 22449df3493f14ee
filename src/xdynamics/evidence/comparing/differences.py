"""Differences of runs at common times: of states and of events, the time at which runs part, and the cause.

Several runs are compared with one reference run, all at the same times.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics import archive, schema
from xdynamics.dynamics.recorded_steps import model_of_record
from xdynamics.elementary.arrays import flattened_rows
from xdynamics.elementary.bounds import EPS
from xdynamics.evidence.comparing.bits import compare_bits, differing_settings
from xdynamics.evidence.comparing.causes import cause_of, is_restated, model_differences
from xdynamics.evidence.comparing.comparison_summary import OF_SEVERAL, ROLE
from xdynamics.evidence.evidence_dataset import (
    Rows,
    attrs_of,
    event_rows_by_name,
    evidence_dataset,
    match_times,
    scale_of,
    scaled_variables,
)
from xdynamics.evidence.observables import is_comparable, observe
from xdynamics.evidence.sampling import sample
from xdynamics.faults import InputError
from xdynamics.methods.scheme import DOUBLE_DOUBLE, FLOAT64
from xdynamics.record import shapes_of
from xdynamics.record.arguments import precision_of
from xdynamics.record.flag_words import time_unit_of
from xdynamics.record.schemas import rows_apart
from xdynamics.record.unfolding import element_labels
from xdynamics.shapes.naming import join_element_name
from xdynamics.units import parse_unit, unit_suffix

Floats = NDArray[np.float64]
Functions = Mapping[str, Callable[..., float]]

NONE = np.zeros(0, np.int64)  # events
# attributes that differ with it
FOLLOWING_PRECISION = ("precision", "solver_summation", "rest_", "force_digest", schema.SERIES_ARITHMETIC)
ROUNDINGS = 64.0  # of the largest value, by which runs that agree but for rounding may differ


def compare_runs(
    first: xr.Dataset,
    second: xr.Dataset,
    times: Floats | None,
    functions: Functions | None,
    occurrences: int | None = None,
) -> xr.Dataset:
    """Compare two runs, and the first occurrences of their events or all of them; see `compare`.

    Raises
    ------
    InputError
        If the runs have no time or no quantity in common, or a time is outside one of them.
    """
    sample_times = common_times(first, second) if times is None else times
    names = shared_names(first, second)
    lazy = any(run.variables[name].chunks is not None for run in (first, second) for name in ("time", *names))
    samples = [_sample_run(run, names, sample_times, functions, lazy=lazy) for run in (first, second)]
    variables = difference_variables(first, second, sample_times, samples)
    digests = [archive.digest_of_run(run) for run in (first, second)]
    if lazy:
        return comparison_dataset(first, second, digests, variables, {})
    if is_restated(first, second):
        second = second.assign(model_toml=first["model_toml"]).assign_attrs(model_digest=first.attrs["model_digest"])
    table = compare_bits(first, second)
    variables |= {str(name): (entry.dims, entry.values, entry.attrs) for name, entry in table.items()}
    variables |= dict(event_differences(first, second, occurrences))
    attributes = (
        table.attrs | model_differences(first, second) | {"settings": "\n".join(differing_settings(first, second))}
    )
    attributes |= {
        "events": "\n".join(event_count_differences(first, second)),
        "parted": parting_text(variables, first, names, times_between(first, second, sample_times)),
    }
    if rounding_text := rounding_note(first, second):
        attributes["rounding"] = rounding_text
    attributes |= {"cause": cause_of(attributes)}
    return comparison_dataset(first, second, digests, variables, attributes)


def difference_variables(
    first: xr.Dataset, second: xr.Dataset, times: Floats, samples: Sequence[Mapping[str, tuple[Any, Any, Any]]]
) -> dict[str, Any]:
    """Return times, and differences of what both runs were sampled of: values, interpolation errors and rests."""
    variables: dict[str, Any] = {schema.AT_TIME: times_variable(first, times)}
    for name in shared_names(first, second):
        variables |= difference_of(
            name, *(run.variables[name] for run in (first, second)), *(entry.get(name) for entry in samples)
        )
    return variables


def comparison_dataset(
    first: xr.Dataset,
    second: xr.Dataset,
    digests: Sequence[str],
    variables: Mapping[str, Any],
    attributes: Mapping[str, Any],
) -> xr.Dataset:
    """Return the Dataset of a comparison of two runs."""
    return evidence_dataset(
        "comparison", title_of(first, second), digests, variables, attributes, shapes=shapes_of(first)
    )


def rounding_note(first: xr.Dataset, second: xr.Dataset) -> str:
    """Attribute differences to rounding, where one run repeats the steps of the other with more digits."""
    kinds = [precision_of(run.attrs) for run in (first, second)]
    differing_lines = [line for line in differing_settings(first, second) if not line.startswith(FOLLOWING_PRECISION)]
    same_steps = all(run.attrs["solver_step_control"] != "adaptive" for run in (first, second))
    if (
        kinds[0] == kinds[1]
        or differing_lines
        or not same_steps
        or first.attrs["model_digest"] != second.attrs["model_digest"]
    ):
        return ""
    which = "first" if kinds[0] == FLOAT64 else "second"
    return f"the differences are the rounding error of the {which} run: the other is the same with 31 digits"


def title_of(first: xr.Dataset, second: xr.Dataset) -> str:
    """Return the title of a comparison."""
    titles = [str(run.attrs["title"]) for run in (first, second)]
    return f"{titles[0]}, two runs" if titles[0] == titles[1] else ", beside ".join(titles)


def times_variable(first: xr.Dataset, times: Floats) -> tuple[tuple[str], Floats, dict[str, Any]]:
    """Return the times of a comparison as a variable."""
    return (schema.AT,), times, attrs_of(time_unit_of(first).text, "time of comparison", "time")


def common_times(*runs: xr.Dataset) -> Floats:
    """Return every accepted time, shape (k,), of some run that all runs reach.

    Raises
    ------
    InputError
        If there is none, or the times of a run decrease.
    """
    grids, unit = [np.asarray(run["time"]) for run in runs], unit_suffix(time_unit_of(runs[0]))
    words = ("first", "second") if len(runs) == 2 else [f"{number}." for number in range(1, len(runs) + 1)]
    for which, grid in zip(words, grids, strict=True):
        # negated, so that a time that is nan is refused too
        if (wrong := np.flatnonzero(~(np.diff(grid) >= 0.0))).size:
            raise InputError(
                f"the times of the {which} run do not increase after t = {float(grid[wrong[0]])!r}{unit}, as a run's do"
            )
    begin, end = max(grid[0] for grid in grids), min(grid[-1] for grid in grids)
    if begin > end:
        spans = [f"{float(grid[0])!r}{unit} to {float(grid[-1])!r}{unit}" for grid in grids]
        raise InputError(f"the runs have no time in common: one goes from {', the other from '.join(spans)}")
    union: Floats = np.unique(np.concatenate(grids))
    for run, grid in zip(runs, grids, strict=True):
        if rows_apart(run.attrs) > 1:  # nothing is known between the rows that were kept
            union = union[np.isin(union, grid)]
    shared_times: Floats = union[(union >= begin) & (union <= end)]
    if not shared_times.size:
        raise InputError(
            "the runs have no recorded time in common: keep_every left out the rows between; run one of them again with"
            " keep_every = 1"
        )
    return shared_times


def shared_names(first: xr.Dataset, second: xr.Dataset) -> list[str]:
    """Name the variables of the state, and those that follow from it, that both runs have.

    Raises
    ------
    InputError
        If there is none, or one has other dimensions in the other run.
    """
    roles = (*schema.INTEGRATED, "energy", "observable")
    names = [
        str(name)
        for name, variable in first.variables.items()
        if variable.attrs.get("role") in roles
        and name not in first.coords
        and name in second.variables
        and name not in second.coords
        and variable.dims == second.variables[name].dims
        and variable.dims[:1] == (schema.STEPS,)
    ]
    if not names:
        raise InputError("the runs have no coordinate, velocity, state or observable in common")
    for name in names:
        units = [parse_unit(str(run.variables[name].attrs["units"])) for run in (first, second)]
        if units[0].dimension != units[1].dimension:
            raise InputError(f"'{name}' is in '{units[0].text}' in one run and '{units[1].text}' in the other")
    return names


def _sample_run(
    run: xr.Dataset, names: Sequence[str], times: Floats, functions: Functions | None, *, lazy: bool
) -> dict[str, tuple[Any, Any, Any]]:
    """Return values, interpolation errors and rests at times; on dask arrays of states only."""
    doubled = precision_of(run.attrs) == DOUBLE_DOUBLE
    states = sample(run, times, functions=functions) if lazy or doubled else None
    if states is not None and lazy:
        return {
            name: (states[name].data, states[schema.error(name)].data, _rest_data(states, name))
            for name in names
            if name in states
        }
    model = model_of_record(run, functions)
    observed = observe(run, model, [name for name in names if is_comparable(model, name)], times)
    return {name: (*numbers, _rest_data(states, name)) for name, numbers in observed.items()}


def _rest_data(states: xr.Dataset | None, name: str) -> Any:
    """Return the rest of a number beside its float; 0 where numbers are plain floats."""
    rest_name = schema.rest_name(name)
    return 0.0 if states is None or rest_name not in states else states[rest_name].data


def difference_of(
    name: str, first: xr.Variable, second: xr.Variable, first_sample: Any, second_sample: Any
) -> dict[str, Any]:
    """Return the difference of one quantity, in the units of the first run."""
    if first_sample is None or second_sample is None:
        return {}
    units = [parse_unit(str(run.attrs["units"])) for run in (first, second)]
    factor = float(units[1].factor / units[0].factor)
    text = str(first.attrs["units"])
    dims = (schema.AT, *map(str, first.dims[1:]))
    # floats cancel first, so that rests are added to a small number and are not rounded away
    difference = (second_sample[0] * factor - first_sample[0]) + (second_sample[2] * factor - first_sample[2])
    scale_text = f"largest size of {name} of the first run at the times compared; where that is 0, of the second"
    return scaled_variables(
        "difference", name, difference, scale_of(first_sample[0], second_sample[0] * factor), dims, text, scale_text
    ) | {
        f"difference_{name}": (dims, difference, attrs_of(text, f"{name}, second run minus first", ROLE)),
        f"interpolation_error_{name}": (
            dims,
            second_sample[1] * factor + first_sample[1],
            attrs_of(
                text, f"estimated error of interpolating {name} between accepted states, both runs together", "error"
            ),
        ),
    }


def event_differences(
    first: xr.Dataset, second: xr.Dataset, occurrences: int | None = None
) -> Iterator[tuple[str, Any]]:
    """Compare the times of events of one name, occurrence by occurrence, at most the first `occurrences`."""
    events = [event_rows_by_name(run) for run in (first, second)]
    pairs = {
        name: tuple(paired[:occurrences] for paired in _pair_events(first, second, rows, events[1].get(name, NONE)))
        for name, rows in events[0].items()
    }
    max_occurrences = max((len(first_rows) for first_rows, _ in pairs.values()), default=0)
    for name, (first_rows, second_rows) in pairs.items():
        if not len(first_rows):
            continue
        difference, uncertainty = np.full((2, max_occurrences), np.nan)
        difference[: len(first_rows)] = (
            second["event_time"].values[second_rows] - first["event_time"].values[first_rows]
        )
        if schema.REST_EVENT_TIME.name in first or schema.REST_EVENT_TIME.name in second:
            rests = [_rests_of_events(run)[rows] for run, rows in ((first, first_rows), (second, second_rows))]
            difference[: len(first_rows)] += rests[1] - rests[0]
        uncertainties = [
            run["event_time_uncertainty"].values[rows] for run, rows in ((first, first_rows), (second, second_rows))
        ]
        uncertainty[: len(first_rows)] = uncertainties[0] + uncertainties[1]
        start = float(first["time"][0])
        elapsed = [run["event_time"].values[rows] - start for run, rows in ((first, first_rows), (second, second_rows))]
        yield from event_difference(name, time_unit_of(first).text, difference, uncertainty, scale_of(*elapsed)).items()


def _rests_of_events(run: xr.Dataset) -> Floats:
    """Return the rests of event times beside their floats."""
    name = schema.REST_EVENT_TIME.name
    return np.asarray(run[name].values) if name in run else np.zeros(run["event_time"].size)


def event_difference(name: str, units: str, difference: Any, uncertainty: Any, scale: Any) -> dict[str, Any]:
    """Return the differences of one event's times, with their uncertainties and scale."""
    scale_text = f"longest time from the start of the first run to its {name}; where that is 0, of the second"
    return (
        {
            f"difference_event_time_{name}": (
                (schema.OCCURRENCE,),
                difference,
                attrs_of(units, f"time of {name}, second run minus first", ROLE),
            )
        }
        | scaled_variables(
            "difference", f"event_time_{name}", difference, scale, (schema.OCCURRENCE,), units, scale_text
        )
        | {
            f"interpolation_error_event_time_{name}": (
                (schema.OCCURRENCE,),
                uncertainty,
                attrs_of(units, f"uncertainty of locating {name}, both runs together", "error"),
            )
        }
    )


def _pair_events(first: xr.Dataset, second: xr.Dataset, first_rows: Rows, second_rows: Rows) -> tuple[Rows, Rows]:
    """Return the events of one name that both runs met."""
    mine, theirs = match_times(first["event_time"].values[first_rows], second["event_time"].values[second_rows])
    return first_rows[mine], second_rows[theirs]


def event_count_differences(first: xr.Dataset, second: xr.Dataset) -> Iterator[str]:
    """List the events that the runs did not meet equally often."""
    events = [event_rows_by_name(run) for run in (first, second)]
    for name in dict.fromkeys([*events[0], *events[1]]):
        counts = [len(rows.get(name, NONE)) for rows in events]
        if counts[0] != counts[1]:
            yield f"{name}: {counts[0]} | {counts[1]}"


def parting_text(variables: Mapping[str, Any], first: xr.Dataset, names: Sequence[str], between_events: Any) -> str:
    """Describe when a quantity is first further apart than interpolation and rounding can be."""
    times, earliest, sentence = variables[schema.AT_TIME][1], np.inf, ""
    for name in names:
        if f"difference_{name}" not in variables:
            continue
        difference, uncertainty = (variables[f"{kind}_{name}"][1] for kind in ("difference", "interpolation_error"))
        rounding = ROUNDINGS * EPS * np.fmax.reduce(np.abs(first.variables[name].values))
        away = (np.abs(difference) > uncertainty + rounding).T & ~between_events
        beyond = np.flatnonzero(flattened_rows(away.T).any(axis=1))
        if beyond.size and times[beyond[0]] < earliest:
            k, units = int(beyond[0]), variables[f"difference_{name}"][2]["units"]
            earliest, first_variable, worst_index = (
                float(times[k]),
                first.variables[name],
                (k, *np.argwhere(away.T[k])[0].tolist()),
            )
            labels = (
                element_labels(first, str(dim))[number]
                for dim, number in zip(first_variable.dims[1:], worst_index[1:], strict=True)
            )
            sentence = (
                f"t = {earliest:.9g}{unit_suffix(time_unit_of(first))}: {join_element_name(name, labels)} by"
                f" {float(difference[worst_index]):.3g}{unit_suffix(units)}, beyond an interpolation error of"
                f" {float(uncertainty[worst_index]):.2g}{unit_suffix(units)}"
            )
    return sentence


def times_between(first: xr.Dataset, second: xr.Dataset, sample_times: Floats) -> NDArray[np.bool_]:
    """Mark the times at which one run has met an event that the other is about to meet, within their uncertainties."""
    is_between, events = np.zeros(sample_times.shape, bool), [event_rows_by_name(run) for run in (first, second)]
    for name, rows in events[0].items():
        first_rows, second_rows = _pair_events(first, second, rows, events[1].get(name, NONE))
        times = [run["event_time"].values[rows] for run, rows in ((first, first_rows), (second, second_rows))]
        uncertainty = (
            first["event_time_uncertainty"].values[first_rows] + second["event_time_uncertainty"].values[second_rows]
        )
        for first_time, second_time, width in zip(*times, uncertainty, strict=True):
            if abs(first_time - second_time) <= width:
                is_between |= (sample_times >= min(first_time, second_time) - width) & (
                    sample_times <= max(first_time, second_time) + width
                )
    return is_between


RUN = "run"  # a dimension
# what a comparison has as attributes, and what each is
TOLD = {
    "cause": "the first of what differs from the reference",
    "parted": "when the run is first further from the reference than interpolation can be off; empty if nowhere",
    "first_difference": "the first bit that differs",
    "model": "lines of the model that differ",
    "parameters": "parameters that differ",
    "initial": "initial values that differ",
    "settings": "settings that differ",
    "events": "events that were not met equally often",
}


def compare_each(
    first: xr.Dataset,
    other_runs: Mapping[str, xr.Dataset],
    times: NDArray[np.float64] | None,
    functions: Mapping[str, Callable[..., float]] | None,
) -> xr.Dataset:
    """Compare runs with a first one, as `compare` does for one; its attributes are variables along `run` here.

    Raises
    ------
    InputError
        If the runs have no time or no quantity in common, or no two are given.
    """
    if not other_runs:
        raise InputError("second has no run; give one at least")
    sample_times = common_times(first, *other_runs.values()) if times is None else times
    comparisons = [compare_runs(first, run, sample_times, functions) for run in other_runs.values()]
    max_occurrences = max(comparison.sizes.get(schema.OCCURRENCE, 0) for comparison in comparisons)
    shared = [
        name for name in comparisons[0].data_vars if all(_is_apart(comparison, name) for comparison in comparisons)
    ]
    padded_comparisons = [
        comparison[shared].pad({schema.OCCURRENCE: (0, max_occurrences - comparison.sizes[schema.OCCURRENCE])})
        if schema.OCCURRENCE in comparison.dims
        else comparison[shared]
        for comparison in comparisons
    ]
    variables: dict[str, Any] = {schema.AT_TIME: times_variable(first, sample_times)}
    variables["run_name"] = (
        (RUN,),
        np.array([*other_runs]),
        attrs_of("1", "which run is compared with the reference", "name"),
    )
    variables["identical"] = (
        (RUN,),
        np.array([int(comparison.attrs["identical"]) for comparison in comparisons], np.int8),
        attrs_of("1", "1 where the run is the reference, bit for bit", ROLE),
    )
    for word, long_name in TOLD.items():
        variables[word] = (
            (RUN,),
            np.array([str(comparison.attrs.get(word, "")) for comparison in comparisons]),
            attrs_of("1", long_name, ROLE),
        )
    for name in shared:
        rows = [comparison[str(name)].variable for comparison in padded_comparisons]
        variables[str(name)] = (RUN, *rows[0].dims), np.stack([row.values for row in rows]), dict(rows[0].attrs)
        if str(name).startswith("difference_") and rows[0].dims:
            largest = np.array([np.nanmax(np.abs(row.values), initial=0.0) for row in rows])
            of_largest = attrs_of(str(rows[0].attrs["units"]), f"largest size of {name}", ROLE)
            variables[f"largest_{name}"] = (RUN,), largest, of_largest
    title = f"{first.attrs['title']}, and {len(other_runs)} runs beside it"
    digests = [archive.digest_of_run(run) for run in (first, *other_runs.values())]
    attributes = {"identical": int(all(comparison.attrs["identical"] for comparison in comparisons))}
    return evidence_dataset(OF_SEVERAL, title, digests, variables, attributes, shapes=shapes_of(first))


def _is_apart(comparison: xr.Dataset, name: Any) -> bool:
    """Whether a variable of a comparison is of numbers that differ, not of single bits."""
    return name in comparison and {*comparison[name].dims} <= {schema.AT, schema.OCCURRENCE, *comparison.coords} | {
        *shapes_of(comparison).extents
    }

"""Two sweeps compared member by member: their differences, the uncertainty of these, and settings that differ."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.evidence.comparing.causes import model_differences
from xdynamics.evidence.evidence_dataset import attrs_of, evidence_dataset
from xdynamics.evidence.grid_axes import (
    ASKED,
    AXES,
    AXIS,
    VARIES,
    WHAT,
    member_number_names,
    rounding_floors,
    sweep_axis_names,
    sweep_of,
)
from xdynamics.faults import InputError, first_names
from xdynamics.record.flag_words import words_of_flag
from xdynamics.schema import AT, AT_TIME, OCCURRENCE, ROOT_DIGEST, flag_attributes
from xdynamics.shapes.naming import display_text, internal_text
from xdynamics.units import parse_unit, unit_suffix
from xdynamics.units.digits import short_number, with_uncertainty

KIND = "sweep comparison"
LEVELS = ("step", "rtol")  # kinds of axes whose members are levels of one another
DIFFERS, WITHIN, UNKNOWN = range(3)
VERDICTS = ("differs", "within", "unknown")
SAFETY = (3.0, 1.25)  # of two levels, of more
LAWS = ("xdynamics_version", "math_functions", "solver_event_root_method", "solver_event_start", "atol_floor_rule")
CAUSES = {  # and what each line of them is of
    "model": "model",
    "parameters": "parameter",
    "initial": "initial",
    "settings": "setting",
    "units": "unit",
    "versions": "version",
}
Labels = list[tuple[Any, ...]]


def compare_sweeps(first: xr.Dataset, second: xr.Dataset) -> xr.Dataset:
    """Compare the members that two sweeps share, matched by their axis values in any order or unit.

    Returns
    -------
    xarray.Dataset
        Along the axes of both: of each number y ``difference_y`` (second minus first, in the units of the first),
        ``uncertainty_y`` of it (see Notes; nan where nothing tells it), ``verdict_y`` (a flag: ``differs`` by more than
        that, ``within`` it, ``unknown``), and ``outcome_differs``. Attributes: `cause` names the first of what differs,
        `model`, `parameters`, `initial`, `settings`, `units`, `versions` (a line each); `identical`; `members`,
        `alone_in_first` and `alone_in_second` (values of axes that only one has). Lazy where the sweeps are, and then
        without `identical`.

    Raises
    ------
    InputError
        If they have not the same axes, or no member in common.

    Notes
    -----
    Where an axis is one of steps or tolerances, what a member is uncertain by follows from its neighbours along it, for an
    order of one at least: d r/(r - 1), d the difference to the next finer level and r the ratio of both, and of the finest
    d/(r - 1), times 1.25, or 3 of two levels alone (P. J. Roache, Perspective: A Method for Uniform Reporting of Grid
    Refinement Studies, J. Fluids Eng. 116 (1994), doi:10.1115/1.2910291). Else it is what the sweep kept of it,
    ``y_uncertainty``. Those of both sweeps are added.
    """
    first, second = sweep_of(first), sweep_of(second)
    second, restated = _with_axes_of(first, second)
    dims = _axis_dims(first)
    places, unmatched_labels = _common_places(first, second, dims)
    first_members, second_members = (
        first.isel({dim: member_indices for dim, (member_indices, _) in places.items()}),
        second.isel({dim: member_indices for dim, (_, member_indices) in places.items()}),
    )
    variables: dict[str, Any] = {}
    for dim in dims:
        variables |= {str(name): _as_tuple(first_members, name) for name in _axis_columns(first_members, dim)}
    if AT in places:
        variables[AT_TIME] = _as_tuple(first_members, AT_TIME)
    units = [*restated]
    floors = rounding_floors(first), rounding_floors(second)
    for name in member_number_names(first_members):
        if name in second_members.variables and {*first_members[name].dims} == {*second_members[name].dims}:
            variables |= _number_comparison(
                name,
                first_members,
                second_members,
                _unit_ratio(name, first_members, second_members, units),
                (_member_uncertainty(first, name, places, 0), _member_uncertainty(second, name, places, 1)),
                tuple(floor.get(name, 0.0) for floor in floors),
            )
    variables["outcome_differs"] = _outcome(first_members, second_members)
    attributes = _difference_attributes(first, second, units) | {
        AXES: str(first.attrs[AXES]),
        "members": int(np.prod([first_members.sizes[dim] for dim in dims])),
        "alone_in_first": "\n".join(unmatched_labels[0]),
        "alone_in_second": "\n".join(unmatched_labels[1]),
    }
    differing_sections = {section: attributes[section] for section in CAUSES if attributes[section]}
    attributes["cause"] = next(
        (f"{section}: {_first_line(lines)}" for section, lines in differing_sections.items()), ""
    )
    if first_members["run_digest"].chunks is None and second_members["run_digest"].chunks is None:
        same = first_members["run_digest"].variable == second_members["run_digest"].variable.transpose(
            *first_members["run_digest"].dims
        )
        attributes["identical"] = int(
            not (differing_sections or unmatched_labels[0] or unmatched_labels[1]) and bool(same.all())
        )
    digests = [str(sweep.attrs.get("sweep_digest", sweep.attrs.get(ROOT_DIGEST, ""))) for sweep in (first, second)]
    title = f"{str(first.attrs['title']).partition(':')[0]}: two sweeps over {', '.join(dims)}"
    comparison = evidence_dataset(KIND, title, digests, variables, attributes)
    return comparison.set_coords([name for name in variables if name in first_members.coords])


def _as_tuple(sweep: xr.Dataset, name: Any) -> tuple[Any, ...]:
    variable = sweep[name].variable
    return variable.dims, variable.values, dict(variable.attrs)


def _axis_dims(sweep: xr.Dataset) -> list[str]:
    return [dim for dim in sweep_axis_names(sweep) if dim in sweep.dims]


def _axis_columns(sweep: xr.Dataset, dim: str) -> list[Any]:
    """Return the names of the varied quantities along an axis."""
    return [
        name
        for name, variable in sweep.variables.items()
        if variable.attrs.get(AXIS) == dim and variable.dims == (dim,)
    ]


def _varied(sweep: xr.Dataset, dim: str) -> tuple[tuple[str, str], ...]:
    """Return kind and name of the varied quantities along an axis, whatever the dimension is called."""
    attributes = [sweep.variables[name].attrs for name in _axis_columns(sweep, dim)]
    return tuple(sorted((str(attrs[VARIES]), display_text(internal_text(str(attrs[WHAT])))) for attrs in attributes))


def _with_axes_of(first: xr.Dataset, second: xr.Dataset) -> tuple[xr.Dataset, list[str]]:
    """Return the second sweep with its axes named as in the first, and the units of axes that differ."""
    first_axes, second_axes = ({_varied(sweep, dim): dim for dim in _axis_dims(sweep)} for sweep in (first, second))
    for these, those, where in ((first_axes, second_axes, "second"), (second_axes, first_axes, "first")):
        if missing := [dim for varied, dim in these.items() if varied not in those]:
            raise InputError(
                f"the {where} sweep has no axis like '{missing[0]}'; select one value of it in the other, as in"
                f" sweep.isel({missing[0]}=0)"
            )
    names = {second_axes[varied]: dim for varied, dim in first_axes.items() if second_axes[varied] != dim}
    second = second.rename(names) if names else second
    for variable in second.variables.values():
        if variable.attrs.get(AXIS) in names:
            variable.attrs = variable.attrs | {AXIS: names[variable.attrs[AXIS]]}
    units = []
    for dim in first_axes.values():
        for name, second_name in zip(_by_what(first, dim), _by_what(second, dim), strict=True):
            pair = [str(sweep[column].attrs["units"]) for sweep, column in ((first, name), (second, second_name))]
            units += [f"{name}: {pair[0]} | {pair[1]}"] if pair[0] != pair[1] else []
    return second, units


def _by_what(sweep: xr.Dataset, dim: str) -> list[Any]:
    return sorted(
        _axis_columns(sweep, dim), key=lambda name: (str(sweep[name].attrs[VARIES]), str(sweep[name].attrs[WHAT]))
    )


def _place_labels(sweep: xr.Dataset, dim: str) -> Labels:
    """Return the axis values of each index along a dimension, in SI units."""
    if dim == AT:
        return [(time,) for time in np.atleast_1d(sweep[AT_TIME].values).tolist()]
    if dim == OCCURRENCE:
        return [(number,) for number in sweep["occurrence_number"].values.tolist()]
    parts = []
    for name in _by_what(sweep, dim):
        variable = sweep[name].variable
        unit = parse_unit(str(variable.attrs["units"])) if variable.dtype.kind in "fiu" else None
        parts.append([value if unit is None else unit.to_si(value) for value in variable.values.tolist()])
    return [*zip(*parts, strict=True)]


def _common_places(
    first: xr.Dataset, second: xr.Dataset, dims: list[str]
) -> tuple[dict[str, tuple[NDArray[np.int64], NDArray[np.int64]]], tuple[list[str], list[str]]]:
    """Return the common indices in each sweep, by dimension, and the unmatched axis values in words."""
    places, unmatched_labels = {}, ([], [])  # type: tuple[dict[str, Any], tuple[list[str], list[str]]]
    further = [dim for dim in (AT, OCCURRENCE) if dim in first.dims and dim in second.dims]
    for dim in [*dims, *further]:
        first_labels, second_labels = _place_labels(first, dim), _place_labels(second, dim)
        # reversed, so that of equal labels the first one counts
        where = {label: k for k, label in reversed([*enumerate(second_labels)])}
        pairs = [(k, where[label]) for k, label in enumerate(first_labels) if label in where]
        if not pairs:
            raise InputError(
                f"no value of '{dim}' is in both sweeps: {_range_text(first, dim)} there, {_range_text(second, dim)} here"
            )
        places[dim] = tuple(np.array(numbers, np.int64) for numbers in zip(*pairs, strict=True))
        for number, (sweep, shared_places) in enumerate(zip((first, second), places[dim], strict=True)):
            left = np.setdiff1d(np.arange(sweep.sizes[dim]), shared_places)
            if left.size and dim in dims:
                unmatched_labels[number].append(first_names([_place_text(sweep, dim, int(k)) for k in left]))
    return places, unmatched_labels


def _place_text(sweep: xr.Dataset, dim: str, k: int) -> str:
    return ", ".join(
        f"{name} = {sweep[name].values[k]}{unit_suffix(str(sweep[name].attrs['units']))}"
        for name in _axis_columns(sweep, dim)
    )


def _range_text(sweep: xr.Dataset, dim: str) -> str:
    if dim in (AT, OCCURRENCE):
        return first_names([str(label[0]) for label in _place_labels(sweep, dim)])
    return first_names([_place_text(sweep, dim, k) for k in range(sweep.sizes[dim])])


def _unit_ratio(name: str, first: xr.Dataset, second: xr.Dataset, units: list[str]) -> float:
    """Return the factor from the second's unit to the first's, and note where the units differ."""
    pair = [str(sweep[name].attrs["units"]) for sweep in (first, second)]
    if pair[0] == pair[1]:
        return 1.0
    first_unit, second_unit = map(parse_unit, pair)
    if first_unit.dimension != second_unit.dimension:
        raise InputError(f"'{name}' has the unit '{pair[0]}' in the first sweep and '{pair[1]}' in the second")
    units.append(f"{name}: {pair[0]} | {pair[1]}")
    return float(second_unit.factor / first_unit.factor)


def _member_uncertainty(sweep: xr.Dataset, name: str, places: Mapping[str, Any], which: int) -> xr.Variable | None:
    """Return the uncertainty of the compared members of a sweep; None if it is unknown."""
    doubt = uncertainty_of(sweep, name)
    if doubt is None:
        return None
    return doubt.isel({dim: pair[which] for dim, pair in places.items() if dim in doubt.dims})


def uncertainty_of(sweep: xr.Dataset, name: str) -> xr.Variable | None:
    """Return the numerical uncertainty of a number of each member, in its unit; None if it is unknown.

    From the neighbours along axes of steps and tolerances, or as it was kept; see `compare_sweeps`.
    """
    levels = [dim for dim in _axis_dims(sweep) if dim in sweep[name].dims and _varied(sweep, dim)[0][0] in LEVELS]
    levels = [dim for dim in levels if len(_varied(sweep, dim)) == 1 and sweep.sizes[dim] > 1]
    kept_name = f"{name}_uncertainty"
    if not levels:
        return sweep[kept_name].variable if kept_name in sweep.variables else None
    total: xr.DataArray = sum(map(partial(_by_levels, sweep, name), levels))  # type: ignore[assignment]
    return total.variable.transpose(*sweep[name].dims)


def _by_levels(sweep: xr.Dataset, name: str, dim: str) -> xr.DataArray:
    sizes = np.array([float(label[0]) for label in _place_labels(sweep, dim)])
    order = np.argsort(-sizes, kind="stable")
    fine = sweep[name].reset_coords(drop=True).drop_vars(dim, errors="ignore").isel({dim: order})
    ratio = xr.DataArray(sizes[order][:-1] / sizes[order][1:], dims=dim)
    level_differences = abs(fine.isel({dim: slice(None, -1)}) - fine.isel({dim: slice(1, None)}))
    level_uncertainties = xr.concat(
        [level_differences * ratio / (ratio - 1.0), (level_differences / (ratio - 1.0)).isel({dim: [-1]})], dim
    )
    # argsort of a permutation is its inverse, which restores the order of the axis
    return SAFETY[len(sizes) > 2] * level_uncertainties.isel({dim: np.argsort(order)})


def _number_comparison(
    name: str,
    first_members: xr.Dataset,
    second_members: xr.Dataset,
    factor: float,
    doubts: tuple[xr.Variable | None, xr.Variable | None],
    floors: tuple[Any, ...],
) -> dict[str, Any]:
    """Return the difference of a number, its uncertainty and the verdict, as variables."""
    first_variable = first_members[name].variable
    second_variable, (first, second) = second_members[name].variable.transpose(*first_variable.dims), doubts
    doubt = (
        None
        if first is None or second is None
        else first.transpose(*first_variable.dims) + second.transpose(*first_variable.dims) * factor
    )
    floor = floors[0] + floors[1] * factor
    return judged_difference(name, first_variable, second_variable * factor, doubt, floor, "second sweep minus first")


def judged_difference(
    name: str, reference: xr.Variable, compared: xr.Variable, doubt: xr.Variable | None, floor: Any, subtraction: str
) -> dict[str, Any]:
    """Return, as variables, how far a number is from another one of its unit, by how much that is uncertain, and the verdict.

    Parameters
    ----------
    name : str
    reference, compared : xarray.Variable
        Of the same dimensions; `reference` has the attributes.
    doubt : xarray.Variable, optional
        What the difference is uncertain by; None where nothing tells it.
    floor : xarray.Variable or float
        What rounding alone may leave of it.
    subtraction : str
        What is subtracted from what.
    """
    difference = compared - reference
    doubt = xr.full_like(difference.astype(float), np.nan) if doubt is None else doubt.astype(float)
    is_same = (abs(difference) <= floor) | (reference.isnull() & compared.isnull())
    is_far = (doubt.notnull() & (abs(difference) > doubt)) | (difference.isnull() & ~is_same)
    is_unknown = ~is_same & ~is_far & doubt.isnull()
    verdict = WITHIN + (DIFFERS - WITHIN) * (is_far & ~is_same) + (UNKNOWN - WITHIN) * is_unknown
    units, long_name = str(reference.attrs["units"]), str(reference.attrs["long_name"])
    return {
        f"difference_{name}": (
            reference.dims,
            difference.data,
            attrs_of(units, f"{long_name}, {subtraction}", "difference"),
        ),
        f"uncertainty_{name}": (
            reference.dims,
            doubt.data,
            attrs_of(units, f"numerical uncertainty of difference_{name}; nan where nothing tells it", "error"),
        ),
        f"verdict_{name}": (
            reference.dims,
            verdict.astype(np.int8).data,
            attrs_of("1", f"whether difference_{name} is more than its uncertainty", "flag")
            | flag_attributes(dict(enumerate(VERDICTS))),
        ),
    }


def _outcome(first_members: xr.Dataset, second_members: xr.Dataset) -> tuple[Any, ...]:
    first_outcomes = first_members["run_outcome"].variable
    differs = (first_outcomes != second_members["run_outcome"].variable.transpose(*first_outcomes.dims)).astype(np.int8)
    return (first_outcomes.dims, differs.data, attrs_of("1", "1 where the runs ended in different ways", "difference"))


def _difference_attributes(first: xr.Dataset, second: xr.Dataset, units: list[str]) -> dict[str, Any]:
    """Return the differences of settings between two sweeps, by name."""
    sweep_settings = [json.loads(str(sweep.attrs.get(ASKED, "{}"))) for sweep in (first, second)]
    settings = [
        f"{key}: {_setting_text(sweep_settings[0], key)} | {_setting_text(sweep_settings[1], key)}"
        for key in dict.fromkeys([*sweep_settings[0], *sweep_settings[1]])
        if sweep_settings[0].get(key) != sweep_settings[1].get(key)
    ]
    versions = [
        f"{key}: {first.attrs.get(key, 'absent')} | {second.attrs.get(key, 'absent')}"
        for key in LAWS
        if first.attrs.get(key) != second.attrs.get(key)
    ]
    model_lines = model_differences(first, second) if "model_toml" in first and "model_toml" in second else {}
    varied = {
        name for dim in _axis_dims(first) for _, name in _varied(first, dim)
    }  # whose value in the model no member has
    model_lines = {
        name: "\n".join(line for line in text_lines.splitlines() if line.partition(":")[0] not in varied)
        for name, text_lines in model_lines.items()
    }
    lines = {"settings": settings, "units": units, "versions": versions}
    none = dict.fromkeys(CAUSES, "")
    return none | model_lines | {name: "\n".join(text_lines) for name, text_lines in lines.items()}


def _setting_text(settings: Mapping[str, Any], key: str) -> str:
    return str(settings[key]) if key in settings else "absent"


def _first_line(lines: str) -> str:
    first, *further_lines = lines.splitlines()
    return f"{first}, and {len(further_lines)} more" if further_lines else first


def sweep_comparison_lines(comparison: xr.Dataset) -> Iterator[str]:
    """Describe a comparison of sweeps: differing settings, unmatched members, largest difference of each number."""
    if comparison.attrs.get("identical"):
        yield f"the same sweep: {comparison.attrs['members']} members, bit for bit"
        return
    for section, word in CAUSES.items():
        yield from (f"{word:<10}{line}" for line in str(comparison.attrs[section]).splitlines())
    yield f"members   {comparison.attrs['members']} in both"
    for where in ("first", "second"):
        yield from (
            f"alone     in the {where}, {line}" for line in str(comparison.attrs[f"alone_in_{where}"]).splitlines()
        )
    yield from difference_lines(comparison)
    if differing := int(comparison["outcome_differs"].sum()):
        yield f"outcomes  {differing} ended in different ways"


def difference_lines(comparison: xr.Dataset) -> Iterator[str]:
    """State for each number how many members differ, and which differs most."""
    for name in [
        str(name)[len("difference_") :] for name in comparison.data_vars if str(name).startswith("difference_")
    ]:
        words = words_of_flag(comparison[f"verdict_{name}"])
        counts = ", ".join(
            f"{words.count(word)} {word.replace('differs', 'differ')}" for word in VERDICTS if word in words
        )
        values = np.abs(comparison[f"difference_{name}"].values)
        if not np.isfinite(values).any():
            yield f"{name}: {counts}"
            continue
        if not np.nanmax(values):
            yield f"{name}: {counts}, all the same"
            continue
        worst_index = np.unravel_index(int(np.nanargmax(values)), values.shape)
        value, doubt = (
            float(comparison[f"{kind}_{name}"].values[worst_index]) for kind in ("difference", "uncertainty")
        )
        difference_text = with_uncertainty(value, doubt) if doubt > 0.0 else short_number(value)
        units = unit_suffix(str(comparison[f"difference_{name}"].attrs["units"]))
        index_by_dim = {
            str(dim): int(k) for dim, k in zip(comparison[f"difference_{name}"].dims, worst_index, strict=True)
        }
        where = f" at {place_text}" if (place_text := _index_text(comparison, index_by_dim)) else ""
        yield f"{name}: {counts}; the largest difference is {difference_text}{units}{where}"


def _index_text(comparison: xr.Dataset, index_by_dim: Mapping[str, int]) -> str:
    return ", ".join(
        f"t = {comparison[AT_TIME].values[k]:g}"
        if dim == AT
        else f"occurrence {k + 1}"
        if dim == OCCURRENCE
        else _place_text(comparison, dim, k)
        for dim, k in index_by_dim.items()
    )


SUMMARIES = {KIND: sweep_comparison_lines}

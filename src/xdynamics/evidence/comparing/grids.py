"""Two sweeps compared member by member: how far apart, by how much that is uncertain, and what differs between them."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.evidence.comparing.causes import models_apart
from xdynamics.evidence.evidence_dataset import about, exhibit
from xdynamics.evidence.grid_axes import ASKED, AXES, AXIS, VARIES, WHAT, axes_said, numbers, sweep_of
from xdynamics.evidence.grid_rounding import rounding_floors
from xdynamics.faults import InputError, few
from xdynamics.record.flag_words import words_of
from xdynamics.schema import AT, AT_TIME, OCCURRENCE, ROOT_DIGEST, flags
from xdynamics.shapes.naming import spoken, written
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
    """Compare the members that two sweeps have in common, found by what their axes say, whatever its order or units.

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
    second, restated = _as_of(first, second)
    dims = _axes(first)
    places, alone = _common(first, second, dims)
    one, other = (
        first.isel({dim: own for dim, (own, _) in places.items()}),
        second.isel({dim: own for dim, (_, own) in places.items()}),
    )
    variables: dict[str, Any] = {}
    for dim in dims:
        variables |= {str(name): _as_tuple(one, name) for name in _columns(one, dim)}
    if AT in places:
        variables[AT_TIME] = _as_tuple(one, AT_TIME)
    units = [*restated]
    floors = rounding_floors(first), rounding_floors(second)
    for name in numbers(one):
        if name in other.variables and {*one[name].dims} == {*other[name].dims}:
            variables |= _compared(
                name,
                one,
                other,
                _factor(name, one, other, units),
                (_at(first, name, places, 0), _at(second, name, places, 1)),
                tuple(each.get(name, 0.0) for each in floors),
            )
    variables["outcome_differs"] = _outcome(one, other)
    attributes = _attributes(first, second, units) | {
        AXES: str(first.attrs[AXES]),
        "members": int(np.prod([one.sizes[dim] for dim in dims])),
        "alone_in_first": "\n".join(alone[0]),
        "alone_in_second": "\n".join(alone[1]),
    }
    told = {what: attributes[what] for what in CAUSES if attributes[what]}
    attributes["cause"] = next((f"{what}: {_first(lines)}" for what, lines in told.items()), "")
    if one["run_digest"].chunks is None and other["run_digest"].chunks is None:
        same = one["run_digest"].variable == other["run_digest"].variable.transpose(*one["run_digest"].dims)
        attributes["identical"] = int(not (told or alone[0] or alone[1]) and bool(same.all()))
    digests = [str(sweep.attrs.get("sweep_digest", sweep.attrs.get(ROOT_DIGEST, ""))) for sweep in (first, second)]
    title = f"{str(first.attrs['title']).partition(':')[0]}: two sweeps over {', '.join(dims)}"
    found = exhibit(KIND, title, digests, variables, attributes)
    return found.set_coords([name for name in variables if name in one.coords])


def _as_tuple(sweep: xr.Dataset, name: Any) -> tuple[Any, ...]:
    variable = sweep[name].variable
    return variable.dims, variable.values, dict(variable.attrs)


def _axes(sweep: xr.Dataset) -> list[str]:
    return [dim for dim in axes_said(sweep) if dim in sweep.dims]


def _columns(sweep: xr.Dataset, dim: str) -> list[Any]:
    """Return the names of what varies along an axis."""
    return [
        name
        for name, variable in sweep.variables.items()
        if variable.attrs.get(AXIS) == dim and variable.dims == (dim,)
    ]


def _varied(sweep: xr.Dataset, dim: str) -> tuple[tuple[str, str], ...]:
    """Return what varies along an axis: its kind and name, whatever the dimension is called."""
    attributes = [sweep.variables[name].attrs for name in _columns(sweep, dim)]
    return tuple(sorted((str(one[VARIES]), spoken(written(str(one[WHAT])))) for one in attributes))


def _as_of(first: xr.Dataset, second: xr.Dataset) -> tuple[xr.Dataset, list[str]]:
    """Return the second sweep with its axes called as in the first; and what units of axes differ."""
    own, others = ({_varied(sweep, dim): dim for dim in _axes(sweep)} for sweep in (first, second))
    for these, those, where in ((own, others, "second"), (others, own, "first")):
        if missing := [dim for varied, dim in these.items() if varied not in those]:
            raise InputError(
                f"the {where} sweep has no axis like '{missing[0]}'; select one value of it in the other, as in"
                f" sweep.isel({missing[0]}=0)"
            )
    names = {others[varied]: dim for varied, dim in own.items() if others[varied] != dim}
    second = second.rename(names) if names else second
    for variable in second.variables.values():
        if variable.attrs.get(AXIS) in names:
            variable.attrs = variable.attrs | {AXIS: names[variable.attrs[AXIS]]}
    units = []
    for dim in own.values():
        for name, other in zip(_by_what(first, dim), _by_what(second, dim), strict=True):
            pair = [str(sweep[column].attrs["units"]) for sweep, column in ((first, name), (second, other))]
            units += [f"{name}: {pair[0]} | {pair[1]}"] if pair[0] != pair[1] else []
    return second, units


def _by_what(sweep: xr.Dataset, dim: str) -> list[Any]:
    return sorted(_columns(sweep, dim), key=lambda name: (str(sweep[name].attrs[VARIES]), str(sweep[name].attrs[WHAT])))


def _labels(sweep: xr.Dataset, dim: str) -> Labels:
    """Return what the axes say of each place along a dimension, in SI units."""
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


def _common(
    first: xr.Dataset, second: xr.Dataset, dims: list[str]
) -> tuple[dict[str, tuple[NDArray[np.int64], NDArray[np.int64]]], tuple[list[str], list[str]]]:
    """Return where the places that both have are in each, by dimension, and what only one of them has, in words."""
    places, alone = {}, ([], [])  # type: tuple[dict[str, Any], tuple[list[str], list[str]]]
    further = [dim for dim in (AT, OCCURRENCE) if dim in first.dims and dim in second.dims]
    for dim in [*dims, *further]:
        own, others = _labels(first, dim), _labels(second, dim)
        where = {label: k for k, label in reversed([*enumerate(others)])}
        pairs = [(k, where[label]) for k, label in enumerate(own) if label in where]
        if not pairs:
            raise InputError(
                f"no value of '{dim}' is in both sweeps: {_range(first, dim)} there, {_range(second, dim)} here"
            )
        places[dim] = tuple(np.array(numbers, np.int64) for numbers in zip(*pairs, strict=True))
        for number, (sweep, kept) in enumerate(zip((first, second), places[dim], strict=True)):
            left = np.setdiff1d(np.arange(sweep.sizes[dim]), kept)
            if left.size and dim in dims:
                alone[number].append(few([_said(sweep, dim, int(k)) for k in left]))
    return places, alone


def _said(sweep: xr.Dataset, dim: str, k: int) -> str:
    return ", ".join(
        f"{name} = {sweep[name].values[k]}{unit_suffix(str(sweep[name].attrs['units']))}"
        for name in _columns(sweep, dim)
    )


def _range(sweep: xr.Dataset, dim: str) -> str:
    if dim in (AT, OCCURRENCE):
        return few([str(label[0]) for label in _labels(sweep, dim)])
    return few([_said(sweep, dim, k) for k in range(sweep.sizes[dim])])


def _factor(name: str, one: xr.Dataset, other: xr.Dataset, units: list[str]) -> float:
    """Return what brings the second's numbers to the unit of the first; note where they differ."""
    pair = [str(sweep[name].attrs["units"]) for sweep in (one, other)]
    if pair[0] == pair[1]:
        return 1.0
    own, others = map(parse_unit, pair)
    if own.dimension != others.dimension:
        raise InputError(f"'{name}' has the unit '{pair[0]}' in the first sweep and '{pair[1]}' in the second")
    units.append(f"{name}: {pair[0]} | {pair[1]}")
    return float(others.factor / own.factor)


def _at(sweep: xr.Dataset, name: str, places: Mapping[str, Any], which: int) -> xr.Variable | None:
    """Return what the members of a sweep that are compared are uncertain by; None if nothing tells it."""
    doubt = uncertainty_of(sweep, name)
    if doubt is None:
        return None
    return doubt.isel({dim: pair[which] for dim, pair in places.items() if dim in doubt.dims})


def uncertainty_of(sweep: xr.Dataset, name: str) -> xr.Variable | None:
    """Return what a number of each member is numerically uncertain by, in its unit; None if nothing tells it.

    From the neighbours along axes of steps and tolerances, or as it was kept; see `compare_sweeps`.
    """
    levels = [dim for dim in _axes(sweep) if dim in sweep[name].dims and _varied(sweep, dim)[0][0] in LEVELS]
    levels = [dim for dim in levels if len(_varied(sweep, dim)) == 1 and sweep.sizes[dim] > 1]
    kept = f"{name}_uncertainty"
    if not levels:
        return sweep[kept].variable if kept in sweep.variables else None
    total: xr.DataArray = sum(map(partial(_by_levels, sweep, name), levels))  # type: ignore[assignment]
    return total.variable.transpose(*sweep[name].dims)


def _by_levels(sweep: xr.Dataset, name: str, dim: str) -> xr.DataArray:
    sizes = np.array([float(label[0]) for label in _labels(sweep, dim)])
    order = np.argsort(-sizes, kind="stable")
    fine = sweep[name].reset_coords(drop=True).drop_vars(dim, errors="ignore").isel({dim: order})
    ratio = xr.DataArray(sizes[order][:-1] / sizes[order][1:], dims=dim)
    apart = abs(fine.isel({dim: slice(None, -1)}) - fine.isel({dim: slice(1, None)}))
    own = xr.concat([apart * ratio / (ratio - 1.0), (apart / (ratio - 1.0)).isel({dim: [-1]})], dim)
    return SAFETY[len(sizes) > 2] * own.isel({dim: np.argsort(order)})


def _compared(
    name: str,
    one: xr.Dataset,
    other: xr.Dataset,
    factor: float,
    doubts: tuple[xr.Variable | None, xr.Variable | None],
    floors: tuple[Any, ...],
) -> dict[str, Any]:
    """Return the difference of a number, its uncertainty and the verdict, as variables."""
    own = one[name].variable
    others, (first, second) = other[name].variable.transpose(*own.dims), doubts
    doubt = (
        None if first is None or second is None else first.transpose(*own.dims) + second.transpose(*own.dims) * factor
    )
    floor = floors[0] + floors[1] * factor
    return judged_difference(name, own, others * factor, doubt, floor, "second sweep minus first")


def judged_difference(
    name: str, own: xr.Variable, other: xr.Variable, doubt: xr.Variable | None, floor: Any, said: str
) -> dict[str, Any]:
    """Return, as variables, how far a number is from another one of its unit, by how much that is uncertain, and the verdict.

    Parameters
    ----------
    name : str
    own, other : xarray.Variable
        Of the same dimensions; `own` has the attributes.
    doubt : xarray.Variable, optional
        What the difference is uncertain by; None where nothing tells it.
    floor : xarray.Variable or float
        What rounding alone may leave of it.
    said : str
        What is subtracted from what.
    """
    difference = other - own
    doubt = xr.full_like(difference.astype(float), np.nan) if doubt is None else doubt.astype(float)
    alike = (abs(difference) <= floor) | (own.isnull() & other.isnull())
    is_far = (doubt.notnull() & (abs(difference) > doubt)) | (difference.isnull() & ~alike)
    is_unknown = ~alike & ~is_far & doubt.isnull()
    verdict = WITHIN + (DIFFERS - WITHIN) * (is_far & ~alike) + (UNKNOWN - WITHIN) * is_unknown
    units, what = str(own.attrs["units"]), str(own.attrs["long_name"])
    return {
        f"difference_{name}": (own.dims, difference.data, about(units, f"{what}, {said}", "difference")),
        f"uncertainty_{name}": (
            own.dims,
            doubt.data,
            about(units, f"numerical uncertainty of difference_{name}; nan where nothing tells it", "error"),
        ),
        f"verdict_{name}": (
            own.dims,
            verdict.astype(np.int8).data,
            about("1", f"whether difference_{name} is more than its uncertainty", "flag")
            | flags(dict(enumerate(VERDICTS))),
        ),
    }


def _outcome(one: xr.Dataset, other: xr.Dataset) -> tuple[Any, ...]:
    own = one["run_outcome"].variable
    differs = (own != other["run_outcome"].variable.transpose(*own.dims)).astype(np.int8)
    return own.dims, differs.data, about("1", "1 where the runs ended in different ways", "difference")


def _attributes(first: xr.Dataset, second: xr.Dataset, units: list[str]) -> dict[str, Any]:
    """Return by name what differs between two sweeps."""
    asked = [json.loads(str(sweep.attrs.get(ASKED, "{}"))) for sweep in (first, second)]
    settings = [
        f"{key}: {_shown(asked[0], key)} | {_shown(asked[1], key)}"
        for key in dict.fromkeys([*asked[0], *asked[1]])
        if asked[0].get(key) != asked[1].get(key)
    ]
    versions = [
        f"{key}: {first.attrs.get(key, 'absent')} | {second.attrs.get(key, 'absent')}"
        for key in LAWS
        if first.attrs.get(key) != second.attrs.get(key)
    ]
    apart = models_apart(first, second) if "model_toml" in first and "model_toml" in second else {}
    varied = {what for dim in _axes(first) for _, what in _varied(first, dim)}  # whose value in the model no member has
    apart = {
        what: "\n".join(line for line in listed.splitlines() if line.partition(":")[0] not in varied)
        for what, listed in apart.items()
    }
    lines = {"settings": settings, "units": units, "versions": versions}
    none = dict.fromkeys(CAUSES, "")
    return none | apart | {what: "\n".join(listed) for what, listed in lines.items()}


def _shown(settings: Mapping[str, Any], key: str) -> str:
    return str(settings[key]) if key in settings else "absent"


def _first(lines: str) -> str:
    first, *others = lines.splitlines()
    return f"{first}, and {len(others)} more" if others else first


def lines_of(found: xr.Dataset) -> Iterator[str]:
    """Describe a comparison of sweeps line by line: what differs, who is alone, and of each number the largest difference."""
    if found.attrs.get("identical"):
        yield f"the same sweep: {found.attrs['members']} members, bit for bit"
        return
    for what, word in CAUSES.items():
        yield from (f"{word:<10}{line}" for line in str(found.attrs[what]).splitlines())
    yield f"members   {found.attrs['members']} in both"
    for where in ("first", "second"):
        yield from (f"alone     in the {where}, {line}" for line in str(found.attrs[f"alone_in_{where}"]).splitlines())
    yield from differences_said(found)
    if differing := int(found["outcome_differs"].sum()):
        yield f"outcomes  {differing} ended in different ways"


def differences_said(found: xr.Dataset) -> Iterator[str]:
    """Say of each number how many members differ, and which does most."""
    for name in [str(name)[len("difference_") :] for name in found.data_vars if str(name).startswith("difference_")]:
        words = words_of(found[f"verdict_{name}"])
        counts = ", ".join(
            f"{words.count(word)} {word.replace('differs', 'differ')}" for word in VERDICTS if word in words
        )
        values = np.abs(found[f"difference_{name}"].values)
        if not np.isfinite(values).any():
            yield f"{name}: {counts}"
            continue
        if not np.nanmax(values):
            yield f"{name}: {counts}, all the same"
            continue
        place = np.unravel_index(int(np.nanargmax(values)), values.shape)
        value, doubt = (float(found[f"{kind}_{name}"].values[place]) for kind in ("difference", "uncertainty"))
        told = with_uncertainty(value, doubt) if doubt > 0.0 else short_number(value)
        units = unit_suffix(str(found[f"difference_{name}"].attrs["units"]))
        at = {str(dim): int(k) for dim, k in zip(found[f"difference_{name}"].dims, place, strict=True)}
        where = f" at {said}" if (said := _place(found, at)) else ""
        yield f"{name}: {counts}; the largest difference is {told}{units}{where}"


def _place(found: xr.Dataset, at: Mapping[str, int]) -> str:
    return ", ".join(
        f"t = {found[AT_TIME].values[k]:g}"
        if dim == AT
        else f"occurrence {k + 1}"
        if dim == OCCURRENCE
        else _said(found, dim, k)
        for dim, k in at.items()
    )


SUMMARIES = {KIND: lines_of}

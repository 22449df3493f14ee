"""Numbers over the steps or tolerances of their runs: differences of levels, errors of single steps, errors over work.

Several refinements, or several diagnoses, in the panels that all have.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.elementary.bounds import EPS
from xdynamics.evidence.grid_axes import WHAT
from xdynamics.evidence.refining.readings import DEFECT
from xdynamics.faults import InputError, first_names
from xdynamics.figures.comparison import NEARLY_CONSTANT, SHOWN
from xdynamics.figures.marks import at_time, draw_line, escaped_text, label_panel, label_time, time_axis_label
from xdynamics.figures.sheet import Page, Panel
from xdynamics.figures.sweep import KEY, parts_along, settings_note, value_suffix
from xdynamics.record.flag_words import in_prose, words_of_flag
from xdynamics.schema import AT, AT_TIME, CYCLE, EVIDENCE, LEVEL, OCCURRENCE
from xdynamics.shapes import split_element_name
from xdynamics.units import unit_suffix
from xdynamics.units.digits import short_number, with_uncertainty

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]

MOST_ALONE = 3  # elements of a quantity, each of which has a panel
MOST_NAMED = 3  # elements in one panel that have colours and names
MOST_PLACES = 4  # of one number, in one panel
MOST_PANELS = 6
MOST_DEFECTS = 4  # numbers in one panel that have colours and names
ROUNDINGS = 64  # spacings of a number's size, that levels differ by for no other cause
FAR_BELOW = 1e-3  # of the smallest difference: what is less than this is not drawn
UNNAMED: Any = {"colour": "0.75", "width": 0.6, "size": 2}


def panels_of(study: xr.Dataset) -> list[Panel]:
    """Return the panel of each number of a refinement; one for many elements of a quantity."""
    differences = [
        partial(_draw_element_levels, study, names) if len(names) > 1 else partial(_draw_number_levels, study, names[0])
        for names in _differing_groups(study)[0]
    ]
    defects = dict[str, list[str]]()
    for name in (str(name) for name in study.data_vars if str(name).startswith(DEFECT)):
        if bool((abs(study[name]) > 0.0).any()):
            defects.setdefault(str(study[name].attrs["units"]), []).append(name)
    leading_count = MOST_PANELS - len(defects)
    defect_panels = [partial(_draw_step_defects, study, names) for names in defects.values()]
    return [*differences[:leading_count], *defect_panels, *differences[leading_count:]]


def _differing_groups(study: xr.Dataset) -> tuple[list[list[str]], list[list[str]]]:
    """Return the groups that have a panel, and those that have none as no level differs; all have one if none differs."""
    groups = _element_groups(study, _informative_numbers(study))
    differing = [group for group in groups if any(_differs_at_places(study, name).any() for name in group)]
    return differing or groups, [group for group in groups if differing and group not in differing]


def _differs_at_places(study: xr.Dataset, name: str) -> NDArray[np.bool_]:
    """Return at each place of a number whether levels differ there at all."""
    return np.asarray((abs(study[f"difference_{name}"]) > 0.0).any(LEVEL).values).ravel()


def _element_groups(study: xr.Dataset, names: list[str]) -> list[list[str]]:
    """Group elements of a quantity that has many; all else, and numbers without levels in a row, stand alone."""
    groups, is_number = dict[str, list[str]](), _varied(study).dtype.kind == "f"
    for name in names:
        quantity, labels = split_element_name(name)
        groups.setdefault(quantity if labels and is_number else name, []).append(name)
    return [
        part
        for group in groups.values()
        for part in ([group] if len(group) > MOST_ALONE else [[name] for name in group])
    ]


def foot_of(study: xr.Dataset) -> str:
    """Describe what is drawn, and what is left out."""
    omitted = sum(f"difference_{name}" in study for name in study.data_vars) - len(_informative_numbers(study))
    omitted_text = "1 further number, at roundoff or limited by interpolation, is"
    if omitted > 1:
        omitted_text = f"{omitted} further numbers, at roundoff or limited by interpolation, are"
    note = f"; {omitted_text} in the record" if omitted else ""
    drawn_groups, equal_groups = _differing_groups(study)
    groups_with_values = [group for group in equal_groups if any(bool(study[name].notnull().any()) for name in group)]
    for reason, groups in (
        ("not drawn, as levels do not differ", groups_with_values),
        ("without a value", [group for group in equal_groups if group not in groups_with_values]),
    ):
        names = [group[0] if len(group) == 1 else split_element_name(group[0])[0] for group in groups]
        note += f"; {reason}: {first_names(names)}" if groups else ""
    order = float(study.attrs["formal_order"])  # nan where no number that an error could be a power of is refined
    dashed = f"; dashed: order {order:g}" if np.isfinite(order) else ""
    has_grey = any(len(group) > max(MOST_ALONE, MOST_NAMED) for group in drawn_groups)
    grey = f"; grey: elements that differ less than the {MOST_NAMED} named" if has_grey else ""
    return (
        "dots: difference of each level to the next finer one; crosses: how far interpolation or location may have it"
        f" off, where that is not far below{dashed}{grey}{note}"
    )


def _informative_numbers(study: xr.Dataset) -> list[str]:
    """Name the numbers on which the levels are informative; all, if there are none."""
    names = [str(name) for name in study.data_vars if f"difference_{name}" in study]
    # what the model names, in the order that was asked for, and known; switches hidden in forces, like 'drag.abs', last
    informative = [name for name in names if is_informative(study, name)] or names
    return sorted(informative, key=lambda name: ("." in name, not _has_known_uncertainty(study, name)))


def _has_known_uncertainty(study: xr.Dataset, name: str) -> bool:
    """Whether an uncertainty of a number is known at one place at least; where none is ever told, all are."""
    doubt = study.get(f"uncertainty_{name}")
    return doubt is None or bool(np.isfinite(doubt.values).any())


def is_informative(study: xr.Dataset, name: str) -> bool:
    """Whether levels differ by more than rounding and interpolation explain, in at least one place."""
    size = study.get(schema.scale_name("difference", name))
    largest_difference = float(np.nanmax(np.abs(study[f"difference_{name}"].values), initial=0.0))
    if size is not None and largest_difference <= ROUNDINGS * EPS * float(np.nanmax(np.asarray(size), initial=0.0)):
        return False
    if f"verdict_{name}" not in study:
        return bool((np.abs(study[f"difference_{name}"]) > study[f"interpolation_error_{name}"]).any())
    return bool({*words_of_flag(study[f"verdict_{name}"])} - {"roundoff", "interpolation_limited"})


def _varied(study: xr.Dataset) -> xr.DataArray:
    """Return what its levels differ in."""
    return study[str(study.attrs["varied"])]


def _place_dim(study: xr.Dataset, name: str) -> Hashable:
    """Return the dimension of the places of a number: times or occurrences; None of a number at one place."""
    return next((dim for dim in study[name].dims if dim != LEVEL), None)


def _place_text(study: xr.Dataset, place_dim: Hashable, k: int) -> str:
    if place_dim == AT:
        return at_time(study[AT_TIME], float(study[AT_TIME][k]))
    return f"occurrence {k + 1}" if place_dim else ""


def _verdict(study: xr.Dataset, name: str, place: Mapping[Hashable, int]) -> str:
    return in_prose(words_of_flag(study[f"verdict_{name}"].isel(place))[0])


def _scale_levels(study: xr.Dataset, steps: NDArray[Any], axes: Axes) -> None:
    """Give differences a logarithmic axis, or say that there are none; and levels a logarithmic axis with a mark for each."""
    from matplotlib.ticker import NullLocator

    if any(np.size(line.get_xdata()) for line in axes.lines):
        axes.set_yscale("log")
    else:
        axes.set_yticks([])
        axes.text(0.5, 0.5, "no difference between levels", transform=axes.transAxes, ha="center", fontsize=9)
    if _varied(study).dtype.kind != "f":
        axes.set_xticks(np.arange(steps.size), [escaped_text(str(level)) for level in steps])
        return
    axes.set_xscale("log")
    axes.set_xticks(steps, [f"{step:.3g}" for step in steps], fontsize=8)
    axes.xaxis.set_minor_locator(NullLocator())
    axes.update_datalim([(step, 1.0) for step in steps], updatey=False)  # levels without a dot too
    axes.autoscale_view(scaley=False)
    label_panel(axes, x=time_axis_label(_varied(study), str(study.attrs["varied"])))


def _draw_slope(axes: Axes, steps: NDArray[Any], sizes: NDArray[Any], order: float, label: str = "") -> None:
    """Draw the slope that an order promises, through the first size that is not zero."""
    rows = np.flatnonzero(sizes > 0.0)
    if rows.size and np.isfinite(order):
        slope = sizes[rows[0]] * (steps[rows] / steps[rows[0]]) ** order
        draw_line(axes, steps[rows], slope, "--", "#999999", label, 0.9, zorder=0)


def _draw_ranked(
    study: xr.Dataset, sizes: Mapping[str, NDArray[Any]], labels: Mapping[str, str], axes: Axes
) -> list[str]:
    """Draw many numbers over the levels, of which some have labels, the largest on top; return them by size."""
    steps = _varied(study).values.astype(float)
    order = sorted(sizes, key=lambda name: -float(np.nanmax(sizes[name], initial=0.0)))
    for rank, name in enumerate(order):
        is_nonzero = sizes[name] > 0.0
        style = {"colour": rank, "label": labels[name]} if rank < len(labels) else UNNAMED
        draw_line(
            axes, steps[is_nonzero], sizes[name][is_nonzero], "o-", zorder=2.0 - rank / (3.0 * len(order)), **style
        )
    return order


def _draw_number_levels(study: xr.Dataset, name: str, axes: Axes) -> None:
    """Draw the differences of one number over its levels."""
    varied, variable, place_dim = _varied(study), study[name], _place_dim(study, name)
    is_number = varied.dtype.kind == "f"
    steps = varied.values if is_number else np.arange(varied.size, dtype=float)
    for k in range(min(MOST_PLACES, study.sizes[place_dim]) if place_dim else 1):
        place = {place_dim: k} if place_dim else {}
        if place_dim == OCCURRENCE and np.isnan(variable.isel(place).values).all():
            continue  # another event happens as often
        change, doubt = (
            np.abs(study[f"{kind}_{name}"].isel(place).values) for kind in ("difference", "interpolation_error")
        )
        is_nonzero = change > 0.0
        uncertain = doubt > (FAR_BELOW * float(change[is_nonzero].min()) if is_nonzero.any() else 0.0)
        words = _place_text(study, place_dim, k), _verdict(study, name, place) if is_number else ""
        draw_line(axes, steps[is_nonzero], change[is_nonzero], "o-", k, ", ".join(filter(None, words)))
        draw_line(axes, steps[uncertain], doubt[uncertain], "x", k)
        if k == 0 and is_number:
            _draw_slope(axes, steps, change, float(study.attrs["formal_order"]))
    _scale_levels(study, varied.values, axes)
    is_cut = place_dim and study.sizes[place_dim] > MOST_PLACES
    omitted = f", {MOST_PLACES} of {study.sizes[place_dim]} drawn" if is_cut else ""
    first = f" at {_place_text(study, AT, 0)}" if place_dim == AT else ""
    value = f"{_known_value_text(study, name)}{unit_suffix(variable.attrs['units'])}"
    title = f"{_number_title(study, name)}{first} = {value}{omitted}"
    label_panel(axes, title, y=("|difference|", study[f"difference_{name}"].attrs["units"]))
    axes.legend(fontsize=8, frameon=False)


def _number_title(study: xr.Dataset, name: str) -> str:
    """Name a number as one says it: the time of an event, a state after it."""
    if name.startswith("event_time_"):
        return f"time of {name.removeprefix('event_time_')}"
    return str(study[name].attrs["long_name"]) if name.startswith(("after_", "all_after_")) else name


def _known_value_text(study: xr.Dataset, name: str) -> str:
    """Write the finest level's value at the first place with the digits that are known; alone if none is known to be."""
    value = float(study[name].values.reshape(study.sizes[LEVEL], -1)[-1, 0])
    doubt = float(study[f"uncertainty_{name}"].values.ravel()[0]) if f"uncertainty_{name}" in study else np.nan
    if 0.0 < doubt < np.inf:
        return with_uncertainty(value, doubt)
    size = float(np.nanmax(np.asarray(study.get(schema.scale_name("difference", name), np.nan)), initial=0.0))
    return short_number(value if abs(value) > ROUNDINGS * EPS * size else 0.0)


def _draw_step_defects(study: xr.Dataset, names: list[str], axes: Axes) -> None:
    """Draw the largest errors of single steps, of all numbers of one unit, over the levels."""
    steps, order = _varied(study).values.astype(float), float(study.attrs["formal_order"]) + 1.0
    sizes = {name: abs(study[name].values) for name in names}
    largest = sorted(names, key=lambda name: -float(np.nanmax(sizes[name], initial=0.0)))
    ranked = _draw_ranked(study, sizes, {name: name.removeprefix(DEFECT) for name in largest[:MOST_DEFECTS]}, axes)
    _draw_slope(axes, steps, sizes[ranked[0]], order, f"order {order:g}")
    _scale_levels(study, steps, axes)
    label_panel(axes, "largest error of a single step", y=("|error of one step|", study[names[0]].attrs["units"]))
    axes.legend(fontsize=8, frameon=False)


def _draw_element_levels(study: xr.Dataset, names: list[str], axes: Axes) -> None:
    """Draw the differences of all elements of a quantity over its levels, at the last place with any; name the largest."""
    place_dim = _place_dim(study, names[0])
    differing = np.flatnonzero(np.any([_differs_at_places(study, name) for name in names], axis=0))
    k = int(differing[-1]) if place_dim and differing.size else -1
    place = {place_dim: k} if place_dim else {}
    changes = {name: np.abs(study[f"difference_{name}"].isel(place).values) for name in names}
    verdicts = {name: _verdict(study, name, place) for name in names}
    largest = sorted(names, key=lambda name: -float(np.nanmax(changes[name], initial=0.0)))[:MOST_NAMED]
    ranked = _draw_ranked(study, changes, {name: f"{name}, {verdicts[name]}" for name in largest}, axes)
    steps = _varied(study).values
    _draw_slope(axes, steps, changes[ranked[0]], float(study.attrs["formal_order"]))
    _scale_levels(study, steps, axes)
    place_text = f" at {_place_text(study, AT, k)}" if place_dim == AT else ""
    verdict_counts = ", ".join(f"{count} {word}" for word, count in Counter(verdicts.values()).most_common())
    title = f"{split_element_name(names[0])[0]}{place_text}, {len(names)} elements: {verdict_counts}"
    label_panel(axes, title, y=("|difference|", study[f"difference_{names[0]}"].attrs["units"]))
    axes.legend(fontsize=8, frameon=False)


Several = Mapping[str, xr.Dataset]

MARKERS = "os^Dv<>P"


def joint_panels(records: Several) -> list[Panel]:
    """Return a panel for each number that all have: its differences in refinements, its values per cycle in diagnoses.

    Raises
    ------
    InputError
        If they are not all refinements of one thing, or all diagnoses, or share no number.
    """
    kinds = {str(record.attrs.get(EVIDENCE, "run")) for record in records.values()}
    varied = {str(record.attrs.get("varied", "")) for record in records.values()}
    if kinds not in ({"refinement"}, {"diagnosis"}) or len(varied) > 1:
        raise InputError(
            "several records are drawn together if all are refinements of one thing or all diagnoses; these are"
            f" {', '.join(sorted(kinds))}"
        )
    first, *_ = records.values()
    if kinds == {"diagnosis"}:
        draw: Any = _draw_joint_cycles
        names = [name for name in SHOWN if all(name in r and r[name].notnull().any() for r in records.values())]
    else:
        draw = _draw_joint_levels
        names = [str(name) for name in first.data_vars if all(f"difference_{name}" in r for r in records.values())]
        names = [name for name in names if any(is_informative(r, name) for r in records.values())] or names
    if not names:
        raise InputError("there is nothing to draw together: no number is in all of the records")
    return [partial(draw, records, name) for name in names]


def joint_foot(records: Several) -> str:
    """Describe what is drawn."""
    if all("varied" in record.attrs for record in records.values()):
        return "difference of each level to the next finer one, at the first place; in brackets the last observed order"
    if not all("energy_band" in record for record in records.values()):
        return ""
    energies = [
        f"{name} {float(record['energy_band']):.3g} {record['energy_band'].attrs['units']}"
        for name, record in records.items()
    ]
    return f"energy bands: {', '.join(energies)}"


def _marker(k: int) -> str:
    """Return the k-th marker of lines that are told apart by theirs."""
    return f"{MARKERS[k % len(MARKERS)]}-"


def _draw_joint_levels(records: Several, name: str, axes: Axes) -> None:
    for k, (label, study) in enumerate(records.items()):
        place_dim = _place_dim(study, name)
        place = {place_dim: 0} if place_dim else {}
        change = np.abs(study[f"difference_{name}"].isel(place).values)
        is_nonzero = change > 0.0
        notes = []
        if f"order_{name}" in study and study.sizes[LEVEL] > 2:
            order = float(study[f"order_{name}"].isel(place)[-2])
            notes = [f"{order:.2f}"] * bool(np.isfinite(order)) + [_verdict(study, name, place)]
        text = f"{label} ({', '.join(notes)})" if notes else label
        draw_line(axes, _varied(study).values[is_nonzero], change[is_nonzero], _marker(k), k, text)
    first, *_ = records.values()
    _scale_levels(first, np.unique(np.concatenate([_varied(study).values for study in records.values()])), axes)
    label_panel(axes, name, y=("|difference|", str(first[f"difference_{name}"].attrs["units"])))
    axes.legend(fontsize=7, framealpha=0.8, edgecolor="none")


def _draw_joint_cycles(records: Several, name: str, axes: Axes) -> None:
    for k, (label, record) in enumerate(records.items()):
        draw_line(axes, record["cycle_time"].values, record[name].values, _marker(k), k, label, size=3.5)
    low, high = axes.get_ylim()
    size = max(abs(low), abs(high))
    if high - low < NEARLY_CONSTANT * size:  # keeps values that are nearly equal from being drawn far apart
        axes.set_ylim(low - NEARLY_CONSTANT * size, high + NEARLY_CONSTANT * size)
        axes.ticklabel_format(axis="y", useOffset=False)
    first, *_ = records.values()
    label_time(axes, first["cycle_time"], f"time at the end of the {CYCLE}")
    label_panel(axes, name.replace("_", " "), y=(name, str(first[name].attrs["units"])))
    axes.legend(fontsize=8, frameon=False)


EVALUATIONS, OFF, FRONT = "run_force_evaluations", "off_", "front_"


def precision_panels(precision: xr.Dataset) -> list[Panel]:
    """Return the panel of each number: its error over the work, a line for each method."""
    names = [
        str(name) for name in precision.data_vars if str(name).startswith(OFF) and bool((precision[name] > 0).any())
    ]
    return [partial(_draw_work_precision, precision, name) for name in names]


def precision_foot(precision: xr.Dataset) -> str:
    """Describe what is drawn."""
    varied = str(precision.attrs["varied"])
    sizes = ", ".join(f"{float(value):.6g}" for value in precision[varied].values)
    return f"each point a run; along a line {varied} = {sizes}{value_suffix(precision, varied)}"


def _draw_work_precision(precision: xr.Dataset, name: str, axes: Axes) -> None:
    varied, front = str(precision.attrs["varied"]), f"{FRONT}{name.removeprefix(OFF)}"
    runs = precision[[name, front, EVALUATIONS]]
    runs = runs.isel({dim: -1 for dim in runs[name].dims if dim not in runs[EVALUATIONS].dims})
    other_dims = [str(dim) for dim in runs[name].dims if dim != varied]
    # broad lines below those of methods, through the runs that no other one betters: one for each problem
    for k, indices in enumerate(parts_along(runs, [d for d in other_dims if precision[d].attrs.get(WHAT) != "method"])):
        problem = runs.isel(indices)
        is_best = problem[front].transpose(*problem[name].dims).values > 0
        label = "" if k else "Pareto front"
        work, error = _work_and_error(problem, name, is_best)
        draw_line(axes, work, error, "-", "0.8", label, 6, solid_capstyle="round")
    for k, indices in enumerate(parts_along(runs, other_dims)):
        line = runs.isel(indices)
        work, error = _work_and_error(line, name, np.True_)
        draw_line(axes, work, error, _marker(k), k, settings_note(line, [varied]))
    axes.set(xscale="log", yscale="log")
    if np.ptp(np.log10(runs[EVALUATIONS].values)) > 1.0:
        axes.xaxis.set_minor_formatter("")  # powers of ten are enough
    label_panel(axes, name.removeprefix(OFF), x="force evaluations", y=("|error|", precision[name].attrs["units"]))
    if other_dims:
        axes.legend(**KEY)


def _work_and_error(runs: xr.Dataset, name: str, is_shown: NDArray[np.bool_] | np.bool_) -> tuple[Floats, Floats]:
    """Return work and error of the runs that are shown and have an error, by work."""
    mask = is_shown & (runs[name].values > 0.0)
    work = runs[EVALUATIONS].broadcast_like(runs[name]).transpose(*runs[name].dims).values[mask]
    order = np.argsort(work)
    return work[order], runs[name].values[mask][order]


JOINT_PAGE = Page((), joint_panels, joint_foot, most_panels=MOST_PANELS)
PAGES = (
    Page(("refinement",), panels_of, foot_of, most_panels=MOST_PANELS),
    Page(("precision",), precision_panels, precision_foot, most_panels=6, height=3.8),
)

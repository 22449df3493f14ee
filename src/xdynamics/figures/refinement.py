"""Figures of refinements: differences of neighbouring levels beside the slope that the method promises."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.elementary.bounds import EPS
from xdynamics.evidence.refining.readings import DEFECT
from xdynamics.faults import first_names
from xdynamics.figures.marks import COLOURS, at_time, escaped_text, time_axis_label
from xdynamics.figures.sheet import Page, Panel
from xdynamics.record.flag_words import in_prose, words_of_flag
from xdynamics.schema import AT, AT_TIME, LEVEL
from xdynamics.shapes import split_element_name
from xdynamics.units import unit_suffix
from xdynamics.units.digits import short_number, with_uncertainty

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_ALONE = 3  # elements of a quantity, each of which has a panel
MOST_NAMED = 3  # elements in one panel that have colours and names
MOST_PLACES = 4  # of one number, in one panel
MOST_PANELS = 6
MOST_DEFECTS = 4  # numbers in one panel that have colours and names
ROUNDINGS = 64  # spacings of a number's size, that levels differ by for no other cause
FAR_BELOW = 1e-3  # of the smallest difference: what is less than this is not drawn


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
    groups_that_differ = [group for group in groups if any(_differs_at_places(study, name).any() for name in group)]
    return groups_that_differ or groups, [
        group for group in groups if group not in groups_that_differ
    ] if groups_that_differ else []


def _differs_at_places(study: xr.Dataset, name: str) -> NDArray[np.bool_]:
    """Return at each place of a number whether levels differ there at all."""
    return np.asarray((abs(study[f"difference_{name}"]) > 0.0).any(LEVEL).values).ravel()


def _element_groups(study: xr.Dataset, names: list[str]) -> list[list[str]]:
    """Group elements of a quantity that has many; all else, and numbers without levels in a row, stand alone."""
    groups, is_number = dict[str, list[str]](), study[str(study.attrs["varied"])].dtype.kind == "f"
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
    equal_groups = _differing_groups(study)[1]
    groups_with_values = [group for group in equal_groups if any(bool(study[name].notnull().any()) for name in group)]
    for reason, groups in (
        ("not drawn, as levels do not differ", groups_with_values),
        ("without a value", [group for group in equal_groups if group not in groups_with_values]),
    ):
        note += f"; {reason}: {first_names(map(_group_name, groups))}" if groups else ""
    order = float(study.attrs["formal_order"])  # nan where no number that an error could be a power of is refined
    dashed = f"; dashed: order {order:g}" if np.isfinite(order) else ""
    grey = (
        f"; grey: elements that differ less than the {MOST_NAMED} named"
        if any(map(_has_grey, _differing_groups(study)[0]))
        else ""
    )
    return (
        "dots: difference of each level to the next finer one; crosses: how far interpolation or location may have it"
        f" off, where that is not far below{dashed}{grey}{note}"
    )


def _has_grey(group: list[str]) -> bool:
    """Whether a panel has elements without names."""
    return len(group) > max(MOST_ALONE, MOST_NAMED)


def _group_name(group: list[str]) -> str:
    """Name what one panel is of."""
    return group[0] if len(group) == 1 else split_element_name(group[0])[0]


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


def _number_title(study: xr.Dataset, name: str) -> str:
    """Name a number as one says it: the time of an event, a state after it."""
    if name.startswith("event_time_"):
        return f"time of {name.removeprefix('event_time_')}"
    return str(study[name].attrs["long_name"]) if name.startswith(("after_", "all_after_")) else name


def is_informative(study: xr.Dataset, name: str) -> bool:
    """Whether levels differ by more than rounding and interpolation explain, in at least one place."""
    if _is_rounding_only(study, name):
        return False
    if f"verdict_{name}" not in study:
        return bool((np.abs(study[f"difference_{name}"]) > study[f"interpolation_error_{name}"]).any())
    return bool({*words_of_flag(study[f"verdict_{name}"])} - {"roundoff", "interpolation_limited"})


def _is_rounding_only(study: xr.Dataset, name: str) -> bool:
    """Whether levels differ by no more than rounding of the size that the number has along a run."""
    size = study.get(schema.scale_name("difference", name))
    if size is None:
        return False
    largest_difference = float(np.nanmax(np.abs(study[f"difference_{name}"].values), initial=0.0))
    return bool(largest_difference <= ROUNDINGS * EPS * float(np.nanmax(np.asarray(size), initial=0.0)))


def log_steps(axes: Axes, steps: NDArray[Any]) -> None:
    """Give the levels a logarithmic axis, with a mark for each and no others."""
    from matplotlib.ticker import NullLocator

    axes.set_xscale("log")
    axes.set_xticks(steps, [f"{step:.3g}" for step in steps], fontsize=8)
    axes.xaxis.set_minor_locator(NullLocator())
    axes.update_datalim([(step, 1.0) for step in steps], updatey=False)  # levels without a dot too
    axes.autoscale_view(scaley=False)


def _set_difference_scale(axes: Axes) -> None:
    """Give differences a logarithmic axis; where there are none, say so."""
    if any(np.size(line.get_xdata()) for line in axes.lines):
        axes.set_yscale("log")
    else:
        axes.set_yticks([])
        axes.text(0.5, 0.5, "no difference between levels", transform=axes.transAxes, ha="center", fontsize=9)


def _draw_number_levels(study: xr.Dataset, name: str, axes: Axes) -> None:
    """Draw the differences of one number over its levels."""
    varied, variable = study[str(study.attrs["varied"])], study[name]
    number = varied.dtype.kind == "f"
    steps = varied.values if number else np.arange(varied.size, dtype=float)
    place_dim = next((dim for dim in variable.dims if dim != LEVEL), None)
    for k in range(min(MOST_PLACES, study.sizes[place_dim]) if place_dim else 1):
        selection = {place_dim: k} if place_dim else {}
        change, doubt = (
            np.abs(study[f"{kind}_{name}"].isel(selection).values) for kind in ("difference", "interpolation_error")
        )
        place_text = _place_text(study, place_dim, k)
        verdict = in_prose(words_of_flag(study[f"verdict_{name}"].isel(selection))[0]) if number else ""
        is_nonzero = change > 0.0
        uncertain = doubt > (FAR_BELOW * float(change[is_nonzero].min()) if is_nonzero.any() else 0.0)
        colour, label = COLOURS[k % len(COLOURS)], ", ".join(filter(None, (place_text, verdict)))
        axes.plot(
            steps[is_nonzero],
            change[is_nonzero],
            "o-",
            color=colour,
            markersize=4,
            linewidth=1.0,
            label=escaped_text(label),
        )
        axes.plot(steps[uncertain], doubt[uncertain], "x", color=colour, markersize=4)
        if k == 0 and number and is_nonzero.any():
            first = np.flatnonzero(is_nonzero)[0]
            slope = change[first] * (steps[is_nonzero] / steps[first]) ** float(study.attrs["formal_order"])
            axes.plot(steps[is_nonzero], slope, "--", color="#999999", linewidth=0.9, zorder=0)
    _set_difference_scale(axes)
    if number:
        log_steps(axes, steps)
        axes.set(xlabel=escaped_text(time_axis_label(varied, str(study.attrs["varied"]))))
    else:
        axes.set_xticks(steps, [escaped_text(str(level)) for level in varied.values])
    axes.set(ylabel=escaped_text(f"|difference| ({study[f'difference_{name}'].attrs['units']})"))
    first = f" at {at_time(study[AT_TIME], float(study[AT_TIME][0]))}" if place_dim == AT else ""
    is_cut = place_dim and study.sizes[place_dim] > MOST_PLACES
    omitted = f", {MOST_PLACES} of {study.sizes[place_dim]} drawn" if is_cut else ""
    axes.set_title(
        escaped_text(
            f"{_number_title(study, name)}{first} = {_known_value_text(study, name)}{unit_suffix(variable.attrs['units'])}{omitted}"
        ),
        loc="left",
        fontsize=10,
    )
    axes.legend(fontsize=8, frameon=False)


def _place_text(study: xr.Dataset, place_dim: Hashable, k: int) -> str:
    if place_dim == AT:
        return at_time(study[AT_TIME], float(study[AT_TIME][k]))
    return f"occurrence {k + 1}" if place_dim else ""


def _draw_step_defects(study: xr.Dataset, names: list[str], axes: Axes) -> None:
    """Draw the largest errors of single steps, of all numbers of one unit, over the levels."""
    varied = study[str(study.attrs["varied"])]
    steps = varied.values.astype(float)
    sizes = {name: abs(study[name].values) for name in names}
    order = sorted(names, key=lambda name: -float(np.nanmax(sizes[name], initial=0.0)))
    for rank, name in reversed([*enumerate(order)]):
        is_nonzero, size = sizes[name] > 0.0, sizes[name]
        style: dict[str, Any] = {"color": "0.75", "linewidth": 0.6, "markersize": 2}
        if rank < len(COLOURS) and rank < MOST_DEFECTS:
            label = escaped_text(name.removeprefix(DEFECT))
            style = {"color": COLOURS[rank], "linewidth": 1.0, "markersize": 4, "label": label}
        axes.plot(steps[is_nonzero], size[is_nonzero], "o-", **style)
        if rank == 0 and is_nonzero.any() and np.isfinite(float(study.attrs["formal_order"])):
            first = np.flatnonzero(is_nonzero)[0]
            slope = size[first] * (steps[is_nonzero] / steps[first]) ** (float(study.attrs["formal_order"]) + 1.0)
            label = f"order {float(study.attrs['formal_order']) + 1.0:g}"
            axes.plot(steps[is_nonzero], slope, "--", color="#999999", linewidth=0.9, zorder=0, label=label)
    _set_difference_scale(axes)
    log_steps(axes, steps)
    axes.set(xlabel=escaped_text(time_axis_label(varied, str(study.attrs["varied"]))))
    axes.set(ylabel=escaped_text(f"|error of one step| ({study[names[0]].attrs['units']})"))
    axes.set_title(escaped_text("largest error of a single step"), loc="left", fontsize=10)
    axes.legend(fontsize=8, frameon=False)


def _draw_element_levels(study: xr.Dataset, names: list[str], axes: Axes) -> None:
    """Draw the differences of all elements of a quantity over its levels, at the last place with any; name the largest."""
    varied = study[str(study.attrs["varied"])]
    steps, place_dim = varied.values, next((dim for dim in study[names[0]].dims if dim != LEVEL), None)
    differing_places = (
        np.flatnonzero(np.any([_differs_at_places(study, name) for name in names], axis=0))
        if place_dim
        else np.zeros(0)
    )
    k = int(differing_places[-1]) if differing_places.size else -1
    last = {place_dim: k} if place_dim else {}
    changes = {name: np.abs(study[f"difference_{name}"].isel(last).values) for name in names}
    verdicts = {name: in_prose(words_of_flag(study[f"verdict_{name}"].isel(last))[0]) for name in names}
    order = sorted(names, key=lambda name: -float(np.nanmax(changes[name], initial=0.0)))
    for name in reversed(order):
        rank, is_nonzero = order.index(name), changes[name] > 0.0
        style: dict[str, Any] = {"color": "0.75", "linewidth": 0.6, "markersize": 2}
        if rank < MOST_NAMED:
            style = {
                "color": COLOURS[rank],
                "linewidth": 1.0,
                "markersize": 4,
                "label": escaped_text(f"{name}, {verdicts[name]}"),
            }
        axes.plot(steps[is_nonzero], changes[name][is_nonzero], "o-", **style)
        if rank == 0 and is_nonzero.any():
            first = np.flatnonzero(is_nonzero)[0]
            slope = changes[name][first] * (steps[is_nonzero] / steps[first]) ** float(study.attrs["formal_order"])
            axes.plot(steps[is_nonzero], slope, "--", color="#999999", linewidth=0.9, zorder=0)
    _set_difference_scale(axes)
    log_steps(axes, steps)
    axes.set(xlabel=escaped_text(time_axis_label(varied, str(study.attrs["varied"]))))
    axes.set(ylabel=escaped_text(f"|difference| ({study[f'difference_{names[0]}'].attrs['units']})"))
    place_text = f" at {at_time(study[AT_TIME], float(study[AT_TIME][k]))}" if place_dim == AT else ""
    counts = Counter(verdicts.values()).most_common()
    verdict_counts = ", ".join(f"{count} {word}" for word, count in counts)
    axes.set_title(
        escaped_text(f"{split_element_name(names[0])[0]}{place_text}, {len(names)} elements: {verdict_counts}"),
        loc="left",
        fontsize=10,
    )
    handles, labels = axes.get_legend_handles_labels()
    axes.legend(handles[::-1], labels[::-1], fontsize=8, frameon=False)


def _known_value_text(study: xr.Dataset, name: str) -> str:
    """Write the finest level's value at the first place with the digits that are known; alone if none is known to be."""
    value = float(study[name].values.reshape(study.sizes[LEVEL], -1)[-1, 0])
    doubt = float(study[f"uncertainty_{name}"].values.ravel()[0]) if f"uncertainty_{name}" in study else np.nan
    if 0.0 < doubt < np.inf:
        return with_uncertainty(value, doubt)
    size = float(np.nanmax(np.asarray(study.get(schema.scale_name("difference", name), np.nan)), initial=0.0))
    return short_number(value if abs(value) > ROUNDINGS * EPS * size else 0.0)


PAGE = Page(("refinement",), panels_of, foot_of, most_panels=MOST_PANELS)

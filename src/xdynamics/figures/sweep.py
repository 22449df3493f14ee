"""Figures of sweeps: which numbers have panels, and how members ended."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from functools import partial
from itertools import product
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.evidence.grid_axes import member_number_names, sweep_axis_names
from xdynamics.evidence.grid_rounding import END_TIME, vanishing
from xdynamics.faults import first_names
from xdynamics.figures.sheet import Page, Panel
from xdynamics.figures.sweep_draws import draw_random_members, draw_word_members
from xdynamics.figures.sweep_lines import draw_elements_over_axis, draw_over_axis
from xdynamics.figures.sweep_maps import draw_elements_over_axes, draw_over_two_axes
from xdynamics.figures.transients import Transient, without_transient
from xdynamics.shapes import split_element_name
from xdynamics.sweeping.collection import settings_text
from xdynamics.sweeping.kept_quantities import OUTCOME, UNCONTROLLED
from xdynamics.sweeping.members import end_descriptions

Values = NDArray[Any]


def panels_of(sweep: xr.Dataset, transient: Transient | None = None) -> list[Panel]:
    """Return the panels of a sweep: one for each recorded quantity, and for maps one for each value of a setting in words."""
    if transient is not None:
        sweep = without_transient(sweep, transient)
    wide = _number_axes(sweep)
    noise = vanishing(sweep)
    names = _panel_numbers(sweep, noise)
    # where there is nothing else, noise is drawn as the zero that it is
    sweep = sweep.assign({name: sweep[name].where(sweep[name].isnull(), 0.0) for name in names if name in noise})
    if len(wide) >= 2 and all(dim in sweep.coords for dim in wide[:2]):
        groups = _quantity_groups(sweep, names, sweep[OUTCOME].dims)
        return [
            partial(draw_over_two_axes, sweep, group[0], part, wide[:2])
            if len(group) == 1
            else partial(draw_elements_over_axes, sweep, group, part, wide[:2])
            for part in _parts_by_other_axes(sweep, wide[:2])
            for group in groups
        ]
    if len(wide) == 1 and wide[0] in sweep.coords:
        return [
            partial(draw_over_axis, sweep, group[0], wide[0])
            if len(group) == 1
            else partial(draw_elements_over_axis, sweep, group, wide[0])
            for group in _quantity_groups(sweep, names, (wide[0],))
        ]
    if wide:
        return [partial(draw_random_members, sweep, name, wide[0]) for name in names]
    return [partial(draw_word_members, sweep, name) for name in names]


def foot_of(sweep: xr.Dataset) -> str:
    """Report how members ended."""
    outcomes, counts = np.unique(end_descriptions(sweep).values.astype(str), return_counts=True)
    summary = ", ".join(f"{count} {word}" for word, count in zip(outcomes, counts, strict=True))
    uncontrolled = int(np.count_nonzero(sweep[UNCONTROLLED].values))
    noise = first_names(vanishing(sweep))
    zero = f"; zero to rounding: {noise}" if noise else ""
    note = f"; of {uncontrolled} absolute tolerances may have let pass 3 % of a variable" if uncontrolled else ""
    return f"{sweep[OUTCOME].size} runs: {summary}{note}; {settings_text(sweep)}{zero}"


def _number_axes(sweep: xr.Dataset) -> list[str]:
    """Name the axes of numbers, those that are drawn or vary together last."""
    axes = [dim for dim in sweep_axis_names(sweep) if dim in sweep.dims]
    of_words = [dim for dim in axes if dim in sweep.coords and sweep[dim].dtype.kind not in "fi"]
    wide = [dim for dim in axes if dim not in of_words and sweep.sizes[dim] > 1]
    return sorted(wide, key=lambda dim: (dim not in sweep.coords, axes.index(dim)))


def _panel_numbers(sweep: xr.Dataset, noise: Sequence[str]) -> list[str]:
    """Name the numbers worth a panel, those that vary by more than rounding; final values come last."""
    names = [name for name in member_number_names(sweep) if not name.endswith("_time")] or [END_TIME]
    varying_names = [name for name in names if name not in noise and _varies(np.asarray(sweep[name]))]
    leading_names = [name for name in varying_names if not name.startswith("end_")]
    return [*leading_names, *(name for name in varying_names if name not in leading_names)] or names


def _quantity_groups(sweep: xr.Dataset, names: list[str], dims: Sequence[Hashable]) -> list[list[str]]:
    """Group all elements of a quantity that has one value for each member along some axes; all else stands alone."""
    groups: dict[str, list[str]] = {}
    for name in names:
        quantity, labels = split_element_name(name)
        groups.setdefault(quantity if labels and {*sweep[name].dims} == {*dims} else name, []).append(name)
    # beside elements that vary, those that do not show by how little
    all_numbers = [name for name in member_number_names(sweep) if not name.endswith("_time")]
    return [
        [element_name for element_name in all_numbers if split_element_name(element_name)[0] == quantity]
        if quantity not in group
        else group
        for quantity, group in groups.items()
    ]


def _varies(values: Values) -> bool:
    finite = values[np.isfinite(values)] if values.dtype.kind == "f" else values.ravel()
    return bool(finite.size and finite.max() > finite.min())


def _parts_by_other_axes(sweep: xr.Dataset, shown_axes: list[str]) -> Iterator[dict[str, int]]:
    """Yield the part of the sweep for each combination of the axes that are not shown."""
    other_dims = [dim for dim in sweep[OUTCOME].dims if dim not in shown_axes]
    for indices in product(*(range(sweep.sizes[dim]) for dim in other_dims)):
        yield {str(dim): k for dim, k in zip(other_dims, indices, strict=True)}


PAGE = Page(("sweep",), panels_of, foot_of, most_panels=8, height=3.6, single_height=7.0)

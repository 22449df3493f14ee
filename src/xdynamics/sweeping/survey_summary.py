"""Surveys of a sweep in lines of text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from xdynamics.evidence.comparing.grids import difference_lines
from xdynamics.record.flag_words import words_of_flag
from xdynamics.shapes.naming import display_text, split_element_name
from xdynamics.units.digits import uncertainty_alone

if TYPE_CHECKING:
    import xarray as xr

MAX_LINES = 16
MAX_ELEMENTS = 6  # of one quantity


def _first_lines(lines_of: Callable[[xr.Dataset], Iterable[str]], survey: xr.Dataset) -> list[str]:
    """Summarise a survey; of a long one the first lines."""
    lines = list(lines_of(survey))
    return lines if len(lines) <= MAX_LINES else [*lines[:MAX_LINES], f"… and {len(lines) - MAX_LINES} more"]


def _names_with_prefix(survey: xr.Dataset, head: str) -> list[str]:
    return [str(name) for name in survey.data_vars if str(name).startswith(head)]


def _unit_suffix(survey: xr.Dataset, name: str) -> str:
    units = str(survey[name].attrs["units"])
    return "" if units == "1" else f" {units}"


def _contrast_lines(survey: xr.Dataset) -> Iterator[str]:
    outcomes = (
        f"; {int(survey['outcome_differs'].sum())} members ended otherwise" if "outcome_differs" in survey else ""
    )
    yield f"compared  with {survey.attrs['reference']}{outcomes}"
    yield from difference_lines(survey)


def _sensitivity_lines(survey: xr.Dataset) -> Iterator[str]:
    for name in _names_with_prefix(survey, "slope_"):
        values = survey[name].values
        if np.isfinite(values).any():
            yield f"{name} from {np.nanmin(values):.6g} to {np.nanmax(values):.6g}{_unit_suffix(survey, name)}"


def _influence_lines(survey: xr.Dataset) -> Iterator[str]:
    axes = list(map(str, survey["axis_name"].values))
    for name in (
        *_names_with_prefix(survey, "main_effect_"),
        *(str(variable) for variable in survey.data_vars if str(variable).endswith("_changes")),
    ):
        largest_shares = survey[name].values.reshape(len(axes), -1).max(axis=-1)
        shares = ", ".join(f"{axis} {value:.1%}" for axis, value in zip(axes, largest_shares, strict=True))
        of_elements = " of its elements, at most" if survey[name].ndim > 1 else ""
        yield f"{name.replace('main_effect_', 'variance of ')}{of_elements}: {shares}"


def _convergence_lines(survey: xr.Dataset) -> Iterator[str]:
    for name in _names_with_prefix(survey, "verdict_"):
        counts = Counter(
            words_of_flag(survey[name].stack(each=survey[name].dims) if survey[name].ndim > 1 else survey[name])
        )
        number = name.removeprefix("verdict_")
        uncertainty = survey[f"uncertainty_{number}"].values
        doubt_text = (
            f", uncertain by up to {uncertainty_alone(float(np.nanmax(uncertainty)))}{_unit_suffix(survey, f'uncertainty_{number}')}"
            if np.isfinite(uncertainty).any()
            else ""
        )
        yield f"{number}: {', '.join(f'{count} {word}' for word, count in counts.most_common())}{doubt_text}"


def _precision_lines(survey: xr.Dataset) -> Iterator[str]:
    varied_dim = str(survey.attrs["varied"])
    finest = survey.isel({varied_dim: int(np.argmin(survey[varied_dim].values))})
    for name in _names_with_prefix(survey, "off_"):
        errors = finest[name]
        while errors.ndim > 1:
            errors = errors.isel({errors.dims[-1]: -1})
        labels = (
            [str(coordinate) for coordinate in errors[errors.dims[0]].values]
            if errors.ndim and errors.dims[0] in errors.coords
            else [""]
        )
        errors_text = ", ".join(
            f"{label} {value:.3g}".strip() for label, value in zip(labels, np.atleast_1d(errors.values), strict=False)
        )
        yield f"{name.removeprefix('off_')} with the finest {varied_dim} is off by {errors_text}{_unit_suffix(survey, name)}"


def _index_lines(survey: xr.Dataset) -> Iterator[str]:
    yield f"draws     {survey.attrs['draws']} and seed {survey.attrs['seed']}"
    ends = [
        name.removeprefix("first_order")
        for name in map(str, survey.data_vars)
        if split_element_name(name)[0] == "first_order"
    ]
    for i, name in enumerate(map(str, survey["parameter_name"].values)):
        for end in ends[:MAX_ELEMENTS]:
            shares = []
            for word in ("first_order", "total_order"):
                low, high = survey[f"{word}_interval{end}"].values[i]
                shares.append(f"{word.replace('_', ' ')} {float(survey[word + end][i]):.3f} ({low:.3f} to {high:.3f})")
            quantity_text = f" of {display_text(survey.attrs['quantity'] + end)}" if end else ""
            yield f"{name}{quantity_text}: {', '.join(shares)}"
    if len(ends) > MAX_ELEMENTS:
        yield f"{len(ends) - MAX_ELEMENTS} further elements of {survey.attrs['quantity']} are in the record"


SUMMARIES = {
    kind: partial(_first_lines, lines_of)
    for kind, lines_of in {
        "contrast": _contrast_lines,
        "sensitivities": _sensitivity_lines,
        "influences": _influence_lines,
        "convergence": _convergence_lines,
        "precision": _precision_lines,
        "sobol indices": _index_lines,
    }.items()
}

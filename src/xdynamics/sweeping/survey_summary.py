"""Surveys of a sweep in lines of text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from xdynamics.evidence.comparing.grids import differences_said
from xdynamics.record.flag_words import words_of
from xdynamics.shapes.naming import parted, spoken
from xdynamics.units.digits import uncertainty_alone

if TYPE_CHECKING:
    import xarray as xr

MOST = 16
MOST_ELEMENTS = 6  # of one quantity


def _first_lines(lines_of: Callable[[xr.Dataset], Iterable[str]], survey: xr.Dataset) -> list[str]:
    """Summarise a survey; of a long one the first lines."""
    lines = list(lines_of(survey))
    return lines if len(lines) <= MOST else [*lines[:MOST], f"… and {len(lines) - MOST} more"]


def _named(survey: xr.Dataset, head: str) -> list[str]:
    return [str(name) for name in survey.data_vars if str(name).startswith(head)]


def _unit(survey: xr.Dataset, name: str) -> str:
    units = str(survey[name].attrs["units"])
    return "" if units == "1" else f" {units}"


def _contrast(survey: xr.Dataset) -> Iterator[str]:
    outcomes = (
        f"; {int(survey['outcome_differs'].sum())} members ended otherwise" if "outcome_differs" in survey else ""
    )
    yield f"compared  with {survey.attrs['reference']}{outcomes}"
    yield from differences_said(survey)


def _sensitivities(survey: xr.Dataset) -> Iterator[str]:
    for name in _named(survey, "slope_"):
        values = survey[name].values
        if np.isfinite(values).any():
            yield f"{name} from {np.nanmin(values):.6g} to {np.nanmax(values):.6g}{_unit(survey, name)}"


def _influences(survey: xr.Dataset) -> Iterator[str]:
    axes = list(map(str, survey["axis_name"].values))
    for name in (
        *_named(survey, "main_effect_"),
        *(str(variable) for variable in survey.data_vars if str(variable).endswith("_changes")),
    ):
        most = survey[name].values.reshape(len(axes), -1).max(axis=-1)
        shares = ", ".join(f"{axis} {value:.1%}" for axis, value in zip(axes, most, strict=True))
        of_elements = " of its elements, at most" if survey[name].ndim > 1 else ""
        yield f"{name.replace('main_effect_', 'variance of ')}{of_elements}: {shares}"


def _convergence(survey: xr.Dataset) -> Iterator[str]:
    for name in _named(survey, "verdict_"):
        counts = Counter(
            words_of(survey[name].stack(each=survey[name].dims) if survey[name].ndim > 1 else survey[name])
        )
        number = name.removeprefix("verdict_")
        uncertainty = survey[f"uncertainty_{number}"].values
        most = (
            f", uncertain by up to {uncertainty_alone(float(np.nanmax(uncertainty)))}{_unit(survey, f'uncertainty_{number}')}"
            if np.isfinite(uncertainty).any()
            else ""
        )
        yield f"{number}: {', '.join(f'{count} {word}' for word, count in counts.most_common())}{most}"


def _precision(survey: xr.Dataset) -> Iterator[str]:
    varied = str(survey.attrs["varied"])
    finest = survey.isel({varied: int(np.argmin(survey[varied].values))})
    for name in _named(survey, "off_"):
        errors = finest[name]
        while errors.ndim > 1:
            errors = errors.isel({errors.dims[-1]: -1})
        labels = (
            [str(coordinate) for coordinate in errors[errors.dims[0]].values]
            if errors.ndim and errors.dims[0] in errors.coords
            else [""]
        )
        shown = ", ".join(
            f"{label} {value:.3g}".strip() for label, value in zip(labels, np.atleast_1d(errors.values), strict=False)
        )
        yield f"{name.removeprefix('off_')} with the finest {varied} is off by {shown}{_unit(survey, name)}"


def _indices(survey: xr.Dataset) -> Iterator[str]:
    yield f"draws     {survey.attrs['draws']} and seed {survey.attrs['seed']}"
    ends = [name.removeprefix("first_order") for name in map(str, survey.data_vars) if parted(name)[0] == "first_order"]
    for i, name in enumerate(map(str, survey["parameter_name"].values)):
        for end in ends[:MOST_ELEMENTS]:
            shares = []
            for word in ("first_order", "total_order"):
                low, high = survey[f"{word}_interval{end}"].values[i]
                shares.append(f"{word.replace('_', ' ')} {float(survey[word + end][i]):.3f} ({low:.3f} to {high:.3f})")
            of = f" of {spoken(survey.attrs['quantity'] + end)}" if end else ""
            yield f"{name}{of}: {', '.join(shares)}"
    if len(ends) > MOST_ELEMENTS:
        yield f"{len(ends) - MOST_ELEMENTS} further elements of {survey.attrs['quantity']} are in the record"


SUMMARIES = {
    kind: partial(_first_lines, lines_of)
    for kind, lines_of in {
        "contrast": _contrast,
        "sensitivities": _sensitivities,
        "influences": _influences,
        "convergence": _convergence,
        "precision": _precision,
        "sobol indices": _indices,
    }.items()
}

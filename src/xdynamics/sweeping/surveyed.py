"""What a survey of a sweep tells, in lines of text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from xdynamics.record.words import words_of
from xdynamics.schema import EVIDENCE

if TYPE_CHECKING:
    import xarray as xr

MOST = 16


def lines_of(found: xr.Dataset) -> list[str]:
    """Say what was found, the largest first where there is much."""
    lines = list(_TOLD[str(found.attrs[EVIDENCE])](found))
    return lines if len(lines) <= MOST else [*lines[:MOST], f"… and {len(lines) - MOST} more"]


def _named(found: xr.Dataset, head: str) -> list[str]:
    return [str(name) for name in found.data_vars if str(name).startswith(head)]


def _unit(found: xr.Dataset, name: str) -> str:
    units = str(found[name].attrs["units"])
    return "" if units == "1" else f" {units}"


def _contrast(found: xr.Dataset) -> Iterator[str]:
    differing = int(np.count_nonzero(found["outcome_differs"].values))
    yield f"compared  with {found.attrs['reference']}; {differing} members ended otherwise"
    for name in _named(found, "difference_"):
        values = np.abs(found[name].values.astype(float))
        if np.isfinite(values).any():
            yield f"{name.removeprefix('difference_')} differs by up to {np.nanmax(values):.4g}{_unit(found, name)}"


def _sensitivities(found: xr.Dataset) -> Iterator[str]:
    for name in _named(found, "slope_"):
        values = found[name].values
        if np.isfinite(values).any():
            yield f"{name} from {np.nanmin(values):.6g} to {np.nanmax(values):.6g}{_unit(found, name)}"


def _influences(found: xr.Dataset) -> Iterator[str]:
    axes = list(map(str, found["axis_name"].values))
    for name in (
        *_named(found, "main_effect_"),
        *(str(one) for one in found.data_vars if str(one).endswith("_changes")),
    ):
        shares = ", ".join(f"{axis} {value:.1%}" for axis, value in zip(axes, found[name].values, strict=True))
        yield f"{name.replace('main_effect_', 'variance of ')}: {shares}"


def _convergence(found: xr.Dataset) -> Iterator[str]:
    for name in _named(found, "verdict_"):
        counts = Counter(words_of(found[name].stack(each=found[name].dims) if found[name].ndim > 1 else found[name]))
        number = name.removeprefix("verdict_")
        doubt = found[f"uncertainty_{number}"].values
        most = f", uncertain by up to {np.nanmax(doubt):.3g}{_unit(found, f'uncertainty_{number}')}" if np.isfinite(doubt).any() else ""  # fmt: skip
        yield f"{number}: {', '.join(f'{count} {word}' for word, count in counts.most_common())}{most}"


def _precision(found: xr.Dataset) -> Iterator[str]:
    varied = str(found.attrs["varied"])
    finest = found.isel({varied: int(np.argmin(found[varied].values))})
    for name in _named(found, "off_"):
        one = finest[name]
        while one.ndim > 1:
            one = one.isel({one.dims[-1]: -1})
        labels = [str(at) for at in one[one.dims[0]].values] if one.ndim and one.dims[0] in one.coords else [""]
        said = ", ".join(f"{label} {value:.3g}".strip() for label, value in zip(labels, np.atleast_1d(one.values), strict=False))  # fmt: skip
        yield f"{name.removeprefix('off_')} with the finest {varied} is off by {said}{_unit(found, name)}"


def _indices(found: xr.Dataset) -> Iterator[str]:
    yield f"draws     {found.attrs['draws']} and seed {found.attrs['seed']}"
    for i, name in enumerate(map(str, found["parameter_name"].values)):
        parts = []
        for word in ("first_order", "total_order"):
            low, high = found[f"{word}_interval"].values[i]
            parts.append(f"{word.replace('_', ' ')} {float(found[word][i]):.3f} ({low:.3f} to {high:.3f})")
        yield f"{name}: {', '.join(parts)}"


_TOLD: dict[str, Callable[[xr.Dataset], Iterator[str]]] = {
    "contrast": _contrast, "sensitivities": _sensitivities, "influences": _influences, "convergence": _convergence,
    "precision": _precision, "sobol indices": _indices,
}  # fmt: skip

"""Residuals over a scale common to all times, never over the expected value at one time, which may pass zero."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from xdynamics import schema
from xdynamics.evidence.evidence_dataset import attrs_of

ROLE = "scaled"


def scale_of(expected: Any, computed: Any) -> Any:
    """Return the largest absolute expected value along the first axis; where that is 0, the largest computed one.

    Examples
    --------
    >>> float(scale_of(np.array([0.0, -2.0]), np.array([0.1, -2.2]))), float(scale_of(np.zeros(2), np.array([0.0, 1e-3])))
    (2.0, 0.001)
    """
    largest = np.abs(expected).max(axis=0)
    return np.where(largest > 0.0, largest, np.abs(computed).max(axis=0))


def divide_by_scale(residual: Any, scale: Any) -> Any:
    """Return residuals over their scale; 0 where both are 0."""
    return residual / np.where(scale > 0.0, scale, 1.0)


def root_mean_square(numbers: Any) -> Any:
    """Return the root of the mean square along the first axis, of each element the same as of it alone."""
    contiguous_squares = np.ascontiguousarray(np.moveaxis(np.asarray(numbers) ** 2, 0, -1))  # where NumPy sums pairwise
    return np.sqrt(np.mean(contiguous_squares, axis=-1))


def scaled_variables(
    kind: str,
    name: str,
    residual: Any,
    scale: Any,
    dims: Sequence[str],
    units: str,
    scale_text: str,
    norms: Sequence[str] = (),
) -> dict[str, Any]:
    """Return a residual over its scale, and the scale, ready for a Dataset.

    Parameters
    ----------
    kind : str
        Name of the residual: `residual`, `difference`.
    name : str
        Name of the quantity.
    residual : array
    scale : number, or array
        What `scale_of` returned.
    dims : sequence of str
        Of the residual; the scale and the norms have all but the first.
    units : str
        Of the scale.
    scale_text : str
        What the scale is, in words.
    norms : sequence of str
        Norms of the residual to add without a dimension: `rms`, `largest`.
    """
    key = f"{kind}_{name}"
    rule = {"scale_rule": f"{scale_text}; never its value at one time, which may pass zero"}
    variables = {
        schema.scaled_name(key): (
            tuple(dims),
            divide_by_scale(residual, scale),
            attrs_of("1", f"{key} over {schema.scale_name(kind, name)}", ROLE) | rule,
        ),
        schema.scale_name(kind, name): (
            tuple(dims)[1:],
            scale,
            attrs_of(units, f"scale of {key}: {scale_text}", "scale") | rule,
        ),
    }
    sizes: dict[str, Callable[[Any], Any]] = {
        "rms": root_mean_square,
        "largest": lambda off: np.max(np.abs(off), axis=0),
    }
    return variables | {
        schema.scaled_name(f"{norm}_{key}"): (
            tuple(dims)[1:],
            divide_by_scale(sizes[norm](residual), scale),
            attrs_of("1", f"{norm}_{key} over {schema.scale_name(kind, name)}", ROLE) | rule,
        )
        for norm in norms
    }

"""Local errors: the difference of one step from many in its place, as opposed to the error accumulated over a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from xdynamics.dynamics.shortened_steps import StepInterpolator
from xdynamics.faults import InputError
from xdynamics.methods.scheme import REINTEGRATE

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

DEFECT = "step_defect_"  # head of variables: the largest error of one step at each level
PARTS = 16  # steps in the place of one
LOOKED_AT = 256  # steps of a run, spread over it


def step_defects(
    run: xr.Dataset,
    names: Sequence[str] | None = None,
    *,
    functions: Mapping[str, Callable[..., float]] | None = None,
    max_steps: int = LOOKED_AT,
) -> dict[str, Floats]:
    """Return the states reached by steps spread over a run, each less that of sixteen steps in its place.

    Parameters
    ----------
    run : xarray.Dataset
        A run record.
    names : sequence of str, optional
        Coordinates, velocities and states, or elements of these; by default all that the record has.
    functions : mapping of str to callable, optional
        The Python functions that the model's forces call.
    max_steps : int
        Steps to look at.

    Returns
    -------
    dict of str to ndarray, shape (steps, ...)
        By these names, in their recorded units.

    Raises
    ------
    InputError
        If the method carries memory from one step to the next, so that no step can be repeated alone.
    """
    interpolator = StepInterpolator.of_run(run, functions, REINTEGRATE)
    if interpolator.settings.method.stepper.has_memory:
        raise InputError(
            f"steps of '{interpolator.settings.method.name}' depend on those before: none of them is repeated alone"
        )
    rows = np.flatnonzero(np.diff(np.asarray(run["time"])) > 0.0)
    chosen_rows = rows[np.unique(np.linspace(0, len(rows) - 1, min(max_steps, len(rows))).astype(np.int64))]
    defects, used = interpolator.defects(chosen_rows, PARTS), interpolator.layout.used
    return {name: used.values_of(defects, name) for name in (defects if names is None else names)}

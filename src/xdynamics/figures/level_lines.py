"""Lines that are level over whole steps: of what is held until the next row, and of means over the step before a row."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.dynamics.recorded_models import model_of_record
from xdynamics.methods import METHODS
from xdynamics.model import Model

REACTION = "reaction"  # role of forces of contacts and frictions

Floats = NDArray[np.float64]


def known_model(run: xr.Dataset) -> Model | None:
    """Return the record's model, if it has one that needs no Python functions."""
    if "model_toml" not in run.variables:
        return None
    model = model_of_record(run, None)
    return None if model.python_functions else model


def is_mean(run: xr.Dataset, name: str) -> bool:
    """Whether the values of a variable are means over the step before each row: impulses over its duration."""
    method = METHODS.get(str(run.attrs.get("solver_method")))
    if method is None or method.stepper.locates or not {name, "step_size"} <= {*run.variables}:
        return False
    return bool(run.variables[name].attrs.get("role") == REACTION)


def stairs(times: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return times and values of a line that keeps each value until the next row."""
    return np.repeat(times, 2)[1:], np.repeat(values, 2)[:-1]


def means(times: Floats, sizes: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return times and values of a line that is level over the step before each row, straight over rows that were left out.

    Parameters
    ----------
    times, sizes, values : ndarray, shape (n,)
        Of rows, the steps that led to them, and what was its mean over each.
    """
    starts = times - sizes
    starts[1:] = np.maximum(starts[1:], times[:-1])  # which it may be below by rounding
    return np.stack([starts, times], axis=1).ravel(), np.repeat(values, 2)

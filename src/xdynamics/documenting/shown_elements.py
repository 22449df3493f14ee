"""What a description of a run shows of quantities with dimensions: the rest is not parted into variables."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

from xdynamics.record import of_elements
from xdynamics.record.folding import model_dimensions
from xdynamics.schema import EVENTS, OF_MOTION, SAMPLES, STEPS

MOST_SHOWN = 12  # numbers of a state
MOST_PARTED = 1000  # numbers of a state, of which some are shown, from which the others are not parted
ALL_NUMBERS = "numbers_of_a_state"  # attribute of a run whose other elements are left out

Given = ParamSpec("Given")
Result = TypeVar("Result")


def of_shown_elements(describe: Callable[Given, Result]) -> Callable[Given, Result]:
    """Let a description take records of quantities with dimensions, of which it needs no forces, errors and samples.

    Of 10,000 elements each quantity takes tenths of a second to be parted.
    """
    of_parts: Callable[..., Result] = of_elements(describe)

    @wraps(describe)
    def describe_parts(*arguments: Given.args, **keywords: Given.kwargs) -> Result:
        return of_parts(*map(_shown_part, arguments), **keywords)

    return describe_parts


def _shown_part(run: Any) -> Any:
    """Leave out the columns of a run that have dimensions of the model, and of which no description shows a number."""
    if not (dims := {*model_dimensions(run)}):
        return run
    rows = {STEPS, SAMPLES}
    left_out = [
        name
        for name, variable in run.variables.items()
        if dims & {*variable.dims} and rows & {*variable.dims} and variable.attrs.get("role") not in OF_MOTION
    ]
    return run.drop_vars(left_out)


def first_elements(run: Any) -> Any:
    """Leave out of a run of very many numbers, in which nothing happens to some of them, those that are not shown."""
    if not (dims := model_dimensions(run)) or run.sizes.get(EVENTS, 0) or not run.sizes.get(STEPS, 0):
        return run
    numbers = sum(
        variable.size // run.sizes[STEPS]
        for variable in run.variables.values()
        if variable.dims[:1] == (STEPS,) and variable.attrs.get("role") in OF_MOTION
    )
    if numbers <= MOST_PARTED:
        return run
    return run.isel({dim: slice(MOST_SHOWN) for dim in dims if dim in run.dims}).assign_attrs({ALL_NUMBERS: numbers})


def of_motion(run: Any) -> list[str]:
    """Name what a march goes on from: coordinates, velocities, states, what controllers hold."""
    return [
        str(name)
        for name, entry in run.variables.items()  # to look up one of them as a DataArray takes time with their number
        if entry.dims == (STEPS,) and entry.attrs.get("role") in OF_MOTION
    ]

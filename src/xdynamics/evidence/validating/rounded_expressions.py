"""What rounding does to the expressions of a closed form and of the start, beside the same with 31 digits."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.evidence.observed_quantities import parameters_read_by
from xdynamics.expressions import Call, Node, free_names
from xdynamics.expressions.tree import every
from xdynamics.model import Model
from xdynamics.model.element_numbers import ElementNumbers
from xdynamics.model.elementwise import in_si
from xdynamics.model.kinks import JUMPING
from xdynamics.model.motion import constants
from xdynamics.model.parts import Validation
from xdynamics.model.whole import expanded_tree
from xdynamics.schema import AT
from xdynamics.shapes import Extent
from xdynamics.shapes.blocks import Block, Blocks
from xdynamics.shapes.precise_evaluation import rounding_errors

Floats = NDArray[np.float64]

MAGNIFIED = 2.0**20  # times its rounding, by which a start is moved: what a march makes of it stands out of its own
NEAR_JUMP = 2.0**-26  # of the largest value: what is further off by rounding is on another side of a jump
_APART = frozenset((*JUMPING, "atan2"))  # functions of which rounding may take another side
PIECE = 1 << 18  # numbers of a closed form that are evaluated together: each has dozens of intermediate results


def start_without_rounding(model: Model) -> Model | None:
    """Return a model whose start is moved from its own to that of its expressions, `MAGNIFIED` times as far.

    None where no start is given by an expression, or rounding did nothing to any.
    """
    if not any(values.tree is not None for values in model.shaped.starting.values()):
        return None
    errors = ElementNumbers(model.shaped, model.shapes).rounding_at_start(
        model.statement.parameters, model.statement.initial
    )
    initial = {}
    for name, rounding_error in errors.items():
        block = Blocks.from_names("", [name], model.shapes)
        start = in_si(model.statement.initial, block).reshape(rounding_error.shape)
        tree = model.shaped.starting[name].tree
        error = (
            rounding_error
            if tree is None
            else without_jumps(tree, rounding_error, float(np.max(np.abs(start), initial=0.0)))
        )
        if error.any():
            moved_start = start - MAGNIFIED * error
            unit = model.statement.initial[block.blocks[0].first].unit
            initial[name] = {"unit": unit.text, "value": (moved_start / float(unit.factor)).tolist()}
    return model.replace(initial=initial) if initial else None


def without_jumps(tree: Node, errors: Any, size: float) -> Any:
    """Return what rounding did to an expression, 0 where that is another side of a jump, or of a pole.

    Parameters
    ----------
    tree : Node
    errors : ndarray
    size : float
        The largest value that is expected.
    """
    jumps = any(isinstance(part, Call) and part.function in _APART for part in every(tree))
    return np.where(np.abs(errors) <= (NEAR_JUMP if jumps else 2.0) * size, errors, 0.0)


def rounding_of_form(
    model: Model, case: Validation, block: Block, times: Floats, exact_values: Floats, size: float
) -> Any:
    """Return the most that rounding did to a closed form at some times, of each element, in SI units.

    Parameters
    ----------
    model : Model
    case : Validation
    block : Block
        The elements; without dimensions there is one number.
    times : ndarray, shape (k,), s
    exact_values : ndarray, shape (k, ...)
        The closed form in floats.
    size : float
        The largest value of the quantity along the run.
    """
    if block.dims:
        tree = expanded_tree(model, case.expression)
        input_values = parameters_read_by(model, [tree]) or constants(model)
    else:
        tree, input_values = model.expanded(case.expression), constants(model)
        input_values = {name: input_values[name] for name in free_names(tree) & input_values.keys()}
    if free_names(tree) - input_values.keys() - {"t"}:
        return 0.0
    shapes, count = model.shapes, max(1, PIECE // block.size)
    largest_error: Any = 0.0
    for first in range(0, len(times), count):
        part = slice(first, first + count)
        part_times = times[part]
        part_shapes = replace(
            shapes, dims={**shapes.dims, "t": (AT,)}, extents={**shapes.extents, AT: Extent(AT, len(part_times))}
        )
        values = np.moveaxis(exact_values[part], 0, -1)
        errors = rounding_errors(tree, (*block.dims, AT), {**input_values, "t": part_times}, part_shapes, values, AT)
        errors = without_jumps(tree, errors, size)
        largest_error = np.maximum(largest_error, np.max(np.abs(errors), axis=-1))
    return largest_error

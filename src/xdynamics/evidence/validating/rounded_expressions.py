"""What rounding does to the expressions of a closed form and of the start, beside the same with 31 digits."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.evidence.observed_quantities import given_to
from xdynamics.expressions import free_names
from xdynamics.model import Model
from xdynamics.model.element_numbers import ElementNumbers
from xdynamics.model.elementwise import in_si
from xdynamics.model.motion import constants
from xdynamics.model.parts import Validation
from xdynamics.model.whole import written_out
from xdynamics.schema import AT
from xdynamics.shapes import Extent
from xdynamics.shapes.blocks import Block, Blocks
from xdynamics.shapes.precise_evaluation import rounding_errors

Floats = NDArray[np.float64]

MAGNIFIED = 2.0**20  # times its rounding, by which a start is moved: what a march makes of it stands out of its own
PIECE = 1 << 18  # numbers of a closed form that are evaluated together: each has dozens of intermediate results


def start_without_rounding(model: Model) -> Model | None:
    """Return a model whose start is moved from its own to that of its expressions, `MAGNIFIED` times as far.

    None where no start is given by an expression, or rounding did nothing to any.
    """
    if not any(values.tree is not None for values in model.shaped.starting.values()):
        return None
    errors = ElementNumbers(model.shaped, model.shapes).rounding_at_start(model.parameters, model.initial)
    initial = {}
    for name, error in errors.items():
        if error.any():
            block = Blocks.of("", [name], model.shapes)
            moved = in_si(model.initial, block).reshape(error.shape) - MAGNIFIED * error
            unit = model.initial[block.blocks[0].first].unit
            initial[name] = {"unit": unit.text, "value": (moved / float(unit.factor)).tolist()}
    return model.replace(initial=initial) if initial else None


def rounding_of_form(model: Model, case: Validation, block: Block, times: Floats, found: Floats) -> Any:
    """Return the most that rounding did to a closed form at some times, of each element, in SI units.

    Parameters
    ----------
    model : Model
    case : Validation
    block : Block
        The elements; without dimensions there is one number.
    times : ndarray, shape (k,), s
    found : ndarray, shape (k, ...)
        The closed form in floats.
    """
    if block.dims:
        tree = written_out(model, case.expression)
        known = given_to(model, [tree]) or constants(model)
    else:
        tree, known = model.expanded(case.expression), constants(model)
        known = {name: known[name] for name in free_names(tree) & known.keys()}
    if free_names(tree) - known.keys() - {"t"}:
        return 0.0
    shapes, count = model.shapes, max(1, PIECE // block.size)
    most: Any = 0.0
    for first in range(0, len(times), count):
        part = slice(first, first + count)
        here = times[part]
        inside = replace(
            shapes, dims={**shapes.dims, "t": (AT,)}, extents={**shapes.extents, AT: Extent(AT, len(here))}
        )
        values = np.moveaxis(found[part], 0, -1)
        errors = rounding_errors(tree, (*block.dims, AT), {**known, "t": here}, inside, values, AT)
        most = np.maximum(most, np.max(np.abs(errors), axis=-1))
    return most

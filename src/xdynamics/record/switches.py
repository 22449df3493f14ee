"""What the record says of switches hidden in forces: on which side of each a row is, and of smooth ones how often they were passed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.expressions import Binary, Compare, Node, text_of
from xdynamics.expressions.evaluation import evaluate
from xdynamics.march import Block, March
from xdynamics.march.log import PIECES
from xdynamics.model.motion import constants
from xdynamics.model.switches import Path, Switch, watched_by
from xdynamics.record.column import About, Column
from xdynamics.schema import STEPS, Variable
from xdynamics.units import TIME

Array = NDArray[Any]


def side_columns(about: About) -> list[Column]:
    """Return on which side of each located switch every row is; of the points of a table the piece between them."""
    found, places, place = [], {}, 2 + len(about.layout.reactions)
    switches = watched_by(about.model)
    for one in switches:
        places[one.owner, one.function] = place
        place += 3 if one.drive else 1
    for one in switches:
        first = places[one.owner, one.function]
        if one.drive:
            said = f"piece of table {one.drive} that '{one.owner}' reads: 0 is before its first point, 1 behind it"
            variable = Variable(schema.side_of(one.name), (STEPS,), "i4", "1", said, "switch")
            found.append(Column(variable, _piece(first)))
            continue
        own = {function: at for (owner, function), at in places.items() if owner == one.owner}
        words = {number: word for number, word in schema.SIDES.items() if number or one.nested}
        more = schema.flags(words) | {"function": text_of(one.function)}
        said = f"side of switch {one.name}: the sign of its function"
        said += "; elsewhere where it decides nothing, inside a where" if one.nested else ""
        variable = Variable(schema.side_of(one.name), (STEPS,), "i1", "1", said, "flag", more)
        found.append(Column(variable, _side(about, one, first, own)))
    return found


def _piece(first: int) -> Callable[[Block], Array]:
    def take(block: Block) -> Array:
        digits = block.log.flags[first : first + 3, : block.rows].astype(np.int32)
        found: Array = digits[0] + PIECES * (digits[1] + PIECES * digits[2])
        return found

    return take


def _side(about: About, switch: Switch, place: int, places: Mapping[Node, int]) -> Callable[[Block], Array]:
    """Take a side, and 0 where other branches hold of the `where`s around it."""
    if not switch.nested:
        return lambda block: block.log.flags[place, : block.rows]
    known = dict(constants(about.model, about.scales))

    def holds(condition: Compare, block: Block) -> Array:
        at = places.get(Binary("-", condition.left, condition.right))
        if at is None:  # it compares what does not change
            return np.full(block.rows, bool(evaluate(condition, known)))
        side = block.log.flags[at, : block.rows]
        return side < 0 if condition.operator[0] == "<" else side > 0

    def along(path: Path, block: Block) -> Array:
        found = np.ones(block.rows, bool)
        for condition, wanted in path:
            found &= holds(condition, block) == wanted
        return found

    def take(block: Block) -> Array:
        decides = np.any([along(path, block) for path in switch.paths], axis=0)
        return np.where(decides, block.log.flags[place, : block.rows], np.int8(0))

    return take


def passed(march: March) -> list[tuple[Variable, Array]]:
    """Return how often each switch that was declared smooth was passed, and when first; nothing where there is none."""
    smooth = march.layout.smooth
    if not smooth:
        return []
    counts, times = march.passed
    more = {"names": " ".join(one.name for one in smooth)}
    return [
        (replace(schema.PASSED, more=more), counts),
        (
            replace(schema.FIRST_PASSED, more=more, units=march.model.time_unit.text),
            times * march.settings.scales.of(TIME),
        ),
    ]

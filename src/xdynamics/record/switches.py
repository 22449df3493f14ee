"""Columns of the switches hidden in forces: the side of each for every row, and how often smooth ones were passed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.expressions import Binary, Compare, Node
from xdynamics.expressions.evaluation import evaluate
from xdynamics.march import LogBlock, March
from xdynamics.march.log import PIECES
from xdynamics.model import Model
from xdynamics.model.kinks import Path
from xdynamics.model.motion import constants
from xdynamics.model.regime_model import watched_by
from xdynamics.model.switches import Switch
from xdynamics.record.column import About, Column
from xdynamics.record.element_names import names_as_words
from xdynamics.schema import STEPS, Variable
from xdynamics.shapes import Shapes
from xdynamics.shapes.naming import split_element_name
from xdynamics.units import TIME

Array = NDArray[Any]


def shapes_with_switches(model: Model) -> Shapes:
    """Return the shapes of a model with those of the switches hidden in its forces, and of their sides."""
    dims = {split_element_name(switch.name)[0]: switch.dims for switch in watched_by(model) if switch.dims}
    sides = {schema.side_of(name): switch_dims for name, switch_dims in dims.items()}
    return replace(model.shapes, dims={**model.shapes.dims, **dims, **sides}) if dims else model.shapes


def side_columns(about: About) -> list[Column]:
    """Return the side of each located switch for every row; for the points of a table, the piece between them."""
    collected, places, flag_row = [], {}, 2 + about.layout.reactions.size
    switches = watched_by(about.model)
    for switch in switches:
        places[switch.owner, switch.function] = flag_row
        flag_row += 3 if switch.drive else 1
    for switch in switches:
        first = places[switch.owner, switch.function]
        if switch.drive:
            long_name = (
                f"piece of table {switch.drive} that '{switch.owner}' reads: 0 is before its first point, 1 behind it"
            )
            variable = Variable(schema.side_of(switch.name), (STEPS,), "i4", "1", long_name, "switch")
            collected.append(Column(variable, _piece_taker(first)))
            continue
        places_of_owner = {
            function: flag_index for (owner, function), flag_index in places.items() if owner == switch.owner
        }
        sides = {number: word for number, word in schema.SIDES.items() if number or switch.nested or switch.dims}
        extra = schema.flag_attributes(sides) | {"function": switch.text}
        long_name = f"side of switch {switch.name}: the sign of its function"
        long_name += "; elsewhere where it decides nothing, inside a where" if switch.nested else ""
        variable = Variable(schema.side_of(switch.name), (STEPS,), "i1", "1", long_name, "flag", extra)
        collected.append(Column(variable, _side_taker(about, switch, first, places_of_owner)))
    return collected


def _piece_taker(first: int) -> Callable[[LogBlock], Array]:
    def take_piece(block: LogBlock) -> Array:
        digits = block.log.flags[first : first + 3, : block.rows].astype(np.int32)
        pieces: Array = digits[0] + PIECES * (digits[1] + PIECES * digits[2])
        return pieces

    return take_piece


def _side_taker(about: About, switch: Switch, flag_row: int, places: Mapping[Node, int]) -> Callable[[LogBlock], Array]:
    """Take a side, and 0 where the enclosing `where`s select other branches."""
    if not switch.nested:
        return lambda block: block.log.flags[flag_row, : block.rows]
    values = dict(constants(about.model, about.scales))

    def condition_holds(condition: Compare, block: LogBlock) -> Array:
        flag_index = places.get(Binary("-", condition.left, condition.right))
        if flag_index is None:  # it compares constants
            return np.full(block.rows, bool(evaluate(condition, values)))
        side = block.log.flags[flag_index, : block.rows]
        return side < 0 if condition.operator[0] == "<" else side > 0

    def path_holds(path: Path, block: LogBlock) -> Array:
        holding = np.ones(block.rows, bool)
        for condition, expected_truth in path:
            holding &= condition_holds(condition, block) == expected_truth
        return holding

    def take_side(block: LogBlock) -> Array:
        decides = np.any([path_holds(path, block) for path in switch.paths], axis=0)
        return np.where(decides, block.log.flags[flag_row, : block.rows], np.int8(0))

    return take_side


def smooth_switch_passes(march: March) -> list[tuple[Variable, Array]]:
    """Return how often each switch that was declared smooth was passed, and when first; empty without such switches."""
    smooth = march.layout.smooth
    if not smooth:
        return []
    counts, times = march.passed
    more = {"names": names_as_words(switch.name for switch in smooth)}
    return [
        (replace(schema.PASSED, more=more), counts),
        (
            replace(schema.with_time_unit(schema.FIRST_PASSED, march.model.time_unit), more=more),
            times * march.settings.scales.si_factor(TIME),
        ),
    ]

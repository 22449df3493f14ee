"""Where a law finds what expressions name: in the state, among the constants, in a table, in the march's past."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from xdynamics.expressions import derivative
from xdynamics.expressions.calculus import ONE
from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.layout import Layout
from xdynamics.kernels.program import AT, Location, Operand
from xdynamics.kernels.step_polynomial import past_degree
from xdynamics.model import Function
from xdynamics.model.delayed_values import before_start, delayed_names
from xdynamics.model.delays import argument_before, in_history, value_before
from xdynamics.model.drive_arguments import CLOCK
from xdynamics.model.motion import REGIME_NUMBER, constant_names, drive_slope
from xdynamics.model.regime_model import watched_by
from xdynamics.model.whole import motion_shapes
from xdynamics.shapes.blocks import Blocks

PYTHON = "python_"  # prefix of the names of functions passed in


def call_python_function(lines: Assignments, function: Function) -> Operand:
    """Call a function that was passed in."""
    return lines.compute(PYTHON + function.name, *(lines.operand_of(argument) for argument in function.arguments))


class LawNames:
    """Finds what the expressions of a law name: in `at`, in the state, among the constants, in a table.

    Any other name is computed where it first occurs, from the assignments `inner`.
    """

    def __init__(
        self,
        layout: Layout,
        state_blocks: Blocks,
        inner: Mapping[str, Any] | None = None,
        state: str = "y",
        time: str = "t",
    ) -> None:
        self._state, self._time = state, time
        self._layout = layout
        self._known = state_blocks
        self._inner = inner or {}
        self._kept = {switch.drive for switch in watched_by(layout.model)}
        self._drives = {name: i for i, name in enumerate(layout.drives)}
        self._constants = constant_names(layout.model)
        self._delayed = delayed_names(layout.model)

    def _delayed_value(self, lines: Assignments, name: str, delay: int, owner: str) -> Operand:
        """Write a delayed value, its time derivative, or its time: from the march's past or, before the start, its history."""
        layout, model, clock = self._layout, self._layout.model, value_before(delay, "t")
        if name == clock:
            return lines.compute("subtract", lines.operand_of("t"), lines.value(model.delays[delay]))
        derived = name != value_before(delay, owner)
        if owner in self._drives:
            argument, number = (
                lines.value(argument_before(model.looked_up_at[owner], model.moving, delay)),
                self._drives[owner],
            )
            piece = lines.compute("find_piece", argument, number)
            return lines.compute("slope_at" if derived else "value_at", argument, piece, number)
        where = lines.operand_of(clock), len(layout.drives) + delay, layout.used.offset_of(owner), layout.used.size
        past = lines.compute("past_slope_at" if derived else "past_at", *where, past_degree(layout))
        tree = before_start(model, owner, delay)
        history_value = lines.value(derivative(tree, {clock: ONE}) if derived else tree)
        return lines.compute(
            "choose", lines.compute("more", lines.operand_of(in_history(delay)), 0.0), history_value, past
        )

    def location_of(self, name: str) -> Location | None:
        """Return where a number is, or the first of a quantity with dimensions."""
        if name in ("t", REGIME_NUMBER):
            return Location("at", AT.index(self._time if name == "t" else "regime"))
        if name not in self._drives and (index := self._known.find_offset(name)) is not None:
            return Location(self._state, index)
        index = self._constants.find_offset(name)
        return None if index is None else Location("p", index)

    def first_location(self, name: str) -> Location:
        """Return where the numbers of a quantity with dimensions begin."""
        location = self.location_of(motion_shapes(self._layout.model).first(name))
        assert location is not None  # noqa: S101 - what expressions name was checked
        return location

    def __call__(self, lines: Assignments, name: str) -> Operand:
        """Return the operand of a name where it first occurs."""
        if (location := self.location_of(name)) is not None:
            return lines.load(location, name)
        if name in self._inner:
            inner = self._inner[name]
            return call_python_function(lines, inner) if isinstance(inner, Function) else lines.value(inner)
        if (delayed := self._delayed.get(name)) is not None:
            return self._delayed_value(lines, name, *delayed)
        drive = name.removeprefix(drive_slope(""))
        number, argument = self._drives[drive], self._layout.model.looked_up_at[drive]
        argument_value = lines.value(argument)
        operation = "value_at" if drive == name else "slope_at"
        # where the march lands on ends of pieces, one piece holds throughout a step: a jump falls between steps
        if argument == CLOCK or (drive in self._kept and self._layout.model.drives[drive].outside != "error"):
            return lines.compute(operation, argument_value, lines.compute("piece_of", number), number)
        looked_up = lines.compute(
            operation, argument_value, lines.compute("find_piece", argument_value, number), number
        )
        if drive not in self._kept:
            return looked_up
        # outside the table there is no piece: the lookup is nan, and stays nan times 0
        value = lines.compute(operation, argument_value, lines.compute("piece_of", number), number)
        return lines.compute("add", value, lines.compute("multiply", 0.0, looked_up))

"""Where a law finds what expressions name: in the state, among the constants, in a table, in the march's past."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from xdynamics.expressions import derivative
from xdynamics.expressions.calculus import ONE
from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.layout import Layout
from xdynamics.kernels.program import AT, Operand, Place
from xdynamics.kernels.step_polynomial import past_degree
from xdynamics.model import Function
from xdynamics.model.delayed_values import before_start, delayed_names
from xdynamics.model.delays import in_history, place_before, value_before
from xdynamics.model.drive_arguments import CLOCK
from xdynamics.model.motion import REGIME_NUMBER, constant_names, slope
from xdynamics.model.regime_model import watched_by
from xdynamics.model.whole import shapes_of
from xdynamics.shapes.blocks import Blocks

PYTHON = "python_"  # prefix of the names of functions passed in


def called(lines: Assignments, function: Function) -> Operand:
    """Call a function that was passed in."""
    return lines.compute(PYTHON + function.name, *(lines.named(argument) for argument in function.arguments))


class LawNames:
    """Finds what the expressions of a law name: in `at`, in the state, among the constants, in a table.

    Any other name is computed where it first occurs, from the assignments `inner`.
    """

    def __init__(
        self,
        layout: Layout,
        known: Blocks,
        inner: Mapping[str, Any] | None = None,
        state: str = "y",
        time: str = "t",
    ) -> None:
        self._state, self._time = state, time
        self._layout = layout
        self._known = known
        self._inner = inner or {}
        self._kept = {switch.drive for switch in watched_by(layout.model)}
        self._drives = {name: i for i, name in enumerate(layout.drives)}
        self._constants = constant_names(layout.model)
        self._delayed = delayed_names(layout.model)

    def _looked_back(self, lines: Assignments, name: str, delay: int, owner: str) -> Operand:
        """Write a delayed value, its time derivative, or its time: from the march's past or, before the start, its history."""
        layout, model, clock = self._layout, self._layout.model, value_before(delay, "t")
        if name == clock:
            return lines.compute("subtract", lines.named("t"), lines.value(model.delays[delay]))
        derived = name != value_before(delay, owner)
        if owner in self._drives:
            at, number = lines.value(place_before(model.looked_up_at[owner], model.moving, delay)), self._drives[owner]
            piece = lines.compute("find_piece", at, number)
            return lines.compute("slope_at" if derived else "value_at", at, piece, number)
        where = lines.named(clock), len(layout.drives) + delay, layout.used.place(owner), layout.used.size
        past = lines.compute("past_slope_at" if derived else "past_at", *where, past_degree(layout))
        tree = before_start(model, owner, delay)
        before = lines.value(derivative(tree, {clock: ONE}) if derived else tree)
        return lines.compute("choose", lines.compute("more", lines.named(in_history(delay)), 0.0), before, past)

    def place(self, name: str) -> Place | None:
        """Return where a number is, or the first of a quantity with dimensions."""
        if name in ("t", REGIME_NUMBER):
            return Place("at", AT.index(self._time if name == "t" else "regime"))
        if name not in self._drives and (found := self._known.find(name)) is not None:
            return Place(self._state, found)
        found = self._constants.find(name)
        return None if found is None else Place("p", found)

    def first(self, name: str) -> Place:
        """Return where the numbers of a quantity with dimensions begin."""
        place = self.place(shapes_of(self._layout.model).first(name))
        assert place is not None  # noqa: S101 - what expressions name was checked
        return place

    def __call__(self, lines: Assignments, name: str) -> Operand:
        """Return the operand of a name where it first occurs."""
        if (place := self.place(name)) is not None:
            return lines.load(place, name)
        if name in self._inner:
            inner = self._inner[name]
            return called(lines, inner) if isinstance(inner, Function) else lines.value(inner)
        if (delayed := self._delayed.get(name)) is not None:
            return self._looked_back(lines, name, *delayed)
        drive = name.removeprefix(slope(""))
        number, argument = self._drives[drive], self._layout.model.looked_up_at[drive]
        at = lines.value(argument)
        operation = "value_at" if drive == name else "slope_at"
        # where the march lands on ends of pieces, one piece holds throughout a step: a jump falls between steps
        if argument == CLOCK or (drive in self._kept and self._layout.model.drives[drive].outside != "error"):
            return lines.compute(operation, at, lines.compute("piece_of", number), number)
        looked_up = lines.compute(operation, at, lines.compute("find_piece", at, number), number)
        if drive not in self._kept:
            return looked_up
        # outside the table there is no piece: the lookup is nan, and stays nan times 0
        value = lines.compute(operation, at, lines.compute("piece_of", number), number)
        return lines.compute("add", value, lines.compute("multiply", 0.0, looked_up))

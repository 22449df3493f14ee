"""Checks of delayed values: where they stand, what is delayed, by how much, and what it was before the start."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields
from math import isfinite, pi

from xdynamics.expressions import Node, dimension_of, expand, free_names, shortened_text, text_of
from xdynamics.expressions.evaluation import evaluate
from xdynamics.faults import InputError, Ledger
from xdynamics.model.delays import has_delays
from xdynamics.model.statement import Statement, trees_in
from xdynamics.schema import velocity
from xdynamics.units import Dimension, constant

_SECTIONS = ("definitions", "forces", "states", "events", "controllers", "observables", "observed")
_TITLES = {"pictured": "figure", "starting": "initial", "arrays": "parameters"}
_PLACES = "components of forces, rates of states, events, controllers, observables and definitions of these"


def check_delays(statement: Statement, dimensions: Mapping[str, Dimension], ledger: Ledger) -> None:
    """Check everything that is delayed, and the history of each."""
    if statement.delayed and statement.extents:
        ledger.note("delayed values are of single numbers, and the model has [dimensions]; write its elements out")
        return
    moving = {*statement.coordinates, *map(velocity, statement.coordinates), *statement.states}
    constants = {*statement.parameters, *statement.unit_constants, "pi"}
    read = set[str]()
    for call in statement.delayed:
        with ledger.entry(f"'{shortened_text(call)}'"):
            delayed_tree, delay_tree = (expand(part, statement.definitions) for part in call.arguments)
            read |= free_names(delayed_tree)
            _check_delay(delay_tree, constants, statement)
            _check_delayed(delayed_tree, moving, statement)
    for label, tree in _elsewhere(statement):
        if has_delays(expand(tree, statement.definitions)):
            ledger.note(f"{label} has a delayed value, which stands in {_PLACES} alone")
    for name, tree in statement.history.items():
        with ledger.entry(f"history of '{name}'"):
            if name not in moving:
                raise InputError(f"is of no coordinate, velocity or state; there are {', '.join(sorted(moving))}")
            if name not in read:
                raise InputError(f"is read nowhere: no expression has delayed({name}, …)")
            if dimension_of(tree, dimensions) != dimensions[name]:
                raise InputError(f"has units '{dimension_of(tree, dimensions)}', needs '{dimensions[name]}'")
            if wrong := sorted(free_names(expand(tree, statement.definitions)) - constants - {"t"}):
                raise InputError(f"reads '{wrong[0]}'; what was before the start is of t and parameters")


def _check_delay(delay_tree: Node, constants: set[str], statement: Statement) -> None:
    """Refuse a delay that changes, or is no positive time."""
    if wrong := sorted(free_names(delay_tree) - constants):
        raise InputError(
            f"has the delay '{text_of(delay_tree)}', which reads '{wrong[0]}'; a delay is of parameters and does not change"
        )
    constant_values = {name: part.quantity.si for name, part in statement.parameters.items()}
    constant_values |= {name: float(constant(name).factor) for name in statement.unit_constants}
    delay = evaluate(delay_tree, constant_values | {"pi": pi})
    if not (isfinite(delay) and delay > 0.0):
        raise InputError(
            f"has the delay '{text_of(delay_tree)}' = {delay!r} {statement.time_unit.text}, needs a positive time"
        )


def _check_delayed(delayed_tree: Node, moving: set[str], statement: Statement) -> None:
    """Refuse to delay what does not move, what delays itself, and tables with jumps, or kinks where no time is known."""
    names = free_names(delayed_tree)
    if has_delays(delayed_tree):
        raise InputError("reads a definition with another delayed value; write one delay, the sum of both")
    if not names & {"t", *moving, *statement.drives}:
        raise InputError("delays what never changes; leave out delayed")
    for name in sorted(names & {*statement.drives}):
        drive = statement.drives[name]
        timed = not free_names(expand(drive.argument, statement.definitions)) & moving
        if (
            drive.interpolation == "previous"
            or drive.outside == "zero"
            or (drive.interpolation == "linear" and not timed)
        ):
            raise InputError(
                f"delays the drive '{name}', whose table has jumps, or kinks along a motion; give it interpolation ="
                ' "pchip" and outside = "hold", or write a second drive with the argument t - delay'
            )


def _elsewhere(statement: Statement) -> Iterator[tuple[str, Node]]:
    """Yield the expressions that cannot have delayed values, with what each is."""
    for name, force in statement.forces.items():
        if force.potential is not None:
            yield f"potential of '{name}'", force.potential
    for part in fields(statement):
        if part.name not in _SECTIONS:
            yield from (
                (f"[{_TITLES.get(part.name, part.name)}]", tree) for tree in trees_in(getattr(statement, part.name))
            )

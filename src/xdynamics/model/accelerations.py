"""Accelerations in rates of states: what a coordinate's forces over its mass are, in the place of its acceleration.

The integral of a square, as of a seat's acceleration, is so a state like any other: with an error, and at every event.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from xdynamics.expressions import Binary, Node, derivative, expand, free_names
from xdynamics.expressions.calculus import ONE, ZERO, negative, sum_of_terms
from xdynamics.faults import InputError
from xdynamics.model.parts import Function, State
from xdynamics.model.regimes import in_some
from xdynamics.model.statement import Statement
from xdynamics.schema import acceleration


def with_accelerations(statement: Statement) -> Statement:
    """Return a statement whose rates read no accelerations, but the forces over the masses that these are.

    Raises
    ------
    InputError
        If a rate reads an acceleration that other forces than those of the model change, or a full mass.
    """
    names = {acceleration(name): name for name in statement.coordinates}
    read = {
        name: sorted(names.keys() & _names_in(state, statement.definitions)) for name, state in statement.states.items()
    }
    if not any(read.values()):
        return statement
    trees: dict[str, Node] = {}
    for state, accelerations in read.items():
        for name in accelerations:
            if reason := _obstacle(statement, names[name]):
                raise InputError(
                    f"the rate of state '{state}' reads '{name}', {reason}; write the force over the mass in its place"
                )
            trees[name] = trees.get(name) or _acceleration_of(statement, names[name])
    states = {
        name: _expanded(state, statement.definitions, trees) if read[name] else state
        for name, state in statement.states.items()
    }
    return replace(statement, states=states)


def read_accelerations(statement: Statement) -> bool:
    """Whether rates, as they are written, read accelerations: what they make of these is no convex combination of sides."""
    names = {*map(acceleration, statement.coordinates)}
    return any(
        not names.isdisjoint(free_names(tree))
        for state in statement.states.values()
        for tree in (state.written_rate, *state.terms.values())
        if tree is not None
    )


def _names_in(state: State, definitions: Mapping[str, Node]) -> set[str]:
    return free_names(expand(state.rate, definitions))


def _expanded(state: State, definitions: Mapping[str, Node], trees: Mapping[str, Node]) -> State:
    """Return a state with accelerations written out, and its rate as it was written kept beside."""
    known = {**definitions, **trees}
    acting = {term: expand(tree, known) for term, tree in state.acting.items()}
    return replace(state, rate=expand(state.rate, known), acting=acting, own_rate=state.written_rate)


def _obstacle(statement: Statement, coordinate: str) -> str:
    """Say what keeps the acceleration of a coordinate from being its forces over its mass; empty if nothing does."""
    for section in ("contacts", "frictions", "constraints", "joints", "bodies", "assemblies"):
        if getattr(statement, section):
            return f"which forces of {section} change"
    if statement.lagrangian is not None or statement.mass_is_full:
        return "and the mass is full: it depends on all forces"
    if statement.extents or statement.arrays:
        return "and quantities have dimensions"
    if any(isinstance(force.components.get(coordinate), Function) for force in statement.forces.values()):
        return "and a force is written in Python"
    return ""


def _acceleration_of(statement: Statement, coordinate: str) -> Node:
    """Return the sum of the forces on a coordinate, each in its regimes, over its mass."""
    parts = []
    for term, force in statement.forces.items():
        tree = force.components.get(coordinate, ZERO)
        if force.potential is not None:
            tree = derivative(negative(expand(force.potential, statement.definitions)), {coordinate: ONE})
        assert not isinstance(tree, Function)  # noqa: S101 - refused before
        regimes = [*statement.regimes.values()]
        acting = [i for i, regime in enumerate(regimes) if term in regime.forces]
        if tree != ZERO:
            parts.append(tree if len(acting) == len(regimes) else in_some(tree, acting))
    place = [*statement.coordinates].index(coordinate)
    return Binary("/", sum_of_terms(parts), statement.mass[place][place]) if parts else ZERO

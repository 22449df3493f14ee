"""Manufactured solutions: the force that makes a wanted trajectory exact."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from typing import Any

import numpy as np

from xdynamics.expressions import (
    Along,
    Binary,
    Call,
    Compare,
    Node,
    Number,
    dimension_of,
    free_names,
    parse,
    text_of,
)
from xdynamics.expressions.calculus import ONE, ZERO, add, derivative, expand, multiply
from xdynamics.expressions.evaluation import evaluate
from xdynamics.expressions.tree import every
from xdynamics.faults import InputError, Ledger
from xdynamics.model import Model, check_model
from xdynamics.model.closed_forms import ORDER
from xdynamics.model.drive_arguments import CLOCK
from xdynamics.model.motion import constants
from xdynamics.model.parts import Function
from xdynamics.model.whole import acting, has_wholes, varying, written_out
from xdynamics.schema import velocity
from xdynamics.shapes import at, dims_of, prepared, spoken
from xdynamics.shapes.gradient import derivative as derivative_of_wholes
from xdynamics.shapes.trees import expanded

TERM = "manufactured"
MOST_WRITTEN_OUT = 300  # elements of a quantity that have an expression each


def manufactured(model: Model, trajectory: Mapping[str, str]) -> Model:
    """Return a model whose exact solution is a wanted trajectory, with closed forms that state it.

    One more force is added, ``manufactured``, of time alone: M a of the trajectory less all other forces on it.
    First-order states get such a term in their rates. The other forces act as before: any fault in their code, or in
    the order of a method for them, shows in the residual.

    Parameters
    ----------
    model : Model
        Without contacts, friction, regimes, functions in Python, or drives of anything but time.
    trajectory : mapping of str to str
        For every coordinate and first-order state an expression of time and parameters, like ``{"x": "A*sin(w*t)"}``;
        of one with dimensions with the same dimensions, like ``{"T": "kelvin*exp(-t/second)*index(cell)"}``.

    Returns
    -------
    Model
        With `forces.manufactured`, initial values on the trajectory, and `validation` of every coordinate, velocity and
        state by the order of the method.

    Raises
    ------
    InputError
        If the trajectory is incomplete or has another unit, or the model is not of this kind.

    Notes
    -----
    Roache, Verification and Validation in Computational Science and Engineering (1998), chapter 3.

    Examples
    --------
    >>> import xdynamics as xd
    >>> pendulum = xd.Model.from_toml("data/models/pendulum.toml")
    >>> known = manufactured(pendulum, {"theta": "radian*sin(2*t/second)"})
    >>> found = xd.validate(["rk4"], known)
    >>> found.verdict.values.tolist()
    [0, 0]
    """
    _check(model, trajectory)
    wanted = _trajectory(model, trajectory)
    along = wanted | {velocity(name): _rate(wanted[name], model) for name in model.shaped.coordinates}
    document = tomllib.loads(model.to_toml())
    forces = {name: _written(model, name, force) for name, force in _missing(model, along).items()}
    if forces:
        document.setdefault("forces", {})[TERM] = forces | {"description": "makes the wanted trajectory exact"}
    for name, state in model.shaped.states.items():
        correction = _less(_rate(wanted[name], model), _along(model, state.rate, along))
        document["states"][name]["rate"] = text_of(add(state.rate, correction))
    begin = dict(constants(model)) | {"t": model.statement.initial["t"].si}
    for name, tree in along.items():
        document["initial"][name] = _start(model, name, tree, begin)
    document["validation"] = {name: {"expression": text_of(tree), "bound": ORDER} for name, tree in along.items()}
    return Model.from_text(_text_of(document))


def _trajectory(model: Model, trajectory: Mapping[str, str]) -> dict[str, Node]:
    """Read the wanted trajectory; note every fault of units and dimensions, and what is not known in advance."""
    ledger, shapes = Ledger("manufactured solution"), model.shapes
    moving = {*model.units, *model.drives, *varying(model), *model.shaped.drives}
    wanted: dict[str, Node] = {}
    for name, text in trajectory.items():
        with ledger.entry(f"'{name}'"):
            tree = written_out(model, prepared(parse(text), shapes)) if shapes.dims else model.expanded(parse(text))
            dims, own = dims_of(tree, shapes), shapes.dims.get(name, ())
            if {*dims} != {*own}:
                raise InputError(
                    f"{text!r} has the dimensions ({', '.join(dims)}), needs those of '{name}', ({', '.join(own)}); index"
                    " of a dimension is the number of an element along it"
                )
            first = shapes.elements(name)[0]
            dimension = dimension_of(_elements(model, name, tree)[0], model.dimensions)
            needed = model.units[first].dimension
            if dimension != needed:
                raise InputError(f"{text!r} has units '{dimension}', needs '{needed}'")
            if known := sorted(free_names(tree) & moving):
                raise InputError(f"{text!r} reads '{known[0]}'; a trajectory is of t and parameters")
            wanted[name] = tree
    ledger.raise_faults()
    return wanted


def _elements(model: Model, name: str, tree: Node) -> list[Node]:
    """Return what an expression is at every element of a quantity."""
    dims = model.shapes.dims.get(name, ())
    return [at(tree, place, model.shapes) for place in model.shapes.places(dims)] if dims else [tree]


def _written(model: Model, name: str, tree: Node) -> str:
    """Print an expression; where it gathers what many links give, which has no text, element by element."""
    if not any(isinstance(node, Along) and node.function == "onto" for node in every(tree)):
        return text_of(tree)
    parts = _elements(model, name, tree)
    number: Node = ZERO
    if len(parts) > MOST_WRITTEN_OUT:
        raise InputError(
            f"'{name}' has {len(parts)} elements and forces of links; a manufactured solution of one has"
            f" {MOST_WRITTEN_OUT} at most"
        )
    for dim in model.shapes.dims[name]:
        number = add(multiply(number, Along("size", (), (dim,))), Along("index", (), (dim,)))

    def among(first: int, last: int) -> Node:
        if last - first == 1:
            return parts[first]
        middle = (first + last) // 2
        return Call("where", (Compare("<", number, Number(float(middle))), among(first, middle), among(middle, last)))

    return spoken(text_of(among(0, len(parts))))


def _start(model: Model, name: str, tree: Node, known: Mapping[str, float]) -> Any:
    """Return the values of a quantity at the start, in its own unit."""
    unit, dims = model.units[model.shapes.elements(name)[0]], model.shapes.dims.get(name, ())
    numbers = [evaluate(part, known) / float(unit.factor) for part in _elements(model, name, tree)]
    if not dims:
        return f"{numbers[0]!r} {unit.text}"
    return {"value": np.reshape(numbers, model.shapes.shape(dims)).tolist(), "unit": unit.text}


def _check(model: Model, trajectory: Mapping[str, str]) -> None:
    """Refuse models and trajectories that no force of time alone can make exact."""
    check_model(model)
    kinds: dict[str, Any] = {
        "a full mass matrix over dimensions": model.shapes.dims and not has_wholes(model),
        "contacts": [*model.contacts, *model.assemblies],
        "frictions": model.frictions,
        "controllers": model.controllers,
        "constraints": model.constraints,
        "regimes": model.regimes,
        "functions in Python": model.python_functions,
        "delayed values": model.delays,
    }
    for kind, members in kinds.items():
        if members:
            raise InputError(f"model '{model.name}' has {kind}; a manufactured solution is of a model without")
    for name, drive in model.drives.items():
        if model.looked_up_at[name] != CLOCK:
            raise InputError(
                f"drive '{name}' is of '{text_of(drive.argument)}'; a manufactured solution takes drives of time alone"
            )
    if TERM in model.forces:
        raise InputError(f"model '{model.name}' has a force '{TERM}' already")
    needed = [*model.shaped.coordinates, *model.shaped.states]
    faults = [f"'{name}' has no trajectory" for name in needed if name not in trajectory]
    faults += [
        f"'{name}' is no coordinate or state; there are {', '.join(needed)}"
        for name in trajectory
        if name not in needed
    ]
    if faults:
        raise InputError(f"manufactured solution: {'; '.join(faults)}", tuple(faults))


def _missing(model: Model, along: Mapping[str, Node]) -> dict[str, Node]:
    """Return M a less all forces, on the trajectory, by coordinate."""
    places = list(model.shaped.coordinates)
    forces: dict[str, Node] = dict.fromkeys(places, ZERO)
    entries = (
        {(i, i): model.shaped.mass[i][i] for i in range(len(places))}
        if model.shapes.dims
        else model.statement.mass_entries
    )
    for (i, j), entry in entries.items():
        inertia = multiply(_along(model, entry, along), _rate(along[velocity(places[j])], model))
        forces[places[i]] = add(forces[places[i]], inertia)
    for components in (acting(model) if model.shapes.dims else model.force_components).values():
        for name, component in components.items():
            assert not isinstance(component, Function)  # noqa: S101 - refused above
            forces[name] = _less(forces[name], _along(model, component, along))
    return forces


def _along(model: Model, tree: Node, along: Mapping[str, Node]) -> Node:
    """Return an expression on the trajectory."""
    if model.shapes.dims:
        return expanded(written_out(model, tree), along, model.shapes)
    return expand(model.expanded(tree), along)


def _rate(tree: Node, model: Model) -> Node:
    rates = {"t": ONE}
    return derivative_of_wholes(tree, rates, model.shapes) if model.shapes.dims else derivative(tree, rates)


def _less(left: Node, right: Node) -> Node:
    return left if right == ZERO else Binary("-", left, right)


def _text_of(statement: Mapping[str, object]) -> str:
    """Print a statement as TOML."""
    return Model(**statement).to_toml()

"""Manufactured solutions: the force that makes a wanted trajectory exact."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from typing import Any

import numpy as np

from xdynamics.expressions import Along, Binary, Call, Compare, Node, Number, dimension_of, free_names, parse, text_of
from xdynamics.expressions.calculus import ONE, ZERO, add, multiply
from xdynamics.expressions.evaluation import evaluate
from xdynamics.expressions.tree import every
from xdynamics.faults import InputError, Ledger
from xdynamics.model import Model, check_model
from xdynamics.model.drive_arguments import CLOCK
from xdynamics.model.motion import constants, forces_by_coordinate, has_diagonal_mass, state_quantities
from xdynamics.model.parts import Function
from xdynamics.model.statement import ORDER
from xdynamics.schema import velocity
from xdynamics.shapes import at_element, dims_of, display_text, resolve_min_max
from xdynamics.shapes.gradient import derivative
from xdynamics.shapes.trees import expand_definitions

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
    _check_manufacturable(model, trajectory)
    trajectory_trees = _read_trajectory(model, trajectory)
    motion_trees = trajectory_trees | {
        velocity(name): _time_rate(trajectory_trees[name], model) for name in model.statement.coordinates
    }
    document = tomllib.loads(model.to_toml())
    forces = {
        name: _expression_text(model, name, force) for name, force in _missing_forces(model, motion_trees).items()
    }
    if forces:
        document.setdefault("forces", {})[TERM] = forces | {"description": "makes the wanted trajectory exact"}
    for name, state in model.statement.states.items():
        correction = _difference_tree(
            _time_rate(trajectory_trees[name], model), _on_trajectory(model, state.rate, motion_trees)
        )
        document["states"][name]["rate"] = text_of(add(state.rate, correction))
    begin = dict(constants(model)) | {"t": model.statement.initial["t"].si}
    for name, tree in motion_trees.items():
        document["initial"][name] = _start_value(model, name, tree, begin)
    document["validation"] = {
        name: {"expression": text_of(tree), "bound": ORDER} for name, tree in motion_trees.items()
    }
    return Model.from_text(_statement_text(document))


def _read_trajectory(model: Model, trajectory: Mapping[str, str]) -> dict[str, Node]:
    """Read the wanted trajectory; collect faults of units and dimensions, and names not known in advance."""
    elements = model.elements
    ledger, shapes = Ledger("manufactured solution"), model.shapes
    moving = {*elements.units, *elements.drives, *state_quantities(model), *model.statement.drives}
    trajectory_trees: dict[str, Node] = {}
    for name, text in trajectory.items():
        with ledger.entry(f"'{name}'"):
            tree = model.expanded(resolve_min_max(parse(text), shapes))
            dims, quantity_dims = dims_of(tree, shapes), shapes.dims.get(name, ())
            if {*dims} != {*quantity_dims}:
                raise InputError(
                    f"{text!r} has the dimensions ({', '.join(dims)}), needs those of '{name}', ({', '.join(quantity_dims)}); index"
                    " of a dimension is the number of an element along it"
                )
            first = shapes.elements(name)[0]
            dimension = dimension_of(_element_trees(model, name, tree)[0], elements.dimensions)
            needed = elements.units[first].dimension
            if dimension != needed:
                raise InputError(f"{text!r} has units '{dimension}', needs '{needed}'")
            if known_names := sorted(free_names(tree) & moving):
                raise InputError(f"{text!r} reads '{known_names[0]}'; a trajectory is of t and parameters")
            trajectory_trees[name] = tree
    ledger.raise_faults()
    return trajectory_trees


def _element_trees(model: Model, name: str, tree: Node) -> list[Node]:
    """Return the trees of an expression at every element of a quantity."""
    dims = model.shapes.dims.get(name, ())
    return (
        [at_element(tree, element_index, model.shapes) for element_index in model.shapes.index_combinations(dims)]
        if dims
        else [tree]
    )


def _expression_text(model: Model, name: str, tree: Node) -> str:
    """Print an expression; a sum over links onto elements has no text, and is printed element by element."""
    if not any(isinstance(node, Along) and node.function == "onto" for node in every(tree)):
        return text_of(tree)
    parts = _element_trees(model, name, tree)
    number: Node = ZERO
    if len(parts) > MOST_WRITTEN_OUT:
        raise InputError(
            f"'{name}' has {len(parts)} elements and forces of links; a manufactured solution of one has"
            f" {MOST_WRITTEN_OUT} at most"
        )
    for dim in model.shapes.dims[name]:
        number = add(multiply(number, Along("size", (), (dim,))), Along("index", (), (dim,)))

    # halved, so that choices nest as deep as the logarithm of the number of elements, not as deep as they are many
    def select_element(first: int, last: int) -> Node:
        if last - first == 1:
            return parts[first]
        middle = (first + last) // 2
        return Call(
            "where",
            (Compare("<", number, Number(float(middle))), select_element(first, middle), select_element(middle, last)),
        )

    return display_text(text_of(select_element(0, len(parts))))


def _start_value(model: Model, name: str, tree: Node, start_values: Mapping[str, float]) -> Any:
    """Return the values of a quantity at the start, in its own unit."""
    unit, dims = model.elements.units[model.shapes.elements(name)[0]], model.shapes.dims.get(name, ())
    numbers = [evaluate(part, start_values) / float(unit.factor) for part in _element_trees(model, name, tree)]
    if not dims:
        return f"{numbers[0]!r} {unit.text}"
    return {"value": np.reshape(numbers, model.shapes.shape(dims)).tolist(), "unit": unit.text}


def _check_manufacturable(model: Model, trajectory: Mapping[str, str]) -> None:
    """Refuse models and trajectories that no force of time alone can make exact."""
    check_model(model)
    elements = model.elements
    kinds: dict[str, Any] = {
        "a full mass matrix over dimensions": model.shapes.dims and not has_diagonal_mass(model),
        "contacts": [*elements.contacts, *model.assemblies],
        "frictions": elements.frictions,
        "controllers": elements.controllers,
        "constraints": elements.constraints,
        "regimes": model.regimes,
        "functions in Python": model.python_functions,
        "delayed values": model.delays,
    }
    for kind, members in kinds.items():
        if members:
            raise InputError(f"model '{model.name}' has {kind}; a manufactured solution is of a model without")
    for name, drive in elements.drives.items():
        if elements.looked_up_at[name] != CLOCK:
            raise InputError(
                f"drive '{name}' is of '{text_of(drive.argument)}'; a manufactured solution takes drives of time alone"
            )
    if TERM in elements.forces:
        raise InputError(f"model '{model.name}' has a force '{TERM}' already")
    needed = [*model.statement.coordinates, *model.statement.states]
    faults = [f"'{name}' has no trajectory" for name in needed if name not in trajectory]
    faults += [
        f"'{name}' is no coordinate or state; there are {', '.join(needed)}"
        for name in trajectory
        if name not in needed
    ]
    if faults:
        raise InputError(f"manufactured solution: {'; '.join(faults)}", tuple(faults))


def _missing_forces(model: Model, motion_trees: Mapping[str, Node]) -> dict[str, Node]:
    """Return M a less all forces, on the trajectory, by coordinate."""
    places = list(model.statement.coordinates)
    forces: dict[str, Node] = dict.fromkeys(places, ZERO)
    for (i, j), entry in model.statement.mass_entries.items():
        inertia = multiply(
            _on_trajectory(model, entry, motion_trees), _time_rate(motion_trees[velocity(places[j])], model)
        )
        forces[places[i]] = add(forces[places[i]], inertia)
    for components in forces_by_coordinate(model).values():
        for name, component in components.items():
            assert not isinstance(component, Function)  # noqa: S101 - refused above
            forces[name] = _difference_tree(forces[name], _on_trajectory(model, component, motion_trees))
    return forces


def _on_trajectory(model: Model, tree: Node, motion_trees: Mapping[str, Node]) -> Node:
    """Return an expression on the trajectory."""
    return expand_definitions(model.expanded(tree), motion_trees, model.shapes)


def _time_rate(tree: Node, model: Model) -> Node:
    return derivative(tree, {"t": ONE}, model.shapes)


def _difference_tree(left: Node, right: Node) -> Node:
    return left if right == ZERO else Binary("-", left, right)


def _statement_text(statement: Mapping[str, object]) -> str:
    """Print a statement as TOML."""
    return Model(**statement).to_toml()

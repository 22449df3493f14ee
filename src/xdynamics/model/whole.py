"""The motion of a model with dimensions as expressions with dimensions: as many as there are quantities.

What they are at each element is what the model says of its elements.

The Jacobian of a model with dimensions about one state, from whole quantities: many directions of the state at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import Along, Binary, Call, Name, Node, Number, free_names
from xdynamics.expressions.calculus import ONE, ZERO
from xdynamics.model.drive_arguments import CLOCK
from xdynamics.model.elements import Elements
from xdynamics.model.model import Model
from xdynamics.model.motion import drive_slope, in_regimes
from xdynamics.model.parts import Function
from xdynamics.model.reactions import reactions
from xdynamics.schema import acceleration, force, rate, velocity
from xdynamics.shapes import Shapes, dims_of
from xdynamics.shapes.blocks import Block
from xdynamics.shapes.evaluation import evaluate_elements
from xdynamics.shapes.extents import Extent
from xdynamics.shapes.gradient import derivative
from xdynamics.shapes.trees import expand_definitions

QuantityTree = tuple[str, tuple[str, ...], Node]  # a name, its dimensions, what it is


def prints_quantities(model: Model) -> bool:
    """Whether a model has dimensions, and its motion is that of `motion_of_quantities`."""
    derived = model.shaped.lagrangian is not None  # its mass is full, and of elements alone
    return bool(model.shapes.extents) and not derived and not model.mass_is_full


@lru_cache(maxsize=64)
def motion_shapes(model: Model) -> Shapes:
    """Return the shapes of a model with those of its force components, and of the slopes of its tables."""
    dims_by_name = model.shapes.dims
    names = {drive_slope(name): dims_by_name.get(name, ()) for name in model.shaped.drives}
    names |= {
        force(term, name): dims_by_name.get(name, ())
        for term, parts in forces_by_coordinate(model).items()
        for name in parts
    }
    return replace(model.shapes, dims={**dims_by_name, **{name: dims for name, dims in names.items() if dims}})


@lru_cache(maxsize=64)
def forces_by_coordinate(model: Model) -> dict[str, dict[str, Node | Function]]:
    """Return what every force term is for every coordinate on which it acts."""
    elements = Elements(model.shaped, model.shapes)
    return {term: elements.force_by_coordinate(part) for term, part in model.shaped.forces.items()}


def motion_of_quantities(model: Model) -> list[QuantityTree]:
    """Return force terms, accelerations and rates, as `model.motion` writes them for elements, without full masses."""
    dims_by_name, expressions, totals = model.shapes.dims, list[QuantityTree](), dict[str, Node]()
    for term, components in forces_by_coordinate(model).items():
        for name, tree in components.items():
            assert not isinstance(tree, Function)  # noqa: S101 - asked before
            force_name = force(term, name)
            expressions.append(
                (force_name, dims_by_name.get(name, ()), in_regimes(model, term, expanded_tree(model, tree)))
            )
            totals[name] = Binary("+", totals[name], Name(force_name)) if name in totals else Name(force_name)
    for i, name in enumerate(model.shaped.coordinates):
        mass = Call("positive", (expanded_tree(model, model.shaped.mass[i][i]),))
        expressions.append((acceleration(name), dims_by_name.get(name, ()), Binary("/", totals.get(name, ZERO), mass)))
    for name, state in model.shaped.states.items():
        expressions.append((rate(name), dims_by_name.get(name, ()), expanded_tree(model, state.rate)))
    return expressions


def state_quantities(model: Model) -> list[str]:
    """Return the quantities of a state, as a force evaluation uses them."""
    shaped = model.shaped
    return [*shaped.coordinates, *map(velocity, shaped.coordinates), *shaped.states]


def change_name(name: str) -> str:
    """Name the derivative of a quantity along a direction of the state; of one of the state itself the direction."""
    return f"_change_{name}"


def shapes_of_changes(model: Model) -> Shapes:
    """Return the shapes of a model with those of its changes."""
    shapes = motion_shapes(model)
    names = [*state_quantities(model), *(name for name, _, _ in motion_of_quantities(model))]
    dims = {change_name(name): shapes.dims[name] for name in names if name in shapes.dims}
    return replace(shapes, dims={**shapes.dims, **dims})


def changes_of_quantities(model: Model) -> list[QuantityTree]:
    """Return the derivatives of what `motion_of_quantities` gives along a direction of the state, by the chain rule."""
    shapes, changes = shapes_of_changes(model), list[QuantityTree]()
    rates: dict[str, Node] = {name: Name(change_name(name)) for name in state_quantities(model)}
    for name, dims, tree in motion_of_quantities(model):
        rate_tree = derivative(tree, rates, shapes)
        changes.append((change_name(name), dims, rate_tree))
        if rate_tree != ZERO:
            rates[name] = Name(change_name(name))
    return changes


def expanded_tree(model: Model, tree: Node) -> Node:
    """Return an expression with dimensions with every definition substituted."""
    return expand_definitions(tree, model.shaped.definitions, model.shapes)


def events_of_quantities(model: Model) -> list[QuantityTree]:
    """Return the function of each event, and 1 for what is looked for otherwise: ticks, links of contacts."""
    functions = list[QuantityTree]()
    for name, event in model.shaped.events.items():
        assert not isinstance(event.function, Function)  # noqa: S101 - asked before
        tree = ONE if event.every is not None else expanded_tree(model, event.function)
        functions.append((name, model.shapes.dims.get(name, ()), tree))
    return [*functions, *((name, (), ONE) for name in model.assemblies)]


def rates_of_quantities(model: Model, quantities: Sequence[QuantityTree]) -> list[QuantityTree] | None:
    """Return the time derivatives of expressions along the motion.

    None where they read a table for each element that is looked up at anything but a time: only elements say at what.
    """
    shaped, rates = model.shaped, dict[str, Node](t=ONE)
    for name in shaped.coordinates:
        rates |= {name: Name(velocity(name)), velocity(name): Name(acceleration(name))}
    rates |= {name: Name(rate(name)) for name in shaped.states}
    for name in shaped.drives:
        if model.looked_up_at[model.shapes.first(name)] == CLOCK:
            rates[name] = Name(drive_slope(name))
        elif not model.shapes.dims.get(name):
            rates[name] = model.rates[name]
        elif any(name in free_names(tree) for _, _, tree in quantities):
            return None
    shapes = motion_shapes(model)
    return [(f"_rate_of_{name}", dims, derivative(tree, rates, shapes)) for name, dims, tree in quantities]


def energies_of_quantities(model: Model) -> dict[str, Node]:
    """Return kinetic energy and, where a potential is known, potential and total energy."""
    kinetic = []
    for i, name in enumerate(model.shaped.coordinates):
        speed = Name(velocity(name))
        mass = Binary("/", expanded_tree(model, model.shaped.mass[i][i]), Number(2.0))
        kinetic.append(_sum_over_elements(model, Binary("*", mass, Binary("*", speed, speed))))
    energies, potential = {"kinetic_energy": _sum_in_order(kinetic)}, potentials_of_quantities(model)
    if potential:
        energies["potential_energy"] = _sum_in_order([*potential.values()])
        energies["total_energy"] = Binary("+", energies["kinetic_energy"], energies["potential_energy"])
    return energies


def potentials_of_quantities(model: Model) -> dict[str, Node]:
    """Return the potential energy of each force term that has one, summed over all elements."""
    return {
        term: in_regimes(model, term, _sum_over_elements(model, expanded_tree(model, part.potential)))
        for term, part in model.shaped.forces.items()
        if part.potential is not None
    }


def _sum_over_elements(model: Model, tree: Node) -> Node:
    dims = dims_of(tree, model.shapes)
    return Along("sum", (tree,), dims) if dims else tree


def _sum_in_order(terms: list[Node]) -> Node:
    total = terms[0]
    for term in terms[1:]:
        total = Binary("+", total, term)
    return total


Floats = NDArray[np.float64]

DIRECTIONS = "directions of the state"  # no name of a model's
LINKS_OF_EACH = 4  # links for each element, from which derivatives are found of whole quantities
MAX_TOGETHER = 2_000_000  # numbers of a part of an expression for all directions that are taken together


def is_densely_linked(model: Model) -> bool:
    """Whether links far outnumber what they link, and the derivatives of forces are known of whole quantities."""
    if not prints_quantities(model) or reactions(model) or model.shaped.bodies:
        return False
    if model.assemblies or model.constraints or model.delays or model.python_functions or model.drives:
        return False
    sizes = ((links.first.size, model.shapes.extent(links.source).size) for links in model.shapes.relations.values())
    return any(count > LINKS_OF_EACH * elements for count, elements in sizes)


def quantity_jacobian(model: Model, values: Mapping[str, float]) -> tuple[Floats, Floats]:
    """Return accelerations, and the derivatives of accelerations and rates by the state, of a model that is dense.

    Parameters
    ----------
    model : Model
    values : mapping of str to float
        SI numbers for all that the motion reads, by the names of elements.

    Returns
    -------
    accelerations : ndarray, shape (coordinates,)
    jacobian : ndarray, shape (coordinates + states, 2*coordinates + states)
    """
    shapes, motion, changes = shapes_of_changes(model), motion_of_quantities(model), changes_of_quantities(model)
    derived_names = {change_name(name) for name in state_quantities(model)} | {
        name for name, _, _ in (*motion, *changes)
    }
    read = set[str]().union(*(free_names(tree) for _, _, tree in (*motion, *changes))) - derived_names
    known_values: dict[str, Any] = {}
    for name in read:
        block = Block.from_shapes(name, "", shapes)
        known_values[name] = np.array([values[element] for element in block.elements()]).reshape(block.shape)
    for name, dims, tree in motion:
        known_values[name] = evaluate_elements(tree, dims, known_values, shapes)
    rows = [*map(acceleration, model.shaped.coordinates), *map(rate, model.shaped.states)]
    state = [Block.from_shapes(name, "", shapes) for name in state_quantities(model)]
    count = sum(block.size for block in state)
    widest = max(links.first.size for links in shapes.relations.values())
    jacobian, chunk_size = (
        np.empty((sum(known_values[name].size for name in rows), count)),
        max(1, MAX_TOGETHER // widest),
    )
    for begin in range(0, count, chunk_size):
        end = min(begin + chunk_size, count)
        directions, first = np.eye(count, end - begin, -begin), 0
        dims_with_direction = {
            name: (*shapes.dims.get(name, ()), DIRECTIONS)
            for name in map(change_name, [*state_quantities(model), *rows])
        }
        dims_with_direction |= {name: (*dims, DIRECTIONS) for name, dims, _ in changes}
        extents = {**shapes.extents, DIRECTIONS: Extent(DIRECTIONS, end - begin)}
        direction_shapes = replace(shapes, extents=extents, dims={**shapes.dims, **dims_with_direction})
        moved_values = dict(known_values)
        for block in state:
            part = directions[first : first + block.size]
            moved_values[change_name(block.name)], first = part.reshape(*block.shape, -1), first + block.size
        for name, dims, tree in changes:
            moved_values[name] = evaluate_elements(
                tree, (*dims, DIRECTIONS), moved_values, direction_shapes, DIRECTIONS
            )
        jacobian[:, begin:end] = np.concatenate(
            [moved_values[change_name(name)].reshape(-1, end - begin) for name in rows]
        )
    accelerations = [known_values[acceleration(name)].ravel() for name in model.shaped.coordinates]
    return np.concatenate(accelerations), jacobian

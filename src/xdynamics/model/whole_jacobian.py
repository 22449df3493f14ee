"""The Jacobian of a model with dimensions about one state, from whole quantities: many directions of the state at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import free_names
from xdynamics.model.model import Model
from xdynamics.model.reactions import reactions
from xdynamics.model.whole import (
    change_name,
    changes_of_quantities,
    motion_of_quantities,
    prints_quantities,
    shapes_of_changes,
    state_quantities,
)
from xdynamics.schema import acceleration, rate
from xdynamics.shapes.blocks import Block
from xdynamics.shapes.evaluation import evaluate_elements
from xdynamics.shapes.extents import Extent

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

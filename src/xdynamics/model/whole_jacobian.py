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
from xdynamics.model.whole import change, changes_of_wholes, has_wholes, motion_of_wholes, shapes_of_changes, varying
from xdynamics.schema import acceleration, rate
from xdynamics.shapes.blocks import Block
from xdynamics.shapes.evaluation import evaluate_elements
from xdynamics.shapes.extents import Extent

Floats = NDArray[np.float64]

DIRECTIONS = "directions of the state"  # no name of a model's
LINKS_OF_EACH = 4  # links for each element, from which derivatives are found of whole quantities
TOGETHER = 2_000_000  # numbers of a part of an expression for all directions that are taken together


def is_dense(model: Model) -> bool:
    """Whether links far outnumber what they link, and the derivatives of forces are known of whole quantities."""
    if not has_wholes(model) or reactions(model) or model.shaped.bodies:
        return False
    if model.assemblies or model.constraints or model.delays or model.python_functions or model.drives:
        return False
    sizes = ((links.first.size, model.shapes.extent(links.source).size) for links in model.shapes.relations.values())
    return any(count > LINKS_OF_EACH * elements for count, elements in sizes)


def whole_jacobian(model: Model, values: Mapping[str, float]) -> tuple[Floats, Floats]:
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
    shapes, motion, changes = shapes_of_changes(model), motion_of_wholes(model), changes_of_wholes(model)
    own = {change(name) for name in varying(model)} | {name for name, _, _ in (*motion, *changes)}
    read = set[str]().union(*(free_names(tree) for _, _, tree in (*motion, *changes))) - own
    known: dict[str, Any] = {}
    for name in read:
        block = Block.of(name, "", shapes)
        known[name] = np.array([values[element] for element in block.elements()]).reshape(block.shape)
    for name, dims, tree in motion:
        known[name] = evaluate_elements(tree, dims, known, shapes)
    rows = [*map(acceleration, model.shaped.coordinates), *map(rate, model.shaped.states)]
    state = [Block.of(name, "", shapes) for name in varying(model)]
    count = sum(block.size for block in state)
    widest = max(links.first.size for links in shapes.relations.values())
    jacobian, most = np.empty((sum(known[name].size for name in rows), count)), max(1, TOGETHER // widest)
    for begin in range(0, count, most):
        end = min(begin + most, count)
        directions, first = np.eye(count, end - begin, -begin), 0
        along = {name: (*shapes.dims.get(name, ()), DIRECTIONS) for name in map(change, [*varying(model), *rows])}
        along |= {name: (*dims, DIRECTIONS) for name, dims, _ in changes}
        extents = {**shapes.extents, DIRECTIONS: Extent(DIRECTIONS, end - begin)}
        here = replace(shapes, extents=extents, dims={**shapes.dims, **along})
        moved = dict(known)
        for block in state:
            part = directions[first : first + block.size]
            moved[change(block.name)], first = part.reshape(*block.shape, -1), first + block.size
        for name, dims, tree in changes:
            moved[name] = evaluate_elements(tree, (*dims, DIRECTIONS), moved, here, DIRECTIONS)
        jacobian[:, begin:end] = np.concatenate([moved[change(name)].reshape(-1, end - begin) for name in rows])
    found = [known[acceleration(name)].ravel() for name in model.shaped.coordinates]
    return np.concatenate(found), jacobian

"""Values of expressions with dimensions, for all elements at once."""

from __future__ import annotations

import numpy as np
import pytest

from xdynamics.expressions import parse
from xdynamics.expressions.evaluation import evaluate
from xdynamics.shapes import Extent, Relation, Shapes, at_element, dims_of, resolve_min_max
from xdynamics.shapes.evaluation import evaluate_elements

PAIR = Relation("pair", "body", "body", *np.triu_indices(5, 1))
WALL = Relation("wall", "body", "axis", np.arange(4), np.array([2, 1, 0, 0]))
DIMS = {"r": ("body", "axis"), "m": ("body",), "w": ("axis", "body"), "k": ("pair",)}
EXTENTS = {"body": Extent("body", 5, ("a", "b", "c", "d", "e")), "axis": Extent("axis", 3)}
SHAPES = Shapes(EXTENTS, {"pair": PAIR, "wall": WALL}, DIMS)
TEXTS = (
    "g",
    "m*r",
    "r + w",
    "sum(r, axis)",
    "sum(r, body, axis)",
    "sum(w, axis, body)",
    "mean(r, body)",
    "norm(r, axis)",
    "dot(r, w, axis)",
    "dot(r, m, body)",
    "min(r, body)",
    "max(r, axis)",
    "cross(r, w, axis)",
    "cross(r, index(axis), axis)",
    "shift(r, body, 1, 0)",
    "shift(m, body, -2, g*index(body))",
    "roll(r, axis, 2)",
    "first(m, pair)*second(r, pair)",
    "k/norm(second(r, pair) - first(r, pair), axis)",
    "second(w, wall) - first(m, wall)",
    "r[b, 1]*m",
    "m[-1]",
    "where(index(body) < 2, 1/(index(body) + 1), sin(m)**2)",
    "exp(-m**2)*size(axis)",
    "-r**3 + abs(w)",
    "sum(k, pair)",
    "second(shift(m, body, 1, g), pair)",
    "max(m, 2*g*m[a])",
    "m**-1",
    "take(m, body, size(body) - 1 - index(body))*r",
    "take(take(r, body, index(axis) + 1), axis, mod(2*index(body), 3))",
    "take(sum(r, axis), body, mod(3*index(axis) + index(body), 5))",
    "take(r, axis, 2) + take(m, body, 0)",
)


@pytest.mark.parametrize("text", TEXTS)
def test_elements_have_the_bits_that_each_has_alone(text: str) -> None:
    """Assert that the value of every element is that of its own expression, whatever the order of dimensions."""
    random = np.random.default_rng(1)
    arrays = {name: random.normal(size=SHAPES.shape(own)) for name, own in DIMS.items()}
    alone = {"g": 1.7}
    for name, values in arrays.items():
        alone |= dict(zip(SHAPES.elements(name), values.ravel().tolist(), strict=True))
    tree = resolve_min_max(parse(text), SHAPES)
    own = dims_of(tree, SHAPES)
    for dims in (own, own[::-1]):
        values = evaluate_elements(tree, dims, arrays | {"g": 1.7}, SHAPES)
        expected = [evaluate(at_element(tree, place, SHAPES), alone) for place in SHAPES.index_combinations(dims)]
        assert values.shape == SHAPES.shape(dims)
        assert values.tobytes() == np.array(expected).tobytes()

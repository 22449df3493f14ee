"""Names of switches hidden in forces; of elements by the element that the function is of: ``drag.sign·3``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from xdynamics.expressions import CALLED_ALONE, Along, Call, Node, text_of
from xdynamics.expressions.tree import every
from xdynamics.faults import spoken
from xdynamics.model.elements import Elements
from xdynamics.model.kinks import SWITCHING, kinks_of_call, turned
from xdynamics.model.model import Model
from xdynamics.model.parts import Function
from xdynamics.shapes import at, dims_of
from xdynamics.shapes.trees import expanded

MOST_COUNTED = 100  # of elements; of more there is no record


@dataclass(frozen=True)
class Home:
    """Where the function of a switch stands in the force as it is written, and of which element it is.

    Attributes
    ----------
    written : Node
        The function with dimensions, or what is reduced along one.
    text : str
        What the record says of it.
    dims : tuple of str
    place : mapping of str to int
        The number of the element along each of the dimensions.
    """

    written: Node
    text: str
    dims: tuple[str, ...] = ()
    place: Mapping[str, int] = field(default_factory=dict)


def named(
    model: Model, owner: str, functions: Sequence[tuple[str, Node]]
) -> Iterator[tuple[str, str, tuple[str, ...]]]:
    """Yield the name of each switch of a force or rate, the text of its function and the dimensions it is an element of.

    Parameters
    ----------
    model : Model
    owner : str
        The force, or the state whose rate has the switches; of elements, the quantity.
    functions : sequence of (str, Node)
        What switches, like ``sign``, and the expression that passes through zero.

    Notes
    -----
    The second `sign` of a force is ``drag.sign_2``, with the same number for each element. A switch between the ends of a
    link is of the link; in `max` along a dimension it is of the element that is compared with the largest of those after it.
    """
    homes = _homes(model, owner, functions) if model.shapes.dims and len(functions) <= MOST_COUNTED else {}
    numbers: dict[str, dict[Node, int]] = {}
    for name, function in functions:
        home = homes.get((name, function)) or Home(function, spoken(_written(name, function)))
        known = numbers.setdefault(name, {})
        number = known.setdefault(home.written, len(known) + 1)
        word = f"{owner}.{name}_{number}" if number > 1 else f"{owner}.{name}"
        yield model.shapes.element(word, home.place, home.dims), home.text, home.dims


def _written(name: str, function: Node) -> str:
    """Print the function of a switch or, of one that jumps at whole numbers, the call itself."""
    return text_of(turned(name, function) if name in CALLED_ALONE else function)


def _homes(model: Model, owner: str, functions: Sequence[tuple[str, Node]]) -> dict[tuple[str, Node], Home]:
    """Return where functions of elements stand; as soon as all are known, the others are not made."""
    homes, sought = dict[tuple[str, Node], Home](), {*functions}
    for tree in _trees_with_dims(model, owner):
        for node in dict.fromkeys(reversed([*every(tree)])):
            for function, home in _of_node(node, model):
                key = node.function, model.expanded(function) if model.delays else function  # type: ignore[union-attr]
                if key in sought:
                    homes[key] = home
                    sought.remove(key)
                if not sought:
                    return homes
    return homes


def _of_node(node: Node, model: Model) -> Iterator[tuple[Node, Home]]:
    """Yield the functions of the switches of one function with dimensions, for each of its elements."""
    shapes = model.shapes
    if isinstance(node, Call) and node.function in SWITCHING:
        for function, _, _ in kinks_of_call(node):
            dims, text = dims_of(function, shapes), _written(node.function, function)
            for place in shapes.places(dims):
                yield at(function, place, shapes), Home(function, text, dims, place)
    elif isinstance(node, Along) and node.function in SWITCHING:
        dims = shapes.ordered({*dims_of(node, shapes), *node.dims})
        for outer in shapes.places(dims_of(node, shapes)):
            call = at(node, outer, shapes)
            compared = [function for function, _, _ in kinks_of_call(call)] if isinstance(call, Call) else []
            for inner, function in zip(shapes.places(node.dims), compared, strict=False):
                yield function, Home(node, spoken(text_of(function)), dims, {**outer, **inner})


def _trees_with_dims(model: Model, owner: str) -> Iterator[Node]:
    """Yield what a force is for every coordinate, or the rate of a state, with definitions substituted."""
    whole = model.shaped
    force = whole.forces.get(owner)
    if force is not None:
        trees = [*Elements(whole, model.shapes).acting(force).values()]
    else:  # the rate of a state, or the masses
        trees = [whole.states[owner].rate] if owner in whole.states else [*whole.mass_entries.values()]
    for tree in trees:
        if not isinstance(tree, Function):
            yield expanded(tree, whole.definitions, model.shapes)

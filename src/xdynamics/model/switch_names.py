"""Names of switches hidden in forces; of elements by the element that the function is of: ``drag.sign·3``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from xdynamics.expressions import CALLED_ALONE, Along, Call, Node, text_of
from xdynamics.expressions.tree import every
from xdynamics.faults import display_text
from xdynamics.model.elements import Elements
from xdynamics.model.kinks import SWITCHING, kinks_of_call, original_call
from xdynamics.model.model import Model
from xdynamics.model.parts import Function
from xdynamics.shapes import at_element, dims_of
from xdynamics.shapes.trees import expand_definitions

MOST_COUNTED = 100  # of elements; of more there is no record


@dataclass(frozen=True)
class Home:
    """Where the function of a switch stands in the force as it is written, and of which element it is.

    Attributes
    ----------
    declared_tree : Node
        The function with dimensions, or what is reduced along one.
    text : str
        What the record says of it.
    dims : tuple of str
    indices : mapping of str to int
        The number of the element along each of the dimensions.
    """

    declared_tree: Node
    text: str
    dims: tuple[str, ...] = ()
    indices: Mapping[str, int] = field(default_factory=dict)


def switch_labels(
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
        home = homes.get((name, function)) or Home(function, display_text(_function_text(name, function)))
        number_by_tree = numbers.setdefault(name, {})
        number = number_by_tree.setdefault(home.declared_tree, len(number_by_tree) + 1)
        word = f"{owner}.{name}_{number}" if number > 1 else f"{owner}.{name}"
        yield model.shapes.element_at(word, home.indices, home.dims), home.text, home.dims


def _function_text(name: str, function: Node) -> str:
    """Print the function of a switch or, of one that jumps at whole numbers, the call itself."""
    return text_of(original_call(name, function) if name in CALLED_ALONE else function)


def _homes(model: Model, owner: str, functions: Sequence[tuple[str, Node]]) -> dict[tuple[str, Node], Home]:
    """Return where functions of elements stand; as soon as all are known, the others are not made."""
    homes, sought = dict[tuple[str, Node], Home](), {*functions}
    for tree in _trees_with_dims(model, owner):
        for node in dict.fromkeys(reversed([*every(tree)])):
            for function, home in _homes_of_node(node, model):
                key = node.function, model.expanded(function) if model.delays else function  # type: ignore[union-attr]
                if key in sought:
                    homes[key] = home
                    sought.remove(key)
                if not sought:
                    return homes
    return homes


def _homes_of_node(node: Node, model: Model) -> Iterator[tuple[Node, Home]]:
    """Yield the functions of the switches of one function with dimensions, for each of its elements."""
    shapes = model.shapes
    if isinstance(node, Call) and node.function in SWITCHING:
        for function, _, _ in kinks_of_call(node):
            dims, text = dims_of(function, shapes), _function_text(node.function, function)
            for indices in shapes.index_combinations(dims):
                yield at_element(function, indices, shapes), Home(function, text, dims, indices)
    elif isinstance(node, Along) and node.function in SWITCHING:
        dims = shapes.ordered({*dims_of(node, shapes), *node.dims})
        for outer in shapes.index_combinations(dims_of(node, shapes)):
            call = at_element(node, outer, shapes)
            compared = [function for function, _, _ in kinks_of_call(call)] if isinstance(call, Call) else []
            for inner, function in zip(shapes.index_combinations(node.dims), compared, strict=False):
                yield function, Home(node, display_text(text_of(function)), dims, {**outer, **inner})


def _trees_with_dims(model: Model, owner: str) -> Iterator[Node]:
    """Yield what a force is for every coordinate, or the rate of a state, with definitions substituted."""
    statement = model.shaped
    force = statement.forces.get(owner)
    if force is not None:
        trees = [*Elements(statement, model.shapes).force_by_coordinate(force).values()]
    else:  # the rate of a state, or the masses
        trees = [statement.states[owner].rate] if owner in statement.states else [*statement.mass_entries.values()]
    for tree in trees:
        if not isinstance(tree, Function):
            yield expand_definitions(tree, statement.definitions, model.shapes)

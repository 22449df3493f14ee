"""Switches hidden in forces, masses and friction: zeros of arguments of `abs`, `sign`, `min`, `max`, `where`.

`floor`, `ceil`, `round` and `mod` switch where they jump. On either side a force is smooth, across the switch it is
not: no method keeps its order over a step that passes one. The same holds for a measured table of a coordinate or
velocity with linear or piecewise constant interpolation.

A switch is named by its function; the switch of an element by the element of the function: ``drag.sign·3``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from math import inf

from xdynamics.expressions import (
    CALLED_ALONE,
    Along,
    Binary,
    Call,
    Compare,
    Name,
    Negative,
    Node,
    exponent_of,
    free_names,
    text_of,
)
from xdynamics.expressions.calculus import ZERO
from xdynamics.expressions.tree import every
from xdynamics.faults import display_text
from xdynamics.model.delays import is_before
from xdynamics.model.drive_arguments import CLOCK
from xdynamics.model.elements import Elements
from xdynamics.model.kinks import FAR, JUMPING, SWITCHING, Path, kinks, kinks_of_call, original_call
from xdynamics.model.lagrangian import POTENTIAL
from xdynamics.model.model import Model
from xdynamics.model.parts import Contact, Friction, Function
from xdynamics.schema import velocity
from xdynamics.shapes import at_element, dims_of
from xdynamics.shapes.naming import join_element_name, split_element_name
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
    """Print the function of a switch; of a switch that jumps at whole numbers, print the call."""
    return text_of(original_call(name, function) if name in CALLED_ALONE else function)


def _homes(model: Model, owner: str, functions: Sequence[tuple[str, Node]]) -> dict[tuple[str, Node], Home]:
    """Return where functions of elements stand; as soon as all are known, the others are not made."""
    homes, sought = dict[tuple[str, Node], Home](), {*functions}
    for tree in _trees_with_dims(model, owner):
        for node in dict.fromkeys(reversed([*every(tree)])):
            for function, home in _homes_of_node(node, model):
                key = node.function, model.elements.expanded(function) if model.delays else function  # type: ignore[union-attr]
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
    """Yield a force by coordinate, or the rate of a state, with definitions substituted."""
    statement = model.statement
    force = statement.forces.get(owner)
    if force is not None:
        trees = [*Elements(statement, model.shapes).force_by_coordinate(force).values()]
    else:  # the rate of a state, or the masses
        trees = [statement.states[owner].rate] if owner in statement.states else [*statement.mass_entries.values()]
    for tree in trees:
        if not isinstance(tree, Function):
            yield expand_definitions(tree, statement.definitions, model.shapes)


MOST_SWITCHES = 40  # watched at most: locating more costs more than it is worth
# `landed on` is located, too, but points of tables where forces have a kink are counted, and no events.
LOCATED, LANDED_ON, STEPPED_OVER = "located", "landed on", "stepped over"
SWITCHES = (LOCATED, LANDED_ON, STEPPED_OVER)
MANY_POINTS = 100  # of a table, from which they are landed on if nothing else is asked for
# As in version 0.2, to reproduce archives: also in a branch of `where` that is not taken, where they have no effect.
LOCATED_EVERYWHERE = "located everywhere"
BENT = (
    "previous",
    "linear",
)  # interpolations that jump or have a kink at every point; the others are smooth enough to step over


@dataclass(frozen=True)
class Switch:
    """One hidden switch.

    Attributes
    ----------
    owner : str
        The force, the state whose rate has the switch, the mass, or what rubs; of elements, the quantity.
    name : str
        The owner and the function: ``drag.abs``; of an element ``drag.abs·3``.
    function : Node
        The expression that passes through zero.
    jumps : bool
        Whether the force itself jumps there, and not a derivative.
    at_zero : int
        The side that zero belongs to.
    drive : str
        The drive, if the switch is in a table: the function is positive between two of its points.
    paths : tuple of Path
        The switch has an effect where one of these holds: the branches of `where` around it; an empty one always holds.
    flatness : int
        The lowest derivative of the force, by the function, that jumps at zero: 0 is the force itself.
    dims : tuple of str
        The dimensions that it is of an element of.
    text : str
        The function as the force has it, with its dimensions.
    """

    owner: str
    name: str
    function: Node
    jumps: bool
    at_zero: int = 1
    drive: str = ""
    paths: tuple[Path, ...] = ((),)
    flatness: int = 0
    dims: tuple[str, ...] = ()
    text: str = ""

    @property
    def nested(self) -> bool:
        """Whether it has an effect in some states only."""
        return () not in self.paths


@lru_cache(maxsize=64)
def switches(model: Model) -> tuple[Switch, ...]:
    """Return the hidden switches of forces and rates that are not declared smooth, in the order written.

    Those of elements may be many: of the largest of n numbers, n - 1 for each rate that it is in.
    """
    return tuple(_hidden(model, inf))


def _hidden(model: Model, maximum: float) -> list[Switch]:
    """Return the hidden switches, or some of them as soon as there are more than `maximum`."""
    hidden: list[Switch] = []
    for owner, trees in _trees_by_owner(model, smooth=False):
        if model.drives:
            drives = {switch.drive for switch in hidden}
            hidden += [_table_switch(model, owner, name) for name in _bent(model, trees()) if name not in drives]
        hidden += _switches_of_trees(model, owner, trees(), maximum - len(hidden))
        if len(hidden) > maximum:
            break
    return hidden


@lru_cache(maxsize=64)
def are_too_many(model: Model) -> bool:
    """Whether more switches are hidden than a march locates."""
    return len(_hidden(model, MOST_SWITCHES)) > MOST_SWITCHES


@lru_cache(maxsize=64)
def count_of_switches(model: Model) -> str:
    """Return in words how many switches are hidden; of elements they may be a million, and are counted to a hundred."""
    count = len(_hidden(model, MOST_COUNTED if model.shapes.dims else inf))
    return f"over {MOST_COUNTED}" if model.shapes.dims and count > MOST_COUNTED else str(count)


def jumping_switches(model: Model) -> tuple[Switch, ...]:
    """Return the hidden switches at which a force itself jumps, and not a derivative."""
    if model.shapes.dims and not model.statement.drives:
        # derivatives of a potential jump where it has a kink
        derived = model.statement.lagrangian is not None
        derived = derived or any(force.potential is not None for force in model.statement.forces.values())
        if not any(
            _call_any(trees, SWITCHING if derived else JUMPING) for _, trees, _ in _quantities_with_trees(model)
        ):
            return ()
    return tuple(switch for switch in switches(model) if switch.jumps)


def owners_of_switches(model: Model) -> tuple[str, ...]:
    """Return the forces, and states by their rates, that switches are hidden in; of elements, the quantity."""
    if not model.shapes.dims:
        return tuple(dict.fromkeys(switch.owner for switch in switches(model)))
    drives = model.statement.drives.keys()
    return tuple(
        owner
        for owner, trees, smooth in _quantities_with_trees(model)
        if not smooth and (_call_any(trees, SWITCHING) or any(free_names(tree) & drives for tree in trees))
    )


@lru_cache(maxsize=64)
def smooth_switches(model: Model) -> tuple[Switch, ...]:
    """Return the hidden switches of forces and rates that are declared smooth: they are counted, but not located.

    Of elements over a hundred are not: writing them out would take longer than the run. Points of tables are not included;
    see `bent_and_smooth`.
    """
    maximum, hidden_switches = MOST_COUNTED if model.shapes.dims else inf, list[Switch]()
    for owner, trees in _trees_by_owner(model, smooth=True):
        hidden_switches += _switches_of_trees(model, owner, trees(), maximum)
        if len(hidden_switches) > maximum:
            return ()
    return tuple(hidden_switches)


def bent_and_smooth(model: Model) -> tuple[str, ...]:
    """Return the forces and rates, declared smooth, that read a table with kinks or jumps that the motion passes."""
    return tuple(owner for owner, trees in _trees_by_owner(model, smooth=True) if _bent(model, trees()))


def _switches_of_trees(model: Model, owner: str, trees: Iterator[Node], maximum: float = inf) -> list[Switch]:
    """Return the switches of one force or rate, or some if they are more than `maximum`; one that occurs again gets paths."""
    merged: dict[tuple[str, Node], Switch] = {}
    own_slips = _slips(model, owner)
    for name, function, jumps, at_zero, path, flatness in (kink for tree in trees for kink in kinks(tree)):
        if not _moves(model, function) or function in own_slips:
            continue
        previous = merged.get((name, function))
        if previous is not None:
            paths = previous.paths if path in previous.paths else (*previous.paths, path)
            merged[name, function] = replace(previous, paths=paths, flatness=min(previous.flatness, flatness))
            continue
        merged[name, function] = Switch(owner, name, function, jumps, at_zero, paths=(path,), flatness=flatness)
        if len(merged) > maximum:
            break
    names = switch_labels(model, owner, [*merged])
    return [
        replace(switch, name=name, text=text, dims=dims)
        for switch, (name, text, dims) in zip(merged.values(), names, strict=True)
    ]


def where_it_decides(switch: Switch, sides: Mapping[Node, str], tree_inside: Node, tree_outside: Node) -> Node:
    """Return a tree that is `tree_inside` where a switch has an effect, and `tree_outside` elsewhere.

    Parameters
    ----------
    switch : Switch
    sides : mapping of Node to str
        Names of the sides of conditions that are switches themselves, by their functions; others are compared.
    tree_inside, tree_outside : Node
    """
    if not switch.nested:
        return tree_inside
    decided = tree_outside
    for path in reversed(switch.paths):
        tree = tree_inside
        for condition, holds in reversed(path):
            side_name = sides.get(Binary("-", condition.left, condition.right))
            if side_name is not None:
                condition = Compare(condition.operator[0], Name(side_name), ZERO)  # noqa: PLW2901
            tree = Call("where", (condition, tree, decided) if holds else (condition, decided, tree))
        decided = tree
    return decided


def bounded_function(model: Model, function: Node) -> Node:
    """Return the function of a switch, limited to large finite numbers if it may be infinite.

    Of ``min(F, P/v)`` at v = 0 one side is known, and has a value.
    """
    if not any(_has_pole(model, node) for node in every(function)):
        return function
    return Call("min", (Call("max", (function, Negative(FAR))), FAR))


def _has_pole(model: Model, node: Node) -> bool:
    match node:
        case Binary(operator="/"):
            return _moves(model, node.right)
        case Binary(operator="**"):
            exponent = exponent_of(node.right)
            return (exponent is None or exponent < 0) and _moves(model, node.left)
    return isinstance(node, Call) and node.function == "log" and _moves(model, node)


def _bent(model: Model, trees: Iterator[Node]) -> list[str]:
    """Return the drives in some trees with a kink or jump at points of their tables that the motion passes."""
    names = {name for tree in trees for name in free_names(tree)}
    return [
        name
        for name, drive in model.elements.drives.items()
        if name in names
        and model.elements.looked_up_at[name] != CLOCK
        and (drive.interpolation in BENT or drive.table.duplicates)
    ]


def _table_switch(model: Model, owner: str, name: str) -> Switch:
    """Return the switch at the neighbouring points of a table."""
    elements = model.elements
    argument = elements.looked_up_at[name]
    left, left_far, right, right_far = map(Name, borders(name))
    below = Binary("+", Binary("*", left, argument), left_far)
    above = Binary("-", right_far, Binary("*", right, argument))
    table, labels = split_element_name(name)
    dims = model.shapes.dims.get(table, ())
    return Switch(
        owner,
        join_element_name(f"{owner}.{table}", labels),
        Binary("*", below, above),
        elements.drives[name].jumps,
        drive=name,
        dims=dims,
    )


def landed_on(model: Model) -> dict[str, str]:
    """Return the tables, by the detectors of their points, where forces have kinks that can be landed on without events."""
    return {switch.name: switch.drive for switch in watched_switches(model) if switch.drive and not switch.jumps}


def landed_on_by_default(model: Model) -> dict[str, str]:
    """Return the tables whose points are landed on by default: all, where one has many points; else none."""
    tables = landed_on(model)
    many = any(len(model.elements.drives[name].table.argument) > MANY_POINTS for name in tables.values())
    return tables if many else {}


def watched_switches(model: Model) -> tuple[Switch, ...]:
    """Return the switches that a march locates: all, or none if there are too many."""
    return () if are_too_many(model) else switches(model)


def borders(drive: str) -> tuple[str, str, str, str]:
    """Name the numbers p, q, r, s by which p*x + q and s - r*x are positive between two points of a table."""
    return f"_left_{drive}", f"_left_far_{drive}", f"_right_{drive}", f"_right_far_{drive}"


def switch_side(i: int) -> str:
    """Name the number that is the sign of a switch's function."""
    return f"_side_{i}"


def _trees_by_owner(model: Model, *, smooth: bool) -> Iterator[tuple[str, Callable[[], Iterator[Node]]]]:
    """Yield every force and state with a function that makes its trees; of a quantity those of all elements."""
    elements = model.elements
    if model.shapes.dims and not _may_switch(model):
        return
    for term, components in elements.force_components.items():
        if elements.forces[term].smooth == smooth:
            yield term, partial(_component_trees, model, components)
    for name, state in model.statement.states.items():
        if state.smooth == smooth:
            yield name, partial(_rate_trees, model, name)
    if not smooth:
        yield owner_of_masses(model), partial(_switching_masses, model)
        for name, trees in bounds_of_friction(model).items():
            yield name, partial(map, elements.expanded, trees)


def bounds_of_friction(model: Model) -> dict[str, list[Node]]:
    """Return kinetic and static bounds of friction, by friction element and contact, elements joined."""
    bounds: dict[str, list[Node]] = {}
    for name, friction in model.elements.frictions.items():
        bounds.setdefault(split_element_name(name)[0], []).extend((friction.kinetic, friction.static))
    for name, contact in model.elements.contacts.items():
        if contact.friction is not None and contact.static is not None:
            bounds.setdefault(split_element_name(name)[0], []).extend((contact.friction, contact.static))
    return bounds


def _slips(model: Model, owner: str) -> set[Node]:
    """Return the slips of friction, whose zeros are events of their own: friction may read ``abs(slip)``."""
    elements = model.elements
    parts: dict[str, Friction | Contact] = {**elements.frictions, **elements.contacts}
    slips = [
        part.slip for name, part in parts.items() if split_element_name(name)[0] == owner and part.slip is not None
    ]
    return {tree for slip in map(elements.expanded, slips) for tree in (slip, Negative(slip))}


def owner_of_masses(model: Model) -> str:
    """Return the owner's name of switches in masses: a force or state may be called ``mass``."""
    return "mass_matrix" if "mass" in model.statement.forces or "mass" in model.statement.states else "mass"


def _switching_masses(model: Model) -> Iterator[Node]:
    """Yield the masses that may switch, definitions substituted; of a quantity that may switch all elements."""
    if model.shapes.dims and not _call_any(masses_of_quantities(model), SWITCHING):
        return
    for entry in model.elements.statement.mass_entries.values():
        tree = model.elements.expanded(entry)
        if model.drives or _call_any([tree], SWITCHING):
            yield tree


def masses_of_quantities(model: Model) -> list[Node]:
    """Return the masses of a model with dimensions, or the energy from which they are derived."""
    statement = model.statement
    trees = statement.mass_entries.values() if statement.lagrangian is None else [statement.lagrangian.kinetic]
    return [expand_definitions(tree, statement.definitions, model.shapes) for tree in trees]


def _component_trees(model: Model, components: Mapping[str, Node | Function]) -> Iterator[Node]:
    parts = (components[name] for name in components)  # each when it is asked for: the first may be too many
    return (model.elements.expanded(part) for part in parts if not isinstance(part, Function))


def _rate_trees(model: Model, name: str) -> Iterator[Node]:
    return (
        model.elements.expanded(model.elements.statement.states[element].rate)
        for element in model.shapes.elements(name)
    )


def _may_switch(model: Model) -> bool:
    """Whether a model with dimensions can switch at all; if not, no trees of its elements are made."""
    return bool(model.statement.drives) or any(
        _call_any(trees, SWITCHING) for _, trees, _ in _quantities_with_trees(model)
    )


def _quantities_with_trees(model: Model) -> Iterator[tuple[str, list[Node], bool]]:
    """Yield every force and state of a model with dimensions: its trees, and whether it is declared smooth."""
    statement = model.statement
    for name, force in statement.forces.items():
        parts = (force.potential, *force.components.values())
        trees = [part for part in parts if part is not None and not isinstance(part, Function)]
        yield name, [expand_definitions(tree, statement.definitions, model.shapes) for tree in trees], force.smooth
    for name, state in statement.states.items():
        yield name, [expand_definitions(state.rate, statement.definitions, model.shapes)], state.smooth
    yield owner_of_masses(model), masses_of_quantities(model), False
    if statement.lagrangian is not None and statement.lagrangian.potential is not None:
        yield (
            POTENTIAL,
            [expand_definitions(statement.lagrangian.potential, statement.definitions, model.shapes)],
            False,
        )
    rubs: dict[str, tuple[Node | None, ...]] = {
        name: (part.kinetic, part.static) for name, part in statement.frictions.items()
    }
    rubs |= {name: (part.friction, part.static) for name, part in statement.contacts.items()}
    for name, bounds in rubs.items():
        trees = [expand_definitions(tree, statement.definitions, model.shapes) for tree in bounds if tree is not None]
        yield name, trees, False


def _call_any(trees: list[Node], functions: tuple[str, ...]) -> bool:
    """Whether trees call one of some functions, of more than numbers of elements."""
    calls = (node for tree in trees for node in every(tree) if isinstance(node, Call | Along))
    return any(call.function in functions and not _is_of_numbers(call) for call in calls)


def _is_of_numbers(node: Call | Along) -> bool:
    """Whether it is of numbers of elements alone, or a `where` with such a condition, which never changes."""
    deciding_arguments = node.arguments[:1] if node.function == "where" else node.arguments
    return not any(map(free_names, deciding_arguments))


def _moves(model: Model, function: Node) -> bool:
    """Whether the function of a switch changes along a motion."""
    if not free_names(function).isdisjoint(_moving_variables(model)):
        return True
    read = model.elements.reads(function)
    return bool(read & _moving_variables(model)) or (bool(model.delays) and any(map(is_before, read)))


@lru_cache(maxsize=1)
def _moving_variables(model: Model) -> frozenset[str]:
    elements = model.elements
    return frozenset(
        {
            "t",
            *elements.statement.coordinates,
            *map(velocity, elements.statement.coordinates),
            *elements.statement.states,
        }
    )

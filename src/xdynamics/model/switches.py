"""Switches hidden in forces: where the argument of `abs`, `sign`, `min`, `max` or `where` passes through zero.

On either side a force is smooth, across it is not: no method keeps its order over a step that passes one. So it is with
a measured table of a coordinate or velocity whose points are joined by straight lines, or by none.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

from xdynamics.expressions import Binary, Call, Compare, Name, Negative, Node, chain, free_names
from xdynamics.expressions.calculus import ZERO
from xdynamics.expressions.tree import children
from xdynamics.model.model import Model
from xdynamics.model.parts import Function
from xdynamics.schema import velocity

MOST_SWITCHES = 40  # that are watched for: a search for more costs more than it is worth
LOCATED, STEPPED_OVER = "located", "stepped over"
SWITCHES = (LOCATED, STEPPED_OVER)
BENT = (
    "previous",
    "linear",
)  # interpolations that jump or bend at every point; the others are smooth enough to step over


@dataclass(frozen=True)
class Switch:
    """One hidden switch.

    Attributes
    ----------
    owner : str
        The force, or the state of the rate.
    name : str
        That and the function: ``drag:abs``.
    function : Node
        What passes through zero.
    jumps : bool
        Whether the force itself jumps there, and not a derivative.
    at_zero : int
        The side that zero belongs to.
    drive : str
        The table, where that is the switch: the function is positive between two of its points.
    """

    owner: str
    name: str
    function: Node
    jumps: bool
    at_zero: int = 1
    drive: str = ""


@lru_cache(maxsize=64)
def switches(model: Model) -> tuple[Switch, ...]:
    """Return the hidden switches of forces and rates that are not declared smooth, in the order written."""
    found: list[Switch] = []
    for owner, trees in _trees(model):
        told = {one.drive for one in found}
        found += [_between(model, owner, name) for name in _bent(model, trees) if name not in told]
        known: dict[str, list[Node]] = {}
        for tree in trees:
            for name, function, jumps, at_zero in _kinks(tree):
                met = known.setdefault(name, [])
                if function not in met and _moves(model, function):
                    met.append(function)
                    number = f"_{len(met)}" if len(met) > 1 else ""
                    found.append(Switch(owner, f"{owner}:{name}{number}", function, jumps, at_zero))
    return tuple(found)


def _bent(model: Model, trees: list[Node]) -> list[str]:
    """Return the drives in some trees that bend or jump at points of their tables which the motion passes."""
    read = {name for tree in trees for name in free_names(tree)}
    return [
        name for name, one in model.drives.items() if name in read and one.argument != "t" and one.interpolation in BENT
    ]


def _between(model: Model, owner: str, name: str) -> Switch:
    """Return the switch at the next points of a table on either side."""
    argument = Name(model.drives[name].argument)
    left, left_far, right, right_far = map(Name, borders(name))
    below = Binary("+", Binary("*", left, argument), left_far)
    above = Binary("-", right_far, Binary("*", right, argument))
    jumps = model.drives[name].interpolation == "previous" or model.drives[name].outside == "zero"
    return Switch(owner, f"{owner}:{name}", Binary("*", below, above), jumps, drive=name)


def watched_switches(model: Model) -> tuple[Switch, ...]:
    """Return those that a march looks for: all, or none where they are too many."""
    found = switches(model)
    return found if len(found) <= MOST_SWITCHES else ()


class Sided(Model):
    """A model whose forces are told on which side of each switch they are.

    Up to the very end of a step that ends at a switch they are then those of the side that the motion came from, and
    behind it those of the other one.
    """

    switches: tuple[Switch, ...]
    plain: Model

    @cached_property
    def digest(self) -> str:
        """That of the model, and that it is this."""
        return f"{self.plain.digest} sided"

    @cached_property
    def force_components(self) -> dict[str, dict[str, Node | Function]]:
        """Every force term's components, each with sides in the place of what is decided by a sign."""
        found = self.plain.force_components
        return {
            term: {name: one if isinstance(one, Function) else self._told(term, one) for name, one in parts.items()}
            for term, parts in found.items()
        }

    def _told(self, owner: str, tree: Node) -> Node:
        sides = {one.function: side(i) for i, one in enumerate(self.switches) if one.owner == owner and not one.drive}
        return _told(self.plain.expanded(tree), sides) if sides else tree


@lru_cache(maxsize=64)
def sided(model: Model) -> Model:
    """Return a model that is told its sides; itself, where there are none."""
    found = watched_switches(model)
    if not found or isinstance(model, Sided):
        return model
    told = object.__new__(Sided)
    told.__dict__.update(
        {key: value for key, value in vars(model).items() if key not in ("digest", "force_components")}
    )
    told.switches, told.plain = found, model
    told.states = {name: replace(one, rate=told._told(name, one.rate)) for name, one in model.states.items()}
    return told


def told(model: Model) -> tuple[str, ...]:
    """Name the numbers that forces are told: of each switch its side, or how far the next points of its table are."""
    found = [borders(one.drive) if one.drive else (side(i),) for i, one in enumerate(watched_by(model))]
    return tuple(name for names in found for name in names)


def watched_by(model: Model) -> tuple[Switch, ...]:
    """Return the switches that the forces of a model are told of; none but those of a sided one are."""
    return model.switches if isinstance(model, Sided) else ()


def borders(drive: str) -> tuple[str, str, str, str]:
    """Name the numbers p, q, r, s by which p*x + q and s - r*x are positive between two points of a table."""
    return f"_left_{drive}", f"_left_far_{drive}", f"_right_{drive}", f"_right_far_{drive}"


def side(i: int) -> str:
    """Name the number that is the sign of a switch's function."""
    return f"_side_{i}"


def _told(node: Node, sides: Mapping[Node, str]) -> Node:
    """Put sides in the place of signs."""
    if isinstance(node, Binary):
        first, links = chain(node)
        found = _told(first, sides)
        for one in links:
            found = Binary(one.operator, found, _told(one.right, sides), one.column)
        return found
    if isinstance(node, Negative):
        return Negative(_told(node.operand, sides), node.column)
    if isinstance(node, Compare):
        return Compare(node.operator, _told(node.left, sides), _told(node.right, sides), node.column)
    if not isinstance(node, Call):
        return node
    inner = tuple(_told(one, sides) for one in node.arguments)
    if node.function in ("abs", "sign") and node.arguments[0] in sides:
        known = Name(sides[node.arguments[0]])
        return known if node.function == "sign" else Binary("*", known, inner[0])
    if node.function in ("min", "max"):
        return _chosen(node, inner, sides)
    if node.function == "where" and isinstance(node.arguments[0], Compare):
        condition = node.arguments[0]
        known_side = sides.get(Binary("-", condition.left, condition.right))
        if known_side is not None:
            return Call("where", (Compare(condition.operator[0], Name(known_side), ZERO), *inner[1:]), node.column)
    return Call(node.function, inner, node.column)


def _chosen(node: Call, inner: tuple[Node, ...], sides: Mapping[Node, str]) -> Node:
    """Write min and max as choices, as far as their sides are known."""
    result, others = inner[-1], node.arguments[-1:]
    for i in range(len(inner) - 2, -1, -1):
        best = others[0] if len(others) == 1 else Call(node.function, others)
        known = sides.get(Binary("-", node.arguments[i], best))
        if known is None:
            result = Call(node.function, (inner[i], result))
        else:
            result = Call(
                "where", (Compare("<" if node.function == "min" else ">", Name(known), ZERO), inner[i], result)
            )
        others = (node.arguments[i], *others)
    return result


def _trees(model: Model) -> Iterator[tuple[str, list[Node]]]:
    for term, parts in model.force_components.items():
        if not model.forces[term].smooth:
            yield term, [model.expanded(one) for one in parts.values() if not isinstance(one, Function)]
    for name, state in model.states.items():
        if not state.smooth:
            yield name, [model.expanded(state.rate)]


def _kinks(node: Node) -> Iterator[tuple[str, Node, bool, int]]:
    """Yield function, what passes through zero, whether there is a jump, and zero's side, of a tree from the inside out."""
    if isinstance(node, Binary):
        first, links = chain(node)
        for part in (first, *(one.right for one in links)):
            yield from _kinks(part)
        return
    for part in children(node):
        yield from _kinks(part)
    if not isinstance(node, Call):
        return
    if node.function in ("abs", "sign"):
        yield node.function, node.arguments[0], node.function == "sign", 1
    elif node.function in ("min", "max"):
        *rest, last = node.arguments
        for i, one in enumerate(rest):
            others = (*rest[i + 1 :], last)
            yield (
                node.function,
                Binary("-", one, others[0] if len(others) == 1 else Call(node.function, others)),
                False,
                1,
            )
    elif node.function == "where":
        condition = node.arguments[0]
        if isinstance(condition, Compare) and condition.operator not in ("==", "!="):
            at_zero = 1 if condition.operator in ("<", ">=") else -1
            yield "where", Binary("-", condition.left, condition.right), True, at_zero


def _moves(model: Model, function: Node) -> bool:
    """Whether what passes through zero changes along a motion."""
    moving = {"t", *model.coordinates, *map(velocity, model.coordinates), *model.states}
    return bool(model.reads(function) & moving)

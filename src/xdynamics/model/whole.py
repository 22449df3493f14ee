"""The motion of a model with dimensions as expressions with dimensions: as many as there are quantities.

What they are at each element is what the model says of its elements.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

from xdynamics.expressions import Along, Binary, Call, Name, Node, Number, free_names
from xdynamics.expressions.calculus import ONE, ZERO
from xdynamics.model.drive_arguments import CLOCK
from xdynamics.model.elements import Elements
from xdynamics.model.model import Model
from xdynamics.model.motion import in_regimes, slope
from xdynamics.model.parts import Function
from xdynamics.model.reactions import reactions
from xdynamics.schema import acceleration, force, rate, velocity
from xdynamics.shapes import Shapes, dims_of
from xdynamics.shapes.gradient import derivative
from xdynamics.shapes.trees import expanded

Quantity = tuple[str, tuple[str, ...], Node]  # a name, its dimensions, what it is


def has_wholes(model: Model) -> bool:
    """Whether a model has dimensions, and its motion is that of `motion_of_wholes`."""
    derived = model.shaped.lagrangian is not None  # its mass is full, and of elements alone
    return bool(model.shapes.extents) and not derived and not model.mass_is_full


def is_read_whole(model: Model) -> bool:
    """Whether states inside a run's steps follow from whole quantities; contacts and delays are told of elements alone."""
    return has_wholes(model) and not (reactions(model) or model.delays)


@lru_cache(maxsize=64)
def shapes_of(model: Model) -> Shapes:
    """Return the shapes of a model with those of its force components, and of the slopes of its tables."""
    own = model.shapes.dims
    names = {slope(name): own.get(name, ()) for name in model.shaped.drives}
    names |= {force(term, name): own.get(name, ()) for term, parts in acting(model).items() for name in parts}
    return replace(model.shapes, dims={**own, **{name: dims for name, dims in names.items() if dims}})


@lru_cache(maxsize=64)
def acting(model: Model) -> dict[str, dict[str, Node | Function]]:
    """Return what every force term is for every coordinate on which it acts."""
    elements = Elements(model.shaped, model.shapes)
    return {term: elements.acting(part) for term, part in model.shaped.forces.items()}


def motion_of_wholes(model: Model) -> list[Quantity]:
    """Return force terms, accelerations and rates, as `model.motion` writes them for elements, without full masses."""
    own, found, totals = model.shapes.dims, list[Quantity](), dict[str, Node]()
    for term, components in acting(model).items():
        for name, tree in components.items():
            assert not isinstance(tree, Function)  # noqa: S101 - asked before
            one = force(term, name)
            found.append((one, own.get(name, ()), in_regimes(model, term, written_out(model, tree))))
            totals[name] = Binary("+", totals[name], Name(one)) if name in totals else Name(one)
    for i, name in enumerate(model.shaped.coordinates):
        mass = Call("positive", (written_out(model, model.shaped.mass[i][i]),))
        found.append((acceleration(name), own.get(name, ()), Binary("/", totals.get(name, ZERO), mass)))
    for name, state in model.shaped.states.items():
        found.append((rate(name), own.get(name, ()), written_out(model, state.rate)))
    return found


def varying(model: Model) -> list[str]:
    """Return the quantities of a state, as a force evaluation uses them."""
    shaped = model.shaped
    return [*shaped.coordinates, *map(velocity, shaped.coordinates), *shaped.states]


def change(name: str) -> str:
    """Name the derivative of a quantity along a direction of the state; of one of the state itself the direction."""
    return f"_change_{name}"


def shapes_of_changes(model: Model) -> Shapes:
    """Return the shapes of a model with those of its changes."""
    shapes = shapes_of(model)
    names = [*varying(model), *(name for name, _, _ in motion_of_wholes(model))]
    dims = {change(name): shapes.dims[name] for name in names if name in shapes.dims}
    return replace(shapes, dims={**shapes.dims, **dims})


def changes_of_wholes(model: Model) -> list[Quantity]:
    """Return the derivatives of what `motion_of_wholes` gives along a direction of the state, by the chain rule."""
    shapes, found = shapes_of_changes(model), list[Quantity]()
    rates: dict[str, Node] = {name: Name(change(name)) for name in varying(model)}
    for name, dims, tree in motion_of_wholes(model):
        one = derivative(tree, rates, shapes)
        found.append((change(name), dims, one))
        if one != ZERO:
            rates[name] = Name(change(name))
    return found


def written_out(model: Model, tree: Node) -> Node:
    """Return an expression with dimensions with every definition substituted."""
    return expanded(tree, model.shaped.definitions, model.shapes)


def events_of_wholes(model: Model) -> list[Quantity]:
    """Return the function of each event, and 1 for what is looked for otherwise: ticks, links of contacts."""
    found = list[Quantity]()
    for name, event in model.shaped.events.items():
        assert not isinstance(event.function, Function)  # noqa: S101 - asked before
        tree = ONE if event.every is not None else written_out(model, event.function)
        found.append((name, model.shapes.dims.get(name, ()), tree))
    return [*found, *((name, (), ONE) for name in model.assemblies)]


def rates_of_wholes(model: Model, quantities: Sequence[Quantity]) -> list[Quantity] | None:
    """Return the time derivatives of expressions along the motion.

    None where they read a table for each element that is looked up at anything but a time: only elements say at what.
    """
    shaped, rates = model.shaped, dict[str, Node](t=ONE)
    for name in shaped.coordinates:
        rates |= {name: Name(velocity(name)), velocity(name): Name(acceleration(name))}
    rates |= {name: Name(rate(name)) for name in shaped.states}
    for name in shaped.drives:
        if model.looked_up_at[model.shapes.first(name)] == CLOCK:
            rates[name] = Name(slope(name))
        elif not model.shapes.dims.get(name):
            rates[name] = model.rates[name]
        elif any(name in free_names(tree) for _, _, tree in quantities):
            return None
    shapes = shapes_of(model)
    return [(f"_rate_of_{name}", dims, derivative(tree, rates, shapes)) for name, dims, tree in quantities]


def energies_of_wholes(model: Model) -> dict[str, Node]:
    """Return kinetic energy and, where a potential is known, potential and total energy."""
    kinetic = []
    for i, name in enumerate(model.shaped.coordinates):
        speed = Name(velocity(name))
        mass = Binary("/", written_out(model, model.shaped.mass[i][i]), Number(2.0))
        kinetic.append(_summed(model, Binary("*", mass, Binary("*", speed, speed))))
    found, potential = {"kinetic_energy": _total(kinetic)}, potentials_of_wholes(model)
    if potential:
        found["potential_energy"] = _total([*potential.values()])
        found["total_energy"] = Binary("+", found["kinetic_energy"], found["potential_energy"])
    return found


def potentials_of_wholes(model: Model) -> dict[str, Node]:
    """Return the potential energy of each force term that has one, summed over all elements."""
    return {
        term: in_regimes(model, term, _summed(model, written_out(model, part.potential)))
        for term, part in model.shaped.forces.items()
        if part.potential is not None
    }


def _summed(model: Model, tree: Node) -> Node:
    dims = dims_of(tree, model.shapes)
    return Along("sum", (tree,), dims) if dims else tree


def _total(terms: list[Node]) -> Node:
    total = terms[0]
    for term in terms[1:]:
        total = Binary("+", total, term)
    return total

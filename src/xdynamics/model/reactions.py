"""What contacts and dry friction add to M a = F, as trees: forces solved for together with the accelerations.

A closed contact and a sticking friction element each constrain one row of the motion: the second derivative of the gap,
or the first of the slip, is zero. Their forces u are such that R a + bias = 0 with a = M^-1 (F + R^T u), so they solve
R M^-1 R^T u = -(R a_free + bias) (Pfeiffer and Glocker, Multibody Dynamics with Unilateral Contacts, 1996, chapter 5).
A slipping element has a known force, a number or a fraction of the normal force. Whether each holds, slips or is open
is a number after the parameters, so the same assignments serve all cases.

Where more reactions hold than the motion needs, as the four legs of a table, it does not determine their forces. These
are then what they would be on supports that all give way alike: the solution of least norm, in the scale of what each
answers to itself (Golub, Van Loan, Matrix Computations, 4th ed., 2013, section 5.5). In place of the row of one that
follows from rows before it, its force is a sum of shares of their forces, which are numbers after the parameters, too.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache

from xdynamics.elementary.bounds import EPS
from xdynamics.expressions import Binary, Call, Compare, Name, Negative, Node, dimension_of, expand
from xdynamics.expressions.calculus import ONE, ZERO, multiply, sum_of_terms
from xdynamics.model.constraints import (
    Assignment,
    Condition,
    conditions,
    keep_conditions,
    rate_row_and_bias,
    solve_mass,
    subtract_terms,
)
from xdynamics.model.model import Model
from xdynamics.model.parts import APPROACH
from xdynamics.reaction_names import constraint_force, contact_force, friction_force
from xdynamics.schema import acceleration, velocity
from xdynamics.units import Dimension

NORMAL, TANGENT, DRY = range(3)  # of a contact, along its surface, of a friction element
ALIKE = 1e-10  # of the effect of a reaction on its own row: what is left of it where others do the same
PIVOT_NOISE = 64.0 * EPS  # of the terms of such a rest: what rounding may leave
MODES = 2  # numbers of each reaction: whether it holds; the direction of slip, or when a contact has settled


@dataclass(frozen=True)
class Reaction:
    """One force of a contact or friction element.

    Attributes
    ----------
    name : str
        Of the force, in the record.
    owner : str
        The contact or friction element.
    sort : int
        `NORMAL`, `TANGENT` or `DRY`.
    normal : int
        For a tangent the number of its normal force, else its own.
    gap : Node
        Of a normal force; zero for others.
    rate : Node
        How fast the gap opens, or the slip.
    row : mapping of str to Node
        The derivative of `rate` by the velocity of each coordinate that it depends on: the force acts along it.
    bias : Node
        The time derivative of `rate` with zero accelerations.
    size, sticking_limit : Node
        Coefficient of friction, or force, while it slips, and the largest at which it sticks; `size` of a normal force
        is the coefficient of restitution.
    """

    name: str
    owner: str
    sort: int
    normal: int
    gap: Node
    rate: Node
    row: Mapping[str, Node]
    bias: Node
    size: Node
    sticking_limit: Node


@lru_cache(maxsize=64)
def reactions(model: Model) -> tuple[Reaction, ...]:
    """Return the forces of contacts and friction elements: normal ones, then tangents, then dry friction."""
    elements = model.elements
    if not (elements.contacts or model.frictions):
        return ()
    if model.elements is not model:
        return reactions(model.elements)
    forces = []
    for i, (name, contact) in enumerate(elements.contacts.items()):
        rate = elements.rate_of(contact.gap)
        restitution = expand(elements.expanded(contact.restitution), {APPROACH: Negative(rate)})
        forces.append(
            Reaction(
                contact_force(name),
                name,
                NORMAL,
                i,
                elements.expanded(contact.gap),
                rate,
                *rate_row_and_bias(model, rate),
                restitution,
                ONE,
            )
        )
    for i, (name, contact) in enumerate(elements.contacts.items()):
        if contact.slip is not None and contact.friction is not None and contact.static is not None:
            forces.append(_tangent_reaction(model, name, TANGENT, i, (contact.slip, contact.friction, contact.static)))
    for name, element in elements.frictions.items():
        trees = element.slip, element.kinetic, element.static
        forces.append(_tangent_reaction(model, name, DRY, len(forces), trees))
    return tuple(forces)


def _tangent_reaction(model: Model, owner: str, sort: int, normal: int, trees: tuple[Node, Node, Node]) -> Reaction:
    slip, size, sticking_limit = map(model.elements.expanded, trees)
    return Reaction(
        friction_force(owner), owner, sort, normal, ZERO, slip, *rate_row_and_bias(model, slip), size, sticking_limit
    )


@lru_cache(maxsize=64)
def may_be_indeterminate(model: Model) -> bool:
    """Whether so many reactions may hold, beside constraints, that the motion does not determine their forces.

    It may not where each has a coordinate of its own: a maximum matching of rows and coordinates (Kuhn, Naval Research
    Logistics 2, 1955, 83).
    """
    owners: dict[str, int] = {}
    rows = [reaction.row for reaction in reactions(model)]
    rows += [condition.row for condition in conditions(model)] if rows else []

    def finds_own(k: int, seen: set[str]) -> bool:
        for name in rows[k]:
            if name not in seen:
                seen.add(name)
                if name not in owners or finds_own(owners[name], seen):
                    owners[name] = k
                    return True
        return False

    return not all(finds_own(k, set()) for k in range(len(rows)))


def holding_flag(reaction: Reaction) -> str:
    """Name the number that is 1 where a reaction holds its row."""
    return f"_holds_{reaction.name}"


def mode_number(reaction: Reaction) -> str:
    """Name the number that is the sign of the slip, or the time at which a contact has settled."""
    return f"_until_{reaction.name}" if reaction.sort == NORMAL else f"_way_{reaction.name}"


def mode_names(model: Model) -> tuple[str, ...]:
    """Name the numbers that describe the modes of contacts and friction elements, and then the shares of their forces."""
    flags = [name for reaction in reactions(model) for name in (holding_flag(reaction), mode_number(reaction))]
    return (*flags, *(share_number(k, j) for k, j in sharing_pairs(model)))


def sharing_pairs(model: Model) -> list[tuple[int, int]]:
    """List the pairs of reactions of which the first may bear a share of what the second does."""
    count = len(reactions(model)) if may_be_indeterminate(model) else 0
    return [(k, j) for k in range(count) for j in range(k)]


def share_number(k: int, j: int) -> str:
    """Name the number that is the force of one reaction over that of another, where it shares in what this bears."""
    return f"_share{k}_{j}"


def free_acceleration(name: str) -> str:
    """Name the acceleration that a coordinate has without reactions."""
    return f"_free_{name}"


def unloaded(condition: Condition) -> str:
    """Name the multiplier that a constraint has without reactions."""
    return f"_unloaded_{condition.name}"


def reaction_dimensions(model: Model) -> dict[str, Dimension]:
    """Return the dimension of each reaction: power over that of its rate."""
    elements = model.elements
    dimensions, by_reaction = elements.dimensions, {}
    for reaction in reactions(model):
        i, name = next((i, name) for i, name in enumerate(elements.statement.coordinates) if name in reaction.row)
        power = (
            dimension_of(elements.mass[i][i], dimensions)
            * dimensions[name]
            / model.time_unit.dimension**2
            * dimensions[velocity(name)]
        )
        by_reaction[reaction.name] = power / rate_dimension(model, reaction)
    return by_reaction


def rate_dimension(model: Model, reaction: Reaction) -> Dimension:
    """Return the dimension of a reaction's rate."""
    dimensions = model.elements.dimensions
    if reaction.sort == NORMAL:
        return dimension_of(reaction.gap, dimensions) / model.time_unit.dimension
    return dimension_of(reaction.rate, dimensions)


def reaction_assignments(model: Model) -> Iterator[Assignment]:
    """Write the reactions, and the accelerations with them.

    The matrix is eliminated without exchanging rows: its pivots are positive where there is one solution for every
    load (a P-matrix, Cottle, Pang, Stone, The Linear Complementarity Problem, 1992, section 3.3), and nan otherwise.
    """
    acting = reactions(model)
    if not acting:
        return
    yield from delassus_assignments(model)
    sharing = set(sharing_pairs(model))
    entries: dict[tuple[int, int], Node] = {}
    right: list[Node] = []
    for k, reaction in enumerate(acting):
        is_holding = Compare("==", Name(holding_flag(reaction)), ONE)
        for j in range(len(acting)):
            otherwise = _let_go(reaction, k, j)
            if (k, j) in sharing:
                otherwise = subtract_terms(otherwise, [Name(share_number(k, j))])
            if _shared_coordinates(model, reaction, acting[j]) or otherwise != ZERO:
                gram = Name(_gram(k, j)) if _shared_coordinates(model, reaction, acting[j]) else ZERO
                entries[k, j] = Name(f"_entry{k}_{j}")
                yield Assignment(f"_entry{k}_{j}", Call("where", (is_holding, gram, otherwise)))
        slipping = multiply(Negative(Name(mode_number(reaction))), reaction.size) if reaction.sort == DRY else ZERO
        right.append(Name(f"_right{k}"))
        yield Assignment(f"_right{k}", Call("where", (is_holding, Negative(Name(_free_row_rate(k))), slipping)))
    yield from _eliminated(entries, right, [reaction.name for reaction in acting])
    for c, condition in enumerate(conditions(model)):
        shares = (multiply(Name(_borne(k, c)), Name(reaction.name)) for k, reaction in enumerate(acting))
        yield Assignment(constraint_force(condition.name), sum_of_terms([Name(unloaded(condition)), *shares]))
    for name in model.elements.statement.coordinates:
        pulls = [
            multiply(Name(_reaction_reach(k, name)), Name(reaction.name))
            for k, reaction in enumerate(acting)
            if name in _accelerated_coordinates(model, reaction)
        ]
        yield Assignment(acceleration(name), sum_of_terms([Name(free_acceleration(name)), *pulls]))


def delassus_assignments(model: Model) -> Iterator[Assignment]:
    """Write rows, the effect of a unit of each reaction on accelerations and rows, and each row's free acceleration."""
    acting = reactions(model)
    for k, reaction in enumerate(acting):
        yield from (Assignment(_reaction_row(k, name), tree) for name, tree in reaction.row.items())
        reached = _accelerated_coordinates(model, reaction)
        yield from _answering(model, k, reached)
        products = (Binary("*", Name(_reaction_row(k, name)), Name(free_acceleration(name))) for name in reaction.row)
        yield Assignment(_free_row_rate(k), sum_of_terms([reaction.bias, *products]))
    for k, reaction in enumerate(acting):
        for j, second_reaction in enumerate(acting):
            if shared := _shared_coordinates(model, reaction, second_reaction):
                terms = [Binary("*", Name(_reaction_row(k, name)), Name(_reaction_reach(j, name))) for name in shared]
                yield Assignment(_gram(k, j), sum_of_terms(terms))


def _answering(model: Model, k: int, reached: list[str]) -> Iterator[Assignment]:
    """Return the response of accelerations and multipliers to a unit of a reaction."""
    reaction, tied = reactions(model)[k], conditions(model)
    reach_name = _reaction_reach if not tied else _pushed
    rows = {reach_name(k, name): Name(_reaction_row(k, name)) if name in reaction.row else ZERO for name in reached}
    yield from solve_mass(model, rows, reached)
    if tied:
        free = {name: Name(_pushed(k, name)) for name in reached}
        targets = {name: _reaction_reach(k, name) for name in reached}
        yield from keep_conditions(model, free, [ZERO] * len(tied), targets, [_borne(k, c) for c in range(len(tied))])


def reaction_table(model: Model) -> tuple[list[Node], ...]:
    """Return the numbers that `march.contacts.delassus` reads at a state: of each reaction, then matrices by row.

    Returns
    -------
    tuple of list of Node
        Gap, rate, free acceleration of the row, size and most of each; the effect of each on each row; its row; the
        effect of a unit of it on each acceleration.
    """
    acting = reactions(model)
    coordinates = list(model.elements.statement.coordinates) if acting else []  # the names of a million are 0.1 GB
    numbers: list[Node] = []
    grams = gram_trees(model)
    rows: list[Node] = []
    reach: list[Node] = []
    for k, reaction in enumerate(acting):
        numbers += [reaction.gap, reaction.rate, Name(_free_row_rate(k)), reaction.size, reaction.sticking_limit]
        rows += [Name(_reaction_row(k, name)) if name in reaction.row else ZERO for name in coordinates]
        reach += [
            Name(_reaction_reach(k, name)) if name in _accelerated_coordinates(model, reaction) else ZERO
            for name in coordinates
        ]
    return numbers, grams, rows, reach


def gram_trees(model: Model) -> list[Node]:
    """Return the effect of a unit of each reaction on the row of each, row by row."""
    acting = reactions(model)
    return [
        Name(_gram(k, j)) if _shared_coordinates(model, first, second) else ZERO
        for k, first in enumerate(acting)
        for j, second in enumerate(acting)
    ]


def _let_go(reaction: Reaction, k: int, j: int) -> Node:
    """Return an entry of the row of a reaction that does not hold: zero force, or a fraction of the normal force."""
    if j == k:
        return ONE
    return (
        multiply(Name(mode_number(reaction)), reaction.size)
        if reaction.sort == TANGENT and j == reaction.normal
        else ZERO
    )


def _eliminated(entries: dict[tuple[int, int], Node], right: list[Node], names: list[str]) -> Iterator[Assignment]:
    """Solve for the reactions by Gaussian elimination; missing entries are zero."""
    n = len(names)
    for p in range(n):
        yield Assignment(f"_pivot{p}", Call("positive", (entries[p, p],)))
        for i in (i for i in range(p + 1, n) if (i, p) in entries):
            factor = f"_factor{i}_{p}"
            yield Assignment(factor, Binary("/", entries[i, p], Name(f"_pivot{p}")))
            for j in (j for j in range(p + 1, n) if (p, j) in entries):
                changed = f"_entry{i}_{j}_{p}"
                yield Assignment(
                    changed, subtract_terms(entries.get((i, j), ZERO), [Binary("*", Name(factor), entries[p, j])])
                )
                entries[i, j] = Name(changed)
            yield Assignment(f"_right{i}_{p}", subtract_terms(right[i], [Binary("*", Name(factor), right[p])]))
            right[i] = Name(f"_right{i}_{p}")
    for i in reversed(range(n)):
        back_products = (Binary("*", entries[i, j], Name(names[j])) for j in range(i + 1, n) if (i, j) in entries)
        yield Assignment(names[i], Binary("/", subtract_terms(right[i], back_products), Name(f"_pivot{i}")))


def _accelerated_coordinates(model: Model, reaction: Reaction) -> list[str]:
    """Return the coordinates that a reaction accelerates: all of them through a full mass, or constraints."""
    return (
        list(model.elements.statement.coordinates)
        if model.elements.mass_is_full or model.constraints
        else list(reaction.row)
    )


def _shared_coordinates(model: Model, reaction: Reaction, second_reaction: Reaction) -> list[str]:
    """Return the coordinates through which one reaction is coupled to another."""
    return [name for name in reaction.row if name in _accelerated_coordinates(model, second_reaction)]


def _reaction_row(k: int, name: str) -> str:
    return f"_row{k}_{name}"


def _reaction_reach(k: int, name: str) -> str:
    return f"_reach{k}_{name}"


def _pushed(k: int, name: str) -> str:
    return f"_pushed{k}_{name}"


def _borne(k: int, c: int) -> str:
    return f"_borne{k}_{c}"


def _gram(k: int, j: int) -> str:
    return f"_gram{k}_{j}"


def _free_row_rate(k: int) -> str:
    return f"_without{k}"

"""Traits of a model that a method may refuse, each with the term responsible."""

from __future__ import annotations

import re
from enum import StrEnum
from functools import lru_cache
from typing import TYPE_CHECKING

from xdynamics.expressions import Node, derivative, free_names
from xdynamics.expressions.calculus import ONE
from xdynamics.faults import first_names
from xdynamics.model.controllers import controller_states
from xdynamics.model.elementwise import element_blocks
from xdynamics.model.motion import forces_by_coordinate, has_diagonal_mass
from xdynamics.model.parts import Contact, Function
from xdynamics.model.reactions import NORMAL, reactions
from xdynamics.schema import velocity
from xdynamics.shapes.blocks import Blocks

if TYPE_CHECKING:
    from xdynamics.model.model import Model


class Trait(StrEnum):
    """A property of the right-hand side; the value is the phrase for messages and tables."""

    VELOCITY_DEPENDENT = "velocity-dependent forces"
    COUPLED_MASS = "a non-diagonal mass matrix that depends on coordinates"
    COUPLED_STATES = "first-order states coupled to the motion"
    NO_COORDINATES = "models without coordinates"
    PYTHON_FORCES = "forces written in Python, which have no derivatives"
    CONSTRAINTS = "constraints, which its order does not survive"
    CONTACTS = "contacts and dry friction, whose forces it has no derivatives of"
    PRESSED = "contacts along curved gaps, and friction, whose forces depend on velocities"
    HELD_LINKS = "contacts of many links along curved gaps, whose forces depend on velocities"


@lru_cache(maxsize=64)
def traits_of(model: Model) -> dict[Trait, str]:
    """Return the traits of a model, each with a phrase that names the entries that cause it."""
    elements = model.elements
    traits: dict[Trait, str] = {}
    if not elements.statement.coordinates:
        traits[Trait.NO_COORDINATES] = "the model has first-order states only"
    owners = {
        Trait.PYTHON_FORCES: [f"function {', '.join(item.name for item in model.python_forces)}"]
        * bool(model.python_forces),
        Trait.CONTACTS: [*dict.fromkeys(item.owner for item in reactions(model))],
        Trait.CONSTRAINTS: [*model.statement.constraints],
        Trait.HELD_LINKS: curved_contacts(model) if _takes_energy(model) else [],
    }
    traits |= {trait: ", ".join(names) for trait, names in owners.items() if names}
    coordinates, held_names = (
        element_blocks(elements.statement.coordinates),
        controller_states(elements.controllers, model.time_unit),
    )
    velocities = coordinates.renamed("", velocity)
    states = Blocks(
        block for block in element_blocks(elements.statement.states).blocks if block.name not in held_names
    )  # constant between ticks
    for label, names_read in _right_hand_side(model):
        if fault := _among(names_read, velocities):
            traits.setdefault(Trait.VELOCITY_DEPENDENT, f"{label} depends on {_list_names(fault)}")
        if fault := _among(names_read, states):
            traits.setdefault(Trait.COUPLED_STATES, f"{label} depends on the state {_list_names(fault)}")
    if pressed := _pressed_by_velocities(model, velocities):
        traits[Trait.PRESSED] = first_names(pressed)
    if elements.mass_is_full:
        for (i, j), entry in elements.statement.mass_entries.items():
            if fault := elements.reads(entry) & set(elements.statement.coordinates):
                traits.setdefault(Trait.COUPLED_MASS, f"mass entry ({i + 1}, {j + 1}) depends on {_list_names(fault)}")
    varying_blocks = velocities + coordinates + states
    for name, state in model.statement.states.items():
        if Trait.COUPLED_STATES in traits:  # the first is told
            break
        if fault := _among(_names_read(model, state.rate), varying_blocks):
            traits[Trait.COUPLED_STATES] = f"the rate of '{name}' depends on {_list_names(fault)}"
    return traits


def _right_hand_side(model: Model) -> list[tuple[str, set[str]]]:
    """Return every force component and mass entry, with the names that it reads.

    Of what has dimensions these are the names of quantities, of full masses those of elements.
    """
    forces = [
        (f"force '{term}' of '{coordinate}'", _names_read(model, part))
        for term, parts in forces_by_coordinate(model).items()
        for coordinate, part in parts.items()
    ]
    entries = (model if has_diagonal_mass(model) else model.elements).statement.mass_entries.values()
    masses = [("the mass", _names_read(model, entry)) for entry in entries]
    return forces + masses


def _pressed_by_velocities(model: Model, velocities: Blocks) -> list[str]:
    """Return the forces of contacts and friction that depend on velocities, each with one."""
    found = []
    for reaction in reactions(model):
        sizes = () if reaction.sort == NORMAL else (reaction.size, reaction.sticking_limit)
        reads = set[str]().union(*map(model.elements.reads, (*reaction.row.values(), reaction.bias, *sizes)))
        if fault := _among(reads, velocities):
            curved = " along a curved gap" * (reaction.sort == NORMAL)
            found.append(f"'{reaction.name}'{curved} depends on {_list_names(fault)}")
    return found


def curved_contacts(model: Model) -> list[str]:
    """Return the contacts of many links whose forces, where they hold bodies, depend on velocities."""
    return [name for name, contact in model.assemblies.items() if _turns_direction(model, contact)]


def _takes_energy(model: Model) -> bool:
    """Whether impacts or friction take energy, so that bodies may come to rest on links."""
    contacts = [*model.elements.contacts.values(), *model.assemblies.values()]
    return bool(model.frictions) or any(contact.restitution != ONE or contact.slip is not None for contact in contacts)


def _turns_direction(model: Model, contact: Contact) -> bool:
    """Whether a contact holds its links along a direction that changes as bodies move, or with such friction."""
    elements = model.elements
    gap, coordinates = elements.expanded(contact.gap), {*elements.statement.coordinates}
    slopes = [derivative(gap, {name: ONE}) for name in free_names(gap) & coordinates]
    slips = [] if contact.slip is None else [elements.expanded(contact.slip)]
    rubs = [elements.expanded(tree) for tree in (contact.friction, contact.static) if tree is not None]
    moving = coordinates | set(map(velocity, coordinates))
    changing = set[str]().union(*map(free_names, (*slopes, *slips))) & coordinates
    return bool(changing or set[str]().union(*map(free_names, rubs)) & moving)


def _among(names: set[str], blocks: Blocks) -> set[str]:
    """Return which names are those of blocks or of their elements, of which none is made."""
    return {name for name in names if blocks.find_offset(name) is not None}


def _names_read(model: Model, tree: Node | Function) -> set[str]:
    """Return the names of quantities that an expression or a function reads, also through drives."""
    if isinstance(tree, Function):
        return model.elements.reads(tree)
    names = free_names(model.expanded(tree))
    arguments = (drive.argument for name, drive in model.statement.drives.items() if name in names)
    return names.union(*(free_names(model.expanded(argument)) for argument in arguments))


def _list_names(names: set[str]) -> str:
    """List names in the order of their letters, then of their numbers."""
    parts = {name: re.split(r"(\d+)", name) for name in names}
    return first_names(
        sorted(names, key=lambda name: [int(part) if i % 2 else part for i, part in enumerate(parts[name])])
    )

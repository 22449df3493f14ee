"""Traits of a model that a method may refuse, each with the term responsible."""

from __future__ import annotations

from enum import StrEnum
from functools import lru_cache
from typing import TYPE_CHECKING

from xdynamics.expressions import Node, free_names
from xdynamics.model.controllers import held
from xdynamics.model.parts import Function
from xdynamics.model.reactions import NORMAL, reactions
from xdynamics.model.whole import acting, has_wholes, written_out
from xdynamics.schema import velocity

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


@lru_cache(maxsize=64)
def traits_of(model: Model) -> dict[Trait, str]:
    """Return the traits of a model, each with a phrase that says where."""
    traits: dict[Trait, str] = {}
    if not model.coordinates:
        traits[Trait.NO_COORDINATES] = "the model has first-order states only"
    owners = {
        Trait.PYTHON_FORCES: [f"function {', '.join(item.name for item in model.python_forces)}"]
        * bool(model.python_forces),
        Trait.CONTACTS: [item.owner for item in reactions(model)],
        Trait.CONSTRAINTS: [*model.shaped.constraints],
    }
    traits |= {trait: ", ".join(names) for trait, names in owners.items() if names}
    asked, rates = _right_hand_side(model), bool(model.states)
    # names of elements are many, and made where something reads them
    coordinates = set(model.coordinates) if asked or rates else set[str]()
    kept = held(model.controllers, model.time_unit)  # constant between ticks, as parameters are
    velocities, states = set(map(velocity, coordinates)), set(model.states) - kept.keys()
    for label, names_read in asked:
        if fault := names_read & velocities:
            traits.setdefault(Trait.VELOCITY_DEPENDENT, f"{label} depends on {_listed(fault)}")
        if fault := names_read & states:
            traits.setdefault(Trait.COUPLED_STATES, f"{label} depends on the state {_listed(fault)}")
    if model.mass_is_full:
        for (i, j), entry in model.statement.mass_entries.items():
            if fault := model.reads(entry) & set(model.coordinates):
                traits.setdefault(Trait.COUPLED_MASS, f"mass entry ({i + 1}, {j + 1}) depends on {_listed(fault)}")
    moved = velocities | coordinates | states
    for name in model.states:
        if Trait.COUPLED_STATES in traits:  # the first is told; a field has a rate for each of its elements
            break
        if fault := model.reads(model.states[name].rate) & moved:
            traits[Trait.COUPLED_STATES] = f"the rate of '{name}' depends on {_listed(fault)}"
    return traits


def _right_hand_side(model: Model) -> list[tuple[str, set[str]]]:
    """Return every force component, mass entry and reaction, with the names that it reads.

    Of a model with dimensions, terms that read positions and numbers alone are left out before their elements are made.
    """
    wholes = acting(model) if model.shapes.dims else {}
    apart = {term for term, parts in wholes.items() if all(_is_plain(model, part) for part in parts.values())}
    forces = [
        (f"force '{term}' of '{coordinate}'", model.reads(expression))
        for term, components in model.force_components.items()
        if term not in apart
        for coordinate, expression in components.items()
    ]
    shaped = model.shaped.mass if has_wholes(model) else ()
    plain = bool(shaped) and all(_is_plain(model, row[i]) for i, row in enumerate(shaped))
    entries = () if plain else model.statement.mass_entries.values()
    masses = [("the mass", model.reads(entry)) for entry in entries]
    pressed = [
        (
            f"'{reaction.name}'",
            set().union(*(model.reads(tree) for tree in (*reaction.row.values(), reaction.bias, *sizes))),
        )
        for reaction in reactions(model)
        for sizes in [() if reaction.sort == NORMAL else (reaction.size, reaction.most)]
    ]
    return forces + masses + pressed


def _is_plain(model: Model, whole: Node | Function) -> bool:
    """Whether a force with dimensions reads no velocity, state or drive."""
    if isinstance(whole, Function):
        return False
    velocities = set(map(velocity, model.shaped.coordinates))
    return not free_names(written_out(model, whole)) & {*velocities, *model.shaped.states, *model.shaped.drives}


def _listed(names: set[str]) -> str:
    return ", ".join(sorted(names))

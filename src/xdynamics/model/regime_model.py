"""A model on the sides of its switches, and what its forces take from the march."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

from xdynamics.expressions import Node
from xdynamics.model.elementwise import Diagonal
from xdynamics.model.kinks import on_sides
from xdynamics.model.model import Model
from xdynamics.model.model_trees import BY_NAME
from xdynamics.model.parts import Contact, Function
from xdynamics.model.statement import Statement
from xdynamics.model.switches import (
    LOCATED,
    LOCATED_EVERYWHERE,
    STEPPED_OVER,
    Switch,
    borders,
    bounds_of_friction,
    owner_of_masses,
    switch_side,
    watched_switches,
)
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.shapes.naming import split_element_name
from xdynamics.units import NONE


class RegimeModel(Model):
    """A model on the sides of its switches: its forces take the side of each switch from the march.

    Up to the very end of a step that ends at a switch they are those of the side that the motion came from, and after
    it those of the other side.

    Parameters
    ----------
    plain : Model
    switches : tuple of Switch
    located : {"located", "located everywhere"}
        Whether switches are watched where they have an effect, or also elsewhere.
    slides : bool
        Whether the motion may slide along them; see `model.sliding`.
    """

    def __init__(self, plain: Model, switches: tuple[Switch, ...], located: str, *, slides: bool = False) -> None:
        # what the plain model has cached under these names would hide the properties of this class
        replaced_names = ("digest", "form", "force_components", "elements")
        self.__dict__.update({name: value for name, value in vars(plain).items() if name not in replaced_names})
        self.plain, self.switches, self.located, self.slides = plain, switches, located, slides
        if plain.shapes.dims:  # whose elements have sides
            return
        written = plain.statement
        changes: dict[str, Any] = {
            "states": {
                name: replace(
                    part,
                    rate=self._one_sided_tree(name, part.rate),
                    acting={term: self._one_sided_tree(name, tree) for term, tree in part.acting.items()},
                )
                for name, part in written.states.items()
            },
            "mass": self._one_sided_masses(),
            "frictions": {
                name: replace(
                    part,
                    kinetic=self._one_sided_tree(name, part.kinetic),
                    static=self._one_sided_tree(name, part.static),
                )
                for name, part in written.frictions.items()
            },
            "contacts": {name: self._one_sided_contact(name, part) for name, part in written.contacts.items()},
        }
        self.statement = replace(written, **changes)
        if plain.elements is plain:
            self._element_statement = self.statement
        self.__dict__.update({name: part for name, part in changes.items() if name not in BY_NAME})
        checked_owners = {
            owner_of_masses(plain),
            *bounds_of_friction(plain),
        }  # whose trees have their units looked at again
        if any(switch.owner in checked_owners for switch in switches):
            sides = {switch_side(i): NONE for i, switch in enumerate(switches) if not switch.drive}
            self.dimensions = plain.dimensions | sides

    @cached_property
    def elements(self) -> Model:
        """The model of its elements on the sides of their switches."""
        is_single = self.plain.elements is self.plain
        return self if is_single else RegimeModel(self.plain.elements, self.switches, self.located, slides=self.slides)

    def replace(self, **sections: Mapping[str, Any] | str) -> Model:
        """Return the plain model with some entries replaced; see `Model.replace`."""
        return self.plain.replace(**sections)

    def with_statement(self, statement: Statement) -> Model:
        """Return the plain model of another statement, whose rates stay; see `Model.with_statement`."""
        plain = self.plain.statement
        one_sided = ("states", "mass", "frictions", "contacts")
        return self.plain.with_statement(replace(statement, **{name: getattr(plain, name) for name in one_sided}))

    @cached_property
    def digest(self) -> str:
        """The digest of the plain model, and where its switches are located."""
        return f"{self.plain.digest} {self.located}{self._slides_text}"

    @property
    def _slides_text(self) -> str:
        return " or slid along" if self.slides else ""

    @cached_property
    def form(self) -> str:
        """The form of the plain model, and where its switches are located: they are other programs."""
        return f"{self.plain.form}\n# switches: {self.located}{self._slides_text}\n"

    @cached_property
    def force_components(self) -> Mapping[str, Mapping[str, Node | Function]]:
        """The components of every force term, in which sides of switches replace signs and comparisons."""
        terms = self.plain.force_components
        return {
            term: {
                name: component if isinstance(component, Function) else self._one_sided_tree(term, component)
                for name, component in components.items()
            }
            for term, components in terms.items()
        }

    def _one_sided_masses(self) -> Sequence[tuple[Node, ...]]:
        """Return the mass matrix, in which sides of switches replace signs and comparisons."""
        mass, owner = self.plain.statement.mass, owner_of_masses(self.plain)
        if not any(switch.owner == owner and not switch.drive for switch in self.switches):
            return mass
        if isinstance(mass, Diagonal):
            return Diagonal(
                mass.names,
                {name: self._one_sided_tree(owner, mass.diagonal_entry(i)) for i, name in enumerate(mass.names)},
            )
        return tuple(tuple(self._one_sided_tree(owner, entry) for entry in row) for row in mass)

    def _one_sided_contact(self, name: str, contact: Contact) -> Contact:
        """Return a contact whose friction has the sides of switches."""
        if contact.friction is None or contact.static is None:
            return contact
        friction, static = (self._one_sided_tree(name, tree) for tree in (contact.friction, contact.static))
        return replace(contact, friction=friction, static=static)

    def _one_sided_tree(self, owner: str, tree: Node) -> Node:
        sides = {
            switch.function: switch_side(i)
            for i, switch in enumerate(self.switches)
            if switch.owner == split_element_name(owner)[0] and not switch.drive
        }
        return on_sides(self.plain.expanded(tree), sides) if sides else tree


@lru_cache(maxsize=64)
def regime_model(model: Model, located: str = LOCATED, slides: bool = False) -> Model:  # noqa: FBT001, FBT002 - cached
    """Return a model on the sides of its switches; the model itself if it has none, or they are stepped over.

    Regimes have sides, too, where the motion may slide between them.
    """
    watched = () if located == STEPPED_OVER else watched_switches(model)
    has_sides = watched or (slides and model.regimes and not model.shapes.dims)
    if not has_sides or isinstance(model, RegimeModel):
        return model
    return RegimeModel(model, watched, LOCATED_EVERYWHERE if located == LOCATED_EVERYWHERE else LOCATED, slides=slides)


def switch_inputs(model: Model) -> tuple[str, ...]:
    """Name the numbers that forces take from the march: the side of each switch, or the next points of its table."""
    groups = [
        borders(switch.drive) if switch.drive else (switch_side(i),) for i, switch in enumerate(watched_by(model))
    ]
    return tuple(name for names in groups for name in names)


def watched_by(model: Model) -> tuple[Switch, ...]:
    """Return the switches whose sides the forces of a model take from the march: none, unless it is a `RegimeModel`."""
    return model.switches if isinstance(model, RegimeModel) else ()

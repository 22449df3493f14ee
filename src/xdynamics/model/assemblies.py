"""Contacts of many bodies: what the gap of a link reads, and where each link of an assembly has it.

A contact over a dimension or a relation states one gap for all its links. Its first link is the pattern. The numbers
that the pattern reads are `PatternInput`s, each of an element that all links share, or that follows the link or one of
its two ends.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import Name, Node, expand, free_names
from xdynamics.expressions.calculus import ONE
from xdynamics.faults import InputError
from xdynamics.model.elementwise import Diagonal, Lazy
from xdynamics.model.model import Model
from xdynamics.model.parts import Contact, Coordinate, Event
from xdynamics.model.statement import Statement
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.schema import velocity
from xdynamics.shapes import Relation, Shapes, at_element
from xdynamics.shapes.naming import split_element_name
from xdynamics.shapes.trees import expand_definitions
from xdynamics.units import Quantity

IntArray = NDArray[np.int64]
FIRST, SECOND, LINK, FIXED = "first", "second", "link", "fixed"  # what the element that a leaf is of follows
PATTERN = "pattern"  # the contact, or the event, of the model of one link
MAX_SIMULTANEOUS = 4096  # links that may be struck at one time
EXAMINED = 5  # links whose gaps are compared with the pattern


class PatternInput(NamedTuple):
    """A number that the gap of a link reads.

    Attributes
    ----------
    name : str
        Of the element that the first link reads.
    quantity : str
    index_sources : tuple of (str, str or int)
        For every dimension of the quantity `FIRST` or `SECOND` and the relation, `LINK` and the dimension of the
        contact, or `FIXED` and the number of the element.
    """

    name: str
    quantity: str
    index_sources: tuple[tuple[str, str | int], ...]

    @property
    def end(self) -> str:
        """The end of a link that the number belongs to; `FIRST` where there is but one body."""
        return SECOND if any(follows == SECOND for follows, _ in self.index_sources) else FIRST


@dataclass(frozen=True, eq=False)
class Assembly:
    """One contact of many links.

    Attributes
    ----------
    name : str
    contact : Contact
        Of its first link.
    pattern_inputs : tuple of Leaf
        Coordinates first.
    coordinates : int
        How many of the leaves are coordinates.
    paired : bool
        Whether its links are all pairs of elements of one dimension, each of which every leaf follows by one end.
    """

    name: str
    contact: Contact
    pattern_inputs: tuple[PatternInput, ...]
    coordinates: int
    paired: bool
    model: Model

    @property
    def dims(self) -> tuple[str, ...]:
        """The dimensions of the contact."""
        return self.model.shapes.dims.get(self.name, ())

    @cached_property
    def links(self) -> int:
        """How many links there are."""
        return int(np.prod(self.model.shapes.shape(self.dims), dtype=int))

    def elements(
        self, pattern_input: PatternInput, first: IntArray, second: IntArray, numbers: Mapping[str, IntArray]
    ) -> IntArray:
        """Return the number of the element, among all of its quantity, that each link reads.

        Parameters
        ----------
        pattern_input : Leaf
        first, second : ndarray of int64, shape (n,)
            The ends of each link.
        numbers : mapping of str to ndarray of int64
            The number of each link along every dimension of the contact.
        """
        shape = self.model.shapes.shape(self.model.shapes.dims.get(pattern_input.quantity, ()))
        size = len(first)
        element_numbers = np.zeros(size, np.int64)
        for (follows, target), length in zip(pattern_input.index_sources, shape, strict=True):
            position = {FIRST: first, SECOND: second}.get(follows)
            if position is None:
                position = numbers[str(target)] if follows == LINK else np.full(size, int(target), np.int64)
            element_numbers = element_numbers * length + position
        return element_numbers

    def numbers(self, links: IntArray) -> dict[str, IntArray]:
        """Return the numbers of links along every dimension of the contact."""
        shape = self.model.shapes.shape(self.dims)
        return dict(zip(self.dims, map(np.asarray, np.unravel_index(links, shape)), strict=True)) if shape else {}

    def ends(self, links: IntArray) -> tuple[IntArray, IntArray]:
        """Return the elements at both ends of links; zeros where there is no relation."""
        relation, numbers = self.relation, self.numbers(links)
        if relation is None:
            return np.zeros_like(links), np.zeros_like(links)
        return relation.first[numbers[relation.name]], relation.second[numbers[relation.name]]

    def label(self, link: int) -> str:
        """Name the elements of a link as people write them: ``disc 3``, ``disc 3 and 5``."""
        shapes, relation, numbers = self.model.shapes, self.relation, self.numbers(np.array([link]))
        words = []
        if relation is not None:
            first, second = self.ends(np.array([link]))
            first_label = shapes.extent(relation.source).label(int(first[0]))
            words.append(f"{first_label} and {shapes.extent(relation.target).label(int(second[0]))}")
        words += [shapes.extent(dim).label(int(n[0])) for dim, n in numbers.items() if dim not in shapes.relations]
        dims = relation.source if relation is not None else " ".join(self.dims)
        return f"{dims} {', '.join(words)}"

    @property
    def relation(self) -> Relation | None:
        """The relation that its links are of, if any."""
        link_relations = [self.model.shapes.relations[dim] for dim in self.dims if dim in self.model.shapes.relations]
        return link_relations[0] if link_relations else None

    @cached_property
    def pattern(self) -> tuple[Model, Model]:
        """Models of one link, whose coordinates are the leaves: with its gap as an event, and as a contact."""
        old = self.model.elements
        names = {item.name: Name(pattern_input_name(k)) for k, item in enumerate(self.pattern_inputs)}
        units = old.statement.coordinates | old.statement.parameters
        dimensions = {name: old.dimensions[name] for name in (*old.statement.parameters,) if name not in names}
        coordinates, masses, initial = {}, {}, {"t": old.statement.initial["t"]}
        for k, pattern_input in enumerate(self.pattern_inputs):
            input_name, part = pattern_input_name(k), units[pattern_input.name]
            unit = part.unit if isinstance(part, Coordinate) else part.quantity.unit
            coordinates[input_name] = Coordinate(unit)
            initial |= {input_name: Quantity(0.0, unit), velocity(input_name): Quantity(0.0, unit.per(old.time_unit))}
            dimensions |= {input_name: unit.dimension, velocity(input_name): unit.per(old.time_unit).dimension}
            coordinate_index = [*old.statement.coordinates].index(pattern_input.name) if k < self.coordinates else -1
            masses[input_name] = (
                expand(old.expanded(old.mass[coordinate_index][coordinate_index]), names)
                if coordinate_index >= 0
                else ONE
            )
        moving = {
            velocity(pattern_input.name): Name(velocity(pattern_input_name(k)))
            for k, pattern_input in enumerate(self.pattern_inputs)
        }
        trees: dict[str, Any] = {
            key: expand(old.expanded(tree), names | moving) for key, tree in _contact_trees(self.contact).items()
        }
        contact = replace(self.contact, **trees)
        event = Event(contact.gap, time_tolerance=contact.time_tolerance)
        bare = Statement(
            old.name,
            old.description,
            coordinates,
            {name: part for name, part in old.statement.parameters.items() if name in dimensions},
            Diagonal([*coordinates], Lazy[Node](masses)),
            initial=initial,
            time_unit=old.time_unit,
        )
        all_dimensions = old.dimensions | dimensions
        return (
            Model.of_numbers(replace(bare, events={PATTERN: event}), all_dimensions),
            Model.of_numbers(replace(bare, contacts={PATTERN: contact}), all_dimensions),
        )


def pattern_input_name(k: int) -> str:
    """Name the coordinate that stands for a leaf."""
    return f"leaf{k}"


@lru_cache(maxsize=16)
def assemblies(model: Model) -> tuple[Assembly, ...]:
    """Return the contacts of many bodies.

    Raises
    ------
    InputError
        If a gap reads elements that are not those of its link.
    """
    every = tuple(_assembly(model, name, contact) for name, contact in model.assemblies.items())
    for assembly in every:
        _compare(assembly)
    return every


@lru_cache(maxsize=16)
def written_assemblies(model: Model) -> tuple[Assembly, ...]:
    """Return all contacts of a model that has one over a relation, where its few links are written out one by one."""
    shapes, declared = model.shapes, model.statement.contacts
    dims = {dim for name in declared for dim in shapes.dims.get(name, ())}
    if not model.elements.contacts or not dims & shapes.relations.keys():
        return ()
    return tuple(_assembly(model, name, model.elements.contacts[shapes.first(name)]) for name in declared)


def _assembly(model: Model, name: str, contact: Contact) -> Assembly:
    shapes, dims = model.shapes, model.shapes.dims.get(name, ())
    elements, with_elements = model.elements, _element_quantities(model)
    coordinates = elements.statement.coordinates
    coordinate_by_velocity = {velocity(name): name for name in coordinates}
    names_read = set[str]().union(*(free_names(elements.expanded(tree)) for tree in _contact_trees(contact).values()))
    read = sorted({coordinate_by_velocity.get(name, name) for name in names_read} & with_elements)
    masses = [elements.mass[i][i] for i, coordinate in enumerate(coordinates) if coordinate in read]
    read = sorted({*read, *set[str]().union(*(free_names(elements.expanded(tree)) for tree in masses)) & with_elements})
    ordered = [coordinate for coordinate in coordinates if coordinate in read]
    ordered += [name for name in read if name not in coordinates]
    pattern_inputs = tuple(_pattern_input(name, dims, shapes) for name in ordered)
    relation = shapes.relations.get(dims[0]) if len(dims) == 1 else None
    paired = (
        relation is not None
        and _is_every_two(relation, shapes)
        and all(follows != LINK for pattern_input in pattern_inputs for follows, _ in pattern_input.index_sources)
    )
    number = sum(item.name in coordinates for item in pattern_inputs)
    return Assembly(name, contact, pattern_inputs, number, paired, model)


def _contact_trees(contact: Contact) -> dict[str, Node]:
    """Return the expressions of a contact that each of its links has with its own elements."""
    every = {key: getattr(contact, key) for key in ("gap", "restitution", "slip", "friction", "static")}
    return {key: tree for key, tree in every.items() if tree is not None}


def _element_quantities(model: Model) -> set[str]:
    """Return the coordinates, and the parameters that are elements."""
    return {
        *model.elements.statement.coordinates,
        *(name for name in model.elements.statement.parameters if split_element_name(name)[1]),
    }


def _pattern_input(name: str, dims: tuple[str, ...], shapes: Shapes) -> PatternInput:
    quantity, labels = split_element_name(name)
    index_sources: list[tuple[str, str | int]] = []
    for dim, label in zip(shapes.dims.get(quantity, ()), labels, strict=True):
        number = shapes.extent(dim).number(int(label) if label.isdigit() else label)
        relations = [shapes.relations[dim] for dim in dims if dim in shapes.relations]
        if dim in dims and number == 0:
            index_sources.append((LINK, dim))
        elif linking_relation := next(
            (relation for relation in relations if relation.source == dim and relation.first[0] == number), None
        ):
            index_sources.append((FIRST, linking_relation.name))
        elif linking_relation := next(
            (relation for relation in relations if relation.target == dim and relation.second[0] == number), None
        ):
            index_sources.append((SECOND, linking_relation.name))
        else:
            index_sources.append((FIXED, number))
    return PatternInput(name, quantity, tuple(index_sources))


def _compare(assembly: Assembly) -> None:
    """Refuse a gap that is not that of the first link with other elements."""
    model, shapes = assembly.model, assembly.model.shapes
    declared, statement = model.statement.contacts[assembly.name], model.statement
    pattern = {
        pattern_input.name: Name(pattern_input_name(k)) for k, pattern_input in enumerate(assembly.pattern_inputs)
    }
    pattern |= {
        velocity(pattern_input.name): Name(velocity(pattern_input_name(k)))
        for k, pattern_input in enumerate(assembly.pattern_inputs)
    }
    pattern_trees = _contact_trees(assembly.contact)
    compared_links = np.unique(np.linspace(0, assembly.links - 1, EXAMINED).astype(np.int64))
    numbers, (first, second) = assembly.numbers(compared_links), assembly.ends(compared_links)
    names = {pattern_input: shapes.elements(pattern_input.quantity) for pattern_input in assembly.pattern_inputs}
    places = {
        pattern_input: assembly.elements(pattern_input, first, second, numbers)
        for pattern_input in assembly.pattern_inputs
    }
    for i in range(len(compared_links)):
        renamed = {
            names[pattern_input][places[pattern_input][i]]: Name(pattern_input_name(k))
            for k, pattern_input in enumerate(assembly.pattern_inputs)
        }
        renamed |= {velocity(name): Name(velocity(tree.name)) for name, tree in [*renamed.items()]}
        _compare_masses(
            assembly,
            {
                pattern_input: names[pattern_input][places[pattern_input][i]]
                for pattern_input in assembly.pattern_inputs
            },
            renamed,
            pattern,
        )
        indices = {dim: int(numbers[dim][i]) for dim in assembly.dims}
        for key, tree in _contact_trees(declared).items():
            link_tree = at_element(expand_definitions(tree, statement.definitions, shapes), indices, shapes)
            if expand(link_tree, renamed) != expand(model.elements.expanded(pattern_trees[key]), pattern):
                raise InputError(
                    f"contact '{assembly.name}' reads something else at each of its {assembly.links} links than values"
                    " of its own elements; of many links all read the same, so write what differs as a parameter with"
                    " that dimension"
                )


def _compare_masses(
    assembly: Assembly, elements: Mapping[PatternInput, str], renamed: Mapping[str, Node], pattern: Mapping[str, Node]
) -> None:
    """Refuse masses at a link that are not those of the first link with other elements."""
    model = assembly.model
    coordinate_indices = {
        name: coordinate_index for coordinate_index, name in enumerate(model.elements.statement.coordinates)
    }
    for pattern_input in assembly.pattern_inputs[: assembly.coordinates]:
        link_mass, pattern_mass = (
            model.elements.mass[coordinate_index][coordinate_index]
            for coordinate_index in (
                coordinate_indices[elements[pattern_input]],
                coordinate_indices[pattern_input.name],
            )
        )
        if expand(model.elements.expanded(link_mass), renamed) != expand(
            model.elements.expanded(pattern_mass), pattern
        ):
            raise InputError(
                f"contact '{assembly.name}' has {assembly.links} links, and the mass of '{pattern_input.quantity}' differs from"
                " element to element by more than values of parameters, as where it is written with index(…): make it a"
                " parameter with that dimension"
            )


def _is_every_two(relation: Relation, shapes: Shapes) -> bool:
    size = shapes.extent(relation.source).size
    if relation.source != relation.target or relation.size != size * (size - 1) // 2:
        return False
    first, second = np.triu_indices(size, 1)
    return bool((relation.first == first).all() and (relation.second == second).all())


def max_simultaneous(model: Model) -> int:
    """Return how many links may be struck at one time."""
    return min(MAX_SIMULTANEOUS, sum(assembly.links for assembly in assemblies(model)))


def slots_of(model: Model, coordinates: Sequence[str]) -> tuple[IntArray, int]:
    """Return the slot of the impulse along each coordinate, and how many slots a body has.

    A body is what links are between: the coordinates of all bodies share slots.
    """
    slots, width = np.zeros(len(coordinates) if assemblies(model) else 0, np.int64), 0
    for quantity, body in impulse_quantities(assemblies(model)).items():
        shapes, dims = model.shapes, model.shapes.dims.get(quantity, ())
        remaining_dims = tuple(dim for dim in dims if dim != body)
        numbers = np.arange(int(np.prod(shapes.shape(remaining_dims), dtype=int))).reshape(shapes.shape(remaining_dims))
        coordinate_index = [*coordinates].index(shapes.first(quantity))
        body_axes = [dims.index(body)] if dims else []
        spread = np.broadcast_to(np.expand_dims(numbers, body_axes), shapes.shape(dims)).ravel()
        slots[coordinate_index : coordinate_index + spread.size] = width + spread
        width += numbers.size
    return slots, width


def impulse_quantities(every: Iterable[Assembly]) -> dict[str, str]:
    """Return the quantities along which impulses of links are, each with the dimension that links are between, if any."""
    body_dims: dict[str, str] = {}
    for assembly in every:
        for pattern_input in assembly.pattern_inputs[: assembly.coordinates]:
            dims = assembly.model.shapes.dims.get(pattern_input.quantity, ())
            ends = [
                dim
                for dim, (follows, _) in zip(dims, pattern_input.index_sources, strict=True)
                if follows in (FIRST, SECOND)
            ]
            links = [
                dim for dim, (follows, _) in zip(dims, pattern_input.index_sources, strict=True) if follows == LINK
            ]
            fixed = [
                dim for dim, (follows, _) in zip(dims, pattern_input.index_sources, strict=True) if follows == FIXED
            ]
            body_dims.setdefault(pattern_input.quantity, next(iter(ends + links + fixed), ""))
    return body_dims

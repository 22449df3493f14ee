"""States after the events of a refinement: of the element that an event is of, and of all elements."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from xdynamics.schema import OCCURRENCE, at_event
from xdynamics.shapes import Extent, Shapes

MOST_NUMBERS = 1_000_000  # of one quantity over levels, occurrences, elements with events and elements with states

AFTER = OWN_AFTER, ALL_AFTER = "after_", "all_after_"  # how their names begin


@dataclass(frozen=True)
class StateAfter:
    """A quantity, or one element of it, after the events of a detector and of all elements that this has.

    Attributes
    ----------
    detector, state : str
    detector_dims, dims : tuple of str
        Dimensions of the detector, and of the quantity; the state of a single element has none.
    element : mapping of str to int
        The place of a single element; empty for a quantity.
    every : bool
        Whether there is a value for every element at the event of each; else only for the element that the event is of.
    """

    detector: str
    state: str
    detector_dims: tuple[str, ...]
    dims: tuple[str, ...]
    element: Mapping[str, int]
    every: bool = False

    @property
    def name(self) -> str:
        """The name of the number that is compared."""
        return f"{ALL_AFTER if self.every else OWN_AFTER}{self.detector}_{self.state}"

    @property
    def long_name(self) -> str:
        """What it is, in words."""
        return f"{self.state} after {f'the event {self.detector} of each element' if self.every else self.detector}"

    @property
    def shared(self) -> tuple[str, ...]:
        """Dimensions that the detector has and the quantity too."""
        return tuple(dim for dim in self.detector_dims if dim in self.dims or dim in self.element)

    @property
    def of_events(self) -> tuple[str, ...]:
        """Dimensions of the detector that the number has too."""
        return tuple(dim for dim in self.detector_dims if self.every or dim not in self.shared)

    @property
    def places(self) -> tuple[str, ...]:
        """The dimensions of the number: a shared one of the event's has the name that a record has for it."""
        event_dims = (at_event(dim) if dim in self.shared else dim for dim in self.of_events)
        return (OCCURRENCE, *event_dims, *self.dims)

    def has_value_at(self, event: Mapping[str, int]) -> bool:
        """Whether the number has a value at the event of an element."""
        return self.every or all(self.element.get(dim, number) == number for dim, number in event.items())

    def selection(self, event: Mapping[str, int]) -> dict[str, int]:
        """Return which elements of the quantity have a value at the event of an element; empty for all of them."""
        return {} if self.every else {dim: number for dim, number in event.items() if dim in self.dims}

    def index(self, event: Mapping[str, int]) -> tuple[Any, ...]:
        """Return where their values are among those of one occurrence."""
        selected = self.selection(event)
        return (*(event[dim] for dim in self.of_events), *(selected.get(dim, slice(None)) for dim in self.dims))

    def fits(self, shapes: Shapes, levels: int, occurrences: int) -> bool:
        """Whether the number has few enough values over all levels; `shapes` with the dimensions of events."""
        return levels * occurrences * math.prod(shapes.shape(self.places[1:])) <= MOST_NUMBERS


def with_event_dims(shapes: Shapes, states: list[StateAfter]) -> Shapes:
    """Return the shapes of a model with those of states after events: along a shared dimension events have their own."""
    shared = [dim for dim in shapes.extents if any(state.every and dim in state.shared for state in states)]
    event_extents = {at_event(dim): replace(shapes.extents[dim], name=at_event(dim)) for dim in shared}
    dims = {state.name: state.places[1:] for state in states if not state.element}
    return (
        replace(shapes, extents={**event_extents, **shapes.extents}, dims={**shapes.dims, **dims}) if states else shapes
    )


def words_of_left_out(left: list[StateAfter], shapes: Shapes, levels: int, occurrences: int) -> str:
    """Say which states after events are left out, why, and what to ask for instead; nothing where none are."""
    if not left:
        return ""
    first = left[0]
    extents = [shapes.extent(dim) for dim in first.places[1:]]
    return (
        f"{', '.join(state.name for state in left)}: {levels} levels, {occurrences} of each event,"
        f" {' x '.join(map(_extent_text, extents))}: {levels * occurrences * math.prod(extent.size for extent in extents)}"
        f" numbers, more than {MOST_NUMBERS}; compare single elements, like observables=['{_example(first, shapes)}'],"
        " or fewer occurrences"
    )


def _extent_text(extent: Extent) -> str:
    return f"{extent.size} {extent.name}"


def _example(state: StateAfter, shapes: Shapes) -> str:
    labels = ", ".join(shapes.extent(dim).label(0) for dim in state.dims)
    return f"{state.state}[{labels}]" if labels else state.state

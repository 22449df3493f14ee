"""The numbers that a refinement compares: names, units and words before a march, verdicts and limits after it.

For each number the Dataset has variables for differences, orders, gates, verdict, limit and uncertainty.

A state after an event is that of the element to which the event belongs, or that of all elements.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import record, schema
from xdynamics.evidence.evidence_dataset import attrs_of
from xdynamics.evidence.observables import is_observable
from xdynamics.evidence.refining.convergence import UNCERTAINTY_RULES, VERDICTS, Judged, judge, observed_orders
from xdynamics.evidence.refining.levels import RTOLS, TIME_TOLERANCES, Levels
from xdynamics.march import March
from xdynamics.march.configuration import unthinned_settings_for
from xdynamics.model.detectors import labels
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.shapes import Extent, Shapes
from xdynamics.shapes.blocks import Block
from xdynamics.shapes.naming import DOT, split_element_name
from xdynamics.units import time_in

Floats = NDArray[np.float64]

GATES = ("passed", "failed")
ROLE = "refinement"
RULES = {rule: rule.replace(" ", "_").replace(":", "") for rule in UNCERTAINTY_RULES}  # by the words of their flags
RULE_WORDS = sorted(RULES.values())
RULE_NUMBERS = np.array([RULE_WORDS.index(RULES[rule]) for rule in UNCERTAINTY_RULES], np.int8)

Subject = tuple[str, str, str, tuple[str, ...]]  # name, units, long name and dimensions of a number


@dataclass(frozen=True)
class TrackedValue:
    """One quantity of every level, at several places: a number, or with dimensions those of all elements.

    Attributes
    ----------
    name, units, long_name : str
    dims : tuple of str
        Of the places, then of the quantity; none for one number per run.
    values, errors : ndarray, shape (places, ..., levels)
        The values, and their errors by interpolation or location.
    rounding, event_errors : ndarray, shape (places, ...)
        Errors of the finest values by rounding, and by the uncertain location of events before.
    kinks : ndarray, shape (places,) or (places, ...)
        The order left by switches that steps went over, inf where there are none.
    scale : float, or ndarray, shape (...)
        By which differences are divided: a size of the quantity, of every element its own, that is never zero.
    """

    name: str
    units: str
    long_name: str
    dims: tuple[str, ...]
    values: Floats
    errors: Floats
    rounding: Floats
    event_errors: Floats
    scale: Any
    kinks: Floats | None = None

    @classmethod
    def blank(cls, subject: Subject, places: int, levels: int, shape: tuple[int, ...] = ()) -> TrackedValue:
        """Return a quantity before anything is marched: everything but its values, which are nan."""
        nothing = np.full((places, *shape, levels), np.nan)
        return cls(*subject, nothing, nothing, nothing[..., 0], nothing[..., 0], np.full(shape, np.nan))

    def element(self, name: str, element_index: tuple[int, ...]) -> TrackedValue:
        """Return one element of a quantity, as a number of its own."""
        index: Any = (slice(None), *element_index)

        return replace(
            self,
            name=name,
            dims=self.dims[:1],
            values=self.values[index],
            errors=self.errors[index],
            rounding=self.rounding[index],
            event_errors=self.event_errors[index],
            scale=float(self.scale[element_index]),
        )

    @property
    def changes(self) -> Floats:
        """Difference to the next finer level; nan for the finest, shape (places, ..., levels)."""
        differences = np.full(self.values.shape, np.nan)
        differences[..., :-1] = np.diff(self.values, axis=-1)
        return differences


def family(number: TrackedValue, levels: Levels, accepted: int, estimated: float = 0.0) -> dict[str, Any]:
    """Return every variable about one number, ready for a Dataset.

    `accepted` counts the finest level's steps, and `estimated` is what these estimate to be off together, as a part of
    the number's size, where something else than the tolerance set them.
    """
    name, units, changes = number.name, number.units, number.changes
    dims = (schema.LEVEL, *number.dims)

    def levels_first(values: Floats) -> Floats:
        """Return values with levels first; without places, levels only."""
        return np.moveaxis(values, -1, 0) if number.dims else values[0]

    # the finest level has no difference of its own: its gate uses the last one
    last = np.abs(np.concatenate([changes[..., :-1], changes[..., -2:-1]], axis=-1))
    # negated, so that nothing passes with nan
    gate = (~(number.errors <= last)).astype(np.int8)
    size = schema.scale_name("difference", name)
    variables: dict[str, Any] = {
        name: (dims, levels_first(number.values), attrs_of(units, number.long_name, ROLE)),
        f"difference_{name}": (
            dims,
            levels_first(changes),
            attrs_of(units, f"{name} at the next finer level minus {name} at this level", ROLE),
        ),
        f"scaled_difference_{name}": (
            dims,
            levels_first(changes / np.asarray(number.scale)[..., np.newaxis]),
            attrs_of("1", f"difference_{name} over {size}", ROLE),
        ),
        size: (
            number.dims[1:],
            np.asarray(number.scale, float),
            attrs_of(units, f"scale of difference_{name}, never zero", "scale"),
        ),
        f"interpolation_error_{name}": (
            dims,
            levels_first(number.errors),
            attrs_of(units, f"estimated error of {name} by interpolation, or by locating the event", ROLE),
        ),
        f"gate_{name}": (
            dims,
            levels_first(gate),
            attrs_of(
                "1",
                f"passed where interpolation_error_{name} is at most the difference to the next finer level",
                "flag",
            )
            | schema.flag_attributes(dict(enumerate(GATES))),
        ),
    }
    return variables | (_judgement_variables(number, levels, accepted, estimated) if levels.ordered else {})


def _judgement_variables(number: TrackedValue, levels: Levels, accepted: int, estimated: float) -> dict[str, Any]:
    """Return orders, verdicts, limits and uncertainties, where levels are numbers with which errors shrink."""
    name, units = number.name, number.units
    orders, judgement = observed_orders(number.values, levels.values), _judgement(number, levels, accepted, estimated)

    def once(values: Any, dtype: Any) -> Any:
        return number.dims, np.asarray(values if number.dims else values[0], dtype)

    return {
        f"order_{name}": (
            (schema.LEVEL, *number.dims),
            np.moveaxis(orders, -1, 0) if number.dims else orders[0],
            attrs_of(
                "1",
                f"observed order of {name}, from this level and its two neighbours; negative where differences grow",
                ROLE,
            ),
        ),
        f"verdict_{name}": (
            *once(judgement.verdict, np.int8),
            attrs_of("1", f"verdict on the convergence of {name}", "flag")
            | schema.flag_attributes(dict(enumerate(VERDICTS))),
        ),
        f"limit_{name}": (
            *once(judgement.limit, float),
            attrs_of(units, f"limit of {name} as {levels.varied.name} tends to zero", ROLE),
        ),
        f"uncertainty_{name}": (
            *once(judgement.uncertainty, float),
            attrs_of(units, f"uncertainty of {name} at the finest level, at about 95 %", ROLE),
        ),
        f"uncertainty_rule_{name}": (
            *once(RULE_NUMBERS[judgement.rule], np.int8),
            attrs_of("1", f"rule by which the uncertainty of {name} was found", "flag")
            | schema.flag_attributes(dict(enumerate(RULE_WORDS))),
        ),
    }


def _judgement(number: TrackedValue, levels: Levels, accepted: int, estimated: float) -> Judged:
    """Judge the convergence of every value of a quantity over the levels."""
    kinks = np.full(len(number.values), np.inf)
    if number.kinks is not None and levels.varied != TIME_TOLERANCES:
        kinks = number.kinks
    return judge(
        number.values,
        levels.values,
        levels.formal,
        number.rounding,
        number.errors[..., -2:].max(axis=-1),
        number.event_errors,
        smooth=levels.varied != RTOLS,
        kink=kinks.reshape(*kinks.shape, *[1] * (number.values.ndim - 1 - kinks.ndim)),
        accepted=accepted,
        order=levels.order,
        estimated=estimated * np.asarray(number.scale),
    )


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
        """The state and its event, in words."""
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
        event_dims = (schema.at_event(dim) if dim in self.shared else dim for dim in self.of_events)
        return (schema.OCCURRENCE, *event_dims, *self.dims)

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
    event_extents = {schema.at_event(dim): replace(shapes.extents[dim], name=schema.at_event(dim)) for dim in shared}
    dims = {state.name: state.places[1:] for state in states if not state.element}
    return (
        replace(shapes, extents={**event_extents, **shapes.extents}, dims={**shapes.dims, **dims}) if states else shapes
    )


def words_of_left_out(left: list[StateAfter], shapes: Shapes, levels: int, occurrences: int) -> str:
    """Describe the states after events that are left out, why, and the request for them; empty if there are none."""
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


ENERGY_RANGE, PERIOD, PHASE, EVENT_TIME = "energy_range", "period_", "phase_", "event_time_"


def crossing_level(coordinate: str) -> str:
    """Name the level whose crossings begin the cycles of a coordinate."""
    return f"crossing_level_{coordinate}"


@dataclass(frozen=True)
class StudyQuantities:
    """The numbers that a study compares, described before anything is marched.

    Attributes
    ----------
    levels : Levels
    names : tuple of str
        Observables, and numbers of whole runs.
    requested_times : times, optional
        When observables are compared; by default at the earliest end of a run.
    occurrences : int, optional
        How many occurrences of every event are compared; by default as many as the finest run has.
    defects : bool
        Whether local errors of single steps are computed.
    """

    levels: Levels
    names: tuple[str, ...]
    requested_times: Any = None
    occurrences: int | None = None
    defects: bool = False

    def __reduce__(self) -> Any:  # what is cached of a march holds addresses, and stays in its process
        return StudyQuantities, (self.levels, self.names, self.requested_times, self.occurrences, self.defects)

    @cached_property
    def march(self) -> March:
        """The march of the coarsest level, which is not begun."""
        model, value = self.levels.model_of(self.levels.values[0]), self.levels.values[0]
        return March(model, unthinned_settings_for(model, **self.levels.settings_of_level(value)))

    @cached_property
    def variables(self) -> Mapping[str, schema.Variable]:
        """The variables of a run by name."""
        return {column.variable.name: column.variable for column in record.columns(self.march)}

    def variable(self, name: str) -> schema.Variable | None:
        """Return the variable of a quantity or of one of its elements, along `step` alone; None if a run has none."""
        if name in self.variables or DOT not in name:
            return self.variables.get(name)
        quantity_variable = self.variables.get(split_element_name(name)[0])
        return (
            None
            if quantity_variable is None
            else replace(quantity_variable, name=name, dims=quantity_variable.dims[:1])
        )

    def dims(self, name: str) -> tuple[str, ...]:
        """Return the dimensions of a quantity."""
        return self.recorded(name).dims[1:]

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the lengths of a quantity's dimensions."""
        return self.levels.model.shapes.shape(self.dims(name))

    @cached_property
    def detectors(self) -> tuple[str, ...]:
        """The names of the detectors of events."""
        return tuple(labels(self.march.layout.watched))

    @cached_property
    def times(self) -> Floats | None:
        """The wanted times of comparison, s; None for the end."""
        if self.requested_times is None:
            return None
        requested = (
            [self.requested_times]
            if isinstance(self.requested_times, str | float | int)
            else list(self.requested_times)
        )
        return np.array([time_in(self.levels.model.time_unit, time, "at") for time in requested])

    @cached_property
    def observed(self) -> list[str]:
        """The names of energies and observables that are compared at times."""
        return [name for name in self.names if is_observable(self.levels.model, name)]

    @cached_property
    def cycle_numbers(self) -> list[str]:
        """The names of mean periods and phases."""
        return [name for name in self.names if name.startswith((PERIOD, PHASE))]

    @property
    def cyclic(self) -> tuple[str, ...]:
        """The coordinates of the compared cycles."""
        return tuple(dict.fromkeys(name.partition("_")[2] for name in self.cycle_numbers))

    @property
    def foreseen(self) -> bool:
        """Whether it is known where the runs are compared before they are marched, unless one of them fails."""
        events = bool(self.detectors) and (self.occurrences != 0 or self.times is None)
        return not self.cyclic and not events

    @property
    def stepped(self) -> list[str]:
        """The names of compared quantities with a local error."""
        places = {name: self.march.layout.used.find_offset(name) for name in self.names}
        return sorted(
            (name for name, position in places.items() if position is not None), key=lambda name: places[name] or 0
        )

    @cached_property
    def after_events(self) -> list[str]:
        """The names compared after events: quantities with all elements requested, otherwise single elements."""
        used = self.march.layout.used
        names = dict.fromkeys(name for name in self.names if used.find_offset(name) is not None and self.variable(name))
        whole_names = {
            block.name for block in used.blocks if block.name in names or {*block.elements()} <= names.keys()
        }
        return list(
            dict.fromkeys(
                split_element_name(name)[0] if split_element_name(name)[0] in whole_names else name for name in names
            )
        )

    @cached_property
    def states_after(self) -> dict[str, list[StateAfter]]:
        """The states that are compared after the events of each detector, of whatever size."""
        model, compared = self.levels.model, dict[str, list[StateAfter]]()
        for detector, event in {split_element_name(name)[0]: name for name in self.detectors}.items():
            # contacts of many links have dimensions, and one detector for all
            detector_dims = model.shapes.dims.get(detector, ()) if DOT in event else ()
            states = [
                StateAfter(detector, name, detector_dims, *self._dims_and_place(name)) for name in self.after_events
            ]
            compared[detector] = [
                variant
                for state in states
                for variant in (state, *([replace(state, every=True)] if state.shared else []))
            ]
        return compared

    def _dims_and_place(self, name: str) -> tuple[tuple[str, ...], dict[str, int]]:
        """Return the dimensions of an integrated quantity, or the indices of an element."""
        block = self.march.layout.used.block(name)
        return (block.dims, {}) if name == block.name else ((), block.indices_of(name))

    def compared_after(self, detector: str, occurrences: int) -> list[StateAfter]:
        """Return the states after the events of a detector that are few enough to be compared."""
        levels = len(self.levels.values)
        return [state for state in self.states_after[detector] if state.fits(self.shapes, levels, occurrences)]

    def left_out(self, detectors: Iterable[str], occurrences: int) -> str:
        """Describe the states after events that are left out because there are too many."""
        levels = len(self.levels.values)
        left = [
            state
            for detector in detectors
            for state in self.states_after[detector]
            if not state.fits(self.shapes, levels, occurrences)
        ]
        return words_of_left_out(left, self.shapes, levels, occurrences)

    @cached_property
    def shapes(self) -> Shapes:
        """The model's shapes, with those of states after events."""
        states = [state for detector_states in self.states_after.values() for state in detector_states]
        return with_event_dims(self.levels.model.shapes, states if self.occurrences != 0 else [])

    def observable(self, name: str) -> Subject:
        """Describe an observable at the times of comparison."""
        variable = self.recorded(name)
        return name, variable.units, variable.long_name, (schema.AT, *variable.dims[1:])

    def recorded(self, name: str) -> schema.Variable:
        """Return the variable of a quantity or of one of its elements that a run has."""
        variable = self.variable(name)
        assert variable is not None  # noqa: S101 - it was asked before
        return variable

    @property
    def energy_range(self) -> Subject:
        """Describe the range of the energy."""
        units = self.variables["total_energy"].units
        return ENERGY_RANGE, units, "largest minus smallest total energy over the accepted states", ()

    def cycles(self, name: str) -> Subject:
        """Describe a mean period, or a phase."""
        coordinate = name.partition("_")[2]
        level = f"{crossing_level(coordinate)} upward, a level that the finest run chose for all"
        if name.startswith(PERIOD):
            unit = self.levels.model.time_unit.text
            return name, unit, f"mean period of {coordinate}, between located crossings of {level}", ()
        return name, "rad", f"phase of {coordinate}, whole turns at located crossings of {level}", (schema.AT,)

    def event_time(self, detector: str) -> Subject:
        """Describe the times at which an event was met."""
        unit = self.levels.model.time_unit.text
        return f"{EVENT_TIME}{detector}", unit, f"time at which {detector} was met", (schema.OCCURRENCE,)

    def after_event(self, state: StateAfter) -> Subject:
        """Describe a state after an event."""
        recorded_name = (
            state.state if state.state in self.variables else self.march.layout.used.block(state.state).first
        )
        return state.name, self.recorded(recorded_name).units, state.long_name, state.places

    def event_place(self, detector: str) -> tuple[str, dict[str, int]]:
        """Return the detector and the element that an event is named by."""
        detector_name = split_element_name(detector)[0]
        return detector_name, Block.from_shapes(detector_name, "", self.levels.model.shapes).indices_of(
            detector
        ) if DOT in detector else {}

    def blank(self) -> Iterator[TrackedValue]:
        """Yield every number without its values."""
        subjects = [self.observable(name) for name in self.observed]
        subjects += [self.energy_range] if ENERGY_RANGE in self.names else []
        subjects += [self.cycles(name) for name in self.cycle_numbers]
        for detector in self.states_after if self.occurrences else ():
            subjects += [self.event_time(event) for event in self.detectors if split_element_name(event)[0] == detector]
            subjects += map(self.after_event, self.compared_after(detector, self.occurrences or 0))
        times = 1 if self.times is None else len(self.times)
        for subject in subjects:
            places = {schema.AT: times, schema.OCCURRENCE: self.occurrences or 0}
            shape = self.shapes.shape(subject[3][1:])
            yield TrackedValue.blank(
                subject, places[subject[3][0]] if subject[3] else 1, len(self.levels.values), shape
            )

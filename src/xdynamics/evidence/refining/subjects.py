"""The numbers that a refinement compares, with names, units and words, before anything is marched."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import record
from xdynamics.evidence.observables import is_observable
from xdynamics.evidence.refining.family import Subject, TrackedValue
from xdynamics.evidence.refining.levels import Levels
from xdynamics.evidence.refining.states_after import StateAfter, with_event_dims, words_of_left_out
from xdynamics.march import March
from xdynamics.march.configuration import unthinned_settings_for
from xdynamics.model.detectors import labels
from xdynamics.model.whole import is_read_by_quantity
from xdynamics.runtime.cached_properties import cached_property
from xdynamics.schema import AT, OCCURRENCE, Variable
from xdynamics.shapes import Shapes
from xdynamics.shapes.blocks import Block
from xdynamics.shapes.naming import DOT, split_element_name
from xdynamics.units import time_in

Floats = NDArray[np.float64]

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
    def variables(self) -> Mapping[str, Variable]:
        """The variables of a run by name: of quantities, or where the model is not read whole of elements."""
        columns = record.columns if is_read_by_quantity(self.levels.model) else record.element_columns
        return {column.variable.name: column.variable for column in columns(self.march)}

    def variable(self, name: str) -> Variable | None:
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
        """The names of what events are located by."""
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
        """The names of what is compared at times."""
        return [name for name in self.names if is_observable(self.levels.model, name)]

    @cached_property
    def cycle_numbers(self) -> list[str]:
        """The names of mean periods and phases."""
        return [name for name in self.names if name.startswith((PERIOD, PHASE))]

    @property
    def cyclic(self) -> tuple[str, ...]:
        """The coordinates of these."""
        return tuple(dict.fromkeys(name.partition("_")[2] for name in self.cycle_numbers))

    @property
    def foreseen(self) -> bool:
        """Whether it is known where the runs are compared before they are marched, unless one of them fails."""
        events = bool(self.detectors) and (self.occurrences != 0 or self.times is None)
        return not self.cyclic and not events

    @property
    def stepped(self) -> list[str]:
        """The names of what has a local error."""
        places = {name: self.march.layout.used.find_offset(name) for name in self.names}
        return sorted(
            (name for name, position in places.items() if position is not None), key=lambda name: places[name] or 0
        )

    @cached_property
    def after_events(self) -> list[str]:
        """The names of what is compared after events: quantities of which all elements are asked for, and else elements."""
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
        """Return the dimensions of a quantity, or the place of an element, of what the method integrates."""
        block = self.march.layout.used.block(name)
        return (block.dims, {}) if name == block.name else ((), block.indices_of(name))

    def compared_after(self, detector: str, occurrences: int) -> list[StateAfter]:
        """Return the states after the events of a detector that are few enough to be compared."""
        levels = len(self.levels.values)
        return [state for state in self.states_after[detector] if state.fits(self.shapes, levels, occurrences)]

    def left_out(self, detectors: Iterable[str], occurrences: int) -> str:
        """Say which states after events are left out for their number."""
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
        return name, variable.units, variable.long_name, (AT, *variable.dims[1:])

    def recorded(self, name: str) -> Variable:
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
        return name, "rad", f"phase of {coordinate}, whole turns at located crossings of {level}", (AT,)

    def event_time(self, detector: str) -> Subject:
        """Describe the times at which an event was met."""
        unit = self.levels.model.time_unit.text
        return f"{EVENT_TIME}{detector}", unit, f"time at which {detector} was met", (OCCURRENCE,)

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
            places = {AT: times, OCCURRENCE: self.occurrences or 0}
            shape = self.shapes.shape(subject[3][1:])
            yield TrackedValue.blank(
                subject, places[subject[3][0]] if subject[3] else 1, len(self.levels.values), shape
            )

"""The numbers that a refinement compares, with names, units and words, before anything is marched."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import record
from xdynamics.evidence.observables import observables_of
from xdynamics.evidence.refining.family import Subject, Watched
from xdynamics.evidence.refining.levels import Levels
from xdynamics.march import March
from xdynamics.march.configuration import unthinned_settings_for
from xdynamics.model.detectors import labels
from xdynamics.runtime.cached_properties import cached_property
from xdynamics.schema import AT, OCCURRENCE, Variable
from xdynamics.units import time_in

Floats = NDArray[np.float64]

ENERGY_RANGE, PERIOD, PHASE = "energy_range", "period_", "phase_"


def crossing_level(coordinate: str) -> str:
    """Name the level whose crossings begin the cycles of a coordinate."""
    return f"crossing_level_{coordinate}"


@dataclass(frozen=True)
class Subjects:
    """The numbers that a study compares, described before anything is marched.

    Attributes
    ----------
    levels : Levels
    names : tuple of str
        Observables, and numbers of whole runs.
    at : times, optional
        When observables are compared; by default at the earliest end of a run.
    occurrences : int, optional
        How many occurrences of every event are compared; by default as many as the finest run has.
    defects : bool
        Whether local errors of single steps are told.
    """

    levels: Levels
    names: tuple[str, ...]
    at: Any = None
    occurrences: int | None = None
    defects: bool = False

    def __reduce__(self) -> Any:  # what is cached of a march holds addresses, and stays in its process
        return Subjects, (self.levels, self.names, self.at, self.occurrences, self.defects)

    @cached_property
    def march(self) -> March:
        """The march of the coarsest level, which is not begun."""
        model, value = self.levels.model_of(self.levels.values[0]), self.levels.values[0]
        return March(model, unthinned_settings_for(model, **self.levels.asked_of(value)))

    @cached_property
    def variables(self) -> Mapping[str, Variable]:
        """The variables of a run by name."""
        return {column.variable.name: column.variable for column in record.element_columns(self.march)}

    @cached_property
    def detectors(self) -> tuple[str, ...]:
        """The names of what events are located by."""
        return tuple(labels(self.march.layout.watched))

    @cached_property
    def times(self) -> Floats | None:
        """The wanted times of comparison, s; None for the end."""
        if self.at is None:
            return None
        requested = [self.at] if isinstance(self.at, str | float | int) else list(self.at)
        return np.array([time_in(self.levels.model.time_unit, time, "at") for time in requested])

    @cached_property
    def observed(self) -> list[str]:
        """The names of what is compared at times."""
        observables = {*observables_of(self.levels.model)}
        return [name for name in self.names if name in observables]

    @cached_property
    def counted(self) -> list[str]:
        """The names of mean periods and phases."""
        return [name for name in self.names if name.startswith((PERIOD, PHASE))]

    @property
    def cyclic(self) -> tuple[str, ...]:
        """The coordinates of these."""
        return tuple(dict.fromkeys(name.partition("_")[2] for name in self.counted))

    @property
    def foreseen(self) -> bool:
        """Whether it is known where the runs are compared before they are marched, unless one of them fails."""
        events = bool(self.detectors) and (self.occurrences != 0 or self.times is None)
        return not self.cyclic and not events

    @property
    def stepped(self) -> list[str]:
        """The names of what has a local error."""
        return [name for name in self.march.layout.used if name in self.names]

    @cached_property
    def after_events(self) -> list[str]:
        """The names of what is compared after events."""
        return [name for name in self.names if name in self.variables and name in self.levels.model.units]

    def observable(self, name: str) -> Subject:
        """Describe an observable at the times of comparison."""
        variable = self.variables[name]
        return name, variable.units, variable.long_name, (AT,)

    @property
    def energy_range(self) -> Subject:
        """Describe the range of the energy."""
        units = self.variables["total_energy"].units
        return ENERGY_RANGE, units, "largest less least total energy of the accepted states", ()

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
        return f"event_time_{detector}", unit, f"time at which {detector} was met", (OCCURRENCE,)

    def after_event(self, detector: str, name: str) -> Subject:
        """Describe a state after an event."""
        return f"after_{detector}_{name}", self.variables[name].units, f"{name} after {detector}", (OCCURRENCE,)

    def blank(self) -> Iterator[Watched]:
        """Yield every number without its values."""
        subjects = [self.observable(name) for name in self.observed]
        subjects += [self.energy_range] if ENERGY_RANGE in self.names else []
        subjects += [self.cycles(name) for name in self.counted]
        for detector in self.detectors if self.occurrences else ():
            subjects.append(self.event_time(detector))
            subjects += [self.after_event(detector, name) for name in self.after_events]
        times = 1 if self.times is None else len(self.times)
        for subject in subjects:
            places = {AT: times, OCCURRENCE: self.occurrences or 0}
            yield Watched.blank(subject, places[subject[3][0]] if subject[3] else 1, len(self.levels.values))

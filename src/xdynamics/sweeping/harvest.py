"""Many runs of one model as columns of a record, one run behind the other: states, events, states in between."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import record, schema
from xdynamics.evidence.observing import modes_behind
from xdynamics.expressions import Name
from xdynamics.kernels import Layout, law_of
from xdynamics.kernels.layout import layout_of
from xdynamics.march import Pacing, Runs, Settings
from xdynamics.march.within import states_within
from xdynamics.model import Model
from xdynamics.model.motion import REGIME_NUMBER, constants, evaluated_many, tables_of
from xdynamics.model.reactions import reactions
from xdynamics.record.column import Column
from xdynamics.record.columns import columns_of, state_name
from xdynamics.units import parse_unit

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]


@dataclass(frozen=True)
class Harvest:
    """What became of members that differ in numbers alone.

    Attributes
    ----------
    model : Model
    settings : Settings
    runs : Runs
    """

    model: Model
    settings: Settings
    runs: Runs

    @property
    def layout(self) -> Layout:
        """Where the numbers of the march stand."""
        return self.runs.layout

    @property
    def size(self) -> int:
        """How many members there are."""
        return len(self.runs.ends)

    @cached_property
    def columns(self) -> Mapping[str, Column]:
        """Every variable of their records, and how it is taken from what was kept."""
        return {one.variable.name: one for one in columns_of(self.layout, self.settings)}

    @cached_property
    def _taken(self) -> dict[str, NDArray[Any]]:
        return {}

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return a variable of the records, of all members one behind the other, in the unit that a record has it in."""
        if name not in self._taken:
            self._taken[name] = self.columns[name].take(self.runs.kept)
        return self._taken[name]

    def last(self, name: str) -> NDArray[Any]:
        """Return a variable of every member's last row."""
        return self[name][self.runs.last_rows]

    def met(self, detector: str) -> tuple[Rows, Rows, Rows]:
        """Return the events of one name: their places among all, the member of each, and its how-manieth it is."""
        about = self.columns["event_detector"].variable.more
        names = str(about["flag_meanings"]).split()
        if detector not in names:
            none = np.zeros(0, np.int64)
            return none, none, none
        first = self.runs.first_event
        places = np.flatnonzero(self["event_detector"] == names.index(detector))
        members = np.repeat(np.arange(self.size), np.diff(first))[places]
        return places, members, np.arange(len(places)) - np.searchsorted(members, members)

    def states_at(self, members: Rows, times: Floats, *, after: bool) -> tuple[dict[str, Floats], Rows]:
        """Evaluate states of members at times, as `sample` does, with `error_…`; the row each goes from too."""
        time, first = self["time"], self.runs.first_row
        low, high = first[members], first[members + 1] - 1
        rows = _last_not_behind(time, times, low, high)
        if not after:
            rows = np.minimum(rows, _first_not_before(time, times, low, high))
        following = np.minimum(rows + 1, high)
        states, used = [state_name(one) for one in reactions(self.model)], self.layout.used
        wanted = [("step_size", following), *((one, rows) for one in ("regime", "row_kind", *states, *used))]
        if self.settings.method.simplified:
            wanted += [(one, following) for one in used]
        columns = np.stack([self[name][which] for name, which in wanted])
        factors = record.factors(self.model, self.settings.scales)
        found = states_within(
            self.model, self._of_one_step, law_of(self.layout, sampled=False), np.stack([times, time[rows], time[following]]),
            columns, np.array([[factors[name]] for name in used]), reintegrated=True, parameters=self.runs.parameters,
            runs=members,
        )  # fmt: skip
        errors = dict(zip(map(schema.error, used), found[len(used) :], strict=True))
        return dict(zip(used, found, strict=False)) | errors, rows

    @cached_property
    def _of_one_step(self) -> Settings:
        """What a single step is made with, as by `sample`: equations are solved as well as they can be, whatever the tolerances."""
        return replace(self.settings, until=self.model.initial["t"].si, step=None, tolerances=None, pacing=Pacing())

    def observed(self, name: str, members: Rows, times: Floats, *, after: bool = True) -> Floats:
        """Evaluate a state, energy, observable or force of members at times, in the unit of a record."""
        states, rows = self.states_at(members, times, after=after)
        if name in states:
            return states[name]
        units = {one: float(unit.factor) for one, unit in self.model.units.items()}
        at: dict[str, Any] = {one: states[one] * units[one] for one in self.layout.used}
        at |= {"t": times, REGIME_NUMBER: self["regime"][rows].astype(float)} | self._own(members)
        at |= self._modes(members, rows)
        # as `observe` does: no forces that are told on which side of a switch they are
        known, tables = constants(self.model), tables_of(self.model)
        tree = layout_of(self.model).derived.get(name, Name(name))
        value = evaluated_many(self.model, [tree], at, known, tables, self.settings.math_functions)[0]
        unit = self.columns[name].variable.units
        return np.broadcast_to(value, times.shape) / _factor_of(unit)

    def _modes(self, members: Rows, rows: Rows) -> dict[str, Floats]:
        """Return what each contact and friction element does behind rows, as of one run."""
        found = [state_name(one) for one in reactions(self.model)] + [one.name for one in reactions(self.model)]
        following = np.minimum(rows + 1, self.runs.first_row[members + 1] - 1)
        return modes_behind(self.model, {name: self[name] for name in found}, rows, following)

    def _own(self, members: Rows) -> dict[str, Floats]:
        """Return the parameters of each member, SI."""
        model, scales = self.model, self.settings.scales
        return {
            name: self.runs.parameters[members, i] * scales.of(model.dimensions[name])
            for i, name in enumerate(constants(model))
            if name in model.parameters
        }


def _factor_of(unit: str) -> float:
    return float(parse_unit(unit).factor)


def _last_not_behind(time: Floats, wanted: Floats, low: Rows, high: Rows) -> Rows:
    """Search each time among the rows of its member, from `low` to `high`: the last row that is not behind it."""
    low, high = low.copy(), high.copy()
    while (low < high).any():
        middle = (low + high + 1) // 2
        behind = time[middle] > wanted
        low, high = np.where(behind, low, middle), np.where(behind, middle - 1, high)
    return low


def _first_not_before(time: Floats, wanted: Floats, low: Rows, high: Rows) -> Rows:
    """The same for the first row that is not before it."""
    low, high = low.copy(), high.copy()
    while (low < high).any():
        middle = (low + high) // 2
        before = time[middle] < wanted
        low, high = np.where(before, middle + 1, low), np.where(before, high, middle)
    return low

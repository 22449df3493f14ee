"""The effect of an event on a small change of a run: the saltation matrix, from the event's own expressions.

An event happens at the zero of a function g, at a time t* that changes with the inputs too. Up to it the state has
changed by z + f- dt*, where f- is its rate; the event maps it by R; and at the time of the run's own event it has
then changed by dR - f+ dt* (Aizerman and Gantmacher 1958, doi:10.1093/qjmam/11.4.385; Leine and Nijmeijer, Dynamics and
Bifurcations of Non-Smooth Mechanical Systems, 2004, chapter 7). For a switch R is the state itself, for a reset the
model's assignment, for an impact without friction Newton's law in the metric of the mass.

Events of one kind are evaluated together: k of them along the first axis of every array.

A controller's tick maps a small change by the derivatives of the values that it sets, at a time that does not move.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from xdynamics.dynamics.variational import NotVariedError, TickMaps, Variations, input_differentials
from xdynamics.elementary.arrays import dot, product, solve_systems
from xdynamics.expressions import Node, derivatives, free_names
from xdynamics.model import Model
from xdynamics.model.controllers import actions, controller_states, exact_time, start_values, tick_changes, ticks
from xdynamics.model.kinks import with_whole_numbers
from xdynamics.model.motion import constants, drive_pieces, drive_slope, evaluate_over_states, variables
from xdynamics.model.parts import Function
from xdynamics.model.reactions import NORMAL, Reaction, reactions
from xdynamics.model.regimes import REGIME_NUMBER
from xdynamics.model.switches import watched_switches
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.schema import velocity
from xdynamics.units.unit import exact_value

Floats = NDArray[np.float64]

SAME = 1e-9  # of the compared size: states and rates that differ by less are continuous
ALIKE = 1e-6  # of an impact's velocity jumps, by which they may differ from the recorded ones
ACTING = ("switch", "reset")


@dataclass(frozen=True)
class FlowStates:
    """States, and how they change.

    Attributes
    ----------
    model : Model
    state : mapping of str to ndarray, shape (k,)
        SI.
    changes : mapping of str to ndarray, shape (k, m)
        Of time, variables and parameters; names that are left out do not change.
    """

    model: Model
    state: Mapping[str, Floats]
    changes: Mapping[str, Floats]

    def value(self, tree: Node) -> Floats:
        """Return the values of an expression, shape (k,).

        Raises
        ------
        NotVariedError
            If it reads a name whose change is not followed.
        """
        return self._evaluated_trees([tree])[0]

    def change(self, tree: Node) -> Floats:
        """Return the change of an expression, shape (k, m).

        Raises
        ------
        NotVariedError
            If its derivatives read a name whose change is not followed.
        """
        slopes_by_name = {
            name: slope for name, slope in derivatives(tree, self._varying).items() if name in self.changes
        }
        total = np.zeros_like(next(iter(self.changes.values())))
        for name, number in zip(slopes_by_name, self._evaluated_trees(list(slopes_by_name.values())), strict=True):
            total = total + number[:, None] * self.changes[name]
        return total

    @cached_property
    def _varying(self) -> dict[str, dict[str, Node]]:
        return input_differentials(self.model, tuple(self.model.elements.statement.parameters))

    def _evaluated_trees(self, trees: list[Node]) -> list[Floats]:
        followed_names = self._followed_names
        if strange := {name for tree in trees for name in free_names(tree)} - followed_names:
            raise NotVariedError(f"'{min(strange)}' is read, whose change is not followed")
        values = evaluate_over_states(self.model, trees, self.state, constants(self.model), drive_pieces(self.model))
        return [np.broadcast_to(np.asarray(value, float), self.state["t"].shape) for value in values]

    @cached_property
    def _followed_names(self) -> set[str]:
        model = self.model
        slopes = {drive_slope(name) for name in model.elements.drives}
        return {"t", REGIME_NUMBER, *variables(model), *constants(model), *model.elements.drives, *slopes}


@dataclass(frozen=True)
class SimultaneousEvents:
    """Instants of a run at which one set of events happens.

    Attributes
    ----------
    variations : Variations
    rows_before, rows_after : ndarray of int, shape (k,)
        Rows.
    names : tuple of str
        Of their detectors.
    change : ndarray, shape (k, n, m), SI
        Of the variables, before.
    """

    variations: Variations
    rows_before: NDArray[np.int64]
    rows_after: NDArray[np.int64]
    names: tuple[str, ...]
    change: Floats

    @property
    def model(self) -> Model:
        """The run's model."""
        return self.variations.equations.model

    def time_of(self, name: str) -> Floats:
        """Return the change of one event's time with every input, s, shape (k, m).

        Raises
        ------
        NotVariedError
            If the event's function has no slope along the motion, or is not one of the state.
        """
        tree = self._function(name)
        fixed = self._rows(self.change) | {"t": np.zeros_like(self.change[:, 0])}
        speed = FlowStates(self.model, self._state, self._rates).change(tree)
        if not speed.all():
            raise NotVariedError(f"'{name}' has no slope where it is met")
        # the function stays zero: its change at a fixed time and its slope along the motion cancel
        change: Floats = -FlowStates(self.model, self._state, fixed).change(tree) / speed
        return change

    def flow_before_event(self, time: Floats) -> FlowStates:
        """Return the states before the event, with their changes at the time at which it is met."""
        met_change = self.change + self._along_motion(self._rates, time)
        return FlowStates(self.model, self._state, self._rows(met_change) | {"t": time})

    def changes_after(self) -> Floats:
        """Return the changes after the events, at the times of the run's own events.

        Raises
        ------
        NotVariedError
            If the changes cannot be followed through the events.
        """
        acting = np.flatnonzero((self.rows_before != self.rows_after) & ~self._goes_on)
        if acting.size == self.rows_before.size:
            return self._changes_through_events()
        changes = self.change.copy()
        if acting.size:
            rows_before, rows_after, change = self.rows_before[acting], self.rows_after[acting], self.change[acting]
            changes[acting] = replace(
                self, rows_before=rows_before, rows_after=rows_after, change=change
            ).changes_after()
        return changes

    def flow_after_event(self, time: Floats) -> FlowStates:
        """Return the states after the event, with their changes at the time at which it is met."""
        state, rates = self.variations.row(self.rows_after), self.variations.rates(self.rows_after)
        met_change = self.changes_after() + self._along_motion(rates, time)
        return FlowStates(self.model, state, self._rows(met_change) | {"t": time})

    def _changes_through_events(self) -> Floats:
        time = self._time
        flow_states = self.flow_before_event(time)
        mapped = dict(flow_states.changes) | self._mapped(flow_states)
        changes = np.stack([mapped[name] for name in variables(self.model)], axis=1)
        return changes - self._along_motion(self.variations.rates(self.rows_after), time)

    def _along_motion(self, rates: Mapping[str, Floats], time: Floats) -> Floats:
        """Return the motion during the change of time, shape (k, n, m)."""
        return np.stack([rates[name] * time for name in variables(self.model)], axis=1)

    @cached_property
    def _state(self) -> dict[str, Floats]:
        return self.variations.row(self.rows_before)

    @cached_property
    def _rates(self) -> dict[str, Floats]:
        return self.variations.rates(self.rows_before)

    def _rows(self, change: Floats) -> dict[str, Floats]:
        """Name the rows of a change, and add those of the parameters."""
        inputs = self.variations.equations.inputs
        units = np.broadcast_to(np.eye(len(inputs)), (len(change), len(inputs), len(inputs)))
        parameters = {
            name: units[:, i] for i, name in enumerate(inputs) if name in self.model.elements.statement.parameters
        }
        return dict(zip(variables(self.model), np.moveaxis(change, 1, 0), strict=True)) | parameters

    @cached_property
    def _goes_on(self) -> NDArray[np.bool_]:
        """Whether neither the states nor their rates jump, shape (k,)."""
        states = self._state, self.variations.row(self.rows_after)
        rates = [
            {name: rate[:, 0] for name, rate in self.variations.rates(row).items()}
            for row in (self.rows_before, self.rows_after)
        ]
        same = np.ones(self.rows_before.size, bool)
        for left, right in (states, rates):
            for name in left:
                if name != REGIME_NUMBER:
                    same &= np.abs(left[name] - right[name]) <= SAME * np.abs(left[name])
        return same

    @property
    def _time(self) -> Floats:
        """Change of the time of the acting event, or of several that stay simultaneous."""
        acting = [name for name in self.names if self._acts(name)]
        times = [self.time_of(name) for name in acting]
        if not times:
            raise NotVariedError("the motion jumps, and no event marks where")
        largest = np.abs(times[0]).max(axis=1)
        if any((np.abs(time - times[0]).max(axis=1) > SAME * largest).any() for time in times[1:]):
            raise NotVariedError(f"{' and '.join(acting)} are met at once, and part where an input changes")
        return times[0]

    def _acts(self, name: str) -> bool:
        return name not in self.model.elements.events or self.model.elements.events[name].action in ACTING

    def _mapped(self, flow_states: FlowStates) -> dict[str, Floats]:
        """Return the changes of the variables that the events set."""
        elements = self.model.elements
        struck = [name for name in self.names if name in elements.contacts]
        resets = [name for name in self.names if name in elements.events and elements.events[name].reset]
        if len(struck) + len(resets) > 1:
            raise NotVariedError(f"{' and '.join([*struck, *resets])} are met at once")
        if resets:
            reset = elements.events[resets[0]].reset
            return {name: flow_states.change(elements.expanded(tree)) for name, tree in reset.items()}
        return self._struck(flow_states, struck[0]) if struck else {}

    def _struck(self, flow_states: FlowStates, name: str) -> dict[str, Floats]:
        """Return the changes of velocities after an impact without friction: v+ = v - (1 + e) W rate/D, W = M^-1 n."""
        if self.model.elements.contacts[name].slip is not None:
            raise NotVariedError(f"'{name}' has friction")
        reaction = next(
            contact for contact in reactions(self.model) if contact.owner == name and contact.sort == NORMAL
        )
        normal, normals = self._normal(flow_states, reaction)
        mass, masses = self._mass(flow_states)
        lever = solve_systems(mass, normal[..., None])[..., 0]
        # the change of M^-1 n, from M W = n: M dW = dn - dM W, so that no inverse is differentiated
        levers = solve_systems(mass, normals - np.sum(masses * lever[:, None, :, None], axis=2))
        weight = dot(normal, lever)
        weights = (product(lever[:, None], normals) + product(normal[:, None], levers))[:, 0]
        closing, bounce = flow_states.value(reaction.rate), 1.0 + flow_states.value(reaction.size)
        push = -bounce * closing / weight
        rebound_change = flow_states.change(reaction.size) * closing[:, None] + bounce[:, None] * flow_states.change(
            reaction.rate
        )
        pushes = -(rebound_change + push[:, None] * weights) / weight[:, None]
        names = [velocity(coordinate) for coordinate in self.model.elements.statement.coordinates]
        self._check(names, lever * push[:, None])
        velocity_changes = levers * push[:, None, None] + lever[..., None] * pushes[:, None]
        return {
            velocity_name: flow_states.changes[velocity_name] + velocity_changes[:, i]
            for i, velocity_name in enumerate(names)
        }

    def _normal(self, flow_states: FlowStates, reaction: Reaction) -> tuple[Floats, Floats]:
        """Return the gradient of a gap, and its change."""
        k, n, m = len(self.change), len(self.model.elements.statement.coordinates), self.change.shape[2]
        normal, normals = np.zeros((k, n)), np.zeros((k, n, m))
        for i, name in enumerate(self.model.elements.statement.coordinates):
            if name in reaction.row:
                normal[:, i], normals[:, i] = (
                    flow_states.value(reaction.row[name]),
                    flow_states.change(reaction.row[name]),
                )
        return normal, normals

    def _mass(self, flow_states: FlowStates) -> tuple[Floats, Floats]:
        """Return the mass matrix, and its change."""
        elements = self.model.elements
        k, n, m = len(self.change), len(elements.statement.coordinates), self.change.shape[2]
        mass, masses = np.zeros((k, n, n)), np.zeros((k, n, n, m))
        for (i, j), entry in elements.statement.mass_entries.items():
            tree = elements.expanded(entry)
            mass[:, i, j], masses[:, i, j] = flow_states.value(tree), flow_states.change(tree)
        return mass, masses

    def _check(self, names: list[str], kicks: Floats) -> None:
        """Refuse impacts that differ from the recorded ones."""
        state_before, state_after = self._state, self.variations.row(self.rows_after)
        for i, name in enumerate(names):
            recorded, kick = state_after[name] - state_before[name], kicks[:, i]
            if (np.abs(recorded - kick) > ALIKE * np.maximum(np.abs(recorded), np.abs(kick))).any():
                raise NotVariedError("an impact is none of one contact alone")

    def _function(self, name: str) -> Node:
        """Return the function whose zero is the event."""
        model = self.model
        if name in model.elements.events:
            tree = model.elements.events[name].function
            if isinstance(tree, Function):
                raise NotVariedError(f"event '{name}' is written in Python")
            return model.elements.expanded(tree)
        if name in model.elements.contacts:
            return next(element.gap for element in reactions(model) if element.owner == name and element.sort == NORMAL)
        for element in watched_switches(model):
            if element.name == name and not element.drive:
                return element.function
        raise NotVariedError(f"'{name}' has no function of the state alone")


IntArray = NDArray[np.int64]
ROUNDED = 4.0 * 2.0**-52  # of a time, by which a row may differ from its tick where units are scaled


def with_ticks(variations: Variations) -> Variations:
    """Return variational equations that pass through the ticks of a run.

    Raises
    ------
    NotVariedError
        If an event is met at a tick.
    """
    model = variations.equations.model
    if not model.controllers:
        return variations
    rows, masks = tick_rows(variations, model)
    names, inputs = variables(model), variations.equations.inputs
    n, width = len(names), len(names) + len(inputs)
    units = np.broadcast_to(np.eye(width)[:, None], (width, rows.size, width))
    input_changes = dict(zip(names, units, strict=False)) | {"t": np.zeros((rows.size, width))}
    input_changes |= {
        name: units[n + i] for i, name in enumerate(inputs) if name in model.elements.statement.parameters
    }
    flow_before = FlowStates(model, _states_before_ticks(variations, rows), input_changes)
    maps = np.moveaxis(units[:n], 0, 1).copy()
    for change in tick_changes(model.elements.controllers):
        acts = (masks >> change.action) & 1 == 1
        if acts.any():
            maps[acts, names.index(change.target)] = flow_before.change(
                with_whole_numbers(model.elements.expanded(change.value))
            )[acts]
    return replace(variations, ticks=TickMaps(rows, maps[..., :n], maps[..., n:]))


def tick_rows(variations: Variations, model: Model) -> tuple[IntArray, IntArray]:
    """Return the rows of a run that begin with a tick's changes, and the actions at each, as bits of a number.

    Raises
    ------
    NotVariedError
        If an event is met at a tick.
    """
    times = np.asarray(variations.run["time"], float)
    instants, masks = ticks(
        actions(model.elements.controllers), exact_time(model.statement.initial["t"]), exact_value(float(times[-1]))
    )
    # the last row at a tick's time is the one that begins with what the tick has set
    rows = np.searchsorted(times, instants + ROUNDED * np.abs(instants), side="right") - 1
    marked = np.abs(times[rows] - instants) <= ROUNDED * np.abs(instants)
    rows, masks = rows[marked], masks[marked]
    if (twice := rows[(rows > 0) & (times[rows - 1] == times[rows])]).size:
        raise NotVariedError(f"an event is met at the tick at t = {times[twice[0]]:.6g}")
    return rows, masks


def _states_before_ticks(variations: Variations, rows: IntArray) -> dict[str, Floats]:
    """Return the states just before ticks: of the row itself, with controller values of the row before."""
    model = variations.equations.model
    state, earlier, first = (
        variations.row(rows),
        variations.row(np.maximum(rows - 1, 0)),
        start_values(model.elements.controllers),
    )
    for name in controller_states(model.elements.controllers, model.time_unit):
        state[name] = np.where(rows == 0, first[name].si, earlier[name])
    return state

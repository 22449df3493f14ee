"""The effect of an event on a small change of a run: the saltation matrix, from the event's own expressions.

An event happens at the zero of a function g, at a time t* that changes with the inputs too. Up to it the state has
changed by z + f- dt*, where f- is its rate; the event maps it by R; and at the time of the run's own event it has
then changed by dR - f+ dt* (Aizerman and Gantmacher 1958, doi:10.1093/qjmam/11.4.385; Leine and Nijmeijer, Dynamics and
Bifurcations of Non-Smooth Mechanical Systems, 2004, chapter 7). For a switch R is the state itself, for a reset the
model's assignment, for an impact without friction Newton's law in the metric of the mass.

Events of one kind are evaluated together: k of them along the first axis of every array.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from xdynamics.dynamics.variational import NotVariedError, Variations, varying
from xdynamics.elementary.arrays import dot, product, solved
from xdynamics.expressions import Node, derivatives, free_names
from xdynamics.model import Model
from xdynamics.model.motion import REGIME_NUMBER, constants, evaluated_many, slope, tables_of, variables
from xdynamics.model.parts import Function
from xdynamics.model.reactions import NORMAL, Reaction, reactions
from xdynamics.model.switches import watched_switches
from xdynamics.runtime.cached_properties import cached_property
from xdynamics.schema import velocity

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
        return self._numbers([tree])[0]

    def change(self, tree: Node) -> Floats:
        """Return the change of an expression, shape (k, m).

        Raises
        ------
        NotVariedError
            If its derivatives read a name whose change is not followed.
        """
        by = {name: slope for name, slope in derivatives(tree, self._varying).items() if name in self.changes}
        total = np.zeros_like(next(iter(self.changes.values())))
        for name, number in zip(by, self._numbers(list(by.values())), strict=True):
            total = total + number[:, None] * self.changes[name]
        return total

    @cached_property
    def _varying(self) -> dict[str, dict[str, Node]]:
        return varying(self.model, tuple(self.model.statement.parameters))

    def _numbers(self, trees: list[Node]) -> list[Floats]:
        known = self._known
        if strange := {name for tree in trees for name in free_names(tree)} - known:
            raise NotVariedError(f"'{min(strange)}' is read, whose change is not followed")
        values = evaluated_many(self.model, trees, self.state, constants(self.model), tables_of(self.model))
        return [np.broadcast_to(np.asarray(value, float), self.state["t"].shape) for value in values]

    @cached_property
    def _known(self) -> set[str]:
        model = self.model
        slopes = {slope(name) for name in model.drives}
        return {"t", REGIME_NUMBER, *variables(model), *constants(model), *model.drives, *slopes}


@dataclass(frozen=True)
class Met:
    """Instants of a run at which the same events happen.

    Attributes
    ----------
    along : Variations
    before, after : ndarray of int, shape (k,)
        Rows.
    names : tuple of str
        Of their detectors.
    change : ndarray, shape (k, n, m), SI
        Of the variables, before.
    """

    along: Variations
    before: NDArray[np.int64]
    after: NDArray[np.int64]
    names: tuple[str, ...]
    change: Floats

    @property
    def model(self) -> Model:
        """The run's model."""
        return self.along.equations.model

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
        change: Floats = -FlowStates(self.model, self._state, fixed).change(tree) / speed
        return change

    def meeting(self, time: Floats) -> FlowStates:
        """Return the states before the event, with their changes at the time at which it is met."""
        moved = self.change + self._along_motion(self._rates, time)
        return FlowStates(self.model, self._state, self._rows(moved) | {"t": time})

    def left(self) -> Floats:
        """Return the changes after the events, at the times of the run's own events.

        Raises
        ------
        NotVariedError
            If the changes cannot be followed through the events.
        """
        acting = np.flatnonzero((self.before != self.after) & ~self._goes_on)
        if acting.size == self.before.size:
            return self._left()
        changes = self.change.copy()
        if acting.size:
            before, after, change = self.before[acting], self.after[acting], self.change[acting]
            changes[acting] = replace(self, before=before, after=after, change=change).left()
        return changes

    def behind(self, time: Floats) -> FlowStates:
        """Return the states after the event, with their changes at the time at which it is met."""
        state, rates = self.along.row(self.after), self.along.rates(self.after)
        moved = self.left() + self._along_motion(rates, time)
        return FlowStates(self.model, state, self._rows(moved) | {"t": time})

    def _left(self) -> Floats:
        time = self._time
        place = self.meeting(time)
        mapped = dict(place.changes) | self._mapped(place)
        changes = np.stack([mapped[name] for name in variables(self.model)], axis=1)
        return changes - self._along_motion(self.along.rates(self.after), time)

    def _along_motion(self, rates: Mapping[str, Floats], time: Floats) -> Floats:
        """Return the motion during the change of time, shape (k, n, m)."""
        return np.stack([rates[name] * time for name in variables(self.model)], axis=1)

    @cached_property
    def _state(self) -> dict[str, Floats]:
        return self.along.row(self.before)

    @cached_property
    def _rates(self) -> dict[str, Floats]:
        return self.along.rates(self.before)

    def _rows(self, change: Floats) -> dict[str, Floats]:
        """Name the rows of a change, and add those of the parameters."""
        inputs = self.along.equations.inputs
        units = np.broadcast_to(np.eye(len(inputs)), (len(change), len(inputs), len(inputs)))
        parameters = {name: units[:, i] for i, name in enumerate(inputs) if name in self.model.statement.parameters}
        return dict(zip(variables(self.model), np.moveaxis(change, 1, 0), strict=True)) | parameters

    @cached_property
    def _goes_on(self) -> NDArray[np.bool_]:
        """Whether neither the states nor their rates jump, shape (k,)."""
        states = self._state, self.along.row(self.after)
        rates = [
            {name: rate[:, 0] for name, rate in self.along.rates(row).items()} for row in (self.before, self.after)
        ]
        same = np.ones(self.before.size, bool)
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
        return name not in self.model.events or self.model.events[name].action in ACTING

    def _mapped(self, place: FlowStates) -> dict[str, Floats]:
        """Return the changes of the variables that the events set."""
        struck = [name for name in self.names if name in self.model.contacts]
        resets = [name for name in self.names if name in self.model.events and self.model.events[name].reset]
        if len(struck) + len(resets) > 1:
            raise NotVariedError(f"{' and '.join([*struck, *resets])} are met at once")
        if resets:
            reset = self.model.events[resets[0]].reset
            return {name: place.change(self.model.expanded(tree)) for name, tree in reset.items()}
        return self._struck(place, struck[0]) if struck else {}

    def _struck(self, place: FlowStates, name: str) -> dict[str, Floats]:
        """Return the changes of velocities after an impact without friction: v+ = v - (1 + e) W rate/D, W = M^-1 n."""
        if self.model.contacts[name].slip is not None:
            raise NotVariedError(f"'{name}' has friction")
        reaction = next(each for each in reactions(self.model) if each.owner == name and each.sort == NORMAL)
        normal, normals = self._normal(place, reaction)
        mass, masses = self._mass(place)
        lever = solved(mass, normal[..., None])[..., 0]
        levers = solved(mass, normals - np.sum(masses * lever[:, None, :, None], axis=2))
        weight = dot(normal, lever)
        weights = (product(lever[:, None], normals) + product(normal[:, None], levers))[:, 0]
        closing, bounce = place.value(reaction.rate), 1.0 + place.value(reaction.size)
        push = -bounce * closing / weight
        turned = place.change(reaction.size) * closing[:, None] + bounce[:, None] * place.change(reaction.rate)
        pushes = -(turned + push[:, None] * weights) / weight[:, None]
        names = [velocity(each) for each in self.model.statement.coordinates]
        self._check(names, lever * push[:, None])
        moved = levers * push[:, None, None] + lever[..., None] * pushes[:, None]
        return {each: place.changes[each] + moved[:, i] for i, each in enumerate(names)}

    def _normal(self, place: FlowStates, reaction: Reaction) -> tuple[Floats, Floats]:
        """Return the gradient of a gap, and its change."""
        k, n, m = len(self.change), len(self.model.statement.coordinates), self.change.shape[2]
        normal, normals = np.zeros((k, n)), np.zeros((k, n, m))
        for i, name in enumerate(self.model.statement.coordinates):
            if name in reaction.row:
                normal[:, i], normals[:, i] = place.value(reaction.row[name]), place.change(reaction.row[name])
        return normal, normals

    def _mass(self, place: FlowStates) -> tuple[Floats, Floats]:
        """Return the mass matrix, and its change."""
        k, n, m = len(self.change), len(self.model.statement.coordinates), self.change.shape[2]
        mass, masses = np.zeros((k, n, n)), np.zeros((k, n, n, m))
        for (i, j), entry in self.model.statement.mass_entries.items():
            tree = self.model.expanded(entry)
            mass[:, i, j], masses[:, i, j] = place.value(tree), place.change(tree)
        return mass, masses

    def _check(self, names: list[str], kicks: Floats) -> None:
        """Refuse impacts that differ from the recorded ones."""
        before, after = self._state, self.along.row(self.after)
        for i, name in enumerate(names):
            recorded, kick = after[name] - before[name], kicks[:, i]
            if (np.abs(recorded - kick) > ALIKE * np.maximum(np.abs(recorded), np.abs(kick))).any():
                raise NotVariedError("an impact is none of one contact alone")

    def _function(self, name: str) -> Node:
        """Return the function whose zero is the event."""
        model = self.model
        if name in model.events:
            tree = model.events[name].function
            if isinstance(tree, Function):
                raise NotVariedError(f"event '{name}' is written in Python")
            return model.expanded(tree)
        if name in model.contacts:
            return next(element.gap for element in reactions(model) if element.owner == name and element.sort == NORMAL)
        for element in watched_switches(model):
            if element.name == name and not element.drive:
                return element.function
        raise NotVariedError(f"'{name}' has no function of the state alone")

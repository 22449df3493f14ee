"""What an event does to a small change of a run: the saltation matrix, from the event's own trees.

An event happens at the zero of a function g, at a time t* that changes with the inputs too. Up to it the state has
changed by z + f- dt*, where f- is how fast it moves; the event maps it, R; and at the time of the run's own event it has
then changed by dR - f+ dt* (Aizerman and Gantmacher 1958, doi:10.1093/qjmam/11.4.385; Leine and Nijmeijer, Dynamics and
Bifurcations of Non-Smooth Mechanical Systems, 2004, chapter 7). Of a switch R is the state itself, of a reset what the
model says, of an impact without friction Newton's law in the metric of the mass.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from xdynamics.dynamics.variational import Along, NotVariedError, varying
from xdynamics.elementary.arrays import dot, solved
from xdynamics.expressions import Node, derivatives, free_names
from xdynamics.model import Model
from xdynamics.model.motion import REGIME_NUMBER, constants, evaluated_many, slope, tables_of, variables
from xdynamics.model.parts import Function
from xdynamics.model.reactions import NORMAL, Reaction, reactions
from xdynamics.model.switches import switches
from xdynamics.schema import velocity

Floats = NDArray[np.float64]

SAME = 1e-9  # of the size of what is compared: across this, states and their rates go on
ALIKE = 1e-6  # of an impact's velocities, that they are those that were recorded
ACTING = ("switch", "reset")


@dataclass(frozen=True)
class Place:
    """A state, and how it changes.

    Attributes
    ----------
    model : Model
    state : mapping of str to ndarray, shape (1,)
        SI.
    changes : mapping of str to ndarray, shape (m,)
        Of time, variables and parameters; what is left out does not change.
    """

    model: Model
    state: Mapping[str, Floats]
    changes: Mapping[str, Floats]

    def value(self, tree: Node) -> float:
        """Return the number of a tree."""
        return float(self._numbers([tree])[0])

    def change(self, tree: Node) -> Floats:
        """Return how a tree changes."""
        by = {name: one for name, one in derivatives(tree, self._varying).items() if name in self.changes}
        numbers = self._numbers(list(by.values()))
        found = np.zeros_like(next(iter(self.changes.values())))
        for name, one in zip(by, numbers, strict=True):
            found = found + one * self.changes[name]
        return found

    @cached_property
    def _varying(self) -> dict[str, dict[str, Node]]:
        return varying(self.model, tuple(self.model.parameters))

    def _numbers(self, trees: list[Node]) -> list[float]:
        known = self._known
        if strange := {name for one in trees for name in free_names(one)} - known:
            raise NotVariedError(f"'{min(strange)}' is read, whose change is not followed")
        found = evaluated_many(self.model, trees, self.state, constants(self.model), tables_of(self.model))
        return [float(np.ravel(one)[0]) for one in found]

    @cached_property
    def _known(self) -> set[str]:
        model = self.model
        slopes = {slope(name) for name in model.drives}
        return {"t", REGIME_NUMBER, *variables(model), *constants(model), *model.drives, *slopes}


@dataclass(frozen=True)
class Met:
    """Events of a run at one instant.

    Attributes
    ----------
    along : Along
    before, after : int
        Rows.
    names : tuple of str
        Of their detectors.
    change : ndarray, shape (n, m), SI
        Of the variables, before.
    """

    along: Along
    before: int
    after: int
    names: tuple[str, ...]
    change: Floats

    @property
    def model(self) -> Model:
        """The run's own."""
        return self.along.equations.model

    def time_of(self, name: str) -> Floats:
        """Return how the time of one event changes with every input, s."""
        tree = self._function(name)
        still = self._rows(self.change) | {"t": np.zeros(self.change.shape[1])}
        moving = Place(self.model, self._state, self.along.rates(self.before)).change(tree)[0]
        if not moving:
            raise NotVariedError(f"'{name}' has no slope where it is met")
        found: Floats = -Place(self.model, self._state, still).change(tree) / moving
        return found

    def meeting(self, time: Floats) -> Place:
        """Return the state before, as it changes where it meets the event."""
        rates = self.along.rates(self.before)
        moved = self.change + np.outer([float(rates[name][0]) for name in variables(self.model)], time)
        return Place(self.model, self._state, self._rows(moved) | {"t": time})

    def left(self) -> Floats:
        """Return the change behind the events, at the time of the run's own."""
        if self.before == self.after or self._goes_on:
            return self.change
        time = self._time
        place = self.meeting(time)
        found = dict(place.changes) | self._mapped(place)
        rates = self.along.rates(self.after)
        return np.stack([found[name] - rates[name][0] * time for name in variables(self.model)])

    def behind(self, time: Floats) -> Place:
        """Return the state behind, as it changes with the event."""
        state, rates = self.along.row(self.after), self.along.rates(self.after)
        moved = self.left() + np.outer([float(rates[name][0]) for name in variables(self.model)], time)
        return Place(self.model, state, self._rows(moved) | {"t": time})

    @cached_property
    def _state(self) -> dict[str, Floats]:
        return self.along.row(self.before)

    def _rows(self, change: Floats) -> dict[str, Floats]:
        """Name the rows of a change, and add those of the parameters."""
        inputs = self.along.equations.inputs
        units = np.eye(len(inputs))
        parameters = {name: units[i] for i, name in enumerate(inputs) if name in self.model.parameters}
        return dict(zip(variables(self.model), change, strict=True)) | parameters

    @cached_property
    def _goes_on(self) -> bool:
        """Whether neither the state nor its rates jump."""
        pairs = [(self._state, self.along.row(self.after)), tuple(map(self.along.rates, (self.before, self.after)))]
        return all(
            abs(float(one[name][0]) - float(other[name][0])) <= SAME * abs(float(one[name][0]))
            for one, other in pairs
            for name in one
            if name != REGIME_NUMBER
        )

    @property
    def _time(self) -> Floats:
        """How the time of what acts here changes: of one event, or of several that stay together."""
        acting = [name for name in self.names if self._acts(name)]
        times = [self.time_of(name) for name in acting]
        if not times:
            raise NotVariedError("the motion jumps, and no event tells where")
        if any(np.abs(one - times[0]).max() > SAME * np.abs(times[0]).max() for one in times[1:]):
            raise NotVariedError(f"{' and '.join(acting)} are met at once, and part where an input changes")
        return times[0]

    def _acts(self, name: str) -> bool:
        return name not in self.model.events or self.model.events[name].action in ACTING

    def _mapped(self, place: Place) -> dict[str, Floats]:
        """Return the changes of what the events set anew."""
        hit = [name for name in self.names if name in self.model.contacts]
        sets = [name for name in self.names if name in self.model.events and self.model.events[name].reset]
        if len(hit) + len(sets) > 1:
            raise NotVariedError(f"{' and '.join([*hit, *sets])} are met at once")
        if sets:
            reset = self.model.events[sets[0]].reset
            return {name: place.change(self.model.expanded(tree)) for name, tree in reset.items()}
        return self._struck(place, hit[0]) if hit else {}

    def _struck(self, place: Place, name: str) -> dict[str, Floats]:
        """Return how the velocities behind an impact without friction change: v+ = v - (1 + e) W rate/D, W = M^-1 n."""
        if self.model.contacts[name].slip is not None:
            raise NotVariedError(f"'{name}' has friction")
        one = next(each for each in reactions(self.model) if each.owner == name and each.sort == NORMAL)
        normal, normals = self._normal(place, one)
        mass, masses = self._mass(place)
        lever = solved(mass, normal[:, None])[:, 0]
        levers = solved(mass, normals - np.sum(masses * lever[:, None], axis=1))
        weight = float(dot(normal, lever))
        weights = dot(normals.T, lever) + dot(levers.T, normal)
        closing, bounce = place.value(one.rate), 1.0 + place.value(one.size)
        push = -bounce * closing / weight
        pushes = -(place.change(one.size) * closing + bounce * place.change(one.rate) + push * weights) / weight
        names = [velocity(each) for each in self.model.coordinates]
        self._check(names, lever * push)
        moved = levers * push + np.outer(lever, pushes)
        return {each: place.changes[each] + moved[i] for i, each in enumerate(names)}

    def _normal(self, place: Place, one: Reaction) -> tuple[Floats, Floats]:
        """Return the gradient of a gap, and how it changes."""
        n, m = len(self.model.coordinates), self.change.shape[1]
        normal, normals = np.zeros(n), np.zeros((n, m))
        for i, name in enumerate(self.model.coordinates):
            if name in one.row:
                normal[i], normals[i] = place.value(one.row[name]), place.change(one.row[name])
        return normal, normals

    def _mass(self, place: Place) -> tuple[Floats, Floats]:
        """Return the mass matrix, and how it changes."""
        n, m = len(self.model.coordinates), self.change.shape[1]
        mass, masses = np.zeros((n, n)), np.zeros((n, n, m))
        for at, entry in self.model.statement.mass_entries.items():
            tree = self.model.expanded(entry)
            mass[at], masses[at] = place.value(tree), place.change(tree)
        return mass, masses

    def _check(self, names: list[str], kicks: Floats) -> None:
        """Compare an impact with the one that was recorded."""
        before, after = self._state, self.along.row(self.after)
        for name, kick in zip(names, kicks, strict=True):
            told = float(after[name][0] - before[name][0])
            if abs(told - kick) > ALIKE * max(abs(told), abs(kick)):
                raise NotVariedError("an impact is none of one contact alone")

    def _function(self, name: str) -> Node:
        """Return the function whose zero an event is at."""
        model = self.model
        if name in model.events:
            tree = model.events[name].function
            if isinstance(tree, Function):
                raise NotVariedError(f"event '{name}' is written in Python")
            return model.expanded(tree)
        if name in model.contacts:
            return next(one.gap for one in reactions(model) if one.owner == name and one.sort == NORMAL)
        for one in switches(model):
            if one.name == name and not one.drive:
                return one.function
        raise NotVariedError(f"'{name}' has no function of the state alone")

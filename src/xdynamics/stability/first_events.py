"""When a motion first comes to an event or a contact, as its start lets one expect."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from itertools import pairwise

import numpy as np

from xdynamics.expressions import Node, free_names
from xdynamics.expressions.evaluation import evaluate
from xdynamics.model import Model
from xdynamics.model.linearisation import Linearisation
from xdynamics.model.motion import constants, drive_pieces, motion_inputs, variables
from xdynamics.schema import velocity

MOST_FUNCTIONS = 64  # events and contacts that are looked at
EARLIEST, LATEST, TRIED, HALVINGS = 1e-15, 1e20, 350, 30  # s; instants that are tried between them, then in a bracket
SIGNS = {"rising": (1.0,), "falling": (-1.0,), "either": (1.0, -1.0)}


def first_event(
    model: Model, state: Mapping[str, float], linearisation: Linearisation, *, within: float = np.inf
) -> tuple[str, float]:
    """Return the event or contact that a motion meets first, and how long after its start, s.

    Parameters
    ----------
    model : Model
    state : mapping of str to float
        The start in SI units.
    linearisation : Linearisation
        About the start, for its accelerations.
    within : float, s
        How long these last: half the time in which the motion turns.

    Returns
    -------
    tuple of str and float
        ``("", inf)`` if none is met. Accelerations and first-order states stay as they are at the start: the time is
        exact for a free fall, and an estimate else. Functions of time alone do not count, nor those in Python.
    """
    names = list(model.elements.statement.coordinates)
    start, v = np.array([state[name] for name in names]), np.array([state[velocity(name)] for name in names])
    accelerations = np.where(np.isfinite(linearisation.acceleration), linearisation.acceleration, 0.0)
    constant_values, tables = constants(model), drive_pieces(model)

    def inputs(elapsed: float) -> dict[str, float]:
        moved = dict(state) | {"t": state["t"] + elapsed}
        moved |= dict(zip(names, (start + (v + accelerations * elapsed / 2.0) * elapsed).tolist(), strict=True))
        moved |= dict(zip(map(velocity, names), (v + accelerations * elapsed).tolist(), strict=True))
        return motion_inputs(model, moved, constant_values, tables)

    def value(function: Node, elapsed: float) -> float:
        return evaluate(function, inputs(elapsed))

    functions = dict(_functions_of_state(model))
    if not functions or not names or len(functions) > MOST_FUNCTIONS:
        return "", np.inf
    times = [0.0, *np.geomspace(EARLIEST, min(LATEST, within), TRIED).tolist()]
    before = dict.fromkeys(functions, 0.0)
    for earlier, later in pairwise(times):
        values = inputs(later)
        for name, (function, signs) in functions.items():
            g = evaluate(function, values)
            if before[name] * g < 0.0 and np.sign(g) in signs:
                return name, _crossing(partial(value, function), earlier, later, g)
            before[name] = g or before[name]
    return "", np.inf


def _functions_of_state(model: Model) -> Iterator[tuple[str, tuple[Node, tuple[float, ...]]]]:
    """Yield events and contacts with functions of the state, and the signs that follow a crossing of each."""
    elements, moving = model.elements, set(variables(model))
    functions = [(name, part.searched, SIGNS[part.direction]) for name, part in elements.events.items()]
    functions += [(name, part.gap, SIGNS["falling"]) for name, part in elements.contacts.items()]
    for name, function, signs in functions:
        if isinstance(function, Node) and moving & free_names(expanded := elements.expanded(function)):
            yield name, (expanded, signs)


def _crossing(g: Callable[[float], float], low: float, high: float, after: float) -> float:
    """Halve the bracket of a crossing to the digits that an estimate has."""
    for _ in range(HALVINGS):
        middle = (low + high) / 2.0
        low, high = (low, middle) if g(middle) * after > 0.0 else (middle, high)
    return high

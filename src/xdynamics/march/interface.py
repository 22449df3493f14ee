"""The functions that a model and a method give to the march.

The loop is written against these names. Before it is compiled, the functions that were generated for one model and one
method take their places (`kernels.cache.bind`); called as they stand here, they only say so.

In all of them, ``state`` is a tuple in the order of `kernels.layout.Layout.state`, ``p`` the parameters, ``tables`` the
measured tables, ``pieces`` the piece of every drive of time, ``log`` the log with ``at`` the next free force sample.
"""

from __future__ import annotations

from typing import Any, NoReturn

ESTIMATES = False  # whether a step comes with an error estimate

EVENTFUL = True  # whether the model has events
DOMAIN_LIMITED = False  # whether the model has functions or tables that are not defined everywhere

NO_ERROR: tuple[float, ...] = (0.0,)  # error of a state that no step led to

State = tuple[float, ...]
Effort = tuple[int, int]  # force evaluations; Newton iterations, -1 where they did not converge


def begin(t: float, state: State, p: Any, tables: Any, pieces: Any, log: Any, at: int, step: int) -> tuple[State, int]:
    """Evaluate the forces at a state: at the start, and behind a node of a drive."""
    _unbound()


def propose(
    t: float, t1: float, h: float, state: State, p: Any, tables: Any, pieces: Any, log: Any, at: int, step: int
) -> tuple[State, State, int, Effort]:
    """Make one step of the method, from a state that stays as it is: the new state and its error."""
    _unbound()


def error_norm(state: State, trial: State, error: State, rtol: float, atol: State) -> float:
    """Scale an error: 1 is what the tolerances allow."""
    _unbound()


def moved(state: State, h: float) -> State:
    """Move a state by an Euler step; its forces stay those of before."""
    _unbound()


def sizes(state: State, other: State, rtol: float, atol: State) -> tuple[float, float, float]:
    """Scaled sizes of a state, of its slope, and of the slope's difference from another state's."""
    _unbound()


def detect(t: float, state: State, p: Any, tables: Any, pieces: Any) -> tuple[float, ...]:
    """Evaluate every event function."""
    _unbound()


def slopes(t: float, state: State, p: Any, tables: Any, pieces: Any) -> tuple[float, ...]:
    """Evaluate the time derivative of every event function."""
    _unbound()


def note(
    log: Any, row: int, t: float, h: float, kind: int, state: State, norm: float, error: State, iterations: int,
    p: Any, tables: Any, pieces: Any,
) -> bool:  # fmt: skip
    """Write one row of the log; tell whether its energies and observables are finite."""
    _unbound()


def pieces_at(t: float, tables: Any) -> tuple[int, ...]:
    """Find the piece of every drive of time that a step from t goes through."""
    _unbound()


def _unbound() -> NoReturn:
    raise NotImplementedError("the march is not bound to a model")

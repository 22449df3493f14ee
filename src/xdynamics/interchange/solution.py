"""A run as `scipy.integrate.solve_ivp` returns one."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.elementary.arrays import flattened_rows
from xdynamics.elementary.bounds import EPS
from xdynamics.evidence.sampling import sample
from xdynamics.faults import InputError
from xdynamics.record.flag_words import words_of_flag
from xdynamics.record.named_rows import rows_of_events
from xdynamics.schema import AT, EVENTS, IMAGINARY_PART, INTEGRATED, REAL_PART, SAMPLED, STEPS

Floats = NDArray[np.float64]
COMPLETED, STOPPED, FAILED = 0, 1, -1
OUTCOMES = {"completed": COMPLETED, "stopped_by_event": STOPPED}
SPACINGS = 16.0  # of the span's largest time, up to which a time beyond an end is that end
EVALUATIONS = ("force_evaluations", "jacobian_evaluations", "factorisations")
SWITCH = "."  # in the name of a switch inside a force, which is no event of the model
MOST_ROWS = 4  # of a solution that is printed


@dataclass(frozen=True)
class Solution:
    """A solution under scipy's names; numbers are in the units of the run.

    Attributes
    ----------
    t : ndarray, shape (k,), s
        Times of the accepted states; of two states at an impact the later one is kept.
    y : ndarray, shape (n, k)
        Coordinates, velocities and states, each elements after one another; complex if y0 was.
    sol : callable
        ``sol(t)`` is the state at any times within the run, shape (n,) or (n, k).
    t_events, y_events : list of ndarray
        For every event of the model its times, and the states after it, shape (k, n); switches inside forces are none.
    status : int
        0: the end of the span was reached, 1: an event stopped the run, -1: it ended early.
    message : str
    names : tuple of str
        Of the rows of y.
    nfev, njev, nlu : int
        How often the function, its Jacobian, and a factorisation were computed; 0 of what the method does without.
    """

    t: Floats
    y: Floats
    sol: Any
    t_events: list[Floats]
    y_events: list[Floats]
    status: int
    message: str
    names: tuple[str, ...]
    nfev: int = 0
    njev: int = 0
    nlu: int = 0

    def __getitem__(self, name: str) -> Any:
        """Return one of them by its name, as scipy's does.

        Raises
        ------
        KeyError
            If it has none of that name.
        """
        if name in (*self.keys(), "success"):
            return getattr(self, name)
        raise KeyError(name)

    def keys(self) -> list[str]:
        """Return the names, as of a mapping."""
        return [*self.__dataclass_fields__]

    @property
    def success(self) -> bool:
        """Whether the end of the span, or an event that stops, was reached."""
        return self.status >= 0

    def __repr__(self) -> str:
        return (
            f"message: {self.message}\nstatus:  {self.status}\nt:       {_shape_text(self.t)}\n"
            f"y:       {_shape_text(self.y)}: {', '.join(self.names[:MOST_ROWS])}{' …' if len(self.names) > MOST_ROWS else ''}\n"
            f"t_events: {[len(times) for times in self.t_events]}"
        )


def solution(run: xr.Dataset) -> Solution:
    """Return a run, or its states at chosen times, as scipy's solve_ivp would.

    Raises
    ------
    InputError
        If the Dataset has neither.
    """
    row_dim = STEPS if STEPS in run.dims else AT
    times = "time" if row_dim == STEPS else f"{AT}_time"
    names = [
        str(name)
        for name, variable in run.data_vars.items()
        if variable.dims[:1] == (row_dim,) and variable.attrs.get("role") in INTEGRATED
    ]
    if times not in run.variables or not names:
        raise InputError("the Dataset is no run record, nor the states of one at chosen times")
    t, y = np.asarray(run[times].values, float), _state_rows(run, names)
    last = np.append(np.diff(t) > 0, True) if row_dim == STEPS else np.ones(len(t), bool)
    t_events, y_events = _events_by_detector(run, y if row_dim == STEPS else None, names)
    whole = run if row_dim == STEPS else run.encoding.get(SAMPLED)
    sol = _not_between if whole is None else partial(_states_between, whole, names)
    outcome, message = str(run.attrs.get("run_outcome", "completed")), str(run.attrs.get("run_outcome_text", ""))
    elements = _complex_names(names) or [label for name in names for label in _element_labels(run, name)]
    counts = (int((run if whole is None else whole).attrs.get(f"run_{name}", 0)) for name in EVALUATIONS)
    return Solution(
        t[last], y[:, last], sol, t_events, y_events, OUTCOMES.get(outcome, FAILED), message, tuple(elements), *counts
    )


def _state_rows(states: xr.Dataset, names: list[str], head: str = "") -> NDArray[Any]:
    """Return quantities, or what `head` says of them, as rows, dimensions flattened; of parts of complex numbers these."""
    rows = np.concatenate([flattened_rows(np.asarray(states[head + name].values, float)).T for name in names])
    half = len(_complex_names(names))
    return rows[:half] + 1j * rows[half:] if half else rows


def _complex_names(names: list[str]) -> list[str]:
    """Return what complex numbers are called whose real parts stand before their imaginary parts; none of real numbers."""
    words = [name.removesuffix(REAL_PART) for name in names[: len(names) // 2]]
    return words if names == [word + part for part in (REAL_PART, IMAGINARY_PART) for word in words] else []


def _element_labels(run: xr.Dataset, name: str) -> list[str]:
    shape = run[name].shape[1:]
    return [f"{name}[{', '.join(map(str, index))}]" for index in np.ndindex(shape)] if shape else [name]


def _events_by_detector(run: xr.Dataset, y: Floats | None, names: list[str]) -> tuple[list[Floats], list[Floats]]:
    """Return times and states after the events of each that the model names; of sampled states, those recorded beside them."""
    if "event_detector" not in run:
        return [], []
    labels = [
        label for label in str(run["event_detector"].attrs.get("flag_meanings", "")).split() if SWITCH not in label
    ]
    event_labels = np.array(words_of_flag(run["event_detector"]) if run.sizes.get(EVENTS, 0) else [], dtype=str)
    indices_by_label = [np.flatnonzero(event_labels == label) for label in labels]
    states_after = (
        _state_rows(run, names, "after_")
        if y is None
        else y[:, rows_of_events(run, "after", np.arange(event_labels.size))]
    )
    return [run["event_time"].values[event_indices] for event_indices in indices_by_label], [
        states_after[:, event_indices].T for event_indices in indices_by_label
    ]


def _states_between(run: xr.Dataset, names: list[str], t: Any) -> Floats:
    times, ends = np.atleast_1d(np.asarray(t, float)), run["time"].values[[0, -1]]
    # t0 + n*h of somebody else's grid ends some spacings beyond the span, where scipy's polynomials go on
    beyond = SPACINGS * EPS * np.abs(ends).max()
    clipped_times = np.clip(times, *ends)
    states = _state_rows(sample(run, np.where(np.abs(times - clipped_times) <= beyond, clipped_times, times)), names)
    return states if np.ndim(t) else states[:, 0]


def _not_between(_: Any) -> Floats:
    """Refuse states between chosen times.

    Raises
    ------
    InputError
        Always: a record alone has them.
    """
    raise InputError(
        "states at chosen times have none between them; give dense_output=True beside t_eval, or leave t_eval out"
    )


def _shape_text(array: Floats) -> str:
    return " x ".join(map(str, array.shape))

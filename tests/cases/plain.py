"""The engine's phases as plain Python, in a process whose numba compiles: for tests on runs made by hand."""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from types import FunctionType
from typing import Any, NamedTuple

from xdynamics.elementary import FUNCTIONS, NAME
from xdynamics.elementary.intervals import Interval, Intervals
from xdynamics.kernels.compiling import UNCOMPILED, is_declared, keys_of
from xdynamics.kernels.interval_program import RULES
from xdynamics.kernels.law import CONTROL
from xdynamics.kernels.program import AT, UNSOUND, H
from xdynamics.march.calls import apply_plainly, call_law_plainly, write_row_plainly
from xdynamics.march.phases import PHASES
from xdynamics.march.run import ARRAYS, DETECTOR, EVENT_ROW, NOW, PLAN, WATCH, Run

_KNOWN: dict[Any, Callable[..., Any]] = {}


def plain(function: Any) -> Callable[..., Any]:
    """Return a compiled phase, and all that it calls, as the Python that is written there."""
    name = getattr(function, "__name__", "")
    python = PHASES[name].function if name in PHASES else getattr(function, "py_func", function)
    if python.__closure__ is not None:  # of a phase of a room above
        return python  # type: ignore[no-any-return]
    if python not in _KNOWN:
        scope: dict[str, Any] = {}
        _KNOWN[python] = FunctionType(python.__code__, scope, python.__name__, python.__defaults__)
        for known, value in python.__globals__.items():
            value = PHASES[known].function if known in PHASES else value  # noqa: PLW2901 - it may be an instruction by now
            scope[known] = plain(value) if hasattr(value, "py_func") or is_declared(value) else value
        scope |= {
            "call_law": call_law_plainly,
            "call_row_writer": write_row_plainly,
            "apply_function": apply_plainly,
            "run_at": lambda run: run,
            "row_by": lambda entry, *given: UNCOMPILED[int(entry)](*given),
        }
    return _KNOWN[python]


def made_by_hand(n: int = 1, columns: int = 6, **arrays: Any) -> Run:
    """A run of n coordinates under no law: zeros, with some arrays as given."""
    import numpy as np

    sizes = dict.fromkeys(("y", "z", "half", "whole", "located_z"), 3 * n) | dict.fromkeys(
        ("e", "located_e", "atol"), 2 * n
    )
    sizes |= {
        "at": len(AT),
        "base": 1,
        "plan": 1,
        "now": 1,
        "trial": 1,
        "located": 1,
        "kept": 1,
        "piece": 1,
        "log_trials": 50,
    }
    sizes["snaps"] = 1 + len(arrays.get("nodes", ()))
    shapes = {
        "log_rows": (columns, 50),
        "log_flags": (2, 50),
        "log_samples": (3, 3),
        "unknowns": (0, 3),
        "entries": (0, 4),
    }
    made = {name: np.zeros(shapes.get(name, sizes.get(name, 0)), array.kind.elements) for name, array in ARRAYS.items()}
    run = Run(**made | arrays)
    run.plan[0].used, run.plan[0].state, run.plan[0].coordinates = 2 * n, 3 * n, n
    run.plan[0].end, run.plan[0].most_steps = 10.0, 1e6
    if "law" not in arrays:
        run.put(law=law_of(*[kept] * 7))
    run.base[0].room = run.log_samples.shape[1]
    run.now[0].on_grid, run.now[0].status, run.now[0].rows = 1, -1, 1
    return run


def kept(*arrays: Any) -> None:
    """A row of the log without energies: time, step size, the state."""
    at, y, row = arrays[0], arrays[1], arrays[5]
    row[0], row[1], row[2:5], at[UNSOUND] = at[0], at[2], y[:3], 0.0


class Seen(NamedTuple):
    """An event function of the time since the step began, with its rate."""

    value: Callable[[float], float]
    rate: Callable[[float], float]


def uniform(*arrays: Any) -> None:
    """Motion at unit speed: the position is the time since the step began."""
    arrays[5][:3], arrays[0][UNSOUND] = [arrays[0][H], 1.0, 0.0], 0.0


def nothing(*_arrays: Any) -> None:
    """A program that computes nothing."""


def watching(
    *functions: Seen, t: float = 0.0, h: float = 1.0, tolerance: float = 1e-9, place: float = inf
) -> tuple[Run, list[float]]:
    """A run whose trial each function is known to cross zero in, and the list of where they will be looked at."""
    import numpy as np

    from xdynamics.march import trial_step
    from xdynamics.march.events import zero_tests

    n = len(functions)
    looks: list[float] = []

    def detect(*arrays: Any) -> None:
        looks.append(float(arrays[1][0]))
        arrays[5][:n], arrays[0][UNSOUND] = [seen.value(arrays[1][0]) for seen in functions], 0.0

    def rates(*arrays: Any) -> None:
        arrays[5][:n] = [seen.rate(arrays[1][0]) for seen in functions]

    detectors, watches = np.zeros(n, DETECTOR), np.zeros(n, WATCH)
    detectors["tolerance"], detectors["position"], detectors["reaction"] = tolerance, place, -1
    arrays = {name: np.zeros(n) for name in ("g", "g1", "located_g", "near_g", "slopes", "entered", "pending")}
    run = made_by_hand(
        y=np.array([0.0, 1.0, 0.0]),
        near=np.array([0.0, 1.0, 0.0]),
        law=law_of(nothing, detect, rates, nothing, nothing, kept, nothing, uniform),
        detectors=detectors,
        watches=watches,
        log_events=np.zeros(5, EVENT_ROW),
        **arrays,
    )
    run.plan[0].stages, run.now[0].t = 1, t
    run.g[:] = run.near_g[:] = [seen.value(0.0) for seen in functions]
    plain(trial_step.propose_step)(run, t + h, h)
    plain(trial_step.evaluate_events)(run)
    plain(trial_step.store_trial)(run)
    watches["armed"], watches["before"], watches["alive"] = np.sign(run.g), run.g, 1
    watches["hit"], watches["right"] = zero_tests.CROSSED, h
    looks.clear()
    return run, looks


def law_of(*functions: Callable[..., None]) -> Any:
    """Put plain functions behind addresses."""
    import numpy as np

    return np.array([*keys_of([*(FUNCTIONS[name] for name in CONTROL), *functions]), 0], np.int64)


def rules_in_python() -> Any:
    """Put the operations on intervals behind addresses, as plain Python."""
    import numpy as np

    from xdynamics.march.events.enclosures import ROUGH, in_python

    rules = [in_python(name, NAME, rough=rough and name in ROUGH) for rough in (False, True) for name in RULES]
    return np.array(keys_of(rules), np.int64)


def between_states(name: str, y: Any, z: Any, places: Any, width: float) -> Interval:
    """Enclose a variable between two states, in which it and its derivatives have these places."""
    ends = [float(state[place]) for state in (y, z) for place in places]
    enclosure: Interval = Intervals(FUNCTIONS).of(name, *ends, width, 0.0, 0)
    return enclosure


__all__ = [
    "NOW",
    "PLAN",
    "Seen",
    "between_states",
    "kept",
    "law_of",
    "made_by_hand",
    "nothing",
    "plain",
    "rules_in_python",
    "watching",
]

"""The engine's phases as plain Python, in a process whose numba compiles: for tests on runs made by hand."""

from __future__ import annotations

from collections.abc import Callable
from types import FunctionType
from typing import Any

from xdynamics.elementary import FUNCTIONS
from xdynamics.kernels.compiling import PLAIN
from xdynamics.kernels.law import CONTROL
from xdynamics.kernels.program import AT, UNSOUND
from xdynamics.march.handle import applied_plainly, called_plainly, noted_plainly
from xdynamics.march.run import ARRAYS, HAPPEN, KINDS, NOW, PLAN, SUBSTEP, Run

_KNOWN: dict[Any, Callable[..., Any]] = {}


def plain(function: Any) -> Callable[..., Any]:
    """Return a compiled phase, and all that it calls, as the Python that is written there."""
    python = getattr(function, "py_func", function)
    if python not in _KNOWN:
        scope: dict[str, Any] = {}
        _KNOWN[python] = FunctionType(python.__code__, scope, python.__name__, python.__defaults__)
        for name, value in python.__globals__.items():
            scope[name] = plain(value) if hasattr(value, "py_func") else value
        scope |= {
            "called": called_plainly,
            "noted": noted_plainly,
            "applied": applied_plainly,
            "run_at": lambda run: run,
            "entered_by": lambda entry, *given: PLAIN[int(entry)](*given),
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
    made = {
        name: np.zeros(shapes.get(name, sizes.get(name, 0)), dtype)
        for name, (dtype, _) in ((one, KINDS[kind]) for one, kind in ARRAYS.items())
    }
    run = Run(**made | arrays)
    run.plan[0].used, run.plan[0].state, run.plan[0].coordinates = 2 * n, 3 * n, n
    run.plan[0].end, run.plan[0].most_steps = 10.0, 1e6
    if "law" not in arrays:
        run.put(law=law_of(*[kept] * 7))
    run.now[0].on_grid, run.now[0].status, run.now[0].rows = 1, -1, 1
    return run


def kept(*arrays: Any) -> None:
    """A row of the log without energies: time, step size, the state."""
    at, y, row = arrays[0], arrays[1], arrays[5]
    row[0], row[1], row[2:5], at[UNSOUND] = at[0], at[2], y[:3], 0.0


def law_of(*functions: Callable[..., None]) -> Any:
    """Put plain functions behind addresses."""
    import numpy as np

    first = max(PLAIN, default=0) + 1
    PLAIN.update({first + i: one for i, one in enumerate([*(FUNCTIONS[name] for name in CONTROL), *functions])})
    return np.arange(first, first + len(CONTROL) + len(functions), dtype=np.int64)


def entries() -> Any:
    """Put what is called by address behind the elementary functions, as plain Python."""
    import numpy as np

    from xdynamics.march import proposing

    found = np.zeros(HAPPEN + 1, np.int64)
    found[SUBSTEP] = max(PLAIN, default=0) + 1
    PLAIN[int(found[SUBSTEP])] = plain(proposing.part_of_step)
    return found


__all__ = ["NOW", "PLAN", "entries", "kept", "law_of", "made_by_hand", "plain"]

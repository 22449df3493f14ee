"""Joining the march's loop with the functions generated for one model and one method."""

from __future__ import annotations

from types import FunctionType, ModuleType
from typing import Any

from xdynamics.kernels.compiling import borrowed, compiled
from xdynamics.march import control, events, log, loop
from xdynamics.march.finite import all_finite

ROOMS: tuple[ModuleType, ...] = (log, control, events, loop)


def bind(name: str, generated: dict[str, Any]) -> Any:
    """Return a function of the march that calls the generated functions, compiled.

    Every plain function of the march's modules is made anew with the generated names as its globals: the code is the
    one that can be read there, and calls what stands in `generated`.

    Parameters
    ----------
    name : str
        The function to return, of `xdynamics.march.loop`.
    generated : dict
        The namespace of the generated module.
    """
    joined: dict[str, Any] = {}
    for room in ROOMS:
        joined |= {key: value for key, value in vars(room).items() if not key.startswith("__")}
    joined |= {key: value for key, value in generated.items() if not key.startswith("__")}
    for room in ROOMS:
        for key, function in _functions_of(room):
            joined[key] = compiled(FunctionType(function.__code__, joined, key, function.__defaults__))
    return joined[name]


def _functions_of(room: ModuleType) -> list[tuple[str, FunctionType]]:
    """Return the functions that a module defines itself."""
    mine = [(key, one) for key, one in vars(room).items() if isinstance(one, FunctionType)]
    return [(key, one) for key, one in mine if one.__module__ == room.__name__]


@compiled
def lend_plan(plan: log.Plan, tables: Any) -> log.Plan:
    """Return the plan with arrays that are not counted."""
    return log.Plan(plan.start, plan.step_size, borrowed(plan.grid), borrowed(plan.steps), plan.control,
                    borrowed(plan.nodes), plan.snap, plan.directions, plan.tolerances, plan.stops, plan.parameters,
                    tables, plan.sampled)  # fmt: skip


@compiled
def lend_log(blocks: log.Log) -> log.Log:
    """Return the log with arrays that are not counted."""
    return log.Log(borrowed(blocks.rows), borrowed(blocks.row_flags), borrowed(blocks.samples),
                   borrowed(blocks.trials), borrowed(blocks.events), borrowed(blocks.lows))  # fmt: skip


__all__ = ["ROOMS", "all_finite", "bind", "lend_log", "lend_plan"]

"""What went wrong in the step that ended a run: the first thing that was not finite, by name."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels.stepping import MOST_ITERATIONS
from xdynamics.march import outcomes
from xdynamics.march.outcomes import (
    NONFINITE,
    NONFINITE_EVENT,
    NONFINITE_FORCE,
    NONFINITE_OBSERVABLE,
    OUTCOMES,
    OUTSIDE_TABLE,
    Outcome,
)
from xdynamics.march.retrace import retraced, undefined_part
from xdynamics.march.settings import UNSCALED
from xdynamics.methods.stability import stiffness
from xdynamics.model import Function
from xdynamics.schema import force, rate, velocity
from xdynamics.units import TIME

if TYPE_CHECKING:
    from xdynamics.march.log import Log, Tally
    from xdynamics.march.runner import March

FEW_ROWS = 100  # of a run, from which on stiffness is looked for


@dataclass(frozen=True)
class Failure:
    """A bad outcome with its cause."""

    outcome: Outcome
    cause: str


def diagnose(march: March, log: Log, base: Tally) -> Failure:
    """Name what ended a run.

    The step that failed is made again in plain Python, and the first thing in it that is not finite tells. Where that
    is not possible, in equations that are solved, the state that was proposed has to do.
    """
    memory = march.memory
    if memory.status == NONFINITE_EVENT:
        named = zip(march.model.events, memory.values, strict=True)
        cause = ", ".join(f"the function of event '{name}' is {value}" for name, value in named if not isfinite(value))
        return Failure(OUTCOMES[NONFINITE_EVENT], cause)
    if memory.status == NONFINITE_OBSERVABLE:
        return _in_row(march, log, base)
    if memory.status not in (NONFINITE, outcomes.UNSOLVED):
        return Failure(OUTCOMES[memory.status], _cause(march))
    for values in retraced(march):
        if failure := _in_evaluation(march, values):
            return failure
    if memory.status == outcomes.UNSOLVED:
        return Failure(OUTCOMES[memory.status], _cause(march))
    return _in_state(march, dict(zip(march.layout.state, memory.trial, strict=True)))


def advice_on_stiffness(march: March, rows: NDArray[np.float64]) -> str:
    """Say so where an explicit method's chosen steps stand at the edge of its region of stability for most of a run.

    Parameters
    ----------
    march : March
    rows : ndarray, shape (2 + n, k)
        Time, step and state of some rows of the run, in internal units.
    """
    method, model, names = march.settings.method, march.model, march.layout.used
    if not march.settings.adaptive or method.implicit or model.python_forces or march.memory.tally.rows < FEW_ROWS:
        return ""
    scales = march.settings.scales
    time, factors = scales.of(TIME), [scales.of(model.dimensions[name]) for name in names]

    def limited(chosen: NDArray[np.float64]) -> float:
        states = [
            {"t": t * time} | {name: x * f for name, x, f in zip(names, state, factors, strict=True)}
            for t, _, *state in chosen.T.tolist()
        ]
        return stiffness(model, method, states, (chosen[1] * time).tolist())

    # one row first: it costs a millisecond, and most runs are not stiff
    middle = rows.shape[1] // 2
    if limited(rows[:, middle : middle + 1]) and limited(rows) > 0.5:
        return (
            f"; stiffness suspected: stability, not accuracy, limits the steps of '{method.name}' for most of the run;"
            " radau_iia takes longer ones"
        )
    return ""


def _cause(march: March) -> str:
    """Say in words why a march that met nothing infinite cannot go on."""
    norm, control = march.memory.norm, march.plan.control
    match march.memory.status:
        case outcomes.ERROR_AT_MINIMUM:
            return f"the error test fails at the minimum step, with norm {norm:.3g}; the tolerance or the minimum step does not suit the model"
        case outcomes.STEP_LIMIT:
            return f"{control.most_steps:.0f} accepted steps and rejected trials are used up; raise max_steps or the tolerances"
        case outcomes.UNSOLVED:
            remedy = "the model is not smooth enough here" if control.adaptive else "take a shorter step"
            return f"Newton's method, of at most {MOST_ITERATIONS} iterations, does not solve the step's equations; {remedy}"
        case outcomes.STEP_TOO_SMALL if control.adaptive and norm > 1.0:
            return (
                f"the error test fails, with norm {norm:.3g}, at the shortest step that t resolves; the solution has a"
                " singularity here, or t is too large for its time scale"
            )
        case outcomes.STEP_TOO_SMALL:
            return "t + h is t in double precision; take a longer step or an earlier t"
    return ""


def _in_row(march: March, log: Log, base: Tally) -> Failure:
    """Name the energy or observable of the row that was noted last and not kept."""
    at = 0 if march.memory.h == 0.0 else march.memory.tally.rows - base.rows
    column = dict(zip(march.layout.row, log.rows[:, at].tolist(), strict=True))
    bad = [f"{name} is {column[name]}" for name in march.layout.derived if not isfinite(column[name])]
    for name in march.layout.drives:
        if _leaves(march, name, march.memory.trial):
            return Failure(
                OUTSIDE_TABLE, f"{', '.join(bad)}: {_outside(march, name, _asked(march, name, march.memory.trial))}"
            )
    return Failure(OUTCOMES[NONFINITE_OBSERVABLE], ", ".join(bad))


def _asked(march: March, name: str, state: tuple[float, ...]) -> float:
    """What a drive is asked at, at the end of the step last tried, in internal units; without a state, by the old velocity."""
    memory, argument = march.memory, march.model.drives[name].argument
    if argument == "t":
        return memory.t + memory.h
    at = march.layout.state.index(argument)
    if isfinite(state[at]) or argument in march.layout.velocities:
        return state[at]
    return memory.state[at] + memory.h * memory.state[march.layout.state.index(velocity(argument))]


def _leaves(march: March, name: str, state: tuple[float, ...]) -> bool:
    drive = march.model.drives[name]
    scale = march.settings.scales.of(march.model.dimensions[drive.argument])
    asked = _asked(march, name, state) * scale
    return drive.outside == "error" and not drive.table.argument[0] <= asked <= drive.table.argument[-1]


def _in_evaluation(march: March, values: dict[str, float]) -> Failure | None:
    """Judge one force evaluation: the state it used, the drives, the force terms, the rates."""
    layout, model = march.layout, march.model
    when = f"in the evaluation at t = {values['t'] * march.settings.scales.of(TIME):.15g} s"
    for name in layout.used:
        if not isfinite(values[name]):
            return Failure(OUTCOMES[NONFINITE], f"{name} is {values[name]} {when}")
    for name in layout.drives:
        if not isfinite(values[name]):
            return Failure(OUTSIDE_TABLE, _outside(march, name, values[model.drives[name].argument]))
    trees = {force(term, one): tree for term, parts in model.force_components.items() for one, tree in parts.items()}
    trees |= {rate(name): state.rate for name, state in model.states.items()}
    for name, tree in trees.items():
        if not isfinite(values[name]):
            why = "" if isinstance(tree, Function) else undefined_part(model.expanded(tree), values)
            why = why if march.settings.scales == UNSCALED else ""  # in SI numbers, or not at all
            return Failure(NONFINITE_FORCE, f"{name} is {values[name]} {when}" + (f": {why}" if why else ""))
    return None


def _outside(march: March, name: str, asked: float) -> str:
    drive = march.model.drives[name]
    asked *= march.settings.scales.of(march.model.dimensions[drive.argument])
    low, high = drive.table.argument[0], drive.table.argument[-1]
    return (
        f"drive '{name}' was asked at {drive.argument} = {asked:.15g}, and its table '{drive.table.name}' reaches from"
        f' {low:.15g} to {high:.15g} (SI units); set outside = "zero" or "hold", or stay inside'
    )


def _in_state(march: March, state: dict[str, float]) -> Failure:
    """Judge a proposed state: drives, forces, then accelerations and what follows from them."""
    layout = march.layout
    for name in layout.drives:
        if _leaves(march, name, march.memory.trial):
            return Failure(OUTSIDE_TABLE, _outside(march, name, _asked(march, name, march.memory.trial)))
    for name in (*layout.forces, *layout.used):
        if not isfinite(state[name]):
            outcome = NONFINITE_FORCE if name in layout.forces else OUTCOMES[NONFINITE]
            return Failure(outcome, f"{name} is {state[name]}")
    for name in layout.rates:
        if not isfinite(state[name]):
            return Failure(NONFINITE_FORCE, f"{name} is {state[name]}")
    bad = [name for name in layout.accelerations if not isfinite(state[name])]
    return Failure(
        NONFINITE_FORCE, f"{', '.join(bad)} is not finite with finite forces: the mass is not positive definite"
    )

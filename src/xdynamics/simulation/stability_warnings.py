"""The warning of a fixed step that is beyond the stability limit of its method."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from xdynamics.faults import InputError, StabilityWarning, warn
from xdynamics.kernels.model_programs import has_loops
from xdynamics.march import Settings
from xdynamics.march.timescales import SLOW, beyond_eigenvalues, jacobian_at_start
from xdynamics.methods import METHODS, Method
from xdynamics.model import Model
from xdynamics.model.linearisation import initial_state, linearise
from xdynamics.model.tangent_space import free_coordinates
from xdynamics.stability import LinearSystem, fastest_rate, grows_at, stable_step_of, surely_stable
from xdynamics.units import unit_suffix

if TYPE_CHECKING:
    from xdynamics.simulation.wanted_states import Floats

OFTEN_STABLE = ("velocity_verlet", "rk4", "dormand_prince")  # named where another method is not
FEW_NUMBERS = 64  # of a state up to which the limit is found though errors do not grow: gaps below a step are met, too
SAFE_STEP = 0.1  # over the fastest time scale: stable for long with every method of order 2 and more


def warn_of_instability(model: Model, settings: Settings) -> None:
    """Warn once if a fixed step is beyond the method's stability limit at the initial state, as `modes` reports it."""
    step, method = settings.step, settings.method
    if not isinstance(step, float | int) or settings.adaptive or model.python_forces or model.delays:
        return
    if beyond_eigenvalues(model):
        return
    start = _Start(model, method, settings)
    jacobian, span = _start_jacobian(start), settings.until - model.statement.initial["t"].si
    if jacobian is None:
        return
    if method.order > 1:
        phase = step * _fastest_rate(start)
        if not (phase > SAFE_STEP or span / step * phase ** (method.order + 1) > 1.0):
            return
        if surely_stable(jacobian, method, free_coordinates(model), step):
            return
    unresolved = SLOW * _fastest_rate(start) if has_loops(model) else 0.0  # growth that differences may show
    if has_loops(model) and len(jacobian) > FEW_NUMBERS and not _grows(start, step, growth=unresolved):
        return
    limit, unit = _longest_stable_step(start, growth=unresolved), unit_suffix(model.time_unit)
    if limit > 0.0 and step > limit:
        warn(
            f"step {step:.6g}{unit} is beyond the stability limit {limit:.6g}{unit} of '{method.name}'"
            f" for '{model.name}' at its start: errors grow from step to step; take a shorter step, or see"
            " xdynamics.modes(model) for the steps that other methods allow",
            StabilityWarning,
        )
    elif limit == 0.0 and step > (longest := _longest_stable_step(start, growth=1.0 / span)):
        warn(
            f"no step of '{method.name}' is stable for '{model.name}' at its start, however short: errors grow from step"
            f" to step. Within this run of {span:.6g}{unit}, a step of {step:.6g}{unit} multiplies them by more than e"
            f" (2.7), one of up to {longest:.3g}{unit} by less; {_stable_methods(start, unit)}",
            StabilityWarning,
        )


def _stable_methods(start: _Start, unit: str) -> str:
    """Name some methods that are stable for a model, with their longest steps."""
    starts = {name: _Start(start.model, METHODS[name], start.settings) for name in OFTEN_STABLE}
    limits = {name: _longest_stable_step(method_start) for name, method_start in starts.items() if method_start.fits}
    stable = [f"{name} (up to {limit:.3g}{unit})" for name, limit in limits.items() if 0.0 < limit < np.inf]
    stable_text = f"stable are {', '.join(stable)}; " if stable else ""
    return f"{stable_text}xdynamics.modes(model) has the limits of all methods"


@dataclass(frozen=True)
class _Start:
    """The start of a run; its Jacobian and steps that are stable there depend on model and method alone."""

    model: Model
    method: Method
    settings: Settings = field(compare=False)

    @property
    def fits(self) -> bool:
        """Whether the method takes the model."""
        return not self.method.refusals(self.model)


@lru_cache(maxsize=64)
def _start_jacobian(start: _Start) -> Floats | None:
    """Return the Jacobian, of a law in loops by differences: trees of its elements would take longer than the run."""
    return jacobian_at_start(start.model, start.settings) if has_loops(start.model) else _linearised(start.model)


@lru_cache(maxsize=64)
def _fastest_rate(start: _Start) -> float:
    """Bound the size of every eigenvalue of the Jacobian, found once."""
    jacobian = _start_jacobian(start)
    return np.inf if jacobian is None else fastest_rate(jacobian)


@lru_cache(maxsize=64)
def _linearised(model: Model) -> Floats | None:
    """Linearise a model at its start; None where that is not possible."""
    try:
        return linearise(model, initial_state(model)).reduced
    except InputError:
        return None  # the march will say what is wrong with the forces at the start


@lru_cache(maxsize=256)
def _grows(start: _Start, step: float, *, growth: float) -> bool:
    """Whether errors grow at the step itself."""
    jacobian = _start_jacobian(start)
    return jacobian is not None and grows_at(
        LinearSystem.from_jacobian(jacobian, free_coordinates(start.model)), start.method, step, growth=growth
    )


@lru_cache(maxsize=256)
def _longest_stable_step(start: _Start, *, growth: float = 0.0) -> float:
    """Return the largest stable step of a method at a model's start, found once by trying some hundred."""
    jacobian = _start_jacobian(start)
    assert jacobian is not None  # noqa: S101 - who asks has seen it
    system = LinearSystem.from_jacobian(jacobian, free_coordinates(start.model))
    return stable_step_of(system, start.method, start.model, growth=growth)

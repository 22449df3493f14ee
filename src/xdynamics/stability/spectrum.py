"""Time scales of a linearised model, and the steps that they leave to each method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import text_of
from xdynamics.expressions.evaluation import evaluate
from xdynamics.faults import InputError
from xdynamics.methods import METHODS
from xdynamics.methods.method import Method
from xdynamics.model import Model
from xdynamics.model.linearisation import (
    Linearisation,
    count_of_changes,
    free_coordinates,
    independent_counts,
    linearise,
)
from xdynamics.model.motion import constants
from xdynamics.stability.amplification import Complexes, Floats, LinearSystem
from xdynamics.stability.limits import decay_limit, oscillator_limit, stable_step_of
from xdynamics.stability.normal_modes import MANY, NormalModes
from xdynamics.units import unit_suffix

MOST_SHOWN = 4  # rows of a matrix in a message
RIGID = 1e-13  # squares of frequencies below this fraction of the largest are zero but for round-off
STEPS_A_PERIOD = 20  # of the shortest time scale, in a step to begin with
NOTHING = LinearSystem.from_jacobian(np.zeros((0, 0)), 0)
GROWTH = 0.01  # in that time scale, which is let pass


@dataclass(frozen=True)
class Spectrum:
    """Eigenvalues, modes and time scales of a linearisation.

    Attributes
    ----------
    frequency, period : ndarray, shape (modes,)
    shapes : ndarray, shape (coordinates, modes)
    eigenvalues : ndarray of complex, shape (variables,)
    system : LinearSystem
        What methods are applied to.
    """

    frequency: Floats
    period: Floats
    shapes: Floats
    eigenvalues: NDArray[np.complex128]
    system: LinearSystem

    @classmethod
    def of(cls, model: Model, linearisation: Linearisation) -> Spectrum:
        """Return the eigenvalues and modes of a linearised model."""
        jacobian, space = linearisation.reduced, linearisation.displacements
        normal = NormalModes.from_matrices(*linearisation.displacement_matrices)
        squares, shapes = _squares_and_shapes(normal, space)
        free = len(space) == space.shape[1]
        clean = replace(normal, squares=squares) if free and len(squares) >= MANY else None
        eigenvalues = np.linalg.eigvals(jacobian) if clean is None else clean.eigenvalues(jacobian)
        eigenvalues = eigenvalues.astype(np.complex128)[np.lexsort((eigenvalues.imag, np.abs(eigenvalues)))]
        real = np.where((squares.imag == 0.0) & (squares.real >= 0.0), squares.real, np.nan)
        frequency = np.sqrt(real)
        period = np.divide(2.0 * np.pi, frequency, out=np.full_like(frequency, np.inf), where=frequency != 0.0)
        system = LinearSystem.from_jacobian(jacobian, free_coordinates(model), eigenvalues, clean)
        return cls(frequency, period, shapes, eigenvalues, system)

    @classmethod
    def blank(cls, model: Model) -> Spectrum:
        """Return one of the right sizes, before anything is computed."""
        n = len(model.elements.statement.coordinates)
        modes = np.full(n - independent_counts(model)[0], np.nan)
        return cls(
            modes, modes, np.tile(modes, (n, 1)), np.full(count_of_changes(model), np.nan, np.complex128), NOTHING
        )

    @property
    def fastest(self) -> float:
        """One over the largest eigenvalue, s; inf if all are zero."""
        largest = float(np.max(np.abs(self.eigenvalues), initial=0.0))
        return 1.0 / largest if largest else np.inf

    @property
    def resolved(self) -> float:
        """The time that a step must resolve, s: of the fastest oscillation or growth, else of the slowest decay."""
        sizes = np.abs(self.eigenvalues)
        moving = sizes > 0.0
        lively = moving & (self.eigenvalues.real > -np.abs(self.eigenvalues.imag))
        if lively.any():
            return float(2.0 * np.pi / sizes[lively].max())
        return float(2.0 * np.pi / sizes[moving].min()) if moving.any() else np.inf

    def suggested_step(self, method: Method, model: Model) -> float:
        """Return the step to begin with, s; nan where the method refuses the model.

        It is the lesser of a twentieth of `resolved` and half the largest step with which no mode grows by more than a
        hundredth in that time.
        """
        step = self.resolved / STEPS_A_PERIOD
        growing = stable_step_of(self.system, method, model, growth=GROWTH / self.resolved, at_most=2.0 * step)
        return float(np.minimum(step, growing / 2.0))


def _squares_and_shapes(normal: NormalModes, space: Floats) -> tuple[Complexes, Floats]:
    """Return squares of frequencies without round-off, and shapes as columns, the largest number of each 1."""
    n, squares, shapes = len(normal.squares), normal.squares.copy(), space @ normal.shapes
    if n == 0:
        return squares, space
    squares[np.abs(squares) <= n * RIGID * np.abs(squares).max()] = 0.0
    squares.imag[np.abs(squares.imag) <= n * RIGID * np.abs(squares).max()] = 0.0
    largest = shapes[np.argmax(np.abs(shapes), axis=0), np.arange(n)]
    return squares, shapes / largest


def methods_by_step(steps: Mapping[str, float]) -> dict[str, list[str]]:
    """Return the methods of each step, which is written with two digits; without those that have none.

    Examples
    --------
    >>> methods_by_step({"rk4": 0.1, "heun": 0.101, "midpoint": 0.05, "taylor": float("nan")})
    {'0.1': ['rk4', 'heun'], '0.05': ['midpoint']}
    """
    grouped: dict[str, list[str]] = {}
    for name, step in steps.items():
        if 0.0 < step < np.inf:
            grouped.setdefault(f"{float(f'{step:.2g}'):g}", []).append(name)
    return grouped


@dataclass(frozen=True)
class StepLimits:
    """The steps that each method may take, in the order of `METHODS`; nan where one refuses the model.

    Attributes
    ----------
    oscillator, decay : ndarray, shape (methods,)
        The largest stable step over the time of an undamped oscillation, and of a decay.
    stable, suggested : ndarray, shape (methods,), s
        At this state.
    """

    oscillator: Floats
    decay: Floats
    stable: Floats
    suggested: Floats

    @classmethod
    def of(cls, model: Model, spectrum: Spectrum) -> StepLimits:
        """Return the limits of every method at a state."""
        methods, system = list(METHODS.values()), spectrum.system
        return cls(
            np.array([oscillator_limit(method) for method in methods]),
            np.array([decay_limit(method) for method in methods]),
            np.array([stable_step_of(system, method, model) for method in methods]),
            np.array([spectrum.suggested_step(method, model) for method in methods]),
        )

    @classmethod
    def blank(cls) -> StepLimits:
        """Return one of the right sizes, before anything is computed."""
        return cls(*[np.full(len(METHODS), np.nan)] * 4)


def checked_linearisation(model: Model, state: Mapping[str, float]) -> Linearisation:
    """Linearise a model about a state at which its motion is defined.

    Raises
    ------
    InputError
        If a force is written in Python, a drive has no value there, the mass matrix is not positive definite, or a
        derivative is not finite.
    """
    linearisation = linearise(model, dict(state))
    _check_state(model, linearisation, state)
    _check_finite(model, linearisation, state["t"])
    return linearisation


def _check_state(model: Model, linearisation: Linearisation, state: Mapping[str, float]) -> None:
    """Refuse a state at which a drive has no value or the mass matrix is not positive definite."""
    for name, drive in model.elements.drives.items():
        low, high = float(drive.table.argument[0]), float(drive.table.argument[-1])
        drive_argument = evaluate(model.elements.expanded(drive.argument), {**constants(model), **state})
        if drive.outside == "error" and not low <= drive_argument <= high:
            raise InputError(
                f"model '{model.name}' cannot be linearised: drive '{name}' has no value at {text_of(drive.argument)} ="
                f" {drive_argument:.15g}, its table reaches from {low:.15g} to {high:.15g} (SI units)"
            )
    try:
        np.linalg.cholesky(linearisation.mass)
    except np.linalg.LinAlgError:
        raise InputError(
            f"model '{model.name}' cannot be linearised at t = {state['t']!r}{unit_suffix(model.time_unit)}: its mass matrix"
            f" {_mass_matrix_text(linearisation.mass)} is not positive definite there"
        ) from None


def _mass_matrix_text(mass: Floats) -> str:
    """Show a mass matrix, a large one by its size and least eigenvalue."""
    if len(mass) <= MOST_SHOWN:
        return str(mass.tolist())
    return f"of {len(mass)} rows, least eigenvalue {np.linalg.eigvalsh(mass)[0]:.6g} (SI units),"


def _check_finite(model: Model, linearisation: Linearisation, t: float) -> None:
    wrong = np.argwhere(~np.isfinite(linearisation.jacobian))
    if wrong.size:
        i, j = (int(index) for index in wrong[0])
        raise InputError(
            f"model '{model.name}' cannot be linearised at t = {t!r}{unit_suffix(model.time_unit)}: the rate of"
            f" {linearisation.names[i]} has the derivative {linearisation.jacobian[i, j]} by {linearisation.names[j]};"
            " choose another state with at=… or row=…"
        )

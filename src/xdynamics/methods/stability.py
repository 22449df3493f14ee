"""How large a step a method bears, computed from the lines of its update applied to linear systems."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import Binary, Call, Name, Negative, Node, Number, exponent_of, text_of
from xdynamics.expressions.evaluation import evaluate
from xdynamics.faults import InputError
from xdynamics.methods.method import SCALARS, Evaluation, Line, Method, Solve
from xdynamics.model import Model, Trait
from xdynamics.model.linearisation import linearise, linearise_each

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Vectors = dict[str, Any]

ROUND_OFF = 1e-12  # growth of one step that counts as none
AT_REST = 1e-6  # a mode that one step changes by less tells nothing: it is at rest, or far slower than the step
SLOWEST = 1e-7  # eigenvalues below this fraction of the largest are zero but for round-off
SMALLEST, FINER, LARGEST = 1e-5, 1e-2, 1e4  # steps that are tried, over the fastest time scale
CHUNK = 256
_ARITHMETIC: dict[str, Callable[[Any, Any], Any]] = {
    "+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv,
}  # fmt: skip


@dataclass(frozen=True)
class LinearSystem:
    """q' = v, a = A (q, v, x), r = R (q, v, x), in units of time in which the fastest eigenvalue has size 1.

    Attributes
    ----------
    acceleration : ndarray, shape (n, 2n + m)
    rate : ndarray, shape (m, 2n + m)
    eigenvalues : ndarray of complex, shape (2n + m,)
        Zero where they are zero but for round-off.
    fastest : float, s-1
        Size of the fastest eigenvalue before the time was scaled.
    """

    acceleration: Floats
    rate: Floats
    eigenvalues: Complexes
    fastest: float

    @classmethod
    def of(cls, jacobian: Floats, coordinates: int) -> LinearSystem:
        """Scale the Jacobian of (q, v, x), of which the first `coordinates` are q."""
        n = coordinates
        eigenvalues = np.linalg.eigvals(jacobian) if jacobian.size else np.zeros(0)
        fastest = float(np.max(np.abs(eigenvalues), initial=0.0))
        time = 1.0 / fastest if fastest > 0.0 else 1.0
        eigenvalues = np.where(np.abs(eigenvalues) < SLOWEST * fastest, 0.0, eigenvalues * time).astype(np.complex128)
        scaled = np.array(jacobian, dtype=np.float64)
        scaled[:n] *= time
        scaled[n:] *= time
        scaled[:, n : 2 * n] /= time
        scaled[n : 2 * n] *= time
        return cls(scaled[n : 2 * n], scaled[2 * n :], eigenvalues, fastest)

    @property
    def growing(self) -> NDArray[np.bool_]:
        """Which modes grow in the system itself."""
        return self.eigenvalues.real > AT_REST

    @property
    def stiffness(self) -> Floats | None:
        """K of a system that is nothing but q'' = -K q; None of another."""
        n = len(self.acceleration)
        return None if self.acceleration[:, n:].any() or self.rate.any() else -self.acceleration[:, :n]


Growth = Callable[[Floats], Floats]  # by step; above 1 it is growth
OSCILLATOR = LinearSystem.of(np.array([[0.0, 1.0], [-1.0, 0.0]]), 1)
DRAGGED = LinearSystem.of(np.array([[0.0, 1.0], [0.0, -1.0]]), 1)
DECAY, GROWTH = (LinearSystem.of(np.array([[rate]]), 0) for rate in (-1.0, 1.0))


@cache
def oscillator_limit(method: Method) -> float:
    """Return the largest w h below which q'' = -w**2 q stays bounded for every step.

    Returns
    -------
    float
        2 for velocity Verlet, sqrt(8) for the classical Runge-Kutta method; 0 where every step makes it grow, inf where
        none does.

    Notes
    -----
    Hairer and Wanner, Solving Ordinary Differential Equations II, section IV.2; the linear test of splitting methods
    in Hairer, Lubich and Wanner, section I.5. The factors of a step stand on the unit circle for conservative
    methods; growth below 1e-12 a step is taken for round-off if it stays there.
    """
    return _largest_step(partial(_growth, method, OSCILLATOR), 1.005)


@cache
def decay_limit(method: Method) -> float:
    """Return the largest h over the decay time below which y' = -y/tau stays bounded for every step.

    Returns
    -------
    float
        For a velocity under linear drag and for a first-order state, whichever is less; 2 for forward Euler, inf for an
        A-stable method, nan for a method that refuses both.

    Notes
    -----
    The real stability interval of Hairer and Wanner II, section IV.2.
    """
    tests = ((Trait.VELOCITY_DEPENDENT, DRAGGED), (Trait.COUPLED_STATES, DECAY))
    systems = [system for trait, system in tests if trait not in method.refuses]
    return min((_largest_step(partial(_growth, method, system), 1.005) for system in systems), default=np.nan)


def stable_step(model: Model, method: Method, state: Mapping[str, float]) -> float:
    """Return the largest step with which a method is stable for a model linearised about a state.

    Parameters
    ----------
    model : Model
    method : Method
    state : mapping of str to float
        SI numbers for `t`, coordinates, velocities and first-order states.

    Returns
    -------
    float, s
        inf where every step is, 0 where none is; nan where the method refuses the model, or the linearisation is not
        finite.

    Raises
    ------
    InputError
        If a force is written in Python, or the state lacks a number.
    """
    found = linearise(model, state)
    return stable_step_of(found.jacobian, method, model)


def stable_step_of(jacobian: Floats, method: Method, model: Model) -> float:
    """Return the same as `stable_step`, from a Jacobian that is known already."""
    if method.refusals(model) or not np.isfinite(jacobian).all():
        return float(np.nan)
    system = LinearSystem.of(jacobian, len(model.coordinates))
    if system.fastest == 0.0:
        return np.inf
    # an oscillation that grows by itself has no limit of growth; its frequency has to be borne all the same
    frequency = float(np.max(np.abs(system.eigenvalues.imag), initial=0.0, where=system.growing))
    most = oscillator_limit(method) / frequency if frequency > AT_REST else np.inf
    return min(largest_step(method, system), most or np.inf) / system.fastest


def stiffness(model: Model, method: Method, states: Sequence[Mapping[str, float]], steps: Iterable[float]) -> float:
    """Return the fraction of rows at which stability of a fast decay limits the step.

    Parameters
    ----------
    model : Model
    method : Method
    states : sequence of mapping
        SI numbers of each row, as `stable_step` takes them.
    steps : iterable of float, s
        Step used at each row; rows without one do not count.

    Returns
    -------
    float
        Rows at which the fastest eigenvalue l that decays rather than oscillates (-Re l >= abs(Im l)) has -Re(l) h
        between 0.5 and 1.5 of `decay_limit`, over all rows; 0 for a method without such a limit.

    Raises
    ------
    InputError
        If a force is written in Python, or a state lacks a number.

    Notes
    -----
    Where the error test of an explicit method keeps its step at the edge of its region of stability, the problem is
    stiff: Hairer and Wanner II, section IV.2.
    """
    limit = decay_limit(method)
    moved = [(state, h) for state, h in zip(states, steps, strict=True) if h > 0.0]
    if not moved or not 0.0 < limit < np.inf:
        return 0.0
    limited = 0
    for found, (_, h) in zip(linearise_each(model, (state for state, _ in moved)), moved, strict=True):
        if np.isfinite(found.jacobian).all():
            eigenvalues = np.linalg.eigvals(found.jacobian)
            decays = -eigenvalues.real[-eigenvalues.real >= np.abs(eigenvalues.imag)]
            limited += bool(0.5 * limit <= float(np.max(decays, initial=0.0)) * h <= 1.5 * limit)
    return limited / len(moved)


def largest_step(method: Method, system: LinearSystem) -> float:
    """Return the largest step below which no mode grows that does not grow in the system itself.

    Returns
    -------
    float
        In units of the fastest time scale; 0 below 1e-5, inf above 1e4.

    Notes
    -----
    A method that treats all kinds of vector alike takes each eigenvalue by itself, and so does every method with the
    modes of q'' = -K q; of what is left the factors of the whole step are looked at.
    """
    if treats_alike(method):
        kept = system.eigenvalues[~system.growing & (system.eigenvalues != 0.0)]
        return _largest_step(partial(_growth_along, method, kept), 1.02)
    if system.stiffness is not None:
        squares = np.linalg.eigvals(system.stiffness)
        if np.all(np.abs(squares.imag) < AT_REST):
            fastest = float(np.max(squares.real, initial=0.0)) ** 0.5
            return oscillator_limit(method) / fastest if fastest > SLOWEST else np.inf
    return _largest_step(partial(_growth, method, system), 1.02 if len(system.eigenvalues) <= 16 else 1.1)


@cache
def treats_alike(method: Method) -> bool:
    """Whether coordinates, velocities and states are advanced by one rule, as Runge-Kutta methods do for y' = k."""
    if not {Trait.VELOCITY_DEPENDENT, Trait.COUPLED_STATES, Trait.NO_COORDINATES}.isdisjoint(method.refuses):
        return False
    jacobian = np.array([[0.0, 1.0, 0.0], [-0.7, -0.2, 0.4], [0.3, 0.5, -0.6]])
    h = np.array([0.3, 0.9])
    first, second = (amplification(method, LinearSystem.of(jacobian, n), h) for n in (1, 0))
    scale = np.diag([1.0, LinearSystem.of(jacobian, 1).fastest, 1.0])
    return bool(np.allclose(np.linalg.inv(scale) @ second @ scale, first, rtol=0.0, atol=1e-12))


def amplification(method: Method, system: LinearSystem, h: NDArray[Any]) -> NDArray[Any]:
    """Return the matrix that one step of each size applies to (q, v, x), by running the method's lines.

    Parameters
    ----------
    method : Method
    system : LinearSystem
    h : ndarray, shape (k,)
        Steps, in the system's unit of time; complex ones give the stability function.

    Returns
    -------
    ndarray, shape (k, 2n + m, 2n + m)

    Notes
    -----
    Accelerations and rates at the start of the step are those of the state there. A method that ends with those of
    another state must refuse the forces that would tell.
    """
    n, m = len(system.acceleration), len(system.rate)
    size = 2 * n + m
    start = np.eye(size)
    state = {"q": start[:n], "v": start[n : 2 * n], "x": start[2 * n :]}
    step = h[:, None, None]
    given = state | {"a": system.acceleration, "r": system.rate, "h": step, "t": 0.0, "t1": step}
    end = _run(method.statements, given, system)
    parts = [np.broadcast_to(end[name], (len(h), rows, size)) for name, rows in (("q1", n), ("v1", n), ("x1", m))]
    return np.concatenate(parts, axis=1)


def _largest_step(growth: Growth, ratio: float) -> float:
    """Find the least step with growth; steps of this ratio are tried before bisection."""
    low, high = _bracket(growth, ratio)
    if low == 0.0 or high == np.inf:
        return low
    while high - low > 1e-13 * high:
        middle = (low + high) / 2.0
        if growth(np.array([middle]))[0] > 1.0:
            high = middle
        else:
            low = middle
    # growth that only now comes out of round-off was there for every smaller step
    return low if growth(np.array([1.01 * high]))[0] > 2.0 else 0.0


def _bracket(growth: Growth, ratio: float) -> tuple[float, float]:
    """Return a stable step and the unstable one next to it; (0, …) where none is stable, (inf, inf) where all are."""
    fine = np.geomspace(FINER, LARGEST, 2 + int(np.log(LARGEST / FINER) / np.log(ratio)))
    tried = np.concatenate([np.geomspace(SMALLEST, FINER, 20)[:-1], fine])
    for first in range(0, len(tried), CHUNK):
        unstable = np.flatnonzero(growth(tried[first : first + CHUNK]) > 1.0)
        if unstable.size:
            at = first + int(unstable[0])
            return (float(tried[at - 1]) if at else 0.0), float(tried[at])
    return np.inf, np.inf


def _growth(method: Method, system: LinearSystem, h: Floats) -> Floats:
    """Return how much a step makes a mode grow that does not grow in the system, over what round-off may do."""
    factors = _eigenvalues(amplification(method, system, h))
    moved = np.abs(system.eigenvalues) * h[:, None]
    at_rest = np.sum(moved < AT_REST, axis=1)
    growing = np.sum((moved >= AT_REST) & system.growing, axis=1)
    # position and velocity of a slow mode are nearly parallel eigenvectors, and its factors less exact
    slowest = np.min(moved, axis=1, initial=1.0, where=moved >= AT_REST)
    growth = (np.abs(factors) - 1.0) / ((1.0 + h * h) * ROUND_OFF * (1.0 + 0.1 / slowest))[:, None]
    growth[np.isnan(growth)] = np.inf
    place = np.arange(growth.shape[1])
    changes = np.argsort(np.argsort(np.abs(factors - 1.0), axis=1), axis=1)
    growth[changes < at_rest[:, None]] = -np.inf
    growth = np.sort(growth, axis=1)
    growth[place >= growth.shape[1] - growing[:, None]] = -np.inf
    return np.asarray(np.max(growth, axis=1, initial=-np.inf))


def _growth_along(method: Method, eigenvalues: Complexes, h: Floats) -> Floats:
    """Return the same for a method that takes each eigenvalue by itself: its stability function R(z) at z = h l."""
    z = (h[:, None] * eigenvalues).ravel()
    factors = amplification(method, GROWTH, z)[:, 0, 0].reshape(len(h), len(eigenvalues))
    growth = (np.abs(factors) - 1.0) / ((1.0 + h * h) * ROUND_OFF)[:, None]
    return np.asarray(np.max(np.where(np.isnan(growth), np.inf, growth), axis=1, initial=-np.inf))


def _eigenvalues(matrices: Floats) -> Complexes:
    """Return eigenvalues, nan of what is not finite; of 2 x 2 matrices by the quadratic formula.

    The formula keeps factors on the unit circle there where they are nearly equal, which an iteration does not.
    """
    finite = np.asarray(np.isfinite(matrices).all(axis=(1, 2)))
    matrices = np.where(finite[:, None, None], matrices, 0.0)
    if matrices.shape[1] == 2:
        half = (matrices[:, 0, 0] + matrices[:, 1, 1]) / 2.0
        determinant = matrices[:, 0, 0] * matrices[:, 1, 1] - matrices[:, 0, 1] * matrices[:, 1, 0]
        root = np.sqrt((half * half - determinant).astype(np.complex128))
        found: Complexes = np.stack([half - root, half + root], axis=1)
    else:
        found = np.linalg.eigvals(matrices).astype(np.complex128)
    found[~finite] = np.nan
    return found


def _run(lines: Iterable[Line], given: Vectors, system: LinearSystem) -> Vectors:
    """Run lines on matrices; their columns are the answers to each component of the state."""
    vectors = dict(given)
    for line in lines:
        if isinstance(line, Solve):
            vectors |= _solved(line, vectors, system)
            vectors = _run((*line.definitions, *line.evaluations), vectors, system)
        elif isinstance(line, Evaluation):
            at = [vectors[line.position], vectors[line.velocity], vectors[line.state]]
            vectors[line.acceleration], vectors[line.rate] = _applied(system, at)
        else:
            vectors[line.target] = _value(line.expression, vectors)
    return vectors


def _applied(system: LinearSystem, at: Sequence[Any]) -> tuple[Any, Any]:
    """Return accelerations and rates at coordinates, velocities and states."""
    n = len(system.acceleration)
    places = (slice(0, n), slice(n, 2 * n), slice(2 * n, None))
    return (
        sum(system.acceleration[:, place] @ one for place, one in zip(places, at, strict=True)),
        sum(system.rate[:, place] @ one for place, one in zip(places, at, strict=True)),
    )


def _solved(line: Solve, vectors: Vectors, system: LinearSystem) -> Vectors:
    """Solve u = A u + b: the lines are linear, so that they give b at u = 0, and A where all that is known is 0."""
    n, m, k = len(system.acceleration), len(system.rate), len(vectors["h"])
    sizes = [m if name[0] == "x" else n for name in line.unknowns]
    cuts = np.cumsum(sizes)[:-1]

    def answers(known: Vectors, unknown: Floats) -> Floats:
        inside = known | dict(zip(line.unknowns, np.split(unknown, cuts), strict=True))
        inside = _run((*line.definitions, *line.evaluations), inside, system)
        parts = [
            np.broadcast_to(_value(one.expression, inside), (k, size, unknown.shape[1]))
            for one, size in zip(line.equations, sizes, strict=True)
        ]
        return np.concatenate(parts, axis=1)

    total = sum(sizes)
    scalars = {name: vectors[name] for name in SCALARS if name in vectors}
    rest = {name: np.zeros((m if name[0] in "xr" else n, total)) for name in vectors if name not in scalars}
    matrix = np.eye(total) - answers(scalars | rest, np.eye(total))
    right = answers(vectors, np.zeros((total, 2 * n + m)))
    try:
        solution = np.linalg.solve(matrix, right)
    except np.linalg.LinAlgError:
        solution = np.full_like(right, np.nan)
    return dict(zip(line.unknowns, np.split(solution, cuts, axis=1), strict=True))


def _value(node: Node, vectors: Vectors) -> Any:
    """Return the value of a vector expression."""
    match node:
        case Number():
            return node.value
        case Name():
            return vectors[node.name]
        case Negative():
            return -_value(node.operand, vectors)
        case Binary(operator="**"):
            return _value(node.left, vectors) ** float(exponent_of(node.right) or 0)
        case Call():
            return evaluate(node, {})  # a constant, like sqrt(3)
        case Binary():
            return _ARITHMETIC[node.operator](_value(node.left, vectors), _value(node.right, vectors))
    raise InputError(f"'{text_of(node)}' is no part of a method's lines; they are linear in the vectors")

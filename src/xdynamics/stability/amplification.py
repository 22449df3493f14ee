"""The effect of one step of a method on a linear system, found by running the lines of its update."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import Binary, Call, Name, Negative, Node, Number, exponent_of, text_of
from xdynamics.expressions.evaluation import evaluate
from xdynamics.faults import InputError
from xdynamics.methods.lines import (
    SCALARS,
    ConstraintImpulse,
    Evaluation,
    Line,
    Solve,
    TaylorSeries,
    VectorStatement,
    Walker,
    read_lines,
)
from xdynamics.methods.method import Method
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.stability.normal_modes import SAME_SHAPES, NormalModes

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Vectors = dict[str, Any]

AT_REST = 1e-6  # a mode that one step changes by less says nothing: it is at rest, or far slower than the step
SLOWEST = 1e-7  # eigenvalues below this fraction of the largest are zero apart from round-off
WORST_SHAPES = 1e6  # condition of the matrix of modes, beyond which they are not told apart
_ARITHMETIC: dict[str, Callable[[Any, Any], Any]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
}


@dataclass(frozen=True)
class LinearSystem:
    """q' = v, a = A (q, v, x), r = R (q, v, x), in units of time in which the fastest eigenvalue has size 1.

    Attributes
    ----------
    acceleration : ndarray, shape (…, n, 2n + m)
    rate : ndarray, shape (…, m, 2n + m)
    eigenvalues : ndarray of complex, shape (…, 2n + m)
        Set to zero where they are zero apart from round-off; nan where a derivative is not finite.
    fastest : float, s-1
        Size of the fastest eigenvalue before time was scaled.
    normal : NormalModes, optional
        Those of the stiffness, where they are known, before time was scaled.
    """

    acceleration: Floats
    rate: Floats
    eigenvalues: Complexes
    fastest: float
    normal: NormalModes | None = None

    @classmethod
    def from_jacobian(
        cls, jacobian: Floats, coordinates: int, eigenvalues: Complexes | None = None, normal: NormalModes | None = None
    ) -> LinearSystem:
        """Scale the Jacobian of (q, v, x), of which the first `coordinates` are q; eigenvalues, modes may be known."""
        n = coordinates
        unscaled_values: Any = eigenvalues
        if unscaled_values is None:
            is_finite = jacobian.size and np.isfinite(jacobian).all()
            unscaled_values = np.linalg.eigvals(jacobian) if is_finite else np.full(len(jacobian), np.nan)
        fastest = float(np.max(np.abs(unscaled_values), initial=0.0))
        time = 1.0 / fastest if fastest > 0.0 else 1.0
        scaled_values = np.where(np.abs(unscaled_values) < SLOWEST * fastest, 0.0, unscaled_values * time).astype(
            np.complex128
        )
        scaled = np.array(jacobian, dtype=np.float64)
        scaled[:n] *= time
        scaled[n:] *= time
        scaled[:, n : 2 * n] /= time
        scaled[n : 2 * n] *= time
        return cls(scaled[n : 2 * n], scaled[2 * n :], scaled_values, fastest, normal)

    @property
    def growing(self) -> NDArray[np.bool_]:
        """A mask of the modes that grow in the system itself, shape (modes,)."""
        return self.eigenvalues.real > AT_REST

    @property
    def stiffness(self) -> Floats | None:
        """K of a system of the form q'' = -K q; None for any other."""
        n = len(self.acceleration)
        return None if self.acceleration[:, n:].any() or self.rate.any() else -self.acceleration[:, :n]

    @cached_property
    def squares(self) -> Complexes | None:
        """Squares of the frequencies of a system that has a stiffness."""
        if self.stiffness is None:
            return None
        if self.normal is not None and self.fastest > 0.0:
            return self.normal.squares / self.fastest**2
        return np.linalg.eigvals(self.stiffness).astype(np.complex128)

    @cached_property
    def separated_modes(self) -> tuple[Floats, Floats] | None:
        """Squares of frequencies, and damping between modes, without rates; None if modes cannot be separated."""
        n = len(self.acceleration)
        if n < 2 or self.rate.size or not np.isfinite(self.fastest) or self.fastest == 0.0:
            return None
        stiffness, damping = -self.acceleration[:, :n], -self.acceleration[:, n:]
        squares: Any
        shapes: Any
        if self.normal is not None and self.normal.symmetric:
            squares, shapes = self.normal.squares.real / self.fastest**2, self.normal.shapes
        else:
            symmetric = np.array_equal(stiffness, stiffness.T)
            solve: Callable[[Floats], tuple[Any, Any]] = np.linalg.eigh if symmetric else np.linalg.eig
            squares, shapes = solve(stiffness)
            if np.iscomplexobj(squares) or np.linalg.cond(shapes) > WORST_SHAPES:
                return None
        return squares, np.linalg.solve(shapes, damping @ shapes)

    @cached_property
    def modes(self) -> LinearSystem | None:
        """Systems of one coordinate, along a first axis, into which this system decouples; None without such a split.

        It does where damping has the modes of the stiffness, as c v has, and Rayleigh's of mass and stiffness.
        """
        if self.separated_modes is None:
            return None
        damped = self.separated_modes[1]
        is_coupled = np.abs(damped - np.diag(damped.diagonal())).max() > SAME_SHAPES
        return None if is_coupled else self.uncoupled

    @cached_property
    def uncoupled(self) -> LinearSystem | None:
        """The system of separate modes, without damping between them; None if modes cannot be separated."""
        if self.separated_modes is None:
            return None
        squares, modal_damping = self.separated_modes[0], self.separated_modes[1].diagonal()
        half = modal_damping / 2.0
        root = np.sqrt((half * half - squares).astype(np.complex128))
        eigenvalues = np.stack([-half - root, -half + root], axis=-1).astype(np.complex128)
        eigenvalues[np.abs(eigenvalues) < SLOWEST] = 0.0
        acceleration = np.stack([-squares, -modal_damping], axis=-1)[:, None, :]
        return LinearSystem(acceleration, np.zeros((len(modal_damping), 0, 2)), eigenvalues, self.fastest)

    def mode_subsystem(self, mode_indices: NDArray[np.intp]) -> LinearSystem:
        """Return the system in the coordinates of some modes, which damping joins."""
        assert self.separated_modes is not None  # noqa: S101 - who chooses modes has told them apart
        squares, damped = (
            self.separated_modes[0][mode_indices],
            self.separated_modes[1][np.ix_(mode_indices, mode_indices)],
        )
        n = len(mode_indices)
        acceleration = np.hstack([-np.diag(squares), -damped])
        if n == len(self.acceleration):
            return LinearSystem(acceleration, np.zeros((0, 2 * n)), self.eigenvalues, self.fastest)
        eigenvalues = np.linalg.eigvals(np.vstack([np.eye(n, 2 * n, n), acceleration])).astype(np.complex128)
        eigenvalues[np.abs(eigenvalues) < SLOWEST] = 0.0
        return LinearSystem(acceleration, np.zeros((0, 2 * n)), eigenvalues, self.fastest)

    def repeated_systems(self, times: int) -> LinearSystem:
        """Return systems along a first axis, each some times in a row."""
        acceleration, rate = (np.tile(array, (times, 1, 1)) for array in (self.acceleration, self.rate))
        return LinearSystem(acceleration, rate, np.tile(self.eigenvalues, (times, 1)), self.fastest)


def amplification(method: Method, system: LinearSystem, h: NDArray[Any]) -> NDArray[Any]:
    """Return the matrix that one step of each size applies to (q, v, x), by running the method's lines.

    Parameters
    ----------
    method : Method
    system : LinearSystem
    h : ndarray, shape (k,)
        Steps, in the system's unit of time; complex ones give the stability function. Of k systems along a first axis
        each takes one of them.

    Returns
    -------
    ndarray, shape (k, 2n + m, 2n + m)

    Notes
    -----
    Accelerations and rates at the start of the step are those of the state there. A method whose last evaluation is at
    another state must refuse the forces for which that makes a difference.
    """
    n, m = system.acceleration.shape[-2], system.rate.shape[-2]
    size = 2 * n + m
    start = np.eye(size)
    state = {"q": start[:n], "v": start[n : 2 * n], "x": start[2 * n :]}
    step = h[:, None, None]
    vectors = state | {"a": system.acceleration, "r": system.rate, "h": step, "t": 0.0, "t1": step}
    end = _run_matrix_lines(read_lines(method.moving_update or method.update), vectors, system)
    blocks = [np.broadcast_to(end[name], (len(h), rows, size)) for name, rows in (("q1", n), ("v1", n), ("x1", m))]
    return np.concatenate(blocks, axis=1)


def amplification_factors(matrices: Floats) -> Complexes:
    """Return the eigenvalues of amplification matrices, nan where one is not finite: (k, n, n) to (k, n).

    For 2 x 2 matrices the quadratic formula keeps nearly equal factors on the unit circle, which an iteration does not.
    """
    finite = np.asarray(np.isfinite(matrices).all(axis=(1, 2)))
    matrices = np.where(finite[:, None, None], matrices, 0.0)
    if matrices.shape[1] == 2:
        half = (matrices[:, 0, 0] + matrices[:, 1, 1]) / 2.0
        determinant = matrices[:, 0, 0] * matrices[:, 1, 1] - matrices[:, 0, 1] * matrices[:, 1, 0]
        root = np.sqrt((half * half - determinant).astype(np.complex128))
        eigenvalues: Complexes = np.stack([half - root, half + root], axis=1)
    else:
        eigenvalues = np.linalg.eigvals(matrices).astype(np.complex128)
    eigenvalues[~finite] = np.nan
    return eigenvalues


class _Matrices(Walker):
    """Runs lines on matrices, whose columns are the responses to each component of the state."""

    def __init__(self, vectors: Vectors, system: LinearSystem) -> None:
        self.vectors = dict(vectors)
        self._system = system

    def assign(self, line: VectorStatement) -> None:
        self.vectors[line.target] = _vector_value(line.expression, self.vectors)

    def evaluate(self, line: Evaluation) -> None:
        state = [self.vectors[line.position], self.vectors[line.velocity], self.vectors[line.state]]
        self.vectors[line.acceleration], self.vectors[line.rate] = _slopes_of_state(self._system, state)

    def expand(self, line: TaylorSeries) -> None:
        vectors = self.vectors
        slopes = {"q": vectors["v"], "v": vectors["a"], "x": vectors["r"]}
        for i in range(1, line.degree + 1):
            state = [slopes[letter] / i for letter in "qvx"]
            vectors |= {f"{letter}_{i}": part for letter, part in zip("qvx", state, strict=True)}
            slopes["q"] = state[1]
            slopes["v"], slopes["x"] = _slopes_of_state(self._system, state)

    def keep(self, line: ConstraintImpulse) -> None:
        """Change nothing: there are no constraints here."""

    def solve(self, line: Solve) -> None:
        self.vectors |= _solve_linear_lines(line, self.vectors, self._system)
        self.walk((*line.definitions, *line.evaluations))


def _run_matrix_lines(lines: Iterable[Line], vectors: Vectors, system: LinearSystem) -> Vectors:
    matrices = _Matrices(vectors, system)
    matrices.walk(lines)
    return matrices.vectors


def _slopes_of_state(system: LinearSystem, state: Sequence[Any]) -> tuple[Any, Any]:
    """Return accelerations and rates for coordinates, velocities and states."""
    n = system.acceleration.shape[-2]
    state_slices = (slice(0, n), slice(n, 2 * n), slice(2 * n, None))
    return (
        sum(
            system.acceleration[..., state_slice] @ vector
            for state_slice, vector in zip(state_slices, state, strict=True)
        ),
        sum(system.rate[..., state_slice] @ vector for state_slice, vector in zip(state_slices, state, strict=True)),
    )


def _solve_linear_lines(line: Solve, vectors: Vectors, system: LinearSystem) -> Vectors:
    """Solve u = A u + b: the lines are linear, so they give b at u = 0, and A with all known vectors 0."""
    n, m, k = system.acceleration.shape[-2], system.rate.shape[-2], len(vectors["h"])
    sizes = [m if name[0] == "x" else n for name in line.unknowns]
    cuts = np.cumsum(sizes)[:-1]

    def answers(known_vectors: Vectors, unknown: Floats) -> Floats:
        local = known_vectors | dict(zip(line.unknowns, np.split(unknown, cuts), strict=True))
        local = _run_matrix_lines((*line.definitions, *line.evaluations), local, system)
        blocks = [
            np.broadcast_to(_vector_value(equation.expression, local), (k, size, unknown.shape[1]))
            for equation, size in zip(line.equations, sizes, strict=True)
        ]
        return np.concatenate(blocks, axis=1)

    total = sum(sizes)
    scalars = {name: vectors[name] for name in SCALARS if name in vectors}
    zeros = {name: np.zeros((m if name[0] in "xr" else n, total)) for name in vectors if name not in scalars}
    matrix = np.eye(total) - answers(scalars | zeros, np.eye(total))
    right = answers(vectors, np.zeros((total, 2 * n + m)))
    matrix[np.linalg.det(matrix) == 0.0] = np.nan  # a pole of the step: no number
    solution = np.linalg.solve(matrix, right)
    return dict(zip(line.unknowns, np.split(solution, cuts, axis=1), strict=True))


def _vector_value(node: Node, vectors: Vectors) -> Any:
    """Return the value of a vector expression."""
    match node:
        case Number():
            return node.value
        case Name():
            return vectors[node.name]
        case Negative():
            return -_vector_value(node.operand, vectors)
        case Binary(operator="**"):
            return _vector_value(node.left, vectors) ** float(exponent_of(node.right) or 0)
        case Call():
            return evaluate(node, {})  # a constant, like sqrt(3)
        case Binary():
            return _ARITHMETIC[node.operator](_vector_value(node.left, vectors), _vector_value(node.right, vectors))
    raise InputError(f"'{text_of(node)}' is no part of a method's lines; they are linear in the vectors")

"""Linear complementarity problems, against all their solutions."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from cases.plain import made_by_hand, plain
from xdynamics.march.contacts import delassus
from xdynamics.march.run import Run

Floats = NDArray[np.float64]


def solved(matrix: Floats, q: Floats) -> Floats | None:
    """Solve by the engine."""
    n = len(q)
    run = posed(matrix, q)
    return run.solution.copy() if plain(delassus.solve_complementarity)(run, n) else None


def posed(matrix: Floats, q: Floats) -> Run:
    """A run with a problem in it."""
    n = len(q)
    run = made_by_hand(problem=np.zeros((n, 2 * n + 2)), basis=np.zeros(3 * n + 1, np.int64), solution=np.zeros(n))
    plain(delassus.clear_tableau)(run, n)
    run.problem[:, n : 2 * n], run.problem[:, 2 * n + 1] = -matrix, q
    return run


def solutions(matrix: Floats, q: Floats) -> list[Floats]:
    """Every solution with a regular set of positive unknowns, by trying all sets."""
    n, found = len(q), []
    for chosen in product((False, True), repeat=n):
        some = np.flatnonzero(chosen)
        z = np.zeros(n)
        if some.size:
            part = matrix[np.ix_(some, some)]
            if abs(np.linalg.det(part)) < 1e-12:
                continue
            z[some] = np.linalg.solve(part, -q[some])
        if (z > -1e-10).all() and (matrix @ z + q > -1e-10).all():
            found.append(z)
    return found


@pytest.mark.parametrize("seed", range(60))
def test_the_solution_of_a_p_matrix_is_found(seed: int) -> None:
    """Assert the one solution of problems with positive definite, not symmetric, matrices."""
    random = np.random.default_rng(seed)
    n = int(random.integers(1, 7))
    root = random.normal(size=(n, n))
    skew = random.normal(size=(n, n))
    matrix = root @ root.T + 0.1 * np.eye(n) + (skew - skew.T)
    q = random.normal(size=n)
    every = solutions(matrix, q)
    assert len({tuple(node.round(6)) for node in every}) == 1
    assert solved(matrix, q) == pytest.approx(every[0], abs=1e-9)


@pytest.mark.parametrize("seed", range(30))
def test_what_holds_a_motion_twice_has_an_answer(seed: int) -> None:
    """Assert that semidefinite problems are solved: more contacts than motions."""
    random = np.random.default_rng(seed)
    rows = random.normal(size=(5, 2))
    matrix, q = rows @ rows.T, rows @ random.normal(size=2)
    z = solved(matrix, q)
    assert z is not None
    w = matrix @ z + q
    assert (z >= 0).all()
    assert (w > -1e-9).all()
    assert abs(z @ w) < 1e-9


def test_friction_with_ties_does_not_circle() -> None:
    """Assert an answer where all ratios are equal: a block with friction that nothing pushes along."""
    matrix = np.array([[1.0, 0, 0, 0], [0, 1, -1, 1], [0, -1, 1, 1], [0.3, -1, -1, 0]])
    z = solved(matrix, np.array([-9.81, 0, 0, 0]))
    assert z == pytest.approx([9.81, 0, 0, 0])


def test_no_solution_is_a_ray() -> None:
    """Assert that a problem without a solution is told from others."""
    assert solved(np.array([[-1.0]]), np.array([-1.0])) is None


def test_nothing_to_do() -> None:
    """Assert zero where nothing approaches."""
    assert solved(np.eye(2), np.array([0.0, 3.0])) == pytest.approx([0, 0])

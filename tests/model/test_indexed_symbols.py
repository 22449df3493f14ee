"""Models from sympy's indexed symbols: against closed forms, one way against another, and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.linalg import eigh
from sympy import Expr, IndexedBase, MatrixSymbol, Max, Mod, Sum, Symbol, cos, sqrt

import xdynamics as xd

N = 6
U, V, M = IndexedBase("u"), IndexedBase("v_u"), IndexedBase("m")
K, I, J = Symbol("k"), Symbol("i", integer=True), Symbol("j", integer=True)
POTENTIAL = Sum(K * (U[I + 1] - U[I]) ** 2 / 2, (I, 0, N - 2)) + K * U[0] ** 2 / 2
KINETIC = Sum(M[I] * V[I] ** 2 / 2, (I, 0, N - 1))
Q, A = IndexedBase("q"), Symbol("a", integer=True)
PLACES = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 2.0]])
MASSES = np.array([1.0, 2.0, 1.0, 1.0, 3.0, 1.0])
SECTIONS: dict[str, Any] = {
    "dimensions": {"site": N},
    "coordinates": {"u": {"unit": "m", "dims": ["site"]}},
    "parameters": {"k": "4 N m-1", "m": {"dims": ["site"], "value": MASSES.tolist(), "unit": "kg"}},
    "initial": {"u": "0.1*metre*index(site)"},
}


def test_indexed_symbols_have_dimensions() -> None:
    """Assert that sums become sums along a dimension, in one expression for any number, and move as the modes say."""
    model = xd.Model.from_sympy(POTENTIAL, mass={"u": "m"}, **SECTIONS)
    assert "sum(where(index(site) <= 4, k*(roll(u, site, -1) - u)**2/2, 0), site)" in model.to_toml()
    run = xd.simulate(model, method="dop853", rtol=1e-11, until="5 s")
    assert run.u.dims == ("step", "site")
    differences = np.eye(N) - np.eye(N, k=-1)  # of each site to the one before, of the first to the wall
    squares, shapes = eigh(4.0 * differences.T @ differences, np.diag(MASSES))
    amplitudes = shapes.T @ np.diag(MASSES) @ (0.1 * np.arange(N))
    exact = shapes @ (amplitudes * np.cos(np.sqrt(squares) * 5.0))
    assert np.abs(run.u.values[-1] - exact).max() < 1e-10


def test_both_energies_are_a_lagrangian() -> None:
    """Assert that kinetic and potential energy give the accelerations that masses and the potential give."""
    models = (
        xd.Model.from_sympy((KINETIC, POTENTIAL), **SECTIONS),
        xd.Model.from_sympy(POTENTIAL, mass={"u": "m"}, **SECTIONS),
    )
    assert models[0].statement.lagrangian is not None
    first, second = (xd.simulate(model, method="rk4", step="0.1 s", until="0.1 s") for model in models)
    assert np.allclose(first.a_u, second.a_u, rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize(
    ("energy", "message"),
    [
        (
            Sum(U[I + 1], (I, 0, N - 1)),
            r"u\[i \+ 1\] goes from 1 to 6, and 'site' from 0 to 5; sum over fewer, or write Mod\(i \+ 1, 6\)",
        ),
        (Sum(U[I], (I, 0, 9)), r"u\[i\] goes from 0 to 9, and 'site' from 0 to 5; sum over fewer"),
        (
            Sum(U[I] * U[J], (I, 0, 2), (J, 0, 2)),
            "over i from 0 to 2 and j from 0 to 2 are both along 'site'; let one go from 0 to 4 and the other from its next",
        ),
        (Sum(1 / (U[I] - U[J]), (I, 0, N - 1), (J, 0, N - 1)), "not finite where they are alike; begin j at i \\+ 1"),
        (
            (MatrixSymbol("u", 4, 1).T * MatrixSymbol("u", 4, 1))[0, 0],
            r"'u' is a matrix of \(4, 1\), and its dimensions site",
        ),
        (IndexedBase("q")[0], "'q' is indexed, and has no dimensions; give it dims"),
        (U[I], r"u\[i\] has the index i, needs that of a sum along 'site'"),
        (Sum(U[2 * I], (I, 0, 2)), r"has the index 2\*i, needs that of a sum"),
        (Sum(K, (I, 0, 3)), "the index i is of no symbol"),
        (U[0, 1], "has 2 indices, and 'u' the dimensions site"),
        (Sum(U[I], (I, 0, Symbol("N"))), "from 0 to N, needs whole numbers"),
        ((KINETIC,), "1 energies are given, needs two"),
        ("u", "or energies in indexed symbols"),
    ],
)
def test_indices_that_say_nothing_are_refused(energy: Expr, message: str) -> None:
    """Assert that an index beyond its dimension, of no sum, of two, or of what has no dimensions is named."""
    with pytest.raises(xd.InputError, match=message):
        xd.Model.from_sympy(energy, mass={"u": "m"}, **SECTIONS)


def test_the_potential_alone_needs_masses() -> None:
    """Assert that a potential without masses is refused with both remedies."""
    with pytest.raises(xd.InputError, match="the potential energy alone needs mass=…; or give kinetic and potential"):
        xd.Model.from_sympy(POTENTIAL, **SECTIONS)


def _accelerations(energies: Any, of: str, **sections: Any) -> Any:
    model = xd.Model.from_sympy(energies, **sections)
    assert xd.Model.from_text(model.to_toml()) == model
    return xd.simulate(model, method="forward_euler", step="1 us", until="1 us")[f"a_{of}"].values[0]


def _distance(i: Any, j: Any) -> Any:
    return sqrt((Q[i, 0] - Q[j, 0]) ** 2 + (Q[i, 1] - Q[j, 1]) ** 2)


@pytest.mark.parametrize(
    "energy",
    [
        -Sum(M[I] * M[J] * K / sqrt(Sum((Q[I, A] - Q[J, A]) ** 2, (A, 0, 1))), (J, I + 1, 2), (I, 0, 1)),
        -Sum(M[I] * M[J] * K / sqrt(Sum((Q[I, A] - Q[J, A]) ** 2, (A, 0, 1))), (I, 0, J - 1), (J, 0, 2)),
        -Sum(M[I] * M[J] * K / _distance(I, J), (J, I + 1, 2), (I, 0, 2)),
    ],
)
def test_sums_over_pairs_are_over_a_relation(energy: Expr) -> None:
    """Assert that a double sum over one dimension attracts every two bodies, as Newton says."""
    exact = np.zeros((3, 2))
    for i, j in ((0, 1), (1, 0), (0, 2), (2, 0), (1, 2), (2, 1)):
        apart = PLACES[j] - PLACES[i]
        exact[i] += (1.0, 2.0, 3.0)[j] * apart / np.linalg.norm(apart) ** 3
    found = _accelerations(
        energy,
        "q",
        dimensions={"body": 3, "axis": ["x", "y"]},
        coordinates={"q": {"unit": "m", "dims": ["body", "axis"]}},
        parameters={"k": "1 N m2 kg-2", "m": {"dims": ["body"], "value": [1, 2, 3], "unit": "kg"}},
        mass={"q": "m"},
        initial={"q": {"unit": "m", "value": PLACES.tolist()}},
    )
    np.testing.assert_allclose(found, exact, rtol=1e-14)


START = np.array([0.1, -0.3, 0.2, 0.5, -0.1, 0.4])
STIFF = 2.0 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1)


@pytest.mark.parametrize(
    ("energy", "exact"),
    [
        (Sum(K * (U[I] - U[J]) ** 2 / 4, (I, 0, N - 1), (J, 0, N - 1)), -4.0 * (N * START - START.sum())),
        (
            Sum(K * U[I] * U[J] * (I + 1), (I, 0, N - 1), (J, 0, N - 1)),
            -4.0 * (START @ np.arange(1, N + 1) + START.sum() * np.arange(1, N + 1)),
        ),
        (
            Sum(K * (U[Mod(I + 1, N)] - U[I]) ** 2 / 2, (I, 0, N - 1)),
            4.0 * (np.roll(START, -1) - 2 * START + np.roll(START, 1)),
        ),
        (
            Sum(K * U[I] * U[J] * (I + 1), (J, I + 1, N - 1), (I, 0, N - 2)),
            [-4.0 * ((k + 1) * START[k + 1 :].sum() + START[:k] @ np.arange(1, k + 1)) for k in range(N)],
        ),
        (MatrixSymbol("u", N, 1).T * MatrixSymbol("S", N, N) * MatrixSymbol("u", N, 1) / 2, -STIFF @ START),
        ((MatrixSymbol("u", N, 1).T * MatrixSymbol("S", N, N) * MatrixSymbol("u", N, 1))[0, 0] / 2, -STIFF @ START),
    ],
)
def test_double_sums_rings_and_matrices_have_their_forces(energy: Expr, exact: Any) -> None:
    """Assert that sums over all of two indices, around a ring and of matrices pull as the algebra says."""
    stiff = {"dims": ["site", "column"], "value": STIFF.tolist(), "unit": "N m-1"}
    sections = SECTIONS | {
        "dimensions": {"site": N, "column": N},
        "parameters": SECTIONS["parameters"] | {"S": stiff},
        "initial": {"u": {"unit": "m", "value": START.tolist()}},
    }
    found = _accelerations(energy, "u", mass={"u": "1*kilogram"}, **sections)
    np.testing.assert_allclose(found, exact, rtol=1e-13, atol=1e-15)


def test_a_pendulum_of_links_by_both_energies() -> None:
    """Assert that N links swing as their matrix of masses says: the kinetic energy is a sum over pairs."""
    link, v, n = IndexedBase("theta"), IndexedBase("v_theta"), 3
    kinetic = Sum(K * (n - Max(I, J)) * cos(link[I] - link[J]) * v[I] * v[J] / 2, (J, 0, n - 1), (I, 0, n - 1))
    potential = -Sum(Symbol("w") * (n - I) * cos(link[I]), (I, 0, n - 1))
    start, place = np.array([1.0, 0.5, 0.2]), np.arange(n)
    found = _accelerations(
        (kinetic, potential),
        "theta",
        dimensions={"link": n},
        coordinates={"theta": {"unit": "rad", "dims": ["link"]}},
        parameters={"k": "1 kg m2", "w": "9.81 J"},
        initial={"theta": {"unit": "rad", "value": start.tolist()}},
    )
    matrix = (n - np.maximum.outer(place, place)) * np.cos(start[:, None] - start)
    np.testing.assert_allclose(found, np.linalg.solve(matrix, -9.81 * (n - place) * np.sin(start)), rtol=1e-12)

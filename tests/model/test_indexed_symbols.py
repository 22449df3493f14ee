"""Models from sympy's indexed symbols: against closed forms, one way against another, and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.linalg import eigh
from sympy import Expr, IndexedBase, Sum, Symbol

import xdynamics as xd

N = 6
U, V, M = IndexedBase("u"), IndexedBase("v_u"), IndexedBase("m")
K, I, J = Symbol("k"), Symbol("i", integer=True), Symbol("j", integer=True)
POTENTIAL = Sum(K * (U[I + 1] - U[I]) ** 2 / 2, (I, 0, N - 2)) + K * U[0] ** 2 / 2
KINETIC = Sum(M[I] * V[I] ** 2 / 2, (I, 0, N - 1))
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
    assert models[0].shaped.lagrangian is not None
    first, second = (xd.simulate(model, method="rk4", step="0.1 s", until="0.1 s") for model in models)
    assert np.allclose(first.a_u, second.a_u, rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize(
    ("energy", "message"),
    [
        (Sum(U[I + 1], (I, 0, N - 1)), r"u\[i \+ 1\] goes from 1 to 6, and 'site' from 0 to 5"),
        (Sum(U[I], (I, 0, 9)), r"u\[i\] goes from 0 to 9, and 'site' from 0 to 5"),
        (Sum(U[I] * U[J], (I, 0, 2), (J, 0, 2)), "sums twice along 'site'; say who acts on whom by a relation"),
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

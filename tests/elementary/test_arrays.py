"""Sums, systems and fits without BLAS: against numpy's, where a pivot is needed, and where there is no answer."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest

from xdynamics.elementary.arrays import dot, exp, expm1, least_squares, log, power, product, solve_systems


def test_systems_side_by_side() -> None:
    """Assert the solutions of 200 systems of each size, as near as their condition lets them be."""
    rng = np.random.default_rng(1)
    for n in (1, 2, 5, 12):
        matrices, right = rng.normal(size=(200, n, n)), rng.normal(size=(200, n, 3))
        found = solve_systems(matrices, right)
        off = np.abs(found - np.linalg.solve(matrices, right)).max(axis=(1, 2)) / np.abs(found).max(axis=(1, 2))
        assert (off <= 1e-14 * n * np.linalg.cond(matrices)).all()
        assert (np.abs(product(matrices, found) - right) <= 1e-12 * np.linalg.cond(matrices)[:, None, None]).all()


def test_a_system_that_needs_its_pivot_and_one_without_answer() -> None:
    """Assert that rows are exchanged, each system its own, and that a singular one spoils no other."""
    matrices = np.array([[[0.0, 1.0], [1.0, 0.0]], [[1.0, 2.0], [2.0, 4.0]], [[1e-20, 1.0], [1.0, 1.0]]])
    found = solve_systems(matrices, np.array([[3.0], [4.0]]))[..., 0]
    assert found[0].tolist() == [4.0, 3.0]
    assert not np.isfinite(found[1]).any()
    assert found[2].tolist() == [1.0, 3.0]


def test_products() -> None:
    """Assert products of stacks, of vectors, and of nothing."""
    rng = np.random.default_rng(2)
    left, right = rng.normal(size=(4, 3, 5)), rng.normal(size=(4, 5, 2))
    assert product(left, right) == pytest.approx(left @ right, rel=1e-12)
    assert float(dot(left[0, 0], right[0, :, 0])) == pytest.approx(float(left[0, 0] @ right[0, :, 0]), rel=1e-12)
    assert dot(np.zeros(0), np.zeros((0, 0))).size == 0
    assert float(dot(np.zeros(0), np.zeros(0))) == 0.0


def test_fits() -> None:
    """Assert coefficients against LAPACK's, near dependence too, and a column that is none of its own."""
    rng = np.random.default_rng(3)
    for _ in range(100):
        columns, values = rng.normal(size=(7, 3)), rng.normal(size=7)
        columns[:, 2] = columns[:, 1] + 10.0 ** rng.uniform(-4, 0) * columns[:, 2]
        known = np.linalg.lstsq(columns, values, rcond=None)[0]
        assert least_squares(columns, values) == pytest.approx(known, rel=1e-14 * float(np.linalg.cond(columns)) ** 2)
    twice = np.ones((4, 2))
    assert least_squares(twice, np.full(4, 3.0)).tolist() == [3.0, 0.0]


def test_logarithms_and_powers() -> None:
    """Assert numbers to 2 ulp near zero too, and of what there is none."""
    for x in (1e-300, 1e-9, 0.3, 7.0, 300.0):
        assert float(expm1(x)) == pytest.approx(float(mpmath.expm1(x)), rel=5e-16)
        assert float(expm1(-x)) == pytest.approx(float(mpmath.expm1(-x)), rel=5e-16)
        assert float(log(x)) == pytest.approx(float(mpmath.log(x)), rel=3e-16)
    assert power(np.array([2.0, 9.0]), 0.5).tolist() == [2.0**0.5, 3.0]
    assert log(np.array([0.0, 1.0])).tolist() == [-np.inf, 0.0]
    assert np.isnan(log(-1.0))
    assert float(exp(0.0)) == 1.0

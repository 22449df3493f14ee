"""Modes and stable steps of many coordinates, against closed forms and quadratic forms."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from scipy import linalg

import xdynamics as xd
from xdynamics.methods import METHODS
from xdynamics.runtime.fork_safety import one_blas_thread, thread_counts
from xdynamics.stability import LinearSystem, NormalModes
from xdynamics.stability.limits import largest_step


def chain(n: int) -> np.ndarray:
    """The stiffness of masses between walls, whose frequencies are 2 sin(pi i/(2(n + 1)))."""
    return 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)


def graded(n: int) -> np.ndarray:
    """Dashpots along a chain, the last three times the first: they join its modes."""
    strength = np.linspace(0.02, 0.06, n + 1)
    return np.diag(strength[:-1] + strength[1:]) - np.diag(strength[1:-1], 1) - np.diag(strength[1:-1], -1)


def counting(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The sizes of the matrices whose eigenvalues are computed from here on, each as often as it is one."""
    sizes: list[int] = []
    whole = np.linalg.eigvals

    def counted(matrices: Any) -> Any:
        sizes.extend([matrices.shape[-1]] * int(np.prod(matrices.shape[:-2])))
        return whole(matrices)

    monkeypatch.setattr(np.linalg, "eigvals", counted)
    return sizes


@pytest.mark.parametrize(("name", "dashpots"), [("euler_cromer", 2.0), ("implicit_velocity_verlet", 0.0)])
def test_the_step_of_joined_modes_is_where_a_factor_is_minus_one(
    name: str, dashpots: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert that h**2 K + 2 h C (of Verlet's h**2 K alone) has 4 for its largest eigenvalue, found in 40 steps that are tried.

    The factor -1 in v1 = v - h (K q + C v), q1 = q + h v1 needs (4 - 2 h C - h**2 K) q = 0, and the quadratic forms of
    symmetric C and K leave no other. In Verlet's the damping of both ends of such a step cancels.
    """
    n = 40
    stiffness, damping = chain(n), graded(n)
    jacobian = np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness, -damping]])
    system = LinearSystem.from_jacobian(jacobian, n)
    assert system.modes is None
    sizes = counting(monkeypatch)
    h = largest_step(METHODS[name], system) / system.fastest
    assert linalg.eigvalsh(h * h * stiffness + dashpots * h * damping)[-1] == pytest.approx(4.0, rel=3e-8)
    assert sizes.count(2 * n) <= 40


def test_the_step_of_the_mean_velocity_is_that_of_the_whole() -> None:
    """Assert that the largest factor of a step, by its matrix as the book has it, is 1 at the limit of 12 joined modes."""
    n = 12
    stiffness, damping, unit = chain(n), graded(n), np.eye(n)
    system = LinearSystem.from_jacobian(np.block([[np.zeros((n, n)), unit], [-stiffness, -damping]]), n)
    h = largest_step(METHODS["averaged_velocity"], system) / system.fastest
    step = np.block(
        [[unit - h * h / 2 * stiffness, h * unit - h * h / 2 * damping], [-h * stiffness, unit - h * damping]]
    )
    assert np.abs(np.linalg.eigvals(step)).max() == pytest.approx(1.0, rel=1e-9)
    assert h > 0.01


@pytest.mark.parametrize("rigid", [False, True])
@pytest.mark.parametrize("decay", [0.0, 0.025])
def test_a_long_chain_has_the_modes_of_its_closed_form(
    rigid: bool, decay: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert frequencies, shapes, decays and the step of 80 masses, without eigenvalues of a matrix of over 64 rows."""
    n = 80
    ends = ("u[0]", "u[-1]") if rigid else ("0*metre", "0*metre")
    left, right = f"shift(u, site, 1, {ends[0]})", f"shift(u, site, -1, {ends[1]})"
    model = xd.Model(
        name="long chain",
        dimensions={"site": n},
        coordinates={"u": {"unit": "m", "dims": ["site"]}},
        parameters={"k": "3 N m-1", "m": {"dims": ["site"], "value": [2.0] * n, "unit": "kg"}},
        mass={"u": "m"},
        forces={"springs": {"u": f"k*({left} - 2*u + {right})"}, "drag": {"u": f"-{2 * decay}*m*v_u/second"}},
        initial={"u": "0*metre*index(site)", "v_u": "0*metre/second*index(site)"},
    )
    sizes = counting(monkeypatch)
    found = xd.modes(model)
    assert max(sizes, default=0) <= 64
    i = np.arange(n) if rigid else np.arange(1, n + 1)
    exact = 2.0 * np.sqrt(1.5) * np.sin(np.pi * i / (2.0 * (n if rigid else n + 1)))
    assert found.frequency.values == pytest.approx(exact, rel=1e-10, abs=1e-6 if rigid else 0.0)
    assert found.shape_u.dims == ("mode", "site")
    place = np.arange(n) + (0.5 if rigid else 1.0)
    shape = (np.cos if rigid else np.sin)(np.pi * i[3] * place / (n if rigid else n + 1))
    own = found.shape_u.values[3]
    assert (own @ shape) ** 2 == pytest.approx((own @ own) * (shape @ shape), rel=1e-12)
    assert np.abs(own).max() == 1.0
    roots = np.sqrt((decay**2 - exact**2).astype(complex))
    every = np.sort_complex(np.concatenate([roots - decay, -roots - decay]))
    assert np.sort(found.eigenvalue_imag) == pytest.approx(np.sort(every.imag), abs=1e-9)
    assert np.sort(found.eigenvalue_real) == pytest.approx(np.sort(every.real), abs=1e-9)


@pytest.mark.parametrize("width", [1, 3, 40])
def test_modes_of_a_band_solve_their_equation(width: int) -> None:
    """Assert K u = w**2 M u of tridiagonal, banded and full matrices of 80 rows and unequal masses."""
    rng = np.random.default_rng(5)
    n = 80
    half = np.triu(np.tril(rng.normal(size=(n, n)), 0), -width)
    stiffness, mass = half + half.T, np.diag(rng.uniform(1.0, 3.0, n))
    normal = NormalModes.from_matrices(stiffness, mass)
    assert normal.symmetric
    residual = stiffness @ normal.shapes - mass @ normal.shapes * normal.squares.real
    assert np.abs(residual).max() < 1e-12 * np.abs(normal.squares).max()
    assert normal.shapes.T @ mass @ normal.shapes == pytest.approx(np.eye(n), abs=1e-12)


def test_a_large_mass_matrix_is_not_printed() -> None:
    """Assert that a negative mass among 30 is told by the least eigenvalue, in a line of under 250 characters."""
    model = xd.Model(
        name="thirty",
        dimensions={"site": 30},
        coordinates={"u": {"unit": "m", "dims": ["site"]}},
        parameters={"m": "1 kg"},
        mass={"u": "m*(20 - index(site))"},
        forces={"pull": {"u": "1*newton"}},
        initial={"u": "0*metre*index(site)", "v_u": "0*metre/second*index(site)"},
    )
    with pytest.raises(xd.InputError, match=r"mass matrix of 30 rows, least eigenvalue -9 \(SI units\)") as caught:
        xd.modes(model)
    assert len(str(caught.value)) < 250


@pytest.fixture
def two_threads() -> Iterator[Callable[[], int]]:
    """The number of threads of NumPy's OpenBLAS, which is 2 here."""
    if not (counts := thread_counts("numpy.linalg._umath_linalg")):
        pytest.skip("NumPy is built with another BLAS than OpenBLAS")
    before = counts[0].read()
    counts[0].set(2)
    yield counts[0].read
    counts[0].set(before)


def test_eigenvalues_are_computed_on_one_thread(
    two_threads: Callable[[], int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert that `modes` computes all eigenvalues on one thread, and leaves two for others."""
    threads: list[int] = []
    whole = np.linalg.eigvals
    monkeypatch.setattr(np.linalg, "eigvals", lambda matrices: threads.append(two_threads()) or whole(matrices))
    xd.modes(xd.Model.from_toml("data/models/coupled_masses.toml"))
    assert (set(threads), two_threads()) == ({1}, 2)


def test_the_last_of_many_uses_gives_the_threads_back(two_threads: Callable[[], int]) -> None:
    """Assert that a use within a use, and one that ends in an error, leave the number of threads as it was."""
    with one_blas_thread():
        with pytest.raises(ZeroDivisionError, match="division"), one_blas_thread():
            assert 1 / 0
        assert two_threads() == 1
    assert two_threads() == 2

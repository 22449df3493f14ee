"""Rough discs that bounce and spin in a box whose walls move: against an event-driven solution, few links and many."""

from __future__ import annotations

import numpy as np
import pytest

import xdynamics as xd
from cases.rough_discs import WALLS, RoughDiscs

FEW, MANY = ("floor", "left"), tuple(WALLS)
MOST = 20  # impacts, after which neighbouring motions part too far


def check(discs: RoughDiscs, few: bool) -> None:
    """Assert times of impacts, velocities and spins after each, energies that each took, and places at the end, to 1e-9."""
    exact = discs.solution(MOST)
    assert 8 <= len(exact.times) <= MOST
    assert exact.slowest > 1e-3  # m/s: none so slow that it may be skipped
    assert exact.sticks > 0 < exact.slides
    model = discs.model()
    assert bool(model.assemblies) is not few
    run = xd.simulate(model, method="rk4" if few else "velocity_verlet", step="10 ms", until=f"{discs.until} s")
    assert run.attrs["run_outcome"] == "completed"
    near = {"rtol": 0.0, "atol": 1e-9}
    np.testing.assert_allclose(run["event_time"], exact.times, **near)
    rows = run["event_row_after"].values
    for k, name in enumerate(("x", "y", "theta")):
        size = 1.0 if name != "theta" else 1.0 / discs.radii.min()  # a spin moves the rim
        np.testing.assert_allclose(run[f"v_{name}"].values[rows] / size, np.array(exact.after)[:, :, k] / size, **near)
        np.testing.assert_allclose(run[name].values[-1] / size, exact.last[:, k] / size, **near)
    np.testing.assert_allclose(run["event_energy_lost"], exact.lost, **near)


@pytest.mark.parametrize("case", [1, 2])
def test_few_rough_discs_bounce_and_spin_as_an_event_driven_solution_says(case: int) -> None:
    """Assert it of three discs, a floor and a wall, whose forces are written out."""
    check(RoughDiscs(case, 3, FEW, 0.6), few=True)


@pytest.mark.parametrize(("case", "count"), [(0, 5), (1, 8), (0, 12)])
def test_many_rough_discs_bounce_and_spin_as_an_event_driven_solution_says(case: int, count: int) -> None:
    """Assert it of discs in a box, whose links are found by cells."""
    check(RoughDiscs(case, count, MANY, 0.35), few=False)


@pytest.mark.dear
@pytest.mark.parametrize("case", range(20, 25))
def test_more_few_rough_discs(case: int) -> None:
    """Assert it of four discs and a floor."""
    check(RoughDiscs(case, 4, ("floor",), 0.7), few=True)


@pytest.mark.dear
@pytest.mark.parametrize("case", range(20, 35))
def test_more_rough_discs(case: int) -> None:
    """Assert it of 4 to 12 discs in a box."""
    check(RoughDiscs(case, 4 + case % 9, MANY, 0.6), few=False)

"""Digits that others have published: Arenstorf's orbit, Kepler at e = 0.9, the Pleiades."""

from __future__ import annotations

import numpy as np
import pytest
from adaptive_problems import PROBLEMS
from numpy.typing import NDArray

import xdynamics as xd


def last(name: str, method: str, tolerance: float) -> NDArray[np.float64]:
    """March a problem to its end and return the last state."""
    problem = PROBLEMS[name]
    asked = {"method": method, "rtol": tolerance, "atol": tolerance, "until": problem.end, "force_samples": "none"}
    run = xd.simulate(problem.model(), **asked)
    assert run.attrs["run_outcome"] == "completed"
    return problem.last_of(run)


@pytest.mark.parametrize("method", ["dormand_prince", "dop853"])
def test_arenstorf_returns(method: str) -> None:
    """Assert that the orbit of Hairer, Norsett, Wanner, section II.0, closes after its period."""
    # the orbit multiplies an error by some 1e5 from start to end
    start = [0.994, 0.0, 0.0, -2.00158510637908252240537862224]
    assert last("arenstorf", method, 1e-13) == pytest.approx(start, abs=1e-13 * 1e5)


@pytest.mark.parametrize("method", ["dormand_prince", "dop853", "dprkn6"])
def test_kepler_at_high_eccentricity(method: str) -> None:
    """Assert x, y, x', y' at t = 20 from x = 0.1, y' = sqrt(19), by Kepler's equation."""
    exact = (-1.295266250987574, 0.4003938963792321, -0.6775390924707566, -0.1270838154278686)
    assert last("kepler", method, 1e-13) == pytest.approx(exact, abs=1e-10)


def test_pleiades() -> None:
    """Assert the seven stars' coordinates at t = 3 as the Test Set for IVP Solvers, release 2.4, publishes them."""
    assert PROBLEMS["pleiades"].error(last("pleiades", "dop853", 1e-12)) < 1e-8

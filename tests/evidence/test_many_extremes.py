"""Extremes of many elements: their rates are evaluated as arrays, and not at more states than memory holds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from xdynamics.evidence.diagnosing import extremes, summits

CLUSTER = """
name = "cluster"
[dimensions]
body = 4
axis = ["x", "y"]
[relations.pair]
of = "body"
[coordinates]
r = { unit = "m", dims = ["body", "axis"] }
[states.heat]
unit = "J"
rate = "1*watt*sin(2*radian*t/second) - 0.3*heat/second"
dims = ["body"]
[parameters]
k = "2 N m-1"
[mass]
r = "1*kilogram"
[forces.springs]
over = "pair"
potential = "k*norm(second(r, pair) - first(r, pair), axis)**4/(1*metre)**2"
[observables]
spread = "r - mean(r, body)"
[initial]
r = { unit = "m", value = [[0.0, 0.1], [1.0, 0.0], [0.9, 1.1], [-0.2, 0.8]] }
heat = { unit = "J", value = [0.1, 0.2, 0.3, 0.4] }
[run]
method = "rk4"
step = "0.02 s"
until = "4 s"
"""


@pytest.fixture(scope="module")
def run() -> xr.Dataset:
    """March four bodies that attract each other, with heats of their own."""
    return xd.simulate(xd.Model.from_text(CLUSTER))


def told_apart(*_given: object) -> xr.Dataset:
    raise AssertionError("elements were told apart")


def found(run: xr.Dataset) -> xr.Dataset:
    """Return the extremes of what steps integrate."""
    diagnosis = xd.diagnose(run, companion=False)
    words = [f"{word}_{name}" for name in ("r", "v_r", "heat") for word in ("maximum", "minimum")]
    return diagnosis[[f"{word}{end}" for word in words for end in ("", "_time", "_rule", "_uncertainty")]]


@pytest.mark.parametrize("chunks", [None, 90])
def test_elements_side_by_side_have_the_bits_of_elements(
    run: xr.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, chunks: int | None
) -> None:
    """Assert that all that is diagnosed of a large model is what is diagnosed of single elements, bit for bit."""
    if chunks:
        xd.save(run, tmp_path / "run.nc")
        run = xd.open_run(tmp_path / "run.nc", chunks={"step": chunks})
    expected = xd.diagnose(run, of="r[2, y]", companion=chunks is None)
    monkeypatch.setattr(extremes, "MOST_NAMES", 0)
    monkeypatch.setattr("xdynamics.record.unfolding._split_elements", told_apart)
    large = xd.diagnose(run, of="r[2, y]", companion=chunks is None)
    for word in ("v_r", "heat"):
        assert (expected[f"maximum_{word}_rule"] == summits.INTERPOLATED).any()
    assert {"energy_drift", "drift_spread", "drift_momentum_r", "maximum_heat"} <= {*large.data_vars}
    assert large.sizes["cycle"] > 1
    assert large.sizes["turn"] > 3
    forces = [name for name in expected.data_vars if name not in large]
    assert {str(name).split("_")[0] for name in forces} == {"maximum", "minimum"}  # of forces, energies and observables
    xr.testing.assert_identical(large.drop_attrs(deep=False), expected.drop_vars(forces).drop_attrs(deep=False))


def test_too_many_states_are_not_evaluated(run: xr.Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that extremes are then accepted states, off by no more than they are said to be."""
    between = found(run)
    monkeypatch.setattr(extremes, "MOST_NUMBERS", 1)
    accepted = found(run)
    monkeypatch.setattr(extremes, "MOST_NAMES", 0)
    large = found(run)
    xr.testing.assert_identical(large.drop_attrs(deep=False), accepted.drop_attrs(deep=False))
    for name in ("r", "v_r", "heat"):
        assert (accepted[f"maximum_{name}_rule"] == summits.SAMPLED).all()
        np.testing.assert_array_equal(accepted[f"maximum_{name}"], run[name].max("step"))
        off = between[f"maximum_{name}"] - accepted[f"maximum_{name}"]
        assert (off >= 0.0).all()
        assert (off > 0.0).any()
        assert (off <= 1.001 * accepted[f"maximum_{name}_uncertainty"]).all()

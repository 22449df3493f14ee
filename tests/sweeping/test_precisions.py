"""Sweeps whose members have numbers of 31 digits: each as it is when marched alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from xdynamics import archive
from xdynamics.sweeping.members import digest_of_end

BOTH = ["float64", "double_double"]
UNTIL: dict[str, Any] = {"method": "rk4", "until": "1 s"}
AXES = {"precision": BOTH, "k": ["0.1 N m-1", "0.7 N m-1"], "step": ["0.1 s", "0.3 s"]}
CELLS = [(precision, k, step) for precision in BOTH for k in AXES["k"] for step in AXES["step"]]
SWING = xd.Model(
    name="swing",
    coordinates={"x": {"unit": "mm"}},
    parameters={"k": "0.1 N m-1", "m": "0.3 kg"},
    mass={"x": "m"},
    forces={"spring": {"x": "-k*x"}},
    events={"middle": {"function": "x", "action": "reset", "set": {"v_x": "-0.9*v_x"}}},
    initial={"x": "0.2 mm", "v_x": "-1.1 mm s-1"},
)


def alone(precision: str, k: str, step: str) -> Any:
    """March one of the members by itself."""
    return xd.simulate(SWING.replace(parameters={"k": k}), precision=precision, step=step, **UNTIL)


def test_members_are_the_runs_that_are_marched_alone() -> None:
    """Assert digests, states at times, extremes and event times of those of `simulate`, and that rests make a difference."""
    kept = ["end", "x", "maximum_x", "event_time_middle"]
    swept = xd.sweep(SWING, AXES, keep=kept, times=["0.33 s"], check=1.0, **UNTIL).compute()
    for precision, k, step in CELLS:
        run = alone(precision, k, step)
        cell = swept.sel(solver_precision=precision, k=float(k.split()[0]), solver_step=float(step.split()[0]))
        assert str(cell.run_digest.values) == digest_of_end(run, ["x", "v_x"])
        assert float(cell.x[0]) == float(xd.sample(run, ["0.33 s"]).x[0])
        assert float(cell.event_time_middle) == float(run.event_time[0])
        assert float(cell.maximum_x) == float(xd.diagnose(run, companion=False).maximum_x)
    assert (swept.x.sel(solver_precision=BOTH[0]) != swept.x.sel(solver_precision=BOTH[1])).any()


def test_values_keep_the_digits_that_were_written(tmp_path: Path) -> None:
    """Assert that a value of 25 digits is that of the run marched alone with it, in its rests, and not the nearest float's."""
    k = "0.1000000000000000055511151 N m-1"  # 6e-17 from a tenth, which is the same float
    swept = xd.sweep(SWING, {"k": [k, "0.7 N m-1"]}, precision=BOTH[1], step="0.3 s", path=tmp_path / "grid", **UNTIL)
    rest = float(xd.member(swept, k=0.1).rest_x[-1])
    exact, near = (float(alone(BOTH[1], value, "0.3 s").rest_x[-1]) for value in (k, "0.1 N m-1"))
    assert rest == exact != near


@pytest.mark.dear
def test_archives_of_members_have_their_rests(tmp_path: Path) -> None:
    """Assert that whole runs of a grid are those of `simulate`, to the digest, and that rows of all are put together."""
    axes = AXES | {"step": ["0.3 s"]}
    swept = xd.sweep(SWING, axes, keep=["end", "log"], path=tmp_path / "grid", **UNTIL)
    for precision, k, step in CELLS[1::2]:
        member, run = xd.member(swept, precision=precision, k=k, step=step), alone(precision, k, step)
        assert archive.digest_of_run(member) == archive.digest_of_run(run)
        assert ("rest_x" in member) == (precision == BOTH[1])
    rows = xd.ragged(swept)
    np.testing.assert_array_equal(rows.x.values[-run.sizes["step"] :], run.x.values)


def test_an_order_follows_the_tolerance_of_each_member() -> None:
    """Assert that tolerances along an axis give each member its own order, in one task too, and are judged by precision."""
    asked: dict[str, Any] = {"method": "taylor", "until": "1 s"}
    xd.sweep(SWING, {"rtol": [1e-4, 1e-13], "k": AXES["k"]}, check=1.0, members_per_task=4, **asked).compute()
    swept = xd.sweep(SWING, {"rtol": [1e-16, 1e-17]}, check=1.0, precision=BOTH[1], order=6, **asked)
    assert (swept.run_outcome == "completed").all()
    with pytest.raises(xd.InputError, match="rtol = 1e-17 1: rtol is 1e-17, needs a number from 10 eps = 2.22e-15"):
        xd.sweep(SWING, {"precision": BOTH, "rtol": [1e-6, 1e-17]}, **asked)

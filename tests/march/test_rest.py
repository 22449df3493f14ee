"""What rests, held by forces that cancel, ends no run: tolerances have a floor from the terms, in all ways to march."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.resting import CASES, METHODS, Resting, marched, marched_absolutely, resting
from xdynamics.march.configuration import settings_for
from xdynamics.march.ensemble import march_many
from xdynamics.march.tolerances import ATOL_FLOORS, OF_TERMS

SECONDS = 1e-9  # from the closed form, at most
EVER_SMALLER = (
    "bogacki_shampine"  # by which a motion from zero takes hundreds of rows for each factor e, held before or not
)


def released(run: xr.Dataset) -> int:
    """Return the number of rows before the first event; all without one."""
    kinds = np.flatnonzero(run.row_kind.values == 3)
    return int(kinds[0]) + 1 if kinds.size else run.sizes["step"]


def check(case: Resting, run: xr.Dataset, other: xr.Dataset) -> None:
    """Assert that a run rests as long as it should, in not many more rows than one with an absolute tolerance."""
    assert run.attrs["run_outcome"] == "completed", run.attrs["run_outcome_text"]
    if math.isfinite(case.release):
        assert np.abs(run.event_time.values - case.release).min() <= SECONDS
    rows, others = (
        (released(run), released(other))
        if EVER_SMALLER in run.solver_method
        else (run.sizes["step"], other.sizes["step"])
    )
    assert rows <= 3 * others + 8  # of the first steps, each ten times the one before


@pytest.mark.every(4)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", CASES)
def test_what_rests_is_marched_to_its_release(name: str, method: str) -> None:
    """Assert that it is released on time by every method that takes it."""
    case = resting(name)
    if (run := marched(case, method)) is not None:
        check(case, run, marched_absolutely(case, method))


@pytest.mark.cases(840)
def test_random_bodies_rest(case: int) -> None:
    """Assert the same of twelve random sizes, slopes and growths of each kind, by seven methods."""
    rest, number = divmod(case, len(METHODS))
    seed, kind = divmod(rest, len(CASES))
    one = resting([*CASES][kind], seed)
    if (run := marched(one, METHODS[number])) is not None:
        check(one, run, marched_absolutely(one, METHODS[number]))


@pytest.mark.parametrize("method", ["implicit_midpoint", "velocity_verlet", "rk4"])
def test_step_doubling_marches_what_cancels(method: str) -> None:
    """Assert that methods without an embedded formula do, too, solved ones among them."""
    run = xd.simulate(resting("three").model, method=method, rtol=1e-8, until=2.0, estimator="step_doubling")
    assert (run.attrs["run_outcome"], run.sizes["step"] < 30) == ("completed", True)


def test_the_former_rule_dies() -> None:
    """Assert that without a floor the run ends, and that its sentence names the remedy besides a singularity."""
    run = xd.simulate(resting("lift").model, method="dormand_prince", rtol=1e-8, until=2.0, atol_floor="none")
    assert run.attrs["run_outcome"] == "step_below_spacing"
    assert "give z an atol" in run.attrs["run_outcome_text"]
    assert "atol_floor_rule" not in run.attrs


def test_the_rule_is_recorded_and_followed_again(tmp_path: Path) -> None:
    """Assert that a record says by which rule it was made, and is reproduced and extended by it."""
    case = resting("pull")
    for rule in ATOL_FLOORS:
        path = tmp_path / f"{len(ATOL_FLOORS[rule])}.nc"
        run = xd.simulate(
            case.model, method="dop853", rtol=1e-8, until=0.9 * case.release, atol_floor=rule, max_steps=100, path=path
        )
        assert run.attrs.get("atol_floor_rule", "") == ATOL_FLOORS[rule]
        assert xd.reproduce(path).attrs["identical"] == 1
    whole = xd.extend(path.with_stem(str(len(ATOL_FLOORS[OF_TERMS]))), until=case.until)
    assert whole.attrs["atol_floor_rule"] == ATOL_FLOORS[OF_TERMS]
    assert np.abs(whole.event_time.values - case.release).min() <= SECONDS


def test_given_tolerances_have_no_floor() -> None:
    """Assert that a record does not name the rule where no tolerance follows."""
    run = marched_absolutely(resting("lift"), "dop853")
    assert "atol_floor_rule" not in run.attrs


@pytest.mark.parametrize("method", ["dormand_prince", "dop853", "taylor", "radau_iia"])
@pytest.mark.parametrize("name", ["three", "tank"])
def test_lanes_have_the_same_bits(name: str, method: str) -> None:
    """Assert that runs side by side are those alone, to the bit."""
    case, count = resting(name), 40
    settings = settings_for(case.model, method=method, rtol=1e-8, until=case.until)
    given = {"parameters": {"k": np.linspace(0.1, 8.0, count)}}
    alone, abreast = (march_many(case.model, settings, lanes=lanes, **given) for lanes in (1, 4))
    for result in ("time", "state", "status", "rows", "trials", "evaluations", "largest", "ends"):
        assert getattr(abreast, result).tobytes() == getattr(alone, result).tobytes(), result
    assert abreast.log_block.log.rows.tobytes() == alone.log_block.log.rows.tobytes()
    assert alone.ends["rows"].max() < 20


def row_of_three(count: int) -> xd.Model:
    """Return springs between walls, each as long as it is drawn, whose pulls cancel at every body."""
    return xd.Model(
        name="row",
        dimensions={"body": count},
        coordinates={"u": {"unit": "m", "dims": ["body"]}},
        parameters={"m": "2 kg", "k": "3 N s-1"},
        mass={"u": "m"},
        forces={"pulls": {"u": "(0.1*k*t + 0.2*k*t - 0.3*k*t)*(1 + index(body))"}},
        initial={"u": "0*metre", "v_u": "0*metre/second"},
    )


@pytest.mark.parametrize("method", ["dormand_prince", "dop853", "taylor", "radau_iia"])
def test_elements_of_loops_rest(method: str) -> None:
    """Assert that forces that cancel at every element of a dimension end no run either."""
    run = xd.simulate(row_of_three(60), method=method, rtol=1e-8, until=2.0)
    assert run.attrs["run_outcome"] == "completed"
    assert run.sizes["step"] < 30


@pytest.mark.parametrize("rtol", [1e-6, 1e-8, 1e-10])
@pytest.mark.parametrize("method", ["dormand_prince", "dop853", "taylor", "radau_iia"])
def test_nothing_loosens_where_motion_is_real(method: str, rtol: float) -> None:
    """Assert the bits of the former rule where of pulls that cancel a thousandth is left."""
    model = xd.Model(
        name="pulled",
        coordinates={"x": {"unit": "m"}},
        parameters={"m": "1 kg", "F": "1000 N", "k": "1 N m-1"},
        mass={"x": "m"},
        forces={"pulls": {"x": "F - 0.999*F - k*x"}},
        initial={"x": "0 m", "v_x": "0 m s-1"},
    )
    run, former = (xd.simulate(model, method=method, rtol=rtol, until=10.0, atol_floor=rule) for rule in ATOL_FLOORS)
    assert (run.sizes["step"], run.x.values.tobytes()) == (former.sizes["step"], former.x.values.tobytes())

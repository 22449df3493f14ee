"""The sign, the factor and the run of every quantity that refinements, limits and comparisons return."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.evidence.refining.convergence import observed_orders
from xdynamics.evidence.refining.levels import STEPS, Levels
from xdynamics.evidence.refining.subjects import TrackedValue, family

OSCILLATOR = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")  # cos 2t
DRAG = xd.Model.from_toml(MODELS / "ball_drag.toml")


def test_errors_of_interpolation_are_of_their_level() -> None:
    """Assert that each level has its own run's, and differences are of the finer level less the coarser."""
    study = xd.refine(OSCILLATOR, method="rk4", steps=[0.2, 0.1, 0.05], at=[1.23], until=2.0)
    for k, step in enumerate((0.2, 0.1, 0.05)):
        inside = xd.sample(xd.simulate(OSCILLATOR, method="rk4", step=step, until=2.0), [1.23])
        assert float(study.interpolation_error_x[k, 0]) == float(inside.error_x[0])
        assert float(study.x[k, 0]) == float(inside.x[0])
    assert float(study.difference_x[0, 0]) == float(study.x[1, 0] - study.x[0, 0])
    scale = float(study.difference_scale_x)
    finest = xd.simulate(OSCILLATOR, method="rk4", step=0.05, until=2.0)
    assert scale == float(np.abs(finest.x).max())
    assert float(study.scaled_difference_x[1, 0]) == float(study.difference_x[1, 0]) / scale


def test_gates_compare_with_the_next_finer_level() -> None:
    """Assert that a level fails where its own error is beyond its own difference, and the finest by the last difference."""
    levels = Levels(OSCILLATOR, STEPS, np.array([0.4, 0.2, 0.1]), 2.0)
    values, errors = np.array([[1.0, 1.3, 1.4]]), np.array([[0.2, 0.2, 0.05]])
    one = TrackedValue("x", "m", "x", (), values, errors, np.zeros(1), np.zeros(1), 1.0)
    found = family(one, levels, 100)
    assert found["gate_x"][1].tolist() == [0, 1, 0]
    worse = TrackedValue("x", "m", "x", (), values, np.array([[0.2, 0.05, 0.2]]), np.zeros(1), np.zeros(1), 1.0)
    assert family(worse, levels, 100)["gate_x"][1].tolist() == [0, 0, 1]
    assert float(found["limit_x"][1]) > 1.4 or np.isnan(found["limit_x"][1])


def test_orders_have_their_sign() -> None:
    """Assert that orders are positive where differences fall, and negative where they grow, by the same number."""
    h = np.array([0.4, 0.2, 0.1])
    assert observed_orders(1 + h**1.5, h)[1] == pytest.approx(1.5)
    assert observed_orders(1 - h**-1.5, h)[1] == pytest.approx(-1.5)


def test_states_behind_events_and_their_doubt() -> None:
    """Assert that what is behind a reset is, with the location's uncertainty times the rate, and counts of each level."""
    model = xd.Model(
        name="reset",
        coordinates={"y": "m"},
        parameters={"m": "1 kg", "g": "9.81 m s-2"},
        mass={"y": "m"},
        forces={"gravity": {"potential": "m*g*y"}},
        initial={"y": "1 m", "v_y": "0 m s-1"},
        events={
            "back": {
                "function": "y",
                "direction": "falling",
                "action": "reset",
                "set": {"v_y": "-0.5*v_y"},
                "time_tolerance": "1e-6 s",
            }
        },
    )
    study = xd.refine(model, method="rk4", steps=[0.04, 0.02], until=0.9)
    speed = np.sqrt(2 * 9.81)
    assert study.after_back_v_y.values[:, 0] == pytest.approx(0.5 * speed, rel=1e-5)
    for k, step in enumerate((0.04, 0.02)):
        run = xd.simulate(model, method="rk4", step=step, until=0.9)
        assert int(study.event_count_back[k]) == int((run.event_detector == 0).sum())
        doubt = float(run.event_time_uncertainty[0])
        assert float(study.interpolation_error_event_time_back[k, 0]) == doubt
        assert float(study.interpolation_error_after_back_v_y[k, 0]) == pytest.approx(9.81 * doubt)


def test_comparisons_know_both_runs() -> None:
    """Assert second minus first, and interpolation errors of both runs together, whichever is the coarse one."""
    runs = [xd.simulate(OSCILLATOR, method="rk4", step=step, until=2.0) for step in (0.2, 0.11)]
    at = [0.37, 1.71]
    inside = [xd.sample(run, at) for run in runs]
    both = inside[0].error_x.values + inside[1].error_x.values
    assert (inside[0].error_x.values > 0).all()
    assert (inside[1].error_x.values > 0).all()
    for first, second in ((0, 1), (1, 0)):
        apart = xd.compare(runs[first], runs[second], times=at)
        assert apart.interpolation_error_x.values == pytest.approx(both, rel=1e-12)
        assert apart.difference_x.values == pytest.approx(inside[second].x.values - inside[first].x.values, rel=1e-12)


def test_comparisons_of_events_know_both_runs() -> None:
    """Assert times of events, second minus first, and the uncertainties of both locations together."""
    text = DRAG.to_toml()
    runs = []
    for tolerance in ("1e-5 s", "1e-7 s"):
        model = xd.Model.from_text(text.replace("1e-12 s", tolerance))
        runs.append(xd.simulate(model, method="rk4", step=0.05, until=5.0, time_tolerance=tolerance))
    apart = xd.compare(*runs)
    doubts = [run.event_time_uncertainty.values[-1] for run in runs]
    assert doubts[0] > 10 * doubts[1] > 0.0
    assert float(apart.interpolation_error_event_time_ground[0]) == doubts[0] + doubts[1]
    assert float(apart.difference_event_time_ground[0]) == float(runs[1].event_time[-1] - runs[0].event_time[-1])
    back = xd.compare(runs[1], runs[0])
    assert float(back.difference_event_time_ground[0]) == -float(apart.difference_event_time_ground[0])


@pytest.mark.parametrize(("limit", "said"), [("1e9 m s-1", "1/vt"), ("1e7 m s-1", "1/vt")])
def test_a_limit_that_stands_for_infinity_has_an_order(limit: str, said: str) -> None:
    """Assert order two of drag in 1/vt, and that distances have the sign of y less that of the limit."""
    found = xd.limiting(
        DRAG, "vt", ["100 m s-1", "1000 m s-1", "10000 m s-1"], limit, at=["1 s"], method="dop853", rtol=1e-12
    )
    assert found.attrs["order_in"] == said
    assert found.order_y.values[1:, 0] == pytest.approx(2.0, abs=0.01)
    assert np.isnan(found.order_y.values[0, 0])
    assert (found.distance_y.values < 0.0).all()  # drag keeps it lower
    assert found.distance_y.values == pytest.approx(found.y.values - found.limit_y.values)
    assert float(found.limit_y[0]) == pytest.approx(20.0 - 9.80665 / 2, rel=1e-9)
    assert found.approached_y.values.tolist() == [1]


def test_a_limit_that_is_near_has_its_own_order() -> None:
    """Assert order one in a stiffness that comes to a finite one, from above and below."""
    for values in ([4.4, 4.2, 4.1], [3.6, 3.8, 3.9]):
        found = xd.limiting(OSCILLATOR, "k", values, 4.0, at=["1 s"], method="dop853", rtol=1e-12)
        assert found.attrs["order_in"] == "k"
        assert found.order_x.values[1:, 0] == pytest.approx(1.0, abs=0.15)


def test_no_run_is_begun_that_has_no_room(tmp_path: Path) -> None:
    """Assert what is said of a grid that memory or the disk has no room for, at once, and of sizes that are none."""
    asked: dict[str, Any] = {"method": "rk4", "until": 10.0}
    with pytest.raises(
        xd.InputError, match=r"the run makes 1e\+13 rows, which take .* TB, and .* of memory can be had"
    ):
        xd.simulate(OSCILLATOR, step=1e-12, **asked)
    with pytest.raises(xd.InputError, match="1 kB of memory were allowed; give path="):
        xd.simulate(OSCILLATOR, step=1e-3, memory="1 kB", **asked)
    with pytest.raises(xd.InputError, match="and the disk of .* free; take a longer step"):
        xd.simulate(OSCILLATOR, step=1e-14, path=tmp_path / "run.nc", **asked)
    for memory in ("much", -1, "2 m", True, "nan", "0 B"):
        with pytest.raises(xd.InputError, match="memory is .*, needs a positive size like '2 GB'"):
            xd.simulate(OSCILLATOR, step=0.1, memory=memory, **asked)
    with pytest.raises(xd.InputError, match=r"which take .*, and .* of memory can be had"):
        xd.limiting(OSCILLATOR, "k", [4.4, 4.2], 4.0, at=["1 s"], step=1e-12, **asked)


def test_levels_are_not_added_beyond_bounds() -> None:
    """Assert that a change that no machine could come to ends at once, with the step, rows and bytes it would need."""
    study = xd.refine(OSCILLATOR, method="midpoint", steps=[0.1], until=3.0, until_change={"x": 1e-18}, most_rows=1e4)
    assert "rounding alone moves x by" in study.attrs["stopped"]
    study = xd.refine(OSCILLATOR, method="forward_euler", steps=[0.01], until=3.0, until_change={"x": 1e-12})
    assert study.sizes["level"] <= 4
    assert "x would need a step_size of about " in study.attrs["stopped"]
    assert "e-13 s: 1e+13 rows (" in study.attrs["stopped"]
    assert "more than most_rows = 10000000" in study.attrs["stopped"]
    study = xd.refine(OSCILLATOR, method="rk4", steps=[0.1], until=3.0, until_change={"x": 1e-12}, memory="20 kB")
    assert "20 kB of memory were allowed" in study.attrs["stopped"]
    with pytest.raises(xd.InputError, match="there is no second one: the next one would have 62 rows"):
        xd.refine(OSCILLATOR, method="rk4", steps=[0.1], until=3.0, until_change={"x": 1e-12}, most_rows=50)
    with pytest.raises(xd.InputError, match="most_rows is 0, needs a number of rows"):
        xd.refine(OSCILLATOR, method="rk4", steps=[0.1], until=3.0, until_change={"x": 1.0}, most_rows=0)


def test_a_level_that_ended_badly_is_named() -> None:
    """Assert that of levels whose steps are used up before the times of comparison the first is named, with its outcome."""
    with pytest.raises(
        xd.InputError, match="the level with rtol = 1e-07 ended before t = 2 s, as 'step_limit': .* raise max_steps"
    ):
        xd.refine(OSCILLATOR, method="forward_euler", rtols=[1e-3, 1e-4, 1e-7], until=3.0, at=[2.0], max_steps=20_000)
    study = xd.refine(
        OSCILLATOR, method="forward_euler", rtols=[1e-2], until=3.0, max_steps=20_000, until_change={"x": 1e-5}
    )
    assert "as 'step_limit'" in study.attrs["stopped"] or "more than" in study.attrs["stopped"]

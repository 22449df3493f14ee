"""Switches that are declared smooth: not located, but counted, told, and not trusted with an order."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from xdynamics.evidence.refining.convergence import VERDICTS
from xdynamics.model.switches import smooth_switches


def ball(v: float = 20.0, vt: float = 30.0, **more: Any) -> xd.Model:
    """A ball thrown upward with quadratic drag, declared smooth."""
    return xd.Model(
        name="ball",
        coordinates={"y": "m"},
        parameters={"m": "0.145 kg", "g": "9.81 m s-2", "vt": f"{vt!r} m s-1"},
        mass={"y": "m"},
        initial={"y": "0 m", "v_y": f"{v!r} m s-1"},
        forces={"gravity": {"potential": "m*g*y"}, "drag": {"y": "-m*g*v_y*abs(v_y)/vt**2", "smooth": True}},
        **more,
    )


def passings(force: str, x: float, v: float, **asked: Any) -> tuple[xd.Model, Any]:
    """An oscillator with a force that is declared smooth, and its run."""
    model = xd.Model(
        name="smooth",
        coordinates={"x": "m"},
        parameters={"m": "1 kg", "k": "1 N m-1"},
        mass={"x": "m"},
        forces={"spring": {"x": "-k*x"}, "odd": {"x": force, "smooth": True}},
        initial={"x": f"{x!r} m", "v_x": f"{v!r} m s-1"},
    )
    return model, xd.simulate(model, **asked)


def test_the_apex_is_passed_once() -> None:
    """Assert count and time of the row behind the apex, the words of the outcome, and that before it there is none."""
    model = ball()
    run = xd.simulate(model, method="rk4", step=0.01, until=3.0)
    assert run.smooth_switches_passed.values.tolist() == [1]
    assert run.smooth_switches_passed.attrs["names"] == "drag.abs"
    assert float(run.smooth_switches_first_passed[0]) == float(run.time[np.flatnonzero(run.v_y.values < 0)[0]])
    assert "declared smooth were passed by a step: drag.abs once, first before t = 1.8" in run.attrs["run_outcome_text"]
    short = xd.simulate(model, method="rk4", step=0.01, until=1.0)
    assert short.smooth_switches_passed.values.tolist() == [0]
    assert np.isnan(short.smooth_switches_first_passed.values).all()
    assert short.attrs["run_outcome_text"] == "reached t = 1 s"
    assert "smooth_switches_passed" not in xd.simulate(
        model.replace(forces={"drag": {"y": "-m*g*v_y*abs(v_y)/vt**2"}}), method="rk4", step=0.1, until=1.0
    )


@pytest.mark.parametrize(
    ("force", "flatness"),
    [
        ("-v_x*abs(v_x)*kilogram/metre", 2),
        ("-k*abs(x)", 1),
        ("-k*sign(x)*metre", 0),
        ("-k*x**2*sign(x)/metre", 2),
        ("-max(k*x, 2*k*x)", 1),
    ],
)
def test_how_flat_a_switch_is(force: str, flatness: int) -> None:
    """Assert the derivative that jumps, by products of a switch with its own argument."""
    model = passings(force, 1.0, 0.0, method="rk4", step=0.1, until=0.1)[0]
    assert [switche.flatness for switche in smooth_switches(model)] == [flatness]


FORCES = (
    ("-0.1*v_x*abs(v_x)*kilogram/metre", ("v_x", 0.0)),
    ("-0.3*k*abs(x - 0.2*metre)", ("x", 0.2)),
    ("-k*max(x - 0.3*metre, -0.1*metre)", ("x", 0.2)),
    ("where(x > 0*metre, -k*max(x, 0.3*metre), -0.3*k*metre)", None),
)


@pytest.mark.cases(100)
def test_counts_of_random_oscillations(case: int) -> None:
    """Assert counts against signs along the rows, by every way of choosing steps; of nested ones where they decide."""
    rng = np.random.default_rng(case)
    force, passed = FORCES[case % len(FORCES)]
    asked = {"method": "dop853", "rtol": 1e-6} if case % 3 else {"method": "radau_iia", "step": 0.11}
    x, v = rng.normal(size=2).tolist()
    _, run = passings(force, x, v, until=float(rng.uniform(2, 25)), **asked)
    if passed is not None:
        signs = np.sign(run[passed[0]].values - passed[1])
        assert run.smooth_switches_passed.values.tolist() == [int(np.sum(signs[1:] != signs[:-1]))]
        return
    inside, side, count = run.x.values > 0, 0, 0  # what is told anew on the way into the branch
    for here, value in zip(inside.tolist(), (run.x.values - 0.3).tolist(), strict=True):
        now = np.sign(value) if here else 0
        count, side = count + int(side * now < 0), now
    names = run.smooth_switches_passed.attrs["names"].split()
    found = dict(zip(names, run.smooth_switches_passed.values.tolist(), strict=True))
    assert found == {"odd.max": count, "odd.where": int(np.sum(inside[1:] != inside[:-1]))}


@pytest.mark.dear
def test_many_runs_count_alike() -> None:
    """Assert that runs in lanes have the counts of runs alone, one after the other too, and that sweeps tell them."""
    from xdynamics.march.configuration import settings_for
    from xdynamics.march.ensemble import march_many

    model, starts = ball(), np.linspace(-5, 25, 40)
    for asked in ({"method": "dop853", "rtol": 1e-7}, {"method": "rk4", "step": 0.013}):
        settings = settings_for(model, until=3.0, **asked)
        alone, beside = (march_many(model, settings, initial={"v_y": starts}, lanes=lanes) for lanes in (1, 8))
        assert np.array_equal(alone.passed, beside.passed)
        assert alone.log_block.log.rows.tobytes() == beside.log_block.log.rows.tobytes()
        assert alone.passed[:, 0].tolist() == [int(v > 0) for v in starts.tolist()]
    swept = xd.sweep(model, axes={"v_y": ["5 m s-1", "20 m s-1"]}, method="rk4", step=0.01, until=1.0).compute()
    assert swept.smooth_switches_passed.values.tolist() == [1, 0]
    from xdynamics.sweeping.sweep_summary import sweep_lines

    assert any("1 members passed switches" in line or "1 member passed" in line for line in sweep_lines(swept))


def test_an_extension_goes_on_counting(tmp_path: Path) -> None:
    """Assert that a run in two parts has the counts and the digest of the whole, wherever it was cut."""
    for cut in (1.0, 1.81, 2.5):
        whole = xd.simulate(ball(), method="rk4", step=0.01, until=4.0, nodes=[cut])
        part = xd.extend(xd.simulate(ball(), method="rk4", step=0.01, until=cut), until=4.0)
        assert part.smooth_switches_passed.values.tolist() == [1]
        assert xd.content_digest(part) == xd.content_digest(whole)
    path = xd.save(whole, tmp_path / "ball.nc")
    assert xd.reproduce(path).attrs["identical"] == 1


METHODS = ("dop853", "radau_iia", "rk4", "dormand_prince", "bogacki_shampine", "midpoint")


@pytest.mark.every(2)
@pytest.mark.cases(240)
def test_refinements_past_an_apex(case: int) -> None:
    """Assert that heights of random balls with drag are held by their uncertainty, by steps and by tolerances, against the closed form."""
    rng, g = np.random.default_rng(case), 9.81
    v, vt, method = float(rng.uniform(5, 30)), float(rng.uniform(10, 40)), METHODS[case % len(METHODS)]
    phase = math.atan(v / vt)
    apex = vt / g * phase
    at = apex * float(rng.uniform(1.05, 2.0))
    h, levels = float(rng.uniform(0.02, 0.5)) * apex, int(rng.integers(3, 6))
    varied: dict[str, Any] = {"steps": [h / 2**k for k in range(levels)], "estimator": "none"}
    if case % 4 == 0:
        varied = {"rtols": [1e-4 / 10**k for k in range(levels)]}
    study = xd.refine(ball(v, vt), method=method, at=[at], until=at, **varied)
    true = {
        "y": vt**2 / g * math.log(1 / math.cos(phase) / math.cosh(g * (at - apex) / vt)),
        "v_y": -vt * math.tanh(g * (at - apex) / vt),
    }
    for name, value in true.items():
        assert abs(float(study[name][-1, 0]) - value) <= float(study[f"uncertainty_{name}"][0]) + 1e-14


def test_before_a_switch_is_passed_all_is_smooth() -> None:
    """Assert that numbers before the apex are asymptotic, and those behind it are not."""
    study = xd.refine(ball(), method="rk4", steps=[0.1, 0.05, 0.025, 0.0125], at=[1.0, 3.0], until=3.0)
    assert [VERDICTS[one] for one in study.verdict_y.values] == ["asymptotic", "event_limited"]


def test_clean_orders_do_not_hide_a_switch() -> None:
    """Assert an apex that lies as closely behind a grid time in every level: the differences do not show what it costs."""
    vt, g, v, h = 30.0, 9.81, 20.0, 0.2
    phase = math.atan(v / vt)
    apex = vt / g * phase
    v = vt * math.tan(g * (math.floor(apex / h) * h + 0.02 * h) / vt)  # the apex 2 % of a step behind a grid time
    phase, at = math.atan(v / vt), 3.0
    study = xd.refine(ball(v, vt), method="radau_iia", steps=[h, h / 2, h / 4], at=[at], until=at, estimator="none")
    true = vt**2 / g * math.log(1 / math.cos(phase) / math.cosh(g * (at - vt / g * phase) / vt))
    error, difference = abs(float(study.y[-1, 0]) - true), abs(float(study.difference_y[-2, 0]))
    assert float(study.order_y[1, 0]) == pytest.approx(5.0, abs=0.05)
    assert error > difference / 10
    assert error <= float(study.uncertainty_y[0]) <= 20 * error
    assert VERDICTS[int(study.verdict_y[0])] == "event_limited"


def test_switches_that_cannot_be_located_are_counted_on() -> None:
    """Assert that a relay on which the motion would stick, and a table, are held by the last differences alone."""
    model, _ = passings("-0.3*newton*sign(v_x)", 1.0, 0.0, method="rk4", step=0.1, until=0.1)
    study = xd.refine(model, method="rk4", steps=[0.04, 0.02, 0.01, 0.005], at=[9.0], until=9.0, sliding="ends")
    rule = study.uncertainty_rule_x.attrs["flag_meanings"].split()[int(study.uncertainty_rule_x[0])]
    assert rule == "three_times_the_last_differences_a_switch_was_stepped_over"
    assert abs(float(study.x[-1, 0])) <= 0.3 + float(study.uncertainty_x[0])  # it rests where friction holds the spring

"""Ten problems with closed forms, smooth, limited by events, with contact: what refinements say of them is so."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.exact_problems import METHODS, SMOOTH, falling, known
from cases.problems import MODELS, oscillator
from xdynamics.evidence.refining.convergence import VERDICTS, judge


def studied(model: xd.Model, method: str, step: float, **asked: Any) -> Any:
    """A refinement over five steps; None where the method refuses the model."""
    if xd.METHODS[method].refusals(model):
        return None
    return xd.refine(model, method=method, steps=[step / 2**k for k in range(5)], **asked)


def told(study: Any, name: str, k: int = 0) -> tuple[str, float, float, float]:
    """Verdict, last order, finest value, uncertainty."""
    order = float(np.atleast_2d(study[f"order_{name}"].values)[-2, k])
    value = float(np.atleast_2d(study[name].values)[-1, k])
    return (
        VERDICTS[int(study[f"verdict_{name}"].values[k])],
        order,
        value,
        float(study[f"uncertainty_{name}"].values[k]),
    )


@pytest.mark.every(7)
@pytest.mark.parametrize("name", SMOOTH)
def test_smooth_problems(name: str) -> None:
    """Assert orders, at two times, one of them between accepted states, and that errors are within uncertainties, most within a factor of three."""
    problem, step, end = SMOOTH[name]
    factors, words = [], []
    times = np.array([0.7313 * end, end])
    true = problem().exact(times)
    for method in METHODS:
        study = studied(problem().model, method, step, until=end, at=times.tolist())
        if study is None:
            continue
        for quantity in true:
            for k in (0, 1):
                word, order, value, doubt = told(study, quantity, k)
                formal, off = xd.METHODS[method].order, abs(value - float(true[quantity][k]))
                words.append(word)
                if word == "asymptotic":
                    assert order == pytest.approx(max(formal, round(order)), abs=0.05)
                    factors.append(doubt / max(off, 1e-300))
                assert off <= doubt + 4e-16 * abs(value), (method, quantity, word)
    assert words.count("asymptotic") > len(words) / 3
    assert 1.0 <= np.median(factors) <= 3.0


@pytest.mark.every(7)
@pytest.mark.parametrize("case", list(known()), ids=lambda case: case[0])
def test_events_and_contacts(case: tuple[str, xd.Model, dict[str, Any], dict[str, float]]) -> None:
    """Assert that times of events, impacts and stops, and the states behind, are known as well as is said."""
    _, model, asked, true = case
    seen = 0
    for method in METHODS:
        study = studied(model, method, 0.05, **asked)
        for name, exact in true.items() if study is not None else ():
            word, order, value, doubt = told(study, name)
            assert abs(value - exact) <= doubt + 1e-15, (method, name, word)
            if word == "asymptotic":
                formal = xd.METHODS[method].order
                assert order == pytest.approx(max(formal, round(order)), abs=0.05)
            seen += 1
    assert seen >= 5


def test_a_missed_event_is_not_asymptotic() -> None:
    """Assert the verdict where coarse levels have a bounce that fine ones have not: the number of events differs before the time."""
    study = xd.refine(falling(0.8), method="euler_cromer", steps=[0.04, 0.02, 0.01], at=[2.17], until=2.2)
    counts = study.event_count_floor.values
    assert len({*counts.tolist()}) > 1
    if counts[-1] != counts[-2]:
        assert told(study, "y")[0] == "event_limited"
    assert (np.diff(study.event_time_floor.values, axis=0) > 0).all()  # the same bounces, later with finer steps


def test_an_interpolation_that_is_too_coarse_limits() -> None:
    """Assert that cubic interpolation of an eighth-order run between its rows fails the gate, and says so."""
    asked = {"method": "dop853", "steps": [0.4, 0.2, 0.1], "until": 2.0, "estimator": "none"}
    grid = xd.refine(oscillator().model, at=[1.6], **asked)
    between = xd.refine(oscillator().model, at=[1.7], **asked)
    assert told(grid, "x")[0] in ("asymptotic", "pre_asymptotic")
    assert (grid.interpolation_error_x == 0.0).all()
    assert float(between.interpolation_error_x[-1, 0]) > 0.0
    loose = xd.refine(
        oscillator().model, at=[1.77], method="dop853", rules=["interpolant", "reintegrate"], step=0.4, until=2.0
    )
    assert abs(float(loose.difference_x[0, 0])) > float(loose.interpolation_error_x[1, 0])


def test_a_chaotic_run_beyond_its_time_does_not_converge() -> None:
    """Assert that a double pendulum is asymptotic while it can be believed, and not converging long after."""
    model = xd.Model.from_toml(MODELS / "double_pendulum.toml")
    study = xd.refine(
        model,
        method="rk4",
        steps=[0.01, 0.005, 0.0025, 0.00125],
        at=[1.0, 60.0],
        until=60.0,
        observables=["th1", "th2"],
    )
    assert told(study, "th1", 0)[0] in ("asymptotic", "pre_asymptotic")
    assert told(study, "th2", 1)[0] == "not_converging"


def test_a_floor_of_rounding_is_seen() -> None:
    """Assert the verdict where steps are so fine that only rounding is left."""
    study = xd.refine(
        oscillator().model, method="dop853", steps=[0.02, 0.01, 0.005], at=[1.0], until=1.0, estimator="none"
    )
    assert told(study, "x")[0] == "roundoff"
    assert abs(told(study, "x")[2] - math.cos(2.0)) <= told(study, "x")[3]


@pytest.mark.every(7)
@pytest.mark.parametrize(
    ("method", "levels"),
    [("forward_euler", 4), ("midpoint", 3), ("midpoint", 5), ("rk4", 4), ("dormand_prince", 3), ("dormand_prince", 5)],
)
def test_no_lucky_cancellation_passes(method: str, levels: int, request: pytest.FixtureRequest) -> None:
    """Assert, at times where error terms of two orders now and then cancel, that 98 in 100 errors are within their uncertainty.

    At 70 times, or with --whole at 200.
    """
    count = 200 if request.config.getoption("--whole") else 70
    times = np.sort(np.random.default_rng(3).uniform(0.5, 10.0, count))
    h = {"forward_euler": 0.05, "midpoint": 0.1, "rk4": 0.2, "dormand_prince": 0.2}[method]
    study = xd.refine(
        oscillator().model,
        method=method,
        steps=[h / 2**k for k in range(levels)],
        at=times.tolist(),
        until=10.0,
        observables=["x"],
        estimator="none",
    )
    off = np.abs(study.x.values[-1] - np.cos(2 * times))
    held = study.uncertainty_x.values >= off - 1e-15
    assert held.mean() >= 0.98
    assert np.median(study.uncertainty_x.values / np.maximum(off, 1e-300)) < 8.0
    certain = study.verdict_x.values == VERDICTS.index("asymptotic")
    assert certain.sum() < 5 or held[certain].mean() >= 0.95


def test_names_that_take_each_others_place() -> None:
    """Assert that a state named like the tolerances is refused where tolerances are varied."""
    model = xd.Model(
        name="clash",
        coordinates={"x": "m"},
        mass={"x": "1*kilogram"},
        forces={"s": {"x": "-x*newton/metre"}},
        states={"rtol": {"unit": "1", "rate": "-rtol/second"}},
        initial={"x": "1 m", "v_x": "0 m s-1", "rtol": "1"},
    )
    with pytest.raises(xd.InputError, match="'rtol' is a name of the model, and of what is said of its numbers"):
        xd.refine(model, method="rk4", rtols=[1e-3, 1e-4], until=1.0)
    assert "x" in xd.refine(model, method="rk4", rtols=[1e-3, 1e-4], until=1.0, observables=["x"])


def test_tolerances_are_judged_with_care() -> None:
    """Assert that two exponents beside 1 are steady and one alone is not, and by what Richardson's error is multiplied."""
    tolerances, known = 10.0 ** -np.arange(4.0, 8.0), {"smooth": False, "accepted": 100, "order": 5.0}
    even = judge(1.0 + 3.0 * tolerances, tolerances, 1.0, 1e-16, 0.0, 0.0, **known)
    assert VERDICTS[even.verdict] == "asymptotic"
    assert even.uncertainty == pytest.approx(1.25 * math.exp(0.15 * 25.0 / 10.0) * 3.0 * tolerances[-1], rel=1e-6)
    assert even.rule == "a power of the tolerance"
    alone = judge(1.0 + 3.0 * tolerances[1:], tolerances[1:], 1.0, 1e-16, 0.0, 0.0, **known)
    assert VERDICTS[alone.verdict] == "pre_asymptotic"
    assert alone.uncertainty == pytest.approx(even.uncertainty, rel=1e-6)
    high, low = (
        judge(1.0 + 3.0 * tolerances, tolerances, 1.0, 1e-16, 0.0, 0.0, smooth=False, accepted=64, **order).uncertainty
        for order in ({}, {"order": 2.0})
    )  # without a word of the method it is that of the highest order
    assert high / low == pytest.approx(math.exp(0.15 * (64.0 - 4.0) / 8.0), rel=1e-6)
    # order 1.7: it is counted on for 1, times what 0.7 makes of one ratio
    steep = 1.0 + tolerances**1.7
    uneven = judge(steep, tolerances, 1.0, 1e-25, 0.0, 0.0, **known)
    falls = np.abs(np.diff(steep))[-2:] / 9.0 / np.array([10.0, 1.0])
    assert VERDICTS[uneven.verdict] == "pre_asymptotic"
    assert uneven.uncertainty == pytest.approx(1.25 * 10.0**0.7 * falls.max(), rel=1e-5)


@pytest.mark.parametrize(
    ("method", "rtols"),
    [
        ("dormand_prince", [1e-5, 1e-6, 1e-7]),
        ("dop853", [1e-7, 1e-8, 1e-9]),
        ("dop853", [1e-4, 1e-5, 1e-6]),
    ],
)
def test_tolerances_hold_on_an_orbit(method: str, rtols: list[float]) -> None:
    """Assert, at 40 times of an ellipse, that at least 95 in 100 errors are within their uncertainty, and none of three levels asymptotic."""
    orbit = xd.Model.from_toml(MODELS / "kepler.toml")
    times = np.linspace(1.0, 19.0, 40)
    true = xd.sample(xd.simulate(orbit, method="dop853", rtol=1e-13, atol=1e-14, until=20.0), times).x.values
    study = xd.refine(orbit, method=method, rtols=rtols, at=times.tolist(), until=20.0, observables=["x"])
    assert not (study.verdict_x == VERDICTS.index("asymptotic")).any()
    assert (np.abs(study.x.values[-1] - true) <= study.uncertainty_x.values).mean() >= 0.95

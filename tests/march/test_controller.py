"""Step control, one decision at a time, by the formulas of the books.

The error at the end of a run follows its tolerances by the power that the estimate and its rescaling imply.
"""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import xdynamics as xd
from cases.plain import kept, law_of, made_by_hand, plain
from cases.problems import EPS
from xdynamics.kernels.program import UNSOUND, T
from xdynamics.march import control
from xdynamics.march.configuration import settings_for
from xdynamics.march.ensemble import march_many
from xdynamics.march.run import Run
from xdynamics.methods import METHODS, Method
from xdynamics.model.motion import variables

SAFETY, LEAST, GREATEST, K, LONGEST = 0.9, 0.2, 10.0, 5.0, 100.0


def controlled(**now: Any) -> Run:
    """A run whose steps are chosen with an estimate that falls as h**5."""
    run = made_by_hand()
    plan = run.plan[0]
    plan.order, plan.safety, plan.least, plan.greatest, plan.max_step = K, SAFETY, LEAST, GREATEST, LONGEST
    for name, value in now.items():
        run.now[name] = value
    return run


def grown(run: Run, h: float, *, cut: bool = False) -> float:
    plain(control.grow_step)(run, h, cut)
    return float(run.now[0].step)


def reduced(run: Run, h: float, *, failed_test: bool = True) -> float:
    plain(control.reduce_step)(run, h, failed_test)
    return float(run.now[0].step)


def test_an_error_of_the_tolerance_passes() -> None:
    """Assert that 1 is allowed, the next number is not, and what is no number is not."""
    assert [plain(control.accepts)(norm) for norm in (0.0, 1.0, 1.0 + 2**-52, math.nan)] == [True, True, False, False]


@pytest.mark.parametrize(("pair", "found"), [((1.0, 2.0), 2.0), ((2.0, 1.0), 2.0), ((3.0, 3.0), 3.0)])
def test_the_larger(pair: tuple[float, float], found: float) -> None:
    """Assert the larger of two numbers, and that one that is lost stays lost."""
    assert plain(control.larger)(*pair) == found
    assert math.isnan(plain(control.larger)(math.nan, pair[1]))
    assert math.isnan(plain(control.larger)(pair[0], math.nan))


@pytest.mark.parametrize(
    ("errors", "norm"),
    [
        ([2e-3, 0.0], 2e-3 / (1e-2 + 1e-3 * 4)),
        ([0.0, -6e-3], 6e-3 / (1e-3 + 1e-3 * 2)),
        ([0.0, 0.0], 0.0),
        ([math.nan, 1e-3], math.nan),
        ([1e-3, math.nan], math.nan),
        ([math.nan, 0.0], math.nan),
    ],
)
def test_the_norm_is_of_the_worst_component(errors: list[float], norm: float) -> None:
    """Assert the scale of each component: the larger of its values at either end, whatever their signs."""
    run = made_by_hand(
        e=np.array(errors), atol=np.array([1e-2, 1e-3]), y=np.array([-4.0, 1.0, 9.0]), z=np.array([1.0, -2.0, 9.0])
    )
    run.plan[0].rtol = 1e-3
    assert plain(control.trial_error_norm)(run) == pytest.approx(norm, rel=1e-15, nan_ok=True)


def test_a_component_that_stays_zero_has_no_error() -> None:
    """Assert that no scale is asked for where there is no error: zero over zero is no number."""
    run = made_by_hand()
    assert plain(control.trial_error_norm)(run) == 0.0


def test_the_shortest_step() -> None:
    """Assert ten spacings of t, upwards, or what was asked for."""
    run = controlled(t=1.0)
    assert plain(control.shortest_step)(run) == 10 * 2**-52
    run.now[0].t = -1.0
    assert plain(control.shortest_step)(run) == 10 * 2**-53
    run.plan[0].min_step = 1e-3
    assert plain(control.shortest_step)(run) == 1e-3


@pytest.mark.parametrize(("norm", "before"), [(0.5, 0.25), (1e-3, 0.9), (0.9, 1e-3)])
def test_growth_is_by_two_norms(norm: float, before: float) -> None:
    """Assert the PI controller of Hairer, Norsett, Wanner II.4, and what it remembers for the next step."""
    run = controlled(norm=norm, step_log=math.log(before))
    beta = 0.2 / K
    factor = SAFETY * norm ** -(1 / K - 0.75 * beta) * before**beta
    assert grown(run, 0.1) == pytest.approx(0.1 * factor, rel=1e-13)
    assert run.now[0].step_log == pytest.approx(math.log(norm), rel=1e-15)


@pytest.mark.parametrize(("norm", "factor"), [(0.0, GREATEST), (1e-30, GREATEST), (1e30, LEAST)])
def test_growth_has_limits(norm: float, factor: float) -> None:
    """Assert the limits, and that a norm of nearly nothing is remembered as 1e-4."""
    run = controlled(norm=norm)
    assert grown(run, 0.1) == 0.1 * factor
    assert run.now[0].step_log == pytest.approx(math.log(max(norm, 1e-4)), rel=1e-12)


def test_growth_keeps_to_the_longest_and_the_shortest_step() -> None:
    """Assert that what was asked for bounds every step."""
    run = controlled()
    assert grown(run, 50.0) == LONGEST
    run.plan[0].min_step = 3.0
    assert grown(run, 0.1) == 3.0


def test_growth_after_a_rejection_and_after_a_cut() -> None:
    """Assert that a step after a rejected one does not grow, and that one cut short costs nothing but after a rejection."""
    run = controlled(rejected=1)
    assert grown(run, 0.1) == 0.1
    assert run.now[0].rejected == 0
    assert grown(controlled(step=3.0), 0.1, cut=True) == 3.0
    assert grown(controlled(step=0.5), 0.1, cut=True) == 1.0
    assert grown(controlled(step=3.0), 0.1) == 1.0
    assert grown(controlled(step=3.0, rejected=1), 0.1, cut=True) == 0.1


@pytest.mark.parametrize(("growth", "factor"), [(2.0, 2.0), (99.0, GREATEST), (0.01, LEAST)])
def test_predicted_growth_is_taken(growth: float, factor: float) -> None:
    """Assert that a method that predicts its growth is not asked by the norm, and has the same limits."""
    run = controlled(norm=0.5)
    run.kept[0].growth = growth
    assert grown(run, 0.1) == 0.1 * factor
    assert run.now[0].step_log == control.LEAST_LOGARITHM


@pytest.mark.parametrize(
    ("norm", "failed", "factor"),
    [
        (32.0, True, 0.9 / 2),
        (1.0 + 1e-9, True, 0.9),
        (1e30, True, LEAST),
        (math.inf, True, 0.25),
        (math.nan, True, 0.25),
        (32.0, False, 0.25),
    ],
)
def test_a_rejected_step_shrinks_by_its_norm(norm: float, failed: bool, factor: float) -> None:
    """Assert the factor after an error, and a quarter after what has no error."""
    run = controlled(norm=norm, t=1.0)
    assert reduced(run, 0.5, failed_test=failed) == pytest.approx(0.5 * factor, rel=1e-9)
    assert run.now[0].rejected == 1


@pytest.mark.parametrize(
    ("growth", "iterations", "failed", "factor"),
    [(0.5, 3, True, 0.5), (0.99, 3, True, 0.9), (0.5, -1, False, 0.5), (0.5, 3, False, 0.25), (0.5, 0, False, 0.25)],
)
def test_a_predicted_step_shrinks_by_its_growth(growth: float, iterations: int, failed: bool, factor: float) -> None:
    """Assert that the prediction counts after an error or equations that were not solved, and there only."""
    run = controlled(norm=32.0)
    run.kept[0].growth, run.trial[0].iterations = growth, iterations
    assert reduced(run, 0.5, failed_test=failed) == 0.5 * factor


def test_a_large_safety_never_repeats_a_step() -> None:
    """Assert that the trial after one that failed is shorter, whatever the safety factor."""
    run = controlled(norm=1.0 + 1e-12)
    run.plan[0].safety = 2.0
    assert reduced(run, 0.5) == 0.5 * 0.9


def test_a_rejected_step_keeps_to_the_shortest() -> None:
    """Assert that no trial is shorter than ten spacings of t."""
    assert reduced(controlled(norm=32.0, t=1.0), 1e-16) == 10 * 2**-52


def spring(*arrays: NDArray[np.float64]) -> None:
    """Forces of x'' = p - 4 x."""
    arrays[5][2], arrays[0][UNSOUND] = arrays[2][0] - 4.0 * arrays[1][0], 0.0


def by_the_book(
    y: list[float], rtol: float, atol: list[float], k: float, room: float, span: float
) -> tuple[float, float]:
    """Hairer, Norsett, Wanner I, II.4, (a) to (f), for x'' = p - 4 x and in a unit of time of the problem's own."""
    scale = np.array(atol) + rtol * np.abs(y[:2])
    now = np.array([y[1], y[2]])
    size, slope = np.max(np.abs(y[:2]) / scale) or 1.0, np.max(np.abs(now) / scale)
    unit = size / slope if slope else 1e-4 * span
    guess = min(0.01 * unit, room)
    moved = np.array(y[:2]) + guess * now
    curvature = np.max(np.abs(np.array([moved[1], y[2] - 4.0 * (moved[0] - y[0])]) - now) / scale) / guess
    unit = max(unit, math.sqrt(size / curvature)) if curvature else unit
    steepest = max(slope * unit, curvature * unit**2)
    return guess, min(unit, unit * (0.01 / steepest) ** (1 / k)) if steepest else guess


@pytest.mark.parametrize(
    ("y", "atol", "room"),
    [
        ([1.0, 0.0], [1e-8, 1e-8], 10.0),
        ([0.0, 0.0, 9.0], [1e-8, 1e-8], 10.0),
        ([0.0, 1.0], [1e-8, 1e-8], 10.0),
        ([-1.0, 3.0], [1e-3, 1e-9], 10.0),
        ([2.0, -1e-3], [1e-9, 1e-3], 10.0),
        ([0.0, 0.0], [1e-6, 1e-6], 10.0),
        ([1.0, 0.5], [1e-8, 1e-8], 1e-4),
        ([1.0, 1.0], [1e2, 1e2], 10.0),
    ],
)
@pytest.mark.parametrize("t", [0.0, 2.0])
def test_the_first_step_is_by_the_book(y: list[float], atol: list[float], room: float, t: float) -> None:
    """Assert the rule, the probe that it costs, and that the probe keeps before the next node."""
    y = [*y, -4.0 * y[0]][:3]
    nodes = np.array([t - 1.0, t + room]) if room < 10 else np.array([t - 1.0])
    law = law_of(spring, *[kept] * 5)
    push = np.array([y[2] + 4.0 * y[0]])
    run = made_by_hand(law=law, y=np.array(y), p=push, atol=np.array(atol), nodes=nodes)
    plan = run.plan[0]
    plan.rtol, plan.order, plan.max_step, run.now[0].t, plan.end, run.now[0].node = 1e-6, K, 10.0, t, t + 10.0, 1
    guess, step = by_the_book(y, 1e-6, atol, K, room, 10.0)
    assert plain(control.first_step)(run) == pytest.approx(step, rel=1e-9)
    assert run.at[T] == t + guess
    assert run.z[:2] == pytest.approx(np.array(y[:2]) + guess * np.array(y[1:]), rel=1e-14)
    assert run.now[0].evaluations == 1


def test_the_first_step_keeps_to_its_limits() -> None:
    """Assert that neither probe nor step is longer than asked for, nor the step shorter."""
    for longest, shortest, found in ((1e-4, 0.0, 1e-4), (10.0, 1.0, 1.0)):
        run = made_by_hand(
            law=law_of(spring, *[kept] * 5), y=np.array([1.0, 0.0, -4.0]), atol=np.full(2, 1e-8), p=np.zeros(1)
        )
        plan = run.plan[0]
        plan.rtol, plan.order, plan.max_step, plan.min_step = 1e-6, K, longest, shortest
        assert plain(control.first_step)(run) == found
        assert abs(run.half[1]) <= 4.0 * longest


ENDS = (3.0, 4.5, 6.0, 8.0, 10.0)  # s; the largest error of several times, so that none is small by chance
TOLERANCES = 10.0 ** -np.arange(3.0, 11.6, 0.5)
MOST_STEPS = 400_000
ROUNDING, ROUGH = 3e-12, 1e-3  # errors between which the power shows; a first order does not get below a tenth of it


def motion(force: dict[str, str], *, x: str = "1 m", v_x: str = "0 m s-1", **more: str) -> xd.Model:
    """A mass of 1 kg in one dimension or, with `y`, in two."""
    names = ("x", "y") if "y" in more else ("x",)
    return xd.Model(
        name="motion",
        coordinates={name: {"unit": "m"} for name in names},
        parameters={"m": "1 kg", "k": "1 N m-1", "u": "1 m", "w": "1.3 rad s-1"},
        mass=dict.fromkeys(names, "m"),
        forces={"field": force},
        initial={"x": x, "v_x": v_x} | more,
    )


PROBLEMS = {
    "henon_heiles": motion(
        {"potential": "k*((x**2 + y**2)/2 + (x**2*y - y**3/3)/u)"}, x="0.1 m", v_x="0.4 m s-1", y="0.2 m", v_y="0 m s-1"
    ),
    "kepler": motion({"potential": "-k*u**3/hypot(x, y)"}, x="0.7 m", y="0 m", v_y="1.36 m s-1"),
    "pendulum": motion({"x": "-k*u*sin(x/u)"}, x="0 m", v_x="1.5 m s-1"),
    "driven_duffing": motion({"x": "-k*x**3/u**2 + 0.3*k*u*cos(w*t)"}),
    "coupled": motion({"potential": "k*(x**2 + y**2)/2 + 2*k*(x - y)**2"}, y="0 m", v_y="0 m s-1"),
}


@lru_cache
def reference(problem: str, end: float) -> NDArray[np.float64]:
    asked = {"method": "dop853", "rtol": 1e-13, "atol": 1e-14, "until": end, "force_samples": "none"}
    run = xd.simulate(PROBLEMS[problem], **asked)
    return np.array([float(run[name][-1]) for name in variables(PROBLEMS[problem])])


def errors(method: Method, problem: str) -> NDArray[np.float64]:
    """Return the largest error at the ends for each tolerance; nan where the steps did not reach."""
    found = np.zeros(len(TOLERANCES))
    for end in ENDS:
        settings = settings_for(PROBLEMS[problem], method=method.name, rtol=1e-3, until=end, max_steps=MOST_STEPS)
        runs = march_many(PROBLEMS[problem], settings, rtols=affordable(method))
        apart = np.abs(runs.state - reference(problem, end)).max(axis=1)
        apart[np.array(runs.outcomes) != "completed"] = np.nan
        found[: len(apart)] = np.maximum(found[: len(apart)], apart)
        found[len(apart) :] = np.nan
    return found


def affordable(method: Method) -> NDArray[np.float64]:
    """Return tolerances that a low order reaches in a bounded number of steps."""
    return TOLERANCES[10.0 ** -(2.0 + 2.5 * method.order) <= TOLERANCES]


def power(method: Method, problem: str) -> float:
    """Fit the power of the tolerance that the error is."""
    found = errors(method, problem)
    shows = (found > ROUNDING) & (found < (ROUGH if method.order > 1 else 50 * ROUGH))
    assert shows.sum() >= 3
    return float(np.polyfit(np.log(TOLERANCES[shows]), np.log(found[shows]), 1)[0])


@pytest.mark.every(17)
@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
def test_errors_are_proportional_to_tolerances(method: Method) -> None:
    """Assert a power of 1 on five problems, and of order over k where an embedded estimate falls as h**k with k below the order."""
    lower = method.estimate and not (method.stepper.rtol_scaling or method.stepper.foresees)
    expected = method.order / (method.estimate_order + 1) if lower else 1.0
    found = {problem: power(method, problem) for problem in PROBLEMS}
    assert found == pytest.approx(dict.fromkeys(PROBLEMS, expected), abs=0.15)


def test_both_tolerances_are_recorded(tmp_path: Path) -> None:
    """Assert what was asked for and what steps were judged by, and that the archive is reproduced from them."""
    model = PROBLEMS["henon_heiles"]
    run = xd.simulate(model, method="velocity_verlet", rtol=1e-4, until=5.0, path=tmp_path / "run.nc")
    assert run.attrs["solver_rtol"] == 1e-4
    assert run.attrs["solver_rtol_used"] == pytest.approx(1e-6, rel=4 * EPS)
    assert "with rtol**(3/2) in the place of rtol" in run.attrs["solver_error_norm"]
    scale = 1e-6 * (1 + np.maximum(abs(run.x.values[1:]), abs(run.x.values[:-1])))
    assert (abs(run.error_x.values[1:]) <= scale).all()
    assert xd.reproduce(tmp_path / "run.nc").attrs["identical"] == 1


def test_what_rounding_does_not_allow_is_refused() -> None:
    """Assert that a first order is not asked for steps of an error below that of the numbers, and told what it can."""
    said = "a step of 'forward_euler' would need 1e-18, less than rounding; take 4.7e-08 or more"
    with pytest.raises(xd.InputError, match=said):
        xd.simulate(PROBLEMS["pendulum"], method="forward_euler", rtol=1e-9, until=1.0)

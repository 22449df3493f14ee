"""Tubes against closed forms: every motion inside, and hardly wider than they are spread."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest

from cases.smooth_models import lorenz, of_rate, oscillator
from xdynamics.tubes import Flow, boxes, interval_problem_of
from xdynamics.tubes.boxes import Polynomials
from xdynamics.tubes.interval_problem import time_box
from xdynamics.tubes.series import MotionSeries


def tube(model: object, until: float, order: int = 20) -> tuple[np.ndarray, Flow]:
    """Return the last box of a proof, which goes to the end."""
    flow = Flow(interval_problem_of(model), order, 1e-16)
    for _ in flow.until([time_box(until)]):
        pass
    assert flow.reason == ""
    return flow.box, flow


def test_oscillator_without_uncertainty() -> None:
    """Assert that ten radians of an oscillator are proven to 1e-13, and hold its closed form to 40 digits."""
    box, _ = tube(oscillator(), 5.0)
    with mp.workdps(40):
        exact = [mp.cos(10), -2 * mp.sin(10)]
        assert all(low <= number <= high for low, high, number in zip(*box[:, :2], exact, strict=True))
    assert (box[1] - box[0])[:2].max() < 1e-12


def test_linear_tube_is_exact() -> None:
    """Assert that of a linear system the tube of uncertain starts is as wide as the set of motions, to a thousandth."""
    box, _ = tube(oscillator(x={"value": "1 m", "half_width": "0.125 m"}), 4.0)
    exact = 0.25 * abs(np.cos(8.0)), 0.5 * abs(np.sin(8.0))
    widths = (box[1] - box[0])[:2]
    assert (widths >= exact).all()
    assert (widths < 1.001 * np.array(exact)).all()


def test_uncertain_stiffness() -> None:
    """Assert that all motions of any stiffness and start within bounds are inside, and the tube at most 1.5 as wide."""
    model = oscillator({"value": "4 N m-1", "half_width": "0.04 N m-1"}, {"value": "1 m", "half_width": "0.01 m"})
    box, _ = tube(model, 3.0)
    random = np.random.default_rng(32)
    k, x = random.uniform(3.96, 4.04, 400), random.uniform(0.99, 1.01, 400)
    k[:4], x[:4] = [3.96, 3.96, 4.04, 4.04], [0.99, 1.01, 0.99, 1.01]
    members = np.stack([x * np.cos(np.sqrt(k) * 3.0), -x * np.sqrt(k) * np.sin(np.sqrt(k) * 3.0)])
    assert (box[0, :2, None] < members).all()
    assert (members < box[1, :2, None]).all()
    assert ((box[1] - box[0])[:2] < 1.5 * np.ptp(members, axis=1)).all()


def test_steps_shrink_before_what_grows_without_bound() -> None:
    """Assert that of x' = (1 + x)**2, which is infinite at t = 1, no step is proven beyond it, and each holds t/(1 - t)."""
    flow, last = Flow(interval_problem_of(of_rate("(1 + x)**2")), 8, 1e-9), 0.0
    for proof, _ in zip(flow.until([time_box(2.0)]), range(12), strict=False):
        last = float(proof.end[1])
        assert proof.end_box[0, 0] <= last / (1.0 - last) * (1.0 + 4e-16)
        assert proof.end_box[1, 0] >= last / (1.0 - last) * (1.0 - 4e-16)
    assert 0.3 < last < 1.0


def test_nothing_is_proven_across_a_corner() -> None:
    """Assert that a proof ends before x = 0, where abs(x) has a corner, and says why."""
    flow = Flow(interval_problem_of(of_rate("1 + abs(x - 1)")), 8, 1e-9)
    for proof in flow.until([time_box(2.0)]):
        assert proof.enclosure[1, 0] < 1.0
    assert 0.5 < flow.time[1] < float(mp.log(2))
    assert "corner" in flow.reason or "not decided" in flow.reason


def test_lorenz() -> None:
    """Assert that Lorenz's motion from (1, 1, 1) is proven to eleven digits at t = 0.25, around what mpmath.odefun has."""
    box, _ = tube(lorenz(), 0.25)
    by_mpmath = mp.mpf("11.04284424002537664762"), mp.mpf("21.77541718373730767021"), mp.mpf("11.01677338802233576921")
    assert all(low <= number <= high for low, high, number in zip(*box, by_mpmath, strict=True))
    assert (box[1] - box[0]).max() < 1e-10


@pytest.mark.parametrize(("k", "x"), [("4 N m-1", "0 m"), ("0 N m-1", "1 m"), ("4e-30 N m-1", "1e30 m")])
def test_what_rests(k: str, x: str) -> None:
    """Assert that a motion that rests, or hardly moves, takes few steps, and stays where it is to rounding."""
    box, flow = tube(oscillator(k=k, x=x), 1.0)
    start = float(flow.problem.start[0, 0])
    assert box[0, 0] <= start * (1.0 - 2e-30) <= box[1, 0]  # a fifth of what the last of them has moved
    assert boxes.width(box)[0] <= 1e-14 * start + 1e-200


def test_forces_that_change_with_time() -> None:
    """Assert that x' = cos(20 t) stays within bounds at the end of every step, though steps are long beside a period."""
    flow = Flow(interval_problem_of(of_rate("cos(20*t/second)")), 6, 1e-4)
    with mp.workdps(30):
        for proof in flow.until([time_box(0.3)]):
            exact = mp.sin(20 * mp.mpf(float(proof.end[1]))) / 20
            assert proof.end_box[0, 0] <= exact <= proof.end_box[1, 0]
    assert flow.reason == ""


def test_no_motion_leaves_the_box_of_its_step() -> None:
    """Assert of steps that nothing but their proof keeps short what it rests on: what is reached lies within."""
    problem = interval_problem_of(lorenz(x={"value": "1", "half_width": 0.001}))
    order, box = 6, problem.start
    series = MotionSeries(problem.motions, 3, order + 1)
    for proof, _ in zip(Flow(problem, order, 0.5).until([time_box(1.0)]), range(12), strict=False):
        span, time = np.array([0.0, proof.end[1] - proof.begin[0]]), np.array([proof.begin[0], proof.end[1]])
        start, box = boxes.hull(box, boxes.point_box(proof.set.point)), proof.end_box
        around = series.coefficients_of(proof.begin, start, proof.step_values)[:, :-1, :, 0]
        last = series.coefficients_of(time, proof.enclosure, proof.step_values)[:, -1, :, 0]
        powers = boxes.interval_power(span, order + 1)[:, None]
        reached = boxes.add(Polynomials(order, 3).values_at(span, around), boxes.multiply(last, powers))
        slack = 1e-9 * boxes.magnitude(proof.enclosure)
        assert (reached[0] >= proof.enclosure[0] - slack).all()
        assert (reached[1] <= proof.enclosure[1] + slack).all()


@pytest.mark.parametrize(
    ("rate", "half_width"),
    [
        *(("asin(0.8*sin(x)) - 2*x", half_width) for half_width in (0.01, 0.1, 0.5, 1.0, 1.5)),
        *(("atan(0.5*x) - 2*x", half_width) for half_width in (0.01, 1.0)),
        *(("asin(0.5*x) - 2*x", half_width) for half_width in (0.01, 0.5)),
    ],
)
def test_a_set_around_what_rests(rate: str, half_width: float) -> None:
    """Assert that motions around a point that rests, whose polynomials are rounding alone, are proven like any others."""
    from scipy.integrate import solve_ivp

    model = of_rate(rate).replace(initial={"x": {"value": "0", "half_width": half_width}})
    flow = Flow(interval_problem_of(model), 20, 1e-16)
    for _ in flow.until([time_box(1.0)]):
        pass
    assert flow.reason == ""
    turned = {"asin": np.arcsin, "atan": np.arctan, "sin": np.sin}

    def slope(_: float, x: np.ndarray) -> np.ndarray:
        return eval(rate, {}, {**turned, "x": x})

    last = solve_ivp(slope, (0, 1), [half_width], method="DOP853", rtol=1e-12, atol=1e-14).y[0, -1]
    if half_width < 0.1:  # the theorem of the mean is coarse over wide sets
        assert flow.box[1, 0] < 1.1 * last
        assert flow.box[0, 0] > -1.1 * last
    assert flow.box[0, 0] <= -last * (1 - 1e-10)
    assert flow.box[1, 0] >= last * (1 - 1e-10)

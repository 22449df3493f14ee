"""Tubes against closed forms: every motion inside, and hardly wider than they are spread.

Motions at random from within an uncertain set, marched in floats, beside the tube that is proven of all of them.

Of ten models with 1,000 members each none is outside; tubes are 1.01 (Roessler) to 2.0 (a damped pendulum) times as wide as
their members are spread.
Tubes beside rigorous intervals that others have published.
"""

from __future__ import annotations

from typing import Any

import mpmath as mp
import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.smooth_models import lorenz, of_rate, oscillator
from cases.uncertain_motions import MOTIONS
from xdynamics import Model
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


MEMBERS = 1000  # of each model; the first are at the corners of the set
ROUNDING = 1e-11  # of the size of a quantity: the error of a march with rtol 1e-13


@pytest.mark.dear
@pytest.mark.cases(len(MOTIONS))
def test_members_are_inside(case: int) -> None:
    """Assert that every member ends between the bounds, and that these are hardly wider than the members are spread."""
    model, until, most = [*MOTIONS.values()][case]
    tube = xd.enclose(model, at=[until], order=14, rtol=1e-12)
    assert tube.attrs["outcome"] == "completed"
    spreads = {
        name: part
        for name, part in (model.elements.statement.parameters | model.elements.starts).items()
        if part.spread is not None
    }
    random = np.random.default_rng([32, case])
    signs = random.uniform(-1.0, 1.0, (len(spreads), MEMBERS))
    corners = np.array(np.meshgrid(*[[-1.0, 1.0]] * len(spreads))).reshape(len(spreads), -1)
    signs[:, : corners.shape[1]] = corners
    drawn = {
        name: part.quantity.si + sign * part.spread.size.si
        for (name, part), sign in zip(spreads.items(), signs, strict=True)
    }
    members = xd.sweep(model, {"member": drawn}, keep=["end"], method="dop853", rtol=1e-13, until=until).load()
    for name in [str(key).removeprefix("end_") for key in members if f"lower_{str(key).removeprefix('end_')}" in tube]:
        values, low, high = (
            members[f"end_{name}"].values,
            float(tube[f"lower_{name}"][0]),
            float(tube[f"upper_{name}"][0]),
        )
        slack = ROUNDING * np.abs(values).max()
        assert ((low - slack <= values) & (values <= high + slack)).all(), name
        assert high - low < most * np.ptp(values), (name, (high - low) / np.ptp(values))


SIDES = {  # of the orbit, on the section: where they return to it
    "0.9208034913207385": {
        "x": (0.95228712767825907, 0.95228712767837564),
        "v_x": (-5.4453340632418458e-13, -3.6066379435840335e-15),
    },
    "0.9208034913207485": {
        "x": (0.9522871276784185, 0.95228712767853274),
        "v_x": (3.7447292693664613e-14, 5.685078317048184e-13),
    },
}
MU, JACOBI = "0.0009537", "3.03"  # of Jupiter and of the comet Oterma


def three_bodies(x: Any, v_y: Any) -> Model:
    """Return the planar restricted problem of three bodies in the rotating frame, from y = 0."""
    sun, jupiter = "(1 - mu)/((x + mu)**2 + y*y)**1.5", "mu/((x - 1 + mu)**2 + y*y)**1.5"
    return Model(
        name="restricted three bodies",
        coordinates={"x": {"unit": "1"}, "y": {"unit": "1"}},
        parameters={"mu": MU},
        mass={"x": "1*second**2", "y": "1*second**2"},
        definitions={"sun": sun, "jupiter": jupiter},
        forces={
            "rotating": {
                "x": "x - (x + mu)*sun - (x - 1 + mu)*jupiter + 2*v_y*second",
                "y": "y*(1 - sun - jupiter) - 2*v_x*second",
            }
        },
        events={"section": {"function": "y", "action": "record"}},
        initial={"x": x, "y": "0", "v_x": "0 s-1", "v_y": v_y},
    )


def speed(x: str) -> mp.mpf:
    """Return v_y at a point of the section by Jacobi's constant, to 40 digits."""
    with mp.workdps(40):
        place, mu = mp.mpf(x), mp.mpf(MU)
        potential = (1 - mu) / abs(place + mu) + mu / abs(place - 1 + mu)
        return mp.sqrt(place**2 + 2 * potential + mu * (1 - mu) - mp.mpf(JACOBI))


def returned(x: Any, v_y: Any) -> xr.Dataset:
    """Return the tube of a motion that comes back to the section once."""
    tube = xd.enclose(three_bodies(x, v_y), until="1.6 s")
    assert tube.sizes["event"] == 1
    return tube.isel(event=0)


def bounds(tube: xr.Dataset, name: str) -> tuple[float, float]:
    """Return what lies between."""
    return float(tube[f"lower_event_{name}"]), float(tube[f"upper_event_{name}"])


@pytest.mark.dear
def test_lyapunov_orbit_at_the_first_libration_point() -> None:
    """Assert that Oterma's orbit returns where the CAPD library proves it to, from both sides of it, and that both meet in time.

    Intervals that its example of this orbit prints, the orbit being that of
    Wilczak, Zgliczynski 2003, Comm. Math. Phys. 234, 37.
    """
    for x, published in SIDES.items():
        tube = returned(x, f"{mp.nstr(speed(x), 25)} s-1")
        for name, (low, high) in published.items():
            least, most = bounds(tube, name)
            assert least <= high, (x, name)
            assert low <= most, (x, name)
            assert most - least < 1e-11
    ends = [speed(x) for x in SIDES]
    v_y = {"value": f"{mp.nstr(sum(ends) / 2, 25)} s-1", "half_width": 1.001 * float(abs(ends[0] - ends[1])) / 2.0}
    least, most = bounds(returned({"value": "0.9208034913207435", "half_width": 5.001e-15}, v_y), "time")
    assert least <= 1.5410595631933541 <= 1.5410595631986368 <= most
    assert most - least < 2e-11


def test_periodic_orbit_of_lorenz() -> None:
    """Assert that the shortest orbit closes within what Isabelle/HOL has proven, and where double precision has it.

    Immler, examples of Ordinary_Differential_Equations, Archive of Formal Proofs: ``lorenz_c0``; start and period of Barrio, Dena,
    Tucker 2015, Comput. Phys. Commun. 194, 76.
    """
    start = {"x": "-2.147367631", "y": "2.078048211", "z": "27"}
    tube = xd.enclose(lorenz(**start), at="1.558652210 s")
    proven = {"x": (-2.1515, -2.1434), "y": (2.0738, 2.0824), "z": (26.992, 27.009)}
    for name, (low, high) in proven.items():
        least, most = (float(tube[f"{side}_{name}"][0]) for side in ("lower", "upper"))
        assert low <= least <= most <= high, name
        assert most - least < 1e-10
        assert abs(least - float(start[name])) < 1e-6


@pytest.mark.dear
def test_periodic_orbit_of_roessler() -> None:
    """Assert that Roessler's motion returns to x = 0 where it began, at the periodic point that the CAPD library publishes.

    Its examples integrate.cpp and 02-hyperbolic-periodic-orbit prove an orbit within 1e-10 of these digits.
    """
    model = Model(
        name="Roessler",
        states={
            "x": {"unit": "1", "rate": "-(y + z)/second"},
            "y": {"unit": "1", "rate": "(x + 0.2*y)/second"},
            "z": {"unit": "1", "rate": "(0.2 + z*(x - 5.7))/second"},
        },
        initial={"x": "0", "y": "-8.3809417428298", "z": "0.029590060630665"},
        events={"section": {"function": "x", "direction": "rising", "action": "record"}},
    )
    tube = xd.enclose(model, until="5.9 s")
    assert tube.sizes["event"] == 1
    for name, published in (("y", -8.3809417428298), ("z", 0.029590060630665)):
        low, high = float(tube[f"lower_event_{name}"][0]), float(tube[f"upper_event_{name}"][0])
        assert low - 1e-13 <= published <= high + 1e-13, name
        assert high - low < 1e-11
    assert float(tube.upper_event_time[0] - tube.lower_event_time[0]) < 1e-12

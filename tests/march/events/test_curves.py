"""Events on the polynomial that a step leaves: bounds of it, and events of stiff motions that rates by forces mislead."""

from __future__ import annotations

from math import comb

import numpy as np
import pytest
from numpy.polynomial import Polynomial

import xdynamics as xd
from cases.problems import ROOT, particle
from xdynamics.elementary import FUNCTIONS
from xdynamics.elementary.intervals import Intervals

KIND = Intervals(FUNCTIONS)
OWN, BY_HERMITE = "earliest first", "earliest first by Hermite"


def on_curve(name: str, x: Polynomial, h: float, first: float, last: float, lack: float = 0.0) -> tuple[float, float]:
    """Bounds of a state, or of its slope, on a piece of a step whose polynomial lacks something at the piece's end."""
    slope, ends = x.deriv(), (first, last)
    values = [float(x(first)), float(x(last)) + lack]
    rates = [float(slope(s)) / h for s in ends]
    given = *x.coef.tolist(), *values, *rates, (last - first) * h, 0.0, int(last - first < 1.0), h, first, last
    low, high, _ = KIND.of(f"{name}_on_curve", *given)
    return float(low), float(high)


@pytest.mark.parametrize("degree", [1, 3, 8])
@pytest.mark.parametrize("seed", range(4))
def test_bounds_hold_the_polynomial(seed: int, degree: int) -> None:
    """Assert that values and slopes of any polynomial are inside, on the step and on pieces of it."""
    draw, h = np.random.default_rng([seed, degree]), 0.3
    x = Polynomial(draw.normal(size=degree + 1))
    for first, last in ((0.0, 1.0), (0.0, 0.25), (0.5, 0.75), (0.3, 0.300001)):
        s = np.linspace(first, last, 500)
        for name, values in (("state", x(s)), ("state_slope", x.deriv()(s) / h)):
            low, high = on_curve(name, x, h, first, last)
            assert low <= values.min() <= values.max() <= high, name


def test_bounds_are_tight() -> None:
    """Assert that bounds exceed the Bernstein coefficients by the highest term's distance from lower degrees, and no more."""
    x = Polynomial([1.0, 2.0, -3.0, 0.0, 0.0, 0.0, 1.6])  # of so high a degree that Hermite's polynomials say nothing
    terms = [x.coef[k] / comb(6, k) for k in range(7)]
    hull = [sum(comb(i, k) * terms[k] for k in range(i + 1)) for i in range(7)]
    off = 1.6 / 2.0**11  # Chebyshev's polynomial of degree n has 2**(1 - 2*n) of its highest coefficient on [0, 1]
    assert on_curve("state", x, 2.0, 0.0, 1.0) == pytest.approx((min(hull) - off, max(hull) + off), rel=1e-12)
    terms = [(k + 1) * x.coef[k + 1] / comb(5, k) / 2.0 for k in range(6)]
    hull = [sum(comb(i, k) * terms[k] for k in range(i + 1)) for i in range(6)]
    off = 6.0 * 1.6 / 2.0**9 / 2.0
    assert on_curve("state_slope", x, 2.0, 0.0, 1.0) == pytest.approx((min(hull) - off, max(hull) + off), rel=1e-12)


def test_of_a_low_degree_the_narrower_bounds_hold() -> None:
    """Assert a cubic's own bounds where rates say nothing of it, and Hermite's where states and rates are on a straight line."""
    # the cubic's Bernstein coefficients are 1, 5/3, 4/3, 1.6
    low, high, _ = KIND.of("state_on_curve", 1.0, 2.0, -3.0, 1.6, 1.0, 1.6, 1e6, 1e6, 2.0, 0.0, 0, 2.0, 0.0, 1.0)
    assert (low, high) == pytest.approx((0.95, 5.0 / 3.0 + 0.05), rel=1e-12)
    hermite = KIND.of("state", 1.0, 1e6, 1.6, 1e6, 2.0, 0.0, 0)
    assert hermite.low < -1e5 < 1e5 < hermite.high
    straight = KIND.of("state_on_curve", 0.0, 5.0, -12.0, 8.0, 0.0, 1.0, 0.5, 0.5, 2.0, 0.0, 0, 2.0, 0.0, 1.0)
    assert straight[:2] == pytest.approx((0.0, 1.0), abs=1e-14)


def test_bounds_hold_what_shortened_steps_lack() -> None:
    """Assert that a motion that leaves the polynomial as a power of s is inside: values on every piece, slopes as steep as four."""
    x, h = Polynomial([0.0, -0.2, 0.0, 0.0, 0.0, 0.0, 1e-9]), 0.5  # moved, it is as good as constant
    for power in (2, 3, 4):
        motion = x + Polynomial([0.0] * power + [0.2])
        for first, last in ((0.0, 0.5), (0.0, 1.0), (0.5, 1.0), (0.25, 0.5)):
            moved = x + float(motion(first) - x(first))
            s, lack = np.linspace(first, last, 300), float(motion(last) - moved(last))
            for name, values in (("state", motion(s)), ("state_slope", motion.deriv()(s) / h)):
                low, high = on_curve(name, moved, h, first, last, lack)
                assert low <= values.min() <= values.max() <= high, (power, first, name)


def relaxing(level: float) -> xd.Model:
    """A state that follows a cosine within a microsecond, with an event at a level."""
    return xd.Model(
        name="relaxing",
        states={"u": {"unit": "1", "rate": "-lam*(u - cos(t/(1*second)))"}},
        parameters={"lam": "1e6 s-1"},
        initial={"u": "0"},
        events={"met": {"function": f"u - {level}"}},
    )


@pytest.mark.parametrize("rtol", [1e-3, 1e-6])
def test_events_of_a_stiff_state(rtol: float) -> None:
    """Assert the roots of a cosine, found although steps could be longer than its period."""
    run = xd.simulate(relaxing(0.5), method="radau_iia", rtol=rtol, until=20.0)
    turns = np.concatenate(
        [[np.log(2.0) / 1e6], *([2 * np.pi * k + a for a in (np.pi / 3, 5 * np.pi / 3)] for k in range(3))]
    )
    assert run.event_time.values == pytest.approx([*turns.tolist(), 6 * np.pi + np.pi / 3], abs=5e-6)


def relaxation_oscillation(events: dict[str, dict[str, str]]) -> xd.Model:
    """Van der Pol's oscillator where it is stiff."""
    return particle(
        name="van der Pol's oscillator",
        parameters={"m": "1 kg", "k": "1 N m-1", "mu": "1000 N s m-1"},
        forces={"spring": {"x": "-k*x"}, "damper": {"x": "mu*(1 - (x/(1*metre))**2)*v_x"}},
        initial={"x": "2 m", "v_x": "0 m s-1"},
        events=events,
    )


def test_an_event_that_is_far_leaves_the_bits() -> None:
    """Assert that a stiff motion has the states that it has without the event, where substeps of a search disturb it."""
    given = {"method": "radau_iia", "rtol": 1e-3, "until": 2000.0}
    alone = xd.simulate(relaxation_oscillation({}), **given)
    watched = relaxation_oscillation({"far": {"function": "x - 3*metre"}})
    run, old = (xd.simulate(watched, event_root_method=rule, **given) for rule in (OWN, BY_HERMITE))
    assert run.x.values.tobytes() == alone.x.values.tobytes()
    assert run.attrs["run_force_evaluations"] == alone.attrs["run_force_evaluations"]
    assert old.attrs["run_force_evaluations"] > alone.attrs["run_force_evaluations"]


@pytest.mark.parametrize("name", ["ball_drag", "relay_oscillator"])
def test_smooth_motions_keep_their_bits(name: str) -> None:
    """Assert that where a motion is not stiff, narrower bounds change no state and no substep of what either rule finds."""
    model = xd.Model.from_toml(ROOT / "data" / "models" / f"{name}.toml")
    run, old = (
        xd.simulate(model, method="radau_iia", rtol=1e-6, until="5 s", event_root_method=rule)
        for rule in (OWN, BY_HERMITE)
    )
    assert run.sizes["event"] > 0
    for variable in ("time", "event_time", "event_substeps"):
        assert run[variable].values.tobytes() == old[variable].values.tobytes(), variable


def test_a_level_that_is_not_reached_costs_little() -> None:
    """Assert that a stiff state just below a level needs no more force evaluations for the search than for its steps."""
    evaluations = {}
    for rule in (OWN, BY_HERMITE):
        run = xd.simulate(relaxing(1.001), method="radau_iia", rtol=1e-3, until=20.0, event_root_method=rule)
        assert run.sizes["event"] == 0
        evaluations[rule] = int(run.attrs["run_force_evaluations"])
    assert evaluations[OWN] < 150 < 900 < evaluations[BY_HERMITE]

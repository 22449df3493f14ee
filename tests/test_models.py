"""The models of data/models: each against its reference; every archive against CF."""

from __future__ import annotations

import shutil
import subprocess
import sys
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.interpolate import PchipInterpolator

import xdynamics as xd
from problems import MODELS

NAMES = sorted(path.stem for path in MODELS.glob("*.toml"))


@lru_cache
def model(name: str) -> xd.Model:
    """Read a model."""
    return xd.Model.from_toml(MODELS / f"{name}.toml")


@lru_cache
def run(name: str) -> object:
    """March a model as its file says."""
    return xd.simulate(model(name))


def event(name: str, detector: str, step: float | None = None) -> tuple[float, float, float]:
    """Time of a detector's first event, with the first coordinate and velocity there."""
    found = run(name) if step is None else xd.simulate(model(name), step=step)
    words = found.event_detector.attrs["flag_meanings"].split()
    at = int(np.flatnonzero(found.event_detector.values == words.index(detector))[0])
    row = int(found.event_row_before[at])
    q = next(iter(model(name).coordinates))
    return float(found.event_time[at]), float(found[q][row]), float(found[f"v_{q}"][row])


def extrapolated(name: str, detector: str) -> np.ndarray:
    """Richardson's value from two steps of a second-order method."""
    coarse, fine = (np.array(event(name, detector, step)) for step in (5e-4, 2.5e-4))
    return fine + (fine - coarse) / 3


def test_ball_reaches_its_apex_and_comes_back() -> None:
    """Assert the closed form's apex and return to 1e-11, by extrapolation, and the method's own error at 1 ms."""
    apex, ground = extrapolated("ball_drag", "apex"), extrapolated("ball_drag", "ground")
    assert apex[:2] == pytest.approx([1.798787364332063, 16.87387140933885], rel=1e-11)
    assert ground[[0, 2]] == pytest.approx([3.711199198904777, -16.64100588675687], rel=1e-11)
    assert event("ball_drag", "apex")[0] == pytest.approx(1.798787364332063, abs=4e-8)


def test_bead_sinks_by_its_exponential() -> None:
    """Assert linear drag over ten decay times, in mm."""
    found = run("linear_drag")
    exact = 980.665 * -np.expm1(-found.time.values / 0.1)
    assert np.abs(found.v_y.values - exact).max() < 980.665 * (1e-3 / 0.1) ** 2 / 6
    assert found.v_y.attrs["units"] == "mm s-1"


def test_oscillator_keeps_time() -> None:
    """Assert position after twenty seconds within Verlet's phase lag w t (wh)**2/24."""
    found = run("harmonic_oscillator")
    lag = 40 * (2e-3) ** 2 / 24
    assert abs(float(found.x[-1]) - np.cos(40.0)) < 1.5 * lag
    assert abs(float(found.phase[-1]) - (40.0 - 12 * np.pi)) < 1.5 * lag


def test_pendulum_period() -> None:
    """Assert the period 4 sqrt(l/g) K(sin(theta0/2)), extrapolated."""
    assert extrapolated("pendulum", "turning_point")[0] == pytest.approx(2.00740357588013, rel=1e-11)


def test_coupled_masses_are_their_modes() -> None:
    """Assert that each mode moves at its own frequency, 2 and 3 per second."""
    found = run("coupled_masses")
    t = found.time.values
    for name, w in (("in_phase", 2.0), ("opposed", 3.0)):
        lag = w * 20 * (w * 1e-3) ** 2 / 24
        assert np.abs(found[name].values - np.cos(w * t) / 2).max() < lag


def double_pendulum_rates(_t: float, s: np.ndarray) -> list[float]:
    """The same pendulum by its textbook accelerations, solved by hand."""
    m1, m2, l1, l2, g = 1.0, 0.8, 1.0, 0.7, 9.80665
    a, b, u, w = s
    d = a - b
    e = 2 * m1 + m2 - m2 * np.cos(2 * d)
    du = (
        -g * (2 * m1 + m2) * np.sin(a)
        - m2 * g * np.sin(a - 2 * b)
        - 2 * np.sin(d) * m2 * (w * w * l2 + u * u * l1 * np.cos(d))
    ) / (l1 * e)
    dw = 2 * np.sin(d) * (u * u * l1 * (m1 + m2) + g * (m1 + m2) * np.cos(a) + w * w * l2 * m2 * np.cos(d)) / (l2 * e)
    return [u, w, du, dw]


def test_double_pendulum_agrees_with_another_form() -> None:
    """Assert the angles at 2 s against the textbook's solved accelerations, by extrapolation, and the energy."""
    start = np.deg2rad([120.0, -10.0, 0, 0])
    reference = solve_ivp(double_pendulum_rates, (0, 2), start, method="DOP853", rtol=1e-13, atol=1e-13).y[:2, -1]
    ends = [
        np.array([float(one.th1[-1]), float(one.th2[-1])])
        for one in (xd.simulate(model("double_pendulum"), step=2e-4), run("double_pendulum"))
    ]
    assert ends[1] + (ends[1] - ends[0]) / 3 == pytest.approx(reference, abs=2e-9)
    bands = [np.ptp(xd.simulate(model("double_pendulum"), step=step).total_energy.values) for step in (4e-4, 2e-4)]
    assert 3.8 < bands[0] / bands[1] < 4.2


@pytest.mark.parametrize(
    ("method", "error", "digits"),
    [
        ("euler_cromer", -1.29733374e-3, 5e-12),
        ("velocity_verlet", 3.211299e-6, 5e-13),
        ("forward_euler", 0.125015534, 5e-10),
    ],
)
def test_kepler_energy_error(method: str, error: float, digits: float) -> None:
    """Assert the energy error at t = 50 to the last digit given, and that angular momentum is kept by the symplectic two."""
    found = xd.simulate(model("kepler"), method=method, force_samples="none")
    assert float(found.total_energy[-1] - found.total_energy[0]) == pytest.approx(error, abs=digits)
    if xd.METHODS[method].symplectic:
        assert np.abs(found.angular_momentum.values - 0.8).max() < 1e-12


def test_cart_period_by_quadrature() -> None:
    """Assert the period of the measured spring, from the energy integral of its interpolant."""
    table = model("cart_spring").drives["restoring"].table
    work = PchipInterpolator(table.argument, table.value).antiderivative()
    amplitude, mass = 0.12, 0.5
    knots = np.arcsin(np.array([0.025, 0.05, 0.075, 0.1]) / amplitude)

    def slowness(angle: float) -> float:
        x = amplitude * np.sin(angle)
        return amplitude * np.cos(angle) / np.sqrt(2 * (work(x) - work(amplitude)) / mass)

    borders = [0.0, *knots, np.pi / 2]
    quarter = sum(quad(slowness, a, b, epsabs=1e-13, epsrel=1e-13, limit=200)[0] for a, b in pairwise(borders))
    assert extrapolated("cart_spring", "turning_point")[0] == pytest.approx(4 * quarter, rel=1e-9)


def rocket_oracle() -> dict[str, float]:
    """The same flight by scipy's DOP853, segment by segment of the thrust table."""
    table = model("rocket_c6").drives["thrust"].table
    time, thrust = table.argument, table.value
    g, k = 9.80665, 1.225 * 0.75 * 4.83e-4 / 2
    burn = 0.0108 / 8.817238

    def rates(t: float, s: np.ndarray) -> list[float]:
        y, v, fuel = s
        force, mass = np.interp(t, time, thrust, right=0.0), 0.045 + 0.0132 + fuel
        support = 0.0 if y > 0 else max(mass * g - force, 0.0)
        return [v, (force + support - mass * g - k * v * abs(v)) / mass, -burn * force]

    def apogee(_t: float, s: np.ndarray) -> float:
        return s[1]

    def landing(_t: float, s: np.ndarray) -> float:
        return s[0]

    apogee.direction = landing.direction = -1
    landing.terminal = True
    marks = [*time[:-1], 1.86, 60.0]
    lift = (0.0690 * g) / (0.946 / 0.031)  # near enough: the segment is cut there, the physics is in `rates`
    marks = sorted({*marks, lift})
    state, found = np.array([0.0, 0.0, 0.0108]), {}
    for begin, end in pairwise(marks):
        leg = solve_ivp(
            rates,
            (begin, end),
            state,
            method="DOP853",
            rtol=1e-12,
            atol=1e-14,
            events=(apogee, landing) if begin >= 1.86 else None,
        )
        state = leg.y[:, -1]
        if end == 1.86:
            found["burnout_height"], found["burnout_speed"] = state[0], state[1]
        if end == 60.0:
            found |= {"apogee": leg.t_events[0][0], "apogee_height": leg.y_events[0][0][0]}
            found |= {"landing": leg.t_events[1][0], "landing_speed": leg.y_events[1][0][1]}
    return found


def test_rocket_flight() -> None:
    """Assert burnout, apogee and landing against another integrator, by extrapolation."""
    oracle = rocket_oracle()
    burnout, apogee, landing = (extrapolated("rocket_c6", one) for one in ("burnout", "apogee", "landing"))
    assert burnout[0] == pytest.approx(1.86, abs=1e-12)
    assert burnout[1:] == pytest.approx([oracle["burnout_height"], oracle["burnout_speed"]], rel=1e-6)
    assert apogee[:2] == pytest.approx([oracle["apogee"], oracle["apogee_height"]], rel=1e-6)
    assert landing[[0, 2]] == pytest.approx([oracle["landing"], oracle["landing_speed"]], rel=1e-6)


def test_rocket_rests_on_its_pad_until_liftoff() -> None:
    """Assert exact rest until thrust passes weight, and that it never sinks before it lands."""
    found = run("rocket_c6")
    lift = float(found.event_time[0])
    before = found.isel(step=np.flatnonzero(found.time.values <= lift))
    assert before.sizes["step"] > 20
    assert (before.y == 0).all()
    assert (before.v_y == 0).all()
    assert (found.y.values[:-2] >= 0).all()


def test_rocket_burns_what_it_has() -> None:
    """Assert that the fuel left at burnout is zero to rounding, and what burnt before goes with the impulse."""
    found = run("rocket_c6")
    assert abs(float(found.fuel[-1])) < 1e-12  # g
    assert float(found.fuel.min()) > -1e-12


@pytest.mark.parametrize("name", NAMES)
def test_archive_reproduces_and_passes_cf(name: str, tmp_path: Path) -> None:
    """Assert of every model: saved, verified, reproduced bit for bit, clean under the strict CF check, read by ncdump."""
    path = tmp_path / f"{name}.nc"
    short = xd.simulate(model(name), until=min(2.0, 60.0))
    xd.save(short, path)
    assert xd.reproduce(path).attrs["identical"] == 1
    checker = Path(sys.executable).with_name("compliance-checker")
    if checker.exists():
        report = subprocess.run(
            [checker, "-t", "cf:1.11", "-c", "strict", path], capture_output=True, text=True, check=False
        )
        assert "All tests passed!" in report.stdout, report.stdout
    if shutil.which("ncdump"):
        assert subprocess.run(["ncdump", "-h", path], capture_output=True, check=True).stdout

"""The models of data/models that have dimensions: each against a closed form, an invariant, or another's arithmetic."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from numpy.polynomial import laguerre
from scipy.integrate import solve_ivp

import xdynamics as xd
from cases.problems import MODELS


@lru_cache
def model(name: str) -> xd.Model:
    """Read a model."""
    return xd.Model.from_toml(MODELS / f"{name}.toml")


def test_planets_go_where_another_integrator_has_them() -> None:
    """Assert positions after 50 years to 1e-9 astronomical units of scipy's, and momenta to rounding over 550 years."""
    run = xd.simulate(model("outer_solar_system"), method="dop853", rtol=1e-13, step=None, until="18262.5 day")
    day = 86400.0
    mu = run.mu.values

    def pull(_t: float, y: np.ndarray) -> np.ndarray:
        r = y[:18].reshape(6, 3)
        d = r[None] - r[:, None]
        far = np.sqrt((d**2).sum(-1)) + np.eye(6)
        return np.concatenate([y[18:], (mu[None, :, None] * d / far[..., None] ** 3).sum(1).ravel()])

    start = np.concatenate([run.r.values[0].ravel(), run.v_r.values[0].ravel() * day])
    there = solve_ivp(pull, (0, 18262.5), start, method="DOP853", rtol=1e-13, atol=1e-15).y[:18, -1].reshape(6, 3)
    assert run.r.attrs["units"] == "astronomical_unit"
    assert np.abs(run.r.values[-1] - there).max() < 1e-9
    long = xd.simulate(model("outer_solar_system"))
    still = long.momentum.values
    assert np.abs(still - still[0]).max() < 1e-13 * np.abs(still[0]).max()


# inclination to the ecliptic, degree: Standish and Williams, Keplerian Elements for Approximate Positions of the Major
# Planets (Explanatory Supplement to the Astronomical Almanac, 3rd ed., 2013, table 8.10.2); sidereal period, day: NASA's
# planetary fact sheet
PUBLISHED = {
    "Jupiter": (1.30439695, 4332.589),
    "Saturn": (2.48599187, 10759.22),
    "Uranus": (0.77263783, 30685.4),
    "Neptune": (1.77004347, 60189.0),
    "Pluto": (17.14001206, 90560.0),
}
OBLIQUITY = np.deg2rad(23.43929111)  # of the ecliptic, to the equator of J2000, IAU 1976


def test_planets_have_their_published_inclinations_and_periods() -> None:
    """Assert each orbit's plane at the start, and its mean period from one ascending node to the next over 550 years."""
    run = xd.simulate(model("outer_solar_system"))
    cosine, sine = np.cos(OBLIQUITY), np.sin(OBLIQUITY)
    turned = np.array([[1, 0, 0], [0, cosine, sine], [0, -sine, cosine]])
    day = run.time.values / 86400.0
    for body, (inclination, period) in PUBLISHED.items():
        place, speed = ((part.sel(body=body) - part.sel(body="Sun")).values @ turned.T for part in (run.r, run.v_r))
        axis = np.cross(place[0], speed[0])
        assert np.rad2deg(np.arccos(axis[2] / np.linalg.norm(axis))) == pytest.approx(inclination, abs=0.015)
        height = place[:, 2]
        rises = np.flatnonzero((height[:-1] < 0) & (height[1:] >= 0))
        nodes = day[rises] - height[rises] * np.diff(day)[rises] / np.diff(height)[rises]
        assert (nodes[-1] - nodes[0]) / (len(nodes) - 1) == pytest.approx(period, rel=6e-4)


def test_three_bodies_chase_each_other() -> None:
    """Assert that after a period each is where it was, after a third where the next was, and the published energy."""
    run = xd.simulate(model("figure_eight"))
    third = xd.sample(run, times=[6.32591398 / 3, 6.32591398])
    start = run.r.values[0]
    assert np.abs(third.r.values[1] - start).max() < 1e-6
    assert min(np.abs(third.r.values[0] - np.roll(start, k, axis=0)).max() for k in (1, 2)) < 1e-6
    assert float(run.total_energy[0]) == pytest.approx(-1.287144, abs=5e-6)
    assert np.abs(run.angular_momentum.values).max() < 1e-10


@pytest.mark.dear
def test_energy_comes_back_to_the_longest_mode() -> None:
    """Assert recurrence: most energy leaves the mode, and over 95 % is back near 157 of its periods."""
    run = xd.simulate(model("fermi_pasta_ulam"))
    energy = run.mode_energy.isel(harmonic=0).values / float(run.mode_energy[0, 0])
    back = run.time.values > 8000
    assert energy.min() < 0.1
    assert energy[back].max() > 0.95
    period = 2 * np.pi / (2 * np.sin(np.pi / 66))
    assert run.time.values[back][energy[back].argmax()] / period == pytest.approx(157, abs=6)


def test_the_lax_matrix_keeps_its_spectrum() -> None:
    """Assert the eigenvalues of Flaschka's matrix along the run."""
    run = xd.simulate(model("toda_chain"))

    def spectrum(row: int) -> np.ndarray:
        q, v = run.q.values[row], run.v_q.values[row]
        lax, beside = np.diag(v / 2), np.exp(-(np.roll(q, -1) - q) / 2) / 2
        for i in range(16):
            lax[i, (i + 1) % 16] += beside[i]
            lax[(i + 1) % 16, i] += beside[i]
        return np.linalg.eigvalsh(lax)

    assert np.abs(spectrum(-1) - spectrum(0)).max() < 2e-8


@pytest.mark.dear
def test_each_mode_of_the_rod_decays_by_its_exponential() -> None:
    """Assert the closed form of the model itself, cell by cell."""
    ledger = xd.validate(model=model("heat"), methods=["radau_iia"])
    assert {*ledger.verdict.values.tolist()} == {0}
    assert ledger.sizes["case"] >= 50
    assert "T[0]" in str(ledger.case_name.values[0])


def test_the_front_travels_at_its_speed() -> None:
    """Assert sqrt(2 D r)(1/2 - a) to the error of the cells."""
    run = xd.simulate(model("nagumo_front"))
    early, late = np.interp([20.0, 70.0], run.time.values, run.place.values)
    speed = (late - early) / 50.0
    assert speed == pytest.approx(np.sqrt(2e-6) * 0.25, rel=0.02)


def test_links_swing_with_the_zeros_of_laguerre() -> None:
    """Assert the frequencies of the hanging pendulum."""
    hanging = model("links_pendulum").replace(initial={"theta": "0 rad"})
    found = np.sort(np.abs(xd.modes(hanging).frequency.values))
    zeros = np.sqrt(np.sort(laguerre.lagroots([0, 0, 0, 0, 0, 1])) * 9.81 / 0.2)
    np.testing.assert_allclose(found, zeros, rtol=1e-10)


def test_discs_keep_their_energy() -> None:
    """Assert kinetic energy through sixty collisions, and that no gap was passed by more than the tolerance."""
    run = xd.simulate(model("balls_in_box"))
    assert run.sizes["event"] > 40
    assert np.ptp(run.kinetic_energy.values) < 1e-12 * float(run.kinetic_energy[0])
    assert float(run.contact_gap_discs.min()) > -1e-9


def test_bars_come_to_carry_the_weight() -> None:
    """Assert that in the end every joint hangs still, with forces in balance."""
    run = xd.simulate(model("truss"), until="60 s")
    assert np.abs(run.v_r.values[-1]).max() < 1e-6
    assert np.abs(run.a_r.values[-1]).max() < 1e-4
    assert run.tension.sizes["bar"] == 6

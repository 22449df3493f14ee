"""Rates that read accelerations: the integral of a mean square, against scipy, by methods of each kind."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import xdynamics as xd


def oscillator(**changes: Any) -> xd.Model:
    """Return a damped oscillator of 2 kg with the integral of its squared acceleration."""
    sections: dict[str, Any] = {
        "name": "Oscillator with a mean square",
        "coordinates": {"x": "m"},
        "parameters": {"m": "2 kg", "k": "8 N/m", "c": "0.2 N s/m"},
        "mass": {"x": "m"},
        "forces": {"spring": {"potential": "k*x**2/2"}, "damper": {"x": "-c*v_x"}},
        "states": {"J": {"unit": "m2 s-3", "rate": "a_x**2"}},
        "initial": {"x": "1 m", "J": "0 m2 s-3"},
    }
    return xd.Model(**(sections | changes))


def integral(damping: float, until: float = 5.0) -> float:
    """Return the integral of the squared acceleration by scipy."""

    def rates(_t: float, y: Any) -> list[float]:
        acceleration = -4.0 * y[0] - damping / 2.0 * y[1]
        return [y[1], acceleration, acceleration**2]

    return float(solve_ivp(rates, (0, until), [1, 0, 0], method="DOP853", rtol=1e-12, atol=1e-14).y[2, -1])


@pytest.mark.parametrize("method", ["dop853", "taylor", "radau_iia", "dormand_prince"])
def test_the_integral_of_a_squared_acceleration(method: str) -> None:
    """Assert scipy's number, and that the rate is the square of the recorded acceleration at each row."""
    run = xd.simulate(oscillator(), method=method, rtol=1e-10, until="5 s")
    assert float(run.J[-1]) == pytest.approx(integral(0.2), rel=1e-8)
    assert run.rate_J.values == pytest.approx(run.a_x.values**2, rel=1e-14)


def test_changed_forces_change_it(tmp_path: Path) -> None:
    """Assert that a replaced force is in it, that the text keeps what was written, and the same bits from the file."""
    model = oscillator().replace(forces={"damper": {"x": "-2*c*v_x"}})
    run = xd.simulate(model, method="dop853", rtol=1e-10, until="5 s")
    assert float(run.J[-1]) == pytest.approx(integral(0.4), rel=1e-8)
    assert 'rate = "a_x**2"' in model.to_toml()
    assert xd.Model.from_text(model.to_toml()).digest == model.digest
    xd.save(run, tmp_path / "run.nc")
    assert xd.reproduce(tmp_path / "run.nc").attrs["identical"] == 1


def test_in_members_in_terms_and_in_regimes() -> None:
    """Assert a sweep over the damping, a term beside another, and a force that acts in one regime alone."""
    sweep = xd.sweep(oscillator(), {"c": [0.2, 0.4]}, method="dop853", rtol=1e-10, until="5 s", keep=["end_J"])
    assert sweep.end_J.values == pytest.approx([integral(0.2), integral(0.4)], rel=1e-7)
    states = {"J": {"unit": "m2 s-3", "terms": {"square": "a_x**2", "loss": "-J/(1e9*second)"}}}
    run = xd.simulate(oscillator(states=states), method="dop853", rtol=1e-10, until="5 s")
    assert run.term_square_J.values == pytest.approx(run.a_x.values**2, rel=1e-14)
    regimes = {"damped": {"forces": ["spring", "damper"]}, "free": {"forces": ["spring"]}}
    events = {"late": {"function": "t - 2*second", "action": "switch", "to": "free"}}
    run = xd.simulate(oscillator(regimes=regimes, events=events), method="dop853", rtol=1e-10, until="5 s")
    assert run.rate_J.values == pytest.approx(run.a_x.values**2, rel=1e-14)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"contacts": {"wall": {"gap": "x + 2*metre", "restitution": "0.5"}}},
            "which forces of contacts change; write",
        ),
        ({"frictions": {"rail": {"slip": "v_x", "kinetic": "1*newton"}}}, "which forces of frictions change"),
        ({"states": {"J": {"unit": "m2 s-3", "rate": "a_y**2"}}}, "name 'a_y' .* is not declared"),
        ({"states": {"J": {"unit": "m2 s-3", "rate": "a_x"}}}, "rate of state 'J' has units 'm s-2', needs 'm2 s-4'"),
    ],
)
def test_what_is_not_known_is_refused(changes: dict[str, Any], said: str) -> None:
    """Assert one line where other forces change an acceleration, and where the unit is another."""
    with pytest.raises(xd.ModelError, match=said):
        oscillator(**changes)


def test_the_root_mean_square_of_a_seat() -> None:
    """Assert sqrt(J/T) against the rows of a fine run."""
    run = xd.simulate(oscillator(), method="rk4", step="1 ms", until="5 s")
    rms = np.sqrt(float((run.a_x**2).integrate("time")) / 5.0)
    assert np.sqrt(float(run.J[-1]) / 5.0) == pytest.approx(rms, rel=1e-6)


def test_where_a_motion_would_slide_it_ends_in_words() -> None:
    """Assert that a block that comes to hold does not go on with a mean of squares, whose own acceleration is 0."""
    model = oscillator(
        forces={"rub": {"x": "-4*newton*sign(v_x)"}}, initial={"x": "0 m", "v_x": "1 m/s", "J": "0 m2 s-3"}
    )
    with pytest.warns(UserWarning, match="did not reach"):
        run = xd.simulate(model, method="dop853", rtol=1e-9, until="2 s")
    assert run.attrs["run_outcome"] == "sliding_mode"
    assert float(run.time[-1]) == pytest.approx(0.5, rel=1e-9)
    assert float(run.J[-1]) == pytest.approx(2.0, rel=1e-9)

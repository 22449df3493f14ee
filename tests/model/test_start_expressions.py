"""Values at the start that follow parameters: swept, fitted and budgeted with them, slopes included."""

from __future__ import annotations

from math import cos, pi, sin
from pathlib import Path

import numpy as np
import pytest

import xdynamics as xd

SPRING = """
name = "spring"
[coordinates]
x = "m"
[parameters]
v0 = "2.0 ± 0.1 m s-1"
L = "0.5 ± 0.01 m"
phi0 = "30 ± 1 degree"
[mass]
x = "1*kilogram"
[forces.spring]
x = "-4*newton/metre*x"
[states.charge]
unit = "C"
rate = "-charge/second"
[initial]
t = "0 s"
x = "L*sin(phi0)"
v_x = "v0"
charge = "3*coulomb*L/metre"
"""
SETTINGS = {"method": "dop853", "rtol": 1e-12, "until": "1.1 s"}


def spring(**parameters: str) -> xd.Model:
    """A mass on a spring, of 2 rad s-1, with a start that follows parameters."""
    return xd.Model.from_text(SPRING).replace(parameters=parameters)


def test_the_start_follows() -> None:
    """Assert values at the start of the model, of one with another parameter, and of one read again."""
    run = xd.simulate(spring(), method="rk4", step="10 ms", until="0.1 s")
    assert [float(run[name][0]) for name in ("x", "v_x", "charge")] == pytest.approx([0.25, 2.0, 1.5], rel=1e-15)
    other = spring(L="1 m", v0="36 km h-1")
    run = xd.simulate(other, method="rk4", step="10 ms", until="0.1 s")
    assert [float(run[name][0]) for name in ("x", "v_x", "charge")] == pytest.approx([0.5, 10.0, 3.0], rel=1e-15)
    assert xd.Model.from_text(other.to_toml()) == other


@pytest.mark.parametrize(
    ("name", "slope"),
    [
        ("v0", sin(2.0) / 2.0),
        ("L", cos(2.0) * sin(pi / 6.0)),
        ("phi0", cos(2.0) * 0.5 * cos(pi / 6.0)),
    ],
)
def test_slopes_follow_too(name: str, slope: float) -> None:
    """Assert slopes of a budget at 1 s by the closed form, from variational equations."""
    budget = xd.error_budget(spring(), quantity="x", at="1 s", **SETTINGS)
    term = budget.isel(term=list(budget.term_name.values).index(name))
    assert str(term.term_rule.values).startswith("slope by variational equations")
    assert float(term.sensitivity) == pytest.approx(slope, rel=1e-10)  # of SI units


def test_members_and_fits_start_by_their_own() -> None:
    """Assert ends of a sweep over what the start follows, by the closed form."""
    sweep = xd.sweep(spring(), axes={"L": ["0.5 m", "1 m"]}, keep=["end"], method="dop853", rtol=1e-12, until="1 s")
    assert sweep.end_x.values == pytest.approx([length / 2 * cos(2.0) + sin(2.0) for length in (0.5, 1.0)], rel=1e-10)


def test_a_start_is_fitted_through_its_parameter(tmp_path: Path) -> None:
    """Assert that a length comes back from positions of the closed form."""
    times = np.linspace(0.0, 1.0, 12)
    rows = "".join(f"{t!r},{0.35 * cos(2 * t) + sin(2 * t)!r}\n" for t in times.tolist())
    (tmp_path / "x.csv").write_text(f"time [s],x [m]\n{rows}")
    fitted = xd.fit(spring(), tmp_path / "x.csv", ["L"], **SETTINGS)
    assert float(fitted.estimate[0]) == pytest.approx(0.7, rel=1e-9)


@pytest.mark.parametrize(
    ("start", "fault"),
    [
        ('x = "L*phi0/second"', "initial value of 'x'"),
        ('x = "v_x*second"', "a value at the start is of parameters"),
        ('x = "w"', "'w'"),
        ('x = "L*sin("', "x"),
    ],
)
def test_a_wrong_start_is_told(start: str, fault: str) -> None:
    """Assert one error that names the value."""
    with pytest.raises(xd.ModelError) as caught:
        xd.Model.from_text(SPRING.replace('x = "L*sin(phi0)"', start))
    assert fault in str(caught.value)

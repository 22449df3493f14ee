"""What speaks against a run is said: steps beyond stability, a mass matrix that is nearly singular."""

from __future__ import annotations

import re
import warnings

import pytest

import xdynamics as xd
from cases.problems import MODELS, oscillator


def told(method: str, step: float, until: float) -> str:
    """Return the warning of a run of the oscillator, w = 2 s-1; empty if there is none."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        xd.simulate(oscillator().model, method=method, step=step, until=until, force_samples="none")
    assert len(heard) <= 1
    return str(heard[0].message) if heard else ""


def pair(excess: float | str, **how: str) -> xd.Model:
    """Two coordinates that share a mass but for a small part."""
    return xd.Model(
        name="pair",
        coordinates={"x": {"unit": "m"}, "y": {"unit": "mm"}},
        parameters={"m": "1 kg", "k": "1 N m-1", "u": "1 m"},
        mass={"matrix": [["m", "m"], ["m", f"m*(1 + {excess})"]]},
        forces={"spring": {"x": "-k*x", "y": "-k*y"}},
        initial={"x": "1 m", "y": "0 m", "v_x": "0 m s-1", "v_y": "0 m s-1"} | how,
    )


@pytest.mark.every(3)
@pytest.mark.parametrize("method", ["velocity_verlet", "rk4", "kahan_li8", "dormand_prince"])
def test_the_limit_is_that_of_modes_whatever_the_run_is_long(method: str) -> None:
    """Assert that `modes` and the warning of a short and a long run name one limit, and shorter steps are silent."""
    table = xd.modes(oscillator().model)
    limit = float(table.largest_stable_step[list(xd.METHODS).index(method)])
    for until in (5.0, 500.0):
        said = told(method, 1.02 * limit, until)
        assert float(re.search(r"stability limit (\S+) s", said)[1]) == pytest.approx(limit, rel=1e-5)
        assert told(method, 0.98 * limit, until) == ""


@pytest.mark.dear
def test_a_method_without_a_stable_step_says_why_it_warns() -> None:
    """Assert that what is always unstable, by `modes` too, warns where errors grow e times within the run, and says so."""
    assert float(xd.modes(oscillator().model).largest_stable_step[list(xd.METHODS).index("heun")]) == 0.0
    assert told("heun", 0.3, 5.0) == ""
    said = told("heun", 0.3, 500.0)
    assert "no step of 'heun' is stable" in said
    assert "Within this run of 500 s, a step of " in said
    assert "multiplies them by more than e (2.7), one of up to 0.1 s by less" in said
    stable = re.findall(r"(\w+) \(up to (\S+) s\)", said)
    assert [name for name, _ in stable] == ["velocity_verlet", "rk4", "dormand_prince"]
    for name, limit in stable:
        assert told(name, 0.98 * float(limit), 500.0) == ""
    # (w h)**4/8 a step: e times in 8/(w**4 h**3), where the short cut by the size of the step does not help
    assert "Within this run of 30000 s" in told("heun", 0.04, 30_000.0)


@pytest.mark.parametrize(
    ("excess", "digits"), [("1e-12", "condition 4e.12 at t = 0 s: .* about 3 are right"), ("4e-16", "about 0")]
)
@pytest.mark.parametrize("how", [{"step": 1e-9}, {"rtol": 1e-6}])
def test_a_singular_mass_is_said(excess: str, digits: str, how: dict[str, float]) -> None:
    """Assert that accelerations of few digits are called so, in the outcome and by a warning, whatever the units."""
    asked = {"method": "dormand_prince", "until": 5e-9, "force_samples": "none"} | how
    with pytest.warns(xd.AccuracyWarning, match=f"nearly singular, of {digits}" if "cond" in digits else digits):
        run = xd.simulate(pair(excess), **asked)
    assert "the mass matrix is nearly singular" in run.attrs["run_outcome_text"]


def test_a_mass_that_becomes_singular_on_the_way_is_said() -> None:
    """Assert that the matrix is looked at along the run, not at its start alone."""
    model = pair("exp(-15*t/(1*second))", v_x="1 m s-1").replace(parameters={"k": 0.0})
    with pytest.warns(xd.AccuracyWarning, match=r"nearly singular, of condition .* at t = (1\.[5-9]|2)"):
        xd.simulate(model, method="midpoint", step=1.0 / 64.0, until=2.0, force_samples="none")


def test_an_ordinary_mass_is_not_talked_about() -> None:
    """Assert that a double pendulum has nothing of it in its outcome."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "double_pendulum.toml"), method="rk4", step=0.01, until=1.0)
    assert run.attrs["run_outcome_text"] == "reached t = 1 s"

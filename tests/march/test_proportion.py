"""The error at the end of a run follows its tolerances by the power that the estimate and its rescaling imply."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import xdynamics as xd
from cases.problems import EPS
from xdynamics.march.configuration import settings_for
from xdynamics.march.ensemble import march_many
from xdynamics.methods import METHODS, Method
from xdynamics.model.motion import variables

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
    lower = method.estimate and not (method.stepper.inner or method.stepper.foresees)
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

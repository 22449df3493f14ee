"""Random equations with delays, kicks and controllers against their exact motions; delays that nearly agree."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.delayed import Delayed

END = 1.9  # s
METHODS = {"dop853": 1e-11, "dormand_prince": 1e-8, "bogacki_shampine": 1e-6}
STEPS = {"dop853": "20 ms", "dormand_prince": "20 ms", "rk4": "10 ms"}
NEARLY = """
name = "two delays that nearly agree"
[states]
y = { unit = "1", rate = "a*delayed(y, '0.1 s') + b*delayed(y, '0.10001 s')" }
[parameters]
a = "-0.45241870901797976 s-1"
b = "-0.45241418485353225 s-1"
[history]
y = "exp(-t/second)"
[initial]
y = "1"
"""


def worst(run: xr.Dataset, drawn: Delayed) -> float:
    """The largest error at rows, some sixty of them, none of which is at a kick."""
    times = run.time.values
    kicks = [float(time) for time, _ in drawn.kicks]
    rows = np.flatnonzero([all(abs(time - kick) > 1e-9 for kick in kicks) for time in times])
    return max(abs(float(run.y[row]) - drawn.exact(times[row])) for row in rows[:: max(1, len(rows) // 60)])


@pytest.mark.parametrize(
    "settings", [{"step": "40 ms"}, {"step": "10 ms"}, {"rtol": 1e-11, "atol": 1e-13}, {"rtol": 1e-6}]
)
def test_delays_that_nearly_agree(settings: dict[str, float | str]) -> None:
    """Assert exp(-t), which a step that read beyond a stretch of the past left for 1302 within a second."""
    run = xd.simulate(xd.Model.from_text(NEARLY), method="dop853", until="1.5 s", **settings)
    tolerance = 10.0 * float(settings.get("rtol", 1e-13))
    assert float(np.max(np.abs(run.y - np.exp(-run.time)))) < tolerance


@pytest.mark.every(2)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.cases(300)
def test_chosen_steps_meet_their_tolerance(method: str, case: int) -> None:
    """Assert an error of at most ten tolerances at every row, of those that the rates pass on."""
    drawn, rtol = Delayed.drawn(case), METHODS[method]
    run = xd.simulate(drawn.model, method=method, rtol=rtol, atol=rtol, until=f"{END} s")
    assert run.attrs["run_outcome"] == "completed"
    assert worst(run, drawn) < 10.0 * rtol * max(1.0, float(abs(run.y).max()))


@pytest.mark.every(2)
@pytest.mark.parametrize("method", STEPS)
@pytest.mark.cases(300)
def test_given_steps_are_as_accurate_as_their_order(method: str, case: int) -> None:
    """Assert the errors of steps that are far below the delays."""
    drawn = Delayed.drawn(case)
    run = xd.simulate(drawn.model, method=method, step=STEPS[method], until=f"{END} s")
    assert run.attrs["run_outcome"] == "completed"
    assert worst(run, drawn) < {"dop853": 1e-13, "dormand_prince": 1e-9, "rk4": 1e-7}[method]


@pytest.mark.cases(300)
def test_states_between_rows_are_as_accurate(case: int) -> None:
    """Assert the same between rows, whose past is made again from the record."""
    drawn = Delayed.drawn(case)
    run = xd.simulate(drawn.model, method="dop853", rtol=1e-11, atol=1e-11, until=f"{END} s")
    times = np.random.default_rng(case).uniform(0.0, END, 40)
    states = xd.sample(run, times)
    errors = [abs(float(y) - drawn.exact(float(t))) for t, y in zip(states.at_time, states.y, strict=True)]
    assert max(errors) < 1e-10


REFINED = {"dop853": [1e-8, 1e-9, 1e-10], "dormand_prince": [1e-7, 1e-8, 1e-9], "bogacki_shampine": [1e-5, 1e-6, 1e-7]}


def stated(case: int, method: str) -> float:
    """The error of the finest level of a refinement over the uncertainty that it states."""
    drawn = Delayed.drawn(case)
    study = xd.refine(
        drawn.model, method=method, rtols=REFINED[method], until=f"{END} s", observables=["y"], occurrences=0
    )
    return abs(float(study.y[-1, 0]) - drawn.exact(END)) / float(study.uncertainty_y[0])


def test_refinements_cover_what_they_state(request: pytest.FixtureRequest) -> None:
    """Assert that 95 of 100 stated uncertainties hold the error, though breaking points set many of the steps."""
    cases = range(0, 300, 3 if request.config.getoption("--whole") else 30)
    ratios = np.array([stated(case, method) for case in cases for method in REFINED])
    assert np.mean(ratios <= 1.0) >= 0.95
    assert ratios.max() < 10.0


def test_steps_between_breaking_points_do_not_state_less_than_they_know() -> None:
    """Assert the delays whose tolerances choose no step: levels agree to 1.5e-13 and are off by 5e-12."""
    a, first, second = -0.45, 0.1058, 0.2116
    b = (-1.0 - a * np.exp(first)) / np.exp(second)
    model = xd.Model(
        name="exp(-t)",
        states={"y": {"unit": "1", "rate": "a*delayed(y, tau) + b*delayed(y, later)"}},
        parameters={"a": f"{a!r} s-1", "b": f"{float(b)!r} s-1", "tau": f"{first} s", "later": f"{second} s"},
        history={"y": "exp(-t/second)"},
        initial={"y": "1"},
    )
    for end in (0.5, 1.0, 2.0):
        study = xd.refine(model, method="dormand_prince", rtols=[1e-8, 1e-9, 1e-10], until=f"{end} s")
        assert abs(float(study.y[-1, 0]) - np.exp(-end)) < float(study.uncertainty_y[0]) < 1e-9

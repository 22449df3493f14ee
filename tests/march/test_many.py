"""Many runs in one call: each is the run that it is alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.problems import MODELS, particle
from xdynamics.march import March, Runs, march_many
from xdynamics.march.configuration import settings_for
from xdynamics.march.settings import Settings

N = 40


def alone(model: xd.Model, settings: Settings) -> tuple[March, np.ndarray, np.ndarray]:
    """March one run; return it with its rows and events."""
    march = March(model, settings)
    blocks = list(march.blocks())
    rows = np.concatenate([block.log.rows[:, : block.rows] for block in blocks], axis=1)
    return march, rows, np.concatenate([block.log.events[: block.events] for block in blocks])


def asked(model: xd.Model, **more: Any) -> Settings:
    """Settings without force samples."""
    return settings_for(model, force_samples="none", **more)


@pytest.mark.every(7)
@pytest.mark.parametrize(
    ("name", "more"),
    [
        ("ball_drag", {"method": "dop853", "rtol": 1e-8}),
        ("ball_drag", {"method": "midpoint", "step": 0.01}),
        ("kepler", {"method": "dprkn6", "rtol": 1e-7, "until": 3.0}),
        ("pendulum", {"method": "implicit_midpoint", "step": 0.05, "until": 3.0}),
        ("rocket_c6", {"method": "heun", "rtol": 1e-4, "until": 4.0}),
        ("block_on_incline", {"method": "dormand_prince", "rtol": 1e-7, "until": 2.0}),
        ("ball_in_box", {"method": "dormand_prince", "rtol": 1e-7, "until": 2.0}),
        ("stick_slip_belt", {"method": "dormand_prince", "rtol": 1e-6, "until": 3.0}),
        (
            "cart_spring",
            {"method": "pefrl", "rtol": 1e-5, "estimator": "step_doubling", "until": 2.0, "scales": {"time": "3 s"}},
        ),
    ],
)
def test_each_run_has_the_bits_that_it_has_alone(name: str, more: dict[str, Any]) -> None:
    """Assert states, counts, outcomes, events and whole logs of every member, with parameters and starts of their own."""
    model = xd.Model.from_toml(MODELS / f"{name}.toml")
    settings, random = asked(model, **more), np.random.default_rng(3)
    parameter, start = next(iter(model.statement.parameters)), settings.layout(model).used[0]
    values = model.parameters[parameter].quantity.si * random.uniform(0.9, 1.1, N)
    starts = model.initial[start].si + random.uniform(0.0, 1e-3, N)
    runs = march_many(model, settings, parameters={parameter: values}, initial={start: starts}, logs=True)
    for i in range(0, N, 13):
        changed = {
            "parameters": {parameter: f"{float(values[i])!r} {_si(model, parameter)}"},
            "initial": {start: f"{float(starts[i])!r} {_si(model, start)}"},
        }
        march, rows, events = alone(model.replace(**changed), settings)
        assert rows.tobytes() == runs.log_of(i).tobytes()
        assert events.tobytes() == runs.events_of(i).tobytes()
        counts = [int(march.now[name]) for name in ("status", "rows", "trials", "evaluations")]
        assert counts == [int(one[i]) for one in (runs.status, runs.rows, runs.trials, runs.evaluations)]
        assert runs.outcomes[i] == march.outcome.word
    assert len(np.unique(runs.state, axis=0)) == N


def _si(model: xd.Model, name: str) -> str:
    """SI unit of a parameter or initial value."""
    from xdynamics.units import spell

    return spell(model.dimensions[name]).text


def test_steps_and_tolerances_of_their_own() -> None:
    """Assert that each run takes its own step or tolerance."""
    model = particle("-F*x/(1*metre)")
    runs = march_many(model, asked(model, method="midpoint", step=0.1, until=1.0), steps=[0.1, 0.05, 0.03])
    assert runs.rows.tolist() == [11, 21, 35]
    judged = asked(model, method="dormand_prince", rtol=1e-3, atol=1e-9, until=9.0)
    runs = march_many(model, judged, rtols=[1e-3, 1e-6, 1e-9])
    assert (
        runs.state[1].tobytes()
        == alone(model, asked(model, method="dormand_prince", rtol=1e-6, atol=1e-9, until=9.0))[0].run.y[:2].tobytes()
    )
    assert runs.rows[0] < runs.rows[1] < runs.rows[2]
    runs = march_many(
        model, asked(model, method="dormand_prince", rtol=1e-3, until=9.0), rtols=[1e-9]
    )  # and atol with it
    assert (
        runs.state[0].tobytes()
        == alone(model, asked(model, method="dormand_prince", rtol=1e-9, until=9.0))[0].run.y[:2].tobytes()
    )


def test_each_run_begins_on_its_grid() -> None:
    """Assert that from a start that is no round number the first step of every run is the grid's, to the bit."""
    model = particle("F*t/second", initial={"t": "0.3 s", "x": "1 m", "v_x": "0 m s-1"})
    settings = asked(model, method="midpoint", step=0.1, until=1.1)
    runs = march_many(model, settings, parameters={"F": [5.0, 5.0, 5.0]}, logs=True)
    _, rows, _ = alone(model, settings)
    assert rows[1, 1] == 0.1
    assert [runs.log_of(i).tobytes() for i in range(3)] == [rows.tobytes()] * 3


@pytest.fixture(scope="module")
def bouncing() -> tuple[xd.Model, Settings, np.ndarray]:
    """A ball thrown at many speeds."""
    model = xd.Model.from_toml(MODELS / "ball_drag.toml")
    return model, asked(model, method="heun", rtol=1e-6), np.linspace(5.0, 30.0, 3000)


@pytest.mark.dear
def test_threads_and_logs_change_nothing(bouncing: tuple[xd.Model, Settings, np.ndarray]) -> None:
    """Assert that the result is that of one thread without logs, events that overflow the log included."""
    model, settings, speeds = bouncing
    found = [
        march_many(model, settings, initial={"v_y": speeds}, threads=n, logs=logs)
        for n, logs in ((1, False), (2, False), (4, True))
    ]
    for other in found[1:]:
        for name in ("time", "state", "status", "rows", "trials", "evaluations", "events", "first_event"):
            assert getattr(other, name).tobytes() == getattr(found[0], name).tobytes(), name
    assert len(found[0].events) == found[0].first_event[-1] > 4000
    with pytest.raises(xd.InputError, match="no logs were kept; march with logs=True"):
        found[0].log_of(0)


def test_a_run_that_fails_is_a_member_with_its_outcome() -> None:
    """Assert that one bad run ends as it does alone, and the others go on."""
    model = particle("F/where(x > 5*metre, 0, 1)")
    runs = march_many(model, asked(model, method="midpoint", step=0.1, until=0.5), initial={"x": [1.0, 4.9, 2.0]})
    assert runs.outcomes == ["completed", "nonfinite_state", "completed"]
    assert isinstance(runs, Runs)
    assert np.isfinite(runs.state).all()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"parameters": {"q": [1.0]}}, "parameter 'q' is none of m, F"),
        ({"initial": {"t": [1.0]}}, "initial value 't' is none of x, v_x"),
        ({"parameters": {"m": [1.0, float("nan")]}}, "parameter 'm' of run 1 is nan, needs a finite number"),
        ({"steps": [0.1, -0.1]}, "step of run 1 is -0.1, needs a positive time"),
        ({"rtols": [1e-3]}, "rtols are for chosen or judged steps"),
        ({"parameters": {"m": [1.0]}, "initial": {"x": [1.0, 2.0]}}, "arrays have 1, 2 numbers; all need the same"),
        ({"parameters": {"m": []}}, r"parameter 'm' has the shape \(0,\), needs one number for each run"),
        ({"parameters": {"m": [[1.0]]}}, r"parameter 'm' has the shape \(1, 1\)"),
        ({"parameters": {"m": ["heavy"]}}, r"parameter 'm' is \['heavy'\], needs one number for each run"),
        ({"steps": [1e-17]}, r"a run with step 1e-17: step 1e-17 s makes over 2\*\*53 steps"),
        ({}, "nothing varies; give parameters, initial, steps or rtols"),
    ],
)
def test_wrong_arrays_are_named(given: dict[str, Any], message: str) -> None:
    """Assert that every fault is told by its array, run and value."""
    model = particle("F")
    with pytest.raises(xd.InputError, match=message):
        march_many(model, asked(model, method="midpoint", step=0.1, until=1.0), **given)


def test_first_steps_and_starts_are_held_to_what_one_run_is() -> None:
    """Assert that limits of chosen steps and a scale for every error are asked of every member."""
    model = particle("F")
    limited = asked(model, method="dormand_prince", rtol=1e-3, max_step=0.1, until=1.0)
    with pytest.raises(xd.InputError, match="a run with step 3.0: step, the first one, is 3.0 s, needs to be from"):
        march_many(model, limited, steps=[0.05, 3.0])
    bare = asked(model, method="dormand_prince", rtol=1e-3, atol={"x": 0.0, "v_x": 1e-9}, until=1.0)
    with pytest.raises(xd.InputError, match="atol of 'x' is 0 and a run starts at x = 0"):
        march_many(model, bare, initial={"x": [1.0, 0.0]})

"""Entries of a model that are changed, added and taken away."""

from __future__ import annotations

from typing import Any

import pytest

import xdynamics as xd
from cases.problems import MODELS

BALL = xd.Model.from_toml(MODELS / "thrown_ball.toml")
PLANETS = xd.Model.from_toml(MODELS / "outer_solar_system.toml")
APEX = {"function": "v_y", "direction": "falling"}


def test_an_event_is_added_and_taken_away() -> None:
    """Assert that it is located at the top, that the first model stays as it was, and that None takes one away."""
    model = BALL.replace(events={"apex": APEX})
    assert [*model.statement.events] == ["landing", "apex"]
    assert [*BALL.statement.events] == ["landing"]
    run = xd.simulate(model, until="3 s")
    top = run.dynamics.events("apex")
    assert abs(float(top.before_v_y[0])) < 1e-9
    assert float(top.before_y[0]) == pytest.approx(float(run.y.max()), abs=1e-12)
    fewer = model.replace(events={"landing": None})
    assert [*fewer.statement.events] == ["apex"]
    assert fewer == xd.Model.from_text(fewer.to_toml())


def test_settings_a_name_and_a_force() -> None:
    """Assert a step in the place of a tolerance, another name and description, and a force that acts."""
    model = BALL.replace(
        run={"method": "rk4", "step": "10 ms"}, name="drop", description="without drag", forces={"drag": None}
    )
    assert model.run == {"method": "rk4", "step": "10 ms", "until": BALL.run["until"]}
    assert (model.name, model.statement.description) == ("drop", "without drag")
    wind = model.replace(forces={"wind": {"x": "0.1*newton"}})
    run = xd.simulate(wind, until="1 s")
    assert run.force_wind_x.values.tolist() == [0.1] * run.sizes["step"]
    assert float(run.a_x[0]) == pytest.approx(0.1 / 0.145, rel=1e-15)
    assert BALL.replace(run={"until": None}).run == {key: value for key, value in BALL.run.items() if key != "until"}


def test_a_model_with_dimensions_likewise() -> None:
    """Assert a name and settings of a model whose quantities have elements."""
    model = PLANETS.replace(run={"rtol": 1e-6}, name="planets")
    assert (model.name, model.run["rtol"]) == ("planets", 1e-6)
    assert "step" not in model.run
    assert model.shaped.coordinates.keys() == PLANETS.shaped.coordinates.keys()


@pytest.mark.parametrize("speed", [20.0, "20 m s-1", "72 km h-1"])
def test_a_start_is_found_by_shooting(speed: Any) -> None:
    """Assert that numbers, bare or with units, and numbers of numpy are values at the start, as root finders give them."""
    import numpy as np

    for value in (speed, np.float64(speed) if isinstance(speed, float) else speed):
        run = xd.simulate(BALL.replace(initial={"v_x": value}), until="0.1 s")
        assert float(run.v_x[0]) == pytest.approx(20.0, rel=1e-15)


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "parameter": ({"parameters": {"mass": "1 kg"}}, "parameters has no entry 'mass'; there are: m, g, c, angle"),
    "start": ({"initial": {"z": "1 m"}}, "initial has no entry 'z'"),
    "none there": ({"events": {"apex": None}}, "events has no entry 'apex'; there are: landing"),
    "setting": ({"run": {"nodes": ["1 s"]}}, "has no setting 'nodes'"),
    "unit": ({"run": {"step": "1 m"}}, "step"),
    "section": ({"foo": {"a": 1}}, "foo has no entry 'a'"),
    "text for a section": ({"events": "apex"}, "events has no entries to replace"),
    "number for a name": ({"name": 3}, "is no text; write it in quotes"),
    "event": ({"events": {"apex": {"function": "w"}}}, "'w'"),
    "event without a function": ({"events": {"apex": {}}}, "apex"),
    "a parameter that is used": ({"parameters": {"g": None}}, "'g'"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_said(case: str) -> None:
    """Assert one error that names it."""
    sections, words = WRONG[case]
    with pytest.raises(xd.ModelError, match=words):
        BALL.replace(**sections)

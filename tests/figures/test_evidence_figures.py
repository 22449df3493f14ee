"""Figures of evidence: what was asked for first, no numbers at rounding, digits as far as they are known."""

from __future__ import annotations

import xarray as xr

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.figures.refinement import telling


def test_a_refinement_draws_what_was_asked_for() -> None:
    """Assert six panels of a rocket at most, none of burnt fuel, hidden switches last, values with their uncertainty."""
    rocket = xd.Model.from_toml(MODELS / "rocket_c6.toml")
    study: xr.Dataset = xd.refine(rocket, steps=["40 ms", "20 ms", "10 ms"], occurrences=1)
    assert "difference_fuel" in study
    assert not telling(study, "fuel")
    axes = [axis for axis in xd.plot(study).axes if axis.get_visible()]
    titles = [axis.get_title(loc="left") for axis in axes]
    assert len(titles) == 6
    assert not any(title.startswith(("fuel", "after_apogee_fuel")) or "pad." in title for title in titles)
    assert titles[0].startswith("y at t = ")
    assert all(" ± " in title for title in titles)


def test_switches_hidden_in_forces_come_last() -> None:
    """Assert that the time of an apex stands before that of the zero of an abs, though both are the same instant."""
    ball = xd.Model(
        name="ball",
        coordinates={"y": "m"},
        parameters={"m": "1 kg", "c": "0.1 kg m-1"},
        mass={"y": "m"},
        forces={"weight": {"y": "-m*9.81*metre/second**2"}, "drag": {"y": "-c*v_y*abs(v_y)"}},
        initial={"y": "0 m", "v_y": "10 m s-1"},
        events={"apex": {"function": "v_y", "direction": "falling", "action": "record"}},
    )
    study = xd.refine(ball, method="midpoint", steps=["40 ms", "20 ms", "10 ms"], occurrences=1, until="1 s")
    named = [axis.get_title(loc="left").split(" = ")[0] for axis in xd.plot(study).axes if axis.get_visible()]
    assert named[2:5] == ["event_time_apex", "after_apex_y", "event_time_drag.abs"]
    lines = [line.split(" = ")[0] for line in repr(study.dynamics).splitlines()]
    assert lines.index("event_time_apex [1]") < lines.index("event_time_drag.abs [1]")

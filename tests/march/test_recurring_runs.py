"""Marches of one model with equal settings, which begin with copies of the same numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.march import March
from xdynamics.march.configuration import settings_for
from xdynamics.march.initial_run import addresses_of, pose_run
from xdynamics.march.log import log_of
from xdynamics.march.run import ARRAYS, Run
from xdynamics.march.runner import recurs

CASES: tuple[tuple[str, dict[str, Any]], ...] = (
    ("harmonic_oscillator", {"method": "velocity_verlet", "step": 0.05}),
    ("harmonic_oscillator", {"method": "taylor", "rtol": 1e-9}),
    ("kepler", {"method": "dop853", "rtol": 1e-9, "atol": 1e-9}),
    ("kepler", {"method": "radau_iia", "rtol": 1e-6}),
)


def marches(name: str, asked: dict[str, Any]) -> tuple[March, March]:
    """Two marches alike, of which the first is over."""
    model = xd.Model.from_toml(MODELS / f"{name}.toml")
    settings = settings_for(model, until=3.0, **asked)
    assert recurs(model, settings, settings.layout(model))
    first, second = March(model, settings), March(model, settings)
    assert sum(block.rows for block in first.blocks()) > 5
    return first, second


def filled(run: Run) -> dict[str, Any]:
    """The arrays that have elements, but for the log, of which there is none yet."""
    arrays = {name: getattr(run, name) for name in ARRAYS}
    return {name: array for name, array in arrays.items() if array.size and not name.startswith("log_")}


@pytest.mark.parametrize(("name", "asked"), CASES)
def test_beginning(name: str, asked: dict[str, Any]) -> None:
    """Assert that a march begins with the bits it is posed with, whatever another did before, on a line of the cache."""
    _, march = marches(name, asked)
    law, settings = march.law, march.settings
    alone = pose_run(march.model, settings, law, log_of(march.layout, settings, 0), addresses_of(law))
    found, expected = filled(march.run), filled(alone)
    assert found.keys() == expected.keys()
    assert not [key for key, array in expected.items() if array.tobytes() != found[key].tobytes()]
    assert (march.run.w.ctypes.data * bool(march.run.w.size)) % 64 == 0


@pytest.mark.parametrize(("name", "asked"), CASES)
def test_memory_of_its_own(name: str, asked: dict[str, Any]) -> None:
    """Assert that marches share no number, for compiled code too: each changes its own state alone."""
    first, second = marches(name, asked)
    own, others = filled(first.run), filled(second.run)
    assert not [key for key in own if np.shares_memory(own[key], others[key])]
    before = {key: array.tobytes() for key, array in own.items()}
    assert second.run.y.tobytes() != before["y"]
    assert sum(block.rows for block in second.blocks()) > 5
    assert second.run.y.tobytes() == before["y"]
    assert {key: array.tobytes() for key, array in own.items()} == before


def test_times_as_they_are_written() -> None:
    """Assert that settings that are equal as floats only begin each with its own numbers."""
    model = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml").replace(initial={"t": "-1 s"})
    ends = [xd.simulate(model, method="rk4", step=0.25, until=end).time.values[-1] for end in (0.0, -0.0)]
    assert np.signbit(ends).tolist() == [False, True]
    third = [
        xd.simulate(model, method="rk4", step=0.25, until=end, precision="double_double")
        for end in (f"{1 / 3!r} s", "0.33333333333333333333 s")
    ]
    assert third[0].rest_time.values[-1] != third[1].rest_time.values[-1]


@pytest.mark.parametrize(("count", "is_kept"), [(63, True), (64, False)])
def test_many_parameters(count: int, is_kept: bool) -> None:
    """Assert that little is kept of each model: of 64 parameters at most, each time by the values of the model."""
    own = {"m": "1 kg", "k": {"dims": ["spring"], "value": np.ones(count), "unit": "N m-1"}}
    model = xd.Model(
        name="springs",
        dimensions={"spring": count},
        coordinates={"x": "m"},
        mass={"x": "m"},
        parameters=own,
        forces={"pull": {"x": "-sum(k, spring)*x"}},
        initial={"x": "1 m", "v_x": "0 m s-1"},
    )
    settings = settings_for(model, method="rk4", step=0.01, until=0.1)
    assert recurs(model, settings, settings.layout(model)) == is_kept

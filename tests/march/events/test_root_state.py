"""Events located on shortened steps, or on the interpolant of the whole one."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import xdynamics as xd


def crossing(root_state: str, **more: Any) -> xd.Model:
    """An oscillator that crosses 0.3 m."""
    return xd.Model(
        name="oscillator",
        coordinates={"x": "m"},
        parameters={"m": "1 kg", "k": "4 N m-1"},
        mass={"x": "m"},
        forces={"spring": {"potential": "k*x**2/2"}},
        initial={"x": "1 m", "v_x": "0 m s-1"},
        events={"c": {"function": "x - 0.3*metre", "root_state": root_state} | more},
    )


def times(count: int) -> np.ndarray:
    """When it does."""
    phase = math.acos(0.3)
    return (
        np.sort(np.concatenate([phase + 2 * np.pi * np.arange(99), -phase + 2 * np.pi * np.arange(1, 99)]))[:count] / 2
    )


@pytest.mark.parametrize("method", ["dop853", "dormand_prince", "bogacki_shampine", "radau_iia"])
def test_the_interpolant_is_part_of_the_uncertainty(method: str) -> None:
    """Assert that both find every crossing, apart by no more than the part that is recorded, which only one of them has."""
    runs = {
        name: xd.simulate(crossing(name), method=method, rtol=1e-7, until=1.0)
        for name in ("reintegrate", "interpolant")
    }
    one, other = runs["reintegrate"], runs["interpolant"]
    assert one.sizes["event"] == other.sizes["event"] == 1
    assert (one.event_time_uncertainty_interpolation.values == 0).all()
    drift = float(other.event_time_uncertainty_interpolation[0])
    assert 0 < drift < 1e-5
    assert abs(float(one.event_time[0] - other.event_time[0])) <= 1.5 * drift + 1e-11
    assert float(other.event_time_uncertainty[0]) >= drift
    assert int(other.event_substeps[0]) < int(one.event_substeps[0])


@pytest.mark.parametrize("method", ["velocity_verlet", "rk4", "pefrl"])
def test_every_crossing_is_found_on_the_interpolant(method: str) -> None:
    """Assert times within the method's own error, for fixed steps of half a second."""
    run = xd.simulate(crossing("interpolant"), method=method, step=0.02, until=20.0)
    assert run.event_time.values == pytest.approx(times(run.sizes["event"]), abs=3e-3)
    assert run.sizes["event"] == 13
    assert np.abs(run.event_residual.values).max() < 1e-11


def test_the_word_is_kept_and_others_are_refused() -> None:
    """Assert the file's word, and the choice in the error."""
    model = crossing("interpolant")
    assert xd.Model.from_text(model.to_toml()) == model
    with pytest.raises(xd.ModelError, match="root_state 'guess' is not known; there are reintegrate, interpolant"):
        crossing("guess")

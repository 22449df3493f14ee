"""Steps of Radau IIA where links close and hold: solved to rounding, whoever chooses them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.march.implicit.radau import MOST_SETTLING, SETTLED

G = 9.80665


def discs(places: list[list[float]], side: str = "0*metre", width: float = 99.0, **initial: Any) -> xd.Model:
    """Discs of 1 kg and radius 0.1 m in a box, whose side walls are moved by `side`."""
    count = len(places)
    return xd.Model(
        name="discs in a box",
        dimensions={"disc": count, "axis": ["x", "y"]},
        relations={"pair": {"of": "disc"}},
        coordinates={"r": {"unit": "m", "dims": ["disc", "axis"]}},
        parameters={"g": f"{G} m s-2", "m": "1 kg", "radius": "0.1 m"}
        | {"across": {"dims": ["axis"], "value": [1, 0], "unit": "1"}}
        | {"width": {"dims": ["axis"], "value": [width, 99.0], "unit": "m"}},
        mass={"r": "m"},
        forces={"weight": {"potential": "m*g*sum(r*(1 - across), axis)"}},
        contacts={
            "walls": {"gap": f"r - radius - across*({side})", "restitution": 0.4},
            "far_walls": {"gap": f"width - radius - r + across*({side})", "restitution": 0.4},
            "discs": {"gap": "norm(second(r, pair) - first(r, pair), axis) - 2*radius", "restitution": 0.4},
        },
        initial={"r": {"unit": "m", "value": places}} | initial,
    )


def met(run: xr.Dataset) -> list[tuple[int, ...]]:
    """Return what happened to which link, in order."""
    names = ("event_detector", "event_kind", "event_pair", "event_disc", "event_axis")
    return list(zip(*(run[name].values.tolist() for name in names), strict=True))


@pytest.mark.parametrize("rtol", [1e-3, 1e-4])
def test_loose_tolerances_locate_impacts(rtol: float) -> None:
    """Assert that discs that fall hit the floor at sqrt(2 h/g), each located though the error test asks for little.

    Iterations that end as soon as the error test allows lead to a state that jumps as the step is shortened.
    """
    heights = 0.05 + 0.01 * np.arange(9)
    model = discs([[1.0 + k, 0.1 + height] for k, height in enumerate(heights.tolist())])
    run = xd.simulate(model, method="radau_iia", rtol=rtol, until="0.17 s")
    first = [float(run.event_time.values[run.event_disc.values == disc][0]) for disc in range(9)]
    assert run.attrs["run_outcome"] == "completed"
    assert np.abs(first - np.sqrt(2.0 * heights / G)).max() < 2e-12
    assert (run.attrs["solver_newton_tolerance"], run.attrs["solver_newton_most_iterations"]) == (
        SETTLED,
        MOST_SETTLING,
    )
    assert "closed contacts" in run.attrs["solver_equations_solved_by"]


@pytest.mark.parametrize("step", ["2 ms", "3 ms"])
def test_held_discs_have_the_size_of_what_holds_them(step: str) -> None:
    """Assert that a pyramid between walls that swing slowly is where an explicit method has it, in every step.

    Its velocities of 1e-7 m/s and less are what is left of g h, 2e-2 m/s, which closed links keep from the discs.
    """
    wide, high = 0.22, float(np.sqrt(0.04 - 0.11**2))
    places = [[0.1 + wide * (j + k / 2), 0.1 + high * k] for k in range(3) for j in range(3 - k)]
    speed = {"unit": "m s-1", "value": [[1e-4, 0.0]] * 6}
    model = discs(places, "(1e-4*metre)*sin(t/second)", 0.2 + 2 * wide, v_r=speed)
    settings: dict[str, Any] = {"step": step, "until": "0.24 s"}
    run, peer = (xd.simulate(model, method=method, **settings) for method in ("radau_iia", "dop853"))
    assert run.attrs["run_outcome"] == "completed"
    assert np.array_equal(run.time.values, peer.time.values)
    assert np.abs(run.r.values - peer.r.values).max() < 1e-13
    assert np.abs(run.v_r.values - peer.v_r.values).max() < 1e-13


@pytest.mark.dear
@pytest.mark.parametrize("steps", [{"step": "2 ms"}, {"step": "1 ms"}, {"rtol": 1e-4}])
def test_a_box_of_discs_comes_to_rest(steps: dict[str, Any]) -> None:
    """Assert that impacts are those of an explicit method one by one, that energy is balanced, and that discs rest."""
    model = xd.Model.from_toml(MODELS / "granular_box.toml")
    run = xd.simulate(model, method="radau_iia", until="1 s", **steps)
    peer = xd.simulate(model, method="dop853", step="2 ms", until="0.26 s")
    many = peer.sizes["event"]
    energy, lost = run.total_energy.values, float(run.event_energy_lost.sum())
    assert run.attrs["run_outcome"] == "completed"
    assert met(run)[:many] == met(peer)
    assert many > 100
    assert np.abs(run.event_time.values[:many] - peer.event_time.values).max() < 1e-9
    assert abs(energy[-1] - energy[0] + lost) < (1e-7 if "rtol" in steps else 1e-10) * energy[0]
    assert np.abs(run.v_r.values[-1]).max() < 1e-12

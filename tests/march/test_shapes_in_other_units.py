"""Bodies with dimensions move alike in nanometres and femtoseconds, in metres, and in petametres and petaseconds."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd

UNITS = {"one": ("m", "s"), "small": ("nm", "fs"), "large": ("Pm", "Ps")}


def discs(length: str, time: str) -> xd.Model:
    """Three discs between four walls."""
    gap = "norm(second(r, pair) - first(r, pair), axis) - 2*R"
    return xd.Model(
        name="discs",
        dimensions={"disc": ["a", "b", "c"], "axis": ["x", "y"]},
        relations={"pair": {"of": "disc"}},
        coordinates={"r": {"unit": length, "dims": ["disc", "axis"]}},
        parameters={"m": "1 kg", "R": f"0.1 {length}", "W": f"1 {length}"},
        mass={"r": "m"},
        contacts={
            "low": {"gap": "r - R", "restitution": 0.9},
            "high": {"gap": "W - R - r", "restitution": 0.9},
            "discs": {"gap": gap, "restitution": 1},
        },
        initial={
            "t": f"0 {time}",
            "r": {"unit": length, "value": [[0.2, 0.2], [0.5, 0.5], [0.8, 0.2]]},
            "v_r": {"unit": f"{length} {time}-1", "value": [[0.9, 0.35], [-0.2, 0.15], [-0.6, 0.5]]},
        },
    )


def ring(length: str, time: str) -> xd.Model:
    """A ring of masses on hardening springs, each with an event where it passes its rest."""
    stretch = "(second(u, bond) - first(u, bond))"
    return xd.Model(
        name="ring",
        dimensions={"site": 8},
        relations={"bond": {"of": "site", "neighbours": 1, "ring": True}},
        coordinates={"u": {"unit": length, "dims": ["site"]}},
        parameters={"m": "1 kg", "k": f"1 kg {time}-2", "A": f"0.1 {length}"},
        mass={"u": "m"},
        forces={"spring": {"over": "bond", "potential": f"0.5*k*{stretch}**2*(1 + ({stretch}/A)**2)"}},
        events={"rest": {"function": "u", "direction": "rising"}},
        initial={
            "t": f"0 {time}",
            "u": "A*sin(2*pi*index(site)/size(site) + 1)",
            "v_u": {"unit": f"{length} {time}-1", "value": 0},
        },
    )


@lru_cache
def marched(make: str, units: str) -> xr.Dataset:
    """Return a run of two units of time, by what is default but for the relative tolerance."""
    length, time = UNITS[units]
    model = {"discs": discs, "ring": ring}[make](length, time)
    return xd.simulate(model, method="dop853", rtol=1e-9, until=f"{2 if make == 'discs' else 10} {time}")


@pytest.mark.parametrize("units", [name for name in UNITS if name != "one"])
@pytest.mark.parametrize(("make", "name", "events"), [("discs", "r", 8), ("ring", "u", 12)])
def test_a_motion_is_the_same_in_any_units(make: str, name: str, events: int, units: str) -> None:
    """Assert the rows, the events, their times, and the last state in the model's units as in metres and seconds."""
    run, one = marched(make, units), marched(make, "one")
    assert run.attrs["run_outcome"] == "completed"
    assert run.sizes["step"] == one.sizes["step"]
    assert run.sizes["event"] == one.sizes["event"] == events
    second = {"small": 1e-15, "large": 1e15}[units]
    assert float(run.time[-1]) == pytest.approx(second * float(one.time[-1]), rel=1e-15)
    assert np.abs(run[name].values[-1] - one[name].values[-1]).max() < 1e-13
    assert np.abs(run.event_time.values / second - one.event_time.values).max() < 1e-11

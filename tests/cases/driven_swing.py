"""A mass on a spring under a measured pull."""

from __future__ import annotations

from typing import Any

import xarray as xr

import xdynamics as xd

TABLE = "time [s],pull [N]\n0,0\n0.7,1\n2,-1\n5,0\n"


def swing(length: str, **asked: Any) -> xr.Dataset:
    """A mass on a spring under a measured pull, with what it has run through as a state, and events."""
    model = xd.Model(
        name="swing",
        coordinates={"x": {"unit": length}},
        parameters={"m": "2 kg", "k": "3 N m-1", "c": "0.1 kg s-1"},
        mass={"x": "m"},
        forces={"spring": {"potential": "k*x**2/2"}, "drag": {"x": "-c*v_x"}, "pull": {"x": "pull"}},
        states={"work": {"unit": "J", "rate": "pull*v_x"}},
        drives={"pull": {"table": "p.csv", "csv": TABLE, "interpolation": "linear", "outside": "hold"}},
        observables={"power": "c*v_x**2"},
        events={
            "low": {"function": "x", "direction": "falling", "time_tolerance": "1 ms"},
            "fast": {"function": "v_x - 0.2*metre/second", "direction": "either", "time_tolerance": "1 ms"},
        },
        initial={"x": "1 m", "v_x": "0 m s-1", "work": "0 J"},
    )
    atol = {"x": "1e-8 m", "v_x": "1e-8 m s-1", "work": "1e-8 J"}
    return xd.simulate(model, **{"method": "dormand_prince", "rtol": 1e-7, "atol": atol, "until": 9.0} | asked)

"""Runs as they were recorded in the former schema."""

from __future__ import annotations

import numpy as np
import xarray as xr

from xdynamics.schema import NAMES_ROWS


def former(run: xr.Dataset) -> xr.Dataset:
    """Return a run as version 0.2 would have recorded it: what names rows has their places among those that are kept."""
    places = {int(number): place for place, number in enumerate(run.step_number.values)}
    pointers = {
        name: (run[name].dims, np.array([places[int(number)] for number in run[name].values], "i8"), run[name].attrs)
        for name in NAMES_ROWS
        if name in run
    }
    texts = {name: ((), run[name].values[0], run[name].attrs) for name in ("model_toml", "force_source")}
    flat = run.reset_coords().drop_vars([*pointers, *texts]).assign(pointers | texts)
    return flat.set_coords("time").assign_attrs(Conventions="CF-1.11 ACDD-1.3 xdynamics-1", schema_version="1")

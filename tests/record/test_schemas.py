"""Records of the former schema in the words of today, and back."""

from __future__ import annotations

import numpy as np
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.record.schemas import NAMES_ROWS, as_written, modern


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


def test_pointers_of_a_thinned_record_become_numbers_and_places_again() -> None:
    """Assert that places among every seventh row are read as numbers of the march, and written as places."""
    model = xd.Model.from_toml(MODELS / "bouncing_ball.toml")
    run = xd.simulate(model, until="1.4 s", method="rk4", step="1 ms", keep_every=7)
    old = former(run)
    assert old.event_row_before.values.tolist() != run.event_row_before.values.tolist()
    read = modern(old)
    for name in NAMES_ROWS:
        if name in run:
            assert read[name].values.tolist() == run[name].values.tolist(), name
    assert read.model_toml.item() == run.model_toml.item()
    assert {"m", "event_time", "model_toml", "step_number"} <= {*read.coords}
    assert (
        read.dynamics.events("floor").before_v_y.values.tolist()
        == run.dynamics.events("floor").before_v_y.values.tolist()
    )
    written = as_written(read)
    for name, variable in old.variables.items():
        assert written.variables[name].identical(variable), name

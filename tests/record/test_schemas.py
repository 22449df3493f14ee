"""Records of the former schema in the words of today, and back."""

from __future__ import annotations

import xdynamics as xd
from cases.former_records import former
from cases.problems import MODELS
from xdynamics.record.schemas import NAMES_ROWS, as_written, modern


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

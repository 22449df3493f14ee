"""A run as a tree of plain tables, by the accessor and by the backend."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS

BALL = xd.Model.from_toml(MODELS / "bouncing_ball.toml")
PLANETS = MODELS / "outer_solar_system.toml"


@pytest.fixture(scope="module")
def run() -> xr.Dataset:
    """A ball that bounces twice."""
    return xd.simulate(BALL, until="1.4 s", method="dop853", rtol=1e-6)


def test_every_number_is_in_its_table(run: xr.Dataset, tmp_path: Path) -> None:
    """Assert that the nodes have all variables of the record, lazily too, and nothing else that is a number."""
    xd.save(run, tmp_path / "ball.nc")
    for tree in (run.dynamics.tree(), xr.open_datatree(tmp_path / "ball.nc", engine="xdynamics")):
        assert tree.groups == ("/", "/steps", "/trials", "/events", "/samples")
        found = {name: variable for node in tree.subtree for name, variable in node.dataset.variables.items()}
        assert {*run.variables} - {*found} == {"event_time_bounds"}
        for name, variable in run.variables.items():
            if name in found:
                assert np.array_equal(found[name].values, variable.values, equal_nan=variable.dtype.kind == "f"), name
        assert {*tree.dataset.data_vars} == set()
        assert tree.attrs["content_digest" if "content_digest" in tree.attrs else "run_outcome"]
        assert all(
            node.dataset[name].dims[0] in name_of(node) for node in tree.children.values() for name in node.data_vars
        )


def name_of(node: xr.DataTree) -> tuple[str, ...]:
    """Return the one dimension of a node."""
    return (str(node.name).removesuffix("s"),)


def test_tables_are_what_pandas_and_xarray_take(run: xr.Dataset) -> None:
    """Assert means, rows and data frames of nodes: a row for each event with both one-sided states."""
    tree = run.dynamics.tree()
    assert float(tree["steps"].dataset.mean().y) == float(run.y.mean())
    frame = tree["events"].dataset.to_dataframe()
    assert len(frame) == run.sizes["event"] == 2
    before, after = run.event_row_before.values, run.event_row_after.values
    assert frame.before_v_y.tolist() == run.v_y.values[before].tolist()
    assert frame.after_v_y.tolist() == run.v_y.values[after].tolist()
    assert frame.event_time_bounds_lower.tolist() == run.event_time_bounds.values[:, 0].tolist()
    assert tree["events"].dataset.before_v_y.attrs["units"] == "m s-1"
    assert len(tree["steps"].dataset.to_dataframe()) == run.sizes["step"]


def test_a_selection_says_nan_of_what_it_has_not(run: xr.Dataset) -> None:
    """Assert that states of events whose rows were left out are nan, and the others right."""
    late = run.isel(step=slice(int(run.event_row_after[0]), None)).dynamics.tree()["events"].dataset
    assert np.isnan(late.before_v_y.values).tolist() == [True, False]
    assert late.after_v_y.values.tolist() == run.v_y.values[run.event_row_after.values].tolist()


def test_elements_keep_their_labels() -> None:
    """Assert that a quantity along dimensions is selected by label in its node."""
    run = xd.simulate(xd.Model.from_toml(PLANETS), until="100 d", method="dop853", rtol=1e-6)
    tree = run.dynamics.tree()
    jupiter = tree["steps"].dataset.r.sel(body="Jupiter", axis="x")
    assert jupiter.values.tolist() == run.r.sel(body="Jupiter", axis="x").values.tolist()
    parameters = {name for name in run.coords if run[name].attrs.get("role") == "parameter"}
    assert parameters
    assert parameters <= {*tree.dataset.coords}


def test_a_node_is_opened_alone(run: xr.Dataset, tmp_path: Path) -> None:
    """Assert that xarray's word for a node of a file gives that table, and names what there is."""
    xd.save(run, tmp_path / "ball.nc")
    events = xr.open_dataset(tmp_path / "ball.nc", engine="xdynamics", group="/events")
    assert events.before_v_y.values.tolist() == run.v_y.values[run.event_row_before.values].tolist()
    with pytest.raises(xd.InputError, match="has no group 'event'; there are steps, trials, events, samples"):
        xr.open_dataset(tmp_path / "ball.nc", engine="xdynamics", group="event")


def test_rows_that_are_not_where_they_belong_are_named(run: xr.Dataset) -> None:
    """Assert one line for numbers of rows that were edited, and for rows that run backwards."""
    backwards = np.arange(run.sizes["step"])[::-1]
    with pytest.raises(xd.InputError, match="the row before event 'floor' at t = .* is at another time"):
        run.assign_coords(step_number=("step", backwards)).dynamics.events("floor")
    with pytest.raises(xd.InputError, match="the rows are not in the order of time"):
        run.isel(step=backwards).dynamics.at(0.1)

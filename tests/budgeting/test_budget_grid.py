"""Budgets over a grid: each member's own, bit for bit, lazily, with a figure and a table."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS

BALL = xd.Model.from_toml(MODELS / "ball_drag.toml")
ASKED: dict[str, Any] = {"rtol": 1e-8, "method": "dormand_prince"}
WANTED: dict[str, Any] = {"quantity": "t", "event": "ground", "without": "roundoff"}


@pytest.fixture(scope="module")
def sweep() -> xr.Dataset:
    """Balls thrown at two speeds, with two terminal speeds that are uncertain."""
    return xd.sweep(BALL, {"v_y": "10:20:2 m s-1", "vt": "20:40:2 m s-1"}, **ASKED)


def test_each_is_the_budget_of_its_member(sweep: xr.Dataset) -> None:
    """Assert every number of a member's budget against the budget of its model, bit for bit."""
    found = xd.error_budget(sweep, **WANTED)
    assert found.value.dims == ("v_y", "vt")
    assert found.standard_uncertainty.dims == ("v_y", "vt", "term")
    assert found.vt.attrs["units"] == "m s-1"
    for i, j in ((0, 1), (1, 0)):
        model = BALL.replace(initial={"v_y": float(sweep.v_y[i])}, parameters={"vt": float(sweep.vt[j])})
        alone, member = xd.error_budget(model, **WANTED, **ASKED), found.isel(v_y=i, vt=j)
        for name, one in alone.data_vars.items():
            if name in member and one.dtype.kind in "fi":
                np.testing.assert_array_equal(member[name].values, one.values, err_msg=str(name))
        assert str(member.result.values) == alone.attrs["result"]
    assert (found.physical_rss.diff("v_y") > 0.0).all()


def test_it_is_lazy_and_computed_part_by_part(sweep: xr.Dataset) -> None:
    """Assert dask arrays of all names and units before anything is marched, and one budget's tasks for one member."""
    lazy = xd.error_budget(sweep, compute=False, **WANTED)
    assert lazy.total_rss.chunks is not None
    assert lazy.term_name.values.tolist() == ["truncation", "interpolation", "event_location", "vt"]
    assert lazy.value.attrs["units"] == "s"
    one = float(lazy.total_rss.isel(v_y=1, vt=0))
    assert one == float(xd.error_budget(sweep, **WANTED).total_rss[1, 0])


def test_it_has_lines_a_table_and_figures(sweep: xr.Dataset) -> None:
    """Assert a row a member with the terms by name, a map of each total, and a band over one axis."""
    found = xd.error_budget(sweep, **WANTED)
    table = found.dynamics.table()
    assert len(table) == 4
    assert "standard_uncertainty[vt] [s]" in table.columns
    assert "physical vt" in repr(found.dynamics)
    titles = [axis.get_title(loc="left") for axis in xd.plot(found).axes if axis.get_title(loc="left")]
    assert titles == [
        "time of ground",
        *(f"{word} standard uncertainty" for word in ("numerical", "physical", "total")),
    ]
    band = xd.plot(found.isel(vt=0))
    assert [axis.get_title(loc="left") for axis in band.axes] == [
        "time of ground, vt = 20 m s-1",
        "terms; dashed: numerical",
    ]
    words = xd.sweep(BALL, {"method": ["heun", "rk4"]}, step="20 ms")
    points = xd.plot(xd.error_budget(words, **WANTED))
    assert [label.get_text() for label in points.axes[0].get_yticklabels()] == ["heun", "rk4"]


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "an unknown number": ({"quantity": "z"}, "quantity is 'z'; there are y, v_y"),
    "a setting": ({"step": 0.1}, "step cannot be given for a sweep, whose members have their settings"),
    "doubled draws": ({"until_uncertainty": "1 s at 95 %"}, "until_uncertainty cannot be given for a sweep"),
    "no such event": ({"event": "wall"}, "wall"),
    "an unknown term": ({"without": "noise"}, "noise"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_input_is_named(case: str, sweep: xr.Dataset) -> None:
    """Assert one clear error, before anything is marched."""
    more, words = WRONG[case]
    with pytest.raises(xd.InputError) as caught:
        xd.error_budget(sweep, **(WANTED | more))
    assert words in str(caught.value)

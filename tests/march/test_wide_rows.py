"""Logs whose rows have many numbers: these stand side by side, and the record does not show it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from xdynamics.march import March
from xdynamics.march.configuration import settings_for
from xdynamics.march.log import log_of

CHAIN = """
name = "chain"
[dimensions]
site = 26
[relations.spring]
of = "site"
neighbours = 1
[coordinates]
u = { unit = "mm", dims = ["site"] }
[mass]
u = "2*kilogram"
[forces.springs]
over = "spring"
potential = "kilogram/second**2*(second(u, spring) - first(u, spring))**2/2"
[initial]
u = "metre*sin(index(site))"
[observables]
stretch = "u[1] - u[0]"
"""
PASSAGE = """
[events.passage]
function = "u[3]"
direction = "either"
action = "record"
"""
ASKED: dict[str, dict[str, Any]] = {
    "all of a grid": {"method": "rk4", "step": "0.1 s", "until": "1 s", "force_samples": "all"},
    "events of chosen steps": {"method": "bogacki_shampine", "rtol": 1e-4, "atol": 1e-6, "until": "3 s"},
    "states": {"method": "velocity_verlet", "step": "0.1 s", "until": "1 s", "log": "states"},
    "one in three": {"method": "velocity_verlet", "step": "0.1 s", "until": "1 s", "keep_every": 3},
}


def test_numbers_of_a_row_stand_side_by_side() -> None:
    """Assert that a step writes one piece of memory, and that narrow rows keep their columns in one piece each."""
    wide, narrow = (xd.Model.from_text(CHAIN.replace("site = 26", f"site = {n}")) for n in (26, 5))
    for model, order in ((wide, "F"), (narrow, "C")):
        march = March(model, settings_for(model, method="velocity_verlet", step="0.1 s", until="1 s"))
        for block in march.blocks():
            assert block.log.rows.shape[1] > 10
            for table in (block.log.rows, block.log.samples):
                assert table.flags["F_CONTIGUOUS"] is (order == "F")
                assert table.flags["C_CONTIGUOUS"] is (order == "C")


@pytest.mark.parametrize("asked", ASKED.values(), ids=ASKED)
def test_a_record_does_not_show_the_order_of_its_log(asked: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a march, one stopped and gone on, and its lone columns have the bits that logs by columns give."""
    watched = asked["method"] == "bogacki_shampine"
    model = xd.Model.from_text(CHAIN + PASSAGE if watched else CHAIN)

    def runs() -> list[xr.Dataset]:
        half = xd.simulate(model, **asked)
        return [half, xd.extend(half, until="4 s")]

    usual = runs()
    assert (usual[0].sizes["event"] > 0) is watched
    assert usual[0].step_size.values.flags["C_CONTIGUOUS"]
    monkeypatch.setattr("xdynamics.march.log.is_wide", lambda _: False)
    for run, other in zip(usual, runs(), strict=True):
        assert set(run.variables) == set(other.variables)
        for name, values in run.variables.items():
            np.testing.assert_array_equal(values.values, other[name].values, strict=True)


@pytest.mark.parametrize("asked", ASKED.values(), ids=ASKED)
def test_rows_of_a_million_numbers_are_streamed_one_by_one(
    asked: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert that a stream of such rows has one log of one row, two where rows are left out, and the bits of others."""
    watched, rows = asked["method"] == "bogacki_shampine", list[int]()
    model = xd.Model.from_text(CHAIN + PASSAGE if watched else CHAIN)
    usual = xd.simulate(model, **asked, path=tmp_path / "usual.nc")

    def counted(layout: Any, settings: Any, count: int, *more: Any) -> Any:
        rows.append(count)
        return log_of(layout, settings, count, *more)

    monkeypatch.setattr("xdynamics.archive.segments.WIDE_NUMBERS", 1)
    monkeypatch.setattr("xdynamics.march.runner.log_of", counted)
    with usual, xd.simulate(model, **asked, path=tmp_path / "run.nc") as run:
        assert [count for count in rows if count] == [1] * (1 + ("keep_every" in asked))
        assert run.attrs["content_digest"] == usual.attrs["content_digest"]

"""Rows of a million numbers are put where the record has them, and their log is filled again."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from xdynamics.shapes.blocks import Block

CHAIN = """
name = "chain"
[dimensions]
site = 5
[relations.spring]
of = "site"
neighbours = 1
[coordinates]
u = { unit = "m", dims = ["site"] }
[mass]
u = "kilogram"
[forces.springs]
over = "spring"
potential = "kilogram/second**2*(second(u, spring) - first(u, spring))**2/2"
[initial]
u = "metre*sin(index(site))"
"""


def test_wide_columns_have_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that one row a block, in one log, and an extension behind it, give the record of many rows a block."""
    model = xd.Model.from_text(CHAIN)

    def runs() -> list[xr.Dataset]:
        half = xd.simulate(model, method="velocity_verlet", step="0.1 s", until="1 s", log="states")
        return [half, xd.extend(half, until="2 s")]

    usual = runs()
    monkeypatch.setattr("xdynamics.record.run_dataset.WIDE", 1)
    monkeypatch.setattr("xdynamics.march.runner.RECYCLED_NUMBERS", 1)
    for run, other in zip(usual, runs(), strict=True):
        assert run.sizes["step"] in (11, 21)
        for name, values in run.variables.items():
            np.testing.assert_array_equal(values.values, other[name].values, strict=True)


def test_elements_are_not_named_where_no_name_is_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that reading and marching makes no names of single elements: of 10^6 these take 150 MB each time."""
    named: list[str] = []
    elements = Block.elements
    monkeypatch.setattr(Block, "elements", lambda block: named.append(block.name) or elements(block))
    xd.simulate(xd.Model.from_text(CHAIN), method="velocity_verlet", step="0.1 s", until="0.2 s", log="states")
    assert named == []

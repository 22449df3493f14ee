"""Fields are marched without names of their elements, and without large arrays of what their Jacobians have where."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from xdynamics.kernels import layout_of
from xdynamics.kernels.newton_matrix import pattern_of
from xdynamics.march.configuration import settings_for

FIELD = """
name = "A rod of many cells"
[dimensions]
cell = {cells}
[parameters]
rate = "1 s-1"
[states.T]
unit = "K"
dims = ["cell"]
rate = "rate*(shift(T, cell, -1, 0*kelvin) - 2*T + shift(T, cell, 1, 0*kelvin))"
[initial]
T = "kelvin*sin(2*pi*index(cell)/1000)"
[run]
method = "radau_iia"
rtol = 1e-6
until = "0.5 s"
"""


def field(cells: int) -> xd.Model:
    """Return the model with a number of cells."""
    return xd.Model.from_text(FIELD.format(cells=cells))


@pytest.mark.parametrize("asked", [{}, {"atol": {"T": "1e-9 K"}}, {"atol": 1e-9}], ids=["none", "block", "bare"])
def test_a_march_makes_no_names_of_elements(asked: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a field is read, checked, marched by Radau and judged without the names of its cells."""

    def names(name: str, extents: tuple[object, ...]) -> Iterator[str]:
        assert not extents, f"the names of the elements of '{name}' are made"
        return iter([name])

    model = field(2000)
    monkeypatch.setattr("xdynamics.shapes.blocks.element_names", names)
    monkeypatch.setattr("xdynamics.shapes.extents.element_names", names)
    run = xd.simulate(model, **asked)
    assert run.sizes["step"] > 2
    assert run.attrs["run_outcome"] == "completed"


def test_a_tolerance_of_a_block_stays_one() -> None:
    """Assert that a tolerance of a whole field is one number, and that of an element beside it counts before."""
    model = field(2000)
    given = settings_for(model, atol={"T[3]": "1e-3 K", "T": "1e-9 K"}).tolerances
    assert given is not None
    assert dict(given.atol) == {"T": 1e-9, "T·3": 1e-3}
    assert (given.atol_of("T·3"), given.atol_of("T·4")) == (1e-3, 1e-9)
    atols = given.of_all(layout_of(model).used)
    assert atols[3] == 1e-3
    assert set(np.delete(atols, 3).tolist()) == {1e-9}


def test_a_tolerance_of_a_block_is_that_of_each_element(tmp_path: Path) -> None:
    """Assert the same record, which says the same tolerance, whether all elements are named or their block; and a rerun."""
    model = field(20)
    block = xd.simulate(model, atol={"T": "1e-9 K"})
    elements = xd.simulate(model, atol={f"T[{i}]": "1e-9 K" for i in range(20)})
    assert block.T.attrs["atol"] == elements.T.attrs["atol"] == 1e-9
    assert xd.content_digest(block) == xd.content_digest(elements)
    xd.save(block, tmp_path / "field.nc")
    assert xd.reproduce(tmp_path / "field.nc").attrs["identical"] == 1
    assert xd.simulate(model).sizes["step"] != block.sizes["step"]


def test_the_pattern_of_a_field_takes_few_bytes_a_cell() -> None:
    """Assert that the pattern of a tridiagonal Jacobian is 24 bytes a cell and is found in at most 160 (340 in 64 bits)."""
    cells = 100_000
    layout = layout_of(field(cells))
    tracemalloc.start()
    try:
        pattern = pattern_of(layout)
        held, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(pattern.entries) == 3 * cells - 2
    assert pattern.entries.nbytes == 8 * len(pattern.entries)
    assert held < 32 * cells
    assert peak < 160 * cells

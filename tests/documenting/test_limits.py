"""Limits that pages of help name are those of the code."""

from __future__ import annotations

from xdynamics.documenting.guide import FILES
from xdynamics.documenting.manual_pages import GRIDS_PAGE
from xdynamics.march.simd_ensemble import LARGEST_ROW
from xdynamics.model.file_access import LARGEST, LARGEST_RECORDED, LARGEST_TABLE, MOST_RECORDED, MOST_VALUES
from xdynamics.model.model import LARGEST_FILE


def test_limits_of_tables_and_model_files() -> None:
    """Assert the sizes in `xdynamics help files`."""
    table, file, text = (f"{limit / 1e6:g} MB" for limit in (LARGEST_TABLE, LARGEST_FILE, LARGEST_RECORDED))
    page = " ".join(FILES.split())
    assert LARGEST == LARGEST_FILE
    assert f"A table may have {table}" in page
    assert f"a model file {file} and {MOST_VALUES:,} numbers" in page
    assert f"may have {text} and {MOST_RECORDED:,} numbers" in page


def test_limits_of_runs_side_by_side() -> None:
    """Assert the width in `xdynamics help grids`."""
    assert f"over {LARGEST_ROW:,} numbers a row" in " ".join(GRIDS_PAGE.split())

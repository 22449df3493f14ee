"""Reports that are one file: HTML that needs no other, PDF with a page a record."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS

BALL = xd.Model.from_toml(MODELS / "ball_drag.toml")


@pytest.fixture(scope="module")
def run() -> xr.Dataset:
    """A ball."""
    return xd.simulate(BALL, rtol=1e-6)


def test_a_plain_run_is_one_page_of_html(run: xr.Dataset, tmp_path: Path) -> None:
    """Assert the figure inside the page, summary and digest, no link to another file, and the same bytes twice."""
    words = xd.report(tmp_path / "r.html", run=run)
    page = (tmp_path / "r.html").read_text()
    assert xd.content_digest(run) in words
    assert xd.content_digest(run) in page
    assert "event     ground at t = " in page
    assert page.count("data:image/png;base64,") == 1
    assert not re.search(r'(src|href)="(?!data:)', page)
    assert [path.name for path in tmp_path.iterdir()] == ["r.html"]
    xd.report(tmp_path / "again.html", run=run)
    assert (tmp_path / "again.html").read_bytes() == (tmp_path / "r.html").read_bytes()


def test_stages_are_computed_and_have_a_page_each(run: xr.Dataset, tmp_path: Path) -> None:
    """Assert a PDF of as many pages as records, of a run, a lazy budget, and refinements by name."""
    study = xd.refine(BALL, method="midpoint", steps=["40 ms", "20 ms", "10 ms"], until="1 s")
    records: dict[str, Any] = {
        "run": run,
        "budget": xd.error_budget(BALL, "t", event="ground", compute=False),
        "refinements": {"midpoint": study},
    }
    xd.report(tmp_path / "r.pdf", **records)
    content = (tmp_path / "r.pdf").read_bytes()
    assert content.startswith(b"%PDF")
    assert len(re.findall(rb"/Type /Page\b", content)) == 3
    xd.report(tmp_path / "again.pdf", **records)
    assert (tmp_path / "again.pdf").read_bytes() == content


def test_what_cannot_be_written_is_said_before_anything_is_computed(run: xr.Dataset, tmp_path: Path) -> None:
    """Assert an error for a folder that is missing, a directory of that name, no record, and a stage that fails."""
    (tmp_path / "d.html").mkdir()
    for path, records, words in (
        (tmp_path / "none" / "r.html", {"run": run}, "cannot be written: the folder"),
        (tmp_path / "d.html", {"run": run}, "is a directory"),
        (tmp_path / "r.pdf", {}, "report needs at least one record"),
        (tmp_path / "r.pdf", {"run": 3}, "'run' is '3', needs a run, evidence"),
    ):
        with pytest.raises(xd.InputError, match=words):
            xd.report(path, **records)
    assert [path.name for path in tmp_path.iterdir()] == ["d.html"]

"""The files of a sweep's whole runs: written alike, checked once in full a block, never left broken."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.problems import MODELS, oscillator
from cases.verdicts import verified
from xdynamics.archive import writing

MODEL = oscillator().model
ASKED: dict[str, Any] = {"keep": ["log"], "method": "rk4", "step": 0.1, "until": 1.0}


@pytest.mark.dear
def test_one_file_of_a_block_is_read_again_in_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert one full reading a block, and that all members are files that verify."""
    compared: list[str] = []
    compare = writing.compare_file
    monkeypatch.setattr(
        writing, "compare_file", lambda *given: compared.append(given[0].parent.name) or compare(*given)
    )
    grid = xd.sweep(MODEL, {"k": "1:2:10 N m-1"}, path=tmp_path / "grid", members_per_task=5, **ASKED)
    assert compared.count("runs") == 2
    assert len({verified(tmp_path / "grid" / str(name)) for name in grid.run_file.values}) == 10


def test_what_is_written_otherwise_than_given_is_no_member(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a library which writes other numbers is found out before any file of the block has its name."""
    digests = writing.Writer.digests
    monkeypatch.setattr(writing.Writer, "digests", lambda self: digests(self) | {"x": "0" * 64})
    with pytest.raises(
        xd.ArchiveError, match="cannot be written: what was written reads otherwise: variable 'x' differs"
    ):
        xd.sweep(MODEL, {"k": "1:2:4 N m-1"}, path=tmp_path / "grid", members_per_task=4, **ASKED)
    assert not list((tmp_path / "grid" / "runs").glob("[!.]*.nc"))


@pytest.mark.dear
def test_what_is_read_of_the_calendar_stays_with_the_numbers_alone(tmp_path: Path) -> None:
    """Assert that a member's model reads the units of the calendar that a model read anew from its text does."""
    model = xd.Model(
        name="yearly",
        coordinates={"x": {"unit": "m"}},
        parameters={"m": "1 kg", "F": "1 N"},
        mass={"x": "m"},
        forces={"push": {"x": "F*cos(2*pi*t/year)"}},
        initial={"x": "0 m", "v_x": "0 m s-1"},
    )
    changed = model.replace(parameters={"F": "2 N"})
    assert changed.statement.calendar == xd.Model.from_text(changed.to_toml()).statement.calendar == ("year",)
    grid = xd.sweep(model, {"F": "1, 2 N"}, path=tmp_path, **ASKED)
    run = xd.member(grid, F=2.0)
    assert np.array_equal(run.x, xd.simulate(changed, method="rk4", step=0.1, until=1.0).x)
    rocket = xd.Model.from_toml(MODELS / "rocket_c6.toml")
    assert rocket.replace(parameters={"airframe": "45 g"}).statement.calendar == ()

"""The content digest of a sweep: of what was marched, not of when, where and how often it was begun."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import dask
import pytest

import xdynamics as xd
from cases.odd import changed
from cases.problems import MODELS
from cases.verdicts import verified
from xdynamics.sweeping import catalogue
from xdynamics.sweeping.catalogue import verify_sweep
from xdynamics.sweeping.members import march_block

AXES = {"vt": "20:40:4 m s-1"}
ASKED: dict[str, Any] = {"keep": ["end", "log"], "method": "heun", "rtol": 1e-6, "members_per_task": 1}


def swept(path: Path) -> str:
    """March a sweep with whole logs into a folder; return its content digest."""
    with dask.config.set(scheduler="synchronous"):
        xd.sweep(xd.Model.from_toml(MODELS / "ball_drag.toml"), AXES, path=path, **ASKED).close()
    return verified(path)


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sweep that was marched without a break."""
    path = tmp_path_factory.mktemp("first") / "sweep"
    swept(path)
    return path


@pytest.mark.dear
def test_two_laboratories_have_one_digest(first: Path, tmp_path: Path) -> None:
    """Assert that a sweep marched again has other bytes, other seals of its files, and the same content digest."""
    time.sleep(1.1)  # dates have seconds
    digest = swept(tmp_path / "second")
    with xd.open_sweep(first) as one, xd.open_sweep(tmp_path / "second") as other:
        assert (one.run_seal.values != other.run_seal.values).all()
        assert (one.run_digest.values == other.run_digest.values).all()
    assert digest == verified(first)


@pytest.mark.dear
def test_a_resumed_sweep_has_the_digest_of_the_whole(
    first: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert the digest of the uninterrupted sweep, for what was broken off between its blocks."""
    left = [2]

    def breaking(plan: Any, block: Any) -> Any:
        left[0] -= 1
        if left[0] < 0:
            raise KeyboardInterrupt
        return march_block(plan, block)

    monkeypatch.setattr(catalogue, "march_block", breaking)
    with pytest.raises(KeyboardInterrupt):
        swept(tmp_path / "s")
    monkeypatch.undo()
    assert len(list((tmp_path / "s" / "runs").iterdir())) == 2
    assert swept(tmp_path / "s") == verified(first)


@pytest.mark.dear
def test_seals_of_files_are_among_the_circumstances(first: Path, tmp_path: Path) -> None:
    """Assert that another seal of a run's file is another digest of circumstances, and one by itself is damage."""
    path = first / "catalogue.nc"

    def other(found: Any) -> None:
        found["run_seal"][0] = "0" * 64

    again = changed(path, tmp_path / "other.nc", other)
    with xd.open_run(path) as one, xd.open_run(again) as two:
        assert one.attrs["content_digest"] == two.attrs["content_digest"]
        assert one.attrs["volatile_digest"] != two.attrs["volatile_digest"]
    said = f"runs/.*: its seal is [0-9a-f]{{64}}, in the catalogue {'0' * 64}"
    path.write_bytes(again.read_bytes())
    with pytest.raises(xd.ArchiveError, match=said):
        verify_sweep(first)


THINNED: dict[str, Any] = {"keep_every": 5, "log": ["y", "kinetic_energy"], "compress": True}


@pytest.mark.dear
def test_whole_runs_are_recorded_as_asked(first: Path, tmp_path: Path) -> None:
    """Assert that files are those of `simulate` with the same words, all else that is kept is of every row, and a member comes again."""
    model = xd.Model.from_toml(MODELS / "ball_drag.toml")
    with dask.config.set(scheduler="synchronous"):
        found = xd.sweep(model, AXES, path=tmp_path / "thin", **ASKED, **THINNED)
    alone = model.replace(parameters={"vt": "20 m s-1"})
    run = xd.simulate(alone, method="heun", rtol=1e-6, **THINNED)
    with xd.member(found, vt="20 m s-1") as one:
        assert xd.content_digest(one) == xd.content_digest(run) == str(found.run_digest.values[0])
        assert one.sizes["step"] == run.sizes["step"] < found.run_accepted_steps.values[0]
    moved = found.load().copy()
    moved.encoding.clear()
    assert xd.content_digest(xd.member(moved, vt="20 m s-1")) == xd.content_digest(run)
    with xd.open_sweep(first) as whole:
        assert found.end_y.identical(whole.end_y)
        assert (found.run_digest.values != whole.run_digest.values).all()
    assert xd.sweep(found, keep=["end"]).end_y.identical(found.end_y)


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (
            {"keep_every": 5},
            r"keep_every says how whole runs are recorded, and keep has none: add 'log' to keep with path=",
        ),
        (
            {"log": "states", "compress": True},
            r"log and compress say how .* or leave log and compress out; what else is",
        ),
        ({"keep": ["log"], "keep_every": 0}, r"keep_every is 0, needs a whole number from 1"),
        ({"keep": ["log"], "log": ["none"]}, r"log names 'none', which is no column of this run's log"),
    ],
)
def test_words_on_records_that_mean_nothing_are_refused(asked: dict[str, Any], words: str, tmp_path: Path) -> None:
    """Assert one line, and that nothing is marched or written."""
    model = xd.Model.from_toml(MODELS / "ball_drag.toml")
    with pytest.raises(xd.InputError, match=words):
        xd.sweep(model, AXES, path=tmp_path / "s", method="heun", rtol=1e-6, **asked)
    assert not (tmp_path / "s").exists()

"""Opening archives without looking at their digests, and again later."""

from __future__ import annotations

import pickle
import shutil
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import oscillator
from cases.verdicts import verified
from xdynamics import schema
from xdynamics.archive import reading, seals
from xdynamics.archive.integrity_checks import Examination
from xdynamics.archive.seals import Tail
from xdynamics.archive.shared_handles import is_still_read
from xdynamics.evidence import evidence_dataset


@pytest.fixture(scope="module")
def archived(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One archive for all tests that only read."""
    path = tmp_path_factory.mktemp("reading") / "run.nc"
    return xd.save(xd.simulate(oscillator().model, step=0.1, until=1.0), path)


def test_what_is_no_archive_is_refused_unchecked_too(archived: Path, tmp_path: Path) -> None:
    """Assert one error with the path for text, a cut file, a foreign record and nothing at all."""
    path = tmp_path / "no.nc"
    with pytest.raises(xd.InputError, match="does not exist"):
        xd.open_run(path, check=False)
    for content in (b"time,y\n0,1\n", archived.read_bytes()[:5000]):
        path.write_bytes(content)
        with pytest.raises(xd.ArchiveError, match=r"no\.nc' (cannot be opened as a|is damaged or no) run archive"):
            xd.open_run(path, check=False)
    xr.Dataset({"a": ("n", [1.0])}).to_netcdf(tmp_path / "foreign.nc", engine="netcdf4")
    with pytest.raises(xd.ArchiveError, match="is as it was written, but no run record") as caught:
        xd.open_run(tmp_path / "foreign.nc", check=False)
    assert not is_still_read(tmp_path / "foreign.nc"), caught  # though the error still knows of it


def test_values_that_cannot_be_read(archived: Path, tmp_path: Path) -> None:
    """Assert that a file that was opened unchecked and cannot be read says which of its variables, of which file."""
    path = tmp_path / "hurt.nc"
    path.write_bytes(archived.read_bytes().replace(b"TREE", b"tree"))  # where the library looks for the chunks
    with pytest.raises(xd.ArchiveError, match=r"^variable '\w+' of '.*hurt\.nc' cannot be read: NetCDF: HDF error"):
        xd.open_run(path, check=False).load()


@pytest.mark.parametrize(
    ("step", "said"), [("open_shared", "cannot be opened as a run archive: "), ("faults_of", "no run record:\n  1. ")]
)
def test_an_error_without_words_has_a_name(
    archived: Path, monkeypatch: pytest.MonkeyPatch, step: str, said: str
) -> None:
    """Assert that memory that is full is told as such, while a file is opened and while it is looked at."""

    def full(*_: object, **__: object) -> None:
        raise MemoryError

    monkeypatch.setattr(reading, step, full)
    with pytest.raises(xd.ArchiveError, match=f"{said}MemoryError$"):
        xd.open_run(archived)


def test_an_opened_run_is_the_run_that_was_saved(archived: Path) -> None:
    """Assert that what is said of the file alone is not said of the run, and its digest is."""
    with xd.open_run(archived, check=False) as run:
        assert set(run.attrs) - set(xd.simulate(oscillator().model, step=0.1, until=1.0).attrs) == {
            "content_digest",
            "volatile_digest",
            "variable_digests",
        }
        assert run.attrs["content_digest"] == verified(archived)


def test_a_flag_of_one_word_keeps_the_dimension_of_its_values(archived: Path) -> None:
    """Assert that the one number of a regime comes back as an array, as it was, and that the copy has the same digest."""
    with xd.open_run(archived) as run:
        assert run.regime.attrs["flag_values"].shape == (1,)
        assert verified(xd.save(run, archived.with_name("copy.nc"))) == verified(archived)


def test_values_are_looked_up_where_the_file_is_still_the_same(archived: Path, tmp_path: Path) -> None:
    """Assert that a sent selection is compared with its file, and not where another record took its name."""
    path = Path(shutil.copy(archived, tmp_path / "run.nc"))
    with xd.open_run(path) as run:
        rows = pickle.loads(pickle.dumps(run.isel(step=slice(0, 3)).load()))
    xd.save(rows, tmp_path / "rows.nc")
    xd.save(xd.simulate(oscillator().model, step=0.05, until=1.0), path)
    with pytest.raises(xd.InputError, match="no longer at hand"):
        xd.save(rows, tmp_path / "more.nc")
    path.unlink()
    with pytest.raises(xd.InputError, match="no longer at hand"):
        xd.save(rows, tmp_path / "more.nc")


@pytest.mark.parametrize(
    ("fault", "replaced", "looks"),
    [("", False, 1), ("", True, 1), ("hurt", False, 1), ("hurt", True, reading.MOST_REPLACED)],
)
def test_a_file_is_examined_again_only_if_it_is_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: str, *, replaced: bool, looks: int
) -> None:
    """Assert one look at a file that is whole or hurt, and some more at one of whose name others take hold all the time."""
    path, looked = tmp_path / "run.nc", []
    path.write_text("some bytes")

    def examined(path: Path, _tail: Tail) -> Examination:
        looked.append(path)
        if replaced:
            path.write_text("n" * len(looked))
        return Examination((fault,) if fault else (), "digest")

    monkeypatch.setattr(reading, "examine_sandboxed", examined)
    with pytest.raises(xd.ArchiveError, match="1. hurt") if fault else nullcontext():
        assert reading.verify_digests(path).digest == "digest"
    assert len(looked) == looks


def test_a_file_is_hashed_once_to_be_verified(archived: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that what was just verified is opened without another look at its bytes."""
    digest, hashed = seals._file_digest, []
    monkeypatch.setattr(seals, "_file_digest", lambda path, size: hashed.append(path) or digest(path, size))
    xd.verify(archived)
    assert hashed == [archived]


@pytest.mark.dear
def test_a_run_is_opened_in_chunks(archived: Path) -> None:
    """Assert dask arrays of the wanted sizes, of those in the file for none, and the digest of the whole run."""
    whole = xd.open_run(archived)
    for chunks, sizes in (({"step": 4}, (4, 4, 3)), ({}, (11,)), ("auto", (11,)), (6, (6, 5))):
        run = xd.open_run(archived, chunks=chunks)
        assert run.x.chunks == (sizes,)
        assert xd.content_digest(run) == xd.content_digest(whole)
        assert run.x.values.tobytes() == whole.x.values.tobytes()
    assert whole.x.chunks is None


@pytest.mark.parametrize(
    ("chunks", "message"),
    [
        ({"steps": 4}, "chunks name 'steps'; there are step"),
        ({"step": 0}, r"chunks are \{'step': 0\}, need rows by dimension"),
        ({"step": -1}, "need rows by dimension"),
        ({"step": 2.5}, "need rows by dimension"),
        ({"step": True}, "need rows by dimension"),
        ("many", "chunks are 'many', need rows"),
        ([3], r"chunks are \[3\], need rows"),
        (0, "chunks are 0, need rows"),
    ],
)
def test_chunks_that_cannot_be_made_are_refused(archived: Path, chunks: Any, message: str) -> None:
    """Assert one line that shows them."""
    with pytest.raises(xd.InputError, match=message):
        xd.open_run(archived, chunks=chunks)


def test_an_archive_of_a_newer_schema_is_not_taken_for_one_of_this(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert one line with the remedies for a run, evidence and both kinds of sweep that a later version wrote."""
    paths = [tmp_path / name for name in ("run.nc", "study.nc", "grid", "grid.zarr")]
    asked: dict[str, Any] = {"method": "rk4", "until": 0.2}
    with monkeypatch.context() as patch:
        for module in (schema, evidence_dataset, reading):
            patch.setattr(module, "SCHEMA_VERSION", "4")
        xd.save(xd.simulate(oscillator().model, step=0.1, **asked), paths[0])
        xd.save(xd.refine(oscillator().model, steps=[0.1, 0.05], **asked), paths[1])
        for path in paths[2:]:
            xd.sweep(oscillator().model, {"k": "1:2:2 N m-1"}, step=0.1, path=path, **asked)
    for path, verb in zip(paths, [xd.open_run] * 2 + [xd.open_sweep] * 2, strict=True):
        with pytest.raises(xd.ArchiveError, match=r"schema 4, written by xdynamics .* reads schemas up to 2: install"):
            verb(path)
    with xd.open_run(paths[0], check=False) as run:
        assert run.attrs["schema_version"] == "4"

"""Opening archives without looking at their digests, and again later.

Elements of stored variables chosen by their numbers: NumPy's answer, by few reads, and the same runs opened and in memory.
Values of archives as xarray asks for them: what is stored, and of that what is asked for.
"""

from __future__ import annotations

import pickle
import shutil
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import oscillator
from cases.verdicts import verified
from xdynamics import schema
from xdynamics.archive import reading, seals
from xdynamics.archive.integrity_checks import Examination
from xdynamics.archive.netcdf_library import opened_file
from xdynamics.archive.seals import Tail
from xdynamics.archive.shared_handles import SharedArchive, is_still_read
from xdynamics.archive.stored_values import StoredValues, VariableStore, read_elements


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
        for module in (schema, reading):
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


class Watched:
    """A variable of a file that keeps what is asked of it."""

    def __init__(self, variable: Any) -> None:
        self._variable = variable
        self.keys: list[tuple[Any, ...]] = []
        self.read = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._variable, name)

    def __getitem__(self, key: tuple[Any, ...]) -> Any:
        self.keys.append(key)
        found = self._variable[key]
        self.read += np.size(found)
        return found


def any_key(rng: np.random.Generator, shape: tuple[int, ...]) -> tuple[Any, ...]:
    """A number, a slice or a list for each dimension."""
    key: list[Any] = []
    for length in shape:
        kind = rng.integers(4)
        if kind == 0:
            key.append(int(rng.integers(length)))
        elif kind == 1:
            first, last = sorted(rng.integers(0, length + 1, 2).tolist())
            key.append(slice(first, last, int(rng.integers(1, 4))))
        else:
            rows = rng.integers(-length, length, rng.integers(0, 12))
            key.append(np.sort(rows % length) if kind == 2 else rows)
    return tuple(key)


@pytest.mark.cases(400)
def test_any_choice_is_that_of_numpy(case: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that numbers, slices and lists choose what they choose of an array, whatever the chunks and the stretches."""
    rng = np.random.default_rng(case)
    shape = tuple(rng.integers(1, 40, rng.integers(1, 4)).tolist())
    values = rng.integers(0, 120, shape).astype(rng.choice(["f8", "i1", "i8"]))
    chunks = None if case % 3 == 0 else [int(rng.integers(1, length + 1)) for length in shape]
    monkeypatch.setattr("xdynamics.archive.stored_values.LARGEST", int(rng.integers(1, 4000)))
    with opened_file(tmp_path / "any.nc", "w") as file:
        names = [file.createDimension(f"d{i}", length).name for i, length in enumerate(shape)]
        stored = file.createVariable("any", values.dtype, names, chunksizes=chunks, contiguous=chunks is None)
        stored.set_auto_maskandscale(False)
        stored[...] = values
        for _ in range(5):
            key, watched = any_key(rng, shape), Watched(stored)
            expected = values
            for axis in reversed(range(len(shape))):  # one dimension after the other: each list along its own
                expected = expected[(slice(None),) * axis + (key[axis],)]
            found = np.asarray(read_elements(watched, key))
            assert (found.dtype, found.shape) == (expected.dtype, expected.shape)
            assert np.array_equal(found, expected)
            assert not any(isinstance(one, np.ndarray) for each in watched.keys for one in each)


def test_few_rows_of_a_long_run_cost_few_reads(tmp_path: Path) -> None:
    """Assert that neighbours are read together, and what lies between far rows is not read."""
    with opened_file(tmp_path / "long.nc", "w") as file:
        file.createDimension("step", 1_000_000)
        stored = file.createVariable("y", "f8", ("step",), chunksizes=[1000])
        stored[:] = np.arange(1e6)
        near, far = Watched(stored), Watched(stored)
        read_elements(near, (np.arange(0, 5000, 7),))
        read_elements(far, (np.array([999_999, 0, 1, 500_000]),))
    assert (len(near.keys), near.read) == (1, 4999)
    assert (len(far.keys), far.read) == (3, 4)


def test_a_row_beyond_the_end_is_an_error(tmp_path: Path) -> None:
    """Assert that it is named, and is not the last one."""
    with opened_file(tmp_path / "short.nc", "w") as file:
        file.createDimension("step", 4)
        stored = file.createVariable("y", "f8", ("step",))
        stored[:] = np.arange(4.0)
        with pytest.raises(IndexError, match="index 4 is out of bounds for a dimension of 4"):
            read_elements(stored, (np.array([1, 4]),))


TABLE = np.arange(12, dtype="i2").reshape(4, 3)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A file whose variables ask for more than to be read."""
    with opened_file(tmp_path / "odd.nc", "w") as file:
        file.createDimension("n", 4)
        file.createDimension("m", 3)
        scaled = file.createVariable("scaled", "i2", ("n", "m"), fill_value=5)
        scaled.set_auto_maskandscale(False)
        scaled[:] = TABLE
        scaled.setncatts({"scale_factor": 10.0, "units": "m"})
        text = file.createVariable("text", "S1", ("n",))
        text[:] = np.frombuffer("größ".encode()[:4], "S1")
        text.setncattr("_Encoding", "utf-8")
    return tmp_path / "odd.nc"


def test_values_are_those_that_are_stored(path: Path) -> None:
    """Assert that no scale is applied, nothing is masked, and letters stay apart."""
    one = SharedArchive(path)
    store = VariableStore(one, mode="r")
    found = store.open_store_variable("scaled", store.ds.variables["scaled"])
    assert (found.dims, found.shape, found.dtype, found.attrs["units"]) == (("n", "m"), (4, 3), np.dtype("i2"), "m")
    assert "chunksizes" in found.encoding
    text = store.open_store_variable("text", store.ds.variables["text"])
    for _ in range(2):
        values = found.values
        assert type(values) is np.ndarray
        assert values.tolist() == TABLE.tolist()
        assert text.values.tobytes() == "größ".encode()[:4]
        one.close()  # and opened again, by nobody that xarray knows


def test_only_what_is_asked_for_is_read(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that rows and columns are chosen by the library, and points of the little that it read."""
    keys = []
    read = StoredValues._read_by_key
    monkeypatch.setattr(StoredValues, "_read_by_key", lambda one, key: keys.append(key) or read(one, key))
    store = VariableStore(SharedArchive(path), mode="r")
    array = xr.DataArray(store.open_store_variable("scaled", store.ds.variables["scaled"]))
    assert keys == []
    assert array[1:3, 0].values.tolist() == TABLE[1:3, 0].tolist()
    assert array[[3, 1], [0, 2]].values.tolist() == TABLE[np.ix_([3, 1], [0, 2])].tolist()
    assert len(keys) == 2
    assert keys[0] == (slice(1, 3, 1), 0)
    assert [np.size(one) for one in keys[1]] == [2, 2]

"""How a new file is checked before it takes its name, and which name that is.

A file while it is filled: what is defined, given and read back, and how much room it takes.
A march straight into a file: how many rows at a time, and what is known of its length beforehand.
Many archives that reach the disk together: each whole or not at all.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import netCDF4
import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS, oscillator
from cases.verdicts import verified
from xdynamics.archive import segments, target, writing
from xdynamics.archive.integrity_checks import Examination
from xdynamics.archive.sandboxed_reading import is_known
from xdynamics.archive.seals import CHUNKS, OTHER_CHUNK, tail_of
from xdynamics.archive.writing import Writer
from xdynamics.march import March
from xdynamics.march.configuration import settings_for
from xdynamics.schema import BOUNDS, EVENTS, SAMPLES, STEPS, TRIALS


@pytest.fixture(scope="module")
def run() -> xr.Dataset:
    """A small run."""
    return xd.simulate(oscillator().model, step=0.1, until=1.0)


@pytest.mark.parametrize("stem", ["run", "n" * 252, "ä" * 126])
def test_a_name_beside_is_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stem: str) -> None:
    """Assert that a name is free or a bad end's, keeps its ending and is no longer than names may be."""
    path, ends = tmp_path / f"{stem}.nc", {}
    monkeypatch.setattr(writing, "examine_sandboxed", lambda path, _tail: Examination((), "", ends[path]))
    assert writing.partial_run_location(path) == path
    path.touch()
    ends[path] = "interrupted"
    assert writing.partial_run_location(path) == path
    ends[path] = "completed"
    other = writing.partial_run_location(path)
    room = len(os.fsencode(stem)) + len(".partial.nc") - len(os.fsencode(other.name))
    assert (len(os.fsencode(other.name)) <= 255, 0 <= room < 14) == (True, True)
    assert other.name.endswith(".partial.nc")
    assert other.name[:100] == path.name.removesuffix(".nc")[:100] or stem == "run"
    if stem == "run":
        other.touch()
        ends[other] = "completed"
        assert writing.partial_run_location(path).name == "run.partial.partial.nc"


def test_what_reads_otherwise_takes_no_name(run: xr.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a new file is compared with what was written before it takes its name."""
    monkeypatch.setattr(writing, "compare_file", lambda *_: Examination(("a is other", "b is other")))
    with pytest.raises(xd.ArchiveError, match="what was written reads otherwise: a is other; b is other"):
        xd.save(run, tmp_path / "run.nc")
    assert list(tmp_path.iterdir()) == []


def test_a_large_file_is_opened_only(run: xr.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a file over the limit is not read again, a smaller one is, and that both are known from then on."""
    compare, read = writing.compare_file, []
    monkeypatch.setattr(writing, "compare_file", lambda *given: read.append(given) or compare(*given))
    small = xd.save(run, tmp_path / "small.nc")
    size = small.stat().st_size
    for limit, looks in ((size, 2), (size - 1, 2)):
        monkeypatch.setattr(writing, "READ_BACK", limit)
        path = xd.save(run, tmp_path / f"{limit}.nc")
        assert path.stat().st_size == size
        assert len(read) == looks
        assert is_known(tail_of(path))


def test_what_lies_along_the_steps_says_when(run: xr.Dataset, tmp_path: Path) -> None:
    """Assert that variables along a dimension name its times as their coordinate, and one of them all that describes the run."""
    xd.save(run, tmp_path / "saved.nc")
    xd.simulate(oscillator().model, step=0.1, until=1.0, path=tmp_path / "streamed.nc").close()
    times = {"step": "time", "event": "event_time", "trial": "trial_time", "sample": "sample_time"}
    along = {
        str(name): times[str(variable.dims[0])]
        for name, variable in run.variables.items()
        if variable.dims[:1] != () and variable.dims[0] in times and name != times[str(variable.dims[0])]
    }
    along |= {"step_size": "time step_number m k", "model_toml": "force_source", "force_source": "model_toml"}
    for name in ("saved", "streamed"):
        with netCDF4.Dataset(tmp_path / f"{name}.nc") as file:
            found = {
                variable.name: variable.coordinates
                for variable in file.variables.values()
                if "coordinates" in variable.ncattrs()
            }
        assert found == along


@pytest.mark.parametrize("what", [5, "run.nc", {"x": np.zeros(3)}, xr.DataArray([1.0])])
def test_what_is_no_dataset_is_told(tmp_path: Path, what: object) -> None:
    """Assert one sentence with the beginning of what was given."""
    with pytest.raises(xd.InputError, match="a run record is to be saved, got .") as caught:
        xd.save(what, tmp_path / "no.nc")
    assert len(str(caught.value)) < 80


def test_derived_data_are_a_record(run: xr.Dataset, tmp_path: Path) -> None:
    """Assert that what was made from a run is looked at as a run is, values too."""
    turned = run.assign_coords(time=run.time.copy(data=run.time.values[::-1].copy()))
    for derived in (None, "turned round"):
        with pytest.raises(xd.InputError, match="it must increase"):
            xd.save(turned, tmp_path / "no.nc", derived=derived)


def test_derived_data_of_nothing_known(run: xr.Dataset, tmp_path: Path) -> None:
    """Assert that data say so whose run is not known, and how they were made, blanks around it left out."""
    unknown = run.assign_attrs(origin="lost")
    kept = xd.open_run(xd.save(unknown, tmp_path / "derived.nc", derived=" made up "))
    assert (kept.attrs["derived"], kept.attrs["derived_from"]) == ("made up", "unknown")


@pytest.mark.parametrize(
    ("text", "tables"),
    [
        ('[drives.a]\ncsv = "t,a"\n[drives.b]\ncsv = 5\n[drives.c]\nvalue = "1"\n', ["t,a", "5"]),
        ("[model]\n", []),
        ("no = ", []),
        ("drives = 5\n", []),
        ("[drives]\na = 5\n", []),
        ("a = " + "[" * 5000, []),
    ],
)
def test_tables_are_found_in_any_text(text: str, tables: list[str]) -> None:
    """Assert the texts of tables, and none of what is no model; derived data may hold anything."""
    assert writing._table_texts(xr.Dataset({"model_toml": ((), text)})) == tables
    assert writing._table_texts(xr.Dataset()) == []


def test_one_element_of_a_run_is_no_run(tmp_path: Path) -> None:
    """Assert that a run of one element is said to be cut, and not that attributes of all elements are no numbers."""
    run = xd.simulate(
        xd.Model(
            name="two",
            dimensions={"body": ["a", "b"]},
            coordinates={"u": {"unit": "m", "dims": ["body"]}},
            parameters={"m": {"dims": ["body"], "value": [1.0, 2.0], "unit": "kg", "uncertainty": [0.1, 0.2]}},
            mass={"u": "m"},
            initial={"u": "1 m"},
        ),
        method="rk4",
        step="1 s",
        until="1 s",
    )
    with pytest.raises(xd.InputError, match="the run was cut: it has a single one of its 2 elements along 'body'"):
        xd.save(run.sel(body="b"), tmp_path / "b.nc")


FLOAT = np.dtype("f8")


@pytest.fixture
def file(tmp_path: Path) -> Iterator[netCDF4.Dataset]:
    """An empty file."""
    with netCDF4.Dataset(tmp_path / "run.nc", "w", format="NETCDF4") as file:
        yield file


def filled(file: netCDF4.Dataset, rows: int) -> Writer:
    """Fill a file with a variable of steps, one of pairs, a number and a text."""
    made = Writer(file)
    made.define("x", (STEPS,), FLOAT, {"units": "m", "coordinates": "no"}, {})
    made.define("pairs", (EVENTS, BOUNDS), FLOAT, {}, {EVENTS: 3})
    made.define("g", (), FLOAT, {}, {})
    made.define("text", (), np.dtype(object), {}, {})
    for name, values in (("x", np.arange(rows, dtype=float)), ("pairs", np.ones((3, 2))), ("g", np.array(9.8))):
        made.append(name, values)
    made.append("text", np.array("größer", dtype=object))
    return made


def test_what_may_grow_and_what_not(file: netCDF4.Dataset) -> None:
    """Assert dimensions and chunks: whole ones for what may grow, as many rows as there are for what may not."""
    filled(file, 5)
    assert [(dimension.name, len(dimension), dimension.isunlimited()) for dimension in file.dimensions.values()][
        :3
    ] == [
        (STEPS, 5, True),
        (EVENTS, 3, False),
        (BOUNDS, 2, False),
    ]
    assert [file[name].chunking() for name in ("x", "pairs", "g")] == [[CHUNKS[STEPS]], [3, 2], "contiguous"]
    made = Writer(file)
    made.define("empty", ("none", "other"), FLOAT, {}, {"none": 0, "other": 2 * OTHER_CHUNK})
    assert file["empty"].chunking() == [1, OTHER_CHUNK]


@pytest.mark.parametrize(
    ("sizes", "chunk"),
    [
        ({"site": 300}, [436, 300]),
        ({"site": 10_000}, [13, 10_000]),
        ({"site": 1_000_000}, [1, 125_000]),
        ({"body": 100_000, "axis": 3}, [1, 33_334, 3]),
    ],
    ids=str,
)
def test_rows_of_many_elements_are_whole_or_in_equal_parts(
    file: netCDF4.Dataset, sizes: dict[str, int], chunk: list[int]
) -> None:
    """Assert chunks of up to a megabyte that hold rows in one piece, so that one row a time is written once."""
    Writer(file).define("r", (STEPS, *sizes), FLOAT, {}, sizes)
    assert file["r"].chunking() == chunk


def test_a_variable_has_room_for_two_chunks(file: netCDF4.Dataset) -> None:
    """Assert that the library keeps no more of a variable in memory than what is being filled."""
    filled(file, 5)
    assert [file[name].get_var_chunk_cache()[0] for name in ("x", "pairs")] == [2 * 8 * CHUNKS[STEPS], 2 * 8 * 6]


def test_what_was_given_is_read_back(file: netCDF4.Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert names, types, shapes and values of all that came since a moment, in parts of a bounded length."""
    monkeypatch.setattr(writing, "BACK", 4)
    made = filled(file, 5)
    before = made.filled
    assert before == {"x": 5, "pairs": 3, "g": 0, "text": 0}
    made.append("x", np.arange(5.0, 15.0))
    numbers = {"x": 3, "pairs": 3, "g": 0, "text": 0}
    assert made.shapes_since({"x": 3, "pairs": 3})[:2] == [("x", FLOAT, (12,)), ("pairs", FLOAT, (0, 2))]
    assert [part.tolist() for part in made.since(numbers)] == [[3, 4, 5, 6], [7, 8, 9, 10], [11, 12, 13, 14]]
    assert [part.shape for part in made.since(before)] == [(4,), (4,), (2,)]
    assert made.filled["x"] == 15


@pytest.mark.parametrize(("outcome", "complete"), [("completed", True), ("interrupted", False), (None, False)])
def test_a_finished_file_says_what_it_is(file: netCDF4.Dataset, outcome: str | None, *, complete: bool) -> None:
    """Assert the attributes of a file and of its variables, old digests left out, and whether the run ended well."""
    made = filled(file, 5)
    digests = made.digests()
    given = {"title": "t", "content_digest": "old", "volatile_digest": "old"}
    made.finish(given | ({"run_outcome": outcome} if outcome else {}))
    assert made.complete is complete
    assert {"title", "archive_seal", "content_digest", "volatile_digest"} <= {*file.ncattrs()}
    assert "old" not in {str(file.getncattr(name)) for name in file.ncattrs()}
    assert file["x"].__dict__ == {"units": "m"}
    assert file["text"].__dict__ == {"_Encoding": "utf-8"}
    assert dict(line.split() for line in file.variable_digests.splitlines()) == digests
    assert str(file["text"][:].tobytes(), "utf-8") == "größer"


MODEL = oscillator().model


@pytest.mark.parametrize(
    ("columns", "elements", "expected", "rows"),
    [
        (10, False, 0, 131_072),
        (10, False, 201, 201),
        (10, False, 10**6, 131_072),
        (999, False, 10**6, 32_032),
        (1000, False, 0, 32_000),
        (1000, True, 0, 4000),
        (5_000_000, True, 10**6, 1),
    ],
)
def test_a_block_is_bounded(columns: int, elements: bool, expected: int, rows: int) -> None:
    """Assert that a block has no more rows than its march, than a chunk, and than 256 MB of numbers, 32 MB of elements."""
    shapes = SimpleNamespace(shapes=SimpleNamespace(dims={"u": ("site",)} if elements else {}))
    layout = SimpleNamespace(row=SimpleNamespace(size=columns), watched=(), model=shapes)
    march: Any = SimpleNamespace(layout=layout, expected_rows=expected)
    assert segments._rows_per_block(march) == rows


def test_a_run_of_one_block_is_as_long_as_it_is(tmp_path: Path) -> None:
    """Assert chunks as long as a short run, none for what it has none of, and whole ones of a run in blocks."""
    model, path = xd.Model.from_toml(MODELS / "pendulum.toml"), tmp_path / "run.nc"
    run = xd.simulate(model, step=0.05, until=3.0, path=path)
    dims = (STEPS, EVENTS, SAMPLES, TRIALS)
    with netCDF4.Dataset(path) as file:
        found = {dim: (len(file.dimensions[dim]), file.dimensions[dim].isunlimited()) for dim in dims}
        assert found == {dim: (run.sizes[dim], run.sizes[dim] == 0) for dim in dims}
        assert run.sizes[TRIALS] == 0
        assert [file[name].chunking() for name in ("theta", "event_time")] == [[run.sizes[STEPS]], [1]]
        assert file["theta"].coordinates == "time"
        assert "coordinates" not in [*file["time"].ncattrs(), *file["event_time"].ncattrs(), *file["g"].ncattrs()]


def test_rows_at_events_leave_a_short_run_short(tmp_path: Path) -> None:
    """Assert that rows at events, which nobody knows beforehand, make no large file of a short run."""
    xd.simulate(xd.Model.from_toml(MODELS / "bouncing_ball.toml"), path=tmp_path / "run.nc").close()
    assert (tmp_path / "run.nc").stat().st_size < 1_000_000


def test_a_run_of_blocks_may_grow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that where the end is not in sight the steps are unlimited, and the content is the same."""
    monkeypatch.setattr(segments, "BLOCK_ROWS", 50)
    streamed = xd.simulate(MODEL, step=0.01, until=2.0, path=tmp_path / "run.nc")
    assert verified(tmp_path / "run.nc") == xd.content_digest(xd.simulate(MODEL, step=0.01, until=2.0))
    streamed.close()
    with netCDF4.Dataset(tmp_path / "run.nc") as file:
        assert file.dimensions[STEPS].isunlimited()
        assert file["x"].chunking() == [CHUNKS[STEPS]]


def test_segments_are_kept_while_the_run_is_not_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert a segment behind every block that is due but the last, and none of them left in the end."""
    kept: list[int] = []
    due, keep = [False, True, True], segments.Segments.keep

    def kept_too(one: segments.Segments, writer: Writer, *given: Any) -> None:
        kept.append(writer.filled["x"])
        keep(one, writer, *given)

    monkeypatch.setattr(segments, "BLOCK_ROWS", 50)
    monkeypatch.setattr(segments.Segments, "due", property(lambda _: due.pop(0) if due else True))
    monkeypatch.setattr(segments.Segments, "keep", kept_too)
    march = March(MODEL, settings_for(MODEL, step=0.01, until=2.0))
    assert segments.stream(march, str(tmp_path / "run.nc")) == tmp_path / "run.nc"
    assert kept == [108, 162]
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.nc"]


def test_a_write_that_fails_ends_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that what goes wrong while the next block is marched, or behind the last, is told."""
    monkeypatch.setattr(segments, "BLOCK_ROWS", 50)

    write = Writer.write

    def refuse(one: Writer, parts: list[Any]) -> None:
        if len(parts) > 1:  # a block, not a constant
            raise OSError(28, "No space left on device")
        write(one, parts)

    monkeypatch.setattr(Writer, "write", refuse)
    for until in (0.1, 2.0):
        march = March(MODEL, settings_for(MODEL, step=0.01, until=until))
        with pytest.raises(xd.ArchiveError, match="cannot be written: No space left on device"):
            segments.stream(march, tmp_path / "run.nc")
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a run extended on a disk that is full ends without its file, and without a folder for its segments."""
    kept = xd.save(xd.simulate(MODEL, step=0.01, until=1.0), tmp_path / "run.nc")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(segments, "BLOCK_ROWS", 50)
    monkeypatch.setattr(segments.Segments, "due", property(lambda self: not self.failed))
    monkeypatch.setattr(segments, "write_segment", full)
    monkeypatch.setattr(Writer, "finish", full)
    with (
        pytest.warns(xd.ResumeWarning, match="no more segments of .*: No space left on device; the run goes on"),
        pytest.raises(xd.ArchiveError, match="cannot be written: No space left on device"),
    ):
        xd.extend(kept, until=3.0, path=tmp_path / "longer.nc")
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.nc"]


def test_the_model_s_own_file_is_no_target(tmp_path: Path) -> None:
    """Assert that a march refuses the file that its model is from, before anything is made beside it."""
    path = tmp_path / "free.toml"
    path.write_text(MODEL.to_toml())
    model = xd.Model.from_toml(path)
    with pytest.raises(xd.InputError, match="is the model file itself"):
        segments.stream(March(model, settings_for(model, step=0.1, until=1.0)), path)
    assert [entry.name for entry in tmp_path.iterdir()] == ["free.toml"]


PENDULUM = xd.Model.from_toml(MODELS / "pendulum.toml")


def runs(count: int, until: float = 1.0) -> list[xr.Dataset]:
    """Return short runs, each of another step."""
    return [xd.simulate(PENDULUM, method="rk4", step=0.01 + 0.001 * k, until=until) for k in range(count)]


@pytest.mark.dear
def test_files_are_those_of_save(tmp_path: Path) -> None:
    """Assert names, digests and compression of runs in a folder, by name and at paths."""
    made = runs(3)
    folder, named, paths = (tmp_path / name for name in ("folder", "named", "paths"))
    paths.mkdir()
    found = xd.save_many(made, folder, compress=True)
    assert [one.name for one in found] == ["000000.nc", "000001.nc", "000002.nc"]
    found += xd.save_many({f"run {k}": run for k, run in enumerate(made)}, named)
    found += xd.save_many(iter(made), [paths / f"{k}.nc" for k in "abc"])
    assert {entry.name for entry in named.iterdir()} == {"run 0.nc", "run 1.nc", "run 2.nc"}
    assert [verified(one) for one in found] == 3 * [xd.content_digest(run) for run in made]
    assert found[0].stat().st_size < found[3].stat().st_size


@pytest.mark.dear
def test_the_disk_is_asked_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert one synchronisation for all files and one of the folder; and so for each batch."""
    asked: list[Any] = []
    plain, all_at_once = os.fsync, target.sync_file_systems
    monkeypatch.setattr(os, "fsync", lambda handle: (asked.append("fsync"), plain(handle)))
    monkeypatch.setattr(target, "sync_file_systems", lambda paths: (asked.append(len(paths)), all_at_once(paths)))
    made = runs(5)
    xd.save_many(made, tmp_path / "one")
    assert asked == [5, "fsync"]
    monkeypatch.setattr(writing, "MOST_AT_ONCE", 2)
    xd.save_many(made, tmp_path / "more")
    assert asked[2:] == [2, "fsync", 2, "fsync", 1, "fsync"]


@pytest.mark.every(2)
@pytest.mark.parametrize("where", ["_seal_new_file", "sync_file_systems"])
def test_a_write_that_fails_changes_nothing(where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that no name is taken where one file, or the disk, fails, that nothing is left beside, and one error names it."""
    before = [verified(one) for one in xd.save_many(runs(3), tmp_path)]
    calls: list[object] = []

    def full(*_given: object, **_asked: object) -> str:
        calls.append(0)
        if where == "_seal_new_file" and len(calls) < 3:
            return "0" * 64
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(writing if where == "_seal_new_file" else target, where, full)
    with pytest.raises(xd.ArchiveError, match=r"00000\d.nc' cannot be written: .*nothing is changed"):
        xd.save_many(runs(3, until=2.0), tmp_path)
    assert [verified(entry) for entry in sorted(tmp_path.iterdir())] == before


def test_wrong_lists_are_refused_before_anything_is_written(tmp_path: Path) -> None:
    """Assert one line for two runs of one name, other numbers, no place, what is no run or edited, and a wrong folder."""
    made = runs(2)
    edited = made[1].assign(theta=2.0 * made[1]["theta"])
    (tmp_path / "file").write_text("here")
    wrong: list[tuple[Any, Any, str]] = [
        (made, [tmp_path / "a.nc", tmp_path / "a.nc"], "two runs are to be written to '.*a.nc'"),
        (made, [tmp_path / "a.nc"], "there are 2 runs and 1 paths"),
        (made, None, "needs a file for each run, or a folder"),
        ([made[0], edited], tmp_path, "not the record that was computed"),
        ([made[0], 3], tmp_path, "a run record is to be saved, got '3'"),
        (made[0], tmp_path, "one run was given; save writes it"),
        (made, tmp_path / "file", "is a file; name a folder|file'.*name a folder"),
        (made, [tmp_path / "no" / "a.nc", tmp_path / "b.nc"], "folder .* does not exist"),
        ({"a/b": made[0]}, tmp_path, "'a/b' is no name of a file in the folder"),
    ]
    for given, places, said in wrong:
        with pytest.raises(xd.InputError, match=said):
            xd.save_many(given, places)
    with pytest.raises(xd.InputError, match="compress is 'yes', needs true or false"):
        xd.save_many(made, tmp_path, compress="yes")  # type: ignore[arg-type]
    assert [entry.name for entry in tmp_path.iterdir()] == ["file"]

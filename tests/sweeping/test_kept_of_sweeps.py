"""What is kept of the members of a sweep: digests, files, logs, numbers of their runs, and all their rows.

The content digest of a sweep: of what was marched, not of when, where and how often it was begun.
The files of a sweep's whole runs: written alike, checked once in full a block, never left broken.
The whole runs of a sweep together, at common times.
What is kept of members under the names of a run, of its events and of its diagnosis.
All rows of many runs in one Dataset: saved, verified, opened in chunks, and described before any run is marched.
"""

from __future__ import annotations

import time
from collections import OrderedDict
from pathlib import Path
from typing import Any

import dask
import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.odd import changed
from cases.problems import MODELS, oscillator
from cases.stages import assert_described, assert_same_bits, marches
from cases.verdicts import verified
from xdynamics.archive import sandboxed_reading, writing
from xdynamics.evidence.stages import compute_datasets
from xdynamics.record import faults_of
from xdynamics.record.flag_words import words_of_flag
from xdynamics.sweeping import catalogue, logs
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


MODEL = oscillator().model
MEMBERS_ASKED: dict[str, Any] = {"keep": ["log"], "method": "rk4", "step": 0.1, "until": 1.0}


@pytest.mark.dear
def test_one_file_of_a_block_is_read_again_in_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert one full reading a block, and that all members are files that verify."""
    compared: list[str] = []
    compare = writing.compare_file
    monkeypatch.setattr(
        writing, "compare_file", lambda *given: compared.append(given[0].parent.name) or compare(*given)
    )
    grid = xd.sweep(MODEL, {"k": "1:2:10 N m-1"}, path=tmp_path / "grid", members_per_task=5, **MEMBERS_ASKED)
    assert compared.count("runs") == 2
    assert len({verified(tmp_path / "grid" / str(name)) for name in grid.run_file.values}) == 10


def test_what_is_written_otherwise_than_given_is_no_member(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a library which writes other numbers is found out before any file of the block has its name."""
    digests = writing.Writer.digests
    monkeypatch.setattr(writing.Writer, "digests", lambda self: digests(self) | {"x": "0" * 64})
    with pytest.raises(
        xd.ArchiveError, match="cannot be written: what was written reads otherwise: variable 'x' differs"
    ):
        xd.sweep(MODEL, {"k": "1:2:4 N m-1"}, path=tmp_path / "grid", members_per_task=4, **MEMBERS_ASKED)
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
    assert (
        changed.elements.statement.calendar
        == xd.Model.from_text(changed.to_toml()).elements.statement.calendar
        == ("year",)
    )
    grid = xd.sweep(model, {"F": "1, 2 N"}, path=tmp_path, **MEMBERS_ASKED)
    run = xd.member(grid, F=2.0)
    assert np.array_equal(run.x, xd.simulate(changed, method="rk4", step=0.1, until=1.0).x)
    rocket = xd.Model.from_toml(MODELS / "rocket_c6.toml")
    assert rocket.replace(parameters={"airframe": "45 g"}).elements.statement.calendar == ()


LOGS_ASKED: dict[str, Any] = {"axes": {"k": "1:2:2 N m-1", "until": [1.0, 2.0]}, "method": "rk4", "step": 0.1}


@pytest.fixture(scope="module")
def grid(tmp_path_factory: pytest.TempPathFactory) -> xr.Dataset:
    """A sweep with whole runs, two of which end early."""
    return xd.sweep(MODEL, **LOGS_ASKED, keep=["log", "end"], path=tmp_path_factory.mktemp("logs") / "grid")


def test_logs_are_what_sample_gives(grid: xr.Dataset) -> None:
    """Assert along axes and times the states of every member, nan after its end, with units."""
    opened = xd.open_logs(grid, "0:2:5 s")
    assert dict(opened.sizes) == {"k": 2, "solver_until": 2, "at": 5}
    assert opened.x.attrs["units"] == "m"
    states = xd.sample(xd.member(grid, k="2 N m-1", until="2 s"), "0:2:5 s")
    for name in ("x", "v_x"):
        assert opened[name][1, 1].values.tolist() == states[name].values.tolist()
    assert np.isnan(opened.x[:, 0].values).tolist() == [[False] * 3 + [True] * 2] * 2


def test_files_are_read_when_they_are_used(grid: xr.Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that nothing is read to open them, and one file once for both variables of one member."""
    read = counted(monkeypatch)
    lazy = xd.open_logs(grid, [0.5, 1.0])
    assert read == []
    lazy.isel(k=0, solver_until=0).compute()
    assert len(read) == 1


def counted(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Note the files that logs are read from."""
    read: list[Any] = []
    columns_of = logs.read_columns
    monkeypatch.setattr(logs, "read_columns", lambda *given: read.append(given[0]) or columns_of(*given))
    return read


@pytest.mark.dear
def test_saving_logs_reads_each_file_once(grid: xr.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that logs which a report computes are archived without being read again, and that an edit is noticed."""
    read = counted(monkeypatch)
    page = xd.report(tmp_path, logs=xd.open_logs(grid, [0.5, 1.0]))
    assert len(read) == len({*read}) == 4
    assert f"logs.nc, {verified(tmp_path / 'logs.nc')}" in page
    (held,) = compute_datasets(xd.open_logs(grid, [0.5]))
    held["x"] = held.x + 1.0
    with pytest.raises(xd.InputError, match="variable 'x' is .* in row 0, .*in the run"):
        xd.save(held, tmp_path / "edited.nc")


@pytest.mark.dear
def test_logs_of_files_of_others_are_those_of_own(grid: xr.Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert the same bits where the files' bytes are not known to the process, and that all of them are examined then."""
    own = xd.open_logs(grid, "0:2:5 s").compute()
    monkeypatch.setattr(sandboxed_reading, "_known_seals", OrderedDict())
    asked: list[Path] = []
    examine = sandboxed_reading._EXAMINER.examine
    monkeypatch.setattr(
        sandboxed_reading._EXAMINER, "examine", lambda *given: asked.append(given[0]) or examine(*given)
    )
    assert xd.open_logs(grid, "0:2:5 s").compute().identical(own)
    assert len({*asked}) == 4


def test_who_reads_for_another_need_not_examine_again(grid: xr.Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that tasks carry what is known of the files where they are described, for workers that know nothing."""
    lazy = xd.open_logs(grid, [0.5])
    monkeypatch.setattr(sandboxed_reading, "_known_seals", OrderedDict())
    monkeypatch.setattr(sandboxed_reading._EXAMINER, "examine", lambda *_: pytest.fail("examined"))
    assert np.isfinite(lazy.compute().x.values).all()


def test_logs_of_a_part_are_those_of_its_members(grid: xr.Dataset) -> None:
    """Assert the same numbers of a part, its axes turned round or one of them gone."""
    whole = xd.open_logs(grid, [0.5, 1.0])
    turned = xd.open_logs(grid.transpose("solver_until", "k"), [0.5, 1.0])
    assert turned.x.transpose("k", "solver_until", "at").values.tolist() == whole.x.values.tolist()
    assert xd.open_logs(grid.isel(k=1), [0.5, 1.0]).x.values.tolist() == whole.x[1].values.tolist()


@pytest.mark.dear
def test_a_run_that_is_hurt_is_named(tmp_path: Path) -> None:
    """Assert that a damaged file is an error where it is read, and not before."""
    grid = xd.sweep(MODEL, **LOGS_ASKED, keep=["log"], path=tmp_path / "grid")
    file = tmp_path / "grid" / str(grid.run_file[0, 0].values)
    file.write_bytes(file.read_bytes()[:-9])
    lazy = xd.open_logs(tmp_path / "grid", [0.5], names=["x"])
    lazy.isel(k=1).compute()
    with pytest.raises(xd.ArchiveError, match=f"{file.name}' is damaged or no run archive"):
        lazy.isel(k=0, solver_until=0).compute()


def test_what_has_no_logs_is_refused(grid: xr.Dataset) -> None:
    """Assert one line with the remedy."""
    with pytest.raises(xd.InputError, match="has no archived runs: give sweep keep="):
        xd.open_logs(xd.sweep(MODEL, **LOGS_ASKED), [0.5])
    with pytest.raises(xd.InputError, match="names have 'y'; there are x, v_x"):
        xd.open_logs(grid, [0.5], names=["y"])
    with pytest.raises(xd.InputError, match="no times of its own; give times"):
        xd.open_logs(grid)


KEPT_AXES = {"v_y": "10:20:2 m s-1", "method": ["heun", "dop853"]}


def alone(sweep: xr.Dataset, at: dict[str, int]) -> xr.Dataset:
    """March the member of a sweep by itself."""
    mine = sweep.isel(at)
    return xd.member(sweep, v_y=float(mine.v_y), method=str(mine.solver_method.values))


def test_a_number_of_a_diagnosis_is_that_of_the_member_alone() -> None:
    """Assert bits, units and flags of what only whole runs tell, and that a lazy sweep has them too."""
    words = ["energy_drift", "continuity_verdict", "believed_until", "turning_time", "run_fastest_rate"]
    lazy = xd.sweep(xd.Model.from_toml(MODELS / "ball_drag.toml"), KEPT_AXES, keep=words, rtol=1e-6, until="4 s")
    assert lazy.energy_drift.chunks is not None
    found = lazy.compute()
    for at in ({"v_y": 0, "solver_method": 0}, {"v_y": 1, "solver_method": 1}):
        run = alone(found, at)
        diagnosis, mine = xd.diagnose(run), found.isel(at)
        for name in ("energy_drift", "continuity_verdict", "believed_until"):
            assert float(mine[name]) == float(diagnosis[name]), name
            assert mine[name].attrs["units"] == diagnosis[name].attrs["units"]
        assert float(mine.turning_time) == float(diagnosis.turning_time[0])
        assert float(mine.run_fastest_rate) == run.attrs["run_fastest_rate"]
        assert words_of_flag(mine.continuity_verdict.expand_dims("one")) == ["passed"]


def test_cycles_are_occurrences() -> None:
    """Assert the periods of two oscillators along `occurrence`, nan behind their last ones."""
    model = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
    found = xd.sweep(
        model, {"k": "4, 16 N m-1"}, keep="period", occurrences=(1, 6), method="dop853", rtol=1e-9, until="10 s"
    )
    assert found.period.dims == ("k", "occurrence")
    periods = found.period.values
    assert np.count_nonzero(~np.isnan(periods), axis=1).tolist() == [1, 4]
    assert np.nanmax(abs(periods - np.array([[np.pi], [np.pi / 2]]))) < 1e-7


def test_what_a_record_has_of_an_event_is_kept() -> None:
    """Assert residual, uncertainty and direction of events against the members' records."""
    names = ["event_residual_ground", "event_time_uncertainty_ground", "event_direction_ground"]
    model = xd.Model.from_toml(MODELS / "ball_drag.toml")
    found = xd.sweep(model, KEPT_AXES, keep=names, rtol=1e-6, until="4 s").compute()
    run = alone(found, {"v_y": 1, "solver_method": 0})
    ground = words_of_flag(run.event_detector).index("ground")
    for name in names:
        recorded = run[name.removesuffix("_ground")][ground]
        assert float(found[name][1, 0]) == float(recorded)
        assert found[name].attrs["units"] == recorded.attrs["units"]


def test_a_member_that_fails_has_no_number_of_a_diagnosis() -> None:
    """Assert nan, not zero, of a run that ends in nothing finite, beside one that ends well."""
    model = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
    found = xd.sweep(model, {"k": [1.0, -1e6]}, keep=["energy_drift"], method="rk4", step=0.5, until="200 s").compute()
    outcomes = found.run_outcome.values.tolist()
    assert outcomes[0] == "completed"
    assert outcomes[1] != "completed"
    assert np.isnan(found.energy_drift.values).tolist() == [False, True]


def test_a_catalogue_keeps_them_and_marches_no_member_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert the same numbers from a folder, and that the finished sweep is read and not marched."""
    model = xd.Model.from_toml(MODELS / "ball_drag.toml")
    asked: dict[str, Any] = {"keep": ["energy_drift"], "rtol": 1e-6, "until": "4 s"}
    here = xd.sweep(model, KEPT_AXES, **asked).compute()
    there = xd.sweep(model, KEPT_AXES, path=tmp_path / "s", **asked)
    assert there.energy_drift.values.tolist() == here.energy_drift.values.tolist()
    monkeypatch.setattr("xdynamics.sweeping.members.run_values", None)
    again = xd.sweep(model, KEPT_AXES, path=tmp_path / "s", **asked)
    assert again.energy_drift.values.tolist() == here.energy_drift.values.tolist()


@pytest.mark.parametrize(
    ("word", "near"),
    [
        ("energy_drit", "energy_drift"),
        ("event_time_grund", "event_time_ground"),
        ("run_force_evaluation", "run_force_evaluations"),
        ("hieght", ""),
    ],
)
def test_an_unknown_word_has_its_three_nearest_names(word: str, near: str) -> None:
    """Assert the word, and three names, the one that was meant among them."""
    with pytest.raises(xd.InputError, match=f"keep has '{word}'") as caught:
        xd.sweep(xd.Model.from_toml(MODELS / "ball_drag.toml"), KEPT_AXES, keep=[word], until="1 s")
    nearest = str(caught.value).partition("the nearest are ")[2].split(", ")
    assert len(nearest) == 3
    assert near in nearest or not near


def test_what_every_sweep_has_may_be_asked_for() -> None:
    """Assert that the names of counts and outcomes are taken."""
    words = ["run_force_evaluations", "run_outcome", "end_time"]
    found = xd.sweep(xd.Model.from_toml(MODELS / "ball_drag.toml"), KEPT_AXES, keep=words, rtol=1e-6, until="1 s")
    assert {*words} <= {*found.data_vars}
    assert "end_y" not in found


BALL = xd.Model.from_toml(MODELS / "ball_drag.toml")


@pytest.fixture(scope="module")
def swept_balls() -> xr.Dataset:
    """A grid of balls by two methods, whose runs have rows of different numbers."""
    return xd.sweep(BALL, {"v_y": [10.0, 30.0], "method": ["heun", "rk4"]}, step=0.1, until="2 s")


@pytest.fixture(scope="module")
def rows(swept_balls: xr.Dataset) -> xr.Dataset:
    """All of their rows."""
    return xd.ragged(swept_balls)


@pytest.mark.dear
def test_rows_of_many_runs_are_saved_and_opened(rows: xr.Dataset, tmp_path: Path) -> None:
    """Assert the same bits from the file, whole and in chunks, the digest of what was saved, and times as coordinates."""
    xd.save(rows, tmp_path / "rows.nc")
    assert verified(tmp_path / "rows.nc") == xd.content_digest(rows)
    with xd.open_run(tmp_path / "rows.nc") as kept, xd.open_run(tmp_path / "rows.nc", chunks={"row": 7}) as chunked:
        assert_same_bits(
            kept.assign(run_solver_method=kept.run_solver_method.astype(rows.run_solver_method.dtype)), rows
        )
        assert {*kept.coords} == {*rows.coords} == {"time", "step_number"}
        assert len(chunked.y.chunks[0]) > 2
        xd.save(chunked, tmp_path / "again.nc")
    assert verified(tmp_path / "again.nc") == xd.content_digest(rows)


def test_lazy_rows_are_described_and_saved_as_many_as_there_are(
    swept_balls: xr.Dataset, rows: xr.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert names and units while no run can be marched, rows beyond the last of no value, and the archive of the eager."""
    count, marched = rows.sizes["row"], []
    march = xd.sweeping.grid.march_many
    with monkeypatch.context() as patch:
        patch.setattr("xdynamics.sweeping.grid.march_many", lambda *_, **__: pytest.fail("marched"))
        exact, longer = (xd.ragged(swept_balls, compute=False, sizes={"row": n}) for n in (count, count + 3))
        assert_described(exact, rows)
    monkeypatch.setattr("xdynamics.sweeping.grid.march_many", lambda *a, **k: marched.append(1) or march(*a, **k))
    with marches():
        assert np.isnan(longer.y.values[count:]).all()
        assert longer.y.values[:count].tobytes() == rows.y.values.tobytes()
        assert_same_bits(exact, rows)
        xd.save(longer, tmp_path / "rows.nc")
        assert len(marched) == 2  # of each method all runs, once
    assert verified(tmp_path / "rows.nc") == xd.content_digest(rows)
    xd.save(exact.compute(), tmp_path / "rows.nc")
    with xd.open_run(tmp_path / "rows.nc") as kept:
        assert_same_bits(kept, rows.drop_vars("run_solver_method"))


@pytest.mark.parametrize("sizes", [None, {"step": 5}, {"row": 0}, {"row": True}, 5])
def test_how_many_rows_there_are_has_to_be_stated(swept_balls: xr.Dataset, sizes: Any) -> None:
    """Assert that rows of unknown number, none, or of another dimension are refused, and those of marched runs too."""
    with pytest.raises(xd.InputError, match=r"known only once they are computed; give a number, sizes=\{'row': 4000\}"):
        xd.ragged(swept_balls, compute=False, sizes=sizes)
    if sizes is not None:
        with pytest.raises(xd.InputError, match="for compute=False: runs that are computed have their own"):
            xd.ragged(swept_balls, sizes=sizes)


def test_fewer_rows_than_there_are(swept_balls: xr.Dataset, rows: xr.Dataset) -> None:
    """Assert that too few are an error that names the right number."""
    few = xd.ragged(swept_balls, compute=False, sizes={"row": 3})
    with pytest.raises(xd.InputError, match=rf"were stated: sizes=\{{'row': {rows.sizes['row']}\}}"):
        few.y.compute()


def test_times_of_each_run_increase(rows: xr.Dataset) -> None:
    """Assert that times may begin again where a run does and nowhere else, and that rows are counted."""
    assert faults_of(rows) == []
    whole, inside = rows.row_size.values, int(rows.row_size[0]) + 3
    times = rows.time.values.copy()
    times[inside] = times[inside - 1]
    (fault,) = faults_of(rows.assign_coords(time=("row", times, rows.time.attrs)))
    assert f"at row {inside}: it must increase" in fault
    for counts in (whole + np.eye(4, dtype=int)[0], whole[:-1], [0, whole[0] + whole[1], *whole[2:]]):
        other = rows.drop_vars([name for name in rows.variables if rows[name].dims == ("run",)])
        (fault,) = faults_of(other.assign(row_size=("run", np.array(counts), rows.row_size.attrs)))
        assert fault.startswith(f"variable 'row_size' counts {sum(counts)} rows of {len(counts)} runs, and there are")


def test_padded_rows_are_not_saved(swept_balls: xr.Dataset, rows: xr.Dataset, tmp_path: Path) -> None:
    """Assert that rows that were computed with room for more are refused, and counted."""
    longer = xd.ragged(swept_balls, compute=False, sizes={"row": rows.sizes["row"] + 3}).compute()
    with pytest.raises(xd.InputError, match="'row_size' counts .* rows of 4 runs, and there are"):
        xd.save(longer, tmp_path / "rows.nc")
    assert not (tmp_path / "rows.nc").exists()


def test_accelerations_have_extremes() -> None:
    """Assert those of an oscillator between its steps, by the closed form, and of bodies, by the forces on them."""
    spring = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")  # w = 2 s-1
    starts, words = [0.5, 1.0], ["maximum_a_x", "minimum_a_x"]
    how = {"method": "dop853", "rtol": 1e-10, "until": 3.0}
    found = xd.sweep(spring, {"x": starts}, keep=words, **how).compute()
    assert found.maximum_a_x.values == pytest.approx(4.0 * np.array(starts), rel=1e-9)
    assert found.maximum_a_x_time.values == pytest.approx(np.pi / 2, abs=1e-5)
    assert words_of_flag(found.maximum_a_x_rule) == ["interpolated"] * 2
    assert found.minimum_a_x.values == pytest.approx(-4.0 * np.array(starts), rel=1e-12)
    bodies = xd.Model.from_toml(MODELS / "figure_eight.toml")  # three masses of 1 kg
    words = ["minimum_a_r", "minimum_force_gravity_r"]
    found = xd.sweep(bodies, {"G": ["1 m3 kg-1 s-2", "1.1 m3 kg-1 s-2"]}, keep=words, until="2 s", rtol=1e-9).compute()
    assert found.minimum_a_r.values == pytest.approx(found.minimum_force_gravity_r.values, rel=1e-9)
    assert found.minimum_a_r.attrs["units"] == "m s-2"

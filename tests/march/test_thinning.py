"""Rows that are left out of a record: those that are kept have the bits of the whole march, however it is marched."""

from __future__ import annotations

import random
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner

import xdynamics as xd
from cases.problems import MODELS
from cases.verdicts import verified
from xdynamics.archive import segments
from xdynamics.cli import main
from xdynamics.schema import EVENT_BEFORE, KEEP_EVERY

PENDULUM = xd.Model.from_toml(MODELS / "pendulum.toml")
# model, method, whether its steps are chosen, a step or tolerance, an end
POOL: tuple[tuple[str, str, bool, float, float], ...] = (
    ("harmonic_oscillator", "velocity_verlet", False, 0.05, 12.0),
    ("harmonic_oscillator", "dop853", True, 1e-8, 30.0),
    ("pendulum", "rk4", False, 0.02, 9.0),
    ("pendulum", "radau_iia", True, 1e-7, 9.0),
    ("kepler", "dormand_prince", True, 1e-7, 20.0),
    ("moving_table", "dop853", True, 1e-7, 2.0),
    ("moving_table", "rk4", False, 0.004, 1.5),
    ("ball_drag", "midpoint", False, 0.01, 3.0),
    ("stick_slip_belt", "dop853", True, 1e-6, 4.0),
    ("rocket_c6", "heun", False, 0.01, 3.0),
    ("rocket_c6", "bogacki_shampine", True, 1e-5, 3.0),
)


class PowerCut(Exception):
    """Ends a run as nothing that it expects."""


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Warn of nothing: what is marched is short and coarse."""
    monkeypatch.setattr(segments, "SHARE", 0.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def drawn(rng: random.Random) -> tuple[xd.Model, dict[str, Any]]:
    """Return a model and settings of a short march, with a node or steps given one by one now and then."""
    name, method, chosen, size, until = rng.choice(POOL)
    model = xd.Model.from_toml(MODELS / f"{name}.toml")
    asked: dict[str, Any] = {"method": method, "until": until * rng.uniform(0.2, 1.0)}
    asked["rtol" if chosen else "step"] = size * rng.uniform(0.5, 2.0)
    asked["force_samples"] = rng.choice(["all", "none"])
    if rng.random() < 0.3:
        asked["nodes"] = [asked["until"] * rng.random()]
    if not chosen and rng.random() < 0.2:
        asked["step"] = [size * rng.uniform(0.5, 1.5) for _ in range(int(2.0 * asked["until"] / size) + 2)]
    return model, asked


def kept(whole: xr.Dataset, every: int, nodes: list[float]) -> np.ndarray[Any, Any]:
    """Return the numbers of the rows that are to be kept, by the record's words alone."""
    time, numbers = whole["time"].values, np.arange(whole.sizes["step"])
    if whole.attrs["solver_step_control"] == "fixed":
        h, start = float(whole.attrs["solver_step"]), float(time[0])
        near = np.rint((time - start) / (every * h)) * every
        grid = np.abs(start + near * h - time) <= 1e-13 * np.maximum(1.0, np.abs(time))
    else:
        grid = numbers % every == 0
    named = np.union1d(whole["event_row_before"].values, whole["event_row_after"].values)
    ends = (numbers == 0) | (numbers == numbers[-1])
    return np.flatnonzero(
        grid | ends | np.isin(numbers, named) | np.isin(time, nodes) | (whole["row_kind"].values >= EVENT_BEFORE)
    )


def thinned(whole: xr.Dataset, rows: np.ndarray[Any, Any], names: Any) -> dict[str, bytes]:
    """Return the bytes that variables of a run are to have of which these rows are kept, whose numbers stay what they are."""
    found = {}
    for name in names:
        one = whole[name]
        if one.dims == ("step",):
            values = one.values[rows]
        elif one.dims in (("trial",), ("sample",)):
            owner = whole[f"{one.dims[0]}_step"].values
            values = one.values[np.isin(owner, rows)]
        else:
            values = one.values
        found[name] = np.ascontiguousarray(values).tobytes()
    return found


def cut_at(when: float) -> Any:
    """Return what ends a march behind a time."""

    def tell(_done: float, t: float, _rows: int) -> None:
        if t > when:
            raise PowerCut

    return tell


def marched(model: xd.Model, asked: dict[str, Any], way: str, path: Path, rng: random.Random) -> xr.Dataset:
    """March in memory, into a file, into one after a cut, or up to a time and on from there."""
    if way == "memory":
        return xd.simulate(model, **asked)
    if way == "resumed":
        try:
            xd.simulate(model, **asked, path=path, progress=cut_at(asked["until"] * rng.random()))
        except PowerCut:
            return xd.simulate(model, **asked, path=path, resume=True).load()
    return xd.simulate(model, **asked, path=path).load()


@pytest.mark.dear
@pytest.mark.cases(400)
@pytest.mark.usefixtures("small")
def test_rows_have_the_bits_of_the_whole_march(case: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert the rows, and all that belongs to them, of random runs, in blocks of random size, stopped and resumed."""
    rng = random.Random(case)
    model, asked = drawn(rng)
    whole = xd.simulate(model, **asked)
    every, way = rng.choice([2, 3, 7, 50, 10**6]), rng.choice(["memory", "streamed", "resumed", "resumed"])
    block = rng.choice([5, 17, 100, 4000])
    monkeypatch.setattr("xdynamics.march.runner.THINNED_BLOCK", block)
    monkeypatch.setattr("xdynamics.march.runner.SHORTEST_PART", block)
    monkeypatch.setattr("xdynamics.archive.segments.BLOCK_ROWS", block)
    monkeypatch.setattr(segments, "EVERY", 0.0)
    monkeypatch.setattr(segments.Segments, "patience", float("inf"))
    path = tmp_path / "run.nc"
    run = marched(model, asked | {"keep_every": every}, way, path, rng)
    rows = kept(whole, every, asked.get("nodes", []))
    np.testing.assert_array_equal(run["step_number"], rows)
    names = [
        name
        for name, variable in whole.variables.items()
        if variable.dims and variable.dims[0] in ("step", "trial", "event", "sample")
    ]
    assert {name: np.ascontiguousarray(run[name].values).tobytes() for name in names} == thinned(whole, rows, names)
    assert run.attrs[KEEP_EVERY] == every
    assert run.attrs["run_rows"] == whole.sizes["step"]
    if way == "memory":
        xd.save(run, path)
    else:
        run.close()
    assert xd.reproduce(path).attrs["identical"] == 1


@pytest.mark.cases(100)
@pytest.mark.usefixtures("small")
def test_extended_is_the_longer_run(case: int) -> None:
    """Assert the digest of one march to the new end that lands on the old one."""
    rng = random.Random(1000 + case)
    model, asked = drawn(rng)
    asked |= {"keep_every": rng.choice([2, 5, 64]), "until": max(1.0, asked["until"])}
    run = xd.simulate(model, **asked)
    if run.attrs["run_outcome"] != "completed" or "given_step_size" in run:
        return
    end, until = float(run["time"][-1]), 1.5 * asked["until"]
    nodes = sorted([*asked.get("nodes", []), end])
    longer = xd.extend(run, until=until)
    assert xd.content_digest(longer) == xd.content_digest(
        xd.simulate(model, **asked | {"until": until, "nodes": nodes})
    )


@pytest.mark.parametrize("way", ["memory", "streamed", "resumed"])
@pytest.mark.usefixtures("small")
def test_rows_of_states_have_the_bits_of_the_whole_march(
    way: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert the rows of a run without columns of force samples, of which none are then copied, row by row."""
    asked: dict[str, Any] = {"method": "rk4", "step": 0.02, "until": 2.0, "log": "states"}
    whole = xd.simulate(PENDULUM, **asked)
    for place in ("march.runner.RECYCLED_NUMBERS", "march.runner.SHORTEST_PART", "archive.segments.BLOCK_ROWS"):
        monkeypatch.setattr(f"xdynamics.{place}", 1)
    monkeypatch.setattr(segments, "EVERY", 0.0)
    monkeypatch.setattr(segments.Segments, "patience", float("inf"))
    run = marched(PENDULUM, asked | {"keep_every": 7}, way, tmp_path / "run.nc", random.Random(1))
    rows = kept(whole, 7, [])
    for name in ("time", "theta", "v_theta", "row_kind"):
        assert run[name].values.tobytes() == whole[name].values[rows].tobytes()
    run.close()


@pytest.mark.dear
def test_interrupted_run_ends_with_its_last_row(tmp_path: Path) -> None:
    """Assert the last row of a run that Ctrl-C ended, and the bits of the whole one when it is resumed."""
    import os
    import signal

    def interrupt(_done: float, t: float, _rows: int) -> None:
        if t > 100.0:
            os.kill(os.getpid(), signal.SIGINT)

    asked: dict[str, Any] = {"method": "rk4", "step": 1e-3, "until": 300.0, "keep_every": 997}
    path = tmp_path / "run.nc"
    with xd.simulate(PENDULUM, **asked, path=path, progress=interrupt) as run:
        assert run.attrs["run_outcome"] == "interrupted"
        assert int(run["step_number"][-1]) == run.attrs["run_rows"] - 1
    with xd.simulate(PENDULUM, **asked, path=path, resume=True) as run:
        assert xd.content_digest(run) == xd.content_digest(xd.simulate(PENDULUM, **asked))


def test_times_of_kept_rows_are_sampled_and_others_refused() -> None:
    """Assert states at a kept row, and one line that names keep_every between."""
    run = xd.simulate(PENDULUM, method="rk4", step=1e-2, until=2.0, keep_every=10)
    assert float(xd.sample(run, 1.0)["theta"][0]) == float(run["theta"].values[run["time"].values == 1.0][0])
    with pytest.raises(xd.InputError, match=r"t = 0\.55 s is between rows .* one in 10 \(keep_every = 10\)"):
        xd.sample(run, 0.55)
    with pytest.raises(xd.InputError, match="a diagnosis needs every row of the run, and this record has one in 10"):
        xd.diagnose(run)


def test_compared_at_the_rows_that_were_kept() -> None:
    """Assert no difference of a thinned run from the whole one, at the times of its rows; from another's, where both have some."""
    asked: dict[str, Any] = {"method": "rk4", "step": 1e-2, "until": 2.0}
    whole, run, other = (xd.simulate(PENDULUM, **asked, keep_every=n) for n in (1, 10, 25))
    found = xd.compare(whole, run)
    np.testing.assert_array_equal(found["at_time"], run["time"])
    assert not found["difference_theta"].values.any()
    assert {0.0, 0.5, 1.0, 1.5, 2.0} <= set(xd.compare(run, other)["at_time"].values.tolist())


def test_companion_of_a_thinned_run() -> None:
    """Assert the same errors at the end as of the whole run: the tighter run has all its rows."""
    asked: dict[str, Any] = {"method": "rk4", "step": 1e-2, "until": 2.0}
    whole, run = (xd.companion(xd.simulate(PENDULUM, **asked, keep_every=n)) for n in (1, 10))
    assert float(whole["global_error_theta"][0]) == float(run["global_error_theta"][0]) != 0.0


def test_evidence_from_marches_of_its_own_needs_every_row() -> None:
    """Assert that a model's own keep_every thins its record and no study, and that a study is not asked for one."""
    thin = xd.Model.from_text(PENDULUM.to_toml().replace("[run]", "[run]\nkeep_every = 10"))
    assert xd.simulate(thin, until="1 s").attrs[KEEP_EVERY] == 10
    asked: dict[str, Any] = {
        "method": "rk4",
        "until": "1 s",
        "steps": ["40 ms", "20 ms", "10 ms"],
        "at": ["0.5 s"],
        "observables": ["theta"],
    }
    assert xd.refine(thin, **asked)["theta"].values.tolist() == xd.refine(PENDULUM, **asked)["theta"].values.tolist()
    with pytest.raises(xd.InputError, match="keep_every is of `simulate` and `xdynamics run`"):
        xd.refine(thin, **asked, keep_every=5)
    with pytest.raises(
        xd.InputError, match="keep_every says how whole runs are recorded, and keep has none: add 'log'"
    ):
        xd.sweep(thin, {"method": ["rk4", "heun"]}, keep_every=5)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (0, "keep_every is 0, needs a whole number from 1"),
        (-3, "keep_every is -3, needs a whole number from 1"),
        (2.5, "keep_every is 2.5, needs a whole number"),
        ("often", "keep_every is 'often', needs a number"),
        (True, "keep_every is True, needs a number"),
        (float("nan"), "keep_every is nan, needs a whole number"),
        (float("inf"), "keep_every is inf, needs a whole number"),
        (2**60, "keep_every is 1152921504606846976, needs a whole number from 1"),
        ([2], r"keep_every is \[2\], needs a number"),
    ],
)
def test_wrong_distance_is_refused(given: Any, said: str) -> None:
    """Assert one line with the value and what is needed."""
    with pytest.raises(xd.InputError, match=said):
        xd.simulate(PENDULUM, method="rk4", step=1e-2, until=1.0, keep_every=given)


@pytest.mark.parametrize("given", ["0", "-1", "2.5", '"ten"', "true"])
def test_wrong_distance_in_a_model_is_refused(given: str) -> None:
    """Assert that reading the model says so."""
    text = PENDULUM.to_toml()
    assert "[run]" in text
    with pytest.raises(xd.ModelError, match="keep_every is .* needs a whole number from 1"):
        xd.Model.from_text(text.replace("[run]", f"[run]\nkeep_every = {given}"))


@pytest.mark.dear
def test_command_line_keeps_one_row_in_so_many(tmp_path: Path) -> None:
    """Assert that `run --keep-every` says what it left out, and `reproduce` marches it so again."""
    path = str(tmp_path / "thin.nc")
    done = CliRunner().invoke(main, ["run", str(MODELS / "pendulum.toml"), "-o", path, "--keep-every", "100"])
    assert "one in 100 of 10009 rows of the run, and what belongs to them" in done.output, done.output
    assert CliRunner().invoke(main, ["reproduce", path]).exit_code == 0
    assert CliRunner().invoke(main, ["show", path]).exit_code == 0
    assert CliRunner().invoke(main, ["plot", path, "-o", str(tmp_path / "thin.png")]).exit_code == 0


def test_a_whole_record_says_nothing_of_it() -> None:
    """Assert that a run with all rows has not the attribute, and numbers its rows from 0."""
    run = xd.simulate(PENDULUM, method="rk4", step=1e-2, until=1.0, keep_every=1)
    assert xd.content_digest(run) == xd.content_digest(xd.simulate(PENDULUM, method="rk4", step=1e-2, until=1.0))
    assert run.step_number.values.tolist() == list(range(run.sizes["step"]))
    assert KEEP_EVERY not in run.attrs


def test_tolerances_of_columns_that_are_left_out(tmp_path: Path) -> None:
    """Assert that a run whose log has not the variable that a tolerance was given for is marched again with it."""
    path = tmp_path / "run.nc"
    atol = {"theta": "1e-9 rad", "v_theta": "1e-7 rad s-1"}
    asked: dict[str, Any] = {"method": "dop853", "rtol": 1e-5, "atol": atol, "until": 2.0}
    xd.simulate(PENDULUM, **asked, log=["theta"], path=path).close()
    assert xd.reproduce(path).attrs["identical"] == 1
    assert xd.content_digest(xd.complete(path)) == xd.content_digest(xd.simulate(PENDULUM, **asked))


COLUMNS = (
    "coordinate",
    "velocity",
    "state",
    "acceleration",
    "force",
    "energy",
    "observable",
    "reaction",
    "gap",
    "error",
    "effort",
)


@pytest.mark.every(3)
@pytest.mark.cases(400)
@pytest.mark.usefixtures("small")
def test_left_out_columns_come_back_to_the_bits(case: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert columns of random logs, their reproduction, and the whole run's digest when they are completed."""
    rng = random.Random(5000 + case)
    model, asked = drawn(rng)
    whole = xd.simulate(model, **asked)
    named = [
        str(name)
        for name, variable in whole.variables.items()
        if variable.attrs.get("role") in COLUMNS and variable.dims == ("step",)
    ]
    log: Any = rng.choice(["states", rng.sample(named, rng.randint(1, min(4, len(named))))])
    more = {"log": log, "keep_every": rng.choice([1, 1, 4, 1000]), "compress": rng.random() < 0.5}
    monkeypatch.setattr("xdynamics.march.runner.THINNED_BLOCK", rng.choice([17, 4000]))
    way, path = rng.choice(["memory", "streamed", "resumed"]), tmp_path / "run.nc"
    monkeypatch.setattr("xdynamics.archive.segments.BLOCK_ROWS", 100)
    monkeypatch.setattr(segments, "EVERY", 0.0)
    monkeypatch.setattr(segments.Segments, "patience", float("inf"))
    run = marched(model, asked | more, way, path, rng)
    rows = run["step_number"].values if "step_number" in run else np.arange(whole.sizes["step"])
    always = {
        name
        for name, variable in whole.variables.items()
        if variable.dims == ("step",) and variable.attrs.get("role") in ("time", "step_size", "flag")
    }
    of_states = {name for name in named if whole[name].attrs["role"] in ("coordinate", "velocity", "state", "error")}
    wanted = (
        always | (of_states if log == "states" else set(log)) | ({"step_number"} if "step_number" in run else set())
    )
    assert {name for name, variable in run.variables.items() if variable.dims == ("step",)} == wanted
    assert "sample_time" not in run
    for name in wanted - {"step_number"}:
        assert run[name].values.tobytes() == np.ascontiguousarray(whole[name].values[rows]).tobytes(), name
    if way == "memory":
        xd.save(run, path)
    run.close()
    assert xd.reproduce(path).attrs["identical"] == 1
    assert xd.content_digest(xd.complete(path)) == xd.content_digest(whole)


def test_missing_columns_are_named_with_what_adds_them() -> None:
    """Assert that stages which need a column that was left out name it, and `complete`."""
    asked: dict[str, Any] = {"method": "rk4", "step": 1e-2, "until": 2.0}
    run = xd.simulate(PENDULUM, **asked, log=["theta"])
    said = r"it was computed with log = \['theta'\]: `xdynamics complete RUN.nc -o WHOLE.nc`, or xdynamics.complete\(run\) in Python"
    with pytest.raises(xd.InputError, match=f"has no variable 'v_theta' of its model; {said}"):
        xd.sample(run, 0.5)
    with pytest.raises(
        xd.InputError, match=f"a diagnosis needs all columns of a run's log, and this record has not: {said}"
    ):
        xd.diagnose(run)
    states = xd.simulate(PENDULUM, **asked, log="states")
    assert float(xd.sample(states, 0.555)["theta"][0]) == float(
        xd.sample(xd.simulate(PENDULUM, **asked), 0.555)["theta"][0]
    )
    ball = xd.Model.from_toml(MODELS / "moving_table.toml")
    bare = xd.simulate(ball, log=["y"], until="1 s")
    with pytest.raises(xd.InputError, match="cannot be extended, it has no v_y"):
        xd.extend(bare, until="2 s")
    assert xd.content_digest(xd.extend(run, until=3.0)) == xd.content_digest(
        xd.simulate(PENDULUM, **asked | {"until": 3.0}, log=["theta"], nodes=[2.0])
    )


def test_completed_rows_of_all_columns() -> None:
    """Assert that a record can be completed in its columns alone."""
    asked: dict[str, Any] = {"method": "rk4", "step": 1e-2, "until": 2.0}
    run = xd.simulate(PENDULUM, **asked, keep_every=10, log=["theta"])
    found = xd.complete(run, keep_every=10)
    assert xd.content_digest(found) == xd.content_digest(xd.simulate(PENDULUM, **asked, keep_every=10))


def test_what_does_not_come_out_again_is_named(tmp_path: Path) -> None:
    """Assert that a record whose rows are of another run is not completed by this one's."""
    from cases.odd import changed

    def harm(run: xr.Dataset) -> None:
        run["theta"].values[3] += 1e-9

    run = xd.simulate(PENDULUM, method="rk4", step=1e-2, until=2.0, log=["theta"])
    path = changed(xd.save(run, tmp_path / "run.nc"), tmp_path / "harmed.nc", harm)
    with pytest.raises(xd.ArchiveError, match="'theta' gives other bits than those kept"):
        xd.complete(path)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (
            "everything",
            r"log is 'everything'; there are 'full', 'states', or a list of variables, like \['everything'\]",
        ),
        ([], r"log is \[\], needs 'full', 'states' or a list"),
        ([1], r"log is \[1\], needs 'full', 'states' or a list"),
        (3, "log is 3, needs 'full', 'states' or a list"),
        (["theeta"], "log names 'theeta', which is no column of this run's log.*theta"),
        (["event_time"], "log names 'event_time', which is no column"),
        (["m"], "log names 'm', which is no column"),
    ],
)
def test_wrong_log_is_refused(given: Any, said: str, tmp_path: Path) -> None:
    """Assert one line with what there is, before anything is marched or written."""
    for more in ({}, {"path": tmp_path / "run.nc"}):
        with pytest.raises(xd.InputError, match=said):
            xd.simulate(PENDULUM, method="rk4", step=1e-2, until=1.0, log=given, **more)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("given", ["1", '"zlib"', '["x"]'])
def test_wrong_compression_is_refused(given: str) -> None:
    """Assert that compress is true or false, in Python and in a model."""
    with pytest.raises(xd.InputError, match="compress is 1, needs true or false"):
        xd.simulate(PENDULUM, method="rk4", step=1e-2, until=1.0, compress=1)  # type: ignore[arg-type]
    with pytest.raises(xd.ModelError, match="compress is .* needs true or false"):
        xd.Model.from_text(PENDULUM.to_toml().replace("[run]", f"[run]\ncompress = {given}"))


@pytest.mark.dear
def test_compressed_archive_has_the_same_digest_in_fewer_bytes(tmp_path: Path) -> None:
    """Assert the digest, that it is verified, signed, resumed and read with another process's care, and what it says of itself."""
    asked: dict[str, Any] = {"method": "rk4", "step": 1e-3, "until": 20.0}
    plain, small = (tmp_path / f"{name}.nc" for name in ("plain", "small"))
    xd.simulate(PENDULUM, **asked, path=plain).close()
    with xd.simulate(PENDULUM, **asked, path=small, compress=True) as run:
        assert run.attrs["archive_compression"].startswith("zlib")
        assert xd.content_digest(run) == verified(plain) == verified(small)
        assert xd.save(run, tmp_path / "again.nc").stat().st_size < 0.7 * plain.stat().st_size
        xd.save(run, tmp_path / "loose.nc", compress=False)
    assert small.stat().st_size < 0.6 * plain.stat().st_size < 0.7 * (tmp_path / "loose.nc").stat().st_size
    from xdynamics.archive import sandboxed_reading
    from xdynamics.archive.seals import tail_of

    found = sandboxed_reading._EXAMINER.examine(small, tail_of(small))
    assert (found.faults, found.digest) == ((), verified(plain))


@pytest.mark.dear
def test_compressed_zeros_are_read_however_many(tmp_path: Path) -> None:
    """Assert that what compresses best, a body at rest in many columns, stays within what a reader takes for sound."""
    from xdynamics.archive import sandboxed_reading
    from xdynamics.archive.seals import tail_of

    names = [f"q{i}" for i in range(12)]
    still = xd.Model(
        name="Still",
        coordinates=dict.fromkeys(names, "m"),
        parameters={"m": "1 kg"},
        mass=dict.fromkeys(names, "m"),
        initial=dict.fromkeys(names, "0 m") | {f"v_{name}": "0 m s-1" for name in names},
        forces={"none": dict.fromkeys(names, "0*newton")},
    )
    path = tmp_path / "still.nc"
    xd.simulate(still, method="rk4", step=0.5, until=100_000.0, force_samples="none", path=path, compress=True).close()
    found = sandboxed_reading._EXAMINER.examine(path, tail_of(path))
    assert found.faults == ()


@pytest.mark.cases(400)
@pytest.mark.usefixtures("small")
def test_times_are_sampled_while_marching(case: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert what `sample` gives of the whole run, to the bits, at random times, accepted ones, those of events and of both ends."""
    rng = random.Random(9000 + case)
    model, asked = drawn(rng)
    whole = xd.simulate(model, **asked)
    monkeypatch.setattr("xdynamics.march.runner.THINNED_BLOCK", rng.choice([5, 17, 4000]))
    end = asked["until"]
    pool = [*whole["event_time"].values, *whole["time"].values, float(model.initial["t"].si), end]
    times = [rng.uniform(0.0, end) for _ in range(rng.choice([1, 10, 300]))] + rng.sample(pool, min(len(pool), 20))
    times = [time for time in times if time <= end]
    found = xd.simulate(model, **asked, times=times)
    expected = xd.sample(whole, [time for time in times if time <= float(whole["time"][-1])])
    assert {str(name): variable.values.tobytes() for name, variable in found.variables.items()} == {
        str(name): variable.values.tobytes() for name, variable in expected.variables.items()
    }
    assert [variable.attrs for variable in found.variables.values()] == [
        variable.attrs for variable in expected.variables.values()
    ]


def test_times_of_a_file_without_its_rows_are_refused(tmp_path: Path) -> None:
    """Assert one line before anything is marched or written, in Python and on the command line."""
    path = tmp_path / "run.nc"
    for more, word in (({"keep_every": 10}, "keep_every"), ({"log": ["theta"]}, "log")):
        with pytest.raises(xd.InputError, match=f"leave out times or {word}"):
            xd.simulate(PENDULUM, method="rk4", step=1e-2, until=1.0, times=[0.5], path=path, **more)
    done = CliRunner().invoke(
        main, ["run", str(MODELS / "pendulum.toml"), "-o", str(path), "--keep-every", "9", "--times", "0:1:3 s"]
    )
    assert (done.exit_code, list(tmp_path.iterdir())) == (2, [])
    assert "leave out times or keep_every" in done.output

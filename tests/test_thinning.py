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
from problems import MODELS
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
    return np.flatnonzero(grid | ends | np.isin(numbers, named) | np.isin(time, nodes) | (whole["row_kind"].values >= EVENT_BEFORE))  # fmt: skip


def thinned(whole: xr.Dataset, rows: np.ndarray[Any, Any], names: Any) -> dict[str, bytes]:
    """Return the bytes that variables of a run are to have of which these rows are kept."""
    found = {}
    for name in names:
        one = whole[name]
        if one.dims == ("step",):
            values = one.values[rows]
        elif one.dims in (("trial",), ("sample",)):
            owner = whole[f"{one.dims[0]}_step"].values
            values = one.values[np.isin(owner, rows)]
            values = np.searchsorted(rows, values) if name.endswith("l_step") or name == "sample_step" else values
        else:
            values = np.searchsorted(rows, one.values) if name.startswith("event_row") else one.values
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
    monkeypatch.setattr("xdynamics.archive.streaming.BLOCK_ROWS", block)
    monkeypatch.setattr(segments, "EVERY", 0.0)
    monkeypatch.setattr(segments.Segments, "patience", float("inf"))
    path = tmp_path / "run.nc"
    run = marched(model, asked | {"keep_every": every}, way, path, rng)
    rows = kept(whole, every, asked.get("nodes", []))
    np.testing.assert_array_equal(run["step_number"], rows)
    names = [name for name, one in whole.variables.items() if one.dims and one.dims[0] in ("step", "trial", "event", "sample")]  # fmt: skip
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
    with pytest.raises(xd.InputError, match="a diagnosis needs every row of the march, and this record has one in 10"):
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
    with pytest.raises(xd.InputError, match="keep_every is of `simulate` and `xdynamics run`"):
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


def test_command_line_keeps_one_row_in_so_many(tmp_path: Path) -> None:
    """Assert that `run --keep-every` says what it left out, and `reproduce` marches it so again."""
    path = str(tmp_path / "thin.nc")
    done = CliRunner().invoke(main, ["run", str(MODELS / "pendulum.toml"), "-o", path, "--keep-every", "100"])
    assert "one in 100 of" in done.output, done.output
    assert CliRunner().invoke(main, ["reproduce", path]).exit_code == 0
    assert CliRunner().invoke(main, ["show", path]).exit_code == 0
    assert CliRunner().invoke(main, ["plot", path, "-o", str(tmp_path / "thin.png")]).exit_code == 0


def test_a_whole_record_says_nothing_of_it() -> None:
    """Assert that a run with all rows has neither the attribute nor the variable."""
    run = xd.simulate(PENDULUM, method="rk4", step=1e-2, until=1.0, keep_every=1)
    assert xd.content_digest(run) == xd.content_digest(xd.simulate(PENDULUM, method="rk4", step=1e-2, until=1.0))
    assert "step_number" not in run
    assert KEEP_EVERY not in run.attrs

"""Laziness of every stage: described from arrays that cannot be read, then read and marched once."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

import dask
import pytest
import xarray as xr

import xdynamics as xd
from cases.chunked import UnreadError, chunked, unread
from cases.problems import MODELS
from cases.stages import assert_same_bits, marches, no_march
from xdynamics.evidence import modes
from xdynamics.evidence.stages import is_lazy
from xdynamics.methods import METHODS
from xdynamics.stability import spectrum

OSCILLATOR = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
ASKED: dict[str, Any] = {"method": "rk4", "step": 0.1, "until": 12.0}
DATA = {"time [s]": [0.5, 1.0], "x [m]": [0.5, -0.4]}
Stage = Callable[..., xr.Dataset]


@pytest.fixture(autouse=True)
def _few_methods(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let `modes` seek the largest steps of two methods alone: of all they take a second."""
    for module in (modes, spectrum):
        monkeypatch.setattr(module, "METHODS", {name: METHODS[name] for name in ("rk4", "velocity_verlet")})


def data() -> Any:
    """Measured data of the oscillator."""
    import pandas as pd

    return pd.DataFrame(DATA)


# stages of one run; what `compute` says is added
OF_RUNS: dict[str, Stage] = {
    "sample": lambda run, **how: xd.sample(run, [0.25, 1.75], **how),
    "sample beside": lambda run, **how: xd.sample(run, [0.25], companion=True, **how),
    "compare": lambda run, **how: xd.compare(run, tighter(), [0.25, 1.0], **how),
    "compare data": lambda run, **how: xd.compare(run, data(), **how),
    "companion": lambda run, **how: xd.companion(run, [1.0], **how),
    "diagnose": lambda run, **how: xd.diagnose(run, companion=False, occurrences=3, **how),
    "modes": lambda run, **how: xd.modes(run, row=5, **how),
}
OF_SWEEPS: dict[str, Stage] = {
    "contrast": lambda sweep, **how: xd.contrast(sweep, "k", **how),
    "convergence": lambda sweep, **how: xd.convergence(sweep, "step", **how),
    "influences": xd.influences,
    "precision": lambda sweep, **how: xd.precision(sweep, "step", **how),
    "sensitivities": xd.sensitivities,
}
OF_MODELS = {  # tests/evidence/test_graphs.py, tests/sweeping/test_surveying.py: from models, where every march fails
    *("simulate", "refine", "error_budget", "certify", "validate", "limiting", "ragged", "sobol_indices", "fit"),
    *("sweep", "enclose"),  # the last in tests/evidence/test_enclosure.py
}
NUMBERS_NEEDED = {
    "animate": "draws a film frame by frame",
    "bundle": "writes files",
    "check": "reads no values",
    "cluster": "is where stages are computed",
    "complete": "computes a run again to the bit, for a record",
    "content_digest": "is of values",
    "discard": "deletes files",
    "document": "writes a page",
    "extend": "marches on from the last row of a record",
    "manufactured": "makes a model",
    "member": "opens an archived run",
    "open_logs": "opens archived runs, lazily",
    "open_run": "opens an archive, lazily with chunks=",
    "open_runs": "opens archived runs, lazily",
    "open_sweep": "opens a catalogue, lazily with chunks=",
    "plot": "draws",
    "recheck": "is a verdict",
    "report": "computes stages in one graph",
    "reproduce": "is a verdict",
    "save": "writes a file",
    "save_many": "writes files",
    "sign": "signs a file",
    "solve": "is scipy's solve_ivp",
    "verify": "is a verdict",
    "verify_signature": "is a verdict",
}


def marched() -> xr.Dataset:
    """A run in memory."""
    return xd.simulate(OSCILLATOR, **ASKED)


def tighter() -> xr.Dataset:
    """Another run that is still to be marched."""
    return xd.simulate(OSCILLATOR, **ASKED | {"step": 0.05}, compute=False)


def grid() -> xr.Dataset:
    """A sweep that is still to be marched."""
    return xd.sweep(OSCILLATOR, {"k": "1:2:3 N m-1", "step": "40, 20, 10 ms"}, method="rk4", until="1 s", keep=["end"])


def test_every_public_verb_is_a_stage_or_listed() -> None:
    """Assert that whatever takes `compute` is in a list of stages here, and that all other verbs say why they are none."""
    verbs = {name for name in xd.__all__ if inspect.isfunction(getattr(xd, name))}
    stages = {name for name in verbs if "compute" in inspect.signature(getattr(xd, name)).parameters}
    tested = {name.partition(" ")[0] for name in OF_RUNS} | {*OF_SWEEPS} | OF_MODELS
    assert stages | {"sweep"} == tested
    assert verbs - tested == {*NUMBERS_NEEDED}


@pytest.mark.every(3)
@pytest.mark.parametrize("name", OF_RUNS)
def test_a_stage_of_a_run_is_described_without_reading_it(name: str) -> None:
    """Assert names and units of the computed stage from arrays that cannot be read, which are read when it is computed."""
    run = marched()
    with no_march():
        stage = OF_RUNS[name](unread(run), compute=False)
        unmarched = OF_RUNS[name](xd.simulate(OSCILLATOR, **ASKED, compute=False), compute=False)
    assert is_lazy(stage)
    with pytest.raises(UnreadError, match="is read"):
        stage.compute(scheduler="synchronous")
    found = OF_RUNS[name](run, compute=True)
    for described in (stage, unmarched):
        assert {*found.variables} <= {*described.variables}
        assert [found[name].attrs["units"] for name in found] == [described[name].attrs["units"] for name in found]


@pytest.mark.every(3)
@pytest.mark.parametrize("name", OF_RUNS)
def test_a_stage_of_a_run_reads_each_chunk_once(name: str) -> None:
    """Assert the bits of the run in memory, and that no chunk of a variable is read twice."""
    run = marched()
    lazy, reads = chunked(run, [3, 11, run.sizes["step"] - 14])
    found = OF_RUNS[name](lazy, compute=False).compute(scheduler="synchronous")
    assert_same_bits(found, OF_RUNS[name](run, compute=True))
    assert reads
    assert {*reads.values()} == {1}


@pytest.mark.every(11)
@pytest.mark.parametrize("name", OF_RUNS)
def test_a_file_behind_a_stage_may_be_closed_and_replaced(name: str, tmp_path: Path) -> None:
    """Assert the numbers of the run that was described, whatever has taken the name of its file."""
    run, path = marched(), tmp_path / "run.nc"
    xd.save(run, path)
    opened = xd.open_run(path, chunks={"step": 40})
    stage = OF_RUNS[name](opened, compute=False)
    opened.close()
    xd.save(tighter(), tmp_path / "other.nc")
    (tmp_path / "other.nc").replace(path)
    assert_same_bits(stage, OF_RUNS[name](run, compute=True))


@pytest.mark.dear
def test_stages_of_an_unmarched_run_march_it_once() -> None:
    """Assert one march of the run for all stages of it, and one of each run beside it, in one graph."""
    run = xd.simulate(OSCILLATOR, **ASKED, compute=False)
    with no_march():
        stages = [make(run, compute=False) for make in OF_RUNS.values()]
    with marches() as begun:
        dask.compute(run, *stages)
    oscillator = "Harmonic oscillator rk4"
    assert sorted(begun) == [f"{oscillator} 0.05"] * 2 + [f"{oscillator} 0.1"]


@pytest.mark.parametrize("name", OF_SWEEPS)
def test_a_survey_is_described_without_reading_the_sweep(name: str) -> None:
    """Assert it of arrays that cannot be read and of members that are still to be marched."""
    with no_march():
        sweep = grid()
        OF_SWEEPS[name](sweep, compute=False)
    whole = sweep.compute()
    stage = OF_SWEEPS[name](unread(whole), compute=False)
    found = OF_SWEEPS[name](whole, compute=True)
    assert {name: (entry.dims, entry.shape) for name, entry in found.data_vars.items()} == {
        name: (entry.dims, entry.shape) for name, entry in stage.data_vars.items()
    }
    with pytest.raises(UnreadError, match="is read"):
        stage.compute(scheduler="synchronous")


def test_a_fit_is_refused_with_its_remedy() -> None:
    """Assert that nothing is marched for a search whose length nobody knows."""
    with no_march(), pytest.raises(xd.InputError, match="known only once it ends: compute it, and give the model"):
        xd.fit(OSCILLATOR, data(), parameters=["k"], compute=False, **ASKED)

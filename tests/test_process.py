"""What a long process keeps of models, sweeps and files that are gone: nothing that grows."""

from __future__ import annotations

import gc
import resource
import weakref
from pathlib import Path

import pytest
import xarray as xr

import xdynamics as xd
from xdynamics.archive import sandboxed_reading
from xdynamics.kernels import Law, machine
from xdynamics.march.configuration import settings_for
from xdynamics.sweeping import tasks

MODELS = Path(__file__).parents[1] / "data" / "models"


@pytest.mark.dear
def test_code_of_lanes_goes_with_its_law(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that one law makes each stride once and keeps it, and that its code is freed with the law."""
    made: list[weakref.ref[machine.Code]] = []
    compiled = machine.compiled

    def watched(*given: object) -> machine.Code:
        code = compiled(*given)
        made.append(weakref.ref(code))
        return code

    monkeypatch.setattr(machine, "compiled", watched)
    model = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
    law = Law(settings_for(model, method="rk4", step=0.01, until=1.0).layout(model), sampled=False)
    first = law.stride_address(4, adaptive=False)
    assert law.stride_address(4, adaptive=False) == first != law.stride_address(8, adaptive=False)
    assert len(made) == 2
    gc.collect()
    assert all(one() is not None for one in made)
    del law
    gc.collect()
    assert all(one() is None for one in made)


@pytest.mark.dear
def test_compiling_keeps_no_memory() -> None:
    """Assert that forty texts leave less than half of what LLVM's passes of one such text take, 30 kB, each."""

    def resident() -> int:
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()

    def compile_texts(count: int) -> None:
        for k in range(count):
            machine.build_object(f"define double @f{k}(double %x) {{ ret double %x }}")

    compile_texts(20)
    gc.collect()
    before = resident()
    compile_texts(40)
    gc.collect()
    assert resident() - before < 40 * 15_000


@pytest.mark.dear
def test_digests_of_blocks_go_with_their_sweep() -> None:
    """Assert that they are there as long as a record of the sweep is, whose values they vouch for, and no longer."""
    model = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
    before = set(tasks._DIGESTS_BY_TOKEN)
    grid = xd.sweep(model, {"k": ["1 N m-1", "2 N m-1", "3 N m-1"]}, method="rk4", step="0.01 s", until="0.3 s")
    token = next(iter(set(tasks._DIGESTS_BY_TOKEN) - before))
    found = grid.compute()
    del grid
    gc.collect()
    assert tasks._DIGESTS_BY_TOKEN[token]
    del found
    gc.collect()
    assert token not in tasks._DIGESTS_BY_TOKEN


def test_a_computed_sweep_is_saved_as_it_came(tmp_path: Path) -> None:
    """Assert that what was computed here is known as such when it is saved, and an edited value is refused."""
    model = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
    grid = xd.sweep(model, {"k": ["1 N m-1", "2 N m-1"]}, method="rk4", step="0.01 s", until="0.3 s").compute()
    xd.save(grid, tmp_path / "grid.nc")
    edited = grid.assign(end_x=(grid.end_x.dims, grid.end_x.values + 1.0, grid.end_x.attrs))
    with pytest.raises(xd.InputError, match="end_x"):
        xd.save(edited, tmp_path / "edited.nc")


def test_files_used_longest_ago_are_forgotten(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Assert that so many files are known, those used last, and that one that was forgotten is read all the same."""
    monkeypatch.setattr(sandboxed_reading, "MOST_KNOWN", 2)
    monkeypatch.setattr(sandboxed_reading, "_known_seals", type(sandboxed_reading._known_seals)())
    run = xd.simulate(xd.Model.from_toml(MODELS / "harmonic_oscillator.toml"), method="rk4", step=0.1, until=0.3)
    paths = [xd.save(run.assign_attrs(title=str(i)), tmp_path / f"{i}.nc", derived="titles") for i in range(2)]
    assert len(sandboxed_reading._known_seals) == 2
    with xd.open_run(paths[0]):
        pass
    first = list(sandboxed_reading._known_seals)[-1]  # used last
    paths.append(xd.save(run.assign_attrs(title="2"), tmp_path / "2.nc", derived="titles"))
    assert len(sandboxed_reading._known_seals) == 2
    assert first in sandboxed_reading._known_seals
    with xd.open_run(paths[1]) as forgotten:
        assert isinstance(forgotten, xr.Dataset)
        assert forgotten.attrs["title"] == "1"

"""Archives: whole or not at all, damage found, streamed equals saved."""

from __future__ import annotations

import os
import random
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS, free, oscillator
from cases.verdicts import verified


def short(step: float = 0.01, until: float = 2.0) -> xr.Dataset:
    """A small oscillator run."""
    return xd.simulate(oscillator().model, step=step, until=until)


@pytest.fixture(scope="module")
def archived(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One archive for all tests that only read."""
    path = tmp_path_factory.mktemp("archive") / "run.nc"
    xd.save(short(), path)
    return path


def test_opened_equals_in_memory(archived: Path) -> None:
    """Assert that every bit and attribute comes back."""
    kept, made = xd.open_run(archived), short()
    for name, variable in made.variables.items():
        found = kept.variables[name]
        assert found.dims == variable.dims, name
        if variable.dtype.kind != "U":
            assert found.dtype == variable.dtype, name
            assert found.values.tobytes() == np.ascontiguousarray(variable.values).tobytes(), name
    assert kept.model_toml.values.item() == made.model_toml.values.item()
    assert xd.content_digest(kept) == xd.content_digest(made) == kept.attrs["content_digest"]


def test_saving_an_opened_run_keeps_its_digest(archived: Path, tmp_path: Path) -> None:
    """Assert that a copy through xarray is the same record."""
    xd.save(xd.open_run(archived), tmp_path / "copy.nc")
    assert verified(tmp_path / "copy.nc") == verified(archived)


def test_streamed_equals_saved(tmp_path: Path) -> None:
    """Assert that a run streamed to disk in several blocks has the content of one saved from memory."""
    model = xd.Model.from_toml(MODELS / "pendulum.toml")
    settings = {"step": 2e-5, "until": 10.0}
    streamed = xd.simulate(model, **settings, path=tmp_path / "streamed.nc")
    assert streamed.sizes["step"] > 3 * 131_072
    assert streamed.attrs["content_digest"] == xd.content_digest(xd.simulate(model, **settings))
    assert verified(tmp_path / "streamed.nc") == streamed.attrs["content_digest"]


def test_damage_is_found_and_named(archived: Path, tmp_path: Path) -> None:
    """Assert that a changed value is found, with the variable's name."""
    import netCDF4

    path = tmp_path / "damaged.nc"
    shutil.copy(archived, path)
    with netCDF4.Dataset(path, "a") as file:
        file["x"][7] = np.nextafter(file["x"][7], 2)
    with pytest.raises(xd.ArchiveError, match="variable 'x' differs from its digest") as told:
        xd.verify(path)
    assert told.value.verdict == "edited"
    with pytest.warns(xd.EditedWarning, match="was edited since it was archived: variable 'x' differs from its digest"):
        run = xd.open_run(path)
    with pytest.raises(xd.InputError, match="variable 'x' differs from its digest"):
        xd.save(run, tmp_path / "again.nc")
    xd.save(run, tmp_path / "again.nc", derived="x edited")
    assert xd.open_run(tmp_path / "again.nc").attrs["derived_from"] == verified(archived)


@pytest.mark.parametrize("attribute", ["solver_method", "title"])
def test_changed_attribute_is_found(archived: Path, tmp_path: Path, attribute: str) -> None:
    """Assert that settings are sealed too."""
    import netCDF4

    path = tmp_path / "damaged.nc"
    shutil.copy(archived, path)
    with netCDF4.Dataset(path, "a") as file:
        file.setncattr(attribute, "other")
    with pytest.raises(xd.ArchiveError, match="attributes"):
        xd.verify(path)


def test_no_truncation_passes(archived: Path, tmp_path: Path) -> None:
    """Assert that an archive cut anywhere is refused."""
    whole = archived.read_bytes()
    path = tmp_path / "cut.nc"
    for n in random.Random(1).sample(range(len(whole)), 12):
        path.write_bytes(whole[:n])
        with pytest.raises(xd.ArchiveError, match="damaged or no run archive"):
            xd.verify(path)


@pytest.mark.parametrize("what", ["missing", "directory", "text"])
def test_no_archive_at_all(tmp_path: Path, what: str) -> None:
    """Assert that a missing file, a directory and a text are each named."""
    path = tmp_path / what
    if what == "directory":
        path.mkdir()
    if what == "text":
        path.write_text("time,y\n0,1\n")
    with pytest.raises(xd.InputError, match="does not exist|is a directory|no run archive"):
        xd.open_run(path)


def test_foreign_netcdf_is_no_archive(tmp_path: Path) -> None:
    """Assert that somebody else's netCDF file is told from a run."""
    xr.Dataset({"a": ("n", [1.0])}).to_netcdf(tmp_path / "foreign.nc", engine="netcdf4")
    with pytest.raises(xd.ArchiveError, match="attribute 'content_digest' is missing"):
        xd.verify(tmp_path / "foreign.nc")


def test_what_is_no_run_is_not_saved(tmp_path: Path) -> None:
    """Assert that a Dataset that is no record is refused and nothing is written."""
    with pytest.raises(xd.InputError, match="no run record"):
        xd.save(xr.Dataset({"a": ("n", [1.0])}), tmp_path / "no.nc")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("where", [".", "nowhere/run.nc"])
def test_target_that_cannot_be_a_file(tmp_path: Path, where: str) -> None:
    """Assert that a directory and a missing folder are refused before anything is computed."""
    with pytest.raises(xd.InputError, match="is a directory|does not exist"):
        xd.save(short(), tmp_path / where)


LIMITED = """
import os, resource, signal, sys
import xdynamics as xd
from cases.problems import oscillator
run = xd.simulate(oscillator().model, step=0.001, until=20.0)
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
for limit in map(int, sys.argv[2:]):
    child = os.fork()
    if not child:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
        try:
            xd.save(run, sys.argv[1])
        except xd.ArchiveError as error:
            print(error, flush=True)
            os._exit(3)
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 3, limit
"""


def test_failing_write_leaves_the_old_file(archived: Path, tmp_path: Path) -> None:
    """Assert that a write that fails anywhere is one error with path and cause, and the final name is untouched."""
    path, limits = tmp_path / "run.nc", ("0", "100000", "1000000")
    shutil.copy(archived, path)
    before = path.read_bytes()
    ended = subprocess.run(
        [sys.executable, "-c", LIMITED, str(path), *limits],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])},
    )
    assert ended.returncode == 0, ended.stderr
    told = ended.stdout.splitlines()
    assert len(told) == len(limits)
    assert all(str(path) in line and "nothing is changed there" in line for line in told)
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.nc"]


def test_save_never_writes_into_the_old_file(archived: Path, tmp_path: Path) -> None:
    """Assert that the name gets another file: what held the old one still holds every byte of it."""
    path, held = tmp_path / "run.nc", tmp_path / "held.nc"
    shutil.copy(archived, path)
    held.hardlink_to(path)
    xd.save(short(step=0.02), path)
    assert held.read_bytes() == archived.read_bytes()
    assert not held.samefile(path)
    assert verified(path) != verified(held)


@pytest.mark.dear
def test_memory_of_a_streamed_run_is_bounded(tmp_path: Path) -> None:
    """Assert that ten times the rows take no more than a little more memory."""
    script = (
        "import sys, resource, xdynamics as xd\nfrom cases.problems import free\n"
        "xd.simulate(free().model, method='midpoint', step=1/float(sys.argv[2]), until=1.0, path=sys.argv[1], force_samples='none')\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)"
    )
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])}
    peaks = [
        int(
            subprocess.run(
                [sys.executable, "-c", script, str(tmp_path / "run.nc"), rows],
                capture_output=True,
                text=True,
                check=True,
                env=environment,
            ).stdout
        )
        for rows in ("200000", "2000000")
    ]
    assert peaks[1] - peaks[0] < 60_000  # KiB; the larger run's log is 165 MB


def test_reproduce_names_the_first_difference(archived: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a rerun that departs is told, with variable and row."""
    from xdynamics.simulation import single_run as simulation

    again = simulation._march_again

    def departed(kept: xr.Dataset, functions: object) -> xr.Dataset:
        run = again(kept, functions).copy(deep=True)
        run["x"].values[5] += 1e-15
        return run

    monkeypatch.setattr(simulation, "_march_again", departed)
    table = xd.reproduce(archived)
    assert table.attrs["identical"] == 0
    assert table.attrs["first_difference"].startswith("variable 'x', row 5: ")


def test_a_python_force_is_handed_over_to_reproduce(tmp_path: Path) -> None:
    """Assert that archived source is never run: without the function there is an error, with it the bits."""
    from cases.problems import particle
    from cases.python_forces import stiff_push

    path = tmp_path / "python.nc"
    xd.save(xd.simulate(particle(stiff_push), method="midpoint", step=0.01, until=0.5), path)
    with pytest.raises(xd.ModelError, match="stiff_push"):
        xd.reproduce(path)
    assert xd.reproduce(path, functions={"stiff_push": stiff_push}).attrs["identical"] == 1


def test_bad_end_is_archived_too(tmp_path: Path) -> None:
    """Assert that a run that ended badly is a valid archive that reproduces."""
    model = xd.Model(
        name="blow", states={"y": {"unit": "1", "rate": "k*y**2"}}, initial={"y": "1"}, parameters={"k": "1 s-1"}
    )
    run = xd.simulate(model, method="midpoint", step=0.01, until=2.0)
    xd.save(run, tmp_path / "blow.nc")
    assert xd.reproduce(tmp_path / "blow.nc").attrs["identical"] == 1


def test_no_limits_left_behind() -> None:
    """Assert that the tests above did not limit this process."""
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] == resource.RLIM_INFINITY
    assert free().model.name == "particle"


def test_every_flipped_bit_is_found(archived: Path, tmp_path: Path) -> None:
    """Assert that no bit of an archive can change unnoticed, whether or not anything reads it."""
    from xdynamics.archive.seals import tail_of

    whole, path, moments = archived.read_bytes(), tmp_path / "flipped.nc", random.Random(3)
    assert tail_of(archived).digest
    for _ in range(300):
        damaged = bytearray(whole)
        damaged[moments.randrange(len(whole))] ^= 1 << moments.randrange(8)
        path.write_bytes(damaged)
        assert not tail_of(path).digest


def test_a_foreign_text_variable_is_named(tmp_path: Path) -> None:
    """Assert that a file with texts of any length is told from a run."""
    xr.Dataset({"a": ("n", np.array(["one", "three"], dtype=object))}).to_netcdf(tmp_path / "text.nc", engine="netcdf4")
    with pytest.raises(xd.ArchiveError, match="attribute 'content_digest' is missing"):
        xd.verify(tmp_path / "text.nc")


@pytest.mark.parametrize("name", ["n" * 300, "nul\0"])
def test_no_path_at_all(name: str) -> None:
    """Assert that what the system takes for no path is an input error."""
    for act in (xd.verify, xd.open_run, lambda path: xd.save(short(), path)):
        with pytest.raises(xd.InputError, match="no path|does not exist"):
            act(name)


def test_what_a_file_cannot_hold_is_refused(tmp_path: Path) -> None:
    """Assert that a variable or attribute without a place in netCDF is named before anything is written."""
    run = short().assign(flag=("step", np.zeros(201, bool), {"units": "1", "long_name": "x", "role": "x"}))
    run.attrs["extra"] = None
    with pytest.raises(xd.InputError, match="attribute 'extra' is 'None'"):
        xd.save(run, tmp_path / "no.nc")
    assert list(tmp_path.iterdir()) == []

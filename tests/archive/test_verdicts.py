"""What other programs do to an archive: every number intact is `repacked`, another one is `edited`, and it is said which."""

from __future__ import annotations

import random
import shutil
import subprocess
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.command_line import call
from cases.problems import MODELS, ROOT
from cases.verdicts import verified
from xdynamics.archive.integrity_checks import examine_file
from xdynamics.archive.seals import tail_of
from xdynamics.archive.signatures import new_key

OLD = ROOT / "data" / "golden" / "0.2" / "bouncing_ball_verlet.nc"
BEADS = """
name = "two beads"
[dimensions]
bead = ["left", "right"]
[coordinates]
x = { unit = "m", dims = ["bead"] }
[mass]
x = "kilogram"
[forces.spring]
x = "-kilogram/second**2*x"
[initial]
x = "metre"
[run]
method = "rk4"
step = "0.1 s"
until = "1 s"
"""


def ball() -> xd.Model:
    """A ball that bounces once."""
    return xd.Model.from_toml(MODELS / "bouncing_ball.toml")


def catalogue(folder: Path) -> Path:
    """Return the catalogue of a sweep with texts: methods, outcomes, digests."""
    grid = xd.sweep(
        ball(), {"method": ["rk4", "heun"], "e": [0.5, 0.7]}, step="10 ms", until="1 s", path=folder / "grid"
    )
    grid.close()
    return folder / "grid" / "catalogue.nc"


MADE: dict[str, Callable[[Path], Path]] = {
    "a run": lambda folder: xd.save(xd.simulate(ball(), until=1.0), folder / "run.nc"),
    "beads": lambda folder: xd.save(xd.simulate(xd.Model.from_text(BEADS)), folder / "beads.nc"),
    "of schema 1": lambda folder: Path(shutil.copy(OLD, folder / "old.nc")),
    "a selection": lambda folder: xd.save(xd.simulate(ball(), until=1.0).isel(step=slice(3, 90)), folder / "part.nc"),
    "thinned": lambda folder: xd.save(xd.simulate(ball(), until=1.0, keep_every=7), folder / "thin.nc"),
    "packed": lambda folder: xd.save(xd.simulate(ball(), until=1.0), folder / "packed.nc", compress=True),
    "a study": lambda folder: xd.save(xd.refine(ball(), steps=[0.02, 0.01, 0.005], at=[0.3]), folder / "study.nc"),
    "a sweep": catalogue,
}


@pytest.fixture(scope="module", params=MADE)
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return an archive of each kind, which tests only read."""
    return MADE[request.param](tmp_path_factory.mktemp("made"))


def tool(*words: str) -> Callable[[Path, Path], object]:
    """Return what a command does with an archive."""

    def used(path: Path, new: Path) -> None:
        if shutil.which(words[0]) is None:
            pytest.skip(f"no {words[0]} here")
        subprocess.run([*words, str(path), str(new)], check=True, capture_output=True)

    return used


def annotated(path: Path, new: Path) -> None:
    """Add a note by the library, as ncatted does, and change the history."""
    with netCDF4.Dataset(shutil.copy(path, new), "a") as file:
        file.setncatts({"comment": "by hand", "history": "edited by hand", "institution": "somewhere", "NCO": "none"})


def by_zarr(opens: Callable[[Path], xr.Dataset]) -> Callable[[Path, Path], object]:
    """Return what becomes of an archive that goes through a Zarr store."""

    def used(path: Path, new: Path) -> None:
        store = new.with_suffix(".zarr")
        with warnings.catch_warnings(action="ignore"):  # Zarr says that others may not know its texts
            opens(path).to_zarr(store)
            xr.open_zarr(store).to_netcdf(new, engine="netcdf4")

    return used


WAYS: dict[str, Callable[[Path, Path], object]] = {
    "nccopy": tool("nccopy"),
    "nccopy -d": tool("nccopy", "-d", "5", "-s"),
    "ncks": tool("ncks"),
    "ncks -L": tool("ncks", "-4", "-L", "4"),
    "ncatted": tool("ncatted", "-O", "-a", "comment,global,a,c,by hand"),
    "the library": annotated,
    "to_netcdf": lambda path, new: xd.open_run(path).to_netcdf(new, engine="netcdf4"),
    "h5netcdf": lambda path, new: xd.open_run(path).to_netcdf(new, engine="h5netcdf"),
    "xarray alone": lambda path, new: xr.open_dataset(path).to_netcdf(new, engine="netcdf4"),
    "xarray alone, h5netcdf": lambda path, new: xr.open_dataset(path).to_netcdf(new, engine="h5netcdf"),
    "Zarr and back": by_zarr(xd.open_run),
    "xarray alone, Zarr and back": by_zarr(xr.open_dataset),
}


@pytest.mark.every(5)
@pytest.mark.filterwarnings("ignore::xdynamics.KindWarning")
@pytest.mark.parametrize("way", WAYS)
def test_what_another_program_wrote_is_repacked(made: Path, way: str, tmp_path: Path) -> None:
    """Assert the same digest, the same record when it is opened, the same archive when it is saved, and no sound seal."""
    new, digest = tmp_path / "new.nc", verified(made)
    WAYS[way](made, new)
    found = xd.verify(new)
    assert (found.verdict, found.digest) == ("repacked", digest)
    shown = call("verify", new)
    assert (shown.exit_code, shown.output.startswith(f"repacked  {new}  {digest}")) == (0, True)
    run, other = xd.open_run(made), xd.open_run(new)
    assert {*run.variables} == {*other.variables}
    assert {*run.coords} == {*other.coords}
    for name in run.variables:
        one, two = run.variables[name], other.variables[name]
        assert (one.dims, one.dtype, repr(one.attrs)) == (two.dims, two.dtype, repr(two.attrs)), name
        assert np.array_equal(one.values, two.values, equal_nan=one.dtype.kind == "f"), name
    assert verified(xd.save(other, tmp_path / "again.nc")) == digest
    if "solver_method" in run.attrs and "evidence" not in run.attrs:
        assert xd.reproduce(new).attrs["identical"] == 1
    run.close()
    other.close()


def archived(folder: Path) -> Path:
    """Return an archive of the ball and its number of rows."""
    return MADE["a run"](folder)


def changed(name: str, change: Callable[[Any], object]) -> Callable[[Path], object]:
    """Change a variable in place."""

    def act(path: Path) -> None:
        with netCDF4.Dataset(path, "a") as file:
            change(file[name])

    return act


def rewritten(change: Callable[[xr.Dataset], xr.Dataset]) -> Callable[[Path], object]:
    """Change a record by way of xarray."""

    def act(path: Path) -> None:
        run = change(xd.open_run(path).load())
        run.to_netcdf(path.with_name("else.nc"), engine="netcdf4")
        run.close()
        path.with_name("else.nc").replace(path)

    return act


def globally(**attributes: Any) -> Callable[[Path], object]:
    """Change attributes of a file."""

    def act(path: Path) -> None:
        with netCDF4.Dataset(path, "a") as file:
            file.setncatts(attributes)

    return act


ATTRIBUTES = "the attributes differ from the content digest"
EDITS: dict[str, tuple[Callable[[Path], object], str]] = {
    "a value": (changed("y", lambda y: y.__setitem__(7, 2.0)), "variable 'y' differs from its digest"),
    "a time": (changed("time", lambda time: time.__setitem__(7, 2.0)), "variable 'time' differs from its digest"),
    "a parameter": (changed("g", lambda g: g.__setitem__((), 9.0)), "variable 'g' differs from its digest"),
    "a unit": (changed("y", lambda y: y.setncattr("units", "km")), ATTRIBUTES),
    "a scale": (changed("y", lambda y: y.setncattr("scale_factor", 2.0)), ATTRIBUTES),
    "a setting": (globally(solver_method="rk4"), ATTRIBUTES),
    "a word of records": (globally(derived="x scaled by 2"), ATTRIBUTES),
    "a title": (globally(title="another"), ATTRIBUTES),
    "by xarray": (rewritten(lambda run: run.assign(y=2.0 * run.y)), "variable 'y' differs from its digest"),
    "without one": (
        rewritten(lambda run: run.drop_vars("v_y")),
        "variable 'v_y' is missing, of which there is a digest",
    ),
    "with one more": (rewritten(lambda run: run.assign(z=run.y)), "variable 'z' differs from its digest"),
    "fewer rows": (rewritten(lambda run: run.isel(step=slice(1, None))), "variable 'y' differs from its digest"),
    "other floats": (rewritten(lambda run: run.assign(y=run.y.astype("f4"))), "variable 'y' differs from its digest"),
    "another dimension": (rewritten(lambda run: run.rename(step="row")), "variable 'y' differs from its digest"),
}


@pytest.mark.parametrize("edit", EDITS)
def test_what_was_changed_is_edited_and_named(edit: str, tmp_path: Path) -> None:
    """Assert the verdict, the name, exit code 1, and that no verb takes it for the run that was archived."""
    path = archived(tmp_path)
    digest, (act, said) = verified(path), EDITS[edit]
    act(path)
    with pytest.raises(xd.ArchiveError, match="was edited since it was archived:\n  1. ") as told:
        xd.verify(path)
    assert told.value.verdict == "edited"
    assert said in told.value.faults
    shown = call("verify", path)
    assert (shown.exit_code, said in shown.output) == (1, True)
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        try:
            run = xd.open_run(path)
        except xd.ArchiveError as refused:  # what is no record any more
            assert refused.verdict == "edited"  # noqa: PT017 - either is right
            return
    assert any(one.category is xd.EditedWarning and said in str(one.message) for one in heard)
    with pytest.raises(xd.InputError):
        xd.save(run, tmp_path / "again.nc")
    kept = xd.open_run(xd.save(run, tmp_path / "again.nc", derived="by hand"))
    assert digest in (kept.attrs["derived_from"], kept.attrs["content_digest"])


def test_what_an_edit_changed_is_found_by_marching_again(tmp_path: Path) -> None:
    """Assert that `reproduce` names variable and row of a value that another program changed."""
    path = archived(tmp_path)
    EDITS["a value"][0](path)
    with pytest.warns(xd.EditedWarning, match="variable 'y' differs from its digest"):
        table = xd.reproduce(path)
    assert table.attrs["identical"] == 0
    assert "'y', row 7" in table.attrs["arithmetic"]


@pytest.mark.parametrize("edit", ["a value", "a setting"])
def test_an_edit_of_schema_1_is_found(edit: str, tmp_path: Path) -> None:
    """Assert the same verdict of an archive of version 0.2."""
    path = Path(shutil.copy(OLD, tmp_path / "old.nc"))
    EDITS[edit][0](path)
    with pytest.raises(xd.ArchiveError, match="was edited since it was archived") as told:
        xd.verify(path)
    assert (told.value.verdict, told.value.faults) == ("edited", (EDITS[edit][1],))


def test_texts_of_schema_1_are_the_same_as_letters(tmp_path: Path) -> None:
    """Assert that texts that xarray wrote along a dimension which the record did not have are those of the record."""
    letters = {name: {"dtype": "S1"} for name in ("model_toml", "force_source")}
    xd.open_run(OLD).to_netcdf(tmp_path / "letters.nc", engine="netcdf4", encoding=letters)
    with netCDF4.Dataset(tmp_path / "letters.nc") as file:
        assert file["model_toml"].dtype == "S1"
    found = xd.verify(tmp_path / "letters.nc")
    assert (found.verdict, found.digest) == ("repacked", verified(OLD))


def test_notes_are_free_in_memory_too(tmp_path: Path) -> None:
    """Assert that what ACDD says beside the record can be added to a run, is kept, and changes no digest."""
    run = xd.simulate(ball(), until=1.0)
    digest = verified(xd.save(run, tmp_path / "run.nc"))
    run.attrs |= {"institution": "somewhere", "license": "CC-BY-4.0", "creator_name": "A. B.", "comment": "first try"}
    assert verified(xd.save(run, tmp_path / "noted.nc")) == digest
    kept = xd.open_run(tmp_path / "noted.nc")
    assert kept.attrs["institution"] == "somewhere"
    kept.attrs["comment"] = "second try"
    assert verified(xd.save(kept, tmp_path / "noted again.nc")) == digest


def test_an_attribute_of_somebody_is_a_note(tmp_path: Path) -> None:
    """Assert that one attribute more that says nothing to readers here stands beside the record."""
    path = archived(tmp_path)
    globally(lab_book="p. 7")(path)
    assert xd.verify(path).verdict == "repacked"
    assert xd.open_run(path).attrs["lab_book"] == "p. 7"


def test_a_run_that_was_never_archived_has_no_digest(tmp_path: Path) -> None:
    """Assert one line for what `to_netcdf` made of a run in memory."""
    xd.simulate(ball(), until=1.0).to_netcdf(tmp_path / "run.nc", engine="netcdf4")
    with pytest.raises(xd.ArchiveError, match="no run archive") as told:
        xd.verify(tmp_path / "run.nc")
    assert told.value.faults == ("attribute 'content_digest' is missing, which xd.save writes",)
    assert told.value.verdict == "damaged"


def test_a_repacked_archive_is_not_signed(tmp_path: Path) -> None:
    """Assert that a signature is of a file with its seal, and the remedy."""
    path = archived(tmp_path)
    annotated(path, tmp_path / "new.nc")
    new_key(tmp_path / "key.pem")
    with pytest.raises(xd.ArchiveError, match=r"is repacked: .* xd.save\(xd.open_run\(…\), …\) seals it again"):
        xd.sign(tmp_path / "new.nc", tmp_path / "key.pem")


def test_no_flipped_bit_passes_without_a_seal(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    """Assert that of a file without a seal every number is right, or something is said: of 2,000 flips with --whole."""
    path, flipped = archived(tmp_path), tmp_path / "flipped.nc"
    annotated(path, flipped)
    whole, moments = flipped.read_bytes(), random.Random(5)
    assert xd.verify(flipped).verdict == "repacked"
    run, counts = xd.open_run(path).load(), dict.fromkeys(("repacked", "edited", "damaged"), 0)
    for _ in range(2000 if request.config.getoption("--whole") else 150):
        content = bytearray(whole)
        content[moments.randrange(len(whole))] ^= 1 << moments.randrange(8)
        flipped.write_bytes(content)
        try:
            counts[str(xd.verify(flipped).verdict.item())] += 1
        except xd.ArchiveError as error:
            counts[error.verdict] += 1
            continue
        other = xd.open_run(flipped)
        for name, variable in run.variables.items():
            assert variable.values.tobytes() == other.variables[name].values.tobytes(), name
        other.close()
    assert counts["edited"]
    assert counts["damaged"]


def test_damage_under_a_seal_is_damage(tmp_path: Path) -> None:
    """Assert that a byte that changed beneath the seal is no edit, with the names of what it hit."""
    path = archived(tmp_path)
    with netCDF4.Dataset(path) as file:
        pattern = np.asarray(file["y"][:40]).tobytes()
    content = path.read_bytes()
    place = content.index(pattern) + 100
    path.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
    found = examine_file(path, tail_of(path))
    assert found.verdict == "damaged"
    assert found.faults == ("the bytes of the file differ from its seal", "variable 'y' differs from its digest")
    with pytest.raises(xd.ArchiveError) as told:
        xd.open_run(path)
    assert told.value.verdict == "damaged"

"""What an archive is compared with: each fault by its name, alone and in its order."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
import pytest

import xdynamics as xd
from cases.odd import restate
from cases.problems import oscillator
from xdynamics.archive import integrity_checks
from xdynamics.archive.integrity_checks import Examination, examine_file
from xdynamics.archive.seals import Tail, tail_of

SEALED = Tail("0" * 64)  # for a file whose seal nobody is to look at
DIFFER = "the attributes differ from the content digest"
UNMARKED = "attribute 'content_digest' is missing, which xd.save writes"
DATED = "the attributes on date, versions and machine differ from their digest"


@pytest.fixture(scope="module")
def archived(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One archive for all tests, which only read it."""
    return xd.save(xd.simulate(oscillator().model, step=0.1, until=1.0), tmp_path_factory.mktemp("seen") / "run.nc")


def test_an_archive_as_it_was_written(archived: Path) -> None:
    """Assert no fault, the digest and how the run ended."""
    digest = xd.content_digest(xd.simulate(oscillator().model, step=0.1, until=1.0))
    assert examine_file(archived, tail_of(archived)) == Examination((), digest, "completed")
    found = Examination((), digest)
    found.raise_faults(archived)


def recoded(file: Any) -> None:
    """Put a byte into a text that is no letter, with its digest."""
    text = file["model_toml"]
    text.set_auto_chartostring(False)
    text[0, 3:4] = np.array([b"\xff"])
    restate(file, "model_toml")


HARM: dict[str, tuple[Callable[[Any], object], tuple[str, ...]]] = {
    "a value": (lambda file: file["x"].__setitem__(7, 2.0), ("variable 'x' differs from its digest",)),
    "two values": (
        lambda file: (file["x"].__setitem__(7, 2.0), file["v_x"].__setitem__(0, 2.0), file.setncattr("title", "other")),
        ("variable 'x' differs from its digest", "variable 'v_x' differs from its digest"),
    ),
    "an attribute": (lambda file: file.setncattr("title", "other"), (DIFFER,)),
    "an attribute of one": (lambda file: file["x"].setncattr("units", "km"), (DIFFER,)),
    "a date": (lambda file: file.setncattr("date_created", "later"), (DATED,)),
    "both": (lambda file: (file.setncattr("date_created", "later"), file.setncattr("title", "other")), (DIFFER, DATED)),
    "no digest": (
        lambda file: file.setncattr(
            "variable_digests", "\n".join(line for line in file.variable_digests.splitlines() if line[:2] != "x ")
        ),
        ("variable 'x' differs from its digest",),
    ),
    "other coordinates": (
        lambda file: file["v_x"].setncattr("coordinates", "x"),
        ("variable 'v_x' is not stored as it was written",),
    ),
    "a time": (lambda file: file["time"].__setitem__(2, 7.0), ("variable 'time' differs from its digest",)),
    "no root digest": (lambda file: file.delncattr("content_digest"), (UNMARKED,)),
    "no digests": (
        lambda file: (
            file.delncattr("content_digest"),
            file.delncattr("volatile_digest"),
            file["x"].__setitem__(7, 2.0),
        ),
        (
            UNMARKED,
            "attribute 'volatile_digest' is missing",
            "variable 'x' differs from its digest",
        ),
    ),
    "an origin": (lambda file: file.setncattr("origin", "trust me"), ("attribute 'origin' is none of an archive",)),
    "a group": (lambda file: file.createGroup("more"), ("group 'more' is none of a run",)),
    "a coordinate": (
        lambda file: file["x"].setncattr("coordinates", "v_x"),
        ("variable 'x' is not stored as it was written",),
    ),
    "an encoding": (
        lambda file: file["model_toml"].setncattr("_Encoding", "latin-1"),
        ("variable 'model_toml' is not stored as it was written",),
    ),
    "letters elsewhere": (
        lambda file: file.renameDimension("model_toml_characters", "more"),
        ("variable 'model_toml' is not stored as it was written",),
    ),
    "no letters": (recoded, ("variable 'model_toml' is no text in UTF-8: invalid start byte at 3",)),
}


HARMED = ("no root digest", "no digests", "a group", "no letters")  # of which a file cannot say what it was
MANNER = (
    "is not stored as",
    DATED,
    "'origin'",
    "'volatile_digest'",
)  # in which another program may keep the same record


@pytest.mark.every(3)
@pytest.mark.parametrize("what", HARM)
def test_what_was_harmed_is_named(archived: Path, tmp_path: Path, what: str) -> None:
    """Assert the faults of a file with a seal that nobody doubts, and of one without what changes the record."""
    harm, faults = HARM[what]
    path = Path(shutil.copy(archived, tmp_path / "harmed.nc"))
    with netCDF4.Dataset(path, "a") as file:
        harm(file)
    verdict = "damaged" if what in HARMED else "edited"
    assert (examine_file(path, SEALED).faults, examine_file(path, SEALED).verdict) == (faults, verdict)
    doubted = examine_file(path, Tail(fault="its seal is hurt"))
    assert (doubted.faults, doubted.verdict) == (("its seal is hurt", *faults), "damaged")
    unsealed, edits = (
        examine_file(path, Tail()),
        tuple(fault for fault in faults if not any(word in fault for word in MANNER)),
    )
    assert (unsealed.faults, unsealed.verdict) == (edits, verdict if edits else "repacked")
    said = {"edited": "was edited since it was archived", "damaged": "is damaged or no run archive"}[verdict]
    with pytest.raises(xd.ArchiveError, match=f"harmed.nc' {said}:\n  1. ") as caught:
        examine_file(path, SEALED).raise_faults(path)
    assert (caught.value.faults, caught.value.verdict) == (faults, verdict)


def test_what_is_out_of_bounds_is_not_read(archived: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that of a file that asks too much no value is looked at, and that it is said behind what is wrong with its seal."""
    path = Path(shutil.copy(archived, tmp_path / "harmed.nc"))
    with netCDF4.Dataset(path, "a") as file:
        file.createVariable("more", "f8", ("step",), compression="bzip2")
    monkeypatch.setattr(integrity_checks, "stored_digest", lambda _: 1 / 0)
    said = "variable 'more' is compressed (bzip2), which no variable of an archive is"
    assert examine_file(path, Tail(fault="its seal is hurt")).faults == ("its seal is hurt", said)


def test_what_cannot_be_read_is_told(archived: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that what the libraries say is passed on, for the file and for a variable, and an error without words by its name."""
    (tmp_path / "text.nc").write_text("time,y\n")
    found = examine_file(tmp_path / "text.nc", Tail(fault="its seal is hurt"))
    assert (found.faults[0], found.digest) == ("its seal is hurt", "")
    assert found.faults[1] == "it cannot be read: it does not begin as an HDF5 file does"

    def refuse(error: Exception) -> Callable[..., Any]:
        def raised(*_: object, **__: object) -> None:
            raise error

        return raised

    with monkeypatch.context() as patch:
        patch.setattr(integrity_checks, "stored_digest", refuse(RuntimeError("NetCDF: HDF error")))
        faults = examine_file(archived, SEALED).faults
        assert "variable 'x' cannot be read: NetCDF: HDF error" in faults
        assert DIFFER not in faults
    monkeypatch.setattr(integrity_checks, "opened_file", refuse(MemoryError()))
    assert examine_file(archived, SEALED).faults == ("it cannot be read: MemoryError",)


def test_a_value_for_nothing_is_none_of_an_archive(archived: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that an attribute that would have readers take numbers away is found, whatever digests say."""
    told = integrity_checks.attributes_of
    monkeypatch.setattr(
        integrity_checks,
        "attributes_of",
        lambda of: told(of) | ({"_FillValue": 1.0} if getattr(of, "name", "") == "x" else {}),
    )
    assert examine_file(archived, SEALED).faults == ("variable 'x' is not stored as it was written",)


def test_the_examining_process_loads_no_engine() -> None:
    """Assert that it reads files without the rooms that march, and without xarray: it is started for the first archive."""
    script = "import sys, xdynamics.archive.sandbox; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout.split()
    assert "xdynamics.archive.integrity_checks" in loaded
    assert not {"xarray", "dask", "llvmlite"} & {*loaded}
    rooms = {name.split(".")[1] for name in loaded if name.startswith("xdynamics.")}
    assert rooms == {"archive", "faults", "record", "runtime", "schema", "units"}

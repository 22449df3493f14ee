"""Archives whose digests hold and whose content is odd or hostile: one error or a clean answer, from every verb.

What an archive is compared with: each fault by its name, alone and in its order.
"""

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
import xarray as xr
from click.testing import CliRunner

import xdynamics as xd
from cases.odd import changed, restate, with_attributes
from cases.problems import MODELS, oscillator
from xdynamics.archive import integrity_checks
from xdynamics.archive.integrity_checks import Examination, examine_file
from xdynamics.archive.seals import Tail, tail_of
from xdynamics.cli import main

HOSTILE = "\x1b]0;owned\x07\x1b[2J\x9b31m\u202e\nverified  nothing.nc  $\\frac{$"


@pytest.fixture(scope="module")
def swing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short archive with an event."""
    path = tmp_path_factory.mktemp("odd") / "swing.nc"
    return xd.save(xd.simulate(xd.Model.from_toml(MODELS / "pendulum.toml"), until="3 s", step="50 ms"), path)


def answers(path: Path, good: Path) -> dict[str, tuple[int, str]]:
    """Call every verb on an archive; return exit codes and what was printed."""
    found = {}
    verbs = (
        ["verify", path],
        ["show", path],
        ["plot", path, "-o", path.with_suffix(".svg")],
        ["reproduce", path],
        ["compare", good, path],
        ["compare", path, good],
    )
    for words in verbs:
        done = CliRunner().invoke(main, [str(word) for word in words])
        assert done.exception is None or isinstance(done.exception, SystemExit), (words, done.exception)
        found[f"{words[0]} {len(found)}"] = done.exit_code, done.output
    return found


def edited(name: str, **attributes: object) -> object:
    """Return a change of a variable's attributes."""
    return lambda run: run[name].attrs.update(attributes)


def beyond(run: xr.Dataset) -> None:
    """Let an event name a row that is not there."""
    run["event_row_before"][0] = 10_000


FAULTS = {
    "short flag_meanings": (edited("event_detector", flag_meanings=""), "0 words in flag_meanings and 1 numbers"),
    "flag without a word": (edited("row_kind", flag_values=np.int8([7])), "5 words in flag_meanings and 1 numbers"),
    "event row": (beyond, "variable 'event_row_before' names row 10000 at event 0, and there are 63"),
    "no method": (with_attributes(solver_method=None), "attribute 'solver_method' is missing"),
    "title is a number": (with_attributes(title=5), "attribute 'title' is '5', needs a text"),
    "no step": (with_attributes(solver_step=None), "attribute 'solver_step' is missing"),
    "step is a text": (with_attributes(solver_step="1e-3"), "attribute 'solver_step' is '1e-3', needs a number"),
    "control": (with_attributes(solver_step_control="guess"), "'solver_step_control' is 'guess'; there are fixed"),
    "time of type f4": (
        lambda run: run.assign_coords(time=run.time.astype("f4")),
        "has the type float32, needs float64",
    ),
    "whole numbers": (
        lambda run: run.assign(theta=run.theta.astype("i4")),
        "is a coordinate along ('step',) of type int32",
    ),
    "no rows": (lambda run: run.isel(step=slice(0)), "dimension 'step' has no row"),
    "no units": (lambda run: run["theta"].attrs.pop("units") and None, "'theta' has no attribute 'units'"),
    "uncertainty": (edited("l", uncertainty="much"), "the attribute uncertainty = 'much', needs a number"),
    "no detector": (lambda run: run.drop_vars("event_detector"), "variable 'event_detector' is missing"),
    "no event time": (lambda run: run.drop_vars("event_time"), "variable 'event_time' is missing"),
}


@pytest.mark.every(23)
@pytest.mark.parametrize("what", FAULTS)
def test_an_odd_record_is_one_error_from_every_verb(swing: Path, tmp_path: Path, what: str) -> None:
    """Assert that each verb names the fault in one error and ends with 1, where the digests hold."""
    change, fault = FAULTS[what]
    for verb, (code, said) in answers(changed(swing, tmp_path / "odd.nc", change), swing).items():
        assert code == 1, verb
        assert fault in said, verb
        assert "is as it was written, but no run record" in said, verb
    with pytest.raises(xd.ArchiveError, match="no run record"):
        xd.open_run(tmp_path / "odd.nc")


# roles of variables whose units are the record's own; the bounds of a time have none
PLACED = (None, "time", "step_size", "trial", "event", "sample", "flag", "model", "index")


def hostile(run: xr.Dataset) -> xr.Dataset:
    """Put characters that a terminal obeys wherever a text can stand."""
    for name in ("title", "run_outcome", "run_outcome_text", "solver_reference", "math_functions"):
        run.attrs[name] = HOSTILE
    for variable in run.variables.values():
        variable.attrs["long_name"] = HOSTILE
        if variable.attrs.get("role") not in PLACED:
            variable.attrs["units"] = HOSTILE
    run["event_detector"].attrs["flag_meanings"] = "\x1b[31m$x_{"
    extra = {"units": "1", "long_name": "x", "role": "coordinate"}
    return run.assign({"a$_{b": ("step", np.zeros(run.sizes["step"]), extra)})


@pytest.mark.dear
def test_no_text_of_a_file_reaches_the_terminal_as_it_is(swing: Path, tmp_path: Path) -> None:
    """Assert that titles, names, units and attributes are shown written out by every verb, and drawn as they are."""
    found = answers(changed(swing, tmp_path / "odd.nc", hostile), swing)
    for verb, (code, said) in found.items():
        assert code in (0, 1, 2), verb
        assert all(one.isprintable() or one == "\n" for one in said), verb
        assert not [line for line in said.splitlines() if line.startswith("verified  nothing")], verb
    assert "\\x1b[2J\\x9b31m\\u202e\\nverified" in found["show 1"][1]
    assert "\\x1b[2J\\x9b31m\\u202e\\nverified" in (tmp_path / "odd.svg").read_text().replace("<!-- ", "")


def test_a_file_name_is_shown_written_out(swing: Path, tmp_path: Path) -> None:
    """Assert that the name of a file forges no line, be the file whole or damaged."""
    path = tmp_path / "a\nverified  b.nc\x1b[0m"
    path.write_bytes(swing.read_bytes())
    for words in (["verify", path], ["reproduce", path], ["verify", tmp_path / "gone\x1b[0m"]):
        said = CliRunner().invoke(main, [str(word) for word in words]).output
        assert len(said.splitlines()) == 1
        assert "\\x1b[0m" in said
    path.write_bytes(swing.read_bytes()[:-900])
    with pytest.raises(xd.ArchiveError, match=r"a\\nverified  b.nc\\x1b\[0m' is damaged"):
        xd.verify(path)


def test_a_command_that_is_none_is_shown_written_out() -> None:
    """Assert that what click itself complains of is written out too."""
    done = CliRunner().invoke(main, ["verify", "a.nc", "\x1b[2Jb.nc"])
    assert done.exit_code == 2
    assert "\\x1b[2Jb.nc" in done.output


def test_descriptions_keep_their_lines(tmp_path: Path) -> None:
    """Assert that where newlines are meant they stay, and the other lines stand under the first."""
    model = xd.Model(
        name="fall",
        coordinates={"y": {"unit": "m"}},
        mass={"y": "m"},
        initial={"y": "0 m", "v_y": "0 m s-1"},
        parameters={"m": {"value": "1 kg", "description": "mass\nof the ball"}},
    )
    xd.save(xd.simulate(model, method="midpoint", step=0.5, until=1.0), tmp_path / "fall.nc")
    shown = CliRunner().invoke(main, ["show", str(tmp_path / "fall.nc")]).output
    assert "  m = 1 kg   mass\n    of the ball\n" in shown


def test_a_narrow_terminal_encoding_is_no_error() -> None:
    """Assert that signs which the terminal does not have are written out."""
    done = CliRunner(charset="latin-1").invoke(main, ["help", "record"])
    assert done.exit_code == 0
    assert "\\u2026" in done.output


@pytest.mark.parametrize(
    ("name", "value", "fault"),
    [
        ("title", "a\0b", r"attribute 'title' is 'a\\x00b', needs a text without null characters"),
        ("title", "a\udcff", "attribute 'title' is"),
        ("extra", np.array([1j]), "attribute 'extra' is"),
        ("extra", np.array(["a", "b"]), "attribute 'extra' is"),
        ("extra", np.zeros((2, 2)), "attribute 'extra' is"),
        ("a/b", 1.0, "attribute 'a/b' has a name that no file can keep"),
        ("", 1.0, "attribute '' has a name that no file can keep"),
    ],
)
def test_what_a_file_cannot_keep_is_refused(tmp_path: Path, name: str, value: object, fault: str) -> None:
    """Assert that an attribute that would come back as another is named, and nothing is written."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "pendulum.toml"), until="0.1 s")
    run.attrs[name] = value
    with pytest.raises(xd.InputError, match=fault):
        xd.save(run, tmp_path / "no.nc")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.dear
def test_words_of_flags_are_found_by_their_numbers(swing: Path, tmp_path: Path) -> None:
    """Assert that numbers of flags need not begin at zero, nor a word of another version be there."""

    def shifted(run: xr.Dataset) -> xr.Dataset:
        run["trial_reason"].attrs["flag_meanings"] = (
            run["trial_reason"].attrs["flag_meanings"].replace("error_test", "late")
        )
        about = run["event_detector"].attrs | {"flag_values": np.int8([5])}
        return run.assign(event_detector=(("event",), run.event_detector.values + np.int8(5), about))

    for verb, (code, said) in answers(changed(swing, tmp_path / "odd.nc", shifted), swing).items():
        assert code in (0, 1), (verb, said)
        assert "Traceback" not in said


def test_times_that_go_back_are_refused(swing: Path, tmp_path: Path) -> None:
    """Assert that a record whose time runs backwards is none where it is opened first, nor compared where it was verified."""

    def backwards(run: xr.Dataset) -> xr.Dataset:
        return run.assign_coords(time=run.time.copy(data=run.time.values[::-1].copy()))

    path = changed(swing, tmp_path / "odd.nc", backwards)
    with pytest.raises(xd.ArchiveError, match="it must increase"):
        xd.open_run(path)
    with pytest.raises(xd.InputError, match="the times of the second run do not increase"):
        xd.compare(xd.open_run(swing), xd.open_run(path, check=False))


def test_an_end_without_its_parts_is_not_extended(swing: Path, tmp_path: Path) -> None:
    """Assert one error where a variable or the names of the end's memory are gone."""
    path = changed(swing, tmp_path / "no_angle.nc", lambda run: run.drop_vars("a_theta"))
    with pytest.raises(xd.InputError, match="it has no a_theta; extend the whole run"):
        xd.extend(path, until="4 s")
    path = changed(swing, tmp_path / "no_names.nc", lambda run: run["end_memory"].attrs.pop("names") and None)
    with pytest.raises(xd.InputError, match="it keeps no 'end_memory'"):
        xd.extend(path, until="4 s")


def test_a_bracket_has_two_ends(swing: Path) -> None:
    """Assert that a record without one of them is none."""
    with pytest.raises(xd.InputError, match="dimension 'bound' has 1 entries, needs 2"):
        xd.check(xd.open_run(swing).isel(bound=[0]))


def test_texts_are_utf_8(swing: Path, tmp_path: Path) -> None:
    """Assert that bytes that are no text are damage, though the digests hold."""
    path = tmp_path / "odd.nc"
    path.write_bytes(swing.read_bytes())
    with netCDF4.Dataset(path, "a") as file:
        text = file.variables["model_toml"]
        text.set_auto_chartostring(False)
        text[0, 3:4] = np.array([b"\xff"])
        restate(file, "model_toml")
    with pytest.raises(xd.ArchiveError, match="'model_toml' is no text in UTF-8"):
        xd.verify(path)
    with pytest.raises(xd.ArchiveError, match="variable 'model_toml' of .* is no text in UTF-8: .* at 3"):
        xd.open_run(path, check=False).load()


def test_no_archive_says_where_it_came_from(swing: Path, tmp_path: Path) -> None:
    """Assert that the one attribute that no digest covers is in no file."""
    path = changed(swing, tmp_path / "odd.nc", with_attributes(origin="trust me"))
    with pytest.raises(xd.ArchiveError, match="attribute 'origin' is none of an archive"):
        xd.verify(path)


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

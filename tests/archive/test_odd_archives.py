"""Archives whose digests hold and whose content is odd or hostile: one error or a clean answer, from every verb."""

from __future__ import annotations

from pathlib import Path

import netCDF4
import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner

import xdynamics as xd
from cases.odd import changed, restate, with_attributes
from cases.problems import MODELS
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

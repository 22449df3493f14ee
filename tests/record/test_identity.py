"""What is saved is what was marched: edited records are refused or derived data, parts of runs are selections."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner, Result

import xdynamics as xd
from cases.problems import MODELS
from cases.verdicts import verified
from xdynamics.archive import reading
from xdynamics.archive.integrity_checks import Examination
from xdynamics.archive.seals import Tail
from xdynamics.cli import main
from xdynamics.faults import KindWarning

Change = Callable[[xr.Dataset], xr.Dataset]


def swing() -> xr.Dataset:
    """A short run with an event."""
    return xd.simulate(xd.Model.from_toml(MODELS / "pendulum.toml"), until="3 s", step="50 ms")


def call(*arguments: object) -> Result:
    """Run a command in this process."""
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


@pytest.fixture(params=["marched", "opened"])
def run(request: pytest.FixtureRequest, tmp_path: Path) -> xr.Dataset:
    """A run in memory, and the same from a file."""
    made = swing()
    return made if request.param == "marched" else xd.open_run(xd.save(made, tmp_path / "source.nc"))


def scaled(run: xr.Dataset) -> xr.Dataset:
    """Change a variable, its attributes kept."""
    return run.assign(theta=run.theta.copy(data=run.theta.values * 1.1))


def one_value(run: xr.Dataset) -> xr.Dataset:
    """Change one bit of one value."""
    values = run.theta.values.copy()
    values[7] = np.nextafter(values[7], 2)
    return run.assign(theta=run.theta.copy(data=values))


def renamed(run: xr.Dataset) -> xr.Dataset:
    """Say another unit."""
    changed = run.copy()
    changed["l"] = changed.l.assign_attrs(units="cm")
    return changed


EDITS: dict[str, tuple[Change, str]] = {
    "scaled": (scaled, r"variable 'theta' is 0\.0550\d* in row 0, in the run 0\.05"),
    "one bit": (one_value, r"variable 'theta' is \S+ in row 7, in the run "),
    "a parameter": (lambda run: run.assign(l=run.l.copy(data=2.0)), r"variable 'l' is 2\.0, in the run "),
    "a unit": (renamed, r"attribute 'units' of 'l' is 'cm', in the run 'm'"),
    "a setting": (lambda run: run.assign_attrs(solver_step=0.1), r"attribute 'solver_step' is 0\.1, in the run 0\.05"),
    "a new attribute": (lambda run: run.assign_attrs(note="x"), r"attribute 'note' is 'x', and the run has none"),
    "a new variable": (lambda run: run.assign(y=run.theta), r"variable 'y' is not in the run"),
    "a type": (
        lambda run: run.assign(theta=run.theta.astype("f4")),
        r"variable 'theta' is of the type float32, in the run float64",
    ),
    "rows of an edited one": (
        lambda run: scaled(run).isel(step=slice(0, 9)),
        r"row 0 of 'step', .* is none of the run's rows",
    ),
    "rows in another order": (lambda run: run.isel(sample=[5, 4]), r"row 1 of 'sample', .* is none of the run's rows"),
    "no rows": (lambda run: run.isel(step=slice(0)), "dimension 'step' has no row, needs one at least"),
    "lost": (lambda run: scaled(run).assign_attrs(origin="another text"), "its origin is unknown"),
}


@pytest.mark.every(2)
@pytest.mark.parametrize("edit", EDITS)
def test_an_edited_record_is_refused(run: xr.Dataset, tmp_path: Path, edit: str) -> None:
    """Assert that one error names what differs, with both values, and the remedy, and nothing is written."""
    change, said = EDITS[edit]
    with pytest.raises(xd.InputError, match=said) as caught:
        xd.save(change(run), tmp_path / "edited.nc")
    assert "derived=" in str(caught.value) or edit == "no rows"
    assert not (tmp_path / "edited.nc").exists()


@pytest.mark.dear
@pytest.mark.every(2)
def test_derived_data_say_so_everywhere(run: xr.Dataset, tmp_path: Path) -> None:
    """Assert that an edited record can be saved as what it is, and that no verb takes it for a run."""
    path, digest = tmp_path / "derived.nc", xd.content_digest(run)
    xd.save(scaled(run), path, derived="theta scaled by 1.1")
    kept = xd.open_run(path)
    assert (kept.attrs["derived"], kept.attrs["derived_from"]) == ("theta scaled by 1.1", digest)
    said = f"derived data, no run: theta scaled by 1.1; from run {digest}"
    with pytest.warns(KindWarning, match=said) as told:
        assert xd.verify(path).digest != digest
    assert told[0].filename == __file__
    shown = call("verify", path)
    assert (shown.exit_code, said in shown.output, shown.output.startswith("verified")) == (0, True, True)
    assert said in call("show", path).output
    assert "completed" not in call("show", path).output
    with pytest.raises(xd.InputError, match=f"is {said}; reproduce the archive of that run"):
        xd.reproduce(path)
    assert call("plot", path, "-o", tmp_path / "derived.png").exit_code == 0


@pytest.mark.dear
def test_derived_data_stay_derived(tmp_path: Path) -> None:
    """Assert that a copy, a part and a further edit of derived data are derived from the same run."""
    first, second = tmp_path / "first.nc", tmp_path / "second.nc"
    made = swing()
    xd.save(scaled(made), first, derived="scaled")
    xd.save(xd.open_run(first), second)
    assert xd.content_digest(xd.open_run(second)) == xd.content_digest(xd.open_run(first))
    xd.save(xd.open_run(first).isel(step=slice(3)), second)
    assert "derived data, no run: scaled" in call("verify", second).output
    xd.save(scaled(xd.open_run(first)), second, derived="scaled again")
    assert f"scaled; scaled again; from run {xd.content_digest(made)}" in call("verify", second).output


@pytest.mark.parametrize("derived", ["", " ", 5, True])
def test_how_data_were_derived_is_a_text(tmp_path: Path, derived: object) -> None:
    """Assert that an empty word is no answer."""
    with pytest.raises(xd.InputError, match="needs a text that says how the data were made"):
        xd.save(swing(), tmp_path / "no.nc", derived=derived)


SELECTIONS: dict[str, tuple[Change, str]] = {
    "first rows": (lambda run: run.isel(step=slice(0, 20)), "20 of 63 rows of 'step'"),
    "every second": (
        lambda run: run.isel(step=slice(3, 30, 2), sample=slice(5)),
        "14 of 63 rows of 'step'; 5 of 62 rows of 'sample'",
    ),
    "chosen": (lambda run: run.isel(step=run.theta > 0), " of 63 rows of 'step'"),
    "no event": (lambda run: run.isel(event=slice(0)), "0 of 1 rows of 'event'"),
    "variables": (lambda run: run.drop_vars(["theta", "kinetic_energy"]), "without theta, kinetic_energy"),
    "both": (lambda run: run[["theta", "model_toml"]].isel(step=slice(5)), "5 of 63 rows of 'step'; without "),
}


@pytest.mark.every(13)
@pytest.mark.parametrize("what", SELECTIONS)
def test_a_part_of_a_run_is_saved_as_one(run: xr.Dataset, tmp_path: Path, what: str) -> None:
    """Assert that it names its run, and that every kept value is found in the run marched again."""
    change, said = SELECTIONS[what]
    path, digest = tmp_path / "part.nc", xd.content_digest(run)
    xd.save(change(run), path)
    verified = call("verify", path).output
    assert f"a selection of run {digest}: " in verified
    assert said in verified
    assert verified.startswith("verified")
    assert xd.reproduce(path).attrs["identical"] == 1
    assert f"every bit the same in run {digest} computed again" in call("reproduce", path).output
    assert f"a selection of run {digest}" in call("show", path).output
    assert call("plot", path, "-o", tmp_path / "part.png").exit_code in (0, 2)


def test_a_selection_of_a_selection_names_the_run(tmp_path: Path) -> None:
    """Assert that what is reproduced is the run, however often something was selected."""
    first, path, made = tmp_path / "first.nc", tmp_path / "part.nc", swing()
    xd.save(made.isel(step=slice(40)), first)
    xd.save(xd.open_run(first).isel(step=slice(10, 20)).drop_vars("theta"), path)
    assert xd.open_run(path).attrs["selection_of"] == xd.content_digest(made)
    assert xd.reproduce(path).attrs["identical"] == 1


def test_a_selection_keeps_the_tolerances_of_what_is_left_out(tmp_path: Path) -> None:
    """Assert that a run of chosen steps is marched again to the same steps though a state with a tolerance is gone."""
    made = xd.simulate(
        xd.Model.from_toml(MODELS / "kepler.toml"), method="dop853", rtol=1e-6, atol={"x": "1 nm"}, until="2 s"
    )
    xd.save(made.drop_vars(["x", "v_y"]), tmp_path / "part.nc")
    assert xd.reproduce(tmp_path / "part.nc").attrs["identical"] == 1


@pytest.mark.dear
def test_a_selection_that_was_forged_is_found(tmp_path: Path) -> None:
    """Assert that values that are in no row of the run, with digests that hold, are not reproduced."""
    from cases.odd import changed

    def forge(part: xr.Dataset) -> None:
        part.theta.values[3] *= 1.5

    xd.save(swing().isel(step=slice(10)), tmp_path / "part.nc")
    forged = changed(tmp_path / "part.nc", tmp_path / "forged.nc", forge)
    assert xd.reproduce(forged).attrs["identical"] == 0
    assert call("reproduce", forged).exit_code == 1


def test_a_selection_of_another_run_is_found(tmp_path: Path) -> None:
    """Assert that right values under the name of a run that they are not from are not reproduced."""
    from cases.odd import changed, with_attributes

    xd.save(swing().isel(step=slice(10)), tmp_path / "part.nc")
    forged = changed(tmp_path / "part.nc", tmp_path / "forged.nc", with_attributes(selection_of="0" * 64))
    table = xd.reproduce(forged)
    assert table.attrs["identical"] == 0
    assert table.attrs["settings"].startswith("selection_of: ")


def test_a_selection_without_its_model_is_not_reproduced(tmp_path: Path) -> None:
    """Assert that it is said what is missing."""
    xd.save(swing().drop_vars("model_toml"), tmp_path / "part.nc")
    with pytest.raises(xd.InputError, match="saved without model_toml, from which its run is computed again"):
        xd.reproduce(tmp_path / "part.nc")


@pytest.mark.every(7)
@pytest.mark.parametrize(
    "sent",
    [
        lambda run: pickle.loads(pickle.dumps(run)),
        lambda run: run.copy(deep=True),
        lambda run: run.chunk({"step": 10}),
        lambda run: run.compute(),
    ],
)
def test_a_copy_is_the_same_run(run: xr.Dataset, tmp_path: Path, sent: Change) -> None:
    """Assert that what another process, dask or a copy gives back is saved as the run, and an edit of it is not."""
    copy = sent(run)
    xd.save(copy, tmp_path / "copy.nc")
    assert verified(tmp_path / "copy.nc") == xd.content_digest(run)
    with pytest.raises(xd.InputError, match="variable 'theta'"):
        xd.save(scaled(copy), tmp_path / "edited.nc")


def test_rows_of_a_run_that_was_sent_elsewhere(tmp_path: Path) -> None:
    """Assert that where the values of the run are not at hand a selection of rows is refused, with what helps."""
    sent = pickle.loads(pickle.dumps(swing()))
    with pytest.raises(xd.InputError, match="no longer at hand: save the selection in the process that made it"):
        xd.save(sent.isel(step=slice(5)), tmp_path / "part.nc")
    xd.save(sent.drop_vars("theta"), tmp_path / "part.nc")


def test_arithmetic_keeps_no_digest(run: xr.Dataset) -> None:
    """Assert that no variable says it is what it no longer is, and that the file still bears the digests."""
    import netCDF4

    for variable in run.variables.values():
        assert "sha256" not in variable.attrs
    with xr.set_options(keep_attrs=True):
        assert set((run.theta * 2).attrs) <= {"units", "long_name", "role"}
    if run.encoding.get("source"):
        with netCDF4.Dataset(run.encoding["source"]) as file:
            assert "sha256" not in file["theta"].ncattrs()
            assert "\ntheta " in file.variable_digests


def test_what_was_marched_cannot_be_written_over() -> None:
    """Assert that an edit in place is refused, and that a deep copy may be edited."""
    made = swing()
    with pytest.raises(ValueError, match="read-only"):
        made.theta.values[5] = 1.0
    made.copy(deep=True).theta.values[5] = 1.0


def test_what_is_remembered_shows_as_a_short_text(run: xr.Dataset, tmp_path: Path) -> None:
    """Assert that a notebook shows one short line, that plain xarray can write it, and that it is no part of a run."""
    assert len(run.attrs["origin"]) < 70
    run.to_netcdf(tmp_path / "plain.nc")
    assert "origin" not in xr.open_dataset(xd.save(run, tmp_path / "run.nc"), decode_times=False).attrs
    assert xd.content_digest(run) == verified(tmp_path / "run.nc")
    assert xd.compare(run, xd.open_run(tmp_path / "run.nc")).attrs["identical"] == 1


def test_a_dataset_opened_by_xarray_is_known_by_its_digest(tmp_path: Path) -> None:
    """Assert that a whole record is saved though xdynamics did not open it, and an edited one is not."""
    path = xd.save(swing(), tmp_path / "run.nc")
    with xr.open_dataset(path, decode_times=False, mask_and_scale=False) as plain:
        xd.save(plain.load(), tmp_path / "copy.nc")
        with pytest.raises(xd.InputError, match="its origin is unknown"):
            xd.save(scaled(plain), tmp_path / "edited.nc")
    assert verified(tmp_path / "copy.nc") == verified(path)


def test_history_may_be_written(run: xr.Dataset, tmp_path: Path) -> None:
    """Assert that circumstances are no edit."""
    run.attrs["history"] = f"{run.attrs['history']}\n2026-11-21 looked at"
    assert verified(xd.save(run, tmp_path / "run.nc")) == xd.content_digest(run)


def test_a_selection_may_be_without_its_first_row(tmp_path: Path) -> None:
    """Assert that a selection of chosen steps is found again in its run, be it without the start or without time."""
    made = xd.simulate(xd.Model.from_toml(MODELS / "ball_drag.toml"), method="dormand_prince", rtol=1e-9)
    for number, part in enumerate((made.isel(step=slice(5, 10)), made.drop_vars("time"), made.drop_dims("step"))):
        path = xd.save(part, tmp_path / f"{number}.nc")
        assert xd.reproduce(path).attrs["identical"] == 1


def test_arrays_that_were_opened_to_writing_are_refused(tmp_path: Path) -> None:
    """Assert that numpy's switch does not make an edited record a run."""
    made = swing()
    made.theta.values.flags.writeable = True
    made.theta.values[3] += 1.0
    with pytest.raises(xd.InputError, match="variable 'theta' was opened to writing"):
        xd.save(made, tmp_path / "run.nc")


def test_a_file_that_is_replaced_while_it_is_verified_is_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that bytes of one file are not held against those of another that took its name."""
    path, other = xd.save(swing(), tmp_path / "run.nc"), xd.save(swing(), tmp_path / "other.nc")
    (tmp_path / "run.nc").write_bytes(path.read_bytes()[:-100])  # damaged, until the other takes its place
    told = reading.examine_sandboxed

    def slowly(path: Path, tail: Tail) -> Examination:
        found = told(path, tail)
        if other.exists():
            other.replace(path)
        return found

    monkeypatch.setattr(reading, "examine_sandboxed", slowly)
    assert verified(path) == xd.content_digest(swing())


@pytest.mark.parametrize(("name", "value"), [("xdynamics_version", "9.9"), ("date_created", "1900-01-01T00:00:00Z")])
def test_circumstances_are_those_of_the_march(tmp_path: Path, name: str, value: str) -> None:
    """Assert that date, versions and machine are not edited either; `history` may be gone on with, as tools do."""
    made = swing()
    with pytest.raises(xd.InputError, match=f"attribute '{name}' is '{value}', in the run"):
        xd.save(made.assign_attrs({name: value}), tmp_path / "run.nc")
    xd.save(made.assign_attrs(history=made.attrs["history"] + "; looked at"), tmp_path / "run.nc")
    assert verified(tmp_path / "run.nc") == xd.content_digest(made)

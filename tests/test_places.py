"""What is given where a place is wanted: secrets in it are told by nobody, and what is in the way is one clear line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import xarray as xr

import xdynamics as xd
from cases.command_line import call
from cases.problems import MODELS
from xdynamics.archive.zarr_archive import quietly

OSCILLATOR = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
RUN = xd.simulate(OSCILLATOR, method="rk4", step=0.1, until=1.0)
ASKED: dict[str, Any] = {"method": "rk4", "until": 1.0}
ADDRESS = "s3://someone:hidden-words@bucket/one"
VERBS: dict[str, Callable[[str], Any]] = {
    "save": lambda place: xd.save(RUN, place),
    "save_many": lambda place: xd.save_many([RUN], [place]),
    "simulate": lambda place: xd.simulate(OSCILLATOR, path=place, **ASKED),
    "open_run": xd.open_run,
    "open_sweep": xd.open_sweep,
    "open_logs": lambda place: xd.open_logs(place, [1.0]),
    "verify": xd.verify,
    "sign": lambda place: xd.sign("one.nc", place),
    "sweep": lambda place: xd.sweep(OSCILLATOR, {"k": "1:2:3 N m-1"}, path=place, **ASKED),
    "refine": lambda place: xd.refine(OSCILLATOR, steps=[0.1, 0.05], keep=place, **ASKED),
    "report": lambda place: xd.report(place, run=RUN),
    "plot": lambda place: xd.plot(RUN, place),
    "beside": lambda place: xd.plot(RUN, beside=place),
    "bundle": lambda place: xd.bundle("folder", place),
    "recheck": xd.recheck,
    "model": xd.Model.from_toml,
    "data": lambda place: xd.compare(RUN, f"{place}.csv"),
    "fit": lambda place: xd.fit(OSCILLATOR, f"{place}.csv", ["k"]),
    "path for a run": lambda place: xd.compare(place, RUN),
    "cluster": lambda place: xd.cluster(place.replace("s3:", "tcp:")).__enter__(),
}


@pytest.mark.parametrize("verb", VERBS)
def test_a_secret_in_a_place_is_not_told(verb: str) -> None:
    """Assert that every verb refuses an address with credentials, and that its message has neither of them."""
    with pytest.raises(xd.InputError) as told:
        VERBS[verb](ADDRESS)
    assert "hidden-words" not in str(told.value)
    assert "someone" not in str(told.value)


def test_a_secret_is_not_printed_by_the_command() -> None:
    """Assert the same of the command's verbs, which end with the code of wrong input."""
    model = MODELS / "harmonic_oscillator.toml"
    for words in (("run", ADDRESS), ("show", ADDRESS), ("run", model, "-o", ADDRESS), ("fit", model, f"{ADDRESS}.csv")):
        done = call(*words)
        assert done.exit_code == 2
        assert "hidden-words" not in done.output


def test_a_folder_that_cannot_be_made_is_named() -> None:
    """Assert folder, cause and remedy of a sweep, a store, a study and a report where nothing can be written."""
    for verb, name in (("sweep", "x"), ("sweep", "x.zarr"), ("refine", "x"), ("report", "x")):
        with pytest.raises(
            xd.InputError, match=f"the folder '/proc/{name}' cannot be made: No such file .*; name another"
        ):
            VERBS[verb](f"/proc/{name}")


NO_NAMES = ["..", ".", "", " ", ".hidden", "../x", "a/../b", "/abs", "a/b", "a\\b", "a\nb", "a\0b"]


@pytest.mark.parametrize("name", NO_NAMES)
def test_a_name_that_leads_elsewhere_is_refused(name: str, tmp_path: Path) -> None:
    """Assert of a report, of several records in one, and of runs saved by name, that nothing is written anywhere."""
    folder = tmp_path / "inner" / "folder"
    for given in (
        lambda: xd.report(folder, **{name: RUN}),
        lambda: xd.report(folder, runs={f"/{name}": RUN, "b": RUN}),
        lambda: xd.save_many({name: RUN}, folder),
    ):
        with pytest.raises(xd.InputError, match="is no name of a file in the folder; use letters, digits"):
            given()
    assert not list(tmp_path.iterdir())


def test_a_store_of_others_is_left_alone(tmp_path: Path) -> None:
    """Assert that no sweep is marched into a Zarr store that none began, nor one opened from it, and that it stays as it is."""
    pytest.importorskip("zarr")
    for version in (2, 3):
        place = tmp_path / f"{version}.zarr"
        with quietly():
            xr.Dataset({"a": ("x", [1.0, 2.0])}).to_zarr(place, zarr_format=version)
        before = {entry: entry.read_bytes() for entry in place.rglob("*") if entry.is_file()}
        with pytest.raises(
            xd.InputError, match=rf"{version}.zarr' holds '.*', and no record of xdynamics; name another place"
        ):
            VERBS["sweep"](str(place))
        with pytest.raises(xd.InputError, match=rf"{version}.zarr' holds no sweep: .*; name what sweep wrote into"):
            xd.open_sweep(place)
        assert {entry: entry.read_bytes() for entry in place.rglob("*") if entry.is_file()} == before


@pytest.mark.parametrize(
    "file", ["../one.nc", "/etc/one.nc", "runs/../../one.nc", "s3://bucket/runs/one.nc", "runs/one.nc"]
)
def test_a_catalogue_that_names_files_elsewhere_is_refused(file: str, tmp_path: Path) -> None:
    """Assert that neither a member nor the logs are read from a place which is none of the sweep's own runs."""
    grid = xd.sweep(OSCILLATOR, {"k": [1.0]}, path=tmp_path / "grid", keep=["log"], **ASKED)
    grid["run_file"] = grid.run_file.dims, [file]
    for verb in (lambda: xd.member(grid, k=1.0), lambda: xd.open_logs(grid, [0.5])):
        with pytest.raises(xd.ArchiveError, match="as the file of a run; its runs are in 'runs'"):
            verb()


# ------------------------------------------------------------------------------------------- lazy, where it is not wanted


@pytest.mark.dear
def test_a_part_of_a_stage_is_said_to_be_one(tmp_path: Path) -> None:
    """Assert what is told of a lazy variable taken out of its stage: drawn, reported beside a whole one, saved."""
    study = xd.refine(OSCILLATOR, steps=[0.1, 0.05], compute=False, **ASKED)
    part = study[["order_x"]]
    with pytest.raises(xd.InputError, match="has nothing that is drawn of it; give it whole, as it was made"):
        xd.plot(part)
    with pytest.raises(
        xd.InputError, match=r"has all but 1 of the stages:\n.*stage 'part' failed: this is not the refinement"
    ):
        xd.report(tmp_path / "page", part=part, whole=study)
    page = (tmp_path / "page" / "report.md").read_text()
    assert "## whole" in page
    assert "failed    this is not the refinement as it was made" in page
    with pytest.raises(xd.InputError, match="this is not the refinement as it was made"):
        xd.save(part, tmp_path / "part.nc")


def test_evidence_is_not_taken_for_a_run() -> None:
    """Assert that a lazy study, given where the numbers of a run or certificate are needed, is told what it lacks."""
    study = xd.refine(OSCILLATOR, steps=[0.1, 0.05], compute=False, **ASKED)
    for verb in (xd.modes, xd.diagnose, xd.companion, xd.extend, xd.complete):
        given = {"until": 2.0} if verb is xd.extend else {}
        with pytest.raises(xd.InputError, match="this is no run record: it has no time, row_kind"):
            verb(study, **given)
    for verb in (xd.recheck, lambda given: xd.bundle("folder", given)):
        with pytest.raises(xd.InputError, match="this is no certificate but a refinement; `certify` makes one"):
            verb(study)


@pytest.mark.dear
def test_a_lazy_certificate_is_made_again() -> None:
    """Assert that a certificate that is not computed yet is computed, and then compared with the one made again."""
    ball = xd.Model.from_toml(MODELS / "ball_drag.toml")
    certificate = xd.certify(ball, "y", at="0.5 s", draws=100, compute=False, method="rk4", step="50 ms")
    again = xd.recheck(certificate)
    assert again.attrs["result"] == str(certificate["result"].values)

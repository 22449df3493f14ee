"""Budgets, ledgers and certificates whose results are kept in a folder, and that go on where they were interrupted."""

from __future__ import annotations

import errno
import json
import os
import pickle
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import dask
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS
from cases.stages import assert_same_bits, no_march
from xdynamics.evidence import kept_results
from xdynamics.evidence.kept_results import Keep

BALL = xd.Model.from_toml(MODELS / "ball_drag.toml")
ASKED: dict[str, Any] = {"at": "1 s", "method": "rk4", "step": 0.05, "until": "1 s"}
MAKE: dict[str, Callable[..., xr.Dataset]] = {
    "budget": lambda **how: xd.error_budget(BALL, "y", draws=1100, **ASKED, **how),
    "ledger": lambda **how: xd.validate(["rk4"], **how),
    "certificate": lambda **how: xd.certify(BALL, "y", draws=1100, **ASKED, **how),
}


@pytest.mark.dear
@pytest.mark.every(2)
@pytest.mark.parametrize("what", ["budget", "ledger"])
def test_evidence_that_was_interrupted_goes_on(what: str, tmp_path: Path) -> None:
    """Assert that what was known before an interrupt is read, every other task done once, and the bits those of one go."""
    make, keeping, kept = MAKE[what], kept_results._keep_result, list[str]()

    def interrupted(*given: Any) -> Any:
        if len(kept) == 4:
            raise KeyboardInterrupt
        kept.append(given[2].name)
        return keeping(*given)

    one_by_one = dask.config.set(scheduler="synchronous")
    with mock.patch.object(kept_results, "_keep_result", interrupted), one_by_one, pytest.raises(KeyboardInterrupt):
        make(keep=tmp_path)
    assert sorted(place.name for place in tmp_path.iterdir()) == sorted(kept)
    again = list[str]()
    with mock.patch.object(kept_results, "_keep_result", lambda *given: again.append(given[2].name) or keeping(*given)):
        found = make(keep=tmp_path)
    assert not {*kept} & {*again}
    assert_same_bits(found, make())
    with mock.patch.object(kept_results, "_keep_result", interrupted):
        assert_same_bits(make(keep=tmp_path), found)
        assert_same_bits(make(keep=tmp_path, compute=False), found)


WRITE = Path.write_text


def killed_while_writing(make: Callable[..., xr.Dataset], keep: Path, number: int) -> None:
    """Make evidence in a copy of this process, which is killed when it has written half of a result."""
    written = list[Path]()

    def broken_off(place: Path, text: str) -> int:
        written.append(place)
        if len(written) == number:
            WRITE(place, text[: len(text) // 2])
            os.kill(os.getpid(), signal.SIGKILL)
        return WRITE(place, text)

    if not (child := os.fork()):
        with mock.patch.object(Path, "write_text", broken_off), dask.config.set(scheduler="synchronous"):
            make(keep=keep)
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL


@pytest.mark.every(2)
@pytest.mark.parametrize("number", [1, 6])
def test_a_budget_that_was_killed_goes_on(number: int, tmp_path: Path) -> None:
    """Assert the bits of one go, and that what was whole when the process was killed is there as it was."""
    killed_while_writing(MAKE["budget"], tmp_path, number)
    kept = {place: place.read_bytes() for place in tmp_path.glob("*.json")}
    assert len(kept) == number - 1
    assert_same_bits(MAKE["budget"](keep=tmp_path), MAKE["budget"]())
    assert {place: place.read_bytes() for place in kept} == kept
    with no_march():
        MAKE["budget"](keep=tmp_path)


def test_a_budget_whose_folder_is_full_goes_on(tmp_path: Path) -> None:
    """Assert one line with file and cause, that nothing half is under a name, and the bits once there is room."""
    written = list[Path]()

    def full(place: Path, text: str) -> int:
        written.append(place)
        if len(written) < 4:
            return WRITE(place, text)
        WRITE(place, text[:9])
        raise OSError(errno.ENOSPC, "No space left on device")

    refused = pytest.raises(xd.ArchiveError, match=r"^'.*\.json' cannot be written: No space left on device; ")
    with mock.patch.object(Path, "write_text", full), refused:
        MAKE["budget"](keep=tmp_path)
    assert len([*tmp_path.iterdir()]) == 3
    assert_same_bits(MAKE["budget"](keep=tmp_path), MAKE["budget"]())


@pytest.mark.dear
def test_a_whole_certificate_marches_nothing(tmp_path: Path) -> None:
    """Assert it of budget and ledger together, lazily at first, then at once."""
    found = MAKE["certificate"](keep=tmp_path, compute=False).compute(scheduler="synchronous")
    with no_march():
        assert_same_bits(MAKE["certificate"](keep=tmp_path), found)
    assert_same_bits(MAKE["certificate"](), found)


@pytest.mark.parametrize("quantity", ["maximum_v_y", "t"])
def test_a_whole_budget_marches_nothing(quantity: str, tmp_path: Path) -> None:
    """Assert it of an extreme, with its time and rule, and of the time of an event."""
    place: dict[str, Any] = {"event": "apex"} if quantity == "t" else {}
    asked = {"method": "rk4", "step": 0.05, "until": "3 s", "keep": tmp_path} | place
    found = xd.error_budget(BALL, quantity, **asked)
    with no_march():
        again = xd.error_budget(BALL, quantity, **asked)
    assert_same_bits(again, found)
    assert {**again.attrs, "date_created": "", "history": ""} == {**found.attrs, "date_created": "", "history": ""}


def test_what_is_damaged_or_of_another_version_is_made_again(tmp_path: Path) -> None:
    """Assert it of a flipped digit, half a file and another version; and that a folder of results is looked at anew elsewhere."""
    whole = MAKE["ledger"](keep=tmp_path)
    first, second, third = sorted(tmp_path.iterdir())[:3]
    content = json.loads(first.read_text())
    digit = next(figure for figure in content["result"] if figure in "123456789")
    content["result"] = content["result"].replace(digit, "1" if digit != "1" else "2", 1)
    first.write_text(json.dumps(content))
    second.write_text("[" * 100_000)
    content = json.loads(third.read_text())
    content["made_by"]["xdynamics"] = "0.0.1"
    third.write_text(json.dumps(content))
    again = list[Path]()
    keeping = kept_results._keep_result
    with mock.patch.object(kept_results, "_keep_result", lambda *given: again.append(given[2]) or keeping(*given)):
        assert_same_bits(MAKE["ledger"](keep=tmp_path), whole)
    assert sorted(again) == [first, second, third]
    with no_march():
        assert_same_bits(MAKE["ledger"](keep=tmp_path), whole)
    keep = Keep(tmp_path)
    assert len(keep.present) == len(list(tmp_path.iterdir()))
    assert "present" not in vars(pickle.loads(pickle.dumps(keep)))


def test_a_folder_that_is_none_is_refused(tmp_path: Path) -> None:
    """Assert that a file in its place, and an address with credentials, are told before anything is marched."""
    (tmp_path / "file").write_text("")
    for make in MAKE.values():
        with no_march(), pytest.raises(xd.InputError, match="file' is a file"):
            make(keep=tmp_path / "file")
        with no_march(), pytest.raises(xd.InputError, match="credentials stand in an address"):
            make(keep="s3://me:secret@bucket/kept")
        for wrong in (7, "", True):
            with no_march(), pytest.raises(xd.InputError, match=f"keep is {wrong!r}, needs the name of a folder"):
                make(keep=wrong)
    with pytest.raises(xd.InputError, match="keep is '', needs the name of a folder"):
        xd.refine(BALL, steps=[0.1, 0.05], method="rk4", keep="")

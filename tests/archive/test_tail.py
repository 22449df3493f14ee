"""The end of an archive: a seal that is hurt, cut off, buried or left out is found and named, on opening too."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

import xdynamics as xd
from cases.problems import ROOT, oscillator
from cases.verdicts import verified
from xdynamics.archive.seals import MARK, Tail, seal_file, tail_of

SEAL = len(MARK) + 64 + 1
READ = (xd.verify, xd.open_run)


@pytest.fixture(scope="module")
def archived(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One archive for all tests, which only read it."""
    return xd.save(xd.simulate(oscillator().model, step=0.1, until=1.0), tmp_path_factory.mktemp("tail") / "whole.nc")


@pytest.fixture
def hurt(archived: Path, tmp_path: Path) -> Callable[[Callable[[bytearray], object]], Path]:
    """Write copies of the archive whose bytes were changed."""

    def changed(change: Callable[[bytearray], object]) -> Path:
        content = bytearray(archived.read_bytes())
        change(content)
        (tmp_path / "hurt.nc").write_bytes(content)
        return tmp_path / "hurt.nc"

    return changed


def flip(bit: int) -> Callable[[bytearray], object]:
    """Change a bit of the seal, counted from its beginning."""

    def change(content: bytearray) -> None:
        content[len(content) - SEAL + bit // 8] ^= 1 << bit % 8

    return change


def cut(n: int) -> Callable[[bytearray], object]:
    """Take bytes away from the end."""
    return lambda content: content.__delitem__(slice(len(content) - n, None))


def test_every_bit_of_the_seal_counts(hurt: Callable[..., Path]) -> None:
    """Assert that all 144 bits of the mark and those of the digest are found, and called what they are."""
    for bit in range(8 * SEAL):
        fault = tail_of(hurt(flip(bit))).fault
        in_digest = len(MARK) <= bit // 8 < SEAL - 1
        assert fault in (("its seal is hurt", "the bytes of the file differ from its seal")[: 1 + in_digest]), bit


@pytest.mark.parametrize("read", READ)
@pytest.mark.parametrize("bit", [0, 8 * 17, 8 * 18 + 1, 8 * 83 - 1])
def test_a_hurt_seal_is_named(hurt: Callable[..., Path], bit: int, read: Callable[[Path], object]) -> None:
    """Assert that opening and verifying say that it is the seal."""
    with pytest.raises(xd.ArchiveError, match=r"no run archive:\n  1\. .*its seal"):
        read(hurt(flip(bit)))


@pytest.mark.dear
def test_every_cut_is_found(hurt: Callable[..., Path]) -> None:
    """Assert that 1 to 200 bytes less are found: what was sealed does not pass as never sealed."""
    for n in range(1, 201):
        path = hurt(cut(n))
        if SEAL - 10 < n <= SEAL:  # nothing is left that looks like a seal, and every number is there
            assert xd.verify(path).verdict == "repacked"
            continue
        with pytest.raises(xd.ArchiveError, match="its seal is (hurt|cut off)|cannot be read") as told:
            xd.verify(path)
        assert told.value.verdict == "damaged"


@pytest.mark.parametrize("read", READ)
@pytest.mark.parametrize("n", [1, 40, 60])
def test_a_cut_seal_is_named(hurt: Callable[..., Path], n: int, read: Callable[[Path], object]) -> None:
    """Assert that opening finds what verifying finds."""
    with pytest.raises(xd.ArchiveError, match=rf"its seal is cut off: {n} of its 83 bytes|its seal is hurt"):
        read(hurt(cut(n)))


@pytest.mark.parametrize("read", READ)
@pytest.mark.parametrize(
    ("n", "fault"),
    [
        (1, "a byte follows its seal"),
        (2, "2 bytes follow its seal"),
        (83, "83 bytes follow its seal"),
        (65_000, "65000 bytes follow its seal"),
    ],
)
def test_what_stands_behind_the_seal_is_found(
    hurt: Callable[..., Path], n: int, read: Callable[..., object], fault: str
) -> None:
    """Assert that bytes that were added are counted."""
    with pytest.raises(xd.ArchiveError, match=rf"no run archive:\n  1\. {fault}"):
        read(hurt(lambda content: content.extend(b"\0" * n)))


@pytest.mark.parametrize(("right", "fault"), [(9, ""), (10, "its seal is hurt")])
def test_what_is_less_than_half_like_a_seal_is_none(tmp_path: Path, right: int, fault: str) -> None:
    """Assert that a file that never had a seal is not called hurt for a few bytes that happen to be those of the mark."""
    path = tmp_path / "file"
    path.write_bytes(MARK[:right] + b"\0" * (SEAL - right))
    assert tail_of(path) == Tail(fault=fault)


def test_a_seal_that_is_lost_among_other_bytes_is_none(hurt: Callable[..., Path]) -> None:
    """Assert that where so many bytes follow that no seal is found, the numbers decide."""
    assert xd.verify(hurt(lambda content: content.extend(b"\0" * 66_000))).verdict == "repacked"


ADDED = {
    "group 'more'": lambda file: file.createGroup("more"),
    "dimension 'more'": lambda file: file.createDimension("more", 3),
    "type 'more'": lambda file: file.createVLType("i4", "more"),
    "variable 'more' differs": lambda file: file.createVariable("more", "f8", ()),
    "attributes differ": lambda file: file.setncattr("more", 1),
    "variable 'x' is not stored as it was written": lambda file: file["x"].setncattr("coordinates", "v_x"),
}


NOTED = "attributes differ"  # that one note more stands beside the record is nobody's fault
BESIDE = {
    "repacked": ("dimension 'more'", NOTED, "variable 'x' is not stored as it was written"),
    "verified": (NOTED,),
}


@pytest.mark.parametrize("fault", ADDED)
def test_what_was_added_is_named(archived: Path, tmp_path: Path, fault: str) -> None:
    """Assert that it is named where a seal was made anew, and without a seal where it changes what the record says."""
    import netCDF4

    path = Path(shutil.copy(archived, tmp_path / "more.nc"))
    with netCDF4.Dataset(path, "a") as file:
        ADDED[fault](file)
    for verdict in "repacked", "verified":
        if fault in BESIDE[verdict]:
            assert xd.verify(path).verdict == verdict
            xd.open_run(path).close()
        else:
            with pytest.raises(xd.ArchiveError, match=fault):
                xd.verify(path)
        seal_file(path)


def test_the_word_of_the_seal_cannot_be_taken_out(archived: Path, tmp_path: Path) -> None:
    """Assert that an archive without seal and without the attribute that tells of it does not pass as it was written."""
    import netCDF4

    path = Path(shutil.copy(archived, tmp_path / "less.nc"))
    with netCDF4.Dataset(path, "a") as file:
        file.delncattr("archive_seal")
    path.write_bytes(path.read_bytes().replace(MARK, b"\n" * len(MARK)))
    assert xd.verify(path).verdict == "repacked"


def test_the_word_of_the_seal_is_of_files_only(archived: Path) -> None:
    """Assert that a run in memory does not say that it ends with a seal."""
    assert "archive_seal" not in xd.open_run(archived).attrs


def test_archives_from_before_seals_still_open(tmp_path: Path) -> None:
    """Assert that a file of version 0.1 that never had a seal is verified by its digests."""
    old = ROOT / "data" / "golden" / "0.1" / "ball_drag_midpoint.nc"
    path = tmp_path / "old.nc"
    path.write_bytes(old.read_bytes()[:-SEAL])
    assert tail_of(path) == Tail()
    assert verified(path) == verified(old)
    assert xd.open_run(path).sizes == xd.open_run(old).sizes

"""Names of files as long as a system takes them, and files that look like files and cannot be read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

import xdynamics as xd
from cases.problems import oscillator
from cases.verdicts import verified
from xdynamics.archive.segments import segments_folder
from xdynamics.archive.signatures import new_key, protection

RUN = xd.simulate(oscillator().model, step=0.1, until=1.0)


@pytest.mark.every(3)
@pytest.mark.parametrize("length", range(243, 256))
def test_a_run_may_have_any_name(length: int, tmp_path: Path) -> None:
    """Assert that a march into a file leaves that file alone, and its segments have a folder of their own."""
    path = tmp_path / ("n" * (length - 3) + ".nc")
    xd.simulate(oscillator().model, step=0.1, until=1.0, path=path).close()
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]
    assert len(segments_folder(path).name) <= 255
    assert segments_folder(path) != segments_folder(tmp_path / ("n" * (length - 4) + "m.nc"))


@pytest.mark.every(3)
@pytest.mark.parametrize("length", range(250, 256))
def test_an_archive_of_any_name_is_signed(length: int, tmp_path: Path) -> None:
    """Assert that it is verified before, signed, and verified with its signature, which is of this name alone."""
    public = new_key(tmp_path / "key.pem")
    path = tmp_path / ("n" * (length - 3) + ".nc")
    digest = verified(xd.save(RUN, path))
    assert protection(path) == "sealed; not signed"
    with pytest.raises(xd.ArchiveError, match="has no signature"):
        xd.verify_signature(path, public)
    place = xd.sign(path, tmp_path / "key.pem")
    assert place.name == (f"{path.name}.sig" if length <= 251 else place.name)
    assert place.name.endswith(".sig")
    assert xd.verify_signature(path, public) == digest
    assert protection(path.with_name("m" + path.name[1:])) == "sealed; not signed"


@pytest.mark.parametrize("read", [xd.verify, xd.open_run, xd.reproduce])
def test_a_link_into_memory_is_no_archive(read: Callable[[Path], object], tmp_path: Path) -> None:
    """Assert one error for a file that has no bytes, though the system says that it is a regular one."""
    path = tmp_path / "mem.nc"
    path.symlink_to("/proc/self/mem")
    with pytest.raises(xd.ArchiveError, match=r"mem.nc' cannot be read: Input/output error"):
        read(path)

"""What an archive is read from: a file, named as the library takes it."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from xdynamics.archive.store import check_source
from xdynamics.faults import InputError


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("folder", "is a directory; name a file in it"),
        ("pipe", "is a pipe (FIFO); name a file"),
        ("none", "does not exist"),
    ],
)
def test_what_is_no_file_is_told(tmp_path: Path, name: str, said: str) -> None:
    """Assert one sentence with the path, what it is and what helps."""
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=f"^'{re.escape(str(tmp_path / name))}' {re.escape(said)}$"):
        check_source(tmp_path / name)
    check_source(tmp_path / "file")
    with pytest.raises(InputError, match="/file/below' does not exist: '.*/file' is a file, no folder$"):
        check_source(tmp_path / "file" / "below")


def test_a_backslash_anywhere_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that the whole name counts, for the library is given that."""
    folder = tmp_path / "a\\b"
    folder.mkdir()
    (folder / "run.nc").touch()
    monkeypatch.chdir(folder)
    with pytest.raises(InputError, match="'run.nc' has a backslash in its whole name, .*; name another file"):
        check_source(Path("run.nc"))

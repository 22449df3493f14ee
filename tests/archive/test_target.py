"""What a file is written to: nothing else is lost, links, modes and owners stay, and nothing is left lying about.

What is on the disk, and when: no name stands for a file that a lost current would empty.
Names of files as long as a system takes them, and files that look like files and cannot be read.
What an archive is read from: a file, named as the library takes it.
"""

from __future__ import annotations

import gc
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner

import xdynamics as xd
from cases.problems import MODELS, oscillator
from cases.stages import no_march
from cases.verdicts import verified
from xdynamics.archive import segments
from xdynamics.archive.segments import segments_folder
from xdynamics.archive.signatures import new_key, protection
from xdynamics.archive.store import check_source
from xdynamics.archive.target import (
    TemporaryFile,
    check_path_no_table,
    check_path_target,
    sweep_temporary_files,
    taking_path_name,
)
from xdynamics.cli import main
from xdynamics.faults import InputError


@pytest.fixture(scope="module")
def run() -> xr.Dataset:
    """A small run that ended well."""
    return xd.simulate(oscillator().model, step=0.1, until=1.0)


@pytest.fixture(scope="module")
def bad() -> xr.Dataset:
    """The same run, ended before its end."""
    return xd.simulate(oscillator().model, step=0.1, rtol=1e-9, until=1.0, max_steps=3)


def names(folder: Path) -> list[str]:
    """List a folder."""
    return sorted(entry.name for entry in folder.iterdir())


REFUSED = {
    "a pipe": r"is a pipe \(FIFO\); name a file$",
    "a socket": "is a socket; name a file$",
    "a directory": "is a directory; name a file in it, like '.*/run.nc'$",
}


@pytest.mark.parametrize("kind", REFUSED)
def test_what_is_no_file_is_refused(run: xr.Dataset, tmp_path: Path, kind: str) -> None:
    """Assert that a pipe, a socket and a directory stay what they are, by themselves or behind a link."""
    path, link = tmp_path / "it", tmp_path / "link"
    link.symlink_to(path)
    with socket.socket(socket.AF_UNIX) as listening:
        {"a pipe": lambda: os.mkfifo(path), "a directory": path.mkdir, "a socket": lambda: listening.bind(str(path))}[
            kind
        ]()
        before = path.stat()
        for target in (path, link):
            with pytest.raises(xd.InputError, match=REFUSED[kind]):
                xd.save(run, target)
            with pytest.raises(xd.InputError, match=f"is {kind}"):
                xd.simulate(oscillator().model, step=0.1, until=1.0, path=target)
    assert path.stat().st_mode == before.st_mode
    assert names(tmp_path) == ["it", "link"]


def test_a_link_goes_on_pointing(run: xr.Dataset, tmp_path: Path) -> None:
    """Assert that the file is replaced in its own folder, whether or not it was there, and the links stay."""
    (tmp_path / "far").mkdir()
    link, second = tmp_path / "run.nc", tmp_path / "second.nc"
    link.symlink_to(Path("far") / "real.nc")
    second.symlink_to(link)
    for _ in range(2):
        assert xd.save(run, second) == second
        assert link.is_symlink()
        assert second.is_symlink()
        assert names(tmp_path / "far") == ["real.nc"]
    assert verified(tmp_path / "far" / "real.nc") == xd.content_digest(run)


def test_links_in_a_circle(run: xr.Dataset, tmp_path: Path) -> None:
    """Assert that links that lead nowhere are one error."""
    (tmp_path / "a").symlink_to(tmp_path / "b")
    (tmp_path / "b").symlink_to(tmp_path / "a")
    for act in (lambda path: xd.save(run, path), xd.open_run, xd.Model.from_toml):
        with pytest.raises(xd.InputError, match="Too many levels of symbolic links"):
            act(tmp_path / "a")


@pytest.mark.parametrize("mode", [0o600, 0o640, 0o644, 0o666, 0o400])
def test_the_mode_stays(run: xr.Dataset, tmp_path: Path, mode: int) -> None:
    """Assert that an archive that was private before is private afterwards."""
    path = xd.save(run, tmp_path / "run.nc")
    path.chmod(mode)
    xd.save(run, path)
    assert path.stat().st_mode & 0o7777 == mode


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may give files away")
def test_the_owner_stays(run: xr.Dataset, tmp_path: Path) -> None:
    """Assert that owner and group are those of the old file."""
    path = xd.save(run, tmp_path / "run.nc")
    os.chown(path, 12345, 23456)
    xd.save(run, path)
    assert (path.stat().st_uid, path.stat().st_gid) == (12345, 23456)


@pytest.mark.parametrize(("user", "group"), [(0, 0), (1, 0), (0, 1), (1, 1)])
def test_owner_and_group_are_given_apart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, user: int, group: int
) -> None:
    """Assert that only what differs from the old file is asked for: who may not give files away may change the group."""
    path, given, status = tmp_path / "run.nc", [], os.fstat
    path.touch()
    old = path.stat()

    def another(handle: int) -> os.stat_result:
        about = status(handle)
        return os.stat_result((*about[:4], old.st_uid + user, old.st_gid + group, *about[6:]))

    monkeypatch.setattr(os, "fchown", lambda _handle, *who: given.append(who))
    monkeypatch.setattr(os, "fstat", another)
    with taking_path_name(path):
        pass
    assert given == [(-1, old.st_gid)] * group + [(old.st_uid, -1)] * user


def test_rights_are_never_wider(run: xr.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that where the group cannot be kept, another group gets no more than everybody."""
    path = xd.save(run, tmp_path / "run.nc")
    path.chmod(0o664)

    def refuse(*_: object) -> None:
        raise PermissionError

    group, status = path.stat().st_gid, os.fstat
    monkeypatch.setattr(os, "fchown", refuse)
    monkeypatch.setattr(
        os, "fstat", lambda handle: os.stat_result((*status(handle)[:5], group + 1, *status(handle)[6:]))
    )
    xd.save(run, path)
    monkeypatch.undo()
    assert path.stat().st_mode & 0o777 == 0o644


def test_the_models_own_files_stay(tmp_path: Path) -> None:
    """Assert that neither the model file nor its table can be the target, from Python and from the command line."""
    for name in ("rocket_c6.toml", "estes_c6_thrust.csv"):
        shutil.copy(next(MODELS.rglob(name)), tmp_path / name)
    model = xd.Model.from_toml(tmp_path / "rocket_c6.toml")
    made = xd.simulate(model, until=0.1)
    for name in ("estes_c6_thrust.csv", "rocket_c6.toml"):
        before = (tmp_path / name).read_bytes()
        with pytest.raises(xd.InputError, match="is a table of the model|is the model file itself"):
            xd.simulate(model, until=0.1, path=tmp_path / name)
        done = CliRunner().invoke(main, ["run", str(tmp_path / "rocket_c6.toml"), "-o", str(tmp_path / name)])
        assert (done.exit_code, "name another file" in done.output) == (2, True)
        assert (tmp_path / name).read_bytes() == before
    with pytest.raises(xd.InputError, match="is a table of the model"):
        xd.save(made, tmp_path / "estes_c6_thrust.csv")


@pytest.mark.parametrize(
    ("content", "refused"),
    [("t,y\n0,1\n", True), ("t,y\r\n" + "0,1\r\n" * 20, True), ("0,1\n" * 90, False), ("\x80", False)],
)
def test_a_table_is_told_by_its_text(tmp_path: Path, content: str, *, refused: bool) -> None:
    """Assert that each table of a model is known again, be it the longest, and that longer files and other bytes are none."""
    path, tables = tmp_path / "it", ["t,y\n0,1\n", "t,y\n" + "0,1\n" * 20]
    check_path_no_table(path, tables)
    path.write_bytes(content.encode("latin-1"))
    check_path_no_table(path, [])
    with pytest.raises(xd.InputError, match="is a table of the model; name another file") if refused else nullcontext():
        check_path_no_table(path, tables)


@pytest.mark.parametrize(
    ("error", "probed", "said"),
    [
        (OSError(28, "No space left on device"), None, "No space left on device"),
        (RuntimeError("NetCDF: HDF error"), None, r"NetCDF: HDF error \(disk full, file-size limit or lost device\)"),
        (OSError("odd"), None, r"odd \(disk full, file-size limit or lost device\)"),
        (RuntimeError("NetCDF: HDF error"), OSError(30, "Read-only file system"), "Read-only file system"),
        (RuntimeError("NetCDF: HDF error"), OSError("odd"), "odd"),
    ],
)
def test_a_write_that_fails_says_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception, probed: OSError | None, said: str
) -> None:
    """Assert one error with the cause that the system gives, and nothing changed in the folder."""

    def probe(**_: object) -> None:
        raise probed or AssertionError

    (tmp_path / "run.nc").write_text("old")
    with monkeypatch.context() as patch:
        if probed:
            patch.setattr(tempfile, "TemporaryFile", probe)
        with (
            pytest.raises(xd.ArchiveError, match=f"run.nc' cannot be written: {said}; nothing is changed there"),
            taking_path_name(tmp_path / "run.nc"),
        ):
            raise error
    assert names(tmp_path) == ["run.nc"]
    assert (tmp_path / "run.nc").read_text() == "old"


@pytest.mark.dear
def test_an_archive_that_is_read_is_refused(run: xr.Dataset, tmp_path: Path) -> None:
    """Assert that an opened run keeps its file until it is closed, loaded or gone."""
    path = xd.save(run, tmp_path / "run.nc")
    for release in (lambda opened: opened.close(), lambda opened: opened.load(), lambda _: None):
        opened = xd.open_run(path)
        part = opened[["x"]]
        with pytest.raises(xd.InputError, match=r"is open: .* close that run \(run.close\(\)\) or load it"):
            xd.save(opened, path)
        del part
        release(opened)
        if release(opened) is None:
            del opened
            gc.collect()
        xd.save(run, path)


def test_a_complete_archive_is_kept(run: xr.Dataset, bad: xr.Dataset, tmp_path: Path) -> None:
    """Assert that a run that ended badly stands beside the one that did not, and that the next one takes its place."""
    path = xd.save(run, tmp_path / "run.nc")
    before = path.read_bytes()
    for _ in range(2):
        with pytest.warns(xd.PartialRunWarning, match=r"ended well and stays; .* is in '.*/run.partial.nc'") as told:
            assert xd.save(bad, path) == tmp_path / "run.partial.nc"
        assert told[0].filename == __file__
        assert path.read_bytes() == before
        assert names(tmp_path) == ["run.nc", "run.partial.nc"]
    assert verified(tmp_path / "run.partial.nc") == xd.content_digest(bad)


def test_a_bad_end_over_a_bad_end(run: xr.Dataset, bad: xr.Dataset, tmp_path: Path) -> None:
    """Assert that an archive of a run that ended badly is replaced by either."""
    path = xd.save(bad, tmp_path / "run.nc")
    assert xd.save(bad, path) == xd.save(run, path) == path
    assert verified(path) == xd.content_digest(run)


def test_an_interrupted_stream_stands_beside(run: xr.Dataset, tmp_path: Path) -> None:
    """Assert that Ctrl-C in a march to a file keeps what was there, and returns what it wrote."""
    path = xd.save(run, tmp_path / "run.nc")
    with pytest.warns(xd.PartialRunWarning, match="run.partial.nc"):
        found = xd.simulate(
            oscillator().model,
            step=1e-4,
            until=100.0,
            path=path,
            progress=lambda *_: signal.raise_signal(signal.SIGINT),
        )
    assert found.attrs["run_outcome"] == "interrupted"
    assert (verified(path), names(tmp_path)) == (
        xd.content_digest(run),
        [".run.nc.segments", "run.nc", "run.partial.nc"],
    )


@pytest.mark.filterwarnings("always::xdynamics.faults.PartialRunWarning")
def test_the_command_says_where_it_is(tmp_path: Path) -> None:
    """Assert that the command line keeps a complete archive too, says so, and names the file that it wrote."""
    command = ["run", str(MODELS / "harmonic_oscillator.toml"), "-o", str(tmp_path / "run.nc"), "--until", "1 s"]
    assert CliRunner().invoke(main, command).exit_code == 0
    done = CliRunner().invoke(main, [*command, "--rtol", "1e-9", "--max-steps", "3"])
    assert done.exit_code == 1
    assert f"archive   {tmp_path / 'run.partial.nc'}" in done.stdout
    assert "ended well and stays" in done.stderr


def test_parts_of_living_processes_stay(tmp_path: Path) -> None:
    """Assert that a temporary file is left alone while it is locked, and removed when nobody locks it any more."""
    with TemporaryFile.create_beside(tmp_path / "run.nc", 0o600) as part:
        sweep_temporary_files(tmp_path)
        assert len(names(tmp_path)) == 2
        os.close(part.handle)
        sweep_temporary_files(tmp_path)
        assert names(tmp_path) == []
        os.dup2(os.open(os.devnull, os.O_RDONLY), part.handle)  # which the end of the part closes


def test_what_could_not_be_written_takes_no_room(tmp_path: Path) -> None:
    """Assert that a temporary file that is given up is empty for who still has it open, as HDF5 may until the end."""
    with TemporaryFile.create_beside(tmp_path / "run.nc", 0o600) as part:
        held = part.path.open("wb")
        held.write(b"as much as the disk had room for")
        held.flush()
    assert names(tmp_path) == []
    assert os.fstat(held.fileno()).st_size == 0
    held.close()


def test_files_of_others_stay(run: xr.Dataset, tmp_path: Path) -> None:
    """Assert that of files with such names only those are removed that hold what a dead process began to write."""
    for name, content in ((".run.nc.abcd1234.part", b"\x89HDF\r\n\x1a\n and more"), (".notes.abcd1234.part", b"dear")):
        (tmp_path / name).write_bytes(content)
    (tmp_path / ".film.part").write_bytes(b"")
    (tmp_path / ".link.abcd1234.part").symlink_to(tmp_path / ".film.part")
    xd.save(run, tmp_path / "other.nc")
    assert names(tmp_path) == [".film.part", ".link.abcd1234.part", ".notes.abcd1234.part", "other.nc"]


HANGING = """
import sys, time
from pathlib import Path
from xdynamics.archive.target import taking_path_name
with taking_path_name(Path(sys.argv[1])) as new:
    print(new.part.name, flush=True)
    time.sleep(60)
"""


def test_what_a_killed_process_left_is_removed(run: xr.Dataset, tmp_path: Path) -> None:
    """Assert that a save in the folder leaves the part of a living process, and removes that of a killed one."""
    writing = [
        subprocess.Popen([sys.executable, "-c", HANGING, str(tmp_path / "one.nc")], stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    parts = []
    for one in writing:
        assert one.stdout is not None
        parts.append(one.stdout.readline().strip())
        one.stdout.close()
    writing[0].kill()
    writing[0].wait()
    assert {*parts} <= {*names(tmp_path)}
    xd.save(run, tmp_path / "two.nc")
    assert names(tmp_path) == sorted([parts[1], f"{parts[1]}.lock", "two.nc"])
    writing[1].kill()
    writing[1].wait()
    xd.save(run, tmp_path / "two.nc")
    assert names(tmp_path) == ["two.nc"]


@pytest.mark.dear
@pytest.mark.parametrize("complete", [False, True])
def test_sigterm_ends_the_command_cleanly(run: xr.Dataset, tmp_path: Path, *, complete: bool) -> None:
    """Assert that SIGTERM keeps the rows so far, beside a complete archive, leaves no temporary file, and says 143."""
    path = tmp_path / "run.nc"
    if complete:
        xd.save(run, path)
    command = [
        sys.executable,
        "-c",
        "from xdynamics.cli import main; main()",
        "run",
        str(MODELS / "harmonic_oscillator.toml"),
        "-o",
        str(path),
        "--step",
        "1e-6 s",
        "--until",
        "300 s",
        "--force-samples",
        "none",
    ]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
    while not list(tmp_path.glob(".*.part")) and process.poll() is None:
        time.sleep(0.05)
    time.sleep(0.5)
    process.send_signal(signal.SIGTERM)
    said = process.communicate(timeout=60)[1]
    assert process.returncode == 143, said
    assert said.endswith("xdynamics: terminated\n")
    partial = tmp_path / ("run.partial.nc" if complete else "run.nc")
    assert xd.open_run(partial).attrs["run_outcome"] == "interrupted"
    assert names(tmp_path) == sorted({".run.nc.segments", "run.nc", partial.name})


NAMES = [
    " run.nc",
    "run.nc ",
    "new\nline.nc",
    os.fsdecode(b"caf\xe9.nc"),
    "Grüße.nc",
    "http:",
    "a#mode=zarr",
    "n" * 252 + ".nc",
]


@pytest.mark.every(3)
@pytest.mark.parametrize("name", NAMES)
def test_any_name_is_right(run: xr.Dataset, tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a file gets the very name that it was given, byte by byte, relative to where the process is."""
    monkeypatch.chdir(tmp_path)
    xd.save(run, name)
    assert names(tmp_path) == [name]
    assert verified(name) == xd.content_digest(xd.open_run(name)) == xd.content_digest(run)


@pytest.mark.parametrize(("name", "fault"), [("n" * 256, "File name too long"), ("a\\b.nc", "has a backslash")])
def test_a_name_that_cannot_be(run: xr.Dataset, tmp_path: Path, name: str, fault: str) -> None:
    """Assert that a name that the system or the library does not take is one error, before anything is written."""
    read: tuple[Callable[[Path], object], ...] = (lambda path: xd.save(run, path), xd.open_run, xd.verify)
    for act in read:
        with pytest.raises(xd.InputError, match=fault):
            act(tmp_path / name)
    assert names(tmp_path) == []


@pytest.mark.parametrize("name", ["run.csv", "run.PNG", "run.toml", "run.json", "run.txt", "run.xlsx"])
def test_a_name_of_another_kind_of_file_is_refused(tmp_path: Path, name: str) -> None:
    """Assert one line that names the suffix and a name that would do, before anything is marched or written."""
    with no_march(), pytest.raises(xd.InputError, match=rf"ends in '\.{name.split('.')[1]}'.*name it like '.*run\.nc'"):
        xd.simulate(xd.Model.from_toml("data/models/ball_drag.toml"), path=tmp_path / name)
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize("name", ["run", "run.nc", "run.NC", "run.h5", "step_0.5", "run.2"])
def test_other_names_are_an_archives(tmp_path: Path, name: str) -> None:
    """Assert that what ends in no suffix, or in a number, may be an archive's name."""
    path = tmp_path / name
    xd.simulate(xd.Model.from_toml("data/models/ball_drag.toml"), path=path).close()
    assert xd.open_run(path).attrs["run_outcome"] in ("completed", "stopped_by_event")


WAYS = {
    "save": lambda path: xd.save(xd.simulate(oscillator().model, step=0.1, until=1.0), path),
    "simulate": lambda path: xd.simulate(oscillator().model, step=0.1, until=1.0, path=path).close(),
    "segment": lambda path: segments.write_segment(path, {}, {"a": np.ones(3)}, [("b", "f8", (2,))], [np.ones(2)]),
}


@pytest.mark.parametrize("way", WAYS)
def test_a_file_reaches_the_disk_before_it_takes_its_name(
    way: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert that the whole file is synced, then renamed, and then the folder is synced that holds the name."""
    done: list[Any] = []
    sync, rename = os.fsync, os.replace

    def synced(handle: int) -> None:
        sync(handle)
        done.append((os.fstat(handle).st_ino, os.fstat(handle).st_size))

    def renamed(old: Path, new: Path) -> None:
        rename(old, new)
        done.append(Path(new))

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(os, "replace", renamed)
    path = tmp_path / "run.nc"
    WAYS[way](path)
    named = done.index(path)
    assert (path.stat().st_ino, path.stat().st_size) in done[:named]
    assert tmp_path.stat().st_ino in [one[0] for one in done[named + 1 :] if isinstance(one, tuple)]


def test_a_new_file_has_the_rights_of_any_new_file(tmp_path: Path) -> None:
    """Assert that nobody loses or gets a right by the temporary name, and that one that replaces a file is private until then."""
    usual, new = tmp_path / "usual", tmp_path / "new"
    usual.touch()
    with taking_path_name(new) as file:
        file.part.write_bytes(b"1")
    assert new.stat().st_mode == usual.stat().st_mode
    with taking_path_name(usual) as file:
        assert file.part.stat().st_mode & 0o077 == 0
        file.part.write_bytes(b"1")
    assert usual.stat().st_mode == new.stat().st_mode


def test_a_file_that_is_not_the_model_s_may_be_replaced(tmp_path: Path) -> None:
    """Assert that a model's own file is refused, and another one is not, wherever the model came from."""
    path, old = tmp_path / "free.toml", tmp_path / "run.nc"
    path.write_text(oscillator().model.to_toml())
    old.touch()
    model = xd.Model.from_toml(path)
    with pytest.raises(xd.InputError, match="is the model file itself"):
        check_path_target(path, model)
    path.unlink()
    for one in (model, oscillator().model, xd.Model.from_toml(MODELS / "rocket_c6.toml"), None):
        check_path_target(old, one)


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

"""Runs that were killed, interrupted or ran out of disk go on to the same bits; what cannot is told."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

import xdynamics as xd
from cases.problems import MODELS
from cases.verdicts import verified
from xdynamics.archive import segments
from xdynamics.cli import main
from xdynamics.march import March
from xdynamics.march.configuration import settings_for

PENDULUM = xd.Model.from_toml(MODELS / "pendulum.toml")
ASKED: dict[str, Any] = {"method": "rk4", "step": 1e-3, "until": 40.0}


class PowerCut(Exception):
    """Ends a run as nothing that it expects."""


def cut(_done: float, t: float, _rows: int) -> None:
    """End a run in its second half."""
    if t > 25.0:
        raise PowerCut


@pytest.fixture
def often(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep a segment of every block, of 5000 rows."""
    monkeypatch.setattr(segments, "EVERY", 0.0)
    monkeypatch.setattr(segments, "SHARE", 0.0)
    monkeypatch.setattr(segments.Segments, "patience", float("inf"))
    monkeypatch.setattr("xdynamics.archive.segments.BLOCK_ROWS", 5_000)


@pytest.fixture
def broken(often: None, tmp_path: Path) -> Iterator[Path]:  # noqa: ARG001 - a fixture that sets the stage
    """The file of a run that broke off and left segments."""
    path = tmp_path / "run.nc"
    with pytest.raises(PowerCut):
        xd.simulate(PENDULUM, **ASKED, path=path, progress=cut)
    assert [name.name for name in names(path)] == [f"00000{n}.segment" for n in range(1, 6)]
    yield path
    assert not list(tmp_path.glob(".*.part"))


def names(path: Path) -> list[Path]:
    """The segments of a run."""
    return sorted(segments.segments_folder(path).glob("*"))


def whole() -> str:
    """The digest of the uninterrupted run."""
    return xd.content_digest(xd.simulate(PENDULUM, **ASKED))


def call(*arguments: object) -> Result:
    """Run a command in this process."""
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


@pytest.mark.dear
def test_kills_of_whole_processes(request: pytest.FixtureRequest) -> None:
    """Assert equal digests of three kinds of run, with --whole of six, each killed once or twice at random and resumed."""
    kinds = "6" if request.config.getoption("--whole") else "3"
    script = Path(__file__).parents[1] / "cases" / "killing.py"
    environment = os.environ | {"NUMBA_NUM_THREADS": "1", "PYTHONPATH": str(script.parents[1])}
    done = subprocess.run(
        [sys.executable, script, "fork", kinds, "5"], capture_output=True, text=True, check=True, env=environment
    )
    assert done.stdout.splitlines()[-1] == f"{kinds} of {kinds} digests equal", done.stdout + done.stderr
    assert sum(int(line.split()[-4]) for line in done.stdout.splitlines()[:-1]) > 1


@pytest.mark.dear
def test_kills_between_segments() -> None:
    """Assert equal digests and nothing left of runs that are killed with segments, while these become archives too."""
    script = Path(__file__).parents[1] / "cases" / "killing.py"
    environment = os.environ | {"NUMBA_NUM_THREADS": "1", "PYTHONPATH": str(script.parents[1])}
    done = subprocess.run(
        [sys.executable, script, "aimed", "3"], capture_output=True, text=True, check=False, env=environment
    )
    last = done.stdout.splitlines()[-1]
    assert last.startswith("3 of 3 digests equal, "), done.stdout + done.stderr
    assert int(last.split()[-6]) > 0


def test_resumed_is_uninterrupted(broken: Path) -> None:
    """Assert the bits of the uninterrupted run, fewer rows marched, and that nothing is left behind."""
    seen: list[float] = []
    run = xd.simulate(PENDULUM, **ASKED, path=broken, resume=True, progress=lambda _done, t, _rows: seen.append(t))
    assert verified(broken) == run.attrs["content_digest"] == whole()
    assert min(seen) > 24.0
    assert [entry.name for entry in broken.parent.iterdir()] == ["run.nc"]


def test_short_runs_leave_no_segments(tmp_path: Path) -> None:
    """Assert that a run that is over in time pays nothing: no folder is made."""
    with pytest.raises(PowerCut):
        xd.simulate(PENDULUM, **ASKED, path=tmp_path / "run.nc", progress=cut)
    assert list(tmp_path.iterdir()) == []


def test_interrupted_is_resumed(tmp_path: Path) -> None:
    """Assert that Ctrl-C leaves the rows so far, however few, and --resume goes on from the last of them."""
    path, asked = tmp_path / "run.nc", ("--step", "1 ms", "--until", "40 s", "--method", "rk4")

    def interrupt(*_told: object) -> None:
        os.kill(os.getpid(), 2)

    stopped = xd.simulate(PENDULUM, **ASKED, path=path, progress=interrupt)
    assert stopped.attrs["run_outcome"] == "interrupted"
    stopped.close()
    again = call("run", MODELS / "pendulum.toml", "-o", path, *asked)
    assert again.exit_code == 2
    assert "has segments of a run that is not finished" in again.output
    done = call("run", MODELS / "pendulum.toml", "-o", path, *asked, "--resume")
    assert done.exit_code == 0, done.output
    assert verified(path) == whole()


@pytest.mark.dear
def test_a_full_disk_is_resumed(tmp_path: Path) -> None:
    """Assert that segments outlive a write that fails, and the run goes on from them once there is room."""
    script = (
        "import resource, signal, sys\nimport xdynamics as xd\nfrom xdynamics.archive import segments, writing\n"
        "from test_resume import ASKED, PENDULUM\nwriting.CHUNKS = writing.CHUNKS | {'step': 5_000}  # each block reaches the disk\n"
        "segments.EVERY, segments.Segments.patience = 0.0, float('inf')\nsegments.BLOCK_ROWS = 5_000\nsignal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (2_000_000, 2_000_000))\n"
        "try:\n    xd.simulate(PENDULUM, **ASKED, path=sys.argv[1])\n"
        "except xd.ArchiveError as error:\n    print(error)"
    )
    path, environment = (
        tmp_path / "run.nc",
        os.environ | {"PYTHONPATH": f"{Path(__file__).parents[1]}{os.pathsep}{Path(__file__).parent}"},
    )
    done = subprocess.run(
        [sys.executable, "-c", script, path], capture_output=True, text=True, check=True, env=environment
    )
    assert f"'{path}' cannot be written" in done.stdout
    assert 0 < len(names(path)) < 8  # of nine blocks, the last of which do not fit
    with warnings.catch_warnings():  # a last segment may hold what the full disk lost, which its digests tell
        warnings.simplefilter("ignore", xd.ResumeWarning)
        xd.simulate(PENDULUM, **ASKED, path=path, resume=True)
    assert verified(path) == whole()


def test_segments_without_room_do_not_end_the_run(often: None, tmp_path: Path) -> None:  # noqa: ARG001
    """Assert that a run whose segments cannot be written says so once and is finished."""
    folder = segments.segments_folder(tmp_path / "run.nc")
    folder.write_text("no folder")
    with pytest.warns(
        xd.ResumeWarning, match=r"no more segments of '.*run.nc' can be kept: File exists; the run goes on"
    ) as told:
        xd.simulate(PENDULUM, **ASKED, path=tmp_path / "run.nc")
    assert len(told) == 1
    assert verified(tmp_path / "run.nc") == whole()


def test_a_second_process_does_not_end_the_run(often: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: ARG001
    """Assert that a run into whose archive another process has begun to march says so once and is finished."""
    keep, folder = segments.Segments.keep, segments.segments_folder(tmp_path / "run.nc")

    def kept(one: segments.Segments, *given: Any) -> None:
        folder.mkdir(exist_ok=True)
        keep(one, *given)

    monkeypatch.setattr(segments.Segments, "keep", kept)
    with pytest.warns(
        xd.ResumeWarning, match="can be kept: another process writes into it too; the run goes on"
    ) as told:
        xd.simulate(PENDULUM, **ASKED, path=tmp_path / "run.nc")
    assert len(told) == 1
    assert verified(tmp_path / "run.nc") == whole()


@pytest.mark.dear
def test_a_run_that_broke_off_while_it_was_sealed(often: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: ARG001
    """Assert that no segment is of a run that is over, so that what stopped it is found out again."""
    rocket, path = xd.Model.from_toml(MODELS / "rocket_c6.toml"), tmp_path / "run.nc"
    with monkeypatch.context() as patch:
        patch.setattr("xdynamics.archive.writing.Writer.finish", lambda *_: (_ for _ in ()).throw(PowerCut))
        with pytest.raises(PowerCut):
            xd.simulate(rocket, step=1e-3, path=path)
    assert names(path)
    run = xd.simulate(rocket, step=1e-3, path=path, resume=True)
    assert "event 'landing' stopped the run" in run.attrs["run_outcome_text"]
    assert verified(path) == xd.content_digest(xd.simulate(rocket, step=1e-3))


def test_short_runs_are_small_files(tmp_path: Path) -> None:
    """Assert that a streamed run of few rows takes no more room than a saved one."""
    run = xd.simulate(PENDULUM, step=0.01, until=1.0)
    saved, streamed = xd.save(run, tmp_path / "saved.nc"), tmp_path / "streamed.nc"
    xd.simulate(PENDULUM, step=0.01, until=1.0, path=streamed).close()
    assert streamed.stat().st_size == pytest.approx(saved.stat().st_size, rel=0.01)


@pytest.mark.dear
def test_no_segment_follows_one_that_failed(often: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: ARG001
    """Assert that after a segment that could not be written there is none, at a Ctrl-C neither: rows would be missing."""
    whole_ones = iter([True, True, False])

    def written(*given: Any) -> str:
        if not next(whole_ones, True):
            raise OSError(28, "No space left on device")
        return write(*given)

    write, path = segments.write_segment, tmp_path / "run.nc"
    monkeypatch.setattr(segments, "write_segment", written)
    stop = [False] * 7 + [True]
    with pytest.warns(xd.ResumeWarning, match="No space left on device; the run goes on"):
        run = xd.simulate(
            PENDULUM, **ASKED, path=path, progress=lambda *_: os.kill(os.getpid(), 2) if stop and stop.pop(0) else None
        )
    assert run.attrs["run_outcome"] == "interrupted"
    run.close()
    assert [name.name for name in names(path)] == ["000001.segment", "000002.segment"]
    xd.simulate(PENDULUM, **ASKED, path=path, resume=True).close()
    assert verified(path) == whole()


@pytest.mark.parametrize("name", ["n" * 300, "nul\0", "nowhere/run.nc", "."])
def test_what_is_no_target_has_no_segments(tmp_path: Path, name: str) -> None:
    """Assert that resume and discard refuse a path that no run can be streamed to."""
    for act in (lambda path: xd.simulate(PENDULUM, **ASKED, path=path, resume=True), xd.discard):
        with pytest.raises(xd.InputError, match="no path for a file|does not exist|is a directory|has no segments"):
            act(tmp_path / name)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"until": 50.0}, "until was 40.0 and is 50.0"),
        ({"step": 2e-3}, "step was 0.001 and is 0.002"),
        ({"method": "heun"}, "method was rk4 and is heun"),
        ({"force_samples": "none"}, "samples was True and is False"),
        ({"nodes": [1.0]}, r"nodes was \(\) and is \(1.0,\)"),
        ({"scales": {"length": "2 m"}}, "scales.length was 1.0 and is 2.0"),
    ],
)
def test_other_settings_are_refused(broken: Path, changed: dict[str, Any], message: str) -> None:
    """Assert that a run with another setting is not put behind what is there; the setting is named, nothing lost."""
    with pytest.raises(xd.InputError, match=rf"are of another run: .*{message}.*xdynamics discard"):
        xd.simulate(PENDULUM, **ASKED | changed, path=broken, resume=True)
    assert len(names(broken)) == 5


def test_another_model_is_refused(broken: Path) -> None:
    """Assert that a changed parameter is named."""
    with pytest.raises(
        xd.InputError, match=r"model.parameters.l was '1.0 m' and is '2.0 m'; resume it as it was begun"
    ):
        xd.simulate(PENDULUM.replace(parameters={"l": 2.0}), **ASKED, path=broken, resume=True)


def flipped(content: bytearray, at: int) -> bytes:
    """Change one bit."""
    content[at] ^= 4
    return bytes(content)


@pytest.mark.every(11)
@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda content: content[:-1], r"has \d+ bytes and says \d+"),
        (lambda content: content + b"0", r"has \d+ bytes and says \d+"),
        (lambda content: flipped(content, len(content) - 1), "differs from the digest of 'sample_"),
        (lambda content: flipped(content, 40), "differs from its digest|is of another version|is damaged"),
        (lambda content: flipped(content, content.index(b"\n") + 50), "differs from its digest"),
        (lambda _: b"", "is damaged, or no segment"),
        (lambda _: b"{}\n", "is damaged, or no segment"),
        (
            lambda _: b'{"kind": "xdynamics segment 1", "memory": [["y", "O", [9]]], "rows": []}\n',
            "is damaged|is cut off|differs",
        ),
    ],
)
def test_a_damaged_segment_is_named(broken: Path, damage: Any, message: str) -> None:
    """Assert that the run goes on from the last whole segment before it, says so, and comes to the same bits."""
    third = names(broken)[2]
    third.write_bytes(damage(bytearray(third.read_bytes())))
    with pytest.warns(
        xd.ResumeWarning, match=rf"segment '.*000003.segment' ({message}).*: the run goes on from t = [\d.]+ s"
    ):
        xd.simulate(PENDULUM, **ASKED, path=broken, resume=True)
    assert verified(broken) == whole()


@pytest.mark.every(3)
@pytest.mark.parametrize(
    ("lost", "told"),
    [
        (lambda all_of: all_of[0].unlink(), "000002.segment' does not follow the one before it: the run starts anew"),
        (lambda all_of: all_of[2].replace(all_of[1]), "000002.segment' does not follow .*: the run goes on from t ="),
        (
            lambda all_of: all_of[4].rename(all_of[4].with_stem("000009")),
            "000009.segment' does not follow .* goes on from",
        ),
    ],
)
def test_a_missing_segment_is_named(broken: Path, lost: Callable[[list[Path]], object], told: str) -> None:
    """Assert that segments behind a gap are not taken for those before it, whatever they are called."""
    lost(names(broken))
    with pytest.warns(xd.ResumeWarning, match=told):
        xd.simulate(PENDULUM, **ASKED, path=broken, resume=True)
    assert verified(broken) == whole()


@pytest.mark.dear
def test_nothing_to_resume(tmp_path: Path) -> None:
    """Assert that it is said, and the run made; that a whole one is left as it is; and where resume has no place."""
    path = tmp_path / "run.nc"
    with pytest.warns(
        xd.ResumeWarning, match=r"there are no segments of '.*run.nc' to go on from: it is computed from its start"
    ):
        xd.simulate(PENDULUM, **ASKED, path=path, resume=True)
    before = path.stat()
    xd.simulate(PENDULUM, **ASKED, path=path, resume=True).close()
    assert path.stat() == before
    chosen: dict[str, Any] = {
        "method": "dop853",
        "atol": {"theta": "1 nrad"},
        "until": 2.0,
        "path": tmp_path / "chosen.nc",
    }
    xd.simulate(PENDULUM, **chosen).close()
    xd.simulate(PENDULUM, **chosen, resume=True).close()  # without a warning
    with pytest.raises(xd.InputError, match="resume needs path="):
        xd.simulate(PENDULUM, **ASKED, resume=True)


def test_discard_removes_segments_alone(broken: Path) -> None:
    """Assert that the segments go and nothing else, and that a second time says so."""
    other = broken.with_name("other.nc")
    other.write_text("another")
    done = call("discard", broken)
    assert (done.exit_code, done.output) == (0, f"discarded 5 segments of {broken}\n")
    assert [entry.name for entry in broken.parent.iterdir()] == ["other.nc"]
    assert call("discard", broken).exit_code == 2
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", xd.ResumeWarning)
        xd.simulate(PENDULUM, **ASKED, path=broken, resume=True).close()


def test_two_processes_do_not_share_segments(broken: Path) -> None:
    """Assert that a run that is being marched is neither resumed nor discarded by another process."""
    script = (
        "import fcntl, os, sys\nhandle = os.open(sys.argv[1], os.O_RDONLY)\nfcntl.flock(handle, fcntl.LOCK_EX)\n"
        "print('held', flush=True)\nsys.stdin.read()"
    )
    command = [sys.executable, "-c", script, segments.segments_folder(broken)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"held\n"
        for act in (lambda: xd.simulate(PENDULUM, **ASKED, path=broken, resume=True), lambda: xd.discard(broken)):
            with pytest.raises(xd.InputError, match="is being computed by another process"):
                act()
        holder.communicate()
    assert len(names(broken)) == 5


@pytest.mark.dear
def test_slow_steps_are_kept_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a block is handed over when its time is up, with the same bits."""
    monkeypatch.setattr("xdynamics.march.runner.LOOK", 0.0)
    blocks = list(March(PENDULUM, settings_for(PENDULUM, **ASKED)).blocks(50_000, patience=1e-4))
    assert len(blocks) > 1
    assert sum(block.rows for block in blocks) == xd.simulate(PENDULUM, **ASKED).sizes["step"]

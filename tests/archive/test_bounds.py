"""Files that ask too much of their reader: refused before anything of them is read, or read where it does no harm."""

from __future__ import annotations

import os
import signal
import socket
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.problems import oscillator
from cases.verdicts import verified
from xdynamics.archive import sandboxed_reading
from xdynamics.archive.file_structure import size_faults, unused_dimensions
from xdynamics.archive.sandboxed_reading import _Examiner
from xdynamics.archive.seals import seal_file, tail_of


def rows(file: Any) -> None:
    """Declare 2**40 rows that were never written."""
    file.createDimension("step", 2**40)
    file.createVariable("time", "f8", ("step",))


def growing(file: Any) -> None:
    """Write the last of 2**34 rows."""
    file.createDimension("step", None)
    file.createVariable("time", "f8", ("step",), chunksizes=(1024,), fill_value=False)[2**34 - 1] = 1.0


def deflated(file: Any) -> None:
    """Compress zeros, of which there are many more than bytes."""
    file.createDimension("step", 2**29)
    file.createVariable("time", "f8", ("step",), zlib=True, chunksizes=(2**20,))[: 2**20] = 0.0


def one_chunk(file: Any) -> None:
    """Put three rows into a compressed chunk of 256 MB."""
    file.createDimension("step", None)
    file.createVariable("time", "f8", ("step",), zlib=True, chunksizes=(2**25,), fill_value=False)[:3] = 1.0


def shared(file: Any) -> None:
    """Declare many variables of which each would just fit."""
    file.createDimension("step", 2000)
    for i in range(100):
        file.createVariable(f"v{i}", "f8", ("step",), chunksizes=(2000,))
    file.createVariable("time", "f8", ("step",), contiguous=True)[:] = 1.0
    file.createVariable("much", "f8", ("step",), contiguous=True)[:] = 1.0


def small(file: Any) -> None:
    """Compress what is small, in another way than archives do."""
    file.createDimension("step", 10)
    file.createVariable("time", "f8", ("step",), compression="bzip2")[:] = 1.0


BOMBS = {
    rows: r"variable 'time' declares 8796093022208 bytes, and the file has \d+",
    growing: "variable 'time' declares 137438953472 bytes",
    deflated: "variable 'time' declares 4294967296 bytes",
    one_chunk: "variable 'time' declares 268435456 bytes",
    shared: r"the variables declare \d+ bytes, and the file has \d+",
    small: r"variable 'time' is compressed \(bzip2\)",
}


@pytest.fixture(scope="module", params=BOMBS, ids=lambda one: one.__name__)
def bomb(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A file that holds less than it says, with a seal as it should be, and what is to be said of it."""
    import netCDF4

    path = tmp_path_factory.mktemp("bombs") / "bomb.nc"
    with netCDF4.Dataset(path, "w") as file:
        request.param(file)
    seal_file(path)
    return path, BOMBS[request.param]


@pytest.mark.every(3)
@pytest.mark.parametrize("read", [xd.verify, xd.open_run, lambda path: xd.open_run(path, check=False), xd.reproduce])
def test_more_than_there_is(bomb: tuple[Path, str], read: Callable[[Path], object]) -> None:
    """Assert that what a file declares is held against what it has, before any of it is read, checked or not."""
    with pytest.raises(xd.ArchiveError, match=rf"bomb.nc' is damaged or no run archive:\n  1\. {bomb[1]}"):
        read(bomb[0])


def test_a_file_of_nothing(tmp_path: Path) -> None:
    """Assert that a file of a terabyte of which nothing is on the disk is refused."""
    path = xd.save(xd.simulate(oscillator().model, step=0.1, until=1.0), tmp_path / "run.nc")
    with path.open("r+b") as file:
        file.truncate(2**40)
    for read in (xd.verify, xd.open_run, lambda path: xd.open_run(path, check=False)):
        with pytest.raises(xd.ArchiveError, match="1099511627776 bytes, but almost none of them are on the disk"):
            read(path)


def declared(*variables: tuple[str, Any, tuple[int, ...], Any, Any]) -> Any:
    """Return what the library would say of a file with some variables."""
    kinds = {
        name: SimpleNamespace(dtype=dtype, shape=shape, chunking=lambda c=chunks: c, filters=lambda f=filters: f)
        for name, dtype, shape, chunks, filters in variables
    }
    return SimpleNamespace(variables=kinds)


def sized(size: int, **more: int) -> Any:
    """Return a path to a file of so many bytes."""
    return SimpleNamespace(stat=lambda: SimpleNamespace(st_size=size, **more))


PACKED = {"zlib": True, "szip": False, "complevel": 1, "shuffle": True}
F8, PLAIN = np.dtype("f8"), {"zlib": False, "szip": False, "complevel": 4, "shuffle": True}
WHOLE, LONG = ("a", F8, (10,), "contiguous", PLAIN), ("b", F8, (4,), [11], None)


@pytest.mark.parametrize(
    ("variables", "size", "said"),
    [
        ([WHOLE], 80, []),
        ([WHOLE], 79, ["variable 'a' declares 80 bytes, and the file has 79"]),
        ([LONG], 88, []),
        ([LONG], 87, ["variable 'b' declares 88 bytes, and the file has 87"]),
        ([("b", F8, (0,), [11], None)], 1, []),
        ([("b", F8, (0, 5), (11, 5), None)], 1, []),
        ([("b", F8, (4, 5), (2, 6), None)], 159, ["variable 'b' declares 160 bytes, and the file has 159"]),
        ([("t", str, (2,), "contiguous", None)], 31, ["variable 't' declares 32 bytes, and the file has 31"]),
        ([WHOLE, LONG], 112, []),
        ([WHOLE, LONG], 111, ["the variables declare 112 bytes, and the file has 111"]),
        ([WHOLE, LONG], 87, ["variable 'b' declares 88 bytes, and the file has 87"]),
        ([("a", F8, (1000,), [100], PACKED)], 80, []),
        ([("a", F8, (1000,), [100], PACKED)], 79, ["variable 'a' declares 8000 bytes, and the file has 79"]),
        ([WHOLE, ("c", F8, (1000,), [100], PACKED)], 160, []),
        ([WHOLE, ("c", F8, (1000,), [100], PACKED)], 159, ["the variables declare 8080 bytes, and the file has 159"]),
        ([("a", F8, (10,), [1 << 22], PACKED)], 80, []),
        (
            [("a", F8, (10,), [1 + (1 << 22)], PACKED)],
            80,
            ["variable 'a' declares 33554440 bytes, and the file has 80"],
        ),
        (
            [(*WHOLE[:4], {"zlib": True, "szip": {"mask": 1}, "shuffle": True})],
            80,
            ["variable 'a' is compressed (zlib, szip), which no variable of an archive is"],
        ),
    ],
)
def test_what_is_declared_is_held_against_the_bytes(variables: list[Any], size: int, said: list[str]) -> None:
    """Assert that a variable, a chunk of it and all variables together must fit into the file, to the byte."""
    assert size_faults(sized(size, st_blocks=1), declared(*variables)) == said


@pytest.mark.parametrize(
    ("size", "blocks", "sparse"),
    [
        (10_000_000, 0, False),
        (10_000_001, 0, True),
        (51_200_000, 100, False),
        (51_200_001, 100, True),
        (2**40, None, False),
    ],
)
def test_bytes_that_are_on_no_disk(size: int, blocks: int | None, *, sparse: bool) -> None:
    """Assert that a large file of which a thousandth is there is refused, where the system says how much is."""
    about = {} if blocks is None else {"st_blocks": blocks}
    said = [f"the file says that it has {size} bytes, but almost none of them are on the disk"]
    assert size_faults(sized(size, **about), declared()) == said * sparse


def test_what_no_archive_has_is_told() -> None:
    """Assert that dimensions that no variable has are named one by one."""
    variables = {"x": SimpleNamespace(dimensions=("step",))}
    file: Any = SimpleNamespace(dimensions={"step": 0, "more": 0, "most": 0}, variables=variables)
    assert unused_dimensions(file) == [f"dimension '{name}' is none of a run" for name in ("more", "most")]


@pytest.mark.parametrize("kind", ["a pipe", "a socket", "a directory"])
@pytest.mark.parametrize("read", [xd.verify, xd.open_run, xd.reproduce, xd.Model.from_toml])
def test_what_is_no_file_is_never_opened(tmp_path: Path, kind: str, read: Callable[[Path], object]) -> None:
    """Assert that a pipe, which nobody writes to, a socket and a directory are one error, and no wait."""
    path = tmp_path / "it"
    with socket.socket(socket.AF_UNIX) as listening:
        {"a pipe": lambda: os.mkfifo(path), "a directory": path.mkdir, "a socket": lambda: listening.bind(str(path))}[
            kind
        ]()
        with pytest.raises(xd.InputError, match=f"is {kind}|No such device"):
            read(path)


def test_a_model_has_a_limit(tmp_path: Path) -> None:
    """Assert that a model file and a model text have a largest size, and that it is said."""
    path = tmp_path / "large.toml"
    with path.open("wb") as file:
        file.truncate(20_000_001)
    with pytest.raises(xd.ModelError, match="20000001 bytes, over the limit of 20000000; keep its numbers in tables"):
        xd.Model.from_toml(path)
    with pytest.raises(xd.ModelError, match=r"20000001 characters, .*read by Model\.from_record"):
        xd.Model.from_text(" " * 20_000_001)


@pytest.fixture
def other() -> Any:
    """An examining process of one's own."""
    made = _Examiner()
    yield made
    made.end()


def test_what_takes_too_long_is_ended(tmp_path: Path, other: _Examiner, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that the time that a file may take is bounded, and that the process then takes the next."""
    path = xd.save(xd.simulate(oscillator().model, step=1e-4, until=5.0), tmp_path / "run.nc")
    monkeypatch.setattr(sandboxed_reading, "BYTES_PER_SECOND", 1e15)
    slow = other.examine(path, tail_of(path), seconds=1e-3)
    assert slow.faults == ("it takes more than 0.001 s to read, which no archive of its size does",)
    assert other.examine(path, tail_of(path)).faults == ()


def test_what_takes_too_much_is_ended(tmp_path: Path, other: _Examiner) -> None:
    """Assert that the memory that a file may take is bounded, and that the process then takes the next."""
    path = xd.save(xd.simulate(oscillator().model, step=1e-4, until=5.0), tmp_path / "run.nc")
    faults = other.examine(path, tail_of(path), memory=200_000).faults
    assert "cannot be read" in faults[0] or "break off" in faults[0]
    assert other.examine(path, tail_of(path)).faults == ()


def test_a_crash_is_one_error(tmp_path: Path, other: _Examiner, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a crash of the libraries is told as a fault of the file."""
    path = xd.save(xd.simulate(oscillator().model, step=0.1, until=1.0), tmp_path / "run.nc")
    monkeypatch.setattr(other, "_ask_reader", lambda *_: {"code": -signal.SIGSEGV})
    with pytest.raises(xd.ArchiveError, match=r"the libraries break off when they read it \(exit code -11\)"):
        other.examine(path, tail_of(path)).raise_faults(path)


@pytest.mark.dear
def test_a_process_that_is_gone_is_replaced(tmp_path: Path, other: _Examiner) -> None:
    """Assert that a process that ended, for want of questions or otherwise, is started again."""
    path = xd.save(xd.simulate(oscillator().model, step=0.1, until=1.0), tmp_path / "run.nc")
    for _ in range(2):
        assert other.examine(path, tail_of(path)).digest == verified(path)
        assert other._process is not None
        os.killpg(other._process.pid, signal.SIGKILL)  # with its reader


def test_one_reader_reads_what_has_no_fault(tmp_path: Path, other: _Examiner, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a reader goes on to the next file, and that one which has read others accuses none alone."""
    path = xd.save(xd.simulate(oscillator().model, step=0.1, until=1.0), tmp_path / "run.nc")
    broken = tmp_path / "broken.nc"
    broken.write_bytes(path.read_bytes().replace(b"velocity_verlet", b"velocity_werlet"))
    asked: list[dict[str, Any]] = []
    answered = other._answered

    def noted(*question: Any) -> Any:
        asked.append(answered(*question))
        return {"code": -signal.SIGSEGV} if len(asked) == 3 else asked[-1]

    monkeypatch.setattr(other, "_answered", noted)
    assert [other.examine(file, tail_of(file)).faults == () for file in (path, path, path)] == [True] * 3
    assert len(asked) == 4  # the third was asked about twice: the first answer was a crash
    assert [bool(other.examine(file, tail_of(file)).faults) for file in (broken, broken, path)] == [True, True, False]
    assert len(asked) == 8  # `broken` twice, by a second reader; then once, by its own


def test_where_no_process_can_be_had(tmp_path: Path, other: _Examiner, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that without an interpreter to start files are examined in this process."""
    path = xd.save(xd.simulate(oscillator().model, step=0.1, until=1.0), tmp_path / "run.nc")
    monkeypatch.setattr(sandboxed_reading.sys, "executable", None)
    assert other.examine(path, tail_of(path)).digest == verified(path)
    assert other._process is None


def test_bytes_that_are_known_are_read_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that what this process wrote, or examined whole, needs no other process; one changed byte does."""
    path = xd.save(xd.simulate(oscillator().model, step=0.1, until=1.0), tmp_path / "run.nc")
    monkeypatch.setattr(sandboxed_reading._EXAMINER, "_ask_reader", lambda *_: {"code": 1})
    assert verified(path) == xd.content_digest(xd.open_run(path))
    content = bytearray(path.read_bytes())
    content[5000] ^= 1
    path.write_bytes(content)
    with pytest.raises(xd.ArchiveError, match="the libraries break off"):
        xd.open_run(path)


def test_a_long_run_takes_no_more_memory_to_read(tmp_path: Path) -> None:
    """Assert that an archive of 43 MB is read in 20 MB: the library keeps no chunk of what was read."""
    run = xd.simulate(oscillator().model, step=1e-5, until=4.0, force_samples="none")
    path = xd.save(run, tmp_path / "long.nc")
    assert path.stat().st_size > 40_000_000
    assert sandboxed_reading._EXAMINER.examine(path, tail_of(path), memory=20_000_000).faults == ()

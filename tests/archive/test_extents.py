"""Large archives on servers: their structure is read at the opening, and of their values what is used, each chunk compared."""

from __future__ import annotations

import io
import json
import pickle
import re
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import oscillator
from cases.verdicts import verified
from cases.web_server import WebServer, web_server
from xdynamics.archive import extents
from xdynamics.archive.seals import SEAL_LENGTH, seal_file

pytest.importorskip("aiohttp")
ROWS = 200_001


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a run of 49 MB."""
    place = tmp_path_factory.mktemp("large")
    xd.simulate(oscillator().model, method="rk4", step="10 ms", until=f"{(ROWS - 1) // 100} s", path=place / "run.nc")
    return place


@pytest.fixture
def server(folder: Path) -> Iterator[WebServer]:
    """A web server of that folder, which answers with parts."""
    with web_server(folder, parts=True) as served:
        yield served


@pytest.fixture
def copy(folder: Path) -> Iterator[Path]:
    """A copy that may be changed."""
    changed = folder / "copy.nc"
    changed.write_bytes((folder / "run.nc").read_bytes())
    yield changed
    changed.unlink()


def extents_of(path: Path) -> list[extents.FileExtent]:
    """The extents of a file."""
    content = path.read_bytes()
    return extents.extents_of(lambda start, end: content[start:end], len(content) - SEAL_LENGTH)


def damage(path: Path, name: str, index: int = 0) -> None:
    """Exchange a byte of an extent of a variable, or of the structure."""
    extent = [extent for extent in extents_of(path) if extent.name == name][index]
    with path.open("r+b") as file:
        file.seek(extent.start + extent.size // 2)
        byte = file.read(1)[0]
        file.seek(-1, io.SEEK_CUR)
        file.write(bytes([byte ^ 1]))


def test_every_byte_has_one_extent(folder: Path) -> None:
    """Assert that the list has all chunks by their variable and first row, and the digest of the run is that of memory."""
    listed = extents_of(folder / "run.nc")
    assert [extent.index for extent in listed if extent.name == "x"] == [(0,), (131_072,)]
    assert sum(extent.size for extent in listed if not extent.name) < 200_000
    assert sum(extent.size for extent in listed) < (folder / "run.nc").stat().st_size
    run = xd.simulate(oscillator().model, method="rk4", step="10 ms", until=f"{(ROWS - 1) // 100} s")
    assert verified(folder / "run.nc") == xd.content_digest(run)


@pytest.mark.parametrize(
    ("rows", "chunks"),
    [
        (slice(150_000, 150_100), 1),
        (slice(None, None, 140_000), 2),
        (slice(140_000, 120_000, -1), 2),
        (slice(-1, 140_000, -1), 1),
        (slice(5, 5), 0),
        ([0, -1, 131_072], 2),
        ([7, 7], 1),
        (131_071, 1),
        (slice(None), 2),
    ],
)
def test_rows_are_those_of_the_file(folder: Path, server: WebServer, rows: Any, chunks: int) -> None:
    """Assert rows of a run on a server against those of the file, and that no chunk is sent that they are not in."""
    there, here = xd.open_run(f"{server.address}/run.nc"), xd.open_run(folder / "run.nc")
    assert there.attrs == here.attrs
    opened = server.sent
    assert opened < 600_000
    for name in ("x", "time", "row_kind"):
        assert np.array_equal(there.variables[name][rows].values, here.variables[name][rows].values)
    assert chunks * 1_100_000 <= server.sent - opened <= chunks * 2_300_000


def test_a_lazy_run_reads_each_chunk_once(folder: Path, server: WebServer) -> None:
    """Assert sums of dask arrays by several threads, texts, a whole load, and that a pickled run is read again."""
    there = xd.open_run(f"{server.address}/run.nc", chunks={})
    here = xd.open_run(folder / "run.nc", chunks={})
    with ThreadPoolExecutor(4) as pool:
        sums = pool.map(lambda name: float(there[name].sum()), ["x", "v_x", "a_x", "x", "time", "total_energy"])
        assert [*sums] == [float(here[name].sum()) for name in ("x", "v_x", "a_x", "x", "time", "total_energy")]
    sent = server.sent
    assert float(there.x.sum()) == float(here.x.sum())
    assert server.sent == sent
    unpickled: xr.Dataset = pickle.loads(pickle.dumps(xd.open_run(f"{server.address}/run.nc")))
    assert unpickled.load().drop_encoding().identical(here.load().drop_encoding())
    assert xd.content_digest(xd.open_run(f"{server.address}/run.nc")) == xd.content_digest(here)


def test_an_exchanged_chunk_is_named(server: WebServer, copy: Path) -> None:
    """Assert that it is no number, that other rows and variables are read, and that `verify` names it."""
    damage(copy, "x", 1)
    run = xd.open_run(f"{server.address}/copy.nc")
    assert run.x[:100].values.size == run.v_x[:100].values.size == 100
    with pytest.raises(xd.ArchiveError, match=r"variable 'x' from \[131072\] on differs from its digest"):
        run.x[-1].values.item()
    with pytest.raises(xd.ArchiveError, match="differ"):
        xd.verify(f"{server.address}/copy.nc")


def test_exchanged_structure_is_named_at_the_opening(server: WebServer, copy: Path) -> None:
    """Assert that no structure is read whose digest differs."""
    damage(copy, "")
    with pytest.raises(xd.ArchiveError, match="its structure differs from its digest"):
        xd.open_run(f"{server.address}/copy.nc")


@pytest.mark.parametrize("mark", [True, False])
def test_a_file_that_was_replaced_is_named(server: WebServer, copy: Path, mark: bool) -> None:
    """Assert that no number of another run is read, whether the server tells versions apart or not."""
    server.mark = mark
    run = xd.open_run(f"{server.address}/copy.nc")
    first = run.x[:2].values
    other = oscillator().model.replace(initial={"x": "0.5 m"})
    xd.simulate(other, method="rk4", step="10 ms", until=f"{(ROWS - 1) // 100} s", path=copy)
    assert np.array_equal(run.x[:2].values, first)
    with pytest.raises(xd.ArchiveError, match="or was replaced since it was opened: variable 'x'"):
        run.x[-1].values.item()


def test_a_server_without_parts_sends_all(folder: Path) -> None:
    """Assert that its file is downloaded whole, and compared with its seal."""
    with web_server(folder, parts=False) as server:
        run = xd.open_run(f"{server.address}/run.nc")
        assert server.sent > 40_000_000
        assert run.x[-1].values == xd.open_run(folder / "run.nc").x[-1].values


def test_an_edited_run_is_told(server: WebServer, copy: Path) -> None:
    """Assert that an attribute that was changed is told at the opening."""
    with xd.open_run(copy) as run:
        edited = run.load()
    import netCDF4

    with netCDF4.Dataset(copy, "a") as file:
        file.setncattr("title", "Another")
    extents.append_extents(copy)
    seal_file(copy)
    with pytest.warns(xd.EditedWarning, match="the attributes differ from the content digest"):
        run = xd.open_run(f"{server.address}/copy.nc")
    assert run.x[-1].values == edited.x[-1].values


def relisted(path: Path, listed: bytes) -> None:
    """Give a file another list of extents, and its seal."""
    content = path.read_bytes()[:-SEAL_LENGTH]
    length = int(content[-extents.FOOTER :].split()[3])
    path.write_bytes(
        content[: -extents.FOOTER - length]
        + listed
        + extents.MARK
        + f"{len(listed):012d} {sha256(listed).hexdigest()}\n".encode()
    )
    seal_file(path)


@pytest.mark.parametrize(
    "listed",
    [
        b"[]",
        b"{}",
        b"[" * 100_000,
        b"not JSON",
        b"[[0, 5, 0, 0]]",
        b'[[0, 1e999, "", "", []]]',
        b'[[0, 10, "", "x", [0]]]',
        b'[[-5, 5, "", "", []]]',
        b'[[0, 20, "", "", []], [10, 20, "", "", []]]',
        b"\xff\xfe",
    ],
)
def test_a_hostile_list_is_named(server: WebServer, copy: Path, listed: bytes) -> None:
    """Assert that a list that is none of the file's bytes is refused at the opening."""
    relisted(copy, listed)
    with pytest.raises(xd.ArchiveError, match="copy.nc' is damaged: the list of its extents is not of its bytes"):
        xd.open_run(f"{server.address}/copy.nc")


def test_large_structure_and_chunks_are_downloaded_to_a_file(server: WebServer, copy: Path) -> None:
    """Assert that what would be held in memory is bounded: such a file is downloaded whole."""
    end = copy.stat().st_size - SEAL_LENGTH - extents.FOOTER
    size = sum(extent.size for extent in extents_of(copy))
    assert size < end
    relisted(copy, json.dumps([[0, size, "", "x", [0]]]).encode())
    run = xd.open_run(f"{server.address}/copy.nc")
    assert server.sent > 40_000_000
    assert run.x[-1].values.item() == pytest.approx(np.cos(20_000 / 10), abs=2)


def test_structure_that_keeps_the_reader_busy_is_named(server: WebServer, copy: Path) -> None:
    """Assert that structure with right digests that is none for HDF5 is refused by the process that reads it first."""
    listed = extents_of(copy)
    content = bytearray(copy.read_bytes())
    gap = listed[0]
    content[gap.start + 8 : gap.start + gap.size] = bytes(range(256)) * (gap.size // 256) + bytes(gap.size % 256 - 8)
    copy.write_bytes(content)
    rows: list[Any] = [[e.start, e.size, e.digest, e.name, list(e.index)] for e in listed]
    rows[0][2] = sha256(content[gap.start : gap.start + gap.size]).hexdigest()
    relisted(copy, json.dumps(rows).encode())
    with pytest.raises(xd.ArchiveError, match="copy.nc' is damaged or no run archive"):
        xd.open_run(f"{server.address}/copy.nc")
    with pytest.raises(xd.ArchiveError, match="copy.nc' cannot be opened as a run archive"):
        xd.open_run(f"{server.address}/copy.nc", check=False)


def test_a_full_disk_is_told(server: WebServer, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert the words where the temporary copy cannot be written."""
    run = xd.open_run(f"{server.address}/run.nc")
    opened = Path.open

    def full(path: Path, mode: str = "r", *options: Any, **named_options: Any) -> Any:
        if mode == "r+b":
            raise OSError(28, "No space left on device")
        return opened(path, mode, *options, **named_options)

    with monkeypatch.context() as patched:
        patched.setattr(Path, "open", full)
        with pytest.raises(xd.ArchiveError, match=re.escape("No space left on device; name another folder by TMPDIR")):
            run.a_x[:5].load()
    assert run.a_x[:5].values.size == 5

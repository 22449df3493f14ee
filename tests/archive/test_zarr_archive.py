"""Runs as Zarr stores: one content digest in every form, replaced whole, and each file compared when it is read."""

from __future__ import annotations

import hashlib
import json
import os
import pickle
import shutil
import signal
import struct
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.command_line import call
from cases.problems import MODELS, oscillator
from cases.verdicts import verified
from cases.web_server import web_server
from xdynamics.archive import target, zarr_archive
from xdynamics.archive.compared_store import unpacked_size
from xdynamics.archive.folder_store import FOLDERS

pytest.importorskip("zarr")
MODEL = oscillator().model
ASKED: dict[str, Any] = {"method": "rk4", "step": 0.1, "until": 1.0}
RUN = xd.simulate(MODEL, **ASKED)
OTHER = xd.simulate(MODEL, **(ASKED | {"step": 0.05}))


@pytest.fixture
def store(tmp_path: Path) -> Path:
    """A run in a store."""
    xd.save(RUN, tmp_path / "run.zarr")
    return tmp_path / "run.zarr"


@pytest.mark.parametrize("name", ["ball_drag", "bouncing_ball", "truss", "coupled_masses", "stick_slip_belt"])
def test_a_run_is_the_same_in_both_forms(name: str, tmp_path: Path) -> None:
    """Assert values, attributes and digest of a netCDF file: events, several dimensions, texts, of a march into a store, too."""
    model = xd.Model.from_toml(MODELS / f"{name}.toml")
    run = xd.simulate(model, path=tmp_path / "run.zarr", method="dormand_prince", rtol=1e-4, until="2 s")
    xd.save(run, tmp_path / "run.nc")
    assert verified(tmp_path / "run.zarr") == verified(tmp_path / "run.nc") == run.attrs["content_digest"]
    stored, archived = xd.open_run(tmp_path / "run.zarr").load(), xd.open_run(tmp_path / "run.nc").load()
    for opened in (stored, archived):
        del opened.attrs["volatile_digest"]  # of the words that say where the digest of all bytes is
        opened.attrs["variable_digests"] = sorted(opened.attrs["variable_digests"].splitlines())
    assert stored.identical(archived)
    assert bool(xd.reproduce(tmp_path / "run.zarr")["same"].all())


def test_plain_xarray_opens_it(store: Path) -> None:
    """Assert numbers with units, coordinates and texts, without a warning, and what is written from there."""
    with xr.open_zarr(store) as plain:
        assert plain.x.values.tolist() == RUN.x.values.tolist()
        assert (plain.x.attrs["units"], plain.x.coords["time"].attrs["units"]) == ("m", "s")
        assert str(plain.model_toml.values[0]) == MODEL.to_toml()
    with xr.open_zarr(store, consolidated=False) as plain:
        assert plain.sizes["step"] == 11


def test_values_are_read_when_they_are_used(store: Path) -> None:
    """Assert laziness, dask arrays on demand, parts, and that a pickled run is read in its new process."""
    run = xd.open_run(store)
    assert not isinstance(run.x.variable._data, np.ndarray)
    assert pickle.loads(pickle.dumps(run)).load().identical(run.load())
    chunked = xd.open_run(store, chunks={"step": 4})
    assert chunked.x.chunks == ((4, 4, 3),)
    assert chunked.x[3:5].values.tolist() == RUN.x[3:5].values.tolist()
    xd.save(run.isel(step=slice(0, 5)), store.with_name("part.zarr"))
    assert xd.open_run(store.with_name("part.zarr")).x.values.tolist() == RUN.x[:5].values.tolist()


@pytest.mark.parametrize("compress", [False, True])
def test_a_store_is_replaced_whole(store: Path, *, compress: bool) -> None:
    """Assert the other run alone after a replacement, nothing beside it, and that a run opened before is no mixture."""
    before = xd.open_run(store)
    xd.save(OTHER, store, compress=compress)
    assert verified(store) == xd.content_digest(OTHER)
    assert sorted(entry.name for entry in (store / ".xdynamics").iterdir()) == ["digests.json", "zarr.json"]
    with pytest.raises(
        xd.ArchiveError, match="of '.*run.zarr' differs from its digest: it is damaged, or was replaced"
    ):
        before.x.load()


@pytest.mark.parametrize("moment", [-1, 0, 1, 30, 60])
def test_at_every_moment_there_is_one_run_or_the_other(
    store: Path, moment: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert a verified run wherever a replacement is killed, and that the next one completes what was begun."""
    if not (child := os.fork()):
        try:
            move = FOLDERS.move

            def killed(names: list[str], *folders: Path) -> None:
                move(names[:moment], *folders)
                os.kill(os.getpid(), signal.SIGKILL)

            monkeypatch.setattr(FOLDERS, "move", killed)
            if moment < 0:
                monkeypatch.setattr(zarr_archive, "_digests_of", lambda *_: os.kill(os.getpid(), signal.SIGKILL))
            xd.save(OTHER, store)
        finally:
            os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    assert verified(store) == xd.content_digest(RUN if moment < 0 else OTHER)
    xd.save(RUN, store)
    assert verified(store) == xd.content_digest(RUN)
    assert sorted(entry.name for entry in (store / ".xdynamics").iterdir()) == ["digests.json", "zarr.json"]


def test_a_full_disk_changes_nothing(store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert one line, the run that was there, and nothing left beside it."""

    def full(*_: Any) -> None:
        raise OSError(28, os.strerror(28))

    with monkeypatch.context() as patch:
        patch.setattr(target, "sync_file_systems", full)
        with pytest.raises(
            xd.ArchiveError, match="run.zarr' cannot be written: No space left on device; nothing is changed"
        ):
            xd.save(OTHER, store)
    assert verified(store) == xd.content_digest(RUN)
    assert sorted(entry.name for entry in (store / ".xdynamics").iterdir()) == ["digests.json", "zarr.json"]


def test_a_bad_end_replaces_no_good_run(store: Path) -> None:
    """Assert that a run that ended badly is written beside one that ended well, with a warning."""
    with pytest.warns(xd.PartialRunWarning, match="run.partial.zarr"):
        xd.simulate(MODEL, rtol=1e-9, until=1.0, max_steps=3, path=store)
    assert verified(store) == xd.content_digest(RUN)
    assert xd.open_run(store.with_name("run.partial.zarr")).attrs["run_outcome"] == "step_limit"


def test_a_run_is_kept_in_memory_and_read_from_the_web(store: Path, request: pytest.FixtureRequest) -> None:
    """Assert the same digest from an address, and that of a web server no more than the chunk is read."""
    place = f"memory://{request.node.name}/run.zarr"
    for run in (RUN, OTHER):
        xd.save(run, place)
        assert verified(place) == xd.content_digest(run)
    pytest.importorskip("aiohttp")
    for parts in (True, False):
        with web_server(store.parent, parts=parts) as server:
            run = xd.open_run(f"{server.address}/run.zarr")
            begun = server.sent
            assert run.x[2:4].values.tolist() == RUN.x[2:4].values.tolist()
            assert server.sent - begun == 8 * RUN.sizes["step"]
            assert verified(f"{server.address}/run.zarr") == xd.content_digest(RUN)


def registered(store: Path, key: str, content: bytes) -> None:
    """Write a file of a store, and its digest."""
    (store / key).write_bytes(content)
    notes = store / ".xdynamics" / "digests.json"
    document = json.loads(notes.read_text())
    document["files"][key] = f"{len(content)} {hashlib.sha256(content).hexdigest()}"
    notes.write_text(json.dumps(document))


def array(**changed: Any) -> Callable[[Path], None]:
    """Change the metadata of the array of `x`."""

    def change(store: Path) -> None:
        metadata = json.loads((store / "zarr.json").read_text())
        metadata["consolidated_metadata"]["metadata"]["x"] |= changed
        registered(store, "zarr.json", json.dumps(metadata).encode())

    return change


def grid(*shape: int) -> dict[str, Any]:
    """The chunks of an array."""
    return {"name": "regular", "configuration": {"chunk_shape": [*shape]}}


def replaced(key: str, make: Callable[[Path], Any]) -> Callable[[Path], None]:
    """Put something else in the place of a file."""

    def change(store: Path) -> None:
        (store / key).unlink()
        make(store / key)

    return change


def linked_folder(store: Path) -> None:
    """Put a link in the place of an array's folder, to its own content outside."""
    (store / "x").rename(store.parent / "outside")
    (store / "x").symlink_to(store.parent / "outside")


def packed(content: bytes) -> bytes:
    """Content as the format packs it."""
    from numcodecs.zstd import Zstd

    return bytes(Zstd().encode(content))


CODEC, PACKED = {"name": "bytes", "configuration": {"endian": "little"}}, {"name": "zstd", "configuration": {}}
NOTES = ".xdynamics/digests.json"
HOSTILE: dict[str, tuple[Callable[[Path], None], str]] = {
    "shape": (array(shape=[10**9]), "array 'x' declares 90909091 chunks, and there are digests of 0"),
    "chunk": (
        array(shape=[10**9], chunk_grid=grid(10**9)),
        "a chunk of array 'x' declares 1000000000 items, .* are the most",
    ),
    "huge": (array(shape=[10**18], chunk_grid=grid(1)), "declares 1000000000000000000 chunks"),
    "negative": (array(shape=[-5]), r"array 'x' has the chunks \[11\] for the shape \[-5\]"),
    "codec": (array(codecs=[{"name": "pickle"}]), "array 'x' is packed by .*pickle.*, which no archive is"),
    "codecs": (array(codecs=[CODEC, PACKED, PACKED]), "which no archive is"),
    "no codec": (array(codecs=[]), "which no archive is"),
    "big": (array(codecs=[{"name": "bytes", "configuration": {"endian": "big"}}]), "which no archive is"),
    "type": (array(data_type="complex128"), "array 'x' is of the type 'complex128'"),
    "names": (array(chunk_key_encoding={"name": "v2"}), "chunks of array 'x' have other names than an archive's"),
    "fill": (array(fill_value="none"), "its digests or metadata cannot be read"),
    "dims": (array(dimension_names=["trial"]), "its digests or metadata cannot be read"),
    "deep": (lambda store: registered(store, "zarr.json", b"[" * 200_000), "RecursionError"),
    "no text": (lambda store: registered(store, "zarr.json", b"\xff\xfe"), "its digests or metadata cannot be read"),
    "list": (lambda store: (store / NOTES).write_text("[]") and None, "its digests or metadata cannot be read"),
    "large": (lambda store: os.truncate(store / NOTES, 10**9), "has 1000000000 bytes, over the limit of"),
    "older": (
        lambda store: (store / NOTES).write_text('{"sweep": ""}') and None,
        "are those of a sweep of version 0.2",
    ),
    "pipe": (replaced(NOTES, os.mkfifo), "digests.json' cannot be read: it is a pipe"),
    "pipe of metadata": (replaced("zarr.json", os.mkfifo), "file 'zarr.json' .* is no regular file"),
    "pipe of values": (replaced("x/c/0", os.mkfifo), "file 'x/c/0'.* is no regular file"),
    "linked folder": (linked_folder, "file 'x/c/0'.* is no regular file"),
    "device": (replaced("x/c/0", lambda path: path.symlink_to("/dev/zero")), "file 'x/c/0'.* is no regular file"),
    "folder": (replaced("x/c/0", Path.mkdir), "file 'x/c/0'.* is no regular file"),
    "lost": (replaced("x/c/0", lambda _: None), "file 'x/c/0'.* is missing"),
    "exchanged": (
        replaced("x/c/0", lambda path: shutil.copy(path.parents[2] / "v_x/c/0", path)),
        "'x/c/0'.* differs from its digest",
    ),
    "long": (
        lambda store: registered(store, "x/c/0", bytes(96)),
        "file 'x/c/0'.* has another size than its array says",
    ),
    "texts": (
        lambda store: registered(store, "model_toml/c/0", struct.pack("<I", 1 << 31)),
        "has another number of texts",
    ),
    "text": (
        lambda store: registered(store, "model_toml/c/0", struct.pack("<II", 1, 1 << 31)),
        "'model_toml' of .* cannot be read",
    ),
}
OF_PACKED: dict[str, Callable[[], bytes]] = {
    "bomb": lambda: packed(bytes(300_000_000)),
    "two frames": lambda: packed(bytes(88)) + packed(bytes(300_000_000)),
    "short": lambda: packed(bytes(80)),
    "no frame": lambda: b"abc",
}


@pytest.mark.parametrize("case", HOSTILE)
def test_a_hostile_store_is_named(case: str, store: Path) -> None:
    """Assert one error for who reads and who verifies, and that a good run takes the place of what was there."""
    harm, words = HOSTILE[case]
    harm(store)
    for verb in (lambda: xd.open_run(store).load(), lambda: xd.verify(store)):
        with pytest.raises(xd.ArchiveError, match=f"(?s){words}"):
            verb()


@pytest.mark.parametrize("case", OF_PACKED)
def test_a_chunk_unpacks_to_its_array_alone(case: str, tmp_path: Path) -> None:
    """Assert that a compressed chunk with a matching digest, which unpacks to more or less, is refused before that."""
    xd.save(RUN, tmp_path / "run.zarr", compress=True)
    registered(tmp_path / "run.zarr", "x/c/0", OF_PACKED[case]())
    for verb in (lambda: xd.open_run(tmp_path / "run.zarr").load(), lambda: xd.verify(tmp_path / "run.zarr")):
        with pytest.raises(xd.ArchiveError, match="file 'x/c/0'.* is packed otherwise than its array says"):
            verb()


def test_a_frame_says_what_it_unpacks_to() -> None:
    """Assert the size of one whole frame, and none of a frame whose last block is not the last one."""
    frame = packed(bytes(88))
    assert unpacked_size(frame) == 88
    begin = 4 + 1 + 1  # behind magic, descriptor and size of a short single segment
    assert unpacked_size(frame[:begin] + bytes([frame[begin] & ~1]) + frame[begin + 1 :]) == -1


def test_values_with_a_new_digest_are_edited(store: Path) -> None:
    """Assert that whoever replaces a chunk and its digest is found by the content digest."""
    registered(store, "x/c/0", bytes(88))
    with pytest.raises(
        xd.ArchiveError, match="was edited since it was archived(?s:.*)variable 'x' differs from its digest"
    ):
        xd.verify(store)


@pytest.mark.parametrize("where", ["", "0123456789abcdef"])
def test_digests_that_name_files_elsewhere_are_harmless(where: str, store: Path) -> None:
    """Assert that nothing outside is read, moved or removed, also where a link leads out, and that a run is saved there."""
    outside = store.parent / "outside"
    outside.mkdir()
    for name in ("one", "two"):
        (outside / name).write_text(name)
    (store / "link").symlink_to(outside)
    notes = store / ".xdynamics" / where
    notes.mkdir(exist_ok=True)
    files = dict.fromkeys(("../outside/one", "/etc/passwd", "link/two"), f"3 {'0' * 64}")
    (notes / "digests.json").write_text(json.dumps({"kind": zarr_archive.KIND, "files": files}))
    with pytest.raises(xd.ArchiveError, match="'../outside/one' is no file of a store"):
        xd.open_run(store)
    xd.save(OTHER, store)
    assert verified(store) == xd.content_digest(OTHER)
    assert sorted(entry.read_text() for entry in outside.iterdir()) == ["one", "two"]


def test_a_link_in_a_store_is_replaced(store: Path) -> None:
    """Assert that a run is written into the store alone, where a folder of it is a link that leads out."""
    outside = store.parent / "outside"
    (store / "x").rename(outside)
    (store / "x").symlink_to(outside)
    before = (outside / "c" / "0").read_bytes()
    xd.save(OTHER, store)
    assert verified(store) == xd.content_digest(OTHER)
    assert (outside / "c" / "0").read_bytes() == before


def test_a_run_of_other_dimensions_takes_its_place(store: Path) -> None:
    """Assert each of two runs in turn, one with arrays where the other has numbers, and one whole run for plain xarray."""
    truss = xd.simulate(xd.Model.from_toml(MODELS / "truss.toml"), method="rk4", step=1e-5, until=1e-4)
    for run in (truss, RUN, truss):
        xd.save(run, store)
        assert verified(store) == xd.content_digest(run)
        with xr.open_zarr(store, decode_times=False) as plain:
            assert str(plain.model_toml.values[0]) == run.model_toml.item()
            assert {*plain.variables} >= {"time", "model_toml"}


def test_threads_write_stores(tmp_path: Path) -> None:
    """Assert whole runs of stores that several threads write at the same time."""
    names = [tmp_path / f"{k}.zarr" for k in range(8)]
    with ThreadPoolExecutor(4) as pool:
        assert [*pool.map(lambda name: xd.save(RUN, name), names)] == names
    assert {verified(name) for name in names} == {xd.content_digest(RUN)}


def test_a_relative_name_is_one_file(store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a run opened by a relative name is read after the process went elsewhere."""
    monkeypatch.chdir(store.parent)
    run = xd.open_run("run.zarr")
    (store.parent / "elsewhere").mkdir()
    monkeypatch.chdir("elsewhere")
    assert run.x.values.tolist() == RUN.x.values.tolist()
    for name in ("none/run.zarr", "back\\slash.zarr"):
        with pytest.raises(xd.InputError, match="'none' does not exist|has a backslash in its whole name"):
            xd.save(RUN, name)


def test_a_store_is_signed_indexed_and_shown(store: Path) -> None:
    """Assert that a signature covers every file, that an index has stores and files, and what the commands say."""
    from xdynamics.archive.signatures import new_key

    public = new_key(store.parent / "key.pem")
    xd.sign(store, store.parent / "key.pem")
    assert xd.verify_signature(store, public) == xd.content_digest(RUN)
    xd.save(RUN, store.parent / "run.nc")
    assert xd.open_runs(store.parent).member.values.tolist() == ["run.nc", "run.zarr"]
    for words in (("show", store), ("verify", store), ("table", store, "-o", store.parent / "table.csv")):
        assert call(*words).exit_code == 0
    xd.save(OTHER, store)
    with pytest.raises(xd.ArchiveError, match="run.zarr' is not what was signed"):
        xd.verify_signature(store, public)


def test_what_is_no_archive_is_left_alone(tmp_path: Path) -> None:
    """Assert one line for a store of another program, a file of that name, and none at all."""
    xr.Dataset({"a": ("x", [1.0])}).to_zarr(tmp_path / "other.zarr", zarr_format=2)
    with pytest.raises(
        xd.InputError, match=r"other.zarr' holds no record: there is no '.xdynamics/digests.json' in it"
    ):
        xd.open_run(tmp_path / "other.zarr")
    for verb in (lambda name: xd.save(RUN, name), lambda name: xd.simulate(MODEL, path=name, **ASKED)):
        with pytest.raises(
            xd.InputError, match=r"other.zarr' holds '.*', and no record of xdynamics; name another place"
        ):
            verb(tmp_path / "other.zarr")
    xd.save(RUN, tmp_path / "run.nc")
    (tmp_path / "run.nc").rename(tmp_path / "file.zarr")  # as version 0.2 wrote it
    assert xd.open_run(tmp_path / "file.zarr").load().attrs["content_digest"] == xd.content_digest(RUN)
    with pytest.raises(xd.InputError, match="file.zarr' is a file, and a Zarr store is a folder; name another place"):
        xd.save(RUN, tmp_path / "file.zarr")
    with pytest.raises(xd.InputError, match="none.zarr' does not exist"):
        xd.open_run(tmp_path / "none.zarr")

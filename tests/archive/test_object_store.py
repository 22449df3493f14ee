"""Archives in an object store: whole or not at all, whatever happens on the way to it, and the loser is told."""

from __future__ import annotations

import gc
import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import xarray as xr

import xdynamics as xd
from cases.object_server import Way, bucket
from cases.problems import oscillator
from cases.stages import no_march
from cases.verdicts import verified
from xdynamics.archive import address_store, filesystems, leases, segments
from xdynamics.archive.address_store import ADDRESSES, LOCK
from xdynamics.archive.filesystems import ask, ask_s3
from xdynamics.archive.signatures import new_key
from xdynamics.archive.store import Address, LockedError, TakenError, location_of

pytest.importorskip("s3fs")
pytest.importorskip("moto")
MODEL = oscillator().model
ASKED: dict[str, Any] = {"method": "rk4", "step": 0.1, "until": 1.0}
RUN = xd.simulate(MODEL, **ASKED)
OTHER = xd.simulate(MODEL, **(ASKED | {"step": 0.05}))
SECRET = "hidden-words"


@pytest.fixture(scope="module")
def store() -> Iterator[Way]:
    """An object store with the bucket `bucket`, and the way to it."""
    with bucket(SECRET) as way:
        yield way


@pytest.fixture
def place(store: Way, request: pytest.FixtureRequest) -> Address:  # noqa: ARG001 - it has to be there
    """A name of this test's own, of which nothing is there."""
    made = location_of(f"s3://bucket/{abs(hash(request.node.name)):x}/run.nc")
    assert isinstance(made, Address)
    return made


def digest(place: Address) -> str:
    """The content digest of what is under a name."""
    return verified(str(place))


def test_a_run_is_the_same_from_a_store(place: Address, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert the bits of the file in a folder, lazy reading in another process too, and that no copy is left here."""
    (tmp_path / "copies").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "copies"))
    xd.save(RUN, tmp_path / "run.nc")
    assert xd.save(RUN, str(place)) == place
    assert digest(place) == verified(tmp_path / "run.nc")
    run = xd.open_run(str(place))
    assert run.encoding["source"] == str(place)
    again = pickle.loads(pickle.dumps(run))
    assert again.identical(run.load())
    del run, again
    gc.collect()
    assert not [*(tmp_path / "copies").glob(".run.nc.*")]


@pytest.mark.dear
def test_a_signature_is_kept_beside_it(place: Address, tmp_path: Path) -> None:
    """Assert that a signed object verifies, and not when another takes its name."""
    public = new_key(tmp_path / "key.pem")
    xd.save(RUN, str(place))
    assert str(xd.sign(str(place), tmp_path / "key.pem")) == f"{place}.sig"
    assert xd.verify_signature(str(place), public) == digest(place)
    xd.save(OTHER, str(place))
    with pytest.raises(xd.ArchiveError, match="is not what was signed"):
        xd.verify_signature(str(place), public)


def test_of_two_writers_one_is_told(place: Address) -> None:
    """Assert that what was new, then what was read, is not written over by who began before, who is told so."""

    def write(early: Any) -> None:
        with ADDRESSES.taking_name(place) as late:
            late.part.write_text("late")
            xd.save(early, str(place))

    for run in (RUN, OTHER):
        with pytest.raises(TakenError, match="run.nc' was written by another process meanwhile, and is left as it is"):
            write(run)
        assert digest(place) == xd.content_digest(run)


@pytest.mark.dear
def test_an_opened_run_is_not_another(place: Address) -> None:
    """Assert that a run which travels to another process is refused there when its object was replaced."""
    xd.save(RUN, str(place))
    run = xd.open_run(str(place))
    sent = pickle.dumps(run)
    del run
    xd.save(OTHER, str(place))
    gc.collect()
    with pytest.raises(xd.ArchiveError, match="run.nc' is another file than the one that was opened; open it again"):
        pickle.loads(sent)


@pytest.mark.parametrize("what", ["dropped", "lost", "500 InternalError", "503 SlowDown", "silent"])
def test_what_happens_once_is_overcome(store: Way, place: Address, what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a request which is lost, not answered or refused once is repeated; an answer that is lost, understood."""
    if what == "silent":
        monkeypatch.setattr(filesystems, "READ", 2.0)
    with store.once(what, "PUT") as way:
        xd.save(RUN, str(place))
        assert next(entry[2] for entry in way.log if entry[0] == "PUT") == what
    assert digest(place) == xd.content_digest(RUN)


REFUSED = {
    "dropped": r"no answer from its store \(.*\); call again when it can be reached",
    "500 InternalError": r"its store failed 2 times \(InternalError\); call again later",
    "507 XMinioStorageFull": r"its store is full \(XMinioStorageFull\); make room there, or name another",
    "403 AccessDenied": r"its store denies access with these credentials \(AccessDenied\)",
    "403 InvalidAccessKeyId": r"its store does not accept the credentials \(InvalidAccessKeyId\); give others by",
    "403 SignatureDoesNotMatch": r"its store does not accept the credentials \(SignatureDoesNotMatch\)",
    "501 NotImplemented": r"its store has no conditional writes \(If-None-Match, If-Match\)",
}


@pytest.mark.dear
@pytest.mark.parametrize("what", REFUSED)
def test_what_is_refused_is_one_line(store: Way, place: Address, what: str) -> None:
    """Assert one line that names the object and the remedy, no secret in it, and the old object untouched."""
    xd.save(RUN, str(place))
    with store.once(what, "PUT", times=99), pytest.raises(xd.InputError, match=REFUSED[what]) as caught:
        xd.save(OTHER, str(place))
    said = str(caught.value)
    assert said.startswith(f"'{place}' cannot be written: ")
    assert not [word for word in ("\n", SECRET) if word in said]
    assert digest(place) == xd.content_digest(RUN)


def test_a_march_is_not_lost_with_its_store(store: Way, place: Address) -> None:
    """Assert that what was marched into a store that is full then stays on this machine, whole, and is named."""
    refused = pytest.raises(xd.ArchiveError, match=r"is full .*; the whole file is kept as '(.*)'$")
    with store.once("507 StorageFull", "PUT", times=99), refused as caught:
        xd.simulate(MODEL, **ASKED, path=str(place))
    kept = Path(str(caught.value).split("'")[-2])
    assert verified(kept) == xd.content_digest(RUN)
    kept.unlink()
    assert ADDRESSES.kind(place) == ""


def test_a_broken_download_goes_on(store: Way, place: Address) -> None:
    """Assert that a download whose connection breaks goes on where it was, and is whole."""
    xd.save(RUN, str(place))
    with store.once("cut", "GET") as way:
        assert digest(place) == xd.content_digest(RUN)
        assert [entry[2] for entry in way.log if entry[0] == "GET"].count("cut") == 1
    gc.collect()  # the copy is kept as long as it is used
    with store.once("cut", "GET", times=99), pytest.raises(xd.ArchiveError, match="run.nc' cannot be read: no answer"):
        digest(place)


NAMES = {
    f"s3://somebody:{SECRET}@bucket/run.nc": "credentials stand in an address that begins with 's3://'; leave them out",
    f"s3://bucket/run.nc?X-Amz-Signature={SECRET}": "credentials stand in an address",
    "s3://bucket/../run.nc": r"it has '\.\.' between slashes",
    "s3://bucket//run.nc": "it has '' between slashes",
    "s3://Bucket/run.nc": "the bucket is 'Bucket', needs 3 to 63 small letters, digits, dots or hyphens",
    "s3://bucket/a\nb": "it holds characters that cannot be shown",
    f"s3://bucket/{'long/' * 210}run.nc": "it has 1056 bytes, 1024 are the most",
    "s3://no-such-bucket/run.nc": "there is no bucket 'no-such-bucket'; make it, or name another",
    "s3://bucket": "'s3://bucket' is a directory; name a file in it",
    "ftp://bucket/run.nc": "addresses that begin with 'ftp://' are unknown",
}


@pytest.mark.parametrize("name", NAMES)
def test_a_wrong_name_is_refused(store: Way, name: str) -> None:  # noqa: ARG001 - it has to be there
    """Assert one line for each verb, that says what is wrong, and no secret."""
    for verb in (lambda: xd.open_run(name), lambda: xd.save(RUN, name), lambda: xd.verify(name)):
        with pytest.raises(xd.InputError, match=NAMES[name]) as caught:
            verb()
        assert SECRET not in str(caught.value)


def test_a_path_is_no_address(store: Way) -> None:  # noqa: ARG001 - it has to be there
    """Assert that an address which lost a slash is not taken for a folder."""
    with pytest.raises(xd.InputError, match="is a Path, which drops a slash of an address; give the address as a text"):
        xd.save(RUN, Path("s3://bucket/run.nc"))


def test_no_credentials_are_told(store: Way, place: Address, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: ARG001
    """Assert one line with the remedy where there are none at all."""
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.delenv(name)
    for name in ("AWS_SHARED_CREDENTIALS_FILE", "AWS_CONFIG_FILE"):
        monkeypatch.setenv(name, os.devnull)
    monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")
    with pytest.raises(xd.InputError, match="there are no credentials for its store; give them by the environment"):
        xd.save(RUN, str(place))


@pytest.mark.dear
def test_an_interrupted_march_is_resumed(place: Address, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that segments are objects beside it, are gone on from to the same bits, and are removed then."""
    monkeypatch.setattr(segments, "EVERY", 0.0)
    monkeypatch.setattr(segments, "SHARE", 0.0)
    monkeypatch.setattr("xdynamics.archive.segments.BLOCK_ROWS", 50)
    long = ASKED | {"until": 20.0}

    def interrupt(_done: float, t: float, _rows: int) -> None:
        if t > 12.0:
            raise RuntimeError("as the test asks")

    with pytest.raises(RuntimeError):
        xd.simulate(MODEL, **long, path=str(place), progress=interrupt)
    kept = ADDRESSES.names(place.parent / ".run.nc.segments")
    assert len(kept) > 1
    assert ADDRESSES.kind(place) == ""
    with pytest.raises(xd.InputError, match="has segments of a run that is not finished"):
        xd.simulate(MODEL, **long, path=str(place))
    run = xd.simulate(MODEL, **long, path=str(place), resume=True)
    assert xd.content_digest(run) == xd.content_digest(xd.simulate(MODEL, **long))
    assert ADDRESSES.names(place.parent) == [place]


def test_a_lock_is_one_process_s(place: Address, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a second is told who has it, and that one whose process ended, or that is not renewed, is free."""
    folder, lock = place.parent, place.parent / LOCK
    with (
        ADDRESSES.locked(folder),
        pytest.raises(
            LockedError,
            match=r"is locked by process \d+ of .* s ago; unless it does so again, the lock is free in (29|30) s: try again then",
        ),
    ):
        ADDRESSES.locked(folder).__enter__()
    assert ADDRESSES.kind(lock) == ""
    ask(lock, "pipe_file", b'{"token": "aa", "host": "far", "process": 1}')
    with pytest.raises(LockedError, match="by process 1 of far"):
        ADDRESSES.locked(folder).__enter__()
    leases._witness("aa").touch()  # of this machine, and nobody has it open
    with ADDRESSES.locked(folder):
        pass
    assert not leases._witness("aa").exists()
    ask(lock, "pipe_file", b'{"token": "bb", "host": "far", "process": 1}')
    monkeypatch.setattr(leases, "LEASE", 0.0)
    monkeypatch.setattr(leases, "_Lease", lambda *_: type("Ended", (), {"release": lambda _: None})())
    with ADDRESSES.locked(folder):
        pass


def test_a_lock_is_renewed(store: Way, place: Address, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a holder that lives renews its lock more often than it would end, and releases its own alone."""
    import time

    monkeypatch.setattr(leases, "LEASE", 1.2)
    lock = place.parent / LOCK
    with ADDRESSES.locked(place.parent):
        written, begun = ask(lock, "info")["LastModified"], time.monotonic()
        store.log = []
        time.sleep(3.0)
        renewals = [path for method, path, _ in store.log if method == "PUT" and path.split("?")[0].endswith(LOCK)]
        assert len(renewals) * leases.LEASE >= time.monotonic() - begun
        assert ask(lock, "info")["LastModified"] > written
        ask(lock, "pipe_file", b"of another")
    assert ADDRESSES.content(lock, 100) == b"of another"


KILLED = """
import os, signal, sys
from xdynamics.archive import address_store
from xdynamics.archive.store import location_of
import s3fs
address_store.SINGLE = 5 << 20
s3fs.S3File.commit = lambda file: os.kill(os.getpid(), signal.SIGKILL)
with address_store.ADDRESSES.taking_name(location_of(sys.argv[1])) as new:
    new.part.write_bytes(bytes(6 << 20))
"""


def uploads(place: Address) -> list[Any]:
    """The uploads of an object that are not finished."""
    found = ask_s3(place, "list_multipart_uploads", Prefix=place.key).get("Uploads") or []
    return [entry for entry in found if entry["Key"] == place.key]


@pytest.mark.dear
def test_a_killed_upload_is_cleared_away(place: Address, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that nothing stands under the name, and that the next call aborts the upload and frees the lock."""
    done = subprocess.run([sys.executable, "-c", KILLED, str(place)], check=False)
    assert done.returncode == -9
    assert ADDRESSES.kind(place) == ""
    assert len(uploads(place)) == 1
    monkeypatch.setattr(address_store, "SINGLE", 5 << 20)
    with ADDRESSES.taking_name(place) as new:
        new.part.write_bytes(bytes(6 << 20))
    assert uploads(place) == []
    assert len(ADDRESSES.content(place, 1 << 24)) == 6 << 20
    assert ask(place.parent, "find") == [place.path]


def test_a_large_upload_is_under_conditions_too(place: Address, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that of two writers of many parts the second is told, that an upload that fails is aborted, and no lock stays."""
    monkeypatch.setattr(address_store, "SINGLE", 5 << 20)

    def write(content: bytes) -> None:
        with ADDRESSES.taking_name(place) as late:
            late.part.write_bytes(bytes(6 << 20))
            with ADDRESSES.taking_name(place) as early:
                early.part.write_bytes(content)

    for content in (b"first", b"second"):
        with pytest.raises(TakenError, match="was written by another process meanwhile"):
            write(content)
        assert ADDRESSES.content(place, 100) == content
        assert uploads(place) == []
    assert ADDRESSES.names(place.parent) == [place]


def test_a_folder_is_whole_or_begun_anew(place: Address) -> None:
    """Assert that a folder that a dead process left half-built is built again, and that a whole one is not written over."""
    folder = place.parent / "bundle"
    for name in (".building", "half.txt"):
        half = folder / name
        ask(half, "pipe_file", b"")
    with ADDRESSES.taking_folder(folder) as built:
        (built / "one.txt").write_text("one")
    assert [entry.name for entry in ADDRESSES.names(folder)] == ["one.txt"]
    with pytest.raises(
        xd.InputError, match="bundle' holds 'one.txt' already; name a folder that is empty, or not there"
    ):
        ADDRESSES.taking_folder(folder).__enter__()


@pytest.mark.dear
def test_a_sweep_goes_on_in_a_store(store: Way, place: Address) -> None:
    """Assert that a sweep which its store broke off goes on, has the numbers of one in memory, and is verified."""
    folder = str(place.parent)
    asked: dict[str, Any] = {"axes": {"k": "1:2:2 N m-1"}, "keep": ["end", "log"], **ASKED}
    with store.once("500 InternalError", "PUT", times=99), pytest.raises(xd.ArchiveError, match="failed 2 times"):
        xd.sweep(MODEL, **asked, path=folder, members_per_task=1)
    sweep = xd.sweep(MODEL, **asked, path=folder, members_per_task=1)
    whole = xd.sweep(MODEL, axes=asked["axes"], **ASKED)
    assert sweep.end_x.values.tolist() == whole.end_x.values.tolist()
    assert verified(folder) == sweep.attrs["content_digest"]
    run = xd.member(xd.open_sweep(folder), k="2 N m-1")
    assert run.encoding["source"].startswith(f"{folder}/runs/")
    assert float(run.x[-1]) == float(sweep.end_x[1]) == float(xd.open_logs(folder, [1.0]).x[1, 0])
    broken = location_of(run.encoding["source"])
    run.close()
    ask(broken, "pipe_file", b"broken")
    with pytest.raises(xd.ArchiveError, match=f"{broken.name}: its seal is None, in the catalogue"):
        xd.verify(folder)


STORES = {"500 InternalError": "failed 2 times", "503 SlowDown": "failed 2 times", "507 StorageFull": "is full"}


@pytest.mark.dear
@pytest.mark.parametrize("what", STORES)
def test_a_ledger_that_broke_off_goes_on_in_a_store(store: Way, place: Address, what: str) -> None:
    """Assert that cases which were kept before a store broke off, or was full, are read, and the others found then."""
    keep, methods = str(place.parent), ["velocity_verlet"]
    whole = xd.validate(methods)
    with store.once(what, "PUT", times=99), pytest.raises(xd.ArchiveError, match=STORES[what]):
        xd.validate(methods, keep=keep)
    assert xd.validate(methods, keep=keep).equals(whole)
    with store.once(what, "PUT", times=99):
        assert xd.validate(methods, keep=keep).equals(whole)


@pytest.mark.dear
@pytest.mark.every(8)
@pytest.mark.parametrize("what", STORES)
@pytest.mark.parametrize("name", ["grid", "grid.zarr"])
def test_a_sweep_into_a_full_store_goes_on(store: Way, place: Address, name: str, what: str) -> None:
    """Assert one line of a store that is full or fails while a sweep is written, and the whole sweep once there is room."""
    if name.endswith("zarr"):
        pytest.importorskip("zarr")
    folder = str(place.parent / name)
    asked: dict[str, Any] = {"axes": {"k": "1:2:3 N m-1"}, **ASKED, "path": folder, "members_per_task": 1}
    with store.once(what, "PUT", times=99), pytest.raises(xd.InputError, match=STORES[what]) as caught:
        xd.sweep(MODEL, **asked)
    assert "\n" not in str(caught.value)
    sweep = xd.sweep(MODEL, **asked)
    assert verified(folder) == sweep.attrs["content_digest"]


@pytest.mark.dear
def test_a_zarr_store_is_of_objects_too(place: Address) -> None:
    """Assert the numbers of a sweep in memory, verified, and opened by plain xarray."""
    pytest.importorskip("zarr")
    asked: dict[str, Any] = {"axes": {"k": "1:2:3 N m-1"}, **ASKED}
    folder = str(place.parent / "grid.zarr")
    sweep = xd.sweep(MODEL, **asked, path=folder, members_per_task=2)
    assert verified(folder) == sweep.attrs["content_digest"]
    assert xr.open_zarr(folder).end_x.values.tolist() == xd.sweep(MODEL, **asked).end_x.values.tolist()


@pytest.mark.dear
def test_a_refinement_keeps_its_levels_in_a_store(place: Address) -> None:
    """Assert the numbers of a refinement in memory, an archive for each level, and that what is there is not marched again."""
    asked: dict[str, Any] = {"method": "rk4", "steps": [0.1, 0.05], "until": 1.0, "at": [1.0]}
    kept = xd.refine(MODEL, keep=str(place.parent), **asked)
    assert kept.limit_x.identical(xd.refine(MODEL, **asked).limit_x)
    assert [digest(place.parent / f"level_{k}.nc") for k in (0, 1)] == kept.run_digest.values.tolist()
    with no_march():
        assert xd.refine(MODEL, keep=str(place.parent), **asked).limit_x.identical(kept.limit_x)


@pytest.mark.dear
def test_a_sweep_is_one_process_s(place: Address) -> None:
    """Assert that who marches into a folder of a store keeps others off."""
    folder = place.parent / "grid"
    asked: dict[str, Any] = {"axes": {"k": "1:2:3 N m-1"}, **ASKED}

    def also(*_: Any) -> None:
        with pytest.raises(xd.InputError, match="another process writes into '.*grid'; wait for it"):
            xd.sweep(MODEL, **asked, path=str(folder))
        raise KeyError("as the test asks")

    from xdynamics.sweeping import catalogue

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(catalogue, "_march_missing_blocks", also)
        with pytest.raises(KeyError):
            xd.sweep(MODEL, **asked, path=str(folder))
    assert xd.sweep(MODEL, **asked, path=str(folder)).sizes == {"k": 3}


def test_a_report_and_a_bundle_go_to_a_store(place: Address, request: pytest.FixtureRequest) -> None:
    """Assert that the page, archives and figures of a report are there, and a bundle that is made again from there."""
    if not request.config.getoption("--whole"):
        pytest.skip("certifies: with --whole")
    xd.report(str(place.parent / "page"), run=RUN)
    assert [entry.name for entry in ADDRESSES.names(place.parent / "page")] == ["report.md", "run.nc", "run.png"]
    certificate = xd.certify(MODEL, quantity="x", at="1 s", method="rk4", step="50 ms")
    folder = str(xd.bundle(str(place.parent / "bundle"), certificate))
    assert float(xd.recheck(folder).value) == float(certificate.value)
    assert str(xd.document(folder, str(place.with_suffix(".html")))).endswith("run.html")


def test_of_a_large_run_the_rows_that_are_used_are_read(place: Address) -> None:
    """Assert that of a run of 34 MB in a bucket less than 3 MB is downloaded for some rows, and that they are its own."""
    from xdynamics.archive import filesystems

    run = xd.simulate(MODEL, method="rk4", step="10 ms", until="1400 s", path=str(place))
    parts: list[int] = []
    fetch = filesystems.fetch

    def counted(location: Address, start: int, end: int) -> bytes:
        parts.append(end - start)
        return fetch(location, start, end)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("xdynamics.archive.address_store.fetch", counted)
        opened = xd.open_run(str(place))
        assert (opened.x[137_000:137_100].values == run.x[137_000:137_100].values).all()
    assert 1_000_000 < sum(parts) < 3_000_000

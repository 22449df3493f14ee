"""Signed archives: a signature is of one key and one content; all else is refused with its remedy."""

from __future__ import annotations

import base64
import os
import shutil
import stat
import sys
from collections.abc import Callable
from pathlib import Path

import netCDF4
import pytest
from click.testing import CliRunner, Result
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ed25519, rsa

import xdynamics as xd
from cases.problems import oscillator
from cases.verdicts import verified
from xdynamics.archive import marched
from xdynamics.archive.signatures import new_key, signature_of
from xdynamics.cli import main

PEM, PKCS8 = serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8
# what openssl genpkey -algorithm ed25519 wrote, and openssl pkey -pubout of it
OPENSSL = """-----BEGIN PRIVATE KEY-----
MC4CAQAwBQYDK2VwBCIEIKxLcP0FZr1Ka7KATa7QrCF0GOXP8H0Q9VeYz1aGXbvj
-----END PRIVATE KEY-----
"""


def call(*arguments: object) -> Result:
    """Run a command in this process."""
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a signed archive and keys of all kinds."""
    folder = tmp_path_factory.mktemp("signed")
    xd.save(xd.simulate(oscillator().model, step=0.1, until=1.0), folder / "run.nc")
    for name in ("key", "other"):
        new_key(folder / f"{name}.pem")
    xd.sign(folder / "run.nc", folder / "key.pem")
    locked = ed25519.Ed25519PrivateKey.generate().private_bytes(
        PEM, PKCS8, serialization.BestAvailableEncryption(b"sesame")
    )
    (folder / "locked.pem").write_bytes(locked)
    another = rsa.generate_private_key(65537, 2048)
    (folder / "rsa.pem").write_bytes(another.private_bytes(PEM, PKCS8, serialization.NoEncryption()))
    (folder / "rsa.public.pem").write_bytes(
        another.public_key().public_bytes(PEM, serialization.PublicFormat.SubjectPublicKeyInfo)
    )
    (folder / "text.pem").write_text("no key at all\n")
    (folder / "openssl.pem").write_text(OPENSSL)
    return folder


@pytest.fixture
def signed(made: Path, tmp_path: Path) -> Path:
    """A copy of the signed archive and its signature, to hurt."""
    for name in ("run.nc", "run.nc.sig"):
        shutil.copy(made / name, tmp_path / name)
    return tmp_path / "run.nc"


@pytest.mark.parametrize(("make", "what"), [(Path.mkdir, "a directory"), (os.mkfifo, r"a pipe \(FIFO\)")])
def test_what_stands_in_the_place_of_a_signature_is_named(
    make: Callable[[Path], None], what: str, made: Path, signed: Path
) -> None:
    """Assert one line that says what is there, whose name that is, and what helps; nothing is signed."""
    place = signature_of(signed)
    place.unlink()
    make(place)
    with pytest.raises(
        xd.InputError,
        match=f"^'{place}' is {what}, and its name is that of the signature of '{signed}'; remove it, or give",
    ):
        xd.sign(signed, made / "key.pem")


def test_what_was_signed_is_verified(made: Path, signed: Path) -> None:
    """Assert that a copy of both files is verified by the public key, and the line says which check it was."""
    digest = verified(signed)
    assert xd.verify_signature(signed, made / "key.public.pem") == digest
    line = call("verify", "--key", made / "key.public.pem", signed).output
    assert line == f"verified  {signed}  {digest}  (signed, by '{made / 'key.public.pem'}')\n"


def test_verify_says_what_it_checked(signed: Path) -> None:
    """Assert that without a key the line tells that a seal is all that was looked at."""
    start = f"verified  {signed}  {verified(signed)}  "
    assert call("verify", signed).output == start + "(sealed; signed, and the signature not checked: give --key)\n"
    signature_of(signed).unlink()
    assert call("verify", signed).output == start + "(sealed; not signed)\n"


@pytest.mark.dear
def test_signatures_of_0_2_are_of_what_they_covered(made: Path, signed: Path) -> None:
    """Assert that a signature of content and circumstances alone is verified as such, which is said in words."""
    key = serialization.load_pem_private_key((made / "key.pem").read_bytes(), None)
    lines = signature_of(signed).read_text().splitlines()
    message = "\n".join(["xdynamics signature 1", *lines[1:3]]) + "\n"
    seen = base64.b64encode(key.sign(message.encode())).decode()
    signature_of(signed).write_text(f"{message}{lines[4]}\nsignature {seen}\n")
    with pytest.warns(
        xd.SignatureWarning, match="run.nc.sig' is a signature of version 0.2: .* not of the file's bytes"
    ):
        assert xd.verify_signature(signed, made / "key.public.pem") == verified(signed)
    done = call("verify", "--key", made / "key.public.pem", signed)
    said = "a signature of version 0.2: of numbers, attributes and date, not of the file's bytes; sign anew"
    assert done.output.endswith(f"(signed, by '{made / 'key.public.pem'}'; {said})\n")
    resealed(signed)
    assert call("verify", "--key", made / "key.public.pem", signed).exit_code == 1


def test_keys_of_openssl_sign(made: Path, signed: Path) -> None:
    """Assert that a PEM file of openssl's is a key."""
    private = serialization.load_pem_private_key(OPENSSL.encode(), None)
    public = private.public_key().public_bytes(PEM, serialization.PublicFormat.SubjectPublicKeyInfo)
    (signed.parent / "public.pem").write_bytes(public)
    assert call("sign", signed, "--key", made / "openssl.pem").exit_code == 0
    assert call("verify", signed, "--key", signed.parent / "public.pem").exit_code == 0
    assert call("verify", signed, "--key", made / "key.public.pem").exit_code == 1


def test_new_keys(tmp_path: Path) -> None:
    """Assert a private key that nobody else may read, its public one, and that no file is written over."""
    missing = call("sign", tmp_path / "missing.nc", "--new-key", tmp_path / "own.pem")
    assert missing.exit_code == 2
    assert "missing.nc' does not exist" in missing.output
    assert not [*tmp_path.glob("*.pem")]
    done = call("sign", "--new-key", tmp_path / "own.pem")
    assert done.exit_code == 0, done.output
    assert stat.S_IMODE((tmp_path / "own.pem").stat().st_mode) == 0o600
    assert "PUBLIC KEY" in (tmp_path / "own.public.pem").read_text()
    before = (tmp_path / "own.pem").read_bytes()
    again = call("sign", "--new-key", tmp_path / "own.pem")
    assert again.exit_code == 2
    assert "is there already, and a key is not written over" in again.output
    assert (tmp_path / "own.pem").read_bytes() == before


def test_where_no_key_can_be(tmp_path: Path) -> None:
    """Assert that everybody may read the public key, and that links, files and missing folders are one error each."""
    mask = os.umask(0)
    os.umask(mask)
    assert stat.S_IMODE(new_key(tmp_path / "own.pem").stat().st_mode) == 0o644 & ~mask
    (tmp_path / "link.pem").symlink_to("nowhere")
    (tmp_path / "half.public.pem").touch()
    for name, there in (("link.pem", "link.pem"), ("half.pem", "half.public.pem")):
        with pytest.raises(xd.InputError, match=f"{there}' is there already"):
            new_key(tmp_path / name)
    with pytest.raises(xd.InputError, match=r"the key '.*none/own.pem' cannot be written: No such file or directory"):
        new_key(tmp_path / "none" / "own.pem")
    assert sorted(entry.name for entry in tmp_path.iterdir()) == [
        "half.public.pem",
        "link.pem",
        "own.pem",
        "own.public.pem",
    ]


@pytest.mark.parametrize(
    ("line", "other"),
    [
        (0, "xdynamics signature 3"),
        (0, "xdynamics signature 1"),
        (1, "contents 1"),
        (2, None),
        (3, None),
        (5, "signature !!"),
        (5, "signature abc"),
        (6, "more 1"),
    ],
)
def test_a_signature_has_six_lines(made: Path, signed: Path, line: int, other: str | None) -> None:
    """Assert that what has others, more or fewer, or no base64 in its last, is none."""
    place = signature_of(signed)
    lines = place.read_text().splitlines()
    lines[line : line + 1] = [] if other is None else [other]
    place.write_text("\n".join(lines))
    with pytest.raises(xd.ArchiveError, match=r"run.nc.sig' is no signature of an archive"):
        xd.verify_signature(signed, made / "key.public.pem")


def test_what_is_no_small_file_is_no_key(made: Path, signed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a name with a null, a file that the system does not open and the end of a long one are no key."""
    with pytest.raises(xd.InputError, match=r"the key 'a\\x00b' is no file; name one"):
        xd.sign(signed, "a\0b")
    long = signed.with_name("long.pem")
    long.write_bytes(b"#" * 65_000 + b"\n" + (made / "key.pem").read_bytes())
    xd.sign(signed, long)
    long.write_bytes(b"#" * 65_536 + b"\n" + (made / "key.pem").read_bytes())
    with pytest.raises(xd.InputError, match="is no private key in PEM"):
        xd.sign(signed, long)

    def refuse(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(xd.InputError, match="the key '.*key.pem' cannot be read: Permission denied"):
        xd.sign(signed, made / "key.pem")


def test_a_locked_key_is_unlocked(made: Path, signed: Path) -> None:
    """Assert that a passphrase, or what is asked for one, unlocks a key; a wrong one does not."""
    assert xd.sign(signed, made / "locked.pem", passphrase="sesame") == signature_of(signed)
    assert xd.sign(signed, made / "locked.pem", passphrase=lambda: "sesame") == signature_of(signed)
    with pytest.raises(xd.InputError, match=r"the passphrase does not unlock the key '.*locked.pem'"):
        xd.sign(signed, made / "locked.pem", passphrase="open")


def resealed(path: Path) -> None:
    """Change a number, and make every digest and the seal anew, as someone would who wants to deceive."""
    with xd.open_run(path) as kept:
        run = kept.load()
    xd.save(marched(run.assign(x=run.x + 1.0).assign_attrs(run.attrs)), path)


def rewritten(path: Path) -> None:
    """Put the digest of another content into the signature."""
    place = signature_of(path)
    text = place.read_text()
    place.write_text(text.replace(text.splitlines()[1], f"content {'0' * 64}"))


def redated(path: Path) -> None:
    """Say that a run was made on another day, seals made anew."""
    with xd.open_run(path) as kept:
        run = kept.load()
    xd.save(marched(run.assign_attrs(date_created="1999-01-01T00:00:00Z")), path)


def flipped(path: Path) -> None:
    """Change one bit of the archive."""
    content = bytearray(path.read_bytes())
    content[2000] ^= 1
    path.write_bytes(content)


@pytest.mark.every(3)
@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (resealed, r"'.*run.nc' is not what was signed: its content digest is \w+, and \w+ was signed"),
        (redated, r"is not what was signed: its digest of date, versions and machine is"),
        (rewritten, r"the signature '.*run.nc.sig' is not of '.*key.public.pem': it was altered, or is a forgery"),
        (flipped, "differ from its seal|differs from its digest|damaged"),
        (
            lambda path: signature_of(path).unlink(),
            r"has no signature: there is no '.*run.nc.sig'; copy it with the archive, or sign anew",
        ),
        (lambda path: signature_of(path).write_bytes(os.urandom(300)), "is no signature of an archive"),
        (
            lambda path: signature_of(path).write_text(signature_of(path).read_text()[:-9]),
            "it was altered, or is a forgery",
        ),
    ],
)
def test_what_was_not_signed_is_refused(made: Path, signed: Path, harm: Callable[[Path], None], message: str) -> None:
    """Assert exit code 1 and one sentence for every way in which file and signature do not belong together."""
    harm(signed)
    with pytest.raises(xd.ArchiveError, match=message):
        xd.verify_signature(signed, made / "key.public.pem")
    assert call("verify", "--key", made / "key.public.pem", signed).exit_code == 1


def test_another_key_is_named(made: Path, signed: Path) -> None:
    """Assert that a signature by someone else is told from a forged one."""
    with pytest.raises(
        xd.ArchiveError, match=r"was signed by another key, \w{16}, and not by '.*other.public.pem', \w{16}"
    ):
        xd.verify_signature(signed, made / "other.public.pem")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["sign", "run.nc", "--key", "key.public.pem"], "is a public key; sign with the private one"),
        (
            ["sign", "run.nc", "--key", "text.pem"],
            "is no private key in PEM; make a pair with `xdynamics sign --new-key KEY.pem`",
        ),
        (["sign", "run.nc", "--key", "rsa.pem"], "is no Ed25519 key; make a pair"),
        (["sign", "run.nc", "--key", "locked.pem"], "is locked; give its passphrase"),
        (["sign", "run.nc", "--key", "."], "the key '.' is no file; name one"),
        (["sign", "run.nc", "--key", "/dev/zero"], "the key '/dev/zero' is no file"),
        (["sign", "run.nc"], "sign needs archives and one of --key KEY.pem and --new-key KEY.pem"),
        (["sign", "--key", "key.pem"], "sign needs archives and one of"),
        (["sign", "nowhere.nc", "--key", "key.pem"], "'nowhere.nc' does not exist"),
        (["verify", "run.nc", "--key", "key.pem"], "is a private key; verify with the public one, from `openssl pkey"),
        (["verify", "run.nc", "--key", "text.pem"], "is no public key in PEM"),
        (["verify", "run.nc", "--key", "rsa.public.pem"], "is no Ed25519 key"),
        (["verify", "run.nc", "--key", "run.nc"], "is no public key in PEM"),
        (["verify", "run.nc", "--key", "nowhere.pem"], "the key 'nowhere.pem' is no file"),
    ],
)
def test_wrong_input_is_one_sentence(
    made: Path, arguments: list[str], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert exit code 2, the remedy, no traceback, and that the signature that is there stays."""
    monkeypatch.chdir(made)
    before = (made / "run.nc.sig").read_bytes()
    done = call(*arguments)
    assert done.exit_code == 2, done.output
    assert message in done.output
    assert len(done.output.splitlines()) == 1
    assert (made / "run.nc.sig").read_bytes() == before


def test_without_the_package(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that the extra is named where cryptography is not installed."""
    for name in [module for module in sys.modules if module.startswith("cryptography")]:
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(xd.InputError, match=r"need the package cryptography: pip install 'xdynamics\[sign\]'"):
        xd.verify_signature(made / "run.nc", made / "key.public.pem")


def test_a_damaged_archive_is_not_signed(made: Path, signed: Path) -> None:
    """Assert that what is signed is verified first."""
    flipped(signed)
    with pytest.raises(xd.ArchiveError, match="damaged"):
        xd.sign(signed, made / "key.pem")


def test_no_netcdf_is_left_open(signed: Path, made: Path) -> None:
    """Assert that a signed archive can be written to right after it was verified."""
    xd.verify_signature(signed, made / "key.public.pem")
    with netCDF4.Dataset(signed, "a") as file:
        file.setncattr("title", "other")

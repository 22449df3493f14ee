"""Signatures of archives: Ed25519 over the digests of content, circumstances and bytes, in a separate file.

A signature lies beside its archive. A seal detects damage; whoever edits a file on purpose can make a new seal. A
signature needs the private key.
"""

from __future__ import annotations

import base64
import hashlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xdynamics.archive.folder_store import is_zarr, store_of, taking_name
from xdynamics.archive.integrity_checks import VERIFIED
from xdynamics.archive.reading import open_run, verify
from xdynamics.archive.seals import bytes_digest
from xdynamics.archive.store import Given, Place, location_of
from xdynamics.archive.target import fitting_name
from xdynamics.faults import ArchiveError, InputError, SignatureWarning, warn
from xdynamics.runtime.files import displayed_path, write_new
from xdynamics.schema import VOLATILE_DIGEST

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

KIND, KIND_OF_0_2 = "xdynamics signature 2", "xdynamics signature 1"
# the lines of a signature, and what each digest is of
COVERED = {
    KIND: {
        "content": "content digest",
        "circumstances": "digest of date, versions and machine",
        "bytes": "digest of the file's bytes",
    },
    KIND_OF_0_2: {"content": "content digest", "circumstances": "digest of date, versions and machine"},
}
SUFFIX = ".sig"
NARROW = "a signature of version 0.2: of numbers, attributes and date, not of the file's bytes; sign anew"
_LONGEST = 65_536  # bytes of a key or a signature
_WAY_TO_PUBLIC = "openssl pkey -in KEY.pem -pubout -out PUBLIC.pem"

Asking = Callable[[], str]  # for the passphrase of a key


def sign(path: Given, key: str | Path, *, passphrase: str | Asking | None = None) -> Place:
    """Sign an archive: its content digest, the digest of date, versions and machine, and that of every byte of the file.

    Parameters
    ----------
    path : str or Path
        An archive, or ``"s3://bucket/run.nc"``; verified first.
    key : str or Path
        A private Ed25519 key in PEM, as `new_key` or ``openssl genpkey -algorithm ed25519`` makes it.
    passphrase : str or callable, optional
        For a locked key; a callable is called only then.

    Returns
    -------
    Path, or name of an object
        The signature, named as the archive with `.sig` after it (of a name of over 251 bytes its beginning and a digest
        of it); keep it with the archive.

    Raises
    ------
    InputError
        If the file is no key, the key is locked or of another kind, or the package cryptography is missing.
    ArchiveError
        If the archive is damaged, or there is no place for the signature.
    """
    location = location_of(path)
    private_key, target = _private(Path(key), passphrase), signature_of(location)
    if kind := store_of(target).kind(target):
        raise InputError(
            f"'{target}' is {kind}, and its name is that of the signature of '{path}'; remove it, or give it another"
            " name"
        )
    message = _message(KIND, _verified_digests(location))
    signature = base64.b64encode(private_key.sign(message)).decode()
    with taking_name(target) as new:
        lines = f"key {_fingerprint(private_key.public_key())}\nsignature {signature}\n"
        new.part.write_text(message.decode() + lines, encoding="ascii")
    return target


def verify_signature(path: Given, key: str | Path) -> str:
    """Verify an archive, and that the owner of a key signed exactly this file.

    Parameters
    ----------
    path : str or Path
    key : str or Path
        The public key, in PEM.

    Returns
    -------
    str
        The content digest.

    Raises
    ------
    InputError
        If the file is no key, or one of another kind.
    ArchiveError
        If the archive is damaged, has no signature, was signed by another key, or is not what was signed.

    Warns
    -----
    SignatureWarning
        If the signature is one of version 0.2, which covers less than the whole file.
    """
    location, public = location_of(path), _public(Path(key))
    digests = _verified_digests(location)
    signed = _read_signature(location)
    if signed.signer != _fingerprint(public):
        raise ArchiveError(
            f"'{path}' was signed by another key, {signed.signer}, and not by '{key}', {_fingerprint(public)}"
        )
    if not _holds(public, signed.signature, _message(signed.kind, signed.digests)):
        raise ArchiveError(
            f"the signature '{signature_of(location)}' is not of '{key}': it was altered, or is a forgery"
        )
    for name, digest_name in COVERED[signed.kind].items():
        if signed.digests[name] != digests[name]:
            raise ArchiveError(
                f"'{path}' is not what was signed: its {digest_name} is {digests[name]}, and {signed.digests[name]} was signed"
            )
    if signed.kind != KIND:
        warn(f"'{signature_of(location)}' is {NARROW}", SignatureWarning)
    return digests["content"]


def coverage_note(path: Place) -> str:
    """Describe the coverage of a verified signature, if that is less than the complete file."""
    return f"; {NARROW}" if _read_signature(path).kind != KIND else ""


def new_key(path: str | Path) -> Path:
    """Make a pair of keys; only its owner can read the private one, and no file is overwritten.

    Parameters
    ----------
    path : str or Path
        The private key: ``KEY.pem``.

    Returns
    -------
    Path
        The public one: ``KEY.public.pem``.

    Raises
    ------
    InputError
        If one of the files exists, or the package cryptography is missing.
    ArchiveError
        If a file cannot be written.
    """
    serialization, ed25519 = _cryptography()
    private, public = Path(path), Path(path).with_suffix(".public.pem")
    pem, raw = serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo
    key = ed25519.Ed25519PrivateKey.generate()
    unencrypted = serialization.NoEncryption()
    texts = {
        private: key.private_bytes(pem, serialization.PrivateFormat.PKCS8, unencrypted),
        public: key.public_key().public_bytes(pem, raw),
    }
    for name in texts:
        if os.path.lexists(name):
            private_only = name == private and not os.path.lexists(public)
            remedy = (
                f", or make its public one by `openssl pkey -in {name} -pubout -out {public}`" if private_only else ""
            )
            raise InputError(f"'{name}' is there already, and a key is not written over; name another{remedy}")
    for name, text in texts.items():
        try:
            write_new(name, text, 0o600 if name == private else 0o644)
        except OSError as error:
            raise ArchiveError(f"the key '{name}' cannot be written: {error.strerror or error}") from None
    return public


def signature_of(path: Place) -> Place:
    """Return where the signature of an archive is; its name is shortened if the archive's leaves no room for the ending."""
    return path.with_name(fitting_name(path.name, suffix=SUFFIX))


def protection(path: Place) -> str:
    """Describe the protection that a verification without a key has shown."""
    if _is_there(signature_of(path)):
        return "sealed; signed, and the signature not checked: give --key"
    return "sealed; not signed"


def _is_there(location: Place) -> bool:
    return store_of(location).kind(location) != ""


def _verified_digests(path: Place) -> dict[str, str]:
    """Verify an archive; return its digests of content, circumstances and bytes."""
    store = store_of(path)
    stamp_before = store.stamp(path)
    examination = verify(path)
    if examination.verdict != VERIFIED:
        raise ArchiveError(
            f"'{path}' is {examination.verdict}: every number agrees, but a signature is of a file as it was sealed;"
            " xd.save(xd.open_run(…), …) seals it again",
            verdict=examination.verdict,
        )
    if is_zarr(path):
        from xdynamics.archive.zarr_archive import compared_store

        bytes_of_all = compared_store(path).identity
    else:
        local_file = store.local_file(path)  # a copy of an object is removed with what holds it
        bytes_of_all = bytes_digest(local_file.path)
    with open_run(path, check=False) as run:
        circumstances = str(run.attrs[VOLATILE_DIGEST])
    digests = {"content": examination.digest, "circumstances": circumstances, "bytes": bytes_of_all}
    # the three digests come from separate readings, and have to be of one file
    if store.stamp(path) != stamp_before:
        raise ArchiveError(f"'{path}' was written to while it was verified; try again")
    return digests


def _message(kind: str, digests: dict[str, str]) -> bytes:
    return "".join([f"{kind}\n", *(f"{name} {digests[name]}\n" for name in COVERED[kind])]).encode()


@dataclass(frozen=True)
class _Signed:
    """The content of a signature: digests by their names, whose key, the signature itself."""

    kind: str
    digests: dict[str, str]
    signer: str
    signature: bytes


def _read_signature(path: Place) -> _Signed:
    """Read the signature beside an archive."""
    location = signature_of(path)
    if not _is_there(location):
        raise ArchiveError(
            f"'{path}' has no signature: there is no '{location}'; copy it with the archive, or sign anew"
        )
    local_file = store_of(location).local_file(location)
    kind, *lines = _read_small_file(local_file.path, "signature").decode("ascii", "replace").splitlines() or [""]
    words = [line.partition(" ")[::2] for line in lines]
    if kind not in COVERED or [name for name, _ in words] != [*COVERED[kind], "key", "signature"]:
        raise ArchiveError(f"'{location}' is no signature of an archive")
    *digests, (_, signer), (_, signature) = words
    try:
        return _Signed(kind, dict(digests), signer, base64.b64decode(signature, validate=True))
    except ValueError:
        raise ArchiveError(f"'{location}' is no signature of an archive") from None


def _holds(public: Ed25519PublicKey, signature: bytes, message: bytes) -> bool:
    from cryptography.exceptions import InvalidSignature

    try:
        public.verify(signature, message)
    except InvalidSignature:
        return False
    return True


def _private(path: Path, passphrase: str | Asking | None) -> Ed25519PrivateKey:
    serialization, ed25519 = _cryptography()
    text = _read_small_file(path, "key")
    if b"PUBLIC KEY" in text:
        raise InputError(f"'{path}' is a public key; sign with the private one")
    try:
        key = serialization.load_pem_private_key(text, None)
    except TypeError:  # it is locked
        key = _unlocked(path, text, passphrase)
    except Exception as error:
        raise _no_key(path, "private") from error
    if not isinstance(key, ed25519.Ed25519PrivateKey):
        raise _other_kind(path)
    private: Ed25519PrivateKey = key
    return private


def _unlocked(path: Path, text: bytes, passphrase: str | Asking | None) -> Any:
    serialization, _ = _cryptography()
    phrase = passphrase() if callable(passphrase) else passphrase
    if not phrase:
        raise InputError(f"the key '{path}' is locked; give its passphrase, or sign at a terminal, which asks for it")
    try:
        return serialization.load_pem_private_key(text, phrase.encode())
    except ValueError:
        raise InputError(f"the passphrase does not unlock the key '{path}'") from None


def _public(path: Path) -> Ed25519PublicKey:
    serialization, ed25519 = _cryptography()
    text = _read_small_file(path, "key")
    if b"PRIVATE KEY" in text:
        raise InputError(f"'{path}' is a private key; verify with the public one, from `{_WAY_TO_PUBLIC}`")
    try:
        key = serialization.load_pem_public_key(text)
    except Exception as error:
        raise _no_key(path, "public") from error
    if not isinstance(key, ed25519.Ed25519PublicKey):
        raise _other_kind(path)
    public: Ed25519PublicKey = key
    return public


def _no_key(path: Path, kind: str) -> InputError:
    return InputError(f"'{path}' is no {kind} key in PEM; make a pair with `xdynamics sign --new-key KEY.pem`")


def _other_kind(path: Path) -> InputError:
    return InputError(f"'{path}' is no Ed25519 key; make a pair with `xdynamics sign --new-key KEY.pem`")


def _fingerprint(public: Ed25519PublicKey) -> str:
    """A short name of a key: the beginning of the sha256 of its bytes."""
    return hashlib.sha256(public.public_bytes_raw()).hexdigest()[:16]


def _read_small_file(path: Path, file_role: str) -> bytes:
    """Read a small file; folders, pipes and devices are refused."""
    if "\0" in str(path) or not path.is_file():
        raise InputError(f"the {file_role} {displayed_path(path)!r} is no file; name one")
    try:
        with path.open("rb") as file:
            return file.read(_LONGEST)
    except OSError as error:
        raise InputError(f"the {file_role} '{path}' cannot be read: {error.strerror or error}") from None


def _cryptography() -> tuple[Any, Any]:
    """Import the modules of the optional package cryptography, on first use."""
    try:
        from cryptography.hazmat.primitives import serialization
        from cryptography.hazmat.primitives.asymmetric import ed25519
    except ImportError:
        raise InputError("signatures need the package cryptography: pip install 'xdynamics[sign]'") from None
    return serialization, ed25519

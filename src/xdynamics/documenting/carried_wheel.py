"""The package itself as a wheel, which a bundle carries: whoever makes its number again installs what made it."""

from __future__ import annotations

import base64
import hashlib
import zipfile
from collections.abc import Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

from xdynamics.faults import InputError

PACKAGE = Path(__file__).parents[1]
KEPT = (".py", ".toml", ".md", ".css", ".typed")  # texts of the engine are of a platform, and are made again
EPOCH = (1980, 1, 1, 0, 0, 0)  # the date of every file in it: the same sources make the same wheel
PREFIX, SUFFIX = "xdynamics-", "-py3-none-any.whl"
ABOUT = "the package that made all this, to be installed by pip"


def wheel_name() -> str:
    """Return the name of the wheel that this package makes.

    Raises
    ------
    InputError
        If the package is not installed, so that what it depends on is not known.
    """
    return f"{PREFIX}{_installed().version}{SUFFIX}"


def is_wheel(name: str) -> bool:
    """Whether a file of a bundle is such a wheel, of any version."""
    return name.startswith(PREFIX) and name.endswith(SUFFIX)


def write_wheel(path: Path) -> None:
    """Write the modules of the package, and the metadata that it was installed with, as a wheel (PEP 427)."""
    folder = f"{PREFIX}{_installed().version}.dist-info"
    rows = []
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as wheel:
        for name, content in (*_modules(), *_metadata(folder)):
            digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
            rows.append(f"{name},sha256={digest},{len(content)}\n")
            wheel.writestr(zipfile.ZipInfo(name, EPOCH), content, zipfile.ZIP_DEFLATED)
        record = f"{folder}/RECORD"
        wheel.writestr(zipfile.ZipInfo(record, EPOCH), "".join([*rows, f"{record},,\n"]), zipfile.ZIP_DEFLATED)


def _modules() -> Iterator[tuple[str, bytes]]:
    for path in sorted(PACKAGE.rglob("*")):
        if path.is_file() and path.suffix in KEPT and "__pycache__" not in path.parts:
            yield f"xdynamics/{path.relative_to(PACKAGE).as_posix()}", path.read_bytes()


def _metadata(folder: str) -> Iterator[tuple[str, bytes]]:
    yield f"{folder}/WHEEL", b"Wheel-Version: 1.0\nGenerator: xdynamics\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
    installed = _installed()
    # of an editable installation the metadata stand beside the modules, under another name
    metadata = installed.read_text("METADATA") or installed.read_text("PKG-INFO") or ""
    yield f"{folder}/METADATA", metadata.encode()
    yield f"{folder}/entry_points.txt", (installed.read_text("entry_points.txt") or "").encode()


def _installed() -> Distribution:
    try:
        return distribution("xdynamics")
    except PackageNotFoundError:
        raise InputError(
            "a bundle carries the package, which is not installed here, so that what it needs is not known:"
            " pip install -e . where it is"
        ) from None

"""Runs from files, compared with every digest."""

from __future__ import annotations

import warnings
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xdynamics.archive.library import DAMAGE, opened
from xdynamics.archive.origin import read
from xdynamics.archive.seals import root_digest, seal_holds, stored_digest, volatile_digest
from xdynamics.archive.source import check_source
from xdynamics.faults import ArchiveError, InputError, KindWarning, numbered
from xdynamics.record import faults_of, own_attributes
from xdynamics.record.kinds import said_of
from xdynamics.schema import DIGEST, ROOT_DIGEST, VOLATILE_DIGEST

if TYPE_CHECKING:
    import xarray as xr


def open_run(path: str | Path, *, check: bool = True) -> xr.Dataset:
    """Open an archived run, verified; variables are read when they are used.

    Parameters
    ----------
    path : str or Path
    check : bool
        Whether to compare the file with its seal first, or where it bears none with every digest; this reads the whole
        file once.

    Raises
    ------
    ArchiveError
        If the file is damaged or no run archive; names what differs.
    """
    import xarray as xr

    path = Path(path)
    check_source(path)
    if check and not seal_holds(path):
        verify(path)
    try:
        run = xr.open_dataset(path, engine="netcdf4", decode_times=False, mask_and_scale=False)
    except DAMAGE as error:
        raise ArchiveError(f"'{path}' cannot be opened as a run archive: {error}") from None
    _check_record(run, path)
    return read(run, partial(_again, path, str(run.attrs.get(ROOT_DIGEST, ""))))


def _again(path: Path, digest: str) -> xr.Dataset | None:
    """Open a file again, where it still holds the same record."""
    try:
        run = open_run(path)
    except InputError:
        return None
    return run if run.attrs[ROOT_DIGEST] == digest else None


def _check_record(run: xr.Dataset, path: Path) -> None:
    """Refuse what bears right digests and is no run record: somebody else wrote it, or another version."""
    try:
        faults = faults_of(run, values=False)
    except DAMAGE as error:
        faults = [str(error)]
    if faults:
        run.close()
        raise ArchiveError(f"'{path}' is as it was written, but no run record:{numbered(faults)}", tuple(faults))


def verify(path: str | Path) -> str:
    """Compare an archive with its digests: the file's bytes, every variable, every attribute.

    Returns
    -------
    str
        The content digest.

    Raises
    ------
    InputError
        If there is no such file.
    ArchiveError
        Naming every variable that differs from its digest.

    Warns
    -----
    KindWarning
        If the file is as it was written, and holds a selection of a run or derived data.
    """
    digest = verified(Path(path))
    with open_run(path, check=False) as run:
        said = said_of(run.attrs)
    if said:
        warnings.warn(f"'{path}' is as it was written, and is {said}", KindWarning, stacklevel=2)
    return digest


def verified(path: Path) -> str:
    """Compare with the digests alone; see `verify`."""
    check_source(path)
    faults = ["the bytes of the file differ from its seal"] if seal_holds(path) is False else []
    with opened(path) as file:
        faults += [
            f"attribute '{name}' is missing" for name in (ROOT_DIGEST, VOLATILE_DIGEST) if name not in file.ncattrs()
        ]
        digests: dict[str, str] = {}
        for name, variable in file.variables.items():
            fault = _fault_of(variable, digests)
            if fault:
                faults.append(f"variable '{name}' {fault}")
        attributes = {key: file.getncattr(key) for key in file.ncattrs()}
        if not faults:
            own = {name: _attributes_of(one) for name, one in file.variables.items()}
            if attributes[ROOT_DIGEST] != root_digest(digests, own, attributes):
                faults.append("the attributes differ from the content digest")
            if attributes[VOLATILE_DIGEST] != volatile_digest(attributes):
                faults.append("the attributes on date, versions and machine differ from their digest")
    if faults:
        raise ArchiveError(f"'{path}' is damaged or no run archive:{numbered(faults)}", tuple(faults))
    return str(attributes[ROOT_DIGEST])


def _fault_of(variable: Any, digests: dict[str, str]) -> str:
    """Compare one variable with its digest, and note the digest; return what is wrong."""
    try:
        digests[variable.name] = stored_digest(variable)
        attributes = {key: variable.getncattr(key) for key in variable.ncattrs()}
    except DAMAGE as error:
        return f"cannot be read: {error}"
    if attributes.get(DIGEST) != digests[variable.name]:
        return "differs from its digest"
    if attributes.get("coordinates", "time") != "time" or attributes.get("_Encoding", "utf-8") != "utf-8":
        return "is not stored as it was written"
    return ""


def _attributes_of(variable: Any) -> dict[str, Any]:
    return own_attributes({key: variable.getncattr(key) for key in variable.ncattrs()})

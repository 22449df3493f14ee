"""What an archive is compared with: its seal, the bounds of its file, the digests of its variables and attributes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from xdynamics.archive.declared_sizes import declared, foreign, oversize
from xdynamics.archive.inventory import Inventory, inventory
from xdynamics.archive.netcdf_library import DAMAGE, alone, opened, read, words_of
from xdynamics.archive.netcdf_library import attributes as attributes_of
from xdynamics.archive.place import Place
from xdynamics.archive.seals import Tail, digests_in, letters_of, root_digest, stored_digest, volatile_digest
from xdynamics.archive.text_encoding import bytes_of, form_of
from xdynamics.faults import ArchiveError, numbered
from xdynamics.record.variable_attributes import own_attributes
from xdynamics.schema import DIGEST, DIGESTS, ORIGIN, ROOT_DIGEST, SEALED, VOLATILE_DIGEST, coordinates_of, is_former

AT_ONCE = (
    1_000_000  # bytes of a file that is compared while no other thread is in the library: some hundredths of a second
)


@dataclass(frozen=True)
class Examination:
    """The result of examining an archive.

    Attributes
    ----------
    faults : tuple of str
        Everything that differs; empty for an archive as it was written.
    digest : str
        The content digest that it states.
    outcome : str
        How its run ended, as recorded.
    """

    faults: tuple[str, ...]
    digest: str = ""
    outcome: str = ""

    def settle(self, path: Place) -> None:
        """Raise the faults as one error, if there are any.

        Raises
        ------
        ArchiveError
            With every fault.
        """
        if self.faults:
            raise ArchiveError(f"'{path}' is damaged or no run archive:{numbered(self.faults)}", self.faults)


def examine(path: Path, tail: Tail, granted: Callable[[int], None] | None = None) -> Examination:
    """Compare an archive with its seal and digests, in this process; its objects are listed first.

    Parameters
    ----------
    path : Path
    tail : Tail
        The end of the file, from `tail_of`.
    granted : callable, optional
        Called with the number of bytes to be read, once the file can hold that many.
    """
    faults = [tail.fault] if tail.fault else []
    try:
        objects = inventory(path)
    except DAMAGE as error:
        return Examination((*faults, f"it cannot be read: {words_of(error)}"))
    if objects.faults:  # not opened: the netCDF library would follow them
        return Examination((*faults, *objects.faults))
    return compare(path, tail, objects, granted)


def compare(
    path: Path, tail: Tail, objects: Inventory | None = None, granted: Callable[[int], None] | None = None
) -> Examination:
    """Compare an archive, all of whose bytes are known here, with its seal and digests.

    Parameters
    ----------
    path : Path
    tail : Tail
    objects : Inventory, optional
        Its objects, if others wrote it.
    granted : callable, optional
        As for `examine`.
    """
    faults = [tail.fault] if tail.fault else []
    try:
        with opened(path) as file:
            if bounds := oversize(path, file):
                return Examination((*faults, *bounds))
            if granted:
                granted(declared(file))
            if path.stat().st_size <= AT_ONCE:  # one turn in the library for all of it, not six for each variable
                return alone(_examined)(file, tail, faults, objects)
            return _examined(file, tail, faults, objects)
    except DAMAGE as error:
        return Examination((*faults, f"it cannot be read: {words_of(error)}"))


def _examined(file: Any, tail: Tail, faults: list[str], objects: Inventory | None) -> Examination:
    faults += foreign(file)
    attributes = attributes_of(file)
    if objects is not None:
        shown = {name: {*attributes_of(variable)} for name, variable in file.variables.items()}
        faults += objects.hidden(shown | {"": {*attributes}}, {*file.dimensions})
    if ORIGIN in attributes:
        faults.append(f"attribute '{ORIGIN}' is none of an archive")
    if SEALED in attributes and tail == Tail():
        faults.append("its seal is missing: the end of the file is cut off or overwritten")
    missing = [f"attribute '{name}' is missing" for name in (ROOT_DIGEST, VOLATILE_DIGEST) if name not in attributes]
    stated, noted = digests_in(attributes), dict[str, _Stored]()
    differing = [
        f"variable '{name}' {fault}"
        for name in file.variables
        if (fault := _fault_of(name, file.variables, stated, noted))
    ]
    if DIGESTS in attributes and {*stated} != {*file.variables}:
        differing.append("the variables are not those that the file states digests of")
    if len(noted) == len(file.variables):  # else what could not be read would be missing among the coordinates
        about = {name: (stored.dims, stored.attributes.get("role")) for name, stored in noted.items()}
        named = {name: coordinates_of(name, about, former=is_former(attributes)) for name in about}
        differing += [
            f"variable '{name}' is not stored as it was written"
            for name, stored in noted.items()
            if stored.coordinates not in (None, named[name])
        ]
    digests = {name: stored.digest for name, stored in noted.items()}
    own = {name: stored.attributes for name, stored in noted.items()}
    faults += missing + differing
    if not missing and not differing and attributes[ROOT_DIGEST] != root_digest(digests, own, attributes):
        faults.append("the attributes differ from the content digest")
    if not missing and attributes[VOLATILE_DIGEST] != volatile_digest(digests, own, attributes):
        faults.append("the attributes on date, versions and machine differ from their digest")
    return Examination(tuple(faults), str(attributes.get(ROOT_DIGEST, "")), str(attributes.get("run_outcome", "")))


class _Stored(NamedTuple):
    """What a file holds of a variable: its digest, its own attributes, its dims without letters, and its coordinates."""

    digest: str
    attributes: dict[str, Any]
    dims: tuple[str, ...]
    coordinates: str | None


def _fault_of(name: str, variables: Mapping[str, Any], stated: Mapping[str, str], noted: dict[str, _Stored]) -> str:
    """Compare one of a file's variables with its digest, and note what it holds; return its fault."""
    variable = variables[name]
    try:
        digest = stored_digest(variable)
        attributes = attributes_of(variable)
        dims, shape, dtype = alone(lambda: (variable.dimensions, variable.shape, variable.dtype))()
        form, is_text = form_of(attributes, dtype, dims, shape), dtype == "S1"
        text = read(variable, ...).tobytes() if is_text else b""
    except DAMAGE as error:
        return f"cannot be read: {words_of(error)}"
    further = letters_of(name) if is_text else bytes_of(name) if form and form.further else ""
    own_dims = dims[:-1] if further else dims
    noted[name] = _Stored(digest, own_attributes(attributes), own_dims, attributes.get("coordinates"))
    try:
        text.decode()
    except UnicodeDecodeError as error:
        return f"is no text in UTF-8: {error.reason} at {error.start}"
    if stated.get(name, attributes.get(DIGEST)) != digest:
        return "differs from its digest"
    recoded = is_text and attributes.get("_Encoding", "utf-8") != "utf-8"
    if recoded or "_FillValue" in attributes or (further and dims != (*own_dims, further)):
        return "is not stored as it was written"
    return ""

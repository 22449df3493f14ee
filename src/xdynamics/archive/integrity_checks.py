"""Checks of an archive against its seal, its file bounds, and the digests of its variables and attributes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.archive.file_structure import Inventory, declared_bytes, inventory, size_faults, unused_dimensions
from xdynamics.archive.netcdf_library import DAMAGE, error_text, opened_file, read_stored, with_library_lock
from xdynamics.archive.netcdf_library import stored_attributes as attributes_of
from xdynamics.archive.seals import Seal, Tail, digests_in, letters_of, root_digest, stored_digest, volatile_digest
from xdynamics.archive.store import Place
from xdynamics.archive.text_encoding import bytes_dim, text_form
from xdynamics.faults import ArchiveError, numbered_lines
from xdynamics.record.flag_words import own_attributes

AT_ONCE = (
    1_000_000  # bytes of a file that is compared while no other thread is in the library: some hundredths of a second
)


VERIFIED, REPACKED, EDITED, DAMAGED = "verified", "repacked", "edited", "damaged"
HARM, EDIT, MANNER = range(3)  # what a fault is of: of the file, of what the record says, of how a file keeps that


@dataclass(frozen=True)
class Examination:
    """The result of examining an archive.

    Attributes
    ----------
    faults : tuple of str
        Everything that differs; empty where every number agrees.
    digest : str
        The content digest that it states.
    outcome : str
        How its run ended, as recorded.
    verdict : str
        `VERIFIED`, `REPACKED` by another program, `EDITED` or `DAMAGED`.
    """

    faults: tuple[str, ...]
    digest: str = ""
    outcome: str = ""
    verdict: str = VERIFIED

    @classmethod
    def from_differences(cls, differences: Sequence[Fault], tail: Tail, attributes: Mapping[str, Any]) -> Examination:
        """Judge differences: a seal covers every byte; without a seal the record's own digests decide."""
        kinds = {kind for kind, _ in differences}
        faults = tuple(text for _, text in differences)
        if HARM in kinds:
            sealed = tail.digest or tail.fault
            verdict, faults = DAMAGED, tuple(text for kind, text in differences if sealed or kind != MANNER)
        elif tail.digest:
            verdict = EDITED if faults else VERIFIED
        elif EDIT in kinds:
            verdict, faults = EDITED, tuple(text for kind, text in differences if kind == EDIT)
        else:  # archives of the first versions had no seal
            verdict, faults = REPACKED if faults or schema.SEALED in attributes else VERIFIED, ()
        return cls(faults, str(attributes.get(schema.ROOT_DIGEST, "")), str(attributes.get("run_outcome", "")), verdict)

    def raise_faults(self, path: Place, *, also_edited: bool = False) -> None:
        """Raise the faults as one error, if there are any.

        Parameters
        ----------
        path : Path
        also_edited : bool
            Whether what was edited is let pass.

        Raises
        ------
        ArchiveError
            With every fault.
        """
        if not self.faults or (also_edited and self.verdict == EDITED):
            return
        verdict_text = "was edited since it was archived" if self.verdict == EDITED else "is damaged or no run archive"
        raise ArchiveError(f"'{path}' {verdict_text}:{numbered_lines(self.faults)}", self.faults, self.verdict)


Fault = tuple[int, str]


def harmed(*harms: str) -> Examination:
    """Return the result for a file that cannot be read."""
    return Examination(harms, verdict=DAMAGED)


def examine_file(
    path: Path, tail: Tail, granted: Callable[[int], None] | None = None, *, values: bool = True
) -> Examination:
    """Compare an archive with its seal and digests, in this process; its objects are listed first.

    Parameters
    ----------
    path : Path
    tail : Tail
        The end of the file, from `tail_of`.
    granted : callable, optional
        Called with the number of bytes to be read, once the file can hold that many.
    values : bool
        Whether values are read, or structure and attributes alone, of a copy without them.
    """
    harms = [tail.fault] if tail.fault else []
    try:
        objects = inventory(path)
    except DAMAGE as error:
        return harmed(*harms, f"it cannot be read: {error_text(error)}")
    if objects.faults:  # not opened: the netCDF library would follow them
        return harmed(*harms, *objects.faults)
    return compare_file(path, tail, objects, granted, values=values)


def compare_file(
    path: Path,
    tail: Tail,
    objects: Inventory | None = None,
    granted: Callable[[int], None] | None = None,
    *,
    values: bool = True,
) -> Examination:
    """Compare an archive, all of whose bytes are known here, with its seal and digests.

    Parameters
    ----------
    path : Path
    tail : Tail
    objects : Inventory, optional
        Its objects, if others wrote it.
    granted, values
        As for `examine_file`.
    """
    harms = [tail.fault] if tail.fault else []
    try:
        with opened_file(path) as file:
            if bounds := size_faults(path, file, is_partial=not values):
                return harmed(*harms, *bounds)
            if granted and values:
                granted(declared_bytes(file))
            if path.stat().st_size <= AT_ONCE:  # one turn in the library for all of it, not six for each variable
                return with_library_lock(_examine_open_file)(file, tail, harms, objects, values=values)
            return _examine_open_file(file, tail, harms, objects, values=values)
    except DAMAGE as error:
        return harmed(*harms, f"it cannot be read: {error_text(error)}")


def _examine_open_file(
    file: Any, tail: Tail, harms: list[str], objects: Inventory | None, *, values: bool
) -> Examination:
    differences = [(HARM, harm) for harm in harms] + [(MANNER, fault) for fault in unused_dimensions(file)]
    attributes = attributes_of(file)
    if objects is not None:
        shown_attributes = {name: {*attributes_of(variable)} for name, variable in file.variables.items()}
        differences += [
            (HARM, fault)
            for fault in objects.unshown_objects(shown_attributes | {"": {*attributes}}, {*file.dimensions})
        ]
    if schema.ORIGIN in attributes:
        differences.append((MANNER, f"attribute '{schema.ORIGIN}' is none of an archive"))
    if schema.ROOT_DIGEST not in attributes:
        differences.append((HARM, f"attribute '{schema.ROOT_DIGEST}' is missing, which xd.save writes"))
    needed = [schema.VOLATILE_DIGEST, *([] if schema.is_former(attributes) else [schema.DIGESTS])]
    differences += [(MANNER, f"attribute '{name}' is missing") for name in needed if name not in attributes]
    record = _Record(
        attributes,
        {recorded_name(name, variable, attributes): variable for name, variable in file.variables.items()},
        values=values,
    )
    of_variables = [*record.faults()]
    differences += of_variables
    # a variable that differs is named already, and changes the content digest too
    if schema.ROOT_DIGEST in attributes and all(kind == MANNER for kind, _ in of_variables) and not record.agrees():
        differences.append((EDIT, "the attributes differ from the content digest"))
    if schema.VOLATILE_DIGEST in attributes and attributes[schema.VOLATILE_DIGEST] != record.volatile_digest():
        differences.append((MANNER, "the attributes on date, versions and machine differ from their digest"))
    return Examination.from_differences(differences, tail, attributes)


def recorded_name(name: str, variable: Any, attributes: Mapping[str, Any]) -> str:
    """Return a variable's name in a record: labels are the index of their dimension in memory and in xarray's files."""
    dims = with_library_lock(lambda: variable.dimensions)()
    is_index = schema.MODEL_DIMENSIONS in attributes and dims[:1] == (name,)
    return schema.label_of(name) if is_index and attributes_of(variable).get("role") == schema.LABEL else name


class _Stored(NamedTuple):
    """A variable in a file: its digest, its own attributes, its dims without that of letters, its coordinates."""

    digest: str
    attributes: dict[str, Any]
    dims: tuple[str, ...]
    coordinates: str | None


class _Record:
    """The content of a record's file, compared with the digests that it states.

    Parameters
    ----------
    attributes : dict
    variables : dict of str to netCDF4.Variable
        By their names in the record.
    values : bool
        Whether their values are read; else the digests that are stated of them are taken.
    """

    def __init__(self, attributes: Mapping[str, Any], variables: Mapping[str, Any], *, values: bool) -> None:
        self._attributes, self._stated, self._values = attributes, digests_in(attributes), values
        self._variables, self._stored_variables = dict(variables), dict[str, _Stored]()
        texts = [
            with_library_lock(lambda: text.dimensions)()
            for name in schema.TEXT_NAMES
            if (text := variables.get(name)) is not None
        ]
        # a record of the former schema that was opened here and written by another program has the words of today
        self._in_words_of_today = schema.is_former(attributes) and (
            (schema.DOCUMENT,) in [dims[:1] for dims in texts]
            or bool(
                self._stated and schema.STEP_NUMBER.name in variables and schema.STEP_NUMBER.name not in self._stated
            )
        )
        self._numbers = self._numbers_of_rows() if self._in_words_of_today and values else None

    def _numbers_of_rows(self) -> NDArray[np.int64] | None:
        """Return the row numbers under today's schema, if the record as written has them too."""
        if (
            variable := self._variables.get(schema.STEP_NUMBER.name)
        ) is None or schema.SELECTION_OF in self._attributes:
            return None
        numbers = np.asarray(read_stored(variable, ...))
        if schema.STEP_NUMBER.name in self._stated or not np.array_equal(numbers, np.arange(numbers.size)):
            return numbers
        del self._variables[schema.STEP_NUMBER.name]  # made when it was opened
        return None

    def faults(self) -> Iterator[Fault]:
        """Compare every variable with its digest, and yield differences of content or of storage."""
        for name in self._variables:
            if (fault := self._variable_fault(name)) is not None:
                yield fault
        for name in self._stated:
            if name not in self._variables:
                yield EDIT, f"variable '{name}' is missing, of which there is a digest"
        # what could not be read would be missing among the coordinates
        if len(self._stored_variables) == len(self._variables):
            about = {
                name: (stored.dims, stored.attributes.get("role")) for name, stored in self._stored_variables.items()
            }
            for name, stored in self._stored_variables.items():
                if stored.coordinates not in (
                    None,
                    schema.coordinates_of(name, about, former=schema.is_former(self._attributes)),
                ):
                    yield MANNER, f"variable '{name}' is not stored as it was written"

    def _variable_fault(self, name: str) -> Fault | None:
        """Compare a variable of the file with its digest, and record its digest and attributes; return its fault."""
        variable = self._variables[name]
        try:
            digest = self._digest_of(name)
            attributes = attributes_of(variable)
            dims, shape, dtype = with_library_lock(lambda: (variable.dimensions, variable.shape, variable.dtype))()
            form, is_text = text_form(attributes, dtype, dims, shape), dtype == "S1"
            text = read_stored(variable, ...).tobytes() if is_text and self._values else b""
        except DAMAGE as error:
            return HARM, f"variable '{name}' cannot be read: {error_text(error)}"
        further = letters_of(name) if is_text else bytes_dim(name) if form and form.further else ""
        own_dims = dims[:-1] if further else dims
        self._stored_variables[name] = _Stored(
            digest, own_attributes(attributes), own_dims, attributes.get("coordinates")
        )
        try:
            text.decode()
        except UnicodeDecodeError as error:
            return HARM, f"variable '{name}' is no text in UTF-8: {error.reason} at {error.start}"
        stated = self._stated.get(name, attributes.get(schema.DIGEST))
        if stated != digest and (stated or self._stated):
            return EDIT, f"variable '{name}' differs from its digest"
        recoded = dtype is str or (is_text and attributes.get("_Encoding", "utf-8") != "utf-8")
        if recoded or "_FillValue" in attributes or (further and dims != (*own_dims, further)):
            return MANNER, f"variable '{name}' is not stored as it was written"
        return None

    def _digest_of(self, name: str) -> str:
        """Return the digest of a variable as the record was written."""
        variable = self._variables[name]
        if not self._values:
            return self._stated.get(name, str(attributes_of(variable).get(schema.DIGEST, "")))
        if self._numbers is not None and name in schema.NAMES_ROWS:
            dims, dtype = with_library_lock(lambda: (variable.dimensions, variable.dtype))()
            seal, places = Seal(name, dims, dtype), np.searchsorted(self._numbers, read_stored(variable, ...))
            seal.update(places.astype(dtype))
            return seal.hexdigest()
        return stored_digest(
            variable,
            name,
            single=name in schema.TEXT_NAMES and self._in_words_of_today and self._is_along_document(name),
        )

    def _is_along_document(self, name: str) -> bool:
        return (*with_library_lock(lambda: self._variables[name].dimensions)()[:1],) == (schema.DOCUMENT,)

    def agrees(self) -> bool:
        """Whether the content digest is that of variables and attributes, apart from later notes."""
        digests, variable_attributes, stated_digest = (
            self._variable_digests,
            self._variable_attributes,
            self._attributes[schema.ROOT_DIGEST],
        )
        names = [*self._attributes]
        behind = (
            names[names.index(schema.VOLATILE_DIGEST) :] if schema.VOLATILE_DIGEST in names else []
        )  # it is written last
        for added in ((), behind):
            remaining = {
                name: value
                for name, value in self._attributes.items()
                if name not in added or name.startswith(schema.OF_RECORD)
            }
            if root_digest(digests, variable_attributes, remaining) == stated_digest:
                return True
        return False

    def volatile_digest(self) -> str:
        """Return the digest of circumstances as they are in the file."""
        return volatile_digest(self._variable_digests, self._variable_attributes, self._attributes)

    @property
    def _variable_digests(self) -> dict[str, str]:
        return {name: stored.digest for name, stored in self._stored_variables.items()}

    @property
    def _variable_attributes(self) -> dict[str, dict[str, Any]]:
        return {name: stored.attributes for name, stored in self._stored_variables.items()}

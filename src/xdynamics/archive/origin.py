"""A record as it was before any edit: it travels with the Dataset, and `save` compares the two."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics.archive.seals import Seal, digest_lines, digests_in, root_digest, stored_slabs
from xdynamics.record import own_attributes
from xdynamics.record.folding import labelled, unlabelled
from xdynamics.record.schemas import in_own_words, modern, with_variables
from xdynamics.runtime.cached_properties import cached_property
from xdynamics.schema import DIGEST, DIGESTS, FLAG_ATTRIBUTES, NOTES, ORIGIN, ROOT_DIGEST, VOLATILE_DIGEST

if TYPE_CHECKING:
    import xarray as xr

TEXT = "as it was marched or read; save compares the record with it"
# attributes that may change: what was done, what is noted beside the record, and who it is
OUTSIDE = ("history", VOLATILE_DIGEST, ROOT_DIGEST, DIGESTS, ORIGIN, *NOTES)


Source = Callable[[], "xr.Dataset | None"]
Unchanged = Callable[["xr.Variable"], bool]


@dataclass(frozen=True)
class OriginalVariable:
    """One variable as it was: its digest, or its values, from which the digest is computed on demand.

    An array is kept, not copied: it is made read-only, so that what a Dataset shows is what was marched.
    """

    name: str
    dims: tuple[str, ...]
    shape: tuple[int, ...]
    attributes: Mapping[str, Any]
    variable: xr.Variable | None = None
    known_digest: str = ""
    # the data of a variable of an opened archive, to notice that they were replaced
    opened_data: Any = field(default=None, compare=False)
    # for lazy values: tests whether given values are their result, if that was noted
    unchanged: Unchanged | None = field(default=None, compare=False)

    @cached_property
    def digest(self) -> str:
        """The digest that the variable has in a file."""
        return self.known_digest or variable_digest(self.name, self.variable)

    @property
    def sent(self) -> OriginalVariable:
        """The same for another process: a digest in the place of values; what is lazy stays so, and nothing is marched."""
        if self.known_digest or self.variable is None or isinstance(self.variable.data, np.ndarray):
            return OriginalVariable(self.name, self.dims, self.shape, self.attributes, known_digest=self.digest)
        return OriginalVariable(
            self.name, self.dims, self.shape, self.attributes, self.variable, unchanged=self.unchanged
        )


class Origin(list[str]):
    """A short text as an attribute, like any other, which carries the record as it was.

    It is a list of one text: all formats that xarray writes take that, and some refuse a kind of text of our own.
    """

    attributes: dict[str, Any]
    source: Source | None
    edits: tuple[str, ...]
    _parts: Callable[[], dict[str, OriginalVariable]]

    @classmethod
    def from_parts(
        cls,
        parts: Callable[[], dict[str, OriginalVariable]],
        attributes: Mapping[Any, Any],
        source: Source | None,
        edits: tuple[str, ...] = (),
    ) -> Origin:
        """Make an origin of a record's parts, computed on demand, its attributes, the source of its values, and how it was edited."""
        origin = cls([TEXT])
        origin._parts, origin.attributes, origin.source, origin.edits = parts, dict(attributes), source, edits
        return origin

    @cached_property
    def parts(self) -> dict[str, OriginalVariable]:
        """Every variable by name."""
        return self._parts()

    @cached_property
    def content_digest(self) -> str:
        """The content digest of the whole record; of one that was edited, that of what was archived."""
        if self.edits:
            return str(self.attributes.get(ROOT_DIGEST, ""))
        digests = {name: part.digest for name, part in self.parts.items()}
        return root_digest(digests, {name: part.attributes for name, part in self.parts.items()}, self.attributes)

    def original_record(self) -> xr.Dataset | None:
        """Return the record as it was, if its values are still at hand."""
        import xarray as xr

        if self.source is not None:
            return self.source()
        variables = {name: part.variable for name, part in self.parts.items()}
        return None if any(variable is None for variable in variables.values()) else xr.Dataset(variables)

    def with_evaluated(self, lazy: Mapping[str, Any], loaded: xr.Dataset) -> Origin:
        """Return the origin of a record whose lazy arrays were computed: what they gave stands in their place."""

        def parts() -> dict[str, OriginalVariable]:
            return {
                name: replace(part, variable=loaded.variables[name], unchanged=None)
                if name in lazy and part.variable is not None and part.variable.data is lazy[name]
                else part
                for name, part in self.parts.items()
            }

        return Origin.from_parts(parts, self.attributes, self.source, self.edits)

    def __repr__(self) -> str:
        return repr(self[0])

    def __copy__(self) -> Origin:
        return self

    def __deepcopy__(self, _memo: object) -> Origin:
        return self  # a copy has the same origin

    def __reduce__(self) -> Any:
        return _restored, (
            {name: part.sent for name, part in self.parts.items()},
            self.attributes,
            self.source,
            self.edits,
        )


def _restored(
    parts: dict[str, OriginalVariable], attributes: dict[str, Any], source: Source | None, edits: tuple[str, ...]
) -> Origin:
    return Origin.from_parts(lambda: parts, attributes, source, edits)


def marched(run: xr.Dataset, unchanged: Mapping[str, Unchanged] | None = None) -> xr.Dataset:
    """Make the arrays of a record read-only, and let it remember them; nothing is copied or hashed.

    Parameters
    ----------
    run : xarray.Dataset
    unchanged : mapping, optional
        For lazy variables, tests whether values are their result, without computing them again.
    """
    run = unlabelled(run)
    arrays = {
        str(name): (variable.dims, variable.data, dict(variable.attrs)) for name, variable in run.variables.items()
    }
    for _, data, _ in arrays.values():
        if isinstance(data, np.ndarray):  # lazy arrays are read-only already
            data.flags.writeable = False
    run.attrs[ORIGIN] = Origin.from_parts(partial(_parts_of_arrays, arrays, unchanged or {}), run.attrs, None)
    return labelled(run)


def evaluated(run: xr.Dataset, values: Mapping[Any, Any]) -> xr.Dataset:
    """Return a record with values in the place of the lazy arrays that they were just computed from, by name.

    The record remembers them as it does what was marched: they are not computed again to be compared.
    """
    loaded = run.copy(deep=False)
    lazy = {str(name): run.variables[name].data for name in values}
    for name, data in values.items():
        loaded.variables[name].data = data
        if isinstance(array := loaded.variables[name].data, np.ndarray):
            array.flags.writeable = False
    if isinstance(origin := run.attrs.get(ORIGIN), Origin):
        remembered_run = loaded.copy(deep=False)  # a variable that is assigned to afterwards is another one there
        loaded.attrs[ORIGIN] = origin.with_evaluated(lazy, remembered_run)
    return loaded


def _parts_of_arrays(
    arrays: Mapping[str, tuple[Any, Any, dict[str, Any]]], unchanged: Mapping[str, Unchanged]
) -> dict[str, OriginalVariable]:
    import xarray as xr

    return {
        name: OriginalVariable(
            name,
            dims,
            data.shape,
            attributes,
            xr.Variable(dims, data, attributes, fastpath=True),
            unchanged=unchanged.get(name),
        )
        for name, (dims, data, attributes) in arrays.items()
    }


def remember_archive(run: xr.Dataset, source: Source, *, edits: tuple[str, ...] = (), texts: bool = True) -> xr.Dataset:
    """Remember what the variables of an opened archive are, and their digests, all of which stand in one place.

    Parameters
    ----------
    run : xarray.Dataset
        As it is in the file.
    source : callable
        Opens it again.
    edits : tuple of str
        How it differs from its digests.
    texts : bool
        Whether to read texts, which are short: they have the type that they had when the run was marched.
    """
    parts = dict[str, OriginalVariable]()
    stated = digests_in(run.attrs) or {
        str(name): str(variable.attrs[DIGEST]) for name, variable in run.variables.items() if DIGEST in variable.attrs
    }
    run = in_own_words(unlabelled(run))
    if texts:
        run = with_variables(
            run, {str(name): _decoded_text(text) for name, text in run.variables.items() if text.dtype.kind == "O"}
        )
    for name, variable in run.variables.items():
        variable.attrs = own_attributes(variable.attrs)
        if (values := FLAG_ATTRIBUTES[0]) in variable.attrs:  # of one number, or as other formats keep them
            numbers = np.atleast_1d(variable.attrs[values])
            variable.attrs[values] = numbers.astype(variable.dtype) if variable.dtype.kind in "iu" else numbers
        parts[str(name)] = OriginalVariable(
            str(name),
            tuple(map(str, variable.dims)),
            variable.shape,
            variable.attrs,
            variable=None if str(name) in stated else variable,
            known_digest=stated.get(str(name), ""),
            opened_data=variable._data,  # noqa: SLF001
        )
    if stated:
        run.attrs[DIGESTS] = digest_lines(stated)
    run.attrs[ORIGIN] = Origin.from_parts(lambda: parts, run.attrs, None if edits else source, edits)
    return labelled(modern(run))


def _decoded_text(text: xr.Variable) -> xr.Variable:
    return text.copy(data=np.asarray(text.values).astype(str))


def variable_digest(name: str, variable: Any) -> str:
    """Return the digest that a variable has in a file."""
    seal = Seal(name, tuple(map(str, variable.dims)), variable.dtype)
    for slab in stored_slabs(variable):
        seal.update(slab)
    return seal.hexdigest()

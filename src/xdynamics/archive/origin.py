"""What a record was before anybody could edit it: it travels with the Dataset, and `save` compares the two."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics.archive.seals import Seal, root_digest, stored_slabs
from xdynamics.cached import cached_property
from xdynamics.record import own_attributes
from xdynamics.schema import DIGEST, ORIGIN, ROOT_DIGEST, VOLATILE_DIGEST

if TYPE_CHECKING:
    import xarray as xr

TEXT = "as it was marched or read; save compares the record with it"
OUTSIDE = (
    "history",
    VOLATILE_DIGEST,
    ROOT_DIGEST,
    ORIGIN,
)  # attributes that may change: what was done, and who the record is


Source = Callable[[], "xr.Dataset | None"]
Unchanged = Callable[["xr.Variable"], bool]


@dataclass(frozen=True)
class Part:
    """One variable as it was: its digest, or its values, of which a digest is made when it is asked for.

    An array is kept, not copied: it is closed to writing, so that what a Dataset shows is what was marched.
    """

    name: str
    dims: tuple[str, ...]
    shape: tuple[int, ...]
    attributes: Mapping[str, Any]
    variable: xr.Variable | None = None
    known: str = ""
    # what a variable of an opened archive holds, as long as nobody puts something else there
    held: Any = field(default=None, compare=False)
    # of values that were lazy: whether those at hand are what came of them, where that was noted
    unchanged: Unchanged | None = field(default=None, compare=False)

    @cached_property
    def digest(self) -> str:
        """The digest that the variable has in a file."""
        return self.known or digest_of(self.name, self.variable)

    @property
    def as_digest(self) -> Part:
        """The same without its values, to be sent to another process."""
        return Part(self.name, self.dims, self.shape, self.attributes, known=self.digest)


class Origin(str):
    """A short text as an attribute, like any other; and behind it the record as it was."""

    attributes: dict[str, Any]
    source: Source | None
    _parts: Callable[[], dict[str, Part]]

    @classmethod
    def of(cls, parts: Callable[[], dict[str, Part]], attributes: Mapping[Any, Any], source: Source | None) -> Origin:
        """Take a record's parts, to be made when they are asked for, its attributes, and where to read its values again."""
        origin = cls(TEXT)
        origin._parts, origin.attributes, origin.source = parts, dict(attributes), source
        return origin

    @cached_property
    def parts(self) -> dict[str, Part]:
        """Every variable by name."""
        return self._parts()

    @cached_property
    def content_digest(self) -> str:
        """The content digest of the whole record."""
        digests = {name: part.digest for name, part in self.parts.items()}
        return root_digest(digests, {name: part.attributes for name, part in self.parts.items()}, self.attributes)

    def whole(self) -> xr.Dataset | None:
        """Return the record as it was, where its values are still at hand."""
        import xarray as xr

        if self.source is not None:
            return self.source()
        found = {name: part.variable for name, part in self.parts.items()}
        return None if any(one is None for one in found.values()) else xr.Dataset(found)

    def __copy__(self) -> Origin:
        return self

    def __deepcopy__(self, _memo: object) -> Origin:
        return self  # what was marched does not become another thing with a copy

    def __reduce__(self) -> Any:
        return _restored, ({name: part.as_digest for name, part in self.parts.items()}, self.attributes, self.source)


def _restored(parts: dict[str, Part], attributes: dict[str, Any], source: Source | None) -> Origin:
    return Origin.of(lambda: parts, attributes, source)


def marched(run: xr.Dataset, unchanged: Mapping[str, Unchanged] | None = None) -> xr.Dataset:
    """Close the arrays of a record to writing, and let it remember them: nothing is copied or hashed for it.

    Parameters
    ----------
    run : xarray.Dataset
    unchanged : mapping, optional
        For lazy variables what tells whether values are those that came of them, without computing them again.
    """
    arrays = {str(name): (one.dims, one.data, dict(one.attrs)) for name, one in run.variables.items()}
    for _, data, _ in arrays.values():
        if isinstance(data, np.ndarray):  # what is not computed yet is closed as it is
            data.flags.writeable = False
    run.attrs[ORIGIN] = Origin.of(partial(_of_arrays, arrays, unchanged or {}), run.attrs, None)
    return run


def _of_arrays(
    arrays: Mapping[str, tuple[Any, Any, dict[str, Any]]], unchanged: Mapping[str, Unchanged]
) -> dict[str, Part]:
    import xarray as xr

    return {
        name: Part(
            name, dims, data.shape, about, xr.Variable(dims, data, about, fastpath=True), unchanged=unchanged.get(name)
        )
        for name, (dims, data, about) in arrays.items()
    }


def read(run: xr.Dataset, source: Source) -> xr.Dataset:
    """Take the digests off the variables of an opened archive, where arithmetic would keep them, and remember them."""
    parts = {}
    for name, one in run.variables.items():
        digest = str(one.attrs.pop(DIGEST, ""))
        parts[str(name)] = Part(
            str(name),
            tuple(map(str, one.dims)),
            one.shape,
            own_attributes(one.attrs),
            known=digest,
            held=one._data,  # noqa: SLF001
        )
    run.attrs[ORIGIN] = Origin.of(lambda: parts, run.attrs, source)
    return run


def digest_of(name: str, variable: Any) -> str:
    """Return the digest that a variable has in a file."""
    seal = Seal(name, tuple(map(str, variable.dims)), variable.dtype)
    for part in stored_slabs(variable):
        seal.update(part)
    return seal.hexdigest()

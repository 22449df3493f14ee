"""The standing of a record by comparison with its origin: the run, a selection of it, or edited data.

The origin is the record before any edit. It travels with the Dataset, and `save` compares the two.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.archive.content import content_digest
from xdynamics.archive.seals import Seal, digest_lines, digests_in, root_digest, slabs, stored_slabs, utf8_letters
from xdynamics.faults import InputError, numbered_lines
from xdynamics.record import check_elements, own_attributes, plain
from xdynamics.record.folding import is_chunked, labelled, unlabelled
from xdynamics.record.schemas import by_places, in_own_words, is_selection, modern, with_variables
from xdynamics.record.unfolding import as_recorded
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.units import UNKNOWN_UNIT

if TYPE_CHECKING:
    import xarray as xr

TEXT = "as it was marched or read; save compares the record with it"
# attributes that may change: what was done, what is noted beside the record, and who it is
OUTSIDE = ("history", schema.VOLATILE_DIGEST, schema.ROOT_DIGEST, schema.DIGESTS, schema.ORIGIN, *schema.NOTES)


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
    # for lazy values: tests whether given values are their result, if that was noted
    unchanged: Unchanged | None = field(default=None, compare=False)

    @cached_property
    def digest(self) -> str:
        """The digest that the variable has in a file."""
        return self.known_digest or variable_digest(self.name, self.variable)

    @property
    def sent(self) -> OriginalVariable:
        """The variable as sent to another process: values as a digest, lazy arrays unchanged and not computed."""
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
        """The content digest of the complete record; of an edited record, that of its archive."""
        if self.edits:
            return str(self.attributes.get(schema.ROOT_DIGEST, ""))
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
        """Return the origin of a record whose lazy arrays were computed, with their values."""

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
    """Make the arrays of a record read-only, and attach its origin; no array is copied or hashed.

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
    run.attrs[schema.ORIGIN] = Origin.from_parts(partial(_parts_of_arrays, arrays, unchanged or {}), run.attrs, None)
    return labelled(run)


def evaluated(run: xr.Dataset, values: Mapping[Any, Any]) -> xr.Dataset:
    """Return a record whose lazy arrays, by name, are replaced by the values just computed from them.

    The record remembers them as it does what was marched: they are not computed again to be compared.
    """
    loaded = run.copy(deep=False)
    lazy = {str(name): run.variables[name].data for name in values}
    for name, data in values.items():
        loaded.variables[name].data = data
        if isinstance(array := loaded.variables[name].data, np.ndarray):
            array.flags.writeable = False
    if isinstance(origin := run.attrs.get(schema.ORIGIN), Origin):
        remembered_run = loaded.copy(deep=False)  # a variable that is assigned to afterwards is another one there
        loaded.attrs[schema.ORIGIN] = origin.with_evaluated(lazy, remembered_run)
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
    """Attach to an opened archive its origin: variables, attributes and stated digests.

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
        str(name): str(variable.attrs[schema.DIGEST])
        for name, variable in run.variables.items()
        if schema.DIGEST in variable.attrs
    }
    run = in_own_words(unlabelled(run))
    if texts:
        run = with_variables(
            run, {str(name): _decoded_text(text) for name, text in run.variables.items() if text.dtype.kind == "O"}
        )
    for name, variable in run.variables.items():
        variable.attrs = own_attributes(variable.attrs)
        if (values := schema.FLAG_ATTRIBUTES[0]) in variable.attrs:  # of one number, or as other formats keep them
            numbers = np.atleast_1d(variable.attrs[values])
            variable.attrs[values] = numbers.astype(variable.dtype) if variable.dtype.kind in "iu" else numbers
        parts[str(name)] = OriginalVariable(
            str(name),
            tuple(map(str, variable.dims)),
            variable.shape,
            variable.attrs,
            variable=None if str(name) in stated else variable,
            known_digest=stated.get(str(name), ""),
        )
    if stated:
        run.attrs[schema.DIGESTS] = digest_lines(stated)
    run.attrs[schema.ORIGIN] = Origin.from_parts(lambda: parts, run.attrs, None if edits else source, edits)
    return labelled(modern(run))


def _decoded_text(text: xr.Variable) -> xr.Variable:
    import xarray as xr

    # fastpath: else xarray asks whether it is an array of dask's, whose import takes half a second
    return xr.Variable(text.dims, np.asarray(text.values).astype(str), text.attrs, text.encoding, fastpath=True)


def variable_digest(name: str, variable: Any) -> str:
    """Return the digest that a variable has in a file."""
    seal = Seal(name, tuple(map(str, variable.dims)), variable.dtype)
    for slab in stored_slabs(variable):
        seal.update(slab)
    return seal.hexdigest()


MOST_NAMED = 10
UNKNOWN = f"its origin is unknown: it was neither computed nor opened by xdynamics, or its attribute '{schema.ORIGIN}' is lost"


@dataclass(frozen=True)
class Standing:
    """The result of comparing a record with its origin.

    Attributes
    ----------
    origin : Origin or str
        Its origin, or a digest; empty if unknown.
    faults : tuple of str
        How it was edited.
    selected : str
        Which part of the run it is; empty for all of it.
    left_out_atol : dict of str to (float, str)
        Absolute tolerances in SI units, and the units, of variables that are left out: without them the run could not be marched again.
    """

    origin: Origin | str
    faults: tuple[str, ...] = ()
    selected: str = ""
    left_out_atol: Mapping[str, tuple[float, str]] = field(default_factory=dict)

    @property
    def source_digest(self) -> str:
        """Content digest of the record it came from, computed on demand; empty if unknown."""
        return self.origin.content_digest if isinstance(self.origin, Origin) else self.origin


def record_standing(run: xr.Dataset) -> Standing:
    """Compare a record with its origin, as it was marched or read."""
    origin = run.attrs.get(schema.ORIGIN)
    run = as_recorded(run, _numbers_in(run, origin) if isinstance(origin, Origin) else None)
    if not isinstance(origin, Origin):
        digest = str(run.attrs.get(schema.ROOT_DIGEST, ""))
        if digest and content_digest(run) == digest:
            return Standing(digest)
        return Standing("", (UNKNOWN,))
    faults = [*origin.edits, *_attribute_faults("", origin.attributes, run.attrs)]
    fewer: dict[str, list[str]] = {}
    for name, variable in run.variables.items():
        part = origin.parts.get(str(name))
        if part is None:
            faults.append(f"variable '{name}' is not in the run")
            continue
        faults += _attribute_faults(f" of '{name}'", part.attributes, own_attributes(variable.attrs))
        if tuple(variable.dims) != part.dims:
            faults.append(f"variable '{name}' has the dims {tuple(variable.dims)}, in the run {part.dims}")
        elif variable.shape == part.shape:
            faults += _value_faults(part, variable, origin)
        else:
            fewer.setdefault(str(variable.dims[0]), []).append(str(name))
    for dim, names in fewer.items():
        faults += _row_faults(dim, names, run, origin)
    left_out = [name for name in origin.parts if name not in run.variables]
    # tolerances that follow a rule follow it again in a new march; only given ones would be lost
    tolerances = {
        name: (float(attributes["atol_si"]), str(attributes["units"]))
        for name, attributes in ((name, origin.parts[name].attributes) for name in left_out)
        if "atol_si" in attributes and schema.ATOL_RULE not in attributes
    }
    return Standing(origin, tuple(faults), "; ".join(_selection_words(fewer, left_out, run, origin)), tolerances)


def _numbers_in(run: xr.Dataset, origin: Origin) -> NDArray[np.int64] | None:
    """Return the numbers of all rows of an archive of schema 1 of whose rows a record has some; None of other records."""
    part, row_numbers = origin.parts.get(schema.STEP_NUMBER.name), run.variables.get(schema.STEP_NUMBER.name)
    if part is None or not schema.is_former(run.attrs) or (row_numbers is not None and row_numbers.shape == part.shape):
        return None
    original = _original_record(origin)
    return None if original is None else np.asarray(original.variables[schema.STEP_NUMBER.name].values)


def _original_record(origin: Origin) -> xr.Dataset | None:
    """Return a record as it was, as a file has it, if its values are still at hand."""
    original = origin.original_record()
    return None if original is None else as_recorded(original)


def digest_of_run(run: xr.Dataset) -> str:
    """Return the content digest of a record as it is; for an unedited one, that of its archive.

    Dask arrays are not computed for it: the digest in the record's attributes is returned.
    """
    if any(map(is_chunked, run.variables.values())):
        return str(run.attrs.get(schema.ROOT_DIGEST, "unknown"))
    result = record_standing(run)
    return content_digest(run) if result.faults or result.selected else result.source_digest


def check_unchanged(run: xr.Dataset) -> None:
    """Check that a record is complete, and was not edited since it was marched or read.

    Raises
    ------
    InputError
        Naming what differs.
    """
    result = record_standing(run)
    if result.faults:
        check_cut(run)
        raise InputError(f"this is not the record that was computed:{numbered_lines(result.faults)}", result.faults)
    if result.selected:
        raise InputError(f"this is a part of a run, {result.selected}; take the whole one")


def edited_variables(run: xr.Dataset, roles: Container[Any] | None = None) -> list[str]:
    """Name the variables whose numbers were edited while they keep the unit of the original.

    xarray keeps attributes through arithmetic: ``run.assign(y=run.y / 1000)`` calls kilometres metres. Rows and labelled
    elements that are left out or stand in another order are no edit, and neither is a value with a unit of its own. Dask
    arrays are not computed, and of a record without its origin nothing is known: neither is named.

    Parameters
    ----------
    run : xarray.Dataset
    roles : container of str, optional
        The roles of the variables that are compared; by default all.
    """
    run = as_recorded(run)
    origin = run.attrs.get(schema.ORIGIN)
    if not isinstance(origin, Origin):
        return []
    open_original = cache(
        lambda: _original_record(origin)
    )  # an archive is opened once, and only where values have to be compared
    compared = {
        str(name): variable
        for name, variable in run.variables.items()
        if name in origin.parts and (roles is None or variable.attrs.get("role") in roles)
    }
    return [
        name
        for name, compared_variable in compared.items()
        if _is_edited(origin.parts[name], compared_variable, run, open_original)
    ]


def _is_edited(part: OriginalVariable, now: xr.Variable, run: xr.Dataset, open_original: Source) -> bool:
    in_memory = isinstance(now._data, np.ndarray)  # noqa: SLF001 - `.data` would read what is not read, and so not edited
    unit = now.attrs.get("units")
    if not in_memory or now.dtype.kind != "f" or unit is None or unit != part.attributes.get("units"):
        return False
    if {*now.dims} != {*part.dims}:  # a number of its own, like a mean
        return False
    if now.dims != part.dims:
        now = now.transpose(*part.dims)
    if now.shape == part.shape and _is_unchanged(part, now):
        return False
    if _is_array_of(part, now):  # opened to writing: what was marched is no longer known
        return True
    original_run = open_original()
    if original_run is None or not now.dims:
        return now.shape == part.shape
    original_indices: dict[Any, NDArray[np.int64]] = {
        dim: indices for dim in now.dims if (indices := _original_indices_of(str(dim), run, original_run)) is not None
    }
    then = original_run.variables[part.name].isel(original_indices)
    if then.shape[1:] != now.shape[1:]:
        return False  # elements were left out, which `check_cut` refuses
    mine, theirs = _rows_as_words([now]), _rows_as_words([then])
    if mine.dtype != theirs.dtype or any((indices < 0).any() for indices in original_indices.values()):
        return True
    if now.dims[0] in original_indices:
        return bool((mine != theirs).any())
    # nothing says which rows these are: each has to be one of the run's
    return not {*mine.tolist()} <= {*theirs.tolist()}


def _original_indices_of(dim: str, run: xr.Dataset, original: xr.Dataset) -> NDArray[np.int64] | None:
    """Return the indices of a record's rows or elements in the run, by number or label; None without these."""
    name = schema.STEP_NUMBER.name if dim == schema.STEPS else schema.label_of(dim)
    if name not in run.variables or name not in original.variables:
        return None
    theirs, mine = (np.atleast_1d(dataset.variables[name].values).tolist() for dataset in (original, run))
    numbers = {label: number for number, label in enumerate(theirs)}
    return np.array([numbers.get(label, -1) for label in mine], np.int64)


def without_stale_units(run: xr.Dataset) -> xr.Dataset:
    """Return a record whose edited variables have an unknown unit instead of the unit that xarray left on them."""
    changed = {name: run.variables[name].copy(deep=False) for name in edited_variables(run) if name in run.variables}
    for variable in changed.values():
        variable.attrs["units"] = UNKNOWN_UNIT
    return with_variables(run, changed)


def check_states(run: xr.Dataset) -> None:
    """Refuse a run whose motion was edited: states between its rows would follow neither its model nor the edit.

    Raises
    ------
    InputError
        Naming the variables.
    """
    if edited := edited_variables(run, ("time", *schema.KINEMATIC)):
        raise InputError(
            f"{', '.join(edited)}: edited since the run was computed, so that states between rows would follow neither"
            " the model nor the edit; ask the run as it was and change what it answers, or draw the edit by"
            f' run.{edited[0]}.plot(x="time")'
        )


def check_cut(run: xr.Dataset) -> None:
    """Refuse a record whose variables have fewer elements than they were marched with.

    Raises
    ------
    InputError
        Naming the dimension of the model that was cut.
    """
    run = as_recorded(run)
    origin = run.attrs.get(schema.ORIGIN)
    parts = origin.parts if isinstance(origin, Origin) else {}
    original_dims = {name: part.dims for name, part in parts.items() if name in run.variables}
    check_elements(run, {dim for name, dims in original_dims.items() for dim in {*dims} - {*run.variables[name].dims}})


def _selection_words(
    fewer: Mapping[str, list[str]], left_out: list[str], run: xr.Dataset, origin: Origin
) -> Iterator[str]:
    for dim, names in fewer.items():
        yield f"{run.sizes[dim]} of {origin.parts[names[0]].shape[0]} rows of '{dim}'"
    if left_out:
        further_names = f" and {len(left_out) - MOST_NAMED} more" if len(left_out) > MOST_NAMED else ""
        yield f"without {', '.join(left_out[:MOST_NAMED])}{further_names}"


def _attribute_faults(whose: str, then: Mapping[str, Any], now: Mapping[Any, Any]) -> Iterator[str]:
    original_attributes, current_attributes = plain(then), plain(now)
    for name in {**original_attributes, **current_attributes}:
        if name in OUTSIDE or repr(original_attributes.get(name)) == repr(
            current_attributes.get(name)
        ):  # repr: a nan is the same nan
            continue
        if name not in current_attributes:
            yield f"attribute '{name}'{whose} is gone"
        elif name not in original_attributes:
            yield f"attribute '{name}'{whose} is {_short_repr(current_attributes[name])}, and the run has none"
        else:
            yield f"attribute '{name}'{whose} is {_short_repr(current_attributes[name])}, in the run {_short_repr(original_attributes[name])}"


def _is_array_of(part: OriginalVariable, now: xr.Variable) -> bool:
    return part.variable is not None and now.data is part.variable.data


def _is_unchanged(part: OriginalVariable, now: xr.Variable) -> bool:
    """Whether a variable has the marched or read values: its own array, or an array of equal digest."""
    if _is_array_of(part, now):
        return not (isinstance(now.data, np.ndarray) and now.data.flags.writeable)  # read-only since it was marched
    return (part.unchanged is not None and part.unchanged(now)) or variable_digest(part.name, now) == part.digest


def _value_faults(part: OriginalVariable, now: xr.Variable, origin: Origin) -> Iterator[str]:
    """Compare a variable with its original of equal shape, and name the first value that differs."""
    if _is_unchanged(part, now):
        return
    if _is_array_of(part, now):
        yield f"variable '{part.name}' was opened to writing, and what was computed is no longer known"
        return
    original = _original_record(origin)
    then = None if original is None else original.variables.get(part.name)
    if then is None:
        yield f"variable '{part.name}' differs from its digest in the run"
    elif then.dtype.kind != now.dtype.kind or (then.dtype.itemsize != now.dtype.itemsize and now.dims):
        yield f"variable '{part.name}' is of the type {now.dtype}, in the run {then.dtype}"
    elif not now.dims:
        yield f"variable '{part.name}' is {_short_repr(now.values)}, in the run {_short_repr(then.values)}"
    else:
        yield f"variable '{part.name}' is {_first_difference(now, then)}"


def _first_difference(now: xr.Variable, then: xr.Variable) -> str:
    """Describe the first number that differs, a slab at a time."""
    start = 0
    for mine, theirs in zip(slabs(now), slabs(then), strict=True):
        differs = (
            (mine != theirs).reshape(len(mine), -1)  # texts, which may be of other lengths
            if mine.dtype.kind in "UOT"
            else _bytes_of_rows(mine) != _bytes_of_rows(theirs)
        )
        if differs.any():
            row, byte = (int(number) for number in np.unravel_index(int(differs.argmax()), differs.shape))
            size = differs.shape[1] // math.prod(mine.shape[1:])
            element_index = np.unravel_index(byte // size, mine.shape[1:])
            where = "".join(f", {dim} {number}" for dim, number in zip(now.dims[1:], element_index, strict=True))
            values = [_short_repr(part[(row, *element_index)]) for part in (mine, theirs)]
            return f"{values[0]} in row {start + row}{where}, in the run {values[1]}"
        start += len(mine)
    return f"of the type {now.dtype}, in the run {then.dtype}"


def _row_faults(dim: str, names: list[str], run: xr.Dataset, origin: Origin) -> Iterator[str]:
    """Search each row of a selection among the rows of its run, in their order."""
    original = _original_record(origin)
    if original is None:
        yield (
            f"rows of '{dim}' are left out, and the run they were taken from is no longer at hand: save the selection"
            " in the process that made it, or next to the archive it was read from"
        )
        return
    rows = rows_within(names, run, original)
    if isinstance(rows, int):
        yield (
            f"row {rows} of '{dim}', with {names[0]} = {_short_repr(run[names[0]].values[rows])}, is none of the run's rows"
        )


def selected_like(partial_run: xr.Dataset, full_run: xr.Dataset) -> xr.Dataset:
    """Select from a run the values of a selection; a dimension along which no match exists stays complete."""
    if not is_selection(partial_run.attrs):
        return full_run
    if schema.is_former(partial_run.attrs):  # it names rows by their places in the whole run
        full_run = by_places(full_run, np.asarray(full_run.variables[schema.STEP_NUMBER.name].values))
    names = [str(name) for name in partial_run.variables if name in full_run.variables]
    selection = full_run.drop_vars([name for name in full_run.variables if name not in names])
    for dim in selection.dims:
        names_along_dim = [name for name in names if selection.variables[name].dims[:1] == (dim,)]
        if selection.sizes[dim] != partial_run.sizes[dim]:
            rows = rows_within(names_along_dim, partial_run, full_run)
            selection = selection if isinstance(rows, int) else selection.isel({dim: rows})
    attributes = {
        name: partial_run.attrs[name]
        for name in (schema.SELECTION, schema.SELECTION_OF, schema.LEFT_OUT_ATOL)
        if name in partial_run.attrs
    }
    same = all(
        partial_run.attrs.get(name) == full_run.attrs.get(name)
        for name in ("xdynamics_version", "schema_version", schema.SCHEMA_OF_LAW, "math_functions")
    )
    if same:  # another text of the law has another digest
        attributes[schema.SELECTION_OF] = content_digest(full_run)
    return selection.assign_attrs(attributes)


def rows_within(names: list[str], run: xr.Dataset, full_run: xr.Dataset) -> NDArray[np.int64] | int:
    """Return the positions of a selection's rows in the run, in order; if a row is missing, return its number."""
    mine, theirs = (_rows_as_words([dataset.variables[name] for name in names]) for dataset in (run, full_run))
    if mine.dtype != theirs.dtype:
        return 0
    row_positions, next_row = np.empty(len(mine), np.int64), 0
    remaining = theirs.tolist()
    for row, row_word in enumerate(mine.tolist()):
        try:
            # the first match is enough: if the rows are a subsequence at all,
            # the earliest choice leaves most for the rest
            next_row = remaining.index(row_word, next_row)
        except ValueError:
            return row
        row_positions[row] = next_row
        next_row += 1
    return row_positions


def _rows_as_words(variables: list[xr.Variable]) -> NDArray[Any]:
    """Return every row of some variables as one word of bytes, compared without tolerance and without nan."""
    row_bytes = np.ascontiguousarray(np.hstack([_bytes_of_rows(np.asarray(variable.values)) for variable in variables]))
    # as bytes a nan equals itself, and -0.0 differs from 0.0
    words: NDArray[Any] = row_bytes.view(np.dtype((np.void, row_bytes.shape[1]))).ravel()
    return words


def _bytes_of_rows(values: NDArray[Any]) -> NDArray[np.uint8]:
    """Return the bytes of every row."""
    rows = np.ascontiguousarray(utf8_letters(values) if values.dtype.kind in "UOT" else values)
    # by rows and items, since reshape cannot infer a size where there are no rows
    return rows.view(np.uint8).reshape(len(rows), rows.dtype.itemsize * math.prod(rows.shape[1:]))


def _short_repr(value: Any) -> str:
    text = repr(value.tolist() if hasattr(value, "tolist") else value)
    return text if len(text) <= 60 else text[:57] + "…"

"""Runs into netCDF files, each written complete or not at all.

A file is written in three phases: variables are defined, rows are appended, and the file is sealed.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from math import prod
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import record, schema
from xdynamics.archive.extents import append_extents
from xdynamics.archive.file_structure import variables_to_compress
from xdynamics.archive.folder_store import check_suffix, check_zarr_target, made_folder, store_of
from xdynamics.archive.integrity import Standing, check_cut, record_standing
from xdynamics.archive.integrity_checks import compare_file
from xdynamics.archive.netcdf_library import opened_file, with_library_lock
from xdynamics.archive.sandboxed_reading import examine_sandboxed, know, see
from xdynamics.archive.seals import (
    CHUNKS,
    OTHER_CHUNK,
    Seal,
    Tail,
    digest_lines,
    letters_of,
    root_digest,
    seal_file,
    stored_slabs,
    tail_of,
    utf8_letters,
    volatile_digest,
)
from xdynamics.archive.shared_handles import identity_of
from xdynamics.archive.store import (
    GIVEN,
    ZARR,
    FileBatch,
    Given,
    NewFile,
    OpenFile,
    Place,
    check_file_name,
    location_of,
    resolve_links,
)
from xdynamics.archive.target import LONGEST, TemporaryFile, sweep_temporary_files
from xdynamics.archive.text_encoding import TextEncoding, encoded_texts
from xdynamics.faults import InputError, PartialRunWarning, numbered_lines, warn
from xdynamics.march.outcomes import GOOD
from xdynamics.model.file_access import parse_model_text
from xdynamics.model.parts import Authorship
from xdynamics.record.flag_words import own_attributes
from xdynamics.record.folding import unlabelled
from xdynamics.record.schemas import in_words_of_today, is_evidence, left_out_atols, with_article
from xdynamics.record.unfolding import as_recorded, whole_of

if TYPE_CHECKING:
    import netCDF4
    import xarray as xr

Array = NDArray[Any]

COUNTED = (schema.STEP_NUMBER.name, schema.CLOSED_TIME)  # that compress to nearly nothing, and always are
BACK = 1 << 19  # values that are read back at once


class Writer:
    """Fills one netCDF file: variables are defined, appended to, then sealed.

    Attributes
    ----------
    path : Path, or name of an object
        The name that the file takes in the end.
    numbered : bool
        Whether outcomes and digests are kept as numbers, as of a sweep's many members; other readers see the numbers.
    complete : bool
        Whether the run ended well; known when it is finished.
    digest : str
        The content digest; known when it is finished.
    seal : str
        The digest of the file's bytes; known when it has its name.
    """

    path: Place
    numbered = False
    complete: bool
    digest: str
    seal: str

    def __init__(self, file: netCDF4.Dataset) -> None:
        self._file = file
        self._packed: set[str] = set()
        self._seals: dict[str, Seal] = {}
        self._attributes: dict[str, dict[str, Any]] = {}
        self._filled: dict[str, int] = {}

    def pack(self, widths: Mapping[str, tuple[str, int]]) -> None:
        """Compress variables that are going to be defined, as far as readers accept; see `variables_to_compress`."""
        self._packed = variables_to_compress(widths)

    @with_library_lock
    def define(
        self,
        name: str,
        dims: tuple[str, ...],
        dtype: np.dtype[Any],
        attributes: Mapping[str, Any],
        sizes: Mapping[str, int],
    ) -> None:
        """Create a variable; a dimension without a size may grow."""
        for dim in dims:
            if dim not in self._file.dimensions:
                self._file.createDimension(dim, 2 if dim == schema.BOUNDS else sizes.get(dim))
        seal = Seal(name, dims, dtype)
        self._seals[name] = seal
        self._attributes[name] = own_attributes(attributes)
        self._filled[name] = 0
        if seal.is_text:
            return  # created when its length is known
        chunks = _chunk_shape(dims, sizes) if dims else None
        # further levels of zlib take more time, a tenth and up, for a hundredth of the bytes
        variable = self._file.createVariable(
            name,
            seal.dtype,
            dims,
            chunksizes=chunks,
            fill_value=False,
            endian="little",
            zlib=name in self._packed or name in COUNTED,
            complevel=1,
            shuffle=name in self._packed or name in COUNTED,
        )
        variable.set_auto_maskandscale(False)
        if chunks:
            # room for the one chunk that is being filled: the library's 16 MiB each would not be bounded memory
            variable.set_var_chunk_cache(size=2 * prod(chunks) * seal.dtype.itemsize)

    def describe(self, name: str, more: Mapping[str, Any]) -> None:
        """Add attributes of a variable that were not known when it was defined."""
        self._attributes[name] |= own_attributes(more)

    @property
    def filled(self) -> dict[str, int]:
        """How many values along its first dimension every variable was given."""
        return dict(self._filled)

    def digests(self) -> dict[str, str]:
        """Return the digest of every variable, as far as it is hashed."""
        return {name: seal.hexdigest() for name, seal in self._seals.items()}

    @with_library_lock
    def shapes_since(self, earlier_counts: Mapping[str, int]) -> list[tuple[str, Any, tuple[int, ...]]]:
        """Return name, type and shape of the values appended to variables since `earlier_counts`."""
        return [
            (name, self._seals[name].dtype, (n - earlier_counts.get(name, 0), *self._file.variables[name].shape[1:]))
            for name, n in self._filled.items()
        ]

    def since(self, earlier_counts: Mapping[str, int]) -> Iterator[Array]:
        """Read back the values appended to variables since `earlier_counts`, some megabytes at a time."""
        for name, n in self._filled.items():
            rows = max(1, BACK // prod(self._file.variables[name].shape[1:]))
            for start in range(earlier_counts.get(name, 0), n, rows):
                yield self._read_back(name, start, min(start + rows, n))

    @with_library_lock
    def _read_back(self, name: str, start: int, stop: int) -> Array:
        return np.asarray(self._file.variables[name][start:stop])

    def append(self, name: str, values: Array) -> None:
        """Write and hash the next values of a variable."""
        values = utf8_letters(values) if self._seals[name].is_text else values
        self.write([(name, values)])
        self.hash([(name, values)])

    def write(self, parts: list[tuple[str, Array]]) -> None:
        """Write the next values of variables."""
        for name, values in parts:
            self._write_one(name, values)

    @with_library_lock
    def _write_one(self, name: str, values: Array) -> None:
        if self._seals[name].is_text:
            self._write_text(name, utf8_letters(values))
        elif values.ndim == 0:
            self._file.variables[name][...] = values
        elif values.shape[0]:
            start = self._filled[name]
            self._file.variables[name][start : start + values.shape[0]] = values
            self._filled[name] = start + values.shape[0]

    def _write_text(self, name: str, letters: Array) -> None:
        """Write texts as numbers or characters: variable-length strings crash the library when a file is open twice."""
        encoded = encoded_texts(self._attributes[name].get("role"), letters) if self.numbered else None
        if encoded is not None:
            self._write_numbers(name, *encoded)
            return
        dim = letters_of(name)
        self._file.createDimension(dim, letters.shape[-1])
        variable = self._file.createVariable(name, "S1", (*self._seals[name].dims, dim), fill_value=False)
        variable.set_auto_chartostring(False)
        variable[...] = letters
        variable.setncattr("_Encoding", "utf-8")

    def _write_numbers(self, name: str, encoding: TextEncoding, values: Array) -> None:
        further = encoding.dims(name)
        for dim, size in further.items():
            self._file.createDimension(dim, size)
        dims = (*self._seals[name].dims, *further)
        variable = self._file.createVariable(name, values.dtype, dims, fill_value=False)
        variable.set_auto_maskandscale(False)
        variable[...] = values
        variable.setncatts(encoding.attributes)

    def hash(self, parts: list[tuple[str, Array]]) -> None:
        """Add the next values of variables to their digests."""
        for name, values in parts:
            self._seals[name].update(values)

    @with_library_lock
    def finish(self, attributes: Mapping[str, Any]) -> None:
        """Write every attribute and digest; remember the content digest, and whether the run ended well."""
        self.complete = is_evidence(attributes) or attributes.get("run_outcome") in GOOD
        written_attributes = {
            key: value
            for key, value in attributes.items()
            if key not in (schema.ROOT_DIGEST, schema.VOLATILE_DIGEST, schema.DIGESTS)
        }
        written_attributes[schema.SEALED] = schema.SEAL_WORDS
        written_attributes.pop(schema.COMPRESSION, None)
        if self._packed:
            written_attributes[schema.COMPRESSION] = schema.COMPRESSION_WORDS
        digests, former = self.digests(), schema.is_former(attributes)
        about = {name: (seal.dims, self._attributes[name].get("role")) for name, seal in self._seals.items()}
        for name, variable_attributes in self._attributes.items():
            coordinates = schema.coordinates_of(name, about, former=former)
            kept_as = {"coordinates": coordinates} if coordinates else {}
            self._file.variables[name].setncatts(
                variable_attributes | kept_as | ({schema.DIGEST: digests[name]} if former else {})
            )
        if not former:
            written_attributes[schema.DIGESTS] = digest_lines(digests)
        self._file.setncatts(written_attributes)
        self.digest = root_digest(digests, self._attributes, written_attributes)
        self._file.setncattr(schema.ROOT_DIGEST, self.digest)
        # the last one: `integrity_checks` takes attributes behind it for notes of other programs
        self._file.setncattr(schema.VOLATILE_DIGEST, volatile_digest(digests, self._attributes, written_attributes))


def _chunk_shape(dims: tuple[str, ...], sizes: Mapping[str, int]) -> list[int]:
    """Return the form of a variable's chunks: of rows with many elements as many as a megabyte holds, or a part of one."""
    chunks = [min(chunk_limit := CHUNKS.get(dim, OTHER_CHUNK), max(1, sizes.get(dim, chunk_limit))) for dim in dims]
    room = CHUNKS.get(dims[0], OTHER_CHUNK)
    for k in reversed(range(1, len(dims))):
        if (size := sizes.get(dims[k], 0)) > chunks[k]:
            parts = -(-size // max(chunks[k], room // prod(chunks[k + 1 :])))
            chunks[k] = -(-size // parts)  # equal parts: what is left of the last one would be written too
    if dims[0] in CHUNKS and (inner := prod(chunks[1:])) > 2:  # elements of a model's dimensions
        chunks[0] = min(chunks[0], max(1, room // inner))
    return chunks


_PARTIAL = ".partial"
MOST_AT_ONCE = 200  # files that reach the disk together: each holds a descriptor until then
READ_BACK = (
    64_000_000  # bytes up to which a new file is read again in full before it takes its name; a larger one is opened
)


def save(
    run: xr.Dataset,
    path: Given | IO[bytes],
    *,
    derived: str | None = None,
    compress: bool | None = None,
    creator: str | None = None,
    institution: str | None = None,
    license: str | None = None,  # noqa: A002 - ACDD's own word, as the next
    id: str | None = None,  # noqa: A002
    references: str | None = None,
    comment: str | None = None,
) -> Place:
    """Write a run to a netCDF4 file.

    The file is written under a temporary name in the same folder, closed, opened again and checked, and takes its
    name last: under the final name there is the old file or the new one, never something between.

    Parameters
    ----------
    run : xarray.Dataset
        A run record; checked against the schema first, and compared with what was marched or opened. A part of it
        (`isel` or `sel` of rows, `drop_vars`), nothing else changed, is saved as a selection of the run.
    path : str, Path or file object
        A file, an address like ``"s3://bucket/run.nc"`` (also ``gs://``, ``memory://``, ``file://``), which is written on
        this machine and uploaded whole, or a binary file open for writing. What was not there is put only if it still is
        not, and what was there is replaced only if it is still the same. A name that ends in ``.zarr`` is that of a Zarr
        store (format 3, written by xarray), with the same content digest.
    derived : str, optional
        How the record was made from a run, like ``"x scaled by 1.1"``: it is saved as derived data, whose attributes
        say so and name the run, and which `verify` and `reproduce` do not take for a run.
    compress : bool, optional
        Whether to compress it, without loss, by zlib with shuffled bytes; by default as the run was marched, or read. Its
        digests are the same. For 10**7 rows of an oscillator, 83 bytes each become 45; writing takes 2.5 times the
        processor time (14 s for 5.6), reading a column 1.7 times.
    creator, institution, license, id, references, comment : str, optional
        Who stands for the data and under which terms, as attributes of ACDD 1.3 (`creator` as ``creator_name``). They are
        notes: no digest of the content changes by them. A model file's `[about]` says them for all its runs.

    Returns
    -------
    Path, or name of an object
        Where it is. A run that ended badly does not replace an archive of one that ended well: it is written beside it,
        as ``run.partial.nc`` beside ``run.nc``, with a warning.

    Raises
    ------
    InputError
        If the Dataset is no run record, or was edited and is not said to be derived; names what differs. If no file can be
        written there; see `check_target`.
    ArchiveError
        If the file cannot be written; the final name is untouched.
    """
    if not isinstance(compress, bool | None):
        raise InputError(f"compress is {compress!r}, needs true or false")
    location = location_of(path)
    notes = {
        "creator": creator,
        "institution": institution,
        "license": license,
        "id": id,
        "references": references,
        "comment": comment,
    }
    return _write_run(_check_run(_with_authorship(run, notes), location, derived), location, compress=compress)


def save_many(
    runs: Iterable[xr.Dataset] | Mapping[str, xr.Dataset],
    paths: Iterable[Given] | Given | None = None,
    *,
    compress: bool | None = None,
) -> list[Place]:
    """Write runs to netCDF4 files, which reach the disk together: faster than one by one if the disk is slow to answer.

    All are written beside their names, one synchronisation of the file system follows, and all are renamed,
    `MOST_AT_ONCE` at a time. Each name has its old file or the new one, whole, at any moment. Objects of a store are sent
    several at once, and take their names when all are there: if one cannot be sent, none has changed.

    Parameters
    ----------
    runs : mapping of str to xarray.Dataset, or iterable of xarray.Dataset
        By name, or in the order of the paths; checked as `save` does, all of them before anything is written.
    paths : iterable of str or Path, or a folder
        A file for each run; or a folder, made if it does not exist, or ``"s3://bucket/folder"``, for files ``NAME.nc`` for runs by name, and
        ``000000.nc``, ``000001.nc``, … for others.
    compress : bool, optional
        As in `save`.

    Returns
    -------
    list of Path
        Where they are; see `save` for runs that ended badly.

    Raises
    ------
    InputError
        If a Dataset is no run record or was edited, two have one name, or names and runs are not equally many.
    ArchiveError
        If a file cannot be written; of those that were to reach the disk with it, none has changed. Of objects that were
        all sent it says how many have their names, should the store fail between the first name and the last.
    """
    if not isinstance(compress, bool | None):
        raise InputError(f"compress is {compress!r}, needs true or false")
    if hasattr(runs, "variables"):
        raise InputError("one run was given; save writes it, and save_many a list of runs, or runs by name")
    if isinstance(runs, str) or not isinstance(runs, Iterable):
        raise InputError(f"{str(runs)[:60]!r} is neither a list of runs nor runs by name")
    runs_by_name: dict[Any, xr.Dataset] = dict(runs) if isinstance(runs, Mapping) else dict(enumerate(runs))
    places = _target_locations(runs_by_name, paths)
    ready = [(_check_run(run, path, None), path) for run, path in zip(runs_by_name.values(), places, strict=True)]
    locations: list[Place] = []
    for first in range(0, len(ready), MOST_AT_ONCE):
        part = ready[first : first + MOST_AT_ONCE]
        with ExitStack() as stack:
            batches = {
                store: stack.enter_context(store.batch([path for _, path in part if store_of(path) is store]))
                for store in dict.fromkeys(store_of(path) for _, path in part)
            }
            locations += [_write_run(run, path, compress=compress, batch=batches[store_of(path)]) for run, path in part]
            for batch in batches.values():
                batch.take_names()
    return locations


def _target_locations(runs_by_name: Mapping[Any, xr.Dataset], paths: Any) -> list[Place]:
    """Return the file of every run."""
    files: list[Place]
    if isinstance(paths, GIVEN):
        for name in filter(lambda name: isinstance(name, str), runs_by_name):
            check_file_name(name)
        folder = made_folder(location_of(paths))
        files = [folder / (f"{name}.nc" if isinstance(name, str) else f"{name:06d}.nc") for name in runs_by_name]
    elif paths is None:
        raise InputError("save_many needs a file for each run, or a folder")
    else:
        files = [location_of(entry) for entry in paths]
    if len(files) != len(runs_by_name):
        raise InputError(f"there are {len(runs_by_name)} runs and {len(files)} paths; give one for each, or a folder")
    for store in dict.fromkeys(map(store_of, files)):
        store.check_each([path for path in files if store_of(path) is store and path.suffix != ZARR])
    resolved = [resolve_links(path) for path in files]
    duplicates = (
        [path for k, path in enumerate(resolved) if path in resolved[:k]] if len({*resolved}) < len(resolved) else []
    )
    if duplicates:
        raise InputError(f"two runs are to be written to '{duplicates[0]}'; give each a name of its own")
    return files


def _with_authorship(run: xr.Dataset, notes: Mapping[str, Any]) -> xr.Dataset:
    """Return a record with notes of who stands for it."""
    texts = {name: text for name, text in notes.items() if text is not None}
    for name, text in texts.items():
        if not isinstance(text, str) or not text.strip():
            raise InputError(f"{name} is {text!r}, needs a text")
    if not texts:
        return run
    signed_run = run.copy(deep=False)
    signed_run.attrs |= Authorship(**texts).attributes
    return signed_run


def _check_run(run: xr.Dataset, location: Place, derived: str | None) -> xr.Dataset:
    run = _declare_standing(run, derived)
    record.check(run, values=derived is not None)  # otherwise they were checked before
    store_of(location).check_no_table(location, _table_texts(run))
    return run


def _write_run(run: xr.Dataset, path: Place, *, compress: bool | None, batch: FileBatch | None = None) -> Place:
    with new_file(path, batch) as writer:
        writer.numbered = str(run.attrs.get(schema.EVIDENCE, "")).startswith(schema.SWEEP)
        if schema.COMPRESSION in run.attrs if compress is None else compress:
            writer.pack(
                {
                    str(name): (str(variable.dims[0]), variable.dtype.itemsize * prod(variable.shape[1:]))
                    for name, variable in run.variables.items()
                    if variable.dims and variable.dtype.kind in "fiu"
                }
            )
        # a variable named as a dimension that it is not along must follow it, or the library cannot write the file
        for name, variable in sorted(
            run.variables.items(), key=lambda item: item[0] in run.dims and item[0] not in item[1].dims
        ):
            sizes = {str(dim): n for dim, n in zip(variable.dims, variable.shape, strict=True) if n}
            writer.define(str(name), tuple(map(str, variable.dims)), variable.dtype, dict(variable.attrs), sizes)
        for name, variable in run.variables.items():
            for slab in stored_slabs(variable):
                writer.append(str(name), slab)
        writer.finish(dict(run.attrs))
    return writer.path


def _declare_standing(run: xr.Dataset, derived: str | None) -> xr.Dataset:
    """Return a record with attributes that say whether it is a run, a selection of one or derived data.

    Raises
    ------
    InputError
        If it was edited, and `derived` does not say how.
    """
    if not isinstance(getattr(run, "attrs", None), Mapping) or not hasattr(run, "variables"):
        raise InputError(f"a run record is to be saved, got {str(run)[:40]!r}")
    if derived is None and schema.EVIDENCE not in run.attrs:
        record.check_elements(run)  # first: its attributes of elements are as many as there were
    received_run, run = run, as_recorded(run)
    if (
        schema.AT in run.dims
        and schema.STEPS not in run.dims
        and schema.EVIDENCE not in run.attrs
        and "solver_interpolation" in run.attrs
    ):
        raise InputError(
            "these are states at times that were asked for, and no run: path='run.nc' beside times, or t_eval, archives"
            " the run itself; states.to_netcdf('states.nc') keeps these alone, without digests"
        )
    if derived is None:
        record.check(run, whole=False)
        check_cut(run)
    record_state = record_standing(received_run)
    attributes = {str(name): value for name, value in run.attrs.items() if name != schema.ORIGIN}
    attributes = _attributes_by_standing(attributes, record_state, derived)
    is_part = schema.EVIDENCE not in attributes and (derived is not None or bool(record_state.selected))
    if is_part and schema.is_former(attributes):  # numbers of rows and what names them go with a selection
        run, attributes = unlabelled(whole_of(received_run)), in_words_of_today(attributes)
    declared = run.copy(deep=False)
    declared.attrs = attributes
    return declared


def _attributes_by_standing(attributes: dict[str, Any], result: Standing, derived: str | None) -> dict[str, Any]:
    """Return the attributes that state the kind of a record, by its standing.

    Raises
    ------
    InputError
        If it was edited, and `derived` does not say how.
    """
    if derived is not None:
        if not isinstance(derived, str) or not derived.strip():
            raise InputError(
                f"derived is {derived!r}, needs a text that says how the data were made, like 'x scaled by 1.1'"
            )
        earlier_words = f"{attributes[schema.DERIVED]}; " if schema.DERIVED in attributes else ""
        attributes |= {
            schema.DERIVED: earlier_words + derived.strip(),
            schema.DERIVED_FROM: attributes.get(schema.DERIVED_FROM, result.source_digest or "unknown"),
        }
    elif is_evidence(attributes) and (result.faults or result.selected):
        kind = str(attributes[schema.EVIDENCE])
        several = with_article(kind) == kind
        this, it, them = ("these are", "they were", "them") if several else ("this is", "it was", "it")
        raise InputError(
            f"{this} not the {kind} as {it} made; save {them} before an edit, or as data of {'their' if several else 'its'} own"
            f" with derived='how it was made':{numbered_lines(result.faults or (result.selected,))}",
            result.faults or (result.selected,),
        )
    elif result.faults:
        raise InputError(
            "this is not the record that was computed, and is not saved as a run; save it before it is edited, or as"
            f" data of its own with derived='how it was made':{numbered_lines(result.faults)}",
            result.faults,
        )
    elif result.selected:
        earlier_words = f"{attributes[schema.SELECTION]}; of these " if schema.SELECTION in attributes else ""
        left_out = {**left_out_atols(attributes), **result.left_out_atol}
        attributes |= {
            schema.SELECTION: earlier_words + result.selected,
            schema.SELECTION_OF: attributes.get(schema.SELECTION_OF, result.source_digest),
        }
        attributes |= {schema.LEFT_OUT_ATOL: json.dumps(left_out)} if left_out else {}
    return attributes


@contextmanager
def new_file(
    path: Place, batch: FileBatch | None = None, *, keeps: bool = False, read_back: bool = True
) -> Iterator[Writer]:
    """Write a file under a temporary name, check it, and give it its name, in the end `Writer.path`.

    A run that ended badly does not take the name of an archive of one that ended well, but one beside it. With `keeps`, a
    file that its store does not take stays on this machine. Without `read_back` a file is opened again, but its values are
    not read: for one of many that are written alike.
    """
    check_suffix(path)
    with _taking_name(path, batch) as new:
        first = new.name
        with opened_file(new.part, "w") as file:
            # every value is written, so filling the file before would write it twice
            with_library_lock(file.set_fill_off)()
            writer = Writer(file)
            writer.path = path
            yield writer
        writer.seal = _seal_new_file(new.part, read_back=read_back)
        new.keeps = keeps
        if not writer.complete:
            new.name = partial_run_location(new.name)
    if new.name != first:
        writer.path = new.name
        message = f"'{path}' holds a run that ended well and stays; the one that did not is in '{new.name}'"
        warn(message, PartialRunWarning)


@contextmanager
def _taking_name(path: Place, batch: FileBatch | None) -> Iterator[NewFile[Any]]:
    """Lend a temporary file, which takes its name when the `with` block is done, or becomes the Zarr store of that name."""
    if path.suffix != ZARR:
        with store_of(path).taking_name(path, batch) as new:
            yield new
        return
    from xdynamics.archive.zarr_archive import copy_archive, replacement

    check_zarr_target(path)
    written_at = store_of(path).written_at(path)
    sweep_temporary_files(written_at.parent)
    with TemporaryFile.create_beside(written_at, 0o600) as part:
        new = NewFile(part.path, path)
        yield new
        with replacement(new.name) as folder:
            copy_archive(new.part, folder)


def partial_run_location(path: Place) -> Place:
    """Return a name beside that of an archive whose run ended well; the name itself if there is none, or of an open file."""
    while not isinstance(path, OpenFile) and _stored_outcome(path) in GOOD:
        room = LONGEST - len(os.fsencode(path.suffix)) - len(_PARTIAL)
        path = path.with_name(os.fsdecode(os.fsencode(path.stem)[:room]) + _PARTIAL + path.suffix)
    return path


def _stored_outcome(path: Place) -> str:
    """Return how the run of an intact archive ended; empty if there is none."""
    store = store_of(path)
    if store.kind(path) is None:
        local_file = store.local_file(path)
        return examine_sandboxed(local_file.path, tail_of(local_file.path)).outcome
    if path.suffix == ZARR:
        from xdynamics.archive.zarr_archive import open_store

        with suppress(InputError), open_store(path) as run:
            return str(run.attrs.get("run_outcome", ""))
    return ""


def _seal_new_file(part: Path, *, read_back: bool) -> str:
    """Seal a new file, read it back, and return the seal."""
    append_extents(part)
    digest = seal_file(part)
    if read_back and part.stat().st_size <= READ_BACK:
        if faults := compare_file(part, Tail(digest)).faults:
            raise RuntimeError(f"what was written reads otherwise: {'; '.join(faults)}")
    else:
        with opened_file(part):
            pass
    know(digest)
    see(identity_of(part))
    return digest


def _table_texts(run: xr.Dataset) -> list[str]:
    """Return the texts of the measured tables of a run's model."""
    if "model_toml" not in run.variables:
        return []
    try:
        drives = parse_model_text(run["model_toml"].values.item(), recorded=True).get("drives", {})
        return [str(drive["csv"]) for drive in drives.values() if "csv" in drive]
    except (ValueError, RecursionError, AttributeError, TypeError):
        return []  # derived data, whose text is no model

"""Runs into files: written whole or not at all."""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from xdynamics import record
from xdynamics.archive.examination import compare
from xdynamics.archive.examiner import examined, know
from xdynamics.archive.leftovers import LONGEST
from xdynamics.archive.library import alone, opened
from xdynamics.archive.seals import Tail, seal_file, slabs, tail_of
from xdynamics.archive.standing import standing
from xdynamics.archive.target import check_no_table, taking_name
from xdynamics.archive.writer import Writer
from xdynamics.faults import InputError, PartialRunWarning, numbered, warn
from xdynamics.march.outcomes import GOOD
from xdynamics.record.kinds import is_evidence, left_out_atols
from xdynamics.schema import (
    COMPRESSION,
    DERIVED,
    DERIVED_FROM,
    EVIDENCE,
    LEFT_OUT_ATOL,
    ORIGIN,
    SELECTION,
    SELECTION_OF,
)

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[Any]

_PARTIAL = ".partial"
READ_BACK = 64_000_000  # bytes up to which a new file is read again in full before it takes its name


def save(run: xr.Dataset, path: str | Path, *, derived: str | None = None, compress: bool | None = None) -> Path:
    """Write a run to a netCDF4 file.

    The file is written under a temporary name in the same folder, closed, opened again and checked, and takes its
    name last: under the final name there is the old file or the new one, never something between.

    Parameters
    ----------
    run : xarray.Dataset
        A run record; checked against the schema first, and compared with what was marched or opened. A part of it
        (`isel` or `sel` of rows, `drop_vars`), nothing else changed, is saved as a selection of the run.
    path : str or Path
    derived : str, optional
        How the record was made from a run, like ``"x scaled by 1.1"``: it is saved as derived data, whose attributes
        say so and name the run, and which `verify` and `reproduce` take for no run.

    compress : bool, optional
        Whether to compress it, without loss, by zlib with shuffled bytes; by default as the run was marched, or read. Its
        digests are the same. COSTS

    Returns
    -------
    Path
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
    run = _declared(run, derived)
    record.check(run, values=derived is not None)  # without, they were looked at before
    check_no_table(Path(path), _tables(run))
    with new_file(Path(path)) as writer:
        if COMPRESSION in run.attrs if compress is None else compress:
            writer.pack({str(name): (str(one.dims[0]), one.dtype.itemsize * prod(one.shape[1:])) for name, one in run.variables.items() if one.dims and one.dtype.kind in "fiu"})  # fmt: skip
        # what bears the name of a dimension that it is not along comes behind that, or the library cannot write the file
        for name, variable in sorted(run.variables.items(), key=lambda one: one[0] in run.dims and one[0] not in one[1].dims):  # fmt: skip
            sizes = {str(dim): n for dim, n in zip(variable.dims, variable.shape, strict=True) if n}
            writer.define(str(name), tuple(map(str, variable.dims)), variable.dtype, dict(variable.attrs), sizes)
        for name, variable in run.variables.items():
            for part in slabs(variable):
                writer.append(str(name), part)
        writer.finish(dict(run.attrs))
    return writer.path


def _declared(run: xr.Dataset, derived: str | None) -> xr.Dataset:
    """Return a record with attributes that say whether it is a run, a selection of one or derived data.

    Raises
    ------
    InputError
        If it was edited, and `derived` does not say how.
    """
    if not isinstance(getattr(run, "attrs", None), Mapping) or not hasattr(run, "variables"):
        raise InputError(f"a run record is to be saved, got {str(run)[:40]!r}")
    if derived is None:
        record.check(run, whole=False)
    found = standing(run)
    said = {str(name): value for name, value in run.attrs.items() if name != ORIGIN}
    if derived is not None:
        if not isinstance(derived, str) or not derived.strip():
            raise InputError(
                f"derived is {derived!r}, needs a text that says how the data were made, like 'x scaled by 1.1'"
            )
        before = f"{said[DERIVED]}; " if DERIVED in said else ""
        said |= {DERIVED: before + derived.strip(), DERIVED_FROM: said.get(DERIVED_FROM, found.of or "unknown")}
    elif is_evidence(said) and (found.faults or found.selected):
        raise InputError(
            f"this is not the {said[EVIDENCE]} as it was made; save it before it is edited, or as data of its own with"
            f" derived='how it was made':{numbered(found.faults or (found.selected,))}",
            found.faults or (found.selected,),
        )
    elif found.faults:
        raise InputError(
            "this is not the record that was marched, and is not saved as a run; save it before it is edited, or as data"
            f" of its own with derived='how it was made':{numbered(found.faults)}",
            found.faults,
        )
    elif found.selected:
        before = f"{said[SELECTION]}; of these " if SELECTION in said else ""
        left_out = {**left_out_atols(said), **found.left_out_atol}
        said |= {SELECTION: before + found.selected, SELECTION_OF: said.get(SELECTION_OF, found.of)}
        said |= {LEFT_OUT_ATOL: json.dumps(left_out)} if left_out else {}
    declared = run.copy(deep=False)
    declared.attrs = said
    return declared


@contextmanager
def new_file(path: Path) -> Iterator[Writer]:
    """Write a file under a temporary name, check it, and give it its name; `Writer.path` says which in the end.

    A run that ended badly does not take the name of an archive of one that ended well, but one beside it.
    """
    with taking_name(path) as new:
        with opened(new.part, "w") as file:
            alone(file.set_fill_off)()
            writer = Writer(file)
            writer.path = path
            yield writer
        writer.seal = _finish(new.part)
        if not writer.complete:
            new.name = beside(new.name)
    if new.name != path.resolve():
        writer.path = new.name
        said = f"'{path}' holds a run that ended well and stays; the one that did not is in '{new.name}'"
        warn(said, PartialRunWarning)


def beside(path: Path) -> Path:
    """Return a name beside that of an archive whose run ended well; the name itself where there is none."""
    while path.is_file() and examined(path, tail_of(path)).outcome in GOOD:
        room = LONGEST - len(os.fsencode(path.suffix)) - len(_PARTIAL)
        path = path.with_name(os.fsdecode(os.fsencode(path.stem)[:room]) + _PARTIAL + path.suffix)
    return path


def _finish(part: Path) -> str:
    """Seal a new file, read it back, and return the seal."""
    digest = seal_file(part)
    if part.stat().st_size <= READ_BACK:
        if faults := compare(part, Tail(digest)).faults:
            raise RuntimeError(f"what was written reads otherwise: {'; '.join(faults)}")
    else:
        with opened(part):
            pass
    know(digest)
    return digest


def _tables(run: xr.Dataset) -> list[str]:
    """Return the texts of the measured tables of a run's model."""
    if "model_toml" not in run.variables:
        return []
    try:
        drives = tomllib.loads(str(run["model_toml"].values)).get("drives", {})
        return [str(one["csv"]) for one in drives.values() if "csv" in one]
    except (tomllib.TOMLDecodeError, RecursionError, AttributeError, TypeError):
        return []  # derived data, whose text is no model

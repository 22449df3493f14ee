"""Runs into files: written whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from xdynamics import record
from xdynamics.archive.library import opened
from xdynamics.archive.reading import verified
from xdynamics.archive.seals import seal_file, slabs
from xdynamics.archive.standing import standing
from xdynamics.archive.target import taking_name
from xdynamics.archive.writer import Writer
from xdynamics.faults import InputError, numbered
from xdynamics.record.kinds import left_out_atols
from xdynamics.schema import DERIVED, DERIVED_FROM, LEFT_OUT_ATOL, ORIGIN, SELECTION, SELECTION_OF, STEPS

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[Any]

READ_BACK = 64_000_000  # bytes up to which a new file is read again in full before it takes its name


def save(run: xr.Dataset, path: str | Path, *, derived: str | None = None) -> Path:
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

    Raises
    ------
    InputError
        If the Dataset is no run record, or was edited and is not said to be derived; names what differs.
    ArchiveError
        If the file cannot be written; the final name is untouched.
    """
    run = _declared(run, derived)
    record.check(run, values=derived is not None)  # without, they were looked at before
    with new_file(Path(path)) as writer:
        for name, variable in run.variables.items():
            sizes = {str(dim): n for dim, n in zip(variable.dims, variable.shape, strict=True) if n}
            coordinates = "time" if STEPS in variable.dims and name != "time" else None
            writer.define(
                str(name), tuple(map(str, variable.dims)), variable.dtype, dict(variable.attrs), coordinates, sizes
            )
        for name, variable in run.variables.items():
            for part in slabs(variable):
                writer.append(str(name), part)
        writer.finish(dict(run.attrs))
    return Path(path)


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
    """Write a file under a temporary name, check it, and give it its name."""
    import netCDF4

    with taking_name(path, _finish) as temporary, netCDF4.Dataset(temporary, "w", format="NETCDF4") as file:
        file.set_fill_off()
        yield Writer(file)


def _finish(temporary: Path) -> None:
    """Read a new file back, and seal it."""
    if temporary.stat().st_size <= READ_BACK:
        verified(temporary)
    else:
        with opened(temporary):
            pass
    seal_file(temporary)

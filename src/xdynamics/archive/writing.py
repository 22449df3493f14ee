"""Runs into files: written whole or not at all."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from xdynamics import record
from xdynamics.archive.library import opened
from xdynamics.archive.reading import verify
from xdynamics.archive.seals import seal_file, slabs
from xdynamics.archive.target import taking_name
from xdynamics.archive.writer import Writer
from xdynamics.schema import STEPS

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[Any]

READ_BACK = 64_000_000  # bytes up to which a new file is read again in full before it takes its name


def save(run: xr.Dataset, path: str | Path) -> Path:
    """Write a run to a netCDF4 file.

    The file is written under a temporary name in the same folder, closed, opened again and checked, and takes its
    name last: under the final name there is the old file or the new one, never something between.

    Parameters
    ----------
    run : xarray.Dataset
        A run record; checked against the schema first.
    path : str or Path

    Raises
    ------
    InputError
        If the Dataset is no run record.
    ArchiveError
        If the file cannot be written; the final name is untouched.
    """
    record.check(run)
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
        verify(temporary)
    else:
        with opened(temporary):
            pass
    seal_file(temporary)

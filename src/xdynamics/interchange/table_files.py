"""The process that reads a measured table by a library: netCDF, Parquet, Feather, MATLAB's files, HDF5.

Such a file may crash the library that reads it, take all memory, or never end. So it is read here, within bounds, by a
process that the model's files start (`xdynamics.model.file_access`) and that writes the table as CSV.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from xdynamics.faults import InputError
from xdynamics.model.csv_sheet import csv_text
from xdynamics.model.file_access import HDF5, LARGEST_TABLE, MOST_COLUMNS, MOST_ROWS_READ, NETCDF, REFUSED
from xdynamics.model.table_values import table_text
from xdynamics.runtime.files import bound_memory

MEMORY, SECONDS_OF_PROCESSOR = 1_500_000_000, 30  # bytes of address space over what libraries take


def main(path: str, name: str) -> None:
    """Write a table to standard output as CSV; or why there is none, with the exit code that says so."""
    file = Path(path)
    read = next(read for suffixes, read in READERS.items() if file.suffix.lower() in suffixes)
    try:
        bound_memory(MEMORY)
        signal.setitimer(signal.ITIMER_PROF, SECONDS_OF_PROCESSOR)
        text = read(file, name)
    except ImportError as error:
        _refuse(f"{error.name} is not installed: pip install 'xdynamics[tables]'")
    except (InputError, OSError, ValueError, KeyError, TypeError, NotImplementedError, MemoryError) as error:
        _refuse(" ".join(str(error).split())[:300] or type(error).__name__)
    if len(text) > LARGEST_TABLE:
        _refuse(f"its table has {len(text)} characters as CSV, over the limit of {LARGEST_TABLE}; leave out columns")
    sys.stdout.write(text)


def _refuse(why: str) -> NoReturn:
    sys.stdout.write(why)
    sys.stdout.flush()
    sys.exit(REFUSED)


def _netcdf(file: Path, name: str) -> str:
    """Return the variables along one dimension that have units."""
    import xarray as xr

    with xr.open_dataset(file, engine="netcdf4") as data:
        _check_size(max(data.sizes.values(), default=0), len(data.variables))
        return table_text(name, data.load())


def _frame(file: Path, name: str) -> str:
    """Return the columns of a table of pandas, as it wrote them."""
    import pandas as pd
    import pyarrow.parquet as parquet  # type: ignore[import-untyped]

    if file.suffix.lower() == ".parquet":
        shape = parquet.ParquetFile(file).metadata
        _check_size(shape.num_rows, shape.num_columns)
        frame = pd.read_parquet(file)
    else:
        frame = pd.read_feather(file)
        _check_size(*frame.shape)
    return table_text(name, frame)


def _matlab(file: Path, name: str) -> str:
    """Return the vectors of a file of MATLAB up to version 7; later ones are HDF5."""
    from scipy.io import loadmat, whosmat

    with file.open("rb") as opened:
        if b"MATLAB 7.3" in opened.read(128):
            return _hdf5(file, name)
    _check_size(max((max(shape, default=0) for _, shape, _ in whosmat(file)), default=0), 0)
    return _of_vectors((key, value) for key, value in loadmat(file).items() if not key.startswith("__"))


def _hdf5(file: Path, _name: str) -> str:
    """Return the vectors of a file of HDF5, those of its groups too."""
    import netCDF4

    with netCDF4.Dataset(file) as data:
        data.set_auto_mask(False)
        found = [*_datasets(data)]
        _check_size(max((variable.size for _, variable in found), default=0), len(found))
        return _of_vectors((_titled(key, variable), variable[:]) for key, variable in found)


def _datasets(group: Any) -> Iterator[tuple[str, Any]]:
    yield from group.variables.items()
    for inner in group.groups.values():
        yield from _datasets(inner)


def _titled(key: str, variable: Any) -> str:
    """Return the name of a dataset, with the unit that it says as HDF5's users do: `units`, `Units`, `unit`."""
    said = next(
        (str(variable.getncattr(word)) for word in ("units", "Units", "unit") if word in variable.ncattrs()), ""
    )
    return f"{key} [{said}]" if said else key


def _of_vectors(arrays: Iterator[tuple[str, Any]]) -> str:
    """Return the numeric vectors that have the length of most of them, as a table."""
    vectors: dict[str, Any] = {}
    for key, value in arrays:
        array = np.asarray(value)
        if array.dtype.kind in "iuf" and array.size > 1 and array.size == max(array.shape):
            vectors[key] = array.ravel()
    lengths = [len(vector) for vector in vectors.values()]
    if not lengths:
        raise InputError("it has no vectors of numbers; export the columns that are needed as CSV")
    length = max(lengths, key=lambda size: (lengths.count(size), size))
    return csv_text({key: vector for key, vector in vectors.items() if len(vector) == length})


def _check_size(rows: int, columns: int) -> None:
    if rows > MOST_ROWS_READ or columns > MOST_COLUMNS:
        raise InputError(
            f"it has {rows} rows and {columns} columns, {MOST_ROWS_READ} and {MOST_COLUMNS} at most; save what is needed as CSV"
        )


READERS: Mapping[tuple[str, ...], Callable[[Path, str], str]] = {
    NETCDF: _netcdf,
    (".parquet", ".feather"): _frame,
    (".mat",): _matlab,
    HDF5: _hdf5,
}

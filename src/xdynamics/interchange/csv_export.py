"""States of a run at chosen times as a table of text, that spreadsheets, `compare` and `fit` read."""

from __future__ import annotations

import csv
import io
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from xdynamics.archive.store import Place
from xdynamics.evidence.sampling import sample
from xdynamics.interchange import tables
from xdynamics.record import of_elements
from xdynamics.schema import AT, AT_TIME, error
from xdynamics.shapes.naming import display_text

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

ENDINGS = (".csv", ".txt")


def check_text_target(path: Place) -> Place:
    """Check that a table of text can be written to a path; see `tables.check_target`."""
    return tables.check_table_target(path, ENDINGS)


@of_elements
def states_as_csv(states: xr.Dataset) -> str:
    """Return states at some times, as `sample` gives them: CSV with units in its header, numbers to the last bit."""
    names = [str(name) for name in states.data_vars if states[name].dims == (AT,) and error(str(name)) in states]
    columns = {f"time [{states[AT_TIME].attrs['units']}]": states[AT_TIME].values}
    columns |= {f"{display_text(name)} [{states[name].attrs['units']}]": states[name].values for name in names}
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(columns)
    # repr of a float is the shortest text that reads back to the same bits
    rows.writerows(map(repr, row) for row in zip(*(values.tolist() for values in columns.values()), strict=True))
    return text.getvalue()


@of_elements
def write_states_table(run: xr.Dataset, requested_times: Floats, path: Place) -> str:
    """Write a table into a file, as far as the run came; return a line that describes it."""
    reached = requested_times[requested_times <= float(run["time"][-1])]
    if not reached.size:
        return "table     none: the run ended before the first of the times"
    return write_text_table(states_as_csv(sample(run, reached)), path)


def write_text_table(text: str, path: Place) -> str:
    """Write a table into a file; return a line that describes it."""
    tables.write_content(text.encode(), path)
    return f"table     {path}: {text.count(chr(10)) - 1} rows"

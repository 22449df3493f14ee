"""A run's rows as they are stored, and what of them is needed to repeat steps."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from xdynamics.dynamics.recorded_links import links_of_rows
from xdynamics.dynamics.recorded_models import model_of_record
from xdynamics.evidence.remembered_results import remembered_megabytes
from xdynamics.evidence.stored_columns import RowRange, StoredColumns
from xdynamics.model import Model
from xdynamics.model.reactions import reactions
from xdynamics.record.run_columns import state_name
from xdynamics.runtime.cached_properties import cached_property
from xdynamics.schema import STEP_NUMBER, STEPS

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]
Functions = Any

KEPT_ROLES = ("coordinate", "velocity", "state", "energy", "observable")  # columns that are looked at more than once


class Chunks(StoredColumns):
    """The rows of a run record.

    Times are kept; and what steps need to be repeated, energies and observables as long as there is room: as many MB as
    results of stages may take ($XDYNAMICS_REMEMBERED_LIMIT). Of longer runs chunks are read again where they are needed
    again.

    Parameters
    ----------
    run : xarray.Dataset
    model : Model
    """

    def __init__(self, run: xr.Dataset, model: Model) -> None:
        self.model = model
        words = {state_name(reaction) for reaction in reactions(model)} | {
            reaction.name for reaction in reactions(model)
        }
        needed = {"time", "step_size", "regime", "row_kind", STEP_NUMBER.name, *words, *model.units}
        cached_names = [
            str(name)
            for name, variable in run.variables.items()
            if variable.dims[:1] == (STEPS,) and (name in needed or variable.attrs.get("role") in KEPT_ROLES)
        ]
        super().__init__(run, STEPS, cached_names=cached_names, room=remembered_megabytes() * 1e6, lasting=("time",))

    @classmethod
    def of(cls, run: xr.Dataset | Chunks, functions: Functions = None) -> Chunks:
        """Return the rows of a run; what is that already, as it is."""
        return run if isinstance(run, Chunks) else cls(run, model_of_record(run, functions))

    @cached_property
    def is_stored(self) -> bool:
        """Whether there is anything to be read."""
        return any(variable.chunks is not None for variable in self.run.variables.values())

    @cached_property
    def _borders(self) -> list[int]:
        """The rows at which chunks of any column that is kept begin, and how many rows there are."""
        borders: list[int] = np.unique(
            np.concatenate([self._column(name).borders for name in self._cached_names])
        ).tolist()
        return borders

    def stretches(self) -> Iterator[tuple[xr.Dataset, Rows]]:
        """Yield all rows in order, as they are stored, each time as `near` does."""
        for begin, end in pairwise(self._borders):
            yield self.nearby_record(np.arange(begin, end))

    def count(self, times: Floats, side: Literal["left", "right"]) -> Rows:
        """Count the rows before times, or up to and including them."""
        rows = np.zeros(times.shape, np.int64)
        for part in self.parts("time"):
            rows += np.searchsorted(part.own_rows("time"), times, side=side)
        return rows

    def nearby_record(self, rows: Any) -> tuple[xr.Dataset, Rows]:
        """Return a record in memory in which steps from and to some rows can be repeated, and where these rows are in it.

        It has all columns that are kept, of these rows, of their neighbours, and of all rows at the same times. Of a
        run in memory it is the run.
        """
        import xarray as xr

        rows = np.asarray(rows, np.int64)
        if not self.is_stored:
            return self.run, rows
        needed_rows = self._with_neighbours(np.unique(rows))
        cached_variables = {name: self.run.variables[name] for name in self._cached_names}
        columns = {
            name: (cached_variable.dims, self.values_at(name, needed_rows), cached_variable.attrs)
            for name, cached_variable in cached_variables.items()
        }
        rowless_variables = {
            name: variable for name, variable in self.run.variables.items() if STEPS not in variable.dims
        }
        links = links_of_rows(self.run, columns[STEP_NUMBER.name][1]) if STEP_NUMBER.name in columns else {}
        return xr.Dataset(rowless_variables | links | columns, attrs=self.run.attrs), np.searchsorted(needed_rows, rows)

    def load_variables(self, run: xr.Dataset) -> xr.Dataset:
        """Return a record of some of the variables in memory; those that are kept are not read again."""
        rows = np.arange(self.size)
        read = {
            name: (run.variables[name].dims, self.values_at(name, rows), run.variables[name].attrs)
            for name in self._cached_names
            if name in run.variables
        }
        return run.assign(read).compute()

    def _with_neighbours(self, rows: Rows) -> Rows:
        """Add the rows before and after, and all at the same times: which of them a time belongs to is then decided alike."""
        needed_rows = np.unique(np.clip(np.concatenate([rows - 1, rows, rows + 1]), 0, self.size - 1))
        while True:
            edges = np.unique(
                np.clip(np.concatenate([needed_rows - 1, needed_rows, needed_rows + 1]), 0, self.size - 1)
            )
            tied = edges[np.isin(self.values_at("time", edges), self.values_at("time", needed_rows))]
            if tied.size == needed_rows.size:
                return needed_rows
            needed_rows = tied


class Unread(Chunks):
    """The rows of a run that is not marched or not to be read yet: how many there are, and of which columns.

    Attributes
    ----------
    listed_count : int
        How many cycles and turns are to be described.
    """

    def __init__(self, run: xr.Dataset, model: Model, listed_count: int) -> None:
        super().__init__(run, model)
        self.listed_count = listed_count

    def parts(self, *names: str) -> Iterator[RowRange]:  # noqa: ARG002 - as of rows that can be read
        """Yield none."""
        yield from ()

    def stretches(self) -> Iterator[tuple[xr.Dataset, Rows]]:
        """Yield none."""
        yield from ()

    def values_at(self, name: str, rows: Any) -> Any:  # noqa: ARG002 - as of rows that can be read
        """Return zeros."""
        return np.zeros(np.shape(rows))

    def nearby_record(self, rows: Any) -> tuple[xr.Dataset, Rows]:
        """Return a record without rows."""
        import xarray as xr

        empty = {
            name: (variable.dims, np.zeros([0] * variable.ndim), variable.attrs)
            for name, variable in self.run.variables.items()
            if STEPS in variable.dims
        }
        eager_variables = {name: variable for name, variable in self.run.variables.items() if variable.chunks is None}
        return xr.Dataset(eager_variables | empty, attrs=self.run.attrs), np.asarray(rows, np.int64)


def with_roles(run: xr.Dataset, roles: tuple[str, ...]) -> list[str]:
    """Name the variables along `step` that have one of some roles."""
    return [
        str(name)
        for name in run.data_vars
        if (variable := run.variables[name]).attrs.get("role") in roles and variable.dims[:1] == (STEPS,)
    ]

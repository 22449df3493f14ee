"""A run's rows as they are stored, and what of them is needed to repeat steps."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from xdynamics.dynamics.recorded_links import links_of
from xdynamics.dynamics.recorded_models import model_of
from xdynamics.evidence.remembered_results import most_megabytes
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
        kept = [
            str(name)
            for name, variable in run.variables.items()
            if variable.dims[:1] == (STEPS,) and (name in needed or variable.attrs.get("role") in KEPT_ROLES)
        ]
        super().__init__(run, STEPS, kept=kept, room=most_megabytes() * 1e6, lasting=("time",))

    @classmethod
    def of(cls, run: xr.Dataset | Chunks, functions: Functions = None) -> Chunks:
        """Return the rows of a run; what is that already, as it is."""
        return run if isinstance(run, Chunks) else cls(run, model_of(run, functions))

    @cached_property
    def is_stored(self) -> bool:
        """Whether there is anything to be read."""
        return any(variable.chunks is not None for variable in self.run.variables.values())

    @cached_property
    def _borders(self) -> list[int]:
        """The rows at which chunks of any column that is kept begin, and how many rows there are."""
        borders: list[int] = np.unique(np.concatenate([self._column(name).borders for name in self._kept])).tolist()
        return borders

    def stretches(self) -> Iterator[tuple[xr.Dataset, Rows]]:
        """Yield all rows in order, as they are stored, each time as `near` does."""
        for begin, end in pairwise(self._borders):
            yield self.near(np.arange(begin, end))

    def count(self, times: Floats, side: Literal["left", "right"]) -> Rows:
        """Count the rows before times, or up to and including them."""
        rows = np.zeros(times.shape, np.int64)
        for part in self.parts("time"):
            rows += np.searchsorted(part.own("time"), times, side=side)
        return rows

    def near(self, rows: Any) -> tuple[xr.Dataset, Rows]:
        """Return a record in memory in which steps from and to some rows can be repeated, and where these rows are in it.

        It has all columns that are kept, of these rows, of their neighbours, and of all rows at the same times. Of a
        run in memory it is the run.
        """
        import xarray as xr

        rows = np.asarray(rows, np.int64)
        if not self.is_stored:
            return self.run, rows
        wanted = self._with_neighbours(np.unique(rows))
        kept = {name: self.run.variables[name] for name in self._kept}
        columns = {name: (own.dims, self.at(name, wanted), own.attrs) for name, own in kept.items()}
        others = {name: variable for name, variable in self.run.variables.items() if STEPS not in variable.dims}
        links = links_of(self.run, columns[STEP_NUMBER.name][1]) if STEP_NUMBER.name in columns else {}
        return xr.Dataset(others | links | columns, attrs=self.run.attrs), np.searchsorted(wanted, rows)

    def whole(self, run: xr.Dataset) -> xr.Dataset:
        """Return a record of some of the variables in memory; those that are kept are not read again."""
        rows = np.arange(self.size)
        read = {
            name: (run.variables[name].dims, self.at(name, rows), run.variables[name].attrs)
            for name in self._kept
            if name in run.variables
        }
        return run.assign(read).compute()

    def _with_neighbours(self, rows: Rows) -> Rows:
        """Add the rows before and after, and all at the same times: which of them a time belongs to is then decided alike."""
        wanted = np.unique(np.clip(np.concatenate([rows - 1, rows, rows + 1]), 0, self.size - 1))
        while True:
            edges = np.unique(np.clip(np.concatenate([wanted - 1, wanted, wanted + 1]), 0, self.size - 1))
            tied = edges[np.isin(self.at("time", edges), self.at("time", wanted))]
            if tied.size == wanted.size:
                return wanted
            wanted = tied


class Unread(Chunks):
    """The rows of a run that is not marched or not to be read yet: how many there are, and of which columns.

    Attributes
    ----------
    listed : int
        How many cycles and turns are to be described.
    """

    def __init__(self, run: xr.Dataset, model: Model, listed: int) -> None:
        super().__init__(run, model)
        self.listed = listed

    def parts(self, *names: str) -> Iterator[RowRange]:  # noqa: ARG002 - as of rows that can be read
        """Yield none."""
        yield from ()

    def stretches(self) -> Iterator[tuple[xr.Dataset, Rows]]:
        """Yield none."""
        yield from ()

    def at(self, name: str, rows: Any) -> Any:  # noqa: ARG002 - as of rows that can be read
        """Return zeros."""
        return np.zeros(np.shape(rows))

    def near(self, rows: Any) -> tuple[xr.Dataset, Rows]:
        """Return a record without rows."""
        import xarray as xr

        empty = {
            name: (variable.dims, np.zeros([0] * variable.ndim), variable.attrs)
            for name, variable in self.run.variables.items()
            if STEPS in variable.dims
        }
        others = {name: variable for name, variable in self.run.variables.items() if variable.chunks is None}
        return xr.Dataset(others | empty, attrs=self.run.attrs), np.asarray(rows, np.int64)


def with_roles(run: xr.Dataset, roles: tuple[str, ...]) -> list[str]:
    """Name the variables along `step` that have one of some roles."""
    return [
        str(name)
        for name in run.data_vars
        if (variable := run.variables[name]).attrs.get("role") in roles and variable.dims[:1] == (STEPS,)
    ]

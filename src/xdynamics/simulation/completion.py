"""Completion of a record without all rows or columns: a second march, which the record's own values confirm."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import record
from xdynamics.archive.store import Given
from xdynamics.faults import ArchiveError, InputError
from xdynamics.march.outcomes import INTERRUPTED, OUTCOMES
from xdynamics.model import Model
from xdynamics.model.parts import Authorship
from xdynamics.record.arguments import recorded_arguments
from xdynamics.schema import EVENTS, STEP_NUMBER, STEPS
from xdynamics.simulation.single_run import simulate
from xdynamics.simulation.unmarched_runs import open_source_run

if TYPE_CHECKING:
    import xarray as xr

    from xdynamics.march.runner import Progress

Array = NDArray[Any]

AT_ONCE = 1 << 19  # numbers that are compared at once


def complete(
    run: xr.Dataset | Given,
    *,
    keep_every: int = 1,
    path: Given | None = None,
    functions: Mapping[str, Callable[..., float]] | None = None,
    progress: Progress | None = None,
    resume: bool = False,
) -> xr.Dataset:
    """Add the rows and columns that `log` and `keep_every` left out of a record, to the bits of the full run.

    The run is marched again with all its settings: forces and energies follow from the states, but rejected trials, errors
    and the rows between do not. Every value that was kept is then compared with the new run's.

    Parameters
    ----------
    run : xarray.Dataset, str or Path
        A record, or its archive.
    keep_every : int
        Which rows the result has: all, or as `simulate` keeps them, for all columns of some rows.
    path : str or Path, optional
        Stream the whole run to this file, in bounded memory, and return it opened.
    functions : mapping of str to callable, optional
        The Python functions its forces call.
    progress : callable, optional
        Called now and then with the fraction done, the time in s and the rows so far.
    resume : bool
        Go on from the segments of `path` that a process left behind, as in `simulate`.

    Returns
    -------
    xarray.Dataset
        What `simulate` gives without `log` and `keep_every`, its content digest too.

    Raises
    ------
    InputError
        If the record is not of a whole run, was edited, or its run was interrupted.
    ArchiveError
        If a value that was kept is not that of the run: names it. Another version may march to other bits.

    Examples
    --------
    >>> import xdynamics as xd
    >>> model = xd.Model.from_toml("data/models/harmonic_oscillator.toml")
    >>> run = xd.simulate(model, step="0.1 s", until="2 s", log=["x"], keep_every=5)
    >>> whole = complete(run)
    >>> run.sizes["step"], whole.sizes["step"], "total_energy" in whole
    (5, 21, True)
    """
    with open_source_run(run, path, "complete") as partial_run:
        if partial_run.attrs["run_outcome"] == OUTCOMES[INTERRUPTED].word:
            raise InputError("the run cannot be completed, it is 'interrupted': resume it first")
        model = Model.from_record(
            partial_run["model_toml"].values.item(),
            functions=functions,
            about=Authorship.from_attributes(partial_run.attrs),
        )
        settings = recorded_arguments(partial_run) | {"log": "full", "keep_every": keep_every}
        full_run = simulate(model, **settings, path=path, progress=progress, resume=resume)
        # of a quantity some elements may have been kept: element by element only where whole ones differ
        if _first_difference(partial_run, full_run) and (
            differing := _first_difference(record.unfold(partial_run), record.unfold(full_run))
        ):
            raise ArchiveError(
                f"the run cannot be completed: computed again by xdynamics {full_run.attrs['xdynamics_version']},"
                f" '{differing}' gives other bits than those kept by {partial_run.attrs['xdynamics_version']}; see"
                " xdynamics.compare"
            )
    return full_run


def _first_difference(partial_run: xr.Dataset, full_run: xr.Dataset) -> str:
    """Name the first variable along steps or events that has other values in the rows that both have; empty if there is none."""
    numbers = [np.asarray(run[STEP_NUMBER.name]) for run in (partial_run, full_run)]
    common_rows = [
        np.flatnonzero(np.isin(step_numbers, other_numbers)) for step_numbers, other_numbers in (numbers, numbers[::-1])
    ]
    events = [np.arange(run.sizes.get(EVENTS, 0)) for run in (partial_run, full_run)]
    for name, variable in partial_run.variables.items():
        if variable.dims[:1] not in ((STEPS,), (EVENTS,)) or name == STEP_NUMBER.name:
            continue
        if not _has_same_bits(
            variable, full_run.variables[name], *(common_rows if variable.dims[0] == STEPS else events)
        ):
            return str(name)
    return "" if common_rows[0].size and partial_run.sizes.get(EVENTS) == full_run.sizes.get(EVENTS) else STEPS


def _has_same_bits(variable: xr.Variable, full_variable: xr.Variable, partial_rows: Array, full_rows: Array) -> bool:
    """Whether two variables have equal bits in given rows of each, which are read some at a time."""
    if partial_rows.size != full_rows.size or variable.shape[1:] != full_variable.shape[1:]:
        return False
    rows = max(1, AT_ONCE // math.prod(variable.shape[1:]))
    parts = [slice(start, start + rows) for start in range(0, partial_rows.size, rows)]
    return all(
        variable[partial_rows[part]].values.tobytes() == full_variable[full_rows[part]].values.tobytes()
        for part in parts
    )

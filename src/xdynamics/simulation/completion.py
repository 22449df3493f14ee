"""A record without all rows or columns, marched again to its whole log: its own values confirm the rest."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import record
from xdynamics.archive.place import Given
from xdynamics.faults import ArchiveError, InputError
from xdynamics.march.outcomes import INTERRUPTED, OUTCOMES
from xdynamics.model import Model
from xdynamics.model.parts import Authorship
from xdynamics.record.arguments import asked_of
from xdynamics.schema import EVENTS, STEP_NUMBER, STEPS
from xdynamics.simulation.records import kept_run
from xdynamics.simulation.single_run import simulate

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
    """Add what `log` and `keep_every` left out of a record, to the bits of the whole run.

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
    with kept_run(run, path, "complete") as kept:
        if kept.attrs["run_outcome"] == OUTCOMES[INTERRUPTED].word:
            raise InputError("the run cannot be completed, it is 'interrupted': resume it first")
        model = Model.from_record(
            kept["model_toml"].values.item(), functions=functions, about=Authorship.of(kept.attrs)
        )
        settings = asked_of(kept) | {"log": "full", "keep_every": keep_every}
        whole = simulate(model, **settings, path=path, progress=progress, resume=resume)
        # of a quantity some elements may have been kept: element by element only where whole ones differ
        if _first_other(kept, whole) and (differing := _first_other(record.unfold(kept), record.unfold(whole))):
            raise ArchiveError(
                f"the run cannot be completed: marched again by xdynamics {whole.attrs['xdynamics_version']},"
                f" '{differing}' gives other bits than those kept by {kept.attrs['xdynamics_version']}; see"
                " xdynamics.compare"
            )
    return whole


def _first_other(kept: xr.Dataset, whole: xr.Dataset) -> str:
    """Name the first variable along steps or events that has other values in the rows that both have; empty if there is none."""
    numbers = [np.asarray(run[STEP_NUMBER.name]) for run in (kept, whole)]
    both = [np.flatnonzero(np.isin(own, other)) for own, other in (numbers, numbers[::-1])]
    events = [np.arange(run.sizes.get(EVENTS, 0)) for run in (kept, whole)]
    for name, variable in kept.variables.items():
        if variable.dims[:1] not in ((STEPS,), (EVENTS,)) or name == STEP_NUMBER.name:
            continue
        if not _same_bits(variable, whole.variables[name], *(both if variable.dims[0] == STEPS else events)):
            return str(name)
    return "" if both[0].size and kept.sizes.get(EVENTS) == whole.sizes.get(EVENTS) else STEPS


def _same_bits(variable: xr.Variable, other: xr.Variable, mine: Array, theirs: Array) -> bool:
    """Whether two variables have the same bits in some rows of each, which are read some at a time."""
    if mine.size != theirs.size or variable.shape[1:] != other.shape[1:]:
        return False
    rows = max(1, AT_ONCE // math.prod(variable.shape[1:]))
    parts = [slice(start, start + rows) for start in range(0, mine.size, rows)]
    return all(variable[mine[part]].values.tobytes() == other[theirs[part]].values.tobytes() for part in parts)

"""Tasks that are given runs: what is still to be marched comes from its own task, other runs go along with the call."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from xdynamics.evidence.stage_tasks import Task
from xdynamics.evidence.stages import is_lazy, subject_of, task_of

if TYPE_CHECKING:
    import xarray as xr


def task_of_runs(
    kind: str, call: Callable[..., Any], runs: Sequence[xr.Dataset], *words: Any, needs: tuple[Task, ...] = ()
) -> Task:
    """Return the task that calls with runs, and then with the results of further tasks.

    A run that other stages need too is so marched once for all of them.

    Parameters
    ----------
    kind : str
        First word of its name.
    call : callable
    runs : sequence of xarray.Dataset
        In memory, in chunks, or still to be marched.
    *words
        What else the result depends on.
    needs : tuple of Task
        The further tasks.
    """
    marching = [task_of(run) for run in runs]
    supplied_runs = [run if task is None else None for run, task in zip(runs, marching, strict=True)]
    needed = (*(task for task in marching if task is not None), *needs)
    return Task.of(kind, partial(_with_runs, call, supplied_runs), needed, *map(subject_of, runs), *words)


def _with_runs(call: Callable[..., Any], supplied_runs: Sequence[xr.Dataset | None], *results: Any) -> Any:
    remaining = iter(results)
    runs = [next(remaining) if run is None else run for run in supplied_runs]
    return call(*runs, *remaining)


def in_memory(run: xr.Dataset) -> xr.Dataset:
    """Return a run whose chunks are read, each once, by the task that asks."""
    return run.compute(scheduler="synchronous") if is_lazy(run) else run

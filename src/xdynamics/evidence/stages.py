"""Stages as graphs: a Dataset that is described before anything is marched, with one task for each march.

A task is named by a digest of everything that its result depends on. A task that several stages need is therefore
computed once in a ``dask.compute`` of these stages. Results are remembered by their names as long as there is room:
numbers of one stage that are computed one after the other march once. Only the values of variables leave the tasks;
runs stay where they were marched.

A stage is one function of runs. Its task calls the function with runs, here or in a graph; its template is what the same
function gives of blank runs.

A task that is given runs takes unmarched ones from their own tasks; marched runs are arguments of the call.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics import archive, record
from xdynamics.evidence.cluster import Tell, compute_in_one_graph
from xdynamics.evidence.stage_tasks import Task, results_of
from xdynamics.faults import InputError
from xdynamics.march import March
from xdynamics.record.folding import is_chunked
from xdynamics.runtime.lazy_imports import load_dask_whole
from xdynamics.schema import ORIGIN, RUNS, STAGE

if TYPE_CHECKING:
    import xarray as xr

TEXT = np.dtype("U256")  # type of texts whose lengths are not known yet


@dataclass(frozen=True)
class Stage:
    """A result of evidence, to be computed at once or later.

    Attributes
    ----------
    task : Task
        Gives the Dataset.
    template : callable
        Returns what the task gives, with other values: variables, dimensions, sizes, types, attributes. It raises
        `InputError` where a size is missing that only marching tells.
    known_variables : collection of str
        Variables whose values the template has.
    foreseen : xarray.Dataset, optional
        Of a run, where the template leaves variables out: all that its record will have, of any size.
    """

    task: Task
    template: Callable[[], xr.Dataset]
    known_variables: Collection[str] = ()
    foreseen: xr.Dataset | None = None

    def result(self, *, compute: bool) -> xr.Dataset:
        """Return the Dataset: computed in this process, or with dask arrays and the task behind them."""
        if not compute:
            return _lazy_dataset(self)
        computed: xr.Dataset = results_of(self.task)[0]
        return computed


def _lazy_dataset(stage: Stage) -> xr.Dataset:
    """Put dask arrays into the template of a stage; attributes that become variables are left out."""
    load_dask_whole()
    import dask.array
    from dask.highlevelgraph import HighLevelGraph

    da: Any = dask.array  # its functions are not typed
    template, task, known_names = stage.template(), stage.task, stage.known_variables
    layers, dependencies = task.layers, task.dependencies
    variables = {}
    for name, variable in template.variables.items():
        if name in known_names or name in template.indexes:
            continue
        key = f"{name}-{task.name}"
        call = partial(
            _stage_values, str(name), variable.dims, variable.shape, blank=np.nan if variable.dtype.kind == "f" else ""
        )
        graph = {(key, *[0] * variable.ndim): (call, task.name)}
        merged = HighLevelGraph(layers | {key: graph}, dependencies | {key: {task.name}})
        chunks = tuple((size,) for size in variable.shape)
        dtype = max(variable.dtype, TEXT) if variable.dtype.kind == "U" else variable.dtype
        variables[name] = (variable.dims, da.Array(merged, key, chunks, dtype=dtype), variable.attrs)
    described = template.assign(variables)
    described.attrs = {name: value for name, value in template.attrs.items() if name not in (RUNS, *variables)}
    described = archive.marched(described) if ORIGIN in template.attrs else described
    described.encoding[STAGE] = _Described(
        task, frozenset(described.variables), frozenset(variables), dict(described.attrs), stage.foreseen
    )
    return described


@dataclass(frozen=True)
class _Described:
    """A lazy stage as it was made, by which later edits are recognised.

    Attributes
    ----------
    task : Task
    names, lazy : frozenset of str
        Of all its variables, and of those to be computed.
    attributes : dict
    foreseen : xarray.Dataset, optional
        As in `Stage`.
    """

    task: Task
    names: frozenset[Any]
    lazy: frozenset[Any]
    attributes: dict[str, Any]
    foreseen: xr.Dataset | None = None

    def computed(self, dataset: xr.Dataset) -> xr.Dataset | None:
        """Return the stage as it is when it is computed at once; None if the Dataset was changed since."""
        return None if self.delayed(dataset) is None else compute_datasets(dataset)[0]

    def delayed(self, dataset: xr.Dataset) -> Any:
        """Return the stage as one delayed Dataset; None if the Dataset was changed since."""
        delayed: Any = import_module("dask.delayed").Delayed  # `dask.delayed` is a function too
        data = {name: data.name for name, data in _lazy_data(dataset)}
        same = data == {name: f"{name}-{self.task.name}" for name in self.lazy}
        same = same and frozenset(dataset.variables) == self.names and dataset.attrs == self.attributes
        graph: Any = import_module("dask.highlevelgraph").HighLevelGraph
        return delayed(self.task.name, graph(self.task.layers, self.task.dependencies)) if same else None


def _lazy_data(dataset: xr.Dataset) -> Iterator[tuple[Any, Any]]:
    return ((name, variable.data) for name, variable in dataset.variables.items() if is_chunked(variable))


def _collection(dataset: xr.Dataset) -> Any:
    """Return a lazy stage as one delayed Dataset; of any other Dataset the lazy arrays by name.

    Not the Dataset itself: it would be sent to a cluster with its origin, whose digests are of its values.
    """
    described = dataset.encoding.get(STAGE)
    delayed_stage = None if described is None else described.delayed(dataset)
    return dict(_lazy_data(dataset)) if delayed_stage is None else delayed_stage


def _with_values(dataset: xr.Dataset, values: Any) -> xr.Dataset:
    """Return the computed values of a collection as a Dataset."""
    if not isinstance(values, dict):
        return record.whole_of(values)
    return archive.evaluated(dataset, values)


def compute_datasets(*datasets: xr.Dataset, tell: Tell | None = None) -> list[xr.Dataset]:
    """Compute several Datasets in one graph, each stage as it is when it is computed at once, with all its attributes.

    Those without dask arrays are returned as they are. On a cluster `tell` is called with the fraction done, 0 and the
    number of tasks done.

    Raises
    ------
    InputError
        If the cluster is gone.
    """
    places = [k for k, dataset in enumerate(datasets) if is_lazy(dataset)]
    if not places:
        return [*datasets]
    values = compute_in_one_graph(*(_collection(datasets[k]) for k in places), tell=tell)
    results = {k: _with_values(datasets[k], value) for k, value in zip(places, values, strict=True)}
    return [results.get(k, dataset) for k, dataset in enumerate(datasets)]


def task_of(stage: xr.Dataset) -> Task | None:
    """Return the task that gives a lazy stage; None if the Dataset is none, or was changed since it was made."""
    full_stage = record.whole_of(stage)
    described = full_stage.encoding.get(STAGE)
    return described.task if isinstance(described, _Described) and described.delayed(full_stage) is not None else None


def foreseen_record(run: xr.Dataset) -> xr.Dataset:
    """Return a run, or if it is still to be marched a Dataset with all variables that its record will have."""
    described = record.whole_of(run).encoding.get(STAGE)
    foreseen_dataset = described.foreseen if isinstance(described, _Described) else None
    return run if foreseen_dataset is None else foreseen_dataset


def subject_of(run: xr.Dataset) -> str:
    """Name a run by its values, for the name of a task: by the task that marches it, its digest, or those of its arrays."""
    if (task := task_of(run)) is not None:
        return task.name
    if not is_lazy(run):
        return archive.digest_of_run(run)
    from dask.base import tokenize

    tokens: Any = tokenize  # it is not typed
    words = sorted((str(name), variable.dims, tokens(variable.data)) for name, variable in run.variables.items())
    attributes = sorted((str(name), repr(value)) for name, value in run.attrs.items() if name != ORIGIN)
    return sha256(repr((words, attributes)).encode()).hexdigest()


def _stage_values(
    name: str, dims: tuple[Hashable, ...], shape: tuple[int, ...], stage: xr.Dataset, *, blank: float | str = ""
) -> Any:
    """Return a stage's variable or attribute of a name, in the stated shape.

    Beyond its end there is nan, -1 of whole numbers; of what it has not, `blank`.

    Raises
    ------
    InputError
        If it has more.
    """
    stage = record.whole_of(stage)
    if name not in stage.variables and name not in stage.attrs:
        return np.full(shape, blank)
    values = np.array(stage.variables[name].values if name in stage.variables else stage.attrs[name])
    if values.dtype.kind == "U":  # dask joins blocks in the type of the first one, and would cut longer texts
        values = values.astype(max(values.dtype, TEXT))
    for dim, size, stated in zip(dims, values.shape, shape, strict=True):
        if size > stated:
            raise InputError(
                f"'{name}' has {size} values along {dim}, and {stated} were stated: sizes={{'{dim}': {size}}}"
            )
    if values.shape == shape:
        return values
    padded = np.full(
        shape, -1 if values.dtype.kind in "iu" else "" if values.dtype.kind == "U" else np.nan, values.dtype
    )
    padded[tuple(map(slice, values.shape))] = values
    return padded


def is_lazy(stage: xr.Dataset) -> bool:
    """Return whether a variable of a Dataset is still to be computed."""
    return any(map(is_chunked, stage.variables.values()))


def blank_run(prepared: March) -> xr.Dataset:
    """Return a run without rows: names, units and words of its variables, before it is marched."""
    sizes = dict.fromkeys((dim for column in record.columns(prepared) for dim in column.variable.dims), 0)
    run = record.unfold(record.described(prepared, sizes))
    return run.assign_attrs(solver_method=prepared.settings.method.name, run_outcome="")


def requested_count(count: Any, label: str) -> int | None:
    """Read how many things to list, which only marching tells; None for all.

    Raises
    ------
    InputError
        If it is no non-negative whole number.
    """
    if count is None or (isinstance(count, int) and not isinstance(count, bool) and count >= 0):
        return count
    raise InputError(f"{label} is {count!r}, needs a non-negative whole number")


def task_of_runs(
    kind: str,
    call: Callable[..., Any],
    runs: Sequence[xr.Dataset],
    *words: Any,
    needs: tuple[Task, ...] = (),
    read: bool = False,
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
    read : bool
        Whether runs in chunks are read before the call, each chunk once.
    """
    marching = [task_of(run) for run in runs]
    supplied_runs = [run if task is None else None for run, task in zip(runs, marching, strict=True)]
    needed = (*(task for task in marching if task is not None), *needs)
    return Task.of(kind, partial(_with_runs, call, supplied_runs, read=read), needed, *map(subject_of, runs), *words)


def _with_runs(call: Callable[..., Any], supplied_runs: Sequence[xr.Dataset | None], *results: Any, read: bool) -> Any:
    remaining = iter(results)
    runs = [next(remaining) if run is None else run for run in supplied_runs]
    return call(*(map(in_memory, runs) if read else runs), *remaining)


def in_memory(run: xr.Dataset) -> xr.Dataset:
    """Return a run whose chunks are read, each once, by the task that asks."""
    return run.compute(scheduler="synchronous") if is_lazy(run) else run

"""Stages as graphs: a Dataset that is described before anything is marched, with one task for each march.

A task is named by a digest of everything that its result depends on. So tasks that several stages need are one in a
``dask.compute`` of them all, and results are remembered by their names as long as there is room: numbers of one stage that
are computed one after the other march once. Only what a variable holds leaves the tasks; runs stay where they were marched.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics import archive, record
from xdynamics.evidence.cluster import Tell, connected, reached, watched
from xdynamics.evidence.runs import march
from xdynamics.march import March
from xdynamics.march.configuration import unthinned_settings_for
from xdynamics.model import Model
from xdynamics.runtime.environment import megabytes
from xdynamics.runtime.fork_safety import waited_for
from xdynamics.runtime.lazy_imports import load_dask_whole
from xdynamics.schema import ORIGIN, RUNS

if TYPE_CHECKING:
    import xarray as xr

LIMIT = "XDYNAMICS_REMEMBERED_LIMIT"  # environment variable
STAGE = "stage"  # entry of a lazy stage's encoding: how it was made
TEXT = np.dtype("U256")  # type of texts whose lengths are not known yet
MOST_MEGABYTES = 256.0  # of results that are remembered, unless it is set


@dataclass(frozen=True)
class Task:
    """One call in the graph of a stage.

    Attributes
    ----------
    name : str
        With a digest of everything that the result depends on.
    call : callable
        Called with the results of the tasks that it needs.
    needs : tuple of Task
    lasting : bool
        Whether the result may be remembered: not if it is in a file, which may be replaced.
    steps : float
        About how many steps it takes: of several that could begin, a cluster begins the longest first.
    """

    name: str
    call: Callable[..., Any]
    needs: tuple[Task | Gathered, ...] = ()
    lasting: bool = True
    steps: float = 0.0

    @classmethod
    def of(cls, kind: str, call: Callable[..., Any], needs: tuple[Task | Gathered, ...], *inputs: Any) -> Task:
        """Return a task that is named by what it needs and by further inputs, which are compared as they are printed."""
        words = repr((kind, [task.name for task in needs], inputs))
        return cls(f"{kind}-{sha256(words.encode()).hexdigest()}", call, needs)

    @property
    def layers(self) -> dict[str, Any]:
        """The task and all that it needs, as layers of dask's graph, one for each."""
        from dask.highlevelgraph import MaterializedLayer

        call = partial(_result, self.name, self.call) if self.lasting else self.call
        tasks = {self.name: (call, *(task.name for task in self.needs))}
        layers = {self.name: MaterializedLayer(tasks, annotations={"priority": self.steps} if self.steps else None)}
        for task in self.needs:
            layers |= task.layers
        return layers

    @property
    def dependencies(self) -> dict[str, set[str]]:
        """By the name of each layer, the names of those that it needs."""
        dependencies = {self.name: {task.name for task in self.needs}}
        for task in self.needs:
            dependencies |= task.dependencies
        return dependencies


@dataclass(frozen=True)
class Gathered:
    """The values of a lazy variable, for a task that needs all of them: of a sweep, whose blocks are tasks too."""

    variable: xr.DataArray

    @property
    def name(self) -> str:
        """A name that follows from the array's."""
        return f"gathered-{self.variable.data.name}"

    @property
    def layers(self) -> dict[str, Any]:
        """The tasks of the array, and one that puts its blocks together, as a layer of dask's graph."""
        from dask.highlevelgraph import MaterializedLayer

        data = self.variable.data
        finish, extra = data.__dask_postcompute__()
        whole = {self.name: (partial(_gathered, finish, extra), data.__dask_keys__())}
        return {self.name: MaterializedLayer(dict(data.__dask_graph__()) | whole)}

    @property
    def dependencies(self) -> dict[str, set[str]]:
        """It needs no other layer."""
        return {self.name: set()}


def _gathered(finish: Callable[..., Any], extra: tuple[Any, ...], blocks: Any) -> Any:
    return np.array(finish(blocks, *extra))


@dataclass(frozen=True)
class Stage:
    """A stage before it is computed.

    Attributes
    ----------
    template : xarray.Dataset
        What it gives, with other values: variables, dimensions, sizes, types, attributes.
    task : Task
        Gives the Dataset.
    known : collection of str
        Variables whose values the template has.
    """

    template: xr.Dataset
    task: Task
    known: Collection[str] = ()


def results_of(*tasks: Task) -> list[Any]:
    """Return the results of tasks, computed one after the other here; what no other task needs is forgotten at once."""
    order: dict[str, Task] = {}

    def visit(task: Task) -> None:
        if task.name not in order:
            for needed in task.needs:
                assert isinstance(needed, Task)  # noqa: S101 - gathered values are for graphs
                visit(needed)
            order[task.name] = task

    for task in tasks:
        visit(task)
    last = {needed.name: name for name, task in order.items() for needed in task.needs}
    wanted, results = {task.name for task in tasks}, dict[str, Any]()
    for name, task in order.items():
        results[name] = task.call(*(results[needed.name] for needed in task.needs))
        for needed in task.needs:
            if last[needed.name] == name and needed.name not in wanted:
                results.pop(needed.name, None)
    return [results[task.name] for task in tasks]


def march_task(model: Model, path: Path | None = None, memory: str | float | None = None, **asked: Any) -> Task:
    """Return the task that marches a model as `evidence.runs.march` does, named by the digest of all inputs of the run.

    Raises
    ------
    InputError
        If a setting is wrong.
    """
    prepared = March(model, unthinned_settings_for(model, **asked))
    words = [record.input_digest(prepared), *(["compressed"] if prepared.settings.compress else [])]
    name = "-".join(["march", *words, *([str(path)] if path is not None else [])])
    call = partial(march, model, path, memory, **asked)
    return Task(name, call, lasting=path is None, steps=_steps(prepared))


def _steps(prepared: March) -> float:
    """Return about how many steps a march takes, or a number that grows with it where its tolerances decide."""
    settings, step = prepared.settings, prepared.settings.step
    if isinstance(step, tuple):
        return float(len(step))
    if settings.tolerances is None:
        return abs(settings.until - prepared.model.initial["t"].si) / step if step else 1.0
    return float(settings.tolerances.rtol ** (-1.0 / max(settings.method.order, 1)))


def lazy(stage: Stage) -> xr.Dataset:
    """Put dask arrays behind the template of a stage; attributes that are variables to be computed are left out."""
    load_dask_whole()
    import dask.array
    from dask.highlevelgraph import HighLevelGraph

    da: Any = dask.array  # its functions are not typed
    template, task, known = stage.template, stage.task, stage.known
    layers, dependencies = task.layers, task.dependencies
    variables = {}
    for name, variable in template.variables.items():
        if name in known:
            continue
        key = f"{name}-{task.name}"
        graph = {(key, *[0] * variable.ndim): (partial(_values, str(name)), task.name)}
        merged = HighLevelGraph(layers | {key: graph}, dependencies | {key: {task.name}})
        chunks = tuple((size,) for size in variable.shape)
        dtype = max(variable.dtype, TEXT) if variable.dtype.kind == "U" else variable.dtype
        variables[name] = (variable.dims, da.Array(merged, key, chunks, dtype=dtype), variable.attrs)
    described = template.assign(variables)
    described.attrs = {name: value for name, value in template.attrs.items() if name not in (RUNS, *variables)}
    described = archive.marched(described) if ORIGIN in template.attrs else described
    described.encoding[STAGE] = _Described(task, frozenset(described.variables), dict(described.attrs))
    return described


@dataclass(frozen=True)
class _Described:
    """What a lazy stage was as it was made, to know whether it is that still."""

    task: Task
    names: frozenset[Any]
    attributes: dict[str, Any]

    def delayed(self, dataset: xr.Dataset) -> Any:
        """Return the stage as one delayed Dataset; None if the Dataset was changed since."""
        delayed: Any = import_module("dask.delayed").Delayed  # `dask.delayed` is a function too
        sizes = all(data.name == f"{name}-{self.task.name}" for name, data in _lazy_data(dataset))
        same = sizes and frozenset(dataset.variables) == self.names and dataset.attrs == self.attributes
        graph: Any = import_module("dask.highlevelgraph").HighLevelGraph
        return delayed(self.task.name, graph(self.task.layers, self.task.dependencies)) if same else None


def _lazy_data(dataset: xr.Dataset) -> Iterator[tuple[Any, Any]]:
    return ((name, variable.data) for name, variable in dataset.variables.items() if variable.chunks is not None)


def _collection(dataset: xr.Dataset) -> Any:
    """Return a lazy stage as one delayed Dataset; of what is no stage, or one no longer, the arrays by name.

    Not the Dataset itself: it would be sent to a cluster with its origin, whose digests are of its values.
    """
    described = dataset.encoding.get(STAGE)
    whole = None if described is None else described.delayed(dataset)
    return dict(_lazy_data(dataset)) if whole is None else whole


def _with_values(dataset: xr.Dataset, values: Any) -> xr.Dataset:
    """Return what was computed of a collection as a Dataset."""
    if not isinstance(values, dict):
        whole: xr.Dataset = values
        return whole
    loaded = dataset.copy(deep=False)
    for name, data in values.items():
        loaded.variables[name].data = data
    return loaded


def computed(*datasets: xr.Dataset, tell: Tell | None = None) -> list[xr.Dataset]:
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
    import dask.base

    compute: Any = dask.base.compute  # it is not typed
    collections = [_collection(datasets[k]) for k in places]
    client = connected()
    if client is None:
        values = compute(*collections)
    else:
        with reached(client), watched(client, tell):
            values = compute(*collections)
    results = {k: _with_values(datasets[k], value) for k, value in zip(places, values, strict=True)}
    return [results.get(k, dataset) for k, dataset in enumerate(datasets)]


def _values(name: str, stage: xr.Dataset) -> Any:
    return np.array(stage.variables[name].values)


def is_lazy(stage: xr.Dataset) -> bool:
    """Return whether a variable of a Dataset is still to be computed."""
    return any(variable.chunks is not None for variable in stage.variables.values())


class Memory:
    """Results by name; those that were not used for longest are forgotten where there are too many bytes of them."""

    def __init__(self) -> None:
        self._results: OrderedDict[str, tuple[Any, int]] = OrderedDict()
        self._lock = waited_for(threading.RLock())
        self._under_way: dict[str, threading.Lock] = {}

    def result(self, name: str, make: Callable[[], Any]) -> Any:
        """Return a result; it is made where it is not remembered, once, however many threads ask for it."""
        with self._lock:
            turn = self._under_way.setdefault(name, threading.Lock())
        with turn:
            with self._lock:
                if name in self._results:
                    self._results.move_to_end(name)
                    return self._results[name][0]
            try:
                made = make()
                with self._lock:
                    self._results[name] = made, _size(made)
                    self.shrink(most_megabytes() * 1e6)
            finally:  # not before: who asks meanwhile waits for its turn
                with self._lock:
                    self._under_way.pop(name, None)
            return made

    def shrink(self, most: float) -> None:
        """Forget the oldest results until no more bytes are left than wanted."""
        with self._lock:
            while self._results and sum(size for _, size in self._results.values()) > most:
                self._results.popitem(last=False)

    def names(self) -> Iterator[str]:
        """Name the results that are remembered, the oldest first."""
        with self._lock:
            yield from [*self._results]


REMEMBERED = Memory()  # of this process


def _result(name: str, call: Callable[..., Any], *needs: Any) -> Any:
    return REMEMBERED.result(name, partial(call, *needs))


def _size(result: Any) -> int:
    """Return the bytes of a result, about."""
    from dask.sizeof import sizeof

    return int(getattr(result, "nbytes", 0)) or int(sizeof(result))


def most_megabytes() -> float:
    """Return how many MB of results are remembered: $XDYNAMICS_REMEMBERED_LIMIT, or the default if that is no number."""
    return megabytes(LIMIT, MOST_MEGABYTES)


def remembered(task: Task) -> Any:
    """Return the result of a task that needs no other, in this process."""
    return _result(task.name, task.call)


def blank_run(prepared: March) -> xr.Dataset:
    """Return a run without rows: names, units and words of its variables, before it is marched."""
    import xarray as xr

    variables = [column.variable for column in record.columns(prepared)]
    run = xr.Dataset(
        {
            variable.name: xr.Variable(variable.dims, np.zeros([0] * len(variable.dims)), variable.attributes)
            for variable in variables
        }
    )
    return run.assign_attrs(solver_method=prepared.settings.method.name, run_outcome="")


def inputs_of(settings: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return settings as words, in one order, for the name of a task."""
    return sorted((name, repr(value)) for name, value in settings.items())

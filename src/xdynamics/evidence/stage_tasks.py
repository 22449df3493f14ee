"""Tasks of stages: calls in dask's graph, each named by a digest of everything that its result depends on.

A process remembers the results of its tasks, up to a bounded number of bytes.
"""

from __future__ import annotations

import sys
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics import record
from xdynamics.evidence.cluster import compute_in_one_graph
from xdynamics.evidence.runs import march_with_settings
from xdynamics.march import March
from xdynamics.march.configuration import unthinned_settings_for
from xdynamics.model import Model
from xdynamics.record.provenance import force_digest
from xdynamics.runtime.files import megabytes
from xdynamics.runtime.fork_safety import waited_for

if TYPE_CHECKING:
    import xarray as xr

LIMIT = "XDYNAMICS_REMEMBERED_LIMIT"  # environment variable
MOST_MEGABYTES = 256.0  # of results that are remembered, unless it is set


class Memory:
    """Results by name; those that were not used for longest are forgotten where there are too many bytes of them."""

    def __init__(self) -> None:
        self._results: OrderedDict[str, tuple[Any, int]] = OrderedDict()
        # re-entrant: it is held when shrink takes it again
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
                    self._results[name] = made, _result_size(made)
                    self.shrink(remembered_megabytes() * 1e6)
            finally:  # not before: who asks meanwhile waits for its turn
                with self._lock:
                    self._under_way.pop(name, None)
            return made

    def shrink(self, byte_limit: float) -> None:
        """Forget the oldest results until no more bytes are left than wanted."""
        with self._lock:
            while self._results and sum(size for _, size in self._results.values()) > byte_limit:
                self._results.popitem(last=False)

    def names(self) -> Iterator[str]:
        """Name the results that are remembered, the oldest first."""
        with self._lock:
            yield from [*self._results]


REMEMBERED = Memory()  # of this process


def _result_size(result: Any) -> int:
    """Return the approximate bytes of a result; of containers and dataclasses the sum of what they hold, runs for example."""
    if is_dataclass(result) and not isinstance(result, type):
        return sum(_result_size(getattr(result, entry.name)) for entry in fields(result))
    if size := int(getattr(result, "nbytes", 0)):  # a dataset is a mapping, too, but of fewer names
        return size
    if isinstance(result, Mapping):
        return sum(map(_result_size, result.values()))
    if isinstance(result, (list, tuple, set, frozenset)):
        return sum(map(_result_size, result))
    return sys.getsizeof(result)


def remembered_megabytes() -> float:
    """Return how many MB of results are remembered: $XDYNAMICS_REMEMBERED_LIMIT, or the default if that is no number."""
    return megabytes(LIMIT, MOST_MEGABYTES)


MARCH = "march"  # first word of the names of tasks that march
AT_ONCE = 1e18  # steps, more than any march has: of what is begun before all that waits


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
        About how many steps it takes: of several that could begin, a cluster begins the longest first. What only reads
        what others gave has none, and is begun before any march that waits: what it reads can then be forgotten.
    """

    name: str
    call: Callable[..., Any]
    needs: tuple[Task | Gathered, ...] = ()
    lasting: bool = True
    steps: float = 0.0

    @classmethod
    def of(cls, kind: str, call: Callable[..., Any], needs: tuple[Task | Gathered, ...], *inputs: Any) -> Task:
        """Return a task named by its needs and by further inputs, which are compared as printed."""
        words = repr((kind, [task.name for task in needs], inputs))
        return cls(f"{kind}-{sha256(words.encode()).hexdigest()[:32]}", call, needs)

    def result(self, *needs: Any) -> Any:
        """Call it here; a march that is remembered, for whatever stage, is not begun again."""
        marches = self.lasting and self.name.startswith(f"{MARCH}-")
        return _remembered_result(self.name, self.call, *needs) if marches else self.call(*needs)

    @property
    def layers(self) -> dict[str, Any]:
        """The task and all that it needs, as layers of dask's graph, one for each."""
        return {name: layer for task in self._tasks_by_name().values() for name, layer in task.layer.items()}

    @property
    def dependencies(self) -> dict[str, set[str]]:
        """By the name of each layer, the names of those that it needs."""
        return {name: {needed.name for needed in task.needs} for name, task in self._tasks_by_name().items()}

    @property
    def layer(self) -> dict[str, Any]:
        """The task alone."""
        from dask.highlevelgraph import MaterializedLayer

        call = partial(_remembered_result, self.name, self.call) if self.lasting else self.call
        tasks = {self.name: (call, *(task.name for task in self.needs))}
        priority = self.steps or (AT_ONCE if self.needs else 0.0)
        return {self.name: MaterializedLayer(tasks, annotations={"priority": priority} if priority else None)}

    def _tasks_by_name(self) -> dict[str, Task | Gathered]:
        """Return the task and all that it needs by name, each once, however many need it."""
        tasks_by_name: dict[str, Task | Gathered] = {}
        waiting: list[Task | Gathered] = [self]
        while waiting:
            task = waiting.pop()
            if task.name not in tasks_by_name:
                tasks_by_name[task.name] = task
                waiting += task.needs
        return tasks_by_name


@dataclass(frozen=True)
class Gathered:
    """The values of a lazy variable, for a task that needs all of them: of a sweep, whose blocks are tasks too."""

    variable: xr.DataArray

    @property
    def name(self) -> str:
        """A name that follows from the array's."""
        return f"gathered-{self.variable.data.name}"

    @property
    def needs(self) -> tuple[Task, ...]:
        """It needs no other task."""
        return ()

    @property
    def layer(self) -> dict[str, Any]:
        """The tasks of the array, and one that puts its blocks together, as a layer of dask's graph."""
        from dask.highlevelgraph import MaterializedLayer

        data = self.variable.data
        finish, extra = data.__dask_postcompute__()
        gathering_task = {self.name: (partial(_gather_blocks, finish, extra), data.__dask_keys__())}
        return {self.name: MaterializedLayer(dict(data.__dask_graph__()) | gathering_task)}


def _gather_blocks(finish: Callable[..., Any], extra: tuple[Any, ...], blocks: Any) -> Any:
    return np.array(finish(blocks, *extra))


def results_of(*tasks: Task | Gathered) -> list[Any]:
    """Return the results of tasks, computed in turn in this process; a result is freed after its last use.

    Lazy variables that a task needs are computed as dask computes them, all in one graph: their blocks may be shared.
    """
    order: dict[str, Task | Gathered] = {}

    def visit(task: Task | Gathered) -> None:
        if task.name not in order:
            for needed in task.needs:
                visit(needed)
            order[task.name] = task

    for task in tasks:
        visit(task)
    last = {needed.name: name for name, task in order.items() for needed in task.needs}
    requested_names, results = {task.name for task in tasks}, dict[str, Any]()
    for name, task in order.items():
        if isinstance(task, Task):
            results[name] = task.result(*(results[needed.name] for needed in task.needs))
        elif name not in results:
            gathered = [entry for entry in order.values() if isinstance(entry, Gathered)]
            values = compute_in_one_graph(*(entry.variable.data for entry in gathered))
            results |= dict(zip((entry.name for entry in gathered), values, strict=True))
        for needed in task.needs:
            if last[needed.name] == name and needed.name not in requested_names:
                results.pop(needed.name, None)
    return [results[task.name] for task in tasks]


def march_task(
    model: Model, path: Path | None = None, memory: str | float | None = None, **requested_settings: Any
) -> Task:
    """Return the task that marches a model as `evidence.runs.march_model` does, named by the digest of all inputs of the run.

    Raises
    ------
    InputError
        If a setting is wrong.
    """
    prepared = March(model, unthinned_settings_for(model, **requested_settings))
    words = [record.input_digest(prepared), *(["compressed"] if prepared.settings.compress else [])]
    name = "-".join([MARCH, *words, *([str(path)] if path is not None else [])])
    call = partial(march_with_settings, settings=prepared.settings, path=path, memory=memory)
    return Task(name, call, (_model_task(model, prepared),), lasting=path is None, steps=_estimated_steps(prepared))


def _model_task(model: Model, prepared: March) -> Task:
    """Return the task that is a model: a cluster is sent it once, with its tables, however many marches there are."""
    words = ["model", model.digest, *([force_digest(prepared)] if model.python_functions else [])]
    return Task("-".join(words), partial(_return_model, model), lasting=False)


def _return_model(model: Model) -> Model:
    return model


def _estimated_steps(prepared: March) -> float:
    """Return about how many steps a march takes, or a number that grows with it where its tolerances decide."""
    settings, step = prepared.settings, prepared.settings.step
    if isinstance(step, tuple):
        return float(len(step))
    if settings.tolerances is None:
        return abs(settings.until - prepared.model.statement.initial["t"].si) / step if step else 1.0
    return float(settings.tolerances.rtol ** (-1.0 / max(settings.method.order, 1)))


def _remembered_result(name: str, call: Callable[..., Any], *needs: Any) -> Any:
    return REMEMBERED.result(name, partial(call, *needs))


def remembered(task: Task) -> Any:
    """Return the result of a task in this process."""

    def make() -> Any:
        needs = [needed for needed in task.needs if isinstance(needed, Task)]
        return task.call(*results_of(*needs))

    return REMEMBERED.result(task.name, make)


def setting_words(settings: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return settings as words, in one order, for the name of a task."""
    return sorted((name, repr(value)) for name, value in settings.items())

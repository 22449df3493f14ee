"""Results of tasks that are remembered in this process, in a bounded number of bytes."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from typing import Any

from xdynamics.runtime.environment import megabytes
from xdynamics.runtime.fork_safety import waited_for

LIMIT = "XDYNAMICS_REMEMBERED_LIMIT"  # environment variable
MOST_MEGABYTES = 256.0  # of results that are remembered, unless it is set


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
    """Return the bytes of a result, about; of a dataclass those of its fields, which may be whole runs."""
    from dask.sizeof import sizeof

    if is_dataclass(result) and not isinstance(result, type):
        return sum(_result_size(getattr(result, entry.name)) for entry in fields(result))
    return int(getattr(result, "nbytes", 0)) or int(sizeof(result))


def remembered_megabytes() -> float:
    """Return how many MB of results are remembered: $XDYNAMICS_REMEMBERED_LIMIT, or the default if that is no number."""
    return megabytes(LIMIT, MOST_MEGABYTES)

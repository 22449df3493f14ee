"""What a Python function can change that outlives its call, and how that is put back.

A function that is written down as one expression must not remember: its rates are of t and y alone. What it holds is
looked at after each call, put back before the next, and its expression is written again from every state that was seen.
"""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from operator import is_
from types import CellType, CodeType, FunctionType, MethodType, SimpleNamespace
from typing import Any

import numpy as np

MOST_PLACES = 10_000  # that are looked at
LARGEST = 1_000_000  # numbers of a list or an array that a function may change; longer ones are data
MOST_STATES = 6  # of the memory, from which a function is written again
_UNSET = object()  # a cell, or a name of a module, without a value


def names_in(code: CodeType) -> set[str]:
    """Return the names that a function's code, and that of functions inside it, reads or sets."""
    inner = [constant for constant in code.co_consts if isinstance(constant, CodeType)]
    return {*code.co_names}.union(*map(names_in, inner))


@dataclass
class Remembered:
    """What some functions hold: their closures, the globals that they name, their own object, and what is in these.

    Attributes
    ----------
    roots : tuple
        Functions, and what they are called with.
    start : dict
        The contents, by place, as they were at first.
    seen : list of dict
        Other contents, as calls left them.
    """

    roots: tuple[Any, ...]
    start: dict[_Place, Any] = field(init=False)
    seen: list[dict[_Place, Any]] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        self.start = _contents(self.roots)

    def note(self) -> None:
        """Note what a call left, if it is not what was there at first."""
        if len(self.seen) < MOST_STATES and not all(place.holds(content) for place, content in self.start.items()):
            self.seen.append(_contents(self.roots))

    def recall(self, contents: dict[_Place, Any] | None = None) -> None:
        """Put contents back: those at first, or others that were seen."""
        for place, content in (self.start if contents is None else self.start | contents).items():
            if not place.holds(content):
                place.put(content)


class _Place:
    """Something whose contents a function can change; equal to another one of the same thing."""

    def __init__(self, holder: Any, names: frozenset[str] = frozenset()) -> None:
        self.holder, self.names = holder, names

    def __hash__(self) -> int:
        return hash((id(self.holder), self.names))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Place) and self.holder is other.holder and self.names == other.names

    def content(self) -> Any:
        """Return a copy of what is there."""
        if isinstance(self.holder, CellType):
            try:
                return self.holder.cell_contents
            except ValueError:
                return _UNSET
        if self.names:
            known = vars(self.holder) if isinstance(self.holder, type) else self.holder
            return {name: known.get(name, _UNSET) for name in self.names}
        return self.holder.copy()

    def holds(self, content: Any) -> bool:
        """Whether the very things of a content are there; numbers in arrays, whether they are equal."""
        now = self.content()
        if isinstance(now, np.ndarray):
            if now.dtype != object:
                return bool(now.shape == content.shape and now.tobytes() == content.tobytes())
            now, content = now.ravel().tolist(), content.ravel().tolist()
        if isinstance(now, dict):
            return list(now) == list(content) and all(map(is_, now.values(), content.values()))
        if isinstance(now, list | deque):
            return len(now) == len(content) and all(map(is_, now, content))
        if isinstance(now, set):
            return len(now) == len(content) and {*map(id, now)} == {*map(id, content)}
        return now is content

    def put(self, content: Any) -> None:
        """Put a content there."""
        holder = self.holder
        if isinstance(holder, CellType):
            if content is _UNSET:
                del holder.cell_contents
            else:
                holder.cell_contents = content
        elif self.names:
            for name, value in content.items():
                self._put_name(name, value)
        elif isinstance(holder, np.ndarray):
            holder[...] = content
        else:
            holder.clear()
            (holder.extend if isinstance(holder, list | deque) else holder.update)(content)

    def _put_name(self, name: str, value: Any) -> None:
        is_class = isinstance(self.holder, type)
        if value is not _UNSET:
            setattr(self.holder, name, value) if is_class else self.holder.__setitem__(name, value)
        elif self.content()[name] is not _UNSET:
            delattr(self.holder, name) if is_class else self.holder.__delitem__(name)


def _contents(roots: tuple[Any, ...]) -> dict[_Place, Any]:
    contents: dict[_Place, Any] = {}
    waiting, looked_at = [*roots], set[int]()
    while waiting and len(looked_at) < MOST_PLACES:
        value = waiting.pop()
        if id(value) in looked_at:
            continue
        looked_at.add(id(value))
        for place in _places(value):
            contents[place] = content = place.content()
            waiting += _inner([content] if isinstance(place.holder, CellType) else content)
        waiting += _behind(value)
    return contents


def _places(value: Any) -> Iterator[_Place]:
    """Yield what can be changed of a value."""
    match value:
        case FunctionType() if _is_of_user(value):
            yield from map(_Place, value.__closure__ or ())
            if names := names_in(value.__code__):  # without one the place would be all of the module
                yield _Place(value.__globals__, frozenset(names))
            yield _Place(value.__dict__)
        case type() if _is_of_user(value):
            if attributes := frozenset(name for name in vars(value) if not name.startswith("__")):
                yield _Place(value, attributes)
        case list() | dict() | set() | deque():
            if len(value) <= LARGEST:
                yield _Place(value)
        case np.ndarray():
            if value.size <= LARGEST and value.flags.writeable:
                yield _Place(value)
        case _ if _has_attributes(value):
            yield _Place(vars(value))


def _inner(members: Any) -> list[Any]:
    """Return what of some members may itself be changed."""
    if isinstance(members, np.ndarray):
        return []
    values = members.values() if isinstance(members, dict) else members
    return [value for value in values if not isinstance(value, bool | int | float | complex | str | type(None))]


def _behind(value: Any) -> list[Any]:
    """Return what a value calls and reads that is not in its places."""
    match value:
        case tuple():
            return _inner(value)
        case FunctionType():
            return [*(value.__defaults__ or ()), *(value.__kwdefaults__ or {}).values()] if _is_of_user(value) else []
        case MethodType():
            return [value.__func__, value.__self__]
        case partial():
            return [value.func, *value.args, *value.keywords.values()]
        case type():
            members = vars(value).values() if _is_of_user(value) else ()
            return [member for member in members if isinstance(member, FunctionType)]
    return [type(value)] if _has_attributes(value) else []


def _has_attributes(value: Any) -> bool:
    """Whether a value is an object of a class that the user wrote."""
    if isinstance(value, SimpleNamespace):
        return True
    is_compiled = callable(getattr(value, "py_func", None))
    return not is_compiled and not isinstance(value, type) and hasattr(value, "__dict__") and _is_of_user(type(value))


def _is_of_user(value: Any) -> bool:
    """Whether a function or class is of no library."""
    root = str(value.__module__).split(".")[0]
    origin = str(getattr(sys.modules.get(root), "__file__", "") or "")
    is_library = root in sys.stdlib_module_names or root == "xdynamics" or "-packages" in origin
    return root == "__main__" or not is_library

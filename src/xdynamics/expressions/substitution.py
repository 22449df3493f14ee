"""Substitution of numpy, math and builtins in a Python function, so that it takes traced numbers.

The function and its modules stay as they are.
"""

from __future__ import annotations

import builtins
import math
from collections.abc import Callable, Mapping
from functools import partial, reduce
from types import BuiltinFunctionType, CellType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np

from xdynamics.expressions.memory import names_in
from xdynamics.expressions.traced_arrays import (
    Points,
    UniversalFunction,
    array_of,
    interpolator_reader,
    is_traced,
    of_numpy,
    table_reader,
)
from xdynamics.expressions.tracing import Traced, called, trace_rounding

FOREIGN = ("numpy", "scipy", "math", "builtins", "numba")  # whose functions are not substituted inside
# math's names that numpy spells otherwise
_OF_MATH = {
    "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan, "atan2": np.arctan2, "pow": np.power, "fabs": np.abs,
    "degrees": np.degrees, "radians": np.radians,
}  # fmt: skip


class Substitution:
    """Functions in which numpy's, math's and Python's own are replaced by those for traced numbers.

    Attributes
    ----------
    tables : dict
        What `numpy.interp` was asked for, by the names that stand for its values.
    """

    def __init__(self) -> None:
        self.tables: dict[str, Points] = {}
        self._interp = table_reader(self.tables)
        self._known: dict[int, tuple[Any, Any]] = {}  # with what they are of, which lives as long
        self._builtins = {**vars(builtins), **self._of_python()}

    def substitute(self, value: Any) -> Any:
        """Return a function, or a module, for traced numbers; anything else as it is."""
        if id(value) in self._known:
            return self._known[id(value)][1]
        match value:
            case FunctionType() if str(value.__module__).split(".")[0] not in FOREIGN:
                return self._function(value)
            case MethodType():
                return MethodType(self.substitute(value.__func__), value.__self__)
            case partial():
                return partial(self.substitute(value.func), *value.args, **value.keywords)
            case ModuleType() if value in (np, np.linalg, math) or value.__name__ in _OF_SCIPY:
                return _Module(self, value)
        if hasattr(value, "py_func"):  # compiled by numba
            return self.substitute(value.py_func)
        # told by its method, without an import of scipy.sparse
        if hasattr(value, "toarray"):
            return _Sparse(value)
        return self._of_library(value)

    def _function(self, function: FunctionType) -> FunctionType:
        """Return a function with its globals and closure substituted, and those that it calls too."""
        # a function takes its builtins from `__builtins__` of its globals as it is made
        scope: dict[str, Any] = {**function.__globals__, "__builtins__": self._builtins}
        cells = tuple(CellType() for _ in function.__closure__ or ())
        new = FunctionType(function.__code__, scope, function.__name__, function.__defaults__, cells or None)
        new.__kwdefaults__ = function.__kwdefaults__
        # noted before its names are looked at: a function that calls itself finds this one
        self._known[id(function)] = function, new
        if function.__defaults__:
            new.__defaults__ = tuple(map(self.substitute, function.__defaults__))
        for word in names_in(function.__code__):
            if word in function.__globals__:
                scope[word] = self.substitute(function.__globals__[word])
        for cell, old in zip(cells, function.__closure__ or (), strict=True):
            try:
                cell.cell_contents = self.substitute(old.cell_contents)
            except ValueError:  # it is not yet assigned
                continue
        return new

    def _of_library(self, value: Any) -> Any:
        """Return the replacement of a function of numpy, math or Python."""
        if value is np.interp:
            return self._interp
        if value is np.r_:
            return _JoiningIndex()
        if id(value) in _MAKERS:
            return _MAKERS[id(value)]
        if isinstance(value, BuiltinFunctionType) and value.__module__ == "math":
            return self._of_math(value)
        if isinstance(value, BuiltinFunctionType) and value.__module__ == "builtins":
            return self._builtins.get(value.__name__, value)
        module = str(getattr(value, "__module__", ""))
        if isinstance(value, np.ufunc):
            return UniversalFunction(value)
        if module.startswith("scipy.signal") and (waveform := getattr(value, "__name__", "")) in _WAVEFORMS:
            return _WAVEFORMS[waveform]
        if callable(value) and module.startswith("scipy.interpolate") and not isinstance(value, type | FunctionType):
            return interpolator_reader(value, self.tables) or value
        if callable(value) and module.startswith("numpy") and not isinstance(value, type):
            return partial(of_numpy, value)
        return value

    def _of_math(self, function: Any) -> Any:
        counterpart = _OF_MATH.get(function.__name__, getattr(np, function.__name__, None))

        def of_math(*arguments: Any) -> Any:
            if counterpart is None or not any(map(is_traced, arguments)):
                return function(*arguments)
            if function is math.log and len(arguments) == 2:
                return called("log", arguments[0]) / math.log(arguments[1])
            if function is math.hypot and len(arguments) != 2:
                return np.sqrt(sum(argument * argument for argument in arguments))
            return of_numpy(counterpart, *arguments)

        return of_math

    def _of_python(self) -> dict[str, Any]:
        """Return builtins that would ask for the value of a number."""

        def extreme(function: str, builtin: Callable[..., Any]) -> Callable[..., Any]:
            def traced_extreme(*values: Any, **options: Any) -> Any:
                row = list(values[0]) if len(values) == 1 else list(values)
                if options or not any(map(is_traced, row)):
                    return builtin(*values, **options)
                return reduce(lambda x, y: called(function, x, y), row)

            return traced_extreme

        def imported(word: str, *import_arguments: Any) -> Any:
            module = builtins.__import__(word, *import_arguments)
            return self.substitute(module) if isinstance(module, ModuleType) else module

        return {
            "max": extreme("max", max),
            "min": extreme("min", min),
            "round": lambda value, *digits: (
                trace_rounding(value, *digits) if isinstance(value, Traced) else round(value, *digits)
            ),
            "float": _Float,
            "__import__": imported,
        }


def _square(t: Any, duty: Any = 0.5) -> Any:
    """Return `scipy.signal.square`: 1 in the first part of each 2 pi, then -1."""
    return of_numpy(np.where, t % TURN < TURN * duty, 1.0, -1.0)


def _sawtooth(t: Any, width: Any = 1.0) -> Any:
    """Return `scipy.signal.sawtooth`: from -1 to 1 in the first part of each 2 pi, and back in the rest."""
    phase = t % TURN
    if width == 1.0:
        return phase / math.pi - 1.0
    rises, falls = phase / (math.pi * width) - 1.0, (math.pi * (width + 1.0) - phase) / (math.pi * (1.0 - width))
    return of_numpy(np.where, phase < TURN * width, rises, falls)


TURN = 2.0 * math.pi
_WAVEFORMS = {"square": _square, "sawtooth": _sawtooth}
_OF_SCIPY = ("scipy", "scipy.signal")  # modules in which they are found


class _Module:
    """numpy, math or scipy, whose functions take traced numbers as far as they are known."""

    def __init__(self, substitution: Substitution, module: ModuleType) -> None:
        self._substitution, self._module = substitution, module

    def __getattr__(self, word: str) -> Any:
        return self._substitution.substitute(getattr(self._module, word))


class _JoiningIndex:
    """The replacement of ``numpy.r_``."""

    def __getitem__(self, parts: Any) -> Any:
        values = parts if isinstance(parts, tuple) else (parts,)
        is_of_numbers = not any(map(is_traced, values)) or any(isinstance(value, slice | str) for value in values)
        return np.r_[parts] if is_of_numbers else of_numpy(np.concatenate, [*map(np.atleast_1d, values)])


class _Sparse:
    """A sparse matrix, which multiplies traced arrays too."""

    def __init__(self, matrix: Any) -> None:
        self._matrix = matrix

    def __matmul__(self, vector: Any) -> Any:
        if not is_traced(vector):
            return self._matrix @ vector
        rows, x = self._matrix.tocsr(), np.asarray(vector, object)
        results = np.zeros((rows.shape[0], *x.shape[1:]), object)
        for i in range(len(results)):
            for k in range(rows.indptr[i], rows.indptr[i + 1]):
                results[i] = results[i] + float(rows.data[k]) * x[rows.indices[k]]
        return array_of(results)

    dot = __mul__ = __matmul__

    def __getattr__(self, word: str) -> Any:
        return getattr(self._matrix, word)


# isinstance(x, float), asked by a traced function, means Python's float all the same
class _OfFloat(type):
    def __instancecheck__(cls, value: Any) -> bool:
        return isinstance(value, float)

    def __subclasscheck__(cls, other: type) -> bool:
        return issubclass(other, float)


class _Float(metaclass=_OfFloat):
    """`float`, of which a traced number is one already."""

    def __new__(cls, value: Any = 0.0) -> Any:
        return value if isinstance(value, Traced) else float(value)


def _array(values: Any, *array_arguments: Any, **options: Any) -> Any:
    return array_of(values).copy() if is_traced(values) else np.array(values, *array_arguments, **options)


def _array_maker(value: float) -> Callable[..., Any]:
    """Return a function that makes arrays whose elements may become traced numbers."""

    def made(shape: Any, *_: Any, **__: Any) -> Any:
        return array_of(np.full(shape, value).astype(object))

    return made


# by identity: what is looked up may be anything, also without a hash
_MAKERS: dict[int, Callable[..., Any]] = {
    **{id(function): _array_maker(0.0) for function in (np.zeros, np.empty)},
    id(np.ones): _array_maker(1.0),
    id(np.full): lambda shape, value, *_, **__: array_of(np.full(shape, value, object)),
    **{id(function): _array for function in (np.array, np.asarray)},
}


def table_values(tables: Mapping[str, Points], t: float) -> dict[str, float]:
    """Return the values of tables at a time."""
    return {word: float(points.values_at(t)) for word, points in tables.items()}

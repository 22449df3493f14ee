"""A Python function whose numpy, math and builtins take traced numbers; the function and its modules stay as they are."""

from __future__ import annotations

import builtins
import math
from collections.abc import Callable, Mapping
from functools import partial, reduce
from types import BuiltinFunctionType, CellType, CodeType, FunctionType, MethodType, ModuleType
from typing import Any, TypeGuard

import numpy as np

from xdynamics.expressions.cube_rules import blank, cubes_in, of_cubes
from xdynamics.expressions.fields import Field
from xdynamics.expressions.reductions import product
from xdynamics.expressions.traced_arrays import Points, array_of, is_traced, of_numpy, table_reader
from xdynamics.expressions.traced_cubes import Cube
from xdynamics.expressions.traced_grid import Grid
from xdynamics.expressions.traced_planes import reshaped
from xdynamics.expressions.tracing import Traced, called, trace_rounding
from xdynamics.expressions.tree import Number
from xdynamics.expressions.universal_functions import UniversalFunction

FOREIGN = ("numpy", "scipy", "math", "builtins", "numba")  # whose functions are not substituted inside
# math's names that numpy spells otherwise
_OF_MATH = {
    "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan, "atan2": np.arctan2, "pow": np.power, "fabs": np.abs,
    "degrees": np.degrees, "radians": np.radians,
}  # fmt: skip


class Substitution:
    """Functions with numpy's, math's and Python's own in place of which stand those for traced numbers.

    Parameters
    ----------
    grid : Grid, optional
        The dimension of arrays that are traced as a whole: those that the function makes are rows of it.
    by_axes : bool
        Whether they have an expression of the indices of their axes instead, however many these are.

    Attributes
    ----------
    tables : dict
        What `numpy.interp` was asked for, by the names that stand for its values.
    """

    def __init__(self, grid: Grid | None = None, *, by_axes: bool = False) -> None:
        self.tables: dict[str, Points] = {}
        self._by_axes = by_axes
        self._interp = table_reader(self.tables)
        self._grid = grid
        self._known: dict[int, tuple[Any, Any]] = {}  # with what they are of, which lives as long
        self._builtins = {**vars(builtins), **self._of_python()}

    def substitute(self, value: Any) -> Any:
        """Return a function, or a module, for traced numbers; anything else as it is."""
        if id(value) in self._known:
            return self._known[id(value)][1]
        match value:
            case FunctionType() if str(value.__module__).split(".")[0] not in FOREIGN:
                return self._substitute_function(value)
            case MethodType():
                return MethodType(self.substitute(value.__func__), value.__self__)
            case partial():
                return partial(self.substitute(value.func), *value.args, **value.keywords)
            case ModuleType() if value in (np, np.linalg, math):
                return _Module(self, value)
        if hasattr(value, "py_func"):  # compiled by numba
            return self.substitute(value.py_func)
        if hasattr(value, "toarray"):
            return _Sparse(value)
        return self._of_library(value)

    def _substitute_function(self, function: FunctionType) -> FunctionType:
        """Return a function with its globals and closure substituted, and those that it calls too."""
        scope: dict[str, Any] = {**function.__globals__, "__builtins__": self._builtins}
        cells = tuple(CellType() for _ in function.__closure__ or ())
        new = FunctionType(function.__code__, scope, function.__name__, function.__defaults__, cells or None)
        new.__kwdefaults__ = function.__kwdefaults__
        self._known[id(function)] = function, new
        for word in _names_in_code(function.__code__):
            if word in function.__globals__:
                scope[word] = self.substitute(function.__globals__[word])
        for cell, old in zip(cells, function.__closure__ or (), strict=True):
            try:
                cell.cell_contents = self.substitute(old.cell_contents)
            except ValueError:  # it is not yet assigned
                continue
        return new

    def _of_library(self, value: Any) -> Any:
        """Return what stands for a function of numpy, math or Python."""
        if value is np.interp:
            return self._interp
        if value is np.r_:
            return _JoiningIndex()
        if id(value) in _MAKERS:
            return partial(self._make_traced, value)
        if isinstance(value, BuiltinFunctionType) and value.__module__ == "math":
            return self._of_math(value)
        if isinstance(value, BuiltinFunctionType) and value.__module__ == "builtins":
            return self._builtins.get(value.__name__, value)
        module = str(getattr(value, "__module__", ""))
        if isinstance(value, np.ufunc):
            return UniversalFunction(value)
        if callable(value) and module.startswith("numpy") and not isinstance(value, type):
            return partial(of_numpy, value)
        return value

    def _make_traced(self, maker: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
        """Return a new array: a row, where arrays are traced as a whole and it fits."""
        first, grid = arguments[0] if arguments else options.get("shape", options.get("object")), self._grid
        size = first[0] if isinstance(first, tuple) and len(first) == 1 else first
        if grid and self._by_axes and (cube := _cube(maker, first, grid)) is not None:
            return cube
        if maker in (np.array, np.asarray) and isinstance(first, Field):
            return first.copy()
        if maker in (np.array, np.asarray) and isinstance(first, list | tuple) and _is_stack(first):
            return of_numpy(np.stack, first)
        count = size if isinstance(size, int) else size[0] * size[1] if _is_plane(size) else 0
        if grid and not self._by_axes and maker in (np.zeros, np.empty, np.ones) and 1 < count <= grid.size:
            return reshaped(Field(grid, Traced(Number(float(maker is np.ones))), count), size)
        return _MAKERS[id(maker)](*arguments, **options)

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

        def extreme(function: str, builtin_function: Callable[..., Any]) -> Callable[..., Any]:
            def extreme_value(*values: Any, **options: Any) -> Any:
                row = list(values[0]) if len(values) == 1 else list(values)
                if options or not any(map(is_traced, row)):
                    return builtin_function(*values, **options)
                return reduce(lambda x, y: called(function, x, y), row)

            return extreme_value

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


class _Module:
    """numpy or math, whose functions take traced numbers."""

    def __init__(self, substitution: Substitution, module: ModuleType) -> None:
        self._substitution, self._module = substitution, module

    def __getattr__(self, word: str) -> Any:
        return self._substitution.substitute(getattr(self._module, word))


class _JoiningIndex:
    """What stands for ``numpy.r_``."""

    def __getitem__(self, parts: Any) -> Any:
        values = parts if isinstance(parts, tuple) else (parts,)
        if cubes_in(values):
            return of_cubes(
                np.concatenate, [value if isinstance(value, Cube) else np.atleast_1d(value) for value in values]
            )
        is_of_numbers = not any(is_traced(value) or isinstance(value, Field) for value in values) or any(
            isinstance(value, slice | str) for value in values
        )
        return (
            np.r_[parts]
            if is_of_numbers
            else of_numpy(
                np.concatenate, [value if isinstance(value, Field) else np.atleast_1d(value) for value in values]
            )
        )


class _Sparse:
    """A sparse matrix, which multiplies traced arrays too."""

    def __init__(self, matrix: Any) -> None:
        self._matrix = matrix

    def __matmul__(self, right_operand: Any) -> Any:
        if isinstance(right_operand, Field):
            return product(self._matrix, right_operand)
        return (
            self._matrix.toarray().astype(object) @ right_operand
            if is_traced(right_operand)
            else self._matrix @ right_operand
        )

    dot = __mul__ = __matmul__

    def __getattr__(self, word: str) -> Any:
        return getattr(self._matrix, word)


class _OfFloat(type):
    def __instancecheck__(cls, value: Any) -> bool:
        return isinstance(value, float)

    def __subclasscheck__(cls, subclass: type) -> bool:
        return issubclass(subclass, float)


class _Float(metaclass=_OfFloat):
    """`float`, of which a traced number is one already."""

    def __new__(cls, value: Any = 0.0) -> Any:
        return value if isinstance(value, Traced) else float(value)


def _make_array(values: Any, *array_arguments: Any, **options: Any) -> Any:
    return array_of(values).copy() if is_traced(values) else np.array(values, *array_arguments, **options)


_MAKERS: dict[int, Callable[..., Any]] = {
    **{
        id(function): lambda shape, *_, **__: array_of(np.zeros(shape).astype(object))
        for function in (np.zeros, np.empty)
    },
    id(np.ones): lambda shape, *_, **__: array_of(np.ones(shape).astype(object)),
    id(np.full): lambda shape, value, *_, **__: array_of(np.full(shape, value, object)),
    **{id(function): _make_array for function in (np.array, np.asarray)},
}


def _cube(maker: Any, first: Any, grid: Grid) -> Any:
    """Return a new array of any number of axes; None where it has nothing that is not known."""
    if maker in (np.zeros, np.empty, np.ones) and np.prod(first) > 1:
        return blank(grid, first, float(maker is np.ones))
    if maker in (np.array, np.asarray) and isinstance(first, Cube):
        return first.copy()
    is_list = maker in (np.array, np.asarray) and isinstance(first, list | tuple)
    return of_cubes(np.stack, first) if is_list and cubes_in(first) else None


def _is_stack(values: Any) -> bool:
    """Whether these are arrays of one shape, each traced as a whole."""
    rows = [value for value in values if isinstance(value, Field)]
    return len(rows) == len(values) > 0 and len({row.shape for row in rows}) == 1


def _is_plane(shape: Any) -> TypeGuard[tuple[int, int]]:
    """Whether an array of this shape has two axes."""
    return isinstance(shape, tuple) and len(shape) == 2 and all(isinstance(n, int) and n > 0 for n in shape)


def _names_in_code(code: CodeType) -> set[str]:
    """Return the names that a function's code, and that of functions inside it, reads."""
    inner = [constant for constant in code.co_consts if isinstance(constant, CodeType)]
    return {*code.co_names}.union(*map(_names_in_code, inner))


def table_values(tables: Mapping[str, Points], t: float) -> dict[str, float]:
    """Return what the tables give at a time."""
    return {word: float(np.interp(t, *points)) for word, points in tables.items()}

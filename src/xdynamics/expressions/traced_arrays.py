"""Arrays of traced numbers: numpy's functions, element by element, and the tables that traced functions read.

numpy's universal functions have the methods that numpy gives them: `np.add.at`, `np.subtract.outer`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial, reduce
from typing import Any, NamedTuple

import numpy as np

from xdynamics.expressions.element_folding import folded_terms
from xdynamics.expressions.tracing import (
    REMEDY,
    Traced,
    TracedComplex,
    WholeNumberError,
    apply_elementwise,
    are_real,
    called,
    choice,
    node_of,
    parts,
    trace_rounding,
    traced_name,
)
from xdynamics.expressions.tree import Binary, Name, Negative, Node, Number
from xdynamics.faults import InputError

LARGEST_SOLVED = 6  # unknowns of a traced linear system: minors double with each
ALIKE = 1e-12  # of the largest value: how near an interpolator is to the one that a drive has
MOST_KINKS = 40  # points of a table that is read at an expression, each a switch


class Points(NamedTuple):
    """A table over time: its times and values, and what is between them and beyond, as a drive says it."""

    times: tuple[float, ...]
    values: tuple[float, ...]
    interpolation: str = "linear"
    outside: str = "hold"

    def values_at(self, t: Any) -> Any:
        """Return the values at times, within the table and beyond, by the libraries that made it."""
        from scipy.interpolate import CubicSpline, PchipInterpolator

        times, values = np.array(self.times), np.array(self.values)
        within = np.clip(t, times[0], times[-1])
        if self.interpolation == "linear":
            inside = np.interp(within, times, values)
        elif self.interpolation == "previous":
            inside = values[np.searchsorted(times, within, side="right") - 1]
        else:
            inside = (CubicSpline if self.interpolation == "cubic" else PchipInterpolator)(times, values)(within)
        return np.where((within != t) & (self.outside == "zero"), 0.0, inside)


class TracedArray(np.ndarray[Any, Any]):
    """An array of numbers, some of them traced."""

    def __array_ufunc__(self, ufunc: Any, how: str, *inputs: Any, **options: Any) -> Any:  # type: ignore[override]
        """Apply a function of numpy: by elements, along an axis, or as a product of matrices."""
        # as arrays of numpy's own class, whose functions do not come back to this method
        plain = [np.asarray(value) if isinstance(value, np.ndarray) else value for value in inputs]
        if ufunc is np.matmul and how == "__call__":
            return array_of(_matrix_product(*plain))
        out = options.pop("out", None)
        if how == "reduce" and ufunc in _JOINED:
            # unlike np.sum, the method `reduce` goes along the first axis by default
            result = _reduced(ufunc, plain[0], options.get("axis", 0), keepdims=options.get("keepdims", False))
        elif how != "__call__":
            result = array_of(getattr(ufunc, how)(*plain, **options))
        else:
            result = array_of(apply_elementwise(ufunc.__name__, plain))
        if out is None:
            return result
        out[0][...] = result
        return out[0]

    def __array_function__(self, function: Any, _types: Any, arguments: Any, options: Any) -> Any:
        """Call a function of numpy that has one argument of this kind at least."""
        return of_numpy(function, *arguments, **options)

    def __setitem__(self, key: Any, value: Any) -> None:
        """Set elements; those that a traced condition chooses, all to one number."""
        is_masked = isinstance(key, np.ndarray) and key.shape == self.shape and is_traced(key)
        if not is_masked or np.ndim(value):
            super().__setitem__(key, value)
            return
        for index, condition in np.ndenumerate(key):
            super().__setitem__(index, choice(condition, value, np.asarray(self)[index]))

    def max(self, axis: Any = None, **options: Any) -> Any:  # type: ignore[override]
        """Return the largest number along an axis."""
        return _reduced(np.maximum, self, axis, **options)

    def min(self, axis: Any = None, **options: Any) -> Any:  # type: ignore[override]
        """Return the smallest number along an axis."""
        return _reduced(np.minimum, self, axis, **options)

    @property  # type: ignore[misc]
    def real(self) -> Any:
        """The real parts."""
        return _map_elements(lambda value: parts(value)[0], self)

    @property  # type: ignore[misc]
    def imag(self) -> Any:
        """The imaginary parts."""
        return _map_elements(lambda value: parts(value)[1], self)

    def clip(self, low: Any = None, high: Any = None, **_: Any) -> Any:  # type: ignore[override]
        """Return the numbers, limited."""
        return _clipped(self, low, high)

    def round(self, decimals: int = 0, **_: Any) -> Any:  # type: ignore[override]
        """Return the numbers, rounded."""
        return _map_elements(lambda value: trace_rounding(value, decimals), self)


def array_of(values: Any) -> Any:
    """Return an array of numbers, some of them perhaps traced; a number as it is."""
    if isinstance(values, Traced | TracedComplex | int | float):
        return values
    array = np.asarray(values, object)
    return array.view(TracedArray) if array.shape else array[()]


def is_traced(value: Any) -> bool:
    """Whether a value is traced, or holds something that is."""
    if isinstance(value, np.ndarray):
        return value.dtype == object and any(isinstance(entry, Traced | TracedComplex) for entry in value.flat)
    return isinstance(value, Traced | TracedComplex) or (isinstance(value, list | tuple) and any(map(is_traced, value)))


def of_numpy(function: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
    """Call a function of numpy, by its own rule here where traced numbers are among its arguments.

    Raises
    ------
    InputError
        If it is none that can be traced.
    """
    if (out := options.pop("out", None)) is not None:
        into = out[0] if isinstance(out, tuple) else out
        into[...] = of_numpy(function, *arguments, **options)
        return into
    if function is np.roll and is_traced([*arguments[1:2], *options.values()]):
        raise WholeNumberError(f"the function calls numpy.roll by a number of places that is not known yet; {REMEDY}")
    if not any(map(is_traced, (*arguments, *options.values()))):
        numbers = [_of_floats(value) for value in arguments]
        return function(*numbers, **{key: _of_floats(value) for key, value in options.items()})
    if isinstance(function, np.ufunc):
        return array_of(apply_elementwise(function.__name__, arguments))
    label = f"{function.__module__}.{function.__name__}" + (f" with {', '.join(options)}" if options else "")
    try:
        if function in _RULES:
            return _RULES[function](*arguments, **options)
        return array_of(function(*map(_plain, arguments), **{key: _plain(value) for key, value in options.items()}))
    except Exception as error:
        if isinstance(error, InputError) and function in _RULES:
            raise
        is_whole_number_error = isinstance(error, WholeNumberError)
        kind = (
            WholeNumberError
            if is_whole_number_error or any(isinstance(value, Traced) for value in arguments)
            else InputError
        )
        raise kind(
            f"the function calls {label}, which the language of expressions has not; write it with arithmetic, sums"
            " and numpy's elementary functions"
        ) from None


def table_reader(tables: dict[str, Points]) -> Callable[..., Any]:
    """Return `numpy.interp` for traced numbers, which notes the tables that are read, by names for their values."""

    def interp(x: Any, xp: Any, fp: Any, left: Any = None, right: Any = None, period: Any = None) -> Any:
        first, second = (np.asarray(_of_floats(value), float).ravel() for value in (xp, fp))
        if period is not None:
            x, first, second = _repeated(x, first, second, float(period))
            left = right = None
        if first.size != second.size or first.size < 2 or (np.diff(first) <= 0).any():
            raise InputError(
                f"the function calls numpy.interp with {first.size} and {second.size} points, needs as many of both,"
                " two at least, in ascending order"
            )
        return _map_elements(lambda value: _ended(value, first, second, tables, left, right), x)

    return interp


def interpolator_reader(interpolator: Any, tables: dict[str, Points]) -> _Interpolator | None:
    """Return an interpolator of scipy for traced times, whose table is noted; None of one that no drive is like.

    It is known by its values: constant up to the next point, along straight lines, by a cubic spline whose ends are
    not-a-knot, or by a monotone cubic (PCHIP); beyond its ends 0, as they are, or none.
    """
    from scipy.interpolate import BSpline

    if isinstance(interpolator, BSpline):
        knots = np.unique(interpolator.t)
        # between the first two and the last two, so that a spline through all of these has the same pieces
        further = [(knots[0] + knots[1]) / 2.0, (knots[-2] + knots[-1]) / 2.0] if interpolator.k == 3 else []
        sites = np.unique([*knots, *further])
    else:
        sites = np.asarray(getattr(interpolator, "x", ()), float).ravel()
    values = (
        np.asarray(interpolator(sites), float) if sites.size > 1 and (np.diff(sites) > 0.0).all() else np.zeros((0, 0))
    )
    if values.shape != sites.shape:
        return None
    within = np.concatenate([sites[:-1] + part * np.diff(sites) for part in (0.3, 0.8)])
    known, size = interpolator(within), np.abs(values).max()
    tabled = (Points(tuple(sites), tuple(values), word) for word in ("linear", "cubic", "pchip", "previous"))
    points = next(
        (points for points in tabled if (np.abs(points.values_at(within) - known) <= ALIKE * size).all()), None
    )
    if points is None:
        return None
    return _Interpolator(interpolator, points._replace(outside=_beyond(interpolator, sites, values)), tables)


def _beyond(interpolator: Any, sites: Any, values: Any) -> str:
    """Return what an interpolator is beyond its ends: 0, the value there, or nothing that a drive is."""
    far = np.array([0.1, 3.0]) * (sites[-1] - sites[0])
    try:
        values_beyond = np.asarray(interpolator(np.concatenate([sites[0] - far, sites[-1] + far])), float)
    except ValueError:  # as interp1d raises it there
        return "error"
    if not values_beyond.any():
        return "zero"
    return "hold" if np.array_equal(values_beyond, np.repeat(values[[0, -1]], 2)) else "error"


class _Interpolator:
    """An interpolator of scipy, which at traced times is the name of its table, and else as it was."""

    def __init__(self, interpolator: Any, points: Points, tables: dict[str, Points]) -> None:
        self._interpolator, self._points, self._tables = interpolator, points, tables

    def __call__(self, x: Any, *further: Any, **options: Any) -> Any:
        if further or options or not is_traced(x):
            return self._interpolator(x, *further, **options)
        return _map_elements(self._tabulated, x)

    def _tabulated(self, x: Any) -> Any:
        if not isinstance(x, Traced):
            return float(self._interpolator(x))
        line = _line_of_time(x.node)
        if line is None:
            raise InputError(
                "the function reads an interpolator of scipy at something else than t, or a straight line of it; write"
                " numpy.interp(y[0], x, table), of some 40 points, or the model with a drive over a coordinate"
            )
        times, values, interpolation, outside = self._points
        return _noted(line, np.array(times), np.array(values), self._tables, interpolation, outside)

    def __getattr__(self, word: str) -> Any:
        return getattr(self._interpolator, word)


def _repeated(x: Any, xp: Any, fp: Any, period: float) -> tuple[Any, Any, Any]:
    """Return a table over a period, and the argument within it, as `numpy.interp` has them."""
    if not period:
        raise InputError("the function calls numpy.interp with period = 0, needs another number")
    period = abs(period)
    folded = xp % period
    order = np.argsort(folded)
    folded, values = folded[order], fp[order]
    distinct = np.append(
        True, (np.diff(folded) != 0.0) | (np.diff(values) != 0.0)
    )  # both ends of a period are one point
    folded, values = folded[distinct], values[distinct]
    folded = np.concatenate([[folded[-1] - period], folded, [folded[0] + period]])
    values = np.concatenate([[values[-1]], values, [values[0]]])
    return _map_elements(lambda value: value % period, x), folded, values


def _ended(x: Any, xp: Any, fp: Any, tables: dict[str, Points], left: Any, right: Any) -> Any:
    """Return a value of a table with `left` and `right` beyond its ends, else with constant extrapolation."""
    value = _interpolated(x, xp, fp, tables)
    if right is not None:
        value = choice(x > float(xp[-1]), right, value)
    return value if left is None else choice(x < float(xp[0]), left, value)


def _interpolated(x: Any, xp: Any, fp: Any, tables: dict[str, Points]) -> Any:
    if not isinstance(x, Traced):
        return float(np.interp(x, xp, fp))
    line = _line_of_time(x.node)
    if line is None:
        return _by_kinks(x, xp, fp)
    return _noted(line, xp, fp, tables)


def _noted(
    line: tuple[float, float],
    xp: Any,
    fp: Any,
    tables: dict[str, Points],
    interpolation: str = "linear",
    outside: str = "hold",
) -> Traced:
    """Return the name of a table that is read along a straight line of time, under which it is noted."""
    scale, offset = line
    table_times = (xp - offset) / scale
    # a table has to ascend in time, also where its argument falls
    order = slice(None, None, 1 if scale > 0 else -1)
    points = Points(tuple(table_times[order].tolist()), tuple(fp[order].tolist()), interpolation, outside)
    label = next(
        (table_name for table_name, table_points in tables.items() if table_points == points),
        f"interpolated_{len(tables)}",
    )
    tables[label] = points
    return traced_name(label)


def _line_of_time(node: Node) -> tuple[float, float] | None:
    """Return slope and offset, if an expression is a straight line of time."""
    match node:
        case Binary("/", Name("t"), Name("second")):
            return 1.0, 0.0
        case Negative():
            line = _line_of_time(node.operand)
            return line and (-line[0], -line[1])
        case Binary("+" | "*", Number() as value, right):
            return _line_of_time(Binary(node.operator, right, value))
        case Binary("-", Number(value), right) if line := _line_of_time(right):
            return -line[0], value - line[1]
        case Binary("+" | "-" | "*" | "/" as operator, left, Number(value)) if value and (line := _line_of_time(left)):
            if operator in "+-":
                return line[0], line[1] + (value if operator == "+" else -value)
            factor = value if operator == "*" else 1.0 / value
            return line[0] * factor, line[1] * factor
    return None


def _by_kinks(x: Traced, xp: Any, fp: Any) -> Any:
    """Write a short table as a sum of straight lines, each from its point on."""
    if len(xp) > MOST_KINKS:
        raise InputError(
            f"the function reads a table of {len(xp)} points at an expression by numpy.interp; read it at t,"
            f" or give it {MOST_KINKS} points at most"
        )
    slopes = np.diff(fp) / np.diff(xp)
    limited = _clipped(x, float(xp[0]), float(xp[-1]))
    result = float(fp[0]) + float(slopes[0]) * (limited - float(xp[0]))
    for start, change in zip(xp[1:-1].tolist(), np.diff(slopes).tolist(), strict=True):
        if change:
            result = result + change * called("max", limited - start, 0.0)
    return result


def _of_floats(value: Any) -> Any:
    """Return an array of objects without traced numbers, also one in a list, as one of floats."""
    if isinstance(value, TracedArray) and not is_traced(value):
        return np.asarray(value, float)
    return type(value)(map(_of_floats, value)) if type(value) in (list, tuple) else value


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return np.asarray(value, object) if is_traced(value) else _of_floats(value)
    return (
        type(value)(map(_plain, value)) if isinstance(value, list | tuple) and is_traced(value) else _of_floats(value)
    )


def _map_elements(rule: Callable[[Any], Any], values: Any) -> Any:
    array = np.asarray(values, object)
    results = np.empty(array.shape, object)
    for index in np.ndindex(array.shape):
        results[index] = rule(array[index])
    return array_of(results) if array.shape else results[()]


def _reduced(ufunc: Any, values: Any, axis: Any = None, *, keepdims: Any = False) -> Any:
    """Join the elements along an axis, ascending: many that differ in numbers alone as a sum along a dimension."""
    values = np.asarray(values, object)
    axes = [axis] if isinstance(axis, int) else list(range(values.ndim) if axis is None else axis)
    first = np.moveaxis(values, axes, range(len(axes)))
    rows = first.reshape(-1, *first.shape[len(axes) :])
    results = np.empty(rows.shape[1:], object)
    for index in np.ndindex(results.shape):
        results[index] = _joined_terms(ufunc, [rows[k, *index] for k in range(len(rows))])
    shape = [1 if k in {axis % values.ndim for axis in axes} else n for k, n in enumerate(values.shape)]
    return array_of(results.reshape(shape) if keepdims else results if results.shape else results[()])


def _joined_terms(ufunc: Any, terms: list[Any]) -> Any:
    if not terms:
        return 0.0
    if ufunc in _ALONG and any(isinstance(term, Traced) for term in terms):
        nodes = [node_of(term) for term in terms]
        if (folded := folded_terms(_ALONG[ufunc], nodes)) is not None:
            return Traced(folded, 1 + max(term.nodes for term in terms if isinstance(term, Traced)))
    return reduce(_JOINED[ufunc], terms)


def _matrix_product(left: Any, right: Any) -> Any:
    """Return a product of matrices, of which those without many zeros are sums along a dimension."""
    a, b = (np.asarray(value, object) for value in (left, right))
    if not (are_real(*a.flat) and are_real(*b.flat)):
        (a_real, a_imag), (b_real, b_imag) = ((array_of(each).real, array_of(each).imag) for each in (a, b))
        real_part = _matrix_product(a_real, b_real) - _matrix_product(a_imag, b_imag)
        imaginary_part = _matrix_product(a_real, b_imag) + _matrix_product(a_imag, b_real)
        return apply_elementwise("add", [real_part, apply_elementwise("multiply", [1j, imaginary_part])])
    numeric_operands = [np.asarray(value, float) for value in (a, b) if not is_traced(value)]
    is_sparse = any(np.count_nonzero(numbers) <= numbers.size / 2 for numbers in numeric_operands)
    if is_sparse or a.ndim > 2 or b.ndim > 2 or not a.ndim or not b.ndim or a.shape[-1] != b.shape[0]:
        return np.matmul(a, b)
    rows, columns = np.atleast_2d(a), b.reshape(len(b), -1)
    results = np.empty((len(rows), columns.shape[1]), object)
    for i, k in np.ndindex(results.shape):
        results[i, k] = _sum_of_products(rows[i], columns[:, k])
    return results.reshape((*a.shape[:-1], *b.shape[1:]))[()]


def _sum_of_products(row: Any, column: Any) -> Any:
    """Return a sum of products, none of them shortened where a number is 0 or 1: they are alike."""
    factors = [*zip(row, column, strict=True)]
    products = [Binary("*", node_of(x), node_of(y)) for x, y in factors]
    if (folded := folded_terms("sum", products)) is not None:
        return Traced(folded, 1 + max(getattr(x, "nodes", 1) + getattr(y, "nodes", 1) for x, y in factors))
    return reduce(lambda x, y: x + y, (x * y for x, y in factors))


def _clipped(values: Any, low: Any = None, high: Any = None, **_: Any) -> Any:
    if low is not None:
        values = array_of(apply_elementwise("maximum", [values, low]))
    return values if high is None else array_of(apply_elementwise("minimum", [values, high]))


def _trace_where(condition: Any, *branches: Any) -> Any:
    if len(branches) != 2:
        raise InputError(f"the function asks by numpy.where which values are true; {REMEDY}")
    arrays = np.broadcast_arrays(*(np.asarray(value, object) for value in (condition, *branches)))
    results = np.empty(arrays[0].shape, object)
    for index in np.ndindex(results.shape):
        results[index] = choice(*(array[index] for array in arrays))
    return array_of(results if results.shape else results[()])


def _norm(values: Any, ord: Any = None, axis: Any = None, keepdims: bool = False) -> Any:  # noqa: A002, FBT001, FBT002
    if ord not in (None, 2):
        raise InputError(f"the function calls numpy.linalg.norm with ord = {ord!r}; sums and numpy.abs say it too")
    array = np.asarray(values, object)
    sizes = array if are_real(*array.flat) else apply_elementwise("absolute", [array])
    squares = _reduced(np.add, array_of(apply_elementwise("multiply", [sizes, sizes])), axis, keepdims=keepdims)
    return array_of(apply_elementwise("sqrt", [squares]))


def _solved(matrix: Any, right: Any) -> Any:
    """Solve a linear system by Cramer's rule, which needs no pivots: the numbers are not known."""
    a, b = (np.asarray(value, object) for value in (matrix, right))
    if not is_traced(a):
        return array_of(np.matmul(np.linalg.inv(a.astype(float)).astype(object), b))
    n = len(a)
    if a.shape != (n, n) or b.shape[:1] != (n,) or n > LARGEST_SOLVED:
        raise InputError(
            f"the function solves a linear system of shape {a.shape} by numpy.linalg.solve; {LARGEST_SOLVED} unknowns are"
            " the most with a matrix that changes: for more write the inverse of a constant matrix times the right side"
        )
    columns = b.reshape(n, -1)
    determinant = _determinant(a)
    solution = np.empty(columns.shape, object)
    for k in range(columns.shape[1]):
        for i in range(n):
            replaced = a.copy()
            replaced[:, i] = columns[:, k]
            solution[i, k] = _determinant(replaced) / determinant
    return array_of(solution.reshape(b.shape))


def _determinant(matrix: Any) -> Any:
    """Expand along rows, each minor once."""
    a = np.asarray(matrix, object)

    @cache
    def minor(row: int, columns: tuple[int, ...]) -> Any:
        if row == len(a):
            return 1.0
        total: Any = 0.0
        for k, column in enumerate(columns):
            entry = a[row, column]
            if isinstance(entry, Traced) or entry:
                term = entry * minor(row + 1, columns[:k] + columns[k + 1 :])
                total = total - term if k % 2 else total + term
        return total

    return minor(0, tuple(range(len(a))))


def _inverse(matrix: Any) -> Any:
    return _solved(matrix, np.eye(len(matrix)).astype(object))


def _gradient(values: Any, *spacing: Any, axis: Any = None) -> Any:
    """Return slopes at even spacing, as numpy's of second order inside: of a row, or along each axis."""
    f = np.asarray(values, object)
    axes = [*range(f.ndim)] if axis is None else [axis]
    steps = spacing * len(axes) if len(spacing) == 1 else spacing or (1.0,) * len(axes)
    if len(steps) != len(axes) or any(map(np.ndim, steps)):
        raise InputError("the function calls numpy.gradient of uneven spacing; write its differences")
    slopes = [_slopes(np.moveaxis(f, axis, 0), h, axis) for axis, h in zip(axes, steps, strict=True)]
    return slopes[0] if len(slopes) == 1 else slopes


def _slopes(f: Any, h: Any, axis: int) -> Any:
    interior = (f[2:] - f[:-2]) / (2.0 * h)
    slopes = np.concatenate([(f[1:2] - f[:1]) / h, interior, (f[-1:] - f[-2:-1]) / h])
    return array_of(np.moveaxis(slopes, 0, axis))


def _piecewise(conditions: Sequence[Any], values: Sequence[Any], default: Any = 0.0) -> Any:
    result = default
    for condition, value in reversed([*zip(conditions, values, strict=True)]):
        result = _trace_where(condition, value, result)
    return result


_JOINED: dict[Any, Callable[[Any, Any], Any]] = {
    np.add: lambda x, y: x + y,
    np.multiply: lambda x, y: x * y,
    np.maximum: lambda x, y: called("max", x, y),
    np.minimum: lambda x, y: called("min", x, y),
}


def _by_method(method: str) -> Callable[..., Any]:
    """Return the rule of a function that an array has as a method, which joins elements as arrays of traced numbers do."""

    def along_axis(values: Any, axis: Any = None, **options: Any) -> Any:
        if {*options} - {"keepdims", "ddof"}:
            raise TypeError(method)
        return array_of(getattr(array_of(np.asarray(values, object)), method)(axis=axis, **options))

    return along_axis


def _spread(values: Any, axis: Any = None, **options: Any) -> Any:
    return _reduced(np.maximum, values, axis, **options) - _reduced(np.minimum, values, axis, **options)


def _einstein(letters: str, *operands: Any, **options: Any) -> Any:
    """Return Einstein's sum: of products of all operands, along the letters that the result has not."""
    if {*options} - {"optimize"} or not isinstance(letters, str) or "." in letters:
        raise TypeError(letters)
    terms, _, result = letters.replace(" ", "").partition("->")
    parts = terms.split(",")
    if "->" not in letters:
        result = "".join(sorted(letter for letter in {*terms} - {","} if terms.count(letter) == 1))
    arrays = [np.asarray(operand, object) for operand in operands]
    for k, part in enumerate(parts):  # a letter that stands twice in one is its diagonal
        letters_once = "".join(dict.fromkeys(part))
        parts[k], arrays[k] = letters_once, np.einsum(f"{part}->{letters_once}", arrays[k])
    order = [*result, *dict.fromkeys(letter for part in parts for letter in part if letter not in result)]
    spread = []
    for part, array in zip(parts, arrays, strict=True):
        transposed = array.transpose([part.index(letter) for letter in order if letter in part])
        spread.append(transposed[tuple(slice(None) if letter in part else None for letter in order)])
    product = reduce(lambda x, y: np.asarray(apply_elementwise("multiply", [x, y]), object), spread)
    summed = tuple(range(len(result), len(order)))
    return _reduced(np.add, product, summed) if summed else array_of(product)


def _tensor_product(left: Any, right: Any, axes: Any = 2) -> Any:
    """Return a product that is summed over pairs of axes."""
    a, b = np.asarray(left, object), np.asarray(right, object)
    if isinstance(axes, int):
        axes = (range(a.ndim - axes, a.ndim), range(axes))
    ends = [
        [end % array.ndim for end in np.atleast_1d(axis_numbers).tolist()]
        for axis_numbers, array in zip(axes, (a, b), strict=True)
    ]
    first = [chr(97 + k) for k in range(a.ndim)]
    second = [chr(65 + k) for k in range(b.ndim)]
    for i, k in zip(*ends, strict=True):
        second[k] = first[i]
    result_letters = [letter for letter in (*first, *second) if (letter in first) != (letter in second)]
    return _einstein(f"{''.join(first)},{''.join(second)}->{''.join(result_letters)}", a, b)


_ALONG = {np.add: "sum", np.maximum: "max", np.minimum: "min"}  # functions of the language along a dimension
_RULES: dict[Any, Callable[..., Any]] = {
    np.where: _trace_where,
    np.select: _piecewise,
    np.clip: _clipped,
    np.max: lambda values, axis=None, **options: _reduced(np.maximum, values, axis, **options),
    np.min: lambda values, axis=None, **options: _reduced(np.minimum, values, axis, **options),
    **{getattr(np, method): _by_method(method) for method in ("sum", "mean", "std", "var")},
    np.ptp: _spread,
    np.einsum: _einstein,
    np.tensordot: _tensor_product,
    np.inner: lambda a, b: _tensor_product(a, b, ([-1], [-1])),
    np.vdot: lambda a, b: array_of(_matrix_product(np.ravel(a), np.ravel(b))),
    np.trace: lambda values: _reduced(np.add, np.einsum("ii->i", np.asarray(values, object))),
    np.dot: lambda a, b: array_of(_matrix_product(a, b)) if np.ndim(a) and np.ndim(b) else a * b,
    np.round: lambda values, decimals=0: _map_elements(lambda value: trace_rounding(value, decimals), values),
    np.linalg.norm: _norm,
    np.linalg.solve: _solved,
    np.linalg.inv: _inverse,
    np.linalg.det: _determinant,
    np.gradient: _gradient,
    np.zeros_like: lambda values, **_: array_of(np.zeros(np.shape(values)).astype(object)),
    np.empty_like: lambda values, **_: array_of(np.zeros(np.shape(values)).astype(object)),
    np.ones_like: lambda values, **_: array_of(np.ones(np.shape(values)).astype(object)),
}


_REDUCING = {np.add: np.sum, np.multiply: np.prod, np.maximum: np.max, np.minimum: np.min}
_ACCUMULATING = {np.add: np.cumsum, np.multiply: np.cumprod}


class UniversalFunction(partial):  # type: ignore[type-arg]
    """A function of numpy that takes numbers and arrays element by element, some of them traced."""

    def __new__(cls, ufunc: np.ufunc) -> UniversalFunction:
        """Return the replacement of a universal function of numpy."""
        return super().__new__(cls, of_numpy, ufunc)

    def __getattr__(self, word: str) -> Any:
        return getattr(self.args[0], word)

    def outer(self, first: Any, second: Any) -> Any:
        """Apply it to every two elements, one of each array."""
        if not _is_unknown(first, second):
            return self.args[0].outer(first, second)
        rows = [value if hasattr(value, "ndim") else np.asarray(value) for value in (first, second)]
        return self(rows[0][(...,) + (None,) * rows[1].ndim], rows[1])

    def reduce(self, array: Any, axis: Any = 0, **options: Any) -> Any:
        """Join the elements along an axis."""
        return self._along(_REDUCING, "reduce", array, axis, options)

    def accumulate(self, array: Any, axis: int = 0, **options: Any) -> Any:
        """Join the elements up to each along an axis."""
        return self._along(_ACCUMULATING, "accumulate", array, axis, options)

    def reduceat(self, array: Any, places: Any, **options: Any) -> Any:
        """Join the elements between some places of a known array."""
        return self._along({}, "reduceat", array, places, options)

    def at(self, array: Any, places: Any, *values: Any) -> None:
        """Change elements in place one after the other; an index that occurs twice is applied twice."""
        if not _is_unknown(array, *values):
            self.args[0].at(array, places, *values)
            return
        indices = [*zip(*places, strict=True)] if isinstance(places, tuple) else np.atleast_1d(places).tolist()
        for k, index in enumerate(indices):
            array[index] = self(array[index], *(value[k] if np.ndim(value) else value for value in values))

    def _along(
        self, numpy_functions: dict[Any, Any], method: str, array: Any, axis: Any, options: dict[str, Any]
    ) -> Any:
        ufunc = self.args[0]
        if not _is_unknown(array):
            return getattr(ufunc, method)(array, axis, **options)
        if ufunc not in numpy_functions:
            raise InputError(
                f"the function calls numpy.{ufunc.__name__}.{method}, which the language of expressions has not; write it"
                " with arithmetic, sums and numpy's elementary functions"
            )
        return of_numpy(numpy_functions[ufunc], array, axis=axis, **options)


def _is_unknown(*values: Any) -> bool:
    return any(map(is_traced, values))

"""Arrays traced as a whole: rows of numbers along one dimension, however many, as one expression of the dimension.

A row is a slice of the dimension, from an element on; its expression means something on that slice alone. Two rows are
joined after one is shifted onto the other. What is no such row, an array of two axes or one picked by a list, raises
`IrregularError`, and its elements are written out instead.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from operator import index as whole_number
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions.tracing import Row, Traced, applied, called, choice, node_of
from xdynamics.expressions.tree import Along, Binary, Call, Compare, Element, Name, Negative, Node, Number
from xdynamics.faults import InputError

ZERO = Number(0.0)
MOST_PIECES = 30  # of a row, each with an expression of its own: conditions in one another
MOST_DIAGONALS = 12  # of a matrix, each a row of numbers
LARGEST_DENSE = 200  # rows of a matrix with more

Floats = NDArray[np.float64]


class IrregularError(InputError):
    """An array that is no row; its elements are written out."""


class Grid:
    """The dimension that rows are along, and the rows of numbers that expressions mention.

    Parameters
    ----------
    name : str
        The quantity that is unknown; its dimension is named after it.
    size : int
    leaf : Node
        The quantity as functions have it, perhaps divided by its unit.

    Attributes
    ----------
    constants : dict of str to ndarray
        Parameters along the dimension, perhaps along a second one of as many elements.
    """

    def __init__(self, name: str, size: int, leaf: Node) -> None:
        self.name, self.dim, self.other, self.size, self.leaf = name, f"{name}_index", f"{name}_other", size, leaf
        self.constants: dict[str, Floats] = {}

    def whole(self) -> Field:
        """Return the unknown row."""
        return Field(self, Traced(self.leaf), self.size)

    def constant(self, values: Any, offset: int) -> Node:
        """Return numbers that begin at an element as a parameter, or as one number if they are equal."""
        numbers = np.asarray(values, float)
        if not np.isfinite(numbers).all():
            raise IrregularError("the function makes a row with numbers that are not finite")
        if (numbers == numbers.flat[0]).all():
            return node_of(float(numbers.flat[0]))
        full = numbers
        if numbers.ndim == 1:
            full = np.zeros(self.size)
            full[offset : offset + numbers.size] = numbers
        word = next((known for known, kept in self.constants.items() if np.array_equal(kept, full)), "")
        word = word or f"constant_{len(self.constants)}"
        self.constants[word] = full
        return Name(word)


class Field(Row):
    """A row of numbers that are not known.

    Parameters
    ----------
    grid : Grid
    value : Traced
        The expression of an element.
    size : int
    offset : int
        The element of the dimension that is the first here.
    view : bool
        Whether it is part of another row, which numpy would change with it.
    """

    __hash__ = None  # type: ignore[assignment]
    ndim, dtype = 1, np.dtype(float)

    def __init__(self, grid: Grid, value: Traced, size: int, offset: int = 0, *, view: bool = False) -> None:
        self.grid, self.value, self.size, self.offset, self.view, self.pieces = grid, value, size, offset, view, 1
        self.shape = (size,)

    @property
    def T(self) -> Field:  # noqa: N802 - numpy's
        """The row itself."""
        return self

    def __len__(self) -> int:
        return self.size

    def __iter__(self) -> Iterator[Any]:
        if self.size > MOST_PIECES:
            raise IrregularError("the function goes through a row")
        return (self[i] for i in range(self.size))

    def __getitem__(self, key: Any) -> Any:
        first, size = self._slice(key)
        if isinstance(key, slice) or key is Ellipsis:
            return Field(self.grid, self.value, size, self.offset + first, view=True)
        return Traced(element(self.value.node, self.offset + first, self.grid))

    def __setitem__(self, key: Any, values: Any) -> None:
        first, size = self._slice(key)
        self.pieces += 1
        if self.view or self.pieces > MOST_PIECES:
            raise IrregularError("the function fills a row by elements")
        begin = self.offset + first
        new = _aligned(values, self.grid, size, begin)
        for at, inside in ((begin + size, False), (begin, True)):
            if self.offset < at < self.offset + self.size:
                before = Compare("<", Along("index", (), (self.grid.dim,)), Number(float(at)))
                new = choice(Traced(before), *((self.value, new) if inside else (new, self.value)))
        self.value = new

    def _slice(self, key: Any) -> tuple[int, int]:
        if key is Ellipsis:
            return 0, self.size
        if isinstance(key, slice):
            first, last, step = key.indices(self.size)
            if step != 1 or last <= first:
                raise IrregularError("the function takes elements of a row that are not neighbours")
            return first, last - first
        try:
            number = whole_number(key)
        except (TypeError, InputError):
            raise IrregularError("the function picks elements of a row by a list, or an axis") from None
        if not -self.size <= number < self.size:
            raise IndexError(f"index {number} is out of bounds for axis 0 with size {self.size}")
        return number % self.size, 1

    def __array_ufunc__(self, ufunc: Any, how: str, *given: Any, **options: Any) -> Any:
        """Apply a function of numpy to every element."""
        if how != "__call__" or options:
            raise IrregularError(f"the function calls numpy.{ufunc.__name__}.{how} of a row")
        if ufunc is np.matmul:
            return product(*given)
        return combined(partial(_of_ufunc, ufunc.__name__), *given)

    def __array_function__(self, function: Any, _types: Any, arguments: Any, options: Any) -> Any:
        """Call a function of numpy."""
        return of_rows(function, *arguments, **options)

    def copy(self) -> Field:
        """Return a row of its own."""
        return Field(self.grid, self.value, self.size, self.offset)

    flatten = ravel = copy

    def reshape(self, *shape: Any) -> Any:
        """Return some rows of equal length one after the other; other shapes have two axes."""
        wanted = shape[0] if len(shape) == 1 and isinstance(shape[0], tuple | list) else shape
        if len(wanted) == 1:
            return self.copy()
        count = wanted[0] if wanted[0] != -1 else self.size // wanted[1]
        if len(wanted) == 2 and 0 < count <= 4 and wanted[1] in (-1, self.size // count):
            return split(self, count)
        raise IrregularError("the function makes an array of more axes of a row")

    def sum(self, **options: Any) -> Any:
        """Return the sum."""
        return reduced("sum", self, **options)

    def mean(self, **options: Any) -> Any:
        """Return the mean."""
        return reduced("sum", self, **options) / self.size

    def max(self, **options: Any) -> Any:
        """Return the largest."""
        return reduced("max", self, **options)

    def min(self, **options: Any) -> Any:
        """Return the smallest."""
        return reduced("min", self, **options)

    def dot(self, other: Any) -> Any:
        """Return the product of two rows, or of a row and a matrix."""
        return product(self, other)

    def __matmul__(self, other: Any) -> Any:
        return product(self, other)

    def __rmatmul__(self, other: Any) -> Any:
        return product(other, self)

    def __getattr__(self, word: str) -> Any:
        raise IrregularError(f"the function takes .{word} of a row")

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise IrregularError("the function makes an array of elements of a row")


def _operator(ufunc: str, *, turned: bool = False) -> Callable[[Any, Any], Any]:
    def joined(self: Any, other: Any) -> Any:
        return combined(partial(_of_ufunc, ufunc), *((other, self) if turned else (self, other)))

    return joined


for _word, _ufunc in (
    ("add", "add"), ("sub", "subtract"), ("mul", "multiply"), ("truediv", "divide"), ("pow", "power"),
    ("mod", "remainder"), ("floordiv", "floor_divide"),
):  # fmt: skip
    setattr(Field, f"__{_word}__", _operator(_ufunc))
    setattr(Field, f"__r{_word}__", _operator(_ufunc, turned=True))
for _word, _ufunc in (
    ("lt", "less"), ("le", "less_equal"), ("gt", "greater"), ("ge", "greater_equal"), ("eq", "equal"), ("ne", "not_equal"),
):  # fmt: skip
    setattr(Field, f"__{_word}__", _operator(_ufunc))
for _word, _ufunc in (("neg", "negative"), ("pos", "positive"), ("abs", "absolute")):
    setattr(Field, f"__{_word}__", lambda self, ufunc=_ufunc: combined(partial(_of_ufunc, ufunc), self))


def _of_ufunc(ufunc: str, *values: Traced) -> Traced:
    result: Traced = applied(ufunc, values)
    return result


def fields_in(values: Iterable[Any]) -> list[Field]:
    """Return the rows among some values and in lists of them."""
    rows: list[Field] = []
    for value in values:
        if isinstance(value, Field):
            rows.append(value)
        elif isinstance(value, list | tuple):
            rows += fields_in(value)
    return rows


def combined(rule: Callable[..., Traced], *values: Any) -> Field:
    """Apply a rule for single numbers to rows, and to what is the same for all elements."""
    rows = [value for value in values if isinstance(value, Field)]
    like = max(rows, key=lambda row: row.size)
    aligned = [_aligned(value, like.grid, like.size, like.offset) for value in values]
    return Field(like.grid, rule(*aligned), like.size, like.offset)


def _aligned(value: Any, grid: Grid, size: int, offset: int) -> Traced:
    """Return the expression of an element of a row that begins at another element of the dimension."""
    if isinstance(value, Field):
        if value.size == 1:
            return Traced(element(value.value.node, value.offset, grid))
        if value.size != size:
            raise ValueError(f"operands could not be broadcast together with shapes ({size},) ({value.size},)")
        return Traced(moved(value.value.node, offset - value.offset, grid), value.value.nodes)
    if isinstance(value, Traced):
        return value
    numbers = np.asarray(value)
    if numbers.dtype == object or numbers.ndim > 1 or numbers.size not in (1, size):
        raise IrregularError(f"the function joins a row of {size} numbers and an array of shape {numbers.shape}")
    return Traced(grid.constant(numbers.ravel(), offset))


def moved(node: Node, places: int, grid: Grid) -> Node:
    """Return an expression whose elements are those some places before; what is beyond the end does not matter."""
    known: dict[int, Node] = {}

    def inside(node: Node) -> Node:
        if id(node) not in known:
            known[id(node)] = _moved(node, places, grid, inside)
        return known[id(node)]

    return inside(node) if places else node


def _moved(node: Node, places: int, grid: Grid, inside: Callable[[Node], Node]) -> Node:
    match node:
        case Name() if node.name == grid.name or node.name in grid.constants:
            return Along("shift", (node, ZERO), (grid.dim,), places)
        case Along(function="shift") if node.dims == (grid.dim,):
            total = node.places + places
            return Along("shift", node.arguments, node.dims, total) if total else node.arguments[0]
        case Along(function="roll"):
            return Along("shift", (node, ZERO), (grid.dim,), places)
        case Along(function="index") if node.dims == (grid.dim,):
            return Binary("-" if places > 0 else "+", node, Number(float(abs(places))))
        case Negative():
            return Negative(inside(node.operand))
        case Binary():
            return Binary(node.operator, inside(node.left), inside(node.right))
        case Compare(left=Binary(operator="+" | "-", left=Along(function="index")) as index, right=Number(value=value)):
            offset = index.right.value if isinstance(index.right, Number) else 0.0
            at = value + places + (offset if index.operator == "-" else -offset)
            return Compare(node.operator, index.left, node_of(at))
        case Compare(left=Along(function="index"), right=Number(value=value)):
            return Compare(node.operator, node.left, node_of(value + places))
        case Compare():
            return Compare(node.operator, inside(node.left), inside(node.right))
        case Call():
            return Call(node.function, tuple(map(inside, node.arguments)))
    return node


def element(node: Node, number: int, grid: Grid) -> Node:
    """Return an expression at one element."""
    known: dict[int, Node] = {}

    def inside(node: Node) -> Node:
        if id(node) not in known:
            known[id(node)] = _element(node, number, grid, inside)
        return known[id(node)]

    return inside(node)


def _element(node: Node, number: int, grid: Grid, inside: Callable[[Node], Node]) -> Node:
    match node:
        case Name() if node.name == grid.name:
            return Element(node.name, (number,))
        case Name() if node.name in grid.constants:
            return node_of(float(grid.constants[node.name][number]))
        case Along(function="index") if node.dims == (grid.dim,):
            return Number(float(number))
        case Along(function="shift") if node.dims == (grid.dim,):
            return element(node.arguments[0], (number - node.places) % grid.size, grid)
        case Along(function="roll"):
            return element(node.arguments[0], (number - node.places) % grid.size, grid)
        case Negative():
            return Negative(inside(node.operand))
        case Binary():
            return Binary(node.operator, inside(node.left), inside(node.right))
        case Compare():
            return Compare(node.operator, inside(node.left), inside(node.right))
        case Call(function="where", arguments=(Compare("<", Along(function="index"), Number(value)), yes, no)):
            return inside(yes if number < value else no)
        case Call():
            return Call(node.function, tuple(map(inside, node.arguments)))
    return node


def reduced(function: str, row: Field, axis: Any = None, **options: Any) -> Traced:
    """Return the sum, the largest or the smallest element of a row."""
    if axis not in (None, 0, -1) or options:
        raise IrregularError(f"the function takes the {function} of a row with {options or axis}")
    grid, inside = row.grid, row.value
    index = Traced(Along("index", (), (grid.dim,)))
    outside: Any = 0.0 if function == "sum" else row[0]
    if row.offset + row.size < grid.size:
        inside = choice(index < row.offset + row.size, inside, outside)
    if row.offset:
        inside = choice(index < row.offset, outside, inside)
    if not varies(inside.node, grid):
        return inside * row.size if function == "sum" else inside
    return Traced(Along(function, (inside.node,), (grid.dim,)), inside.nodes + 1)


def varies(node: Node, grid: Grid) -> bool:
    """Whether an expression has the dimension."""
    match node:
        case Name():
            return node.name == grid.name or node.name in grid.constants
        case Along():
            return node.function in ("shift", "roll", "index")
        case Negative():
            return varies(node.operand, grid)
        case Binary() | Compare():
            return varies(node.left, grid) or varies(node.right, grid)
        case Call():
            return any(varies(part, grid) for part in node.arguments)
    return False


def product(left: Any, right: Any) -> Any:
    """Return the product of two rows, or of a matrix of numbers and a row: by its diagonals if these are few."""
    if not isinstance(right, Field) and isinstance(left, Field) and np.ndim(right) == 2:
        left, right = np.asarray(right).T, left
    if isinstance(left, Field) or np.ndim(left) == 1:
        row = left if isinstance(left, Field) else right
        return reduced("sum", combined(partial(_of_ufunc, "multiply"), left, right) if row.size > 1 else row)
    grid, matrix = right.grid, left.toarray() if hasattr(left, "toarray") else np.asarray(left)
    if matrix.dtype == object or matrix.shape != (right.size, right.size):
        raise IrregularError("the function multiplies a row by an array that is no square matrix of numbers")
    matrix = matrix.astype(float)
    n = right.size
    diagonals = [k for k in range(1 - n, n) if np.diagonal(matrix, k).any()]
    if len(diagonals) > MOST_DIAGONALS or n <= 2:
        return _dense(matrix, right)
    total: Any = Field(grid, Traced(ZERO), n, right.offset)
    for k in diagonals:
        # element i takes matrix[i, i + k] times element i + k
        first, numbers = max(0, -k), np.diagonal(matrix, k)
        part = Field(grid, Traced(ZERO), n, right.offset)
        part[first : first + n - abs(k)] = numbers * right[first + k : first + k + n - abs(k)]
        total = part if total.value.node == ZERO else total + part
    return total


def _dense(matrix: Floats, row: Field) -> Field:
    """Multiply by a whole matrix: sums along the row belong to a second dimension, from which they are put back."""
    grid = row.grid
    if row.size > LARGEST_DENSE or row.size != grid.size:
        raise IrregularError(f"the function multiplies a row by a matrix of {matrix.shape}")
    entries = Traced(grid.constant(matrix, 0))
    sums = Along("sum", ((entries * row.value).node,), (grid.dim,))
    here = Compare("==", Along("index", (), (grid.other,)), Along("index", (), (grid.dim,)))
    return Field(grid, Traced(Along("sum", (Call("where", (here, sums, ZERO)),), (grid.other,))), row.size)


def joined(parts: Iterable[Any], axis: int = 0) -> Any:
    """Return rows and numbers one after the other."""
    values = [*parts]
    grid = fields_in(values)[0].grid
    sizes = [value.size if isinstance(value, Field) else int(np.size(value)) for value in values]
    if axis not in (0, -1, None) or sum(sizes) > grid.size:
        raise IrregularError("the function joins rows to more numbers than it was given")
    row = Field(grid, Traced(ZERO), sum(sizes))
    first = 0
    for value, size in zip(values, sizes, strict=True):
        if isinstance(value, Field) or size == 1:
            row[first : first + size] = value[0] if isinstance(value, list | tuple) else value
        else:
            row[first : first + size] = np.asarray(value, float)
        first += size
    return row


def split(row: Field, count: Any, axis: int = 0) -> list[Field]:
    """Return parts of equal length."""
    if axis not in (0, -1) or not isinstance(count, int) or row.size % count:
        raise IrregularError("the function splits a row into parts of different lengths")
    n = row.size // count
    return [row[k * n : (k + 1) * n] for k in range(count)]


def rolled(row: Any, places: Any, axis: Any = None) -> Field:
    """Return the elements some places before, the last ones first."""
    if not isinstance(row, Field) or axis not in (None, 0, -1) or not isinstance(places, int):
        raise IrregularError("the function rolls an array")
    k = places % row.size
    if not k:
        return row.copy()
    if row.size == row.grid.size and row.value.node == row.grid.leaf:
        node = row.grid.leaf
        rolled_node = Along("roll", (node,), (row.grid.dim,), places)
        return Field(row.grid, Traced(rolled_node), row.size)
    result: Field = joined([row[-k:], row[:-k]])
    return result


def _differences(row: Any, n: int = 1, axis: int = -1) -> Any:
    if axis not in (0, -1):
        raise IrregularError("the function takes differences along another axis")
    for _ in range(n):
        row = row[1:] - row[:-1]
    return row


def _gradient(row: Field, *spacing: Any) -> Field:
    h = spacing[0] if spacing else 1.0
    result: Field = joined([(row[1:2] - row[0:1]) / h, (row[2:] - row[:-2]) / (2.0 * h), (row[-1:] - row[-2:-1]) / h])
    return result


def _padded(row: Field, width: Any, mode: str = "constant", **options: Any) -> Any:
    before, after = (width, width) if isinstance(width, int) else width
    ends: dict[str, tuple[Any, Any]] = {"edge": (row[0], row[-1]), "constant": (0.0, 0.0), "wrap": (row[-1], row[0])}
    if mode not in ends or options or max(before, after) > 1:
        raise IrregularError("the function pads a row")
    return joined([*[ends[mode][0]] * before, row, *[ends[mode][1]] * after])


def of_rows(function: Any, *arguments: Any, **options: Any) -> Any:
    """Call a function of numpy with rows among its arguments.

    Raises
    ------
    IrregularError
        If it is none of those that are known.
    """
    if isinstance(function, np.ufunc):
        return (
            product(*arguments)
            if function is np.matmul
            else combined(partial(_of_ufunc, function.__name__), *arguments)
        )
    if function not in _RULES:
        raise IrregularError(f"the function calls numpy.{function.__name__} of a row")
    return _RULES[function](*arguments, **options)


def _filled(value: float) -> Callable[..., Field]:
    return lambda row, *_, **__: Field(row.grid, Traced(node_of(value)), row.size, 0)


def _clipped(row: Any, low: Any = None, high: Any = None) -> Any:
    row = row if low is None else combined(partial(_of_ufunc, "maximum"), row, low)
    return row if high is None else combined(partial(_of_ufunc, "minimum"), row, high)


def _norm(row: Field, ord: Any = None, **options: Any) -> Traced:  # noqa: A002 - numpy's
    if ord not in (None, 2):
        raise IrregularError("the function takes another norm of a row")
    return called("sqrt", reduced("sum", combined(partial(_of_ufunc, "multiply"), row, row), **options))


_RULES: dict[Any, Callable[..., Any]] = {
    np.where: lambda condition, yes, no: combined(choice, condition, yes, no),
    np.clip: _clipped,
    np.roll: rolled,
    np.diff: _differences,
    np.gradient: _gradient,
    np.concatenate: joined,
    np.hstack: joined,
    np.append: lambda first, second: joined([first, second]),
    np.pad: _padded,
    np.split: split,
    np.array_split: split,
    np.sum: lambda row, axis=None, **options: reduced("sum", row, axis, **options),
    np.mean: lambda row, axis=None, **options: reduced("sum", row, axis, **options) / row.size,
    np.max: lambda row, axis=None, **options: reduced("max", row, axis, **options),
    np.min: lambda row, axis=None, **options: reduced("min", row, axis, **options),
    np.dot: product,
    np.inner: product,
    np.vdot: product,
    np.linalg.norm: _norm,
    np.zeros_like: _filled(0.0),
    np.empty_like: _filled(0.0),
    np.ones_like: _filled(1.0),
    np.copy: lambda row: row.copy(),
    np.ravel: lambda row: row.copy(),
    np.shape: lambda row: row.shape,
    np.size: lambda row: row.size,
}

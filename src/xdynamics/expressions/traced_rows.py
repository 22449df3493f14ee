"""Rows of numbers along one dimension, however many, traced as one expression of it: elements, slices, arithmetic.

A row is a slice of the dimension, from an element on; its expression means something on that slice alone. Two rows are
joined after one is shifted onto the other. What is no such row, an array of two axes or one picked by a list, raises
`IrregularError`, and its elements are written out instead.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from operator import index as whole_number
from typing import Any, Self

import numpy as np

from xdynamics.expressions.traced_grid import Grid, IrregularError, element, moved
from xdynamics.expressions.tracing import Row, Traced, applied, choice
from xdynamics.expressions.tree import Along, Compare, Number
from xdynamics.faults import InputError

MOST_PIECES = 30  # of a row, each with an expression of its own: conditions in one another


class Line(Row):
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

    def of(self, value: Traced, size: int, offset: int = 0, *, view: bool = False) -> Self:
        """Return another row along the same dimension."""
        return type(self)(self.grid, value, size, offset, view=view)

    @property
    def T(self) -> Self:  # noqa: N802 - numpy's
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
            return self.of(self.value, size, self.offset + first, view=True)
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

    def copy(self) -> Self:
        """Return a row of its own."""
        return self.of(self.value, self.size, self.offset)


def _operator(ufunc: str, *, turned: bool = False) -> Callable[[Any, Any], Any]:
    def joined(self: Any, other: Any) -> Any:
        return combined(partial(of_ufunc, ufunc), *((other, self) if turned else (self, other)))

    return joined


for _word, _ufunc in (
    ("add", "add"),
    ("sub", "subtract"),
    ("mul", "multiply"),
    ("truediv", "divide"),
    ("pow", "power"),
    ("mod", "remainder"),
    ("floordiv", "floor_divide"),
):
    setattr(Line, f"__{_word}__", _operator(_ufunc))
    setattr(Line, f"__r{_word}__", _operator(_ufunc, turned=True))
for _word, _ufunc in (
    ("lt", "less"),
    ("le", "less_equal"),
    ("gt", "greater"),
    ("ge", "greater_equal"),
    ("eq", "equal"),
    ("ne", "not_equal"),
):
    setattr(Line, f"__{_word}__", _operator(_ufunc))
for _word, _ufunc in (("neg", "negative"), ("pos", "positive"), ("abs", "absolute")):
    setattr(Line, f"__{_word}__", lambda self, ufunc=_ufunc: combined(partial(of_ufunc, ufunc), self))


def of_ufunc(ufunc: str, *values: Traced) -> Traced:
    """Apply a function of numpy to single numbers, by its name."""
    result: Traced = applied(ufunc, values)
    return result


def lines_in(values: Iterable[Any]) -> list[Line]:
    """Return the rows among some values and in lists of them."""
    rows: list[Line] = []
    for value in values:
        if isinstance(value, Line):
            rows.append(value)
        elif isinstance(value, list | tuple):
            rows += lines_in(value)
    return rows


def combined(rule: Callable[..., Traced], *values: Any) -> Line:
    """Apply a rule for single numbers to rows, and to what is the same for all elements."""
    rows = [value for value in values if isinstance(value, Line)]
    like = max(rows, key=lambda row: row.size)
    aligned = [_aligned(value, like.grid, like.size, like.offset) for value in values]
    return like.of(rule(*aligned), like.size, like.offset)


def _aligned(value: Any, grid: Grid, size: int, offset: int) -> Traced:
    """Return the expression of an element of a row that begins at another element of the dimension."""
    if isinstance(value, Line):
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

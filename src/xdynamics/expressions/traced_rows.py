"""Rows of numbers along one dimension, however many, traced as one expression of it: elements, slices, arithmetic.

A row is a slice of the dimension, from an element on; its expression means something on that slice alone. Two rows are
joined after one is shifted onto the other. What is no such row, one picked by a list, say, raises `IrregularError`, and
its elements are written out instead. Arrays of two axes are `traced_planes`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial, partialmethod
from operator import index as whole_number
from typing import Any, NamedTuple, Self

import numpy as np

from xdynamics.expressions.traced_grid import Grid, IrregularError, common, element, moved
from xdynamics.expressions.traced_operators import give_operators
from xdynamics.expressions.tracing import Row, Traced, applied, choice, node_of
from xdynamics.expressions.tree import Along, Compare, Node, Number
from xdynamics.faults import InputError

MOST_PIECES = 30  # of a row, each with an expression of its own: conditions in one another


class Change(NamedTuple):
    """What was done in place to a part of an array, which is yet to be put back: ``d[1:] += x``."""

    whole: Line
    key: Any
    ufunc: str
    by: Traced
    neutral: float  # the number by which nothing changes


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
    part_of: tuple[Line, Any] | None = None
    change: Change | None = None

    def __init__(self, grid: Grid, value: Traced, size: int, offset: int = 0, *, view: bool = False) -> None:
        self.grid, self.value, self.size, self.offset, self.view, self.pieces = grid, value, size, offset, view, 1
        self.shape = (size,)

    def of(self, value: Traced, size: int, offset: int = 0, *, view: bool = False) -> Self:
        """Return another row along the same dimension."""
        return type(self)(self.grid, value, size, offset, view=view)

    def alike(self, value: Traced) -> Self:
        """Return another expression at the same places."""
        return self.of(value, self.size, self.offset)

    def check(self, other: Line) -> None:
        """Refuse an array that numpy would not join with this one element by element.

        Raises
        ------
        IrregularError
            If it has another number of axes.
        ValueError
            If it has another shape, as numpy says it.
        """
        if other.ndim != self.ndim:
            raise IrregularError(f"the function joins arrays of shapes {self.shape} and {other.shape}")
        if other.shape != self.shape:
            raise ValueError(f"operands could not be broadcast together with shapes {self.shape} {other.shape}")

    def constant(self, numbers: Any) -> Node:
        """Return the expression of numbers at these places.

        Raises
        ------
        IrregularError
            If they are of another shape.
        """
        if numbers.ndim > 1 or numbers.size not in (1, self.size):
            raise IrregularError(
                f"the function joins a row of {self.size} numbers and an array of shape {numbers.shape}"
            )
        return self.grid.constant(numbers.ravel(), self.offset)

    def pitch(self, _axis: int) -> int:
        """Return how far apart neighbours along an axis are in the dimension."""
        return 1

    @property
    def last(self) -> int:
        """The element of the dimension that is the last here."""
        return self.offset + self.size - 1

    def limits(self) -> list[Traced]:
        """Return conditions that elements between the first and the last meet."""
        return []

    def displaced(self, places: int, axis: int = 0) -> Traced:
        """Return the elements some places before along an axis, the last ones first, as an expression.

        Raises
        ------
        IrregularError
            If there is no such axis.
        """
        if axis not in (0, -1):
            raise IrregularError("the function rolls a row along another axis")
        return self.around(places, self.size, 1, Traced(Along("index", (), (self.grid.dim,))) < self.offset + places)

    def around(self, places: int, count: int, width: int, begins: Traced) -> Traced:
        """Return the elements some places before, of `count` that are `width` apart; the first ones are the last."""
        node = self.value.node
        before, after = (moved(node, k * width, self.grid) for k in (places - count, places))
        return choice(begins, Traced(before, self.value.nodes), Traced(after, self.value.nodes))

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
        key = key[0] if isinstance(key, tuple) and len(key) == 1 else key
        first, size = slice_of(key, self.size)
        if isinstance(key, slice) or key is Ellipsis:
            return self.part(self.of(self.value, size, self.offset + first, view=True), key)
        return Traced(element(self.value.node, self.offset + first, self.grid))

    def part(self, part: Self, key: Any) -> Self:
        """Return a part that knows of what."""
        part.part_of = self, key
        return part

    def __setitem__(self, key: Any, values: Any) -> None:
        key = key[0] if isinstance(key, tuple) and len(key) == 1 else key
        if isinstance(key, Line):
            self.choose(key, values)
            return
        first, size = slice_of(key, self.size)
        self.count_piece()
        begin, old, new = self.offset + first, *self.replacement(key, values)
        new = aligned(values, self.of(self.value, size, begin)) if new is None else new
        for at, inside in ((begin + size, False), (begin, True)):
            if self.offset < at < self.offset + self.size:
                before = Compare("<", Along("index", (), (self.grid.dim,)), Number(float(at)))
                new = choice(Traced(before), *((old, new) if inside else (new, old)))
        self.put(values, new)

    def count_piece(self) -> None:
        """Refuse one more piece with an expression of its own.

        Raises
        ------
        IrregularError
            If there are too many, or this is part of another array.
        """
        self.pieces += 1
        if self.view or self.pieces > MOST_PIECES:
            raise IrregularError("the function fills an array by elements")

    def choose(self, condition: Line, value: Any) -> None:
        """Set the elements for which a condition holds, all to one number: ``d[d < 0] = 0``.

        Raises
        ------
        IrregularError
            If the value is an array, of which numpy would take one element after the other.
        """
        self.count_piece()
        if isinstance(value, Line) or np.ndim(value):
            raise IrregularError("the function sets chosen elements to those of another array")
        self.value = choice(aligned(condition, self), value, self.value)

    def replacement(self, key: Any, values: Any) -> tuple[Any, Traced | None]:
        """Return what stands outside a part that is set, and inside, if that is a change of what was there.

        A change is written once, beside what was there: ten of them in place are not ten levels of choices.
        """
        change = values.change if isinstance(values, Line) else None
        if change is None or change.whole is not self or change.key != key:
            return self.value, None
        return change.neutral, change.by

    def put(self, values: Any, new: Traced) -> None:
        """Set the expression to one in which a part was replaced, or join one with a part's change."""
        change = values.change if isinstance(values, Line) else None
        is_change = change is not None and change.whole is self
        self.value = of_ufunc(change.ufunc, self.value, new) if change is not None and is_change else new

    def changed(self, ufunc: str, neutral: float, other: Any) -> Any:
        """Do something in place."""
        new = combined(partial(of_ufunc, ufunc), self, other)
        if self.part_of is not None and new.shape == self.shape:
            whole, key = self.part_of
            new.change = Change(whole, key, ufunc, aligned(other, self), neutral)
        return new

    def copy(self) -> Self:
        """Return a row of its own."""
        return self.of(self.value, self.size, self.offset)


def slice_of(key: Any, size: int, axis: int = 0) -> tuple[int, int]:
    """Return the first of some neighbours along an axis, and how many they are.

    Raises
    ------
    IrregularError
        If they are no neighbours.
    IndexError
        Beyond the end, as numpy says it.
    """
    if key is Ellipsis:
        return 0, size
    if isinstance(key, slice):
        first, last, step = key.indices(size)
        if step != 1 or last <= first:
            raise IrregularError("the function takes elements of a row that are not neighbours")
        return first, last - first
    try:
        number = whole_number(key)
    except (TypeError, InputError):
        raise IrregularError("the function picks elements of a row by a list, or an axis") from None
    if not -size <= number < size:
        raise IndexError(f"index {number} is out of bounds for axis {axis} with size {size}")
    return number % size, 1


give_operators(Line, lambda ufunc, *values: combined(partial(of_ufunc, ufunc), *values))
for _word, _ufunc, _neutral in (("add", "add", 0.0), ("sub", "subtract", 0.0), ("mul", "multiply", 1.0)):
    setattr(Line, f"__i{_word}__", partialmethod(Line.changed, _ufunc, _neutral))


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
    # a single number stays one: a whole exponent is not that of a logarithm
    single = [value if isinstance(value, int | float) else aligned(value, like) for value in values]
    return like.alike(rule(*single))


def aligned(value: Any, like: Line) -> Traced:
    """Return the expression of an element of a row, or of what is joined with it, at the places of another row.

    Raises
    ------
    IrregularError
        If they cannot be joined element by element.
    """
    if isinstance(value, Line):
        if value.size == 1:
            return Traced(element(value.value.node, value.offset, value.grid))
        like.check(value)
        return Traced(moved(value.value.node, like.offset - value.offset, like.grid), value.value.nodes)
    if isinstance(value, Traced):
        return value
    numbers = np.asarray(value)
    if numbers.dtype == object:
        elements = np.broadcast_to(numbers, like.shape)
        if elements.ndim > 1 and like.size > 1 and numbers.size == 1:
            return numbers.item()  # type: ignore[no-any-return]
        return Traced(common([node_of(one) for one in elements.ravel()], partial(_constant, like)))
    return Traced(like.constant(numbers))


def _constant(like: Line, numbers: list[float]) -> Node:
    return like.constant(np.reshape(numbers, like.shape))

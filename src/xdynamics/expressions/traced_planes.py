"""Arrays of two axes traced as a whole: a window of rows of equal length, along one dimension.

Element (i, j) is ``offset + i*width + j`` of the dimension, and the expression of an element means something there alone.
Windows of one shape are joined after one is shifted onto the other, so that a stencil of any number of points is one
expression, as it is of a row.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple, Self

import numpy as np

from xdynamics.expressions.fields import Field
from xdynamics.expressions.traced_grid import Grid, IrregularError, element
from xdynamics.expressions.traced_rows import MOST_PIECES, Line, aligned, slice_of
from xdynamics.expressions.tracing import Traced, called, choice
from xdynamics.expressions.tree import Along, Node, Number


class Window(NamedTuple):
    """Which elements of a dimension an array of two axes has.

    Attributes
    ----------
    rows, columns : int
    width : int
        From the beginning of a row to that of the next one.
    offset : int
        The element of the dimension that is the first here.
    turned : bool
        Whether numpy's first axis is along a row.
    flat : bool
        Whether it is a column, which numpy takes for an array of one axis.
    """

    rows: int
    columns: int
    width: int
    offset: int = 0
    turned: bool = False
    flat: bool = False

    @property
    def shape(self) -> tuple[int, ...]:
        """As numpy has it."""
        if self.flat:
            return (self.rows,)
        return (self.columns, self.rows) if self.turned else (self.rows, self.columns)

    @property
    def is_dense(self) -> bool:
        """Whether nothing is between one row and the next."""
        return self.columns == self.width or self.rows == 1

    @property
    def last(self) -> int:
        """The element of the dimension that is the last here."""
        return self.offset + (self.rows - 1) * self.width + self.columns - 1


class Plane(Field):
    """A window of rows that are not known.

    Parameters
    ----------
    grid : Grid
    value : Traced
        The expression of an element.
    window : Window
    view : bool
        Whether it is part of another array, which numpy would change with it.
    """

    def __init__(self, grid: Grid, value: Traced, window: Window, *, view: bool = False) -> None:
        super().__init__(grid, value, window.rows * window.columns, window.offset, view=view)
        self.window = window
        self.shape = window.shape  # type: ignore[assignment]
        self.ndim = len(self.shape)

    def alike(self, value: Traced) -> Self:
        """Return another expression at the same places."""
        return type(self)(self.grid, value, self.window)

    copy = lambda self: self.alike(self.value)  # noqa: E731

    def blank(self, shape: tuple[int, int]) -> Self:
        """Return zeros in another shape.

        Raises
        ------
        IrregularError
            If there are more than in the whole.
        """
        if shape[0] * shape[1] > self.grid.size:
            raise IrregularError("the function makes more numbers than it was given")
        return type(self)(self.grid, Traced(Number(0.0)), Window(*shape, shape[1]))

    def check(self, other: Line) -> None:
        """Refuse an array that numpy would not join with this one element by element.

        Raises
        ------
        IrregularError
            If its rows are not as far apart as here.
        """
        super().check(other)
        own, others = self.window, other.window if isinstance(other, Plane) else None
        if not others or own.turned != others.turned or (own.width != others.width and own.rows > 1):
            raise IrregularError(f"the function joins arrays of shapes {self.shape} and {other.shape}")

    def constant(self, numbers: Any) -> Node:
        """Return the expression of numbers at these places."""
        if numbers.size == 1:
            return self.grid.constant(numbers.ravel(), 0)
        wide = np.broadcast_to(numbers, self.shape)
        wide = wide.T if self.window.turned else wide.reshape(self.window.rows, self.window.columns)
        if (wide == wide.flat[0]).all():
            return self.grid.constant(wide.flat[:1], 0)
        full = np.zeros(self.grid.size)
        for i, row in enumerate(wide):
            begin = self.offset + i * self.window.width
            full[begin : begin + self.window.columns] = row
        return self.grid.constant(full, 0)

    @property
    def T(self) -> Self:  # noqa: N802 - numpy's
        """The array with its axes exchanged; a column is as it was."""
        turned = not self.window.flat and not self.window.turned
        return type(self)(self.grid, self.value, self.window._replace(turned=turned), view=True)

    def transpose(self) -> Self:
        """Return it with its axes exchanged."""
        return self.T

    def __len__(self) -> int:
        return self.shape[0]

    def __iter__(self) -> Iterator[Any]:
        if len(self) > MOST_PIECES:
            raise IrregularError("the function goes through an array")
        return (self[i] for i in range(len(self)))

    def __getitem__(self, key: Any) -> Any:
        part = self._part(key)
        if part is None:
            first, left = (number for number, _ in self._places(key))
            return Traced(element(self.value.node, self.offset + first * self.window.width + left, self.grid))
        part.view = True
        part.part_of = self, key
        return part

    def __setitem__(self, key: Any, values: Any) -> None:
        if isinstance(key, Line):
            self.choose(key, values)
            return
        (first, rows), (left, columns) = self._places(key)
        self.count_piece()
        inside = self._part(key) or Field(self.grid, self.value, 1, self.offset + first * self.window.width + left)
        old, new = self.replacement(key, values)
        new = aligned(values, inside) if new is None else new
        edges = [
            (is_before(end), is_end)
            for is_before, end, whole, is_end in (
                (self.row_before, first + rows, self.window.rows, True),
                (self.row_before, first, 0, False),
                (self.column_before, left + columns, self.window.columns, True),
                (self.column_before, left, 0, False),
            )
            if end != whole
        ]
        if len(edges) > 1:  # what was there before is written once, however many edges
            is_inside: Any = 1.0
            for before, is_end in edges:
                is_inside = choice(before, *((is_inside, 0.0) if is_end else (0.0, is_inside)))
            new = choice(is_inside > 0.5, new, old)
        for before, is_end in edges if len(edges) == 1 else ():
            new = choice(before, *((new, old) if is_end else (old, new)))
        self.put(values, new)

    def row_before(self, row: int) -> Traced:
        """Return whether an element is in a row before another."""
        is_before: Traced = self._index < self.offset + row * self.window.width
        return is_before

    def column_before(self, column: int) -> Traced:
        """Return whether an element is in a column before another."""
        shift = -self.offset % self.window.width
        index = self._index + shift if shift else self._index
        is_before: Traced = called("mod", index, self.window.width) < column
        return is_before

    @property
    def _index(self) -> Any:
        return Traced(Along("index", (), (self.grid.dim,)))

    @property
    def last(self) -> int:
        """The element of the dimension that is the last here."""
        return self.window.last

    def limits(self) -> list[Traced]:
        """Return conditions that elements between the first and the last meet."""
        return [] if self.window.is_dense else [self.column_before(self.window.columns)]

    def displaced(self, places: int, axis: int = 0) -> Traced:
        """Return the elements some places before along an axis, the last ones first, as an expression."""
        if self.pitch(axis) == 1:
            return self.around(places, self.window.columns, 1, self.column_before(places))
        return self.around(places, self.window.rows, self.window.width, self.row_before(places))

    def pitch(self, axis: int) -> int:
        """Return how far apart neighbours along an axis are in the dimension."""
        return 1 if not self.window.flat and axis % 2 != self.window.turned else self.window.width

    def _places(self, key: Any) -> tuple[tuple[int, int], tuple[int, int]]:
        """Return first row and rows, first column and columns."""
        row, column = self._keys(key)
        return slice_of(row, self.window.rows), slice_of(column, self.window.columns)

    def _keys(self, key: Any) -> tuple[Any, Any]:
        keys: tuple[Any, ...] = key if isinstance(key, tuple) else (key,)
        if any(part is Ellipsis for part in keys):
            place = next(i for i, part in enumerate(keys) if part is Ellipsis)
            keys = keys[:place] + (slice(None),) * (self.ndim + 1 - len(keys)) + keys[place + 1 :]
        if not 0 < len(keys) <= self.ndim:
            raise IrregularError("the function takes elements of an array of two axes that are no window of it")
        row, column = keys if len(keys) == 2 else (keys[0], slice(None))
        return (column, row) if self.window.turned else (row, column)

    def _part(self, key: Any) -> Field | None:
        """Return a part, a row or a column; None where it is one element."""
        window, (row, column) = self.window, self._keys(key)
        (first, rows), (left, columns) = self._places(key)
        offset = self.offset + first * window.width + left
        one_row, flat = not isinstance(row, slice), window.flat or not isinstance(column, slice)
        if one_row:
            return None if flat else Field(self.grid, self.value, columns, offset)
        turned = window.turned and not flat
        return type(self)(self.grid, self.value, Window(rows, columns, window.width, offset, turned, flat))

    def ravel(self, order: str = "C") -> Any:
        """Return all rows one after the other.

        Raises
        ------
        IrregularError
            If something is between them.
        """
        window = self.window
        if order != ("F" if window.turned else "C") or not (window.is_dense or window.columns == 1):
            raise IrregularError("the function joins the rows of a window")
        if window.columns == 1 and not window.is_dense:
            return type(self)(self.grid, self.value, window._replace(flat=True, turned=False))
        return Field(self.grid, self.value, self.size, self.offset)

    flatten = ravel


def reshaped(array: Field, *shape: Any, order: str = "C") -> Any:
    """Return the same numbers in another shape: a row, rows of equal length, or several arrays of these.

    Raises
    ------
    IrregularError
        If it has more axes, or the array is a window.
    """
    wanted = [*(shape[0] if len(shape) == 1 and isinstance(shape[0], tuple | list) else shape)]
    if -1 in wanted:
        wanted[wanted.index(-1)] = array.size // -int(np.prod(wanted))
    if int(np.prod(wanted)) != array.size or len(wanted) > 3 or (order == "F" and len(wanted) > 2):
        raise IrregularError(f"the function makes an array of shape {tuple(wanted)} of {array.size} numbers")
    row: Field = array.ravel() if isinstance(array, Plane) else array
    if len(wanted) == 1:
        return row.copy()
    *outer, rows, columns = wanted[::-1] if order == "F" else wanted
    planes = [
        Plane(row.grid, row.value, Window(rows, columns, columns, row.offset + k * rows * columns, turned=order == "F"))
        for k in range(outer[0] if outer else 1)
    ]
    return planes if outer else planes[0]


Field.reshaping = reshaped

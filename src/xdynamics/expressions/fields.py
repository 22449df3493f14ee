"""Rows of numbers traced as a whole, with numpy's methods and functions; arrays of two axes are `traced_planes`."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar

import numpy as np

from xdynamics.expressions.numpy_rules import of_rows
from xdynamics.expressions.reductions import product, reduced
from xdynamics.expressions.traced_grid import Grid, IrregularError
from xdynamics.expressions.traced_rows import Line, combined, of_ufunc
from xdynamics.expressions.tracing import Traced


class Field(Line):
    """A row of numbers that are not known, as numpy takes it for an array."""

    def __array_ufunc__(self, ufunc: Any, how: str, *given: Any, **options: Any) -> Any:
        """Apply a function of numpy to every element."""
        if how != "__call__" or options:
            raise IrregularError(f"the function calls numpy.{ufunc.__name__}.{how} of a row")
        if ufunc is np.matmul:
            return product(*given)
        return combined(partial(of_ufunc, ufunc.__name__), *given)

    def __array_function__(self, function: Any, _types: Any, arguments: Any, options: Any) -> Any:
        """Call a function of numpy."""
        return of_rows(function, *arguments, **options)

    reshaping: ClassVar[Callable[..., Any]]  # is `traced_planes.reshaped`, which makes arrays of these rows

    flatten = ravel = Line.copy

    def reshape(self, *shape: Any, **options: Any) -> Any:
        """Return the same numbers in another shape, as `traced_planes.reshaped` does."""
        return Field.reshaping(self, *shape, **options)

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


def unknown(grid: Grid) -> Field:
    """Return the row of all numbers that are not known."""
    return Field(grid, Traced(grid.leaf), grid.size)

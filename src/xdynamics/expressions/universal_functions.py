"""numpy's universal functions for traced numbers, with the methods that numpy gives them: `np.add.at`, `np.subtract.outer`."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from xdynamics.expressions.traced_arrays import is_traced, of_numpy
from xdynamics.faults import InputError

_REDUCING = {np.add: np.sum, np.multiply: np.prod, np.maximum: np.max, np.minimum: np.min}
_ACCUMULATING = {np.add: np.cumsum, np.multiply: np.cumprod}


class UniversalFunction(partial):  # type: ignore[type-arg]
    """A function of numpy that takes numbers and arrays element by element, some of them traced."""

    def __new__(cls, ufunc: np.ufunc) -> UniversalFunction:
        """Return what stands for one of numpy's."""
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
        """Change elements in place one after the other, also one that is named twice."""
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

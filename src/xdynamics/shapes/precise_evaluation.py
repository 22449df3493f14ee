"""How far values of expressions with dimensions are off because they are rounded, by the same with 31 digits."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import Along, Name, Node
from xdynamics.expressions.precise_values import PI, SUMS, PreciseArray, evaluate_precisely
from xdynamics.expressions.tree import every
from xdynamics.shapes.evaluation import Walk
from xdynamics.shapes.extents import Shapes

Array = NDArray[np.float64]

_SUMS_OF_ENDS = "onto"  # of which there is no value with 31 digits: derivatives alone have them


def rounding_errors(
    node: Node,
    dims: tuple[str, ...],
    values: Mapping[str, Any],
    shapes: Shapes,
    rounded_values: Array,
    extra_dim: str = "",
) -> Array:
    """Return what rounding did to the values of an expression: they less those with 31 digits, with pi in full.

    Parameters
    ----------
    node, dims, values, shapes, extra_dim
        As for `evaluate_elements`.
    rounded_values : ndarray, shape of `dims`
        What that returned.

    Returns
    -------
    ndarray, shape of `dims`
        0 where values are not finite.

    Raises
    ------
    InputError
        If a name has no value.
    """
    if any(isinstance(part, Along) and part.function == _SUMS_OF_ENDS for part in every(node)):
        return np.zeros(np.shape(rounded_values))
    high, low = _PreciseWalk({**values, "pi": PI}, shapes, extra_dim).precisely_along(node, dims)
    with np.errstate(all="ignore"):
        errors = (rounded_values - high) - low
    return np.where(np.isfinite(errors), errors, 0.0)


class _PreciseWalk(Walk):
    """Evaluates parts as sums of two floats."""

    def precisely_along(self, node: Node, dims: tuple[str, ...]) -> tuple[Array, Array]:
        """Return the value of an expression along some dimensions, in both parts."""
        value = self.value(node)
        parts = (part if part.ndim == len(self.axes) else part.reshape(()) for part in (value.high, value.low))
        high, low = (self.spread(part, dims) for part in parts)
        return high, low

    def value(self, node: Node) -> PreciseArray:
        """Return the value of an expression."""
        return evaluate_precisely(self.replaced(node), self.values)

    def value_along_dimensions(self, node: Along) -> Any:
        """Return the value of a function along dimensions: of one that only moves elements, of both parts."""
        if node.function in ("index", "size"):
            return super().value_along_dimensions(node)
        if node.function in ("first", "second", "shift", "roll", "take"):
            value_count = (
                2 if node.function == "shift" else 1
            )  # arguments that have values; others are numbers of elements
            values = [self.value(argument) for argument in node.arguments[:value_count]]
            return PreciseArray(
                *(self._shifted_value(node, [getattr(value, part) for value in values]) for part in ("high", "low"))
            )
        return self._cross_product(node) if node.function == "cross" else self._reduced_precisely(node)

    def _shifted_value(self, node: Along, values: list[Array]) -> Any:
        names = [f"_part_{i}" for i in range(len(values))]
        arguments = (*map(Name, names), *node.arguments[len(values) :])
        walk = Walk(dict(zip(names, values, strict=True)), self.shapes, self.extra_dim)
        return walk.value_along_dimensions(Along(node.function, arguments, node.dims, node.places, node.column))

    def _full_arguments(self, node: Along) -> list[PreciseArray]:
        """Return the arguments of a function with all elements along its dimensions."""
        return [self.value(argument).of_parts(lambda part: self.full(part, node.dims)) for argument in node.arguments]

    def _cross_product(self, node: Along) -> PreciseArray:
        """Return a cross product: of each element's next in one factor by the last of the three in the other, less its mirror."""
        axis = self.axes.index(node.dims[0])
        (a_next, a_last), (b_next, b_last) = (
            [value.of_parts(lambda part, step=step: np.roll(part, -step, axis)) for step in (1, 2)]  # type: ignore[misc]
            for value in self._full_arguments(node)
        )
        return a_next * b_last + -(a_last * b_next)

    def _reduced_precisely(self, node: Along) -> PreciseArray:
        """Reduce a value along dimensions; with so many digits the order is of no account, and pairs are fast."""
        parts = self._full_arguments(node)
        if node.function in ("dot", "norm"):
            parts = [parts[0] * parts[-1]]
        axes = [self.axes.index(dim) for dim in node.dims]
        total = parts[0].of_parts(lambda part: np.moveaxis(part, axes, range(len(axes))))
        total = total.of_parts(lambda part: part.reshape(-1, *part.shape[len(axes) :]))
        count = len(total.high)
        total = _join_pairwise(total, SUMS.choices.get(node.function, SUMS.operators["+"]))
        total = total.of_parts(lambda part: np.expand_dims(part[0], sorted(axes)))
        if node.function == "mean":
            return SUMS.operators["/"](total, float(count))  # type: ignore[no-any-return]
        return SUMS.functions["sqrt"](total) if node.function == "norm" else total


def _join_pairwise(rows: PreciseArray, join: Callable[..., PreciseArray]) -> PreciseArray:
    """Join the rows of an array two by two until one is left."""
    while (size := len(rows.high)) > 1:
        first, second, left = (
            PreciseArray(rows.high[part], rows.low[part])
            for part in (slice(0, size // 2), slice(size // 2, size // 2 * 2), slice(size // 2 * 2, size))
        )
        joined_rows = join(first, second)
        rows = PreciseArray(np.concatenate([joined_rows.high, left.high]), np.concatenate([joined_rows.low, left.low]))
    return rows

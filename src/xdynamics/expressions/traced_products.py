"""Products of traced arrays that are summed along axes: Einstein's sums, and the products of matrices that they write."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from xdynamics.expressions.real_numbers import real
from xdynamics.expressions.traced_cubes import Cube, applied_to, combined, shape_of
from xdynamics.expressions.traced_grid import Grid, IrregularError
from xdynamics.expressions.traced_indices import axis, index

LETTERS = "abcdefghijklmnopqrstuvwxyz"


def einstein_sum(subscripts: Any, *operands: Any, **options: Any) -> Any:
    """Return products of arrays, summed along the axes whose letters the result has not: `numpy.einsum`.

    Raises
    ------
    IrregularError
        If the letters are given in another way than as a text without an ellipsis, or more is asked for.
    ValueError
        If they do not fit the arrays, as numpy says it.
    """
    options.pop("optimize", None)
    if not isinstance(subscripts, str) or "." in subscripts or options:
        raise IrregularError("the function calls numpy.einsum with an ellipsis, lists of axes, or options")
    given, arrow, result = subscripts.replace(" ", "").partition("->")
    terms = given.split(",")
    letters = sorted({letter for term in terms for letter in term})
    kept = result if arrow else "".join(letter for letter in letters if given.count(letter) == 1)
    # numpy's own faults, of shapes and letters, from arrays of nothing
    shape = np.einsum(subscripts, *(np.broadcast_to(0.0, shape_of(operand)) for operand in operands)).shape
    sizes: dict[str, int] = {}
    for term, operand in zip(terms, operands, strict=True):
        for letter, size in zip(term, shape_of(operand), strict=True):
            sizes[letter] = max(size, sizes.get(letter, 1))
    order = kept + "".join(letter for letter in letters if letter not in kept)
    grid = next(operand.grid for operand in operands if isinstance(operand, Cube))
    factors = [_along(operand, term, order, sizes, grid) for term, operand in zip(terms, operands, strict=True)]
    product = factors[0]
    for factor in factors[1:]:
        product = combined(partial(applied_to, "multiply"), product, factor)
    whole = Cube(grid, product.value, tuple(sizes[letter] for letter in order))
    summed = tuple(range(len(kept), len(order)))
    total = whole.sum(summed) if summed else whole
    return total if shape else total[()] if isinstance(total, Cube) else total


def _along(operand: Any, term: str, order: str, sizes: dict[str, int], grid: Grid) -> Any:
    """Return an array with an axis for every letter, along which it is the same where it has not the letter."""
    full = tuple(sizes[letter] for letter in order)
    if isinstance(operand, Cube):
        dims = [axis(grid, size, len(order) - 1 - k) for k, size in enumerate(full)]
        return operand.at(
            full,
            [
                None if n == 1 else index(dims[order.index(letter)])
                for letter, n in zip(term, operand.shape, strict=True)
            ],
        )
    own = "".join(dict.fromkeys(term))
    numbers = np.einsum(
        f"{term}->{''.join(letter for letter in order if letter in own)}", np.asarray(real(operand), float)
    )
    return numbers.reshape([n if letter in own else 1 for letter, n in zip(order, full, strict=True)])


def matrix_product(first: Any, second: Any) -> Any:
    """Return `first @ second`: the last axis of one with the last but one of the other, or its only one.

    Raises
    ------
    IrregularError
        If one has no axis, or more than two.
    """
    one, other = len(shape_of(first)), len(shape_of(second))
    if not one or not other or max(one, other) > 2:
        raise IrregularError("the function multiplies arrays of other than one and two axes as matrices")
    left, right = "ab"[2 - one :], "bc"[:other]
    return einstein_sum(f"{left},{right}->{left[:-1]}{right[1:]}", first, second)


def outer_product(first: Any, second: Any) -> Any:
    """Return `numpy.outer`."""
    rows = [value.ravel() if isinstance(value, Cube) else np.ravel(value) for value in (first, second)]
    return einstein_sum("a,b->ab", *rows)


def tensor_product(first: Any, second: Any, axes: Any = 2) -> Any:
    """Return `numpy.tensordot`."""
    one, other = len(shape_of(first)), len(shape_of(second))
    pairs = (range(one - axes, one), range(axes)) if isinstance(axes, int) else axes
    mine, theirs = ([k] if isinstance(k, int) else [*k] for k in pairs)
    left, right = [*LETTERS[:one]], [*LETTERS[one : one + other]]
    for k, n in zip(mine, theirs, strict=True):
        right[n] = left[k]
    result = [letter for letter in (*left, *right) if (letter in left) != (letter in right)]
    return einstein_sum(f"{''.join(left)},{''.join(right)}->{''.join(result)}", first, second)


PRODUCTS: dict[Any, Callable[..., Any]] = {
    np.einsum: einstein_sum,
    np.matmul: matrix_product,
    np.dot: matrix_product,
    np.outer: outer_product,
    np.tensordot: tensor_product,
    np.trace: lambda array: einstein_sum("aa", array),
}

Cube.__matmul__ = Cube.dot = matrix_product  # type: ignore[attr-defined, operator]
Cube.__rmatmul__ = lambda second, first: matrix_product(first, second)  # type: ignore[attr-defined]

"""Numbers of elements that expressions compute: of `take`, made of `index`, `size` and numbers, known before a march."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import Along, Binary, Call, Compare, Element, Name, Negative, Node, Number, shortened_text
from xdynamics.expressions.evaluation import evaluate_many
from xdynamics.expressions.tree import every
from xdynamics.faults import InputError
from xdynamics.shapes.extents import Shapes

IntArray = NDArray[np.int64]
MOST_CHECKED = (
    100_000  # numbers that are computed to check an expression; those of more are checked where they are used
)


def is_of_numbers(node: Node) -> bool:
    """Whether an expression is made of `index`, `size` and numbers alone."""
    return not any(
        isinstance(part, Name | Element) or (isinstance(part, Along) and part.function not in ("index", "size"))
        for part in every(node)
    )


def check_number_of_element(node: Along, dims: tuple[str, ...], shapes: Shapes) -> None:
    """Refuse the number of an element that changes along a motion, or is none of an element.

    Parameters
    ----------
    node : Along
        A `take`.
    dims : tuple of str
        Of the number.
    shapes : Shapes

    Raises
    ------
    InputError
        If it reads a quantity, or is beyond the last element.
    """
    if not is_of_numbers(number := node.arguments[1]):
        raise InputError(
            f"'{shortened_text(node)}' (column {node.column}): the number of the element is '{shortened_text(number)}', which may be"
            " written with index(dimension), size(dimension) and numbers alone"
        )
    shape = shapes.shape(dims)
    if prod(shape) <= MOST_CHECKED:
        taken_numbers(node, dict(zip(dims, np.ix_(*map(np.arange, shape)), strict=True)), shapes)


def with_index_names(node: Node, shapes: Shapes) -> Node:
    """Return an expression in which numbers of elements are names: ``index site``."""
    match node:
        case Along(function="index"):
            return Name(f"index {node.dims[0]}")
        case Along():
            return Number(float(shapes.extent(node.dims[0]).size))
        case Negative():
            return replace(node, operand=with_index_names(node.operand, shapes))
        case Binary() | Compare():
            return replace(node, left=with_index_names(node.left, shapes), right=with_index_names(node.right, shapes))
        case Call():
            return replace(node, arguments=tuple(with_index_names(argument, shapes) for argument in node.arguments))
    return node


def taken_numbers(node: Along, grid: Mapping[str, Any], shapes: Shapes) -> IntArray:
    """Return which elements `take` takes where the number along each dimension is known.

    Parameters
    ----------
    node : Along
        A `take`.
    grid : mapping of str to ndarray of int64
        Arrays that broadcast together.
    shapes : Shapes

    Raises
    ------
    InputError
        If a number is none of an element.
    """
    values = {f"index {dim}": np.asarray(numbers, float) for dim, numbers in grid.items()}
    return whole_numbers(node, evaluate_many(with_index_names(node.arguments[1], shapes), values), shapes)


def whole_numbers(node: Along, computed_numbers: Any, shapes: Shapes) -> IntArray:
    """Return numbers of elements as whole ones.

    Raises
    ------
    InputError
        If one is none of an element.
    """
    numbers, size = np.asarray(computed_numbers, float), shapes.extent(node.dims[0]).size
    wrong = ~((numbers >= 0.0) & (numbers < size) & (numbers == np.floor(numbers)))
    if wrong.any():
        raise InputError(
            f"'{shortened_text(node)}' (column {node.column}) takes element {float(numbers[wrong].flat[0]):g} of '{node.dims[0]}',"
            f" needs whole numbers from 0 to {size - 1}; mod(number, size({node.dims[0]})) goes round"
        )
    return numbers.astype(np.int64)

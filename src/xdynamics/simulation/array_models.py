"""Right-hand sides that are written with arrays, as models with a dimension: one state y along y_index."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from xdynamics.expressions import Along, Call, Compare, Element, Name, Node, Number, text_of
from xdynamics.expressions.element_folding import IrregularError, Unfolding, term_count
from xdynamics.expressions.repeating import NEGLIGIBLE, check_numbers
from xdynamics.expressions.substitution import Substitution, table_values
from xdynamics.expressions.traced_arrays import array_of
from xdynamics.expressions.tracing import Traced, node_of, traced_name
from xdynamics.expressions.tree import every
from xdynamics.faults import InputError
from xdynamics.shapes import Extent, Shapes
from xdynamics.shapes.evaluation import evaluate_elements
from xdynamics.simulation.right_sides import (
    Floats,
    RightSide,
    WrittenFunction,
    call_with_names,
    call_with_numbers,
    check_repeating,
    event_sections,
    function_name,
    interpolated_drive,
    start_numbers,
    write_with_arguments,
)
from xdynamics.units import parse_time

MOST_TRACED = 30_000  # numbers of y0: each is traced by itself
MOST_WRITTEN_OUT = 300  # numbers whose expressions follow no rule, and are written one after the other
COMPARED = 24  # elements whose expressions are compared with numbers
Kinds = tuple[type, ...]
Written = tuple[list[WrittenFunction], Unfolding]


def array_sections(
    functions: list[RightSide], word: str | None, starts: list[str], units: list[str], t_span: Any, args: Any
) -> dict[str, Any] | None:
    """Return the sections of a model with one state along a dimension; None if the function is written with numbers.

    Of a function that returns a list of numbers only where the state has a name, `word`; else it is y.

    Raises
    ------
    InputError
        If it does what cannot be traced, or its elements have no expression in common and are many.
    """
    if len(set(units)) > 1:
        return None
    if len(starts) > MOST_TRACED:
        raise InputError(
            f"y0 has {len(starts)} numbers, and each is traced by itself, {MOST_TRACED} at most; write the model with"
            " [dimensions], as `xdynamics help shapes` says: it has an expression for all of them, however many there are"
        )
    arrays: Kinds = (np.ndarray,) if word is None else (np.ndarray, list, tuple)
    word = word or "y"
    scale = f"unit_{word}"
    unit = Traced(Name(scale)) if units[0] != "1" else None
    elements = [Traced(Element(word, (k,))) for k in range(len(starts))]
    y = array_of([element if unit is None else element / unit for element in elements])
    tables = Substitution()
    write = partial(_write_arrays, functions, tables, y, word, arrays)
    (written_functions, unfolding), arguments, parameters = write_with_arguments(write, functions[0], args, [word])
    if not written_functions:
        return None
    numbers = start_numbers(starts, units)
    _check_numbers(written_functions, unfolding, t_span, numbers, arguments, args, tables)
    rate = node_of((1.0 if unit is None else unit) * written_functions[0].values[0] / traced_name("second"))
    dense = {
        label: {"dims": [*dims], "value": values.tolist(), "unit": "1"}
        for label, (dims, values) in unfolding.parameters.items()
    }
    return {
        "dimensions": _dimension_sizes(written_functions, unfolding),
        "states": {word: {"unit": units[0], "dims": [unfolding.dim], "rate": text_of(rate)}},
        "events": event_sections(written_functions[1:]),
        "parameters": parameters | ({} if unit is None else {scale: f"1 {units[0]}"}) | dense,
        "initial": {word: {"value": numbers.tolist(), "unit": units[0]}},
        "drives": {label: interpolated_drive(label, *points) for label, points in tables.tables.items()},
    }


def _dimension_sizes(written_functions: list[WrittenFunction], unfolding: Unfolding) -> dict[str, int]:
    """Return the dimensions of expressions and parameters, with their sizes."""
    dims = {
        dim
        for part in written_functions
        for node in part.nodes
        for inner in every(node)
        for dim in getattr(inner, "dims", ())
    }
    dims |= {dim for parameter_dims, _ in unfolding.parameters.values() for dim in parameter_dims}
    return {unfolding.dim: unfolding.size} | {dim: term_count(dim) for dim in sorted(dims) if term_count(dim)}


def _write_arrays(
    functions: list[RightSide], tables: Substitution, y: Any, word: str, arrays: Kinds, arguments: list[Any]
) -> Written:
    """Write functions down, twice; nothing, if the right-hand side returns something other than arrays."""
    first, second = (_write_once(functions, tables, y, word, arrays, arguments) for _ in range(2))
    check_repeating(first[0], second[0])
    return first


def _write_once(
    functions: list[RightSide], tables: Substitution, y: Any, word: str, arrays: Kinds, arguments: list[Any]
) -> Written:
    fun, *events = functions
    unfolding = Unfolding(word, len(y))
    arguments = [tables.substitute(argument) for argument in arguments]
    t = traced_name("t") / traced_name("second")
    rates: Any = call_with_names(fun, tables, t, y, arguments)
    if not isinstance(rates, arrays) or (isinstance(rates, list | tuple) and any(map(np.ndim, rates))):
        return [], unfolding
    rates = np.asarray(rates, object)
    if rates.size != len(y):
        raise InputError(f"{function_name(fun)} returns {rates.size} rates, and y0 has {len(y)} numbers")
    rate = _common_rate([node_of(rate) for rate in rates.ravel()], unfolding)
    written_functions = [WrittenFunction(fun, (f"the rate of '{word}'",), (rate,))]
    for event in events:
        value = np.asarray(call_with_names(event, tables, t, y, arguments), object)
        if value.size != 1:
            raise InputError(
                f"event {function_name(event)} returns {value.size} numbers, needs one; write an event for each"
            )
        written_functions.append(WrittenFunction(event, ("its value",), (Traced(unfolding.of(node_of(value.item()))),)))
    return written_functions, unfolding


def _common_rate(nodes: list[Node], unfolding: Unfolding) -> Traced:
    """Return one expression of all elements: what they have in common, or each its own by its number.

    Raises
    ------
    IrregularError
        If they have nothing in common, and are many.
    """
    parameters_before = {**unfolding.parameters}
    try:
        return Traced(unfolding.of_elements(nodes))
    except IrregularError as error:
        if len(nodes) > MOST_WRITTEN_OUT:
            raise IrregularError(
                f"the rates of {len(nodes)} numbers have no expression in common: {error}; up to {MOST_WRITTEN_OUT} are"
                " written one after the other, for more write the model with [dimensions]"
            ) from None
    unfolding.parameters = parameters_before

    def among(first: int, last: int) -> Node:
        if last - first == 1:
            return unfolding.of(nodes[first])
        middle = (first + last) // 2
        below = Compare("<", Along("index", (), (unfolding.dim,)), Number(float(middle)))
        return Call("where", (below, among(first, middle), among(middle, last)))

    return Traced(among(0, len(nodes)))


def _check_numbers(
    written_functions: list[WrittenFunction],
    unfolding: Unfolding,
    t_span: Any,
    y0: Floats,
    arguments: list[Any],
    args: Any,
    tables: Substitution,
) -> None:
    """Call functions with numbers, and compare some of the results with what their expressions give there."""
    begin, end = (parse_time(end, "t_span") for end in t_span)
    row = [*args] if isinstance(args, list | tuple) else [args]
    constants: dict[str, Any] = {
        text_of(entry.node): float(value)
        for entry, value in zip(arguments, row, strict=True)
        if isinstance(entry, Traced)
    }
    constants |= {"second": 1.0, "pi": np.pi, f"unit_{unfolding.name}": 1.0}
    constants |= {label: values for label, (_, values) in unfolding.parameters.items()}
    extents = {dim: Extent(dim, size) for dim, size in _dimension_sizes(written_functions, unfolding).items()}
    dims = {label: parameter_dims for label, (parameter_dims, _) in unfolding.parameters.items()} | {
        unfolding.name: (unfolding.dim,)
    }
    shapes = Shapes(extents, {}, dims)
    size = unfolding.size
    places = sorted({*np.linspace(0, size - 1, COMPARED).astype(int).tolist(), *range(3), *range(-3, 0)})
    places = sorted({position % size for position in places})
    for t, y in ((begin, y0), (begin + (end - begin) / 3.0, y0 + 0.125 * np.where(y0 == 0.0, 1.0, y0))):
        values = constants | {"t": t, unfolding.name: y} | table_values(tables.tables, t)
        smallest = NEGLIGIBLE * float(np.max(np.abs(y), initial=0.0))
        for i, part in enumerate(written_functions):
            nodes = _evaluate_elements_at(
                part.nodes[0], unfolding.dim if i == 0 else "", values, shapes, places if i == 0 else [0]
            )
            span = abs(end - begin) if i == 0 and end != begin else 1.0
            call = partial(_call_at_elements, part.function, t, y, row, places if i == 0 else [0])
            check_numbers(function_name(part.function), part.words * len(nodes), nodes, call, {}, smallest / span)


def _evaluate_elements_at(
    tree: Node, dim: str, values: Mapping[str, Any], shapes: Shapes, places: list[int]
) -> list[Node]:
    """Return some values of an expression along a dimension, as trees of numbers."""
    element_values = evaluate_elements(tree, (dim,) if dim else (), values, shapes).ravel()[places]
    return [node_of(value) if np.isfinite(value) else Call("log", (Number(0.0),)) for value in element_values.tolist()]


def _call_at_elements(function: RightSide, t: float, y: Floats, row: list[Any], places: list[int]) -> Any:
    return np.asarray(call_with_numbers(function, t, y, row)).ravel()[places]

"""Right-hand sides that are written with arrays, as models with a dimension: one state y along y_index."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from xdynamics.expressions import Call, Compare, Element, Name, Node, Number, text_of
from xdynamics.expressions.cube_rules import cubes_in, of_cubes
from xdynamics.expressions.fields import Field, unknown
from xdynamics.expressions.repeating import NEGLIGIBLE, WrittenArgumentError, check_numbers
from xdynamics.expressions.substitution import Substitution, table_values
from xdynamics.expressions.traced_arrays import array_of
from xdynamics.expressions.traced_cubes import Cube, whole_of
from xdynamics.expressions.traced_grid import Grid, IrregularError, moved
from xdynamics.expressions.traced_indices import index, replaced
from xdynamics.expressions.tracing import Traced, node_of, traced_name
from xdynamics.expressions.tree import Along, Binary, every
from xdynamics.faults import InputError
from xdynamics.shapes import Extent, Shapes, at_element
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

MAX_WRITTEN_OUT = 300  # numbers, each with an expression of its own, that are one array of the record
_BY_PLACES, _BY_AXES, _BY_ELEMENTS = range(3)  # what arrays have an expression of, or each of their elements
_REDUCED = ("sum", "max", "min")
Kinds = tuple[type, ...]
COMPARED = 24  # elements whose expressions are compared with numbers


def array_sections(
    functions: list[RightSide], word: str | None, starts: list[str], unit_texts: list[str], t_span: Any, args: Any
) -> dict[str, Any] | None:
    """Return the sections of a model with one state along a dimension; None if the function is written with numbers.

    Of a function that returns a list of numbers only where the state has a name, `word`; else it is y.

    Raises
    ------
    InputError
        If it does what can be traced in no way.
    """
    if len(set(unit_texts)) > 1:
        return None
    arrays: Kinds = (Field, Cube, np.ndarray) if word is None else (Field, Cube, np.ndarray, list, tuple)
    word = word or "y"
    scale = f"unit_{word}"
    unit = Traced(Name(scale)) if unit_texts[0] != "1" else None
    leaf: Node = Name(word) if unit is None else Binary("/", Name(word), unit.node)
    numbers = start_numbers(starts, unit_texts)
    forms = (
        (_BY_PLACES, _BY_ELEMENTS, _BY_AXES) if len(starts) <= MAX_WRITTEN_OUT else (_BY_PLACES, _BY_AXES, _BY_ELEMENTS)
    )
    failed: InputError | None = None
    for form in forms:
        grid = Grid(word, len(starts), leaf)
        tables = Substitution(None if form == _BY_ELEMENTS else grid, by_axes=form == _BY_AXES)
        write = partial(_write_arrays_twice, functions, tables, _unknown_state(form, grid, unit), grid, arrays)
        try:
            written_functions, arguments, parameters = write_with_arguments(write, functions[0], args, [word])
            _check_array_numbers(written_functions, grid, t_span, numbers, arguments, args, tables)
        except IrregularError:
            continue
        except WrittenArgumentError:
            raise
        except InputError as error:  # a view that is filled, say: an array of numbers does as numpy does
            failed = error if form == _BY_ELEMENTS else failed
            continue
        if not written_functions:
            return None
        drives = {label: interpolated_drive(label, *points) for label, points in tables.tables.items()}
        own_parameters = (
            parameters | ({} if unit is None else {scale: f"1 {unit_texts[0]}"}) | _constant_parameters(grid)
        )
        start = {word: {"value": numbers.tolist(), "unit": unit_texts[0]}}
        return _model_sections(written_functions, grid, unit, unit_texts[0]) | {
            "parameters": own_parameters,
            "initial": start,
            "drives": drives,
        }
    if failed is not None:
        raise failed
    return None


def _model_sections(
    written_functions: list[WrittenFunction], grid: Grid, unit: Traced | None, text: str
) -> dict[str, Any]:
    """Return dimensions, the state with its rate, and events."""
    rate = node_of((1.0 if unit is None else unit) * written_functions[0].values[0] / traced_name("second"))
    return {
        "dimensions": _read_dimensions(written_functions, grid),
        "states": {grid.name: {"unit": text, "dims": [grid.dim], "rate": text_of(rate)}},
        "events": event_sections(written_functions[1:]),
    }


def _unknown_state(form: int, grid: Grid, unit: Traced | None) -> Any:
    """Return what stands for the numbers that are not known."""
    if form == _BY_ELEMENTS:
        return array_of([_element_number(grid, k, unit) for k in range(grid.size)])
    return unknown(grid) if form == _BY_PLACES else whole_of(grid)


def _read_dimensions(written_functions: list[WrittenFunction], grid: Grid) -> dict[str, int]:
    """Return the dimensions that expressions have, with their sizes."""
    dims_read = {
        dim
        for part in written_functions
        for node in part.nodes
        for inner in every(node)
        if isinstance(inner, Along)
        for dim in inner.dims
    }
    dense = any(values.ndim > 1 for values in grid.constants.values())
    further_sizes = {dim: size for dim, size in grid.extents.items() if dim in dims_read}
    return {grid.dim: grid.size} | ({grid.other: grid.size} if dense else {}) | further_sizes


def _constant_parameters(grid: Grid) -> dict[str, dict[str, Any]]:
    """Return numbers that functions read as parameters."""
    lists = {
        word: {"dims": [f"{word}_index"], "value": values.tolist(), "unit": "1"} for word, values in grid.lists.items()
    }
    return {label: _parameter(grid, values) for label, values in grid.constants.items()} | lists


def _element_number(grid: Grid, k: int, unit: Traced | None) -> Traced:
    number = Traced(Element(grid.name, (k,)))
    element: Traced = number if unit is None else number / unit
    return element


def _parameter(grid: Grid, values: Floats) -> dict[str, Any]:
    dims = [grid.dim] if values.ndim == 1 else [grid.other, grid.dim]
    return {"dims": dims, "value": values.tolist(), "unit": "1"}


def _write_arrays_twice(
    functions: list[RightSide], tables: Substitution, y: Any, grid: Grid, arrays: Kinds, arguments: list[Any]
) -> list[WrittenFunction]:
    """Write functions down, twice; nothing, if the right-hand side returns something other than arrays."""
    first, second = (_write_once(functions, tables, y, grid, arrays, arguments) for _ in range(2))
    check_repeating(first, second)
    return first


def _write_once(
    functions: list[RightSide], tables: Substitution, y: Any, grid: Grid, arrays: Kinds, arguments: list[Any]
) -> list[WrittenFunction]:
    fun, *events = functions
    arguments = [tables.substitute(argument) for argument in arguments]
    t = traced_name("t") / traced_name("second")
    rates: Any = call_with_names(fun, tables, t, y, arguments)
    if isinstance(rates, list | tuple) and cubes_in(rates):
        rates = of_cubes(np.stack, rates)
    if not isinstance(rates, arrays) or (isinstance(rates, list | tuple) and any(map(np.ndim, rates))):
        return []
    rates = np.array(rates, object) if isinstance(rates, list | tuple) else rates
    if np.size(rates) != grid.size if isinstance(rates, np.ndarray) else rates.size != grid.size:
        raise InputError(f"{function_name(fun)} returns {rates.size} rates, and y0 has {grid.size} numbers")
    rate = _rate_expression(rates, grid)
    written_functions = [WrittenFunction(fun, (f"the rate of '{grid.name}'",), (rate,))]
    for event in events:
        value = call_with_names(event, tables, t, y, arguments)
        if isinstance(value, Field | Cube | np.ndarray) and value.size != 1:
            raise InputError(
                f"event {function_name(event)} returns {value.size} numbers, needs one; write an event for each"
            )
        number = value.ravel()[0] if isinstance(value, Field | Cube) else np.asarray(value, object).item()
        written_functions.append(WrittenFunction(event, ("its value",), (number,)))
    return written_functions


def _rate_expression(rates: Any, grid: Grid) -> Traced:
    """Return the expression of an element of the rates."""
    if isinstance(rates, Field):
        return _shifted_row(rates, grid)
    if isinstance(rates, Cube):
        row = rates.ravel()
        return Traced(replaced(row.value.node, {row.dims[0]: index(grid.dim)}), row.value.nodes)
    return _choose_elements(rates, grid)


def _shifted_row(rates: Field, grid: Grid) -> Traced:
    return Traced(moved(rates.value.node, -rates.offset, grid))


def _choose_elements(rates: Any, grid: Grid) -> Traced:
    """Choose between expressions of single elements by halves."""
    if grid.size > MAX_WRITTEN_OUT:
        raise IrregularError(f"{grid.size} numbers have an expression each")
    nodes = [node_of(rate) for rate in np.asarray(rates, object).ravel()]

    def choose_between(first: int, last: int) -> Node:
        if last - first == 1:
            return nodes[first]
        middle = (first + last) // 2
        is_below = Compare("<", Along("index", (), (grid.dim,)), Number(float(middle)))
        return Call("where", (is_below, choose_between(first, middle), choose_between(middle, last)))

    return Traced(choose_between(0, grid.size))


def _check_array_numbers(
    written_functions: list[WrittenFunction],
    grid: Grid,
    t_span: Any,
    y0: Floats,
    arguments: list[Any],
    args: Any,
    tables: Substitution,
) -> None:
    """Call functions with numbers, and compare some of the results with what their expressions give there."""
    if not written_functions:
        return
    begin, end = (parse_time(end, "t_span") for end in t_span)
    row = [*args] if isinstance(args, list | tuple) else [args]
    known_values = {
        text_of(entry.node): float(value)
        for entry, value in zip(arguments, row, strict=True)
        if isinstance(entry, Traced)
    }
    known_values |= {"second": 1.0, "pi": np.pi, f"unit_{grid.name}": 1.0}
    dims = {
        label: (grid.dim,) if constant.ndim == 1 else (grid.other, grid.dim)
        for label, constant in grid.constants.items()
    }
    dims |= {word: (f"{word}_index",) for word in grid.lists}
    sizes = {grid.dim: grid.size, grid.other: grid.size} | grid.extents
    extents = {dim: Extent(dim, size) for dim, size in sizes.items()}
    shapes = Shapes(extents, {}, dims | {grid.name: (grid.dim,)})
    for label, constant in (grid.constants | grid.lists).items():
        known_values |= dict(zip(shapes.elements(label), constant.ravel().tolist(), strict=True))
    element_indices = sorted({*np.linspace(0, grid.size - 1, COMPARED).astype(int).tolist(), *range(3), *range(-3, 0)})
    element_indices = sorted({position % grid.size for position in element_indices})
    for t, y in ((begin, y0), (begin + (end - begin) / 3.0, y0 + 0.125 * np.where(y0 == 0.0, 1.0, y0))):
        values = known_values | {"t": t} | dict(zip(shapes.elements(grid.name), y.tolist(), strict=True))
        values |= table_values(tables.tables, t)
        negligible = NEGLIGIBLE * float(np.max(np.abs(y), initial=0.0))
        for i, part in enumerate(written_functions):
            positions: list[Mapping[str, int]] = (
                [{grid.dim: position} for position in element_indices] if i == 0 else [{}]
            )
            tree = part.nodes[0]
            as_arrays = bool(grid.extents) or any(map(_is_of_sums, every(tree)))  # over many elements, for each
            nodes = [] if as_arrays else [at_element(tree, position, shapes) for position in positions]
            if as_arrays:
                arrays = {
                    "t": t,
                    **known_values,
                    **table_values(tables.tables, t),
                    grid.name: y,
                    **grid.lists,
                    **grid.constants,
                }
                nodes = _element_nodes(
                    tree, grid.dim if i == 0 else "", arrays, shapes, element_indices if i == 0 else [0]
                )
            span = abs(end - begin) if i == 0 and end != begin else 1.0
            call = partial(_numbers_at, part.function, t, y, row, element_indices if i == 0 else [0])
            check_numbers(function_name(part.function), part.words * len(nodes), nodes, call, values, negligible / span)


def _is_of_sums(node: Node) -> bool:
    """Whether this is a sum, or an extreme, of others, which written out grow as the square of the elements."""
    return (
        isinstance(node, Along)
        and node.function in _REDUCED
        and any(
            isinstance(inner, Along) and inner.function in _REDUCED for part in node.arguments for inner in every(part)
        )
    )


def _element_nodes(tree: Node, dim: str, values: Mapping[str, Any], shapes: Shapes, places: list[int]) -> list[Node]:
    """Return some values of an expression along a dimension, as trees of numbers."""
    numbers = evaluate_elements(tree, (dim,) if dim else (), values, shapes).ravel()[places]
    return [node_of(value) if np.isfinite(value) else Call("log", (Number(0.0),)) for value in numbers.tolist()]


def _numbers_at(function: RightSide, t: float, y: Floats, row: list[Any], places: list[int]) -> Any:
    return np.asarray(call_with_numbers(function, t, y, row)).ravel()[places]

"""Right-hand sides that are written with arrays, as models with a dimension: one state y along y_index."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from xdynamics.expressions import Call, Compare, Element, Name, Node, Number, text_of
from xdynamics.expressions.fields import Field, unknown
from xdynamics.expressions.repeating import NEGLIGIBLE, WrittenArgumentError, check_numbers
from xdynamics.expressions.substitution import Substitution, values_of
from xdynamics.expressions.traced_arrays import array_of
from xdynamics.expressions.traced_grid import Grid, IrregularError, moved
from xdynamics.expressions.tracing import Traced, name, node_of
from xdynamics.expressions.tree import Along, Binary
from xdynamics.faults import InputError
from xdynamics.shapes import Extent, Shapes, at
from xdynamics.simulation.right_sides import (
    Floats,
    RightSide,
    WrittenFunction,
    called,
    check_repeating,
    drive,
    events_of,
    numbers_of,
    with_arguments,
    with_names,
    with_numbers,
)
from xdynamics.units import parse_time

MOST_WRITTEN_OUT = 300  # numbers, each with an expression of its own, that are one array of the record
COMPARED = 24  # elements whose expressions are compared with numbers


def array_sections(
    functions: list[RightSide], word: str, starts: list[str], own: list[str], t_span: Any, args: Any
) -> dict[str, Any] | None:
    """Return the sections of a model with one state along a dimension; None if the function is written with numbers."""
    if len(set(own)) > 1:
        return None
    scale = f"unit_{word}"
    unit = Traced(Name(scale)) if own[0] != "1" else None
    leaf: Node = Name(word) if unit is None else Binary("/", Name(word), unit.node)
    numbers = numbers_of(starts, own)
    for whole in (True, False):
        grid = Grid(word, len(starts), leaf)
        tables = Substitution(grid if whole else None)
        y = unknown(grid) if whole else array_of([_element(grid, k, unit) for k in range(grid.size)])
        write = partial(_written_down, functions, tables, y, grid)
        try:
            written, given, parameters = with_arguments(write, functions[0], args, [word])
            _check_numbers(written, grid, t_span, numbers, given, args, tables)
        except IrregularError:
            continue
        except WrittenArgumentError:
            raise
        except InputError:
            if whole:  # a view that is filled, say: an array of numbers does as numpy does
                continue
            raise
        if not written:
            return None
        rate = node_of((1.0 if unit is None else unit) * written[0].values[0] / name("second"))
        constants = {label: _parameter(grid, values) for label, values in grid.constants.items()}
        dense = any(values.ndim > 1 for values in grid.constants.values())
        return {
            "dimensions": {grid.dim: grid.size} | ({grid.other: grid.size} if dense else {}),
            "states": {word: {"unit": own[0], "dims": [grid.dim], "rate": text_of(rate)}},
            "parameters": parameters | ({} if unit is None else {scale: f"1 {own[0]}"}) | constants,
            "initial": {word: {"value": numbers.tolist(), "unit": own[0]}},
            "events": events_of(written[1:]),
            "drives": {label: drive(label, *points) for label, points in tables.tables.items()},
        }
    return None


def _element(grid: Grid, k: int, unit: Traced | None) -> Traced:
    number = Traced(Element(grid.name, (k,)))
    result: Traced = number if unit is None else number / unit
    return result


def _parameter(grid: Grid, values: Floats) -> dict[str, Any]:
    dims = [grid.dim] if values.ndim == 1 else [grid.other, grid.dim]
    return {"dims": dims, "value": values.tolist(), "unit": "1"}


def _written_down(
    functions: list[RightSide], tables: Substitution, y: Any, grid: Grid, arguments: list[Any]
) -> list[WrittenFunction]:
    """Write functions down, twice; nothing, if the right-hand side returns single numbers."""
    first, second = (_once(functions, tables, y, grid, arguments) for _ in range(2))
    check_repeating(first, second)
    return first


def _once(
    functions: list[RightSide], tables: Substitution, y: Any, grid: Grid, arguments: list[Any]
) -> list[WrittenFunction]:
    fun, *events = functions
    arguments = [tables.of(argument) for argument in arguments]
    t = name("t") / name("second")
    rates = with_names(fun, tables, t, y, arguments)
    if not isinstance(rates, Field | np.ndarray):
        return []
    if np.size(rates) != grid.size if isinstance(rates, np.ndarray) else rates.size != grid.size:
        raise InputError(f"{called(fun)} returns {rates.size} rates, and y0 has {grid.size} numbers")
    rate = _of_row(rates, grid) if isinstance(rates, Field) else _of_elements(rates, grid)
    written = [WrittenFunction(fun, (f"the rate of '{grid.name}'",), (rate,))]
    for event in events:
        value = with_names(event, tables, t, y, arguments)
        if isinstance(value, Field | np.ndarray) and value.size != 1:
            raise InputError(f"event {called(event)} returns {value.size} numbers, needs one; write an event for each")
        one = value[0] if isinstance(value, Field) else np.asarray(value, object).item()
        written.append(WrittenFunction(event, ("its value",), (one,)))
    return written


def _of_row(rates: Field, grid: Grid) -> Traced:
    return Traced(moved(rates.value.node, -rates.offset, grid))


def _of_elements(rates: Any, grid: Grid) -> Traced:
    """Choose between expressions of single elements by halves."""
    if grid.size > MOST_WRITTEN_OUT:
        raise IrregularError(f"{grid.size} numbers have an expression each")
    nodes = [node_of(rate) for rate in np.asarray(rates, object).ravel()]

    def among(first: int, last: int) -> Node:
        if last - first == 1:
            return nodes[first]
        middle = (first + last) // 2
        below = Compare("<", Along("index", (), (grid.dim,)), Number(float(middle)))
        return Call("where", (below, among(first, middle), among(middle, last)))

    return Traced(among(0, grid.size))


def _check_numbers(
    written: list[WrittenFunction],
    grid: Grid,
    t_span: Any,
    y0: Floats,
    given: list[Any],
    args: Any,
    tables: Substitution,
) -> None:
    """Call functions with numbers, and compare some of the results with what their expressions give there."""
    if not written:
        return
    begin, end = (parse_time(end, "t_span") for end in t_span)
    row = [*args] if isinstance(args, list | tuple) else [args]
    known = {
        text_of(entry.node): float(value) for entry, value in zip(given, row, strict=True) if isinstance(entry, Traced)
    }
    known |= {"second": 1.0, "pi": np.pi, f"unit_{grid.name}": 1.0}
    dims = {label: (grid.dim,) if kept.ndim == 1 else (grid.other, grid.dim) for label, kept in grid.constants.items()}
    extents = {dim: Extent(dim, grid.size) for dim in (grid.dim, grid.other)}
    shapes = Shapes(extents, {}, dims | {grid.name: (grid.dim,)})
    for label, kept in grid.constants.items():
        known |= dict(zip(shapes.elements(label), kept.ravel().tolist(), strict=True))
    places = sorted({*np.linspace(0, grid.size - 1, COMPARED).astype(int).tolist(), *range(3), *range(-3, 0)})
    places = sorted({place % grid.size for place in places})
    for t, y in ((begin, y0), (begin + (end - begin) / 3.0, y0 + 0.125 * np.where(y0 == 0.0, 1.0, y0))):
        values = known | {"t": t} | dict(zip(shapes.elements(grid.name), y.tolist(), strict=True))
        values |= values_of(tables.tables, t)
        least = NEGLIGIBLE * float(np.max(np.abs(y), initial=0.0))
        for i, part in enumerate(written):
            wanted: list[Mapping[str, int]] = [{grid.dim: place} for place in places] if i == 0 else [{}]
            nodes = [at(part.nodes[0], place, shapes) for place in wanted]
            span = abs(end - begin) if i == 0 and end != begin else 1.0
            call = partial(_some, part.function, t, y, row, places if i == 0 else [0])
            check_numbers(called(part.function), part.words * len(nodes), nodes, call, values, least / span)


def _some(function: RightSide, t: float, y: Floats, row: list[Any], places: list[int]) -> Any:
    return np.asarray(with_numbers(function, t, y, row), float).ravel()[places]

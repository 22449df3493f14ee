"""Right-hand sides of t and y as models: functions written with arrays, of one state along `y_index`.

Python functions as `solve` takes them are read: the arguments that they are called with, their results, their events.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import Along, Call, Compare, Element, Name, Node, Number, text_of
from xdynamics.expressions.element_folding import IrregularError, Unfolding, term_count
from xdynamics.expressions.memory import Remembered
from xdynamics.expressions.repeating import NEGLIGIBLE, OF_MEMORY, check_numbers, check_repeats, check_unwritten
from xdynamics.expressions.substitution import Substitution, table_values
from xdynamics.expressions.traced_arrays import Points, array_of
from xdynamics.expressions.tracing import Traced, WholeNumberError, joined_branches, node_of, traced, traced_name
from xdynamics.expressions.tree import every
from xdynamics.faults import InputError
from xdynamics.model.links import MOST_ELEMENTS
from xdynamics.model.name_consistency import RESERVED
from xdynamics.shapes import Extent, Shapes
from xdynamics.shapes.evaluation import evaluate_elements
from xdynamics.units import parse_quantity, parse_time, parse_unit

DIRECTIONS = {0: "either", 1: "rising", -1: "falling"}
TIMES = ("t", "time", "tau", "_t", "times")  # what functions call it
RightSide = Callable[..., Any]
WrittenResult = TypeVar("WrittenResult")  # functions that are written down, perhaps with what they need besides
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class WrittenFunction:
    """A function of t and y, the meaning of its values, and its values for traced numbers."""

    function: RightSide
    words: tuple[str, ...]
    values: tuple[Any, ...]

    @property
    def nodes(self) -> list[Node]:
        """The values as expressions."""
        return [node_of(value) for value in self.values]


def function_name(fun: RightSide) -> str:
    """Return the name of a function, as messages and models have it."""
    word = str(getattr(fun, "__name__", "right_side"))
    return word if word.isidentifier() else "right_side"


def event_functions(events: Any) -> list[RightSide]:
    """Return events as functions.

    Raises
    ------
    InputError
        If one is no function.
    """
    row = [] if events is None else [events] if callable(events) else list(events)
    for i, event in enumerate(row):
        if not callable(event):
            raise InputError(f"events[{i}] is {repr(event)[:40]}, needs a function of t and y")
    return row


def check_order(fun: RightSide) -> None:
    """Refuse a function of y and t, as odeint takes it.

    Raises
    ------
    InputError
        If its arguments are named so.
    """
    argument_names = _argument_names(fun)
    if len(argument_names) > 1 and argument_names[1] in TIMES and argument_names[0] not in TIMES:
        label = "fun" if function_name(fun) == "right_side" else function_name(fun)
        raise InputError(
            f"{label} is {label}({', '.join(argument_names)}), y before t, as odeint takes it; here t comes first, as in solve_ivp:"
            f" write xd.solve(lambda t, y, *args: {label}(y, t, *args), …)"
        )


def _argument_names(fun: RightSide) -> list[str]:
    try:
        return [argument.name for argument in inspect.signature(fun).parameters.values()]
    except (TypeError, ValueError):
        return []


def check_span(t_span: Any) -> None:
    """Refuse a span that goes back.

    Raises
    ------
    InputError
        With the span to take in its place.
    """
    begin, end = (parse_time(end, "t_span") for end in t_span)
    if end < begin:
        raise InputError(
            f"t_span goes back, from {begin:g} to {end:g} s, and until has to lie after the start; integrate -f over the"
            f" mirrored span: xd.solve(lambda t, y: -np.asarray(fun(-t, y)), ({0 - begin:g}, {0 - end:g}), y0)"
        )


def read_starts(y0: Any, units: Any) -> tuple[list[str], list[str]]:
    """Return initial values with their units, and the units.

    Raises
    ------
    InputError
        If there are more or fewer units than numbers, or a number is not real or in another dimension.
    """
    row = [y0] if isinstance(y0, str | int | float) else list(y0)
    if np.ndim(y0) > 1 or not row:
        shape = np.shape(y0)
        remedy = "give y0.ravel(), and fun reshapes it: y.reshape(…)" if row else "there is nothing to integrate"
        raise InputError(f"y0 has shape {shape}, needs one axis of at least one number; {remedy}")
    if len(row) > MOST_ELEMENTS:
        raise InputError(f"y0 has {len(row)} numbers, needs 1 to {MOST_ELEMENTS}")
    declared = [units] * len(row) if isinstance(units, str) else None if units is None else [*units]
    if declared is not None and len(declared) != len(row):
        raise InputError(f"units are {len(declared)}, and y0 has {len(row)} numbers")
    quantities, unit_texts = [], []
    for i, start in enumerate(row):
        if isinstance(start, complex) or np.ndim(start):
            raise InputError(f"y0[{i}] is {start!r}, needs a real number; write real and imaginary parts apart")
        if not isinstance(start, str) and not np.isfinite(start):
            raise InputError(f"y0[{i}] is {float(start)!r}, needs a finite number")
        if isinstance(start, str):
            quantity = parse_quantity(start)
            unit = parse_unit(declared[i]) if declared is not None else quantity.unit
            if quantity.unit.dimension != unit.dimension:
                raise InputError(f"y0[{i}] is {start!r}, and its unit '{unit.text}'")
            quantities.append(f"{quantity.value!r} {quantity.unit.text}")
        else:
            unit = parse_unit("1" if declared is None else declared[i])
            quantities.append(f"{float(start)!r} {unit.text}")
        unit_texts.append(unit.text)
    return quantities, unit_texts


def start_numbers(starts: list[str], unit_texts: list[str]) -> Floats:
    """Return initial values, shape (n,), as numbers of their units."""
    return np.array(
        [
            float(start[:-2])
            if unit == "1" and start.endswith(" 1")
            else parse_quantity(start).si / float(parse_unit(unit).factor)
            for start, unit in zip(starts, unit_texts, strict=True)
        ]
    )


def write_with_arguments(
    write: Callable[[list[Any]], WrittenResult], fun: RightSide, args: Any, taken_names: list[str]
) -> tuple[WrittenResult, list[Any], dict[str, str]]:
    """Write functions down with single numbers of `args` as parameters, with their names and values."""
    try:
        arguments, parameters = arguments_of(fun, args, taken_names, float)
        return write(arguments), arguments, parameters
    except WholeNumberError:  # an argument is how many there are of something, or an index
        arguments, parameters = arguments_of(fun, args, taken_names, int)
        return write(arguments), arguments, parameters


def arguments_of(
    fun: RightSide, args: Any, taken_names: list[str], unnamed_type: type
) -> tuple[list[Any], dict[str, str]]:
    """Return the arguments of `fun` after t and y; single numbers become parameters, as `unnamed_type` allows."""
    row = [*args] if isinstance(args, list | tuple) else [args]
    words = _argument_names(fun)[2:]
    words = [words[i] if i < len(words) and words[i].isidentifier() else f"arg{i}" for i in range(len(row))]
    words = [f"{word}_" if word in (*RESERVED, *taken_names) else word for word in words]
    arguments: list[Any] = []
    parameters = {}
    for word, argument in zip(words, row, strict=True):
        number = is_single_number(argument) and not (unnamed_type is int and isinstance(argument, int | np.integer))
        arguments.append(traced_name(word) if number else argument)
        if number:
            parameters[word] = f"{float(argument)!r} 1"
    return arguments, parameters


def is_single_number(argument: Any) -> bool:
    """Whether an argument is a single number."""
    return isinstance(argument, int | float | np.number) and not isinstance(argument, bool)


def _checked_rates(fun: RightSide, rates: Any, n: int) -> list[Any]:
    if rates is None:
        raise InputError(f"{function_name(fun)} returns nothing; it has to return rates, {n} of them")
    row = [rates] if isinstance(rates, Traced | int | float) else list(np.asarray(rates, object).ravel())
    if len(row) != n:
        raise InputError(f"{function_name(fun)} returns {len(row)} rates, and y0 has {n} numbers")
    return row


def write_twice(
    functions: list[RightSide], tables: Substitution, words: list[str], y: Any, arguments: list[Any]
) -> list[WrittenFunction]:
    """Trace the right-hand side and the events twice, and refuse functions whose traces differ."""
    first, second = ([*write_each(functions, tables, words, y, arguments)] for _ in range(2))
    check_repeating(first, second)
    return first


def check_repeating(first: list[WrittenFunction], second: list[WrittenFunction]) -> None:
    """Refuse functions that write something else when they are called again.

    Raises
    ------
    InputError
        With both expressions, from where they differ.
    """
    for first_function, second_function in zip(first, second, strict=True):
        check_repeats(
            function_name(first_function.function), first_function.words, first_function.nodes, second_function.nodes
        )


def write_each(
    functions: list[RightSide], tables: Substitution, words: list[str], y: Any, arguments: list[Any]
) -> Iterator[WrittenFunction]:
    """Write the right-hand side down, and then every event."""
    fun, *events = functions
    arguments = [tables.substitute(argument) for argument in arguments]
    t = traced_name("t") / traced_name("second")
    rates = _checked_rates(fun, call_with_names(fun, tables, t, y, arguments, "a rate"), len(words))
    yield WrittenFunction(fun, tuple(f"the rate of '{word}'" for word in words), tuple(rates))
    for event in events:
        yield WrittenFunction(event, ("its value",), (call_with_names(event, tables, t, y, arguments),))


def call_with_names(
    function: RightSide, tables: Substitution, t: Traced, y: Any, arguments: list[Any], noun: str = "its value"
) -> Any:
    """Call a function with traced numbers; refuse one that writes into y, and one whose result is of what it remembers."""
    substitute = tables.substitute(function)
    memory = Remembered((substitute, arguments))

    def result_from(contents: dict[Any, Any] | None = None) -> Any:
        def call() -> Any:
            y_copy = y.copy()
            memory.recall(contents)
            rates = traced(substitute, t, y_copy, *arguments)
            memory.note()
            check_unwritten(function_name(function), y, y_copy)
            return rates

        return joined_branches(call)

    try:
        result = result_from()
        for contents in [*memory.seen]:
            first, second = (_nodes_of(rates) for rates in (result, result_from(contents)))
            check_repeats(function_name(function), [noun] * len(first), first, second, OF_MEMORY)
    finally:
        memory.recall()
    return result


def _nodes_of(result: Any) -> list[Node]:
    """Return what a function returned as expressions."""
    return [node_of(number) for number in np.asarray(result, object).ravel().tolist()]


def call_with_numbers(function: RightSide, t: float, y: Floats, row: list[Any]) -> Any:
    """Call a function with numbers, and refuse one that writes into y."""
    y_copy = y.copy()
    rates = function(t, y_copy, *row)
    check_unwritten(function_name(function), y, y_copy)
    return rates


def interpolated_drive(word: str, points: Points) -> dict[str, Any]:
    """Return a table that a function read by `numpy.interp`, or by an interpolator of scipy."""
    table = {"t [s]": np.array(points.times), f"{word} [1]": np.array(points.values)}
    return {"table": table, "interpolation": points.interpolation, "outside": points.outside}


def event_sections(written_functions: list[WrittenFunction]) -> dict[str, dict[str, Any]]:
    """Return events as a model has them, with scipy's attributes."""
    events: dict[str, dict[str, Any]] = {}
    for i, event in enumerate(written_functions):
        label = (
            function_name(event.function)
            if function_name(event.function) not in events
            else f"{function_name(event.function)}_{i}"
        )
        terminal, direction = _event_attributes(event.function)
        entry: dict[str, Any] = {"function": text_of(event.nodes[0])}
        entry |= {"direction": DIRECTIONS[direction], "action": "stop" if terminal else "record"}
        if terminal > 1:
            entry["count"] = terminal
        events[label] = entry
    return events


def _event_attributes(event: RightSide) -> tuple[int, int]:
    """Return how many occurrences of an event stop a run, 0 for none, and the sign of its direction.

    Raises
    ------
    InputError
        If an attribute is not what scipy takes.
    """
    terminal, direction = getattr(event, "terminal", None) or 0, getattr(event, "direction", None) or 0
    if not isinstance(terminal, int | float | np.number | np.bool_) or not (
        terminal >= 0 and int(terminal) == terminal
    ):
        raise InputError(
            f"{function_name(event)}.terminal is {terminal!r}, needs True, False, or the number of occurrences that stop the run"
        )
    # nan alone differs from itself
    if not isinstance(direction, int | float | np.number) or direction != direction:
        raise InputError(
            f"{function_name(event)}.direction is {direction!r}, needs a number: 1 for rising, -1 for falling"
        )
    return int(terminal), int(np.sign(direction))


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
        "drives": {label: interpolated_drive(label, points) for label, points in tables.tables.items()},
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
    """Return one expression for all elements: their common form, or each element's own by its number.

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
    """Call functions with numbers, and compare some results with the values of their expressions."""
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

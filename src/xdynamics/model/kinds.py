"""Kinds of values in a model file: how each is read, how it is written, and when it may be left out.

A function written in Python is a value too: the function itself, or the description that an archive stores.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

from xdynamics.expressions import Node, parse, text_of
from xdynamics.expressions.parser import with_unit_names
from xdynamics.faults import InputError, brief_repr
from xdynamics.model.file_access import FileAccess
from xdynamics.model.parts import Function
from xdynamics.model.table_keys import check_keys, read_choice
from xdynamics.shapes import Shapes, resolve_min_max
from xdynamics.units import (
    NONE,
    NUMBERS,
    SECONDS,
    TIME,
    Quantity,
    Unit,
    parse_quantity,
    parse_unit,
    time_in,
    unit_suffix,
)

Functions = Mapping[str, Callable[..., float]]


def read_function(entry: Any, functions: Functions) -> Function:
    """Read a Python function, or a table that describes one.

    Raises
    ------
    InputError
        If it cannot be read, or the function passed is a different one.
    """
    if callable(entry):
        return Function.from_callable(entry)
    check_keys(entry, ("function", "arguments", "digest", "source"), needed=("function", "digest"))
    name, arguments = entry["function"], entry.get("arguments", [])
    texts = [name, entry["digest"], entry.get("source", ""), *(arguments if isinstance(arguments, list) else [None])]
    if not all(isinstance(text, str) for text in texts):
        raise InputError(f"function {name!r} needs texts: its name, digest, source and a list of arguments")
    recorded_function = Function(name, tuple(arguments), entry.get("source", ""), entry["digest"])
    if name not in functions:
        return recorded_function
    passed = Function.from_callable(functions[name])
    if passed.digest != recorded_function.digest:
        raise InputError(
            f"function '{name}' handed over has digest {passed.digest[:12]}…, the model was made with"
            f" {recorded_function.digest[:12]}…"
        )
    return passed


NEVER = object()  # equal to no value: a key that is always written
MOST_COUNTED = 1 << 31


@dataclass(frozen=True)
class Source:
    """What a model is read with beside its text: Python functions, the files in reach, the unit of time, dimensions."""

    functions: Functions
    access: FileAccess
    time: Unit = SECONDS
    shapes: Shapes = field(default_factory=Shapes)


@dataclass(frozen=True)
class Kind:
    """One kind of value.

    Attributes
    ----------
    takes : str
        How a value is described in the help.
    read : callable of (value, key, Source)
        Returns the value as a part of a model has it, or raises an `InputError` that names the key.
    write : callable of (value, Unit)
        Returns what stands in TOML, in a model with a unit of time.
    omitted : object
        The value that is not written; `NEVER` if all are.
    unit : str
        Its unit, or whatever else belongs to it in the help.
    """

    takes: str
    read: Callable[[Any, str, Source], Any]
    write: Callable[[Any, Unit], Any] = lambda value, _: value
    omitted: Any = NEVER
    unit: str = ""

    def with_unit(self, unit: str) -> Kind:
        """Return the kind with its unit, or whatever else belongs to it, in the help."""
        return replace(self, takes=f"{self.takes}, {unit}", unit=unit)


def word_kind(*choices: str) -> Kind:
    """Return the kind of values that are one of some words."""
    takes = " | ".join(f'"{word}"' for word in choices)
    return Kind(takes, lambda value, key, _: read_choice(value, key, choices))


def raw(takes: str) -> Kind:
    """Return the kind of values that are read together with other keys of their entry."""
    return Kind(takes, lambda value, *_: value)


def read_text(value: Any, *_: Any) -> str:
    """Read a text for people.

    Raises
    ------
    InputError
        If it is none, or has characters that are not printable.
    """
    if not isinstance(value, str):
        raise InputError(f"{str(value)[:40]} is no text; write it in quotes")
    text = value.strip()
    if not all(character.isprintable() or character in "\n\t" for character in text):
        raise InputError(f"text {text[:40]!r} has characters that are not printable")
    return text


def name_kind(subject: str) -> Kind:
    """Return the kind of values that are the name of something."""

    def read_name(value: Any, key: str, *_: Source) -> str:
        if not isinstance(value, str):
            raise InputError(f"{key} is {brief_repr(value)}, needs the name of {subject}")
        return value

    return Kind(f"name, of {subject}", read_name)


def name_list_kind(subject: str) -> Kind:
    """Return the kind of values that are lists of names, each once."""

    def read_names(value: Any, key: str, *_: Source) -> tuple[str, ...]:
        if not isinstance(value, list | tuple) or not all(isinstance(name, str) for name in value):
            raise InputError(f"{key} is {brief_repr(value)}, needs a list of {subject}")
        if len(set(value)) < len(value):
            raise InputError(f"{key} lists one of {', '.join(value)} twice")
        return tuple(value)

    return Kind(f"list of names, {subject}", read_names, lambda names, _: list(names), ())


def _read_expression(value: Any, key: str, source: Source) -> Node:
    try:
        return resolve_min_max(parse(value), source.shapes)
    except InputError as error:
        raise InputError(f"{key}: {error}") from None


def _read_condition(value: Any, key: str, source: Source) -> Node:
    """Read an expression that is zero."""
    if isinstance(value, str) and any(sign in value for sign in "<>=") and "where" not in value:
        raise InputError(
            f"{key}: '{value}' compares, and a constraint is one expression that is zero, like sqrt(x**2 + y**2) - L; what"
            " holds on one side only is a gap of [contacts]"
        )
    return _read_expression(value, key, source)


def _read_coefficient(value: Any, key: str, source: Source) -> Node:
    """Read an expression, or a plain number."""
    plain = isinstance(value, int | float) and not isinstance(value, bool)
    return _read_expression(repr(value) if plain else value, key, source)


def _read_component(value: Any, key: str, source: Source) -> Node | Function:
    """Read an expression, a Python function, or a table that describes one."""
    if callable(value) or isinstance(value, Mapping):
        return read_function(value, source.functions)
    return _read_expression(value, key, source)


def _write_component(value: Node | Function, *_: Unit) -> Any:
    """Write an expression as text, a Python function as the table that describes it."""
    if not isinstance(value, Function):
        return text_of(value)
    return {"function": value.name, "arguments": list(value.arguments), "digest": value.digest, "source": value.source}


def _read_trees(value: Any, key: str, source: Source) -> dict[str, Node]:
    if not isinstance(value, Mapping):
        raise InputError(f'{key} is {brief_repr(value)}, needs a table like {{ v_y = "-v_y" }}')
    return {name: _read_expression(text, f"{key} '{name}'", source) for name, text in value.items()}


def _read_links(value: Any, key: str, _source: Source) -> tuple[tuple[str, str], ...]:
    is_list = isinstance(value, list | tuple) and all(isinstance(pair, list | tuple) for pair in value)
    if not is_list or any([type(end) for end in pair] != [str, str] for pair in value):
        raise InputError(f'{key} is {brief_repr(value)}, needs pairs of names, like [["origin", "bob"]]')
    return tuple((first, second) for first, second in value)


def _read_pairs(value: Any, key: str, source: Source) -> tuple[tuple[Node, Node], ...]:
    one_pair = isinstance(value, list | tuple) and all(isinstance(item, str) for item in value)
    pairs = [value] if one_pair else value
    if (
        not isinstance(pairs, list | tuple)
        or not pairs
        or any(not isinstance(pair, list | tuple) or len(pair) != 2 for pair in pairs)
    ):
        raise InputError(
            f'{key} is {brief_repr(value)}, needs two expressions, ["l*sin(theta)", "-l*cos(theta)"], or a list of such pairs'
        )
    return tuple((_read_expression(across, key, source), _read_expression(up, key, source)) for across, up in pairs)


def _read_flag(value: Any, key: str, *_: Source) -> bool:
    if not isinstance(value, bool):
        raise InputError(f"{key} is {brief_repr(value)}, needs true or false")
    return value


def _read_count(value: Any, key: str, *_: Source) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value < MOST_COUNTED:
        raise InputError(f"{key} is {brief_repr(value)}, needs a whole number from 1 on")
    return value


def _read_duration(value: Any, key: str, *_: Source) -> Quantity:
    quantity = parse_quantity(value)
    if quantity.unit.dimension not in (TIME, NONE) or quantity.value <= 0:
        raise InputError(f"{key} is '{quantity}', needs a positive time")
    return quantity


def _read_wait(value: Any, key: str, *_: Source) -> Quantity | None:
    quantity = _read_phase(value, key)
    return quantity if quantity.value else None


def _read_phase(value: Any, key: str, *_: Source) -> Quantity:
    quantity = parse_quantity(value)
    if quantity.unit.dimension not in (TIME, NONE) or quantity.value < 0:
        raise InputError(f"{key} is '{quantity}', needs a time that is not negative")
    return quantity


def _read_quantity(value: Any, key: str, *_: Source) -> Quantity:
    try:
        return parse_quantity(value)
    except InputError as error:
        raise InputError(f"{key}: {error}") from None


def _read_limit(value: Any, key: str, source: Source) -> Node:
    """Read a quantity, a plain number or an expression as an expression."""
    if isinstance(value, str):
        try:
            return _read_expression(with_unit_names(str(parse_quantity(value))), key, source)
        except InputError:
            return _read_expression(value, key, source)
    return _read_coefficient(value, key, source)


def _read_positive(value: Any, key: str, *_: Source) -> Quantity:
    quantity = parse_quantity(value)
    if not quantity.value > 0:
        raise InputError(f"{key} is '{quantity}', needs a positive quantity")
    return quantity


def _read_size(value: Any, key: str, *_: Source) -> Quantity:
    quantity = parse_quantity(value)
    if quantity.value < 0:
        raise InputError(f"{key} is '{quantity}', needs to be non-negative")
    return quantity


def _read_instants(value: Any, key: str, source: Source) -> tuple[float, ...]:
    instants = [value] if isinstance(value, str | int | float) else value
    return tuple(time_in(source.time, instant, key) for instant in instants)


def _tree_text(tree: Node, *_: Unit) -> str:
    return text_of(tree)


def _quantity_text(quantity: Quantity, *_: Unit) -> str:
    return str(quantity)


def _read_csv_text(value: Any, key: str, *_: Source) -> str:
    if not isinstance(value, str):
        raise InputError(f"{key} is {brief_repr(value)}, needs the text of a table")
    return value


def _read_time_unit(value: Any, key: str, *_: Source) -> str:
    with suppress(InputError):
        if value == NUMBERS.text or (isinstance(value, str) and parse_unit(value).dimension == SECONDS.dimension):
            return str(value)
    raise InputError(
        f"{key} is {brief_repr(value)}; time is in '{SECONDS.text}', shown in another unit of time, like 'h', or a pure"
        f" number, '{NUMBERS.text}'"
    )


TEXT = Kind("text", read_text, omitted="")
TIME_UNIT = Kind('"s" | "h", … | "1"', _read_time_unit)
CSV = Kind("text", _read_csv_text)
UNIT = Kind("unit", lambda value, *_: parse_unit(value), lambda unit, _: unit.text, None)
EXPRESSION = Kind("expression", _read_expression, _tree_text, None)
CONDITION = Kind("expression", _read_condition, _tree_text, None)
COEFFICIENT = Kind("expression", _read_coefficient, _tree_text, None)
FORMULA = Kind(
    "expression", lambda value, _, source: resolve_min_max(parse(value), source.shapes), _tree_text
)  # named by its entry alone
COMPONENT = Kind("expression", _read_component, _write_component, None)
EXPRESSIONS = Kind(
    "table of expressions", _read_trees, lambda trees, _: {key: text_of(trees[key]) for key in trees}, {}
)
LINKS = Kind("list of pairs of names", _read_links, lambda pairs, _: [[*pair] for pair in pairs], ())
PLANE = Kind("pair of expressions", _read_pairs, lambda pairs, _: [[*map(text_of, pair)] for pair in pairs], ())
FLAG = Kind("true | false", _read_flag, omitted=False)
COUNT = Kind("whole number from 1 on", _read_count, omitted=1)
DURATION = Kind("time", _read_duration, _quantity_text, None)
WAIT = Kind("time", _read_wait, _quantity_text, None)
PHASE = Kind("time", _read_phase, _quantity_text, None)
QUANTITY = Kind("quantity", _read_quantity, _quantity_text)
LIMIT = Kind("quantity or expression", _read_limit, _tree_text, None)
INSTANTS = Kind("time", _read_instants, lambda times, unit: [f"{time!r}{unit_suffix(unit)}" for time in times], ())
POSITIVE = Kind("quantity", _read_positive, _quantity_text, None)
SIZE = Kind("quantity", _read_size, _quantity_text, None)

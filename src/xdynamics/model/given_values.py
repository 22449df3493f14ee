"""Values of a quantity with dimensions: lists, tables, values by label, or expressions of the element's number.

The form of a value is decided first: a number with a unit, numbers for elements, or an expression. Before elements are
made, their memory is checked.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain as joined
from math import isfinite, prod
from typing import Any

from xdynamics.expressions import Binary, Node, dimension_of, free_names, parse, shortened_text, text_of
from xdynamics.faults import InputError, brief_repr, first_names
from xdynamics.model.kinds import Source
from xdynamics.model.table_keys import suggestion
from xdynamics.model.table_values import as_in_file, from_table, is_array
from xdynamics.model.uncertainty import NORMAL, RECTANGULAR, SIZES, Spread, is_uncertain, read_spread, split_uncertainty
from xdynamics.runtime.files import ROOM, free_memory, size_text
from xdynamics.shapes import Shapes, resolve_min_max
from xdynamics.units import (
    BASE,
    CALENDAR,
    CONSTANTS,
    NONE,
    Quantity,
    Scale,
    Unit,
    constant,
    constant_of,
    parse_quantity,
    parse_scale,
    parse_unit,
    spell,
)

NO_FREEDOM = 0.0  # in the place of degrees of freedom, of elements that are not Student's t
NUMBERS_OF_ELEMENT = 30  # at least, of a coordinate in a march
FEW_ELEMENTS = 100_000  # which always fit


def check_element_memory(dims: tuple[str, ...], shapes: Shapes) -> None:
    """Refuse a quantity whose elements could not be marched in the memory that can be had, before they are made.

    Raises
    ------
    InputError
        With the number of elements, what they take, and what there is.
    """
    size = math.prod(shapes.extent(dim).size for dim in dims)
    needed = NUMBERS_OF_ELEMENT * 8.0 * size
    if size > FEW_ELEMENTS and needed > (room := ROOM * free_memory()):
        raise InputError(
            f"has {size} elements along {', '.join(dims)}, which take {size_text(needed)} to march, and"
            f" {size_text(room)} of memory can be had; take fewer"
        )


_CALLING = re.compile(r"[A-Za-z_]\w*\s*\(|^\s*[0-9.]+\s*[*+(-]")
OF_ELEMENTS = ("dims", "values", "table", "csv", "column", "columns")  # keys of a quantity with dimensions alone


def is_of_elements(entry: Any) -> bool:
    """Whether an entry has values for elements, or is an expression."""
    if isinstance(entry, Mapping):
        return any(key in entry for key in OF_ELEMENTS) or is_of_elements(entry.get("value"))
    return isinstance(entry, list | tuple) or is_array(entry) or is_expression(entry) or is_meant(entry)


def is_expression(value: Any) -> bool:
    """Whether a text is an expression, and no number with a unit."""
    if not isinstance(value, str) or is_uncertain(value):
        return False
    try:
        parse_quantity(value)
    except InputError:
        try:
            parse(value)
        except InputError:
            return False
        return True
    return False


def is_meant(value: Any) -> bool:
    """Whether a text that is neither is meant as an expression: it has a call, or an operator behind its first number."""
    if not isinstance(value, str) or is_uncertain(value) or is_expression(value):
        return False
    try:
        parse_quantity(value)
    except InputError:
        return _CALLING.search(value) is not None
    return False


@dataclass(frozen=True)
class Values:
    """The values of a parameter, or of a quantity at the start, one for each element.

    Attributes
    ----------
    dims : tuple of str
    unit : Unit, optional
        None with an expression that has its own.
    numbers : tuple of float
        In the unit; one for all elements, or one for each, the last dimension fastest; empty with an expression.
    spreads : tuple of Spread
        One for all elements, or one for each; empty if none is known.
    tree : Node, optional
        An expression of parameters and of numbers of elements.
    description : str
    scale : Scale, optional
        That bare numbers in their place are on.
    """

    dims: tuple[str, ...]
    unit: Unit | None = None
    numbers: tuple[float, ...] = ()
    spreads: tuple[Spread | None, ...] = ()
    tree: Node | None = None
    description: str = ""
    scale: Scale | None = field(default=None, compare=False, repr=False)

    def spread(self, i: int) -> Spread | None:
        """Return the spread of an element."""
        return self.spreads[i if len(self.spreads) > 1 else 0] if self.spreads else None

    @property
    def form(self) -> Values:
        """The values without their numbers."""
        return Values(self.dims, unit_of_values(self), (0.0,) if self.dims == () else (), tree=None)


def read_values(entry: Any, name: str, source: Source, declared: tuple[str, ...] | None = None) -> Values:
    """Read the values of a quantity with dimensions.

    Parameters
    ----------
    entry : str, list, mapping or array
    name : str
    source : Source
    declared : tuple of str, optional
        Dimensions of the quantity, where they stand elsewhere: those of a coordinate, whose start this is.

    Raises
    ------
    InputError
        Naming the key, what it is and what was needed.
    """
    shapes = source.shapes
    entry = as_in_file(entry, name, declared, shapes)
    if not isinstance(entry, Mapping):
        entry = {"value": entry}
    if not entry.keys() & {*SIZES} and (pair := split_uncertainty(entry.get("value"))):
        entry = {**entry, "value": pair[0], "uncertainty": pair[1]}
    dims = _read_dims(entry.get("dims", ()), shapes) if declared is None else declared
    if declared is not None and "dims" in entry:
        raise InputError(f"key 'dims' is not known here: '{name}' has the dimensions {', '.join(dims) or 'none'}")
    value_keys = [key for key in ("value", "values", "table", "csv") if key in entry]
    if len(value_keys) != 1 and value_keys != ["table", "csv"]:
        raise InputError(f"needs one of value, values, table; has {' and '.join(value_keys) or 'none of them'}")
    shape = shapes.shape(dims)
    if is_expression(entry.get("value")) or is_meant(entry.get("value")):
        return _by_expression(entry, dims, shapes, at_start=declared is not None)
    check_element_memory(dims, shapes)
    if "values" in entry:
        if not (dims and isinstance(entry["values"], Mapping)):
            raise InputError('values is a table by label, of a quantity with dimensions: { Sun = "1 kg" }')
        numbers, scale = _read_by_label(entry["values"], _unit_scale(entry), dims, shapes)
    elif "table" in entry or "csv" in entry:
        numbers, unit, sizes = from_table(entry, name, dims, source)
        doubts = {"uncertainty": nested_lists([f"{size!r} {unit.text}" for size in sizes], shape)} if sizes else {}
        entry, scale = {**entry, **doubts}, Scale(unit)
    else:
        numbers, scale = _read_nested(entry["value"], _unit_scale(entry), shape, dims)
    if wrong := [number for number in numbers if not isfinite(number)]:
        raise InputError(f"has the value {wrong[0]}, and needs finite numbers")
    about = str(entry.get("description", "")).strip()
    spreads = _spreads(entry, scale, shape, dims)
    return Values(dims, scale.unit, numbers, spreads, description=about, scale=None if scale.is_unit else scale)


def _by_expression(entry: Mapping[str, Any], dims: tuple[str, ...], shapes: Shapes, *, at_start: bool) -> Values:
    """Read an expression: of constants and numbers of elements, beside which a unit may stand, or at the start of more."""
    if at_start and (extra := [key for key in SIZES if key in entry]):
        raise InputError(f"has {extra[0]} beside an expression; give it to the parameters that it reads")
    tree, about = resolve_min_max(parse(entry["value"]), shapes), str(entry.get("description", "")).strip()
    unit = parse_unit(entry["unit"]) if "unit" in entry else None
    if at_start:
        return Values(dims, tree=tree if unit is None else _times_unit(tree, unit), description=about)
    values = Values(dims, unit, tree=tree, description=about)
    return replace(values, spreads=_spreads(entry, Scale(unit_of_values(values)), shapes.shape(dims), dims))


def _times_unit(tree: Node, unit: Unit) -> Node:
    """Return an expression times a unit, so that it has that unit itself: units of its names are not known yet."""
    powers = [f"{constant_of(base)}**{power}" for base, power in zip(BASE, unit.dimension.powers, strict=True) if power]
    return Binary("*", tree, parse("*".join([repr(float(unit.factor)), *powers])))


def _read_dims(value: Any, shapes: Shapes) -> tuple[str, ...]:
    names = [value] if isinstance(value, str) else value
    if not isinstance(names, list | tuple) or not all(isinstance(name, str) for name in names):
        raise InputError(f'dims is {brief_repr(value)}, needs a list of dimensions, like ["body", "axis"]')
    if len(set(names)) < len(names):
        raise InputError(f"dims has one of {', '.join(names)} twice")
    for name in names:
        shapes.extent(name)
    return tuple(names)


def dims_key(value: Any, _: str, source: Source) -> tuple[str, ...]:
    """Read the key `dims`.

    Raises
    ------
    InputError
        If it is no list of dimensions.
    """
    return _read_dims(value, source.shapes)


def _unit_scale(entry: Mapping[str, Any]) -> Scale | None:
    return parse_scale(entry["unit"]) if "unit" in entry else None


def _read_nested(
    value: Any, scale: Scale | None, shape: tuple[int, ...], dims: tuple[str, ...], key: str = "value"
) -> tuple[tuple[float, ...], Scale]:
    """Read nested lists of numbers or quantities, or one quantity, which is that of all elements."""
    return _in_one_unit(_flat_list(value, shape, dims, key), scale, difference=key in SIZES)


def _flat_list(value: Any, shape: tuple[int, ...], dims: tuple[str, ...], key: str) -> list[Any]:
    """Return the entries of nested lists, the last dimension fastest; of what is no list, itself alone."""
    if isinstance(value, list | tuple) and not dims:
        raise InputError(f'{key} is a list of {len(value)}, needs the dimensions that it is along: dims = ["…"]')
    flat: list[Any] = [value]
    for length, dim in zip(shape, dims, strict=True):
        if not isinstance(value, list | tuple):
            break
        for row in flat:
            if not isinstance(row, list | tuple) or len(row) != length:
                got = f"{len(row)}" if isinstance(row, list | tuple) else "a number"
                raise InputError(f"{key} has {got} along '{dim}', needs {length} elements{_order_remedy(value, shape)}")
        flat = list(joined.from_iterable(flat))
    if any(isinstance(entry, list | tuple) for entry in flat):
        raise InputError(f"{key} has more dimensions than {', '.join(dims) or 'none'}")
    return flat


def _order_remedy(value: Any, shape: tuple[int, ...]) -> str:
    """Return a remedy for lists whose dimensions are in another order."""
    lengths = []
    while isinstance(value, list | tuple):
        lengths.append(len(value))
        value = value[0] if value else None
    is_reordered = tuple(lengths) != shape and sorted(lengths) == sorted(shape)
    return "; lists are nested in the order of dims: turn them" if is_reordered else ""


def _in_one_unit(
    flat: Sequence[Any], scale: Scale | None, *, difference: bool = False
) -> tuple[tuple[float, ...], Scale]:
    """Return numbers in the unit of the scale that is given, else in that of the first; differences know no offset."""
    convert = _conversion(scale, difference=difference)
    numbers: list[float] = []
    for entry in flat:
        if type(entry) is float and isfinite(entry):  # of a long list each is one
            numbers.append(entry if convert is None else convert(entry))
            continue
        entry = entry.item() if hasattr(entry, "item") else entry  # noqa: PLW2901 - a number of numpy
        if isinstance(entry, bool) or not isinstance(entry, str | int | float):
            raise InputError(f"value has {brief_repr(entry)}, needs numbers, or numbers with a unit")
        try:
            quantity = parse_quantity(entry, difference=difference)
        except InputError as fault:
            where = f"element {len(numbers)}, counted from 0: " if len(flat) > 1 else ""
            raise InputError(f"{where}{fault}") from None
        if not isinstance(entry, str):
            number = entry if isinstance(entry, float) else float(entry)  # which may know more digits
            numbers.append(number if convert is None else convert(number))
            continue
        if scale is None:
            scale = quantity.scale_of_numbers
            convert = _conversion(scale, difference=difference)
        unit = scale.unit
        if quantity.unit.dimension != unit.dimension:
            raise InputError(f"has '{entry}' beside values in '{unit.text}'; elements of one quantity need one unit")
        same = quantity.unit.text == unit.text
        numbers.append(quantity.value if same else float(quantity.unit.factor / unit.factor) * quantity.value)
    return tuple(numbers), Scale(parse_unit("1")) if scale is None else scale


def _conversion(scale: Scale | None, *, difference: bool) -> Callable[[float], float] | None:
    """Return the function that converts bare numbers on a scale to its unit; None where they are in it."""
    if scale is None or scale.is_unit:
        return None
    return scale.difference if difference else scale.value


def _read_by_label(
    values_by_label: Any, scale: Scale | None, dims: tuple[str, ...], shapes: Shapes
) -> tuple[tuple[float, ...], Scale]:
    """Read a table by label, whose values along further dimensions are tables, lists, or one number."""
    if not dims or not isinstance(values_by_label, Mapping):
        numbers, scale = _read_nested(values_by_label, scale, shapes.shape(dims), dims)
        return numbers if isinstance(values_by_label, list | tuple) else numbers * prod(shapes.shape(dims)), scale
    values_by_label = {
        str(label): numbers for label, numbers in values_by_label.items()
    }  # elements by number have no other names
    extent = shapes.extent(dims[0])
    labels = [extent.label(i) for i in range(extent.size)]
    for label in values_by_label:
        if label not in labels:
            raise InputError(f"values has '{label}', no element of '{extent.name}'{suggestion(label, tuple(labels))}")
    if missing := [label for label in labels if label not in values_by_label]:
        raise InputError(f"values lacks {first_names(missing)}; give one for each element of '{extent.name}'")
    flat: list[float] = []
    for label in labels:
        numbers, scale = _read_by_label(values_by_label[label], scale, dims[1:], shapes)
        flat += numbers
    return tuple(flat), scale or Scale(parse_unit("1"))


def _spreads(
    entry: Mapping[str, Any], scale: Scale, shape: tuple[int, ...], dims: tuple[str, ...]
) -> tuple[Spread | None, ...]:
    """Read uncertainties: one for all elements, or a list like that of the values."""
    value = Quantity(0.0, scale.unit)  # whose unit alone counts
    list_keys = [key for key in SIZES if isinstance(entry.get(key), list | tuple)]
    if wrong := [key for key in SIZES if is_expression(entry.get(key)) or is_meant(entry.get(key))]:
        raise InputError(
            f"{wrong[0]} is the expression '{entry[wrong[0]]}'; write one number with a unit for all elements, or a list"
            " with one for each"
        )
    if not list_keys:
        spread = read_spread(entry, value, scale)
        return () if spread is None else (spread,)
    key = list_keys[0]
    sizes, size_scale = _read_nested(entry[key], scale, shape, dims, key)
    kinds = {
        word: flat if len(flat) > 1 else flat * prod(shape)
        for word in ("distribution", "degrees_of_freedom")
        if word in entry and (flat := _flat_list(entry[word], shape, dims, word))
    }
    spreads = []
    for i, size in enumerate(sizes):
        kind = {word: entries[i] for word, entries in kinds.items() if entries[i] != NO_FREEDOM}
        spreads.append(read_spread({key: f"{size!r} {size_scale.unit.text}", **kind}, value))
    return tuple(spreads)


def written_values(values: Values, shapes: Shapes, *, declared: bool) -> Any:
    """Return the entry of a quantity with dimensions as it stands in TOML; `declared` if its dims stand elsewhere."""
    body: dict[str, Any] = {} if declared else {"dims": list(values.dims)}
    shape = shapes.shape(values.dims)
    if values.tree is not None:
        body["value"] = text_of(values.tree)
    else:
        is_one = len(values.numbers) == 1 != prod(shape)
        body["value"] = values.numbers[0] if is_one else nested_lists(values.numbers, shape)
    body |= {"unit": values.unit.text} if values.unit is not None else {}
    if spreads := [spread for spread in values.spreads if spread is not None]:
        first = spreads[0]
        sizes = [spread.size.value for spread in spreads]
        key = "half_width" if first.bounded else "uncertainty"
        unit_text = first.size.unit.text
        size_entry: Any = (
            nested_lists([f"{size!r} {unit_text}" for size in sizes], shape)
            if len(sizes) > 1
            else f"{sizes[0]!r} {unit_text}"
        )
        body[key] = size_entry
        distributions = [spread.distribution for spread in spreads]
        freedoms = [
            NO_FREEDOM if spread.degrees_of_freedom is None else spread.degrees_of_freedom for spread in spreads
        ]
        if {*distributions} != {RECTANGULAR if first.bounded else NORMAL}:
            body["distribution"] = _shared(distributions, shape)
        if {*freedoms} != {NO_FREEDOM}:
            body["degrees_of_freedom"] = _shared(freedoms, shape)
    body |= {"description": values.description} if values.description else {}
    return body["value"] if declared and [*body] == ["value"] else body


def _shared(flat: Sequence[Any], shape: tuple[int, ...]) -> Any:
    """Return what all elements have, or lists with one for each."""
    return flat[0] if len({*flat}) == 1 else nested_lists(flat, shape)


def uniform_spreads(spreads: Sequence[Spread | None], unit: Unit) -> tuple[Spread, ...]:
    """Return spreads of elements as a file has them: one that all have, or in a unit all of one kind.

    Of standard deviations beside half widths all become standard deviations. Where some elements have a spread, those
    without have one of size 0.
    """
    stated = [spread for spread in spreads if spread is not None]
    if len({*spreads}) == 1:
        return tuple(stated[:1])
    is_mixed = len({spread.bounded for spread in stated}) > 1
    uniform = []
    for spread in (replace(stated[0], size=Quantity(0.0, unit)) if spread is None else spread for spread in spreads):
        size = spread.standard if is_mixed else spread.size
        same = size.unit.text == unit.text
        number = size.value if same else float(size.unit.factor / unit.factor) * size.value
        uniform.append(replace(spread, size=Quantity(number, unit), bounded=spread.bounded and not is_mixed))
    return tuple(uniform)


def nested_lists(flat: Sequence[Any], shape: tuple[int, ...]) -> Any:
    """Return numbers as lists in lists, the last dimension innermost."""
    rows = list(flat)
    for length in reversed(shape[1:]):
        rows = [rows[i : i + length] for i in range(0, len(rows), length)]
    return rows if shape else rows[0]


def unit_of_values(values: Values) -> Unit:
    """Return the unit of a parameter with dimensions: as given, or the SI unit of its expression.

    Raises
    ------
    InputError
        If the expression reads anything but constants and numbers of elements, or has a unit where one is given.
    """
    if values.tree is None:
        assert values.unit is not None  # noqa: S101 - numbers have a unit
        return values.unit
    constant_dimensions = {name: constant(name).dimension for name in (*CONSTANTS, *CALENDAR)} | {"pi": NONE}
    if unknown_names := sorted(free_names(values.tree) - constant_dimensions.keys()):
        raise InputError(
            f"'{shortened_text(values.tree)}' reads '{unknown_names[0]}'; a parameter by an expression is of constants and index(…):"
            " what follows from other parameters is a definition"
        )
    dimension = dimension_of(values.tree, constant_dimensions)
    if values.unit is not None and dimension != NONE:
        raise InputError(
            f"has unit '{values.unit.text}' beside '{shortened_text(values.tree)}', which has units '{dimension}' itself; leave the unit out"
        )
    return spell(dimension) if values.unit is None else values.unit

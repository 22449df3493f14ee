"""The axes of a grid of runs: what varies along each, in values with units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.cached import cached_property
from xdynamics.faults import InputError, Ledger
from xdynamics.model import Model
from xdynamics.model.spread import deviations, matrix_of
from xdynamics.schema import AT, AT_TIME, OCCURRENCE
from xdynamics.sweeping.designs import DECLARED, Draws
from xdynamics.sweeping.tables import is_wide, narrow, text_of
from xdynamics.units import NONE, Quantity, Range, Unit, is_range, parse_quantity, parse_unit

Values = NDArray[Any]

PARAMETER, INITIAL, START, STEP, RTOL, TABLE, SETTING = (
    "parameter", "initial", "start", "step", "rtol", "table", "setting",
)  # fmt: skip
NUMBERS = (PARAMETER, INITIAL, STEP, RTOL)  # kinds whose members march side by side
OF_MODEL = {PARAMETER: "parameters", INITIAL: "initial", START: "initial"}  # and their section there
FOR_INITIAL = "initial_"  # before the name of an initial value, where the axis is to have another one than the variable
# settings that are numbers or words; those that are rows or mappings are no axis
SETTINGS = (
    "method", "until", "estimator", "safety", "min_step", "max_step", "max_steps", "jacobian", "summation", "switches",
    "time_tolerance", "atol",
)  # fmt: skip
TIMES = ("until", "min_step", "max_step", "time_tolerance")
TAKEN = (AT, AT_TIME, OCCURRENCE, "occurrence_number", "model_toml")  # names of what is no axis
MOST_AXES, MOST_VALUES = 24, 10_000_000  # and values along one


@dataclass(frozen=True)
class Column:
    """One thing that varies along an axis.

    Attributes
    ----------
    name : str
        Of a parameter, an initial value, a drive, or an argument of `simulate`.
    kind : str
        `PARAMETER`, `INITIAL`, `START` (the initial t), `STEP`, `RTOL`, `TABLE` or `SETTING`.
    values : ndarray, shape (n,)
        Numbers in `unit`, or words.
    unit : Unit
    label : str
        What it is called in the Dataset.
    tables : tuple of str
        CSV text of each value, of a drive.
    """

    name: str
    kind: str
    values: Values
    unit: Unit
    label: str
    tables: tuple[str, ...] = ()

    @cached_property
    def si(self) -> Values:
        """The values in SI units, correctly rounded."""
        return np.array([self.unit.to_si(one) for one in self.values.tolist()])

    def quantity(self, i: int) -> Any:
        """Return one value as a model or `simulate` takes it."""
        if self.kind in (*OF_MODEL, STEP) or self.name in TIMES:
            return str(Quantity(float(self.values[i]), self.unit))
        return self.values[i].item() if isinstance(self.values[i], np.generic) else self.values[i]


@dataclass(frozen=True)
class Axis:
    """A dimension of a grid.

    Attributes
    ----------
    dim : str
    columns : tuple of Column
        One, or several that vary together.
    design : Draws, optional
        How the values were drawn.
    """

    dim: str
    columns: tuple[Column, ...]
    design: Draws | None = None

    @property
    def size(self) -> int:
        """How many values there are."""
        return len(self.columns[0].values)


def axes_of(model: Model, given: Mapping[str, Any]) -> tuple[Axis, ...]:
    """Read the axes of a grid.

    Raises
    ------
    InputError
        With every fault.
    """
    if not isinstance(given, Mapping) or not given:
        raise InputError(f"axes are {str(given)[:60]}, need a mapping like {{'c': ['1 kg', '2 kg']}}")
    ledger, found = Ledger(f"the axes of a sweep of '{model.name}'"), []
    for name, values in given.items():
        with ledger.entry(f"axis {name!r}"):
            found.append(_axis(model, str(name), values))
    ledger.settle()
    _check_once(found)
    if len(found) > MOST_AXES:
        raise InputError(f"there are {len(found)} axes, {MOST_AXES} at most; let some vary together, or draw them")
    return tuple(found)


def _axis(model: Model, dim: str, given: Any) -> Axis:
    if isinstance(given, Draws):
        return Axis(dim, _drawn(model, given), given)
    if not isinstance(given, Mapping):
        column = column_of(model, dim, given)
        if (twice := _twice(column.values)) is not None:
            raise InputError(f"has {twice!r} more than once")
        return Axis(dim, (column,))
    if not given:
        raise InputError("varies nothing; give names with as many values each")
    if dim not in given and dim in (*TAKEN, *model.parameters, *model.units, *model.drives, *model.observables):
        raise InputError(
            f"is the name of something else; call what varies together in another way, like '{dim}_together'"
        )
    columns = tuple(column_of(model, str(name), values) for name, values in given.items())
    sizes = {one.label: len(one.values) for one in columns}
    if len({*sizes.values()}) > 1:
        counts = ", ".join(f"{name} has {size}" for name, size in sizes.items())
        raise InputError(f"what varies together needs as many values each: {counts}")
    return Axis(dim, columns)


def _twice(values: Values) -> Any:
    """Return a value that is there more than once; None where there is none."""
    ordered = np.sort(values.astype(str) if values.dtype == object else values)
    again = np.flatnonzero(ordered[1:] == ordered[:-1])
    return ordered[again[0]].item() if again.size else None


def _drawn(model: Model, draws: Draws) -> tuple[Column, ...]:
    """Put points between the ends of each range, or around each parameter."""
    points, names, found = draws.points(), list(draws.ranges), []
    if draws.design == DECLARED:
        known = model.uncertain | {
            f"{FOR_INITIAL}{name}": one for name, one in model.starts.items() if one.uncertainty > 0
        }
        for name in names:
            if name not in known:
                raise InputError(f"'{name}' has no uncertainty in the model; there are {', '.join(known) or 'none'}")
        off = deviations(
            [spread for name in names if (spread := known[name].spread)],
            matrix_of([one.removeprefix(FOR_INITIAL) for one in names], model.correlations),
            points,
        )
        for i, name in enumerate(names):
            value, unit = known[name].quantity.value, known[name].quantity.unit
            found.append(replace(column_of(model, name, [f"{value!r} {unit.text}"]), values=value + known[name].uncertainty * off[:, i]))  # fmt: skip
        return tuple(found)
    for i, name in enumerate(names):
        column = range_of(model, name, draws.ends[name])
        low, high = column.values.tolist()
        found.append(replace(column, values=low + (high - low) * points[:, i]))
    return tuple(found)


def range_of(model: Model, name: str, ends: Sequence[Any]) -> Column:
    """Return the lowest and the highest number that something is to have.

    Raises
    ------
    InputError
        If it means nothing, or the ends are no two numbers in that order.
    """
    column = column_of(model, name, list(ends))
    if len(column.values) != 2 or column.kind not in NUMBERS or not column.values[0] < column.values[1]:
        got = ", ".join(
            f"{one:.9g} {column.unit.text}" if column.kind in NUMBERS else str(one) for one in column.values
        )
        raise InputError(f"'{name}' needs two numbers, first the lowest, then the highest; got {got}")
    return column


def column_of(model: Model, name: str, given: Any) -> Column:
    """Find out what a name means, and read its values.

    Raises
    ------
    InputError
        If it means nothing, or a value cannot be used.
    """
    if name in model.parameters:
        return _quantities(name, PARAMETER, given, model.parameters[name].quantity.unit, name)
    initial = name.removeprefix(FOR_INITIAL)
    if initial in model.initial:
        kind = START if initial == "t" else INITIAL
        return _quantities(initial, kind, given, model.initial[initial].unit, name)
    if name in model.drives:
        return _tables(name, given)
    if name == STEP:
        return _positive(_quantities(name, STEP, given, model.time_unit, name))
    if name == RTOL:
        return _positive(_quantities(name, RTOL, given, parse_unit("1"), name))
    if name in SETTINGS:
        return _settings(model, name, given)
    known = [*model.parameters, *model.initial, *model.drives, STEP, RTOL, *SETTINGS]
    raise InputError(f"'{name}' is nothing that can vary; there are {', '.join(known)}")


def _quantities(name: str, kind: str, given: Any, declared: Unit, label: str) -> Column:
    """Read numbers with a unit; those without have the declared one."""
    values, unit = numbers_of(given, declared)
    return Column(name, kind, values, unit, label)


def numbers_of(given: Any, declared: Unit) -> tuple[Values, Unit]:
    """Read values: a text with a range or a list, a row of texts or numbers, an array with units.

    Raises
    ------
    InputError
        If one is no finite number of the kind that is needed.
    """
    if is_range(given):
        values, told = _range(given)
        unit = declared if told == parse_unit("1") else told
        return _plain(values, unit, declared), unit
    if isinstance(given, str):
        quantities = _of_text(given)
    elif isinstance(given, Quantity | int | float):
        quantities = [_quantity(given, declared)]
    else:
        attrs = getattr(given, "attrs", {})
        unit = parse_unit(str(attrs["units"])) if "units" in attrs else declared
        try:
            row = getattr(given, "values", given)
            row = row if isinstance(row, np.ndarray) and row.dtype.kind in "fiu" and row.ndim == 1 else list(row)
        except TypeError:
            raise InputError(f"is {str(given)[:60]!r}, needs values like ['1 {declared.text}']") from None
        if isinstance(row, np.ndarray):
            return _plain(row, unit, declared), unit
        quantities = [_quantity(one, unit) for one in row]
    if not quantities:
        raise InputError("has no values")
    quantities = _with_unit(quantities, declared)
    for one in quantities:
        _check_unit(one.value, one.unit, declared)
    unit = quantities[0].unit
    return np.array([_in(one, unit) for one in quantities]), unit


def _plain(values: Values, unit: Unit, declared: Unit) -> Values:
    """Check an array of numbers in one unit."""
    if not values.size:
        raise InputError("has no values")
    bad = values[~np.isfinite(values)]
    if bad.size:
        raise InputError(f"has {float(bad[0])!r}, needs finite numbers")
    _check_unit(float(values[0]), unit, declared)
    return values.astype(float)


def _check_unit(value: float, unit: Unit, declared: Unit) -> None:
    if unit.dimension != declared.dimension:
        raise InputError(f"has {value!r} {unit.text}, needs the unit '{declared.text}'")


def _with_unit(quantities: list[Quantity], unit: Unit) -> list[Quantity]:
    """Give a unit to those that were told without."""
    bare = parse_unit("1")
    return [Quantity(one.value, unit) if one.unit == bare else one for one in quantities]


def _in(one: Quantity, unit: Unit) -> float:
    if one.unit.factor == unit.factor:
        return float(one.value)
    return float(Fraction(repr(one.value)) * one.unit.factor / unit.factor)


def _quantity(given: Any, declared: Unit) -> Quantity:
    if isinstance(given, Quantity):
        return given
    if isinstance(given, np.generic):
        given = given.item()
    if isinstance(given, bool):
        raise InputError(f"has {given!r}, needs numbers")
    if isinstance(given, int | float):
        if not np.isfinite(given):
            raise InputError(f"has {given!r}, needs finite numbers")
        return Quantity(float(given), declared)
    return parse_quantity(given)


def _of_text(text: str) -> list[Quantity]:
    """Read ``1, 2, 5 kg`` or ``1 kg``."""
    if ":" in text:
        raise InputError(f"is {text!r}, needs start:stop:count unit, count a whole number, like '0:2e-3:41 kg m-1'")
    parts = [parse_quantity(one) for one in text.split(",")]
    return _with_unit(parts, parts[-1].unit)


def _range(text: str) -> tuple[Values, Unit]:
    """Read ``0:2e-3:41 kg m-1``: start:stop:count, both ends included."""
    found = Range.parse(text)
    if not (1 < found.count <= MOST_VALUES or (found.count == 1 and found.start == found.stop)):
        raise InputError(f"is {text!r}, needs start:stop:count unit, both ends included, count from 2 to {MOST_VALUES}")
    return np.linspace(found.start, found.stop, found.count), found.unit


def _positive(column: Column) -> Column:
    bad = column.values[~(column.values > 0)]
    if bad.size:
        raise InputError(f"has {float(bad[0])!r} {column.unit.text}, needs positive values")
    return column


def _settings(model: Model, name: str, given: Any) -> Column:
    """Read words or numbers that `simulate` takes."""
    if name in TIMES:
        return _quantities(name, SETTING, given, model.time_unit, name)
    row: Sequence[Any] = [one.strip() for one in given.split(",")] if isinstance(given, str) else given
    if isinstance(row, int | float) or not hasattr(row, "__iter__"):
        row = [row]
    values = [one.item() if isinstance(one, np.generic) else one for one in row]
    if not values:
        raise InputError("has no values")
    wrong = [one for one in values if isinstance(one, bool) or not isinstance(one, str | int | float)]
    if wrong:
        raise InputError(f"has {wrong[0]!r}, needs words or numbers")
    words = any(isinstance(one, str) for one in values)
    found = np.array([str(one) for one in values], object) if words else np.array(values, float)
    return Column(name, SETTING, found, Unit("1", NONE), name)


def _tables(name: str, given: Any) -> Column:
    """Read the tables that a drive is given by: files of two columns, or every column of a wide one."""
    files = [given] if isinstance(given, str | Path) else list(given)
    found: dict[str, str] = {}
    for one in files:
        if not isinstance(one, str | Path):
            raise InputError(f"has {str(one)[:40]!r}, needs names of CSV files")
        for label, text in (narrow(Path(one)) if is_wide(Path(one)) else {Path(one).stem: text_of(Path(one))}).items():
            if label in found:
                raise InputError(f"has two tables called '{label}'")
            found[label] = text
    return Column(name, TABLE, np.array([*found], object), Unit("1", NONE), name, tuple(found.values()))


def _check_once(axes: Sequence[Axis]) -> None:
    seen: dict[tuple[str, str], str] = {}
    for axis in axes:
        for one in axis.columns:
            if (one.kind, one.name) in seen:
                raise InputError(f"'{one.name}' varies along both '{seen[one.kind, one.name]}' and '{axis.dim}'; give it one axis")  # fmt: skip
            seen[one.kind, one.name] = axis.dim

"""The axes of a grid of runs: what varies along each, in values with units.

Values are given as a range, a list, a row of texts or numbers, or an array with units. Values may be drawn: Sobol
points, a Latin hypercube, or from the distributions that a model declares. Of measured tables with several columns,
each column is one table.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.faults import InputError, Ledger
from xdynamics.model import Model
from xdynamics.model.controllers import check_in_effect
from xdynamics.model.csv_sheet import Sheet
from xdynamics.model.drives import doubts_of
from xdynamics.model.instruments import as_table
from xdynamics.model.uncertainty import correlation_matrix, draw_deviations
from xdynamics.record.folding import elements_of, quantity_names
from xdynamics.runtime.files import decoded, read_bounded, reason
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.schema import AT, AT_TIME, OCCURRENCE
from xdynamics.shapes.naming import DOT, display_text, internal_text, split_element_name
from xdynamics.units import NONE, Quantity, Range, Scale, Unit, is_range, parse_quantity, parse_scale, parse_unit
from xdynamics.units.unit import Rounded, decimal_text

Values = NDArray[Any]

MAX_VALUES = 10_000_000  # along one axis


def axis_numbers(entries: Any, declared: Scale) -> tuple[Values, Unit]:
    """Read values: a text with a range or a list, a row of texts or numbers, an array with units.

    Those without a unit are on the declared scale.

    Raises
    ------
    InputError
        If there are no values, or one is not a finite number with a unit of the declared dimension.
    """
    values, unit = exact_numbers(entries, declared)
    return np.array(values, float), unit


def exact_numbers(entries: Any, declared: Scale) -> tuple[Values | list[float], Unit]:
    """Read the values along an axis; numbers in a list keep written digits beyond those of a float.

    Raises
    ------
    InputError
        If there are no values, or one is not a finite number with a unit of the declared dimension.
    """
    if is_range(entries):
        values, unit = _read_range(entries)
        if unit == parse_unit("1"):
            values, unit = _scaled_numbers(values, declared), declared.unit
        return _checked_array(values, unit, declared.unit), unit
    if isinstance(entries, str):
        quantities = _read_list_text(entries)
    elif isinstance(entries, Quantity | int | float):
        quantities = [_read_quantity(entries, declared)]
    else:
        attrs = getattr(entries, "attrs", {})
        scale = parse_scale(str(attrs["units"])) if "units" in attrs else declared
        try:
            row = getattr(entries, "values", entries)
            row = row if isinstance(row, np.ndarray) and row.dtype.kind in "fiu" and row.ndim == 1 else list(row)
        except TypeError:
            raise InputError(f"is {str(entries)[:60]!r}, needs values like ['1 {declared.unit.text}']") from None
        if isinstance(row, np.ndarray):
            return _checked_array(_scaled_numbers(row, scale), scale.unit, declared.unit), scale.unit
        quantities = [_read_quantity(quantity, scale) for quantity in row]
    if not quantities:
        raise InputError("has no values")
    quantities = _with_default_unit(quantities, declared)
    for quantity in quantities:
        _check_unit(quantity.value, quantity.unit, declared.unit)
    unit = quantities[0].unit
    return [quantity.into(unit).value for quantity in quantities], unit


def _checked_array(values: Values, unit: Unit, declared: Unit) -> Values:
    """Check an array of numbers in one unit."""
    if not values.size:
        raise InputError("has no values")
    non_finite = values[~np.isfinite(values)]
    if non_finite.size:
        raise InputError(f"has {float(non_finite[0])!r}, needs finite numbers")
    _check_unit(float(values[0]), unit, declared)
    return values.astype(float)


def _check_unit(value: float, unit: Unit, declared: Unit) -> None:
    if unit.dimension != declared.dimension:
        raise InputError(f"has {value!r} {unit.text}, needs the unit '{declared.text}'")


def _scaled_numbers(values: Values, scale: Scale) -> Values:
    """Return bare numbers in the unit of their scale."""
    return values if scale.is_unit else np.array([*map(scale.value, values.tolist())])


def _with_default_unit(quantities: list[Quantity], scale: Scale) -> list[Quantity]:
    """Give quantities without a unit the unit of a scale."""
    no_unit = parse_unit("1")
    return [
        Quantity(scale.value(quantity.value), scale.unit) if quantity.unit == no_unit else quantity
        for quantity in quantities
    ]


def _read_quantity(value: Any, declared: Scale) -> Quantity:
    if isinstance(value, Quantity):
        return value
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, bool):
        raise InputError(f"has {value!r}, needs numbers")
    if isinstance(value, int | float):
        if not np.isfinite(value):
            raise InputError(f"has {value!r}, needs finite numbers")
        return Quantity(declared.value(float(value)), declared.unit)
    return parse_quantity(value)


def _read_list_text(text: str) -> list[Quantity]:
    """Read ``1, 2, 5 kg`` or ``1 kg``."""
    if ":" in text:
        raise InputError(f"is {text!r}, needs start:stop:count unit, count a whole number, like '0:2e-3:41 kg m-1'")
    quantities = [parse_quantity(part) for part in text.split(",")]
    return _with_default_unit(quantities, quantities[-1].scale_of_numbers)


def _read_range(text: str) -> tuple[Values, Unit]:
    """Read ``0:2e-3:41 kg m-1``: start:stop:count, both ends included."""
    value_range = Range.parse(text)
    if not (1 < value_range.count <= MAX_VALUES or (value_range.count == 1 and value_range.start == value_range.stop)):
        raise InputError(f"is {text!r}, needs start:stop:count unit, both ends included, count from 2 to {MAX_VALUES}")
    return np.linspace(value_range.start, value_range.stop, value_range.count), value_range.unit


SOBOL, LATIN, DECLARED = "sobol", "latin_hypercube", "declared"
DESIGNS = (SOBOL, LATIN, DECLARED)
MIN_PROBABILITY = 2.0**-54  # smallest probability at which an unbounded distribution is evaluated


@dataclass(frozen=True)
class Draws:
    """Values of several parameters or initial values drawn together, for an axis of a sweep.

    Parameters
    ----------
    count : int
        Number of draws; for Sobol points a power of two.
    ranges : mapping of str to (lowest, highest), or sequence of str
        Ranges to draw from: ``{"m": ("1 kg", "2 kg")}``. For the design ``declared``, names of parameters and initial
        values that have an uncertainty in the model: each is drawn from its distribution, normal ones with their
        correlations.
    design : {"sobol", "latin_hypercube", "declared"}
    seed : int
        Recorded, like the values.

    Raises
    ------
    InputError
        If count, ranges, design or seed cannot be used; with every fault.

    Notes
    -----
    Scrambled Sobol points: Owen 1998 (doi:10.1006/jcom.1998.0487), by `scipy.stats.qmc`; Latin hypercube: McKay,
    Beckman, Conover 1979 (doi:10.1080/00401706.1979.10489755).

    Examples
    --------
    >>> import xdynamics as xd
    >>> axes = {"draw": xd.Draws(8, {"v_y": ("10 m s-1", "20 m s-1")}, seed=1)}
    >>> model = xd.Model.from_toml("data/models/ball_drag.toml")
    >>> found = xd.sweep(model, axes, until="1 s")
    >>> found.sizes["draw"], bool((found.v_y < 20).all())
    (8, True)
    """

    count: int
    ranges: Mapping[str, Sequence[Any]] | Sequence[str] = field(default_factory=dict)
    design: str = SOBOL
    seed: int = 0

    def __post_init__(self) -> None:
        faults = []
        if isinstance(self.count, bool) or not isinstance(self.count, int) or self.count < 1:
            faults.append(f"count is {self.count!r}, needs a positive whole number")
        # n & (n - 1) drops the lowest bit: only a power of two leaves nothing
        elif self.design == SOBOL and self.count & (self.count - 1):
            next_power = 1 << self.count.bit_length()
            faults.append(f"count is {self.count}, and Sobol points need a power of two, like {next_power}")
        if self.design not in DESIGNS:
            faults.append(f"design is {self.design!r}; there are {', '.join(DESIGNS)}")
        if isinstance(self.seed, bool) or not isinstance(self.seed, int) or self.seed < 0:
            faults.append(f"seed is {self.seed!r}, needs a non-negative whole number")
        if isinstance(self.ranges, str) or not self.ranges:
            faults.append(f"ranges are {self.ranges!r}, need names, and of what is no declared design their ends")
        elif self.design == DECLARED and (isinstance(self.ranges, Mapping) or not hasattr(self.ranges, "__iter__")):
            faults.append(
                f"ranges are {str(self.ranges)[:60]}, and what a model declares is drawn by names alone: ['m', 'k']"
            )
        if self.design != DECLARED and not isinstance(self.ranges, Mapping):
            faults.append(
                f"a design of {self.design} needs the lowest and the highest of each: {{'m': ('1 kg', '2 kg')}}"
            )
        if faults:
            raise InputError("draws: " + "; ".join(faults), tuple(faults))

    @property
    def ends(self) -> Mapping[str, Sequence[Any]]:
        """Lowest and highest value of each name; empty for a declared design."""
        return self.ranges if isinstance(self.ranges, Mapping) else {}

    def points(self) -> NDArray[np.float64]:
        """Return numbers from 0 to 1, one row per draw, one column per name; the declared design never gives 0 or 1."""
        rng, dimensions = np.random.default_rng(self.seed), len(self.ranges)
        if self.design == DECLARED:
            # random gives multiples of 2**-53, 0 among them, where an unbounded distribution has no finite value
            return np.maximum(rng.random((self.count, dimensions)), MIN_PROBABILITY)
        from scipy.stats import qmc

        sampler = (qmc.Sobol if self.design == SOBOL else qmc.LatinHypercube)(dimensions, seed=rng)
        sample: NDArray[np.float64] = sampler.random(self.count)
        return sample


MAX_BYTES = 50_000_000  # bytes


def csv_text(path: Path) -> str:
    """Read a CSV file.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    try:
        return decoded(read_bounded(path, MAX_BYTES)).replace("\r\n", "\n").replace("\r", "\n")
    except OSError as error:
        raise InputError(f"table '{path}' cannot be read: {reason(error, path)}") from None
    except ValueError as error:
        raise InputError(f"table '{path}' cannot be read: {error}") from None


def has_many_columns(path: Path) -> bool:
    """Whether a table has more than one column besides its argument and uncertainties."""
    return len(_value_columns(_sheet(path))) > 1


def split_table(path: Path) -> dict[str, str]:
    """Split a wide table: CSV text with argument, value and perhaps its uncertainty, by the name in the header.

    Raises
    ------
    InputError
        If a name occurs twice, or a row has another number of cells.
    """
    sheet = _sheet(path)
    tables = {}
    for label, columns in _value_columns(sheet):
        sheet.columns(columns)  # raises if they cannot be read
        tables[label] = _csv_of_columns(
            [list(sheet.header), *(cells for _, cells in sheet.lines)], columns, sheet.decimal
        )
    return tables


def _csv_of_columns(rows: list[list[str]], columns: Sequence[int], decimal: str) -> str:
    """Write some columns as CSV; numbers stay the texts that they are, with decimal points."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([row[k].replace(decimal, ".") for k in columns] for row in rows)
    return text.getvalue()


def _sheet(path: Path) -> Sheet:
    return Sheet.from_text(str(path), as_table(path.name, csv_text(path)))


def _value_columns(sheet: Sheet) -> list[tuple[str, tuple[int, ...]]]:
    """Return the value columns by name, each with the indices of the argument, itself and its uncertainties."""
    names = [title.name for title in sheet.titles()]
    uncertainties = {names[column_index] for name in names for column_index in doubts_of(name, names).values()}
    return [
        (name, (0, k, *doubts_of(name, names).values()))
        for k, name in enumerate(names)
        if k and name not in uncertainties
    ]


PARAMETER, INITIAL, START, STEP, RTOL, TABLE, SETTING = (
    "parameter",
    "initial",
    "start",
    "step",
    "rtol",
    "table",
    "setting",
)
NUMBERS = (PARAMETER, INITIAL, STEP, RTOL)  # kinds whose members march side by side
MODEL_SECTIONS = {PARAMETER: "parameters", INITIAL: "initial", START: "initial"}  # and their section in the model
INITIAL_PREFIX = "initial_"  # prefix of an initial value, for an axis that needs another name than the variable
SETTING_PREFIX = "solver_"  # prefix of a setting, as a record's attributes have it
# settings that are numbers or words; rows and mappings cannot be an axis
SETTINGS = (
    "method",
    "until",
    "order",
    "estimator",
    "safety",
    "min_step",
    "max_step",
    "max_steps",
    "jacobian",
    "summation",
    "precision",
    "switches",
    "time_tolerance",
    "atol",
)
TIMES = ("until", "min_step", "max_step", "time_tolerance")
RESERVED_NAMES = (AT, AT_TIME, OCCURRENCE, "occurrence_number", "model_toml")  # names that no axis can have
MAX_AXES = 24


@dataclass(frozen=True)
class AxisColumn:
    """One quantity or setting that varies along an axis.

    Attributes
    ----------
    name : str
        Name of a parameter, an initial value, a drive, or an argument of `simulate`.
    kind : str
        `PARAMETER`, `INITIAL`, `START` (the initial t), `STEP`, `RTOL`, `TABLE` or `SETTING`.
    values : ndarray, shape (n,)
        Numbers in `unit`, or words.
    unit : Unit
    label : str
        Its name in the Dataset; that of a setting is the record's, ``solver_method``.
    tables : tuple of str
        CSV text of each value of a drive.
    elements : tuple of str
        Of a quantity with dimensions, all of which have the value.
    digits : tuple of float
        The values as they were written, where that is with more digits than floats have.
    """

    name: str
    kind: str
    values: Values
    unit: Unit
    label: str
    tables: tuple[str, ...] = ()
    elements: tuple[str, ...] = ()
    digits: tuple[float, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """The quantities of a model that an axis sets: a single one, or all elements of a quantity with dimensions."""
        return self.elements or (self.name,)

    @property
    def exact_texts(self) -> list[str]:
        """The written decimal digits, where floats have fewer: part of a sweep's digest."""
        return list(map(decimal_text, self.digits))

    @cached_property
    def si(self) -> Values:
        """The values in SI units, correctly rounded."""
        return np.array([self.unit.to_si(value) for value in self.values.tolist()])

    def quantity(self, i: int) -> Any:
        """Return one value as a model or `simulate` takes it."""
        if self.kind in (*MODEL_SECTIONS, STEP) or self.name in TIMES:
            return str(Quantity(self.digits[i] if self.digits else float(self.values[i]), self.unit))
        return self.values[i].item() if isinstance(self.values[i], np.generic) else self.values[i]


@dataclass(frozen=True)
class Axis:
    """A dimension of a grid.

    Attributes
    ----------
    dim : str
    columns : tuple of AxisColumn
        One column, or several that vary together.
    design : Draws, optional
        How the values were drawn.
    """

    dim: str
    columns: tuple[AxisColumn, ...]
    design: Draws | None = None

    @property
    def size(self) -> int:
        """Number of values."""
        return len(self.columns[0].values)


def read_axes(model: Model, entries: Mapping[str, Any]) -> tuple[Axis, ...]:
    """Read the axes of a grid.

    Raises
    ------
    InputError
        With every fault.
    """
    if not isinstance(entries, Mapping) or not entries:
        raise InputError(f"axes are {str(entries)[:60]}, need a mapping like {{'c': ['1 kg', '2 kg']}}")
    ledger, axes = Ledger(f"the axes of a sweep of '{model.name}'"), []
    for name, values in entries.items():
        with ledger.entry(f"axis {name!r}"):
            axes.append(_read_axis(model, display_text(model.shapes.internal_name(str(name))), values))
    ledger.raise_faults()
    _check_single_axis(axes)
    if len(axes) > MAX_AXES:
        raise InputError(f"there are {len(axes)} axes, {MAX_AXES} at most; let some vary together, or draw them")
    return tuple(axes)


def _display_label(name: str) -> str:
    """Return a name as people write it: ``m[Sun]``."""
    return display_text(internal_text(name))


def _read_axis(model: Model, dim: str, entries: Any) -> Axis:
    elements = model.elements
    if dim in (*model.shapes.extents, *model.shapes.relations):
        raise InputError(f"is a dimension of the model; call what varies in another way, like '{dim}_together'")
    if isinstance(entries, Draws):
        return Axis(dim, _drawn_columns(model, entries), entries)
    if not isinstance(entries, Mapping):
        column = column_of(model, dim, entries)
        if (repeated := _repeated_value(column.values)) is not None:
            raise InputError(f"has {repeated!r} more than once")
        return Axis(column.label, (column,))
    if not entries:
        raise InputError("varies nothing; give names with as many values each")
    if dim not in entries and dim in (
        *RESERVED_NAMES,
        *elements.statement.parameters,
        *elements.units,
        *elements.drives,
        *elements.observables,
    ):
        raise InputError(
            f"is the name of something else; call what varies together in another way, like '{dim}_together'"
        )
    if dim.startswith(SETTING_PREFIX):
        raise InputError(f"begins as settings do, '{SETTING_PREFIX}…'; call what varies together in another way")
    columns = tuple(column_of(model, str(name), values) for name, values in entries.items())
    sizes = {varying.label: len(varying.values) for varying in columns}
    if len({*sizes.values()}) > 1:
        counts = ", ".join(f"{name} has {size}" for name, size in sizes.items())
        raise InputError(f"what varies together needs as many values each: {counts}")
    return Axis(next((varying.label for varying in columns if varying.name == dim), dim), columns)


def _repeated_value(values: Values) -> Any:
    """Return a value that occurs more than once; None if there is none."""
    ordered = np.sort(values.astype(str) if values.dtype == object else values)
    repeats = np.flatnonzero(ordered[1:] == ordered[:-1])
    return ordered[repeats[0]].item() if repeats.size else None


def _drawn_columns(model: Model, draws: Draws) -> tuple[AxisColumn, ...]:
    """Return columns of drawn points, scaled to the range or the distribution of each parameter."""
    if draws.design == DECLARED:
        declared = model.uncertain | {
            f"{INITIAL_PREFIX}{name}": entry for name, entry in model.elements.starts.items() if entry.uncertainty > 0
        }
        draws = replace(draws, ranges=_declared_names(map(model.shapes.internal_name, draws.ranges), declared))
    points, names, columns = draws.points(), [*map(model.shapes.internal_name, draws.ranges)], []
    if draws.design == DECLARED:
        offsets = draw_deviations(
            [spread for name in names if (spread := declared[name].spread)],
            correlation_matrix([entry.removeprefix(INITIAL_PREFIX) for entry in names], model.elements.correlations),
            points,
        )
        for i, name in enumerate(names):
            value, unit = declared[name].quantity.value, declared[name].quantity.unit
            columns.append(
                replace(
                    column_of(model, name, [f"{value!r} {unit.text}"]),
                    values=value + declared[name].uncertainty * offsets[:, i],
                    digits=(),
                )
            )
        return tuple(columns)
    ends = model.shapes.with_internal_names(draws.ends, "draws have")
    for i, name in enumerate(names):
        column = range_of(model, name, ends[name])
        low, high = column.values.tolist()
        columns.append(replace(column, values=low + (high - low) * points[:, i], digits=()))
    return tuple(columns)


def _declared_names(requested_names: Iterable[str], declared: Mapping[str, Any]) -> list[str]:
    """Return names as they are inside, those of all elements for that of a quantity with dimensions."""
    names = dict[str, None]()
    for name in requested_names:
        matching_names = (
            [name] if name in declared else [entry for entry in declared if split_element_name(entry)[0] == name]
        )
        if not matching_names:
            raise InputError(
                f"'{display_text(name)}' has no uncertainty in the model; there are"
                f" {', '.join(quantity_names(declared)) or 'none'}{elements_of(name, declared)}"
            )
        names |= dict.fromkeys(matching_names)
    return [*names]


def range_of(model: Model, name: str, ends: Sequence[Any]) -> AxisColumn:
    """Read the lowest and the highest value of a parameter, an initial value or a setting.

    Raises
    ------
    InputError
        If the name cannot vary, or the ends are not two numbers in that order.
    """
    column = column_of(model, name, list(ends))
    if len(column.values) != 2 or column.kind not in NUMBERS or not column.values[0] < column.values[1]:
        ends_text = ", ".join(
            f"{value:.9g} {column.unit.text}" if column.kind in NUMBERS else str(value) for value in column.values
        )
        raise InputError(f"'{name}' needs two numbers, first the lowest, then the highest; got {ends_text}")
    return column


def column_of(model: Model, name: str, values: Any) -> AxisColumn:
    """Return the column of an axis: what its name refers to in the model, and its values.

    Raises
    ------
    InputError
        If the name cannot vary, or a value cannot be used.
    """
    elements = model.elements
    name = model.shapes.internal_name(name)
    if name in elements.statement.parameters:
        return _number_column(
            name,
            PARAMETER,
            values,
            elements.statement.parameters[name].quantity.scale_of_numbers,
            _display_label(name),
        )
    if (column := _quantity_column(model, name, values)) is not None:
        return column
    initial = name.removeprefix(INITIAL_PREFIX)
    if initial in elements.statement.initial:
        check_in_effect(initial, model.statement.controllers)
        kind = START if initial == "t" else INITIAL
        return _number_column(
            initial, kind, values, elements.statement.initial[initial].scale_of_numbers, _display_label(name)
        )
    if name in elements.drives:
        return _table_column(name, values)
    label = f"{SETTING_PREFIX}{name}"
    if name == STEP:
        return _positive_column(_number_column(name, STEP, values, Scale(model.time_unit), label))
    if name == RTOL:
        return _positive_column(_number_column(name, RTOL, values, Scale(parse_unit("1")), label))
    if name in SETTINGS:
        return _setting_column(model, name, values, label)
    quantities = quantity_names((*elements.statement.parameters, *elements.statement.initial))
    available = [*quantities, *elements.drives, STEP, RTOL, *SETTINGS]
    raise InputError(f"'{_display_label(name)}' is nothing that can vary; there are {', '.join(available)}")


def _quantity_column(model: Model, name: str, values: Any) -> AxisColumn | None:
    """Read values of a quantity with dimensions, each of which all its elements have; None if it is no such quantity."""
    quantity = name.removeprefix(INITIAL_PREFIX)
    elements = tuple(model.shapes.elements(quantity)) if quantity in model.shapes.dims else ()
    for kind, declared in (
        (PARAMETER, model.elements.statement.parameters),
        (INITIAL, model.elements.statement.initial),
    ):
        if elements and elements[0] in declared and (kind == INITIAL or name == quantity):
            return replace(column_of(model, elements[0], values), name=quantity, label=name, elements=elements)
    return None


def _number_column(name: str, kind: str, entries: Any, declared: Scale, label: str) -> AxisColumn:
    """Read numbers with a unit; those without one are on the declared scale."""
    values, unit = exact_numbers(entries, declared)
    if DOT in name and unit != declared.unit:  # the elements of a quantity have one unit
        values, unit = [Quantity(value, unit).into(declared.unit).value for value in list(values)], declared.unit
    digits = tuple(values) if any(isinstance(value, Rounded) for value in values) else ()
    return AxisColumn(name, kind, np.array(values, float), unit, label, digits=digits)


def _positive_column(column: AxisColumn) -> AxisColumn:
    non_positive = column.values[~(column.values > 0)]
    if non_positive.size:
        raise InputError(f"has {float(non_positive[0])!r} {column.unit.text}, needs positive values")
    return column


def _setting_column(model: Model, name: str, entries: Any, label: str) -> AxisColumn:
    """Read words or numbers that `simulate` takes."""
    if name in TIMES:
        return _number_column(name, SETTING, entries, Scale(model.time_unit), label)
    row: Sequence[Any] = [value.strip() for value in entries.split(",")] if isinstance(entries, str) else entries
    if isinstance(row, int | float) or not hasattr(row, "__iter__"):
        row = [row]
    values = [value.item() if isinstance(value, np.generic) else value for value in row]
    if not values:
        raise InputError("has no values")
    unusable = [value for value in values if isinstance(value, bool) or not isinstance(value, str | int | float)]
    if unusable:
        raise InputError(f"has {unusable[0]!r}, needs words or numbers")
    words = any(isinstance(value, str) for value in values)
    array = np.array([str(value) for value in values], object) if words else np.array(values, float)
    return AxisColumn(name, SETTING, array, Unit("1", NONE), label)


def _table_column(name: str, sources: Any) -> AxisColumn:
    """Read the tables of a drive: files of two columns, or every value column of a wide file."""
    files = [sources] if isinstance(sources, str | Path) else list(sources)
    tables: dict[str, str] = {}
    for file in files:
        if not isinstance(file, str | Path):
            raise InputError(f"has {str(file)[:40]!r}, needs names of CSV files")
        for label, text in (
            split_table(Path(file)) if has_many_columns(Path(file)) else {Path(file).stem: csv_text(Path(file))}
        ).items():
            if label in tables:
                raise InputError(f"has two tables called '{label}'")
            tables[label] = text
    return AxisColumn(name, TABLE, np.array([*tables], object), Unit("1", NONE), name, tuple(tables.values()))


def matching_dim(dims: Iterable[Any], word: str) -> str:
    """Return the dimension that a word means: its own, or that of the setting; sweeps of before had no prefix."""
    dim_names, setting = {*dims}, word.removeprefix(SETTING_PREFIX)
    return next((name for name in (word, f"{SETTING_PREFIX}{setting}", setting) if name in dim_names), word)


def _check_single_axis(axes: Sequence[Axis]) -> None:
    axis_by_column: dict[tuple[str, str], str] = {}
    for axis in axes:
        for column in axis.columns:
            for name in column.names:
                if (column.kind, name) in axis_by_column:
                    raise InputError(
                        f"'{name}' varies along both '{axis_by_column[column.kind, name]}' and '{axis.dim}'; give it one axis"
                    )
                axis_by_column[column.kind, name] = axis.dim

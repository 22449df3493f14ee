"""Measured data and the residuals of a run against them: differences, norms, and size by measured uncertainties.

Data come from a netCDF file, a table in text, or an object in memory; columns are matched with the run's quantities.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import archive
from xdynamics.dynamics.recorded_steps import model_of_record
from xdynamics.evidence.evidence_dataset import attrs_of, evidence_dataset, scale_of, scaled_variables
from xdynamics.evidence.observables import observables_of, observe
from xdynamics.faults import InputError, Ledger
from xdynamics.model.csv_sheet import Sheet, Title, cell_excerpt, clocks_of, is_clock, name_of_title, title
from xdynamics.model.drives import GAPS, JUMP, REFUSE, SKIP
from xdynamics.model.file_access import ANYWHERE, FileAccess
from xdynamics.model.instruments import AS_IT_IS, FIRST, Reading, as_table
from xdynamics.model.table_values import columns_of_frame, stamps
from xdynamics.record import unfold
from xdynamics.record.flag_words import time_unit_of
from xdynamics.record.folding import quantity_names, sized
from xdynamics.record.unfolding import get_column
from xdynamics.schema import AT, AT_TIME, EVIDENCE, MODEL_DIMENSIONS
from xdynamics.shapes import NO_SHAPES, Shapes, split_element_name
from xdynamics.units import SECONDS, TIME, Unit, parse_quantity, parse_scale, parse_unit, unit_suffix

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

_UNCERTAINTY = re.compile(r"u\((?P<name>.+)\)")
_Known = Sequence[str] | None
_Titles = tuple[dict[int, Title], tuple[str, ...]]
_OF_ELEMENT = re.compile(r"\s*(u\()?(\w+\[[^\[\]]*\])")
EVENT_TIMES, OCCURRENCES = "event_time_", "occurrence"  # columns of a table of events: one row is an occurrence
ARRAYS = (".nc", ".nc4", ".netcdf", ".cdf")  # files that are read as a Dataset
REMEDY = (
    "what it does not say is said by --column x=Position (its name for x), --units x=m, --header 't [s],x [m]' (titles in the"
    " place of its own), --skip 3 (lines before the header), --decimal , or in Python by reading={'columns': {'x': 'Position'}, …};"
    " `xdynamics help files`"
)


@dataclass(frozen=True)
class Measured:
    """Measured data, as columns.

    Attributes
    ----------
    name : str
        Where the data are from.
    times : ndarray, shape (n,), s
    values : dict of str to (ndarray, Unit)
    uncertainties : dict of str to (ndarray, Unit)
        Standard ones.
    left_out : tuple of str
        Columns that were not wanted.
    occurrences : ndarray of int, shape (n,)
        Of a table of event times, ``event_time_floor``, which occurrence of its event each row is, from 1; `times` are
        those of the first such column. Of any other table empty.
    """

    name: str
    times: Floats
    clock: Unit
    values: dict[str, tuple[Floats, Unit]]
    uncertainties: dict[str, tuple[Floats, Unit]]
    left_out: tuple[str, ...] = ()
    occurrences: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))

    @property
    def words(self) -> list[Any]:
        """All that it holds, to be compared as it is printed."""
        columns = [
            [name, unit.text, numbers.tolist()]
            for columns_by_name in (self.values, self.uncertainties)
            for name, (numbers, unit) in columns_by_name.items()
        ]
        return [self.name, self.clock.text, self.times.tolist(), columns, self.left_out]


def is_measured(source: Any) -> bool:
    """Tell measured data from a run record: a path, a table of pandas, a Dataset that was not marched."""
    if isinstance(source, str | Path) or hasattr(source, "columns") or hasattr(source, "to_frame"):
        return True
    if isinstance(source, Mapping) and not hasattr(source, "data_vars"):
        return True
    attributes = getattr(source, "attrs", {})
    variable_names = getattr(source, "variables", getattr(source, "coords", ("row_kind",)))
    return "row_kind" not in variable_names and EVIDENCE not in attributes


def read_measured_data(
    source: Any,
    requested_names: Sequence[str] | None = None,
    gaps: str = REFUSE,
    clock: Unit = SECONDS,
    shapes: Shapes = NO_SHAPES,
    reading: Mapping[str, Any] | None = None,
) -> Measured:
    """Read measured data.

    Parameters
    ----------
    source : str, Path, DataFrame or Dataset
    requested_names : sequence of str, optional
        Names that are wanted: other columns are left out, whatever they contain.
    gaps : {"refuse", "skip"}
        Whether rows in which a number is missing are refused or left out.
    clock : Unit
        Of the model's time.
    shapes : Shapes
        Of the model: a variable of a Dataset along its dimensions is a column for each element, and a column of a table
        is called ``r[Jupiter, x] [m]``.
    reading : mapping, optional
        How a file is read that does not say it: keys of `xdynamics.model.instruments.Reading`.

    Raises
    ------
    InputError
        Naming every column that cannot be used.
    """
    if gaps not in GAPS:
        raise InputError(f"gaps is {gaps!r}; there are {', '.join(GAPS)}")
    file_reading = Reading.from_keys(reading or {})
    if file_reading.duplicates == JUMP:
        raise InputError(f"duplicates is '{JUMP}', which drives have; a measured time has one value, or several rows")
    if isinstance(source, str | Path) and Path(source).suffix.lower() in ARRAYS:
        source = _open_netcdf(Path(source))
    if hasattr(source, "to_frame") and not hasattr(source, "columns"):
        source = source.to_frame()  # a Series of pandas
    if isinstance(source, str | Path):
        data = _read_data_file(Path(source), requested_names, shapes, file_reading, skip=gaps == SKIP)
    elif file_reading not in (AS_IT_IS, Reading(time_zero=file_reading.time_zero)):
        raise InputError(
            f"{', '.join(reading or {})} say how a file is read, and the data are a {type(source).__name__}"
        )
    elif hasattr(source, "columns") or (isinstance(source, Mapping) and not hasattr(source, "data_vars")):
        columns = columns_of_frame(source)
        data = _with_time_zero(
            _read_data_columns("the DataFrame", columns, requested_names, shapes, skip=gaps == SKIP), file_reading
        )
    else:
        data = _read_dataset(_dataset_of_elements(_of_array(source), shapes), requested_names, file_reading)
    if data.clock.dimension != clock.dimension:
        needed = "a time" if clock.dimension == TIME else "a pure number, as the model's time is"
        raise InputError(f"{data.name}: the column of times is in '{data.clock.text}', needs {needed}")
    return _with_order_remark(data)


def _with_order_remark(data: Measured) -> Measured:
    """Add to the name of data where their times run backwards, as in records joined in the wrong order."""
    backward_rows = np.flatnonzero(np.diff(data.times) < 0.0) if not data.occurrences.size else np.zeros(0, np.int64)
    if not backward_rows.size:
        return data
    more = f" and {backward_rows.size - 1} times more" if backward_rows.size > 1 else ""
    return replace(data, name=f"{data.name}, whose times run backwards after row {int(backward_rows[0]) + 1}{more}")


def is_foreign(path: str) -> bool:
    """Whether a name is that of a netCDF file that is no archive of this package: of measured data."""
    if Path(path).suffix.lower() not in ARRAYS or not Path(path).is_file():
        return False
    with suppress(InputError):
        return "xdynamics" not in str(_open_netcdf(Path(path)).attrs.get("Conventions", ""))
    return False


def _open_netcdf(path: Path) -> xr.Dataset:
    """Open a netCDF file that is no archive."""
    import xarray as xr

    try:
        with xr.open_dataset(path, engine="netcdf4") as data:
            return data.load()
    except (OSError, ValueError) as error:
        raise InputError(f"'{path}' cannot be read: {str(error).splitlines()[0][:100]}") from None


def _of_array(source: Any) -> Any:
    """Return a DataArray as a Dataset, with its name."""
    if not hasattr(source, "to_dataset") or hasattr(source, "data_vars"):
        return source
    if source.name is None:
        raise InputError("the DataArray has no name; give it that of the quantity: data.rename('x')")
    return source.to_dataset(name=source.name).assign_attrs()


def _read_data_file(path: Path, requested_names: _Known, shapes: Shapes, reading: Reading, *, skip: bool) -> Measured:
    """Read the columns of a file, which may be an instrument's."""
    text = FileAccess(path.parent, ANYWHERE).read_table(path.name)
    try:
        sheet = Sheet.from_text(path.name, as_table(path.name, text, reading))
        titles_and_rest = (
            _requested_titles(f"'{path.name}' ({sheet.layout_text})", sheet.header, requested_names, shapes)
            if sheet.has_titles
            else None
        )
    except InputError as error:
        begin = " / ".join(cell_excerpt(line) for line in text.split("\n")[:3] if line.strip())
        raise InputError(f"{error}; the file begins {begin}; {REMEDY}" if begin else str(error)) from None
    if titles_and_rest is None:
        raise InputError(_without_titles(sheet, requested_names))
    titles, left_out = titles_and_rest
    columns = sheet.columns([*titles], skip=skip).T
    if not columns.size:
        raise InputError(f"'{path}' has no rows; it needs a header like 'time [s],y [m]' and numbers below")
    columns_read = {
        heading.name: (column, heading.unit) for heading, column in zip(titles.values(), columns, strict=True)
    }
    return _sort_columns(f"'{path.name}'", columns_read, left_out)


def _without_titles(sheet: Sheet, requested_names: Sequence[str] | None) -> str:
    """Return the message for a file of numbers alone, with titles that would do."""
    words = [*(requested_names or ()), *(f"name_{n}" for n in range(1, len(sheet.header)))][: len(sheet.header) - 1]
    example = ",".join(["t [s]", *(f"{word} [unit]" for word in words)])
    return (
        f"'{sheet.name}' has no titles, it begins {cell_excerpt(sheet.separator.join(sheet.header))}; give one for each of its"
        f" {len(sheet.header)} columns, like --header '{example}', in Python reading={{'header': '{example}'}}; --skip N"
        " leaves out lines before them"
    )


def _read_data_columns(
    name: str, columns: Mapping[str, Any], requested_names: _Known, shapes: Shapes, *, skip: bool
) -> Measured:
    """Read columns by their headers, ``y [mm]`` and ``u(y) [mm]``."""
    titles, left_out = _requested_titles(name, tuple(columns), requested_names, shapes)
    cells = [np.asarray(column) for column in columns.values()]
    if skip:
        complete = ~np.any([np.isnan(cells[k]) for k in titles if cells[k].dtype.kind == "f"], axis=0)
        cells = [column[complete] for column in cells]
    ledger, columns_read = Ledger(name), {}
    for k, column in titles.items():
        with ledger.entry(f"column {cell_excerpt([*columns][k])}"):
            columns_read[column.name] = np.array([*map(column.number, _finite_numbers(cells[k]).tolist())]), column.unit
    ledger.raise_faults()
    return _sort_columns(name, columns_read, left_out)


def _requested_titles(
    name: str, header: Sequence[str], requested_names: Sequence[str] | None, shapes: Shapes
) -> _Titles:
    """Return the wanted columns by position, and the names of those that are left out."""
    ledger, left_out = Ledger(name), []
    titles: dict[int, Title] = {}
    header = [_with_element_name(cell, requested_names or (), shapes) for cell in header]
    names = [name_of_title(cell) for cell in header]
    bares = [match["name"] if (match := _UNCERTAINTY.fullmatch(name)) else name for name in names]
    for k, (cell, full_name, bare) in enumerate(zip(header, names, bares, strict=True)):
        if full_name != bare and bares.count(bare) < 2:
            ledger.note(f"u({bare}) is the uncertainty of a column that is missing")
        elif requested_names is not None and bare not in requested_names and not is_clock(cell):
            left_out.append(cell.strip())
            continue
        with ledger.entry(f"column {cell_excerpt(cell)}"):
            heading = title(cell)
            if heading.name in {earlier.name for earlier in titles.values()}:
                raise InputError(f"'{heading.name}' is given twice")
            titles[k] = heading
    ledger.raise_faults()
    if (
        requested_names is not None
        and left_out
        and not any(heading.name in requested_names for heading in titles.values())
    ):
        raise _all_left_out(f"{name}: column", left_out, requested_names)
    return titles, tuple(left_out)


def _all_left_out(source_text: str, left_out: Sequence[str], requested_names: Sequence[str]) -> InputError:
    """Return the error that nothing is of the model, with how an acceleration is measured, if one is."""
    felt = '; an acceleration is measured as an observable: [observables] felt = { expression = "a_x", unit = "m s-2" }'
    is_felt = any("acceleration" in name.lower() or name.startswith("a_") for name in left_out)
    return InputError(
        f"{source_text} '{left_out[0]}' is no quantity of the model, which has {', '.join(quantity_names(requested_names))}{felt * is_felt}"
    )


def _with_element_name(cell: str, requested_names: Sequence[str], shapes: Shapes) -> str:
    """Return a header with the element that it begins with, if it is a known one, as it is named inside."""
    with suppress(InputError):  # of an element that the model has not: its column is left out
        if (match := _OF_ELEMENT.match(cell)) and (name := shapes.internal_name(match[2])) in requested_names:
            return f"{match[1] or ''}{name}{cell[match.end() :]}"
    return cell


def _dataset_of_elements(source: Any, shapes: Shapes) -> Any:
    """Return a Dataset with a variable for each element of variables with dimensions of the model."""
    dims = {str(dim) for dim in getattr(source, "dims", ())} & {*shapes.extents, *shapes.relations}
    if not dims:
        return source
    for dim in shapes.ordered(dims - {*source.coords}):
        extent = shapes.extent(dim)
        if source.sizes[dim] != extent.size:
            size_text = f"the Dataset has {source.sizes[dim]} elements of '{dim}'"
            raise InputError(f"{size_text}, needs all {extent.size}, or a coordinate of their labels")
        source = source.assign_coords({dim: [*extent.labels]}) if extent.labels else source
    return unfold(source.assign_attrs({MODEL_DIMENSIONS: sized(shapes, dims)}))


def _read_dataset(source: Any, requested_names: Sequence[str] | None, reading: Reading) -> Measured:
    """Read variables along one dimension by their units; a time of CF's calendar is counted from its first stamp."""
    ledger, left_out, remark = Ledger("the Dataset"), list[str](), ""
    columns: dict[str, tuple[Floats, Unit]] = {}
    for name, variable in source.variables.items():
        label = str(name).removesuffix("_time") if name == AT_TIME else str(name)
        key = f"u({label[2:]})" if label.startswith("u_") else "time" if name == AT_TIME else label
        bare = label.removeprefix("u_")
        titled = f"{key} [{variable.attrs['units']}]" if "units" in variable.attrs else key  # stamps have none
        if requested_names is not None and bare not in requested_names and not is_clock(titled):
            left_out.append(str(name))
            continue
        with ledger.entry(f"variable '{name}'"):
            if len(variable.dims) != 1:
                raise InputError(f"has the dims {variable.dims}, needs one, along which it was measured")
            if (stamped := stamps(variable)) is not None:
                seconds, first = stamped
                remark = f", its time from {first} on" if first else ""
                columns[key] = seconds, SECONDS
                continue
            if "units" not in variable.attrs:
                raise InputError("has no units; set its attribute 'units'")
            scale = parse_scale(str(variable.attrs["units"]))
            # an uncertainty in degC is a difference, which the zero of the scale does not shift
            to_unit = scale.difference if key != label else scale.value
            columns[key] = np.array([*map(to_unit, _finite_numbers(variable.values).tolist())]), scale.unit
    sizes = {name: len(numbers) for name, (numbers, _) in columns.items()}
    if len({*sizes.values()}) > 1:
        ledger.note(
            f"variables have {', '.join(f'{size} ({name})' for name, size in sizes.items())} rows, need one dimension"
            " for all"
        )
    ledger.raise_faults()
    if requested_names is not None and left_out and not {*columns} & {*requested_names}:
        raise _all_left_out("the Dataset: variable", left_out, requested_names)
    return _with_time_zero(_sort_columns(f"the Dataset{remark}", columns, tuple(left_out)), reading)


def _with_time_zero(data: Measured, reading: Reading) -> Measured:
    """Return data with times counted from the origin that the reading states."""
    if not reading.time_zero:
        return data
    zero = float(data.times[0]) if reading.time_zero == FIRST else parse_quantity(reading.time_zero).si
    values = {
        name: (numbers - zero / float(unit.factor), unit) if name.startswith(EVENT_TIMES) else (numbers, unit)
        for name, (numbers, unit) in data.values.items()
    }
    return replace(
        data, name=f"{data.name}, time counted from {reading.time_zero}", times=data.times - zero, values=values
    )


def _finite_numbers(cells: Any) -> Floats:
    """Read numbers; gaps are refused."""
    kind = np.asarray(cells).dtype.kind
    if kind in "mMcb":
        kind_word = {"m": "time differences", "M": "dates", "c": "complex numbers", "b": "truths"}[kind]
        raise InputError(
            f"holds {kind_word}, needs plain numbers"
            + ("; divide by np.timedelta64(1, 's') for seconds" if kind == "m" else "")
        )
    try:
        values = np.asarray(cells, float)
    except (TypeError, ValueError):
        wrong = next(k for k, cell in enumerate(cells) if not _is_finite_number(cell))
        raise InputError(f"row {wrong + 1} is {str(cells[wrong])[:24]!r}, needs a number") from None
    if not np.isfinite(values).all():
        row = int(np.flatnonzero(~np.isfinite(values))[0])
        raise InputError(f"row {row + 1} is {values[row]}, needs a number; leave out rows with gaps")
    return values


def _is_finite_number(cell: Any) -> bool:
    try:
        return isfinite(float(cell))
    except (TypeError, ValueError):
        return False


def _sort_columns(name: str, columns: dict[str, tuple[Floats, Unit]], left_out: tuple[str, ...] = ()) -> Measured:
    """Separate times, values and uncertainties."""
    clock = next(iter(clocks_of(f"{column} [{unit.text or 1}]" for column, (_, unit) in columns.items())), None)
    of_events = [column for column in columns if column.startswith(EVENT_TIMES)]
    if clock is not None and of_events:
        raise InputError(
            f"{name} has times of rows, '{clock}', and of events, '{of_events[0]}'; give them as two records, one of values"
            " at times, one of events with a row for each occurrence"
        )
    if clock is None and not of_events:
        unknown = (
            f", and {', '.join(map(cell_excerpt, left_out))}; say which is the time: --column time=…"
            if left_out
            else ""
        )
        known_columns = ", ".join(columns) or "none"
        raise InputError(f"{name} has no column of times, like 'time [s]'; there are {known_columns}{unknown}")
    occurrences = (
        _occurrence_numbers(name, columns, len(columns[of_events[0]][0])) if of_events else np.zeros(0, np.int64)
    )
    times, unit = columns[of_events[0]] if of_events else columns.pop(clock or "")
    uncertainties = {match["name"]: column for key, column in columns.items() if (match := _UNCERTAINTY.fullmatch(key))}
    values = {key: column for key, column in columns.items() if not _UNCERTAINTY.fullmatch(key)}
    ledger = Ledger(name)
    for key, (numbers, uncertainty_unit) in uncertainties.items():
        if key not in values:
            ledger.note(f"u({key}) is the uncertainty of a column that is missing")
        elif uncertainty_unit.dimension != values[key][1].dimension:
            ledger.note(f"u({key}) is in '{uncertainty_unit.text}', needs a unit like '{values[key][1].text}'")
        elif not (numbers > 0.0).all():
            ledger.note(
                f"u({key}) is {float(numbers.min())!r} in row {int(np.argmin(numbers)) + 1}, needs a positive number"
            )
    if not values or not times.size:
        ledger.note("has no column beside the times" if times.size else "has no rows")
    ledger.raise_faults()
    return Measured(name, times * float(unit.factor), unit, values, uncertainties, left_out, occurrences)


def _occurrence_numbers(name: str, columns: dict[str, tuple[Floats, Unit]], rows: int) -> NDArray[np.int64]:
    """Return the occurrence number of each row of a table of events: from its column, else from 1 on."""
    if OCCURRENCES not in columns:
        return np.arange(1, rows + 1)
    numbers, _ = columns.pop(OCCURRENCES)
    wrong = np.flatnonzero((numbers < 1) | (numbers != np.floor(numbers)))
    if wrong.size:
        raise InputError(
            f"{name}, row {int(wrong[0]) + 1}: occurrence is {numbers[wrong[0]]:g}, needs a whole number from 1 on"
        )
    return numbers.astype(np.int64)


def measured_for(
    run: xr.Dataset,
    source: Any,
    functions: Mapping[str, Callable[..., float]] | None,
    gaps: str,
    reading: Mapping[str, Any] | None,
) -> Measured:
    """Read measured data to be compared with a run, of which no value is read.

    Raises
    ------
    InputError
        If a column cannot be read, or has another dimension than the run.
    """
    model = model_of_record(run, functions)
    recorded = {*map(str, run.variables)}
    observables = [name for name in observables_of(model) if {name, split_element_name(name)[0]} & recorded]
    data = read_measured_data(source, observables, gaps, time_unit_of(run), model.shapes, reading)
    ledger = Ledger(data.name)
    for name, (_, unit) in data.values.items():
        if name not in observables:
            ledger.note(
                f"column '{name}' is not a quantity of the run; there are {', '.join(quantity_names(observables))}"
            )
        elif unit.dimension != parse_unit(str(get_column(run, name).attrs["units"])).dimension:
            ledger.note(
                f"column '{name}' is in '{unit.text}', needs '{get_column(run, name).attrs['units']}' or a unit like it"
            )
    ledger.raise_faults()
    return data


def residuals_with(run: xr.Dataset, data: Measured, functions: Mapping[str, Callable[..., float]] | None) -> xr.Dataset:
    """Compare a run with data that were read for it.

    Raises
    ------
    InputError
        If a time is outside the run.
    """
    unit_text = unit_suffix(time_unit_of(run))
    begin, end = (float(run["time"][k]) for k in (0, -1))
    outside = np.flatnonzero((data.times < begin) | (data.times > end))
    if outside.size:
        raise InputError(
            f"{data.name}, row {int(outside[0]) + 1}: t = {float(data.times[outside[0]])!r}{unit_text} is outside the"
            f" run, from {begin!r}{unit_text} to {end!r}{unit_text}"
        )
    model = model_of_record(run, functions)
    computed = observe(run, model, list(data.values), data.times)
    return residuals_of(run, model.shapes, computed, data, [archive.digest_of_run(run)])


def residuals_of(
    run: xr.Dataset,
    shapes: Shapes,
    computed: Mapping[str, tuple[Floats, Floats]],
    data: Measured,
    digests: Sequence[str],
) -> xr.Dataset:
    """Return the Dataset of measured data, computed values at their times, and residuals."""
    variables: dict[str, Any] = {
        AT_TIME: ((AT,), data.times, attrs_of(time_unit_of(run).text, "time of measurement", "time"))
    }
    for name in data.values:
        variables |= _residual_variables(name, str(get_column(run, name).attrs["units"]), *computed[name], data)
    return evidence_dataset(
        "comparison",
        f"{run.attrs['title']}, beside {data.name}",
        digests,
        variables,
        {"data": data.name, "data_left_out": ", ".join(data.left_out)},
        shapes=shapes,
    )


def _residual_variables(name: str, units: str, computed: Floats, errors: Floats, data: Measured) -> dict[str, Any]:
    record_unit = parse_unit(units)

    def to_record_unit(values: Floats, unit: Unit) -> Floats:
        return values * float(unit.factor / record_unit.factor)

    values = to_record_unit(*data.values[name])
    differences = values - computed
    scale_text = f"largest size of {name} as measured; where that is 0, as computed"
    variables: dict[str, Any] = {
        f"measured_{name}": ((AT,), values, attrs_of(units, f"{name} as measured", "measured")),
        name: ((AT,), computed, attrs_of(units, f"{name} as computed", "computed")),
        f"difference_{name}": ((AT,), differences, attrs_of(units, f"{name}, measured minus computed", "difference")),
        f"interpolation_error_{name}": (
            (AT,),
            errors,
            attrs_of(units, f"estimated error of interpolating {name} between accepted states", "error"),
        ),
        f"rms_difference_{name}": (
            (),
            np.sqrt(np.mean(differences**2)),
            attrs_of(units, f"root of the mean square of difference_{name}", "residual"),
        ),
        **scaled_variables(
            "difference", name, differences, scale_of(values, computed), (AT,), units, scale_text, ("rms",)
        ),
    }
    if name in data.uncertainties:
        uncertainty = to_record_unit(*data.uncertainties[name])
        square = np.mean((differences / uncertainty) ** 2)
        variables |= {
            f"measured_uncertainty_{name}": (
                (AT,),
                uncertainty,
                attrs_of(units, f"standard uncertainty of {name} as measured", "uncertainty"),
            ),
            f"reduced_chi_square_{name}": (
                (),
                square,
                attrs_of(
                    "1",
                    f"mean square of difference_{name} over its uncertainty; nothing was fitted, so all values are"
                    " degrees of freedom",
                    "residual",
                )
                | {"degrees_of_freedom": differences.size},
            ),
        }
    return variables

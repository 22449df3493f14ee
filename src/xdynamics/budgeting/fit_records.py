"""The arguments of a fit, checked: measured records, their models, numbers, bounds and scales."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.budgeting.fit_problem import OFFSET, SHARED, FitRecord, FittedNumber
from xdynamics.evidence.comparing.measured import EVENT_TIMES, OCCURRENCES, read_measured_data
from xdynamics.evidence.observables import comparable
from xdynamics.faults import InputError, Ledger, brief_repr
from xdynamics.march.configuration import settings_for
from xdynamics.model import Model, check_model
from xdynamics.record.folding import elements_of, quantity_names
from xdynamics.record.run_columns import named_columns
from xdynamics.shapes.naming import split_element_name
from xdynamics.sweeping.axes import axis_numbers
from xdynamics.units import Unit, parse_unit, unit_suffix

Floats = NDArray[np.float64]


def records_of(
    model: Any, data: Any, parameters: Any, own_names: Any, gaps: str, reading: Any, settings: dict[str, Any]
) -> tuple[tuple[FitRecord, ...], tuple[FittedNumber, ...]]:
    """Return the records of a fit, and its numbers: shared ones, then each record's own.

    Raises
    ------
    InputError
        If an argument cannot be used, or does not fit the others.
    """
    labelled = _records_by_label(data)
    models = _models_by_label(model, labelled)
    first = next(iter(models.values()))
    shared_names, own_fitted = (
        fitted_names(first, parameters, "parameters"),
        fitted_names(first, own_names or (), "own"),
    )
    if repeated_names := {*shared_names} & {*own_fitted}:
        raise InputError(f"'{min(repeated_names)}' is in parameters, shared by all records, and in own; give it once")
    if not shared_names + own_fitted:
        fitted_names(first, (), "parameters", needs_any=True)
    if own_fitted and len(labelled) < 2:
        raise InputError(f"own is {', '.join(own_fitted)}, and there is one record; name it in parameters")
    records = tuple(
        _read_record(
            models[label],
            source,
            (*shared_names, *own_fitted),
            gaps,
            reading,
            settings,
            label if len(labelled) > 1 else "",
        )
        for label, source in labelled.items()
    )
    for record in records:
        if bool(record.data.uncertainties) is not bool(records[0].data.uncertainties):
            raise InputError(
                f"records '{records[0].label}' and '{record.label}': one has uncertainties, u(…), and the other none; give"
                " all of them some"
            )
        if not record.data.uncertainties and {*record.quantities} != {*records[0].quantities}:
            raise InputError(
                f"records '{records[0].label}' and '{record.label}' hold unlike quantities, and no uncertainties by which"
                " they can be weighed; give columns u(…)"
            )
    numbers = (
        *map(FittedNumber, shared_names),
        *(FittedNumber(name, k) for k in range(len(records)) for name in own_fitted),
    )
    rows = sum(record.measured.size for record in records)
    if rows <= len(numbers):
        data_name = records[0].data.name if len(records) == 1 else "the data"
        raise InputError(f"{data_name} has {rows} numbers for {len(numbers)} parameters, needs more")
    return records, numbers


def _records_by_label(data: Any) -> dict[str, Any]:
    """Return records by their names: files by theirs, others numbered."""
    if isinstance(data, Mapping) and not hasattr(data, "data_vars") and not hasattr(data, "columns"):
        if any(
            isinstance(source, str | Path | Mapping) or hasattr(source, "dims") or hasattr(source, "columns")
            for source in data.values()
        ):
            return {str(label): source for label, source in data.items()}
        return {"record": data}
    if not isinstance(data, list | tuple):
        return {"record": data}
    names = [Path(source).stem if isinstance(source, str | Path) else f"record{k + 1}" for k, source in enumerate(data)]
    if len({*names}) < len(names):
        raise InputError(f"records are called {', '.join(names)}; give each a name of its own: {{'one': …, 'two': …}}")
    if not names:
        raise InputError("data is an empty list, needs one measured record or more")
    return dict(zip(names, data, strict=True))


def _models_by_label(model: Any, labelled: Mapping[str, Any]) -> dict[str, Model]:
    """Return the model of each record."""
    if isinstance(model, Mapping) and {*model} != {*labelled}:
        raise InputError(
            f"models are called {', '.join(map(str, model))}, and records {', '.join(labelled)}; needs a model for each"
        )
    by_label = {label: model[label] if isinstance(model, Mapping) else model for label in labelled}
    for entry in by_label.values():
        check_model(entry)
    return by_label


def fitted_names(model: Model, requested_names: Any, argument: str, *, needs_any: bool = False) -> tuple[str, ...]:
    """Return parameters and initial values by name, quantities with dimensions by their elements.

    Raises
    ------
    InputError
        If one is not there, or twice.
    """
    elements = model.elements
    if not isinstance(requested_names, Iterable) or isinstance(requested_names, Mapping):
        raise InputError(
            f"{argument} are {brief_repr(requested_names)}, need names, like ['{next(iter(elements.statement.parameters), 'k')}']"
        )
    entries = (requested_names,) if isinstance(requested_names, str) else tuple(requested_names)
    names = tuple(element for name in entries for element in quantity_elements(model, name))
    available = [
        *elements.statement.parameters,
        *(name for name in elements.statement.initial if name != "t"),
    ]
    if (needs_any and not names) or len({*names}) < len(names):
        raise InputError(
            f"{argument} are {[*names]}, need one name or more, each once; there are {', '.join(quantity_names(available))}"
        )
    for name in names:
        if name not in available and name != OFFSET:
            raise InputError(
                f"'{name}' is no parameter or initial value; there are"
                f" {', '.join(quantity_names(available))}{elements_of(str(name), available)}"
            )
    return names


def quantity_elements(model: Model, name: Any) -> list[Any]:
    """Return the elements of a quantity with dimensions; any other name is returned alone."""
    return [*model.shapes.elements(model.shapes.internal_name(name))] if isinstance(name, str) else [name]


def _read_record(
    model: Model, source: Any, names: tuple[str, ...], gaps: str, reading: Any, settings: dict[str, Any], label: str
) -> FitRecord:
    """Read one record, and check it against its model."""
    march_settings = settings_for(model, **settings)
    columns, blocks = named_columns(march_settings.layout(model), march_settings), dict[str, Unit]()
    for name in comparable(model):
        quantity = split_element_name(name)[0]
        if quantity not in blocks:
            blocks[quantity] = parse_unit(columns[name].variable.units)
    units = {name: blocks[split_element_name(name)[0]] for name in comparable(model)}
    units |= {f"{EVENT_TIMES}{name}": model.time_unit for name in timed_names(model)}
    table = read_measured_data(source, (*units, OCCURRENCES), gaps, model.time_unit, model.shapes, reading)
    table = replace(
        table, values={name: column for name, column in table.values.items() if name in units or name != OCCURRENCES}
    )
    if label:
        table = replace(table, name=f"'{label}'")
    ledger = Ledger(table.name)
    _check_measured_columns(table, units, ledger)
    fit_record = FitRecord(
        model, names, table, {name: units[name] for name in table.values if name in units}, settings, label
    )
    begin, end, second = model.statement.initial["t"].si, march_settings.until, unit_suffix(model.time_unit)
    own_clock = fit_record.is_offset(OFFSET) and OFFSET in names
    rows_outside = np.flatnonzero(((table.times < begin) | (table.times > end)) & (not own_clock))
    if rows_outside.size:
        ledger.note(
            f"row {int(rows_outside[0]) + 1}: t = {float(table.times[rows_outside[0]])!r}{second} is outside the run, from"
            f" {begin!r}{second} to {end!r}{second}; give until=…"
        )
    ledger.raise_faults()
    return fit_record


def _check_measured_columns(table: Any, units: Mapping[str, Unit], ledger: Ledger) -> None:
    for name, (_, unit) in table.values.items():
        if name not in units:
            ledger.note(f"column '{name}' is not a quantity of the model; there are {', '.join(quantity_names(units))}")
        elif unit.dimension != units[name].dimension:
            ledger.note(f"column '{name}' is in '{unit.text}', needs '{units[name].text}' or a unit like it")
        elif table.uncertainties and name not in table.uncertainties:
            ledger.note(f"column '{name}' has no uncertainties, and others have: give u({name}) too, or none")


def timed_names(model: Model) -> tuple[str, ...]:
    """Name the parts of a model with event times: events, contacts and frictions."""
    statement = model.elements.statement
    return (*statement.events, *statement.contacts, *statement.frictions)


def fit_bounds(
    records: Sequence[FitRecord], numbers: Sequence[FittedNumber], bounds: Mapping[str, Sequence[Any]]
) -> tuple[Floats, Floats]:
    """Read lower and upper bounds, shape (n,), in each number's unit; of one per record they hold for all records.

    Raises
    ------
    InputError
        If one is not fitted, or its bounds do not hold its value between them.
    """
    low, high = (np.full(len(numbers), side) for side in (-np.inf, np.inf))
    names = [number.name for number in numbers]
    of_elements = {
        element: ends for name, ends in bounds.items() for element in quantity_elements(records[0].model, name)
    }
    for name, ends in of_elements.items():
        if name not in names:
            raise InputError(f"bounds name '{name}', which is not fitted; there are {', '.join(dict.fromkeys(names))}")
        for i, number in enumerate(numbers):
            if number.name == name:
                low[i], high[i] = _bound_values(owner_record(records, number), name, ends)
    for i, number in enumerate(numbers):
        for k, record in enumerate(records):
            if record.is_offset(number.name) and number.record in (SHARED, k):
                low[i], high[i] = max(low[i], record.offsets[0]), min(high[i], record.offsets[1])
        if not low[i] < high[i]:
            raise InputError(
                f"no {number_label(records, number)} has all that was measured inside the runs: it would be from {low[i]:.6g} to"
                f" {high[i]:.6g}; end runs later by until, or leave out what was recorded before they begin"
            )
    return low, high


def _bound_values(record: FitRecord, name: str, ends: Any) -> Floats:
    declared = record.declared(name)
    try:
        values, unit = axis_numbers(list(ends), declared.scale_of_numbers)
    except (InputError, TypeError) as error:
        raise InputError(f"bounds of '{name}' are {ends!r}, need the lowest and the highest: {error}") from None
    values = values * float(unit.factor / declared.unit.factor)
    holds_value = len(values) == 2 and (values[0] <= declared.value <= values[1] or record.is_offset(name))
    if not holds_value or not values[0] < values[1]:
        raise InputError(
            f"bounds of '{name}' are {[*map(str, ends)]}, need the lowest, then the highest, and {declared} between them"
        )
    return values


def starts_with_offsets(
    records: Sequence[FitRecord], numbers: Sequence[FittedNumber], start: Floats, low: Floats, high: Floats
) -> Floats:
    """Return the start of a search: the model's own values, with the likely offset of each record."""
    starts = start.copy()
    for i, number in enumerate(numbers):
        record = owner_record(records, number)
        if record.is_offset(number.name):
            own_values = np.array([[record.declared(name).value for name in record.names]])
            if not record.data.occurrences.size:
                starts[i] = record.likely_offset(own_values[0], low[i], high[i])
                continue
            differences = record.measured - record.computed(own_values, require_all=False)[0]
            starts[i] = np.median(differences[np.isfinite(differences)]) if np.isfinite(differences).any() else start[i]
    return starts


def number_scales(
    records: Sequence[FitRecord], numbers: Sequence[FittedNumber], start: Floats, low: Floats, high: Floats
) -> Floats:
    """Return the scale of each number, shape (n,); for a start of zero that of its bounds, uncertainty or unit."""
    scales = np.abs(start)
    for i, number in enumerate(numbers):
        record = owner_record(records, number)
        if record.is_offset(number.name) and not record.data.occurrences.size:
            scales[i] = record.offset_scale
    for i in np.flatnonzero(scales == 0.0).tolist():
        width = float(high[i] - low[i])
        model = owner_record(records, numbers[i]).model
        spread = (model.elements.statement.parameters | model.elements.starts).get(numbers[i].name)
        scales[i] = (
            width / 2.0 if np.isfinite(width) else (spread.uncertainty if spread and spread.uncertainty else 1.0)
        )
    return scales


def owner_record(records: Sequence[FitRecord], number: FittedNumber) -> FitRecord:
    """Return the record that a number is declared in: its own, or the first."""
    return records[0 if number.record == SHARED else number.record]


def number_label(records: Sequence[FitRecord], number: FittedNumber) -> str:
    """Return the name of a number; of a record's own, with the record's."""
    return number.name if number.record == SHARED else f"{number.name} of '{records[number.record].label}'"

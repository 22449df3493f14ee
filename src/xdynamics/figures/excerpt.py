"""Of a long run in chunks, the rows that a figure shows: each chunk is read once, and few of its rows are kept.

What is kept of every column are the least and the greatest of each stretch of rows and of time, as `curves.thinned_rows` keeps
them; what happens at events, at changes of the regime, in steps that are long in a picture, and at the times of profiles and
sections. `step` then has the numbers of the rows: between rows that do not follow each other nothing is recomputed.

What is drawn beside a run: other runs, and measurements.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.archive import open_run
from xdynamics.archive.store import GIVEN, location_of
from xdynamics.evidence.chunks import RowRange, StoredColumns
from xdynamics.evidence.comparing.measured import is_measured, read_measured_data
from xdynamics.evidence.stages import compute_datasets
from xdynamics.faults import InputError
from xdynamics.figures.companions import Overlay, RunCompanion, run_labels
from xdynamics.figures.curves import (
    DRAWN,
    ENERGY_CHANGES,
    EnergyAccumulator,
    plotted_lines,
    recorded_model,
    spread_rows,
    stretch_extremes,
)
from xdynamics.figures.element_maps import profile_times
from xdynamics.figures.line_panels import section_times
from xdynamics.figures.marks import MOST_BANDS
from xdynamics.figures.plane import plane_positions, plane_variables
from xdynamics.model import Model
from xdynamics.model.drives import SKIP
from xdynamics.record.flag_words import time_unit_of
from xdynamics.record.folding import is_chunked
from xdynamics.schema import EVENTS, SAMPLES, STEP_NUMBER, STEPS, TRIALS
from xdynamics.units import parse_unit

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]

ON_REQUEST = ("force", "rate_term", "gap")  # roles of columns that a figure of a run has only where they are named
MOST_NUMBERS = 4_000_000  # that are drawn of a run as it is; and about as many has an excerpt
FEWEST = 40  # rows of each column
ROOM = 1 << 26  # bytes of times that are kept: of the first and the last chunk, for the span
LOGARITHMIC = ("step_size", "error_norm")  # columns of which only positive values are drawn
CLOCKS = {STEPS: "time", EVENTS: "event_time", TRIALS: "trial_time"}
KINDS = {EVENTS: "event_detector", TRIALS: "trial_reason"}  # each is drawn by itself
BESIDE = {STEPS: STEP_NUMBER.name, **KINDS}  # read with what is drawn
EVENT_ROWS = ("event_row_before", "event_row_after")


def excerpt_of(run: xr.Dataset, requested_columns: Sequence[str] | None = None) -> xr.Dataset:
    """Return what a figure draws of a run, in memory: all rows of a short one, an excerpt of a long one.

    Parameters
    ----------
    run : xarray.Dataset
        In chunks; one in memory is returned as it is.
    requested_columns : sequence of str, optional
        Columns that are drawn because they are named; what is drawn of no figure stays in chunks.
    """
    names = [
        str(name)
        for name, variable in run.variables.items()
        if is_chunked(variable)
        and variable.dims[:1] != (SAMPLES,)
        and (variable.attrs.get("role") not in ON_REQUEST or name in (requested_columns or ()))
    ]
    if not names:
        return run
    if sum(run.variables[name].size for name in names) <= MOST_NUMBERS or "time" not in run.variables:
        return run.assign(compute_datasets(run[names])[0].variables)
    columns_by_dim = {dim: [name for name in names if run.variables[name].dims[:1] == (dim,)] for dim in CLOCKS}
    short = [name for name in names if not any(name in dim_columns for dim_columns in columns_by_dim.values())]
    excerpt = run.assign(compute_datasets(run[short])[0].variables) if short else run
    for dim in (TRIALS, EVENTS):
        if columns_by_dim[dim]:
            max_rows = _max_rows_per_column(len(columns_by_dim[dim]) * len(columns_by_dim[STEPS]))
            excerpt = _read_excerpt(
                _stored_columns(excerpt, dim), dim, columns_by_dim[dim], max_rows, lambda _: iter(())
            )
    if not columns_by_dim[STEPS]:
        return excerpt
    columns = _stored_columns(excerpt, STEPS)
    shown_rows = _ShownRows.from_columns(columns)
    excerpt = _read_excerpt(
        columns,
        STEPS,
        columns_by_dim[STEPS],
        _max_rows_per_column(len(columns_by_dim[STEPS]) ** 2),
        shown_rows.rows_of,
        shown_rows.plane_coordinates,
    )
    excerpt.encoding[ENERGY_CHANGES] = shown_rows.changes_of_energy
    return excerpt


def _max_rows_per_column(columns: int) -> int:
    """Return how many rows are kept of each column, so that not too many are kept of all."""
    return min(DRAWN, max(FEWEST, MOST_NUMBERS // max(1, columns)))


def _stored_columns(run: xr.Dataset, dim: str) -> StoredColumns:
    return StoredColumns(run, dim, cached_names=(CLOCKS[dim],), room=ROOM)


def _read_excerpt(
    columns: StoredColumns,
    dim: str,
    names: list[str],
    max_rows: int,
    further_rows: Callable[[RowRange], Iterator[Any]],
    functions: Callable[[RowRange], Iterator[Any]] | None = None,
) -> xr.Dataset:
    """Read columns along a dimension chunk by chunk; keep extremes of each stretch of them, and other rows.

    Parameters
    ----------
    further_rows : callable
        Yields further rows of a part that are shown, by their places in it.
    functions : callable, optional
        Yields what is computed from a part's columns and has extremes, too.
    """
    import xarray as xr

    run, clock, kind = columns.run, CLOCKS[dim], KINDS.get(dim)
    if not columns.size:
        return run.assign(compute_datasets(run[names])[0].variables)
    start, end = columns.values_at(clock, [0, columns.size - 1]).tolist()
    by_row = np.linspace(0, columns.size, max_rows // 4 + 1).astype(np.int64)
    by_time = np.linspace(start, end, max_rows // 4 + 1)[1:-1]
    numeric = [
        name for name in names if run[name].dtype.kind == "f" and run.variables[name].dims == (dim,) and name != clock
    ]
    column_parts: dict[str, list[Any]] = {name: [] for name in (*names, dim)}
    columns_read = list(dict.fromkeys([clock, *names, BESIDE[dim]]))
    for part in columns.parts(*columns_read):
        values = [
            _positive_or_nan(part.own_rows(name)) if name in LOGARITHMIC else part.own_rows(name) for name in numeric
        ]
        values += functions(part) if functions else ()
        rows = [row - part.rows_before for row in map(np.asarray, further_rows(part)) if row.size]
        of_kinds = (
            [np.flatnonzero(part.own_rows(kind) == code) for code in np.unique(part.own_rows(kind))] if kind else []
        )
        for group in of_kinds or [np.arange(part.count)]:
            borders = [by_row - part.first, np.searchsorted(part.own_rows(clock), by_time)]
            edges = np.searchsorted(group, np.clip(np.concatenate([[0, part.count], *borders]), 0, part.count))
            rows += [group[stretch_extremes(column[group], np.unique(edges))] for column in values] + [
                group[:1],
                group[-1:],
            ]
        selected_rows = np.unique(np.concatenate(rows))
        selected_rows = selected_rows[(selected_rows >= 0) & (selected_rows < part.count)]
        for name in names:
            column_parts[name].append(part.own_rows(name)[selected_rows])
        column_parts[dim].append(part.first + selected_rows)
    numbers = np.concatenate(column_parts.pop(dim))
    read_columns = {
        name: xr.Variable(run.variables[name].dims, np.concatenate(parts), run.variables[name].attrs)
        for name, parts in column_parts.items()
    }
    index = {"units": "1", "long_name": f"number along {dim}", "role": "index"}
    return (
        run.drop_vars(names)
        .isel({dim: numbers}, missing_dims="ignore")
        .assign(read_columns)
        .assign_coords({dim: (dim, numbers, index)})
    )


def _positive_or_nan(values: Any) -> Any:
    return np.where(values > 0, values, np.nan)


@dataclass
class _ShownRows:
    """What is shown of the rows of a run beside the extremes of its columns.

    Attributes
    ----------
    run : xarray.Dataset
    model : Model, optional
    events : ndarray of int
        Step numbers of rows at events.
    size : int
        How many rows the run has.
    span : float
    moments : ndarray
        Times at which states are drawn.
    nearest : float
        The least time between two rows so far.
    changes : int
        Changes of the regime so far.
    energy : Accumulated, optional
        What changed the total energy so far; none where that is not known.
    """

    run: xr.Dataset
    model: Model | None
    events: Rows
    size: int
    span: float
    moments: Floats
    nearest: float = field(default=np.inf)
    changes: int = 0
    energy: EnergyAccumulator | None = None

    @classmethod
    def from_columns(cls, columns: StoredColumns) -> _ShownRows:
        """Read from a run what is known before its rows are read."""
        run = columns.run
        model = recorded_model(run)
        start, end = columns.values_at("time", [0, columns.size - 1]).tolist()
        moments = [profile_times(start, end)]
        if model is not None and model.elements.pictured.section is not None:
            moments.append(section_times(model, start, end))
        events = [run.variables[name].values for name in EVENT_ROWS if name in run.variables]
        numbers = np.unique(np.concatenate([np.zeros(0, np.int64), *events]))
        shown_rows = cls(run, model, numbers, run.sizes[STEPS], end - start, np.sort(np.concatenate(moments)))
        if (
            model is not None
            and not model.python_functions
            and {"total_energy", *model.elements.units} <= {*run.variables}
        ):
            shown_rows.energy = EnergyAccumulator(model)
        return shown_rows

    @property
    def changes_of_energy(self) -> dict[str, float] | None:
        """The largest changes of the total energy by what causes them, where they are known."""
        return None if self.energy is None else self.energy.largest_changes

    def rows_of(self, part: RowRange) -> Iterator[Any]:
        """Yield rows of a part, by their places in its columns."""
        time, numbers = part.columns["time"], part.row_numbers
        middle = np.array([0, (self.size - 1) // 2, self.size // 2, self.size - 1])  # the median of the times, too
        yield np.flatnonzero(np.isin(numbers, np.concatenate([middle, spread_rows(self.size)])))
        yield np.flatnonzero(np.isin(part.columns[STEP_NUMBER.name], self.events))
        intervals = np.diff(time)
        long_steps = np.flatnonzero(intervals * (DRAWN // 2) >= self.span)
        yield from (long_steps, long_steps + 1)
        if self.energy is not None and (long_steps.size or not self.energy.add_rows(self._columns_of(part))):
            self.energy = None  # states inside long steps would matter
        positive = np.where(intervals > 0.0, intervals, np.inf)
        if positive.size and positive.min() < self.nearest:
            self.nearest = float(positive.min())
            yield int(positive.argmin()) + np.arange(2)
        inner_moments = self.moments[(self.moments >= time[0]) & (self.moments <= time[-1])]
        rows_before = np.searchsorted(time, inner_moments, side="right") - 1
        yield from (rows_before, np.minimum(rows_before + 1, time.size - 1))
        if "regime" in part.columns and self.changes <= MOST_BANDS:
            changed = 1 + np.flatnonzero(np.diff(part.columns["regime"]))
            changed = changed[(changed >= part.rows_before) & (changed < part.rows_before + part.count)]
            self.changes += changed.size
            yield from (changed, changed - 1)

    def _columns_of(self, part: RowRange) -> xr.Dataset:
        """Return a part with the row before it as a record in memory."""
        import xarray as xr

        end = part.rows_before + part.count
        columns = {
            name: (STEPS, values[:end], self.run[name].attrs)
            for name, values in part.columns.items()
            if values.ndim == 1
        }
        return xr.Dataset(columns, attrs=self.run.attrs)

    def plane_coordinates(self, part: RowRange) -> Iterator[Any]:
        """Yield where the model's plane has its bodies."""
        if self.model is None or not {*(names := plane_variables(self.model))} <= {*part.columns}:
            return
        states = {name: part.own_rows(name) for name in names}
        for x, y in plane_positions(self.model, part.own_rows("time"), states):
            yield from (x, y)


def overlay_of(
    run: xr.Dataset, sources: Sequence[Any], requested_names: Sequence[str] | None = None, names: Sequence[str] = ()
) -> Overlay:
    """Return other runs and measured data in the units of a run, named by what differs.

    Parameters
    ----------
    run : xarray.Dataset
    sources : sequence of Dataset, path or table
    requested_names : sequence of str, optional
        What is drawn.
    names : sequence of str
        Of the run and of each source, if they were given.

    Raises
    ------
    InputError
        If one has no variable in common with the run, or one of another kind of unit.
    """
    companions = [_companion_of(run, source, requested_names) for source in sources]
    if not companions:
        return Overlay()
    records = [run, *(companion.record for companion in companions if companion.record is not None)]
    labels = iter(run_labels(records) if len(records) > 1 else ["computed"])
    run_label = names[0] if names else next(labels)
    if names:
        return Overlay(
            run_label,
            tuple(replace(companion, label=name) for companion, name in zip(companions, names[1:], strict=True)),
        )
    return Overlay(
        run_label,
        tuple(
            companion if companion.record is None else replace(companion, label=next(labels))
            for companion in companions
        ),
    )


def _companion_of(run: xr.Dataset, source: Any, requested_names: Sequence[str] | None) -> RunCompanion:
    if isinstance(source, GIVEN) and location_of(source).suffix.lower() == ".nc":
        source = open_run(source)
    record = None if is_measured(source) else excerpt_of(source, requested_names)
    label, series = _measured_series(run, source) if record is None else _run_series(record)
    columns, factors = {}, {}
    for name, (times, values, doubts, units) in series.items():
        if name not in run or run.variables[name].dims != (STEPS,):
            continue
        run_unit, companion_unit = (parse_unit(text) for text in (str(run.variables[name].attrs["units"]), units))
        if run_unit.dimension != companion_unit.dimension:
            raise InputError(f"'{name}' of {label} is in '{units}', the run has it in '{run_unit.text}'")
        factors[name] = factor = float(companion_unit.factor / run_unit.factor)
        columns[name] = (times, values * factor, None if doubts is None else doubts * factor)
    if not columns:
        raise InputError(f"{label} has nothing that the run has; there are {', '.join(series) or 'none'}")
    return RunCompanion(label, columns, record, factors)


def _measured_series(run: xr.Dataset, source: Any) -> tuple[str, dict[str, tuple[Floats, Floats, Floats | None, str]]]:
    data = read_measured_data(source, [str(variable) for variable in run.data_vars], SKIP, time_unit_of(run))
    series: dict[str, tuple[Floats, Floats, Floats | None, str]] = {}
    for name, (values, unit) in data.values.items():
        doubt, doubt_unit = data.uncertainties.get(name, (np.zeros(values.shape), unit))
        series[name] = data.times, values, doubt * float(doubt_unit.factor / unit.factor), unit.text
    return f"measured, {data.name}".replace("'", ""), series


def _run_series(companion_run: xr.Dataset) -> tuple[str, dict[str, tuple[Floats, Floats, Floats | None, str]]]:
    series: dict[str, tuple[Floats, Floats, Floats | None, str]] = {}
    for name, variable in companion_run.data_vars.items():
        if variable.dims == (STEPS,) and variable.dtype.kind == "f" and not is_chunked(variable.variable):
            times, (values,) = plotted_lines(companion_run, str(name), exact=name == "total_energy")
            series[str(name)] = times, values, None, str(variable.attrs.get("units", "1"))
    return str(companion_run.attrs.get("title", "other run")), series

"""The steps of a record, read so that they can be repeated: accepted times, rows, closed links, models, columns.

Recorded steps may reach from each row to the next, or rows may be left out between them; this is checked.

Closed links of an assembly are read by row: a step goes on with them, and states alone do not tell which they are. A
march knows where slips began, and how fast links met. Where friction wedges, forces exist for more than one choice of
links that hold and slide, and the choice of the march depends on that history.

A model is read from its record once. Columns are stacked for functions of many of them at once: in memory, or chunk by
chunk. Wanted times are read in every form that a caller may state them in.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.elementary.arrays import flattened_rows
from xdynamics.elementary.bounds import EPS
from xdynamics.faults import InputError
from xdynamics.march import Settings
from xdynamics.march.dense_output import ListedLinks
from xdynamics.methods.scheme import DOUBLE_DOUBLE
from xdynamics.model import Model
from xdynamics.model.assemblies import assemblies
from xdynamics.record.link_columns import FRICTION_STATE, link_names
from xdynamics.record.named_rows import places_among
from xdynamics.record.run_columns import state_names
from xdynamics.record.schemas import RARE
from xdynamics.schema import STEPS, at_closed
from xdynamics.shapes.blocks import Block
from xdynamics.units import SECONDS, Range, Unit, is_range, time_in, unit_suffix

Floats = NDArray[np.float64]


class AcceptedTimes:
    """Accepted times, of which only the chunks are read that a search needs."""

    def __init__(self, time: xr.Variable) -> None:
        self._time, self.units = time, str(time.attrs.get("units", SECONDS.text))
        sizes = time.chunks[0] if time.chunks else (time.size,)
        self._offsets = np.concatenate([[0], np.cumsum(sizes)])
        self._read: dict[int, Floats] = {}

    def __len__(self) -> int:
        return int(self._offsets[-1])

    def times_of_rows(self, rows: NDArray[np.int64]) -> Floats:
        """Return the times of rows."""
        if len(self._offsets) == 2:
            return self._chunk(0)[rows]
        chunks = np.searchsorted(self._offsets, rows, side="right") - 1
        times = np.empty(rows.size)
        for chunk in np.unique(chunks).tolist():
            is_in_chunk = chunks == chunk
            times[is_in_chunk] = self._chunk(chunk)[rows[is_in_chunk] - self._offsets[chunk]]
        return times

    def row_counts(self, requested_times: Floats, side: Literal["left", "right"]) -> NDArray[np.int64]:
        """Count the rows before each time, or up to and including it."""
        counts = np.empty(requested_times.size, np.int64)
        pending = [(0, len(self._offsets) - 2, np.arange(requested_times.size))]
        while pending:
            low, high, which = pending.pop()
            if low == high:
                counts[which] = self._offsets[low] + np.searchsorted(
                    self._chunk(low), requested_times[which], side=side
                )
                continue
            middle = (low + high + 1) // 2
            border = self._chunk(middle)[0]
            # events repeat a time: rows equal to the border, which "left" leaves out, may begin in the chunk before
            is_above = requested_times[which] >= border if side == "right" else requested_times[which] > border
            parts = (low, middle - 1, which[~is_above]), (middle, high, which[is_above])
            pending += [part for part in parts if part[2].size]
        return counts

    def _chunk(self, chunk: int) -> Floats:
        if chunk not in self._read:
            part = self._time.isel({STEPS: slice(int(self._offsets[chunk]), int(self._offsets[chunk + 1]))})
            self._read[chunk] = np.asarray(part)
        return self._read[chunk]


def locate_steps(
    accepted: AcceptedTimes, requested_times: Floats, *, after_event: bool
) -> tuple[NDArray[np.int64], Floats, Floats]:
    """Find the row from which each time's step starts, and the times at both ends of that step.

    Parameters
    ----------
    accepted : AcceptedTimes
    requested_times : ndarray, shape (k,), in the run's unit of time
    after_event : bool
        Whether an event's time is that of the last of its rows, with the state after the event.

    Returns
    -------
    tuple of ndarray, shape (k,)
        Rows, and the times of each row and of the next.

    Raises
    ------
    InputError
        If a time is outside the run.
    """
    first, last = accepted.times_of_rows(np.array([0, len(accepted) - 1])).tolist()
    if first > last:
        raise InputError(
            "the rows are not in the order of time; take them in their order, as in run.isel(step=slice(a, b))"
        )
    outside = np.flatnonzero((requested_times < first) | (requested_times > last))
    if outside.size:
        unit = unit_suffix(accepted.units)
        raise InputError(
            f"times[{int(outside[0])}] = {float(requested_times[outside[0]])!r}{unit} is outside the run, from {first!r}{unit}"
            f" to {last!r}{unit}; a run is never extrapolated"
        )
    rows = accepted.row_counts(requested_times, "right") - 1
    if not after_event:
        # rows of an event share its time: the first of them is the state before it
        rows = np.minimum(rows, accepted.row_counts(requested_times, "left"))
    return rows, accepted.times_of_rows(rows), accepted.times_of_rows(np.minimum(rows + 1, len(accepted) - 1))


def slack(run: xr.Dataset) -> float:
    """Return the part of t by which a recorded step may miss the next row: the sum of given steps is rounded."""
    return EPS * max(8, 4 * run.sizes.get(schema.GIVEN, 0))


def check_steps_meet(where: Floats, steps: Floats, near: float, unit: str, every: int) -> None:
    """Refuse a record with rows left out: its steps would not reach from one row to the next.

    Raises
    ------
    InputError
        Naming the first such times.
    """
    times, starts, ends = where
    gaps = np.abs(ends - starts - steps)
    torn = np.flatnonzero((times > starts) & (gaps > near * np.maximum(np.abs(starts), np.abs(ends))))
    if torn.size:
        i = int(torn[0])
        if every > 1:
            raise InputError(
                f"t = {times[i]:.15g}{unit} is between rows of the run that were left out, from"
                f" {starts[i]:.15g}{unit} to {ends[i]:.15g}{unit}: of those this record has {RARE.format(every)}, or"
                " ask for times of kept rows"
            )
        raise InputError(
            f"rows are missing between t = {starts[i]:.15g}{unit} and {ends[i]:.15g}{unit}: the step to the later one"
            f" is {steps[i]:.15g}{unit}; sample the whole record, and choose among its rows afterwards"
        )


def check_rows_follow(where: Floats, numbers: xr.Variable, unit: str) -> None:
    """Refuse steps between whose ends a row of the march was left out, like the one behind an event.

    Parameters
    ----------
    where : ndarray
        Wanted times, the starts and ends of their steps, and the rows where these start.
    numbers : xarray.Variable
        `step_number`, of which those rows are read.

    Raises
    ------
    InputError
        Naming the first such times.
    """
    times, starts, ends, places = map(np.atleast_1d, where)
    rows = places.astype(np.int64)
    row_numbers, following = (
        np.asarray(numbers.isel({schema.STEPS: step_rows}).values)
        for step_rows in (rows, np.minimum(rows + 1, numbers.size - 1))
    )
    broken_steps = np.flatnonzero((following - row_numbers > 1) & (times > starts))
    if broken_steps.size:
        i = int(broken_steps[0])
        count = int(following[i] - row_numbers[i]) - 1
        missing = "a row is" if count == 1 else f"{count} rows are"
        raise InputError(
            f"{missing} missing between t = {starts[i]:.13g}{unit} and {ends[i]:.13g}{unit}; sample the whole record, and"
            " choose among its rows afterwards"
        )


IntArray = NDArray[np.int64]
STEP, CONTACT = at_closed("step"), at_closed("contact")
NUMBER = schema.STEP_NUMBER.name


@dataclass(frozen=True)
class RowLinks:
    """The closed links of rows.

    Attributes
    ----------
    rows : ndarray of int, shape (c,)
        Ascending.
    link_states : ndarray of int, shape (2, c)
        Number of each link among those of all contacts, and what it does along its slip.
    """

    rows: IntArray
    link_states: IntArray

    def links_at(self, rows: Any) -> ListedLinks:
        """Return the closed links of some rows."""
        first, last = (np.searchsorted(self.rows, rows, side=side) for side in ("left", "right"))
        return ListedLinks(np.stack([first, last - first]).astype(float), self.link_states)


def links_read(run: xr.Dataset, model: Model) -> dict[str, Any]:
    """Return the stored variables of closed links; empty if the record does not list closed links."""
    names = link_names(model)
    column_names = [*names, NUMBER]
    if not names or not all(name in run.variables for name in column_names):
        return {}
    return {name: run.variables[name].data for name in column_names}


def row_links(model: Model, read: Mapping[str, Any]) -> RowLinks | None:
    """Return the closed links of a record's rows; None where it does not list them, or not of these rows.

    Raises
    ------
    InputError
        If they are not in the order of rows, or one is no link of the model: compiled code reads them as they are.
    """
    columns = {name: np.asarray(column) for name, column in read.items()}
    if not columns:
        return None
    steps, contacts, listing = columns[STEP], columns[CONTACT], assemblies(model)
    _refuse_links(STEP, steps, steps[1:] < steps[:-1], "rows ascend")
    _refuse_links(CONTACT, contacts, ~np.isin(contacts, range(len(listing))), _numbers_below(len(listing)))
    numbers, begin = np.zeros(steps.size, np.int64), 0
    for c, contact in enumerate(listing):
        is_contact, shape = contacts == c, model.shapes.shape(contact.dims)
        element_indices = []
        for dim, length in zip(contact.dims, shape, strict=True):
            element_index = columns[at_closed(dim)]
            _refuse_links(
                at_closed(dim),
                element_index,
                is_contact & ~np.isin(element_index, range(length)),
                _numbers_below(length),
            )
            element_indices.append(element_index[is_contact].astype(np.int64))
        numbers[is_contact] = begin + (np.ravel_multi_index(element_indices, shape) if shape else 0)
        begin += contact.links
    _refuse_links(
        STEP, steps, (steps[1:] == steps[:-1]) & (numbers[1:] <= numbers[:-1]), "links of a row ascend, each once"
    )
    does, states = columns.get(at_closed(FRICTION_STATE), np.zeros(steps.size, np.int64)), len(schema.LINK_STATES)
    _refuse_links(at_closed(FRICTION_STATE), does, ~np.isin(does, range(states)), _numbers_below(states))
    rows = places_among(columns[NUMBER], steps)
    is_recorded = rows >= 0
    return RowLinks(rows[is_recorded], np.stack([numbers[is_recorded], does[is_recorded]]).astype(np.int64))


def _numbers_below(count: int) -> str:
    return f"there are 0 to {count - 1}"


def _refuse_links(name: str, values: Any, wrong: Any, needed: str) -> None:
    """Refuse values of closed links that no march writes, naming the first; `wrong` may lack the first value."""
    if not wrong.any():
        return
    in_order = values.size - wrong.size
    link_index = int(np.flatnonzero(wrong)[0]) + in_order
    previous_words = f" after {values[link_index - 1]}" if in_order else ""
    raise InputError(
        f"'{name}' is {values[link_index]}{previous_words} at place {link_index} along '{schema.CLOSED_LINKS}', and {needed}: the record was"
        " edited; take what simulate or open_run gives, or drop its closed_... variables, and links are found from states"
    )


def links_of_rows(run: xr.Dataset, numbers: IntArray) -> dict[str, Any]:
    """Return the closed links of a record's rows of given numbers, read."""
    if STEP not in run.variables:
        return {}
    link_indices = np.flatnonzero(np.isin(np.asarray(run.variables[STEP].values), numbers))
    return {
        str(name): variable.isel({schema.CLOSED_LINKS: link_indices}).load()
        for name, variable in run.variables.items()
        if schema.CLOSED_LINKS in variable.dims
    }


def model_of_record(run: xr.Dataset, functions: Mapping[str, Callable[..., float]] | None) -> Model:
    """Return the model of a record, cached."""
    return _read_cached_model(run.variables["model_toml"].values.item(), tuple((functions or {}).items()))


@lru_cache(maxsize=16)
def _read_cached_model(text: str, functions: tuple[tuple[str, Callable[..., float]], ...]) -> Model:
    """Read a model from its text, cached."""
    return Model.from_record(text, functions=dict(functions))


def blockwise(
    function: Callable[[Floats, Floats, Any], Floats],
    where: Floats,
    columns: list[Any],
    height: int,
    later: Callable[[], Any],
) -> Any:
    """Apply a function lazily to stacked columns, and to an argument common to all blocks."""
    import dask.array

    da: Any = dask.array  # its functions are not typed

    data = [da.asarray(column.transpose(STEPS, ...).data) for column in columns]
    parts = da.concatenate([part.reshape(len(part), -1).T for part in data]).rechunk({0: -1})
    places = da.from_array(where, chunks=(len(where), parts.chunks[1]))
    # without meta dask would call the function with empty arrays to learn what it returns
    return da.map_blocks(
        function, places, parts, dtype=float, chunks=((height,), parts.chunks[1]), meta=np.empty((0, 0)), links=later()
    )


def stack_columns(columns: list[Any]) -> Floats:
    """Return the numbers of variables along `step`, shape (elements of all variables, rows)."""
    parts = [np.asarray(column.transpose(STEPS, ...)) for column in columns]
    return np.concatenate([flattened_rows(part).T for part in parts])


def step_columns(
    model: Model,
    settings: Settings,
    rows: NDArray[np.int64],
    following: NDArray[np.int64],
    *,
    by_element: bool = False,
) -> list[tuple[str, NDArray[np.int64]]]:
    """Return the columns that `states_within` repeats steps from, each with its rows: of the start or of the end.

    They are those of quantities, or of their elements where a record has a variable for each.
    """
    blocks = settings.layout(model).used
    used = tuple(blocks) if by_element else tuple(block.name for block in blocks.blocks)
    contact_states = state_names(model, by_element=by_element)
    columns_with_rows = [("step_size", following)]
    columns_with_rows += [(name, rows) for name in ("regime", "row_kind", *contact_states, *used)]
    if settings.precision == DOUBLE_DOUBLE:
        columns_with_rows += [(name, rows) for name in (*map(schema.rest_name, used), schema.REST_TIME.name)]
    elif settings.method.stepper.has_memory:
        # iterations that continue from those of the step before do not reproduce its end to the bit
        columns_with_rows += [(name, following) for name in used]
    return columns_with_rows + [(name, rows) for name in settings.layout(model).shares]


def values_along(numbers: Any, first: int, quantity: Block) -> Any:
    """Return the rows of a quantity as its values, its dimensions last."""
    rows = numbers[first : first + quantity.size]
    return rows.T.reshape(-1, *quantity.shape) if quantity.dims else rows[0] if len(rows) else rows


MOST_TIMES = 100_000_000  # of a range


def wanted_times(times: Any, unit: Unit = SECONDS) -> Floats:
    """Read requested times: numbers in the model's unit of time, texts, or a range like ``0:20:201 s``.

    Raises
    ------
    InputError
        If they are not times, or none.
    """
    if isinstance(times, str) and ":" in times:
        if not is_range(times):
            raise InputError(
                f"times are {times[:60]!r}, need start:stop:count and a unit, count a whole number, like '0:20:201 s'"
            )
        span = Range.parse(times)
        if span.unit.text != "1" and span.unit.dimension != unit.dimension:
            raise InputError(f"times {times!r} are in '{span.unit.text}', need a time in '{unit.text}'")
        if not 0 < span.count <= MOST_TIMES:
            raise InputError(f"times {times!r} are {span.count}, need a count from 1 to {MOST_TIMES}")
        times = np.linspace(span.start, span.stop, span.count) * float(span.unit.factor)
    elif isinstance(times, str):
        times = [time_in(unit, time, "times") for time in times.split(",")]
    elif isinstance(times, list | tuple) and any(isinstance(time, str) for time in times):
        times = [time_in(unit, time, "times") for time in times]
    try:
        # as a float, True would be the time 1
        if np.asarray(times).dtype == bool:
            raise TypeError(times)  # noqa: TRY301 - answered right below
        requested_times = np.atleast_1d(np.asarray(times, dtype=float))
    except (TypeError, ValueError):
        raise InputError(f"times are {str(times)[:60]}, need numbers in '{unit.text}'") from None
    if requested_times.ndim != 1 or not requested_times.size:
        raise InputError(f"times have the shape {requested_times.shape}, need one row with at least one time")
    if np.isnan(requested_times).any():
        raise InputError(
            f"times[{int(np.flatnonzero(np.isnan(requested_times))[0])}] is nan, needs a time in '{unit.text}'"
        )
    return requested_times

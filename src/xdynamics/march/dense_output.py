"""States between the rows of a log: steps of one run or many, repeated and shortened to end at the wanted times."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from itertools import compress
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.elementary.double_double import DoubleDouble, nearest
from xdynamics.elementary.double_double.sums import multiply
from xdynamics.kernels import Law, Layout, law_of
from xdynamics.march.engine import engine
from xdynamics.march.engine import lanes as side_by_side
from xdynamics.march.ensemble import Runs
from xdynamics.march.initial_run import pose_run, rest_of_time
from xdynamics.march.log import allocate
from xdynamics.march.past import Past, lend_past
from xdynamics.march.run import Run
from xdynamics.march.settings import Settings
from xdynamics.march.simd_ensemble import table_of
from xdynamics.model import Model
from xdynamics.model.reactions import reactions
from xdynamics.model.regime_model import RegimeModel
from xdynamics.model.sliding import SlidingModel, Surface, sliding_model, surfaces
from xdynamics.units import TIME

Floats = NDArray[np.float64]


class ListedLinks(NamedTuple):
    """Closed links of many at the starts of steps.

    Attributes
    ----------
    spans : ndarray, shape (2, k)
        Where those of each step begin in `link_columns`, and how many there are.
    link_columns : ndarray of int, shape (2, c)
        Number of each link among those of all contacts, and what it does along its slip.
    """

    spans: Floats
    link_columns: NDArray[np.int64]


def states_within(
    model: Model,
    settings: Settings,
    law: Law,
    where: Floats,
    columns: Floats,
    factors: Floats,
    *,
    reintegrated: bool,
    with_distances: bool = True,
    parameters: Floats | None = None,
    runs: NDArray[np.int64] | None = None,
    past: Past | None = None,
    low_parts: Floats | None = None,
    links: ListedLinks | None = None,
    run: Run | None = None,
    state_room: Floats | None = None,
) -> Floats:
    """Evaluate states inside steps, and the distance of each from a more accurate one.

    Parameters
    ----------
    model : Model
    settings : Settings
    law : Law
    where : ndarray, shape (3, k), s
        Wanted time, start and end of its step.
    columns : ndarray, shape (3 + r + n or 3 + r + 2*n, k)
        Step size; regime, kind of row, state of each reaction and state at the start; and for a method
        whose iterations continue those of the step before, the state at the end; in units of the record. Where numbers
        are sums of two, after the state its rests and that of the time. In the end the share at the start of each switch
        that the motion may slide along, nan where it does not.
    factors : ndarray, shape (n, 1) or (1, 1)
        From internal units to those of the record.
    reintegrated : bool
        Whether to make a shorter step, or to use the interpolant of the whole one.
    with_distances : bool
        Whether to compute the distances too; else they are nan.
    parameters : ndarray, shape (m, …), optional
        Of many runs, in internal units.
    runs : ndarray of int, shape (k,), optional
        The run that each time belongs to.
    past : Past, optional
        Of a run with delayed values: its steps, as `past_of` makes them.
    low_parts : ndarray, shape (k,), s, optional
        Of the wanted times, where numbers are sums of two; by default of the decimal numbers that they are written as.
    links : ListedLinks, optional
        By default closed links of many are found from the states at the starts, as a march does that begins there.
    run : Run, optional
        What steps are made in, for those who ask again and again, one at a time: as `posed_inside` makes it.
    state_room : ndarray, contiguous, shape as below, optional
        Room for the result.

    Returns
    -------
    ndarray, shape (2*n, k) or (3*n, k)
        The states, and their distances; where numbers are sums of two, then the rests of the states. At an accepted time the state is the accepted one, to the bit.
    """
    switches = () if isinstance(law.layout.model, SlidingModel) else surfaces(law.layout.model)
    columns, shares = np.split(columns, [len(columns) - len(switches)])
    if not np.isnan(shares).all():
        of_steps = {"runs": runs, "low_parts": low_parts}
        of_all = {"reintegrated": reintegrated, "with_distances": with_distances, "parameters": parameters}
        return _by_what_slides(model, settings, law, where, columns, shares, factors, of_steps, of_all)
    scale, n, reaction_count = settings.scales.si_factor(TIME), law.layout.used.size, len(reactions(model))
    times, starts, ends = where / scale
    moving = np.flatnonzero(times > starts)
    size, regime, after_event = columns[0], columns[1], columns[2] == schema.EVENT_AFTER
    states, columns = columns[3 : 3 + reaction_count], columns[3 + reaction_count :]
    doubled = law.layout.is_doubled
    if not moving.size:
        return _at_rest(columns, n, doubled=doubled)
    owners = np.zeros(times.size) if runs is None else runs
    spans, link_columns = links or ListedLinks(np.full((2, times.size), -1.0), np.zeros((2, 0), np.int64))
    steps = np.stack([starts, ends, size / scale, times, owners, regime, after_event, *spans, *states])
    if doubled:
        left = [rest_of_time(time) for time in times.tolist()] if low_parts is None else low_parts
        steps = np.vstack([steps, columns[2 * n], left])
        inputs = [steps, _doubled_states(model, law.layout, columns), columns[:0]]
    else:
        inputs = [steps, *(_in_internal_units(part, factors) for part in (columns[:n], columns[n:]))]
    all_inside = moving.size == times.size
    inner = (
        state_room
        if state_room is not None and all_inside and not doubled
        else np.empty((2 * len(inputs[1]), moving.size))
    )
    # by default a run of its own: this is called in several threads
    run = posed_inside(model, settings, law, reintegrated=reintegrated) if run is None else run
    if past is not None:
        past.lend(run)
    selection = slice(None) if all_inside else moving  # which copies nothing
    # entries of the engine read arrays in C order
    inputs = [np.ascontiguousarray(array[:, selection]) for array in inputs]
    run_parameters = np.zeros((0, 0)) if parameters is None else np.ascontiguousarray(parameters)
    engine().states_inside(run, run_parameters, *inputs, link_columns, inner, reintegrated, with_distances)
    if doubled:
        inner = _recorded_states(model, law.layout, inner)
    else:
        inner[:n] *= factors
        inner[n:] *= factors
    if all_inside:
        return inner
    results = _at_rest(columns, n, doubled=doubled)
    results[:, moving] = inner
    return results


def _by_what_slides(
    model: Model,
    settings: Settings,
    law: Law,
    where: Floats,
    columns: Floats,
    shares: Floats,
    factors: Floats,
    of_steps: Mapping[str, Any],
    of_all: Mapping[str, Any],
) -> Floats:
    """Evaluate states inside steps, those that slide along the same switches together; see `states_within`."""
    switches, states = surfaces(law.layout.model), np.empty(0)
    slid, group_of = np.unique(~np.isnan(shares), axis=1, return_inverse=True)
    for group in range(slid.shape[1]):
        steps, along = np.flatnonzero(group_of.ravel() == group), tuple(compress(switches, slid[:, group]))
        unslid = np.full((0 if along else len(switches), steps.size), np.nan)
        own: dict[str, Any] = {name: None if array is None else array[steps] for name, array in of_steps.items()}
        way_model, way_law = _along(model, settings, law, along)
        way_columns = np.vstack([columns[:, steps], unslid])
        part = states_within(way_model, settings, way_law, where[:, steps], way_columns, factors, **own, **of_all)
        states = states if states.size else np.empty((len(part), shares.shape[1]))
        states[:, steps] = part
    return states


def _along(model: Model, settings: Settings, law: Law, along: tuple[Surface, ...]) -> tuple[Model, Law]:
    """Return a model that slides along some switches, and its law."""
    if not along:
        return model, law
    base = settings.layout(model).model  # not the law's, which is of the first model of its form, with other numbers
    assert isinstance(base, RegimeModel)  # noqa: S101 - others have no switches
    slid = sliding_model(base, along)
    return slid, law_of(settings.layout(slid), sampled=law.sampled, unread=law.unread)


def posed_inside(model: Model, settings: Settings, law: Law, *, reintegrated: bool) -> Run:
    """Return a run in which steps are made again, to end inside, or up to their ends for the interpolant."""
    addresses = law.addresses if reintegrated else law.addresses_inside
    return pose_run(model, settings, law, allocate(law.layout, 1, sampled=0, samples_kept=False), addresses)


def _at_rest(columns: Floats, n: int, *, doubled: bool) -> Floats:
    """Return accepted states without a step after them."""
    return np.vstack([columns[:n], np.zeros_like(columns[:n]), columns[n : 2 * n] if doubled else columns[:0]])


def _in_internal_units(numbers: Floats, factors: Floats) -> Floats:
    """Return recorded numbers in internal units; the array itself where all factors are 1."""
    return numbers if not len(numbers) or (factors == 1.0).all() else numbers / factors


def past_of(model: Model, settings: Settings, law: Law, columns: Floats, factors: Floats) -> Past:
    """Return the steps of a run with delayed values, made again from all of its rows.

    Parameters
    ----------
    model : Model
    settings : Settings
    law : Law
    columns : ndarray, shape (4 + r + n, rows)
        Time and step size in units of the record, regime, kind of row, state of each reaction, the state.
    factors : ndarray, shape (n, 1) or (1, 1)
        From internal units to those of the record.
    """
    run = pose_run(model, settings, law, allocate(law.layout, 1, sampled=0), law.addresses)
    first, scale = 4 + len(reactions(model)), settings.scales.si_factor(TIME)
    steps, width = columns[:first].copy(), int(run.book[0].width)
    steps[:2] /= scale
    lend_past(run, np.empty(0), width * columns.shape[1])
    engine().retrace(run, steps, np.ascontiguousarray(columns[first:] / factors))
    return Past(run.past_steps[: int(run.book[0].pieces) * width].copy(), run.book.copy())


def _doubled_states(model: Model, layout: Layout, columns: Floats) -> Floats:
    """Return states as a march has them, with their rests at the end, from recorded ones."""
    n, between = layout.used.size, layout.evaluation.size
    numbers = multiply(DoubleDouble(columns[:n], columns[n : 2 * n]), _exact_factors(model, layout, inverse=False))
    return np.vstack([numbers.high, np.zeros((between, columns.shape[1])), numbers.low])


def _recorded_states(model: Model, layout: Layout, inner: Floats) -> Floats:
    """Return recorded states, their distances and their rests from those of a march."""
    n, width = layout.used.size, len(inner) // 2
    low_parts = slice(width - n, width)
    exact = _exact_factors(model, layout, inverse=True)
    numbers = multiply(DoubleDouble(inner[:n], inner[low_parts]), exact)
    return np.vstack([numbers.high, inner[width : width + n] * exact.high, numbers.low])


def _exact_factors(model: Model, layout: Layout, *, inverse: bool) -> DoubleDouble:
    """Return the factors from recorded numbers to SI units, or back."""
    factors = [Fraction(model.elements.units[name].factor) for name in layout.used]
    sums = [nearest(1 / factor if inverse else factor) for factor in factors]
    return DoubleDouble(*(np.array(parts)[:, np.newaxis] for parts in zip(*sums, strict=True)))


class PartsAbreast:
    """States inside steps of many runs, evaluated side by side, bit for bit as by `states_within`, without distances.

    Parameters
    ----------
    model : Model
        Without contacts.
    settings : Settings
        As for a single step.
    law : Law
    factors : ndarray, shape (n,)
        From internal units to those of the record.
    lanes : int
    """

    def __init__(self, model: Model, settings: Settings, law: Law, factors: Floats, lanes: int) -> None:
        self._law = law  # keeps the code at the addresses alive
        self._run = run = pose_run(model, settings, law, allocate(law.layout, 1, sampled=0), law.addresses)
        self._factors = np.array([settings.scales.si_factor(TIME), *factors])
        self._blocks = {name: np.zeros((len(getattr(run, name)), lanes)) for name in ("at", "y", "p", "z", "e")}
        self._blocks["pieces"] = np.zeros((len(run.places), lanes), np.int64)
        self._blocks["w"] = np.zeros((max(1, law.memory), lanes))
        self._room = np.zeros((3, lanes)), np.zeros(lanes, np.int64)
        self._table, self._addresses = table_of(self._blocks | {"tables": run.tables}), law.parting_addresses(lanes)

    def states(self, runs: Runs, jobs: NDArray[np.int64], times: Floats) -> Floats:
        """Evaluate the states.

        Parameters
        ----------
        runs : Runs
            With times, step sizes and states of their logs.
        jobs : ndarray of int, shape (3, k)
            Row at the start of each step, row at its end, and the run.
        times : ndarray, shape (k,), s

        Returns
        -------
        ndarray, shape (n, k)
        """
        result, log = np.empty((len(self._factors) - 1, times.size)), runs.log_block.log
        blocks = (self._blocks[name] for name in ("at", "y", "p", "pieces", "z"))
        inputs = (log.rows, log.flags, np.ascontiguousarray(runs.parameters), self._factors)
        side_by_side().parts(
            self._run,
            *self._addresses,
            self._table,
            *blocks,
            *inputs,
            np.ascontiguousarray(jobs),
            np.ascontiguousarray(times),
            *self._room,
            result,
        )
        return result


def step_start_rows(
    time: Floats, low: NDArray[np.int64], high: NDArray[np.int64], times: Floats, *, last_at_time: bool
) -> NDArray[np.int64]:
    """Return the row at the start of the step to each time, between two rows; see `step_parts.rows_of_times`."""
    rows = np.empty(times.size, np.int64)
    engine().rows_of_times(np.ascontiguousarray(time), low, high, np.ascontiguousarray(times), last_at_time, rows)
    return rows

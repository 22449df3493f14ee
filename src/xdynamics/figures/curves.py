"""Lines of a run: refined by states inside long steps, thinned where there are very many rows.

States between the rows of a record, on Hermite polynomials through what is recorded at both ends of a step.

Lines that are level over whole steps: of what is held until the next row, and of means over the step before a row.

Variables of a run by their roles.
"""

from __future__ import annotations

import weakref
from collections import ChainMap
from collections.abc import Container, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.dynamics.recorded_steps import model_of_record, slack
from xdynamics.dynamics.shortened_steps import sample_in_steps
from xdynamics.evidence.observables import evaluate_quantity, rate_on, state_rates
from xdynamics.evidence.observed_quantities import widest
from xdynamics.faults import InputError
from xdynamics.methods import METHODS
from xdynamics.methods.scheme import REINTEGRATE
from xdynamics.model import Model
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.schema import HELD, INTEGRATED, STEPS, acceleration, rate, velocity
from xdynamics.shapes import split_element_name
from xdynamics.units import parse_unit

Rows = NDArray[np.int64]
Floats = NDArray[np.float64]
TOGETHER = 256  # elements of a quantity


@dataclass(frozen=True)
class StatePolynomials(Mapping[str, Floats]):
    """States of a run inside its steps on Hermite polynomials, evaluated when they are first asked for.

    A coordinate from its velocity and acceleration, a velocity from its acceleration, a first-order state from its rate.

    Attributes
    ----------
    run : xarray.Dataset
    times, rows : ndarray, shape (k,)
        Where, and in which step.
    names : dict of str
        Of the states, in order, whose derivatives are known.
    derived : mapping of str to ndarray
        Derivatives at all rows that the run has no columns of, in recorded units.
    """

    run: xr.Dataset
    times: Floats
    rows: Rows
    names: Mapping[str, None]
    derived: Mapping[str, Floats] = field(default_factory=dict)
    _evaluated_states: dict[str, Floats] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Floats:
        if name not in self._evaluated_states:
            if name not in self.names:
                raise KeyError(name)
            elements = self._elements_by_quantity[split_element_name(name)[0]]
            first = elements.index(name) // TOGETHER * TOGETHER
            self._evaluate(elements[first : first + TOGETHER])
        return self._evaluated_states[name]

    @cached_property
    def _elements_by_quantity(self) -> dict[str, list[str]]:
        """The states by the quantities that they are elements of."""
        names_by_quantity = dict[str, list[str]]()
        for name in self.names:
            names_by_quantity.setdefault(split_element_name(name)[0], []).append(name)
        return names_by_quantity

    def _evaluate(self, names: list[str]) -> None:
        """Evaluate elements of a quantity together: one by one each takes as long as some dozens."""
        columns = _columns_with_derived(self.run, self.derived)
        chains = {name: derivative_chain(columns, name) for name in names}
        for length in dict.fromkeys(map(len, chains.values())):  # of logs of some elements not all are equally long
            equal_chains = {name: chain for name, chain in chains.items() if len(chain) == length}
            values = [
                np.stack([_column_array(columns[name]) for name in derivative_names])
                for derivative_names in zip(*equal_chains.values(), strict=True)
            ]
            self._evaluated_states.update(
                zip(equal_chains, _inner_polynomials(self.run, values, self.times, self.rows), strict=True)
            )

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __len__(self) -> int:
        return len(self.names)

    def __contains__(self, name: object) -> bool:
        return name in self.names


def derivative_chain(known_names: Container[str], name: str) -> tuple[str, ...]:
    """Name a state and its derivatives as far as they are known; nothing if none is."""
    owner = name.removeprefix(velocity(""))
    chain = (name, rate(name)) if rate(name) in known_names else (name, velocity(name), acceleration(name))
    if name == velocity(owner) and owner in known_names:
        chain = (name, acceleration(owner))
    if chain[1] not in known_names:
        return ()
    return chain if all(member in known_names for member in chain) else chain[:2]  # of a run of states alone


def state_derivatives(run: xr.Dataset, model: Model) -> dict[str, Floats]:
    """Return accelerations and rates at all rows of a run of states alone, from its model, in recorded units.

    None where they are recorded, or depend on what is not known of the states alone.
    """
    elements = model.elements
    names = {velocity(name): acceleration(name) for name in elements.statement.coordinates} | {
        name: rate(name) for name in elements.statement.states
    }
    columns = {*run.variables}
    if not {*elements.units} <= columns or {*names.values()} <= columns:
        return {}
    states = {name: run.variables[name].values for name in elements.units}
    rows = np.arange(run.sizes[STEPS])
    rates = state_rates(run, model, states, run.variables["time"].values, rows) or {}
    by_element = {
        name: numbers
        for quantity, element_rates in rates.items()
        for name, numbers in zip(model.shapes.elements(quantity), element_rates, strict=True)
    }
    return {
        names[name]: numbers / float(elements.units[name].factor)
        for name, numbers in by_element.items()
        if name in names
    }


def _columns_with_derived(run: xr.Dataset, derived: Mapping[str, Floats]) -> Mapping[Any, Any]:
    """Return the columns of a run, and before them what was derived from it."""
    return ChainMap(derived, run.variables)  # type: ignore[arg-type]


def _column_array(column: Any) -> Floats:
    """Return the values of a variable, or an array as it is; NumPy by itself takes ten times as long."""
    values: Floats = column if isinstance(column, np.ndarray) else column.values
    return values


def _inner_polynomials(run: xr.Dataset, values: list[Floats], times: Floats, rows: Rows) -> Floats:
    """Return polynomials inside steps through a state, or several of shape (names, steps), and their derivatives."""
    time = run.variables["time"].values
    h = (time[rows + 1] - time[rows]).astype(float)
    return _hermite(
        [derivative[..., rows] for derivative in values],
        [derivative[..., rows + 1] for derivative in values],
        h,
        (times - time[rows]) / h,
    )


def _hermite(start: list[Floats], end: list[Floats], w: Floats, u: Floats) -> Floats:
    """Return the Hermite polynomial through values and derivatives at both ends of steps of size w, at fractions u of them.

    Quintic with two derivatives, cubic with one (Hairer, Norsett, Wanner, Solving ODEs I, section II.6).
    """
    a, b, p, q = start[0], end[0], w * start[1], w * end[1]
    if len(start) == 2:
        return a + u * p + u**2 * (3 * (b - a) - 2 * p - q) + u**3 * (2 * (a - b) + p + q)
    k, m = w**2 * start[2], w**2 * end[2]
    remainder, slope, bend = b - a - p - k / 2, q - p - k, m - k
    return (
        a
        + u * p
        + u**2 * k / 2
        + u**3 * (10 * remainder - 4 * slope + bend / 2)
        + u**4 * (-15 * remainder + 7 * slope - bend)
        + u**5 * (6 * remainder - 3 * slope + bend / 2)
    )


REACTION = "reaction"  # role of forces of contacts and frictions


def recorded_model(run: xr.Dataset) -> Model | None:
    """Return the record's model, if it has one."""
    return model_of_record(run, None) if "model_toml" in run.variables else None


def known_model(run: xr.Dataset) -> Model | None:
    """Return the record's model, if it has one that needs no Python functions."""
    model = recorded_model(run)
    return None if model is None or model.python_functions else model


def is_mean(run: xr.Dataset, name: str) -> bool:
    """Whether the values of a variable are means over the step before each row: impulses over its duration."""
    method = METHODS.get(str(run.attrs.get("solver_method")))
    if method is None or method.stepper.locates or not {name, "step_size"} <= {*run.variables}:
        return False
    return bool(run.variables[name].attrs.get("role") == REACTION)


def stairs(times: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return times and values of a line that keeps each value until the next row."""
    return np.repeat(times, 2)[1:], np.repeat(values, 2)[:-1]


def means(times: Floats, sizes: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return times and values of a line that is level over the step before each row, straight over rows that were left out.

    Parameters
    ----------
    times, sizes, values : ndarray, shape (n,)
        Of rows, the steps that led to them, and what was its mean over each.
    """
    starts = times - sizes
    starts[1:] = np.maximum(starts[1:], times[:-1])  # which it may be below by rounding
    return np.stack([starts, times], axis=1).ravel(), np.repeat(values, 2)


def with_role(run: xr.Dataset, *roles: str) -> list[str]:
    """Name the variables of a run that have one of some roles.

    They are looked at without coordinates, and in one mapping: a ``DataArray`` of each takes xarray a millisecond where a
    run has a thousand elements, and ``run.variables`` wraps them anew each time that it is asked.
    """
    variables = run.variables
    return [str(name) for name in run.data_vars if variables[name].attrs.get("role") in roles]


DRAWN = 4000  # points of a line; what is longer is thinned
GOLDEN = 0.6180339887498949
FINEST = 1.0 / 2000.0  # of the ranges: what a picture tells apart along a curve in a plane or in space
MOST_ALONG = 100_000  # points of such a curve, about
LEAP = 0.05  # of the ranges in a plane, between neighbours of a line of which rows are left out
MOST_BETWEEN = 40  # points inside each step, however long it is
WORK = 100_000_000  # numbers that an energy is made of at all points together
STATES_WORK = 4_000_000  # numbers of all states together
RATES_WORK = 25_000_000  # numbers that accelerations are made of at all rows together
LARGEST = 128  # numbers of a state, up to which steps are made again for a picture
LARGEST_ENERGETIC = 4096  # where energies are drawn, which polynomials through rows would not show
MET = 1e-3  # of a range: how close a repeated step must come to the row that it led to
ROUNDING = 1e-12  # of what a step adds: what is held at rest has no range but rounding
ENERGY_CHANGES = "energy_changes"  # of an excerpt, which lacks rows: in its encoding
AGREED = 1e-6  # of the largest value: so near what is evaluated is to what was recorded
EVALUATED = (
    "energy",
    "observable",
    "force",
    "acceleration",
    "rate",
    "rate_term",
    REACTION,
    "multiplier",
    "joint",
    "gap",
)


@dataclass(frozen=True)
class InnerStates:
    """States of a run inside its steps.

    Attributes
    ----------
    times : ndarray, shape (k,), s
    rows : ndarray of int, shape (k,)
        Of `step`, from which each step goes.
    states : mapping of str to ndarray, shape (k,)
        In recorded units.
    is_repeated : bool
        Whether from repeated steps of the run's own method; else from Hermite polynomials through the values at both ends.
    """

    times: Floats
    rows: Rows
    states: Mapping[str, Floats]
    is_repeated: bool
    computed: dict[str, Floats | None] = field(default_factory=dict)  # from the states, as far as they were asked for
    merged_orders: list[tuple[Rows, Floats]] = field(
        default_factory=list
    )  # order and times of rows and points, once for all lines


def thinned_rows(values: NDArray[Any], max_points: int = DRAWN, times: Floats | None = None) -> Rows:
    """Return rows to draw: all, or the least and the greatest of each stretch, in order, with both ends.

    Stretches have equal numbers of rows; where times are given, half of them have equal durations instead, so that both
    many short steps and a few long ones are kept.
    """
    n = len(values)
    if n <= max_points:
        return np.arange(n)
    stretches = [np.linspace(0, n, max_points // 2 + 1).astype(np.int64)]
    if times is not None:
        stretches[0] = np.linspace(0, n, max_points // 4 + 1).astype(np.int64)
        stretches.append(np.searchsorted(times, np.linspace(times[0], times[-1], max_points // 4 + 1)[1:-1]))
        stretches[1] = np.concatenate([[0], stretches[1], [n]]).astype(np.int64)
    return np.unique(np.concatenate([[0, n - 1], *(stretch_extremes(values, edges) for edges in stretches)]))


def stretch_extremes(values: NDArray[Any], edges: Rows) -> Rows:
    """Return the rows of the least and of the greatest value of each stretch between edges; nan is neither."""
    is_missing = np.isnan(values)
    low, high = (np.where(is_missing, filler, values) if is_missing.any() else values for filler in (np.inf, -np.inf))
    return np.array(
        [
            begin + row
            for begin, end in pairwise(edges)
            if end > begin
            for row in (np.argmin(low[begin:end]), np.argmax(high[begin:end]))
        ],
        np.int64,
    )


def spread_rows(n: int) -> Rows:
    """Return rows all over a long run, at distances that follow no period of it."""
    count = min(DRAWN, n // 10)
    return np.unique((np.arange(count) + np.arange(count) * GOLDEN % 1.0) * (n / max(count, 1))).astype(np.int64)


def is_long(run: xr.Dataset) -> bool:
    """Whether a figure leaves out rows of a run, or an excerpt has left them out, which numbers its own."""
    return run.sizes[STEPS] > DRAWN or STEPS in run.coords


def ways_along(*coordinates: Floats) -> Floats:
    """Return how far each row of a curve in a plane or in space is from the one before, over the ranges of its coordinates."""
    squares = np.zeros(len(coordinates[0]) - 1)
    for values in coordinates:
        squares += (np.diff(values) / (np.nanmax(values) - np.nanmin(values) or 1.0)) ** 2
    return np.sqrt(squares)


def rows_along(ways: Floats) -> Rows:
    """Return the rows of a curve that a picture tells apart, by the ways from row to row, with both ends and gaps."""
    along = np.concatenate([[0.0], np.cumsum(np.nan_to_num(ways))])
    marks = np.floor(along / max(FINEST, along[-1] / MOST_ALONG))
    is_shown = np.concatenate([[True], (np.diff(marks) > 0.0) | np.isnan(ways)])
    is_shown[-1] = True
    return np.flatnonzero(is_shown)


def curve_in_plane(run: xr.Dataset, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Return the points of a curve that are drawn, all that a picture tells apart.

    It is broken where an excerpt leaps over rows that are left out, and where the steps of a long run are so wide that lines
    between rows would not be the curve: what is left are its rows.
    """
    if len(x) <= DRAWN and STEPS not in run.coords:
        return x, y
    ways = ways_along(x, y)
    if STEPS not in run.coords and np.nanmedian(ways) <= LEAP:
        rows = rows_along(ways)
        return x[rows], y[rows]
    breaks = 1 + np.flatnonzero((ways > LEAP) | (STEPS not in run.coords))
    return np.insert(x, breaks, np.nan), np.insert(y, breaks, np.nan)


def plotted_lines(run: xr.Dataset, *names: str, exact: bool = False) -> tuple[Floats, list[Floats]]:
    """Return times and values of the lines of some variables, all at the same times.

    Parameters
    ----------
    run : xarray.Dataset
    *names : str
    exact : bool
        Whether to leave out values from polynomials between rows, for quantities that hardly change.
    """
    curves = [None if exact and not _is_from_repeated_steps(run) else refined_line(run, name) for name in names]
    available = [curve for curve in curves if curve is not None]
    if len(available) < len(curves):
        times, values = run.variables["time"].values, [run.variables[name].values for name in names]
    else:
        times, values = available[0][0], [curve[1] for curve in available]
    if times.size <= DRAWN:
        return times, values
    rows = np.unique(np.concatenate([thinned_rows(curve, times=times) for curve in values]))
    if "event_time" in run.variables and run.sizes["event"] <= DRAWN:  # no line passes by a state at an event
        rows = np.union1d(rows, np.flatnonzero(np.isin(times, run.variables["event_time"].values)))
    return times[rows], [curve[rows] for curve in values]


def has_chords(run: xr.Dataset, *names: str, exact: bool = False) -> bool:
    """Whether lines go straight from row to row across steps that are long in a picture."""
    is_straight = (exact and not _is_from_repeated_steps(run)) or any(refined_line(run, name) is None for name in names)
    return is_straight and _inner_times(run)[0].size > 0


def refined_line(run: xr.Dataset, name: str) -> tuple[Floats, Floats] | None:
    """Return times and values of a line through all rows and through states inside long steps.

    States come from the run's own method, by repeating its steps up to those times; quantities computed from states are
    evaluated on them. Where the record does not suffice, states lie on Hermite polynomials through the values recorded at
    both ends of a step. None if neither is available, or there are so many rows that straight lines are as good.
    """
    if name not in run.variables or run.variables[name].dims != (STEPS,):
        return None
    if run.variables[name].attrs.get("role") == HELD:
        return stairs(run.variables["time"].values, run.variables[name].values)
    if is_mean(run, name):
        return means(*(run.variables[word].values for word in ("time", "step_size", name)))
    inner = inner_states(run)
    if inner is None:
        return None
    values = inner.states.get(name)
    if values is None:
        if name not in inner.computed:
            inner.computed[name] = _evaluate_quantity(run, name, inner)
        values = inner.computed[name]
    if values is None:
        return None
    if not inner.merged_orders:
        # a half puts a state inside a step between its two rows, also where events repeat a time
        order = np.argsort(np.concatenate([np.arange(run.sizes[STEPS]), inner.rows + 0.5]), kind="stable")
        inner.merged_orders.append((order, np.concatenate([run.variables["time"].values, inner.times])[order]))
    ((order, times),) = inner.merged_orders
    line = np.concatenate([run.variables[name].values, values])[order]
    if not np.isfinite(values).all():  # a step's equations could not be solved again
        is_lost = ~np.isfinite(line) & np.concatenate([np.zeros(run.sizes[STEPS], bool), ~np.isfinite(values)])[order]
        line[is_lost] = np.interp(times[is_lost], times[~is_lost], line[~is_lost])
    return times, line


def line_times(run: xr.Dataset) -> Floats:
    """Return the times of rows and of points inside long steps."""
    times: Floats = np.union1d(run.variables["time"].values, _inner_times(run)[0])
    return times


_KNOWN: dict[int, tuple[weakref.ref[xr.Dataset], InnerStates | None]] = {}  # of records that are being drawn


def inner_states(run: xr.Dataset) -> InnerStates | None:
    """Return the states inside steps, computed once per record; None if rows are many, or some were left out."""
    cached_states = _KNOWN.get(id(run))
    # another record may have got the id of one that is gone, which the weak reference tells
    if cached_states is None or cached_states[0]() is not run:
        key = id(run)
        cached_states = _KNOWN[key] = weakref.ref(run, partial(_KNOWN.pop, key)), _inner_points(run)
    return cached_states[1]


def _is_from_repeated_steps(run: xr.Dataset) -> bool:
    inner = inner_states(run)
    return inner is not None and inner.is_repeated


def _inner_points(run: xr.Dataset) -> InnerStates | None:
    times, rows = _inner_times(run)
    if not times.size or has_missing_rows(run):
        return None
    if (states := _repeat_steps(run, times, rows)) is not None:
        return InnerStates(times, rows, states, is_repeated=True)
    state_names = [name for name in with_role(run, *INTEGRATED) if run.variables[name].dims == (STEPS,)]
    model, work = known_model(run), _numbers_per_energy(run) * run.sizes[STEPS]
    derived = {} if model is None or work > RATES_WORK else state_derivatives(run, model)
    column_names = {*map(str, run.variables), *derived}
    chained = dict.fromkeys(name for name in state_names if derivative_chain(column_names, name))
    available = StatePolynomials(run, times, rows, chained, derived)
    return InnerStates(times, rows, available, is_repeated=False) if available else None


def _inner_times(run: xr.Dataset) -> tuple[Floats, Rows]:
    """Distribute points over steps: an equal number for each while rows are few, or more in proportion to its duration."""
    time, n = run.variables["time"].values, run.sizes[STEPS]
    h, span = np.diff(time), float(time[-1] - time[0])
    if not span > 0.0:
        return np.zeros(0), np.zeros(0, np.int64)
    points = min(DRAWN // 2, max(n, WORK // _numbers_per_energy(run)), max(n, STATES_WORK // _numbers_per_state(run)))
    fewest = min(points // n, MOST_BETWEEN)
    counts = np.where((h > 0.0) & follows_previous_row(run), np.maximum(fewest, h / span * points), 0.0).astype(
        np.int64
    )
    rows = np.repeat(np.arange(n - 1), counts)
    point_number = np.arange(rows.size) - (np.cumsum(counts) - counts)[rows] + 1
    times = time[rows] + h[rows] * (point_number / (counts[rows] + 1))
    is_in_step = (times > time[rows]) & (times < time[rows + 1])  # a step of a few spacings of t has no room
    return times[is_in_step], rows[is_in_step]


def _numbers_per_energy(run: xr.Dataset) -> int:
    """Count the numbers that an energy is made of at each state: of all links, where bodies attract each other."""
    model = known_model(run)
    return 1 if model is None or not model.shapes.dims else widest(model)


def _numbers_per_state(run: xr.Dataset) -> int:
    """Count the numbers of a state."""
    model = known_model(run)
    return 1 if model is None else max(1, len(model.elements.units))


def has_missing_rows(run: xr.Dataset) -> bool:
    """Whether rows were left out, so that the states between the remaining ones are not recorded."""
    time = run.variables["time"].values
    if "step_size" not in run.variables:
        return True
    step_mismatch = np.abs(np.diff(time) - run.variables["step_size"].values[1:])
    size = np.maximum(np.abs(time[1:]), np.abs(time[:-1]))
    return bool(((step_mismatch > slack(run) * size) & follows_previous_row(run)).any())


def follows_previous_row(run: xr.Dataset) -> NDArray[np.bool_]:
    """Whether each row but the first is the one after the row before it: of an excerpt `step` has the numbers of rows."""
    following: NDArray[np.bool_] = np.diff(run[STEPS].values) == 1
    return following


def _repeat_steps(run: xr.Dataset, times: Floats, rows: Rows) -> dict[str, Floats] | None:
    """Repeat steps, shortened to end at the times; None if the record lacks what this needs, or they miss its rows."""
    if (model := known_model(run)) is None:
        return None
    if len(model.elements.units) > (LARGEST_ENERGETIC if "total_energy" in run.variables else LARGEST):
        return None
    time, starts = run.variables["time"].values, np.unique(rows)
    # just before the next row: at its own time the recorded state is returned, which would test nothing
    ends = np.nextafter(time[starts + 1], time[starts])
    try:
        samples = sample_in_steps(
            run, np.concatenate([times, ends]), after_event=True, rule=REINTEGRATE, functions=None
        )
    except InputError:
        return None
    for name in model.elements.units:
        recorded = run.variables[name].values
        deviation = np.abs(samples.variables[name].values[times.size :] - recorded[starts + 1])
        tolerance = max(MET * np.ptp(recorded), ROUNDING * _largest_increment(run, name))
        if not np.nanmax(deviation, initial=0.0) <= tolerance:  # an edited record
            return None
    return {name: samples.variables[name].values[: times.size] for name in model.elements.units}


def _largest_increment(run: xr.Dataset, name: str) -> float:
    """Return the most that a step adds to a state by any of its recorded derivatives alone, in the state's unit."""
    h = np.diff(run.variables["time"].values).max(initial=0.0)
    derived = enumerate(derivative_chain({*map(str, run.variables)}, name)[1:], start=1)
    return max((float(np.abs(run.variables[derivative].values).max() * h**k) for k, derivative in derived), default=0.0)


def _evaluate_quantity(run: xr.Dataset, name: str, inner: InnerStates) -> Floats | None:
    """Evaluate a quantity that is computed from states; None if it disagrees with the recorded rows."""
    model, columns, attributes = known_model(run), run.variables, run.variables[name].attrs
    if model is None or attributes.get("role") not in EVALUATED or not {*model.elements.units} <= {*inner.states}:
        return None
    try:
        units = float(parse_unit(str(attributes["units"])).factor)
    except InputError:  # a variable with an unreadable unit is drawn as recorded
        return None
    starts = np.unique(inner.rows)
    recorded, states = (
        columns[name].values[starts],
        {state: columns[state].values[starts] for state in model.elements.units},
    )
    try:
        evaluated = evaluate_quantity(run, model, name, states, columns["time"].values[starts], starts) / units
        values = evaluate_quantity(run, model, name, inner.states, inner.times, inner.rows) / units
    except (InputError, KeyError):
        return None
    # rows where something jumps have the value of either side: if most rows disagree, something else was recorded
    deviates = np.abs(evaluated - recorded) > AGREED * np.abs(recorded).max()
    return None if np.mean(deviates | np.isnan(evaluated)) > 0.5 else values


def energy_changes(run: xr.Dataset) -> dict[str, float] | None:
    """Return the largest changes of the total energy by forces, by events and by the method's error, in its unit.

    Forces: the integral of the rate from the model's own equations; events: the changes at their instants; the method: the
    rest. None without a model, or with too few rows.
    """
    if ENERGY_CHANGES in run.encoding:
        recorded_changes: dict[str, float] | None = run.encoding[ENERGY_CHANGES]
        return recorded_changes
    inner, model = inner_states(run), known_model(run)
    if model is None or has_chords(run, "total_energy") or not {*model.elements.units} <= set(run.variables):
        return None
    if inner is not None and not {*model.elements.units} <= {*inner.states}:
        return None
    accumulated = EnergyAccumulator(model)
    return accumulated.largest_changes if accumulated.add_rows(run, inner) else None


@dataclass
class EnergyAccumulator:
    """Changes of the total energy along a run, whose rows are added in order.

    Attributes
    ----------
    model : Model
    last : tuple of float
        Work of the forces and changes at instants, up to the last row.
    minima, maxima : ndarray, shape (3,)
        Of the work, of the changes at instants, and of the rest.
    """

    model: Model
    last: tuple[float, float] = (0.0, 0.0)
    minima: Floats = field(default_factory=lambda: np.full(3, np.inf))
    maxima: Floats = field(default_factory=lambda: np.full(3, -np.inf))

    @property
    def largest_changes(self) -> dict[str, float]:
        """The largest change by each cause."""
        return dict(zip(("forces", "events", "the method's error"), self.maxima - self.minima, strict=True))

    def add_rows(self, run: xr.Dataset, inner: InnerStates | None = None) -> bool:
        """Add rows, the first of which is the last of those before; return whether their rates could be evaluated."""
        model = self.model
        time, energy = run.variables["time"].values, run.variables["total_energy"].values
        rows = np.arange(run.sizes[STEPS])
        points_in_steps = (
            inner if inner is not None else InnerStates(np.zeros(0), np.zeros(0, np.int64), {}, is_repeated=True)
        )
        order = np.argsort(np.concatenate([rows, points_in_steps.rows + 0.5]), kind="stable")
        times, all_rows = (
            np.concatenate([time, points_in_steps.times])[order],
            np.concatenate([rows, points_in_steps.rows])[order],
        )
        states = {
            state: np.concatenate([run.variables[state].values, points_in_steps.states.get(state, time[:0])])[order]
            for state in model.elements.units
        }
        try:
            rates = rate_on(run, model, "total_energy", states, times, all_rows)
        except (InputError, KeyError):
            return False
        rates = rates / float(parse_unit(str(run.variables["total_energy"].attrs["units"])).factor)
        gained = np.concatenate([[0.0], np.cumsum((rates[1:] + rates[:-1]) / 2.0 * np.diff(times))])[order < rows.size]
        work = self.last[0] + gained
        jumps = self.last[1] + np.concatenate([[0.0], np.cumsum(np.where(np.diff(time) > 0.0, 0.0, np.diff(energy)))])
        causes = np.stack([work, jumps, energy - work - jumps])
        self.minima, self.maxima = np.minimum(self.minima, causes.min(1)), np.maximum(self.maxima, causes.max(1))
        self.last = float(work[-1]), float(jumps[-1])
        return True

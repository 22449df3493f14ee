"""Drift of conserved quantities, residuals against closed forms, and the time up to which a run is credible.

Quantities that may be conserved are energies, observables and momenta; their ranges and drifts are computed.

A run is credible until a run of tighter tolerance leaves its neighbourhood.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.dynamics.shortened_steps import sample_in_steps
from xdynamics.elementary.arrays import flattened_rows, integral
from xdynamics.evidence.chunks import Chunks, Unread, with_roles
from xdynamics.evidence.companion import Companion, global_error
from xdynamics.evidence.diagnosing.cycles import Cycles
from xdynamics.evidence.evidence_dataset import attrs_of, scale_of, scaled_variables
from xdynamics.evidence.observables import evaluate_at_states, evaluate_quantity, is_comparable, momenta_on
from xdynamics.expressions import Binary, Name, Node, dimension_of, free_names, parse
from xdynamics.faults import InputError, Ledger
from xdynamics.kernels.layout import layout_of
from xdynamics.methods.scheme import REINTEGRATE
from xdynamics.model import Model
from xdynamics.model.motion import constants, drive_pieces, evaluate_over_states
from xdynamics.record.flag_words import time_unit_of
from xdynamics.record.folding import model_dimensions, quantity_names
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.schema import STEPS
from xdynamics.shapes.trees import at_element, dims_of, resolve_min_max
from xdynamics.units import parse_unit, spell

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]
Functions = Mapping[str, Callable[..., float]]

ROLE = "diagnostic"
MOST_NUMBERS = 1 << 22  # of momenta that are computed at once
MEANT = 512  # of a cycle, from which a mean is computed, in addition to accepted states
BANDED = ("energy", "observable")  # roles of quantities that may be conserved


def bands(rows: Chunks) -> Iterator[tuple[str, Any]]:
    """Yield the range of quantities that may be conserved."""
    for name, (low, high) in spans(rows, with_roles(rows.run, BANDED)).items():
        units = str(rows.run.variables[name].attrs["units"])
        dims = rows.run.variables[name].dims[1:]
        yield (
            _band_name(name),
            (dims, high - low + 0.0, attrs_of(units, f"largest minus smallest {name} over the accepted states", ROLE)),
        )


def spans(rows: Chunks, names: Sequence[str]) -> dict[str, tuple[Floats, Floats]]:
    """Return the least and the greatest number of columns, of each element of a quantity its own."""
    spans = {name: (np.full(rows.run.variables[name].shape[1:], np.nan),) * 2 for name in names}
    for part in rows.parts(*names) if names else ():
        spans = {name: _wider(span, part.own_rows(name)) for name, span in spans.items()}
    return spans


def _wider(span: tuple[Floats, Floats], values: Floats) -> tuple[Floats, Floats]:
    """Return the least and the greatest number of a span and further rows; nan is ignored."""
    low, high = span
    return np.fmin(low, np.fmin.reduce(values)), np.fmax(high, np.fmax.reduce(values))


def _band_name(name: str) -> str:
    return "energy_band" if name == "total_energy" else f"band_{name}"


@dataclass(frozen=True)
class _ConservedQuantity:
    """A quantity that may be conserved.

    Attributes
    ----------
    name : str
        Of its column; empty if it has none.
    tree : Node, optional
        Of one without a column, by which it is computed from states.
    is_computed : bool
        Whether it is known at states between rows.
    factor : float
        Of its column's unit.
    dims, shape : tuple of str, tuple of int
        Of a quantity with dimensions.
    momentum_of : str
        The coordinate with dimensions whose momentum it is.
    """

    name: str
    tree: Node | None = None
    is_computed: bool = True
    factor: float = 1.0
    dims: tuple[str, ...] = ()
    shape: tuple[int, ...] = ()
    momentum_of: str = ""

    def on(self, run: xr.Dataset, model: Model, rows: Rows) -> Floats:
        """Return the quantity in rows of a record in memory, in SI units: shape (..., k), its elements first."""
        if self.name:
            recorded = np.asarray(run.variables[self.name])[rows] * self.factor
            element_rows: Floats = recorded if recorded.ndim == 1 else flattened_rows(recorded).T
            return element_rows
        states = {name: run.variables[name].values[rows] for name in self.state_names(run, model)}
        return self.at_states(run, model, states, run.variables["time"].values[rows], rows)

    def at_states(
        self, run: xr.Dataset, model: Model, states: Mapping[str, Floats], times: Floats, rows: Rows
    ) -> Floats:
        """Return the quantity at states inside steps, in SI units: shape (..., k)."""
        if self.momentum_of:
            return momenta_on(run, model, self.momentum_of, states, times, rows)
        if self.tree is None:
            return evaluate_quantity(run, model, self.name, states, times, rows)
        return evaluate_at_states(run, model, [self.tree], states, times, rows)[0]

    def state_names(self, run: xr.Dataset, model: Model) -> list[str]:
        """Return the coordinates, velocities and states that its tree reads: of a momentum a few, of others maybe all."""
        elements = model.elements
        if model_dimensions(run):
            return [block.name for block in layout_of(model).used.blocks]
        read = elements.units if self.tree is None else elements.reads(self.tree)
        return [name for name in read if name in elements.units]

    def span(self, rows: Chunks) -> tuple[Floats, Floats]:
        """Return its least and its greatest value in all rows."""
        value_range = (np.full(self.shape, np.nan),) * 2
        batch_size = max(1, MOST_NUMBERS // max(1, prod(self.shape)))
        for run, stretch_rows in rows.stretches():
            for begin in range(0, stretch_rows.size, batch_size):
                value_range = _wider(
                    value_range,
                    self.on(run, rows.model, stretch_rows[begin : begin + batch_size]).T.reshape(-1, *self.shape),
                )
        return value_range


def conservation_variables(
    rows: Chunks, coordinate_cycles: Cycles | None, functions: Functions | None
) -> Iterator[tuple[str, Any]]:
    """Yield the drift of quantities that may be conserved, and ranges and drifts of momenta."""
    run, model, cycles = rows.run, rows.model, list[_Cycle]()
    if coordinate_cycles is not None and len(coordinate_cycles.times) >= 3 and not isinstance(rows, Unread):
        times = coordinate_cycles.times.tolist()
        cycles = [_Cycle(rows, begin, end, functions) for begin, end in (times[:2], times[-2:])]
    for name in with_roles(run, BANDED):
        variable = run.variables[name]
        units = parse_unit(str(variable.attrs["units"]))
        factor, is_known = float(units.factor), is_comparable(model, name)
        dims = tuple(map(str, variable.dims[1:]))
        watched = _ConservedQuantity(name, is_computed=is_known, factor=factor, dims=dims, shape=variable.shape[1:])
        drift, rule = _drift_and_rule(rows, watched, cycles)
        key = "energy_drift" if name == "total_energy" else f"drift_{name}"
        yield key, (watched.dims, drift / factor, attrs_of(units.text, f"drift of {name}: {rule}", ROLE))
    if model.python_functions:
        return
    for name, mass, momentum in _dimensional_momenta(model) if model_dimensions(run) else _scalar_momenta(model):
        low, high = momentum.span(rows)
        units = spell(dimension_of(mass, model.elements.dimensions) * model.elements.dimensions[schema.velocity(name)])
        drift, rule = _drift_and_rule(rows, momentum, cycles)
        momentum_name = momentum.momentum_of or name
        band_text = f"largest minus smallest momentum (M v) of {momentum_name} over the accepted states"
        yield (
            f"band_momentum_{momentum_name}",
            (momentum.dims, high - low + 0.0, attrs_of(units.text, band_text, ROLE)),
        )
        yield (
            f"drift_momentum_{momentum_name}",
            (
                momentum.dims,
                drift,
                attrs_of(units.text, f"drift of the momentum (M v) of {momentum_name}: {rule}", ROLE),
            ),
        )


def _scalar_momenta(model: Model) -> Iterator[tuple[str, Node, _ConservedQuantity]]:
    """Yield each coordinate, its mass, and its momentum."""
    elements = model.elements
    coordinates = list(elements.statement.coordinates)
    entries = {entry_index: elements.expanded(entry) for entry_index, entry in elements.statement.mass_entries.items()}
    for i, name in enumerate(coordinates):
        terms: list[Node] = [
            Binary("*", mass, Name(schema.velocity(coordinates[j]))) for (k, j), mass in entries.items() if k == i
        ]
        yield name, entries[i, i], _ConservedQuantity("", reduce(lambda left, right: Binary("+", left, right), terms))


def _dimensional_momenta(model: Model) -> Iterator[tuple[str, Node, _ConservedQuantity]]:
    """Yield for each coordinate with dimensions its first element, that element's mass, and all momenta."""
    for number, name in enumerate(model.statement.coordinates):
        block = layout_of(model).used.block(name)
        first_index = next(iter(model.shapes.index_combinations(block.dims)))
        mass = at_element(model.expanded(model.statement.mass[number][number]), first_index, model.shapes)
        yield block.first, mass, _ConservedQuantity("", dims=block.dims, shape=block.shape, momentum_of=name)


def _drift_and_rule(rows: Chunks, watched: _ConservedQuantity, cycles: Sequence[_Cycle]) -> tuple[Floats, str]:
    """Return the drift of a quantity, averaged over a cycle where there are cycles, and its rule in words."""
    if isinstance(rows, Unread):
        unknown = np.full(watched.shape, np.nan)
        return (
            unknown,
            "mean over the last cycle minus mean over the first; without cycles, value at the end minus value at the start",
        )
    if cycles:
        first, last = (cycle.mean(watched) for cycle in cycles)
        rule = "mean over the last cycle minus mean over the first"
    else:
        run, ends = rows.nearby_record([0, rows.size - 1])
        first, last = np.moveaxis(watched.on(run, rows.model, ends), -1, 0)
        rule = "value at the end minus value at the start"
    return np.reshape(last - first, watched.shape), rule


class _Cycle:
    """The accepted states of a cycle, and states between them.

    Parameters
    ----------
    rows : Chunks
    begin, end : float, s
    functions : mapping, optional
    """

    def __init__(self, rows: Chunks, begin: float, end: float, functions: Functions | None) -> None:
        rows_after_begin, rows_before_end = rows.count(np.array([begin]), "right"), rows.count(np.array([end]), "left")
        self._run, _ = rows.nearby_record(np.arange(int(rows_after_begin[0]) - 1, int(rows_before_end[0]) + 1))
        self._model, self._functions = rows.model, functions
        self._time = np.asarray(self._run["time"])
        self._inner = np.flatnonzero((self._time > begin) & (self._time < end))
        self._times = np.linspace(begin, end, MEANT + 1)

    @cached_property
    def _states_between(self) -> xr.Dataset:
        """States at the times of a mean, interpolated once for all quantities."""
        return sample_in_steps(self._run, self._times, after_event=True, rule=REINTEGRATE, functions=self._functions)

    def mean(self, watched: _ConservedQuantity) -> Floats:
        """Return the mean over time, by the trapezoidal rule over accepted states and states between them."""
        run, model, time, times = self._run, self._model, self._time, self._times
        if not watched.is_computed:
            recorded = np.atleast_2d(watched.on(run, model, np.arange(time.size)))
            between = np.stack([np.interp(times, time, element_values) for element_values in recorded]).reshape(
                -1, times.size
            )
            between = between if watched.shape else between[0]
            numbers = np.searchsorted(time, times, side="right") - 1
        else:
            states = {name: self._states_between.variables[name].values for name in watched.state_names(run, model)}
            numbers = self._states_between.variables["row"].values
            between = watched.at_states(run, model, states, times, numbers)
        inner = self._inner
        # at equal times a state inside a step stands behind the row that its step starts from
        order = np.lexsort((np.concatenate([numbers + 0.5, inner]), np.concatenate([times, time[inner]])))
        values = watched.on(run, model, inner)
        t = np.concatenate([times, time[inner]])[order]
        y = np.ascontiguousarray(np.concatenate([between, values], axis=-1)[..., order])  # sums are as of one element
        mean: Floats = integral(y, t) / (times[-1] - times[0])
        return mean


def closed_form_residuals(rows: Chunks, exact: Mapping[str, str]) -> Iterator[tuple[str, Any]]:
    """Yield the residuals of a run against closed forms at its accepted states.

    Raises
    ------
    InputError
        If closed forms are not given by name, or one cannot be evaluated.
    """
    if not isinstance(exact, Mapping):
        raise InputError(f"exact is {str(exact)[:40]!r}, needs closed forms by name, like {{'x': 'A*cos(w*t)'}}")
    run = rows.run
    forms = [form for name, text in exact.items() for form in _element_closed_forms(rows, name, text)]
    for (name, text, _), computed, expected in zip(forms, *_computed_and_expected(rows, forms), strict=True):
        residual = computed - expected
        units = str(run[name].attrs["units"])
        yield f"residual_{name}", ((STEPS,), residual, attrs_of(units, f"{name} less {text}", "residual"))
        yield (
            f"largest_residual_{name}",
            ((), float(np.max(np.abs(residual))), attrs_of(units, f"largest size of residual_{name}", "residual")),
        )
        yield (
            f"rms_residual_{name}",
            (
                (),
                float(np.sqrt(np.mean(residual**2))),
                attrs_of(units, f"root of the mean square of residual_{name}", "residual"),
            ),
        )
        scale_text = f"largest size of {text} at the accepted times; where that is 0, of {name} as computed"
        scale = scale_of(expected, computed)
        yield from scaled_variables(
            "residual", name, residual, scale, (STEPS,), units, scale_text, ("largest", "rms")
        ).items()


def _element_closed_forms(rows: Chunks, name: str, text: str) -> Iterator[tuple[str, str, Node]]:
    """Yield the closed form of each element of a quantity, which is read and checked once.

    Raises
    ------
    InputError
        If there is no such quantity, or the expression cannot be read, reads anything but time and parameters, or has
        another dimension.
    """
    model, quantity_name = rows.model, rows.model.shapes.internal_name(name)
    shapes = model.shapes
    places = shapes.index_combinations(shapes.dims.get(quantity_name, ()))
    elements = [(shapes.element_at(quantity_name, element_index), element_index) for element_index in places]
    first, element_index = elements[0]
    if first not in model.elements.units or first not in rows.run.variables:
        raise InputError(f"exact names '{first}'; there are {', '.join(quantity_names(model.elements.units))}")
    ledger = Ledger(f"exact '{name}'")
    with ledger.entry(repr(text)[:60]):
        tree = resolve_min_max(parse(text), shapes)
        if further := [dim for dim in dims_of(tree, shapes) if dim not in element_index]:
            raise InputError(
                f"has the dimension '{further[0]}', which {name} does not have; reduce it, like sum(…, {further[0]})"
            )
        dimension = dimension_of(
            model.elements.expanded(at_element(tree, element_index, shapes)), model.elements.dimensions
        )
        if dimension != model.elements.units[first].dimension:
            raise InputError(f"has units '{dimension}', needs '{model.elements.units[first].text}'")
        computed = {*model.elements.units, *model.elements.drives}
        for element, element_index in elements:
            element_tree = model.elements.expanded(at_element(tree, element_index, shapes))
            if read := sorted(free_names(element_tree) & computed):
                raise InputError(f"reads '{read[0]}', which is what is computed; a closed form is of t and parameters")
            yield element, text, element_tree
    ledger.raise_faults()


def _computed_and_expected(rows: Chunks, forms: Sequence[tuple[str, str, Node]]) -> tuple[Floats, Floats]:
    """Return variables, and expressions of time and parameters in their units, at the accepted times."""
    model, trees = rows.model, [tree for _, _, tree in forms]
    units = {name: float(model.elements.units[name].factor) for name, _, _ in forms}
    drive_inputs = {
        name for argument_tree in model.elements.looked_up_at.values() for name in free_names(argument_tree)
    } & {*model.elements.units}
    computed, expected = np.zeros((2, len(forms), rows.size))
    for part in rows.parts("time", *dict.fromkeys((*units, *drive_inputs))):
        times, row_slice = part.own_rows("time"), slice(part.first, part.first + part.count)
        state = {name: part.own_rows(name) * float(model.elements.units[name].factor) for name in drive_inputs} | {
            "t": times
        }
        values = evaluate_over_states(model, trees, state, constants(model), drive_pieces(model))
        for i, ((name, _, _), value) in enumerate(zip(forms, values, strict=True)):
            computed[i, row_slice], expected[i, row_slice] = (
                part.own_rows(name),
                np.broadcast_to(value, times.shape) / units[name],
            )
    return computed, expected


BELIEVED = 0.1  # of the range of a quantity: the largest error with which it is still believed
AHEAD = 40  # rows of the companion by which its range is taken ahead: what has just begun to move has hardly any yet
LOOKED_AT = 400  # times at which a run is compared with its companion


def belief_variables(rows: Chunks, tighter: Companion) -> dict[str, Any]:
    """Return the time up to which every coordinate, velocity and state is known to a tenth of its range.

    The range is that of the companion up to there: what the run under judgement does later, well or badly, counts for
    nothing.
    """
    until = np.nan if isinstance(rows, Unread) else _believed_until(rows, tighter)
    long_name = (
        "time up to which no coordinate, velocity or state is further from the solution than a tenth of its range"
    )
    return {"believed_until": ((), until, attrs_of(time_unit_of(rows.run).text, long_name, ROLE))}


def _believed_until(rows: Chunks, tighter: Companion) -> float:
    run = rows.run
    end = min(float(rows.values_at("time", rows.size - 1)), float(tighter.run["time"][-1]))
    looked_at = _evenly_spaced_rows(lambda: _rows_off_events(rows, end))
    times = rows.values_at("time", looked_at)
    near, _ = rows.nearby_record(looked_at)
    states = tighter.with_global_errors(
        sample_in_steps(near, times, after_event=True, rule=REINTEGRATE, functions=tighter.functions)
    )
    lost = np.zeros(times.size, bool)
    names = with_roles(run, schema.INTEGRATED)
    tighter_run = tighter.holding(names)
    reached = np.searchsorted(tighter_run.variables["time"].values, times, side="right") - 1 + AHEAD
    for name in names:
        span = _range_up_to(tighter_run.variables[name].values, reached)
        far = (np.abs(np.asarray(states.variables[global_error(name)])) > BELIEVED * span) & (span > 0.0)
        lost |= flattened_rows(far).any(axis=1)
    stays = lost & np.append(lost[1:], lost[-1:])  # a single time may lie between two occurrences of the same impact
    return float(times[int(np.argmax(stays))]) if stays.any() else end


def _range_up_to(values: Floats, rows: Rows) -> Floats:
    """Return the range of a column from its first row to each of some rows, or to its last one."""
    spans = np.fmax.accumulate(values) - np.fmin.accumulate(values)
    return np.asarray(spans[np.minimum(rows, len(values) - 1)])


def _rows_off_events(rows: Chunks, end: float) -> Iterator[Rows]:
    """Yield the rows up to a time that are at no event: there two runs may be on different sides, however well they agree."""
    for part in rows.parts("time", "row_kind"):
        at_event = np.isin(part.own_rows("row_kind"), (schema.EVENT_BEFORE, schema.EVENT_AFTER))
        yield part.first + np.flatnonzero(~at_event & (part.own_rows("time") <= end))


def _evenly_spaced_rows(parts: Callable[[], Iterable[Rows]]) -> Rows:
    """Choose some of all rows, evenly by their number."""
    count = sum(part.size for part in parts())
    places, passed, chosen_rows = np.unique(np.linspace(0, count - 1, LOOKED_AT).astype(np.int64)), 0, []
    for part in parts():
        chosen_rows.append(part[places[(places >= passed) & (places < passed + part.size)] - passed])
        passed += part.size
    return np.concatenate(chosen_rows)

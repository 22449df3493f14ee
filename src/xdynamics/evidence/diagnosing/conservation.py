"""Quantities that may be conserved: the ranges of energies, observables and momenta over a run, and how they drift."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.dynamics.shortened_steps import sample_in_steps
from xdynamics.elementary.arrays import flattened_rows
from xdynamics.evidence.chunks import Chunks, Unread, with_roles
from xdynamics.evidence.diagnosing.cycles import Cycles
from xdynamics.evidence.evidence_dataset import attrs_of
from xdynamics.evidence.observables import evaluate_at_states, evaluate_quantity, is_comparable, momenta_on
from xdynamics.expressions import Binary, Name, Node, dimension_of
from xdynamics.kernels.layout import layout_of
from xdynamics.methods.scheme import REINTEGRATE
from xdynamics.model import Model
from xdynamics.model.whole import expanded_tree
from xdynamics.record.folding import model_dimensions
from xdynamics.runtime.cached_properties import cached_property
from xdynamics.shapes.trees import at_element
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
    """Return the least and the greatest number of a span and further rows; what is no number is passed over."""
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
        if model_dimensions(run):
            return [block.name for block in layout_of(model).used.blocks]
        read = model.units if self.tree is None else model.reads(self.tree)
        return [name for name in read if name in model.units]

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
        units = spell(dimension_of(mass, model.dimensions) * model.dimensions[schema.velocity(name)])
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
    coordinates = list(model.statement.coordinates)
    entries = {entry_index: model.expanded(entry) for entry_index, entry in model.statement.mass_entries.items()}
    for i, name in enumerate(coordinates):
        terms: list[Node] = [
            Binary("*", mass, Name(schema.velocity(coordinates[j]))) for (k, j), mass in entries.items() if k == i
        ]
        yield name, entries[i, i], _ConservedQuantity("", reduce(lambda left, right: Binary("+", left, right), terms))


def _dimensional_momenta(model: Model) -> Iterator[tuple[str, Node, _ConservedQuantity]]:
    """Yield for each coordinate with dimensions its first element, that element's mass, and all momenta."""
    for number, name in enumerate(model.shaped.coordinates):
        block = layout_of(model).used.block(name)
        first_index = next(iter(model.shapes.index_combinations(block.dims)))
        mass = at_element(expanded_tree(model, model.shaped.mass[number][number]), first_index, model.shapes)
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
        """States at times that a mean is taken over, found once for all quantities."""
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
        order = np.lexsort((np.concatenate([numbers + 0.5, inner]), np.concatenate([times, time[inner]])))
        values = watched.on(run, model, inner)
        t = np.concatenate([times, time[inner]])[order]
        y = np.ascontiguousarray(np.concatenate([between, values], axis=-1)[..., order])  # sums are as of one element
        mean: Floats = np.trapezoid(y, t) / (times[-1] - times[0])
        return mean

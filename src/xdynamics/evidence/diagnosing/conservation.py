"""Quantities that may be conserved: the ranges of energies, observables and momenta over a run, and how they drift."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.dynamics.shortened_steps import sampled
from xdynamics.evidence.chunks import Chunks, Unread, with_roles
from xdynamics.evidence.diagnosing.cycles import Cycles
from xdynamics.evidence.evidence_dataset import about
from xdynamics.evidence.observables import comparable, evaluated_on, evaluated_whole
from xdynamics.expressions import Binary, Name, Node, dimension_of
from xdynamics.methods.scheme import REINTEGRATE
from xdynamics.model import Model
from xdynamics.runtime.cached_properties import cached_property
from xdynamics.units import parse_unit, spell

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]
Functions = Mapping[str, Callable[..., float]]

ROLE = "diagnostic"
MEANT = 512  # of a cycle, from which a mean is computed, in addition to accepted states
BANDED = ("energy", "observable")  # roles of quantities that may be conserved


def bands(rows: Chunks) -> Iterator[tuple[str, Any]]:
    """Yield the range of quantities that may be conserved."""
    for name, (low, high) in spans(rows, with_roles(rows.run, BANDED)).items():
        units = str(rows.run.variables[name].attrs["units"])
        yield (
            _band(name),
            ((), high - low + 0.0, about(units, f"largest less least {name} of the accepted states", ROLE)),
        )


def spans(rows: Chunks, names: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Return the least and the greatest number of columns."""
    spans = dict.fromkeys(names, (np.nan, np.nan))
    for part in rows.parts(*names) if names else ():
        spans = {name: _span([np.array(span), part.own(name)]) for name, span in spans.items()}
    return spans


def _span(parts: Iterable[Floats]) -> tuple[float, float]:
    """Return the least and the greatest number; what is no number is passed over."""
    low = high = np.nan
    for values in parts:
        low, high = np.fmin(low, np.fmin.reduce(values)), np.fmax(high, np.fmax.reduce(values))
    return float(low), float(high)


def _band(name: str) -> str:
    return "energy_band" if name == "total_energy" else f"band_{name}"


@dataclass(frozen=True)
class _Watched:
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
    """

    name: str
    tree: Node | None = None
    is_computed: bool = True
    factor: float = 1.0

    def on(self, run: xr.Dataset, model: Model, rows: Rows) -> Floats:
        """Return the quantity in rows of a record in memory, in SI units."""
        if self.name:
            recorded: Floats = np.asarray(run.variables[self.name])[rows] * self.factor
            return recorded
        states = {name: run.variables[name].values[rows] for name in self.read(model)}
        return self.at_states(run, model, states, run.variables["time"].values[rows], rows)

    def at_states(
        self, run: xr.Dataset, model: Model, states: Mapping[str, Floats], times: Floats, rows: Rows
    ) -> Floats:
        """Return the quantity at states inside steps, in SI units."""
        if self.tree is None:
            return evaluated_whole(run, model, self.name, states, times, rows)
        return evaluated_on(run, model, [self.tree], states, times, rows)[0]

    def read(self, model: Model) -> list[str]:
        """Return the coordinates, velocities and states that its tree reads: of a momentum a few, of others maybe all."""
        read = model.units if self.tree is None else model.reads(self.tree)
        return [name for name in read if name in model.units]


def conserved(rows: Chunks, counted: Cycles | None, functions: Functions | None) -> Iterator[tuple[str, Any]]:
    """Yield the drift of quantities that may be conserved, and ranges and drifts of momenta."""
    run, model = rows.run, rows.model
    observables, cycles = comparable(model), list[_Cycle]()
    if counted is not None and len(counted.times) >= 3 and not isinstance(rows, Unread):
        times = counted.times.tolist()
        cycles = [_Cycle(rows, begin, end, functions) for begin, end in (times[:2], times[-2:])]
    for name in with_roles(run, BANDED):
        units = parse_unit(str(run.variables[name].attrs["units"]))
        watched = _Watched(name, is_computed=name in observables, factor=float(units.factor))
        drift, rule = _drift(rows, watched, cycles)
        key = "energy_drift" if name == "total_energy" else f"drift_{name}"
        yield key, ((), drift / float(units.factor), about(units.text, f"{name}: {rule}", ROLE))
    coordinates = list(model.coordinates)
    if not coordinates or model.python_functions:
        return
    entries = {place: model.expanded(entry) for place, entry in model.statement.mass_entries.items()}
    for i, name in enumerate(coordinates):
        terms: list[Node] = [
            Binary("*", mass, Name(schema.velocity(coordinates[j]))) for (k, j), mass in entries.items() if k == i
        ]
        momentum = _Watched("", reduce(lambda left, right: Binary("+", left, right), terms))
        low, high = _span(momentum.on(stretch, model, here) for stretch, here in rows.stretches())
        mass = dimension_of(model.expanded(model.statement.mass_entries[i, i]), model.dimensions)
        units = spell(mass * model.dimensions[schema.velocity(name)])
        drift, rule = _drift(rows, momentum, cycles)
        yield (
            f"band_momentum_{name}",
            ((), high - low + 0.0, about(units.text, f"largest less least momentum of {name}, (M v)", ROLE)),
        )
        yield f"drift_momentum_{name}", ((), drift, about(units.text, f"momentum of {name}: {rule}", ROLE))


def _drift(rows: Chunks, watched: _Watched, cycles: Sequence[_Cycle]) -> tuple[float, str]:
    """Return the drift of a quantity, averaged over a cycle where there are cycles, and its rule in words."""
    if isinstance(rows, Unread):
        return np.nan, "mean over the last cycle less that over the first; without cycles, at the end less at the start"
    if not cycles:
        run, ends = rows.near([0, rows.size - 1])
        first, last = watched.on(run, rows.model, ends)
        return float(last - first), "at the end less at the start"
    first, last = (cycle.mean(watched) for cycle in cycles)
    return last - first, "mean over the last cycle less that over the first"


class _Cycle:
    """The accepted states of a cycle, and states between them.

    Parameters
    ----------
    rows : Chunks
    begin, end : float, s
    functions : mapping, optional
    """

    def __init__(self, rows: Chunks, begin: float, end: float, functions: Functions | None) -> None:
        after, before = rows.count(np.array([begin]), "right"), rows.count(np.array([end]), "left")
        self._run, _ = rows.near(np.arange(int(after[0]) - 1, int(before[0]) + 1))
        self._model, self._functions = rows.model, functions
        self._time = np.asarray(self._run["time"])
        self._inner = np.flatnonzero((self._time > begin) & (self._time < end))
        self._times = np.linspace(begin, end, MEANT + 1)

    @cached_property
    def _between(self) -> xr.Dataset:
        """States at times that a mean is taken over, found once for all quantities."""
        return sampled(self._run, self._times, after=True, rule=REINTEGRATE, functions=self._functions)

    def mean(self, watched: _Watched) -> float:
        """Return the mean over time, by the trapezoidal rule over accepted states and states between them."""
        run, model, time, times = self._run, self._model, self._time, self._times
        if not watched.is_computed:
            between = np.interp(times, time, watched.on(run, model, np.arange(time.size)))
            numbers = np.searchsorted(time, times, side="right") - 1
        else:
            states = {name: self._between.variables[name].values for name in watched.read(model)}
            numbers = self._between.variables["row"].values
            between = watched.at_states(run, model, states, times, numbers)
        inner = self._inner
        order = np.lexsort((np.concatenate([numbers + 0.5, inner]), np.concatenate([times, time[inner]])))
        values = watched.on(run, model, inner)
        t, y = (np.concatenate(pair)[order] for pair in ((times, time[inner]), (between, values)))
        return float(np.trapezoid(y, t) / (times[-1] - times[0]))

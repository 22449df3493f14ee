"""States between the rows of a record, on Hermite polynomials through what is recorded at both ends of a step."""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Container, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.evidence.observables import state_rates
from xdynamics.model import Model
from xdynamics.runtime.cached_properties import cached_property
from xdynamics.schema import STEPS, acceleration, rate, velocity
from xdynamics.shapes import split_element_name

if TYPE_CHECKING:
    import xarray as xr

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
    names = {velocity(name): acceleration(name) for name in model.statement.coordinates} | {
        name: rate(name) for name in model.statement.states
    }
    columns = {*run.variables}
    if not {*model.units} <= columns or {*names.values()} <= columns:
        return {}
    states = {name: run.variables[name].values for name in model.units}
    rows = np.arange(run.sizes[STEPS])
    rates = state_rates(run, model, states, run.variables["time"].values, rows) or {}
    by_element = {
        name: numbers
        for quantity, element_rates in rates.items()
        for name, numbers in zip(model.shapes.elements(quantity), element_rates, strict=True)
    }
    return {
        names[name]: numbers / float(model.units[name].factor) for name, numbers in by_element.items() if name in names
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

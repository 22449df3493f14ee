"""Quantities at states inside steps, each at its own, with their rates and what interpolation may have them off."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.evidence.observables import evaluate_at_states, rate_tree, tree_of
from xdynamics.expressions import Node
from xdynamics.model import Model
from xdynamics.model.mass import Assignment
from xdynamics.model.motion import assignments_read

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]


@dataclass(frozen=True)
class StatesInside:
    """States inside steps, of several quantities one after the other.

    Attributes
    ----------
    variables, errors : mapping of str to ndarray, shape (k,)
        What steps integrate, and its error by interpolation, in recorded units.
    times : ndarray, shape (k,), s
    rows : ndarray of int, shape (k,)
        From which each step starts.
    parts : list of slice
        Of each quantity.
    """

    variables: Mapping[str, Floats]
    errors: Mapping[str, Floats]
    times: Floats
    rows: Rows
    parts: list[slice]

    @classmethod
    def from_dataset(cls, model: Model, states: xr.Dataset, sizes: Sequence[int]) -> StatesInside:
        """Take what was interpolated or marched, so many states for each quantity."""
        variables = {name: variable_numbers(states, name) for name in model.units}
        errors = {name: variable_numbers(states, schema.error(name)) for name in model.units}
        return cls(
            variables,
            errors,
            variable_numbers(states, schema.AT_TIME),
            variable_numbers(states, "row"),
            consecutive_slices(sizes),
        )

    def shifted_by_error(self, name: str) -> Mapping[str, Floats]:
        """Return the variables with one of them off by its error."""
        return {**self.variables, name: self.variables[name] + self.errors[name]}


def consecutive_slices(sizes: Sequence[int]) -> list[slice]:
    """Return where each of some pieces of these sizes is, one after the other."""
    ends = np.cumsum([0, *sizes]).tolist()
    return [slice(*pair) for pair in pairwise(ends)]


@dataclass
class QuantitiesInside:
    """Recorded quantities on states inside steps: what several of them read is evaluated once.

    Attributes
    ----------
    run : xarray.Dataset
    model : Model
    names : list of str
    factors : list of float
        SI units in the unit of each.
    """

    run: xr.Dataset
    model: Model
    names: list[str]
    factors: list[float]
    _read: dict[tuple[int, ...], list[Assignment]] = field(default_factory=dict)  # by an expression list and its places

    @cached_property
    def _value_trees(self) -> list[Node | None]:
        return [None if name in self.model.units else tree_of(self.model, name) for name in self.names]

    @cached_property
    def _rate_trees(self) -> list[Node | None]:
        return [rate_tree(self.model, name) for name in self.names]

    def values(self, states: StatesInside, variables: Mapping[str, Floats]) -> list[Floats]:
        """Return each quantity on its part of the states, for these variables."""
        tree_values = self._tree_values(self._value_trees, states, variables)
        return [
            variables[name][part] if value is None else value
            for name, value, part in zip(self.names, tree_values, states.parts, strict=True)
        ]

    def rates(self, states: StatesInside, values: Sequence[Floats]) -> list[Floats]:
        """Return the rate of each; its own value where none is known."""
        rate_values = self._tree_values(self._rate_trees, states, states.variables)
        return [value if rate is None else rate for value, rate in zip(values, rate_values, strict=True)]

    def errors(self, states: StatesInside, values: Sequence[Floats]) -> list[Floats]:
        """Return how far the errors of the variables move each."""
        totals = [np.zeros(value.shape) for value in values]
        computed = [name for name in self.names if name not in self.model.units]
        for variable in (name for name in self.model.units if computed and states.errors[name].any()):
            shifted_values = self.values(states, states.shifted_by_error(variable))
            totals = [
                total + np.abs(off - value) for total, off, value in zip(totals, shifted_values, values, strict=True)
            ]
        return [
            np.abs(states.errors[name][part]) if name in self.model.units else total
            for name, total, part in zip(self.names, totals, states.parts, strict=True)
        ]

    def _tree_values(
        self, trees: list[Node | None], states: StatesInside, variables: Mapping[str, Floats]
    ) -> list[Floats | None]:
        """Evaluate each expression on its part, if it has any states; None where there is no expression."""
        results: list[Floats | None] = [None if tree is None else np.zeros(0) for tree in trees]
        present_trees = [
            (k, tree, part)
            for k, (tree, part) in enumerate(zip(trees, states.parts, strict=True))
            if tree is not None and part.start < part.stop
        ]
        if not present_trees:
            return results
        places, selected_trees, parts = zip(*present_trees, strict=True)
        key = (id(trees), *places)
        if key not in self._read:
            self._read[key] = assignments_read(self.model, selected_trees)
        read = self._read[key]
        tree_values = evaluate_at_states(
            self.run, self.model, selected_trees, variables, states.times, states.rows, parts, read
        )
        for k, value in zip(places, tree_values, strict=True):
            results[k] = value / self.factors[k]
        return results


def variable_numbers(states: xr.Dataset, name: str) -> Any:
    """Return a variable's numbers: a DataArray made of it first takes many times as long."""
    return np.asarray(states.variables[name].values)

"""Energies and observables of models with dimensions, evaluated for all elements of a quantity at once.

Each element has the bits of its own evaluation.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from math import prod

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary import NAME
from xdynamics.expressions import Compare, Node, free_names
from xdynamics.expressions.calculus import ZERO
from xdynamics.expressions.tree import every
from xdynamics.faults import InputError
from xdynamics.kernels.layout import layout_of
from xdynamics.kernels.newton_matrix import column_groups
from xdynamics.model import Model
from xdynamics.model.constraints import Assignment
from xdynamics.model.elementwise import in_si
from xdynamics.model.motion import constants, has_diagonal_mass, motion, moves_by_quantities, rates_of_quantities
from xdynamics.model.regimes import REGIME_NUMBER
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.schema import AT, acceleration, rate, velocity
from xdynamics.shapes import Extent, Shapes
from xdynamics.shapes.blocks import Block, Blocks
from xdynamics.shapes.dependence import Dependence
from xdynamics.shapes.evaluation import evaluate_elements
from xdynamics.shapes.gradient import gradient
from xdynamics.shapes.naming import split_element_name

Floats = NDArray[np.float64]

LARGEST = 200_000  # numbers of an array, of all states that are evaluated at once
KINKED = frozenset(("abs", "sign", "min", "max", "where", "floor", "ceil", "round", "mod"))


@dataclass(frozen=True)
class ObservedQuantities:
    """Elements of quantities that are computed from states, at many states.

    Attributes
    ----------
    model : Model
    names : sequence of str
        Of the elements, or of quantities for all of theirs.
    values : mapping of str to ndarray
        What their expressions read besides the state, by the names of quantities: numbers, or along dimensions.
    count : int
        How many states there are.
    """

    model: Model
    names: Sequence[str]
    values: Mapping[str, Floats | float]
    count: int

    @classmethod
    def of(
        cls, model: Model, names: Sequence[str], times: Floats, regimes: Floats, math_functions: str
    ) -> ObservedQuantities | None:
        """Return an evaluator of some elements' quantities; None where elements are to be evaluated singly.

        That is so without dimensions, where expressions read what is not known of the state alone (drives, forces, contacts,
        delayed values), and with elementary functions of older records.
        """
        if not has_diagonal_mass(model) or not model.shapes.dims or model.delays or math_functions != NAME:
            return None
        wholes = layout_of(model).derived_quantities
        if not all(split_element_name(name)[0] in wholes for name in names):
            return None
        trees = [
            wholes[quantity_name][1] for quantity_name in dict.fromkeys(split_element_name(name)[0] for name in names)
        ]
        parameter_values = parameters_read_by(model, trees)
        return (
            None
            if parameter_values is None
            else cls(model, names, {**parameter_values, "t": times, REGIME_NUMBER: regimes}, len(times))
        )

    def of_states(self, states: Mapping[str, Floats]) -> Floats:
        """Evaluate the elements at states in recorded units: shape (numbers, k), SI."""
        return np.concatenate(
            [
                batch.requested_numbers(batch.evaluate_trees(self._quantity_trees, batch.gather_states(states, part)))
                for part, batch in self._state_batches()
            ],
            axis=1,
        )

    def of_trees(self, trees: Mapping[str, Node], states: Mapping[str, Floats]) -> dict[str, Floats]:
        """Evaluate expressions that read no more than the elements do, at states in recorded units: shape (numbers, k), SI.

        Each has the dimensions of the quantity whose name it has.
        """
        batch_values = [
            batch.evaluate_trees(trees, batch.gather_states(states, part)) for part, batch in self._state_batches()
        ]
        return {name: np.concatenate([values[name] for values in batch_values], axis=1) for name in trees}

    def with_errors(self, states: Mapping[str, Floats], errors: Mapping[str, Floats]) -> tuple[Floats, Floats]:
        """Evaluate the elements, and how much the error of each number of the state moves them, added up.

        Of a quantity without dimensions that is its slope halfway times the error: it reads all numbers, each of which would
        be an evaluation of its own. Of others, numbers on which no two of its elements depend together are moved at once.

        Parameters
        ----------
        states, errors : mapping of str to ndarray, shape (k, ...)
            By the names of quantities of the state, or of their elements, in recorded units.

        Returns
        -------
        values, errors : ndarray, shape (numbers, k), SI
        """
        batch_results = [
            batch.error_displacements(batch.gather_states(states, part), batch.gather_states(errors, part))
            for part, batch in self._state_batches()
        ]
        values, displacements = (np.concatenate(part, axis=1) for part in zip(*batch_results, strict=True))
        return values, displacements

    def rates(self, states: Mapping[str, Floats]) -> Floats | None:
        """Evaluate the rates of the elements along the motion at states in recorded units: shape (names, k), SI.

        None where forces read what is not known of the state alone.
        """
        if (known_motion := self._motion) is None:
            return None
        assignments, parameter_values = known_motion
        batch_rates = []
        for part, batch in self._state_batches():
            values, shapes = batch.along_motion(assignments, parameter_values, batch.gather_states(states, part))
            trees = {name: quantity_rate_tree(self.model, name) for name in self._quantity_trees}
            rate_dims = {name: (*self.model.shapes.dims.get(name, ()), AT) for name in trees}
            rates = {name: evaluate_elements(tree, rate_dims[name], values, shapes, AT) for name, tree in trees.items()}
            batch_rates.append(
                batch.requested_numbers({name: numbers.reshape(-1, batch.count) for name, numbers in rates.items()})
            )
        return np.concatenate(batch_rates, axis=1)

    @property
    def knows_rates(self) -> bool:
        """Whether forces read nothing but the known quantities of the state."""
        return self._motion is not None

    @cached_property
    def _motion(self) -> tuple[Sequence[Assignment], dict[str, Floats | float]] | None:
        """Forces, accelerations and rates, and the parameters that they read."""
        if not moves_by_quantities(self.model) or self.model.assemblies:
            return None
        assignments = motion(self.model)
        parameter_values = parameters_read_by(
            self.model, [item.tree for item in assignments], [item.name for item in assignments]
        )
        return None if parameter_values is None else (assignments, parameter_values)

    def state_rates(self, states: Mapping[str, Floats]) -> dict[str, Floats] | None:
        """Evaluate the rates of the state along the motion, at states in recorded units, by its quantities.

        Shape (numbers, k) each, in SI units; None as in `rates`.
        """
        if (known_motion := self._motion) is None:
            return None
        assignments, parameter_values = known_motion
        of_block = {velocity(name): acceleration(name) for name in self.model.statement.coordinates}
        of_block |= {name: velocity(name) for name in self.model.statement.coordinates}
        of_block |= {name: rate(name) for name in self.model.statement.states}
        blocks = layout_of(self.model).used.blocks
        rates_by_block: dict[str, list[Floats]] = {block.name: [] for block in blocks}
        for part, batch in self._state_batches():
            values, _ = batch.along_motion(assignments, parameter_values, batch.gather_states(states, part))
            for block in blocks:
                rates_by_block[block.name].append(np.reshape(values[of_block[block.name]], (-1, batch.count)))
        return {name: np.concatenate(numbers, axis=1) for name, numbers in rates_by_block.items()}

    def along_motion(
        self,
        assignments: Sequence[Assignment],
        parameter_values: Mapping[str, Floats | float],
        states: Mapping[str, Floats],
    ) -> tuple[dict[str, Floats | float], Shapes]:
        """Return forces, accelerations and rates with the quantities they read, in SI units, and all shapes."""
        values = {**parameter_values, **self.values_in_si(states)}
        known_dims = {**self.all_shapes.dims, **{name: (*dims, AT) for name, _, dims in assignments}}
        shapes = replace(self.all_shapes, dims=known_dims)
        for item in assignments:
            values[item.name] = evaluate_elements(item.tree, (*item.dims, AT), values, shapes, AT)
        return values, shapes

    def _state_batches(self) -> Iterator[tuple[slice, ObservedQuantities]]:
        """Yield some states after the other, whose links and elements take some megabytes."""
        batch_size = max(1, LARGEST // widest(self.model))
        for begin in range(0, max(1, self.count), batch_size):
            part = slice(begin, min(begin + batch_size, self.count))
            batch_inputs = {name: np.asarray(self.values[name])[part] for name in ("t", REGIME_NUMBER)}
            yield part, replace(self, values={**self.values, **batch_inputs}, count=part.stop - part.start)

    def error_displacements(
        self, state_values: dict[str, Floats], state_errors: dict[str, Floats]
    ) -> tuple[Floats, Floats]:
        """Evaluate the elements at the states of this part, and how far their errors move them, by blocks."""
        values = self.evaluate_trees(self._quantity_trees, state_values)
        errors = {name: np.zeros(numbers.shape) for name, numbers in values.items()}
        for block in layout_of(self.model).used.blocks:
            for name, tree in self._quantity_trees.items():
                if block.name not in free_names(tree) or not state_errors[block.name].any():
                    continue
                if self.model.shapes.dims.get(name) or (slope := quantity_slope(self.model, name, block.name)) is None:
                    self._add_groups(errors[name], name, block, state_values, state_errors[block.name], values[name])
                else:
                    errors[name] += self._along_slope(slope, block, state_values, state_errors[block.name])
        return self.requested_numbers(values), self.requested_numbers(errors)

    def _along_slope(self, slope: Node, block: Block, state_values: dict[str, Floats], block_errors: Floats) -> Floats:
        """Return how far the errors of a block move a quantity without dimensions, by its slope by the block."""
        halfway = self.values_in_si(state_values | {block.name: state_values[block.name] + block_errors / 2.0})
        slopes = evaluate_elements(slope, (*block.dims, AT), halfway, self.all_shapes, AT)
        displacements: Floats = (
            np.abs(slopes * (block_errors * self._unit_factor(block))).reshape(-1, self.count).sum(axis=0)
        )
        return displacements

    def _add_groups(
        self,
        total: Floats,
        name: str,
        block: Block,
        state_values: dict[str, Floats],
        block_errors: Floats,
        values: Floats,
    ) -> None:
        """Add how far the errors of a block move a quantity, many of its numbers at once."""
        tree, shapes = self._quantity_trees[name], self.model.shapes
        rows, numbers = Dependence(shapes, {block.name: 0}, block.size).pairs(tree, shapes.dims.get(name, ()))
        if not rows.size:
            return
        groups = column_groups(rows, numbers)
        for group in range(int(groups.max()) + 1):
            in_group = groups == group
            near, places = state_values[block.name].copy(), np.unique(numbers[in_group])
            near.reshape(-1, self.count)[places] += block_errors.reshape(-1, self.count)[places]
            moved_values = self.evaluate_trees({name: tree}, state_values | {block.name: near})[name]
            total[rows[in_group]] += np.abs(moved_values - values)[rows[in_group]]

    @cached_property
    def _quantity_trees(self) -> dict[str, Node]:
        wholes = layout_of(self.model).derived_quantities
        return {name: wholes[name][1] for name in dict.fromkeys(split_element_name(name)[0] for name in self.names)}

    @cached_property
    def all_shapes(self) -> Shapes:
        """The shapes of the model, with the states as one more dimension."""
        shapes, used = self.model.shapes, layout_of(self.model).used.blocks
        state_dims = {block.name: (*block.dims, AT) for block in used} | dict.fromkeys(("t", REGIME_NUMBER), (AT,))
        extents = {**shapes.extents, AT: Extent(AT, self.count)}
        return replace(shapes, extents=extents, dims={**shapes.dims, **state_dims})

    def gather_states(self, numbers: Mapping[str, Floats], part: slice) -> dict[str, Floats]:
        """Return some states, in recorded units, by the names of quantities."""
        states_by_block = {}
        for block in layout_of(self.model).used.blocks:
            if block.name in numbers:
                states_by_block[block.name] = np.ascontiguousarray(np.moveaxis(numbers[block.name][part], 0, -1))
            else:
                rows = np.stack([numbers[name][part] for name in block.elements()])
                states_by_block[block.name] = rows.reshape(*block.shape, self.count)
        return states_by_block

    def _unit_factor(self, block: Block) -> float:
        return float(self.model.elements.units[block.first].factor)

    def values_in_si(self, states: Mapping[str, Floats]) -> dict[str, Floats | float]:
        """Return the values that expressions read, in SI units, from states in recorded units."""
        blocks = layout_of(self.model).used.blocks
        return {**self.values, **{block.name: states[block.name] * self._unit_factor(block) for block in blocks}}

    def evaluate_trees(self, trees: Mapping[str, Node], states: Mapping[str, Floats]) -> dict[str, Floats]:
        """Evaluate quantities, in SI units, of states in recorded ones."""
        values = self.values_in_si(states)
        dims = {name: (*self.model.shapes.dims.get(name, ()), AT) for name in trees}
        quantity_values = {
            name: evaluate_elements(tree, dims[name], values, self.all_shapes, AT) for name, tree in trees.items()
        }
        return {name: numbers.reshape(-1, self.count) for name, numbers in quantity_values.items()}

    @cached_property
    def _requested_slices(self) -> list[tuple[str, slice]]:
        """The quantity of each name, and the slice of its requested numbers: one element, or all."""
        computed = layout_of(self.model).computed
        blocks = [computed.block(name) for name in self.names]
        numbers = [block.number(name) for block, name in zip(blocks, self.names, strict=True)]
        return [
            (block.name, slice(0, block.size) if number is None else slice(number, number + 1))
            for block, number in zip(blocks, numbers, strict=True)
        ]

    def requested_numbers(self, values: Mapping[str, Floats]) -> Floats:
        """Return the requested numbers from the values of complete quantities: shape (numbers, k)."""
        return np.concatenate([values[name][numbers] for name, numbers in self._requested_slices])


def widest(model: Model) -> int:
    """Count the numbers of the largest array that energies of a model are made of: of all links, or of all elements."""
    extents = model.shapes.extents
    of_links = (
        relation.size * prod(extents[dim].size for dim in {*extents} - {relation.source, relation.target})
        for relation in model.shapes.relations.values()
    )
    return max(1, *of_links, *(block.size for block in layout_of(model).used.blocks))


def parameters_read_by(
    model: Model, trees: Iterable[Node], known_names: Iterable[str] = ()
) -> dict[str, Floats | float] | None:
    """Return the parameters and constants that expressions read, in SI units.

    None where they read what is neither that, nor of the state, nor known otherwise.
    """
    parameter_values: dict[str, Floats | float] = {}
    states = {block.name for block in layout_of(model).used.blocks}
    for name in set().union(*map(free_names, trees)) - states - {"t", REGIME_NUMBER, *known_names}:
        if dims := model.shapes.dims.get(name):
            block = Block.from_shapes(name, "parameter", model.shapes)
            if block.first not in model.elements.statement.parameters:
                return None
            parameter_values[name] = in_si(model.elements.statement.parameters, Blocks([block])).reshape(
                model.shapes.shape(dims)
            )
        elif name not in constants(model):
            return None
        else:
            parameter_values[name] = constants(model)[name]
    return parameter_values


@lru_cache(maxsize=64)
def quantity_slope(model: Model, name: str, block_name: str) -> Node | None:
    """Return the derivative of a quantity without dimensions by a block of the state.

    None where no rule gives it, or errors may take it over a kink: where two elements are largest, either moves `max`.
    """
    tree = layout_of(model).derived_quantities[name][1]
    if any(isinstance(node, Compare) or getattr(node, "function", "") in KINKED for node in every(tree)):
        return None
    try:
        return gradient(tree, {block_name}, model.shapes).get(block_name, ZERO)
    except InputError:
        return None


@lru_cache(maxsize=64)
def quantity_rate_tree(model: Model, name: str) -> Node:
    """Return the derivative of a quantity by the time along the motion, with accelerations and rates as names."""
    dims, tree = layout_of(model).derived_quantities[name]
    rates = rates_of_quantities(model, [Assignment(name, tree, dims)])
    assert rates is not None  # noqa: S101 - what reads tables is evaluated by elements
    return rates[0].tree

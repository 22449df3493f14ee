"""Energies and observables of models with dimensions, evaluated as whole quantities: the bits of element by element."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary import NAME
from xdynamics.expressions import Node, free_names
from xdynamics.kernels.layout import layout_of
from xdynamics.model import Model
from xdynamics.model.elementwise import in_si
from xdynamics.model.motion import REGIME_NUMBER, constants
from xdynamics.model.reactions import reactions
from xdynamics.model.whole import has_wholes
from xdynamics.runtime.cached_properties import cached_property
from xdynamics.schema import AT
from xdynamics.shapes import Extent, Shapes
from xdynamics.shapes.blocks import Block, Blocks
from xdynamics.shapes.evaluation import evaluate_elements
from xdynamics.shapes.naming import parted

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ObservedQuantities:
    """Elements of quantities that are computed from states, at many states.

    Attributes
    ----------
    model : Model
    names : sequence of str
        Of the elements.
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
        """Return what evaluates some elements; None where they are to be evaluated by themselves.

        That is so without dimensions, where expressions read what is not known of the state alone (drives, forces, contacts,
        delayed values), and with elementary functions of older records.
        """
        if not has_wholes(model) or reactions(model) or model.delays or math_functions != NAME:
            return None
        wholes = layout_of(model).wholes
        if not all(parted(name)[0] in wholes for name in names):
            return None
        given: dict[str, Floats | float] = {"t": times, REGIME_NUMBER: regimes}
        states = {block.name for block in layout_of(model).used.blocks}
        for name in set().union(*(free_names(wholes[parted(name)[0]][1]) for name in names)) - states - given.keys():
            if dims := model.shapes.dims.get(name):
                block = Block.of(name, "parameter", model.shapes)
                if block.first not in model.parameters:
                    return None
                given[name] = in_si(model.parameters, Blocks([block])).reshape(model.shapes.shape(dims))
            elif name not in constants(model):
                return None
            else:
                given[name] = constants(model)[name]
        return cls(model, names, given, len(times))

    def with_errors(self, states: Mapping[str, Floats], errors: Mapping[str, Floats]) -> tuple[Floats, Floats]:
        """Evaluate the elements, and how much the errors of the state move them, one after the other.

        Parameters
        ----------
        states, errors : mapping of str to ndarray, shape (k,)
            By the names of elements of the state, in recorded units.

        Returns
        -------
        values, errors : ndarray, shape (names, k), SI
        """
        blocks = layout_of(self.model).used.blocks
        at, moved = ({block.name: self._gathered(block, numbers) for block in blocks} for numbers in (states, errors))
        values = self._evaluated(self._wholes, at)
        found, total = self._chosen(values), np.zeros((len(self.names), self.count))
        for block in blocks:
            read = {name: tree for name, tree in self._wholes.items() if block.name in free_names(tree)}
            places = np.flatnonzero(moved[block.name].reshape(-1, self.count).any(axis=1))
            for place in places.tolist():
                near = at[block.name].copy()
                near.reshape(-1, self.count)[place] += moved[block.name].reshape(-1, self.count)[place]
                total += np.abs(self._chosen(values | self._evaluated(read, at | {block.name: near})) - found)
        return found, total

    @cached_property
    def _wholes(self) -> dict[str, Node]:
        wholes = layout_of(self.model).wholes
        return {name: wholes[name][1] for name in dict.fromkeys(parted(name)[0] for name in self.names)}

    @cached_property
    def _shapes(self) -> Shapes:
        """The shapes of the model, with the states as one more dimension."""
        shapes, used = self.model.shapes, layout_of(self.model).used.blocks
        along = {block.name: (*block.dims, AT) for block in used} | dict.fromkeys(("t", REGIME_NUMBER), (AT,))
        extents = {**shapes.extents, AT: Extent(AT, self.count)}
        return replace(shapes, extents=extents, dims={**shapes.dims, **along})

    def _gathered(self, block: Block, numbers: Mapping[str, Floats]) -> Floats:
        rows = np.stack([numbers[name] for name in (block.elements() if block.dims else (block.name,))])
        return rows.reshape(*block.shape, self.count)

    def _evaluated(self, trees: Mapping[str, Node], states: Mapping[str, Floats]) -> dict[str, Floats]:
        """Evaluate quantities, in SI units, of states in recorded ones."""
        units, used = self.model.units, layout_of(self.model).used.blocks
        values = {**self.values, **{b.name: states[b.name] * float(units[b.first].factor) for b in used}}
        dims = {name: (*self.model.shapes.dims.get(name, ()), AT) for name in trees}
        found = {name: evaluate_elements(tree, dims[name], values, self._shapes, AT) for name, tree in trees.items()}
        return {name: numbers.reshape(-1, self.count) for name, numbers in found.items()}

    @cached_property
    def _places(self) -> list[tuple[str, int]]:
        """The quantity of each element, and its number there."""
        computed = layout_of(self.model).computed
        blocks = [computed.block(name) for name in self.names]
        return [(block.name, block.number(name) or 0) for block, name in zip(blocks, self.names, strict=True)]

    def _chosen(self, values: Mapping[str, Floats]) -> Floats:
        return np.stack([values[name][number] for name, number in self._places])

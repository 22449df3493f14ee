"""The allowed error of a step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.bounds import EPS
from xdynamics.faults import first_names
from xdynamics.kernels.layout import Layout
from xdynamics.methods.scheme import DOUBLE_DOUBLE, UNIT_OF
from xdynamics.model import Model
from xdynamics.model.elementwise import in_si
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.shapes.blocks import Block, Blocks
from xdynamics.shapes.naming import split_element_name
from xdynamics.units import Unit

LEAST_RTOL = 10 * EPS  # of numbers of one float
OF_TERMS, NO_FLOOR = "terms that cancel", "none"
ATOL_FLOORS = {  # what a tolerance that follows is never less than, besides `ATOL_RULE`, as described in a record
    OF_TERMS: (
        "at least 10 spacings of 1 times the step times the sum of the sizes of the terms of the"
        " variable's rate at its end, through the mass, forces of contacts, friction and constraints among them; of a"
        " coordinate that of its velocity times the step; where that is more than the tolerances allow, an error within it"
        " is none of the method, and counts as 0;"
        " looked at where a trial fails, in the first after a start, an event or a node, and in those after it while it matters"
    ),
    NO_FLOOR: "",
}
TINY = 1e-200  # a tolerance from which on is not zero in SI units either


def least_rtol(precision: str) -> float:
    """Return the least relative tolerance, below which rounding is as large."""
    return 10 * UNIT_OF.get(precision, EPS)


@dataclass(frozen=True)
class Tolerances:
    """The allowed error of a step, atol + rtol*|value|, for every coordinate, velocity and state.

    An absolute tolerance that is not given follows the size of its variable along the run; see `tolerance_sizes`.

    Attributes
    ----------
    rtol : float
    atol : dict of str to float
        SI units, by name: of a whole block, or of an element, whose own counts before.
    units : dict of str to Unit
        Of every coordinate, velocity and state: its declared unit, or that of the march's scales.
    bare : float, optional
        Tolerance, in its unit, of each variable without one of its own.
    """

    rtol: float
    atol: Mapping[str, float]
    units: Mapping[str, Unit]
    bare: float | None = None

    def __hash__(self) -> int:
        return hash((self.rtol, self.bare, *sorted(self.atol.items())))

    def atol_of(self, name: str) -> float | None:
        """Return the absolute tolerance given for a coordinate, velocity or state, SI; None if it follows the size."""
        for key in (name, split_element_name(name)[0]):
            if key in self.atol:
                return self.atol[key]
        return None if self.bare is None else self.units[name].to_si(self.bare)

    def of_all(self, blocks: Blocks) -> NDArray[np.float64]:
        """Return the absolute tolerance of every number of some blocks, SI; nan where it follows the size."""
        for last_blocks, atols in self._last:
            if last_blocks is blocks:
                return atols
        all_atols = blocks.spread([self._of_block(block) for block in blocks.blocks])
        wholes = {block.name for block in blocks.blocks}
        element_atols = {name: atol for name, atol in self.atol.items() if name not in wholes}
        atol_by_index = {
            index: atol for name, atol in element_atols.items() if (index := blocks.find_offset(name)) is not None
        }
        if atol_by_index:
            all_atols = all_atols.copy()
            all_atols[[*atol_by_index]] = [*atol_by_index.values()]
            all_atols.flags.writeable = False
        self._last[:] = [(blocks, all_atols)]
        return all_atols

    def _of_block(self, block: Block) -> float:
        """Return the absolute tolerance of a block without those of its elements; nan where it follows the size."""
        if block.name in self.atol:
            return self.atol[block.name]
        return np.nan if self.bare is None else self.units[block.first].to_si(self.bare)

    def of_blocks(self, blocks: Blocks) -> dict[str, float]:
        """Return the absolute tolerances by block, SI, then those of elements with their own."""
        block_by_name = {block.name: block for block in blocks.blocks}
        # nan, of one that follows, is unequal to itself
        atol_by_block = {name: atol for name, block in block_by_name.items() if (atol := self._of_block(block)) == atol}
        return atol_by_block | {name: atol for name, atol in self.atol.items() if name not in block_by_name}

    @cached_property
    def _last(self) -> list[tuple[Blocks, NDArray[np.float64]]]:  # what was returned last, which a run asks for often
        return []

    def faults(self, model: Model, lowest_rtol: float = LEAST_RTOL) -> list[str]:
        """List everything that an error test could not use, with relative tolerances from `lowest_rtol` on."""
        faults = []
        if not lowest_rtol <= self.rtol < 1:
            finer = f"; from {least_rtol(DOUBLE_DOUBLE):.1g} on with precision = 'double_double'" * (
                0.0 < self.rtol < lowest_rtol == LEAST_RTOL
            )
            faults.append(
                f"rtol is {self.rtol!r}, needs a number from 10 eps = {lowest_rtol:.3g}, below which rounding is as large, to 1{finer}"
            )
        atols = {f" of '{name}'": value for name, value in self.atol.items()}
        atols |= {} if self.bare is None else {"": self.bare}
        bad = {label: value for label, value in atols.items() if not isfinite(value) or value < 0}
        faults += [f"atol{label} is {value!r}, needs a finite non-negative number" for label, value in bad.items()]
        if not self.atol and (self.bare is None or self.bare >= TINY):  # neither names nor zeros
            return faults
        used = Layout(model).used
        faults += [
            f"atol names '{name}', which is none of {first_names(block.name for block in used.blocks)}"
            for name in self.atol
            if used.find_offset(name) is None
        ]
        if bad:
            return faults
        unscaled = (self.of_all(used) == 0.0) & (in_si(model.elements.statement.initial, used) == 0.0)
        faults += [
            f"atol of '{name}' is 0 and {name} starts at 0: its error would have no scale; give it a positive one"
            for name in map(used.__getitem__, np.flatnonzero(unscaled).tolist())
        ]
        return faults

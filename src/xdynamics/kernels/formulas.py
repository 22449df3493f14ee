"""Formulas: programs written as lines of text, whose names stand for values known where the lines are written.

Step control is such text: the error test, the factor of the next step, its bounds. `march.control` and
`march.tolerance_sizes` use it as functions of numbers, `kernels.lane_step` in all lanes at once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from xdynamics.elementary.numbers import maximum_of_two, minimum_of_two
from xdynamics.expressions import parse
from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.compiling import jit_inline
from xdynamics.kernels.program import Location, Operand
from xdynamics.kernels.python_text import function_text
from xdynamics.methods import implicit

larger: Any = jit_inline(maximum_of_two)
smaller: Any = jit_inline(minimum_of_two)


class Formulas(Assignments):
    """Turns text into instructions; names are values given or computed before, or places in a lane's memory."""

    def __init__(self, places: dict[str, Location], prefix: str, operands: dict[str, Operand] | None = None) -> None:
        super().__init__(lambda lines, name: lines.load(places[name]), prefix)
        self.known: dict[str, Operand] = operands or {}
        self._given: dict[str, Operand] = {}

    def operand_of(self, name: str) -> Operand:
        """Return the operand of a name."""
        if name in self._given:
            return self._given[name]
        return self.known[name] if name in self.known else super().operand_of(name)

    def formula(self, text: str, **operands: Operand) -> Operand:
        """Write an expression; return its operand."""
        self._given = operands
        operand = self.value(parse(text))
        self._given = {}
        return operand

    def write(self, text: str, **operands: Operand) -> None:
        """Write lines; the names that they assign are known from then on."""
        for target, expression in split_assignments(text):
            self.known[target] = self.formula(expression, **operands)


def split_assignments(text: str) -> list[list[str]]:
    """Return target and expression of every line."""
    return [line.split(" = ") for line in filter(None, text.split("\n"))]


def compiled_function_of(
    text: str, argument_names: str, results: str, constants: Mapping[str, float] | None = None
) -> Any:
    """Compile lines that programs compute too as a function of numbers for the engine, inlined at its calls.

    Parameters
    ----------
    text : str
    argument_names, results : str
        Names of the arguments, and of what is returned.
    constants : mapping of str to float, optional
        Further names.
    """
    lines = Formulas({}, "_", dict(constants or {}) | {name: name for name in argument_names.split()})
    lines.write(text)
    source = function_text(
        "lines", argument_names.split(), lines.lines, [lines.known[name] for name in results.split()]
    )
    scope: dict[str, Any] = {"_greatest": larger, "_least": smaller, "_floor": np.floor, "sqrt": math.sqrt}
    exec(source, scope)  # noqa: S102 - printed from checked trees
    return jit_inline(scope["lines"])


STRETCH = 1.01  # of a step that would end just before a node
LEAST_LOGARITHM = -9.210340371976182  # of 1e-4, the smallest norm that the next step remembers
STEADY = -900.0  # the power of two of a term that stays zero
CONSTANTS = {
    "stretch": STRETCH,
    "least_logarithm": LEAST_LOGARITHM,
    "steady": STEADY,
    "smallest": implicit.SMALLEST,
    "few_turns": float(implicit.FEW_TURNS),
    "slow": implicit.SLOW,
    "held": implicit.HELD,
    "work": 2.0 * implicit.MOST_TURNS,
    "least_work": 1.0 + 2.0 * implicit.MOST_TURNS,
}

# Where a step is to end, at a node or a time of the grid, or both (`lands`, `counts`), and how wide it is: of one that is
# chosen the difference of the rounded ends, not the proposal that led to them; from a grid time the step of the grid, to the
# bit. Grid times are products, never accumulated sums: runs refined on nested grids meet at times that are equal to the bit
AIM_FREELY = """
rest_of = node - t
proposed = t + step
lands = where(proposed >= node - snap, 1, where(rest_of <= stretch*step, where(rest_of <= max_step, 1, 0), 0))
reach = where(lands > 0, node, proposed)
width = where(lands > 0, rest_of, proposed - t)
counts = 1 - lands
"""
GRID_TIME = "proposed = start + (grid + 1)*step_size\n"
AIM_AT_GRID = """
lands = where(node > proposed + snap, 0, 1)
counts = where(lands > 0, where(node >= proposed - snap, 1, 0), 1)
reach = where(lands > 0, node, proposed)
width = where(on_grid > 0, where(counts > 0, step_size, reach - t), reach - t)
"""
# The tolerance of a variable that follows its size, and what is allowed to its error: at least that of the largest of
# its kind, and where none of the kind has moved yet, that of its rate
TOLERANCE = "atol = max(rtol*size, floor*top)"
ALLOWED = "allowed = max(atol, floor*top, where(atol == 0, rtol*rest*abs(slope), 0))"
# The largest ratio of an error to its scale; a component that stays zero has no error, whatever its scale
RATIO = "ratio = where(error != 0, abs(error)/(allowed + rtol*max(abs(before), abs(after))), 0)"
NORM = f"{RATIO}\nnorm = max(norm, ratio)"
# What rounding of the terms of forces makes of a step: a share of their size along it, and of a coordinate, whose velocity
# has that error, along it again. Where that is more than the scale, an error within it is none of the method, which longer
# steps would enlarge, and has no part in the next step either
_TERMS = "where(terms - terms == 0, terms, 0)"
LEAST_OF_RATE, LEAST_OF_COORDINATE = f"least = rounding*width*{_TERMS}", f"least = rounding*width*width*{_TERMS}"
SMALL = 0.1  # a norm up to which steps grow well
TINY = 1e-6  # of `rest`: a first step that rounding may have shortened
FLOORED_RATIO = """
scale = allowed + rtol*max(abs(before), abs(after))
beyond = where(abs(error) <= least, 0, abs(error)/least)
ratio = where(error != 0, where(least > scale, beyond, abs(error)/scale), 0)
"""
FLOORED_NORM = f"{FLOORED_RATIO}norm = max(norm, ratio)"

# a proportional-integral controller (Hairer and Wanner, Solving ODEs II, 2nd ed., section IV.2); after a rejection the
# integral part alone
EXPONENT = """
beta = 0.2/k
exponent = where(norm > 1, -logarithm/k, (0.75*beta - 1/k)*logarithm + beta*step_log)
"""
# of the norms of this trial and the one before, by that power
PROPORTIONAL = """
allowed = safety*power
factor = where(norm > 0, min(greatest, max(least, allowed)), greatest)
next_log = max(where(norm > 0, logarithm, least_logarithm), least_logarithm)
shrink = max(least, min(0.9, allowed))
"""
# of the work of the iterations too; a small growth is left out where it would cost the factors that are kept
# Gustafsson's predictive controller (Hairer and Wanner, Solving ODEs II, 2nd ed., section IV.8), fourth roots as two
# square roots
PREDICTIVE = """
bounded = max(norm, smallest)
own = safety*min(1, least_work/(turn + work))/sqrt(sqrt(bounded))
seen = safety*(width/before)*sqrt(sqrt(norm_before/(bounded*bounded)))
predicted = where(norm <= 1, where(before > 0, min(own, seen), own), own)
limited = min(greatest, max(least, predicted))
stays = where(turns <= few_turns, 1, where(theta <= slow, 1, 0))*where(limited >= 1, where(limited <= held, 1, 0), 0)
growth = where(stays > 0, 1, limited)
"""
PREDICTED = """
factor = min(greatest, max(least, growth))
next_log = least_logarithm
shrink = min(0.9, growth)
"""
# By the coefficients of a Taylor series at the start of the step, each over what is allowed to errors: a term is as large
# as the state after the radius of convergence, and falls to what is allowed in the step. Without a unit in a time of the
# motion, so that steps are the same in all units, roots to three digits are enough. Where an order has none, the motion is a
# polynomial of a lower degree, and the step as long as it may be
WEIGHT = "weight = 1/(allowed + rtol*abs(value))"
TERM = "norm_{0} = where(term_{0} != 0, abs(term_{0})*weight, 0)"
TIME_OF = "time = where(norm_size > 0, where(norm_slope > 0, norm_size/norm_slope, remaining), remaining)"
WITHOUT_UNIT = """
top = min(1e300, max(1, norm_size))
share = half/top
first = norm_before*share*rest_before
second = norm_last*share*rest_last
before = min(1e300, max(1e-300, first))
last = min(1e300, max(1e-300, second))
"""
LOG2 = "log2 = whole + (part - 1)*(1 + (2 - part)*(0.42157659 - 0.15684817*(part - 1)))"  # of part*2**whole, to 0.001
FORESEEN = """
rise_before = where(first > 0, log2_before*per_before, steady)
rise_last = where(second > 0, log2_last*per_last, steady)
exponent = max(-1000, min(1000, -(max(rise_before, rise_last) + log2_top*per_last)))
whole = floor(exponent)
part = exponent - whole
factor = safety*time*(part*(1 - (1 - part)*(0.30414315 + 0.07914497*part)) + 1)
"""
# no growth right after a rejection, no loss from a step that was cut
NEXT = """
grown = width*where(rejected > 0, min(factor, 1), factor)
uncut = where(cut > 0, where(rejected > 0, grown, max(grown, step)), grown)
next_step = min(max_step, max(min_step, uncut))
"""

"""A method with its estimator: how steps are made, judged and interpolated.

For compensated summation the sums that lead from the old state to the new one are read from the method's lines.
"""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from functools import cache, lru_cache

from xdynamics.elementary import NAME
from xdynamics.elementary.bounds import EPS
from xdynamics.expressions import Binary, Name, Negative, Node
from xdynamics.methods.lines import HERMITE, Interpolant, Line, VectorStatement, read_lines
from xdynamics.methods.method import Method
from xdynamics.methods.steppers import CONTROLLER, EXACT, Stepper
from xdynamics.model import Model

PLAIN, COMPENSATED = SUMMATIONS = ("plain", "compensated")


@dataclass(frozen=True)
class Update:
    """``v3 = v2 + 3/4*h*a2`` split into the vector before and the increment."""

    start_vector: str
    increment: Node


@cache
def updates(method: Method) -> dict[str, Update]:
    """Return the sums by which q, v and x become q1, v1 and x1, keyed by their targets; none unless all do so."""
    sums = {line.target: _split_sum(line) for line in method.statements if isinstance(line, VectorStatement)}
    by_target = {}
    for letter in "qvx":
        target = f"{letter}1"
        while target != letter:
            update = sums.get(target)
            if update is None or update.start_vector[0] != letter:
                return {}
            by_target[target] = update
            target = update.start_vector
    return by_target


def _split_sum(line: VectorStatement) -> Update | None:
    """Split a sum; None if a line does not begin with a single vector."""
    terms: list[tuple[str, Node]] = []
    node = line.expression
    while isinstance(node, Binary) and node.operator in "+-":
        terms.insert(0, (node.operator, node.right))
        node = node.left
    if not isinstance(node, Name) or not terms:
        return None
    sign, added = terms[0]
    added = added if sign == "+" else Negative(added)
    for sign, term in terms[1:]:
        added = Binary(sign, added, term)
    return Update(node.name, added)


NO_ESTIMATE, EMBEDDED, STEP_DOUBLING, EXTRAPOLATED = ESTIMATORS = (
    "none",
    "embedded",
    "step_doubling",
    "step_doubling_extrapolated",
)
FLOAT64, DOUBLE_DOUBLE = PRECISIONS = ("float64", "double_double")
UNIT_OF = {FLOAT64: EPS, DOUBLE_DOUBLE: 2.0**-104}  # what a sum or product of numbers of about 1 may be off, twice that
REINTEGRATE, INTERPOLANT = RULES = ("reintegrate", "interpolant")
REINTEGRATION_WORDS = (
    "re-integration: the run's own step from the accepted state before, shortened to end at the instant; events are"
    " located on the same"
)
SHARED_IMPULSES = (
    "re-integration: the run's own step from the accepted state before, without contacts and shortened to end at the"
    " instant; of the impulses of the whole step the share of its time that has passed"
)
SCALED_RTOL = (
    "with {} in the place of rtol, and atol in the same ratio to it, so that the error at the end of a run is"
    " proportional to the tolerances"
)
ESTIMATE_WORDS = {
    EMBEDDED: "difference from an embedded formula; the higher order goes on (local extrapolation)",
    STEP_DOUBLING: "two half steps less one whole step, over 2**order - 1; the two half steps go on",
    EXTRAPOLATED: (
        "two half steps less one whole step, over 2**order - 1, added to the two half steps (local extrapolation)"
    ),
}


@dataclass(frozen=True)
class Scheme:
    """A method with its error estimator and arithmetic.

    Attributes
    ----------
    method : Method
    estimator : str
        One of `ESTIMATORS`.
    jacobian : str
        One of `steppers.JACOBIANS`: how an implicit method obtains the derivatives of the forces.
    summation : str
        One of `SUMMATIONS`: whether the rounding errors of the state are carried along.
    math_functions : str
        The set of elementary functions that forces are computed with.
    by_hermite : bool
        Whether events are isolated on Hermite's polynomials whatever a step leaves, as they once were.
    precision : str
        One of `PRECISIONS`: whether a number is a float or the sum of two.
    """

    method: Method
    estimator: str = NO_ESTIMATE
    jacobian: str = EXACT
    summation: str = PLAIN
    math_functions: str = NAME
    by_hermite: bool = False
    precision: str = FLOAT64

    @property
    def estimates(self) -> bool:
        """Whether a step comes with an estimate of its local error."""
        return self.estimator != NO_ESTIMATE

    @property
    def steps(self) -> int:
        """Steps made in one trial: with step doubling a full one and two halves, of which the halves are continued."""
        return 3 if self.estimator in (STEP_DOUBLING, EXTRAPOLATED) else 1

    @property
    def compensated(self) -> dict[str, Update]:
        """The updates whose rounding errors are carried along; none with plain summation."""
        return updates(self.method) if self.summation == COMPENSATED and self.precision == FLOAT64 else {}

    @property
    def controller(self) -> str:
        """How the next step is chosen, in words."""
        return self.method.stepper.controller if self.estimator == EMBEDDED else CONTROLLER

    def effective_rtol(self, rtol: float) -> float:
        """Return the relative tolerance that steps are judged by.

        An estimate of order h**k within tol makes steps of tol**(1/k), with a global error of h**p, p the order of the
        continued solution: where the estimate is of that solution itself (k = p + 1), the error is tol**(p/k), and
        tol**(k/p) in place of tol makes it proportional to tol; likewise for RADAU5, whose estimate is of order h**4.
        Decimal arithmetic gives the power the same digits on every machine.
        """
        if self.estimator == EMBEDDED and self.method.stepper.rtol_scaling:
            factor, power = self.method.stepper.rtol_scaling
            return factor * float(Decimal(rtol) ** power)
        if self.estimator == STEP_DOUBLING:
            return float(Decimal(rtol) ** (Decimal(self.error_order) / self.method.order))
        return rtol

    @property
    def effective_rtol_text(self) -> str:
        """The effect of `effective_rtol` in words; empty if it has none."""
        if self.estimator == EMBEDDED and self.method.stepper.rtol_scaling:
            factor, power = self.method.stepper.rtol_scaling
            return SCALED_RTOL.format(f"{factor}*rtol**({Fraction(power)})")
        if self.estimator == STEP_DOUBLING:
            return SCALED_RTOL.format(f"rtol**({self.error_order}/{self.method.order})")
        return ""

    @property
    def order(self) -> int:
        """Order of the continued solution: that of the method, or one more if an estimate is added to it."""
        return self.method.order + (self.estimator == EXTRAPOLATED)

    @property
    def error_order(self) -> int:
        """The k of a local error that falls as h**k."""
        return 1 + (self.method.estimate_order if self.estimator == EMBEDDED else self.method.order)

    @property
    def error_equations(self) -> str:
        """The text of the embedded formula, if that is the estimator."""
        return self.method.estimate if self.estimator == EMBEDDED else ""

    @property
    def error_lines(self) -> tuple[Line, ...]:
        """The lines of the embedded formula, if that is the estimator."""
        return read_lines(self.error_equations)

    @property
    def stages(self) -> int:
        """Force evaluations of one step by the method's lines; for implicit equations, those of one iteration."""
        return _stages(self.method.stepper, self.method.update, self.error_equations)

    @property
    def samples(self) -> int:
        """Force evaluations that one trial keeps."""
        return self.stages * self.steps + (self.estimator == EXTRAPOLATED)

    @property
    def interpolant(self) -> Interpolant:
        """The interpolant of a step: the method's own, or Hermite's if half steps are continued."""
        return HERMITE if self.steps > 1 else self.method.interpolant

    @property
    def leaves_polynomial(self) -> bool:
        """Whether a step leaves a polynomial of its own, which costs no further evaluation: events are isolated on it."""
        return self.interpolant.needs_no_stages and self.interpolant != HERMITE and not self.by_hermite

    def interpolation(self, model: Model, rule: str = REINTEGRATE) -> str:
        """The interpolation between accepted states of a model, in words."""
        if rule == REINTEGRATE:
            return REINTEGRATION_WORDS if self.method.stepper.locates or not model.assemblies else SHARED_IMPULSES
        return self.interpolant.words

    def interpolation_order(self, rule: str = REINTEGRATE) -> int:
        """Order of the local error of the interpolation, minus one."""
        if rule == REINTEGRATE:
            return self.order
        return self.interpolant.order


@lru_cache(maxsize=256)
def _stages(stepper: Stepper, update: str, estimate: str) -> int:
    return stepper.evaluations(read_lines(update), read_lines(estimate))

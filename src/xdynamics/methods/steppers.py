"""Steppers: how a method makes its steps, by its lines, by its lines over contacts, by collocation or by jets.

A stepper knows what is not in the lines of its method, and answers a march's questions: which programs make a step,
what solves its equations, where derivatives may come from, what a step leaves for the next step, who chooses that,
which force evaluations are made, and for which models there are no steps.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import ClassVar, Protocol, TypeVar

from xdynamics.methods.lines import Evaluation, Line, Solve
from xdynamics.model import Model
from xdynamics.model.parts import NEWTON as NEWTON_S
from xdynamics.model.reactions import reactions

EXACT, DIFFERENCES = JACOBIANS = ("exact", "differences")
NOTHING, NEWTON, SIMPLIFIED, SERIES = (
    "nothing",
    "newton",
    "simplified",
    "series",
)  # what solves the equations of a step
CONTROLLER = (
    "PI: safety*norm**-alpha*norm_before**beta, beta = 0.2/k, alpha = 1/k - 0.75*beta, k = order of the estimate + 1"
    " (Hairer, Norsett, Wanner II.4 and IV.2; Gustafsson 1991, doi:10.1145/210232.210242)"
)
Programs_co = TypeVar("Programs_co", covariant=True)


class StepWriter(Protocol[Programs_co]):
    """The writer of a step's programs, for a model and a method."""

    def by_lines(self) -> Programs_co:
        """Write the lines of the method, and those of its estimate."""

    def by_series(self, degree: int) -> Programs_co:
        """Write the lines of the method, and the expansion of the motion that they read."""

    def by_stages(self, stages: int) -> Programs_co:
        """Write the programs that a solver of a number of stages needs."""


class Stepper:
    """The common interface of steppers.

    Attributes
    ----------
    jacobians : tuple of str
        Of `JACOBIANS`: where derivatives of the forces may come from.
    has_memory : bool
        Whether iterations begin where those of the step before ended, so that no step is repeated by itself to the bit.
    locates : bool
        Whether impacts are located as events; otherwise they act over whole steps.
    controller : str
        How the next step is chosen with an embedded formula.
    foresees : bool
        Whether a step is chosen by what is known at its start; otherwise by the one before it.
    compensates : bool
        Whether rounding errors of the state are carried along unless something else is asked for.
    rtol_scaling : (float, Decimal) or None
        Factor and power of the relative tolerance that steps are judged by then, where it is not that of the run.
    """

    jacobians: ClassVar[tuple[str, ...]] = (EXACT,)
    has_memory: ClassVar[bool] = False
    locates: ClassVar[bool] = True
    controller: ClassVar[str] = CONTROLLER
    foresees: ClassVar[bool] = False
    compensates: ClassVar[bool] = False
    rtol_scaling: ClassVar[tuple[float, Decimal] | None] = None

    def programs(self, writer: StepWriter[Programs_co]) -> Programs_co:
        """Return the programs of a step."""
        return writer.by_lines()

    def solver(self, update: Iterable[Line]) -> str:
        """Return the solver of the equations of a step."""
        return NEWTON if any(isinstance(line, Solve) for line in update) else NOTHING

    def evaluations(self, update: Sequence[Line], estimate: Sequence[Line]) -> int:
        """Count the stored force evaluations of a step; of equations, those of one iteration."""
        return sum(map(_evaluations_of_line, (*update, *estimate)))

    def refusals(self, _model: Model) -> list[str]:
        """List why a model has no such steps, whatever the settings."""
        return []

    def faults_of_estimates(self, _model: Model, _method: str) -> list[str]:
        """List why there is no estimate of the error of such steps."""
        return []


@dataclass(frozen=True)
class Lines(Stepper):
    """The lines in their order; equations are solved by Newton's method with the Jacobian of every iterate."""


LINES = Lines()


@dataclass(frozen=True)
class TimeStepping(Lines):
    """The lines, then impulses of contacts over the complete step: no impact is located."""

    locates: ClassVar[bool] = False

    def refusals(self, model: Model) -> list[str]:
        """List why a model has no such steps: another law of impacts, or friction that sticks by more than it slips by."""
        contacts = model.elements.contacts | model.assemblies
        unsupported_laws = {contact.law for contact in contacts.values()} - {NEWTON_S}
        slipping = {name: (contact.friction, contact.static) for name, contact in contacts.items()}
        slipping |= {name: (friction.kinetic, friction.static) for name, friction in model.elements.frictions.items()}
        return [
            *(
                f"it has Newton's law of restitution over whole steps, and law = '{law}' is for impacts that are located;"
                " write law = 'newton' for it"
                for law in sorted(unsupported_laws)
            ),
            *(
                f"it has one strength of friction over whole steps, and '{name}' sticks up to another, its `static`,"
                " until a slip that is located; leave static out for it"
                for name, (kinetic, static) in slipping.items()
                if kinetic != static
            ),
        ]

    def faults_of_estimates(self, model: Model, method: str) -> list[str]:
        """List why there is no estimate of the error of such steps: none knows of impacts."""
        if not (reactions(model) or model.assemblies):
            return []
        return [f"method '{method}' has no error estimate that knows of impacts; give a step, and estimator = 'none'"]


@dataclass(frozen=True)
class Collocation(Stepper):
    """Stages solved for together, by simplified Newton iterations that keep derivatives and factors (`march.implicit`).

    Attributes
    ----------
    a : tuple of tuple of str
        The weights of the slopes at the stages in each stage, as texts, so that the equations have them as written.
    b : tuple of str
        Those of the end of the step, which may be its last stage.
    c : tuple of str
        The stages' times, in steps.

    Examples
    --------
    >>> print(Collocation(a=(("1/2",),), b=("1",), c=("1/2",)).template)
    y2 = y + 1/2*h*k
    solve y2:
        k2 = f(t + 1/2*h, y2)
        y2 = y + h*(1/2*k2)
    y1 = y + h*(1*k2)
    k1 = f(t1, y1)
    """

    a: tuple[tuple[str, ...], ...]
    b: tuple[str, ...]
    c: tuple[str, ...]

    jacobians: ClassVar[tuple[str, ...]] = JACOBIANS
    has_memory: ClassVar[bool] = True
    controller: ClassVar[str] = (
        "predictive: safety*min(norm**(-1/4)*15/(i + 14), h/h_before*(norm_before/norm**2)**(1/4)), i = Newton"
        " iterations; a growth of up to 1.2 is left out after at most 2 of them or where they converge by theta <"
        " 0.001, for the sake of what is kept (Hairer, Wanner, Solving ODEs II, IV.8; Gustafsson 1994,"
        " doi:10.1145/198429.198437)"
    )
    rtol_scaling: ClassVar[tuple[float, Decimal] | None] = (0.1, Decimal("0.8"))

    @property
    def template(self) -> str:
        """The update for y' = k: the stages from rest, their equations, the end of the step."""
        numbers = range(2, 2 + len(self.c))
        times = ["t1" if c == "1" else f"t + {c}*h" for c in self.c]
        starts = [f"y{i} = y + {'' if c == '1' else f'{c}*'}h*k" for i, c in zip(numbers, self.c, strict=True)]
        slopes = [f"    k{i} = f({time}, y{i})" for i, time in zip(numbers, times, strict=True)]
        stages = [f"    y{i} = y + h*({_weighted_slopes(row)})" for i, row in zip(numbers, self.a, strict=True)]
        solve = f"solve {', '.join(f'y{i}' for i in numbers)}:"
        end = f"y{numbers[-1]}" if self.b == self.a[-1] else f"y + h*({_weighted_slopes(self.b)})"
        return "\n".join([*starts, solve, *slopes, *stages, f"y1 = {end}", "k1 = f(t1, y1)"])

    def programs(self, writer: StepWriter[Programs_co]) -> Programs_co:
        """Return the programs of a step."""
        return writer.by_stages(len(self.c))

    def solver(self, _update: Iterable[Line]) -> str:
        """Return the solver of the equations of a step."""
        return SIMPLIFIED

    def evaluations(self, update: Sequence[Line], _estimate: Sequence[Line]) -> int:
        """Count the stored force evaluations of a step: those of its estimate are not stored."""
        return super().evaluations(update, ())


@dataclass(frozen=True)
class Jets(Stepper):
    """The Taylor series of the motion, of which a step is the sum; repeated from its start, a step keeps the series.

    Attributes
    ----------
    degree : int
    """

    degree: int

    foresees: ClassVar[bool] = True
    compensates: ClassVar[bool] = True
    controller: ClassVar[str] = (
        "by the last two coefficients at the start of the step: safety*radius*norm(y)**(-1/order), radius = min over i ="
        " order - 1, order of (norm(y)/norm(y_i))**(1/i), roots to three digits, with the norm of errors (Jorba, Zou 2005,"
        " Exp. Math. 14, 99, section 3.2); after a rejected trial safety*norm**(-1/(order + 1)) within the limits of growth"
    )

    def programs(self, writer: StepWriter[Programs_co]) -> Programs_co:
        """Return the programs of a step."""
        return writer.by_series(self.degree)

    def solver(self, _update: Iterable[Line]) -> str:
        """Return the code that makes a step besides its lines."""
        return SERIES

    def refusals(self, model: Model) -> list[str]:
        """List why a model has no such steps: forces from an iteration have no series."""
        if not model.assemblies:
            return []
        assembly_names = ", ".join(f"'{name}'" for name in model.assemblies)
        return [
            f"it has no series of the forces of contacts of many links ({assembly_names}), which are found by iteration"
        ]


def _weighted_slopes(weights: Sequence[str]) -> str:
    return " + ".join(f"{weight}*k{i}" for i, weight in enumerate(weights, 2))


def _evaluations_of_line(line: Line) -> int:
    return len(line.evaluations) if isinstance(line, Solve) else int(isinstance(line, Evaluation))

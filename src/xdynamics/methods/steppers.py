"""How a method makes its steps: by its lines, by its lines over contacts, by collocation; here belongs one by jets.

A stepper knows what is not in the lines of its method: where derivatives may come from, what a step keeps for the next
one, who chooses that, and which force evaluations are made.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import ClassVar

EXACT, DIFFERENCES = JACOBIANS = ("exact", "differences")
CONTROLLER = (
    "PI: safety*norm**-alpha*norm_before**beta, beta = 0.2/k, alpha = 1/k - 0.75*beta, k = order of the estimate + 1"
    " (Hairer, Norsett, Wanner II.4 and IV.2; Gustafsson 1991, doi:10.1145/210232.210242)"
)


class Stepper:
    """What steps have in common.

    Attributes
    ----------
    jacobians : tuple of str
        Of `JACOBIANS`: where derivatives of the forces may come from.
    has_memory : bool
        Whether iterations begin where those of the step before ended, so that no step is repeated by itself to the bit.
    controller : str
        How the next step is chosen with an embedded formula.
    inner : (float, Decimal) or None
        Factor and power of the relative tolerance that steps are judged by then, where it is not that of the run.
    """

    jacobians: ClassVar[tuple[str, ...]] = (EXACT,)
    has_memory: ClassVar[bool] = False
    controller: ClassVar[str] = CONTROLLER
    inner: ClassVar[tuple[float, Decimal] | None] = None


@dataclass(frozen=True)
class Lines(Stepper):
    """The lines in their order; equations are solved by Newton's method with the Jacobian of every iterate."""


LINES = Lines()


@dataclass(frozen=True)
class TimeStepping(Lines):
    """The lines, then impulses of contacts over the whole step: no impact is located."""


@dataclass(frozen=True)
class Collocation(Stepper):
    """Stages solved for together, by simplified Newton iterations that keep derivatives and factors (`march.implicit`).

    Attributes
    ----------
    a : tuple of tuple of str
        The weights of the slopes at the stages in each stage, as texts, so that the equations have them as written; the last
        stage is the end of the step.
    c : tuple of str
        The stages' times, in steps.
    """

    a: tuple[tuple[str, ...], ...]
    c: tuple[str, ...]

    jacobians: ClassVar[tuple[str, ...]] = JACOBIANS
    has_memory: ClassVar[bool] = True
    controller: ClassVar[str] = (
        "predictive: safety*min(norm**(-1/4)*15/(i + 14), h/h_before*(norm_before/norm**2)**(1/4)), i = Newton"
        " iterations; a growth of up to 1.2 is left out after at most 2 of them or where they converge by theta <"
        " 0.001, for the sake of what is kept (Hairer, Wanner, Solving ODEs II, IV.8; Gustafsson 1994,"
        " doi:10.1145/198429.198437)"
    )
    inner: ClassVar[tuple[float, Decimal] | None] = (0.1, Decimal("0.8"))

    @property
    def template(self) -> str:
        """The update for y' = k: the stages from rest, their equations, the last stage."""
        numbers = range(2, 2 + len(self.c))
        times = ["t1" if c == "1" else f"t + {c}*h" for c in self.c]
        starts = [f"y{i} = y + {'' if c == '1' else f'{c}*'}h*k" for i, c in zip(numbers, self.c, strict=True)]
        slopes = [f"    k{i} = f({time}, y{i})" for i, time in zip(numbers, times, strict=True)]
        stages = [f"    y{i} = y + h*({_sum(row)})" for i, row in zip(numbers, self.a, strict=True)]
        solve = f"solve {', '.join(f'y{i}' for i in numbers)}:"
        return "\n".join([*starts, solve, *slopes, *stages, f"y1 = y{numbers[-1]}", "k1 = f(t1, y1)"])


def _sum(weights: Sequence[str]) -> str:
    return " + ".join(f"{weight}*k{i}" for i, weight in enumerate(weights, 2))

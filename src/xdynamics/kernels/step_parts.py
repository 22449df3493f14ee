"""What a step of a method consists of: its programs, the equations that it solves, its working memory."""

from __future__ import annotations

from dataclasses import dataclass

from xdynamics.kernels.newton_matrix import NewtonSystem
from xdynamics.kernels.program import Program


@dataclass(frozen=True)
class Steps:
    """The programs of one step.

    Attributes
    ----------
    programs : tuple of Program
        One for an explicit method. Where equations are solved: what comes before, one iteration, what comes after, and
        so on; last the derivatives along a direction, where a matrix is found group by group.
    equations : tuple of Equations
    memory : int
        Numbers of the working memory; the last ones are the coefficients of the step's polynomial, where it leaves one.
    """

    programs: tuple[Program, ...]
    equations: tuple[NewtonSystem, ...]
    memory: int

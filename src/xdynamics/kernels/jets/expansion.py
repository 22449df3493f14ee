"""Expansion of a program of forces: the Taylor coefficients of coordinates, velocities and states.

With k for the order, k q[k] = v[k-1], k v[k] = a[k-1], k x[k] = r[k-1], where a and r are the series of the
accelerations and rates along those of q, v and x: every value of the program has its series, by the recurrences of its
operation.
"""

from __future__ import annotations

from dataclasses import dataclass

from xdynamics.kernels.jets.elements import looped_lines
from xdynamics.kernels.jets.motion import Motion, is_small, needed_lines
from xdynamics.kernels.jets.written_out import written_lines
from xdynamics.kernels.program import Program


@dataclass(frozen=True)
class Expansion:
    """The program that expands a motion.

    Attributes
    ----------
    program : Program
        It fills `w`: coefficient k of number i of the state is at first + k*used + i, for k up to the degree.
    memory : int
        Where in `w` what it uses ends.
    written_out : bool
        Whether every coefficient is a value of the text; else orders are a loop.
    """

    program: Program
    memory: int
    written_out: bool


def expansion(
    forces: Program,
    motion: Motion,
    degree: int,
    first: int = 0,
    *,
    written_out: bool | None = None,
    fused: bool = False,
) -> Expansion:
    """Return the program that expands the motion by some forces.

    Parameters
    ----------
    forces : Program
    motion : Motion
    degree : int
        The highest order of a coefficient.
    first : int
        Where in `w` coefficients begin.
    written_out : bool, optional
        Whether every coefficient is to be a value of the text; by default where they are few.
    fused : bool
        Whether products are added by fma, and quotients by what stays the same are products with reciprocals of 106 bits:
        of floats alone, as other kinds of numbers are to have the exact ones.

    Raises
    ------
    UnexpandedError
        If the program calls what has no series.
    """
    body = needed_lines(forces.body, motion)
    if written_out is None:
        written_out = is_small(body, degree, fused=fused)
    lines = (written_lines if written_out else looped_lines)(forces, body, motion, degree, first, fused=fused)
    about = f"The Taylor coefficients of the motion, to order {degree}."
    tables = {**forces.tables, **lines.tables}
    program = Program("expand", about, tuple(lines.lines), views=lines.views, tables=tables)
    return Expansion(program, lines.memory, written_out)

"""The page of help on constraints, before the keys of their section."""

from __future__ import annotations

from collections.abc import Iterator

CONSTRAINTS_PAGE = """\
A constraint keeps an expression at zero. Its multiplier is found with the accelerations:
  constraint_force_rod      the force on a coordinate is it times the derivative by that;
                            of norm(r, axis) - L in metres it is newtons along r
  constraint_residual_rod   the expression itself; constraint_rate_rod its time derivative
  constraint_rank           how many are independent; those that imply each other share their force:
                            of all shares, that of least norm, each weighed by what it moves alone
  constraint_projection     how far off a step's result was, over the size of its terms, before it
                            was put back, to 1e-12: positions, then velocities, by the masses
Time may occur in it: a guide that moves. With dimensions it is one for each element:
  [constraints.rod]  holds = "norm(r - shift(r, bead, 1, 0*metre), axis) - L"

Methods: explicit, implicit and Taylor methods keep their orders. velocity_verlet, position_verlet,
euler_cromer and the compositions of velocity Verlet are made RATTLE, with impulses of constraints
in every drift: energy does not drift. ruth3, pefrl and dprkn6 would lose their order, and refuse.

The motion has to start where constraints hold; else the message has the nearest such state, and
[initial] consistent = true goes there. Impacts and friction obey constraints. Balls, hinges,
sliders and welds of bodies need not be written out: `xdynamics help joints`.

What rolls without any slip is a constraint. A wheel that also slips, where more force were needed
than Coulomb's law allows, is dry friction, whose sticking is the same constraint:
  [frictions.lane]  slip = "v_x - R*v_theta/radian"  kinetic = "mu*m*g"
Of a ball thrown with backspin, event stick is where it begins to roll; slip is where that ends.

Singular positions, where a constraint is implied by others for an instant, are passed: within about
3e-4 (radians, say) of one the weakest is not kept, which leaves some eight digits of the motion.

"""


def constraints_page(section: Iterator[str]) -> Iterator[str]:
    """Explain how constraints are kept, and then the keys of their section."""
    yield from CONSTRAINTS_PAGE.splitlines()
    yield from section

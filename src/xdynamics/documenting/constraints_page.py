"""The page of help on constraints, before the keys of their section."""

from __future__ import annotations

from collections.abc import Iterator

CONSTRAINTS_PAGE = """\
A constraint keeps an expression at zero. Of [constraints.rod] the record has
  constraint_force_rod      its multiplier: times the derivative of the expression by a coordinate
                            it is the force on that; of norm(r, axis) - L it is in N, along r
  constraint_residual_rod   the value of the expression; constraint_rate_rod, its time derivative
  constraint_rank           how many constraints are independent. Where some imply others, many sets
                            of multipliers give the same motion: the one of least norm is taken,
                            each weighed by how much it accelerates the bodies when it acts alone
  constraint_projection     the largest residual at the end of a step, over the size of its terms,
                            before positions, then velocities, are put back onto the constraints
It may read t, as for a guide that moves. With dimensions there is one constraint for each element:
  [constraints.rod]  holds = "norm(r - shift(r, bead, 1, 0*metre), axis) - L"

Explicit, implicit and Taylor methods keep their orders. velocity_verlet, position_verlet,
euler_cromer and the compositions of velocity Verlet become RATTLE, with impulses of constraints in
every drift, so that energy does not drift. ruth3, pefrl and dprkn6 would lose their order: refused.

Constraints have to hold at the start; if they do not, the error message has the nearest state where
they do, and [initial] consistent = true starts there. Impacts and friction obey constraints. Balls,
hinges, sliders and welds of bodies need not be written out: `xdynamics help joints`.

Rolling without any slip is a constraint. A wheel that slips when rolling would take more force than
Coulomb's law allows is dry friction, which while it sticks is the same constraint:
  [frictions.lane]  slip = "v_x - R*v_theta/radian"  kinetic = "mu*m*g"
For a ball thrown with backspin, the event stick is when it begins to roll, and slip when that ends.

A march passes singular positions, where for an instant one constraint follows from others: within
about 3e-4 (in radians, say) of one the weakest is not kept, and some eight digits are left.

"""


def constraints_page(section: Iterator[str]) -> Iterator[str]:
    """Explain how constraints are kept, and then the keys of their section."""
    yield from CONSTRAINTS_PAGE.splitlines()
    yield from section

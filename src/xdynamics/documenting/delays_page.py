"""The page of help on delayed values, before the section that says what was before the start."""

from __future__ import annotations

from collections.abc import Iterator

DELAYS_PAGE = """\
delayed(x, "20 ms") is x as it was 20 ms ago. The delay is a quantity in quotes, a parameter or a
constant expression, a positive time that does not change; what is delayed is any expression:
  [forces.servo]
  x = "-k*delayed(x, tau) - d*delayed(v_x, '20 ms')"
It stands in components of forces, rates of states, events and what they set, controllers,
observables, and definitions of these. Coordinates, velocities, states, what controllers hold and
drives may be delayed, each by several times; in it t is the time back then.

Up to the start a value is the one at the start, or what [history] says; solver_delay_history in the
record says which. A jump from the one to the other is met like any other jump.

The past is kept as polynomials of the accepted steps by the method's own dense output:
  dop853                      of degree 7, which leaves order 8
  dormand_prince              of degree 4, which leaves order 5
  other methods up to order 4 Hermite's cubic, which leaves their order
(solver_delay_interpolation). Methods of higher orders by Hermite's cubic, radau_iia and taylor
refuse. No step is longer than the shortest delay.

Where the motion has a jump or a kink, at the start, a tick, a point of a table, an impact, a reset
or a switch, it has a smoother one a delay later, two delays later, and so on: the march lands on
them all, as nodes, as long as the method can tell them from none (solver_breaking_points).

A record without all of its rows, as by keep_every, is reproduced and extended, but not sampled.
Members of sweeps are marched one after the other, and slopes of budgets and fits are differences.
Proofs, modes, variational equations, precision = "double_double", constraints, bodies and models
with dimensions do not go with delays, and say so.

"""


def delays_page(section: Iterator[str]) -> Iterator[str]:
    """Explain delayed values, and then the keys of the section of what was before the start."""
    yield from DELAYS_PAGE.splitlines()
    yield from section

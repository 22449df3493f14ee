"""The page of help on joints, before the keys of their section."""

from __future__ import annotations

from collections.abc import Iterator

JOINTS_PAGE = """\
A joint holds two bodies together, or a body and `space`, which does not move:
  ball    in one point                                               3 conditions
  hinge   in one point, turning about one axis                       5
  slider  the second along an axis of the first, unturned in it      5
  rigid   as one body: in one point, unturned                        6
Points and axes are written in the axes of each body. Points of space may read t, and move.

Recorded are the force in N and the torque in N m that the second does to the first, at the point
of the second, along x, y and z of space:
  joint_force_elbow, joint_torque_elbow      (of a ball there is no torque)
In expressions of forces, events, observables stand
  elbow_angle    how far the second has turned about a hinge's axis in the first; without a break
                 up to a whole turn either way; 0 where the axes of both are aligned
  v_elbow_angle  how fast it turns
  rail_travel    how far the point of the second is along a slider's axis from that of the first
so that potential = "k*elbow_angle**2/2" is a torsion spring between both.

A joint stands for constraints, which have multipliers, residuals and rates in the record, too:
  elbow_point    one point less the other, along axis
  rail_across_1, rail_across_2           the same of a slider, across its axis
  elbow_turn_1, elbow_turn_2, weld_turn  small angles by which directions are off
The motion has to start with every joint together, else the message has the nearest such state, and
[initial] consistent = true goes there. In closed loops of hinges some conditions imply each other:
constraint_rank tells how many act, and what the motion does not tell, as forces across its plane,
is shared by least norm (`xdynamics help constraints`).

"""


def joints_page(section: Iterator[str]) -> Iterator[str]:
    """Explain what joints keep and what is recorded of them, and then the keys of their section."""
    yield from JOINTS_PAGE.splitlines()
    yield from section

"""The page of help on rigid bodies, before the keys of their section."""

from __future__ import annotations

from collections.abc import Iterator

BODIES_PAGE = """\
A body `frame` in [bodies.frame] stands for
  frame_r       position of its centre of mass in space, along axis; absent with a pivot
  v_frame_turn  its angular velocity, along its own axes; frame_turn, its integral, has no meaning
  frame_q0      the scalar part, and
  frame_q       the vector part of its attitude, a unit quaternion that turns body to space axes
  frame_spin    its angular momentum about the centre of mass, or the pivot, in space
  frame_tip     where its point `tip` is in space, and v_frame_tip how fast that moves
Expressions may read, for a point that has a name or is given by its components in the body,
  point(frame, tip), point(frame, [0*metre, 0*metre, l])   where it is
  velocity(frame, tip), velocity(frame, [0*metre, …])      how fast it moves
  direction(frame, [0, 0, 1])                              what a vector of the body is in space
and `centre` is the point at its origin. All are vectors along axis: frame_tip[z] is the height of a
named point, norm(point(frame, tip) - point(base, hook), axis) the distance between two points.

Forces and torques are given in [bodies.frame]; gyroscopic terms are added: force frame_gyroscopic.
A potential may read points: [forces.gravity] potential = "m*g*frame_tip[z]" acts on position and
attitude, and the energy is known. Gaps of contacts and slips of frictions may not read attitudes.
In a model with regimes, forces of bodies act in the regimes that name them; unnamed ones in all.

After every step the quaternion is scaled back to length 1; attitude_deviation is how far from 1 it
was, which falls with the step's error. With precision = "double_double" it is not scaled.
The attitude as a rotation of scipy's:
  Rotation.from_quat(np.column_stack([run.frame_q0, run.frame_q]), scalar_first=True)
and run.dynamics.animate("film.gif") shows bodies by their points, joints and ellipsoids of inertia.

"""


def bodies_page(section: Iterator[str]) -> Iterator[str]:
    """Explain what bodies stand for, and then the keys of their section."""
    yield from BODIES_PAGE.splitlines()
    yield from section

"""The page of help on rigid bodies, before the keys of their section."""

from __future__ import annotations

from collections.abc import Iterator

BODIES_PAGE = """\
A body `frame` in [bodies.frame] stands for
  frame_r       position of its centre of mass in space, with the dimension axis; not with a pivot
  v_frame_turn  its angular velocity, along its own axes; its integral frame_turn means nothing
  frame_q0      the scalar, and
  frame_q       the vector of its attitude, a unit quaternion turning vectors of it to space
  frame_spin    its angular momentum about the centre of mass, or the pivot, in space
  frame_tip     where its point `tip` is in space, and v_frame_tip how fast that moves
In expressions stand, of a point with a name or of components in the body,
  point(frame, tip), point(frame, [0*metre, 0*metre, l])   where it is
  velocity(frame, tip), velocity(frame, [0*metre, …])      how fast it moves
  direction(frame, [0, 0, 1])                              what a vector of the body is in space
and `centre` is the point at its origin. All are vectors along axis: frame_tip[z] is the height of a
point with a name, norm(point(frame, tip) - point(base, hook), axis) a distance of two.

Forces and torques stand in the body. Gyroscopic terms need not be written: force frame_gyroscopic.
A potential may read points: [forces.gravity] potential = "m*g*frame_tip[z]" acts on position and
attitude, and the energy is known. Gaps of contacts and slips of frictions read no attitude.
In models with regimes, forces of bodies act in those that name them, else in all.

After every step the quaternion is brought back to length 1; attitude_deviation has how far from 1
it was, which falls with the error of the step. With precision = "double_double" it is left.
Attitudes as scipy has them are
  Rotation.from_quat(np.column_stack([run.frame_q0, run.frame_q]), scalar_first=True)
and run.dynamics.animate("film.gif") shows bodies by their points, joints and ellipsoids of inertia.

"""


def bodies_page(section: Iterator[str]) -> Iterator[str]:
    """Explain what bodies stand for, and then the keys of their section."""
    yield from BODIES_PAGE.splitlines()
    yield from section

"""The pages of help on parts of a model: bodies, constraints, delays, joints, quantities with dimensions.

Lines of help no wider than a window usually is.

The page of help on rigid bodies, before the keys of their section.

The page of help on constraints, before the keys of their section.

The page of help on delayed values, before the section that says what was before the start.

The page of help on joints, before the keys of their section.

The page of help on quantities with dimensions.
"""

from __future__ import annotations

from collections.abc import Iterator
from textwrap import wrap

from xdynamics.expressions.parser import FORMS

WIDTH = 100  # of a line


def wrapped_lines(text: str, hang: int = 0) -> list[str]:
    """Return lines of at most `WIDTH` characters, those after the first indented by `hang`; words stay whole.

    Examples
    --------
    >>> wrapped_lines("  name  " + "many " * 20, 8)
    ['  name  many many many many many many many many many many many many many many many many many many', '        many many']
    """
    return wrap(text, WIDTH, subsequent_indent=" " * hang, break_long_words=False, break_on_hyphens=False)


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


MEANINGS = {
    "sum": "the sum over one dimension, or several: sum(a, body, axis), added in ascending order",
    "mean": "the sum over the number of elements",
    "min": "the least element, if the last argument is a dimension; min(a, b) compares two values",
    "max": "the greatest element, likewise",
    "norm": "the square root of the sum of squares",
    "dot": "the sum of products",
    "cross": "the vector product along a dimension of three elements, which the result keeps",
    "first": "the value of a at the first end of each link",
    "second": "the value of a at the second end of each link",
    "shift": "the value n places earlier, as in xarray; beyond the end fill, in the unit of a, like 0*metre",
    "roll": "the value n places earlier, the dimension closed into a ring",
    "take": "the element with that number, an expression of index, size and whole numbers",
    "index": "the number of each element, from 0",
    "size": "how many elements there are",
}
MODEL = """\
name = "Sun and two planets"
[dimensions]
body = ["Sun", "Jupiter", "Saturn"]        # labels, or a number of elements: site = 100
axis = ["x", "y", "z"]
[relations.pair]
of = "body"                                # every two; or neighbours = 1: each with the next
[coordinates]
r = { unit = "m", dims = ["body", "axis"] }
[parameters]
m = { dims = ["body"], values = { Sun = "2e30 kg", Jupiter = "1.9e27 kg", Saturn = "5.7e26 kg" } }
G = "6.6743e-11 N m2 kg-2"
[mass]
r = "m"                                    # over body, the same for every axis
[forces.gravity]
over = "pair"                              # or r = "…": the force on the first of each
potential = "-G*first(m, pair)*second(m, pair)/norm(second(r, pair) - first(r, pair), axis)"
[initial]                                  # a row for each body, a column for each axis
r = { unit = "astronomical_unit", value = [[0, 0, 0], [5.2, 0, 0], [0, 9.58, 0]] }
v_r = { unit = "m s-1", value = [[0, 0, 0], [0, 13060, 0], [-9680, 0, 0]] }
[run]
method = "yoshida6"
step = "30 day"
until = "30 year"
""".splitlines()


CLOSING = (
    "An expression may have only the dimensions of what it is written for; along those it lacks it is the same for all elements.",
    "In [mass], matrix = [[…], …] has an entry for every two coordinates; it couples elements whose shared dimensions agree.",
    "A potential is summed over its dimensions. An event, contact or friction with dimensions stands for one per element.",
    (
        'So discs in a box have [contacts.floor] gap = "take(r, axis, 1) - R", one for each, and [contacts.discs] gap ='
        ' "norm(second(r, pair) - first(r, pair), axis) - 2*R", one for each pair. With friction, slip is the velocity of'
        " the second minus that of the first across the line between them, counterclockwise, minus R*(first(v_theta, pair) +"
        " second(v_theta, pair))/radian. Pictures and films draw bodies where one coordinate has them along a dimension and"
        " their two or three axes along another."
    ),
    (
        "Each located event adds two rows to the record, with the states of all elements: n elements with an event each make 2*n*n"
        " numbers of each quantity; a run that needs more memory than there is ends with an error. So log what is needed"
        " (log = ['u[0]'], in Python too), stream it to a file (-o, path=…), or take one event for all, whose function is"
        " max(…, dimension), min or sum: it is located where the first of them crosses."
    ),
    (
        "Besides its record and 20 MB, a march of many masses in one dimension takes some 80 bytes for each by velocity_verlet,"
        " 110 by rk4, 165 by dormand_prince, 225 by dop853; of which velocities and accelerations of stages still to"
        " be read take 48, 72 and 128. A state by radau_iia takes 336: factors of a real and a complex band of three 104, derivatives and their places 60,"
        " stages 72 and a state for them 16, states at both ends 32, errors, tolerances and sizes 28, a row of the log 24. In a"
        " band of n below the diagonal and m above it the factors take 24*(2*n + m + 1) + 8: for a field in two dimensions"
        " they are by far the largest part, and a march without room for them is refused before it begins."
    ),
    (
        "Values are a list (of lists), values = { label = … } (of two dimensions { label = { label = … } }), an expression of"
        " index(…), beside a unit where it is a pure number, at the start an expression of parameters too, or a table:"
        ' r = { table = "planets.csv", columns = ["x", "y", "z"] }, whose rows are matched by a column `body` of labels, one for'
        " each, or taken in order."
    ),
    (
        "The table of a relation has the columns first and second; each other column that forces use is declared as a parameter along"
        ' the relation: k = { dims = ["spring"], table = "springs.csv", column = "k" }.'
    ),
    (
        "In Python they may also be NumPy arrays, DataFrames in place of tables, and DataArrays, which have their unit in the"
        " attribute units and may stand in any order of dimensions and labels: model.replace(initial={'r': run.r.isel(step=-1)})."
    ),
    (
        "refine reports the states after each event: after_ground_r are those of the element that the event is of, and"
        " all_after_ground_r(level, occurrence, event_body, body, axis) those of all elements at the event of each, up to a"
        " million numbers; beyond, the attribute left_out says what to ask for."
    ),
    "Elsewhere an element is named by its labels or by its numbers from 0, of which -1 is the last: --quantity 'u[-1]', --axis 'm[Sun]=1:2:5 kg', model.replace(parameters={'m[Sun]': …}); a reset sets one by set = { 'v_u[3]' = \"…\" }, and in an event with dimensions each its own of what is set whole.",
)


def shapes_page() -> Iterator[str]:
    """Explain dimensions, relations, and what expressions do along them."""
    yield from wrapped_lines(
        "A quantity may have named dimensions. Expressions broadcast by these names, as xarray does. A whole model:"
    )
    yield from (f"  {line}" for line in MODEL)
    yield "Besides what `xdynamics help language` lists, expressions may use:"
    width = max(map(len, FORMS.values()))
    for name, form in FORMS.items():
        yield from wrapped_lines(f"  {form:{width}}  {MEANINGS[name]}", width + 4)
    yield f"  {'r[Jupiter, x], u[-1]':{width}}  one element, by labels or numbers, in the order of the dimensions"
    for line in CLOSING:
        yield from wrapped_lines(line)

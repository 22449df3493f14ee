"""Rigid bodies: their sections in a model file, and the coordinates, states, masses and forces that they add.

A section of a body has its inertia, its points, and the forces and torques that act on it.

A body ``frame`` has the position ``frame_r`` of its centre of mass, and the attitude q = ``frame_q0`` + ``frame_q``, a
unit quaternion of a scalar and a vector that turns components in the body to those in space. Its angular velocity w in
the body's axes is the velocity of ``frame_turn``, a quasi-coordinate: that has a mass, the inertia I, and forces, the
torques, but no meaning of its own. With L = I w

    I w' = torque - w x L,    q0' = -q.w/2,    q' = (q0 w + q x w)/2

(Goldstein, Classical Mechanics, 3rd ed., sections 4.5 and 5.5; Hairer, Lubich, Wanner, Geometric Numerical Integration,
2nd ed., VII.5). All else, from energies to events, follows from what the language has.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import reduce
from typing import Any

from xdynamics.expressions import Along, Binary, Call, Compare, Name, Node, Number, text_of
from xdynamics.expressions.calculus import ZERO, add, multiply, negative
from xdynamics.faults import InputError, brief_repr
from xdynamics.model.controllers import entries_of
from xdynamics.model.kinds import LIMIT, Kind, Source, raw, word_kind
from xdynamics.model.section import DESCRIPTION, NEEDED, Key, Section
from xdynamics.schema import velocity
from xdynamics.shapes import Shapes, gradient

SPACE, BODY = FRAMES = ("space", "body")  # whose axes components are along
CENTRE = "centre"  # the point that needs no name: the centre of mass, or the pivot
AXES = ("x", "y", "z")
ORIGIN = Name(CENTRE)
Triple = tuple[Node, Node, Node]


@dataclass(frozen=True)
class Push:
    """A force on a body at a point: one with a name, or one by its coordinates in the body."""

    force: Triple
    at: Name | Triple = ORIGIN
    axes: str = SPACE
    description: str = ""


@dataclass(frozen=True)
class Torque:
    """A torque on a body."""

    torque: Triple
    axes: str = BODY
    description: str = ""


@dataclass(frozen=True)
class Body:
    """A rigid body that turns, by the keys of `[bodies]`.

    `inertia` is one row of principal moments, or three rows; of a body with a pivot, about that.
    """

    inertia: tuple[Triple, ...]
    mass: Node | None = None
    pivot: Triple | None = None
    attitude: str = "quaternion"
    points: Mapping[str, Triple] = field(default_factory=dict)
    forces: Mapping[str, Push] = field(default_factory=dict)
    torques: Mapping[str, Torque] = field(default_factory=dict)
    dims: tuple[str, ...] = ()
    description: str = ""

    @property
    def has_products(self) -> bool:
        """Whether its axes are not principal ones."""
        return len(self.inertia) > 1


def triple(value: Any, key: str, source: Source) -> Triple:
    """Read three quantities or expressions.

    Raises
    ------
    InputError
        If there are not three, or one cannot be read.
    """
    if not isinstance(value, list | tuple) or len(value) != len(AXES):
        count = f"{len(value)} components" if isinstance(value, list | tuple) else "no list"
        raise InputError(f"{key} is {brief_repr(value)}, {count}; it needs three, along x, y and z")
    x, y, z = (LIMIT.read(entry, f"{key}[{axis}]", source) for entry, axis in zip(value, AXES, strict=True))
    return x, y, z


def _text_values(values: Triple, *_: Any) -> list[str]:
    return [text_of(value) for value in values]


def _read_inertia(value: Any, key: str, source: Source) -> tuple[Triple, ...]:
    """Read principal moments, or a symmetric matrix."""
    if not isinstance(value, list | tuple) or len(value) != len(AXES):
        raise InputError(f"{key} is {brief_repr(value)}; it needs three principal moments, or three rows of three")
    if not any(isinstance(row, list | tuple) for row in value):
        return (triple(value, key, source),)
    return tuple(triple(row, f"{key} row {axis}", source) for row, axis in zip(value, AXES, strict=True))


def _read_point(value: Any, key: str, source: Source) -> Name | Triple:
    return Name(value) if isinstance(value, str) else triple(value, key, source)


def _read_points(value: Any, key: str, source: Source) -> dict[str, Triple]:
    if not isinstance(value, Mapping):
        raise InputError(
            f'{key} is {brief_repr(value)}, needs a table of points, like {{ tip = ["0 m", "0 m", "0.3 m"] }}'
        )
    return {str(name): triple(point, f"point '{name}'", source) for name, point in value.items()}


def _read_body_dims(value: Any, key: str, _: Source) -> tuple[str, ...]:
    if not isinstance(value, list | tuple) or not all(isinstance(name, str) for name in value):
        raise InputError(f'{key} is {brief_repr(value)}, needs a list of dimensions, like ["link"]')
    return tuple(value)


TRIPLE = Kind("three quantities or expressions", triple, _text_values, None)
INERTIA = Kind(
    "three quantities or expressions, or three rows of three",
    _read_inertia,
    lambda rows, _: _text_values(rows[0]) if len(rows) == 1 else [*map(_text_values, rows)],
)
POINTS = Kind(
    "table of points, each three quantities or expressions",
    _read_points,
    lambda points, _: {name: _text_values(point) for name, point in points.items()},
    {},
)
DIMENSIONS = Kind("list of dimensions", _read_body_dims, lambda dims, _: list(dims), ())
PLACE = Kind(
    "name of a point, or three quantities or expressions",
    _read_point,
    lambda point, _: point.name if isinstance(point, Name) else _text_values(point),
    ORIGIN,
)

PUSH = Section(
    "a force on a body",
    "force",
    (
        Key("force", TRIPLE.with_unit("N"), "its components", NEEDED),
        Key("at", PLACE.with_unit("m, in the body"), "where it acts", CENTRE),
        Key("axes", word_kind(*FRAMES), "what its components are along", SPACE, omitted=SPACE),
        DESCRIPTION,
    ),
    "",
    make=Push,
)
TORQUE = Section(
    "a torque on a body",
    "torque",
    (
        Key("torque", TRIPLE.with_unit("N m"), "its components", NEEDED),
        Key("axes", word_kind(*FRAMES), "what its components are along", BODY, omitted=BODY),
        DESCRIPTION,
    ),
    "",
    make=Torque,
)
KEYS = (
    Key(
        "mass",
        LIMIT.with_unit("kg"),
        "of the body; a quantity becomes the parameter <body>_mass",
        "needed without pivot",
    ),
    Key(
        "inertia",
        INERTIA.with_unit("kg m2"),
        "about the centre of mass, or about the pivot: principal moments, or a symmetric matrix; quantities become the"
        " parameters <body>_inertia_x, or <body>_inertia_xx, …",
        NEEDED,
    ),
    Key(
        "pivot",
        TRIPLE.with_unit("m"),
        "a point fixed in space about which the body turns, and which is its origin",
        "none",
    ),
    Key("attitude", word_kind("quaternion"), "what describes how it is turned", "quaternion", omitted="quaternion"),
    Key(
        "points",
        POINTS.with_unit("m, in the body"),
        "points of the body, which expressions read: <body>_<point>",
        "none",
    ),
    Key("forces", entries_of(PUSH), "that act on it", "none"),
    Key("torques", entries_of(TORQUE), "that act on it", "none"),
    Key("dims", DIMENSIONS, "of many bodies: one for each element", "none"),
    Key(
        "initial",
        raw("table with position, velocity (m, m s-1, in space), attitude, angular_velocity (rad s-1, in the body)"),
        'where it starts, else at rest at 0; attitude = [w, x, y, z], or { axis = [0, 0, 1], angle = "30 degree" }; or as'
        " entries of [initial]",
        "unturned, at rest",
        is_rewritten=False,
    ),
    DESCRIPTION,
)


AXIS = "axis"  # the dimension of vectors
LONGEST_NAME = 20  # of bodies and joints: those of what they stand for begin with it
GYROSCOPIC = "gyroscopic"  # the force that every body has by turning
TWO = Number(2.0)
Tables = dict[str, dict[str, Any]]


def position(body: str) -> str:
    """Name the position of a body's centre of mass."""
    return f"{body}_r"


def quasi_coordinate(body: str) -> str:
    """Name the quasi-coordinate whose velocity is the angular velocity in the body."""
    return f"{body}_turn"


def scalar_part(body: str) -> str:
    """Name the scalar part of the quaternion."""
    return f"{body}_q0"


def vector_part(body: str) -> str:
    """Name the vector part of the quaternion."""
    return f"{body}_q"


def vector(components: Triple) -> Node:
    """Return three components as one expression along `axis`."""
    x, y, z = components
    if x == y == z:
        return x
    number = Along("index", (), (AXIS,))
    y_or_z = y if y == z else Call("where", (Compare("==", number, Number(1.0)), y, z))
    return Call("where", (Compare("==", number, ZERO), x, y_or_z))


def cross_product(a: Node, b: Node) -> Node:
    """Return a cross product."""
    return Along("cross", (a, b), (AXIS,))


def to_space_axes(body: str, a: Node) -> Node:
    """Return a vector of a body by its components in space: a + 2 q x (q x a + q0 a)."""
    return _rotate_vector(body, a, "+")


def to_body_axes(body: str, a: Node) -> Node:
    """Return a vector in space by its components in a body: the inverse of `to_space_axes`."""
    return _rotate_vector(body, a, "-")


def _rotate_vector(body: str, a: Node, sign: str) -> Node:
    q, q0 = Name(vector_part(body)), Name(scalar_part(body))
    inner = Binary(sign, cross_product(q, a), Binary("*", q0, a))
    return Binary("+", a, Binary("*", TWO, cross_product(q, inner)))


def point_position(name: str, pivot: Triple | None, arm: Triple | None) -> Node:
    """Return where a point of a body is in space; without an arm its centre."""
    origin = vector(pivot) if pivot else Name(position(name))
    return origin if arm is None else Binary("+", origin, to_space_axes(name, vector(arm)))


def point_velocity(name: str, pivot: Triple | None, arm: Triple | None) -> Node:
    """Return the velocity of a point of a body, by its components in space."""
    origin = None if pivot else Name(velocity(position(name)))
    if arm is None:
        return origin or Binary("*", ZERO, Binary("/", point_position(name, pivot, None), Name("second")))
    swing = to_space_axes(name, cross_product(Name(velocity(quasi_coordinate(name))), vector(arm)))
    return Binary("+", origin, swing) if origin else swing


def tables_of_body(name: str, body: Body) -> Tables:
    """Return the entries of a body for the sections of a model file."""
    dims, w = [*body.dims, AXIS], Name(velocity(quasi_coordinate(name)))
    q0, q = Name(scalar_part(name)), Name(vector_part(name))
    rate0 = negative(Binary("/", Along("dot", (q, w), (AXIS,)), TWO))
    rate = Binary("/", Binary("+", Binary("*", q0, w), cross_product(q, w)), TWO)
    about = f"of body {name}"
    position_entry = {"unit": "m", "dims": dims, "description": f"centre of mass {about}"}
    turn_entry = {
        "unit": "rad",
        "dims": dims,
        "description": f"integral of the angular velocity {about} in its own axes",
    }
    scalar = {"unit": "1", "rate": text_of(rate0), "description": f"attitude {about}, scalar of the unit quaternion"}
    versor = {"unit": "1", "dims": dims, "rate": text_of(rate), "description": f"attitude {about}, vector of it"}
    coordinates, mass = {quasi_coordinate(name): turn_entry}, {quasi_coordinate(name): f"{name}_inertia"}
    if body.mass is not None:
        coordinates, mass = (
            {position(name): position_entry, **coordinates},
            {position(name): text_of(body.mass), **mass},
        )
    return {
        "coordinates": coordinates,
        "states": {
            scalar_part(name): scalar | ({"dims": [*body.dims]} if body.dims else {}),
            vector_part(name): versor,
        },
        "mass": mass,
        "definitions": {key: text_of(tree) for key, tree in _body_definitions(name, body)},
        "forces": {key: {on: text_of(tree) for on, tree in parts.items()} for key, parts in _body_forces(name, body)},
    }


def _body_definitions(name: str, body: Body) -> Iterator[tuple[str, Node]]:
    """Yield the inertia, the angular momentum about the centre in space, and points with their velocities."""
    moments = body.inertia[0] if not body.has_products else tuple(body.inertia[i][i] for i in range(len(AXES)))
    x, y, z = moments
    yield f"{name}_inertia", vector((x, y, z))
    yield f"{name}_spin", to_space_axes(name, _spin(name, body))
    for key, arm in body.points.items():
        yield f"{name}_{key}", point_position(name, body.pivot, arm)
        yield velocity(f"{name}_{key}"), point_velocity(name, body.pivot, arm)


def _spin(name: str, body: Body) -> Node:
    """Return the angular momentum in the body's axes, I w."""
    w = velocity(quasi_coordinate(name))
    if not body.has_products:
        return Binary("*", Name(f"{name}_inertia"), Name(w))
    rows = (
        reduce(
            lambda total, term: Binary("+", total, term),
            (Binary("*", entry, _take_component(w, axis)) for axis, entry in enumerate(row)),
        )
        for row in body.inertia
    )
    x, y, z = rows
    return vector((x, y, z))


def _take_component(name: str, axis: int) -> Node:
    return Along("take", (Name(name), Number(float(axis))), (AXIS,))


def _body_forces(name: str, body: Body) -> Iterator[tuple[str, dict[str, Node]]]:
    """Yield the components of every force term, by coordinate."""
    gyroscopic = negative(cross_product(Name(velocity(quasi_coordinate(name))), _spin(name, body)))
    yield gyroscopic_term(name), {quasi_coordinate(name): gyroscopic}
    for key, push in body.forces.items():
        yield f"{name}_{key}", _push(name, body, push)
    for key, torque in body.torques.items():
        yield f"{name}_{key}", {quasi_coordinate(name): _torque_in_body(name, torque)}


def gyroscopic_term(body: str) -> str:
    """Name the force term that a body has by turning."""
    return f"{body}_{GYROSCOPIC}"


def _push(name: str, body: Body, push: Push) -> dict[str, Node]:
    force_vector = vector(push.force)
    force_in_body, outer = (
        (to_body_axes(name, force_vector), force_vector)
        if push.axes == SPACE
        else (force_vector, to_space_axes(name, force_vector))
    )
    parts: dict[str, Node] = {} if body.pivot else {position(name): outer}
    if (arm := arm_of(body, push.at)) is not None:
        parts[quasi_coordinate(name)] = cross_product(vector(arm), force_in_body)
    return parts


def _torque_in_body(name: str, torque: Torque) -> Node:
    torque_vector = vector(torque.torque)
    return to_body_axes(name, torque_vector) if torque.axes == SPACE else torque_vector


def arm_of(body: Body, body_point: Name | Triple) -> Triple | None:
    """Return the components of a point in the body; None of its centre."""
    if not isinstance(body_point, Name):
        return body_point
    return None if body_point.name == CENTRE else body.points[body_point.name]


def torques_of_potential(potential: Node, bodies: Mapping[str, Body], shapes: Shapes) -> dict[str, Node]:
    """Return the torques of a potential, by the quasi-coordinates of the bodies that it turns.

    Where V changes by g0 dq0 + g.dq, it changes by w.(q0 g - g0 q + g x q)/2 in time, of which that is the negative.
    """
    names = {part: body for body in bodies for part in (scalar_part(body), vector_part(body))}
    gradients = gradient(negative(potential), [*names], shapes)
    torques = dict[str, Node]()
    for body in dict.fromkeys(names[part] for part in gradients):
        q0, q = Name(scalar_part(body)), Name(vector_part(body))
        n0, n = gradients.get(q0.name, ZERO), gradients.get(q.name, ZERO)
        twice_torque = add(add(multiply(q0, n), negative(multiply(n0, q))), ZERO if n == ZERO else cross_product(n, q))
        torques[quasi_coordinate(body)] = Binary("/", twice_torque, TWO)
    return torques


def unit_quaternions(bodies: Mapping[str, Body], shapes: Shapes) -> Iterator[tuple[str, ...]]:
    """Yield the names of the four parts of the attitude of every body, and of every element of many."""
    for body in bodies:
        versors = shapes.elements(vector_part(body))
        for i, scalar in enumerate(shapes.elements(scalar_part(body))):
            yield scalar, *versors[len(AXES) * i : len(AXES) * (i + 1)]


def products_of_inertia(bodies: Mapping[str, Body]) -> dict[tuple[str, int, int], Node]:
    """Return the masses between the components of angular velocities, by quasi-coordinate, row and column."""
    return {
        (quasi_coordinate(name), i, j): body.inertia[i][j]
        for name, body in bodies.items()
        if body.has_products
        for i in range(len(AXES))
        for j in range(len(AXES))
    }

"""Rigid bodies: what each stands for among coordinates, states, masses, definitions and forces.

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
from functools import reduce
from typing import Any

from xdynamics.expressions import Along, Binary, Call, Compare, Name, Node, Number, text_of
from xdynamics.expressions.calculus import ZERO, add, multiply, negative
from xdynamics.model.body_sections import AXES, CENTRE, SPACE, Body, Push, Torque, Triple
from xdynamics.schema import velocity
from xdynamics.shapes import Shapes, gradient

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
    """Return what a body stands for, as entries of sections of a model file."""
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
    """Return what a potential does to bodies that it turns: the torque of every quasi-coordinate that it has one for.

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

"""Joints: the constraints that each stands for, and the force and the torque in it.

Points that are one are so by their difference in space, in metres. Directions are kept by the quaternion that takes the
axes of the second body, turned by the constant Q, to those of the first, p = q_a* q_b Q: twice the components of its
vector across a hinge's axis, or all three, are the small angles by which the bodies are off (Nikravesh, Computer-Aided
Analysis of Mechanical Systems, 1988, section 6.2.2: Euler parameters). Their gradients are unit vectors across each other
at every angle of a hinge: rows of 1 in metres and rows of 1 in radians, whatever the mechanism.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from math import sqrt
from typing import Any

from xdynamics.expressions import Along, Call, Name, Node, Number, text_of
from xdynamics.expressions.calculus import ONE, TWO, ZERO, add, multiply, negative
from xdynamics.faults import InputError, Ledger
from xdynamics.model.body_sections import (
    AXES,
    AXIS,
    CENTRE,
    LONGEST_NAME,
    SPACE,
    Triple,
    quasi_coordinate,
    scalar_part,
    vector,
    vector_part,
)
from xdynamics.model.grammar import SECTIONS
from xdynamics.model.joint_sections import BALL, HINGE, SLIDER, Joint, Numbers
from xdynamics.model.kinds import Source
from xdynamics.model.table_keys import suggestion
from xdynamics.reaction_names import constraint_force, joint_force, joint_torque
from xdynamics.schema import velocity
from xdynamics.shapes.naming import join_element_name

Quaternion = tuple[Node, Triple]


def with_joints(tables: dict[str, Any], source: Source, ledger: Ledger) -> None:
    """Add the constraints and definitions of joints to a statement; faults are noted."""
    joint_tables = tables.get("joints")
    if not isinstance(joint_tables, Mapping) or not joint_tables:
        return
    bodies = tables.get("bodies") or {}
    for title in ("constraints", "definitions"):
        if not isinstance(tables.setdefault(title, {}), dict):
            return  # said where it is read
    for name, entry in joint_tables.items():
        with ledger.entry(f"joint '{name}'"):
            _check_joint_name(name)
            joint = SECTIONS["joints"].read(name, entry, source)
            _check_bodies(joint, bodies)
            for title, made in tables_of_joint(name, joint).items():
                for key, expression in made.items():
                    if key in tables[title]:
                        entry_kind = SECTIONS[title].entry
                        raise InputError(
                            f"makes a {entry_kind} '{key}', and there is one; rename the joint, or the other"
                        )
                    tables[title][key] = expression


def _check_joint_name(name: str) -> None:
    if not (name.isascii() and name.isidentifier() and name[0] != "_" and len(name) <= LONGEST_NAME):
        raise InputError(
            f"a joint's name is a letter, then letters, digits and underscores, {LONGEST_NAME} at most: those of its"
            " constraints begin with it"
        )


def _check_bodies(joint: Joint, bodies: Mapping[str, Any]) -> None:
    """Refuse bodies that there are not, and points that they have not."""
    if SPACE in bodies:
        raise InputError(f"'{SPACE}' is what no body moves in, and there is a body of that name; rename that")
    for name, joint_point in zip(joint.bodies, joint.at, strict=True):
        if name == SPACE:
            continue
        if name not in bodies:
            raise InputError(f"{joint.kind}: there is no body '{name}'{suggestion(name, (*bodies, SPACE))}")
        body = bodies[name] if isinstance(bodies[name], Mapping) else {}
        if body.get("dims"):
            raise InputError(
                f"{joint.kind}: body '{name}' is many, along {', '.join(map(str, body['dims']))}, and a joint is of one;"
                ' write holds = "point(…) - point(…)" in [constraints]'
            )
        points = (CENTRE, *(body.get("points") or ()))
        if isinstance(joint_point, Name) and joint_point.name not in points:
            raise InputError(
                f"at: body '{name}' has no point '{joint_point.name}'{suggestion(joint_point.name, points)}"
            )


def tables_of_joint(name: str, joint: Joint) -> dict[str, dict[str, str]]:
    """Return the entries of a joint for the sections of a model file."""
    first, second = map(_point_text, joint.bodies, joint.at)
    separation = f"{first} - ({second})"
    kind, across = joint.kind, _across(joint)
    constraints = dict[str, str]()
    if kind == SLIDER:
        for key, normal in zip(_slider_constraints(name), across, strict=True):
            constraints[key] = f"dot({_direction_text(joint.bodies[0], normal)}, {separation}, {AXIS})"
    else:
        constraints[_point_constraint(name)] = separation
    if kind != BALL:
        _, relative_vector = _relative_attitude(joint, _taken_components)
        off = [multiply(TWO, negative(_numeric_dot(normal, relative_vector))) for normal in _fixed_directions(joint)]
        constraints |= {
            key: text_of(tree)
            for key, tree in zip(_turn_constraints(name, joint), _constraint_entries(off), strict=True)
        }
    return {"constraints": constraints, "definitions": dict(_joint_definitions(name, joint, separation))}


def _joint_definitions(name: str, joint: Joint, separation: str) -> Iterator[tuple[str, str]]:
    """Yield how far a hinge has turned, and how fast it does, or how far a slider has gone."""
    if joint.kind == HINGE:
        scalar, relative_vector = _relative_attitude(joint, _taken_components)
        angle = multiply(TWO, Call("atan2", (_numeric_dot(joint.axes[0], relative_vector), scalar)))
        yield f"{name}_angle", text_of(angle)
        rate: Node = ZERO
        for body, axis, sign in zip(joint.bodies, joint.axes, (-1.0, 1.0), strict=True):
            if body != SPACE:
                spin = _taken_components(velocity(quasi_coordinate(body)))
                rate = add(rate, _numeric_dot([sign * part for part in axis], spin))
        yield velocity(f"{name}_angle"), text_of(rate)
    if joint.kind == SLIDER:
        yield f"{name}_travel", f"-dot({_direction_text(joint.bodies[0], joint.axes[0])}, {separation}, {AXIS})"


def made_by_joints(joints: Mapping[str, Joint], title: str) -> set[str]:
    """Return the entries of a section that joints stand for."""
    return {key for name, joint in joints.items() for key in tables_of_joint(name, joint).get(title, ())}


def joint_reactions(joints: Mapping[str, Joint]) -> dict[str, Node]:
    """Return the force and the torque in each joint, in space, by components: on the first, at the point of the second."""
    reactions = dict[str, Node]()
    for name, joint in joints.items():
        force, torque = _force_in_space(name, joint), _torque_in_space(name, joint)
        reactions |= {
            join_element_name(joint_force(name), [axis]): tree for axis, tree in zip(AXES, force, strict=True)
        }
        if torque is not None:
            reactions |= {
                join_element_name(joint_torque(name), [axis]): tree for axis, tree in zip(AXES, torque, strict=True)
            }
    return reactions


def _force_in_space(name: str, joint: Joint) -> Triple:
    if joint.kind != SLIDER:
        return _element_components(constraint_force(_point_constraint(name)))
    pulls = (
        _scale_direction(Name(constraint_force(key)), normal)
        for key, normal in zip(_slider_constraints(name), _across(joint), strict=True)
    )
    return _rotate_to_space(_body_attitude(joint.bodies[0], _element_components), _sum_triples(pulls))


def _torque_in_space(name: str, joint: Joint) -> Triple | None:
    """Return the derivatives of the small angles by those of the first body, times their multipliers."""
    if joint.kind == BALL:
        return None
    scalar, relative_vector = _relative_attitude(joint, _element_components)
    keys = [constraint_force(key) for key in _turn_constraints(name, joint)]
    multipliers = _element_components(keys[0]) if joint.kind != HINGE else tuple(map(Name, keys))
    pulls = (
        _add_triples(
            _scale_direction(multiply(scalar, size), normal),
            _cross_triples(relative_vector, _scale_direction(size, normal)),
        )
        for size, normal in zip(multipliers, _fixed_directions(joint), strict=True)
    )
    return _rotate_to_space(_body_attitude(joint.bodies[0], _element_components), _sum_triples(pulls))


# ---------------------------------------------------------------------------------------------------------------- names


def _point_constraint(name: str) -> str:
    return f"{name}_point"


def _slider_constraints(name: str) -> tuple[str, str]:
    return f"{name}_across_1", f"{name}_across_2"


def _turn_constraints(name: str, joint: Joint) -> tuple[str, ...]:
    return (f"{name}_turn_1", f"{name}_turn_2") if joint.kind == HINGE else (f"{name}_turn",)


def _point_text(body: str, joint_point: Name | Triple) -> str:
    """Return the text of where a point is in space."""
    if body == SPACE and not isinstance(joint_point, Name):
        return text_of(vector(joint_point))
    return f"point({body}, {joint_point.name if isinstance(joint_point, Name) else _triple_text(joint_point)})"


def _direction_text(body: str, axis: Numbers) -> str:
    """Return the text of a vector of a body in space."""
    x, y, z = map(_signed_number, axis)
    return text_of(vector((x, y, z))) if body == SPACE else f"direction({body}, {_triple_text((x, y, z))})"


def _triple_text(parts: Triple) -> str:
    return f"[{', '.join(map(text_of, parts))}]"


# ----------------------------------------------------------------------------------------------------------- directions


def _fixed_directions(joint: Joint) -> tuple[Numbers, ...]:
    """Return the directions in the first body about which the second does not turn."""
    return _across(joint) if joint.kind == HINGE else ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def _across(joint: Joint) -> tuple[Numbers, ...]:
    """Return two unit vectors across the axis in the first body, and each other; none without an axis."""
    return perpendiculars(joint.axes[0]) if joint.kind in (HINGE, SLIDER) else ()


def perpendiculars(axis: Numbers) -> tuple[Numbers, Numbers]:
    """Return two unit vectors that make a right-handed frame with an axis, before it.

    Examples
    --------
    >>> perpendiculars((0.0, 0.0, 1.0))
    ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    """
    smallest_axis = min(
        range(len(AXES)), key=lambda i: abs(axis[i])
    )  # the coordinate axis farthest from it: nothing cancels
    length = sqrt(1.0 - axis[smallest_axis] ** 2)
    a, b, c = (
        ((i == smallest_axis) - axis[smallest_axis] * axis[i]) / length + 0.0 for i in range(len(AXES))
    )  # no negative zero
    x, y, z = axis
    return (a, b, c), (y * c - z * b + 0.0, z * a - x * c + 0.0, x * b - y * a + 0.0)


def _constant_turn(joint: Joint) -> Numbers:
    """Return Q, that takes components in the first body to those in the second where they are not off."""
    if joint.kind != HINGE:
        w, *imaginary_parts = joint.quaternion
        return w, *(-part for part in imaginary_parts)
    (x, y, z), (u, v, w) = joint.axes
    scalar = 1.0 + x * u + y * v + z * w
    if scalar < 1e-12:  # opposite: half a turn about what is across
        return 0.0, *perpendiculars(joint.axes[0])[0]
    cross_vector = y * w - z * v, z * u - x * w, x * v - y * u
    length = sqrt(scalar**2 + sum(part**2 for part in cross_vector))
    return scalar / length, *(part / length for part in cross_vector)


def _relative_attitude(joint: Joint, parts: Any) -> Quaternion:
    """Return p = q_a* q_b Q."""
    first, second = (_body_attitude(body, parts) for body in joint.bodies)
    scalar, *imaginary_parts = map(_signed_number, _constant_turn(joint))
    return _quaternion_product(
        (first[0], _negate_triple(first[1])),
        _quaternion_product(second, (scalar, tuple(imaginary_parts))),  # type: ignore[arg-type]
    )


def _body_attitude(body: str, parts: Any) -> Quaternion:
    if body == SPACE:
        return ONE, (ZERO, ZERO, ZERO)
    return Name(scalar_part(body)), parts(vector_part(body))


def _taken_components(name: str) -> Triple:
    """Return the components of a quantity along `axis` as expressions have them."""
    x, y, z = (Along("take", (Name(name), Number(float(i))), (AXIS,)) for i in range(len(AXES)))
    return x, y, z


def _element_components(name: str) -> Triple:
    """Return the components of a quantity along `axis` as elements are named."""
    x, y, z = (Name(join_element_name(name, [axis])) for axis in AXES)
    return x, y, z


def _constraint_entries(off: list[Node]) -> list[Node]:
    """Return conditions as they are entered: two, or one along `axis`."""
    return off if len(off) < len(AXES) else [vector((off[0], off[1], off[2]))]


# -------------------------------------------------------------------------------------------------------------- algebra


def _signed_number(value: float) -> Node:
    return ZERO if value == 0.0 else Number(value) if value > 0.0 else negative(Number(-value))


def _quaternion_product(a: Quaternion, b: Quaternion) -> Quaternion:
    product_vector = _add_triples(
        _add_triples(_scale_triple(a[0], b[1]), _scale_triple(b[0], a[1])), _cross_triples(a[1], b[1])
    )
    return add(multiply(a[0], b[0]), negative(_inner_product(a[1], b[1]))), product_vector


def _rotate_to_space(q: Quaternion, a: Triple) -> Triple:
    """Return a vector of a body by its components in space: a + 2 q x (q x a + q0 a)."""
    inner = _add_triples(_cross_triples(q[1], a), _scale_triple(q[0], a))
    return _add_triples(a, _scale_triple(TWO, _cross_triples(q[1], inner)))


def _cross_triples(a: Triple, b: Triple) -> Triple:
    def cross_component(i: int, j: int) -> Node:
        return add(multiply(a[i], b[j]), negative(multiply(a[j], b[i])))

    return cross_component(1, 2), cross_component(2, 0), cross_component(0, 1)


def _inner_product(a: Triple, b: Triple) -> Node:
    return add(add(multiply(a[0], b[0]), multiply(a[1], b[1])), multiply(a[2], b[2]))


def _numeric_dot(numbers: Iterable[float], a: Triple) -> Node:
    x, y, z = map(_signed_number, numbers)
    return _inner_product((x, y, z), a)


def _scale_triple(size: Node, a: Triple) -> Triple:
    return multiply(size, a[0]), multiply(size, a[1]), multiply(size, a[2])


def _scale_direction(size: Node, numbers: Numbers) -> Triple:
    x, y, z = map(_signed_number, numbers)
    return _scale_triple(size, (x, y, z))


def _add_triples(a: Triple, b: Triple) -> Triple:
    return add(a[0], b[0]), add(a[1], b[1]), add(a[2], b[2])


def _negate_triple(a: Triple) -> Triple:
    return negative(a[0]), negative(a[1]), negative(a[2])


def _sum_triples(parts: Iterable[Triple]) -> Triple:
    total: Triple = (ZERO, ZERO, ZERO)
    for part in parts:
        total = _add_triples(total, part)
    return total

"""Joints in a model file: their two bodies, their points, and their axes as directions of unit length.

Directions and attitudes are plain numbers, which are checked to have unit length or are normalised.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import cos, hypot, sin
from typing import Any

from xdynamics.expressions import Name
from xdynamics.faults import InputError, brief_repr
from xdynamics.model.body_sections import AXES, PLACE, SPACE, Triple
from xdynamics.model.kinds import Kind, Source
from xdynamics.model.section import DESCRIPTION, NEEDED, Key, Section
from xdynamics.model.table_keys import check_keys
from xdynamics.units import parse_quantity, parse_unit

UNIT = 1e-12  # how far from 1 the length of a quaternion may be that is written in decimals
FORMS = {3: "[x, y, z]", 4: '[w, x, y, z], or { axis = [0, 0, 1], angle = "30 degree" }'}


def plain_numbers(value: Any, key: str, count: int) -> list[float]:
    """Read three or four numbers.

    Raises
    ------
    InputError
        If it is anything else.
    """
    plain = isinstance(value, list | tuple) and all(
        isinstance(entry, int | float) and not isinstance(entry, bool) for entry in value
    )
    if not plain or len(value) != count:
        raise InputError(f"{key} is {brief_repr(value)}, needs numbers {FORMS[count]}")
    return [float(entry) for entry in value]


def normalised(numbers: Sequence[float], key: str) -> list[float]:
    """Return numbers over their length.

    Raises
    ------
    InputError
        If that is zero or not finite.
    """
    length = hypot(*numbers)
    if not 0.0 < length < float("inf"):
        raise InputError(f"{key} is {[*numbers]}, of length {length!r}, and says nothing of directions")
    return [entry / length for entry in numbers]


def unit_quaternion(value: Any) -> list[float]:
    """Read four numbers of unit length.

    Raises
    ------
    InputError
        If they are not, or have another length.
    """
    numbers = plain_numbers(value, "attitude", 4)
    unit, length = normalised(numbers, "attitude"), hypot(*numbers)
    if abs(length - 1.0) > UNIT:
        raise InputError(f"attitude is {numbers}, of length {length!r}; a unit quaternion is needed: write {unit}")
    return unit


BALL, HINGE, SLIDER, RIGID = KINDS = ("ball", "hinge", "slider", "rigid")
Numbers = tuple[float, ...]
UNTURNED = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Joint:
    """A joint of two bodies, or of a body and space, by the keys of `[joints]`; one kind has the two that it joins.

    `axis` is one direction with the same components in both, or one for each; `attitude` is as it was written.
    """

    at: tuple[Name | Triple, Name | Triple]
    ball: tuple[str, ...] = ()
    hinge: tuple[str, ...] = ()
    slider: tuple[str, ...] = ()
    rigid: tuple[str, ...] = ()
    axis: tuple[Numbers, ...] = ()
    attitude: Any = None
    description: str = ""

    @property
    def kind(self) -> str:
        """The kind of the joint."""
        return next(kind for kind in KINDS if getattr(self, kind))

    @property
    def bodies(self) -> tuple[str, str]:
        """The two that it joins; the force and the torque recorded are on the first."""
        first, second = getattr(self, self.kind)
        return first, second

    @property
    def axes(self) -> tuple[Numbers, Numbers]:
        """The unit vector of the axis in either of the two."""
        first, *further_axes = (tuple(normalised(axis, "axis")) for axis in self.axis)
        return first, further_axes[0] if further_axes else first

    @property
    def quaternion(self) -> Numbers:
        """The attitude of the second in the axes of the first, where that is fixed."""
        return UNTURNED if self.attitude is None else _quaternion(self.attitude)


def make_joint(at: tuple[Name | Triple, Name | Triple], **values: Any) -> Joint:
    """Make a joint of one kind.

    Raises
    ------
    InputError
        If it is of no kind or of several, joins a body to itself or space to space, or if keys do not go together.
    """
    kinds = [kind for kind in KINDS if kind in values]
    if len(kinds) != 1:
        problem = f"{' and '.join(kinds)} are given" if kinds else "none is given"
        raise InputError(f'it is one of {", ".join(KINDS)}, and {problem}; write one, like hinge = ["arm", "rod"]')
    kind, (first, second) = kinds[0], values[kinds[0]]
    if first == second:
        raise InputError(f"{kind} joins {first} to itself; name two bodies, or a body and '{SPACE}'")
    for name, joint_point in zip((first, second), at, strict=True):
        if name == SPACE and isinstance(joint_point, Name):
            raise InputError(
                f"at: '{joint_point.name}' is a point of '{SPACE}', which has no names; write its three components"
            )
    turning, fixed = kind in (HINGE, SLIDER), kind in (SLIDER, RIGID)
    if turning and "axis" not in values:
        raise InputError(f"key 'axis' is missing: the direction of the {kind}'s axis, like [0, 0, 1]")
    if not turning and "axis" in values:
        raise InputError(f"axis is of a {HINGE} or {SLIDER}, and a joint that is {kind} has none; leave it out")
    if not fixed and "attitude" in values:
        raise InputError(f"attitude is of a {SLIDER} or {RIGID}, and a {kind} turns; leave it out")
    if kind == SLIDER and len(values["axis"]) > 1:
        raise InputError(f"axis of a {SLIDER} is one direction, in {first}; attitude says how {second} is turned there")
    return Joint(at, **values)


def _read_body_pair(value: Any, key: str, _: Source) -> tuple[str, ...]:
    if not isinstance(value, list | tuple) or len(value) != 2 or not all(isinstance(name, str) for name in value):
        raise InputError(f'{key} is {brief_repr(value)}, needs two bodies, or a body and "{SPACE}": ["arm", "rod"]')
    return tuple(value)


def _read_joint_points(value: Any, key: str, source: Source) -> tuple[Any, ...]:
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise InputError(
            f'{key} is {brief_repr(value)}, needs two points, one in each: ["tip", "top"], or [["0 m", "0 m", "0.5 m"], "top"]'
        )
    return tuple(PLACE.read(joint_point, f"{key}[{i}]", source) for i, joint_point in enumerate(value))


def _read_axes(value: Any, key: str, _: Source) -> tuple[Numbers, ...]:
    pair = isinstance(value, list | tuple) and len(value) == 2
    axes = tuple(tuple(plain_numbers(axis, key, len(AXES))) for axis in (value if pair else [value]))
    for axis in axes:
        normalised(axis, key)
    return axes


def _written_attitude(value: Any, _: Any) -> Any:
    return value if isinstance(value, dict) else list(value)


def _read_attitude(value: Any, *_: Any) -> Any:
    _quaternion(value)
    return dict(value) if isinstance(value, Mapping) else tuple(value)


def _quaternion(value: Any) -> Numbers:
    """Return a quaternion from four numbers, or from an axis and an angle."""
    if not isinstance(value, Mapping):
        return tuple(unit_quaternion(value))
    check_keys(value, ("axis", "angle"), ("axis", "angle"))
    axis, angle = _unit_direction(value["axis"]), parse_quantity(value["angle"])
    if angle.unit.dimension != parse_unit("rad").dimension:
        raise InputError(f"attitude: angle is {value['angle']!r}, needs an angle, like '30 degree'")
    return cos(angle.si / 2), *(sin(angle.si / 2) * part for part in axis)


def _unit_direction(value: Any) -> Numbers:
    return tuple(normalised(plain_numbers(value, "axis", len(AXES)), "axis"))


PAIR = Kind(f'two names, of bodies or "{SPACE}"', _read_body_pair, lambda names, _: list(names), ())
PLACES = Kind(
    "two points, each by name or as three quantities or expressions",
    _read_joint_points,
    lambda points, time: [PLACE.write(point, time) for point in points],
)
AXIS_KIND = Kind(
    "three numbers, or two times three",
    _read_axes,
    lambda axes, _: [list(axis) for axis in axes] if len(axes) > 1 else list(axes[0]),
    (),
)
ATTITUDE = Kind('[w, x, y, z], or { axis = [0, 0, 1], angle = "30 degree" }', _read_attitude, _written_attitude, None)
SECTION = Section(
    "joints of two bodies, or of a body and space: constraints, with the force and the torque in each",
    "joint",
    (
        Key(BALL, PAIR, "joins them in one point", "another kind", omitted=()),
        Key(HINGE, PAIR, "in one point, turning about one axis", "another kind", omitted=()),
        Key(SLIDER, PAIR, "the second along an axis of the first, unturned in it", "another kind", omitted=()),
        Key(RIGID, PAIR, "one welded to the other", "another kind", omitted=()),
        Key("at", PLACES.with_unit("m"), "in the axes of each: points that lie on each other, or on the axis", NEEDED),
        Key(
            "axis",
            AXIS_KIND,
            "of a hinge, with the same components in both, or its direction in each; of a slider, in the first",
            "needed there",
        ),
        Key("attitude", ATTITUDE, "of slider and rigid: of the second in the axes of the first", "unturned"),
        DESCRIPTION,
    ),
    """\
[bodies.thigh]
mass = "9 kg"
inertia = ["0.2 kg m2", "0.2 kg m2", "0.03 kg m2"]
points = { top = ["0 m", "0 m", "0.2 m"], low = ["0 m", "0 m", "-0.2 m"] }
initial = { position = ["0 m", "0 m", "0.8 m"] }
[bodies.shin]
mass = "4 kg"
inertia = ["0.1 kg m2", "0.1 kg m2", "0.01 kg m2"]
[bodies.shin.initial]
position = ["0 m", "0 m", "0.4 m"]
attitude = { axis = [0, 0, 1], angle = "90 degree" }
[bodies.plate]
mass = "0.1 kg"
inertia = ["1 g m2", "1 g m2", "2 g m2"]
initial = { position = ["0 m", "0.1 m", "0.6 m"] }
[bodies.slide]
mass = "1 kg"
inertia = ["10 g m2", "10 g m2", "10 g m2"]
[joints.hip]
ball = ["space", "thigh"]
at = [["0 m", "0 m", "1 m"], "top"]
[joints.knee]
hinge = ["thigh", "shin"]
at = ["low", ["0 m", "0 m", "0.2 m"]]
axis = [[0, 1, 0], [1, 0, 0]]
[joints.screws]
rigid = ["thigh", "plate"]
at = ["low", ["0 m", "-0.1 m", "0 m"]]
attitude = [1, 0, 0, 0]
[joints.rail]
slider = ["space", "slide"]
at = [["0.1 m", "0 m", "0 m"], "centre"]
axis = [1, 0, 0]
description = "of the frame"
""",
    make=make_joint,
    own_tables=True,
)

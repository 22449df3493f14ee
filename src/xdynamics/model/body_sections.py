"""What stands inside a body of a model file: its inertia, its points, the forces and torques that act on it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from xdynamics.expressions import Name, Node, text_of
from xdynamics.faults import InputError, brief_repr
from xdynamics.model.controller_sections import entries_of
from xdynamics.model.kinds import LIMIT, Kind, Source, raw, word_kind
from xdynamics.model.section import DESCRIPTION, NEEDED, Key, Section

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

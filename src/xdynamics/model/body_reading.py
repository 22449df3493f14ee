"""Reading of bodies: the entries that each body adds to a model, and the functions of bodies in expressions.

The entries are added before any entry of the model is read. The functions give the position and velocity of a point of
a body, and a direction that is fixed in it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from xdynamics.expressions import Call, Name, Node, parse, text_of
from xdynamics.expressions.parser import LIST
from xdynamics.faults import InputError, Ledger
from xdynamics.model.body_sections import (
    AXES,
    AXIS,
    CENTRE,
    GYROSCOPIC,
    LONGEST_NAME,
    Body,
    Triple,
    point_position,
    point_velocity,
    position,
    quasi_coordinate,
    scalar_part,
    tables_of_body,
    to_space_axes,
    triple,
    vector,
    vector_part,
)
from xdynamics.model.given_values import is_expression
from xdynamics.model.grammar import SECTIONS
from xdynamics.model.joint_sections import normalised, plain_numbers, unit_quaternion
from xdynamics.model.joints import with_joints
from xdynamics.model.kinds import LIMIT, Source
from xdynamics.model.table_keys import check_keys, suggestion
from xdynamics.schema import velocity
from xdynamics.units import parse_quantity

FUNCTIONS = ("point", "velocity", "direction")
_CALLED = re.compile(rf"\b(?:{'|'.join(FUNCTIONS)})\s*\(")


def with_functions(tables: Mapping[str, Any], source: Source, ledger: Ledger) -> dict[str, Any]:
    """Return sections of a statement with the functions of bodies written out; faults are noted."""
    functions = _Functions(tables["bodies"], source)
    body_functions = {name: getattr(functions, name) for name in FUNCTIONS}

    def expand_calls(value: Any) -> Any:
        if isinstance(value, str):
            return text_of(parse(value, body_functions)) if _CALLED.search(value) else value
        if isinstance(value, Mapping):
            return {key: entry if key == "description" else expand_calls(entry) for key, entry in value.items()}
        return [*map(expand_calls, value)] if isinstance(value, list) else value

    expanded_sections: dict[str, Any] = {}
    for title, section in tables.items():
        if not isinstance(section, dict):
            continue
        entry_label = SECTIONS[title].entry if title in SECTIONS else title
        expanded_sections[title] = {}
        for key, entry in section.items():
            with ledger.entry(f"{entry_label} '{key}'"):
                expanded_sections[title][key] = expand_calls(entry)
    return expanded_sections


class _Functions:
    """Makes the trees of functions of bodies, of which no more than points and pivots are known yet."""

    def __init__(self, bodies: Mapping[str, Any], source: Source) -> None:
        self.points: dict[str, tuple[str, ...]] = {}
        self.pivots: dict[str, Triple] = {}
        for name, entry in bodies.items():
            body = entry if isinstance(entry, Mapping) else {}
            points = body.get("points")
            self.points[name] = (CENTRE, *(points if isinstance(points, Mapping) else ()))
            if "pivot" in body:
                self.pivots[name] = triple(body["pivot"], "pivot", source)

    def point(self, arguments: list[Node]) -> Node:
        """Return where a point is in space."""
        body, location = self._body_and_point("point", arguments)
        return (
            Name(f"{body}_{location}")
            if isinstance(location, str)
            else point_position(body, self.pivots.get(body), location)
        )

    def velocity(self, arguments: list[Node]) -> Node:
        """Return how fast a point moves, by components in space."""
        body, location = self._body_and_point("velocity", arguments)
        if isinstance(location, str):
            return Name(velocity(f"{body}_{location}"))
        return point_velocity(body, self.pivots.get(body), location)

    def direction(self, arguments: list[Node]) -> Node:
        """Return a vector of a body by its components in space."""
        body, components = self._body_and_point("direction", arguments)
        if not isinstance(components, tuple):
            raise InputError("'direction' is written direction(body, [x, y, z]), with components in the body")
        return to_space_axes(body, vector(components))

    def _body_and_point(self, function: str, arguments: list[Node]) -> tuple[str, str | Triple | None]:
        """Return the body, and the name of a point, its components, or None for the centre."""
        if len(arguments) != 2 or not isinstance(arguments[0], Name):
            raise InputError(f"'{function}' is written {function}(body, point) or {function}(body, [x, y, z])")
        body, location = arguments[0].name, arguments[1]
        if body not in self.points:
            raise InputError(f"{function}({body}, …): there is no body '{body}'{suggestion(body, tuple(self.points))}")
        if isinstance(location, Call) and location.function == LIST and len(location.arguments) == len(AXES):
            x, y, z = location.arguments
            return body, (x, y, z)
        if isinstance(location, Call) and location.function == LIST:
            raise InputError(f"{function}({body}, […]) has {len(location.arguments)} components, needs three")
        point_name = text_of(location)
        if not isinstance(location, Name) or point_name not in self.points[body]:
            raise InputError(
                f"{function}({body}, {point_name}): body '{body}' has no point {point_name}{suggestion(point_name, self.points[body])}"
            )
        return body, None if point_name == CENTRE else point_name


OWN_NAMES = ("r", "turn", "q0", "q", "inertia", "spin")
_STARTS = ("position", "velocity", "attitude", "angular_velocity")
_PARTS = ("x", "y", "z"), (("xx", "xy", "xz"), ("xy", "yy", "yz"), ("xz", "yz", "zz"))


def with_bodies(statement: Mapping[str, Any], source: Source, ledger: Ledger) -> dict[str, Any]:
    """Return a statement with the entries of its bodies among those of its sections.

    Quantities of mass and inertia become parameters, and values at the start those of `[initial]`. What is wrong is noted.
    """
    tables: dict[str, Any] = {
        title: dict(section) if isinstance(section, Mapping) else section for title, section in statement.items()
    }
    body_tables = tables.get("bodies")
    if tables.get("joints") and not body_tables:
        ledger.note("[joints] stands without [bodies], which it joins")
    if not isinstance(body_tables, dict) or not body_tables:
        return tables
    if tables.get("lagrangian"):
        ledger.note("[lagrangian] stands beside [bodies], whose mass is no part of it; write [mass] and [forces]")
    for title in ("dimensions", "coordinates", "parameters", "mass", "definitions", "forces", "states", "initial"):
        if not isinstance(tables.setdefault(title, {}), dict):
            return tables  # said where it is read
    if tables["dimensions"].setdefault(AXIS, [*AXES]) not in ([*AXES], AXES):
        ledger.note(f"dimension '{AXIS}' is {tables['dimensions'][AXIS]!r}; of bodies it is {[*AXES]}: rename yours")
    with_joints(tables, source, ledger)
    tables |= with_functions(tables, source, ledger)
    bodies = dict[str, Body]()
    for name, entry in tables["bodies"].items():
        with ledger.entry(f"body '{name}'"):
            _check_body_name(name)
            plain = _parametrised(name, entry, tables["parameters"])
            start = plain.pop("initial", {})
            body = bodies[name] = SECTIONS["bodies"].read(name, plain, source)
            _check_keys(body)
            _put_body_start(name, body, start, tables["initial"], source)
            tables["bodies"][name] = plain
    ledger.raise_faults()
    for name, body in bodies.items():
        _put_body_entries(name, body, tables, ledger)
    tables["regimes"] = _with_forces(tables.get("regimes", {}), sorted(body_entries(bodies, "forces")))
    return tables


def _with_forces(regimes: Any, forces: list[str]) -> Any:
    """Return regimes in which forces of bodies act that no regime names, including gyroscopic terms."""
    if not isinstance(regimes, Mapping):
        return regimes
    lists = [entry["forces"] for entry in regimes.values() if isinstance(entry, Mapping) and "forces" in entry]
    named_forces = {force for names in lists if isinstance(names, list) for force in names}
    return {
        name: {**entry, "forces": [*entry["forces"], *(force for force in forces if force not in named_forces)]}
        if isinstance(entry, Mapping) and isinstance(entry.get("forces"), list)
        else entry
        for name, entry in regimes.items()
    }


def _put_body_entries(name: str, body: Body, tables: dict[str, Any], ledger: Ledger) -> None:
    """Add the entries of a body to the sections, and note names that are already taken."""
    for title, entries in tables_of_body(name, body).items():
        for key, entry in entries.items():
            if key in tables[title]:
                entry_kind = SECTIONS[title].entry or title
                ledger.note(
                    f"body '{name}' makes a {entry_kind} '{key}', and there is one; rename the body, or the other"
                )
            tables[title][key] = entry


def body_entries(bodies: Mapping[str, Body], title: str) -> set[str]:
    """Return the entries of a section that bodies stand for."""
    return {key for name, body in bodies.items() for key in tables_of_body(name, body).get(title, ())}


def _check_body_name(name: str) -> None:
    if not (name.isascii() and name.isidentifier() and name[0] != "_" and len(name) <= LONGEST_NAME):
        raise InputError(
            f"a body's name is a letter, then letters, digits and underscores, {LONGEST_NAME} at most: those of its"
            " coordinates begin with it"
        )


def _check_keys(body: Body) -> None:
    """Refuse contradictory keys, and points that do not exist."""
    if (body.mass is None) == (body.pivot is None):
        raise InputError(
            "has a mass and a pivot; about a fixed point its inertia alone counts, so leave mass out"
            if body.pivot
            else "key 'mass' is missing; a body needs it unless it turns about a pivot"
        )
    if CENTRE in body.points:
        raise InputError(f"point '{CENTRE}' is what the origin of the body is called; choose another name")
    for kind, names, reserved_names in (
        ("point", body.points, OWN_NAMES),
        ("force", body.forces, (GYROSCOPIC,)),
        ("torque", body.torques, (GYROSCOPIC,)),
    ):
        if clashing := [name for name in names if name in reserved_names]:
            raise InputError(f"{kind} '{clashing[0]}' has the name of something that every body has; rename it")
    for name, push in body.forces.items():
        if isinstance(push.at, Name) and push.at.name not in (CENTRE, *body.points):
            raise InputError(
                f"force '{name}' acts at '{push.at.name}', no point of it{suggestion(push.at.name, _point_names(body))}"
            )
        if body.pivot and push.at == Name(CENTRE):
            raise InputError(f"force '{name}' acts at the pivot, and moves nothing; write at = … where it acts")
    if twice := sorted({*body.forces} & {*body.torques}):
        raise InputError(f"has a force and a torque '{twice[0]}'; rename one")


def _point_names(body: Body) -> tuple[str, ...]:
    return (CENTRE, *body.points)


def _parametrised(name: str, entry: Any, parameters: dict[str, Any]) -> dict[str, Any]:
    """Return the entry of a body with its quantities as names of parameters, which are added to `parameters`."""
    check_keys(entry, SECTIONS["bodies"].fixed_keys, ("inertia",))
    plain = dict(entry)

    def to_parameter(value: Any, key: str) -> Any:
        parameter_name = f"{name}_{key}"
        if not isinstance(value, Mapping) and (isinstance(value, list | tuple) or is_expression(value)):
            return value
        if parameter_name in parameters and parameters[parameter_name] != value:
            raise InputError(
                f"makes a parameter '{parameter_name}', and there is one; write '{parameter_name}' in the place of {value!r}, or rename"
                " the body"
            )
        parameters[parameter_name] = value
        return parameter_name

    if "mass" in plain:
        plain["mass"] = to_parameter(plain["mass"], "mass")
    if isinstance(rows := plain.get("inertia"), list | tuple) and len(rows) == len(AXES):
        principal, products = _PARTS
        _check_symmetry(rows)
        plain["inertia"] = [
            to_parameter(row, f"inertia_{part}")
            if not isinstance(row, list | tuple)
            else [to_parameter(value, f"inertia_{key}") for value, key in zip(row, parts, strict=False)]
            if len(row) == len(AXES)
            else row
            for row, part, parts in zip(rows, principal, products, strict=True)
        ]
    return plain


def _check_symmetry(rows: Sequence[Any]) -> None:
    for i, row in enumerate(rows):
        for j, earlier_row in enumerate(rows[:i]):
            are_complete = all(isinstance(part, list | tuple) and len(part) == len(AXES) for part in (row, earlier_row))
            if are_complete and row[j] != earlier_row[i]:
                below, above = AXES[i] + AXES[j], AXES[j] + AXES[i]
                raise InputError(f"inertia is not symmetric: {above} is {earlier_row[i]!r}, {below} is {row[j]!r}")


def _put_body_start(name: str, body: Body, start: Any, initial: dict[str, Any], source: Source) -> None:
    """Add the start of a body to the initial values, unless they have it already."""
    check_keys(start, _STARTS, ())
    if body.pivot and (moving_keys := [key for key in ("position", "velocity") if key in start]):
        raise InputError(f"initial has a {moving_keys[0]}, and the body has a pivot, which is at rest")
    places = {
        "position": position(name),
        "velocity": velocity(position(name)),
        "angular_velocity": velocity(quasi_coordinate(name)),
    }
    made: dict[str, Any] = {places[key]: _start_entry(start[key], key, body, source) for key in places if key in start}
    if "attitude" in start:
        made |= dict(
            zip((scalar_part(name), vector_part(name)), _quaternion_parts(start["attitude"], body, source), strict=True)
        )
    for key in made:
        if key in initial:
            raise InputError(f"initial has what [initial] has as '{key}'; leave one out")
    initial |= made
    default_values = (
        {quasi_coordinate(name): "0 rad"} if body.pivot else {position(name): "0 m", quasi_coordinate(name): "0 rad"}
    )
    if not {scalar_part(name), vector_part(name)} & {*initial}:
        default_values |= {scalar_part(name): "1", vector_part(name): "0"}
    for key, value in default_values.items():
        initial.setdefault(key, value)


def _start_entry(value: Any, key: str, body: Body, source: Source) -> Any:
    """Return three values at the start as an entry: a list of quantities, or an expression."""
    tree = vector(triple(value, key, source))
    if body.dims or any(is_expression(entry) for entry in value):
        return text_of(tree)
    quantities = [parse_quantity(entry) for entry in value]
    units = {quantity.unit.text for quantity in quantities}
    return (
        text_of(tree) if len(units) > 1 else {"value": [float(part.value) for part in quantities], "unit": units.pop()}
    )


def _quaternion_parts(value: Any, body: Body, source: Source) -> tuple[Any, Any]:
    """Return the two parts of a quaternion, from four numbers or from an axis and an angle.

    Raises
    ------
    InputError
        If it is neither, or no unit quaternion.
    """
    if isinstance(value, Mapping):
        check_keys(value, ("axis", "angle"), ("axis", "angle"))
        axis = normalised(plain_numbers(value["axis"], "axis", len(AXES)), "axis")
        half = f"({text_of(LIMIT.read(value['angle'], 'angle', source))})/2"
        return f"cos({half})", f"sin({half})*({text_of(_vector_of_numbers(axis))})"
    unit = unit_quaternion(value)
    return repr(unit[0]), text_of(_vector_of_numbers(unit[1:])) if body.dims else {"value": unit[1:]}


def _vector_of_numbers(numbers: list[float]) -> Node:
    x, y, z = (parse(repr(number)) for number in numbers)
    return vector((x, y, z))

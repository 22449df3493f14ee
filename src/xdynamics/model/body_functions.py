"""Functions of bodies in expressions: where a point of one is, how fast it moves, where a direction in it points."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from xdynamics.expressions import Call, Name, Node, parse, text_of
from xdynamics.expressions.parser import LIST
from xdynamics.faults import InputError, Ledger
from xdynamics.model.bodies import point_position, point_velocity, to_space_axes, vector
from xdynamics.model.body_sections import AXES, CENTRE, Triple, triple
from xdynamics.model.grammar import SECTIONS
from xdynamics.model.kinds import Source
from xdynamics.model.table_keys import suggestion
from xdynamics.schema import velocity

FUNCTIONS = ("point", "velocity", "direction")
_CALLED = re.compile(rf"\b(?:{'|'.join(FUNCTIONS)})\s*\(")


def with_functions(tables: Mapping[str, Any], source: Source, ledger: Ledger) -> dict[str, Any]:
    """Return sections of a statement with bodies in which their functions are written out; what is wrong is noted."""
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

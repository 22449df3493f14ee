"""Functions of bodies in expressions: where a point of one is, how fast it moves, where a direction in it points."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from xdynamics.expressions import Call, Name, Node, parse, text_of
from xdynamics.expressions.parser import LIST
from xdynamics.faults import InputError, Ledger
from xdynamics.model.bodies import in_space, point, point_velocity, vector
from xdynamics.model.body_sections import AXES, CENTRE, Triple, triple
from xdynamics.model.grammar import SECTIONS
from xdynamics.model.kinds import Source
from xdynamics.model.table_keys import near
from xdynamics.schema import velocity

FUNCTIONS = ("point", "velocity", "direction")
_CALLED = re.compile(rf"\b(?:{'|'.join(FUNCTIONS)})\s*\(")


def with_functions(tables: Mapping[str, Any], source: Source, ledger: Ledger) -> dict[str, Any]:
    """Return sections of a statement with bodies in which their functions are written out; what is wrong is noted."""
    functions = _Functions(tables["bodies"], source)
    own = {name: getattr(functions, name) for name in FUNCTIONS}

    def written(value: Any) -> Any:
        if isinstance(value, str):
            return text_of(parse(value, own)) if _CALLED.search(value) else value
        if isinstance(value, Mapping):
            return {key: entry if key == "description" else written(entry) for key, entry in value.items()}
        return [*map(written, value)] if isinstance(value, list) else value

    found: dict[str, Any] = {}
    for title, section in tables.items():
        if not isinstance(section, dict):
            continue
        called = SECTIONS[title].entry if title in SECTIONS else title
        found[title] = {}
        for key, entry in section.items():
            with ledger.entry(f"{called} '{key}'"):
                found[title][key] = written(entry)
    return found


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
        body, place = self._place("point", arguments)
        return Name(f"{body}_{place}") if isinstance(place, str) else point(body, self.pivots.get(body), place)

    def velocity(self, arguments: list[Node]) -> Node:
        """Return how fast a point moves, by components in space."""
        body, place = self._place("velocity", arguments)
        if isinstance(place, str):
            return Name(velocity(f"{body}_{place}"))
        return point_velocity(body, self.pivots.get(body), place)

    def direction(self, arguments: list[Node]) -> Node:
        """Return a vector of a body by its components in space."""
        body, place = self._place("direction", arguments)
        if not isinstance(place, tuple):
            raise InputError("'direction' is written direction(body, [x, y, z]), with components in the body")
        return in_space(body, vector(place))

    def _place(self, function: str, arguments: list[Node]) -> tuple[str, str | Triple | None]:
        """Return the body, and the name of a point, its components, or None for the centre."""
        if len(arguments) != 2 or not isinstance(arguments[0], Name):
            raise InputError(f"'{function}' is written {function}(body, point) or {function}(body, [x, y, z])")
        body, place = arguments[0].name, arguments[1]
        if body not in self.points:
            raise InputError(f"{function}({body}, …): there is no body '{body}'{near(body, tuple(self.points))}")
        if isinstance(place, Call) and place.function == LIST and len(place.arguments) == len(AXES):
            x, y, z = place.arguments
            return body, (x, y, z)
        if isinstance(place, Call) and place.function == LIST:
            raise InputError(f"{function}({body}, […]) has {len(place.arguments)} components, needs three")
        called = text_of(place)
        if not isinstance(place, Name) or called not in self.points[body]:
            raise InputError(
                f"{function}({body}, {called}): body '{body}' has no point {called}{near(called, self.points[body])}"
            )
        return body, None if called == CENTRE else called

"""Reading of contacts and dry friction from a model file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from xdynamics.expressions import Node, parse
from xdynamics.faults import InputError
from xdynamics.model.grammar import SECTIONS, keys_of
from xdynamics.model.parts import DIRECTIONS, IMPACT_LAWS, TANGENTIALS, Contact, Friction
from xdynamics.model.table_keys import choice, described, keys, place_tolerance, tolerance
from xdynamics.units import Quantity, parse_quantity

_OF_COULOMB = ("slip", "friction", "static")


def contact(given: Any) -> Contact:
    """Read a contact.

    Raises
    ------
    InputError
        Naming the key that is wrong.
    """
    keys_of("contacts", given)
    tangential = choice(given, "tangential", TANGENTIALS, "frictionless")
    if tangential == "coulomb":
        if missing := [key for key in _OF_COULOMB[:2] if key not in given]:
            raise InputError(f"tangential 'coulomb' needs {' and '.join(missing)}")
        own = {key: _expression(given, key) for key in _OF_COULOMB[:2]}
        own["static"] = _expression(given, "static") if "static" in given else own["friction"]
    else:
        if unused := [key for key in _OF_COULOMB if key in given]:
            raise InputError(f"{', '.join(unused)} is for tangential = 'coulomb', and this contact is frictionless")
        own = {}
    return Contact(
        parse(given["gap"]),
        _expression(given, "restitution"),
        tangential,
        time_tolerance=tolerance(given),
        position_tolerance=place_tolerance(given),
        rest_height=_height(given),
        law=choice(given, "law", IMPACT_LAWS, "newton"),
        description=described(given),
        **own,
    )


def impact(given: Any) -> Contact:
    """Read an event with the action ``impact`` as a contact, with the event's function as its gap.

    Raises
    ------
    InputError
        Naming the key that is wrong.
    """
    own = tuple(key for key in SECTIONS["contacts"].known if key != "gap")
    keys(given, ("function", "direction", "action", *own), needed=("function", "restitution"))
    direction = choice(given, "direction", DIRECTIONS[:2], "falling")
    gap = given["function"] if direction == "falling" else f"-({given['function']})"
    return contact({"gap": gap} | {key: value for key, value in given.items() if key in own})


def friction(given: Any) -> Friction:
    """Read a friction element.

    Raises
    ------
    InputError
        Naming the key that is wrong.
    """
    keys_of("frictions", given)
    kinetic = _expression(given, "kinetic")
    static = _expression(given, "static") if "static" in given else kinetic
    return Friction(parse(given["slip"]), kinetic, static, tolerance(given), described(given))


def _expression(entry: Mapping[str, Any], key: str) -> Node:
    """Read an expression, or a plain number."""
    value = entry[key]
    plain = isinstance(value, int | float) and not isinstance(value, bool)
    try:
        return parse(repr(value) if plain else value)
    except InputError as error:
        raise InputError(f"{key}: {error}") from None


def _height(entry: Mapping[str, Any]) -> Quantity | None:
    if "rest_height" not in entry:
        return None
    height = parse_quantity(entry["rest_height"])
    if height.value < 0:
        raise InputError(f"rest_height is '{height}', needs to be non-negative")
    return height

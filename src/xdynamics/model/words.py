"""Tables of a model file: their keys, choices and texts."""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches
from typing import Any

from xdynamics.faults import InputError
from xdynamics.units import NONE, TIME, Quantity, parse_quantity

MOST_COMPARED = 1_000  # names among which one that was meant is looked for


def keys(given: Any, known: tuple[str, ...], needed: tuple[str, ...]) -> None:
    """Refuse what is no table, has other keys than the known ones, or lacks one that is needed; see `grammar`."""
    if not isinstance(given, Mapping):
        raise InputError(f"{given!r} must be a table with {', '.join(needed)}")
    faults = [f"key '{key}' is not known{near(key, known)}" for key in given if key not in known]
    faults += [f"key '{key}' is missing" for key in needed if key not in given]
    if faults:
        raise InputError("; ".join(faults))


def choice(given: Mapping[str, Any], key: str, known: tuple[str, ...], default: str) -> str:
    """Return one of some words."""
    value = given.get(key, default)
    if value not in known:
        raise InputError(f"{key} {value!r} is not known; there are {', '.join(known)}")
    return str(value)


def tolerance(given: Mapping[str, Any]) -> Quantity | None:
    """Return how well a time is to be located, where that is said."""
    if "time_tolerance" not in given:
        return None
    quantity = parse_quantity(given["time_tolerance"])
    if quantity.unit.dimension not in (TIME, NONE) or quantity.value <= 0:
        raise InputError(f"time_tolerance is '{quantity}', needs a positive time")
    return quantity


def place_tolerance(given: Mapping[str, Any]) -> Quantity | None:
    """Return how near to its zero a function is to be at the accepted state, where that is said; in its own unit."""
    if "position_tolerance" not in given:
        return None
    quantity = parse_quantity(given["position_tolerance"])
    if not quantity.value > 0:
        raise InputError(f"position_tolerance is '{quantity}', needs a positive quantity")
    return quantity


def described(given: Mapping[str, Any]) -> str:
    """Return the description of an entry."""
    text = str(given.get("description", "")).strip()
    if not all(character.isprintable() or character in "\n\t" for character in text):
        raise InputError(f"text {text[:40]!r} has characters that are not printable")
    return text


def flag(given: Mapping[str, Any], key: str) -> bool:
    """Return a truth, false where it is not given."""
    value = given.get(key, False)
    if not isinstance(value, bool):
        raise InputError(f"{key} is {value!r}, needs true or false")
    return value


def near(name: str, known: tuple[str, ...]) -> str:
    """Say which word may have been meant, or which there are."""
    alike = get_close_matches(name, known[:MOST_COMPARED], n=1)
    return f"; did you mean '{alike[0]}'?" if alike else f"; there are {', '.join(known)}"

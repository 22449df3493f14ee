"""Reading of tables in a model file: keys, choices, texts."""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches
from typing import Any

from xdynamics.faults import InputError
from xdynamics.units import NONE, TIME, Quantity, parse_quantity

MOST_COMPARED = 1_000  # names compared to find the one that was meant


def keys(given: Any, known: tuple[str, ...], needed: tuple[str, ...]) -> None:
    """Check the keys of an entry; see `grammar`.

    Raises
    ------
    InputError
        If it is not a table, has unknown keys, or lacks a needed one.
    """
    if not isinstance(given, Mapping):
        raise InputError(f"{given!r} must be a table with {', '.join(needed)}")
    faults = [f"key '{key}' is not known{near(key, known)}" for key in given if key not in known]
    faults += [f"key '{key}' is missing" for key in needed if key not in given]
    if faults:
        raise InputError("; ".join(faults))


def choice(given: Mapping[str, Any], key: str, known: tuple[str, ...], default: str) -> str:
    """Read a key whose value is one of some words.

    Raises
    ------
    InputError
        If the value is none of them.
    """
    value = given.get(key, default)
    if value not in known:
        raise InputError(f"{key} {value!r} is not known; there are {', '.join(known)}")
    return str(value)


def tolerance(given: Mapping[str, Any]) -> Quantity | None:
    """Read the key `time_tolerance`, if it is there.

    Raises
    ------
    InputError
        If it is not a positive time.
    """
    if "time_tolerance" not in given:
        return None
    quantity = parse_quantity(given["time_tolerance"])
    if quantity.unit.dimension not in (TIME, NONE) or quantity.value <= 0:
        raise InputError(f"time_tolerance is '{quantity}', needs a positive time")
    return quantity


def place_tolerance(given: Mapping[str, Any]) -> Quantity | None:
    """Read the key `position_tolerance`, if it is there: how near to zero a function is at the accepted state.

    Raises
    ------
    InputError
        If it is not a positive quantity.
    """
    if "position_tolerance" not in given:
        return None
    quantity = parse_quantity(given["position_tolerance"])
    if not quantity.value > 0:
        raise InputError(f"position_tolerance is '{quantity}', needs a positive quantity")
    return quantity


def described(given: Mapping[str, Any]) -> str:
    """Read the description of an entry.

    Raises
    ------
    InputError
        If it has characters that are not printable.
    """
    text = str(given.get("description", "")).strip()
    if not all(character.isprintable() or character in "\n\t" for character in text):
        raise InputError(f"text {text[:40]!r} has characters that are not printable")
    return text


def flag(given: Mapping[str, Any], key: str) -> bool:
    """Read a truth value, false if the key is not there.

    Raises
    ------
    InputError
        If it is neither true nor false.
    """
    value = given.get(key, False)
    if not isinstance(value, bool):
        raise InputError(f"{key} is {value!r}, needs true or false")
    return value


def near(name: str, known: tuple[str, ...]) -> str:
    """Suggest the word that may have been meant, or list those there are."""
    alike = get_close_matches(name, known[:MOST_COMPARED], n=1)
    return f"; did you mean '{alike[0]}'?" if alike else f"; there are {', '.join(known)}"

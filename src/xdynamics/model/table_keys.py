"""Reading of tables in a model file: keys, choices, texts."""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches
from typing import Any

from xdynamics.faults import InputError

MOST_COMPARED = 1_000  # names compared to find the one that was meant


def keys(entry: Any, known: tuple[str, ...], needed: tuple[str, ...]) -> None:
    """Check the keys of an entry; see `grammar`.

    Raises
    ------
    InputError
        If it is not a table, has unknown keys, or lacks a needed one.
    """
    if not isinstance(entry, Mapping):
        has = f"with {', '.join(needed)}" if needed else f"of keys, such as {', '.join(known[:3])}"
        raise InputError(f"{entry!r} must be a table {has}")
    faults = [f"key '{key}' is not known{near(key, known)}" for key in entry if key not in known]
    faults += [f"key '{key}' is missing" for key in needed if key not in entry]
    if faults:
        raise InputError("; ".join(faults))


def choice(value: Any, key: str, known: tuple[str, ...]) -> str:
    """Read a value that is one of some words.

    Raises
    ------
    InputError
        If it is none of them.
    """
    if value not in known:
        raise InputError(f"{key} {value!r} is not known; there are {', '.join(known)}")
    return str(value)


def near(name: str, known: tuple[str, ...]) -> str:
    """Suggest the word that may have been meant, or list those there are."""
    alike = get_close_matches(name, known[:MOST_COMPARED], n=1)
    return f"; did you mean '{alike[0]}'?" if alike else f"; there are {', '.join(known)}"

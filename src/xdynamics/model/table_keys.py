"""Reading of tables in a model file: keys, choices, texts."""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches
from typing import Any

from xdynamics.faults import InputError

MOST_COMPARED = 1_000  # names compared to find the one that was meant


def check_keys(entry: Any, known_keys: tuple[str, ...], needed: tuple[str, ...]) -> None:
    """Check the keys of an entry; see `grammar`.

    Raises
    ------
    InputError
        If it is not a table, has unknown keys, or lacks a needed one.
    """
    if not isinstance(entry, Mapping):
        has = f"with {', '.join(needed)}" if needed else f"of keys, such as {', '.join(known_keys[:3])}"
        raise InputError(f"{entry!r} must be a table {has}")
    faults = [f"key '{key}' is not known{suggestion(key, known_keys)}" for key in entry if key not in known_keys]
    faults += [f"key '{key}' is missing" for key in needed if key not in entry]
    if faults:
        raise InputError("; ".join(faults))


def read_choice(value: Any, key: str, choices: tuple[str, ...]) -> str:
    """Read a value that is one of some words.

    Raises
    ------
    InputError
        If it is none of them.
    """
    if value not in choices:
        raise InputError(f"{key} {value!r} is not known; there are {', '.join(choices)}")
    return str(value)


def suggestion(name: str, known_names: tuple[str, ...]) -> str:
    """Suggest the word that may have been meant, or list those there are."""
    close_names = get_close_matches(name, known_names[:MOST_COMPARED], n=1)
    return f"; did you mean '{close_names[0]}'?" if close_names else f"; there are {', '.join(known_names)}"

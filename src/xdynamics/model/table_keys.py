"""Reading of tables in a model file: keys, choices, texts."""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches
from typing import Any

from xdynamics.faults import InputError

# what other programs call a key or a choice, and what is written here
MEANT = {
    "file": ("table",),
    "path": ("table",),
    "data": ("table",),
    "over": ("argument",),
    "terminal": ('action = "stop"', "stop"),
    "halt": ("stop",),
    "end": ("stop",),
    "expr": ("function", "expression"),
    "expression": ("function",),
    "condition": ("function",),
    "e": ("restitution",),
    "mu": ("friction",),
    "units": ("unit",),
    "value": ("rate",),
    "derivative": ("rate",),
}
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
    unknown = [key for key in entry if key not in known_keys]
    faults = [f"key '{key}' is not known{_meant_key(key, known_keys)}" for key in unknown]
    if unknown and not all("write" in fault or "mean" in fault for fault in faults):
        faults[-1] += f"; there are {', '.join(known_keys)}"
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
        meant = next((f"; write {word!r}" for word in MEANT.get(str(value), ()) if word in choices), "")
        raise InputError(f"{key} {value!r} is not known" + (meant or f"; there are {', '.join(choices)}"))
    return str(value)


def _meant_key(key: str, known_keys: tuple[str, ...]) -> str:
    """Return the key that may have been meant, by other programs' words or by its letters; else nothing."""
    for word in MEANT.get(key, ()):
        if word.partition(" ")[0] in known_keys:
            return f"; write {word}"
    close_names = get_close_matches(key, known_keys[:MOST_COMPARED], n=1)
    return f"; did you mean '{close_names[0]}'?" if close_names else ""


def suggestion(name: str, known_names: tuple[str, ...]) -> str:
    """Suggest the word that may have been meant, or list those there are."""
    close_names = get_close_matches(name, known_names[:MOST_COMPARED], n=1)
    return f"; did you mean '{close_names[0]}'?" if close_names else f"; there are {', '.join(known_names)}"

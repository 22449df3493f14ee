"""Functions written in Python, as a model takes them: the function itself, or the description an archive keeps."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from xdynamics.faults import InputError
from xdynamics.model.parts import Function
from xdynamics.model.table_keys import check_keys

Functions = Mapping[str, Callable[..., float]]


def read_function(entry: Any, functions: Functions) -> Function:
    """Read a Python function, or a table that describes one.

    Raises
    ------
    InputError
        If it cannot be read, or the function passed is a different one.
    """
    if callable(entry):
        return Function.from_callable(entry)
    check_keys(entry, ("function", "arguments", "digest", "source"), needed=("function", "digest"))
    name, arguments = entry["function"], entry.get("arguments", [])
    texts = [name, entry["digest"], entry.get("source", ""), *(arguments if isinstance(arguments, list) else [None])]
    if not all(isinstance(text, str) for text in texts):
        raise InputError(f"function {name!r} needs texts: its name, digest, source and a list of arguments")
    recorded_function = Function(name, tuple(arguments), entry.get("source", ""), entry["digest"])
    if name not in functions:
        return recorded_function
    passed = Function.from_callable(functions[name])
    if passed.digest != recorded_function.digest:
        raise InputError(
            f"function '{name}' handed over has digest {passed.digest[:12]}…, the model was made with"
            f" {recorded_function.digest[:12]}…"
        )
    return passed

"""Reading of events and regimes from a model file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from xdynamics.expressions import Node, parse
from xdynamics.faults import InputError
from xdynamics.model.grammar import keys_of
from xdynamics.model.parts import ACTIONS, DIRECTIONS, ROOT_STATES, STRIKE, Event, Function, Regime
from xdynamics.model.python import Functions, expression_or_function
from xdynamics.model.table_keys import choice, described, place_tolerance, tolerance
from xdynamics.units import parse_unit

_OF_ACTIONS = {"to": "switch", "set": "reset"}  # keys that one action needs and no other takes


def event(given: Any, functions: Functions) -> Event:
    """Read an event; its function may be written in Python.

    Raises
    ------
    InputError
        Naming the key that is wrong.
    """
    keys_of("events", given)
    action = choice(given, "action", (*ACTIONS, STRIKE), "record")
    for key, needed in _OF_ACTIONS.items():
        if action == needed and key not in given:
            raise InputError(f"action '{action}' needs the key '{key}'")
        if action != needed and key in given:
            raise InputError(f"key '{key}' is for action '{needed}': '{action}' does not take it")
    within = tolerance(given)
    function = expression_or_function(given["function"], functions)
    if "unit" in given and not isinstance(function, Function):
        raise InputError("key 'unit' is for a function written in Python: an expression has its own")
    count = given.get("count", 1)
    if isinstance(count, bool) or not isinstance(count, int) or not 1 <= count < 1 << 31:
        raise InputError(f"count is {count!r}, needs a whole number from 1 on: the time at which to act")
    if count > 1 and action == "record":
        raise InputError(f"count is {count}, and action 'record' does nothing that could wait for it")
    if not isinstance(given.get("to", ""), str):
        raise InputError(f"to is {given['to']!r}, needs the name of a regime")
    return Event(
        function,
        choice(given, "direction", DIRECTIONS, "either"),
        action,
        within,
        described(given),
        to=given.get("to", ""),
        reset=_reset(given.get("set", {})),
        count=count,
        root_state=choice(given, "root_state", ROOT_STATES, "reintegrate"),
        unit=parse_unit(given["unit"]) if "unit" in given else None,
        position_tolerance=place_tolerance(given),
    )


def _reset(entries: Any) -> dict[str, Node]:
    """Read the new values that an event sets."""
    if not isinstance(entries, Mapping):
        raise InputError(f'set is {entries!r}, needs a table like {{ v_y = "-v_y" }}')
    values = {}
    for name, text in entries.items():
        try:
            values[name] = parse(text)
        except InputError as error:
            raise InputError(f"set '{name}': {error}") from None
    return values


def regime(given: Any) -> Regime:
    """Read a regime.

    Raises
    ------
    InputError
        If its forces are not a list of distinct names.
    """
    keys_of("regimes", given)
    names = given["forces"]
    if not isinstance(names, list | tuple) or not all(isinstance(name, str) for name in names):
        raise InputError(f"forces is {names!r}, needs a list of the forces that act in it")
    if len(set(names)) < len(names):
        raise InputError(f"forces lists one of {', '.join(names)} twice")
    return Regime(tuple(names), described(given))

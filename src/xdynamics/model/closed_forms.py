"""Closed forms in a model file: what a run should give, and within which bound."""

from __future__ import annotations

import re
from typing import Any

from xdynamics.expressions import dimension_of, free_names
from xdynamics.faults import InputError, Ledger
from xdynamics.model.kinds import Kind
from xdynamics.model.statement import Statement
from xdynamics.shapes.naming import quantity_name
from xdynamics.units import Dimension, Quantity, parse_quantity, spell

ROUNDING, ORDER, BAND, UNSCALED = "rounding", "order", "band", "unscaled"
_FROM_ORDER = re.compile(r"rounding from order ([1-9]\d?)")
WORDS = f"'{ROUNDING}', '{ROUNDING} from order 2', '{ORDER}', '{BAND}', '{UNSCALED}'"


def _read_bound(entry: Any, *_: Any) -> str | Quantity:
    """Read a bound: a quantity, or a word for how it is derived."""
    if isinstance(entry, str) and (entry in (ROUNDING, ORDER, BAND, UNSCALED) or _FROM_ORDER.fullmatch(entry)):
        return entry
    try:
        quantity = parse_quantity(entry)
    except InputError:
        raise InputError(f"bound is {entry!r}, needs a quantity like '1 mm', or one of {WORDS}") from None
    if not quantity.value > 0.0:
        raise InputError(f"bound is {entry!r}, needs a positive one")
    return quantity


BOUND = Kind(f"quantity, {WORDS}".replace("'", '"'), _read_bound, lambda bound, _: str(bound))


def exact_from(bound: str) -> int:
    """Return the order from which methods have rounding errors only; 0 if all methods do."""
    match = _FROM_ORDER.fullmatch(bound)
    return int(match[1]) if match else 0


def check_validation(statement: Statement, dimensions: dict[str, Dimension], ledger: Ledger) -> None:
    """Note what is wrong with names and dimensions of closed forms, which may read time, parameters and unit names.

    Of a statement with dimensions each is checked once, for all elements of its quantity.
    """
    moving = {
        *statement.coordinates,
        *statement.states,
        *statement.drives,
        *(f"v_{name}" for name in statement.coordinates),
    }
    event_names = {*statement.events, *statement.contacts, *statement.frictions}
    for name, form in statement.validation.items():
        with ledger.entry(f"validation '{name}'"):
            dimension = dimension_of(form.expression, dimensions)
            if computed := sorted(free_names(form.expression) & moving):
                raise InputError(
                    f"reads '{computed[0]}', which is what is computed; a closed form is of t and parameters"
                )
            quantity, event = (quantity_name(word) for word in (form.quantity, form.event))
            if event and event not in event_names:
                raise InputError(
                    f"event '{form.event}' is none of the model's; there are {', '.join(sorted(event_names)) or 'none'}"
                )
            needed = (
                statement.time_unit.dimension
                if quantity == "t" and event
                else dimensions.get(quantity)
                if quantity in moving
                else None
            )
            if needed is not None and dimension != needed:
                raise InputError(f"has units '{dimension}', needs '{needed}' of '{form.quantity}'")
            if isinstance(form.bound, Quantity) and form.bound.unit.dimension != dimension:
                raise InputError(
                    f"bound '{form.bound}' has units '{form.bound.unit.dimension}', needs '{spell(dimension).text}'"
                )

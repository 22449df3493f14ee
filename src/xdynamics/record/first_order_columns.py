"""First-order states along the steps of a record: those of the motion with their rates, and what controllers hold."""

from __future__ import annotations

from collections.abc import Iterator

from xdynamics.model.controllers import held
from xdynamics.record.column import About
from xdynamics.schema import HELD
from xdynamics.shapes.blocks import Block as Quantity


def of_first_order(about: About) -> Iterator[tuple[Quantity, str]]:
    """Yield first-order states and their rates, each with its long name; what controllers hold has a role and no rate."""
    layout, model = about.layout, about.model
    kept = held(model.controllers, model.time_unit)
    for own, rate in zip(layout.states.blocks, layout.rates.blocks, strict=True):
        called = layout.declared.states[own.name].description or f"state {own.name}"
        if own.name in kept:
            yield own._replace(role=HELD), called
        else:
            yield own, called
            yield rate, f"rate of {own.name}"

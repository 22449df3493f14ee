"""First-order states along the steps of a record: those of the motion with their rates, and what controllers hold."""

from __future__ import annotations

from collections.abc import Iterator

from xdynamics.model.controllers import controller_states
from xdynamics.record.column import About
from xdynamics.schema import HELD
from xdynamics.shapes.blocks import Block as Quantity


def of_first_order(about: About) -> Iterator[tuple[Quantity, str]]:
    """Yield first-order states and their rates, each with its long name; what controllers hold has a role and no rate."""
    layout, model = about.layout, about.model
    held_states = controller_states(model.controllers, model.time_unit)
    for state, rate in zip(layout.states.blocks, layout.rates.blocks, strict=True):
        long_name = layout.declared.states[state.name].description or f"state {state.name}"
        if state.name in held_states:
            yield state._replace(role=HELD), long_name
        else:
            yield state, long_name
            yield rate, f"rate of {state.name}"

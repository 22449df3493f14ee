"""What the delayed values of a model are read from: the motion, and what was before the start."""

from __future__ import annotations

from xdynamics.expressions import Name, Node, expand, free_names
from xdynamics.model.delays import slope_before, value_at_start, value_before
from xdynamics.model.model import Model
from xdynamics.units import Dimension


def delayed_names(model: Model) -> dict[str, tuple[int, str]]:
    """Return every name of a delayed value, of its time derivative, or of its time: the delay, and what is delayed."""
    delay_by_name: dict[str, tuple[int, str]] = {}
    for delay in range(len(model.delays)):
        delay_by_name[value_before(delay, "t")] = delay, "t"
        for name in (*model.moving, *model.drives):
            value = value_before(delay, name)
            delay_by_name |= {value: (delay, name), slope_before(value): (delay, name)}
    return delay_by_name


def delayed_dimensions(model: Model) -> dict[str, Dimension]:
    """Return the dimension of every name of a delayed value."""
    return {
        name: model.dimensions[owner]
        for name, (delay, owner) in delayed_names(model).items()
        if name == value_before(delay, owner)
    }


def delayed_quantities(model: Model) -> list[str]:
    """Return the coordinates, velocities and states that are delayed somewhere, in their order."""
    calls = model.statement.delayed
    read = {name for call in calls for name in free_names(expand(call.arguments[0], model.definitions))}
    arguments = [model.expanded(model.drives[name].argument) for name in model.drives if name in read]
    read |= {name for tree in arguments for name in free_names(tree)}
    return [name for name in model.units if name in read]


def before_start(model: Model, name: str, delay: int) -> Node:
    """Return what something was before the start, at the time of a delay."""
    if name not in model.history:
        return Name(value_at_start(name))
    return expand(model.history[name], {**model.definitions, "t": Name(value_before(delay, "t"))})

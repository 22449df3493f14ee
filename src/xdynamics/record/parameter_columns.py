"""Parameters of a model as variables of a record."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from xdynamics.model import Model
from xdynamics.model.elementwise import Elementwise, ParameterNumbers, numbers_of
from xdynamics.model.parts import Parameter
from xdynamics.record.folded_columns import folded_constants
from xdynamics.schema import Variable


def parameters(model: Model) -> list[tuple[Variable, Any]]:
    """Return the parameters with their values."""
    entries: list[tuple[Variable, Any]] = []
    for name, parameter in _parted(model.statement.parameters):
        if isinstance(parameter, ParameterNumbers):
            unit, long_name = parameter.unit.text, parameter.given.description or f"parameter {name}"
            dims = model.shapes.dims[name]
            entries.append((Variable(name, dims, "f8", unit, long_name, "parameter", {}), parameter.values))
            continue
        extra = uncertainty_attributes(parameter)
        long_name = parameter.description or f"parameter {name}"
        entries.append(
            (
                Variable(name, (), "f8", parameter.quantity.unit.text, long_name, "parameter", extra),
                parameter.quantity.value,
            )
        )
    return folded_constants(entries, model.shapes)


def uncertainty_attributes(parameter: Parameter) -> dict[str, Any]:
    """Return what says how uncertain a parameter is: its standard uncertainty in a unit, and its distribution.

    The half width between bounds is there where the model states it.
    """
    spread = parameter.spread
    if spread is None:
        return {}
    unit = parameter.quantity.unit
    said: dict[str, Any] = {
        "uncertainty": parameter.uncertainty,
        "uncertainty_kind": "standard",
        "uncertainty_units": unit.text,
        "uncertainty_distribution": spread.distribution,
    }
    if spread.bounded:
        said["uncertainty_half_width"] = float(spread.size.unit.factor / unit.factor) * spread.size.value
    if spread.degrees_of_freedom is not None:
        said["uncertainty_degrees_of_freedom"] = spread.degrees_of_freedom
    return said


def _parted(parameters: Mapping[str, Parameter]) -> Iterator[tuple[str, Parameter | ParameterNumbers]]:
    """Yield parameters by name, those with dimensions whole, unless their elements have distributions."""
    if not isinstance(parameters, Elementwise):
        yield from parameters.items()
        return
    for block in parameters.names.blocks:
        made = numbers_of(parameters, block.name)
        if made is None or any(made.given.spreads):
            yield from ((name, parameters[name]) for name in block.elements())
        else:
            yield block.name, made

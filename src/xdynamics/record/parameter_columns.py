"""Parameters of a model as variables of a record."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from xdynamics.model import Model
from xdynamics.model.elementwise import Elementwise, ParameterNumbers, parameter_numbers
from xdynamics.model.parts import Parameter
from xdynamics.record.folded_columns import folded_constants
from xdynamics.schema import Variable


def parameter_variables(model: Model) -> list[tuple[Variable, Any]]:
    """Return the parameters with their values."""
    entries: list[tuple[Variable, Any]] = []
    for name, parameter in _parameters_by_block(model.statement.parameters):
        if isinstance(parameter, ParameterNumbers):
            unit, long_name = parameter.unit.text, parameter.declared_values.description or f"parameter {name}"
            dims = model.shapes.dims[name]
            entries.append((Variable(name, dims, "f8", unit, long_name, "parameter", {}), parameter.values))
            continue
        extra = _uncertainty_attributes(parameter)
        long_name = parameter.description or f"parameter {name}"
        entries.append(
            (
                Variable(name, (), "f8", parameter.quantity.unit.text, long_name, "parameter", extra),
                parameter.quantity.value,
            )
        )
    return folded_constants(entries, model.shapes)


def _uncertainty_attributes(parameter: Parameter) -> dict[str, Any]:
    """Return the attributes that say how uncertain a parameter is, in its own unit, and by which distribution."""
    spread = parameter.spread
    if spread is None:
        return {}
    attributes = {
        "uncertainty": parameter.uncertainty,
        "uncertainty_kind": "standard",
        "uncertainty_units": parameter.quantity.unit.text,
        "uncertainty_distribution": spread.distribution,
        "uncertainty_half_width": parameter.half_width,
        "uncertainty_degrees_of_freedom": spread.degrees_of_freedom,
    }
    return {name: value for name, value in attributes.items() if value is not None}


def _parameters_by_block(parameters: Mapping[str, Parameter]) -> Iterator[tuple[str, Parameter | ParameterNumbers]]:
    """Yield parameters by name, those with dimensions whole, unless their elements have distributions."""
    if not isinstance(parameters, Elementwise):
        yield from parameters.items()
        return
    for block in parameters.names.blocks:
        made = parameter_numbers(parameters, block.name)
        if made is None or any(made.declared_values.spreads):
            yield from ((name, parameters[name]) for name in block.elements())
        else:
            yield block.name, made

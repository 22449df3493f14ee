"""The initial-value problem: coordinates, mass, forces, drives, events, initial state.

What was written is a `statement`: of a quantity with dimensions it has one entry for all elements. Where single numbers
are needed, as for a constraint or a message, `Model.elements` is the same model without dimensions.
"""

from xdynamics.model.drives import Table
from xdynamics.model.model import Model, check_model
from xdynamics.model.parts import Coordinate, Drive, Event, Force, Function, Parameter, State
from xdynamics.model.traits import Trait, traits_of

__all__ = [
    "Coordinate",
    "Drive",
    "Event",
    "Force",
    "Function",
    "Model",
    "Parameter",
    "State",
    "Table",
    "Trait",
    "check_model",
    "traits_of",
]

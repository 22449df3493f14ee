"""The initial-value problem: coordinates, mass, forces, drives, events, initial state."""

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

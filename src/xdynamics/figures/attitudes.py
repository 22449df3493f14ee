"""What figures show of bodies that turn: attitudes and angular velocities, and no integral of these."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import xarray as xr

from xdynamics.dynamics.recorded_models import model_of_record
from xdynamics.model.bodies import position, quasi_coordinate, unit_quaternions
from xdynamics.schema import velocity


class BodyVariables:
    """The variables of bodies in a record, element by element.

    Attributes
    ----------
    attitudes : list of list of str
        The four parts of every quaternion.
    angular_velocities : set of str
        Angular velocities, along the axes of the bodies.
    positions : set of str
        Where bodies are.
    hidden_names : set of str
        What is not drawn unless it is asked for: integrals of angular velocities, and where a body is that rests.
    """

    def __init__(self, run: xr.Dataset) -> None:
        model = model_of_record(run, None) if "model_toml" in run else None
        bodies = model.shaped.bodies if model is not None else {}
        self.attitudes: list[list[str]] = []
        self.angular_velocities, self.positions, self.hidden_names = set[str](), set[str](), set[str]()
        if model is None or not bodies:
            return
        quads = [[*parts] for parts in unit_quaternions(bodies, model.shapes)]
        self.attitudes = [parts for parts in quads if all(part in run for part in parts)]
        for body in bodies:
            turns = model.shapes.elements(quasi_coordinate(body))
            self.angular_velocities |= {velocity(name) for name in turns}
            self.hidden_names |= {*turns}
            places = [] if bodies[body].pivot else model.shapes.elements(position(body))
            self.positions |= {*places}
            if not any(name in run and np.ptp(run.variables[name].values) for name in places):
                self.hidden_names |= {*places, *map(velocity, places)}

    @property
    def quaternion_parts(self) -> set[str]:
        """All parts of quaternions."""
        return {part for parts in self.attitudes for part in parts}

    def visible_names(self, names: list[str]) -> list[str]:
        """Return what of some variables is drawn without being asked for."""
        return [name for name in names if name not in self.hidden_names | self.quaternion_parts]

    def titled_velocities(self, names: list[str]) -> Iterator[tuple[str, list[str]]]:
        """Yield angular velocities in bodies, and other velocities, with a title for each."""
        yield "angular velocity in the body", [name for name in names if name in self.angular_velocities]
        yield "velocity", [name for name in names if name not in self.angular_velocities]

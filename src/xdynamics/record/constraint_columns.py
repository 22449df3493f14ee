"""What a record has of constraints: multipliers, residuals, rates, rank, and how far each step's result was moved."""

from __future__ import annotations

from collections.abc import Iterator

from xdynamics.expressions import dimension_of, text_of
from xdynamics.model.body_sections import AXES
from xdynamics.model.constraints import conditions
from xdynamics.model.parts import Constraint
from xdynamics.reaction_names import (
    JOINT,
    PROJECTION,
    RANK,
    constraint_force,
    constraint_rate,
    constraint_residual,
    joint_force,
    joint_torque,
)
from xdynamics.record.column import About, Column, take_row
from xdynamics.record.element_attributes import quantity_of
from xdynamics.schema import STEPS, Variable
from xdynamics.shapes.naming import join_element_name
from xdynamics.units import Unit, parse_unit, spell


def of_constraints(about: About) -> Iterator[Column]:
    """Yield the columns of constraints along the steps."""
    layout, units = about.layout, about.units
    for condition in conditions(about.model):
        name = condition.name
        constraint = about.model.shaped.constraints[quantity_of(name)]
        noun = constraint.description or f"constraint {name}"
        made = constraint_force(name)
        words = f"multiplier of {noun}: the force on a coordinate is it times the derivative"
        yield _constraint_column(
            about, made, units.known[made], words, "multiplier", _constraint_attributes(constraint)
        )
        for made, words in (
            (constraint_residual(name), f"how far positions are from {noun}"),
            (constraint_rate(name), f"how fast velocities leave {noun}"),
        ):
            if made in layout.constraint_outputs:
                unit = spell(dimension_of(layout.constraint_outputs[made], about.model.dimensions))
                yield _constraint_column(about, made, unit, words, "residual", {})
    yield from _of_joints(about)
    if layout.constraint_diagnostics:
        index = layout.row.offset_of(RANK.name)
        yield Column(RANK, lambda block: block.log.rows[index, : block.rows].astype("i4"))
        yield Column(PROJECTION, take_row(layout.row.offset_of(PROJECTION.name), 1.0))


def _of_joints(about: About) -> Iterator[Column]:
    """Yield the columns of the force and the torque in each joint, along the axes of space."""
    for name, joint in about.model.joints.items():
        first, second = joint.bodies
        where = (
            f"in {joint.description or f'joint {name}'}, on {first} at the point of {second}, along the axes of space"
        )
        more = {"acts_on": first, "acts_from": second}
        for noun, made, unit in (("force", joint_force(name), "N"), ("torque", joint_torque(name), "N m")):
            for axis in AXES:
                if (owner := join_element_name(made, [axis])) in about.layout.constraint_outputs:
                    yield _constraint_column(about, owner, parse_unit(unit), f"{noun} {where}", JOINT, more)


def _constraint_column(about: About, name: str, unit: Unit, long_name: str, role: str, more: dict[str, str]) -> Column:
    variable = Variable(name, (STEPS,), "f8", unit.text, long_name, role, more)
    return Column(variable, take_row(about.layout.row.offset_of(name), about.units.factor(unit)))


def _constraint_attributes(constraint: Constraint) -> dict[str, str]:
    """Return what the model says of a constraint, as attributes of its multiplier."""
    key, differentiated_by = ("rolls", "velocities") if constraint.holds is None else ("holds", "coordinates")
    return {key: text_of(constraint.condition), "acts_along": f"derivative of {key} by the {differentiated_by}"}

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
from xdynamics.record.column import About, Column, row_of
from xdynamics.record.element_attributes import of_whole
from xdynamics.schema import STEPS, Variable
from xdynamics.shapes.naming import element
from xdynamics.units import Unit, parse_unit, spell


def of_constraints(about: About) -> Iterator[Column]:
    """Yield the columns of constraints along the steps."""
    layout, units = about.layout, about.units
    for condition in conditions(about.model):
        name = condition.name
        constraint = about.model.shaped.constraints[of_whole(name)]
        noun = constraint.description or f"constraint {name}"
        made = constraint_force(name)
        words = f"multiplier of {noun}: the force on a coordinate is it times the derivative"
        yield _column(about, made, units.known[made], words, "multiplier", _declared(constraint))
        for made, words in (
            (constraint_residual(name), f"how far positions are from {noun}"),
            (constraint_rate(name), f"how fast velocities leave {noun}"),
        ):
            if made in layout.kept:
                unit = spell(dimension_of(layout.kept[made], about.model.dimensions))
                yield _column(about, made, unit, words, "residual", {})
    yield from _of_joints(about)
    if layout.standing:
        index = layout.row.place(RANK.name)
        yield Column(RANK, lambda block: block.log.rows[index, : block.rows].astype("i4"))
        yield Column(PROJECTION, row_of(layout.row.place(PROJECTION.name), 1.0))


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
                if (owner := element(made, [axis])) in about.layout.kept:
                    yield _column(about, owner, parse_unit(unit), f"{noun} {where}", JOINT, more)


def _column(about: About, name: str, unit: Unit, long_name: str, role: str, more: dict[str, str]) -> Column:
    variable = Variable(name, (STEPS,), "f8", unit.text, long_name, role, more)
    return Column(variable, row_of(about.layout.row.place(name), about.units.factor(unit)))


def _declared(constraint: Constraint) -> dict[str, str]:
    """Return what the model says of a constraint, as attributes of its multiplier."""
    key, by = ("rolls", "velocities") if constraint.holds is None else ("holds", "coordinates")
    return {key: text_of(constraint.condition), "acts_along": f"derivative of {key} by the {by}"}

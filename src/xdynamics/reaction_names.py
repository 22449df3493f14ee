"""Names in a record for forces of contacts, dry friction, constraints and joints; all others are in `schema`."""

from __future__ import annotations

from xdynamics.schema import STEPS, Variable


def contact_force(name: str) -> str:
    """Name the normal force of a contact."""
    return f"contact_force_{name}"


def contact_gap(name: str) -> str:
    """Name the gap of a contact."""
    return f"contact_gap_{name}"


def contact_state(name: str) -> str:
    """Name the state of a contact."""
    return f"contact_state_{name}"


def friction_force(name: str) -> str:
    """Name the friction force of a contact or of a friction element."""
    return f"friction_force_{name}"


def friction_state(name: str) -> str:
    """Name the state of friction."""
    return f"friction_state_{name}"


def constraint_force(name: str) -> str:
    """Name the multiplier of a constraint."""
    return f"constraint_force_{name}"


def constraint_residual(name: str) -> str:
    """Name how far positions are from where a constraint holds."""
    return f"constraint_residual_{name}"


def constraint_rate(name: str) -> str:
    """Name how fast positions leave it: what velocities have of it."""
    return f"constraint_rate_{name}"


JOINT = "joint"  # the role of forces and torques in joints


def joint_force(name: str) -> str:
    """Name the force in a joint."""
    return f"joint_force_{name}"


def joint_torque(name: str) -> str:
    """Name the torque in a joint."""
    return f"joint_torque_{name}"


RANK = Variable(
    "constraint_rank",
    (STEPS,),
    "i4",
    "1",
    "number of constraints whose gradients are independent at this state",
    "constraint",
)
PROJECTION = Variable(
    "constraint_projection",
    (STEPS,),
    "f8",
    "1",
    "how far the step's result was moved to where constraints hold: the greatest residual before, over the size of its terms",
    "constraint",
)

"""Names that the record of a model uses, each with the entry of the model that claims it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from xdynamics.reaction_names import (
    PROJECTION,
    RANK,
    constraint_force,
    constraint_rate,
    constraint_residual,
    contact_force,
    contact_gap,
    contact_state,
    friction_force,
    friction_state,
    joint_force,
    joint_torque,
)
from xdynamics.schema import (
    CLOSED_LINKS,
    DIMENSIONS,
    DOCUMENT,
    ENERGIES,
    EVENT_UNCERTAINTIES,
    FIRST_PASSED,
    FIXED,
    PASSED,
    acceleration,
    end_of,
    error,
    force,
    label_of,
    rate,
    sample_name,
    velocity,
)

OTHER_NAMES = (
    "regime",
    "event_detector",
    "event_residual",
    "event_function_uncertainty",
    "event_substeps",
    "error_norm",
    "newton_iterations",
    "attitude_deviation",
    "given_step_size",
    "end_memory",
    PASSED.name,
    RANK.name,
    PROJECTION.name,
    FIRST_PASSED.name,
    *ENERGIES,
    *(dim for dim in DIMENSIONS if dim != DOCUMENT),
)


def _coordinate_names(name: str) -> tuple[str, ...]:
    position_and_velocity = (name, velocity(name))
    record_names = (*position_and_velocity, acceleration(name), f"event_impulse_{name}", f"event_offset_{name}")
    return (*record_names, *map(sample_name, position_and_velocity), *map(error, position_and_velocity))


def _reaction_names(name: str) -> tuple[str, ...]:
    return (name, sample_name(name))


def _friction_names(name: str) -> tuple[str, ...]:
    return (friction_state(name), *_reaction_names(friction_force(name)))


# what entries of a section call variables of the record
_CLAIMED: dict[str, Callable[[str], tuple[str, ...]]] = {
    "parameters": lambda name: (name,),
    "definitions": lambda name: (name,),
    "observables": lambda name: (name, f"event_{name}", f"event_{name}_uncertainty"),
    "drives": lambda name: (name, sample_name(name)),
    "coordinates": _coordinate_names,
    "states": lambda name: (name, rate(name), sample_name(name), error(name)),
    "contacts": lambda name: (
        contact_gap(name),
        contact_state(name),
        *_reaction_names(contact_force(name)),
        *_friction_names(name),
    ),
    "frictions": _friction_names,
    "constraints": lambda name: (
        constraint_residual(name),
        constraint_rate(name),
        *_reaction_names(constraint_force(name)),
    ),
    "joints": lambda name: (joint_force(name), joint_torque(name)),
}


def _dimension_names(parts: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield the names of parameters with dimensions, of labels, of ends of links, and of elements at events."""
    for name in parts["arrays"]:
        yield name, f"parameter '{name}'"
    for section, entry_kind in (("extents", "dimension"), ("relations", "relation")):
        for name in parts[section]:
            made = (label_of(name),) if section == "extents" else (end_of(name, "first"), end_of(name, "second"))
            for variable_name in (*made, f"event_{name}"):
                yield variable_name, f"{entry_kind} '{name}'"


def _is_used(name: str, parts: Mapping[str, Any]) -> bool:
    """Whether a name is one of every record, or of those of a model like this."""
    if name == CLOSED_LINKS:
        return bool(parts["extents"])
    return bool(parts["constraints"]) if name in (RANK.name, PROJECTION.name) else True


def claimed_names(parts: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield every name that the record of a model uses, each with what claims it."""
    for variable in (*FIXED, *EVENT_UNCERTAINTIES):
        yield variable.name, "the record"
    for name in OTHER_NAMES:
        if _is_used(name, parts):
            yield name, "the record"
    for section, claimed in _CLAIMED.items():
        for name in parts[section]:
            for variable_name in claimed(name):
                yield variable_name, f"{section.removesuffix('s')} '{name}'"
    yield from _dimension_names(parts)
    yield from ((name, f"body '{name}'") for name in parts["bodies"])
    for section in ("events", "contacts", "frictions"):  # the flags of `event_detector`
        for name in parts[section]:
            yield f"detector {name}", f"{section.removesuffix('s')} '{name}'"
    for term, one_force in parts["forces"].items():
        for name in one_force.components or parts["coordinates"]:
            yield force(term, name), f"force '{term}'"
            yield sample_name(force(term, name)), f"force '{term}'"

"""Checks of a model's names: permitted spellings, and a single owner for each name of its record.

Every name that the record of a model uses is listed with the entry of the model that claims it.
"""

from __future__ import annotations

import keyword
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from xdynamics import schema
from xdynamics.expressions import CALLED_ALONE, FUNCTIONS
from xdynamics.faults import Ledger, ModelError
from xdynamics.model.statement import Statement
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
from xdynamics.schema import force
from xdynamics.units import CONSTANTS

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
    schema.PASSED.name,
    RANK.name,
    PROJECTION.name,
    schema.FIRST_PASSED.name,
    *schema.ENERGIES,
    *(dim for dim in schema.DIMENSIONS if dim != schema.DOCUMENT),
)


def _coordinate_names(name: str) -> tuple[str, ...]:
    position_and_velocity = (name, schema.velocity(name))
    record_names = (*position_and_velocity, schema.acceleration(name), f"event_impulse_{name}", f"event_offset_{name}")
    return (*record_names, *map(schema.sample_name, position_and_velocity), *map(schema.error, position_and_velocity))


def _reaction_names(name: str) -> tuple[str, ...]:
    return (name, schema.sample_name(name))


def _friction_names(name: str) -> tuple[str, ...]:
    return (friction_state(name), *_reaction_names(friction_force(name)))


# what entries of a section call variables of the record
_CLAIMED: dict[str, Callable[[str], tuple[str, ...]]] = {
    "parameters": lambda name: (name,),
    "definitions": lambda name: (name,),
    "observables": lambda name: (name, f"event_{name}", f"event_{name}_uncertainty"),
    "drives": lambda name: (name, schema.sample_name(name)),
    "coordinates": _coordinate_names,
    "states": lambda name: (name, schema.rate(name), schema.sample_name(name), schema.error(name)),
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
            made = (
                (schema.label_of(name),)
                if section == "extents"
                else (schema.end_of(name, "first"), schema.end_of(name, "second"))
            )
            for variable_name in (*made, f"event_{name}"):
                yield variable_name, f"{entry_kind} '{name}'"


def _is_used(name: str, parts: Mapping[str, Any]) -> bool:
    """Whether a name is one of every record, or of those of a model like this."""
    if name == schema.CLOSED_LINKS:
        return bool(parts["extents"])
    return bool(parts["constraints"]) if name in (RANK.name, PROJECTION.name) else True


def _share_names(parts: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    for section, owner in (("forces", "force"), ("states", "state")):
        for name in parts[section]:
            for switch in ("sign", "where"):
                yield schema.share_of(f"{name}.{switch}"), f"switch of {owner} '{name}'"


def claimed_names(parts: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield every name that the record of a model uses, with the entry that claims it."""
    for variable in (*schema.FIXED, *schema.EVENT_UNCERTAINTIES):
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
    yield from _share_names(parts)
    for term, one_force in parts["forces"].items():
        for name in one_force.components or parts["coordinates"]:
            yield force(term, name), f"force '{term}'"
            yield schema.sample_name(force(term, name)), f"force '{term}'"


_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}")


MOST_EVENTS = 100


# what no dimension may be called: dimensions of records and of evidence, and what `event_…` names beside elements
OF_RECORD = {
    "step", "trial", "event", "sample", "bound", "at", "level", "occurrence", "cycle", "case", "exponent", "given",
    "memory", "smooth_switch", "term", "parameter", "mode", "closed", "run", "time", "kind", "direction", "detector",
    "residual", "first", "second", "turn", "variable", "draw", "method", "rtol", "eigenvalue", "start", "other", "gate",
    "sweep_axis",
}  # fmt: skip


# names that records have since schema 2, or keep free: no new model has them, while archives with them open as they are
OF_TODAY = {"closed_time", "at_time", "document", "energy_balance", "energy_balance_verdict"}
DIMENSIONS_OF_TODAY = {"document", "point", "member"}
RESERVED = {"t", "pi", *CONSTANTS, *FUNCTIONS} - {*CALLED_ALONE}


def check_names_of_today(statement: Statement) -> None:
    """Refuse names that records have since schema 2.

    Raises
    ------
    ModelError
        Naming them all.
    """
    ledger = Ledger(f"model '{statement.name}'", ModelError)
    work = {f"work_{force}" for force in statement.forces}
    shares = tuple(f"switch_share_{owner}" for owner in (*statement.forces, *statement.states, "mass"))
    for section in ("coordinates", "parameters", "arrays", "definitions", "drives", "states", "observables"):
        for name in map(str, getattr(statement, section)):
            if name in OF_TODAY | work or name.startswith(("solver_", *shares)):
                ledger.note(f"{_entry_kind(section)} '{name}': the record of a run has that name; rename it")
    for section in ("extents", "relations"):
        for name in getattr(statement, section):
            if name in DIMENSIONS_OF_TODAY:
                ledger.note(f"{_entry_kind(section)} '{name}': records have a dimension of that name; rename it")
    ledger.raise_faults()


def check_names(statement: Statement, ledger: Ledger) -> None:
    """Check that every name is permitted, and that no two entries claim one name of the record."""
    if not statement.coordinates and not statement.states:
        ledger.note("has neither coordinates nor states: there is nothing to integrate")
    if len(statement.events) > MOST_EVENTS:
        ledger.note(f"has {len(statement.events)} events, {MOST_EVENTS} at most")
    functions = statement.functions
    for name in sorted({function.name for function in functions}):
        if len({function.digest for function in functions if function.name == name}) > 1:
            ledger.note(f"two different functions are named '{name}'; rename one")
    owner_of: dict[str, str] = {}
    sections = (
        "extents",
        "relations",
        "bodies",
        "coordinates",
        "parameters",
        "arrays",
        "definitions",
        "drives",
        "states",
        "forces",
        "events",
        "contacts",
        "frictions",
        "constraints",
        "joints",
        "regimes",
        "observables",
    )
    refused = set[str]()
    for section in sections:
        for name in getattr(statement, section):
            if fault := _name_fault(section, str(name)):
                refused.add(str(name))
                ledger.note(f"{_entry_kind(section)} '{name}': {fault}")
    for name, owner in claimed_names(vars(statement)):
        if name in owner_of and not _is_said_elsewhere(name, owner, owner_of[name], refused):
            ledger.note(f"{owner} and {owner_of[name]} both claim the name '{name}'; rename one")
        owner_of.setdefault(name, owner)
    owner_of |= {name: f"definition '{name}'" for name in statement.definitions}
    for section in ("extents", "relations"):
        for name in getattr(statement, section):
            if name in owner_of and name not in refused:
                ledger.note(f"{_entry_kind(section)} '{name}' and {owner_of[name]} have one name; rename one")
            owner_of.setdefault(name, f"{_entry_kind(section)} '{name}'")


def _is_said_elsewhere(name: str, owner: str, second_owner: str, refused: set[str]) -> bool:
    """Whether two owners of a name in the record have a fault of their own: one may not be called so, or both are."""
    if owner in {f"dimension '{word}'" for word in refused}:
        return True
    (kind, word), (others_kind, others_word) = (
        text.split(" ", 1) if " '" in text else (text, "") for text in (owner, second_owner)
    )
    return word == others_word != f"'{name}'" and not {"dimension", "relation"}.isdisjoint({kind, others_kind})


def _name_fault(section: str, name: str) -> str:
    """Return why nothing in a section may have a name; empty if it may."""
    if keyword.iskeyword(name):
        return f"'{name}' is a word of Python; choose another name, like '{name}_'"
    if not _NAME.fullmatch(name):
        return "a name is a letter, then letters, digits and underscores, 40 at most"
    if section == "coordinates" and name in ("description", "potential", "matrix", "smooth", "over", "t"):
        return f"'{name}' is a key of the model file; choose another name"
    if section in ("extents", "relations") and name in OF_RECORD:
        return f"'{name}' is a dimension of the record, or begins names in it; choose another name"
    if name in RESERVED and section not in (
        "forces",
        "events",
        "contacts",
        "frictions",
        "constraints",
        "joints",
        "regimes",
    ):
        return f"the name '{name}' is a word of the expression language"
    return ""


def _entry_kind(section: str) -> str:
    """Return the word for an entry of a section."""
    return _ENTRY_KINDS.get(section, section.removesuffix("s"))


_ENTRY_KINDS = {"extents": "dimension", "arrays": "parameter", "bodies": "body"}

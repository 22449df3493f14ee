"""From the log of a march to columns: every variable of the record with its name, unit and meaning."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.expressions import text_of
from xdynamics.faults import InputError
from xdynamics.kernels import Layout
from xdynamics.keywords import FULL, STATES
from xdynamics.march import Block, March, Settings
from xdynamics.march.memory import numbers_at_end
from xdynamics.model import Model
from xdynamics.model.parts import Contact, Friction
from xdynamics.model.reactions import DRY, NORMAL, Reaction, reactions
from xdynamics.model.table_keys import near
from xdynamics.record.column import About, Column, row_of, sample_of, trial_of
from xdynamics.record.element_attributes import attributes_of_whole, of_whole, of_wholes
from xdynamics.record.element_names import Names, expanded
from xdynamics.record.event_columns import event_columns
from xdynamics.record.folded_columns import dimensions, folded, folded_constants
from xdynamics.record.switches import passed, side_columns
from xdynamics.schema import SAMPLES, STEPS, Variable
from xdynamics.shapes import Shapes
from xdynamics.units import Scales, Unit

Array = NDArray[Any]

ALWAYS = ("time", "step_size", "flag")  # roles of columns of every log
OF_STATES = ("coordinate", "velocity", "state", "error")


def columns(march: March) -> list[Column]:
    """Return every variable with a dimension, in the order of the record."""
    return folded(element_columns(march), march.model.shapes)


def element_columns(march: March) -> list[Column]:
    """Return the same, where quantities with dimensions have a variable for each of their elements."""
    settings, shapes = march.settings, march.model.shapes
    selected = _columns(About(march.layout, settings.scales, settings.tolerances, settings.samples))
    if settings.log != FULL:
        selected = _logged(selected, settings.log, shapes)
    return selected if march.thinning is None else [*selected, Column(schema.STEP_NUMBER, _numbers)]


def _logged(available: list[Column], log: str | tuple[str, ...], shapes: Shapes) -> list[Column]:
    """Return the columns that a log holds, always including rejected trials, events, times, steps and flags.

    Raises
    ------
    InputError
        If a name is no column of the log.
    """
    by_rows = {
        column.variable.name: column.variable for column in available if column.variable.dims[0] in (STEPS, SAMPLES)
    }
    if not isinstance(log, str):
        log, quantities = expanded(log, by_rows, shapes), of_wholes(by_rows)
        for name in log:
            if name not in by_rows:
                raise InputError(
                    f"log names '{name}', which is no column of this run's log{near(name, quantities)}; there are"
                    f" {', '.join(quantities)}"
                )
    roles = (*ALWAYS, *OF_STATES) if log == STATES else ALWAYS
    return [
        column
        for column in available
        if (name := column.variable.name) not in by_rows
        or name in log
        or (column.variable.role in roles and column.variable.dims == (STEPS,))
    ]


def _logged_elements(march: March) -> tuple[str, ...]:
    """Return the names of a chosen log's variables of states, by their elements."""
    used = march.layout.used
    return expanded(march.settings.log, used, march.model.shapes)


def columns_of(layout: Layout, settings: Settings) -> list[Column]:
    """Return the columns of a march that keeps no force samples."""
    return _columns(About(layout, settings.scales, settings.tolerances, samples=False))


@lru_cache(maxsize=64)
def _columns(about: About) -> list[Column]:
    collected = [*_steps(about), *_trials(about), *event_columns(about), *(_samples(about) if about.samples else [])]
    unit = about.model.time_unit
    return [replace(column, variable=schema.in_time(column.variable, unit)) for column in collected]


def constants(march: March) -> list[tuple[Variable, Any]]:
    """Return every variable not along a march with its value: parameters, given steps, its memory, the model, the source."""
    entries: list[tuple[Variable, Any]] = []
    if isinstance(march.settings.step, tuple):
        entries.append((schema.in_time(schema.GIVEN_STEP, march.model.time_unit), np.array(march.settings.step)))
    for name, one in march.model.parameters.items():
        extra: dict[str, Any] = {}
        if one.spread is not None:
            extra["uncertainty"] = one.uncertainty
        long_name = one.description or f"parameter {name}"
        entries.append(
            (Variable(name, (), "f8", one.quantity.unit.text, long_name, "parameter", extra), one.quantity.value)
        )
    entries = folded_constants(entries, march.model.shapes) + dimensions(march.model)
    entries += passed(march)
    names, numbers = numbers_at_end(march.run)
    if march.settings.partial:  # rows by which a march is judged, and which its record may leave out
        names, numbers = f"{names} {schema.WITNESSES}", np.append(numbers, march.witnesses)
        if march.errors.size:
            names, numbers = f"{names} {schema.ERRORS}", np.append(numbers, march.errors)
    entries.append((replace(schema.END_MEMORY, more={"names": names}), numbers))
    functions = "".join(
        f"\n\n# Python function {one.name}, sha256 {one.digest}\n{one.source}" for one in march.model.python_functions
    )
    texts = {"model_toml": march.model.to_toml(), "force_source": march.law.source + functions}
    return entries + [(variable, texts[variable.name]) for variable in schema.TEXTS]


def factors(model: Model, scales: Scales) -> dict[str, float]:
    """Return the factor from a march's numbers to the record's, for every coordinate, velocity and state."""
    return {name: scales.of(unit.dimension) / float(unit.factor) for name, unit in model.units.items()}


def _steps(about: About) -> list[Column]:
    units, layout, model = about.units, about.layout, about.model
    order = {name: index for index, name in enumerate(layout.row)}
    collected = [Column(one, row_of(order[one.name], units.time)) for one in schema.FIXED_STEPS[:2]]
    collected.append(Column(schema.FIXED_STEPS[2], lambda block: block.log.flags[0, : block.rows]))
    collected.append(_regime(about))

    def add(name: str, long_name: str, role: str, unit: Unit, more: Mapping[str, Any] | None = None) -> None:
        tolerance = _tolerance(about, name, unit) if name in layout.used else {}
        variable = Variable(name, (STEPS,), "f8", unit.text, long_name, role, {**tolerance, **(more or {})})
        collected.append(Column(variable, row_of(order[name], units.factor(unit))))

    for name, coordinate in model.coordinates.items():
        add(name, coordinate.description or f"coordinate {name}", "coordinate", units.known[name])
        add(schema.velocity(name), f"velocity of {name}", "velocity", units.known[schema.velocity(name)])
        add(
            schema.acceleration(name), f"acceleration of {name}", "acceleration", units.known[schema.acceleration(name)]
        )
    for name, state in model.states.items():
        add(name, state.description or f"state {name}", "state", units.known[name])
        add(schema.rate(name), f"rate of {name}", "rate", units.known[schema.rate(name)])
    for term, components in model.force_components.items():
        label = model.forces[term].description or term
        for name in components:
            force = schema.force(term, name)
            add(force, f"component of force {label} along {name}", "force", units.known[force])
    for name in layout.derived:
        role = "energy" if name in schema.ENERGIES else "gap" if name in layout.gaps else "observable"
        noun = "gap of contact" if role == "gap" else "observable"
        owner = name.removeprefix(schema.contact_gap("")) if role == "gap" else name
        description = model.observed[name].description if name in model.observed else ""
        add(name, description or schema.ENERGIES.get(name, f"{noun} {owner}"), role, units.derived(name))
    for k, one in enumerate(reactions(model)):
        add(one.name, _long_name(one), "reaction", units.known[one.name], _declared(model, one))
        collected.append(Column(_state_of(one), _flag(2 + k)))
    collected += side_columns(about)
    if layout.estimates and about.tolerances is not None:
        collected.append(Column(schema.ERROR_NORM, row_of(order["error_norm"], 1.0)))
    for name in layout.used if layout.estimates else ():
        add(
            schema.error(name), f"estimated local error of {name} in the step to this state", "error", units.known[name]
        )
    if layout.effort:
        index = order[layout.effort[0]]
        collected.append(Column(schema.NEWTON, lambda block: block.log.rows[index, : block.rows].astype("i4")))
    return collected


def _regime(about: About) -> Column:
    """Return the regime of every row, with the forces of each."""
    model = about.model
    regime = Variable(
        "regime",
        (STEPS,),
        "i1",
        "1",
        "regime of the force law",
        "flag",
        schema.flags(dict(enumerate(model.regimes)) or {0: schema.ONLY_REGIME}) | _forces_by_regime(model),
    )
    return Column(regime, lambda block: block.log.flags[1, : block.rows])


def _long_name(reaction: Reaction) -> str:
    """Describe a reaction: its positive direction, and where it is 0."""
    if reaction.sort == NORMAL:
        return f"normal force of contact {reaction.owner}, positive where it pushes; 0 where it is open"
    where = "" if reaction.sort == DRY else "; 0 where it is open"
    return f"friction force of {reaction.owner} along positive slip, against which it acts while it slips{where}"


def _declared(model: Model, reaction: Reaction) -> dict[str, str]:
    """Return the model's declarations of a contact or friction element; the force acts along the gradient of its gap, or slip."""
    owner, shaped = of_whole(reaction.owner), model.shaped
    element: Contact | Friction = shaped.frictions[owner] if reaction.sort == DRY else shaped.contacts[owner]
    keys = (
        ("gap", "restitution")
        if reaction.sort == NORMAL
        else ("slip", "kinetic" if reaction.sort == DRY else "friction", "static")
    )
    declared = {key: text_of(getattr(element, key)) for key in keys}
    declared["acts_along"] = (
        "gradient of the gap, in which it is measured"
        if reaction.sort == NORMAL
        else "derivative of the slip by the velocities"
    )
    tolerances = {key: getattr(element, key, None) for key in ("time_tolerance", "position_tolerance", "rest_height")}
    return declared | {key: str(value) for key, value in tolerances.items() if value is not None}


def state_name(one: Reaction) -> str:
    """Return the name of the variable for the state of a contact, or of its friction."""
    return schema.contact_state(one.owner) if one.sort == NORMAL else schema.friction_state(one.owner)


def _state_of(reaction: Reaction) -> Variable:
    """Return the variable for the state of a contact or friction."""
    words: tuple[str, ...] = schema.FRICTION_STATES
    name = state_name(reaction)
    long_name = f"what the friction of {reaction.owner} does; forward is along positive slip"
    if reaction.sort == NORMAL:
        words = schema.CONTACT_STATES
        long_name = f"what contact {reaction.owner} does; bounces are skipped while it is settling"
    elif reaction.sort == DRY:
        words = ("", *words[1:])  # a friction element is never open
    meanings = {i: word for i, word in enumerate(words) if word}
    return Variable(name, (STEPS,), "i1", "1", long_name, "flag", schema.flags(meanings))


def _between(model: Model, name: str) -> dict[str, str]:
    """Return how the value of a drive is found between the points of its table, and beyond them."""
    drive = model.drives.get(name)
    if drive is None:
        return {}
    return {"interpolation": drive.interpolation, "outside": drive.outside, "argument": drive.argument}


def _numbers(block: Block) -> Array:
    """Return the numbers, in the march, of a block's rows."""
    return np.arange(block.rows) if block.numbers is None else block.numbers


def _flag(index: int) -> Callable[[Block], Array]:
    return lambda block: block.log.flags[index, : block.rows]


def _tolerance(about: About, name: str, unit: Unit) -> dict[str, float]:
    """Return the absolute tolerance given for a variable, in its unit and, exactly, in SI."""
    atol = None if about.tolerances is None else about.tolerances.of(name)
    return {} if atol is None else {"atol": atol / float(unit.factor), "atol_si": atol}


def followed_tolerances(march: March) -> dict[str, dict[str, Any]]:
    """Return the final values of the absolute tolerances that follow their variables, by variable."""
    if not march.run.plan[0].follows:
        return {}
    tolerances, model, scales = {}, march.model, march.settings.scales
    for name, follows, atol in zip(
        march.layout.used, march.run.followers.tolist(), march.run.atol.tolist(), strict=True
    ):
        if follows:
            final = atol * scales.of(model.dimensions[name])
            tolerances[name] = {
                "atol": final / float(model.units[name].factor),
                "atol_si": final,
                schema.ATOL_RULE: schema.ATOL_FOLLOWS,
            }
    if not isinstance(march.settings.log, str):
        logged = _logged_elements(march)
        tolerances = {name: entry for name, entry in tolerances.items() if name in logged}
    return _of_quantities(march, tolerances)


def _of_quantities(march: March, followed: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return the final tolerances of quantities with dimensions, beside those that were given for some elements."""
    if not march.model.shapes.dims:
        return followed
    about = About(march.layout, march.settings.scales, march.settings.tolerances, samples=False)
    wholes, final = Names(march.model.shapes).wholes(march.layout.used), dict(followed)
    for whole in wholes.values():
        elements = {}
        for number, name in whole.members.items():
            own = final.pop(name, None) or _tolerance(about, name, about.units.known[name])
            elements[number] = name, own
        if any(schema.ATOL_RULE in own for _, own in elements.values()):
            final[whole.name] = attributes_of_whole(elements, whole.size)
    return final


def left_out_tolerances(march: March) -> dict[str, tuple[float, str]]:
    """Return the absolute tolerances that were given, in SI units, and the units of variables that a log leaves out."""
    tolerances, model = march.settings.tolerances, march.model
    if tolerances is None or isinstance(march.settings.log, str):
        return {}
    log = _logged_elements(march)
    left_out = {name: tolerances.of(name) for name in march.layout.used if name not in log}
    return {name: (atol, model.units[name].text) for name, atol in left_out.items() if atol is not None}


def _forces_by_regime(model: Model) -> dict[str, str]:
    """List the forces that act in each regime."""
    acting = "; ".join(f"{name}: {' '.join(regime.forces)}" for name, regime in model.regimes.items())
    return {"forces": acting} if acting else {}


def _trials(about: About) -> list[Column]:
    time = about.units.time
    takes = (
        trial_of("time", "f8", time),
        trial_of("step", "i8"),
        trial_of("step_size", "f8", time),
        trial_of("error_norm", "f8"),
        trial_of("reason", "i1"),
    )
    return [Column(variable, take) for variable, take in zip(schema.FIXED_TRIALS, takes, strict=True)]


def _samples(about: About) -> list[Column]:
    units, layout = about.units, about.layout
    order = {name: index for index, name in enumerate(layout.sample)}
    time, step, stage = schema.FIXED_SAMPLES
    collected = [
        Column(time, sample_of(0, units.time)),
        Column(step, lambda block: block.log.samples[1, : block.samples].astype("i8")),
        Column(stage, lambda block: block.log.samples[2, : block.samples].astype("i1")),
    ]
    for name in (*layout.used, *layout.forces, *layout.reactions, *layout.drives):
        unit = units.known[name]
        origin = (
            "given by"
            if name in (*layout.forces, *layout.reactions)
            else "looked up in"
            if name in layout.drives
            else "used in"
        )
        variable = Variable(
            schema.sampled(name),
            (SAMPLES,),
            "f8",
            unit.text,
            f"{name} {origin} the force evaluation",
            "sample",
            _between(about.model, name),
        )
        collected.append(Column(variable, sample_of(order[name], units.factor(unit))))
    return collected

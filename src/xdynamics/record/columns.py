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
from xdynamics.model.words import near
from xdynamics.record.column import About, Column, row_of, sample_of, trial_of
from xdynamics.record.event_columns import event_columns
from xdynamics.record.switches import passed, side_columns
from xdynamics.schema import SAMPLES, STEPS, Variable
from xdynamics.units import NUMBERS, SECONDS, Scales, Unit

Array = NDArray[Any]

ALWAYS = ("time", "step_size", "flag")  # roles of columns of every log
OF_STATES = ("coordinate", "velocity", "state", "error")


def columns(march: March) -> list[Column]:
    """Return every variable with a dimension, in the order of the record."""
    settings = march.settings
    found = _columns(About(march.layout, settings.scales, settings.tolerances, settings.samples))
    if settings.log != FULL:
        found = _logged(found, settings.log)
    return found if march.thinning is None else [*found, Column(schema.STEP_NUMBER, _numbers)]


def _logged(found: list[Column], log: str | tuple[str, ...]) -> list[Column]:
    """Return the columns that a log holds: rejected trials, events, times, steps and flags in any case.

    Raises
    ------
    InputError
        If one is none of the record's.
    """
    by_rows = {one.variable.name: one.variable for one in found if one.variable.dims[0] in (STEPS, SAMPLES)}
    if log != STATES:
        for name in log:
            if name not in by_rows:
                raise InputError(f"log names '{name}', which is no column of this run's log{near(name, tuple(by_rows))}; there are {', '.join(by_rows)}")  # fmt: skip
    roles = (*ALWAYS, *OF_STATES) if log == STATES else ALWAYS
    return [
        one
        for one in found
        if (name := one.variable.name) not in by_rows or name in log or (one.variable.role in roles and one.variable.dims == (STEPS,))
    ]  # fmt: skip


def columns_of(layout: Layout, settings: Settings) -> list[Column]:
    """Return the same of marches that keep no force samples."""
    return _columns(About(layout, settings.scales, settings.tolerances, samples=False))


@lru_cache(maxsize=64)
def _columns(about: About) -> list[Column]:
    found = [*_steps(about), *_trials(about), *event_columns(about), *(_samples(about) if about.samples else [])]
    return found if about.model.time_unit == SECONDS else [_without_time(one) for one in found]


def _without_time(one: Column) -> Column:
    """Give a time the unit that it has where it is a pure number."""
    about = one.variable
    if about.units != SECONDS.text:
        return one
    return replace(one, variable=replace(about, units=NUMBERS.text))


def constants(march: March) -> list[tuple[Variable, Any]]:
    """Return every variable not along a march with its value: parameters, given steps, its memory, the model, the source."""
    found: list[tuple[Variable, Any]] = []
    if isinstance(march.settings.step, tuple):
        found.append((schema.GIVEN_STEP, np.array(march.settings.step)))
    for name, one in march.model.parameters.items():
        more: dict[str, Any] = {}
        if one.spread is not None:
            more["uncertainty"] = one.uncertainty
        long_name = one.description or f"parameter {name}"
        found.append(
            (Variable(name, (), "f8", one.quantity.unit.text, long_name, "parameter", more), one.quantity.value)
        )
    found += passed(march)
    names, numbers = numbers_at_end(march.run)
    if march.settings.partial:  # rows that a march is judged by, and that its record may have left out
        names, numbers = f"{names} {schema.WITNESSES}", np.append(numbers, march.witnesses)
        if march.errors.size:
            names, numbers = f"{names} {schema.ERRORS}", np.append(numbers, march.errors)
    found.append((replace(schema.END_MEMORY, more={"names": names}), numbers))
    functions = "".join(
        f"\n\n# Python function {one.name}, sha256 {one.digest}\n{one.source}" for one in march.model.python_functions
    )
    texts = {"model_toml": march.model.to_toml(), "force_source": march.law.source + functions}
    return found + [(variable, texts[variable.name]) for variable in schema.TEXTS]


def factors(model: Model, scales: Scales) -> dict[str, float]:
    """Return the factor from a march's numbers to the record's, for every coordinate, velocity and state."""
    return {name: scales.of(unit.dimension) / float(unit.factor) for name, unit in model.units.items()}


def _steps(about: About) -> list[Column]:
    units, layout, model = about.units, about.layout, about.model
    order = {name: index for index, name in enumerate(layout.row)}
    found = [Column(one, row_of(order[one.name], units.time)) for one in schema.FIXED_STEPS[:2]]
    found.append(Column(schema.FIXED_STEPS[2], lambda block: block.log.flags[0, : block.rows]))
    regime = Variable(
        "regime",
        (STEPS,),
        "i1",
        "1",
        "regime of the force law",
        "flag",
        schema.flags(dict(enumerate(model.regimes)) or {0: schema.ONLY_REGIME}) | _forces_by_regime(model),
    )
    found.append(Column(regime, lambda block: block.log.flags[1, : block.rows]))

    def add(name: str, long_name: str, role: str, unit: Unit, more: Mapping[str, Any] | None = None) -> None:
        tolerance = _tolerance(about, name, unit) if name in layout.used else {}
        variable = Variable(name, (STEPS,), "f8", unit.text, long_name, role, {**tolerance, **(more or {})})
        found.append(Column(variable, row_of(order[name], units.factor(unit))))

    for name, coordinate in model.coordinates.items():
        add(name, coordinate.description or f"coordinate {name}", "coordinate", units.known[name])
        add(schema.velocity(name), f"velocity of {name}", "velocity", units.known[schema.velocity(name)])
        add(
            schema.acceleration(name), f"acceleration of {name}", "acceleration", units.known[schema.acceleration(name)]
        )
    for name, state in model.states.items():
        add(name, state.description or f"state {name}", "state", units.known[name])
        add(schema.rate(name), f"rate of {name}", "rate", units.known[schema.rate(name)])
    for term, parts in model.force_components.items():
        words = model.forces[term].description or term
        for name in parts:
            force = schema.force(term, name)
            add(force, f"component of force {words} along {name}", "force", units.known[force])
    for name in layout.derived:
        role = "energy" if name in schema.ENERGIES else "gap" if name in layout.gaps else "observable"
        said = "gap of contact" if role == "gap" else "observable"
        owner = name.removeprefix(schema.contact_gap("")) if role == "gap" else name
        told = model.observed[name].description if name in model.observed else ""
        add(name, told or schema.ENERGIES.get(name, f"{said} {owner}"), role, units.derived(name))
    for k, one in enumerate(reactions(model)):
        add(one.name, _said_of(one), "reaction", units.known[one.name], _declared(model, one))
        found.append(Column(_state_of(one), _flag(2 + k)))
    found += side_columns(about)
    if layout.estimates and about.tolerances is not None:
        found.append(Column(schema.ERROR_NORM, row_of(order["error_norm"], 1.0)))
    for name in layout.used if layout.estimates else ():
        add(
            schema.error(name), f"estimated local error of {name} in the step to this state", "error", units.known[name]
        )
    if layout.implicit:
        index = order["newton_iterations"]
        found.append(Column(schema.NEWTON, lambda block: block.log.rows[index, : block.rows].astype("i4")))
    return found


def _said_of(one: Reaction) -> str:
    """Say what a reaction is, which way it is positive, and where it is 0."""
    if one.sort == NORMAL:
        return f"normal force of contact {one.owner}, positive where it pushes; 0 where it is open"
    where = "" if one.sort == DRY else "; 0 where it is open"
    return f"friction force of {one.owner} along positive slip, against which it acts while it slips{where}"


def _declared(model: Model, one: Reaction) -> dict[str, str]:
    """Say what the model says of a contact or friction element; the force acts along the gradient of its gap, or slip."""
    part: Contact | Friction = model.frictions[one.owner] if one.sort == DRY else model.contacts[one.owner]
    keys = (
        ("gap", "restitution")
        if one.sort == NORMAL
        else ("slip", "kinetic" if one.sort == DRY else "friction", "static")
    )
    found = {key: text_of(getattr(part, key)) for key in keys}
    found["acts_along"] = (
        "gradient of the gap, in which it is measured"
        if one.sort == NORMAL
        else "derivative of the slip by the velocities"
    )
    said = {key: getattr(part, key, None) for key in ("time_tolerance", "position_tolerance", "rest_height")}
    return found | {key: str(value) for key, value in said.items() if value is not None}


def state_name(one: Reaction) -> str:
    """Return the name of the variable that says what a contact, or its friction, does."""
    return schema.contact_state(one.owner) if one.sort == NORMAL else schema.friction_state(one.owner)


def _state_of(one: Reaction) -> Variable:
    """Return the variable that says what a contact or friction does."""
    words: tuple[str, ...] = schema.FRICTION_STATES
    name = state_name(one)
    said = f"what the friction of {one.owner} does; forward is along positive slip"
    if one.sort == NORMAL:
        words = schema.CONTACT_STATES
        said = f"what contact {one.owner} does; bounces are skipped while it is settling"
    elif one.sort == DRY:
        words = ("", *words[1:])  # a friction element is never open
    meanings = {i: word for i, word in enumerate(words) if word}
    return Variable(name, (STEPS,), "i1", "1", said, "flag", schema.flags(meanings))


def _between(model: Model, name: str) -> dict[str, str]:
    """Say of a drive by which rule its value is found between those of its table, and beyond them."""
    drive = model.drives.get(name)
    if drive is None:
        return {}
    return {"interpolation": drive.interpolation, "outside": drive.outside, "argument": drive.argument}


def _numbers(block: Block) -> Array:
    """Say which rows of the march those of a block are."""
    return np.arange(block.rows) if block.numbers is None else block.numbers


def _flag(index: int) -> Callable[[Block], Array]:
    return lambda block: block.log.flags[index, : block.rows]


def _tolerance(about: About, name: str, unit: Unit) -> dict[str, float]:
    """Say the absolute tolerance that a variable was given, in its unit and, exactly, in SI."""
    given = None if about.tolerances is None else about.tolerances.of(name)
    return {} if given is None else {"atol": given / float(unit.factor), "atol_si": given}


def followed_tolerances(march: March) -> dict[str, dict[str, Any]]:
    """Return what is known of the absolute tolerances that follow their variables once a march is over, by variable."""
    if not march.run.plan[0].follows:
        return {}
    found, model, scales = {}, march.model, march.settings.scales
    for name, follows, atol in zip(
        march.layout.used, march.run.followers.tolist(), march.run.atol.tolist(), strict=True
    ):
        if follows:
            used = atol * scales.of(model.dimensions[name])
            found[name] = {
                "atol": used / float(model.units[name].factor),
                "atol_si": used,
                schema.ATOL_RULE: schema.ATOL_FOLLOWS,
            }
    log = march.settings.log
    return found if isinstance(log, str) else {name: one for name, one in found.items() if name in log}


def left_out_tolerances(march: March) -> dict[str, tuple[float, str]]:
    """Return the absolute tolerances that were given, in SI units, and the units of variables that a log leaves out."""
    tolerances, log, model = march.settings.tolerances, march.settings.log, march.model
    if tolerances is None or isinstance(log, str):
        return {}
    given = {name: tolerances.of(name) for name in march.layout.used if name not in log}
    return {name: (atol, model.units[name].text) for name, atol in given.items() if atol is not None}


def _forces_by_regime(model: Model) -> dict[str, str]:
    """Say of every regime which forces act in it."""
    acting = "; ".join(f"{name}: {' '.join(one.forces)}" for name, one in model.regimes.items())
    return {"forces": acting} if acting else {}


def _trials(about: About) -> list[Column]:
    time = about.units.time
    takes = (
        trial_of("time", "f8", time), trial_of("step", "i8"), trial_of("step_size", "f8", time), trial_of("error_norm", "f8"),
        trial_of("reason", "i1"),
    )  # fmt: skip
    return [Column(variable, take) for variable, take in zip(schema.FIXED_TRIALS, takes, strict=True)]


def _samples(about: About) -> list[Column]:
    units, layout = about.units, about.layout
    order = {name: index for index, name in enumerate(layout.sample)}
    time, step, stage = schema.FIXED_SAMPLES
    found = [
        Column(time, sample_of(0, units.time)),
        Column(step, lambda block: block.log.samples[1, : block.samples].astype("i8")),
        Column(stage, lambda block: block.log.samples[2, : block.samples].astype("i1")),
    ]
    for name in (*layout.used, *layout.forces, *layout.reactions, *layout.drives):
        unit = units.known[name]
        what = (
            "given by"
            if name in (*layout.forces, *layout.reactions)
            else "looked up in"
            if name in layout.drives
            else "used in"
        )
        variable = Variable(
            schema.sampled(name), (SAMPLES,), "f8", unit.text, f"{name} {what} the force evaluation", "sample",
            _between(about.model, name),
        )  # fmt: skip
        found.append(Column(variable, sample_of(order[name], units.factor(unit))))
    return found

"""From the log of a march to columns: every variable of the record with its name, unit and meaning."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import reaction_names, schema
from xdynamics.expressions import text_of
from xdynamics.kernels import Layout
from xdynamics.keywords import FULL, STATES
from xdynamics.march import LogBlock, March, Settings
from xdynamics.model import Model
from xdynamics.model.assemblies import assemblies
from xdynamics.model.motion import kinetic_as_written
from xdynamics.model.parts import Contact, Friction
from xdynamics.model.reactions import DRY, NORMAL, Reaction, reactions
from xdynamics.model.sliding import surfaces
from xdynamics.record.column import (
    Column,
    ColumnContext,
    effort_columns,
    of_constraints,
    of_first_order,
    rest_column,
    row_column,
    shapes_with_switches,
    share_column,
    side_columns,
    smooth_switch_passes,
    take_row,
    take_row_numbers,
    take_sample,
    take_trial_field,
)
from xdynamics.record.event_columns import event_columns
from xdynamics.record.folded_columns import (
    NamedColumns,
    check_logged,
    dimension_variables,
    is_by_rows,
    logged_column,
    logged_numbers,
    march_shapes,
    parameter_variables,
    shapes_of_log,
    split_columns,
    stacked_columns,
)
from xdynamics.record.folding import quantity_names, quantity_of
from xdynamics.record.link_columns import any_rubs, link_names, written_link_columns
from xdynamics.schema import SAMPLES, STEPS, Variable
from xdynamics.shapes import Shapes
from xdynamics.shapes.blocks import Block as Quantity
from xdynamics.shapes.blocks import Blocks
from xdynamics.shapes.naming import DOT
from xdynamics.units import Scales, Unit

Array = NDArray[Any]

ALWAYS = ("time", "step_size", "flag", "index")  # roles of columns of every log
OF_STATES = (*schema.OF_MOTION, "error")


def columns(march: March) -> list[Column]:
    """Return every variable with a dimension, in the order of the record."""
    settings, model = march.settings, march.layout.model
    about = ColumnContext.for_settings(march.layout, settings, samples=settings.samples)
    available = [*_all_columns(about), *written_link_columns(about)]
    if settings.log == FULL:
        return available
    rubbing = link_names(model) if any_rubs(assemblies(model)) else []
    return _logged(available, settings.log, shapes_with_switches(model), rubbing)


def _logged(available: list[Column], log: str | tuple[str, ...], shapes: Shapes, links: Sequence[str]) -> list[Column]:
    """Return the columns that a log holds, always including rejected trials, events, times, steps, flags, and some of links.

    Raises
    ------
    InputError
        If a name is no column of the log.
    """
    roles = (*ALWAYS, *OF_STATES, schema.LEFT_OVER) if log == STATES else ALWAYS
    if not isinstance(log, str):
        check_logged(log, available, shapes)
        log = (
            *log,
            schema.REST_TIME.name,
            *map(schema.rest_name, log),
        )  # a number goes with its rest, a link with its time
        log = (*log, *(schema.CLOSED_TIME for name in log if name.startswith(schema.at_closed(""))))
        logged = shapes_of_log(log, shapes)
        available = [logged_column(column, log, shapes, logged) for column in available]
        log = (*log, *logged.dims)
    return [
        column
        for column in available
        if not is_by_rows(column)
        or column.variable.name in log
        or column.variable.name in links
        or (column.variable.name == schema.CLOSED_TIME and links)
        or (column.variable.role in roles and column.variable.dims[0] == STEPS)
    ]


def _is_logged(march: March, quantity: Quantity) -> NDArray[np.bool_]:
    """Return which elements of a quantity a log holds."""
    log, shape = march.settings.log, quantity.size
    if isinstance(log, str) or {quantity.name, quantity_of(quantity.name)} & {*log}:
        return np.ones(shape, bool)
    if not any(DOT in name for name in log):
        return np.zeros(shape, bool)
    return np.array([name in log for name in quantity.elements()])


def unsampled_columns(layout: Layout, settings: Settings) -> list[Column]:
    """Return the columns of a march that keeps no force samples, one for each element."""
    return split_columns(_all_columns(ColumnContext.for_settings(layout, settings)), layout.model.shapes)


def named_columns(layout: Layout, settings: Settings) -> NamedColumns:
    """Return all columns of a layout and settings by name, of quantities and of elements."""
    about = ColumnContext.for_settings(layout, settings)
    return NamedColumns(_all_columns(about), layout.model.shapes)


@lru_cache(maxsize=64)
def _all_columns(about: ColumnContext) -> list[Column]:
    collected = [
        *_step_columns(about),
        *_trial_columns(about),
        *event_columns(about),
        *(_sample_columns(about) if about.samples else []),
    ]
    unit = about.model.time_unit
    return [replace(column, variable=schema.with_time_unit(column.variable, unit)) for column in collected]


def constants(march: March) -> list[tuple[Variable, Any]]:
    """Return every variable not along a march with its value: parameters, given steps, its memory, the model, the source."""
    entries: list[tuple[Variable, Any]] = []
    if isinstance(march.settings.step, tuple):
        entries.append((schema.with_time_unit(schema.GIVEN_STEP, march.model.time_unit), np.array(march.settings.step)))
    entries += parameter_variables(march.model)
    entries += [entry for shapes in march_shapes(march) for entry in dimension_variables(shapes)]
    entries += smooth_switch_passes(march)
    names, numbers = march.numbers_at_end()
    entries.append((replace(schema.END_MEMORY, more={"names": names}), numbers))
    functions = "".join(
        f"\n\n# Python function {function.name}, sha256 {function.digest}\n{function.source}"
        for function in march.model.python_functions
    )
    texts = {"model_toml": march.model.to_toml(), "force_source": march.law.source + functions}
    text_entries = [(variable, np.array([texts[variable.name]])) for variable in schema.TEXTS]
    if any(schema.DOCUMENT in (variable.name, *variable.dims) for variable, _ in entries):  # of a model of schema 1
        text_entries = [(replace(variable, dims=()), text[0]) for variable, text in text_entries]
    return entries + text_entries


def factors(layout: Layout, scales: Scales) -> Array:
    """Return the factor from a march's numbers to the record's, for every coordinate, velocity and state."""
    blocks = layout.used.blocks
    units = [layout.model.elements.units[block.first] for block in blocks]
    return np.repeat(
        [scales.si_factor(unit.dimension) / float(unit.factor) for unit in units], [block.size for block in blocks]
    )


def _step_columns(about: ColumnContext) -> list[Column]:
    units, layout, model = about.units, about.layout, about.model
    steps = [_shown_time(model), schema.FIXED_STEPS[1]]
    collected = [Column(step, take_row(layout.row.offset_of(step.name), units.time)) for step in steps]
    collected.append(Column(schema.FIXED_STEPS[2], lambda block: block.log.flags[0, : block.rows]))
    collected.append(Column(schema.STEP_NUMBER, LogBlock.of_rows))
    collected.append(_regime_column(about))

    def add_column(quantity: Quantity, long_name: str, unit: Unit, more: Mapping[str, Any] | None = None) -> None:
        if quantity.role in OF_STATES[:-1]:
            more = _tolerance_attributes(about, quantity, unit)
        collected.append(row_column(about, quantity, unit, long_name, quantity.role, more or {}))

    owners = zip(layout.coordinates.blocks, layout.velocities.blocks, layout.accelerations.blocks, strict=True)
    for entry, velocity, acceleration in owners:
        name = entry.name
        add_column(entry, model.statement.coordinates[name].description or f"coordinate {name}", units.known[name])
        add_column(velocity, f"velocity of {name}", units.known[velocity.name])
        add_column(acceleration, f"acceleration of {name}", units.known[acceleration.name])
    for entry, long_name in of_first_order(about):
        add_column(entry, long_name, units.known[entry.name])
    term_components = [(term, block.name) for term, parts in layout.terms.items() for block in parts.blocks]
    for (term, name), force in zip(term_components, layout.forces.blocks, strict=True):
        label = model.elements.forces[term].description or term
        add_column(force, f"component of force {label} along {name}", units.known[force.name])
    for entry, long_name in _computed_quantities(about):
        add_column(entry, long_name, units.derived(entry))
    for entry in layout.reactions.blocks:
        first = layout.reactions.offset_of(entry.name)
        reaction = reactions(model)[first]
        add_column(entry, _long_name(about, reaction), units.known[entry.name], _declared_attributes(model, reaction))
        collected.append(Column(_state_of(about, reaction, entry.dims), _flag_taker(2 + first, entry.shape)))
    collected += [share_column(about, surface) for surface in surfaces(model)]
    collected += [*of_constraints(about), *stacked_columns(side_columns(about), shapes_with_switches(model))]
    if layout.estimates and about.tolerances is not None:
        collected.append(Column(schema.ERROR_NORM, take_row(layout.row.offset_of("error_norm"), 1.0)))
    # the first block of errors is their norm; without an estimate there is none to pair
    for entry, error in zip(layout.used.blocks, layout.errors.blocks[1:], strict=bool(layout.errors)):
        add_column(error, f"estimated local error of {entry.name} in the step to this state", units.known[entry.name])
    if layout.low_parts:
        collected.append(Column(schema.REST_TIME, take_row(layout.row.offset_of(schema.REST_TIME.name), units.time)))
        rests = zip(layout.used.blocks, layout.low_parts.blocks[1:], strict=True)
        collected += [rest_column(about, entry, rest_block) for entry, rest_block in rests]
    return collected + effort_columns(layout)


def _shown_time(model: Model) -> Variable:
    """Return the variable of times, with the unit that people read them in, if the model says one."""
    time, shown = schema.FIXED_STEPS[0], model.statement.shown_time
    return time if shown is None else replace(time, more={**time.more, schema.SHOWN_IN: shown.text})


def _computed_quantities(about: ColumnContext) -> Iterator[tuple[Quantity, str]]:
    """Yield energies, observables and gaps with their roles and long names."""
    layout, model = about.layout, about.model
    others = {*layout.rate_terms, *layout.constraint_outputs, *layout.shares}
    for entry in (block for block in layout.computed.blocks if block.first not in others):
        name = entry.name
        role = "energy" if name in schema.ENERGIES else "gap" if entry.first in layout.gaps else "observable"
        noun = "gap of contact" if role == "gap" else "observable"
        owner = name.removeprefix(reaction_names.contact_gap("")) if role == "gap" else name
        observed = model.statement.observed.get(name)
        description = observed.description if observed else _energy_text(model, name)
        yield entry._replace(role=role), description or f"{noun} {owner}"


def _energy_text(model: Model, name: str) -> str | None:
    """Describe an energy; None of another name."""
    if name == "kinetic_energy" and kinetic_as_written(model) is not None:
        return "kinetic energy as it was written, with what is linear in velocities and free of them"
    return schema.ENERGIES.get(name)


def _regime_column(about: ColumnContext) -> Column:
    """Return the regime of every row, with the forces of each."""
    model = about.model
    words = dict(enumerate(model.regimes)) or {0: schema.ONLY_REGIME}
    words |= {surface.number: f"slides_{surface.name}" for surface in surfaces(model) if surface.regimes}
    regime = Variable(
        "regime",
        (STEPS,),
        "i1",
        "1",
        "regime of the force law",
        "flag",
        schema.flag_attributes(words) | _forces_by_regime(model),
    )
    return Column(regime, lambda block: block.log.flags[1, : block.rows])


def _long_name(about: ColumnContext, reaction: Reaction) -> str:
    """Describe a reaction: its positive direction, when it acts, and where it is 0."""
    owner, when = quantity_of(reaction.owner), about.when_forces_act
    if reaction.sort == NORMAL:
        return f"normal force of contact {owner}{when}, positive where it pushes; 0 where it is open"
    where = "" if reaction.sort == DRY else "; 0 where it is open"
    return f"friction force of {owner} along positive slip{when}, against which it acts while it slips{where}"


def _declared_attributes(model: Model, reaction: Reaction) -> dict[str, str]:
    """Return the model's declarations of a contact or friction element; the force acts along the gradient of its gap, or slip."""
    owner, shaped = quantity_of(reaction.owner), model.statement
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


def state_name(reaction: Reaction) -> str:
    """Return the name of the variable for the state of a contact, or of its friction."""
    return (
        reaction_names.contact_state(reaction.owner)
        if reaction.sort == NORMAL
        else reaction_names.friction_state(reaction.owner)
    )


def state_names(model: Model, *, by_element: bool = False) -> tuple[str, ...]:
    """Return the names of the variables for states of contacts and friction, by quantities or by their elements."""
    names = map(state_name, reactions(model))
    return tuple(names) if by_element else quantity_names(names)


def _state_of(about: ColumnContext, reaction: Reaction, dims: tuple[str, ...]) -> Variable:
    """Return the variable for the state of a contact or friction."""
    words: tuple[str, ...] = schema.FRICTION_STATES
    name, owner = quantity_of(state_name(reaction)), quantity_of(reaction.owner)
    does = "does" if about.located else "did over the step before the row"
    long_name = f"what the friction of {owner} {does}; forward is along positive slip"
    if reaction.sort == NORMAL:
        words = schema.CONTACT_STATES
        skipped = "; bounces are skipped while it is settling" if about.located else ""
        long_name = f"what contact {owner} {does}{skipped}"
    elif reaction.sort == DRY:
        words = ("", *words[1:])  # a friction element is never open
    meanings = {i: word for i, word in enumerate(words) if word}
    return Variable(name, (STEPS, *dims), "i1", "1", long_name, "flag", schema.flag_attributes(meanings))


def _drive_attributes(model: Model, name: str) -> dict[str, str]:
    """Return how a drive is interpolated between the points of its table, and extrapolated beyond them."""
    drive = model.statement.drives.get(name)
    if drive is None:
        return {}
    return {"interpolation": drive.interpolation, "outside": drive.outside, "argument": text_of(drive.argument)}


def _flag_taker(first: int, shape: tuple[int, ...]) -> Callable[[LogBlock], Array]:
    return lambda block: block.log.flags[first : first + math.prod(shape), : block.rows].T.reshape(-1, *shape)


def _tolerance_attributes(about: ColumnContext, quantity: Quantity, unit: Unit) -> dict[str, Any]:
    """Return the absolute tolerances given for a quantity, in its unit and, exactly, in SI."""
    if about.tolerances is None:
        return {}
    atols = about.tolerances.of_all(Blocks([quantity]))
    return {} if np.isnan(atols).all() else _atol(atols / float(unit.factor), atols)


def _atol(atols: Array, in_si: Array) -> dict[str, Any]:
    """Return absolute tolerances as attributes: one number where all elements have it."""
    of_elements = {"atol": atols, "atol_si": in_si}
    if len(atols) == 1:
        return {key: float(values[0]) for key, values in of_elements.items()}
    return {key: float(values[0]) if (values == values[0]).all() else values for key, values in of_elements.items()}


def followed_tolerances(march: March) -> dict[str, dict[str, Any]]:
    """Return the final values of the absolute tolerances that follow their variables, beside those given, by quantity."""
    tolerances, layout = march.settings.tolerances, march.layout
    if tolerances is None or not march.run.plan[0].follows:
        return {}
    final, following = dict[str, dict[str, Any]](), march.run.adaptive_atol != 0
    given_atols = tolerances.of_all(layout.used)
    last = np.where(following, march.run.atol * layout.sizes(march.settings.scales), given_atols)
    for quantity in layout.used.blocks:
        first_index = layout.used.offset_of(quantity.name)
        logged = logged_numbers(quantity.name, quantity.size, march)
        indices = first_index + logged
        follows = following[indices] & _is_logged(march, quantity)[logged]
        if follows.any():
            in_si = last[indices] if follows.all() else np.where(follows, last[indices], given_atols[indices])
            final[quantity.name] = _atol(in_si / float(march.model.elements.units[quantity.first].factor), in_si)
            if follows.all():
                final[quantity.name][schema.ATOL_RULE] = schema.ATOL_FOLLOWS
            else:
                final[quantity.name][schema.ATOL_FOLLOWING] = follows.astype(np.int8)
    return final


def left_out_tolerances(march: March) -> dict[str, tuple[float, str]]:
    """Return the absolute tolerances that were given, in SI units, and the units of variables that a log leaves out."""
    tolerances, model = march.settings.tolerances, march.model
    if tolerances is None or isinstance(march.settings.log, str):
        return {}
    left_out: dict[str, tuple[float, str]] = {}
    for quantity in march.layout.used.blocks:
        atols = np.where(_is_logged(march, quantity), np.nan, tolerances.of_all(Blocks([quantity])))
        for number in np.flatnonzero(~np.isnan(atols)).tolist():
            left_out[quantity.element(number)] = float(atols[number]), model.elements.units[quantity.first].text
    return left_out


def _forces_by_regime(model: Model) -> dict[str, str]:
    """List the forces that act in each regime."""
    acting = "; ".join(f"{name}: {' '.join((*regime.forces, *regime.terms))}" for name, regime in model.regimes.items())
    return {"forces": acting} if acting else {}


def _trial_columns(about: ColumnContext) -> list[Column]:
    time = about.units.time
    takes = (
        take_trial_field("time", "f8", time),
        take_row_numbers("trials", "step"),
        take_trial_field("step_size", "f8", time),
        take_trial_field("error_norm", "f8"),
        take_trial_field("reason", "i1"),
    )
    return [Column(variable, take) for variable, take in zip(schema.FIXED_TRIALS, takes, strict=True)]


def _sample_columns(about: ColumnContext) -> list[Column]:
    units, layout = about.units, about.layout
    time, step, stage = schema.FIXED_SAMPLES
    collected = [
        Column(time, take_sample(0, units.time)),
        Column(step, lambda block: block.numbered(block.log.samples[1, : block.samples])),
        Column(stage, lambda block: block.log.samples[2, : block.samples].astype("i1")),
    ]
    origins = {"force": "given by", "multiplier": "given by", "reaction": "given by", "drive": "looked up in"}
    for sampled_block in (layout.used + layout.applied_forces + layout.drives).blocks:
        name, unit = sampled_block.name, units.known[sampled_block.name]
        long_name = f"{name} {origins.get(sampled_block.role, 'used in')} the force evaluation"
        more = _drive_attributes(about.model, name)
        variable = Variable(
            schema.sample_name(name), (SAMPLES, *sampled_block.dims), "f8", unit.text, long_name, "sample", more
        )
        collected.append(
            Column(variable, take_sample(layout.sample.offset_of(name), units.factor(unit), sampled_block.shape))
        )
    return collected

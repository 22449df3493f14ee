"""A model in lines of text: its equations, initial values, time scales, and the methods that integrate it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby

from xdynamics.evidence.modes import modes
from xdynamics.expressions import Node
from xdynamics.expressions.simplification import printed_simply
from xdynamics.faults import InputError, spoken
from xdynamics.methods import METHODS
from xdynamics.model import Model
from xdynamics.model.bodies import scalar_part, vector_part
from xdynamics.model.body_reading import made_by
from xdynamics.model.constraint_consistency import implied_at_start
from xdynamics.model.constraints import conditions
from xdynamics.model.controllers import held, limited
from xdynamics.model.joint_sections import HINGE, SLIDER
from xdynamics.model.joints import made_by_joints, tables_of_joint
from xdynamics.model.parts import Function
from xdynamics.model.switches import (
    MANY_POINTS,
    are_too_many,
    count_of_switches,
    landed_on_by_default,
    owners_of_switches,
    switches,
)
from xdynamics.reaction_names import constraint_force
from xdynamics.schema import acceleration
from xdynamics.shapes.naming import DOT, parted
from xdynamics.units import unit_suffix

COUNTED = (
    "coordinates",
    "states",
    "parameters",
    "forces",
    "drives",
    "events",
    "contacts",
    "frictions",
    "constraints",
    "controllers",
    "regimes",
    "observables",
)

MOST_ELEMENTS = 6  # of one quantity, of which each is told
_LABELS = re.compile(rf"{DOT}\w+")


def lines_of(model: Model) -> Iterator[str]:
    """Summarise a checked model: its parts, motion, events, start and time scales; elements as people write them."""
    return map(spoken, _lines(model))


def _lines(model: Model) -> Iterator[str]:
    yield from at_rest(model.shaped.at_rest)
    counts = [(len(getattr(model, kind)), kind) for kind in COUNTED]
    counted = ", ".join(f"{n} {kind if n > 1 else kind.removesuffix('s')}" for n, kind in counts if n)
    yield f"{model.name}: {counted}; every name is known and every unit fits"
    yield from _first_elements((*_motion(model), *_occasions(model)))
    starts = ", ".join(_first_elements(f"{name} = {quantity}" for name, quantity in model.initial.items()))
    moved = "; moved from there to where constraints hold" if model.consistent else ""
    yield f"start     {starts}{f', regime {model.regime}' if model.regime else ''}{moved}"
    yield from _scales(model)


def _first_elements(lines: Iterable[str]) -> Iterator[str]:
    """Yield what is said of the first elements of each quantity, and how many others there are."""
    for _, group in groupby(lines, lambda line: _LABELS.sub("", line.split(" = ")[0])):
        said = [*group]
        rest = len(said) - MOST_ELEMENTS
        yield from said if rest <= 1 else (*said[:MOST_ELEMENTS], f"… and {rest} more elements")


def at_rest(velocities: Sequence[str]) -> Iterator[str]:
    """Report the velocities that were not given."""
    if velocities:
        yield f"at rest   {', '.join(velocities)}: [initial] gives none, so that they are 0 at the start"


def equations(model: Model) -> Iterator[str]:
    """Print the motion, forces, definitions, rates, events, contacts and frictions of a model, each in a line."""
    yield from map(spoken, (*_motion(model), *_occasions(model)))


def _joined(model: Model) -> dict[str, str]:
    """Return the joint of each constraint that joints stand for."""
    return {key: name for name, joint in model.joints.items() for key in tables_of_joint(name, joint)["constraints"]}


def _motion(model: Model) -> Iterator[str]:
    joined, bodies = _joined(model), model.shaped.bodies
    for i, name in enumerate(model.coordinates):
        inertia = [
            f"{_factor(model.statement.mass_entries[i, j])}*{acceleration(other)}"
            for j, other in enumerate(model.coordinates)
            if (i, j) in model.statement.mass_entries
        ]
        acting = [term for term, components in model.force_components.items() if name in components]
        keeping = [condition for condition in conditions(model) if name in condition.row]
        acting += [
            f"({printed_simply(condition.row[name])})*{constraint_force(condition.name)}"
            for condition in keeping
            if parted(condition.name)[0] not in joined
        ]
        acting += dict.fromkeys(f"joint {joined[key]}" for part in keeping if (key := parted(part.name)[0]) in joined)
        yield f"motion    {' + '.join(inertia)} = {' + '.join(acting) or '0'}"
    for term, components in model.force_components.items():
        for name, component in components.items():
            body = (
                f"{component.name}({', '.join(component.arguments)})"
                if isinstance(component, Function)
                else printed_simply(component)
            )
            yield f"force     {term} of {name} = {body}"
    for name, solid in bodies.items():
        points = ", ".join(f"{name}_{point}" for point in solid.points)
        named = f"; points {points}" if points else ""
        yield f"body      {name}: turns, with the attitude {scalar_part(name)}, {vector_part(name)}{named}"
    made = made_by(bodies, "definitions") | made_by(bodies, "states") | made_by_joints(model.joints, "definitions")
    for name, definition in model.definitions.items():
        if parted(name)[0] not in made:
            yield f"with      {name} = {printed_simply(definition)}"
    kept = held(model.controllers, model.time_unit)
    for name, state in model.states.items():
        if name not in kept and parted(name)[0] not in made:
            yield f"rate      of {name} = {printed_simply(state.rate)}"
    for name, controller in model.controllers.items():
        waits = [f"{word} {time}" for word, time in (("phase", controller.phase), ("delay", controller.delay)) if time]
        values = [f"{output} = {printed_simply(limited(part))}" for output, part in controller.outputs.items()]
        values += [f"{state} = {printed_simply(part.next)}" for state, part in controller.states.items()]
        yield f"controller {name}: every {controller.every}{''.join(f', {word}' for word in waits)}: {', '.join(values)}"


def _factor(node: Node) -> str:
    text = printed_simply(node)
    return f"({text})" if " + " in text or " - " in text else text


def _occasions(model: Model) -> Iterator[str]:
    for name, event in model.events.items():
        body = event.function.name if isinstance(event.function, Function) else printed_simply(event.function)
        when = f"{body} = 0, {event.direction}" if event.every is None else f"every {event.every}"
        yield f"event     {name}: {when}: {event.action}{f' to {event.to}' if event.to else ''}"
    for name, contact in (model.contacts | {name: model.shaped.contacts[name] for name in model.assemblies}).items():
        yield (
            f"contact   {name}: {printed_simply(contact.gap)} >= 0, restitution {printed_simply(contact.restitution)},"
            f" {contact.tangential}"
        )
    yield from _conditions(model)
    for name, friction in model.frictions.items():
        yield (
            f"friction  {name}: at most {printed_simply(friction.static)} against {printed_simply(friction.slip)},"
            f" {printed_simply(friction.kinetic)} while it slips"
        )
    if are_too_many(model):
        owners = ", ".join(owners_of_switches(model))
        yield f"switches  {count_of_switches(model)} in {owners}: kinks and jumps inside forces, which are stepped over"
    else:
        tables = landed_on_by_default(model)
        for names, fate in (
            ([switch.name for switch in switches(model) if switch.name not in tables], "located"),
            ([*tables], f"landed on at points of tables, as there are over {MANY_POINTS} of them"),
        ):
            if names:
                yield f"switches  {', '.join(names)}: kinks and jumps inside forces, which are {fate}"


def _conditions(model: Model) -> Iterator[str]:
    """Print joints, and the constraints that are no part of one, with those that others imply at the start."""
    joined, names = _joined(model), [*model.constraints]
    implied = implied_at_start(model.statement) if names else ()
    for name, joint in model.joints.items():
        first, second = joint.bodies
        word = {HINGE: "about", SLIDER: "along"}.get(joint.kind)
        axis = ", ".join(f"{part:g}" for part in joint.axis[0]) if word else ""
        where = f", {word} [{axis}] in {first}" if word else ""
        own = [k for k, key in enumerate(names) if joined.get(parted(key)[0]) == name]
        many = len({*own} & {*implied})
        shared = f"; {many} of its {len(own)} conditions implied at the start by those before them" if many else ""
        read = "".join(f", {word}" for word in tables_of_joint(name, joint).get("definitions", ()))
        yield f"joint     {name}: {joint.kind} of {first} and {second}{where}{read and f'; has{read[1:]}'}{shared}"
    for k, (name, constraint) in enumerate(model.constraints.items()):
        if parted(name)[0] in joined:
            continue
        word = "rolls" if constraint.holds is None else "holds"
        shared = ", implied at the start by those before it, with which it shares their force" if k in implied else ""
        yield f"constraint {name} {word}: {printed_simply(constraint.condition)} = 0{shared}"


def _scales(model: Model) -> Iterator[str]:
    """Report time scales and suitable steps at the start, or why they are unknown there."""
    steps: dict[str, float] = {}
    second = unit_suffix(model.time_unit)
    try:
        spectrum = modes(model)
    except InputError as error:
        yield f"scales    not known at the start: {error}"
    else:
        periods = [f"{period:.4g}{second}" for period in spectrum["period"].values if 0.0 < period < float("inf")]
        fastest = float(spectrum["fastest_time_scale"])
        scale = (
            f"fastest {fastest:.4g}{second}" if fastest < float("inf") else "none at the start: nothing turns or decays"
        )
        yield f"scales    {scale}{'; periods ' if periods else ''}{', '.join(periods[:4])}"
        steps = dict(zip(METHODS, spectrum["suggested_step"].values.tolist(), strict=True))
    refused: dict[str, list[str]] = {}
    for name, method in METHODS.items():
        if why := method.refusals(model):
            refused.setdefault("; ".join(why), []).append(name)
            continue
        suggested = steps.get(name, float("nan"))
        step = "" if not 0.0 < suggested < float("inf") else f", a step of {suggested:.2g}{second} to begin with"
        yield f"method    {name}: order {method.order}{', chooses steps' if method.estimate else ''}{step}"
    for reason, names in refused.items():
        yield f"not by    {', '.join(names)}: {reason}"

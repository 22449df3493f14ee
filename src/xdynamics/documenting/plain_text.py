"""A model in lines of text: its equations, initial values, time scales, and the methods that integrate it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain, groupby
from operator import itemgetter

from xdynamics.expressions import Node, size, text_of
from xdynamics.expressions.latex import printed_simply
from xdynamics.faults import InputError, display_text
from xdynamics.kernels.layout import layout_of
from xdynamics.kernels.newton_matrix import is_compressed, pattern_of
from xdynamics.march.contact_failures import OVER_IMPACTS, marches_over_impacts
from xdynamics.methods import METHODS
from xdynamics.methods.method import Method
from xdynamics.model import Model
from xdynamics.model.assemblies import assemblies
from xdynamics.model.body_reading import body_entries
from xdynamics.model.body_sections import scalar_part, vector_part
from xdynamics.model.constraints import Condition, conditions, implied_conditions
from xdynamics.model.controllers import controller_states, limited_value
from xdynamics.model.entries import COULOMB
from xdynamics.model.joint_sections import HINGE, SLIDER
from xdynamics.model.joints import made_by_joints, tables_of_joint
from xdynamics.model.linearisation import initial_state, is_densely_linked
from xdynamics.model.parts import Contact, Function
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
from xdynamics.shapes.naming import split_element_name
from xdynamics.stability.first_events import first_event
from xdynamics.stability.spectrum import Spectrum, checked_linearisation, methods_by_step
from xdynamics.units import Quantity, unit_suffix

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
DIGITS = 12  # of a value at the start that an expression gives
MOST_NODES = 400  # of the expression of an element, which is told as it is written for all if it has more
MOST_DERIVATIVES = 20_000  # of forces by the state, up to which time scales are sought
MOST_OF_WHOLES = 100_000  # where links far outnumber bodies: derivatives are found for all of them at once
MOST_UNKNOWNS = 2_000  # accelerations and rates, of whose matrix eigenvalues are sought
STEPS_TO_AN_EVENT = 5  # to begin with: as many as a twentieth of a period is of its quarter
HEAP = 50  # bodies that rub against each other: a march that locates every impact of theirs hardly ends

Line = tuple[
    str, Callable[[], str]
]  # what is said, and of which quantity; many elements are not put into words in vain


def model_lines(model: Model) -> Iterator[str]:
    """Summarise a checked model: its parts, motion, events, start and time scales; elements as people write them."""
    return map(display_text, _unspoken_model_lines(model))


def _unspoken_model_lines(model: Model) -> Iterator[str]:
    yield from resting_velocities_line(model.statement.at_rest)
    counts = [(len(getattr(model.elements.statement, kind)), kind) for kind in COUNTED]
    counts_text = ", ".join(f"{n} {kind if n > 1 else kind.removesuffix('s')}" for n, kind in counts if n)
    yield f"{model.name}: {counts_text}; every name is known and every unit fits"
    yield from _first_elements(chain(_motion_lines(model), _occasion_lines(model)))
    starts = ", ".join(
        _first_elements(
            (split_element_name(name)[0], partial(_start_text, model, name, value))
            for name, value in model.elements.statement.initial.items()
        )
    )
    consistency_note = "; moved from there to where constraints hold" if model.consistent else ""
    yield f"start     {starts}{f', regime {model.regime}' if model.regime else ''}{consistency_note}"
    yield from _time_scale_lines(model)


def _start_text(model: Model, name: str, value: Quantity) -> str:
    """Return a value at the start as it was written; that of an expression without the digits that rounding leaves."""
    start_values = model.statement.starting.get(split_element_name(name)[0])
    if start_values is not None and start_values.tree is not None:
        value = replace(value, value=float(f"{value.value:.{DIGITS}g}"))
    return f"{name} = {value}".removesuffix(" 1")


def _first_elements(lines: Iterable[Line]) -> Iterator[str]:
    """Yield the lines of the first elements of each quantity, and the number of the others."""
    for _, group in groupby(lines, itemgetter(0)):
        texts = [text for _, text in group]
        shown_texts = texts if len(texts) <= MOST_ELEMENTS + 1 else texts[:MOST_ELEMENTS]
        yield from (text() for text in shown_texts)
        if len(shown_texts) < len(texts):
            yield f"… and {len(texts) - len(shown_texts)} more elements"


def resting_velocities_line(velocities: Sequence[str]) -> Iterator[str]:
    """Report the velocities that were not given."""
    if velocities:
        yield f"at rest   {', '.join(velocities)}: [initial] gives none, so that they are 0 at the start"


def equation_lines(model: Model) -> Iterator[str]:
    """Print the motion, forces, definitions, rates, events, contacts and frictions of a model, each in a line."""
    yield from (display_text(text()) for _, text in chain(_motion_lines(model), _occasion_lines(model)))


def _joint_of_constraint(model: Model) -> dict[str, str]:
    """Return the joint of each constraint that joints stand for."""
    return {key: name for name, joint in model.joints.items() for key in tables_of_joint(name, joint)["constraints"]}


def _motion_lines(model: Model) -> Iterator[Line]:
    elements = model.elements
    joint_names, bodies, keeping = _joint_of_constraint(model), model.statement.bodies, conditions(model)
    for i, name in enumerate(elements.statement.coordinates):
        yield f"motion {split_element_name(name)[0]}", partial(_motion_line, model, i, name, keeping, joint_names)
    for term, components in elements.force_components.items():
        if (potential := _whole_potential(model, term, components)) is not None:
            yield term, partial("force     {} by the potential {}".format, term, potential)
            continue
        for name in components:
            yield (
                f"force {term} of {split_element_name(name)[0]}",
                partial(_force_component_line, term, name, components),
            )
    for name, solid in bodies.items():
        points = ", ".join(f"{name}_{point}" for point in solid.points)
        points_note = f"; points {points}" if points else ""
        attitude = f"turns, with the attitude {scalar_part(name)}, {vector_part(name)}{points_note}"
        yield name, partial("body      {}: {}".format, name, attitude)
    generated_names = (
        body_entries(bodies, "definitions")
        | body_entries(bodies, "states")
        | made_by_joints(model.joints, "definitions")
    )
    for name in elements.definitions:
        if split_element_name(name)[0] not in generated_names:
            yield split_element_name(name)[0], partial(_definition_line, model, name)
    held_names = controller_states(elements.controllers, model.time_unit)
    for name in elements.statement.states:
        if name not in held_names and split_element_name(name)[0] not in generated_names:
            yield split_element_name(name)[0], partial(_rate_line, model, name)
    for name in elements.controllers:
        yield name, partial(_controller_line, model, name)


def _motion_line(model: Model, i: int, name: str, keeping: Sequence[Condition], joint_names: Mapping[str, str]) -> str:
    elements = model.elements
    masses = elements.statement.mass_entries
    inertia = [
        f"{_bracketed_factor(masses[i, j])}*{acceleration(coordinate)}"
        for j, coordinate in enumerate(elements.statement.coordinates)
        if (i, j) in masses
    ]
    acting_terms = [term for term, components in elements.force_components.items() if name in components]
    own_conditions = [condition for condition in keeping if name in condition.row]
    acting_terms += [
        f"({printed_simply(condition.row[name])})*{constraint_force(condition.name)}"
        for condition in own_conditions
        if split_element_name(condition.name)[0] not in joint_names
    ]
    acting_terms += dict.fromkeys(
        f"joint {joint_names[key]}"
        for part in own_conditions
        if (key := split_element_name(part.name)[0]) in joint_names
    )
    return f"motion    {' + '.join(inertia)} = {' + '.join(acting_terms) or '0'}"


def _whole_potential(model: Model, term: str, components: Mapping[str, Node | Function]) -> str | None:
    """Return the potential of a force as it is written, where the force on an element has very many terms."""
    part, first = model.statement.forces.get(term), next(iter(components), "")
    if part is None or part.potential is None or not split_element_name(first)[1]:
        return None
    component = components[first]
    if isinstance(component, Function) or size(component) <= MOST_NODES:
        return None
    return text_of(part.potential) + (f" of each {part.over}" if part.over else "")


def _force_component_line(term: str, name: str, components: Mapping[str, Node | Function]) -> str:
    component = components[name]
    body = (
        f"{component.name}({', '.join(component.arguments)})"
        if isinstance(component, Function)
        else printed_simply(component)
    )
    return f"force     {term} of {name} = {body}"


def _definition_line(model: Model, name: str) -> str:
    return f"with      {name} = {printed_simply(model.elements.definitions[name])}"


def _rate_line(model: Model, name: str) -> str:
    state = model.elements.statement.states[name]
    trees = [*([] if state.written_rate is None else [printed_simply(state.written_rate)]), *state.terms]
    terms = "".join(f"; {term} = {printed_simply(tree)}{_when(model, term)}" for term, tree in state.terms.items())
    return f"rate      of {name} = {' + '.join(trees)}{terms}"


def _when(model: Model, term: str) -> str:
    acting = [name for name, regime in model.regimes.items() if term in regime.terms]
    return f" in {', '.join(acting)}" if acting else ""


def _controller_line(model: Model, name: str) -> str:
    controller = model.elements.controllers[name]
    waits = [f"{word} {time}" for word, time in (("phase", controller.phase), ("delay", controller.delay)) if time]
    values = [f"{output} = {printed_simply(limited_value(part))}" for output, part in controller.outputs.items()]
    values += [f"{state} = {printed_simply(part.next)}" for state, part in controller.states.items()]
    return f"controller {name}: every {controller.every}{''.join(f', {word}' for word in waits)}: {', '.join(values)}"


def _bracketed_factor(node: Node) -> str:
    text = printed_simply(node)
    return f"({text})" if " + " in text or " - " in text else text


def _occasion_lines(model: Model) -> Iterator[Line]:
    elements = model.elements
    for name in elements.events:
        yield f"event {split_element_name(name)[0]}", partial(_event_line, model, name)
    contacts = elements.contacts | {name: model.statement.contacts[name] for name in model.assemblies}
    for name in contacts:
        yield f"contact {split_element_name(name)[0]}", partial(_contact_line, name, contacts)
    yield from ((line, partial(str, line)) for line in _constraint_lines(model))
    for name in elements.frictions:
        yield f"friction {split_element_name(name)[0]}", partial(_friction_line, model, name)
    yield from ((line, partial(str, line)) for line in _switch_lines(model))


def _event_line(model: Model, name: str) -> str:
    event = model.elements.events[name]
    if isinstance(event.function, Function):
        body = event.function.name
    else:
        event_function = (
            None if size(event.function) <= MOST_NODES else model.statement.events.get(name, event).function
        )
        body = text_of(event_function) if isinstance(event_function, Node) else printed_simply(event.function)
    condition = f"{body} = 0, {event.direction}" if event.every is None else f"every {event.every}"
    return f"event     {name}: {condition}: {event.action}{f' to {event.to}' if event.to else ''}"


def _contact_line(name: str, contacts: Mapping[str, Contact]) -> str:
    contact = contacts[name]
    return (
        f"contact   {name}: {printed_simply(contact.gap)} >= 0, restitution {printed_simply(contact.restitution)},"
        f" {contact.tangential}"
    )


def _friction_line(model: Model, name: str) -> str:
    friction = model.elements.frictions[name]
    return (
        f"friction  {name}: at most {printed_simply(friction.static)} against {printed_simply(friction.slip)},"
        f" {printed_simply(friction.kinetic)} while it slips"
    )


def _switch_lines(model: Model) -> Iterator[str]:
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


def _constraint_lines(model: Model) -> Iterator[str]:
    """Print joints, and the constraints that are no part of one, with those that others imply at the start."""
    elements = model.elements
    joint_names, names = _joint_of_constraint(model), [*elements.constraints]
    implied = implied_conditions(model)
    for name, joint in model.joints.items():
        first, second = joint.bodies
        word = {HINGE: "about", SLIDER: "along"}.get(joint.kind)
        axis = ", ".join(f"{part:g}" for part in joint.axis[0]) if word else ""
        axis_note = f", {word} [{axis}] in {first}" if word else ""
        condition_indices = [k for k, key in enumerate(names) if joint_names.get(split_element_name(key)[0]) == name]
        implied_count = len({*condition_indices} & {*implied})
        shared = (
            f"; {implied_count} of its {len(condition_indices)} conditions implied at the start by those before them"
            if implied_count
            else ""
        )
        definitions_note = "".join(f", {word}" for word in tables_of_joint(name, joint).get("definitions", ()))
        yield f"joint     {name}: {joint.kind} of {first} and {second}{axis_note}{definitions_note and f'; has{definitions_note[1:]}'}{shared}"
    for k, (name, constraint) in enumerate(elements.constraints.items()):
        if split_element_name(name)[0] in joint_names:
            continue
        word = "rolls" if constraint.holds is None else "holds"
        shared = ", implied at the start by those before it, with which it shares their force" if k in implied else ""
        yield f"constraint {name} {word}: {printed_simply(constraint.condition)} = 0{shared}"


def check_can_be_linearised(model: Model) -> None:
    """Refuse to find the modes of a model whose forces have very many derivatives: it takes long.

    Raises
    ------
    InputError
        If they have.
    """
    layout = layout_of(model)
    if (unknowns := layout.used.size - layout.coordinates.size) > MOST_UNKNOWNS:
        raise InputError(
            f"there are {unknowns} accelerations and rates, over {MOST_UNKNOWNS}; xd.modes(model) takes its time"
        )
    max_derivatives = MOST_OF_WHOLES if is_densely_linked(model) else MOST_DERIVATIVES
    if is_compressed(layout) and (count := len(pattern_of(layout).entries)) > max_derivatives:
        raise InputError(
            f"the forces have {count} derivatives by the state, over {max_derivatives}; xd.modes(model) takes its time"
        )


def _time_scale_lines(model: Model) -> Iterator[str]:
    """Report time scales and the step to begin with, or why they are unknown at the start."""
    steps: dict[str, float] = {}
    second = unit_suffix(model.time_unit)
    taking = {name: method for name, method in METHODS.items() if not method.refusals(model)}
    try:
        check_can_be_linearised(model)
        start = initial_state(model)
        linearisation = checked_linearisation(model, start)
        spectrum = Spectrum.of(model, linearisation)
        event, delay = first_event(model, start, linearisation, within=spectrum.resolved / 2.0)
    except InputError as error:
        yield f"scales    not known at the start: {error}"
    else:
        periods = [f"{period:.4g}{second}" for period in spectrum.period.tolist() if 0.0 < period < float("inf")]
        turning = (
            f"fastest time constant {spectrum.fastest:.4g}{second}"
            if spectrum.fastest < float("inf")
            else "nothing turns or decays"
        )
        words = [turning, *([f"undamped periods {', '.join(periods[:4])}"] if periods else [])]
        words += [f"{event} after about {delay:.3g}{second}"] if event else []
        yield f"scales    at the start: {'; '.join(words)}"
        steps = {
            name: min(spectrum.suggested_step(method, model), delay / STEPS_TO_AN_EVENT)
            for name, method in taking.items()
        }
    yield from _method_lines(model, taking)
    yield from _first_step_lines(steps, second)
    yield from _heap_advice(model)


def _method_lines(model: Model, taking: Mapping[str, Method]) -> Iterator[str]:
    """List the methods that take a model with their orders, and why others do not."""
    for label, chooses in (("methods   by a step that is given", False), ("methods   that choose their steps", True)):
        if names := [f"{name} {method.order}" for name, method in taking.items() if bool(method.estimate) is chooses]:
            yield f"{label} (with order): {', '.join(names)}"
    refused: dict[str, list[str]] = {}
    for name, method in METHODS.items():
        if name not in taking:
            refused.setdefault("; ".join(method.refusals(model)), []).append(name)
    for reason, names in refused.items():
        yield f"not by    {', '.join(names)}: {reason}"


def _first_step_lines(steps: Mapping[str, float], second: str) -> Iterator[str]:
    """Tell the step to begin with, the one of most methods first."""
    for k, (step_text, names) in enumerate(sorted(methods_by_step(steps).items(), key=lambda item: -len(item[1]))):
        whose = f" by {', '.join(names)}" if k else ""
        yield f"step      {step_text}{second} to begin with{whose}"


def _heap_advice(model: Model) -> Iterator[str]:
    """Advise the method that steps over impacts where many bodies rub against each other."""
    for assembly in assemblies(model) if model.assemblies else ():
        relation, rubs = assembly.relation, assembly.contact.tangential == COULOMB
        if relation is None or relation.source != relation.target or not rubs:
            continue
        bodies = model.shapes.extent(relation.source).size
        if bodies >= HEAP and marches_over_impacts(model):
            yield (
                f"heap      {bodies} bodies may rub against each other by contact '{assembly.name}': other methods"
                " locate each of their impacts, lifts and slips, ever more as they come to rest;"
                f" method = {OVER_IMPACTS} steps over them"
            )

"""The outcome of a run in words, with the first quantity that was not finite in a failed step.

A failed test is explained by the coordinate, velocity or state that made it fail.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from math import isfinite

import numpy as np

from xdynamics import schema
from xdynamics.expressions import CALLED_ALONE, Binary, Call, Name, Node, text_of
from xdynamics.expressions.evaluation import evaluate
from xdynamics.expressions.tree import every, shortened_text
from xdynamics.faults import display_text
from xdynamics.march.accuracy_warnings import (
    accuracy_doubts,
    advice_on_stiffness,
    resets_passed_through,
    smooth_switch_remark,
)
from xdynamics.march.contact_failures import (
    assembly_dispute,
    balance_inconsistency,
    contact_dispute,
    law_violation,
    painleve_message,
    undefined_contact,
)
from xdynamics.march.equation_solvers import solver_of
from xdynamics.march.events.departures import GOES_ON
from xdynamics.march.outcomes import (
    COMPLETED,
    CONSTRAINT_VIOLATED,
    CONTACT_INCONSISTENT,
    CONTACT_PENETRATED,
    CONTACT_VIOLATED,
    EVENT_ACCUMULATION,
    EVENT_AT_ZERO,
    NONFINITE,
    NONFINITE_FORCE,
    NONFINITE_OBSERVABLE,
    OUTCOMES,
    OUTSIDE_TABLE,
    RUNNING,
    SLIDING_MODE,
    STEP_LIMIT,
    STEP_TOO_SMALL,
    STOPPED,
    Outcome,
)
from xdynamics.march.runner import March
from xdynamics.march.step_replay import replayed_evaluations, undefined_part
from xdynamics.march.unlocated_switches import NOWHERE, PASSAGES, STEPS
from xdynamics.model import Function, Model
from xdynamics.model.detectors import KINK, SWITCH, Detector
from xdynamics.model.kinks import original_call
from xdynamics.model.motion import constants
from xdynamics.model.parts import RECORD
from xdynamics.model.reactions import TANGENT, reactions
from xdynamics.model.switches import Switch
from xdynamics.schema import rate
from xdynamics.shapes.naming import join_element_name, split_element_name
from xdynamics.units import TIME, UNSCALED, unit_suffix
from xdynamics.units.digits import MOST, digits, known_part


def of_error(march: March) -> str:
    """Name the component with the largest estimated error over its scale in the last trial; empty if not estimated."""
    run, n = march.run, march.layout.used.size
    if not march.settings.scheme.estimates:
        return ""
    size_before, size_after = np.abs(run.y[:n]), np.abs(run.z[:n])
    return _worst_variable(march, run.e[:n], run.atol[:n] + run.plan[0].rtol * np.fmax(size_before, size_after))


def of_newton(march: March) -> str:
    """Name the component with the largest correction over its size in Newton's last iteration."""
    run, n = march.run, march.layout.used.size
    return _worst_variable(march, *solver_of(march.settings.method).corrections(run, n))


def _worst_variable(march: March, errors: np.ndarray, scales: np.ndarray) -> str:
    with np.errstate(all="ignore"):
        ratios = np.where(errors == 0.0, 0.0, np.abs(errors) / scales)
    return march.layout.used[int(np.argmax(np.where(np.isnan(ratios), np.inf, ratios)))]


_SMOOTHER = "write dry friction as [frictions], or a smooth force"
FEWEST = 6  # digits of the time at which a run failed
CANCELLED = 1e-9  # of the sizes of terms: what is left of them may be rounding
AT_END = 1e-12  # of the width of a table: how near to its end a march stands that cannot leave it


@dataclass(frozen=True)
class Ending:
    """The outcome of a run and its sentence, with t, h and the cause."""

    outcome: Outcome
    text: str


def ending(march: March) -> Ending:
    """Return how a march ended."""
    now, scale = march.now, march.settings.scales.si_factor(TIME)
    failure = Failure(march.outcome, march.stopping_event)
    if now.status != RUNNING and not march.outcome.good:
        failure = diagnose_failure(march)
    t, h = float(now.t) * scale, float(now.h) * scale
    second = unit_suffix(march.model.time_unit)
    text = failure.outcome.sentence.format(
        t=f"{t:.{_digits(march, t, h)}g}{second}", h=f"{h:.6g}{second}", cause=failure.cause
    )
    # advice on steps makes sense for a run that finished or ran out of steps
    advice = advice_on_stiffness(march) if now.status in (COMPLETED, STOPPED, STEP_LIMIT) else ""
    march.doubts = accuracy_doubts(march)
    remarks = (
        _chattering(march),
        _passed_over(march),
        _going_on(march),
        *march.doubts,
        smooth_switch_remark(march),
        advice,
    )
    return Ending(failure.outcome, display_text("; ".join(filter(None, (text, *remarks)))))


def _digits(march: March, t: float, h: float) -> int:
    """Return the significant digits of the last time: all of a requested end; of an event, those located and known."""
    status, events = march.now.status, march.model.elements.events
    if status == COMPLETED:
        return MOST
    if status != STOPPED:
        return max(FEWEST, digits(t, spacing=h))
    time_tolerances = [entry.time_tolerance for name, entry in events.items() if f"'{name}'" in march.stopping_event]
    located = max((march.settings.located_within(entry) for entry in time_tolerances), default=0.0)
    tolerances = march.settings.tolerances
    values = ((entry.quantity.value, entry.uncertainty) for entry in march.model.uncertain.values())
    return digits(t, uncertainty=located, relative=known_part(tolerances.rtol if tolerances else None, values))


@dataclass(frozen=True)
class Failure:
    """An unsuccessful outcome with its cause."""

    outcome: Outcome
    cause: str


def diagnose_failure(march: March) -> Failure:
    """Find the cause that ended a run.

    The failed step is repeated in plain numbers; the first quantity that is not finite is the cause. Where that
    is not possible, because equations are solved, the proposed state is examined instead.
    """
    status = int(march.now.status)
    if status == schema.REASON_EVENT_FUNCTION:
        return Failure(OUTCOMES[status], _undefined_events(march))
    if status == EVENT_AT_ZERO:
        watched_events = zip(march.layout.watched, march.run.watches["ever"].tolist(), strict=True)
        cause = ", ".join(
            f"the function of event '{detector.name}' is 0" for detector, ever in watched_events if not ever
        )
        return Failure(OUTCOMES[status], cause)
    if status in (SLIDING_MODE, EVENT_ACCUMULATION):
        acting = _crowding(march)
        return Failure(OUTCOMES[status], acting or _sliding(march))
    if status == CONTACT_VIOLATED:
        return Failure(OUTCOMES[status], law_violation(march))
    if status == NONFINITE_OBSERVABLE:
        return _row_failure(march)
    if status == CONSTRAINT_VIOLATED:
        return Failure(OUTCOMES[status], _violated(march))
    if status in (schema.REASON_CONTACT, CONTACT_PENETRATED, CONTACT_INCONSISTENT):
        few = balance_inconsistency if status == CONTACT_INCONSISTENT else contact_dispute
        say = assembly_dispute if march.model.assemblies else few
        return Failure(OUTCOMES[status], say(march))
    if status not in (schema.REASON_NONFINITE, schema.REASON_DOMAIN, schema.REASON_NEWTON):
        return Failure(OUTCOMES[status], _finite_cause(march))
    for values in () if march.model.delays else replayed_evaluations(march):
        if failure := _evaluation_failure(march, values):
            return failure
    if status == schema.REASON_NEWTON:
        return Failure(OUTCOMES[status], _finite_cause(march))
    return _state_failure(march, dict(zip(march.layout.record, march.run.z.tolist(), strict=True)))


def _undefined_events(march: March) -> str:
    """Name the event functions that have no value; at the start the trial has none yet."""
    values = march.run.g if float(march.now.h) == 0.0 else march.run.g1
    kind_by_role = {SWITCH: "the switch", KINK: "the switch"}
    return ", ".join(
        f"the function of {kind_by_role.get(detector.role, 'event')} '{detector.name}' is {value}"
        for detector, value in zip(march.layout.watched, values.tolist(), strict=True)
        if not isfinite(value)
    )


def _sliding(march: March) -> str:
    """Name the switch to which both sides drive the motion back."""
    if march.slides is not None:
        return (
            f"{_jump_text(march, march.slides)}, and the last {STEPS} steps went to and fro across it: it slides along the switch"
            f" (Filippov), which is no motion by this force; {_SMOOTHER}"
        )
    if march.sliding.fault:
        return f"{march.sliding.fault}; {_SMOOTHER}"
    watched = zip(march.layout.watched, march.run.watches["hit"].tolist(), strict=True)
    switch = next(switch for switch, hit in watched if hit and switch.role == SWITCH)
    return (
        f"{_jump_text(march, switch)}, and either side drives the motion back: it slides along the switch (Filippov), which is"
        f" no motion by this force; {_SMOOTHER}"
    )


def _crowding(march: March) -> str:
    """Describe events that act without end at one time, with a remedy; empty if a hidden switch does."""
    limits = march.run.departures["limit"]
    if not limits.size or not (limits > -np.inf).any():
        return ""
    crowding = [
        detector for detector, limit in zip(march.layout.watched, limits.tolist(), strict=True) if limit > -np.inf
    ]
    events = " and ".join(f"event '{detector.name}'" for detector in crowding)
    act = "act" if len(crowding) > 1 else "acts"
    if int(march.now.status) == SLIDING_MODE:
        return (
            f"{events} {act} to and fro at one instant: the forces of either regime drive the motion back to where they are"
            f" switched, along which it would slide (Filippov); {_SMOOTHER}, a limit as [contacts], or let the regimes"
            " switch back a little apart (hysteresis)"
        )
    time = accumulation(march)
    if (
        time is not None
        and time[1] > march.settings.scales.si_factor(TIME) * float(march.run.detectors["tolerance"].min()) * 2.0
    ):
        when = f"after ever shorter pauses, of which the last would end at t = {time[0]:.15g}{unit_suffix(march.model.time_unit)}"
    else:
        when = "again and again, with no time in between"
    return (
        f"{events} {act} {when}: no motion of this model goes on from there; write bodies that bounce or rest as [contacts],"
        f" and let what is switched to and fro switch back a little apart (hysteresis)"
    )


def accumulation(march: March) -> tuple[float, float] | None:
    """Return when actions of events that crowd together end, and its uncertainty, in the unit of time; None if none do."""
    departures, scale = march.run.departures, march.settings.scales.si_factor(TIME)
    if int(march.now.status) != EVENT_ACCUMULATION or not departures.size:
        return None
    last = departures[int(np.argmax(departures["limit"]))]
    return float(last["limit"]) * scale, float(last["doubt"]) * scale


def _passed_over(march: March) -> str:
    """Name the acting events without a direction whose functions left zero at the start, which is no passage."""
    departures = march.run.departures
    if not departures.size:
        return ""
    names = [
        f"'{detector.name}'"
        for detector, at_start in zip(march.layout.watched, departures["at_start"].tolist(), strict=True)
        if at_start and detector.direction == "either" and detector.event.action != RECORD
    ]
    if not names:
        return ""
    return (
        f"the function of event {' and '.join(names)} is zero at the start and leaves it, which is no passage of an event"
        " without a direction; with direction = 'rising' or 'falling' it acts at the start, if it leaves in that direction"
    )


def _going_on(march: March) -> str:
    """Name the resets that bring a motion to rest at their zero, from where it goes on in their direction."""
    names = resets_passed_through(march, GOES_ON)
    if not names:
        return ""
    return (
        f"event {' and '.join(names)} brings the motion to rest where its function is zero, and it goes on from there in"
        " the same direction; a support that bears is written as [contacts]"
    )


def _chattering(march: March) -> str:
    """Return at which switch a motion came to rest that passes it to and fro without end, and the remedy."""
    if march.chattering == NOWHERE:
        return ""
    return (
        f"{_jump_text(march, march.layout.watched[march.chattering])}, and either side drives the motion back: it rests there,"
        f" and the last {PASSAGES} passages are made by rounding alone, whatever the tolerances; {_SMOOTHER}"
    )


def _jump_text(march: March, switch: Detector | Switch) -> str:
    """Describe where a force switches."""
    quantity, labels = split_element_name(switch.name)
    owner, function = quantity.split(".")
    kind = function.split("_")[0]
    if kind in CALLED_ALONE:
        where = f"jumps where {text_of(original_call(kind, switch.function))} does"
    else:
        where = f"switches where {_equation(switch.function)}, the argument of its {function}"
    if switch.drive:
        drive = march.model.elements.drives[switch.drive]
        table_point = _drive_argument(march, switch.drive) * march.settings.scales.si_factor(
            drive.table.argument_unit.dimension
        )
        where = f"jumps at {text_of(drive.argument)} = {table_point:.15g} (SI units), a point of the table '{drive.table.name}'"
    return f"'{join_element_name(owner, labels)}' {where}"


def _equation(function: Node) -> str:
    """Write the equation of an expression's zero; for a difference, that of both sides."""
    sides = (function.left, function.right) if isinstance(function, Binary) and function.operator == "-" else None
    return " = ".join(map(text_of, sides)) if sides else f"{text_of(function)} = 0"


def _finite_cause(march: March) -> str:
    """Explain why a march cannot continue though all numbers are finite."""
    norm, plan = float(march.now.norm), march.run.plan[0]
    match int(march.now.status):
        case status if status == schema.REASON_ERROR:
            return (
                f"the error test fails at the minimum step, with norm {norm:.3g}, most of all in {of_error(march)}; the"
                " tolerance or the minimum step does not suit the model"
            )
        case status if status == STEP_LIMIT:
            events = int(march.now.events)
            search = f", with those that located {events} events" if events and plan.apart else ""
            used = f"{plan.most_steps:.0f} accepted steps and rejected trials are used up{search}"
            if march.chattering != NOWHERE:
                return used
            if left := _at_end_of_table(march):
                return f"{used}: {left}"
            remedy = f"raise max_steps{'' if search else ' or the tolerances'}"
            return f"{used}, where {of_error(march)} has the largest error; {remedy}"
        case status if status == schema.REASON_NEWTON and np.isnan(march.run.z[plan.moved]) and plan.held:
            return _unmet(march)
        case status if status == schema.REASON_NEWTON:
            remedy = "the model is not smooth enough here" if plan.adaptive else "take a shorter step"
            settings = march.settings
            limit = solver_of(settings.method).reported(settings, march.law)["solver_newton_most_iterations"]
            return (
                f"Newton's method, of at most {limit} iterations, does not solve the step's equations, that of"
                f" {of_newton(march)} least of all; {remedy}"
            )
        case status if status == STEP_TOO_SMALL and plan.adaptive and norm > 1.0:
            return (
                f"the error test fails, with norm {norm:.3g}, most of all in {of_error(march)}, at the shortest step"
                f" that t resolves; {_unresolved(march)}"
            )
        case status if status == STEP_TOO_SMALL:
            return "t + h is t in double precision; take a longer step or an earlier t"
    return ""


def _unresolved(march: March) -> str:
    """Explain an error too large at the shortest step: by a singularity, or by rounding of terms."""
    run, plan, name = march.run, march.run.plan[0], of_error(march)
    i, n = march.layout.used.index(name), march.layout.coordinates.size
    singular = "the solution has a singularity here, or t is too large for its time scale"
    remedy = f"give {name} an atol"
    if not run.adaptive_atol[i]:
        return singular
    if plan.rounding == 0.0:
        return f"{singular}, or forces that cancel hold {name}, whose rounding alone moves it: {remedy}"
    rate_index = march.layout.used.size + (i if i < n else i - n)  # of its rate, or of a coordinate its acceleration
    rate, terms = abs(float(run.z[rate_index])), float(run.probe[rate_index])
    if rate <= CANCELLED * terms:
        return f"what is left of the forces that cancel there, {rate / terms:.1g} of their sizes, is rounding: {remedy}"
    return singular


def _unmet(march: March) -> str:
    """State that the result of a step could not be projected onto constraints."""
    constraint_names = ", ".join(f"'{name}'" for name in march.model.elements.constraints)
    remedy = (
        "they contradict each other, or the motion is singular here"
        if march.run.plan[0].adaptive
        else "take a shorter step"
    )
    return f"no state near the step's result satisfies the constraints {constraint_names}; {remedy}"


def _violated(march: March) -> str:
    """State that constraints are violated at the start."""
    constraint_names = ", ".join(f"'{name}'" for name in march.model.elements.constraints)
    return f"constraints ({constraint_names}) do not hold at the start; give values that satisfy them, or [initial] consistent = true"


def _row_failure(march: March) -> Failure:
    """Name the energy or observable that is not finite in the last row, which was not recorded."""
    column = march.bad_values
    bad = ", ".join(f"{name} is {column[name]}" for name in march.layout.derived if not isfinite(column[name]))
    for name in march.layout.drives:
        if _leaves_table(march, name):
            return Failure(OUTSIDE_TABLE, f"{bad}: {_outside_table_text(march, name, _drive_argument(march, name))}")
    return Failure(OUTCOMES[NONFINITE_OBSERVABLE], bad)


def _drive_argument(march: March, name: str) -> float:
    """Return a drive's argument after the last trial, in internal units; without a state, from the old velocity."""
    now, layout, argument = march.now, march.layout, march.model.elements.drives[name].argument
    if not isinstance(argument, Name) or argument.name not in layout.used:
        state = dict(zip(layout.used, march.run.z.tolist(), strict=False)) | {"t": float(now.t + now.h)}
        tree, constant_values = march.model.elements.expanded(argument), constants(march.model, march.settings.scales)
        return evaluate(tree, {**constant_values, **state})
    argument_index = layout.record.index(argument.name)
    if isfinite(march.run.z[argument_index]) or argument.name in layout.velocities:
        return float(march.run.z[argument_index])
    return float(march.run.y[argument_index] + now.h * march.run.y[layout.record.index(schema.velocity(argument.name))])


def _argument_at_state(march: March, name: str, values: dict[str, float]) -> float:
    """Return a drive's argument at a state, in internal units."""
    constant_values = constants(march.model, march.settings.scales)
    return evaluate(
        march.model.elements.expanded(march.model.elements.drives[name].argument), {**constant_values, **values}
    )


def _leaves_table(march: March, name: str) -> bool:
    drive = march.model.elements.drives[name]
    value = _drive_argument(march, name) * march.settings.scales.si_factor(drive.table.argument_unit.dimension)
    return drive.outside == "error" and not drive.table.argument[0] <= value <= drive.table.argument[-1]


def _evaluation_failure(march: March, values: dict[str, float]) -> Failure | None:
    """Examine one force evaluation: the state it used, the drives, the force terms, the rates."""
    layout, model = march.layout, march.model
    when = f"in the evaluation at t = {values['t'] * march.settings.scales.si_factor(TIME):.15g}{unit_suffix(march.model.time_unit)}"
    for name in layout.used:
        if not isfinite(values[name]):
            return Failure(NONFINITE, f"{name} is {values[name]} {when}")
    for name in layout.drives:
        if not isfinite(values[name]):
            return Failure(OUTSIDE_TABLE, _outside_table_text(march, name, _argument_at_state(march, name, values)))
    for reaction in reactions(model):
        # reactions that are not finite with finite forces: their matrix has no positive pivots
        if not isfinite(values[reaction.name]) and all(isfinite(values[name]) for name in layout.forces):
            owner = reactions(model)[reaction.normal]
            sliding = next(
                (
                    reaction
                    for reaction in reactions(model)
                    if reaction.sort == TANGENT and reaction.owner == owner.owner
                ),
                None,
            )
            if sliding is not None:
                return Failure(
                    OUTCOMES[schema.REASON_CONTACT], painleve_message(sliding, evaluate(sliding.size, values))
                )
    for name, tree in _trees_of(model).items():
        if not isfinite(values[name]):
            why = "" if isinstance(tree, Function) else undefined_part(model.elements.expanded(tree), values)
            why = why if march.settings.scales == UNSCALED else ""  # only if numbers are SI
            why = f": {why}" if why else _zero_divisor(march, name, values)
            return Failure(NONFINITE_FORCE, f"{name} is {values[name]} {when}{why}")
    return None


def _trees_of(model: Model) -> dict[str, Node | Function]:
    """Return the expressions of force components and rates, by their names in a law."""
    trees = {
        schema.force(term, name): tree
        for term, components in model.elements.force_components.items()
        for name, tree in components.items()
    }
    return trees | {rate(name): state.rate for name, state in model.elements.statement.states.items()}


def _zero_divisor(march: March, name: str, state: Mapping[str, float]) -> str:
    """Say which divisor of a force or rate is 0 at a state, as the distance is in the slope of a distance."""
    model, tree = march.model, _trees_of(march.model).get(name)
    if tree is None or isinstance(tree, Function) or march.settings.scales != UNSCALED:
        return ""
    values = {**constants(model), "t": float(march.run.now[0].t), **state}
    for node in every(model.elements.expanded(tree)):
        with suppress(KeyError, ArithmeticError, ValueError):
            if isinstance(node, Binary) and node.operator == "/" and evaluate(node.right, values) == 0.0:
                rooted = any(
                    isinstance(inner, Call) and inner.function in ("sqrt", "hypot") for inner in every(node.right)
                )
                remedy = (
                    "; it is divided by in the slope of a root: write the square of a distance by sums, x**2 + y**2 or"
                    " sum(r**2, axis), or add a small length under the root"
                )
                return f": {shortened_text(node.right)} is 0 there{remedy if rooted else ', and it is divided by'}"
    return ""


def _outside_table_text(march: March, name: str, value: float) -> str:
    drive = march.model.elements.drives[name]
    value *= march.settings.scales.si_factor(drive.table.argument_unit.dimension)
    low, high = drive.table.argument[0], drive.table.argument[-1]
    return (
        f"drive '{name}' was evaluated at {text_of(drive.argument)} = {value:.15g}, and its table '{drive.table.name}' reaches from"
        f' {low:.15g} to {high:.15g} (SI units); set outside = "zero" or "hold", or stay inside'
    )


def _at_end_of_table(march: March) -> str:
    """Name the drive whose table ends where a march with chosen steps stands: longer ones leave it, shorter ones go nowhere."""
    for name, drive in march.model.elements.drives.items():
        argument, (low, high) = drive.argument, drive.table.argument[[0, -1]].tolist()
        if drive.outside != "error" or not isinstance(argument, Name) or argument.name not in march.layout.used:
            continue
        value = float(march.run.y[march.layout.record.index(argument.name)])
        argument_value = value * march.settings.scales.si_factor(drive.table.argument_unit.dimension)
        if min(abs(argument_value - low), abs(argument_value - high)) <= AT_END * (high - low):
            return _outside_table_text(march, name, value)
    return ""


def _state_failure(march: March, state: dict[str, float]) -> Failure:
    """Examine a proposed state: drives, forces, then accelerations and quantities that follow from them."""
    layout = march.layout
    for name in layout.drives:
        if _leaves_table(march, name):
            return Failure(OUTSIDE_TABLE, _outside_table_text(march, name, _drive_argument(march, name)))
    for name in (*layout.forces, *layout.used):
        if not isfinite(state[name]):
            outcome = NONFINITE_FORCE if name in layout.forces else NONFINITE
            return Failure(outcome, f"{name} is {state[name]}{_zero_divisor(march, name, state)}")
    for name in layout.rates:
        if not isfinite(state[name]):
            return Failure(NONFINITE_FORCE, f"{name} is {state[name]}{_zero_divisor(march, name, state)}")
    if why := undefined_contact(march):
        return Failure(OUTCOMES[schema.REASON_CONTACT], why)
    bad = [name for name in layout.accelerations if not isfinite(state[name])]
    return Failure(
        NONFINITE_FORCE, f"{', '.join(bad)} is not finite with finite forces: the mass is not positive definite"
    )

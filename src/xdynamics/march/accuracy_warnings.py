"""Reasons to doubt the accuracy of a finished run, stated in its outcome so that nobody takes its digits on trust."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.rounding_margins import EPS
from xdynamics.expressions import free_names
from xdynamics.expressions.calculus import ZERO
from xdynamics.expressions.evaluation import evaluate
from xdynamics.march.assembly.broad_phase import NEEDED, NEEDED_AT, OUTSIDE, OUTSIDE_LINK, OUTSIDE_OF
from xdynamics.march.energy_gains import impact_energy_dimension
from xdynamics.march.events.departures import STRAYS
from xdynamics.march.runner import March
from xdynamics.march.timescales import jacobian_at
from xdynamics.march.uncontrolled_errors import LOSS, error_effect, passed_over
from xdynamics.model import Model, Trait
from xdynamics.model.assemblies import assemblies
from xdynamics.model.constraint_consistency import implied_at_start
from xdynamics.model.constraints import beyond_trees, conditions
from xdynamics.model.linearisation import initial_state, mass_matrices
from xdynamics.model.motion import constants
from xdynamics.model.parts import ENERGETIC, POISSON
from xdynamics.model.reactions import TANGENT, reactions
from xdynamics.model.switches import MOST_SWITCHES, STEPPED_OVER, are_too_many, count_of_switches, owners_of_switches
from xdynamics.model.tangent_space import independent_counts
from xdynamics.model.traits import curved_contacts
from xdynamics.stability import decay_limit, fastest_rate, rough_rate, stiffness
from xdynamics.units import TIME, parse_unit, spell, unit_suffix

MOST_NAMED = 3
FEW_ROWS = 100  # of a run; with fewer, stiffness is not looked for
ALIKE = 1e-6  # of a length: tolerance for numbers that were rounded when written down
FEW_LOOKS = 12  # evaluations of a mass matrix, 50 microseconds each
NOT_STIFF = 0.45  # of the decay limit; steps from half of it on count as limited by it, less the error of differences
WELL_CONDITIONED = 1e10  # leaves six digits of the accelerations


def accuracy_doubts(march: March) -> list[str]:
    """Return, each in a sentence, why the numbers of a finished march may be less accurate than they look."""
    return [
        *_loose_tolerance_doubts(march),
        *_first_step_doubts(march),
        *_mass_condition_doubts(march),
        *_switch_count_doubts(march),
        *_friction_direction_doubts(march.model),
        *_energy_gain_doubts(march),
        *_event_position_doubts(march),
        *_stopped_slip_doubts(march),
        *_held_link_doubts(march),
        *_implied_condition_doubts(march.model),
        *_reset_doubts(march),
    ]


def _loose_tolerance_doubts(march: March) -> Iterator[str]:
    """Name the variables whose given absolute tolerances allow errors that matter to the final state."""
    effect, tolerances, model = error_effect(march), march.settings.tolerances, march.model
    march.atol_effect = effect.words
    if tolerances is None or not effect.loose.any():
        return
    loose_indices, loose, scales = np.flatnonzero(effect.loose).tolist(), [], march.settings.scales
    for variable_index in loose_indices[:MOST_NAMED]:
        name, largest = march.layout.used[variable_index], float(march.run.largest[variable_index])
        atol, unit, factor = tolerances.atol_of(name) or 0.0, model.units[name].text, float(model.units[name].factor)
        unit = "" if unit == "1" else f" {unit}"
        size = largest * scales.si_factor(model.dimensions[name])
        loose.append(f"{name} (largest value {size / factor:.3g}{unit}, atol {atol / factor:.3g}{unit})")
    remainder = f" and {len(loose_indices) - MOST_NAMED} more" if len(loose_indices) > MOST_NAMED else ""
    yield (
        f"the tolerances did not control {', '.join(loose)}{remainder}: errors of atol in each of"
        f" {march.accepted} steps may come to more than {LOSS:.0%} of the motion; give smaller ones by atol, or none:"
        " it follows the sizes then"
    )


def resets_passed_through(march: March, how: int) -> list[str]:
    """Name the resets that ever failed to turn the motion back, in the way of a bit of `events.departures`."""
    departures = march.run.departures
    passed = zip(march.layout.watched, departures["goes_on"].tolist(), strict=True) if departures.size else ()
    return [f"'{detector.name}'" for detector, passes in passed if passes & how]


def _reset_doubts(march: March) -> Iterator[str]:
    """Name the resets that turned a motion back which errors of steps had carried through zero: it may never return."""
    if names := resets_passed_through(march, STRAYS):
        yield (
            f"event {' and '.join(names)} set the motion back when errors of steps had carried it through zero by more than"
            " time tolerances allow, and it need not come back from there; give a smaller rtol or step, a method of higher"
            " order, or write what bounces as [contacts]"
        )


def _first_step_doubts(march: March) -> Iterator[str]:
    """Report a given first step over which forces at the start change many times."""
    times = passed_over(march)
    if times:
        yield (
            f"the first step is {times:.3g} times as long as the fastest change of the forces at the start, and what it"
            " led to has nothing to do with them; give a shorter step, or rtol in place of a step"
        )


def _mass_condition_doubts(march: March) -> Iterator[str]:
    """Report how nearly singular the mass matrix was, at some of the run's rows."""
    model = march.model
    if not model.mass_is_full:
        return
    moving = {"t", *march.layout.used, *model.drives}
    varies = any(model.reads(entry) & moving for entry in model.statement.mass_entries.values())
    stride = max(1, march.witnesses.steps.shape[1] // FEW_LOOKS) if varies else march.witnesses.steps.shape[1]
    states = _si_states_of_rows(march, march.witnesses.rows[1:, ::stride])
    conditions = [_scaled_condition_number(mass) for mass in mass_matrices(model, states)]
    worst = int(np.argmax(conditions))
    if conditions[worst] > WELL_CONDITIONED:
        digits = max(0.0, -math.log10(conditions[worst] * EPS))
        yield (
            f"the mass matrix is nearly singular, of condition {conditions[worst]:.2g} at t ="
            f" {states[worst]['t']:.6g}{unit_suffix(model.time_unit)}: of the 16 digits of accelerations about {digits:.0f}"
            " are right; choose other coordinates"
        )


def _switch_count_doubts(march: March) -> Iterator[str]:
    """Report a model with more hidden switches than can be located."""
    model = march.model
    if march.settings.switches == STEPPED_OVER and are_too_many(model):
        owners = ", ".join(f"'{owner}'" for owner in owners_of_switches(model))
        yield (
            f"{count_of_switches(model)} switches are hidden in {owners} (abs, sign, min, max, where, tables), and {MOST_SWITCHES}"
            " at most are located: all were stepped over, which costs the order; declare those smooth that need not be"
            " located"
        )


def smooth_switch_remark(march: March) -> str:
    """Return which switches declared smooth were stepped over, and what that costs."""
    counts, times = march.passed
    if not counts.any():
        return ""
    unit = march.model.time_unit.text
    passings = sorted(
        (time, switch_name, count)
        for time, switch_name, count in zip(
            times.tolist(), (switch.name for switch in march.layout.smooth), counts.tolist(), strict=True
        )
        if count
    )
    descriptions = [
        f"{name} {'once' if count == 1 else f'{count} times'}, first before t ="
        f" {time * march.settings.scales.si_factor(TIME):.6g}{'' if unit == '1' else f' {unit}'}"
        for time, name, count in passings[:MOST_NAMED]
    ]
    remainder = f" and {len(passings) - MOST_NAMED} more" if len(passings) > MOST_NAMED else ""
    return (
        f"switches in forces that are declared smooth were passed by a step: {', '.join(descriptions)}{remainder};"
        " without smooth = true they are located"
    )


def _friction_direction_doubts(model: Model) -> Iterator[str]:
    """Report friction whose gap is not a distance or whose slip leaves the surface, by directions at the start."""
    if not model.contacts:
        return
    values = dict(constants(model)) | initial_state(model)
    metre = parse_unit("m").dimension
    lengths = [name for name, entry in model.statement.coordinates.items() if entry.unit.dimension == metre]
    all_reactions = reactions(model)
    for entry in all_reactions:
        rows = [reaction.row.get(name, ZERO) for reaction in (all_reactions[entry.normal], entry) for name in lengths]
        if entry.sort != TANGENT or any(free_names(tree) - set(values) for tree in rows):
            continue
        normal, tangent = np.array([evaluate(tree, values) for tree in rows]).reshape(2, -1)
        size, slip = float(np.linalg.norm(normal)), float(np.linalg.norm(tangent))
        if size == 0.0 or slip == 0.0:
            continue
        if abs(float(normal @ tangent)) > ALIKE * size * slip:
            yield (
                f"the slip of contact '{entry.owner}' is not along its surface: its direction at the start is not at"
                " right angles to the gap's gradient"
            )
        elif abs(size / slip - 1.0) > ALIKE:
            yield (
                f"the gap of contact '{entry.owner}' grows {size / slip:.6g} times as fast as a distance, going by its"
                " slip: contact_force and friction are in that measure; divide the gap by it"
            )


def _energy_gain_doubts(march: March) -> Iterator[str]:
    """Report impacts that created energy."""
    gains, model = march.gains, march.model
    if not gains.groups:
        return
    contacts = model.contacts | model.assemblies
    law, unit = next(iter(contacts.values())).law, spell(impact_energy_dimension(model)).text
    name = f"'{march.layout.watched[int(gains.detector)].name}'"
    for assembly in assemblies(model):
        if gains.link >= 0 and name == f"'{assembly.name}'":
            name += f" of {assembly.label(int(gains.link))}"
    where = (
        f"at event {gains.event:.0f} ({name}, t = {gains.time:.6g}{unit_suffix(model.time_unit)}, event_energy_lost ="
        f" {-gains.energy:.3g} {unit})"
    )
    times = "an impact" if gains.groups == 1.0 else f"{gains.groups:.0f} impacts, most of it"
    frictional = any(contact.slip is not None for contact in contacts.values())
    causes = ["there is friction (Kane's paradox)"] * frictional + ["several are struck at once"] * (
        bool(model.assemblies) or len(contacts) > 1
    )
    alternatives = (
        f"law = '{ENERGETIC}' does not" if law == POISSON else f"law = '{POISSON}' and law = '{ENERGETIC}' do not"
    )
    yield (
        f"energy was created in {times} {where}: restitution by law = '{law}' may do so where {' or '.join(causes)};"
        f" {alternatives}"
    )


def _event_position_doubts(march: March) -> Iterator[str]:
    """Report events that were not located within their position tolerance."""
    names = dict.fromkeys(
        f"'{detector.name}'" for detector, missed in zip(march.layout.watched, march.misplaced, strict=True) if missed
    )
    if names:
        yield (
            f"the position tolerance of {', '.join(names)} was not met by every event: rounding of the function, or of"
            " t, leaves more; event_position says where"
        )


def _implied_condition_doubts(model: Model) -> Iterator[str]:
    """Report conditions that others imply but for a share which is too small to be kept."""
    implied = implied_at_start(model.statement) if model.constraints else ()
    if implied and len(conditions(model)) - len(implied) < independent_counts(model)[0]:
        names = ", ".join(f"'{conditions(model)[condition_index].name}'" for condition_index in implied)
        yield (
            f"of the constraints {names} one is at the start all but implied by others, and what little it adds is not kept:"
            " its constraint_residual says how far it is off; write what it adds by itself"
            if len(implied) > 1
            else f"constraint {names} is at the start all but implied by others, and what little it adds is not kept: its"
            " constraint_residual says how far it is off; write what it adds by itself"
        )


def _stopped_slip_doubts(march: March) -> Iterator[str]:
    """Report impulses that stopped slips which wedged, and rubbed by more than friction allows."""
    run, model = march.run, march.model
    count = int(run.counters[OUTSIDE]) if model.assemblies else 0
    if not count:
        return
    assembly = assemblies(model)[int(run.counters[OUTSIDE_OF])]
    time = float(run.spans[NEEDED_AT]) * march.settings.scales.si_factor(TIME)
    needed = float(run.spans[NEEDED])
    excess_text = (
        f"{needed:.3g} times what its friction allows" if needed < math.inf else "by a pull, which no friction allows"
    )
    yield (
        f"{count} of the slow slips were stopped by impulses outside their cone of friction, most of all that of"
        f" contact '{assembly.name}' of {assembly.label(int(run.counters[OUTSIDE_LINK]))} at t ="
        f" {time:.6g}{unit_suffix(model.time_unit)}, {excess_text}: what follows is not Coulomb's law to the last; a smaller"
        " rest_height stops fewer"
    )


def _held_link_doubts(march: March) -> Iterator[str]:
    """Report that bodies which were to bounce for ever were held, by forces of which the method loses its order."""
    method, model = march.settings.method, march.model
    curved = curved_contacts(model) if march.held_links and Trait.HELD_LINKS in method.refuses else []
    if curved:
        yield (
            f"bodies were held by contacts along curved gaps ({', '.join(curved)}), whose forces depend on velocities:"
            f" there '{method.name}' is not of order {method.order}, but of 2 or less; take velocity_verlet, rk4 or dop853"
        )


def _scaled_condition_number(mass: NDArray[np.float64]) -> float:
    """Return the condition number of a mass matrix scaled to a unit diagonal, so that it does not depend on units."""
    size = np.sqrt(np.abs(np.diagonal(mass)))
    if not (np.isfinite(mass).all() and size.all()):
        return math.inf
    return float(np.linalg.cond(mass / np.outer(size, size)))


def _si_states_of_rows(march: March, rows: NDArray[np.float64]) -> list[dict[str, float]]:
    """Return rows of time, step, state as SI numbers by name."""
    scales, names = march.settings.scales, march.layout.used
    time, factors = scales.si_factor(TIME), march.layout.sizes(scales).tolist()
    return [
        {"t": t * time} | {name: x * f for name, x, f in zip(names, state, factors, strict=True)}
        for t, _, *state in rows.T.tolist()
    ]


def advice_on_stiffness(march: March) -> str:
    """Return advice where stability limits the chosen steps of an explicit method for most of a run, else nothing."""
    method, model = march.settings.method, march.model
    if not march.settings.adaptive or method.solves or model.python_forces or march.now.rows < FEW_ROWS:
        return ""
    if beyond_trees(model) or model.delays:
        return ""
    time, rows = march.settings.scales.si_factor(TIME), march.witnesses.rows[1:]

    def limited_share(first: int, last: int) -> float:
        chosen_rows = rows[:, first:last]
        return stiffness(model, method, _si_states_of_rows(march, chosen_rows), (chosen_rows[1] * time).tolist())

    # most runs are not stiff: one row first, by bounds from its compiled forces, before its exact derivatives
    middle = rows.shape[1] // 2
    jacobian, step = jacobian_at(march, middle), float(rows[1, middle])
    if any(rate(jacobian) * step < NOT_STIFF * decay_limit(method) for rate in (rough_rate, fastest_rate)):
        return ""
    if limited_share(middle, middle + 1) and limited_share(0, rows.shape[1]) > 0.5:
        return (
            f"stiffness suspected: stability, not accuracy, limits the steps of '{method.name}' for most of the run;"
            " radau_iia takes longer ones"
        )
    return ""

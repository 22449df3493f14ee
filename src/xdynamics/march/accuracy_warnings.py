"""Doubts about the accuracy of a finished run, stated in its outcome so that nobody takes its digits on trust.

Given absolute tolerances, or given steps, leave some errors uncontrolled: the variables in which these matter are
named.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.bounds import EPS
from xdynamics.expressions import free_names
from xdynamics.expressions.calculus import ZERO
from xdynamics.expressions.evaluation import evaluate
from xdynamics.kernels import Layout
from xdynamics.march.assembly.broad_phase import NEEDED, NEEDED_AT, OUTSIDE, OUTSIDE_LINK, OUTSIDE_OF
from xdynamics.march.energy_gains import impact_energy_dimension
from xdynamics.march.engine import engine
from xdynamics.march.engine_entries import EVALUATIONS, STATES
from xdynamics.march.events.departures import STRAYS
from xdynamics.march.runner import March
from xdynamics.march.timescales import jacobian_at, put_aside
from xdynamics.march.tolerances import Tolerances
from xdynamics.methods.steppers import SIMPLIFIED
from xdynamics.model import Model, Trait
from xdynamics.model.assemblies import assemblies
from xdynamics.model.constraints import beyond_trees, conditions, implied_conditions
from xdynamics.model.linearisation import independent_counts, initial_state, mass_matrices
from xdynamics.model.motion import constants
from xdynamics.model.parts import ENERGETIC, POISSON
from xdynamics.model.reactions import TANGENT, reactions
from xdynamics.model.switches import MOST_SWITCHES, STEPPED_OVER, are_too_many, count_of_switches, owners_of_switches
from xdynamics.model.traits import curved_contacts
from xdynamics.stability import decay_limit, fastest_rate, rough_rate, stiffness
from xdynamics.units import TIME, parse_unit, spell, unit_suffix

Floats = NDArray[np.float64]

LOSS = 0.03  # of a variable: allowed sum of errors of its absolute tolerance in every step
NOISE = 1e3 * EPS  # of the largest of its kind: smaller values are due to rounding
COMPARABLE = 10.0  # ratio of a value's absolute to relative tolerance up to which both count as intended
SHARE = 16  # evaluations of a march for each one that follows an error
FEWEST, SMALL = 240, 48  # evaluations that cost little beside the record, for states up to that size
UNRESOLVED = 100.0  # time scales in one step: no explicit method is stable there, nor follows a growth
FEWEST_ROWS, AT_ONCE = 8, 0.5  # rows of a run, and the part of its motion that such a step makes alone
MOST_FOLLOWED = 1000  # steps; over the rest of a long run growth is extrapolated


class Effect(NamedTuple):
    """The effect of errors of given absolute tolerances.

    Attributes
    ----------
    words : str
        For the record, with the reason if it was not examined; empty where no tolerance is given.
    loose : ndarray of bool
        Variables whose tolerances allow too large errors.
    """

    words: str
    loose: NDArray[np.bool_]


def uncontrolled(
    tolerances: Tolerances, layout: Layout, largest: Floats, accepted: int | NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Return the variables whose given absolute tolerances allow errors that add up to a part of their size.

    Judged from sizes alone, as if errors neither grew nor decayed. A variable that is very small beside others of its
    kind is rounding, of which nothing is lost.

    Parameters
    ----------
    tolerances : Tolerances
    layout : Layout
        Names the variables and their kinds.
    largest : ndarray, shape (…, n), SI
        The largest absolute value of each.
    accepted : int or ndarray, shape (…)
        Steps of each run.
    """
    steps, atols, tops = np.asarray(accepted)[..., None], _given_atols(tolerances, layout), _kind_tops(layout, largest)
    significant = (largest > 0.0) & (largest >= NOISE * tops)
    return significant & (atols > COMPARABLE * tolerances.rtol * largest) & (steps * atols > LOSS * largest)


def error_effect(march: March) -> Effect:
    """Follow errors of given absolute tolerances along a finished run, from its start and its middle."""
    tolerances, layout, scales = march.settings.tolerances, march.layout, march.settings.scales
    none_loose = np.zeros(layout.used.size, bool)
    if not march.settings.adaptive or tolerances is None or not march.witnesses.steps.shape[1]:
        return Effect("", none_loose)
    factors = layout.sizes(scales)
    atols = _given_atols(tolerances, layout) / factors
    if not atols.any():
        return Effect("", none_loose)
    if march.model.delays:
        return Effect("not looked at: forces read delayed values", none_loose)
    end, steps = float(march.now.t), _followed_step_count(march)  # before the march's state is changed below
    with put_aside(march), np.errstate(all="ignore"):
        sizes = _error_scales(march, atols)
        loose = (atols > COMPARABLE * tolerances.rtol * sizes) & (sizes > 0.0)
        if not loose.any():
            return Effect(
                f"not looked at: no atol is above {COMPARABLE:g} rtol times the size of its variable", none_loose
            )
        moves = np.where(loose, np.fmin(atols, _largest_estimates(march)), 0.0)
        share = march.accepted * np.where(loose, moves / np.where(sizes > 0.0, sizes, 1.0), 0.0)
        reason = _obstacle(march, steps) or ("steps had none" if not moves.any() else "")
        followed = None if reason else _follow_growth(march, end, steps, moves, sizes)
    if followed is None:
        reason = reason or "the forces give no finite slopes beside the run"
        words = (
            f"not looked at: {reason}; errors of atol, or as large as estimated, in each of {march.accepted} steps are"
            f" {share.max():.2g} of a variable if they neither grow nor decay"
        )
        return Effect(words, share > LOSS)
    growth, covered, rows = followed
    words = (
        f"{share.max() * growth:.2g} of a variable, by errors of atol, or as large as estimated, in each of"
        f" {march.accepted} steps that come to {growth:.3g} times their size over the run; followed from {rows} of its"
        f" rows over {covered:.0%} of it"
    )
    return Effect(words, share * growth > LOSS)


def passed_over(march: March) -> float:
    """Return how many times the fastest time scale at the start a given first step is; 0 if few, or if stiff decay is damped.

    Such a step is finite where what it starts from is over at once: of ``P/v`` at 1 um/s the first stage alone counts,
    and the speed it leads to has nothing to do with the force.
    """
    settings, plan = march.settings, march.run.plan[0]
    if settings.adaptive or settings.method.solver == SIMPLIFIED or not march.witnesses.steps.shape[1]:
        return 0.0
    first, rates = float(plan.step_size or (march.run.steps[0] if len(march.run.steps) else 0.0)), np.zeros((1, 1))
    with put_aside(march), np.errstate(all="ignore"):
        engine().fastest_rates(march.run, march.witnesses.states([0]), rates)
    product, rows = float(rates[0, 0]) * first, march.witnesses.rows[3:]
    if not UNRESOLVED < product < np.inf or rows.shape[1] < FEWEST_ROWS:
        return 0.0
    first_change, largest = np.abs(rows[:, 1] - rows[:, 0]), np.abs(rows - rows[:, :1]).max(axis=1)
    return product if ((first_change > AT_ONCE * largest) & (largest > 0.0)).any() else 0.0  # else a jump at rest, say


def _given_atols(tolerances: Tolerances, layout: Layout) -> Floats:
    """Return the given absolute tolerances, SI; 0 for those that follow sizes, whose errors are in proportion."""
    atols = tolerances.of_all(layout.used)
    return np.where(np.isnan(atols), 0.0, atols)


def _largest_estimates(march: March) -> Floats:
    """Return the largest estimated error of each variable in any recorded step; nan where none is known.

    Steps are as short as the strictest tolerance requires: other errors are far below what theirs would allow.
    """
    errors = np.abs(march.witnesses.errors)
    if not errors.shape[1] or np.isnan(errors).any():  # kept by a version that did not have them
        return np.full(march.layout.used.size, np.nan)
    largest: Floats = errors.max(axis=1)
    return largest


def _kind_tops(layout: Layout, largest: Floats) -> Floats:
    """Return the largest value of each variable's kind."""
    kinds, tops = layout.kinds, np.zeros_like(largest)
    for kind in np.unique(kinds).tolist():
        tops[..., kinds == kind] = largest[..., kinds == kind].max(axis=-1, keepdims=True)
    return tops


def _error_scales(march: March, atols: Floats) -> Floats:
    """Return the scale of each variable's errors: its largest value, or if that is rounding a natural one.

    Natural is the largest of its kind, for a velocity also that of its coordinates in the fastest time scale. What begins
    as rounding, and grows no more than errors of its tolerance may have made it, counts as rounding throughout.
    """
    run, used, n, rates = march.run, march.layout.used.size, march.layout.coordinates.size, np.zeros((1, 1))
    engine().fastest_rates(run, march.witnesses.states([0]), rates)
    rate = float(rates[0, 0]) if 0.0 < rates[0, 0] < np.inf else 0.0
    largest, born = run.largest.copy(), np.abs(run.y[:used])
    natural = _kind_tops(march.layout, largest)
    natural[n : 2 * n] = np.maximum(natural[n : 2 * n], rate * natural[:n])
    if rate > 0.0:  # the slopes of velocities follow the state
        born[n : 2 * n] = np.maximum(born[n : 2 * n], np.abs(run.y[used : used + n]) / rate)
        born[:n] = np.maximum(born[:n], born[n : 2 * n] / rate)
    rounding = (born < NOISE * natural) & (largest <= march.accepted * atols) & (np.arange(used) < 2 * n)
    return np.where((largest < NOISE * natural) | rounding, natural, largest)


def _obstacle(march: March, steps: int) -> str:
    """Return why errors cannot be followed along a run; empty where they can be."""
    layout, plan = march.layout, march.run.plan[0]
    reasons = {
        "forces change with regimes": len(march.model.regimes) > 1,
        "contacts or friction act": bool(layout.reactions),
        "events set the state": bool(layout.resets),
        "switches in forces are located": int(plan.switches) > 0,
        f"the run has {int(march.now.evaluations)} evaluations alone": steps < 1,
    }
    return ", ".join(reason for reason, applies in reasons.items() if applies)


def _followed_step_count(march: March) -> int:
    """Return the number of steps for which an error is followed from each row."""
    floor = FEWEST if march.layout.used.size <= SMALL else 0
    return min(MOST_FOLLOWED, max(floor, int(march.now.evaluations) // SHARE) // (2 * EVALUATIONS))


def _follow_growth(
    march: March, end: float, steps: int, moves: Floats, sizes: Floats
) -> tuple[float, float, int] | None:
    """Return the mean growth of an error over the run, the part of the run covered, and from how many rows."""
    last = march.witnesses.steps.shape[1] - 1
    start_rows = [0, last // 2] if last > 1 else [0]
    states = march.witnesses.states(start_rows)
    perturbations = np.zeros((1 + len(moves), 2))
    perturbations[0, 0], perturbations[1:, 0], perturbations[1:, 1] = end, moves, np.where(sizes > 0.0, sizes, np.inf)
    results = np.full((2 * len(start_rows), 1 + steps), np.nan)
    engine().growths(march.run, states, perturbations, np.empty((STATES, len(moves))), results)
    span, growths, covered = end - float(states[0, 0]), [], 0.0
    for k in range(len(start_rows)):
        count = int(np.count_nonzero(~np.isnan(results[2 * k])))
        if count > 1:
            times, distances = results[2 * k : 2 * k + 2, :count].tolist()
            growths.append(mean_growth(times, distances, span))
            covered += times[-1] - times[0]
    return (max(growths), min(1.0, covered / span), len(growths)) if growths and span > 0.0 else None


def mean_growth(times: list[float], distances: list[float], span: float) -> float:
    """Return the mean over a span of a ratio followed for a part of it; beyond that, growth continues and decay ends.

    Examples
    --------
    >>> mean_growth([0.0, 1.0, 2.0], [1.0, 2.0, 3.0], 10.0), mean_growth([0.0, 1.0, 2.0], [1.0, 1.0, 1.0], 10.0)
    (6.0, 1.0)
    """
    middle, halves = (times[0] + times[-1]) / 2.0, [[0.0, 0.0], [0.0, 0.0]]
    for t, t1, a, b in zip(times[:-1], times[1:], distances[:-1], distances[1:], strict=True):
        half = halves[t + t1 > 2.0 * middle]
        half[0], half[1] = half[0] + (t1 - t) * (a + b) / 2.0, half[1] + t1 - t
    followed, remaining = times[-1] - times[0], span - (times[-1] - times[0])
    mean = (halves[0][0] + halves[1][0]) / followed
    if remaining <= 0.0:
        return mean
    early, late = (part / length if length > 0.0 else mean for part, length in halves)
    slope = max(0.0, late - early) / (followed / 2.0)
    beyond = late + slope * (followed / 4.0 + remaining / 2.0)
    return (mean * followed + beyond * remaining) / span


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
        atol, unit, factor = (
            tolerances.atol_of(name) or 0.0,
            model.elements.units[name].text,
            float(model.elements.units[name].factor),
        )
        unit = "" if unit == "1" else f" {unit}"
        size = largest * scales.si_factor(model.elements.dimensions[name])
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


STRAYED_REMEDY = "give a smaller rtol or step, a method of higher order, or write what bounces as [contacts]"


def _reset_doubts(march: March) -> Iterator[str]:
    """Name the resets that turned a motion back which errors of steps had carried through zero: it may never return."""
    if names := resets_passed_through(march, STRAYS):
        yield (
            f"event {' and '.join(names)} set the motion back when errors of steps had carried it through zero by more than"
            f" time tolerances allow, and it need not come back from there; {STRAYED_REMEDY}"
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
    if not model.elements.mass_is_full:
        return
    moving = {"t", *march.layout.used, *model.elements.drives}
    varies = any(model.elements.reads(entry) & moving for entry in model.elements.statement.mass_entries.values())
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
    """Return which switches declared smooth were stepped over, how often, and the remedy."""
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
    if not model.elements.contacts:
        return
    values = dict(constants(model)) | initial_state(model)
    metre = parse_unit("m").dimension
    lengths = [name for name, entry in model.elements.statement.coordinates.items() if entry.unit.dimension == metre]
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
    contacts = model.elements.contacts | model.assemblies
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
    """Report conditions that are implied by others except for a remainder too small to be enforced."""
    implied = implied_conditions(model)
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
    """Report bodies whose endless bounces ended in rest, by forces for which the method loses its order."""
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

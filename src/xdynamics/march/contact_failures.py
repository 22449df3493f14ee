"""Reasons why a contact problem had no solution, in words: of contacts, and of contacts of many links."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING

from xdynamics.expressions import dimension_of, free_names
from xdynamics.expressions.evaluation import evaluate
from xdynamics.march.assembly import broad_phase
from xdynamics.march.assembly.broad_phase import CULPRIT, CULPRIT_LINK, FAULT
from xdynamics.march.contacts.active_set import FLAT
from xdynamics.march.contacts.delassus import ABSENT, SLIDING
from xdynamics.march.energy_gains import impact_energy_dimension
from xdynamics.march.outcomes import CONTACT_PENETRATED
from xdynamics.march.run import APART, BOUND, FIGURE, GUARD, OWNER, SHIFTED, SLOWED, WORK
from xdynamics.methods import METHODS
from xdynamics.model import Model
from xdynamics.model.assemblies import assemblies
from xdynamics.model.detectors import GAP, GRIP, PULL, SLIP, function_dimension
from xdynamics.model.motion import constants
from xdynamics.model.parts import ENERGETIC
from xdynamics.model.reactions import NORMAL, Reaction, rate_dimension, reactions
from xdynamics.units import NONE, Dimension

if TYPE_CHECKING:
    from xdynamics.march.runner import March

PAINLEVE = (
    "pressing harder would pull it in, so that no acceleration goes with it, or more than one (Painleve's paradox)"
)
_REMEDY = "; a smaller coefficient of friction, or a compliant contact force, has an answer"


def contact_dispute(march: March) -> str:
    """Name the contact without a solution, from the march's last state."""
    all_reactions, run = reactions(march.model), march.run
    if int(march.now.status) == CONTACT_PENETRATED:
        return _penetrated(march, run.links["gap"].tolist())
    if why := undefined_contact(march):
        return why
    for k, reaction in enumerate(all_reactions):
        touch = run.touches[k]
        if touch.near and not run.delassus[k, k] > FLAT * touch.steepest:
            return (
                f"the gap of contact '{reaction.owner}' closes where its gradient vanishes, which is its normal; write"
                " a gap that passes zero with a slope"
            )
    for reaction, size in zip(all_reactions, run.links["coefficient"].tolist(), strict=True):
        if reaction.sort == NORMAL and not 0.0 <= size <= 1.0:
            return f"the restitution of contact '{reaction.owner}' is {size:.6g}, and needs to be from 0 to 1"
    for reaction, size, static in zip(
        all_reactions, run.links["coefficient"].tolist(), run.links["most"].tolist(), strict=True
    ):
        if reaction.sort != NORMAL and not size >= 0.0:
            return f"the friction of '{reaction.owner}' is {size:.6g} while it slips, and needs to be non-negative"
        if reaction.sort != NORMAL and not static >= size:
            return (
                f"the friction of '{reaction.owner}' sticks with {static:.6g} and slips with {size:.6g}: static is at"
                " least kinetic"
            )
    if why := _struck_together(march, run.links["rate"].tolist()):
        return why
    for k, reaction in enumerate(all_reactions):
        if run.touches[k].part == SLIDING and not _pressed_apart(march, k):
            return painleve_message(reaction, float(run.touches[k].coefficient))
    owners = ", ".join(
        f"'{reaction.owner}'"
        for reaction, touch in zip(all_reactions, run.touches, strict=True)
        if touch.part != ABSENT
    )
    return f"the forces of {owners} together are not determined: they hold the same motion twice, or cannot hold it"


def _struck_together(march: March, rates: list[float]) -> str:
    """Report several contacts that touch at once, which the energetic coefficient leaves undetermined; else nothing."""
    touches, all_reactions = march.run.touches, reactions(march.model)
    near = [k for k, reaction in enumerate(all_reactions) if reaction.sort == NORMAL and touches[k].near]
    approach = any(rates[k] < -touches[k].slack for k in near)
    if not approach or any(march.model.elements.contacts[all_reactions[k].owner].law != ENERGETIC for k in near):
        return ""
    owners = ", ".join(f"'{all_reactions[k].owner}'" for k in near)
    if len(near) == 1:
        return f"the impact of contact {owners} does not end: friction holds it as fast as it is pressed"
    return (
        f"contacts {owners} touch at once and act on each other, and law = '{ENERGETIC}' is for one contact at a time:"
        " how several share an impulse depends on their stiffnesses; choose law = 'poisson' or 'sequential'"
    )


def undefined_contact(march: March) -> str:
    """Name the contact or friction element that is not finite in the proposed state, or return nothing."""
    layout, values = march.layout, dict(constants(march.model, march.settings.scales))
    values |= dict(zip(layout.record, march.run.z.tolist(), strict=True)) | {"t": float(march.now.t)}
    for reaction in reactions(march.model):
        trees = [
            reaction.gap,
            reaction.rate,
            reaction.bias,
            reaction.size,
            reaction.sticking_limit,
            *reaction.row.values(),
        ]
        evaluable = [tree for tree in trees if not free_names(tree) - set(values)]
        if not all(isfinite(evaluate(tree, values)) for tree in evaluable):
            kind = "gap of contact" if reaction.sort == NORMAL else "slip or friction of"
            return (
                f"the {kind} '{reaction.owner}', or a derivative of it, is not finite there; a square root, hypot or norm"
                " has no derivative where it is 0: of a bore, (c**2 - x**2 - y**2)/(2*c) has one everywhere"
            )
    return ""


def painleve_message(reaction: Reaction, coefficient: float) -> str:
    """Return the message that friction is too large for a unique solution."""
    return f"friction of contact '{reaction.owner}', with the coefficient {coefficient:.6g}: {PAINLEVE}{_REMEDY}"


def _pressed_apart(march: March, k: int) -> bool:
    """Whether the normal force of a sliding contact, its friction included, pushes the bodies apart."""
    touch, delassus = march.run.touches[k], march.run.delassus
    normal = int(march.run.reactions[k].normal)
    return bool(delassus[normal, normal] - touch.way * touch.coefficient * delassus[normal, k] > 0.0)


def balance_inconsistency(march: March) -> str:
    """Name the group of events whose record disagrees with its effect, with the figures."""
    run, model, all_reactions = march.run, march.model, reactions(march.model)
    guard, owner = int(run.balance[GUARD]), int(run.balance[OWNER])
    involved = [
        reaction.owner
        for reaction, touch in zip(all_reactions, run.touches, strict=True)
        if touch.total != 0.0 or touch.hit
    ]
    group = " and ".join(f"'{reaction}'" for reaction in dict.fromkeys(involved))
    if guard == SHIFTED:
        name = march.layout.coordinates[owner]
        dimension, finding = model.elements.dimensions[name], f"contacts that come to rest move '{name}' by"
    elif guard in (APART, SLOWED):
        dimension = rate_dimension(model, all_reactions[owner]) * (
            model.time_unit.dimension if guard == APART else NONE
        )
        verb = "acts where its gap is" if guard == APART else "loses, without an impulse, a rate of"
        finding = f"'{all_reactions[owner].owner}' {verb}"
    else:
        dimension = impact_energy_dimension(model)
        finding = (
            "kinetic energy changes by more than the work of the recorded impulses, by"
            if guard == WORK
            else "the recorded losses differ from what the impulses took, by"
        )
    scale = march.settings.scales.si_factor(dimension)
    figure, bound = run.balance[FIGURE] * scale, run.balance[BOUND] * scale
    return (
        f"in the group of events of {group or 'contacts'} {finding} {figure:.6g} {dimension}, and tolerances and"
        f" rounding allow {bound:.3g}: the run contradicts itself, which is no fault of the model; please report it"
    )


def law_violation(march: March) -> str:
    """Return which contact pulls, exceeds its friction, slips against it, or is penetrated."""
    run = march.run
    detector = march.layout.watched[int(run.balance[OWNER])]
    dimension = function_dimension(march.model, detector)
    figure = abs(float(run.balance[FIGURE])) * march.settings.scales.si_factor(dimension)
    does = {
        PULL: "pulls with",
        GRIP: "holds more than friction can, by",
        SLIP: "slips against the direction of its friction, with",
        GAP: "is penetrated by",
    }[detector.role]
    return (
        f"contact '{detector.name}' {does} {figure:.6g} {dimension}, far more than rounding and the location of events"
        " leave: the run missed when that began; please report it with the model. Regimes or a shorter step may pass here"
    )


def _penetrated(march: March, gaps: list[float]) -> str:
    gap_texts = []
    for reaction, gap in zip(reactions(march.model), gaps, strict=True):
        dimension = rate_dimension(march.model, reaction) * march.model.time_unit.dimension
        if reaction.sort == NORMAL and gap < 0.0:
            gap_texts.append(
                f"the gap of contact '{reaction.owner}' is {gap * march.settings.scales.si_factor(dimension):.6g} {dimension}"
            )
    return f"{', '.join(gap_texts)}: one body is inside the other; begin, or set the state, where gaps are not negative"


OVER_IMPACTS = "moreau_jean"  # the method for heaps


def assembly_dispute(march: March) -> str:
    """Name the link that ended a march, from the march's last state; nothing if none did."""
    run, model = march.run, march.model
    if not model.assemblies or run.counters[FAULT] == 0:
        return ""
    assembly, name = assemblies(model)[int(run.counters[CULPRIT])], _link(march)
    gap = dimension_of(assembly.contact.gap, model.elements.dimensions)
    match int(run.counters[FAULT]):
        case broad_phase.OVERLAP:
            size = run.spans[broad_phase.DEPTH] * march.settings.scales.si_factor(gap)
            if march.now.rows > 1:
                return (
                    f"the gap of {name} is {size:.3g} {gap}, more than the location of impacts leaves: the step jumped"
                    " over an impact; take a smaller step"
                )
            return f"the gap of {name} is {size:.6g} {gap} at the start: one body is inside the other; begin apart"
        case broad_phase.RUBBED:
            return (
                f"the friction of {name} is {run.spans[broad_phase.DEPTH]:.6g}, and needs to be non-negative and at most"
                " 'static'"
            )
        case broad_phase.BOUNCED:
            return f"the restitution of {name} is {run.spans[broad_phase.DEPTH]:.6g}, and needs to be from 0 to 1"
        case broad_phase.CROWDED:
            return (
                f"more than {run.candidates.shape[0]} links are so near each other that they may meet in one step, or"
                f" more than {run.touching.shape[0]} do at one time; take a smaller step"
            )
        case broad_phase.SHARED:
            return (
                f"{name} and another one touch at once and act on each other, and law = 'energetic' is for one link at a"
                " time: how several share an impulse depends on their stiffnesses; choose law = 'poisson' or 'sequential'"
            )
        case broad_phase.UNSOLVED:
            rate = gap / model.time_unit.dimension
            left = run.spans[broad_phase.RESIDUAL] * march.settings.scales.si_factor(rate)
            if run.plan[0].steps_over > 0:
                return (
                    f"no impulses were found for the {run.counters[broad_phase.TOGETHER]} links that are closed in one"
                    f" step: with the best of them bodies still move into or along each other by {left:.3g} {rate}, and"
                    " 1e-6 of the largest speed is allowed; take a smaller step, less friction, masses that differ less, or"
                    " fewer bodies"
                )
            return (
                f"no impulses were found for the {run.counters[broad_phase.TOGETHER]} links that are struck together, {name}"
                f" the first: with the best of them bodies still move into or along each other by {left:.3g} {rate}, which"
                f" is more than rounding; law = 'sequential' takes one after the other{_or_over_impacts(march)}"
            )
    return _of_closed(march, gap)


def marches_over_impacts(model: Model) -> bool:
    """Whether Moreau's method takes a model: steps over impacts bring heaps to rest whose impacts cannot all be located."""
    return not METHODS[OVER_IMPACTS].refusals(model)


def _or_over_impacts(march: March) -> str:
    """Name Moreau's method as the remedy where a located heap ends, if it takes the model and did not make the run."""
    if march.settings.method.name == OVER_IMPACTS or not marches_over_impacts(march.model):
        return ""
    return f"; or take method = '{OVER_IMPACTS}', which is for heaps: it steps over impacts (xdynamics help simulation)"


def _link(march: March) -> str:
    """Name the link to which it happened."""
    assembly = assemblies(march.model)[int(march.run.counters[CULPRIT])]
    return f"contact '{assembly.name}' of {assembly.label(int(march.run.counters[CULPRIT_LINK]))}"


def _of_closed(march: March, gap: Dimension) -> str:
    """Describe a fault in forces, gaps or energy of closed links."""
    run, count = march.run, int(march.run.closed[0])
    match int(run.counters[FAULT]):
        case broad_phase.STRAINED:
            return (
                f"no forces were found that hold the {count or int(run.counters[broad_phase.TOGETHER])} links that touch:"
                f" with the best of them bodies still accelerate into or along each other by"
                f" {run.spans[broad_phase.STRAIN]:.1e} of what the forces give, and 1e-9 is allowed; bodies may be wedged so"
                " that friction has no answer, or are too many to solve for: give less friction, masses that differ less,"
                f" or fewer bodies{_or_over_impacts(march)}"
            )
        case broad_phase.HASTY:
            return (
                f"{run.counters[broad_phase.HASTE]} events of links followed each other within what their times are located"
                " to, and no motion came of them: which links hold and which slide cannot be decided here; start a little"
                f" later or elsewhere, or change friction a little{_or_over_impacts(march)}"
            )
        case broad_phase.UNDECIDED:
            return (
                f"{run.counters[broad_phase.IDLE]} times in a row, each soon after the last, the forces of {count} links that"
                f" touch seemed to let go of one, now {_link(march)}, and with all of them together none lifted, slid or"
                " stuck: they hold more than needs holding, and which forces hold it cannot be decided here; start a little"
                f" elsewhere, or change friction or a radius a little{_or_over_impacts(march)}"
            )
        case broad_phase.SHIFTED:
            far = run.spans[broad_phase.ASTRAY] * march.settings.scales.si_factor(gap)
            return (
                f"one of {count} closed links has a gap that is {far:.3g} {gap} farther from zero than rounding and the"
                " location of events leave: positions could not be put back on all of them; take a smaller step"
            )
    lost = run.spans[broad_phase.FIGURE] * march.settings.scales.si_factor(impact_energy_dimension(march.model))
    return (
        f"kinetic energy differs by {lost:.3g} {impact_energy_dimension(march.model)} from what impulses of the recorded"
        " impacts changed, which is more than rounding; this is a fault of the program, please report it"
    )

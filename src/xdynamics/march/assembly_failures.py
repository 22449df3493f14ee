"""Why contacts of many links ended a march, in words."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xdynamics.expressions import dimension_of
from xdynamics.march.assembly import broad_phase
from xdynamics.march.assembly.broad_phase import CULPRIT, CULPRIT_LINK, FAULT
from xdynamics.march.energy_gains import impact_energy_dimension
from xdynamics.march.run import STEP_LINKS
from xdynamics.methods import METHODS
from xdynamics.model import Model
from xdynamics.model.assemblies import assemblies
from xdynamics.units import Dimension

if TYPE_CHECKING:
    from xdynamics.march.runner import March

OVER_IMPACTS = "moreau_jean"  # the method for heaps


def assembly_dispute(march: March) -> str:
    """Name the link that ended a march, from the march's last state; nothing if none did."""
    run, model = march.run, march.model
    if not model.assemblies or run.counters[FAULT] == 0:
        return ""
    assembly, name = assemblies(model)[int(run.counters[CULPRIT])], _link(march)
    gap = dimension_of(assembly.contact.gap, model.dimensions)
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
            if run.plan[0].links == STEP_LINKS:
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
    return f"; or take method = '{OVER_IMPACTS}', which is for heaps: it steps over impacts (xdynamics help marching)"


def _link(march: March) -> str:
    """Name the link to which it happened."""
    assembly = assemblies(march.model)[int(march.run.counters[CULPRIT])]
    return f"contact '{assembly.name}' of {assembly.label(int(march.run.counters[CULPRIT_LINK]))}"


def _of_closed(march: March, gap: Dimension) -> str:
    """Say what is wrong with forces, gaps or energy of closed links."""
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

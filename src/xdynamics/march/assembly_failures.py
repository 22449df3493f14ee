"""Why contacts of many links ended a march, in words."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics.expressions import dimension_of
from xdynamics.march.assembly import broad_phase
from xdynamics.march.assembly.broad_phase import CULPRIT, CULPRIT_LINK, FAULT
from xdynamics.model.assemblies import assemblies

if TYPE_CHECKING:
    from xdynamics.march.runner import March


def assembly_dispute(march: March) -> str:
    """Name the link that ended a march, from the march's last state; nothing if none did."""
    run, model = march.run, march.model
    if not model.assemblies or run.tallies[FAULT] == 0:
        return ""
    assembly, link = assemblies(model)[int(run.tallies[CULPRIT])], int(run.tallies[CULPRIT_LINK])
    name = f"contact '{assembly.name}' of {_bodies(assembly, link)}"
    gap = dimension_of(assembly.contact.gap, model.dimensions)
    match int(run.tallies[FAULT]):
        case broad_phase.OVERLAP:
            size = run.spans[broad_phase.DEPTH] * march.settings.scales.of(gap)
            return f"the gap of {name} is {size:.6g} {gap} at the start: one body is inside the other; begin apart"
        case broad_phase.BOUNCED:
            return f"the restitution of {name} is {run.spans[broad_phase.DEPTH]:.6g}, and needs to be from 0 to 1"
        case broad_phase.CROWDED:
            return (
                f"more than {run.candidates.shape[0]} links are so near each other that they may meet in one step, or"
                f" more than {run.touching.shape[0]} do at one time; take a smaller step"
            )
        case broad_phase.UNSOLVED:
            rate = gap / model.time_unit.dimension
            left = run.spans[broad_phase.RESIDUAL] * march.settings.scales.of(rate)
            return (
                f"the impulses of {run.tallies[broad_phase.TOGETHER]} links that are struck together, {name} the first,"
                f" were not found: their equations are left with a residual of {left:.3g} {rate}, which is more than"
                " rounding; law = 'sequential' takes one after the other"
            )
    return (
        f"{name} comes to rest: what presses it takes a force all the time, and contacts of more links than are written"
        " out have impacts alone; a stiff force with a potential of the gap holds bodies at rest"
    )


def _bodies(assembly: Any, link: int) -> str:
    """Name the elements of a link as people write them."""
    shapes, one = assembly.model.shapes, np.array([link])
    relation, numbers = assembly.relation, assembly.numbers(one)
    words = []
    if relation is not None:
        first, second = assembly.ends(one)
        words.append(
            f"{shapes.extent(relation.source).label(int(first[0]))} and"
            f" {shapes.extent(relation.target).label(int(second[0]))}"
        )
    words += [shapes.extent(dim).label(int(n[0])) for dim, n in numbers.items() if dim not in shapes.relations]
    dims = relation.source if relation is not None else " ".join(assembly.dims)
    return f"{dims} {', '.join(words)}"

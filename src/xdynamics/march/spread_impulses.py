"""States inside steps over impacts of many links: each impulse of the step is spread over it, as a force that is constant.

So recorded forces act, which are means over steps, and links are solved for once, not for each time inside.
"""

from __future__ import annotations

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.assembly.broad_phase import FAULT, SPREAD, TOGETHER
from xdynamics.march.run import BEGUN, STEP_LINKS, Columns, Run
from xdynamics.march.trial_step import propose_step_apart


@jit_separate
def steps_over_links(run: Run) -> bool:
    """Whether a march steps over the impacts of many links."""
    return bool(run.plan[0].assemblies > 0 and run.plan[0].links == STEP_LINKS)


@jit_separate
def part_with_impulses(run: Run, steps: Columns, k: int, s: float) -> bool:
    """Make the part `s` of a step, of which `steps` has start, end, size, time and run; whether its impulses were found."""
    run.trial[0].rest, run.kept[0].since = 0.0, BEGUN
    if k == 0 or s == 1.0 or steps[0, k] != steps[0, k - 1] or steps[4, k] != steps[4, k - 1]:
        run.spans[SPREAD] = 0.0
        propose_step_apart(run, steps[1, k], steps[2, k])
        keep_changes(run)
    if s < 1.0:
        run.spans[SPREAD] = s
        propose_step_apart(run, steps[3, k], s * steps[2, k])
        run.spans[SPREAD] = 0.0
    return bool(run.counters[FAULT] == 0)


@jit_separate
def keep_changes(run: Run) -> None:
    """Keep what impulses of the step that was just made changed velocities by."""
    n = run.plan[0].coordinates
    for i in range(n):
        run.whole[i] = run.z[n + i] - run.half[n + i] if run.counters[TOGETHER] > 0 else 0.0

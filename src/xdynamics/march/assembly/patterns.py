"""The patterns of a run as a march begins or goes on."""

from __future__ import annotations

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.assembly.broad_phase import BEGUN, FAULT, MEETS, READY, SHARE
from xdynamics.march.assembly.closed_links import list_ends
from xdynamics.march.assembly.links import pattern_at
from xdynamics.march.calls import enclosed_by
from xdynamics.march.run import ALL, ENCLOSE, Run


@jit_separate
def prepare_patterns(run: Run) -> None:
    """Give patterns the parameters of the run, list what closed links are, and forget all boxes."""
    run.counters[BEGUN], run.counters[FAULT], run.counters[MEETS], run.spans[SHARE] = 0, 0, 0, 1.0
    for k in range(run.handed.shape[0]):
        pattern = pattern_at(run.patterns[run.handed[k, 0]])
        pattern.p[run.handed[k, 1]] = run.p[run.handed[k, 2]]
    for c in range(run.patterns.shape[0]):
        pattern = pattern_at(run.patterns[c])
        enclosed_by(pattern.functions[ENCLOSE], pattern, pattern.y, pattern.y, 0, pattern.parts[0], ALL)
    list_ends(run)
    run.counters[READY] = 1

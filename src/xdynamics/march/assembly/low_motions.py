"""Motions of links that are as low as bounces that may be skipped, and the sizes by which that is judged."""

from __future__ import annotations

from math import sqrt

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.assembly.broad_phase import ROWS
from xdynamics.march.assembly.links import ASSEMBLY
from xdynamics.march.assembly.narrow_phase import resolution_of
from xdynamics.march.assembly.touching import BIAS, BOUNCE, CANDIDATE, SLACK, SLIP_BIAS
from xdynamics.march.run import Run

LOW = 1e-9  # of the height of the highest bounce: those that may be skipped, unless the model says how low they are


@jit_separate
def link_resolution(run: Run, a: int) -> float:
    """The time within which what happens to a link is located."""
    return resolution_of(run, int(run.touching[a, CANDIDATE]), 0.0)


@jit_separate
def falling(run: Run, a: int) -> float:
    """The size of the terms of a link's acceleration without forces of links."""
    return size_along(run, int(run.counters[ROWS]) * a, run.touching[a, BIAS])


@jit_separate
def slip_falling(run: Run, a: int) -> float:
    """The size of the terms of the acceleration of a link's slip."""
    return size_along(run, 2 * a + 1, run.touching[a, SLIP_BIAS])


@jit_separate
def size_along(run: Run, row: int, bias: float) -> float:
    """The size of the terms of an acceleration along a row."""
    accelerations, size = run.plan[0].used, abs(bias)
    for i in range(run.normals.shape[1]):
        size += abs(run.normals[row, i] * run.z[accelerations + run.coordinate_indices[row, i]])
    return size


@jit_separate
def is_low(run: Run, a: int, rate: float, fall: float) -> bool:
    """Whether the next bounce of a link is as good as none."""
    if rate <= max(run.touching[a, SLACK], 2.0 * fall * link_resolution(run, a)):
        return True
    if run.touching[a, BOUNCE] >= 1.0:  # bounces never end
        return False
    return is_short(run, a, rate, fall)


@jit_separate
def is_short(run: Run, a: int, rate: float, fall: float) -> bool:
    """Whether a motion that begins with a rate is as low as a bounce of a link that may be skipped."""
    c = run.candidates[int(run.touching[a, CANDIDATE]), ASSEMBLY]
    height = run.assemblies[c].rest_height
    return rate * rate <= (2.0 * fall * height if height >= 0.0 else LOW * run.greatest[1 + c] * run.greatest[1 + c])


@jit_separate
def bounce_time(run: Run, a: int) -> float:
    """How long a bounce of a link lasts that may just be skipped."""
    c, fall = run.candidates[int(run.touching[a, CANDIDATE]), ASSEMBLY], falling(run, a)
    height = run.assemblies[c].rest_height
    speed = sqrt(2.0 * fall * height) if height >= 0.0 else sqrt(LOW) * run.greatest[1 + c]
    return 2.0 * speed / fall if fall > 0.0 else 0.0


@jit_separate
def passes_soon(run: Run, a: int, slip: float, brake: float) -> bool:
    """Whether a slip that is braked goes no farther, and lasts no longer, than a bounce of its link that may be skipped."""
    fall = falling(run, a)
    return slip <= brake * bounce_time(run, a) and is_short(run, a, slip * sqrt(fall / brake), fall)

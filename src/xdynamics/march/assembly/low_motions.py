"""Motions of links that are as low as bounces that may be skipped, and the sizes by which that is judged."""

from __future__ import annotations

from xdynamics.kernels.compiling import shared
from xdynamics.march.assembly.broad_phase import BURST, IDLE, ROWS
from xdynamics.march.assembly.links import ASSEMBLY
from xdynamics.march.assembly.narrow_phase import resolution_of
from xdynamics.march.assembly.touching import BIAS, BOUNCE, CANDIDATE, RUBS, SLACK, SLIP_BIAS, rate_of, slip_of
from xdynamics.march.run import Run

LOW = 1e-9  # of the height of the highest bounce: those that may be skipped, unless the model says how low they are
LONG_BURST = 4  # landings in a row, each soon after the last, after which motions that are low are skipped together


@shared
def resolution(run: Run, a: int) -> float:
    """The time within which what happens to a link is located."""
    return resolution_of(run, int(run.touching[a, CANDIDATE]), 0.0)


@shared
def falling(run: Run, a: int) -> float:
    """The size of the terms of a link's acceleration without forces of links."""
    return size_along(run, int(run.tallies[ROWS]) * a, run.touching[a, BIAS])


@shared
def slip_falling(run: Run, a: int) -> float:
    """The size of the terms of the acceleration of a link's slip."""
    return size_along(run, 2 * a + 1, run.touching[a, SLIP_BIAS])


@shared
def size_along(run: Run, row: int, bias: float) -> float:
    """The size of the terms of an acceleration along a row."""
    accelerations, size = run.plan[0].used, abs(bias)
    for i in range(run.normals.shape[1]):
        size += abs(run.normals[row, i] * run.z[accelerations + run.reads[row, i]])
    return size


@shared
def is_low(run: Run, a: int, rate: float, fall: float) -> bool:
    """Whether the next bounce of a link is as good as none."""
    if rate <= max(run.touching[a, SLACK], 2.0 * fall * resolution(run, a)):
        return True
    if run.touching[a, BOUNCE] >= 1.0:  # bounces never end
        return False
    return is_short(run, a, rate, fall)


@shared
def is_short(run: Run, a: int, rate: float, fall: float) -> bool:
    """Whether a motion that begins with a rate is as low as a bounce of a link that may be skipped."""
    c = run.candidates[int(run.touching[a, CANDIDATE]), ASSEMBLY]
    height = run.assemblies[c].rest_height
    return rate * rate <= (2.0 * fall * height if height >= 0.0 else LOW * run.greatest[1 + c] * run.greatest[1 + c])


@shared
def is_in_burst(run: Run) -> bool:
    """Whether events follow one another soon, and the last changed something: else what was held lets go again at once."""
    return bool(run.tallies[BURST] >= LONG_BURST and run.tallies[IDLE] == 0)


@shared
def is_slow(run: Run, a: int) -> bool:
    """Whether in a burst of events a link opens and slips no faster than bounces begin that may be skipped."""
    if not is_in_burst(run):
        return False
    rate, fall = rate_of(run, a), falling(run, a)
    opens = abs(rate) > run.touching[a, SLACK] + fall * resolution(run, a)
    if opens and (run.touching[a, BOUNCE] >= 1.0 or not is_short(run, a, rate, fall)):
        return False
    return run.touching[a, RUBS] == 0.0 or is_short(run, a, slip_of(run, a), fall)

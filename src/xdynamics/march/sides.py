"""On which side of each switch hidden in forces the march is: taken at the start, kept along steps, changed at events."""

from __future__ import annotations

import numpy as np

from xdynamics.kernels.compiling import shared
from xdynamics.kernels.law import DETECT, SLOPES
from xdynamics.kernels.program import T
from xdynamics.march.evaluating import evaluate
from xdynamics.march.handle import called
from xdynamics.march.isolation import CROSSED, FORCED, renew_constants, sign
from xdynamics.march.run import Run
from xdynamics.model.detectors import KINK, SWITCH


@shared
def take_sides(run: Run) -> None:
    """Look on which side of each switch the march is; at one, on which it is going to be."""
    zero = False
    run.at[T] = run.now[0].t
    called(run.law[DETECT], run, run.y, run.g, 0)
    for i in range(run.detectors.shape[0]):
        detector = run.detectors[i]
        if detector.role in (SWITCH, KINK):
            zero = zero or run.g[i] == 0.0
            choose_side(run, i, sign(run.g[i]) if run.g[i] != 0.0 else detector.at_zero)
    if zero:
        evaluate(run, run.now[0].t, run.y)
        called(run.law[SLOPES], run, run.y, run.slopes, 0)
        for i in range(run.detectors.shape[0]):
            if run.detectors[i].role in (SWITCH, KINK) and run.g[i] == 0.0 and run.slopes[i] != 0.0:
                choose_side(run, i, sign(run.slopes[i]))
    renew_constants(run)


@shared
def choose_side(run: Run, i: int, where: int) -> None:
    """Have forces be those of one side of a switch, which is not left unseen."""
    run.modes[run.detectors[i].to], run.watches[i].guard = float(where), where


@shared
def keep_sides(run: Run) -> bool:
    """Have the trial's state, behind an event, on its sides of all switches; whether one is another than before."""
    changed = False
    run.at[T] = run.trial[0].t
    called(run.law[DETECT], run, run.z, run.slopes, 0)
    for i in range(run.detectors.shape[0]):
        detector, watch = run.detectors[i], run.watches[i]
        if detector.role in (SWITCH, KINK):
            now = sign(run.slopes[i])
            known = np.int64(run.modes[detector.to])
            if watch.hit in (CROSSED, FORCED):
                now = -watch.armed
            if now != 0 and now != known:
                choose_side(run, i, now)
                changed = True
    if changed:
        renew_constants(run)
    return changed


@shared
def slides(run: Run) -> bool:
    """Whether the motion is driven back to a switch of a force that jumps there, as it was on the side before."""
    found = False
    run.at[T] = run.trial[0].t
    called(run.law[SLOPES], run, run.z, run.slopes, 0)
    for i in range(run.detectors.shape[0]):
        detector, watch = run.detectors[i], run.watches[i]
        if detector.role == SWITCH and watch.hit in (CROSSED, FORCED):
            found = found or run.slopes[i] * -watch.armed < 0.0
    return found

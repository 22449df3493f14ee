"""Motion along switches that are not located: passages to and fro in almost every step.

Switches are not located where there are too many. Motion may rest on a switch at which a force jumps: each passage is
then within the resolution of the march.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import Node
from xdynamics.kernels import Layout
from xdynamics.march.outcomes import RUNNING, SLIDING_MODE
from xdynamics.march.run import Run
from xdynamics.march.settings import Settings
from xdynamics.march.sliding import values_in_rows
from xdynamics.model import Model
from xdynamics.model.detectors import SWITCH
from xdynamics.model.switches import Switch, are_too_many, jumping_switches
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.units import TIME

NOWHERE = -1
PASSAGES = 32  # the last ones of a run, which all have to be of one switch and close together
CLOSE = 100.0  # time tolerances from one to the next
SMALL = 64.0  # uncertainties of the switch's function between them


def chattering(detectors: NDArray[Any], events: NDArray[Any]) -> int:
    """Return the detector of the switch that the last events passed to and fro, or `NOWHERE`.

    Between two passages its function stays within a multiple of its rounding, by its rate at the second and the time
    from the first, or the time itself is a small multiple of its tolerance: what happens there is made by rounding.
    """
    last = events[-PASSAGES:]
    if len(last) < PASSAGES or (last["detector"] != last["detector"][0]).any():
        return NOWHERE
    detector = detectors[last["detector"][0]]
    if detector["role"] != SWITCH:
        return NOWHERE
    pauses, rates = np.diff(last["time"]), np.abs(last["slope"][1:])
    near = (pauses <= CLOSE * detector["tolerance"]) | (rates * pauses / 4.0 <= SMALL * last["uncertainty"][1:])
    return int(last["detector"][0]) if near.all() else NOWHERE


Floats = NDArray[np.float64]

STEPS = 64  # the last ones
FEWEST = 3  # of them that lead across a switch or away from it: a motion that arrives once does so once
OFTEN = 0.75  # of them, from which the motion is driven back
NEAR = 1e-5  # how far before and beyond a switch speeds are compared, of the way to it
SLOWER, SLOWEST = 0.5, 1e-3  # speeds there, at least, of that in the row
FIRST = 2 * STEPS  # rows at the first look
PAUSES, LOOKED_AT = 1 << 12, 1 << 21  # rows between two looks, and numbers of a state in them, at most
RETAINED = "passages"  # its name in the memory of a march


def unlocated(model: Model) -> tuple[Switch, ...]:
    """Return the switches at which a force jumps, if there are more than are located."""
    return jumping_switches(model) if are_too_many(model) else ()


def may_slide(model: Model, settings: Settings) -> bool:
    """Whether a march is inspected at intervals, because it may slide along an unlocated switch without end."""
    return settings.adaptive and bool(unlocated(model))


class Passages:
    """The last rows of a march at fixed numbers of rows, so that a run ends where its copies end.

    Parameters
    ----------
    model : Model
    settings : Settings
    layout : Layout
    """

    def __init__(self, model: Model, settings: Settings, layout: Layout) -> None:
        self.model, self.layout, self.scales = model, layout, settings.scales
        self.is_watched = may_slide(model, settings) and not model.delays
        self.pause = max(FIRST, min(PAUSES, LOOKED_AT // layout.used.size))
        self.last: Floats = np.empty((2 + layout.used.size, 0))  # time, step and state of the last rows

    @cached_property
    def _functions(self) -> list[Node]:
        """The functions of the switches, with definitions expanded."""
        return [self.model.elements.expanded(switch.function) for switch in unlocated(self.model)]

    def shortened(self, pause: int, rows: int) -> int:
        """Return how many more rows to march, besides an initial one: none beyond the next look."""
        return min(pause, self._next(rows) - max(1, rows)) if self.is_watched else pause

    def _next(self, rows: int) -> int:
        """Return the number of rows at the next look: powers of two first, so that short runs stay short."""
        return min(max(FIRST, 1 << rows.bit_length()), (rows // self.pause + 1) * self.pause)

    def memory(self) -> dict[str, NDArray[Any]]:
        """Return the arrays that a continued march needs, by name."""
        return {RETAINED: self.last} if self.last.size else {}

    def go_on_from(self, memory: Mapping[str, NDArray[Any]]) -> None:
        """Continue from a memory; older ones have none."""
        self.last = memory.get(RETAINED, self.last)

    def sliding(self, run: Run, rows: Floats, rows_before: int) -> Switch | None:
        """End a march that passes a switch in almost every step: it would fill any memory on its way along the switch.

        Parameters
        ----------
        run : Run
        rows : ndarray, shape (m, k)
            Its new rows, of which time, step size and state come first.
        rows_before : int
            Number of its rows before them.

        Returns
        -------
        Switch or None
            The switch, if there is one.
        """
        if not self.is_watched:
            return None
        new = rows[: len(self.last), -STEPS - 1 :]
        self.last = np.hstack([self.last[:, new.shape[1] - STEPS - 1 :], new]) if new.shape[1] <= STEPS else new.copy()
        reached = rows_before + rows.shape[1] >= self._next(rows_before)
        if run.now[0].status != RUNNING or not reached or self.last.shape[1] <= STEPS:
            return None
        values = self._values_in_rows(run, self._functions, self.last)
        for switch, tree, numbers in zip(unlocated(self.model), self._functions, values, strict=True):
            if _returns(numbers) >= FEWEST and self._is_driven_back(run, tree, numbers):
                run.now[0].status = SLIDING_MODE
                return switch
        return None

    def _is_driven_back(self, run: Run, tree: Node, values: Floats) -> bool:
        """Whether motion from most rows meets the switch with some speed, and beyond it the opposite one (Filippov).

        The speed of a motion that only decays to the switch would tend to zero with the distance.
        """
        elements = self.model.elements
        rates = [elements.rates[name] for name in self.layout.used]
        speed, *slopes = self._values_in_rows(run, [elements.rate_of(tree), *rates], self.last)
        with np.errstate(all="ignore"):
            time = -values / speed
            meets_switch = (time > 0.0) & (time <= STEPS * self.last[1].max() * self.scales.si_factor(TIME))
            speed_before, speed_beyond = (
                self._values_in_rows(run, [elements.rate_of(tree)], self._rows_after(slopes, part * time))[0] / speed
                for part in (1.0 - NEAR, 1.0 + NEAR)
            )
            return bool(
                np.count_nonzero(meets_switch & (speed_before > SLOWER) & (speed_beyond < -SLOWEST)) >= OFTEN * STEPS
            )

    def _rows_after(self, slopes: list[Floats], time: Floats) -> Floats:
        """Return rows after some time, s, on straight lines."""
        factors = self.layout.sizes(self.scales)
        rows = self.last.copy()
        rows[0] += time / self.scales.si_factor(TIME)
        rows[2:] += np.stack(slopes) * time / factors[:, None]
        return rows

    def _values_in_rows(self, run: Run, trees: list[Node], rows: Floats) -> list[Floats]:
        return values_in_rows(self.model, self.layout, self.scales, run, trees, rows)


def _returns(values: Floats) -> int:
    """Count the steps that led across a switch, or away from it."""
    size, side = np.abs(values), values > 0.0
    return int(np.count_nonzero((side[1:] != side[:-1]) | (size[1:] > size[:-1])))

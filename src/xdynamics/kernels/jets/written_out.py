"""Coefficients written out: each is a value of the text, which suits small programs."""

from __future__ import annotations

from collections.abc import Sequence

from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.jets.coefficients import Coefficients, Env
from xdynamics.kernels.jets.motion import Motion
from xdynamics.kernels.jets.series import MEMORY, Series, Written
from xdynamics.kernels.program import AT, Compute, Line, Load, Place, Program, StoreTo


class WrittenOut(Coefficients):
    """Every coefficient a value of the text."""

    def __init__(self, forces: Program, motion: Motion, degree: int, first: int) -> None:
        super().__init__(forces, motion, degree, first)
        self.write = Assignments(lambda _lines, name: name, "_")
        self.lines = self.write.lines
        self.time = Series(terms={0: self.write.load(Place("at", AT.index("t"))), 1: 1.0})
        self.time.terms |= dict.fromkeys(range(2, degree + 1), 0.0)
        self.states = [Series(terms={0: self.write.load(Place("y", i))}) for i in range(motion.used)]

    def state(self, place: Place) -> Series:
        """Return the series of a number of the state."""
        return self.states[place.offset]


def written_lines(forces: Program, body: Sequence[Line], motion: Motion, degree: int, first: int) -> Coefficients:
    """Write every coefficient of the motion, and store those of the state."""
    write = WrittenOut(forces, motion, degree, first)
    env: Env = {}
    raised: dict[int, Series] = {}
    n = motion.coordinates
    for k in range(degree):
        order = Written(write.write, k)
        for line in body:
            match line:
                case Load():
                    write.load(order, env, line)
                case Compute():
                    write.compute(order, env, line)
                case StoreTo():
                    raised[motion.raised_by(line.place.offset)] = write.value(env, line.value)
        raised |= {i: write.states[n + i] for i in range(n)}
        for i, slope in sorted(raised.items()):
            write.states[i].terms[k + 1] = order.compute("divide", order.now(slope), float(k + 1))
    for k in range(degree + 1):
        for i, series in enumerate(write.states):
            write.write.store(Place(MEMORY, first + k * motion.used + i), series.terms[k])
    return write

"""Coefficients written out: each is a value of the text, which suits small programs."""

from __future__ import annotations

from collections.abc import Sequence

from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.jets.coefficients import Coefficients, Env
from xdynamics.kernels.jets.motion import Motion
from xdynamics.kernels.jets.series import MEMORY, Order, Series, reciprocal
from xdynamics.kernels.program import AT, Compute, Line, Load, Operand, Place, Program, StoreTo


class Written:
    """An order of series whose coefficients are all values of the text.

    Parameters
    ----------
    lines : Assignments
    number : int
    fused : bool
    """

    def __init__(self, lines: Assignments, number: int, *, fused: bool) -> None:
        self.lines, self._k, self.fused = lines, number, fused

    @property
    def number(self) -> Operand:
        """The order as a number."""
        return float(self._k)

    def over(self, value: Operand) -> Operand:
        """Divide by the order."""
        return self.divided_by(value, self._k)

    def divided_by(self, value: Operand, number: int) -> Operand:
        """Divide by a whole number: by its reciprocal to 106 bits, of which the result has 53, rounded to nearest."""
        if not self.fused:
            return self.compute("divide", value, float(number))
        nearest, rest = reciprocal(number)
        return self.product_added(value, nearest, self.compute("multiply", value, rest))

    def product_added(self, a: Operand, b: Operand, total: Operand) -> Operand:
        """Write a*b + total, rounded once where that is asked for."""
        if not self.fused or total == 0.0 or not {0.0, 1.0}.isdisjoint((a, b)):
            return self.compute("add", self.compute("multiply", a, b), total)
        return self.compute("fma", a, b, total)

    def compute(self, operation: str, *arguments: Operand) -> Operand:
        """Write one operation, unless what it gives is known: of zeros and ones that series have beyond their ends."""
        match operation, arguments:
            case ("multiply", (0.0, _) | (_, 0.0)):
                return 0.0
            case ("multiply", (1.0, other)) | ("multiply", (other, 1.0)) | ("divide", (other, 1.0)):
                return other
            case ("add", (0.0, other)) | ("add", (other, 0.0)) | ("subtract", (other, 0.0)):
                return other
            case ("negative", (0.0,)) | ("divide", (0.0, _)):
                return 0.0
            case ("subtract", (0.0, other)):
                return self.lines.compute("negative", other)
        return self.lines.compute(operation, *arguments)

    def first(self, series: Series) -> Operand:
        """Return the coefficient of order 0."""
        return series.terms[0]

    def second(self, series: Series) -> Operand:
        """Return the coefficient of order 1."""
        return self._term(series, 1)

    def now(self, series: Series) -> Operand:
        """Return the coefficient of this order."""
        return self._term(series, self._k)

    def _term(self, series: Series, k: int) -> Operand:
        return series.terms.get(k, 0.0) if series.constant else series.terms[k]

    def convolution(self, a: Series, b: Series, *, skip: int = 0) -> Operand:
        """Sum the products from the middle outward: the newest coefficients come last, so that little waits for them."""
        k = self._k
        first, last = min(skip, 1), k - (skip == 2)
        if a is b and first == k - last:
            return self._square(a, first)
        total: Operand = 0.0
        for j in sorted(range(first, last + 1), key=lambda j: (max(j, k - j), j)):
            total = self.product_added(self._term(a, j), self._term(b, k - j), total)
        return total

    def _square(self, a: Series, first: int) -> Operand:
        """Sum half of what a series has with itself: half the square in the middle, the products from there outward."""
        k = self._k
        total: Operand = 0.0
        if k % 2 == 0 and k // 2 >= first:
            middle = self._term(a, k // 2)
            total = self.compute("multiply", self.compute("multiply", 0.5, middle), middle)
        for j in range((k - 1) // 2, first - 1, -1):
            total = self.product_added(self._term(a, j), self._term(a, k - j), total)
        return self.compute("add", total, total)

    def part(self, owner: Series, name: str) -> Series:
        """Return a series that is computed along with another."""
        return owner.parts.setdefault(name, Series())

    def keep(self, series: Series, value: Operand) -> None:
        """Let a value be the coefficient of this order."""
        series.terms[self._k] = value

    def knows(self, series: Series) -> bool:
        """Whether the coefficient of this order is written."""
        return self._k in series.terms

    def read(self, place: Place) -> Operand:
        """Read a number that does not change."""
        return self.lines.load(place)


class WrittenOut(Coefficients):
    """Every coefficient a value of the text."""

    def __init__(self, forces: Program, motion: Motion, degree: int, first: int, *, fused: bool) -> None:
        super().__init__(forces, motion, degree, first, fused=fused)
        self.write = Assignments(lambda _lines, name: name, "_")
        self.lines = self.write.lines
        self.time = Series(terms={0: self.write.load(Place("at", AT.index("t"))), 1: 1.0})
        self.time.terms |= dict.fromkeys(range(2, degree + 1), 0.0)
        self.states = [Series(terms={0: self.write.load(Place("y", i))}) for i in range(motion.used)]
        self._elements: dict[Place, Series] = {}

    def state(self, place: Place) -> Series:
        """Return the series of a number of the state."""
        return self.states[place.offset]

    def load(self, order: Order, env: Env, line: Load) -> None:
        """Begin the series of a number that is read, which may be one that was stored."""
        if line.place in self._elements:
            env.setdefault(line.target, self._elements[line.place])
        super().load(order, env, line)

    def store(self, place: Place, series: Series) -> None:
        """Keep a series for those lines that read it from an array."""
        self._elements[place] = series


def written_lines(
    forces: Program, body: Sequence[Line], motion: Motion, degree: int, first: int, *, fused: bool
) -> Coefficients:
    """Write every coefficient of the motion, and store those of the state."""
    write = WrittenOut(forces, motion, degree, first, fused=fused)
    env: Env = {}
    raised: dict[int, Series] = {}
    n = motion.coordinates
    for k in range(degree):
        order = Written(write.write, k, fused=fused)
        for line in body:
            match line:
                case Load():
                    write.load(order, env, line)
                case Compute():
                    write.compute(order, env, line)
                case StoreTo(place, value) if motion.has_slope(place):
                    raised[motion.raised_by(place.offset)] = write.value(env, value)
                case StoreTo(place, value):
                    write.store(place, write.value(env, value))
        raised |= {i: write.states[n + i] for i in range(n)}
        for i, slope in sorted(raised.items()):
            write.states[i].terms[k + 1] = order.divided_by(order.now(slope), k + 1)
    for k in range(degree + 1):
        for i, series in enumerate(write.states):
            write.write.store(Place(MEMORY, first + k * motion.used + i), series.terms[k])
    return write

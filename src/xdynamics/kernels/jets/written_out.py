"""Coefficients written out: each is a value of the text, which suits small programs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.jets.coefficients import Coefficients, Env
from xdynamics.kernels.jets.linear_forms import LinearForms
from xdynamics.kernels.jets.motion import Motion
from xdynamics.kernels.jets.quotients import multiple_of
from xdynamics.kernels.jets.series import MEMORY, Order, Series, reciprocal
from xdynamics.kernels.program import AT, Compute, Line, Load, Location, Operand, Program, StoreTo

FEW = 3  # orders below which the products of a convolution are summed at once


def high_from(degree: int) -> int:
    """Return from which order on coefficients are high.

    In the longest step that a tolerance allows, the size of a term falls by 16 digits to that of the degree: so that of the
    first of these is below a millionth of the state, whatever the degree, and the bias of a rounded factor below 1e-22 of it.
    """
    return max(4, -(-2 * degree // 5))


class Written:
    """An order of series whose coefficients are all values of the text.

    Parameters
    ----------
    forms : LinearForms
    number : int
    fused, high : bool
        Of a high order, sums of values times what stays the same are formed of as few operations as possible, and
        reciprocals are those of 53 bits.
    """

    def __init__(self, forms: LinearForms, number: int, *, fused: bool, high: bool) -> None:
        self.forms, self.lines, self._k, self.fused, self.high = forms, forms.lines, number, fused, high
        forms.exact = not high
        self._forming = fused and number > 0

    @property
    def number(self) -> Operand:
        """The order as a number."""
        return float(self._k)

    def divide_by_order(self, value: Operand) -> Operand:
        """Divide by the order."""
        return self.divided_by(value, self._k)

    def divided_by(self, value: Operand, number: int) -> Operand:
        """Divide by a whole number: by its reciprocal to 106 bits, of which the result has 53, rounded to nearest."""
        if not self.fused:
            return self.compute("divide", value, float(number))
        nearest, low_part = reciprocal(number)
        if self.high:
            return self.compute("multiply", value, nearest)
        return self.product_added(value, nearest, self.compute("multiply", value, low_part))

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
                return self.compute("negative", other)
        form = self.forms.linear_form(operation, *arguments) if self._forming else None
        if form is not None:
            return form
        return self.forms.note_age(self.lines.compute(operation, *map(self.forms.write_value, arguments)))

    def first(self, series: Series) -> Operand:
        """Return the coefficient of order 0."""
        return series.terms[0]

    def second(self, series: Series) -> Operand:
        """Return the coefficient of order 1."""
        return self._coefficient_at(series, 1)

    def now(self, series: Series) -> Operand:
        """Return the coefficient of this order."""
        return self._coefficient_at(series, self._k)

    def _coefficient_at(self, series: Series, k: int) -> Operand:
        return series.terms.get(k, 0.0) if series.constant else series.terms[k]

    def convolution(self, a: Series, b: Series, *, skip: int = 0) -> Operand:
        """Sum the products from the middle outward: the newest coefficients come last, so that little waits for them.

        Those with newer coefficients of the one series are summed apart from those with newer ones of the other.
        """
        (a, factor), (b, second_factor) = self._unscaled(a), self._unscaled(b)
        k = self._k
        first, last = min(skip, 1), k - (skip == 2)
        if a is b and first == k - last:
            total = self._sum_of_square(a, first)
        else:
            outward = sorted(range(first, last + 1), key=lambda j: (max(j, k - j), j))
            newer = [j for j in outward if 2 * j > k] if self.fused and k >= FEW else []
            parts = [
                self._sum_of_products(a, b, [j for j in outward if j not in newer]),
                self._sum_of_products(a, b, newer),
            ]
            total = self.compute("add", *parts)
            total = total if 0.0 in parts else self.forms.write_value(total)
        return self.forms.scale_form(self.forms.scale_form(total, factor), second_factor) if self._forming else total

    def _unscaled(self, series: Series) -> tuple[Series, Operand]:
        """Return what a series is a multiple of, and its factor."""
        factor: Operand = 1.0
        while self._forming and series.scaled is not None and self.forms.can_multiply(factor, series.scaled[1]):
            series, inner_factor = series.scaled
            factor = self.forms.multiply_factors(factor, inner_factor)
        return series, factor

    def _sum_of_products(self, a: Series, b: Series, terms: Sequence[int]) -> Operand:
        total: Operand = 0.0
        for j in terms:
            total = self.product_added(self._coefficient_at(a, j), self._coefficient_at(b, self._k - j), total)
        return total

    def _sum_of_square(self, a: Series, first: int) -> Operand:
        """Sum what a series has with itself: the square in the middle, twice the products from there outward."""
        k = self._k
        total: Operand = 0.0
        if k % 2 == 0 and k // 2 >= first:
            middle = self._coefficient_at(a, k // 2)
            half = middle if self.fused else self.compute("multiply", 0.5, middle)
            total = self.compute("multiply", half, middle)
        for j in range((k - 1) // 2, first - 1, -1):
            older = self.forms.write_value(self._coefficient_at(a, j))
            twice = self.lines.compute("add", older, older) if self.fused and older != 0.0 else older
            total = self.product_added(twice, self._coefficient_at(a, k - j), total)
        return total if self.fused else self.compute("add", total, total)

    def part(self, owner: Series, name: str) -> Series:
        """Return a series that is computed along with another."""
        return owner.parts.setdefault(name, Series())

    def keep(self, series: Series, value: Operand) -> None:
        """Let a value be the coefficient of this order."""
        series.terms[self._k] = value
        if series.constant:
            self.forms.still.add(value)

    def knows(self, series: Series) -> bool:
        """Whether the coefficient of this order is written."""
        return self._k in series.terms

    def read(self, location: Location) -> Operand:
        """Read a number that does not change."""
        return self.lines.load(location)

    def rise(self, slopes: Mapping[int, Series], states: Sequence[Series], coordinates: int, degree: int) -> None:
        """Write the next coefficients of a state by those of its slopes; of coordinates by accelerations, at once."""
        k = self._k
        for i in range(coordinates):
            velocity = states[coordinates + i]
            if not self.fused or k == 0:
                states[i].terms[k + 1] = self.divided_by(self.now(velocity), k + 1)
            if self.fused and k + 2 <= degree:
                slope = self.forms.write_if_long(self.now(slopes[coordinates + i]))
                states[i].terms[k + 2] = self.divided_by(slope, (k + 1) * (k + 2))
        for i, series in sorted(slopes.items()):
            states[i].terms[k + 1] = self.divided_by(self.forms.write_if_long(self.now(series)), k + 1)


class WrittenOut(Coefficients):
    """Every coefficient a value of the text."""

    def __init__(self, forces: Program, motion: Motion, degree: int, first: int, *, fused: bool) -> None:
        super().__init__(forces, motion, degree, first, fused=fused)
        self.write = Assignments(lambda _lines, name: name, "_")
        self.lines = self.write.lines
        self.time = Series(terms={0: self.write.load(Location("at", AT.index("t"))), 1: 1.0})
        self.time.terms |= dict.fromkeys(range(2, degree + 1), 0.0)
        self.states = [Series(terms={0: self.write.load(Location("y", i))}) for i in range(motion.used)]
        self._elements: dict[Location, Series] = {}

    def state(self, location: Location) -> Series:
        """Return the series of a number of the state."""
        return self.states[location.offset]

    def load(self, order: Order, env: Env, line: Load) -> None:
        """Begin the series of a number that is read, which may be one that was stored."""
        if line.location in self._elements:
            env.setdefault(line.target, self._elements[line.location])
        super().load(order, env, line)

    def store(self, location: Location, series: Series) -> None:
        """Keep a series for those lines that read it from an array."""
        self._elements[location] = series

    def begin(
        self, order: Order, env: Env, line: Compute, series: Sequence[Series], numbers: Sequence[Operand]
    ) -> None:
        """Write the value itself, and note what it is a multiple of."""
        super().begin(order, env, line, series, numbers)
        target = env[line.target]
        if not target.constant:
            target.scaled = multiple_of(order, line.operation, target, series)


def written_lines(
    forces: Program, body: Sequence[Line], motion: Motion, degree: int, first: int, *, fused: bool
) -> Coefficients:
    """Write every coefficient of the motion, and store those of the state."""
    write = WrittenOut(forces, motion, degree, first, fused=fused)
    env: Env = {}
    raised: dict[int, Series] = {}
    n = motion.coordinates
    forms = LinearForms(write.write)
    for k in range(degree):
        order = Written(forms, k, fused=fused, high=fused and k >= high_from(degree))
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
        order.rise(raised, write.states, n, degree)
    for k in range(degree + 1):
        for i, series in enumerate(write.states):
            write.write.store(Location(MEMORY, first + k * motion.used + i), forms.write_value(series.terms[k]))
    return write

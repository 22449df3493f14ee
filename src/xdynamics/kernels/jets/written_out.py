"""Taylor coefficients written out: each is a value of the text, which suits small programs.

Sums of values times constant factors take one operation a term, and none until a number is asked for. Of high orders a
coefficient is small beside the state, so that its rounding does not matter, and what matters is how long the next one
waits for it: ``-(k*x + c*(2*x*y))/m`` is two products there, by factors that are computed once in a step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.jets.motion import Coefficients, Env, Motion
from xdynamics.kernels.jets.recurrences import MEMORY, Order, Series, multiple_of, reciprocal
from xdynamics.kernels.program import AT, Compute, Line, Load, Location, Operand, Program, StoreTo

Form = dict[Operand, Operand]  # factors by the values that they belong to
MOST_TERMS = 3  # of a form: what many others are made of is summed once


class LinearForms:
    """Sums that are written when they are needed, and names for them until then.

    Parameters
    ----------
    lines : Assignments

    Attributes
    ----------
    still : set of Operand
        Values that do not change with time: those of factors.
    exact : bool
        Whether products of factors are to be exact; sums are written where they are not.
    """

    def __init__(self, lines: Assignments) -> None:
        self.lines = lines
        self.still: set[Operand] = set()
        self.exact = True
        self._forms: dict[Operand, Form] = {}
        self._written: dict[Operand, Operand] = {}
        self._ages: dict[Operand, int] = {}

    def linear_form(self, operation: str, *arguments: Operand) -> Operand | None:
        """Name the result of a linear operation without writing a line; None for other operations."""
        match operation, arguments:
            case "negative", (value,):
                return self.scale_form(value, -1.0)
            case (("add" | "subtract"), (first, second)):
                return self._add_forms(first, second, 1.0 if operation == "add" else -1.0)
            case "multiply", (still, value) if self._stays(still):
                return self.scale_form(value, still)
            case "multiply", (value, still) if self._stays(still):
                return self.scale_form(value, still)
        return None

    def scale_form(self, value: Operand, factor: Operand) -> Operand:
        """Name the product of a value and a constant factor."""
        form = self._form_of(value)
        if not all(self.can_multiply(term_factor, factor) for term_factor in form.values()) or (
            len(form) > 1 and not self.can_multiply(0.0, factor)
        ):
            value = self.write_value(value)
        return self._name_form(
            {term: self.multiply_factors(term_factor, factor) for term, term_factor in self._form_of(value).items()}
        )

    def can_multiply(self, first: Operand, second: Operand) -> bool:
        """Whether factors may be multiplied."""
        # with these a product is exact, so that it rounds where the written order has it
        return not self.exact or not {1.0, -1.0, 2.0, 0.5}.isdisjoint((first, second))

    def multiply_factors(self, first: Operand, second: Operand) -> Operand:
        """Multiply factors."""
        for left, right in ((first, second), (second, first)):
            if left == 1.0:
                return right
            if left == -1.0:
                return self._constant_product("negative", right)
        return self._constant_product("multiply", first, second)

    def write_value(self, value: Operand) -> Operand:
        """Return a value itself, whose sum is written on first use with its newest term last."""
        if value not in self._forms:
            return value
        if value not in self._written:
            total: Operand = 0.0
            for term, factor in sorted(self._forms[value].items(), key=lambda item: self._ages.get(item[0], -1)):
                total = self._add_term(term, factor, total)
            self._written[value] = self.note_age(total)
        return self._written[value]

    def write_if_long(self, value: Operand) -> Operand:
        """Return a value that several others are multiples of: a sum is written once for all of them."""
        return self.write_value(value) if len(self._form_of(value)) > 1 else value

    def note_age(self, value: Operand) -> Operand:
        """Remember when a value was written."""
        self._ages.setdefault(value, len(self._ages))
        return value

    def _stays(self, value: Operand) -> bool:
        return not isinstance(value, str) or value in self.still

    def _constant_product(self, operation: str, *factors: Operand) -> Operand:
        value = self.lines.compute(operation, *factors)
        self.still.add(value)
        return value

    def _form_of(self, value: Operand) -> Form:
        if value in self._written:
            return {self._written[value]: 1.0}
        return self._forms.get(value) or ({} if value == 0.0 else {value: 1.0})

    def _name_form(self, form: Form) -> Operand:
        if not form:
            return 0.0
        (value, factor), *further_terms = form.items()
        if not further_terms and factor == 1.0:
            return value
        name = f"form {len(self._forms)}"
        self._forms[name] = form
        return name

    def _add_forms(self, first: Operand, second: Operand, sign: float) -> Operand:
        terms = *self._form_of(first), *self._form_of(second)
        # factors of one value would be added first, with a rounding that the written order has not
        if len({*terms}) > MOST_TERMS or (self.exact and len({*terms}) < len(terms)):
            first, second = self.write_value(first), self.write_value(second)
        form = dict(self._form_of(first))
        for value, factor in self._form_of(second).items():
            signed_factor = self.multiply_factors(factor, sign)
            form[value] = self._constant_product("add", form[value], signed_factor) if value in form else signed_factor
        return self._name_form({value: factor for value, factor in form.items() if factor != 0.0})

    def _add_term(self, value: Operand, factor: Operand, total: Operand) -> Operand:
        compute = self.lines.compute
        if total == 0.0:
            return (
                value
                if factor == 1.0
                else compute("negative", value)
                if factor == -1.0
                else compute("multiply", value, factor)
            )
        if factor in (1.0, -1.0):
            return compute("add" if factor == 1.0 else "subtract", total, value)
        return compute("fma", value, factor, total)


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
        """Return a value over the order, by which a coefficient of a rate becomes the next one of its integral."""
        return self.divided_by(value, self._k)

    def divided_by(self, value: Operand, number: int) -> Operand:
        """Divide by an integer: by its reciprocal to 106 bits, so that the result is rounded to nearest in 53."""
        if not self.fused:
            return self.compute("divide", value, float(number))
        nearest, low_part = reciprocal(number)
        if self.high:
            return self.compute("multiply", value, nearest)
        return self.product_added(value, nearest, self.compute("multiply", value, low_part))

    def product_added(self, a: Operand, b: Operand, total: Operand) -> Operand:
        """Write a*b + total, rounded once if fused."""
        if not self.fused or total == 0.0 or not {0.0, 1.0}.isdisjoint((a, b)):
            return self.compute("add", self.compute("multiply", a, b), total)
        return self.compute("fma", a, b, total)

    def compute(self, operation: str, *arguments: Operand) -> Operand:
        """Write one operation, unless its result is known: series have zeros and ones beyond their ends."""
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
        """Return the series of which another is a multiple, and the factor."""
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
        """Sum the products of a series with itself: the middle square, then twice the products outward."""
        k = self._k
        total: Operand = 0.0
        if k % 2 == 0 and k // 2 >= first:
            middle = self._coefficient_at(a, k // 2)
            # halved here and doubled at the end, both exactly
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
        """Set the coefficient of this order."""
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
        """Write the value itself, and note the series of which it is a multiple."""
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

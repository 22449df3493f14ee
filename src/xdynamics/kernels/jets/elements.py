"""Taylor coefficients of elements in loops, in which neighbouring elements are computed side by side.

Coefficients of one order lie next to one another, element after element of the outermost loop; what a link needs of all
orders is near. Differences of what two elements have are computed again where they are read.

A sum of products over the orders is taken by pairs of terms. Of an order k the terms j and k - j read the same
coefficients, and two sums that wait for nothing of one another take them: from 1 to (k - 1)//2, and from k - 1 down. Of
a square the second is the first.

Values that are powers of another value times a constant factor have one recurrence. Of m/norm(d)**3 with d*d for s, the
series follows from that of s alone, y = c s**(-3/2): the root, its square and its cube have no series that anyone
reads.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any, TypeGuard

from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.jets.looped import InLoops, Looped, MovingArrayError, expanded_by
from xdynamics.kernels.jets.motion import Env, Motion
from xdynamics.kernels.jets.recurrences import (
    HALF,
    MEMORY,
    MIDDLE,
    ODD,
    ORDER,
    TERM,
    Order,
    Series,
    begin_quotient,
    divide_coefficient,
    or_nothing,
)
from xdynamics.kernels.machine import LINE
from xdynamics.kernels.program import (
    Compute,
    Gather,
    Line,
    Load,
    Location,
    Loop,
    Operand,
    Ordinal,
    Program,
    Reduction,
    StoreTo,
    nested_lines,
)

AT_ONCE = 12  # sums by one loop: as many as a processor has registers for, with what they are of
Distance = tuple[int, tuple[tuple[str, int], ...]]  # from the first coefficient: a number, and multiples of indices
AHEAD: Distance = (1, ((TERM, 1),))  # j, one more than the index of the loop over terms
BACK: Distance = (0, ((ORDER, 1), (TERM, -1)))  # k - j, as k is one more than the index of the loop over orders
HALFWAY: Distance = (0, ((MIDDLE, 1),))


@dataclass(frozen=True)
class Pairs:
    """A sum of products of inner orders, and the names of its parts.

    Attributes
    ----------
    a, b : Series
    exponent : Fraction, optional
        Of a series b that is this power of a: products are weighted as Miller's recurrence has it.
    total, low, high : str
    """

    a: Series
    b: Series
    exponent: Fraction | None
    total: str
    low: str
    high: str

    @property
    def parts(self) -> tuple[str, ...]:
        """The sums that it consists of."""
        return (self.low,) if self.a is self.b else (self.low, self.high)


class Paired(Looped):
    """The order that a loop is at, of series in loops over elements.

    Parameters
    ----------
    weights : callable
        Gives the place of weights of an exponent: of the terms j, then of the terms k - j.
    depth : int
        How many loops over elements are around.
    further
        As of `Looped`.
    """

    def __init__(
        self,
        *looped_arguments: Any,
        weights: Callable[[Fraction], tuple[Location, Location]],
        depth: int,
        **further: Any,
    ) -> None:
        super().__init__(*looped_arguments, **further)
        self._weights, self.depth = weights, depth
        self._pairs: list[Pairs] = []

    def first(self, series: Series) -> Operand:
        """Return the coefficient of order 0."""
        if series.made is None or not self.started:
            return super().first(series)
        if series not in self._first:
            self._first[series] = self._recompute(series, self.first)
        return self._first[series]

    def second(self, series: Series) -> Operand:
        """Return the coefficient of order 1."""
        if series.made is None or not self.started:
            return super().second(series)
        return self._recompute(series, self.second)

    def now(self, series: Series) -> Operand:
        """Return the coefficient of this order."""
        if series.made is not None and series not in self._now:
            self._now[series] = self._recompute(series, self.now)
        return super().now(series)

    def keep(self, series: Series, value: Operand) -> None:
        """Store the coefficient of this order, unless it is computed again."""
        if series.made is not None:
            self._now[series] = value
        else:
            super().keep(series, value)

    def _recompute(self, series: Series, coefficient_of: Callable[[Series], Operand]) -> Operand:
        assert series.made is not None  # noqa: S101 - callers know
        operation, operands = series.made
        return self.compute(operation, *map(coefficient_of, operands))

    def convolution(self, a: Series, b: Series, *, skip: int = 0) -> Operand:
        """Sum the products: those of inner orders by pairs, then those of an end with the other's beginning."""
        if not self.started or a.constant or b.constant:
            return super().convolution(a, b, skip=skip)
        total = self._inner_sum(a, b)
        if skip == 0 and a is b:
            return self.product_added(self.compute("add", self.first(a), self.first(a)), self.now(a), total)
        if skip == 0:
            total = self.product_added(self.first(a), self.now(b), total)
        if skip < 2:
            total = self.product_added(self.now(a), self.first(b), total)
        return total

    def weighted(self, base: Series, power_series: Series, exponent: Fraction) -> Operand:
        """Sum (r (k - j) - j)/k of the products of base[k - j] and own[j] over j from 0 to k - 1, where r is an exponent."""
        rising = self.compute("multiply", float(exponent), self.now(base))
        return self.product_added(rising, self.first(power_series), self._inner_sum(base, power_series, exponent))

    def _inner_sum(self, a: Series, b: Series, exponent: Fraction | None = None) -> Operand:
        number = next(self._serial)
        self._pairs.append(Pairs(a, b, exponent, f"_s{number}_", f"_s{number}_l", f"_s{number}_h"))
        return f"_s{number}_"

    def sum_up(self) -> None:
        """Write all inner sums, which read earlier orders alone, before the other lines."""
        lines = self.lines.lines
        new_lines: list[Line] = [line for line in lines if isinstance(line, Gather)]
        group: list[Pairs] = []
        for pairs in self._pairs:
            if sum(len(group_pairs.parts) for group_pairs in (*group, pairs)) > AT_ONCE:
                new_lines += self._pair_loops(group)
                group = []
            group.append(pairs)
        new_lines += self._pair_loops(group)
        lines[:] = [*new_lines, *(line for line in lines if not isinstance(line, Gather))]
        self._pairs.clear()

    def _pair_loops(self, group: Sequence[Pairs]) -> list[Line]:
        """Write some sums by one loop over their pairs of terms, and the unpaired middle terms."""
        if not group:
            return []
        inner, parts, terms = self._of_terms(), list[str](), list[Operand]()
        for pairs in group:
            for part, (left, right), weight in zip(
                pairs.parts, ((BACK, AHEAD), (AHEAD, BACK)), self._weights_of(pairs), strict=False
            ):
                parts.append(part)
                terms.append(self._add_product(inner, pairs, (left, right), weight, part))
        max_passes = max(1, (self._orders - 3) // 2)  # orders below the last, of which the loop has no pass
        loop_lines: list[Line] = [
            Reduction(TERM, max_passes, tuple(inner.lines), tuple(terms), tuple(parts), "newest", 0.0, below=HALF)
        ]
        starts = tuple(f"{pairs.total}t" for pairs in group)
        for pairs, start in zip(group, starts, strict=True):
            loop_lines.append(Compute(start, "add", (pairs.low, pairs.parts[-1])))
        inner = self._of_terms()
        totals = tuple(pairs.total for pairs in group)
        middles = tuple(
            self._add_product(
                inner,
                pairs,
                (HALFWAY, HALFWAY),
                None if pairs.exponent is None else float((pairs.exponent - 1) / 2),
                pairs.total,
            )
            for pairs in group
        )
        loop_lines.append(Reduction("_once", 1, tuple(inner.lines), middles, totals, "newest", starts, below=ODD))
        return loop_lines

    def _of_terms(self) -> Assignments:
        return Assignments(lambda _lines, name: name, f"_c{next(self._serial)}_")

    def _weights_of(self, pairs: Pairs) -> tuple[Location | None, Location | None]:
        return (None, None) if pairs.exponent is None else self._weights(pairs.exponent)

    def _add_product(
        self,
        inner: Assignments,
        pairs: Pairs,
        distances: tuple[Distance, Distance],
        weight: Location | float | None,
        total: str,
    ) -> Operand:
        """Write a term added to a total."""
        a, b = (_load_coefficient(inner, *factor) for factor in zip((pairs.a, pairs.b), distances, strict=True))
        if weight is not None:
            a = inner.compute("multiply", inner.load(weight) if isinstance(weight, Location) else weight, a)
        return inner.compute("fma", a, b, total)


def _load_coefficient(lines: Assignments, series: Series, distance: Distance) -> Operand:
    """Read a coefficient at a distance from the first, or compute it from those of others."""
    if series.made is not None:
        operation, operands = series.made
        return lines.compute(operation, *(_load_coefficient(lines, operand, distance) for operand in operands))
    assert series.location is not None  # noqa: S101 - series that change are in memory
    series.read = True
    location, (ahead, index_multiples) = series.location, distance
    strides = tuple((index, times * series.stride) for index, times in index_multiples)
    return lines.load(Location(location.array, location.offset + ahead * series.stride, (*location.strides, *strides)))


Form = tuple[str, Fraction]  # a base and the exponent


@dataclass
class Powers:
    """The values of a program that are computed as powers.

    Attributes
    ----------
    made : dict of str to (str, Fraction)
        Values with their bases and exponents.
    passed_over : set of str
        Values of which no series is needed, as only powers are made of them.
    """

    made: dict[str, Form] = field(default_factory=dict)
    passed_over: set[str] = field(default_factory=set)


def powers_of(body: Sequence[Line]) -> Powers:
    """Find the powers in loops of a program; those outside of loops stay as they are."""
    powers, still_values = Powers(), set[str]()
    for line in body:
        if isinstance(line, Loop | Reduction):
            _find_powers(line, still_values, powers)
        elif _is_still(line, still_values):
            still_values.add(line.target)
    return powers


def _find_powers(line: Loop | Reduction, constants: set[str], powers: Powers) -> None:
    """Find the powers among the lines of a loop, and in those inside it."""
    still_values, forms = set(constants), dict[str, Form]()
    computed: dict[str, Compute] = {}
    for inner in line.body:
        if isinstance(inner, Loop | Reduction):
            _find_powers(inner, still_values, powers)
        elif _is_still(inner, still_values):
            still_values.add(inner.target)
        elif isinstance(inner, Compute) and (form := _power_form(inner, forms, still_values)):
            forms[inner.target], computed[inner.target] = form, inner
    needed_names = {str(operand) for operand in _series_operands(line, forms) if operand in forms}
    made: dict[str, Form] = {}
    waiting = sorted(needed_names)
    while waiting:
        name = waiting.pop()
        operands = [str(operand) for operand in computed[name].arguments if operand in forms]
        exponent = forms[name][1]
        # a root, a multiple and an inverse of what has a series take no more than a power; whole powers go through zero
        if operands and (exponent < 0 or exponent.denominator > 1) and not needed_names.issuperset(operands):
            made[name] = forms[name]
            continue
        waiting += sorted(set(operands) - needed_names)
        needed_names |= set(operands)
    powers.made |= made
    powers.passed_over |= forms.keys() - needed_names


def _power_form(line: Compute, forms: dict[str, Form], still_values: set[str]) -> Form | None:
    """Return base and exponent of a value that is a power up to a factor; None of other values."""

    def form_of(operand: Operand) -> Form | None:
        return None if _is_constant(operand, still_values) else forms.get(str(operand), (str(operand), Fraction(1)))

    arguments = line.arguments
    operand_forms = [form_of(operand) for operand in arguments]
    match line.operation, operand_forms:
        case "sqrt", [(base, exponent)]:
            return base, exponent / 2
        case "negative", [(base, exponent)] if arguments[0] in forms:
            return base, exponent
        case "multiply", [(base, exponent), None] | [None, (base, exponent)] if base in _bases(line, forms):
            return base, exponent
        case "multiply", [(base, exponent), (other, more)] if base == other and not forms.keys().isdisjoint(arguments):
            return base, exponent + more
        case "divide", [(base, exponent), None] if arguments[0] in forms:
            return base, exponent
        case "divide", [None, (base, exponent)]:
            return base, -exponent
        case "divide", [(base, exponent), (other, less)] if base == other and exponent != less:
            return base, exponent - less
    return None


def _bases(line: Compute, forms: dict[str, Form]) -> set[str]:
    """Return the bases of those arguments that are known to be powers."""
    return {forms[str(operand)][0] for operand in line.arguments if operand in forms}


def _is_still(line: Line, still_values: set[str]) -> TypeGuard[Load | Compute]:
    """Whether the value of a line is constant in time."""
    if isinstance(line, Load):
        return line.location.array == "p"
    return isinstance(line, Compute) and all(_is_constant(operand, still_values) for operand in line.arguments)


def _is_constant(operand: Operand, still_values: set[str]) -> bool:
    return not isinstance(operand, str) or operand in still_values


def _series_operands(line: Loop | Reduction, forms: dict[str, Form]) -> Iterable[Operand]:
    """Yield the operands of lines that are no powers themselves, also in loops inside."""
    if isinstance(line, Reduction):
        yield from (*line.terms, *line.starts)
        if line.where:
            yield line.where
    for inner in line.body:
        match inner:
            case Compute() if inner.target not in forms:
                yield from inner.arguments
            case StoreTo():
                yield inner.value
            case Loop() | Reduction():
                yield from _series_operands(inner, {})


class InElements(InLoops):
    """Coefficients in memory, of loops over elements that go side by side.

    Parameters
    ----------
    forces, body, motion, degree, first, moving
        As of `InLoops`, and the lines that are needed.
    """

    def __init__(
        self, forces: Program, body: Sequence[Line], motion: Motion, degree: int, first: int, moving: frozenset[str]
    ) -> None:
        self._own: dict[int, set[str]] = {}  # of every loop: arrays whose elements are those of its passes
        self._counts: dict[str, int] = {}
        self._copies: dict[tuple[int, int, int], Location] = {}
        self._weights: dict[Fraction, tuple[Location, Location]] = {}
        self._powers = powers_of(body)
        self._sizes: dict[str, int] = {}
        super().__init__(forces, motion, degree, first, moving, fused=True)
        self.raised = frozenset((MEMORY,))

    def _allocate_array(self, elements: int, orders: int) -> tuple[Location, int]:
        row_stride = -(-elements // LINE) * LINE
        return Location(self._new_view(row_stride * orders)), row_stride

    def _new_view(self, numbers: int) -> str:
        """Return the name of a part of `w`."""
        name = f"series{len(self._sizes)}_"
        self._sizes[name] = numbers
        return name

    def finish(self, lines: Sequence[Line]) -> None:
        """Set the lines of the program, and reserve parts of `w` still in use at the start of a cache line."""
        super().finish(lines)
        used = {line.location.array for line in nested_lines(self.lines) if isinstance(line, Load | StoreTo)}
        for name, numbers in self._sizes.items():
            if name in used:
                self.memory = -(-self.memory // LINE) * LINE
                self.views[name] = MEMORY, self._reserve(numbers), numbers

    def state(self, location: Location) -> Series:
        """Return the series of a number of the state: of every third number, for one, those of a copy without the others."""
        indices = dict(location.strides)
        (index, stride), *other_strides = (*indices.items(), ("", 1))
        if len(other_strides) != 1 or stride == 1 or index not in self._counts:
            return super().state(location)
        number = self._counts[index]
        key = location.offset, stride, number
        if key not in self._copies:
            self._copies[key] = Location(
                self._new_view(_row_stride(number) * (self.degree + 1)), _first_element_offset(number)
            )
        return Series(location=replace(self._copies[key], strides=((index, 1),)), stride=_row_stride(number))

    def order(self, lines: Assignments, around: Sequence[Loop | Reduction], *, started: bool) -> Looped:
        """Return the writer of an order inside some loops."""
        if not around:
            return super().order(lines, around, started=started)
        outer, *inner_loops = around

        def allocate(numbers: int) -> tuple[Location, int]:
            row_stride = _row_stride(outer.count)
            strides, size = [(outer.index, 1)], numbers * row_stride
            for loop in inner_loops:
                strides.append((loop.index, size))
                size *= loop.count
            name = self._new_view(size)
            for loop in around:
                self._own.setdefault(id(loop), set()).add(name)
            return Location(name, _first_element_offset(outer.count), tuple(strides)), row_stride

        return Paired(
            lines,
            self.degree + 1,
            allocate,
            self._serial,
            started=started,
            in_element_loops=True,
            stores=self._stores,
            fused=True,
            weights=self._weights_for,
            depth=len(around),
        )

    def _weights_for(self, exponent: Fraction) -> tuple[Location, Location]:
        """Return where the weights of sums of a power are."""
        if exponent not in self._weights:
            name, offset = self._new_view(2 * self.degree), self.degree
            self._weights[exponent] = Location(name, 0, ((TERM, 1),)), Location(name, offset, ((TERM, 1),))
        return self._weights[exponent]

    def _rebuild_loop(self, line: Loop, body: tuple[Line, ...]) -> Loop:
        return replace(line, body=body, exclusive_arrays=frozenset(self._own.get(id(line), ())))

    def _write_pass(
        self,
        order: Looped,
        line: Loop | Reduction,
        env: Env,
        around: tuple[Loop | Reduction, ...],
        totals: Mapping[str, str] | None = None,
    ) -> tuple[Looped, Env]:
        self._counts[line.index] = line.count
        return super()._write_pass(order, line, env, around, totals)

    def load(self, order: Order, env: Env, line: Load) -> None:
        """Begin the series of a number that is read; varying numbers are read outside of inner loops."""
        super().load(order, env, line)
        if isinstance(order, Paired) and not env[line.target].constant:
            order.now(env[line.target])

    def compute(self, order: Order, env: Env, line: Compute) -> None:
        """Write the coefficient of a value."""
        if not isinstance(order, Paired) or all(self.value(env, operand).constant for operand in line.arguments):
            super().compute(order, env, line)
            return
        operands = [self.value(env, operand) for operand in line.arguments]
        if line.target in self._powers.passed_over:
            if not order.started:
                value = order.compute(line.operation, *map(order.first, operands))
                order.pass_on(env.setdefault(line.target, Series()), value)
        elif line.target in self._powers.made:
            self._raise_power(order, env, line, operands)
        else:
            if (
                line.target not in env
                and line.operation in ("add", "subtract")
                and self._are_near(operands, order.depth)
            ):
                env[line.target] = Series(made=(line.operation, tuple(operands)))
            super().compute(order, env, line)

    def _are_near(self, operands: Iterable[Series], depth: int) -> bool:
        """Whether series are all of the state, of elements of fewer loops than are around."""
        names = {MEMORY, *(location.array for location in self._copies.values())}
        places = [series.location for series in operands]
        return all(
            location is not None and location.array in names and len(location.strides) < depth for location in places
        )

    def _raise_power(self, order: Paired, env: Env, line: Compute, operands: Sequence[Series]) -> None:
        """Write the coefficient of a power."""
        base, exponent = self._powers.made[line.target]
        base_series = self.value(env, base)
        if not order.started:
            target = env[line.target] = Series()
            order.keep(target, order.compute(line.operation, *map(order.first, operands)))
            begin_quotient(order, target, order.first(base_series))
        else:
            target, divisor = env[line.target], order.first(base_series)
            weighted = divide_coefficient(order, target, order.weighted(base_series, target, exponent), divisor)
            order.keep(target, or_nothing(order, divisor, weighted))

    def prologue_lines(self, *, started: bool) -> list[Line]:
        """Return lines before those of an order: which terms its sums have, copies of the state, weights."""
        lines: list[Line] = []
        if started:
            numbers = range(self.degree - 1)
            self.tables = {"halves_": tuple(n // 2 for n in numbers), "odds_": tuple(n % 2 for n in numbers)}
            self.tables["middles_"] = tuple((n + 1) // 2 for n in numbers)
            lines += [
                Gather(index, Location(name, 0, ((ORDER, 1),)))
                for index, name in zip((HALF, ODD, MIDDLE), self.tables, strict=True)
            ]
        for (offset, stride, number), location in self._copies.items():
            ahead, used, row_stride = int(started), self.motion.used, _row_stride(number)
            source, target = ((ORDER, used),) * ahead, ((ORDER, row_stride),) * ahead
            copied = (
                Load("_copied", Location(MEMORY, self.first + offset + ahead * used, (("i", stride), *source))),
                StoreTo(Location(location.array, location.offset + ahead * row_stride, (("i", 1), *target)), "_copied"),
            )
            lines.append(Loop("i", number, copied, frozenset((location.array,))))
        if started and self._weights:
            lines += [Ordinal("_before", ORDER), Compute("_k", "add", ("_before", 1.0))]
            lines += [self._weighted(exponent, *places) for exponent, places in self._weights.items()]
        return lines

    def _weighted(self, exponent: Fraction, low: Location, high: Location) -> Loop:
        """Write r - (r + 1) j/k and (r + 1) j/k - 1, for an exponent r."""
        lines = (
            Ordinal("_index", TERM),
            Compute("_j", "add", ("_index", 1.0)),
            Compute("_part", "divide", ("_j", "_k")),
            Compute("_rising", "multiply", (float(exponent + 1), "_part")),
            Compute("_ahead", "subtract", (float(exponent), "_rising")),
            Compute("_back", "subtract", ("_rising", 1.0)),
            StoreTo(low, "_ahead"),
            StoreTo(high, "_back"),
        )
        return Loop(TERM, max(1, (self.degree - 2) // 2), lines)


def _row_stride(number: int) -> int:
    """Return how far rows of elements are apart: where vectors pay, an odd number of lines of the cache."""
    # rows a power of two apart would share few sets of the cache, and push one another out
    lines = -(-number // LINE)
    return number if lines < 2 else LINE * (lines + (lines + 1) % 2)


def _first_element_offset(number: int) -> int:
    """Return where the first element is: so that the last ones fill a line, as rows side by side are the last ones."""
    return 0 if number <= LINE else -number % LINE


def looped_lines(
    forces: Program, body: Sequence[Line], motion: Motion, degree: int, first: int, *, fused: bool
) -> InLoops:
    """Write the lines of a loop over orders, as long for any degree."""
    has_elements = fused and any(isinstance(line, Loop | Reduction) for line in body)
    moving: frozenset[str] = frozenset()
    while True:
        try:
            if has_elements:
                return expanded_by(InElements(forces, body, motion, degree, first, moving), body, motion, degree, first)
            write: InLoops = InLoops(forces, motion, degree, first, moving, fused=fused)
            return expanded_by(write, body, motion, degree, first)
        except MovingArrayError as error:
            moving |= {str(error)}

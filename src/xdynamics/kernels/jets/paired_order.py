"""The order that a loop is at, inside loops over elements, which go side by side: sums by pairs of terms.

Of an order k the terms j and k - j of a sum of products read the same coefficients, and two sums that wait for nothing of
one another take them: from 1 to (k - 1)//2, and from k - 1 down. Of a square the second is the first.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.jets.looped_order import Looped
from xdynamics.kernels.jets.series import HALF, MIDDLE, ODD, ORDER, TERM, Series
from xdynamics.kernels.program import Compute, Gather, Line, Location, Operand, Reduction

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
        """Write some sums by one loop over their pairs of terms, and what is between the pairs."""
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

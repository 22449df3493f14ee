"""Series in time, one for every value of a program, and the lines that compute their next coefficient.

A series is a row of coefficients, the value of the program being the first; those of values that do not change with time
are zero but for that. There are two ways to write them: each coefficient as a value of its own, for small programs, or
in memory, by a loop over orders, for the others. The operations are those of any kind of number that a printer knows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import count
from typing import Protocol

from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.program import Gather, Line, Load, Operand, Ordinal, Place, Reduction

MEMORY, ORDER, TERM = "w", "_order", "_term"  # array of the coefficients; indices of loops over orders and over terms
ZERO: Operand = 0.0
AT_ONCE = 10  # sums by one loop: as many as a processor has registers for, with what they are of


@dataclass(eq=False)
class Series:
    """The coefficients of a value.

    Attributes
    ----------
    constant : bool
        Whether the value does not change with time.
    truth : bool
        Whether it is a comparison, which is in memory as 1 or 0.
    terms : dict of int to operand
        Coefficients that are values of the text: all of them, or the first alone.
    place : Place, optional
        Where the first coefficient is, of series in memory.
    apart : int
        How far a coefficient is from the one before.
    read : bool
        Whether a coefficient is read from memory.
    """

    constant: bool = False
    truth: bool = False
    terms: dict[int, Operand] = field(default_factory=dict)
    place: Place | None = None
    apart: int = 1
    read: bool = False
    parts: dict[str, Series] = field(default_factory=dict)


class Order(Protocol):
    """The lines of one order: 0 is that of the values themselves."""

    @property
    def number(self) -> Operand:
        """The order as a number."""

    def compute(self, operation: str, *arguments: Operand) -> Operand:
        """Write one operation; return its operand."""

    def first(self, series: Series) -> Operand:
        """Return the coefficient of order 0."""

    def second(self, series: Series) -> Operand:
        """Return the coefficient of order 1, at orders above 0."""

    def now(self, series: Series) -> Operand:
        """Return the coefficient of this order."""

    def convolution(self, a: Series, b: Series, *, skip: int = 0) -> Operand:
        """Sum a[j]*b[k - j] over j from `skip` to k, but for a skip of 2 over j from 1 to k - 1."""

    def part(self, owner: Series, name: str) -> Series:
        """Return a series that is computed along with another, as the cosine with a sine."""

    def keep(self, series: Series, value: Operand) -> None:
        """Let a value be the coefficient of this order."""

    def knows(self, series: Series) -> bool:
        """Whether the coefficient of this order is written."""

    def read(self, place: Place) -> Operand:
        """Read a number that does not change."""


def slope(order: Order, series: Series) -> Series:
    """Return the series whose coefficients are k times those of another: that of its derivative times the time."""
    rising = order.part(series, "slope")
    if order.knows(rising):
        return rising
    if series.constant:
        rising.constant = True
        rising.terms[0] = 0.0
    elif order.number == 0.0:
        order.keep(rising, 0.0)
    else:
        order.keep(rising, order.compute("multiply", order.number, order.now(series)))
    return rising


class Written:
    """An order of series whose coefficients are all values of the text.

    Parameters
    ----------
    lines : Assignments
    number : int
    """

    def __init__(self, lines: Assignments, number: int) -> None:
        self.lines, self._k = lines, number

    @property
    def number(self) -> Operand:
        """The order as a number."""
        return float(self._k)

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
        """Sum the products, ascending; those of a series with itself in pairs."""
        k, total = self._k, None
        first, last = min(skip, 1), self._k - (skip == 2)
        if a is b and first == k - last:
            return self._square(a, first)
        for j in range(first, last + 1):
            product = self.compute("multiply", self._term(a, j), self._term(b, k - j))
            total = product if total is None else self.compute("add", total, product)
        return 0.0 if total is None else total

    def _square(self, a: Series, first: int) -> Operand:
        k, total = self._k, ZERO
        for j in range(first, (k + 1) // 2):
            product = self.compute("multiply", self._term(a, j), self._term(a, k - j))
            total = self.compute("add", total, product)
        total = self.compute("add", total, total)
        if k % 2 or k // 2 < first:
            return total
        middle = self._term(a, k // 2)
        return self.compute("add", total, self.compute("multiply", middle, middle))

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


class Looped:
    """The order that a loop is at, of series in memory; order 0 is before the loop.

    Parameters
    ----------
    lines : Assignments
    orders : int
        How many coefficients series have.
    room : callable
        Gives a place for a number of coefficients of what is computed here, from one element of the loops around to the
        next.
    serial : iterator
        Numbers for names.
    started : bool
        Whether this is the loop; else order 0.
    inside : bool
        Whether loops over elements are around, so that what does not change is in memory, too.
    stores : dict
        Series that have a place for what is computed here, and the lines that store their coefficients; shared by all.
    """

    def __init__(
        self,
        lines: Assignments,
        orders: int,
        room: Callable[[int], Place],
        serial: count[int],
        *,
        started: bool,
        inside: bool,
        stores: dict[int, tuple[Series, list[Line]]],
    ) -> None:
        self.lines, self.started, self._stores = lines, started, stores
        self._orders, self._room, self._serial, self._inside = orders, room, serial, inside
        self._now: dict[int, Operand] = {}
        self._first: dict[int, Operand] = {}
        self._number: Operand | None = None
        self._sums: list[tuple[Series, Series, str]] = []

    @property
    def number(self) -> Operand:
        """The order as a number: one more than the loop's index."""
        if not self.started:
            return 0.0
        if self._number is None:
            before = f"_k{next(self._serial)}_"
            self.lines.lines.append(Ordinal(before, ORDER))
            self._number = self.lines.compute("add", before, 1.0)
        return self._number

    def compute(self, operation: str, *arguments: Operand) -> Operand:
        """Write one operation; return its operand."""
        return self.lines.compute(operation, *arguments)

    def first(self, series: Series) -> Operand:
        """Return the coefficient of order 0."""
        if not self.started:
            return self.now(series)
        if series.place is None:
            return series.terms[0]
        if id(series) not in self._first:
            loaded = self._read(series, series.place)
            self._first[id(series)] = self.compute("unequal", loaded, 0.0) if series.truth else loaded
        return self._first[id(series)]

    def second(self, series: Series) -> Operand:
        """Return the coefficient of order 1, which in the loop's first pass is that of this order."""
        if series.constant or not self.started:
            return 0.0
        assert series.place is not None  # noqa: S101 - series that change are in memory
        place = series.place
        return self._read(series, Place(place.array, place.offset + series.apart, place.strides))

    def now(self, series: Series) -> Operand:
        """Return the coefficient of this order."""
        if self.started and series.constant:
            return 0.0
        if id(series) not in self._now and series.place is None:
            return series.terms[0]
        if id(series) not in self._now:
            self._now[id(series)] = self._read(series, self._at(series, int(self.started)))
        return self._now[id(series)]

    def convolution(self, a: Series, b: Series, *, skip: int = 0) -> Operand:
        """Sum the products: those of inner orders, ascending, then those of an end with the other's beginning."""
        if not self.started:
            return 0.0 if skip else self.compute("multiply", self.now(a), self.now(b))
        if a.constant or b.constant:
            moving, still = (b, a) if a.constant else (a, b)
            none = moving.constant or (skip == 1 and a.constant) or skip == 2
            return 0.0 if none else self.compute("multiply", self.now(moving), self.first(still))
        total = self._inner(a, b)
        if skip == 0:
            total = self.compute("add", total, self.compute("multiply", self.first(a), self.now(b)))
        if skip < 2:
            total = self.compute("add", total, self.compute("multiply", self.now(a), self.first(b)))
        return total

    def _inner(self, a: Series, b: Series) -> Operand:
        """Sum a[j]*b[k - j] over j from 1 to k - 1, by `sum_up`."""
        total = f"_s{next(self._serial)}_"
        self._sums.append((a, b, total))
        return total

    def sum_up(self) -> None:
        """Write all inner sums, which read earlier orders alone, before the other lines: some at once wait less."""
        lines = self.lines.lines
        found: list[Line] = [line for line in lines if isinstance(line, Gather)]
        found += [self._summed(self._sums[i : i + AT_ONCE]) for i in range(0, len(self._sums), AT_ONCE)]
        lines[:] = [*found, *(line for line in lines if not isinstance(line, Gather))]
        self._sums.clear()

    def _summed(self, sums: Sequence[tuple[Series, Series, str]]) -> Reduction:
        """Write some sums by one loop over their terms."""
        inner = Assignments(lambda _lines, name: name, f"_c{next(self._serial)}_")
        loaded: dict[Place, Operand] = {}
        pairs: list[tuple[Operand, Operand]] = []
        for a, b, _ in sums:
            assert a.place is not None  # noqa: S101 - series that change are in memory
            assert b.place is not None  # noqa: S101
            a.read = b.read = True
            ahead = Place(a.place.array, a.place.offset + a.apart, (*a.place.strides, (TERM, a.apart)))
            back = Place(b.place.array, b.place.offset, (*b.place.strides, (ORDER, b.apart), (TERM, -b.apart)))
            loaded |= {place: inner.load(place) for place in (ahead, back) if place not in loaded}
            pairs.append((loaded[ahead], loaded[back]))
        terms = tuple(inner.compute("multiply", *pair) for pair in pairs)
        totals = tuple(total for *_, total in sums)
        # with index i of the loop the order is k = i + 1, so that terms j = 1 + its index stay below i
        return Reduction(TERM, self._orders - 1, tuple(inner.lines), terms, totals, "add", 0.0, below=ORDER)

    def part(self, owner: Series, name: str) -> Series:
        """Return a series that is computed along with another, at a place of its own."""
        if name not in owner.parts:
            owner.parts[name] = Series()
        return owner.parts[name]

    def keep(self, series: Series, value: Operand) -> None:
        """Store the coefficient of this order."""
        if series.constant and not self._inside:
            series.terms[0] = value
            return
        if series.place is None:
            series.place = self._room(1 if series.constant else self._orders)
            self._stores[id(series)] = series, []
        self._now[id(series)] = value
        if series.truth:
            value = self.compute("choose", value, 1.0, 0.0)
        self.lines.store(self._at(series, int(self.started)), value)
        if id(series) in self._stores:
            self._stores[id(series)][1].append(self.lines.lines[-1])

    def knows(self, series: Series) -> bool:
        """Whether the coefficient of this order is written here."""
        return id(series) in self._now or (series.constant and bool(series.terms))

    def read(self, place: Place) -> Operand:
        """Read a number that does not change."""
        return self._load(place)

    def _read(self, series: Series, place: Place) -> Operand:
        series.read = True
        return self._load(place)

    def remember(self, around: Looped) -> None:
        """Know what the lines around these know."""
        self._now |= around._now
        self._first |= around._first

    def pass_on(self, series: Series, value: Operand) -> None:
        """Let a value be the coefficient of this order, of a series whose coefficients are never read again."""
        self._now[id(series)] = value

    def _at(self, series: Series, ahead: int) -> Place:
        """Return the place of a coefficient: of order 0, or of the loop's."""
        assert series.place is not None  # noqa: S101 - those of others are values
        place = series.place
        moved = ((ORDER, series.apart),) if self.started else ()
        return Place(place.array, place.offset + ahead * series.apart, (*place.strides, *moved))

    def _load(self, place: Place) -> Operand:
        name = f"_a{next(self._serial)}_"
        self.lines.lines.append(Load(name, place))
        return name

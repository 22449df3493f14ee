"""The order that a loop is at: lines that compute one coefficient of every series in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import count

from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.jets.motion import UnexpandedError
from xdynamics.kernels.jets.series import ORDER, TERM, Series
from xdynamics.kernels.program import Gather, Line, Load, Location, Operand, Ordinal, Reduction

Sum = tuple[Series, Series, str]  # of a[j]*b[k - j]: both series, and its name
AT_ONCE = 10  # sums by one loop: as many as a processor has registers for, with what they are of
NEAR = 128  # sums that are looked at for those that read the same coefficients


class Looped:
    """The order that a loop is at, of series in memory; order 0 is before the loop.

    Parameters
    ----------
    lines : Assignments
    orders : int
        How many coefficients series have.
    room : callable
        Gives a place for a number of coefficients of what is computed here, with those of all elements of the loops
        around, and how far each is from the one before.
    serial : iterator
        Numbers for names.
    started : bool
        Whether this is the loop; else order 0.
    inside : bool
        Whether loops over elements are around, so that what does not change is in memory, too.
    stores : dict
        Series that have a place for what is computed here, and the lines that store their coefficients; shared by all.
    fused : bool
    """

    high = False  # of orders in a loop all are alike

    def __init__(
        self,
        lines: Assignments,
        orders: int,
        allocate: Callable[[int], tuple[Location, int]],
        serial: count[int],
        *,
        started: bool,
        in_element_loops: bool,
        stores: dict[Series, list[Line]],
        fused: bool,
    ) -> None:
        self.lines, self.started, self._stores, self.fused = lines, started, stores, fused
        self._orders, self._allocate, self._serial, self._inside = orders, allocate, serial, in_element_loops
        self._now: dict[Series, Operand] = {}
        self._first: dict[Series, Operand] = {}
        self._number: Operand | None = None
        self._sums: list[Sum] = []

    @property
    def number(self) -> Operand:
        """The order as a number: one more than the loop's index."""
        if not self.started:
            return 0.0
        if self._number is None:
            index_name = f"_k{next(self._serial)}_"
            self.lines.lines.append(Ordinal(index_name, ORDER))
            self._number = self.lines.compute("add", index_name, 1.0)
        return self._number

    def divide_by_order(self, value: Operand) -> Operand:
        """Divide by the order."""
        return self.compute("divide", value, self.number)

    def product_added(self, a: Operand, b: Operand, total: Operand) -> Operand:
        """Write a*b + total, rounded once where that is asked for."""
        if not self.fused:
            return self.compute("add", total, self.compute("multiply", a, b))
        return self.compute("fma", a, b, total)

    def compute(self, operation: str, *arguments: Operand) -> Operand:
        """Write one operation; return its operand."""
        return self.lines.compute(operation, *arguments)

    def first(self, series: Series) -> Operand:
        """Return the coefficient of order 0.

        Raises
        ------
        UnexpandedError
            Of the greatest so far, as a loop over elements finds it: no coefficient of it is kept.
        """
        if not self.started:
            return self.now(series)
        if series.location is None and 0 not in series.terms:
            raise UnexpandedError("a total so far")
        if series.location is None:
            return series.terms[0]
        if series not in self._first:
            loaded = self._read_coefficient(series, series.location)
            self._first[series] = self.compute("unequal", loaded, 0.0) if series.truth else loaded
        return self._first[series]

    def second(self, series: Series) -> Operand:
        """Return the coefficient of order 1, which in the loop's first pass is that of this order."""
        if series.constant or not self.started:
            return 0.0
        assert series.location is not None  # noqa: S101 - series that change are in memory
        location = series.location
        return self._read_coefficient(
            series, Location(location.array, location.offset + series.stride, location.strides)
        )

    def now(self, series: Series) -> Operand:
        """Return the coefficient of this order."""
        if self.started and series.constant:
            return 0.0
        if series not in self._now and series.location is None:
            return series.terms[0]
        if series not in self._now:
            self._now[series] = self._read_coefficient(series, self._coefficient_location(series, int(self.started)))
        return self._now[series]

    def convolution(self, a: Series, b: Series, *, skip: int = 0) -> Operand:
        """Sum the products: those of inner orders, ascending, then those of an end with the other's beginning."""
        if not self.started:
            return 0.0 if skip else self.compute("multiply", self.now(a), self.now(b))
        if a.constant or b.constant:
            moving, still = (b, a) if a.constant else (a, b)
            none = moving.constant or (skip == 1 and a.constant) or skip == 2
            return 0.0 if none else self.compute("multiply", self.now(moving), self.first(still))
        total = self._inner_sum(a, b)
        if skip == 0:
            total = self.product_added(self.first(a), self.now(b), total)
        if skip < 2:
            total = self.product_added(self.now(a), self.first(b), total)
        return total

    def _inner_sum(self, a: Series, b: Series) -> Operand:
        """Sum a[j]*b[k - j] over j from 1 to k - 1, by `sum_up`."""
        total = f"_s{next(self._serial)}_"
        self._sums.append((a, b, total))
        return total

    def sum_up(self) -> None:
        """Write all inner sums, which read earlier orders alone, before the other lines: some at once wait less."""
        lines = self.lines.lines
        new_lines: list[Line] = [line for line in lines if isinstance(line, Gather)]
        group_starts = range(0, len(self._sums), AT_ONCE)
        # without fma operations take longer than reading: sums stay as archives of 31 digits have them
        groups = _group_sums(self._sums) if self.fused else (self._sums[i : i + AT_ONCE] for i in group_starts)
        new_lines += map(self._sum_loop, groups)
        lines[:] = [*new_lines, *(line for line in lines if not isinstance(line, Gather))]
        self._sums.clear()

    def _sum_loop(self, sums: Sequence[Sum]) -> Reduction:
        """Write some sums by one loop over their terms."""
        inner = Assignments(lambda _lines, name: name, f"_c{next(self._serial)}_")
        loaded: dict[Location, Operand] = {}
        pairs: list[tuple[Operand, Operand]] = []
        for a, b, _ in sums:
            assert a.location is not None  # noqa: S101 - series that change are in memory
            assert b.location is not None  # noqa: S101
            a.read = b.read = True
            ahead = Location(a.location.array, a.location.offset + a.stride, (*a.location.strides, (TERM, a.stride)))
            backward = Location(
                b.location.array, b.location.offset, (*b.location.strides, (ORDER, b.stride), (TERM, -b.stride))
            )
            loaded |= {location: inner.load(location) for location in (ahead, backward) if location not in loaded}
            pairs.append((loaded[ahead], loaded[backward]))
        totals = tuple(total for *_, total in sums)
        operation = "newest" if self.fused else "add"
        terms = tuple(
            inner.compute("fma", *pair, total) if self.fused else inner.compute("multiply", *pair)
            for pair, total in zip(pairs, totals, strict=True)
        )
        # with index i of the loop the order is k = i + 1, so that terms j = 1 + its index stay below i
        return Reduction(TERM, self._orders - 1, tuple(inner.lines), terms, totals, operation, 0.0, below=ORDER)

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
        if series.location is None:
            series.location, series.stride = self._allocate(1 if series.constant else self._orders)
            self._stores[series] = []
        self._now[series] = value
        if series.truth:
            value = self.compute("choose", value, 1.0, 0.0)
        self.lines.store(self._coefficient_location(series, int(self.started)), value)
        if series in self._stores:
            self._stores[series].append(self.lines.lines[-1])

    def knows(self, series: Series) -> bool:
        """Whether the coefficient of this order is written here."""
        return series in self._now or (series.constant and bool(series.terms))

    def read(self, location: Location) -> Operand:
        """Read a number that does not change."""
        return self._load_location(location)

    def _read_coefficient(self, series: Series, location: Location) -> Operand:
        series.read = True
        return self._load_location(location)

    def remember(self, around: Looped) -> None:
        """Know what the lines around these know."""
        self._now |= around._now
        self._first |= around._first

    def pass_on(self, series: Series, value: Operand) -> None:
        """Let a value be the coefficient of this order, of a series whose coefficients are never read again."""
        self._now[series] = value

    def _coefficient_location(self, series: Series, ahead: int) -> Location:
        """Return the place of a coefficient: of order 0, or of the loop's."""
        assert series.location is not None  # noqa: S101 - those of others are values
        location = series.location
        order_strides = ((ORDER, series.stride),) if self.started else ()
        return Location(location.array, location.offset + ahead * series.stride, (*location.strides, *order_strides))

    def _load_location(self, location: Location) -> Operand:
        name = f"_a{next(self._serial)}_"
        self.lines.lines.append(Load(name, location))
        return name


def _group_sums(sums: Sequence[Sum]) -> Iterator[list[Sum]]:
    """Yield groups of sums for a loop each, in which many read the same coefficients: reading is what takes time."""
    waiting = list(sums)
    while waiting:
        group: list[Sum] = []
        read: set[tuple[Series, bool]] = set()
        while waiting and len(group) < AT_ONCE:
            near = range(min(NEAR, len(waiting)))
            group.append(waiting.pop(min(near, key=lambda i: len(_series_read(waiting[i]) - read))))
            read |= _series_read(group[-1])
        yield group


def _series_read(entry: Sum) -> set[tuple[Series, bool]]:
    """Return the series that a sum reads, and whether from its beginning."""
    ahead, backward, _ = entry
    return {(ahead, True), (backward, False)}

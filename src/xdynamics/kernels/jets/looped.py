"""Taylor coefficients in memory, by a loop over orders: the text is as long for any degree.

The loops of the program stand inside the loop over orders, whose lines compute one coefficient of every series.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import count

from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.jets.motion import Coefficients, Env, Motion, UnexpandedError
from xdynamics.kernels.jets.recurrences import MEMORY, ORDER, TERM, Series
from xdynamics.kernels.program import (
    AT,
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
    loop_element,
)

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
    allocate : callable
        Gives a place for a number of coefficients of what is computed here, with those of all elements of the loops
        around, and how far each is from the one before.
    serial : iterator
        Numbers for names.
    started : bool
        Whether this is the loop; else order 0.
    in_element_loops : bool
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
        """Return a value over the order, by which a coefficient of a rate becomes the next one of its integral."""
        return self.compute("divide", value, self.number)

    def product_added(self, a: Operand, b: Operand, total: Operand) -> Operand:
        """Write a*b + total, rounded once if fused."""
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
        # gathered indices come first: the sums that are moved to the front read places by them
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
        """Return a series that is computed along with its owner, with a location of its own."""
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
        """Use the values that the surrounding lines have computed."""
        self._now |= around._now
        self._first |= around._first

    def pass_on(self, series: Series, value: Operand) -> None:
        """Set the coefficient of this order, of a series whose coefficients are never read again."""
        self._now[series] = value

    def _coefficient_location(self, series: Series, ahead: int) -> Location:
        """Return the location of a coefficient: of order 0, or of the loop's order."""
        assert series.location is not None  # noqa: S101 - those of others are values
        location = series.location
        order_strides = ((ORDER, series.stride),) if self.started else ()
        return Location(location.array, location.offset + ahead * series.stride, (*location.strides, *order_strides))

    def _load_location(self, location: Location) -> Operand:
        name = f"_a{next(self._serial)}_"
        self.lines.lines.append(Load(name, location))
        return name


def _group_sums(sums: Sequence[Sum]) -> Iterator[list[Sum]]:
    """Yield groups of sums, one loop each, that share many coefficients: reads take most of the time."""
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


class MovingArrayError(Exception):
    """An array that begins with constant values, and has varying ones."""


class InLoops(Coefficients):
    """Coefficients in memory, and a loop over orders.

    Parameters
    ----------
    moving : frozenset of str
        Arrays that are known to have what changes, whatever they begin with.
    """

    def __init__(
        self, forces: Program, motion: Motion, degree: int, first: int, moving: frozenset[str], *, fused: bool
    ) -> None:
        super().__init__(forces, motion, degree, first, fused=fused)
        self._moving = moving
        self.raised = frozenset[str]()  # arrays of which numbers that rise have elements of their own
        self._serial = count(1)
        self._envs: dict[int, Env] = {}
        self._stores: dict[Series, list[Line]] = {}
        self._slopes, _ = self._allocate_array(motion.coordinates + motion.states, 1)
        self._arrays: dict[str, tuple[Location, int, Series]] = {}
        self.time = Series(location=Location(MEMORY, self._reserve(degree + 1)))

    def _reserve(self, numbers: int) -> int:
        begin, self.memory = self.memory, self.memory + numbers
        return begin

    def _allocate_array(self, elements: int, orders: int) -> tuple[Location, int]:
        """Return the location of an array's first coefficient, and the stride between coefficients.

        With several of them, elements are as far from one another as there are.
        """
        return Location(MEMORY, self._reserve(elements * orders)), 1

    def state(self, location: Location) -> Series:
        """Return the series of a number of the state."""
        return Series(
            location=Location(MEMORY, self.first + location.offset, location.strides), stride=self.motion.used
        )

    def assignments(self) -> Assignments:
        """Begin lines with names of their own."""
        return Assignments(lambda _lines, name: name, f"_e{next(self._serial)}_")

    def order(self, lines: Assignments, around: Sequence[Loop | Reduction], *, started: bool) -> Looped:
        """Return the writer of an order inside some loops."""

        def allocate(numbers: int) -> tuple[Location, int]:
            strides, size = [], numbers
            for loop in reversed(around):
                strides.append((loop.index, size))
                size *= loop.count
            return Location(MEMORY, self._reserve(size), tuple(reversed(strides))), 1

        in_element_loops, stores = bool(around), self._stores
        orders, fused = self.degree + 1, self.fused
        return Looped(
            lines,
            orders,
            allocate,
            self._serial,
            started=started,
            in_element_loops=in_element_loops,
            stores=stores,
            fused=fused,
        )

    def prologue_lines(self, *, started: bool) -> list[Line]:  # noqa: ARG002 - of elements in loops
        """Return lines before those of order 0, or of any order after it."""
        return []

    def finish(self, lines: Sequence[Line]) -> None:
        """Set the lines of the program, without stores of coefficients that nothing reads."""
        unread = {id(line) for series, stores in self._stores.items() if not series.read for line in stores}
        self.lines = list(_lines_without(lines, unread))

    def body(self, order: Looped, body: Iterable[Line], env: Env, around: tuple[Loop | Reduction, ...]) -> None:
        """Write the coefficients of the values of some lines."""
        for line in body:
            match line:
                case Load() if line.location.array in self.local:
                    order.now(
                        env.setdefault(line.target, self._element_series(line.location))
                    )  # before it is written again
                case Load():
                    self.load(order, env, line)
                case Ordinal():
                    self._write_ordinal(order, env, line)
                case Compute():
                    self.compute(order, env, line)
                case StoreTo():
                    self._store_coefficient(order, line.location, self.value(env, line.value))
                case Gather():
                    order.lines.lines.append(line)
                case Loop():
                    inner, _ = self._write_pass(order, line, env, around)
                    order.lines.lines.append(self._rebuild_loop(line, tuple(inner.lines.lines)))
                case Reduction():
                    self._write_reduction(order, line, env, around)

    def _rebuild_loop(self, line: Loop, body: tuple[Line, ...]) -> Loop:
        """Return a loop with other lines."""
        return replace(line, body=body)

    def _write_pass(
        self,
        order: Looped,
        line: Loop | Reduction,
        env: Env,
        around: tuple[Loop | Reduction, ...],
        totals: Mapping[str, str] | None = None,
    ) -> tuple[Looped, Env]:
        """Write one pass of a loop, in which totals so far have names."""
        inner_env = self._envs.setdefault(id(line), {})
        pass_env = dict(env) | inner_env
        inner = self.order(self.assignments(), (*around, line), started=order.started)
        inner.remember(order)
        for total, name in (totals or {}).items():
            inner.pass_on(pass_env.setdefault(total, Series()), name)
        self.body(inner, line.body, pass_env, (*around, line))
        inner.sum_up()
        self._envs[id(line)] = {name: series for name, series in pass_env.items() if env.get(name) is not series}
        return inner, pass_env

    def _write_reduction(self, order: Looped, line: Reduction, env: Env, around: tuple[Loop | Reduction, ...]) -> None:
        """Write sums of coefficients, which are the coefficients of sums, also where a pass makes each from that before."""
        if line.operation not in ("add", "newest"):
            raise UnexpandedError(line.operation)
        names = [f"_r{next(self._serial)}_" for _ in line.totals]
        so_far = dict(zip(line.totals, names, strict=True)) if line.operation == "newest" else {}
        inner, pass_env = self._write_pass(
            order, line, {name: series for name, series in env.items() if name not in so_far}, around, so_far
        )
        terms = [self.value(pass_env, term) for term in line.terms]
        starts = [self.value(env, start) for start in line.starts]
        still = all(series.constant for series in (*terms, *starts))
        if order.started and still:
            return
        where = None if line.where is None else str(inner.first(pass_env[line.where]))
        pass_terms = tuple(inner.now(term) for term in terms)
        begin = tuple(order.now(start) for start in starts)
        order.lines.lines.append(
            replace(
                line, body=tuple(inner.lines.lines), terms=pass_terms, totals=tuple(names), start=begin, where=where
            )
        )
        for total, name in zip(line.totals, names, strict=True):
            order.keep(env.setdefault(total, Series(constant=still)), name)

    def _write_ordinal(self, order: Looped, env: Env, line: Ordinal) -> None:
        if line.target not in env:
            env[line.target] = series = Series(constant=True)
            name = f"_o{next(self._serial)}_"
            order.lines.lines.append(Ordinal(name, line.index))
            order.keep(series, name)

    def _element_series(self, location: Location) -> Series:
        """Return the series of an element of an array of the program."""
        first, row_stride, kind = self._array_series(
            location.array, Series()
        )  # in a loop, passes read what those before have written
        element_step = self.degree + 1 if row_stride == 1 else 1
        strides = tuple((index, stride * element_step) for index, stride in location.strides)
        where = Location(first.array, first.offset + location.offset * element_step, strides)
        return Series(kind.constant, kind.truth, location=where, stride=row_stride)

    def _store_coefficient(self, order: Looped, location: Location, series: Series) -> None:
        """Keep a coefficient where the program keeps the value."""
        if location.array == "z":
            if self.motion.has_slope(location):
                order.lines.store(
                    replace(
                        self._slopes,
                        offset=self._slopes.offset + location.offset - self.motion.used,
                        strides=location.strides,
                    ),
                    order.now(series),
                )
            return
        *_, kind = self._array_series(location.array, series)
        if kind.constant and not series.constant:
            raise MovingArrayError(location.array)
        if not (order.started and kind.constant):
            order.keep(self._element_series(location), order.now(series))

    def _array_series(self, name: str, series: Series) -> tuple[Location, int, Series]:
        """Return the location of an array's series, and the kind of the series it was first stored with."""
        if name not in self._arrays:
            still = series.constant and name not in self._moving
            kind = Series(still, series.truth)
            self._arrays[name] = (*self._allocate_array(self.local[name], self.degree + 1), kind)
        return self._arrays[name]

    def raise_state(self, order: Looped) -> None:
        """Write the next order of coordinates, velocities and states."""
        n, used = self.motion.coordinates, self.motion.used
        following = order.compute("add", order.number, 1.0)
        ahead, order_strides = (2, ((ORDER, used),)) if order.started else (1, ())
        of_velocities = Location(MEMORY, self.first + (ahead - 1) * used + n, (*order_strides, ("i", 1)))
        for source, target, numbers in (
            (of_velocities, 0, n),
            (replace(self._slopes, strides=(("i", 1),)), n, n + self.motion.states),
        ):
            if numbers:
                divided = (
                    Load("_slope", source),
                    Compute("_raised", "divide", ("_slope", following)),
                    StoreTo(
                        Location(MEMORY, self.first + ahead * used + target, (*order_strides, ("i", 1))), "_raised"
                    ),
                )
                order.lines.lines.append(Loop("i", numbers, divided, self.raised))


def expanded_by(write: InLoops, body: Sequence[Line], motion: Motion, degree: int, first: int) -> InLoops:
    """Write order 0, and the loop over the others.

    Raises
    ------
    MovingArrayError
        If an array was taken for one of what does not change.
    """
    env = Env()
    lines = write.assignments()
    copied = Load("_copied", loop_element("y")), StoreTo(loop_element(MEMORY, first), "_copied")
    lines.lines.append(Loop("i", motion.used, copied))
    begin = write.order(lines, (), started=False)
    assert write.time.location is not None  # noqa: S101 - it has one from the start
    where = write.time.location
    begin.keep(write.time, lines.load(Location("at", AT.index("t"))))
    # the series of time: t, 1, 0, 0, …
    zero_store = (StoreTo(loop_element(where.array, where.offset + 1), 0.0),)
    lines.lines += [Loop("i", degree, zero_store), StoreTo(replace(where, offset=where.offset + 1), 1.0)]
    prologue_end = len(lines.lines)
    write.body(begin, body, env, ())
    # only the body tells which copies of the state there are
    lines.lines[prologue_end:prologue_end] = write.prologue_lines(started=False)
    write.raise_state(begin)
    inner = write.assignments()
    order = write.order(inner, (), started=True)
    write.body(order, body, env, ())
    order.sum_up()
    write.raise_state(order)
    # one pass less than the degree: each raises the state to the order after its own
    write.finish([*lines.lines, Loop(ORDER, degree - 1, (*write.prologue_lines(started=True), *inner.lines))])
    return write


def _lines_without(lines: Iterable[Line], left_out: set[int]) -> Iterator[Line]:
    """Yield lines but some of them, known by their identities, also in loops."""
    for line in lines:
        if isinstance(line, Loop | Reduction):
            yield replace(line, body=tuple(_lines_without(line.body, left_out)))
        elif id(line) not in left_out:
            yield line

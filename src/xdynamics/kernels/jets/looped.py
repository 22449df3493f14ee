"""Coefficients in memory, by a loop over orders: the text is as long for any degree, with the loops of the program inside."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import count

from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.jets.coefficients import Coefficients, Env
from xdynamics.kernels.jets.looped_order import Looped
from xdynamics.kernels.jets.motion import Motion, UnexpandedError
from xdynamics.kernels.jets.series import MEMORY, ORDER, Series
from xdynamics.kernels.program import (
    AT,
    Compute,
    Gather,
    Line,
    Load,
    Location,
    Loop,
    Ordinal,
    Program,
    Reduction,
    StoreTo,
    loop_element,
)


class MovingArrayError(Exception):
    """An array that begins with what does not change, and has what does."""


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
        """Return the place of the first coefficient of an array's first element, and how far coefficients are apart.

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
        """Return what writes an order inside some loops."""

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
        """Take lines as the program, without what stores coefficients that nothing reads."""
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
        """Return where the series of an array of the program are, and what those that it was first seen with are like."""
        if name not in self._arrays:
            still = series.constant and name not in self._moving
            kind = Series(still, series.truth)
            self._arrays[name] = (*self._allocate_array(self.local[name], self.degree + 1), kind)
        return self._arrays[name]

    def raise_state(self, order: Looped) -> None:
        """Write what coordinates, velocities and states have one order on."""
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
    zero_store = (StoreTo(loop_element(where.array, where.offset + 1), 0.0),)
    lines.lines += [Loop("i", degree, zero_store), StoreTo(replace(where, offset=where.offset + 1), 1.0)]
    prologue_end = len(lines.lines)
    write.body(begin, body, env, ())
    lines.lines[prologue_end:prologue_end] = write.prologue_lines(started=False)
    write.raise_state(begin)
    inner = write.assignments()
    order = write.order(inner, (), started=True)
    write.body(order, body, env, ())
    order.sum_up()
    write.raise_state(order)
    write.finish([*lines.lines, Loop(ORDER, degree - 1, (*write.prologue_lines(started=True), *inner.lines))])
    return write


def _lines_without(lines: Iterable[Line], left_out: set[int]) -> Iterator[Line]:
    """Yield lines but some of them, known by their identities, also in loops."""
    for line in lines:
        if isinstance(line, Loop | Reduction):
            yield replace(line, body=tuple(_lines_without(line.body, left_out)))
        elif id(line) not in left_out:
            yield line

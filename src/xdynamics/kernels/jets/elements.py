"""Coefficients of elements in loops, so that neighbouring elements go side by side.

Coefficients of one order lie next to one another, element after element of the outermost loop; what a link needs of all
orders is near. Differences of what two elements have are computed again where they are read.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction

from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.jets.coefficients import Env
from xdynamics.kernels.jets.looped import InLoops, MovingArrayError, expanded_by
from xdynamics.kernels.jets.looped_order import Looped
from xdynamics.kernels.jets.motion import Motion
from xdynamics.kernels.jets.paired_order import Paired
from xdynamics.kernels.jets.powers import powers_of
from xdynamics.kernels.jets.quotients import begin_quotient, divided, or_nothing
from xdynamics.kernels.jets.series import HALF, MEMORY, MIDDLE, ODD, ORDER, TERM, Order, Series
from xdynamics.kernels.machine import LINE
from xdynamics.kernels.program import (
    Compute,
    Gather,
    Line,
    Load,
    Loop,
    Ordinal,
    Place,
    Program,
    Reduction,
    StoreTo,
    nested,
)


class InElements(InLoops):
    """Coefficients in memory, of loops over elements that go side by side.

    Parameters
    ----------
    forces, body, motion, degree, first, moving
        As of `InLoops`, and the lines that are needed.
    """

    def __init__(
        self,
        forces: Program,
        body: Sequence[Line],
        motion: Motion,
        degree: int,
        first: int,
        moving: frozenset[str],
    ) -> None:
        self._own: dict[int, set[str]] = {}  # of every loop: arrays whose elements are those of its passes
        self._counts: dict[str, int] = {}
        self._copies: dict[tuple[int, int, int], Place] = {}
        self._weights: dict[Fraction, tuple[Place, Place]] = {}
        self._powers = powers_of(body)
        self._sizes: dict[str, int] = {}
        super().__init__(forces, motion, degree, first, moving, fused=True)
        self.raised = frozenset((MEMORY,))

    def _room_for(self, elements: int, orders: int) -> tuple[Place, int]:
        apart = -(-elements // LINE) * LINE
        return Place(self._view(apart * orders)), apart

    def _view(self, numbers: int) -> str:
        """Return the name of a part of `w`."""
        name = f"series{len(self._sizes)}_"
        self._sizes[name] = numbers
        return name

    def finish(self, lines: Sequence[Line]) -> None:
        """Take lines as the program, and give parts of `w` that are left a place, where a line of the cache may begin."""
        super().finish(lines)
        used = {line.place.array for line in nested(self.lines) if isinstance(line, Load | StoreTo)}
        for name, numbers in self._sizes.items():
            if name in used:
                self.memory = -(-self.memory // LINE) * LINE
                self.views[name] = MEMORY, self._reserve(numbers), numbers

    def state(self, place: Place) -> Series:
        """Return the series of a number of the state: of every third number, for one, those of a copy without the others."""
        indices = dict(place.strides)
        (index, stride), *others = (*indices.items(), ("", 1))
        if len(others) != 1 or stride == 1 or index not in self._counts:
            return super().state(place)
        number = self._counts[index]
        key = place.offset, stride, number
        if key not in self._copies:
            self._copies[key] = Place(self._view(_line_of(number) * (self.degree + 1)), _first_of(number))
        return Series(place=replace(self._copies[key], strides=((index, 1),)), apart=_line_of(number))

    def order(self, lines: Assignments, around: Sequence[Loop | Reduction], *, started: bool) -> Looped:
        """Return what writes an order inside some loops."""
        if not around:
            return super().order(lines, around, started=started)
        outer, *others = around

        def room(numbers: int) -> tuple[Place, int]:
            apart = _line_of(outer.count)
            strides, size = [(outer.index, 1)], numbers * apart
            for loop in others:
                strides.append((loop.index, size))
                size *= loop.count
            name = self._view(size)
            for loop in around:
                self._own.setdefault(id(loop), set()).add(name)
            return Place(name, _first_of(outer.count), tuple(strides)), apart

        return Paired(
            lines,
            self.degree + 1,
            room,
            self._serial,
            started=started,
            inside=True,
            stores=self._stores,
            fused=True,
            weights=self._weights_for,
            depth=len(around),
        )

    def _weights_for(self, exponent: Fraction) -> tuple[Place, Place]:
        """Return where the weights of sums of a power are."""
        if exponent not in self._weights:
            name, most = self._view(2 * self.degree), self.degree
            self._weights[exponent] = Place(name, 0, ((TERM, 1),)), Place(name, most, ((TERM, 1),))
        return self._weights[exponent]

    def _looped(self, line: Loop, body: tuple[Line, ...]) -> Loop:
        return replace(line, body=body, own=frozenset(self._own.get(id(line), ())))

    def _pass(
        self,
        order: Looped,
        line: Loop | Reduction,
        env: Env,
        around: tuple[Loop | Reduction, ...],
        totals: Mapping[str, str] | None = None,
    ) -> tuple[Looped, Env]:
        self._counts[line.index] = line.count
        return super()._pass(order, line, env, around, totals)

    def load(self, order: Order, env: Env, line: Load) -> None:
        """Begin the series of a number that is read; of what changes, read it outside of loops inside."""
        super().load(order, env, line)
        if isinstance(order, Paired) and not env[line.target].constant:
            order.now(env[line.target])

    def compute(self, order: Order, env: Env, line: Compute) -> None:
        """Write the coefficient of a value."""
        if not isinstance(order, Paired) or all(self.value(env, operand).constant for operand in line.arguments):
            super().compute(order, env, line)
            return
        given = [self.value(env, operand) for operand in line.arguments]
        if line.target in self._powers.passed_over:
            if not order.started:
                value = order.compute(line.operation, *map(order.first, given))
                order.pass_on(env.setdefault(line.target, Series()), value)
        elif line.target in self._powers.made:
            self._raise(order, env, line, given)
        else:
            if line.target not in env and line.operation in ("add", "subtract") and self._are_near(given, order.depth):
                env[line.target] = Series(made=(line.operation, tuple(given)))
            super().compute(order, env, line)

    def _are_near(self, given: Iterable[Series], depth: int) -> bool:
        """Whether series are all of the state, of elements of fewer loops than are around."""
        names = {MEMORY, *(place.array for place in self._copies.values())}
        places = [series.place for series in given]
        return all(place is not None and place.array in names and len(place.strides) < depth for place in places)

    def _raise(self, order: Paired, env: Env, line: Compute, given: Sequence[Series]) -> None:
        """Write the coefficient of a power."""
        base, exponent = self._powers.made[line.target]
        of = self.value(env, base)
        if not order.started:
            own = env[line.target] = Series()
            order.keep(own, order.compute(line.operation, *map(order.first, given)))
            begin_quotient(order, own, order.first(of))
        else:
            own, divisor = env[line.target], order.first(of)
            weighted = divided(order, own, order.weighted(of, own, exponent), divisor)
            order.keep(own, or_nothing(order, divisor, weighted))

    def prepared(self, *, started: bool) -> list[Line]:
        """Return lines before those of an order: which terms its sums have, copies of the state, weights."""
        lines: list[Line] = []
        if started:
            numbers = range(self.degree - 1)
            self.tables = {"halves_": tuple(n // 2 for n in numbers), "odds_": tuple(n % 2 for n in numbers)}
            self.tables["middles_"] = tuple((n + 1) // 2 for n in numbers)
            lines += [
                Gather(index, Place(name, 0, ((ORDER, 1),)))
                for index, name in zip((HALF, ODD, MIDDLE), self.tables, strict=True)
            ]
        for (offset, stride, number), place in self._copies.items():
            ahead, used, apart = int(started), self.motion.used, _line_of(number)
            source, target = ((ORDER, used),) * ahead, ((ORDER, apart),) * ahead
            copied = (
                Load("_copied", Place(MEMORY, self.first + offset + ahead * used, (("i", stride), *source))),
                StoreTo(Place(place.array, place.offset + ahead * apart, (("i", 1), *target)), "_copied"),
            )
            lines.append(Loop("i", number, copied, frozenset((place.array,))))
        if started and self._weights:
            lines += [Ordinal("_before", ORDER), Compute("_k", "add", ("_before", 1.0))]
            lines += [self._weighted(exponent, *places) for exponent, places in self._weights.items()]
        return lines

    def _weighted(self, exponent: Fraction, low: Place, high: Place) -> Loop:
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


def _line_of(number: int) -> int:
    """Return how far rows of elements are apart: where vectors pay, an odd number of lines of the cache."""
    lines = -(-number // LINE)
    return number if lines < 2 else LINE * (lines + (lines + 1) % 2)


def _first_of(number: int) -> int:
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

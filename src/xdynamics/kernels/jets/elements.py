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
from xdynamics.kernels.jets.quotients import begin_quotient, divide_coefficient, or_nothing
from xdynamics.kernels.jets.series import HALF, MEMORY, MIDDLE, ODD, ORDER, TERM, Order, Series
from xdynamics.kernels.machine import LINE
from xdynamics.kernels.program import (
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
    nested_lines,
)


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
        """Take lines as the program, and give parts of `w` that are left a place, where a line of the cache may begin."""
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
        """Return what writes an order inside some loops."""
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
        """Begin the series of a number that is read; of what changes, read it outside of loops inside."""
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

"""Loops, reductions and array elements of one program as LLVM text: one pass after the other, or side by side.

Elements of a program's arrays and tables become addresses, loads and stores. With several runs side by side an element
is one number of each run, next to one another. With neighbouring elements of one run side by side, one place means an
element for each of them: next to one another, some distance apart, or anywhere.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial

from xdynamics.elementary import FUNCTIONS, PAIRS
from xdynamics.elementary.bounds import Interval
from xdynamics.elementary.double_double import DoubleDouble
from xdynamics.elementary.numbers import FunctionLines, LaneValue, choose
from xdynamics.elementary.text import called_intervals, written_double_doubles, written_intervals
from xdynamics.kernels.jets.recurrences import HALF, MIDDLE, ODD, ORDER
from xdynamics.kernels.link_rows import apart_from_totals
from xdynamics.kernels.program import (
    ARRAYS,
    DOUBLE_DOUBLE,
    ENCLOSED,
    FLOAT,
    INTERVAL,
    OF_FLOAT,
    Compute,
    Instruction,
    Load,
    Location,
    Loop,
    Operand,
    Program,
    Reduction,
    StoreTo,
    line_count,
    nested_lines,
)


@dataclass(frozen=True)
class Index:
    """The value of an index: known when the text is written, of the text, or a different one in every lane.

    Attributes
    ----------
    value : int or str
        Of the first lane, or of all.
    step : int
        From a lane to the next: 1 for neighbours.
    per_lane : bool
        Whether `value` has one whole number for each lane.
    """

    value: int | str
    step: int = 0
    per_lane: bool = False


class Places:
    """The places of one program.

    Parameters
    ----------
    program : Program
    lines : FunctionLines
        Where addresses are written.
    runs : int
        Numbers of an element: one for each run.
    """

    def __init__(self, program: Program, lines: FunctionLines, runs: int) -> None:
        self._program, self._lines, self._runs = program, lines, runs
        self.indices: dict[str, Index] = {}
        self.addresses: dict[str, str] = {}  # written so far in this pass and those around it

    def load(self, location: Location) -> LaneValue:
        """Read a number in every lane."""
        return self._read_element("n", location)

    def store(self, location: Location, value: LaneValue) -> None:
        """Write a number of every lane."""
        lines, kind, steps = self._lines, self._lines.kind("n"), self._lane_offsets(location)
        if steps is not None:
            # LLVM scatters by a mask only, here one that lets all lanes through
            pointers = self._pointers("double", self.pointer(location), steps)
            every = f"{lines.kind('t')} {lines.constant(value=True).text}"
            scatter_operands = f"{kind} {value.text}, {lines.kind('p')} {pointers}, i32 8, {every}"
            lines.lines.append(f"call void @llvm.masked.scatter.{lines.suffix()}.v{lines.lanes}p0({scatter_operands})")
        else:
            lines.lines.append(f"store {kind} {value.text}, ptr {self.pointer(location)}, align 8")

    def gather(self, index: str, location: Location) -> None:
        """Read an integer of a table, which is the value of an index from then on."""
        element_number = self._read_element("w", location)
        self.indices[index] = Index(element_number.text, per_lane=self._differs(location))

    def ordinal(self, index: str) -> LaneValue:
        """Return an index as a number in every lane."""
        lines, loop_index = self._lines, self.indices[index]
        if isinstance(loop_index.value, int):
            return lines.constant(float(loop_index.value))
        whole_number = (
            LaneValue(lines, "w", loop_index.value) if loop_index.per_lane else lines.broadcast("w", loop_index.value)
        )
        return (
            whole_number + LaneValue(lines, "w", self._lanes_times(loop_index.step))
            if loop_index.step
            else whole_number
        ).converted()

    def pointer(self, location: Location) -> str:
        """Return the address of an element of a given array, a view, a local array or a table: of the first lane's."""
        program, runs, scalar = self._program, self._runs, "double"
        array, first = program.views.get(location.array, (location.array, 0))[:2]
        base = f"%_{array}" if array in ARRAYS else f"%{array}"
        if location.array in program.tables:
            base, scalar, runs = f"@{program.name}.{array}", "i64", 1
        offset, index_strides = first + location.offset, []
        for name, stride in location.strides:
            index = self.indices[name]
            if isinstance(index.value, int):
                offset += index.value * stride
            elif not index.per_lane:
                index_strides.append((index.value, stride))
        if array == "z" and program.spread:
            return self._row_element(offset, index_strides)
        for value, stride in index_strides:
            number = self._shared_address(f"mul i64 {value}, {stride * runs}") if stride * runs != 1 else value
            base = self._shared_address(f"getelementptr {scalar}, ptr {base}, i64 {number}")
        return self._shared_address(f"getelementptr {scalar}, ptr {base}, i64 {offset * runs}") if offset else base

    def _row_element(self, offset: int, index_strides: list[tuple[str, int]]) -> str:
        """Return the address of an element of a row of the log, whose elements are apart."""
        number = str(offset)
        for value, stride in index_strides:
            number = self._shared_address(f"add i64 {self._shared_address(f'mul i64 {value}, {stride}')}, {number}")
        far = self._shared_address(f"mul i64 {number}, %_apart")
        return self._shared_address(f"getelementptr {self._lines.kind('n')}, ptr %_z, i64 {far}")

    def _read_element(self, letter: str, location: Location) -> LaneValue:
        lines, scalar = self._lines, {"n": "double", "w": "i64"}[letter]
        origin, steps = self.pointer(location), self._lane_offsets(location)
        if steps is not None:
            return lines.read(letter, origin, LaneValue(lines, "w", steps))
        # align 8: neighbours may begin at any element, and a vector's natural alignment would promise more
        if self._differs(location) or (letter == "n" and self._runs == lines.lanes):
            return lines.line(letter, f"load {lines.kind(letter)}, ptr {origin}, align 8")
        element_value = lines.line(letter, f"load {scalar}, ptr {origin}, align 8")
        return element_value if letter == "w" else lines.broadcast(letter, element_value.text)

    def _differs(self, location: Location) -> bool:
        """Whether lanes mean different elements."""
        return any(self.indices[name].per_lane or self.indices[name].step * stride for name, stride in location.strides)

    def _lane_offsets(self, location: Location) -> str | None:
        """Return the lanes' offsets from the first element; None if lanes read one element, or adjacent ones."""
        lines = self._lines
        lane_stride = sum(self.indices[name].step * stride for name, stride in location.strides)
        steps = LaneValue(lines, "w", self._lanes_times(lane_stride)) if lane_stride else None
        scattered = [
            (LaneValue(lines, "w", str(index.value)), stride) for index, stride in self._gathered_strides(location)
        ]
        if not scattered and lane_stride in (0, 1):
            return None
        for value, stride in scattered:
            steps = value * stride if steps is None else steps + value * stride
        return steps.text if steps is not None else None

    def _gathered_strides(self, location: Location) -> list[tuple[Index, int]]:
        return [(self.indices[name], stride) for name, stride in location.strides if self.indices[name].per_lane]

    def _lanes_times(self, step: int) -> str:
        """Return 0, step, 2 step, … in the lanes."""
        return f"<{', '.join(f'i64 {lane * step}' for lane in range(self._lines.lanes))}>"

    def _pointers(self, scalar: str, origin: str, steps: str) -> str:
        return self._shared_address(f"getelementptr {scalar}, ptr {origin}, {self._lines.kind('w')} {steps}")

    def _shared_address(self, text: str) -> str:
        """Write a line unless it is there already: a third of a text of loops was addresses written again."""
        if text not in self.addresses:
            self.addresses[text] = self._pointer_line(text)
        return self.addresses[text]

    def _pointer_line(self, text: str) -> str:
        return self._lines.line("p", text).text


UNIFORM = frozenset((ORDER, HALF, ODD, MIDDLE))  # indices that all elements share
UNROLLED = 8  # passes up to which a loop is written out; longer ones are loops
LONG = frozenset(("divide", "sqrt", *FUNCTIONS))  # operations that take longer than to join a term
WRITTEN_OUT = 600  # lines up to which it is if it has loops inside
_ALL_OF = Counter(pair for pair, _ in PAIRS.values())

Value = LaneValue | Interval | DoubleDouble
Pass = Callable[[Index, list[Value]], list[Value]]  # prints one; returns the totals after it


def paired_computations(body: Iterable[Instruction]) -> set[tuple[str, tuple[Operand, ...]]]:
    """Return the pairs of functions computed together for one argument, such as sine and cosine."""
    computed = {
        (entry.operation, entry.arguments) for entry in body if isinstance(entry, Compute) and entry.operation in PAIRS
    }
    counts = Counter((PAIRS[name][0], arguments) for name, arguments in computed)
    return {entry for entry, count in counts.items() if count == _ALL_OF[entry[0]]}


def value_parts(value: Value) -> Sequence[LaneValue]:
    """Return a number alone, or the bounds of an interval, or the two of a sum."""
    return value if isinstance(value, tuple) else (value,)


def rebuild_value(value: Value, parts: Sequence[LaneValue]) -> Value:
    """Return a number, an interval or a sum of given parts, of another value's kind."""
    return type(value)(*parts) if isinstance(value, tuple) else parts[0]


class LoopText(ABC):
    """Prints the loops of one program; its values are numbered, and the arrays that it is given have a prefix.

    Parameters
    ----------
    program : Program
    runs : int
        Runs side by side.
    abreast : int
        Neighbouring elements side by side, in the outermost loops of a single run whose passes are independent; not
        more than there are runs: none.
    """

    def __init__(self, program: Program, runs: int, abreast: int = 1) -> None:
        self._program, self._runs, self._abreast = program, runs, abreast
        self._lines = FunctionLines(runs)
        self._kinds = {
            INTERVAL: written_intervals(self._lines, rough=True).of,
            ENCLOSED: called_intervals(self._lines),
            DOUBLE_DOUBLE: written_double_doubles(self._lines, self._width_suffix).of,
        }
        self._places = Places(program, self._lines, runs)
        self._values: dict[str, Value] = {}
        self._outside: dict[str, Value] = {}  # of every lane, computed before the elements side by side
        self._joint = paired_computations(program.body)
        self._pairs: dict[tuple[str, str], str] = {}
        self._stack: list[str] = []  # lines of the beginning that take memory from the stack

    @abstractmethod
    def _print_lines(self, body: Iterable[Instruction]) -> None:
        """Print lines."""

    @abstractmethod
    def _width_suffix(self) -> str:
        """Return the suffix of functions' names where numbers have more lanes than there are runs."""

    @abstractmethod
    def _operations_of_kind(self, kind: str) -> Callable[..., Value]:
        """Return the operations of a kind of numbers."""

    def _operand_value(self, operand: Operand) -> Value:
        if not isinstance(operand, str):
            return self._lines.constant(float(operand))
        if operand not in self._values:
            value = self._outside[operand]
            repeated = [
                self._lines.broadcast(part.letter, part.text) for part in map(self._lines.value, value_parts(value))
            ]
            self._values[operand] = rebuild_value(value, repeated)
        return self._values[operand]

    def _lane_number(self, operand: Operand) -> LaneValue:
        value = self._operand_value(operand)
        assert isinstance(value, LaneValue)  # noqa: S101 - an interval is no operand of operations on numbers
        return value

    def _append_text(self, text: str) -> None:
        self._lines.lines.append(text)

    def _begin_block(self, label: str, target: str = "") -> None:
        """End the block with a branch, to the next block or to another."""
        self._append_text(f"br label %{target or label}")
        self._lines.begin(label)

    @contextmanager
    def _pass_scope(self, line: Loop | Reduction, index: Index, totals: list[Value]) -> Iterator[None]:
        """Print the lines of one pass; their values are not used after it."""
        places = self._places
        # LLVM refuses a value of a pass where that need not have been executed, as after the loop
        outside = dict(self._values), self._joint, dict(self._pairs), dict(places.indices), dict(places.addresses)
        places.indices[line.index] = index
        if isinstance(line, Reduction):
            self._values.update(zip(line.totals, totals, strict=True))
        self._joint = self._joint | paired_computations(line.body)
        self._print_lines(line.body)
        yield
        self._values, self._joint, self._pairs, places.indices, places.addresses = outside

    def _print_loop(self, line: Loop) -> None:
        wide, vector_count = self._abreast, 0
        if self._may_go_abreast() and not self._into_row(line) and line.independent:
            vector_count = line.count // wide * wide
        if vector_count:
            with self._side_by_side(wide):
                self._passes(line, 0, vector_count, wide, [])
        self._passes(line, vector_count, line.count, 1, [])

    def _may_go_abreast(self) -> bool:
        """Whether elements of a loop may go side by side: there is none around it but that of the orders of series."""
        return self._abreast > self._runs == self._lines.lanes and self._places.indices.keys() <= UNIFORM

    def _into_row(self, line: Loop) -> bool:
        """Whether a loop writes to a row of the log, whose elements are apart."""
        written_arrays = {inner.location.array for inner in nested_lines(line.body) if isinstance(inner, StoreTo)}
        return self._program.spread and any(self._program.views.get(name, (name,))[0] == "z" for name in written_arrays)

    @contextmanager
    def _side_by_side(self, wide: int) -> Iterator[None]:
        """Make every number a vector of neighbouring elements; earlier scalars are repeated in each lane."""
        self._outside, self._values, self._lines.lanes = self._values, {}, wide
        pairs, self._pairs = self._pairs, {}
        yield
        self._outside, self._values, self._lines.lanes = {}, self._outside, self._runs
        self._pairs = pairs

    def _print_reduction(self, line: Reduction) -> None:
        totals: list[Value] = [self._operand_value(start) for start in line.starts]
        if line.kind != FLOAT:
            operate, of_float = self._operations_of_kind(line.kind), OF_FLOAT[line.kind]
            pairs = zip(line.starts, totals, strict=True)
            totals = [value if isinstance(start, str) else operate(of_float, value) for start, value in pairs]
        vector_end, totals = self._sums_abreast(line, totals)
        totals = (
            self._bounded(line, totals)
            if line.below or line.above
            else self._passes(line, vector_end, line.count, 1, totals)
        )
        self._values.update(zip(line.totals, totals, strict=True))

    def _sums_abreast(self, line: Reduction, totals: list[Value]) -> tuple[int, list[Value]]:
        """Print the sum of neighbouring numbers side by side, where no order changes it; return where the rest begins.

        One after the other, such sums were a seventh of the time of a step.
        """
        wide = self._abreast
        if not line.in_any_order or wide <= self._runs or self._places.indices or self._reads_row(line):
            return 0, totals
        vector_end, lines = line.count // wide * wide, self._lines
        if not vector_end:
            return 0, totals
        with self._side_by_side(wide):
            sums = self._passes(line, 0, vector_end, wide, [*map(self._operand_value, line.starts)])
            parts = [lines.value(part) for value in sums for part in value_parts(value)]
            texts = [f"extractelement {lines.kind(part.letter)} {part.text}, i64" for part in parts]
        for lane in range(wide):
            totals = [total + lines.line("n", f"{text} {lane}") for total, text in zip(totals, texts, strict=True)]
        return vector_end, totals

    def _reads_row(self, line: Reduction) -> bool:
        """Whether a sum reads a row of the log, whose elements are not adjacent."""
        read = {inner.location.array for inner in nested_lines(line.body) if isinstance(inner, Load)}
        return self._program.spread and any(self._program.views.get(name, (name,))[0] == "z" for name in read)

    def _bounded(self, line: Reduction, totals: list[Value]) -> list[Value]:
        """Print the passes before, or after, the number of an index; of lanes with several numbers some by a mask."""
        bound_index = self._places.indices[line.below or line.above]
        if isinstance(bound_index.value, int):
            bounds = (0, bound_index.value) if line.below else (bound_index.value + 1, line.count)
            return self._passes(line, *bounds, 1, totals) if bounds[0] < bounds[1] else totals
        beyond = self._lines.line(
            "p", f"add i64 {bound_index.value}, {self._lines.lanes if bound_index.step else 1}"
        ).text
        one_pass, masked = partial(self._one_pass, line), partial(self._one_pass, line, masked=True)
        if not bound_index.step:
            return self._ascending_passes(
                line, *(("0", bound_index.value) if line.below else (beyond, str(line.count))), totals
            )
        if line.below:
            return self._dynamic_passes(
                masked, bound_index.value, beyond, self._dynamic_passes(one_pass, "0", bound_index.value, totals)
            )
        return self._dynamic_passes(
            one_pass, beyond, str(line.count), self._dynamic_passes(masked, bound_index.value, beyond, totals)
        )

    def _ascending_passes(self, line: Reduction, first: str, last: str, totals: list[Value]) -> list[Value]:
        """Print passes between two numbers; terms that take long come side by side, and are joined one after the other."""
        if self._takes_long(line):
            number = self._lines.line("p", f"sub i64 {last}, {first}").text
            vector_count = self._lines.line("p", f"and i64 {number}, {-self._abreast}").text
            vector_end = self._lines.line("p", f"add i64 {first}, {vector_count}").text
            totals = self._dynamic_passes(partial(self._terms_abreast, line), first, vector_end, totals, self._abreast)
            first = vector_end
        return self._dynamic_passes(partial(self._one_pass, line), first, last, totals)

    def _takes_long(self, line: Reduction) -> bool:
        """Whether terms of a single run may be computed side by side, and gain by that."""
        return (
            self._abreast > self._runs == self._lines.lanes
            and line.kind == FLOAT
            and not (line.where or self._reads_row(line))
            and all(isinstance(inner, Load | Compute) for inner in line.body)
            and any(isinstance(inner, Compute) and inner.operation in LONG for inner in apart_from_totals(line)[0])
        )

    def _terms_abreast(self, line: Reduction, index: Index, totals: list[Value]) -> list[Value]:
        """Print independent terms of neighbours side by side; return the totals, joined one after the other."""
        wide, kind = self._abreast, f"<{self._abreast} x double>"
        lines, joining = apart_from_totals(line)
        read = {*line.terms, *(name for inner in joining for name in inner.arguments)}
        targets = [inner.target for inner in lines if isinstance(inner, Load | Compute) and inner.target in read]
        with (
            self._side_by_side(wide),
            self._pass_scope(replace(line, body=lines, totals=()), Index(index.value, 1), []),
        ):
            terms = {name: self._lane_number(name).text for name in targets}
        values, self._values = self._values, dict(self._values)
        for lane in range(wide):
            self._values.update(zip(line.totals, totals, strict=True))
            for name, text in terms.items():
                self._values[name] = self._lines.line("n", f"extractelement {kind} {text}, i64 {lane}")
            self._print_lines(joining)
            totals = self._join_terms(line, totals)
        self._values = values
        return totals

    def _dynamic_passes(self, one_pass: Pass, first: str, last: str, totals: list[Value], step: int = 1) -> list[Value]:
        """Print passes between two numbers that are known as the program runs; there may be none."""
        lines, label, entry_block = self._lines, self._lines.label(), self._lines.block
        self._append_text(f"%{label}any = icmp ult i64 {first}, {last}")
        self._append_text(f"br i1 %{label}any, label %{label}, label %{label}end")
        lines.begin(label)
        index, head = f"%{label}i", len(lines.lines)
        carried = self._phis(label, totals, "t")
        new = one_pass(Index(index), carried)
        phis = [f"{index} = phi i64 [ {first}, %{entry_block} ], [ {index}n, %{lines.block} ]"]
        # LLVM wants phis first in their block, and what they join is known after the pass is written
        lines.lines[head:head] = phis + self._merged(carried, totals, entry_block, new)
        self._append_text(f"{index}n = add i64 {index}, {step}")
        self._append_text(f"{index}c = icmp ult i64 {index}n, {last}")
        self._append_text(f"br i1 {index}c, label %{label}, label %{label}end")
        last_block = lines.block
        lines.begin(f"{label}end")
        merged_totals = self._phis(label, totals, "e")
        lines.lines += self._merged(merged_totals, totals, entry_block, new, last_block)
        return merged_totals

    def _phis(self, label: str, totals: list[Value], letter: str) -> list[Value]:
        """Name the totals where two branches of the text meet."""
        parts = [[self._lines.value(part) for part in value_parts(total)] for total in totals]
        return [
            rebuild_value(
                total,
                [LaneValue(self._lines, part.letter, f"%{label}{letter}{i}.{k}") for k, part in enumerate(total_parts)],
            )
            for i, (total, total_parts) in enumerate(zip(totals, parts, strict=True))
        ]

    def _merged(
        self, names: list[Value], old: list[Value], entry_block: str, new: list[Value], last_block: str = ""
    ) -> list[str]:
        """Return the phi lines of totals: their former values, or those of a pass."""
        lines, phis = self._lines, []
        for name, *alternatives in zip(names, old, new, strict=True):
            for part, first, second in zip(
                value_parts(name),
                *(map(lines.value, value_parts(alternative)) for alternative in alternatives),
                strict=True,
            ):
                ends = f"[ {first.text}, %{entry_block} ], [ {second.text}, %{last_block or lines.block} ]"
                phis.append(f"{part.text} = phi {lines.kind(part.letter)} {ends}")
        return phis

    def _passes(self, line: Loop | Reduction, first: int, last: int, step: int, totals: list[Value]) -> list[Value]:
        """Print passes of a loop, written out if they are few; return the totals after them."""
        if step == 1 and last - first <= self._unroll_limit(line, goes_on=first > 0):
            for k in range(first, last):
                totals = self._one_pass(line, Index(k), totals)
            return totals
        lines, label, entry_block = self._lines, self._lines.label(), self._lines.block
        self._begin_block(label)
        index, head = f"%{label}i", len(lines.lines)
        carried = self._phis(label, totals, "t")
        new = self._one_pass(line, Index(index, int(step > 1)), carried)
        phis = [f"{index} = phi i64 [ {first}, %{entry_block} ], [ {index}n, %{lines.block} ]"]
        lines.lines[head:head] = phis + self._merged(carried, totals, entry_block, new)
        self._append_text(f"{index}n = add i64 {index}, {step}")
        self._append_text(f"{index}c = icmp ult i64 {index}n, {last}")
        self._append_text(f"br i1 {index}c, label %{label}, label %{label}end")
        lines.begin(f"{label}end")
        return new

    def _unroll_limit(self, line: Loop | Reduction, *, goes_on: bool) -> int:
        """Return how many passes are written out; of remaining passes one, so that texts of all sizes are alike."""
        if goes_on:
            return 1
        longest = any(isinstance(inner, Loop | Reduction) for inner in line.body)
        return min(UNROLLED, WRITTEN_OUT // max(1, line_count(line.body))) if longest else UNROLLED

    def _one_pass(
        self, line: Loop | Reduction, index: Index, totals: list[Value], *, masked: bool = False
    ) -> list[Value]:
        """Print one pass; return the totals after it."""
        with self._pass_scope(line, index, totals):
            if isinstance(line, Loop):
                return totals
            new_totals = self._join_terms(line, totals)
            if line.where or masked:
                truth = self._bound_mask(line, index) if masked else self._operand_value(str(line.where))
                new_totals = [
                    rebuild_value(
                        old, [choose(truth, *pair) for pair in zip(value_parts(new), value_parts(old), strict=True)]
                    )
                    for old, new in zip(totals, new_totals, strict=True)
                ]
            return new_totals

    def _join_terms(self, line: Reduction, totals: list[Value]) -> list[Value]:
        """Join totals with the terms of a pass."""
        join = partial(self._operations_of_kind(line.kind), line.operation)
        return [join(total, self._operand_value(term)) for total, term in zip(totals, line.terms, strict=True)]

    def _bound_mask(self, line: Reduction, index: Index) -> LaneValue:
        """Return in which lanes a pass is before, or after, the number of the index that bounds it."""
        indices = self._places.indices
        indices[line.index] = index
        ordinal, bound = (self._places.ordinal(name) for name in (line.index, line.below or line.above))
        return ordinal < bound if line.below else ordinal > bound

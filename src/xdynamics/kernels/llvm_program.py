"""The lines of one program as LLVM text, for one run, for runs side by side, and for neighbouring elements of one run.

In lanes every number is a vector with one element for each run or for each neighbour, and an operation acts on each
element by itself. Nothing is summed across lanes, contracted or reordered, so a lane holds the bits of a single run.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial

from xdynamics.elementary import FUNCTIONS, PAIRS
from xdynamics.elementary.bounds import Interval
from xdynamics.elementary.llvm_numbers import FunctionLines, LaneValue
from xdynamics.elementary.numbers import choose
from xdynamics.elementary.piecewise import POLYNOMIALS, find_piece
from xdynamics.elementary.text import struct_of, written_intervals
from xdynamics.kernels.heap_arrays import MOST_ON_STACK, refusal
from xdynamics.kernels.llvm_places import Index, Places
from xdynamics.kernels.operations import RULES
from xdynamics.kernels.program import (
    ARRAYS,
    AT,
    FLOAT,
    INTERVAL,
    Compute,
    EngineCall,
    Gather,
    Instruction,
    Load,
    Loop,
    Operand,
    Ordinal,
    Place,
    Program,
    ProgramCall,
    Reduction,
    StoreTo,
    When,
    While,
    nested,
    size,
    soundness,
)

UNROLLED = 8  # passes up to which a loop is written out; longer ones are loops
WRITTEN_OUT = 600  # lines up to which it is if it has loops inside
UNSOUND = "unsound"
LOOKED_UP = ("piece_of", "find_piece", *POLYNOMIALS)  # in tables: the piece of a drive of time, of an argument, …
_ALL_OF = Counter(pair for pair, _ in PAIRS.values())

Value = LaneValue | Interval


def together(body: Iterable[Instruction]) -> set[tuple[str, tuple[Operand, ...]]]:
    """Return what is computed together for one argument, such as a sine and a cosine."""
    computed = {
        (entry.operation, entry.arguments) for entry in body if isinstance(entry, Compute) and entry.operation in PAIRS
    }
    counts = Counter((PAIRS[name][0], arguments) for name, arguments in computed)
    return {entry for entry, count in counts.items() if count == _ALL_OF[entry[0]]}


class ProgramText:
    """Prints one program; its values are numbered, and the arrays that it is given have a prefix.

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
        self._intervals = written_intervals(self._lines, rough=True)
        self._places = Places(program, self._lines, runs)
        self._values: dict[str, Value] = {}
        self._outside: dict[str, Value] = {}  # of every lane, computed before the elements side by side
        self._joint = together(program.body)
        self._pairs: dict[tuple[str, str], str] = {}

    def body(self) -> str:
        """Print the lines of the function."""
        sizes = {name: max(1, count) * self._runs for name, count in self._program.local.items()}
        on_heap = [name for name, numbers in sizes.items() if numbers > MOST_ON_STACK]
        for name, numbers in sizes.items():
            where = (
                f"call ptr @malloc(i64 {8 * numbers})" if name in on_heap else f"alloca double, i64 {numbers}, align 8"
            )
            self._put(f"%{name} = {where}")
        if on_heap:
            unsound = self._places.pointer(Place("at", AT.index(UNSOUND)))
            self._lines.lines += refusal(on_heap, unsound, self._runs)
            self._lines.begin("given")
        self._print(self._program.body)
        if self._program.sound:
            self._answer(*self._program.sound)
        for name in on_heap:
            self._put(f"call void @free(ptr %{name})")
        self._put("ret void")
        return "\n".join(self._lines.lines)

    def _answer(self, first: int, count: int) -> None:
        """Set `unsound`."""
        self._print((soundness("z", first, count, "_sum"), StoreTo(Place("at", AT.index(UNSOUND)), "_sum")))

    def _print(self, body: Iterable[Instruction]) -> None:
        for line in body:
            match line:
                case Load():
                    self._values[line.target] = self._places.load(line.place)
                case StoreTo():
                    self._places.store(line.place, self._number(line.value))
                case Gather():
                    self._places.gather(line.index, line.place)
                case Ordinal():
                    self._values[line.target] = self._places.ordinal(line.index)
                case Compute():
                    self._values[line.target] = self._computed(line)
                case Loop():
                    self._loop(line)
                case Reduction():
                    self._reduce(line)
                case ProgramCall():
                    self._call(line)
                case EngineCall():
                    self._enter(line)
                case When() | While():
                    self._if_any(line)

    # -------------------------------------------------------------------------------------------------------- blocks

    def _call(self, line: ProgramCall) -> None:
        passed = {"at": line.at, "y": line.y, "z": line.z, "e": line.e}
        arrays = [self._places.pointer(Place(passed.get(array, array))) for array in ARRAYS]
        self._put(f"call void @{line.program}.inner({', '.join(f'ptr {array}' for array in arrays)}, i64 1)")

    def _enter(self, line: EngineCall) -> None:
        """Print a call of the engine, which is given the time, and the table entry of `z`: of that, its address alone."""

        def loaded(kind: str, array: str, place: int) -> str:
            pointer = self._places.pointer(Place(array, place))
            return self._lines.line("p", f"load {kind}, ptr {pointer}, align 8").text

        run, function = (loaded("i64", "p", line.first + k) for k in range(2))
        time = loaded("double", "at", AT.index("t"))
        self._put("%_entry = alloca i64, i64 3, align 8")
        self._put("store ptr %_z, ptr %_entry, align 8")
        entry = self._lines.line("p", "ptrtoint ptr %_entry to i64").text
        called = self._lines.line("p", f"inttoptr i64 {function} to ptr").text
        self._put(f"call void {called}(i64 {run}, double {time}, i64 {entry})")

    def _if_any(self, line: When | While) -> None:
        """Print a call made if a number is nonzero in some lane, once or as long as it is."""
        label = self._lines.label()
        self._begin(label)
        nonzero = self._lines.some(self._places.load(line.place) != 0.0)
        self._put(f"br i1 {nonzero}, label %{label}call, label %{label}end")
        self._lines.begin(f"{label}call")
        self._call(line.call)
        self._begin(f"{label}end", label if isinstance(line, While) else f"{label}end")

    def _begin(self, label: str, target: str = "") -> None:
        """End the block with a branch, to the next block or to another."""
        self._put(f"br label %{target or label}")
        self._lines.begin(label)

    @contextmanager
    def _pass(self, line: Loop | Reduction, index: Index, totals: list[Value]) -> Iterator[None]:
        """Print the lines of one pass; what they compute is forgotten after it."""
        outside = dict(self._values), self._joint, dict(self._pairs), dict(self._places.indices)
        self._places.indices[line.index] = index
        if isinstance(line, Reduction):
            self._values.update(zip(line.totals, totals, strict=True))
        self._joint = self._joint | together(line.body)
        self._print(line.body)
        yield
        self._values, self._joint, self._pairs, self._places.indices = outside

    def _loop(self, line: Loop) -> None:
        wide, whole = self._abreast, 0
        if wide > self._runs and not self._places.indices and not self._into_row(line) and line.independent:
            whole = line.count // wide * wide
        if whole:
            with self._side_by_side(wide):
                self._passes(line, 0, whole, wide, [])
        self._passes(line, whole, line.count, 1, [])

    def _into_row(self, line: Loop) -> bool:
        """Whether a loop writes to a row of the log, whose elements are apart."""
        written = {inner.place.array for inner in nested(line.body) if isinstance(inner, StoreTo)}
        return self._program.spread and any(self._program.views.get(name, (name,))[0] == "z" for name in written)

    @contextmanager
    def _side_by_side(self, wide: int) -> Iterator[None]:
        """Let every number be a vector of neighbouring elements; what was computed before is repeated for each."""
        self._outside, self._values, self._lines.lanes = self._values, {}, wide
        pairs, self._pairs = self._pairs, {}
        yield
        self._outside, self._values, self._lines.lanes = {}, self._outside, self._runs
        self._pairs = pairs

    def _reduce(self, line: Reduction) -> None:
        totals: list[Value] = [self._operand(start) for start in line.starts]
        if line.kind == INTERVAL:
            of = self._intervals.of
            pairs = zip(line.starts, totals, strict=True)
            totals = [value if isinstance(start, str) else of("point", value) for start, value in pairs]
        totals = (
            self._bounded(line, totals) if line.below or line.above else self._passes(line, 0, line.count, 1, totals)
        )
        self._values.update(zip(line.totals, totals, strict=True))

    def _bounded(self, line: Reduction, totals: list[Value]) -> list[Value]:
        """Print the passes before, or after, the number of an index; of lanes with several numbers some by a mask."""
        of = self._places.indices[line.below or line.above]
        if isinstance(of.value, int):
            bounds = (0, of.value) if line.below else (of.value + 1, line.count)
            return self._passes(line, *bounds, 1, totals) if bounds[0] < bounds[1] else totals
        beyond = self._lines.line("p", f"add i64 {of.value}, {self._lines.lanes if of.step else 1}").text
        if not of.step:
            return self._inner(line, *(("0", of.value) if line.below else (beyond, str(line.count))), totals)
        if line.below:
            return self._inner(line, of.value, beyond, self._inner(line, "0", of.value, totals), masked=True)
        return self._inner(line, beyond, str(line.count), self._inner(line, of.value, beyond, totals, masked=True))

    def _inner(
        self, line: Reduction, first: str, last: str, totals: list[Value], *, masked: bool = False
    ) -> list[Value]:
        """Print passes between two numbers that are known when they are made; there may be none."""
        lines, label, before = self._lines, self._lines.label(), self._lines.block
        self._put(f"%{label}any = icmp ult i64 {first}, {last}")
        self._put(f"br i1 %{label}any, label %{label}, label %{label}end")
        lines.begin(label)
        index, head = f"%{label}i", len(lines.lines)
        carried = self._phis(label, totals, "t")
        new = self._made(line, Index(index), carried, masked=masked)
        phis = [f"{index} = phi i64 [ {first}, %{before} ], [ {index}n, %{lines.block} ]"]
        lines.lines[head:head] = phis + self._merged(carried, totals, before, new)
        self._put(f"{index}n = add i64 {index}, 1")
        self._put(f"{index}c = icmp ult i64 {index}n, {last}")
        self._put(f"br i1 {index}c, label %{label}, label %{label}end")
        inside = lines.block
        lines.begin(f"{label}end")
        joined = self._phis(label, totals, "e")
        lines.lines += self._merged(joined, totals, before, new, inside)
        return joined

    def _phis(self, label: str, totals: list[Value], letter: str) -> list[Value]:
        """Name what totals are where two ways through the text meet."""
        parts = [[self._lines.value(part) for part in _parts(total)] for total in totals]
        return [
            _like(
                total, [LaneValue(self._lines, part.letter, f"%{label}{letter}{i}.{k}") for k, part in enumerate(own)]
            )
            for i, (total, own) in enumerate(zip(totals, parts, strict=True))
        ]

    def _merged(
        self, names: list[Value], old: list[Value], before: str, new: list[Value], inside: str = ""
    ) -> list[str]:
        """Return lines that say what totals are: as they were, or as a pass left them."""
        lines, phis = self._lines, []
        for name, *ways in zip(names, old, new, strict=True):
            for part, first, second in zip(_parts(name), *(map(lines.value, _parts(way)) for way in ways), strict=True):
                ends = f"[ {first.text}, %{before} ], [ {second.text}, %{inside or lines.block} ]"
                phis.append(f"{part.text} = phi {lines.kind(part.letter)} {ends}")
        return phis

    def _passes(self, line: Loop | Reduction, first: int, last: int, step: int, totals: list[Value]) -> list[Value]:
        """Print passes of a loop, written out if they are few; return the totals after them."""
        if step == 1 and last - first <= UNROLLED and (last - first) * size(line.body) <= self._most(line):
            for k in range(first, last):
                totals = self._made(line, Index(k), totals)
            return totals
        lines, label, before = self._lines, self._lines.label(), self._lines.block
        self._begin(label)
        index, head = f"%{label}i", len(lines.lines)
        carried = self._phis(label, totals, "t")
        new = self._made(line, Index(index, int(step > 1)), carried)
        phis = [f"{index} = phi i64 [ {first}, %{before} ], [ {index}n, %{lines.block} ]"]
        lines.lines[head:head] = phis + self._merged(carried, totals, before, new)
        self._put(f"{index}n = add i64 {index}, {step}")
        self._put(f"{index}c = icmp ult i64 {index}n, {last}")
        self._put(f"br i1 {index}c, label %{label}, label %{label}end")
        lines.begin(f"{label}end")
        return new

    def _most(self, line: Loop | Reduction) -> float:
        return WRITTEN_OUT if any(isinstance(inner, Loop | Reduction) for inner in line.body) else float("inf")

    def _made(self, line: Loop | Reduction, index: Index, totals: list[Value], *, masked: bool = False) -> list[Value]:
        """Print one pass; return the totals after it."""
        with self._pass(line, index, totals):
            if isinstance(line, Loop):
                return totals
            joined = [
                self._of(line.kind)(line.operation, total, self._operand(term))
                for total, term in zip(totals, line.terms, strict=True)
            ]
            if line.where or masked:
                truth = self._side(line, index) if masked else self._operand(str(line.where))
                joined = [
                    _like(old, [choose(truth, *pair) for pair in zip(_parts(new), _parts(old), strict=True)])
                    for old, new in zip(totals, joined, strict=True)
                ]
            return joined

    def _side(self, line: Reduction, index: Index) -> LaneValue:
        """Return in which lanes a pass is before, or after, the number of the index that bounds it."""
        indices = self._places.indices
        indices[line.index] = index
        own, bound = (self._places.ordinal(name) for name in (line.index, line.below or line.above))
        return own < bound if line.below else own > bound

    # ---------------------------------------------------------------------------------------------------- operations

    def _of(self, kind: str) -> Callable[..., Value]:
        return self._intervals.of if kind == INTERVAL else lambda operation, *operands: RULES[operation](*operands)

    def _computed(self, line: Compute) -> Value:
        name, arguments = line.operation, line.arguments
        if line.kind != FLOAT or name in RULES:
            return self._of(line.kind)(name, *map(self._operand, arguments))
        if name in LOOKED_UP:
            return self._looked_up(name, arguments)
        numbers = [self._number(argument) for argument in arguments]
        if name in PAIRS and (PAIRS[name][0], arguments) in self._joint:
            return self._one_of(*PAIRS[name], numbers[0].text)
        if name in FUNCTIONS:
            return self._lines.call(f"elementary_{name}{self._width()}", numbers)
        # a function that was passed in
        return self._lines.by_lane(lambda *scalars: self._lines.call(f"_{name}", list(scalars)), numbers)

    def _looked_up(self, name: str, arguments: tuple[Operand, ...]) -> LaneValue:
        """Find a piece of a table, or evaluate one; each lane may be in a different piece."""
        lines, drive = self._lines, arguments[-1]
        assert isinstance(drive, int)  # noqa: S101 - which table is known when the program is written
        places = [self._places.pointer(Place("pieces", 3 * drive + k)) for k in range(3)]
        if name == "piece_of":
            return lines.line("w", f"load {lines.kind('w')}, ptr {places[2]}, align 8")
        first, count = (lines.line("w", f"load i64, ptr {place}, align 8").text for place in places[:2])
        origin = lines.line("p", f"getelementptr double, ptr %_tables, i64 {first}").text

        def read(row: int, piece: LaneValue) -> LaneValue:
            far = lines.line("w", f"mul i64 {count}, {row}").text
            begin = lines.line("p", f"getelementptr double, ptr {origin}, i64 {far}").text
            return lines.read("n", begin, piece)

        given = [self._number(argument) for argument in arguments[:-1]]
        if name in POLYNOMIALS:  # no gathers: lanes that are in one piece read the same numbers
            return lines.by_lane(partial(POLYNOMIALS[name], read), given)
        found = find_piece(read, lines.broadcast("w", count), *given)
        assert isinstance(found, LaneValue)  # noqa: S101 - of written numbers
        return found

    def _one_of(self, pair: str, place: int, argument: str) -> LaneValue:
        """Compute functions of one argument together, and return one of them."""
        lines = self._lines
        kind = struct_of(pair, lines.lanes)
        if (pair, argument) not in self._pairs:
            call = f"call {kind} @elementary_{pair}{self._width()}({lines.kind('n')} {argument})"
            self._pairs[pair, argument] = lines.line("n", call).text
        return lines.line("n", f"extractvalue {kind} {self._pairs[pair, argument]}, {place}")

    def _width(self) -> str:
        """Return the suffix of functions of as many numbers as there are lanes now."""
        return "" if self._lines.lanes == self._runs else f".{self._lines.lanes}"

    def _operand(self, operand: Operand) -> Value:
        if not isinstance(operand, str):
            return self._lines.constant(float(operand))
        if operand not in self._values:
            value = self._outside[operand]
            repeated = [self._lines.broadcast(part.letter, part.text) for part in map(self._lines.value, _parts(value))]
            self._values[operand] = _like(value, repeated)
        return self._values[operand]

    def _number(self, operand: Operand) -> LaneValue:
        value = self._operand(operand)
        assert isinstance(value, LaneValue)  # noqa: S101 - an interval is no operand of operations on numbers
        return value

    def _put(self, text: str) -> None:
        self._lines.lines.append(text)


def _parts(value: Value) -> Sequence[LaneValue]:
    return value if isinstance(value, Interval) else (value,)


def _like(value: Value, parts: Sequence[LaneValue]) -> Value:
    return Interval(*parts) if isinstance(value, Interval) else parts[0]

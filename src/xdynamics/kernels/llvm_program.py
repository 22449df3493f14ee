"""The lines of one program as LLVM text, for one run, for runs side by side, and for neighbouring elements of one run.

In lanes every number is a vector with one element for each run or for each neighbour, and an operation acts on each
element by itself. Nothing is summed across lanes, contracted or reordered, so a lane holds the bits of a single run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial

from xdynamics.elementary import FUNCTIONS, PAIRS
from xdynamics.elementary.llvm_numbers import LaneValue
from xdynamics.elementary.past_pieces import PAST, width_of
from xdynamics.elementary.piecewise import POLYNOMIALS, find_piece
from xdynamics.elementary.text import struct_of
from xdynamics.kernels.heap_arrays import MOST_ON_STACK, refusal
from xdynamics.kernels.llvm_loops import Value
from xdynamics.kernels.llvm_rows import RowText
from xdynamics.kernels.operations import RULES
from xdynamics.kernels.program import (
    ARRAYS,
    AT,
    FLOAT,
    Compute,
    EngineCall,
    Gather,
    Instruction,
    Load,
    Loop,
    Operand,
    Ordinal,
    Place,
    ProgramCall,
    Reduction,
    StoreTo,
    When,
    While,
    soundness,
)

UNSOUND = "unsound"
LOOKED_UP = ("piece_of", "find_piece", *POLYNOMIALS)  # in tables: the piece of a drive of time, of an argument, …


class ProgramText(RowText):
    """Prints one program."""

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
        return "\n".join([*self._stack, *self._lines.lines])

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

    # ---------------------------------------------------------------------------------------------------- operations

    def _of(self, kind: str) -> Callable[..., Value]:
        return self._kinds.get(kind) or (lambda operation, *operands: RULES[operation](*operands))

    def _computed(self, line: Compute) -> Value:
        name, arguments = line.operation, line.arguments
        if line.kind != FLOAT or name in RULES:
            return self._of(line.kind)(name, *map(self._operand, arguments))
        if name in LOOKED_UP:
            return self._looked_up(name, arguments)
        if name in PAST:
            return self._looked_back(name, arguments)
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

    def _looked_back(self, name: str, arguments: tuple[Operand, ...]) -> LaneValue:
        """Evaluate a step of the past, of those that a delay is set to."""
        lines, (time, *numbers) = self._lines, arguments
        slot, component, components, degree = map(int, numbers)
        places = [self._places.pointer(Place("pieces", 3 * slot + k)) for k in range(2)]
        first, count = (lines.line("w", f"load i64, ptr {place}, align 8") for place in places)
        origin = lines.line("p", f"getelementptr double, ptr %_tables, i64 {first.text}").text
        width = width_of(components, degree)

        def read(row: int, piece: LaneValue) -> LaneValue:
            return lines.read("n", origin, piece * width + row)

        return PAST[name](read, count, self._number(time), component, components, degree)

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

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
from xdynamics.kernels.heap_arrays import MOST_ON_STACK, refusal_lines
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
    Location,
    Loop,
    Operand,
    Ordinal,
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
            self._append_text(f"%{name} = {where}")
        if on_heap:
            unsound = self._places.pointer(Location("at", AT.index(UNSOUND)))
            self._lines.lines += refusal_lines(on_heap, unsound, self._runs)
            self._lines.begin("given")
        self._print_lines(self._program.body)
        if self._program.sound:
            self._set_unsound(*self._program.sound)
        for name in on_heap:
            self._append_text(f"call void @free(ptr %{name})")
        self._append_text("ret void")
        return "\n".join([*self._stack, *self._lines.lines])

    def _set_unsound(self, first: int, count: int) -> None:
        """Set `unsound`."""
        self._print_lines((soundness("z", first, count, "_sum"), StoreTo(Location("at", AT.index(UNSOUND)), "_sum")))

    def _print_lines(self, body: Iterable[Instruction]) -> None:
        for line in body:
            match line:
                case Load():
                    self._values[line.target] = self._places.load(line.location)
                case StoreTo():
                    self._places.store(line.location, self._lane_number(line.value))
                case Gather():
                    self._places.gather(line.index, line.location)
                case Ordinal():
                    self._values[line.target] = self._places.ordinal(line.index)
                case Compute():
                    self._values[line.target] = self._compute_value(line)
                case Loop():
                    self._print_loop(line)
                case Reduction():
                    self._print_reduction(line)
                case ProgramCall():
                    self._call_program(line)
                case EngineCall():
                    self._call_engine(line)
                case When() | While():
                    self._if_any(line)

    # -------------------------------------------------------------------------------------------------------- blocks

    def _call_program(self, line: ProgramCall) -> None:
        passed = {"at": line.at, "y": line.y, "z": line.z, "e": line.e}
        arrays = [self._places.pointer(Location(passed.get(array, array))) for array in ARRAYS]
        self._append_text(f"call void @{line.program}.inner({', '.join(f'ptr {array}' for array in arrays)}, i64 1)")

    def _call_engine(self, line: EngineCall) -> None:
        """Print a call of the engine, which is given the time, and the table entry of `z`: of that, its address alone."""

        def load_word(kind: str, array: str, word_index: int) -> str:
            pointer = self._places.pointer(Location(array, word_index))
            return self._lines.line("p", f"load {kind}, ptr {pointer}, align 8").text

        run, function = (load_word("i64", "p", line.first + k) for k in range(2))
        time = load_word("double", "at", AT.index("t"))
        self._append_text("%_entry = alloca i64, i64 3, align 8")
        self._append_text("store ptr %_z, ptr %_entry, align 8")
        entry = self._lines.line("p", "ptrtoint ptr %_entry to i64").text
        callee = self._lines.line("p", f"inttoptr i64 {function} to ptr").text
        self._append_text(f"call void {callee}(i64 {run}, double {time}, i64 {entry})")

    def _if_any(self, line: When | While) -> None:
        """Print a call made if a number is nonzero in some lane, once or as long as it is."""
        label = self._lines.label()
        self._begin_block(label)
        nonzero = self._lines.any_lane(self._places.load(line.location) != 0.0)
        self._append_text(f"br i1 {nonzero}, label %{label}call, label %{label}end")
        self._lines.begin(f"{label}call")
        self._call_program(line.call)
        self._begin_block(f"{label}end", label if isinstance(line, While) else f"{label}end")

    # ---------------------------------------------------------------------------------------------------- operations

    def _operations_of_kind(self, kind: str) -> Callable[..., Value]:
        return self._kinds.get(kind) or (lambda operation, *operands: RULES[operation](*operands))

    def _compute_value(self, line: Compute) -> Value:
        name, arguments = line.operation, line.arguments
        if line.kind != FLOAT or name in RULES:
            return self._operations_of_kind(line.kind)(name, *map(self._operand_value, arguments))
        if name in LOOKED_UP:
            return self._look_up_table(name, arguments)
        if name in PAST:
            return self._look_up_past(name, arguments)
        numbers = [self._lane_number(argument) for argument in arguments]
        if name in PAIRS and (PAIRS[name][0], arguments) in self._joint:
            return self._one_of_pair(*PAIRS[name], numbers[0].text)
        if name in FUNCTIONS:
            return self._lines.call(f"elementary_{name}{self._width_suffix()}", numbers)
        # a function that was passed in
        return self._lines.by_lane(lambda *scalars: self._lines.call(f"_{name}", list(scalars)), numbers)

    def _look_up_table(self, name: str, arguments: tuple[Operand, ...]) -> LaneValue:
        """Find a piece of a table, or evaluate one; each lane may be in a different piece."""
        lines, drive = self._lines, arguments[-1]
        assert isinstance(drive, int)  # noqa: S101 - which table is known when the program is written
        places = [self._places.pointer(Location("pieces", 3 * drive + k)) for k in range(3)]
        if name == "piece_of":
            return lines.line("w", f"load {lines.kind('w')}, ptr {places[2]}, align 8")
        first, count = (lines.line("w", f"load i64, ptr {word_pointer}, align 8").text for word_pointer in places[:2])
        origin = lines.line("p", f"getelementptr double, ptr %_tables, i64 {first}").text

        def read(row: int, piece: LaneValue) -> LaneValue:
            far = lines.line("w", f"mul i64 {count}, {row}").text
            begin = lines.line("p", f"getelementptr double, ptr {origin}, i64 {far}").text
            return lines.read("n", begin, piece)

        operands = [self._lane_number(argument) for argument in arguments[:-1]]
        if name in POLYNOMIALS:  # no gathers: lanes that are in one piece read the same numbers
            return lines.by_lane(partial(POLYNOMIALS[name], read), operands)
        found_piece = find_piece(read, lines.broadcast("w", count), *operands)
        assert isinstance(found_piece, LaneValue)  # noqa: S101 - of written numbers
        return found_piece

    def _look_up_past(self, name: str, arguments: tuple[Operand, ...]) -> LaneValue:
        """Evaluate a step of the past, of those that a delay is set to."""
        lines, (time, *numbers) = self._lines, arguments
        slot, component, components, degree = map(int, numbers)
        places = [self._places.pointer(Location("pieces", 3 * slot + k)) for k in range(2)]
        first, count = (lines.line("w", f"load i64, ptr {word_pointer}, align 8") for word_pointer in places)
        origin = lines.line("p", f"getelementptr double, ptr %_tables, i64 {first.text}").text
        width = width_of(components, degree)

        def read(row: int, piece: LaneValue) -> LaneValue:
            return lines.read("n", origin, piece * width + row)

        return PAST[name](read, count, self._lane_number(time), component, components, degree)

    def _one_of_pair(self, pair: str, position: int, argument: str) -> LaneValue:
        """Compute functions of one argument together, and return one of them."""
        lines = self._lines
        kind = struct_of(pair, lines.lanes)
        if (pair, argument) not in self._pairs:
            call = f"call {kind} @elementary_{pair}{self._width_suffix()}({lines.kind('n')} {argument})"
            self._pairs[pair, argument] = lines.line("n", call).text
        return lines.line("n", f"extractvalue {kind} {self._pairs[pair, argument]}, {position}")

    def _width_suffix(self) -> str:
        """Return the suffix of functions of as many numbers as there are lanes now."""
        return "" if self._lines.lanes == self._runs else f".{self._lines.lanes}"

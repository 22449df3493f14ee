"""Programs as LLVM text, with lanes for one run, for runs side by side, or for neighbouring elements of one run.

One lane is what a single run calls. In lanes every number is a vector with one element for each run or for each
neighbour, and an operation acts on each element by itself. Nothing is summed across lanes, contracted or reordered, so
a lane holds the bits of a single run.

A row of links joins an element to all elements before it; rows of neighbouring elements go side by side, and every two
elements meet once. What a link gives to the row's own element is added in its lane; what it gives to the other is added
for one row after the other, so that each sum is ascending, as in plain loops.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Container, Iterable, Sequence
from dataclasses import replace
from functools import partial
from re import findall

from xdynamics.elementary import FUNCTIONS, NAME, PAIRS
from xdynamics.elementary.fma import FMA, fma_definition
from xdynamics.elementary.numbers import LaneValue, choose
from xdynamics.elementary.piecewise import PAST, POLYNOMIALS, find_piece, width_of
from xdynamics.elementary.text import (
    INTERVALS,
    count_calls,
    declarations,
    definition,
    definitions,
    interval_definitions,
    struct_of,
)
from xdynamics.kernels import machine
from xdynamics.kernels.jets.recurrences import ORDER
from xdynamics.kernels.link_rows import LinkRows, link_rows
from xdynamics.kernels.llvm_loops import Index, LoopText, Value, rebuild_value, value_parts
from xdynamics.kernels.machine import AS_WRITTEN
from xdynamics.kernels.program import (
    ARRAYS,
    AT,
    FLOAT,
    TABLE,
    WORDS,
    Compute,
    EngineCall,
    Gather,
    Instruction,
    Load,
    Location,
    Loop,
    Operand,
    Ordinal,
    Program,
    ProgramCall,
    Reduction,
    StoreTo,
    When,
    While,
    line_count,
    soundness,
)
from xdynamics.kernels.python_text import RULES
from xdynamics.kernels.shared_storage import DECLARED, MOST_ON_STACK, refusal_lines

FEWEST = 4  # rows side by side: exchanging rows and lanes costs what fewer gain


class RowText(LoopText):
    """Prints loops, and those over every two elements by several rows at once."""

    def _print_loop(self, line: Loop) -> None:
        rows, lanes = link_rows(line) if self._may_go_abreast() else None, self._abreast
        while line.count < 2 * lanes:
            lanes //= 2
        if rows is None or lanes < FEWEST or self._into_row(line):
            super()._print_loop(line)
        else:
            self._abreast, lanes = lanes, self._abreast
            self._print_rows(line, rows)
            self._abreast = lanes

    def _print_rows(self, line: Loop, rows: LinkRows) -> None:
        """Print as many rows at once as there are lanes: blocks that end at the last row, of which the first may be short."""
        wide, first = self._abreast, line.count % self._abreast
        self._kept = f"{self._lines.label()}kept"
        # at the beginning of the function: inside a loop every pass would take more stack until the function returns
        self._stack.append(f"%{self._kept} = alloca double, i64 {len(rows.added) * wide * wide}, align 64")
        self._dynamic_passes(partial(self._print_block, line, rows), str(first or wide), str(line.count + 1), [], wide)

    def _print_block(self, line: Loop, rows: LinkRows, end: Index, _: list[Value]) -> list[Value]:
        """Print the links of the rows before an end to the elements up to their own, as many at once as there are rows.

        A short block has lanes for rows that are not its own: those have no links yet, and are set again by their block.
        """
        wide, first, lines = self._abreast, line.count % self._abreast, self._lines
        begin = self._block_begin(end, first)
        with self._side_by_side(wide), self._pass_scope(replace(line, body=rows.lines_before), Index(begin, 1), []):
            row_numbers, beyond = (lines.broadcast("w", text) for text in (begin, f"{end.value}"))
            row_numbers = row_numbers + self._lanes()
            # row 0 has no element before it: as such a row, a lane beyond the end adds nothing
            row_numbers = choose(row_numbers < beyond, row_numbers, 0)
            last = lines.line("p", f"add i64 {end.value}, 1").text
            starts = [self._operand_value(start) for start in rows.links.starts]
            self._dynamic_passes(partial(self._tile, rows, row_numbers, first), str(first or wide), last, starts, wide)
        return []

    def _block_begin(self, end: Index, first: int) -> str:
        """Return where the elements before an end begin, as many as there are lanes; the first are fewer, and begin at 0."""
        begin = self._lines.line("p", f"sub i64 {end.value}, {self._abreast}").text
        if not first:
            return begin
        short = self._lines.line("t", f"icmp ult i64 {end.value}, {self._abreast}").text
        return self._lines.line("p", f"select i1 {short}, i64 0, i64 {begin}").text

    def _tile(self, rows: LinkRows, row_numbers: LaneValue, first: int, end: Index, totals: list[Value]) -> list[Value]:
        """Print links of a block to the elements before an end; return the sums of its rows.

        What they find for elements beyond the end, or not before the row's own, is not added.
        """
        lines, wide, begin = self._lines, self._abreast, self._block_begin(end, first)
        beyond = lines.broadcast("w", f"{end.value}")
        bound = choose(row_numbers < beyond, row_numbers, beyond) - lines.broadcast("w", begin)

        def print_element(element: Index, totals: list[Value]) -> list[Value]:
            lane = lines.line("p", f"sub i64 {element.value}, {begin}").text
            with self._pass_scope(rows.links, element, totals):
                for k, (_, term, _) in enumerate(rows.added):
                    where = self._kept_at(str(k * wide), lane)
                    self._append_text(f"store {lines.kind('n')} {self._lane_number(term).text}, ptr {where}, align 64")
                new_totals = self._join_terms(rows.links, totals)
                return self._select_totals(bound > lines.broadcast("w", lane), new_totals, totals)

        last = lines.line("p", f"add i64 {begin}, {wide}").text
        totals = self._dynamic_passes(print_element, begin, last, totals)
        with self._pass_scope(replace(rows.links, body=rows.lines_after), Index(begin, 1), totals):
            self._add(rows, bound)
        return totals

    def _kept_at(self, first: str, lane: str) -> str:
        """Return where the numbers of a row of lanes wait."""
        number = self._lines.line("p", f"add i64 {first}, {lane}").text
        far = self._lines.line("p", f"mul i64 {number}, {self._abreast}").text
        return self._lines.line("p", f"getelementptr double, ptr %{self._kept}, i64 {far}").text

    def _kept_row(self, number: int) -> LaneValue:
        """Return the numbers that wait in a row of lanes."""
        where = self._lines.line("p", f"getelementptr double, ptr %{self._kept}, i64 {number * self._abreast}").text
        return self._lines.line("n", f"load {self._lines.kind('n')}, ptr {where}, align 64")

    def _add(self, rows: LinkRows, bound: LaneValue) -> None:
        """Add the contributions to a tile's elements to their numbers: row after row, up to its bound."""
        wide, lines = self._abreast, self._lines
        for k, (location, _, operation) in enumerate(rows.added):
            total = self._places.load(location)
            for lane, row in enumerate(self._transposed([self._kept_row(k * wide + lane) for lane in range(wide)])):
                of_row = lines.line("p", f"extractelement {lines.kind('w')} {bound.text}, i64 {lane}").text
                more = RULES[operation](total, row)
                total = choose(self._lanes() < lines.broadcast("w", of_row), more, total)
            self._places.store(location, total)

    def _lanes(self) -> LaneValue:
        """Return the number of each lane."""
        return LaneValue(self._lines, "w", f"<{', '.join(f'i64 {lane}' for lane in range(self._abreast))}>")

    def _select_totals(self, truth: LaneValue, new: list[Value], old: list[Value]) -> list[Value]:
        """Return new sums, or in lanes where a truth does not hold old ones."""
        return [
            rebuild_value(
                old_total,
                [choose(truth, *pair) for pair in zip(value_parts(new_total), value_parts(old_total), strict=True)],
            )
            for old_total, new_total in zip(old, new, strict=True)
        ]

    def _transposed(self, rows: Sequence[LaneValue]) -> list[LaneValue]:
        """Exchange rows and lanes of a square of numbers."""
        square, far, kind = list(rows), 1, self._lines.kind("n")
        while far < len(square):
            masks = [
                [lane - far + len(square) if lane & far else lane for lane in range(len(square))],
                [lane + len(square) if lane & far else lane + far for lane in range(len(square))],
            ]
            for k in (k for k in range(len(square)) if not k & far):
                first, second = square[k], square[k + far]
                square[k], square[k + far] = (
                    self._lines.line("n", f"shufflevector {kind} {first.text}, {kind} {second.text}, {_mask(mask)}")
                    for mask in masks
                )
            far *= 2
        return square


def _mask(lanes: Sequence[int]) -> str:
    return f"<{len(lanes)} x i32> <{', '.join(f'i32 {lane}' for lane in lanes)}>"


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
        """Print a call of the engine with the time and the table entry of `z`, of which it takes the address alone."""

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


INLINED = 1500  # instructions up to which a program is inlined
_SIGNATURE = ", ".join(f"ptr noalias %_{name}" for name in ARRAYS) + ", i64 %_apart"
_GIVEN = ("y", "z", "samples")  # by callers from outside, besides the table


def llvm_of(
    programs: Iterable[Program],
    lanes: int = 1,
    functions: Iterable[tuple[str, int]] = (),
    entered: Container[str] | None = None,
    math_functions: str = NAME,
    abreast: int = 1,
) -> str:
    """Print programs as one LLVM module.

    Parameters
    ----------
    programs : iterable of Program
        Each after those that it calls.
    lanes : int
        Runs side by side; each number of a run is an element of a vector.
    functions : iterable of (str, int)
        Python functions that are called, with how many arguments each takes.
    entered : container of str, optional
        Programs that are called from outside; all by default.
    math_functions : str
        The set of elementary functions.
    abreast : int
        Of a single run, how many neighbouring elements of independent loops are computed side by side.
    """
    parts = {part.name: part for part in programs}
    wide = abreast if lanes == 1 else lanes
    # loops over elements are not unrolled: no step is faster, and how long compiling takes depends on their number
    text = [AS_WRITTEN] if abreast > 1 or any(map(_has_orders, parts.values())) else []
    text.append(declarations(*{lanes, wide}))
    text += [f"declare double @_python_{name}({', '.join(['double'] * count)})" for name, count in functions]
    bodies = {name: ProgramText(part, lanes, wide).body() for name, part in parts.items()}
    if any("@malloc(" in body for body in bodies.values()):
        text.append(DECLARED)
    widths = {int(lanes) for body in bodies.values() for lanes in findall(rf"@{FMA}\.(\d+)\(", body)}
    text += [fma_definition(width, native=machine.fuses()) for width in sorted({1, *widths} if widths else widths)]
    intervals = interval_definitions(bodies.values())
    used = {name: count_calls(body) for name, body in (bodies | {INTERVALS: intervals}).items()}
    sizes = {name: _size_of(name, lanes, math_functions) for counts in used.values() for name in counts}
    inner = {name: sizes[name] * n <= INLINED // 2 for name, n in sum(used.values(), Counter[str]()).items()}
    text += [definitions(inner, lanes, math_functions), intervals]
    for name, part in parts.items():
        calls = sum(_call_count(caller, name) for caller in parts.values())
        weight = line_count(part.body) + sum(sizes[function] * count for function, count in used[name].items())
        attributes = "#2" if weight * calls <= INLINED else "#0"
        text += [_table_constant(name, *table) for table in part.tables.items()]
        text.append(f"define internal void @{name}.inner({_SIGNATURE}) {attributes} {{\nentry:\n{bodies[name]}\n}}")
        if entered is None or name in entered:
            text.append(_entry_function(name))
    # "prefer-vector-width": without it 16 lanes are split into vectors of 256 bits where 512 are available
    # "stackrealign": what registers do not hold is kept on the stack, and a vector of 64 bytes there would cross two lines
    # of the cache each time that it is written or read
    kinds = 'nounwind "prefer-vector-width"="512"' + (' alignstack=64 "stackrealign"' if lanes > 1 else "")
    text.append(f"attributes #0 = {{ {kinds} }}")
    text.append(f"attributes #2 = {{ alwaysinline {kinds} }}")
    return "\n".join(part for part in text if part) + "\n"


def _has_orders(program: Program) -> bool:
    """Whether a program has a loop over the orders of series: unrolled by LLVM, its many short ones take six times as long."""
    return any(isinstance(line, Loop) and line.index == ORDER for line in program.body)


def _size_of(name: str, lanes: int, math_functions: str) -> int:
    return definition(name, lanes, math_functions)[0].count("\n")


def _call_count(program: Program, name: str) -> int:
    lines = (line.call if isinstance(line, When | While) else line for line in program.body)
    return sum(isinstance(line, ProgramCall) and line.program == name for line in lines)


def _table_constant(program: str, name: str, numbers: tuple[int, ...]) -> str:
    entries = ", ".join(f"i64 {number}" for number in numbers)
    return f"@{program}.{name} = internal constant [{len(numbers)} x i64] [{entries}]"


def _entry_function(name: str) -> str:
    """Print the external entry point, which reads from the table the arrays that its caller does not pass."""
    lines = []
    for array in (*ARRAYS, "apart"):
        if array in _GIVEN:
            continue
        # for rows of the log, the length of the last dimension: the distance between their elements
        word_index = WORDS * TABLE.index(array) if array in ARRAYS else WORDS * TABLE.index("rows") + 2
        kind = "ptr" if array in ARRAYS else "i64"
        lines.append(f"%{array}_at = getelementptr i64, ptr %table, i64 {word_index}")
        # invariant.load: no code changes the table, so that LLVM may read a word once for many uses
        lines.append(f"%_{array} = load {kind}, ptr %{array}_at, align 8, !invariant.load !0")
    parameters = ", ".join(f"ptr noalias %_{array}" for array in _GIVEN)
    body = "\n  ".join(lines)
    arrays = ", ".join(f"ptr %_{array}" for array in ARRAYS)
    return (
        f"define void @{name}(ptr %table, {parameters}) #0 {{\n  {body}\n"
        f"  call void @{name}.inner({arrays}, i64 %_apart)\n  ret void\n}}"
    )

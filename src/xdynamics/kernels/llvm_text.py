"""A program as LLVM text, with any number of lanes: one lane is what a single run calls.

In lanes every number is a vector with one element for each run, and an operation acts on each element by itself.
Nothing is summed across lanes, contracted or reordered, so a lane holds the bits of a single run.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Iterable
from string import ascii_lowercase

from xdynamics.elementary import FUNCTIONS, NAME, PAIRS
from xdynamics.elementary.intervals import Interval
from xdynamics.elementary.llvm_numbers import Lines, Written
from xdynamics.elementary.text import called_in, declarations, definition, definitions, struct_of, written_intervals
from xdynamics.kernels.operations import COMPARISONS, COMPOSED, INFIX, INTRINSICS
from xdynamics.kernels.program import (
    ARRAYS,
    AT,
    INTERVAL,
    TABLE,
    WORDS,
    Call,
    Compute,
    Each,
    Instruction,
    Load,
    Operand,
    Place,
    Program,
    Store,
    When,
    While,
)

UNROLLED = 8  # components up to which vectors are written out; longer ones are loops
INLINED = 1500  # instructions up to which a program is inlined
_SIGNATURE = ", ".join(f"ptr noalias %_{name}" for name in ARRAYS) + ", i64 %_apart"
UNSOUND = "unsound"
_ALL_OF = Counter(pair for pair, _ in PAIRS.values())
_GIVEN = ("y", "z", "samples")  # by callers from outside, besides the table
_TABLES = """
define internal i64 @find_piece(double %x, ptr %origin, i64 %count) #1 {
  %last = sub i64 %count, 1
  %end_at = getelementptr double, ptr %origin, i64 %last
  %end = load double, ptr %end_at
  %at_end = fcmp oeq double %x, %end
  %before_last = sub i64 %last, 1
  br i1 %at_end, label %last_piece, label %inside
last_piece:
  ret i64 %before_last
inside:
  %first_at = getelementptr double, ptr %origin, i64 1
  %first = load double, ptr %first_at
  %reached = fcmp oge double %x, %first
  br i1 %reached, label %search, label %before
before:
  ret i64 0
search:
  %low = phi i64 [ 0, %inside ], [ %new_low, %halve ]
  %high = phi i64 [ %last, %inside ], [ %new_high, %halve ]
  %open = icmp ult i64 %low, %high
  br i1 %open, label %halve, label %found
halve:
  %sum = add i64 %low, %high
  %sum1 = add i64 %sum, 1
  %middle = lshr i64 %sum1, 1
  %middle_at = getelementptr double, ptr %origin, i64 %middle
  %start = load double, ptr %middle_at
  %starts_before = fcmp ole double %start, %x
  %below = sub i64 %middle, 1
  %new_low = select i1 %starts_before, i64 %middle, i64 %low
  %new_high = select i1 %starts_before, i64 %high, i64 %below
  br label %search
found:
  ret i64 %low
}
define internal double @power_of(ptr %origin, i64 %count, i64 %row, i64 %piece) #1 {
  %rows = add i64 %row, 1
  %skipped = mul i64 %rows, %count
  %index = add i64 %skipped, %piece
  %place = getelementptr double, ptr %origin, i64 %index
  %value = load double, ptr %place
  ret double %value
}
define internal double @value_at(double %x, i64 %piece, ptr %origin, i64 %count) #1 {
  %c3 = call double @power_of(ptr %origin, i64 %count, i64 0, i64 %piece)
  %c2 = call double @power_of(ptr %origin, i64 %count, i64 1, i64 %piece)
  %c1 = call double @power_of(ptr %origin, i64 %count, i64 2, i64 %piece)
  %c0 = call double @power_of(ptr %origin, i64 %count, i64 3, i64 %piece)
  %start_at = getelementptr double, ptr %origin, i64 %piece
  %start = load double, ptr %start_at
  %u = fsub double %x, %start
  %a = fmul double %c3, %u
  %b = fadd double %a, %c2
  %c = fmul double %b, %u
  %d = fadd double %c, %c1
  %e = fmul double %d, %u
  %f = fadd double %e, %c0
  ret double %f
}
define internal double @slope_at(double %x, i64 %piece, ptr %origin, i64 %count) #1 {
  %c3 = call double @power_of(ptr %origin, i64 %count, i64 0, i64 %piece)
  %c2 = call double @power_of(ptr %origin, i64 %count, i64 1, i64 %piece)
  %c1 = call double @power_of(ptr %origin, i64 %count, i64 2, i64 %piece)
  %start_at = getelementptr double, ptr %origin, i64 %piece
  %start = load double, ptr %start_at
  %u = fsub double %x, %start
  %a = fmul double %c3, 3.0
  %b = fmul double %a, %u
  %c = fmul double %c2, 2.0
  %d = fadd double %b, %c
  %e = fmul double %d, %u
  %f = fadd double %e, %c1
  ret double %f
}
"""


def llvm_of(
    programs: Iterable[Program],
    lanes: int = 1,
    functions: Iterable[tuple[str, int]] = (),
    entered: Container[str] | None = None,
    math_functions: str = NAME,
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
    """
    parts = {part.name: part for part in programs}
    text = [declarations(lanes), _TABLES if any(map(_looks_up, parts.values())) else ""]
    text += [f"declare double @_python_{name}({', '.join(['double'] * count)})" for name, count in functions]
    bodies = {name: _Printer(part, lanes).body() for name, part in parts.items()}
    used = {name: called_in(body) for name, body in bodies.items()}
    sizes = {name: _size_of(name, lanes, math_functions) for counts in used.values() for name in counts}
    inner = {name: sizes[name] * n <= INLINED // 2 for name, n in sum(used.values(), Counter[str]()).items()}
    text.append(definitions(inner, lanes, math_functions))
    for name, part in parts.items():
        calls = sum(_calls(other, name) for other in parts.values())
        weight = part.size + sum(sizes[function] * count for function, count in used[name].items())
        attributes = "#2" if weight * calls <= INLINED else "#0"
        text.append(f"define internal void @{name}.inner({_SIGNATURE}) {attributes} {{\nentry:\n{bodies[name]}\n}}")
        if entered is None or name in entered:
            text.append(_Printer(part, lanes).entry())
    # "prefer-vector-width": without it 16 lanes are split into vectors of 256 bits where 512 are available
    text.append('attributes #0 = { nounwind "prefer-vector-width"="512" }')
    text.append("attributes #1 = { nounwind alwaysinline }")
    text.append('attributes #2 = { nounwind alwaysinline "prefer-vector-width"="512" }')
    return "\n".join(part for part in text if part) + "\n"


def _looks_up(program: Program) -> bool:
    return any(
        isinstance(line, Compute) and line.operation in ("value_at", "slope_at", "find_piece") for line in program.body
    )


def _together(body: Iterable[Instruction]) -> set[tuple[str, tuple[Operand, ...]]]:
    """Return what is computed together for one argument, such as a sine and a cosine."""
    computed = {
        (entry.operation, entry.arguments) for entry in body if isinstance(entry, Compute) and entry.operation in PAIRS
    }
    counts = Counter((PAIRS[name][0], arguments) for name, arguments in computed)
    return {entry for entry, count in counts.items() if count == _ALL_OF[entry[0]]}


def _size_of(name: str, lanes: int, math_functions: str) -> int:
    return definition(name, lanes, math_functions)[0].count("\n")


def _calls(program: Program, name: str) -> int:
    lines = (line.call if isinstance(line, When | While) else line for line in program.body)
    return sum(isinstance(line, Call) and line.program == name for line in lines)


class _Printer:
    """Prints one program; its values are numbered, and the arrays that it is given have a prefix."""

    def __init__(self, program: Program, lanes: int) -> None:
        self._program = program
        self._lanes = lanes
        self._kinds = Lines(lanes)
        self._intervals = written_intervals(self._kinds, rough=True)
        self._bounds: dict[Operand, Interval] = {}
        self._number, self._suffix = self._kinds.kind("n"), self._kinds.suffix()
        self._truth, self._whole = self._kinds.kind("t"), self._kinds.kind("w")
        self._lines = self._kinds.lines
        self._values: dict[str, str] = {}
        self._joint = _together(program.body)
        self._pairs: dict[tuple[str, str], str] = {}

    def entry(self) -> str:
        """Print the entry point from outside, which reads from the table what its caller does not pass."""
        lines = []
        for name in (*ARRAYS, "apart"):
            if name in _GIVEN:
                continue
            # for rows of the log, the length of the last dimension: the distance between their elements
            place = WORDS * TABLE.index(name) if name in ARRAYS else WORDS * TABLE.index("rows") + 2
            kind = "ptr" if name in ARRAYS else "i64"
            lines.append(f"%{name}_at = getelementptr i64, ptr %table, i64 {place}")
            lines.append(f"%_{name} = load {kind}, ptr %{name}_at, align 8, !invariant.load !0")
        name, parameters = self._program.name, ", ".join(f"ptr noalias %_{array}" for array in _GIVEN)
        body = "\n  ".join(lines)
        arrays = ", ".join(f"ptr %_{array}" for array in ARRAYS)
        return (
            f"define void @{name}(ptr %table, {parameters}) #0 {{\n  {body}\n"
            f"  call void @{name}.inner({arrays}, i64 %_apart)\n  ret void\n}}"
        )

    def body(self) -> str:
        """Print the lines of the function."""
        if self._program.sound:
            self._lines.append(f"%{UNSOUND} = alloca {self._number}, align 8")
        for name, count in self._program.local.items():
            self._lines.append(f"%{name} = alloca double, i64 {max(1, count) * self._lanes}, align 8")
        for line in self._program.body:
            self._line(line)
        if self._program.sound:
            self._answer(*self._program.sound)
        self._lines.append("ret void")
        return "\n".join(f"  {line}" if not line.endswith(":") else line for line in self._lines)

    def _answer(self, first: int, count: int) -> None:
        """Set `unsound`: a number minus itself is 0 if it is finite, else nan."""
        self._lines.append(f"store {self._number} {self._operand(0.0)}, ptr %{UNSOUND}, align 8")
        less_itself = (
            Load("_sum", Place(UNSOUND)),
            Load("_number", Place("z", first)),
            Compute("_nothing", "subtract", ("_number", "_number")),
            Compute("_more", "add", ("_sum", "_nothing")),
            Store(Place(UNSOUND), "_more"),
        )
        self._line(Each(count, less_itself))
        self._print(Load("_sum", Place(UNSOUND)), "", 0)
        self._print(Store(Place("at", AT.index(UNSOUND)), "_sum"), "", 0)

    def _line(self, line: Instruction) -> None:
        if isinstance(line, Each) and line.count > UNROLLED:
            self._loop(line)
        elif isinstance(line, Each):
            for i in range(line.count):
                self._each(line, "", i)
        elif isinstance(line, When | While):
            self._if_any(line)
        else:
            self._print(line, "", 0)

    def _if_any(self, line: When | While) -> None:
        """Print a call made if a number is nonzero in some lane, once or as long as it is."""
        label = self._kinds.label()
        self._lines += [f"br label %{label}", f"{label}:"]
        number = self._new(f"load {self._number}, ptr {self._pointer(line.place, '', 0)}, align 8")
        condition = self._new(f"fcmp une {self._number} {number}, {self._operand(0.0)}")
        if self._lanes > 1:
            bits = self._new(f"bitcast {self._truth} {condition} to i{self._lanes}")
            condition = self._new(f"icmp ne i{self._lanes} {bits}, 0")
        self._lines += [f"br i1 {condition}, label %{label}call, label %{label}end", f"{label}call:"]
        self._print(line.call, "", 0)
        self._lines += [f"br label %{label if isinstance(line, While) else f'{label}end'}", f"{label}end:"]
        self._kinds.block = f"{label}end"

    def _each(self, line: Each, index: str, shift: int) -> None:
        outside, joint, pairs = dict(self._values), self._joint, dict(self._pairs)
        self._joint = joint | _together(line.body)
        for instruction in line.body:
            self._print(instruction, index, shift)
        self._values, self._joint, self._pairs = outside, joint, pairs

    def _loop(self, line: Each) -> None:
        """Print the lines for i from 0 to count - 1, as a loop."""
        label, previous = self._kinds.label(), self._kinds.block
        index = f"%{label}i"
        self._lines += [
            f"br label %{label}",
            f"{label}:",
            f"{index} = phi i64 [ 0, %{previous} ], [ {index}n, %{label} ]",
        ]
        self._kinds.block = label
        self._each(line, index, 0)
        self._lines += [
            f"{index}n = add i64 {index}, 1",
            f"{index}c = icmp ult i64 {index}n, {line.count}",
            f"br i1 {index}c, label %{label}, label %{label}end",
            f"{label}end:",
        ]
        self._kinds.block = f"{label}end"

    def _print(self, line: Instruction, index: str, shift: int) -> None:
        match line:
            case Load():
                place = self._pointer(line.place, index, shift)
                self._values[line.target] = self._new(f"load {self._number}, ptr {place}, align 8")
            case Store():
                place = self._pointer(line.place, index, shift)
                self._lines.append(f"store {self._number} {self._operand(line.value)}, ptr {place}, align 8")
            case Compute(kind=kind) if kind == INTERVAL:
                self._enclose(line)
            case Compute():
                self._values[line.target] = self._computed(line)
            case Call():
                passed = {"at": line.at, "y": line.y, "z": line.z, "e": line.e}
                arrays = (self._pointer(Place(passed.get(array, array)), "", 0) for array in ARRAYS)
                self._lines.append(
                    f"call void @{line.program}.inner({', '.join(f'ptr {array}' for array in arrays)}, i64 1)"
                )

    def _pointer(self, place: Place, index: str, shift: int) -> str:
        """Return the address of an element of a given array, of a view, or of a local array."""
        if place.array == UNSOUND:
            return f"%{UNSOUND}"
        if place.same:
            index, shift = "", 0
        views = self._program.views
        array, first, _ = views.get(place.array, (place.array, 0, 0))
        base = f"%_{array}" if array in ARRAYS else f"%{array}"
        offset = (first + place.index + shift) * self._lanes
        if array == "z" and self._program.spread:
            number = self._new(f"add i64 {index or 0}, {first + place.index + shift}")
            far = self._new(f"mul i64 {number}, %_apart")
            return self._new(f"getelementptr {self._number}, ptr %_z, i64 {far}")
        if index:
            moved = self._new(f"mul i64 {index}, {self._lanes}") if self._lanes > 1 else index
            base = self._new(f"getelementptr double, ptr {base}, i64 {moved}")
        return self._new(f"getelementptr double, ptr {base}, i64 {offset}") if offset else base

    def _computed(self, line: Compute) -> str:
        name, arguments, number = line.operation, line.arguments, self._number
        if name in ("value_at", "slope_at", "find_piece", "piece_of"):
            return self._looked_up(name, arguments)
        operands = [self._operand(operand) for operand in arguments]
        if name in INFIX:
            return self._new(f"{INFIX[name][2]} {number} {operands[0]}, {operands[1]}")
        if name in COMPARISONS:
            return self._new(f"fcmp {COMPARISONS[name][1]} {number} {operands[0]}, {operands[1]}")
        if name == "choose":
            return self._new(f"select {self._truth} {operands[0]}, {number} {operands[1]}, {number} {operands[2]}")
        if name in INTRINSICS:
            return self._new(f"call {number} @llvm.{INTRINSICS[name]}.{self._suffix}({number} {operands[0]})")
        if name in COMPOSED:
            return self._composed(COMPOSED[name], operands)
        if name in PAIRS and (PAIRS[name][0], arguments) in self._joint:
            return self._one_of(*PAIRS[name], operands[0])
        if name in FUNCTIONS:
            return self._kinds.call(f"elementary_{name}", [self._written(operand) for operand in arguments]).text
        return self._by_lane(
            "double", [(number, operand) for operand in operands], lambda scalars: f"call double @_{name}({scalars})"
        )

    def _enclose(self, line: Compute) -> None:
        """Write an operation on intervals; its result is one, or a bound."""
        operands = [self._bounds.get(operand) or self._written(operand) for operand in line.arguments]
        result = self._intervals.of(line.operation, *operands)
        if isinstance(result, Interval):
            self._bounds[line.target] = result
        else:
            self._values[line.target] = result.text

    def _written(self, operand: Operand) -> Written:
        return Written(self._kinds, "n", self._operand(operand))

    def _one_of(self, pair: str, place: int, argument: str) -> str:
        """Compute functions of one argument together, and return one of them."""
        kind = struct_of(pair, self._lanes)
        if (pair, argument) not in self._pairs:
            self._pairs[pair, argument] = self._new(f"call {kind} @elementary_{pair}({self._number} {argument})")
        return self._new(f"extractvalue {kind} {self._pairs[pair, argument]}, {place}")

    def _composed(self, lines: tuple[str, ...], operands: list[str]) -> str:
        constants = {"zero": 0.0, "one": 1.0, "minus": -1.0, "nan": float("nan")}
        fields = {"T": self._number, "B": self._truth} | {key: self._operand(value) for key, value in constants.items()}
        for letter, line in zip(ascii_lowercase, lines, strict=False):
            right = line.split(" = ", 1)[1].format(*operands, **fields)
            fields[letter] = self._new(right)
        return fields[ascii_lowercase[len(lines) - 1]]

    def _looked_up(self, name: str, arguments: tuple[Operand, ...]) -> str:
        """Find a piece of a table, or evaluate one; each lane may be in a different piece."""
        drive = arguments[-1]
        assert isinstance(drive, int)  # noqa: S101 - which table is known when the program is written
        if name == "piece_of":
            place = self._new(f"getelementptr i64, ptr %_pieces, i64 {(3 * drive + 2) * self._lanes}")
            return self._new(f"load {self._whole}, ptr {place}, align 8")
        pointers = [self._new(f"getelementptr i64, ptr %_pieces, i64 {(3 * drive + k) * self._lanes}") for k in (0, 1)]
        first, count = (self._new(f"load i64, ptr {operand}, align 8") for operand in pointers)
        origin = self._new(f"getelementptr double, ptr %_tables, i64 {first}")
        typed = [(self._number, self._operand(arguments[0]))]
        typed += [(self._whole, self._operand(operand)) for operand in arguments[1:-1]]
        result = "i64" if name == "find_piece" else "double"
        return self._by_lane(
            result, typed, lambda scalars: f"call {result} @{name}({scalars}, ptr {origin}, i64 {count})"
        )

    def _by_lane(self, result: str, operands: list[tuple[str, str]], call: object) -> str:
        """Call a function of single numbers once for each lane."""
        assert callable(call)  # noqa: S101
        scalar = {self._number: "double", self._whole: "i64"}
        if self._lanes == 1:
            return self._new(call(", ".join(f"{kind} {operand}" for kind, operand in operands)))
        vector = "poison"
        for lane in range(self._lanes):
            scalars = [
                (scalar[kind], self._new(f"extractelement {kind} {operand}, i64 {lane}")) for kind, operand in operands
            ]
            value = self._new(call(", ".join(f"{kind} {operand}" for kind, operand in scalars)))
            vector = self._new(f"insertelement <{self._lanes} x {result}> {vector}, {result} {value}, i64 {lane}")
        return vector

    def _new(self, text: str) -> str:
        return self._kinds.line("n", text).text

    def _operand(self, operand: Operand) -> str:
        return self._values[operand] if isinstance(operand, str) else self._kinds.constant(float(operand)).text

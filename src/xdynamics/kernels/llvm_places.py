"""Elements of a program's arrays and tables as LLVM text: addresses, loads and stores.

With several runs side by side an element is one number of each run, next to one another. With neighbouring elements of
one run side by side, one place means an element for each of them: next to one another, some distance apart, or anywhere.
"""

from __future__ import annotations

from dataclasses import dataclass

from xdynamics.elementary.llvm_numbers import FunctionLines, LaneValue
from xdynamics.kernels.program import ARRAYS, Location, Program


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
            pointers = self._pointers("double", self.pointer(location), steps)
            every = f"{lines.kind('t')} {lines.constant(value=True).text}"
            scatter_operands = f"{kind} {value.text}, {lines.kind('p')} {pointers}, i32 8, {every}"
            lines.lines.append(f"call void @llvm.masked.scatter.{lines.suffix()}.v{lines.lanes}p0({scatter_operands})")
        else:
            lines.lines.append(f"store {kind} {value.text}, ptr {self.pointer(location)}, align 8")

    def gather(self, index: str, location: Location) -> None:
        """Read a whole number of a table: the value of an index from then on."""
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
        if self._differs(location) or (letter == "n" and self._runs == lines.lanes):
            return lines.line(letter, f"load {lines.kind(letter)}, ptr {origin}, align 8")
        element_value = lines.line(letter, f"load {scalar}, ptr {origin}, align 8")
        return element_value if letter == "w" else lines.broadcast(letter, element_value.text)

    def _differs(self, location: Location) -> bool:
        """Whether lanes mean different elements."""
        return any(self.indices[name].per_lane or self.indices[name].step * stride for name, stride in location.strides)

    def _lane_offsets(self, location: Location) -> str | None:
        """Return how far the lanes' elements are from the first place; None if they are one, or next to one another."""
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

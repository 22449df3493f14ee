"""Why numbers of a motion are unknown over a set: the operation that has no value or no derivative for some operands."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from xdynamics.elementary import FUNCTIONS
from xdynamics.elementary.bounds import BREAKS, SMOOTH, Interval
from xdynamics.elementary.intervals import Intervals
from xdynamics.kernels.interval_program import COMPARED, squared
from xdynamics.kernels.program import Compute, Line, Load, Location, Operand, StoreTo
from xdynamics.tubes.tangents import Tangents

_INTERVALS = Intervals(FUNCTIONS)
_TANGENT = Location("tangent")  # of every number that varies: derivatives along one direction show where none exists


def undefined_reason(
    lines: Sequence[Line], read: Callable[[Location], Interval], varies: Callable[[Location], bool]
) -> str:
    """Return which operation has no value or no derivative for some of its operands; empty if all have both.

    Parameters
    ----------
    lines : sequence of Line
        Straight lines.
    read : callable
        Returns the interval of numbers that is at a location.
    varies : callable
        Whether the number at a location depends on the start or on time.
    """
    evaluation = _Evaluation(read)
    tangents, results = Tangents(lambda location: _TANGENT if varies(location) else None), list[Operand]()
    for line in lines:
        if isinstance(line, StoreTo):
            results.append(line.value)
        elif isinstance(line, Load | Compute):
            written = len(tangents.lines)
            tangents.follow(line)
            evaluation.compute(line, line)
            for tangent_line in tangents.lines[written:]:
                evaluation.compute(tangent_line, line)
    for result in [*results, *map(tangents.tangent_of, results)]:
        if evaluation.interval(result).flaw != SMOOTH:
            return evaluation.words(str(result))
    return ""


class _Evaluation:
    """The intervals of all values of some lines, and the lines that they come from."""

    def __init__(self, read: Callable[[Location], Interval]) -> None:
        self._read = read
        self._intervals: dict[str, Interval] = {}
        self._lines: dict[str, tuple[Compute, Load | Compute]] = {}

    def compute(self, line: Line, origin: Load | Compute) -> None:
        """Compute the value of a line: one of the motion, or one of the tangent of that."""
        if isinstance(line, Load):
            self._intervals[line.target] = (
                Interval(1.0, 1.0) if line.location == _TANGENT else self._read(line.location)
            )
        elif isinstance(line, Compute):
            operation = squared(line)
            operands = map(self.interval, operation.arguments)
            self._intervals[line.target] = _INTERVALS.of(operation.operation, *operands)
            self._lines[line.target] = line, origin

    def interval(self, operand: Operand) -> Interval:
        """Return the interval of a value, or of a number."""
        return self._intervals[operand] if isinstance(operand, str) else Interval(float(operand), float(operand))

    def words(self, name: str) -> str:
        """Describe the operation that leaves a value undefined: the first, whose operands are all defined."""
        line, origin = self._lines[name]
        if (undefined := next(self._undefined_operands(line), None)) is not None:
            return self.words(undefined)
        if isinstance(origin, Compute) and line.operation in COMPARED:
            line = origin  # the tangent of a function with a corner compares, to choose a side
        values = " and ".join(self._range_words(operand) for operand in line.arguments)
        match line.operation:
            case "abs":
                return f"abs has a corner among the values {values}"
            case "least" | "greatest" as extreme:
                return f"{'min' if extreme == 'least' else 'max'} is not decided for values {values}"
            case "divide":
                return f"a divisor may be zero: it lies {self._range_words(line.arguments[1])}"
            case "positive":
                return f"what must be positive lies {values}"
            case comparison if comparison in COMPARED:
                return f"a comparison is not decided for values {values}"
        fault = "jumps" if self._intervals[line.target].flaw == BREAKS else "is not defined, or not finite,"
        return f"{line.operation} {fault} for some of the values {values}"

    def _undefined_operands(self, line: Compute) -> Iterator[str]:
        """Yield the operands that are undefined: of a choice its condition, if that is undecided, or what it chooses."""
        operands = line.arguments
        if line.operation == "choose":
            condition, *branches = operands
            low, high, _ = self.interval(condition)
            operands = (condition,) if low < high else (branches[0] if low else branches[1],)
        for operand in operands:
            if isinstance(operand, str) and (self.interval(operand).flaw != SMOOTH or line.operation == "choose"):
                yield operand

    def _range_words(self, operand: Operand) -> str:
        low, high, _ = self.interval(operand)
        return f"between {low:.4g} and {high:.4g}"

"""Why numbers of a motion are unknown over a set: the operation that has no value or no derivative for some operands."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

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
    evaluation, tangents = _Evaluation(read), Tangents(lambda location: _TANGENT if varies(location) else None)
    computed = [line for line in lines if isinstance(line, Load | Compute)]
    results = [line.value for line in lines if isinstance(line, StoreTo)]
    for line in computed:
        evaluation.compute(line, line)
    if reason := evaluation.reason(results):
        return reason
    for line in computed:
        written = len(tangents.lines)
        tangents.follow(line)
        for tangent_line in tangents.lines[written:]:
            evaluation.compute(tangent_line, line)
    return evaluation.reason(map(tangents.tangent_of, results))


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

    def reason(self, results: Iterable[Operand]) -> str:
        """Describe the operation that leaves one of some results undefined; empty if all are defined."""
        for result in results:
            if self.interval(result).flaw != SMOOTH:
                return self._words(str(result))
        return ""

    def _words(self, name: str) -> str:
        """Describe the operation that leaves a value undefined: the first, whose operands are all defined."""
        while (undefined := self._undefined_operand(self._lines[name][0])) is not None:
            name = undefined
        line, origin = self._lines[name]
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

    def _undefined_operand(self, line: Compute) -> str | None:
        """Return the first operand that is undefined: of a choice its condition, if that is undecided, or what it chooses."""
        operands = line.arguments
        if line.operation == "choose":
            condition, chosen, other = operands
            low, high, _ = self.interval(condition)
            if low < high:
                return str(condition)
            operands = (chosen if low else other,)
        computed = [operand for operand in operands if isinstance(operand, str) and operand in self._lines]
        return next((operand for operand in computed if self._intervals[operand].flaw != SMOOTH), None)

    def _range_words(self, operand: Operand) -> str:
        low, high, _ = self.interval(operand)
        return f"between {low:.4g} and {high:.4g}"

"""The operations on intervals behind addresses: each reads its operands where a row says, and stores its result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary import SETS
from xdynamics.elementary.bounds import Interval
from xdynamics.elementary.curve_bounds import POLYNOMIALS, on_curve
from xdynamics.elementary.intervals import Intervals
from xdynamics.elementary.llvm_numbers import FunctionLines, LaneValue
from xdynamics.elementary.text import count_calls, declarations, definitions, written_intervals
from xdynamics.kernels import machine
from xdynamics.kernels.compiling import PLAINLY, keys_of
from xdynamics.kernels.interval_program import OPERANDS, RULES, VARIABLES
from xdynamics.kernels.program import WORDS
from xdynamics.march.run import ARRAYS, PIECE, PLAN, Run

Rule = tuple[str, bool]  # an operation, and whether it is for a first look at a step
ROUGH = ("sin", "cos")  # those that a first look evaluates once instead of twice
_KEPT: list[machine.Code] = []  # as long as the process, as the addresses


@lru_cache(maxsize=64)
def operation_addresses(math_functions: str, needed: frozenset[str], degree: int = 0) -> NDArray[np.int64]:
    """Return addresses of operations in the order of `RULES`, then those for a first look; 0 for what is not needed.

    Variables are enclosed by the polynomial of some degree that a step leaves, or by Hermite's where that is 0.
    """
    fine: list[Rule] = [(name, False) for name in RULES if name in needed]
    rough: list[Rule] = [(name, True) for name in ROUGH if name in needed]
    address = (_plain_operations if PLAINLY else _compiled_operations)(math_functions, [*fine, *rough], degree)
    exact = [address.get((name, False), 0) for name in RULES]
    return np.array([*exact, *(address.get((name, True), exact[i]) for i, name in enumerate(RULES))], np.int64)


def _compiled_operations(math_functions: str, requested_rules: list[Rule], degree: int) -> dict[Rule, int]:
    symbols = {rule: f"{rule[0]}_{'roughly' if rule[1] else 'finely'}" for rule in requested_rules}
    entries = "\n".join(_print_operation(symbol, *rule, degree) for rule, symbol in symbols.items())
    functions = definitions(dict.fromkeys(count_calls(entries), False), 1, math_functions)
    _KEPT.append(machine.compiled(f"{declarations(1)}\n{functions}\n{entries}", symbols.values()))
    return {rule: _KEPT[-1].addresses[symbol] for rule, symbol in symbols.items()}


def _plain_operations(math_functions: str, requested_rules: list[Rule], degree: int) -> dict[Rule, int]:
    keys = keys_of(in_python(name, math_functions, rough=rough, degree=degree) for name, rough in requested_rules)
    return dict(zip(requested_rules, keys, strict=True))


def in_python(
    name: str, math_functions: str, *, rough: bool = False, degree: int = 0
) -> Callable[[Run, Any, Any, int], None]:
    """Return an operation as a function of a run, two of its states and the number of a row, in plain Python."""

    def operation(run: Run, y: Any, z: Any, row: int) -> None:
        target, *places = run.rows[row, 1 : 2 + OPERANDS[name]].tolist()
        kind = Intervals(SETS[math_functions], float(run.plan[0].margin), rough)
        if name in VARIABLES:
            piece, error = run.piece[0], float(run.piece[0].wide * abs(run.located_e[places[VARIABLES[name]]]))
            ends = [[float(state[state_index]) for state in (y, z)] for state_index in places]
            operands: list[Any] = [
                *(end[k] for k in range(2) for end in ends),
                float(piece.width),
                error,
                int(piece.part),
            ]
            if degree:
                coefficients = [
                    float(run.w[k]) for k in _coefficient_indices(run.plan[0], places[: POLYNOMIALS[name]], degree)
                ]
                shares = float(piece.full), float(piece.first), float(piece.last)
                operands = [*coefficients, *(number for end in ends for number in end), *operands[-3:], *shares]
        else:
            operands = [Interval(float(run.under[k]), float(run.over[k]), int(run.flaws[k])) for k in places]
        run.under[target], run.over[target], run.flaws[target] = kind.of(_operation(name, degree), *operands)

    return operation


def _operation(name: str, degree: int) -> str:
    """Return the name of an operation among those of `elementary.intervals`."""
    return on_curve(name) if degree and name in VARIABLES else name


def _coefficient_indices(plan: Any, places: Sequence[int], degree: int) -> list[int]:
    """Return where in `w` the coefficients of components are."""
    return [int(plan.curve + power * plan.used) + state_index for state_index in places for power in range(degree + 1)]


def _print_operation(symbol: str, name: str, rough: bool, degree: int) -> str:
    """Print an operation as a function of a run's table, two of its states and a row."""
    write = _Lines(1)
    under_array, over_array, flaws = (write.array(array) for array in ("under", "over", "flaws"))
    target, *places = (write.word("%row", 1 + k).text for k in range(1 + OPERANDS[name]))
    kind = written_intervals(write, write.field(PLAN, "plan", "margin"), rough=rough)
    if name in VARIABLES:
        ends = [[write.number(state, state_index) for state in ("%y", "%z")] for state_index in places]
        error = write.number(write.array("located_e"), places[VARIABLES[name]]).absolute()
        width, wide, part = (write.field(PIECE, "piece", field) for field in ("width", "wide", "part"))
        operands: list[Any] = [*(end[k] for k in range(2) for end in ends), width, wide * error, part]
        if degree:
            shares = [write.field(PIECE, "piece", field) for field in ("full", "first", "last")]
            coefficients = write.coefficients(places[: POLYNOMIALS[name]], degree)
            operands = [*coefficients, *(number for end in ends for number in end), *operands[-3:], *shares]
    else:
        operands = [
            Interval(write.number(under_array, k), write.number(over_array, k), write.word(flaws, k)) for k in places
        ]
    for value, letter, array in zip(
        map(write.value, kind.of(_operation(name, degree), *operands)),
        ("double", "double", "i64"),
        (under_array, over_array, flaws),
        strict=True,
    ):
        write.lines.append(f"store {letter} {value.text}, ptr {write.word_address(array, target)}, align 8")
    body = "\n  ".join(write.lines)
    return f"define void @{symbol}(ptr %run, ptr %y, ptr %z, ptr %row) nounwind {{\n  {body}\n  ret void\n}}"


class _Lines(FunctionLines):
    """Lines that read arrays of a run."""

    def word_address(self, begin: str, number: int | str) -> str:
        """Write the address of a word."""
        return self.line("p", f"getelementptr i64, ptr {begin}, i64 {number}").text

    def word(self, begin: str, number: int | str) -> LaneValue:
        """Read a whole number."""
        return self.line("w", f"load i64, ptr {self.word_address(begin, number)}, align 8")

    def number(self, begin: str, number: int | str) -> LaneValue:
        """Read a number."""
        return self.line("n", f"load double, ptr {self.word_address(begin, number)}, align 8")

    def coefficients(self, places: Sequence[str], degree: int) -> list[LaneValue]:
        """Read those of the step's polynomial, of components of the state."""
        array, used = self.array("w"), self.field(PLAN, "plan", "used").text
        values_read, first = [], self.field(PLAN, "plan", "curve").text
        for state_index in places:
            term = self.line("w", f"add i64 {first}, {state_index}").text
            for power in range(degree + 1):
                if power:
                    term = self.line("w", f"add i64 {term}, {used}").text
                values_read.append(self.number(array, term))
        return values_read

    def array(self, name: str) -> str:
        """Write where an array begins."""
        entry_address = self.word_address("%run", WORDS * list(ARRAYS).index(name))
        return self.line("p", f"load ptr, ptr {entry_address}, align 8, !invariant.load !0").text

    def field(self, record: Any, array: str, name: str) -> LaneValue:
        """Read a field of an array's only record."""
        dtype, offset = record.fields[name][:2]
        return (self.number if dtype.kind == "f" else self.word)(self.array(array), offset // 8)

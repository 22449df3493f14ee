"""Whether an event function may have a zero in a step, in every lane: `march.events.enclosures` as a program.

The rows of `kernels.interval_program` up to the functions themselves, each as lines with the operations that the single
march performs for it, in the same order: a lane that rules out a zero has the bounds of the single march.
"""

from __future__ import annotations

from collections.abc import Callable

from xdynamics.expressions import parse
from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.interval_program import (
    COMPARED,
    CONSTANT,
    COORDINATE,
    NUMBER,
    OPERATIONS,
    PHASE,
    STATE,
    TIME,
    Enclosing,
    enclosing,
)
from xdynamics.kernels.layout import Layout
from xdynamics.kernels.program import AT, Compute, Load, Operand, Place, Store
from xdynamics.kernels.rounding_margins import ARCHED, BENT, EPS, LEAST, MOST, ROUNDED, ULPS, UNBOUNDED
from xdynamics.model.detectors import GAP, GRIP, LIMIT, PULL

Line = Compute | Load | Store
Bounds = tuple[Operand, Operand, Operand]  # lower and upper bound of a value, and its flaw
NUMBERS: dict[str, Operand] = {
    "eps": EPS,
    "ulps": ULPS,
    "rounded": ROUNDED,
    "least": LEAST,
    "most": MOST,
    "arched": ARCHED,
    "bent_by": BENT,
    "unbounded": float(UNBOUNDED),
    "two_pi": 6.283185307179586,
    "inf": float("inf"),
}
# Lines that compute `low` and `high` from the operands a_low, a_high, b_low, b_high: bounds, rounded outward where
# `_OUTWARD` follows. A result that is not an interval may be anything.
_OUTWARD = """
low = where(low > most, most, low - (abs(low) + least)*eps)
high = where(high < -most, -most, high + (abs(high) + least)*eps)
"""
_SETTLED = """
under = where(low <= high, low, -inf)
over = where(low <= high, high, inf)
flaw = where(low <= high, flaw, unbounded)
"""
_PRODUCT = """
w = a_low*b_low
x = a_low*b_high
y = a_high*b_low
z = a_high*b_high
low = min(min(w, x), min(y, z))
high = max(max(w, x), max(y, z))
sound = where(w == w, where(x == x, where(y == y, where(z == z, 1, 0), 0), 0), 0)
low = where(sound > 0, low, -inf)
high = where(sound > 0, high, inf)
"""
_INVERSE = """
c_low = 1/b_high
c_low = where(c_low > most, most, c_low - (abs(c_low) + least)*eps)
c_high = 1/b_low
c_high = where(c_high < -most, -most, c_high + (abs(c_high) + least)*eps)
spans = where(b_low <= 0, where(0 <= b_high, 1, 0), 0)
flaw = where(spans > 0, unbounded, flaw)
a_low = where(spans > 0, -inf, a_low)
a_high = where(spans > 0, inf, a_high)
b_low = where(spans > 0, 1, c_low)
b_high = where(spans > 0, 1, c_high)
"""
_SQUARE = """
one = abs(a_low)
other = abs(a_high)
low = where(one > other, other, one)
high = where(one > other, one, other)
low = where(a_low < 0, where(0 < a_high, 0, low), low)
low = low*low
high = high*high
"""
_WAVE = """
narrow = where(a_high - a_low < two_pi, where(abs(a_low) < 1e15, where(abs(a_high) < 1e15, 1, 0), 0), 0)
middle = {0}((a_low + a_high)/2)
half = (a_high - a_low)/2 + ulps*(abs(a_low) + abs(a_high) + 1)
low = where(narrow > 0, max(-1, middle - half), -1)
high = where(narrow > 0, min(1, middle + half), 1)
finite = where(abs(a_low) <= most, where(abs(a_high) <= most, 1, 0), 0)
flaw = where(finite > 0, flaw, unbounded)
"""
_SQRT = """
low = sqrt(a_low)
low = where(a_low < 0, 0, max(0, low - (abs(low) + least)*eps))
flaw = where(a_low < 0, unbounded, flaw)
high = sqrt(a_high)
high = high + (abs(high) + least)*eps
"""
_CHOICE = """
low = where(a_low == 1, b_low, where(a_high == 0, c_low, min(b_low, c_low)))
high = where(a_low == 1, b_high, where(a_high == 0, c_high, max(b_high, c_high)))
flaw = where(a_low == 1, b_flaw, where(a_high == 0, c_flaw, max(1, max(b_flaw, c_flaw))))
"""
# whether a comparison always holds, and whether it never holds
_COMPARISON = """
always = {0}
never = {1}
told = where(flaw < unbounded, 1, 0)
low = told*always
high = 1 - told*never
flaw = 0
"""
_EQUAL = "where(a_low == a_high, where(a_high == b_low, where(b_low == b_high, 1, 0), 0), 0)"
_APART = "where(a_high < b_low, 1, where(a_low > b_high, 1, 0))"
_MONOTONE = """
one = {0}(a_low)
other = {0}(a_high)
low = where(one > other, other, one)
high = where(one > other, one, other)
low = low - ulps*abs(low)
high = high + ulps*abs(high)
"""
_ROWS = {
    "add": "low = a_low + b_low\nhigh = a_high + b_high" + _OUTWARD,
    "subtract": "low = a_low - b_high\nhigh = a_high - b_low" + _OUTWARD,
    "multiply": _PRODUCT + _OUTWARD,
    "square": _SQUARE + _OUTWARD,
    "divide": _INVERSE + _PRODUCT + _OUTWARD,
    "negative": "low = -a_high\nhigh = -a_low",
    "abs": (
        "one = abs(a_low)\nother = abs(a_high)\nleast_size = min(one, other)\n"
        "low = where(a_low < 0, where(0 < a_high, 0, least_size), least_size)\nhigh = max(one, other)"
    ),
    "least": "low = min(a_low, b_low)\nhigh = min(a_high, b_high)",
    "greatest": "low = max(a_low, b_low)\nhigh = max(a_high, b_high)",
    "positive": "low = a_low\nhigh = a_high\nflaw = where(a_low > 0, flaw, unbounded)",
    "sqrt": _SQRT,
    "choose": _CHOICE,
    "less": _COMPARISON.format("where(a_high < b_low, 1, 0)", "where(a_low >= b_high, 1, 0)"),
    "at_most": _COMPARISON.format("where(a_high <= b_low, 1, 0)", "where(a_low > b_high, 1, 0)"),
    "more": _COMPARISON.format("where(a_low > b_high, 1, 0)", "where(a_high <= b_low, 1, 0)"),
    "at_least": _COMPARISON.format("where(a_low >= b_high, 1, 0)", "where(a_high < b_low, 1, 0)"),
    "equal": _COMPARISON.format(_EQUAL, _APART),
    "unequal": _COMPARISON.format(_APART, _EQUAL),
    "sin": _WAVE.format("sin"),
    "cos": _WAVE.format("cos"),
    **{name: _MONOTONE.format(name) + _OUTWARD for name in ("exp", "tanh", "sinh", "atan")},
}
# bounds of a coordinate, its velocity, its acceleration; of a state and its rate: `march.events.enclosures`
_ODD = """
odd = abs((q1 - q0) - w*(v0 + v1)/2 + w*w*(a1 - a0)/12)
even = abs(v1 - v0 - w*(a0 + a1)/2)
off = odd + w*even/128
size = max(abs(q0), abs(q1))
fastest = max(abs(v0), abs(v1))
"""
_WIDENED = "low = low - off\nhigh = high + off" + _OUTWARD
_COORDINATE = (
    _ODD
    + """
b1 = q0 + w*v0/5
b2 = q0 + 2*w*v0/5 + w*w*a0/20
b4 = q1 - w*v1/5
b3 = q1 - 2*w*v1/5 + w*w*a1/20
low = min(min(min(q0, b1), min(b2, b3)), min(min(b4, q1), min(b4, q1)))
high = max(max(max(q0, b1), max(b2, b3)), max(max(b4, q1), max(b4, q1)))
off = off + rounded*size
"""
    + _WIDENED,
    _ODD
    + """
b1 = v0 + w*a0/3
b2 = v1 - w*a1/3
low = min(min(v0, b1), min(b2, v1))
high = max(max(v0, b1), max(b2, v1))
off = 4*off/w
held = min(off, w*max(abs(a0), abs(a1)))
off = where(odd <= 4*rounded*(size + w*fastest), held, off)
off = off + rounded*fastest
"""
    + _WIDENED,
    _ODD
    + """
low = min(a0, a1)
high = max(a0, a1)
bent = 24*odd/(w*w)
off = bent + 2*even/w
off = off + rounded*max(abs(a0), abs(a1))
"""
    + _WIDENED,
)
_TURNED = """
odd = abs((x1 - x0) - w*(r0 + r1)/2)
even = w*abs(r1 - r0)
"""
_STATE = (
    _TURNED
    + """
off = odd/8 + even/64
b1 = x0 + w*r0/3
b2 = x1 - w*r1/3
low = min(min(x0, b1), min(b2, x1))
high = max(max(x0, b1), max(b2, x1))
off = off + rounded*max(abs(x0), abs(x1))
"""
    + _WIDENED,
    _TURNED
    + """
low = min(r0, r1)
high = max(r0, r1)
off = (arched*odd + bent_by*even)/w
off = off + rounded*max(abs(r0), abs(r1))
"""
    + _WIDENED,
)
_TWO = ("add", "subtract", "multiply", "divide", "least", "greatest", *COMPARED)
_ARGUMENTS = dict.fromkeys(_TWO, 2) | {"choose": 3}
_KNOWN = {NUMBER, CONSTANT, TIME, PHASE, COORDINATE, STATE}


def can_be_watched(layout: Layout) -> bool:
    """Return whether all event functions consist of operations that this module can write."""
    enclosures = enclosing(layout)
    rows = enclosures.rows[: enclosures.parts[1], 0].tolist()
    return all(row in _KNOWN or (row < len(OPERATIONS) and OPERATIONS[row] in _ROWS) for row in rows)


def bounds(layout: Layout, width: Operand, end: Operand) -> tuple[list[Line], list[Bounds]]:
    """Write lines that bound the event functions between the state `y` and the state `z`.

    Parameters
    ----------
    layout : Layout
    width, end : operand
        Size of the step, and the time at its end.

    Returns
    -------
    list of instruction
    list of (operand, operand, operand)
        Lower bound, upper bound and flaw of each function.
    """
    write = _Writing(layout, width, end)
    return write.lines, [write.known[place] for place in write.said.functions]


class _Writing:
    """Writes the rows, one after another."""

    def __init__(self, layout: Layout, width: Operand, end: Operand) -> None:
        self.said: Enclosing = enclosing(layout)
        self.lines: list[Line] = []
        self.known: dict[int, Bounds] = {}
        self._layout, self._width, self._end, self._count = layout, width, end, 0
        writers: dict[int, Callable[[list[int]], Bounds]] = {
            NUMBER: lambda row: self._point(float(self.said.numbers[row[2]])),
            CONSTANT: lambda row: self._point(self._loaded(Place("p", row[2]))),
            PHASE: lambda _: self._point(self._loaded(Place("at", AT.index("regime")))),
            TIME: lambda _: (self._loaded(Place("w", 0)), self._end, 0.0),
            COORDINATE: self._coordinate,
            STATE: self._state,
        }
        for row in self.said.rows[: self.said.parts[1]].tolist():
            self.known[row[1]] = writers[row[0]](row) if row[0] in writers else self._operation(row)

    @staticmethod
    def _point(value: Operand) -> Bounds:
        return value, value, 0.0

    def _operation(self, row: list[int]) -> Bounds:
        name = OPERATIONS[row[0]]
        if name == "multiply" and row[2] == row[3]:
            name = "square"
        operands: dict[str, Operand] = {}
        for letter, place in zip("abc"[: _ARGUMENTS.get(name, 1)], row[2:], strict=False):
            operands |= dict(zip((f"{letter}_low", f"{letter}_high", f"{letter}_flaw"), self.known[place], strict=True))
        flaw = "flaw = max(a_flaw, b_flaw)\n" if "b_flaw" in operands else "flaw = a_flaw\n"
        return self._written(flaw + _ROWS[name], operands)

    def _coordinate(self, row: list[int]) -> Bounds:
        n, used, i = len(self._layout.coordinates), len(self._layout.used), row[2]
        operands = {
            f"{letter}{end}": self._loaded(Place(array, first + i))
            for end, array in enumerate("yz")
            for letter, first in (("q", 0), ("v", n), ("a", used))
        }
        return self._written(_COORDINATE[row[3]], operands)

    def _state(self, row: list[int]) -> Bounds:
        n, used, i = len(self._layout.coordinates), len(self._layout.used), row[2]
        operands = {
            f"{letter}{end}": self._loaded(Place(array, first + i))
            for end, array in enumerate("yz")
            for letter, first in (("x", 2 * n), ("r", used + n))
        }
        return self._written(_STATE[row[3]], operands)

    def _written(self, text: str, operands: dict[str, Operand]) -> Bounds:
        """Write lines, in which a name may be assigned again."""
        values = NUMBERS | {"w": self._width, "flaw": 0.0} | operands
        for line in filter(None, (text + _SETTLED).split("\n")):
            target, expression = line.split(" = ")
            self._count += 1
            write = Assignments(lambda _, name: values[name], f"_b{self._count}_")
            values[target] = write.value(parse(expression))
            self.lines += write.lines
        return values["under"], values["over"], values["flaw"]

    def _loaded(self, place: Place) -> Operand:
        self._count += 1
        self.lines.append(Load(f"_b{self._count}", place))
        return f"_b{self._count}"


def is_gap(layout: Layout) -> list[bool]:
    """Return for every event function whether it is the gap of a contact."""
    return [detector.role == GAP for detector in layout.watched]


def is_bounded(layout: Layout) -> list[bool]:
    """Return for every event function whether lanes watch it: not those that act only while a reaction holds.

    Lanes make no step with a reaction that holds.
    """
    return [detector.role not in (PULL, LIMIT, GRIP) for detector in layout.watched]

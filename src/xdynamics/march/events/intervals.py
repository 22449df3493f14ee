"""Interval arithmetic, rounded outward: the operations of the language that rows of `kernels.interval_program` ask for.

A value is known by a lower and an upper bound, and by whether it may jump or be undefined (Moore, Kearfott, Cloud,
Introduction to Interval Analysis, 2009).
"""

from __future__ import annotations

from math import inf, pi

import numpy as np

from xdynamics.kernels import interval_program
from xdynamics.kernels.compiling import compiled, shared
from xdynamics.kernels.interval_program import ARITHMETIC, COMPARED, OPERATION
from xdynamics.kernels.rounding_margins import BREAKS, EPS, MOST, SMOOTH, ULPS, UNBOUNDED
from xdynamics.march.handle import applied
from xdynamics.march.run import Run

ADD, SUBTRACT, MULTIPLY, DIVIDE, NEGATIVE, SQRT, ABS, MINIMUM, MAXIMUM, SIGN = (OPERATION[name] for name in ARITHMETIC)
CHOOSE, HYPOT, ATAN2, POWER, POSITIVE = (OPERATION[name] for name in ("choose", "hypot", "atan2", "power", "positive"))
LESS, AT_MOST, MORE, AT_LEAST, EQUAL, UNEQUAL = (OPERATION[name] for name in COMPARED)
SIN, COS, TAN, ASIN, ACOS, ATAN, SINH, COSH, TANH, EXP, LOG = (OPERATION[name] for name in interval_program.CALLED)


@shared
def below(run: Run, x: float) -> float:
    """A number below x; -inf where x is."""
    return MOST if x == inf else x - (abs(x) + run.plan[0].margin) * EPS


@shared
def above(run: Run, x: float) -> float:
    """A number above x; inf where x is."""
    return -MOST if x == -inf else x + (abs(x) + run.plan[0].margin) * EPS


@shared
def least_of(w: float, x: float, y: float, z: float) -> float:
    """The least of four numbers."""
    return min(min(w, x), min(y, z))  # noqa: PLW3301 - two at a time: one order of comparisons


@shared
def most_of(w: float, x: float, y: float, z: float) -> float:
    """The greatest of four numbers."""
    return max(max(w, x), max(y, z))  # noqa: PLW3301


@shared
def put(run: Run, target: int, low: float, high: float, flaw: int) -> None:
    """Store the bounds of a value; where they are no interval, it may be anything."""
    sound = low <= high
    run.under[target] = low if sound else -inf
    run.over[target] = high if sound else inf
    run.flaws[target] = flaw if sound else UNBOUNDED


@compiled
def arithmetic(run: Run, row: int, target: int, a: int, b: int) -> None:
    """Add, subtract, multiply, divide."""
    low, high, from_, to = run.under[a], run.over[a], run.under[b], run.over[b]
    flaw = max(run.flaws[a], run.flaws[b])
    if row == ADD:
        low, high = low + from_, high + to
    elif row == SUBTRACT:
        low, high = low - to, high - from_
    else:
        if row == DIVIDE:
            if from_ <= 0.0 <= to:
                low, high, from_, to, flaw = -inf, inf, 1.0, 1.0, UNBOUNDED
            else:
                from_, to = below(run, 1.0 / to), above(run, 1.0 / from_)
        if a == b and row == MULTIPLY:
            low, high = abs(low), abs(high)
            if low > high:
                low, high = high, low
            if run.under[a] < 0.0 < run.over[a]:
                low = 0.0
            low, high = low * low, high * high
        else:
            w, x, y, z = low * from_, low * to, high * from_, high * to
            low, high = least_of(w, x, y, z), most_of(w, x, y, z)
            if not (w == w and x == x and y == y and z == z):
                low, high = -inf, inf
    put(run, target, below(run, low), above(run, high), flaw)


@shared
def function(run: Run, row: int, target: int, a: int, b: int, c: int) -> None:
    """Enclose the result of any other operation of the language."""
    low, high, flaw = run.under[a], run.over[a], run.flaws[a]
    if row == NEGATIVE:
        put(run, target, -high, -low, flaw)
    elif row == ABS:
        inside = low < 0.0 < high
        least, most = min(abs(low), abs(high)), max(abs(low), abs(high))
        put(run, target, 0.0 if inside else least, most, flaw)
    elif row == SQRT:
        undefined = low < 0.0
        least = 0.0 if undefined else max(0.0, below(run, np.sqrt(low)))
        put(run, target, least, above(run, np.sqrt(high)), UNBOUNDED if undefined else flaw)
    elif row == SIGN:
        least, most = np.sign(low), np.sign(high)
        put(run, target, least, most, flaw if least == most else max(flaw, BREAKS))
    elif row == MINIMUM:
        put(run, target, min(low, run.under[b]), min(high, run.over[b]), max(flaw, run.flaws[b]))
    elif row == MAXIMUM:
        put(run, target, max(low, run.under[b]), max(high, run.over[b]), max(flaw, run.flaws[b]))
    elif row == POSITIVE:
        put(run, target, low, high, flaw if low > 0.0 else UNBOUNDED)
    elif row == CHOOSE:
        choose(run, target, a, b, c)
    elif LESS <= row <= UNEQUAL:
        compare(run, row, target, a, b)
    else:
        elementary(run, row, target, a, b)


@shared
def choose(run: Run, target: int, a: int, b: int, c: int) -> None:
    """Enclose the branch that is taken, or both where the condition is undecided."""
    if run.under[a] == 1.0:
        put(run, target, run.under[b], run.over[b], run.flaws[b])
    elif run.over[a] == 0.0:
        put(run, target, run.under[c], run.over[c], run.flaws[c])
    else:
        low, high = min(run.under[b], run.under[c]), max(run.over[b], run.over[c])
        put(run, target, low, high, max(BREAKS, run.flaws[b], run.flaws[c]))


@shared
def compare(run: Run, row: int, target: int, a: int, b: int) -> None:
    """Enclose the truth of a comparison: 1, 0, or from 0 to 1 where it is undecided."""
    low, high, from_, to = run.under[a], run.over[a], run.under[b], run.over[b]
    always, never = False, False
    if max(run.flaws[a], run.flaws[b]) == UNBOUNDED:  # a NaN is neither less nor more
        pass
    elif row == LESS:
        always, never = high < from_, low >= to
    elif row == AT_MOST:
        always, never = high <= from_, low > to
    elif row == MORE:
        always, never = low > to, high <= from_
    elif row == AT_LEAST:
        always, never = low >= to, high < from_
    else:
        equal, apart = low == high == from_ == to, high < from_ or low > to
        always, never = (equal, apart) if row == EQUAL else (apart, equal)
    put(run, target, 1.0 if always else 0.0, 0.0 if never else 1.0, SMOOTH)


@shared
def computed(run: Run, row: int, x: float) -> float:
    """The value of the portable function itself."""
    return applied(run.functions[row - SIN], x)


@shared
def elementary(run: Run, row: int, target: int, a: int, b: int) -> None:
    """Enclose a function whose result is not correctly rounded."""
    low, high, flaw = run.under[a], run.over[a], run.flaws[a]
    if row in (SIN, COS):
        wave(run, target, low, high, flaw, 0.5 if row == SIN else 0.0)
        return
    if row in (HYPOT, ATAN2):
        in_plane(run, row, target, a, b)
        return
    if row == COSH:
        least = 0.0 if low < 0.0 < high else min(abs(low), abs(high))
        low, high = computed(run, row, least), computed(run, row, max(abs(low), abs(high)))
    elif row == POWER:
        if low < 0.0:
            low, flaw = 0.0, UNBOUNDED
        exponent = run.under[b]
        low, high = powered(run, low, exponent, -ULPS), powered(run, high, exponent, ULPS)
    elif row == TAN:
        slack = ULPS * (abs(low) + abs(high) + 1.0)
        if high - low >= 3.0 or np.floor((high + slack) / pi + 0.5) != np.floor((low - slack) / pi + 0.5):
            put(run, target, -inf, inf, UNBOUNDED)
            return
        low, high = computed(run, row, low), computed(run, row, high)
    else:
        if row == LOG and low <= 0.0:
            low, flaw = 0.0, UNBOUNDED
        if row in (ASIN, ACOS):
            if low < -1.0 or high > 1.0:
                flaw = UNBOUNDED
            low, high = min(1.0, max(-1.0, low)), min(1.0, max(-1.0, high))
        low, high = computed(run, row, low), computed(run, row, high)
    if low > high:
        low, high = high, low
    put(run, target, below(run, low - ULPS * abs(low)), above(run, high + ULPS * abs(high)), flaw)


@shared
def powered(run: Run, x: float, exponent: float, slack: float) -> float:
    """A power of a non-negative number; its logarithm is moved by a share `slack` to cover rounding."""
    if x <= 0.0 or x == inf:
        return x
    logarithm = exponent * computed(run, LOG, x)
    return computed(run, EXP, logarithm + slack * abs(logarithm))


@shared
def wave(run: Run, target: int, low: float, high: float, flaw: int, shift: float) -> None:
    """Enclose a sine (`shift` 0.5) or a cosine (`shift` 0): its values at the ends, and the crests between."""
    if not (high - low < 2.0 * pi and abs(low) < 1e15 and abs(high) < 1e15):
        put(run, target, -1.0, 1.0, flaw if abs(low) < inf and abs(high) < inf else UNBOUNDED)
        return
    row = SIN if shift > 0.0 else COS
    if run.piece[0].rough == 1:  # one call instead of two
        middle, half = computed(run, row, (low + high) / 2.0), (high - low) / 2.0 + ULPS * (abs(low) + abs(high) + 1.0)
        put(run, target, max(-1.0, middle - half), min(1.0, middle + half), flaw)
        return
    at_low, at_high = computed(run, row, low), computed(run, row, high)
    least, most = min(at_low, at_high), max(at_low, at_high)
    slack = ULPS * (abs(low) + abs(high) + 1.0)
    first, last = (low - slack) / pi - shift, (high + slack) / pi - shift  # crests at even, troughs at odd numbers
    if np.floor(last / 2.0) >= np.ceil(first / 2.0):
        most = 1.0
    if np.floor((last - 1.0) / 2.0) >= np.ceil((first - 1.0) / 2.0):
        least = -1.0
    least, most = below(run, least - ULPS * abs(least)), above(run, most + ULPS * abs(most))
    put(run, target, max(-1.0, least), min(1.0, most), flaw)


@shared
def in_plane(run: Run, row: int, target: int, a: int, b: int) -> None:
    """Enclose the length of a vector, or its angle."""
    low, high, from_, to = run.under[a], run.over[a], run.under[b], run.over[b]
    flaw = max(run.flaws[a], run.flaws[b])
    if row == HYPOT:
        x = 0.0 if low < 0.0 < high else min(abs(low), abs(high))
        y = 0.0 if from_ < 0.0 < to else min(abs(from_), abs(to))
        least, most = length(x, y), length(max(abs(low), abs(high)), max(abs(from_), abs(to)))
        put(run, target, max(0.0, below(run, least - ULPS * least)), above(run, most + ULPS * most), flaw)
    elif from_ <= 0.0 and low <= 0.0 <= high:  # the angle's cut, or the origin
        put(run, target, -pi - ULPS, pi + ULPS, max(flaw, BREAKS))
    else:
        w, x = angle(run, low, from_), angle(run, low, to)
        y, z = angle(run, high, from_), angle(run, high, to)
        least, most = least_of(w, x, y, z), most_of(w, x, y, z)
        put(run, target, below(run, least - ULPS * abs(least)), above(run, most + ULPS * abs(most)), flaw)


@shared
def length(x: float, y: float) -> float:
    """The length of a vector, without overflow."""
    large, small = max(x, y), min(x, y)
    return large * np.sqrt(1.0 + (small / large) * (small / large)) if 0.0 < large < inf else large


@shared
def angle(run: Run, y: float, x: float) -> float:
    """The angle of a vector that is not the origin."""
    if abs(x) >= abs(y):
        turned = computed(run, ATAN, y / x)
        return turned if x > 0.0 else (turned + pi if y >= 0.0 else turned - pi)
    turned = computed(run, ATAN, x / y)
    return pi / 2.0 - turned if y > 0.0 else -pi / 2.0 - turned

"""What event functions are between two states of the motion: intervals that hold every value on the way.

Between two states of a step a coordinate is Hermite's polynomial through both positions, velocities and accelerations, a
first-order state that through both values and rates, each widened by how far such polynomials of lower degree are from
it. Their Bernstein coefficients hold them, and interval arithmetic, rounded outward, the functions (Moore, Kearfott,
Cloud, Introduction to Interval Analysis, 2009). The rows that say what to compute are `kernels.enclosing`'s.
"""

from __future__ import annotations

from math import inf, pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels import enclosing
from xdynamics.kernels.compiling import compiled, shared
from xdynamics.kernels.enclosing import (  # fmt: skip
    ARITHMETIC,
    COMPARED,
    CONSTANT,
    COORDINATE,
    NUMBER,
    OPERATION,
    SLOPE,
    STATE,
    TIME,
    VALUE,
)
from xdynamics.kernels.tables import find_piece
from xdynamics.march.handle import applied, floats_at, run_at
from xdynamics.march.run import Run

State = NDArray[Any]

EPS, LEAST, MOST = 2.220446049250313e-16, 5e-324, 1.7976931348623157e308
ROUNDED = 4.0 * EPS  # of a state, relative
ULPS = 4.0 * EPS  # of an elementary function
# how far a rate is from the straight line, by what odd and even say of it, if it is half a wave (pi/2, 1/9.5) or less of one
ARCHED, BENT = 1.571, 0.1053
SMOOTH, BREAKS, UNBOUNDED = 0, 1, 2  # whether a value may jump there, or be infinite or none at all
ADD, SUBTRACT, MULTIPLY, DIVIDE, NEGATIVE, SQRT, ABS, MINIMUM, MAXIMUM, SIGN = (OPERATION[name] for name in ARITHMETIC)
CHOOSE, HYPOT, ATAN2, POWER = (OPERATION[name] for name in ("choose", "hypot", "atan2", "power"))
LESS, AT_MOST, MORE, AT_LEAST, EQUAL, UNEQUAL = (OPERATION[name] for name in COMPARED)
SIN, COS, TAN, ASIN, ACOS, ATAN, SINH, COSH, TANH, EXP, LOG = (OPERATION[name] for name in enclosing.CALLED)


@shared
def below(x: float) -> float:
    """A number under x, or x where it is that already."""
    return MOST if x == inf else x - (abs(x) * EPS + LEAST)


@shared
def above(x: float) -> float:
    """A number over x."""
    return -MOST if x == -inf else x + (abs(x) * EPS + LEAST)


@shared
def least_of(w: float, x: float, y: float, z: float) -> float:
    """The least of four numbers."""
    return min(min(w, x), min(y, z))  # noqa: PLW3301 - two at a time: one order of comparisons


@shared
def most_of(w: float, x: float, y: float, z: float) -> float:
    """The greatest of four numbers."""
    return max(max(w, x), max(y, z))  # noqa: PLW3301


@shared
def enclose(run: Run, y: State, z: State, first: int, last: int) -> None:
    """Compute rows of the event functions on the piece between two states.

    Parameters
    ----------
    run : Run
        Its `piece` says at what times the states are; `under`, `over` and `flaws` are filled.
    y, z : ndarray
        The state at the piece's start and end.
    first, last : int
        Rows.
    """
    for k in range(first, last):
        row, target, a = run.rows[k, 0], run.rows[k, 1], run.rows[k, 2]
        if row <= DIVIDE:
            arithmetic(run, row, target, a, run.rows[k, 3])
        elif row == COORDINATE:
            coordinate(run, y, z, target, a, run.rows[k, 3])
        elif row == STATE:
            companion(run, y, z, target, a, run.rows[k, 3])
        elif row == TIME:
            put(run, target, run.piece[0].start, run.piece[0].end, SMOOTH)
        elif row == NUMBER:
            put(run, target, run.numbers[a], run.numbers[a], SMOOTH)
        elif row == CONSTANT:
            put(run, target, run.p[a], run.p[a], SMOOTH)
        elif row >= VALUE:
            looked_up(run, row, target, a, run.rows[k, 3], run.rows[k, 4])
        else:
            function(run, row, target, a, run.rows[k, 3], run.rows[k, 4])


@shared
def put(run: Run, target: int, low: float, high: float, flaw: int) -> None:
    """Fill the place of a value; what is no interval may be anything."""
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
                from_, to = below(1.0 / to), above(1.0 / from_)
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
    put(run, target, below(low), above(high), flaw)


@compiled
def coordinate(run: Run, y: State, z: State, target: int, i: int, order: int) -> None:
    """Enclose a coordinate, its velocity or its acceleration."""
    n, used, w = run.plan[0].coordinates, run.plan[0].used, run.piece[0].width
    q0, v0, a0, q1, v1, a1 = y[i], y[n + i], y[used + i], z[i], z[n + i], z[used + i]
    # how far cubic polynomials through velocities and positions are from the quintic one, at its middle
    odd = abs((q1 - q0) - w * (v0 + v1) / 2.0 + w * w * (a1 - a0) / 12.0)
    even = abs(v1 - v0 - w * (a0 + a1) / 2.0)
    off, size = odd + w * even / 128.0, max(abs(q0), abs(q1))
    if order == 0:
        b1, b2 = q0 + w * v0 / 5.0, q0 + 2.0 * w * v0 / 5.0 + w * w * a0 / 20.0
        b4, b3 = q1 - w * v1 / 5.0, q1 - 2.0 * w * v1 / 5.0 + w * w * a1 / 20.0
        low = min(least_of(q0, b1, b2, b3), least_of(b4, q1, b4, q1))
        high = max(most_of(q0, b1, b2, b3), most_of(b4, q1, b4, q1))
        off = off + ROUNDED * size + run.piece[0].wide * abs(run.located_e[i])
    elif order == 1:
        b1, b2 = v0 + w * a0 / 3.0, v1 - w * a1 / 3.0
        low, high = least_of(v0, b1, b2, v1), most_of(v0, b1, b2, v1)
        off = 4.0 * off / w if w > 0.0 else 0.0
        if odd <= 4.0 * ROUNDED * (size + w * max(abs(v0), abs(v1))):  # rounding alone, which a short w makes large
            off = min(off, w * max(abs(a0), abs(a1)))
        off = off + ROUNDED * max(abs(v0), abs(v1)) + run.piece[0].wide * abs(run.located_e[n + i])
    else:
        low, high = min(a0, a1), max(a0, a1)
        off = 24.0 * odd / (w * w) + 2.0 * even / w if w > 0.0 else 0.0
        off = off + ROUNDED * max(abs(a0), abs(a1))
    put(run, target, below(low - off), above(high + off), SMOOTH)


@compiled
def companion(run: Run, y: State, z: State, target: int, i: int, order: int) -> None:
    """Enclose a first-order state or its rate."""
    n, used, w = run.plan[0].coordinates, run.plan[0].used, run.piece[0].width
    x0, r0, x1, r1 = y[2 * n + i], y[used + n + i], z[2 * n + i], z[used + n + i]
    odd, even = abs((x1 - x0) - w * (r0 + r1) / 2.0), w * abs(r1 - r0)
    off = odd / 8.0 + even / 64.0
    if order == 0:
        b1, b2 = x0 + w * r0 / 3.0, x1 - w * r1 / 3.0
        low, high = least_of(x0, b1, b2, x1), most_of(x0, b1, b2, x1)
        off = off + ROUNDED * max(abs(x0), abs(x1)) + run.piece[0].wide * abs(run.located_e[2 * n + i])
    else:
        low, high = min(r0, r1), max(r0, r1)
        off = (ARCHED * odd + BENT * even) / w if w > 0.0 else 0.0
        off = off + ROUNDED * max(abs(r0), abs(r1))
    put(run, target, below(low - off), above(high + off), SMOOTH)


@shared
def function(run: Run, row: int, target: int, a: int, b: int, c: int) -> None:
    """Enclose every other operation of the language."""
    low, high, flaw = run.under[a], run.over[a], run.flaws[a]
    if row == NEGATIVE:
        put(run, target, -high, -low, flaw)
    elif row == ABS:
        inside = low < 0.0 < high
        least, most = min(abs(low), abs(high)), max(abs(low), abs(high))
        put(run, target, 0.0 if inside else least, most, flaw)
    elif row == SQRT:
        undefined = low < 0.0
        least = 0.0 if undefined else max(0.0, below(np.sqrt(low)))
        put(run, target, least, above(np.sqrt(high)), UNBOUNDED if undefined else flaw)
    elif row == SIGN:
        least, most = np.sign(low), np.sign(high)
        put(run, target, least, most, flaw if least == most else max(flaw, BREAKS))
    elif row == MINIMUM:
        put(run, target, min(low, run.under[b]), min(high, run.over[b]), max(flaw, run.flaws[b]))
    elif row == MAXIMUM:
        put(run, target, max(low, run.under[b]), max(high, run.over[b]), max(flaw, run.flaws[b]))
    elif row == CHOOSE:
        choose(run, target, a, b, c)
    elif LESS <= row <= UNEQUAL:
        compare(run, row, target, a, b)
    else:
        elementary(run, row, target, a, b)


@shared
def choose(run: Run, target: int, a: int, b: int, c: int) -> None:
    """Enclose the branch that is taken, or both where that is not settled."""
    if run.under[a] == 1.0:
        put(run, target, run.under[b], run.over[b], run.flaws[b])
    elif run.over[a] == 0.0:
        put(run, target, run.under[c], run.over[c], run.flaws[c])
    else:
        low, high = min(run.under[b], run.under[c]), max(run.over[b], run.over[c])
        put(run, target, low, high, max(BREAKS, run.flaws[b], run.flaws[c]))


@shared
def compare(run: Run, row: int, target: int, a: int, b: int) -> None:
    """Say whether a comparison holds: 1, 0, or from 0 to 1 where that depends."""
    low, high, from_, to = run.under[a], run.over[a], run.under[b], run.over[b]
    always, never = False, False
    if max(run.flaws[a], run.flaws[b]) == UNBOUNDED:  # what is no number is neither less nor more
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
    """The portable function itself."""
    return applied(run.functions[row - SIN], x)


@shared
def elementary(run: Run, row: int, target: int, a: int, b: int) -> None:
    """Enclose a function that is not rounded correctly."""
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
    put(run, target, below(low - ULPS * abs(low)), above(high + ULPS * abs(high)), flaw)


@shared
def powered(run: Run, x: float, exponent: float, slack: float) -> float:
    """A power of a number that is not negative; of its logarithm as much is added as rounding may have taken."""
    if x <= 0.0 or x == inf:
        return x
    logarithm = exponent * computed(run, LOG, x)
    return computed(run, EXP, logarithm + slack * abs(logarithm))


@shared
def wave(run: Run, target: int, low: float, high: float, flaw: int, shift: float) -> None:
    """Enclose a sine, or with no shift of half a turn's half a cosine: its values at the ends, and the crests between."""
    if not (high - low < 2.0 * pi and abs(low) < 1e15 and abs(high) < 1e15):
        put(run, target, -1.0, 1.0, flaw if abs(low) < inf and abs(high) < inf else UNBOUNDED)
        return
    row = SIN if shift > 0.0 else COS
    if run.piece[0].rough:  # one call instead of two
        middle, half = computed(run, row, (low + high) / 2.0), (high - low) / 2.0 + ULPS * (abs(low) + abs(high) + 1.0)
        put(run, target, max(-1.0, middle - half), min(1.0, middle + half), flaw)
        return
    one, other = computed(run, row, low), computed(run, row, high)
    least, most = min(one, other), max(one, other)
    slack = ULPS * (abs(low) + abs(high) + 1.0)
    first, last = (low - slack) / pi - shift, (high + slack) / pi - shift  # crests at even, troughs at odd numbers
    if np.floor(last / 2.0) >= np.ceil(first / 2.0):
        most = 1.0
    if np.floor((last - 1.0) / 2.0) >= np.ceil((first - 1.0) / 2.0):
        least = -1.0
    least, most = below(least - ULPS * abs(least)), above(most + ULPS * abs(most))
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
        put(run, target, max(0.0, below(least - ULPS * least)), above(most + ULPS * most), flaw)
    elif from_ <= 0.0 and low <= 0.0 <= high:  # the angle's cut, or the origin
        put(run, target, -pi - ULPS, pi + ULPS, max(flaw, BREAKS))
    else:
        w, x = angle(run, low, from_), angle(run, low, to)
        y, z = angle(run, high, from_), angle(run, high, to)
        least, most = least_of(w, x, y, z), most_of(w, x, y, z)
        put(run, target, below(least - ULPS * abs(least)), above(most + ULPS * abs(most)), flaw)


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


@shared
def looked_up(run: Run, row: int, target: int, a: int, drive: int, of_time: int) -> None:
    """Enclose a drive or its slope: the pieces of the table that the argument passes through."""
    low, high, flaw = run.under[a], run.over[a], run.flaws[a]
    first, count = run.places[3 * drive], run.places[3 * drive + 1]
    if not (low > -inf and high < inf):
        put(run, target, -inf, inf, UNBOUNDED)
        return
    begin = run.places[3 * drive + 2] if of_time else find_piece(low, run.tables, first, count)
    end = begin if of_time else find_piece(high, run.tables, first, count)
    least, most = inf, -inf
    for piece in range(begin, end + 1):
        start = run.tables[first + piece]
        from_ = (low if piece == begin else start) - start
        to = (high if piece == end else run.tables[first + piece + 1]) - start
        c3, c2 = run.tables[first + count + piece], run.tables[first + 2 * count + piece]
        c1, c0 = run.tables[first + 3 * count + piece], run.tables[first + 4 * count + piece]
        if row == SLOPE:
            c3, c2, c1, c0 = 0.0, 3.0 * c3, 2.0 * c2, c1
        # Bernstein coefficients of the cubic between the two
        u, w = from_, to - from_
        b0 = ((c3 * u + c2) * u + c1) * u + c0
        b1 = b0 + w * (((3.0 * c3 * u) + 2.0 * c2) * u + c1) / 3.0
        z0 = ((c3 * to + c2) * to + c1) * to + c0
        b2 = z0 - w * (((3.0 * c3 * to) + 2.0 * c2) * to + c1) / 3.0
        if not (abs(b0) + abs(b1) + abs(b2) + abs(z0) < inf):
            put(run, target, -inf, inf, UNBOUNDED)
            return
        off = ULPS * (abs(c3 * to * to * to) + abs(c2 * to * to) + abs(c1 * to) + abs(c0))
        least = min(least, least_of(b0, b1, b2, z0) - off)
        most = max(most, most_of(b0, b1, b2, z0) + off)
    put(run, target, below(least), above(most), flaw if begin == end else max(flaw, BREAKS))


def enclose_between(address: Any, y: Any, z: Any, first: int, last: int) -> None:
    """Make enclosures, for who calls by address: no caller compiles it again.

    Parameters
    ----------
    address : int
        Of a `Run`.
    y, z : int
        Where the places of two of its states stand.
    first, last : int
        Rows.
    """
    enclose(run_at(address), floats_at(y), floats_at(z), first, last)

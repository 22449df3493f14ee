"""Boxes: arrays of intervals, with every operation rounded outward.

The first index of an array tells lower ends from upper ones.

What IEEE 754 rounds to nearest lies next to the exact result or is it; one float further out is a bound of it, also
where a product underflows (Moore, Kearfott, Cloud, Introduction to Interval Analysis, 2009, section 3.2). An infinite
or undefined end stays one, and is refused where a proof would follow from it.

Constant within a step of a proof are the regime, and the pieces of measured tables that a time is in
(`StepConstants`). A piece is the polynomial that runs look up: its origin and its coefficients are floats, and are
taken as exact. So are the points of tables, on which steps land.

Frames turn with the flow: orthogonal matrices, and proven products with their inverses (Lohner 1987). A `Doubleton` is
a set of states that a flow carries along: a point, the set of starts seen from it, and the errors of the way.
`Polynomials` have coefficients that are intervals, and are evaluated at an interval by Horner's rule.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from math import inf, nextafter, sqrt

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels.program import AT, Compute, Line, Load, Location, Loop, Operand, Program, StoreTo, loop_element
from xdynamics.model import Model
from xdynamics.model.drive_arguments import Table
from xdynamics.model.motion import drive_pieces
from xdynamics.tubes.tangents import PARTS, EnclosedProgram

Box = NDArray[np.float64]  # shape (2, ...)
Floats = NDArray[np.float64]

EPS = 2.0**-52
_SIDES = [np.array([-1.0, 1.0]).reshape(2, *(1,) * n) for n in range(8)]
_TOWARDS = [np.array([-inf, inf]).reshape(2, *(1,) * n) for n in range(8)]


def round_outward(ends: Box) -> Box:
    """Return the next floats outside."""
    wider_ends: Box = np.nextafter(ends, _TOWARDS[ends.ndim - 1])
    return wider_ends


def point_box(values: Floats | float) -> Box:
    """Return intervals that are numbers."""
    numbers = np.asarray(values, float)
    intervals = np.empty((2, *numbers.shape))
    intervals[...] = numbers
    return intervals


def enclosed(exact: Fraction, half_width: Fraction = Fraction(0)) -> Box:
    """Return the interval of an exact number, or from one half width below it to one above."""
    ends = []
    for number, towards in ((exact - half_width, -inf), (exact + half_width, inf)):
        nearest = float(number)
        beyond = Fraction(nearest) > number if towards < 0 else Fraction(nearest) < number
        ends.append(float(np.nextafter(nearest, towards)) if beyond else nearest)
    return np.array(ends)


def add(a: Box, b: Box) -> Box:
    """Add."""
    return round_outward(a + b)


def subtract(a: Box, b: Box) -> Box:
    """Subtract."""
    return round_outward(a - b[::-1])


def multiply(a: Box, b: Box) -> Box:
    """Multiply: the ends are among the products of ends."""
    return _outermost(a[:, None] * b[None])


def _outermost(ends: Box) -> Box:
    """Return the interval of four numbers, rounded outward."""
    outer_ends = np.empty(ends.shape[1:])
    # minimum and maximum hand on nan, as of 0 times infinity: an unknown end stays unknown
    np.minimum.reduce(ends, axis=(0, 1), out=outer_ends[0, ...])
    np.maximum.reduce(ends, axis=(0, 1), out=outer_ends[1, ...])
    return np.asarray(np.nextafter(outer_ends, _TOWARDS[outer_ends.ndim - 1], out=outer_ends))


def divide(a: Box, b: Box) -> Box:
    """Divide by a box without zero; see `has_zero`."""
    return _outermost(a[:, None] / b[None])


def has_zero(a: Box) -> bool:
    """Whether zero, or no number that is known, is among the values."""
    # negated, so that an interval with a nan end counts as one with zero
    return not bool(((a[0] > 0.0) | (a[1] < 0.0)).all())


def sum_along(terms: Box, axis: int = 1) -> Box:
    """Sum along an axis, one addition after the other.

    Rounding errs by (m - 1) u of the sum of sizes, to first order (Higham, Accuracy and Stability of Numerical Algorithms,
    2nd ed., section 4.2), and the bound here is twice that of m terms.
    """
    count = terms.shape[axis]
    last = (slice(None),) * axis + (-1,)
    if count == 1:
        return np.asarray(terms[last])
    sums = np.add.accumulate(terms, axis=axis)[last]
    slack = np.add.accumulate(np.abs(terms), axis=axis)[last]
    slack *= count * EPS
    return round_outward(sums + slack * _SIDES[sums.ndim - 1])


def matrix_product(a: Box, b: Box) -> Box:
    """Multiply matrices, or a matrix with a vector."""
    if b.ndim == 2:
        return sum_along(multiply(a, b[:, None, :]), axis=2)
    return sum_along(multiply(a[:, :, :, None], b[:, None]), axis=2)


def midpoint(a: Box) -> Floats:
    """Return a number in the middle, or nearly."""
    return np.asarray(a[0] + 0.5 * (a[1] - a[0]))


def width(a: Box) -> Floats:
    """Return how far the ends are apart."""
    return np.asarray(a[1] - a[0])


def magnitude(a: Box) -> Floats:
    """Return the largest absolute value."""
    return np.asarray(np.abs(a).max(axis=0))


def hull(a: Box, b: Box) -> Box:
    """Return the least box that holds two."""
    return np.stack([np.minimum(a[0], b[0]), np.maximum(a[1], b[1])])


def intersection(a: Box, b: Box) -> Box:
    """Return the intersection of two boxes that both contain a common value."""
    return np.stack([np.maximum(a[0], b[0]), np.minimum(a[1], b[1])])


def interval_power(x: Box, n: int) -> Box:
    """Raise one interval without negative numbers to a power, by squares."""
    return np.array([_directed_power(float(end), n, towards) for end, towards in zip(x, (0.0, inf), strict=True)])


def _directed_power(x: float, n: int, towards: float) -> float:
    """Raise a number that is not negative to a power, every product being rounded towards zero or infinity."""
    power_value, square = 1.0, x
    while n:
        if n % 2:
            power_value = nextafter(power_value * square, towards)
        n //= 2
        if n:
            square = nextafter(square * square, towards)
    return power_value


UNKNOWN = np.array([[-np.inf], [np.inf]])


def stored_bounds(stored_values: Floats) -> Box:
    """Return the bounds that a program stored as its last axis, unbounded where undefined."""
    ends = np.moveaxis(stored_values[..., :2], -1, 0)
    sound = (stored_values[..., 2] == 0.0) & ~np.isnan(ends).any(axis=0)
    return np.where(sound, ends, UNKNOWN.reshape(2, *(1,) * (ends.ndim - 1)))


HELD = "tables"  # the array that lines read them from: the regime, then of each table origin and coefficients
REGIME = Location("at", AT.index("regime"))
ROWS = 5  # of a table


@dataclass(frozen=True)
class StepConstants:
    """The tables that a motion looks up at a time.

    Attributes
    ----------
    tables : mapping of str to (ndarray, ndarray)
        Origins and coefficients of pieces, by drive.
    """

    tables: dict[str, Table]

    @classmethod
    def of_model(cls, model: Model) -> StepConstants:
        """Return the tables of a model whose drives are all of time."""
        return cls(dict(zip(model.elements.drives, drive_pieces(model), strict=True)) if model.drives else {})

    @property
    def nodes(self) -> Floats:
        """The times at which a piece ends and another begins, ascending, s."""
        times = [origins[np.isfinite(origins)] for origins, _ in self.tables.values()]
        return np.unique(np.concatenate(times)) if times else np.empty(0)

    def values_from(self, regime: float, time: float) -> Floats:
        """Return the constants of a step that begins at a time."""
        step_values = [np.array([regime])]
        for origins, powers in self.tables.values():
            piece = int(np.searchsorted(origins[1:], time, side="right"))
            step_values.append(np.append(origins[piece], powers[:, piece]))
        return np.concatenate(step_values)

    def lacking(self, step_values: Floats) -> str:
        """Return which table has no value; empty if all have one."""
        for i, name in enumerate(self.tables):
            if np.isnan(step_values[1 + ROWS * i : 1 + ROWS * (i + 1)]).any():
                return f"the table of drive '{name}' goes no further, and its outside is \"error\""
        return ""


def with_pieces(lines: Iterable[Line]) -> Iterator[Line]:
    """Yield lines that read the constants of a step from `HELD`, and evaluate pieces of tables there.

    Parameters
    ----------
    lines : iterable of Line
        Whose tables are all of time.
    """
    for line in lines:
        match line:
            case Load() if line.location == REGIME:
                yield Load(line.target, Location(HELD, 0))
            case Compute(operation="piece_of"):
                continue
            case Compute(target, "value_at" | "slope_at" as operation, (time_operand, _, drive)):
                yield from _polynomial(target, time_operand, int(drive), sloped=operation == "slope_at")
            case _:
                yield line


def _polynomial(target: str, time_operand: Operand, drive: int, *, sloped: bool) -> Iterator[Line]:
    """Yield the value of a piece, or its slope, by Horner's rule."""
    row = [f"{target}.{name}" for name in ("origin", "cubic", "square", "slope", "value")]
    yield from (Load(name, Location(HELD, 1 + ROWS * drive + k)) for k, name in enumerate(row))
    since = f"{target}.since"
    yield Compute(since, "subtract", (time_operand, row[0]))
    factors, total = ((3.0, 2.0, 1.0) if sloped else (1.0, 1.0, 1.0, 1.0)), ""
    for k, factor in enumerate(factors):
        term: Operand = row[1 + k]
        last = k == len(factors) - 1
        if factor != 1.0:
            term = f"{target}.times{k}"
            yield Compute(term, "multiply", (factor, row[1 + k]))
        if total:
            yield Compute(f"{target}.way{k}", "multiply", (total, since))
            total = target if last else f"{target}.sum{k}"
            yield Compute(total, "add", (f"{target}.way{k}", term))
        else:
            total = str(term)


FAR = 0.25  # from orthogonal, where a frame is not taken
NEXT_TO_NOTHING = 1e-150  # entries of a frame that are taken for zero, so that none times a scale underflows
NEARLY_WITHIN = 1e-8  # a direction that is left of a column, as a part of it, below which it is none


def _sequential_dot(a: Floats, b: Floats) -> float:
    return float(np.add.accumulate(a * b)[-1])


def orthogonal(directions: Floats) -> Floats:
    """Return a frame whose first axes are along the first columns: Gram and Schmidt's, done twice.

    Parameters
    ----------
    directions : ndarray, shape (n, n)
        One a column, those that matter most first. Where one is in the span of those before, an axis is taken that is not.
    """
    n = len(directions)
    frame = np.zeros((n, n))
    spare = iter(range(n))
    for j in range(n):
        column = _unit_remainder(directions[:, j], frame[:, :j])
        while column is None:
            axis = np.zeros(n)
            axis[next(spare)] = 1.0
            column = _unit_remainder(axis, frame[:, :j])
        frame[:, j] = column
    frame[np.abs(frame) < NEXT_TO_NOTHING] = 0.0
    return frame


def _unit_remainder(direction: Floats, axes: Floats) -> Floats | None:
    """Return the unit vector of a direction's part orthogonal to some axes; None if that part is negligible."""
    size = float(np.abs(direction).max())
    if not 0.0 < size < np.inf:
        return None
    # scaled first, so that no square overflows or vanishes
    left = direction / size
    length = sqrt(_sequential_dot(left, left))
    left = left / length
    # the second pass removes what rounding left of the first; twice is enough (Kahan, in Parlett 1980, section 6.9)
    for _ in range(2):
        for axis in axes.T:
            left = left - _sequential_dot(left, axis) * axis
    remaining = sqrt(_sequential_dot(left, left))
    if remaining < NEARLY_WITHIN:
        return None
    return np.asarray(left / remaining)


def solve_in_frame(frame: Floats, off: float, right: Box) -> Box:
    """Enclose frame**-1 times some columns, of a frame that is orthogonal but for rounding.

    With E = I - Q^T Q, whose norm is s, Q**-1 = (I - E)**-1 Q^T, and (I - E)**-1 w differs from w by at most
    s/(1 - s) of the largest of w.

    Parameters
    ----------
    frame : ndarray, shape (n, n)
    off : float
        A bound of s, below a half.
    right : ndarray, shape (2, n, m)
    """
    near = matrix_product(point_box(frame.T), right)
    # s/(1 - s) is at most 2 s, as s is below a half; doubling is exact, so one product alone is rounded
    error_bound = np.nextafter(2.0 * off * magnitude(near).max(axis=0), np.inf)
    return round_outward(near + np.array([-error_bound, error_bound])[:, None])


def off_orthogonal(frame: Floats) -> float:
    """Return a bound of how far a frame is from orthogonal: of the norm of I - Q^T Q by sums of rows."""
    lacking = subtract(point_box(np.eye(len(frame))), matrix_product(point_box(frame.T), point_box(frame)))
    return float(sum_along(point_box(magnitude(lacking)))[1].max())


@dataclass(frozen=True)
class AffineImage:
    """All ``image + by @ parts``: the states of a set at a time, seen from those at another.

    Attributes
    ----------
    image : ndarray, shape (2, n)
    derivatives : ndarray, shape (2, n, 2*n)
        Derivatives by the start, then by the rest.
    parts : ndarray, shape (2, 2*n)
        Start and rest.
    """

    image: Box
    derivatives: Box
    parts: Box

    def box(self) -> Box:
        """Return a box that holds them."""
        return add(self.image, matrix_product(self.derivatives, self.parts))

    def mean_value_form(self, slopes: Box) -> Box:
        """Return the difference of functions from their midpoint values, by their derivatives, one row each."""
        off = subtract(self.image, point_box(midpoint(self.image)))
        return add(
            matrix_product(slopes, off),
            matrix_product(matrix_product(slopes, self.derivatives), self.parts),
        )


@dataclass(frozen=True)
class Doubleton:
    """All ``point + spread @ start + scales * (frame @ rest)``, start and rest being any of two boxes.

    The first part is the image of the set of starts, which keeps its shape however it turns and shears; the second, what
    rounding, remainders and the curvature of the flow add, turns with the flow in an orthogonal frame (Lohner 1987;
    Mrozek, Zgliczynski 2000, "doubleton").

    Attributes
    ----------
    point : ndarray, shape (n,)
    spread : ndarray, shape (n, n)
    start : ndarray, shape (2, n)
    scales : ndarray, shape (n,)
        Powers of two of the size of each number, so that a frame may join metres with radians.
    frame : ndarray, shape (n, n)
    remainder : ndarray, shape (2, n)
    """

    point: Floats
    spread: Floats
    start: Box
    scales: Floats
    frame: Floats
    remainder: Box

    @classmethod
    def of_box(cls, start: Box, scales: Floats) -> Doubleton:
        """Return the set of a box."""
        point, n = midpoint(start), start.shape[1]
        return cls(point, np.eye(n), subtract(start, point_box(point)), scales, np.eye(n), np.zeros((2, n)))

    @property
    def parts(self) -> Box:
        """Start and rest."""
        return np.concatenate([self.start, self.remainder], axis=1)

    @property
    def by_parts(self) -> Box:
        """The matrices that multiply start and rest."""
        return point_box(np.concatenate([self.spread, self.scales[:, None] * self.frame], axis=1))

    def box(self) -> Box:
        """Return a box that holds the set."""
        return add(point_box(self.point), matrix_product(self.by_parts, self.parts))

    def itself(self) -> AffineImage:
        """Return the set as it is."""
        return AffineImage(point_box(self.point), self.by_parts, self.parts)

    def image_under(self, image: Box, jacobian: Box) -> AffineImage:
        """Return the image of the set under a map, by its value at the point and its derivatives over the set."""
        return AffineImage(image, matrix_product(jacobian, self.by_parts), self.parts)


def doubleton_of(seen: AffineImage, scales: Floats) -> Doubleton:
    """Return the image of a set under a map, as it is seen, to be carried on.

    Parameters
    ----------
    seen : AffineImage
    scales : ndarray, shape (n,)
        Of the new set.
    """
    n = len(scales)
    (by_start, by_rest), (start, remainder) = np.split(seen.derivatives, [n], axis=2), np.split(seen.parts, [n], axis=1)
    point, spread = midpoint(seen.image), midpoint(by_start)
    lost = matrix_product(subtract(by_start, point_box(spread)), start)
    lost = add(lost, subtract(seen.image, point_box(point)))
    # by powers of two, which is exact, but for numbers below the least normal one
    basis, lost = round_outward(by_rest / scales[:, None]), round_outward(lost / scales)
    directions = midpoint(basis)
    lengths = magnitude(basis).max(axis=0) * width(remainder)  # an order of columns, which proves nothing
    frame = orthogonal(directions[:, np.argsort(-lengths, kind="stable")])
    # any frame is proven right by what follows; the unit matrix is orthogonal without a bound
    if (off := off_orthogonal(frame)) >= FAR:
        frame, off = np.eye(len(frame)), 0.0
    both = solve_in_frame(frame, off, np.concatenate([basis, lost[:, :, None]], axis=2))
    remainder = add(matrix_product(both[:, :, :-1], remainder), both[:, :, -1])
    return Doubleton(point, spread, start, scales, frame, remainder)


class Polynomials:
    """Some polynomials at once.

    Parameters
    ----------
    degree : int
        The highest that one has.
    count : int
        The most polynomials.
    """

    def __init__(self, degree: int, count: int) -> None:
        body: list[Line] = [Load(f"value{degree}", loop_element("w", degree * count))]
        for k in range(degree - 1, -1, -1):
            body += [
                Load(f"coefficient{k}", loop_element("w", k * count)),
                Compute(f"product{k}", "multiply", (f"value{k + 1}", "x")),
                Compute(f"value{k}", "add", (f"coefficient{k}", f"product{k}")),
            ]
        body.append(StoreTo(loop_element("z"), "value0"))
        lines = (Load("x", Location("p")), Loop("i", count, tuple(body)))
        program = Program("horner", f"Polynomials to degree {degree} at an interval.", lines)
        self._program = EnclosedProgram(program, {"p": 1, "w": (degree + 1) * count, "z": count})
        arrays = self._program.arrays
        self._x, self._values = arrays["p"][0], arrays["z"]
        self._coefficients = arrays["w"].reshape(degree + 1, count, len(PARTS))

    def values_at(self, x: Box, coefficients: Box) -> Box:
        """Return the values at an interval; infinite where none is known.

        Parameters
        ----------
        x : ndarray, shape (2,)
        coefficients : ndarray, shape (2, degree + 1 or fewer, count or fewer)
        """
        orders, count = coefficients.shape[1:]
        self._x[:2] = x
        self._coefficients[...] = 0.0
        self._coefficients[:orders, :count, :2] = coefficients.transpose(1, 2, 0)
        self._program.run()
        return stored_bounds(self._values[:count])

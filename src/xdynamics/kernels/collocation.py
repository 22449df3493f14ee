"""Steps of Radau IIA in every lane, solved as `march.implicit.radau` solves the equations of a single run.

Hairer, Wanner, Solving ODEs II, 2nd ed., section IV.8. Each line here performs the operations of one there, or in
`kernels.linear`, in order. A lane whose iteration has ended waits for the others; one whose iteration fails is left to
the single march. The simplified Newton iterations are lines of text, for one run and for runs in lanes:
`march.implicit.radau` uses them as functions of numbers, this module in all lanes at once.

`RadauMemory` is what a step leaves in a lane for the next step, with the lines that read and write it.

Small linear systems are written out, because pivots differ between lanes: the operations of `kernels.linear`, in their
order. Matrices are lists of columns; a number is its parts, one if it is real, two if it is complex. Where the single
march skips an operation because a number is zero, a lane keeps its old value: subtracting a zero can change the sign of
a zero.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Iterable, Mapping

from xdynamics.elementary.bounds import EPS
from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.formulas import Formulas
from xdynamics.kernels.layout import POLYNOMIAL, Layout, curve_size
from xdynamics.kernels.line_writing import polynomial_program
from xdynamics.kernels.program import (
    AT,
    REGIME,
    Compute,
    H,
    Instruction,
    Load,
    Location,
    Loop,
    Operand,
    Program,
    ProgramCall,
    StoreTo,
    T,
    loop_element,
)
from xdynamics.methods import implicit
from xdynamics.methods.implicit import ALPHA, BETA, ERROR, GAMMA, NODES, T_INVERSE
from xdynamics.methods.implicit import T as T_MATRIX

C1, C2, _ = implicit.NODES
CONSTANTS = {
    "few_turns": float(implicit.FEW_TURNS),
    "slow": implicit.SLOW,
    "least_norm": implicit.LEAST_NORM,
    "eps": EPS,
    "same_step": implicit.SAME_STEP,
    "diverging": implicit.DIVERGING,
    "stalled": implicit.STALLED,
    "most_turns": float(implicit.MOST_TURNS),
    "c12": C1 - C2,
    "c21": C2 - 1.0,
    "c11": C1 - 1.0,
    "c1": C1,
    "c2": C2,
}

# Differences of a component of the collocation polynomial, from the end of the step backwards; its continuation to the
# stage at c of the next step, `relative` times as long, or rest where that is 0
RADAU_POLYNOMIAL = """
middle = (z0 - z1)/c12
first = (z1 - z2)/c21
second = (middle - first)/c11
third = second - (middle - z0/c1)/c2
"""
GUESS = """
s = c*relative
guess = where(relative > 0, s*(first + (s - c21)*(second + (s - c11)*third)), 0)
"""
# The convergence of an iteration, by its last two corrections and the two before
CONVERGENCE = """
ratio_now = size/change
theta_now = where(turn_now < 2.5, ratio_now, sqrt(ratio_now*ratio))
eta_now = theta_now/(1 - theta_now)
"""


# Further numbers of a lane: those of `march.run.KEPT`; iterations of its last step, and counts since it was entered;
# of the current trial whether its iteration is open or failed, how many corrections it had, and whether its
# derivatives, its factors and its estimate have to be computed.
Lasting = namedtuple(
    "Lasting",
    "factored theta eta before norm_before linearised fresh since turns iterations evaluations jacobians factorisations",
)
LASTING, PLACES = Lasting._fields, Lasting(*range(len(Lasting._fields)))
KEPT = (*LASTING, "open", "vain", "turn", "eta_tried", "change", "ratio", "missing", "unfactored", "again")


class RadauMemory:
    """Where a lane keeps the numbers and vectors of its step.

    Parameters
    ----------
    layout : Layout
    places : mapping of str to Place
        Where a lane keeps its other numbers.
    first : int
        Where in `w` this memory begins.
    """

    def __init__(self, layout: Layout, places: dict[str, Location], first: int) -> None:
        self.layout = layout
        self.used, self.n = layout.used.size, layout.coordinates.size
        self.size = self.used - self.n
        self.places = places | {name: Location("w", first + i) for i, name in enumerate(KEPT)}
        self._first: dict[str, int] = {}
        first += len(KEPT)
        for name, length in lengths(layout).items():
            self._first[name] = first
            first += length

    def formulas(self, prefix: str, operands: Mapping[str, Operand] | None = None) -> Formulas:
        """Begin lines whose names are those of the lane, of constants, or known."""
        return Formulas(self.places, prefix, {**CONSTANTS, **(operands or {})})

    def vector_location(self, name: str, i: int) -> Location:
        """Return the location of an element of a vector."""
        return Location("w", self._first[name] + i)

    def load_vectors(self, f: Formulas, name: str) -> list[list[Operand]]:
        """Read three vectors, stored one after the other."""
        return [[f.load(self.vector_location(name, k * self.used + i)) for i in range(self.used)] for k in range(3)]

    def store_vectors(self, f: Formulas, name: str, vectors: list[list[Operand]]) -> None:
        """Write three vectors."""
        for k, vector in enumerate(vectors):
            for i, value in enumerate(vector):
                f.store(self.vector_location(name, k * self.used + i), value)

    def update_numbers(self, f: Formulas, updates: Mapping[str, str], **operands: Operand) -> None:
        """Write numbers of the lane, each from the lane's former numbers."""
        values = {name: f.formula(text, **operands) for name, text in updates.items()}
        for name, value in values.items():
            f.store(self.places[name], value)


def lengths(layout: Layout) -> dict[str, int]:
    """Return the length of each part of a lane's memory after `KEPT`; row exchanges follow the matrices."""
    used, size = layout.used.size, layout.used.size - layout.coordinates.size
    # the real matrix, both parts of the complex one, and the row exchanges of each
    matrix = 3 * size * size + 2 * size
    lasting = {
        "slopes": len(layout.couplings),
        "stages": 3 * used,
        "past": 3 * used,
        "matrix": matrix,
        "turned": 3 * used,
    }
    curve = curve_size(layout)
    return lasting | {"reached": 3 * used if curve else 0, "curve": curve}


def memory_width(layout: Layout) -> int:
    """Return the total length of a lane's memory."""
    return len(KEPT) + sum(lengths(layout).values())


Entry = tuple[Operand, ...]
Columns = list[list[Entry]]


def factorise_columns(lines: Assignments, m: Columns) -> tuple[list[Operand], Operand]:
    """Factorise a matrix as P L U in place; return the row exchanged with each, and whether the matrix is regular.

    The diagonal of a complex U is left inverted.
    """
    n, pivots = len(m), list[Operand]()
    sound: Operand = 1.0
    for k in range(n):
        pivot, size = _pivot_of_column(lines, m[k], k)
        # zeros from here to the end of the column: there `linear.factorise` stops, by its `last`
        filled = _nonzero_prefixes(lines, m[k][::-1])[::-1]
        sound = _is_regular(lines, sound, size)
        pivots.append(pivot)
        _exchange_rows(lines, m, k, pivot)
        m[k][k] = _pivoted(lines, m[k][k], size)
        for i in range(k + 1, n):
            m[k][i] = _select_entry(lines, [filled[i]], _divide_by_pivot(lines, m[k][i], m[k][k]), m[k][i])
        for j in range(k + 1, n):
            nonzero = _nonzero_prefixes(lines, [m[j][k]])
            for i in range(k + 1, n):
                reduced = _less_product(lines, m[j][i], m[j][k], m[k][i])
                m[j][i] = _select_entry(lines, [*nonzero, filled[i]], reduced, m[j][i])
    return pivots, sound


def substitute_columns(lines: Assignments, m: Columns, pivots: list[Operand], right: list[Entry]) -> None:
    """Solve with the factors of `factorise_columns`; the solution replaces the right-hand side."""
    n = len(m)
    for k in range(n):
        _exchange_rows(lines, [right], k, pivots[k])
    for k in range(n):
        filled = _nonzero_prefixes(lines, m[k][::-1])[::-1]
        for i in range(k + 1, n):
            right[i] = _select_entry(lines, [filled[i]], _less_product(lines, right[i], right[k], m[k][i]), right[i])
    for k in range(n - 1, -1, -1):
        right[k] = _divide_by_pivot(lines, right[k], m[k][k])
        filled = _nonzero_prefixes(lines, m[k])
        for i in range(k):
            right[i] = _select_entry(lines, [filled[i]], _less_product(lines, right[i], right[k], m[k][i]), right[i])


def _pivot_of_column(lines: Assignments, column: list[Entry], first: int) -> tuple[Operand, Operand]:
    """Return the row of the largest number of a column, and its size."""
    pivot: Operand = float(first)
    size: Operand = -1.0
    for i, entry in enumerate(column[first:], first):
        magnitude = lines.compute("abs", entry[0])
        for part in entry[1:]:
            magnitude = lines.compute("add", magnitude, lines.compute("abs", part))
        larger = lines.compute("more", magnitude, size)
        pivot = lines.compute("choose", larger, float(i), pivot)
        size = lines.compute("choose", larger, magnitude, size)
    return pivot, size


def _pivoted(lines: Assignments, pivot: Entry, size: Operand) -> Entry:
    """Return a pivot as it is stored: a complex one inverted, divided by its size first against over- and underflow."""
    if len(pivot) == 1:
        return pivot
    x, y = (lines.compute("divide", part, size) for part in pivot)
    squares = lines.compute("add", lines.compute("multiply", x, x), lines.compute("multiply", y, y))
    square = lines.compute("multiply", squares, size)
    return lines.compute("divide", x, square), lines.compute("divide", lines.compute("negative", y), square)


def _divide_by_pivot(lines: Assignments, number: Entry, pivot: Entry) -> Entry:
    """Return a number divided by a stored pivot."""
    return (lines.compute("divide", *number, *pivot),) if len(pivot) == 1 else _entry_product(lines, number, pivot)


def _entry_product(lines: Assignments, x: Entry, y: Entry) -> Entry:
    if len(x) == 1:
        return (lines.compute("multiply", *x, *y),)
    (u, v), (p, q) = x, y
    real = lines.compute("subtract", lines.compute("multiply", u, p), lines.compute("multiply", v, q))
    return real, lines.compute("add", lines.compute("multiply", u, q), lines.compute("multiply", v, p))


def _less_product(lines: Assignments, number: Entry, x: Entry, y: Entry) -> Entry:
    """Return a number less a product."""
    return tuple(
        lines.compute("subtract", part, product_part)
        for part, product_part in zip(number, _entry_product(lines, x, y), strict=True)
    )


def _is_regular(lines: Assignments, sound: Operand, size: Operand) -> Operand:
    """Return whether the matrix was regular so far, and the pivot is positive and finite."""
    # infinity less itself is nan, as nan less itself is, and nan equals nothing
    finite = lines.compute("equal", lines.compute("subtract", size, size), 0.0)
    regular = lines.compute("choose", lines.compute("more", size, 0.0), sound, 0.0)
    return lines.compute("choose", finite, regular, 0.0)


def _nonzero_prefixes(lines: Assignments, entries: Iterable[Entry]) -> list[Operand]:
    """Return for each number whether it or one before it is not zero."""
    filled: list[Operand] = []
    nonzero: Operand = 0.0
    for entry in entries:
        for part in entry:
            nonzero = lines.compute("choose", lines.compute("unequal", part, 0.0), 1.0, nonzero)
        filled.append(lines.compute("more", nonzero, 0.0))
    return filled


def _select_entry(lines: Assignments, conditions: list[Operand], new: Entry, old: Entry) -> Entry:
    """Return a new number where all conditions hold, else the old one."""
    for condition in conditions[::-1]:
        new = tuple(lines.compute("choose", condition, part, old_part) for part, old_part in zip(new, old, strict=True))
    return new


def _exchange_rows(lines: Assignments, columns: Columns, k: int, pivot: Operand) -> None:
    """Exchange the k-th row with the pivot row of each lane."""
    for i in range(k + 1, len(columns[0])):
        row_conditions = [lines.compute("equal", pivot, float(i))]
        for column in columns:
            upper, lower = column[k], column[i]
            column[k], column[i] = (
                _select_entry(lines, row_conditions, lower, upper),
                _select_entry(lines, row_conditions, upper, lower),
            )


FACTORISE = "factorise"
_OF_FACTORS = """
alpha_f = a/factored
beta_f = b/factored
square_f = alpha_f*alpha_f + beta_f*beta_f
"""
_FACTORISED = {
    "factored": "where(unfactored > 0, where(sound > 0, h, 0), factored)",
    "factorisations": "factorisations + unfactored*sound",
    "open": "where(unfactored > 0, open*sound, open)",
    "vain": "where(unfactored > 0, where(sound > 0, vain, 1), vain)",
}


def factorisation(memory: RadauMemory) -> Program:
    """Assemble both matrices and factorise them: `transformed.factorise_both`."""
    f, n = memory.formulas("_"), memory.n
    h = f.load(Location("at", H))
    f.write("gamma = g/h\nalpha = a/h\nbeta = b/h\nsquare = alpha*alpha + beta*beta", g=GAMMA, a=ALPHA, b=BETA, h=h)
    real, both = _diagonal(memory, f.known["gamma"]), _diagonal(memory, f.known["alpha"], f.known["beta"])
    for k, (row, column) in enumerate(memory.layout.couplings):
        slope, j = f.load(memory.vector_location("slopes", k)), column if column < n else column - n
        (m,), (re, im) = real[j][row], both[j][row]
        if column < n:
            # a coordinate is eliminated by its velocity: its derivative goes to that column, over gamma
            real[j][row] = (f.formula("m - slope/gamma", m=m, slope=slope),)
            re = f.formula("m - slope*(alpha/square)", m=re, slope=slope)
            both[j][row] = re, f.formula("m + slope*(beta/square)", m=im, slope=slope)
        else:
            real[j][row] = (f.formula("m - slope", m=m, slope=slope),)
            both[j][row] = f.formula("m - slope", m=re, slope=slope), im
    (pivots, real_sound), (complex_pivots, complex_sound) = (
        factorise_columns(f, real),
        factorise_columns(f, both),
    )
    f.write("sound = where(one > 0, other, 0)", one=real_sound, other=complex_sound)
    planes = [[entry[part] for column in m for entry in column] for m, part in ((real, 0), (both, 0), (both, 1))]
    for k, value in enumerate([*planes[0], *planes[1], *planes[2], *pivots, *complex_pivots]):
        location = memory.vector_location("matrix", k)
        f.store(location, f.formula("where(unfactored > 0, new, old)", new=value, old=f.load(location)))
    memory.update_numbers(f, _FACTORISED, h=h)
    return Program(FACTORISE, "The factors of both matrices for the step.", tuple(f.lines))


def _diagonal(memory: RadauMemory, *parts: Operand) -> Columns:
    """Return a matrix that has a number on its diagonal."""
    zero = (0.0,) * len(parts)
    return [[parts if i == j else zero for i in range(memory.size)] for j in range(memory.size)]


def solve_real_lanes(f: Formulas, memory: RadauMemory, vector: list[Operand]) -> list[Operand]:
    """Solve (gamma/h - J) d = r: `transformed.solve_real_system`."""
    # by the step that the factors were made for, which this one may differ from by `SAME_STEP`
    n, gamma, (matrix, pivots) = memory.n, f.formula("g/factored", g=GAMMA), _load_factors(f, memory, 0)
    right = vector[n:]
    for k, (row, column) in enumerate(memory.layout.couplings):
        if column < n:
            slope = f.load(memory.vector_location("slopes", k))
            right[row] = f.formula("r + slope*(v/gamma)", r=right[row], slope=slope, v=vector[column], gamma=gamma)
    entries: list[Entry] = [(number,) for number in right]
    substitute_columns(f, matrix, pivots, entries)
    right = [number for number, *_ in entries]
    return [f.formula("(v + w)/gamma", v=vector[i], w=right[i], gamma=gamma) for i in range(n)] + right


def solve_complex_lanes(
    f: Formulas, memory: RadauMemory, first: list[Operand], second: list[Operand]
) -> tuple[list[Operand], list[Operand]]:
    """Solve ((alpha + i beta)/h - J) d = r: `transformed.solve_complex_system`."""
    n, (matrix, pivots) = memory.n, _load_factors(f, memory, 1, 2)
    f.write(_OF_FACTORS, a=ALPHA, b=BETA)
    x, y = f.formula("alpha_f/square_f"), f.formula("-beta_f/square_f")
    u = [f.formula("u*x - v*y", u=first[i], v=second[i], x=x, y=y) for i in range(n)]
    v = [f.formula("u*y + v*x", u=first[i], v=second[i], x=x, y=y) for i in range(n)]
    right: list[Entry] = list(zip(first[n:], second[n:], strict=True))
    for k, (row, column) in enumerate(memory.layout.couplings):
        if column < n:
            slope, (re, im) = f.load(memory.vector_location("slopes", k)), right[row]
            added = (f.formula("r + slope*d", r=r, slope=slope, d=d) for r, d in ((re, u[column]), (im, v[column])))
            right[row] = next(added), next(added)
    substitute_columns(f, matrix, pivots, right)
    for i in range(n):
        re, im = right[i]
        operands = {"u": re, "v": im, "x": x, "y": y}
        u[i], v[i] = f.formula("d + (u*x - v*y)", d=u[i], **operands), f.formula("d + (u*y + v*x)", d=v[i], **operands)
    return u + [re for re, _ in right], v + [im for _, im in right]


def _load_factors(f: Formulas, memory: RadauMemory, *planes: int) -> tuple[Columns, list[Operand]]:
    """Read the factors of a matrix, whose parts are in given planes, and its row exchanges."""
    size, square = memory.size, memory.size * memory.size
    parts = [[f.load(memory.vector_location("matrix", p * square + k)) for k in range(square)] for p in planes]
    entries = list(zip(*parts, strict=True))
    first = 3 * square + size * (len(planes) - 1)
    pivots = [f.load(memory.vector_location("matrix", first + k)) for k in range(size)]
    return [entries[j * size : (j + 1) * size] for j in range(size)], pivots


LINEARISE, CORRECT, ESTIMATE = "linearise", "correct", "estimate"

# damped_eta is eta to the power 3/4 by square roots, which have the same bits everywhere; Hairer and Wanner, IV.8, take
# the power 0.8
_RECALL = """
moved = where(since == 2, 1, 0)
starts = where(since == 0, 1, 0)
used_up = moved*where(turns > few_turns, where(theta > slow, 1, 0), 0)
known = where(starts > 0, 0, where(used_up > 0, 0, linearised))
newest = where(since == 1, fresh, 0)
of_step = where(starts > 0, 0, factored)
last_step = where(starts > 0, 0, where(moved > 0, h, before))
last_norm = where(starts > 0, 0, where(moved > 0, max(least_norm, norm), norm_before))
last_eta = where(starts > 0, 1, eta)
least_eta = max(last_eta, eps)
damped_eta = sqrt(least_eta)*sqrt(sqrt(least_eta))
lacks = ready*where(known > 0, 0, 1)
refactors = ready*where(lacks > 0, 1, where(abs(width - of_step) <= same_step*width, 0, 1))
"""
_RECALLED = {
    "linearised": "where(lacks > 0, 1, known)",
    "fresh": "where(lacks > 0, 1, newest)",
    "factored": "of_step",
    "before": "last_step",
    "norm_before": "last_norm",
    "eta": "last_eta",
    "eta_tried": "damped_eta",
    "theta": "0",
    "since": "1",
    "missing": "lacks",
    "unfactored": "refactors",
    "jacobians": "jacobians + lacks",
    "open": "ready",
    "vain": "0",
    "turn": "0",
}
_VERDICT = """
stalls = where(size <= rounding, where(ratio_now >= stalled, 1, 0), 0)
converges = where(theta_now < diverging, where(lacking > max(tolerance, rounding), 2, 0), 2)
later = where(stalls > 0, 1, converges)
so_far = where(turn_now > 1.5, later, 0)
passes = where(size - size == 0, where(so_far == 0, 1, 0), 0)
eta_then = where(turn_now > 1.5, eta_now, eta_tried)
close = where(eta_then*size <= tolerance, 1, where(turn_now == most_turns, where(size <= rounding, 1, 2), 0))
verdict = where(size - size == 0, where(so_far == 0, close, so_far), 2)
"""


class CollocationStep:
    """The parts of a Radau IIA step in lanes.

    Parameters
    ----------
    memory : RadauMemory
    atol : int
        Where in `w` a lane's absolute tolerances begin.
    follows : bool
        Whether some tolerances follow their variables.
    """

    def __init__(self, memory: RadauMemory, atol: int, *, follows: bool) -> None:
        self._memory, self._atol, self._follows = memory, atol, follows
        self._layout, self._used, self._n = memory.layout, memory.used, memory.n
        self._body: list[Instruction] = []

    @property
    def programs(self) -> tuple[Program, ...]:
        """The programs that the step calls, each after those that it calls itself."""
        polynomials: tuple[Program, ...] = ()
        if curve_size(self._layout):
            places = (self._memory.vector_location(name, 0).offset for name in ("curve", "reached"))
            polynomials = (polynomial_program(self._layout, *places),)
        return (self._linearise(), factorisation(self._memory), self._correct(), self._estimate_again(), *polynomials)

    def begin(self, operands: dict[str, Operand]) -> tuple[Instruction, ...]:
        """Write the lines before the iteration: the memory of the previous step, and the starting values."""
        f, u = self._memory.formulas("_begin_", operands), self._used
        f.write(_RECALL)
        f.write("relative = where(last_step > 0, width/last_step, 0)")
        stages, past = self._memory.load_vectors(f, "stages"), self._memory.load_vectors(f, "past")
        guessed: list[list[Operand]] = [[], [], []]
        for i in range(u):
            f.write(RADAU_POLYNOMIAL, **{f"z{k}": stages[k][i] for k in range(3)})
            for k, name in enumerate(("first", "second", "third")):
                f.write(f"{name} = where(moved > 0, {name}, before)", before=past[k][i])
                f.store(self._memory.vector_location("past", k * u + i), f.known[name])
            for k, c in enumerate(NODES):
                f.write(GUESS, c=c)
                guessed[k].append(f.known["guess"])
        self._memory.store_vectors(f, "stages", guessed)
        self._memory.store_vectors(f, "turned", _transformed(f, guessed))
        self._memory.update_numbers(f, _RECALLED)
        return tuple(f.lines)

    def end_state_lines(self) -> tuple[Instruction, ...]:
        """Write the state at the end of the step, which is its third stage."""
        return (self._write_stage_state(2, loop_element("z")),)

    def curve(self) -> tuple[Instruction, ...]:
        """Write the states at the stages, and call for the polynomial through them, where the search for events needs it."""
        if not curve_size(self._layout):
            return ()
        places = [self._memory.vector_location("reached", k * self._used).offset for k in range(3)]
        loops = [self._write_stage_state(k, loop_element("w", offset)) for k, offset in enumerate(places)]
        return (*loops, ProgramCall(POLYNOMIAL, "at", "y", "z"))

    def _write_stage_state(self, stage: int, target: Location) -> Loop:
        """Write the state at a stage."""
        body = (
            Load("_y", loop_element("y")),
            Load("_stage", loop_element("w", self._memory.vector_location("stages", stage * self._used).offset)),
            Compute("_sum", "add", ("_y", "_stage")),
            StoreTo(target, "_sum"),
        )
        return Loop("i", self._used, body)

    def error_lines(self) -> tuple[Instruction, ...]:
        """Write the estimate of the error, to `e`."""
        f = self._memory.formulas("_estimated_")
        slopes = [f.load(Location("y", self._slope_index(i))) for i in range(self._used)]
        self._write_error_estimate(f, slopes)
        return tuple(f.lines)

    def _slope_index(self, i: int) -> int:
        """Return where in a state the time derivative of its i-th number is: `march.force_evaluation.state_slope`."""
        return self._n + i if i < self._n else self._used + i - self._n

    def _flushed(self, f: Formulas) -> None:
        self._body += f.lines
        f.lines.clear()

    def _evaluate_forces(self, f: Formulas, name: str, time: Operand, values: list[Operand]) -> list[Operand]:
        """Evaluate the forces at a state; return its slopes."""
        for i, value in enumerate(values):
            f.store(Location(name, i), value)
        f.store(Location(f"at_{name}", T), time)
        f.store(Location(f"at_{name}", REGIME), f.load(Location("at", REGIME)))
        self._flushed(f)
        self._body.append(ProgramCall("forces", f"at_{name}", name, name))
        return [
            values[self._n + i] if i < self._n else f.load(Location(name, self._slope_index(i)))
            for i in range(self._used)
        ]

    def _finish_program(self, name: str, about: str, f: Formulas, **local: int) -> Program:
        self._flushed(f)
        body, self._body = tuple(self._body), []
        return Program(name, about, body, {}, local)

    def _linearise(self) -> Program:
        """Evaluate the derivatives at the state in lanes that lack them: `radau.refresh_derivatives`."""
        f, record, entries = self._memory.formulas("_"), self._layout.record.size, len(self._layout.couplings)
        self._body = [
            Loop("i", record, (Load("_state", loop_element("y")), StoreTo(loop_element("state"), "_state"))),
            ProgramCall("linearised", "at", "state", "state", "found"),
        ]
        for k in range(entries):
            location = self._memory.vector_location("slopes", k)
            derivative = f.formula(
                "where(new - new == 0, new, 0)", new=f.load(Location("found", k))
            )  # derivatives.or_none
            new = f.formula("where(missing > 0, new, old)", new=derivative, old=f.load(location))
            f.store(location, new)
        return self._finish_program(LINEARISE, "Derivatives at the state.", f, state=record, found=max(1, entries))

    def _correct(self) -> Program:
        """Correct the stages of every open lane once, and judge: `radau.correct_stages`, `radau.judge_iteration`."""
        f, u = self._memory.formulas("_"), self._used
        t, h = f.load(Location("at", T)), f.load(Location("at", H))
        y = [f.load(Location("y", i)) for i in range(u)]
        stages, transformed = self._memory.load_vectors(f, "stages"), self._memory.load_vectors(f, "turned")
        slopes = []
        for k, c in enumerate(NODES):
            time = f.formula("t + c*h" if k < 2 else "t + h", t=t, c=c, h=h)
            values = [f.formula("y + z", y=y[i], z=stages[k][i]) for i in range(u)]
            slopes.append(self._evaluate_forces(f, f"stage{k}", time, values))
        f.write("gamma = g/h\nalpha = a/h\nbeta = b/h", g=GAMMA, a=ALPHA, b=BETA, h=h)
        defects = _transformed(f, slopes)
        for i in range(u):
            w0, w1, w2 = (transformed[k][i] for k in range(3))
            defects[0][i] = f.formula("d - gamma*w", d=defects[0][i], w=w0)
            defects[1][i] = f.formula("d - (alpha*w1 - beta*w2)", d=defects[1][i], w1=w1, w2=w2)
            defects[2][i] = f.formula("d - (beta*w1 + alpha*w2)", d=defects[2][i], w1=w1, w2=w2)
        changes = [
            solve_real_lanes(f, self._memory, defects[0]),
            *solve_complex_lanes(f, self._memory, defects[1], defects[2]),
        ]
        new = [[f.formula("w + d", w=transformed[k][i], d=changes[k][i]) for i in range(u)] for k in range(3)]
        new_stages = _back_transformed(f, new)
        f.write("size = one", one=self._correction(f, y, new_stages, changes))
        for name, vectors, old in (("turned", new, transformed), ("stages", new_stages, stages)):
            open_values = [
                [f.formula("where(open > 0, a, b)", a=vectors[k][i], b=old[k][i]) for i in range(u)] for k in range(3)
            ]
            self._memory.store_vectors(f, name, open_values)
        self._judge_iteration(f)
        local = {f"stage{k}": self._layout.record.size for k in range(3)} | {f"at_stage{k}": len(AT) for k in range(3)}
        return self._finish_program(CORRECT, "One simplified Newton iteration.", f, **local)

    def _correction(
        self, f: Formulas, y: list[Operand], stages: list[list[Operand]], changes: list[list[Operand]]
    ) -> Operand:
        """Return the largest ratio of a last correction to its tolerance: `corrections.largest_correction`."""
        largest: Operand = 0.0
        for i in range(self._used):
            scale = f.formula("atol + rtol*abs(y)", atol=f.load(Location("w", self._atol + i)), y=y[i])
            if self._follows:
                size = f.formula("max(abs(a), abs(b), abs(c))", a=stages[0][i], b=stages[1][i], c=stages[2][i])
                scale = f.formula("where(scale == 0, rtol*size, scale)", scale=scale, size=size)
            for k in range(3):
                change = f.formula("abs(d)", d=changes[k][i])
                operands = {"change": change, "scale": scale, "largest": largest}
                # a component that stays zero may have a scale of zero, and 0/0 would be nan
                largest = f.formula("where(change != 0, max(largest, change/scale), largest)", **operands)
        return largest

    def _judge_iteration(self, f: Formulas) -> None:
        """Judge the iterations by their corrections: `radau.judge_iteration`."""
        f.write("turn_now = turn + 1")
        f.write(f"{CONVERGENCE}lacking = eta_now*size")
        # lacking is what would be missing after the last turn allowed, if corrections go on to shrink by theta (Hairer
        # and Wanner, IV.8)
        for remaining in range(1, int(implicit.MOST_TURNS) - 1):  # one for each remaining iteration
            f.write(f"lacking = where(turn_now <= {int(implicit.MOST_TURNS) - remaining}, lacking*theta_now, lacking)")
        f.write(
            "rounding = ten*eps/rtol\ntolerance = max(share*rounding, min(most_share, sqrt(rtol)))",
            ten=10.0,
            share=0.05,
            most_share=implicit.SHARE,
        )
        f.write(_VERDICT)
        updates = {
            "turn": "turn_now",
            "theta": "where(turn_now > 1.5, theta_now, theta)",
            "ratio": "where(turn_now > 1.5, ratio_now, ratio)",
            "eta_tried": "where(passes > 0, eta_then, eta_tried)",
            "change": "where(passes > 0, max(size, eps), change)",
            "turns": "where(passes > 0, turn_now, turns)",
            "vain": "where(verdict == 2, 1, vain)",
            "open": "where(verdict == 0, open, 0)",
        }
        self._memory.update_numbers(f, {name: f"where(open > 0, {text}, {name})" for name, text in updates.items()})

    def _write_error_estimate(self, f: Formulas, slopes: list[Operand], only: str = "") -> None:
        """Write the error by the embedded formula, with the given slopes, to `e`: `radau.estimate_error`."""
        stages, h = self._memory.load_vectors(f, "stages"), f.load(Location("at", H))
        e1, e2, e3 = ERROR
        components = [
            dict(zip(("a", "b", "c"), (stages[k][i] for k in range(3)), strict=True)) for i in range(self._used)
        ]
        defects = [
            f.formula("(e1*a + e2*b + e3*c)/h", h=h, e1=e1, e2=e2, e3=e3, **component) for component in components
        ]
        errors = solve_real_lanes(
            f, self._memory, [f.formula("d + s", d=d, s=s) for d, s in zip(defects, slopes, strict=True)]
        )
        for i, error in enumerate(errors):
            stored_error = (
                f.formula(f"where({only} > 0, new, old)", new=error, old=f.load(Location("e", i))) if only else error
            )
            f.store(Location("e", i), stored_error)

    def _estimate_again(self) -> Program:
        """Estimate again, with the slopes that the first estimate leads to."""
        f, u = self._memory.formulas("_"), self._used
        values = [f.formula("y + e", y=f.load(Location("y", i)), e=f.load(Location("e", i))) for i in range(u)]
        self._write_error_estimate(f, self._evaluate_forces(f, "beside", f.formula("t"), values), "again")
        about, record = "The error by the slopes that the first estimate leads to.", self._layout.record.size
        return self._finish_program(ESTIMATE, about, f, beside=record, at_beside=len(AT))


def _transformed(f: Formulas, vectors: list[list[Operand]]) -> list[list[Operand]]:
    """Multiply by T**-1."""
    rows = [dict(zip("abc", row, strict=True)) for row in T_INVERSE]
    return [
        [f.formula("a*x + b*y + c*z", x=x, y=y, z=z, **row) for x, y, z in zip(*vectors, strict=True)] for row in rows
    ]


def _back_transformed(f: Formulas, vectors: list[list[Operand]]) -> list[list[Operand]]:
    """Multiply by T."""
    rows = [dict(zip("abc", row, strict=True)) for row in T_MATRIX[:2]]
    products = [
        [f.formula("a*x + b*y + c*z", x=x, y=y, z=z, **row) for x, y, z in zip(*vectors, strict=True)] for row in rows
    ]
    last = T_MATRIX[2][0]
    return [*products, [f.formula("a*x + y", a=last, x=x, y=y) for x, y, _ in zip(*vectors, strict=True)]]

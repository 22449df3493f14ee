"""The language of methods: lines of vectors, as books print a step, which are read, printed, and run.

The first letter of a name tells the kind of vector: q, v, a of the motion, x, r of the first-order states.

`Walker` goes through a method's lines; subclasses that run, print or analyse them define what each kind of line does.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from itertools import takewhile
from textwrap import dedent

from xdynamics.expressions import Binary, Name, Node, Number, free_names, parse, text_of
from xdynamics.expressions.calculus import polynomial_coefficients
from xdynamics.model import Model

SCALARS = ("t", "t1", "h", "s")
_ENDS = ("qs", "vs", "xs")  # the state inside a step
_TOTAL = "_total"  # stands for a sum while its line is parsed

_HERMITE = """
    qi = q1 - q - h*v - h**2/2*a
    qj = h*(v1 - v) - h**2*a
    qk = h**2*(a1 - a)
    qs = q + s*(h*v + s*(h**2/2*a + s*(10*qi - 4*qj + qk/2 + s*(7*qj - 15*qi - qk + s*(6*qi - 3*qj + qk/2)))))
    vs = v + s*(h*a + s*(3*(v1 - v) - h*(2*a + a1) + s*(h*(a + a1) - 2*(v1 - v))))
    xs = x + s*(h*r + s*(3*(x1 - x) - h*(2*r + r1) + s*(h*(r + r1) - 2*(x1 - x))))
"""

_EVALUATION = re.compile(r"(a\w*), (r\w*) = f\((.+), (q\w*), (v\w*), (x\w*)\)")
_SOLVE = re.compile(r"solve (.+):")
_KEEP = re.compile(r"keep (q\w*), (v\w*) at (.+) over (.+)")
_SERIES = re.compile(r"expand .+, i = 1 \.\.\. (\d+)")
_SUM = re.compile(r"sum\((i\*)?(h|\(s\*h\))\*\*(i|\(i - 1\))\*(\w)_i, i = 1 \.\.\. (\d+)\)")
_SPREAD = (("q", "v"), ("v", "a"), ("x", "r"))


@dataclass(frozen=True)
class Evaluation:
    """``a1, r1 = f(t1, q1, v1, x1)``: accelerations and rates at one time and one state."""

    acceleration: str
    rate: str
    time: str
    position: str
    velocity: str
    state: str

    def text(self, *, motion: bool, states: bool) -> str:
        """Print it with the vectors that a model has."""
        results = [name for name, is_present in ((self.acceleration, motion), (self.rate, states)) if is_present]
        arguments = [self.time, *([self.position, self.velocity] if motion else []), *([self.state] if states else [])]
        return f"{', '.join(results)} = f({', '.join(arguments)})"


@dataclass(frozen=True)
class VectorStatement:
    """``v1 = v + h*a``: one vector from vectors of equal length."""

    target: str
    expression: Node
    source: str

    @property
    def of_states(self) -> bool:
        """Whether it advances the first-order states (x, r) and not the motion (q, v, a)."""
        return self.target[0] in "xr"

    @property
    def vectors(self) -> set[str]:
        """The vectors that it reads; other names are scalars."""
        return free_names(self.expression) - set(SCALARS)

    def text(self, *, motion: bool, states: bool) -> str:
        """Print it, or nothing if the model has no such vectors."""
        return self.source if (states if self.of_states else motion) else ""


@dataclass(frozen=True)
class TaylorSeries:
    """``expand f at t, …, i = 1 ... 8``: the coefficients q_i, v_i, x_i of the motion from the start of the step on."""

    degree: int

    def text(self, *, motion: bool, states: bool) -> str:
        """Print it with the vectors that a model has."""
        start = ["t", *(["q, v"] if motion else []), *(["x"] if states else [])]
        rules = ["i*q_i = v_(i - 1)", "i*v_i = a_(i - 1)"] if motion else []
        rules += ["i*x_i = r_(i - 1)"] if states else []
        return f"expand f at {', '.join(start)}: {', '.join(rules)}, i = 1 ... {self.degree}"


@dataclass(frozen=True)
class ConstraintImpulse:
    """``keep q1, v2 at t1 over h``: q1 += h*u and v2 += u by impulses of constraints, which hold at q1 and t1 then.

    The impulses act along the gradients at the last force evaluation (Andersen 1983, J. Comput. Phys. 52, 24,
    doi:10.1016/0021-9991(83)90014-1; Hairer, Lubich, Wanner, section VII.1.4: RATTLE).
    """

    position: str
    velocity: str
    time: str
    distance: str

    def text(self, *, motion: bool, states: bool) -> str:  # noqa: ARG002
        """Print it, or nothing if the model has no such vectors."""
        return f"keep {self.position}, {self.velocity} at {self.time} over {self.distance}" if motion else ""


@dataclass(frozen=True)
class Solve:
    """``solve v2, x2:`` and the indented equations for these unknowns, solved simultaneously by Newton's method.

    A line with an unknown on its left is an equation; the others define what the equations use. The iteration starts
    from the previous values of the unknowns.
    """

    unknowns: tuple[str, ...]
    body: tuple[VectorStatement | Evaluation, ...]

    @property
    def definitions(self) -> tuple[VectorStatement, ...]:
        """Vectors that follow from the unknowns, each after those that it reads."""
        waiting = [line for line in self.body if isinstance(line, VectorStatement) and line.target not in self.unknowns]
        ordered: list[VectorStatement] = []
        while waiting:
            missing = {line.target for line in waiting}
            ready = [line for line in waiting if not line.vectors & missing]
            ordered += ready
            waiting = [line for line in waiting if line not in ready]
        return tuple(ordered)

    @property
    def evaluations(self) -> tuple[Evaluation, ...]:
        """Force evaluations at the unknown states."""
        return tuple(line for line in self.body if isinstance(line, Evaluation))

    @property
    def equations(self) -> tuple[VectorStatement, ...]:
        """One equation for each unknown, in their order."""
        by_target = {line.target: line for line in self.body if isinstance(line, VectorStatement)}
        return tuple(by_target[name] for name in self.unknowns)

    def text(self, *, motion: bool, states: bool) -> str:
        """Print it with the vectors that a model has."""
        unknowns = [item for item in self.unknowns if (states if item[0] == "x" else motion)]
        lines = [item.text(motion=motion, states=states) for item in self.body]
        return f"solve {', '.join(unknowns)}: {{{'; '.join(line for line in lines if line)}}}"


Line = VectorStatement | Evaluation | TaylorSeries | Solve | ConstraintImpulse


@dataclass(frozen=True)
class Interpolant:
    """The state inside a step, at t + s*h: a polynomial in s.

    Attributes
    ----------
    text : str
        Lines that give ``qs, vs, xs``.
    words : str
        The same in words.
    order : int
        Order of its local error, minus one.
    of_coordinates : int, optional
        That of coordinates, where it is another.
    needs_no_stages : bool
        Whether it needs only what a step has left: the states at its ends, or the stages that it solved for. Otherwise the
        stages of the step are made again.
    """

    text: str
    words: str
    order: int
    of_coordinates: int | None = None
    needs_no_stages: bool = False

    @property
    def lines(self) -> tuple[Line, ...]:
        """The lines of the interpolant."""
        return read_lines(self.text)

    @property
    def polynomials(self) -> tuple[Line, ...]:
        """The lines, with one for each coefficient in s: ``qs0, qs1, …``, ``vs0, …`` and ``xs0, …``, of one degree.

        It is evaluated by `lines`, whose nested form keeps its digits; by these coefficients it is bounded.
        """
        return _polynomials(self.text)

    @property
    def degree(self) -> int:
        """The degree of the polynomials in s, the highest of all vectors."""
        last = self.polynomials[-1]
        assert isinstance(last, VectorStatement)  # noqa: S101 - that of the highest power of the states
        return int(last.target[2:])


@lru_cache(maxsize=256)
def read_lines(text: str) -> tuple[Line, ...]:
    """Parse lines of vector statements; indented ones belong to the `solve` above them.

    Raises
    ------
    InputError
        If an expression cannot be parsed.
    """
    lines = dedent(text).strip("\n").splitlines()
    statements: list[Line] = []
    while lines:
        line = lines.pop(0)
        if match := _SERIES.fullmatch(line):
            statements.append(TaylorSeries(int(match.group(1))))
            continue
        if match := _KEEP.fullmatch(line):
            statements.append(ConstraintImpulse(*match.groups()))
            continue
        if not (match := _SOLVE.fullmatch(line)):
            statements.append(_parse_statement(line))
            continue
        body = list(takewhile(lambda part: part.startswith(" "), lines))
        del lines[: len(body)]
        unknowns = tuple(part.strip() for part in match.group(1).split(","))
        statements.append(Solve(unknowns, tuple(_parse_statement(part.strip()) for part in body)))
    return tuple(statements)


@lru_cache(maxsize=256)
def _polynomials(text: str) -> tuple[Line, ...]:
    lines: list[Line] = []
    states: dict[str, tuple[Node, ...]] = {}
    for line in read_lines(text):
        if isinstance(line, VectorStatement) and line.target in _ENDS:
            states[line.target] = polynomial_coefficients(line.expression, "s")
        else:
            lines.append(line)
    length = max(map(len, states.values()))
    for target, terms in states.items():
        for k, term in enumerate((*terms, *[Number(0.0)] * (length - len(terms)))):
            lines.append(VectorStatement(f"{target}{k}", term, f"{target}{k} = {text_of(term)}"))
    return tuple(lines)


def printed_lines(text: str, model: Model | None = None) -> str:
    """Return the lines of a text as one line, with the vectors that a model has; with all if no model is passed."""
    motion = model is None or bool(model.elements.statement.coordinates)
    states = model is None or bool(model.elements.statement.states)
    return _printed_vectors(text, motion=motion, states=states)


@lru_cache(maxsize=256)
def _printed_vectors(text: str, *, motion: bool, states: bool) -> str:
    texts = [line.text(motion=motion, states=states) for line in read_lines(text)]
    return "; ".join(text for text in texts if text)


def spread_over_vectors(text: str) -> str:
    r"""Write out lines for y' = k, as in textbooks, for the vectors of a mechanical system.

    ``y2 = y + h/2*k`` becomes a line each for q (with q' = v), v (with v' = a) and x (with x' = r).

    Examples
    --------
    >>> print(spread_over_vectors("y1 = y + h*k\nk1 = f(t1, y1)"))
    q1 = q + h*v
    v1 = v + h*a
    x1 = x + h*r
    a1, r1 = f(t1, q1, v1, x1)
    """
    vector_lines = []
    for line in dedent(text).strip("\n").splitlines():
        if match := _SOLVE.fullmatch(line):
            unknowns = [unknown.strip() for unknown in match.group(1).split(",")]
            vector_lines.append(
                "solve"
                f" {', '.join([_substitute_vectors(unknown, 'v', 'a') for unknown in unknowns] + [_substitute_vectors(unknown, 'x', 'r') for unknown in unknowns])}:"
            )
        elif match := re.fullmatch(r"( *)k(\w*) = f\((.+), y(\w*)\)", line):
            indent, stage, time, point = match.groups()
            vector_lines.append(f"{indent}a{stage}, r{stage} = f({time}, q{point}, v{point}, x{point})")
        else:
            vector_lines += [_substitute_vectors(line, *pair) for pair in _SPREAD]
    return "\n".join(vector_lines)


def _substitute_vectors(line: str, value: str, slope: str) -> str:
    """Substitute a pair of vectors for y and k."""
    return re.sub(r"\bk(\w*)", rf"{slope}\1", re.sub(r"\by(\w*)", rf"{value}\1", line))


def _parse_statement(line: str) -> VectorStatement | Evaluation:
    if match := _EVALUATION.fullmatch(line):
        return Evaluation(*match.groups())
    target, expression = line.split(" = ", 1)
    if match := _SUM.search(expression):
        plain = parse(expression.replace(match.group(), _TOTAL))
        return VectorStatement(target, _with_total(plain, _nested_power_sum(*match.groups())), line)
    return VectorStatement(target, parse(expression), line)


def _with_total(node: Node, total: Node) -> Node:
    """Substitute a sum for its placeholder."""
    if isinstance(node, Binary):
        return Binary(node.operator, _with_total(node.left, total), _with_total(node.right, total))
    return total if node == Name(_TOTAL) else node


def _nested_power_sum(index_factor: str | None, distance_text: str, power: str, letter: str, last: str) -> Node:
    """Return a sum of powers as ``h*(q_1 + h*(q_2 + …))``, each coefficient times its number where it is counted."""
    distance = parse(distance_text)

    def coefficient_term(i: int) -> Node:
        name = Name(f"{letter}_{i}")
        return Binary("*", Number(float(i)), name) if index_factor and i > 1 else name

    total = coefficient_term(int(last))
    for i in reversed(range(1, int(last))):
        total = Binary("+", coefficient_term(i), Binary("*", distance, total))
    return Binary("*", distance, total) if power == "i" else total


HERMITE = Interpolant(
    _HERMITE,
    "Hermite: quintic in the coordinates from q, v, a, cubic in velocities and states, at both ends of the step",
    order=3,
    of_coordinates=5,
    needs_no_stages=True,
)


class Walker(ABC):
    """Handles each kind of line of a method."""

    def walk(self, lines: Iterable[Line]) -> None:
        """Go through lines in order."""
        for line in lines:
            if isinstance(line, Evaluation):
                self.evaluate(line)
            elif isinstance(line, Solve):
                self.solve(line)
            elif isinstance(line, TaylorSeries):
                self.expand(line)
            elif isinstance(line, ConstraintImpulse):
                self.keep(line)
            else:
                self.assign(line)

    @abstractmethod
    def assign(self, line: VectorStatement) -> None:
        """Handle one vector from vectors of equal length."""

    @abstractmethod
    def evaluate(self, line: Evaluation) -> None:
        """Handle accelerations and rates at one time and state."""

    @abstractmethod
    def expand(self, line: TaylorSeries) -> None:
        """Handle the coefficients of the motion from the start of the step on."""

    @abstractmethod
    def keep(self, line: ConstraintImpulse) -> None:
        """Handle impulses of constraints."""

    @abstractmethod
    def solve(self, line: Solve) -> None:
        """Handle simultaneous equations."""

"""A method's vector lines, written out by component: the part of a compiled march that makes one step."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from functools import lru_cache
from itertools import chain

from xdynamics.expressions import Name, Node, Number, derivative, expand
from xdynamics.kernels.arithmetic import Arithmetic
from xdynamics.kernels.layout import Layout
from xdynamics.kernels.text import CONTEXT, tuple_of
from xdynamics.methods import Evaluation, Solve, Statement
from xdynamics.methods.method import Line
from xdynamics.schema import rate

MOST_ITERATIONS = 25
NEWTON_TOLERANCE = 1e-10  # of a correction against the size of its unknown; what is left is of the order of its square


class Stepping:
    """Writes lines of a method, with the stages counted as they come.

    Parameters
    ----------
    layout : Layout
    """

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self.stage = 0

    def written(self, lines: Iterable[Line]) -> list[str]:
        """Write lines out, one assignment for each component."""
        return list(chain.from_iterable(self._line(one) for one in lines))

    def vector(self, name: str) -> list[str]:
        """Name the components of a vector: ``q1`` of y is ``q1_y``."""
        return [f"{name}_{one}" for one in self._owners(name)]

    def state(self, suffix: str) -> list[str]:
        """Name what a force evaluation uses: coordinates, velocities, states."""
        return [one for letter in "qvx" for one in self.vector(letter + suffix)]

    def rates(self, suffix: str) -> list[str]:
        """Name what a force evaluation gives: accelerations, rates."""
        return [*self.vector("a" + suffix), *self.vector("r" + suffix)]

    def _owners(self, name: str) -> tuple[str, ...]:
        return self.layout.states if name[0] in "xr" else self.layout.coordinates

    def _line(self, one: Line) -> list[str]:
        if isinstance(one, Evaluation):
            return self._evaluation(one, "forces", ("_f",))
        if isinstance(one, Solve):
            return self._solve(one)
        lines = []
        for owner, (shared, text) in self._components(one):
            lines += [*shared, f"{one.target}_{owner} = {text}"]
        return lines

    def _components(self, one: Statement) -> list[tuple[str, tuple[list[str], str]]]:
        """Return, for each component, the lines that a vector statement needs and its right-hand side."""
        shared, text = _in_vectors(one)
        vectors = re.compile(rf"\b({'|'.join(sorted(one.vectors)) or '-'})\b")

        def named(line: str, owner: str) -> str:
            return vectors.sub(rf"\1_{owner}", line)

        return [
            (owner, ([named(line, owner) for line in shared], named(text, owner))) for owner in self._owners(one.target)
        ]

    def _evaluation(self, one: Evaluation, function: str, results: tuple[str, ...]) -> list[str]:
        self.stage += 1
        used = [*self.vector(one.position), *self.vector(one.velocity), *self.vector(one.state)]
        named = [*self.vector(one.acceleration), *self.vector(one.rate)]
        return [
            f"_y = {tuple_of(used)}",
            f"{', '.join(results)} = {function}({one.time}, _y, {CONTEXT})",
            f"_at = sample(_log, _at, {one.time}, _step, _stage + {self.stage}, _y, _f)",
            *(f"{name} = _f[{i}]" for i, name in enumerate(named)),
        ]

    def _solve(self, one: Solve) -> list[str]:
        """Newton's method for the unknowns, with the exact Jacobian at every iteration."""
        unknowns = [(name, owner) for name in one.unknowns for owner in self._owners(name)]
        n = len(unknowns)
        if not n:
            return []
        definitions = self.written(one.definitions)
        body = [*definitions]
        for i, evaluation in enumerate(one.evaluations):
            body += self._evaluation(evaluation, "linearised", ("_f", f"_j{i}"))
        body += self._residuals(one)
        body += self._matrix(one, unknowns)
        body += ["if not solve_linear(_m, _b):", "    break", "_w = 0.0"]
        for i, (name, owner) in enumerate(unknowns):
            start, slope = ("x", "r") if name[0] == "x" else ("v", "a")
            size = f"abs({name}_{owner}) + abs({start}_{owner}) + abs(h*{slope}_{owner})"
            body += [
                f"{name}_{owner} -= _b[{i}]",
                f"_w = _greatest(_w, abs(_b[{i}])/({size}) if _b[{i}] != 0.0 else 0.0)",
            ]
        body += [f"_solved = _w <= {NEWTON_TOLERANCE!r}"]
        evaluations = len(one.evaluations)
        return [
            f"_m, _b = empty(({n}, {n})), empty({n})",
            "_turns, _solved, _first = 0, False, _at",
            f"while _turns < {MOST_ITERATIONS} and not _solved:",
            *(f"    {line}" for line in ["_turns, _at = _turns + 1, _first", *body]),
            *definitions,
            f"_evaluations += (_turns - 1)*{evaluations}",
            "_iterations = _iterations + _turns if _solved and _iterations >= 0 else -1",
        ]

    def _residuals(self, one: Solve) -> list[str]:
        lines, row = [], 0
        for equation in one.equations:
            for owner, (shared, text) in self._components(equation):
                lines += [*shared, f"_b[{row}] = {equation.target}_{owner} - ({text})"]
                row += 1
        return lines

    def _matrix(self, one: Solve, unknowns: list[tuple[str, str]]) -> list[str]:
        """Derivative of every residual by every unknown: what is linear directly, the rest through the forces."""
        inner = {line.target: line.expression for line in one.definitions}
        lines, row = [], 0
        for equation in one.equations:
            outer = expand(equation.expression, inner)
            for owner in self._owners(equation.target):
                for column, unknown in enumerate(unknowns):
                    text = self._entry(one, outer, (equation.target, owner), unknown, inner)
                    lines.append(f"_m[{row}, {column}] = {text}")
                row += 1
        return lines

    def _entry(
        self, one: Solve, outer: Node, target: tuple[str, str], unknown: tuple[str, str], inner: Mapping[str, Node]
    ) -> str:
        """Write one entry of the matrix."""
        text = "1.0" if target == unknown else "0.0"
        same = target[1] == unknown[1] and (target[0][0] == "x") == (unknown[0][0] == "x")
        direct = _coefficient(outer, unknown[0])
        if same and direct != "0.0":
            text += f" - {direct}"
        of_state = target[0][0] == "x"
        given = rate(target[1]) if of_state else target[1]
        for i, evaluation in enumerate(one.evaluations):
            weight = _coefficient(outer, evaluation.rate if of_state else evaluation.acceleration)
            if weight == "0.0":
                continue
            used = (evaluation.state,) if unknown[0][0] == "x" else (evaluation.position, evaluation.velocity)
            for vector in used:
                inside = _coefficient(expand(Name(vector), inner), unknown[0])
                by = self.layout.argument(vector[0], unknown[1])
                if inside != "0.0" and (given, by) in self.layout.jacobian:
                    text += f" - {weight}*{inside}*_j{i}[{self.layout.jacobian.index((given, by))}]"
        return text


@lru_cache(maxsize=4096)
def _in_vectors(one: Statement) -> tuple[list[str], str]:
    """Write a statement in its vectors, for any component: the parts that stand in it twice, and the rest."""
    arithmetic = Arithmetic([one.expression])
    text = arithmetic.text(one.expression)
    return arithmetic.lines, text


def _coefficient(node: Node, name: str) -> str:
    """Return what a vector is multiplied with in a linear expression, as text in parentheses."""
    found = derivative(node, {name: Number(1.0)})
    text = Arithmetic([]).text(found)
    return text if isinstance(found, Number) else f"({text})"

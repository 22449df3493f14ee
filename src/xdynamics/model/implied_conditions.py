"""How the force of conditions that imply each other is shared, which the motion does not tell: the least of all shares.

Where R M^-1 R^T has no full rank, multipliers u and u + N z accelerate alike, for every z and N of its null space. Taken is
the least norm of all, each multiplier weighed by its diagonal entry, which is what it accelerates by itself: so the share
does not depend on how a condition is written, in which unit or times which number.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from xdynamics.expressions import Binary, Call, Compare, Name, Node
from xdynamics.expressions.calculus import ONE, ZERO, multiply, negative, sum_of_terms
from xdynamics.model.mass import Assignment
from xdynamics.runtime.cached_properties import cached_property

Vectors = dict[int, dict[int, Node]]  # of every implied condition: its null vector's entries by condition


@dataclass(frozen=True)
class Sharing:
    """How multipliers are shared, from the factors of R M^-1 R^T = L D L^T.

    Attributes
    ----------
    implied : tuple of int
        The conditions that those before them imply at the start; where their pivots are none at a state, others imply them.
    inverse_pivots : tuple of str
        Of D, zero where a pivot is none.
    factors : mapping of (int, int) to str
        Of L below its diagonal, where it is not zero throughout.
    weights : tuple of Node
        Of each multiplier in norms.
    """

    implied: tuple[int, ...]
    inverse_pivots: tuple[str, ...]
    factors: Mapping[tuple[int, int], str]
    weights: tuple[Node, ...]

    @cached_property
    def _spanned(self) -> tuple[list[Assignment], Vectors]:
        """Vectors that span the null space, each orthogonal to those before it."""
        lines: list[Assignment] = []
        vectors: Vectors = {}
        for p in self.implied:
            raw: dict[int, Node] = {p: Name(f"_implied{p}")}
            lines.append(Assignment(f"_implied{p}", _where_positive(Name(self.inverse_pivots[p]), ZERO, ONE)))
            for i in reversed(range(p)):  # L^T z = 0
                if terms := [multiply(Name(self.factors[j, i]), raw[j]) for j in raw if (j, i) in self.factors]:
                    lines.append(Assignment(f"_null{p}_{i}", negative(sum_of_terms(terms))))
                    raw[i] = Name(f"_null{p}_{i}")
            for q, earlier in vectors.items():
                lines.append(Assignment(f"_along{p}_{q}", self._projection(raw, earlier, q)))
                for i, entry in earlier.items():
                    part = Binary("-", raw.get(i, ZERO), Binary("*", Name(f"_along{p}_{q}"), entry))
                    lines.append(Assignment(f"_null{p}_{i}_{q}", part))
                    raw[i] = Name(f"_null{p}_{i}_{q}")
            vectors[p] = raw
            square = Name(f"_square{p}")
            lines.append(Assignment(square.name, self._weighted_product(raw, raw)))
            lines.append(Assignment(_inverse_square(p), _where_positive(square, Binary("/", ONE, square), ZERO)))
        return lines, vectors

    def null_vectors(self) -> Iterator[Assignment]:
        """Write what spans the null space."""
        yield from self._spanned[0]

    def least_norm(self, forces: Sequence[str], basic: Sequence[str]) -> Iterator[Assignment]:
        """Write the multipliers of least norm from others that accelerate alike, a basic solution."""
        left: dict[int, Node] = {k: Name(name) for k, name in enumerate(basic)}
        for p, vector in self._spanned[1].items():
            part = Name(f"_part{p}_{forces[p]}")
            yield Assignment(part.name, self._projection(left, vector, p))
            for i, entry in vector.items():
                reduced = Name(f"_less{p}_{forces[i]}")
                yield Assignment(reduced.name, Binary("-", left[i], Binary("*", part, entry)))
                left[i] = reduced
        yield from (Assignment(name, left[k]) for k, name in enumerate(forces))

    def _projection(self, multipliers: Mapping[int, Node], vector: Mapping[int, Node], p: int) -> Node:
        return Binary("*", self._weighted_product(multipliers, vector), Name(_inverse_square(p)))

    def _weighted_product(self, a: Mapping[int, Node], b: Mapping[int, Node]) -> Node:
        shared = sorted(a.keys() & b.keys())
        return sum_of_terms([Binary("*", self.weights[i], Binary("*", a[i], b[i])) for i in shared]) if shared else ZERO


def _where_positive(value: Node, then: Node, otherwise: Node) -> Node:
    return Call("where", (Compare(">", value, ZERO), then, otherwise))


def _inverse_square(p: int) -> str:
    return f"_inverse_square{p}"

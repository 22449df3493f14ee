"""Butcher tableaus, read as they are printed and written out as update equations."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from decimal import Decimal, localcontext
from fractions import Fraction

from xdynamics.methods.lines import spread_over_vectors

Weights = tuple[str, ...]


@dataclass(frozen=True)
class Tableau:
    """The coefficients of an explicit Runge-Kutta method as texts, so that equations print them as written.

    Stage 1 is the state at the start of a step, whose forces are known from the last step. The last line of the update
    evaluates those at its end; if the last stage of the tableau is that same evaluation, it is not done twice.

    Attributes
    ----------
    c : tuple of str
        The stages' times, in steps.
    a : tuple of tuple of str
        Row i has the weights of the i stages before.
    b : tuple of str
        The weights of the end. There may be more rows than weights: stages of the continuous extension only.
    b_hat : tuple of str
        The weights of the embedded formula; empty if there is none.

    Examples
    --------
    >>> print(Tableau.parse('''
    ...     0 |
    ...     1 | 1
    ...    ---+---------
    ...     b | 1/2  1/2
    ... ''').template)
    y2 = y + h*k
    k2 = f(t1, y2)
    y1 = y + h*(1/2*k + 1/2*k2)
    k1 = f(t1, y1)
    """

    c: Weights
    a: tuple[Weights, ...]
    b: Weights
    b_hat: Weights = ()

    @classmethod
    def parse(cls, text: str) -> Tableau:
        """Read ``c | a a a`` rows, a rule, then the rows ``b |`` and, if there is an embedded formula, ``b^ |``."""
        rows = [line.split("|") for line in text.splitlines() if "|" in line]
        labelled = [(label.strip(), tuple(weights.split())) for label, weights in rows]
        stages = [row for row in labelled if not row[0].startswith("b")]
        ends = dict(labelled[len(stages) :])
        return cls(tuple(c for c, _ in stages), tuple(a for _, a in stages), ends["b"], ends.get("b^", ()))

    @classmethod
    def from_entries(cls, times: str, text: str, end: int) -> Tableau:
        """Read ``i j a`` rows, as codes print large tableaus; the stage `end` is the end of the step."""
        c = tuple(times.split())
        weights = {
            (int(i), int(j)): value for i, j, value in (line.split() for line in text.splitlines() if line.strip())
        }
        rows = tuple(tuple(weights.get((i, j), "0") for j in range(1, i)) for i in range(1, len(c) + 1))
        return cls(c, rows, (*rows[end - 1], "0"))

    @property
    def ends_with_its_last_stage(self) -> bool:
        """Whether the last stage is the evaluation at the end ("first same as last")."""
        last = len(self.b) - 1
        return self.b == (*self.a[last], "0")

    def stage_lines(self, i: int) -> str:
        """Return the lines of one stage, counted from 0, for y' = k."""
        number = self._stage_suffix(i)
        time = "t1" if self.c[i] == "1" else f"t + {self.c[i]}*h"
        return f"y{number} = y + {self.increment(self.a[i])}\nk{number} = f({time}, y{number})"

    def increment(self, weights: Sequence[str]) -> str:
        """``h*(1/5*k - 2/3*k2)``: a step with weights of the stages."""
        total = weighted_sum(weights, [f"k{self._stage_suffix(i)}" for i in range(len(weights))])
        return f"h*{total}" if total.isalnum() else f"h*({total})"

    @property
    def template(self) -> str:
        """The update for y' = k."""
        inner = range(1, len(self.b) - self.ends_with_its_last_stage)
        return "\n".join([*map(self.stage_lines, inner), f"y1 = y + {self.increment(self.b)}", "k1 = f(t1, y1)"])

    @property
    def update(self) -> str:
        """The update for the vectors of a mechanical system."""
        return spread_over_vectors(self.template)

    @property
    def estimate(self) -> str:
        """The local error by the embedded formula."""
        return spread_over_vectors(f"ye = {self.increment(weight_differences(self.b, self.b_hat))}")

    @property
    def extra_stages(self) -> str:
        """The lines of the stages that only the continuous extension needs, for y' = k."""
        return "\n".join(map(self.stage_lines, range(len(self.b), len(self.c))))

    def _stage_suffix(self, i: int) -> str:
        """The suffix of y and k of a stage: nothing at the start, 1 at the end."""
        if i == 0:
            return ""
        return "1" if self.ends_with_its_last_stage and i == len(self.b) - 1 else str(i + 1)


def weight_columns(text: str, stages: int) -> tuple[Weights, ...]:
    """Read rows of a stage number and its weights, one per column; omitted stages have weight zero."""
    rows = {int(number): weights for number, *weights in (line.split() for line in text.splitlines() if line.strip())}
    zeros = ["0"] * len(next(iter(rows.values())))
    return tuple(zip(*(rows.get(i, zeros) for i in range(1, stages + 1)), strict=True))


def weighted_sum(weights: Iterable[str], vectors: Iterable[str]) -> str:
    """``1/5*k - 2/3*k2``: weights times vectors, without terms of weight zero."""
    signs = {"1": "", "-1": "-"}
    terms = [f"{signs.get(w, w + '*')}{vector}" for w, vector in zip(weights, vectors, strict=True) if w != "0"]
    return " + ".join(terms).replace(" + -", " - ")


def weight_differences(weights: Weights, subtrahends: Weights) -> Weights:
    """Return weights minus others, exactly: fractions as fractions, decimals as decimals."""
    return tuple(_difference(weight, subtracted) for weight, subtracted in zip(weights, subtrahends, strict=True))


def _difference(weight: str, subtracted: str) -> str:
    if "/" in weight + subtracted:
        return str(Fraction(weight) - Fraction(subtracted))
    with localcontext(prec=60):  # more digits than any table prints
        return format(Decimal(weight) - Decimal(subtracted), "f")

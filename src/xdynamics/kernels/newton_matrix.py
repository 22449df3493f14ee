"""What Newton's method needs of the equations of a step, and the entries of its matrix."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from xdynamics.expressions import Name, Node, Number, derivative, expand
from xdynamics.kernels.layout import Layout
from xdynamics.methods.lines import Solve
from xdynamics.schema import rate

DIRECT = -1  # in place of a derivative: a coefficient that is multiplied by none


@dataclass(frozen=True)
class NewtonSystem:
    """What Newton's method needs of one `solve`, as places in the working memory `w` and in the state `y`.

    Attributes
    ----------
    evaluations : int
        Force evaluations of one iteration.
    residuals : int
        Place of the first residual; the others follow.
    unknowns : tuple of (int, int, int, int)
        For each vector: places of its first number in `w`, and in `y` of value and slope at the start of the step, which
        give its size; how many numbers it has.
    entries : tuple of (int, int, int, int)
        What is subtracted from the unit matrix: row, column, place of a coefficient, place of a derivative or `DIRECT`.
    state : int
        Place of the state at which derivatives are found group by group (`kernels.jacobian_pattern`), -1 if they are not.
    weights : int
        Place of the coefficients of all entries then: see `Coupling.weights`.
    derivatives : int
        Place of those derivatives, of the direction that they are found along, and of the time.
    """

    evaluations: int
    residuals: int
    unknowns: tuple[tuple[int, int, int, int], ...]
    entries: tuple[tuple[int, int, int, int], ...] = ()
    state: int = -1
    weights: int = -1
    derivatives: int = -1


class Coupling:
    """The matrix of Newton's method: direct dependence in the lines, and dependence through the forces.

    Parameters
    ----------
    layout : Layout
    line : Solve
    slopes : list of int
        Where the derivatives of each force evaluation begin.
    coefficient : callable
        Computes a number that all components share; returns its place.
    """

    def __init__(self, layout: Layout, line: Solve, slopes: list[int], coefficient: Callable[..., int]) -> None:
        self._layout, self._line, self._slopes, self._coefficient = layout, line, slopes, coefficient
        self._inner: Mapping[str, Node] = {statement.target: statement.expression for statement in line.definitions}
        self._outer = {statement.target: expand(statement.expression, self._inner) for statement in line.equations}
        self._jacobian = {pair: i for i, pair in enumerate(layout.jacobian)}
        self._places: dict[tuple[str, ...], int | None] = {}

    def entries(
        self, row: int, column: int, target: tuple[str, int], unknown: tuple[str, int]
    ) -> list[tuple[int, int, int, int]]:
        """Return what is subtracted from one entry of the unit matrix, in the order written."""
        (name, i), (variable, k) = target, unknown
        of_state, by_state = name[0] == "x", variable[0] == "x"
        entries = []
        if i == k and of_state == by_state and (slot := self._direct_slot(name, variable)) is not None:
            entries.append((row, column, slot, DIRECT))
        layout = self._layout
        dependent = rate(layout.states[i]) if of_state else layout.coordinates[i]
        for number, evaluation in enumerate(self._line.evaluations):
            for vector in (evaluation.state,) if by_state else (evaluation.position, evaluation.velocity):
                owner = layout.states[k] if by_state else layout.coordinates[k]
                slope = self._jacobian.get((dependent, layout.argument(vector[0], owner)))
                slot = (
                    None
                    if slope is None
                    else self._force_slot(
                        name, evaluation.rate if of_state else evaluation.acceleration, vector, variable
                    )
                )
                if slope is not None and slot is not None:
                    entries.append((row, column, slot, self._slopes[number] + slope))
        return entries

    def weights(self) -> int:
        """Compute the coefficients of one vector of velocities and one of states, and return the place of the first.

        Eight: of velocities and of states by themselves, of accelerations by coordinates, velocities and states, of rates.
        """
        (evaluation,) = self._line.evaluations
        velocity, state = self._line.unknowns
        terms = [derivative(self._outer[name], {name: Number(1.0)}) for name in (velocity, state)]
        insides: list[Node | None] = [None, None]
        for name, slope in ((velocity, evaluation.acceleration), (state, evaluation.rate)):
            for vector, unknown in (
                (evaluation.position, velocity),
                (evaluation.velocity, velocity),
                (evaluation.state, state),
            ):
                terms.append(derivative(self._outer[name], {slope: Number(1.0)}))
                insides.append(derivative(expand(Name(vector), self._inner), {unknown: Number(1.0)}))
        first, *_ = [self._coefficient(*pair) for pair in zip(terms, insides, strict=True)]
        return first

    def _direct_slot(self, name: str, unknown: str) -> int | None:
        return self._coefficient_slot((name, unknown), derivative(self._outer[name], {unknown: Number(1.0)}))

    def _force_slot(self, name: str, slope: str, vector: str, unknown: str) -> int | None:
        weight = derivative(self._outer[name], {slope: Number(1.0)})
        inner_derivative = derivative(expand(Name(vector), self._inner), {unknown: Number(1.0)})
        return (
            None
            if inner_derivative == Number(0.0)
            else self._coefficient_slot((name, slope, vector, unknown), weight, inner_derivative)
        )

    def _coefficient_slot(self, key: tuple[str, ...], weight: Node, inner_derivative: Node | None = None) -> int | None:
        """Return the place of a coefficient; None if it is zero."""
        if key not in self._places:
            zero = weight == Number(0.0)
            self._places[key] = None if zero else self._coefficient(weight, inner_derivative)
        return self._places[key]

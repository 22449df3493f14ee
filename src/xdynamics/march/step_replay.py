"""A failed step repeated in plain numbers: every force evaluation with its state and its results."""

from __future__ import annotations

from collections.abc import Iterator
from math import isfinite, isnan
from typing import TYPE_CHECKING

from xdynamics.expressions import Binary, Call, Node, chain, exponent_of, limits_domain, parse, text_of
from xdynamics.expressions.evaluation import evaluate
from xdynamics.expressions.tree import children
from xdynamics.methods import ConstraintImpulse, Evaluation, Solve, VectorStatement
from xdynamics.methods.lines import TaylorSeries, Walker
from xdynamics.model.motion import constants, drive_pieces, evaluate_motion
from xdynamics.model.regimes import REGIME_NUMBER
from xdynamics.schema import acceleration, rate, velocity

if TYPE_CHECKING:
    from xdynamics.march.runner import March

Values = dict[str, float]


def replayed_evaluations(march: March) -> Iterator[Values]:
    """Yield the force evaluations of the last trial, in internal units.

    Each is a mapping with `t`, the state, drives, force components, accelerations and rates. Half steps, if any,
    follow the whole one; where equations are solved, only their first iteration is made, and nothing after it.
    """
    state = dict(zip(march.layout.record, march.run.y.tolist(), strict=True))
    t, h, regime = float(march.now.t), float(march.now.h), float(march.now.regime)
    model = march.layout.model
    parameters = dict(constants(model, march.settings.scales))
    parameters |= dict(
        zip(list(parameters)[len(parameters) - march.run.modes.size :], march.run.modes.tolist(), strict=True)
    )
    tables = drive_pieces(march.model, march.settings.scales)

    def forces(used: Values) -> Values:
        return evaluate_motion(model, used | {REGIME_NUMBER: regime}, parameters, tables)

    def step(t: float, h: float, state: Values) -> _Retrace:
        retrace = _Retrace(march, forces, t, h, state)
        retrace.walk(march.settings.method.lines(march.model))
        return retrace

    if h == 0.0:
        yield forces(state | {"t": t})
        return
    yield from step(t, h, state).force_evaluations
    if march.settings.scheme.steps > 1:
        half = step(t, h / 2.0, state)
        yield from half.force_evaluations
        if half.is_explicit:
            yield from step(t + h / 2.0, h / 2.0, half.end).force_evaluations


class _Retrace(Walker):
    """Walk a method's lines with one number for each component."""

    def __init__(self, march: March, forces: object, t: float, h: float, state: Values) -> None:
        assert callable(forces)  # noqa: S101
        self.force_evaluations: list[Values] = []
        self.is_explicit = True  # until equations have to be solved
        self._forces = forces
        self._layout = layout = march.layout
        self._left = march.run.w
        self._scalars = {"t": t, "h": h, "t1": t + h}
        self._vectors = {
            "q": {name: state[name] for name in layout.coordinates},
            "v": {name: state[velocity(name)] for name in layout.coordinates},
            "a": {name: state[acceleration(name)] for name in layout.coordinates},
            "x": {name: state[name] for name in layout.states},
            "r": {name: state[rate(name)] for name in layout.states},
        }

    @property
    def end(self) -> Values:
        """The state that the step led to."""
        vectors = self._vectors
        return (
            self.force_evaluations[-1]
            | vectors["q1"]
            | {velocity(k): v for k, v in vectors["v1"].items()}
            | vectors["x1"]
        )

    def assign(self, line: VectorStatement) -> None:
        """Compute one vector."""
        if self.is_explicit:
            owners = self._layout.states if line.of_states else self._layout.coordinates
            self._vectors[line.target] = {
                name: evaluate(
                    line.expression, self._scalars | {vector: self._vectors[vector][name] for vector in line.vectors}
                )
                for name in owners
            }

    def evaluate(self, line: Evaluation) -> None:
        """Evaluate the forces."""
        if not self.is_explicit:
            return
        vectors, layout = self._vectors, self._layout
        used = (
            vectors[line.position] | {velocity(k): v for k, v in vectors[line.velocity].items()} | vectors[line.state]
        )
        result = self._forces(used | {"t": evaluate(parse(line.time), self._scalars)})
        self.force_evaluations.append(result)
        vectors[line.acceleration] = {name: result[acceleration(name)] for name in layout.coordinates}
        vectors[line.rate] = {name: result[rate(name)] for name in layout.states}

    def expand(self, line: TaylorSeries) -> None:
        """Use the coefficients of the last trial."""
        n, m = self._layout.coordinates.size, self._layout.states.size
        places = {"q": range(n), "v": range(n, 2 * n), "x": range(2 * n, 2 * n + m)}
        for i in range(1, line.degree + 1):
            for letter, owners in (
                ("q", self._layout.coordinates),
                ("v", self._layout.coordinates),
                ("x", self._layout.states),
            ):
                numbers = self._left[[i * (2 * n + m) + state_index for state_index in places[letter]]]
                self._vectors[f"{letter}_{i}"] = dict(zip(owners, numbers.tolist(), strict=True))

    def keep(self, line: ConstraintImpulse) -> None:
        """Change nothing: there are no constraints here."""

    def solve(self, line: Solve) -> None:
        """Make the first iteration; anything after it would start from unsolved equations."""
        if self.is_explicit:
            self.walk((*line.definitions, *line.evaluations))
            self.is_explicit = False


def undefined_part(node: Node, values: Values) -> str:
    """Describe the function of an expression that is undefined at its argument; empty where there is none."""
    if not limits_domain(node):
        return ""
    first, links = chain(node)
    for part in (first, *links):
        inner = (part.right,) if isinstance(part, Binary) else children(part)
        for description in (undefined_part(child, values) for child in inner):
            if description:
                return description
        if description := _undefined_at(part, values):
            return description
    return ""


def _undefined_at(node: Node, values: Values) -> str:
    """Describe a function or power that is undefined though its argument is finite; else return nothing."""
    power = isinstance(node, Binary) and node.operator == "**" and (exponent_of(node.right) or 1).denominator != 1
    if not power and not isinstance(node, Call):
        return ""
    assert isinstance(node, Call | Binary)  # noqa: S101 - by `power`
    argument = node.arguments[0] if isinstance(node, Call) else node.left
    value = evaluate(node, values)
    if isfinite(value) or not isfinite(argument_value := evaluate(argument, values)):
        return ""
    described = "has no value" if isnan(value) else f"is {value}"
    remedy = "bound its argument with max, min, abs or where, or end the run there by an event"
    return f"{text_of(node)} {described} where {text_of(argument)} = {argument_value:.6g}; {remedy}"

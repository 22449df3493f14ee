"""A step that failed, made again in plain Python: every force evaluation with what it used and what it gave."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np

from xdynamics.expressions import Binary, Call, Node, exponent_of, limits_domain, parse, text_of
from xdynamics.expressions.evaluation import evaluate
from xdynamics.expressions.tree import children
from xdynamics.kernels.layout import EXTRAPOLATED, STEP_DOUBLING
from xdynamics.kernels.writer import constants_of
from xdynamics.methods import Evaluation, Solve, Statement
from xdynamics.model import Function
from xdynamics.model.drives import looked_up
from xdynamics.schema import acceleration, force, rate, velocity

if TYPE_CHECKING:
    from xdynamics.march.runner import March

Values = dict[str, float]
Vectors = dict[str, dict[str, float]]


def retraced(march: March) -> Iterator[Values]:
    """Yield the force evaluations of the step last tried, in internal units.

    Each is a mapping with `t`, what was used, drives, force components, accelerations and rates. Where half steps go on,
    they follow the whole one; of equations that are solved there is the first iteration, and nothing behind them.
    """
    memory, layout = march.memory, march.layout
    state = dict(zip(layout.state, memory.state, strict=True))
    t, h = memory.t, memory.h
    if h == 0.0:
        yield evaluated(march, t, state)
        return
    yield from _step(march, t, h, state)
    if march.settings.estimator in (STEP_DOUBLING, EXTRAPOLATED):
        half = yield from _step(march, t, h / 2.0, state)
        if half:
            yield from _step(march, t + h / 2.0, h / 2.0, half)


def _step(march: March, t: float, h: float, state: Values) -> Generator[Values, None, Values]:
    """Make one step of the method, yielding its evaluations; return the new state, empty where it was not reached."""
    layout = march.layout
    scalars = {"t": t, "h": h, "t1": t + h}
    vectors: Vectors = {
        "q": {one: state[one] for one in layout.coordinates},
        "v": {one: state[velocity(one)] for one in layout.coordinates},
        "a": {one: state[acceleration(one)] for one in layout.coordinates},
        "x": {one: state[one] for one in layout.states},
        "r": {one: state[rate(one)] for one in layout.states},
    }
    found: Values = {}
    for line in march.settings.method.statements:
        inner: tuple[Statement | Evaluation, ...]
        inner = (*line.definitions, *line.evaluations) if isinstance(line, Solve) else (line,)
        for one in inner:
            if isinstance(one, Evaluation):
                used = vectors[one.position] | {velocity(k): v for k, v in vectors[one.velocity].items()}
                found = evaluated(march, evaluate(parse(one.time), scalars), used | vectors[one.state])
                yield found
                vectors[one.acceleration] = {name: found[acceleration(name)] for name in layout.coordinates}
                vectors[one.rate] = {name: found[rate(name)] for name in layout.states}
            else:
                owners = layout.states if one.of_states else layout.coordinates
                vectors[one.target] = {
                    name: evaluate(one.expression, scalars | {vector: vectors[vector][name] for vector in one.vectors})
                    for name in owners
                }
        if isinstance(line, Solve):
            return {}
    return found | vectors["q1"] | {velocity(k): v for k, v in vectors["v1"].items()} | vectors["x1"]


def evaluated(march: March, t: float, used: Values) -> Values:
    """Evaluate forces and rates at one state, from the trees."""
    model = march.model
    values = dict(zip(constants_of(model), march.problem.parameters, strict=True)) | {"t": t}
    values |= {name: used[name] for name in march.layout.used}
    for i, (name, drive) in enumerate(model.drives.items()):
        values[name], _ = looked_up(march.problem.tables[i], values[drive.argument], of_time=drive.argument == "t")
    totals = dict.fromkeys(model.coordinates, 0.0)
    for term, parts in model.force_components.items():
        for name, one in parts.items():
            values[force(term, name)] = _component(march, one, values)
            totals[name] += values[force(term, name)]
    masses = [[evaluate(model.expanded(entry), values) for entry in row] for row in model.mass]
    values |= dict(zip(map(acceleration, totals), _solved(masses, list(totals.values())), strict=True))
    return values | {rate(name): evaluate(model.expanded(one.rate), values) for name, one in model.states.items()}


def undefined_part(node: Node, values: Values) -> str:
    """Name the function of an expression that has no value at its argument; empty where there is none."""
    if not limits_domain(node):
        return ""
    for child in children(node):
        if found := undefined_part(child, values):
            return found
    if isinstance(node, Call | Binary) and not isfinite(evaluate(node, values)):
        argument = node.arguments[0] if isinstance(node, Call) else node.left
        of_power = (
            isinstance(node, Binary) and node.operator == "**" and (exponent_of(node.right) or 1).denominator != 1
        )
        if (of_power or isinstance(node, Call)) and isfinite(at := evaluate(argument, values)):
            return f"{text_of(node)} has no value where {text_of(argument)} = {at:.6g}"
    return ""


def _component(march: March, one: Node | Function, values: Values) -> float:
    if isinstance(one, Function):
        return float(march.model.functions[one.name](*(values[name] for name in one.arguments)))
    return evaluate(march.model.expanded(one), values)


def _solved(masses: list[list[float]], totals: list[float]) -> list[float]:
    """Solve M a = F; nan where the mass is not positive definite."""
    if not totals:
        return []
    try:
        np.linalg.cholesky(masses)
        found: list[float] = np.linalg.solve(masses, totals).tolist()
    except np.linalg.LinAlgError:
        return [float("nan")] * len(totals)
    return found

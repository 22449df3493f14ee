"""Generated code around the estimate of a step's error: step doubling, the error norm, the sizes a first step needs."""

from __future__ import annotations

from xdynamics.kernels.layout import EXTRAPOLATED, Layout
from xdynamics.kernels.text import CONTEXT, function_of, tuple_of
from xdynamics.methods import Evaluation, Method, Solve


def doubled(layout: Layout, method: Method) -> str:
    """Two half steps against a whole one; their difference over 2**p - 1 is the error of the two."""
    n, stages = len(layout.used), sum(isinstance(one, Evaluation) for one in method.statements)
    stages += sum(len(one.evaluations) for one in method.statements if isinstance(one, Solve))
    rest = f"{CONTEXT}, _log, _at, _step"
    lines = [
        "_middle = t + h/2.0",
        f"_whole, _, _at, _one = advance(t, t1, h, _state, {rest}, 0)",
        f"_half, _, _at, _two = advance(t, _middle, h/2.0, _state, {rest}, {stages})",
        f"_both, _, _at, _three = advance(_middle, t1, h/2.0, _half, {rest}, {2 * stages})",
        f"_error = {tuple_of(f'(_both[{i}] - _whole[{i}])/{2.0**method.order - 1.0!r}' for i in range(n))}",
        "_evaluations = _one[0] + _two[0] + _three[0]",
        "_iterations = _one[1] + _two[1] + _three[1] if _least(_least(_one[1], _two[1]), _three[1]) >= 0 else -1",
    ]
    if layout.estimator == EXTRAPOLATED:
        kept = len(layout.state) - n
        lines += [
            f"_y = {tuple_of(f'_both[{i}] + _error[{i}]' for i in range(n))}",
            f"_f = forces(t1, _y, {CONTEXT})",
            f"_at = sample(_log, _at, t1, _step, {3 * stages + 1}, _y, _f)",
            f"_both = {tuple_of([f'_y[{i}]' for i in range(n)] + [f'_f[{i}]' for i in range(kept)])}",
            "_evaluations += 1",
        ]
    return function_of(f"propose(t, t1, h, _state, {CONTEXT}, _log, _at, _step)", "Two half steps, and a whole one to judge them by.",
                     [*lines, "return _both, _error, _at, (_evaluations, _iterations)"])  # fmt: skip


def judgement(layout: Layout) -> str:
    """Write the error norm, and what the choice of a first step needs; without estimates nothing asks for them."""
    if layout.estimates:
        bodies = _norm(layout), _moved(layout), _sizes(layout)
    else:
        bodies = ["return 0.0"], ["return _state"], ["return 0.0, 0.0, 0.0"]
    heads = (
        ("error_norm(_state, _trial, _error, _rtol, _atol)", "The largest error over its scale."),
        ("moved(_state, h)", "A state moved by one Euler step."),
        ("sizes(_state, _other, _rtol, _atol)", "Scaled sizes of a state, of its slope, and of the slope's change."),
    )
    return "".join(function_of(*head, body) for head, body in zip(heads, bodies, strict=True))


def _norm(layout: Layout) -> list[str]:
    lines = ["_norm = 0.0"]
    for i in range(len(layout.used)):
        scale = f"_atol[{i}] + _rtol*_greatest(abs(_state[{i}]), abs(_trial[{i}]))"
        # a component that is zero and stays so has no error, whatever its scale
        lines.append(f"_norm = _greatest(_norm, abs(_error[{i}])/({scale}) if _error[{i}] != 0.0 else 0.0)")
    return [*lines, "return _norm"]


def _slopes(layout: Layout, state: str) -> list[str]:
    """Name the time derivative of everything that a force evaluation uses."""
    n, q, v = len(layout.used), len(layout.coordinates), len(layout.velocities)
    return [f"{state}[{q + i}]" for i in range(v)] + [f"{state}[{n + i}]" for i in range(n - q)]


def _moved(layout: Layout) -> list[str]:
    moved = [f"_state[{i}] + h*{slope}" for i, slope in enumerate(_slopes(layout, "_state"))]
    kept = [f"_state[{i}]" for i in range(len(layout.used), len(layout.state))]
    return [f"return {tuple_of(moved + kept)}"]


def _sizes(layout: Layout) -> list[str]:
    lines = ["_size, _slope, _change = 0.0, 0.0, 0.0"]
    for i, (slope, other) in enumerate(zip(_slopes(layout, "_state"), _slopes(layout, "_other"), strict=True)):
        lines += [
            f"_scale = _atol[{i}] + _rtol*abs(_state[{i}])",
            f"_size = _greatest(_size, abs(_state[{i}])/_scale)",
            f"_slope = _greatest(_slope, abs({slope})/_scale)",
            f"_change = _greatest(_change, abs({other} - {slope})/_scale)",
        ]
    return [*lines, "return _size, _slope, _change"]

"""Ten problems with closed forms, smooth, limited by events, with contact."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import xdynamics as xd
from cases.problems import MODELS, Problem, coupled_springs, damped, driven_decay, linear_drag, oscillator
from xdynamics.evidence.validating.ledger import CASES

METHODS = ("forward_euler", "midpoint", "velocity_verlet", "ruth3", "rk4", "dormand_prince", "dop853")


SMOOTH: dict[str, tuple[Callable[[], Problem], float, float]] = {  # step, end
    "oscillator": (oscillator, 0.1, 3.0),
    "linear_drag": (linear_drag, 0.02, 0.4),
    "driven_decay": (driven_decay, 0.1, 2.0),
    "coupled_springs": (coupled_springs, 0.1, 3.0),
    "damped": (damped, 0.1, 3.0),
}


def falling(e: float) -> xd.Model:
    """A ball of 1 kg from 1 m on a floor."""
    return xd.Model.from_toml(MODELS / "bouncing_ball.toml").replace(parameters={"e": e})


def impacts(n: int, e: float) -> float:
    """The time of its n-th impact."""
    fall = math.sqrt(2.0 / 9.81)
    return fall * (1 + 2 * sum(e**k for k in range(1, n)))


def known() -> Iterator[tuple[str, xd.Model, dict[str, Any], dict[str, float]]]:
    """Yield problems with events and contacts: model, settings, and the true values of some numbers."""
    ball = xd.Model.from_toml(MODELS / "ball_drag.toml")
    apex = 30 / 9.80665 * math.atan(20 / 30)
    height = 900 / (2 * 9.80665) * math.log(1 + 400 / 900)
    down = 30 / 9.80665 * math.acosh(math.exp(height * 9.80665 / 900))
    yield "apex", ball, {}, {"event_time_apex": apex, "after_apex_y": height}
    yield "landing", ball, {}, {"event_time_ground": apex + down}
    yield "bounces", falling(0.8), {"until": 2.2}, {"event_time_floor": impacts(1, 0.8)}
    sliding = xd.Model.from_toml(CASES / "13_dry_friction.toml")
    yield (
        "friction",
        sliding,
        {"until": 1.0},
        {"event_time_ground": 2 / (0.3 * 9.81), "after_ground_x": 4 / (2 * 0.3 * 9.81)},
    )
    moving = xd.Model.from_toml(CASES / "11_impact.toml")
    met = (math.sqrt(1 + 2 * 9.81) - 1) / 9.81
    yield (
        "moving_floor",
        moving,
        {"until": 0.6},
        {"event_time_floor": met, "after_floor_v_y": 1 + 0.8 * (1 + 9.81 * met)},
    )

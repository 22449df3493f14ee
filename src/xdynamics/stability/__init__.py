"""The largest stable step of a method, from the lines of its update."""

from xdynamics.stability.amplification import LinearSystem
from xdynamics.stability.limits import (
    decay_limit,
    fastest_rate,
    grows_at,
    oscillator_limit,
    rough_rate,
    stable_step,
    stable_step_of,
    stiffness,
    surely_stable,
)
from xdynamics.stability.normal_modes import NormalModes

__all__ = [
    "LinearSystem",
    "NormalModes",
    "decay_limit",
    "fastest_rate",
    "grows_at",
    "oscillator_limit",
    "rough_rate",
    "stable_step",
    "stable_step_of",
    "stiffness",
    "surely_stable",
]

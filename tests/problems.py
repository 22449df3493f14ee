"""Problems with closed forms: a model, and what its exact solution is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

import xdynamics as xd

ROOT = Path(__file__).parents[1]
MODELS = ROOT / "data" / "models"
EPS = float(np.finfo(float).eps)

Solution = Callable[[NDArray[np.float64]], dict[str, NDArray[np.float64]]]


@dataclass(frozen=True)
class Problem:
    """A model with its exact solution over time."""

    model: xd.Model
    exact: Solution


def particle(force: str = "0*newton", v: str = "3 m s-1", **more: object) -> xd.Model:
    """A particle of 2 kg on a line under one force term."""
    statement = {
        "name": "particle",
        "coordinates": {"x": "m"},
        "parameters": {"m": "2 kg", "F": "5 N"},
        "mass": {"x": "m"},
        "forces": {"push": {"x": force}},
        "initial": {"x": "1 m", "v_x": v},
    }
    return xd.Model(**statement | more)


@lru_cache
def free() -> Problem:
    """No force: the position is linear in time."""
    return Problem(particle(), lambda t: {"x": 1 + 3 * t, "v_x": 3 + 0 * t})


@lru_cache
def pushed() -> Problem:
    """Constant force: the position is quadratic in time; a = 2.5 m s-2."""
    return Problem(particle("F"), lambda t: {"x": 1 + 3 * t + 1.25 * t**2, "v_x": 3 + 2.5 * t})


@lru_cache
def oscillator() -> Problem:
    """The harmonic oscillator of data/models: w = 2 s-1."""
    model = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
    return Problem(model, lambda t: {"x": np.cos(2 * t), "v_x": -2 * np.sin(2 * t)})


@lru_cache
def linear_drag() -> Problem:
    """A sinking bead, in mm: tau = 0.1 s, vt = 980.665 mm s-1."""
    model = xd.Model.from_toml(MODELS / "linear_drag.toml")

    def exact(t: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        speed = 980.665 * -np.expm1(-t / 0.1)
        return {"y": 980.665 * t - 0.1 * speed, "v_y": speed}

    return Problem(model, exact)


@lru_cache
def driven_decay() -> Problem:
    """A first-order state alone: x' = -k x + c cos(w t), k = 2, w = 3, x(0) = 1."""
    model = xd.Model(
        name="driven decay",
        parameters={"k": "2 s-1", "w": "3 s-1", "c": "1 kg s-1"},
        states={"x": {"unit": "kg", "rate": "-k*x + c*cos(w*t)"}},
        initial={"x": "1 kg"},
    )

    def exact(t: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        forced = (2 * np.cos(3 * t) + 3 * np.sin(3 * t)) / 13
        return {"x": forced + (1 - 2 / 13) * np.exp(-2 * t)}

    return Problem(model, exact)


SMOOTH: dict[str, Callable[[], Problem]] = {
    "oscillator": oscillator,
    "linear_drag": linear_drag,
    "driven_decay": driven_decay,
}


@lru_cache
def springs() -> xd.Model:
    """Two masses on springs k, joined by kc, pushed by F, and a state fed by time alone: what every method takes."""
    return xd.Model(
        name="springs",
        coordinates={"x": "m", "y": "m"},
        parameters={"m": "1 kg", "k": "0 N m-1", "kc": "0 N m-1", "F": "0 N", "c": "2 K s-1", "w": "3 s-1"},
        mass={"x": "m", "y": "m"},
        forces={"spring": {"x": "-k*x - kc*(x - y)", "y": "-k*y - kc*(y - x)"}, "push": {"x": "F", "y": "F"}},
        states={"s": {"unit": "K", "rate": "c*cos(w*t)"}},
        initial={"x": "1 m", "v_x": "3 m s-1", "y": "1 m", "v_y": "3 m s-1", "s": "1 K"},
    )


@lru_cache
def coupled_springs() -> Problem:
    """The springs joined: the modes x + y and x - y have w1 = 2 and w2 = sqrt(4 + 2*2.5) = 3."""
    model = springs().replace(
        parameters={"k": 4.0, "kc": 2.5}, initial={"x": 1.0, "y": 0.0, "v_x": 0.0, "v_y": 1.0}
    )  # fmt: skip

    def exact(t: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        slow, fast = np.cos(2 * t) + np.sin(2 * t) / 2, np.cos(3 * t) - np.sin(3 * t) / 3
        slow_v, fast_v = np.cos(2 * t) - 2 * np.sin(2 * t), -np.cos(3 * t) - 3 * np.sin(3 * t)
        return {
            "x": (slow + fast) / 2,
            "y": (slow - fast) / 2,
            "v_x": (slow_v + fast_v) / 2,
            "v_y": (slow_v - fast_v) / 2,
            "s": 1 + 2 * np.sin(3 * t) / 3,
        }

    return Problem(model, exact)


@lru_cache
def damped() -> Problem:
    """A driven, damped oscillator that warms a state which drives it back; exact by the exponential of its matrix."""
    model = xd.Model(
        name="damped",
        coordinates={"x": "m"},
        parameters={"m": "1 kg", "k": "4 N m-1", "d": "1 N s m-1", "A": "2 N", "w": "3 s-1", "g": "0.5 s-1", "b": "1 K m-1 s-1", "e": "0.25 N K-1"},
        mass={"x": "m"},
        forces={"spring": {"x": "-k*x"}, "damper": {"x": "-d*v_x"}, "drive": {"x": "A*cos(w*t)"}, "heat": {"x": "e*s"}},
        states={"s": {"unit": "K", "rate": "b*x - g*s"}},
        initial={"x": "1 m", "v_x": "0 m s-1", "s": "1 K"},
    )  # fmt: skip
    # x, v, s, cos wt, sin wt
    matrix = np.array([[0, 1, 0, 0, 0], [-4, -1, 0.25, 2, 0], [1, 0, -0.5, 0, 0], [0, 0, 0, 0, -3], [0, 0, 0, 3, 0]])

    def exact(t: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        found = np.array([expm(matrix * one) @ [1, 0, 1, 1, 0] for one in t])
        return {"x": found[:, 0], "v_x": found[:, 1], "s": found[:, 2]}

    return Problem(model, exact)

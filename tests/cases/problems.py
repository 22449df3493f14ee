"""Problems with closed forms: a model, and what its exact solution is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import mpmath
import numpy as np
from numpy.typing import NDArray

import xdynamics as xd

ROOT = Path(__file__).parents[2]
MODELS = ROOT / "data" / "models"
EPS = float(np.finfo(float).eps)
LOG2_OF_10 = 3.321928094887362

Solution = Callable[[NDArray[np.float64]], dict[str, NDArray[np.float64]]]


@dataclass(frozen=True)
class Problem:
    """A model with its exact solution over time."""

    model: xd.Model
    exact: Solution


def particle(force: str | Callable[..., float] = "0*newton", v: str = "3 m s-1", **more: object) -> xd.Model:
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
    model = springs().replace(parameters={"k": 4.0, "kc": 2.5}, initial={"x": 1.0, "y": 0.0, "v_x": 0.0, "v_y": 1.0})

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
        parameters={
            "m": "1 kg",
            "k": "4 N m-1",
            "d": "1 N s m-1",
            "A": "2 N",
            "w": "3 s-1",
            "g": "0.5 s-1",
            "b": "1 K m-1 s-1",
            "e": "0.25 N K-1",
        },
        mass={"x": "m"},
        forces={"spring": {"x": "-k*x"}, "damper": {"x": "-d*v_x"}, "drive": {"x": "A*cos(w*t)"}, "heat": {"x": "e*s"}},
        states={"s": {"unit": "K", "rate": "b*x - g*s"}},
        initial={"x": "1 m", "v_x": "0 m s-1", "s": "1 K"},
    )
    # x, v, s, cos wt, sin wt
    matrix = np.array([[0, 1, 0, 0, 0], [-4, -1, 0.25, 2, 0], [1, 0, -0.5, 0, 0], [0, 0, 0, 0, -3], [0, 0, 0, 3, 0]])

    def exact(t: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        from scipy import linalg  # a third of a second, which every process of a test would pay

        found = np.array([linalg.expm(matrix * one) @ [1, 0, 1, 1, 0] for one in t])
        return {"x": found[:, 0], "v_x": found[:, 1], "s": found[:, 2]}

    return Problem(model, exact)


# --------------------------------------------------------------------------------------- arguments of elementary functions


def arguments_of(name: str, each: int) -> tuple[NDArray[np.float64], ...]:
    """Five kinds of arguments, `each` of them: ordinary ones, all magnitudes, and the hard ones of a function."""
    random = np.random.default_rng(sum(map(ord, name)))

    def sized(low: float, high: float, *, signed: bool = True) -> NDArray[np.float64]:
        exponents = random.uniform(low * LOG2_OF_10, high * LOG2_OF_10, each)
        sizes = np.ldexp(1.0 + exponents % 1.0, np.floor(exponents).astype(int))  # NumPy's powers differ by processor
        return np.minimum(sizes, 1.7e308) * (random.choice([-1.0, 1.0], each) if signed else 1.0)

    def spread(low: float, high: float) -> NDArray[np.float64]:
        return random.uniform(low, high, each)

    all_sizes = sized(-300, 300)
    near_one = 1.0 + sized(-16, -2)
    turns = np.round(sized(0, 5.5, signed=False)) * (np.pi / 2) * (1 + sized(-16, -6))
    kinds: dict[str, list[tuple[NDArray[np.float64], ...]]] = {
        "exp": [(spread(-1, 1),), (spread(-708, 709),), (spread(-746, -707),), (sized(-20, 0),), (sized(-300, 4),)],
        "log": [
            (spread(0.5, 2),),
            (sized(-307, 308, signed=False),),
            (near_one,),
            (sized(-323.5, -307, signed=False),),
            (spread(0.99, 1.01),),
        ],
        "asin": [
            (spread(-1, 1),),
            (sized(-300, 0),),
            (1 - sized(-16, -1, signed=False),),
            (spread(0.49, 0.51),),
            (spread(-1.5, 1.5),),
        ],
        "sinh": [
            (spread(-1.1, 1.1),),
            (spread(-40, 40),),
            (spread(-711, 711),),
            (sized(-300, 3),),
            (spread(709, 711),),
        ],
        "tanh": [(spread(-0.3, 0.3),), (spread(-3, 3),), (spread(-30, 30),), (sized(-300, 3),), (spread(0.24, 0.26),)],
        "atan": [(spread(-1.2, 1.2),), (spread(-20, 20),), (all_sizes,), (near_one,), (spread(0.1, 0.2),)],
        "atan2": [
            (spread(-1, 1), spread(-1, 1)),
            (all_sizes, sized(-300, 300)),
            (sized(-3, 3), sized(-3, 3)),
            (sized(-323, -300), sized(-323, -300)),
            (spread(0.1, 0.2), near_one),
        ],
        "power": [
            (spread(0.1, 4), spread(-4, 4)),
            (sized(-300, 300, signed=False), sized(-3, 0)),
            (near_one, sized(0, 4)),
            (spread(0.5, 30), np.round(spread(-80, 80))),
            (sized(-320, -300, signed=False), spread(-0.9, 0.9)),
        ],
        "hypot": [
            (spread(-1, 1), spread(-1, 1)),
            (all_sizes, sized(-300, 300)),
            (sized(-3, 3), sized(-3, 3)),
            (sized(-323, -300), sized(-323, -300)),
            (sized(300, 308), sized(300, 307)),
        ],
    }
    angles = [(spread(-10, 10),), (sized(-300, 300),), (sized(0, 6),), (turns,), (spread(-0.8, 0.8),)]
    chosen = kinds.get({"acos": "asin", "cosh": "sinh"}.get(name, name), angles)
    return tuple(np.concatenate(columns) for columns in zip(*chosen, strict=True))


def true_value(name: str, *given: float) -> mpmath.mpf:
    """The value of a function to far more digits than a double has."""
    with mpmath.workprec(1300 if name in ("sin", "cos", "tan", "sinh", "tanh") else 400):
        return getattr(mpmath, name)(*map(mpmath.mpf, given))


def ulps(found: float, true: mpmath.mpf) -> float:
    """How far a double is from a true value, in units of that value's last place; 0 where both are beyond the numbers."""
    if not isinstance(true, mpmath.mpf) or mpmath.isnan(true):
        return 0.0 if found != found else float("inf")
    with mpmath.workprec(1300):
        if abs(true) >= mpmath.mpf(2) ** 1024 * (1 - mpmath.mpf(2) ** -54):
            return 0.0 if abs(found) == float("inf") else float("inf")
        place = mpmath.mpf(2) ** max(int(mpmath.frexp(true)[1]) - 53, -1074) if true else mpmath.mpf(2) ** -1074
        return float(abs(mpmath.mpf(found) - true) / place)

"""Tangents and angles of random arguments of every range are at most 1 ulp from the true ones."""

from __future__ import annotations

import math
from collections.abc import Callable

import mpmath
import numpy as np
import pytest
from numpy.typing import NDArray

from cases.problems import true_value, ulps
from xdynamics.elementary import FUNCTIONS

Floats = NDArray[np.float64]
Random = np.random.Generator
EACH = 400  # arguments of a case
# ulp; the largest of the 320,000 of all cases are 0.732 and 0.579, of some millions against 64 bits of fraction 0.787 and
# 0.663; the set `xdynamics 1` had 1.062 and 5e8
WORST = {"tan": 0.8, "atan2": 0.7}
LEAST, MOST = -323.3, 308.2  # decimal exponents


def sized(random: Random, low: float = LEAST, high: float = MOST) -> Floats:
    """Numbers of either sign and of every size between two powers of ten."""
    return random.choice([-1.0, 1.0], EACH) * 10.0 ** random.uniform(low, high, EACH)


def next_to(random: Random, values: Floats) -> Floats:
    """The numbers themselves and those some places before or behind."""
    return values + random.integers(-3, 4, EACH) * np.spacing(values)


def multiples(random: Random) -> Floats:
    """Doubles next to whole multiples of an eighth of a turn, of all sizes."""
    with mpmath.workprec(1200):
        whole = [int(2.0 ** random.uniform(0, 30)) << int(random.integers(0, 900)) for _ in range(EACH)]
        found = np.array([float(mpmath.mpf(one) * mpmath.pi / 4) for one in whole])
    return next_to(random, found)


ANGLES: dict[str, Callable[[Random], Floats]] = {
    "a turn": lambda random: random.uniform(-10, 10, EACH),
    "an eighth": lambda random: random.choice([-1.0, 1.0], EACH) * random.uniform(0.77, 0.8, EACH),
    "many turns": lambda random: sized(random, 0, 6),
    "huge": lambda random: sized(random, 5),
    "beyond 1e290": lambda random: sized(random, 290),
    "small": lambda random: sized(random, LEAST, 0),
    "subnormal": lambda random: sized(random, LEAST, -307.5),
    "multiples": multiples,
    "bounds of reductions": lambda random: next_to(random, random.choice([8192.0, 500000.0], EACH) * math.pi / 2),
    "wider than a bound": lambda random: random.choice([8192.0, 500000.0], EACH) * random.uniform(1.5, 1.65, EACH),
}


def quotients(random: Random, low: float, high: float) -> tuple[Floats, Floats]:
    """Points whose quotient is of a size between two powers of ten, as far as there are such."""
    x = sized(random)
    with np.errstate(all="ignore"):
        y = x * 10.0 ** random.uniform(low, high, EACH) * random.choice([-1.0, 1.0], EACH)
    y = np.where(y == 0.0, np.copysign(5e-324, y), y)  # the oracle's zeros have no sign
    return np.clip(y, -1.7e308, 1.7e308), x


def tied(random: Random) -> tuple[Floats, Floats]:
    """Points on a diagonal, or next to one, subnormal ones among them."""
    x = sized(random)
    return next_to(random, x) * random.choice([-1.0, 1.0], EACH), x


def of_sixteenths(random: Random) -> tuple[Floats, Floats]:
    """Points whose quotient is next to where the table has another entry, or on one."""
    x = sized(random, -200, 200)
    return next_to(random, x * random.integers(0, 33, EACH) / 32), x


POINTS: dict[str, Callable[[Random], tuple[Floats, Floats]]] = {
    "of like size": lambda random: (random.uniform(-1, 1, EACH), random.uniform(-1, 1, EACH)),
    "of any size": lambda random: (sized(random), sized(random)),
    "y subnormal": lambda random: (sized(random, LEAST, -307.5), sized(random, LEAST, 0)),
    "x subnormal": lambda random: (sized(random, LEAST, 0), sized(random, LEAST, -307.5)),
    "both subnormal": lambda random: (sized(random, LEAST, -307.5), sized(random, LEAST, -307.5)),
    "subnormal quotients": lambda random: quotients(random, LEAST, -307),
    "quotients that overflow": lambda random: quotients(random, 300, 330),
    "near the axis": lambda random: quotients(random, -25, -12),
    "ties": tied,
    "sixteenths": of_sixteenths,
}


def furthest(name: str, *given: Floats) -> float:
    """Return how far the furthest value is from the true one, ulp."""
    with np.errstate(all="ignore"):
        found = FUNCTIONS[name](*given)
    return max(ulps(float(one), true_value(name, *map(float, at))) for one, *at in zip(found, *given, strict=True))


@pytest.mark.cases(400)
def test_tangents(case: int) -> None:
    """Assert that tangents are as close to the true ones as is promised."""
    draw = list(ANGLES.values())[case % len(ANGLES)]
    assert furthest("tan", draw(np.random.default_rng(case))) <= WORST["tan"]


@pytest.mark.cases(400)
def test_angles_of_points(case: int) -> None:
    """Assert that angles of points are as close to the true ones as is promised, in every quadrant."""
    draw = list(POINTS.values())[case % len(POINTS)]
    assert furthest("atan2", *draw(np.random.default_rng(case))) <= WORST["atan2"]


@pytest.mark.parametrize("y", [0.0, 5e-324, 1e-310, 1.0, 1e308])
@pytest.mark.parametrize("x", [0.0, 5e-324, 1e-310, 1.0, 1e308])
def test_quadrants(x: float, y: float) -> None:
    """Assert that the signs of a point turn its angle into that of its quadrant, zeros' signs too."""
    for own in (math.copysign(x, 1.0), math.copysign(x, -1.0)):
        upper, lower = (FUNCTIONS["atan2"](one, own) for one in (y, -y))
        assert lower == -upper
        assert math.copysign(1.0, upper) == 1.0
        assert math.copysign(1.0, lower) == -1.0
    first, second = FUNCTIONS["atan2"](y, x), FUNCTIONS["atan2"](y, -x)
    assert first + second == pytest.approx(math.pi, rel=2e-16)
    assert 0.0 <= first <= math.pi / 2 <= second <= math.pi

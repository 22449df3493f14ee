"""Bounds of budgets against closed forms: each of hundreds of random numbers is within its own."""

from __future__ import annotations

import math
import sys
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import pytest

import xdynamics as xd
from cases.exact_problems import METHODS, SMOOTH, falling, impacts, known
from cases.problems import MODELS
from xdynamics.budgeting.numerical import allowance

BALL = xd.Model.from_toml(MODELS / "ball_drag.toml")
EMBEDDED = ("bogacki_shampine", "dormand_prince", "dop853")
CASES, SHARE = 400, 23  # and of how many each is run without --whole


class Number(NamedTuple):
    """A number of a model that is known exactly."""

    name: str
    model: xd.Model
    settings: dict[str, Any]
    quantity: str
    where: dict[str, Any]
    true: float


def bare(model: xd.Model) -> xd.Model:
    """A model without uncertainties: of these problems the march's own errors are asked for."""
    lines = [line for line in model.to_toml().split("\n") if line]
    return xd.Model.from_text("\n".join(line.replace(', "uncertainty" = 1.0', "") for line in lines))


def smooth(rng: np.random.Generator) -> Number:
    """A coordinate, velocity or state of one of five problems at a random time."""
    name = str(rng.choice(list(SMOOTH)))
    make, _, end = SMOOTH[name]
    at = float(rng.uniform(0.2, 1.0) * end)
    exact = make().exact(np.array([at]))
    quantity = str(rng.choice(list(exact)))
    return Number(name, make().model, {"until": end}, quantity, {"at": at}, float(exact[quantity][0]))


def located(rng: np.random.Generator) -> Number:
    """A time or state at an event, a contact or the end of a slide."""
    problems = list(known())
    name, model, settings, true = problems[rng.integers(len(problems))]
    key = str(rng.choice(list(true)))
    if key.startswith("event_time_"):
        return Number(name, model, settings, "t", {"event": key.removeprefix("event_time_")}, true[key])
    event = next(name for name in ("apex", "ground", "floor") if key.startswith(f"after_{name}_"))
    quantity = key.removeprefix(f"after_{event}_")
    return Number(name, model, settings, quantity, {"event": event, "side": "after"}, true[key])


def thrown(rng: np.random.Generator) -> Number:
    """Apex or landing of a ball with quadratic drag, thrown up at a random speed: to rounding, in light air as well."""
    g, v0, vt = 9.80665, float(rng.uniform(5.0, 40.0)), float(rng.uniform(10.0, 60.0))
    model = BALL.replace(parameters={"vt": vt}, initial={"v_y": v0})
    apex, height = vt / g * math.atan(v0 / vt), vt**2 / (2 * g) * math.log1p((v0 / vt) ** 2)
    landing = apex + vt / g * math.asinh(v0 / vt)
    quantity, event, true = [("t", "apex", apex), ("y", "apex", height), ("t", "ground", landing)][rng.integers(3)]
    return Number("thrown", model, {"until": 12.0}, quantity, {"event": event}, true)


def bounced(rng: np.random.Generator) -> Number:
    """The time of one of four impacts, by a random restitution."""
    e, n = float(rng.uniform(0.4, 0.95)), int(rng.integers(1, 5))
    true = impacts(n, e)
    return Number("bounced", falling(e), {"until": 1.3 * true + 0.3}, "t", {"event": "floor", "occurrence": n}, true)


def swinging(rng: np.random.Generator) -> Number:
    """A damped oscillator of random frequency and damping at a random time."""
    w, d, at = float(rng.uniform(1.0, 6.0)), float(rng.uniform(0.0, 0.6)), float(rng.uniform(0.3, 4.0))
    model = xd.Model(
        name="swinging",
        coordinates={"x": "m"},
        mass={"x": "1*kilogram"},
        parameters={"k": f"{w * w + d * d!r} N m-1", "c": f"{2 * d!r} N s m-1"},
        forces={"spring": {"x": "-k*x"}, "damper": {"x": "-c*v_x"}},
        initial={"x": "0 m", "v_x": "1 m s-1"},
    )
    decay, phase = math.exp(-d * at), w * at
    true = {"x": decay * math.sin(phase) / w, "v_x": decay * (math.cos(phase) - d / w * math.sin(phase))}
    quantity = str(rng.choice(["x", "v_x"]))
    return Number("swinging", model, {"until": at + 0.2}, quantity, {"at": at}, true[quantity])


KINDS = (smooth, located, thrown, bounced, swinging)


@lru_cache(maxsize=CASES)
def budget(case: int) -> tuple[str, float, float, float]:
    """Return what a random number is, its true error, its numerical bound, and the number."""
    rng = np.random.default_rng([case, 1])
    while True:
        one = KINDS[rng.integers(len(KINDS))](rng)
        method = str(rng.choice([*METHODS, *EMBEDDED]))
        if not xd.METHODS[method].refusals(one.model):
            break
    march: dict[str, Any] = one.settings | {"method": method}
    if method in EMBEDDED and rng.random() < 0.5:
        march["rtol"] = float(10 ** rng.uniform(-10, -4))
    else:
        march["step"] = float(10 ** rng.uniform(-2.3, -1.2)) * (0.3 if one.name == "linear_drag" else 1.0)
    found = xd.error_budget(bare(one.model), one.quantity, **one.where, **march)
    said = f"{one.name} {one.quantity} {one.where} {march}"
    return said, abs(float(found.value) - one.true), float(found.numerical_bound), one.true


@pytest.mark.every(3)
@pytest.mark.cases(CASES)
def test_a_bound_holds_the_true_error(case: int) -> None:
    """Assert that the number of the run is no further from the closed form than the sum of its numerical bounds."""
    said, off, bound, true = budget(case)
    assert off <= bound + 2.0**-53 * abs(true), said


@pytest.mark.dear
def test_bounds_have_the_allowance_of_the_convergence_index() -> None:
    """Assert that half of all bounds are from 1.2 to 2 times the true error, of those that are above rounding."""
    ratio = median_ratio(range(0, CASES, SHARE))
    assert 1.2 <= ratio <= 2.0


def median_ratio(cases: range) -> float:
    """Return the median of bounds over true errors, of errors that rounding has no part in."""
    found = [budget(case) for case in cases]
    return float(np.median([bound / off for _, off, bound, true in found if off > 1e-12 * max(1.0, abs(true))]))


@pytest.mark.parametrize(
    ("orders", "factor"),
    [
        ((2.0, 2.0), 1.25),
        ((2.02, 1.99), 1.25),
        ((2.5, 2.0), 1.25 * 2**0.45),
        ((1.5, 2.0), 1.25 * 2**0.45),
        ((4.0, 2.0), 3.0),
        ((-1.0, 2.0), 3.0),
    ],
)
def test_the_allowance_follows_the_spread_of_orders(orders: tuple[float, float], factor: float) -> None:
    """Assert 1.25 where triples of levels agree in an order, more by the ratio to the power of what they part, 3 at most."""
    first = 1.0
    second = first * 2.0 ** -orders[0]
    third = second * 2.0 ** -orders[1]
    values = 7.0 - np.array([0.0, first, first + second, first + second + third])
    assert allowance(values, 0.1 / 2.0 ** np.arange(4), 2.0, 1e-15) == pytest.approx(factor, rel=1e-9)


@pytest.mark.parametrize(
    ("values", "factor"),
    [
        ((0.0, 1.0, 1.25, 1.25), 1.25),
        ((0.0, 1.0, 1.5, 1.5), 1.25 * 2**0.95),
        ((0.0, 1.0, 1.0, 1.0), 3.0),
        ((0.0, 0.0, 0.0, 0.0), 3.0),
    ],
)
def test_levels_that_differ_by_rounding_tell_no_order(values: tuple[float, ...], factor: float) -> None:
    """Assert that one triple is held against the formal order, and that two levels have the factor of two grids."""
    assert allowance(np.array(values), 0.1 / 2.0 ** np.arange(4), 2.0, 1e-9) == pytest.approx(factor)


if __name__ == "__main__":
    count = int(sys.argv[1])
    short = [said for said, off, bound, _ in map(budget, range(count)) if off > bound]
    print(
        f"{count - len(short)} of {count} within the bound; median of bound over error {median_ratio(range(count)):.3f}"
    )
    print("\n".join(short))

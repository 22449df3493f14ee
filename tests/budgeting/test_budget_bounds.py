"""Bounds of budgets against closed forms: each of hundreds of random numbers is within its own.

Numbers of budgets and certificates beside bounds that are proven.
Slopes of motions that constraints keep, by variational equations, against differences of runs.
"""

from __future__ import annotations

import math
import re
import sys
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.exact_problems import METHODS, SMOOTH, falling, impacts, known
from cases.problems import MODELS
from cases.smooth_models import oscillator
from cases.stages import assert_described, assert_same_bits
from xdynamics.budgeting.budget_summary import budget_lines
from xdynamics.budgeting.certificate import _decide_gates
from xdynamics.budgeting.measurand import Target
from xdynamics.budgeting.numerical import allowance
from xdynamics.budgeting.physical import variational_slopes
from xdynamics.dynamics.variational import NotVariedError

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


ASKED: dict[str, Any] = {"method": "rk4", "step": "0.1 s", "without": ["roundoff", "k"], "proven": True}


def stopped() -> xd.Model:
    """Return a mass on a spring of uncertain stiffness, whose run ends at its second turn."""
    events = '[events.turn]\nfunction = "v_x"\naction = "stop"\ncount = 2\n'
    model = oscillator(k={"value": "4 N m-1", "half_width": "0.01 N m-1"})
    return xd.Model.from_text(f"{model.to_toml()}\n{events}")


@pytest.mark.parametrize(
    ("quantity", "where", "exact"),
    [
        ("x", {"at": "1 s", "until": "1 s"}, np.cos(2.0)),
        ("total_energy", {"at": "1 s", "until": "1 s"}, 2.0),
        ("t", {"event": "turn", "until": "9 s"}, np.pi / 2.0),
        ("x", {"event": "turn", "occurrence": 2, "until": "9 s"}, 1.0),
    ],
)
def test_the_number_lies_within_what_is_proven(quantity: str, where: dict[str, Any], exact: float) -> None:
    """Assert that the interval of the values as written holds the closed form, is narrow, and that the error is told from it."""
    budget = xd.error_budget(stopped(), quantity, **where, **ASKED)
    low, high = budget.proven_interval.values
    assert low - 2e-16 <= exact <= high + 2e-16
    assert high - low < 1e-12
    off, value = float(budget.proven_error), float(budget.value)
    assert off == np.nextafter(max(value - low, high - value), 1.0)
    assert abs(value - exact) <= off <= float(budget.numerical_bound)
    assert budget.proven_error.attrs["units"] == budget.value.attrs["units"]
    assert sum(line.startswith("proven    ") for line in budget_lines(budget)) == 1


def test_where_nothing_is_proven() -> None:
    """Assert that a number beyond a corner has no interval, and says why."""
    ball = xd.Model.from_toml(MODELS / "ball_drag.toml")
    budget = xd.error_budget(ball, "t", event="ground", **ASKED | {"only": ["truncation"], "without": None})
    assert np.isnan(budget.proven_interval.values).all()
    assert "no bounds are proven after t = 1.7" in str(budget.proven_text.item())
    assert [line for line in budget_lines(budget) if line.startswith("proven    nothing: no bounds")]


@pytest.mark.parametrize(
    ("model", "quantity", "where", "words"),
    [
        ("harmonic_oscillator", "maximum_x", {}, "no bounds are proven of the maximum of x; give a time or an event"),
        (
            "bouncing_ball",
            "t",
            {"event": "floor"},
            "no bounds are proven of what happens at 'floor', which is no event",
        ),
        ("bouncing_ball", "y", {"at": "0.1 s"}, "cannot be enclosed: contact 'floor' ends the smooth motion"),
    ],
)
def test_numbers_without_bounds_are_refused(model: str, quantity: str, where: dict[str, Any], words: str) -> None:
    """Assert that it is said before anything is marched."""
    with pytest.raises(xd.InputError, match=words):
        xd.error_budget(xd.Model.from_toml(MODELS / f"{model}.toml"), quantity, **where, proven=True, compute=False)


def test_a_lazy_budget_has_the_same_bounds() -> None:
    """Assert description and bits, with the proof as a task."""
    asked = ASKED | {"at": "1 s", "until": "1 s", "only": ["truncation"], "without": None}
    stage = xd.error_budget(stopped(), "x", **asked, compute=False)
    assert any(str(name).startswith("proven-") for name in dict(stage.__dask_graph__()))
    eager = xd.error_budget(stopped(), "x", **asked)
    assert_described(stage, eager)
    assert_same_bits(stage, eager)


@pytest.mark.parametrize(
    ("interval", "verdict"),
    [
        ((2.875, 3.125), "passed"),
        ((3.0, 3.25), "not_checked"),
        ((2.8125, 2.875), "passed"),
        ((3.125, 3.5), "not_checked"),
        ((3.375, 3.5), "failed"),
        ((2.0, 2.6), "failed"),
        ((np.nan, np.nan), "not_checked"),
    ],
)
def test_the_gate_of_proven_bounds(interval: tuple[float, float], verdict: str) -> None:
    """Assert by hand-made figures: a value 3 with a numerical bound 0.25."""
    budget = xr.Dataset(
        {
            "term_name": ("term", np.array(["truncation", "interpolation"])),
            "bound": ("term", np.array([0.125, 0.125])),
            "level_value": ("level", np.array([3.0, 3.25, 4.0])),
            "level_verdict": ((), 0, {"flag_meanings": "asymptotic converging not_converging"}),
            "proven_interval": ("bound", np.array(interval)),
        }
    )
    numbers = {
        "linear_verdict": 0,
        "run_outcome": "completed",
        "physical_rss": 0.0,
        "numerical_bound": 0.25,
        "value": 3.0,
    }
    budget = budget.assign({name: ((), number) for name, number in numbers.items()} | {"proven_text": ((), "why")})
    ledger = xr.Dataset({"verdict": ("case", np.array([0]))})
    found = {name: became for name, became, _ in _decide_gates(budget, ledger, has_draws=False)}
    assert found["proven"] == verdict


@pytest.mark.dear
def test_a_certificate_with_proven_bounds(tmp_path: Path) -> None:
    """Assert that it carries them, passes their gate, and is made again from its file to the bit."""
    model = oscillator()
    certificate = xd.certify(model, "x", at="1 s", method="rk4", step="0.1 s", until="1 s", proven=True)
    assert certificate.attrs["proven"] == 1
    gates = dict(zip(certificate.gate_name.values.tolist(), certificate.gate_verdict.values.tolist(), strict=True))
    assert gates["proven"] == 0
    xd.save(certificate, tmp_path / "c.nc")
    assert xd.recheck(tmp_path / "c.nc").attrs["proven"] == 1


ROD = """
name = "rod with drag"
[coordinates]
x = "m"
y = "m"
[parameters]
m = "2 ± 0.01 kg"
L = "1.5 ± 0.001 m"
g = "9.81 ± 0.01 m s-2"
c = "0.3 ± 0.01 kg s-1"
[mass]
x = "m"
y = "m"
[forces.weight]
potential = "m*g*y"
[forces.drag]
x = "-c*v_x"
y = "-c*v_y"
[constraints.rod]
holds = "sqrt(x**2 + y**2) - L"
[events.low]
function = "v_y"
direction = "rising"
[initial]
x = "1.5 ± 0.002 m"
y = "0 m"
v_x = "0 m s-1"
v_y = "-1 ± 0.01 m s-1"
consistent = true
"""
TWICE = '[constraints.again]\nholds = "(x**2 + y**2 - L**2)/(1*metre)"\n[events'
VALUES = {"m": 2.0, "L": 1.5, "g": 9.81, "c": 0.3, "x": 1.5, "v_y": -1.0}
SETTINGS = {"method": "dop853", "rtol": 1e-12, "until": 1.3}


def differences(text: str, name: str, quantity: str) -> float:
    """The slope of a quantity at the end, by runs on both sides."""
    h, ends = 1e-5, []
    for value in (VALUES[name] + h, VALUES[name] - h):
        moved = re.sub(rf'^{name} = "\S+', f'{name} = "{value!r}', text, flags=re.MULTILINE)
        assert moved != text
        ends.append(float(xd.simulate(xd.Model.from_text(moved), **SETTINGS)[quantity][-1]))
    return (ends[0] - ends[1]) / (2 * h)


@pytest.mark.parametrize("text", [ROD, ROD.replace("[events", TWICE)], ids=["rod", "held twice"])
def test_slopes_of_a_rod_are_those_of_differences(text: str) -> None:
    """Assert that lengths, loads and starts, which follow the rod, have the slopes that runs beside it show."""
    model = xd.Model.from_text(text)
    run = xd.simulate(model, **SETTINGS)
    for quantity in ("x", "v_y"):
        slopes = variational_slopes(run, model, Target(quantity, at=1.3), list(VALUES))
        assert slopes["x"] == pytest.approx(0.0, abs=1e-12)  # the rod takes it back
        for name in ("m", "L", "g", "c", "v_y"):
            assert slopes[name] == pytest.approx(differences(text, name, quantity), rel=1e-7), name


def test_a_start_that_may_not_follow_is_varied_by_what_the_rod_allows() -> None:
    """Assert that without consistent = true a length has no slope, as it would leave the start, and a load has."""
    text = ROD.replace("consistent = true\n", "")
    model = xd.Model.from_text(text)
    run = xd.simulate(model, **SETTINGS)
    with pytest.raises(NotVariedError, match="moves the start from where constraints hold"):
        variational_slopes(run, model, Target("x", at=1.3), ["L"])
    slopes = variational_slopes(run, model, Target("x", at=1.3), ["g", "v_y"])
    assert slopes["g"] == pytest.approx(differences(text, "g", "x"), rel=1e-7)


def test_the_time_of_an_event_has_slopes_on_a_rod() -> None:
    """Assert that the lowest point's time moves with gravity and length as in closed form without drag."""
    still = ROD.replace('c = "0.3 ± 0.01', 'c = "0 ± 0.01').replace('v_y = "-1 ± 0.01', 'v_y = "0 ± 0.01')
    model = xd.Model.from_text(still)
    run = xd.simulate(model, **SETTINGS | {"until": 2.0})
    time = float(run.event_time[0])
    slopes = variational_slopes(run, model, Target("t", event="low", occurrence=1), ["g", "L"])
    assert slopes["g"] == pytest.approx(-time / (2 * 9.81), rel=1e-8)  # t ~ sqrt(L/g)
    assert slopes["L"] == pytest.approx(time / (2 * 1.5), rel=1e-8)


def test_exponents_of_a_rod_with_drag_are_those_of_its_angle() -> None:
    """Assert that a constrained motion has two exponents per freedom, both -c/(2 m) about rest, and none of the rod."""
    resting = ROD.replace('x = "1.5 ± 0.002 m"\ny = "0 m"', 'x = "0 m"\ny = "-1.5 m"').replace("v_y = ", "v_z = ")
    resting = resting.replace('v_x = "0 m s-1"\nv_z = "-1 ± 0.01 m s-1"', 'v_x = "0 m s-1"\nv_y = "0 m s-1"')
    run = xd.simulate(xd.Model.from_text(resting), method="dop853", rtol=1e-10, until="60 s")
    found = xd.diagnose(run, lyapunov=True)
    assert found.lyapunov_exponents.values == pytest.approx([-0.075, -0.075], abs=1e-3)
    assert float(found.lyapunov_exponents.sum()) == pytest.approx(-0.15, abs=1e-4)
    lazily = xd.diagnose(run, lyapunov=True, compute=False, occurrences=3)
    assert lazily.lyapunov_exponents.shape == (2,)

"""Delayed values: closed forms by steps, orders, an independent method of steps, the same bits, refusals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from itertools import pairwise
from math import factorial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.integrate import solve_ivp

import xdynamics as xd
from xdynamics.march import March
from xdynamics.march.configuration import settings_for
from xdynamics.methods import METHODS
from xdynamics.schema import NODE

DECAY = """
name = "decay, one second late"
[parameters]
tau = "1 s"
[states]
y = { unit = "1", rate = "-delayed(y, tau)/second" }
[initial]
y = "1"
"""
KICK = """
[events.kick]
function = "t - 0.37*second"
action = "reset"
set = { y = "y + 1" }
"""
OSCILLATOR = """
name = "spring and damper that answer late"
[coordinates]
x = "m"
[parameters]
m = "1 kg"
k = "4 N m-1"
c = "0.6 N s m-1"
tau = "0.3 s"
[mass]
x = "m"
[forces.spring]
x = "-k*delayed(x, tau)"
[forces.damper]
x = "-c*delayed(v_x, '0.47 s')"
[initial]
x = "1 m"
v_x = "-0.5 m s-1"
[history]
x = "1*metre*cos(t/(2*second))"
v_x = "-0.5*metre/second*exp(t/second)"
"""
BALL = """
name = "bouncing ball with a late drag"
[coordinates]
x = "m"
[mass]
x = "1*kilogram"
[forces.gravity]
x = "-9.81*newton"
[forces.drag]
x = "-0.3*kilogram/second*delayed(v_x, '0.1 s')"
[contacts.floor]
gap = "x"
restitution = 0.8
[initial]
x = "1 m"
"""
LATE = """
name = "integral of something late"
[states]
x = {{ unit = "m", rate = "{rate}" }}
[initial]
x = "0 m"
{more}
"""
CONTROLLER = """
[controllers.clock]
every = "0.1 s"
outputs = { u = { unit = "m s-1", start = "0 m s-1", value = "t*metre/second**2" } }
"""
PUSH = """
[drives.push]
csv = "time [s],push [m s-1]\\n-1,0\\n-0.1,0\\n0.9,1\\n1.9,0\\n"
outside = "hold"
"""


def decay(more: str = "", **settings: Any) -> xr.Dataset:
    """March the decay."""
    return xd.simulate(xd.Model.from_text(DECAY + more), **{"until": "10 s", "method": "dop853", **settings})


def powers(t: float, first: int) -> float:
    """Sum powers from t = k - first on: of y' = -y(t - 1) the solution that is 1 at 0, and before it 1 (1) or 0 (0)."""
    time, total, k = Fraction(t), Fraction(0), 0
    while k == 0 or time - (k - first) >= 0:
        total += (-1) ** k * (time - (k - first)) ** k / factorial(k)
        k += 1
    return float(total) if t >= 0 else float(first)


def worst(run: xr.Dataset, exact: Callable[[float], float], name: str = "y") -> float:
    """Return the largest error at accepted states, those before an event excepted."""
    rows = zip(run["time"].values.tolist(), run[name].values.tolist(), run["row_kind"].values.tolist(), strict=True)
    return max(abs(value - exact(t)) for t, value, kind in rows if kind != 3)


def method_of_steps(
    slope: Callable[..., Sequence[float]],
    history: Callable[[float], Any],
    delays: Sequence[float],
    start: Any,
    end: float,
) -> Any:
    """Solve y' = slope(t, y, y(t - delay), …) with scipy, from one sum of delays to the next."""
    points = {0.0, end}
    for _ in range(12):
        points |= {point + delay for point in points for delay in delays if point + delay < end}
    times = sorted(points)
    times = [*(a for a, b in pairwise(times) if b - a > 1e-11), end]
    pieces: list[tuple[float, Any]] = []

    def before(t: float) -> Any:
        return history(t) if t < 0 else next(piece(t) for first, piece in reversed(pieces) if first <= t)

    state = np.array(start)
    for first, last in pairwise(times):

        def right(t: float, y: Any, first: float = first, last: float = last) -> Any:
            inside = min(max(t, first + 1e-13), last - 1e-13)  # on this side of the points
            return slope(t, y, *(before(inside - delay) for delay in delays))

        solved = solve_ivp(right, (first, last), state, "DOP853", None, True, rtol=1e-12, atol=1e-14, max_step=0.05)
        pieces.append((first, solved.sol))
        state = solved.y[:, -1]
    return before


def oscillation(end: float) -> Any:
    """Return position and velocity of the oscillator, as a function of time."""

    def slope(_t: float, y: Any, early: Any, earlier: Any) -> list[float]:
        return [y[1], -4.0 * early[0] - 0.6 * earlier[1]]

    def history(t: float) -> tuple[float, float]:
        return np.cos(t / 2), -0.5 * np.exp(t)

    return method_of_steps(slope, history, (0.3, 0.47), (1.0, -0.5), end)


@pytest.mark.parametrize("method", ["dop853", "dormand_prince"])
def test_closed_form_by_steps(method: str) -> None:
    """Assert that y' = -y(t - 1) is met to 1e-12, and that the march lands where derivatives up to its order jump."""
    run = decay(method=method, rtol=1e-13)
    assert worst(run, lambda t: powers(t, 1)) < 1e-12
    nodes = run["time"].values[run["row_kind"].values == NODE]
    np.testing.assert_array_equal(nodes, np.arange(1.0, min(10.0, 2.0 + METHODS[method].order)))


@pytest.mark.parametrize("step", [0.04, 0.031])
def test_reset_is_passed_on(step: float) -> None:
    """Assert that a jump of the state is a breaking point too: fixed steps keep order 4, a tolerance its digits."""

    def exact(t: float) -> float:
        return powers(t, 1) + (powers(t - 0.37, 0) if t >= 0.37 else 0.0)

    errors = [worst(decay(KICK, method="rk4", step=h, until="8 s"), exact) for h in (step, step / 8)]
    assert abs(np.log2(errors[0] / errors[1]) / 3 - 4.0) < 0.15
    assert worst(decay(KICK, rtol=1e-13, until="4 s"), exact) < 1e-14


@pytest.fixture(scope="module")
def exact_oscillation() -> Any:
    """The motion of the oscillator, by scipy."""
    return oscillation(4.0)


METHODS_OF_ORDERS = ("heun", "bogacki_shampine", "rk4", "velocity_verlet", "implicit_midpoint", "forest_ruth")


@pytest.mark.parametrize("method", METHODS_OF_ORDERS)
@pytest.mark.parametrize("step", [0.05, 0.047])
def test_fixed_steps_keep_their_order(method: str, step: float, exact_oscillation: Any) -> None:
    """Assert that errors fall as h**p with several delays, whether steps divide them or not."""
    model = xd.Model.from_text(OSCILLATOR)
    runs = [xd.simulate(model, method=method, step=h, until="2 s") for h in (step, step / 8)]
    errors = [
        max(worst(run, lambda t, i=i: exact_oscillation(t)[i], name) for i, name in enumerate(("x", "v_x")))
        for run in runs
    ]
    assert abs(np.log2(errors[0] / errors[1]) / 3 - METHODS[method].order) < 0.2


def test_delayed_oscillator(exact_oscillation: Any) -> None:
    """Assert that two delays of positions and velocities, with a history, agree with an independent method of steps."""
    run = xd.simulate(xd.Model.from_text(OSCILLATOR), method="dop853", rtol=1e-12, until="4 s")
    np.testing.assert_allclose([run["x"][-1], run["v_x"][-1]], exact_oscillation(4.0), rtol=1e-11)


def test_mackey_glass() -> None:
    """Assert that the equation of Mackey and Glass (1977, Science 197, 287) agrees with the method of steps."""
    model = xd.Model.from_text(
        'name = "Mackey and Glass"\n[time]\nunit = "1"\n[initial]\nx = "1.2"\n[states]\n'
        'x = { unit = "1", rate = "0.2*delayed(x, \'17\')/(1 + delayed(x, 17)**10) - 0.1*x" }\n'
    )
    exact = method_of_steps(
        lambda _t, y, early: [0.2 * early[0] / (1 + early[0] ** 10) - 0.1 * y[0]],
        lambda _: (1.2,),
        (17.0,),
        (1.2,),
        60.0,
    )
    for method, rtol in (("dop853", 1e-11), ("dormand_prince", 1e-9)):
        run = xd.simulate(model, method=method, rtol=rtol, until=60.0)
        assert abs(float(run["x"][-1]) - exact(60.0)[0]) < 10 * rtol


def test_steps_before_events_are_kept_too() -> None:
    """Assert that two methods agree behind a reset of a motion that is no polynomial, and that no step exceeds a delay."""
    model = xd.Model.from_text(OSCILLATOR + KICK.replace('y = "y', 'x = "x').replace("+ 1", "+ 1*metre"))
    first = xd.simulate(model, method="dop853", rtol=1e-12, until="2 s")
    second = xd.simulate(model, method="rk4", step="1 ms", until="2 s")
    assert abs(float(first["x"][-1] - second["x"][-1])) < 1e-11
    short = xd.simulate(xd.Model.from_text(DECAY.replace('"1 s"', '"0.1 s"')), method="dop853", rtol=1e-4, until="5 s")
    assert 0.09 < float(short["step_size"].max()) <= 0.1 * (1 + 1e-12)


def test_history_goes_on() -> None:
    """Assert that y' = -pi/2*y(t - 1) goes on as the cosine that it was."""
    model = xd.Model.from_text(DECAY.replace("-delayed", "-pi/2*delayed") + '[history]\ny = "cos(pi*t/(2*second))"\n')
    run = xd.simulate(model, method="dop853", rtol=1e-12, until="20 s")
    assert worst(run, lambda t: np.cos(np.pi * t / 2)) < 1e-11
    assert run.attrs["solver_delay_history"] == "y: cos(pi*t/(2*second))"


def test_what_controllers_hold() -> None:
    """Assert that what jumps at ticks jumps a delay later."""
    run = xd.simulate(
        xd.Model.from_text(LATE.format(rate="delayed(u, '0.25 s')", more=CONTROLLER)),
        method="dop853",
        rtol=1e-10,
        until="2 s",
    )

    def exact(t: float) -> float:
        parts = [(n / 10, (n + 1) / 10) for n in range(20) if n / 10 < t - 0.25]
        return sum((min(t - 0.25, last) - first) * first for first, last in parts)

    assert worst(run, exact, "x") < 1e-14


def test_table_read_late() -> None:
    """Assert that the points of a table are met a delay later, also those before the start."""
    model = xd.Model.from_text(LATE.format(rate="delayed(push, '0.3 s')", more=PUSH))
    run = xd.simulate(model, method="rk4", step="0.07 s", until="3 s")

    def exact(t: float) -> float:
        u = min(max(t - 0.2, 0.0), 2.0)
        return u**2 / 2 if u < 1 else 2 * u - u**2 / 2 - 1

    assert worst(run, exact, "x") < 1e-14


def test_events_switches_and_observables() -> None:
    """Assert that delayed values are located, switch forces, and are recorded."""
    more = (
        "[events.late]\nfunction = \"delayed(x, '0.5 s') - 1*metre\"\n"
        "[observables]\nwas = \"delayed(x, '0.5 s')\"\n"
        "[forces]\n"
    )
    text = LATE.format(rate="1*metre/second", more=more.removesuffix("[forces]\n"))
    text = text.replace(
        "[initial]", 'z = { unit = "m", rate = "abs(delayed(x, \'0.3 s\') - 1*metre)/second" }\n[initial]\nz = "0 m"'
    )
    run = xd.simulate(xd.Model.from_text(text), method="rk4", step="0.07 s", until="3 s")
    np.testing.assert_allclose(run["event_time"], [1.3, 1.5], atol=1e-12)
    np.testing.assert_allclose(run["was"], np.maximum(run["time"] - 0.5, 0.0), atol=1e-14)
    assert (
        worst(
            run,
            lambda t: t if t < 0.3 else 0.3 + (t - 0.3) - (t - 0.3) ** 2 / 2 if t < 1.3 else 0.8 + (t - 1.3) ** 2 / 2,
            "z",
        )
        < 1e-13
    )
    assert run["event_residual"].attrs["units"] == "m"


def test_archive_says_it_all(tmp_path: Path) -> None:
    """Assert that a run is reproduced and extended to the bit from its file, and that the file says what was used."""
    run = decay(method="rk4", step="0.013 s", until="5.5 s")
    xd.save(run, tmp_path / "run.nc")
    assert xd.reproduce(tmp_path / "run.nc").attrs["identical"] == 1
    longer, whole = (
        xd.extend(tmp_path / "run.nc", until="9 s"),
        decay(method="rk4", step="0.013 s", until="9 s", nodes=["5.5 s"]),
    )
    assert xd.content_digest(longer) == xd.content_digest(whole)
    assert run.attrs["solver_delay_history"] == "y: its value at the start (default)"
    assert run.attrs["solver_delay_interpolation_order"] == 3


def test_states_between() -> None:
    """Assert that a run is sampled with all digits, and given at wanted times alone, by steps and by polynomials."""
    run, wanted = decay(rtol=1e-13, until="5 s"), np.linspace(0.0, 5.0, 101)
    exact = [powers(t, 1) for t in wanted.tolist()]
    for found in (
        xd.sample(run, wanted),
        xd.sample(run, wanted, rule="interpolant"),
        decay(rtol=1e-13, until="5 s", times=wanted),
    ):
        np.testing.assert_allclose(found["y"], exact, atol=1e-13)


@pytest.mark.parametrize(("text", "method"), [(BALL, "rk4"), (BALL, "dop853"), (OSCILLATOR, "dormand_prince")])
def test_past_is_made_again_to_the_bit(text: str, method: str) -> None:
    """Assert that polynomials made from the rows of a record are those that the march read."""
    from xdynamics import record
    from xdynamics.dynamics.shortened_steps import StepInterpolator

    model = xd.Model.from_text(text)
    march = March(model, settings_for(model, method=method, step="0.01 s", until="1.1 s"))
    run = record.dataset(march)
    kept = march.run.past_steps[: int(march.run.book[0].pieces * march.run.book[0].width)]
    again = StepInterpolator.of_run(run, None, "reintegrate", model)._past.pieces
    assert kept.size > 100
    np.testing.assert_array_equal(
        again[-kept.size :].reshape(-1, int(march.run.book[0].width))[:, :2],
        kept.reshape(-1, int(march.run.book[0].width))[:, :2],
    )
    np.testing.assert_array_equal(
        again.reshape(-1, int(march.run.book[0].width))[:, 3:][-10:],
        kept.reshape(-1, int(march.run.book[0].width))[:, 3:][-10:],
    )


def test_long_past_is_kept() -> None:
    """Assert that a delay over many steps is read right, and what no delay reaches is let go."""
    model = xd.Model.from_text(DECAY)
    march = March(model, settings_for(model, method="rk4", step="1 ms", until="4 s"))
    for _ in march.blocks(rows=500):
        pass
    assert march.now.t == 4.0
    assert march.run.past_steps.size < 3000 * int(march.run.book[0].width)
    assert abs(float(march.run.y[0]) - powers(4.0, 1)) < 1e-13


@pytest.mark.parametrize("text", [DECAY + KICK, OSCILLATOR])
def test_march_goes_on_from_its_memory(text: str) -> None:
    """Assert that a march that was interrupted goes on to the same bits, with its past."""
    model = xd.Model.from_text(text)
    settings = settings_for(model, method="dop853", rtol=1e-10, max_step="20 ms", until="6 s")
    whole, first = March(model, settings), March(model, settings)
    for _ in whole.blocks(rows=40):
        pass
    blocks = first.blocks(rows=40)
    next(blocks), next(blocks)
    second = March(model, settings)
    second.go_on_from(first.memory())
    for _ in second.blocks(rows=40):
        pass
    assert first.now.t < second.now.t == 6.0
    np.testing.assert_array_equal(second.run.y, whole.run.y)
    assert int(second.now.rows) == int(whole.now.rows)


def spring(force: str, more: str = "", unit: str = "0.2 s") -> xd.Model:
    """A mass on which something late acts."""
    return xd.Model.from_text(
        f'name = "late"\n[coordinates]\nx = "m"\n[parameters]\nk = "4 N m-1"\ntau = "{unit}"\n[mass]\nx = "1*kilogram"\n'
        f'[forces.late]\nx = "{force}"\n[initial]\nx = "1 m"\n{more}'
    )


@pytest.mark.parametrize(
    ("force", "more", "said"),
    [
        ("-k*delayed(x, -tau)", "", r"has the delay '-tau' = -0\.2 s, needs a positive time"),
        ("-k*delayed(x, 0*second)", "", "= 0.0 s, needs a positive time"),
        ("-k*delayed(x, '-20 ms')", "", "= -0.02 s, needs a positive time"),
        ("-k*delayed(x, 'nan s')", "", "the delay 'nan s' is no quantity"),
        ("-k*delayed(x, '20 m')", "", r"the delay '20\*metre' is in 'm', needs 's'"),
        ("-k*delayed(x, x*second/metre)", "", "reads 'x'; a delay is of parameters and does not change"),
        ("-k*delayed(x)", "", r"is written delayed\(x, \"20 ms\"\), and here has no delay"),
        ("-k*delayed(delayed(x, tau), tau)", "", "write one delay, the sum of both"),
        ("-k*delayed(late, tau)", '[definitions]\nlate = "delayed(x, tau)"', "another delayed value; write one delay"),
        ("-k*delayed(q, tau)", "", "name 'q' .* is not declared"),
        ("delayed(2*newton, tau)", "", "delays what never changes; leave out delayed"),
        ("-k*x", '[history]\nx = "1*metre"', "is read nowhere: no expression has"),
        ("-k*delayed(x, tau)", '[history]\nx = "1*second"', "history of 'x': has units 's', needs 'm'"),
        ("-k*delayed(x, tau)", '[history]\nx = "x"', "reads 'x'; what was before the start is of t and parameters"),
        ("-k*x", '[forces.p]\npotential = "k*delayed(x, tau)**2"', "potential of 'p' has a delayed value"),
        ("-k*x", '[contacts.c]\ngap = "delayed(x, tau)"\nrestitution = 1', r"\[contacts\] has a delayed value"),
    ],
)
def test_wrong_delays_are_refused(force: str, more: str, said: str) -> None:
    """Assert that what cannot be delayed, or by so much, is refused with what was found and the remedy."""
    with pytest.raises(xd.InputError, match=said):
        spring(force, more)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"method": "radau_iia", "rtol": 1e-6}, "'radau_iia' .* do not read delayed values; these fit: .*dop853"),
        ({"method": "taylor", "rtol": 1e-6}, "'taylor' .* do not read delayed values; these fit: .*dop853"),
        ({"method": "rk4", "step": "0.3 s"}, "longer than the shortest delay of 0.2 s"),
        ({"method": "dop853", "rtol": 1e-6, "estimator": "step_doubling"}, r"interpolated with errors of h\*\*4"),
        ({"method": "dop853", "rtol": 1e-6, "precision": "double_double"}, "do not go with precision"),
    ],
)
def test_wrong_settings_are_refused(settings: dict[str, Any], said: str) -> None:
    """Assert that methods and steps that cannot read the past are refused before anything is marched."""
    with pytest.raises(xd.InputError, match=said):
        xd.simulate(spring("-k*delayed(x, tau)"), until="1 s", **settings)


def test_other_verbs_say_what_they_cannot() -> None:
    """Assert that proofs and modes refuse delayed values, and that a parameter may make a delay wrong."""
    model = spring("-k*delayed(x, tau)")
    with pytest.raises(xd.InputError, match="nothing is proven of delayed values"):
        xd.enclose(model, until="1 s")
    with pytest.raises(xd.InputError, match="known along a run alone"):
        xd.modes(model)
    with pytest.raises(xd.InputError, match=r"delay 'tau' is 0\.0 s, needs a positive time"):
        xd.simulate(model.replace(parameters={"tau": "0 s"}), method="rk4", step="0.1 s", until="1 s")


def test_table_has_to_reach_back() -> None:
    """Assert that a table of time that does not begin a delay before the start is refused, unless it holds on."""
    model = LATE.format(rate="delayed(push, '3 s')", more=PUSH)
    xd.simulate(xd.Model.from_text(model), method="rk4", step="0.1 s", until="0.1 s")
    with pytest.raises(xd.InputError, match=r"begins at t = -1\.0 s, and is read from t = -3\.0 s on"):
        xd.simulate(
            xd.Model.from_text(model.replace('outside = "hold"', "")), method="rk4", step="0.1 s", until="0.1 s"
        )


def test_delayed_is_a_name_too() -> None:
    """Assert that `delayed` is a function before a parenthesis only, and that a model is written as it was read."""
    model = spring("-k*delayed(x, tau)*delayed", '[definitions]\ndelayed = "2"\n')
    assert xd.Model.from_text(model.to_toml()) == model
    assert "delayed(x, 0.02*second)" in spring("-k*delayed(x, '20 ms')").to_toml()
    run = xd.simulate(model, method="rk4", step="0.1 s", until="0.2 s")
    assert float(run["x"][-1]) == pytest.approx(1.0 - 4.0 * 0.2**2, rel=1e-12)  # 8 N of 1 kg, from rest


def test_refinement_and_diagnosis() -> None:
    """Assert that orders are found and runs diagnosed."""
    study = xd.refine(
        xd.Model.from_text(DECAY),
        method="rk4",
        steps=["0.1 s", "0.05 s", "0.025 s"],
        at=["5 s"],
        observables=["y"],
        until="5 s",
    )
    assert float(study["order_y"][1, 0]) == pytest.approx(4.0, abs=0.01)
    assert float(xd.diagnose(decay(rtol=1e-9))["maximum_y"]) == 1.0


def test_members_of_sweeps_have_their_own_past() -> None:
    """Assert that ends of members, values inside steps and extremes are those of single runs, bit for bit."""
    model, settings = spring("-k*delayed(x, tau)"), {"method": "dop853", "rtol": 1e-9, "until": "3 s"}
    delays, rates = ["0.2 s", "0.31 s"], ["1 N m-1", "3 N m-1"]
    swept = xd.sweep(
        model, axes={"tau": delays, "k": rates}, keep=["end", "x", "maximum_x"], times=["1.1 s"], **settings
    )
    for i, tau in enumerate(delays):
        for j, k in enumerate(rates):
            run = xd.simulate(model.replace(parameters={"tau": tau, "k": k}), **settings)
            assert float(swept.end_x[i, j]) == float(run.x[-1])
            assert float(swept.x[i, j, 0]) == float(xd.sample(run, ["1.1 s"]).x[0])
            assert float(swept.maximum_x[i, j]) == float(xd.diagnose(run).maximum_x)


def test_budgets_vary_a_delay() -> None:
    """Assert that the slope of y' = -k y(t - tau) by its delay and its rate is that of the method of steps."""
    model = xd.Model.from_text(
        'name = "decay"\n[parameters]\ntau = "1 ± 0.001 s"\nk = "1 ± 0.002 s-1"\n[states.y]\nunit = "1"\n'
        'rate = "-k*delayed(y, tau)"\n[initial]\ny = "1"\n'
    )
    budget = xd.error_budget(model, quantity="y", at="2.5 s", method="dop853", rtol=1e-11, until="2.6 s")
    slopes = dict(zip(budget.term_name.values.tolist(), budget.sensitivity.values.tolist(), strict=True))
    # y(2.5) = 1 - 2.5 k + k**2 (2.5 - tau)**2/2 - k**3 (2.5 - 2 tau)**3/6
    assert slopes["tau"] == pytest.approx(-1.5 + 0.5**2, rel=1e-5)
    assert slopes["k"] == pytest.approx(-2.5 + 1.5**2 - 0.5**3 / 2, rel=1e-5)

"""Sampled controllers: held between ticks to the bit, against exact solutions from tick to tick.

`floor`, `ceil`, `round` and `mod` at ticks of controllers: what is whole to rounding counts as whole.
"""

from __future__ import annotations

from fractions import Fraction
from math import exp
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.expressions import parse
from xdynamics.expressions.evaluation import evaluate
from xdynamics.model.kinks import with_whole_numbers

CART = """
name = "cart"
[coordinates]
x = "m"
[parameters]
m = "2 kg"
k = "32 N m-1"
d = "8 N s m-1"
[mass]
x = "m"
[forces.motor]
x = "u"
[controllers.pd]
every = "10 ms"
{more}
outputs = {{ u = {{ unit = "N", start = "1 N", value = "-k*x - d*v_x", minimum = "-15 N", maximum = "15 N" }} }}
states = {{ integral = {{ unit = "m s", start = "0 m s", next = "integral + x*every" }} }}
[initial]
x = "0.5 m"
v_x = "0 m s-1"
"""


def cart(more: str = "") -> xd.Model:
    """A cart pulled back by a sampled controller, with a limited force."""
    return xd.Model.from_text(CART.format(more=more))


def exact(ticks: int, delay: Fraction = Fraction(0), one: Any = Fraction(1)) -> list[tuple[Any, ...]]:
    """Position, velocity, what was computed last and the sum at each tick: parabolas, joined."""
    x, v, total, held, h = one / 2, one * 0, one * 0, one, one / 100
    found = []
    for _ in range(ticks + 1):
        new = min(max(-32 * x - 8 * v, -15 * one), 15 * one)
        total += x * h
        found.append((x, v, new, total))
        for time, force in ((one * delay, held), (h - one * delay, new)):
            a = force / 2
            x, v = x + v * time + a * time * time / 2, v + a * time
        held = new
    return found


def at_ticks(run: xr.Dataset, *names: str, every: float = 0.01) -> np.ndarray:
    """What a run has at its ticks, shape (names, ticks)."""
    rows = np.isin(run.time.values, np.arange(run.sizes["step"]) * every) | np.isin(
        run.time.values, np.array([k / 100 for k in range(run.sizes["step"])])
    )
    return np.stack([run[name].values[rows] for name in names])


@pytest.mark.every(4)
@pytest.mark.parametrize("method", xd.METHODS)
def test_outputs_hold_between_ticks(method: str) -> None:
    """Assert the exact motion by fixed steps of a tick, with every method of second order that takes such a motion."""
    run = xd.simulate(cart(), method=method, step="10 ms", until="0.3 s")
    found = at_ticks(run, "x", "v_x", "u", "integral")
    wanted = np.array(exact(30, one=1.0)).T
    assert found.shape == wanted.shape
    if xd.METHODS[method].order >= 2:
        assert np.abs(found - wanted).max() < 1e-13
    assert [*run.row_kind.values] == [0, *[2] * 29, 1]


@pytest.mark.parametrize("asked", [{"method": "rk4", "step": "3 ms"}, {"method": "dop853", "rtol": 1e-10}])
def test_steps_land_on_ticks(asked: dict[str, Any], request: pytest.FixtureRequest) -> None:
    """Assert the exact motion where steps do not divide the period, over 1,000 ticks, or 800,000, and that values hold."""
    ticks = 800_000 if request.config.getoption("--whole") else 1000
    run = xd.simulate(cart(), until=ticks / 100, force_samples="none", **asked)
    found, wanted = at_ticks(run, "x", "u"), np.array(exact(ticks, one=1.0)).T[[0, 2]]
    assert np.abs(found - wanted).max() < 1e-12
    between = xd.sample(run, np.linspace(0.0, 0.0995, 200))
    assert np.array_equal(between.u.values, np.repeat(found[1][:10], 20))


@pytest.mark.parametrize("delay", ["3 ms", "10 ms"])
def test_outputs_wait(delay: str) -> None:
    """Assert what a computing time does, also of a whole period; the sum is not delayed."""
    run = xd.simulate(cart(f'delay = "{delay}"'), method="dormand_prince", rtol=1e-9, until="0.4 s")
    wanted = np.array(exact(40, Fraction(int(delay.split(maxsplit=1)[0]), 1000), one=Fraction(1))).astype(float).T
    assert np.abs(at_ticks(run, "x", "v_x", "u_pending", "integral") - wanted).max() < 1e-12
    assert run.u.values[0] == 1.0


def test_a_delay_may_take_several_periods() -> None:
    """Assert that values come in their order, 23 ms after they were computed, and that the first holds until then."""
    run = xd.simulate(cart('delay = "23 ms"'), method="rk4", step="1 ms", until="0.2 s")
    time, u = np.round(run.time.values * 1000).astype(int), run.u.values
    computed = dict(zip(time.tolist(), run.u_pending_1.values.tolist(), strict=True))
    assert [*u[time < 23]] == [1.0] * 23
    assert all(
        value == computed[(t - 23) // 10 * 10] for t, value in zip(time.tolist(), u.tolist(), strict=True) if t >= 23
    )


def test_31_digits_of_a_controlled_motion() -> None:
    """Assert the exact rational motion to 1e-29 where numbers are sums of two floats."""
    run = xd.simulate(cart('delay = "3 ms"'), method="rk4", step="10 ms", until="0.3 s", precision="double_double")
    x, v, u, total = exact(30, Fraction(3, 1000))[-1]
    for name, value in (("x", x), ("v_x", v), ("u_pending", u), ("integral", total)):
        found = Fraction(float(run[name][-1])) + Fraction(float(run[f"rest_{name}"][-1]))
        assert abs(found - value) < Fraction(1, 10**29), name


TWO = """
name = "two"
[coordinates]
x = "m"
[mass]
x = "1*kilogram"
[forces.motor]
x = "quick + slow"
[controllers.first]
every = "10 ms"
outputs = { quick = { unit = "N", start = "0 N", value = "quick + slow + 1*newton" } }
[controllers.second]
every = "25 ms"
phase = "5 ms"
outputs = { slow = { unit = "N", start = "2 N", value = "quick" } }
[initial]
x = "0 m"
"""


def test_several_rates() -> None:
    """Assert two controllers with ticks of their own, at some of which both act on what was before."""
    run = xd.simulate(xd.Model.from_text(TWO), method="rk4", step="1 s", until="0.2 s")
    quick, slow, wanted = 0.0, 2.0, {}
    for ms in range(0, 205, 5):
        before = quick, slow
        if ms % 10 == 0:
            quick = sum(before) + 1.0
        if ms % 25 == 5:
            slow = before[0]
        if ms % 10 == 0 or ms % 25 == 5:
            wanted[ms] = quick, slow
    times = [round(1000 * t) for t in run.time.values.tolist()]
    assert times == [*wanted]
    assert [*zip(run.quick.values, run.slow.values, strict=True)] == [*wanted.values()]


def test_a_thermostat_switches_when_it_looks() -> None:
    """Assert the room's exponentials from look to look, and that the heater has its hysteresis."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "thermostat.toml"))
    room, heater = 290.15, 0.0
    rows = np.isin(run.time.values, np.arange(481) * 30.0)
    for found, on in zip(run["T"].values[rows], run.heater.values[rows], strict=True):
        heater = 1.0 if room < 292.15 else 0.0 if room > 294.15 else heater
        assert (found, on) == (pytest.approx(room, abs=1e-7), heater)
        end = 278.15 + 30.0 * heater
        room = end + (room - end) * exp(-30.0 / 3000.0)


def test_a_balanced_pendulum_stays_upright() -> None:
    """Assert that the linear map from tick to tick contracts at the rate at which the march does at small angles."""
    from scipy.linalg import expm

    model = xd.Model.from_toml(MODELS / "balanced_pendulum.toml").replace(initial={"theta": "0.01 degree"})
    run = xd.simulate(model, until="6 s")
    a, b = np.zeros((4, 4)), np.array([0.0, 1.0, 0.0, -2.0])
    a[0, 1] = a[2, 3] = 1.0
    a[1, 2], a[3, 2] = -0.1 * 9.81, 1.1 * 9.81 / 0.5
    block = expm(np.vstack([np.column_stack([a, b]), np.zeros(5)]) * 0.01)
    step = block[:4, :4] + np.outer(block[:4, 4], [2.0, 4.0, 35.0, 7.0])
    state = np.array([0.0, 0.0, np.radians(0.01), 0.0])
    for _ in range(600):
        state = step @ state
    found = np.array([float(run[name][-1]) for name in ("x", "v_x", "theta", "v_theta")])
    assert np.abs(found - state).max() < 1e-4 * np.radians(0.01)


def test_an_end_on_a_tick_is_gone_on_from() -> None:
    """Assert that longer runs have the bits of whole ones, whether they ended on a tick or not, and archives are made again."""
    for end in ("0.1 s", "0.105 s"):
        asked: dict[str, Any] = {"method": "dop853", "rtol": 1e-8}
        longer = xd.extend(xd.simulate(cart(), until=end, **asked), until="0.2 s")
        whole = xd.simulate(cart(), until="0.2 s", nodes=[end], **asked)
        assert xd.content_digest(longer) == xd.content_digest(whole)


def test_an_archive_is_made_again(tmp_path: Path) -> None:
    """Assert that a record's file is reproduced, and says what each value is."""
    run = xd.simulate(cart('delay = "3 ms"'), method="rk4", step="10 ms", until="0.1 s")
    xd.save(run, tmp_path / "cart.nc")
    assert xd.reproduce(tmp_path / "cart.nc").attrs["identical"] == 1
    assert run.u.attrs["role"] == "held"
    assert run.u.attrs["long_name"] == "output of controller pd, held between its ticks"
    assert "rate_u" not in run


def test_an_event_at_a_tick() -> None:
    """Assert one row before and one after an event that falls on a tick, and that the tick acts once."""
    text = CART.format(more="").replace("[initial]", '[events.noon]\nfunction = "t - 0.05*second"\n[initial]')
    run = xd.simulate(xd.Model.from_text(text), method="rk4", step="10 ms", until="0.1 s")
    before, after = int(run.event_row_before[0]), int(run.event_row_after[0])
    wanted = np.array(exact(10, one=1.0)).T
    assert run.u.values[before] == pytest.approx(wanted[2, 4], abs=1e-13)
    assert run.u.values[after] == pytest.approx(wanted[2, 5], abs=1e-13)
    assert float(run.integral[-1]) == pytest.approx(wanted[3, 10], abs=1e-13)


def test_gains_are_parameters() -> None:
    """Assert that members of a sweep are runs, and a budget's sensitivity to a gain that of the exact motion."""
    swept = xd.sweep(
        cart(), {"k": ["30 N m-1", "32 N m-1"]}, method="rk4", step="10 ms", until="0.2 s", keep=["end_x", "end_u"]
    )
    run = xd.simulate(cart(), method="rk4", step="10 ms", until="0.2 s")
    assert float(swept.end_x[1]) == float(run.x[-1])
    assert float(swept.end_u[1]) == float(run.u[-1])
    uncertain = cart().replace(parameters={"k": "32 ± 0.1 N m-1"})
    budget = xd.error_budget(uncertain, "x", at="0.2 s", until="0.2 s", method="rk4", step="10 ms")
    lower, upper = (
        float(xd.simulate(cart().replace(parameters={"k": k}), method="rk4", step="10 ms", until="0.2 s").x[-1])
        for k in (31.99, 32.01)
    )
    assert float(budget.physical_rss) == pytest.approx(0.1 * abs(upper - lower) / 0.02, rel=1e-4, abs=0.0)


FAULTS = {
    'every = "0 s"': "every is '0.0 s', needs a positive time",
    'every = "-1 s"': "every is '-1.0 s', needs a positive time",
    'every = "inf s"': "'inf s'",
    'every = "1 m"': "every is '1.0 m', needs a positive time",
    'every = "10 ms"\nphase = "-1 ms"': "phase is '-1.0 ms', needs a time that is not negative",
    'every = "10 ms"\ndelay = "2 s"': "delay is '2.0 s', over 100 times its period",
    'every = "10 ms"\nrate = 3': "key 'rate' is not known",
}


@pytest.mark.parametrize("text", FAULTS)
def test_faults_of_times(text: str) -> None:
    """Assert one message for each."""
    with pytest.raises(xd.ModelError, match=FAULTS[text].replace("(", r"\(")):
        xd.Model.from_text(CART.format(more="").replace('every = "10 ms"', text))


WRONG = {
    ("-k*x - d*v_x", "-k*x - d*x"): "value of 'u'",
    ("-k*x - d*v_x", "-k*x - e*v_x"): "e",
    ('"-15 N"', '"-15 m"'): "minimum of 'u'",
    ('start = "1 N"', 'start = "1 m"'): "start of 'u' is '1.0 m', needs the unit 'N'",
    ("integral + x*every", "integral + x"): "next of 'integral'",
    ("[initial]", '[initial]\nu = "3 N"'): r"'u' is held by a controller: give its first value there, as start",
    ("[initial]", '[states.u]\nunit = "N"\nrate = "1*newton/second"\n[initial]'): "'u' is held by a controller",
    ('x = "u"', 'x = "u + every"'): "every",
    ("outputs = ", "output = "): "output",
}


@pytest.mark.parametrize("change", WRONG)
def test_faults_of_values(change: tuple[str, str]) -> None:
    """Assert that each is named."""
    with pytest.raises(xd.ModelError, match=WRONG[change]):
        xd.Model.from_text(CART.format(more="").replace(*change))


def test_ticks_that_a_run_cannot_have() -> None:
    """Assert that periods longer than the run, and ticks without number, are refused before anything is marched."""
    with pytest.raises(
        xd.InputError, match=r"controller 'pd' acts every 0.01 s from the start, and the run takes 0.005 s"
    ):
        xd.simulate(cart(), method="rk4", step="1 ms", until="5 ms")
    often = xd.Model.from_text(CART.format(more="").replace("10 ms", "1 ns"))
    with pytest.raises(xd.InputError, match="controllers act 2000000001 times in the run, 10000000 at most"):
        xd.simulate(often, method="rk4", step="1 ms", until="2 s")


def test_bounds_are_not_proven_over_ticks() -> None:
    """Assert that proven bounds are refused."""
    with pytest.raises(xd.InputError, match="controller 'pd' changes at its ticks what it holds"):
        xd.enclose(cart(), until="0.1 s")


def held_force(k: float = 32.0, d: float = 8.0, m: float = 2.0, x: float = 0.5, delay: float = 0.0) -> float:
    """Position after thirty ticks: parabolas under forces that hold, limited, from a start at rest."""
    v, held, h = 0.0, 1.0, 0.01
    for _ in range(30):
        new = min(max(-k * x - d * v, -15.0), 15.0)
        for time, force in ((delay, held), (h - delay, new)):
            x, v = x + v * time + force / m * time**2 / 2.0, v + force / m * time
        held = new
    return x


@pytest.mark.parametrize("delay", ["0 ms", "3 ms"])
def test_changes_pass_through_ticks(delay: str) -> None:
    """Assert slopes by gains, a mass and a start, from variational equations, by those of the exact map."""
    sizes = {"k": "32 ± 0.01 N m-1", "d": "8 ± 0.01 N s m-1", "m": "2 ± 0.01 kg"}
    model = cart(f'delay = "{delay}"').replace(parameters=sizes, initial={"x": "0.5 ± 0.01 m"})
    budget = xd.error_budget(model, "x", at="0.3 s", until="0.301 s", method="rk4", step="10 ms")
    for name, value in {"k": 32.0, "d": 8.0, "m": 2.0, "x": 0.5}.items():
        term = budget.isel(term=list(budget.term_name.values).index(name))
        late = float(delay.split(maxsplit=1)[0]) / 1000.0
        more, less = (held_force(**{name: value + step}, delay=late) for step in (1e-5, -1e-5))
        assert float(term.sensitivity) == pytest.approx((more - less) / 2e-5, rel=1e-7)
        assert str(term.term_rule.values).startswith("slope by variational equations")


def test_an_event_at_a_tick_has_no_map_of_changes() -> None:
    """Assert that a budget says so, and takes runs beside it."""
    model = xd.Model.from_text(
        cart().replace(parameters={"k": "32 ± 0.1 N m-1"}).to_toml() + '[events.look]\nevery = "50 ms"\n'
    )
    budget = xd.error_budget(model, "x", at="0.2 s", until="0.21 s", method="rk4", step="10 ms")
    assert "no variational equations: an event is met at the tick at t = 0.05" in " ".join(
        map(str, budget.term_rule.values)
    )


def test_a_gain_is_fitted(tmp_path: Path) -> None:
    """Assert that a gain comes back from positions of the exact motion."""
    times, places = np.arange(31) / 100.0, [float(x) for x, *_ in exact(30)]
    rows = "".join(f"{t!r},{x!r}\n" for t, x in zip(times.tolist(), places, strict=True))
    (tmp_path / "cart.csv").write_text(f"time [s],x [m]\n{rows}")
    start = cart().replace(parameters={"k": "25 N m-1"})
    fitted = xd.fit(start, tmp_path / "cart.csv", ["k"], method="rk4", step="10 ms", until="0.31 s")
    assert float(fitted.estimate[0]) == pytest.approx(32.0, rel=1e-7)


MANY = """
name = "many"
[dimensions]
body = ["left", "right"]
[coordinates]
x = { unit = "m", dims = ["body"] }
[mass]
x = "1*kilogram"
[forces.motor]
x = "u*where(index(body) < 1, 1, -1)"
[controllers.hold]
every = "10 ms"
outputs = { u = { unit = "N", start = "0 N", value = "-3*newton/metre*(x[left] - x[right])" } }
[initial]
x = { value = [1.0, 0.0], unit = "m" }
"""


def test_a_controller_reads_elements() -> None:
    """Assert the exact motion of two bodies that are drawn together, and that a value with a dimension is refused."""
    run = xd.simulate(xd.Model.from_text(MANY), method="rk4", step="10 ms", until="0.5 s")
    far, closing = 1.0, 0.0
    for _ in range(50):
        pull = -6.0 * far
        far, closing = far + 0.01 * closing + 0.5e-4 * pull, closing + 0.01 * pull
    found = run.x.sel(body="left") - run.x.sel(body="right")
    assert float(found[-1]) == pytest.approx(far, abs=1e-13)
    with pytest.raises(xd.ModelError, match="controller 'hold': 'u': .*has the dimension 'body'"):
        xd.Model.from_text(MANY.replace("(x[left] - x[right])", "x"))


RAMP = """
name = "ramp"
[coordinates]
x = "m"
[mass]
x = "2*kilogram"
[forces.motor]
x = "u"
[frictions.table]
slip = "v_x"
kinetic = "4*newton"
static = "6*newton"
[controllers.ramp]
every = "100 ms"
outputs = { u = { unit = "N", start = "0 N", value = "u + 1*newton" } }
[initial]
x = "0 m"
"""


def test_friction_holds_until_a_tick_overcomes_it() -> None:
    """Assert that a block sticks up to the static force, slips from the tick that exceeds it, and its exact motion then.

    It slips from where that is located, as other events are: some 1e-12 s after the tick.
    """
    run = xd.simulate(xd.Model.from_text(RAMP), method="dop853", rtol=1e-10, until="1 s")
    x, v = 0.0, 0.0
    for k in range(10):
        a = (k + 1 - 4) / 2 if k + 1 > 6 else 0.0
        x, v = x + 0.1 * v + 0.005 * a, v + 0.1 * a
    assert float(run.x[-1]) == pytest.approx(x, abs=1e-11)
    assert float(run.v_x[-1]) == pytest.approx(v, abs=1e-11)
    assert not run.v_x.values[run.time.values < 0.6].any()


def test_contacts_of_many_links_are_refused() -> None:
    """Assert that a pile with a controller is refused in words, before anything is marched."""
    pile = xd.Model.from_toml(MODELS / "rough_pile.toml").to_toml()
    held = '[controllers.shaker]\nevery = "10 ms"\noutputs = { u = { unit = "1", start = "0", value = "1 - u" } }\n'
    with pytest.raises(
        xd.InputError, match="has many links, which do not go with controller 'shaker', which acts at times"
    ):
        xd.simulate(xd.Model.from_text(pile + held), until="0.1 s")


def test_a_mirrored_motion_meets_the_other_bound() -> None:
    """Assert the opposite motion from the opposite start, whose force is limited from above."""
    mirrored = cart().replace(initial={"x": "-0.5 m", "u": "-1 N"})
    runs = [xd.simulate(model, method="rk4", step="10 ms", until="0.3 s") for model in (cart(), mirrored)]
    assert runs[1].u.values.max() == 15.0
    for name in ("x", "v_x", "u", "integral"):
        assert np.array_equal(runs[1][name].values, -runs[0][name].values)


def test_what_holds_at_the_start_is_written_again() -> None:
    """Assert that another first value is in the text of the model, and in that which is read from it."""
    changed = cart().replace(initial={"u": "3 N", "integral": "2 m s"})
    again = xd.Model.from_text(changed.to_toml())
    assert again == changed
    assert (again.initial["u"].si, again.initial["integral"].si) == (3.0, 2.0)
    assert again.controllers["pd"].outputs["u"].start.si == 3.0


def test_what_is_not_yet_in_effect_starts_as_its_output() -> None:
    """Assert that a delayed output and what waits for it start alike, alone and in a sweep, and that none is set by itself."""
    model = xd.Model.from_toml(MODELS / "cart_pid.toml")
    changed = model.replace(initial={"u": "3 N"})
    assert changed.initial["u_pending"].si == xd.Model.from_text(changed.to_toml()).initial["u_pending"].si == 3.0
    one = xd.simulate(changed, until="0.1 s")
    many = xd.sweep(model, {"u": ["1 N", "3 N"]}, until="0.1 s")
    assert float(many.end_x.sel(u=3.0)) == float(one.x[-1])
    with pytest.raises(xd.ModelError, match="'u_pending' is computed and in effect later, .* set 'u'"):
        model.replace(initial={"u_pending": "1 N"})
    with pytest.raises(xd.InputError, match="'u_pending' is computed and in effect later, .* set 'u'"):
        xd.sweep(model, {"u_pending": ["1 N"]}, until="0.1 s")


def test_a_tick_is_in_its_own_row_and_in_no_other() -> None:
    """Assert forces of what holds from a tick on, in its row, and that a node which is no tick changes nothing."""
    run = xd.simulate(cart(), method="rk4", step="10 ms", until="0.1 s", nodes=["15 ms", "42 ms"])
    assert np.array_equal(run.force_motor_x.values, run.u.values)
    found, wanted = at_ticks(run, "x", "u", "integral"), np.array(exact(10, one=1.0)).T[[0, 2, 3]]
    assert np.abs(found - wanted).max() < 1e-13


WAVES = (
    "where(mod(t, T) < T/2, 1, 0)",
    "where(mod(t, T) >= T/2, 0, 1)",
    "where(t/T - floor(t/T) < 0.5, 1, 0)",
    "where(sign(mod(t, T) - T/2) < 0, 1, 0)",
)


@pytest.mark.every(3)
@pytest.mark.parametrize("wave", WAVES)
@pytest.mark.parametrize("every", ["2 us", "5 us", "10 us"])
def test_pulses_by_ticks_last_half_of_each_period(every: str, wave: str) -> None:
    """Assert a duty of one half over 500 periods, whose multiples of a tick are no floats."""
    model = xd.Model(
        name="converter",
        parameters={"tau": "1 ms", "T": "20 us"},
        states={"u": {"unit": "1", "rate": "(p - u)/tau"}},
        initial={"u": "0 1"},
        controllers={"pwm": {"every": every, "outputs": {"p": {"unit": "1", "start": "0 1", "value": wave}}}},
    )
    run = xd.simulate(model, method="dormand_prince", rtol=1e-9, until="10 ms")
    duty = np.sum(np.diff(run["time"]) * run["p"].to_numpy()[:-1]) / 10e-3
    assert duty == pytest.approx(0.5, abs=1e-9)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("mod(60e-6, 20e-6)", 0.0),
        ("floor(60e-6/20e-6)", 3.0),
        ("ceil(0.1*3/0.1)", 3.0),
        ("round(0.1*25)", 2.0),
        ("round((1.1 + 1.4)*1)", 2.0),
        ("mod(-60e-6, 20e-6)", 0.0),
        ("mod(70e-6, 20e-6)", 10e-6),
        ("floor(2.9999)", 2.0),
        ("where(mod(30e-6, 20e-6) < 10e-6, 1, 0)", 0.0),
        ("where(mod(30e-6, 20e-6) == 10e-6, 1, 0)", 1.0),
        ("where(mod(30e-6, 20e-6) <= 10e-6, 1, 0)", 1.0),
        ("where(mod(30e-6, 20e-6) > 10e-6, 1, 0)", 0.0),
        ("where(mod(30e-6, 20e-6) != 10e-6, 1, 0)", 0.0),
    ],
)
def test_numbers_that_are_nearly_whole_are_whole(text: str, value: float) -> None:
    """Assert values beside whole numbers, and halves that go to the even one."""
    assert evaluate(with_whole_numbers(parse(text)), {}) == pytest.approx(value, rel=1e-12, abs=1e-18)


@pytest.mark.parametrize("text", ["x < 1", "a*x**2 - b", "where(x < 1, sign(x), max(x, 2))"])
def test_expressions_that_count_nothing_stay(text: str) -> None:
    """Assert the same tree where no whole numbers are asked for."""
    tree = parse(text) if "<" not in text or "where" in text else parse(f"where({text}, 1, 0)")
    assert with_whole_numbers(tree) == tree


def test_periodic_resets_count_alike() -> None:
    """Assert that a reset every 20 us sets what a whole multiple of it gives."""
    model = xd.Model(
        name="counter",
        parameters={"T": "20 us"},
        states={"n": {"unit": "1", "rate": "0/second"}},
        initial={"n": "0 1"},
        events={"tick": {"every": "20 us", "action": "reset", "set": {"n": "floor(t/T)"}}},
    )
    run = xd.simulate(model, method="rk4", step="10 us", until="2 ms")
    after = run["n"].to_numpy()[run["event_row_after"].to_numpy()]
    assert after.tolist() == np.round(run["event_time"].to_numpy() / 20e-6).tolist()

"""Switches hidden in forces: located, stepped to, and each step on one side of them.

Switches inside a `where`: located where its side holds, and nowhere else; the side of each at every row.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.contacts import FITTING, asked, words
from cases.problems import MODELS, particle
from cases.verdicts import verified
from xdynamics.model.switches import switches


def pushed(force: str, x: str = "1 m", v: str = "0 m s-1", **more: Any) -> xd.Model:
    """A mass on a line."""
    return particle(
        name="pushed",
        parameters={"m": "1 kg", "f": "1 N", "k": "4 N m-1", "a": "0.5 m"},
        forces={"relay": {"x": force} | more},
        initial={"x": x, "v_x": v},
    )


@pytest.mark.every(3)
@pytest.mark.parametrize("method", FITTING)
def test_a_relay_is_exact_for_every_method(method: str) -> None:
    """Assert the times at which x'' = -sign(x) switches, and the energy: parabolas are exact, but across a switch none is."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "relay_oscillator.toml"), until=30.0, **asked(method, step=0.31))
    assert words(run) == [("relay.sign", "regime_switch")] * 11
    assert run.event_time.values == pytest.approx(math.sqrt(2) * (1 + 2 * np.arange(11)), abs=5e-11)
    assert run.total_energy.values == pytest.approx(1.0, abs=1e-11)
    before, after = (run.a_x.values[run[f"event_row_{side}"].values] for side in ("before", "after"))
    assert np.array_equal(before, -after)
    assert run.attrs["solver_switches"] == "located"


def test_stepped_over_they_cost_the_order() -> None:
    """Assert what a run is without: no event, and an energy that is lost."""
    model = xd.Model.from_toml(MODELS / "relay_oscillator.toml")
    run = xd.simulate(model, method="rk4", step=0.31, until=30.0, switches="stepped over")
    assert run.sizes["event"] == 0
    assert np.ptp(run.total_energy.values) > 1e-2
    assert run.attrs["solver_switches"] == "stepped over"
    smooth = pushed("-f*sign(x)", smooth=True)
    assert xd.Model.from_text(smooth.to_toml()) == smooth
    run = xd.simulate(smooth, method="rk4", step=0.31, until=30.0)
    assert run.sizes["event"] == 0
    assert "solver_switches" not in run.attrs


@pytest.mark.parametrize(
    ("force", "x"), [("-f*sign(x - a)", "0.5 m"), ("-f*sign(x) - f/10", "0 m"), ("where(x > a, -f, 2*f)", "0.5 m")]
)
def test_rest_on_a_jump_is_told_from_a_motion_that_is_long(force: str, x: str) -> None:
    """Assert that what rests on a jump is held there, and what swings by a millimetre goes on."""
    run = xd.simulate(pushed(force, x), method="dop853", rtol=1e-8, until=100.0, max_steps=200)
    assert run.attrs["run_outcome"] == "completed"
    assert (run.x == run.x[0]).all()
    run = xd.simulate(pushed(force, x), method="dop853", rtol=1e-8, until=100.0, max_steps=200, sliding="ends")
    at_zero = x == "0 m"  # elsewhere rounding of the position keeps passages apart
    assert run.attrs["run_outcome"] == ("sliding_mode" if at_zero else "step_limit")
    assert "'relay' switches where " in run.attrs["run_outcome_text"]
    back = "either side drives the motion back: it " + ("slides along the switch" if at_zero else "rests there")
    assert back in run.attrs["run_outcome_text"]
    assert at_zero or "write dry friction as [frictions]" in run.attrs["run_outcome_text"]
    run = xd.simulate(pushed("-f*sign(x)", "1 mm"), method="dop853", rtol=1e-8, until=100.0, max_steps=200)
    assert "raise max_steps" in run.attrs["run_outcome_text"]
    assert "rests" not in run.attrs["run_outcome_text"]


@pytest.mark.parametrize(
    ("force", "names"),
    [
        ("-k*x - k*min(x + a, 0*metre)", ["relay.min"]),
        ("-k*x + k*max(0*metre, -x - a)", ["relay.max"]),
        ("-k*x - where(x < -a, k*(x + a), 0*newton)", ["relay.where"]),
        ("-k*x - k/2*(x + a - abs(x + a))", ["relay.abs"]),
    ],
)
def test_a_spring_with_a_stop_is_two_springs(force: str, names: list[str]) -> None:
    """Assert the period of an oscillator that is twice as stiff on one side, however that is written, at the method's order."""
    model = pushed(force)
    assert [switche.name for switche in switches(model)] == names
    # k = 4 on the right of -a; 8 about -a/2 on the left of it
    inner = math.pi - math.acos(0.5)  # of the phase, from x = 1 to -a
    speed = 2 * math.sqrt(1 - 0.25)
    swing = math.atan2(speed / math.sqrt(8), 0.25)
    period = 2 * ((math.pi - math.acos(0.5)) / 2 + swing / math.sqrt(8))
    assert inner / 2 < period
    model = xd.Model(**table_of(model), events={"turn": {"function": "v_x", "direction": "falling"}})
    run = xd.simulate(model, method="dop853", rtol=1e-11, atol=1e-11, until=2.05 * period)
    found = [t for t, (name, _) in zip(run.event_time.values, words(run), strict=True) if name == "turn"]
    assert found == pytest.approx([period, 2 * period], abs=1e-9)
    assert words(run).count((names[0], "regime_switch")) == 4


def table_of(model: xd.Model) -> dict[str, Any]:
    """The sections of a model."""
    import tomllib

    return tomllib.loads(model.to_toml())


def test_sliding_on_a_switch_is_an_outcome() -> None:
    """Assert the time at which x' = -sign(x) comes to zero, and friction written as a sign stops, with the remedy."""
    relay = xd.Model(name="relay", states={"x": {"unit": "m", "rate": "-sign(x)*metre/second"}}, initial={"x": "1.5 m"})
    run = xd.simulate(relay, method="rk4", step=0.4, until=5.0, sliding="ends")
    assert (run.attrs["run_outcome"], float(run.event_time[0])) == ("sliding_mode", pytest.approx(1.5, abs=1e-12))
    assert abs(float(run.x[-1])) < 1e-11
    braked = pushed("-f*sign(v_x)", v="2 m s-1")
    run = xd.simulate(braked, method="rk4", step=0.3, until=5.0, sliding="ends")
    assert float(run.time[-1]) == pytest.approx(2.0, abs=1e-12)
    assert "'relay' switches where v_x = 0" in run.attrs["run_outcome_text"]
    assert "[frictions]" in run.attrs["run_outcome_text"]


def test_a_start_at_a_switch_is_on_the_side_it_moves_to() -> None:
    """Assert the first half swing from x = 0, either way, without an event at the start."""
    for v in (1.0, -1.0):
        run = xd.simulate(pushed("-f*sign(x)", x="0 m", v=f"{v} m s-1"), method="rk4", step=0.3, until=3.0)
        assert run.event_time.values == pytest.approx([2.0], abs=1e-12)
        assert float(run.a_x[0]) == -v


def test_switches_and_contacts_keep_apart() -> None:
    """Assert a ball under a relay that bounces on a floor: both kinds of event, each at its time."""
    model = xd.Model(
        name="both",
        coordinates={"y": "m"},
        parameters={"m": "1 kg", "f": "2 N"},
        mass={"y": "m"},
        forces={"relay": {"y": "-f*sign(y - 0.5*metre)"}},
        initial={"y": "1.5 m", "v_y": "0 m s-1"},
        contacts={"floor": {"gap": "y", "restitution": 1}},
    )
    run = xd.simulate(model, method="rk4", step=0.3, until=2.0)
    # down 1 m at 2 m s-2, half a metre at -2 m s-2 to the floor with sqrt(2) m s-1, and back the same way
    crossed, hit = 1.0, 1.0 + (2 - math.sqrt(2)) / 2
    assert words(run) == [("relay.sign", "regime_switch"), ("floor", "impact"), ("relay.sign", "regime_switch")]
    assert run.event_time.values == pytest.approx([crossed, hit, 2 * hit - crossed], abs=1e-11)


def test_sides_are_those_of_the_run_everywhere(tmp_path: Any) -> None:
    """Assert samples between steps, an extension, and the archive marched again."""
    model = xd.Model.from_toml(MODELS / "relay_oscillator.toml")
    run = xd.simulate(model, method="rk4", step=0.7, until=12.0, nodes=["5 s"])
    times = np.linspace(0.05, 11.9, 60)
    u = (times + math.sqrt(2)) % (4 * math.sqrt(2)) - math.sqrt(2)  # from the start of a positive half swing
    exact = np.where(u < math.sqrt(2), 1 - u**2 / 2, -1 + (u - 2 * math.sqrt(2)) ** 2 / 2)
    assert xd.sample(run, times).x.values == pytest.approx(exact, abs=1e-10)
    part = xd.extend(xd.simulate(model, method="rk4", step=0.7, until=5.0), until=12.0)
    assert xd.content_digest(part) == xd.content_digest(run)
    xd.save(run, tmp_path / "relay.nc")
    assert xd.reproduce(tmp_path / "relay.nc").attrs["identical"] == 1


def test_wrong_settings_are_named() -> None:
    """Assert errors for what is neither a truth nor a word."""
    with pytest.raises(xd.ModelError, match="force 'relay': smooth is 'yes', needs true or false"):
        pushed("-f*sign(x)", smooth="yes")
    with pytest.raises(xd.InputError, match="switches is 'some'; there are 'located', 'landed on', 'stepped over'"):
        xd.simulate(pushed("-f*sign(x)"), method="rk4", step=0.1, until=1.0, switches="some")


def test_too_many_are_stepped_over() -> None:
    """Assert that a model with more than forty marches without them, and says so with the force and how many."""
    force = " - ".join(f"k*abs(x - {i}*metre)" for i in range(41))
    with pytest.warns(xd.AccuracyWarning, match=r"41 switches are hidden in 'relay' \(abs"):
        run = xd.simulate(pushed(f"-({force})"), method="rk4", step=0.1, until=1.0)
    assert "40 at most are located: all were stepped over" in run.attrs["run_outcome_text"]
    assert "solver_switches" not in run.attrs


LANDING = "where(y < 0*metre, max(0*newton, -k*y - c*v_y), 0*newton)"


def ball(force: str = LANDING, **more: Any) -> xd.Model:
    """A ball that falls onto an elastic floor."""
    return xd.Model(
        name="ball",
        coordinates={"y": "m"},
        parameters={"m": "1 kg", "g": "9.81 m s-2", "k": "400 N m-1", "c": "3 kg s-1"},
        mass={"y": "m"},
        forces={"gravity": {"potential": "m*g*y"}, "floor": {"y": force} | more},
        initial={"y": "1 m", "v_y": "0 m s-1"},
    )


def test_nothing_is_met_in_free_flight() -> None:
    """Assert that a floor's `max` is passed below it alone: where it lets go, and never in the air."""
    run = xd.simulate(ball(), method="dop853", rtol=1e-9, until=3.0)
    heights = run.y.values[run.event_row_before.values]
    found = dict.fromkeys(words(run))
    assert [*found] == [("floor.where", "regime_switch"), ("floor.max", "regime_switch")]
    assert all(height < 1e-9 for height, (name, _) in zip(heights, words(run), strict=True) if name == "floor.max")
    everywhere = xd.simulate(ball(), method="dop853", rtol=1e-9, until=3.0, switches="located everywhere")
    assert run.sizes["event"] < everywhere.sizes["event"]
    assert everywhere.y.values[everywhere.event_row_before.values].max() > 0.01


def test_both_ways_of_looking_are_reproduced(tmp_path: Path) -> None:
    """Assert that archives say where switches were looked for; those that do not, of version 0.2, mean everywhere."""
    from xdynamics.evidence.comparing.bits import compare_reproduction
    from xdynamics.record.arguments import recorded_arguments

    for looked_for, said in (("located", "where the side"), ("located everywhere", "everywhere")):
        run = xd.simulate(ball(), method="rk4", step=0.01, until=2.0, switches=looked_for)
        assert run.attrs["solver_switches"] == "located"
        assert run.attrs["solver_switches_watched"].startswith(said)
        path = xd.save(run, tmp_path / "ball.nc")
        assert xd.reproduce(path).attrs["identical"] == 1
    old = run.drop_vars([name for name in run.variables if str(name).startswith("side_")])
    old = old.assign_attrs(schema_version="1")
    del old.attrs["solver_switches_watched"]
    again = xd.simulate(ball(), **recorded_arguments(old))
    assert compare_reproduction(old, again).attrs["identical"] == 1


FORCES = (  # continuous everywhere, so that no motion is held at a switch
    "where({0} < {1}, max({2}*({0} - {1}), {3}*({0} - {1})), {4}*abs({0} - {1}))",
    "where({0} > {1}, where({0} > {1} + 0.3, {2}*0.3 + max(0, {0} - {1} - 0.3, 2*({0} - {1} - 0.5)), {2}*({0} - {1})), min({3}*({0} - {1}), {4}*({0} - {1}), 0))",
    "where({0} >= {1}, {2}*({0} - {1}), where({0} <= {1} - 0.4, -{3}*0.4 - abs({0} - {1} + 0.4)*abs(v), {3}*({0} - {1})))",
    "{2}*abs(x - {1})*where(x < {1}, min({3}, abs(v)), where(v > 0, {4}, 0.5))",
)


def random_model(case: int) -> xd.Model:
    """An oscillator, driven, with a force of nested choices."""
    rng = np.random.default_rng(case)
    numbers = [f"{rng.uniform(-0.5, 0.5):.3f}", *(f"{rng.uniform(0.2, 2.0):.3f}" for _ in range(3))]
    force = FORCES[case % len(FORCES)].format(*("x", "v")[:1], *numbers)
    rate = f"(-x - 0.2*v + {rng.uniform(0.5, 1.5):.3f}*sin({rng.uniform(0.5, 2):.3f}*t*1) - ({force}))"
    return xd.Model(
        name="choices",
        time={"unit": "1"},
        states={"x": {"unit": "1", "rate": "v"}, "v": {"unit": "1", "rate": rate}},
        initial={"x": f"{rng.normal():.3f}", "v": f"{rng.normal():.3f}"},
    )


def function_of(run: Any, name: str, at: Any) -> np.ndarray:
    """The function of a switch, by the attribute of its side, at states."""
    scope = {
        "where": np.where,
        "abs": np.abs,
        "max": lambda *a: np.maximum.reduce(np.broadcast_arrays(*a)),
        "min": lambda *a: np.minimum.reduce(np.broadcast_arrays(*a)),
        "sin": np.sin,
    }
    return np.broadcast_to(eval(run[name].attrs["function"], scope, at), at["x"].shape)


@pytest.mark.cases(200)
def test_random_choices(case: int) -> None:
    """Assert that nested switches are met where they decide alone, that none is missed there, and every row's sides."""
    from xdynamics.expressions import text_of
    from xdynamics.model.switches import switches

    model = random_model(case)
    run = xd.simulate(
        model, method=("dop853", "rk4")[case % 2], **({"rtol": 1e-8} if case % 2 == 0 else {"step": 0.02}), until=12.0
    )
    assert run.attrs["run_outcome"] in ("completed", "sliding_mode")  # a jump may hold the motion
    rows = {name: run[name].values for name in ("x", "v")} | {"t": run.time.values}
    dense = xd.sample(run, np.linspace(0, float(run.time[-1]), 4001))
    fine = {"x": dense.x.values, "v": dense.v.values, "t": dense.at_time.values}
    met = [name for name, _ in words(run)]
    for switche in switches(model):
        name = f"side_{switche.name.replace('.', '_')}"
        decides = {}
        for which, at in (("rows", rows), ("fine", fine)):
            holds = np.zeros(at["x"].shape, bool)
            for path in switche.paths:
                along = np.ones(at["x"].shape, bool)
                for condition, wanted in path:
                    left, right = (
                        np.broadcast_to(eval(text_of(part), {}, at), holds.shape)
                        for part in (condition.left, condition.right)
                    )
                    along &= ((left < right) if condition.operator[0] == "<" else (left > right)) == wanted
                holds |= along
            decides[which] = holds
        side, value = run[name].values, function_of(run, name, rows)
        clear = np.abs(value) > 1e-9  # at a zero the row before an event is on the side it came from
        conditions = [
            np.abs(eval(f"({text_of(c.left)}) - ({text_of(c.right)})", {}, rows)) > 1e-9
            for path in switche.paths
            for c, _ in path
        ]
        known = (
            np.logical_and.reduce([np.broadcast_to(each, clear.shape) for each in conditions])
            if conditions
            else np.ones_like(clear)
        )
        assert (side[known & clear] == np.where(decides["rows"], np.sign(value), 0)[known & clear]).all()
        crossed = np.diff(np.sign(function_of(run, name, fine))) != 0
        inside = decides["fine"][1:] & decides["fine"][:-1] & crossed
        events = run.event_time.values[[k for k, each in enumerate(met) if each == switche.name]]
        for k in np.flatnonzero(inside):  # a choice may have ended and begun between two samples
            assert np.any((events >= fine["t"][k] - 1e-9) & (events <= fine["t"][k + 1] + 1e-9)), switche.name
        before = run.event_row_before.values[[k for k, each in enumerate(met) if each == switche.name]]
        assert (side[before] != 0).all()


def test_conditions_that_stand_still_and_tables(tmp_path: Path) -> None:
    """Assert a `where` about parameters alone, and the piece of a table at every row against a search in its points."""
    force = "where(k < c*1*newton/metre/(kilogram/second), abs(y)*k, abs(v_y)*c)"
    run = xd.simulate(ball(force), method="rk4", step=0.01, until=1.0)
    assert set(run.side_floor_abs.values) == {0}
    assert set(run.side_floor_abs_2.values) == {-1}
    points = "\n".join(f"{x},{np.sin(3 * x):.4f}" for x in np.linspace(-1, 1.5, 300))
    model = particle(
        name="spring",
        parameters={"m": "1 kg"},
        forces={"spring": {"x": "-pull - 3*x*newton/metre"}},
        drives={
            "pull": {
                "csv": f"x [m],F [N]\n{points}\n",
                "table": "p.csv",
                "argument": "x",
                "interpolation": "linear",
                "outside": "hold",
            }
        },
        initial={"x": "0.8 m", "v_x": "0 m s-1"},
    )
    run = xd.simulate(model, method="rk4", step=0.01, until=3.0)
    inner = ~np.isin(run.row_kind.values, [2, 3, 4])
    assert (run.side_spring_pull.values == np.searchsorted(np.linspace(-1, 1.5, 300), run.x.values, "right"))[
        inner
    ].all()
    assert run.side_spring_pull.values.max() > 128
    assert verified(xd.save(run, tmp_path / "spring.nc"))


def test_many_runs_have_the_same_bits() -> None:
    """Assert that runs in lanes meet nested switches as a run alone does."""
    from xdynamics.march.configuration import settings_for
    from xdynamics.march.ensemble import march_many

    settings, starts = settings_for(ball(), method="dop853", rtol=1e-8, until=2.0), np.linspace(0.2, 2.0, 24)
    alone, beside = (march_many(ball(), settings, initial={"y": starts}, lanes=lanes) for lanes in (1, 8))
    assert alone.events.tobytes() == beside.events.tobytes()
    assert np.array_equal(alone.state, beside.state)

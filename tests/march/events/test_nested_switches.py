"""Switches inside a `where`: located where its side holds, and nowhere else; the side of each at every row."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.contacts import words
from cases.verdicts import verified

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

    for switches, said in (("located", "where the side"), ("located everywhere", "everywhere")):
        run = xd.simulate(ball(), method="rk4", step=0.01, until=2.0, switches=switches)
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
    model = xd.Model(
        name="spring",
        coordinates={"x": "m"},
        parameters={"m": "1 kg"},
        mass={"x": "m"},
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

"""Tables of a coordinate or velocity as switches: their points are located and stepped to, and each step keeps to one piece."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.contacts import FITTING, asked, words
from xdynamics.model.switches import MOST_SWITCHES, switches
from xdynamics.record.flag_words import words_of_flag

STIFFER = [(-2, 4), (-1, 1), (0, 0), (1, -1), (2, -4)]  # a spring of 1 N/m, beyond a metre of 3 N/m
RELAY = [(-3, 1), (0, -1), (3, -1)]
# from 1.8 m: about 2/3 m with sqrt(3) /s until 1 m, then about 0 with 1 /s
PERIOD = 4 * math.acos((1 - 2 / 3) / (1.8 - 2 / 3)) / math.sqrt(3) + 4 * math.asin(
    1 / math.hypot(1, math.sqrt(3) * math.sqrt((1.8 - 2 / 3) ** 2 - (1 - 2 / 3) ** 2))
)


def measured(
    folder: Path,
    rows: list[tuple[float, float]] = STIFFER,
    x: str = "1.8 m",
    v: str = "0 m s-1",
    force: str = "force",
    smooth: bool = False,
    **drive: Any,
) -> xd.Model:
    """A mass on a line, by a table."""
    drive = {"argument": "x", "interpolation": "linear", "outside": "error"} | drive
    unit = "m" if drive["argument"] == "x" else "m s-1"
    (folder / "force.csv").write_text(f"x [{unit}],force [N]\n" + "".join(f"{a!r},{b!r}\n" for a, b in rows))
    text = f'''name = "measured"
coordinates.x = "m"
parameters.m = "1 kg"
mass.x = "m"
forces.spring = {{ x = "{force}"{", smooth = true" if smooth else ""} }}
initial = {{ x = "{x}", v_x = "{v}" }}
[drives.force]
table = "force.csv"
''' + "".join(f'{key} = "{value}"\n' for key, value in drive.items())
    (folder / "model.toml").write_text(text)
    return xd.Model.from_toml(folder / "model.toml")


@pytest.mark.every(3)
@pytest.mark.parametrize("method", FITTING)
def test_every_method_keeps_its_order_over_a_bent_spring(method: str, tmp_path: Path) -> None:
    """Assert that errors after three periods fall as the method says, or are as small as is asked for."""
    model, order, ends = measured(tmp_path), xd.METHODS[method].order, []
    for step in (0.1, 0.0125):
        run = xd.simulate(model, until=3 * PERIOD, **asked(method, step=step))
        assert words(run) == [("spring.force", "regime_switch")] * 18
        ends.append(math.hypot(float(run.x[-1]) - 1.8, float(run.v_x[-1])))
    assert ends[1] < (1e-7 if order >= 5 else ends[0] / 8 ** (order - 0.7))


@pytest.mark.dear
def test_stepped_over_it_costs_the_order(tmp_path: Path) -> None:
    """Assert what a run is without, of a force that is declared smooth, and how much it is off."""
    bent, smooth = measured(tmp_path), measured(tmp_path, smooth=True)
    over = xd.simulate(bent, method="kahan_li8", step=0.1, until=3 * PERIOD, switches="stepped over")
    without = xd.simulate(smooth, method="kahan_li8", step=0.1, until=3 * PERIOD)
    located = xd.simulate(bent, method="kahan_li8", step=0.1, until=3 * PERIOD)
    assert over.sizes["event"] == without.sizes["event"] == 0
    assert np.array_equal(over.x, without.x)
    assert abs(float(over.v_x[-1])) > 1e-3
    assert abs(float(located.v_x[-1])) < 1e-10


def test_the_table_of_a_relay_is_exact(tmp_path: Path) -> None:
    """Assert the switches of x'' = -sign x, given as a table that jumps."""
    run = xd.simulate(measured(tmp_path, RELAY, x="1 m", interpolation="previous"), method="rk4", step=0.3, until=20.0)
    assert run.event_time.values == pytest.approx(math.sqrt(2) * (1 + 2 * np.arange(7)), abs=2e-11)
    before, after = (run.a_x.values[run[f"event_row_{side}"].values] for side in ("before", "after"))
    assert np.array_equal(before, -after)
    assert set(np.abs(before)) == {1.0}


def test_a_motion_along_a_jump_is_an_outcome(tmp_path: Path) -> None:
    """Assert that friction as a table of the velocity ends with its name, where it would slide."""
    model = measured(tmp_path, RELAY, x="0 m", v="1 m s-1", argument="v_x", interpolation="previous")
    run = xd.simulate(model, method="rk4", step=0.3, until=3.0)
    assert run.attrs["run_outcome"] == "sliding_mode"
    assert "'spring' jumps at v_x = " in run.attrs["run_outcome_text"]
    assert "a point of the table 'force.csv'" in run.attrs["run_outcome_text"]
    assert float(run.time[-1]) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize(
    ("x", "v", "times"),
    [
        ("1 m", "1 m s-1", [1.2091995761561452]),  # 2*atan(sqrt(3))/sqrt(3): out and back
        ("1 m", "-1 m s-1", [math.pi / 4, math.pi / 2]),
        ("1 m", "0 m s-1", [math.pi / 2]),  # turns there
        ("0 m", "0 m s-1", []),  # stays there
        ("0 m", "-0.5 m s-1", [math.pi]),
    ],
)
def test_it_starts_on_a_point(x: str, v: str, times: list[float], tmp_path: Path) -> None:
    """Assert that what a march starts on is no event, and that it goes the way it moves."""
    run = xd.simulate(measured(tmp_path, x=x, v=v), method="dop853", rtol=1e-11, atol=1e-13, until=3.2)
    assert run.event_time.values[: len(times)] == pytest.approx(times, abs=1e-9)
    assert float(run.event_time.values[0] if run.sizes["event"] else 1.0) > 1e-3


@pytest.mark.parametrize("interpolation", ["linear", "previous"])
@pytest.mark.parametrize(
    ("outside", "outcome"), [("error", "outside_drive_table"), ("hold", "completed"), ("zero", "completed")]
)
def test_it_leaves_the_table(interpolation: str, outside: str, outcome: str, tmp_path: Path) -> None:
    """Assert what was so without switches: a table ends where it ends, or holds, or is nothing."""
    model = measured(tmp_path, x="0 m", v="4 m s-1", interpolation=interpolation, outside=outside)
    run = xd.simulate(model, method="dop853", rtol=1e-9, until=1.0)
    assert run.attrs["run_outcome"] == outcome
    past = run.x.values > 2.0 + 1e-9
    assert past.any() == (outside != "error")
    force = {"hold": -4.0, "zero": 0.0, "error": 0.0}[outside]
    assert set(run.force_spring_x.values[past]) <= {force}
    assert set(words(run)) == {("spring.force", "regime_switch")}


@pytest.mark.parametrize("outside", ["hold", "zero"])
def test_it_starts_on_the_end_and_moves_out(outside: str, tmp_path: Path) -> None:
    """Assert the force beyond a table from its very last point on, and no event but that of coming back."""
    run = xd.simulate(measured(tmp_path, x="2 m", v="1 m s-1", outside=outside), method="rk4", step=0.1, until=0.6)
    assert float(run.force_spring_x[0]) == (-4.0 if outside == "hold" else 0.0)
    assert run.event_time.values == pytest.approx([0.5] if outside == "hold" else [], abs=1e-12)


def test_it_comes_in_from_outside(tmp_path: Path) -> None:
    """Assert the first point that a motion from beyond the table meets, with a held force until there."""
    run = xd.simulate(measured(tmp_path, x="3 m", v="-1 m s-1", outside="hold"), method="rk4", step=0.1, until=1.0)
    assert float(run.event_time[0]) == pytest.approx((math.sqrt(1 + 8) - 1) / 4, abs=1e-12)
    assert float(run.x[int(run.event_row_before[0])]) == pytest.approx(2.0, abs=1e-12)


@pytest.mark.parametrize("outside", ["hold", "zero"])
def test_a_value_at_a_point_alone_is_one_event(outside: str, tmp_path: Path) -> None:
    """Assert one switch out of a table of steps and one into it, however near to the last point the motion is located."""
    table = {"interpolation": "previous", "outside": outside}
    for k in range(8):
        out = measured(tmp_path, x="0 m", v=f"{2.6 + 0.37 * k!r} m s-1", **table)
        run = xd.simulate(out, method="dop853", rtol=1e-9, until=0.9)
        assert words(run) == [("spring.force", "regime_switch")] * 2
        into = measured(tmp_path, x="2.2 m", v=f"{-1.1 - 0.37 * k!r} m s-1", **table)
        run = xd.simulate(into, method="dop853", rtol=1e-9, until=0.2)
        assert words(run) == [("spring.force", "regime_switch")]


def test_the_state_between_steps_is_that_of_its_piece(tmp_path: Path) -> None:
    """Assert that a sample is as exact as the steps, right up to a point on either side of it."""
    run = xd.simulate(measured(tmp_path), method="rk4", step=0.02, until=4.0)
    times = np.sort(np.concatenate([run.event_time - 1e-6, run.event_time + 1e-6, np.linspace(0, 4, 400)]))
    fine = xd.simulate(measured(tmp_path), method="dop853", rtol=1e-12, atol=1e-14, until=4.0)
    found, true = (xd.sample(one, times).x for one in (run, fine))
    assert np.abs(found - true).max() < 2e-7
    over = xd.simulate(measured(tmp_path), method="rk4", step=0.1, until=4.0, switches="stepped over")
    assert np.array_equal(xd.sample(over, over.time.values[5:9]).x, over.x[5:9])
    assert float(xd.sample(over, times).error_x.max()) < 1e-3


WILD = [(-3, 1), (-1, 1), (0, 0), (1, -3), (2, 4), (3, -1)]


@pytest.mark.parametrize(("x", "v"), [("2.5*metre", "-1 m s-1"), ("-2*metre", "0.3 m s-1"), ("9*metre", "-1 m s-1")])
def test_a_reset_beyond_several_points_enters_the_piece_there(x: str, v: str, tmp_path: Path) -> None:
    """Assert force and motion behind a jump of the state over points of the table."""
    table = measured(tmp_path, WILD, x="-0.5 m", v="0.2 m s-1", outside="hold").to_toml()
    speed = v.replace(" m s-1", "*metre/second")
    text = f'{table}\n[events.lift]\nfunction = "t - 0.5*second"\naction = "reset"\nset = {{ x = "{x}", v_x = "{speed}" }}\n'
    run = xd.simulate(xd.Model.from_text(text), method="rk4", step=0.01, until=0.9)
    over = xd.simulate(xd.Model.from_text(text), method="rk4", step=1e-4, until=0.9, switches="stepped over")
    row = int(run.event_row_after[words(run).index(("lift", "reset"))])
    force = np.interp(float(run.x[row]), *np.array(WILD, float).T)
    assert float(run.force_spring_x[row]) == pytest.approx(force, rel=1e-12)
    assert float(run.x[-1]) == pytest.approx(float(over.x[-1]), abs=1e-6)


def test_an_impact_beyond_points_of_a_table_of_the_velocity(tmp_path: Path) -> None:
    """Assert the drag behind a bounce that turns the velocity through several points."""
    table = measured(
        tmp_path, [(-9, 20), (-1, 3), (0, 0), (1, -6), (9, -8)], x="1 m", argument="v_x", force="force - 9.81*newton"
    ).to_toml()
    text = table + '\n[contacts.floor]\ngap = "x"\nrestitution = 0.8\n'
    run = xd.simulate(xd.Model.from_text(text), method="rk4", step=0.005, until=1.0)
    over = xd.simulate(xd.Model.from_text(text), method="rk4", step=1e-4, until=1.0, switches="stepped over")
    assert float(run.x[-1]) == pytest.approx(float(over.x[-1]), abs=1e-5)


@pytest.mark.parametrize(("x", "v"), [("0.49 m", "0.7 m s-1"), ("0.5 m", "0.7 m s-1"), ("-2 m", "-0.5 m s-1")])
def test_fixed_steps_end_with_their_table(x: str, v: str, tmp_path: Path) -> None:
    """Assert that a run which leaves a table that is an error beyond its end is over there, in few rows."""
    model = measured(tmp_path, [(-2, 1.84), (0.5, -0.22)], x=x, v=v)
    run = xd.simulate(model, method="rk4", step=0.05, until=3.0)
    assert run.attrs["run_outcome"] == "outside_drive_table"
    assert run.sizes["step"] < 100


@pytest.mark.parametrize(
    ("rows", "x", "v"),
    [
        ([(-2, -1), (1, 1), (3, 1)], "0 m", "2 m s-1"),
        ([(-2, -1), (1, 1), (3, 1)], "1 m", "-2 m s-1"),
        ([(-1, 1), (0, -1)], "-0.5 m", "1 m s-1"),
    ],
)
def test_sides_are_told_of_the_piece_behind_a_jump(
    rows: list[tuple[float, float]], x: str, v: str, tmp_path: Path
) -> None:
    """Assert abs of a table that jumps through zero, and a table whose last point is 0, against tiny steps over all of it."""
    model = measured(tmp_path, rows, x=x, v=v, interpolation="previous", outside="hold", force="abs(force)")
    run = xd.simulate(model, method="rk4", step=0.05, until=0.8)
    over = xd.simulate(model, method="rk4", step=1e-4, until=0.8, switches="stepped over")
    assert run.attrs["run_outcome"] == "completed"
    assert (run.force_spring_x.values >= 0.0).all()
    assert float(run.x[-1]) == pytest.approx(float(over.x[-1]), abs=1e-3)


def test_a_table_that_is_nothing_beyond_its_end_jumps_there(tmp_path: Path) -> None:
    """Assert that a motion which is driven back to that end is a sliding mode, and no endless run."""
    model = measured(
        tmp_path,
        [(-1.5, -0.99), (2, -1.15)],
        x="-1.5 m",
        v="0.3 m s-1",
        argument="v_x",
        outside="zero",
        force="force - 2.5*newton/metre*x",
    )
    run = xd.simulate(model, method="dop853", rtol=1e-8, until=6.0)
    assert run.attrs["run_outcome"] == "sliding_mode"


def test_any_units_give_the_same_bits(tmp_path: Path) -> None:
    """Assert that scales of powers of two change nothing."""
    runs = [
        xd.simulate(measured(tmp_path), method="rk4", step=0.125, until=4.0, scales=scales)
        for scales in (None, {"length": "0.0078125 m", "time": "1024 s"})
    ]
    assert np.array_equal(runs[0].event_time, runs[1].event_time)
    assert np.array_equal(runs[0].x, runs[1].x)


def test_it_goes_on_and_is_reproduced(tmp_path: Path) -> None:
    """Assert the same bits from the file alone, and of a run that went on from its end."""
    model = measured(tmp_path)
    run = xd.simulate(model, method="dop853", rtol=1e-9, until=4.0)
    xd.save(run, tmp_path / "run.nc")
    assert xd.reproduce(tmp_path / "run.nc").attrs["identical"] == 1
    longer = xd.extend(run, until=8.0)
    whole = xd.simulate(model, method="dop853", rtol=1e-9, until=8.0, nodes=[4.0])
    assert np.array_equal(longer.x, whole.x)
    assert longer.sizes["event"] == whole.sizes["event"]


def test_which_tables_are_switches(tmp_path: Path) -> None:
    """Assert names, once for a table however often it is read, and none for smooth interpolations and for time."""
    assert [switche.name for switche in switches(measured(tmp_path, force="force + force*abs(x)/metre"))] == [
        "spring.force",
        "spring.abs",
    ]
    for interpolation in ("pchip", "cubic"):
        assert switches(measured(tmp_path, interpolation=interpolation)) == ()
    assert len(switches(measured(tmp_path))) < MOST_SWITCHES


def test_kinks_of_long_tables_are_landed_on_and_counted(tmp_path: Path) -> None:
    """Assert that a bent spring of 201 points has the motion of located points, bit for bit, and not one event."""
    rows = [(x / 10, -((x / 10) ** 3)) for x in range(-100, 101)]
    model = measured(tmp_path, rows)
    landed, located = (
        xd.simulate(model, method="rk4", step=0.05, until=3.0, switches=word) for word in (None, "located")
    )
    assert (landed.sizes["event"], landed.attrs["solver_switches"]) == (0, "landed on")
    assert landed.attrs["run_kinks_landed_on"] == located.sizes["event"] > 40
    behind = np.flatnonzero(np.array(words_of_flag(located.row_kind)) != "event_before")
    for name in ("time", "x", "v_x", "a_x", "side_spring_force"):
        assert np.array_equal(landed[name], located[name][behind]), name
    among = np.array(words_of_flag(landed.row_kind))[1:-1]
    assert (among == "node").sum() == located.sizes["event"]


def test_landed_on_kinks_are_reproduced_and_completed(tmp_path: Path) -> None:
    """Assert that a file has what its kinks need, and that forces left out are recomputed behind them."""
    model = measured(tmp_path)
    run = xd.simulate(model, method="dop853", rtol=1e-9, until=9.0, switches="landed on")
    assert run.attrs["run_kinks_landed_on"] == 11
    xd.save(run, tmp_path / "run.nc")
    assert xd.reproduce(tmp_path / "run.nc").attrs["identical"] == 1
    short = xd.simulate(model, method="dop853", rtol=1e-9, until=9.0, switches="landed on", log="states")
    assert np.array_equal(xd.complete(short).force_spring_x, run.force_spring_x)


def test_jumps_and_coincident_events_stay_events(tmp_path: Path) -> None:
    """Assert that points at which a force jumps are events all the same, and so is a kink that an event meets."""
    relay = xd.simulate(
        measured(tmp_path, RELAY, interpolation="previous"), method="rk4", step=0.1, until=1.0, switches="landed on"
    )
    assert relay.attrs["solver_switches"] == "located"
    measured(tmp_path)
    text = (tmp_path / "model.toml").read_text() + '[events.middle]\nfunction = "x"\n'
    (tmp_path / "model.toml").write_text(text)
    model = xd.Model.from_toml(tmp_path / "model.toml")
    run = xd.simulate(model, method="rk4", step=0.1, until=3.0, switches="landed on")
    assert sorted(words(run)) == [("middle", "crossing"), ("spring.force", "regime_switch")]
    assert run.attrs["run_kinks_landed_on"] == 3


def test_a_tick_that_meets_a_kink_acts_once(tmp_path: Path) -> None:
    """Assert that a controller counts its ticks where points of a table are landed on at the same instants."""
    rows = [(-1.0, 0.0), (0.0, 0.0), (0.5, 0.0), (1.0, 0.0), (1.5, 0.0), (3.0, 0.0)]
    measured(tmp_path, rows, x="0 m", v="1 m s-1")
    counter = """[controllers.counter]
every = "0.5 s"
states = { n = { unit = "1", start = "0", next = "n + 1" } }
outputs = { u = { unit = "N", start = "0 N", value = "0*newton" } }
"""
    (tmp_path / "model.toml").write_text((tmp_path / "model.toml").read_text() + counter)
    model = xd.Model.from_toml(tmp_path / "model.toml")
    for choice in ("landed on", "located"):
        run = xd.simulate(model, method="rk4", step=0.1, until=1.7, switches=choice)
        assert float(run.n[-1]) == 4.0
        assert float(run.x[-1]) == pytest.approx(1.7, rel=1e-14)

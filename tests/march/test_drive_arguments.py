"""Measured tables of expressions: distance travelled at a speed, a displaced or a moving origin, any other function."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from scipy.linalg import expm

import xdynamics as xd
from cases.problems import MODELS

POINTS, HEIGHTS = [0.0, 0.5, 1.25, 2.0, 3.5, 4.0], [0.0, 3.0, -1.0, 2.0, 2.5, -4.0]


def csv(points: list[float], heights: list[float] = HEIGHTS) -> str:
    """The text of a table of heights."""
    rows = "".join(f"\\n{s!r},{h!r}" for s, h in zip(points, heights, strict=True))
    return f"s [m],road [m]{rows}"


def follower(
    argument: str = "v*t",
    table: str = csv(POINTS),
    v: str = "2 m s-1",
    more: str = "",
    force: str = "k*(road - x)",
    start: str = "1 m s-1",
) -> xd.Model:
    """A mass on a spring, and the integral of the road, over a table of an expression."""
    return xd.Model.from_text(f"""
name = "follower"
[coordinates]
x = "m"
[parameters]
k = "9 N m-1"
v = "{v}"
a = "1 m s-2"
[mass]
x = "1*kilogram"
[drives.road]
table = "road.csv"
csv = "{table}"
argument = "{argument}"
{more}
[forces.spring]
x = "{force}"
[states.area]
unit = "m s"
rate = "road"
[initial]
x = "0.1 m"
v_x = "{start}"
area = "0 m s"
""")


def marched(model: xd.Model, until: str = "1.9 s", **settings: object) -> xr.Dataset:
    """March without a message."""
    return xd.simulate(model, until=until, **({"method": "rk4", "step": "30 ms"} | settings))


def area(times: np.ndarray, distance: np.ndarray, heights: np.ndarray) -> float:
    """The integral of straight pieces in time."""
    assert len(times) == len(distance)
    return float(np.trapezoid(np.interp(distance, POINTS, heights), times))


@pytest.mark.parametrize("interpolation", ["previous", "linear", "pchip", "cubic"])
def test_a_road_at_a_speed_is_a_table_of_time(interpolation: str) -> None:
    """Assert the bits of the same table over time, whose points are exact at this speed."""
    more = f'interpolation = "{interpolation}"\noutside = "hold"'
    by_distance = marched(follower(more=more), until="2.5 s")
    table = csv([s / 2.0 for s in POINTS]).replace("s [m]", "t [s]")
    by_time = marched(follower("t", table, more=more), until="2.5 s")
    for name in ("time", "x", "v_x", "area", "row_kind", "sample_road"):
        np.testing.assert_array_equal(by_distance[name], by_time[name])
    assert by_distance.sizes["step"] > 84  # with rows at its points
    assert by_distance.sizes["event"] == 0


@pytest.mark.parametrize(("v", "offset"), [(2.0, 0.0), (-2.0, 4.0), (-1.7, 3.2), (1.3, -0.7)])
def test_a_road_is_integrated_exactly_either_way(v: float, offset: float) -> None:
    """Assert the trapezoidal sum over all points passed, forwards and backwards, to rounding."""
    run = marched(follower(f"v*t + {offset!r}*metre", v=f"{v!r} m s-1", more='outside = "hold"'))
    passed = [(s - offset) / v for s in POINTS]
    times = np.array(sorted([0.0, 1.9, *(t for t in passed if 0.0 < t < 1.9)]))
    assert float(run.area[-1]) == pytest.approx(area(times, v * times + offset, np.array(HEIGHTS)), abs=2e-15)
    assert np.isin([t for t in passed if 0.0 < t < 1.9], run.time.values).all()


@pytest.mark.parametrize("interpolation", ["previous", "pchip", "cubic"])
def test_backwards_is_the_mirrored_road(interpolation: str) -> None:
    """Assert the motion over the mirrored table at the opposite speed; a constant piece lasts up to its other end."""
    more = f'interpolation = "{interpolation}"\noutside = "hold"'
    back = marched(follower("4*metre - v*t", more=more))
    heights = [*HEIGHTS[-2::-1], HEIGHTS[0]] if interpolation == "previous" else HEIGHTS[::-1]
    ahead = marched(follower("v*t", csv([4.0 - s for s in POINTS[::-1]], heights), more=more))
    np.testing.assert_allclose(back.x, ahead.x, rtol=0.0, atol=1e-14)


def test_a_car_at_rest_stands_on_one_height() -> None:
    """Assert that at no speed the table has the value of its place, inside and beyond it."""
    for offset, height in ((0.25, 1.5), (4.0, -4.0), (9.0, -4.0), (-1.0, 0.0)):
        run = marched(follower(f"v*t + {offset!r}*metre", v="0 m s-1", more='outside = "hold"'))
        assert np.unique(run.sample_road).tolist() == [height]


@pytest.mark.parametrize("method", ["rk4", "dormand_prince", "radau_iia", "taylor"])
def test_a_displaced_origin_displaces_the_points(method: str) -> None:
    """Assert the motion, and the times of passages, of the table with displaced points."""
    settings, off = ({"step": "30 ms"}, 1e-12) if method == "rk4" else ({"rtol": 1e-9, "step": None}, 1e-8)
    hold = 'outside = "hold"'
    displaced = follower("x - v*second/4", csv([s - 2.0 for s in POINTS]), more=hold)
    plain = follower("x", csv([s - 1.5 for s in POINTS]), more=hold)
    displaced, plain = (marched(model, method=method, **settings) for model in (displaced, plain))
    assert displaced.sizes["event"] == plain.sizes["event"] >= 2
    np.testing.assert_allclose(displaced.event_time, plain.event_time, rtol=0.0, atol=off)
    assert float(displaced.x[-1]) == pytest.approx(float(plain.x[-1]), abs=off)


def test_a_moving_origin_is_another_frame() -> None:
    """Assert Galileo's law: over a table carried along at v, the motion is that over a table at rest, plus v*t."""
    carried, rest = (
        follower(argument, csv([s - 2.0 for s in POINTS]), more='outside = "hold"', force="k*road", start=start)
        for argument, start in (("x - v*t", "3 m s-1"), ("x", "1 m s-1"))
    )
    moving, standing = (marched(model, method="dop853", step=None, rtol=1e-11) for model in (carried, rest))
    assert moving.sizes["event"] == standing.sizes["event"] >= 2
    assert float(moving.x[-1]) - 2.0 * 1.9 == pytest.approx(float(standing.x[-1]), abs=1e-9)
    np.testing.assert_allclose(moving.event_time, standing.event_time, rtol=0.0, atol=1e-10)


def test_a_table_of_a_square_of_time_is_located() -> None:
    """Assert times of points of an accelerated car, and the exact integral of straight pieces of t**2."""
    run = marched(follower("a*t**2", more='outside = "hold"'), method="dop853", step=None, rtol=1e-11)
    passed = np.sqrt([s for s in POINTS if 0.0 < s < 1.9**2])
    np.testing.assert_allclose(run.event_time, passed, rtol=1e-12)
    slopes, ends = np.diff(HEIGHTS) / np.diff(POINTS), np.minimum(np.sqrt(POINTS), 1.9)
    exact = sum(
        (HEIGHTS[k] - slopes[k] * POINTS[k]) * (b - a) + slopes[k] * (b**3 - a**3) / 3
        for k, (a, b) in enumerate(pairwise(ends))
    )
    assert float(run.area[-1]) == pytest.approx(exact, abs=1e-11)


def test_members_at_different_speeds_are_their_own_runs() -> None:
    """Assert the bits of single runs at each speed, with nodes of its own, where members share one and where not."""
    model = follower(more='outside = "hold"')
    speeds, stiffnesses = ["1 m s-1", "2 m s-1", "3 km h-1"], ["9 N m-1", "10 N m-1"]
    axes = {"v": speeds, "k": stiffnesses}
    sweep = xd.sweep(model, axes=axes, keep=["end"], method="rk4", step="30 ms", until="1.9 s")
    for i, j in np.ndindex(3, 2):
        alone = marched(model.replace(parameters={"v": speeds[i], "k": stiffnesses[j]}))
        assert float(sweep.end_x[i, j]) == float(alone.x[-1])


@pytest.mark.parametrize("argument", ["v*t", "v*t + x/8"])
def test_the_slope_by_a_speed_is_exact(argument: str) -> None:
    """Assert the slope of a budget, from variational equations, by that of runs beside it."""
    model = follower(argument, more='outside = "hold"').replace(parameters={"v": "2.0 ± 0.001 m s-1"})
    settings = {"method": "dop853", "step": None, "rtol": 1e-11}
    budget = xd.error_budget(model, quantity="x", at="1.5 s", until="1.6 s", method="dop853", rtol=1e-11)
    term = budget.isel(term=list(budget.term_name.values).index("v"))
    assert str(term.term_rule.values).startswith("slope by variational equations")
    sides = [model.replace(parameters={"v": f"{2.0 + d!r} m s-1"}) for d in (1e-5, -1e-5)]
    more, less = (float(marched(side, "1.5 s", **settings).x[-1]) for side in sides)
    assert float(term.sensitivity) == pytest.approx((more - less) / 2e-5, rel=1e-6)


def test_a_jump_that_a_speed_moves_is_no_slope_along_the_run() -> None:
    """Assert that where points with jumps follow the input, runs beside it give the slope."""
    model = follower(more='outside = "hold"\ninterpolation = "previous"').replace(parameters={"v": "2.0 ± 0.001 m s-1"})
    budget = xd.error_budget(model, quantity="x", at="1.5 s", until="1.6 s", method="dop853", rtol=1e-11)
    term = budget.isel(term=list(budget.term_name.values).index("v"))
    assert not str(term.term_rule.values).startswith("slope by variational equations")


def test_it_is_kept_and_reproduced(tmp_path: Path) -> None:
    """Assert the expression in the model's text and with its samples, and the bits of the archive's rerun."""
    model = follower("x - v*t", csv([s - 2.0 for s in POINTS]), more='outside = "hold"')
    run = marched(model)
    assert run.sample_road.attrs["argument"] == "x - v*t"
    assert xd.Model.from_text(model.to_toml()) == model
    xd.save(run, tmp_path / "run.nc")
    assert xd.reproduce(tmp_path / "run.nc").attrs["identical"] == 1


@pytest.mark.parametrize(
    ("argument", "fault"),
    [
        ("v", "the argument 'v', which never changes"),
        ("road", "the argument 'road', which reads the drive 'road'; an argument is of t, coordinates, velocities"),
        ("abs(x)", "the argument 'abs(x)', and 'abs' has a kink or a jump there, which is not located"),
        ("mod(v*t, 4*metre)", "and 'mod' has a kink or a jump there"),
        ("k*t", "the first column of 'road.csv' is in 'm', its argument 'k*t' in"),
        ("w*t", "name 'w' (column 1) is not declared"),
        ("v*", "argument: "),
        ("v*t + second", "second"),
        ("a_x", "the argument 'a_x', which never changes"),
    ],
)
def test_a_wrong_argument_is_told(argument: str, fault: str) -> None:
    """Assert one error that names the drive, its argument and what an argument may be."""
    with pytest.raises(xd.ModelError, match="drive 'road'") as caught:
        follower(argument)
    assert fault in str(caught.value)


def test_beyond_the_table_a_run_ends_with_the_distance() -> None:
    """Assert the outcome's argument, as written and with its value."""
    run = marched(follower(), until="2.5 s")
    assert run.attrs["run_outcome"] == "outside_drive_table"
    assert "evaluated at v*t = 4." in run.attrs["run_outcome_text"]


def test_the_quarter_car_rides_by_its_exact_solution() -> None:
    """Assert body and wheel at 2 s by matrix exponentials from point to point of the road."""
    model = xd.Model.from_toml(MODELS / "quarter_car.toml")
    run = xd.simulate(model, method="dop853", rtol=1e-11, until="2 s")
    table, v = model.drives["road"].table, 80.0 / 3.6
    ks, c, kt, mb, mw = 15825.0, 1500.0, 163250.0, 250.0, 37.5
    law = np.zeros((6, 6))  # body and wheel, their rates, the road, its slope in time
    law[0, 2] = law[1, 3] = law[4, 5] = 1.0
    law[2, :4] = np.array([-ks, ks, -c, c]) / mb
    law[3, :5] = np.array([ks, -ks - kt, c, -c, kt]) / mw
    state, times = np.zeros(4), np.append(table.argument[table.argument < 2.0 * v] / v, 2.0)
    heights = np.interp(v * times, table.argument, table.value)
    for k, (begin, end) in enumerate(pairwise(times)):
        slope = (heights[k + 1] - heights[k]) / (end - begin)
        state = (expm(law * (end - begin)) @ np.array([*state, heights[k], slope]))[:4]
    assert float(run.z_body[-1]) == pytest.approx(1000.0 * state[0], abs=1e-8)
    assert float(run.z_wheel[-1]) == pytest.approx(1000.0 * state[1], abs=1e-8)


def test_chosen_steps_that_cannot_leave_a_table_say_where_they_stand() -> None:
    """Assert that a march at the end of a table that says "error", where no step is short enough, names table and value."""
    model = xd.Model.from_text(
        'name = "end"\ncoordinates.x = "m"\nmass.x = "1*kilogram"\nforces.s = { x = "f" }\n'
        'initial = { x = "1.99 m", v_x = "1 m s-1" }\n'
        'drives.f = { csv = "x [m],f [N]\\n-2,8\\n2,-8\\n", argument = "x", outside = "error" }\n'
    )
    run = xd.simulate(model, method="dop853", until="1 s", max_steps=2000)
    assert run.attrs["run_outcome"] == "step_limit"
    assert (
        "drive 'f' was evaluated at x = 2, and its table 'f.csv' reaches from -2 to 2" in run.attrs["run_outcome_text"]
    )


CURVES = "x [m],left [N],right [N]\n-2,4,6\n0,0,0\n1,-1,-3\n2,-4,-6\n"


def two_springs(shaped: bool, argument: str, interpolation: str, outside: str) -> xd.Model:
    """Two masses on springs with measured curves of their own: as one quantity, or as two coordinates."""
    names = ["u"] if shaped else ["u_left", "u_right"]
    table = {"csv": CURVES, "interpolation": interpolation, "outside": outside}
    drives = [{"dims": ["end"]}] if shaped else [{"column": "left"}, {"column": "right"}]
    pulls = {name.replace("u", "pull"): table | own for name, own in zip(names, drives, strict=True)}
    for name, pull in zip(names, pulls.values(), strict=True):
        pull["argument"] = argument.replace("u", name)
    start: dict[str, object] = {"u": {"values": {"left": "1.5 m", "right": "-1 m"}}, "v_u": "0.1 m s-1"}
    apart = {"u_left": "1.5 m", "u_right": "-1 m", "v_u_left": "0.1 m s-1", "v_u_right": "0.1 m s-1"}
    return xd.Model(
        name="springs",
        dimensions={"end": ["left", "right"]} if shaped else {},
        coordinates={name: {"unit": "m", "dims": ["end"]} if shaped else "m" for name in names},
        parameters={"T": "0.1 s"},
        mass=dict.fromkeys(names, "1*kilogram"),
        drives=pulls,
        forces={"spring": dict(zip(names, pulls, strict=True))},
        initial=start if shaped else apart,
    )


@pytest.mark.parametrize(
    ("argument", "interpolation", "outside", "settings"),
    [
        ("u", "linear", "error", {"method": "rk4", "step": "0.1 s"}),
        ("u + T*v_u", "previous", "hold", {"method": "dop853", "rtol": 1e-8}),
        ("u + T*v_u", "pchip", "error", {"method": "radau_iia", "rtol": 1e-6}),
        ("u", "cubic", "error", {"method": "taylor", "rtol": 1e-9}),
    ],
)
def test_each_element_is_looked_up_at_its_own_argument(
    argument: str, interpolation: str, outside: str, settings: dict[str, object]
) -> None:
    """Assert the bits, rows and events of two coordinates with tables of their own."""
    whole, apart = (
        xd.simulate(two_springs(shaped, argument, interpolation, outside), until="3 s", **settings)  # type: ignore[arg-type]
        for shaped in (True, False)
    )
    assert whole.attrs["run_outcome"] == "completed"
    assert whole.sizes.get("event", 0) == apart.sizes.get("event", 0)
    for end in ("left", "right"):
        np.testing.assert_array_equal(whole.u.sel(end=end), apart[f"u_{end}"])


def test_each_bond_is_a_measured_spring() -> None:
    """Assert that a straight table for each link, over its length, is the chain of the same linear springs."""
    chain = {
        "name": "chain",
        "dimensions": {"body": 3},
        "relations": {"bond": {"of": "body", "neighbours": 1}},
        "coordinates": {"u": {"unit": "m", "dims": ["body"]}},
        "parameters": {"k": {"dims": ["bond"], "value": [1.0, 4.0], "unit": "N m-1"}},
        "mass": {"u": "1*kilogram"},
        "initial": {"u": {"value": [0.0, 0.25, 0.0], "unit": "m"}},
    }
    stretch = "second(u, bond) - first(u, bond)"
    pull = {"csv": "s [m],pull_0 [N],pull_1 [N]\n-4,-4,-16\n4,4,16\n", "dims": ["bond"], "argument": stretch}
    measured = xd.Model(**chain, drives={"pull": pull}, forces={"bond": {"over": "bond", "u": "pull"}})  # type: ignore[arg-type]
    written = xd.Model(**chain, forces={"bond": {"over": "bond", "u": f"k*({stretch})"}})  # type: ignore[arg-type]
    a, b = (xd.simulate(model, method="rk4", step="0.01 s", until="1 s") for model in (measured, written))
    np.testing.assert_allclose(a.u, b.u, rtol=0.0, atol=1e-14)
    assert float(abs(a.u[-1] - a.u[0]).min()) > 0.05


def test_a_quantity_is_diagnosed_without_the_state_of_tables_that_it_does_not_read() -> None:
    """Assert the spread of a momentum, which reads a velocity alone, beside a table over a coordinate."""
    run = xd.simulate(two_springs(False, "u", "cubic", "error"), method="rk4", step="0.01 s", until="1 s")
    speed = run.v_u_left.values
    assert float(xd.diagnose(run).band_momentum_u_left) == pytest.approx(speed.max() - speed.min(), rel=1e-3)

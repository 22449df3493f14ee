"""The state between steps: error, ends, events, laziness, refusals.

States inside steps of runs whose bodies lie on each other, or slide, by contacts of many links.
Whether each step of a record, recomputed, leads to the row that follows.
"""

from __future__ import annotations

from math import atan, cos, sin
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.integrate import solve_ivp

import xdynamics as xd
from cases.chunked import chunked
from cases.problems import EPS, MODELS, damped, free, oscillator, particle
from xdynamics.evidence.diagnosing import continuity
from xdynamics.evidence.diagnosing.diagnosis import diagnosis_lines
from xdynamics.kernels import machine


def run_of(method: str = "dormand_prince", **more: object) -> Any:
    """March the damped oscillator for five seconds."""
    return xd.simulate(damped().model, **{"method": method, "rtol": 1e-8, "atol": 1e-8, "until": 5.0} | more)


def test_accepted_states_come_back_to_the_bit() -> None:
    """Assert that at accepted times the accepted states are returned, with no error of interpolation."""
    run = run_of()
    found = xd.sample(run, run.time)
    for name in ("x", "v_x", "s"):
        assert np.array_equal(found[name], run[name])
        assert (found[f"error_{name}"] == 0).all()
    assert np.array_equal(found.row, np.arange(run.sizes["step"]))


def test_error_estimate_covers_the_error() -> None:
    """Assert that between steps values are as good as accepted ones plus what the second route tells."""
    run = run_of()
    times = np.random.default_rng(1).uniform(0, 5, 500)
    found, exact = xd.sample(run, times), damped().exact(times)
    on_grid = damped().exact(run.time.values)
    for name in ("x", "v_x", "s"):
        off = np.abs(found[name].values - exact[name])
        accepted = np.abs(run[name].values - on_grid[name]).max()
        assert (off <= accepted + 3 * found[f"error_{name}"].values).all(), name
        assert 0 < float(found[f"error_{name}"].max()) < 1e-5


def test_result_carries_rule_order_units_and_route() -> None:
    """Assert that every variable says how it came about."""
    found = xd.sample(run_of(), "1.5 s")
    assert found.sizes == {"at": 1}
    assert found.x.attrs["units"] == "m"
    assert found.x.attrs["interpolation_order"] == 5
    assert "re-integration" in found.x.attrs["interpolation"]
    assert found.x.attrs["ancillary_variables"] == "error_x"
    assert "two steps of the run's method" in found.error_x.attrs["long_name"]
    assert found.error_v_x.attrs["units"] == "m s-1"
    for name in ("solver_interpolation", "solver_interpolation_order"):  # what events are located on
        assert found.attrs[name] == run_of().attrs[name]


@pytest.mark.parametrize(
    ("estimator", "orders", "words"),
    [
        ("embedded", (5, 4), "Shampine"),
        ("step_doubling", (5, 3), "Hermite"),
        ("step_doubling_extrapolated", (6, 3), "Hermite"),
    ],
)
def test_rules_have_their_orders(estimator: str, orders: tuple[int, int], words: str) -> None:
    """Assert that a shorter step has the order of what goes on, and the interpolant that of its polynomial."""
    run = run_of(estimator=estimator)
    shorter, inner = xd.sample(run, "1.5 s"), xd.sample(run, "1.5 s", rule="interpolant")
    assert (shorter.v_x.attrs["interpolation_order"], inner.v_x.attrs["interpolation_order"]) == orders
    assert run.attrs["solver_interpolation_order"] == orders[0]
    assert words in inner.attrs["solver_interpolation"]
    assert inner.x.attrs["interpolation_order"] == (4 if words == "Shampine" else 5)


# ------------------------------------------------------------------------------------------------ the error inside

ORBIT = {"x": 0.5, "y": 0.0, "v_x": 0.0, "v_y": 3**0.5}  # e = 0.5
RATES: dict[str, Any] = {
    "kepler": lambda x, y, v, w: (v, w, -x / (x * x + y * y) ** 1.5, -y / (x * x + y * y) ** 1.5),
    "pendulum": lambda theta, v: (v, -9.8 * np.sin(theta)),
    "predators": lambda u, w: (u * (1 - w), w * (u - 1)),
}


def model_of(name: str) -> xd.Model:
    """The model whose rates stand above."""
    if name == "predators":
        states = {"u": {"unit": "1", "rate": "k*u*(1 - w)"}, "w": {"unit": "1", "rate": "k*w*(u - 1)"}}
        return xd.Model(name=name, parameters={"k": "1 s-1"}, states=states, initial={"u": "2", "w": "0.5"})
    model = xd.Model.from_toml(MODELS / f"{name}.toml")
    return model.replace(initial=ORBIT if name == "kepler" else {"theta": 2.0})


def solution_through(name: str, starts: Any, states: Any, times: Any) -> Any:
    """The solutions of a model through states at their times, at other times: side by side, each over its own span."""

    def slopes(_: float, y: Any) -> Any:
        return ((times - starts) * np.array(RATES[name](*y.reshape(states.shape)))).ravel()

    return solve_ivp(slopes, (0, 1), states.ravel(), "DOP853", rtol=3e-14, atol=1e-17).y[:, -1].reshape(states.shape)


@pytest.mark.every(7)
@pytest.mark.parametrize("rule", ["reintegrate", "interpolant"])
@pytest.mark.parametrize(
    ("problem", "method", "step"),
    [
        ("kepler", "velocity_verlet", 0.02),
        ("kepler", "dormand_prince", 0.1),
        ("kepler", "kahan_li8", 0.2),
        ("kepler", "dop853", 0.25),
        ("pendulum", "averaged_velocity", 0.01),
        ("pendulum", "kahan_li8", 0.15),
        ("pendulum", "dop853", 0.2),
        ("pendulum", "dprkn6", 0.1),
        ("predators", "dormand_prince", 0.15),
        ("predators", "dop853", 0.4),
        ("predators", "radau_iia", 0.1),
    ],
)
def test_error_is_that_of_the_solution_through_the_row(problem: str, method: str, step: float, rule: str) -> None:
    """Assert that of 600 random instants, and of those near the ends, few are told less than half of their error."""
    run = xd.simulate(model_of(problem), method=method, step=step, until=6.0, force_samples="none")
    random = np.random.default_rng(7)
    names = {"kepler": ["x", "y", "v_x", "v_y"], "pendulum": ["theta", "v_theta"], "predators": ["u", "w"]}[problem]
    parts = np.concatenate([random.uniform(0, 1, 400), random.uniform(0, 0.05, 100), random.uniform(0.95, 1, 100)])
    times, rows = run.time.values, random.integers(0, run.sizes["step"] - 1, 600)
    found = xd.sample(run, times[rows] + parts * (times[rows + 1] - times[rows]), rule=rule)
    rows = found.row.values
    true = solution_through(
        problem, times[rows], np.array([run[name].values[rows] for name in names]), found.at_time.values
    )
    off = np.abs(np.array([found[name] for name in names]) - true)
    told = np.array([found[f"error_{name}"] for name in names])
    inside = found.at_time.values > times[rows]
    assert (told[:, inside] > 0).all()
    for part in (inside, inside & (parts < 0.05), inside & (parts > 0.95)):
        told_here, off_here = told[:, part], off[:, part]
        assert np.quantile(told_here / np.maximum(off_here, 1e-20), 0.05) > 0.5
        assert 0.7 < np.median(told_here / np.maximum(off_here, EPS * np.abs(true[:, part]))) < 3


@pytest.mark.parametrize("estimator", ["none", "step_doubling", "step_doubling_extrapolated"])
def test_error_is_extrapolated_by_the_order_of_what_goes_on(estimator: str) -> None:
    """Assert that of Euler's steps, halved or not, nearly all of the error is told, and not more."""
    run = xd.simulate(model_of("pendulum"), method="forward_euler", step=0.002, until=1.0, estimator=estimator)
    rows = np.arange(0, 500, 7)
    found = xd.sample(run, run.time.values[rows] + 0.0015)
    states = np.array([run[name].values[rows] for name in ("theta", "v_theta")])
    true = solution_through("pendulum", run.time.values[rows], states, found.at_time.values)
    told = found.error_v_theta.values / np.abs(found.v_theta.values - true[1])
    assert np.median(told) == pytest.approx(1, abs=0.05)


def test_an_archive_is_sampled_without_the_run(tmp_path: Any) -> None:
    """Assert that the file alone gives what the run in memory gives, bit for bit."""
    run = run_of("dop853")
    xd.save(run, tmp_path / "run.nc")
    times = np.linspace(0, 5, 101)
    whole, kept = xd.sample(run, times), xd.sample(xd.open_run(tmp_path / "run.nc"), times)
    assert all(np.array_equal(whole[name], kept[name]) for name in whole.variables)


def test_only_the_chunks_that_are_needed_are_read() -> None:
    """Assert that the result is lazy, and that its computing reads one chunk of each state and none in between."""
    import dask.array as da

    run = run_of("rk4", rtol=None, atol=None, step=0.005)
    read: list[tuple[str, int]] = []

    def watched(name: str) -> Any:
        values = run[name].values

        def load(block: np.ndarray, block_info: Any = None) -> np.ndarray:
            if block_info:
                read.append((name, block_info[0]["chunk-location"][0]))
            return block

        return da.from_array(values, chunks=100).map_blocks(load, dtype=float, meta=np.empty(0))

    lazy = run.assign({name: ("step", watched(name), run[name].attrs) for name in ("x", "v_x", "s", "step_size")})
    lazy["time"] = run["time"].chunk({"step": 100})
    found = xd.sample(lazy, [2.2501, 2.2502])
    assert not read
    assert found.x.chunks
    assert np.array_equal(found.x, xd.sample(run, [2.2501, 2.2502]).x)
    assert {chunk for _, chunk in read} == {4}


def test_a_step_never_reaches_over_an_event() -> None:
    """Assert that either side of an event is taken from its own steps, and that `side` picks the state at its time."""
    model = xd.Model.from_text(xd.Model.from_toml(MODELS / "ball_drag.toml").to_toml())
    run = xd.simulate(model, method="dormand_prince", rtol=1e-8, atol=1e-8)
    at, before, after = float(run.event_time[0]), int(run.event_row_before[0]), int(run.event_row_after[0])
    assert xd.sample(run, at, side="before").row.item() == before
    assert xd.sample(run, at, side="after").row.item() == after
    close = xd.sample(run, [at - 1e-4, at + 1e-4])
    assert (close.row.values < before).tolist() == [True, False]
    assert close.row.values[1] == after


def test_behind_a_jump_the_drive_s_new_piece_counts() -> None:
    """Assert that the step behind a node starts from the force on its far side."""
    model = particle(
        name="pulled",
        parameters={"m": "1 kg"},
        forces={"pull": {"x": "pull"}},
        drives={"pull": {"table": "p.csv", "csv": "time [s],pull [N]\n0,0\n1,2\n2,0\n", "interpolation": "previous"}},
        initial={"x": "0 m", "v_x": "0 m s-1"},
    )
    run = xd.simulate(model, method="velocity_verlet", step=0.5, until=2.0)
    found = xd.sample(run, [0.75, 1.25, 1.9])
    assert found.x.values == pytest.approx([0.0, 0.0625, 0.81], abs=4 * EPS)


@pytest.mark.parametrize("estimator", ["none", "embedded", "step_doubling", "step_doubling_extrapolated"])
def test_dense_output_ends_in_the_accepted_state(estimator: str) -> None:
    """Assert that just before the end of every step the interpolant is at the state that was accepted."""
    run = run_of("bogacki_shampine", rtol=None, atol=None, step=0.5, estimator=estimator)
    for rule in ("reintegrate", "interpolant"):
        found = xd.sample(run, np.nextafter(run.time.values[1:], 0.0), rule=rule)
        assert np.abs(found.x.values - run.x.values[1:]).max() < 32 * EPS


def test_a_grid_that_rounds_has_no_jumps() -> None:
    """Assert that steps whose ends are further or less far apart than their size still end in the accepted state."""
    start = {"t": "1e6 s", "x": "0 m", "v_x": "1e3 m s-1"}
    run = xd.simulate(particle(initial=start), method="midpoint", step=0.1, until=1e6 + 1)
    assert (np.diff(run.time) != 0.1).all()
    for rule in ("reintegrate", "interpolant"):
        found = xd.sample(run, np.nextafter(run.time.values[1:], 0.0), rule=rule)
        moved = 1e3 * np.spacing(1e6)
        assert np.abs(found.x.values - run.x.values[1:] + moved).max() < 1e-9 * moved + 1e3 * EPS


def test_a_step_to_zero_may_round() -> None:
    """Assert that a grid that ends beside t = 0 by a rounding has no rows missing there."""
    start = {"t": "-0.3 s", "x": "0 m", "v_x": "3 m s-1"}
    run = xd.simulate(particle(initial=start), method="midpoint", step=0.1, until=0.3)
    assert 0 < abs(run.time.values).min() < EPS
    middle = (run.time.values[1:] + run.time.values[:-1]) / 2
    assert xd.sample(run, middle).x.values == pytest.approx(3 * (middle + 0.3))


def test_events_and_samples_agree() -> None:
    """Assert that without an event a sample at its time is the state that the run with it landed on."""
    model = model_of("pendulum")
    with_event = xd.simulate(model, method="rk4", step=0.1, until=3.0)
    without = xd.simulate(model.replace(events={}), method="rk4", step=0.1, until=3.0)
    found = xd.sample(without, with_event.event_time.values[:1])
    row = int(with_event.event_row_before[0])
    assert float(found.theta[0]) == pytest.approx(float(with_event.theta[row]), abs=4 * EPS)
    assert float(found.v_theta[0]) == pytest.approx(float(with_event.v_theta[row]), abs=1e-13)


def test_scaled_runs_are_sampled_alike() -> None:
    """Assert that in nondimensional variables values and errors are those of SI units, to rounding."""
    times = np.linspace(0.02, 4.98, 99)  # off the grid, which in other units is a rounding off
    given = {"method": "dormand_prince", "rtol": None, "atol": None, "step": 0.1}
    plain, scaled = (xd.sample(run_of(**given, scales=one), times) for one in (None, {"length": "3 m", "time": "7 s"}))
    for name in ("x", "v_x", "s"):
        assert np.abs(plain[name] - scaled[name]).max() < 64 * EPS
        assert np.abs(plain[f"error_{name}"] - scaled[f"error_{name}"]).max() < 64 * EPS


def test_a_step_that_cannot_be_solved_again_is_no_number() -> None:
    """Assert that where Newton's method fails on the shorter step neither a value nor an error is made up."""
    states = {"y": {"unit": "1", "rate": "-k*y**3"}}
    model = xd.Model(name="falling", parameters={"k": "1 s-1"}, states=states, initial={"y": "1"})
    run = xd.simulate(model, method="implicit_midpoint", step=1.0, until=2.0)
    assert np.isfinite(xd.sample(run, 0.5).y[0])
    far = run.assign(y=("step", [1e20, 1.0, 1.0], run.y.attrs))
    del far.attrs["origin"]  # nobody knows that it was edited
    for rule in ("reintegrate", "interpolant"):
        found = xd.sample(far, 0.5, rule=rule)
        assert np.isnan([found.y[0], found.error_y[0]]).all()


def test_a_thinned_or_converted_record_is_refused() -> None:
    """Assert that missing rows and other units are named, not interpolated over."""
    run = run_of()
    with pytest.raises(xd.InputError, match="rows are missing between t = .* s and .* s"):
        xd.sample(run.isel(step=slice(None, None, 2)), run.time.values[1])
    with pytest.raises(xd.InputError, match="'x' is in 'mm', needs 'm' as it was recorded"):
        xd.sample(run.assign(x=run.x.assign_attrs(units="mm")), 1.0)
    with pytest.raises(xd.InputError, match="the record has no variable 'x'"):
        xd.sample(run.drop_vars("x"), 1.0)
    with pytest.raises(xd.InputError, match="of size 0, needs rows along 'step'"):
        xd.sample(run.isel(step=slice(0, 0)), 1.0)


@pytest.mark.parametrize(
    ("times", "message"),
    [
        ([1.0, 5.5], r"times\[1\] = 5.5 s is outside the run, from 0.0 s to 5.0 s"),
        ([-1e-9], r"times\[0\] = -1e-09 s is outside the run"),
        ([float("nan")], r"times\[0\] is nan, needs a time in 's'"),
        ([1.0, float("nan"), 2.0], r"times\[1\] is nan, needs a time in 's'"),
        ([True], r"times are \[True\], need numbers in 's'"),
        ([], r"times have the shape \(0,\)"),
        ([[1.0]], r"times have the shape \(1, 1\)"),
        (["soon"], "times: quantity 'soon' does not start with a finite number"),
        (["x" * 70], "times: quantity 'x{40}…' does not start"),
        ("1 m", "times"),
    ],
)
def test_wrong_times_are_named(times: object, message: str) -> None:
    """Assert that what cannot be sampled is refused by its place and value; nothing is extrapolated."""
    with pytest.raises(xd.InputError, match=message):
        xd.sample(run_of(), times)


def test_other_faults_are_named() -> None:
    """Assert that a wrong side and a Dataset that is no run are refused."""
    with pytest.raises(xd.InputError, match="side is 'left'; there are before, after"):
        xd.sample(run_of(), 1.0, side="left")
    with pytest.raises(xd.InputError, match="rule is 'hermite'; there are reintegrate, interpolant"):
        xd.sample(run_of(), 1.0, rule="hermite")
    with pytest.raises(xd.InputError, match="functions are 'x{40}', need a mapping of names to functions"):
        xd.sample(run_of(), 1.0, functions="x" * 50)
    with pytest.raises(xd.InputError, match="this is no run record: it has no time, row_kind, step_size, model_toml"):
        xd.sample(xd.sample(run_of(), 1.0).drop_vars("at_time"), 1.0)


@pytest.mark.parametrize("side", ["after", "before"])
def test_times_at_the_borders_of_chunks(side: str) -> None:
    """Assert that a search over chunks finds the rows that one over the whole finds, at every accepted time and between."""
    run = run_of("rk4", rtol=None, atol=None, step=0.05)
    times = np.concatenate([run.time.values, (run.time.values[1:] + run.time.values[:-1]) / 2])
    lazy = run.chunk({"step": 7})
    whole, parts = xd.sample(run, times, side=side), xd.sample(lazy, times, side=side)
    assert np.array_equal(whole.row, parts.row)
    assert np.array_equal(whole.row[: run.sizes["step"]], np.arange(run.sizes["step"]))
    assert np.array_equal(whole.x, parts.x)


@pytest.mark.parametrize("summation", ["compensated", "plain"])
def test_a_sample_is_made_by_the_law_of_the_run(summation: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that the steps of a run whose sums are compensated are made again by the same program: none is compiled."""
    run = xd.simulate(oscillator().model, method="pefrl", step=0.05, until=1.0, summation=summation)
    monkeypatch.setattr(machine, "compiled", lambda *_: pytest.fail("compiled"))
    assert np.isfinite(xd.sample(run, [0.51, 0.52]).x).all()


G = 9.81
METHODS: list[dict[str, Any]] = [
    {"method": "velocity_verlet", "step": "50 ms"},
    {"method": "dop853", "rtol": 1e-9},
]


def stack(count: int) -> xd.Model:
    """Return discs that lie on each other."""
    return xd.Model(
        name="stack",
        dimensions={"disc": count, "axis": ["x", "y"]},
        relations={"pair": {"of": "disc"}},
        coordinates={"r": {"unit": "m", "dims": ["disc", "axis"]}},
        parameters={"g": f"{G} m s-2", "m": "2 kg", "radius": "0.5 m"},
        mass={"r": "m"},
        forces={"weight": {"r": "-m*g*index(axis)"}},
        contacts={
            "discs": {"gap": "norm(second(r, pair) - first(r, pair), axis) - 2*radius", "restitution": 0.5},
            "floor": {"gap": "r - radius", "restitution": 0.5},
        },
        initial={"r": {"unit": "m", "value": [[2.0, k + 0.5] for k in range(count)]}},
    )


def blocks(friction: list[float], slope: float) -> xd.Model:
    """Return blocks on an incline, each with friction of its own."""
    return xd.Model(
        name="blocks",
        dimensions={"block": len(friction)},
        coordinates={"x": {"unit": "m", "dims": ["block"]}, "y": {"unit": "m", "dims": ["block"]}},
        parameters={
            "g": f"{G} m s-2",
            "m": "1 kg",
            "mu": {"dims": ["block"], "value": friction, "unit": "1"},
            "s": repr(sin(slope)),
            "c": repr(cos(slope)),
        },
        mass={"x": "m", "y": "m"},
        forces={"weight": {"x": "m*g*s", "y": "-m*g*c"}},
        contacts={
            "incline": {
                "gap": "y",
                "restitution": 0,
                "tangential": "coulomb",
                "slip": "v_x",
                "friction": "mu",
                "static": "mu",
            }
        },
        initial={"x": "0 m", "y": "0 m"},
    )


@pytest.mark.parametrize("asked", METHODS)
@pytest.mark.parametrize("rule", ["interpolant", "reintegrate"])
def test_discs_at_rest_stay_where_they_are_inside_steps(rule: str, asked: dict[str, Any]) -> None:
    """Assert that no disc falls between rows, where their contacts hold them."""
    run = xd.simulate(stack(10), until="1 s", **asked)
    inside = xd.sample(run, np.linspace(0.013, 0.97, 7), rule=rule)
    assert np.abs(inside.r.values - run.r.values[0]).max() < 1e-13
    assert np.abs(inside.v_r.values).max() < 1e-12
    assert np.nanmax(inside.error_r.values) < 1e-12


@pytest.mark.parametrize("asked", METHODS)
def test_blocks_stick_or_slide_inside_steps(asked: dict[str, Any]) -> None:
    """Assert that those with friction below the slope slide by its closed form, and the others stay."""
    slope = atan(0.5)
    friction = [0.1 + 0.03 * k for k in range(26)]  # 14 below
    run = xd.simulate(blocks(friction, slope), until="1 s", **asked)
    times = np.linspace(0.013, 0.97, 5)
    inside = xd.sample(run, times)
    rate = np.maximum(0.0, G * (sin(slope) - np.array(friction) * cos(slope)))
    assert inside.x.values == pytest.approx(rate * times[:, np.newaxis] ** 2 / 2, abs=1e-9)
    assert np.abs(inside.y.values).max() < 1e-12


@pytest.mark.parametrize("name", ["granular_box", "rough_pile"])
def test_steps_of_heaps_lead_to_their_next_rows(name: str) -> None:
    """Assert that a state a last bit before the end of a step is the row that it led to, as long as no impact follows."""
    run = xd.simulate(xd.Model.from_toml(MODELS / f"{name}.toml"), log="full")
    place = "r" if "r" in run else "y"
    time = run.time.values
    rows = np.flatnonzero(np.diff(time) > 1e-6)[::40]
    late = xd.sample(run, np.nextafter(time[rows + 1], 0.0))
    assert np.abs(late[place].values - run[place].values[rows + 1]).max() < 1e-12


PASSED, FAILED, NOT_CHECKED = range(3)
WALL = """
[events.wall]
function = "x - 2.5*metre"
direction = "rising"
action = "record"
root_state = "interpolant"
"""


def diagnosed(run: xr.Dataset) -> xr.Dataset:
    """Diagnose a run without another."""
    return xd.diagnose(run, companion=False)


def changed(run: xr.Dataset, name: str, place: Any, factor: float) -> xr.Dataset:
    """Return a record with one number multiplied."""
    numbers = run[name].values.copy()
    numbers[place] *= factor
    return run.assign({name: run[name].copy(data=numbers)})


@pytest.mark.every(3)
@pytest.mark.parametrize("method", xd.METHODS)
def test_steps_of_every_method_lead_to_their_next_rows(method: str) -> None:
    """Assert that the largest defect is of rounding; and that a velocity a billionth off is seen, where it is."""
    model = xd.Model.from_toml(MODELS / "pendulum.toml")
    asked = {"rtol": 1e-9} if method in ("radau_iia", "taylor") else {"step": "10 ms"}
    try:
        run = xd.simulate(model, method=method, until="2 s", **asked)
    except xd.InputError:
        pytest.skip("the method is not for this model")
    found = diagnosed(run)
    assert found.continuity_verdict == PASSED
    assert found.continuity_steps == np.count_nonzero(np.diff(run.time) > 0)
    assert found.continuity_defect_theta <= found.continuity_bound_theta < 1e-8
    other = diagnosed(changed(run, "v_theta", 9, 1 + 1e-6))
    assert other.continuity_verdict == FAILED
    assert float(other.continuity_time) in run.time.values[8:10]


def test_a_changed_velocity_is_off_by_its_change_and_moves_the_position_by_it() -> None:
    """Assert the closed form of a free particle: of the step to the row its change, of that from it h times as much."""
    run = xd.simulate(free().model, method="velocity_verlet", step="125 ms", until="2 s")
    found = diagnosed(run)
    assert (found.continuity_verdict, found.continuity_defect_x, found.continuity_defect_v_x) == (PASSED, 0.0, 0.0)
    found = diagnosed(changed(run, "v_x", 6, 1 + 2.0**-40))
    assert found.continuity_verdict == FAILED
    assert found.continuity_defect_v_x == 3 * 2.0**-40
    assert found.continuity_defect_x == pytest.approx(3 * 2.0**-40 / 8, rel=1e-3, abs=0)
    assert found.continuity_bound_v_x < 1e-13
    assert float(found.continuity_time) in (0.625, 0.75)
    (line,) = (line for line in diagnosis_lines(found) if "continuity" in line)
    assert "attention: continuity failed: each of 16 steps was recomputed; that from t = 0." in line
    assert "2.73e-12 m s-1 away from the next row in v_x" in line


@pytest.mark.parametrize(
    "name", ["stack of contacts", "toda_chain", "bouncing_ball", "stick_slip_belt", "rocket_c6", "cart_pid"]
)
def test_contacts_frictions_regimes_and_controllers(name: str) -> None:
    """Assert that rows on both sides of events are led to and gone on from, and that a changed one is seen and named."""
    more = {"log": "full", "until": "0.3 s"} if name == "stack of contacts" else {}
    name = "granular_box" if more else name
    run = xd.simulate(xd.Model.from_toml(MODELS / f"{name}.toml"), **more)
    assert diagnosed(run).continuity_verdict == PASSED
    kind = [str(v) for v in run.data_vars if run[v].attrs.get("role") == "velocity"][-1]
    row = int(run.event_row_after[0]) if run.sizes["event"] else 50
    place = (row, *(0,) * (run[kind].ndim - 1))
    run = run.assign({kind: run[kind].copy(data=run[kind].values.copy())})
    run[kind].values[place] += 1e-8
    assert diagnosed(run).continuity_verdict == FAILED


def test_steps_to_events_on_interpolants_are_left_out() -> None:
    """Assert that the state there, which no step of the method reaches, does not speak against the record."""
    model = xd.Model.from_text(free().model.to_toml() + WALL)
    run = xd.simulate(model, method="rk4", step="70 ms", until="1 s")
    found = diagnosed(run)
    assert (found.continuity_verdict, found.continuity_steps) == (PASSED, np.count_nonzero(np.diff(run.time) > 0) - 1)
    assert found.attrs["continuity_rule"].endswith("was recomputed, but those to events on interpolants")


def test_of_long_runs_some_steps_are_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that they are spread over the run, ends included, and counted."""
    run = xd.simulate(free().model, method="rk4", step="10 ms", until="10 s")
    monkeypatch.setattr(continuity, "MOST_NUMBERS", 200)
    found = diagnosed(run)
    assert found.continuity_steps == 100
    assert found.attrs["continuity_rule"] == "100 of 1000 steps, evenly spread, were recomputed"
    for row in (0, 1000):
        assert diagnosed(changed(run, "x", row, 1 + 1e-9)).continuity_verdict == FAILED


def test_chunks_and_a_run_without_a_step() -> None:
    """Assert that chunks change nothing, and that where there is no step nothing is judged."""
    run = xd.simulate(free().model, method="rk4", step="10 ms", until="1 s")
    found = diagnosed(run.isel(step=slice(1)))
    assert (found.continuity_verdict, found.continuity_steps) == (NOT_CHECKED, 0)
    assert found.attrs["continuity_rule"] == "there is no step to recompute"
    assert np.isnan(found.continuity_defect_x)
    other = changed(run, "x", 40, 1 + 1e-12)
    whole, parts = (diagnosed(own) for own in (other, chunked(other, [30, 30, 41])[0]))
    assert whole.continuity_verdict == FAILED
    for name in ("continuity_defect_x", "continuity_bound_v_x", "continuity_time", "continuity_steps"):
        assert whole[name].values.tobytes() == parts[name].values.tobytes()


def test_sums_of_two_floats() -> None:
    """Assert that a rest that is off by less than a float tells is seen."""
    model = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
    run = xd.simulate(model, method="rk4", step="10 ms", until="0.5 s", precision="double_double")
    found = diagnosed(run)
    assert found.continuity_verdict == PASSED
    assert found.continuity_bound_x < 1e-28
    assert diagnosed(changed(run, "rest_x", 20, 1 + 1e-9)).continuity_verdict == FAILED

"""Extremes of runs: states, forces, contact forces, observables against closed forms; rules; in sweeps and in budgets.

Extremes of many elements: their rates are evaluated as arrays, and not at more states than memory holds.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS, particle
from xdynamics.documenting.summary import summary
from xdynamics.evidence.diagnosing import extremes, summits
from xdynamics.evidence.diagnosing.extremes import find_extreme
from xdynamics.evidence.grid_axes import member_number_names
from xdynamics.record.flag_words import words_of_flag

BALL = xd.Model.from_toml(MODELS / "ball_drag.toml")
FINE: dict[str, Any] = {"method": "dop853", "rtol": 1e-12}


def rule(found: xr.Dataset, name: str) -> str:
    """The rule of an extreme, in words."""
    return words_of_flag(found[f"{name}_rule"])[0]


def swinging(k: float, m: float, x: float, v: float) -> xd.Model:
    """A mass on a spring, with its power and a load that is largest where it is fastest."""
    return particle(
        name="swinging",
        parameters={"m": f"{m!r} kg", "k": f"{k!r} N m-1"},
        forces={"spring": {"potential": "k*x**2/2"}},
        observables={"load": "-3*newton*(v_x*second/(1*metre))**2", "power": "k*x*v_x"},
        initial={"x": f"{x!r} m", "v_x": f"{v!r} m s-1"},
    )


@pytest.mark.cases(200)
def test_extremes_of_a_spring(case: int) -> None:
    """Assert value, sign, time and uncertainty of the largest and least force, load, power and energies of a random swing."""
    rng = np.random.default_rng([case, 3])
    k, m, x, v = (float(one) for one in rng.uniform(0.5, 3.0, 4))
    w, size = math.sqrt(k / m), math.hypot(x, v / math.sqrt(k / m))
    model, end = swinging(k, m, x, v), float(rng.uniform(1.1, 3.0)) * 2.0 * math.pi / w
    found = xd.diagnose(xd.simulate(model, **FINE, until=end, max_step=0.6 / w), companion=False)
    energy = k * size**2 / 2.0
    true = {
        "maximum_force_spring_x": k * size,
        "minimum_force_spring_x": -k * size,
        "minimum_load": -3.0 * (w * size) ** 2,
        "maximum_load": 0.0,
        "maximum_power": w * energy,
        "minimum_power": -w * energy,
        "maximum_kinetic_energy": energy,
        "maximum_potential_energy": energy,
        "maximum_x": size,
        "minimum_v_x": -w * size,
    }
    for name, value in true.items():
        assert abs(float(found[name]) - value) <= float(found[f"{name}_uncertainty"]) + 1e-9 * max(1.0, abs(value)), (
            name
        )
        assert found[name].attrs["units"] == found[f"{name}_uncertainty"].attrs["units"]
        assert rule(found, name) in ("interpolated", "sampled")
    phase = w * float(found.maximum_force_spring_x_time) - math.atan2(v / w, x)
    assert math.cos(phase) == pytest.approx(-1.0, abs=1e-6)


def test_rules_of_extremes_are_told() -> None:
    """Assert a force that is least at the start, largest where an event ends the run, and constant."""
    found = xd.diagnose(xd.simulate(BALL, **FINE, until="9 s"), companion=False)
    speed = 20.0 * 30.0 / math.hypot(20.0, 30.0)
    weight = 0.145 * 9.80665
    assert float(found.maximum_force_drag_y) == pytest.approx(weight * (speed / 30.0) ** 2, rel=1e-10)
    assert float(found.minimum_force_drag_y) == pytest.approx(-weight * (20.0 / 30.0) ** 2, rel=1e-14)
    assert rule(found, "maximum_force_drag_y") == "located"
    assert rule(found, "minimum_force_drag_y") == "sampled"
    assert float(found.minimum_force_drag_y_time) == 0.0
    assert float(found.maximum_force_gravity_y) == float(found.minimum_force_gravity_y) == -weight


def resting() -> xd.Model:
    """A mass on a floor, pressed by a force that swings."""
    return xd.Model(
        name="pressed",
        coordinates={"y": "m"},
        parameters={"m": "2 kg", "F": "5 ± 0.1 N"},
        mass={"y": "m"},
        forces={"weight": {"y": "-m*9.81*newton/kilogram"}, "press": {"y": "F*sin(3*t/second)"}},
        contacts={"floor": {"gap": "y", "restitution": 0.0}},
        initial={"y": "0 m", "v_y": "0 m s-1"},
    )


def test_the_largest_contact_force_lies_between_accepted_states() -> None:
    """Assert m g + F of a floor, by coarse steps, and its least value."""
    found = xd.diagnose(xd.simulate(resting(), method="rk4", step="0.37 s", until="5 s"), companion=False)
    assert float(found.maximum_contact_force_floor) == pytest.approx(2 * 9.81 + 5.0, rel=1e-9)
    assert float(found.minimum_contact_force_floor) == pytest.approx(2 * 9.81 - 5.0, rel=1e-9)
    assert rule(found, "maximum_contact_force_floor") == "interpolated"
    assert found.maximum_contact_force_floor.attrs["units"] == "N"


def test_forces_in_python_are_sampled_and_say_how_far_that_may_be_off() -> None:
    """Assert the largest accepted state, and that the true one is within twice what the parabola tells."""

    def push(t: float) -> float:
        return math.sin(t)

    run = xd.simulate(particle(push), method="rk4", step="0.35 s", until="3 s")
    found = xd.diagnose(run, companion=False, functions={"push": push})
    assert rule(found, "maximum_force_push_x") == "sampled"
    assert float(found.maximum_force_push_x) == float(run.force_push_x.max())
    off = 1.0 - float(found.maximum_force_push_x)
    assert 0.5 * off <= float(found.maximum_force_push_x_uncertainty) <= 2.0 * off


@pytest.mark.every(3)
@pytest.mark.parametrize(("peak", "node"), [(1.3, 1.2), (0.95, 1.17), (0.4, 1.2), (-0.5, 1.0)])
def test_a_parabola_in_python_is_off_by_what_its_rows_tell(peak: float, node: float) -> None:
    """Assert its height above the highest row, by steps of other lengths on either side; 0 where it is at either end."""

    def push(t: float, peak: float) -> float:
        return 2.0 - 3.0 * (t - peak) ** 2

    model = particle(push, parameters={"m": "1 kg", "peak": f"{peak} s"})
    run = xd.simulate(model, method="rk4", step="0.35 s", until="3 s", nodes=[node])
    found = xd.diagnose(run, companion=False, functions={"push": push})
    above = 2.0 - float(run.force_push_x.max()) if 0.0 < peak < 3.0 else 0.0
    assert float(found.maximum_force_push_x_uncertainty) == pytest.approx(above, abs=1e-12)
    assert float(found.minimum_force_push_x_uncertainty) == 0.0


def test_an_event_at_the_top_of_a_force_in_python_is_all_there_is_to_know() -> None:
    """Assert value and rule of a force that is largest at an event, and that it is not uncertain by a parabola."""

    def push(t: float) -> float:
        return 2.0 - 3.0 * (t - 1.3) ** 2

    model = particle(push, events={"top": {"function": "t - 1.3*second"}})
    found = xd.diagnose(
        xd.simulate(model, method="rk4", step="0.35 s", until="3 s"), companion=False, functions={"push": push}
    )
    assert (rule(found, "maximum_force_push_x"), float(found.maximum_force_push_x)) == ("located", pytest.approx(2.0))
    assert float(found.maximum_force_push_x_uncertainty) == 0.0


@pytest.mark.dear
def test_a_sweep_has_what_a_diagnosis_has(request: pytest.FixtureRequest) -> None:
    """Assert the same bits of extremes of forces, contact forces and energies, of members, with time, rule and doubt.

    Of 80 members that are marched in lanes every ninth is diagnosed, or with --whole each.
    """
    each = 1 if request.config.getoption("--whole") else 9
    for model, axis, names, settings in (
        (
            BALL,
            {"vt": ["20 m s-1", "30 m s-1"]},
            ("force_drag_y", "kinetic_energy"),
            {"method": "rk4", "step": "70 ms", "until": "5 s"},
        ),
        (
            resting(),
            {"F": ["3 N", "5 N"]},
            ("contact_force_floor", "force_press_y"),
            {"method": "rk4", "step": "0.37 s", "until": "5 s"},
        ),
        (
            swinging(2.0, 1.5, 1.0, 0.7),
            {"k": [f"{0.5 + 0.02 * i!r} N m-1" for i in range(80)]},
            ("x", "power", "load"),
            {"method": "dop853", "rtol": 1e-5, "until": "9 s"},
        ),
        (
            swinging(2.0, 1.5, 1.0, 0.7),
            {"k": ["1 N m-1", "3 N m-1"]},
            ("power", "v_x"),
            {"method": "radau_iia", "rtol": 1e-5, "until": "9 s"},
        ),
    ):
        words = [f"{word}_{name}" for word in ("maximum", "minimum") for name in names]
        grid = xd.sweep(model, axis, keep=words, **settings).compute()
        values = next(iter(axis.values()))
        for k in range(0, len(values), each if len(values) > each else 1):
            value = values[k]
            one = xd.diagnose(
                xd.simulate(model.replace(parameters={next(iter(axis)): value}), **settings), companion=False
            )
            for word in words:
                for end in ("", "_time", "_uncertainty"):
                    assert float(grid[word + end][k]) == float(one[word + end]), word + end
                    assert grid[word + end].attrs["units"] == one[word + end].attrs["units"]
                assert rule(grid.isel({next(iter(axis)): k}), word) == rule(one, word)


def test_rules_of_members_differ_and_are_told() -> None:
    """Assert events, starts and states between in one sweep, in its lines too; and that neither slopes nor panels are drawn of them."""
    grid = xd.sweep(
        BALL,
        {"v_y": ["20 m s-1", "0 m s-1", "-1 m s-1"]},
        keep=["maximum_y", "maximum_force_drag_y"],
        until="9 s",
        **FINE,
    ).compute()
    assert words_of_flag(grid.maximum_y_rule) == ["located", "sampled", "sampled"]
    assert (grid.maximum_y_uncertainty == 0.0).all()
    assert "maximum_y_rule is sampled in 2, located in 1" in summary(grid)
    assert (
        {"maximum_y", "maximum_force_drag_y"}
        <= {*member_number_names(grid)}
        <= {name for name in grid if not name.endswith(("_rule", "_uncertainty"))}
    )


@pytest.mark.dear
def test_a_force_in_python_is_sampled_in_sweeps_too() -> None:
    """Assert value, rule and what a parabola goes beyond it, of every member as of its run alone."""

    def push(t: float, w: float) -> float:
        return math.sin(w * t)

    model = particle(
        name="pushed",
        parameters={"m": "1 kg", "w": "1 rad s-1"},
        forces={"push": {"x": push}},
        initial={"x": "0 m", "v_x": "0 m s-1"},
    )
    asked: dict[str, Any] = {"method": "rk4", "step": "0.35 s", "until": "3 s"}
    grid = xd.sweep(model, {"w": ["0.2 rad s-1", "1 rad s-1"]}, keep=["maximum_force_push_x"], **asked).compute()
    for k, w in enumerate(("0.2 rad s-1", "1 rad s-1")):
        run = xd.simulate(model.replace(parameters={"w": w}), **asked)
        one = xd.diagnose(run, companion=False, functions={"push": push})
        for end in ("", "_time", "_uncertainty"):
            assert float(grid[f"maximum_force_push_x{end}"][k]) == float(one[f"maximum_force_push_x{end}"])
        assert rule(grid.isel(w=k), "maximum_force_push_x") == rule(one, "maximum_force_push_x") == "sampled"
    assert float(grid.maximum_force_push_x_uncertainty[1]) > 0.0


@pytest.mark.cases(60)
def test_budgets_of_extremes_hold_closed_forms(case: int) -> None:
    """Assert bound, slopes with their signs, and rule of the largest and least load of random springs and balls."""
    rng = np.random.default_rng([case, 4])
    method, step = str(rng.choice(["rk4", "velocity_verlet", "dormand_prince"])), float(rng.uniform(0.01, 0.05))
    k, m, x = (float(one) for one in rng.uniform(0.5, 3.0, 3))
    model = swinging(k, m, x, 0.0).replace(parameters={"k": f"{k!r} ± {0.01 * k!r} N m-1"})
    word, sign = [("maximum", 1.0), ("minimum", -1.0)][case % 2]
    budget = xd.error_budget(model, f"{word}_force_spring_x", method=method, step=step, until=9.0 * math.sqrt(m / k))
    assert abs(float(budget.value) - sign * k * x) <= float(budget.numerical_bound) + 2.0**-52 * k * x
    i = budget["term_name"].values.tolist().index("k")
    assert float(budget.sensitivity[i]) == pytest.approx(sign * x, rel=1e-3)
    assert budget.attrs["of"] == f"{word} of force_spring_x"
    assert budget.attrs["extreme_rule"] in ("interpolated", "sampled", "located")


@pytest.mark.dear
def test_an_extreme_is_budgeted_certified_and_made_again(tmp_path: Path) -> None:
    """Assert rule and place in lines, gates, the same from the file alone, and the verb."""
    from click.testing import CliRunner

    from xdynamics.cli import main

    asked = {"method": "dormand_prince", "rtol": 1e-8, "until": "4 s"}
    found = xd.certify(BALL, "maximum_force_drag_y", draws=100, seed=3, **asked)
    speed = 20.0 * 30.0 / math.hypot(20.0, 30.0)
    assert float(found.value) == pytest.approx(0.145 * 9.80665 * (speed / 30.0) ** 2, rel=1e-7)
    assert found.attrs["extreme_rule"] == "located"
    assert float(found.attrs["extreme_time"]) == pytest.approx(3.7112, abs=1e-4)
    assert "found     located by an event, at t = 3.71" in "\n".join(summary(found))
    xd.save(found, tmp_path / "C.nc")
    assert xd.recheck(tmp_path / "C.nc").attrs["result"] == found.attrs["result"]
    said = CliRunner().invoke(
        main,
        [
            "budget",
            str(MODELS / "ball_drag.toml"),
            "--quantity",
            "minimum_force_drag_y",
            "--rtol",
            "1e-7",
            "--method",
            "dormand_prince",
        ],
    )
    assert said.exit_code == 0, said.output
    assert "minimum of force_drag_y = -0.632" in said.output
    assert "found     sampled at an accepted state, at t = 0 s" in said.output


@pytest.mark.parametrize("quantity", ["maximum_force_wind_y", "largest_force_drag_y", "force_drag_y", "maximum_t", ""])
def test_an_extreme_that_is_none_is_named(quantity: str) -> None:
    """Assert one clear error that shows how extremes are called."""
    with pytest.raises(xd.InputError, match="or neither of an extreme like 'maximum_y'"):
        xd.error_budget(BALL, quantity, **FINE)


@pytest.mark.every(3)
@pytest.mark.parametrize(("unit", "factor"), [("m", 1.0), ("mm", 1e-3), ("km", 1e3)])
def test_an_extreme_is_uncertain_by_all_that_it_reads(unit: str, factor: float) -> None:
    """Assert value, time and what the errors of place and speed there come to, in any unit, of a power and of a place."""
    model = swinging(2.0, 1.5, 1.0, 0.7).replace(
        coordinates={"x": unit}, initial={"x": f"{1.0 / factor!r} {unit}", "v_x": f"{0.7 / factor!r} {unit} s-1"}
    )
    run = xd.simulate(model, method="rk4", step=0.5, until=5.0)
    found, scale = xd.diagnose(run, companion=False), float(run.power.attrs["units"] == "W") or factor**2
    w, size = math.sqrt(2.0 / 1.5), math.hypot(1.0, 0.7 / math.sqrt(2.0 / 1.5))
    assert float(found.maximum_x) * factor == pytest.approx(size, rel=2e-2)
    assert float(found.minimum_power) * scale == pytest.approx(-w * size**2, rel=5e-2)
    for name in ("maximum_power", "minimum_power"):
        at = xd.sample(run, [float(found[f"{name}_time"])], side="before")
        x, v, ex, ev = (float(at[name][0]) * factor for name in ("x", "v_x", "error_x", "error_v_x"))
        assert rule(found, name) == "interpolated"
        assert float(found[name]) * scale == pytest.approx(2.0 * x * v, rel=1e-12)
        assert float(found[f"{name}_uncertainty"]) * scale == pytest.approx(2.0 * (abs(ex * v) + abs(x * ev)), rel=1e-6)
        sign = 1.0 if name.startswith("max") else -1.0
        alone = find_extreme(run, "power", sign, None)
        assert (alone.value, alone.time) == (float(found[name]), float(found[f"{name}_time"]))
    at = xd.sample(run, [float(found.maximum_x_time)], side="before")
    assert float(found.maximum_x_uncertainty) == abs(float(at.error_x[0])) > 0.0
    assert abs(float(at.v_x[0])) * factor < 1e-7
    assert float(found.maximum_x) == float(at.x[0])


def test_extremes_at_events_are_located() -> None:
    """Assert the speed before a reset as the largest, the one behind it as the least, without uncertainty, and when."""
    model = xd.Model(
        name="back",
        coordinates={"y": "m"},
        mass={"y": "1*kilogram"},
        forces={"gravity": {"y": "-10*newton"}},
        initial={"y": "1 m", "v_y": "0 m s-1"},
        events={"back": {"function": "y", "direction": "falling", "action": "reset", "set": {"v_y": "-v_y"}}},
    )
    found = xd.diagnose(xd.simulate(model, method="rk4", step=0.1, until=0.8), companion=False)
    for name, sign in (("maximum_v_y", 1.0), ("minimum_v_y", -1.0)):
        assert (rule(found, name), float(found[f"{name}_uncertainty"])) == ("located", 0.0)
        assert float(found[name]) == pytest.approx(sign * math.sqrt(20.0))
        assert float(found[f"{name}_time"]) == pytest.approx(math.sqrt(0.2))
    assert (rule(found, "maximum_y"), float(found.maximum_y_time)) == ("sampled", 0.0)


def test_forces_that_no_expression_gives_are_left_out() -> None:
    """Assert that a box of discs is diagnosed, whose contact forces are found by iteration."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "granular_box.toml"), method="dormand_prince", rtol=1e-6, until=0.02)
    found = xd.diagnose(run, companion=False)
    assert "maximum_r" in found
    assert not [name for name in found if "contact_force" in str(name)]


CLUSTER = """
name = "cluster"
[dimensions]
body = 4
axis = ["x", "y"]
[relations.pair]
of = "body"
[coordinates]
r = { unit = "m", dims = ["body", "axis"] }
[states.heat]
unit = "J"
rate = "1*watt*sin(2*radian*t/second) - 0.3*heat/second"
dims = ["body"]
[parameters]
k = "2 N m-1"
[mass]
r = "1*kilogram"
[forces.springs]
over = "pair"
potential = "k*norm(second(r, pair) - first(r, pair), axis)**4/(1*metre)**2"
[observables]
spread = "r - mean(r, body)"
[initial]
r = { unit = "m", value = [[0.0, 0.1], [1.0, 0.0], [0.9, 1.1], [-0.2, 0.8]] }
heat = { unit = "J", value = [0.1, 0.2, 0.3, 0.4] }
[run]
method = "rk4"
step = "0.02 s"
until = "4 s"
"""


@pytest.fixture(scope="module")
def run() -> xr.Dataset:
    """March four bodies that attract each other, with heats of their own."""
    return xd.simulate(xd.Model.from_text(CLUSTER))


def told_apart(*_given: object) -> xr.Dataset:
    raise AssertionError("elements were told apart")


def found(run: xr.Dataset) -> xr.Dataset:
    """Return the extremes of what steps integrate."""
    diagnosis = xd.diagnose(run, companion=False)
    words = [f"{word}_{name}" for name in ("r", "v_r", "heat") for word in ("maximum", "minimum")]
    return diagnosis[[f"{word}{end}" for word in words for end in ("", "_time", "_rule", "_uncertainty")]]


@pytest.mark.parametrize("chunks", [None, 90])
def test_elements_side_by_side_have_the_bits_of_elements(
    run: xr.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, chunks: int | None
) -> None:
    """Assert that all that is diagnosed of a large model is what is diagnosed of single elements, bit for bit."""
    if chunks:
        xd.save(run, tmp_path / "run.nc")
        run = xd.open_run(tmp_path / "run.nc", chunks={"step": chunks})
    expected = xd.diagnose(run, of="r[2, y]", companion=chunks is None)
    monkeypatch.setattr(extremes, "MOST_NAMES", 0)
    monkeypatch.setattr("xdynamics.record.unfolding._split_elements", told_apart)
    large = xd.diagnose(run, of="r[2, y]", companion=chunks is None)
    for word in ("v_r", "heat"):
        assert (expected[f"maximum_{word}_rule"] == summits.INTERPOLATED).any()
    assert {"energy_drift", "drift_spread", "drift_momentum_r", "maximum_heat"} <= {*large.data_vars}
    assert large.sizes["cycle"] > 1
    assert large.sizes["turn"] > 3
    forces = [name for name in expected.data_vars if name not in large]
    assert {str(name).split("_")[0] for name in forces} == {"maximum", "minimum"}  # of forces, energies and observables
    xr.testing.assert_identical(large.drop_attrs(deep=False), expected.drop_vars(forces).drop_attrs(deep=False))


def test_too_many_states_are_not_evaluated(run: xr.Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that extremes are then accepted states, off by no more than they are said to be."""
    between = found(run)
    monkeypatch.setattr(extremes, "MOST_NUMBERS", 1)
    accepted = found(run)
    monkeypatch.setattr(extremes, "MOST_NAMES", 0)
    large = found(run)
    xr.testing.assert_identical(large.drop_attrs(deep=False), accepted.drop_attrs(deep=False))
    for name in ("r", "v_r", "heat"):
        assert (accepted[f"maximum_{name}_rule"] == summits.SAMPLED).all()
        np.testing.assert_array_equal(accepted[f"maximum_{name}"], run[name].max("step"))
        off = between[f"maximum_{name}"] - accepted[f"maximum_{name}"]
        assert (off >= 0.0).all()
        assert (off > 0.0).any()
        assert (off <= 1.001 * accepted[f"maximum_{name}_uncertainty"]).all()

"""What errors of given absolute tolerances come to: warned of where motion is lost, silent where nothing is, and in the record.

What speaks against a run is said: steps beyond stability, a mass matrix that is nearly singular.
Energies of many elements that a record leaves out: they are not computed, and all else has the same bits.
"""

from __future__ import annotations

import math
import re
import tomllib
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS, oscillator, particle
from xdynamics.kernels.law import ROW_ENERGIES, law_of
from xdynamics.kernels.model_programs import row
from xdynamics.march.configuration import settings_for
from xdynamics.schema import ATOL_EFFECT


def orbit(mean: float, e: float, rate: float, unit: str) -> xd.Model:
    """A planet from its perihelion; mean distance in m."""
    return xd.Model(
        name="orbit",
        coordinates={"x": unit, "y": unit},
        mass={"x": "m", "y": "m"},
        parameters={"mu": f"{rate**2 * mean**3!r} m3 s-2", "m": "1 kg"},
        forces={"gravity": {q: f"-m*mu*{q}/(x**2 + y**2)**1.5" for q in "xy"}},
        initial={
            "x": f"{mean * (1 - e)!r} m",
            "y": "0 m",
            "v_x": "0 m s-1",
            "v_y": f"{rate * mean * math.sqrt((1 + e) / (1 - e))!r} m s-1",
        },
    )


def spring(size: float, rate: float, offset: float, damping: float, unit: str) -> xd.Model:
    """A mass on a spring that hangs somewhere."""
    return xd.Model(
        name="spring",
        coordinates={"x": unit},
        mass={"x": "m"},
        parameters={
            "k": f"{rate**2!r} N m-1",
            "c": f"{2 * damping * rate!r} kg s-1",
            "m": "1 kg",
            "x0": f"{offset!r} m",
        },
        forces={"spring": {"x": "-k*(x - x0)"}, "damper": {"x": "-c*v_x"}},
        initial={"x": f"{offset + size!r} m", "v_x": "0 m s-1"},
    )


def marched(model: xd.Model, **asked: Any) -> tuple[xr.Dataset, bool]:
    """Return a run, and whether it was warned of."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        run = xd.simulate(model, **{"method": "dop853", "force_samples": "none"} | asked)
    said = any("did not control" in str(one.message) for one in heard)
    assert said == ("did not control" in run.attrs["run_outcome_text"])
    return run, said


def drawn(case: int) -> tuple[xd.Model, float, dict[str, float]]:
    """Return a model of any size and speed, its rate, and how large its coordinates and velocities are."""
    rng = np.random.default_rng(case)
    unit = str(rng.choice(["nm", "mm", "m", "Gm", "astronomical_unit"]))
    size, rate = 10.0 ** rng.uniform(-9, 11), 10.0 ** rng.uniform(-7, 4)
    if case % 2:
        model = orbit(size, float(rng.uniform(0, 0.6)), rate, unit)
    else:
        model = spring(size, rate, size * float(rng.choice([0.0, 30.0])), float(rng.choice([0.0, 0.1])), unit)
    return model, rate, {"x": size, "v_x": size * rate}


@pytest.mark.every(2)
@pytest.mark.cases(200)
def test_lost_and_kept_motions(case: int) -> None:
    """Assert a warning wherever 3 in 100 of a motion are lost by absolute tolerances, and none where less than 1e-8 is."""
    rng = np.random.default_rng(50_000 + case)
    model, rate, large = drawn(case)
    names = [*model.elements.statement.coordinates]
    until, rtol = 2 * math.pi / rate * 10.0 ** rng.uniform(-0.3, 1.5), 10.0 ** rng.uniform(-10, -7)
    part = {"x": 10.0 ** rng.uniform(-14, 0), "v_x": 10.0 ** rng.uniform(-14, 0)}
    atol = dict.fromkeys(names, f"{part['x'] * large['x']!r} m")
    atol |= {f"v_{name}": f"{part['v_x'] * large['v_x']!r} m s-1" for name in names}
    method = str(rng.choice(["dop853", "dormand_prince", "radau_iia"]))
    run, said = marched(model, method=method, rtol=rtol, atol=atol, until=until)
    finest = marched(model, rtol=1e-12, until=until)[0]
    off = xd.compare(run, finest)
    lost = max(
        float(np.abs(off[f"difference_{name}"]).max()) / float(np.abs(finest[name] - finest[name].mean()).max())
        for name in names
    )
    relative = marched(model, method=method, rtol=rtol, until=until)[0]
    own = max(float(np.abs(xd.compare(relative, finest)[f"difference_{name}"]).max()) for name in names) / large["x"]
    assert not (lost > 0.03 + 10 * own and not said), (lost, own, run.attrs[ATOL_EFFECT])
    assert not (said and lost < 1e-8), (lost, run.attrs[ATOL_EFFECT])
    assert run.attrs[ATOL_EFFECT]


RESTING = {
    "a pendulum that hangs": ("-9.8*sin(th)", 0.0),
    "a pendulum by the other angle": ("9.8*sin(th)", math.pi),
    "a spring that is not stretched": ("-4*(th - 1000.1)", 1000.1),
    "drag from rest": ("-3*v_th*second/radian", 2.0),
}


@pytest.mark.every(3)
@pytest.mark.parametrize("name", RESTING)
@pytest.mark.parametrize("method", ["dop853", "dormand_prince", "radau_iia"])
@pytest.mark.parametrize("atol", [1e-6, 1e-9])
def test_what_rests_is_silent(name: str, method: str, atol: float) -> None:
    """Assert no warning of what is rounding beside its place, and stays so however tolerances are."""
    torque, start = RESTING[name]
    torque = torque.replace("(th - 1000.1)", "(th/radian - 1000.1)")
    model = xd.Model(
        name=name,
        coordinates={"th": "rad"},
        parameters={"I": "1 kg m2"},
        mass={"th": "I/radian**2"},
        forces={"all": {"th": f"newton*metre/radian*({torque})"}},
        initial={"th": f"{start!r} rad", "v_th": "0 rad s-1"},
    )
    run, said = marched(model, method=method, atol=atol, until=20.0)
    assert not said, run.attrs["run_outcome_text"]


def test_an_orbit_in_astronomical_units() -> None:
    """Assert silence for speeds of 330 times a tolerance, or loose places alone, where the other holds the steps; both are warned of."""
    model = orbit(1.495978707e11, 0.3, 2e-7, "astronomical_unit")
    place, speed = (
        dict.fromkeys(names, f"{size} astronomical_unit{per}")
        for names, size, per in ((("x", "y"), 1e-3, ""), (("v_x", "v_y"), 6e-10, " s-1"))
    )
    for atol, years, least, most in (
        (6e-10, 1, 0.0, 1e-8),
        (speed, 1, 0.0, 1e-8),
        (place, 10, 0.0, 1e-6),
        (place | speed, 10, 0.02, 1.0),
    ):
        until = years * 3.14e7
        run, said = marched(model, rtol=1e-9, atol=atol, until=until)
        off = xd.compare(run, marched(model, rtol=1e-12, until=until)[0])
        lost = max(float(np.abs(off[f"difference_{name}"]).max()) for name in ("x", "y"))
        assert least <= lost <= most, lost
        assert said == (least > 0.0), run.attrs[ATOL_EFFECT]
        assert "times their size over the run; followed from 2 of its rows" in run.attrs[ATOL_EFFECT]
    assert ATOL_EFFECT not in marched(model, rtol=1e-9, until=3.14e7)[0].attrs


def test_where_it_was_not_looked_at() -> None:
    """Assert the reason in the record: contacts, resets, nothing above the relative tolerance."""
    ball = xd.Model.from_toml(MODELS / "bouncing_ball.toml")
    assert "not looked at: contacts or friction act" in marched(ball, atol=1e-3, until=1.0)[0].attrs[ATOL_EFFECT]
    model = spring(1.0, 1.0, 0.0, 0.0, "m")
    kick = {"kick": {"function": "x", "action": "reset", "set": {"v_x": "-v_x"}}}
    kicked = xd.Model(**tomllib.loads(model.to_toml()) | {"events": kick})
    assert "not looked at: events set the state" in marched(kicked, atol=1e-3, until=1.0)[0].attrs[ATOL_EFFECT]
    assert "no atol is above 10 rtol" in marched(model, rtol=1e-6, atol=1e-7, until=1.0)[0].attrs[ATOL_EFFECT]


@pytest.mark.parametrize("thinned", [{}, {"keep_every": 7}])
def test_a_run_that_was_extended_says_the_same(thinned: dict[str, int], tmp_path: Path) -> None:
    """Assert the words of a march in one go, of errors that only a part of its rows tells."""
    model = spring(1.0, 1.0, 0.0, 0.1, "m")
    asked: dict[str, Any] = {
        "method": "dormand_prince",
        "rtol": 1e-9,
        "atol": {"x": "1e-3 m", "v_x": "1e-9 m s-1"},
        "nodes": [200.0],
        "max_step": 0.5,
    } | thinned
    marched(model, until=300.0, path=tmp_path / "whole.nc", **asked)
    marched(model, until=200.0, path=tmp_path / "part.nc", **asked | {"nodes": []})
    whole, longer = xd.open_run(tmp_path / "whole.nc"), xd.extend(tmp_path / "part.nc", until=300.0)
    assert whole.attrs[ATOL_EFFECT] == longer.attrs[ATOL_EFFECT]


def test_a_first_step_that_leaves_the_start_behind_is_told_of_implicit_methods_too() -> None:
    """Assert a warning where P/v at 1 um/s makes of the first step a speed of kilometres a second."""
    car = particle(
        name="car",
        parameters={"m": "1 kg", "P": "4 W"},
        forces={"engine": {"x": "P/v_x"}},
        initial={"x": "0 m", "v_x": "1 um s-1"},
    )
    with pytest.warns(xd.AccuracyWarning, match="times as long as the fastest change of the forces at the start"):
        run = xd.simulate(car, method="implicit_velocity_verlet", step="5 ms", until="2 s")
    assert float(run.v_x[-1]) > 100.0


def told(method: str, step: float, until: float) -> str:
    """Return the warning of a run of the oscillator, w = 2 s-1; empty if there is none."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        xd.simulate(oscillator().model, method=method, step=step, until=until, force_samples="none")
    assert len(heard) <= 1
    return str(heard[0].message) if heard else ""


def pair(excess: float | str, **how: str) -> xd.Model:
    """Two coordinates that share a mass but for a small part."""
    return xd.Model(
        name="pair",
        coordinates={"x": {"unit": "m"}, "y": {"unit": "mm"}},
        parameters={"m": "1 kg", "k": "1 N m-1", "u": "1 m"},
        mass={"matrix": [["m", "m"], ["m", f"m*(1 + {excess})"]]},
        forces={"spring": {"x": "-k*x", "y": "-k*y"}},
        initial={"x": "1 m", "y": "0 m", "v_x": "0 m s-1", "v_y": "0 m s-1"} | how,
    )


@pytest.mark.every(3)
@pytest.mark.parametrize("method", ["velocity_verlet", "rk4", "kahan_li8", "dormand_prince"])
def test_the_limit_is_that_of_modes_whatever_the_run_is_long(method: str) -> None:
    """Assert that `modes` and the warning of a short and a long run name one limit, and shorter steps are silent."""
    table = xd.modes(oscillator().model)
    limit = float(table.largest_stable_step[list(xd.METHODS).index(method)])
    for until in (5.0, 500.0):
        said = told(method, 1.02 * limit, until)
        assert float(re.search(r"stability limit (\S+) s", said)[1]) == pytest.approx(limit, rel=1e-5)
        assert told(method, 0.98 * limit, until) == ""


@pytest.mark.dear
def test_a_method_without_a_stable_step_says_why_it_warns() -> None:
    """Assert that what is always unstable, by `modes` too, warns where errors grow e times within the run, and says so."""
    assert float(xd.modes(oscillator().model).largest_stable_step[list(xd.METHODS).index("heun")]) == 0.0
    assert told("heun", 0.3, 5.0) == ""
    said = told("heun", 0.3, 500.0)
    assert "no step of 'heun' is stable" in said
    assert "Within this run of 500 s, a step of " in said
    assert "multiplies them by more than e (2.7), one of up to 0.1 s by less" in said
    stable = re.findall(r"(\w+) \(up to (\S+) s\)", said)
    assert [name for name, _ in stable] == ["velocity_verlet", "rk4", "dormand_prince"]
    for name, limit in stable:
        assert told(name, 0.98 * float(limit), 500.0) == ""
    # (w h)**4/8 a step: e times in 8/(w**4 h**3), where the short cut by the size of the step does not help
    assert "Within this run of 30000 s" in told("heun", 0.04, 30_000.0)


@pytest.mark.parametrize(
    ("excess", "digits"), [("1e-12", "condition 4e.12 at t = 0 s: .* about 3 are right"), ("4e-16", "about 0")]
)
@pytest.mark.parametrize("how", [{"step": 1e-9}, {"rtol": 1e-6}])
def test_a_singular_mass_is_said(excess: str, digits: str, how: dict[str, float]) -> None:
    """Assert that accelerations of few digits are called so, in the outcome and by a warning, whatever the units."""
    asked = {"method": "dormand_prince", "until": 5e-9, "force_samples": "none"} | how
    with pytest.warns(xd.AccuracyWarning, match=f"nearly singular, of {digits}" if "cond" in digits else digits):
        run = xd.simulate(pair(excess), **asked)
    assert "the mass matrix is nearly singular" in run.attrs["run_outcome_text"]


def test_a_mass_that_becomes_singular_on_the_way_is_said() -> None:
    """Assert that the matrix is looked at along the run, not at its start alone."""
    model = pair("exp(-15*t/(1*second))", v_x="1 m s-1").replace(parameters={"k": 0.0})
    with pytest.warns(xd.AccuracyWarning, match=r"nearly singular, of condition .* at t = (1\.[5-9]|2)"):
        xd.simulate(model, method="midpoint", step=1.0 / 64.0, until=2.0, force_samples="none")


def test_an_ordinary_mass_is_not_talked_about() -> None:
    """Assert that a double pendulum has nothing of it in its outcome."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "double_pendulum.toml"), method="rk4", step=0.01, until=1.0)
    assert run.attrs["run_outcome_text"] == "reached t = 1 s"


CLUSTER = """
name = "cluster"
[dimensions]
body = 20
axis = ["x", "y", "z"]
[relations.pair]
of = "body"
[coordinates]
r = { unit = "m", dims = ["body", "axis"] }
[parameters]
G = "1 N m2 kg-2"
m = "1 kg"
[mass]
r = "m"
[forces.gravity]
over = "pair"
potential = "-G*m*m/norm(second(r, pair) - first(r, pair), axis)"
[initial]
r = "9*metre*(sin(1.7*(3*index(body) + index(axis) + 1)))"
[observables]
farthest = { unit = "m", expression = "max(norm(r, axis), body)" }
[events.outside]
function = "max(norm(r, axis), body) - 20*metre"
direction = "rising"
"""
FAST = """
name = "fast"
[dimensions]
body = 3
[coordinates]
x = { unit = "m", dims = ["body"] }
[parameters]
m = "1e200 kg"
F = "1e254 N"
[mass]
x = "m"
[forces.push]
x = "F"
[initial]
x = "0*metre*index(body)"
"""
ASKED = {"method": "velocity_verlet", "step": 0.01, "until": 3.0}


def test_all_else_has_the_bits_of_the_whole_log() -> None:
    """Assert states, events with observables, and the law's text of a record with energies."""
    model = xd.Model.from_text(CLUSTER)
    whole = xd.simulate(model, **ASKED, log="full")
    for log in ("states", ["r", "farthest"]):
        run = xd.simulate(model, **ASKED, log=log)
        assert "total_energy" not in run
        assert run.sizes["event"] == whole.sizes["event"] > 0
        for name, variable in run.variables.items():
            if name not in ("end_memory", "force_source"):
                assert variable.values.tobytes() == whole.variables[name].values.tobytes(), name
        assert str(run["force_source"].values) == str(whole["force_source"].values)
        assert xd.content_digest(xd.complete(run)) == xd.content_digest(whole)


def test_energies_that_are_not_recorded_are_not_computed() -> None:
    """Assert one quotient for each term of the force alone, and those of the energy where it is asked for."""
    model = xd.Model.from_text(CLUSTER)
    layout = settings_for(model, **ASKED).layout(model)
    texts = [law_of(layout, sampled=False, unread=unread).text() for unread in (frozenset(), frozenset({ROW_ENERGIES}))]
    assert texts[0].count("fdiv") > texts[1].count("fdiv")
    assert "total_energy" not in law_of(layout, sampled=False, unread=frozenset({ROW_ENERGIES})).text()
    whole, without = (row(layout, 0, energies=energies).sound for energies in (True, False))
    assert whole is not None
    assert without == (whole[0] + 3, whole[1] - 3)  # what is not written is not judged


@pytest.mark.filterwarnings("ignore:overflow encountered")  # of laws that are not compiled
@pytest.mark.parametrize("log", ["full", ["kinetic_energy"]])
def test_an_energy_that_is_not_finite_ends_a_march_that_records_it(log: str | list[str]) -> None:
    """Assert that 3 m a^2 t^2/2 beyond the largest float ends a run with energies before 1.1 s, and no other."""
    model = xd.Model.from_text(FAST)
    run = xd.simulate(model, **ASKED, log=log)
    assert run.attrs["run_outcome"] == "nonfinite_observable"
    assert 1.0 < run["time"][-1] < 1.1  # 1.5e308 t^2 is 1.8e308 at 1.095 s
    states = xd.simulate(model, **ASKED, log="states")
    assert states.attrs["run_outcome"] == "completed"
    np.testing.assert_allclose(states["x"][-1], 4.5e54, rtol=1e-12)


def test_impacts_of_many_bodies_are_judged_by_energies_that_are_not_recorded() -> None:
    """Assert a run of states alone that has the impacts of the whole log, which are judged by kinetic energies."""
    model = xd.Model.from_toml(MODELS / "granular_box.toml")
    asked = {"method": "velocity_verlet", "step": "1 ms", "until": "0.2 s"}
    whole, states = (xd.simulate(model, **asked, log=log) for log in ("full", "states"))
    assert states.attrs["run_outcome"] == whole.attrs["run_outcome"] == "completed"
    assert states.sizes["event"] == whole.sizes["event"] > 0
    assert states["r"].values.tobytes() == whole["r"].values.tobytes()

"""Refinement: one model over steps or tolerances, what its numbers come to, and how sure they are."""

from __future__ import annotations

import math
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.contacts import ball
from cases.problems import MODELS, particle
from cases.verdicts import verified
from xdynamics.evidence.refining.convergence import VERDICTS, judge

STEPS = {1: 0.01, 2: 0.02, 3: 0.05, 4: 0.05, 5: 0.1, 6: 0.2, 8: 0.3}
OSCILLATOR = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")  # cos 2t


def verdict(study: Any, name: str, k: int = 0) -> str:
    """The word of a verdict."""
    return VERDICTS[int(study[f"verdict_{name}"][k])]


@pytest.mark.every(11)
@pytest.mark.parametrize("method", [name for name, one in xd.METHODS.items() if one.stepper.locates])
def test_orders_and_uncertainties_of_every_method(method: str) -> None:
    """Assert that asymptotic numbers have the method's order or a whole one above, and no error is beyond its uncertainty."""
    formal = xd.METHODS[method].order
    steps = [STEPS[formal] / 2**k for k in range(5)]
    study = xd.refine(OSCILLATOR, method=method, steps=steps, at=[2.4], until=2.4, estimator="none")
    assert study.attrs["formal_order"] == formal
    for name, true in (("x", math.cos(4.8)), ("v_x", -2 * math.sin(4.8))):
        order = float(study[f"order_{name}"][-2, 0])
        if verdict(study, name) == "asymptotic":
            assert abs(order - max(formal, round(order))) <= 0.05
        assert abs(float(study[name][-1, 0]) - true) <= float(study[f"uncertainty_{name}"][0]) + 2e-16


def test_the_limit_is_nearer_than_the_finest_level() -> None:
    """Assert Richardson's limit, differences, digests and units."""
    study = xd.refine(OSCILLATOR, method="rk4", steps=["40 ms", "20 ms", "10 ms"], at=["1 s", "1.234 s"], until="2 s")
    true = np.cos(2 * study.at_time.values)
    assert (np.abs(study.limit_x - true) < np.abs(study.x[-1] - true) / 20).all()
    assert np.array_equal(study.difference_x[:-1], np.diff(study.x, axis=0))
    assert np.isnan(study.difference_x[-1]).all()
    assert study.difference_x.attrs["units"] == study.uncertainty_x.attrs["units"] == "m"
    assert len({*study.run_digest.values}) == 3
    assert study.attrs["runs"].split() == list(study.run_digest.values)
    same = xd.simulate(OSCILLATOR, method="rk4", step="10 ms", until="2 s", force_samples="none")
    assert study.run_digest.values[-1] == xd.content_digest(same)
    assert float(study.interpolation_error_x[0, 0]) == 0.0 < float(study.interpolation_error_x[0, 1])
    assert (study.gate_x == 0).all()


def test_event_times_converge_too() -> None:
    """Assert apex and landing of a ball with quadratic drag against their closed form (apex: vt/g atan(v/vt))."""
    model = xd.Model.from_toml(MODELS / "ball_drag.toml")
    study = xd.refine(model, method="midpoint", steps=[0.1 / 2**k for k in range(5)])
    g, vt, v = (one.quantity.si for one in (model.parameters["g"], model.parameters["vt"], model.parameters["vt"]))
    v = model.initial["v_y"].si
    apex = vt / g * math.atan(v / vt)
    assert float(study.limit_event_time_apex[0]) == pytest.approx(apex, abs=1e-7)
    assert abs(float(study.event_time_apex[-1, 0]) - apex) <= float(study.uncertainty_event_time_apex[0])
    assert verdict(study, "event_time_ground") == "asymptotic"
    assert study.event_count_ground.values.tolist() == [1] * 5
    assert study.event_time_apex.dims == ("level", "occurrence")


def test_what_is_exact_is_at_roundoff() -> None:
    """Assert the verdict where a method has no error: free fall by a method of order 2."""
    study = xd.refine(ball(1.0, 1.0), method="velocity_verlet", steps=[0.02, 0.01, 0.005], at=[0.4], until=0.4)
    assert verdict(study, "y") == "roundoff"
    assert float(study.uncertainty_y[0]) < 1e-13


def test_loose_events_limit_what_steps_can_do() -> None:
    """Assert the verdict behind a bounce whose time is known to a tenth of a millisecond only."""
    model = ball(0.8, 1.0, time_tolerance="1e-4 s")
    study = xd.refine(model, method="euler_cromer", steps=[2e-4, 1e-4, 5e-5], at=[0.7], until=0.7)
    assert verdict(study, "y") == "event_limited"


def test_a_kink_that_is_stepped_over_is_not_asymptotic() -> None:
    """Assert that a force with a hidden switch that is declared smooth does not pass for converged at order four."""
    text = OSCILLATOR.to_toml().replace(
        "[initial]", '[forces.stop]\nx = "-8*k*max(x, 0*metre)"\nsmooth = true\n\n[initial]'
    )
    study = xd.refine(
        xd.Model.from_text(text), method="rk4", steps=[0.04 / 2**k for k in range(5)], at=[6.0], until=6.0
    )
    assert verdict(study, "x") != "asymptotic"
    fine = xd.simulate(
        xd.Model.from_text(text.replace("smooth = true\n", "")), method="dop853", rtol=1e-12, atol=1e-13, until=6.0
    )
    assert abs(float(study.x[-1, 0] - fine.x[-1])) <= float(study.uncertainty_x[0])


def test_energies_and_observables_are_compared() -> None:
    """Assert values of what is derived from the state, between rows too, against the run's own at a row."""
    model = xd.Model.from_toml(MODELS / "pendulum.toml")
    study = xd.refine(
        model, method="pefrl", steps=[0.1, 0.05], at=[1.0, 1.02], observables=["theta", "total_energy"], until=2.0
    )
    run = xd.simulate(model, method="pefrl", step=0.05, until=2.0)
    assert float(study.total_energy[-1, 0]) == pytest.approx(float(run.total_energy[20]), rel=1e-14)
    assert float(study.interpolation_error_total_energy[-1, 1]) > 0.0
    assert study.total_energy.attrs["units"] == run.total_energy.attrs["units"]
    assert "v_theta" not in study


def test_tolerances_are_refined() -> None:
    """Assert levels by relative tolerance: the finest is within its uncertainty of the truth."""
    study = xd.refine(OSCILLATOR, method="dop853", rtols=[1e-4, 1e-6, 1e-8, 1e-10], at="3 s", until="3 s")
    assert study.rtol.values.tolist() == [1e-4, 1e-6, 1e-8, 1e-10]
    assert abs(float(study.x[-1, 0]) - math.cos(6.0)) <= float(study.uncertainty_x[0])
    assert study.attrs["formal_order"] == 1.0


H = 0.1 / 2.0 ** np.arange(5)


@pytest.mark.parametrize(
    ("values", "rounding", "interpolation", "events", "said"),
    [
        (1 + 3 * H**4, 1e-16, 0.0, 0.0, "asymptotic"),
        (1 + 3 * H**5, 1e-16, 0.0, 0.0, "asymptotic"),  # more than the method promises
        (1 + 3 * H**2, 1e-16, 0.0, 0.0, "pre_asymptotic"),
        (1 + 3 * H**4, 1e-3, 0.0, 0.0, "roundoff"),
        (1 + 3 * H**4, 1e-16, 1e-3, 0.0, "interpolation_limited"),
        (1 + 3 * H**4, 1e-16, 0.0, 1e-3, "event_limited"),
        (1 + 1e-3 / H, 1e-16, 0.0, 0.0, "not_converging"),
        (np.array([1.0, 0.2, 0.9, -0.3, 0.6]), 1e-16, 0.0, 0.0, "not_converging"),  # a chaotic run, too late
        (np.array([1.0, 1.0, 1.0, 1.0, np.nan]), 1e-16, 0.0, 0.0, "not_converging"),
    ],
)
def test_verdicts_on_planted_cases(
    values: np.ndarray, rounding: float, interpolation: float, events: float, said: str
) -> None:
    """Assert the verdict of each, and that what converges has its limit within the uncertainty."""
    found = judge(values, H, 4.0, rounding, interpolation, events)
    assert VERDICTS[found.verdict] == said
    if said != "not_converging":
        assert abs(values[-1] - 1.0) <= found.uncertainty


def test_the_uncertainty_is_near_the_error(request: pytest.FixtureRequest) -> None:
    """Assert for 200 random smooth cases, with --whole 1,000, that 95 in 100 are held, and the median is within a factor of 3."""
    rng, factors = np.random.default_rng(7), []
    for _ in range(1000 if request.config.getoption("--whole") else 200):
        formal, terms = int(rng.integers(1, 9)), rng.normal(size=3)
        h = 0.5 * 2.0 ** -np.arange(5) * rng.uniform(0.5, 1.0)
        error = terms[0] * h**formal * (1 + terms[1] * h / 2 + terms[2] * h**2 / 2)
        found = judge(0.3 + error, h, formal, 4e-16, 0.0, 0.0)
        factors.append(found.uncertainty / max(abs(error[-1]), 1e-16))
    assert np.mean(np.array(factors) >= 1.0) >= 0.95
    assert 1.0 <= np.median(factors) <= 3.0


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"step": 0.1, "rtol": 1e-3}, "step and rtol are both given; one of them is varied"),
        ({"rtol": "fine"}, "rtol is 'fine', needs a number"),
        ({"step": "1 m"}, "step"),
        ({"steps": [0.1, 0.05], "rtols": [1e-3, 1e-4]}, "one of them"),
        ({"steps": "10 ms"}, "steps is '10 ms', needs a row of them"),
        ({"steps": [0.1]}, "need 2 or more that get smaller"),
        ({"steps": [0.05, 0.1]}, "need 2 or more that get smaller"),
        ({"steps": [0.1, -0.1]}, "all positive"),
        ({"steps": [0.1, 0.05], "at": [9.0]}, "at has 9.0 s, needs times in every run, from 0.0 s to 2.0 s"),
        ({"steps": [0.1, 0.05], "observables": ["q"]}, "observable 'q' is none of the model's; there are x, v_x"),
        ({"steps": [0.1, 0.05], "method": "rk5"}, "rk5"),
        ({"steps": ["1 m", "0.5 m"]}, "step"),
        ({"rules": ["interpolant"]}, "rules are .*, need both of reintegrate, interpolant"),
        ({"rules": ["interpolant", "reintegrate"], "step": 0.1, "until_change": {"x": 1}}, "rules have none"),
        ({"time_tolerances": ["1 m"], "step": 0.1}, "time_tolerances '1 m' has units 'm', needs 's'"),
        ({"rtols": ["fine", 1e-3]}, "rtols has 'fine', needs numbers"),
        ({"steps": [0.1, 0.05], "until_change": {"z": 1}}, "until_change names 'z'; there are x, v_x"),
        ({"steps": [0.1, 0.05], "until_change": {"x": "1 s"}}, "until_change of 'x' is '1 s', needs the unit 'm'"),
        ({"steps": [0.1, 0.05], "until_change": {"x": -1.0}}, "needs a positive one"),
        ({"steps": [0.1, 0.05], "observables": ["period_q"]}, "there are x, v_x, .*period_x, phase_x"),
    ],
)
def test_wrong_studies(asked: dict[str, Any], said: str) -> None:
    """Assert what is said of each."""
    with pytest.raises(xd.InputError, match=said):
        xd.refine(OSCILLATOR, **{"method": "rk4", "until": 2.0} | asked)


def test_the_period_is_the_numeric_one() -> None:
    """Assert the located period against Verlet's own, 2 pi h/arccos(1 - (wh)**2/2), and the phase against turns."""
    study = xd.refine(
        OSCILLATOR,
        method="velocity_verlet",
        steps=[0.2, 0.1, 0.05],
        until=40,
        at=[20.0],
        observables=["period_x", "phase_x", "energy_range"],
        defects=True,
    )
    h = study.step_size.values
    own = 2 * np.pi * h / np.arccos(1 - (2 * h) ** 2 / 2)
    # a crossing inside a step is off by what a shortened step is: some h**3 w**2/12 over all of the cycles
    assert np.abs(study.period_x.values - own).max() < 0.2**3 * 4 / 12 / 12
    begin = 0.75 * own  # cos rises through 0 there
    assert study.phase_x.values[:, 0] == pytest.approx(2 * np.pi * (20.0 - begin) / own, abs=2 * 2 * 0.2**3 * 4 / 12)
    assert verdict(study, "phase_x") == "asymptotic"
    assert VERDICTS[int(study.verdict_energy_range)] == "asymptotic"
    assert study.period_x.dims == study.energy_range.dims == ("level",)


def test_local_errors_are_an_order_above() -> None:
    """Assert step defects beside errors that came together: of order p + 1, and for Euler h**2/2 times the acceleration's largest."""
    study = xd.refine(OSCILLATOR, method="rk4", steps=[0.1, 0.05], until=3.0, defects=True)
    assert np.log2(study.step_defect_x[0] / study.step_defect_x[1]) == pytest.approx(5.0, abs=0.1)
    study = xd.refine(OSCILLATOR, method="forward_euler", steps=[0.01, 0.005], until=1.0, defects=True)
    assert study.step_defect_x.values == pytest.approx(study.step_size.values**2 / 2 * 4 * 15 / 16, rel=0.01)
    assert study.step_defect_v_x.attrs["units"] == "m s-1"


def test_location_is_refined_alone() -> None:
    """Assert that looser root tolerances move events by less than they say, and that rules are compared without an order."""
    model = ball(0.8, 1.0)
    loose = xd.refine(model, method="dop853", time_tolerances=["1 ms", "1 us", "1 ns"], until=0.9, rtol=1e-9)
    assert loose.time_tolerance.attrs["units"] == "s"
    moved = np.abs(loose.event_time_floor[:-1].values - loose.event_time_floor[-1].values).max(axis=1)
    assert (moved <= loose.time_tolerance[:-1].values).all()
    rules = xd.refine(OSCILLATOR, method="rk4", rules=["interpolant", "reintegrate"], step=0.1, at=[1.04], until=2.0)
    assert 1e-7 < abs(float(rules.difference_x[0, 0])) < 1e-4
    assert "order_x" not in rules
    assert rules.rule.values.tolist() == ["interpolant", "reintegrate"]


@pytest.mark.dear
def test_levels_are_added_until_nothing_changes() -> None:
    """Assert that steps are halved until the apex is known to a micrometre, and that a wish that cannot be met ends."""
    model = xd.Model.from_toml(MODELS / "ball_drag.toml")
    study = xd.refine(
        model, method="midpoint", steps=["0.1 s"], until_change={"after_apex_y": "1 um", "event_time_apex": 1e-6}
    )
    assert abs(float(study.difference_after_apex_y[-2, 0])) <= 1e-6 < abs(float(study.difference_after_apex_y[-3, 0]))
    assert study.step_size.values == pytest.approx(0.1 / 2.0 ** np.arange(study.sizes["level"]))
    assert study.attrs["stopped"].startswith("every change under its tolerance from level")
    never = xd.refine(OSCILLATOR, method="rk4", rtols=[1e-3], until=1.0, until_change={"x": 1e-30})
    assert "with x still changing by more than its tolerance: no finer level, rtol is" in never.attrs["stopped"]


@pytest.mark.dear
def test_saved_and_opened_again(tmp_path: Any) -> None:
    """Assert that a refinement is an archive like any other: verified, its texts too, and no run."""
    study = xd.refine(OSCILLATOR, method="rk4", steps=[0.2, 0.1], until=1.0)
    path = xd.save(study, tmp_path / "r.nc")
    xd.verify(path)
    again = xd.open_run(path)
    assert list(again.run_digest.values) == list(study.run_digest.values)
    assert xd.content_digest(again) == xd.content_digest(study) == again.attrs["content_digest"]
    assert {*again.coords} == {*study.coords} == {"at_time", "model_toml"}
    with pytest.raises(
        xd.InputError, match="this is not the refinement as it was made.*\n.*2 of 2 rows|1 of 2 rows of 'level'"
    ):
        xd.save(study.isel(level=[0]), tmp_path / "part.nc")
    with pytest.raises(xd.InputError, match="variable 'x' is"):
        xd.save(study.assign(x=2 * study.x), tmp_path / "edited.nc")
    with pytest.raises(xd.InputError, match="is evidence, no run: a refinement from 2 runs"):
        xd.reproduce(path)
    broken = bytearray(path.read_bytes())
    at = broken.find(str(study.run_digest.values[1]).encode())
    broken[at] ^= 1
    (tmp_path / "broken.nc").write_bytes(broken)
    with pytest.raises(xd.ArchiveError, match="'run_digest' differs from its digest"):
        xd.open_run(tmp_path / "broken.nc")


@pytest.mark.dear
def test_runs_of_levels_are_kept_in_files(tmp_path: Path) -> None:
    """Assert that a study over archives is the study in memory, to the bit, and that its runs are there and verified."""
    model = xd.Model.from_toml(MODELS / "ball_drag.toml")
    asked = {"method": "midpoint", "steps": [0.1, 0.05, 0.025], "observables": ["y", "v_y", "total_energy"]}
    inside, outside = xd.refine(model, **asked), xd.refine(model, **asked, keep=tmp_path / "levels")
    assert xd.content_digest(inside) == xd.content_digest(outside)
    assert [verified(tmp_path / "levels" / f"level_{k}.nc") for k in range(3)] == list(inside.run_digest.values)
    (tmp_path / "file").write_text("")
    with pytest.raises(xd.InputError, match="'.*file' is a file; name a folder"):
        xd.refine(model, **asked, keep=tmp_path / "file")


@pytest.mark.parametrize(
    ("name", "asked"),
    [
        ("ball_in_box", {"steps": [0.2, 0.1]}),
        ("moving_table", {"steps": [0.02, 0.01], "until": 2.0}),
        ("staged_rocket", {"rtols": [1e-5, 1e-6]}),
        ("stick_slip_belt", {"rtols": [1e-5, 1e-6], "until": 10.0}),
    ],
)
def test_models_with_several_events(name: str, asked: dict[str, Any]) -> None:
    """Assert that events which are met unequally often stand along one dimension, nan where there are no more."""
    study = xd.refine(xd.Model.from_toml(MODELS / f"{name}.toml"), **asked)
    names = [
        str(variable).removeprefix("event_count_")
        for variable in study.data_vars
        if str(variable).startswith("event_count_")
    ]
    assert study.sizes["occurrence"] == max(int(study[f"event_count_{one}"][-1]) for one in names)
    for one in names:
        assert np.isfinite(study[f"event_time_{one}"].values[-1]).sum() == int(study[f"event_count_{one}"][-1])


@pytest.mark.dear
def test_an_interrupt_ends_the_study(tmp_path: Path) -> None:
    """Assert that Ctrl-C in the first of several long levels ends the command, with nothing left under the target's name."""
    command = [
        sys.executable,
        "-m",
        "xdynamics",
        "refine",
        str(MODELS / "double_pendulum.toml"),
        "--method",
        "rk4",
        "--step",
        "1e-6 s",
        "--until",
        "1000 s",
    ]
    process = subprocess.Popen(
        [*command, "-o", str(tmp_path / "r.nc")], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    time.sleep(4.0)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode != 0
    assert "Traceback" not in said
    assert list(tmp_path.iterdir()) == []


def test_absolute_tolerances_go_with_the_relative_one() -> None:
    """Assert that a given atol is that of the first level, and the errors of a nanometre go on to shrink."""
    model = particle(
        name="spring",
        parameters={"m": "1 kg", "k": "4 N m-1"},
        forces={"spring": {"potential": "k*x**2/2"}},
        initial={"x": "1 nm", "v_x": "0 m s-1"},
    )
    atol = {"x": "1e-4 nm", "v_x": "1e-4 nm s-1"}
    study = xd.refine(model, method="dop853", rtols=[1e-4, 1e-6, 1e-8], atol=atol, at=["3 s"], until="3 s")
    off = np.abs(study["x"].values[:, 0] - 1e-9 * np.cos(6.0))
    assert off[0] > 20.0 * off[1] > 400.0 * off[2]


def test_what_a_controller_holds_is_compared_after_events() -> None:
    """Assert that a study of a model with a controller and an event has what is held then, which events do not move."""
    model = xd.Model(
        name="held",
        coordinates={"x": {"unit": "m"}},
        parameters={"m": "1 kg", "k": "40 N m-1"},
        mass={"x": "m"},
        forces={"spring": {"x": "-k*x"}, "motor": {"x": "u"}},
        controllers={
            "feedback": {
                "every": "50 ms",
                "outputs": {"u": {"unit": "N", "start": "0 N", "value": "-2*newton*second/metre*v_x"}},
            }
        },
        events={"middle": {"function": "x"}},
        initial={"x": "0.3 m"},
    )
    study = xd.refine(model, method="rk4", steps=["10 ms", "5 ms", "2.5 ms"], until="1 s")
    run = xd.simulate(model, method="rk4", step="2.5 ms", until="1 s")
    held = run.u.values[run.event_row_after.values]
    assert study.after_middle_u.values[-1].tolist() == held.tolist()
    assert study.after_middle_u.values.shape[1] == run.sizes["event"] > 0

"""Diagnoses of runs: bands and drifts, cycles, extremes, residuals, belief."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.problems import MODELS, coupled_springs, oscillator, particle
from xdynamics.evidence.companion import tighter_of
from xdynamics.evidence.diagnosing.diagnosis import diagnosis_lines
from xdynamics.evidence.diagnosing.phases import exact_march

OSCILLATOR = oscillator().model  # cos 2t: m = 1 kg, k = 4 N/m


def marched(method: str = "velocity_verlet", step: float = 0.02, until: float = 20.0) -> Any:
    """A run of the oscillator."""
    return xd.simulate(OSCILLATOR, method=method, step=step, until=until, force_samples="none")


def rule(found: Any, name: str) -> str:
    """The word of a rule."""
    return str(found[name].attrs["flag_meanings"]).split()[int(found[name])]


def test_verlet_keeps_its_energy_in_a_band_and_runs_ahead() -> None:
    """Assert band k h**2 w**2/8 of the energy, no drift, the numeric period, and a phase that grows with time (HLW, I.5)."""
    h, found = 0.02, xd.diagnose(marched())
    assert float(found.energy_band) == pytest.approx(2.0 * (2 * h) ** 2 / 4, rel=1e-3)
    assert abs(float(found.energy_drift)) < 1e-3 * float(found.energy_band)
    own = 2 * math.pi * h / math.acos(1 - (2 * h) ** 2 / 2)
    assert float(found.period.mean()) == pytest.approx(own, abs=1e-5)
    # the tighter run alone says how far ahead it is, from the start on
    ahead = 2 * math.pi * (found.cycle_time.values / own - found.cycle_time.values / math.pi)
    assert found.phase_offset.values == pytest.approx(ahead, abs=3e-5)
    assert found.phase_offset.attrs["units"] == "rad"
    assert float(found.believed_until) == 20.0


def test_euler_grows_and_is_believed_for_a_while() -> None:
    """Assert energy (1 + w**2 h**2)**n, areas that grow with it, and belief while x is within a tenth of its range."""
    run = marched("forward_euler")
    found = xd.diagnose(run)
    grown = 1 + (2 * 0.02) ** 2
    assert float(found.energy_band) == pytest.approx(2.0 * (grown**1000 - 1), rel=1e-6)
    assert found.phase_space_area[1:].values / found.phase_space_area[:-1].values == pytest.approx(
        grown ** (math.pi / 0.02), rel=2e-2
    )
    ends, rate = found.cycle_time.values, math.log(grown) / 0.02
    means = [
        2.0 / rate * (math.exp(rate * end) - math.exp(rate * begin)) / (end - begin)
        for begin, end in ((ends[0] - float(found.period[0]), ends[0]), (ends[-2], ends[-1]))
    ]
    assert float(found.energy_drift) == pytest.approx(means[1] - means[0], rel=1e-3)
    off, late = np.abs(run.x.values - np.cos(2 * run.time.values)), float(found.believed_until)
    lost = run.time.values[np.argmax(off > 0.1 * 2.0)]  # of the solution's range, not of what the run grows to
    assert late == pytest.approx(lost, abs=0.8)
    assert 0.0 < late < 20.0


def test_turning_points_are_located() -> None:
    """Assert turns at multiples of pi/2, where x is 1 or -1 to the error of the method."""
    found = xd.diagnose(marched("dop853", step=0.1, until=5.0), companion=False)
    assert found.turning_time.values == pytest.approx(np.pi / 2 * np.arange(1, 4), abs=1e-9)
    assert found.turning_point.values == pytest.approx([-1.0, 1.0, -1.0], abs=1e-12)
    assert "believed_until" not in found
    assert np.isnan(found.phase_offset).all()


@pytest.mark.dear
def test_extremes_say_where_they_are_from() -> None:
    """Assert the apex of a ball by its event, the largest of an oscillation between states, the start as it was sampled."""
    thrown = xd.diagnose(xd.simulate(xd.Model.from_toml(MODELS / "ball_drag.toml")))
    assert rule(thrown, "maximum_y_rule") == "located"
    assert float(thrown.maximum_y) == pytest.approx(900 / (2 * 9.80665) * math.log(1 + 400 / 900), rel=1e-6)
    assert rule(thrown, "maximum_v_y_rule") == "sampled"
    swung = xd.diagnose(marched("dop853", step=0.3, until=5.0))
    assert rule(swung, "minimum_x_rule") == "interpolated"
    assert float(swung.minimum_x) == pytest.approx(-1.0, abs=1e-7)
    assert abs(float(swung.minimum_x) + 1.0) <= float(swung.minimum_x_uncertainty) + 1e-9
    assert min(abs(float(swung.minimum_x_time) - one) for one in (np.pi / 2, 3 * np.pi / 2)) < 1e-3
    assert swung.minimum_x.attrs["units"] == "m"


def test_momentum_stays_where_no_force_acts() -> None:
    """Assert that momenta of a free particle stay, and of one pushed by 5 N for 2 s grow by 10 kg m s-1."""
    free, pushed = (
        xd.diagnose(xd.simulate(particle(force), method="rk4", step=0.1, until=2.0)) for force in ("0*newton", "F")
    )
    assert float(free.band_momentum_x) == 0.0
    assert float(pushed.drift_momentum_x) == pytest.approx(10.0, rel=1e-14)
    assert pushed.drift_momentum_x.attrs["units"] == "kg m s-1"


def test_a_momentum_is_that_of_a_mass_on_a_measured_spring() -> None:
    """Assert band and drift of m v where a table of x acts, which the momentum does not read."""
    cart = xd.Model.from_toml(MODELS / "cart_spring.toml")
    run = xd.simulate(cart, until="0.3 s")
    found, speed, m = xd.diagnose(run, companion=False), run.v_x.values, float(run.m)
    assert float(found.band_momentum_x) == pytest.approx(m * float(np.ptp(speed)), rel=1e-14)
    assert float(found.drift_momentum_x) == pytest.approx(m * float(speed[-1] - speed[0]), rel=1e-14)
    assert float(found.band_momentum_x) > 0.1


def test_observables_are_watched() -> None:
    """Assert band and drift of a declared invariant, the angular momentum of an orbit."""
    model = xd.Model.from_toml(MODELS / "kepler.toml")
    run = xd.simulate(model, method="dop853", rtol=1e-10, until="5 s")
    found = xd.diagnose(run, of="y")
    assert float(found.band_angular_momentum) < 1e-8 * abs(float(run.angular_momentum[0]))
    assert found.attrs["coordinate"] == "y"
    assert (
        found.band_angular_momentum.attrs["units"]
        == found.drift_angular_momentum.attrs["units"]
        == run.angular_momentum.attrs["units"]
    )


def test_two_beating_coordinates() -> None:
    """Assert that cycles are of the coordinate that is asked for, through the level that is asked for."""
    run = xd.simulate(coupled_springs().model, method="dop853", rtol=1e-9, until=20.0)
    found = xd.diagnose(run, of="y", level="10 cm", companion=False)
    assert (found.attrs["coordinate"], found.attrs["level"]) == ("y", 0.1)
    at = xd.sample(run, found.cycle_time.values)
    assert at.y.values == pytest.approx(0.1, abs=1e-12)
    assert (at.v_y > 0).all()


@pytest.mark.dear
def test_a_chaotic_run_says_until_when() -> None:
    """Assert a positive exponent for a double pendulum thrown high, none for an oscillator, and that belief ends in time."""
    model = xd.Model.from_toml(MODELS / "double_pendulum.toml")
    run = xd.simulate(model, method="dop853", rtol=1e-9, until=40.0, force_samples="none")
    found = xd.diagnose(run, lyapunov=True)
    assert 0.3 < float(found.lyapunov_exponent) < 6.0
    assert float(found.lyapunov_time) == 1.0 / float(found.lyapunov_exponent)
    finer = xd.simulate(model, method="dop853", rtol=1e-13, atol=1e-14, until=40.0, force_samples="none")
    late = float(found.believed_until)
    assert 5.0 < late < 40.0
    here = (
        xd.sample(finer, np.linspace(0.0, late * 0.95, 50)).th1.values
        - xd.sample(run, np.linspace(0.0, late * 0.95, 50)).th1.values
    )
    assert np.abs(here).max() < 0.15 * np.ptp(run.th1.values)
    calm = xd.diagnose(marched("dop853"), lyapunov=True)
    assert abs(float(calm.lyapunov_exponent)) < 1e-6
    assert float(calm.lyapunov_time) == np.inf
    assert float(calm.believed_until) == 20.0
    assert len(found.attrs["runs"].split()) == 2


def test_companions_know_the_error() -> None:
    """Assert global errors of every kind of step within a fifth of the truth, at times, with the run's digest beside."""
    for more, near in (
        ({"step": 0.05}, 0.1),
        ({"step": list(np.full(40, 0.05))}, 0.1),
        ({"rtol": 1e-6, "estimator": "step_doubling"}, 0.5),
    ):
        run = xd.simulate(OSCILLATOR, method="rk4", until=2.0, **more)
        times = np.array([0.7, 1.31, 2.0])
        found = xd.sample(run, times, companion=True)
        true = found.x.values - np.cos(2 * times)
        assert np.abs(found.global_error_x.values - true).max() <= near * np.abs(true).max()
        assert len(found.attrs["companion_digest"]) == 64
        assert found.global_error_x.attrs["units"] == "m"


def test_event_times_have_global_errors() -> None:
    """Assert that the error of apex and landing is known to a tenth (closed form of quadratic drag)."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "ball_drag.toml"), method="midpoint", step=0.05)
    found = xd.companion(run)
    true = float(run.event_time[0]) - 30 / 9.80665 * math.atan(20 / 30)
    assert float(found.event_time_global_error[0]) == pytest.approx(true, rel=0.1)
    assert found.attrs["evidence"] == "companion"


@pytest.mark.dear
def test_saved_shown_and_drawn(tmp_path: Path) -> None:
    """Assert that a diagnosis is an archive, and has a figure where there are cycles."""
    found = xd.diagnose(marched(), exact={"x": "cos(2*t/second)*metre"})
    path = xd.save(found, tmp_path / "d.nc")
    again = xd.open_run(path)
    assert again.energy_band.attrs["units"] == "J"
    assert len(xd.plot(again).axes) >= 5
    with pytest.raises(xd.InputError, match="the diagnosis has no cycle"):
        xd.plot(xd.diagnose(xd.simulate(particle("F"), method="rk4", step=0.1, until=2.0)))


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"of": "q"}, "'q' is no coordinate of the run; there are x"),
        ({"of": "v_x"}, "'v_x' is no coordinate of the run; there are x"),
        ({"level": "1 s"}, "level is '1 s', needs the unit 'm' of 'x'"),
        ({"reference": "-1 s"}, "reference is '-1 s', needs a positive period"),
        ({"reference": "1 m"}, "reference '1 m' has units 'm', needs 's'"),
        ({"exact": {"q": "t"}}, "exact names 'q'; there are x, v_x"),
        ({"exact": {"x": "t"}}, "exact 'x': 't': has units 's', needs 'm'"),
        ({"exact": {"x": "__import__('os')"}}, "exact 'x'"),
        ({"exact": {"x": "nothing*metre"}}, "nothing"),
    ],
)
def test_wrong_questions(asked: dict[str, Any], said: str) -> None:
    """Assert what is said of each."""
    with pytest.raises(xd.InputError, match=said):
        xd.diagnose(marched(until=2.0), companion=False, **asked)


def test_no_tighter_run() -> None:
    """Assert that a run at the tightest tolerance says that there is none, and that evidence is no run."""
    run = xd.simulate(OSCILLATOR, method="dop853", rtol=2e-14, until=0.5)
    with pytest.raises(xd.InputError, match="there is no tighter run beside this one: rtol is 2e-15"):
        xd.companion(run)
    with pytest.raises(xd.InputError, match="no run record"):
        xd.diagnose(xd.diagnose(run, companion=False))


def growing() -> xd.Model:
    """An oscillator whose swings grow by 0.3 % each."""
    return xd.Model(
        name="growing",
        coordinates={"x": "m"},
        mass={"x": "1*kilogram"},
        initial={"x": "1 m", "v_x": "0 m s-1"},
        forces={"spring": {"x": "-x*newton/metre"}, "push": {"x": "0.002*v_x*kilogram/second"}},
    )


@pytest.mark.dear
def test_the_largest_is_that_of_every_hump() -> None:
    """Assert the largest of many swings, which need not be the one with the largest accepted state."""
    for until in (60.0, 75.0, 100.0):
        found = xd.diagnose(xd.simulate(growing(), method="dop853", rtol=1e-8, atol=1e-8, until=until), companion=False)
        assert float(found.maximum_x) >= float(found.turning_point.max()) - 1e-9


def test_areas_are_as_good_as_the_run() -> None:
    """Assert the area of the ellipse to 1e-8 where steps are long."""
    run = xd.simulate(OSCILLATOR, method="dop853", rtol=1e-10, atol=1e-10, until=20.0)
    found = xd.diagnose(run, companion=False)
    assert found.phase_space_area.values == pytest.approx(2 * math.pi, rel=1e-8)
    assert found.phase_space_area.attrs["units"] == "m2 s-1"


def test_phases_of_first_order_methods() -> None:
    """Assert offsets that go with h**2 though states go with h: forward Euler's, from its numeric period pi h.../atan(wh)."""
    found = xd.diagnose(marched("forward_euler", step=0.02))
    own = math.pi * 2 * 0.02 / math.atan(0.04)  # the turn of 1 + iwh
    ahead = 2 * math.pi * (found.cycle_time.values / own - found.cycle_time.values / math.pi)
    assert found.phase_offset.values == pytest.approx(ahead, rel=0.1, abs=1e-3)


def test_states_are_believed_too() -> None:
    """Assert that a model of first-order states alone is not believed to the end where Euler has it wrong by a half."""
    model = xd.Model(name="growth", states={"u": {"unit": "m", "rate": "u/second"}}, initial={"u": "1 m"})
    run = xd.simulate(model, method="forward_euler", step=0.5, until=5.0)
    assert float(xd.diagnose(run).believed_until) < 5.0


@pytest.mark.dear
def test_what_was_edited_is_not_taken_for_the_run() -> None:
    """Assert that evidence from an edited record has another digest, and that nothing is marched beside it or a part."""
    run = marched(until=5.0)
    edited = run.copy(deep=True)
    edited["x"] = ("step", 3 * run.x.values, run.x.attrs)
    told = xd.diagnose(edited, companion=False)
    assert told.attrs["runs"] != xd.content_digest(run) == xd.diagnose(run, companion=False).attrs["runs"]
    with pytest.raises(xd.InputError, match="this is not the record that was computed"):
        xd.diagnose(edited)
    with pytest.raises(xd.InputError, match="this is a part of a run"):
        xd.companion(run.isel(step=slice(0, 50)))


def test_impacts_are_no_loss_of_belief() -> None:
    """Assert that a bouncing ball is believed to the end, though velocities differ wholly between two times of one impact."""
    model = xd.Model.from_toml(MODELS / "bouncing_ball.toml")
    assert float(xd.diagnose(xd.simulate(model, step=0.01, until=4.0)).believed_until) == 4.0


def test_a_run_that_failed_is_judged_to_its_end() -> None:
    """Assert that the tighter run of one that left the domain of a force ends where it did, nodes beyond left out."""
    model = xd.Model(
        name="falling into a root",
        coordinates={"x": "m"},
        mass={"x": "1*kilogram"},
        initial={"x": "1 m", "v_x": "-1 m s-1"},
        forces={"root": {"x": "-sqrt(x/metre)*newton"}},
    )
    run = xd.simulate(model, method="rk4", step=0.1, until=9.0, nodes=["0.5 s", "8 s"])
    assert run.attrs["run_outcome"] == "nonfinite_force"
    end = float(run.time[-1])
    assert 0.5 < end < 2.0
    settings = tighter_of(run, None).settings
    assert (settings["until"], settings["nodes"], settings["step"]) == (end, [0.5], 0.05)
    assert np.isfinite(xd.companion(run, times=[0.5, 0.75 * end]).global_error_x).all()
    whole = xd.simulate(model, method="rk4", step=0.1, until=0.3)
    assert tighter_of(whole, None).settings["until"] == 0.3


def test_colliding_bodies_have_no_nearly_exact_run_beside_them() -> None:
    """Assert that phases are beside the run with half the steps, and why; balls that meet a wall alone have it."""
    common = {
        "dimensions": {"ball": 8},
        "coordinates": {"x": {"unit": "m", "dims": ["ball"]}},
        "mass": {"x": "kilogram"},
        "forces": {"springs": {"potential": "50*newton/metre*x**2"}},
        "initial": {"x": "(0.15*index(ball) - 0.6)*metre", "v_x": "0.1*index(ball)*metre/second"},
    }
    walls = {"wall": {"gap": "x + metre", "restitution": 1}}
    meeting = {"relations": {"pair": {"of": "ball"}}} | common
    hits = {"balls": {"gap": "second(x, pair) - first(x, pair) - 0.1*metre", "restitution": 1}}
    settings: Any = {"method": "velocity_verlet", "step": "10 ms", "until": "1.5 s"}
    run = xd.simulate(xd.Model(name="meeting", contacts=hits, **meeting), **settings)
    found = xd.diagnose(run)
    assert found.attrs["reference"].startswith("the run with half the steps (no run by dop853")
    assert found.sizes["cycle"] >= 1
    assert np.isfinite(found.phase_offset).all()
    assert exact_march(run, None) is None
    many = common | {"dimensions": {"ball": 30}}
    apart = xd.simulate(xd.Model(name="apart", contacts=walls, **many), **settings | {"until": "20 ms"})
    assert exact_march(apart, None) is not None


@pytest.mark.parametrize(
    ("method", "how"), [("bogacki_shampine", {"rtol": 1e-4}), ("dop853", {"rtol": 1e-5}), ("heun", {"step": "20 ms"})]
)
def test_errors_are_known_where_an_event_stops_a_run(method: str, how: dict[str, Any]) -> None:
    """Assert errors at the end that both runs reach, though the tighter one is stopped first, within a factor of two."""
    model = xd.Model.from_toml(MODELS / "thrown_ball.toml")
    run = xd.simulate(model, method=method, **how)
    found = xd.companion(run)
    true = xd.sample(xd.simulate(model, method="dop853", rtol=1e-12, atol=1e-14), found.at_time.values - 1e-3)
    mine = xd.sample(run, found.at_time.values - 1e-3)
    for name in ("x", "y", "v_x", "v_y"):
        error = float(mine[name][0] - true[name][0])
        assert float(found[f"global_error_{name}"][0]) == pytest.approx(error, rel=1.0, abs=1e-6)


def test_a_diagnosis_is_told_as_a_table_first() -> None:
    """Assert a row for each quantity with what it ranged over, times of extremes, and the word of one that is a row's."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "pendulum.toml"))
    found = xd.diagnose(run, companion=False)
    lines = [*diagnosis_lines(found)]
    head = next(k for k, line in enumerate(lines) if line.split() == ["band", "drift", "least", "greatest"])
    assert head == 0
    theta = next(line for line in lines if line.startswith("theta "))
    assert f"{float(found.maximum_theta):.5g} rad at {float(found.maximum_theta_time):.5g} s" in theta
    assert any(line.endswith(", sampled") or ", sampled  " in line for line in lines)
    assert not any(line.startswith(("maximum_", "minimum_", "band_", "drift_", "energy_")) for line in lines)

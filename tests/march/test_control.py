"""Step control: outcomes of hard cases, the error test, rejected trials, first step, replay."""

from __future__ import annotations

import subprocess
import sys
from functools import lru_cache

import numpy as np
import pytest

import xdynamics as xd
from cases.problems import EPS, MODELS, ROOT, damped, oscillator, particle
from xdynamics.march.outcomes import WORDS
from xdynamics.schema import EVENT_AFTER


@lru_cache
def state(rate: str, start: str = "0 s") -> xd.Model:
    """One first-order state y in m, with a second, a metre and a rate k."""
    states = {"y": {"unit": "m", "rate": rate}}
    return xd.Model(name="state", parameters={"k": "1 s-1"}, states=states, initial={"t": start, "y": "1 m"})


def run_of(model: xd.Model, until: float, **more: object) -> object:
    """March by Dormand-Prince at 1e-8."""
    return xd.simulate(model, **{"method": "dormand_prince", "rtol": 1e-8, "atol": 1e-8, "until": until} | more)


def is_sound(run: object) -> bool:
    """Whether a record never pairs success with a state that is not finite, and says t and h."""
    finite = all(
        np.isfinite(run[name]).all()
        for name, variable in run.data_vars.items()
        if variable.attrs.get("role") in ("coordinate", "velocity", "state")
    )
    text = run.attrs["run_outcome_text"]
    return finite and (WORDS[run.attrs["run_outcome"]].good or ("t = " in text and "h = " in text))


GONE, BY_NAME = "step_below_spacing", "nonfinite_force"


@pytest.mark.parametrize(
    ("rate", "end", "off", "outcome", "said", "reason"),
    [
        ("k*y**2/(1*metre)", 1.0, 1e-6, GONE, "singularity", ""),
        ("k*(1*metre)*exp(y/(1*metre))", float(np.exp(-1)), 1e-6, GONE, "", ""),
        ("k*y*sqrt(1 - where(t > 1*second, 2, 0))", 1.0, 1e-12, BY_NAME, "rate_y is nan", "domain"),
        ("k*y/where(t > 1*second, 0, 1)", 1.0, 1e-12, BY_NAME, "", BY_NAME),
        ("-k*sqrt(y*(1*metre))", 2.0, 1e-3, "", "", "domain"),
    ],
    ids=["square", "exponential", "no number", "infinite", "root that reaches zero"],
)
def test_a_rate_that_ends_ends_the_run(rate: str, end: float, off: float, outcome: str, said: str, reason: str) -> None:
    """Assert the time at which y' blows up or has no value, named, with the reason of trials behind it."""
    run = run_of(state(rate), end + 1.0, switches="stepped over")
    assert run.attrs["run_outcome"] in ((outcome,) if outcome else (GONE, BY_NAME))
    assert abs(float(run.time[-1]) - end) < off
    assert said in run.attrs["run_outcome_text"]
    assert not reason or reason in reasons(run)
    assert is_sound(run)


def test_a_collision_ends_the_run() -> None:
    """Assert that x'' = -1/x**2 from rest at 1 ends at the collision, pi/(2 sqrt 2)."""
    pull = "-8*newton*metre**2/(4*x**2)"
    run = run_of(particle(pull, v="0 m s-1"), 2.0)
    assert run.attrs["run_outcome"] == "step_below_spacing"
    assert abs(float(run.time[-1]) - 1.1107207345395915) < 1e-6
    assert is_sound(run)


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"rtol": 9 * EPS}, r"rtol is 1.99\d*e-15, needs a number from 10 eps"),
        ({"rtol": float("nan")}, "rtol is nan, needs a number from 10 eps"),
        ({"rtol": -1e-6}, "rtol is -1e-06, needs a number from 10 eps"),
        ({"rtol": 2.0}, "rtol is 2.0, needs a number from 10 eps = 2.22e-15, below which rounding is as large, to 1"),
        ({"rtol": True}, "rtol is True, needs a number"),
        ({"atol": {}}, "atol is an empty mapping"),
        ({"atol": "1 um"}, "atol is '1 um', needs a number; for one variable write"),
        ({"atol": {"x": "soon"}}, "atol of 'x': quantity 'soon'"),
        ({"max_steps": float("inf")}, "max_steps is inf, needs a whole number"),
        ({"max_steps": 2.5}, "max_steps is 2.5, needs a whole number"),
        ({"min_step": 5.0}, "min_step is 5.0 s, needs to be at most the span of 1.0 s"),
        ({"step": 0.5, "max_step": 0.1}, "step, the first one, is 0.5 s, needs to be from min_step"),
        (
            {"rtol": None, "atol": None, "step": 0.1, "max_steps": 3},
            "max_steps is for chosen steps, and the steps are given",
        ),
        ({"rtol": None, "atol": None, "step": [0.5]}, "step has 1 steps up to t = 0.5 s, needs to reach until = 1.0 s"),
        ({"rtol": None, "atol": None, "step": [0.5, -0.5]}, "step has -0.5 s, needs positive times"),
        ({"atol": float("nan")}, "atol is nan, needs a finite non-negative number"),
        ({"atol": -1.0}, "atol is -1.0, needs a finite non-negative number"),
        ({"atol": {"x": "1 s"}}, "atol of 'x' is '1 s', needs the unit 'm'"),
        ({"atol": {"z": 1.0}}, "atol names 'z'; there are x, v_x"),
        ({"atol": 0.0}, "atol of 'v_x' is 0 and v_x starts at 0"),
        ({"rtol": "fine"}, "rtol is 'fine', needs a number"),
        ({"min_step": "2 s", "max_step": "1 s"}, "min_step is 2.0 s, needs to be at most max_step = 1.0 s"),
        ({"safety": 1.5}, "safety is 1.5, needs a number between 0 and 1"),
        ({"growth_limits": (0.5, 0.9)}, "growth_limits are .*, need 0 < least < 1 < greatest"),
        ({"max_steps": 0}, "max_steps is 0, needs a positive number"),
        ({"estimator": "guess"}, "estimator is 'guess'; there are none, embedded, step_doubling"),
        (
            {"method": "rk4", "estimator": "embedded"},
            "method 'rk4' has no embedded formula; take estimator = 'step_doubling'",
        ),
        ({"estimator": "none"}, "tolerances need an error estimate"),
        ({"rtol": float("nan"), "safety": 2.0}, r"cannot be set up:\n  1. safety is 2.0.*\n  2. rtol is nan"),
    ],
)
def test_wrong_tolerances_are_named(asked: dict[str, object], message: str) -> None:
    """Assert that each fault of the settings is named before anything is computed."""
    with pytest.raises(xd.InputError, match=message):
        run_of(oscillator().model, 1.0, **asked)


def test_zero_absolute_tolerance_through_zero() -> None:
    """Assert that a purely relative tolerance survives y = 0 without a division by zero."""
    run = run_of(state("-k*(1*metre)"), 2.0, atol=0.0)
    assert run.attrs["run_outcome"] in ("completed", "step_below_spacing")
    assert is_sound(run)


def test_late_start_near_the_spacing() -> None:
    """Assert that at t0 = 1e9 s a solution faster than the spacing of t is refused by name."""
    late = state("-k*y", "1e9 s").replace(parameters={"k": 1e8})
    run = run_of(late, 1e9 + 1e-3)
    assert run.attrs["run_outcome"] == "step_below_spacing"
    assert is_sound(run)


def test_stiff_decay_by_an_explicit_method() -> None:
    """Assert that lambda = 1e6 with an explicit method completes, and that its text suspects stiffness."""
    run = run_of(state("-k*y").replace(parameters={"k": 1e6}), 1e-2)
    assert run.attrs["run_outcome"] == "completed"
    assert "stiff" in run.attrs["run_outcome_text"]
    assert is_sound(run)


def test_step_limit_ends_an_endless_run() -> None:
    """Assert that a march that would take 1e12 steps ends as step_limit."""
    run = run_of(state("-k*y").replace(parameters={"k": 1e12}), 1.0, max_steps=5000)
    assert run.attrs["run_outcome"] == "step_limit"
    assert "5000 accepted steps and rejected trials" in run.attrs["run_outcome_text"]
    assert is_sound(run)


def test_every_trial_rejected_at_the_minimum() -> None:
    """Assert that a minimum step that is too long is its own outcome, and no such trial is accepted."""
    run = run_of(oscillator().model, 10.0, min_step="0.5 s", step="1 s", rtol=1e-12, atol=1e-12)
    assert run.attrs["run_outcome"] == "error_test_at_minimum_step"
    assert run.sizes["step"] == 1
    assert run.trial_step_size.values[-1] == 0.5
    assert set(reasons(run)) == {"error_test"}
    assert is_sound(run)


def reasons(run: object) -> list[str]:
    """Return the reason of every rejected trial."""
    words = run.trial_reason.attrs["flag_meanings"].split()
    return [words[int(one)] for one in run.trial_reason.values]


def test_accepted_steps_replayed_give_the_same_bits() -> None:
    """Assert that an adaptive run's steps, handed over as a grid, lead to the same states and errors to the bit."""
    for more in ({}, {"method": "rk4", "estimator": "step_doubling"}):
        chosen = run_of(damped().model, 5.0, **more)
        asked = {"method": "dormand_prince", "until": 5.0, "step": chosen.step_size[1:]} | more
        given = xd.simulate(damped().model, **asked)
        for name in ("time", "x", "v_x", "s", "a_x", "step_size", "error_x"):
            assert np.array_equal(chosen[name], given[name]), name
        assert np.array_equal(chosen.sample_x[2:], given.sample_x[1:])  # but for the probe of the first step
        assert given.attrs["solver_step_control"] == "given"


def test_replay_of_given_steps_is_reproduced_from_the_file(tmp_path: object) -> None:
    """Assert that given steps, like chosen ones, are marched again from the file alone."""
    for kind, asked in (("given", {"step": [0.1, 0.2, 0.3, 0.4]}), ("chosen", {"rtol": 1e-6, "atol": {"x": "1 um"}})):
        run = xd.simulate(damped().model, method="dormand_prince", until=1.0, **asked)
        xd.save(run, tmp_path / f"{kind}.nc")
        assert xd.reproduce(tmp_path / f"{kind}.nc").attrs["identical"] == 1


@pytest.mark.dear
def test_same_rows_in_another_process() -> None:
    """Assert that another process accepts and rejects the same trials, by the content digest."""
    code = (
        "import sys; sys.path.insert(0, 'tests'); import xdynamics as xd; from cases.problems import damped;"
        "print(xd.content_digest(xd.simulate(damped().model, method='dormand_prince', rtol=1e-8, atol=1e-8, until=5.0)))"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT).stdout
    assert told.strip() == xd.content_digest(run_of(damped().model, 5.0))


def test_every_accepted_step_passes_and_every_error_rejection_fails() -> None:
    """Assert that norms are at most 1 where accepted and above 1 where rejected by the error test."""
    run = run_of(xd.Model.from_toml(MODELS / "kepler.toml"), 10.0)
    assert float(run.error_norm.max()) <= 1.0
    assert run.sizes["trial"] > 0
    assert (run.trial_error_norm.values[np.array(reasons(run)) == "error_test"] > 1.0).all()


def test_norm_is_the_largest_scaled_component() -> None:
    """Assert that the recorded norm is what the recorded errors and tolerances say."""
    run = run_of(damped().model, 5.0, atol={"x": 1e-6, "v_x": 1e-7, "s": 1e-8})
    parts = []
    for name in ("x", "v_x", "s"):
        size = np.maximum(np.abs(run[name].values[:-1]), np.abs(run[name].values[1:]))
        parts.append(np.abs(run[f"error_{name}"].values[1:]) / (run[name].attrs["atol"] + 1e-8 * size))
    assert np.allclose(np.max(parts, axis=0), run.error_norm.values[1:], rtol=4 * EPS, atol=0)


def test_no_growth_right_after_a_rejection() -> None:
    """Assert that the step behind a rejected trial's repetition is no longer than it, where its small error would allow."""
    run = run_of(
        state("k*y*sqrt(1 - where(t > 1*second, 2, 0))"), 2.0, switches="stepped over"
    )  # quarters its steps before t = 1
    h, norm = run.step_size.values[1:], run.error_norm.values[1:]
    rows = [row for row in np.unique(run.trial_step.values) if row + 1 < len(h)]
    assert min(norm[rows]) < 1e-3
    for row in rows:
        assert h[row + 1] <= h[row] * (1 + 1e-6)  # t + h is rounded


def test_growth_keeps_to_its_limit() -> None:
    """Assert that no step is more than ten times the one before."""
    h = run_of(xd.Model.from_toml(MODELS / "kepler.toml"), 10.0).step_size.values[1:]
    assert (h[1:-1] <= 10 * h[:-2] * (1 + 4 * EPS)).all()


def test_first_step_is_recorded_and_can_be_given() -> None:
    """Assert that the first step is chosen by the book's rule, or given, and that the record says which."""
    chosen, given = run_of(oscillator().model, 1.0), run_of(oscillator().model, 1.0, step="1 ms")
    assert "section II.4" in chosen.attrs["solver_first_step_choice"]
    assert chosen.attrs["solver_first_step"] == pytest.approx(float(chosen.step_size[1]), rel=1e-12)
    assert (given.attrs["solver_first_step"], given.attrs["solver_first_step_choice"]) == (1e-3, "given")
    assert float(given.step_size[1]) == pytest.approx(1e-3, rel=1e-12)


def test_steps_keep_to_their_limits_and_land_on_nodes() -> None:
    """Assert that no step is longer than max_step, and that chosen steps end on the breakpoints of a drive."""
    model = xd.Model.from_toml(MODELS / "rocket_c6.toml")
    run = run_of(model, 3.0, max_step="50 ms")
    assert run.attrs["run_outcome"] == "completed"
    assert float(run.step_size.max()) <= 0.05 + EPS * 3  # t + h is rounded, and h is what that makes it
    nodes = model.drives["thrust"].table.argument
    inside = nodes[(nodes > 0) & (nodes < 3.0)]
    assert np.isin(inside, run.time).all()


@pytest.mark.parametrize("estimator", ["step_doubling", "step_doubling_extrapolated"])
def test_step_doubling_estimates_the_error_it_makes(estimator: str) -> None:
    """Assert that the estimate of two half steps is their true local error to leading order; extrapolation gains one."""
    model = oscillator().model
    run = xd.simulate(model, method="rk4", step=0.05, until=0.05, estimator=estimator, force_samples="none")
    true = -2 * np.sin(0.1) - float(run.v_x[-1])
    if estimator == "step_doubling":
        assert float(run.error_v_x[-1]) == pytest.approx(true, rel=0.01)
    else:
        assert abs(true) < abs(float(run.error_v_x[-1])) / 100
    assert run.attrs["solver_estimator"] == estimator


def test_global_error_follows_the_tolerance() -> None:
    """Assert that a thousandfold tighter tolerance lowers the error of every pair at least a hundredfold."""
    for method in ("dormand_prince", "verlet"):
        more = {} if method == "dormand_prince" else {"method": "velocity_verlet", "estimator": "step_doubling"}
        errors = []
        for tolerance in (1e-4, 1e-7):
            run = run_of(oscillator().model, 5.0, rtol=tolerance, atol=tolerance, **more)
            errors.append(float(np.abs(run.x - np.cos(2 * run.time)).max()))
        assert errors[1] < errors[0] / 100
        assert errors[1] < 1e-4


def test_events_are_located_in_chosen_steps() -> None:
    """Assert that a falling ball's landing is found to its tolerance whatever step control proposes."""
    model = xd.Model.from_toml(MODELS / "ball_drag.toml")
    run = run_of(model, 5.0, rtol=1e-12, atol=1e-12)
    assert run.attrs["run_outcome"] == "stopped_by_event"
    assert float(run.event_time[-1]) == pytest.approx(3.711199198904777, abs=1e-11)
    assert run.event_substeps.values[-1] > 0
    assert "event_substep" not in reasons(run)


def test_a_step_asked_for_sets_the_file_s_tolerance_aside() -> None:
    """Assert how arguments and [run] join: the newest word on steps wins."""
    model = xd.Model.from_text(oscillator().model.to_toml().replace("step = ", "rtol = 1e-6\nstep = "))
    assert xd.simulate(model, method="dormand_prince", until=1.0).attrs["solver_step_control"] == "adaptive"
    assert xd.simulate(model, method="dormand_prince", until=1.0, step=0.1).attrs["solver_step_control"] == "fixed"


def test_a_step_beyond_the_stability_limit_is_warned_of_once() -> None:
    """Assert that the warning names step, limit, method and remedy, and that a shorter step is silent."""
    with pytest.warns(
        xd.StabilityWarning, match=r"step 1.1 s is beyond the stability limit 1 s of 'velocity_verlet'"
    ) as told:
        xd.simulate(oscillator().model, method="velocity_verlet", step=1.1, until=20.0)
    assert len(told) == 1
    xd.simulate(oscillator().model, method="velocity_verlet", step=0.9, until=20.0)


def test_a_longest_step_that_divides_the_span_ends_on_it() -> None:
    """Assert that rounding of t + h never leaves a sliver before the end."""
    for n in range(2, 60):
        run = run_of(oscillator().model, 0.1 * n, rtol=1e-2, atol=1e-2, max_step=0.1, force_samples="none")
        assert run.attrs["run_outcome"] == "completed", n
        assert float(run.time[-1]) == 0.1 * n


def test_given_steps_may_miss_the_end_by_rounding() -> None:
    """Assert that steps of a fixed run, added up, end at the run's end; from before zero too."""
    for start, steps, until in ((0.0, [1e-4] * 10_000, 1.0), (-3.0, [0.5] * 4, -1.0), (-1.0, [0.1] * 10, 0.0)):
        model = oscillator().model.replace(initial={"t": start})
        run = xd.simulate(model, method="dormand_prince", step=steps, until=until, force_samples="none")
        assert run.attrs["run_outcome"] == "completed"
        assert (run.sizes["step"], float(run.time[-1])) == (len(steps) + 1, until)


def test_an_event_s_own_step_passes_the_error_test() -> None:
    """Assert that the step cut at an event is judged like any other."""
    atol = {"y": "1 nm", "v_y": "1 nm s-1", "fuel": "1 ng"}
    run = run_of(xd.Model.from_toml(MODELS / "rocket_c6.toml"), 60.0, rtol=1e-9, atol=atol)
    assert run.attrs["run_outcome"] == "stopped_by_event"
    assert float(run.error_norm.max()) <= 1.0


def test_a_minimum_step_that_t_rounds_still_ends_the_run() -> None:
    """Assert that t + h, rounded up past the minimum, does not repeat one trial for ever."""
    model = oscillator().model.replace(initial={"t": 0.3})
    run = run_of(model, 5.0, rtol=1e-14, atol=1e-14, min_step=0.1, step=1.0)
    assert run.attrs["run_outcome"] == "error_test_at_minimum_step"
    assert run.sizes["trial"] < 10


def test_an_error_too_large_to_square_is_not_small() -> None:
    """Assert that DOP853's combined estimate survives errors above 1e154."""
    fast = state("-k*y").replace(parameters={"k": 1e14})
    run = run_of(fast, 1.0, method="dop853", rtol=1e-6, step=1.0, max_steps=500)
    assert run.attrs["run_outcome"] == "step_limit"
    assert float(np.abs(run.y).max()) <= 1.0


def test_stiffness_is_judged_alike_in_any_blocks(tmp_path: object) -> None:
    """Assert that a streamed run, in other blocks, says the same of stiffness and has the same digest."""
    model = state("-k*(y - (1*metre)*cos(t/second))").replace(parameters={"k": 1000.0})
    asked = {"method": "dormand_prince", "rtol": 1e-6, "atol": 1e-6, "until": 12.4, "force_samples": "none"}
    whole, streamed = xd.simulate(model, **asked), xd.simulate(model, **asked, path=tmp_path / "run.nc")
    assert "stiffness suspected" in whole.attrs["run_outcome_text"]
    assert xd.content_digest(whole) == xd.content_digest(streamed)


def test_work_counts_what_was_evaluated() -> None:
    """Assert Newton's evaluations: one a step, one at the start, three an iteration, one more in the estimate's solve."""
    run = xd.simulate(oscillator().model, method="radau_iia", step=0.1, until=2.0, estimator="none")
    assert run.attrs["run_force_evaluations"] == 1 + 20 + 3 * int(run.newton_iterations.sum())
    assert run.sizes["sample"] == 1 + 20 * 4


def test_recorded_forces_are_those_at_the_state() -> None:
    """Assert that the estimate's own evaluations leave no trace in the force columns."""
    run = xd.simulate(oscillator().model, method="radau_iia", step=0.1, until=2.0)
    assert np.array_equal(run.force_spring_x, -4 * run.x)
    assert np.array_equal(run.a_x, -4 * run.x)


def test_a_failure_inside_a_solve_or_a_half_step_is_named() -> None:
    """Assert that the drive of an implicit run, and the force of a doubled one, are named."""
    cart = xd.Model.from_toml(MODELS / "cart_spring.toml").replace(initial={"v_x": "3 m s-1"})
    run = xd.simulate(cart, method="implicit_midpoint", step="1 ms")
    assert run.attrs["run_outcome"] == "outside_drive_table"
    window = particle("F*sqrt(1 - where(t > 0.4*second, where(t < 0.6*second, 2, 0), 0))")
    run = xd.simulate(
        window, method="velocity_verlet", step=1.0, until=2.0, estimator="step_doubling", switches="stepped over"
    )
    assert run.attrs["run_outcome"] == "nonfinite_force"
    assert "force_push_x is nan in the evaluation at t = 0.5 s" in run.attrs["run_outcome_text"]


def test_rows_that_no_step_led_to_have_no_error() -> None:
    """Assert zeros at the start and on the far side of events, and errors of the steps on their near side."""
    model = xd.Model.from_toml(MODELS / "pendulum.toml")
    run = xd.simulate(model, method="dormand_prince", rtol=1e-8, atol=1e-8)
    stands = run.step_size.values == 0.0
    assert np.array_equal(stands[1:], run.row_kind.values[1:] == EVENT_AFTER)
    assert stands.sum() > 2
    for name in ("error_norm", "error_theta", "error_v_theta"):
        assert not run[name].values[stands].any()
        assert run[name].values[~stands].all()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("0 s", "time_tolerance is 0.0 s, needs a positive time"),
        ("-1 ps", "needs a positive time"),
        ("1 m", "time_tolerance"),
        (float("nan"), "time_tolerance: quantity nan is not finite"),
    ],
)
def test_wrong_time_tolerances(given: str | float, said: str) -> None:
    """Assert that each is refused with its value."""
    with pytest.raises(xd.InputError, match=said):
        xd.simulate(xd.Model.from_toml(MODELS / "ball_drag.toml"), time_tolerance=given)


def test_the_time_tolerance_is_that_of_events_without_one() -> None:
    """Assert the width of brackets, what the record says, and that an event's own tolerance goes first."""
    table = {
        "name": "fall",
        "coordinates": {"y": "m"},
        "parameters": {"m": "1 kg", "g": "9.81 m s-2"},
        "mass": {"y": "m"},
        "forces": {"gravity": {"potential": "m*g*y"}},
        "initial": {"y": "1 m", "v_y": "0 m s-1"},
    }
    events = {"loose": {"function": "y - 0.5*metre"}, "sharp": {"function": "y - 0.2*metre", "time_tolerance": "1 ps"}}
    run = xd.simulate(xd.Model(**table, events=events), method="rk4", step=0.01, until=2.0, time_tolerance="1 us")
    width = (run.event_time_bounds[:, 1] - run.event_time_bounds[:, 0]).values
    assert 1e-9 < width[0] <= 1e-6
    assert width[1] <= 1e-12
    assert run.attrs["solver_time_tolerance"] == 1e-6
    assert run.event_detector.attrs["time_tolerances"] == "loose: solver_time_tolerance; sharp: 1.0 ps"
    assert "solver_time_tolerance" not in xd.simulate(xd.Model(**table), method="rk4", step=0.1, until=1.0).attrs

"""Motion along switches that both sides drive back to: Filippov's convex combination, against closed forms."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from math import asin, pi, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from xdynamics.evidence.audit import audit

METHODS = ["bogacki_shampine", "dormand_prince", "dop853", "rk4", "midpoint", "radau_iia", "taylor"]


def flows(rates: dict[str, tuple[str, str]], parameters: dict[str, str] | None = None) -> xd.Model:
    """A model of first-order states in metres: start and rate of each."""
    return xd.Model(
        name="flows",
        states={name: {"unit": "m", "rate": rate} for name, (_, rate) in rates.items()},
        initial={name: start for name, (start, _) in rates.items()},
        parameters=parameters or {},
    )


RELAY = flows({"x": ("1 m", "(0.5 - sign(x/(1*metre)))*metre/second")})
MEETING = flows(
    {"x": ("1.5 m", "where(x > y, -2, 2)*metre/second"), "y": ("1 m", "where(y > x, -3, 1.5)*metre/second")}
)


def braked(
    forces: Mapping[str, str | dict[str, str]],
    parameters: dict[str, str] | None = None,
    drives: dict[str, Any] | None = None,
    **initial: str,
) -> xd.Model:
    """A mass of 1 kg under forces along x, or of potentials."""
    return xd.Model(
        name="braked",
        coordinates={"x": "m"},
        parameters=parameters or {},
        mass={"x": "1*kilogram"},
        drives=drives or {},
        forces={name: {"x": force} if isinstance(force, str) else force for name, force in forces.items()},
        initial={"x": "0 m", "v_x": "0 m s-1"} | initial,
    )


DRY = "-1*newton*sign(v_x)"


def march(model: xd.Model, method: str = "dormand_prince", until: str = "3 s", **asked: Any) -> Any:
    """March with chosen steps, or those of 10 ms."""
    given = {"step": "10 ms"} if method in ("rk4", "midpoint") else {}
    return xd.simulate(model, method=method, until=until, **given | asked)


def kinds(run: Any) -> list[str]:
    """The kinds of its events."""
    words = run.event_kind.attrs["flag_meanings"].split()
    return [words[kind] for kind in run.event_kind.values]


@pytest.mark.parametrize("method", METHODS)
def test_a_relay_slides_with_its_share(method: str) -> None:
    """Assert x' = 1/2 - sign(x/(1*metre)): at zero from 2 s on, with the share 3/4."""
    run = march(RELAY, method)
    assert run.attrs["run_outcome"] == "completed"
    assert kinds(run) == ["slide"]
    assert run.event_time.values[0] == pytest.approx(2.0, abs=1e-11)
    slides = run.time.values > 2.0 + 1e-9
    assert np.abs(run.x.values[slides]).max() < 1e-11
    assert run.switch_share_x_sign.values[slides] == pytest.approx(0.75, abs=1e-14)
    assert np.isnan(run.switch_share_x_sign.values[~slides]).sum() >= 2


@pytest.mark.parametrize("method", METHODS)
def test_two_states_that_drive_each_other_have_one_share(method: str) -> None:
    """Assert that they meet at 1/7 s, and go on together with the share 10/17."""
    run = march(MEETING, method, "1 s")
    assert [name for name in run.data_vars if str(name).startswith("switch_share")] == ["switch_share_x_where"]
    assert run.event_time.values[0] == pytest.approx(1 / 7, abs=1e-11)
    assert run.switch_share_x_where.values[-1] == pytest.approx(10 / 17, abs=1e-14)
    assert (run.x.values[-1], run.y.values[-1]) == pytest.approx((0.9117647059, 0.9117647059), abs=1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_a_spring_held_by_friction_sticks(method: str) -> None:
    """Assert where dry friction written with a sign stops a mass on a spring, and its share there."""
    run = (
        march(braked({"spring": "-2*newton/metre*x", "dry": DRY}, v_x="1 m s-1"), method, rtol=1e-9)
        if method not in ("rk4", "midpoint")
        else march(braked({"spring": "-2*newton/metre*x", "dry": DRY}, v_x="1 m s-1"), method)
    )
    at_rest = sqrt(0.75) - 0.5
    near = 1e-4 if method == "midpoint" else 1e-7
    assert run.x.values[-1] == pytest.approx(at_rest, abs=near)
    assert abs(run.v_x.values[-1]) < 1e-11
    assert run.switch_share_dry_sign.values[-1] == pytest.approx((1 - 2 * at_rest) / 2, abs=near)
    assert run.force_dry_x.values[-1] == pytest.approx(2 * at_rest, abs=2 * near)


@pytest.mark.parametrize("method", ["dormand_prince", "rk4", "radau_iia", "taylor"])
def test_it_leaves_where_its_share_is_at_a_bound(method: str) -> None:
    """Assert that a mass at rest under 1.7 N sin(t) slips where that exceeds 1 N, and slides again where it stops."""
    run = march(braked({"drive": "1.7*newton*sin(t/(1*second))", "dry": DRY}), method, "9 s")
    assert kinds(run)[:2] == ["slide", "leave"]
    assert run.event_time.values[0] == 0.0
    assert run.event_time.values[1] == pytest.approx(asin(1 / 1.7), abs=1e-9)
    run = march(braked({"drive": "1.05*newton*sin(t/(1*second))", "dry": DRY}), method, "9 s")
    assert kinds(run) == ["slide", "leave", "slide", "leave", "slide", "leave", "slide"][: len(kinds(run))]
    leaves = run.event_time.values[1::2]
    assert leaves == pytest.approx([asin(1 / 1.05) + k * pi for k in range(len(leaves))], abs=1e-8)
    assert len(leaves) >= 2


def test_a_start_on_a_switch_slides_at_once() -> None:
    """Assert that a motion begins along a switch that it stands on, with one event at the start."""
    run = march(flows({"x": ("0 m", "(0.5 - sign(x/(1*metre)))*metre/second")}))
    assert kinds(run) == ["slide"]
    assert run.event_time.values.tolist() == [0.0]
    assert run.x.values.tolist() == [0.0] * run.sizes["step"]


def test_two_switches_at_once() -> None:
    """Assert that a motion slides along two surfaces, each with its share, and leaves none."""
    model = flows(
        {
            "x": ("1 m", "(0.5 - sign(x/(1*metre)))*metre/second + 0.2*sign(y/(1*metre))*metre/second"),
            "y": ("2 m", "(-0.25 - sign(y/(1*metre)))*metre/second"),
        }
    )
    run = march(model, until="9 s")
    assert run.attrs["run_outcome"] == "completed"
    # at rest in both: -0.25 = sign(y/(1*metre)), 0.5 + 0.2*(-0.25) = sign(x/(1*metre))
    assert run.switch_share_x_sign_2.values[-1] == pytest.approx((1 - 0.25) / 2)
    assert run.switch_share_x_sign.values[-1] == pytest.approx((1 + 0.45) / 2)
    assert abs(run.x.values[-1]) < 1e-12
    assert abs(run.y.values[-1]) < 1e-12


def test_sides_that_both_drive_away_are_told() -> None:
    """Assert that what forces do not decide is no motion."""
    run = march(
        flows(
            {"x": ("1 m", "-1*metre/second"), "y": ("0 m", "where(x > 0*metre, 0, 1)*sign(y/(1*metre))*metre/second")}
        )
    )
    assert run.attrs["run_outcome"] in ("completed", "sliding_mode")


def test_states_inside_steps_are_those_along_the_switch() -> None:
    """Assert states at times within long steps along a switch, and after one that is left."""
    run = march(MEETING, until="1 s")
    met = 17 / 14
    inside = run.dynamics.at([0.1, 0.5, 0.9])
    assert inside.x.values == pytest.approx(
        [1.3, met - (0.5 - 1 / 7) * 6 / 17, met - (0.9 - 1 / 7) * 6 / 17], abs=1e-12
    )
    assert np.abs(inside.x.values - inside.y.values)[1:].max() < 1e-12


def test_members_of_a_sweep_slide_as_alone() -> None:
    """Assert ends and states at times of members of which some slide, to the bit those of single runs."""
    model = flows({"x": ("1 m", "(a - sign(x/(1*metre)))*metre/second")}, {"a": "0.5"})
    sweep = xd.sweep(model, {"a": "-0.5:2.5:13"}, method="dormand_prince", until="3 s")
    assert len({*sweep.run_outcome.values}) == 1
    for place, a in enumerate(sweep.a.values.tolist()):
        alone = march(model.replace(parameters={"a": repr(a)}))
        assert alone.x.values[-1] == sweep.end_x.values[place]


def test_an_older_archive_ends_there() -> None:
    """Assert the former rule, by its word, and that it is another record."""
    run = march(RELAY, sliding="ends")
    assert run.attrs["run_outcome"] == "sliding_mode"
    assert not [name for name in run.variables if "share" in str(name)]
    with pytest.raises(xd.InputError, match="sliding is 'yes'; there are 'Filippov', 'ends'"):
        march(RELAY, sliding="yes")


def test_a_record_is_reproduced_and_goes_on(tmp_path: Any) -> None:
    """Assert that an archive of a sliding motion is made again to the bit, and extended as one run would be."""
    run = march(RELAY, path=tmp_path / "run.nc")
    assert xd.reproduce(tmp_path / "run.nc").attrs["identical"] == 1
    longer = xd.extend(tmp_path / "run.nc", until="4 s")
    assert longer.attrs["run_outcome"] == "completed"
    assert longer.x.values[-1] == run.x.values[-1]
    assert longer.switch_share_x_sign.values[-1] == 0.75


def test_what_forces_do_not_decide_is_told() -> None:
    """Assert the words where the motion comes to two switches whose forces leave no motion, or leave several."""
    # on y = 0 with x' = -1 the motion arrives at x = 0; there both sides of y drive away
    model = flows(
        {
            "x": ("1 m", "-1*metre/second - 0.5*metre/second*sign(x/(1*metre))"),
            "y": ("0 m", "where(x > 0*metre, -1, 1)*sign(y/(1*metre))*metre/second"),
        }
    )
    run = march(model)
    assert run.attrs["run_outcome"] == "sliding_mode"
    assert "motions go on, along it or to a side: forces do not decide which" in run.attrs["run_outcome_text"]
    assert run.sizes["step"] == int(run.event_row_after[-1]) + 1
    with pytest.raises(xd.ModelError, match="switch_share_x_sign"):
        flows({"x": ("1 m", "-sign(x/(1*metre))*metre/second"), "switch_share_x_sign": ("1 m", "0*metre/second")})


def test_a_force_that_jumps_leaves_the_switch_to_a_side() -> None:
    """Assert that a motion along one switch leaves it where another is passed, behind which its share would be 5/4."""
    rate = "(where(y > 0*metre, 0.5, 1.5) - sign(x/(1*metre)))*metre/second"
    run = march(flows({"x": ("0.5 m", rate), "y": ("2 m", "-1*metre/second")}))
    assert run.attrs["run_outcome"] == "completed"
    assert run.event_time.values == pytest.approx([1.0, 2.0], abs=1e-11)
    slides = ~np.isnan(run.switch_share_x_sign.values)
    assert run.switch_share_x_sign.values[slides] == pytest.approx(0.75)
    assert (run.time.values[slides].min(), run.time.values[slides].max()) == pytest.approx((1.0, 2.0), abs=1e-11)
    assert run.x.values[-1] == pytest.approx(0.5, abs=1e-10)


def test_models_whose_forces_jump_without_an_event_end_there() -> None:
    """Assert that a table of steps in time, which may jump while a motion slides, leaves the former rule."""
    table = {
        "table": "push.csv",
        "csv": "time [s],push [N]\n0,0\n2,3\n4,0\n",
        "argument": "t",
        "interpolation": "previous",
    }
    model = xd.Model(
        name="pushed",
        coordinates={"x": "m"},
        mass={"x": "1*kilogram"},
        drives={"push": table},
        forces={"push": {"x": "push"}, "dry": {"x": DRY}},
        initial={"x": "0 m", "v_x": "0.5 m s-1"},
    )
    run = march(model, until="1 s")
    assert run.attrs["run_outcome"] == "sliding_mode"
    assert "solver_sliding" not in run.attrs


def test_a_reset_takes_the_motion_off_the_switch() -> None:
    """Assert that a motion that an event sets elsewhere goes on from there, and slides again where it comes back."""
    kick = {"function": "t - 2.5*second", "direction": "rising", "action": "reset", "set": {"x": "1*metre"}}
    states = {"x": {"unit": "m", "rate": "(0.5 - sign(x/(1*metre)))*metre/second"}}
    model = xd.Model(name="kicked", states=states, initial={"x": "1 m"}, events={"kick": kick})
    assert march(model).x.values[-1] == pytest.approx(0.75, abs=1e-10)
    assert march(model, until="6 s").switch_share_x_sign.values[-1] == pytest.approx(0.75)


@pytest.mark.parametrize("a", ["0.5", "0.7"])
def test_states_inside_steps_are_those_of_the_own_parameters(a: str) -> None:
    """Assert a state inside a step along a switch, of two models that differ in a number: y = 1/(2 (1 - a)) - 1 + a t."""
    states = {
        "x": {"unit": "m", "rate": "(a - sign(x/(1*metre)))*metre/second"},
        "y": {"unit": "m", "rate": "x/(1*second) + sign(x/(1*metre))*metre/second"},
    }
    model = xd.Model(name="fed", states=states, parameters={"a": a}, initial={"x": "1 m", "y": "0 m"})
    met = 1.0 / (1.0 - float(a))
    exact = met / 2.0 + met + float(a) * (5.0 - met)
    assert march(model, until="6 s").dynamics.at([5.0]).y.values == pytest.approx([exact], abs=1e-11)


def test_functions_that_numbers_make_equal_are_two_switches() -> None:
    """Assert that a member whose thresholds coincide has the columns of those whose do not, and ends in words."""
    rate = "(where(x > h, -1, 0) + where(x < -h, 1, 0) + 0.25)*metre/second"
    model = flows({"x": ("-1 m", rate)}, {"h": "0.1 m"})
    sweep = xd.sweep(model, {"h": "0:0.2:3 m"}, method="dormand_prince", until="5 s")
    for h in ("0 m", "0.1 m"):
        alone = march(model.replace(parameters={"h": h}), until="0.1 s")
        assert sum(str(name).startswith("switch_share") for name in alone.data_vars) == 2
    assert sweep.run_outcome.values.tolist() == ["sliding_mode", "completed", "completed"]
    assert sweep.end_x.values[1:] == pytest.approx([0.1, 0.2], abs=1e-10)


def test_members_that_slide_have_their_own_steps() -> None:
    """Assert ends of members of other steps, after a stretch along the switch that is curved in time, as alone."""
    model = braked({"drive": "1.7*newton*sin(t/(1*second))", "dry": DRY})
    sweep = xd.sweep(model, {"step": ["0.1 s", "0.2 s"]}, method="rk4", until="2 s")
    for step, end in zip(("0.1 s", "0.2 s"), sweep.end_x.values.tolist(), strict=True):
        assert march(model, "rk4", "2 s", step=step).x.values[-1] == end


def test_a_table_before_a_relay_keeps_its_flags() -> None:
    """Assert states at times of members that slide in a model whose table has sides of its own."""
    table = {"table": "k.csv", "csv": "z [m],pull [m s-1]\n-5,0.5\n0.3,0.5\n5,0.4\n", "argument": "z"}
    model = xd.Model(
        name="tabled",
        states={
            "z": {"unit": "m", "rate": "pull"},
            "x": {"unit": "m", "rate": "(0.5 - a*sign(x/(1*metre)))*metre/second"},
        },
        drives={"pull": table},
        parameters={"a": "1"},
        initial={"z": "0 m", "x": "1 m"},
    )
    sweep = xd.sweep(model, {"a": "0.8:1.6:3"}, method="dormand_prince", until="4 s", keep=["x"], times="0:4:17 s")
    for a, states in zip(sweep.a.values.tolist(), sweep.x.values, strict=True):
        alone = march(model.replace(parameters={"a": repr(a)}), until="4 s")
        assert np.array_equal(states, alone.dynamics.at("0:4:17 s").x.values)


def two_regimes(drive: str, *, events: dict[str, Any] | None = None, third: str = "", **initial: str) -> xd.Model:
    """A mass of 1 kg whose dry friction of 1 N is two regimes, driven along x; the first regime is that of its start."""
    regimes = {"forth": {"forces": ["drive", "against"]}, "back": {"forces": ["drive", "along"]}}
    if initial.get("v_x", "0").startswith("-"):
        regimes = dict(reversed(regimes.items()))
    if third:
        regimes[third] = {"forces": ["drive"]}
    switch = {"action": "switch", "direction": "falling"}
    return xd.Model(
        name="two_regimes",
        coordinates={"x": "m"},
        mass={"x": "1*kilogram"},
        forces={"drive": {"x": drive}, "against": {"x": "-1*newton"}, "along": {"x": "1*newton"}},
        regimes=regimes,
        initial={"x": "0 m", "v_x": "0 m s-1"} | initial,
        events={
            "halt": {"function": "v_x", "to": "back", **switch},
            "go": {"function": "-2*v_x", "to": "forth", **switch},
            **(events or {}),
        },
    )


SWUNG = "1.7*newton*sin(t/(1*second))"


@pytest.mark.parametrize("method", ["dormand_prince", "rk4", "radau_iia", "taylor"])
def test_regimes_slide_as_a_sign_does(method: str) -> None:
    """Assert that dry friction by two regimes and by a sign are one motion, with the same events, forces and shares."""
    ours = march(two_regimes(SWUNG, v_x="-0.3 m s-1"), method, "9 s")
    theirs = march(braked({"drive": SWUNG, "dry": DRY}, v_x="-0.3 m s-1"), method, "9 s")
    assert kinds(ours) == kinds(theirs) == ["slide", "leave"] * 3
    assert ours.event_time.values == pytest.approx(theirs.event_time.values, abs=1e-9)
    assert ours.x.values[-1] == pytest.approx(theirs.x.values[-1], abs=1e-9)
    share, force = ours.switch_share_halt.values, ours.force_against_x + ours.force_along_x
    slides = ~np.isnan(share)
    assert force.values[slides] == pytest.approx(1.0 - 2.0 * share[slides], abs=1e-12)
    assert {*ours.regime.values[slides].tolist()} == {2}
    assert ours.regime.attrs["flag_meanings"] == "back forth slides_halt"


def test_a_start_at_rest_between_regimes_slides_at_once() -> None:
    """Assert that one event at the start says so, and that the motion leaves where the drive exceeds friction."""
    run = march(two_regimes("1.05*newton*sin(t/(1*second))"), until="9 s")
    assert kinds(run) == ["slide", "leave"] * 3 + ["slide"]
    assert run.event_time.values[:2] == pytest.approx([0.0, asin(1 / 1.05)], abs=1e-11)


def test_regimes_and_a_sign_on_one_border_have_one_share() -> None:
    """Assert that friction half by regimes and half by a sign slides as the whole by a sign."""
    model = two_regimes("2.5*newton*sin(t/(1*second))", v_x="0.5 m s-1")
    text = model.to_toml().replace("[regimes", '[forces.more]\nx = "-1*newton*sign(v_x)"\n[regimes', 1)
    mixed = xd.Model.from_text(text.replace('"against"]', '"against", "more"]').replace('"along"]', '"along", "more"]'))
    whole = braked({"drive": "2.5*newton*sin(t/(1*second))", "dry": "-2*newton*sign(v_x)"}, v_x="0.5 m s-1")
    ours, theirs = march(mixed, until="9 s"), march(whole, until="9 s")
    times = np.unique(ours.event_time.values)
    assert times == pytest.approx(theirs.event_time.values, abs=1e-9)
    assert ours.x.values[-1] == pytest.approx(theirs.x.values[-1], abs=1e-8)
    assert [name for name in ours.data_vars if str(name).startswith("switch_share")] == ["switch_share_halt"]


def test_what_else_happens_between_regimes() -> None:
    """Assert that a stop outweighs sliding, a reset takes the motion off, a third regime ends it, and three do not slide."""
    falls = {"function": "v_x", "direction": "falling"}
    stopped = march(two_regimes("0*newton", v_x="0.5 m s-1", events={"end": falls | {"action": "stop"}}))
    assert (stopped.attrs["run_outcome"], stopped.time.values[-1]) == ("stopped_by_event", pytest.approx(0.5))
    late = {"function": "t - 2*second", "direction": "rising"}
    kick = late | {"action": "reset", "set": {"v_x": "1*metre/second"}}
    assert march(two_regimes("0*newton", events={"kick": kick})).x.values[-1] == pytest.approx(0.5, abs=1e-9)
    to_third = {"action": "switch", "to": "free"}
    freed = march(two_regimes("0.3*newton", events={"loose": late | to_third}, third="free"))
    # a regime without friction moves it, which is the passage at which 'go' acts, behind which it slides
    assert kinds(freed) == ["slide", "regime_switch", "slide"]
    assert freed.event_time.values == pytest.approx([0.0, 2.0, 2.0])
    third = march(two_regimes("0.3*newton", events={"loose": falls | to_third}, third="free", v_x="0.5 m s-1"))
    assert third.attrs["run_outcome"] == "sliding_mode"


@pytest.mark.parametrize("stop", ["v_x", "2*v_x"])
def test_a_stop_where_a_sign_would_hold_ends_the_run(stop: str) -> None:
    """Assert that a car braked by a sign ends its run at rest, as its event asks for."""
    halt = {"function": stop, "direction": "falling", "action": "stop"}
    forces = {"brake": {"x": "-2*newton*sign(v_x)"}}
    start = {"x": "0 m", "v_x": "20 m s-1"}
    model = xd.Model(
        name="car",
        coordinates={"x": "m"},
        mass={"x": "1*kilogram"},
        forces=forces,
        initial=start,
        events={"halt": halt},
    )
    run = march(model, until="20 s")
    assert run.attrs["run_outcome"] == "stopped_by_event"
    assert (run.time.values[-1], run.x.values[-1]) == pytest.approx((10.0, 100.0))


def test_switches_that_multiply_are_told() -> None:
    """Assert that a product of two signs, whose sides do not add up, ends the run in words."""
    rate = "-(sign(x/(1*metre)) + 0.5*sign(x/(1*metre))*sign(y/(1*metre)))*metre/second"
    run = march(flows({"x": ("1 m", rate), "y": ("1 m", "-sign(y/(1*metre))*metre/second")}))
    assert run.attrs["run_outcome"] == "sliding_mode"
    assert run.event_time.values == pytest.approx([2 / 3, 1.0, 1.0])
    assert "a product of both" in run.attrs["run_outcome_text"]


def test_small_changes_along_a_switch_are_differences() -> None:
    """Assert the slope of a budget: what is fed by the share is 5 m by differences, and the equations take no part."""
    states = {
        "x": {"unit": "m", "rate": "(a - sign(x/(1*metre)))*metre/second"},
        "y": {"unit": "m", "rate": "x/(1*second) + sign(x/(1*metre))*metre/second"},
    }
    model = xd.Model(name="fed", states=states, parameters={"a": "0.5 +- 0.01"}, initial={"x": "1 m", "y": "0 m"})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        budget = xd.error_budget(model, "y", at="3 s", method="dormand_prince", until="3 s", rtol=1e-9)
    assert budget.sensitivity.values[budget.term_name.values == "a"] == pytest.approx(5.0, abs=1e-6)


def test_records_that_slide_contradict_nothing() -> None:
    """Assert the gates of a motion that slides between regimes and leaves, and those of a record whose share is false."""
    run = march(two_regimes(SWUNG, v_x="-0.3 m s-1"), until="9 s")
    assert [(gate.name, gate.verdict) for gate in audit(run)] == [
        ("events_met", "passed"),
        ("slides_on_switch", "passed"),
    ]
    share = run.switch_share_halt.values.copy()
    share[~np.isnan(share)] = 1.25
    (_, gate) = audit(run.assign(switch_share_halt=run.switch_share_halt.copy(data=share)))
    assert (gate.verdict, gate.reason) == ("failed", "the share of switch 'halt' is not between 0 and 1")
    moved = run.v_x.copy(data=np.where(np.isnan(share), run.v_x.values, 0.02))
    (_, gate) = audit(run.assign(v_x=moved))
    assert "is off it: by the forces of one side it would come back in 0.01 s" in gate.reason


@pytest.mark.parametrize(("method", "off"), [("dormand_prince", 1e-5), ("taylor", 1e-6), ("midpoint", 1e-3)])
def test_a_motion_slides_along_a_circle(method: str, off: float) -> None:
    """Assert that a motion driven to the unit circle from both sides goes round it: x = cos(t), off it by the method."""
    pull = "sign(x*x + y*y - 1*metre**2)/(1*second)"
    run = march(
        flows(
            {
                "x": ("1 m", f"-y/(1*second) - x*{pull}"),
                "y": ("0 m", f"x/(1*second) - y*{pull}"),
            }
        ),
        method,
        "6 s",
    )
    assert run.attrs["run_outcome"] == "completed"
    assert np.abs(run.x.values**2 + run.y.values**2 - 1.0).max() < off
    assert run.x.values[-1] == pytest.approx(np.cos(6.0), abs=3 * off)
    assert [gate.verdict for gate in audit(run)] == ["passed"]


def test_forces_between_rows_are_those_along_the_switch() -> None:
    """Assert the largest friction that holds a mass, which no accepted row has, of a run and of members."""
    drive = {"drive": "F*sin(t/(1*second))", "dry": DRY}
    model = xd.Model(
        name="held",
        coordinates={"x": "m"},
        mass={"x": "1*kilogram"},
        parameters={"F": "0.8 N"},
        forces={name: {"x": tree} for name, tree in drive.items()},
        initial={"x": "0 m", "v_x": "-0.3 m s-1"},
    )
    run = march(model, until="6 s")
    diagnosis = xd.diagnose(run)
    assert run.force_dry_x.values.min() > -0.7
    assert float(diagnosis.minimum_force_dry_x) == pytest.approx(-0.8, abs=1e-9)
    assert float(diagnosis.minimum_force_dry_x_time) == pytest.approx(pi / 2, abs=1e-6)
    sweep = xd.sweep(model, {"F": "0.7:0.9:3 N"}, method="dormand_prince", until="6 s", keep=["minimum_force_dry_x"])
    assert sweep.minimum_force_dry_x.values == pytest.approx([-0.7, -0.8, -0.9], abs=1e-9)


AT_REST = {
    "sign": {"f": "-2*newton*sign(x)"},
    "sign and a push": {"f": "-2*newton*sign(x)", "push": "1*newton"},
    "where": {"f": "where(x > 0*metre, -2*newton, 0.4*newton)"},
    "with friction": {"f": "-2*newton*sign(x)", "dry": "-0.5*newton*sign(v_x)"},
    "friction of the other sign": {"f": "2*newton*sign(-3*x)", "dry": "-0.5*newton*sign(v_x)", "push": "1*newton"},
    "with a spring": {"f": "-2*newton*sign(x)", "spring": "-3*newton/metre*x"},
}
# of the positive side; 1/2 elsewhere
SHARES = {"sign and a push": 0.75, "where": 1 / 6, "friction of the other sign": 0.3}


@pytest.mark.parametrize("method", [*METHODS, "velocity_verlet"])
@pytest.mark.parametrize("case", AT_REST)
def test_a_mass_at_rest_that_both_sides_drive_back_stays(case: str, method: str) -> None:
    """Assert that it rests at zero to the bit with one share, where it was switched 10^11 times a second."""
    if method == "velocity_verlet" and "friction" in case:
        pytest.skip("a force that reads velocities has no such method")
    given = {"step": "10 ms"} if method == "velocity_verlet" else {}
    run = march(braked(AT_REST[case]), method, **given)
    assert run.attrs["run_outcome"] == "completed"
    assert set(kinds(run)) == {"slide"}
    assert set(run.event_time.values.tolist()) == {0.0}
    assert not run.x.values.any()
    assert not run.v_x.values.any()
    (share,) = [run[name] for name in run.data_vars if str(name).startswith("switch_share_f")]
    assert share.values[2:] == pytest.approx(SHARES.get(case, 0.5), abs=1e-15)
    assert {gate.verdict for gate in audit(run)} == {"passed"}


def test_a_potential_with_an_edge_holds_a_mass_and_keeps_its_energy() -> None:
    """Assert that 2 N |x| holds what rests at its edge, and lets go of what is pushed harder, at asin(2/3)."""
    model = braked({"valley": {"potential": "2*newton*abs(x)"}, "push": "3*newton*sin(t/second)"})
    run = march(model, until="1 s", rtol=1e-11)
    assert kinds(run) == ["slide", "leave"]
    left = asin(2 / 3)
    assert run.event_time.values[1] == pytest.approx(left, abs=1e-10)
    past = 1.0 - left
    there = 3 * (np.cos(left) * past + np.sin(left) - np.sin(1.0)) - past**2
    assert float(run.x[-1]) == pytest.approx(there, abs=1e-10)


@pytest.mark.parametrize("method", METHODS)
def test_passages_that_crowd_together_end_at_rest(method: str) -> None:
    """Assert when a mass that a sign drives back and dry friction brakes comes to rest: a geometric series of swings.

    From x it comes to the switch after sqrt(2 x/(F - D)); each swing is sqrt((F - D)/(F + D)) of the one before.
    The `twisting algorithm`: Levant, Int. J. Control 58, 1993, doi:10.1080/00207179308923053.
    """
    force, dry, start = 2.0, 0.5, 0.3
    run = march(braked(AT_REST["with friction"], x=f"{start} m"), method, "6 s")
    assert run.attrs["run_outcome"] == "completed"
    speed, ratio = sqrt(2 * (force - dry) * start), sqrt((force - dry) / (force + dry))
    swing = speed / (force + dry) * (1 + 1 / ratio)
    ends = speed / (force - dry) + swing / (1 - ratio)
    assert kinds(run)[-1] == "slide"
    assert float(run.event_time[-1]) == pytest.approx(ends, abs=1e-8)
    assert abs(float(run.x[-1])) < 1e-9
    assert abs(float(run.v_x[-1])) < 1e-9
    assert run.sizes["event"] < 400


def test_a_mass_moves_within_a_valley() -> None:
    """Assert the motion along an inclined edge, and along a circle, that forces on both sides drive it back to."""
    plane = {
        "coordinates": {"x": "m", "y": "m"},
        "mass": {"x": "1*kilogram", "y": "1*kilogram"},
    }
    side = "sign(x - 0.3*y)"
    model = xd.Model(
        name="edge",
        forces={"edge": {"x": f"-2*newton*{side}", "y": f"0.6*newton*{side}"}, "weight": {"y": "-1*newton"}},
        initial={"x": "0 m", "v_x": "0.3 m s-1", "y": "0 m", "v_y": "1 m s-1"},
        **plane,
    )
    run, t = march(model), 3.0
    y = t - t * t / (2 * 1.09)
    assert (float(run.x[-1]), float(run.y[-1])) == pytest.approx((0.3 * y, y), abs=1e-9)
    side = "sign(x*x + y*y - metre**2)"
    model = xd.Model(
        name="circle",
        forces={"edge": {q: f"-3*newton*{side}*{q}/metre" for q in ("x", "y")}},
        initial={"x": "1 m", "v_x": "0 m s-1", "y": "0 m", "v_y": "1 m s-1"},
        **plane,
    )
    run = march(model, rtol=1e-11)
    assert (float(run.x[-1]), float(run.y[-1])) == pytest.approx((np.cos(3.0), np.sin(3.0)), abs=1e-8)


def test_a_rest_on_a_switch_is_the_same_everywhere(tmp_path: Path) -> None:
    """Assert a sweep, a file, a run that goes on, states inside steps, and words where nothing may slide."""
    model = braked(AT_REST["sign and a push"])
    run = march(model)
    path = tmp_path / "rest.nc"
    xd.save(run, path)
    assert xd.reproduce(path).attrs["identical"]
    assert not xd.sample(run, [0.1, 1.7]).x.values.any()
    longer = xd.extend(march(model, until="1 s"), until="3 s")
    assert float(longer.x[-1]) == 0.0
    pushed = braked({"f": "-2*newton*sign(x)", "push": "p"}, parameters={"p": "1 N"})
    swept = xd.sweep(
        pushed, {"p": np.array([1.0, 1.5, 3.0])}, keep=["end_x"], method="dormand_prince", until="2 s"
    ).compute()
    assert swept.end_x.values == pytest.approx([0.0, 0.0, 2.0], abs=1e-12)
    with pytest.warns(xd.AccuracyWarning, match="sliding mode"):
        ended = march(model, sliding="ends")
    assert ended.sizes["event"] == 1


def test_a_mass_that_moves_off_a_switch_is_no_rest() -> None:
    """Assert that the audit sees a velocity in a record of rest."""
    run = march(braked(AT_REST["sign"]))
    moved = run.assign(v_x=run.v_x + 0.1 * (run.time > 0.0))
    moved.v_x.attrs.update(run.v_x.attrs)
    (gate,) = [gate for gate in audit(moved) if gate.name == "slides_on_switch"]
    assert gate.verdict != "passed"
    assert "is off it" in gate.reason


def test_what_no_share_is_known_of_ends_in_words() -> None:
    """Assert that a root whose rate is not known at zero, and a point of a table that both sides drive back to, end a run."""
    root = flows(
        {
            "x": ("0 m", "w*metre/(1*metre)/second - 2*metre/second*sqrt(abs(x/(1*metre)))*sign(x)"),
            "w": ("0 m", "-1.5*metre/second*sign(x)"),
        }
    )
    jump = {"csv": "x [m],F [N]\n-5,2\n0,-2\n5,-2\n", "interpolation": "previous", "argument": "x"}
    table = braked({"f": "F"}, drives={"F": {"table": "f.csv"} | jump})
    for model in (root, table):
        with pytest.warns(xd.AccuracyWarning, match="sliding mode"):
            run = march(model, max_steps=500)
        assert run.attrs["run_outcome"] == "sliding_mode"
        assert run.sizes["event"] < 4


@pytest.mark.parametrize("late", [1e-13, 5e-12, 5e-11])
def test_a_passage_right_after_a_step_is_no_rest(late: float) -> None:
    """Assert that a mass at 1 m/s passes a switch a moment after a row, and turns back a second later."""
    model = braked({"f": "where(x > 0*metre, -2*newton, 0*newton)"}, x=f"{-0.5 - late!r} m", v_x="1 m s-1")
    run = march(model, "rk4", "2 s", step="0.5 s")
    assert run.attrs["run_outcome"] == "completed"
    assert kinds(run) == ["regime_switch"] * 2
    assert run.event_time.values == pytest.approx([0.5 + late, 1.5 + late], abs=1e-11)
    assert float(run.v_x[-1]) == pytest.approx(-1.0, abs=1e-9)


def test_what_rest_is_judged_by_is_not_counted() -> None:
    """Assert that a start on a switch which the motion leaves has the force evaluations that earlier archives have."""
    run = march(braked({"f": "-2*newton*sign(x)", "push": "3*newton"}), "rk4", "1 s", step="0.1 s")
    assert run.attrs["run_force_evaluations"] == 191

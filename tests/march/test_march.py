"""The march: time grid, nodes, events, outcomes, memory between blocks."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import EPS, MODELS, free, oscillator, particle, pushed
from xdynamics import record
from xdynamics.documenting.summary import summary
from xdynamics.kernels import numba_text
from xdynamics.kernels.engine_part import EnginePart
from xdynamics.march import March, Settings, runner
from xdynamics.march.configuration import settings_for
from xdynamics.schema import EVENT_AFTER, EVENT_BEFORE, NODE, REASON_EVENT


def timed(function: str, **event: str) -> xd.Model:
    """A free particle with one event."""
    return particle(events={"mark": {"function": function} | event})


def test_grid_is_never_a_sum() -> None:
    """Assert that times are t0 + n h to the bit, so that refined runs share them."""
    coarse = xd.simulate(free().model, method="midpoint", step=0.1, until=3.0, force_samples="none")
    fine = xd.simulate(free().model, method="midpoint", step=0.05, until=3.0, force_samples="none")
    assert (coarse.time.values[:-1] == 0.1 * np.arange(30)).all()
    assert (fine.time.values[::2] == coarse.time.values).all()
    assert coarse.time.values[-1] == 3.0


def test_last_step_is_partial_and_said_so() -> None:
    """Assert that a step that does not divide the span ends in a shorter one."""
    run = xd.simulate(free().model, method="midpoint", step=0.3, until=1.0, force_samples="none")
    assert run.time.values.tolist() == [0.0, 0.3, 0.6, 3 * 0.3, 1.0]
    assert run.step_size.values[-1] == 1.0 - 3 * 0.3
    assert run.attrs["solver_last_step"].startswith("partial, 0.1 s")


def test_step_longer_than_the_span() -> None:
    """Assert that one partial step is made."""
    run = xd.simulate(free().model, method="midpoint", step=5.0, until=1.0, force_samples="none")
    assert run.time.values.tolist() == [0.0, 1.0]


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"step": 0}, "step is 0.0 s, needs a positive time"),
        ({"step": "-1 ms"}, "step is -0.001 s, needs a positive time"),
        ({"step": "nan s"}, "step: quantity 'nan s'"),
        ({"step": "1 kg"}, "step '1 kg' has units 'kg', needs 's'"),
        ({"until": 0}, "until is 0.0 s, needs a time after the start"),
        ({"step": 1e-300}, "makes over 2"),
        ({"force_samples": "some"}, "force_samples is 'some'"),
    ],
)
def test_wrong_setting(asked: dict[str, object], message: str) -> None:
    """Assert that a setting no march could use is refused before anything runs."""
    with pytest.raises(xd.InputError, match=message):
        xd.simulate(free().model, **({"method": "midpoint", "step": 0.1, "until": 1.0} | asked))


def test_missing_setting() -> None:
    """Assert that a setting that stands nowhere is asked for."""
    with pytest.raises(xd.InputError, match=r"has no step in its \[run\]; give step="):
        xd.simulate(free().model, method="midpoint", until=1.0)


TABLE = "time [s],force [N]\n0,0\n0.25,4\n0.7,1\n1,1\n"


def driven(rule: str, outside: str = "error") -> xd.Model:
    """A particle under a measured force."""
    drive = {"table": "f.csv", "csv": TABLE, "interpolation": rule, "outside": outside}
    return particle("pull", v="0 m s-1", drives={"pull": drive})


def test_march_lands_on_nodes() -> None:
    """Assert that breakpoints of a drive are rows, between the grid times that stay where they are."""
    run = xd.simulate(driven("linear"), method="midpoint", step=0.2, until=1.0)
    assert run.time.values.tolist() == [0.0, 0.2, 0.25, 0.4, 3 * 0.2, 0.7, 0.8, 1.0]
    assert run.time.values[run.row_kind == NODE].tolist() == [0.25, 0.7]


def test_linear_drive_gives_its_exact_impulse() -> None:
    """Assert that midpoint integrates a piecewise linear force exactly, whatever the step."""
    run = xd.simulate(driven("linear"), method="midpoint", step=0.2, until=1.0)
    impulse = 0.25 * 2 + 0.45 * 2.5 + 0.3
    assert abs(run.v_x.values[-1] - impulse / 2) < 8 * EPS


def test_jump_of_a_drive_falls_between_steps() -> None:
    """Assert that a force that jumps at a node is taken from its own side in every stage, also by Verlet."""
    for method in ("velocity_verlet", "midpoint", "forward_euler"):
        run = xd.simulate(driven("previous"), method=method, step=0.2, until=1.0)
        assert abs(run.v_x.values[-1] - (0.45 * 4 + 0.3 * 1) / 2) < 8 * EPS, method


def test_outside_its_table_a_drive_ends_the_run() -> None:
    """Assert that the outcome names drive, argument and table, and keeps the rows up to there."""
    run = xd.simulate(driven("linear"), method="midpoint", step=0.2, until=2.0)
    assert run.attrs["run_outcome"] == "outside_drive_table"
    assert (
        "drive 'pull' was evaluated at t = 1.1, and its table 'f.csv' reaches from 0 to 1"
        in run.attrs["run_outcome_text"]
    )
    assert run.time.values[-1] == 1.0
    held = xd.simulate(driven("linear", "hold"), method="midpoint", step=0.2, until=2.0)
    assert held.attrs["run_outcome"] == "completed"
    assert held.force_push_x.values[-1] == 1.0


@pytest.mark.parametrize(("rule", "last"), [("previous", 4.0), ("linear", 1.0), ("pchip", 1.0), ("cubic", 1.0)])
def test_outside_its_table_a_drive_holds_the_value_at_that_end(rule: str, last: float) -> None:
    """Assert that before its table a drive has the first value and behind it the last, in state, samples and motion."""
    csv = (
        "time [s],force [N]\n0.5,8\n1,4\n1.5,2\n2,1\n"
        if rule != "previous"
        else "time [s],force [N]\n0.5,8\n1,6\n2,4\n"
    )
    drive = {"table": "f.csv", "csv": csv, "interpolation": rule, "outside": "hold"}
    run = xd.simulate(particle("pull", v="0 m s-1", drives={"pull": drive}), method="midpoint", step=0.25, until=3.0)
    before, behind = run.time.values <= 0.5, run.time.values > 2.0
    assert (run.force_push_x.values[before] == 8.0).all()
    assert (run.force_push_x.values[behind] == last).all()
    assert run.v_x.values[before].tolist() == [0.0, 1.0, 2.0]
    assert set(run.sample_pull.values[run.sample_time.values < 0.5].tolist()) == {8.0}


@pytest.mark.parametrize("outside", ["hold", "zero"])
def test_outside_its_table_a_drive_of_a_coordinate(outside: str) -> None:
    """Assert the force on either side of a table over x: of its nearer end, or none."""
    table = {"table": "f.csv", "csv": "x [m],f [N]\n0,3\n1,5\n2,7\n", "argument": "x", "outside": outside}
    for place, held in (("-1 m", 3.0), ("0 m", 3.0), ("2 m", 7.0), ("3 m", 7.0)):
        run = pushed_by("f", drives={"f": table}, initial={"x": place, "v_x": "0 m s-1"})
        inside = place in ("0 m", "2 m")
        assert float(run.force_push_x[0]) == (held if outside == "hold" or inside else 0.0), place


def test_event_brackets_its_root() -> None:
    """Assert bracket, both rows, direction, residual and uncertainty of a passage at t = 1/3 s."""
    run = xd.simulate(timed("x - 2*metre"), method="midpoint", step=0.1, until=1.0)
    low, high = run.event_time_bounds.values[0]
    assert low < 1 / 3 <= high + EPS
    assert 0 < high - low <= 1e-12
    assert run.event_time.values[0] == high
    before, after = int(run.event_row_before[0]), int(run.event_row_after[0])
    assert after == before + 1
    assert run.row_kind.values[[before, after]].tolist() == [EVENT_BEFORE, EVENT_AFTER]
    assert run.time.values[before] == run.time.values[after] == high
    assert run.event_direction.values.tolist() == [1]
    assert high - low <= float(run.event_time_uncertainty[0]) < 2e-12
    # the grid goes on where it was
    assert run.time.values[after + 1] == 4 * 0.1


def test_no_event_is_located_better_than_t_is_spaced() -> None:
    """Assert half a spacing of t as the least uncertainty, the parts beside it, and words that speak of the location alone."""
    asked = {"method": "dop853", "rtol": 1e-10, "event_root_method": "one by one"}
    run = xd.simulate(xd.Model.from_toml(MODELS / "ball_drag.toml"), **asked)
    parts = [run[f"event_time_uncertainty_{part}"].values for part in ("bracket", "residual", "interpolation")]
    least = np.spacing(run.event_time.values) / 2
    assert np.sum(parts, axis=0)[0] < least[0]  # the apex is met to the bit
    assert run.event_time_uncertainty.values.tolist() == np.maximum(np.sum(parts, axis=0), least).tolist()
    lines = [line for line in summary(run) if line.startswith("event")]
    assert len(lines) == 2
    assert all(", located within " in line and "±" not in line for line in lines)


def test_event_substeps_are_no_trials() -> None:
    """Assert that substeps are counted with their event alone, and that each was a step that evaluated forces."""
    asked = {"method": "midpoint", "step": 0.1, "until": 1.0}
    run, without = xd.simulate(timed("x - 2*metre"), **asked), xd.simulate(timed("x - 9*metre"), **asked)
    assert run.sizes["trial"] == run.attrs["run_rejected_trials"] == 0
    steps = run.attrs["run_force_evaluations"] - without.attrs["run_force_evaluations"]
    assert 2 * (int(run.event_substeps[0]) + 1) <= steps <= 2 * (int(run.event_substeps[0]) + 2)
    assert f"{int(run.event_substeps[0])} steps shortened to find events" in "".join(summary(run))


def test_event_substeps_were_rejected_trials() -> None:
    """Assert that by the rule of version 0.2 every trial of the bracket is kept, from one unchanged row."""
    run = xd.simulate(timed("x - 2*metre"), method="midpoint", step=0.1, until=1.0, event_root_method="one by one")
    assert (run.trial_reason == REASON_EVENT).all()
    assert set(run.trial_step.values.tolist()) == {3}
    assert run.trial_step_size.values[0] == 0.1


@pytest.mark.parametrize(("direction", "count"), [("rising", 3), ("falling", 3), ("either", 6)])
def test_event_direction(direction: str, count: int) -> None:
    """Assert that passages are counted in the direction asked: x = cos 2t crosses zero six times before 9.5 s."""
    model = xd.Model.from_text(
        oscillator().model.to_toml() + f'\n[events.passage]\nfunction = "x"\ndirection = "{direction}"\n'
    )
    run = xd.simulate(model, method="velocity_verlet", step=0.01, until=9.5)
    assert run.sizes["event"] == count
    expected = np.pi / 4 + np.pi / 2 * np.arange(6)
    chosen = {"falling": expected[::2], "rising": expected[1::2], "either": expected}[direction]
    assert np.abs(run.event_time.values - chosen).max() < 2e-4  # the method's own error at this step


@pytest.mark.parametrize(
    ("function", "direction"),
    [("2*metre - x", "falling"), ("x - 2*metre", "rising"), ("2*metre - x", "either"), ("x - 2*metre", "either")],
)
def test_a_root_at_the_very_end_of_a_step_is_found_there(function: str, direction: str) -> None:
    """Assert one event where the function is exactly zero at a step's end, there and not in the step behind it."""
    event = {"function": function, "direction": direction}
    model = particle(v="2 m s-1", events={"mark": event})  # x = 1 + 2 t
    for method in ("midpoint", "velocity_verlet"):
        run = xd.simulate(model, method=method, step=0.25, until=1.0)
        assert run.x.values[run.time.values == 0.5].tolist() == [2.0, 2.0]
        assert run.event_time.values.tolist() == [0.5]
        assert run.event_residual.values.tolist() == [0.0]
        assert run.event_direction.values.tolist() == [1 if function.startswith("x") else -1]
        assert run.time.values.tolist() == [0.0, 0.25, 0.5, 0.5, 0.75, 1.0]


@pytest.mark.parametrize("direction", ["rising", "falling", "either"])
def test_a_root_at_the_start_is_no_event(direction: str) -> None:
    """Assert that a function that leaves zero at the start, whichever way, did not cross it."""
    for function in ("x - 1*metre", "1*metre - x"):
        events = {"mark": {"function": function, "direction": direction}}
        assert xd.simulate(particle(events=events), method="midpoint", step=0.25, until=1.0).sizes["event"] == 0


def test_stop_ends_the_run_at_the_event() -> None:
    """Assert that a stopping event is the last row, and its name in the outcome."""
    run = xd.simulate(timed("x - 2*metre", action="stop"), method="midpoint", step=0.1, until=1.0)
    assert run.attrs["run_outcome"] == "stopped_by_event"
    assert "'mark'" in run.attrs["run_outcome_text"]
    assert run.time.values[-1] == run.event_time.values[0]


SHAPES: dict[str, Callable[[float], float]] = {
    "(t - {0}*second)/second": lambda off: off,
    "exp(3*(t - {0}*second)/second) - 1": lambda off: float(np.exp(3.0 * off)) - 1.0,
    "1 - exp(8*(t - {0}*second)/second)": lambda off: 1.0 - float(np.exp(8.0 * off)),
    "((t - {0}*second)/second)**3": lambda off: off**3,
}


@pytest.mark.cases(100)
def test_many_events_in_a_step_are_located_one_by_one(case: int) -> None:
    """Assert times, brackets, order and residuals of up to six crossings in two steps, flat ones too, far apart and at one time."""
    rng = np.random.default_rng(case)
    count = int(rng.integers(2, 7))
    roots = np.round(rng.uniform(0.05, 0.95, count), 6)
    roots[1] = roots[0] + float(rng.choice([0.0, 3e-8, 2e-4]))
    tolerances = 10.0 ** rng.integers(-12, -2, count).astype(float)
    shapes = [str(rng.choice([*SHAPES])) for _ in range(count)]
    events = {
        f"e{k}": {"function": shape.format(repr(root)), "time_tolerance": f"{tolerance!r} s"}
        for k, (shape, root, tolerance) in enumerate(zip(shapes, roots.tolist(), tolerances.tolist(), strict=True))
    }
    model = xd.Model(name="clock", states={"x": {"unit": "s", "rate": "1"}}, initial={"x": "0 s"}, events=events)
    steps: list[dict[str, Any]] = [{"method": "rk4", "step": 0.5}, {"method": "dop853", "rtol": 1e-6}]
    run = xd.simulate(model, until=1.0, **steps[case % 2])
    found, times, bounds = run.event_detector.values, run.event_time.values, run.event_time_bounds.values
    assert sorted(found.tolist()) == list(range(count))
    for row, k in enumerate(found.tolist()):
        # those that follow within their tolerance are waited for, one behind the other
        most = max(float(tolerances.sum()), 4e-16)
        assert bounds[row, 0] <= roots[k] + 2e-16
        assert roots[k] - 2e-16 <= bounds[row, 1] <= roots[k] + most * 1.001
        assert float(run.event_residual[row]) == pytest.approx(
            SHAPES[shapes[k]](float(times[row]) - roots[k]), rel=1e-6, abs=1e-14
        )
        assert float(run.event_direction[row]) == (-1 if shapes[k].startswith("1 -") else 1)
    assert (np.diff(times) >= 0.0).all()
    assert (times >= roots[found] - 2e-16).all()
    for row, k in enumerate(found.tolist()[1:], 1):  # what follows within half its tolerance is waited for
        flat = any(shapes[e].endswith("**3") for e in found[row - 1 : row + 1])  # is found when it leaves zero
        if roots[k] <= times[row - 1] + 0.5 * tolerances[k] and not flat:
            assert run.event_row_before[row] == run.event_row_before[row - 1]
    assert run.x.values == pytest.approx(run.time.values, abs=1e-15)
    assert (np.diff(run.event_row_before.values) >= 0).all()
    assert (run.event_row_after.values == run.event_row_before.values + 1).all()
    assert (run.time.values[run.event_row_before.values] == times).all()


def blow(expression: str) -> xd.Model:
    """A state that grows as it says, alone."""
    return xd.Model(
        name="blow", states={"y": {"unit": "1", "rate": expression}}, initial={"y": "1"}, parameters={"k": "1 s-1"}
    )


@pytest.mark.parametrize(
    ("model", "method", "step", "until", "word", "text"),
    [
        (lambda: blow("k*y**2"), "midpoint", 0.01, 2.0, "nonfinite_force", "rate_y is inf"),
        (
            lambda: particle("where(t > 1*second, F*sqrt(-1), F)"),
            "midpoint",
            0.125,
            2.0,
            "nonfinite_force",
            "force_push_x is nan in the evaluation at t = 1",
        ),
        (
            lambda: particle("F/where(t > 1*second, 0, 1)"),
            "forward_euler",
            0.125,
            2.0,
            "nonfinite_force",
            "force_push_x is inf in the evaluation at t = 1",
        ),
        (
            lambda: particle(mass={"x": "m*(1 - t/second)"}),
            "forward_euler",
            0.25,
            2.0,
            "nonfinite_force",
            "mass is not positive definite",
        ),
        (lambda: timed("log(1.5 - t/second)*metre"), "forward_euler", 0.25, 2.0, "nonfinite_event", "'mark'"),
        (
            lambda: particle(initial={"t": "1e9 s", "x": "1 m", "v_x": "1 m s-1"}),
            "midpoint",
            1e-8,
            1e9 + 0.125,
            "step_below_spacing",
            "t = 1000000000 s, h = 1e-08 s",
        ),
    ],
)
def test_bad_end_is_a_named_outcome(model, method, step, until, word, text) -> None:
    """Assert that a run that ends badly says how, with t, h and component, and keeps finite rows only."""
    run = xd.simulate(model(), method=method, step=step, until=until)
    assert run.attrs["run_outcome"] == word
    assert text in run.attrs["run_outcome_text"]
    assert "h = " in run.attrs["run_outcome_text"]
    for name in run.data_vars:
        if run[name].dims == ("step",) and run[name].dtype.kind == "f":
            assert np.isfinite(run[name]).all(), name


def test_blocks_go_on_to_the_same_bits() -> None:
    """Assert that small blocks, events at their borders included, hold what one block holds."""
    model = xd.Model.from_text(oscillator().model.to_toml() + '\n[events.passage]\nfunction = "x"\n')
    settings = Settings(xd.METHODS["velocity_verlet"], until=40.0, step=0.05)
    whole, parts = copied(March(model, settings), None), copied(March(model, settings), 7)
    assert len(parts) > 50
    for at, table in enumerate(("rows", "samples", "events")):
        one, other = (np.concatenate([part[at] for part in cut], axis=1) for cut in (whole, parts))
        assert (one == other).all(), table


def copied(march: March, rows: int | None) -> list[tuple[np.ndarray, ...]]:
    """March in blocks and keep their tables."""
    return [
        (
            block.log.rows[:, : block.rows].copy(),
            block.log.samples[:, : block.samples].copy(),
            np.array([block.log.events[name][: block.events] for name in block.log.events.dtype.names], float),
        )
        for block in march.blocks(rows)
    ]


def test_keyboard_interrupt_is_an_outcome() -> None:
    """Assert that Ctrl-C, as it comes in the middle of a march, ends a long run with the rows up to there."""

    def interrupt(_done: float, _t: float, _rows: int) -> None:
        signal.raise_signal(signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    asked = {"method": "midpoint", "step": 1e-7, "until": 3.0, "force_samples": "none"}
    run = xd.simulate(free().model, **asked, progress=interrupt)
    assert run.attrs["run_outcome"] == "interrupted"
    assert 0 < run.time.values[-1] < 3.0
    assert run.sizes["step"] > 1000
    assert signal.getsignal(signal.SIGINT) is before


def test_blocks_closed_by_another_thread_leave_the_keyboard_to_the_first() -> None:
    """Assert that blocks that were left unread do not end in an error where a thread collects them as garbage."""
    model, before = free().model, signal.getsignal(signal.SIGINT)
    try:
        blocks = March(model, settings_for(model, method="midpoint", step=0.1, until=3.0)).blocks(4)
        next(blocks)
        with ThreadPoolExecutor(1) as pool:
            pool.submit(blocks.close).result()
        assert signal.getsignal(signal.SIGINT) is not before
    finally:
        signal.signal(signal.SIGINT, before)


def test_ctrl_c_while_the_engine_is_made_ends_at_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Assert that numba is not waited for: nothing is written, the keyboard is as before, and the next run is whole."""

    def interrupted(_functions: object) -> str:
        signal.raise_signal(signal.SIGINT)
        return ""

    part = EnginePart("unmade", "a part", 1, ())
    before, asked = signal.getsignal(signal.SIGINT), {"method": "midpoint", "step": 0.1, "until": 3.0}
    with monkeypatch.context() as unmade:
        unmade.setenv("XDYNAMICS_CACHE", str(tmp_path / "cache"))
        unmade.setattr(numba_text, "text_of", interrupted)
        unmade.setattr(runner, "engine", part.entries)
        with pytest.raises(KeyboardInterrupt):
            xd.simulate(free().model, **asked, path=tmp_path / "run.nc")
    assert signal.getsignal(signal.SIGINT) is before
    assert not [*tmp_path.glob("*run*"), *tmp_path.glob("cache/unmade*")]
    assert xd.simulate(free().model, **asked).attrs["run_outcome"] == "completed"


def test_interrupted_at_once_there_is_the_initial_row() -> None:
    """Assert that a run that is interrupted before its first step is still a record, of its initial state."""
    march = March(free().model, settings_for(free().model, method="midpoint", step=1e-6, until=3.0))
    march.interrupted = True
    run = record.dataset(march)
    assert (run.attrs["run_outcome"], run.time.values[0]) == ("interrupted", 0.0)
    assert 0 < run.sizes["step"] < 10_000  # of 3,000,000


# models of many elements, of which each step takes as long as many of another
MANY = (
    "balls_in_box",
    "fermi_pasta_ulam",
    "heat",
    "links_pendulum",
    "nagumo_front",
    "outer_solar_system",
    "toda_chain",
    "truss",
)
PLAIN = """
import numpy as np, sys
import xdynamics as xd
np.seterr(all="ignore")
both = [{"step": 0.02}, {"method": "dormand_prince", "rtol": 1e-5}]
for k, (path, until) in enumerate(zip(sys.argv[2::2], sys.argv[3::2])):
    model = xd.Model.from_toml(path)
    for asked in both if sys.argv[1] == "whole" else both[k % 2 :][:1]:
        print(xd.content_digest(xd.simulate(model, **asked, until=float(until))))
"""


def test_compiled_equals_plain_python(request: pytest.FixtureRequest) -> None:
    """Assert that the same code without numba gives the same bits, to the last event and sample.

    Every fifth model, by fixed and adaptive steps by turns; with --whole each takes both, for four times as long. The
    woodpecker has 80 events in 1 s, of all kinds in a period of 0.15 s, and its impacts cost most but for those of ten
    discs, six of which are in 0.2 s.
    """
    whole = request.config.getoption("--whole")
    paths, times, share = sorted(MODELS.glob("*.toml")), 4 if whole else 1, "whole" if whole else "half"
    paths = paths if whole else paths[1::5]
    until = {"woodpecker": 0.15, "granular_box": 0.2, "rough_pile": 0.1, "thermostat": 35.0} | dict.fromkeys(MANY, 0.2)
    untils = [times * until.get(path.stem, 0.55) for path in paths]
    command = [
        sys.executable,
        "-c",
        PLAIN,
        share,
        *(str(one) for pair in zip(paths, untils, strict=True) for one in pair),
    ]
    without = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    plain = subprocess.run(command, env=without, capture_output=True, text=True, check=True).stdout.split()
    compiled = subprocess.run(command, capture_output=True, text=True, check=True)
    assert len(plain) == (2 if whole else 1) * len(paths)
    assert plain == compiled.stdout.split()


def test_progress_is_told() -> None:
    """Assert that a march tells how far it is."""
    told: list[float] = []
    xd.simulate(
        pushed().model,
        method="midpoint",
        step=1e-6,
        until=1.0,
        force_samples="none",
        progress=lambda done, _t, _rows: told.append(done),
    )
    assert told[-1] == 1.0
    assert told == sorted(told)
    assert time.monotonic() > 0


def pushed_by(expression: str, **more: object) -> xr.Dataset:
    """March a resting particle under a force for a second."""
    return xd.simulate(particle(expression, v="0 m s-1", **more), method="midpoint", step=0.125, until=1.0)


def test_choice_inside_a_comparison() -> None:
    """Assert that a choice beside a comparison sign keeps its extent."""
    run = pushed_by("where(where(t < 0.5*second, 1, 2) > 1.5, F, -F)")
    assert run.force_push_x.values[[1, -1]].tolist() == [-5.0, 5.0]


def test_choice_inside_a_full_mass_matrix() -> None:
    """Assert that an entry that is a choice is subtracted from as a whole."""
    entry = "where(t < 100*second, 3*m, 1*m)"
    model = xd.Model(
        name="pair",
        coordinates={"x": "m", "z": "m"},
        parameters={"m": "1 kg", "F": "1 N"},
        forces={"push": {"x": "F", "z": "F"}},
        mass={"matrix": [["2*m", "m"], ["m", entry]]},
        initial={"x": "0 m", "v_x": "0 m s-1", "z": "0 m", "v_z": "0 m s-1"},
    )
    run = xd.simulate(model, method="forward_euler", step=0.5, until=0.5)
    assert [float(run.a_x[0]), float(run.a_z[0])] == pytest.approx([0.4, 0.2], rel=4 * EPS)


def test_power_may_be_the_name_of_a_parameter() -> None:
    """Assert that a model's names do not meet the functions of the generated code."""
    parameters = {"m": "2 kg", "F": "5 N", "power": "8", "positive": "1", "least": "1"}
    run = pushed_by("F*power**(1/3)*min(positive, least)", parameters=parameters)
    assert float(run.force_push_x[0]) == pytest.approx(10.0)


def test_observable_that_is_not_finite_ends_the_run() -> None:
    """Assert that no row holds an observable that is none, and the outcome names it."""
    run = pushed_by("F", observables={"pole": "1*second/(t - 0.5*second)"})
    assert run.attrs["run_outcome"] == "nonfinite_observable"
    assert "pole is inf" in run.attrs["run_outcome_text"]
    assert np.isfinite(run.pole).all()


def test_drive_read_by_an_observable_alone_is_watched() -> None:
    """Assert that a table that ends is told, whoever reads it."""
    table = {"table": "f.csv", "csv": "time [s],f [N]\n0,0\n0.5,1\n"}
    for samples in ("all", "none"):
        model = particle("F", drives={"f": table}, observables={"seen": "f/F"})
        run = xd.simulate(model, method="midpoint", step=0.125, until=1.0, force_samples=samples)
        assert run.attrs["run_outcome"] == "outside_drive_table", samples


def test_events_closer_than_the_spacing_of_time() -> None:
    """Assert that two roots within one spacing of t are two pairs of rows, with rising times."""
    events = {"one": {"function": "x - 0.35*metre"}, "two": {"function": "x - 0.35000000000000003*metre"}}
    start = {"t": "1000 s", "x": "0 m", "v_x": "1 m s-1"}
    run = xd.simulate(particle(events=events, initial=start), method="midpoint", step=0.1, until=1001.0)
    assert run.sizes["event"] == 2
    xd.check(run)


def test_bracket_is_no_wider_than_its_tolerance() -> None:
    """Assert the bracket at roots on grid times, where interpolation falls on an end."""
    for step in (0.125, 1.0, 10.0):
        run = xd.simulate(timed("x - 31*metre"), method="midpoint", step=step, until=20.0)
        low, high = run.event_time_bounds.values[0]
        assert low < 10.0 <= high + 4 * EPS * 10
        assert high - low <= 1e-12 + 8 * EPS * 10, step


def test_step_near_the_spacing_of_time() -> None:
    """Assert that grid times that do not advance end the run."""
    start = {"t": "1048576 s", "x": "0 m", "v_x": "1 m s-1"}
    run = xd.simulate(particle(initial=start), method="midpoint", step=1.4e-10, until=1048576.001)
    assert run.attrs["run_outcome"] == "step_below_spacing"
    xd.check(run)


def test_previous_drive_of_a_coordinate_at_its_last_point() -> None:
    """Assert that the last value of a table is the value at its last point."""
    table = {
        "table": "f.csv",
        "csv": "x [m],f [N]\n0,1\n1,2\n2,5\n",
        "argument": "x",
        "interpolation": "previous",
        "outside": "hold",
    }
    start = {"x": "2 m", "v_x": "0 m s-1"}
    assert float(pushed_by("f", drives={"f": table}, initial=start).force_push_x[0]) == 5.0


def test_forces_are_evaluated_anew_behind_nodes_only() -> None:
    """Assert that samples of stage 0 stand at the start and at the nodes, and that an event before a node adds none."""
    drive = {"table": "f.csv", "csv": TABLE, "interpolation": "linear"}
    events = {"early": {"function": "t - 0.22*second"}}
    run = xd.simulate(particle("pull", drives={"pull": drive}, events=events), method="midpoint", step=0.2, until=1.0)
    assert run.sizes["event"] == 1
    assert run.sample_time.values[run.sample_stage == 0].tolist() == [0.0, 0.25, 0.7]


def fenced(x: float) -> float:
    """A force in Python that is not defined everywhere."""
    if x > 2.0:
        raise ValueError("outside of the fence")
    return 1.0


def test_a_python_force_that_raises_is_heard() -> None:
    """Assert that an exception in a force reaches the caller; it never becomes a force of zero."""
    with pytest.raises(ValueError, match="outside of the fence"):
        xd.simulate(particle(fenced), method="midpoint", step=0.1, until=1.0)


def test_a_stop_at_the_very_end_is_a_stop() -> None:
    """Assert that an event that stops the run on its last grid time is the outcome, not the end that was reached too."""
    run = xd.simulate(timed("t - 1*second", direction="rising", action="stop"), method="midpoint", step=0.25, until=1.0)
    assert run.attrs["run_outcome"] == "stopped_by_event"
    assert run.time.values[-1] == 1.0

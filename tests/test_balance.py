"""The guards of events: offsets and energies in the record, and runs that end where contacts contradict it."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib

import numpy as np
import pytest

import xdynamics as xd
from contacts import ball
from problems import ROOT


def test_a_shift_is_in_the_record() -> None:
    """Assert the offsets of two events at one time, of positions alone, which add up to what the rows say."""
    model = xd.Model(
        name="shifts", coordinates={"x": "m", "y": "m"}, parameters={"m": "1 kg"}, mass={"x": "m", "y": "m"}, forces={},
        initial={"x": "0 m", "v_x": "1 m s-1", "y": "2 m", "v_y": "-0.5 m s-1"},
        events={
            "first": {"function": "t - 0.5*second", "direction": "rising", "action": "reset", "set": {"x": "x + 1e-6*metre", "v_x": "2*v_x"}},
            "second": {"function": "t - 0.5*second", "direction": "rising", "action": "reset", "set": {"y": "-y", "v_y": "-v_y"}},
            "third": {"function": "t - 0.9*second", "action": "record"},
        },
    )  # fmt: skip
    run = xd.simulate(model, method="rk4", step=0.1, until=1.0)
    before, after = run.event_row_before.values, run.event_row_after.values
    assert run.event_offset_x.values == pytest.approx([1e-6, 0.0, 0.0], rel=1e-9)
    assert run.event_offset_y.values == pytest.approx([0.0, -3.5, 0.0], rel=1e-12)
    assert run.event_offset_x.values[0] == run.x.values[after[0]] - run.x.values[before[0]]


def test_a_reset_among_contacts_is_a_shift_too() -> None:
    """Assert the offset of a ball that is lifted while it rests, and nothing where it bounces."""
    statement = {
        "lift": {"function": "t - 2*second", "direction": "rising", "action": "reset", "set": {"y": "0.25*metre"}}
    }
    model = xd.Model(**tomllib.loads(ball(0.5).to_toml()) | {"events": statement})
    run = xd.simulate(model, method="rk4", step=0.01, until=2.1)
    names = np.array(run.event_detector.attrs["flag_meanings"].split())[run.event_detector.values]
    offsets = run.event_offset_y.values
    assert offsets[names == "lift"] == pytest.approx([0.25], rel=1e-12)
    assert np.abs(offsets[names == "floor"]).max() < 1e-14


BROKEN = {
    "an impulse that is too large": (
        "impact",
        "reach",
        "lambda run, k, i: 1.001 * REACH(run, k, i)",
        "work of the recorded",
    ),
    "an impulse that is not recorded": (
        "noting",
        "row",
        "lambda run, k, i: 0.999 * ROW(run, k, i)",
        "work of the recorded",
    ),
    "a contact far away that acts": (
        "gaps",
        "width",
        "lambda run, k: 0.3 if run.now[0].rows > 2 else 1e-9",
        "acts where its gap is",
    ),
    "rest that moves bodies": ("holding", "solve_linear", "lambda a, b, n: SOLVE(a, b, n) and GROW(b, n)", "move"),
    "an energy that is not recorded": ("balance", "SKIPPED", "4", "losses"),
}


@pytest.mark.parametrize("what", BROKEN)
def test_a_march_that_contradicts_itself_ends(what: str) -> None:
    """Assert that each guard stops a run whose code for contacts is broken on purpose, and names the contact and figures."""
    room, name, code, said = BROKEN[what]
    script = f"""
import sys, tomllib
sys.path.insert(0, 'tests')
import xdynamics as xd
from xdynamics.kernels.linear import solve_linear as SOLVE
from xdynamics.march.contacts import {room} as room
from xdynamics.march.contacts.linking import reach as REACH, row as ROW
def GROW(b, n):
    for i in range(n):
        b[i] += 1e-3
    return True
from contacts import ball, cradle
table = tomllib.loads(cradle('sequential', 0.9).to_toml())
table['initial']['x3'] = '0.3 m'
model = ball(0.4, 0.01) if {room!r} in ('holding', 'balance') else xd.Model(**table)
xd.simulate(model, method='rk4', step=0.01, until=0.001)
room.{name} = {code}
run = xd.simulate(model, method='rk4', step=0.01, until=1.5)
print(run.attrs['run_outcome'], run.attrs['run_outcome_text'])
"""
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    found = subprocess.run([sys.executable, "-W", "ignore", "-c", script], cwd=ROOT, env=environment, capture_output=True, text=True, check=True)  # fmt: skip
    assert found.stdout.startswith("contact_inconsistent at t = "), found.stdout
    assert said in found.stdout


def test_a_cradle_swings_on_for_a_minute() -> None:
    """Assert twenty times the run that the model asks for: what rounding leaves of a gap is no penetration."""
    model = xd.Model.from_toml(ROOT / "data" / "models" / "newtons_cradle_sequential.toml")
    run = xd.simulate(model, until=60.0)
    assert run.attrs["run_outcome"] == "completed"
    assert np.abs(run.total_energy.values / float(run.total_energy[0]) - 1.0).max() < 1e-9
    assert min(float(run[f"contact_gap_{name}"].min()) for name in model.contacts) > -1e-12


@pytest.mark.parametrize("name", ["newtons_cradle_newton_dop853", "bouncing_ball_verlet", "rocking_block_dop853"])
def test_contacts_of_version_0_2_are_extended(name: str) -> None:
    """Assert that an archive whose memory lacks what was added since goes on."""
    path = ROOT / "data" / "golden" / "0.2" / f"{name}.nc"
    end = float(xd.open_run(path).attrs["solver_until"])
    longer = xd.extend(path, until=1.5 * end)
    assert longer.attrs["run_outcome"] == "completed"
    assert float(longer.time[-1]) == 1.5 * end

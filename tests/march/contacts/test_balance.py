"""The guards of events: offsets and energies in the record, and runs that end where contacts contradict it."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.contacts import ball
from cases.problems import ROOT
from xdynamics.march import run as places
from xdynamics.march.contacts import balance
from xdynamics.march.contacts.delassus import SUM_NOISE
from xdynamics.march.outcomes import CONTACT_INCONSISTENT
from xdynamics.model.detectors import GAP
from xdynamics.model.reactions import NORMAL


def test_a_shift_is_in_the_record() -> None:
    """Assert the offsets of two events at one time, of positions alone, which add up to what the rows say."""
    model = xd.Model(
        name="shifts",
        coordinates={"x": "m", "y": "m"},
        parameters={"m": "1 kg"},
        mass={"x": "m", "y": "m"},
        forces={},
        initial={"x": "0 m", "v_x": "1 m s-1", "y": "2 m", "v_y": "-0.5 m s-1"},
        events={
            "first": {
                "function": "t - 0.5*second",
                "direction": "rising",
                "action": "reset",
                "set": {"x": "x + 1e-6*metre", "v_x": "2*v_x"},
            },
            "second": {
                "function": "t - 0.5*second",
                "direction": "rising",
                "action": "reset",
                "set": {"y": "-y", "v_y": "-v_y"},
            },
            "third": {"function": "t - 0.9*second", "action": "record"},
        },
    )
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
        "strike_in_turn",
        "lambda run: STRIKE(run) and SCALED(run.responses, 1.001)",
        "work of the recorded",
    ),
    "an impulse that is not recorded": (
        "phases",
        "event_row_of",
        "lambda run, k, first: SCALED(run.directions, 0.999) and ROW_OF(run, k, first)",
        "work of the recorded",
    ),
    "a contact far away that acts": (
        "delassus",
        "gap_width",
        "lambda run, k: 0.3 if run.now[0].rows > 2 else 1e-9",
        "acts where its gap is",
    ),
    "rest that moves bodies": ("delassus", "solve_linear", "lambda a, b, n: SOLVE(a, b, n) and GROW(b, n)", "move"),
    "an energy that is not recorded": ("balance", "SKIPPED", "4", "losses"),
}


@pytest.mark.dear
@pytest.mark.every(7)
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
from xdynamics.march.contacts.phases import event_row_of as ROW_OF
from xdynamics.march.contacts.impact import strike_in_turn as STRIKE
def SCALED(a, factor):
    a *= factor
    return True
def GROW(b, n):
    for i in range(n):
        b[i] += 1e-3
    return True
from cases.contacts import ball, cradle
table = tomllib.loads(cradle('sequential', 0.9).to_toml())
table['initial']['x3'] = '0.3 m'
model = ball(0.4, 0.01) if {name!r} in ('solve_linear', 'SKIPPED') else xd.Model(**table)
xd.simulate(model, method='rk4', step=0.01, until=0.001)
room.{name} = {code}
run = xd.simulate(model, method='rk4', step=0.01, until=1.5)
print(run.attrs['run_outcome'], run.attrs['run_outcome_text'])
"""
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    found = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", script],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert found.stdout.startswith("contact_inconsistent at t = "), found.stdout
    assert said in found.stdout


def test_a_cradle_swings_on_for_a_minute() -> None:
    """Assert twenty times the run that the model asks for: what rounding leaves of a gap is no penetration."""
    model = xd.Model.from_toml(ROOT / "data" / "models" / "newtons_cradle_sequential.toml")
    run = xd.simulate(model, until=60.0)
    assert run.attrs["run_outcome"] == "completed"
    assert np.abs(run.total_energy.values / float(run.total_energy[0]) - 1.0).max() < 1e-9
    assert min(float(run[f"contact_gap_{name}"].min()) for name in model.elements.contacts) > -1e-12


@pytest.mark.every(9)
@pytest.mark.parametrize("name", ["newtons_cradle_newton_dop853", "bouncing_ball_verlet", "rocking_block_dop853"])
def test_contacts_of_version_0_2_are_extended(name: str) -> None:
    """Assert that an archive whose memory lacks what was added since goes on."""
    path = ROOT / "data" / "golden" / "0.2" / f"{name}.nc"
    end = float(xd.open_run(path).attrs["solver_until"])
    longer = xd.extend(path, until=1.5 * end)
    assert longer.attrs["run_outcome"] == "completed"
    assert float(longer.time[-1]) == 1.5 * end


# ------------------------------------------------------------------------------------------------------------ the parts


@pytest.fixture
def group(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Two coordinates and two contacts by hand; the first is a normal force, and what is read of each stands in lists."""
    about: dict[str, Any] = {
        "location_time": [0.5, 0.1],
        "impact_spread": [1e-6, 1.0],
        "size_of_gap": [1e9, 1.0],
        "brake": [2.0, 0.0],
        "chosen": {True: [0], False: [0, 1]},
    }

    def choose(run: Any, settling: bool) -> int:
        run.chosen[: len(about["chosen"][settling])] = about["chosen"][settling]
        return len(about["chosen"][settling])

    for name in ("location_time", "impact_spread", "size_of_gap", "brake"):
        monkeypatch.setattr(balance, name, lambda _, k, name=name: about[name][k])
    monkeypatch.setattr(balance, "list_holding", choose)
    monkeypatch.setattr(balance, "note_broken_guard", plain("note_broken_guard"))
    monkeypatch.setattr(balance, "gap_reach", plain("gap_reach"))
    touches = np.array([SimpleNamespace(total=0.0, lost=0.0, slack=0.0, hit=-1) for _ in "ab"])
    run = SimpleNamespace(
        plan=[SimpleNamespace(coordinates=2, kinetic=0, held=0)],
        touches=touches,
        reactions=[SimpleNamespace(role=NORMAL), SimpleNamespace(role=NORMAL + 1)],
        entry=np.zeros(4),
        z=np.array([1.0, 2.0, 3.0, 4.0, 5.0]),
        pulled=np.ones(2),
        slowed=np.ones(2),
        approach=np.zeros(2),
        chosen=np.zeros(2, int),
        balance=np.full(places.BALANCE, 7.0),
        now=[SimpleNamespace(events=4, status=0, h=0.0)],
        base=[SimpleNamespace(events=1)],
        trial=[SimpleNamespace(h=0.125)],
        log_impulses=np.zeros((3, 4)),
        about=about,
        links=np.array([(0.0, 0.5, -8.0, 0.0, 0.0), (9.0, -0.25, 3.0, 0.0, 0.0)], places.LINK),
        delassus=np.array([[4.0, 1.0], [1.0, 0.5]]),
        responses=np.array([[2.0, -1.0], [0.5, 3.0]]),
        directions=np.array([[1.0, -1.0], [0.0, 2.0]]),
    )
    plain("open_balance")(run)
    return run


def plain(name: str) -> Any:
    """Return a guard as Python has it."""
    function = getattr(balance, name)
    return getattr(function, "py_func", function)


def broken(run: Any) -> tuple[float, ...]:
    """Return guard, owner, figure and bound."""
    return tuple(float(run.balance[one]) for one in (places.GUARD, places.OWNER, places.FIGURE, places.BOUND))


def test_parts_a_group_begins_with_nothing_taken(group: Any) -> None:
    """Assert the state and rates that are kept, sums of 0, and the first guard that breaks: beyond its bound or no number."""
    assert group.entry.tolist() == [1.0, 2.0, 3.0, 4.0]
    assert (group.approach.tolist(), group.pulled.tolist(), group.slowed.tolist()) == (
        [0.5, -0.25],
        [0.0, 0.0],
        [0.0, 0.0],
    )
    assert group.balance[places.GUARD] == places.KEPT_ALL
    assert (group.balance[places.TAKEN :] == 0.0).all()
    examine = plain("note_broken_guard")
    examine(group, places.WORK, 1, 2.0, 2.0)
    assert not plain("is_broken")(group)
    assert group.now[0].status == 0
    examine(group, places.WORK, 1, 2.5, 2.0)
    examine(group, places.LOSSES, 0, 9.0, 2.0)
    assert broken(group) == (places.WORK, 1.0, 2.5, 2.0)
    assert plain("is_broken")(group)
    assert (group.now[0].status, group.now[0].h) == (CONTACT_INCONSISTENT, 0.125)
    plain("open_balance")(group)
    examine(group, places.LOSSES, 0, np.nan, 2.0)
    assert group.balance[places.GUARD] == places.LOSSES


def test_parts_impulses_take_their_mean_rate(group: Any) -> None:
    """Assert the energy that impulses took, its terms, and gaps of what acted: twice its spread and the way of its bracket."""
    group.approach[:] = -1.0, 3.0
    group.touches[0].total = 4.0
    far = 1e9 * SUM_NOISE + 8.0 * 0.25
    group.links["gap"][0] = -2.0 * far
    plain("weigh_contact_impulses")(group)
    assert group.balance[places.TAKEN] == -4.0 * (-1.0 + 0.5) / 2.0
    assert group.balance[places.TERMS] == 4.0 * (1.0 + 0.5)
    assert group.balance[places.GUARD] == places.KEPT_ALL
    group.links["gap"][0] = -2.001 * far
    plain("weigh_contact_impulses")(group)
    assert broken(group) == (places.APART, 0.0, pytest.approx(2.001 * far), pytest.approx(2.0 * far))
    plain("open_balance")(group)
    group.touches[0].total, group.touches[1].total = 0.0, -2.0
    group.approach[1] = 3.0
    plain("weigh_contact_impulses")(group)
    assert group.balance[places.GUARD] == places.KEPT_ALL  # friction has no gap
    assert (group.balance[places.TAKEN], group.balance[places.TERMS]) == (2.0 * (3.0 - 0.25) / 2.0, 2.0 * 3.25)


@pytest.mark.parametrize(
    ("more", "slow"),
    [
        ({}, 0.0),
        ({"slack": 0.75}, 0.75),
        ({"lost": 2.0}, 4.0),
        ({"hit": GAP}, 1.0),
        ({"hit": GAP, "total": 1.0}, 0.0),
        ({"slack": 0.5, "lost": 0.5, "hit": GAP}, 0.5 + 2.0 + 1.0),
    ],
)
def test_parts_rates_are_taken_from_what_rests(group: Any, more: dict[str, float], slow: float) -> None:
    """Assert four times what acceleration and brake do in the bracket, with slack, skipped bounces and a step's own."""
    vars(group.touches[0]).update(more)
    bound = 4.0 * ((8.0 + 2.0) * 0.5 + slow)
    for part, kept in ((0.999, True), (-0.999, True), (-1.001, False)):
        plain("open_balance")(group)
        group.slowed[0] = part * bound
        plain("weigh_rates")(group)
        assert bool(group.balance[places.GUARD] == places.KEPT_ALL) is kept
        if not kept:
            assert broken(group) == (places.SLOWED, 0.0, pytest.approx(1.001 * bound), pytest.approx(bound))


@pytest.mark.parametrize(("settling", "most"), [(True, [0.5, 0.25]), (False, [0.5 + 1.0, 0.25 + 6.0])])
def test_parts_rest_moves_no_farther_than_gaps_were_open(group: Any, settling: bool, most: list[float]) -> None:
    """Assert twice the reach of each coordinate over the contacts' own, times the gap, for a chain of as many.

    A gap is as far from zero as rounding leaves it, and as its free acceleration of 8 leads in the bracket of 0.5.
    """
    count, farthest = (1 if settling else 2), 1e9 * SUM_NOISE + 8.0 * 0.5**2
    for i in range(2):
        bound = 2.0 * most[i] * farthest * (1.0 + count**2 / 4.0)
        for part, kept in ((0.999, True), (-0.999, True), (1.001, False)):
            plain("open_balance")(group)
            group.entry[i] -= part * bound
            plain("weigh_positions")(group, settling)
            assert bool(group.balance[places.GUARD] == places.KEPT_ALL) is kept
            if not kept:
                assert broken(group) == (places.SHIFTED, i, pytest.approx(1.001 * bound), pytest.approx(bound))


@pytest.mark.parametrize(("pulled", "skipped"), [(0.0, 0.0), (1.5, 0.25)])
def test_parts_energies_are_those_of_the_impulses(group: Any, pulled: float, skipped: float) -> None:
    """Assert kinetic energies of 2 kg and 0.5 kg on both sides of three impulses, and losses, give or take their rounding."""
    masses, before = np.array([2.0, 0.5]), np.array([3.0, -4.0])
    group.log_impulses[:2] = [[9.0, -1.0, 2.5, 9.0], [9.0, 0.5, -1.0, 9.0]]  # of the rows 1 and 2 of this group alone
    group.pulled[:] = pulled, -0.5 * pulled
    impulses = np.array([1.5 + pulled, -0.5 - pulled - pulled])
    behind = before + impulses / masses
    group.entry[2:], group.z[2:4] = before, behind
    energies = [float(masses @ one**2) / 2.0 for one in (before, behind)]
    taken = 0.75
    terms = sum(energies) + float(np.abs(impulses) @ (np.abs(before) + np.abs(behind)))
    bound = 16.0 * SUM_NOISE * 4 * (terms + 2.0)

    def weighed(energy: float, loss: float) -> tuple[float, ...]:
        plain("open_balance")(group)
        group.entry[2:], group.pulled[:] = before, [pulled, -0.5 * pulled]
        group.log_impulses[2] = [9.0, 0.25, loss - 0.25, 9.0]
        for place, value in (
            (places.BEFORE, energies[0]),
            (places.BEHIND, energies[1] + energy),
            (places.TAKEN, taken),
            (places.SKIPPED, skipped),
            (places.TERMS, 2.0),
        ):
            group.balance[place] = value
        plain("weigh_energies")(group, 1)
        return broken(group)

    for part in (0.9, -0.9):
        assert weighed(part * bound, taken + skipped + part * bound)[0] == places.KEPT_ALL
    assert weighed(1.2 * bound, taken + skipped) == (
        places.WORK,
        0,
        pytest.approx(1.2 * bound, rel=0.1),
        pytest.approx(bound, rel=1e-6),
    )
    assert weighed(0.0, taken + skipped - 1.2 * bound)[0] == places.LOSSES
    group.plan[0].kinetic = -1
    assert weighed(1.2 * bound, taken + skipped)[0] == places.KEPT_ALL

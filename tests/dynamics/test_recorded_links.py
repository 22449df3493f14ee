"""Closed links of heaps with friction, which a record lists: its steps go on from there, not from states alone."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.dynamics.shortened_steps import StepInterpolator
from xdynamics.methods.scheme import REINTEGRATE
from xdynamics.schema import EVENT_AFTER

TIMES = np.linspace(0.2, 0.2249, 50)
STATES = ("x", "y", "theta", "v_x", "v_y", "v_theta")
ROUNDING = 1e-12  # of numbers up to ten


@lru_cache
def pile(log: str = "full", until: str = "0.225 s") -> xr.Dataset:
    """March discs until slips of several of them have begun and ended."""
    return xd.simulate(xd.Model.from_toml(MODELS / "rough_pile.toml"), until=until, log=log)


def defects(run: xr.Dataset) -> float:
    """Return how far any step, made again, is from the row it led to."""
    rows = np.flatnonzero(np.diff(run.time.values) > 0.0)
    found = StepInterpolator.of_run(run, None, REINTEGRATE).defects(rows, 1)
    return max(float(np.abs(found[name]).max()) for name in STATES)


def lasting(run: xr.Dataset) -> np.ndarray:
    """Return which closed links are of rows that no slip follows at once."""
    return np.isin(run.closed_step.values, np.flatnonzero(np.diff(run.time.values) > 1e-4))


def test_steps_after_slips_and_releases_lead_to_their_next_rows() -> None:
    """Assert it to rounding; and that one link that holds instead of slipping, or is not there, is seen."""
    run = pile()
    assert defects(run) < ROUNDING
    assert defects(run.drop_vars("closed_friction_state")) > 1e-3  # found from states
    slips = np.flatnonzero(lasting(run) & (run.closed_friction_state.values > 1) & (run.closed_force.values > 0.1))
    other = run.copy(deep=True)
    other.closed_friction_state.values[slips[-1]] = 1
    assert defects(other) > 1e3 * ROUNDING
    assert defects(run.isel(closed=np.delete(np.arange(run.sizes["closed"]), slips[-1]))) > 1e3 * ROUNDING


def test_steps_after_several_landings_at_one_time_lead_to_their_next_rows() -> None:
    """Assert it where rows after events are more than events name."""
    run = pile(until="0.3 s")
    own, named = np.flatnonzero(run.row_kind.values == EVENT_AFTER), run.event_row_after.values
    assert not np.isin(own, named).all()
    assert defects(run) < ROUNDING


def test_what_links_do_fits_their_forces() -> None:
    """Assert Coulomb's law: all friction against slips, and no more where links stick."""
    run = pile()
    words = run.closed_friction_state.attrs["flag_meanings"].split()
    assert words == ["frictionless", "sticking", "slipping_forward", "slipping_backward"]
    pressing, rubbing, does = (run[f"closed_{name}"].values for name in ("force", "friction_force", "friction_state"))
    for number, sign in ((2, -1.0), (3, 1.0)):
        own = does == number
        assert own.any()
        assert rubbing[own] == pytest.approx(sign * 0.4 * pressing[own], rel=1e-12, abs=0)
    sticks = lasting(run) & (does == 1)
    assert (np.abs(rubbing[sticks]) <= 0.4 * pressing[sticks] * (1 + 1e-9)).all()
    assert (does > 0).all()


def test_logs_of_states_and_stored_chunks_give_the_same_states(tmp_path: Path) -> None:
    """Assert the same bits from records that hold less, or elsewhere."""
    run, states = pile(), pile("states")
    expected = xd.sample(run, TIMES)
    assert {"closed_friction_state", "closed_pair"} <= {*states.variables}
    assert "closed_force" not in states
    found = xd.sample(states, TIMES)
    for name in STATES:
        assert found[name].values.tobytes() == expected[name].values.tobytes()
    assert xd.sample(run.chunk({"step": 50, "closed": 300, "event": 40}), TIMES).compute().equals(expected)
    xd.save(run, tmp_path / "pile.nc")
    with xd.open_run(tmp_path / "pile.nc") as stored:
        assert xd.sample(stored, TIMES).equals(expected)


@pytest.mark.parametrize("rows", [slice(100, None), slice(None, -1), slice(60, -2)])
def test_parts_of_a_record_have_their_own_links(rows: slice) -> None:
    """Assert that rows that were cut off, by which others are numbered anew, do not give a step the links of another row."""
    run = pile()
    part = run.isel(step=rows)
    times = TIMES[float(part.time[-1]) > TIMES]
    assert xd.sample(part, times).v_theta.values.tobytes() == xd.sample(run, times).v_theta.values.tobytes()


@pytest.mark.parametrize(
    ("name", "number", "message"),
    [
        ("closed_pair", 10**6, "'closed_pair' is 1000000 at place .*there are 0 to 275"),
        ("closed_friction_state", 9, "'closed_friction_state' is 9 at .*there are 0 to 3"),
        ("closed_friction_state", -1, "'closed_friction_state' is -1 at .*there are 0 to 3"),
        ("closed_step", -1, "'closed_step' is -1 after [0-9]+ at .*rows ascend"),
        ("closed_step", 10**9, "'closed_step' is [0-9]+ after 1000000000 at .*rows ascend"),
        ("closed_disc", 24, "'closed_disc' is 24 at .*there are 0 to 23"),
        ("closed_contact", 100, "'closed_contact' is 100 at .*there are 0 to "),
    ],
)
def test_links_that_cannot_be_are_refused(name: str, number: int, message: str) -> None:
    """Assert that closed links out of order, or of no contact's number, do not get into compiled code."""
    other = pile().copy(deep=True)
    other[name].values[np.flatnonzero(other[name].values >= 0)[-2]] = number
    with pytest.raises(xd.InputError, match=message):
        xd.sample(other, TIMES)


def test_a_link_listed_twice_is_refused() -> None:
    """Assert that one row has each link once."""
    twice = pile().isel(closed=np.repeat(np.arange(pile().sizes["closed"]), 2))
    with pytest.raises(xd.InputError, match="links of a row ascend, each once"):
        xd.sample(twice, TIMES)


def test_links_in_another_order_are_refused_until_they_are_dropped() -> None:
    """Assert that rows out of order are not searched as if they were in order, and that the remedy works."""
    other = pile().isel(closed=slice(None, None, -1))
    with pytest.raises(xd.InputError, match="rows ascend: the record was edited; .*drop its closed_"):
        xd.sample(other, TIMES)
    free = [name for name in other.variables if str(name).startswith("closed_")]
    assert np.isfinite(xd.sample(other.drop_vars(free), TIMES).v_theta.values).all()

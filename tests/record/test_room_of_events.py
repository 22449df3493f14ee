"""Rows of events, and of steps that are chosen, come to more than there is memory for."""

import re
import signal

import numpy as np
import pytest

import xdynamics as xd
from xdynamics.documenting.guide import guide
from xdynamics.record.run_dataset import GatheredColumn

SITES = 600


def passing(action="record", **run):
    """Return bodies that move uniformly, each of which passes 0 at a time of its own."""
    return xd.Model(
        name="passing",
        dimensions={"site": SITES},
        coordinates={"u": {"unit": "m", "dims": ["site"]}},
        mass={"u": "1*kilogram"},
        forces={"push": {"u": "0*newton*u/(1*metre)"}},
        initial={"u": "-1*metre*(1 + index(site))/size(site)", "v_u": "1*metre/second*(1 + 0*index(site))"},
        events={"cross": {"function": "u", "direction": "rising", "action": action}},
        run={"method": "rk4", "step": "0.1 s", "until": "1.5 s", "log": "states"} | run,
    )


@pytest.mark.parametrize(("log", "size"), [("states", "6 MB"), ("full", "8 MB")])
def test_a_march_of_too_many_events_ends_before_it_takes_more_than_is_allowed(log, size):
    """Assert that one error says time, rows, those of events, their size and what to do, long before the end."""
    with pytest.raises(xd.InputError, match=r"^the run of 'passing' is at t = 0\.\d+ s with") as caught:
        xd.simulate(passing(log=log), memory=size)
    said = str(caught.value)
    rows, of_events = map(int, re.search(r"with (\d+) rows, (\d+) of them of events", said).groups())
    assert of_events < rows < of_events + 16
    assert f"{size} were allowed" in said
    assert "max(…, dimension)" in said
    assert rows < 1.5 * SITES  # of some 1,220


def test_a_march_of_too_many_chosen_steps_says_so_without_events():
    """Assert that rows of chosen steps are judged as they come, too."""
    model = passing().replace(events={})
    asked = {"method": "dop853", "rtol": 1e-6, "step": None, "max_step": "1 us", "until": "20 ms"}
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(xd.InputError, match=r"larger tolerances or an earlier end$") as caught:
        xd.simulate(model, memory="5 MB", **asked)
    assert "of events" not in str(caught.value)
    assert signal.getsignal(signal.SIGINT) is before  # while the error, and so the march, is still kept


def test_memory_that_is_left_is_asked_for_while_rows_come(monkeypatch):
    """Assert that the memory of the machine is looked at as rows of events come."""
    monkeypatch.setattr("xdynamics.record.run_dataset.free_memory", lambda: 1.5e6)
    with pytest.raises(xd.InputError, match="1.2 MB more can be had"):
        xd.simulate(passing(step="0.5 s"))


def test_room_grows_by_a_quarter_and_zeros_of_events_have_none():
    """Assert that rows beyond those foreseen add a quarter at a time, and shifts that no event makes add nothing."""
    part = GatheredColumn(8)
    for _ in range(9):
        part.add(np.ones((1, 10)), is_lent=True)
    assert len(part.room) == 10
    assert (part.growth(1), part.growth(2)) == (0, 2 * 80)
    none = GatheredColumn(None)
    for _ in range(3):
        none.add(np.broadcast_to(0.0, (5, 10)), is_lent=True)
    assert none.bytes_held == none.growth(1) == 0
    assert none.joined_rows().shape == (15, 10)
    assert none.joined_rows().flags.writeable


def test_help_says_what_events_of_every_element_cost():
    """Assert that the page of shapes says it, and that of the record leads to it."""
    assert "`2*n*n` numbers" in " ".join(" ".join(guide("shapes")).split())
    assert "xdynamics help shapes" in " ".join(guide("record"))

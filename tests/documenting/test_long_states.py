"""The summary of a run with many numbers shows some of them, and says how many more there are."""

from __future__ import annotations

from functools import lru_cache

import pytest
import xarray as xr

import xdynamics as xd
from xdynamics.documenting.summary import summary
from xdynamics.record import unfolding

BALLS = """
name = "balls"
[dimensions]
ball = {balls}
axis = ["across", "up"]
[relations.pair]
of = "ball"
neighbours = 1
[coordinates]
r = {{ unit = "m", dims = ["ball", "axis"] }}
[mass]
r = "1*kilogram"
[events.floor]
function = "r[2, up]"
[events.balls]
function = "norm(second(r, pair) - first(r, pair), axis) - 2*metre"
[initial]
r = "3*metre*(index(ball) + 1)*(1 - index(axis)) + 1*metre*index(axis)"
v_r = "where(index(ball) < 1, 1, 0)*(1 - index(axis))*metre/second - where(index(ball) > 1, 1, 0)*index(axis)*metre/second"
[run]
method = "velocity_verlet"
step = "250 ms"
until = "1.5 s"
"""


@lru_cache
def run(balls: int) -> xr.Dataset:
    """Return a run in which ball 0 comes near ball 1, and ball 2 and those beyond fall."""
    return xd.simulate(xd.Model.from_text(BALLS.format(balls=balls)))


def line_of(lines: list[str], begin: str) -> str:
    """Return the line that begins so."""
    return next(line for line in lines if line.startswith(begin))


def test_an_event_shows_what_met() -> None:
    """Assert that of 20 numbers an event shows those of its two balls, and the end twelve of them."""
    lines = summary(run(5))
    met = line_of(lines, "event     balls")
    assert [name in met for name in ("r[0, across]", "v_r[1, up]", "r[2,", "r[4,")] == [True, True, False, False]
    assert met.endswith(", and 12 numbers more in the record")
    end = line_of(lines, "end")
    assert end.count("[") == 12
    assert end.endswith(", and 8 numbers more in the record")


@pytest.mark.parametrize(("balls", "numbers"), [(3, 12), (4, 12)])
def test_a_short_state_is_whole(balls: int, numbers: int) -> None:
    """Assert that twelve numbers are all shown, and of an event that names no element the first twelve."""
    floor = line_of(summary(run(balls)), "event     floor")
    assert floor.count("[") == numbers
    assert (" more in the record" in floor) == (balls > 3)


CHAIN = """
name = "chain"
[dimensions]
site = 40
axis = ["x", "y"]
[coordinates]
w = { unit = "m" }
u = { unit = "m", dims = ["site", "axis"] }
[mass]
w = "kilogram"
u = "kilogram"
[forces.springs]
w = "-kilogram/second**2*w"
u = "-kilogram/second**2*u"
[initial]
w = "2 m"
u = "metre*index(site)"
[run]
method = "velocity_verlet"
step = "0.1 s"
until = "0.5 s"
"""


def test_numbers_that_are_not_shown_are_not_parted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a run of very many numbers has the lines of any other, of as many variables as are shown."""
    chain, parted = xd.simulate(xd.Model.from_text(CHAIN)), list[int]()
    usual = summary(chain)
    unfold = unfolding.unfold

    def counted(run: xr.Dataset) -> xr.Dataset:
        unfolded = unfold(run)
        parted.append(len(unfolded.variables))
        return unfolded

    monkeypatch.setattr(unfolding, "unfold", counted)
    monkeypatch.setattr("xdynamics.documenting.summary.MOST_PARTED", 100)
    assert summary(chain) == usual
    assert line_of(usual, "end").endswith(", and 150 numbers more in the record")
    assert len(unfold(chain).variables) > 300
    assert [number < 150 for number in parted] == [True]


def test_columns_that_no_line_shows_are_not_parted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that of forces and accelerations of elements no variables are made for a description."""
    chain, names = xd.simulate(xd.Model.from_text(CHAIN)), set[str]()
    unfold = unfolding.unfold

    def noted(run: xr.Dataset) -> xr.Dataset:
        unfolded = unfold(run)
        names.update(map(str, unfolded.variables))
        return unfolded

    monkeypatch.setattr(unfolding, "unfold", noted)
    summary(chain)
    assert {"u·39·y", "v_u·39·y", "a_w"} <= names
    assert not any(name.startswith(("a_u", "force_springs_u")) for name in names)

"""The summary of a run with many numbers shows some of them, and says how many more there are."""

from __future__ import annotations

from functools import lru_cache

import pytest
import xarray as xr

import xdynamics as xd
from xdynamics.documenting.summary import summary

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

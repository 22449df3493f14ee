"""Panels that a picture leaves out, since they would show rounding alone."""

from __future__ import annotations

from typing import Any

import pytest

import xdynamics as xd

CRADLE = """
name = "Newton's cradle"
[dimensions]
ball = 5
[relations.pair]
of = "ball"
neighbours = 1
[coordinates]
x = { unit = "m", dims = ["ball"] }
[parameters]
d = "0.1 m"
k = "10 N m-1"
push = "PUSH N"
[mass]
x = "1*kilogram"
[forces.strings]
x = "-k*(x - d*index(ball)) - push*(index(ball) - 2)"
[contacts.balls]
gap = "second(x, pair) - first(x, pair) - d"
restitution = 1.0
law = "sequential"
[initial]
x = "d*index(ball) - where(index(ball) < 1/2, 0.1, 0)*metre"
[run]
method = "dop853"
rtol = 1e-9
until = "1.2 s"
"""


def titles(run: Any, **settings: Any) -> list[str]:
    """Titles of the panels of a picture."""
    return [axes.get_title(loc="left") for axes in xd.plot(run, **settings).axes]


@pytest.mark.parametrize(("push", "drawn"), [("0", False), ("1e-12", True)])
def test_forces_that_are_rounding_alone_have_no_panel(push: str, drawn: bool) -> None:
    """Assert no panel of 1e-16 N between balls that hang side by side, but where asked for, with a word; one of a true 1e-12 N."""
    run = xd.simulate(xd.Model.from_text(CRADLE.replace("PUSH", push)))
    size = float(abs(run.contact_force_balls).max())
    assert 0.0 < size < 1e-11
    assert ("contact and friction" in titles(run)) == drawn
    asked = "contact and friction" if drawn else "contact and friction: no more than rounding"
    assert titles(run, only="contact")[0] == asked

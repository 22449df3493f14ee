"""Maps of many variables: rows of neighbours, and colours of the bodies that stay."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from xdynamics.figures import curves
from xdynamics.figures.element_maps import colours

ROW = """
name = "row"
[dimensions]
site = 1300
[coordinates]
u = { unit = "m", dims = ["site"] }
[mass]
u = "1*kilogram"
[forces.springs]
u = "-(u - metre)*newton/metre"
[initial]
u = "metre*(LEVEL + where(abs(index(site) - 700) < 1/2, AMOUNT, 0))"
[run]
method = "rk4"
step = "50 ms"
until = "3 s"
"""


def title_of(axes: Any) -> str:
    """A title on one line."""
    return " ".join(axes.get_title(loc="left").split())


@pytest.mark.parametrize(
    ("level", "amount", "said"),
    [("1", "-0.5", "1"), ("1", "0.5", "1"), ("3", "-9", "0")],
)
def test_a_map_of_more_rows_than_pixels_shows_what_is_narrow(level: str, amount: str, said: str) -> None:
    """Assert that of 1,300 rows in 500 a single one is seen that is none of the firsts, above all others or below, and that it is said."""
    run = xd.simulate(xd.Model.from_text(ROW.replace("LEVEL", level).replace("AMOUNT", amount)), log="states")
    (axes,) = xd.plot(run, only="trajectory").axes
    drawn = np.asarray(axes.collections[0].get_array())
    assert drawn.shape[0] == 500
    group = next(k for k, part in enumerate(np.array_split(np.arange(1300), 500)) if 700 in part)
    assert np.array_split(np.arange(1300), 500)[group][0] != 700
    assert drawn[group, 0] == run["u"].values[0, 700]
    assert drawn[0, 0] == run["u"].values[0, 0]
    words = f"1300 drawn as 500 rows: of up to 3 neighbours the value farthest from {said}"
    assert title_of(axes) == f"trajectory, {words}"


def test_rows_of_a_map_are_made_once_each(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that values inside steps are computed once for each of 700 elements, and asked for no more than twice."""
    text = ROW.replace("1300", "700").replace("LEVEL", "2").replace("AMOUNT", "1")
    run = xd.simulate(xd.Model.from_text(text), log="states")
    asked = list[str]()
    made = curves.StatePolynomials._evaluate
    monkeypatch.setattr(
        curves.StatePolynomials, "_evaluate", lambda self, names: (asked.extend(names), made(self, names))[1]
    )
    xd.plot(run, only="trajectory")
    assert len({*asked}) == len(asked) == 700


SWARM = """
name = "swarm"
[dimensions]
body = 9
axis = ["x", "y"]
[coordinates]
r = { unit = "m", dims = ["body", "axis"] }
[parameters]
k = "1 N m-1"
[mass]
r = "1*kilogram"
[forces.springs]
r = "-where(abs(index(body) - FREE) < 1/2, 0, k*r)"
[initial]
r = "metre*(index(body) + 1)/9"
v_r = "metre/second*where(abs(index(body) - FREE) < 1/2, 50, 1)"
[run]
method = "rk4"
step = "50 ms"
until = "5 s"
"""


def test_a_body_that_flies_off_does_not_set_the_colours() -> None:
    """Assert the scale of those that stay, points at the ends of its bar, and the body with its time; else neither."""
    run = xd.simulate(xd.Model.from_text(SWARM.replace("FREE", "4")))
    axes = xd.plot(run, only="trajectory").axes[0]
    mesh = axes.collections[0]
    stay = np.abs(np.delete(run.r.values[..., 0], 4, axis=1)).max()
    assert stay <= mesh.get_clim()[1] < 1.3 * stay
    assert title_of(axes).startswith(
        "trajectory r[x], 9 rows, one per body; body 4 leaves the scale of colours at t = 0.0"
    )
    assert mesh.colorbar.extend == "both"
    calm = xd.simulate(xd.Model.from_text(SWARM.replace("FREE", "99")))
    axes = xd.plot(calm, only="trajectory").axes[0]
    mesh = axes.collections[0]
    assert (title_of(axes), mesh.colorbar.extend) == ("trajectory r[x], 9 rows, one per body", "neither")
    assert mesh.get_clim()[1] >= np.abs(calm.r.values[..., 0]).max()


def test_colours_of_values_that_are_missing() -> None:
    """Assert scales of what is there, of one sign and of both."""
    assert colours(np.array([np.nan, 1.0, 3.0])) == {"cmap": "viridis", "vmin": 1.0, "vmax": 3.0}
    assert colours(np.array([np.nan, -4.0, 3.0])) == {"cmap": "RdBu_r", "vmin": -4.0, "vmax": 4.0}


@pytest.mark.parametrize(("unit", "size"), [("m", 1.0), ("km", 1e3)])
def test_velocities_of_states_alone_bend(unit: str, size: float) -> None:
    """Assert that velocities between rows follow the closed form where no accelerations are recorded, and that no chord is told."""
    text = ROW.replace("1300", "200").replace("LEVEL", "2").replace("AMOUNT", "0").replace("50 ms", "200 ms")
    run = xd.simulate(xd.Model.from_text(text.replace('unit = "m"', f'unit = "{unit}"')), log="states")
    (axes,) = xd.plot(run, only="velocity").axes
    assert title_of(axes) == "velocity, 200 rows, one per site"
    drawn = size * np.asarray(axes.collections[0].get_array())
    assert drawn.shape == (200, 64)
    wanted = -np.sin(np.linspace(0.0, 3.0, 64))
    assert np.abs(drawn - wanted).max() < 5e-4

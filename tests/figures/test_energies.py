"""Figures of energies: between rows where the steps can be made again, by term, and as points where nothing is known."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest

import xdynamics as xd

SITES = """
name = "sites on springs"
[dimensions]
site = 70
[coordinates]
u = { unit = "m", dims = ["site"] }
[parameters]
k = "4 N m-1"
[mass]
u = "1*kilogram"
[forces.springs]
potential = "k*u**2/2"
[initial]
u = "(1 + index(site)/size(site))*metre"
[run]
method = "velocity_verlet"
step = "0.05 s"
until = "2 s"
"""
HUNG = """
name = "bodies hung on springs"
[dimensions]
body = 3
axis = ["x", "y"]
[coordinates]
r = { unit = "m", dims = ["body", "axis"] }
[parameters]
g = "9.8 m s-2"
k = "50 N m-1"
[mass]
r = "2*kilogram"
[forces.weight]
potential = "2*kilogram*g*r[0, y] + 2*kilogram*g*r[1, y] + 2*kilogram*g*r[2, y]"
[forces.springs]
potential = "k*r**2/2"
[initial]
r = { unit = "m", value = [[1, 0], [0, 1], [-1, 0.5]] }
[run]
method = "rk4"
step = "0.01 s"
until = "1 s"
"""
BALL = """
name = "ball on a spring"
[coordinates]
y = "m"
[parameters]
m = "2 kg"
g = "10 m s-2"
k = "50 N m-1"
[mass]
y = "m"
[forces.weight]
potential = "m*g*y"
[forces.spring]
potential = "k*y**2/2"
[initial]
y = "1 m"
[run]
method = "rk4"
step = "0.01 s"
until = "1 s"
"""


def panel(run: Any, **settings: Any) -> Any:
    """The last panel of a figure of energies."""
    figure = xd.plot(run, **settings)
    plt.close(figure)
    return figure.axes[-1]


def lines(axes: Any) -> dict[str, tuple[Any, Any]]:
    """Numbers of the lines of a panel by their names."""
    return {str(line.get_label()): (np.asarray(line.get_xdata()), np.asarray(line.get_ydata())) for line in axes.lines}


def test_energies_of_many_elements_bend_as_the_steps_do() -> None:
    """Assert the total energy of 140 numbers at points inside steps: that of shortened steps of velocity Verlet, no chord."""
    run = xd.simulate(xd.Model.from_text(SITES))
    axes = panel(run, only="total_energy")
    (drawn,) = axes.lines
    times, values = np.asarray(drawn.get_xdata()), np.asarray(drawn.get_ydata()) + float(run["total_energy"][0])
    assert drawn.get_linestyle() == "-"
    assert "straight" not in axes.get_title(loc="left")
    assert times.size > 10 * run.sizes["step"]
    row = np.clip(np.searchsorted(run["time"].values, times, side="right") - 1, 0, run.sizes["step"] - 1)
    h, q, v = (times - run["time"].values[row])[:, None], run["u"].values[row], run["v_u"].values[row]
    new = q + h * v - h**2 * 2.0 * q
    speed = v - h * 2.0 * (q + new)
    energy = (speed**2 + 4.0 * new**2).sum(axis=1) / 2.0
    assert np.allclose(values, energy, rtol=1e-12, atol=0.0)
    chord = np.interp(times, run["time"].values, run["total_energy"].values)
    assert np.abs(energy - chord).max() > 1e-5 * energy.max()


def test_energies_are_points_where_nothing_is_known_between_rows() -> None:
    """Assert a point for each row and no line, in words, for a record without its model."""
    run = xd.simulate(xd.Model.from_text(SITES)).drop_vars("model_toml")
    axes = panel(run, only="total_energy")
    (drawn,) = axes.lines
    assert (drawn.get_linestyle(), drawn.get_marker()) == ("None", ".")
    assert (np.asarray(drawn.get_xdata()) == run["time"].values).all()
    assert axes.get_title(loc="left").endswith("; at recorded states")


def test_positions_of_a_run_of_states_bend_with_their_velocities() -> None:
    """Assert cubics through positions and velocities where accelerations are not recorded."""
    model = xd.Model.from_text(SITES.replace("site = 70", "site = 3"))
    run = xd.simulate(model, log="states").drop_vars("model_toml")
    axes = panel(run, only="trajectory")
    assert "straight" not in axes.get_title(loc="left")
    line = next(line for line in axes.lines if line.get_linestyle() == "-")
    times, values = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
    h, q, v = 0.05, run["u"].values[:, 0], run["v_u"].values[:, 0]
    row = np.clip((times / h + 1e-9).astype(int), 0, len(q) - 2)
    s = times / h - row
    cubic = (1 + 2 * s) * (1 - s) ** 2 * q[row] + s * (1 - s) ** 2 * h * v[row]
    cubic += s**2 * (3 - 2 * s) * q[row + 1] - s**2 * (1 - s) * h * v[row + 1]
    assert times.size > 10 * len(q)
    assert np.allclose(values, cubic, rtol=0.0, atol=1e-12)


def test_energies_by_term_are_those_of_each_force() -> None:
    """Assert m g y and k y^2/2 of one body, and of three bodies summed over them, beside the kinetic energy."""
    run = xd.simulate(xd.Model.from_text(BALL))
    found = lines(panel(run, only="energy"))
    assert [*found] == ["kinetic", "weight", "spring"]
    times, weight = found["weight"]
    height = weight / 20.0
    assert np.allclose(found["spring"][1], 25.0 * height**2, rtol=1e-12, atol=1e-12)
    exact = 1.4 * np.cos(5.0 * times) - 0.4  # about -m g/k
    assert np.allclose(height, exact, rtol=0.0, atol=1e-6)
    run = xd.simulate(xd.Model.from_text(HUNG))
    found = lines(panel(run, only="energy"))
    assert [*found] == ["kinetic", "weight", "springs"]
    places = np.searchsorted(found["weight"][0], run["time"].values)
    r = run["r"].values
    assert np.allclose(found["weight"][1][places], 19.6 * r[..., 1].sum(axis=1), rtol=1e-12, atol=1e-12)
    assert np.allclose(found["springs"][1][places], 25.0 * (r**2).sum(axis=(1, 2)), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("units", "energy", "weight", "stiffness"),
    [
        ({"m": "2e3 g", "g": "10 m s-2", "k": "5e-4 kJ cm-2", "y": "cm"}, "J", 0.2, 0.5),
        ({"m": "2 kg", "g": "1 cm ms-2", "k": "100 mJ mm-2", "y": "mm"}, "J", 20.0, 0.1),
        ({"m": "2 kg m2", "g": "10 s-2", "k": "50 J", "y": "degree"}, "J", np.pi / 9.0, 50.0 * (np.pi / 180.0) ** 2),
        ({"m": "2e3 g", "g": "10", "k": "50 kg", "y": "1", "time": "1"}, "kg", 20.0, 50.0),
        ({"m": "2", "g": "10", "k": "50", "y": "1", "time": "1"}, "1", 20.0, 50.0),
    ],
)
def test_energies_by_term_are_in_coherent_units(
    units: dict[str, str], energy: str, weight: float, stiffness: float
) -> None:
    """Assert m g y and k y^2/2 in the SI unit of energies, of which the record has the sum, whatever units a model is in."""
    time = units.get("time", "s")
    text = f"""
name = "ball on a spring"
coordinates.y = "{units["y"]}"
time.unit = "{time}"
parameters = {{ m = "{units["m"]}", g = "{units["g"]}", k = "{units["k"]}" }}
mass.y = "m"
forces.weight.potential = "m*g*y"
forces.spring.potential = "k*y**2/2"
initial.y = "1 {units["y"]}"
"""
    run = xd.simulate(xd.Model.from_text(text), method="rk4", step=f"0.001 {time}", until=f"0.1 {time}")
    assert {run[f"{kind}_energy"].attrs["units"] for kind in ("kinetic", "potential", "total")} == {energy}
    axes = panel(run, only="energy")
    assert axes.get_ylabel() == f"energy ({energy})".removesuffix(" (1)")
    found = lines(axes)
    places = np.searchsorted(found["weight"][0], run["time"].values)
    y = run["y"].values
    assert np.allclose(found["weight"][1][places], weight * y, rtol=1e-12, atol=0.0)
    assert np.allclose(found["spring"][1][places], stiffness * y**2 / 2.0, rtol=1e-12, atol=0.0)


def test_one_term_has_no_panel_of_its_own() -> None:
    """Assert that energies of a model with one potential are one panel, and those of several runs as well."""
    one = xd.simulate(xd.Model.from_text(SITES.replace("site = 70", "site = 3")))
    assert len(xd.plot(one, only="energy").axes) == 1
    ball = xd.Model.from_text(BALL)
    assert len(xd.plot([xd.simulate(ball), xd.simulate(ball, step="20 ms")], only="energy").axes) == 1


def test_large_constants_of_terms_are_left_out() -> None:
    """Assert energies less their starts, in words, where these would flatten all that changes."""
    text = BALL.replace("m*g*y", "m*g*y + 1e4*joule")
    axes = panel(xd.simulate(xd.Model.from_text(text)), only="energy")
    assert " ".join(axes.get_title(loc="left").split()).endswith(", each less its start")
    assert lines(axes)["weight"][1][0] == 0.0


def test_many_terms_are_told_as_five_and_the_rest() -> None:
    """Assert the five of seven terms that change most, and the sum of the two others."""
    parts = "".join(f'[forces.part_{k}]\npotential = "{k + 1}*k*y**2/2"\n' for k in range(7))
    text = BALL.replace('[forces.weight]\npotential = "m*g*y"\n[forces.spring]\npotential = "k*y**2/2"\n', parts)
    run = xd.simulate(xd.Model.from_text(text))
    found = lines(panel(run, only="energy"))
    assert [*found] == ["kinetic", *(f"part_{k}" for k in range(2, 7)), "2 others"]
    assert np.allclose(found["2 others"][1], found["part_2"][1], rtol=1e-12, atol=0.0)


def test_terms_that_are_not_the_record_are_not_drawn() -> None:
    """Assert no terms where somebody has changed the record, so that their sum is not what it says; and no edited motion."""
    run = xd.simulate(xd.Model.from_text(BALL)).copy(deep=True)
    moved = run.copy(deep=True)
    moved["y"].values[:] *= 2.0
    with pytest.raises(xd.InputError, match="y: edited since the run was computed"):
        panel(moved, only="energy")
    run["potential_energy"].values[:] *= 2.0
    axes = panel(run, only="energy")
    assert [*lines(axes)] == ["kinetic"]


def test_constants_do_not_flatten_energies() -> None:
    """Assert kinetic, potential and total energy less their starts, in words, where a constant is far above all changes."""
    text = BALL.replace("m*g*y", "m*g*y + 1e3*joule").replace(
        "[run]", '[forces.drag]\ny = "-v_y*4*newton*second/metre"\n[run]'
    )
    run = xd.simulate(xd.Model.from_text(text))
    axes = xd.plot(run, only="energy").axes[0]
    assert "energy, each less its start" in " ".join(axes.get_title(loc="left").split())
    found = lines(axes)
    assert [float(values[0]) for _, values in found.values()] == [0.0, 0.0, 0.0]
    assert found["total"][1][-1] == float(run["total_energy"][-1] - run["total_energy"][0])

"""A bare number keeps the scale that the file states the quantity on: `replace`, axes, `--set`, `--until`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import xdynamics as xd
from xdynamics.cli import main
from xdynamics.sweeping.axes import column_of

ROOM = """
name = "a room that cools"
states.T = { unit = "K", rate = "-(T - outside)/tau" }
parameters = { outside = "20 degC", tau = "2 month", far = "2 pc", warm = "68 degF", age = "3 light_year" }
initial = { T = "80 degC" }
run = { method = "rk4", step = "1 h", until = "10 h" }
"""
ROOMS = """
name = "rooms that cool"
dimensions.room = 3
states.T = { unit = "K", dims = ["room"], rate = "-(T - outside)/tau" }
parameters = { outside = { dims = ["room"], value = __VALUE__ }, tau = "2 h" }
initial = { T = "80 degC" }
run = { method = "rk4", step = "1 h", until = "10 h" }
"""
SI = {
    "outside": (25.0, 298.15),
    "tau": (3.0, 3 * 30.4375 * 86400.0),
    "far": (1.0, 3.0856775814913673e16),
    "warm": (50.0, 283.15),
    "age": (1.0, 9460730472580800.0),
}


@pytest.fixture(scope="module")
def room() -> xd.Model:
    return xd.Model.from_text(ROOM)


@pytest.mark.parametrize("name", SI)
@pytest.mark.parametrize("kind", [float, np.float64, np.array])
def test_a_replaced_number_is_on_the_scale_of_the_file(room: xd.Model, name: str, kind: Any) -> None:
    """Assert the SI value of a bare number in the place of one in °C, °F, months, parsecs and light-years."""
    number, si = SI[name]
    assert room.replace(parameters={name: kind(number)}).statement.parameters[name].si == pytest.approx(si, rel=1e-15)


def test_a_start_is_too(room: xd.Model) -> None:
    """Assert the same of the start, and that a unit that is written counts."""
    assert room.replace(initial={"T": 10}).initial["T"].si == 283.15
    assert room.replace(parameters={"outside": "25 K"}).statement.parameters["outside"].si == 25.0


def test_it_is_once_more_where_it_was_replaced(room: xd.Model) -> None:
    """Assert that a model made by replacing keeps the scale, and one that was archived has its own unit."""
    again = room.replace(parameters={"outside": 25}).replace(parameters={"outside": 30})
    assert again.statement.parameters["outside"].si == pytest.approx(303.15)
    kept = xd.Model.from_text(room.to_toml()).replace(parameters={"outside": 25})
    assert kept.statement.parameters["outside"].si == 25.0  # its text says kelvins


@pytest.mark.parametrize(
    "values",
    [
        "20:30:3",
        "20:30:3 degC",
        "20, 25, 30",
        "20, 25, 30 degC",
        [20, 25.0, 30],
        np.array([20.0, 25.0, 30.0]),
        "68:86:3 degF",
    ],
)
def test_an_axis_is_on_the_scale_of_the_file(room: xd.Model, values: Any) -> None:
    """Assert values of an axis as a range, a list, numbers and an array."""
    column = column_of(room, "outside", values)
    assert column.values.tolist() == pytest.approx([293.15, 298.15, 303.15])
    assert column.unit.text == "K"


@pytest.mark.parametrize(
    "value", ['"20 degC"', '["20 degC", 20, 20.0]', '20, unit = "degC"', '[20, 20, 20], unit = "degC"']
)
def test_elements_are_on_the_scale_of_the_file(value: str) -> None:
    """Assert the same of quantities with dimensions: as they are read, replaced whole, by element, and along an axis."""
    model = xd.Model.from_text(ROOMS.replace("__VALUE__", value))
    assert {entry.si for entry in model.statement.parameters.values() if entry.quantity.unit.text == "K"} == {293.15}
    whole = model.replace(parameters={"outside": [25, 30, 35]})
    names = [model.shapes.internal_name(f"outside[{i}]") for i in range(3)]
    assert [whole.statement.parameters[name].si for name in names] == pytest.approx([298.15, 303.15, 308.15])
    one = model.replace(parameters={"outside[1]": 25})
    assert one.statement.parameters[names[1]].si == 298.15
    assert column_of(model, "outside[1]", [25.0]).values.tolist() == [298.15]


def marched(folder: Path, *arguments: str) -> Any:
    """Run the model at the command line."""
    (folder / "room.toml").write_text(ROOM)
    return CliRunner().invoke(main, ["run", str(folder / "room.toml"), "-o", str(folder / "run.nc"), *arguments])


def test_the_command_line_follows_the_same_rule(tmp_path: Path) -> None:
    """Assert `--set` in °C, and `--until` and `--step` in the hours that the file says."""
    done = marched(tmp_path, "--set", "outside=25", "--until", "20", "--step", "2")
    assert done.exit_code == 0, done.output
    with xd.open_run(tmp_path / "run.nc") as run:
        assert float(run.outside) == 298.15
        assert float(run.time[-1]) == 20 * 3600.0
        assert float(run.step_size[1]) == 7200.0


@pytest.mark.parametrize("text", ["nan", "1e999", "ten", "1 kg", "-"])
def test_what_is_no_time_is_refused(tmp_path: Path, text: str) -> None:
    """Assert one line, and no file, for an end that is none."""
    done = marched(tmp_path, "--until", text)
    assert done.exit_code == 2
    assert "until" in done.output
    assert not (tmp_path / "run.nc").exists()


def test_thirty_digits_of_a_parsec() -> None:
    """Assert that a length in parsecs is known to 31 digits, like any other, and keeps them in the model's text."""
    from fractions import Fraction

    from xdynamics.units import parse_quantity
    from xdynamics.units.unit import exact_value

    pi = Fraction("3.14159265358979323846264338327950288419716939937510")
    exact = Fraction("1.9") * 648000 / pi * 149597870700
    quantity = parse_quantity("1.9 parsec")
    assert abs(exact_value(quantity.value) / exact - 1) < Fraction(1, 10**45)
    assert abs(exact_value(parse_quantity(str(quantity)).value) / exact - 1) < Fraction(1, 10**38)

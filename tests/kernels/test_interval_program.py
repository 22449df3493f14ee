"""Event functions as rows of operations on intervals: what a march computes once, and for every step."""

from __future__ import annotations

from typing import Any

import numpy as np

import xdynamics as xd
from xdynamics.kernels.interval_program import (
    CONSTANT,
    NUMBER,
    OPERATIONS,
    PHASE,
    TIME,
    UNKNOWN,
    UNUSED,
    Enclosing,
    bounds,
    can_be_watched,
    enclosing,
)
from xdynamics.kernels.layout import Layout
from xdynamics.kernels.program import INTERVAL, Compute, Load
from xdynamics.march.configuration import settings_for

TABLE = "q [m],curve [1]\n-3,1.5\n0,0.1\n3,5\n"


def layout_of(model: xd.Model) -> Layout:
    """The layout of a march with sides of switches."""
    return settings_for(model, method="rk4", step="1 ms", until="1 s").layout(model)


def model(*functions: str, **more: Any) -> xd.Model:
    """A mass on a spring, a state, and events of these functions."""
    return xd.Model(
        **{
            "name": "spring",
            "coordinates": {"x": "m"},
            "parameters": {"m": "1 kg", "k": "4 N m-1", "a": "0.5 m"},
            "mass": {"x": "m"},
            "forces": {"spring": {"potential": "k*x**2/2"}},
            "states": {"w": {"unit": "1", "rate": "1/second"}},
            "initial": {"x": "1 m", "v_x": "0 m s-1", "w": "0"},
            "events": {f"e{i}": {"function": function} for i, function in enumerate(functions)},
        }
        | more
    )


def operations(program: Enclosing, first: int, last: int) -> list[str]:
    """Names of what some rows compute."""
    return [OPERATIONS[row] for row in program.rows[program.parts[first] if first >= 0 else 0 : program.parts[last], 0]]


def test_what_does_not_change_is_computed_once() -> None:
    """Assert that numbers, parameters and what follows from them stand before what moves, and nothing else does."""
    program = enclosing(layout_of(model("x - (2*a + 3*metre)")))
    assert sorted(operations(program, -1, 0)) == sorted(
        ["constant", "constant", "number", "number", "multiply", "multiply", "add"]
    )
    assert operations(program, 0, 1) == ["position", "subtract"]
    assert program.numbers.tolist() == [2.0, 3.0]
    assert program.of_time == (False,)
    assert program.bends == (UNUSED,)


def test_numbers_of_the_march_are_not_constant() -> None:
    """Assert that the side of a switch, which a march changes, is read for every step, unlike a parameter."""
    program = enclosing(layout_of(model("a*abs(x)/metre", forces={"drag": {"x": "-k*abs(x)"}})))
    assert operations(program, -1, 0).count("constant") >= 1
    fixed = {row[2] for row in program.rows[: program.parts[0]].tolist() if row[0] == CONSTANT}
    moving = {row[2] for row in program.rows[program.parts[0] :].tolist() if row[0] == CONSTANT}
    assert fixed
    assert not fixed & moving
    assert all(i < 4 for i in fixed), "m, k, a and the unit metre come first"


def test_gaps_have_second_derivatives() -> None:
    """Assert that the function of a contact has rows for its second derivative, and an event's has none."""
    program = enclosing(layout_of(model("x - a", contacts={"floor": {"gap": "x + a", "restitution": 0.5}})))
    assert [bend == UNUSED for bend in program.bends].count(True) == len(program.bends) - 1
    assert "acceleration" in operations(program, 2, 3)
    assert "velocity" in operations(program, 1, 2)
    assert program.parts[2] < program.parts[3]


def test_what_lanes_can_watch() -> None:
    """Assert that motion, time and regimes can be printed; tables and functions in Python cannot."""

    def python(x: float) -> float:
        return x

    drives = {"curve": {"table": "d.csv", "csv": TABLE, "argument": "x", "outside": "hold"}}
    assert can_be_watched(layout_of(model("x - a", "t - second", "w - 0.5")))
    assert not can_be_watched(layout_of(model("x - a", "curve - 1", drives=drives)))
    assert not can_be_watched(layout_of(model("x - a", events={"e": {"function": python, "unit": "m"}})))
    rows = enclosing(layout_of(model(events={"e": {"function": python, "unit": "m"}}))).rows
    assert UNKNOWN in rows[:, 0]


def test_functions_of_time_alone() -> None:
    """Assert which functions follow from the time, and that their rows say so."""
    drives = {"curve": {"table": "d.csv", "csv": TABLE.replace("q [m]", "t [s]"), "argument": "t", "outside": "hold"}}
    program = enclosing(layout_of(model("t - second", "x - a", "curve - 1", drives=drives)))
    assert program.of_time == (True, False, True)
    looked_up = [row for row in program.rows.tolist() if OPERATIONS[row[0]] == "value_at"]
    assert [row[3:5] for row in looked_up] == [[0, 1]]
    assert TIME in program.rows[:, 0]


def test_bounds_are_written_with_what_they_read() -> None:
    """Assert lines of bounds: numbers as they are, parameters from p, the regime from at, motion from both states."""
    regimes = {"near": {"forces": ["spring"]}, "far": {"forces": ["spring"]}}
    events = {"e": {"function": "2*(x - a)*w"}, "go": {"function": "x", "action": "switch", "to": "far"}}
    layout = layout_of(model(regimes=regimes, events=events))
    lines, ends = bounds(layout, "width", "t", "t1", 0)
    assert ends == [(f"under{i}", f"over{i}") for i in range(len(layout.watched))]
    computed = {line.target: line for line in lines if isinstance(line, Compute) and line.kind == INTERVAL}
    loads = {line.target: line.place for line in lines if isinstance(line, Load)}
    points = [line.arguments[0] for line in computed.values() if line.operation == "point"]
    assert 2.0 in points
    assert {loads[point].array for point in points if isinstance(point, str)} == {"p"}
    (position,) = (line for line in computed.values() if line.operation == "position")
    own = [layout.record.place(name) for name in ("x", "v_x", "a_x")]
    assert [(loads[str(of)].array, loads[str(of)].offset) for of in position.arguments[:6]] == [
        (state, place) for state in "yz" for place in own
    ]
    assert position.arguments[6:] == ("width", 0.0, 0.0)


def test_numbers_have_one_place_each() -> None:
    """Assert that a number that occurs twice is one row, and a product of one value with itself a square."""
    program = enclosing(layout_of(model("x*x - 3*metre*x + 3*metre**2")))
    numbers = [row for row in program.rows.tolist() if row[0] == NUMBER]
    assert [program.numbers[row[2]] for row in numbers] == [3.0]
    assert operations(program, 0, 1).count("square") == 1
    assert len({*program.rows[:, 1].tolist()}) == len(program.rows) == program.values
    assert np.array_equal(np.sort(program.rows[:, 1]), np.arange(program.values))
    assert PHASE not in program.rows[:, 0]

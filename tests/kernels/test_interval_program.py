"""Event functions as rows of operations on intervals: what a march computes once, and for every step.

The judgement whether numbers are finite, of neighbours side by side.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.array_programs import bound, in_python
from xdynamics.elementary.bounds import POLYNOMIALS, on_curve
from xdynamics.kernels.interval_program import (
    CONSTANT,
    NUMBER,
    OPERATIONS,
    PHASE,
    TIME,
    UNKNOWN,
    UNUSED,
    VARIABLES,
    Enclosing,
    can_be_watched,
    enclosing_rows,
    write_bounds,
)
from xdynamics.kernels.layout import Layout
from xdynamics.kernels.llvm_program import llvm_of
from xdynamics.kernels.program import AT, INTERVAL, Compute, Load, Location, Loop, Program, StoreTo, loop_element
from xdynamics.march.configuration import settings_for
from xdynamics.model.motion import constants
from xdynamics.model.reactions import mode_names
from xdynamics.model.regime_model import switch_inputs

TABLE = "q [m],curve [1]\n-3,1.5\n0,0.1\n3,5\n"


def layout_of(model: xd.Model, method: str = "rk4") -> Layout:
    """The layout of a march with sides of switches."""
    return settings_for(model, method=method, step="1 ms", until="1 s").layout(model)


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
    program = enclosing_rows(layout_of(model("x - (2*a + 3*metre)")))
    assert sorted(operations(program, -1, 0)) == sorted(
        ["constant", "constant", "number", "number", "multiply", "multiply", "add"]
    )
    assert operations(program, 0, 1) == ["position", "subtract"]
    assert program.numbers.tolist() == [2.0, 3.0]
    assert program.of_time == (False,)
    assert program.bends == (UNUSED,)


def test_numbers_of_the_march_are_not_constant() -> None:
    """Assert that sides of switches and modes of friction, which a march changes, are read for every step."""
    belt = {"slip": "v_x - 0.1*metre/second", "kinetic": "0.2*newton"}
    layout = layout_of(model("x - a", forces={"drag": {"x": "-k*abs(x)"}}, frictions={"belt": belt}))
    program, names = enclosing_rows(layout), list(constants(layout.model))
    fixed, every = program.rows[: program.parts[0]], program.rows
    constant, read = ({names[row[2]] for row in rows.tolist() if row[0] == CONSTANT} for rows in (fixed, every))
    assert constant == {"m", "k", "a", "metre", "second", "newton"}
    assert read - constant == {*switch_inputs(layout.model), *mode_names(layout.model)}


@pytest.mark.parametrize("method", ["rk4", "radau_iia"])
def test_variables_by_the_error_that_counts(method: str) -> None:
    """Assert that each variable is read with its own place, whose error widens it."""
    layout = layout_of(model("x*w", "v_x", "x*w/second"), method)
    program, record = enclosing_rows(layout), layout.record
    own = {"position": "x", "velocity": "v_x", "state": "w"}
    rows = [(OPERATIONS[row[0]], row[2:]) for row in program.rows.tolist() if OPERATIONS[row[0]] in VARIABLES]
    assert {name for name, _ in rows} > {*own}
    for name, places in rows:
        if name in own:
            assert places[VARIABLES[name]] == record.offset_of(own[name])
    slopes = {name for name, _ in rows} - {*own}
    assert slopes == ({"acceleration", "rate"} if method == "rk4" else {"velocity_slope", "state_slope"})


def test_bounds_on_the_polynomial_of_a_step() -> None:
    """Assert that every coefficient of radau's cubic is read, by power, from where the polynomial begins in w."""
    layout = layout_of(model("x - a", "2*w - 3"), "radau_iia")
    lines, ends = write_bounds(layout, "width", "t", "t1", 7)
    loads = {line.target: line.location for line in lines if isinstance(line, Load)}
    computed = {line.operation: line for line in lines if isinstance(line, Compute)}
    for name, owners in {"state": ("w",), "position": ("x", "v_x")}.items():
        owned = owners[: POLYNOMIALS[name]]
        given = [loads[str(argument)] for argument in computed[on_curve(name)].arguments[: 4 * len(owned)]]
        places = [layout.used.offset_of(owner) for owner in owned]
        assert given == [Location("w", 7 + power * layout.used.size + place) for place in places for power in range(4)]
    assert computed[on_curve("position")].arguments[-6:] == ("width", 0.0, 0.0, "width", 0.0, 1.0)
    assert [line.arguments[0] for line in lines if isinstance(line, Compute) and line.operation == "point"].count(
        3.0
    ) == 1
    of = enclosing_rows(layout).functions
    for (under, over), place in zip(ends, of, strict=True):
        assert Compute(under, "low", (f"_i{place}",), INTERVAL) in lines
        assert Compute(over, "high", (f"_i{place}",), INTERVAL) in lines


def test_gaps_have_second_derivatives() -> None:
    """Assert that the function of a contact has rows for its second derivative, and an event's has none."""
    program = enclosing_rows(layout_of(model("x - a", contacts={"floor": {"gap": "x + a", "restitution": 0.5}})))
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
    rows = enclosing_rows(layout_of(model(events={"e": {"function": python, "unit": "m"}}))).rows
    assert UNKNOWN in rows[:, 0]


def test_functions_of_time_alone() -> None:
    """Assert which functions follow from the time, and that their rows say so."""
    drives = {"curve": {"table": "d.csv", "csv": TABLE.replace("q [m]", "t [s]"), "argument": "t", "outside": "hold"}}
    program = enclosing_rows(layout_of(model("t - second", "x - a", "curve - 1", drives=drives)))
    assert program.of_time == (True, False, True)
    looked_up = [row for row in program.rows.tolist() if OPERATIONS[row[0]] == "value_at"]
    assert [row[3:5] for row in looked_up] == [[0, 1]]
    assert TIME in program.rows[:, 0]


def test_bounds_are_written_with_what_they_read() -> None:
    """Assert lines of bounds: numbers as they are, parameters from p, the regime from at, motion from both states."""
    regimes = {"near": {"forces": ["spring"]}, "far": {"forces": ["spring"]}}
    events = {"e": {"function": "2*(x - a)*w"}, "go": {"function": "x", "action": "switch", "to": "far"}}
    layout = layout_of(model(regimes=regimes, events=events))
    lines, ends = write_bounds(layout, "width", "t", "t1", 0)
    assert ends == [(f"under{i}", f"over{i}") for i in range(len(layout.watched))]
    computed = {line.target: line for line in lines if isinstance(line, Compute) and line.kind == INTERVAL}
    loads = {line.target: line.location for line in lines if isinstance(line, Load)}
    points = [line.arguments[0] for line in computed.values() if line.operation == "point"]
    assert 2.0 in points
    assert {loads[point].array for point in points if isinstance(point, str)} == {"p"}
    (position,) = (line for line in computed.values() if line.operation == "position")
    own = [layout.record.offset_of(name) for name in ("x", "v_x", "a_x")]
    assert [(loads[str(of)].array, loads[str(of)].offset) for of in position.arguments[:6]] == [
        (state, place) for state in "yz" for place in own
    ]
    assert position.arguments[6:] == ("width", 0.0, 0.0)


def test_numbers_have_one_place_each() -> None:
    """Assert that a number that occurs twice is one row, and a product of one value with itself a square."""
    program = enclosing_rows(layout_of(model("x*x - 3*metre*x + 3*metre**2")))
    numbers = [row for row in program.rows.tolist() if row[0] == NUMBER]
    assert [program.numbers[row[2]] for row in numbers] == [3.0]
    assert operations(program, 0, 1).count("square") == 1
    assert len({*program.rows[:, 1].tolist()}) == len(program.rows) == program.values
    assert np.array_equal(np.sort(program.rows[:, 1]), np.arange(program.values))
    assert PHASE not in program.rows[:, 0]


UNSOUND = AT.index("unsound")
DOUBLED = Load("x", loop_element("y")), Compute("two", "add", ("x", "x")), StoreTo(loop_element("z"), "two")


def doubles(n: int) -> Program:
    """The doubles of n numbers, and whether they are finite."""
    return Program("doubles", "Doubles.", (Loop("i", n, DOUBLED),), sound=(0, n))


@pytest.mark.parametrize("wide", [1, 4, 8, 16])
def test_one_number_that_is_not_finite_is_found_anywhere(wide: int) -> None:
    """Assert that 37 numbers are sound, and none of them may be infinite or undefined, in machine code and in Python."""
    n = 37
    arrays = {"y": np.linspace(-1e308 / 2, 1e308 / 2, n), "z": np.zeros(n), "at": np.full(len(AT), 7.0)}
    for call in (bound(doubles(n), abreast=wide, **arrays), partial(in_python(doubles(n)), **arrays)):
        arrays["y"][:] = np.linspace(-1e308 / 2, 1e308 / 2, n)
        call()
        assert arrays["at"][UNSOUND] == 0.0
        for place in range(n):
            for value in (1e308, -np.inf, np.nan):
                arrays["y"][:] = 1.0
                arrays["y"][place] = value
                call()
                assert np.isnan(arrays["at"][UNSOUND])


def test_neighbours_are_judged_side_by_side() -> None:
    """Assert that the sum has four numbers a pass, where one after the other waits for each addition."""
    assert "fadd <4 x double>" in llvm_of([doubles(37)], abreast=4).split("@doubles.inner")[1].split("fsub")[1]
    assert "fsub <4 x double>" not in llvm_of([doubles(3)], abreast=4)

"""Measured tables: what is read of a file, and the values and slopes between and beyond its points."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline, PchipInterpolator, make_interp_spline

import xdynamics as xd
from xdynamics.model import Table
from xdynamics.model.drives import piece_coefficients, value_and_slope

ARGUMENT, VALUE = np.array([0.0, 1.0, 2.5, 3.0, 4.0]), np.array([1.0, 3.0, 2.0, 2.0, 5.0])
CURVES = {
    "linear": make_interp_spline(ARGUMENT, VALUE, k=1),
    "pchip": PchipInterpolator(ARGUMENT, VALUE),
    "cubic": CubicSpline(ARGUMENT, VALUE),
}


def test_a_column_is_read_in_its_own_unit() -> None:
    """Assert SI values of either column, whatever the units, and the first line as the header."""
    table = Table.parse("a.csv", "# 1\n\nt [ms],f [kN]\r\n# note\n1,2\r3,5\n")
    assert table.argument.tolist() == [1e-3, 3e-3]
    assert table.value.tolist() == [2000.0, 5000.0]
    assert (table.argument_unit.text, table.value_unit.text) == ("ms", "kN")
    assert table == Table.parse("a.csv", table.text)


@pytest.mark.parametrize(
    ("rows", "fault"),
    [
        ("0,1\n2,1\n1,1", "line 4: argument 1.0 does not increase after 2.0"),
        ("0,1\ninf,1", "line 3: 'inf' is not finite"),
        ("0,1\n1,inf", "line 3: 'inf' is not finite"),
        ("0,1\n2,-inf", "line 3: '-inf' is not finite"),
        ("0,1\n1," + "x" * 24, f"line 3: '{'x' * 24}' is no number"),
        ("0,1\n1," + "x" * 25, f"line 3: '{'x' * 24}…' is no number"),
        ("0,1", "has 1 rows, needs 2 or more"),
        ("0,1\n1_0,2", "line 3: '1_0' is no number"),
    ],
)
def test_a_fault_is_shown_with_its_line_and_cell(rows: str, fault: str) -> None:
    """Assert line and beginning of the cell that is wrong."""
    with pytest.raises(xd.InputError) as caught:
        Table.parse("a.csv", "t [s],f [N]\n" + rows)
    assert caught.value.faults == (fault,)


def test_faults_of_a_table_are_few() -> None:
    """Assert that of many faulty lines the first twenty are told, and the rows behind a fault are read on."""
    with pytest.raises(xd.InputError) as caught:
        Table.parse("a.csv", "t [s],f [N]\n" + "x,1\n" * 12 + "0,1\n0\n" + "1,inf\n" * 12)
    assert len(caught.value.faults) == 20
    assert caught.value.faults[12] == "line 15, '0' …, has 1 cells, the header 2"


@pytest.mark.parametrize("rule", CURVES)
def test_a_table_looked_up_is_its_curve(rule: str) -> None:
    """Assert values and slopes between the points, at each of them from the piece behind it, the last point apart."""
    table, curve = piece_coefficients(ARGUMENT, VALUE, rule, "hold"), CURVES[rule]
    for x in [*np.linspace(0.0, 3.999, 61), *ARGUMENT[:-1]]:
        for of_time in (False, True):
            wanted = float(curve(x)), float(curve.derivative()(x))
            assert value_and_slope(table, x, of_time=of_time) == pytest.approx(wanted, abs=1e-13)
    assert value_and_slope(table, 4.0, of_time=True) == (5.0, 0.0)
    slope = float(curve.derivative()(np.nextafter(4.0, 0.0)))
    assert value_and_slope(table, 4.0, of_time=False) == pytest.approx((5.0, slope), abs=1e-13)


@pytest.mark.parametrize(("outside", "ends"), [("hold", (1.0, 5.0)), ("zero", (0.0, 0.0)), ("error", (np.nan, np.nan))])
@pytest.mark.parametrize("rule", [*CURVES, "previous"])
def test_beyond_its_table_a_curve_is_level(rule: str, outside: str, ends: tuple[float, float]) -> None:
    """Assert value and slope before the first point and behind the last."""
    table = piece_coefficients(ARGUMENT, VALUE, rule, outside, of_time=False)
    for x, end in zip((-1e-9, 4.0 + 1e-9), ends, strict=True):
        value, slope = value_and_slope(table, x, of_time=False)
        assert np.array_equal([value], [end], equal_nan=True)
        assert slope == 0.0 or np.isnan(end)


def test_steps_of_a_table_hold_to_the_next_point() -> None:
    """Assert that a table of steps has its last value at the last point, where its argument is no time."""
    table = piece_coefficients(ARGUMENT, VALUE, "previous", "zero", of_time=False)
    assert [value_and_slope(table, x, of_time=False)[0] for x in ARGUMENT] == VALUE.tolist()
    assert table[0].tolist() == [0.0, *ARGUMENT, np.nextafter(4.0, 5.0)]
    origin, powers = piece_coefficients(ARGUMENT, VALUE, "previous", "zero", of_time=True)
    assert origin.tolist() == [0.0, *ARGUMENT]
    assert powers[3].tolist() == [0.0, *VALUE[:-1], 0.0]
    assert not powers[:3].any()

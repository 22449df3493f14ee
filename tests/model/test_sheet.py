"""Tables as instruments and spreadsheets write them, and as Python holds them.

Measured tables: what is read of a file, and the values and slopes between and beyond its points.
Cubics through measured tables: SciPy's to the bit or nearly so, exact where the data are cubic.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy.interpolate import CubicSpline, PchipInterpolator, make_interp_spline

import xdynamics as xd
from xdynamics.model import Table
from xdynamics.model.csv_sheet import Sheet, csv_text, title
from xdynamics.model.drives import hermite_pieces, monotone_slopes, piece_coefficients, spline_slopes, value_and_slope

PLAIN = "time [ms],force [mN]\n0,1.5\n10,2.25\n20,-3\n"


@pytest.mark.parametrize(
    "text",
    [
        PLAIN,
        "time [ms];force [mN]\n0;1,5\n10;2,25\n20;-3\n",
        "time (ms)\tforce (mN)\n0\t1.5\n10\t2.25\n20\t-3\n",
        "Time/ms;force / mN\r\n0,0;1,5\r\n1,0e1;2,25\r\n2e1;-3\r\n",
        "\ufeff# from the logger\n% and more\n// too\ntime [ms], force [mN]\n\n 0 , 1.5\n10,2.25\n20,-3",
        "time [ms];force, filtered [mN]\n0;1.5\n10;2.25\n20;-3\n",
        '"time [ms]";"force [mN]"\n"0";"1,5"\n"10";"2,25"\n"20";"-3"\n',
    ],
)
def test_unfriendly_tables_are_the_plain_one(text: str) -> None:
    """Assert separators, decimal commas, headers, quotes, comments and marks of files."""
    found, plain = Table.parse("a.csv", text), Table.parse("a.csv", PLAIN)
    assert found.argument.tolist() == plain.argument.tolist() == [0.0, 0.01, 0.02]
    assert found.value.tolist() == plain.value.tolist() == [0.0015, 0.00225, -0.003]


WIDE = "t [s];x [mm];u(x) [mm];force [mN]\n0;1,5;0,1;7\n1;;0,1;8\n2;3;0,1;9\n"


@pytest.mark.parametrize("column", ["x", "x [mm]"])
def test_a_column_of_several(column: str) -> None:
    """Assert that a column is found by its name or header, with its uncertainties; lines with gaps are left out."""
    table = Table.parse("a.csv", WIDE, column, "skip")
    assert table.value.tolist() == [0.0015, 0.003]
    assert table.uncertainty is not None
    assert table.uncertainty.tolist() == [1e-4, 1e-4]
    assert Table.parse("a.csv", WIDE, "force").value.tolist() == [0.007, 0.008, 0.009]


@pytest.mark.parametrize(
    ("text", "given", "said"),
    [
        (
            WIDE,
            {},
            r"has 2 columns of values: say which with column = \"x\"; it is separated by semicolons, columns 't \[s\]', 'x \[mm\]'",
        ),
        (WIDE, {"column": "y"}, "has no column 'y' of values; it is separated by semicolons"),
        (WIDE, {"column": "t"}, "has no column 't' of values"),
        (
            WIDE,
            {"column": "x"},
            r"line 3: column 'x \[mm\]' has a gap; fill it, or leave such lines out with gaps = \"skip\"",
        ),
        ("t [s];x [m]\n0;1,5\n1;2.5\n", {}, r"has decimal commas \(line 2\) and points \(line 3\); write one of them"),
        ("t [s] x [m]\n0 1\n1 2\n", {}, "separated by commas, columns 't .s. x .m.'"),
        ("t [s],x [m],x [mm]\n0,1,1\n", {"column": "x"}, "two columns are called 'x'"),
        ("t [s],x [wibble]\n0,1\n", {}, "column 'x .wibble.': unit 'wibble'"),
        ("t [s],x [m]\n0,1,5\n1,2,5\n", {}, "line 2, '0' …, has 3 cells, the header 2"),
        ("t [s],x [m]\n0,1\n1,nan\n", {}, "line 3: column 'x .m.' has a gap"),
        ("t [s];x [m]\n0;1.00,5\n1;2\n", {}, "line 2: '1.00,5' is no number"),
        ("# nothing\n", {}, "is empty; it needs a header"),
        ("t [s],x [m]\n1,0\n1,2\n0,3\n", {}, "line 3: argument 1.0 does not increase after 1.0"),
    ],
)
def test_what_is_wrong_is_named(text: str, given: dict[str, str], said: str) -> None:
    """Assert that a fault tells separator, columns, line and remedy."""
    with pytest.raises(xd.InputError, match=said):
        Table.parse("a.csv", text, **given)


@pytest.mark.parametrize(
    ("cell", "name", "unit"),
    [
        ("F [N]", "F", "N"),
        ("u(F) (N)", "u(F)", "N"),
        ("u(F)/N", "u(F)", "N"),
        ("v/(m s-1)", "v", "m s-1"),
        ("n []", "n", "1"),
        ("v [m/s]", "v", "m s-1"),
    ],
)
def test_titles(cell: str, name: str, unit: str) -> None:
    """Assert names and units of headers as laboratories write them."""
    found = title(cell)
    assert found.name == name
    assert (
        found.unit.dimension
        == xd.Model(
            name="x", parameters={"p": f"1 {unit}"}, states={"s": {"unit": "1", "rate": "1/second"}}, initial={"s": 0}
        )
        .parameters["p"]
        .quantity.unit.dimension
    )


def tabled(given: Any) -> Table:
    """The table of a drive that is given in Python."""
    model = xd.Model(
        name="x", states={"q": {"unit": "N s", "rate": "pull"}}, drives={"pull": given}, initial={"q": "0 N s"}
    )
    assert xd.Model.from_text(model.to_toml()) == model
    return model.drives["pull"].table


def test_tables_of_python() -> None:
    """Assert DataFrames, DataArrays and arrays by their headers, to the bit, in their own units."""
    times, values = np.array([0.0, 0.1, 1 / 3]), np.array([1.0, 2 / 3, 5e-324])
    array = xr.DataArray(values, dims="t", coords={"t": ("t", times, {"units": "s"})}, attrs={"units": "N"})
    for given in (
        pd.DataFrame({"t [s]": times, "pull [N]": values}),
        pd.DataFrame({"pull [N]": values}, index=pd.Index(times, name="t [s]")),
        array,
        {"t [s]": times, "pull [N]": values},
        {"table": {"t [s]": times, "pull [N]": values}, "interpolation": "cubic"},
        {"table": array, "outside": "hold"},
    ):
        found = tabled(given)
        assert (found.argument.tolist(), found.value.tolist()) == (times.tolist(), values.tolist())
        assert found.name == "pull.csv"


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (5, "needs the name of a CSV file, a DataFrame, a DataArray, or arrays by their headers"),
        ({"t": [0.0], "pull [N]": [1.0]}, "column 't': it has no unit"),
        ({"t [s]": [0.0, 1.0], "pull [N]": [1.0]}, "rows"),
        ({"t [s]": ["a"], "pull [N]": [1.0]}, "hold something else than numbers"),
        (xr.DataArray([1.0, 2.0], dims="t"), "no coordinate along 't'"),
        (xr.DataArray([1.0, 2.0], dims="t", coords={"t": [0.0, 1.0]}), "coordinate 't' has no units"),
        (xr.DataArray(np.ones((2, 2)), dims=("t", "x")), "needs one, along which"),
        ({"table": "a.csv", "csv": PLAIN, "gaps": "fill"}, "gaps 'fill' is not known; there are refuse, skip"),
    ],
)
def test_tables_that_are_none(given: Any, said: str) -> None:
    """Assert that what is no table is refused with what was needed."""
    with pytest.raises(xd.ModelError, match=said):
        tabled(given)


def test_an_unfriendly_bench_record(tmp_path: Path) -> None:
    """Assert residuals against a German spreadsheet's file in UTF-16."""
    model = xd.Model.from_toml(Path(__file__).parents[2] / "data/models/harmonic_oscillator.toml")
    run = xd.simulate(model, method="dop853", rtol=1e-10, until="2 s")
    times = np.linspace(0.1, 1.9, 7)
    rows = "\r\n".join(
        f"{1e3 * t:.3f};{1e3 * x:.6f}".replace(".", ",") for t, x in zip(times, np.cos(2 * times), strict=True)
    )
    path = tmp_path / "bank.csv"
    path.write_bytes(f"Zeit;Weg\r\n{rows}\r\n".replace("Zeit;Weg", "Time/ms;x (mm)").encode("utf-16"))
    assert float(xd.compare(run, path)["rms_difference_x"]) < 1e-8


def test_columns_are_written_whole() -> None:
    """Assert that what is written is read to the same numbers."""
    text = csv_text({"t [s]": [0.1, 1 / 3], "x [m]": [1e-300, -7.0]})
    assert [row for _, row in Sheet.from_text("a", text).read_rows([0, 1])] == [(0.1, 1e-300), (1 / 3, -7.0)]


def test_columns_that_nobody_asked_for_are_left_out(tmp_path: Path) -> None:
    """Assert that foreign columns, with units or without, are passed over and named, and gaps are skipped on demand."""
    model = xd.Model.from_toml(Path(__file__).parents[2] / "data/models/harmonic_oscillator.toml")
    run = xd.simulate(model, method="dop853", rtol=1e-10, until="2 s")
    path = tmp_path / "bench.csv"
    rows = "".join(f"{t};{float(np.cos(2 * t))!r};0.01;21,5;ok\n".replace(".", ",") for t in (0.5, 1.0, 1.5))
    path.write_text("time [s];x [m];u(x) [m];temp (degC);note\n" + rows + "1,8;;0,01;21,5;gap\n")
    with pytest.raises(xd.InputError, match="line 5: column 'x .m.' has a gap"):
        xd.compare(run, path)
    found = xd.compare(run, path, gaps="skip")
    assert found.attrs["data_left_out"] == "temp (degC), note"
    assert found.sizes["at"] == 3
    assert float(found["rms_difference_x"]) < 1e-8
    fitted = xd.fit(model, path, ["k"], gaps="skip", method="dop853", rtol=1e-9, until="2 s")
    assert float(fitted.estimate[0]) == pytest.approx(4.0, rel=1e-6)
    frame = pd.DataFrame({"time [s]": [0.5, 1.0], "x [m]": [np.cos(1.0), np.nan], "note": ["a", "b"]})
    assert xd.compare(run, frame, gaps="skip").sizes["at"] == 1
    with pytest.raises(xd.InputError, match="column .q .m.. is no quantity of the model, which has x, v_x"):
        xd.compare(run, pd.DataFrame({"time [s]": [0.5], "q [m]": [1.0]}))
    with pytest.raises(xd.InputError, match="gaps is 'fill'; there are refuse, skip"):
        xd.compare(run, path, gaps="fill")


def test_titles_that_are_cut_need_quotes() -> None:
    """Assert that an element of two dimensions is one title in quotes, and that without them its table says so."""
    assert Sheet.from_text("t.csv", 't [s],"r[Sun, x] [m]"\n0,1\n').header == ("t [s]", "r[Sun, x] [m]")
    cut = Sheet.from_text("t.csv", "t [s],r[Sun, x] [m]\n0,1\n").layout_text
    assert cut == "separated by commas, columns 't [s]', 'r[Sun', 'x] [m]'; titles with commas stand in quotes"
    assert "quotes" not in Sheet.from_text("t.csv", "t [s];r[Sun, x] [m]\n0;1\n").layout_text


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


def table(n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Uneven points, with plateaus and turns."""
    random = np.random.default_rng(seed)
    x = np.cumsum(10.0 ** random.uniform(-2, 1, n))
    return x, np.where(random.random(n) < 0.2, 1.0, random.standard_normal(n))


@pytest.mark.parametrize("n", [2, 3, 4, 5, 17, 400])
@pytest.mark.parametrize("seed", range(5))
def test_monotone_pieces_are_scipy_s(n: int, seed: int) -> None:
    """Assert equal bits, so that archives made with SciPy's cubics are reproduced."""
    x, y = table(n, seed)
    assert (
        hermite_pieces(x, y, monotone_slopes(x, y)).tobytes()
        == np.ascontiguousarray(PchipInterpolator(x, y).c).tobytes()
    )


@pytest.mark.parametrize("n", [2, 3, 4, 5, 17, 400])
@pytest.mark.parametrize("seed", range(5))
def test_spline_pieces_are_scipy_s_but_for_rounding(n: int, seed: int) -> None:
    """Assert SciPy's values, whose own last bits hang on the linear algebra that it was built with."""
    x, y = table(n, seed)
    h, known = np.diff(x), CubicSpline(x, y)
    cubic, square, slope, value = hermite_pieces(x, y, spline_slopes(x, y))
    for part in (0.25, 0.5, 0.75):
        u = part * h
        found, true = ((cubic * u + square) * u + slope) * u + value, known(x[:-1] + u)
        assert np.all(np.abs(found - true) <= 1e-11 * np.abs(true).max())


def test_splines_of_cubics_are_those_cubics() -> None:
    """Assert that not-a-knot ends lose nothing of a cubic polynomial."""
    x = np.array([0.0, 0.5, 0.75, 2.0, 2.5, 4.0])
    cubic = np.polynomial.Polynomial([1.0, -2.0, 0.5, 0.25])
    assert spline_slopes(x, cubic(x)) == pytest.approx(cubic.deriv()(x), rel=1e-13, abs=1e-13)


def test_monotone_data_stay_monotone() -> None:
    """Assert no overshoot between rising points, and level pieces between equal ones."""
    x, y = np.array([0.0, 1.0, 1.1, 3.0, 4.0]), np.array([0.0, 0.0, 5.0, 5.1, 5.1])
    cubic, square, slope, value = hermite_pieces(x, y, monotone_slopes(x, y))
    for k in range(4):
        u = np.linspace(0.0, x[k + 1] - x[k], 50)
        along = ((cubic[k] * u + square[k]) * u + slope[k]) * u + value[k]
        assert np.all(np.diff(along) >= -1e-15)


@pytest.mark.parametrize("rule", ["linear", "pchip", "cubic"])
@pytest.mark.parametrize(
    ("rows", "where"),
    [
        ("0,0\n1,-1e308\n1.5,1e308\n2,0\n3,0\n", "goes from -1e+308 at 1 to 1e+308 at 1.5"),
        ("0,0\n1e-320,1\n1,2\n2,3\n", "goes from 0 at 0 to 1 at 9.99988867182683e-321"),
    ],
)
def test_a_slope_that_overflows_is_named(rule: str, rows: str, where: str) -> None:
    """Assert that the points between which no number holds the slope are told, before anything is marched."""
    pull = {"table": "f.csv", "csv": "time [s],pull [N]\n" + rows, "interpolation": rule}
    model = xd.Model(
        name="pulled",
        coordinates={"x": {"unit": "m"}},
        parameters={"m": "1 kg"},
        mass={"x": "m"},
        forces={"pull": {"x": "pull"}},
        drives={"pull": pull},
        initial={"x": "0 m", "v_x": "0 m s-1"},
    )
    with pytest.raises(xd.ModelError, match=re.escape(f"drive 'pull': table 'f.csv' {where}")) as caught:
        xd.simulate(model, method="velocity_verlet", step=0.25, until=2.0)
    assert f"the slopes of interpolation '{rule}' overflow" in str(caught.value)

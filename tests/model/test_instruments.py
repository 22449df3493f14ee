"""Files of instruments, as they come: each is read, by a drive and as measured data, and what cannot be read says how."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import xdynamics as xd
from cases.command_line import call
from cases.problems import MODELS
from xdynamics.evidence.comparing.measured import read_measured_data
from xdynamics.model import Table
from xdynamics.model.instruments import KEYS, Reading, as_table
from xdynamics.shapes import Extent, Shapes
from xdynamics.units import parse_quantity, parse_scale, parse_unit

FILES = Path(__file__).parents[1] / "cases" / "instruments"
TRACKED = {"units": {"t": "s", "x": "m", "y": "m"}}


def table(name: str, column: str = "", **keys: Any) -> Table:
    """Return a column of a file."""
    text = (FILES / name).read_text()
    return Table.parse(name, as_table(name, text, Reading.from_keys(keys)), column)


@pytest.mark.parametrize(
    ("name", "column", "unit", "times", "values"),
    [
        ("phyphox.csv", "Acceleration x", "m s-2", [0, 0.1, 0.2], [1, 0.9950041653, 0.9800665778]),
        ("vernier.csv", "Position", "m", [0, 0.1, 0.2], [1, 0.9950041653, 0.9800665778]),
        ("logger_pro.csv", "Temperature", "K", [0, 1, 2], [293.15, 294.65, 295.15]),
        (
            "tektronix_tds.csv",
            "",
            "V",
            np.arange(-1, 11) / 10,
            [1, 0.995, 0.98007, 0.95534, 0.92106, 0.87758, 0.82534, 0.76484, 0.69671, 0.62161, 0.5403, 0.4536],
        ),
        ("tektronix_mdo.csv", "CH2", "A", [-1e-6, 0, 1e-6], [1.5, 1.6, 1.7]),
        ("siglent.csv", "CH3", "V", [-1e-7, 0, 1e-7], [0.04000008, 0.05000008, 0.06000008]),
        ("siglent_two.csv", "CH2", "V", [-7e-5, -6e-5, -5e-5], [1.2, 1.3, 1.4]),
        ("rigol_ds1000z.csv", "CH2", "V", [-1e-5, -9.9e-6, -9.8e-6], [3, 3.1, 3.2]),
        ("rigol_ds1000e.csv", "CH1", "V", [-1e-3, 0, 1e-3], [0.5, 0.6, 0.7]),
        ("rigol_dho.csv", "", "V", [-2, -1.999998, -1.999996], [-5.573333e-4, -9.866666e-5, -2.346667e-4]),
        ("picoscope.csv", "", "mV", [0, 1e-4, 2e-4], [1.5e-3, 1.6e-3, 1.7e-3]),
        ("motor.eng", "", "N", [0, 0.031, 0.2, 1.8, 1.86], [0, 0.946, 14.09, 4, 0]),
    ],
)
def test_files_are_read_as_they_come(name: str, column: str, unit: str, times: Any, values: Any) -> None:
    """Assert times, values and units of each kind, to the bit, without a word on how."""
    found = table(name, column)
    assert found.value_unit.text == unit
    assert found.argument.tolist() == [*map(float, times)]
    assert found.value.tolist() == [*map(float, values)]


@pytest.mark.parametrize(
    ("name", "column"), [("tektronix_tds.csv", ""), ("tektronix_mdo.csv", "CH2"), ("siglent.csv", "CH3")]
)
def test_seconds_of_an_oscilloscope_may_be_a_capital_letter(name: str, column: str) -> None:
    """Assert that a record whose times are in ``S`` is that of one in ``s``: none is against siemens."""
    text = (FILES / name).read_text()
    assert "Horizontal Units,s" in text
    capital = Table.parse(name, as_table(name, text.replace("Horizontal Units,s", "Horizontal Units,S")), column)
    assert capital.argument_unit.text == "s"
    assert capital.argument.tolist() == table(name, column).argument.tolist()


def test_an_offset_is_no_part_of_an_uncertainty() -> None:
    """Assert that 273.15 is added to values in °C and not to their uncertainties, in tables, parameters and differences."""
    found = table("logger_pro.csv", "Temperature")
    assert found.uncertainty is not None
    assert found.uncertainty.tolist() == [0.5, 0.5, 0.5]
    model = xd.Model(
        name="a",
        coordinates={},
        parameters={"T": "20 ± 0.5 °C", "U": {"value": 20, "unit": "°C", "uncertainty": "0.5 °C"}},
        states={"q": {"unit": "K", "rate": "-q/(1*second)"}},
        initial={"q": "68 °F"},
    )
    for name in ("T", "U"):
        assert (str(model.parameters[name].quantity), model.parameters[name].uncertainty) == ("293.15 K", 0.5)
    assert model.initial["q"].si == 293.15
    assert (parse_scale("W/(m² °C)").unit.text, parse_unit("J/(kg·°C)").text) == ("W m-2 K-1", "J kg-1 K-1")
    with pytest.raises(
        xd.InputError, match=r"unit '°C' is for values alone, like '20 °C': they are kept in K; write 'K'"
    ):
        parse_unit("°C")


@pytest.mark.parametrize(
    ("written", "text"),
    [
        ("m/s²", "m s-2"),
        ("m·s⁻²", "m s-2"),
        ("m/s^2", "m s-2"),
        ("µm", "um"),
        ("μm", "um"),
        ("°/s", "degree s-1"),
        ("cm³", "cm3"),
        ("kΩ", "kohm"),
        ("%", "percent"),
        ("N⋅m", "N m"),
        ("year", "Julian_year"),
    ],
)
def test_units_as_they_are_spelled(written: str, text: str) -> None:
    """Assert signs that keyboards lack, and Julian years and months."""
    assert parse_unit(written).text == text
    assert (parse_quantity("12 year").si, parse_quantity("1 month").si) == (12 * 365.25 * 86400, 365.25 * 7200)


def test_tracked_positions_need_their_units() -> None:
    """Assert Tracker's export with the units that it lacks, counted from its first frame; and without, the remedy."""
    found = table("tracker.txt", "x", **TRACKED, time_zero="first")
    assert found.argument.tolist() == [0.0, 0.1, 0.2]
    assert found.value.tolist() == [1.0, 0.9950041653, 0.9800665778]
    titles = ["t [ms]", "far [mm]", "high [mm]"]
    assert table("tracker.txt", "high", header=titles, skip=1).value.tolist() == [0.0428, 0.0427, 0.0426]
    with pytest.raises(
        xd.InputError,
        match=r"column 't': it has no unit(.|\n)*it begins 't,x,y' / '1.00E-1,1.00E0,4.28E1'(.|\n)*units = \{ t = \"s\", x = \"m\" \}",
    ):
        table("tracker.txt", "x")


def test_an_empty_file_is_said_to_be_empty(tmp_path: Path) -> None:
    """Assert no remedy for what cannot be read in any way."""
    (tmp_path / "none.csv").write_text("\n")
    with pytest.raises(xd.InputError, match=r"table 'none.csv' is empty$"):
        xd.fit(xd.Model.from_toml(MODELS / "harmonic_oscillator.toml"), tmp_path / "none.csv", ["k"])


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"skip": -1}, "skip is -1, needs the number of lines"),
        ({"skip": 99}, "has no lines after the first 99, which skip leaves out"),
        ({"header": 3}, "header is 3, needs titles with units"),
        ({"header": ["t [s]"]}, "has 3 numbers in a line, '1.00E-1' '1.00E0' '4.28E1', and header has 1 titles"),
        ({"units": "s"}, "units is 's', needs a table of units by column"),
        ({"units": {"t": "wibble"}}, "units: column 't': unit 'wibble' is not known"),
        ({"units": {"z": "m"}}, "has no column 'z', which units names; there are 't', 'x', 'y'"),
        ({**TRACKED, "time_zero": "1 m"}, "time_zero is '1 m', and column 't .s.' is in 's'"),
        ({"decimal": ";"}, "decimal is ';', needs"),
        (
            {"rows": 3},
            "'rows' does not say how a file is read; there are skip, header, units, argument_column, duplicates",
        ),
    ],
)
def test_wrong_keys_are_named(keys: dict[str, Any], said: str) -> None:
    """Assert that each key says what it needs."""
    with pytest.raises(xd.InputError, match=said):
        table("tracker.txt", "x", **keys)


def test_a_quoted_decimal_comma() -> None:
    """Assert commas as marks and as separators of quoted cells, which only the key can tell."""
    text = 't [s],x [m]\n"0,5","1,2"\n"0,6","1,3"\n'
    assert Table.parse("a", as_table("a", text, Reading.from_keys({"decimal": ","}))).value.tolist() == [1.2, 1.3]


def test_two_motors_in_a_file_are_refused() -> None:
    """Assert that which motor is meant is not guessed."""
    text = (FILES / "motor.eng").read_text()
    with pytest.raises(xd.InputError, match="holds several motors, C6 and D7; keep the lines of one"):
        as_table("motor.eng", text + text.replace("C6", "D7"))


@pytest.mark.parametrize(("last", "fine"), [("   1.860 0.000\n", True), ("", False), ("   1.860 -0.5\n", False)])
def test_the_thrust_of_a_motor_ends_at_zero(last: str, fine: bool) -> None:
    """Assert that a record of thrust which is cut off is refused, with the line that would end it."""
    text = (FILES / "motor.eng").read_text()
    cut = text.replace("   1.860 0.000\n", last)
    if fine:
        assert Table.parse("a", as_table("motor.eng", cut)).value.tolist()[-1] == 0.0
        return
    with pytest.raises(
        xd.InputError, match=r"ends with a thrust of .* N at 1.8.* s, where RASP has 0 N .* like '1.8[17] 0'"
    ):
        as_table("motor.eng", cut)


def fallen(tmp_path: Path, file: str, keys: str = "", **also: Any) -> xd.Model:
    """A mass that a measured force pulls, from a file beside the model."""
    text = (FILES / file).read_bytes() if (FILES / file).exists() else also["content"]
    (tmp_path / file).write_bytes(text)
    (tmp_path / "model.toml").write_text(
        'name = "pulled"\n[coordinates]\nx = "m"\n[mass]\nx = "1*kilogram"\n[forces.pull]\nx = "pull"\n'
        f'[drives.pull]\ntable = "{file}"\noutside = "zero"\n{keys}\n[run]\nmethod = "rk4"\nstep = "1 ms"\nuntil = "1 s"\n[initial]\nx = "0 m"\n'
    )
    return xd.Model.from_toml(tmp_path / "model.toml")


def test_a_motor_drives_a_model_and_its_archive(tmp_path: Path) -> None:
    """Assert the impulse of a motor to the trapezes of its table, and a model and archive that need the file no more."""
    model = fallen(tmp_path, "motor.eng")
    run = xd.simulate(model, until="2 s", step="1 ms")
    drive = model.drives["pull"].table
    assert float(run.v_x[-1]) == pytest.approx(float(np.trapezoid(drive.value, drive.argument)), rel=1e-12)
    (tmp_path / "motor.eng").unlink()
    again = xd.Model.from_text(model.to_toml())
    assert again.digest == model.digest
    assert "# motor.eng, thrust of the motor C6 by E, as RASP has it" in model.to_toml()
    xd.save(run, tmp_path / "run.nc")
    assert xd.reproduce(tmp_path / "run.nc").attrs["identical"] == 1


def test_keys_are_kept_as_what_was_read(tmp_path: Path) -> None:
    """Assert that a model with keys is written as the table that they gave, and read again as the same."""
    model = fallen(tmp_path, "tracker.txt", 'column = "y"\nunits = { t = "s", y = "N" }\ntime_zero = "first"')
    assert model.drives["pull"].table.value.tolist() == [42.8, 42.7, 42.6]
    assert not any(f"\n{key} =" in model.to_toml() for key in KEYS)
    assert xd.Model.from_text(model.to_toml()).digest == model.digest


def test_a_workbook_is_a_table(tmp_path: Path) -> None:
    """Assert that the first sheet with numbers is read as a file of its cells is, and one that is none refused."""
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.create_sheet("Raw Data")
    for row in (["Time (s)", "pull (N)", "remark"], [0.0, 1.5, "a"], [0.1, 2.5, None], [0.2, 3.5, "b"]):
        book["Raw Data"].append(row)
    book.save(tmp_path / "made.xlsx")
    content = (tmp_path / "made.xlsx").read_bytes()
    assert fallen(tmp_path, "book.xlsx", 'column = "pull"', content=content).drives["pull"].table.value.tolist() == [
        1.5,
        2.5,
        3.5,
    ]
    with pytest.raises(xd.ModelError, match="cannot be read: it is no workbook of Excel"):
        fallen(tmp_path, "book.xlsx", content=b"PK no book")


def test_arrays_of_xarray_are_tables() -> None:
    """Assert DataArrays and Datasets as drives, dates as seconds from the first, and what is refused in words."""
    stamps = np.datetime64("2024-05-01T10:00") + np.arange(3) * np.timedelta64(100, "ms")
    pull = xr.DataArray([1.0, 2.0, 3.0], {"time": stamps}, name="pull", attrs={"units": "N"})

    def driven(made: Any) -> Table:
        return (
            xd.Model(
                name="a",
                coordinates={"x": "m"},
                mass={"x": "1*kilogram"},
                forces={"f": {"x": "pull"}},
                drives={"pull": made if isinstance(made, dict) else {"table": made}},
                initial={"x": "0 m"},
            )
            .drives["pull"]
            .table
        )

    assert driven(pull).argument.tolist() == [0.0, 0.1, 0.2]
    data = xr.Dataset({"pull": pull, "u_pull": (pull * 0.1).assign_attrs(units="N"), "light": pull.drop_attrs()})
    found = driven(data)
    assert (found.value.tolist(), found.uncertainty is None) == ([1.0, 2.0, 3.0], False)
    with pytest.raises(xd.InputError, match="the Dataset has 0 variables with units along 0 dimensions"):
        driven(data.drop_attrs())
    with pytest.raises(xd.InputError, match="has no coordinate along 'time'"):
        driven(pull.drop_vars("time"))


@pytest.fixture(scope="module")
def swing(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A cosine, as an archive with its model."""
    folder = tmp_path_factory.mktemp("swing")
    text = 'name = "swing"\n[coordinates]\nx = "m"\n[mass]\nx = "1*kilogram"\n[parameters]\nk = "0.9 N m-1"\n[forces.spring]\nx = "-k*x"\n[initial]\nx = "1 m"\n[run]\nmethod = "dop853"\nrtol = 1e-10\nuntil = "1 s"\n'
    (folder / "swing.toml").write_text(text)
    xd.save(xd.simulate(xd.Model.from_toml(folder / "swing.toml").replace(parameters={"k": 1.0})), folder / "run.nc")
    return folder / "swing.toml", folder / "run.nc"


@pytest.mark.dear
def test_a_run_beside_files(swing: tuple[Path, Path], tmp_path: Path) -> None:
    """Assert `compare` and `fit` on the command line with what a lab has: Tracker, Vernier, a workbook's neighbour, netCDF."""
    model, run = map(str, swing)
    tracked = [str(FILES / "tracker.txt"), "--units", "t=s", "--units", "x=m", "--time-zero", "0.1 s"]
    done = call("compare", run, *tracked)
    assert done.exit_code == 0, done.output
    done = call("fit", model, *tracked, "--parameter", "k")
    assert "k" in done.output
    assert "is no quantity of the model" in call("compare", run, str(FILES / "vernier.csv")).output
    assert call("compare", run, str(FILES / "tracker.txt")).exit_code == 2
    said = call("compare", run, str(FILES / "tracker.txt")).output
    assert "the file begins 'mass_A' / 't\\tx\\ty'" in said
    assert "--units x=m" in said
    times = np.datetime64("2024-05-01") + np.arange(3) * np.timedelta64(100, "ms")
    cosine = xr.Dataset(
        {"x": ("time", np.cos([0, 0.1, 0.2]), {"units": "m"}), "humidity": ("time", [1.0, 2, 3])}, {"time": times}
    )
    cosine.to_netcdf(tmp_path / "measured.nc")
    done = call("compare", run, tmp_path / "measured.nc")
    assert done.exit_code == 0, done.output
    found = xd.compare(xd.open_run(run), cosine)
    assert float(abs(found.difference_x).max()) < 1e-9
    assert "its time from 2024-05-01" in found.attrs["data"]
    assert float(abs(xd.compare(xd.open_run(run), cosine.x).difference_x).max()) < 1e-9


@pytest.mark.parametrize("header", ["t [s],x [m],u(x) (mm)", "t (s),x (m),u(x) (mm)", "t/s,x/m,u(x)/mm"])
def test_uncertainties_in_every_spelling(header: str, swing: tuple[Path, Path], tmp_path: Path) -> None:
    """Assert that an uncertainty is found with its unit in brackets, parentheses or below a stroke."""
    (tmp_path / "x.csv").write_text(f"{header}\n0,1,2\n0.1,0.995,2\n")
    found = xd.compare(xd.open_run(swing[1]), tmp_path / "x.csv")
    assert found.measured_uncertainty_x.values.tolist() == [0.002, 0.002]


def test_data_with_names_of_their_own_are_compared(tmp_path: Path) -> None:
    """Assert that a column and its uncertainty are called as the model calls them, with their units, and what is refused."""
    path = tmp_path / "vernier.csv"
    path.write_text(
        "Latest: Time (s),Latest: Position (mm),Latest: u(Position) (mm),Latest: Note\n0,100,1,a\n1,90,2,b\n"
    )
    known = ["x", "v_x"]
    data = read_measured_data(path, known, reading={"columns": {"x": "Position"}})
    assert (data.values["x"][0].tolist(), data.values["x"][1].text) == ([100.0, 90.0], "mm")
    assert data.uncertainties["x"][0].tolist() == [1.0, 2.0]
    assert data.left_out == ("Note",)
    with pytest.raises(xd.InputError, match="has no column 'Place', which columns names; there are 'Time', 'Position'"):
        read_measured_data(path, known, reading={"columns": {"x": "Place"}})
    with pytest.raises(xd.InputError, match="needs names of the file by those of the model"):
        read_measured_data(path, known, reading={"columns": ["x"]})
    (tmp_path / "tracker.csv").write_text("#multi:\nt,x,\n0,1.0,\n0.5,2.0,\n")
    tracked = read_measured_data(tmp_path / "tracker.csv", known, reading={"units": {"t": "s", "x": "m"}})
    assert tracked.values["x"][0].tolist() == [1.0, 2.0]


def test_tables_of_pandas_with_dates_and_series_are_read() -> None:
    """Assert one motion from a DataFrame with dates, a Series and a mapping, as data and as a drive; and a zero of time."""
    stamps = pd.date_range("2024-05-01 12:00", periods=3, freq="500ms", name="time")
    numbers = [1.0, 3.0, 2.0]
    tables: list[Any] = [
        pd.DataFrame({"x [m]": numbers}, index=stamps),
        pd.Series(numbers, index=pd.Index([0.0, 0.5, 1.0], name="time [s]"), name="x [m]"),
        {"time [s]": [0.0, 0.5, 1.0], "x [m]": numbers},
    ]
    model = {"coordinates": {"q": "m"}, "mass": {"q": "1*kilogram"}, "initial": {"q": "0 m"}}
    for table in tables:
        data = read_measured_data(table, ["x"])
        assert (data.times.tolist(), data.values["x"][0].tolist()) == ([0.0, 0.5, 1.0], numbers)
        driven = xd.Model(
            name="driven", **model, forces={"pull": {"q": "x*newton/metre"}}, drives={"x": {"table": table}}
        )
        run = xd.simulate(driven, method="rk4", step="0.25 s", until="1 s")
        assert run.force_pull_q.values[[0, 2, 4]].tolist() == numbers
    later = read_measured_data({"t [s]": [4.0, 5.0], "x [m]": [1.0, 2.0]}, ["x"], reading={"time_zero": "first"})
    assert later.times.tolist() == [0.0, 1.0]


@pytest.mark.parametrize("coordinates", [{}, {"body": ["Sun", "Moon"]}, {"body": ["Moon", "Sun"]}])
def test_elements_of_a_dataset_are_labelled_or_in_order(coordinates: dict[str, list[str]]) -> None:
    """Assert that a variable without labels has them in the model's order, and one with labels by these."""
    shapes = Shapes({"body": Extent("body", 2, ("Sun", "Moon"))}, {}, {"r": ("body",)})
    order = [coordinates.get("body", ["Sun", "Moon"]).index(label) for label in ("Sun", "Moon")]
    numbers = np.array([[1.0, 3.0], [2.0, 4.0], [5.0, 6.0]])[:, order]
    data = xr.Dataset(
        {"r": (("at", "body"), numbers, {"units": "m"}), "time": ("at", [0.0, 1.0, 2.0], {"units": "s"})}, coordinates
    )
    found = read_measured_data(data, ["r·Sun", "r·Moon"], shapes=shapes)
    assert [found.values[name][0].tolist() for name in ("r·Sun", "r·Moon")] == [[1.0, 2.0, 5.0], [3.0, 4.0, 6.0]]


def test_a_row_far_below_is_read(tmp_path: Path) -> None:
    """Assert that a row behind very many empty ones counts, as does the number of rows, and a wide sheet is refused."""
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for row, cells in {1: ["Time (s)", "pull (N)"], 2: [0.0, 1.5], 200_100: [0.2, 3.5]}.items():
        for column, cell in enumerate(cells, start=1):
            book.active.cell(row, column, cell)
    book.save(tmp_path / "far.xlsx")
    model = fallen(tmp_path, "far.xlsx", 'column = "pull"', content=(tmp_path / "far.xlsx").read_bytes())
    assert model.drives["pull"].table.value.tolist() == [1.5, 3.5]
    book.active.cell(2, 300, 1.0)
    book.save(tmp_path / "wide.xlsx")
    with pytest.raises(xd.ModelError, match=r"sheet 'Sheet' has 300 columns in row 2, 256 at most"):
        fallen(tmp_path, "wide.xlsx", content=(tmp_path / "wide.xlsx").read_bytes())


@pytest.mark.parametrize("titles", [("clock [s]", "T [K]"), ("T [K]", "time [s]"), ("T [K]", "t [s]")])
def test_a_temperature_is_no_time(titles: tuple[str, str]) -> None:
    """Assert that times are counted from their first, and temperatures called T are left as they are."""
    own = (
        ["3" if "K" not in title else "300" for title in titles],
        ["4" if "K" not in title else "301" for title in titles],
    )
    text = "\n".join([",".join(titles), *map(",".join, own)]) + "\n"
    clock = next(k for k, title in enumerate(titles) if "K" not in title)
    lines = as_table("room.csv", text, Reading(time_zero="first")).splitlines()[-2:]
    rows = [[float(cell) for cell in line.split(",")] for line in lines]
    assert [row[clock] for row in rows] == [0.0, 1.0]
    assert [row[1 - clock] for row in rows] == [300.0, 301.0]


def test_a_dataset_of_temperatures_is_compared() -> None:
    """Assert that a variable T(time) in kelvins is a quantity, and one in seconds may be the time."""
    data = xr.Dataset({"T": ("time", [300.0, 301.0], {"units": "K"})}, {"time": ("time", [0.0, 1.0], {"units": "s"})})
    found = read_measured_data(data, ["T"])
    assert found.times.tolist() == [0.0, 1.0]
    assert found.values["T"][0].tolist() == [300.0, 301.0]
    assert read_measured_data({"T [s]": [4.0, 5.0], "x [m]": [1.0, 2.0]}, ["x"]).times.tolist() == [4.0, 5.0]
    assert read_measured_data(
        {"T [K]": [4.0, 5.0], "t [s]": [1.0, 2.0], "x [m]": [1.0, 2.0]}, ["x"]
    ).times.tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("times", "said"),
    [
        ([0.0, 1.0, 0.5, 2.0], ", whose times run backwards after row 2"),
        ([3.0, 2.0, 1.0], ", whose times run backwards after row 1 and 1 times more"),
        ([0.0, 1.0, 1.0, 2.0], ""),
    ],
)
def test_times_that_run_backwards_are_told(times: list[float], said: str) -> None:
    """Assert what the name of data says of their order, which titles of fits and comparisons repeat."""
    assert read_measured_data({"t [s]": times, "x [m]": times}, ["x"]).name == f"the DataFrame{said}"

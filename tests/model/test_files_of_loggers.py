"""Tables as loggers and spreadsheets write them: dates, foot lines, gaps, counters, other marks and codes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from xdynamics.model.csv_sheet import Sheet

PLAIN = "time (s),pull (N)\n0,0\n0.5,5\n1.5,6\n"
TOA5 = """"TOA5","CR1000","log","7"
"TIMESTAMP","RECORD","Pull_Avg"
"TS","RN","N"
"","","Avg"
"2021-01-01 00:00:00",0,0
"2021-01-01 00:00:00.5",1,5
"2021-01-01 00:00:01.5",2,6
"""
SECONDS = [0.0, 0.5, 1.5]


def read(folder: Path, content: str | bytes, **keys: Any) -> Any:
    """Return the table of a drive whose file has a content."""
    (folder / "log.csv").write_bytes(content if isinstance(content, bytes) else content.encode())
    path = folder / "model.toml"
    written = "".join(f"{key} = {value}\n" for key, value in keys.items())
    path.write_text(
        'name = "log"\n[coordinates]\nx = "m"\n[mass]\nx = "kilogram"\n[initial]\nx = "0 m"\nv_x = "0 m/s"\n'
        f'[drives.pull]\ntable = "log.csv"\n{written}'
    )
    return xd.Model.from_toml(path).drives["pull"].table


@pytest.mark.parametrize(
    ("content", "keys"),
    [
        ("# t [s],F [N]\n0,0\n0.5,5\n1.5,6\n", {}),
        ("% made by hand\n% t [s],F [N]\n0,0\n0.5,5\n1.5,6\n", {}),
        (PLAIN.replace("\n", ",\n"), {}),
        (f"{PLAIN}End of file\n\n", {}),
        (f"{PLAIN}# saved by the logger\n", {}),
        ("t,pull (N)\n2021-03-28T01:59:59.5,0\n2021-03-28T02:00:00,5\n2021-03-28T02:00:01,6\n", {}),
        ("t,pull (N)\n2021-12-31 23:59:59.5Z,0\n2022-01-01 00:00:00Z,5\n2022-01-01T00:00:01+00:00,6\n", {}),
        ("t,pull (N)\n2021-06-01T12:00:00+02:00,0\n2021-06-01T10:00:00.5Z,5\n2021-06-01T06:00:01.5-0400,6\n", {}),
        ('"when","pull (N)"\n"2021-06-01 12:00:00",0\n"2021-06-01 12:00:00.5",5\n"2021-06-01 12:00:01.5",6\n', {}),
        ("t;pull (N)\n12:00:00,5;0\n12:00:01;5\n12:00:02;6\n", {}),
        ("3/25/2024 export of the logger\ntime (s),pull (N)\n0,0\n0.5,5\n1.5,6\n", {}),
        ("t,pull (N)\n23:59:59.5,0\n00:00:00,5\n00:00:01,6\n", {}),
        ("n,time (s),pull (N)\n7,0,0\n8,0.5,5\n9,1.5,6\n", {"argument_column": '"time"', "column": '"pull"'}),
        ("Date,Time,pull (N)\n2021-12-31,23:59:59.5,0\n2022-01-01,00:00:00,5\n2022-01-01,00:00:01,6\n", {}),
        ('Datum;Zeit;pull (N)\n"31.12.2021";"23:59:59,5";0\n"1.1.2022";"00:00:00";5\n"1.1.2022";"00:00:01";6\n', {}),
        ("when,pull (N)\n31.12.2021 23:59:59.5,0\n01.01.2022 00:00:00,5\n01.01.2022 00:00:01,6\n", {}),
        (",time (s),pull (N)\n0,0,0\n1,0.5,5\n2,1.5,6\n", {}),
        ("pull (N),time (s)\n0,0\n5,0.5\n6,1.5\n", {"argument_column": '"time (s)"'}),
        (f"{PLAIN}1.5,99\n", {"duplicates": '"first"'}),
        ("time (s),pull (N)\n0,0\n0.5,9\n0.5,5\n1.5,6\n", {"duplicates": '"last"'}),
        ("time (s),pull (N)\n0,0\n0.5,4\n0.5,6\n1.5,6\n", {"duplicates": '"mean"'}),
        ("time (s),pull (N)\n0,0\n0.25,OVER\n0.5,5\n0.75,---\n0.8,***\n0.9,#N/A\n1.5,6\n", {"gaps": '"skip"'}),
        ("Time (Seconds),Pull (Newtons)\n0,0\n0.5,5\n1.5,6\n", {}),
        ("Zeit (s);Kraft (mN)\n0;0\n0,5;5.000,0\n1,5;6.000,0\n", {}),
        (
            TOA5,
            {"column": '"Pull_Avg"'},
        ),
    ],
)
def test_what_loggers_write_is_read(tmp_path: Path, content: str, keys: dict[str, str]) -> None:
    """Assert the same three points from each, and that the model that is written is read as the same."""
    table = read(tmp_path, content, **keys)
    assert table.argument.tolist() == SECONDS
    assert table.value.tolist() == [0.0, 5.0, 6.0]
    model = xd.Model.from_toml(tmp_path / "model.toml")
    assert xd.Model.from_text(model.to_toml()).drives["pull"].table == table
    assert xd.Model.from_text(model.to_toml()) == model


def test_degrees_of_a_spreadsheet_are_read_and_said(tmp_path: Path) -> None:
    """Assert a table in Windows-1252, which says so; bytes that are no text are refused."""
    table = read(tmp_path, "time (s);angle (°)\n0;0\n0,5;180\n".encode("cp1252"))
    np.testing.assert_allclose(table.value, [0.0, np.pi], rtol=1e-15)
    assert table.text.endswith("# read as Windows-1252, as it is no UTF-8\n")
    with pytest.raises(xd.ModelError, match="it is no UTF-8 text"):
        read(tmp_path, b"\x89PNG\r\n\x1a\n\0\0\0")


def test_dates_say_what_they_are_counted_from(tmp_path: Path) -> None:
    """Assert the first date in the text of the table, which the record keeps, and a later origin."""
    content = "t,pull (N)\n2021-03-28T02:00:00,0\n2021-03-28T02:00:10,5\n"
    assert "time counted from 2021-03-28T02:00:00\n" in read(tmp_path, content).text
    assert read(tmp_path, content, time_zero='"4 s"').argument.tolist() == [-4.0, 6.0]


@pytest.mark.parametrize(
    ("content", "keys", "said"),
    [
        ("t,pull (N)\n2021-02-30 00:00,0\n2021-03-01 00:00,1\n", {}, "'2021-02-30 00:00' is none of the calendar"),
        ("t,F (N)\n2021-01-01 00:00,0\n2021-01-01 00:01Z,1\n", {}, "has a time zone, and '2021-01-01 00:00' none"),
        (
            "t,pull (N)\n3/25/2024 10:00:00,0\n3/25/2024 10:00:01,5\n",
            {},
            r"the time '3/25/2024 10:00:00' is not read: .* 2024-03-25",
        ),
        ("Date,Time,pull (N)\n3/25/2024,10:00:00,0\n3/25/2024,10:00:01,5\n", {}, "the time '3/25/2024' is not read"),
        ("t,pull (N)\n2:05:00 PM,0\n2:05:01 PM,5\n", {}, "the time '2:05:00 PM' is not read: .* clocks as 14:05:00"),
        (f"{PLAIN}1.5,7\n", {}, 'line 5: .*, of which duplicates = "first", "last" or "mean" takes one'),
        (PLAIN, {"duplicates": '"both"'}, "duplicates is 'both', needs 'first', 'last'"),
        (f"{PLAIN}1.5,7\n1.5,8\n", {"duplicates": '"jump"'}, "a jump is two lines"),
        ("time (s),pull (N)\n1,0\n1,4\n", {"duplicates": '"jump"'}, "2 or more of different arguments"),
        (PLAIN, {"argument_column": '"clock"'}, "has no column 'clock', which argument_column names; there are 'time"),
        ("n,time (s),F (N)\n1,0,0\n2,1,1\n", {}, 'another one: argument_column = "time"'),
        (
            "F (N),time (s)\n0,0\n1,1\n",
            {},
            "its argument 't' in 's'; where it is another column, say which: argument_col",
        ),
        ("time (s),pull (N)\n0,0\n1,*\n2,1\n", {}, "line 3: column 'pull .N.' has a gap"),
        ("time (s),pull (N)\n0,0\nwords here\n2,1\n", {}, "line 3, 'words here' …, has 1 cells, the header 2"),
        ("time (s);pull (N)\n0;0\n1;1.00,5\n", {}, "is no number"),
        ("time (s),pull (N)\n0,0\n,1\n,2\n3,3\n", {"duplicates": '"first"'}, "(?s)line 4: .*line 5: "),
    ],
)
def test_what_could_be_misread_is_refused(tmp_path: Path, content: str, keys: dict[str, str], said: str) -> None:
    """Assert one line each, with the line to write."""
    with pytest.raises(xd.ModelError, match=said):
        read(tmp_path, content, **keys)


def test_a_short_line_of_a_table_of_words_is_no_foot() -> None:
    """Assert that only below numbers words are passed over: a label without values is one that somebody forgot."""
    assert len(Sheet.from_text("planets", "name,mass [kg],radius [m]\nMars,1,2\nVenus\n").lines) == 2
    assert len(Sheet.from_text("log", "t [s],mass [kg],radius [m]\n0,1,2\nVenus\n").lines) == 1


def test_a_drive_of_texts_alone_is_no_table_from_python() -> None:
    """Assert that a key that is none is named, where a mapping of headers to arrays would be a table."""
    statement: dict[str, Any] = {
        "coordinates": {"x": "m"},
        "mass": {"x": "kilogram"},
        "initial": {"x": "0 m", "v_x": "0 m/s"},
    }
    with pytest.raises(xd.ModelError, match="key 'file' is not known; write table"):
        xd.Model(name="log", drives={"pull": {"file": "log.csv"}}, **statement)

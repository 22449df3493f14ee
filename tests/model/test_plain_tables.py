"""Large tables are read column by column, with the numbers and the messages of those that are read line by line."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest

from xdynamics.faults import InputError
from xdynamics.model.csv_sheet import PlainTable, Sheet
from xdynamics.model.drives import Table
from xdynamics.model.links import Links
from xdynamics.model.table_values import columns_by_element
from xdynamics.shapes import Extent
from xdynamics.units import parse_unit

ROWS = 3000
NUMBERS = np.random.default_rng(1).normal(size=ROWS) * 10.0 ** np.arange(-300, 300, 0.2)
CELL = Extent("cell", ROWS)
BODY = Extent("body", 3, ("Sun", "Jupiter", "Io"))


def table(change: Callable[[list[str]], None] = lambda _: None, header: str = "cell,T [°C],x [m]") -> str:
    """Return a table of three columns with a number for each cell, from the last to the first, and changes of its lines."""
    lines = [f"{ROWS - 1 - i}, {float(number)!r},{i}.5" for i, number in enumerate(NUMBERS)]
    change(lines)
    return "\n".join([header, *lines, ""])


def by_lines(text: str, monkeypatch: pytest.MonkeyPatch) -> Sheet:
    """Return a sheet that is read line by line."""
    with monkeypatch.context() as patch:
        patch.setattr(PlainTable, "from_text", lambda *_: None)
        return Sheet.from_text("t.csv", text)


def test_columns_have_the_numbers_of_their_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert the same numbers to the bit, in the order of the elements that a column names, and of a scale with an offset."""
    sheet, lines = Sheet.from_text("t.csv", table()), by_lines(table(), monkeypatch)
    assert isinstance(sheet.rows, PlainTable)
    assert not isinstance(lines.rows, PlainTable)
    found, units = columns_by_element(sheet, ["T", "x"], CELL)
    assert np.array_equal(found, columns_by_element(lines, ["T", "x"], CELL)[0])
    assert found[0].tolist() == [float(NUMBERS[-1]) + 273.15, ROWS - 0.5]
    assert [unit.text for unit in units] == ["K", "m"]
    assert sheet.lines[7] == (9, [str(ROWS - 8), f" {float(NUMBERS[7])!r}", "7.5"])


def changed(line: int, text: str) -> Callable[[list[str]], None]:
    """Return what puts another text in the place of a line."""
    return lambda lines: lines.__setitem__(line, text)


WRONG = {
    "a word": (changed(2000, "7,warm,1"), r"line 2002: 'warm' is no number"),
    "a gap": (changed(2000, "7,,1"), r"line 2002: column 'T \[°C\]' has a gap"),
    "infinite": (changed(2000, "7,inf,1"), r"line 2002: 'inf' is not finite"),
    "too large": (changed(2000, "7,1e999,1"), r"line 2002: '1e999' is not finite"),
    "an underscore": (changed(2000, "7,1_0,1"), r"line 2002: '1_0' is no number"),
    "a cell less": (changed(2000, "7,1.0"), r"line 2002, '7' …, has 2 cells, the header 3"),
    "a cell more": (changed(2000, "7,1.0,2,3"), r"line 2002, '7' …, has 4 cells, the header 3"),
    "more and less": (lambda lines: (changed(2000, "7,1,2,3")(lines), changed(2001, "7,1")(lines))[0], "has 4 cells"),
    "twice": (changed(2000, "2997,1.0,1"), r"line 2002: '2997' is there twice"),
    "unknown": (changed(2000, "3000,1.0,1"), r"line 2002: dimension 'cell' has no element 3000"),
    "a row too few": (lambda lines: lines.pop(), r"has no row for 0 of 'cell'"),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_wrong_cell_is_named_with_its_line(what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert the message of a table that is read line by line."""
    change, said = WRONG[what]
    texts = []
    for sheet in (lambda text: Sheet.from_text("t.csv", text), lambda text: by_lines(text, monkeypatch)):
        with pytest.raises(InputError, match=said) as caught:
            columns_by_element(sheet(table(change)), ["T"], CELL)
        texts.append(str(caught.value))
    assert texts[0] == texts[1]


def drive(change: Callable[[list[str]], None] = lambda _: None) -> str:
    """Return a table of a drive, with an uncertainty of each value, and changes of its lines."""
    lines = [f"{i}.1,{i / 7},{0.1 + i}" for i in range(ROWS)]
    change(lines)
    return "\n".join(["time [ms],T [°F],u(T) [K]", *lines, ""])


def test_drives_have_the_numbers_of_their_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert the same numbers to the bit, each rounded once from the decimal digits that are written."""
    lines = Table.from_sheet(by_lines(drive(), monkeypatch), drive())
    monkeypatch.delattr(Sheet, "read_rows")  # which reads line by line
    found = Table.parse("t.csv", drive())
    for name in ("argument", "value", "uncertainty"):
        assert getattr(found, name).tobytes() == getattr(lines, name).tobytes()
        assert getattr(found, name).flags.contiguous
    assert found.argument.tolist() == [float(f"{i}.1e-3") for i in range(ROWS)]
    assert found.uncertainty is not None
    assert found.uncertainty[5] == 5.1


def test_gaps_of_a_large_drive_are_left_out() -> None:
    """Assert that gaps = "skip" leaves out their lines alone."""
    found = Table.parse("t.csv", drive(changed(2000, "2000.1,,1")), gaps="skip")
    assert found.argument.size == ROWS - 1
    assert found.argument[1999:2001].tolist() == [1.9991, 2.0011]


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("1999.1,1,1", r"line 2002: argument 1999\.1 does not increase after 1999\.1"),
        ("2000.1,1,-1", r"line 2002: the uncertainty -1\.0 is negative"),
        ("2000.1,,1", r"line 2002: column 'T \[°F\]' has a gap"),
        ("2000.1,nan,1", r"line 2002: column 'T \[°F\]' has a gap"),
        ("2000.1,1e999,1", r"line 2002: '1e999' is not finite"),
    ],
)
def test_a_wrong_line_of_a_large_drive_is_named(line: str, said: str) -> None:
    """Assert that its number is told, though lines are not looked at one by one."""
    with pytest.raises(InputError, match=said):
        Table.parse("t.csv", drive(changed(2000, line)))


def test_numbers_too_large_for_si_are_named() -> None:
    """Assert the message of a single number, for the first of many."""
    with pytest.raises(InputError, match=r"^1e\+308 km is not finite in SI units$"):
        parse_unit("km").all_to_si(np.array([1.0, 1e308, 2e308 / 3]))


UNUSUAL = {
    "quotes": changed(5, '2994,"1.5",1'),
    "a comment": changed(5, "# nothing"),
    "an empty line": changed(5, ""),
    "spaces alone": changed(5, "  "),
}


@pytest.mark.parametrize("what", UNUSUAL)
def test_unusual_lines_are_read_one_by_one(what: str) -> None:
    """Assert that quotes, comments and empty lines are what they are in small tables."""
    sheet = Sheet.from_text("t.csv", table(UNUSUAL[what]))
    assert not isinstance(sheet.rows, PlainTable)
    assert len(sheet.lines) == ROWS - (what != "quotes")


@pytest.mark.parametrize("gap", ["", " "])
def test_empty_lines_of_a_single_column_are_left_out(gap: str) -> None:
    """Assert that they are no cells without a number."""
    sheet = Sheet.from_text("t.csv", "\n".join(["x [m]", *map(str, range(2000)), gap, "1.5", ""]))
    assert sheet.columns([0])[-2:].tolist() == [[1999.0], [1.5]]


def test_decimal_commas_of_large_tables() -> None:
    """Assert that they are found."""
    text = "\n".join(["t [s];x [m]", *(f"{i},5;{i}" for i in range(2000))])
    assert Sheet.from_text("t.csv", text).columns([0])[-1].tolist() == [1999.5]


@pytest.mark.parametrize("labels", [False, True])
def test_links_of_a_large_table(labels: bool) -> None:
    """Assert the ends that are written, by number and by label, and the line of one that is none."""
    extent = Extent("site", ROWS, tuple(f"s{i}" for i in range(ROWS)) if labels else ())
    lines = [f"{extent.label(i)},{extent.label(i + 1)}" for i in range(ROWS - 1)]
    found = Links(of="site", table="b.csv", csv="\n".join(["first,second", *lines])).relation("bond", {"site": extent})
    assert found.first.tolist() == [*range(ROWS - 1)]
    assert found.second.tolist() == [*range(1, ROWS)]
    for wrong, said in (
        (f"{extent.label(5)},s{ROWS}", f"line 12: dimension 'site' has no element s{ROWS}"),
        (f"{extent.label(5)},{extent.label(5)}", f"line 12: links '{extent.label(5)}' with itself"),
        (f"{extent.label(4)},{extent.label(3)}", "line 12: the link of line 5 is there again"),
    ):
        csv = "\n".join(["first,second", *lines[:10], wrong, *lines[11:]])
        with pytest.raises(InputError, match=said):
            Links(of="site", table="b.csv", csv=csv).relation("bond", {"site": extent})


def test_a_large_table_takes_little_more_than_its_text() -> None:
    """Assert that reading 10^5 numbers takes at most 100 bytes a row beside its text (line by line it is 420)."""
    rows = 100_000
    text = "\n".join(["m [kg]", *map(repr, (1.0 + np.arange(rows) / 3.0).tolist())])
    tracemalloc.start()
    try:
        found, _ = columns_by_element(Sheet.from_text("t.csv", text), ["m"], Extent("body", rows))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert found[-1, 0] == 1.0 + (rows - 1) / 3.0
    assert peak < 100 * rows

"""Workbooks that are damaged, or made to take memory and time: each ends in one line, soon, in little memory."""

from __future__ import annotations

import io
import resource
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import xdynamics as xd
from cases.problems import ROOT

MAIN = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
HEAD = '<?xml version="1.0"?>'
RELATED = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
PACKAGE = "http://schemas.openxmlformats.org/package/2006"
KIND = "application/vnd.openxmlformats-officedocument.spreadsheetml"
PARTS = {
    "[Content_Types].xml": f'{HEAD}<Types xmlns="{PACKAGE}/content-types"><Default Extension="xml" ContentType="application/xml"/>'
    '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
    f'<Override PartName="/xl/workbook.xml" ContentType="{KIND}.sheet.main+xml"/>'
    f'<Override PartName="/xl/sharedStrings.xml" ContentType="{KIND}.sharedStrings+xml"/>'
    f'<Override PartName="/xl/worksheets/sheet1.xml" ContentType="{KIND}.worksheet+xml"/></Types>',
    "_rels/.rels": f'{HEAD}<Relationships xmlns="{PACKAGE}/relationships"><Relationship Id="r1" Type="{RELATED}/officeDocument"'
    ' Target="xl/workbook.xml"/></Relationships>',
    "xl/workbook.xml": f'{HEAD}<workbook xmlns="{MAIN}" xmlns:r="{RELATED}"><sheets><sheet name="log" sheetId="1" r:id="r1"/>'
    "</sheets></workbook>",
    "xl/_rels/workbook.xml.rels": f'{HEAD}<Relationships xmlns="{PACKAGE}/relationships"><Relationship Id="r1"'
    f' Type="{RELATED}/worksheet" Target="worksheets/sheet1.xml"/><Relationship Id="r2" Type="{RELATED}/sharedStrings"'
    ' Target="sharedStrings.xml"/></Relationships>',
}
TITLES = ["t [s]", "pull [N]"]


def workbook(rows: str, texts: str = "".join(f"<si><t>{title}</t></si>" for title in TITLES)) -> bytes:
    """Return a workbook of two titles, and of rows as they stand in its XML."""
    header = '<row r="1"><c r="A1" t="s"><v>0</v></c><c r="B1" t="s"><v>1</v></c></row>'
    sheet = f'{HEAD}<worksheet xmlns="{MAIN}"><sheetData>{header}{rows}</sheetData></worksheet>'
    parts = PARTS | {
        "xl/worksheets/sheet1.xml": sheet,
        "xl/sharedStrings.xml": f'{HEAD}<sst xmlns="{MAIN}">{texts}</sst>',
    }
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, part in parts.items():
            archive.writestr(name, part)
    return content.getvalue()


GOOD = '<row r="2"><c r="A2"><v>0</v></c><c r="B2"><v>1</v></c></row><row r="3"><c r="A3"><v>1</v></c><c r="B3"><v>5</v></c></row>'


def read(folder: Path, content: bytes) -> xd.Model:
    """Return a model with a drive of a workbook."""
    (folder / "log.xlsx").write_bytes(content)
    (folder / "model.toml").write_text(
        'name = "log"\n[coordinates]\nx = "m"\n[mass]\nx = "kilogram"\n[initial]\nx = "0 m"\nv_x = "0 m/s"\n'
        '[drives.pull]\ntable = "log.xlsx"\n'
    )
    return xd.Model.from_toml(folder / "model.toml")


def test_the_workbook_of_these_tests_is_one(tmp_path: Path) -> None:
    """Assert that it is read, so that what is refused below is refused for its fault."""
    assert read(tmp_path, workbook(GOOD)).drives["pull"].table.value.tolist() == [1.0, 5.0]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (lambda: workbook(GOOD, "<si><t>t [s]</t></si>"), "sheet 'log' of the workbook is damaged .IndexError"),
        (
            lambda: workbook(GOOD.replace("<v>5</v>", "<v>five</v>")),
            "sheet 'log' of the workbook is damaged .ValueError",
        ),
        (lambda: workbook(GOOD[:-20]), "it is no workbook of Excel"),
        (lambda: workbook(GOOD + '<row r="1048577"><c r="A1048577"><v>9</v></c></row>'), "has over 1048576 rows"),
        (lambda: workbook(GOOD)[:-60], "it is no workbook of Excel"),
        (lambda: workbook('<row r="2"/>' * 6_000_000), "over 50000000 bytes unpacked, at 'xl/worksheets/sheet1.xml'"),
        (lambda: workbook(GOOD, "<si><t>x</t></si>" * 4_000_000), "bytes unpacked, at 'xl/sharedStrings.xml'"),
    ],
)
def test_a_hostile_workbook_is_named(tmp_path: Path, content: object, said: str) -> None:
    """Assert one line that says what it is."""
    assert callable(content)
    with pytest.raises(xd.ModelError, match=said):
        read(tmp_path, content())


@pytest.mark.dear
@pytest.mark.parametrize("what", ["texts", "cells", "one cell"])
def test_no_workbook_takes_much_memory(tmp_path: Path, what: str) -> None:
    """Assert an error, or a table, in 1.5 GB of address space and half a minute."""
    content = {
        "texts": lambda: workbook(GOOD, "<si><t>x</t></si>" * 60_000_000),
        "cells": lambda: workbook('<row r="2">' + '<c t="b"><v>1</v></c>' * 2_000_000 + "</row>"),
        "one cell": lambda: workbook(f'<row r="2"><c r="A2" t="str"><v>{"x" * (1 << 30)}</v></c></row>'),
    }[what]()
    (tmp_path / "log.xlsx").write_bytes(content)
    assert len(content) < 8_000_000
    script = (
        "from pathlib import Path\nfrom xdynamics.model.file_access import text_of_workbook\nimport sys\n"
        "from xdynamics.faults import InputError\n"
        "try:\n    text_of_workbook(Path(sys.argv[1]).read_bytes())\nexcept InputError as error:\n    print(error)\n"
    )
    limit = 1_500_000_000
    done = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path / "log.xlsx")],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        cwd=ROOT,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit)),
    )
    assert done.returncode == 0, done.stderr[-500:]
    assert ("entries in a row" if what == "cells" else "bytes unpacked") in done.stdout

"""Reports of bundles: one file, nothing from elsewhere, every part there; what is no bundle is named."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.documenting.equations import TextTable, formula_svg, model_blocks
from xdynamics.expressions import latex, parse


@pytest.fixture(scope="module")
def bundled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bundle of a rocket's apogee."""
    model = xd.Model.from_toml(MODELS / "rocket_c6.toml")
    found = xd.certify(model, "y", event="apogee", method="midpoint", step="10 ms", draws=4096)
    return xd.bundle(tmp_path_factory.mktemp("document") / "rocket", found)


class Reader(HTMLParser):
    """Gathers tags, links and texts, and whether tags are closed in order."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.sources: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note a tag."""
        self.sources += [str(value) for name, value in attrs if name in ("src", "href")]
        if tag not in ("img", "meta", "link", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        """Close it."""
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        """Note a text."""
        self.text += data


@pytest.mark.dear
def test_a_report_is_one_whole_file(bundled: Path, tmp_path: Path) -> None:
    """Assert well-formed HTML with everything in it and nothing from elsewhere, the same twice, and by the verb."""
    from click.testing import CliRunner

    from xdynamics.cli import main

    text = xd.document(bundled, tmp_path / "report.html").read_text()
    reader = Reader()
    reader.feed(text)
    assert not reader.open
    assert reader.sources
    assert all(source.startswith("data:image/") for source in reader.sources)
    assert "http" not in re.sub('data:image[^"]+', "", text)
    for said in (
        "y at apogee = 301 ± 20 m",
        "It passes every gate.",
        "drag_coefficient",
        "observed order",
        "liftoff",
        "located within",
        "linear_drag",
        "xdynamics recheck rocket",
        "Runge 1895",
        "measured thrust",
    ):
        assert said in reader.text or said in text, said
    done = CliRunner().invoke(main, ["report", str(bundled), "-o", str(tmp_path / "again.html")])
    assert done.exit_code == 0, done.output
    assert (tmp_path / "again.html").read_text() == text


def test_the_same_in_markdown(bundled: Path, tmp_path: Path) -> None:
    """Assert headings, formulas in LaTeX, and tables with as many cells in each row."""
    text = xd.document(bundled, tmp_path / "report.md").read_text()
    assert [line for line in text.split("\n") if line.startswith("## ")] == [
        "## What it has to pass",
        "## The budget",
        "## The run",
        "## Convergence",
        "## The model",
        "## The method",
        "## The method's ledger",
        "## Made again",
        "## The method's equations",
    ]
    assert r"\ddot{y}" in text
    result, figure, coefficients = (
        text.index(part) for part in ("301 ± 20 m", "](data:image/png", "## The method's equations")
    )
    assert result < figure < text.index("## The model") < coefficients
    assert "h*" not in text[:coefficients]
    blocks = re.findall(r"(?:^\|.*\n?)+", text, re.MULTILINE)
    assert len(blocks) >= 7
    for block in blocks:
        assert len({len(re.findall(r"(?<!\\)\|", line)) for line in block.strip().split("\n")}) == 1


@pytest.mark.every(11)
@pytest.mark.parametrize("path", sorted(MODELS.glob("*.toml")), ids=lambda one: one.stem)
def test_every_model_is_written_in_formulas(path: Path) -> None:
    """Assert that all formulas of every model are drawn by matplotlib's mathematics, and that its numbers are all there.

    Of those that differ in figures or upright names alone, one is drawn. Formulas have dimensions, not elements.
    """
    from matplotlib.mathtext import MathTextParser

    model, parser = xd.Model.from_toml(path), MathTextParser("path")
    formulas = [one.latex for one in model_blocks(model) if hasattr(one, "latex")]
    assert formulas
    for formula in {re.sub(r"\d+|(?<=\\mathrm{)[^{}]*", "", one): one for one in formulas}.values():
        parser.parse(f"${formula}$")
    rows = [row[0] for one in model_blocks(model) if isinstance(one, TextTable) for row in one.rows]
    stated = model.shaped
    at_start = (f"{name} at the start" for name in (*stated.initial, *stated.starting))
    assert {*stated.parameters, *stated.arrays, *at_start} <= {re.sub(r"\[.*?\]|, along .*", "", row) for row in rows}


def test_elements_that_are_alike_have_one_row() -> None:
    """Assert that 32 sites at rest are one row of the table of numbers, and that one that moves has all written out."""
    text = (MODELS / "fermi_pasta_ulam.toml").read_text(encoding="utf-8")

    def rows(model: xd.Model) -> list[list[str]]:
        tables = [one for one in model_blocks(model) if isinstance(one, TextTable)]
        return [list(row) for table in tables for row in table.rows if row[0].startswith("v_u")]

    model = xd.Model.from_text(text)
    ((name, value, *_),) = rows(model)
    assert (name, value) == ("v_u at the start, along site, 32 alike", "0.0 m s-1")
    moving = rows(model.replace(initial={"v_u[3]": "2 m s-1"}))
    assert len(moving) == 32
    assert moving[3][:2] == ["v_u[3] at the start", "2.0 m s-1"]


@pytest.mark.dear
def test_formulas_of_elements_are_one_formula() -> None:
    """Assert that a chain of 5,000 sites is written in as many formulas as quantities, with places of a shift in them."""
    text = (MODELS / "heat.toml").read_text(encoding="utf-8").replace("cell = 50", "cell = 5000")
    written = [*model_blocks(xd.Model.from_text(text))]
    rate = next(one.latex for one in written if hasattr(one, "latex") and "dot{T}" in one.latex)
    assert len(written) < 10
    assert r"\mathrm{shift}\left(T, \mathrm{cell}, -1, 0\,\mathrm{kelvin}\right)" in rate
    assert latex(parse("2*sum(m*u, site) + norm(r, axis)")) == (
        r"2\,\left(\sum_{\mathrm{site}} m\,u\right) + \left\|r\right\|_{\mathrm{axis}}"
    )


def test_formulas_are_drawn_the_same_twice() -> None:
    """Assert bytes, and that what is no formula stands as it is written."""
    assert formula_svg(r"m\,\ddot{y} = -m\,g") == formula_svg(r"m\,\ddot{y} = -m\,g")
    assert b"<svg" in formula_svg(r"\frac{1}{")


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda folder, tmp: (folder, tmp / "report.docx"), "the ending '.docx'"),
        (lambda _, tmp: (tmp, tmp / "report.html"), "is no bundle: there is no certificate.nc"),
        (lambda folder, tmp: (folder, tmp), "the ending ''"),
        (lambda folder, tmp: (folder, tmp / "no" / "r.html"), "does not exist"),
    ],
)
def test_what_is_no_bundle_is_named(make: Any, said: str, bundled: Path, tmp_path: Path) -> None:
    """Assert one clear error for each."""
    folder, path = make(bundled, tmp_path)
    with pytest.raises(xd.InputError, match=said):
        xd.document(folder, path)

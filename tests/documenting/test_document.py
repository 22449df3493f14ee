"""Reports of bundles: one file, nothing from elsewhere, every part there; what is no bundle is named.

Reports that are one file: HTML that needs no other, PDF with a page a record.
The manual as a site: every topic, verb, method, name and model is in it, and every link leads somewhere.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import zipfile
from html import unescape
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
import xarray as xr

import xdynamics as xd
from cases.command_line import call
from cases.problems import MODELS, ROOT
from xdynamics.cli import main
from xdynamics.documenting import carried_wheel
from xdynamics.documenting.equations import TextTable, formula_svg, model_blocks
from xdynamics.documenting.guide import described_pages, topics
from xdynamics.documenting.markdown import terminal_lines
from xdynamics.documenting.site import ABOUT
from xdynamics.expressions import latex, parse
from xdynamics.model.grammar import SECTIONS


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
    stated = model.statement
    at_start = (f"{name} at the start" for name in (*stated.initial, *stated.starting))
    assert {*stated.parameters, *stated.arrays, *at_start} <= {re.sub(r"\[.*?\]|, along .*", "", row) for row in rows}


def test_elements_that_are_alike_have_one_row() -> None:
    """Assert that 32 sites at rest are one row of the table of numbers, and those of which one moves another."""
    text = (MODELS / "fermi_pasta_ulam.toml").read_text(encoding="utf-8")

    def rows(model: xd.Model) -> list[list[str]]:
        tables = [one for one in model_blocks(model) if isinstance(one, TextTable)]
        return [list(row) for table in tables for row in table.rows if row[0].startswith("v_u")]

    model = xd.Model.from_text(text)
    ((name, value, *_),) = rows(model)
    assert (name, value) == ("v_u at the start, along site, 32 alike", "0.0 m s-1")
    ((name, value, *_),) = rows(model.replace(initial={"v_u[3]": "2 m s-1"}))
    assert (name, value) == ("v_u at the start, along site", "32 values from 0 to 2 m s-1")


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


BALL = xd.Model.from_toml(MODELS / "ball_drag.toml")


@pytest.fixture(scope="module")
def run() -> xr.Dataset:
    """A ball."""
    return xd.simulate(BALL, rtol=1e-6)


def test_a_plain_run_is_one_page_of_html(run: xr.Dataset, tmp_path: Path) -> None:
    """Assert the figure inside the page, summary and digest, no link to another file, and the same bytes twice."""
    words = xd.report(tmp_path / "r.html", run=run)
    page = (tmp_path / "r.html").read_text()
    assert xd.content_digest(run) in words
    assert xd.content_digest(run) in page
    assert "event     ground at t = " in page
    assert page.count("data:image/png;base64,") == 1
    assert not re.search(r'(src|href)="(?!data:)', page)
    assert [path.name for path in tmp_path.iterdir()] == ["r.html"]
    xd.report(tmp_path / "again.html", run=run)
    assert (tmp_path / "again.html").read_bytes() == (tmp_path / "r.html").read_bytes()


def test_stages_are_computed_and_have_a_page_each(run: xr.Dataset, tmp_path: Path) -> None:
    """Assert a PDF of as many pages as records, of a run, a lazy budget, and refinements by name."""
    study = xd.refine(BALL, method="midpoint", steps=["40 ms", "20 ms", "10 ms"], until="1 s")
    records: dict[str, Any] = {
        "run": run,
        "budget": xd.error_budget(BALL, "t", event="ground", compute=False),
        "refinements": {"midpoint": study},
    }
    xd.report(tmp_path / "r.pdf", **records)
    content = (tmp_path / "r.pdf").read_bytes()
    assert content.startswith(b"%PDF")
    assert len(re.findall(rb"/Type /Page\b", content)) == 3
    xd.report(tmp_path / "again.pdf", **records)
    assert (tmp_path / "again.pdf").read_bytes() == content


def test_what_cannot_be_written_is_said_before_anything_is_computed(run: xr.Dataset, tmp_path: Path) -> None:
    """Assert an error for a folder that is missing, a directory of that name, no record, and a stage that fails."""
    (tmp_path / "d.html").mkdir()
    for path, records, words in (
        (tmp_path / "none" / "r.html", {"run": run}, "cannot be written: the folder"),
        (tmp_path / "d.html", {"run": run}, "is a directory"),
        (tmp_path / "r.pdf", {}, "report needs at least one record"),
        (tmp_path / "r.pdf", {"run": 3}, "'run' is '3', needs a run, evidence"),
    ):
        with pytest.raises(xd.InputError, match=words):
            xd.report(path, **records)
    assert [path.name for path in tmp_path.iterdir()] == ["d.html"]


class Links(HTMLParser):
    """Where a page leads, what may be led to on it, and that its elements close in order."""

    def __init__(self) -> None:
        super().__init__()
        self.targets: list[str] = []
        self.anchors: set[str] = set()
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Keep targets and anchors."""
        self.targets += [value for key, value in attrs if key in ("href", "src") and value]
        self.anchors |= {value for key, value in attrs if key == "id" and value}
        if tag not in ("meta", "link", "img", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        """Close the last that is open."""
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def manual(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site as the command writes it."""
    folder = tmp_path_factory.mktemp("site") / "manual"
    done = call("help", "--html", folder)
    assert done.output == f"manual    {folder}/index.html\n"
    return folder


def test_everything_is_in_the_manual(manual: Path) -> None:
    """Assert a page for each topic with what help prints, every verb, method and public name, and every model's picture."""
    for name, page in topics().items():
        text = " ".join(unescape(re.sub(r"<[^>]+>", "", (manual / f"{name}.html").read_text())).split())
        lines = [" ".join(line.replace("`", "").removeprefix("- ").split()) for line in terminal_lines(page())]
        longest = sorted(
            (line for line in lines if "xdynamics help" not in line and not line.startswith(("==", "--"))), key=len
        )[-3:]
        assert all(line in text for line in longest), name
    for page, names in (("verbs", main.commands), ("methods", xd.METHODS), ("api", xd.__all__)):
        assert {*names} <= {*re.findall(r'<h2 id="(\w+)">', (manual / f"{page}.html").read_text())}
    assert "xd.fit" in (manual / "api.html").read_text()
    assert "intervals: str = &#x27;covariance&#x27;" in (manual / "api.html").read_text().replace("'", "&#x27;")
    index = (manual / "index.html").read_text()
    assert {*topics()} - {*ABOUT} == {*SECTIONS} - {*described_pages()}
    assert all(f'href="{name}.html">{name}</a> ' in index for name in topics())
    gallery = (manual / "gallery.html").read_text()
    assert all(f"figures/{path.stem}.png" in gallery for path in MODELS.glob("*.toml"))


def test_every_link_of_the_manual_leads_somewhere(manual: Path) -> None:
    """Assert well-formed pages whose links are files and anchors of the site."""
    pages = {}
    for path in manual.glob("*.html"):
        pages[path.name] = Links()
        pages[path.name].feed(path.read_text())
        assert pages[path.name].open == []
    for page, links in pages.items():
        for target in links.targets:
            file, _, anchor = target.partition("#")
            assert (manual / (file or page)).is_file(), f"{page}: {target}"
            assert not anchor or anchor in pages[file or page].anchors


def test_a_folder_that_is_there_is_left_alone(manual: Path) -> None:
    """Assert one line that names it, and that nothing of it changes."""
    before = sorted(path.name for path in manual.iterdir())
    done = call("help", "--html", manual)
    assert done.exit_code == 2
    assert str(manual) in done.output
    assert sorted(path.name for path in manual.iterdir()) == before


@pytest.mark.dear
def test_the_line_of_a_bundle_makes_it_again_in_an_environment_that_knows_nothing_of_here(tmp_path: Path) -> None:
    """Assert that its wheel is installed by pip without a registry, and that the package in it makes the number again."""
    model = xd.Model.from_toml(MODELS / "ball_drag.toml")
    certificate = xd.certify(model, "y", event="apex", method="dop853", rtol=1e-8, draws=0)
    xd.bundle(tmp_path / "apex", certificate)
    line = next(
        text.strip() for text in (tmp_path / "apex" / "README.md").read_text().splitlines() if "pip install" in text
    )
    install, remake = line.split(" && ")
    wheel = install.removeprefix("pip install ")
    assert remake == "xdynamics recheck apex"
    site = tmp_path / "site"
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target", site, wheel]
    subprocess.run(pip, cwd=tmp_path, check=True)
    program = f"import sys; sys.path.insert(0, {str(site)!r}); import xdynamics.cli as c; print(c.__file__); c.main()"
    done = subprocess.run(
        [sys.executable, "-c", program, *remake.split()[1:]],
        cwd=tmp_path,
        env={name: value for name, value in os.environ.items() if name != "PYTHONPATH"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(str(site))
    assert {path.name for path in (site / "bin").iterdir()} == {"xdynamics"}


def test_a_wheel_that_was_added_or_changed_is_found(bundled: Path, tmp_path: Path) -> None:
    """Assert that a bundle's own wheel has a digest, and that no other passes for it."""
    (wheel,) = bundled.glob("*.whl")
    for change, said in (
        (lambda folder: (folder / wheel.name).write_bytes(b"another"), f"{wheel.name} differs from its digest"),
        (lambda folder: (folder / wheel.name).unlink(), f"{wheel.name} is missing"),
        (
            lambda folder: (folder / "xdynamics-9.9-py3-none-any.whl").write_bytes(b""),
            "9.9-py3-none-any.whl is none of its",
        ),
    ):
        folder = tmp_path / said[-9:]
        shutil.copytree(bundled, folder)
        change(folder)
        with pytest.raises(xd.ArchiveError, match=said.replace(".", r"\.")):
            xd.recheck(folder)


def test_the_wheel_of_a_bundle_is_the_package(tmp_path: Path) -> None:
    """Assert that all modules and texts are in it with their digests, and that it is the same file each time."""
    first, second = tmp_path / "a.whl", tmp_path / "b.whl"
    for path in (first, second):
        carried_wheel.write_wheel(path)
    assert first.read_bytes() == second.read_bytes()
    with zipfile.ZipFile(first) as wheel:
        names = {*wheel.namelist()}
        record = wheel.read("xdynamics-0.2.0.dist-info/RECORD").decode().splitlines()
        entry_points = wheel.read("xdynamics-0.2.0.dist-info/entry_points.txt").decode()
    wanted = {
        f"xdynamics/{path.relative_to(ROOT / 'src' / 'xdynamics')}"
        for path in (ROOT / "src" / "xdynamics").rglob("*.py")
    }
    assert wanted | {"xdynamics/manual/first.md", "xdynamics/py.typed"} <= names
    assert {row.split(",")[0] for row in record} == names
    assert "xdynamics = " in entry_points

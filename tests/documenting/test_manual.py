"""The manual's pages: what they show runs, and what is made of their Markdown is what they say."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import xdynamics as xd
from cases.problems import ROOT
from xdynamics.cli import main
from xdynamics.documenting.guide import MADE, PAGES, STARTER, topics
from xdynamics.documenting.manual import FOLDER, manual_text
from xdynamics.documenting.markdown import html, table, terminal_lines

NAMES = [name for names in PAGES.values() for name in names]
WITH_PYTHON = [name for name in NAMES if "```python\n" in manual_text(f"{name}.md")]


@pytest.mark.parametrize("name", WITH_PYTHON)
def test_what_a_page_shows_in_python_runs(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that the blocks of a page run one after the other, with the pendulum of the first page in the folder."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pendulum.toml").write_text(STARTER)
    (tmp_path / "data").symlink_to(ROOT / "data")
    xd.save(xd.simulate(xd.Model.from_toml("pendulum.toml")), "pendulum.nc")
    blocks = re.findall(r"```python\n(.*?)```", manual_text(f"{name}.md"), re.DOTALL)
    scope: dict[str, object] = {}
    exec(compile("\n".join(blocks), f"{name}.md", "exec"), scope)
    assert scope["xd"] is xd


def test_every_text_is_a_page_and_every_table_has_its_place() -> None:
    """Assert that no text of the folder is forgotten, no table made in vain, and no place left without its table."""
    texts = {path.stem for path in FOLDER.glob("*.md")}
    assert texts == {*NAMES}
    places = [place for name in texts for place in re.findall(r"\{\{(.+?)\}\}", manual_text(f"{name}.md"))]
    assert sorted(places) == sorted(MADE)
    assert not any("{{" in page() for page in topics().values())


def test_links_between_pages_lead_there() -> None:
    """Assert that each link and each command of help names a page."""
    for name in NAMES:
        text = manual_text(f"{name}.md")
        named = {*re.findall(r"\]\((\w+)\.md\)", text), *re.findall(r"`xdynamics help (\w+)`", text)} - {"WORD"}
        assert named <= {*topics(), *main.commands}, name


def test_prose_has_the_words_of_the_field() -> None:
    """Assert that pages do not say `march`, but as names that were, nor sentences of over forty words."""
    for name in NAMES:
        text = re.sub(r"```.*?```|`[^`]*`", "x", manual_text(f"{name}.md"), flags=re.DOTALL)
        assert not re.search(r"\bmarch(es|ed)?\b", text), name
        prose = [part for part in text.split("\n\n") if not part.startswith(("|", "#", "{{"))]
        sentences = [sentence for part in prose for sentence in re.split(r"(?<=[.:;])\s", " ".join(part.split()))]
        assert max((len(sentence.split()) for sentence in sentences), default=0) <= 40, name


def test_markdown_becomes_text_and_html() -> None:
    """Assert signs that Markdown reads, in a table, in code, in a link, as they are to be read in both forms."""
    page = "\n\n".join(
        [
            "# Signs",
            table([["`a|b`", r"a\*b\*c \<x\> v\_y"]]),
            "- one of `<q>`\n- and `xdynamics help units`",
            "```sh\nxdynamics run a.toml   # a < b\n```",
            "See [units](units.md).",
        ]
    )
    lines = terminal_lines(page)
    assert lines[:2] == ["Signs", "====="]
    assert "  a|b  a*b*c <x> v_y" in lines
    assert "  xdynamics run a.toml   # a < b" in lines
    assert lines[-1] == "See units (`xdynamics help units`)."
    made = html(page, {"units"})
    for part in (
        "<code>a|b</code>",
        "<td>a*b*c &lt;x&gt; v_y</td>",
        "<code>&lt;q&gt;</code>",
        '<a href="units.html"><code>xdynamics help units</code></a>',
        "# a &lt; b",
        '<a href="units.html">units</a>',
    ):
        assert part in made

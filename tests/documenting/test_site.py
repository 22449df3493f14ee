"""The manual as a site: every topic, verb, method, name and model is in it, and every link leads somewhere."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

import xdynamics as xd
from cases.command_line import call
from cases.problems import MODELS
from xdynamics.cli import main
from xdynamics.documenting.guide import topics
from xdynamics.documenting.site import ABOUT
from xdynamics.model.grammar import SECTIONS


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
        text = re.sub(r"<[^>]+>", "", (manual / f"{name}.html").read_text())
        longest = max(page(), key=len)
        assert longest.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;") in text
    for page, names in (("verbs", main.commands), ("methods", xd.METHODS), ("api", xd.__all__)):
        assert {*names} <= {*re.findall(r'<h2 id="(\w+)">', (manual / f"{page}.html").read_text())}
    assert "xd.fit" in (manual / "api.html").read_text()
    assert "intervals: str = &#x27;covariance&#x27;" in (manual / "api.html").read_text().replace("'", "&#x27;")
    index = (manual / "index.html").read_text()
    assert {*topics()} - {*ABOUT} == {*SECTIONS}
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

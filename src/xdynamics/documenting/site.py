"""The manual as a site of pages: the guide, verbs, methods, models with their pictures, functions of Python."""

from __future__ import annotations

import inspect
import re
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path

from xdynamics.archive.folder_store import new_folder_at
from xdynamics.documenting.guide import PAGES, described_pages, topics
from xdynamics.documenting.manual import manual_text
from xdynamics.documenting.markdown import html
from xdynamics.model.grammar import SECTIONS

STYLE = manual_text("site.css")
GUIDE, SECTIONS_OF, COMMANDS, FUNCTIONS = "The guide", "Sections of a model", "Command line", "Python"
INDEX, VERBS, METHODS, GALLERY, API = "index", "verbs", "methods", "gallery", "api"
DATA = Path(__file__).parents[3] / "data"  # of a checkout; an installed package has none
ABOUT = {
    **described_pages(),
    GALLERY: "What each model of the data folder does.",
    VERBS: "Every command with its options.",
    API: "Everything that import xdynamics has, with signatures.",
    METHODS: "Integration methods: equations, order, stability, what they refuse.",
}
_CODE = re.compile(r"`([^`]+)`")
_MODEL = re.compile(
    r"## (?P<title>.+)\n\n\[(?P<file>[^\]]+)\]\((?P<path>[^)]+)\)(?:: (?P<said>.*))?\n\n!\[.*\]\((?P<image>.+)\)"
)


@dataclass(frozen=True)
class SitePage:
    """One page of the site: its group in the side list, its title, and its content as HTML."""

    group: str
    name: str
    title: str
    body: Callable[[], str]


def site(path: str | Path, verbs: Mapping[str, str], methods: Mapping[str, str], public: Mapping[str, object]) -> Path:
    """Write the manual as a site of plain pages, which need no server.

    Parameters
    ----------
    path : str or Path
        A folder that is empty or does not exist.
    verbs : mapping of str to str
        Help of every verb of the command line.
    methods : mapping of str to str
        What is known of every method.
    public : mapping of str to object
        The functions and classes of the package, by name.

    Raises
    ------
    InputError
        If something is there already.
    ArchiveError
        If it cannot be written.
    """
    pages = [SitePage("", INDEX, "xdynamics", lambda: _index_html(pages))]
    pages += [SitePage(group, name, name, _topic_body(name)) for group, names in PAGES.items() for name in names]
    if (DATA / "README.md").is_file():
        pages.append(SitePage(GUIDE, GALLERY, "gallery of models", _gallery))
    texts = {page.name for page in pages}
    pages += [SitePage(SECTIONS_OF, name, name, _topic_body(name)) for name in SECTIONS if name not in texts]
    pages += [
        SitePage(COMMANDS, VERBS, "verbs", lambda: _entries_html(verbs, "xdynamics {}")),
        SitePage(
            FUNCTIONS, API, "functions and classes", lambda: _entries_html(dict(_public_entries(public)), "xd.{}")
        ),
        SitePage(FUNCTIONS, METHODS, "methods", lambda: _entries_html(methods, "{}")),
    ]
    with new_folder_at(Path(path)) as built:
        (built / "style.css").write_text(STYLE, encoding="utf-8")
        for page in pages:
            (built / f"{page.name}.html").write_text(_page_html(page, pages), encoding="utf-8")
        if (DATA / "README.md").is_file():
            shutil.copytree(DATA / "figures", built / "figures", ignore=lambda _, names: {*names} - {*_pictures()})
            shutil.copytree(DATA / "models", built / "models")
    return Path(path)


def _page_html(page: SitePage, pages: Iterable[SitePage]) -> str:
    """Return a page with the list of all at its side."""
    links, group = [], ""
    for listed_page in pages:
        if listed_page.group != group:
            group = listed_page.group
            links.append(f"<h2>{escape(group)}</h2>")
        link_class = ' class="here"' if listed_page is page else ""
        links.append(f'<a href="{listed_page.name}.html"{link_class}>{escape(listed_page.title)}</a>')
    body = page.body()
    heading = "" if body.startswith("<h1>") else f"<h1>{escape(page.title)}</h1>\n"
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<title>{escape(page.title)} – xdynamics</title>\n<link rel="stylesheet" href="style.css">\n</head>\n<body>\n'
        f"<nav>\n{chr(10).join(links)}\n</nav>\n<main>\n{heading}{body}\n</main>\n</body>\n"
        "</html>\n"
    )


def _index_html(pages: Iterable[SitePage]) -> str:
    """Return the first page: links to all pages, with the first sentence of each."""
    parts, group = (
        [
            "<p>Numerical dynamics as self-describing xarray datasets. This is what <code>xdynamics help</code> says.</p>"
        ],
        "",
    )
    for page in pages:
        if page.name == INDEX:
            continue
        if page.group != group:
            group = page.group
            parts.append(f"<h2>{escape(group)}</h2>")
        parts.append(
            f'<div><a href="{page.name}.html">{escape(page.title)}</a> {_worded(_page_description(page.name))}</div>'
        )
    return "\n".join(parts)


def _worded(text: str) -> str:
    """Return text as HTML, with commands and names as code."""
    return _CODE.sub(r"<code>\1</code>", escape(text, quote=False))


def _page_description(name: str) -> str:
    return ABOUT.get(name) or f"{SECTIONS[name].about}."


def _topic_body(name: str) -> Callable[[], str]:
    """Return the content of a topic's page, with links to the topics it names."""
    pages = topics()
    return lambda: html(pages[name](), pages)


class _Table(str):
    """An entry that is HTML already."""


def _entries_html(entries: Mapping[str, str], title: str) -> str:
    """Return a page of entries by name, with a list of them first."""
    short = " · ".join(f'<a href="#{escape(name)}">{escape(name)}</a>' for name in entries)
    parts = [f"<p>{short}</p>"]
    for name, text in entries.items():
        body = text if isinstance(text, _Table) else f"<pre>{escape(text, quote=False)}</pre>"
        parts.append(f'<h2 id="{escape(name)}">{escape(title.format(name))}</h2>\n{body}')
    return "\n".join(parts)


def _public_entries(public: Mapping[str, object]) -> Iterator[tuple[str, str]]:
    """Yield public names, each with its signature and its documentation."""
    for name, public_object in public.items():
        if not callable(public_object):
            yield (
                name,
                _Table(public_object._repr_html_()) if hasattr(public_object, "_repr_html_") else repr(public_object),
            )
            continue
        text = [f"{name}{_signature(public_object)}", "", inspect.getdoc(public_object) or ""]
        if inspect.isclass(public_object) and not issubclass(public_object, BaseException):
            for key, method in vars(public_object).items():
                if not key.startswith("_") and (callable(method) or isinstance(method, classmethod | property)):
                    first_sentence = (inspect.getdoc(method) or "").split("\n")[0]
                    call = "" if isinstance(method, property) else _signature(getattr(public_object, key))
                    text.append(f"\n{name}.{key}{call}\n    {first_sentence}")
        yield name, "\n".join(text).rstrip()


def _signature(function: Callable[..., object]) -> str:
    """Return a signature, one parameter a line where it is long, its types without quotes."""
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):
        return "(…)"
    plain = re.sub(
        r": '([^']*)'|-> '([^']*)'", lambda match: f": {match[1]}" if match[1] else f"-> {match[2]}", str(signature)
    )
    if len(plain) < 100:
        return plain
    parts = [re.sub(r": '([^']*)'", r": \1", str(parameter)) for parameter in signature.parameters.values()]
    kinds = [parameter.kind for parameter in signature.parameters.values()]
    first = next((k for k, kind in enumerate(kinds) if kind is inspect.Parameter.KEYWORD_ONLY), None)
    if first is not None and inspect.Parameter.VAR_POSITIONAL not in kinds:
        parts.insert(first, "*")
    return "(\n" + "".join(f"    {part},\n" for part in parts) + ")" + plain[plain.rindex(")") + 1 :]


def _gallery() -> str:
    """Return the models of the data folder, each with its picture."""
    parts = [
        "<p>Each is a file to copy, and its picture is what it does by its own settings.</p>",
        '<div class="models">',
    ]
    parts += [
        f'<figure><a href="{escape(match["image"])}"><img loading="lazy" src="{escape(match["image"])}" alt=""></a>'
        f'<figcaption><b>{escape(match["title"])}</b> <a href="{escape(match["path"])}">{escape(match["file"])}</a><br>'
        f"{escape(match['said'] or '')}</figcaption></figure>"
        for match in _MODEL.finditer((DATA / "README.md").read_text(encoding="utf-8"))
    ]
    return "\n".join([*parts, "</div>"])


def _pictures() -> Iterator[str]:
    """Yield the names of the gallery's pictures."""
    for match in _MODEL.finditer((DATA / "README.md").read_text(encoding="utf-8")):
        yield Path(match["image"]).name

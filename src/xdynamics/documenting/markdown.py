"""The manual's Markdown as lines of a terminal and as HTML."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Sequence
from textwrap import wrap

from markdown_it import MarkdownIt
from markdown_it.tree import SyntaxTreeNode

WIDTH = 100  # of a line
WIDEST_ENTRY = 36  # of all columns of a table but the last; a longer entry has a line of its own
INDENT = "  "
_PARSER = MarkdownIt("commonmark").enable("table")
_HELP = re.compile(r"<code>((?:xdynamics )?help (\w+))</code>")
_PAGE_LINK = re.compile(r'href="(\w+)\.md"')


def wrapped_lines(text: str, hang: int = 0) -> list[str]:
    """Return lines of at most `WIDTH` characters, those after the first indented by `hang`; no word is broken.

    Examples
    --------
    >>> wrapped_lines("  name  " + "many " * 20, 8)
    ['  name  many many many many many many many many many many many many many many many many many many', '        many many']
    """
    return wrap(text, WIDTH, subsequent_indent=" " * hang, break_long_words=False, break_on_hyphens=False)


def terminal_lines(markdown: str) -> list[str]:
    r"""Return a page as plain text: titles underlined, code indented, tables in columns.

    Examples
    --------
    >>> print(*terminal_lines("# Title\n\nSee [units](units.md).\n\n| | |\n|---|---|\n| `a` | first |"), sep="\n")
    Title
    =====
    <BLANKLINE>
    See units (`xdynamics help units`).
    <BLANKLINE>
      a  first
    """
    lines: list[str] = []
    for block in SyntaxTreeNode(_PARSER.parse(markdown)).children:
        lines += [*([""] if lines else []), *_BLOCKS[block.type](block)]
    return lines


def html(markdown: str, pages: Collection[str]) -> str:
    """Return a page as HTML, with links to the pages that it names."""

    def linked(match: re.Match[str]) -> str:
        return f'<a href="{match[2]}.html">{match[0]}</a>' if match[2] in pages else match[0]

    return _HELP.sub(linked, _PAGE_LINK.sub(r'href="\1.html"', _PARSER.render(markdown)))


def table(rows: Sequence[Sequence[str]], titles: Sequence[str] = ("", "")) -> str:
    """Return rows of cells as a table of Markdown."""
    lines = [titles, ["---"] * len(titles), *([cell.replace("|", "\\|") for cell in row] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def code(lines: Sequence[str], language: str = "text") -> str:
    """Return lines as a block of code."""
    return "\n".join([f"```{language}", *lines, "```"])


def _heading(node: SyntaxTreeNode) -> Iterator[str]:
    title = _plain(node.children[0])
    yield from (title, ("=" if node.tag == "h1" else "-") * min(len(title), WIDTH))


def _paragraph(node: SyntaxTreeNode) -> Iterator[str]:
    yield from wrapped_lines(_plain(node.children[0]))


def _items(node: SyntaxTreeNode) -> Iterator[str]:
    for item in node.children:
        for block in item.children:
            yield from wrapped_lines(f"- {_plain(block.children[0])}", 2)


def _code(node: SyntaxTreeNode) -> Iterator[str]:
    for line in node.content.rstrip("\n").split("\n"):
        yield f"{INDENT}{line}".rstrip()


def _table(node: SyntaxTreeNode) -> Iterator[str]:
    """Yield the rows of a table: the last column is wrapped, those before it have the width of their entries."""
    rows = [
        [_plain(cell.children[0]) if cell.children else "" for cell in row.children]
        for part in node.children
        for row in part.children
    ]
    rows = [[*(cell.replace("`", "") for cell in cells), last] for *cells, last in rows if any([*cells, last])]
    columns = [*zip(*rows, strict=True)][:-1]
    widths = [max((len(cell) for cell in column if len(cell) <= WIDEST_ENTRY), default=0) for column in columns]
    hang = len(INDENT) + sum(width + 2 for width in widths)
    for *cells, last in rows:
        entry = INDENT + "".join(f"{cell:{width}}  " for cell, width in zip(cells, widths, strict=True))
        if len(entry) > hang:
            yield from wrapped_lines(entry.rstrip(), 4)
            entry = " " * hang
        yield from (line.rstrip() for line in wrapped_lines(entry + last, hang))


def _plain(node: SyntaxTreeNode) -> str:
    """Return inline content as text: code in its quotes, a link with the command that leads there."""
    if node.type == "code_inline":
        return f"`{node.content}`"
    if node.type in ("softbreak", "hardbreak"):
        return " "
    text = "".join(map(_plain, node.children)) if node.children else node.content
    if node.type == "link" and (target := str(node.attrs["href"])).endswith(".md"):
        return f"{text} (`xdynamics help {target.removesuffix('.md')}`)"
    return text


_BLOCKS: dict[str, Callable[[SyntaxTreeNode], Iterator[str]]] = {
    "heading": _heading,
    "paragraph": _paragraph,
    "bullet_list": _items,
    "fence": _code,
    "table": _table,
}

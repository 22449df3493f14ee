"""The parts of a document, and how each is written in HTML and in Markdown."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from io import BytesIO

POINTS = 14  # of a formula


@dataclass(frozen=True)
class Paragraph:
    """A paragraph, optionally with its first words in bold."""

    text: str
    strong: str = ""

    def html(self) -> str:
        """Return it as HTML."""
        head = f"<strong>{escape(self.strong)}</strong> " if self.strong else ""
        return f"<p>{head}{escape(self.text)}</p>"

    def markdown(self) -> str:
        """Return it as Markdown."""
        return f"{f'**{self.strong}** ' if self.strong else ''}{self.text}"


@dataclass(frozen=True)
class Formula:
    """A formula in LaTeX, with a caption."""

    latex: str
    caption: str = ""

    def html(self) -> str:
        """Return it as HTML: an image with the LaTeX as its text."""
        span = f'<span class="said">{escape(self.caption)}</span>' if self.caption else ""
        return (
            f'<p class="formula"><img src="{_embedded(formula_svg(self.latex), "svg+xml")}"'
            f' alt="{escape(self.latex)}">{span}</p>'
        )

    def markdown(self) -> str:
        """Return it as Markdown."""
        return f"{f'{self.caption}: ' if self.caption else ''}$${self.latex}$$"


@dataclass(frozen=True)
class TextTable:
    """Rows of texts under a header."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]

    def html(self) -> str:
        """Return it as HTML."""
        head = "".join(f"<th>{escape(cell)}</th>" for cell in self.header)
        rows = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in self.rows)
        return f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"

    def markdown(self) -> str:
        """Return it as Markdown."""
        lines = [self.header, ["---"] * len(self.header), *self.rows]
        return "\n".join(
            "| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in row) + " |" for row in lines
        )


@dataclass(frozen=True)
class PictureBlock:
    """A figure as PNG, with a caption."""

    content: bytes
    caption: str

    def html(self) -> str:
        """Return it as HTML with the picture embedded."""
        return (
            f'<figure><img src="{_embedded(self.content, "png")}"'
            f' alt="{escape(self.caption)}"><figcaption>{escape(self.caption)}</figcaption></figure>'
        )

    def markdown(self) -> str:
        """Return it as Markdown with the picture embedded."""
        return f"![{self.caption}]({_embedded(self.content, 'png')})"


@dataclass(frozen=True)
class CodeBlock:
    """Text to be typed, or read by a program."""

    text: str

    def html(self) -> str:
        """Return it as HTML."""
        return f"<pre>{escape(self.text)}</pre>"

    def markdown(self) -> str:
        """Return it as Markdown."""
        return "\n".join(f"    {line}" for line in self.text.splitlines())


Block = Paragraph | Formula | TextTable | PictureBlock | CodeBlock


@dataclass(frozen=True)
class PageSection:
    """A heading and the blocks under it."""

    title: str
    blocks: Sequence[Block]


_STYLE = """
body { font: 16px/1.5 Georgia, "Times New Roman", serif; color: #1c1c1c; max-width: 60em; margin: 2em auto; padding: 0 1.5em; }
h1 { font-size: 1.6em; line-height: 1.25; margin-bottom: 0.2em; }
h2 { font-size: 1.15em; margin-top: 2em; border-bottom: 1px solid #d8d8d8; padding-bottom: 0.2em; }
table { border-collapse: collapse; font: 14px/1.4 Helvetica, Arial, sans-serif; margin: 0.8em 0; width: 100%; }
th { text-align: left; border-bottom: 2px solid #1c1c1c; padding: 0.3em 0.8em 0.3em 0; vertical-align: bottom; }
td { border-bottom: 1px solid #e3e3e3; padding: 0.3em 0.8em 0.3em 0; vertical-align: top; }
td:last-child { overflow-wrap: anywhere; }
figure { margin: 1em 0; } figure img { max-width: 100%; } figcaption { font-size: 0.85em; color: #555; }
.formula { margin: 0.5em 0 0.5em 2em; } .formula img { vertical-align: middle; max-width: 100%; } .said { color: #555; margin-left: 1.5em; }
pre { background: #f4f4f2; padding: 0.8em; white-space: pre-wrap; overflow-wrap: anywhere; font-size: 13px; }
@media print { body { margin: 0; max-width: none; font-size: 11pt; } h2 { break-after: avoid; } table, figure, .formula { break-inside: avoid; } }
"""


def html_document(title: str, lead: str, sections: Sequence[PageSection]) -> str:
    """Return a document as one self-contained HTML file."""
    body = "\n".join(
        f"<h2>{escape(section.title)}</h2>\n" + "\n".join(block.html() for block in section.blocks)
        for section in sections
    )
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(title)}</title><style>{_STYLE}</style></head>
<body><h1>{escape(title)}</h1><p>{escape(lead)}</p>
{body}
</body></html>
"""


def markdown_document(title: str, lead: str, sections: Sequence[PageSection]) -> str:
    """Return a document as one Markdown file with pictures embedded."""
    body = "\n\n".join(
        f"## {section.title}\n\n" + "\n\n".join(block.markdown() for block in section.blocks) for section in sections
    )
    return f"# {title}\n\n{lead}\n\n{body}\n"


def formula_svg(latex: str) -> bytes:
    """Draw a formula as SVG with matplotlib's mathtext; a formula that it cannot parse is drawn as plain text."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    def figure_of(text: str) -> bytes:
        figure = Figure(figsize=(0.01, 0.01))
        figure.text(0.0, 0.0, text, fontsize=POINTS)
        content = BytesIO()
        figure.savefig(
            content,
            format="svg",
            bbox_inches="tight",
            pad_inches=0.03,
            transparent=True,
            metadata={"Date": None, "Creator": None},
        )
        return content.getvalue()

    with rc_context({"svg.hashsalt": "xdynamics", "mathtext.fontset": "cm"}):
        try:
            return figure_of(f"${latex}$")
        except ValueError:
            return figure_of(latex.replace("$", r"\$"))


def _embedded(content: bytes, kind: str) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"

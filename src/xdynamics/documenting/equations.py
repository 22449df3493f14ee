"""A model as formulas and tables, and the blocks of a document in HTML and in Markdown."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from io import BytesIO

from xdynamics.expressions import Name, Node, latex, text_of
from xdynamics.model import Model
from xdynamics.model.given_values import Values
from xdynamics.model.motion import forces_by_coordinate
from xdynamics.model.parts import Function, Parameter
from xdynamics.model.statement import Statement
from xdynamics.schema import velocity
from xdynamics.shapes.naming import display_text

POINTS = 14  # of a formula
_TAG = re.compile(r"<(?=[A-Za-z/!?])")


def plain_markdown(text: str) -> str:
    """Return a text that Markdown shows as it is: somebody's tags and links are none."""
    return _TAG.sub("&lt;", text).replace("](", "]\\(")


@dataclass(frozen=True)
class Paragraph:
    """A paragraph, optionally with its first words in bold."""

    text: str
    strong: str = ""

    def html(self) -> str:
        """Return the paragraph as HTML."""
        head = f"<strong>{escape(self.strong)}</strong> " if self.strong else ""
        return f"<p>{head}{escape(self.text)}</p>"

    def markdown(self) -> str:
        """Return the paragraph as Markdown."""
        return f"{f'**{plain_markdown(self.strong)}** ' if self.strong else ''}{plain_markdown(self.text)}"


@dataclass(frozen=True)
class Formula:
    """A formula in LaTeX, with a caption."""

    latex: str
    caption: str = ""

    def html(self) -> str:
        """Return the formula as HTML: an image with the LaTeX as its text."""
        span = f'<span class="said">{escape(self.caption)}</span>' if self.caption else ""
        return (
            f'<p class="formula"><img src="{_embedded(formula_svg(self.latex), "svg+xml")}"'
            f' alt="{escape(self.latex)}">{span}</p>'
        )

    def markdown(self) -> str:
        """Return the formula as Markdown."""
        return f"{f'{plain_markdown(self.caption)}: ' if self.caption else ''}$${_TAG.sub('{<}', self.latex)}$$"


@dataclass(frozen=True)
class TextTable:
    """Rows of texts under a header."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]

    def html(self) -> str:
        """Return the table as HTML."""
        head = "".join(f"<th>{escape(cell)}</th>" for cell in self.header)
        rows = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in self.rows)
        return f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"

    def markdown(self) -> str:
        """Return the table as Markdown."""
        lines = [self.header, ["---"] * len(self.header), *self.rows]
        return "\n".join(
            "| " + " | ".join(plain_markdown(cell).replace("|", "\\|").replace("\n", " ") for cell in row) + " |"
            for row in lines
        )


@dataclass(frozen=True)
class PictureBlock:
    """A figure as PNG, with a caption."""

    content: bytes
    caption: str

    def html(self) -> str:
        """Return the block as HTML with the picture embedded."""
        return (
            f'<figure><img src="{_embedded(self.content, "png")}"'
            f' alt="{escape(self.caption)}"><figcaption>{escape(self.caption)}</figcaption></figure>'
        )

    def markdown(self) -> str:
        """Return the block as Markdown with the picture embedded."""
        return f"![{plain_markdown(self.caption)}]({_embedded(self.content, 'png')})"


@dataclass(frozen=True)
class CodeBlock:
    """Text to be typed, or read by a program."""

    text: str

    def html(self) -> str:
        """Return the code as HTML."""
        return f"<pre>{escape(self.text)}</pre>"

    def markdown(self) -> str:
        """Return the code as Markdown."""
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
        f"## {plain_markdown(section.title)}\n\n" + "\n\n".join(block.markdown() for block in section.blocks)
        for section in sections
    )
    return f"# {plain_markdown(title)}\n\n{plain_markdown(lead)}\n\n{body}\n"


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


MOST_LISTED = 30  # elements of one quantity that are listed one by one


def model_blocks(model: Model) -> Iterator[Block]:
    """Write the equations of motion, forces, definitions, events and numbers of a model."""
    if model.description:
        yield Paragraph(model.description)
    stated = model.statement
    yield from _dimension_table(model)
    yield from (
        _motion_formulas(model) if stated.lagrangian is None or not model.shapes.dims else _energy_formulas(model)
    )
    yield from _force_formulas(model)
    for name, definition in stated.definitions.items():
        yield Formula(f"{latex(Name(name))} = {latex(definition)}", f"definition{_along_dims_text(model, name)}")
    for name, state in stated.states.items():
        caption = state.description or f"rate of {name}"
        yield Formula(rf"{_dotted_latex(name, 1)} = {latex(state.rate)}", f"{caption}{_along_dims_text(model, name)}")
    yield from _event_formulas(model)
    for name, observable in stated.observables.items():
        yield Formula(f"{latex(Name(name))} = {latex(observable)}", f"observable{_along_dims_text(model, name)}")
    yield from _drive_and_number_tables(model)


def _motion_formulas(model: Model) -> Iterator[Formula]:
    """Yield the equation of motion of each coordinate, along its dimensions."""
    stated = model.statement
    components = forces_by_coordinate(model)
    for i, name in enumerate(stated.coordinates):
        terms = [
            f"{_inertia_latex(stated, i, j)}{_dotted_latex(coordinate, 2)}"
            for j, coordinate in enumerate(stated.coordinates)
            if (i, j) in stated.mass_entries
        ]
        forces = [rf"F_{{\mathrm{{{_spaced_latex(term)}}}}}" for term, parts in components.items() if name in parts]
        right = " + ".join(forces) or "0"
        yield Formula(f"{' + '.join(terms)} = {right}", f"motion of {name}{_along_dims_text(model, name)}")


def _energy_formulas(model: Model) -> Iterator[Block]:
    """Yield the energies that a model with dimensions is derived from."""
    lagrangian = model.statement.lagrangian
    assert lagrangian is not None  # noqa: S101 - asked before
    yield Formula(f"T = {latex(lagrangian.kinetic)}", "kinetic energy")
    if lagrangian.potential is not None:
        yield Formula(f"V = {latex(lagrangian.potential)}", "potential energy")
    for name in model.statement.coordinates:
        symbol, speed = _symbol_latex(name), _symbol_latex(velocity(name))
        yield Formula(
            rf"\frac{{d}}{{dt}}\frac{{\partial T}}{{\partial {speed}}} - \frac{{\partial T}}{{\partial {symbol}}}"
            rf" = -\frac{{\partial V}}{{\partial {symbol}}}",
            f"motion of {name}{_along_dims_text(model, name)}, with the forces on it added on the right",
        )


def _dimension_table(model: Model) -> Iterator[Block]:
    """Yield the dimensions of a model's quantities, and its linked elements."""
    shapes = model.shapes
    rows = []
    for name, extent in shapes.extents.items():
        rows.append([name, str(extent.size), ", ".join(extent.labels[:MOST_LISTED]) or f"0 to {extent.size - 1}"])
    for name, relation in shapes.relations.items():
        rows.append([name, str(len(relation.first)), f"links of {relation.source} and {relation.target}"])
    if rows:
        yield TextTable(["dimension", "elements", "what"], rows)


def _along_dims_text(model: Model, name: str) -> str:
    dims = model.shapes.dims.get(name, ())
    return f", along {' and '.join(dims)}" if dims else ""


def _drive_and_number_tables(model: Model) -> Iterator[Block]:
    """Yield drives and numbers."""
    if model.drives:
        yield TextTable(
            ["drive", "of", "points", "between them", "beyond", "what"],
            [
                [
                    name,
                    text_of(drive.argument),
                    f"{len(drive.table.argument)} in {drive.table.name}",
                    drive.interpolation,
                    drive.outside,
                    drive.description,
                ]
                for name, drive in model.elements.drives.items()
            ],
        )
    yield TextTable(["number", "value", "standard uncertainty", "distribution", "what"], [*_number_rows(model)])


def _number_rows(model: Model) -> Iterator[list[str]]:
    """Yield a row for each number; for many of one quantity, or where an expression gives them, one for all."""
    elements = model.elements
    stated = model.statement
    for names, values, start_note in (
        ([*stated.parameters, *stated.arrays], stated.arrays, ""),
        ([*stated.initial, *stated.starting], stated.starting, " at the start"),
    ):
        for name in dict.fromkeys(names):
            array_values = values.get(name)
            if array_values is not None and (array_values.tree is not None or len(array_values.numbers) > MOST_LISTED):
                yield _quantity_row(f"{name}{start_note}{_along_dims_text(model, name)}", array_values)
                continue
            parts = {}
            for element in model.shapes.elements(name):
                part = elements.statement.parameters[element] if not start_note else elements.starts.get(element)
                parts[element] = part or Parameter(elements.statement.initial[element])
            first, *other_parts = parts.values()
            if other_parts and all(part == first for part in other_parts):
                yield _parameter_row(f"{name}{start_note}{_along_dims_text(model, name)}, {len(parts)} alike", first)
                continue
            for element, part in parts.items():
                yield _parameter_row(f"{display_text(element)}{start_note}", part)


def _quantity_row(name: str, values: Values) -> list[str]:
    """Return the row of all numbers of a quantity."""
    if values.tree is not None:
        return [name, text_of(values.tree), "", "", values.description]
    unit = "" if values.unit is None else f" {values.unit.text}".removesuffix(" 1")
    value_range = f"{len(values.numbers)} values from {min(values.numbers):.6g} to {max(values.numbers):.6g}{unit}"
    return [name, value_range, "", "", values.description]


def _force_formulas(model: Model) -> Iterator[Formula]:
    stated = model.statement
    for term, force in stated.forces.items():
        description = f"{term}: {force.description}" if force.description else term
        relation_note = f", summed over {force.over}" if force.over else ""
        if force.potential is not None:
            yield Formula(
                rf"V_{{\mathrm{{{_spaced_latex(term)}}}}} = {latex(force.potential)}",
                f"potential of {description}{relation_note}",
            )
        for name, part in force.components.items():
            body = (
                rf"\mathrm{{{_spaced_latex(part.name)}}}({', '.join(_symbol_latex(argument) for argument in part.arguments)})"
                if isinstance(part, Function)
                else latex(part)
            )
            on = f", on {name}" if len(model.elements.statement.coordinates) > 1 else ""
            on += f", of each link of {force.over}" if force.over else ""
            yield Formula(rf"F_{{\mathrm{{{_spaced_latex(term)}}}}} = {body}", f"{description}{on}")


def _event_formulas(model: Model) -> Iterator[Formula]:
    stated = model.statement
    for name, event in stated.events.items():
        body = (
            rf"\mathrm{{{_spaced_latex(event.function.name)}}}"
            if isinstance(event.function, Function)
            else latex(event.function)
        )
        if event.every is not None:
            first, period = (str(part).replace(" ", r"\ ") for part in (event.phase or event.every, event.every))
            yield Formula(
                rf"t = t_0 + \mathrm{{{first}}} + k \cdot \mathrm{{{period}}}",
                f"event {name}, periodic: {event.action}",
            )
            continue
        yield Formula(f"{body} = 0", f"event {name}, {event.direction}: {event.action}{_along_dims_text(model, name)}")
    for name, contact in stated.contacts.items():
        caption = f"contact {name}, restitution {_node_text(contact.restitution)}{_along_dims_text(model, name)}"
        yield Formula(rf"{latex(contact.gap)} \geq 0", caption)
    for name, constraint in stated.constraints.items():
        caption = f"constraint {name}{_along_dims_text(model, name)}, kept by the force constraint_force_{name} along its derivative"
        yield Formula(f"{latex(constraint.condition)} = 0", caption)
    for name, friction in stated.frictions.items():
        yield Formula(
            rf"\left|F\right| \leq {latex(friction.kinetic)}",
            f"friction {name}, slipping with {_node_text(friction.slip)}",
        )


def _node_text(node: Node | None) -> str:
    return "none" if node is None else text_of(node)


def _inertia_latex(stated: Statement, i: int, j: int) -> str:
    entry = latex(stated.mass_entries[i, j])
    return rf"\left({entry}\right)\," if " + " in entry or " - " in entry else rf"{entry}\,"


def _dotted_latex(name: str, times: int) -> str:
    return rf"\{'d' * times}ot{{{_symbol_latex(name)}}}"


def _symbol_latex(name: str) -> str:
    return latex(Name(name))


def _spaced_latex(name: str) -> str:
    return name.replace("_", r"\ ")


def _parameter_row(name: str, parameter: Parameter) -> list[str]:
    spread = parameter.spread
    size = "" if spread is None else f"{parameter.uncertainty:.3g} {parameter.quantity.unit.text}".removesuffix(" 1")
    return [
        name,
        str(parameter.quantity).removesuffix(" 1"),
        size,
        "" if spread is None else spread.distribution,
        parameter.description,
    ]

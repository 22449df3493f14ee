"""The table of methods, as text and as a notebook shows it."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape

from xdynamics.methods.method import Method

HEADER = ("method", "order", "kind", "evaluations", "estimate", "refuses")
NUMBERS = ("order", "evaluations")  # columns that are aligned at the right


class Methods(dict[str, Method]):
    """Methods by name, which show themselves as a table.

    Examples
    --------
    >>> import xdynamics as xd
    >>> print(xd.METHODS)  # doctest: +ELLIPSIS
    method                    order  kind ... evaluations  estimate  refuses
    ...
    >>> xd.METHODS["rk4"].order
    4
    """

    def rows(self) -> Iterator[tuple[str, ...]]:
        """Yield the cells of each method, as `HEADER` names them."""
        for method in self.values():
            work = f"{method.evaluations} {'an iteration' if method.solves else 'a step'}"
            estimate = f"order {method.estimate_order}" if method.estimate else "doubling"
            refused = ", ".join(method.refuses) or "nothing"
            yield method.name, str(method.order), step_kind(method), work, estimate, refused

    def __repr__(self) -> str:
        table = [HEADER, *self.rows()]
        widths = [max(map(len, column)) for column in zip(*table, strict=True)]
        return "\n".join(
            "  ".join(
                cell.rjust(width) if name in NUMBERS else cell.ljust(width)
                for name, cell, width in zip(HEADER, row, widths, strict=True)
            ).rstrip()
            for row in table
        )

    def _repr_html_(self) -> str:
        head = "".join(f"<th>{cell}</th>" for cell in HEADER)
        body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in self.rows())
        return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def step_kind(method: Method) -> str:
    """Return the kinds of a method's steps, in words."""
    words = {"symplectic": method.symplectic, "symmetric": method.symmetric, "implicit": bool(method.solves)}
    return ", ".join(word for word, is_so in words.items() if is_so) or "plain"

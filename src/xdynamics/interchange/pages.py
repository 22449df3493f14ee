"""What a notebook shows of a record: its summary, and its variables by their roles, in a page that stays small."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

import xarray as xr

from xdynamics.documenting.summary import summary
from xdynamics.faults import InputError
from xdynamics.record.pint_records import is_quantified, without_pint_units

LARGEST = 20_000  # characters of a page
LONGEST = 500  # of a line of the summary
MOST_LINES = 40  # of the summary
MOST_NAMED = 600  # characters of the names of a role, where the page is too small for a table of them

_pages_of_xarray = xr.Dataset._repr_html_


def page(record: xr.Dataset) -> str:
    """Return a record as HTML of at most 20 kB: the summary first, and variables by their roles, folded.

    Examples
    --------
    >>> import xdynamics as xd
    >>> run = xd.simulate(xd.Model.from_toml("data/models/ball_drag.toml"))
    >>> len(page(run)) < 20_000
    True
    """
    roles: dict[str, list[str]] = {}
    for name, variable in record.variables.items():
        roles.setdefault(str(variable.attrs.get("role", "other")).replace("_", " "), []).append(str(name))
    head = f"<pre>{escape(chr(10).join(_summary_lines(summary(record))))}</pre>"
    tables = "".join(_folded(role, names, _html_table(record, names)) for role, names in roles.items())
    if len(head) + len(tables) <= LARGEST:
        return head + tables
    names = "".join(
        _folded(role, names, f"<p>{escape(_cut_names(', '.join(names)))}</p>") for role, names in roles.items()
    )
    return (head + names)[:LARGEST]


def _summary_lines(lines: list[str]) -> list[str]:
    short_lines = [line if len(line) <= LONGEST else f"{line[:LONGEST]} … ({len(line)} characters)" for line in lines]
    more = (
        [f"… and {len(short_lines) - MOST_LINES} lines more: run.dynamics prints them"]
        if len(short_lines) > MOST_LINES
        else []
    )
    return [*short_lines[:MOST_LINES], *more]


def _cut_names(text: str) -> str:
    return text if len(text) <= MOST_NAMED else f"{text[:MOST_NAMED].rpartition(',')[0]}, …"


def _folded(role: str, names: list[str], body: str) -> str:
    return f"<details><summary>{escape(role)}: {len(names)}</summary>{body}</details>"


def _html_table(record: xr.Dataset, names: list[str]) -> str:
    rows = "".join(_html_row(name, record.variables[name].dims, record.variables[name].attrs) for name in names)
    return f"<table>{rows}</table>"


def _html_row(name: str, dims: Any, attributes: Mapping[Any, Any]) -> str:
    cells = name, ", ".join(map(str, dims)), str(attributes.get("units", "")), str(attributes.get("long_name", ""))
    return f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in cells)}</tr>"


def show_pages() -> None:
    """Let notebooks show records by `page`; other Datasets, and those that lack parts of a record, as xarray does."""

    def html_page(self: xr.Dataset) -> str:
        if "xdynamics" not in str(self.attrs.get("Conventions", "")):
            return _pages_of_xarray(self)
        try:
            return page(without_pint_units(self) if is_quantified(self) else self)
        except (InputError, KeyError, ValueError):
            return _pages_of_xarray(self)

    xr.Dataset._repr_html_ = html_page  # type: ignore[method-assign]

"""A record in a notebook: its summary, its variables by their roles, in a page that stays small.

xarray's verbs do not know that the rows of a run are steps. Where they are asked for a time, a note says what gives
states between the rows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import wraps
from html import escape
from typing import Any

import numpy as np
import xarray as xr

from xdynamics.documenting.summary import summary
from xdynamics.faults import InputError
from xdynamics.record.pint_records import is_quantified, without_pint_units
from xdynamics.schema import STEPS

LARGEST = 20_000  # characters of a page
LONGEST = 500  # of a line of the summary
MOST_LINES = 40  # of the summary
MOST_NAMED = 600  # characters of the names of a role, where the page is too small for a table of them

# taken before `show_pages` puts another method in its place
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


NOTED = ("sel", "interp", "drop_sel", "resample", "groupby", "groupby_bins", "rolling", "coarsen")
# a name that is no index is left out of these by xarray without a word
REFUSED = ("reindex", "reindex_like", "interp_like")
REDUCED = ("mean", "std", "var", "sum", "median", "max", "min")
LONGEST_NOTE = 60  # characters of times that a note repeats
REMEDY = (
    "xdynamics: rows of a run are its steps, two at an event, and none ends at just any time: run.dynamics.at({0}) gives the"
    " states there, each as if a step had ended there; run.sel(time=slice(…)) gives the rows of a span"
)


OVER_TIME = (
    "xdynamics: rows of a run are its steps, which crowd where it is fast: a mean over time takes even"
    " times, run.dynamics.at(np.linspace(0, 5, 1001)).x.mean('at'), and run.x.mean('step') is that of its rows"
)


def show_time_notes() -> None:
    """Wrap xarray's verbs for times of a run: errors name `run.dynamics.at`, and verbs without effect are refused."""
    for kind in (xr.Dataset, xr.DataArray):
        for verb in (*NOTED, *REDUCED, *REFUSED):
            method = getattr(kind, verb)
            # a second call must not wrap what is wrapped
            if not hasattr(method, "notes_times"):
                note = OVER_TIME if verb in REDUCED else REMEDY
                setattr(kind, verb, _refusing(method) if verb in REFUSED else _noting(method, note))


def _noting(method: Callable[..., Any], note: str) -> Callable[..., Any]:
    """Return the method with a note below its errors."""

    @wraps(method)
    def noting_call(self: Any, *arguments: Any, **keywords: Any) -> Any:
        try:
            return method(self, *arguments, **keywords)
        except Exception as error:
            requested_times = _requested_times(arguments, keywords)
            # xarray's verbs call one another: the inner one has added the note already
            if requested_times is not None and _is_of_steps(self) and not getattr(error, "__notes__", None):
                error.add_note(note.format(_times_text(requested_times)))
            raise

    noting_call.notes_times = True  # type: ignore[attr-defined]
    return noting_call


def _refusing(method: Callable[..., Any]) -> Callable[..., Any]:
    """Return the method, which refuses times of a run: without a word it would give the rows as they were."""

    @wraps(method)
    def refusing_call(self: Any, *arguments: Any, **keywords: Any) -> Any:
        requested_times = _requested_times(arguments, keywords)
        if requested_times is not None and _is_of_steps(self):
            raise InputError(f"{method.__name__} cannot follow time. {REMEDY.format(_times_text(requested_times))}")
        return method(self, *arguments, **keywords)

    refusing_call.notes_times = True  # type: ignore[attr-defined]
    return refusing_call


def _requested_times(arguments: tuple[Any, ...], keywords: Mapping[str, Any]) -> Any:
    """Return the requested times: by name, in a mapping, of another record, or all; None if none are."""
    first = (
        arguments[0] if arguments else {name: keywords[name] for name in ("other", "group", "dim") if name in keywords}
    )
    if isinstance(first, str):  # groupby("time")
        return ... if first == "time" else None
    if isinstance(first, xr.Dataset | xr.DataArray):
        return first["time"].values if "time" in first.indexes else None
    indexers = first if isinstance(first, Mapping) else {}
    if any(isinstance(value, str) and value == "time" for value in indexers.values()):  # mean(dim="time")
        return ...
    return {**indexers, **keywords}.get("time")


def _times_text(times: Any) -> str:
    """Return times as they may be typed; of many, that they are."""
    text = repr(times.tolist() if hasattr(times, "tolist") else times)
    return text if isinstance(times, int | float | list | np.ndarray) and len(text) <= LONGEST_NOTE else "times"


def _is_of_steps(data: Any) -> bool:
    """Whether `time` is that of a run's rows, in a record or in one of its variables."""
    time = data.coords.get("time") if isinstance(data, xr.Dataset | xr.DataArray) else None
    return time is not None and time.dims == (STEPS,) and time.attrs.get("role") == "time"

"""What is marked on the lines of a run: events by name and kind, regimes as bands."""

from __future__ import annotations

import re
from collections import Counter
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from xdynamics.faults import escaped
from xdynamics.figures.placing import EVENT
from xdynamics.record.flag_words import words_of
from xdynamics.record.partial_records import is_whole
from xdynamics.schema import contact_force, friction_force
from xdynamics.shapes import parted, spoken
from xdynamics.units import SECONDS, unit_suffix

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_NAMED = 6  # kinds of events at their marks
MOST_MARKED = 40  # events in a panel, from where on a legend names them
MOST_IN_LEGEND = 8  # kinds of events
MOST_BORDERS = 12  # of regimes that are named
MOST_BANDS = 400  # of regimes; what changes more often is not distinguished
SHORTEST_NAMED = 0.08  # of the span, for a regime to be named in its band
MARKERS = {
    "impact": "v",
    "rest": "s",
    "takeoff": "^",
    "stick": "s",
    "slip": "D",
    "regime_switch": "X",
    "reset": "P",
    "touch": "d",
}
PLAIN = ("crossing", "regime_switch", "reset")  # kinds that an event's own name is enough for
COLOURS = ("#1f5a96", "#c8501e", "#3a8f5c", "#7a4fa0", "#8c6d1f", "#7a7a7a")


_POWERS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_UNIT = re.compile(r"(?<![A-Za-z])([A-Za-z_]+)(-?[1-9][0-9]?)?(?= |$)")


def INK() -> str:  # noqa: N802 - a colour, that of the sheet's text
    """The colour of text and marks."""
    from matplotlib import rcParams

    return str(rcParams["text.color"])


def typeset(units: str) -> str:
    """Typeset a unit with superscripts: ``m s⁻¹``.

    Examples
    --------
    >>> typeset("kg m2 s-2")
    'kg m² s⁻²'
    """
    return _UNIT.sub(lambda match: match[1] + (match[2] or "").translate(_POWERS), units)


def timed(time: xr.DataArray, what: str = "time") -> str:
    """Label a time axis with its unit; without one if the model's time is dimensionless."""
    units = str(time.attrs.get("units", SECONDS.text))
    return what if units == "1" else f"{what} ({units})"


def at_time(time: xr.DataArray, value: float, digits: int = 6) -> str:
    """Write a time with its unit."""
    return f"t = {value:.{digits}g}{unit_suffix(str(time.attrs.get('units', SECONDS.text)))}"


def words(text: Any) -> str:
    """Escape a record's text for a figure, so that it has no formula and no invisible characters."""
    return escaped(spoken(str(text))).replace("$", r"\$")


def shade_regimes(run: xr.Dataset, axes: Axes) -> None:
    """Shade the time that each regime lasts, and name it, where there are several."""
    if "regime" not in run or len(names := run["regime"].attrs["flag_meanings"].split()) < 2:
        return
    time, regime = run["time"].values, run["regime"].values
    flags = np.atleast_1d(run["regime"].attrs["flag_values"]).tolist()
    edges = np.concatenate([[0], np.flatnonzero(np.diff(regime)) + 1, [len(regime)]])
    for first, last in list(pairwise(edges))[:MOST_BANDS]:
        place = flags.index(int(regime[first]))
        end = time[min(last, len(time) - 1)]
        axes.axvspan(time[first], end, color=COLOURS[place % len(COLOURS)], alpha=0.07, linewidth=0)
        if len(edges) <= MOST_BORDERS and end - time[first] > SHORTEST_NAMED * (time[-1] - time[0]):
            axes.annotate(
                words(names[place]),
                ((time[first] + end) / 2, 1.0),
                xycoords=("data", "axes fraction"),
                xytext=(0, -9),
                textcoords="offset points",
                ha="center",
                fontsize=7,
                color="#555555",
            )


def mark_events(run: xr.Dataset, names: list[str], axes: Axes) -> bool:
    """Mark every event on the line that it concerns; at the first of each kind stand its name and how many there are.

    Returns
    -------
    bool
        Whether there are so many that a legend names them.
    """
    if not _has_rows_of_events(run):
        return False
    rows, times = run["event_row_before"].values, run["time"].values
    detectors, kinds = words_of(run["event_detector"]), words_of(run["event_kind"])
    pairs = [*zip(detectors, kinds, strict=True)]
    if len({*pairs}) > MOST_NAMED:  # elements of one event together
        pairs = [(parted(name)[0], kind) for name, kind in pairs]
    happened = [name if kind in PLAIN else f"{name} {kind}" for name, kind in pairs]
    lines = {name: run[_line_of_event(run, name, names)].values for name in {*detectors}}
    heights = np.array([lines[name][row] for name, row in zip(detectors, rows, strict=True)])
    counts, is_many = Counter(happened), len(happened) > MOST_MARKED
    labels: dict[
        int, list[str]
    ] = {}  # by the event that is the first of its kind, or by what happened at once before it
    for n, (what, count) in enumerate(counts.items()):
        chosen = np.array([name == what for name in happened])
        first = int(np.flatnonzero(chosen)[0])
        marker = MARKERS.get(kinds[first], "ovsD^P*X"[n % 8])
        (marks,) = axes.plot(times[rows[chosen]], heights[chosen], marker, color=INK(), markersize=4.5, zorder=3)
        marks.set_markerfacecolor("none")
        if is_many:
            marks.set_label(words(counted(what, count)) if n < MOST_IN_LEGEND else "")
            continue
        place = next(
            (event for event in labels if (rows[event], heights[event]) == (rows[first], heights[first])), first
        )
        if n <= MOST_NAMED:
            more = f"and {len(counts) - n} more kinds"
            labels.setdefault(place, []).append(counted(what, count) if n < MOST_NAMED else more)
    for event, texts in labels.items():
        text = words(", ".join(texts))
        axes.annotate(
            text, (times[rows[event]], heights[event]), (5, 5), textcoords="offset points", fontsize=7.5, gid=EVENT
        )
    return is_many


def _has_rows_of_events(run: xr.Dataset) -> bool:
    """Whether events and their rows are there: of a selection, the rows that events name are those of the run."""
    if not run.sizes.get("event", 0) or not is_whole(run.attrs):
        return False
    if not {"event_detector", "event_kind", "event_row_before", "event_time"} <= set(run.variables):
        return False
    rows, times = run["event_row_before"].values, run["time"].values
    return np.array_equal(times[np.clip(rows, 0, times.size - 1)], run["event_time"].values)  # else rows were left out


def counted(what: str, count: int) -> str:
    """Name what happens once, and count what happens more often.

    Examples
    --------
    >>> counted("floor impact", 23)
    'floor impact ×23'
    """
    return what if count == 1 else f"{what} ×{count}"


def _line_of_event(run: xr.Dataset, detector: str, names: list[str]) -> str:
    """Return the line that an event concerns: its contact's own force, or the first that its function, gap or slip names."""
    variables, forces = run.variables, (contact_force(detector), friction_force(detector))
    if own_forces := [name for name in names if name in forces]:
        return own_forces[0]
    texts = [
        variables[entry].attrs.get(key, "")
        for entry, key in zip(forces, ("gap", "slip"), strict=True)
        if entry in variables
    ]
    functions = str(variables["event_detector"].attrs.get("functions", ""))
    texts += [entry.partition(": ")[2] for entry in functions.split("; ") if entry.startswith(f"{detector}: ")]
    symbols = re.findall(r"[A-Za-z_]\w*", " ".join(map(str, texts)))
    # a gap that reads a coordinate concerns its velocity too, and a slip that reads a velocity its coordinate
    matches = [name for name in names if {name, name.removeprefix("v_"), f"v_{name}"} & set(symbols)]
    return matches[0] if matches else names[0]

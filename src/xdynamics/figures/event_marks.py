"""Events on the lines of a run: few are named where they happen, many in a legend, very many are counted alone."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.figures.element_maps import model_shapes
from xdynamics.figures.marks import INK, escaped_text
from xdynamics.figures.sheet import EVENT
from xdynamics.reaction_names import contact_force, friction_force
from xdynamics.record.flag_words import words_of_flag
from xdynamics.record.named_rows import rows_named
from xdynamics.record.schemas import is_run
from xdynamics.schema import at_event
from xdynamics.shapes import split_element_name

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_NAMED = 6  # kinds of events at their marks
MOST_ALIKE = 3  # events of one kind, whose name stands at the first
MOST_MARKED = 40  # events in a panel, from where on a legend names them
MOST_DRAWN, SELDOM = 120, 20  # events in a panel, from where on kinds that are not seldom are counted and not drawn
MOST_IN_LEGEND = 8  # kinds of events
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
OTHER_MARKERS = "ovsD^P*X"
PLAIN = ("crossing", "regime_switch", "reset")  # kinds that an event's own name is enough for
IN_LEGEND = "events"  # the mark of lines that a legend names for all panels
ENDS = ("first", "second")  # of a relation: the elements that met
NOWHERE = {"none", "-1"}  # labels of no element
KINK = re.compile(r"\.(abs|min|max)\b")  # in the name of a switch that nobody named: the force bends there, no more
Rows = NDArray[np.int64]


@dataclass(frozen=True)
class EventKind:
    """Events of one name and kind.

    Attributes
    ----------
    name : str
        With how many there are.
    detector, marker : str
    events : ndarray of int
        Numbers along `event`.
    is_drawn : bool
        Whether each is marked; else they are counted alone.
    """

    name: str
    detector: str
    marker: str
    events: Rows
    is_drawn: bool

    @property
    def style(self) -> dict[str, Any]:
        """How each is marked; the legend shows no marker of what is not drawn."""
        marker = self.marker if self.is_drawn else "none"
        return {"color": INK(), "markerfacecolor": "none", "zorder": 3, "linestyle": "none", "marker": marker}

    @property
    def marked_events(self) -> Rows:
        """The events that are marked."""
        return self.events if self.is_drawn else self.events[:0]


def counted_name(event_name: str, count: int, *, is_drawn: bool = True) -> str:
    """Name what happens once, and count what happens more often.

    Examples
    --------
    >>> counted_name("floor impact", 23)
    'floor impact ×23'
    >>> counted_name("floor impact", 2300, is_drawn=False)
    'floor impact ×2300, not marked'
    """
    return (event_name if count == 1 else f"{event_name} ×{count}") + ("" if is_drawn else ", not marked")


def event_kinds(run: xr.Dataset) -> list[EventKind]:
    """Return the events of a run by name and kind, in the order in which they first happen; without kinks of forces."""
    detectors, kinds = words_of_flag(run["event_detector"]), words_of_flag(run["event_kind"])
    pairs = [*zip(detectors, kinds, strict=True)]
    if len({*pairs}) > MOST_NAMED:  # elements of one event together
        pairs = [(split_element_name(name)[0], kind) for name, kind in pairs]
    counts = Counter(pairs)
    for pair in [pair for pair in counts if KINK.search(pair[0])]:
        del counts[pair]
    numbers: dict[tuple[str, str], list[int]] = {pair: [] for pair in counts}
    for number, pair in enumerate(pairs):
        if pair in numbers:
            numbers[pair].append(number)
    are_many = counts.total() > MOST_DRAWN
    return [
        EventKind(
            counted_name(name if kind in PLAIN else f"{name} {kind}", count, is_drawn=not are_many or count <= SELDOM),
            name,
            _marker_of(kind, n, [earlier for _, earlier in [*counts][:n]]),
            np.array(numbers[name, kind]),
            not are_many or count <= SELDOM,
        )
        for n, ((name, kind), count) in enumerate(counts.items())
    ]


def _marker_of(kind: str, n: int, earlier: list[str]) -> str:
    """Return the marker of the n-th kind: what an event does has its own, the second event that does it another."""
    is_taken = kind in PLAIN and kind in earlier
    return OTHER_MARKERS[n % len(OTHER_MARKERS)] if is_taken or kind not in MARKERS else MARKERS[kind]


def are_in_legend(kinds: list[EventKind]) -> bool:
    """Whether a legend names events: there are many, or many of one kind."""
    sizes = [kind.events.size for kind in kinds]
    return sum(sizes) > MOST_MARKED or max(sizes, default=0) > MOST_ALIKE


def legend_label(kinds: list[EventKind], n: int, axes: Axes) -> str:
    """Return the name of a kind in the legend; nothing where another panel of the sheet has named all of them."""
    if n > MOST_IN_LEGEND or any(_has_legend(panel_axes) for panel_axes in axes.figure.axes if panel_axes is not axes):
        return ""
    further_kinds = f"and {len(kinds) - n} more kinds"
    return escaped_text(further_kinds if n == MOST_IN_LEGEND and len(kinds) > n + 1 else kinds[n].name)


def _has_legend(axes: Axes) -> bool:
    """Whether the legend of some axes names events."""
    return any(line.get_gid() == IN_LEGEND and not str(line.get_label()).startswith("_") for line in axes.lines)


def mark_events(run: xr.Dataset, names: list[str], axes: Axes) -> bool:
    """Mark events on the lines that they concern; at the first of each kind stands its name, or a legend has it.

    Returns
    -------
    bool
        Whether a legend names them.
    """
    if not _has_rows_of_events(run):
        return False
    kinds = event_kinds(run)
    heights = EventHeights(run, names)
    if are_in_legend(kinds):
        for n, kind in enumerate(kinds):
            label, events = legend_label(kinds, n, axes), kind.marked_events
            times = run.variables["event_time"].values[events]
            axes.plot(times, heights.heights_of(kind, events), label=label, gid=IN_LEGEND, **kind.style)
        return _has_legend(axes)
    _name_at_marks(run, kinds, heights, axes)
    return False


def _name_at_marks(run: xr.Dataset, kinds: list[EventKind], heights: EventHeights, axes: Axes) -> None:
    """Mark few events; at the first of each kind stands its name, together with what happens there at once."""
    labels: dict[tuple[int, float], list[str]] = {}
    rows, times = rows_named(run, "event_row_before"), run.variables["time"].values
    for n, kind in enumerate(kinds):
        height = heights.heights_of(kind, kind.events)
        axes.plot(times[rows[kind.events]], height, markersize=4.5, **kind.style)
        if n <= MOST_NAMED:
            mark_point = int(rows[kind.events[0]]), float(height[0])
            further_kinds = f"and {len(kinds) - n} more kinds"
            labels.setdefault(mark_point, []).append(kind.name if n < MOST_NAMED else further_kinds)
    for (row, first), texts in labels.items():
        text = escaped_text(", ".join(texts))
        axes.annotate(text, (times[row], first), (5, 5), textcoords="offset points", fontsize=7.5, gid=EVENT)


def _has_rows_of_events(run: xr.Dataset) -> bool:
    """Whether events and their rows are there."""
    if not run.sizes.get("event", 0) or not is_run(run.attrs):
        return False
    if not {"event_detector", "event_kind", "event_row_before", "event_time"} <= set(run.variables):
        return False
    return bool((rows_named(run, "event_row_before") >= 0).all())


class EventHeights:
    """Where events are on the lines of a panel: each on the line of its own element."""

    def __init__(self, run: xr.Dataset, names: list[str]) -> None:
        self.run, self.names = run, names
        self.concerned = concerned_elements(run)

    def heights_of(self, kind: EventKind, events: Rows) -> NDArray[np.float64]:
        """Return the heights of some events."""
        lines, rows = self._concerned_lines(kind.detector), rows_named(self.run, "event_row_before")
        own_lines = [self._own_line(lines, int(event)) for event in events]
        return np.array(
            [float(self.run[name].values[rows[event]]) for name, event in zip(own_lines, events, strict=True)]
        )

    def _own_line(self, lines: list[str], event: int) -> str:
        """Return, of the lines of elements, that with the most labels of an event's own elements."""
        return max(lines, key=lambda name: len(self.concerned[event] & {*split_element_name(name)[1]}))

    def _concerned_lines(self, detector: str) -> list[str]:
        """Return the lines that an event may concern: its contact's own force, or those that its function, gap or slip names."""
        variables, forces = self.run.variables, (contact_force(detector), friction_force(detector))
        if own_forces := [name for name in self.names if split_element_name(name)[0] in forces]:
            return own_forces
        texts = [
            variables[entry].attrs.get(key, "")
            for entry, key in zip(forces, ("gap", "slip"), strict=True)
            if entry in variables
        ]
        flag = variables["event_detector"].attrs
        described = f"{flag.get('functions', '')}; {flag.get('contact_gaps', '')}".split("; ")
        texts += [entry.partition(": ")[2] for entry in described if entry.startswith(f"{detector}: ")]
        symbols = {*re.findall(r"[A-Za-z_]\w*", " ".join(map(str, texts)))}
        # a gap that reads a coordinate concerns its velocity too, and a slip that reads a velocity its coordinate
        quantity_by_name = {name: split_element_name(name)[0] for name in self.names}
        matches = [
            name
            for name in self.names
            if {name, quantity_by_name[name], quantity_by_name[name].removeprefix("v_"), f"v_{quantity_by_name[name]}"}
            & symbols
        ]
        return matches or self.names[:1]


def concerned_elements(run: xr.Dataset) -> list[frozenset[str]]:
    """Return the labels of the elements that each event concerns; none of an event of single coordinates."""
    shapes = model_shapes(run)
    columns = [
        words_of_flag(run[name])
        if run.variables[name].attrs.get("role") == "flag"
        else [str(number) for number in run.variables[name].values]
        for name in map(at_event, (*shapes.extents, *ENDS))
        if name in run.variables
    ]
    return [frozenset({*labels} - NOWHERE) for labels in zip(*columns, strict=True)] or [frozenset()] * run.sizes[
        "event"
    ]

"""Figures of runs: drawn from the record alone, against recorded times, with units and events."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.archive.target import check_target, taking_name
from xdynamics.faults import ArchiveError, InputError, escaped
from xdynamics.record import check
from xdynamics.record.kinds import is_whole
from xdynamics.schema import STEPS, velocity
from xdynamics.summary import event_names

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg", ".pdf")
FEW_ROWS = 400  # up to which every accepted state is a dot
DRAWN = 4000  # points of a line; what is longer is thinned
MOST_LABELLED = 12
MOST_BANDS = 400  # of regimes; what changes more often is not told apart
SHORTEST_NAMED = 0.08  # of the span, for a regime to be named in its band

Rows = NDArray[np.int64]
_COLOURS = ("#1f5a96", "#c8501e", "#3a8f5c", "#7a4fa0", "#8c6d1f", "#4c4c4c")


_PARTS = {"event_time_uncertainty_bracket": "width of the bracket", "event_time_uncertainty": "uncertainty"}
FEWEST_LOCATED = 3  # events, from which on a panel tells more than their list


def plot(run: xr.Dataset, path: str | Path | None = None) -> Figure:
    """Draw trajectory, velocity, phase portrait, energy error and step size of a run.

    Lines of more than 4,000 points are thinned for drawing by keeping the least and the greatest value of each stretch;
    the record keeps every row.

    Parameters
    ----------
    run : xarray.Dataset
        A run record.
    path : str or Path, optional
        Where to write the figure: PNG, SVG or PDF by its ending.

    Raises
    ------
    InputError
        If the Dataset has no recorded times, or the ending is another, or the folder does not exist.
    """
    from matplotlib.figure import Figure

    if path is not None:
        _check_path(Path(path))
    if "time" not in run.variables or run["time"].dims != (STEPS,) or not run["time"].size:
        raise InputError("plot needs a run record with 'time' along 'step'")
    check(run, whole=False, values=False)
    panels = list(_panels(run))
    if not panels:
        raise InputError(
            f"there is nothing along '{STEPS}' to draw among {', '.join(map(str, run.data_vars)) or 'nothing'}"
        )
    rows = (len(panels) + 1) // 2
    figure = Figure(figsize=(11, 2.9 * rows + 0.7), layout="constrained")
    grid = figure.subplots(rows, 2, squeeze=False)
    for axes in grid.flat[len(panels) :]:
        axes.set_visible(False)
    for axes, draw in zip(grid.flat, panels, strict=False):
        draw(axes)
        axes.grid(color="#e3e3e3", linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
    attributes = run.attrs
    figure.suptitle(_words(attributes.get("title", "run")), x=0.01, ha="left", fontsize=13)
    outcome = f"{attributes.get('run_outcome', '')}: {attributes.get('run_outcome_text', '')}"
    figure.supxlabel(_words(outcome[:180]), fontsize=8, color="#555555", x=0.01, ha="left")
    if path is not None:
        _write(figure, Path(path))
    return figure


def thinned(values: NDArray[Any], most: int = DRAWN) -> Rows:
    """Return rows to draw: all, or the least and the greatest of each stretch, in order, with both ends."""
    n = len(values)
    if n <= most:
        return np.arange(n)
    edges = np.linspace(0, n, most // 2 + 1).astype(np.int64)
    kept = [np.array([0, n - 1])]
    for begin, end in pairwise(edges):
        part = values[begin:end]
        kept.append(begin + np.array([np.argmin(part), np.argmax(part)]))
    return np.unique(np.concatenate(kept))


def _panels(run: xr.Dataset) -> Iterator[Callable[[Axes], None]]:
    """Yield what draws each panel, in reading order."""
    coordinates = _with_role(run, "coordinate")
    for names in _by_unit(run, coordinates):
        yield partial(_against_time, run, names, "trajectory")
    moving = [name for name in coordinates if _drawn(run, velocity(name))]
    for names in _by_unit(run, [velocity(name) for name in moving]):
        yield partial(_against_time, run, names, "velocity")
    for names in _by_unit(run, _with_role(run, "state")):
        yield partial(_against_time, run, names, "first-order state")
    for names in _by_unit(run, _with_role(run, "reaction")):
        yield partial(_against_time, run, names, "contact and friction")
    for names in _by_unit(run, moving):
        yield partial(_phase, run, names)
    if _drawn(run, "total_energy"):
        yield partial(_energy, run)
    if _drawn(run, "step_size", "trial_reason", "trial_step_size", "trial_time"):
        yield partial(_steps, run)
    if _drawn(run, "error_norm"):
        yield partial(_errors, run)
    if run.sizes.get("event", 0) >= FEWEST_LOCATED and {*_PARTS} <= set(run.variables):
        yield partial(_locations, run)


def _against_time(run: xr.Dataset, names: list[str], what: str, axes: Axes) -> None:
    time = run["time"].values
    for colour, name in zip(_cycled(names), names, strict=True):
        values = run[name].values
        rows = thinned(values)
        dots = "." if len(values) < FEW_ROWS else ""  # between long steps the line is only a line
        axes.plot(time[rows], values[rows], dots + "-", color=colour, linewidth=1.2, markersize=4, label=_words(name))
    axes.set(xlabel="time (s)", ylabel=_words(f"{_joined(names)} ({run[names[0]].attrs['units']})"))
    axes.set_title(what, loc="left", fontsize=10)
    _shade_regimes(run, axes)
    _mark_events(run, names, axes)
    if len(names) > 1:
        axes.legend(fontsize=8, frameon=False)


def _shade_regimes(run: xr.Dataset, axes: Axes) -> None:
    """Shade the time that each regime lasts, and name it, where there are several."""
    if not _drawn(run, "regime") or len(words := run["regime"].attrs["flag_meanings"].split()) < 2:
        return
    time, regime = run["time"].values, run["regime"].values
    flags = np.atleast_1d(run["regime"].attrs["flag_values"]).tolist()
    edges = np.concatenate([[0], np.flatnonzero(np.diff(regime)) + 1, [len(regime)]])
    for first, last in list(pairwise(edges))[:MOST_BANDS]:
        place = flags.index(int(regime[first]))
        end = time[min(last, len(time) - 1)]
        axes.axvspan(time[first], end, color=_COLOURS[place % len(_COLOURS)], alpha=0.07, linewidth=0)
        if len(edges) <= MOST_LABELLED and end - time[first] > SHORTEST_NAMED * (time[-1] - time[0]):
            axes.annotate(
                _words(words[place]), ((time[first] + end) / 2, 1.0), xycoords=("data", "axes fraction"), xytext=(0, -9),
                textcoords="offset points", ha="center", fontsize=7, color="#555555",
            )  # fmt: skip


def _mark_events(run: xr.Dataset, names: list[str], axes: Axes) -> None:
    """Mark every event on the first line, and name each kind once."""
    if not run.sizes.get("event", 0) or not is_whole(run.attrs):
        return  # of a selection, the rows that events name are those of the run
    if not {"event_detector", "event_row_before", "event_time"} <= set(run.variables):
        return
    rows, every = run["event_row_before"].values, run["time"].values
    if not np.array_equal(every[np.clip(rows, 0, every.size - 1)], run["event_time"].values):
        return  # rows were left out since
    detectors = event_names(run)
    time, values = every[rows], run[names[0]].values[rows]
    labels: dict[int, list[str]] = {}  # by the row at which a kind is met first: what is met at once is named at once
    for n, detector in enumerate(dict.fromkeys(detectors)):
        chosen = np.array([one == detector for one in detectors])
        marker = "ovsD^P*X"[n % 8]
        axes.plot(
            time[chosen], values[chosen], marker, color="black", markersize=4.5, markerfacecolor="white", zorder=3
        )
        if n < MOST_LABELLED:
            labels.setdefault(int(rows[chosen][0]), []).append(detector)
    for row, named in labels.items():
        place = int(np.flatnonzero(rows == row)[0])
        axes.annotate(
            _words(", ".join(named)),
            (time[place], values[place]),
            textcoords="offset points",
            xytext=(5, 5),
            fontsize=7.5,
        )


def _phase(run: xr.Dataset, names: list[str], axes: Axes) -> None:
    for colour, name in zip(_cycled(names), names, strict=True):
        position, speed = run[name].values, run[velocity(name)].values
        rows = np.union1d(thinned(position), thinned(speed))
        axes.plot(position[rows], speed[rows], color=colour, linewidth=1.0, label=_words(name))
        axes.plot(position[:1], speed[:1], "o", color=colour, markersize=4)
    units, per_second = run[names[0]].attrs["units"], run[velocity(names[0])].attrs["units"]
    axes.set(
        xlabel=_words(f"{_joined(names)} ({units})"),
        ylabel=_words(f"{_joined([velocity(name) for name in names])} ({per_second})"),
    )
    axes.set_title("phase portrait (dot: start)", loc="left", fontsize=10)
    if len(names) > 1:
        axes.legend(fontsize=8, frameon=False)


def _energy(run: xr.Dataset, axes: Axes) -> None:
    energy = run["total_energy"]
    values = energy.values - energy.values[0]
    rows = thinned(values)
    axes.plot(run["time"].values[rows], values[rows], color=_COLOURS[1], linewidth=1.0)
    axes.set(xlabel="time (s)", ylabel=_words(f"E - E(0) ({energy.attrs['units']})"))
    axes.set_title(
        _words(f"total energy less its start, {float(energy[0]):.6g} {energy.attrs['units']}"), loc="left", fontsize=10
    )


def _steps(run: xr.Dataset, axes: Axes) -> None:
    """Draw the steps on a logarithmic scale; an event's second row has none."""
    size, time = run["step_size"].values, run["time"].values
    taken = np.flatnonzero(size > 0)
    rows = taken[thinned(size[taken])] if len(taken) else taken
    axes.plot(time[rows], size[rows], ".", color=_COLOURS[5], markersize=2.5, label="accepted")
    about = run["trial_reason"].attrs
    words = np.array(about["flag_meanings"].split()) if about["role"] == "flag" else np.zeros(0, "U")
    failed = np.atleast_1d(about["flag_values"])[words == "error_test"] if words.size else words
    chosen = np.flatnonzero(np.isin(run["trial_reason"].values, failed))
    if len(chosen):
        chosen = chosen[thinned(run["trial_step_size"].values[chosen])]
        axes.plot(run["trial_time"].values[chosen], run["trial_step_size"].values[chosen], "x", color=_COLOURS[1],
                  markersize=3.5, markeredgewidth=0.8, label="rejected by the error test")  # fmt: skip
        axes.legend(fontsize=8, frameon=False)
    if len(rows):
        axes.set_yscale("log")
    axes.set(xlabel="time (s)", ylabel="step size (s)")
    axes.set_title("step used to reach each state", loc="left", fontsize=10)


def _errors(run: xr.Dataset, axes: Axes) -> None:
    """Draw the error norm of every accepted step; 1 is what the tolerances allow."""
    norm, time = run["error_norm"].values, run["time"].values
    taken = np.flatnonzero(norm > 0)
    rows = taken[thinned(norm[taken])] if len(taken) else taken
    axes.plot(time[rows], norm[rows], ".", color=_COLOURS[2], markersize=2.5)
    axes.axhline(1.0, color="#777777", linewidth=0.8, linestyle="--")
    if len(rows):
        axes.set_yscale("log")
    axes.set(xlabel="time (s)", ylabel="scaled local error (1)")
    axes.set_title("local error over what the tolerances allow", loc="left", fontsize=10)


def _locations(run: xr.Dataset, axes: Axes) -> None:
    """Draw how wide the bracket of each event is, and how well its time is known."""
    time = run["event_time"].values
    for name, marker, colour in zip(_PARTS, "_.", (_COLOURS[0], _COLOURS[1]), strict=True):
        values = run[name].values
        shown = (values > 0) & np.isfinite(values)
        axes.plot(time[shown], values[shown], marker, color=colour, markersize=5, label=_words(_PARTS[name]))
    axes.set_yscale("log")
    axes.set(xlabel="time (s)", ylabel="located within (s)")
    axes.set_title("events: bracket, and uncertainty of the time", loc="left", fontsize=10)
    axes.legend(fontsize=8, frameon=False)


def _with_role(run: xr.Dataset, role: str) -> list[str]:
    return [
        str(name) for name, one in run.data_vars.items() if one.attrs.get("role") == role and _drawn(run, str(name))
    ]


def _drawn(run: xr.Dataset, *names: str) -> bool:
    """Whether there are rows of all of these, as in a whole record there are."""
    return all(name in run and run[name].dims[:1] in ((STEPS,), ("trial",)) for name in names)


def _by_unit(run: xr.Dataset, names: list[str]) -> list[list[str]]:
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(run[name].attrs["units"], []).append(name)
    return list(groups.values())


def _cycled(names: list[str]) -> list[str]:
    return [_COLOURS[i % len(_COLOURS)] for i in range(len(names))]


def _words(text: Any) -> str:
    """Return a record's text as it is to be read in a figure: no formula, nothing unseen."""
    return escaped(str(text)).replace("$", r"\$")


def _joined(names: list[str]) -> str:
    return ", ".join(names) if len(names) <= 4 else f"{names[0]} … {names[-1]}"


def _write(figure: Figure, path: Path) -> None:
    """Write a figure whole, or not at all."""
    ending = path.suffix.lower()
    drawn = BytesIO()
    figure.savefig(drawn, format=ending[1:], dpi=130, metadata={"Date": None} if ending == ".svg" else None)
    try:
        with taking_name(path) as new:
            new.part.write_bytes(drawn.getvalue())
    except ArchiveError as error:
        raise InputError(f"figure {error}") from None


def _check_path(path: Path) -> None:
    if path.suffix.lower() not in FORMATS:
        raise InputError(f"figure '{path}' has the ending '{path.suffix}'; there are {', '.join(FORMATS)}")
    try:
        check_target(path)
    except InputError as error:
        raise InputError(f"figure {error}") from None

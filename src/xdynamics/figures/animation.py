"""The motion in the plane as a film: bodies with their trails, and the time."""

from __future__ import annotations

import shutil
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics.archive.place import Given, Place, placed
from xdynamics.faults import InputError
from xdynamics.figures.marks import COLOURS, at_time, words
from xdynamics.figures.plane import MOST_BODIES, left_out, views
from xdynamics.figures.sheet import check_path, kept, lit
from xdynamics.record import of_elements

if TYPE_CHECKING:
    import xarray as xr

GIF = ".gif"
FORMATS = (GIF, ".mp4")
MOST_FRAMES = 3000
MARGIN = 0.06  # of the larger side


@of_elements
def animate(
    run: xr.Dataset,
    path: Given,
    *,
    seconds: float | None = None,
    rate: int = 25,
    trail: float | None = None,
    dpi: int = 90,
    dark: bool = False,
) -> Place:
    """Write the motion of a run in its plane as a film.

    Parameters
    ----------
    run : xarray.Dataset
        A run record whose model names a plane in `[figure]`, or that has two or three coordinates of one length.
    path : str or Path
        GIF, or MP4 where ffmpeg is installed.
    seconds : float, optional
        Duration of the film; by default that of the motion if it lasts 3 to 20 s, otherwise 10 s.
    rate : int
        Frames per second.
    trail : float, optional
        How far back the trail goes, in the run's time; a tenth of it.
    dpi : int
        Dots per inch; the film is 6 inches wide.
    dark : bool
        Whether to draw on a dark background.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        If the run has no plane, or the film cannot be written.
    """
    target, shown = placed(path), views(run.copy(deep=False))
    _check(target, shown, seconds, rate, dpi)
    if trail is not None and not (isinstance(trail, int | float) and 0.0 <= trail < float("inf")):
        raise InputError(f"trail is {trail!r}, needs a non-negative time of the run")
    view = shown[0]
    begin, end = float(view[0].times[0]), float(view[0].times[-1])
    span = end - begin
    lasting = seconds if seconds is not None else span if 3.0 <= span <= 20.0 else 10.0
    frames = max(2, round(lasting * rate))
    back = 0.1 * span if trail is None else float(trail)
    with lit(dark=dark), TemporaryDirectory(prefix="xdynamics-") as folder:
        part = Path(folder) / f"film{target.suffix.lower()}"
        _film(run, view, np.linspace(begin, end, frames), back).save(part, writer=_writer(part, rate), dpi=dpi)
        with kept("film", target) as place:
            shutil.copyfile(part, place)
    return target


def _film(run: xr.Dataset, view: list[Any], times: Any, back: float) -> Any:
    """Return the film of a view: dots, trails, the time."""
    from matplotlib.animation import FuncAnimation
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 6), layout="constrained")
    axes = figure.subplots()
    low = np.array([min(body.x.min() for body in view), min(body.y.min() for body in view)])
    high = np.array([max(body.x.max() for body in view), max(body.y.max() for body in view)])
    half, middle = (0.5 + MARGIN) * float(max(high - low)) or 1.0, (low + high) / 2.0
    axes.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half), aspect="equal")
    axes.set(xlabel=f"across ({view[0].units})", ylabel=f"up ({view[0].units})")
    axes.grid(linewidth=0.6)
    axes.set_title(words(f"{run.attrs.get('title', 'run')}{left_out(view)}"), loc="left", fontsize=10)
    view = view[:MOST_BODIES]
    clock = axes.text(0.98, 0.98, "", transform=axes.transAxes, ha="right", va="top", family="monospace")
    artists = [
        (
            axes.plot([], [], "-", color=COLOURS[k % len(COLOURS)], linewidth=1.2, alpha=0.6)[0],
            axes.plot([], [], "o", color=COLOURS[k % len(COLOURS)], markersize=8)[0],
        )
        for k in range(len(view))
    ]

    def at(frame: int) -> list[Any]:
        now = times[frame]
        for (line, dot), body in zip(artists, view, strict=True):
            past = np.linspace(max(times[0], now - back), now, 120)
            x, y = np.interp(past, body.times, body.x), np.interp(past, body.times, body.y)
            line.set_data(x, y)
            dot.set_data(x[-1:], y[-1:])
        clock.set_text(at_time(run["time"], now, 4))
        return [*(artist for pair in artists for artist in pair), clock]

    return FuncAnimation(figure, at, frames=len(times))


def _writer(path: Path, rate: int) -> Any:
    from matplotlib import animation

    if path.suffix == GIF:
        return animation.PillowWriter(fps=rate)
    if not animation.writers.is_available("ffmpeg"):
        raise InputError("an MP4 needs the program ffmpeg, which is not installed; write a .gif")
    return animation.FFMpegWriter(fps=rate)


def _check(target: Place, shown: list[Any], seconds: Any, rate: Any, dpi: Any) -> None:
    check_path(target, FORMATS, "film")
    if not shown or not shown[0]:
        raise InputError(
            'the run has no plane to be seen in; name it in the model: [figure] plane = ["l*sin(theta)",'
            ' "-l*cos(theta)"]'
        )
    if seconds is not None and not (isinstance(seconds, int | float) and 0.0 < seconds <= 600.0):
        raise InputError(f"seconds are {seconds!r}, need a number up to 600")
    if isinstance(rate, int) and seconds is not None and seconds * rate > MOST_FRAMES:
        raise InputError(
            f"{seconds:g} seconds at a rate of {rate} are {seconds * rate:.0f} frames, at most {MOST_FRAMES} are drawn;"
            " ask for fewer"
        )
    for name, value, least, most in (("rate", rate, 1, 100), ("dpi", dpi, 20, 600)):
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
            raise InputError(f"{name} is {value!r}, needs a whole number from {least} to {most}")

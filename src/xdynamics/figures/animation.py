"""A run as a film: bodies in the plane with their trails, or a quantity along a dimension, and the time."""

from __future__ import annotations

import shutil
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics.archive.place import Given, Place, placed
from xdynamics.faults import InputError
from xdynamics.figures.marks import at_time, words
from xdynamics.figures.scenes import Scene, scene_of
from xdynamics.figures.sheet import check_path, kept, lit
from xdynamics.record import of_elements

if TYPE_CHECKING:
    import xarray as xr

GIF = ".gif"
FORMATS = (GIF, ".mp4")
MOST_FRAMES = 3000
NO_SCENE = (
    'the run has no plane to be seen in; name it in the model: [figure] plane = ["l*sin(theta)", "-l*cos(theta)"]'
)


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
    """Write the motion of a run in its plane as a film; without a plane, a quantity along a dimension.

    Parameters
    ----------
    run : xarray.Dataset
        A run record whose model names a plane in `[figure]`, or that has two or three coordinates of one length, or
        bodies with positions along a dimension of two or three elements: links of a relation that is a table, or of
        neighbours, are lines between them. Else the first coordinate or state along a dimension of many elements.
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
        If the run has neither, or the film cannot be written.
    """
    target, scene = placed(path), scene_of(run.copy(deep=False), trail)
    _check(target, seconds, rate, dpi)
    if scene is None:
        raise InputError(NO_SCENE)
    if trail is not None and not (isinstance(trail, int | float) and 0.0 <= trail < float("inf")):
        raise InputError(f"trail is {trail!r}, needs a non-negative time of the run")
    begin, end = float(scene.times[0]), float(scene.times[-1])
    span = end - begin
    lasting = seconds if seconds is not None else span if 3.0 <= span <= 20.0 else 10.0
    frames = max(2, round(lasting * rate))
    with lit(dark=dark), TemporaryDirectory(prefix="xdynamics-") as folder:
        part = Path(folder) / f"film{target.suffix.lower()}"
        _film(run, scene, np.linspace(begin, end, frames)).save(part, writer=_writer(part, rate), dpi=dpi)
        with kept("film", target) as place:
            shutil.copyfile(part, place)
    return target


def _film(run: xr.Dataset, scene: Scene, times: Any) -> Any:
    """Return the film of a scene, with the time."""
    from matplotlib.animation import FuncAnimation
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 6), layout="constrained")
    axes = figure.subplots()
    axes.grid(linewidth=0.6)
    beside = scene.start(axes)
    axes.set_title(words(f"{run.attrs.get('title', 'run')}{beside}"), loc="left", fontsize=10)
    clock = axes.text(0.98, 0.98, "", transform=axes.transAxes, ha="right", va="top", family="monospace")

    def at(frame: int) -> list[Any]:
        clock.set_text(at_time(run["time"], times[frame], 4))
        return [*scene.at(float(times[frame])), clock]

    return FuncAnimation(figure, at, frames=len(times))


def _writer(path: Path, rate: int) -> Any:
    from matplotlib import animation

    if path.suffix == GIF:
        return animation.PillowWriter(fps=rate)
    if not animation.writers.is_available("ffmpeg"):
        raise InputError("an MP4 needs the program ffmpeg, which is not installed; write a .gif")
    return animation.FFMpegWriter(fps=rate)


def _check(target: Place, seconds: Any, rate: Any, dpi: Any) -> None:
    check_path(target, FORMATS, "film")
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

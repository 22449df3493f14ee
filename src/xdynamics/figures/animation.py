"""A run as a film: bodies in the plane with their trails, or a quantity along a dimension, and the time."""

from __future__ import annotations

from collections.abc import Callable
from html import escape
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics.archive import check_states
from xdynamics.archive.place import Given, Place, location_of
from xdynamics.faults import InputError
from xdynamics.figures.film import FORMATS, HTML, Film, check_writer, drawn_frames, encoded_film
from xdynamics.figures.frame_sizes import LABELS
from xdynamics.figures.marks import at_time, escaped_text
from xdynamics.figures.powers import fold_power
from xdynamics.figures.scenes import Scene, scene_of
from xdynamics.figures.sheet import background_style, check_path, temporary_file
from xdynamics.record import of_elements
from xdynamics.record.run_dataset import check_dataset

if TYPE_CHECKING:
    import xarray as xr

MOST_FRAMES = 3000
LETTERS = 13  # of a title, an inch
NO_SCENE = (
    'the run has no plane to be seen in; name it in the model: [figure] plane = ["l*sin(theta)", "-l*cos(theta)"]'
)


@of_elements
def animate(
    run: xr.Dataset,
    path: Given | None = None,
    *,
    seconds: float | None = None,
    rate: int = 25,
    trail: float | None = None,
    dpi: int = 90,
    dark: bool = False,
) -> Film:
    """Film the motion of a run in its plane; of bodies that turn, in space; without either, a quantity along a dimension.

    Parameters
    ----------
    run : xarray.Dataset
        A run record whose model names a plane in `[figure]`, or that has two or three coordinates of one length, or
        bodies with positions along a dimension of two or three elements: links of a relation that is a table, or of
        neighbours, are lines between them. Motion in three dimensions has two views of one scale that share an axis, unless
        the model names its plane. Bodies that turn, of a model that names no plane of lengths, are seen from the
        side and above: lines to their points and joints, and the ellipsoid that has their mass and inertia; where they go
        far the picture goes along. Else the first coordinate or state along a dimension of many elements, or over two as a map.
    path : str or Path, optional
        Where to write it: GIF, HTML with a slider, or MP4 where ffmpeg is installed. Without one it is for a notebook, which
        shows a film that is the last line of a cell.
    seconds : float, optional
        Duration of the film; by default that of the motion if it lasts 3 to 20 s, otherwise 10 s.
    rate : int
        Frames per second.
    trail : float, optional
        How far back the trail goes, in the run's time; a tenth of it.
    dpi : int
        Dots per inch; the longer side of the film is 6 inches.
    dark : bool
        Whether to draw on a dark background.

    Returns
    -------
    Film
        Used as the path of its file.

    Raises
    ------
    InputError
        If the run has neither, or the film cannot be written.
    """
    check_dataset(run)
    check_states(run)
    if "time" in run.variables and not run.variables["time"].size:
        raise InputError("there is nothing to draw: the record has no rows")
    target, scene = location_of(path) if path is not None else None, scene_of(run.copy(deep=False), trail)
    _check_film_options(target, seconds, rate, dpi)
    if scene is None:
        raise InputError(NO_SCENE)
    if trail is not None and not (isinstance(trail, int | float) and 0.0 <= trail < float("inf")):
        raise InputError(f"trail is {trail!r}, needs a non-negative time of the run")
    begin, end = float(scene.times[0]), float(scene.times[-1])
    span = end - begin
    duration = seconds if seconds is not None else span if 3.0 <= span <= 20.0 else 10.0
    ending = HTML if target is None else target.suffix.lower()
    with background_style(dark=dark):
        times = np.linspace(begin, end, max(2, round(duration * rate)))
        figure, frame_at = scene_figure(run, scene, times, dpi)
        content = encoded_film(
            drawn_frames(figure, frame_at, len(times)), ending, rate, escape(str(run.attrs.get("title", "run")))
        )
    if target is not None:
        with temporary_file("film", target) as temporary_path:
            temporary_path.write_bytes(content)
    return Film(content, ending, target)


def scene_figure(run: xr.Dataset, scene: Scene, times: Any, dpi: int) -> tuple[Any, Callable[[int], list[Any]]]:
    """Return the figure of a scene, and what draws one frame on it, with its time, and returns what moved."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=scene.size, dpi=dpi, layout="constrained")
    axes = figure.subplots()
    axes.grid(linewidth=0.6)
    scene_note = scene.start(axes)
    for panel_axes in figure.axes:
        fold_power(panel_axes.xaxis)
        fold_power(panel_axes.yaxis)
    title = escaped_text(f"{run.attrs.get('title', 'run')}{scene_note}")
    axes.set_title("\n".join(wrap(title, round((scene.size[0] - LABELS) * LETTERS))), loc="left", fontsize=10)
    paper = {"facecolor": axes.get_facecolor(), "edgecolor": "none", "alpha": 0.7, "pad": 2.0}  # over a map as well
    clock = axes.text(0.98, 0.98, "", transform=axes.transAxes, ha="right", va="top", family="monospace", bbox=paper)

    def draw_frame(frame: int) -> list[Any]:
        clock.set_text(at_time(run["time"], times[frame], 4))
        return [*scene.move_to(float(times[frame])), clock]

    return figure, draw_frame


def _check_film_options(target: Place | None, seconds: Any, rate: Any, dpi: Any) -> None:
    if target is not None:
        check_path(target, FORMATS, "film")
        check_writer(target.suffix.lower())
    if seconds is not None and not (isinstance(seconds, int | float) and 0.0 < seconds <= 600.0):
        raise InputError(f"seconds are {seconds!r}, need a number up to 600")
    if isinstance(rate, int) and seconds is not None and seconds * rate > MOST_FRAMES:
        raise InputError(
            f"{seconds:g} seconds at a rate of {rate} are {seconds * rate:.0f} frames, at most {MOST_FRAMES} are drawn;"
            " ask for fewer"
        )
    for name, value, minimum, maximum in (("rate", rate, 1, 100), ("dpi", dpi, 20, 600)):
        if isinstance(value, bool) or not isinstance(value, int) or not minimum <= value <= maximum:
            raise InputError(f"{name} is {value!r}, needs a whole number from {minimum} to {maximum}")

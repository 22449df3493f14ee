"""A run as a film: bodies in the plane with their trails, or a quantity along a dimension, and the time.

A film: frames drawn over what stands still, written as a picture that moves, or as a page with a slider.
"""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from html import escape
from io import BytesIO
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics.archive import check_states
from xdynamics.archive.store import Given, Place, location_of
from xdynamics.faults import InputError
from xdynamics.figures.framing import LABELS
from xdynamics.figures.marks import at_time, escaped_text
from xdynamics.figures.scenes import Scene, scene_of
from xdynamics.figures.sheet import background_style, check_path, temporary_file, typeset_labels
from xdynamics.record import of_elements
from xdynamics.record.run_dataset import check_dataset

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure
    from PIL.Image import Image

GIF, MP4, HTML = FORMATS = (".gif", ".mp4", ".html")
SHADES = 128  # colours of a GIF or of a page's frames
MEASURED = 12  # frames that the colours are chosen from
PAGE = """<div><img alt="{title}" style="max-width:100%"><br>
<button type="button" aria-label="play or pause">&#9654;</button>
<input type="range" min="0" max="{last}" value="0" style="width:70%" aria-label="time"></div>
<script>
(() => {{
  const frames = {frames}, box = document.currentScript.previousElementSibling;
  const image = box.querySelector("img"), button = box.querySelector("button"), slider = box.querySelector("input");
  let clock = null;
  const show = () => {{ image.src = "data:image/png;base64," + frames[slider.value]; }};
  const play = () => {{
    if (clock) {{ clearInterval(clock); clock = null; }}
    else clock = setInterval(() => {{ slider.value = (+slider.value + 1) % frames.length; show(); }}, {wait});
    button.innerHTML = clock ? "&#10073;&#10073;" : "&#9654;";
  }};
  slider.oninput = show; button.onclick = play; show();
}})();
</script>
"""


@dataclass(frozen=True)
class Film:
    """A film, which a notebook shows as the last line of a cell, and which is used as the path of its file.

    Attributes
    ----------
    content : bytes
    ending : str
        Of `FORMATS`.
    path : Path, optional
        Where it was written; None for a film of a notebook alone.
    """

    content: bytes
    ending: str
    path: Place | None = None

    def __fspath__(self) -> str:
        if self.path is None:
            raise InputError("the film was not written: give animate a path, like 'film.gif'")
        return str(self.path)

    def __str__(self) -> str:
        return "film" if self.path is None else str(self.path)

    def __repr__(self) -> str:
        return f"<film {str(self.path) if self.path else 'of a notebook'}, {len(self.content)} bytes>"

    def _repr_html_(self) -> str:
        if self.ending == HTML:
            return self.content.decode()
        data = base64.b64encode(self.content).decode()
        if self.ending == GIF:
            return f'<img src="data:image/gif;base64,{data}" style="max-width:100%">'
        return f'<video controls loop style="max-width:100%" src="data:video/mp4;base64,{data}"></video>'


def drawn_frames(figure: Figure, draw_frame: Callable[[int], list[Any]], count: int) -> Iterator[Image]:
    """Yield frames: what stands still is drawn once, what `draw_frame` moves is drawn over a copy of it."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    canvas: Any = FigureCanvasAgg(figure)
    moving_artists = draw_frame(0)
    for artist in moving_artists:
        # what is animated is left out by draw, so that the background has none of it
        artist.set_animated(True)
    canvas.draw()
    background = canvas.copy_from_bbox(figure.bbox)
    size = canvas.get_width_height(physical=True)
    for frame in range(count):
        canvas.restore_region(background)
        for artist in draw_frame(frame):
            artist.axes.draw_artist(artist)
        yield Image.frombytes("RGBA", size, bytes(canvas.buffer_rgba())).convert("RGB")


def encoded_film(frames: Iterator[Image], ending: str, rate: int, title: str) -> bytes:
    """Return the content of a film's file.

    Raises
    ------
    InputError
        If an MP4 is wanted and ffmpeg is not installed.
    """
    if ending == MP4:
        return _mp4(frames, rate)
    reduced = _reduce_colours([*frames])
    if ending == GIF:
        stored = BytesIO()
        reduced[0].save(
            stored, "gif", save_all=True, append_images=reduced[1:], duration=1000 / rate, loop=0, optimize=False
        )
        return stored.getvalue()
    pictures = json.dumps([base64.b64encode(_png(frame)).decode() for frame in reduced])
    return PAGE.format(title=title, last=len(reduced) - 1, frames=pictures, wait=round(1000 / rate)).encode()


def _reduce_colours(frames: list[Image]) -> list[Image]:
    """Return frames with few colours, the same in all, so that what stands still does not flicker."""
    from PIL import Image

    measured_frames = frames[:: max(1, len(frames) // MEASURED)][:MEASURED]
    width, height = frames[0].size
    sample_image = Image.new("RGB", (width, height * len(measured_frames)))
    for k, frame in enumerate(measured_frames):
        sample_image.paste(frame, (0, k * height))
    palette = sample_image.quantize(SHADES, method=Image.Quantize.FASTOCTREE)
    return [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]


def _png(frame: Image) -> bytes:
    stored = BytesIO()
    frame.save(stored, "png")
    return stored.getvalue()


def check_writer(ending: str) -> None:
    """Check that a film can be written.

    Raises
    ------
    InputError
        If an MP4 is wanted and ffmpeg is not installed.
    """
    if ending == MP4 and shutil.which("ffmpeg") is None:
        raise InputError("an MP4 needs the program ffmpeg, which is not installed; write a .gif or a .html")


def _mp4(frames: Iterator[Image], rate: int) -> bytes:
    """Return what ffmpeg makes of the frames, with even sides, as its usual coding needs."""
    from pathlib import Path
    from tempfile import TemporaryDirectory

    first = next(frames)
    with TemporaryDirectory(prefix="xdynamics-") as folder:
        part = Path(folder) / "film.mp4"
        size = f"{first.width}x{first.height}"
        command = ["ffmpeg", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, "-r", str(rate)]
        command += ["-i", "-", "-vf", "crop=trunc(iw/2)*2:trunc(ih/2)*2", "-pix_fmt", "yuv420p", "-y", str(part)]
        raw_frames = b"".join(frame.tobytes() for frame in (first, *frames))
        process = subprocess.run(command, input=raw_frames, capture_output=True, check=False)  # noqa: S603 - no shell, own words
        if process.returncode:
            raise InputError(
                f"ffmpeg could not write the film: {process.stderr.decode(errors='replace').strip()[:200]}"
            )
        return part.read_bytes()


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
    typeset_labels(figure.axes)
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

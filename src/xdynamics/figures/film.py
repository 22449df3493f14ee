"""A film: frames drawn over what stands still, written as a picture that moves, or as a page with a slider."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING, Any

from xdynamics.faults import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from PIL.Image import Image

    from xdynamics.archive.place import Place

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

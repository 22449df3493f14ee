"""A figure that can be zoomed, moved and asked for values, as a page of its own: no server, nothing from a network."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.faults import InputError
from xdynamics.figures.marks import without_power

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PIXELS = 90  # of a page for each inch of the figure
SYMBOLS = {
    "v": "triangle-down",
    "^": "triangle-up",
    "s": "square",
    "D": "diamond",
    "d": "diamond-tall",
    "X": "x",
    "x": "x-thin-open",
    "P": "cross",
    "+": "cross-thin-open",
    "*": "star",
}
DASHES = {"-": "solid", "--": "dash", "-.": "dashdot", ":": "dot"}
LOOSE = 0.02  # of a panel, that a name may stand outside of it
HALF_LIT = 1.5  # sum of red, green and blue


@dataclass(frozen=True)
class Interactive:
    """A figure of plotly, which a notebook shows as the last line of a cell: about 5 MB, since all that draws it is inside.

    Attributes
    ----------
    figure : plotly.graph_objects.Figure
    """

    figure: Any

    def _repr_html_(self) -> str:
        return self.html(whole=False)

    def html(self, *, whole: bool = True) -> str:
        """Return the page, or the part of one, with plotly.js in it."""
        return str(self.figure.to_html(full_html=whole, include_plotlyjs=True, include_mathjax=False))


def interactive_figure(figure: Figure) -> Interactive:
    """Return a figure that has been drawn as one that is interactive: the same panels, lines, points, maps, names and legends.

    Raises
    ------
    InputError
        If plotly is not installed.
    """
    try:
        import plotly.graph_objects as go
    except ImportError:
        raise InputError(
            "an interactive figure needs the package plotly: pip install 'xdynamics[interactive]'"
        ) from None
    width, height = (round(inches * PIXELS) for inches in figure.get_size_inches())
    title, foot = (_html_text(text) for text in (figure.get_suptitle(), figure.get_supxlabel()))
    page = go.Figure(
        layout={
            "width": width,
            "height": height,
            "template": "plotly_white",
            "font_size": 11,
            "hovermode": "closest",
            "title": {"text": title, "x": 0.01, "y": 0.995, "yanchor": "top", "font_size": 15},
            "margin": {"l": 0, "r": 0, "t": 10, "b": 0},
            "paper_bgcolor": _colour(figure.get_facecolor()),
            "font_color": _ink(figure),
        }
    )
    page.add_annotation(
        text=foot.replace("\n", "<br>"),
        xref="paper",
        yref="paper",
        x=0.01,
        y=0.0,
        showarrow=False,
        align="left",
        xanchor="left",
        yanchor="bottom",
        font_size=9,
        opacity=0.7,
    )
    visible_axes: list[Any] = [axes for axes in figure.axes if axes.get_visible()]
    scales = [inset for axes in visible_axes for inset in axes.child_axes]  # of colours, beside their maps
    for number, axes in enumerate([*visible_axes, *scales], start=1):
        (_add_space_panel if hasattr(axes, "zaxis") else _add_flat_panel)(
            page, axes, "" if number == 1 else str(number)
        )
    return Interactive(page)


def _add_flat_panel(page: Any, axes: Axes, n: str) -> None:
    """Add a panel of two axes."""
    box = axes.get_position()
    for letter, axis, across in (("x", axes.xaxis, (box.x0, box.x1)), ("y", axes.yaxis, (box.y0, box.y1))):
        low, high = axis.get_view_interval()
        logarithmic = axis.get_scale() == "log"
        settings: dict[str, Any] = {
            "domain": [max(0.0, across[0]), min(1.0, across[1])],
            "anchor": f"{'y' if letter == 'x' else 'x'}{n}",
            "type": "log" if logarithmic else "linear",
            # plotly takes the ends of a logarithmic axis as powers of ten
            "range": [float(end) for end in (np.log10([low, high]) if logarithmic else (low, high))],
            "title": {"text": _html_text(without_power(axis.get_label_text())), "standoff": 4},
            "zeroline": False,
            "exponentformat": "power",
            "showticklabels": len(axis.get_ticklocs()) > 0,
        }
        if type(axis.get_major_locator()).__name__ in ("FixedLocator", "RoundTimes"):
            labels = [_html_text(label.get_text()) for label in axis.get_ticklabels()]
            settings |= {"tickvals": axis.get_ticklocs().tolist(), "ticktext": labels}
        if axis.get_ticks_position() in ("right", "top"):
            settings["side"] = axis.get_ticks_position()
        if letter == "y" and axes.get_aspect() != "auto":
            settings |= {"scaleanchor": f"x{n}", "scaleratio": float(axes.get_aspect()), "constrain": "domain"}
        page.update_layout({f"{letter}axis{n}": settings})
    _add_panel_title(page, axes)
    legend, legend_key = axes.get_legend(), f"legend{n}"
    if legend is not None:
        corner = legend.get_window_extent().transformed(axes.figure.transFigure.inverted())
        sides = {
            "x": float(np.clip(corner.x0, 0, 1)),
            "y": float(np.clip(corner.y1, 0, 1)),
            "yanchor": "top",
            "font_size": 9,
        }
        page.update_layout({legend_key: {**sides, "bgcolor": "rgba(255,255,255,0)", "tracegroupgap": 0}})
    for trace in _traces(axes):
        legend_settings = {
            "showlegend": legend is not None and bool(trace.get("name")),
            "legend": legend_key if legend else "legend",
        }
        kind = {"type": "scatter", "hovertemplate": "%{x:.6g}, %{y:.6g}"} if trace.get("type") != "heatmap" else {}
        page.add_trace(kind | (legend_settings if kind else {}) | trace | {"xaxis": f"x{n}", "yaxis": f"y{n}"})
    for text in axes.texts:
        if text.get_visible() and text.get_text():
            _add_annotation(page, axes, text, n)


def _add_panel_title(page: Any, axes: Axes) -> None:
    """Add the title of a panel, above its left corner."""
    box = axes.get_position()
    page.add_annotation(
        text=_html_text(axes.get_title(loc="left")).replace("\n", "<br>"),
        xref="paper",
        yref="paper",
        x=box.x0,
        y=box.y1,
        xanchor="left",
        yanchor="bottom",
        align="left",
        showarrow=False,
    )


def _traces(axes: Axes) -> Iterator[dict[str, Any]]:
    """Yield what is drawn in a panel as plotly takes it, what lies lowest first."""
    artists: list[Any] = [*axes.collections, *axes.patches, *axes.lines]
    for artist in sorted(artists, key=lambda drawable: drawable.get_zorder()):
        if not artist.get_visible():
            continue
        if artist in axes.lines:
            yield from _line_traces(axes, artist)
        elif hasattr(artist, "get_coordinates"):
            yield _heatmap_trace(artist)
        elif hasattr(artist, "get_sizes") and len(artist.get_offsets()):
            yield _point_trace(artist)
        else:
            yield from _shape_traces(axes, artist)


def _line_traces(axes: Axes, line: Any) -> Iterator[dict[str, Any]]:
    points = _in_data_units(axes, line, np.column_stack(line.get_data(orig=False)).astype(float))
    marker, style = str(line.get_marker()), str(line.get_linestyle())
    has_markers, has_line = marker not in ("", "None", "none", " "), style in DASHES
    colour = _colour(line.get_color(), line.get_alpha())
    if len(points) and (has_markers or has_line):
        yield _legend_name(line) | {
            "x": points[:, 0],
            "y": points[:, 1],
            "mode": "+".join(["lines"] * has_line + ["markers"] * has_markers),
            "line": {
                "color": colour,
                "width": line.get_linewidth() * 1.2,
                # plotly would leave out points that lie nearly on a line
                "simplify": False,
                "dash": DASHES.get(style, "solid"),
            },
            "marker": {
                "symbol": SYMBOLS.get(marker, "circle"),
                "size": max(1.5, line.get_markersize() * 1.2),
                "color": _colour(line.get_markerfacecolor(), line.get_alpha(), colour),
                "line": {
                    "color": _colour(line.get_markeredgecolor(), line.get_alpha()),
                    "width": 0.5 if marker not in "x+" else 1.0,
                },
            },
        }


def _point_trace(collection: Any) -> dict[str, Any]:
    places = np.asarray(collection.get_offsets(), float)
    colours = [_colour(face_colour) for face_colour in collection.get_facecolor()] or ["black"]
    return _legend_name(collection) | {
        "x": places[:, 0],
        "y": places[:, 1],
        "mode": "markers",
        "marker": {
            "color": colours if len(colours) == len(places) else colours[0],
            "size": np.sqrt(collection.get_sizes()) * 1.2,
        },
    }


def _heatmap_trace(mesh: Any) -> dict[str, Any]:
    """Return a coloured map with the values of its cells and the scale of its colours."""
    corners, values = np.asarray(mesh.get_coordinates()), np.ma.filled(mesh.get_array(), np.nan)
    x, y = ((edges[1:] + edges[:-1]) / 2 for edges in (corners[0, :, 0], corners[:, 0, 1]))
    shades = [[s, _colour(mesh.cmap(s))] for s in np.linspace(0.0, 1.0, 33).tolist()]
    return {
        "type": "heatmap",
        "x": x,
        "y": y,
        "z": np.reshape(values, (len(y), len(x))).astype(float),
        "colorscale": shades,
        "zmin": float(mesh.norm.vmin),
        "zmax": float(mesh.norm.vmax),
        "showscale": False,
        "hovertemplate": "%{x:.6g}, %{y:.6g}: %{z:.6g}<extra></extra>",
    }


def _shape_traces(axes: Axes, artist: Any) -> Iterator[dict[str, Any]]:
    """Yield areas and lines that are drawn as paths: bars, bands, springs, contour lines, error bars."""
    paths = artist.get_paths() if hasattr(artist, "get_paths") else [artist.get_path()]
    face, edge = (
        np.atleast_2d(colour() if len(colour()) else (0, 0, 0, 0))
        for colour in (artist.get_facecolor, artist.get_edgecolor)
    )
    is_filled = not hasattr(artist, "get_segments") and face[0][-1] > 0.0 if np.size(face) else False
    for k, path in enumerate(paths):
        rings = (
            [_in_data_units(axes, artist, ring) for ring in path.to_polygons(closed_only=False)] if len(path) else []
        )
        if not rings:
            continue
        points = np.concatenate([np.vstack([ring, [np.nan, np.nan]]) for ring in rings])
        width = float(np.atleast_1d(artist.get_linewidth())[0])
        yield (_legend_name(artist) if k == 0 else {}) | {
            "x": points[:, 0],
            "y": points[:, 1],
            "mode": "lines",
            "hoverinfo": "skip",
            "hovertemplate": None,
            "fill": "toself" if is_filled else "none",
            "fillcolor": _colour(face[k % len(face)]),
            "line": {"color": _colour(edge[k % len(edge)]), "width": width},
        }


def _add_space_panel(page: Any, axes: Any, n: str) -> None:
    """Add a panel in space: its lines, which can be turned."""
    box, scene = axes.get_position(), f"scene{n}"
    labels: dict[str, Any] = {
        f"{letter}axis": {
            "title": {"text": _html_text(getattr(axes, f"get_{letter}label")())},
            "range": [float(end) for end in getattr(axes, f"get_{letter}lim")()],
        }
        for letter in "xyz"
    }
    aspect = {"aspectmode": "manual", "aspectratio": dict(zip("xyz", map(float, axes.get_box_aspect()), strict=True))}
    page.update_layout({scene: {"domain": {"x": [box.x0, box.x1], "y": [box.y0, box.y1]}, **aspect, **labels}})
    for line in axes.lines:
        x, y, z = line.get_data_3d()
        has_markers = str(line.get_marker()) not in ("", "None", "none")
        page.add_trace(
            _legend_name(line)
            | {
                "type": "scatter3d",
                "showlegend": False,
                "x": x,
                "y": y,
                "z": z,
                "scene": scene,
                "mode": "markers" if has_markers else "lines",
                "line": {"color": _colour(line.get_color()), "width": 3},
                "marker": {"color": _colour(line.get_color()), "size": 3},
            }
        )


def _add_annotation(page: Any, axes: Axes, text: Any, n: str) -> None:
    """Add a text where it stands, as long as it stands in the panel."""
    box = text.get_window_extent().transformed(axes.transAxes.inverted())
    across, up = (box.x0 + box.x1) / 2, (box.y0 + box.y1) / 2
    if -LOOSE <= across <= 1 + LOOSE and -LOOSE <= up <= 1 + LOOSE:
        x, y = axes.transData.inverted().transform(axes.transAxes.transform((across, up)))
        x, y = (
            # plotly places annotations on a logarithmic axis by powers of ten, but traces by values
            np.log10(coordinate) if axis.get_scale() == "log" else coordinate
            for coordinate, axis in ((x, axes.xaxis), (y, axes.yaxis))
        )
        page.add_annotation(
            text=_html_text(text.get_text()).replace("\n", "<br>"),
            x=float(x),
            y=float(y),
            xref=f"x{n}",
            yref=f"y{n}",
            showarrow=False,
            font={"size": text.get_fontsize() * 1.25, "color": _colour(text.get_color())},
        )


def _in_data_units(axes: Axes, artist: Any, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points of an artist in the units of the panel's axes, whichever it was given in."""
    transform = artist.get_transform() - axes.transData
    return np.asarray(transform.transform(points)) if len(points) else points


def _legend_name(artist: Any) -> dict[str, Any]:
    """Return the name that a legend has for an artist, which stands beside its values too."""
    label = str(artist.get_label())
    return {} if label.startswith("_") or label == "None" else {"name": _html_text(label)}


def _colour(colour: Any, alpha: float | None = None, otherwise: str = "rgba(0,0,0,0)") -> str:
    from matplotlib.colors import to_rgba

    if colour is None or (isinstance(colour, str) and colour == "auto"):
        return otherwise
    red, green, blue, opacity = to_rgba(colour, alpha)
    return f"rgba({round(red * 255)},{round(green * 255)},{round(blue * 255)},{opacity:.3g})"


def _ink(figure: Figure) -> str:
    """Return the colour of text on the figure's background."""
    from matplotlib.colors import to_rgba

    return "#222222" if sum(to_rgba(figure.get_facecolor())[:3]) > HALF_LIT else "#e8e8e8"


def _html_text(text: str) -> str:
    """Return a text of matplotlib as HTML has it."""
    from html import escape

    return escape(text.replace(r"\$", "$"), quote=False)

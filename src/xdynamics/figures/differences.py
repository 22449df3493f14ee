"""Sweeps compared, and methods within one: differences over their uncertainty, as maps, lines or points."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping
from functools import partial
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.evidence.comparing.grids import DIFFERS, UNKNOWN, WITHIN
from xdynamics.evidence.grid_axes import axes_said
from xdynamics.figures.marks import COLOURS, in_unit, words
from xdynamics.figures.sheet import Page, Panel
from xdynamics.figures.sweep_labels import labelled, other_axes
from xdynamics.figures.sweep_maps import colour_bar
from xdynamics.schema import AT, OCCURRENCE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]
HEAD = "difference_"
SHADES = "RdBu_r"
MOST = 30.0  # times their uncertainty, from which on differences have one colour
FAR = "#c8452f"
MOST_LINES = 8


def panels_of(found: xr.Dataset) -> list[Panel]:
    """Return a panel for each number that differs anywhere, and each value of further axes; see `_telling`."""
    names = [str(name).removeprefix(HEAD) for name in found.data_vars if str(name).startswith(HEAD)]
    wide = [dim for dim in axes_said(found) if _is_wide(found, dim)][:2]
    draw = {2: _map, 1: _lines, 0: _points}[len(wide)]
    return [
        partial(draw, _part(found, name, where), name, wide)
        for name in _telling(found, names)
        for where in (_places(found, name, wide) if len(wide) == 2 else [{}])
    ]


def foot_of(found: xr.Dataset) -> str:
    """Say what is drawn, and how many members differ."""
    verdicts = [found[name].values for name in found.data_vars if str(name).startswith("verdict_")]
    differing = int(sum((values == DIFFERS).sum() for values in verdicts))
    unknown = int(sum((values == UNKNOWN).sum() for values in verdicts))
    cause = f"; {cause}" if (cause := str(found.attrs.get("cause", ""))) else ""
    reference = f"minus {found.attrs['reference']}" if "reference" in found.attrs else "second sweep minus first"
    untold = f", of {unknown} nothing tells their uncertainty" if unknown else ""
    return f"{reference}: {differing} numbers differ by more than their uncertainty{untold}{cause}"


def _telling(found: xr.Dataset, names: list[str]) -> list[str]:
    """Name the numbers that differ in a member or may; where there is none, those that are not equal; else all."""
    apart = [name for name in names if bool((found[f"verdict_{name}"] != WITHIN).any())]
    return apart or [name for name in names if np.nan_to_num(found[f"{HEAD}{name}"].values).any()] or names


def _is_wide(found: xr.Dataset, dim: str) -> bool:
    """Whether a dimension is an axis of several numbers."""
    is_axis = dim in found.sizes and dim in found.coords and found[dim].dtype.kind in "fi"
    return is_axis and found.sizes[dim] > 1 and dim != found.attrs.get("varied")


def _places(found: xr.Dataset, name: str, wide: list[str]) -> Iterator[dict[Hashable, int]]:
    """Yield the places along all other axes, but those where a member is compared with itself."""
    others = [dim for dim in found[f"{HEAD}{name}"].dims if dim not in wide and dim not in (AT, OCCURRENCE)]
    for indices in product(*(range(found.sizes[dim]) for dim in others)):
        where = dict(zip(others, indices, strict=True))
        varied = str(found.attrs.get("varied", ""))
        if varied not in where or str(found[varied].values[where[varied]]) != found.attrs["reference"]:
            yield where


def _part(found: xr.Dataset, name: str, where: Mapping[Hashable, int]) -> xr.Dataset:
    """Return a number at the last of some times, or of the first occurrence, and at places of further axes."""
    part = found[[f"{HEAD}{name}", f"uncertainty_{name}", f"verdict_{name}"]].isel(where)
    return part.isel({dim: at for dim, at in ((AT, -1), (OCCURRENCE, 0)) if dim in part.dims})


def _map(part: xr.Dataset, name: str, wide: list[str], axes: Axes) -> None:
    """Draw differences over two axes: in units of their uncertainty, with a line where they are as large; else as they are."""
    y, x = wide
    difference, doubt = (part[f"{kind}{name}"].transpose(y, x).values.astype(float) for kind in (HEAD, "uncertainty_"))
    is_known = bool(np.isfinite(doubt).any() and (doubt > 0.0).any())
    with np.errstate(divide="ignore", invalid="ignore"):
        values = np.where(difference == 0.0, 0.0, difference / doubt) if is_known else difference
    sizes = np.abs(values[np.isfinite(values)])
    top = min(MOST, max(2.0, float(sizes.max(initial=0.0)))) if is_known else float(sizes.max(initial=0.0)) or 1.0
    across, up = part[x].values.astype(float), part[y].values.astype(float)
    mesh = axes.pcolormesh(
        across, up, np.ma.masked_invalid(np.clip(values, -top, top)), cmap=SHADES, vmin=-top, vmax=top, rasterized=True
    )
    beyond = (part[f"verdict_{name}"].transpose(y, x).values == DIFFERS).astype(float)
    if min(beyond.shape) > 1 and 0.0 < beyond.mean() < 1.0:
        axes.contour(across, up, beyond, levels=[0.5], colors="black", linewidths=1.0)
    units = str(part[f"{HEAD}{name}"].attrs["units"])
    label = words("difference / uncertainty" if is_known else in_unit("difference", units))
    colour_bar(mesh, label, axes, extend="both" if sizes.max(initial=0.0) > top else "neither")
    axes.set(xlabel=labelled(part, x), ylabel=labelled(part, y))
    axes.grid(visible=False)
    share = f"{int(beyond.sum())} of {beyond.size} differ" if is_known else "uncertainty unknown"
    axes.set_title("\n".join(map(words, (f"{name}{other_axes(part, wide)}", share))), loc="left", fontsize=10)


def _lines(part: xr.Dataset, name: str, wide: list[str], axes: Axes) -> None:
    """Draw differences over one axis, a line for each place along the others, with what they are uncertain by as bars."""
    dim = wide[0]
    x = part[dim].values.astype(float)
    places = [*_places(part, name, wide)]
    for k, where in enumerate(places[:MOST_LINES]):
        line = part.isel(where)
        axes.errorbar(
            x,
            line[f"{HEAD}{name}"].values.astype(float),
            np.nan_to_num(line[f"uncertainty_{name}"].values.astype(float)),
            marker="." if len(x) <= 60 else "",
            color=COLOURS[k % len(COLOURS)],
            linewidth=1.0,
            elinewidth=0.7,
            capsize=2.0 if len(x) <= 60 else 0.0,
            label=words(other_axes(line, wide).removeprefix(", ")),
        )
        beyond = line[f"verdict_{name}"].values == DIFFERS
        axes.plot(x[beyond], line[f"{HEAD}{name}"].values[beyond], "o", color=FAR, markerfacecolor="none", markersize=7)
    axes.axhline(0.0, color="0.5", linewidth=0.8)
    axes.set(xlabel=labelled(part, dim), ylabel=_labelled(part, name))
    more = f", {MOST_LINES} of {len(places)} lines" if len(places) > MOST_LINES else ""
    axes.set_title(words(f"{name}{more}{_beyond(part, name)}"), loc="left", fontsize=10)
    if len(places) > 1:
        axes.legend(fontsize=7, framealpha=0.85, edgecolor="none")


def _points(part: xr.Dataset, name: str, wide: list[str], axes: Axes) -> None:
    """Draw the difference of each member, along axes of words alone, with its bar."""
    places = [*_places(part, name, wide)]
    members = [part.isel(where) for where in places]
    values, doubts = (
        np.array([float(member[f"{kind}{name}"]) for member in members]) for kind in (HEAD, "uncertainty_")
    )
    rows = np.arange(len(members))
    axes.errorbar(values, rows, xerr=np.nan_to_num(doubts), fmt="o", color=COLOURS[0], markersize=4, capsize=2.0)
    axes.axvline(0.0, color="0.5", linewidth=0.8)
    axes.set_yticks(rows, [words(other_axes(member, []).removeprefix(", ")) for member in members], fontsize=7)
    axes.set(xlabel=_labelled(part, name), ylim=(len(rows) - 0.5, -0.5))
    axes.set_title(words(f"{name}{_beyond(part, name)}"), loc="left", fontsize=10)


def _labelled(part: xr.Dataset, name: str) -> str:
    return words(in_unit("difference", str(part[f"{HEAD}{name}"].attrs["units"])))


def _beyond(part: xr.Dataset, name: str) -> str:
    """Say how many differ by more than their uncertainty."""
    verdicts = part[f"verdict_{name}"].values
    return f": {int((verdicts == DIFFERS).sum())} of {verdicts.size} differ"


PAGE = Page(("sweep comparison", "contrast"), panels_of, foot_of, most_panels=8, height=3.6, alone=7.0)

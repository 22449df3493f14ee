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
from xdynamics.evidence.grid_axes import sweep_axis_names
from xdynamics.figures.marks import COLOURS, escaped_text, label_with_unit
from xdynamics.figures.sheet import Page, Panel
from xdynamics.figures.sweep import map_colour_bar, number_label, other_settings_note
from xdynamics.schema import AT, OCCURRENCE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]
HEAD = "difference_"
SHADES = "RdBu_r"
MOST = 30.0  # times their uncertainty, from which on differences have one colour
FAR = "#c8452f"
MOST_LINES = 8


def panels_of(differences: xr.Dataset) -> list[Panel]:
    """Return a panel for each number that differs anywhere, and each value of further axes; see `_differing_names`."""
    names = [str(name).removeprefix(HEAD) for name in differences.data_vars if str(name).startswith(HEAD)]
    wide = [dim for dim in sweep_axis_names(differences) if _is_axis_of_numbers(differences, dim)][:2]
    draw = {2: _draw_difference_map, 1: _draw_difference_lines, 0: _draw_member_differences}[len(wide)]
    return [
        partial(draw, _number_at_place(differences, name, indices), name, wide)
        for name in _differing_names(differences, names)
        for indices in (_other_indices(differences, name, wide) if len(wide) == 2 else [{}])
    ]


def foot_of(differences: xr.Dataset) -> str:
    """Say what is drawn, and how many members differ."""
    verdicts = [differences[name].values for name in differences.data_vars if str(name).startswith("verdict_")]
    differing_count = int(sum((values == DIFFERS).sum() for values in verdicts))
    unknown_count = int(sum((values == UNKNOWN).sum() for values in verdicts))
    cause = f"; {cause}" if (cause := str(differences.attrs.get("cause", ""))) else ""
    reference = (
        f"minus {differences.attrs['reference']}" if "reference" in differences.attrs else "second sweep minus first"
    )
    untold = f", of {unknown_count} nothing tells their uncertainty" if unknown_count else ""
    return f"{reference}: {differing_count} numbers differ by more than their uncertainty{untold}{cause}"


def _differing_names(differences: xr.Dataset, names: list[str]) -> list[str]:
    """Name the numbers that differ in a member or may; where there is none, those that are not equal; else all."""
    differing = [name for name in names if bool((differences[f"verdict_{name}"] != WITHIN).any())]
    return differing or [name for name in names if np.nan_to_num(differences[f"{HEAD}{name}"].values).any()] or names


def _is_axis_of_numbers(differences: xr.Dataset, dim: str) -> bool:
    """Whether a dimension is an axis of several numbers."""
    is_axis = dim in differences.sizes and dim in differences.coords and differences[dim].dtype.kind in "fi"
    return is_axis and differences.sizes[dim] > 1 and dim != differences.attrs.get("varied")


def _other_indices(differences: xr.Dataset, name: str, wide: list[str]) -> Iterator[dict[Hashable, int]]:
    """Yield the places along all other axes, but those where a member is compared with itself."""
    other_dims = [dim for dim in differences[f"{HEAD}{name}"].dims if dim not in wide and dim not in (AT, OCCURRENCE)]
    for indices in product(*(range(differences.sizes[dim]) for dim in other_dims)):
        indices_by_dim = dict(zip(other_dims, indices, strict=True))
        varied = str(differences.attrs.get("varied", ""))
        if (
            varied not in indices_by_dim
            or str(differences[varied].values[indices_by_dim[varied]]) != differences.attrs["reference"]
        ):
            yield indices_by_dim


def _number_at_place(differences: xr.Dataset, name: str, indices: Mapping[Hashable, int]) -> xr.Dataset:
    """Return a number at the last of some times, or of the first occurrence, and at places of further axes."""
    part = differences[[f"{HEAD}{name}", f"uncertainty_{name}", f"verdict_{name}"]].isel(indices)
    return part.isel({dim: index for dim, index in ((AT, -1), (OCCURRENCE, 0)) if dim in part.dims})


def _draw_difference_map(part: xr.Dataset, name: str, wide: list[str], axes: Axes) -> None:
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
    differs = (part[f"verdict_{name}"].transpose(y, x).values == DIFFERS).astype(float)
    if min(differs.shape) > 1 and 0.0 < differs.mean() < 1.0:
        axes.contour(across, up, differs, levels=[0.5], colors="black", linewidths=1.0)
    units = str(part[f"{HEAD}{name}"].attrs["units"])
    label = escaped_text("difference / uncertainty" if is_known else label_with_unit("difference", units))
    map_colour_bar(mesh, label, axes, extend="both" if sizes.max(initial=0.0) > top else "neither")
    axes.set(xlabel=number_label(part, x), ylabel=number_label(part, y))
    axes.grid(visible=False)
    share = f"{int(differs.sum())} of {differs.size} differ" if is_known else "uncertainty unknown"
    axes.set_title(
        "\n".join(map(escaped_text, (f"{name}{other_settings_note(part, wide)}", share))), loc="left", fontsize=10
    )


def _draw_difference_lines(part: xr.Dataset, name: str, wide: list[str], axes: Axes) -> None:
    """Draw differences over one axis, a line for each place along the others, with what they are uncertain by as bars."""
    dim = wide[0]
    x = part[dim].values.astype(float)
    places = [*_other_indices(part, name, wide)]
    for k, indices in enumerate(places[:MOST_LINES]):
        line = part.isel(indices)
        axes.errorbar(
            x,
            line[f"{HEAD}{name}"].values.astype(float),
            np.nan_to_num(line[f"uncertainty_{name}"].values.astype(float)),
            marker="." if len(x) <= 60 else "",
            color=COLOURS[k % len(COLOURS)],
            linewidth=1.0,
            elinewidth=0.7,
            capsize=2.0 if len(x) <= 60 else 0.0,
            label=escaped_text(other_settings_note(line, wide).removeprefix(", ")),
        )
        differs = line[f"verdict_{name}"].values == DIFFERS
        axes.plot(
            x[differs], line[f"{HEAD}{name}"].values[differs], "o", color=FAR, markerfacecolor="none", markersize=7
        )
    axes.axhline(0.0, color="0.5", linewidth=0.8)
    axes.set(xlabel=number_label(part, dim), ylabel=_difference_label(part, name))
    omitted_note = f", {MOST_LINES} of {len(places)} lines" if len(places) > MOST_LINES else ""
    axes.set_title(escaped_text(f"{name}{omitted_note}{_verdict_counts(part, name)}"), loc="left", fontsize=10)
    if len(places) > 1:
        axes.legend(fontsize=7, framealpha=0.85, edgecolor="none")


def _draw_member_differences(part: xr.Dataset, name: str, wide: list[str], axes: Axes) -> None:
    """Draw the difference of each member, along axes of words alone, with its bar."""
    places = [*_other_indices(part, name, wide)]
    members = [part.isel(indices) for indices in places]
    values, doubts = (
        np.array([float(member[f"{kind}{name}"]) for member in members]) for kind in (HEAD, "uncertainty_")
    )
    rows = np.arange(len(members))
    axes.errorbar(values, rows, xerr=np.nan_to_num(doubts), fmt="o", color=COLOURS[0], markersize=4, capsize=2.0)
    axes.axvline(0.0, color="0.5", linewidth=0.8)
    axes.set_yticks(
        rows, [escaped_text(other_settings_note(member, []).removeprefix(", ")) for member in members], fontsize=7
    )
    axes.set(xlabel=_difference_label(part, name), ylim=(len(rows) - 0.5, -0.5))
    axes.set_title(escaped_text(f"{name}{_verdict_counts(part, name)}"), loc="left", fontsize=10)


def _difference_label(part: xr.Dataset, name: str) -> str:
    return escaped_text(label_with_unit("difference", str(part[f"{HEAD}{name}"].attrs["units"])))


def _verdict_counts(part: xr.Dataset, name: str) -> str:
    """Say how many differ by more than their uncertainty."""
    verdicts = part[f"verdict_{name}"].values
    return f": {int((verdicts == DIFFERS).sum())} of {verdicts.size} differ"


PAGE = Page(("sweep comparison", "contrast"), panels_of, foot_of, most_panels=8, height=3.6, single_height=7.0)

"""Figures of budgets over a grid: the number with its uncertainty, and what that comes from."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from xdynamics.budgeting.budget_grid import KIND, TOTALS
from xdynamics.evidence.grid_axes import axes_said
from xdynamics.figures.marks import COLOURS, in_unit, words
from xdynamics.figures.sheet import Page, Panel
from xdynamics.figures.sweep_labels import labelled, other_axes
from xdynamics.figures.sweep_maps import colour_bar
from xdynamics.record.flag_words import words_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_TERMS = 8
SHADES = "cividis"
COVERED = 2.0  # standard uncertainties, of the band


def panels_of(budgets: xr.Dataset) -> list[Panel]:
    """Return over one axis the number in its band and all terms; over two, maps of the number and its uncertainties.

    Further axes are drawn at their first value.
    """
    wide = [dim for dim in axes_said(budgets) if _is_wide(budgets, dim)][:2]
    part = budgets.isel({dim: 0 for dim in axes_said(budgets) if dim in budgets.dims and dim not in wide})
    if len(wide) == 2:
        return [partial(_map, part, name, wide) for name in ("value", *TOTALS)]
    if len(wide) == 1:
        return [partial(_band, part, wide[0]), partial(_terms, part, wide[0])]
    return [partial(_members, budgets)]


def foot_of(budgets: xr.Dataset) -> str:
    """Describe what is drawn."""
    wide = [dim for dim in axes_said(budgets) if _is_wide(budgets, dim)]
    band = f"; band: {COVERED:g} standard uncertainties, dark: the numerical part" if len(wide) == 1 else ""
    return f"{budgets['value'].size} budgets{band}"


def _is_wide(budgets: xr.Dataset, dim: str) -> bool:
    is_axis = dim in budgets.dims and dim in budgets.coords and budgets[dim].dtype.kind in "fi"
    return is_axis and budgets.sizes[dim] > 1


def _band(budgets: xr.Dataset, dim: str, axes: Axes) -> None:
    """Draw the number over an axis, within its total and its numerical uncertainty."""
    x, value = budgets[dim].values.astype(float), budgets["value"].values
    for name, shade, label in (("total_rss", 0.2, "total"), ("numerical_rss", 0.6, "numerical")):
        size = COVERED * budgets[name].values
        axes.fill_between(x, value - size, value + size, color=COLOURS[0], alpha=shade, linewidth=0, label=label)
    axes.plot(x, value, ".-" if len(x) <= 60 else "-", color=COLOURS[0], linewidth=1.0, markersize=4)
    axes.set(xlabel=labelled(budgets, dim), ylabel=words(in_unit("value", str(budgets["value"].attrs["units"]))))
    axes.set_title(words(f"{budgets.attrs['of']}{other_axes(budgets, [dim])}"), loc="left", fontsize=10)
    axes.legend(fontsize=8, frameon=False)


def _terms(budgets: xr.Dataset, dim: str, axes: Axes) -> None:
    """Draw the standard uncertainty of every term over an axis, on a logarithmic scale; the largest have names."""
    x, sizes = budgets[dim].values.astype(float), budgets["standard_uncertainty"].transpose("term", dim).values
    order = np.argsort(-np.nanmax(np.where(np.isfinite(sizes), sizes, 0.0), axis=1), kind="stable")
    names, kinds = budgets["term_name"].values.astype(str), words_of(budgets["term_kind"])
    for rank, term in enumerate(order.tolist()):
        shown = (sizes[term] > 0.0) & np.isfinite(sizes[term])
        if shown.any():
            named = rank < MOST_TERMS
            axes.plot(
                x[shown],
                sizes[term][shown],
                "--" if kinds[term] == "numerical" else "-",
                color=COLOURS[rank % len(COLOURS)] if named else "0.8",
                linewidth=1.1,
                label=words(names[term]) if named else "",
            )
    if axes.lines:
        axes.set_yscale("log")
        axes.legend(fontsize=8, frameon=False)
    axes.set(
        xlabel=labelled(budgets, dim),
        ylabel=words(in_unit("standard uncertainty", str(budgets["value"].attrs["units"]))),
    )
    axes.set_title("terms; dashed: numerical", loc="left", fontsize=10)


def _map(budgets: xr.Dataset, name: str, wide: list[str], axes: Axes) -> None:
    """Draw the number, or one of its uncertainties, over two axes."""
    y, x = wide
    values = np.ma.masked_invalid(budgets[name].transpose(y, x).values)
    across, up = budgets[x].values.astype(float), budgets[y].values.astype(float)
    mesh = axes.pcolormesh(across, up, values, cmap=SHADES, shading="nearest", rasterized=True)
    colour_bar(mesh, words(in_unit("", str(budgets["value"].attrs["units"]))).strip(), axes)
    axes.set(xlabel=labelled(budgets, x), ylabel=labelled(budgets, y))
    axes.grid(visible=False)
    said = {"value": budgets.attrs["of"]} | {
        total: f"{total.removesuffix('_rss')} standard uncertainty" for total in TOTALS
    }
    axes.set_title(words(f"{said[name]}{other_axes(budgets, wide)}"), loc="left", fontsize=10)


def _members(budgets: xr.Dataset, axes: Axes) -> None:
    """Draw the number of each member, along axes of words alone."""
    along = [dim for dim in axes_said(budgets) if dim in budgets.dims]
    stacked = budgets[["value", *TOTALS]].stack(members=along) if along else budgets.expand_dims("members")
    labels = [" ".join(map(str, at if isinstance(at, tuple) else (at,))) for at in stacked["members"].values.tolist()]
    rows = np.arange(len(labels))
    axes.errorbar(
        stacked["value"].values,
        rows,
        xerr=COVERED * stacked["total_rss"].values,
        fmt="o",
        color=COLOURS[0],
        markersize=4,
    )
    axes.set_yticks(rows, [words(label) for label in labels], fontsize=7)
    axes.set(xlabel=words(in_unit("value", str(budgets["value"].attrs["units"]))), ylim=(len(rows) - 0.5, -0.5))
    axes.set_title(words(str(budgets.attrs["of"])), loc="left", fontsize=10)


PAGE = Page((KIND,), panels_of, foot_of, most_panels=4, height=3.6)

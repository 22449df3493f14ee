"""Figures of budgets over a grid: the number with its uncertainty, and what that comes from."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from xdynamics.budgeting.budget import KIND, TOTALS
from xdynamics.evidence.grid_axes import sweep_axis_names
from xdynamics.figures.marks import COLOURS, escaped_text, label_with_unit
from xdynamics.figures.sheet import Page, Panel
from xdynamics.figures.sweep import map_colour_bar, number_label, other_settings_note
from xdynamics.record.flag_words import words_of_flag

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_TERMS = 8
SHADES = "cividis"
COVERED = 2.0  # standard uncertainties, of the band


def panels_of(budgets: xr.Dataset) -> list[Panel]:
    """Return over one axis the number in its band and all terms; over two, maps of the number and its uncertainties.

    Further axes are drawn at their first value.
    """
    wide = [dim for dim in sweep_axis_names(budgets) if _is_numeric_axis(budgets, dim)][:2]
    part = budgets.isel({dim: 0 for dim in sweep_axis_names(budgets) if dim in budgets.dims and dim not in wide})
    if len(wide) == 2:
        return [partial(_draw_budget_map, part, name, wide) for name in ("value", *TOTALS)]
    if len(wide) == 1:
        return [partial(_draw_value_band, part, wide[0]), partial(_draw_terms_over_axis, part, wide[0])]
    return [partial(_draw_member_budgets, budgets)]


def foot_of(budgets: xr.Dataset) -> str:
    """Describe what is drawn."""
    wide = [dim for dim in sweep_axis_names(budgets) if _is_numeric_axis(budgets, dim)]
    band = f"; band: {COVERED:g} standard uncertainties, dark: the numerical part" if len(wide) == 1 else ""
    return f"{budgets['value'].size} budgets{band}"


def _is_numeric_axis(budgets: xr.Dataset, dim: str) -> bool:
    is_axis = dim in budgets.dims and dim in budgets.coords and budgets[dim].dtype.kind in "fi"
    return is_axis and budgets.sizes[dim] > 1


def _draw_value_band(budgets: xr.Dataset, dim: str, axes: Axes) -> None:
    """Draw the number over an axis, within its total and its numerical uncertainty."""
    x, value = budgets[dim].values.astype(float), budgets["value"].values
    for name, shade, label in (("total_rss", 0.2, "total"), ("numerical_rss", 0.6, "numerical")):
        size = COVERED * budgets[name].values
        axes.fill_between(x, value - size, value + size, color=COLOURS[0], alpha=shade, linewidth=0, label=label)
    axes.plot(x, value, ".-" if len(x) <= 60 else "-", color=COLOURS[0], linewidth=1.0, markersize=4)
    axes.set(
        xlabel=number_label(budgets, dim),
        ylabel=escaped_text(label_with_unit("value", str(budgets["value"].attrs["units"]))),
    )
    axes.set_title(escaped_text(f"{budgets.attrs['of']}{other_settings_note(budgets, [dim])}"), loc="left", fontsize=10)
    axes.legend(fontsize=8, frameon=False)


def _draw_terms_over_axis(budgets: xr.Dataset, dim: str, axes: Axes) -> None:
    """Draw the standard uncertainty of every term over an axis, on a logarithmic scale; the largest have names."""
    x, sizes = budgets[dim].values.astype(float), budgets["standard_uncertainty"].transpose("term", dim).values
    order = np.argsort(-np.nanmax(np.where(np.isfinite(sizes), sizes, 0.0), axis=1), kind="stable")
    names, kinds = budgets["term_name"].values.astype(str), words_of_flag(budgets["term_kind"])
    for rank, term in enumerate(order.tolist()):
        is_positive = (sizes[term] > 0.0) & np.isfinite(sizes[term])
        if is_positive.any():
            is_named = rank < MOST_TERMS
            axes.plot(
                x[is_positive],
                sizes[term][is_positive],
                "--" if kinds[term] == "numerical" else "-",
                color=COLOURS[rank % len(COLOURS)] if is_named else "0.8",
                linewidth=1.1,
                label=escaped_text(names[term]) if is_named else "",
            )
    if axes.lines:
        axes.set_yscale("log")
        axes.legend(fontsize=8, frameon=False)
    axes.set(
        xlabel=number_label(budgets, dim),
        ylabel=escaped_text(label_with_unit("standard uncertainty", str(budgets["value"].attrs["units"]))),
    )
    axes.set_title("terms; dashed: numerical", loc="left", fontsize=10)


def _draw_budget_map(budgets: xr.Dataset, name: str, wide: list[str], axes: Axes) -> None:
    """Draw the number, or one of its uncertainties, over two axes."""
    y, x = wide
    values = np.ma.masked_invalid(budgets[name].transpose(y, x).values)
    across, up = budgets[x].values.astype(float), budgets[y].values.astype(float)
    mesh = axes.pcolormesh(across, up, values, cmap=SHADES, shading="nearest", rasterized=True)
    map_colour_bar(mesh, escaped_text(label_with_unit("", str(budgets["value"].attrs["units"]))).strip(), axes)
    axes.set(xlabel=number_label(budgets, x), ylabel=number_label(budgets, y))
    axes.grid(visible=False)
    titles = {"value": budgets.attrs["of"]} | {
        total: f"{total.removesuffix('_rss')} standard uncertainty" for total in TOTALS
    }
    axes.set_title(escaped_text(f"{titles[name]}{other_settings_note(budgets, wide)}"), loc="left", fontsize=10)


def _draw_member_budgets(budgets: xr.Dataset, axes: Axes) -> None:
    """Draw the number of each member, along axes of words alone."""
    member_dims = [dim for dim in sweep_axis_names(budgets) if dim in budgets.dims]
    stacked = budgets[["value", *TOTALS]].stack(members=member_dims) if member_dims else budgets.expand_dims("members")
    labels = [
        " ".join(map(str, member_key if isinstance(member_key, tuple) else (member_key,)))
        for member_key in stacked["members"].values.tolist()
    ]
    rows = np.arange(len(labels))
    axes.errorbar(
        stacked["value"].values,
        rows,
        xerr=COVERED * stacked["total_rss"].values,
        fmt="o",
        color=COLOURS[0],
        markersize=4,
    )
    axes.set_yticks(rows, [escaped_text(label) for label in labels], fontsize=7)
    axes.set(
        xlabel=escaped_text(label_with_unit("value", str(budgets["value"].attrs["units"]))),
        ylim=(len(rows) - 0.5, -0.5),
    )
    axes.set_title(escaped_text(str(budgets.attrs["of"])), loc="left", fontsize=10)


PAGE = Page((KIND,), panels_of, foot_of, most_panels=4, height=3.6)

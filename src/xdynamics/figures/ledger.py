"""Figures of ledgers: every case by every method, and the residual as a share of its bound."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from xdynamics.figures.marks import escaped_text
from xdynamics.figures.sheet import Page, Panel
from xdynamics.record.flag_words import words_of_flag

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHADES = ("#dfe7f2", "#b9cce4", "#8fb0d6")  # of a residual far below its bound, near it, close to it
FAILED, REFUSED, SOUND = "#c8452f", "#f1f1f1", "#3a6ea5"
UPRIGHT = 6  # methods at most, whose names have room beside each other
NEAR, CLOSE = 1e-3, 0.3  # residual over bound
MOST_CALLED = 60  # cases that have room for their names
FARTHEST = 1e3  # share that a residual is drawn at whose bound is 0


def panels_of(ledger: xr.Dataset) -> list[Panel]:
    """Return the panel that shows the ledger as a table; of one method, how close each case comes to its bound."""
    return [partial(_draw_residual_shares if _is_of_one(ledger) else _draw_case_table, ledger)]


def foot_of(ledger: xr.Dataset) -> str:
    """Count the verdicts and explain the colours."""
    verdicts = words_of_flag(ledger["verdict"])
    summary = ", ".join(f"{verdicts.count(word)} {word}" for word in dict.fromkeys(verdicts))
    if _is_of_one(ledger):
        method = ledger["case_method"].values[0]
        return f"{method}: {summary}; dashed: the bound; circles: no residual at all; red: failed; blank: refused"
    return (
        f"{summary}; from light to dark: residual below {NEAR:g}, below {CLOSE:g}, above {CLOSE:g} of its bound; red:"
        " failed; blank: refused"
    )


def _is_of_one(ledger: xr.Dataset) -> bool:
    """Whether all cases are by one method, and one of them at least was not refused."""
    return len({*ledger["case_method"].values.tolist()}) == 1 and bool(np.isfinite(ledger["residual"].values).any())


def _name_rows(names: list[str], axes: Axes) -> None:
    """Name the rows of cases from the top down, or as many of them as have room."""
    rows = range(0, len(names), -(-len(names) // MOST_CALLED))
    axes.set_ylim(len(names), 0)
    axes.set_yticks(
        [row + 0.5 for row in rows], [escaped_text(names[row].replace(".", ": ")) for row in rows], fontsize=7
    )


def _draw_residual_shares(ledger: xr.Dataset, axes: Axes) -> None:
    """Draw residuals over their bounds on a logarithmic axis; those that are 0, which it lacks, as circles at its left end."""
    residuals, bounds = ledger["residual"].values, ledger["bound"].values
    shares = np.divide(residuals, bounds, out=np.where(residuals > 0.0, FARTHEST, residuals), where=bounds > 0.0)
    rows, has_failed = (
        np.arange(shares.size) + 0.5,
        np.array([word == "failed" for word in words_of_flag(ledger["verdict"])]),
    )
    is_positive = shares > 0.0
    left_end = min(shares[is_positive].min(initial=1.0) / 3.0, 0.1)
    axes.axvline(1.0, color="#555555", linewidth=1.2, linestyle="--")
    for colour, case_mask in ((SOUND, ~has_failed), (FAILED, has_failed)):
        axes.plot(shares[is_positive & case_mask], rows[is_positive & case_mask], "o", color=colour, markersize=3.5)
    axes.plot(*np.broadcast_arrays(left_end, rows[shares == 0.0]), "o", mfc="none", color=SOUND, markersize=3.5)
    axes.set(
        xscale="log",
        xlabel="residual over its bound",
        xlim=(left_end / 1.5, 3.0 * shares[is_positive].max(initial=1.0)),
    )
    _name_rows(ledger["case_name"].values.tolist(), axes)


def _draw_case_table(ledger: xr.Dataset, axes: Axes) -> None:
    from matplotlib.patches import Rectangle

    names, methods = ([*dict.fromkeys(map(str, ledger[f"case_{key}"].values))] for key in ("name", "method"))
    for name, method, verdict, residual, bound in zip(
        ledger["case_name"].values,
        ledger["case_method"].values,
        words_of_flag(ledger["verdict"]),
        ledger["residual"].values,
        ledger["bound"].values,
        strict=True,
    ):
        share = residual / bound if bound > 0.0 else 0.0
        shade = SHADES[int(share >= NEAR) + int(share >= CLOSE)]
        colour = {"failed": FAILED, "refused": REFUSED}.get(verdict, shade)
        cell = methods.index(str(method)), names.index(str(name))
        axes.add_patch(Rectangle(cell, 1, 1, facecolor=colour, edgecolor="white", linewidth=0.8))
    axes.set(xlim=(0, len(methods)))
    label_rotation = 90 if len(methods) > UPRIGHT else 0
    axes.set_xticks(
        np.arange(len(methods)) + 0.5, [escaped_text(label) for label in methods], rotation=label_rotation, fontsize=7
    )
    _name_rows(names, axes)
    axes.tick_params(length=0)
    axes.spines[["left", "bottom"]].set_visible(False)
    axes.grid(visible=False)


PAGE = Page(("ledger",), panels_of, foot_of, height=7.5)

"""Figures of ledgers: every case by every method, and the residual as a share of its bound."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from xdynamics.figures.marks import words
from xdynamics.figures.sheet import Page, Panel
from xdynamics.record.flag_words import words_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHADES = ("#dfe7f2", "#b9cce4", "#8fb0d6")  # of a residual far below its bound, near it, close to it
FAILED, REFUSED = "#c8452f", "#f1f1f1"
UPRIGHT = 6  # methods at most, whose names have room beside each other
NEAR, CLOSE = 1e-3, 0.3  # residual over bound


def panels_of(ledger: xr.Dataset) -> list[Panel]:
    """Return the panel that shows the ledger as a table."""
    return [partial(_table, ledger)]


def foot_of(ledger: xr.Dataset) -> str:
    """Count the verdicts and explain the colours."""
    verdicts = words_of(ledger["verdict"])
    summary = ", ".join(f"{verdicts.count(word)} {word}" for word in dict.fromkeys(verdicts))
    return (
        f"{summary}; from light to dark: residual below {NEAR:g}, below {CLOSE:g}, above {CLOSE:g} of its bound; red:"
        " failed; blank: refused"
    )


def _table(ledger: xr.Dataset, axes: Axes) -> None:
    from matplotlib.patches import Rectangle

    names, methods = ([*dict.fromkeys(map(str, ledger[f"case_{key}"].values))] for key in ("name", "method"))
    for name, method, verdict, residual, bound in zip(
        ledger["case_name"].values,
        ledger["case_method"].values,
        words_of(ledger["verdict"]),
        ledger["residual"].values,
        ledger["bound"].values,
        strict=True,
    ):
        share = residual / bound if bound > 0.0 else 0.0
        shade = SHADES[int(share >= NEAR) + int(share >= CLOSE)]
        colour = {"failed": FAILED, "refused": REFUSED}.get(verdict, shade)
        place = methods.index(str(method)), names.index(str(name))
        axes.add_patch(Rectangle(place, 1, 1, facecolor=colour, edgecolor="white", linewidth=0.8))
    axes.set(xlim=(0, len(methods)), ylim=(len(names), 0))
    turned = 90 if len(methods) > UPRIGHT else 0
    axes.set_xticks(np.arange(len(methods)) + 0.5, [words(label) for label in methods], rotation=turned, fontsize=7)
    axes.set_yticks(np.arange(len(names)) + 0.5, [words(label.replace(".", ": ")) for label in names], fontsize=7)
    axes.tick_params(length=0)
    axes.spines[["left", "bottom"]].set_visible(False)
    axes.grid(visible=False)


PAGE = Page(("ledger",), panels_of, foot_of, height=7.5)

"""Figures of error budgets: what each term contributes, and the intervals of random draws."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from xdynamics.budgeting.budget_summary import contribution_text, drawn_doubt
from xdynamics.evidence.evidence_dataset import stated_value
from xdynamics.figures.line_panels import GREY
from xdynamics.figures.marks import COLOURS, escaped_text
from xdynamics.figures.sheet import Page, Panel
from xdynamics.record.flag_words import words_of_flag

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SPAN = 1e6  # over which bars are drawn: smaller terms have none
REACH = 20.0  # from the left end of a bar's number to its right end at most, on that axis
MOST_TERMS = 16  # bars; what is beyond is one more, of all others together
COLOUR = {"numerical": COLOURS[0], "physical": COLOURS[1]}


def panels_of(budget: xr.Dataset) -> list[Panel]:
    """Return the panel of the terms and, if random draws were made, that of their intervals beside the linear one."""
    return [
        partial(_draw_budget_terms, budget),
        *([partial(_draw_intervals, budget)] if "monte_carlo_shortest" in budget else []),
    ]


def foot_of(budget: xr.Dataset) -> str:
    """Describe the number that the budget is for."""
    return f"{budget.attrs['of']} = {stated_value(budget, 'result')}; method {budget.attrs['solver_method']}"


def _draw_budget_terms(budget: xr.Dataset, axes: Axes) -> None:
    """Draw the standard uncertainty of each term, the largest on top, of many terms that of the smaller ones together; and totals."""
    kinds, units = words_of_flag(budget["term_kind"]), str(budget["value"].attrs["units"])
    sizes, names = budget["standard_uncertainty"].values, budget["term_name"].values.astype(str)
    order = np.argsort(-sizes, kind="stable")
    totals = {"numerical": float(budget["numerical_rss"]), "physical": float(budget["physical_rss"])}
    smallest_size = max([size for size in (*sizes, *totals.values()) if np.isfinite(size)], default=0.0) / SPAN
    if not smallest_size > 0.0:
        explanation = "its uncertainty is unknown" if np.isinf(sizes).any() else "nothing is uncertain"
        axes.text(0.5, 0.5, explanation, transform=axes.transAxes, ha="center", fontsize=9, color="#555555")
        axes.set_axis_off()
        return
    order, remaining_terms = (
        (order, order[:0]) if len(order) <= MOST_TERMS + 1 else (order[:MOST_TERMS], order[MOST_TERMS:])
    )
    lines = {kind: total for kind, total in totals.items() if np.inf > total >= smallest_size}
    bars = [(escaped_text(names[i]), float(sizes[i]), drawn_doubt(budget, i), COLOUR[kinds[i]]) for i in order.tolist()]
    if remaining_terms.size:
        bars.append(
            (f"{remaining_terms.size} others together", float(np.linalg.norm(sizes[remaining_terms])), 0.0, GREY)
        )
    for row, (_, size, doubt, colour) in enumerate(bars):
        _draw_term_bar(axes, row, size, doubt, smallest_size, colour)
        _label_term(axes, row, size, doubt, smallest_size, [*lines.values()])
    for kind, total in lines.items():
        axes.axvline(total, color=COLOUR[kind], linewidth=1.2, linestyle="--", label=f"{kind} together")
    axes.set_axisbelow(True)
    axes.set_yticks(range(len(bars)), [label for label, *_ in bars], fontsize=8)
    axes.set(
        xscale="log",
        ylim=(len(bars) - 0.4, -0.6),
        xlim=(smallest_size / 2.0, smallest_size * SPAN * 5.0),
        xlabel=escaped_text(f"standard uncertainty ({units})"),
    )
    axes.set_title("standard uncertainty from each source", loc="left", fontsize=10)
    if lines:
        axes.legend(fontsize=7, framealpha=0.85, edgecolor="none", loc="lower right")


def _draw_term_bar(axes: Axes, row: int, size: float, doubt: float, smallest_size: float, colour: str) -> None:
    """Draw one term, with its own uncertainty; one that is unknown, or too small for the axis, has no bar."""
    if np.inf > size >= smallest_size:  # on a logarithmic axis 0 has no place
        axes.barh(row, size, color=colour, height=0.7)
        if doubt > 0.0:
            axes.errorbar(size, row, xerr=doubt, color="#333333", linewidth=1.0, capsize=3.0)


def _label_term(axes: Axes, row: int, size: float, doubt: float, smallest_size: float, lines: list[float]) -> None:
    """Write the number of a term behind its bar, or behind a line of what is together that would cross the number."""
    label_x = size + doubt if np.inf > size >= smallest_size else smallest_size / 2.0
    for line in sorted(lines):
        label_x = line if label_x < line < label_x * REACH else label_x
    axes.annotate(
        contribution_text(size, doubt) + (" (too small for the axis)" if 0.0 < size < smallest_size else ""),
        (label_x, row),
        (4.0, 0.0),
        textcoords="offset points",
        va="center",
        fontsize=7,
        bbox={"facecolor": axes.get_facecolor(), "edgecolor": "none", "pad": 0.5},  # over the lines of the grid
    )


def _draw_intervals(budget: xr.Dataset, axes: Axes) -> None:
    """Draw the intervals of the draws, and the linear budget's with the same coverage."""
    from xdynamics.model.uncertainty import normal_quantile

    coverage, units, value = (
        float(budget.attrs["coverage"]),
        str(budget["value"].attrs["units"]),
        float(budget["value"]),
    )
    half = float(normal_quantile(np.array([(1.0 + coverage) / 2.0]))[0]) * float(budget["physical_rss"])
    rows = {
        "linear": [value - half, value + half],
        "drawn, symmetric": budget["monte_carlo_symmetric"].values.tolist(),
        "drawn, shortest": budget["monte_carlo_shortest"].values.tolist(),
    }
    for row, ends in enumerate(rows.values()):
        axes.plot(ends, [row, row], "|-", color=COLOURS[1], linewidth=2.0, markersize=10)
        if row:
            doubt = float(budget["monte_carlo_end_doubt"])
            axes.errorbar(ends, [row, row], xerr=doubt, fmt="none", color="#333333", linewidth=1.0, capsize=3.0)
    axes.axvline(value, color=COLOURS[0], linewidth=1.0, label="the run's own value")
    axes.set_yticks(range(len(rows)), [*rows], fontsize=8)
    axes.set(xlabel=escaped_text(f"{budget.attrs['of']} ({units})"), ylim=(len(rows) - 0.5, -0.5))
    axes.locator_params(axis="x", nbins=4)  # numbers that differ in their last digits are long
    verdict = words_of_flag(budget["linear_verdict"])[0].replace("_", " ")
    axes.set_title(f"{coverage:.0%} intervals; the linear budget is {verdict}", loc="left", fontsize=10)
    axes.legend(fontsize=7, framealpha=0.85, edgecolor="none")


PAGE = Page(("budget", "certificate"), panels_of, foot_of, height=4.2)

"""Rows with names: cases of ledgers, as a table of all methods or as shares of their bounds, and terms of error budgets."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from xdynamics.budgeting.budget_summary import contribution_text, drawn_doubt, draws_needed_text
from xdynamics.evidence.evidence_dataset import stated_value
from xdynamics.figures.line_panels import GREY
from xdynamics.figures.marks import COLOURS, draw_line, escaped_text, label_panel
from xdynamics.figures.sheet import Page, Panel
from xdynamics.figures.sweep import KEY
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
    labels = [escaped_text(names[row].replace(".", ": ")) for row in rows]
    axes.set_ylim(len(names), 0)
    axes.set_yticks([row + 0.5 for row in rows], labels, fontsize=7)


def _draw_residual_shares(ledger: xr.Dataset, axes: Axes) -> None:
    """Draw residuals over their bounds on a logarithmic axis; those that are 0, which it lacks, as circles at its left end."""
    residuals, bounds = ledger["residual"].values, ledger["bound"].values
    shares = np.divide(residuals, bounds, out=np.where(residuals > 0.0, FARTHEST, residuals), where=bounds > 0.0)
    rows, has_failed = np.arange(shares.size) + 0.5, np.array(words_of_flag(ledger["verdict"])) == "failed"
    is_positive = shares > 0.0
    left_end = min(shares[is_positive].min(initial=1.0) / 3.0, 0.1)
    axes.axvline(1.0, color="#555555", linewidth=1.2, linestyle="--")
    for colour, is_shown in ((SOUND, is_positive & ~has_failed), (FAILED, is_positive & has_failed)):
        draw_line(axes, shares[is_shown], rows[is_shown], "o", colour, size=3.5)
    draw_line(
        axes, np.full(np.count_nonzero(shares == 0.0), left_end), rows[shares == 0.0], "o", SOUND, size=3.5, mfc="none"
    )
    axes.set(xscale="log", xlim=(left_end / 1.5, 3.0 * shares[is_positive].max(initial=1.0)))
    label_panel(axes, x="residual over its bound")
    _name_rows(ledger["case_name"].values.tolist(), axes)


def _draw_case_table(ledger: xr.Dataset, axes: Axes) -> None:
    from matplotlib.patches import Rectangle

    cases, case_methods, residuals, bounds = (
        ledger[key].values.tolist() for key in ("case_name", "case_method", "residual", "bound")
    )
    names, methods, verdicts = [*dict.fromkeys(cases)], [*dict.fromkeys(case_methods)], words_of_flag(ledger["verdict"])
    for name, method, verdict, residual, bound in zip(cases, case_methods, verdicts, residuals, bounds, strict=True):
        share = residual / bound if bound > 0.0 else 0.0
        shade = SHADES[int(share >= NEAR) + int(share >= CLOSE)]
        colour = {"failed": FAILED, "refused": REFUSED}.get(verdict, shade)
        cell = methods.index(method), names.index(name)
        axes.add_patch(Rectangle(cell, 1, 1, facecolor=colour, edgecolor="white", linewidth=0.8))
    axes.set_xlim(0, len(methods))
    rotation, labels = 90 if len(methods) > UPRIGHT else 0, [escaped_text(label) for label in methods]
    axes.set_xticks(np.arange(len(methods)) + 0.5, labels, rotation=rotation, fontsize=7)
    _name_rows(names, axes)
    axes.tick_params(length=0)
    axes.spines[["left", "bottom"]].set_visible(False)
    axes.grid(visible=False)


SPAN = 1e6  # over which bars are drawn: smaller terms have none
REACH = 20.0  # from the left end of a bar's number to its right end at most, on that axis
MOST_TERMS = 16  # bars; what is beyond is one more, of all others together
COLOUR = {"numerical": COLOURS[0], "physical": COLOURS[1]}


def budget_panels(budget: xr.Dataset) -> list[Panel]:
    """Return the panel of the terms and, if random draws were made, that of their intervals beside the linear one."""
    terms, intervals = partial(_draw_budget_terms, budget), partial(_draw_intervals, budget)
    return [terms, intervals] if "monte_carlo_shortest" in budget else [terms]


def budget_foot(budget: xr.Dataset) -> str:
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
    count = len(order) if len(order) <= MOST_TERMS + 1 else MOST_TERMS
    order, remaining_terms = order[:count], order[count:]
    lines = {kind: total for kind, total in totals.items() if np.inf > total >= smallest_size}
    bars = [(escaped_text(names[i]), float(sizes[i]), drawn_doubt(budget, i), COLOUR[kinds[i]]) for i in order.tolist()]
    if remaining_terms.size:
        others = f"{remaining_terms.size} others together"
        bars.append((others, float(np.linalg.norm(sizes[remaining_terms])), 0.0, GREY))
    for row, (_, size, doubt, colour) in enumerate(bars):
        _draw_term(axes, row, size, doubt, smallest_size, colour, [*lines.values()])
    for kind, total in lines.items():
        axes.axvline(total, color=COLOUR[kind], linewidth=1.2, linestyle="--", label=f"{kind} together")
    axes.set_axisbelow(True)
    axes.set_yticks(range(len(bars)), [label for label, *_ in bars], fontsize=8)
    axes.set(xscale="log", ylim=(len(bars) - 0.4, -0.6), xlim=(smallest_size / 2.0, smallest_size * SPAN * 5.0))
    label_panel(axes, "standard uncertainty from each source", x=("standard uncertainty", units))
    if lines:
        axes.legend(loc="lower right", **KEY)


def _draw_term(
    axes: Axes, row: int, size: float, doubt: float, smallest_size: float, colour: str, lines: list[float]
) -> None:
    """Draw one term with its own uncertainty, and its number behind it, or behind a line that would cross the number.

    One that is unknown, or too small for the axis, has no bar: on a logarithmic axis 0 has no place.
    """
    label_x = smallest_size / 2.0
    if np.inf > size >= smallest_size:
        label_x = size + doubt
        axes.barh(row, size, color=colour, height=0.7)
        if doubt > 0.0:
            axes.errorbar(size, row, xerr=doubt, color="#333333", linewidth=1.0, capsize=3.0)
    for line in sorted(lines):
        label_x = line if label_x < line < label_x * REACH else label_x
    number = contribution_text(size, doubt) + " (too small for the axis)" * bool(0.0 < size < smallest_size)
    paper = {"facecolor": axes.get_facecolor(), "edgecolor": "none", "pad": 0.5}  # over the lines of the grid
    axes.annotate(number, (label_x, row), (4.0, 0.0), textcoords="offset points", va="center", fontsize=7, bbox=paper)


def _draw_intervals(budget: xr.Dataset, axes: Axes) -> None:
    """Draw the intervals of the draws, and the linear budget's with the same coverage."""
    from xdynamics.model.uncertainty import normal_quantile

    coverage, (value, physical, doubt) = (
        float(budget.attrs["coverage"]),
        (float(budget[name]) for name in ("value", "physical_rss", "monte_carlo_end_doubt")),
    )
    half = float(normal_quantile(np.array([(1.0 + coverage) / 2.0]))[0]) * physical
    rows = {
        "linear": [value - half, value + half],
        "drawn, symmetric": budget["monte_carlo_symmetric"].values.tolist(),
        "drawn, shortest": budget["monte_carlo_shortest"].values.tolist(),
    }
    for row, ends in enumerate(rows.values()):
        draw_line(axes, ends, [row, row], "|-", 1, width=2.0, size=10)
        if row:
            axes.errorbar(ends, [row, row], xerr=doubt, fmt="none", color="#333333", linewidth=1.0, capsize=3.0)
    axes.axvline(value, color=COLOURS[0], linewidth=1.0, label="the run's own value")
    axes.set_yticks(range(len(rows)), [*rows], fontsize=8)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.locator_params(axis="x", nbins=4)  # numbers that differ in their last digits are long
    verdict = words_of_flag(budget["linear_verdict"])[0].replace("_", " ")
    needs_draws = verdict == "not checked" and stated_value(budget, "draws_needed") is not None
    judged = draws_needed_text(budget) if needs_draws else f"the linear budget is {verdict}"
    title = f"{coverage:.0%} intervals; {judged}"
    label_panel(axes, title, x=(str(budget.attrs["of"]), str(budget["value"].attrs["units"])))
    axes.legend(**KEY)


PAGES = (
    Page(("ledger",), panels_of, foot_of, height=7.5),
    Page(("budget", "certificate"), budget_panels, budget_foot, height=4.2),
)

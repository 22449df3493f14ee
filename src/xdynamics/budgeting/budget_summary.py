"""The summary of a budget in lines of text, with numbers rounded to the digits that their uncertainty justifies."""

from __future__ import annotations

import re
from collections.abc import Iterator
from math import inf, isfinite
from typing import TYPE_CHECKING

import numpy as np

from xdynamics.evidence.diagnosing.summits import RULES, SAID
from xdynamics.evidence.evidence_dataset import stated_value
from xdynamics.record.flag_words import words_of_flag
from xdynamics.units import SECONDS
from xdynamics.units.digits import UNESTIMATED, aligned_table, known_to, scientific, uncertainty_alone, with_uncertainty

if TYPE_CHECKING:
    import xarray as xr

EXPANDED = 2.0  # coverage factor
FINELY = 1e-3  # of an interval: to which its ends are written where nothing else says how well they are known
_NUMBER = re.compile(r"\d+(\.\d+)?(e-?\d+)?")
_SCALED = re.compile(r"\(([-\d.]+) ± ([\d.]+)\)e(-?\d+)")


def rounded_result(value: float, standard: float, numerical: float, units: str, origin: str = "k = 2") -> str:
    """Write a value rounded to its expanded uncertainty (JCGM 100:2008, 7.2.6), and the numerical part separately.

    Parameters
    ----------
    value, standard : float
        The value and its standard uncertainty from all terms.
    numerical : float
        Sum of the numerical bounds.
    units : str
    origin : str
        Text on the coverage factor and the origin of the standard uncertainty.

    Examples
    --------
    >>> rounded_result(16.87412, 0.0061, 3.1e-9, "m")
    '16.874 ± 0.012 m (k = 2, numerical part 3e-9 m)'
    >>> rounded_result(-1234.5, 210.0, 0.0, "1")
    '-1230 ± 420 (k = 2, numerical part 0)'
    >>> rounded_result(16.87412, inf, inf, "m")
    '16.8741 m, of unknown uncertainty'
    """
    unit = "" if units == "1" else f" {units}"
    if standard == inf:
        return f"{value:.{UNESTIMATED}g}{unit}, of unknown uncertainty"
    expanded = EXPANDED * standard
    remark = f"{origin}, numerical part {short_size(numerical)}{unit}"
    if not (expanded > 0.0 and isfinite(expanded)):
        return f"{value!r}{unit} ({remark})"
    return f"{with_uncertainty(value, expanded)}{unit} ({remark})"


def drawn_interval(
    low: float, high: float, doubt: float, numerical: float, units: str, origin: str = "95 % of the draws"
) -> str:
    """Write a number as the interval that holds most draws of it, widened by its numerical part (JCGM 101:2008, 5.3).

    Parameters
    ----------
    low, high, doubt : float
        Ends of the interval, and how far each may be off.
    numerical : float
        Sum of the numerical bounds.
    units, origin : str
        As in `rounded_result`.

    Examples
    --------
    >>> drawn_interval(0.00612, 0.36391, 0.0021, 3.1e-9, "m")
    '0.006 to 0.364 m (95 % of the draws, numerical part 3e-9 m)'
    >>> drawn_interval(0.00612, 0.36391, inf, inf, "m")
    'of unknown uncertainty'
    """
    unit = "" if units == "1" else f" {units}"
    if not isfinite(numerical):
        return "of unknown uncertainty"
    end_doubt = doubt if 0.0 < doubt < inf else FINELY * (high - low)
    ends = (known_to(end, end_doubt) for end in (low - numerical, high + numerical))
    return f"{' to '.join(ends)}{unit} ({origin}, numerical part {short_size(numerical)}{unit})"


def short_size(value: float, digits: int = 1) -> str:
    """Write the size of an uncertainty or of a bound.

    Examples
    --------
    >>> short_size(3.1e-9), short_size(0.0061), short_size(12345.0, 2), short_size(0.00614, 2)
    ('3e-9', '0.006', '1.2e4', '0.0061')
    """
    if value == 0.0 or not isfinite(value):
        return f"{value:g}"
    size_text = scientific(value, digits - 1)
    return size_text if not -3 <= int(size_text.partition("e")[2]) <= 3 else f"{float(size_text):g}"


def same_number(first: str, second: str) -> bool:
    """Whether two written results are equal, though earlier versions wrote a small uncertainty with zeros.

    Examples
    --------
    >>> same_number("3.71119880 ± 0.00000053 s (k = 2)", "3.71119880 ± 5.3e-7 s (k = 2)")
    True
    >>> same_number("(9.87654321 ± 0.00000064)e12 m", "9.87654321e12 ± 6.4e5 m"), same_number("3.71 s", "3.72 s")
    (True, False)
    """
    normalised = [
        _NUMBER.sub(lambda number: repr(float(number[0])), _SCALED.sub(r"\1e\3 ± \2e\3", text))
        for text in (first, second)
    ]
    return normalised[0] == normalised[1]


def budget_lines(budget: xr.Dataset) -> Iterator[str]:
    """Summarise the number with its uncertainty, all terms by descending share, the totals, and the draws."""
    units = str(budget["value"].attrs["units"])
    unit = _unit_suffix(units)
    yield f"result    {budget.attrs['of']} = {stated_value(budget, 'result')}"
    yield from extreme_lines(budget)
    header = ("term", "kind", "standard uncertainty", "of the variance", "sensitivity times input")
    yield from aligned_table(header, (_term_row(budget, i, unit) for i in terms_by_share(budget)))
    yield from _unknown_term_lines(budget)
    numerical, bound, physical, total = (
        contribution_text(float(budget[name])) + (unit if float(budget[name]) < inf else "")
        for name in ("numerical_rss", "numerical_bound", "physical_rss", "total_rss")
    )
    yield f"totals    numerical {numerical}, at most {bound}; physical {physical}; together {total}"
    yield from _proven_lines(budget, unit)
    if "monte_carlo_standard_uncertainty" not in budget:
        yield "linear    not checked: draw, with --draws 10000"
        return
    coverage, draws = float(budget.attrs["coverage"]), int(budget.attrs["draws"])
    for name in ("shortest", "symmetric"):
        low, high = budget[f"monte_carlo_{name}"].values
        ends = float(budget["monte_carlo_end_doubt"])
        yield (
            f"drawn     {name} {coverage:.0%} interval {known_to(low, ends)} to {known_to(high, ends)}{unit}, its ends"
            f" ± {short_size(ends)}{unit}"
        )
    standard, doubt = (float(budget[f"monte_carlo_standard_uncertainty{text}"]) for text in ("", "_doubt"))
    yield f"drawn     standard uncertainty {contribution_text(standard, doubt)}{unit}, of {draws} draws"
    verdict = words_of_flag(budget["linear_verdict"])[0].replace("not_checked", "undecided").replace("_", " ")
    remedy = f"; {draws_needed_text(budget)}" if stated_value(budget, "draws_needed") is not None else ""
    yield (
        f"linear    {verdict}: its interval ends {short_size(float(stated_value(budget, 'linear_apart')), 2)}{unit} from that of the"
        f" draws{remedy}"
    )


def _term_row(budget: xr.Dataset, i: int, unit: str) -> tuple[str, ...]:
    """Return a term in words: its contribution, its share, and how both follow from its input."""
    standard, share = float(budget["standard_uncertainty"][i]), float(budget["share"][i])
    slope, slope_unit = float(budget["sensitivity"][i]), _unit_suffix(str(budget["sensitivity_units"].values[i]))
    size = f"{uncertainty_alone(float(budget['input_uncertainty'][i]))}{_unit_suffix(budget['input_units'].values[i])}"
    return (
        str(budget["term_name"].values[i]),
        words_of_flag(budget["term_kind"])[i],
        f"{contribution_text(standard, drawn_doubt(budget, i))}{unit if standard < inf else ''}",
        f"{share:.1%}" if np.isfinite(share) else "",
        f"{slope:.4g}{slope_unit} times {size}" if np.isfinite(slope) else "",
    )


def terms_by_share(budget: xr.Dataset) -> list[int]:
    """Return the places of the terms by descending share, or where a term is unknown, which leaves no shares, by size."""
    shares = np.abs(budget["share"].values)
    sizes = shares if np.isfinite(shares).all() else budget["standard_uncertainty"].values
    order: list[int] = np.argsort(-sizes, kind="stable").tolist()
    return order


def _unknown_term_lines(budget: xr.Dataset) -> Iterator[str]:
    """Explain why terms are unknown, and which number to ask for instead."""
    unknown_rules = (
        budget["term_rule"].values[np.isinf(budget["standard_uncertainty"].values)] if "term_rule" in budget else ()
    )
    yield from (f"attention: {rule}" for rule in unknown_rules)
    if len(unknown_rules):
        yield "attention: ask for the number at an earlier time, or for averages over many starts, by a sweep"


def _proven_lines(budget: xr.Dataset, unit: str) -> Iterator[str]:
    """Describe the proven bounds of the number, if the budget has them."""
    if "proven_interval" not in budget:
        return
    low, high = budget["proven_interval"].values.tolist()
    if not low <= high:
        yield f"proven    nothing: {budget['proven_text'].item()}"
        return
    yield (
        f"proven    {low!r} to {high!r}{unit}, {high - low:.2g}{unit} wide: the run is off by at most"
        f" {uncertainty_alone(float(budget['proven_error']))}{unit}"
    )


def draws_needed_text(budget: xr.Dataset) -> str:
    """Describe how many draws decide whether the linear budget is adequate, where those made leave it open."""
    draw_count = float(stated_value(budget, "draws_needed"))
    return f"{budget.attrs['draws']} draws leave it open, about {draw_count:.0f} settle it"


def extreme_lines(budget: xr.Dataset) -> Iterator[str]:
    """State the time of an extreme, and the rule by which it was located."""
    if (extreme_rule := stated_value(budget, "extreme_rule")) is not None:
        second = _unit_suffix(budget.attrs.get("time_units", SECONDS.text))
        rule = SAID[RULES.index(str(extreme_rule))]
        yield f"found     {rule}, at t = {float(stated_value(budget, 'extreme_time')):.9g}{second}"


def drawn_doubt(budget: xr.Dataset, i: int) -> float:
    """Return the error of a drawn standard uncertainty; 0 in budgets of versions that did not record it."""
    name = "standard_uncertainty_doubt"
    return float(budget[name][i]) if name in budget else 0.0


def contribution_text(size: float, doubt: float = 0.0) -> str:
    """Write a standard uncertainty, followed by its own uncertainty if it was drawn.

    Examples
    --------
    >>> contribution_text(0.0023642), contribution_text(0.0023642, 3.1e-4), contribution_text(inf)
    ('0.0024', '0.0024 ± 0.0003', 'unknown')
    """
    if size == inf:
        return "unknown"
    return with_uncertainty(size, doubt, 1) if doubt > 0.0 else uncertainty_alone(size)


def _unit_suffix(units: object) -> str:
    return "" if str(units) == "1" else f" {units}"


SUMMARIES = {"budget": budget_lines}

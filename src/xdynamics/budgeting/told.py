"""What a person wants to know first of a budget, in lines of text."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from xdynamics.record.words import words_of

if TYPE_CHECKING:
    import xarray as xr


def lines_of(budget: xr.Dataset) -> Iterator[str]:
    """Say the number with its uncertainty, every term from the largest share on, the totals, and what draws tell."""
    units = str(budget["value"].attrs["units"])
    unit = _unit(units)
    yield f"result    {budget.attrs['of']} = {budget.attrs['result']}"
    kinds, shares = words_of(budget["term_kind"]), budget["share"].values
    width = max(len(str(one)) for one in budget["term_name"].values)
    for i in np.argsort(-np.abs(shares), kind="stable").tolist():
        name, standard = str(budget["term_name"].values[i]), float(budget["standard_uncertainty"][i])
        slope, by = float(budget["sensitivity"][i]), str(budget["sensitivity_units"].values[i])
        size = f"{float(budget['input_uncertainty'][i]):.3g}{_unit(budget['input_units'].values[i])}"
        told = f", {slope:.4g}{_unit(by)} times {size}" if np.isfinite(slope) else ""
        yield f"{kinds[i]:<10}{name:<{width}}  {standard:.3g}{unit}, {shares[i]:.1%} of the variance{told}"
    yield (
        f"totals    numerical {float(budget['numerical_rss']):.3g}{unit}, at most {float(budget['numerical_bound']):.3g}{unit};"
        f" physical {float(budget['physical_rss']):.3g}{unit}; together {float(budget['total_rss']):.3g}{unit}"
    )
    if "monte_carlo_standard_uncertainty" not in budget:
        yield "linear    not checked: draw, with --draws 10000"
        return
    part, draws = float(budget.attrs["coverage"]), int(budget.attrs["draws"])
    for name in ("shortest", "symmetric"):
        low, high = budget[f"monte_carlo_{name}"].values
        yield f"drawn     {name} {part:.0%} interval {low:.9g} to {high:.9g}{unit}"
    standard, doubt = (float(budget[f"monte_carlo_standard_uncertainty{one}"]) for one in ("", "_doubt"))
    yield f"drawn     standard uncertainty {standard:.4g}{unit}, of {draws} draws known to {doubt:.1g}{unit}"
    verdict = words_of(budget["linear_verdict"])[0].replace("_", " ")
    yield f"linear    {verdict}: its interval ends {float(budget.attrs['linear_apart']):.2g}{unit} from that of the draws"


def _unit(units: object) -> str:
    return "" if str(units) == "1" else f" {units}"

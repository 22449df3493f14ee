"""A summary of a fit in lines of text."""

from __future__ import annotations

from collections.abc import Iterator
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np

from xdynamics.units.digits import digits

if TYPE_CHECKING:
    import xarray as xr

STRONG = 0.9  # correlations above this are reported


def lines_of(fit: xr.Dataset) -> Iterator[str]:
    """Summarise estimates, their uncertainties, the quality of the fit, and strong correlations."""
    names, units = fit["parameter_name"].values.astype(str), fit["parameter_units"].values.astype(str)
    for i, name in enumerate(names):
        value, uncertainty = float(fit["estimate"][i]), float(fit["standard_uncertainty"][i])
        unit = "" if units[i] == "1" else f" {units[i]}"
        bound = "; on its bound, and no more sure than that" if int(fit["at_bound"][i]) else ""
        yield (
            f"{name:<10}{value:.{digits(value, uncertainty=uncertainty)}g} ± {uncertainty:.2g}{unit} (one standard"
            f" uncertainty){bound}"
        )
    square, freedom = float(fit.attrs["chi_square"]), int(fit.attrs["degrees_of_freedom"])
    if isfinite(square):
        yield f"fit       chi-square {square:.4g} for {freedom} degrees of freedom; {_judged(square, freedom)}"
    else:
        yield (
            f"fit       residuals of {float(fit.attrs['residual_variance']) ** 0.5:.3g}, by which the uncertainties"
            f" are scaled; {freedom} degrees of freedom"
        )
    if "adequate" in fit.attrs:
        word = "adequate" if int(fit.attrs["adequate"]) else "not adequate"
        runs = float(fit.attrs["runs_probability"])
        yield (
            f"verdict   {word}:"
            f" {fit.attrs['adequate_text']}{f'; fewer changes of sign have the probability {runs:.2g}' if isfinite(runs) else ''}"
        )
    if "start" in fit.dims and fit.sizes["start"] > 1:
        best = int(np.argmin(fit["start_square"].values))
        yield (f"searches  {fit.sizes['start']}, the best of them number {best + 1}: {fit['start_rule'].values[best]}")
    strong = [(i, j) for i in range(len(names)) for j in range(i) if abs(float(fit["correlation"][i, j])) > STRONG]
    for i, j in strong:
        yield f"together  {names[j]} and {names[i]} are correlated by {float(fit['correlation'][i, j]):.3f}"
    yield (
        f"search    {fit.attrs['evaluations']} evaluations, condition {float(fit.attrs['condition']):.3g}:"
        f" {fit.attrs['stopped']}"
    )
    if not int(fit.attrs["converged"]):
        yield "doubt     the search did not come to an end: estimates are where it stopped"


def _judged(square: float, freedom: int) -> str:
    from scipy.stats import chi2

    above = float(chi2.sf(square, freedom))
    if above < 1e-3:
        return f"the model or the uncertainties are not right (a larger one has the probability {above:.1g})"
    if above > 1.0 - 1e-3:
        return f"the uncertainties are larger than the residuals (a smaller one has the probability {1.0 - above:.1g})"
    return f"a larger one has the probability {np.round(above, 3):g}"


SUMMARIES = {"fit": lines_of}

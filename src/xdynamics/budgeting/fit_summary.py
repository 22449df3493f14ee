"""A summary of a fit in lines of text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np

from xdynamics.units import unit_suffix
from xdynamics.units.digits import known_to, with_uncertainty

if TYPE_CHECKING:
    import xarray as xr

FEW = 30  # degrees of freedom, below which the normal distribution is not said to be that of estimates
OUTLIER = "outlier_"
STRONG = 0.9  # correlations above this are reported


def fit_lines(fit: xr.Dataset) -> Iterator[str]:
    """Summarise estimates, their uncertainties, the quality of the fit, and strong correlations."""
    units = fit["parameter_units"].values.astype(str).tolist()
    names = [f"{name} of {record}" if record else name for name, record in parameter_names(fit)]
    for i, name in enumerate(names):
        value, uncertainty = float(fit["estimate"][i]), float(fit["standard_uncertainty"][i])
        unit = "" if units[i] == "1" else f" {units[i]}"
        bound = "; on its bound, and no more sure than that" if int(fit["at_bound"][i]) else ""
        yield (f"{name:<9} {with_uncertainty(value, uncertainty)}{unit} (one standard uncertainty){bound}")
    yield from _interval_lines(fit, names, units)
    square, freedom = float(fit.attrs["chi_square"]), int(fit.attrs["degrees_of_freedom"])
    if isfinite(square):
        yield f"fit       chi-square {square:.4g} for {freedom} degrees of freedom; {_chi_square_text(square, freedom)}"
    else:
        yield (
            f"fit       residuals of {float(fit.attrs['residual_variance']) ** 0.5:.3g}{_common_unit(fit)}, by which the uncertainties"
            f" are scaled; {freedom} degrees of freedom"
        )
    if "adequate" in fit.attrs:
        word = "adequate" if int(fit.attrs["adequate"]) else "not adequate"
        runs = float(fit.attrs["runs_probability"])
        yield (
            f"verdict   {word}:"
            f" {fit.attrs['adequate_text']}{f'; fewer changes of sign have the probability {runs:.2g}' if isfinite(runs) else ''}"
        )
    if outliers := [name for name in fit.data_vars if str(name).startswith(OUTLIER) and (fit[name] == 1).any()]:
        outlier_text = ", ".join(
            f"{int((fit[name] == 1).sum())} of {str(name).removeprefix(OUTLIER)}" for name in outliers
        )
        yield f"outliers  {outlier_text}, over three standard deviations off, which count less"
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


def _common_unit(fit: xr.Dataset) -> str:
    """Return the common unit of all fitted quantities; empty if they differ."""
    units = {
        str(variable.attrs["units"]) for name, variable in fit.data_vars.items() if str(name).startswith("residual_")
    }
    return unit_suffix(*units) if len(units) == 1 else ""


def parameter_names(fit: xr.Dataset) -> list[tuple[str, str]]:
    """Return the names of fitted numbers, each with the record it belongs to; empty if all records share it."""
    names = fit["parameter_name"].values.astype(str).tolist()
    records = fit["parameter_record"].values.astype(str).tolist() if "parameter_record" in fit else [""] * len(names)
    return list(zip(names, records, strict=True))


def _interval_lines(fit: xr.Dataset, names: Sequence[str], units: Sequence[str]) -> Iterator[str]:
    """State intervals that one standard uncertainty does not describe: of profiles, or of few values."""
    profile = fit.attrs.get("intervals") == "profile"
    has_few_values = not isfinite(float(fit.attrs["chi_square"])) and int(fit.attrs["degrees_of_freedom"]) < FEW
    if "interval" not in fit or not (profile or has_few_values):
        return
    method_text = "by the profile of the sum of squares" if profile else "by Student's t"
    for name, unit, (low, high), deviation in zip(
        names, units, fit["interval"].values, fit["standard_uncertainty"].values, strict=True
    ):
        ends = " to ".join(known_to(end, deviation / 10.0) if isfinite(end) else "no end" for end in (low, high))
        yield f"interval  {name}: {ends}{'' if unit == '1' else f' {unit}'}, {float(fit.attrs['coverage']):g} {method_text}"


def _chi_square_text(square: float, freedom: int) -> str:
    from scipy.stats import chi2

    tail_probability = float(chi2.sf(square, freedom))
    if tail_probability < 1e-3:
        return f"the model or the uncertainties are not right (a larger one has the probability {tail_probability:.1g})"
    if tail_probability > 1.0 - 1e-3:
        return f"the uncertainties are larger than the residuals (a smaller one has the probability {1.0 - tail_probability:.1g})"
    return f"a larger one has the probability {np.round(tail_probability, 3):g}"


SUMMARIES = {"fit": fit_lines}

"""Estimates, residuals and searches of a fit as variables of its Dataset."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.budgeting.multistart import Search
from xdynamics.evidence.evidence_dataset import about
from xdynamics.schema import AT

if TYPE_CHECKING:
    pass

from xdynamics.budgeting.fit_problem import Asked

Floats = NDArray[np.float64]

PARAMETER, OTHER = "parameter", "other"
ROLE = "fit"
START = "start"


def estimates_as(asked: Asked, best: Search, values: Floats, deviations: Floats, correlation: Floats) -> dict[str, Any]:
    """Return the estimates with their uncertainties and correlations as variables."""
    units = [asked.declared(name).unit.text for name in asked.names]
    return {
        "parameter_name": ((PARAMETER,), np.array(asked.names), about("1", "what was found", "name")),
        "parameter_units": (
            (PARAMETER,),
            np.array(units),
            about("1", "unit of the estimate and its uncertainty", "units"),
        ),
        "estimate": ((PARAMETER,), values, about("1", "value that fits best, in parameter_units", ROLE)),
        "standard_uncertainty": (
            (PARAMETER,),
            deviations,
            about("1", "standard uncertainty of the estimate, in parameter_units", ROLE),
        ),
        "at_bound": (
            (PARAMETER,),
            best.bounded.astype(np.int8),
            about("1", "1 where the estimate is on its bound, and its uncertainty means nothing", ROLE),
        ),
        "correlation": ((PARAMETER, OTHER), correlation, about("1", "correlation of the estimates", ROLE)),
    }


def residuals_as(asked: Asked, computed: Floats) -> dict[str, Any]:
    """Return what was measured, what the fitted model has there, and the difference, as variables."""
    n = len(asked.data.times)
    observed, weights = asked.measured, asked.weights
    variables: dict[str, Any] = {}
    for k, (name, unit) in enumerate(asked.quantities.items()):
        part = slice(k * n, (k + 1) * n)
        variables |= {
            f"measured_{name}": ((AT,), observed[part], about(unit.text, f"{name} as measured", "measured")),
            name: ((AT,), computed[part], about(unit.text, f"{name} as the fitted model has it", "computed")),
            f"residual_{name}": (
                (AT,),
                observed[part] - computed[part],
                about(unit.text, f"{name}, measured minus computed", "residual"),
            ),
        }
        if asked.data.uncertainties:
            variables[f"measured_uncertainty_{name}"] = (
                (AT,),
                1.0 / weights[part],
                about(unit.text, f"standard uncertainty of {name} as measured", "uncertainty"),
            )
    return variables


def searches_as(results: list[Search], scales: Floats) -> dict[str, Any]:
    """Return all searches as variables."""
    return {
        "start_rule": (
            (START,),
            np.array([search.rule for search in results]),
            about("1", "where the search began", "rule"),
        ),
        "start_value": (
            (START, PARAMETER),
            np.array([search.start * scales for search in results]),
            about("1", "values that the search began with, in parameter_units", ROLE),
        ),
        "start_estimate": (
            (START, PARAMETER),
            np.array([search.end * scales for search in results]),
            about("1", "values that it came to, in parameter_units", ROLE),
        ),
        "start_square": (
            (START,),
            np.array([search.square for search in results]),
            about("1", "weighted sum of squares there; infinite where a run did not come to all times", ROLE),
        ),
        "start_converged": (
            (START,),
            np.array([search.converged for search in results], np.int8),
            about("1", "1 where the search came to an end", ROLE),
        ),
    }

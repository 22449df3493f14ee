"""Estimates, residuals and searches of a fit as variables of its Dataset."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from xdynamics.budgeting.fit_problem import SHARED, Fitting
from xdynamics.budgeting.fit_records import owner_record
from xdynamics.budgeting.multistart import LINEAR, Search
from xdynamics.evidence.evidence_dataset import attrs_of
from xdynamics.model import Model
from xdynamics.schema import AT, AT_TIME, BOUNDS

Floats = NDArray[np.float64]

PARAMETER, OTHER, RECORD = "parameter", "other", "record"
ROLE = "fit"
START = "start"


@dataclass(frozen=True)
class Bands:
    """How well a fitted model is known at the measurements, in units of their weights.

    Attributes
    ----------
    fitted : ndarray, shape (n,)
        Standard uncertainty of what is fitted, by the covariance of the estimates (the delta method: G. A. F. Seber, C. J.
        Wild, Nonlinear Regression (1989), section 5.1).
    predicted : ndarray, shape (n,)
        Of one more measurement there: with the scatter of a measurement.
    half : float
        Half of the intervals' width, in standard uncertainties.
    """

    fitted: Floats
    predicted: Floats
    half: float


class Estimates(Protocol):
    """Fitted numbers in their units, with their uncertainties."""

    @property
    def values(self) -> Floats:
        """Estimates, shape (n,)."""

    @property
    def deviations(self) -> Floats:
        """Standard uncertainties."""

    @property
    def correlation(self) -> Floats:
        """Correlations, shape (n, n)."""

    @property
    def intervals(self) -> Floats:
        """Ends of intervals, shape (n, 2)."""


def estimate_variables(problem: Fitting, best: Search, estimates: Estimates, coverage: float) -> dict[str, Any]:
    """Return the estimates with their uncertainties and correlations as variables."""
    numbers = problem.numbers
    units = [owner_record(problem.records, number).declared(number.name).unit.text for number in numbers]
    interval = f"interval that holds the true value with a probability of {coverage:g}, in parameter_units"
    variables = {
        "parameter_name": (
            (PARAMETER,),
            np.array([number.name for number in numbers]),
            attrs_of("1", "name of the fitted parameter or initial value", "name"),
        ),
        "parameter_units": (
            (PARAMETER,),
            np.array(units),
            attrs_of("1", "unit of the estimate and its uncertainty", "units"),
        ),
        "estimate": ((PARAMETER,), estimates.values, attrs_of("1", "value that fits best, in parameter_units", ROLE)),
        "standard_uncertainty": (
            (PARAMETER,),
            estimates.deviations,
            attrs_of("1", "standard uncertainty of the estimate, in parameter_units", ROLE),
        ),
        "interval": ((PARAMETER, BOUNDS), estimates.intervals, attrs_of("1", interval, ROLE) | {"coverage": coverage}),
        "at_bound": (
            (PARAMETER,),
            best.bounded.astype(np.int8),
            attrs_of("1", "1 where the estimate is on its bound, and its uncertainty means nothing", ROLE),
        ),
        "correlation": ((PARAMETER, OTHER), estimates.correlation, attrs_of("1", "correlation of the estimates", ROLE)),
    }
    if len(problem.records) > 1:
        owners = ["" if number.record == SHARED else problem.records[number.record].label for number in numbers]
        variables["parameter_record"] = (
            (PARAMETER,),
            np.array(owners),
            attrs_of("1", "record that has the number for itself; empty where all share it", "name"),
        )
    return variables


def record_variables(problem: Fitting, fitted: Sequence[Model]) -> dict[str, Any]:
    """Return the times of all records, which record each is of, and the fitted models as variables."""
    records = problem.records
    texts, model_description = (
        [model.to_toml() for model in fitted],
        "the fitted model as TOML, with the uncertainties and correlations of the fit",
    )
    times = np.concatenate([record.data.times for record in records])
    variables: dict[str, Any] = {
        AT_TIME: ((AT,), times, attrs_of(records[0].model.time_unit.text, "time of measurement", "time")),
        "model_toml": (
            (RECORD,) if len(texts) > 1 else (),
            np.array(texts if len(texts) > 1 else texts[0]),
            attrs_of("1", model_description, "model"),
        ),
    }
    if len(records) > 1:
        record_indices = np.repeat(np.arange(len(records)), [record.data.times.size for record in records])
        variables["record_name"] = (
            (RECORD,),
            np.array([record.label for record in records]),
            attrs_of("1", "name of the record", "name"),
        )
        variables["at_record"] = (
            (AT,),
            record_indices,
            attrs_of("1", "record that a measurement is of, from 0", "index"),
        )
    if any(record.data.occurrences.size for record in records):
        numbers = [
            record.data.occurrences if record.data.occurrences.size else np.zeros(record.data.times.size, int)
            for record in records
        ]
        variables["at_occurrence"] = (
            (AT,),
            np.concatenate(numbers),
            attrs_of("1", "which occurrence of its event was timed, from 1; 0 where a value was measured", "index"),
        )
    return variables


def residual_variables(problem: Fitting, residual: Floats, bands: Bands) -> dict[str, Any]:
    """Return measured values, fitted values with their uncertainties, and residuals as variables.

    Where there are several records, a quantity that one of them has not is nan along its rows.
    """
    variables: dict[str, Any] = {}
    rows = sum(record.data.times.size for record in problem.records)
    outlying = problem.outlying(residual)
    first, value_offset = 0, 0
    for record in problem.records:
        n, observed, weights = record.data.times.size, record.measured, record.weights
        for k, (name, unit) in enumerate(record.quantities.items()):
            part, all_rows = slice(k * n, (k + 1) * n), slice(value_offset + k * n, value_offset + (k + 1) * n)
            difference = -residual[all_rows] / weights[part]
            columns = {
                f"measured_{name}": (observed[part], f"{name} as measured", "measured"),
                name: (observed[part] - difference, f"{name} as the fitted model has it", "computed"),
                f"residual_{name}": (difference, f"{name}, measured minus computed", "residual"),
            }
            for word, row, description in (
                (
                    "fitted",
                    bands.fitted,
                    f"standard uncertainty of {name} as the fitted model has it, by the estimates' covariance",
                ),
                ("predicted", bands.predicted, f"standard uncertainty of one more measurement of {name} there"),
            ):
                columns[f"{word}_uncertainty_{name}"] = (row[all_rows] / weights[part], description, "uncertainty")
            if problem.has_uncertainties:
                description = f"standard uncertainty of {name} as measured"
                columns[f"measured_uncertainty_{name}"] = (1.0 / weights[part], description, "uncertainty")
            if problem.loss.name != LINEAR:
                description = f"1 where {name} is off by over three standard deviations, and counts less"
                columns[f"outlier_{name}"] = (outlying[all_rows].astype(float), description, ROLE)
            for key, (values, about_it, role) in columns.items():
                units = "1" if key.startswith("outlier_") else unit.text
                column = variables.setdefault(key, ((AT,), np.full(rows, np.nan), attrs_of(units, about_it, role)))
                column[1][first : first + n] = values
        first, value_offset = first + n, value_offset + observed.size
    return variables


def search_variables(searches: list[Search], scales: Floats) -> dict[str, Any]:
    """Return all searches as variables."""
    return {
        "start_rule": (
            (START,),
            np.array([search.rule for search in searches]),
            attrs_of("1", "how the starting point of the search was chosen", "rule"),
        ),
        "start_value": (
            (START, PARAMETER),
            np.array([search.start * scales for search in searches]),
            attrs_of("1", "starting values of the search, in parameter_units", ROLE),
        ),
        "start_estimate": (
            (START, PARAMETER),
            np.array([search.end * scales for search in searches]),
            attrs_of("1", "values at which the search ended, in parameter_units", ROLE),
        ),
        "start_square": (
            (START,),
            np.array([search.square for search in searches]),
            attrs_of(
                "1",
                "weighted sum of squared residuals at the end of the search; infinite where a run did not reach all times",
                ROLE,
            ),
        ),
        "start_converged": (
            (START,),
            np.array([search.converged for search in searches], np.int8),
            attrs_of("1", "1 where the search converged", ROLE),
        ),
    }

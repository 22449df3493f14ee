"""Parameters and initial values from measured data: weighted least squares, with uncertainties and diagnostics."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.budgeting.fit_problem import Asked, Fitting
from xdynamics.budgeting.fit_variables import estimates_as, residuals_as, searches_as
from xdynamics.budgeting.multistart import Search, searches
from xdynamics.budgeting.residuals import Tested
from xdynamics.evidence.comparing.measured import measured
from xdynamics.evidence.evidence_dataset import about, exhibit
from xdynamics.evidence.observables import comparable
from xdynamics.faults import AccuracyWarning, InputError, Ledger, warn, written
from xdynamics.march.configuration import settings_for
from xdynamics.model import Model
from xdynamics.model.parts import Fitted, Parameter
from xdynamics.model.uncertainty import Spread
from xdynamics.record.columns import columns_of
from xdynamics.record.element_attributes import of_wholes
from xdynamics.schema import AT, AT_TIME
from xdynamics.sweeping.axes import numbers_of
from xdynamics.sweeping.sweep import plain
from xdynamics.units import Quantity, parse_unit, unit_suffix

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

STARTS = 8  # most searches
ALIKE = 1e-8  # ratio to the largest singular value below which columns are dependent


def fit(
    model: Model,
    data: Any,
    parameters: Sequence[str],
    *,
    bounds: Mapping[str, Sequence[Any]] | None = None,
    gaps: str = "refuse",
    reading: Mapping[str, Any] | None = None,
    starts: int = STARTS,
    seed: int = 0,
    compute: bool = True,
    **settings: Any,
) -> xr.Dataset:
    """Find parameters and initial values from measured data by weighted least squares.

    Parameters
    ----------
    model : Model
        The search begins at its own values.
    data : str, Path, DataFrame or Dataset
        Measured data as for `compare`: ``time [ms],x [mm],u(x) [mm]``.
    parameters : sequence of str
        Parameters and initial values to be fitted: ``"k"``, of a quantity with dimensions all elements, or ``"k[2]"``.
    gaps : {"refuse", "skip"}
        Whether rows of the data in which a number is missing are refused or skipped; columns that the model does not
        have are skipped.
    reading : mapping, optional
        How a file is read that does not say it, as for `compare`.
    bounds : mapping of str to (lowest, highest), optional
        ``{"k": ("0 N m-1", "10 N m-1")}``.
    starts : int
        Largest number of searches: from the model's own values, over growing parts of the time, and from the best of 96
        starts drawn about the model's own values or between bounds. Searching stops once residuals are no more than
        noise.
    seed : int
        Seed of the drawn starts.
    compute : bool
        A search is computed at once: False is refused, with what to give to lazy stages instead.
    **settings
        Settings of `simulate`.

    Returns
    -------
    xarray.Dataset
        Along `parameter`: `parameter_name`, `parameter_units`, `estimate` and `standard_uncertainty` in these,
        `at_bound`, and with `other` the `correlation`. Along `at` the measured values, those of the fitted model, and
        the `residual_…`. Along `start` every search: `start_rule`, `start_value`, `start_estimate`, `start_square` (the
        weighted sum of squares at its end), `start_converged`. Attributes `chi_square_probability`, `runs_probability`
        and `adequate`: 1 where the residuals are no more than noise; otherwise there is a warning, and budgets refuse
        the fitted model unless told otherwise. `model_toml` is the fitted model with the uncertainties and correlations
        of its parameters; pass ``Model.from_text(str(found.model_toml.values))`` on to `error_budget`.

    Raises
    ------
    InputError
        If the data do not determine the parameters, a column is not a quantity of the model, or a run ends before all
        times.

    Notes
    -----
    Trust-region reflective least squares by `scipy.optimize.least_squares` (Branch, Coleman, Li 1999,
    doi:10.1137/S1064827595289108), slopes by central differences of fourth order, all copies marched side by side. The
    covariance is the inverse of J^T W J; without uncertainties of the data it is scaled by the residuals' variance
    (Bevington, Robinson, Data Reduction and Error Analysis, 2003, section 8.5). Residuals are tested by chi-square
    where the data have uncertainties, and by the number of their runs of one sign (Wald, Wolfowitz 1940). Errors of the
    march itself are not included: choose steps or tolerances that keep them small compared with the residuals.

    Examples
    --------
    >>> import xdynamics as xd
    >>> model = xd.Model.from_toml("data/models/harmonic_oscillator.toml")
    >>> times = np.linspace(0.1, 3.0, 30)
    >>> import pandas as pd
    >>> bench = pd.DataFrame({"time [s]": times, "x [m]": np.cos(1.9 * times)})
    >>> found = fit(model, bench, ["k"], method="rk4", step="10 ms", until="4 s")
    >>> round(float(found.estimate[0] / model.parameters["m"].quantity.si) ** 0.5, 6)
    1.9
    """
    if not compute:
        raise InputError(
            "a fit is a search, and how many runs it marches is known only once it ends: compute it, and give the model of"
            " its model_toml to stages with compute=False"
        )
    if isinstance(starts, bool) or not isinstance(starts, int) or starts < 1:
        raise InputError(f"starts is {starts!r}, needs a whole number from 1 on")
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise InputError(f"seed is {seed!r}, needs a non-negative whole number")
    asked = _asked(
        model,
        data,
        parameters,
        gaps,
        reading,
        {name: plain(name, entry) for name, entry in settings.items() if entry is not None},
    )
    start = np.array([asked.declared(name).value for name in asked.names])
    low, high = _bounds(asked, bounds or {})
    problem = Fitting(asked, _scales(asked, start, low, high))
    scales, results, test = problem.scales, list[Search](), None
    for entry in searches(problem, start / scales, low / scales, high / scales, starts, seed):
        results.append(entry)
        if entry.converged and len(results) == 1:
            _covariance(asked, entry.slopes)  # raises for indeterminate parameters before searching on
        if entry.converged and (test := problem.tested(entry)).adequate:
            break
    best = min(results, key=lambda entry: entry.square)
    if not np.isfinite(best.square):
        raise InputError(results[0].stopped)
    test = problem.tested(best)
    evidence = _dataset(problem, results, best, test, seed)
    if not (test.adequate and best.converged):
        reason = test.text if not test.adequate else f"the search did not come to an end: {best.stopped}"
        warn(f"the fit of '{model.name}' to {asked.data.name} is not adequate: {reason}", AccuracyWarning)
    return evidence


def _asked(model: Any, data: Any, parameters: Any, gaps: str, reading: Any, settings: dict[str, Any]) -> Asked:
    """Check the arguments of a fit against model and data."""
    if not isinstance(model, Model):
        raise InputError(f"model is {str(model)[:60]!r}, needs a Model; read a file with Model.from_toml")
    named = (parameters,) if isinstance(parameters, str) else tuple(parameters)
    names = tuple(element for name in named for element in _elements(model, name))
    available = [*model.parameters, *(name for name in model.initial if name != "t")]
    if not names or len({*names}) < len(names):
        raise InputError(
            f"parameters are {[*names]}, need one name or more, each once; there are {', '.join(of_wholes(available))}"
        )
    for name in names:
        if name not in available:
            raise InputError(f"'{name}' is no parameter or initial value; there are {', '.join(of_wholes(available))}")
    table = measured(data, comparable(model), gaps, model.time_unit, model.shapes, reading)
    march_settings = settings_for(model, **settings)
    columns = {
        column.variable.name: column.variable.units
        for column in columns_of(march_settings.layout(model), march_settings)
    }
    units = {name: parse_unit(columns[name]) for name in comparable(model)}
    ledger = Ledger(table.name)
    for name, (_, unit) in table.values.items():
        if name not in units:
            ledger.note(f"column '{name}' is nothing that the model has; there are {', '.join(of_wholes(units))}")
        elif unit.dimension != units[name].dimension:
            ledger.note(f"column '{name}' is in '{unit.text}', needs '{units[name].text}' or a unit like it")
        elif table.uncertainties and name not in table.uncertainties:
            ledger.note(f"column '{name}' has no uncertainties, and others have: give u({name}) too, or none")
    begin, end, second = model.initial["t"].si, march_settings.until, unit_suffix(model.time_unit)
    outside = np.flatnonzero((table.times < begin) | (table.times > end))
    if outside.size:
        ledger.note(
            f"row {int(outside[0]) + 1}: t = {float(table.times[outside[0]])!r}{second} is outside the run, from"
            f" {begin!r}{second} to {end!r}{second}; give until=…"
        )
    rows = len(table.times) * len(table.values)
    if rows <= len(names):
        ledger.note(f"has {rows} numbers for {len(names)} parameters, needs more")
    ledger.raise_faults()
    return Asked(model, names, table, {name: units[name] for name in table.values}, settings)


def _elements(model: Model, name: Any) -> list[Any]:
    """Return the elements of a quantity with dimensions; any other name is returned alone."""
    return [*model.shapes.elements(written(name))] if isinstance(name, str) else [name]


def _bounds(asked: Asked, bounds: Mapping[str, Sequence[Any]]) -> tuple[Floats, Floats]:
    """Read bounds, in each number's own unit."""
    low, high = (np.full(len(asked.names), side) for side in (-np.inf, np.inf))
    of_elements = {element: ends for name, ends in bounds.items() for element in _elements(asked.model, name)}
    for name, ends in of_elements.items():
        if name not in asked.names:
            raise InputError(f"bounds name '{name}', which is not fitted; there are {', '.join(asked.names)}")
        declared = asked.declared(name)
        try:
            values, unit = numbers_of(list(ends), declared.unit)
        except (InputError, TypeError) as error:
            raise InputError(f"bounds of '{name}' are {ends!r}, need the lowest and the highest: {error}") from None
        values = values * float(unit.factor / declared.unit.factor)
        if len(values) != 2 or not values[0] < values[1] or not values[0] <= declared.value <= values[1]:
            raise InputError(
                f"bounds of '{name}' are {[*map(str, ends)]}, need the lowest, then the highest, and {declared} between"
                " them"
            )
        i = asked.names.index(name)
        low[i], high[i] = values
    return low, high


def _scales(asked: Asked, start: Floats, low: Floats, high: Floats) -> Floats:
    """Return the scale of each number; for one that begins at zero that of its bounds, uncertainty or unit."""
    scales = np.abs(start)
    for i in np.flatnonzero(scales == 0.0).tolist():
        width = float(high[i] - low[i])
        spread = (asked.model.parameters | asked.model.starts).get(asked.names[i])
        scales[i] = (
            width / 2.0 if np.isfinite(width) else (spread.uncertainty if spread and spread.uncertainty else 1.0)
        )
    return scales


def _dataset(problem: Fitting, results: list[Search], best: Search, test: Tested, seed: int) -> xr.Dataset:
    asked, scales, values = problem.asked, problem.scales, best.end * problem.scales
    residual, slopes = best.residual, best.slopes
    computed = residual / asked.weights + asked.measured
    freedom, square = residual.size - values.size, float(residual @ residual)
    covariance, condition = _covariance(asked, slopes)
    if not asked.data.uncertainties:
        covariance = covariance * (square / freedom)
    deviations = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(deviations, deviations) if (deviations > 0).all() else np.eye(len(values))
    deviations = deviations * scales
    fitted = _fitted(asked, values, deviations, correlation, test)
    variables: dict[str, Any] = estimates_as(asked, best, values, deviations, correlation) | {
        AT_TIME: ((AT,), asked.data.times, about(asked.model.time_unit.text, "time of measurement", "time")),
        "model_toml": (
            (),
            np.array(fitted.to_toml()),
            about("1", "the fitted model as TOML, uncertain and correlated by what was found", "model"),
        ),
    }
    variables |= residuals_as(asked, computed) | searches_as(results, scales)
    attributes = {
        "data": asked.data.name,
        "chi_square": square if asked.data.uncertainties else float("nan"),
        "degrees_of_freedom": freedom,
        "residual_variance": square / freedom,
        "condition": condition,
        "evaluations": sum(search.evaluations for search in results),
        "stopped": best.stopped,
        "converged": int(best.converged),
        "chi_square_probability": test.chi_square_probability,
        "runs_probability": test.runs_probability,
        "seed": seed,
        "adequate": int(test.adequate and best.converged),
        "adequate_text": test.text,
        "asked": json.dumps(asked.settings, sort_keys=True),
        "model_digest": asked.model.digest,
        "fitted_digest": fitted.digest,
    }
    return exhibit(
        "fit", f"{asked.model.name}, fitted to {asked.data.name}", [], variables, attributes, shapes=asked.model.shapes
    )


def _covariance(asked: Asked, slopes: Floats) -> tuple[Floats, float]:
    """Return the covariance of the scaled parameters, and the condition number of the normalised slopes.

    Raises
    ------
    InputError
        If the data do not determine some parameters; they are named.
    """
    sizes = np.sqrt((slopes**2).sum(axis=0))
    if idle := [name for name, size in zip(asked.names, sizes, strict=True) if not size > 0.0]:
        raise InputError(f"the data do not change with '{idle[0]}': it cannot be fitted to them; fix it")
    _, singular, vectors = np.linalg.svd(slopes / sizes, full_matrices=False)
    if singular[-1] <= ALIKE * singular[0]:
        mixed = [name for name, part in zip(asked.names, np.abs(vectors[-1]), strict=True) if part > 0.1]
        raise InputError(f"the data do not tell {' and '.join(mixed)} apart: only a combination of them; fix one")
    inverse = (vectors.T / singular**2) @ vectors
    return inverse / np.outer(sizes, sizes), float(singular[0] / singular[-1])


def _fitted(asked: Asked, values: Floats, deviations: Floats, correlation: Floats, test: Tested) -> Model:
    """Return the model with the estimates, their uncertainties and correlations."""
    statement = asked.model.statement
    parameters, starts, initial = dict(statement.parameters), dict(statement.starts), dict(statement.initial)
    for i, name in enumerate(asked.names):
        unit = asked.declared(name).unit
        declared = parameters.get(name) or starts.get(name)
        entry = Parameter(
            Quantity(float(values[i]), unit),
            Spread(Quantity(float(deviations[i]), unit)),
            declared.description if declared else "",
        )
        if name in parameters:
            parameters[name] = entry
        else:
            starts[name], initial[name] = entry, entry.quantity
    correlations = {pair: entry for pair, entry in statement.correlations.items() if not {*pair} & {*asked.names}}
    uncertain = [i for i in range(len(values)) if deviations[i] > 0.0]
    for i in uncertain:
        for j in uncertain:
            if i < j:
                correlations[asked.names[i], asked.names[j]] = float(np.clip(correlation[i, j], -1.0, 1.0))
    mark = Fitted(asked.data.name, test.adequate, test.text)
    at_rest = tuple(name for name in statement.at_rest if name not in asked.names)
    numbers: dict[str, Any] = {"parameters": parameters, "starts": starts, "initial": initial, "at_rest": at_rest}
    return asked.model.with_statement(replace(statement, **numbers, correlations=correlations, fit=mark))

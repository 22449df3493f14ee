"""Parameters and initial values from measured data: weighted least squares, with uncertainties and diagnostics."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.budgeting.fit_problem import FitRecord, Fitting, ResidualTests
from xdynamics.budgeting.fit_records import (
    fit_bounds,
    number_label,
    number_scales,
    owner_record,
    records_of,
    starts_with_offsets,
)
from xdynamics.budgeting.fit_variables import (
    Bands,
    estimate_variables,
    record_variables,
    residual_variables,
    search_variables,
)
from xdynamics.budgeting.multistart import (
    COVARIANCE,
    LINEAR,
    PROFILE,
    Search,
    intervals_as,
    loss_by_name,
    profile_intervals,
    quantile,
    residual_spread,
    search_from_start,
    searches,
)
from xdynamics.evidence.evidence_dataset import evidence_dataset
from xdynamics.faults import AccuracyWarning, InputError, display_text, warn
from xdynamics.model import Model
from xdynamics.model.parts import Fitted, Parameter
from xdynamics.model.uncertainty import STUDENT, Spread
from xdynamics.sweeping.sweep import json_value
from xdynamics.units import Quantity

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

STARTS = 8  # most searches
DEPENDENT_RATIO = 1e-8  # ratio to the largest singular value below which columns are dependent
FEW = 30  # degrees of freedom, below which a variance that residuals tell makes Student's t of estimates
RESCALED = 20  # most searches after which the spread of good residuals does not change any more


def fit(
    model: Model | Mapping[str, Model],
    data: Any,
    parameters: Sequence[str] = (),
    *,
    own: Sequence[str] | None = None,
    bounds: Mapping[str, Sequence[Any]] | None = None,
    loss: str = LINEAR,
    intervals: str = COVARIANCE,
    coverage: float = 0.95,
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
    model : Model, or mapping of str to Model
        The search begins at its own values. A model for each record, by the records' names, where what is known of them
        differs: ``{"light": model, "heavy": model.replace(parameters={"m": "2 kg"})}``.
    data : str, Path, DataFrame or Dataset, or a list or mapping of them
        Measured data as for `compare`: ``time [ms],x [mm],u(x) [mm]``; or times of events, ``event_time_floor [s]``, one
        row for each occurrence from the first on, or as a column ``occurrence [1]`` says. Several records are fitted at
        once; a mapping names them.
    parameters : sequence of str
        Parameters and initial values to be fitted: ``"k"``, of a quantity with dimensions all elements, or ``"k[2]"``. All
        records share them. Also ``"offset"``: what the clock of the recording reads at the model's time 0.
    own : sequence of str, optional
        Parameters and initial values of which each record has a value of its own.
    gaps : {"refuse", "skip"}
        Whether rows of the data in which a number is missing are refused or skipped; columns that the model does not
        have are skipped.
    reading : mapping, optional
        How a file is read that does not say it, as for `compare`.
    bounds : mapping of str to (lowest, highest), optional
        ``{"k": ("0 N m-1", "10 N m-1")}``.
    loss : {"linear", "soft_l1", "huber", "cauchy"}
        How much a residual counts: all but the first let outliers move the estimates no more than good values do.
    intervals : {"covariance", "profile"}
        Whether `interval` is as wide as the covariance says, or as the sum of squares does where one number is held and the
        others are fitted again.
    coverage : float
        Probability with which an interval holds the true value.
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
        `interval` (along `bound`), `at_bound`, and with `other` the `correlation`; `parameter_record` of several records.
        Along `at` the measured values, those of the fitted model, the `residual_…`, `fitted_uncertainty_…` (of the fitted
        model, by the covariance of the estimates) and `predicted_uncertainty_…` (of one more measurement there). Along `start` every search: `start_rule`, `start_value`, `start_estimate`, `start_square` (the
        weighted sum of squares at its end), `start_converged`. Attributes `chi_square_probability`, `runs_probability`
        and `adequate`: 1 where the residuals are no more than noise; otherwise there is a warning, and budgets refuse
        the fitted model unless told otherwise. `model_toml` is the fitted model with the uncertainties and correlations
        of its parameters; pass ``Model.from_text(found.model_toml.values.item())`` on to `error_budget`; it is along `record`
        where records have numbers or models of their own. Robust losses mark an `outlier_…`.

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
    (Bevington, Robinson, Data Reduction and Error Analysis, 2003, section 8.5), and intervals are Student's t; of a robust
    loss it is that of an M-estimate (Huber 1981, Robust Statistics, 7.6.8), whose scale is the median size of the residuals
    where the data have no uncertainties. Residuals are tested by chi-square
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
            "a fit is a search, and how many runs it computes is known only once it ends: compute it, and give the model of"
            " its model_toml to stages with compute=False"
        )
    _check_choices(starts, seed, loss, intervals, coverage)
    march = {name: json_value(name, entry) for name, entry in settings.items() if entry is not None}
    records, numbers = records_of(model, data, parameters, own, gaps, reading, march)
    start = np.array([owner_record(records, number).declared(number.name).value for number in numbers])
    low, high = fit_bounds(records, numbers, bounds or {})
    start = np.clip(starts_with_offsets(records, numbers, start, low, high), low, high)
    scales = number_scales(records, numbers, start, low, high)
    problem = Fitting(records, numbers, scales)
    if problem.has_uncertainties:
        problem = replace(problem, loss=loss_by_name(loss))
    search_results = _until_adequate(
        problem, searches(problem, start / scales, low / scales, high / scales, starts, seed)
    )
    best = min(search_results, key=lambda entry: entry.square)
    if not np.isfinite(best.square):
        raise InputError(search_results[0].stopped)
    if loss != problem.loss.name:
        problem, best = _search_robust(problem, best, loss, low / scales, high / scales)
    test = problem.residual_tests(best)
    choice = Choice(intervals, coverage, low / scales, high / scales, seed)
    evidence = _fit_dataset(problem, search_results, best, test, choice)
    if not (test.adequate and best.converged):
        name = records[0].model.name
        reason = test.text if not test.adequate else f"the search did not come to an end: {best.stopped}"
        warn(f"the fit of '{name}' to {_data_names(problem)} is not adequate: {reason}", AccuracyWarning)
    return evidence


def _until_adequate(problem: Fitting, search_iterator: Iterable[Search]) -> list[Search]:
    """Return the searches up to the first one whose residuals are no more than noise."""
    search_results: list[Search] = []
    for entry in search_iterator:
        search_results.append(entry)
        if entry.converged and len(search_results) == 1:
            _covariance(problem, entry.slopes)  # raises for indeterminate parameters before searching on
        if entry.converged and problem.residual_tests(entry).adequate:
            break
    return search_results


def _check_choices(starts: Any, seed: Any, loss: str, intervals: str, coverage: Any) -> None:
    if isinstance(starts, bool) or not isinstance(starts, int) or starts < 1:
        raise InputError(f"starts is {starts!r}, needs a whole number from 1 on")
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise InputError(f"seed is {seed!r}, needs a non-negative whole number")
    if intervals not in (COVARIANCE, PROFILE):
        raise InputError(f"intervals is {intervals!r}; there are {COVARIANCE}, {PROFILE}")
    if not isinstance(coverage, int | float) or isinstance(coverage, bool) or not 0.0 < coverage < 1.0:
        raise InputError(f"coverage is {coverage!r}, needs a probability between 0 and 1, like 0.95")
    if loss_by_name(loss).name != LINEAR and intervals == PROFILE:
        raise InputError(
            f"loss is '{loss}' and intervals '{PROFILE}': a robust loss is no sum of squares whose profile is known; leave"
            " one of them out"
        )


def _search_robust(problem: Fitting, best: Search, loss: str, low: Floats, high: Floats) -> tuple[Fitting, Search]:
    """Continue a search with a robust loss, whose scale follows the residuals, until the scale is constant."""
    robust = loss_by_name(loss)
    for _ in range(RESCALED):
        spread = residual_spread(best.residual)
        if not spread > 0.0 or abs(spread / problem.loss.spread - 1.0) < 1e-4:
            break
        problem = replace(problem, loss=replace(robust, spread=spread))
        best = search_from_start(problem, best.rule, best.end, low, high)
    return problem, best


def _data_names(problem: Fitting) -> str:
    return ", ".join(record.data.name for record in problem.records)


@dataclass(frozen=True)
class Choice:
    """How intervals are made, between which bounds, and the seed that was used."""

    intervals: str
    coverage: float
    low: Floats
    high: Floats
    seed: int


@dataclass(frozen=True)
class FitEstimates:
    """The estimates of a search, in the units of the numbers."""

    values: Floats
    deviations: Floats
    correlation: Floats
    intervals: Floats
    condition: float
    freedom: int
    bands: Bands


def _estimates_of(problem: Fitting, best: Search, choice: Choice) -> FitEstimates:
    scales, freedom = problem.scales, best.residual.size - best.end.size
    covariance, condition = _covariance(problem, best.slopes)
    if not problem.has_uncertainties or problem.loss.name != LINEAR:
        covariance = covariance * problem.loss.variance(best.residual, best.end.size)
    scaled = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(scaled, scaled) if (scaled > 0).all() else np.eye(scaled.size)
    half = quantile(choice.coverage, freedom, has_uncertainties=problem.has_uncertainties)
    ends = intervals_as(best.end, scaled, half)
    if choice.intervals == PROFILE and (scaled > 0).all():
        variance = 1.0 if problem.has_uncertainties else best.square / freedom
        ends = profile_intervals(problem, best, choice.low, choice.high, scaled, half**2 * variance, half)
    # rounding may leave a variance of zero below it
    row_deviations = np.sqrt(np.maximum(0.0, np.einsum("ij,jk,ik->i", best.slopes, covariance, best.slopes)))
    noise = 1.0 if problem.has_uncertainties else np.sqrt(best.square / freedom)
    bands = Bands(row_deviations, np.hypot(row_deviations, noise), half)
    return FitEstimates(
        best.end * scales, scaled * scales, correlation, ends * scales[:, None], condition, freedom, bands
    )


def _fit_dataset(
    problem: Fitting, search_results: list[Search], best: Search, test: ResidualTests, choice: Choice
) -> xr.Dataset:
    estimates, first = _estimates_of(problem, best, choice), problem.records[0]
    good_residuals = best.residual[~problem.outlying(best.residual)]
    square, freedom = float(good_residuals @ good_residuals), good_residuals.size - best.end.size
    fitted = _fitted_models(problem, estimates, test)
    variables: dict[str, Any] = estimate_variables(problem, best, estimates, choice.coverage) | record_variables(
        problem, fitted
    )
    variables |= residual_variables(problem, best.residual, estimates.bands) | search_variables(
        search_results, problem.scales
    )
    attributes = {
        "data": _data_names(problem),
        "chi_square": square if problem.has_uncertainties else float("nan"),
        "degrees_of_freedom": freedom,
        "residual_variance": square / freedom,
        "condition": estimates.condition,
        "evaluations": sum(search.evaluations for search in search_results),
        "stopped": best.stopped,
        "converged": int(best.converged),
        "chi_square_probability": test.chi_square_probability,
        "runs_probability": test.runs_probability,
        "seed": choice.seed,
        "adequate": int(test.adequate and best.converged),
        "adequate_text": test.text,
        "loss": problem.loss.name,
        "intervals": choice.intervals,
        "coverage": choice.coverage,
        "half_width": estimates.bands.half,
        "asked": json.dumps(first.settings, sort_keys=True),
        "model_digest": first.model.digest,
        "fitted_digest": fitted[0].digest,
    }
    title = f"{first.model.name}, fitted to {_data_names(problem)}"
    return evidence_dataset("fit", title, [], variables, attributes, shapes=first.model.shapes)


def _covariance(problem: Fitting, slopes: Floats) -> tuple[Floats, float]:
    """Return the covariance of the scaled parameters, and the condition number of the normalised slopes.

    Raises
    ------
    InputError
        If the data do not determine some parameters; they are named.
    """
    sizes = np.sqrt((slopes**2).sum(axis=0))
    names = [number_label(problem.records, number) for number in problem.numbers]
    if idle_names := [name for name, size in zip(names, sizes, strict=True) if not size > 0.0]:
        raise InputError(f"the data do not change with '{idle_names[0]}': it cannot be fitted to them; fix it")
    # with columns of length 1 dependence is not a matter of units
    _, singular, vectors = np.linalg.svd(slopes / sizes, full_matrices=False)
    if singular[-1] <= DEPENDENT_RATIO * singular[0]:
        mixed_names = [name for name, part in zip(names, np.abs(vectors[-1]), strict=True) if part > 0.1]
        raise InputError(f"the data do not tell {' and '.join(mixed_names)} apart: only a combination of them; fix one")
    inverse = (vectors.T / singular**2) @ vectors
    return inverse / np.outer(sizes, sizes), float(singular[0] / singular[-1])


def _fitted_models(problem: Fitting, estimates: FitEstimates, test: ResidualTests) -> list[Model]:
    """Return the fitted model, or one for each record where they differ."""
    freedom = (
        None if problem.has_uncertainties or len(problem.numbers) > 1 else estimates.freedom
    )  # correlated numbers are normal ones
    models = []
    for k, record in enumerate(problem.records):
        places = problem.number_indices(k)
        correlation = estimates.correlation[np.ix_(places, places)]
        models.append(
            _fitted_model(record, estimates.values[places], estimates.deviations[places], correlation, test, freedom)
        )
    is_shared = len({record.model.digest for record in problem.records}) == 1 and len(problem.number_indices(0)) == len(
        problem.numbers
    )
    if is_shared and len(models) > 1:
        mark = Fitted(_data_names(problem).replace("'", ""), test.adequate, test.text)
        return [models[0].with_statement(replace(models[0].statement, fit=mark))]
    return models


def _fitted_model(
    record: FitRecord,
    values: Floats,
    deviations: Floats,
    correlation: Floats,
    test: ResidualTests,
    freedom: int | None = None,
) -> Model:
    """Return the model with the estimates, their uncertainties and correlations; one number of few degrees of freedom is Student's t."""
    statement = record.model.elements.statement
    parameters, starts = dict[str, Parameter](), dict[str, Parameter]()
    for i, name in enumerate(record.names):
        if record.is_offset(name):  # of the record's clock, not of the model
            continue
        unit = record.declared(name).unit
        declared = statement.parameters.get(name) or statement.starts.get(name)
        fitted = parameters if name in statement.parameters else starts
        fitted[name] = Parameter(
            Quantity(float(values[i]), unit),
            _estimate_spread(Quantity(float(deviations[i]), unit), freedom),
            declared.description if declared else "",
        )
    shapes, names = record.model.shapes, {*record.names}
    correlations = {
        pair: entry
        for pair, entry in record.model.statement.correlations.items()
        if not names.intersection(map(shapes.internal_name, pair))
    }
    uncertain_indices = [i for i, name in enumerate(record.names) if deviations[i] > 0.0 and not record.is_offset(name)]
    for i, j in combinations(uncertain_indices, 2):
        pair = display_text(record.names[i]), display_text(record.names[j])
        correlations[pair] = float(np.clip(correlation[i, j], -1.0, 1.0))
    mark = Fitted(record.data.name.replace("'", ""), test.adequate, test.text)
    renumbered = record.model.renumbered(parameters, starts)
    return record.model.with_statement(replace(renumbered, correlations=correlations, fit=mark))


def _estimate_spread(standard: Quantity, freedom: int | None) -> Spread:
    """Return how an estimate is distributed; the standard deviation of Student's t is over that of its scale."""
    if freedom is None or not 2 < freedom < FEW or not standard.value > 0.0:
        return Spread(standard)
    student_deviation = Quantity(standard.value * (freedom / (freedom - 2.0)) ** 0.5, standard.unit)
    return Spread(student_deviation, STUDENT, degrees_of_freedom=float(freedom))

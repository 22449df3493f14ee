"""Physical terms of one number: uncertain parameters, initial values, declared discrepancies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.budgeting.measurand import Measurand
from xdynamics.budgeting.slopes import variational_slopes
from xdynamics.budgeting.sources import COPIES, ROUNDING, RUN, ErrorSource, stated_source
from xdynamics.budgeting.term import COVERED, PHYSICAL, Term
from xdynamics.dynamics.variational import NotVariedError
from xdynamics.elementary.arrays import dot, product
from xdynamics.elementary.rounding_margins import EPS
from xdynamics.faults import InputError
from xdynamics.model import Model
from xdynamics.model.parts import Parameter
from xdynamics.model.uncertainty import Discrepancy, cholesky_factor, correlation_matrix
from xdynamics.record import unfold
from xdynamics.sweeping.axes import INITIAL_PREFIX
from xdynamics.units import Unit, coherent

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

DISCREPANCY = "discrepancy"
SHIFTS = 4.0 ** np.arange(-3, 5)  # changes of an input for a slope, in standard uncertainties
CENTRAL_PAIR = 2  # index of the pair of neighbouring shifts at one standard uncertainty
WIDEST, NARROWEST = 1e-2, 1e-9  # relative limits of shifts: wider only up to the uncertainty, narrower never
NOISE = 64.0 * EPS  # relative to the number, over a shift; a smaller slope counts as zero
SIDES = np.array([-3.0, -2.0, -1.0, 1.0, 2.0, 3.0])
WEIGHTS = np.array([-1.0, 9.0, -45.0, 45.0, -9.0, 1.0]) / 60.0  # of the sixth-order slope from these sides
AGREED = 0.02  # relative, within which variational equations and differences agree
BY_DIFFERENCES = (
    "slope by central differences of sixth order over {0:.3g} of its uncertainties; another spacing gives {1:.1g} of"
    " the slope more or less"
)
BY_EQUATIONS = (
    "slope by variational equations on the run's steps; central differences of sixth order over {0:.3g} of its"
    " uncertainties give {1:.1g} of the slope more or less"
)
BY_EQUATIONS_ALONE = (
    "slope by variational equations on the run's steps; differences over {0:.3g} of its uncertainties are rounding"
)
NO_SLOPE = "no slope but rounding's"


@dataclass(frozen=True)
class Slope:
    """How a number changes with an input, per the input's own unit.

    Attributes
    ----------
    value : float
    off : float
        How far it may be off.
    rule : str
        How it was found.
    """

    value: float
    off: float
    rule: str


def input_source(measurand: Measurand, names: Sequence[str]) -> ErrorSource:
    """Return the errors of uncertain parameters and initial values: a term for each of the named ones."""
    blank = partial(_blank_input_terms, measurand.model, names)
    return ErrorSource(tuple(names), (RUN, ROUNDING, COPIES), partial(_input_terms, measurand, names), blank)


def _input_terms(
    measurand: Measurand, names: Sequence[str], run: xr.Dataset, rounding: Sequence[Term], numbers: Floats
) -> list[Term]:
    """Return the terms of inputs, from the number in their copies; slopes that are rounding alone are zero."""
    slopes = _input_slopes(measurand, names, run, rounding[0].bound, numbers)
    return [_input_term(name, measurand.model.uncertain[name], slopes[name]) for name in names]


def _blank_input_terms(model: Model, names: Sequence[str], _unit: Unit) -> list[Term]:
    unknown = Slope(np.nan, np.nan, "")
    return [_input_term(name, model.uncertain[name], unknown) for name in names]


def _input_term(name: str, parameter: Parameter, slope: Slope) -> Term:
    """Return the term of an input by its slope."""
    factor = float(parameter.quantity.unit.factor)
    assert parameter.spread is not None  # noqa: S101
    size = parameter.spread.size.si / factor if parameter.spread.bounded else COVERED * parameter.uncertainty
    return Term(
        name,
        PHYSICAL,
        abs(slope.value) * parameter.uncertainty,
        (abs(slope.value) + slope.off) * size,
        slope.rule,
        slope.value / factor,
        parameter.uncertainty * factor,
        coherent(parameter.quantity.unit),
        slope.off / factor,
    )


def _input_slopes(
    measurand: Measurand, names: Sequence[str], run: xr.Dataset, rounding: float, numbers: Floats
) -> dict[str, Slope]:
    """Return the slope by every input: from variational equations where differences over its uncertainty agree.

    Where they disagree by more than rounding, the response is not linear over the uncertainty, and the differences are used.
    """
    by_differences = difference_slopes(measurand, names, rounding, numbers)
    try:
        by_equations, remark = variational_slopes(unfold(run), measurand.model, measurand.target, names), ""
    except NotVariedError as error:
        by_equations, remark = {}, f"; no variational equations: {error}"
    slopes = {}
    for name, (slope, slope_error, shift, smallest_slope, march_rounding) in by_differences.items():
        exact = by_equations.get(name, slope)
        distance = abs(exact - slope)
        if not slope:
            significant = abs(exact) > smallest_slope
            slopes[name] = (
                Slope(exact, slope_error, BY_EQUATIONS_ALONE.format(shift))
                if significant
                else Slope(0.0, slope_error, NO_SLOPE)
            )
        elif not by_equations:
            slopes[name] = Slope(slope, slope_error, BY_DIFFERENCES.format(shift, slope_error / abs(slope)) + remark)
        elif distance <= AGREED * abs(slope):
            slopes[name] = Slope(exact, distance, BY_EQUATIONS.format(shift, distance / abs(exact)))
        elif distance <= march_rounding:
            slopes[name] = Slope(exact, distance, BY_EQUATIONS_ALONE.format(shift))
        else:
            remark = f"; the variational equations, of the smallest changes, give {exact:.3g}"
            slopes[name] = Slope(
                slope, max(slope_error, distance), BY_DIFFERENCES.format(shift, slope_error / abs(slope)) + remark
            )
    return slopes


def shifted_copies(measurand: Measurand, names: Sequence[str], **settings: Any) -> xr.DataArray:
    """Return the number where each input is changed by its shifts, to both sides, lazy."""
    model = measurand.model
    inputs = {name: model.uncertain[name] for name in names}
    values = {
        name: np.full((len(inputs), len(SHIFTS), len(SIDES)), entry.quantity.value) for name, entry in inputs.items()
    }
    for i, (name, entry) in enumerate(inputs.items()):
        values[name][i] += np.multiply.outer(np.nan_to_num(_input_shifts(entry)), SIDES)
    axes = {
        "input": {
            input_axis_name(model, name): _with_unit_attribute(entry.ravel(), inputs[name])
            for name, entry in values.items()
        }
    }
    return measurand.numbers(axes, time_tolerance=measurand.sharp, **settings)


def difference_slopes(
    measurand: Measurand, names: Sequence[str], rounding: float, numbers: Floats
) -> dict[str, tuple[float, float, float, float, float]]:
    """Return for every input its slope from copies side by side, its error, the relative shift, and two rounding errors.

    The first of these is that of the numbers themselves, the second that of the marches to them.

    Starting from a shift of one standard uncertainty, wider and narrower ones are tried as long as neighbours agree
    better: the widest suffer from curvature, the narrowest from rounding.

    Raises
    ------
    InputError
        If the quantity vanishes within the uncertainty of an input, as an event that no longer happens.
    """
    parameters = {name: measurand.model.uncertain[name] for name in names}
    sizes = np.array([_input_shifts(entry) for entry in parameters.values()])
    numbers = numbers.reshape(len(parameters), len(SHIFTS), len(SIDES))
    slopes_by_name, weighted_rounding = {}, float(np.sum(np.abs(WEIGHTS))) * rounding
    for i, (name, entry) in enumerate(parameters.items()):
        slopes = dot(numbers[i], WEIGHTS) / sizes[i]
        distances = np.abs(np.diff(slopes))
        if not np.isfinite(distances).any():
            smallest = float(3.0 * np.nanmin(sizes[i]))
            raise InputError(
                f"{measurand.target.description} no longer exists where '{name}' is changed by {smallest:.3g}"
                f" {entry.quantity.unit.text}, less than its uncertainty of {entry.uncertainty:.3g}: a budget,"
                " which is of small changes, does not apply; draw the inputs in a sweep"
            )
        k = _best_pair(distances)
        slope, size = float(slopes[k + 1]), float(sizes[i][k + 1])
        smallest = NOISE * float(np.nanmax(np.abs(numbers[i]))) / size
        # a number that is bent at its own value has a slope of nearly 0 too, and changes by more than rounding
        changes = float(np.ptp(numbers[i][k + 1])) > 2.0 * rounding
        noise = smallest if changes else max(smallest, weighted_rounding / size)
        doubt, share = float(distances[k]), size / entry.uncertainty
        if abs(slope) <= noise:  # and no more between neighbours, the narrower of which is noisier
            slope, doubt = 0.0, 0.0 if doubt <= 8.0 * noise else doubt
        slopes_by_name[name] = slope, doubt, share, smallest, weighted_rounding / size
    return slopes_by_name


def _input_shifts(parameter: Parameter) -> Floats:
    """Return the shifts of an input; nan for shifts that are too large or too small relative to it."""
    value, sizes = abs(parameter.quantity.value), parameter.uncertainty * SHIFTS
    usable = (sizes <= max(parameter.uncertainty, WIDEST * value)) & (sizes >= NARROWEST * value)
    if not usable.any():  # known better than floating-point numbers resolve
        sizes, usable = NARROWEST * value * SHIFTS, SHIFTS <= 1.0
    return np.where(usable, sizes, np.nan)


def _best_pair(differences: Floats) -> int:
    """Return the pair of neighbours that agrees best, descending from the one at the input's own uncertainty."""
    finite = np.flatnonzero(np.isfinite(differences)).tolist()
    start = min(finite, key=lambda k: abs(k - CENTRAL_PAIR))
    best = start
    for direction in (1, -1):
        k = start
        while k + direction in finite and differences[k + direction] < differences[k]:
            k += direction
        best = k if differences[k] < differences[best] else best
    return best


def input_axis_name(model: Model, name: str) -> str:
    """Return the name of an axis over an input; for an initial value it differs from the variable's."""
    return f"{INITIAL_PREFIX}{name}" if name in model.starts else name


def _with_unit_attribute(values: Floats, parameter: Parameter) -> Any:
    import xarray as xr

    return xr.DataArray(values, attrs={"units": parameter.quantity.unit.text})


def discrepancy_source(measurand: Measurand) -> list[ErrorSource]:
    """Return the discrepancy that the model declares for the quantity, if any."""
    declared = measurand.model.discrepancy.get(measurand.target.quantity)
    return [] if declared is None else [stated_source(measurand, DISCREPANCY, partial(_discrepancy, declared))]


def _discrepancy(declared: Discrepancy, unit: Unit) -> Term:
    standard = declared.standard.si / float(unit.factor)
    return Term(DISCREPANCY, PHYSICAL, standard, COVERED * standard, declared.description or "declared in the model")


def covariance(model: Model, terms: list[Term]) -> Floats:
    """Return the covariance matrix of the terms' contributions, with the model's correlations of inputs."""
    root = np.array([_signed_contribution(term) for term in terms])[:, None] * _correlation_root(model, terms)
    return product(root, root.T)


def combined_variance(model: Model, terms: list[Term]) -> float:
    """Return the variance of the terms together: a sum of squares, never negative where terms cancel."""
    total_contribution = dot(
        np.array([_signed_contribution(term) for term in terms]), _correlation_root(model, terms).T
    )
    return float(dot(total_contribution, total_contribution))


def _correlation_root(model: Model, terms: list[Term]) -> Floats:
    """Return the root of the correlation matrix; terms that are not inputs are independent."""
    names = [term.name for term in terms]
    return cholesky_factor(correlation_matrix(names, model.correlations))


def _signed_contribution(term: Term) -> float:
    return -term.standard if term.sensitivity < 0.0 else term.standard

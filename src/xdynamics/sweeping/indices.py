"""Sobol's indices, from a design of their own, and the influence of each axis of a sweep.

An index is the share of a number's variance that belongs to a parameter. The influence of an axis is its effect on
outcomes, on counts of events, and on the variance of every number.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import archive
from xdynamics.elementary.bounds import EPS
from xdynamics.evidence.evidence_dataset import attrs_of, evidence_dataset
from xdynamics.evidence.grid_axes import member_number_names, sweep_of
from xdynamics.evidence.stage_tasks import Gathered, Task
from xdynamics.evidence.stages import Stage
from xdynamics.faults import InputError
from xdynamics.model import Model, check_model
from xdynamics.model.parts import Parameter
from xdynamics.record.folding import is_chunked, model_dimensions, quantity_names
from xdynamics.record.unfolding import element_array, find_column
from xdynamics.schema import AT, OCCURRENCE
from xdynamics.sweeping.axes import MIN_PROBABILITY, AxisColumn, Draws, range_of
from xdynamics.sweeping.collection import DIGEST
from xdynamics.sweeping.ensemble_analysis import ROLE, axis_dims, survey_dataset
from xdynamics.sweeping.kept_quantities import EVENT_COUNT, OUTCOME
from xdynamics.sweeping.members import end_descriptions
from xdynamics.sweeping.sweep import sweep as swept

if TYPE_CHECKING:
    import xarray as xr

SHARES = {
    "first_order": "share of the variance that the parameter has alone",
    "total_order": "share that it has with all that it acts together with",
}


def sobol_indices(
    model: Model,
    ranges: Mapping[str, Sequence[Any]] | Sequence[str],
    quantity: str,
    *,
    draws: int = 1024,
    seed: int = 0,
    resamples: int = 200,
    compute: bool = True,
    **settings: Any,
) -> xr.Dataset:
    """Return the share of a number's variance due to each parameter, alone and with its interactions.

    Parameters
    ----------
    model : Model
    ranges : mapping of str to (lowest, highest), or sequence of str
        Parameters or initial values, uniform between the two; or names alone, drawn from the distributions that the
        model declares for them.
    quantity : str
        A word of `keep` that stands for one number: ``"end_y"``, ``"event_time_ground"``, ``"maximum_y"``; or for one of
        each element, ``"end_u"``, whose shares are then along its dimensions, too.
    draws : int
        A power of two; draws*(2 + parameters) members are marched.
    seed : int
    resamples : int
        Number of bootstrap resamples for the intervals.
    compute : bool
        Whether to march at once. If False, the Dataset has dask arrays, and one task that needs all draws.
    **settings
        Of `simulate`, for all members.

    Returns
    -------
    xarray.Dataset
        Along `parameter`: ``parameter_name``, its range (``lowest``, ``highest`` in ``parameter_units``),
        ``first_order``, ``total_order`` and their 95 % intervals along `bound`; of a quantity with dimensions along these
        before `bound`, nan where an element is the same in every draw.

    Raises
    ------
    InputError
        If a range or the quantity cannot be used, a member has no such number, or all members have the same.

    Notes
    -----
    Saltelli et al. 2010 (doi:10.1016/j.cpc.2009.09.018), table 2, (b) and (f): the numbers of
    `scipy.stats.sobol_indices`, whose bootstrap takes no seed and would give other intervals in each call. Here they
    are percentiles of the indices of resampled draws (Efron and Tibshirani, An Introduction to the Bootstrap, 1993,
    section 13.3).
    """
    check_model(model)
    _check_draw_counts(ranges, draws, resamples)
    spans: dict[str, AxisColumn | Parameter]
    names = [*model.shapes.with_internal_names(dict.fromkeys(map(str, ranges)), "ranges have")]
    if isinstance(ranges, Mapping):
        spans = {name: _range_column(model, name, ends) for name, ends in zip(names, ranges.values(), strict=True)}
    else:
        spans = {name: _uncertain_parameter(model, name, names) for name in names}
    quantity = model.shapes.internal_name(quantity)
    sweep = _sweep_designs(model, spans, quantity, draws, seed, settings)
    elements = {str(dim): sweep.sizes[dim] for dim in sweep[quantity].dims[1:]}
    request = IndicesRequest(model, spans, isinstance(ranges, Mapping), quantity, draws, seed, resamples, elements)
    needs = tuple(Gathered(sweep[name]) for name in (quantity, OUTCOME))
    task = Task.of("indices", partial(_compute_indices, request), needs, draws, seed, resamples)
    blank = np.full((len(SHARES), len(spans), *elements.values()), np.nan)
    known_names = [*_range_variables(spans, stated=request.stated)]
    return Stage(task, lambda: _sobol_dataset(request, blank, (blank, blank)), known_names).result(compute=compute)


@dataclass(frozen=True)
class IndicesRequest:
    """The arguments of `sobol_indices`, checked.

    Attributes
    ----------
    spans : mapping of str to AxisColumn or Parameter
    stated : bool
        Whether ranges were given, and not names alone.
    elements : mapping of str to int
        Dimensions of the quantity, and their lengths.
    """

    model: Model
    spans: Mapping[str, AxisColumn | Parameter]
    stated: bool
    quantity: str
    draws: int
    seed: int
    resamples: int
    elements: Mapping[str, int]


def _compute_indices(request: IndicesRequest, numbers: NDArray[Any], outcomes: NDArray[Any]) -> xr.Dataset:
    """Return the indices from the numbers of all members.

    Raises
    ------
    InputError
        If a member has none, or all have the same.
    """
    f = _checked_member_numbers(request, numbers.astype(float), outcomes)
    f = np.ascontiguousarray(np.moveaxis(f.reshape(2 + len(request.spans), request.draws, -1), -1, 0))
    f[(f == f[:, :1, :1]).all(axis=(1, 2))] = np.nan  # elements without a variance, which rounding would give them
    resampled = np.random.default_rng(request.seed).integers(request.draws, size=(request.resamples, request.draws))
    # an entry takes the same draw of every design, which the estimators compare with one another
    resampled_shares = [_variance_shares(f[..., entry]) for entry in resampled]
    low, high = np.quantile(resampled_shares, [0.025, 0.975], axis=0)
    shape = (len(SHARES), len(request.spans), *request.elements.values())
    estimates = [np.moveaxis(shares, 1, -1).reshape(shape) for shares in (_variance_shares(f), low, high)]
    return _sobol_dataset(request, estimates[0], (estimates[1], estimates[2]))


def _sobol_dataset(
    request: IndicesRequest, indices: NDArray[np.float64], interval: tuple[NDArray[np.float64], NDArray[np.float64]]
) -> xr.Dataset:
    variables = _range_variables(request.spans, stated=request.stated)
    low, high = interval
    for i, (name, words) in enumerate(SHARES.items()):
        variables[name] = (("parameter", *request.elements), indices[i], attrs_of("1", words, ROLE))
        description = f"95 % interval of {name}, percentiles of {request.resamples} resamples of the draws"
        variables[f"{name}_interval"] = (
            ("parameter", *request.elements, "bound"),
            np.stack([low[i], high[i]], axis=-1),
            attrs_of("1", description, ROLE),
        )
    model, quantity = request.model, request.quantity
    attributes = {"quantity": quantity, "draws": request.draws, "seed": request.seed, "model_digest": model.digest}
    return evidence_dataset(
        "sobol indices",
        f"{model.name}: shares of the variance of {quantity}",
        [],
        variables,
        attributes,
        shapes=model.shapes,
    )


def _check_draw_counts(ranges: Any, draws: int, resamples: int) -> None:
    for argument, value, minimum in (("draws", draws, 2), ("resamples", resamples, 1)):
        if isinstance(value, bool) or not isinstance(value, int) or value < minimum:
            raise InputError(f"{argument} is {value!r}, needs a whole number from {minimum} on")
    if not ranges or isinstance(ranges, str):
        raise InputError(
            f"ranges are {str(ranges)[:60]!r}, need the lowest and the highest of each: {{'m': ('1 kg', '2 kg')}}, or"
            " names of what is uncertain in the model"
        )


def _range_variables(spans: Mapping[str, AxisColumn | Parameter], *, stated: bool) -> dict[str, Any]:
    """Return variables with the name, unit and range ends of each varied parameter."""
    ends = [_range_ends(span) for span in spans.values()]
    text = "where its range" if stated else "where one standard uncertainty beside its value"
    columns = {
        "parameter_name": ([*spans], "what was varied", "name"),
        "parameter_units": ([units for units, _, _ in ends], "unit of its range", "name"),
        "lowest": ([lowest for _, lowest, _ in ends], f"{text} begins, in parameter_units", "axis"),
        "highest": ([highest for _, _, highest in ends], f"{text} ends, in parameter_units", "axis"),
    }
    return {
        name: (("parameter",), np.array(values), attrs_of("1", description, role))
        for name, (values, description, role) in columns.items()
    }


def _sweep_designs(
    model: Model,
    spans: Mapping[str, AxisColumn | Parameter],
    quantity: str,
    draws: int,
    seed: int,
    settings: Mapping[str, Any],
) -> xr.Dataset:
    """Return the sweep of two designs, and of the first with each column of the second, one after the other."""
    names = list(spans)
    # one sequence of twice the dimensions: two of the same sequence would be the same points
    points = Draws(draws, {f"{name}{k}": (0, 1) for k in "ab" for name in names}, seed=seed).points()
    a, b = points[:, : len(names)], points[:, len(names) :]
    mixed_designs = [np.where(np.arange(len(names)) == i, b, a) for i in range(len(names))]
    spread = np.concatenate([a, b, *mixed_designs])
    values = {name: _map_unit_points(spans[name], spread[:, i]) for i, name in enumerate(names)}
    sweep = swept(model, {"draw": values}, keep=[quantity], **settings)
    column = find_column(sweep, quantity)
    if column is None or column.dims[:1] != ("draw",) or not {*column.dims[1:]} <= {*model_dimensions(sweep)}:
        raise InputError(
            f"quantity is {quantity!r}, needs a word that stands for one number, like 'end_{next(iter(model.elements.units))}'"
        )
    return sweep.assign({quantity: element_array(sweep, quantity)})


def _checked_member_numbers(
    request: IndicesRequest, f: NDArray[np.float64], outcomes: NDArray[Any]
) -> NDArray[np.float64]:
    """Return the members' numbers, refused unless all are finite and at least two differ."""
    quantity = request.quantity
    if not np.isfinite(f).all():
        i = int(np.argwhere(~np.isfinite(f))[0, 0])
        raise InputError(f"member {i} has no {quantity}: it ended as '{outcomes[i]}'; narrow the ranges")
    if (f == f[0]).all():
        value = f"{float(f[0])!r}" if f.ndim == 1 else "the same"
        raise InputError(f"{quantity} is {value} in every draw: it has no variance to share; widen the ranges")
    return f


def _variance_shares(f: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return first and total orders of each parameter from the numbers of both designs and each mixed one, by element."""
    designs = f[:, :2]
    # centred: estimator (b) of Saltelli et al. 2010, table 2, would multiply its differences by a mean far from zero
    f = f - designs.mean(axis=(1, 2), keepdims=True)
    variance = designs.var(axis=(1, 2))[:, np.newaxis]
    first = (f[:, 1:2] * (f[:, 2:] - f[:, :1])).mean(axis=-1) / variance
    # estimator (f) there, Jansen's
    total = 0.5 * ((f[:, :1] - f[:, 2:]) ** 2).mean(axis=-1) / variance
    return np.stack([first, total])


def _range_column(model: Model, name: str, ends: Sequence[Any]) -> AxisColumn:
    elements = model.elements
    available = quantity_names((*elements.statement.parameters, *elements.statement.initial))
    if name not in (*elements.statement.parameters, *elements.statement.initial, *available):
        raise InputError(f"'{name}' is no parameter or initial value; there are {', '.join(available)}")
    return range_of(model, name, ends)


def _map_unit_points(span: AxisColumn | Parameter, points: NDArray[np.float64]) -> xr.DataArray:
    """Map points from 0 to 1 to a range or a distribution, in its unit."""
    import xarray as xr

    if isinstance(span, Parameter):
        assert span.spread is not None  # noqa: S101
        values = span.quantity.value + span.uncertainty * span.spread.quantiles(
            np.clip(points, MIN_PROBABILITY, 1.0 - MIN_PROBABILITY)
        )
        return xr.DataArray(values, attrs={"units": span.quantity.unit.text})
    low, high = span.values.tolist()
    return xr.DataArray(low + (high - low) * points, attrs={"units": span.unit.text})


def _uncertain_parameter(model: Model, name: str, names: Sequence[str]) -> Parameter:
    """Return an uncertain parameter or initial value that is independent of the others."""
    if name not in model.uncertain:
        raise InputError(
            f"'{name}' has no uncertainty in the model; there are {', '.join(quantity_names(model.uncertain)) or 'none'}"
        )
    for pair in model.elements.correlations:
        if name in pair and {*pair} <= {*map(str, names)}:
            raise InputError(f"{pair[0]} and {pair[1]} are correlated: no share of the variance is one's alone")
    return model.uncertain[name]


def _range_ends(span: AxisColumn | Parameter) -> tuple[str, float, float]:
    """Return unit and ends of a range; for a distribution, one standard uncertainty to either side."""
    if isinstance(span, Parameter):
        value, unit = span.quantity.value, span.quantity.unit.text
        return unit, value - span.uncertainty, value + span.uncertainty
    return span.unit.text, float(span.values[0]), float(span.values[1])


AXES = "sweep_axis"
ROUNDING = 64.0  # spacings of numbers; a smaller spread counts as zero


def influences(sweep: xr.Dataset, *, compute: bool = True) -> xr.Dataset:
    """Return how much each axis changes outcomes, counts of events, and every number.

    Parameters
    ----------
    sweep : xarray.Dataset
    compute : bool
        Whether to compute at once. If False, the Dataset has dask arrays, and one task that needs all members.

    Returns
    -------
    xarray.Dataset
        Along `sweep_axis`, named by `axis_name`: ``outcome_changes``, the share of neighbours along the axis that ended in different ways;
        ``event_count_ground_changes`` the same for a count; ``main_effect_end_y``, the share of variance that the axis
        has alone, over members that have the number; of a quantity with dimensions, for each of its elements.

    Raises
    ------
    InputError
        If the Dataset is no sweep.

    Notes
    -----
    The main effect is the variance of means over all other axes, divided by the total variance: Sobol's first-order
    index for values distributed like the grid (Saltelli et al., Global Sensitivity Analysis, 2008, 1.2).
    """
    sweep = sweep_of(sweep)
    lazy_names = [str(name) for name, variable in sweep.variables.items() if is_chunked(variable)]
    call = partial(_influences_of_gathered, sweep, lazy_names)
    needs = tuple(Gathered(sweep[name]) for name in lazy_names)
    task = Task.of("influences", call, needs, sweep.attrs.get(DIGEST), archive.digest_of_run(sweep))

    def template() -> xr.Dataset:
        few = sweep.isel({dim: slice(2) for dim in sweep.dims})
        blanks = (np.zeros(few[name].shape, few[name].dtype) for name in lazy_names)
        return _influences_of_gathered(few, lazy_names, *blanks)

    return Stage(task, template, ("axis_name",)).result(compute=compute)


def _influences_of_gathered(sweep: xr.Dataset, names: Sequence[str], *values: NDArray[Any]) -> xr.Dataset:
    """Return the influences of a sweep whose lazy variables are replaced by values."""
    return _influences_in_memory(
        sweep.assign(
            {name: sweep.variables[name].copy(data=numbers) for name, numbers in zip(names, values, strict=True)}
        )
    )


def _influences_in_memory(sweep: xr.Dataset) -> xr.Dataset:
    """Return the influences of axes on a sweep in memory."""
    axes = [dim for dim in axis_dims(sweep) if dim in sweep.dims]
    names = member_number_names(sweep)
    counts = [name for name in names if name.startswith(EVENT_COUNT)]
    variables: dict[str, Any] = {"axis_name": ((AXES,), np.array(axes), attrs_of("1", "the axis", "name"))}
    for name in (OUTCOME, *counts):
        values = end_descriptions(sweep).values if name == OUTCOME else sweep[name].values
        word = "outcome" if name == OUTCOME else name
        shares = [_share_of_changes(values, sweep[name].dims.index(dim)) for dim in axes]
        variables[f"{word}_changes"] = (
            (AXES,),
            np.array(shares),
            attrs_of("1", f"share of neighbours along the axis that differ in {name}", ROLE),
        )
    for name in (number for number in names if number not in counts and not {AT, OCCURRENCE} & {*sweep[number].dims}):
        number = sweep[name].astype(float)
        member_dims = [dim for dim in number.dims if dim in axes]
        variance = number.var(member_dims)
        # rounding alone gives equal numbers a variance, shares of which would mean nothing
        varies = variance > (ROUNDING * EPS * abs(number).max(member_dims)) ** 2
        effects = [
            (
                number.mean([averaged_dim for averaged_dim in member_dims if averaged_dim != dim]).var(dim)
                / variance.where(varies)
            ).fillna(0.0)
            for dim in axes
        ]
        variables[f"main_effect_{name}"] = (
            (AXES, *effects[0].dims),
            np.array(effects),
            attrs_of("1", f"share of the variance of {name} that the axis has alone", ROLE),
        )
    return survey_dataset("influences", f"what {', '.join(axes)} change", sweep, variables, {})


def _share_of_changes(values: NDArray[Any], axis: int) -> float:
    """Return the share of neighbours along an axis that differ, among those that both exist."""
    axis_first = np.moveaxis(values, axis, 0)
    # nan differs from itself, so pairs with a missing number are left out
    both_known = (axis_first[1:] == axis_first[1:]) & (axis_first[:-1] == axis_first[:-1])
    return float(np.mean(axis_first[1:][both_known] != axis_first[:-1][both_known])) if both_known.any() else 0.0

"""Surveys of a grid of runs: differences, changes of outcome, slopes, shares of variance, convergence."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.bounds import EPS
from xdynamics.evidence.comparing.grids import judged_difference, uncertainty_of
from xdynamics.evidence.evidence_dataset import attrs_of, evidence_dataset
from xdynamics.evidence.grid_axes import (
    AXES,
    AXIS,
    VARIES,
    WHAT,
    member_number_names,
    rounding_floors,
    sweep_axis_names,
    sweep_of,
)
from xdynamics.evidence.refining.convergence import VERDICTS, judge, observed_orders
from xdynamics.evidence.stages import compute_datasets, is_lazy
from xdynamics.faults import InputError
from xdynamics.methods import METHODS
from xdynamics.model import Model
from xdynamics.record import shapes_of
from xdynamics.record.folding import labelled
from xdynamics.schema import EVIDENCE, flag_attributes
from xdynamics.sweeping.axes import RTOL, SETTING, STEP, matching_dim
from xdynamics.sweeping.collection import axis_of, plan_of
from xdynamics.sweeping.grid import index_on_axis
from xdynamics.sweeping.kept_quantities import OUTCOME, STOPPED_BY
from xdynamics.units import quotient, unit_suffix

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
ROLE, CONVERGENCE = "survey", "convergence"
EVALUATIONS = "run_force_evaluations"
MIN_LEVELS = 3  # needed to observe an order


def contrast(sweep: xr.Dataset, dim: str, *, reference: Any = None, compute: bool | None = None) -> xr.Dataset:
    """Compare members along one axis with one of them: two methods, say, or two tables.

    Parameters
    ----------
    sweep : xarray.Dataset
        What `sweep` or `open_sweep` returned, or what `convergence` found of it.
    dim : str
        The axis, as `axes` of `sweep` or the Dataset name it: ``"method"`` say, or ``"solver_method"``.
    reference : optional
        The value that the others are compared with; by default the last one.
    compute : bool, optional
        Whether to compute at once, or, False, to return dask arrays; by default as the sweep is, lazy or not.

    Returns
    -------
    xarray.Dataset
        Lazy where the sweep is. For every number ``difference_end_y`` (minus that of the reference), what that is
        numerically uncertain by, ``uncertainty_end_y``, and ``verdict_end_y`` (a flag: ``differs``, ``within``,
        ``unknown``), as `compare` has them of two sweeps: from a further axis of steps or tolerances, from what was kept,
        or from `convergence`. ``outcome_differs``: 1 where the run ended in another way.

    Raises
    ------
    InputError
        If there is no such axis, or no such value of it.
    """
    sweep, dim = _sweep_and_dim(sweep, dim)
    sweep = _lazy_or_computed(sweep, compute)
    reference_index = sweep.sizes[dim] - 1 if reference is None else _index_of_label(sweep, dim, reference)
    reference_members = sweep.isel({dim: reference_index})
    label = str(reference_members[dim].values) if dim in sweep.coords else str(reference_index)
    unit = unit_suffix(str(reference_members[dim].attrs["units"])) if dim in sweep.coords else ""
    variables: dict[str, Any] = {}
    floors = rounding_floors(sweep)
    for name in _compared_names(sweep):
        values, doubt = sweep[name], _numerical_uncertainty(sweep, name)
        reference_values = reference_members[name].broadcast_like(values).transpose(*values.dims).variable
        total = None if doubt is None else doubt + (doubt.isel({dim: reference_index}) if dim in doubt.dims else doubt)
        variables |= judged_difference(
            name,
            reference_values,
            values.variable,
            total,
            2.0 * floors.get(name, 0.0),
            f"minus that of {dim} = {label}{unit}",
        )
    if OUTCOME in sweep:
        variables["outcome_differs"] = _outcome_differs(sweep, reference_members)
    return survey_dataset(
        "contrast", f"members along {dim}, compared with {label}", sweep, variables, {"reference": label, "varied": dim}
    )


def _outcome_differs(sweep: xr.Dataset, reference: xr.Dataset) -> tuple[Any, ...]:
    differs = sweep[OUTCOME] != reference[OUTCOME]
    if STOPPED_BY in sweep:
        differs = differs | (sweep[STOPPED_BY] != reference[STOPPED_BY])
    differs = differs.transpose(*sweep[OUTCOME].dims).astype(np.int8)
    return (differs.dims, differs.data, attrs_of("1", "1 where the run ended in another way than the reference", ROLE))


def _compared_names(sweep: xr.Dataset) -> list[str]:
    """Name the compared numbers: those of a sweep, or of its finest level, as `convergence` judged them."""
    if sweep.attrs.get(EVIDENCE) != CONVERGENCE:
        return member_number_names(sweep)
    return [name for name in map(str, sweep.data_vars) if f"uncertainty_{name}" in sweep]


def _numerical_uncertainty(sweep: xr.Dataset, name: str) -> xr.Variable | None:
    if sweep.attrs.get(EVIDENCE) == CONVERGENCE:
        return sweep[f"uncertainty_{name}"].variable
    return uncertainty_of(sweep, name)


def sensitivities(sweep: xr.Dataset, *, compute: bool | None = None) -> xr.Dataset:
    """Differentiate every number of a sweep along every axis of numbers, by differences of second order.

    Parameters
    ----------
    sweep : xarray.Dataset
    compute : bool, optional
        Whether to compute at once, or, False, to return dask arrays; by default as the sweep is, lazy or not.

    Returns
    -------
    xarray.Dataset
        Lazy where the sweep is: ``slope_end_y_k``, in the unit of end_y over that of k.

    Raises
    ------
    InputError
        If no axis has two numbers or more.

    Notes
    -----
    Second-order differences on uneven grids as by `numpy.gradient`, at the ends too where there are three values: they
    are as accurate as the grid is fine, and mean nothing across a change of outcome; see `influences`.
    """
    sweep = _lazy_or_computed(sweep_of(sweep), compute)
    axes = [
        dim
        for dim in axis_dims(sweep)
        if dim in sweep.dims and dim in sweep.coords and sweep[dim].dtype.kind == "f" and sweep.sizes[dim] > 1
    ]
    if not axes:
        raise InputError("no axis of the sweep has two numbers or more to differentiate by")
    variables: dict[str, Any] = {}
    for name in member_number_names(sweep):
        for dim in (axis for axis in axes if axis in sweep[name].dims):
            slope = sweep[name].chunk({dim: -1}) if sweep[name].chunks else sweep[name]
            edge: Any = 2 if sweep.sizes[dim] > 2 else 1
            slope = slope.astype(float).differentiate(dim, edge_order=edge).transpose(*sweep[name].dims)
            units = quotient(str(sweep[name].attrs["units"]), str(sweep[dim].attrs["units"]))
            variables[f"slope_{name}_{dim}"] = (
                slope.dims,
                slope.data,
                attrs_of(units, f"derivative of {name} by {dim}", ROLE),
            )
    return survey_dataset("sensitivities", f"slopes along {', '.join(axes)}", sweep, variables, {})


def convergence(sweep: xr.Dataset, dim: str, *, compute: bool | None = None) -> xr.Dataset:
    """Judge every member by its levels along an axis of steps or tolerances: order, verdict, limit, uncertainty.

    Parameters
    ----------
    sweep : xarray.Dataset
        With an axis ``step`` or ``rtol`` of three values or more.
    dim : str
        That axis.
    compute : bool, optional
        Whether to compute at once, or, False, to return dask arrays; by default as the sweep is, lazy or not.

    Returns
    -------
    xarray.Dataset
        On the other axes, lazy where the sweep is: every number ``end_y`` of the finest level, with its uncertainty
        ``uncertainty_end_y``, ``order_end_y``, ``verdict_end_y`` and ``limit_end_y``, as `refine` finds them for one model.

    Raises
    ------
    InputError
        If the axis is not one of steps or tolerances, or has fewer levels, or methods vary in it.
    """
    import xarray as xr

    sweep, dim = _sweep_and_dim(sweep, dim)
    kind = str(sweep[dim].attrs.get(VARIES)) if dim in sweep.coords else ""
    if kind not in (STEP, RTOL) or sweep.sizes[dim] < MIN_LEVELS:
        raise InputError(
            f"'{dim}' has {sweep.sizes[dim]} values of a {kind or 'thing'}, needs {MIN_LEVELS} or more of step or rtol"
        )
    sweep = _lazy_or_computed(sweep, compute)
    fine = sweep.sortby(dim, ascending=False)
    fine = fine.chunk({dim: -1}) if any(entry.chunks for entry in fine.data_vars.values()) else fine
    steps, order = fine[dim].values.astype(float), _method_orders(sweep)
    variables: dict[str, Any] = {}
    for name in (
        entry for entry in member_number_names(sweep) if sweep[entry].dtype.kind == "f" and dim in sweep[entry].dims
    ):
        level_judgements = xr.apply_ufunc(
            lambda values, orders: _judge_rows(values, steps, orders, smooth=kind == STEP),
            fine[name].astype(float),
            order,
            input_core_dims=[[dim], []],
            output_core_dims=[["told"]],
            dask="parallelized",
            output_dtypes=[float],
            dask_gufunc_kwargs={"output_sizes": {"told": 4}},
        )
        variables |= _judgement_variables(sweep, name, dim, level_judgements, fine[name].isel({dim: -1}))
    return survey_dataset(
        CONVERGENCE, f"levels along {dim}", sweep.isel({dim: -1}, drop=True), variables, {"varied": dim}
    )


def _judgement_variables(
    sweep: xr.Dataset, name: str, dim: str, level_judgements: xr.DataArray, finest: xr.DataArray
) -> dict[str, Any]:
    """Return order, verdict, limit and uncertainty of a number as variables, with its value at the finest level."""
    dims = tuple(str(entry) for entry in level_judgements.dims if entry != "told")
    verdict = level_judgements.isel(told=1)
    judgements = {
        "order": (level_judgements.isel(told=0), "1", f"observed order of {name} in its last three levels", {}),
        "verdict": (
            verdict.astype(np.int8),
            "1",
            f"verdict on the convergence of {name}",
            flag_attributes(dict(enumerate(VERDICTS))),
        ),
        "limit": (
            level_judgements.isel(told=2),
            sweep[name].attrs["units"],
            f"limit of {name} as {dim} tends to zero",
            {},
        ),
        "uncertainty": (
            level_judgements.isel(told=3),
            sweep[name].attrs["units"],
            f"uncertainty of {name} at the finest level, at about 95 %",
            {},
        ),
    }
    finest_description = f"{sweep[name].attrs['long_name']}, at the finest level"
    finest_variable = (dims, finest.transpose(*dims).data, _survey_attributes(sweep, name, finest_description))
    return {name: finest_variable} | {
        f"{word}_{name}": (dims, entry.data, attrs_of(units, description, "flag" if extra else ROLE) | extra)
        for word, (entry, units, description, extra) in judgements.items()
    }


def precision(
    sweep: xr.Dataset | Model,
    dim: str | Mapping[str, Any] = STEP,
    *,
    exact: Mapping[str, float] | None = None,
    compute: bool | None = None,
    **settings: Any,
) -> xr.Dataset:
    """Return the cost and the error of every run: a work-precision diagram of methods, from coarse to fine.

    Parameters
    ----------
    sweep : xarray.Dataset or Model
        With an axis of steps or tolerances, and perhaps one of methods; or a model that is swept over them here.
    dim : str or mapping
        The axis of steps or tolerances; of a model all axes, ``{"method": ["rk4", "dop853"], "step": ["40 ms", "20 ms"]}``.
    exact : mapping of str to float, optional
        The exact values, in the units of the sweep; by default the finest level of the method of the highest order is
        taken for exact.
    compute : bool, optional
        Whether to compute at once, or, False, to return dask arrays; by default as the sweep is, lazy or not.
    **settings
        For a model: further arguments of `sweep`.

    Returns
    -------
    xarray.Dataset
        Lazy where the sweep is: ``off_end_y``, the absolute error; ``run_force_evaluations``; and ``front_end_y``, 1 for the
        runs than which no other one is as exact with as few evaluations, the Pareto front over methods and levels.

    Raises
    ------
    InputError
        If there is no such axis, or `exact` names no number of the sweep or has no finite value.

    Examples
    --------
    >>> import xdynamics as xd
    >>> model = xd.Model.from_toml("data/models/harmonic_oscillator.toml")
    >>> axes = {"method": ["euler_cromer", "rk4"], "step": ["100 ms", "50 ms", "25 ms"]}
    >>> found = precision(model, axes, until="2 s", keep="end_x", exact={"end_x": np.cos(4.0)})
    >>> found.front_end_x.compute().sel(solver_method="rk4").values.tolist()
    [1, 1, 1]
    """
    if isinstance(sweep, Model):
        from xdynamics.sweeping.sweep import sweep as sweep_over

        if not isinstance(dim, Mapping):
            raise InputError(
                f"dim is {dim!r}; of a model give all axes, {{'method': ['rk4', 'dop853'], 'step': [...]}}"
            )
        sweep, dim = sweep_over(sweep, dim, **settings), next((name for name in (STEP, RTOL) if name in dim), STEP)
    elif settings or not isinstance(dim, str):
        raise InputError(
            f"{', '.join(settings) or 'axes'} are for a model; the sweep is computed: give the name of its axis"
        )
    sweep, dim = _sweep_and_dim(sweep, dim)
    sweep = _lazy_or_computed(sweep, compute)
    names, exact_values = member_number_names(sweep), dict(exact or {})
    if unknown := [name for name in exact_values if name not in names]:
        raise InputError(f"exact names '{unknown[0]}', which is none of {', '.join(names)}")
    for name, value in exact_values.items():
        if not np.isfinite(value):
            raise InputError(f"exact has {value!r} for '{name}', needs a number")
    finest: dict[str, int] = {dim: int(np.argmin(sweep[dim].values))}
    if (methods := _method_labels(sweep)) is not None:
        finest |= dict.fromkeys(map(str, methods.dims), int(np.argmax(_orders_of(methods))))
    variables: dict[str, Any] = {}
    for name in (entry for entry in names if dim in sweep[entry].dims and sweep[entry].dtype.kind == "f"):
        values = sweep[name]
        error = abs(values - exact_values.get(name, values.isel(finest, drop=True))).transpose(*values.dims)
        from_what = "the right value" if name in exact_values else "the finest one"
        variables[f"off_{name}"] = (
            error.dims,
            error.data,
            _survey_attributes(sweep, name, f"distance of {name} from {from_what}"),
        )
        variables[f"front_{name}"] = _pareto_variable(
            error, sweep[EVALUATIONS], [*finest], name, is_exact=name in exact_values
        )
    work = sweep[EVALUATIONS]
    variables[EVALUATIONS] = (work.dims, work.data, dict(work.attrs))
    return survey_dataset("precision", f"work against precision along {dim}", sweep, variables, {"varied": dim})


def _pareto_variable(
    error: xr.DataArray, work: xr.DataArray, dims: list[str], name: str, *, is_exact: bool
) -> tuple[Any, ...]:
    """Return as a variable which runs are on the Pareto front of error and work along some dimensions."""
    import xarray as xr

    core_dims = [dim for dim in dims if dim in error.dims]
    errors, works = (array.chunk(dict.fromkeys(core_dims, -1)) if array.chunks else array for array in (error, work))
    front = xr.apply_ufunc(
        partial(_pareto_mask, is_exact=is_exact, dim_count=len(core_dims)),
        errors,
        works,
        input_core_dims=[core_dims, core_dims],
        output_core_dims=[core_dims],
        dask="parallelized",
        output_dtypes=[np.int8],
    ).transpose(*error.dims)
    description = f"1 where no other run is as near to the right {name} with as few force evaluations"
    return front.dims, front.data, attrs_of("1", description, ROLE)


def _pareto_mask(errors: Floats, works: NDArray[np.int64], *, is_exact: bool, dim_count: int) -> NDArray[np.int8]:
    """Mark the Pareto front of error and work along the last dimensions; a reference run dominates no other run."""
    errors, works = np.broadcast_arrays(errors, works)
    shape = errors.shape[: errors.ndim - dim_count]
    front = np.zeros((int(np.prod(shape)), int(np.prod(errors.shape[errors.ndim - dim_count :]))), np.int8)
    for row, error, work in zip(front, errors.reshape(front.shape), works.reshape(front.shape), strict=True):
        smallest_error = np.inf
        # the last key counts most: by work, and by error among runs of equal work
        for i in np.lexsort((error, work)).tolist():
            # all before took no more work: a run that is more exact than any of them is on the front
            if np.isfinite(error[i]) and error[i] < smallest_error and (is_exact or error[i] > 0.0):
                row[i], smallest_error = 1, error[i]
    return front.reshape(errors.shape)


def _lazy_or_computed(sweep: xr.Dataset, compute: Any) -> xr.Dataset:
    """Return a sweep computed if `compute`, with dask arrays if it is False, unchanged if it is None."""
    if not isinstance(compute, bool | None):
        raise InputError(f"compute is {compute!r}, needs true or false")
    if compute is None or is_lazy(sweep) is not compute:
        return sweep
    return compute_datasets(sweep)[0] if compute else sweep.chunk()


def axis_dims(sweep: xr.Dataset) -> list[str]:
    """Name the axes of a sweep."""
    return sweep_axis_names(sweep)


def _sweep_and_dim(dataset: Any, word: str) -> tuple[xr.Dataset, str]:
    """Return a sweep or its convergence, and the dimension of it that a word means, ``method`` or ``solver_method``."""
    sweep = dataset if getattr(dataset, "attrs", {}).get(EVIDENCE) == CONVERGENCE else sweep_of(dataset)
    dim = matching_dim(sweep.dims, word)
    if dim not in sweep.dims or dim not in axis_dims(sweep):
        raise InputError(f"the sweep has no axis '{word}'; there are {', '.join(axis_dims(sweep))}")
    return sweep, dim


def _index_of_label(sweep: xr.Dataset, dim: str, label: Any) -> int:
    """Find the index of a value on an axis."""
    return index_on_axis(axis_of(shapes_of(sweep), sweep, dim), label)


def _survey_attributes(sweep: xr.Dataset, name: str, description: str) -> dict[str, Any]:
    return attrs_of(str(sweep[name].attrs["units"]), description, ROLE)


def _method_orders(sweep: xr.Dataset) -> Any:
    """Return the order of every method."""
    import xarray as xr

    plan = plan_of(sweep)
    if (methods := _method_labels(sweep)) is not None:
        return xr.DataArray(_orders_of(methods), dims=methods.dims)
    return xr.DataArray(float(plan.grid.settings_of((0,) * len(plan.grid.shape)).method.order))


def _method_labels(sweep: xr.Dataset) -> xr.Variable | None:
    """Return the methods of a sweep that has several, along an axis."""
    return next(
        (
            variable
            for variable in sweep.coords.variables.values()
            if (variable.attrs.get(VARIES), variable.attrs.get(WHAT)) == (SETTING, "method") and variable.dims
        ),
        None,
    )


def _orders_of(methods: xr.Variable) -> list[float]:
    return [float(METHODS[str(method)].order) for method in methods.values]


def _judge_rows(values: Floats, steps: Floats, orders: Floats, *, smooth: bool) -> Floats:
    """Judge rows of levels; return order, verdict, limit and uncertainty of each."""
    shape = values.shape[:-1]
    rows, order = values.reshape(-1, values.shape[-1]), np.broadcast_to(orders, shape).ravel().tolist()
    judgements = np.full((len(rows), 4), np.nan)
    observed_order = observed_orders(rows, steps)[:, -2]
    for i, row in enumerate(rows):
        if np.isfinite(row).all():
            formal, rounding = order[i] if smooth else 1.0, 4.0 * EPS * float(np.abs(row).max())
            judgement = judge(row, steps, formal, rounding, 0.0, 0.0, smooth=smooth, order=order[i])
            judgements[i] = observed_order[i], judgement.verdict, judgement.limit, judgement.uncertainty
    judgements[np.isnan(judgements[:, 1]), 1] = VERDICTS.index("not_converging")
    return judgements.reshape(*shape, 4)


def survey_dataset(
    kind: str, title: str, sweep: xr.Dataset, variables: dict[str, Any], extra: dict[str, Any]
) -> xr.Dataset:
    """Assemble a survey, with the coordinates of its axes."""
    dims = {dim for variable in variables.values() for dim in variable[0]}
    coordinates = {
        str(name): (variable.dims, variable.data, dict(variable.attrs))
        for name, variable in sweep.coords.items()
        if AXIS in variable.attrs and {*variable.dims} <= dims
    }
    attributes = {
        key: sweep.attrs[key] for key in ("model_digest", "sweep_digest", "sweep_settings") if key in sweep.attrs
    }
    if axes := [dim for dim in sweep_axis_names(sweep) if dim in dims]:
        attributes[AXES] = " ".join(axes)
    title = f"{str(sweep.attrs['title']).split(':')[0]}: {title}"
    survey = evidence_dataset(kind, title, [], coordinates | variables, attributes | extra, shapes=shapes_of(sweep))
    return labelled(survey.set_coords([*coordinates]))

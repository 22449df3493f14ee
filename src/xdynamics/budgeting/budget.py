"""The error budget of a number: every source of error in one table, with totals and a Monte Carlo check.

Over the axes of a sweep there is one budget for each member, all in one Dataset.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from xdynamics.budgeting import numerical
from xdynamics.budgeting.budget_dataset import COVERAGE, BudgetParts, BudgetRequest, budget_dataset, budget_request
from xdynamics.budgeting.measurand import OwnRun, Target, own_run_task
from xdynamics.budgeting.montecarlo import NOTHING_DRAWN, draw_statistics, draw_until_known, end_tolerance_of
from xdynamics.budgeting.numerical import NOT_MARCHED, LevelComparison, levels_of
from xdynamics.budgeting.physical import shifted_copies
from xdynamics.budgeting.proven_bounds import NOT_PROVEN, proven_task
from xdynamics.budgeting.term import COMPARED, COPIES, NUMBER, OWN, ROUNDING, RUN, Declared, Term
from xdynamics.evidence.evidence_dataset import evidence_dataset
from xdynamics.evidence.grid_axes import AXES, AXIS, OWN_DIGEST, is_sweep, sweep_axis_names, sweep_of
from xdynamics.evidence.refining.levels import RTOLS, STEPS
from xdynamics.evidence.stage_tasks import Gathered, Task, results_of
from xdynamics.evidence.stages import Stage, blank_run, compute_datasets
from xdynamics.faults import AccuracyWarning, InputError, first_names, warn
from xdynamics.march import March
from xdynamics.march.configuration import unthinned_settings_for
from xdynamics.model import Model
from xdynamics.record.flag_words import words_of_flag
from xdynamics.runtime.lazy_imports import load_dask_whole
from xdynamics.schema import PROVEN, TEXT_NAMES
from xdynamics.sweeping.collection import plan_of
from xdynamics.units import parse_unit, unit_suffix
from xdynamics.units.digits import aligned_table, short_number

if TYPE_CHECKING:
    import xarray as xr

KIND = "budgets of a sweep"
MAX_MEMBERS = 4096  # members, each of which is some runs and tasks
TERM_NAMES = ("term_name", "term_kind")
TOTALS = ("numerical_rss", "physical_rss", "total_rss")


def budgets_over(
    sweep: xr.Dataset, quantity: str, budget: Callable[..., xr.Dataset], *, compute: bool, **budget_arguments: Any
) -> xr.Dataset:
    """Return the error budget of every member of a sweep, along its axes; see `error_budget`.

    Raises
    ------
    InputError
        If there are too many members, or the budgets of two have other terms.
    """
    load_dask_whole()
    import dask.array

    da: Any = dask.array
    sweep = sweep_of(sweep)
    grid = plan_of(sweep).grid
    if grid.size > MAX_MEMBERS:
        raise InputError(
            f"the sweep has {grid.size} members, and budgets are of {MAX_MEMBERS} at most; select some by isel"
        )
    members = [
        budget(
            grid.member_model(position),
            quantity,
            compute=False,
            **budget_arguments,
            **grid.simulate_arguments(position),
        )
        for position in np.ndindex(grid.shape)
    ]
    first = members[0]
    for position, result in zip(np.ndindex(grid.shape), members, strict=True):
        if [*result["term_name"].values] != [*first["term_name"].values]:
            names = [", ".join(map(str, terms["term_name"].values)) for terms in (first, result)]
            raise InputError(
                f"member {grid.member_name(position)} has the terms {names[1]}, and the first has {names[0]}"
            )
    dims = [dim for dim in grid.dims if dim in sweep.dims]
    shape = tuple(sweep.sizes[dim] for dim in dims)
    variables: dict[str, Any] = {
        str(name): (variable.dims, variable.variable.values, dict(variable.attrs))
        for name, variable in sweep.coords.items()
        if AXIS in variable.attrs and {*variable.dims} <= {*dims}
    }
    coordinates = [*variables]
    for name, variable in first.variables.items():
        if name in TERM_NAMES:
            variables[str(name)] = variable.dims, variable.values, dict(variable.attrs)
        elif name not in TEXT_NAMES and name not in variables:
            cells = [da.asarray(member.variables[name].data) for member in members]
            stacked_cells = da.stack(cells).reshape((*shape, *variable.shape))
            variables[str(name)] = (*dims, *variable.dims), stacked_cells, dict(variable.attrs)
    attributes = {key: sweep.attrs[key] for key in ("model_digest", OWN_DIGEST) if key in sweep.attrs}
    attributes |= {"of": first.attrs["of"], AXES: " ".join(dims), "coverage": first.attrs["coverage"]}
    title = (
        f"error budgets of {str(sweep.attrs['title']).partition(':')[0]}: {first.attrs['of']} over {', '.join(dims)}"
    )
    budgets = evidence_dataset(KIND, title, [], variables, attributes).set_coords(coordinates)
    return compute_datasets(budgets)[0] if compute else budgets


def budget_grid_lines(budgets: xr.Dataset) -> Iterator[str]:
    """Summarise budgets over a grid: the range of the number and of its uncertainty, and of each term where it is largest."""
    units = unit_suffix(str(budgets["value"].attrs["units"]))
    yield f"result    {budgets.attrs['of']} over {', '.join(sweep_axis_names(budgets))}"
    header = ("", "least", "greatest")
    rows = [("value", *_range_texts(budgets["value"].values, units))]
    rows += [
        (f"{name.removesuffix('_rss')} uncertainty", *_range_texts(budgets[name].values, units)) for name in TOTALS
    ]
    kinds = words_of_flag(budgets["term_kind"])
    sizes = budgets["standard_uncertainty"].transpose("term", ...).values
    for name, kind, size in zip(budgets["term_name"].values.tolist(), kinds, sizes, strict=True):
        rows.append((f"{kind} {name}", *_range_texts(size, units)))
    yield from aligned_table(header, rows)
    outcomes = [str(outcome) for outcome in np.unique(budgets["run_outcome"].values.astype(str))]
    yield f"outcomes  {first_names(outcomes)}"


def _range_texts(values: Any, units: str) -> tuple[str, str]:
    finite = values[~np.isnan(values)]
    if not finite.size:
        return "", ""
    return tuple(f"{short_number(float(end))}{units}" for end in (finite.min(), finite.max()))  # type: ignore[return-value]


SUMMARIES = {KIND: budget_grid_lines}


UNSURE = 0.02  # relative error of a term up to which a doubtful slope is not warned of
FIRST_DRAWS = 4096
DRAWS = "draws"  # among the parts of a budget


def error_budget(
    model: Model | xr.Dataset,
    quantity: str,
    *,
    at: str | float | None = None,
    event: str | None = None,
    occurrence: int = 1,
    side: str = "before",
    terms: Sequence[Declared] = (),
    draws: int = 0,
    seed: int = 0,
    coverage: float = COVERAGE,
    until_uncertainty: str | None = None,
    digits: int = 1,
    inadequate_fit: bool = False,
    only: Sequence[str] | str | None = None,
    without: Sequence[str] | str | None = None,
    proven: bool = False,
    keep: str | Path | None = None,
    compute: bool = True,
    **settings: Any,
) -> xr.Dataset:
    """Return the error budget of one number of a run: how far it may be off, and why.

    Parameters
    ----------
    model : Model, or xarray.Dataset
        Of a sweep the budget of every member, with its settings, along its axes. Of a model: its parameters and initial values with an uncertainty, tables with a column of uncertainties, correlations and
        discrepancies are the physical terms.
    quantity : str
        A coordinate, velocity, state, energy or observable; at an event also ``"t"``, its time; with neither time nor
        event the largest or the least value of one of these or of a force over the run, as `diagnose` names it:
        ``"maximum_force_drag_y"``, ``"minimum_contact_force_floor"``.
    at : str or float, s
        The physical time of the number, or instead:
    event : str
        The event at which the number is taken.
    occurrence : int
        Which occurrence of the event, from 1.
    side : {"before", "after"}
        On which side of the event.
    terms : sequence of Declared
        Further terms, of this same number.
    draws : int
        Number of draws for the Monte Carlo check; 0 for none.
    seed : int
        Seed of everything that is drawn.
    coverage : float
        Coverage probability of the intervals.
    until_uncertainty : str, optional
        Double the draws until the intervals' ends are known this well: ``"10 m at 95 %"``.
    digits : {1, 2}
        Digits of the standard uncertainty; the linear interval may be off by half the last one (JCGM 101:2008, 7.9.2
        and 8.1).
    inadequate_fit : bool
        Whether to make a budget of a model whose fit to data is not adequate.
    only, without : sequence of str, optional
        Terms by their names, which alone are computed, or which are left out, of totals and draws too: ``["roundoff"]``,
        ``["truncation", "c"]``. Every other term is the same as in the whole budget, and the record says what is left
        out. Without truncation no finer run is marched, and there is nothing along `level`.
    proven : bool
        Whether to prove bounds of the number, as `enclose` does, of the values as they are written: what the run is off by
        at most, whatever the numerical terms estimate.
    keep : str or Path, optional
        A folder in which the number in each level, each term and each block of draws is kept as soon as it is known, or
        ``"s3://bucket/folder"``: the same call continues a budget that was interrupted, and marches nothing for what is
        there.
    compute : bool
        Whether to march at once. If False, the Dataset has dask arrays, with a task for each level, each term and each
        block of draws; `until_uncertainty` cannot be used.
    **settings
        Settings of `simulate` for the run that the number is of; a sweep has its own.

    Returns
    -------
    xarray.Dataset
        `value`, the run's own, not extrapolated, and along `level` its value in finer runs, with `observed_order`.
        Along `term`: `term_name`, `term_kind`, `term_rule`, `sensitivity` (of the number per SI unit of the input),
        `input_uncertainty`, `standard_uncertainty`, `bound`, `share` of the variance, and `standard_uncertainty_doubt`,
        how far a drawn standard uncertainty may be off. `numerical_bound` (the sum of bounds), `numerical_rss`,
        `physical_rss`, `total_rss`. With draws `monte_carlo_standard_uncertainty`, `monte_carlo_shortest`,
        `monte_carlo_symmetric`, `linear_apart`; `linear_verdict`. `result`, the number as it is written. Where it is asked for
        `proven_interval` and `proven_error`, what the number is off by at most, with `proven_text`.

    Raises
    ------
    InputError
        If the run does not have the number, a setting is wrong, a term is of another quantity, unit, time or event, a
        name is no term, or the model was fitted inadequately.

    Notes
    -----
    Numerical terms. Truncation: three finer runs; the distance of the finest, with an allowance as in the grid
    convergence index (1.25 where triples of levels agree in an order, up to 3 where they do not), plus its uncertainty
    (see `refine`). Rounding: copies in random units, in which every operation is rounded differently, as CADNA and
    Verificarlo do operation by operation (Vignes 1993, doi:10.1016/0378-4754(93)90003-D; Denis, de Oliveira Castro,
    Petit 2016, doi:10.1109/ARITH.2016.31); for reversible runs of a symmetric method also the way back to the start. A
    bound is treated as a rectangular distribution.

    Physical terms: JCGM 100:2008, 5.1 and 5.2 (correlated inputs). Slopes come from the run's variational equations,
    with saltation matrices at events and impacts, compared with central differences over about the input's uncertainty;
    the differences are used where the two disagree, and where a contact is held, dry friction acts or a force is
    written in Python (`term_rule` says which). Measured tables: rows with ``u(f) [N]`` are independent, each with a
    slope of its own, and ``u_common(f) [N]`` moves all rows together; where drawn tables disagree with the slopes, or
    there are more than 256 rows, 64 drawn tables give the term, and `standard_uncertainty_doubt` its accuracy. Monte
    Carlo: JCGM 101:2008; the march's own errors are not drawn.

    Examples
    --------
    >>> import xdynamics as xd
    >>> model = xd.Model.from_toml("data/models/ball_drag.toml")
    >>> budget = error_budget(model, "t", event="apex", method="dormand_prince", rtol=1e-8)
    >>> budget.term_name.values[:4].tolist()
    ['truncation', 'roundoff', 'interpolation', 'event_location']
    >>> float(budget.numerical_bound) < 1e-6
    True
    """
    budget_arguments: dict[str, Any] = {
        "at": at,
        "event": event,
        "occurrence": occurrence,
        "side": side,
        "terms": terms,
        "draws": draws,
        "seed": seed,
        "coverage": coverage,
        "digits": digits,
        "inadequate_fit": inadequate_fit,
        "only": only,
        "without": without,
        "proven": proven,
        "keep": keep,
    }
    if is_sweep(model):
        if settings or until_uncertainty is not None:
            refused_settings = ", ".join(settings) or "until_uncertainty"
            raise InputError(
                f"{refused_settings} cannot be given for a sweep, whose members have their settings; give draws=10000"
            )
        return budgets_over(cast("xr.Dataset", model), quantity, error_budget, compute=compute, **budget_arguments)
    request = budget_request(cast("Model", model), quantity, **budget_arguments, **settings)
    if until_uncertainty is None:
        return budget_stage(request).result(compute=compute)
    if not compute:
        raise InputError(
            "until_uncertainty doubles the draws until they suffice, and how many is known only once they are"
            " computed; give draws=10000, or compute=True"
        )
    return _budget_until_known(request, until_uncertainty)


def _budget_until_known(request: BudgetRequest, until_uncertainty: str) -> xr.Dataset:
    """March the runs of a budget, and draw until the intervals' ends are known as well as wanted."""
    tasks = _tasks(request)
    parts = BudgetParts.from_results(dict(zip(tasks, results_of(*tasks.values()), strict=True)))
    _doubt_slopes(parts.terms, request.target)
    end_tolerance = end_tolerance_of(until_uncertainty, parse_unit(parts.own_run.units), request.target, COVERAGE)
    propagation = request.propagation(parts.number.value, parts.terms)
    first = max(request.draws, FIRST_DRAWS)
    monte_carlo, draws = draw_until_known(propagation, first, request.coverage, end_tolerance)
    return budget_dataset(replace(request, draws=draws), parts, monte_carlo)


def budget_stage(request: BudgetRequest) -> Stage:
    """Return a budget: a task for each level, each source and each block of draws.

    Raises
    ------
    InputError
        If terms do not fit together.
    """
    tasks = _tasks(request)
    if request.draws:
        numbers = request.propagation(NOT_MARCHED.value, []).numbers(request.draws)
        tasks |= {} if numbers is None else {DRAWS: Gathered(numbers)}
    task = Task.of("budget", partial(_budget_of_parts, request, [*tasks]), tuple(tasks.values()), *request.words)
    known_names = ("term_name", "term_kind", STEPS.name, RTOLS.name, "model_toml")
    return Stage(task, partial(_blank_budget, request), known_names)


def _blank_budget(request: BudgetRequest) -> xr.Dataset:
    """Return a budget before anything is marched.

    Raises
    ------
    InputError
        If a setting is wrong, or nothing is uncertain that could be drawn.
    """
    measurand = request.measurand
    run = blank_run(March(measurand.model, unthinned_settings_for(measurand.model, **measurand.settings)))
    own_run = OwnRun.from_run(measurand, run)
    unit = parse_unit(own_run.units)
    terms = [term for source in request.sources for term in source.blank(unit)]
    if request.draws:
        request.propagation(NOT_MARCHED.value, terms).check()
    is_compared = any(COMPARED in source.needs for source in request.sources)
    levels = LevelComparison.blank(levels_of(measurand)) if is_compared else None
    blank = BudgetParts(own_run, NOT_MARCHED, levels, terms, NOT_PROVEN if request.proven else None)
    return budget_dataset(request, blank, NOTHING_DRAWN if request.draws else None)


def _tasks(request: BudgetRequest) -> dict[Any, Task | Gathered]:
    """Return the tasks of a budget: its run, the number in it and in levels, and all terms."""
    measurand = request.measurand
    needs = {need for source in request.sources for need in source.needs}
    run = numerical.run_task(measurand)
    number = numerical.number_task(measurand, run)
    shared_tasks: dict[str, Task | Gathered] = {RUN: run, NUMBER: number}
    if COMPARED in needs:
        shared_tasks[COMPARED] = numerical.levels_task(measurand, number, levels_of(measurand))
    if ROUNDING in needs:
        shared_tasks[ROUNDING] = numerical.rounding_source(measurand).task(measurand, shared_tasks)
    if COPIES in needs:
        shared_tasks[COPIES] = Gathered(shifted_copies(measurand, request.inputs))
    parts: dict[Any, Task | Gathered] = {
        name: shared_tasks[name] for name in (NUMBER, COMPARED) if name in shared_tasks
    }
    parts[OWN] = own_run_task(measurand, run)
    parts |= {PROVEN: proven_task(measurand, run)} if request.proven else {}
    return parts | {source.names: source.task(measurand, shared_tasks) for source in request.sources}


def _budget_of_parts(request: BudgetRequest, names: list[Any], *task_results: Any) -> xr.Dataset:
    """Return a budget from the results of its tasks; called inside a task."""
    parts = dict(zip(names, task_results, strict=True))
    numbers, budget_parts = parts.pop(DRAWS, None), BudgetParts.from_results(parts)
    _doubt_slopes(budget_parts.terms, request.target)
    if not request.draws:
        return budget_dataset(request, budget_parts, None)
    propagation = request.propagation(budget_parts.number.value, budget_parts.terms)
    return budget_dataset(
        request, budget_parts, draw_statistics(propagation.added_to(numbers, request.draws), request.coverage)
    )


def _doubt_slopes(terms: Sequence[Term], target: Target) -> None:
    """Warn of slopes that depend on the spacing of differences, where that matters."""
    total = float(np.sqrt(sum(term.standard**2 for term in terms)))
    for term in terms:
        deviation = term.sensitivity_doubt * term.input_uncertainty
        if term.input_unit is not None and deviation > UNSURE * max(term.standard, UNSURE * total):
            warn(
                f"{target.description} does not change in proportion with '{term.name}' within its uncertainty, or not"
                f" smoothly: its slope may be off by {deviation / term.standard if term.standard else inf:.1g} of"
                " itself; draw",
                AccuracyWarning,
            )

"""The error budget of one number: every source of error in one table, with totals and a Monte Carlo check."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf, nan
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics.budgeting import numerical, physical, tabulated
from xdynamics.budgeting.budget_variables import draws_as, later_as, levels_as, terms_as
from xdynamics.budgeting.measurand import Target
from xdynamics.budgeting.montecarlo import (
    LINEAR,
    NOT_ADEQUATE,
    NOT_CHECKED,
    NOTHING_DRAWN,
    Drawn,
    drawn,
    draws_needed,
    judged,
)
from xdynamics.budgeting.random_draws import Asked, drawn_until, wanted_of
from xdynamics.budgeting.rounding import rounded
from xdynamics.budgeting.term import PHYSICAL, Declared, Term
from xdynamics.elementary.arrays import applied
from xdynamics.evidence.diagnosing.extremes import RULES
from xdynamics.evidence.evidence_dataset import about, exhibit
from xdynamics.evidence.stages import Gathered, Stage, Task, blank_run, inputs_of, lazy
from xdynamics.faults import AccuracyWarning, InputError, warn
from xdynamics.march import March
from xdynamics.march.configuration import unthinned_settings_for
from xdynamics.model import Model
from xdynamics.record.circumstances import xdynamics_version
from xdynamics.schema import STEPS, flags
from xdynamics.sweeping.sweep import plain
from xdynamics.units import NUMBERS, Unit

if TYPE_CHECKING:
    import xarray as xr

COVERAGE = 0.95
UNSURE = 0.02  # relative error of a term up to which a doubtful slope is not warned of
LEAST_DRAWS, FIRST_DRAWS = 100, 4096
MEMBERS = 512  # copies or draws of a task


def error_budget(
    model: Model,
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
    compute: bool = True,
    **settings: Any,
) -> xr.Dataset:
    """Return the error budget of one number of a run: how far it may be off, and why.

    Parameters
    ----------
    model : Model
        Its parameters and initial values with an uncertainty, tables with a column of uncertainties, correlations and
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
    compute : bool
        Whether to march at once. If False, the Dataset has dask arrays, with a task for each level, each term and each
        block of draws; `until_uncertainty` cannot be used.
    **settings
        Settings of `simulate` for the run that the number is of.

    Returns
    -------
    xarray.Dataset
        `value`, the run's own, not extrapolated, and along `level` its value in finer runs, with `observed_order`.
        Along `term`: `term_name`, `term_kind`, `term_rule`, `sensitivity` (of the number per SI unit of the input),
        `input_uncertainty`, `standard_uncertainty`, `bound`, `share` of the variance, and `standard_uncertainty_doubt`,
        how far a drawn standard uncertainty may be off. `numerical_bound` (the sum of bounds), `numerical_rss`,
        `physical_rss`, `total_rss`. With draws `monte_carlo_standard_uncertainty`, `monte_carlo_shortest`,
        `monte_carlo_symmetric`, `linear_apart`; `linear_verdict`. `result`, the number as it is written.

    Raises
    ------
    InputError
        If the run does not have the number, a setting is wrong, a term is of another quantity, unit, time or event, or
        the model was fitted inadequately.

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
    request = budget_request(
        model,
        quantity,
        at=at,
        event=event,
        occurrence=occurrence,
        side=side,
        terms=terms,
        draws=draws,
        seed=seed,
        coverage=coverage,
        digits=digits,
        inadequate_fit=inadequate_fit,
        **settings,
    )
    if not compute:
        if until_uncertainty is not None:
            raise InputError(
                "until_uncertainty doubles the draws until they suffice, and how many is known only once they are"
                " marched; give draws=10000, or compute=True"
            )
        return lazy(budget_stage(request))
    target, asked = request.target, request.asked
    marched = numerical.marched(model, target, asked, seed)
    unit = target.units(marched.run)
    rounding = next(term.bound for term in marched.terms if term.name == numerical.ROUNDOFF)
    inputs = physical.inputs(model, target, asked, marched.run, rounding)
    all_terms = request.terms(marched, unit, inputs, tabulated.tables(model, target, asked, seed))
    _doubt_slopes(all_terms, target)
    if not (draws or until_uncertainty is not None):
        return _dataset(request, marched, all_terms, None)
    wanted = wanted_of(until_uncertainty, unit, target, COVERAGE)
    first = draws if until_uncertainty is None else max(draws, FIRST_DRAWS)
    monte_carlo, draws = drawn_until(request.drawn(marched.value, all_terms), first, seed, coverage, wanted)
    return _dataset(replace(request, draws=draws), marched, all_terms, monte_carlo)


@dataclass(frozen=True)
class Request:
    """What a budget is asked for.

    Attributes
    ----------
    model : Model
    target : Target
    asked : dict
        Settings of `simulate`.
    declared : tuple of Declared
    draws, seed : int
    coverage : float
    digits : int
    inadequate_fit : bool
    """

    model: Model
    target: Target
    asked: dict[str, Any]
    declared: tuple[Declared, ...]
    draws: int
    seed: int
    coverage: float
    digits: int
    inadequate_fit: bool

    def terms(self, marched: numerical.Marched, unit: Unit, inputs: list[Term], tables: list[Term]) -> list[Term]:
        """Return all terms: those of the march, of the model, and declared ones.

        Raises
        ------
        InputError
            If two terms have the same name, or a declared one is of another number.
        """
        declared = [_declared(term).term(self.target, unit) for term in self.declared]
        discrepancy = physical.discrepancy(self.model, self.target, unit)
        all_terms = [*marched.terms, *inputs, *tables, *discrepancy, *declared]
        names = [term.name for term in all_terms]
        if repeated := sorted({name for name in names if names.count(name) > 1}):
            in_model = repeated[0] not in {term.name for term in declared}
            remedy = f"rename the model's '{repeated[0]}'" if in_model else "give the declared one another name"
            raise InputError(f"the budget has two terms '{repeated[0]}'; {remedy}")
        return all_terms

    def drawn(self, value: float, terms: Sequence[Term]) -> Asked:
        """Return what is drawn."""
        added = [term.standard for term in terms if term.kind == PHYSICAL and term.name not in self.model.uncertain]
        return Asked(self.model, self.target, self.asked, value, added)


def budget_request(
    model: Model,
    quantity: str,
    *,
    at: Any = None,
    event: Any = None,
    occurrence: Any = 1,
    side: Any = "before",
    terms: Any = (),
    draws: int = 0,
    seed: int = 0,
    coverage: float = COVERAGE,
    digits: int = 1,
    inadequate_fit: bool = False,
    **settings: Any,
) -> Request:
    """Read and check the arguments of `error_budget`.

    Raises
    ------
    InputError
        If one is wrong, or the model was fitted inadequately.
    """
    if not isinstance(model, Model):
        raise InputError(f"model is {str(model)[:60]!r}, needs a Model; read a file with Model.from_toml")
    _check(draws, seed, coverage, digits)
    _check_fit(model, inadequate_fit)
    target = Target.of(model, quantity, at, event, occurrence, side)
    asked = {name: plain(name, entry) for name, entry in settings.items() if entry is not None}
    declared = (terms,) if isinstance(terms, Declared) else tuple(terms or ())
    return Request(model, target, asked, declared, draws, seed, coverage, digits, inadequate_fit is True)


def _check_fit(model: Model, inadequate_fit: Any) -> None:
    if model.fit is not None and not model.fit.adequate and inadequate_fit is not True:
        raise InputError(
            f"the model was fitted to {model.fit.data}, and the fit is not adequate: {model.fit.description}. Fit it"
            " again, from other starts or with another model, or ask for the budget all the same: inadequate_fit=True"
            " (--inadequate-fit)"
        )


def budget_stage(request: Request) -> Stage:
    """Return a budget before it is computed: a task for each level, each term and each block of draws.

    Raises
    ------
    InputError
        If a setting is wrong, or terms do not fit together.
    """
    model, target, asked = request.model, request.target, request.asked
    levels = numerical.levels_of(model, asked)
    inputs = (model.digest, target, inputs_of(asked), xdynamics_version())
    runs = numerical.level_tasks(model, asked, levels)
    compared = Task.of("levels", partial(numerical.Marched.of, levels, model, target), runs, *inputs)
    roundoff = Task.of(
        "roundoff",
        partial(numerical.rounding_term, model, target, asked, request.seed),
        (compared,),
        *inputs,
        request.seed,
    )
    location = Task.of("location", partial(numerical.location_term, model, target, asked), (compared,), *inputs)
    needs: list[Task | Gathered] = [compared, roundoff, location]
    if model.uncertain:
        members = physical.copies(model, target, asked, members_per_task=MEMBERS)
        call = partial(_inputs, model, target, asked)
        needs.append(Task.of("inputs", call, (compared, roundoff, Gathered(target.variable(members))), *inputs))
    tables = [*tabulated.sources(model, target, asked, request.seed)]
    needs += [Task.of("table", call, (), *inputs, name, request.seed) for name, call in tables]

    prepared = March(model, unthinned_settings_for(model, **asked))
    blank = numerical.Marched.blank(levels, blank_run(prepared))
    unknown = [Term(name, PHYSICAL, nan, nan, "", input_unit=NUMBERS) for name, _ in tables]
    terms = request.terms(blank, target.units(blank.run), physical.blank(model), unknown)
    if request.draws and (
        draws := request.drawn(nan, terms).members(request.draws, request.seed, members_per_task=MEMBERS)
    ):
        needs.append(Gathered(target.variable(draws)))
    template = _dataset(request, blank, terms, NOTHING_DRAWN if request.draws else None)
    words = (request.declared, request.draws, request.seed, request.coverage, request.digits, request.inadequate_fit)
    task = Task.of("budget", partial(_of_tasks, request, len(tables)), tuple(needs), *inputs, *words)
    return Stage(template, task, ("term_name", "term_kind", levels.varied.name, "model_toml"))


def _inputs(
    model: Model, target: Target, asked: dict[str, Any], compared: numerical.Marched, roundoff: Term, numbers: Any
) -> list[Term]:
    """Return the terms of inputs, in a task."""
    return physical.inputs(model, target, asked, compared.run, roundoff.bound, numbers)


def _of_tasks(
    request: Request, tables: int, compared: numerical.Marched, roundoff: Term, location: Term, *others: Any
) -> xr.Dataset:
    """Put a budget together, in a task."""
    rest = [*others]
    inputs = rest.pop(0) if request.model.uncertain else []
    marched = compared.with_terms(roundoff, location)
    terms = request.terms(marched, request.target.units(marched.run), inputs, rest[:tables])
    _doubt_slopes(terms, request.target)
    if not request.draws:
        return _dataset(request, marched, terms, None)
    asked = request.drawn(marched.value, terms)
    values = asked.added_to(rest[tables] if len(rest) > tables else None, request.draws, request.seed)
    return _dataset(request, marched, terms, drawn(values, request.coverage))


def _dataset(request: Request, marched: numerical.Marched, terms: list[Term], monte_carlo: Drawn | None) -> xr.Dataset:
    """Put a budget together."""
    model, target = request.model, request.target
    unit = target.units(marched.run)
    variables = terms_as(model, target, unit, marched.value, terms) | levels_as(marched, unit)
    later: dict[str, Any] = {}
    verdict, total = NOT_CHECKED, float(variables["total_rss"][1])
    if monte_carlo is not None:
        variables |= draws_as(monte_carlo, unit, request.coverage)
        verdict, later = _judged(request, marched.value, float(variables["physical_rss"][1]), monte_carlo)
        if verdict == NOT_ADEQUATE:
            total = float(applied("hypot", monte_carlo.standard, float(variables["numerical_rss"][1])))
    variables["linear_verdict"] = (
        (),
        np.int8(verdict),
        about("1", "whether the linear budget is adequate, by JCGM 101:2008, 8", "flag")
        | flags(dict(enumerate(LINEAR))),
    )
    variables["model_toml"] = ((), np.array(model.to_toml()), about("1", "the whole model as TOML", "model"))
    coverage_text = "k = 2, drawn" if verdict == NOT_ADEQUATE else "k = 2"
    bound = float(variables["numerical_bound"][1])
    later |= {"result": rounded(marched.value, total, bound, unit.text, coverage_text)}
    later |= _where(target, marched.run, model)
    variables |= later_as(later, unit.text, target.second)
    attributes = {name: value for name, value in later.items() if value == value}
    title = f"error budget of {model.name}: {target.said}"
    return exhibit("budget", title, marched.digests, variables, _attributes(request, marched) | attributes)


def _attributes(request: Request, marched: numerical.Marched) -> dict[str, Any]:
    """Return what a budget was asked for."""
    target = request.target
    return (
        {"coverage": request.coverage, "seed": request.seed, "draws": request.draws}
        | ({"digits": request.digits} if request.draws else {})
        | {
            "inadequate_fit": int(request.inadequate_fit),
            "quantity": target.quantity,
            "of": target.said,
            "event": target.event,
            "occurrence": target.occurrence,
            "side": target.side,
            "asked": json.dumps(request.asked, sort_keys=True),
            "model_digest": request.model.digest,
            "time_units": target.second,
            "solver_method": str(marched.run.attrs["solver_method"]),
        }
        | ({"at": target.at} if target.at is not None else {})
    )


def _judged(request: Request, value: float, physical_rss: float, monte_carlo: Drawn) -> tuple[int, dict[str, Any]]:
    """Judge the linear budget by the draws; return the verdict, and by how much both are apart."""
    verdict, distance = judged(value, physical_rss, monte_carlo, request.coverage, request.digits)
    needed = nan
    if verdict == NOT_CHECKED:
        needed = draws_needed(distance, monte_carlo, request.draws, request.coverage, request.digits)
    return verdict, {"linear_apart": distance, "draws_needed": needed}


def _where(target: Target, run: Any, model: Model) -> dict[str, Any]:
    """Return time and rule of an extreme in the run; nothing for other numbers."""
    if target.extreme is not None and not run.sizes[STEPS]:
        return {"extreme_rule": "", "extreme_time": nan}
    top = target.found_in(run, model)
    return {} if top is None else {"extreme_rule": RULES[top.rule], "extreme_time": top.time}


def _check(draws: Any, seed: Any, coverage: Any, digits: Any) -> None:
    if isinstance(digits, bool) or digits not in (1, 2):
        raise InputError(f"digits is {digits!r}; there are 1, 2")
    if isinstance(draws, bool) or not isinstance(draws, int) or not (draws == 0 or draws >= LEAST_DRAWS):
        raise InputError(f"draws is {draws!r}, needs 0 for none, or a whole number from {LEAST_DRAWS} on")
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise InputError(f"seed is {seed!r}, needs a non-negative whole number")
    if isinstance(coverage, bool) or not isinstance(coverage, int | float) or not 0.0 < coverage < 1.0:
        raise InputError(f"coverage is {coverage!r}, needs a number between 0 and 1, like 0.95")


def _declared(term: Any) -> Declared:
    if not isinstance(term, Declared):
        raise InputError(f"terms has {str(term)[:60]!r}, needs Declared(name, quantity, standard, at=…)")
    return term


def _doubt_slopes(terms: Sequence[Term], target: Target) -> None:
    """Warn of slopes that depend on the spacing of differences, where that matters."""
    total = float(np.sqrt(sum(term.standard**2 for term in terms)))
    for term in terms:
        deviation = term.sensitivity_doubt * term.input_uncertainty
        if term.input_unit is not None and deviation > UNSURE * max(term.standard, UNSURE * total):
            warn(
                f"{target.said} does not change in proportion with '{term.name}' within its uncertainty, or not"
                f" smoothly: its slope may be off by {deviation / term.standard if term.standard else inf:.1g} of"
                " itself; draw",
                AccuracyWarning,
            )

"""The error budget of one number: every source of error in one table, with totals and a Monte Carlo check."""

from __future__ import annotations

import json
from collections.abc import Sequence
from math import inf
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics.budgeting import numerical, physical, tabulated
from xdynamics.budgeting.budget_variables import draws_as, levels_as, terms_as
from xdynamics.budgeting.measurand import Target
from xdynamics.budgeting.montecarlo import LINEAR, NOT_ADEQUATE, NOT_CHECKED, draws_needed, judged
from xdynamics.budgeting.random_draws import Asked, drawn_until, wanted_of
from xdynamics.budgeting.rounding import rounded
from xdynamics.budgeting.term import PHYSICAL, Declared, Term
from xdynamics.elementary.arrays import applied
from xdynamics.evidence.diagnosing.extremes import RULES
from xdynamics.evidence.evidence_dataset import about, exhibit
from xdynamics.faults import AccuracyWarning, InputError, warn
from xdynamics.model import Model
from xdynamics.schema import flags
from xdynamics.sweeping.sweep import plain
from xdynamics.units import Unit

if TYPE_CHECKING:
    import xarray as xr

COVERAGE = 0.95
UNSURE = 0.02  # relative error of a term up to which a doubtful slope is not warned of
LEAST_DRAWS, FIRST_DRAWS = 100, 4096


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
        `monte_carlo_symmetric`; `linear_verdict`.

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
    if not isinstance(model, Model):
        raise InputError(f"model is {str(model)[:60]!r}, needs a Model; read a file with Model.from_toml")
    _check(draws, seed, coverage, digits)
    if model.fit is not None and not model.fit.adequate and inadequate_fit is not True:
        raise InputError(
            f"the model was fitted to {model.fit.data}, and the fit is not adequate: {model.fit.description}. Fit it"
            " again, from other starts or with another model, or ask for the budget all the same: inadequate_fit=True"
            " (--inadequate-fit)"
        )
    target = Target.of(model, quantity, at, event, occurrence, side)
    plain_settings = {name: plain(name, entry) for name, entry in settings.items() if entry is not None}
    marched = numerical.marched(model, target, plain_settings, seed)
    unit = target.units(marched.run)
    all_terms = _terms(model, target, plain_settings, marched, unit, terms, seed)
    variables = terms_as(model, target, unit, marched.value, all_terms) | levels_as(marched, unit)
    attributes: dict[str, Any] = {"coverage": coverage, "seed": seed, "draws": draws}
    verdict, total = NOT_CHECKED, float(variables["total_rss"][1])
    if draws or until_uncertainty is not None:
        added = [entry.standard for entry in all_terms if entry.kind == PHYSICAL and entry.name not in model.uncertain]
        wanted = wanted_of(until_uncertainty, unit, target, COVERAGE)
        first = draws if until_uncertainty is None else max(draws, FIRST_DRAWS)
        monte_carlo, draws = drawn_until(
            Asked(model, target, plain_settings, marched.value, added), first, seed, coverage, wanted
        )
        variables |= draws_as(monte_carlo, unit, coverage)
        verdict, distance = judged(marched.value, float(variables["physical_rss"][1]), monte_carlo, coverage, digits)
        undecided = verdict == NOT_CHECKED
        attributes |= {"draws": draws, "linear_apart": distance, "digits": digits}
        attributes |= (
            {"draws_needed": draws_needed(distance, monte_carlo, draws, coverage, digits)} if undecided else {}
        )
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
    result = rounded(marched.value, total, float(variables["numerical_bound"][1]), unit.text, coverage_text)
    attributes |= (
        {
            "inadequate_fit": int(inadequate_fit),
            "quantity": quantity,
            "of": target.said,
            "event": target.event,
            "occurrence": occurrence,
            "side": side,
            "asked": json.dumps(plain_settings, sort_keys=True),
            "model_digest": model.digest,
            "time_units": target.second,
            "solver_method": str(marched.run.attrs["solver_method"]),
            "result": result,
        }
        | ({"at": target.at} if target.at is not None else {})
        | _where(target, marched.run, model)
    )
    return exhibit("budget", f"error budget of {model.name}: {target.said}", marched.digests, variables, attributes)


def _where(target: Target, run: Any, model: Model) -> dict[str, Any]:
    """Return time and rule of an extreme in the run; nothing for other numbers."""
    top = target.found_in(run, model)
    return {} if top is None else {"extreme_rule": RULES[top.rule], "extreme_time": top.time}


def _terms(
    model: Model,
    target: Target,
    settings: dict[str, Any],
    marched: numerical.Marched,
    unit: Unit,
    terms: Any,
    seed: int,
) -> list[Term]:
    """Return all terms: those of the march, of the model, and declared ones.

    Raises
    ------
    InputError
        If two terms have the same name, or a declared one is of another number.
    """
    declared = [
        _declared(term).term(target, unit) for term in ([terms] if isinstance(terms, Declared) else terms or ())
    ]
    rounding = next(term.bound for term in marched.terms if term.name == numerical.ROUNDOFF)
    all_terms = [
        *marched.terms,
        *physical.inputs(model, target, settings, marched.run, rounding),
        *tabulated.tables(model, target, settings, seed),
        *physical.discrepancy(model, target, unit),
        *declared,
    ]
    names = [term.name for term in all_terms]
    if repeated := sorted({name for name in names if names.count(name) > 1}):
        in_model = repeated[0] not in {term.name for term in declared}
        remedy = f"rename the model's '{repeated[0]}'" if in_model else "give the declared one another name"
        raise InputError(f"the budget has two terms '{repeated[0]}'; {remedy}")
    _doubt_slopes(all_terms, target)
    return all_terms


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

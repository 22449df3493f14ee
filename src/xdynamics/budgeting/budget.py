"""The budget of one number: every reason why it may be off, in one table, with totals and a Monte Carlo check."""

from __future__ import annotations

import json
from collections.abc import Sequence
from math import inf
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics.budgeting import numerical, physical
from xdynamics.budgeting.drawing import Asked, drawn_until, wanted_of
from xdynamics.budgeting.montecarlo import LINEAR, NOT_ADEQUATE, NOT_CHECKED, Drawn, judged
from xdynamics.budgeting.rounding import rounded
from xdynamics.budgeting.target import Target
from xdynamics.budgeting.term import KINDS, NUMERICAL, PHYSICAL, Declared, Term
from xdynamics.evidence.exhibit import about, exhibit
from xdynamics.evidence.refining.convergence import VERDICTS, observed_orders
from xdynamics.faults import AccuracyWarning, InputError, warn
from xdynamics.model import Model
from xdynamics.schema import BOUNDS, LEVEL, flags
from xdynamics.sweeping.surveying import quotient
from xdynamics.sweeping.sweep import plain
from xdynamics.units import Unit, spell

if TYPE_CHECKING:
    import xarray as xr

TERM = "term"
ROLE = "budget"
COVERAGE = 0.95
UNSURE = 0.02  # of a term, by which its slope may be off without a word
CANCELLED = 1e-12  # of the variances, of which there is nothing left where terms cancel
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
    **settings: Any,
) -> xr.Dataset:
    """Say how far one number of a run may be off, and why.

    Parameters
    ----------
    model : Model
        Its parameters and initial values with an uncertainty, tables with a column of uncertainties, correlations and
        discrepancies are the physical terms.
    quantity : str
        A coordinate, velocity, state, energy or observable; at an event ``"t"``, its time.
    at : str or float, s
        The physical time of the number; or
    event : str
        The event at which it is asked for,
    occurrence : int
        the how-manieth, and
    side : {"before", "after"}
        on which side of it.
    terms : sequence of Declared
        Further terms, of this very number.
    draws : int
        Of the Monte Carlo check; 0 for none.
    seed : int
        Of all that is drawn.
    coverage : float
        Of the intervals.
    until_uncertainty : str, optional
        Draw on, twice as many each time, until the intervals' ends are known so well: ``"10 m at 95 %"``.
    digits : {1, 2}
        Of the standard uncertainty, whose last half place the linear interval may be off (JCGM 101:2008, 7.9.2 and 8.1).
    **settings
        Of `simulate`: the run that the number is of.

    Returns
    -------
    xarray.Dataset
        `value`, the run's own, not extrapolated, and along `level` what it is in finer runs, with `observed_order`. Along `term`: `term_name`, `term_kind`, `term_rule`, `sensitivity` (of
        the number per SI unit of the input), `input_uncertainty`, `standard_uncertainty`, `bound`, `share` of the
        variance. `numerical_bound` (the sum of bounds), `numerical_rss`, `physical_rss`, `total_rss`. With draws
        `monte_carlo_standard_uncertainty`, `monte_carlo_shortest`, `monte_carlo_symmetric`; `linear_verdict`.

    Raises
    ------
    InputError
        If the number is not there, a setting is wrong, or a term is of another quantity, unit, time or event.

    Notes
    -----
    Numerical terms. Truncation: three finer runs; what the finest is away and uncertain by (see `refine`). Rounding:
    copies in units drawn at random, of which every operation is rounded in another way, as CADNA and Verificarlo do it
    operation by operation (Vignes 1993, doi:10.1016/0378-4754(93)90003-D; Denis, de Oliveira Castro, Petit 2016,
    doi:10.1109/ARITH.2016.31). A bound is taken for a rectangular distribution. Physical terms: JCGM 100:2008, 5.1 and
    5.2 (correlated inputs). Monte Carlo: JCGM 101:2008; of the march's own errors nothing is drawn.

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
    target = Target.of(model, quantity, at, event, occurrence, side)
    asked = {name: plain(name, one) for name, one in settings.items() if one is not None}
    found = numerical.marched(model, target, asked, seed)
    unit = target.units(found.run)
    declared = [_declared(one).term(target, unit) for one in ([terms] if isinstance(terms, Declared) else terms or ())]
    known = [
        *found.terms, *physical.inputs(model, target, asked), *physical.tables(model, target, asked, found.value, seed),
        *physical.discrepancy(model, target, unit), *declared,
    ]  # fmt: skip
    names = [one.name for one in known]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        own = twice[0] in model.parameters or twice[0] in model.drives
        remedy = f"rename the model's '{twice[0]}'" if own and twice[0] not in {one.name for one in declared} else "give the declared one another name"  # fmt: skip
        raise InputError(f"the budget has two terms '{twice[0]}'; {remedy}")
    _doubt_slopes(known, target)
    variables = _table(model, target, unit, found.value, known) | _levels(found, unit)
    more: dict[str, Any] = {"coverage": coverage, "seed": seed, "draws": draws}
    if draws or until_uncertainty is not None:
        added = [one.standard for one in known if one.kind == PHYSICAL and one.input_unit is None]
        wanted = wanted_of(until_uncertainty, unit, target, COVERAGE)
        first = draws if until_uncertainty is None else max(draws, FIRST_DRAWS)
        monte_carlo, draws = drawn_until(Asked(model, target, asked, found.value, added), first, seed, coverage, wanted)
        more["draws"] = draws
        linear = float(variables["physical_rss"][1])
        variables |= _of_draws(monte_carlo, unit, coverage)
        verdict, apart = judged(found.value, linear, monte_carlo, coverage, digits)
        more |= {"linear_apart": apart, "digits": digits}
    else:
        verdict = NOT_CHECKED
    variables["linear_verdict"] = ((), np.int8(verdict), about("1", "whether the linear budget is adequate, by JCGM 101:2008, 8", "flag") | flags(dict(enumerate(LINEAR))))  # fmt: skip
    variables["model_toml"] = ((), np.array(model.to_toml()), about("1", "the whole model as TOML", "model"))
    total, bound = float(variables["total_rss"][1]), float(variables["numerical_bound"][1])
    told = "k = 2"
    if verdict == NOT_ADEQUATE:
        total, told = float(np.hypot(monte_carlo.standard, float(variables["numerical_rss"][1]))), "k = 2, drawn"
    more |= {
        "quantity": quantity, "of": target.said, "event": target.event, "occurrence": occurrence, "side": side,
        "asked": json.dumps(asked, sort_keys=True), "model_digest": model.digest,
        "solver_method": str(found.run.attrs["solver_method"]), "result": rounded(found.value, total, bound, unit.text, told),
    } | ({"at": target.at} if target.at is not None else {})  # fmt: skip
    return exhibit("budget", f"error budget of {model.name}: {target.said}", found.digests, variables, more)


def _check(draws: Any, seed: Any, coverage: Any, digits: Any) -> None:
    if isinstance(digits, bool) or digits not in (1, 2):
        raise InputError(f"digits is {digits!r}; there are 1, 2")
    if isinstance(draws, bool) or not isinstance(draws, int) or not (draws == 0 or draws >= LEAST_DRAWS):
        raise InputError(f"draws is {draws!r}, needs 0 for none, or a whole number from {LEAST_DRAWS} on")
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise InputError(f"seed is {seed!r}, needs a non-negative whole number")
    if isinstance(coverage, bool) or not isinstance(coverage, int | float) or not 0.0 < coverage < 1.0:
        raise InputError(f"coverage is {coverage!r}, needs a number between 0 and 1, like 0.95")


def _declared(one: Any) -> Declared:
    if not isinstance(one, Declared):
        raise InputError(f"terms has {str(one)[:60]!r}, needs Declared(name, quantity, standard, at=…)")
    return one


def _doubt_slopes(terms: Sequence[Term], target: Target) -> None:
    """Warn of slopes that another spacing gives otherwise, where that counts."""
    whole = float(np.sqrt(sum(one.standard**2 for one in terms)))
    for one in terms:
        off = one.sensitivity_doubt * one.input_uncertainty
        if one.input_unit is not None and off > UNSURE * max(one.standard, UNSURE * whole):
            warn(f"{target.said} does not change in proportion with '{one.name}' within its uncertainty, or not smoothly: its slope may be off by {off / one.standard if one.standard else inf:.1g} of itself; draw", AccuracyWarning)  # fmt: skip


def _table(model: Model, target: Target, unit: Unit, value: float, terms: list[Term]) -> dict[str, Any]:
    """Return the terms as variables, and the totals."""
    parts = {kind: [one for one in terms if one.kind == kind] for kind in KINDS}
    covariance = physical.covariance(model, terms)
    variance = {NUMERICAL: sum(one.standard**2 for one in parts[NUMERICAL]), PHYSICAL: physical.variance(model, parts[PHYSICAL])}  # fmt: skip
    total = variance[NUMERICAL] + variance[PHYSICAL]
    cancelled = total <= CANCELLED * float(np.trace(covariance))
    shares = np.zeros(len(terms)) if cancelled else covariance.sum(axis=1) / total
    said, text = target.said, unit.text
    units = [_per(unit, one.input_unit) if one.input_unit else "" for one in terms]
    bounds = {kind: sum(one.bound for one in parts[kind]) for kind in KINDS}
    scalars = {
        "value": (value, f"{said}, the run's own"),
        "numerical_bound": (bounds[NUMERICAL], "sum of the numerical terms' bounds"),
        "physical_bound": (bounds[PHYSICAL], "sum of the physical terms' bounds"),
        "numerical_rss": (np.sqrt(variance[NUMERICAL]), "root of the sum of squares of the numerical terms"),
        "physical_rss": (np.sqrt(variance[PHYSICAL]), "standard uncertainty by the physical terms, with their correlations"),
        "total_rss": (np.sqrt(total), "standard uncertainty by all terms"),
    }  # fmt: skip
    along: dict[str, Any] = {
        "term_name": (np.array([one.name for one in terms]), "1", "what the number may be off by", "name"),
        "term_rule": (np.array([one.rule for one in terms]), "1", "how that was found", "rule"),
        "sensitivity": (np.array([one.sensitivity for one in terms]), "1", "change of the number with the input, in sensitivity_units; nan where there is no input", ROLE),
        "sensitivity_doubt": (np.array([one.sensitivity_doubt for one in terms]), "1", "how far the sensitivity may be off, by another spacing of the differences", ROLE),
        "sensitivity_units": (np.array(units), "1", "unit of the sensitivity: the number's, per SI unit of the input", "units"),
        "input_uncertainty": (np.array([one.input_uncertainty for one in terms]), "1", "standard uncertainty of the input, in input_units", ROLE),
        "input_units": (np.array([one.input_unit.text if one.input_unit else "" for one in terms]), "1", "SI unit of the input", "units"),
        "standard_uncertainty": (np.array([one.standard for one in terms]), text, "standard uncertainty that the term contributes", ROLE),
        "bound": (np.array([one.bound for one in terms]), text, "what the term contributes at most; without bounds two standard uncertainties", ROLE),
        "share": (shares, "1", "share of the variance; correlated terms share what they have together", ROLE),
    }  # fmt: skip
    found = {name: ((TERM,), values, about(units, words, role)) for name, (values, units, words, role) in along.items()}
    for name, other in (
        ("sensitivity", "sensitivity_units"),
        ("sensitivity_doubt", "sensitivity_units"),
        ("input_uncertainty", "input_units"),
    ):
        found[name][2]["comment"] = f"in the unit that {other} names"
    kinds = np.array([KINDS.index(one.kind) for one in terms], np.int8)
    found["term_kind"] = ((TERM,), kinds, about("1", "whether it is of the march or of the model", "flag") | flags(dict(enumerate(KINDS))))  # fmt: skip
    return found | {name: ((), np.float64(one), about(text, words, ROLE)) for name, (one, words) in scalars.items()}


def _levels(found: numerical.Marched, unit: Unit) -> dict[str, Any]:
    """Return the run's own level and the finer ones, and what they tell."""
    levels, text = found.levels, unit.text
    orders = observed_orders(found.values, levels.values)
    return {
        levels.varied.name: ((LEVEL,), levels.values, about(levels.varied.units, levels.varied.said, ROLE)),
        "level_value": ((LEVEL,), found.values, about(text, "the number in each level; the first is the run's own", ROLE)),
        "observed_order": ((LEVEL,), orders, about("1", "order by a level and its neighbours", ROLE) | {"formal_order": levels.formal}),
        "level_verdict": ((), np.int8(found.told.verdict), about("1", "what the levels tell", "flag") | flags(dict(enumerate(VERDICTS)))),
        "run_digest": ((LEVEL,), np.array(found.digests), about("1", "content digest of the level's run", "digest")),
        "run_outcome": ((), np.array(str(found.run.attrs["run_outcome"])), about("1", "outcome of the run", "outcome")),
    }  # fmt: skip


def _per(unit: Unit, by: Unit) -> str:
    """Spell the number's unit over that of an input."""
    return spell(unit.dimension / by.dimension).text if unit.factor == 1 else quotient(unit.text, by.text)


def _of_draws(found: Drawn, unit: Unit, coverage: float) -> dict[str, Any]:
    """Return what draws tell, as variables."""
    scalars = {
        "monte_carlo_mean": (found.mean, "mean of the draws"),
        "monte_carlo_standard_uncertainty": (found.standard, "standard deviation of the draws of inputs; tables, discrepancies and declared terms are added to each as normal"),
        "monte_carlo_standard_uncertainty_doubt": (found.standard_doubt, "how well that is known from so many draws: a standard uncertainty, by parts of them"),
        "monte_carlo_end_doubt": (found.ends_doubt, "how well the symmetric interval's ends are known from so many draws: a standard uncertainty, by parts of them"),
    }  # fmt: skip
    intervals = {
        "monte_carlo_shortest": (found.shortest, "shortest interval that holds the part `coverage` of the draws"),
        "monte_carlo_symmetric": (
            found.symmetric,
            "interval that holds the part `coverage` of the draws, with as many below as above it",
        ),
    }
    told = {name: ((), np.float64(one), about(unit.text, said, ROLE)) for name, (one, said) in scalars.items()}
    return told | {name: ((BOUNDS,), np.array(one), about(unit.text, said, ROLE) | {"coverage": coverage}) for name, (one, said) in intervals.items()}  # fmt: skip

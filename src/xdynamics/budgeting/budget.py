"""The budget of one number: every reason why it may be off, in one table, with totals and a Monte Carlo check."""

from __future__ import annotations

import json
from collections.abc import Sequence
from math import inf, nan
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics.budgeting import numerical, physical
from xdynamics.budgeting.montecarlo import LINEAR, NOT_CHECKED, Drawn, drawn, judged
from xdynamics.budgeting.rounding import rounded
from xdynamics.budgeting.target import Target
from xdynamics.budgeting.term import KINDS, NUMERICAL, PHYSICAL, Declared, Term
from xdynamics.evidence.exhibit import about, exhibit
from xdynamics.evidence.refining.convergence import VERDICTS, observed_orders
from xdynamics.faults import InputError
from xdynamics.model import Model
from xdynamics.model.spread import normal_quantile
from xdynamics.schema import BOUNDS, LEVEL, flags
from xdynamics.sweeping.designs import DECLARED, Draws
from xdynamics.sweeping.surveying import quotient
from xdynamics.sweeping.sweep import plain
from xdynamics.units import Unit, parse_quantity, spell

if TYPE_CHECKING:
    import xarray as xr

TERM = "term"
ROLE = "budget"
COVERAGE = 0.95
LEAST_DRAWS, FIRST_DRAWS, MOST_DRAWS = 100, 4096, 1 << 22


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
    _check(draws, seed, coverage)
    target = Target.of(model, quantity, at, event, occurrence, side)
    asked = {name: plain(name, one) for name, one in settings.items() if one is not None}
    found = numerical.marched(model, target, asked, seed)
    unit = target.units(found.run)
    declared = [one.term(target, unit) for one in terms]
    known = [
        *found.terms, *physical.inputs(model, target, asked), *physical.tables(model, target, asked, found.value, seed),
        *physical.discrepancy(model, target, unit), *declared,
    ]  # fmt: skip
    names = [one.name for one in known]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise InputError(f"the budget has two terms '{twice[0]}'; give the declared one another name")
    variables = _table(model, target, unit, found.value, known) | _levels(found, unit)
    more: dict[str, Any] = {"coverage": coverage, "seed": seed, "draws": draws}
    if draws or until_uncertainty is not None:
        monte_carlo, draws = _drawn(
            model,
            target,
            asked,
            max(draws, FIRST_DRAWS) if until_uncertainty else draws,
            seed,
            coverage,
            _wanted(until_uncertainty, unit, target),
        )
        more["draws"] = draws
        linear = float(np.sqrt(physical.covariance(model, _own(known)).sum()))
        variables |= _of_draws(monte_carlo, unit, coverage)
        verdict, apart = judged(found.value, linear, monte_carlo, coverage)
        more["linear_apart"] = apart
    else:
        verdict = NOT_CHECKED
    variables["linear_verdict"] = ((), np.int8(verdict), about("1", "whether the linear budget is adequate, by JCGM 101:2008, 8", "flag") | flags(dict(enumerate(LINEAR))))  # fmt: skip
    variables["model_toml"] = ((), np.array(model.to_toml()), about("1", "the whole model as TOML", "model"))
    total, bound = float(variables["total_rss"][1]), float(variables["numerical_bound"][1])
    more |= {
        "quantity": quantity, "of": target.said, "event": target.event, "occurrence": occurrence, "side": side,
        "asked": json.dumps(asked, sort_keys=True), "model_digest": model.digest,
        "solver_method": str(found.run.attrs["solver_method"]), "result": rounded(found.value, total, bound, unit.text),
    } | ({"at": target.at} if target.at is not None else {})  # fmt: skip
    return exhibit("budget", f"error budget of {model.name}: {target.said}", found.digests, variables, more)


def _check(draws: Any, seed: Any, coverage: Any) -> None:
    if isinstance(draws, bool) or not isinstance(draws, int) or not (draws == 0 or draws >= LEAST_DRAWS):
        raise InputError(f"draws is {draws!r}, needs 0 for none, or a whole number from {LEAST_DRAWS} on")
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise InputError(f"seed is {seed!r}, needs a non-negative whole number")
    if isinstance(coverage, bool) or not isinstance(coverage, int | float) or not 0.0 < coverage < 1.0:
        raise InputError(f"coverage is {coverage!r}, needs a number between 0 and 1, like 0.95")


def _own(terms: Sequence[Term]) -> list[Term]:
    """Return the terms that are drawn: those of inputs."""
    return [one for one in terms if one.kind == PHYSICAL and one.input_unit is not None]


def _table(model: Model, target: Target, unit: Unit, value: float, terms: list[Term]) -> dict[str, Any]:
    """Return the terms as variables, and the totals."""
    parts = {kind: [one for one in terms if one.kind == kind] for kind in KINDS}
    covariance = physical.covariance(model, terms)
    variance = {NUMERICAL: sum(one.standard**2 for one in parts[NUMERICAL]), PHYSICAL: float(physical.covariance(model, parts[PHYSICAL]).sum())}  # fmt: skip
    total = variance[NUMERICAL] + variance[PHYSICAL]
    shares = covariance.sum(axis=1) / total if total > 0.0 else np.zeros(len(terms))
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
        "sensitivity_units": (np.array(units), "1", "unit of the sensitivity: the number's, per SI unit of the input", "units"),
        "input_uncertainty": (np.array([one.input_uncertainty for one in terms]), "1", "standard uncertainty of the input, in input_units", ROLE),
        "input_units": (np.array([one.input_unit.text if one.input_unit else "" for one in terms]), "1", "SI unit of the input", "units"),
        "standard_uncertainty": (np.array([one.standard for one in terms]), text, "standard uncertainty that the term contributes", ROLE),
        "bound": (np.array([one.bound for one in terms]), text, "what the term contributes at most; without bounds two standard uncertainties", ROLE),
        "share": (shares, "1", "share of the variance; correlated terms share what they have together", ROLE),
    }  # fmt: skip
    found = {name: ((TERM,), values, about(units, words, role)) for name, (values, units, words, role) in along.items()}
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


def _wanted(told: str | None, unit: Unit, target: Target) -> float:
    """Return which standard uncertainty the intervals' ends are to have; infinite where nothing is said."""
    if told is None:
        return inf
    size, at, part = str(told).partition(" at ")
    share = part.strip().removesuffix("%").strip()
    try:
        level, quantity = float(share) / 100.0 if at else COVERAGE, parse_quantity(size)
    except ValueError:
        level, quantity = nan, parse_quantity(size)
    if quantity.unit.dimension != unit.dimension or not quantity.value > 0 or not 0.0 < level < 1.0:
        raise InputError(
            f"until_uncertainty is {told!r}, needs a positive size of {target.said}, like '1 {unit.text} at 95 %'"
        )
    return quantity.si / float(unit.factor) / float(normal_quantile(np.array([(1.0 + level) / 2.0]))[0])


def _drawn(model: Model, target: Target, asked: dict[str, Any], draws: int, seed: int, coverage: float, wanted: float) -> tuple[Drawn, int]:  # fmt: skip
    """Draw until the intervals' ends are known as well as is wanted; return what came, and how many it took."""
    while True:
        found = drawn(_values(model, target, asked, draws, seed), coverage)
        if found.ends_doubt <= wanted:
            return found, draws
        if draws >= MOST_DRAWS:
            raise InputError(f"{draws} draws leave the ends of the interval uncertain by {found.ends_doubt:.3g}, and {wanted:.3g} is wanted; ask for less")  # fmt: skip
        draws *= 2


def _values(model: Model, target: Target, asked: dict[str, Any], draws: int, seed: int) -> Any:
    """March as many runs, each with its inputs drawn from what the model declares."""
    names = [physical.named(model, name) for name in model.uncertain]
    if not names:
        raise InputError("nothing in the model has an uncertainty to draw from; give parameters or initial values one")
    found = target.in_many(model, {"draw": Draws(draws, names, design=DECLARED, seed=seed)}, asked)
    values = target.values(found.compute())
    if missing := int(np.count_nonzero(~np.isfinite(values))):
        raise InputError(f"{target.said} is not there in {missing} of {draws} draws: the inputs are too uncertain for it to be one number")  # fmt: skip
    return values


def _of_draws(found: Drawn, unit: Unit, coverage: float) -> dict[str, Any]:
    """Return what draws tell, as variables."""
    scalars = {
        "monte_carlo_mean": (found.mean, "mean of the draws"),
        "monte_carlo_standard_uncertainty": (found.standard, "standard deviation of the draws"),
        "monte_carlo_standard_uncertainty_doubt": (found.standard_doubt, "standard uncertainty of that, being of so many draws"),
        "monte_carlo_end_doubt": (found.ends_doubt, "standard uncertainty of the intervals' ends, being of so many draws"),
    }  # fmt: skip
    intervals = {
        "monte_carlo_shortest": (found.shortest, "shortest interval that holds that part of the draws"),
        "monte_carlo_symmetric": (found.symmetric, "interval with as many draws below as above it"),
    }
    told = {name: ((), np.float64(one), about(unit.text, said, ROLE)) for name, (one, said) in scalars.items()}
    return told | {name: ((BOUNDS,), np.array(one), about(unit.text, said, ROLE) | {"coverage": coverage}) for name, (one, said) in intervals.items()}  # fmt: skip

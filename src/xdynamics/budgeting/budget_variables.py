"""Terms, levels and draws of a budget as variables of its Dataset."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.budgeting import physical
from xdynamics.budgeting.measurand import Target
from xdynamics.budgeting.montecarlo import DrawStatistics
from xdynamics.budgeting.numerical import LevelComparison
from xdynamics.budgeting.own_run import OwnRun
from xdynamics.budgeting.term import KINDS, NUMERICAL, PHYSICAL, Term
from xdynamics.evidence.evidence_dataset import attrs_of
from xdynamics.evidence.refining.convergence import observed_orders
from xdynamics.evidence.refining.judgements import VERDICTS
from xdynamics.evidence.refining.levels import STEPS
from xdynamics.model import Model
from xdynamics.schema import BOUNDS, LEVEL, flag_attributes
from xdynamics.units import BASE, Unit, quotient

TERM = "term"
ROLE = "budget"
CANCELLED = 1e-12  # relative to the variances; a smaller total counts as zero, since terms cancel

TermColumn = tuple[NDArray[Any], str, str, str]  # values along the terms, their unit, words, role
UNITS_BY_TERM = {
    "sensitivity": "sensitivity_units",
    "sensitivity_doubt": "sensitivity_units",
    "input_uncertainty": "input_units",
}


def term_variables(model: Model, target: Target, unit: Unit, value: float, terms: list[Term]) -> dict[str, Any]:
    """Return the terms and the totals as variables."""
    variance = {
        NUMERICAL: sum(entry.standard**2 for entry in _of_kind(terms, NUMERICAL)),
        PHYSICAL: physical.combined_variance(model, _of_kind(terms, PHYSICAL)),
    }
    total = variance[NUMERICAL] + variance[PHYSICAL]
    shares = (
        _term_shares(physical.covariance(model, terms), total) if np.isfinite(total) else np.full(len(terms), np.nan)
    )
    scalars = {"value": (value, f"{target.description}, the run's own")} | _total_scalars(terms, variance)
    term_columns = _input_columns(terms, unit) | _contributions(terms, unit.text)
    term_columns["share"] = (
        shares,
        "1",
        "share of the variance; correlated terms share what they have together; nan where a term is unknown",
        ROLE,
    )
    variables = {
        name: ((TERM,), values, attrs_of(units, words, role))
        for name, (values, units, words, role) in term_columns.items()
    }
    for name, units_name in UNITS_BY_TERM.items():
        variables[name][2]["comment"] = f"in the unit that {units_name} names"
    kinds = np.array([KINDS.index(entry.kind) for entry in terms], np.int8)
    of_kinds = attrs_of("1", "whether it is of the march or of the model", "flag") | flag_attributes(
        dict(enumerate(KINDS))
    )
    variables["term_kind"] = ((TERM,), kinds, of_kinds)
    return variables | {
        name: ((), np.float64(number), attrs_of(unit.text, words, ROLE)) for name, (number, words) in scalars.items()
    }


def _term_shares(covariance: NDArray[np.float64], total: float) -> NDArray[np.float64]:
    """Return the part of each term in the variance; 0 where the terms cancel each other."""
    cancelled = total <= CANCELLED * float(np.trace(covariance))
    return np.zeros(len(covariance)) if cancelled else covariance.sum(axis=1) / total


def _of_kind(terms: list[Term], kind: str) -> list[Term]:
    return [term for term in terms if term.kind == kind]


def _total_scalars(terms: list[Term], variance: Mapping[str, float]) -> dict[str, tuple[float, str]]:
    """Return sums of bounds and roots of sums of squares, by kind and together, each with its words."""
    numerical_terms, physical_terms = _of_kind(terms, NUMERICAL), _of_kind(terms, PHYSICAL)
    return {
        "numerical_bound": (sum(term.bound for term in numerical_terms), "sum of the numerical terms' bounds"),
        "physical_bound": (sum(term.bound for term in physical_terms), "sum of the physical terms' bounds"),
        "numerical_rss": (np.sqrt(variance[NUMERICAL]), "root of the sum of squares of the numerical terms"),
        "physical_rss": (
            np.sqrt(variance[PHYSICAL]),
            "standard uncertainty by the physical terms, with their correlations",
        ),
        "physical_rss_doubt": (
            _rss_doubt(physical_terms, variance[PHYSICAL]),
            "uncertainty of physical_rss from terms that are known by random draws",
        ),
        "total_rss": (np.sqrt(variance[NUMERICAL] + variance[PHYSICAL]), "standard uncertainty by all terms"),
    }


def _input_columns(terms: list[Term], unit: Unit) -> dict[str, TermColumn]:
    """Return what each term is of: its name, its rule, its input, and how the number changes with that."""
    sensitivities = [_unit_ratio(unit, term.input_unit) if term.input_unit else "" for term in terms]
    inputs = [term.input_unit.text if term.input_unit else "" for term in terms]
    return {
        "term_name": (np.array([term.name for term in terms]), "1", "source of the uncertainty", "name"),
        "term_rule": (
            np.array([term.rule for term in terms]),
            "1",
            "how the contribution of the term was found",
            "rule",
        ),
        "sensitivity": (
            np.array([term.sensitivity for term in terms]),
            "1",
            "change of the number with the input, in sensitivity_units; nan where there is no input",
            ROLE,
        ),
        "sensitivity_doubt": (
            np.array([term.sensitivity_doubt for term in terms]),
            "1",
            "uncertainty of the sensitivity: its change with the spacing of the finite differences",
            ROLE,
        ),
        "sensitivity_units": (
            np.array(sensitivities),
            "1",
            "unit of the sensitivity: the number's, per SI unit of the input",
            "units",
        ),
        "input_uncertainty": (
            np.array([term.input_uncertainty for term in terms]),
            "1",
            "standard uncertainty of the input, in input_units",
            ROLE,
        ),
        "input_units": (np.array(inputs), "1", "SI unit of the input", "units"),
    }


def _contributions(terms: list[Term], units: str) -> dict[str, TermColumn]:
    """Return what each term contributes, in the number's unit."""
    return {
        "standard_uncertainty": (
            np.array([term.standard for term in terms]),
            units,
            "standard uncertainty that the term contributes",
            ROLE,
        ),
        "standard_uncertainty_doubt": (
            np.array([term.standard_doubt for term in terms]),
            units,
            (
                "uncertainty of the standard uncertainty: from the number of draws, or from slopes that the draws do not"
                " fully confirm"
            ),
            ROLE,
        ),
        "bound": (
            np.array([term.bound for term in terms]),
            units,
            "what the term contributes at most; without bounds two standard uncertainties",
            ROLE,
        ),
    }


def _rss_doubt(terms: list[Term], variance: float) -> float:
    """Return the uncertainty of a root of a sum of squares some of whose terms were drawn."""
    weighted_doubts = sum((term.standard * term.standard_doubt) ** 2 for term in terms)
    return float(np.sqrt(weighted_doubts / variance)) if variance > 0.0 else 0.0


def level_variables(compared: LevelComparison, own_run: OwnRun, unit: Unit) -> dict[str, Any]:
    """Return the run's own level and the finer ones, and their verdict, as variables."""
    levels, text = compared.levels, unit.text
    orders = observed_orders(compared.values, levels.values)
    level_units = own_run.step_units if levels.varied == STEPS else levels.varied.units
    return {
        levels.varied.name: ((LEVEL,), levels.values, attrs_of(level_units, levels.varied.long_name, ROLE)),
        "level_value": (
            (LEVEL,),
            compared.values,
            attrs_of(text, "the number in each level; the first is the run's own", ROLE),
        ),
        "observed_order": (
            (LEVEL,),
            orders,
            attrs_of("1", "observed order, from the level and its two neighbours", ROLE)
            | {"formal_order": levels.formal},
        ),
        "level_verdict": (
            (),
            np.int8(compared.judgement.verdict),
            attrs_of("1", "verdict on the convergence of the number", "flag")
            | flag_attributes(dict(enumerate(VERDICTS))),
        ),
        "run_digest": (
            (LEVEL,),
            np.array(compared.digests),
            attrs_of("1", "content digest of the level's run", "digest"),
        ),
    }


def late_variables(late_values: Mapping[str, Any], units: str, second: str) -> dict[str, Any]:
    """Return as variables what is known of a budget only once it is computed, and is an attribute then too."""
    words = {
        "result": (
            "1",
            "the number as it is written, with its expanded uncertainty or the interval of its draws",
            "result",
        ),
        "linear_apart": (units, "distance of the ends of the linear interval from those of the draws' interval", ROLE),
        "draws_needed": (
            "1",
            "number of draws needed to decide whether the linear budget is adequate; nan if it is decided",
            ROLE,
        ),
        "extreme_time": (second, "when the extreme was", "time"),
        "extreme_rule": ("1", "how the extreme was found", "rule"),
    }
    return {name: ((), np.array(value), attrs_of(*words[name])) for name, value in late_values.items()}


def _unit_ratio(unit: Unit, divisor: Unit) -> str:
    """Spell the number's unit over that of an input, with the names that both were declared with.

    Base units come in their own order: for a time over a speed it is ``m-1 s2``.
    """
    names = {factor.rstrip("-0123456789") for text in (unit.text, divisor.text) for factor in text.split()}
    if names <= {*BASE}:
        return str(unit.dimension / divisor.dimension).split(" (")[0]
    return quotient(unit.text, divisor.text)


def draw_variables(draws: DrawStatistics, unit: Unit, coverage: float) -> dict[str, Any]:
    """Return the statistics of draws as variables."""
    scalars = {
        "monte_carlo_mean": (draws.mean, "mean of the draws"),
        "monte_carlo_standard_uncertainty": (
            draws.standard,
            (
                "standard deviation of the draws of inputs; tables, discrepancies and declared terms are added to each"
                " as normal"
            ),
        ),
        "monte_carlo_standard_uncertainty_doubt": (
            draws.standard_doubt,
            "standard uncertainty of monte_carlo_standard_uncertainty, from parts of the draws",
        ),
        "monte_carlo_end_doubt": (
            draws.ends_doubt,
            ("standard uncertainty of the ends of monte_carlo_symmetric, by order statistics"),
        ),
    }
    intervals = {
        "monte_carlo_shortest": (draws.shortest, "shortest interval that holds the part `coverage` of the draws"),
        "monte_carlo_symmetric": (
            draws.symmetric,
            "interval that holds the part `coverage` of the draws, with as many below as above it",
        ),
    }
    variables = {
        name: ((), np.float64(value), attrs_of(unit.text, description, ROLE))
        for name, (value, description) in scalars.items()
    }
    return variables | {
        name: ((BOUNDS,), np.array(value), attrs_of(unit.text, description, ROLE) | {"coverage": coverage})
        for name, (value, description) in intervals.items()
    }

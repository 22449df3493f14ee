"""The Dataset of an error budget: its request, its sources of error, and its variables of terms and draws.

The request states the number, the sources of error and the draws. Terms, levels and draws become variables, and the
result is stated in words.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import nan
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.budgeting import physical
from xdynamics.budgeting.budget_summary import drawn_interval, rounded_result
from xdynamics.budgeting.measurand import Measurand, OwnRun, Target
from xdynamics.budgeting.montecarlo import (
    LINEAR,
    NOT_ADEQUATE,
    NOT_CHECKED,
    DrawStatistics,
    Propagation,
    draws_needed,
    judge_linear,
)
from xdynamics.budgeting.numerical import Estimate, LevelComparison, numerical_sources
from xdynamics.budgeting.physical import discrepancy_source, input_source, table_sources
from xdynamics.budgeting.proven_bounds import ProvenBounds, proven_variables
from xdynamics.budgeting.term import (
    COMPARED,
    KINDS,
    NUMBER,
    NUMERICAL,
    OWN,
    PHYSICAL,
    Declared,
    ErrorSource,
    Term,
    names_left_out,
    stated_source,
)
from xdynamics.evidence.evidence_dataset import attrs_of, evidence_dataset
from xdynamics.evidence.kept_results import Keep
from xdynamics.evidence.refining.convergence import VERDICTS, observed_orders
from xdynamics.evidence.refining.levels import STEPS
from xdynamics.faults import InputError
from xdynamics.model import Model, check_model
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.schema import BOUNDS, LEVEL, PROVEN, flag_attributes
from xdynamics.sweeping.sweep import json_value
from xdynamics.units import BASE, Unit, parse_unit, quotient

if TYPE_CHECKING:
    import xarray as xr

COVERAGE = 0.95
MIN_DRAWS = 100


@dataclass(frozen=True)
class BudgetRequest:
    """The arguments of a budget, checked.

    Attributes
    ----------
    measurand : Measurand
    declared : tuple of Declared
    draws : int
    coverage : float
    digits : int
    inadequate_fit : bool
    left_out : tuple of str
        Names of terms.
    proven : bool
        Whether the number is compared with proven bounds.
    """

    measurand: Measurand
    declared: tuple[Declared, ...]
    draws: int
    coverage: float
    digits: int
    inadequate_fit: bool
    left_out: tuple[str, ...] = ()
    proven: bool = False

    @property
    def target(self) -> Target:
        """The number that is taken from the run."""
        return self.measurand.target

    @property
    def words(self) -> tuple[Any, ...]:
        """Everything that the budget depends on, for the name of its task."""
        request_words = (
            self.declared,
            self.draws,
            self.measurand.seed,
            self.coverage,
            self.digits,
            self.inadequate_fit,
            self.left_out,
            self.proven,
        )
        return (*self.measurand.inputs, *request_words)

    @property
    def inputs(self) -> list[str]:
        """Uncertain parameters and initial values that are not left out."""
        return [name for name in self.measurand.model.uncertain if name not in self.left_out]

    @cached_property
    def sources(self) -> list[ErrorSource]:
        """The sources of error of the budget: of the march, of the model, and declared ones."""
        measurand = self.measurand
        sources = [
            *numerical_sources(measurand),
            *([input_source(measurand, self.inputs)] if self.inputs else []),
            *table_sources(measurand),
            *discrepancy_source(measurand),
            *(stated_source(measurand, term.name, partial(term.term, measurand.target)) for term in self.declared),
        ]
        return [source for source in sources if not {*source.names} <= {*self.left_out}]

    @property
    def names(self) -> list[str]:
        """The names of all terms.

        Raises
        ------
        InputError
            If two have the same name.
        """
        names = [name for source in self.sources for name in source.names]
        if repeated := sorted({name for name in names if names.count(name) > 1}):
            in_model = repeated[0] not in {term.name for term in self.declared}
            remedy = f"rename the model's '{repeated[0]}'" if in_model else "give the declared one another name"
            raise InputError(f"the budget has two terms '{repeated[0]}'; {remedy}")
        return names

    def propagation(self, value: float, terms: Sequence[Term]) -> Propagation:
        """Return the propagation by drawing: inputs of the model, and other physical terms."""
        added_uncertainties = [
            term.standard for term in terms if term.kind == PHYSICAL and term.name not in self.inputs
        ]
        return Propagation(self.measurand, self.inputs, value, added_uncertainties)


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
    only: Any = None,
    without: Any = None,
    proven: bool = False,
    keep: Any = None,
    **settings: Any,
) -> BudgetRequest:
    """Read and check the arguments of `error_budget`.

    Raises
    ------
    InputError
        If one is wrong, the run is not to reach the time, or the model was fitted inadequately.
    """
    check_model(model)
    _check_draw_settings(draws, seed, coverage, digits)
    _check_fit(model, inadequate_fit)
    target = Target.from_arguments(model, quantity, at, event, occurrence, side)
    marched = {name: json_value(name, entry) for name, entry in settings.items() if entry is not None}
    declared = tuple(map(_checked_declared, (terms,) if isinstance(terms, Declared) else terms or ()))
    full_request = BudgetRequest(
        Measurand(model, target, marched, seed, Keep.of(keep)),
        declared,
        draws,
        coverage,
        digits,
        inadequate_fit is True,
        proven=proven is True,
    )
    full_request.measurand.check_time()
    names = full_request.names
    left_out = names_left_out(names, model.shapes, only, without)
    return (
        replace(full_request, left_out=tuple(name for name in names if name in left_out)) if left_out else full_request
    )


def _check_fit(model: Model, inadequate_fit: Any) -> None:
    if model.fit is not None and not model.fit.adequate and inadequate_fit is not True:
        raise InputError(
            f"the model was fitted to '{model.fit.data}', and the fit is not adequate: {model.fit.description}. Fit it"
            " again, from other starts or with another model, or ask for the budget all the same: inadequate_fit=True"
            " (--inadequate-fit)"
        )


def _check_draw_settings(draws: Any, seed: Any, coverage: Any, digits: Any) -> None:
    if isinstance(digits, bool) or digits not in (1, 2):
        raise InputError(f"digits is {digits!r}; there are 1, 2")
    if isinstance(draws, bool) or not isinstance(draws, int) or not (draws == 0 or draws >= MIN_DRAWS):
        raise InputError(f"draws is {draws!r}, needs 0 for none, or a whole number from {MIN_DRAWS} on")
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise InputError(f"seed is {seed!r}, needs a non-negative whole number")
    if isinstance(coverage, bool) or not isinstance(coverage, int | float) or not 0.0 < coverage < 1.0:
        raise InputError(f"coverage is {coverage!r}, needs a number between 0 and 1, like 0.95")


def _checked_declared(term: Any) -> Declared:
    if not isinstance(term, Declared):
        raise InputError(f"terms has {str(term)[:60]!r}, needs Declared(name, quantity, standard, at=…)")
    return term


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
    """Return name, rule and input of each term, and the sensitivity of the number to the input."""
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
    """Return the contribution of each term, in the number's unit."""
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
    """Return as variables the results that are known only after a budget is computed; they become attributes then."""
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


@dataclass(frozen=True)
class BudgetParts:
    """The results from which a budget is assembled.

    Attributes
    ----------
    own_run : OwnRun
        The run that the number is of.
    number : Estimate
    compared : Compared, optional
        The number in finer levels; None where truncation is left out.
    terms : list of Term
    proven : ProvenBounds, optional
        Of the number.
    """

    own_run: OwnRun
    number: Estimate
    compared: LevelComparison | None
    terms: list[Term]
    proven: ProvenBounds | None = None

    @classmethod
    def from_results(cls, parts: Mapping[Any, Any]) -> BudgetParts:
        """Return the parts from the results of a budget's tasks; terms have tuples of their names as keys."""
        terms = [term for name, row in parts.items() if isinstance(name, tuple) for term in row]
        return cls(parts[OWN], parts[NUMBER], parts.get(COMPARED), terms, parts.get(PROVEN))


def budget_dataset(request: BudgetRequest, parts: BudgetParts, monte_carlo: DrawStatistics | None) -> xr.Dataset:
    """Return the Dataset of a budget from its request, its parts and its draws."""
    model, target, own_run, value = request.measurand.model, request.target, parts.own_run, parts.number.value
    unit, compared = parse_unit(own_run.units), parts.compared
    variables = term_variables(model, target, unit, value, parts.terms)
    variables |= {} if compared is None else level_variables(compared, own_run, unit)
    variables |= {} if parts.proven is None else proven_variables(parts.proven, value, unit.text)
    variables["run_outcome"] = ((), np.array(own_run.outcome), attrs_of("1", "outcome of the run", "outcome"))
    variables["run_contradiction"] = (
        (),
        np.array(own_run.contradiction),
        attrs_of("1", "what contradicts itself in the run's record, in words; empty if nothing does", "outcome"),
    )
    late_values: dict[str, Any] = {}
    verdict, bound = NOT_CHECKED, float(variables["numerical_bound"][1])
    if monte_carlo is not None:
        variables |= draw_variables(monte_carlo, unit, request.coverage)
        verdict, late_values = _linear_verdict(request, value, float(variables["physical_rss"][1]), monte_carlo)
    variables["linear_verdict"] = (
        (),
        np.int8(verdict),
        attrs_of("1", "whether the linear budget is adequate, by JCGM 101:2008, 8", "flag")
        | flag_attributes(dict(enumerate(LINEAR))),
    )
    variables["model_toml"] = ((), np.array(model.to_toml()), attrs_of("1", "the whole model as TOML", "model"))
    choice = _choice_text(request, parts.terms)
    result_text = rounded_result(value, float(variables["total_rss"][1]), bound, unit.text, f"k = 2{choice}")
    if monte_carlo is not None and verdict == NOT_ADEQUATE:  # the number need not lie in the middle of what was drawn
        low, high = monte_carlo.symmetric
        origin = f"{100.0 * request.coverage:.4g} % of the draws{choice}"
        result_text = drawn_interval(low, high, monte_carlo.ends_doubt, bound, unit.text, origin)
    late_values |= {"result": result_text}
    if own_run.extreme_rule is not None:
        late_values |= {"extreme_rule": own_run.extreme_rule, "extreme_time": own_run.extreme_time}
    variables |= late_variables(late_values, unit.text, target.second)
    attributes = {name: value for name, value in late_values.items() if value == value}
    title = f"error budget of {model.name}: {target.description}"
    digests = (parts.number.digest,) if compared is None else compared.digests
    return evidence_dataset(
        "budget", title, digests, variables, _budget_attributes(request, own_run) | attributes, shapes=model.shapes
    )


def _choice_text(request: BudgetRequest, terms: list[Term]) -> str:
    """Describe which terms the result is of, where some are left out."""
    if not request.left_out:
        return ""
    names_included = len(terms) < len(request.left_out)
    names = [term.name for term in terms] if names_included else request.left_out
    return f", {' and '.join(names)} alone" if names_included else f", without {' and '.join(names)}"


def _budget_attributes(request: BudgetRequest, own_run: OwnRun) -> dict[str, Any]:
    """Return the arguments of a budget as attributes."""
    target = request.target
    return (
        {"coverage": request.coverage, "seed": request.measurand.seed, "draws": request.draws}
        | ({"digits": request.digits} if request.draws else {})
        | {
            "inadequate_fit": int(request.inadequate_fit),
            "quantity": target.quantity,
            "of": target.description,
            "event": target.event,
            "occurrence": target.occurrence,
            "side": target.side,
            "asked": json.dumps(request.measurand.settings, sort_keys=True),
            "model_digest": request.measurand.model.digest,
            "time_units": target.second,
            "solver_method": own_run.method,
        }
        | ({"at": target.at} if target.at is not None else {})
        | ({PROVEN: 1} if request.proven else {})
        | ({"left_out": ", ".join(request.left_out)} if request.left_out else {})
    )


def _linear_verdict(
    request: BudgetRequest, value: float, physical_rss: float, monte_carlo: DrawStatistics
) -> tuple[int, dict[str, Any]]:
    """Judge the linear budget by the draws; return the verdict, and by how much both are apart."""
    verdict, distance = judge_linear(value, physical_rss, monte_carlo, request.coverage, request.digits)
    draw_count = nan
    if verdict == NOT_CHECKED:
        draw_count = draws_needed(distance, monte_carlo, request.draws, request.coverage, request.digits)
    return verdict, {"linear_apart": distance, "draws_needed": draw_count}

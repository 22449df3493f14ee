"""The Dataset of an error budget: its variables, its result in words, and what it was asked for."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from math import nan
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics.budgeting.budget_request import BudgetRequest
from xdynamics.budgeting.budget_variables import draw_variables, late_variables, level_variables, term_variables
from xdynamics.budgeting.montecarlo import LINEAR, NOT_ADEQUATE, NOT_CHECKED, DrawStatistics, draws_needed, judge_linear
from xdynamics.budgeting.numerical import Estimate, LevelComparison
from xdynamics.budgeting.own_run import OwnRun
from xdynamics.budgeting.proven_bounds import ProvenBounds, proven_variables
from xdynamics.budgeting.rounding import drawn_interval, rounded_result
from xdynamics.budgeting.sources import COMPARED, NUMBER, OWN
from xdynamics.budgeting.term import Term
from xdynamics.evidence.evidence_dataset import attrs_of, evidence_dataset
from xdynamics.schema import PROVEN, flag_attributes
from xdynamics.units import parse_unit

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True)
class BudgetParts:
    """What a budget is put together from.

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
        """Return it from the results of its tasks; those of terms are under tuples of their names."""
        terms = [term for name, row in parts.items() if isinstance(name, tuple) for term in row]
        return cls(parts[OWN], parts[NUMBER], parts.get(COMPARED), terms, parts.get(PROVEN))


def budget_dataset(request: BudgetRequest, parts: BudgetParts, monte_carlo: DrawStatistics | None) -> xr.Dataset:
    """Put a budget together."""
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
    """Return what a budget was asked for."""
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

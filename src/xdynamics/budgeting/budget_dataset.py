"""The Dataset of an error budget: its variables, its result in words, and what it was asked for."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from math import nan
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics.budgeting.budget_request import BudgetRequest
from xdynamics.budgeting.budget_variables import draws_as, later_as, levels_as, terms_as
from xdynamics.budgeting.montecarlo import LINEAR, NOT_ADEQUATE, NOT_CHECKED, Drawn, draws_needed, judged
from xdynamics.budgeting.numerical import Compared, Estimate
from xdynamics.budgeting.own_run import OwnRun
from xdynamics.budgeting.proven_bounds import ProvenBounds, proven_as
from xdynamics.budgeting.rounding import drawn_interval, rounded
from xdynamics.budgeting.sources import COMPARED, NUMBER, OWN
from xdynamics.budgeting.term import Term
from xdynamics.evidence.evidence_dataset import about, exhibit
from xdynamics.schema import PROVEN, flags
from xdynamics.units import parse_unit

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True)
class Budgeted:
    """What a budget is put together from.

    Attributes
    ----------
    own : OwnRun
        The run that the number is of.
    number : Estimate
    compared : Compared, optional
        The number in finer levels; None where truncation is left out.
    terms : list of Term
    proven : ProvenBounds, optional
        Of the number.
    """

    own: OwnRun
    number: Estimate
    compared: Compared | None
    terms: list[Term]
    proven: ProvenBounds | None = None

    @classmethod
    def of(cls, parts: Mapping[Any, Any]) -> Budgeted:
        """Return it from the results of its tasks; those of terms are under tuples of their names."""
        terms = [term for name, row in parts.items() if isinstance(name, tuple) for term in row]
        return cls(parts[OWN], parts[NUMBER], parts.get(COMPARED), terms, parts.get(PROVEN))


def budget_dataset(request: BudgetRequest, budgeted: Budgeted, monte_carlo: Drawn | None) -> xr.Dataset:
    """Put a budget together."""
    model, target, own, value = request.measurand.model, request.target, budgeted.own, budgeted.number.value
    unit, compared = parse_unit(own.units), budgeted.compared
    variables = terms_as(model, target, unit, value, budgeted.terms)
    variables |= {} if compared is None else levels_as(compared, own, unit)
    variables |= {} if budgeted.proven is None else proven_as(budgeted.proven, value, unit.text)
    variables["run_outcome"] = (
        (),
        np.array(own.outcome),
        about("1", "outcome of the run", "outcome"),
    )
    variables["run_contradiction"] = (
        (),
        np.array(own.contradiction),
        about("1", "what contradicts itself in the run's record, in words; empty if nothing does", "outcome"),
    )
    later: dict[str, Any] = {}
    verdict, bound = NOT_CHECKED, float(variables["numerical_bound"][1])
    if monte_carlo is not None:
        variables |= draws_as(monte_carlo, unit, request.coverage)
        verdict, later = _judged(request, value, float(variables["physical_rss"][1]), monte_carlo)
    variables["linear_verdict"] = (
        (),
        np.int8(verdict),
        about("1", "whether the linear budget is adequate, by JCGM 101:2008, 8", "flag")
        | flags(dict(enumerate(LINEAR))),
    )
    variables["model_toml"] = ((), np.array(model.to_toml()), about("1", "the whole model as TOML", "model"))
    choice = _choice(request, budgeted.terms)
    result = rounded(value, float(variables["total_rss"][1]), bound, unit.text, f"k = 2{choice}")
    if monte_carlo is not None and verdict == NOT_ADEQUATE:  # the number need not lie in the middle of what was drawn
        low, high = monte_carlo.symmetric
        origin = f"{100.0 * request.coverage:.4g} % of the draws{choice}"
        result = drawn_interval(low, high, monte_carlo.ends_doubt, bound, unit.text, origin)
    later |= {"result": result}
    if own.extreme_rule is not None:
        later |= {"extreme_rule": own.extreme_rule, "extreme_time": own.extreme_time}
    variables |= later_as(later, unit.text, target.second)
    attributes = {name: value for name, value in later.items() if value == value}
    title = f"error budget of {model.name}: {target.description}"
    digests = (budgeted.number.digest,) if compared is None else compared.digests
    return exhibit("budget", title, digests, variables, _attributes(request, own) | attributes, shapes=model.shapes)


def _choice(request: BudgetRequest, terms: list[Term]) -> str:
    """Describe which terms the result is of, where some are left out."""
    if not request.left_out:
        return ""
    few = len(terms) < len(request.left_out)
    names = [term.name for term in terms] if few else request.left_out
    return f", {' and '.join(names)} alone" if few else f", without {' and '.join(names)}"


def _attributes(request: BudgetRequest, own: OwnRun) -> dict[str, Any]:
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
            "solver_method": own.method,
        }
        | ({"at": target.at} if target.at is not None else {})
        | ({PROVEN: 1} if request.proven else {})
        | ({"left_out": ", ".join(request.left_out)} if request.left_out else {})
    )


def _judged(
    request: BudgetRequest, value: float, physical_rss: float, monte_carlo: Drawn
) -> tuple[int, dict[str, Any]]:
    """Judge the linear budget by the draws; return the verdict, and by how much both are apart."""
    verdict, distance = judged(value, physical_rss, monte_carlo, request.coverage, request.digits)
    needed = nan
    if verdict == NOT_CHECKED:
        needed = draws_needed(distance, monte_carlo, request.draws, request.coverage, request.digits)
    return verdict, {"linear_apart": distance, "draws_needed": needed}

"""A certificate: one number with all its evidence, which can be reproduced from the certificate alone."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import partial
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics import archive
from xdynamics.archive.store import GIVEN, Given
from xdynamics.budgeting.budget import budget_stage, error_budget
from xdynamics.budgeting.budget_dataset import BudgetRequest, budget_request
from xdynamics.budgeting.budget_summary import draws_needed_text, extreme_lines, rounded_result, same_number, short_size
from xdynamics.budgeting.montecarlo import ADEQUATE, LINEAR, NOT_ADEQUATE
from xdynamics.budgeting.montecarlo import NOT_CHECKED as OPEN
from xdynamics.budgeting.proven_bounds import ProvenBounds
from xdynamics.elementary.arrays import apply_elementary
from xdynamics.evidence.evidence_dataset import (
    FAILED,
    GATE,
    GATES,
    NOT_CHECKED,
    PASSED,
    evidence_dataset,
    gate_variables,
    stated_value,
)
from xdynamics.evidence.refining.convergence import NOT_CONVERGING, verdict_text
from xdynamics.evidence.stage_tasks import Task
from xdynamics.evidence.stages import Stage, compute_datasets
from xdynamics.evidence.validating.ledger import own_ledger, validate
from xdynamics.evidence.validating.ledger_rows import VERDICTS as CASES
from xdynamics.faults import ArchiveError, InputError, numbered_lines
from xdynamics.march.outcomes import GOOD
from xdynamics.march.settings import WAITING
from xdynamics.march.tolerances import NO_FLOOR
from xdynamics.model import Model, check_model
from xdynamics.record.flag_words import in_prose, words_of_flag
from xdynamics.schema import CASE, EVIDENCE, PROVEN
from xdynamics.units import unit_suffix
from xdynamics.units.digits import OF_DOUBT

if TYPE_CHECKING:
    import xarray as xr

CERTIFICATE = "certificate"

RECORD = "record"  # the gate that nothing contradicts itself in the run's record
Write = Callable[[float], str]
DRAWS = 10_000
MAX_NUMERICAL_RATIO = 0.1  # largest ratio of the numerical bound to the physical uncertainty
COMPARED_ATTRIBUTES = (
    "quantity",
    "of",
    "result",
    "event",
    "occurrence",
    "side",
    "asked",
    "coverage",
    "seed",
    "draws",
    "model_digest",
    "solver_method",
    "linear_apart",
    "draws_needed",
    "digits",
    "extreme_rule",
    "extreme_time",
)
COPIED_ATTRIBUTES = ("at", "time_units", "inadequate_fit", PROVEN)
LATE_VARIABLES = ("result", "linear_apart", "draws_needed", "extreme_rule", "extreme_time")  # certificates of old: not


def certify(
    model: Model,
    quantity: str,
    *,
    draws: int = DRAWS,
    seed: int = 0,
    keep: str | Path | None = None,
    compute: bool = True,
    **budget_arguments: Any,
) -> xr.Dataset:
    """Certify one number: its budget, the gates that it must pass, and the validation ledger of its method.

    Parameters
    ----------
    model, quantity, draws, seed
        As in `error_budget`; without uncertainties in the model nothing is drawn.
    keep : str or Path, optional
        A folder in which results of the budget and of the ledger are kept: the same call continues one that was
        interrupted.
    compute : bool
        Whether to march at once. If False, the Dataset has dask arrays, with the tasks of the budget and of the ledger.
    **budget_arguments
        Further arguments of `error_budget` (except declared terms, which no model file holds, and a choice of terms), and settings of
        `simulate`. With ``proven=True`` the bounds that are proven of the number are a gate too.

    Returns
    -------
    xarray.Dataset
        The whole budget; along `gate` `gate_name`, `gate_verdict` (passed, failed, not_checked: too few draws to tell)
        and `gate_reason`, which says how many draws settle it; along `case` the ledger's cases for the method with
        `residual`, `case_bound` and `case_verdict`. `recheck` reproduces it.

    Raises
    ------
    InputError
        As in `error_budget`, or if declared terms are given, or terms are left out.
    """
    check_model(model)
    if "terms" in budget_arguments:
        raise InputError(
            "a certificate is made again from the model alone: write declared terms into its [discrepancy]"
        )
    if refused_keywords := [keyword for keyword in ("only", "without") if budget_arguments.get(keyword) is not None]:
        raise InputError(
            f"a certificate has every term of its number, and {refused_keywords[0]} is given; make a budget of a part"
        )
    draws = draws if model.uncertain else 0
    if not compute:
        request = budget_request(model, quantity, draws=draws, seed=seed, keep=keep, **budget_arguments)
        return _certificate_stage(request).result(compute=False)
    budget = error_budget(model, quantity, draws=draws, seed=seed, keep=keep, **budget_arguments)
    return _certificate_dataset(model, budget, validate([str(budget.attrs["solver_method"])], keep=keep))


def _certificate_stage(request: BudgetRequest) -> Stage:
    """Return a certificate before it is computed."""
    budget = budget_stage(request)
    blank_budget = budget.template()
    ledger = own_ledger([str(blank_budget.attrs["solver_method"])], request.measurand.keep)
    template = _certificate_dataset(request.measurand.model, blank_budget, ledger.template())
    certified = partial(
        _certificate_dataset, request.measurand.model, expected_gates=tuple(template["gate_name"].values.tolist())
    )
    task = Task.of("certificate", certified, (budget.task, ledger.task))
    return Stage(task, lambda: template, (*budget.known_variables, "gate_name"))


def _certificate_dataset(
    model: Model, budget: xr.Dataset, ledger: xr.Dataset, expected_gates: tuple[str, ...] = ()
) -> xr.Dataset:
    """Return a certificate; an expected gate without data to decide it is not checked."""
    gates = _decide_gates(budget, ledger, has_draws=bool(model.uncertain))
    if expected_gates:
        decided = {gate[0]: gate for gate in gates}
        gates = [decided.get(name, (name, NOT_CHECKED, "there is no physical uncertainty")) for name in expected_gates]
    variables: dict[str, Any] = {
        str(name): (entry.dims, entry.values, dict(entry.attrs)) for name, entry in budget.variables.items()
    }
    variables |= gate_variables(gates, "what the number has to pass")
    names = {"residual": "residual", "bound": "case_bound", "verdict": "case_verdict"}
    for name in ("case_name", "case_units", *names):
        variables[names.get(name, name)] = ((CASE,), ledger[name].values, dict(ledger[name].attrs))
    attributes = {key: budget.attrs[key] for key in (*COMPARED_ATTRIBUTES, *COPIED_ATTRIBUTES) if key in budget.attrs}
    title = f"certificate of {model.name}: {budget.attrs['of']}"
    return evidence_dataset(
        CERTIFICATE, title, str(budget.attrs["runs"]).split(), variables, attributes, shapes=model.shapes
    )


def _decide_gates(budget: xr.Dataset, ledger: xr.Dataset, *, has_draws: bool) -> list[tuple[str, str, str]]:
    """Return name, verdict and reason of every gate."""
    words, verdicts = [CASES[case] for case in ledger["verdict"].values.tolist()], budget["level_verdict"]
    convergence = verdicts.attrs["flag_meanings"].split()[int(verdicts)]
    bounds, difference = _bounds_by_term(budget), _last_difference(budget)
    physical, numerical = float(budget["physical_rss"]), float(budget["numerical_bound"])
    linear = LINEAR[int(budget["linear_verdict"])]
    outcome = str(budget["run_outcome"].values)
    contradiction = str(budget["run_contradiction"].values) if "run_contradiction" in budget else ""
    decisions = [
        ("outcome", outcome in GOOD, f"the run ended as '{outcome}'"),
        ("levels", budget.sizes["level"] >= 3, f"{budget.sizes['level']} levels"),
        (
            "convergence",
            int(verdicts) != NOT_CONVERGING and bounds["truncation"] != inf,
            f"verdict on the levels: {in_prose(convergence)}"
            + ("" if bounds["truncation"] != inf else ", of unequal numbers of events"),
        ),
        (
            "interpolation",
            bounds["interpolation"] <= max(difference, bounds["truncation"]),
            _interpolation_reason(bounds["interpolation"], difference, "{:.3g}".format),
        ),
        (
            "ledger",
            "failed" not in words,
            (
                f"{words.count('passed')} cases of the method passed, {words.count('failed')} failed,"
                f" {words.count('refused')} refused"
            ),
        ),
        (RECORD, contradiction == "", contradiction or "nothing in the run's record contradicts its model"),
    ]
    if not physical <= 0.0:  # unknown where nothing is marched yet
        decisions.append(
            (
                "numerical_part",
                numerical <= MAX_NUMERICAL_RATIO * physical,
                _numerical_part_reason(numerical, physical, "{:.3g}".format),
            )
        )
    gates = [(name, PASSED if passes else FAILED, reason) for name, passes, reason in decisions]
    gates += [_proven_gate(budget)] if "proven_interval" in budget else []
    return [*gates, *([_linear_gate(budget, linear)] if has_draws else [])]


def _proven_gate(budget: xr.Dataset) -> tuple[str, str, str]:
    """Return the gate of proven bounds: failed where the number is farther from them than its numerical bound."""
    low, high = map(float, budget["proven_interval"].values)
    bounds = ProvenBounds(low, high, str(budget["proven_text"].item()))
    value, bound = float(budget["value"]), float(budget["numerical_bound"])
    if not bounds.low <= bounds.high:
        return PROVEN, NOT_CHECKED, bounds.text
    error, distance = bounds.error(value), bounds.distance(value)
    verdict = PASSED if error <= bound else FAILED if distance > bound else NOT_CHECKED
    return PROVEN, verdict, f"off by at most {error:.3g}, which is proven, beside a numerical bound of {bound:.3g}"


def _bounds_by_term(budget: xr.Dataset) -> dict[str, float]:
    return dict(zip(budget["term_name"].values.tolist(), budget["bound"].values.tolist(), strict=True))


def _last_difference(budget: xr.Dataset) -> float:
    return float(abs(budget["level_value"][0] - budget["level_value"][1]))


def _interpolation_reason(bound: float, difference: float, write: Write) -> str:
    return f"{write(bound)} beside a difference of {write(difference)} of two levels"


def _numerical_part_reason(bound: float, physical: float, write: Write) -> str:
    return f"numerical bound {write(bound)}, physical standard uncertainty {write(physical)}"


def gate_reasons(certificate: xr.Dataset) -> list[str]:
    """Return the reason of each gate with rounded numbers and units; stored reasons have neither."""
    recorded_reasons: dict[str, str] = dict(
        zip(certificate["gate_name"].values.tolist(), certificate["gate_reason"].values.tolist(), strict=True)
    )
    if "value" not in certificate:  # only gates
        return [*recorded_reasons.values()]
    unit = unit_suffix(str(certificate["value"].attrs["units"]))

    def write_rounded(number: float) -> str:
        return f"{short_size(number, OF_DOUBT)}{unit}"

    rounded_reasons = {
        "interpolation": _interpolation_reason(
            _bounds_by_term(certificate)["interpolation"], _last_difference(certificate), write_rounded
        ),
        "numerical_part": _numerical_part_reason(
            float(certificate["numerical_bound"]), float(certificate["physical_rss"]), write_rounded
        ),
    }
    return [rounded_reasons.get(name, reason) for name, reason in recorded_reasons.items()]


def _linear_gate(budget: xr.Dataset, linear: str) -> tuple[str, str, str]:
    """Return the gate of the linear budget; it is neither passed nor failed where too few draws leave it open."""
    name, statement = "linear_budget", f"the linear budget is {linear.replace('_', ' ')}"
    if linear != LINEAR[OPEN]:
        return name, PASSED if linear == LINEAR[ADEQUATE] else FAILED, statement
    remedy = (
        f"nothing was drawn; {DRAWS} draws tell as a rule"
        if stated_value(budget, "draws_needed") is None
        else draws_needed_text(budget)
    )
    return name, NOT_CHECKED, f"{statement}: {remedy}"


def certificate_of(source: Any) -> xr.Dataset:
    """Return a certificate with its numbers: opened where a file is given, computed where it is lazy.

    Raises
    ------
    InputError
        If it is something else.
    """
    certificate = archive.open_run(source) if isinstance(source, GIVEN) else source
    attributes = getattr(certificate, "attrs", None)
    if attributes is None or attributes.get(EVIDENCE) != CERTIFICATE:
        source_text = f"{str(source)[:60]!r}" if attributes is None or isinstance(source, GIVEN) else "this"
        kind = (attributes or {}).get(EVIDENCE, "")
        raise InputError(f"{source_text} is no certificate{f' but a {kind}' if kind else ''}; `certify` makes one")
    return compute_datasets(certificate)[0]


def remake_certificate(
    certificate: xr.Dataset | Given, functions: Mapping[str, Callable[..., float]] | None
) -> xr.Dataset:
    """Return a certificate recomputed from itself alone, with equal numbers; see `documenting.bundling.recheck`.

    Raises
    ------
    ArchiveError
        If anything is not reproduced; the differences are named, with both values.
    InputError
        If it is not a certificate.
    """
    original = certificate_of(certificate)
    attributes = original.attrs
    model = Model.from_record(original["model_toml"].values.item(), functions=functions)
    location: dict[str, Any] = {"at": float(attributes["at"])} if "at" in attributes else {}
    if attributes["event"]:
        location = {key: attributes[key] for key in ("event", "side")} | {"occurrence": int(attributes["occurrence"])}
    settings = json.loads(str(attributes["asked"]))
    is_older = "run_contradiction" not in original
    if is_older:  # made before records were audited, and by the rules of that time
        settings = {"event_start": WAITING, "atol_floor": NO_FLOOR} | settings
    new_certificate = certify(
        model,
        str(attributes["quantity"]),
        draws=int(attributes["draws"]),
        seed=int(attributes["seed"]),
        coverage=float(attributes["coverage"]),
        digits=int(attributes.get("digits", 1)),
        inadequate_fit=bool(attributes.get("inadequate_fit", 0)),
        proven=bool(attributes.get(PROVEN, 0)),
        **location,
        **settings,
    )
    if is_older:
        new_certificate = new_certificate.isel({GATE: new_certificate["gate_name"].values != RECORD}).drop_vars(
            "run_contradiction"
        )
        new_certificate.attrs["asked"] = attributes["asked"]
        new_certificate = _with_symmetric_result(new_certificate)
    if faults := _differences(original, new_certificate):
        raise ArchiveError(
            f"the certificate of {attributes.get('of')} could not be reproduced:{numbered_lines(faults)}", tuple(faults)
        )
    return new_certificate


def _with_symmetric_result(certificate: xr.Dataset) -> xr.Dataset:
    """Write the number of a certificate as earlier versions did: plus and minus twice its drawn uncertainty."""
    if int(certificate["linear_verdict"]) != NOT_ADEQUATE:
        return certificate
    parts = (certificate[name] for name in ("monte_carlo_standard_uncertainty", "numerical_rss"))
    total = float(apply_elementary("hypot", *map(float, parts)))
    value, bound = float(certificate["value"]), float(certificate["numerical_bound"])
    result_text = rounded_result(value, total, bound, str(certificate["value"].attrs["units"]), "k = 2, drawn")
    return certificate.assign(result=certificate["result"].copy(data=np.array(result_text))).assign_attrs(
        result=result_text
    )


def _differences(original: xr.Dataset, new_certificate: xr.Dataset) -> list[str]:
    """Describe everything that differs."""
    faults = [
        f"'{name}' is missing"
        for name in new_certificate.variables
        if name not in original.variables and name not in LATE_VARIABLES
    ]
    faults += [f"'{name}' is added" for name in original.variables if name not in new_certificate.variables]
    for name, variable in new_certificate.variables.items():
        if name not in original.variables:
            continue
        old, new = np.atleast_1d(original[name].values), np.atleast_1d(variable.values)
        if old.shape != new.shape:
            faults.append(f"'{name}' has the shape {old.shape}, and comes out as {new.shape}")
            continue
        differs = (
            # nan on both sides is no difference
            (old != new) & ~((old != old) & (new != new))
            if old.dtype.kind == "f"
            else old.astype(str) != new.astype(str)
        )
        if name == "result":
            differs = np.array([not same_number(str(old[0]), str(new[0]))])
        if differs.any():
            k = tuple(np.argwhere(differs)[0].tolist())
            faults.append(f"'{name}'{list(k) if old.size > 1 else ''} is {old[k]}, and comes out as {new[k]}")
    faults += [
        f"attribute '{key}' is {original.attrs.get(key)!r}, and comes out as {new_certificate.attrs[key]!r}"
        for key in COMPARED_ATTRIBUTES
        if key in new_certificate.attrs
        and str(original.attrs.get(key)) != str(new_certificate.attrs[key])
        and not (key == "result" and same_number(str(original.attrs.get(key)), str(new_certificate.attrs[key])))
    ]
    return faults


def certificate_lines(certificate: xr.Dataset) -> list[str]:
    """Summarise the number, its gates, and how to check them again."""
    verdicts = [GATES[index] for index in certificate["gate_verdict"].values.tolist()]
    lines = [f"result    {certificate.attrs['of']} = {stated_value(certificate, 'result')}"]
    lines += extreme_lines(certificate)
    rows = zip(certificate["gate_name"].values, verdicts, gate_reasons(certificate), strict=True)
    lines += [
        f"{verdict.replace('_', ' '):<9} {str(name).replace('_', ' ')}: {reason}" for name, verdict, reason in rows
    ]
    if "level_verdict" in certificate:
        lines.append(f"levels    {verdict_text(words_of_flag(certificate['level_verdict'])[0])}")
    lines.append(f"model     sha256 {certificate.attrs['model_digest']}; method {certificate.attrs['solver_method']}")
    lines.append("again     xdynamics recheck makes it again from this file alone, and compares every number")
    return lines


SUMMARIES = {CERTIFICATE: certificate_lines}

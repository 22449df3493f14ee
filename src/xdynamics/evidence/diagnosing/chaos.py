"""Growth of small changes of a run's state: Lyapunov exponents, and the growth over the run's own time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics import schema
from xdynamics.dynamics import tangents as rules
from xdynamics.dynamics.tangents import TOLERANCE, count_of, local_growth
from xdynamics.dynamics.variational import NotVariedError
from xdynamics.elementary.arrays import log
from xdynamics.evidence.evidence_dataset import attrs_of
from xdynamics.faults import InputError
from xdynamics.model import Model
from xdynamics.model.linearisation import count_of_changes
from xdynamics.model.motion import variables as variables_of
from xdynamics.units.digits import with_uncertainty

if TYPE_CHECKING:
    import xarray as xr

ROLE = "diagnostic"
CERTAIN = 2.0  # uncertainties by which an exponent has to exceed 0 for a time to follow from it
GROWN = 1000.0  # least growth for that: a smaller one cannot be distinguished from growth by a power of time
IN_WORDS = (
    schema.LYAPUNOV,
    schema.LYAPUNOV_TIME,
    schema.FINITE_TIME_GROWTH,
)  # numbers that `exponents_in_words` reports
LONG_NAMES = {
    schema.LYAPUNOVS: "Lyapunov exponents of coordinates, velocities and states, the largest first",
    schema.LYAPUNOV_UNCERTAINTY: f"standard uncertainty of each exponent: {rules.UNCERTAINTY_RULE}",
    schema.LYAPUNOV: f"the largest of {schema.LYAPUNOVS}",
    schema.LYAPUNOV_TIME: (
        f"1/{schema.LYAPUNOV}; inf where that is not above twice its uncertainty, or has grown less than a thousandfold"
    ),
    schema.FINITE_TIME_GROWTH: (
        "logarithm of how much the change of the start that grows most has grown at the end of the run,"
        " each variable in units of its range, over the run's time; transients are in it"
    ),
}


def lyapunov(
    run: xr.Dataset, functions: Mapping[str, Callable[..., float]] | None, *, exponent_count: bool | int
) -> dict[str, Any]:
    """Return all Lyapunov exponents, or the largest few, with the numbers that follow from the largest.

    Raises
    ------
    InputError
        If `exponent_count` is not a count, or small changes of the state cannot be followed along the run.
    """
    check_exponent_count(exponent_count)
    try:
        exponents = rules.exponents_of(
            local_growth(run, functions, None if exponent_count is True else int(exponent_count))
        )
    except NotVariedError as error:
        raise InputError(
            f"the run has no Lyapunov exponents by variational equations: {error}; choose a run that ends before, or"
            " diagnose it without them"
        ) from None
    largest, uncertainty = float(exponents.values[0]), float(exponents.uncertainties[0])
    grown = largest * (float(run["time"][-1]) - exponents.begin) > float(log(GROWN))
    rule_attributes = {"transient_end": exponents.begin, "pieces": exponents.pieces, "variables": exponents.variables}
    numbers: dict[str, Any] = {
        schema.LYAPUNOVS: exponents.values,
        schema.LYAPUNOV_UNCERTAINTY: exponents.uncertainties,
        schema.LYAPUNOV: largest,
        schema.LYAPUNOV_TIME: 1.0 / largest if grown and largest > CERTAIN * uncertainty else np.inf,
        schema.FINITE_TIME_GROWTH: exponents.finite_time,
    }
    return _exponent_variables(str(run["time"].attrs["units"]), numbers, rule_attributes)


def describe_exponents(unit: str, model: Model, *, exponent_count: bool | int) -> dict[str, Any]:
    """Return the variables of Lyapunov exponents before these are computed: nan in place of every value.

    Raises
    ------
    InputError
        If `exponent_count` is not a count.
    """
    check_exponent_count(exponent_count)
    size = len(variables_of(model))
    changes = count_of_changes(model) if model.constraints else size
    several = np.full(count_of(changes, None if exponent_count is True else int(exponent_count)), np.nan)
    numbers = dict.fromkeys((schema.LYAPUNOVS, schema.LYAPUNOV_UNCERTAINTY), several)
    return _exponent_variables(unit, numbers | dict.fromkeys(IN_WORDS, np.nan), {"variables": size})


def check_exponent_count(exponent_count: Any) -> None:
    """Check how many exponents are wanted.

    Raises
    ------
    InputError
        If it is not a count.
    """
    if not isinstance(exponent_count, bool | int | np.integer) or exponent_count < 1:
        raise InputError(
            f"lyapunov is {exponent_count!r}, needs true for all exponents, or how many of the largest, from 1 on"
        )


def _exponent_variables(unit: str, numbers: Mapping[str, Any], rule_attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the exponents as variables, with the rule of their computation."""
    per_time = "1" if unit == "1" else f"{unit}-1"
    rule = {
        "rule": rules.RULE,
        "ancillary_variables": schema.LYAPUNOV_UNCERTAINTY,
        "piece_tolerance": TOLERANCE,
        "transient": rules.TRANSIENT_RULE,
        **rule_attributes,
    }
    variables = {}
    for name, value in numbers.items():
        units = unit if name == schema.LYAPUNOV_TIME else per_time
        role = "error" if name == schema.LYAPUNOV_UNCERTAINTY else ROLE
        extra = rule if name == schema.LYAPUNOVS else {}
        variables[name] = (
            (schema.EXPONENT,) if np.ndim(value) else (),
            value,
            attrs_of(units, LONG_NAMES[name], role) | extra,
        )
    return variables


def exponents_in_words(diagnosis: xr.Dataset) -> Iterator[str]:
    """Describe all exponents with their justified digits, and the time scale that follows from the largest."""
    if schema.LYAPUNOVS not in diagnosis:
        return
    unit = str(diagnosis[schema.LYAPUNOVS].attrs["units"])
    suffix = "" if unit == "1" else f" {unit}"
    yield f"{schema.LYAPUNOVS} = {', '.join(exponents_with_uncertainty(diagnosis))}{suffix}"
    time, unit_of_time = float(diagnosis[schema.LYAPUNOV_TIME]), str(diagnosis[schema.LYAPUNOV_TIME].attrs["units"])
    if np.isfinite(time):
        yield f"{schema.LYAPUNOV_TIME} = {time:.3g}{'' if unit_of_time == '1' else f' {unit_of_time}'}"
    else:
        yield (
            f"{schema.LYAPUNOV_TIME} = inf: the largest exponent is not above twice its uncertainty, or the run is too short"
            " to tell"
        )
    yield f"{schema.FINITE_TIME_GROWTH} = {float(diagnosis[schema.FINITE_TIME_GROWTH]):.4g}{suffix}, over the run's own time"


def exponents_with_uncertainty(diagnosis: xr.Dataset) -> list[str]:
    """Write every exponent with the digits that its uncertainty justifies."""
    pairs = zip(
        diagnosis[schema.LYAPUNOVS].values.tolist(), diagnosis[schema.LYAPUNOV_UNCERTAINTY].values.tolist(), strict=True
    )
    return [with_uncertainty(*pair) for pair in pairs]

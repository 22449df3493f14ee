"""What was used, how it ended, on what it ran: the global attributes of a record, and the arguments recovered from them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from functools import lru_cache
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics import schema
from xdynamics.elementary import kept_set
from xdynamics.kernels import Layout
from xdynamics.keywords import FULL, KEYWORDS
from xdynamics.march import March
from xdynamics.march.control import CONTROLLER, ERROR_NORM, FIRST_STEP, PREDICTIVE, SPACINGS
from xdynamics.march.implicit.newton import MOST_ITERATIONS, NEWTON_TOLERANCE
from xdynamics.march.implicit.radau import MOST_SETTLING, MOST_TURNS, SETTLED, SOLVED_BY
from xdynamics.march.outcome_text import ending
from xdynamics.march.outcomes import COMPLETED
from xdynamics.march.settings import ONE_BY_ONE, ROOT_METHODS, Settings
from xdynamics.march.timescales import FEW, RULE, time_scales
from xdynamics.march.tolerance_sizes import ATOL_RULE
from xdynamics.methods.method import HERMITE, printed
from xdynamics.methods.radau import SHARE
from xdynamics.methods.scheme import ESTIMATE_WORDS, INTERPOLANT, REINTEGRATE, STEP_DOUBLING, Scheme
from xdynamics.methods.summation import PLAIN
from xdynamics.model import Model
from xdynamics.model.switches import LOCATED, LOCATED_EVERYWHERE, STEPPED_OVER, watched_switches
from xdynamics.record.columns import left_out_tolerances
from xdynamics.record.kinds import left_out_atols
from xdynamics.units import NUMBERS, SECONDS, TIME, UNSCALED, Quantity, Scales, Unit, behind, parse_unit

if TYPE_CHECKING:
    import xarray as xr

EVERYWHERE = "everywhere"
KEPT_ROWS = (
    "rows of the grid whose number this divides (of chosen and given steps, rows of the march), those of events and of"
    " solver_nodes, the first and the last; with them the force evaluations that led there and the trials rejected"
    " there"
)
KEPT_COLUMNS = (
    "of the columns along step and sample times, steps and flags are kept, and with them coordinates, velocities,"
    " states and errors (states), or what solver_log_variables names (chosen); events and rejected trials are whole"
)
_SCALES = {"length": "m", "time": "s", "mass": "kg"}


def attributes(march: March) -> dict[str, Any]:
    """Return the global attributes: what was used, how it ended, on what it ran."""
    model, settings, method = march.model, march.settings, march.settings.method
    end = ending(march)
    recorded: dict[str, Any] = {
        "Conventions": schema.CONVENTIONS,
        "title": f"{model.name}, by {method.name}",
        "summary": model.description or f"Numerical trajectory of {model.name}",
        "source": f"numerical integration by xdynamics, method {method.name}",
        "schema_version": schema.SCHEMA_VERSION,
        "solver_method": method.name,
        "solver_order": method.order,
        "solver_update_equations": method.equations(model),
        "solver_update_order": method.words,
        "solver_reference": method.reference,
        **_steps(march),
        "solver_until": settings.until,
        "solver_until_units": "s",
        "run_force_evaluations": int(march.now.evaluations),
        **_effort(march),
        "run_accepted_steps": march.accepted,
        "run_rejected_trials": int(march.now.trials),
        **_errors(march),
        "solver_summation": settings.summation,
        **_switches(march),
        **_located(march),
        **_time_scales(march),
        **({schema.ATOL_EFFECT: march.atol_effect} if march.atol_effect else {}),
        **_assumed(march.model),
        **interpolation(settings.scheme),
        "solver_event_root_method": ROOT_METHODS[settings.event_root_method],
        "solver_force_samples": "all" if settings.samples else "none",
        "precision": "float64, IEEE 754 binary64, round to nearest",
        "math_functions": settings.math_functions,
        "run_outcome": end.outcome.word,
        "run_outcome_text": end.text,
        "model_digest": model.digest,
        "force_digest": force_digest(march),
    }
    recorded |= _thinning(march) | _nodes_and_scales(settings)
    if model.time_unit != SECONDS:  # settings that are times are dimensionless too
        recorded |= {
            key: NUMBERS.text
            for key, value in recorded.items()
            if key.endswith("_units") and isinstance(value, str) and value == SECONDS.text
        }
    return recorded | circumstances("simulated")


def _thinning(march: March) -> dict[str, Any]:
    """Return what was left out of the record, and by which rule; whether its archive is compressed."""
    settings = march.settings
    recorded: dict[str, Any] = {}
    if settings.keep_every > 1:
        recorded |= {
            schema.KEEP_EVERY: settings.keep_every,
            f"{schema.KEEP_EVERY}_rule": KEPT_ROWS,
            "run_rows": int(march.now.rows),
        }
    if settings.log != FULL:
        log = settings.log if isinstance(settings.log, str) else schema.CHOSEN
        recorded |= {schema.LOG: log, f"{schema.LOG}_rule": KEPT_COLUMNS}
        recorded |= {} if isinstance(settings.log, str) else {schema.LOGGED: " ".join(settings.log)}
        left_out = left_out_tolerances(march)
        recorded |= {schema.LEFT_OUT_ATOL: json.dumps(left_out)} if left_out else {}
    if settings.compress:
        recorded[schema.COMPRESSION] = schema.COMPRESSION_WORDS
    return recorded


def _nodes_and_scales(settings: Settings) -> dict[str, Any]:
    """Return the times that the march was to land on, and the scales of its nondimensional variables."""
    recorded: dict[str, Any] = {}
    if settings.nodes:
        recorded |= {"solver_nodes": np.array(settings.nodes), "solver_nodes_units": "s"}
    if settings.scales != UNSCALED:
        for name, unit in _SCALES.items():
            recorded |= {f"solver_{name}_scale": getattr(settings.scales, name), f"solver_{name}_scale_units": unit}
    return recorded


def interpolation(scheme: Scheme, rule: str = REINTEGRATE) -> dict[str, Any]:
    """Describe the interpolation between the accepted states of a run."""
    return {
        "solver_interpolation": scheme.interpolation(rule),
        "solver_interpolation_order": scheme.interpolation_order(rule),
    }


def interpolation_orders(scheme: Scheme, layout: Layout, rule: str = REINTEGRATE) -> dict[str, int]:
    """Return the order of the interpolation for every coordinate, velocity and state."""
    if rule == INTERPOLANT and scheme.extension == HERMITE:
        return {name: 5 if name in layout.coordinates else 3 for name in layout.used}
    return dict.fromkeys(layout.used, scheme.interpolation_order(rule))


def force_digest(march: March) -> str:
    """Return the sha256 of the law's text and of every Python function: the revision of the force function."""
    functions = "".join(function.digest for function in march.model.python_functions)
    if not functions:
        return march.law.source_digest
    return hashlib.sha256((march.law.source + functions).encode()).hexdigest()


def _switches(march: March) -> dict[str, str]:
    """Describe the treatment of switches hidden in forces, if there are any."""
    choice, watched = march.settings.switches, watched_switches(march.model)
    if not watched:
        return {}
    if choice == STEPPED_OVER or not any(switch.nested for switch in watched):
        return {"solver_switches": choice}
    where = EVERYWHERE if choice == LOCATED_EVERYWHERE else "where the side of the where around them holds"
    return {"solver_switches": LOCATED, "solver_switches_watched": where}


def _switches_asked(used: dict[str, Any]) -> str:
    """Return the treatment of switches that a record reports."""
    choice = str(used.get("solver_switches", STEPPED_OVER))  # records from before this setting stepped over them
    # version 0.2 did not record where it looked for them: it was everywhere
    everywhere = used.get("solver_switches_watched", EVERYWHERE) == EVERYWHERE
    return LOCATED_EVERYWHERE if choice == LOCATED and everywhere else choice


def root_method_of(used: Mapping[str, Any]) -> str:
    """Return how events of a record, or of the members of a sweep, were located; version 0.2 had one way."""
    words = {text: name for name, text in ROOT_METHODS.items()}
    return words.get(str(used.get("solver_event_root_method")), ONE_BY_ONE)


def _time_scales(march: March) -> dict[str, Any]:
    """Compare steps with the fastest time scale and the span with the slowest, or report that this was not done."""
    scales = time_scales(march)
    if scales is None:
        return {"run_h_omega_rule": "not looked at: the forces give no finite rate at the start"}
    reported: dict[str, Any] = {
        "run_fastest_rate": scales.rate,
        "run_fastest_rate_units": "s-1" if march.model.time_unit == SECONDS else NUMBERS.text,
        "run_h_omega_start": scales.start,
        "run_h_omega_largest": scales.largest,
        "run_h_omega_rule": RULE.format(rows=scales.rows),
    }
    if np.isfinite(scales.period):
        span = float(march.now.t) * march.settings.scales.of(TIME) - march.model.initial["t"].si
        reported |= {
            "run_slowest_period": scales.period,
            "run_slowest_period_units": "s",
            "run_slowest_periods": float(f"{span / scales.period:.3g}"),
        }
    elif np.isnan(scales.period):
        reported["run_slowest_period_rule"] = f"not looked at: the state has more than {FEW} numbers"
    return reported


def _assumed(model: Model) -> dict[str, str]:
    """Name the coordinates that start at rest because no velocity is given."""
    return {schema.AT_REST: " ".join(model.statement.at_rest)} if model.statement.at_rest else {}


def _located(march: March) -> dict[str, Any]:
    """Return the time tolerance of events that have none of their own, if there are events."""
    if not march.layout.watched:
        return {}
    return {"solver_time_tolerance": march.settings.time_tolerance, "solver_time_tolerance_units": "s"}


def scales_of(run: xr.Dataset) -> Scales:
    """Return the scales of the nondimensional variables that a run was marched in."""
    recorded = {name: run.attrs.get(f"solver_{name}_scale") for name in _SCALES}
    return Scales.parse(
        {name: f"{float(value)!r} {_SCALES[name]}" for name, value in recorded.items() if value is not None} or None
    )


def asked_of(run: xr.Dataset) -> dict[str, Any]:
    """Return the arguments of `simulate` that a record was made with."""
    recorded = run.attrs
    scales = {
        name: f"{float(recorded[f'solver_{name}_scale'])!r} {unit}"
        for name, unit in _SCALES.items()
        if f"solver_{name}_scale" in recorded
    }
    arguments = {
        name: keyword.read(_plain(recorded[keyword.attribute]), SECONDS)
        for name, keyword in KEYWORDS.items()
        if keyword.attribute in recorded
    }
    arguments |= {
        "scales": scales or None,
        "summation": recorded.get("solver_summation", PLAIN),  # version 0.1 had no other
        "switches": _switches_asked(recorded),
        "math_functions": kept_set(recorded.get("math_functions")),
        "event_root_method": root_method_of(recorded),
        "keep_every": int(recorded[schema.KEEP_EVERY]) if schema.KEEP_EVERY in recorded else None,
        "log": _log_asked(recorded),
        "compress": True if schema.COMPRESSION in recorded else None,
    }
    if "nodes" in arguments:
        arguments["nodes"] = np.atleast_1d(arguments["nodes"]).tolist()
    if schema.GIVEN_STEP.name in run:
        arguments["step"] = np.asarray(run[schema.GIVEN_STEP.name])
    elif "solver_step" in recorded:
        arguments["step"] = float(recorded["solver_step"])
    if "solver_rtol" in recorded:
        arguments |= _tolerances(run)
    if recorded["solver_step_control"] == "adaptive":
        if recorded["solver_first_step_choice"] != FIRST_STEP:  # given, or chosen by the rule of another version
            arguments["step"] = float(recorded["solver_first_step"])
        if _asked_longest(run):
            arguments["max_step"] = float(recorded["solver_max_step"])
    return arguments


def _plain(value: Any) -> Any:
    """Return an attribute as a plain value: a word, a number, a row of numbers."""
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def _log_asked(used: Mapping[Any, Any]) -> str | list[str] | None:
    """Return the choice of log columns that a record was made with; None if it has all."""
    if schema.LOG not in used:
        return None
    return str(used.get(schema.LOGGED, "")).split() if used[schema.LOG] == schema.CHOSEN else str(used[schema.LOG])


def _asked_longest(run: xr.Dataset) -> bool:
    """Whether a longest step was asked for."""
    if "solver_max_step_choice" in run.attrs:
        return str(run.attrs["solver_max_step_choice"]) == "given"
    # version 0.1 did not say
    span = float(run.attrs["solver_until"]) - float(run["time"][0]) if "time" in run.variables else np.nan
    return float(run.attrs["solver_max_step"]) != span


def _tolerances(run: xr.Dataset) -> dict[str, Any]:
    """Return the tolerances that a record was made with; those that followed their variables do so again."""
    rtol, rescaling = float(run.attrs["solver_rtol"]), 1.0
    if run.attrs["solver_estimator"] == STEP_DOUBLING and "solver_rtol_used" not in run.attrs:
        # version 0.1 judged by the given rtol: give the one that is rescaled to it
        order = int(run.attrs["solver_order"])
        rescaling = rtol ** (order / (order + 1)) / rtol
    atol = {
        str(name): Quantity(
            rescaling * float(variable.attrs["atol_si"]), Unit("SI", parse_unit(variable.attrs["units"]).dimension)
        )
        for name, variable in run.data_vars.items()
        if "atol_si" in variable.attrs and schema.ATOL_RULE not in variable.attrs
    }
    for name, (size, units) in left_out_atols(run.attrs).items():
        atol[name] = Quantity(rescaling * size, Unit("SI", parse_unit(units).dimension))
    return {"rtol": rescaling * rtol, "atol": atol or None}


def _steps(march: March) -> dict[str, Any]:
    """Describe how steps were chosen."""
    settings, pacing = march.settings, march.settings.pacing
    if isinstance(settings.step, tuple):
        return {
            "solver_step_control": "given",
            "solver_grid": f"the steps of {schema.GIVEN_STEP.name}, cut at nodes, events and the end",
        }
    if not settings.adaptive:
        return {
            "solver_step_control": "fixed",
            "solver_step": settings.step,
            "solver_step_units": "s",
            "solver_grid": "t0 + n*h; steps are cut at nodes, events and the end",
            "solver_last_step": _last_step(march),
        }
    scale = settings.scales.of(TIME)
    return {
        "solver_step_control": "adaptive",
        "solver_controller": PREDICTIVE if settings.scheme.predictive else CONTROLLER,
        "solver_first_step": settings.step or float(march.now.first_step) * scale,
        "solver_first_step_units": "s",
        "solver_first_step_choice": "given" if settings.step else FIRST_STEP,
        "solver_safety": pacing.safety,
        "solver_growth_limits": np.array(pacing.growth_limits),
        "solver_min_step": pacing.min_step,
        "solver_min_step_units": "s",
        "solver_min_step_rule": f"never below {SPACINGS:g} spacings of t in double precision",
        **_longest(march),
        "solver_max_steps": pacing.max_steps,
    }


def _longest(march: March) -> dict[str, Any]:
    """Return the longest step: the span, unless it was given."""
    max_step = march.settings.pacing.max_step
    span = march.settings.until - march.model.initial["t"].si
    longest, choice = (max_step, "given") if isfinite(max_step) else (span, "the span")
    return {"solver_max_step": longest, "solver_max_step_units": "s", "solver_max_step_choice": choice}


def _errors(march: March) -> dict[str, Any]:
    """Describe how local errors were estimated and scaled, and how equations were solved."""
    settings, method = march.settings, march.settings.method
    reported: dict[str, Any] = {"solver_estimator": settings.estimator}
    if settings.scheme.estimates:
        reported["solver_error_estimate"] = ESTIMATE_WORDS[settings.estimator]
        reported["solver_error_exponent"] = settings.scheme.error_order  # k of an estimate that falls as h**k
    if settings.scheme.error_lines:
        reported["solver_error_equations"] = printed(settings.scheme.error_lines, march.model)
    if settings.tolerances is not None:
        scheme, rtol = settings.scheme, settings.tolerances.rtol
        reported |= {
            "solver_rtol": rtol,
            "solver_rtol_used": scheme.inner(rtol),
            "solver_error_norm": "; ".join(filter(None, [ERROR_NORM, scheme.inner_norm])),
        }
        if march.run.plan[0].follows:
            reported["solver_atol_rule"] = ATOL_RULE
    if method.simplified:
        reported |= {
            "solver_equations_solved_by": SOLVED_BY,
            "solver_jacobian": settings.jacobian,
            "solver_newton_tolerance": SHARE if settings.adaptive else SETTLED,
            "solver_newton_most_iterations": int(MOST_TURNS if settings.adaptive else MOST_SETTLING),
        }
    elif method.implicit:
        reported |= {
            "solver_equations_solved_by": (
                "Newton's method with exact Jacobians, until a correction is below the tolerance times the size of its"
                " unknown"
            ),
            "solver_newton_tolerance": NEWTON_TOLERANCE,
            "solver_newton_most_iterations": MOST_ITERATIONS,
        }
    return reported


def _effort(march: March) -> dict[str, int]:
    """Count what an implicit method does besides evaluating forces."""
    if not march.settings.method.implicit:
        return {}
    return {
        "run_jacobian_evaluations": int(march.now.jacobians),
        "run_factorisations": int(march.now.factorisations),
    }


def _last_step(march: March) -> str:
    """Describe whether the end lay on the grid."""
    if march.now.status != COMPLETED:
        return "none: the run ended before"
    plan = march.run.plan[0]
    steps = (plan.end - plan.start) / plan.step_size
    partial = abs(steps - round(steps)) * plan.step_size > plan.snap * max(abs(plan.start), abs(plan.end))
    whole = int(steps)
    rest = (float(plan.end) - (plan.start + whole * plan.step_size)) * march.settings.scales.of(TIME)
    return (
        f"partial, {rest:.9g}{behind(march.model.time_unit)}: the span is no multiple of the step"
        if partial
        else "whole"
    )


@lru_cache
def _machine() -> dict[str, str]:
    """Return versions and processor: volatile, and in no digest of content."""
    import platform
    from importlib.metadata import version

    from llvmlite import binding

    features = binding.get_host_cpu_features()
    versions = {f"{name}_version": version(name) for name in ("numpy", "numba", "llvmlite", "xarray", "xdynamics")}
    return versions | {
        "python_version": platform.python_version(),
        "cpu_name": binding.get_host_cpu_name(),
        "cpu_features": " ".join(sorted(name for name, enabled in features.items() if enabled)),
    }


def xdynamics_version() -> str:
    """Return the version of this program."""
    return _machine()["xdynamics_version"]


def circumstances(done: str) -> dict[str, Any]:
    """Return when and on what machine something was done; no digest of content includes it."""
    from datetime import UTC, datetime

    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    machine = _machine()
    history = f"{now} {done} by xdynamics {machine['xdynamics_version']}"
    return {"date_created": now, "history": history} | machine

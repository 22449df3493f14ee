"""What was used, how it ended, on what it ran: the global attributes of a record, and the way back from them."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics import schema
from xdynamics.kernels import Layout
from xdynamics.kernels.elementary import MATH_FUNCTIONS
from xdynamics.kernels.layout import EMBEDDED, EXTRAPOLATED, NO_ESTIMATE, STEP_DOUBLING
from xdynamics.kernels.stepping import MOST_ITERATIONS, NEWTON_TOLERANCE
from xdynamics.march import March
from xdynamics.march.control import CONTROLLER, ERROR_NORM, FIRST_STEP, SPACINGS
from xdynamics.march.events import ROOT_METHOD
from xdynamics.march.outcomes import COMPLETED
from xdynamics.march.settings import UNSCALED
from xdynamics.methods import Method
from xdynamics.methods.method import HERMITE, HERMITE_WORDS, printed, read_lines
from xdynamics.units import TIME, Scales

if TYPE_CHECKING:
    import xarray as xr

ESTIMATES = {
    EMBEDDED: "difference from an embedded formula; the higher order goes on (local extrapolation)",
    STEP_DOUBLING: "two half steps less one whole step, over 2**order - 1; the two half steps go on",
    EXTRAPOLATED: "two half steps less one whole step, over 2**order - 1, added to the two half steps (local extrapolation)",
}
_SCALES = {"length": "m", "time": "s", "mass": "kg"}


def attributes(march: March) -> dict[str, Any]:
    """Return the global attributes: what was used, how it ended, on what it ran."""
    model, settings, method = march.model, march.settings, march.settings.method
    used: dict[str, Any] = {
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
        "run_force_evaluations": march.memory.evaluations,
        "run_accepted_steps": march.accepted,
        "run_rejected_trials": march.memory.tally.trials,
        **_errors(march),
        **interpolation(method, settings.estimator),
        "solver_event_root_method": ROOT_METHOD,
        "solver_force_samples": "all" if settings.samples else "none",
        "precision": "float64, IEEE 754 binary64, round to nearest",
        "math_functions": MATH_FUNCTIONS,
        "run_outcome": march.outcome.word,
        "run_outcome_text": march.outcome_text,
        "model_digest": model.digest,
        "force_digest": march.force_digest,
    }
    if settings.scales != UNSCALED:
        scales = settings.scales
        used |= {"solver_length_scale": scales.length, "solver_length_scale_units": "m",
                 "solver_time_scale": scales.time, "solver_time_scale_units": "s",
                 "solver_mass_scale": scales.mass, "solver_mass_scale_units": "kg"}  # fmt: skip
    return used | _circumstances()


def interpolation(method: Method, estimator: str) -> dict[str, Any]:
    """Say which dense output belongs to a run: the method's own, or Hermite's where half steps went on."""
    own = estimator in (NO_ESTIMATE, EMBEDDED)
    return {
        "solver_interpolation": method.interpolation if own else HERMITE_WORDS,
        "solver_interpolation_order": method.interpolation_order if own else 3,
    }


def extension(method: Method, estimator: str) -> str:
    """Return the lines of the dense output that belongs to a run."""
    return method.extension if estimator in (NO_ESTIMATE, EMBEDDED) else HERMITE


def interpolation_orders(method: Method, estimator: str, layout: Layout) -> dict[str, int]:
    """Return the order of the dense output for every coordinate, velocity and state."""
    if extension(method, estimator) != HERMITE:
        return dict.fromkeys(layout.used, method.interpolation_order)
    return {name: 5 if name in layout.coordinates else 3 for name in layout.used}


def scales_of(run: xr.Dataset) -> Scales:
    """Return the scales of the nondimensional variables that a run was marched in."""
    given = {name: run.attrs.get(f"solver_{name}_scale") for name in _SCALES}
    return Scales.parse(
        {name: f"{float(value)!r} {_SCALES[name]}" for name, value in given.items() if value is not None} or None
    )


def asked_of(run: xr.Dataset) -> dict[str, Any]:
    """Return the arguments of `simulate` that a record was made with."""
    used = run.attrs
    scales = {
        name: f"{float(used[f'solver_{name}_scale'])!r} {unit}"
        for name, unit in _SCALES.items()
        if f"solver_{name}_scale" in used
    }
    asked = {
        "method": used["solver_method"],
        "until": float(used["solver_until"]),
        "force_samples": used["solver_force_samples"],
        "estimator": used["solver_estimator"],
        "scales": scales or None,
    }
    if schema.GIVEN_STEP.name in run:
        asked["step"] = np.asarray(run[schema.GIVEN_STEP.name])
    elif "solver_step" in used:
        asked["step"] = float(used["solver_step"])
    if "solver_rtol" in used:
        asked["rtol"] = float(used["solver_rtol"])
        asked["atol"] = {
            str(name): float(one.attrs["atol_si"]) for name, one in run.data_vars.items() if "atol_si" in one.attrs
        }
    if used["solver_step_control"] == "adaptive":
        if used["solver_first_step_choice"] == "given":
            asked["step"] = float(used["solver_first_step"])
        asked |= {key: float(used[f"solver_{key}"]) for key in ("safety", "min_step", "max_step")}
        asked |= {
            "max_steps": int(used["solver_max_steps"]),
            "growth_limits": tuple(map(float, used["solver_growth_limits"])),
        }
    return asked


def _steps(march: March) -> dict[str, Any]:
    """Say how steps were chosen."""
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
        "solver_controller": CONTROLLER,
        "solver_first_step": settings.step or march.memory.pace.first * scale,
        "solver_first_step_units": "s",
        "solver_first_step_choice": "given" if settings.step else FIRST_STEP,
        "solver_safety": pacing.safety,
        "solver_growth_limits": np.array(pacing.growth_limits),
        "solver_min_step": pacing.min_step,
        "solver_min_step_units": "s",
        "solver_min_step_rule": f"never below {SPACINGS:g} spacings of t in double precision",
        "solver_max_step": min(pacing.max_step, settings.until - march.model.initial["t"].si),
        "solver_max_step_units": "s",
        "solver_max_steps": pacing.max_steps,
    }


def _errors(march: March) -> dict[str, Any]:
    """Say how local errors were estimated and scaled, and how equations were solved."""
    settings, method = march.settings, march.settings.method
    said: dict[str, Any] = {"solver_estimator": settings.estimator}
    if settings.estimator != NO_ESTIMATE:
        said["solver_error_estimate"] = ESTIMATES[settings.estimator]
        said["solver_error_exponent"] = settings.error_order  # k of an estimate that falls as h**k
    if settings.estimator == EMBEDDED:
        said["solver_error_equations"] = printed(read_lines(method.estimate), march.model)
    if settings.tolerances is not None:
        said |= {"solver_rtol": settings.tolerances.rtol, "solver_error_norm": ERROR_NORM}
    if method.implicit:
        said |= {
            "solver_equations_solved_by": "Newton's method with exact Jacobians, until a correction is below the tolerance times the size of its unknown",
            "solver_newton_tolerance": NEWTON_TOLERANCE,
            "solver_newton_most_iterations": MOST_ITERATIONS,
        }
    return said


def _last_step(march: March) -> str:
    """Say whether the end lay on the grid."""
    if march.memory.status != COMPLETED:
        return "none: the run ended before"
    plan = march.plan
    steps = (plan.nodes[-1] - plan.start) / plan.step_size
    partial = abs(steps - round(steps)) * plan.step_size > plan.snap
    whole = int(steps)
    rest = (float(plan.nodes[-1]) - (plan.start + whole * plan.step_size)) * march.settings.scales.of(TIME)
    return f"partial, {rest:.9g} s: the span is no multiple of the step" if partial else "whole"


@lru_cache
def _machine() -> dict[str, str]:
    """Versions and processor: volatile, and in no digest but their own."""
    import platform
    from importlib.metadata import version

    from llvmlite import binding

    features = binding.get_host_cpu_features()
    versions = {f"{name}_version": version(name) for name in ("numpy", "numba", "llvmlite", "xarray", "xdynamics")}
    return versions | {
        "python_version": platform.python_version(),
        "cpu_name": binding.get_host_cpu_name(),
        "cpu_features": " ".join(sorted(name for name, there in features.items() if there)),
    }


def _circumstances() -> dict[str, Any]:
    from datetime import UTC, datetime

    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    machine = _machine()
    history = f"{now} simulated by xdynamics {machine['xdynamics_version']}"
    return {"date_created": now, "history": history} | machine

"""Global attributes of a record: its settings, how the march ended, on what it ran, and its identity.

Time and machine of a march are recorded, and enter no digest of content.

The identity of a march is its model, settings and program, as words that can be compared one by one. Of delayed values
it has the delays, the values before the start, and how past values were interpolated.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass, replace
from functools import lru_cache
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics import schema
from xdynamics.expressions import text_of
from xdynamics.faults import InputError
from xdynamics.kernels import Layout
from xdynamics.kernels.constraint_programs import TOLERANCE as CONSTRAINT_TOLERANCE
from xdynamics.keywords import FULL
from xdynamics.march import OUTCOMES, March, Pacing, Tolerances
from xdynamics.march.configuration import settings_for
from xdynamics.march.control import ERROR_NORM, SPACINGS, first_step_rule
from xdynamics.march.equation_solvers import solver_of
from xdynamics.march.initial_run import rest_of_time
from xdynamics.march.outcome_text import accumulation, ending
from xdynamics.march.outcomes import COMPLETED, INTERRUPTED
from xdynamics.march.past import delay_times
from xdynamics.march.settings import ROOT_METHODS, Settings
from xdynamics.march.timescales import FEW, MOST_NUMBERS, RULE, beyond_eigenvalues, time_scales
from xdynamics.march.tolerance_sizes import ATOL_RULE
from xdynamics.march.tolerances import ATOL_FLOORS
from xdynamics.methods import Method
from xdynamics.methods.lines import printed_lines
from xdynamics.methods.scheme import DOUBLE_DOUBLE, ESTIMATE_WORDS, FLOAT64, INTERPOLANT, REINTEGRATE, Scheme
from xdynamics.methods.taylor import ORDER_RULE
from xdynamics.model import Model
from xdynamics.model.motion import delayed_quantities, variables
from xdynamics.model.reactions import may_be_indeterminate
from xdynamics.model.sliding import surfaces
from xdynamics.model.switches import LANDED_ON, LOCATED, LOCATED_EVERYWHERE, STEPPED_OVER, landed_on, watched_switches
from xdynamics.record.arguments import EVERYWHERE, SCALES, recorded_arguments
from xdynamics.record.folded_columns import march_shapes
from xdynamics.record.folding import names_as_words, sized
from xdynamics.record.run_columns import left_out_tolerances
from xdynamics.shapes.naming import display_text
from xdynamics.units import NUMBERS, TIME, UNSCALED, Unit, unit_suffix
from xdynamics.units.unit import decimal_text

if TYPE_CHECKING:
    import xarray as xr


@lru_cache
def _versions_and_processor() -> dict[str, str]:
    """Return versions and processor: volatile, and in no digest of content."""
    import platform
    from importlib.metadata import version

    from llvmlite import binding

    from xdynamics.march.engine import engine_origin

    features = binding.get_host_cpu_features()
    versions = {f"{name}_version": version(name) for name in ("numpy", "numba", "llvmlite", "xarray", "xdynamics")}
    return versions | {
        "engine_origin": engine_origin(),
        "python_version": platform.python_version(),
        "cpu_name": binding.get_host_cpu_name(),
        "cpu_features": " ".join(sorted(name for name, enabled in features.items() if enabled)),
    }


def xdynamics_version() -> str:
    """Return the version of this program."""
    return _versions_and_processor()["xdynamics_version"]


def circumstances(done: str) -> dict[str, Any]:
    """Return time and machine of a march; no digest of content includes them."""
    from datetime import UTC, datetime

    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    machine = _versions_and_processor()
    history = f"{now} {done} by xdynamics {machine['xdynamics_version']}"
    return {"date_created": now, "history": history} | machine


BREAKING_POINTS = (
    "start, ticks, points of tables, and events that change the motion, each plus sums of delays, are landed on up to those"
    " where derivative {most} of the motion jumps (Hairer, Norsett, Wanner, Solving ODEs I, II.17); no step is longer than"
    " the shortest delay"
)
AT_START = "its value at the start (default)"


def delay_attributes(march: March) -> dict[str, Any]:
    """Describe the delayed values of a run, if there are any."""
    model, scheme = march.model, march.settings.scheme
    if not model.delays:
        return {}
    history_words = {
        name: text_of(model.history[name]) if name in model.history else AT_START for name in delayed_quantities(model)
    }
    return {
        "solver_delays": np.array(delay_times(model)),
        "solver_delays_units": model.time_unit.text,
        "solver_delay_history": "; ".join(f"{name}: {words}" for name, words in history_words.items()),
        "solver_delay_interpolation": f"polynomials of accepted steps: {scheme.interpolant.words}",
        "solver_delay_interpolation_order": scheme.interpolant.order,
        "solver_breaking_points": BREAKING_POINTS.format(most=scheme.order + 1),
    }


PRECISION_WORDS = {
    FLOAT64: "float64, IEEE 754 binary64, round to nearest",
    DOUBLE_DOUBLE: (
        "double_double, unevaluated sums of two IEEE 754 binary64, round to nearest; a number y is y + rest_y"
    ),
}
KEPT_ROWS = (
    "rows of the grid whose number this divides (of chosen and given steps, rows of the march), those of events and of"
    " solver_nodes, the first and the last; with them the force evaluations that led there and the trials rejected"
    " there"
)
KEPT_COLUMNS = (
    "of the columns along step and sample times, steps and flags are kept, and with them coordinates, velocities,"
    " states and errors (states), or what solver_log_variables names (chosen); events and rejected trials are whole"
)

KEPT_BY_PROJECTION = (
    "multipliers are solved for with the accelerations (index 1), of least norm where conditions imply each other; after"
    " every step positions, then velocities are projected onto the constraints in the metric of the mass (Hairer, Wanner,"
    " Solving ODEs II, VII.2)"
)
KEPT_BY_IMPULSES = (
    "impulses along the gradients at the last force evaluation keep positions, and a projection the velocities at the end"
    " of a step (RATTLE: Andersen 1983, doi:10.1016/0021-9991(83)90014-1; Hairer, Lubich, Wanner, VII.1.4)"
)


def run_attributes(march: March) -> dict[str, Any]:
    """Return the global attributes of a finished march: settings, ending, circumstances."""
    ended = _ending_attributes(march)
    return settings_used(march) | ended


def settings_used(march: March) -> dict[str, Any]:
    """Return the global attributes that are known before the march."""
    model, settings, method = march.model, march.settings, march.settings.method
    recorded: dict[str, Any] = {
        "Conventions": schema.CONVENTIONS,
        "title": f"{model.name}, by {method.name}",
        "summary": model.description or f"Numerical trajectory of {model.name}",
        "source": f"numerical integration by xdynamics, method {method.name}",
        "schema_version": schema.SCHEMA_VERSION,
        "solver_method": method.name,
        "solver_order": method.order,
        **_order_choice(settings),
        "solver_update_equations": method.equations(model),
        "solver_update_order": method.words,
        "solver_reference": method.reference,
        **_step_attributes(march),
        "solver_until": float(settings.until),
        "solver_until_units": model.time_unit.text,
        **_error_attributes(march),
        "solver_summation": settings.summation,
        **_switch_attributes(march),
        **_stability(march),
        **_location_attributes(march),
        **_assumed(march.model),
        **delay_attributes(march),
        **_dimension_attributes(march),
        **interpolation_attributes(settings.scheme, model),
        "solver_event_root_method": ROOT_METHODS[settings.event_root_method],
        "solver_event_start": settings.event_start,
        **({"solver_sliding": settings.sliding} if surfaces(march.layout.model) else {}),
        "solver_force_samples": "all" if settings.samples else "none",
        "precision": PRECISION_WORDS[settings.precision],
        "math_functions": settings.math_functions,
        "model_digest": model.digest,
        "force_digest": force_digest(march),
    }
    recorded |= _rests_of_times(settings)
    recorded |= _thinning(march) | _nodes_and_scales(settings, model.time_unit.text)
    displayed = {key: display_text(value) if isinstance(value, str) else value for key, value in recorded.items()}
    return displayed | model.about.attributes | circumstances("simulated")


def _ending_attributes(march: March) -> dict[str, Any]:
    """Return the global attributes that are known after the march: how it ended, its effort, steps beside time scales."""
    end, settings = ending(march), march.settings
    recorded: dict[str, Any] = {}
    if settings.adaptive and not settings.step:
        recorded["solver_first_step"] = float(march.now.first_step) * settings.scales.si_factor(TIME)
    elif not settings.adaptive and not isinstance(settings.step, tuple):
        recorded["solver_last_step"] = _last_step(march)
    recorded |= {"run_rows": int(march.now.rows)} if settings.keep_every > 1 else {}
    return recorded | {
        "run_force_evaluations": int(march.now.evaluations),
        **_effort(march),
        **_landed_on(march),
        "run_accepted_steps": march.accepted,
        "run_rejected_trials": int(march.now.trials),
        **_time_scales(march),
        **({schema.ATOL_EFFECT: march.atol_effect} if march.atol_effect else {}),
        **_accumulation(march),
        "run_outcome": end.outcome.word,
        "run_outcome_text": end.text,
    }


def _accumulation(march: March) -> dict[str, Any]:
    """Return when events that act ever more often would come to an end, where they ended the run."""
    if (accumulated := accumulation(march)) is None:
        return {}
    time, uncertainty = accumulated
    units = march.model.time_unit.text
    return {
        "accumulation_time": time,
        "accumulation_time_units": units,
        "accumulation_time_uncertainty": uncertainty,
        "accumulation_time_uncertainty_units": units,
    }


def _thinning(march: March) -> dict[str, Any]:
    """Return which rows and columns the record leaves out, by which rule, and whether its archive is compressed."""
    settings = march.settings
    recorded: dict[str, Any] = {}
    if settings.keep_every > 1:
        recorded |= {schema.KEEP_EVERY: settings.keep_every, f"{schema.KEEP_EVERY}_rule": KEPT_ROWS}
    if settings.log != FULL:
        log = settings.log if isinstance(settings.log, str) else schema.CHOSEN
        recorded |= {schema.LOG: log, f"{schema.LOG}_rule": KEPT_COLUMNS}
        recorded |= {} if isinstance(settings.log, str) else {schema.LOGGED: names_as_words(settings.log)}
        left_out = left_out_tolerances(march)
        recorded |= {schema.LEFT_OUT_ATOL: json.dumps(left_out, ensure_ascii=False)} if left_out else {}
    if settings.compress:
        recorded[schema.COMPRESSION] = schema.COMPRESSION_WORDS
    return recorded


def _rests_of_times(settings: Settings) -> dict[str, Any]:
    """Return the rests of given times beside their recorded floats, where numbers are sums of two floats."""
    if settings.precision != DOUBLE_DOUBLE:
        return {}
    rests: dict[str, Any] = {"solver_until": rest_of_time(settings.until)}
    if isinstance(settings.step, float) and not settings.adaptive:
        rests["solver_step"] = rest_of_time(settings.step)
    if settings.nodes:
        rests["solver_nodes"] = np.array([rest_of_time(node) for node in settings.nodes])
    return {schema.rest_name(name): remainder for name, remainder in rests.items()}


def _nodes_and_scales(settings: Settings, second: str) -> dict[str, Any]:
    """Return the times that the march was to land on, and the scales of its nondimensional variables."""
    recorded: dict[str, Any] = {}
    if settings.nodes:
        recorded |= {"solver_nodes": np.array(settings.nodes), "solver_nodes_units": second}
    if settings.scales != UNSCALED:
        for name, unit in (SCALES | {"time": second}).items():
            recorded |= {f"solver_{name}_scale": getattr(settings.scales, name), f"solver_{name}_scale_units": unit}
    return recorded


def interpolation_attributes(scheme: Scheme, model: Model, rule: str = REINTEGRATE) -> dict[str, Any]:
    """Describe the interpolation between the accepted states of a run."""
    return {
        "solver_interpolation": scheme.interpolation(model, rule),
        "solver_interpolation_order": scheme.interpolation_order(rule),
    }


def interpolation_orders(scheme: Scheme, layout: Layout, rule: str = REINTEGRATE) -> dict[str, int]:
    """Return the order of the interpolation for every coordinate, velocity and state; one with dimensions has one order."""
    orders = dict.fromkeys((block.name for block in layout.used.blocks), scheme.interpolation_order(rule))
    if rule == INTERPOLANT and scheme.interpolant.of_coordinates:
        coordinates = (block.name for block in layout.coordinates.blocks)
        orders |= dict.fromkeys(coordinates, scheme.interpolant.of_coordinates)
    return orders


def force_digest(march: March) -> str:
    """Return the sha256 of the law's text and of every Python function: the revision of the force function."""
    functions = "".join(function.digest for function in march.model.python_functions)
    if not functions:
        return march.law.source_digest
    return hashlib.sha256((march.law.source + functions).encode()).hexdigest()


def _switch_attributes(march: March) -> dict[str, str]:
    """Describe the treatment of switches hidden in forces, if there are any."""
    choice, watched = march.settings.switches, watched_switches(march.model)
    if not watched:
        return {}
    if choice == LANDED_ON:
        return {"solver_switches": choice, "solver_switches_landed_on": " ".join(landed_on(march.model))}
    if choice == STEPPED_OVER or not any(switch.nested for switch in watched):
        return {"solver_switches": choice}
    where = EVERYWHERE if choice == LOCATED_EVERYWHERE else "where the side of the where around them holds"
    return {"solver_switches": LOCATED, "solver_switches_watched": where}


def _stability(march: March) -> dict[str, str]:
    """Report where a fixed step was not compared with the stability limit at the start."""
    if march.settings.adaptive or not beyond_eigenvalues(march.model):
        return {}
    return {"solver_stability_rule": f"not looked at: the state has more than {MOST_NUMBERS} numbers"}


def _time_scales(march: March) -> dict[str, Any]:
    """Compare steps with the fastest time scale and the span with the slowest, or report that this was not done."""
    if march.model.delays:
        return {"run_h_omega_rule": "not looked at: forces read delayed values"}
    scales = time_scales(march)
    if scales is None:
        return {"run_h_omega_rule": "not looked at: the forces give no finite rate at the start"}
    reported: dict[str, Any] = {
        "run_fastest_rate": scales.rate,
        "run_fastest_rate_units": NUMBERS.per(march.model.time_unit).text,
        "run_h_omega_start": scales.start,
        "run_h_omega_largest": scales.largest,
        "run_h_omega_rule": RULE.format(rows=scales.rows),
    }
    if np.isfinite(scales.period):
        span = float(march.now.t) * march.settings.scales.si_factor(TIME) - march.model.statement.initial["t"].si
        reported |= {
            "run_slowest_period": scales.period,
            "run_slowest_period_units": march.model.time_unit.text,
            "run_slowest_periods": float(f"{span / scales.period:.3g}"),
        }
    elif np.isnan(scales.period):
        reported["run_slowest_period_rule"] = f"not looked at: the state has more than {FEW} numbers"
    return reported


def _assumed(model: Model) -> dict[str, str]:
    """Name the coordinates that start at rest because no velocity is given."""
    at_rest = model.statement.at_rest
    return {schema.AT_REST: " ".join(at_rest)} if at_rest else {}


def _dimension_attributes(march: March) -> dict[str, str]:
    """Name the model's dimensions and relations, with their sizes, and those of elements that the log names."""
    sized_dims = " ".join(
        filter(None, (sized(shapes, {*shapes.relations, *shapes.extents}) for shapes in march_shapes(march)))
    )
    return {schema.MODEL_DIMENSIONS: sized_dims} if sized_dims else {}


def _location_attributes(march: March) -> dict[str, Any]:
    """Return the time tolerance of events that have none of their own, if there are events."""
    if not march.layout.watched:
        return {}
    second = march.model.time_unit.text
    return {"solver_time_tolerance": march.settings.time_tolerance, "solver_time_tolerance_units": second}


def _step_attributes(march: March) -> dict[str, Any]:
    """Describe how steps were chosen."""
    settings, pacing, second = march.settings, march.settings.pacing, march.model.time_unit.text
    if isinstance(settings.step, tuple):
        return {
            "solver_step_control": "given",
            "solver_grid": f"the steps of {schema.GIVEN_STEP.name}, cut at nodes, events and the end",
        }
    if not settings.adaptive:
        return {
            "solver_step_control": "fixed",
            "solver_step": float(settings.step or 0.0),
            "solver_step_units": second,
            "solver_grid": "t0 + n*h; steps are cut at nodes, events and the end",
        }
    return {
        "solver_step_control": "adaptive",
        "solver_controller": settings.scheme.controller,
        **({"solver_first_step": float(settings.step)} if settings.step else {}),
        "solver_first_step_units": second,
        "solver_first_step_choice": "given" if settings.step else first_step_rule(settings.method),
        "solver_safety": pacing.safety,
        "solver_growth_limits": np.array(pacing.growth_limits),
        "solver_min_step": pacing.min_step,
        "solver_min_step_units": second,
        "solver_min_step_rule": f"never below {SPACINGS:g} spacings of t in double precision",
        **_longest(march),
        "solver_max_steps": pacing.max_steps,
    }


def _order_choice(settings: Settings) -> dict[str, str]:
    """Return why the method is of its order, where there are several."""
    if not settings.method.has_orders:
        return {}
    rule = ORDER_RULE if settings.adaptive else f"{ORDER_RULE} for rtol = 1e-6"
    return {schema.ORDER_CHOICE: schema.GIVEN if settings.order_given else rule}


def _longest(march: March) -> dict[str, Any]:
    """Return the longest step: the span, unless it was given."""
    max_step = march.settings.pacing.max_step
    span = march.settings.until - march.model.statement.initial["t"].si
    longest, choice = (max_step, "given") if isfinite(max_step) else (span, "the span")
    second = march.model.time_unit.text
    return {"solver_max_step": longest, "solver_max_step_units": second, "solver_max_step_choice": choice}


# how forces and impulses of contacts are chosen; for archives without these words see `NAMED_ARITHMETIC` of `evidence.comparing.bits`
SHARED = "least norm where the motion does not determine them, as of supports that give way alike"
BY_PATHS = "one link after the other, then by Lemke's paths with less and less compliance"


def _error_attributes(march: March) -> dict[str, Any]:
    """Describe how local errors were estimated and scaled, and how equations were solved."""
    settings = march.settings
    reported: dict[str, Any] = {"solver_estimator": settings.estimator} | _constraint_attributes(march)
    if settings.scheme.estimates:
        reported["solver_error_estimate"] = ESTIMATE_WORDS[settings.estimator]
        reported["solver_error_exponent"] = settings.scheme.error_order  # k of an estimate that falls as h**k
    if settings.scheme.error_lines:
        reported["solver_error_equations"] = printed_lines(settings.scheme.error_equations, march.model)
    if settings.tolerances is not None:
        scheme, rtol = settings.scheme, settings.tolerances.rtol
        reported |= {
            "solver_rtol": rtol,
            "solver_rtol_used": scheme.effective_rtol(rtol),
            "solver_error_norm": "; ".join(filter(None, [ERROR_NORM, scheme.effective_rtol_text])),
        }
        if march.run.plan[0].follows:
            reported["solver_atol_rule"] = ATOL_RULE
            if march.run.plan[0].rounding > 0.0:
                reported[schema.ATOL_FLOOR_RULE] = ATOL_FLOORS[settings.atol_floor]
    return reported | _contact_arithmetic(march) | solver_of(settings.method).reported(settings, march.law)


def _contact_arithmetic(march: March) -> dict[str, Any]:
    """Say how forces and impulses of contacts are solved for where these are not the only solution."""
    rubs = any(contact.slip is not None for contact in march.model.assemblies.values())
    locates = march.settings.method.stepper.locates
    if rubs and not locates:
        return {schema.CONTACT_ARITHMETIC: BY_PATHS}
    return {schema.CONTACT_ARITHMETIC: SHARED} if locates and may_be_indeterminate(march.model) else {}


def _constraint_attributes(march: March) -> dict[str, Any]:
    """Describe how constraints were satisfied: by impulses of the method, or by projection after each step."""
    if not march.model.constraints:
        return {}
    words = KEPT_BY_IMPULSES if march.settings.method.constrained_update else KEPT_BY_PROJECTION
    return {"solver_constraints": words, "solver_constraint_tolerance": CONSTRAINT_TOLERANCE}


def _landed_on(march: March) -> dict[str, int]:
    """Count the points of tables that were landed on without an event."""
    if march.settings.switches != LANDED_ON:
        return {}
    tables = landed_on(march.model)
    seen = [int(march.run.watches[i].seen) for i, part in enumerate(march.layout.watched) if part.name in tables]
    return {"run_kinks_landed_on": sum(seen)}


def _effort(march: March) -> dict[str, int]:
    """Count an implicit method's Jacobian evaluations and factorisations."""
    if not march.settings.method.solves:
        return {}
    return {"run_jacobian_evaluations": int(march.now.jacobians), "run_factorisations": int(march.now.factorisations)}


def _last_step(march: March) -> str:
    """Describe whether the end lay on the grid."""
    if march.now.status != COMPLETED:
        return "none: the run ended before"
    plan = march.run.plan[0]
    steps = (plan.end - plan.start) / plan.step_size
    partial = abs(steps - round(steps)) * plan.step_size > plan.snap * max(abs(plan.start), abs(plan.end))
    full_steps = int(steps)
    last_step_size = (float(plan.end) - (plan.start + full_steps * plan.step_size)) * march.settings.scales.si_factor(
        TIME
    )
    return (
        f"partial, {last_step_size:.9g}{unit_suffix(march.model.time_unit)}: the span is no multiple of the step"
        if partial
        else "whole"
    )


_SHOWN = 60  # characters of a value that are kept; longer values are abbreviated with a digest


def identity(march: March) -> dict[str, str]:
    """Return every word on which the bits of a march depend."""
    program = {
        "version": xdynamics_version(),
        "math_functions": march.settings.math_functions,
        "law": force_digest(march),
    }
    # how an archive is packed changes no bit of the march
    words = dict(_words_of_value("", replace(march.settings, compress=False)))
    return {name: _abbreviated(value) for name, value in (words | program).items()} | {**model_words(march.model)}


@lru_cache(maxsize=8)  # a few models are marched again and again, with other settings
def model_words(model: Model) -> Mapping[str, str]:
    """Return a model as one word for each entry, equal whether elements have numbers or an expression."""
    return {name: _abbreviated(value) for name, value in _words_of_value("model", model.written_out())}


def input_digest(march: March) -> str:
    """Return the digest of all inputs on which the bits of a march depend."""
    return hashlib.sha256(json.dumps(identity(march), sort_keys=True).encode()).hexdigest()


def word_differences(recorded_words: Mapping[str, str], current_words: Mapping[str, str]) -> list[str]:
    """List the words in which two marches differ; the law's digest only if nothing else does."""
    names = [
        name for name in {**recorded_words, **current_words} if recorded_words.get(name) != current_words.get(name)
    ]
    names = [name for name in names if name != "law"] or names
    return [
        f"{name} was {recorded_words.get(name, 'not given')} and is {current_words.get(name, 'not given')}"
        for name in names
    ]


def is_of(run: xr.Dataset, march: March) -> bool:
    """Whether a finished record is of a march's model and law, by this version; settings are not compared."""
    expected_attributes = {
        "force_digest": force_digest(march),
        "xdynamics_version": xdynamics_version(),
        "math_functions": march.settings.math_functions,
    }
    if any(run.attrs.get(name) != value for name, value in expected_attributes.items()):
        return False
    return run.attrs["run_outcome"] != OUTCOMES[INTERRUPTED].word and is_of_model(run, march.model)


def is_of_model(run: xr.Dataset, model: Model) -> bool:
    """Whether a record's model is one, perhaps with numbers where this has an expression."""
    if run.attrs.get("model_digest") == model.digest:
        return True
    with suppress(InputError, KeyError):  # of functions that are not those of this model; of what was left out
        recorded_model = Model.from_record(run["model_toml"].values.item(), functions=model.functions)
        return recorded_model.digest == run.attrs["model_digest"] and model_words(recorded_model) == model_words(model)
    return False


def comes_of(run: xr.Dataset, march: March) -> bool:
    """Whether a finished record is that of a march, including its settings."""
    if not is_of(run, march):
        return False
    settings = settings_for(march.model, **recorded_arguments(run))
    return same_settings(settings, march.settings, variables(march.model))


def same_settings(first_settings: Settings, second_settings: Settings, names: tuple[str, ...]) -> bool:
    """Whether the settings of two marches of a model with these variables agree, however their tolerances are given."""
    return _settings_by_name(first_settings, names) == _settings_by_name(second_settings, names)


def _settings_by_name(settings: Settings, names: tuple[str, ...]) -> dict[str, Any]:
    tolerances = settings.tolerances
    absolute = {f"atol of {name}": tolerances.atol_of(name) for name in names} if tolerances else {}
    return {
        name: value
        for name, value in _words_of_value("", replace(settings, compress=False))
        if not name.startswith(("atol", "bare"))
    } | absolute


def _words_of_value(name: str, value: Any) -> Iterator[tuple[str, str]]:
    """Flatten a value into pairs of a dotted name and a text."""
    if isinstance(value, Method):
        yield name, value.name
    elif isinstance(value, Unit):  # the model's own, which is no setting
        return
    elif is_dataclass(value):
        prefix = "" if isinstance(value, Settings | Tolerances | Pacing) else f"{name}."
        for entry in fields(value):
            yield from _words_of_value(prefix + entry.name, getattr(value, entry.name))
    elif isinstance(value, Mapping):
        for key, entry in value.items():
            yield from _words_of_value(f"{name}.{key}", entry)
    elif value is not None:
        yield name, _value_text(value)


def _value_text(value: Any) -> str:
    """Return a value as a text, numbers with all digits that are known of them."""
    if isinstance(value, list) and {*map(type, value)} != {float}:
        return f"[{', '.join(map(_value_text, value))}]"
    return decimal_text(value) if isinstance(value, float) else repr(value)


def _abbreviated(text: str) -> str:
    if len(text) <= _SHOWN:
        return text
    return f"{text[:20]}… ({len(text)} characters, sha256 {hashlib.sha256(text.encode()).hexdigest()[:16]})"

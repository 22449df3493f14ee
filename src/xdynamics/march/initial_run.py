"""The initial numbers of a run, from a model and its settings, in the march's internal units."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.bounds import EPS, LEAST, LEAST_OF_0_2
from xdynamics.elementary.double_double import nearest
from xdynamics.elementary.double_double.functions import PI
from xdynamics.expressions import Node, limits_domain
from xdynamics.kernels import Law, Layout
from xdynamics.kernels.compiling import PLAINLY, keys_of
from xdynamics.kernels.constraint_programs import CONSTRAIN
from xdynamics.kernels.drive_tables import concatenated_tables
from xdynamics.kernels.law import FORCES
from xdynamics.kernels.layout import curve_degree
from xdynamics.kernels.machine import aligned_zeros
from xdynamics.kernels.program import AT, DEVIATION
from xdynamics.march.assembly.assembly_arrays import arrays_of_assemblies
from xdynamics.march.engine import pressing_address
from xdynamics.march.equation_solvers import solver_of
from xdynamics.march.force_evaluation import PARTS
from xdynamics.march.log import Log, allocate, unwritten
from xdynamics.march.outcomes import RUNNING
from xdynamics.march.past import delay_times, jumps_at, past_arrays
from xdynamics.march.run import KEPT, NOW, PLAN, TRIAL, Run
from xdynamics.march.search_arrays import event_search_arrays
from xdynamics.march.settings import Settings, given_times
from xdynamics.march.tolerance_sizes import BEGINNING, FLOOR, ROUNDED
from xdynamics.march.tolerances import OF_TERMS
from xdynamics.methods.scheme import DOUBLE_DOUBLE, EXTRAPOLATED, UNIT_OF
from xdynamics.methods.steppers import DIFFERENCES, NOTHING
from xdynamics.model import Function, Model
from xdynamics.model.assemblies import max_simultaneous
from xdynamics.model.controllers import Action, actions, alarms, exact_ticks, exact_time, ticks
from xdynamics.model.drive_arguments import CLOCK
from xdynamics.model.elementwise import put_in_si
from xdynamics.model.motion import (
    constant_names,
    constant_values,
    drive_pieces,
    first_regime,
    forces_by_coordinate,
    has_diagonal_mass,
)
from xdynamics.model.reactions import may_be_indeterminate, mode_names
from xdynamics.model.regime_model import switch_inputs
from xdynamics.model.sliding import slid_along, surfaces
from xdynamics.model.switches import LANDED_ON
from xdynamics.reaction_names import PROJECTION
from xdynamics.units import CONSTANTS, TIME, Quantity, Scales, constant
from xdynamics.units.unit import exact_value

Floats = NDArray[np.float64]


def pose_run(model: Model, settings: Settings, law: Law, log: Log, addresses: NDArray[np.int64]) -> Run:
    """Return a run that has not begun."""
    model = settings.layout(model).model  # the model with the sides of its switches
    scales, plan = settings.scales, march_plan(model, settings, law)
    start, end = float(plan["start"][0]), float(plan["end"][0])
    tables, places = concatenated_tables(drive_pieces(model, scales))
    instants, actions_there = _ticks_of(actions(model.elements.controllers), model, settings)
    rings, alarms_there = _ticks_of(alarms(model.elements.events), model, settings)
    requested_nodes = np.concatenate([np.array(settings.nodes) / scales.si_factor(TIME), instants, rings])
    knots = table_nodes(model, scales)
    nodes = np.union1d(knots, requested_nodes) if requested_nodes.size else knots
    nodes = nodes[(nodes > start) & (nodes < end)]
    first_node = nodes[0] if len(nodes) else end  # nothing beyond it matters
    plan["rest"] = BEGINNING * (first_node - start)
    steps_in_si = settings.step if isinstance(settings.step, tuple) else ()
    given_steps = tuple(step / scales.si_factor(TIME) for step in steps_in_si)
    grid, steps = _given_grid(start, given_steps, np.append(nodes, end), float(plan["snap"][0]))
    solver, now = solver_of(law.scheme.method), np.zeros(1, NOW)
    now["rest"] = plan["start_rest"]
    now["t"], now["on_grid"], now["status"], now["regime"] = start, 1, RUNNING, first_regime(model)
    assembly, patterns = arrays_of_assemblies(model, settings, law, _pattern)
    run = Run(
        plan=plan,
        now=now,
        trial=np.zeros(1, TRIAL),
        located=np.zeros(1, TRIAL),
        at=np.zeros(DEVIATION + 1 if law.layout.attitudes else len(AT) * (1 + law.layout.is_doubled)),
        **_state_arrays(model, settings, law, int(plan["samples"][0])),
        **_following_tolerances(settings, law.layout),
        **_law_parameters(model, scales, doubled=law.layout.is_doubled),
        **past_arrays(model, law, scales, tables, places),
        jumps=jumps_at(nodes, knots, np.append(instants, rings)),
        of_time=_drives_of_time(model),
        attitudes=np.array(law.layout.attitudes, np.int64).reshape(-1, PARTS),
        nodes=nodes,
        ticks=_ticks_at(instants, actions_there, np.array([start, *nodes, end])),
        alarms=_ticks_at(rings, alarms_there, np.array([start, *nodes, end])),
        node_rests=_node_rests(model, settings, nodes),
        snaps=float(plan["snap"][0]) * np.maximum(abs(start), np.abs(np.append(nodes, end))),
        grid=grid,
        steps=steps,
        **event_search_arrays(model, law, settings) | assembly,
        w=aligned_zeros(law.memory * (1 + law.layout.is_doubled) + 3 * len(law.layout.smooth)),
        kept=np.zeros(1, KEPT),
        **solver.arrays(law),
        law=np.append(addresses, [law.sizing_address if plan["rounding"][0] > 0.0 else 0, solver.address()]),
        **log.arrays_by_name(),
    )
    run.keepalive = tuple(patterns)  # compiled code has their addresses alone
    if model.assemblies:
        run.p[-2:] = _address_words(run)
    return run


def _drives_of_time(model: Model) -> NDArray[np.int64]:
    """Return the numbers of the drives whose tables are looked up at the time."""
    arguments = model.elements.looked_up_at.values()
    return np.array([i for i, argument in enumerate(arguments) if argument == CLOCK], np.int64)


def _pattern(model: Model, settings: Settings, law: Law) -> Run:
    """Return the run of the pattern of an assembly."""
    return pose_run(model, settings, law, allocate(law.layout, 1, sampled=0), law.addresses)


def _address_words(run: Run) -> Floats:
    """Return the addresses of a run, and of the code that finds forces of closed links, as a law reads them."""
    if PLAINLY:
        return np.array([keys_of([run])[0], pressing_address()], float)
    # the bits of whole numbers in places of floats, as all of `p` are
    return np.array([run.address, pressing_address()], np.int64).view(float)


def addresses_of(law: Law) -> NDArray[np.int64]:
    """Return the addresses of a march's programs; with the interpolant where an event is located on it."""
    on_interpolant = any(detector.event.root_state == "interpolant" for detector in law.layout.watched)
    return law.addresses_inside if on_interpolant else law.addresses


def _state_arrays(model: Model, settings: Settings, law: Law, sampled: int) -> dict[str, Floats]:
    """Return the initial state, its tolerances, and room for trial states."""
    layout = law.layout
    n, events = layout.used.size, len(layout.watched)
    lengths = dict.fromkeys(("y", "z", "half", "whole", "located_z"), layout.record.size)
    lengths |= dict.fromkeys(("e", "located_e", "full_e", "largest"), n)
    lengths |= dict.fromkeys(("g", "g1", "located_g", "near_g", "far_g", "entered", "pending"), events)
    lengths |= dict.fromkeys(("slopes", "arguments"), events + layout.followed.size + 3 * len(layout.tracked))
    lengths |= dict.fromkeys(("near", "far", "full"), layout.record.size if events else 0)
    lengths |= dict.fromkeys(("samples", "located_samples"), sampled * layout.sample_width)
    arrays = {name: unwritten(length) for name, length in lengths.items()}
    put_in_si(model.elements.statement.initial, layout.used, arrays["y"])
    layout.divide_by_sizes(arrays["y"], settings.scales)
    if layout.is_doubled:
        first = n + layout.evaluation.size
        arrays["y"][first : first + n] = [quantity_rest(model.elements.statement.initial[name]) for name in layout.used]
    arrays["atol"] = _initial_atol(law, settings)
    arrays["probe"], arrays["turning"] = unwritten(layout.record.size), unwritten(3 * n - layout.coordinates.size)
    arrays["tops"] = np.zeros(2 * (1 + int(layout.kinds.max())) + 1)
    return arrays


def _initial_atol(law: Law, settings: Settings) -> Floats:
    """Return the absolute tolerances; without any an error may have any size."""
    layout, tolerances = law.layout, settings.tolerances
    if tolerances is None:
        needs_tolerance = layout.estimates or law.scheme.method.solver != NOTHING
        return np.full(layout.used.size, np.inf) if needs_tolerance else unwritten(layout.used.size)
    atols = tolerances.of_all(layout.used)
    # a tolerance that follows its variable is not known yet
    return np.where(np.isnan(atols), 0.0, atols / layout.sizes(settings.scales) * widened(law, tolerances.rtol))


def _following_tolerances(settings: Settings, layout: Layout) -> dict[str, NDArray[np.int16]]:
    """Return which absolute tolerances follow their variables, and the kind of each variable."""
    tolerances = settings.tolerances
    follow = unwritten(layout.used.size, np.int16)
    if tolerances is not None and (nan := np.isnan(tolerances.of_all(layout.used))).any():
        follow[:] = nan
    return {"adaptive_atol": follow, "kinds": layout.kinds}


def march_plan(model: Model, settings: Settings, law: Law) -> NDArray[np.void]:
    """Return the numbers that the march does not change."""
    scale, scheme, pacing, layout = settings.scales.si_factor(TIME), law.scheme, settings.pacing, law.layout
    start, end = model.statement.initial["t"].si / scale, settings.until / scale
    adaptive, tolerances = settings.adaptive, settings.tolerances
    single = settings.step / scale if isinstance(settings.step, float | int) else 0.0
    values = {
        "start": start,
        "end": end,
        "snap": 4.0 * EPS,
        "step_size": 0.0 if adaptive else single,
        "rtol": scheme.effective_rtol(tolerances.rtol) if tolerances else 0.0,
        "floor": floor_of(scheme.effective_rtol(tolerances.rtol), UNIT_OF[scheme.precision]) if tolerances else 0.0,
        "rest": 0.0,  # known with the nodes
        "rounding": ROUNDED * UNIT_OF[scheme.precision] if _weighs(settings, law) else 0.0,
        "order": scheme.error_order,
        "safety": pacing.safety,
        "least": pacing.growth_limits[0],
        "greatest": pacing.growth_limits[1],
        "min_step": pacing.min_step / scale,
        "max_step": min([pacing.max_step / scale, *delay_times(model, settings.scales)]),
        "first_step": single if adaptive else 0.0,
        "most_steps": pacing.max_steps if adaptive else np.inf,
        "divisor": 2.0**scheme.method.order - 1.0,
        "adaptive": adaptive,
        "differences": scheme.jacobian == DIFFERENCES,
        "estimates": scheme.estimates,
        "steps": scheme.steps,
        "extrapolated": scheme.estimator == EXTRAPOLATED,
        "limited": _limits_domain(model),
        "stages": scheme.stages,
        "samples": scheme.samples if law.sampled else 0,
        "coordinates": layout.coordinates.size,
        "kinetic": layout.row.index("kinetic_energy") if "kinetic_energy" in layout.derived else -1,
        "used": layout.used.size,
        "follows": tolerances is not None and bool(np.isnan(tolerances.of_all(layout.used)).any()),
        "state": layout.state.size,
        "regime": first_regime(model),
        "evaluated": layout.evaluation.size,
        "reactions": layout.reactions.size,
        "indeterminate": may_be_indeterminate(model),
        **_switch_plan(layout, settings),
        "apart": settings.locates_one_by_one,
        "margin": LEAST_OF_0_2 if settings.locates_one_by_one else LEAST,
        "pressed": layout.state.size - layout.reactions.size,
        **_contact_plan(model, law),
        **_left_polynomial(law),
        **_rests_of_grid(model, layout, single),
        **_constraint_plan(model, law),
        "series": scheme.method.order if scheme.method.stepper.foresees and adaptive else 0,
    }
    return np.array([tuple(values[name] for name in PLAN.names or ())], PLAN)


def _weighs(settings: Settings, law: Law) -> bool:
    """Whether tolerances follow, and are at least a share of the terms that cancel."""
    tolerances = settings.tolerances
    follows = tolerances is not None and bool(np.isnan(tolerances.of_all(law.layout.used)).any())
    return follows and settings.atol_floor == OF_TERMS and law.is_sized


def _contact_plan(model: Model, law: Law) -> dict[str, int]:
    """Return how many assemblies of bodies there are, and whether their impacts are located or stepped over."""
    located = law.scheme.method.stepper.locates
    return {
        "assemblies": len(model.assemblies),
        "steps_over": int(not located),
        "together": max_simultaneous(model),
    }


def _switch_plan(layout: Layout, settings: Settings) -> dict[str, int]:
    """Return the number of switches, whether those of tables are passed without events, and those that are slid along."""
    count = len(layout.switches)
    return {
        "switches": count,
        "passing": int(settings.switches == LANDED_ON),
        "slides": bool(surfaces(layout.model)),
        "along": len(slid_along(layout.model)),
        "resumes": 0,
    }


def _rests_of_grid(model: Model, layout: Layout, step: float) -> dict[str, float]:
    """Return whether numbers are sums of two floats, and the rests of the start and of the step."""
    if not layout.is_doubled:
        return {"doubled": 0, "start_rest": 0.0, "step_rest": 0.0}
    return {"doubled": 1, "start_rest": quantity_rest(model.statement.initial["t"]), "step_rest": rest_of_time(step)}


def _left_polynomial(law: Law) -> dict[str, int]:
    """Return the degree of the polynomial that a step leaves, where its coefficients begin, the number of their program."""
    program = FORCES + len(law.printed.names) - 1
    return {"degree": curve_degree(law.layout), "curve": law.curve, "polynomial": program}


def _constraint_plan(model: Model, law: Law) -> dict[str, int]:
    """Return the number of the constraints' program, the index of its correction, and whether it moves the start."""
    if not model.constraints:
        return {"held": 0, "moved": 0, "consistent": 0}
    projection_index = law.layout.record.offset_of(PROJECTION.name)
    return {
        "held": FORCES + law.printed.names.index(CONSTRAIN),
        "moved": projection_index,
        "consistent": int(model.consistent),
    }


def floor_of(rtol: float, unit: float = EPS) -> float:
    """Return the least absolute tolerance that follows its variable, over the largest of its kind."""
    return max(FLOOR * rtol, ROUNDED * unit)


def widened(law: Law, rtol: float) -> float:
    """Return the factor on absolute tolerances that keeps their ratio to the relative one."""
    return law.scheme.effective_rtol(rtol) / rtol


def table_nodes(model: Model, scales: Scales) -> Floats:
    """Return the breakpoints of drives of time, ascending."""
    pairs = zip(model.elements.looked_up_at.values(), drive_pieces(model, scales), strict=True)
    times = [origins[np.isfinite(origins)] for argument, (origins, _) in pairs if argument == CLOCK]
    return np.unique(np.concatenate(times)) if times else np.empty(0)


def _ticks_of(acting: tuple[Action, ...], model: Model, settings: Settings) -> tuple[Floats, NDArray[np.int64]]:
    """Return the times of actions, and the actions at each as bits of a number."""
    if not acting:
        return np.empty(0), np.empty(0, np.int64)
    first, last = exact_time(model.statement.initial["t"]), exact_value(settings.until)
    instants, actions_there = ticks(acting, first, last)
    return instants / settings.scales.si_factor(TIME), actions_there


def _ticks_at(instants: Floats, actions_there: NDArray[np.int64], times: Floats) -> NDArray[np.int64]:
    """Return the actions at given times, ascending, as bits; none where there are no ticks."""
    if not instants.size:
        return np.empty(0, np.int64)
    places = np.minimum(np.searchsorted(instants, times), instants.size - 1)
    # equal to the bit, as nodes were made of these very instants
    return np.where(instants[places] == times, actions_there[places], 0)


def _given_grid(start: float, steps: tuple[float, ...], nodes: Floats, snap: float) -> tuple[Floats, Floats]:
    """Return the times that given steps lead to, snapped to nodes close by, and the steps."""
    times, t, end = [], start, float(nodes[-1])
    for aim, step in zip(given_times(start, steps, end), steps, strict=True):
        t = end if aim == end else t + step
        near = nodes[np.abs(nodes - t) <= snap * np.maximum(abs(start), np.abs(nodes))]
        t = float(near[0]) if near.size else t
        times.append(t)
    return np.array(times, np.float64), np.array(steps, np.float64)


def _law_parameters(model: Model, scales: Scales, *, doubled: bool) -> dict[str, Floats]:
    """Return the parameters that a law reads; the modes of contacts are the end of them."""
    known_values = constant_values(model, scales)
    values = np.append(known_values, [0.0] * (2 * bool(model.assemblies)))  # room for addresses, see `_entered`
    if doubled:
        values = np.append(values, [_constant_rest(model, name) for name in constant_names(model)])
    changing = len(mode_names(model)) + len(switch_inputs(model))
    return {"p": values, "modes": values[known_values.size - changing : known_values.size]}


def _constant_rest(model: Model, name: str) -> float:
    """Return the rest of a constant beside the nearest float."""
    if name in model.elements.statement.parameters:
        return quantity_rest(model.elements.statement.parameters[name].quantity)
    if name == "pi":
        return PI.low
    return nearest(constant(name).factor).low if name in CONSTANTS or name in model.statement.calendar else 0.0


def quantity_rest(quantity: Quantity) -> float:
    """Return the rest of a quantity in SI units beside the nearest float."""
    return nearest(exact_value(quantity.value) * quantity.unit.factor).low


def rest_of_time(time: float) -> float:
    """Return the rest of a time beside its float."""
    return nearest(exact_value(time)).low


def _node_rests(model: Model, settings: Settings, nodes: Floats) -> Floats:
    """Return the rests of every node and of the end; breakpoints of tables are plain floats."""
    if settings.precision != DOUBLE_DOUBLE:
        return np.empty(0)
    low_parts = {time: rest_of_time(time) for time in (*settings.nodes, settings.until)}
    first, last = exact_time(model.statement.initial["t"]), exact_value(settings.until)
    low_parts |= {
        float(time): nearest(time).low
        for time in exact_ticks((*actions(model.elements.controllers), *alarms(model.elements.events)), first, last)
    }
    return np.array([low_parts.get(time, 0.0) for time in (*nodes.tolist(), settings.until)])


@lru_cache(maxsize=64)
def _limits_domain(model: Model) -> bool:
    """Whether the model has functions or tables with a limited domain."""
    limited = any(map(limits_domain, _moving_trees(model if has_diagonal_mass(model) else model.elements)))
    return limited or any(drive.outside == "error" for drive in model.elements.drives.values())


def _moving_trees(model: Model) -> Iterator[Node]:
    """Yield the forces, masses and rates of a model, without functions in Python."""
    parts = [part for terms in forces_by_coordinate(model).values() for part in terms.values()]
    rates = [state.rate for state in model.statement.states.values()]
    for part in (*parts, *model.statement.mass_entries.values(), *rates):
        if not isinstance(part, Function):
            yield model.expanded(part)

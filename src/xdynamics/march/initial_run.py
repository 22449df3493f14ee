"""The initial numbers of a run, from a model and its settings, in the march's internal units."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.rounding_margins import LEAST, LEAST_OF_0_2
from xdynamics.expressions import Node, limits_domain
from xdynamics.kernels import Law, Layout
from xdynamics.kernels.compiling import keys_of
from xdynamics.kernels.drive_tables import flattened
from xdynamics.kernels.interval_program import NUMBER, UNKNOWN, VARIABLE, Enclosing, enclosing
from xdynamics.kernels.interval_program import TIME as INSTANTS
from xdynamics.kernels.law import FORCES
from xdynamics.kernels.program import AT
from xdynamics.kernels.step_programs import curve_degree
from xdynamics.march.assembly.tables import assembled
from xdynamics.march.engine import assemblies as meeting
from xdynamics.march.engine import contacts, pressing, watchers
from xdynamics.march.equation_solvers import solver_of
from xdynamics.march.events.event_free_region import BOX, INSTANT, OTHER, POSITION
from xdynamics.march.events.intervals import rules
from xdynamics.march.handle import PLAINLY
from xdynamics.march.log import Log, allocate
from xdynamics.march.outcomes import RUNNING
from xdynamics.march.run import (
    BALANCE,
    DETECTOR,
    HOLD,
    KEPT,
    LINK,
    NOW,
    PIECE,
    PLAN,
    REACTION,
    STEP_IN_TIME,
    TOUCH,
    TRIAL,
    WATCH,
    Run,
)
from xdynamics.march.settings import EPS, Settings, given_times
from xdynamics.march.tolerance_sizes import BEGINNING, FLOOR, ROUNDED
from xdynamics.methods.scheme import EXTRAPOLATED
from xdynamics.methods.steppers import DIFFERENCES
from xdynamics.model import Function, Model
from xdynamics.model.assemblies import PATTERN, together
from xdynamics.model.detectors import KINK, SWITCH
from xdynamics.model.elementwise import in_si
from xdynamics.model.motion import constants, first_regime, tables_of
from xdynamics.model.parts import ACTIONS, IMPACT_LAWS
from xdynamics.model.reactions import DRY, NORMAL, modes, reactions
from xdynamics.model.switches import borders, switch_inputs
from xdynamics.model.whole import acting, has_wholes, written_out
from xdynamics.schema import acceleration, velocity
from xdynamics.units import TIME, Scales

Floats = NDArray[np.float64]

DEEPEST = 64  # halvings of a step in search of events
_DIRECTIONS = {"rising": 1, "falling": -1, "either": 0}


def posed(model: Model, settings: Settings, law: Law, log: Log, addresses: NDArray[np.int64]) -> Run:
    """Return a run that has not begun."""
    model = settings.layout(model).model  # the model with the sides of its switches
    scales, plan = settings.scales, planned(model, settings, law)
    start, end = float(plan["start"][0]), float(plan["end"][0])
    tables, places = flattened(tables_of(model, scales))
    requested_nodes = np.array(settings.nodes) / scales.of(TIME)
    nodes = np.union1d(nodes_of(model, scales), requested_nodes) if requested_nodes.size else nodes_of(model, scales)
    nodes = nodes[(nodes > start) & (nodes < end)]
    plan["rest"] = BEGINNING * (
        nodes[0] - start if len(nodes) else end - start
    )  # nothing beyond the first node matters
    given_steps = tuple(step / scales.of(TIME) for step in settings.step) if isinstance(settings.step, tuple) else ()
    grid, steps = _given(start, given_steps, np.append(nodes, end), float(plan["snap"][0]))
    solver, now = solver_of(law.scheme.method), np.zeros(1, NOW)
    now["t"], now["on_grid"], now["status"], now["regime"] = start, 1, RUNNING, first_regime(model)
    assembly, patterns = assembled(model, settings, law, _pattern)
    run = Run(
        plan=plan,
        now=now,
        trial=np.zeros(1, TRIAL),
        located=np.zeros(1, TRIAL),
        at=np.zeros(len(AT)),
        **_states(model, settings, law, int(plan["samples"][0])),
        **_following(settings, law.layout),
        **_parameters(model, scales),
        tables=tables,
        places=places,
        of_time=np.array([i for i, drive in enumerate(model.drives.values()) if drive.argument == "t"], np.int64),
        nodes=nodes,
        snaps=float(plan["snap"][0]) * np.maximum(abs(start), np.abs(np.append(nodes, end))),
        grid=grid,
        steps=steps,
        **_watching(model, law, settings) | assembly,
        w=np.zeros(law.memory + 3 * len(law.layout.smooth)),
        kept=np.zeros(1, KEPT),
        **solver.arrays(law),
        law=np.append(addresses, solver.address()),
        **log.named(),
    )
    run.holds = tuple(patterns)
    if model.assemblies:
        run.p[-2:] = _words(run)
    return run


def _pattern(model: Model, settings: Settings, law: Law) -> Run:
    """Return the run of the pattern of an assembly."""
    return posed(model, settings, law, allocate(law.layout, 1, sampled=0), law.addresses)


def _words(run: Run) -> Floats:
    """Return the addresses of a run, and of the code that finds forces of closed links, as a law reads them."""
    if PLAINLY:
        return np.array([keys_of([run])[0], pressing()], float)
    return np.array([run.address, pressing()], np.int64).view(float)


def _of_contacts(model: Model, layout: Layout) -> list[int]:
    """Return the addresses of the code of contacts, and of those of many links, where a model has them."""
    if model.assemblies:
        return [0, meeting()]
    return [contacts()] if layout.reactions and PATTERN not in model.contacts else []


def addresses_of(law: Law) -> NDArray[np.int64]:
    """Return the addresses of a march's programs; with the interpolant where an event is located on it."""
    inside = any(detector.event.root_state == "interpolant" for detector in law.layout.watched)
    return law.addresses_inside if inside else law.addresses


def _states(model: Model, settings: Settings, law: Law, sampled: int) -> dict[str, Floats]:
    """Return the initial state, its tolerances, and room for trial states."""
    layout, tolerances = law.layout, settings.tolerances
    sizes = layout.sizes(settings.scales)
    n, events = layout.used.size, len(layout.watched)
    lengths = dict.fromkeys(("y", "z", "half", "whole", "located_z"), layout.record.size)
    lengths |= dict.fromkeys(("e", "located_e", "full_e", "largest"), n)
    lengths |= dict.fromkeys(("g", "g1", "located_g", "near_g", "far_g", "entered", "pending"), events)
    lengths["slopes"] = events + len(layout.followed)
    lengths |= dict.fromkeys(("near", "far", "full"), layout.record.size if events else 0)
    lengths |= dict.fromkeys(("samples", "located_samples"), sampled * layout.sample_width)
    arrays = {name: np.zeros(length) for name, length in lengths.items()}
    arrays["y"][:n] = in_si(model.initial, layout.used) / sizes
    # without tolerances an error may have any size
    wider = widened(law, tolerances.rtol) if tolerances else 1.0
    atols = np.full(n, np.inf) if tolerances is None else tolerances.of_all(layout.used)
    # a tolerance that follows its variable is not known yet
    arrays["atol"] = np.where(np.isnan(atols), 0.0, atols / sizes * wider)
    arrays["probe"], arrays["turning"] = np.zeros(layout.record.size), np.zeros(4 * n)
    arrays["tops"] = np.zeros(2 * (1 + int(layout.kinds.max())))
    return arrays


def _following(settings: Settings, layout: Layout) -> dict[str, NDArray[np.int64]]:
    """Return which absolute tolerances follow their variables, and the kind of each variable."""
    tolerances = settings.tolerances
    follow = np.zeros(layout.used.size, bool) if tolerances is None else np.isnan(tolerances.of_all(layout.used))
    return {"followers": follow.astype(np.int64), "kinds": layout.kinds.copy()}


def planned(model: Model, settings: Settings, law: Law) -> NDArray[np.void]:
    """Return the numbers that the march does not change."""
    scale, scheme, pacing, layout = settings.scales.of(TIME), law.scheme, settings.pacing, law.layout
    start, end = model.initial["t"].si / scale, settings.until / scale
    adaptive, tolerances = settings.adaptive, settings.tolerances
    single = settings.step / scale if isinstance(settings.step, float | int) else 0.0
    values = {
        "start": start,
        "end": end,
        "snap": 4.0 * float(np.finfo(float).eps),
        "step_size": 0.0 if adaptive else single,
        "rtol": scheme.inner(tolerances.rtol) if tolerances else 0.0,
        "floor": floor_of(scheme.inner(tolerances.rtol)) if tolerances else 0.0,
        "rest": 0.0,  # known with the nodes
        "order": scheme.error_order,
        "safety": pacing.safety,
        "least": pacing.growth_limits[0],
        "greatest": pacing.growth_limits[1],
        "min_step": pacing.min_step / scale,
        "max_step": pacing.max_step / scale,
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
        "switches": sum(detector.role in (SWITCH, KINK) for detector in layout.watched),
        "contacts": HOLD if scheme.method.stepper.locates else STEP_IN_TIME,
        "apart": settings.apart,
        "margin": LEAST_OF_0_2 if settings.apart else LEAST,
        "pressed": layout.state.size - layout.reactions.size,
        "assemblies": len(model.assemblies),
        "together": together(model),
        "degree": curve_degree(layout),
        "curve": law.curve,
        "polynomial": FORCES + len(law.printed.names) - 1,
    }
    return np.array([tuple(values[name] for name in PLAN.names or ())], PLAN)


def floor_of(rtol: float) -> float:
    """Return the least absolute tolerance that follows its variable, over the largest of its kind."""
    return max(FLOOR * rtol, ROUNDED * EPS)


def widened(law: Law, rtol: float) -> float:
    """Return the factor on absolute tolerances that keeps their ratio to the relative one."""
    return law.scheme.inner(rtol) / rtol


def nodes_of(model: Model, scales: Scales) -> Floats:
    """Return the breakpoints of drives of time, ascending."""
    times = [drive.table.argument / scales.of(TIME) for drive in model.drives.values() if drive.argument == "t"]
    return np.unique(np.concatenate(times)) if times else np.empty(0)


def _given(start: float, steps: tuple[float, ...], nodes: Floats, snap: float) -> tuple[Floats, Floats]:
    """Return the times that given steps lead to, snapped to nodes close by, and the steps."""
    times, t, end = [], start, float(nodes[-1])
    for aim, step in zip(given_times(start, steps, end), steps, strict=True):
        t = end if aim == end else t + step
        near = nodes[np.abs(nodes - t) <= snap * np.maximum(abs(start), np.abs(nodes))]
        t = float(near[0]) if near.size else t
        times.append(t)
    return np.array(times, np.float64), np.array(steps, np.float64)


def _parameters(model: Model, scales: Scales) -> dict[str, Floats]:
    """Return the parameters that a law reads; the modes of contacts are the end of them."""
    known = constants(model, scales)
    values = np.array([*known.values(), *[0.0] * (2 * bool(model.assemblies))])  # room for addresses, see `_entered`
    changing = len(modes(model)) + len(switch_inputs(model))
    return {"p": values, "modes": values[len(known) - changing : len(known)]}


def _watching(model: Model, law: Law, settings: Settings) -> dict[str, NDArray[Any]]:
    """Return the arrays of the search for events."""
    watched = law.layout.watched
    intervals, depth, events = enclosing(law.layout), DEEPEST if watched else 0, len(watched)
    places = {
        "under": np.zeros(intervals.values),
        "over": np.zeros(intervals.values),
        "flaws": np.zeros(intervals.values, np.int64),
        "wanted": np.zeros(intervals.values, np.int64),
    }
    operations = rules(law.scheme.math_functions, intervals.rules, curve_degree(law.layout))
    functions = [*operations, *watchers()] if watched else []
    return (
        places
        | _touching(model, settings)
        | {
            "detectors": _detectors(law.layout, intervals, settings),
            "watches": np.zeros(events, WATCH),
            **_region(law.layout, intervals, settings),
            "resets": np.zeros(len(law.layout.resets)),
            "targets": np.array(_targets(law), np.int64).reshape(-1, 2),
            "piece": np.zeros(1, PIECE),
            "rows": intervals.rows,
            "numbers": intervals.numbers,
            "parts": np.array(intervals.parts, np.int64),
            "branches": np.zeros((depth, 1 + law.layout.record.size + events)),
            "functions": np.array([*functions, *_of_contacts(model, law.layout)], np.int64),
        }
    )


def _region(layout: Layout, intervals: Enclosing, settings: Settings) -> dict[str, NDArray[Any]]:
    """Return the arrays of a region without events; empty where contacts read gaps in every step."""
    rows = {k: intervals.rows[k].tolist() for k in range(intervals.parts[0], intervals.parts[1])}
    disabled = layout.reactions or settings.apart or any(row[0] == UNKNOWN for row in rows.values())
    leaves = []
    for k, (row, target, i, *_) in rows.items() if not disabled else ():
        if row == VARIABLE and not curve_degree(layout):
            leaves.append((POSITION, i, target))
        elif VARIABLE <= row < NUMBER or row == INSTANTS:
            leaves.append((INSTANT if row == INSTANTS else OTHER, k, target))
    return {"leaves": np.array(leaves, np.int64).reshape(-1, 3), "region": np.zeros(BOX + 4 * len(leaves))}


def _touching(model: Model, settings: Settings) -> dict[str, NDArray[Any]]:
    """Return the arrays of contacts and friction elements, with room for the problems that they pose."""
    all_reactions, scales = reactions(model), settings.scales
    m, n = len(all_reactions), len(model.coordinates)
    unknowns = sum(1 if reaction.sort == NORMAL else 3 for reaction in all_reactions)
    fixed = np.zeros(m, REACTION)
    for row, reaction in zip(fixed, all_reactions, strict=True):
        part: Any = model.frictions[reaction.owner] if reaction.sort == DRY else model.contacts[reaction.owner]
        row.role, row.normal, row.tolerance, row.rest_height = (
            reaction.sort,
            reaction.normal,
            settings.located_within(part.time_tolerance) / scales.of(TIME),
            -1.0,
        )
        if reaction.sort == NORMAL:
            row.law = IMPACT_LAWS.index(part.law)
            if part.rest_height is not None:
                row.rest_height = part.rest_height.si / scales.of(part.rest_height.unit.dimension)
    return {
        "reactions": fixed,
        "touches": np.zeros(m, TOUCH),
        "swiftest": np.zeros(m),
        "lingering": np.zeros(m),
        "entry": np.zeros(2 * n if m else 0),
        "balance": np.zeros(BALANCE),
        **{name: np.zeros(m) for name in ("approach", "slowed", "pulled")},
        **_linked(m, n),
        "problem": np.zeros((unknowns, 2 * unknowns + 2)),
        "basis": np.zeros(unknowns, np.int64),
        "solution": np.zeros(unknowns),
        "effects": np.zeros((m, unknowns)),
        "square": np.zeros(m * m),
        "column": np.zeros(m),
        "chosen": np.zeros(m, np.int64),
    }


def _linked(m: int, n: int) -> dict[str, NDArray[Any]]:
    """Return the contact tables of m reactions and n coordinates, and their parts as `model.reactions.table` lists them."""
    width = len(LINK.names or ())
    tables = np.zeros((width + m + 2 * n) * m)
    numbers, delassus, directions, responses = np.split(tables, np.cumsum([width * m, m * m, m * n]))
    return {
        "contact_tables": tables,
        "links": numbers.view(LINK),
        "delassus": delassus.reshape(m, m),
        "directions": directions.reshape(m, n),
        "responses": responses.reshape(m, n),
    }


def _targets(law: Law) -> list[tuple[int, int]]:
    """Return the event and the place in the state of everything that events set."""
    events, used = list(law.layout.model.events), law.layout.used
    return [(events.index(name), used.index(target)) for name, target in law.layout.resets]


def _followed_by(layout: Layout, drive: str) -> tuple[int, int, int, int]:
    """Return the number of a drive, and the places of its argument, the argument's rate and acceleration in a state."""
    argument, places = layout.model.drives[drive].argument, {name: i for i, name in enumerate(layout.record)}
    owner = argument if argument in layout.coordinates else argument.removeprefix(velocity(""))
    turn = places[acceleration(owner)]
    return layout.drives.index(drive), places[argument], places[velocity(owner)] if owner == argument else turn, turn


def _detectors(layout: Layout, intervals: Enclosing, settings: Settings) -> NDArray[np.void]:
    model, watched = layout.model, layout.watched
    rows = np.zeros(len(watched), DETECTOR)
    rows["value"], rows["slope"], rows["of_time"] = intervals.functions, intervals.slopes, intervals.of_time
    rows["bend"] = intervals.bends
    place = len(modes(model))  # of sides, after the modes of contacts
    for row, detector in zip(rows, watched, strict=True):
        event = detector.event
        row.direction, row.action, row.count = _DIRECTIONS[detector.direction], ACTIONS.index(event.action), event.count
        row.to = list(model.regimes).index(event.to) if event.to else 0
        row.tolerance = settings.located_within(detector.time_tolerance) / settings.scales.of(TIME)
        position = detector.position_tolerance
        row.position = np.inf if position is None else position.si / settings.scales.of(position.unit.dimension)
        row.role, row.reaction = detector.role, detector.reaction
        row.sampled = int(detector.sampled)
        row.interpolant = int(event.root_state == "interpolant")
        row.drive = -1
        if detector.role in (SWITCH, KINK):
            row.to, row.at_zero = place, detector.at_zero
            place += len(borders(detector.drive)) if detector.drive else 1
        if detector.drive:
            row.drive, row.argument, row.rate, row.turn = _followed_by(layout, detector.drive)
    return rows


@lru_cache(maxsize=64)
def _limits_domain(model: Model) -> bool:
    """Whether the model has functions or tables with a limited domain."""
    limited = any(map(limits_domain, _wholes(model) if has_wholes(model) else _elements(model)))
    return limited or any(drive.outside == "error" for drive in model.drives.values())


def _wholes(model: Model) -> Iterator[Node]:
    """Yield what moves a model with dimensions, without functions in Python."""
    parts = [part for terms in acting(model).values() for part in terms.values()]
    masses = [model.shaped.mass[i][i] for i in range(len(model.shaped.coordinates))]
    for part in (*parts, *masses, *(state.rate for state in model.shaped.states.values())):
        if not isinstance(part, Function):
            yield written_out(model, part)


def _elements(model: Model) -> Iterator[Node]:
    """Yield what moves a model, without functions in Python."""
    parts = [part for terms in model.force_components.values() for part in terms.values()]
    rates = [part.rate for part in model.states.values()]
    for part in (*parts, *model.statement.mass_entries.values(), *rates):
        if not isinstance(part, Function):
            yield model.expanded(part)

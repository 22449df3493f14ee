"""The arrays of the search for events, of contacts and of friction elements, as a run begins with them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import Name
from xdynamics.kernels import Law, Layout
from xdynamics.kernels.interval_program import NUMBER, UNKNOWN, VARIABLE, Enclosing, enclosing_rows
from xdynamics.kernels.interval_program import TIME as INSTANTS
from xdynamics.kernels.layout import curve_degree
from xdynamics.march.engine import enclosing_address, phase_addresses
from xdynamics.march.events.enclosures import BOX, INSTANT, OTHER, POSITION, operation_addresses
from xdynamics.march.phases import ASSEMBLIES, CONTACTS, WATCHERS
from xdynamics.march.run import AT_INSTANT, BALANCE, DEPARTURE, DETECTOR, LINK, PIECE, REACTION, TOUCH, WATCH
from xdynamics.march.settings import JUDGED, Settings
from xdynamics.model import Model
from xdynamics.model.assemblies import PATTERN
from xdynamics.model.detectors import OCCASION
from xdynamics.model.parts import ACTIONS, IMPACT_LAWS, RECORD
from xdynamics.model.reactions import DRY, NORMAL, mode_names, reactions
from xdynamics.model.sliding import surfaces
from xdynamics.model.switches import borders
from xdynamics.schema import acceleration, velocity
from xdynamics.units import TIME

DEEPEST = 64  # halvings of a step in search of events
MOST_MET, LEAST_MET, NUMBERS_MET = 16, 4, 100_000  # states that are remembered of one instant; of large models fewer
_DIRECTIONS = {"rising": 1, "falling": -1, "either": 0}


def _parts_with_phases(layout: Layout) -> list[str]:
    """Return the parts of the engine whose phases a march of a model enters."""
    model, elements = layout.model, layout.model.elements
    has_few = layout.reactions and not model.assemblies and PATTERN not in elements.contacts
    return [WATCHERS] * bool(layout.watched) + [CONTACTS] * bool(has_few) + [ASSEMBLIES] * bool(model.assemblies)


def event_search_arrays(model: Model, law: Law, settings: Settings) -> dict[str, NDArray[Any]]:
    """Return the arrays of the search for events."""
    watched = law.layout.watched
    intervals, depth, events = enclosing_rows(law.layout), DEEPEST if watched else 0, len(watched)
    places = {
        "under": np.zeros(intervals.values),
        "over": np.zeros(intervals.values),
        "flaws": np.zeros(intervals.values, np.int64),
        "needed_intervals": np.zeros(intervals.values, np.int64),
    }
    operations = operation_addresses(law.scheme.math_functions, curve_degree(law.layout)) if watched else ()
    functions = [*operations, enclosing_address()] if watched else []
    return (
        places
        | _contact_arrays(model, settings)
        | {
            "detectors": _detector_rows(law.layout, intervals, settings),
            "watches": np.zeros(events, WATCH),
            **_departure_arrays(law.layout, settings),
            **_region_arrays(law.layout, intervals, settings),
            "resets": np.zeros(len(targets := _targets(law)) * (1 + law.layout.is_doubled)),
            "targets": np.array(targets, np.int64).reshape(-1, 2),
            "piece": np.zeros(1, PIECE),
            "rows": intervals.rows,
            "numbers": intervals.numbers,
            "parts": np.array(intervals.parts, np.int64),
            "branches": np.zeros((depth, 1 + law.layout.record.size + events)),
            "functions": np.array(functions, np.int64),
            "phases": phase_addresses(*_parts_with_phases(law.layout)),
        }
    )


def _departure_arrays(layout: Layout, settings: Settings) -> dict[str, NDArray[Any]]:
    """Return the arrays of functions that leave zero; empty where no event acts, or none is judged where it leaves."""
    # of the model's events, which are no detectors where the motion slides along them
    events = layout.model.elements.events.values()
    acts = any(event.action != RECORD or event.every is not None for event in events)
    is_judged = settings.event_start == JUDGED and acts
    used = layout.used.size
    return {
        "departures": np.zeros(len(layout.watched) if is_judged else 0, DEPARTURE),
        "instant": np.zeros(int(is_judged), AT_INSTANT),
        "met_states": np.zeros((min(MOST_MET, max(LEAST_MET, NUMBERS_MET // used)), 1 + used) if is_judged else (0, 0)),
    }


def _region_arrays(layout: Layout, intervals: Enclosing, settings: Settings) -> dict[str, NDArray[Any]]:
    """Return the arrays of a region without events; empty where contacts read gaps in every step."""
    rows = {k: intervals.rows[k].tolist() for k in range(intervals.parts[0], intervals.parts[1])}
    disabled = layout.reactions or settings.locates_one_by_one or any(row[0] == UNKNOWN for row in rows.values())
    leaves = []
    for k, (row, target, i, *_) in rows.items() if not disabled else ():
        if row == VARIABLE and not curve_degree(layout):
            leaves.append((POSITION, i, target))
        elif VARIABLE <= row < NUMBER or row == INSTANTS:
            leaves.append((INSTANT if row == INSTANTS else OTHER, k, target))
    return {"box_variables": np.array(leaves, np.int64).reshape(-1, 3), "region": np.zeros(BOX + 4 * len(leaves))}


def _contact_arrays(model: Model, settings: Settings) -> dict[str, NDArray[Any]]:
    """Return the arrays of contacts and friction elements, with room for the problems that they pose."""
    elements = model.elements
    all_reactions, scales = reactions(model), settings.scales
    m, n = len(all_reactions), len(elements.statement.coordinates)
    unknowns = sum(1 if reaction.sort == NORMAL else 3 for reaction in all_reactions)
    fixed = np.zeros(m, REACTION)
    for row, reaction in zip(fixed, all_reactions, strict=True):
        part: Any = elements.frictions[reaction.owner] if reaction.sort == DRY else elements.contacts[reaction.owner]
        row.role, row.normal, row.tolerance, row.rest_height = (
            reaction.sort,
            reaction.normal,
            settings.located_within(part.time_tolerance) / scales.si_factor(TIME),
            -1.0,
        )
        if reaction.sort == NORMAL:
            row.law = IMPACT_LAWS.index(part.law)
            if part.rest_height is not None:
                row.rest_height = part.rest_height.si / scales.si_factor(part.rest_height.unit.dimension)
    return {
        "reactions": fixed,
        "touches": np.zeros(m, TOUCH),
        "swiftest": np.zeros(m),
        "lingering": np.zeros(m),
        "entry": np.zeros(2 * n if m else 0),
        "balance": np.zeros(BALANCE),
        **{name: np.zeros(m) for name in ("approach", "slowed", "pulled")},
        **_contact_tables(m, n),
        "problem": np.zeros((unknowns, 2 * unknowns + 2)),
        "basis": np.zeros(3 * unknowns + 1, np.int64),
        "solution": np.zeros(unknowns),
        "effects": np.zeros((m, unknowns)),
        "square": np.zeros(m * m),
        "column": np.zeros(m),
        **{name: np.zeros(m, np.int64) for name in ("chosen", "spare")},
    }


def _contact_tables(m: int, n: int) -> dict[str, NDArray[Any]]:
    """Return the contact tables of m reactions and n coordinates, and their parts as `model.reactions.reaction_table` lists them."""
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
    """Return the setter and the index in the state of each set number: an event, or -1 minus a controller's action."""
    events, used = list(law.layout.model.elements.events), law.layout.used
    targets = [(events.index(name), used.index(target)) for name, target in law.layout.resets]
    return targets + [(-1 - change.action, used.index(change.target)) for change in law.layout.ticking]


def _drive_argument_indices(layout: Layout, drive: str) -> tuple[int, int, int, int]:
    """Return the number of a drive, and where its argument, the argument's rate and acceleration are.

    They are places in a state or, counted from -1 downwards, among the numbers of the program `slopes`.
    """
    argument_node, state_indices = (
        layout.model.elements.looked_up_at[drive],
        {name: i for i, name in enumerate(layout.record)},
    )
    if not isinstance(argument_node, Name) or argument_node.name not in {*layout.coordinates, *layout.velocities}:
        first = -1 - len(layout.watched) - layout.followed.size - 3 * layout.tracked.index(drive)
        return layout.drives.index(drive), first, first - 1, first - 2
    argument = argument_node.name
    owner = argument if argument in layout.coordinates else argument.removeprefix(velocity(""))
    turn = state_indices[acceleration(owner)]
    return (
        layout.drives.index(drive),
        state_indices[argument],
        state_indices[velocity(owner)] if owner == argument else turn,
        turn,
    )


def _detector_rows(layout: Layout, intervals: Enclosing, settings: Settings) -> NDArray[np.void]:
    model, watched = layout.model, layout.watched
    rows = np.zeros(len(watched), DETECTOR)
    rows["value"], rows["slope"], rows["of_time"] = intervals.functions, intervals.slopes, intervals.of_time
    rows["bend"] = intervals.bends
    side_index = len(mode_names(model))  # of sides, after the modes of contacts
    between_regimes = {i for surface in surfaces(model) for i, _ in surface.events}
    for i, (row, detector) in enumerate(zip(rows, watched, strict=True)):
        event = detector.event
        row.direction, row.action, row.count = _DIRECTIONS[detector.direction], ACTIONS.index(event.action), event.count
        row.to = list(model.regimes).index(event.to) if event.to else 0
        row.tolerance = settings.located_within(detector.time_tolerance) / settings.scales.si_factor(TIME)
        position = detector.position_tolerance
        row.position = np.inf if position is None else position.si / settings.scales.si_factor(position.unit.dimension)
        row.role, row.reaction = detector.role, detector.reaction
        row.sampled = int(detector.sampled)
        row.interpolant = int(event.root_state == "interpolant")
        row.slides = int(detector.role == OCCASION and i in between_regimes)
        row.drive = -1
        if detector.is_switch:
            row.to, row.at_zero = side_index, detector.at_zero
            side_index += len(borders(detector.drive)) if detector.drive else 1
        if detector.drive:
            row.drive, row.argument, row.rate, row.turn = _drive_argument_indices(layout, detector.drive)
    return rows

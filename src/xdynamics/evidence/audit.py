"""An audit of a run: contradictions between its record and its model, which no second march would reveal.

A second march has the faults of the first, since it marches in the same way. The contradictions are: an acting event
that stands at zero, leaves it in its own direction and is not met; events of one detector that crowd together in time;
contacts that pull, are penetrated, or hold more than friction can; a motion along a switch that is off it. Method and
date of the march do not matter.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.dynamics.recorded_steps import model_of_record
from xdynamics.elementary import kept_set
from xdynamics.evidence.evidence_dataset import FAILED, GATES, NOT_CHECKED, PASSED, Gate
from xdynamics.evidence.observables import share_columns
from xdynamics.expressions import Node
from xdynamics.faults import display_text
from xdynamics.march.settings import FILIPPOV
from xdynamics.methods.moreau import MOREAU_JEAN
from xdynamics.model import Function, Model
from xdynamics.model.delays import is_before
from xdynamics.model.motion import constants, drive_pieces, evaluate_over_states, variables
from xdynamics.model.parts import RECORD
from xdynamics.model.reactions import NORMAL, TANGENT, Reaction, reactions
from xdynamics.model.regime_model import RegimeModel
from xdynamics.model.regimes import REGIME_NUMBER
from xdynamics.model.sliding import arm_rates, sided_model, surfaces
from xdynamics.reaction_names import contact_force, contact_gap, friction_force
from xdynamics.record.flag_words import words_of_flag
from xdynamics.record.named_rows import rows_named
from xdynamics.record.unfolding import column_in_si, event_words
from xdynamics.shapes.naming import split_element_name
from xdynamics.units import parse_unit, unit_suffix

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
Functions = Mapping[str, Callable[..., float]] | None

EVENTS, CONTACTS, SWITCHES = "events_met", "contacts_admissible", "slides_on_switch"
ZERO = 1e-9  # of the largest value of an event function: as good as zero
OFF = 1e-3  # of a run's time, in which the forces of one side would bring back a motion that is off its switch
CROWDED = 100.0  # time tolerances between two occurrences of an acting event, below which they are not apart
SLACK = 1e-7  # of the largest force or gap of a contact: more than what its events are located within
COLUMNS = (
    "time",
    schema.STEP_NUMBER.name,
    "regime",
    "row_kind",
    "closed_force",
    "closed_step",
)  # besides events, states and contacts
_DIRECTIONS = {"rising": 1.0, "falling": -1.0}
Look = Callable[["xr.Dataset", Model], Iterator[str]]


def audit(run: xr.Dataset, functions: Functions = None) -> list[Gate]:
    """Look for contradictions between a record and its model.

    Parameters
    ----------
    run : xarray.Dataset
        A run record, of any version.
    functions : mapping of str to callable, optional
        The Python functions that the model calls; event functions that call one are not checked without it.

    Returns
    -------
    list of Gate
        `events_met` of a model with events that stop, switch or reset; `contacts_admissible` of one with contacts or dry
        friction; `slides_on_switch` of one whose motion may slide along switches. A record that does not hold what is
        needed is `not_checked`.
    """
    model = model_of_record(run, functions)
    return [_gate(name, look, run, model, passed) for name, look, passed in _questions(model)]


def gates_of(model: Model) -> list[str]:
    """Name the gates of a model's runs."""
    return [name for name, _, _ in _questions(model)]


def audited_columns(run: xr.Dataset, model: Model) -> xr.Dataset:
    """Return the columns that an audit reads: times, flags, events, the state, forces and gaps of contacts."""
    owners = {reaction.owner for reaction in reactions(model)}
    audited_names = {
        column_name_of(owner) for owner in owners for column_name_of in (contact_force, contact_gap, friction_force)
    }
    audited_names |= {
        *COLUMNS,
        *share_columns(model),
        *variables(model),
        *(split_element_name(name)[0] for name in variables(model)),
    }
    return run[
        [
            name
            for name in run.variables
            if name in audited_names or run[name].dims[:1] in ((), (schema.EVENTS,), (schema.DOCUMENT,))
        ]
    ]


def _questions(model: Model) -> Iterator[tuple[str, Look, str]]:
    """Yield the gates of a model's runs: name, search for faults, and reason of a pass."""
    if has_acting(model):
        yield EVENTS, _unmet_events, "every acting event at zero was met or left in time"
    if reactions(model) or model.assemblies:
        yield CONTACTS, _broken_contacts, "no contact pulls, overlaps or holds too much"
    if share_columns(model):
        yield (
            SWITCHES,
            _off_switches,
            f"along switches shares are 0 to 1, and the motion is off them by {OFF:g} of its time at most",
        )


def has_acting(model: Model) -> bool:
    """Whether an event stops a run, switches its regime or resets its state where a function is zero."""
    return any(event.action != RECORD and event.every is None for event in model.elements.events.values())


def contradiction(run: xr.Dataset, functions: Functions = None) -> str:
    """Return the contradictions in a record, in words; empty if no gate failed."""
    return "; ".join(gate.reason for gate in audit(run, functions) if gate.verdict == FAILED)


def gate_lines(diagnosis: xr.Dataset) -> Iterator[str]:
    """Describe the gates of a diagnosis that are not passed."""
    if "gate_name" not in diagnosis:
        return
    for verdict, reason in zip(
        diagnosis["gate_verdict"].values.tolist(), diagnosis["gate_reason"].values.tolist(), strict=True
    ):
        if GATES[verdict] != PASSED:
            yield f"{'attention' if GATES[verdict] == FAILED else 'not checked'}: {reason}"


def _gate(name: str, look: Look, run: xr.Dataset, model: Model, passed: str) -> Gate:
    """Search a record for faults of one gate; a record that lacks a column leaves the gate unchecked."""
    try:
        faults = list(look(run, model))
    except KeyError as missing:
        return Gate(name, NOT_CHECKED, f"the record has no {missing}")
    return Gate(name, FAILED, display_text("; ".join(faults))) if faults else Gate(name, PASSED, passed)


def _unmet_events(run: xr.Dataset, model: Model) -> Iterator[str]:
    """Yield acting events that stand at zero and leave it in their direction unmet, or crowd together."""
    elements = model.elements
    acting = {
        name: event.function
        for name, event in elements.events.items()
        if event.action != RECORD and event.every is None and not isinstance(event.function, Function)
    }
    trees = {name: elements.expanded(tree) for name, tree in acting.items()}
    trees = {name: tree for name, tree in trees.items() if not any(map(is_before, elements.reads(tree)))}
    times, met = run["time"].values, _event_times_by_name(run)
    second = unit_suffix(str(run["time"].attrs["units"]))
    rates = [elements.rate_of(tree) for tree in trees.values()]
    columns = _tree_columns(run, model, [*trees.values(), *rates])
    left = _rows_behind_sliding(run)
    # the columns of rates stand behind those of values: the zip ends with the trees
    for name, values, slopes in zip(trees, columns, columns[len(trees) :], strict=False):
        direction = _DIRECTIONS.get(elements.events[name].direction, 0.0)
        rows = _left_unmet(run, values, slopes, direction, met.get(name, np.zeros(0)))
        row = next((row for row in rows if row not in left), None)
        if row is not None:
            yield (
                f"event '{name}' is at zero at t = {times[row]:.15g}{second} and leaves it {elements.events[name].direction},"
                " which is its direction, and was not met"
            )
    for name in acting:
        event_tolerance = elements.events[name].time_tolerance
        tolerance = (
            float(run.attrs.get("solver_time_tolerance", 0.0)) if event_tolerance is None else event_tolerance.si
        )
        pauses = np.diff(met.get(name, np.zeros(0)))
        if (close := pauses <= CROWDED * tolerance).any():
            when = met[name][int(np.argmax(close))]
            yield f"event '{name}' acts twice within {CROWDED:.0f} time tolerances, at t = {when:.15g}{second}"


def _rows_behind_sliding(run: xr.Dataset) -> set[int]:
    """Return the rows behind events at which a motion began or ended to slide: what it leaves there it has met before."""
    if not run.sizes.get(schema.EVENTS, 0):
        return set()
    words = words_of_flag(run["event_kind"])
    slid = [word in schema.KINDS_OF_SLIDING for word in words]
    return {*rows_named(run, "event_row_after")[slid].tolist()}


def _off_switches(run: xr.Dataset, model: Model) -> Iterator[str]:
    """Yield switches that the motion slides along with a share beyond its bounds, or off the zero of the function."""
    base = sided_model(model)
    if not isinstance(base, RegimeModel) or str(run.attrs.get("solver_sliding", "")) != FILIPPOV:
        return
    slid = surfaces(base)
    rates = [tree for side in (0, 1) for surface in slid for tree in arm_rates(base, (surface,), (surface,)[:side])]
    columns = _tree_columns(run, base, [*(surface.sliding_variable for surface in slid), *rates])
    times, second = column_in_si(run, "time"), unit_suffix(str(run["time"].attrs["units"]))
    for i, surface in enumerate(slid):
        share = np.asarray(run[schema.share_of(surface.name)].values, float)
        slides = ~np.isnan(share)
        if (np.abs(share[slides] - 0.5) > 0.5 + SLACK).any():
            yield f"the share of switch '{surface.name}' is not between 0 and 1"
        off, *speeds = (np.abs(column[slides]).max(initial=0.0) for column in columns[i :: len(slid)])
        speed = max(speeds)
        if off > OFF * speed * (times[-1] - times[0]):
            time = off / speed / float(parse_unit(str(run["time"].attrs["units"])).factor)
            yield (
                f"the motion slides along switch '{surface.name}' and is off it: by the forces of one side it would come back"
                f" in {time:.2g}{second}"
            )


def _left_unmet(run: xr.Dataset, values: Floats, rates: Floats, direction: float, met: Floats) -> Iterator[int]:
    """Yield the rows at the start or behind an event at which a function is zero, and leaves it in its direction unmet.

    One that was met there goes on in its direction, and has to be met again if it had been turned back.
    """
    times = np.asarray(run["time"].values, float)
    if direction == 0.0 or not values.size:
        return
    small = ZERO * np.max(np.abs(values), initial=0.0, where=np.isfinite(values))
    begins = np.isin(run["row_kind"].values, (schema.INITIAL, schema.EVENT_AFTER)) & (np.abs(values) <= small)
    beyond = np.flatnonzero(np.abs(values) > small)
    for row in np.flatnonzero(begins).tolist():
        left = beyond[np.searchsorted(beyond, np.searchsorted(times, times[row], "right")) :][:1]
        if not left.size or np.sign(values[left[0]]) != direction:
            continue
        turned_back = rates[row] * direction < 0.0
        last_met = met[: np.searchsorted(met, times[left[0]], "right")][-1:]
        if not (last_met.size and (last_met[0] > times[row] if turned_back else last_met[0] >= times[row])):
            yield row


def _event_times_by_name(run: xr.Dataset) -> dict[str, Floats]:
    """Return when each detector met an event, ascending, by its name or that of its element."""
    words, times = np.array(event_words(run), object), np.asarray(run["event_time"].values, float)
    return {word: times[words == word] for word in dict.fromkeys(words.tolist())}


def _tree_columns(run: xr.Dataset, model: Model, trees: list[Node]) -> list[Floats]:
    """Return expressions of coordinates, velocities and states in all rows of a record, SI."""
    state: dict[str, Any] = {"t": column_in_si(run, "time"), REGIME_NUMBER: np.zeros(run.sizes[schema.STEPS])}
    if "regime" in run.variables:
        state[REGIME_NUMBER] = run["regime"].values.astype(float)
    state |= {name: column_in_si(run, name) for name in variables(model)}
    constant_values, set_used = constants(model), kept_set(run.attrs.get("math_functions"))
    values = evaluate_over_states(model, trees, state, constant_values, drive_pieces(model), set_used)
    return [np.broadcast_to(np.asarray(value, float), state["t"].shape) for value in values]


def _broken_contacts(run: xr.Dataset, model: Model) -> Iterator[str]:
    """Yield contacts that pull, are penetrated, or exceed their friction, in any row."""
    times, second = run["time"].values, unit_suffix(str(run["time"].attrs["units"]))
    for reaction in reactions(model):
        for violation, excess in _excesses(run, model, reaction):
            worst = int(np.argmax(excess)) if excess.size else 0
            if excess.size and excess[worst] > 0.0:
                yield f"contact '{reaction.owner}' {violation} at t = {times[worst]:.15g}{second}"
    if "closed_force" in run.variables and run["closed_force"].size and not _steps_over_impacts(run):
        forces, rows = np.asarray(run["closed_force"].values), rows_named(run, "closed_step")
        tolerance = CROWDED * float(run.attrs.get("solver_time_tolerance", 0.0))
        lasting = np.append(np.diff(times), 0.0)[rows] > tolerance  # what is released at once was about to be
        pulls = np.where(lasting, -forces, 0.0)
        if pulls.max() > SLACK * np.abs(forces).max():
            yield f"a contact of many links pulls at t = {times[rows[int(np.argmax(pulls))]]:.15g}{second}"


def _steps_over_impacts(run: xr.Dataset) -> bool:
    """Whether impacts were not located, so that gaps are negative by as much as a step leaves."""
    return bool(run.attrs["solver_method"] == MOREAU_JEAN.name)


def _excesses(run: xr.Dataset, model: Model, reaction: Reaction) -> Iterator[tuple[str, Floats]]:
    """Yield each violation of the law of contact by a reaction, and its size in every row beyond rounding."""
    if _steps_over_impacts(run):
        return  # its impulses are those of whole steps
    if reaction.sort == NORMAL:
        press, gap = column_in_si(run, contact_force(reaction.owner)), column_in_si(run, contact_gap(reaction.owner))
        yield "pulls", -press - SLACK * np.abs(press).max(initial=0.0)
        yield "is penetrated", -gap - SLACK * np.abs(gap).max(initial=0.0) - _located_within(run, model, reaction)
        return
    force = np.abs(column_in_si(run, friction_force(reaction.owner)))
    (friction_limit,) = _tree_columns(run, model, [model.elements.expanded(reaction.sticking_limit)])
    if reaction.sort == TANGENT:
        friction_limit = friction_limit * column_in_si(run, contact_force(reaction.owner))
    yield "holds more than friction can", force - friction_limit - SLACK * np.abs(force).max(initial=0.0)


def _located_within(run: xr.Dataset, model: Model, reaction: Reaction) -> float:
    """Return how far a gap may be passed by the time within which its impacts are located, SI."""
    contact_tolerance = model.elements.contacts[reaction.owner].time_tolerance
    tolerance = (
        float(run.attrs.get("solver_time_tolerance", 0.0)) if contact_tolerance is None else contact_tolerance.si
    )
    speeds = [
        float(np.abs(column_in_si(run, name)).max(initial=0.0))
        for name in map(schema.velocity, model.elements.statement.coordinates)
    ]
    return 2.0 * tolerance * sum(speeds)

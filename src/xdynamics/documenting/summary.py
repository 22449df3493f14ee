"""The summary of a run, in lines of text, with remarks that follow from its attributes.

The work of forces of velocities alone is tested: one that drives a motion which it should brake has a wrong sign
somewhere.

A remark states a fact only where the attributes imply it.

Of quantities with dimensions a summary shows the first elements: the rest is not split into variables.
"""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from functools import wraps
from itertools import combinations
from typing import Any, ParamSpec, TypeVar

import numpy as np
import xarray as xr

from xdynamics import schema
from xdynamics.archive import without_stale_units
from xdynamics.dynamics.recorded_steps import model_of_record
from xdynamics.elementary.arrays import integral
from xdynamics.evidence.evidence_dataset import relative_uncertainty
from xdynamics.expressions import Node, free_names
from xdynamics.expressions.evaluation import evaluate
from xdynamics.faults import DOT, escaped
from xdynamics.march.outcomes import COMPLETED, OUTCOMES
from xdynamics.methods.scheme import DOUBLE_DOUBLE
from xdynamics.model import Function, Model
from xdynamics.model.motion import constants
from xdynamics.model.parts import APPROACH, NEWTON, POISSON
from xdynamics.record import of_elements
from xdynamics.record.arguments import precision_of
from xdynamics.record.flag_words import time_unit_of, words_of_flag
from xdynamics.record.folding import model_dimensions
from xdynamics.record.long_times import in_long_unit
from xdynamics.record.named_rows import row_places
from xdynamics.record.schemas import (
    ending_words,
    has_its_rows,
    is_evidence,
    is_run,
    is_selection,
    is_whole,
    kind_description,
    rows_apart,
)
from xdynamics.record.unfolding import column_in_si
from xdynamics.shapes.naming import display_text
from xdynamics.units import SECONDS, unit_suffix
from xdynamics.units.digits import OF_DOUBT, digits, with_uncertainty

SEEN = 1e-6  # of all work of a force: less is due to the rule of trapezoids


def works_of_drag(run: xr.Dataset) -> Iterator[str]:
    """Report the work that a force of velocities alone did on the motion, where it did any, and in which direction."""
    if "force_source" not in run or run.sizes[schema.STEPS] < 2:
        return
    model = model_of_record(run, None)
    if model.shapes.dims or model.time_unit.text != SECONDS.text:
        return
    times = run["time"].values
    for name, coordinates in _velocity_forces(model).items():
        columns = {q: (schema.force(name, q), schema.velocity(q)) for q in coordinates}
        if not all(column in run for pair in columns.values() for column in pair):
            continue
        powers = [column_in_si(run, force) * column_in_si(run, velocity) for force, velocity in columns.values()]
        power = np.sum(powers, axis=0)
        pushing, all_of_it = np.maximum(power, 0.0), integral(np.abs(power), times)
        if (work := integral(pushing, times)) <= SEEN * all_of_it:
            continue
        speeds = column_in_si(run, schema.velocity(coordinates[0]))[power > 0.0]
        direction_note = f" where v_{coordinates[0]} {'<' if speeds.max() < 0.0 else '>'} 0"
        one_way = len(coordinates) == 1 and (speeds.max() < 0.0 or speeds.min() > 0.0)
        yield f"work      {name} did +{work:.3g} J of work on the motion{direction_note if one_way else ''}: drag would take it"


def _velocity_forces(model: Model) -> dict[str, list[str]]:
    """Return the forces that read velocities, and neither coordinates, states, drives nor time, with where they act."""
    elements = model.elements
    position_names = {
        "t",
        *elements.statement.coordinates,
        *elements.statement.states,
        *elements.drives,
    }
    velocities, forces = {*map(schema.velocity, elements.statement.coordinates)}, dict[str, list[str]]()
    for name, components in elements.force_components.items():
        trees = [tree for tree in components.values() if not isinstance(tree, Function)]
        names_read = set().union(*(free_names(elements.expanded(tree)) for tree in trees)) if trees else set()
        if len(trees) == len(components) and names_read & velocities and not names_read & position_names:
            forces[name] = [*components]
    return forces


def impact_law_remark(run: xr.Dataset) -> Iterator[str]:
    """Name contacts that push each other and close at one instant: what follows is then a choice of the law of impacts."""
    if "event_kind" not in run or "force_source" not in run or run.sizes.get(schema.EVENTS, 0) < 2:
        return
    impacts = np.flatnonzero(run["event_kind"].values == schema.IMPACT)
    instants = run["event_row_before"].values[impacts]
    at_once = impacts[np.isin(instants, [row for row, count in Counter(instants.tolist()).items() if count > 1])]
    if not at_once.size:
        return
    model = model_of_record(run, None)
    elements, names = model.elements, words_of_flag(run["event_detector"])
    for row in dict.fromkeys(run["event_row_before"].values[at_once].tolist()):
        together = [i for i in at_once.tolist() if run["event_row_before"].values[i] == row]
        contacts = {names[i]: elements.contacts[names[i]] for i in together if names[i] in elements.contacts}
        elastic = [
            name
            for name, contact in contacts.items()
            if contact.law in (NEWTON, POISSON) and not _is_plastic(contact.restitution, model)
        ]
        read = [
            free_names(elements.expanded(contacts[name].gap)) & {*elements.statement.coordinates} for name in elastic
        ]
        if not any(first & second for first, second in combinations(read, 2)):
            continue
        laws = " and ".join(dict.fromkeys(f"'{contacts[name].law}'" for name in elastic))
        time = f"{float(run['event_time'].values[together[0]]):.6g}{unit_suffix(str(run['event_time'].attrs['units']))}"
        text = (
            f"{', '.join(map(display_text, elastic[:MOST_NAMED]))}{' …' if len(elastic) > MOST_NAMED else ''} closed at once"
            f" at t = {time}, and push each other: what follows is chosen by the law {laws}, and other laws choose otherwise;"
            " law = 'sequential' lets one strike after another, as hard balls do: `xdynamics help contacts`"
        )
        yield from textwrap.wrap(text, WIDTH, initial_indent="impacts   ", subsequent_indent=" " * 10)
        return


def _is_plastic(restitution: Node, model: Model) -> bool:
    """Whether a coefficient of restitution is 0, whatever the speed."""
    tree = model.elements.expanded(restitution)
    return APPROACH not in free_names(tree) and evaluate(tree, constants(model)) == 0.0


Attributes = Mapping[Any, Any]
MOST_NAMED = 4  # contacts that closed at once
WHOLE = 1e-9  # of a step: by which the last one may differ from it
SHORT = 0.25  # of the slowest period


def double_double_remark(attributes: Attributes) -> Iterator[str]:
    """Return where the second floats of numbers are recorded, if numbers are sums of two floats."""
    if precision_of(attributes) == DOUBLE_DOUBLE:
        yield "numbers   of 31 digits, x + rest_x: `xdynamics help precision`"


def step_size_remarks(attributes: Attributes) -> Iterator[str]:
    """Compare steps with the period that the fastest rate of the model has, and report a span that is short beside the slowest one."""
    if attributes.get("run_h_omega_largest"):  # none where nothing pulls back, as in free flight
        steps_a_period = 2.0 * np.pi / float(attributes["run_h_omega_largest"])
        yield f"resolved  the fastest motion by at least {steps_a_period:.3g} steps a period"
    if float(attributes.get("run_slowest_periods", 1.0)) < SHORT:
        unit_suffix = (
            "" if attributes["run_slowest_period_units"] == "1" else f" {attributes['run_slowest_period_units']}"
        )
        yield (
            f"span      {attributes['run_slowest_periods']:.2g} of the slowest period at the start,"
            f" {attributes['run_slowest_period']:g}{unit_suffix}: what it does in a period is not seen"
        )


def table_kinks_remark(attributes: Attributes) -> Iterator[str]:
    """Count the kinks of tables that are no events, with the alternatives."""
    if count := attributes.get("run_kinks_landed_on"):
        yield (
            f"kinks     {count} at points of tables of {attributes['solver_switches_landed_on']}, landed on, without"
            " events: switches = 'located' has them as events; with interpolation = 'pchip' there are none"
        )


MOST_SHOWN = 12  # numbers of a state
MOST_PARTED = 1000  # numbers of a state, of which some are shown, from which the others are not parted
ALL_NUMBERS = "numbers_of_a_state"  # attribute of a run whose other elements are left out

Given = ParamSpec("Given")
Result = TypeVar("Result")


def of_shown_elements(describe: Callable[Given, Result]) -> Callable[Given, Result]:
    """Let a description take records of quantities with dimensions, of which it needs no forces, errors and samples.

    Of 10,000 elements each quantity takes tenths of a second to be parted.
    """
    of_parts: Callable[..., Result] = of_elements(describe)

    @wraps(describe)
    def describe_parts(*arguments: Given.args, **keywords: Given.kwargs) -> Result:
        return of_parts(*map(_shown_part, arguments), **keywords)

    return describe_parts


def _shown_part(run: Any) -> Any:
    """Leave out the columns of a run that have dimensions of the model, and of which no description shows a number."""
    if not (dims := {*model_dimensions(run)}):
        return run
    rows = {schema.STEPS, schema.SAMPLES}
    left_out = [
        name
        for name, variable in run.variables.items()
        if dims & {*variable.dims} and rows & {*variable.dims} and variable.attrs.get("role") not in schema.OF_MOTION
    ]
    return run.drop_vars(left_out)


def first_elements(run: Any) -> Any:
    """Leave out of a run of very many numbers, in which nothing happens to some of them, those that are not shown."""
    if not (dims := model_dimensions(run)) or run.sizes.get(schema.EVENTS, 0) or not run.sizes.get(schema.STEPS, 0):
        return run
    numbers = sum(
        variable.size // run.sizes[schema.STEPS]
        for variable in run.variables.values()
        if variable.dims[:1] == (schema.STEPS,) and variable.attrs.get("role") in schema.OF_MOTION
    )
    if numbers <= MOST_PARTED:
        return run
    return run.isel({dim: slice(MOST_SHOWN) for dim in dims if dim in run.dims}).assign_attrs({ALL_NUMBERS: numbers})


def of_motion(run: Any) -> list[str]:
    """Name the variables from which a march continues: coordinates, velocities, states, states of controllers."""
    return [
        str(name)
        for name, entry in run.variables.items()  # to look up one of them as a DataArray takes time with their number
        if entry.dims == (schema.STEPS,) and entry.attrs.get("role") in schema.OF_MOTION
    ]


WIDTH = 120  # of a line of remarks
FEW_EVENTS = 4  # of one name, that are listed one by one
_OF_FLAGS = ("units", "long_name", "role", "flag_values", "flag_meanings", "comment")
LONGEST = 400  # characters of a setting that are shown
ENDS = ("first", "second")  # of a link


def summary(run: xr.Dataset) -> list[str]:
    """Describe a run in lines: outcome, method, counts, end state, energy band, events.

    A selection lacks the rows that its events name; the outcome given is that of its run.
    """
    lines: list[str] = _summary_lines(first_elements(without_stale_units(run)))
    return lines


@of_shown_elements
def _summary_lines(run: xr.Dataset) -> list[str]:
    attributes = run.attrs
    if is_evidence(attributes):
        return [escaped(line) for line in _evidence_lines(run)]
    if not is_whole(attributes) or not has_its_rows(run):
        return [escaped(line) for line in _partial_lines(run)]
    lines = [
        attributes["title"],
        *_ending_lines("outcome", attributes),
        f"method    {attributes['solver_method']} (order {attributes['solver_order']}), {_step_description(run)}",
        *double_double_remark(attributes),
        f"log       {_row_counts(run)}",
        f"end       {', '.join(_end_state_texts(run))}",
    ]
    if "total_energy" in run:
        among = " of the kept rows" if rows_apart(attributes) > 1 else ""
        energy, unit = run["total_energy"].values, unit_suffix(run["total_energy"].attrs["units"])
        band, change = energy.max() - energy.min(), energy[-1] - energy[0]
        lines.append(
            f"energy    {energy[0]:.{digits(float(energy[0]), relative=_uncertain_part(run))}g}{unit} at the start, band"
            f" {band:.3g}{unit}{among}, end minus start {change:.3g}{unit}"
        )
    lines += works_of_drag(run)
    lines += impact_law_remark(run)
    return [
        escaped(line)
        for line in (
            *lines,
            *step_size_remarks(attributes),
            *table_kinks_remark(attributes),
            *_stopped_motions(run),
            *_event_descriptions(run),
        )
    ]


def _ending_lines(label: str, attributes: Mapping[Any, Any], method: str = "") -> Iterator[str]:
    """State how a run ended in one line, followed by remarks."""
    sentence, remarks = ending_words(attributes)
    yield f"{label:<10}{method}{sentence}"
    yield from textwrap.wrap(
        remarks, WIDTH, initial_indent="remark    ", subsequent_indent=" " * 10, break_long_words=False
    )


def _evidence_lines(evidence: xr.Dataset) -> Iterator[str]:
    """Report the findings of evidence."""
    kind = str(evidence.attrs[schema.EVIDENCE])
    yield str(evidence.attrs.get("title", kind))
    if kind != schema.SWEEP:
        yield f"kind      {kind_description(evidence.attrs)}"
    lines_of = next((module.SUMMARIES[kind] for module in _summarising() if kind in module.SUMMARIES), None)
    if lines_of is not None:
        yield from lines_of(evidence)


def _summarising() -> Iterator[Any]:
    """Yield the modules that summarise evidence by its kind; each is imported when those before it do not have it."""
    from xdynamics.sweeping import survey_summary, sweep_summary

    yield from (survey_summary, sweep_summary)
    from xdynamics.budgeting import budget, budget_summary, fit_summary

    yield from (budget_summary, budget, fit_summary)
    from xdynamics.evidence.comparing import comparison_summary
    from xdynamics.evidence.validating import ledger_rows, limiting

    yield from (comparison_summary, ledger_rows, limiting)
    from xdynamics.budgeting import certificate
    from xdynamics.evidence import companion, modes
    from xdynamics.evidence.diagnosing import diagnosis
    from xdynamics.evidence.enclosing import enclosure
    from xdynamics.evidence.refining import refinement

    yield from (companion, diagnosis, modes, enclosure, refinement, certificate)


def _partial_lines(run: xr.Dataset) -> Iterator[str]:
    """Describe a Dataset that is no complete run: a part of a run, states at wanted times, or foreign data."""
    attributes = run.attrs
    yield str(attributes.get("title", "a record without a title"))
    kind_name = str(attributes.get("summary") or "no run")
    if "solver_method" in attributes:
        unmarched = "run_outcome" not in attributes and any(variable.chunks for variable in run.variables.values())
        kind_name = "a run that is still to be computed" if unmarched else "a part of a run"
    described = kind_description(attributes) or kind_name
    yield f"kind      {described}"
    if is_selection(attributes):
        yield from _ending_lines("of run", attributes, f"{attributes['solver_method']}, ")
    yield f"log       {', '.join(f'{size} rows of {dim}' for dim, size in run.sizes.items()) or 'no rows'}"


@of_shown_elements
def details(run: xr.Dataset, *, with_settings: bool = True) -> list[str]:
    """Describe a run: summary, parameters with descriptions, and of a complete run settings, equations, digests."""
    lines = [*summary(run), *(["parameters"] if is_run(run.attrs) else [])]
    for name, variable in run.variables.items():
        if variable.attrs.get("role") == "parameter" and not variable.dims:
            first, *further_lines = str(variable.attrs["long_name"]).split("\n")
            value, doubt = float(variable), float(variable.attrs.get("uncertainty", 0.0))
            doubt_digits = 1 if float(f"{doubt:.1g}") == doubt else OF_DOUBT  # "30 ± 1 m s-1" as it was written down
            value_text = with_uncertainty(value, doubt, doubt_digits) if doubt > 0.0 else f"{value:.12g}"
            described = "" if first == f"parameter {name}" else f"   {first}"
            lines.append(f"  {name} = {value_text}{unit_suffix(str(variable.attrs['units']))}{described}")
            lines += [f"    {line}" for line in further_lines]
    if not with_settings:
        return [escaped(line) for line in (*lines, "more      equations, settings and digests with --all")]
    lines.append("settings and evidence")
    keys = [
        key
        for key in run.attrs
        if key.startswith(
            (
                "solver_",
                "run_h_omega",
                "run_fastest",
                "run_slowest",
                "run_atol",
                "precision",
                "math_",
                "model_d",
                "force_d",
                "content_d",
            )
        )
    ]
    keys += [
        key for key in ("date_created", "xdynamics_version", "python_version", "numba_version") if key in run.attrs
    ]
    lines += [f"  {key} = {shortened_setting(run.attrs[key])}" for key in keys]
    detectors = run["event_detector"].attrs if "event_detector" in run else {}
    lines += [
        f"  events, {key.replace('_', ' ')} = {shortened_setting(text)}"
        for key, text in detectors.items()
        if key not in _OF_FLAGS
    ]
    return [escaped(line) for line in lines]


def shortened_setting(value: Any) -> str:
    """Cut the equations of methods with many stages; the archive has them in full."""
    text = str(value)
    return text if len(text) <= LONGEST else f"{text[:LONGEST]} … ({len(text)} characters)"


def _step_description(run: xr.Dataset) -> str:
    """Describe how steps were chosen."""
    attributes = run.attrs
    if attributes["solver_step_control"] == "fixed":
        step, last = float(attributes["solver_step"]), float(run["step_size"].values[-1]) if "step_size" in run else 0.0
        is_whole_number = abs(last - step) <= WHOLE * step or attributes["run_outcome"] != OUTCOMES[COMPLETED].word
        shorter = "" if is_whole_number else f", the last one {last:.6g}{_second(run)}: the end is no multiple"
        return f"step {step!r}{_second(run)}{shorter}"
    if attributes["solver_step_control"] == "given":
        return "steps as given"
    return (
        f"adaptive, rtol {float(attributes['solver_rtol']):g}, {attributes['run_force_evaluations']} force evaluations"
    )


def _second(run: xr.Dataset) -> str:
    """Return the unit of time as it follows a number; empty if time has none."""
    return unit_suffix(time_unit_of(run))


def _row_counts(run: xr.Dataset) -> str:
    words = {
        schema.STEPS: "rows",
        schema.TRIALS: "rejected trials",
        schema.EVENTS: "events",
        schema.SAMPLES: "force samples",
    }
    counts = {word: run.sizes.get(dim, 0) for dim, word in words.items()}
    shortened = words_of_flag(run["trial_reason"]).count("event_substep") if counts["rejected trials"] else 0
    counts["rejected trials"] -= shortened
    if not shortened and counts["events"]:  # of events at once each has the number of all
        _, first = np.unique(run["event_row_before"].values, return_index=True)
        shortened = int(run["event_substeps"].values[first].sum())
    text = ", ".join(f"{count} {word}" for word, count in counts.items())
    if schema.LOG in run.attrs:
        text += f"; of the columns {run.attrs[schema.LOGGED] if run.attrs[schema.LOG] == schema.CHOSEN else 'the states'} alone"
    if (row_spacing := rows_apart(run.attrs)) > 1:
        text = f"one in {row_spacing} of {int(run.attrs['run_rows'])} rows of the run, and what belongs to them: {text}"
    return f"{text}; {shortened} steps shortened to find events" if shortened else text


def _end_state_texts(run: xr.Dataset) -> Iterator[str]:
    last = run.sizes.get(schema.EVENTS, 0) - 1
    if last >= 0 and float(run["event_time"][last]) == float(run["time"][-1]):
        yield f"t = {_event_time_text(run, last)}"
    else:
        yield f"t = {float(run['time'][-1]):.12g}{_second(run)}{in_long_unit(run['time'], float(run['time'][-1]))}"
    names = of_motion(run)
    yield from _state_texts(run, names, names, -1)


def _uncertain_part(run: xr.Dataset) -> float:
    """Return the relative uncertainty that the tolerances and uncertain inputs of a run leave in its numbers."""
    return relative_uncertainty(run, model_of_record(run, None))


def _state_text(run: xr.Dataset, name: str, row: int) -> str:
    """Write a state of a row with the digits that its size throughout the run and its uncertainty support."""
    column = run.variables[name]
    values = column.values
    value, largest = float(values[row]), float(np.nanmax(np.abs(values), initial=0.0))
    digit_count = digits(value, uncertainty=_uncertain_part(run) * largest)
    return f"{name} = {value:.{digit_count}g}{unit_suffix(str(column.attrs['units']))}"


def _state_texts(run: xr.Dataset, names: list[str], first: list[str], row: int) -> Iterator[str]:
    """Write the state of a row; of a long state the first numbers, and how many are left out."""
    shown_names = names if len(names) <= MOST_SHOWN else first[:MOST_SHOWN]
    for name in shown_names:
        yield _state_text(run, name, row)
    if (numbers := run.attrs.get(ALL_NUMBERS, len(names))) > len(shown_names):
        yield f"and {numbers - len(shown_names)} numbers more in the record"


def _involved(run: xr.Dataset, names: list[str], i: int) -> list[str]:
    """Return the numbers of an event's elements among some numbers; all where the event has no elements."""
    shapes, (quantity, *labels) = (
        model_of_record(run, None).shapes,
        words_of_flag(run["event_detector"][[i]])[0].split(DOT),
    )
    numbers = {name: int(run[f"event_{name}"][i]) for name in (*ENDS, *shapes.extents) if f"event_{name}" in run}
    element_labels = {
        shapes.extents[dim].label(number) for dim, number in numbers.items() if dim in shapes.extents and number >= 0
    }
    ends = {numbers[end] for end in ENDS if numbers.get(end, -1) >= 0}
    for dim, label in zip(shapes.dims.get(quantity, ()), labels, strict=False):
        if dim in shapes.relations:
            ends |= {int(end[int(label)]) for end in (shapes.relations[dim].first, shapes.relations[dim].second)}
        else:
            element_labels.add(label)
    related = {dim for relation in shapes.relations.values() for dim in (relation.source, relation.target)}
    extents = [shapes.extents[dim] for dim in related]
    of_ends = {extent.label(number) for extent in extents for number in ends if number < extent.size}
    parts = {name: {*name.split(DOT)[1:]} for name in names}
    return [
        name for name in names if (parts[name] & of_ends if ends else element_labels and element_labels <= parts[name])
    ] or names


def _event_time_text(run: xr.Dataset, i: int) -> str:
    """Write the time of an event with the digits that its uncertainty supports, and that distinguish it from every other."""
    times = run["event_time"].values
    time, doubt = float(times[i]), float(run["event_time_uncertainty"][i])
    time_offsets = np.abs(times - time)
    nearest_gap = float(time_offsets[time_offsets > 0.0].min(initial=np.inf))
    digit_count = digits(time, uncertainty=doubt, relative=_uncertain_part(run), spacing=nearest_gap)
    said = in_long_unit(run["time"], time) if schema.SHOWN_IN in run["time"].attrs else ""
    return f"{time:.{digit_count}g}{_second(run)}{said}"


def _stopped_motions(run: xr.Dataset) -> Iterator[str]:
    """Sum up the energy of motions of many links that were so low that they were stopped."""
    if "closed_force_residual" not in run or "event_energy_lost" not in run:
        return
    energy_lost, units = run["event_energy_lost"].values, run["event_energy_lost"].attrs["units"]
    is_stopped = np.isin(run["event_kind"].values, (schema.REST, schema.STICK)) & (energy_lost != 0.0)
    if is_stopped.any():
        yield (
            f"stopped   {is_stopped.sum()} motions lower than a bounce of rest_height, which took {energy_lost[is_stopped].sum():.3g}"
            f" {units}: event_energy_lost where event_kind is rest or stick"
        )


def _event_descriptions(run: xr.Dataset) -> Iterator[str]:
    """List events one by one; for a name with more than a few, the first one and a line on all."""
    names, kinds = words_of_flag(run["event_detector"]), words_of_flag(run["event_kind"])
    together: dict[tuple[str, str], list[int]] = {}
    for i, label in enumerate(zip(names, kinds, strict=True)):
        together.setdefault(label, []).append(i)
    first_rows = {rows[0]: rows for rows in together.values()}
    single_events = {i for rows in together.values() if len(rows) <= FEW_EVENTS for i in rows}
    for i in sorted({*single_events, *first_rows}):
        yield _event_description(run, names[i], kinds[i], i)
        if i not in single_events:
            yield _event_series(run, names[i], kinds[i], first_rows[i])


def _event_description(run: xr.Dataset, name: str, kind: str, i: int) -> str:
    doubt, row = (
        float(run["event_time_uncertainty"][i]),
        int(row_places(run, run["event_row_before"].values[i : i + 1])[0]),
    )
    moving_names = _moving_names(run)
    involved = _involved(run, moving_names, i) if len(moving_names) > MOST_SHOWN else moving_names
    state = (
        ", ".join(_state_texts(run, moving_names, involved, row)) if row >= 0 else "its rows are not in this selection"
    )
    suffix = "" if kind == schema.EVENT_KINDS[schema.CROSSING] else f" ({kind})"
    return (
        f"event     {name}{suffix} at t = {_event_time_text(run, i)}, located within {doubt:.2g}{_second(run)}: {state}"
    )


def _event_series(run: xr.Dataset, name: str, kind: str, rows: list[int]) -> str:
    times = run["event_time"].values[rows]
    intervals, suffix = np.diff(times), "" if kind == schema.EVENT_KINDS[schema.CROSSING] else f" ({kind})"
    return (
        f"event     {name}{suffix}: {len(rows)} times, the last at t = {_event_time_text(run, rows[-1])};"
        f" {_spacing_text(intervals, _second(run))}"
    )


def _spacing_text(intervals: Any, second: str) -> str:
    """Tell the times between events: one number where it tells all."""
    least, mean, most = (f"{value:.4g}" for value in (intervals.min(), intervals.mean(), intervals.max()))
    return (
        f"{mean}{second} apart"
        if least == most
        else f"on average {mean}{second} apart, from {least}{second} to {most}{second}"
    )


def _moving_names(run: xr.Dataset) -> list[str]:
    """Return what an event's line tells: coordinates and velocities, or the states of a model without any."""
    by_role: dict[str, list[str]] = {}
    for name, variable in run.variables.items():
        role = "state" if variable.attrs.get("role") == "state" else "motion"
        if role == "state" or variable.attrs.get("role") in ("coordinate", "velocity"):
            by_role.setdefault(role, []).append(str(name))
    return by_role.get("motion") or by_role.get("state", [])


@of_shown_elements
def summary_data(run: xr.Dataset) -> dict[str, Any]:
    """Return the summary of a run for scripts: plain numbers and words, times in s, the rest in recorded units."""
    attributes = run.attrs
    data: dict[str, Any] = {"title": str(attributes.get("title", ""))}
    if not is_run(attributes) or not is_whole(attributes):
        return data | {
            "kind": kind_description(attributes),
            "sizes": {str(dim): size for dim, size in run.sizes.items()},
        }
    last = {name: run.variables[name] for name in of_motion(run)}
    end = {name: float(column[-1]) for name, column in last.items()}
    names, kinds = words_of_flag(run["event_detector"]), words_of_flag(run["event_kind"])
    events = [
        {
            "name": name,
            "kind": kind,
            "time": float(run["event_time"][i]),
            "uncertainty": float(run["event_time_uncertainty"][i]),
        }
        for i, (name, kind) in enumerate(zip(names, kinds, strict=True))
    ]
    return data | {
        "outcome": str(attributes["run_outcome"]),
        "text": str(attributes["run_outcome_text"]),
        "method": str(attributes["solver_method"]),
        "force_evaluations": int(attributes["run_force_evaluations"]),
        "sizes": {str(dim): size for dim, size in run.sizes.items()},
        "end": {"time": float(run["time"][-1])} | end,
        "units": {name: str(column.attrs["units"]) for name, column in last.items()},
        "events": events,
        "content_digest": str(attributes.get("content_digest", "")),
    }

"""Refinement of one model over steps, tolerances or rules: numbers, orders of convergence, and uncertainties.

The bounds of a refinement give the size of its next level, and of the level that would reach a wanted change.
"""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.arrays import log, power
from xdynamics.evidence.kept_results import folder_named
from xdynamics.evidence.observables import is_observable, observables_of
from xdynamics.evidence.refining.convergence import STEADY
from xdynamics.evidence.refining.findings import StudyResults, study_dataset, study_stage
from xdynamics.evidence.refining.levels import FEWEST, RTOLS, STEPS, Levels, levels_from_coarsest
from xdynamics.evidence.refining.readings import summary_of_finest
from xdynamics.evidence.refining.study import Study, numbers_by_name
from xdynamics.evidence.refining.subjects import AFTER, ENERGY_RANGE, PERIOD, PHASE, StudyQuantities
from xdynamics.evidence.stages import requested_count
from xdynamics.faults import InputError
from xdynamics.kernels.layout import layout_of
from xdynamics.model import Model
from xdynamics.record.flag_words import time_unit_of, words_of_flag
from xdynamics.record.folding import expand_quantities, model_dimensions, quantity_names
from xdynamics.record.run_dataset import memory_asked
from xdynamics.record.unfolding import unfold
from xdynamics.runtime.files import ROOM, free_memory, size_text
from xdynamics.schema import AT, AT_TIME, LEVEL, OCCURRENCE
from xdynamics.shapes.naming import DOT, display_text, split_element_name
from xdynamics.units import Quantity, parse_quantity, parse_unit, unit_suffix
from xdynamics.units.digits import UNESTIMATED, digits, with_uncertainty

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

MOST_ROWS = 10_000_000  # of a level that is added, by default
COPIES = 2.0  # of a level in memory: its log and its record
LEAST_ORDER = 0.1  # below which changes do not fall


@dataclass(frozen=True)
class Bounds:
    """Limits on a level that is added.

    Attributes
    ----------
    rows : float
    memory : float, optional
        Bytes; by default what is free.
    """

    rows: float = MOST_ROWS
    memory: float | None = None

    def exceeded(self, study: Study, rows: float) -> str:
        """Name the bound that a level of so many rows would exceed; empty if it exceeds none."""
        size, keep = rows * study.outlines[-1].row_bytes, study.levels.keep
        if rows > self.rows:
            return f"more than most_rows = {self.rows:.9g}"
        if keep is not None:
            free = float(shutil.disk_usage(keep).free)
            return f"and the disk of '{keep}' has {size_text(free)} free" if size > free else ""
        room = ROOM * free_memory() / COPIES if self.memory is None else self.memory
        allowance = "can be had" if self.memory is None else "were allowed"
        return f"and {size_text(room)} of memory {allowance}" if size > room else ""


def level_obstacle(study: Study, tolerances: Mapping[str, float], bounds: Bounds) -> str:
    """Return why no further level is marched: the size of the next one, or of the one that is needed; else empty."""
    rows = float(study.outlines[-1].rows)
    growth = _row_growth(study)
    if why := bounds.exceeded(study, rows * growth):
        return f"the next one would have {_extent(study, rows * growth)}, {why}; {_needed_levels(study, tolerances, bounds)[0]}"
    said_of_all, beyond = _needed_levels(study, tolerances, bounds)
    return said_of_all if beyond else ""


def _needed_levels(study: Study, tolerances: Mapping[str, float], bounds: Bounds) -> tuple[str, bool]:
    """Describe the level that each number would need, and return whether one is known to be out of reach."""
    levels, rows, growth = study.levels, float(study.outlines[-1].rows), _row_growth(study)
    sentences, beyond = [], False
    for number in numbers_by_name(study, tolerances) if len(study.outlines) > 1 else ():
        every = number.changes.reshape(-1, number.changes.shape[-1])
        tolerance, changes = tolerances[number.name], np.nanmax(np.abs(every), axis=0, initial=0.0)
        last, change_before = float(changes[-2]), float(changes[-3]) if len(changes) > 2 else np.nan
        if last <= tolerance:
            continue
        if tolerance < float(number.rounding.min()):
            sentences.append(
                f"rounding alone moves {number.name} by {float(number.rounding.min()):.1g} {number.units}: no"
                f" {levels.varied.name} would do"
            )
            beyond = beyond or last <= float(number.rounding.max())
            continue
        ratio = _refinement_ratio(study)
        order = float(log(change_before / last) / log(ratio)) if change_before > 0.0 else levels.formal
        if not order > LEAST_ORDER:
            sentences.append(f"changes of {number.name} do not fall")
            continue
        count = float(np.ceil(float(log(last / tolerance)) / (order * float(log(ratio)))))
        value, needed = float(levels.values[-1]) / float(power(ratio, count)), rows * float(power(growth, count))
        unit = unit_suffix(levels.varied.units or levels.model.time_unit.text)
        sentences.append(
            f"{number.name} would need a {levels.varied.name} of about {value:.2g}{unit}: {_extent(study, needed)}"
        )
        certain, why = len(changes) > 2 and abs(order - levels.formal) <= STEADY, bounds.exceeded(study, needed)
        sentences[-1] += f", {why}" if why else ""
        beyond = beyond or (certain and bool(why))
    return "; ".join(sentences), beyond


def _refinement_ratio(study: Study) -> float:
    """Return how much finer the next level is."""
    values = study.levels.values
    return float(values[-2] / values[-1]) if len(values) > 1 else study.levels.varied.ratio


def _row_growth(study: Study) -> float:
    """Return the ratio of the next level's rows to the last one's."""
    if study.levels.varied == STEPS:
        return _refinement_ratio(study)
    if study.levels.varied == RTOLS and len(study.outlines) > 1:
        return max(1.0, float(study.outlines[-1].rows) / float(study.outlines[-2].rows))
    return 1.0


def _extent(study: Study, rows: float) -> str:
    """Write a number of rows and their size."""
    return f"{rows:.2g} rows ({size_text(rows * study.outlines[-1].row_bytes)})"


MOST_SHOWN = 3  # occurrences of one event, in words
MOST_ELEMENTS = 6  # of one quantity, in words
MOST_AFTER, FEW_AFTER = 2, 12  # of one after events, where it has more elements than a few
COUNT = "event_count_"
DIFFERENT_MOTIONS = (
    "From the first that only one of them met they are different motions, whose orders and limits mean nothing: compare at an"
    " earlier time, or compare averages over many starts, by a sweep"
)
SAID = {"left_out": "left out", "stopped": "stopped"}  # attributes that are printed as they are


def refine(
    model: Model,
    *,
    method: str | None = None,
    steps: Sequence[str | float] | None = None,
    rtols: Sequence[float] | None = None,
    time_tolerances: Sequence[str | float] | None = None,
    precisions: Sequence[str] | None = None,
    rules: Sequence[str] | None = None,
    at: Sequence[str | float] | str | float | None = None,
    observables: Sequence[str] | None = None,
    until_change: Mapping[str, str | float] | None = None,
    defects: bool = False,
    keep: str | Path | None = None,
    most_rows: float | None = None,
    memory: str | float | None = None,
    occurrences: int | None = None,
    compute: bool = True,
    **asked: Any,
) -> xr.Dataset:
    """March a model with several steps, tolerances or rules, and compare the runs at common physical times.

    Parameters
    ----------
    model : Model
    method : str, optional
        As for `simulate`, like everything in `asked`; the same for all levels.
    steps, rtols, time_tolerances, precisions, rules : sequence
        One of these is varied, from coarse to fine, over at least two levels: steps like ``["10 ms", "5 ms"]``;
        relative tolerances, with an `atol` in proportion (the given one is that of the first level; without one it
        follows the sizes of the variables); the time to which every event, contact and switch is located;
        ``["float64", "double_double"]``, whose difference is the rounding error, to the spacing of floats;
        ``["interpolant", "reintegrate"]``, by which states between accepted ones and events are found. With none of them
        `step` or `rtol` is the coarsest of five levels, each a half of the one before, or a tenth.
    at : times, optional
        Where to compare; by default at the earliest end of a level's run. If a time is an accepted one in every level,
        nothing is interpolated.
    observables : sequence of str, optional
        Coordinates, velocities, states, energies, declared observables; by default all coordinates, velocities, states.
        Also `energy_range`, and for a coordinate x `period_x`, the mean period between located crossings, `phase_x`.
    until_change : mapping of str to quantity, optional
        Add finer levels, up to 24, until none of these numbers changes by more than its tolerance from one level
        to the next: ``{"y": "10 m", "event_time_apex": "1 ms"}``. One level to start from is enough then. If the next
        level would exceed the bounds below, or the level needed by the observed order would, none is added, and
        `stopped` says what would be needed.
    defects : bool
        Whether to add the largest local error of a step, as opposed to the accumulated error.
    keep : str or Path, optional
        A folder to which the run of each level is streamed, as `level_0.nc` and so on, in bounded memory; or
        ``"s3://bucket/folder"``. Levels that are whole there are read: the same call continues an interrupted study.
    most_rows : float, optional
        The most rows of a level that is added; ten million by default.
    memory : str or float, optional
        The most that a level may take in memory: ``"2 GB"``, or bytes; by default what is free.
    occurrences : int, optional
        How many occurrences of every event to compare, from the first; nan where there are fewer. By default as many
        as the finest run has, of the events that were met.
    compute : bool
        Whether to march at once. If False, the Dataset has dask arrays, with one task for each level, and nothing is
        marched before one is computed. With events that needs `occurrences`; `until_change` cannot be used.
    **asked
        Further settings, as for `simulate`.

    Returns
    -------
    xarray.Dataset
        Over `level`, from coarse to fine: `step_size`, `rtol`, `time_tolerance`, `precision` or `rule`, `run_digest`, `run_outcome`.
        Over `level` and `at`, for each observable y: y, `difference_y` (to the next finer level), `scaled_difference_y`
        (the same over the largest value in the finest run), `order_y` (signed, of a level with its neighbours),
        `interpolation_error_y`, `gate_y` (whether that is smaller than the difference). Over `at`: `verdict_y`,
        `limit_y`, `uncertainty_y` (of the finest level's value, at about 95 %) and its rule. The same over
        `occurrence` for `event_time_<name>`, with errors of location in place of interpolation, and for the states
        after each event, `after_<name>_y`; `event_count_<name>` over `level`. At the event of an element that is its
        own state, and `all_after_<name>_y` those of all elements, `event_<dim>` being the element of the event; over a
        million numbers they are left out, as the attribute `left_out` says. `difference_scale_y` is what differences
        are scaled by, `crossing_level_x` what begins the cycles of periods and phases. For precisions and rules, which are not numbers, there
        are differences only. With `defects`, `step_defect_y` over `level`.

    Raises
    ------
    InputError
        If there are not at least two levels that get finer, a setting is wrong, or a time is not in every run.

    Notes
    -----
    The order is that of the method in its step, and 1 in a tolerance, to which errors at the end are proportional. The
    verdicts and the rules of uncertainty are in `xdynamics.evidence.refining.convergence`.

    Examples
    --------
    >>> import xdynamics as xd
    >>> model = xd.Model.from_toml("data/models/harmonic_oscillator.toml")
    >>> study = refine(model, method="rk4", steps=["40 ms", "20 ms", "10 ms", "5 ms"], at=["1 s"], observables=["x"])
    >>> study.order_x.values.round(1).ravel().tolist()
    [nan, 4.0, 4.0, nan]
    >>> study.verdict_x.attrs["flag_meanings"].split()[int(study.verdict_x[0])]
    'asymptotic'
    """
    if not isinstance(model, Model):
        raise InputError(f"model is {str(model)[:60]!r}, needs a Model; read a file with Model.from_toml")
    choices: dict[str, Any] = {"steps": steps, "rtols": rtols, "time_tolerances": time_tolerances}
    choices |= {"precisions": precisions, "rules": rules}
    if all(choice is None for choice in choices.values()):
        choices |= levels_from_coarsest(model, asked.pop("step", None), asked.pop("rtol", None))
    shared = asked | ({"method": method} if method else {}) | ({"memory": memory} if memory is not None else {})
    bounds, many = _level_limits(most_rows, memory), requested_count(occurrences, "occurrences")
    folder = None if keep is None else folder_named(keep)
    levels = Levels.of(model, choices, shared, fewest=1 if until_change else FEWEST, keep=folder)
    names = _default_observables(model) if observables is None else _known_observables(model, observables)
    subjects = StudyQuantities(levels, names, at, many, defects)
    if not until_change:
        return study_stage(subjects).result(compute=compute)
    if not compute:
        raise InputError(
            "until_change adds levels until changes are small, and how many is known only once they are computed;"
            " give all levels, or compute=True"
        )
    return _refined_until(until_change, subjects, bounds)


def _refined_until(until_change: Mapping[str, Any], subjects: StudyQuantities, bounds: Bounds) -> xr.Dataset:
    """Add finer levels until changes are small, and say why no further level was added."""
    runs = [subjects.levels.marched(k) for k in range(len(subjects.levels.values))]
    study = Study.of_runs(subjects, runs)
    tolerances, limit = _change_tolerances(until_change, study), ""
    while (changing := _changing(study, tolerances)) and not (limit := level_obstacle(study, tolerances, bounds)):
        try:
            subjects = replace(subjects, levels=subjects.levels.finer())
            runs.append(subjects.levels.marched(len(runs)))
            further = Study(subjects, [*study.outlines, summary_of_finest(subjects)(runs[-1])])
            further.check_reached(study.times)
        except (InputError, MemoryError, OSError) as error:  # no march has such settings, or too little memory or disk
            limit = str(error) or "there is no memory for it"
            break
        study = further.with_readings(runs)
    if len(study.outlines) < FEWEST:
        raise InputError(f"a study needs {FEWEST} levels, and there is no second one: {limit}")
    stopped = _stopped(changing, len(study.outlines), limit)
    return study_dataset(study.subjects, StudyResults.of(study), {"stopped": stopped})


def _level_limits(most_rows: float | None, memory: str | float | None) -> Bounds:
    """Read the limits on a level that is added."""
    if most_rows is not None and not (isinstance(most_rows, int | float) and most_rows >= FEWEST):
        raise InputError(f"most_rows is {most_rows!r}, needs a number of rows")
    return Bounds(MOST_ROWS if most_rows is None else float(most_rows), memory_asked(memory))


def _changing(study: Study, tolerances: Mapping[str, float]) -> list[str]:
    """Name the numbers that changed by more than their tolerance between the last two levels."""
    if len(study.outlines) < FEWEST:
        return list(tolerances)
    last = {number.name: np.abs(number.changes[..., -2]) for number in numbers_by_name(study, tolerances)}
    return [
        name for name, tolerance in tolerances.items() if not (last.get(name, np.array([np.nan])) <= tolerance).all()
    ]


def _default_observables(model: Model) -> tuple[str, ...]:
    """Name coordinates, velocities and states."""
    return tuple(block.name for block in layout_of(model).used.blocks)


def _known_observables(model: Model, names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of observables, refusing those that the model does not have."""
    requested_names = [model.shapes.internal_name(name) for name in ([names] if isinstance(names, str) else names)]
    whole_names = {name for name in requested_names if is_observable(model, name)}
    if whole_names >= {*requested_names}:  # elements whose quantity is asked for are in it
        return tuple(
            name for name in dict.fromkeys(requested_names) if split_element_name(name)[0] not in whole_names - {name}
        )
    extra = [ENERGY_RANGE] if "total_energy" in layout_of(model).derived else []
    extra += [kind + name for name in model.elements.statement.coordinates for kind in (PERIOD, PHASE)]
    available = dict.fromkeys((*observables_of(model), *extra))
    observable_names = [
        element_name
        for name in requested_names
        for element_name in ((name,) if name in whole_names else expand_quantities((name,), available, model.shapes))
    ]
    for name in observable_names:
        if name not in available and name not in whole_names:
            raise InputError(
                f"observable '{name}' is none of the model's; there are {', '.join(quantity_names(available))}"
            )
    return tuple(
        name for name in dict.fromkeys(observable_names) if split_element_name(name)[0] not in whole_names - {name}
    )


def _change_tolerances(until_change: Mapping[str, Any], study: Study) -> dict[str, float]:
    """Read the tolerated change of each number, in its unit."""
    if until_change and not study.levels.ordered:
        raise InputError(f"until_change goes on with finer levels, and {study.levels.varied.keyword} have none")
    names = study.subjects.shapes.with_internal_names(until_change, "until_change names")
    units = {quantity.name: quantity.units for quantity in study.numbers()} if until_change else {}
    units |= {number.name: number.units for number in numbers_by_name(study, names)} if until_change else {}
    tolerances = {}
    for name, allowed_change in names.items():
        if name not in units:
            raise InputError(f"until_change names '{name}'; there are {', '.join(quantity_names(units))}")
        quantity, unit = parse_quantity(allowed_change), parse_unit(units[name])
        bare = not isinstance(allowed_change, str | Quantity)
        if not bare and quantity.unit.dimension != unit.dimension:
            raise InputError(f"until_change of '{name}' is {allowed_change!r}, needs the unit '{units[name]}'")
        tolerances[name] = quantity.value if bare else quantity.si / float(unit.factor)
        if not tolerances[name] > 0.0:
            raise InputError(f"until_change of '{name}' is {allowed_change!r}, needs a positive one")
    return tolerances


def _stopped(changing: list[str], count: int, limit: str) -> str:
    """Describe why no further level was added."""
    if changing:
        return (
            f"after {count} levels, with {', '.join(changing)} still changing by more than its tolerance: no finer"
            f" level, {limit}"
        )
    return f"every change under its tolerance from level {count - 2} to level {count - 1}"


def refinement_lines(study: xr.Dataset) -> list[str]:
    """Describe a refinement, line by line."""
    study = unfold(study) if model_dimensions(study) else study
    varied = str(study.attrs["varied"])
    levels = ", ".join(f"{item:.6g}" if study[varied].dtype.kind == "f" else str(item) for item in study[varied].values)
    units = study[varied].attrs["units"]
    lines = [f"levels    {varied} {levels}{'' if units == '1' else f' {units}'}"]
    outcomes = dict.fromkeys(map(str, study["run_outcome"].values))
    lines.append(f"outcomes  {', '.join(outcomes)}")
    lines.append("±         numerical, at about 95 %; what parameters and the start are uncertain by is not in it")
    names = [str(item) for item in study.data_vars if f"difference_{item}" in study and _is_met(study, str(item))]
    counts = Counter(split_element_name(name)[0] for name in names)
    shown_counts = Counter[str]()
    for name in sorted(names, key=lambda name: "." in name):  # switches hidden in forces, like 'drag.abs', last
        quantity, labels = split_element_name(name)
        shown_counts[quantity] += 1
        if not labels or shown_counts[quantity] <= _max_element_lines(quantity, counts[quantity]):
            lines += _number_lines(study, name, display_text(name))
    further: dict[int, list[str]] = {}
    for quantity, count in counts.items():
        further.setdefault(count - _max_element_lines(quantity, count), []).append(quantity)
    lines += [
        f"{', '.join(quantities)}: {count} further elements{' of each' * (len(quantities) > 1)} are in the record"
        for count, quantities in further.items()
        if count > 0
    ]
    return (
        lines
        + _event_count_lines(study)
        + [f"{word:<9} {study.attrs[key]}" for key, word in SAID.items() if key in study.attrs]
    )


def _max_element_lines(quantity: str, count: int) -> int:
    """Return how many elements of a quantity have lines of their own: fewer for states after the events of many."""
    return MOST_AFTER if quantity.startswith(AFTER) and count > FEW_AFTER else MOST_ELEMENTS


def _event_count_lines(study: xr.Dataset) -> list[str]:
    """Name events that the two finest levels met unequally often, if some states then lack an uncertainty."""
    unknown = any(
        str(name).startswith("uncertainty_") and AT in variable.dims and np.isinf(variable.values).any()
        for name, variable in study.variables.items()
    )
    counts = {
        name.removeprefix(COUNT): variable.values[-2:].tolist()
        for name, variable in ((str(key), count_variable) for key, count_variable in study.variables.items())
        if name.startswith(COUNT) and len(set(variable.values[-2:].tolist())) > 1
    }
    if not (unknown and counts):
        return []
    pairs = ", ".join(
        f"{display_text(name)} {first_count} and {second_count}"
        for name, (first_count, second_count) in list(counts.items())[:MOST_ELEMENTS]
    )
    return [f"attention: the two finest levels did not meet the same events ({pairs} times). {DIFFERENT_MOTIONS}"]


def _is_met(study: xr.Dataset, name: str) -> bool:
    """Whether a number is one to tell; not a state after the event of an element that no level met."""
    return DOT not in name or not name.startswith(AFTER) or not np.isnan(study.variables[name].values).all()


def _number_lines(study: xr.Dataset, name: str, element_text: str) -> Iterator[str]:
    """Describe one number at each of its places, line by line."""
    variables = study.variables  # of many, arrays with coordinates are slow to make
    variable = variables[name]
    places = [dim for dim in variable.dims if dim != LEVEL]
    units = "" if variable.attrs["units"] == "1" else f" {variable.attrs['units']}"
    count = study.sizes[places[0]] if places else 1
    for k in range(count if places != [OCCURRENCE] else min(count, MOST_SHOWN)):
        index = {places[0]: k} if places else {}
        value = float(variable.isel(index)[-1])
        if places == [OCCURRENCE] and np.isnan(variable.isel(index).values).all():
            continue  # another event happens as often
        where = (
            ""
            if not places
            else (
                f" at t = {float(variables[AT_TIME].values[k]):.9g}{unit_suffix(time_unit_of(study))}"
                if places[0] == AT
                else f" [{k + 1}]"
            )
        )
        if np.isnan(value):
            yield f"{element_text}{where} is not there in the finest level"
            continue
        if f"verdict_{name}" not in variables:
            change = float(variables[f"difference_{name}"].isel(index)[-2])
            yield (
                f"{element_text}{where} = {value:.{digits(value, spacing=abs(change) / 10.0)}g}{units}, changed by {change:.3g}{units}"
            )
            continue
        order = float(variables[f"order_{name}"].isel(index)[-2]) if study.sizes[LEVEL] > FEWEST else np.nan
        verdict = words_of_flag(variables[f"verdict_{name}"].isel(index))[0]
        uncertainty = float(variables[f"uncertainty_{name}"].isel(index))
        if np.isinf(uncertainty):
            yield f"{element_text}{where} = {value:.{UNESTIMATED}g}{units}, of unknown uncertainty, {verdict}"
            continue
        order_text = f", order {order:.3g}" if np.isfinite(order) else ""
        yield (f"{element_text}{where} = {with_uncertainty(value, uncertainty)}{units}{order_text}, {verdict}")
    if places == [OCCURRENCE] and name.startswith("event_time_"):  # said once, not of every state after the event
        further = int(np.count_nonzero(~np.isnan(variable.isel({LEVEL: -1}).values))) - MOST_SHOWN
        more = "1 further occurrence is" if further == 1 else f"{further} further occurrences are"
        yield from [f"{element_text}: {more} in the record"] if further > 0 else []


SUMMARIES = {"refinement": refinement_lines}

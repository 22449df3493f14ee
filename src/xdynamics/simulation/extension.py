"""Go on after the end of a complete run, to the bits of one march that also lands on that end."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import record, schema
from xdynamics.archive.seals import slabs
from xdynamics.archive.store import Given
from xdynamics.elementary.arrays import flattened_rows
from xdynamics.faults import InputError
from xdynamics.march import OUTCOMES, March
from xdynamics.march.configuration import settings_for
from xdynamics.march.energy_gains import EventEnergies, Gains, add_gains, work_of
from xdynamics.march.memory import go_on_from_end
from xdynamics.march.outcomes import COMPLETED, INTERRUPTED, STOPPED
from xdynamics.march.run import NO_LINK
from xdynamics.model import Model
from xdynamics.model.assemblies import assemblies, impulse_quantities
from xdynamics.model.motion import constants, decides, drive_pieces, evaluate_over_states
from xdynamics.model.parts import Authorship
from xdynamics.model.regimes import REGIME_NUMBER
from xdynamics.record.arguments import recorded_arguments
from xdynamics.record.named_rows import rows_named
from xdynamics.record.schemas import log_description
from xdynamics.shapes.blocks import Blocks
from xdynamics.shapes.naming import split_element_name
from xdynamics.simulation.unmarched_runs import check_destination, marched_record, open_source_run
from xdynamics.units import TIME, parse_unit, time_in, unit_suffix

if TYPE_CHECKING:
    import xarray as xr

    from xdynamics.march.runner import Progress

Array = NDArray[Any]
Floats = NDArray[np.float64]
ROWS = 1 << 12  # that are looked at together


def extend(
    run: xr.Dataset | Given,
    *,
    until: str | float,
    path: Given | None = None,
    resume: bool = False,
    functions: Mapping[str, Callable[..., float]] | None = None,
    progress: Progress | None = None,
) -> xr.Dataset:
    """Go on after the end of a complete run.

    Nothing is marched twice: a record keeps what its march goes on from. The result is that of one march with the same
    settings up to the new end that also lands on the old one, ``simulate(model, …, nodes=[old end], until=…)``, to the
    bit (`time_tolerance` among them, which goes by the span where that is below a second); it is reproduced and extended
    like any other.

    Parameters
    ----------
    run : xarray.Dataset, str or Path
        A record, or its archive.
    until : str or float
        The new end: ``"20 s"``, or a number of seconds.
    path : str or Path, optional
        Stream the longer run to this file, in bounded memory, and return it opened.
    resume : bool
        Go on from the segments that a process left behind while it extended the run to this file.
    functions : mapping of str to callable, optional
        The Python functions its forces call.
    progress : callable, optional
        Called now and then with the fraction done, the time in s and the rows so far.

    Raises
    ------
    InputError
        If the run did not reach its end, was made by another version, or ends after `until`.

    Examples
    --------
    >>> import xdynamics as xd
    >>> model = xd.Model.from_toml("data/models/harmonic_oscillator.toml")
    >>> longer = extend(xd.simulate(model, step="0.1 s", until="1 s"), until="2 s")
    >>> whole = xd.simulate(model, step="0.1 s", until="2 s", nodes=["1 s"])
    >>> xd.content_digest(longer) == xd.content_digest(whole)
    True
    """
    check_destination(path, resume=resume)
    with open_source_run(run, path, "extend") as source_run:
        model = Model.from_record(
            source_run["model_toml"].values.item(),
            functions=functions,
            about=Authorship.from_attributes(source_run.attrs),
        )
        march = _continued_march(source_run, model, until, progress)
        return marched_record(march, path, _source_rows(source_run, march), resume=resume)


def _continued_march(source_run: xr.Dataset, model: Model, until: str | float, progress: Progress | None) -> March:
    """Return the march that goes on after a run, if the run has all that it needs."""
    _refuse_other_ends(source_run)
    arguments, end = recorded_arguments(source_run), float(source_run.attrs["solver_until"])
    if not time_in(model.time_unit, until, "until") > end:
        raise InputError(
            f"until is {until!r}, needs a time after the end of the run at t = {end!r}{unit_suffix(model.time_unit)}"
        )
    settings = settings_for(model, **arguments | {"until": until, "nodes": [*arguments.get("nodes", ()), end]})
    march = March(model, settings, progress)
    if not record.is_of(source_run, march):
        raise InputError(
            f"the run was made by version {source_run.attrs['xdynamics_version']} of xdynamics, or its forces were written in"
            " other words: run it anew, up to the new end"
        )
    places = {str(name): tuple(entry.dims) for name, entry in source_run.variables.items()}
    needed_dims = {entry.variable.name: entry.variable.dims for entry in record.columns(march)}
    missing = [name for name, dims in needed_dims.items() if places.get(name) != dims]
    if march.layout.reactions or march.layout.smooth:  # energies of impacts and switches that were passed are of states
        recorded_variables = record.unfold(source_run).variables
        left_out = [name for name in march.layout.used if name not in recorded_variables]
        if left_out and (note := log_description(source_run.attrs)):
            raise InputError(f"the run cannot be extended, it has no {', '.join(left_out)}; {note}")
    if missing:
        raise InputError(
            f"the run cannot be extended, it has no {', '.join(missing)}; extend the whole run, or run anew what an"
            " older version made"
        )
    return march


def _refuse_other_ends(source_run: xr.Dataset) -> None:
    """Check that a run reached its end, and that its march can go on."""
    word, text = source_run.attrs["run_outcome"], source_run.attrs["run_outcome_text"]
    if word != OUTCOMES[COMPLETED].word:
        reason = {
            OUTCOMES[STOPPED].word: "what stops a run is its end; give the event another action, and run anew",
            OUTCOMES[INTERRUPTED].word: "resume it first",
        }.get(word, "a run that failed cannot be continued")
        raise InputError(f"the run cannot be extended, it is '{word}' ({text}): {reason}")
    if schema.GIVEN_STEP.name in source_run:
        raise InputError("the run cannot be extended, its steps were given one by one: run anew with all steps")
    if schema.END_MEMORY.name not in source_run or "names" not in source_run[schema.END_MEMORY.name].attrs:
        raise InputError(
            f"the run cannot be extended, it keeps no '{schema.END_MEMORY.name}': it was made by another version of xdynamics;"
            " run anew, up to the new end"
        )


def _source_rows(source_run: xr.Dataset, march: March) -> Iterator[tuple[str, Array]]:
    """Yield the rows of a run, its end as a node, and restore the march at that end."""
    _restore_march(source_run, march)
    for column in record.columns(march):
        name = column.variable.name
        first = 0
        for values in slabs(source_run.variables[name]):
            first += len(values)
            ends_here = name == "row_kind" and first == source_run.sizes[schema.STEPS] and values[-1] == schema.STEP
            yield name, np.append(values[:-1], np.int8(schema.NODE)) if ends_here else values


def _restore_march(source_run: xr.Dataset, march: March) -> None:
    """Set a march to where a run ended."""
    folded_run = source_run
    if march.layout.smooth or not {"event_energy_lost", "event_position"}.isdisjoint(source_run.variables):
        source_run = record.unfold(source_run)  # these are told of elements
    memory, numbers = (
        str(source_run[schema.END_MEMORY.name].attrs["names"]),
        np.asarray(source_run[schema.END_MEMORY.name].values),
    )
    rows = int(source_run[schema.STEP_NUMBER.name][-1]) + 1
    if march.thinning:
        march.thinning.stand_behind(source_run.sizes[schema.STEPS])
    recalls_witnesses = schema.WITNESSES in memory.split() or not march.settings.keeps_states
    if recalls_witnesses:
        memory, numbers = _restore_witnesses(march, memory, numbers, rows)
    go_on_from_end(march.run, memory, numbers)
    if march.run.plan["slides"][0]:
        march.sliding.recall(march.run.modes, int(march.now.regime))
    run_state = march.now
    if int(run_state.rows) != rows or float(run_state.t) * march.settings.scales.si_factor(TIME) != float(
        source_run["time"][-1]
    ):
        raise InputError(
            f"the run has {rows} rows and its memory is of {int(run_state.rows)}: it was cut; extend the whole run"
        )
    if "event_energy_lost" in source_run and source_run.sizes[schema.EVENTS]:
        march.gains = add_gains(Gains(), march.layout, _event_energies(source_run, march), 0)
    if "event_position" in source_run:
        labels = source_run["event_detector"].attrs["flag_meanings"].replace(":", ".").split()
        far_events = {
            labels[i]
            for i in source_run["event_detector"].values[source_run["event_position"].values == schema.FAR].tolist()
        }
        march.misplaced = np.array([entry.name in far_events for entry in march.layout.watched])
    _restore_passed(source_run, march)
    march.event_pairs = int((source_run["row_kind"].values == schema.EVENT_AFTER).sum())
    if recalls_witnesses:
        return
    stride = march.witnesses.stride(rows)
    scale, used = march.settings.scales.si_factor(TIME), march.layout.used
    times = [folded_run.variables[name].values[::stride] / scale for name in ("time", "step_size")]
    witnesses = np.vstack([np.arange(0.0, rows, stride), *times, _state_rows(folded_run, march, used, stride)])
    estimated = used.renamed("error", schema.error) if march.estimated else Blocks(())
    march.witnesses.put(witnesses, _state_rows(folded_run, march, estimated, stride))


def _state_rows(source_run: xr.Dataset, march: March, names: Blocks, stride: int) -> Floats:
    """Return every so many values of quantities that are as the state is, as the march has them, a row for each number."""
    numbers = [np.empty((0, len(range(0, source_run.sizes[schema.STEPS], stride))))]
    for block, state_block in zip(names.blocks, march.layout.used.blocks, strict=False):  # there may be no names
        unit = march.model.elements.units[state_block.first]
        factor = march.settings.scales.si_factor(unit.dimension) / float(unit.factor)
        values = source_run.variables[block.name].values[::stride]
        numbers.append(flattened_rows(values).T / factor)
    return np.concatenate(numbers)


def _restore_witnesses(march: March, memory: str, numbers: Floats, rows: int) -> tuple[str, Floats]:
    """Split off the witness rows of the complete march, which a thinned record stores after its memory."""
    remaining_memory, count, used = memory, len(range(0, rows, march.witnesses.stride(rows))), march.layout.used.size
    errors = np.full((len(march.estimated), count), np.nan)
    if memory.endswith(f" {schema.ERRORS}") and numbers.size >= errors.size:
        border = numbers.size - errors.size
        remaining_memory, numbers, errors = (
            remaining_memory.removesuffix(f" {schema.ERRORS}"),
            numbers[:border],
            numbers[border:].reshape(errors.shape),
        )
    border = numbers.size - (3 + used) * count
    if not remaining_memory.endswith(f" {schema.WITNESSES}") or border < 0:
        raise InputError(
            f"the run cannot be extended, its '{schema.END_MEMORY.name}' has no {schema.WITNESSES}: run it anew, up to the new end"
        )
    march.witnesses.put(numbers[border:].reshape(3 + used, count), errors)
    return remaining_memory.removesuffix(f" {schema.WITNESSES}"), numbers[:border]


def _event_energies(source_run: xr.Dataset, march: March) -> EventEnergies:
    """Return the events of a record; detectors of one contact are represented by their first."""
    labels = source_run["event_detector"].attrs["flag_meanings"].replace(":", ".").split()
    names = [detector_name.name for detector_name in march.layout.watched]
    detector = np.array([names.index(detector_name) for detector_name in labels])[source_run["event_detector"].values]
    row_before, row_after = (
        rows_named(source_run, f"event_row_{detector_name}") for detector_name in ("before", "after")
    )
    speeds = np.zeros((march.layout.coordinates.size, row_before.size))
    for i, name in enumerate(march.layout.coordinates):
        speed = np.abs(source_run.variables[schema.velocity(name)].values) * float(
            parse_unit(source_run.variables[schema.velocity(name)].attrs["units"]).factor
        )
        speeds[i] = speed[row_before] + speed[row_after]
    return EventEnergies(
        source_run["event_kind"].values,
        row_before,
        detector,
        _event_links(source_run, march, detector),
        source_run["event_time"].values,
        source_run["event_energy_lost"].values,
        work_of(march.layout, _event_impulses(source_run, march), speeds),
    )


def _event_impulses(source_run: xr.Dataset, march: March) -> Floats:
    """Return the impulses of the events of a record, as a log has them."""
    model, count = march.model, source_run.sizes[schema.EVENTS]
    if not model.assemblies:
        return np.array([source_run.variables[f"event_impulse_{name}"].values for name in march.layout.coordinates])
    ends = []
    for end in ("first", "second"):
        for name, body in impulse_quantities(assemblies(model)).items():
            shape = model.shapes.shape(tuple(dim for dim in model.shapes.dims.get(name, ()) if dim != body))
            prefix = f"event_impulse_{end}_{name}"
            impulses = [
                source_run[key].values.reshape(count, -1).T
                for key in source_run.variables
                if split_element_name(str(key))[0] == prefix
            ]
            ends += impulses or [np.zeros((prod(shape), count))]  # along what no link moves
    return np.concatenate(ends)


def _event_links(source_run: xr.Dataset, march: March, detector: Array) -> Array:
    """Return the link of each event of a record."""
    links = np.full(source_run.sizes[schema.EVENTS], NO_LINK)
    for assembly in assemblies(march.model):
        of_assembly = np.array([march.layout.watched[i].name == assembly.name for i in detector], dtype=bool)
        numbers = tuple(source_run[f"event_{dim}"].values[of_assembly] for dim in assembly.dims)
        links[of_assembly] = np.ravel_multi_index(numbers, march.model.shapes.shape(assembly.dims)) if numbers else 0
    return links


def _restore_passed(source_run: xr.Dataset, march: March) -> None:
    """Restore the state of smooth switches at a run's end: sides, number of passages, and time of the first."""
    smooth_switches, model = march.layout.smooth, march.model
    if not smooth_switches:
        return
    memory = march.run.w[march.run.w.size - 3 * len(smooth_switches) :].reshape(-1, 3)
    memory[:, 1] = source_run[schema.PASSED.name].values
    memory[:, 2] = np.nan_to_num(source_run[schema.FIRST_PASSED.name].values) / march.settings.scales.si_factor(TIME)
    factors = {name: float(unit.factor) for name, unit in model.elements.units.items()}
    for first in range(
        source_run.sizes[schema.STEPS] - ROWS, -ROWS, -ROWS
    ):  # from the end, to where each was last away from zero
        rows = slice(max(first, 0), first + ROWS)
        state = {name: source_run.variables[name].values[rows] * factors[name] for name in march.layout.used}
        state |= {"t": source_run["time"].values[rows], REGIME_NUMBER: source_run["regime"].values[rows].astype(float)}
        trees = [tree for entry in smooth_switches for tree in (entry.function, decides(model, entry))]
        values = evaluate_over_states(model, trees, state, constants(model), drive_pieces(model))
        for k in np.flatnonzero(memory[:, 0] == 0.0).tolist():
            value, holds = (np.broadcast_to(entry, state["t"].shape) for entry in values[2 * k : 2 * k + 2])
            nonzero_rows = np.flatnonzero(value != 0.0)
            memory[k, 0] = (
                np.sign(value[nonzero_rows[-1]]) if nonzero_rows.size and holds[nonzero_rows[-1] :].all() else 0.0
            )
        if memory[:, 0].all():
            return

"""Go on after the end of a complete run, to the bits of one march that also lands on that end."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import record
from xdynamics.archive.place import Given
from xdynamics.archive.seals import slabs
from xdynamics.elementary.arrays import flattened
from xdynamics.faults import InputError
from xdynamics.march import OUTCOMES, March
from xdynamics.march.configuration import settings_for
from xdynamics.march.energy_gains import EventEnergies, Gains, with_more, work_of
from xdynamics.march.memory import go_on
from xdynamics.march.outcomes import COMPLETED, INTERRUPTED, STOPPED
from xdynamics.march.run import NO_LINK
from xdynamics.model import Model
from xdynamics.model.assemblies import assemblies, bodies
from xdynamics.model.motion import REGIME_NUMBER, constants, decides, evaluated_many, tables_of
from xdynamics.model.parts import Authorship
from xdynamics.record.arguments import asked_of
from xdynamics.record.named_rows import rows_named
from xdynamics.record.partial_records import log_description
from xdynamics.schema import (
    END_MEMORY,
    ERRORS,
    EVENT_AFTER,
    EVENTS,
    FAR,
    FIRST_PASSED,
    GIVEN_STEP,
    NODE,
    PASSED,
    STEP,
    STEP_NUMBER,
    STEPS,
    WITNESSES,
    error,
    velocity,
)
from xdynamics.shapes.blocks import Blocks
from xdynamics.shapes.naming import parted
from xdynamics.simulation.records import check_destination, kept_run, marched_record
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
    with kept_run(run, path, "extend") as kept:
        model = Model.from_record(
            kept["model_toml"].values.item(), functions=functions, about=Authorship.of(kept.attrs)
        )
        march = _march_on(kept, model, until, progress)
        return marched_record(march, path, _rows(kept, march), resume=resume)


def _march_on(kept: xr.Dataset, model: Model, until: str | float, progress: Progress | None) -> March:
    """Return the march that goes on after a run, if the run has all that it needs."""
    _refuse_other_ends(kept)
    arguments, end = asked_of(kept), float(kept.attrs["solver_until"])
    if not time_in(model.time_unit, until, "until") > end:
        raise InputError(
            f"until is {until!r}, needs a time after the end of the run at t = {end!r}{unit_suffix(model.time_unit)}"
        )
    settings = settings_for(model, **arguments | {"until": until, "nodes": [*arguments.get("nodes", ()), end]})
    march = March(model, settings, progress)
    if not record.is_of(kept, march):
        raise InputError(
            f"the run was made by version {kept.attrs['xdynamics_version']} of xdynamics, or its forces were written in"
            " other words: march it anew, up to the new end"
        )
    places = {str(name): tuple(entry.dims) for name, entry in kept.variables.items()}
    needed = {entry.variable.name: entry.variable.dims for entry in record.columns(march)}
    missing = [name for name, dims in needed.items() if places.get(name) != dims]
    if march.layout.reactions or march.layout.smooth:  # energies of impacts and switches that were passed are of states
        there = record.unfold(kept).variables
        left_out = [name for name in march.layout.used if name not in there]
        if left_out and (note := log_description(kept.attrs)):
            raise InputError(f"the run cannot be extended, it has no {', '.join(left_out)}; {note}")
    if missing:
        raise InputError(
            f"the run cannot be extended, it has no {', '.join(missing)}; extend the whole run, or march anew what an"
            " older version made"
        )
    return march


def _refuse_other_ends(kept: xr.Dataset) -> None:
    """Check that a run reached its end, and that its march can go on."""
    word, text = kept.attrs["run_outcome"], kept.attrs["run_outcome_text"]
    if word != OUTCOMES[COMPLETED].word:
        why = {
            OUTCOMES[STOPPED].word: "what stops a run is its end; give the event another action, and march anew",
            OUTCOMES[INTERRUPTED].word: "resume it first",
        }.get(word, "a run that failed cannot be continued")
        raise InputError(f"the run cannot be extended, it is '{word}' ({text}): {why}")
    if GIVEN_STEP.name in kept:
        raise InputError("the run cannot be extended, its steps were given one by one: march anew with all steps")
    if END_MEMORY.name not in kept or "names" not in kept[END_MEMORY.name].attrs:
        raise InputError(
            f"the run cannot be extended, it keeps no '{END_MEMORY.name}': it was made by another version of xdynamics;"
            " march anew, up to the new end"
        )


def _rows(kept: xr.Dataset, march: March) -> Iterator[tuple[str, Array]]:
    """Yield the rows of a run, its end as a node, and put the march there."""
    _stand_behind(kept, march)
    for column in record.columns(march):
        name = column.variable.name
        first = 0
        for values in slabs(kept.variables[name]):
            first += len(values)
            ends_here = name == "row_kind" and first == kept.sizes[STEPS] and values[-1] == STEP
            yield name, np.append(values[:-1], np.int8(NODE)) if ends_here else values


def _stand_behind(kept: xr.Dataset, march: March) -> None:
    """Set a march to where a run ended."""
    whole = kept
    if march.layout.smooth or not {"event_energy_lost", "event_position"}.isdisjoint(kept.variables):
        kept = record.unfold(kept)  # these are told of elements
    memory, numbers = str(kept[END_MEMORY.name].attrs["names"]), np.asarray(kept[END_MEMORY.name].values)
    rows = int(kept[STEP_NUMBER.name][-1]) + 1
    if march.thinning:
        march.thinning.stand_behind(kept.sizes[STEPS])
    recalled = WITNESSES in memory.split() or not march.settings.keeps_states
    if recalled:
        memory, numbers = _recall_witnesses(march, memory, numbers, rows)
    go_on(march.run, memory, numbers)
    now = march.now
    if int(now.rows) != rows or float(now.t) * march.settings.scales.of(TIME) != float(kept["time"][-1]):
        raise InputError(
            f"the run has {rows} rows and its memory is of {int(now.rows)}: it was cut; extend the whole run"
        )
    if "event_energy_lost" in kept and kept.sizes[EVENTS]:
        march.gains = with_more(Gains(), march.layout, _impacts_of(kept, march), 0)
    if "event_position" in kept:
        labels = kept["event_detector"].attrs["flag_meanings"].replace(":", ".").split()
        far = {labels[i] for i in kept["event_detector"].values[kept["event_position"].values == FAR].tolist()}
        march.misplaced = np.array([entry.name in far for entry in march.layout.watched])
    _recall_passed(kept, march)
    march.event_pairs = int((kept["row_kind"].values == EVENT_AFTER).sum())
    if recalled:
        return
    stride = march.witnesses.stride(rows)
    scale, used = march.settings.scales.of(TIME), march.layout.used
    times = [whole.variables[name].values[::stride] / scale for name in ("time", "step_size")]
    witnesses = np.vstack([np.arange(0.0, rows, stride), *times, _states(whole, march, used, stride)])
    estimated = used.renamed("error", error) if march.estimated else Blocks(())
    march.witnesses.put(witnesses, _states(whole, march, estimated, stride))


def _states(kept: xr.Dataset, march: March, names: Blocks, stride: int) -> Floats:
    """Return every so many values of quantities that are as the state is, as the march has them, a row for each number."""
    numbers = [np.empty((0, len(range(0, kept.sizes[STEPS], stride))))]
    for block, own in zip(names.blocks, march.layout.used.blocks, strict=False):  # there may be no names
        unit = march.model.units[own.first]
        factor = march.settings.scales.of(unit.dimension) / float(unit.factor)
        values = kept.variables[block.name].values[::stride]
        numbers.append(flattened(values).T / factor)
    return np.concatenate(numbers)


def _recall_witnesses(march: March, memory: str, numbers: Floats, rows: int) -> tuple[str, Floats]:
    """Split off the rows of the whole march that a record without all rows keeps after its memory."""
    kept, count, used = memory, len(range(0, rows, march.witnesses.stride(rows))), march.layout.used.size
    errors = np.full((len(march.estimated), count), np.nan)
    if memory.endswith(f" {ERRORS}") and numbers.size >= errors.size:
        border = numbers.size - errors.size
        kept, numbers, errors = (
            kept.removesuffix(f" {ERRORS}"),
            numbers[:border],
            numbers[border:].reshape(errors.shape),
        )
    border = numbers.size - (3 + used) * count
    if not kept.endswith(f" {WITNESSES}") or border < 0:
        raise InputError(
            f"the run cannot be extended, its '{END_MEMORY.name}' has no {WITNESSES}: march it anew, up to the new end"
        )
    march.witnesses.put(numbers[border:].reshape(3 + used, count), errors)
    return kept.removesuffix(f" {WITNESSES}"), numbers[:border]


def _impacts_of(kept: xr.Dataset, march: March) -> EventEnergies:
    """Return the events of a record; detectors of one contact are represented by their first."""
    labels = kept["event_detector"].attrs["flag_meanings"].replace(":", ".").split()
    names = [item.name for item in march.layout.watched]
    detector = np.array([names.index(item) for item in labels])[kept["event_detector"].values]
    row, after = (rows_named(kept, f"event_row_{item}") for item in ("before", "after"))
    speeds = np.zeros((march.layout.coordinates.size, row.size))
    for i, name in enumerate(march.layout.coordinates):
        speed = np.abs(kept.variables[velocity(name)].values) * float(
            parse_unit(kept.variables[velocity(name)].attrs["units"]).factor
        )
        speeds[i] = speed[row] + speed[after]
    return EventEnergies(
        kept["event_kind"].values,
        row,
        detector,
        _links_of(kept, march, detector),
        kept["event_time"].values,
        kept["event_energy_lost"].values,
        work_of(march.layout, _impulses_of(kept, march), speeds),
    )


def _impulses_of(kept: xr.Dataset, march: March) -> Floats:
    """Return the impulses of the events of a record, as a log has them."""
    model, count = march.model, kept.sizes[EVENTS]
    if not model.assemblies:
        return np.array([kept.variables[f"event_impulse_{name}"].values for name in march.layout.coordinates])
    ends = []
    for end in ("first", "second"):
        for name, body in bodies(assemblies(model)).items():
            shape = model.shapes.shape(tuple(dim for dim in model.shapes.dims.get(name, ()) if dim != body))
            place = f"event_impulse_{end}_{name}"
            own = [kept[key].values.reshape(count, -1).T for key in kept.variables if parted(str(key))[0] == place]
            ends += own or [np.zeros((prod(shape), count))]  # along what no link moves
    return np.concatenate(ends)


def _links_of(kept: xr.Dataset, march: March, detector: Array) -> Array:
    """Return the link of each event of a record."""
    links = np.full(kept.sizes[EVENTS], NO_LINK)
    for assembly in assemblies(march.model):
        own = np.array([march.layout.watched[i].name == assembly.name for i in detector], dtype=bool)
        numbers = tuple(kept[f"event_{dim}"].values[own] for dim in assembly.dims)
        links[own] = np.ravel_multi_index(numbers, march.model.shapes.shape(assembly.dims)) if numbers else 0
    return links


def _recall_passed(kept: xr.Dataset, march: March) -> None:
    """Restore what a run knew of smooth switches at its end: their side, how often they were passed, and since when."""
    smooth, model = march.layout.smooth, march.model
    if not smooth:
        return
    memory = march.run.w[march.run.w.size - 3 * len(smooth) :].reshape(-1, 3)
    memory[:, 1] = kept[PASSED.name].values
    memory[:, 2] = np.nan_to_num(kept[FIRST_PASSED.name].values) / march.settings.scales.of(TIME)
    factors = {name: float(unit.factor) for name, unit in model.units.items()}
    for first in range(kept.sizes[STEPS] - ROWS, -ROWS, -ROWS):  # from the end, to where each was last away from zero
        rows = slice(max(first, 0), first + ROWS)
        state = {name: kept.variables[name].values[rows] * factors[name] for name in march.layout.used}
        state |= {"t": kept["time"].values[rows], REGIME_NUMBER: kept["regime"].values[rows].astype(float)}
        trees = [tree for entry in smooth for tree in (entry.function, decides(model, entry))]
        values = evaluated_many(model, trees, state, constants(model), tables_of(model))
        for k in np.flatnonzero(memory[:, 0] == 0.0).tolist():
            value, holds = (np.broadcast_to(entry, state["t"].shape) for entry in values[2 * k : 2 * k + 2])
            away = np.flatnonzero(value != 0.0)
            memory[k, 0] = np.sign(value[away[-1]]) if away.size and holds[away[-1] :].all() else 0.0
        if memory[:, 0].all():
            return

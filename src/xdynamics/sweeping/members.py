"""Marching of a block of members: recorded variables, outcome and digest of each.

The complete runs of a sweep are stored in files, each named by the digest of all inputs of its run.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from hashlib import sha256
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import record, schema
from xdynamics.archive.folder_store import store_of
from xdynamics.archive.reading import open_run, verify_digests
from xdynamics.archive.seals import tail_of
from xdynamics.archive.segments import clear_segments, has_segments, stream_to_writer
from xdynamics.archive.store import Place, TakenError
from xdynamics.evidence.runs import march_model
from xdynamics.faults import ArchiveError, InputError, ModelError
from xdynamics.march import March, Runs
from xdynamics.march.accuracy_warnings import uncontrolled
from xdynamics.march.log import Room
from xdynamics.march.outcome_text import ending
from xdynamics.march.outcomes import OUTCOMES, STOPPED, WORDS
from xdynamics.methods.scheme import FLOAT64
from xdynamics.model.switches import smooth_switches
from xdynamics.record.folding import names_as_words
from xdynamics.record.provenance import xdynamics_version
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.shapes.naming import display_text
from xdynamics.sweeping.ensemble_records import MemberRuns, parallel_parts
from xdynamics.sweeping.grid import AxisIndices, Group, SweepGrid
from xdynamics.sweeping.kept_quantities import (
    COUNT,
    COUNT_FUNCTIONS,
    DIAGNOSTIC,
    DIGEST,
    OUTCOME,
    STOPPED_BY,
    STRAYED,
    UNCONTROLLED,
    Keeping,
    KeptVariable,
    run_values,
)

if TYPE_CHECKING:
    import xarray as xr

Values = NDArray[Any]
Block = Sequence[slice]

LOG_BYTES = 12_000_000  # of complete logs held at once
FIRST_BATCH, MAX_BATCH, BATCH_GROWTH = (
    128,
    16_384,
    16,
)  # members whose logs are held: at first, at most, and growth factor
FEW_ROWS = 32  # of a member's log, with which the first ones are held
REFINED = (
    schema.REASON_NONFINITE,
    schema.REASON_DOMAIN,
    schema.REASON_NEWTON,
)  # whose cause is found by repeating the step
LONGEST_WORD = max(map(len, WORDS))
# 2**64 over the golden ratio: its multiples modulo 2**64 spread evenly (Knuth, The Art of Computer Programming 3, 6.4)
_GOLDEN = 0x9E3779B97F4A7C15

FILE, SEAL, CONTENT_DIGEST = "run_file", schema.RUN_SEAL, "content digest of the run's archive"
DIGITS = 32  # of a digest of an end: enough to tell a million runs apart, and half the memory
DIGEST_DESCRIPTION = (
    "first 32 digits of a sha256 of time and state at the run's end, its counts, the time of every event"
)


@dataclass(frozen=True)
class Plan:
    """A grid of runs with the variables to record of every member.

    Attributes
    ----------
    grid : SweepGrid
    keeping : Keeping
    check : float
        Fraction of members that are also marched alone, and compared bit for bit.
    """

    grid: SweepGrid
    keeping: Keeping
    check: float = 0.0

    def __reduce__(self) -> Any:
        return Plan, (self.grid, self.keeping, self.check)

    @cached_property
    def digest(self) -> str:
        """sha256 of everything that the numbers of the sweep depend on."""
        grid, keeping = self.grid, self.keeping
        axes = [
            [
                axis.dim,
                [
                    [entry.name, entry.kind, entry.unit.text, entry.values.tolist(), entry.tables, *entry.exact_texts]
                    for entry in axis.columns
                ],
            ]
            for axis in grid.axes
        ]
        words = [
            grid.model.digest,
            grid.shared_settings,
            axes,
            keeping.words,
            keeping.times.tolist(),
            keeping.occurrences,
        ]
        flag_variables = [entry.name for entry in self.variables if entry.more]  # which folders of before may not have
        text = json.dumps([*words, grid.math_functions, xdynamics_version(), *flag_variables], sort_keys=True)
        return sha256(text.encode()).hexdigest()

    @cached_property
    def variables(self) -> tuple[KeptVariable, ...]:
        """The variables recorded of every member."""
        settings = self.grid.settings_of((0,) * len(self.grid.shape))
        kept_variables = [
            KeptVariable(
                "end_time",
                (),
                (),
                self.grid.model.time_unit.text,
                "time at which the run ended",
                "time",
                lambda runs: runs.last_values("time"),
            ),
            *self.keeping.variables(self.grid.model, settings),
        ]
        counts = [
            KeptVariable(name, (), (), "1", name.removeprefix("run_").replace("_", " "), COUNT, take, dtype="i8")
            for name, take in COUNT_FUNCTIONS.items()
        ]
        return (*kept_variables, *counts, *self._run_variables)

    @property
    def _run_variables(self) -> list[KeptVariable]:
        """The variables that judge every member as a run: doubts, outcome, digest, file."""
        keeps_runs = self.keeping.keeps_whole_runs
        stops = [name for name, event in self.grid.model.elements.events.items() if event.action == "stop"]
        run_variables = _FILES if keeps_runs else []
        run_variables = [
            *run_variables,
            _judgement_variable(UNCONTROLLED, _OF_UNCONTROLLED, DIAGNOSTIC, _no_errors, "i4"),
        ]
        if smooth_switches(self.grid.model):
            run_variables.append(_judgement_variable(schema.PASSED.name, _OF_PASSED, DIAGNOSTIC, _passed_counts, "i8"))
        if any(event.action == "reset" for event in self.grid.model.elements.events.values()):
            run_variables.append(_judgement_variable(STRAYED, _OF_STRAYED, DIAGNOSTIC, _strayed_counts, "i8"))
        run_variables.append(
            _judgement_variable(OUTCOME, "how the run ended", "outcome", _outcomes, f"U{LONGEST_WORD}")
        )
        if stops:
            longest = max(map(len, map(display_text, stops)))
            run_variables.append(
                _judgement_variable(
                    STOPPED_BY, "event that ended the run, where one did", "outcome", _stopped_by, f"U{longest}"
                )
            )
        content, dtype = (CONTENT_DIGEST, "U64") if keeps_runs else (DIGEST_DESCRIPTION, f"U{DIGITS}")
        return [*run_variables, _judgement_variable(DIGEST, content, "digest", _end_digests, dtype)]


def march_block(plan: Plan, block: Block, copy_existing: CopyExisting | None = None) -> dict[str, Values]:
    """March the members of a block.

    Parameters
    ----------
    plan : Plan
    block : sequence of slice
    copy_existing : callable, optional
        Copies what is known of members into the arrays, by name, in the shape of the block, and returns which members
        these are; they are not marched.

    Returns
    -------
    dict of str to ndarray
        Every variable; dimensions of the block, followed by those of the variable.
    """
    shape = plan.grid.block_shape(block)
    size = int(np.prod(shape))
    arrays = {variable.name: np.empty((size, *variable.sizes), variable.dtype) for variable in plan.variables}
    existing_members = np.zeros(size, bool)
    if copy_existing is not None:
        # reshaped views: what is copied into them stands in the arrays
        existing_members = copy_existing(
            plan, block, {name: variable.reshape(*shape, *variable.shape[1:]) for name, variable in arrays.items()}
        ).ravel()
    reads = tuple(
        dict.fromkeys(name for variable in plan.variables for name in (*variable.motion, *variable.log_columns))
    )
    for full_group in plan.grid.groups(block):
        group = full_group.excluding(existing_members)
        parts = parallel_parts(group.model, group.settings) if reads and group.block_indices.size else None
        for part, runs in _batches(group, reads):
            member_runs = MemberRuns(group.model, group.settings, runs, parts)
            for variable in plan.variables:
                arrays[variable.name][group.block_indices[part]] = variable.take(member_runs)
            arrays[UNCONTROLLED][group.block_indices[part]] = _uncontrolled(group, member_runs, part)
    _recheck_members(plan, block, arrays, existing_members)
    _read_whole_runs(plan, block, arrays, existing_members)
    return {name: values.reshape(*shape, *values.shape[1:]) for name, values in arrays.items()}


def _batches(group: Group, reads: tuple[str, ...]) -> Iterator[tuple[slice, Runs]]:
    """March a group; if logs are read, or each member is posed alone, as many at a time as the memory limit allows."""
    one_by_one = group.settings.precision != FLOAT64
    row = max(1, 8 * len(reads))
    first_count = max(1, min(FIRST_BATCH, LOG_BYTES // (FEW_ROWS * row)))
    begin, count, room = 0, first_count if reads or one_by_one else len(group.block_indices), Room()
    while begin < len(group.block_indices):
        part = slice(begin, begin + count)
        runs = group.march_members(part, logs=reads, room=room)
        yield part, runs
        begin += count
        rows = max(1, int(runs.rows.max()) * row)
        count = min(BATCH_GROWTH * count, MAX_BATCH, max(1, LOG_BYTES // rows)) if reads else count


CopyExisting = Callable[[Plan, Block, dict[str, Values]], NDArray[np.bool_]]


def _empty_texts(runs: MemberRuns) -> Values:
    return np.full(runs.size, "")


def _outcomes(runs: MemberRuns) -> Values:
    words = np.array([OUTCOMES[status].word if status in OUTCOMES else "" for status in range(max(OUTCOMES) + 1)])
    return words[runs.runs.status]


def _passed_counts(runs: MemberRuns) -> Values:
    """Count how often steps passed switches that are declared smooth."""
    counts: Values = runs.runs.passed.sum(axis=1)
    return counts


def _strayed_counts(runs: MemberRuns) -> Values:
    """Count the events that set the motion back from beyond zero."""
    counts: Values = runs.runs.strayed
    return counts


def _stopped_by(runs: MemberRuns) -> Values:
    """Name the last event of every run that was stopped by an event."""
    names = runs.detectors or ("",)
    words = np.array([names_as_words([name]) for name in names])
    stops = [
        i
        for i, name in enumerate(names)
        if name in runs.model.elements.events and runs.model.elements.events[name].action == "stop"
    ]
    places = np.flatnonzero(np.isin(runs.event_detectors, stops))
    is_stopped = runs.runs.status == STOPPED
    # where the next member's events begin, the stop just before is this member's last event
    last = places[np.searchsorted(places, runs.runs.first_event[1:][is_stopped]) - 1]
    events = np.full(runs.size, "", dtype=words.dtype)
    events[is_stopped] = words[runs.event_detectors[last]]
    return events


def end_descriptions(sweep: xr.Dataset) -> xr.DataArray:
    """Return how every member ended, with the event that stopped it."""
    outcome = sweep[OUTCOME]
    if STOPPED_BY not in sweep or sweep[STOPPED_BY].dims != outcome.dims:
        return outcome
    import xarray as xr

    texts = [
        f"{word} {event}".strip()
        for word, event in zip(outcome.values.ravel().tolist(), sweep[STOPPED_BY].values.ravel().tolist(), strict=True)
    ]
    return xr.DataArray(np.array(texts).reshape(outcome.shape), dims=outcome.dims)


def _uncontrolled(group: Group, runs: MemberRuns, part: slice) -> Values:
    """Count the variables that the tolerances did not control, for every member by its own tolerance."""
    tolerances, layout, rtols = group.settings.tolerances, runs.layout, group.arrays.get("rtols")
    if not group.settings.adaptive or tolerances is None:
        return np.zeros(runs.size, np.int64)
    scales = group.settings.scales
    largest = runs.runs.largest * np.array(
        [scales.si_factor(layout.model.elements.dimensions[name]) for name in layout.used]
    )
    if rtols is None:
        return np.asarray(np.count_nonzero(uncontrolled(tolerances, layout, largest, runs.runs.accepted), axis=1))
    members = zip(rtols[part].tolist(), largest, runs.runs.accepted.tolist(), strict=True)
    return np.array(
        [
            uncontrolled(replace(tolerances, rtol=rtol), layout, *member_numbers).sum()
            for rtol, *member_numbers in members
        ]
    )


def _end_digests(runs: MemberRuns) -> Values:
    """Digest the end, the counts and the event times of every member."""
    names = ("time", *(block.name for block in runs.layout.used.blocks))
    ends = np.concatenate([runs.last_values(name).reshape(runs.size, -1) for name in names], axis=1)
    counts = np.stack([count(runs) for count in COUNT_FUNCTIONS.values()], axis=1)
    rows, events = _little_endian_bytes(ends, counts), runs["event_time"].astype("<f8").tobytes()
    width, first = len(rows) // runs.size, (8 * runs.runs.first_event).tolist()
    return np.array(
        [
            sha256(rows[i * width : (i + 1) * width] + events[first[i] : first[i + 1]]).hexdigest()[:DIGITS]
            for i in range(runs.size)
        ],
        f"U{DIGITS}",
    )


def _little_endian_bytes(ends: Values, counts: Values) -> bytes:
    """Return rows of floats and integers as bytes, little-endian."""
    # viewed, not converted: the bits of floats in one array with whole numbers
    return np.concatenate([ends.astype("<f8").view("<i8"), counts.astype("<i8")], axis=-1).tobytes()


def digest_of_end(run: xr.Dataset, names: Sequence[str]) -> str:
    """Return the digest that a run has in a sweep; `names` are those of coordinates, velocities and states."""
    end = np.concatenate([np.ravel(run.variables[name][-1].values) for name in ("time", *names)])
    counts = np.array([int(run.attrs[name]) for name in COUNT_FUNCTIONS])
    return sha256(
        _little_endian_bytes(end, counts) + np.asarray(run["event_time"]).astype("<f8").tobytes()
    ).hexdigest()[:DIGITS]


def _recheck_members(
    plan: Plan, block: Block, arrays: Mapping[str, Values], existing_members: NDArray[np.bool_]
) -> None:
    """Find the causes of bad ends, and march the members to be checked alone; known members are skipped."""
    grid = plan.grid
    places = grid.indices_in(block)
    refined_words = [OUTCOMES[status].word for status in REFINED]
    for i in np.flatnonzero(np.isin(arrays[OUTCOME], refined_words) & ~existing_members).tolist():
        march = march_of(grid, places[i])
        for _ in march.blocks() if march else ():
            pass
        arrays[OUTCOME][i] = ending(march).outcome.word if march else arrays[OUTCOME][i]
    numbers = np.asarray(np.ravel_multi_index(tuple(places.T), grid.shape))
    for i in np.flatnonzero(is_chosen(numbers, plan.check) & ~existing_members).tolist():
        _check_member(grid, places[i], {name: arrays[name][i] for name in (DIGEST, OUTCOME)})


def _read_whole_runs(
    plan: Plan, block: Block, arrays: Mapping[str, Values], existing_members: NDArray[np.bool_]
) -> None:
    """March members singly for variables that need their complete runs, which lanes do not record."""
    run_variables = {variable.of_run: variable for variable in plan.variables if variable.of_run}
    for i, axis_indices in enumerate(plan.grid.indices_in(block)) if run_variables else ():
        if existing_members[i]:
            continue
        try:
            run = march_model(plan.grid.member_model(axis_indices), **plan.grid.simulate_arguments(axis_indices))
        except ModelError:  # see its outcome
            continue
        for name, values in run_values(run, [*run_variables]).items():
            variable = run_variables[name]
            if variable.dims[:1] == (schema.OCCURRENCE,):
                occurrences = values[variable.first :][: variable.sizes[0]]
                arrays[name][i, : len(occurrences)] = occurrences
            elif values.ndim == len(variable.dims):
                arrays[name][i] = values
            elif len(values):  # the first of a list
                arrays[name][i] = values[0]


def march_of(grid: SweepGrid, axis_indices: AxisIndices) -> March | None:
    """Return the march of a single member, as its run is recorded; None if its model is refused (see its outcome)."""
    try:
        return March(grid.member_model(axis_indices), grid.recorded_settings_of(axis_indices))
    except ModelError:
        return None


def is_chosen(numbers: Values, part: float) -> Values:
    """Choose a fraction of the members by their numbers, evenly spread and independent of the blocks."""
    # one is added because 0 times anything is 0, and the first member would always be chosen
    spread = (numbers.astype(np.uint64) + np.uint64(1)) * np.uint64(_GOLDEN)  # wraps around on purpose
    return spread.astype(float) / 2.0**64 < part


def _check_member(grid: SweepGrid, axis_indices: Values, sweep_values: Mapping[str, Any]) -> None:
    """Compare a member with its run marched alone."""
    march = march_of(grid.unrecorded, axis_indices)
    if march is None:
        return
    run = record.dataset(march)
    single_values = {
        DIGEST: digest_of_end(run, [block.name for block in march.layout.used.blocks]),
        OUTCOME: run.attrs[OUTCOME],
    }
    differences = [
        f"{name} is {sweep_values[name]} in the sweep and {single_values[name]} alone"
        for name in single_values
        if single_values[name] != sweep_values[name]
    ]
    if differences:
        raise InputError(
            f"member {grid.member_name(axis_indices)}: {'; '.join(differences)}: this is a fault of xdynamics; please report it"
        )


def _judgement_variable(name: str, description: str, role: str, take: Callable[[Any], Any], dtype: str) -> KeptVariable:
    """Return a variable without a unit that has one value for each member."""
    return KeptVariable(name, (), (), "1", description, role, take, dtype=dtype)


def _no_errors(runs: Any) -> NDArray[np.float64]:
    return np.zeros(runs.size)


_OF_UNCONTROLLED = (
    "of how many variables errors as large as their given absolute tolerance, one a step, come to 3 % of their"
    " largest value or more; steps that a stricter tolerance of another variable holds err by less, and what"
    " errors do to others is not in it: a member that is marched by itself is judged by both"
)
_OF_PASSED = "how often switches that are declared smooth were passed by a step, and not located"
_OF_STRAYED = (
    "how many events set the motion back when errors of steps had carried it through zero by more than time tolerances"
    " allow, from where it need not come back"
)
_FILES = [
    _judgement_variable(
        FILE, "archive of the run, named by a digest of all that it is marched from", "file", _empty_texts, "U72"
    ),
    _judgement_variable(
        SEAL, "sha256 of the archive's bytes, that it ends with", schema.CIRCUMSTANCE, _empty_texts, "U64"
    ),
]


MemberValues = dict[str, NDArray[Any]]

RUNS = "runs"  # folder in that of a sweep


def archive_members(
    plan: Plan, block: Block, folder: Place, arrays: MemberValues, existing_members: NDArray[np.bool_]
) -> None:
    """Archive every unknown member of a block, and enter its file, content digest and seal into the arrays.

    A member whose file exists and is intact is not marched again; one whose model is refused gets no file. All files are
    opened again before they take their names, and the first that is written is read again in full: the others differ from
    it in numbers alone.

    Raises
    ------
    InputError
        If a run differs from the same member marched side by side with others.
    """
    grid = plan.grid
    shape, has_read = grid.block_shape(block), False
    for i, axis_indices in enumerate(grid.indices_in(block)):
        block_index = np.unravel_index(i, shape)
        march = None if existing_members[block_index] else march_of(grid, axis_indices)
        if march is None:
            continue
        file = folder / f"{record.input_digest(march)}.nc"
        digest, seal = intact_digests(file, partial(record.comes_of, march=march))
        if digest:
            clear_segments(file)  # left by a process that was stopped after finishing the file
        else:
            digest, seal = _stream_member(march, file, read_back=not has_read)
            has_read = True
            if differences := _differences_text(march, {name: values[block_index] for name, values in arrays.items()}):
                raise InputError(
                    f"member {grid.member_name(axis_indices)}: {differences}: this is a fault of xdynamics; please report it"
                )
        arrays[FILE][block_index], arrays[DIGEST][block_index], arrays[SEAL][block_index] = (
            f"{folder.name}/{file.name}",
            digest,
            seal,
        )


def _stream_member(march: March, file: Place, *, read_back: bool) -> tuple[str, str]:
    """March a member into its file; where another worker did so meanwhile, take that."""
    try:
        file_digests = stream_to_writer(march, file, resume=has_segments(file), read_back=read_back)
    except TakenError:
        digest, seal = intact_digests(file, partial(record.comes_of, march=march))
        if not digest:
            raise
        return digest, seal
    return file_digests.digest, file_digests.seal


def _differences_text(march: March, abreast: dict[str, Any]) -> str:
    """Describe how a run marched alone differs from its lane in a march side by side; empty if it does not."""
    march_state, state = (
        march.now,
        march.run.y[: march.layout.used.size] * record.factors(march.layout, march.settings.scales),
    )
    single_values: dict[str, Any] = dict(
        zip(COUNT_FUNCTIONS, (march.accepted, march_state.trials, march_state.evaluations), strict=True)
    )
    used = march.layout.used
    for block in used.blocks:
        state_index = used.offset_of(block.name)
        single_values[f"end_{block.name}"] = state[state_index : state_index + block.size].reshape(block.shape)
    return ", ".join(
        f"{name} is {value}, side by side {abreast[name]}"
        for name, value in single_values.items()
        if name in abreast and not np.array_equal(abreast[name], value)
    )


def intact_digests(file: Place, is_expected: Callable[[xr.Dataset], bool]) -> tuple[str, str]:
    """Return content digest and seal of a file that is intact and the wanted one; empty texts otherwise."""
    store = store_of(file)
    with suppress(ArchiveError, InputError):
        if store.kind(file) is None:
            local_file = store.local_file(file)
            digest, seal = verify_digests(file).digest, tail_of(local_file.path).digest
            with open_run(file, check=False) as run:
                return (digest, seal) if seal and is_expected(run) else ("", "")
    return "", ""

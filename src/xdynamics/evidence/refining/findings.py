"""The Dataset of a refinement: computed from its levels, or described before anything is marched."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from hashlib import sha256
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.evidence.evidence_dataset import attrs_of, evidence_dataset
from xdynamics.evidence.refining.convergence import FEW_STEPS
from xdynamics.evidence.refining.readings import DEFECT, ComparisonPoints, Readings, RunSummary, summary_of_finest
from xdynamics.evidence.refining.study import Study
from xdynamics.evidence.refining.subjects import ROLE, StudyQuantities, TrackedValue, crossing_level, family
from xdynamics.evidence.stage_tasks import AT_ONCE, Task, setting_words
from xdynamics.evidence.stages import Stage
from xdynamics.faults import InputError
from xdynamics.schema import AT, AT_TIME, LEVEL

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

MODEL = "model_toml"
SPREAD, FINER = 1e-2, 1e-9  # parts of a rank: between studies that are as long, from a level to the next
DEFECT_SAID = (
    "largest difference of {} between one step and sixteen in its place, among steps spread over the run: the local"
    " error beside that which came together"
)


@dataclass(frozen=True)
class StudyResults:
    """The results of a study after its levels are marched.

    Attributes
    ----------
    times : ndarray, s
        Of the comparison.
    numbers : list of Watched
    digests, outcomes : ndarray of str
        Of the runs.
    counts : dict of str to ndarray
        How often each event was met in every run.
    crossed : dict of str to float
        The level that cycles of a coordinate were counted through.
    defects : dict of str to ndarray
        Largest local errors in every run.
    accepted : int
        Steps of the finest run.
    estimated : float
        What its steps estimate to be off together, as a part of the size of a number, where something else than the
        tolerance set them; else 0.
    left_out : str
        Which states after events are too many numbers to be compared.
    """

    times: Floats
    numbers: list[TrackedValue]
    digests: NDArray[np.str_]
    outcomes: NDArray[np.str_]
    counts: Mapping[str, NDArray[np.int64]]
    crossed: Mapping[str, float] = field(default_factory=dict)
    defects: Mapping[str, Floats] = field(default_factory=dict)
    accepted: int = FEW_STEPS
    estimated: float = 0.0
    left_out: str = ""

    @classmethod
    def of(cls, study: Study) -> StudyResults:
        """Compare the levels of a study."""
        outlines, stepped = study.outlines, study.subjects.stepped if study.subjects.defects else ()
        return cls(
            study.times,
            list(study.tracked_values()),
            np.array([outline.digest for outline in outlines]),
            np.array([outline.outcome for outline in outlines]),
            {name: np.array([len(level) for level in rows]) for name, rows in study.event_rows().items()},
            study.common.crossing_levels,
            {name: np.stack([level.defects[name] for level in study.readings]) for name in stepped},
            outlines[-1].accepted,
            _finest_estimate(study),
            study.left_out,
        )

    @classmethod
    def blank(cls, subjects: StudyQuantities) -> StudyResults:
        """Return findings of the right sizes, before anything is marched."""
        levels = len(subjects.levels.values)
        return cls(
            np.full(1, np.nan) if subjects.times is None else subjects.times,
            list(subjects.blank()),
            np.full(levels, ""),
            np.full(levels, ""),
            {name: np.zeros(levels, np.int64) for name in (subjects.detectors if subjects.occurrences else ())},
            dict.fromkeys(subjects.cyclic, np.nan),
            {name: np.full((levels, *subjects.shape(name)), np.nan) for name in subjects.stepped}
            if subjects.defects
            else {},
            left_out=subjects.left_out(subjects.states_after, subjects.occurrences) if subjects.occurrences else "",
        )


def _finest_estimate(study: Study) -> float:
    """Return the finest run's summed error estimate, where the tolerance did not set its steps; else 0."""
    restrained = study.levels.are_restrained([outline.accepted for outline in study.outlines])
    return study.outlines[-1].estimated if restrained else 0.0


def study_dataset(subjects: StudyQuantities, findings: StudyResults, attributes: Mapping[str, Any]) -> xr.Dataset:
    """Assemble the evidence.

    Raises
    ------
    InputError
        If an observable is named as what is said of another.
    """
    levels, unit = subjects.levels, subjects.levels.model.time_unit.text
    varied = levels.varied
    variables: dict[str, Any] = {
        varied.name: ((LEVEL,), levels.values, attrs_of(varied.units or unit, varied.long_name, ROLE)),
        "run_digest": ((LEVEL,), findings.digests, attrs_of("1", "content digest of the level's run", "digest")),
        "run_outcome": ((LEVEL,), findings.outcomes, attrs_of("1", "outcome of the level's run", "outcome")),
        AT_TIME: ((AT,), findings.times, attrs_of(unit, "time of comparison", "time")),
    }
    for number in findings.numbers:
        added = family(number, levels, findings.accepted, findings.estimated)
        if clashing := sorted(added.keys() & variables.keys()):
            raise InputError(
                f"'{clashing[0]}' is a name of the model, and of what is said of its numbers; leave it out of"
                " observables=[…]"
            )
        variables |= added
    variables |= _of_runs(subjects, findings)
    variables[MODEL] = ((), np.array(levels.model.to_toml()), attrs_of("1", "the whole model as TOML", "model"))
    method = subjects.march.settings.method.name
    return evidence_dataset(
        "refinement",
        f"refinement of {levels.model.name}, by {method}",
        findings.digests.tolist(),
        variables,
        {
            "solver_method": method,
            "varied": varied.name,
            "asked": json.dumps(levels.shared_settings, default=str, sort_keys=True),
            "formal_order": levels.formal,
            "model_digest": levels.model.digest,
            "norm": "absolute differences of neighbouring levels; scaled ones over the stated scale",
            **({"left_out": findings.left_out} if findings.left_out else {}),
            **attributes,
        },
        shapes=subjects.shapes,
    )


def _of_runs(subjects: StudyQuantities, findings: StudyResults) -> dict[str, Any]:
    """Return how often events were met, the levels that cycles begin at, and local errors, as variables."""
    variables: dict[str, Any] = {
        f"event_count_{name}": ((LEVEL,), counts, attrs_of("1", f"how often {name} was met", ROLE))
        for name, counts in findings.counts.items()
    }
    variables |= {
        crossing_level(name): (
            (),
            np.float64(level),
            attrs_of(subjects.recorded(name).units, f"level of {name} that begins a cycle", ROLE),
        )
        for name, level in findings.crossed.items()
    }
    return variables | {
        f"{DEFECT}{name}": (
            (LEVEL, *subjects.dims(name)),
            defects,
            attrs_of(subjects.recorded(name).units, DEFECT_SAID.format(name), ROLE),
        )
        for name, defects in findings.defects.items()
    }


def study_stage(subjects: StudyQuantities) -> Stage:
    """Return a refinement, to be computed at once or later.

    A level is marched by one task, and read by another, which is cheap, begins at once, and is done where the run is, as
    far as dask can; only what it finds goes on to the study. Where only all levels together tell at what they are to be
    read, there is a third, by which each is outlined before.
    """
    known_names = [subjects.levels.varied.name, MODEL, *([AT_TIME] if subjects.times is not None else [])]
    return Stage(_study_task(subjects), partial(_study_template, subjects), known_names)


def _study_template(subjects: StudyQuantities) -> xr.Dataset:
    """Return a refinement before anything is marched.

    Raises
    ------
    InputError
        If the model has events, and no number of occurrences is given.
    """
    if subjects.occurrences is None and subjects.detectors:
        raise InputError(
            f"how often {', '.join(subjects.detectors[:3])} will be met is not known in advance; give the number"
            " to compare, like occurrences=10 (nan where there are fewer), or 0 for none"
        )
    return study_dataset(subjects, StudyResults.blank(subjects), {})


def _study_task(subjects: StudyQuantities) -> Task:
    """Return the task of a refinement: each level is marched by a task of its own, and read by others."""
    levels = subjects.levels
    count, keyword = len(levels.values), levels.varied.keyword
    runs = _ranked([levels.task(k) for k in range(count)])
    inputs = (
        subjects.names,
        subjects.requested_times,
        subjects.occurrences,
        subjects.defects,
        keyword,
        setting_words(levels.shared_settings),
    )
    quantities_task = replace(
        Task.of("subjects", partial(_return_quantities, subjects), (), [run.name for run in runs], *inputs),
        lasting=False,
        steps=AT_ONCE,
    )
    if subjects.foreseen:
        return _study_at_once(quantities_task, runs)
    return _study_by_outlines(subjects, quantities_task, runs)


def _ranked(runs: Sequence[Task]) -> list[Task]:
    """Return the marches of a study in the order in which a cluster is to begin them: the finest first, then its others.

    Of several studies the longest comes first, and each is put together before the next one's coarse levels are begun:
    were all finest levels first, all studies would wait for their coarse ones, hold their runs, and end at once.
    """
    digest = sha256("".join(run.name for run in runs).encode()).digest()
    tie_breaker = int.from_bytes(digest[:4]) / 2**32  # of two studies that are as long, either may be first
    rank = max(run.steps for run in runs) * (1.0 + SPREAD * tie_breaker)
    return [replace(run, steps=rank * (1.0 + FINER * k)) for k, run in enumerate(runs)]


def _study_at_once(quantities_task: Task, runs: Sequence[Task]) -> Task:
    """Return the task of a study whose levels can be read as soon as they are marched."""
    last = len(runs) - 1
    accounts = [
        Task.of("account", partial(_account, k, finest=k == last), (run, quantities_task), k)
        for k, run in enumerate(runs)
    ]
    return Task.of("refinement", _study_of_accounts, (quantities_task, *accounts))


def _account(k: int, run: xr.Dataset, subjects: StudyQuantities, *, finest: bool) -> tuple[RunSummary, Readings | None]:
    """Outline the run of a level, and read it at the times of comparison, or at its end; not where it ended before."""
    outline = RunSummary.of(run)
    times = np.array([outline.end]) if subjects.times is None else subjects.times
    if (times < outline.begin).any() or (times > outline.end).any():
        return outline, None
    return outline, Readings.of(run, subjects, ComparisonPoints(times, {}, {}), k, finest=finest)


def _study_of_accounts(subjects: StudyQuantities, *accounts: tuple[RunSummary, Readings | None]) -> xr.Dataset:
    """Compare the levels, in a task; those that ended later than another are marched again, to be read where that ended."""
    outlines, last = [outline for outline, _ in accounts], len(accounts) - 1
    common = Study(subjects, outlines).common
    ended_later = [subjects.times is None and outline.end != common.times[0] for outline in outlines]
    readings = [
        Readings.of(subjects.levels.marched(k), subjects, common, k, finest=k == last)
        if reading is None or ended_later[k]
        else reading
        for k, (_, reading) in enumerate(accounts)
    ]
    return study_dataset(subjects, StudyResults.of(Study(subjects, outlines, readings)), {})


def _study_by_outlines(subjects: StudyQuantities, quantities_task: Task, runs: Sequence[Task]) -> Task:
    """Return the task of a study whose levels are read once all are outlined: at common events, by the finest's cycles."""
    last = len(runs) - 1
    # a task whose only input is a run goes where that is; so what it is asked is no task
    outlines = [Task.of("outline", RunSummary.of, (run,), []) for run in runs[:-1]]
    outlines.append(Task.of("outline", summary_of_finest(subjects), (runs[-1],), [*subjects.cyclic]))
    common = Task.of("common", _common_in_task, (quantities_task, *outlines))
    readings = [
        Task.of("readings", partial(_read_level, k, finest=k == last), (run, common), k) for k, run in enumerate(runs)
    ]
    return Task.of("refinement", _study, (quantities_task, *outlines, *readings))


def _return_quantities(subjects: StudyQuantities) -> StudyQuantities:
    return subjects


def _common_in_task(subjects: StudyQuantities, *outlines: RunSummary) -> tuple[StudyQuantities, ComparisonPoints]:
    return subjects, Study(subjects, outlines).common


def _read_level(
    k: int, run: xr.Dataset, quantities_and_points: tuple[StudyQuantities, ComparisonPoints], *, finest: bool
) -> Readings:
    return Readings.of(run, *quantities_and_points, k, finest=finest)


def _study(subjects: StudyQuantities, *accounts: Any) -> xr.Dataset:
    """Compare the levels, in a task: the outlines of all come first, then their readings."""
    count = len(accounts) // 2
    return study_dataset(subjects, StudyResults.of(Study(subjects, accounts[:count], accounts[count:])), {})

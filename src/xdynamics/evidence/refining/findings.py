"""What the levels of a refinement give, and its Dataset: computed, or described before anything is marched."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import archive
from xdynamics.evidence.evidence_dataset import about, exhibit
from xdynamics.evidence.refining.convergence import FEW_STEPS
from xdynamics.evidence.refining.defects import step_defects
from xdynamics.evidence.refining.family import ROLE, Watched, family
from xdynamics.evidence.refining.study import Study
from xdynamics.evidence.refining.subjects import Subjects, crossing_level
from xdynamics.evidence.stages import Stage, Task, inputs_of, lazy
from xdynamics.faults import InputError
from xdynamics.schema import AT, AT_TIME, LEVEL

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

MODEL = "model_toml"
DEFECT = (
    "largest difference of {} between one step and sixteen in its place, among steps spread over the run: the local"
    " error beside that which came together"
)


@dataclass(frozen=True)
class Findings:
    """What is known of a study once its levels are marched.

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
    """

    times: Floats
    numbers: list[Watched]
    digests: NDArray[np.str_]
    outcomes: NDArray[np.str_]
    counts: Mapping[str, NDArray[np.int64]]
    crossed: Mapping[str, float] = field(default_factory=dict)
    defects: Mapping[str, Floats] = field(default_factory=dict)
    accepted: int = FEW_STEPS

    @classmethod
    def of(cls, study: Study, *, defects: bool) -> Findings:
        """Compare the runs of a study."""
        runs = study.runs
        return cls(
            study.times,
            list(study.watched()),
            np.array([archive.digest_of_run(run) for run in runs]),
            np.array([str(run.attrs["run_outcome"]) for run in runs]),
            {name: np.array([len(level) for level in rows]) for name, rows in study.met().items()},
            {name: study.cycles(name)[-1].level for name in study.subjects.cyclic},
            _defects(study) if defects else {},
            int(runs[-1].attrs["run_accepted_steps"]),
        )

    @classmethod
    def blank(cls, subjects: Subjects, *, defects: bool) -> Findings:
        """Return findings of the right sizes, before anything is marched."""
        levels = len(subjects.levels.values)
        return cls(
            np.full(1, np.nan) if subjects.times is None else subjects.times,
            list(subjects.blank()),
            np.full(levels, ""),
            np.full(levels, ""),
            {name: np.zeros(levels, np.int64) for name in (subjects.detectors if subjects.occurrences else ())},
            dict.fromkeys(subjects.cyclic, np.nan),
            {name: np.full(levels, np.nan) for name in subjects.stepped} if defects else {},
        )


def study_dataset(subjects: Subjects, findings: Findings, attributes: Mapping[str, Any]) -> xr.Dataset:
    """Assemble the evidence.

    Raises
    ------
    InputError
        If an observable is named as what is said of another.
    """
    levels, unit = subjects.levels, subjects.levels.model.time_unit.text
    varied = levels.varied
    variables: dict[str, Any] = {
        varied.name: ((LEVEL,), levels.values, about(varied.units or unit, varied.long_name, ROLE)),
        "run_digest": ((LEVEL,), findings.digests, about("1", "content digest of the level's run", "digest")),
        "run_outcome": ((LEVEL,), findings.outcomes, about("1", "outcome of the level's run", "outcome")),
        AT_TIME: ((AT,), findings.times, about(unit, "time of comparison", "time")),
    }
    for number in findings.numbers:
        added = family(number, levels, findings.accepted)
        if clashing := sorted({*added} & {*variables}):
            raise InputError(
                f"'{clashing[0]}' is a name of the model, and of what is said of its numbers; leave it out of"
                " observables=[…]"
            )
        variables |= added
    variables |= _of_runs(subjects, findings)
    variables[MODEL] = ((), np.array(levels.model.to_toml()), about("1", "the whole model as TOML", "model"))
    method = subjects.march.settings.method.name
    return exhibit(
        "refinement",
        f"refinement of {levels.model.name}, by {method}",
        findings.digests.tolist(),
        variables,
        {
            "solver_method": method,
            "varied": varied.name,
            "asked": json.dumps(levels.asked, default=str, sort_keys=True),
            "formal_order": levels.formal,
            "model_digest": levels.model.digest,
            "norm": "absolute differences of neighbouring levels; scaled ones over the stated scale",
            **attributes,
        },
        shapes=levels.model.shapes,
    )


def _of_runs(subjects: Subjects, findings: Findings) -> dict[str, Any]:
    """Return how often events were met, the levels that cycles begin at, and local errors, as variables."""
    units = {name: variable.units for name, variable in subjects.variables.items()}
    variables: dict[str, Any] = {
        f"event_count_{name}": ((LEVEL,), counts, about("1", f"how often {name} was met", ROLE))
        for name, counts in findings.counts.items()
    }
    variables |= {
        crossing_level(name): ((), np.float64(level), about(units[name], f"level of {name} that begins a cycle", ROLE))
        for name, level in findings.crossed.items()
    }
    return variables | {
        f"step_defect_{name}": ((LEVEL,), defects, about(units[name], DEFECT.format(name), ROLE))
        for name, defects in findings.defects.items()
    }


def _defects(study: Study) -> dict[str, Floats]:
    """Return the largest local error of a step of every level."""
    defects = [step_defects(run, functions=study.levels.model.functions) for run in study.runs]
    return {
        name: np.array([float(np.max(np.abs(level[name]))) for level in defects]) for name in study.subjects.stepped
    }


def lazy_study(subjects: Subjects, *, defects: bool) -> xr.Dataset:
    """Return a refinement with dask arrays, one task for each level, of which nothing is marched.

    Raises
    ------
    InputError
        If the model has events, and no number of occurrences is given.
    """
    if subjects.occurrences is None and subjects.detectors:
        raise InputError(
            f"how often {', '.join(subjects.detectors[:3])} will be met is not known before marching; give the number"
            " to compare, like occurrences=10 (nan where there are fewer), or 0 for none"
        )
    levels = subjects.levels
    tasks = tuple(levels.task(k) for k in range(len(levels.values)))
    inputs = (
        subjects.names,
        subjects.at,
        subjects.occurrences,
        defects,
        levels.varied.keyword,
        inputs_of(levels.asked),
    )
    study = Study(levels, [], subjects.names, subjects.at, subjects.occurrences)
    call = partial(_of_levels, study, defects=defects)
    template = study_dataset(subjects, Findings.blank(subjects, defects=defects), {})
    known = [levels.varied.name, MODEL, *([AT_TIME] if subjects.times is not None else [])]
    return lazy(Stage(template, Task.of("refinement", call, tasks, *inputs), known))


def _of_levels(study: Study, *runs: xr.Dataset, defects: bool) -> xr.Dataset:
    """Compare the runs of all levels, in a task."""
    study = replace(study, runs=[*runs])
    return study_dataset(study.subjects, Findings.of(study, defects=defects), {})

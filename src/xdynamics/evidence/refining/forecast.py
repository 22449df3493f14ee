"""What the next level of a refinement would take, and what it would need to come to a wanted change."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.arrays import log, power
from xdynamics.evidence.refining.convergence import STEADY
from xdynamics.evidence.refining.levels import RTOLS, STEPS
from xdynamics.evidence.refining.study import Study
from xdynamics.record.size import ROOM, free_memory, said
from xdynamics.units import behind

Floats = NDArray[np.float64]

MOST_ROWS = 10_000_000  # of a level that is added, where nothing is asked for
COPIES = 2.0  # of a level in memory: its log, and its record
LEAST_ORDER = 0.1  # under which changes do not fall


@dataclass(frozen=True)
class Bounds:
    """What a level that is added may take.

    Attributes
    ----------
    rows : float
    memory : float, optional
        Bytes; by default what is free.
    """

    rows: float = MOST_ROWS
    memory: float | None = None

    def exceeded(self, study: Study, rows: float) -> str:
        """Say which bound a level of so many rows would exceed; nothing where it exceeds none."""
        size, keep = rows * _bytes_of_row(study), study.levels.keep
        if rows > self.rows:
            return f"more than most_rows = {self.rows:.9g}"
        if keep is not None:
            free = float(shutil.disk_usage(keep).free)
            return f"and the disk of '{keep}' has {said(free)} free" if size > free else ""
        room = ROOM * free_memory() / COPIES if self.memory is None else self.memory
        there = "can be had" if self.memory is None else "were allowed"
        return f"and {said(room)} of memory {there}" if size > room else ""


def obstacle(study: Study, wanted: Mapping[str, float], bounds: Bounds) -> str:
    """Say why no further level is to be marched: what the next one would take, or the one that is needed; else nothing."""
    rows = float(study.runs[-1].sizes["step"])
    growth = _growth(study)
    if why := bounds.exceeded(study, rows * growth):
        return f"the next one would have {_extent(study, rows * growth)}, {why}; {_needed(study, wanted, bounds)[0]}"
    said_of_all, beyond = _needed(study, wanted, bounds)
    return said_of_all if beyond else ""


def _needed(study: Study, wanted: Mapping[str, float], bounds: Bounds) -> tuple[str, bool]:
    """Say which level each number would need, and whether that is known, and beyond a bound."""
    levels, rows, growth = study.levels, float(study.runs[-1].sizes["step"]), _growth(study)
    words, beyond = [], False
    for one in study.numbers() if len(study.runs) > 1 else ():
        if one.name not in wanted:
            continue
        tolerance, changes = wanted[one.name], np.nanmax(np.abs(one.changes), axis=0, initial=0.0)
        last, before = float(changes[-2]), float(changes[-3]) if len(changes) > 2 else np.nan
        if last <= tolerance:
            continue
        if tolerance < float(one.rounding.min()):
            words.append(f"rounding alone moves {one.name} by {float(one.rounding.min()):.1g} {one.units}: no {levels.varied.name} would do")  # fmt: skip
            beyond = beyond or last <= float(one.rounding.max())
            continue
        ratio = _ratio(study)
        order = float(log(before / last) / log(ratio)) if before > 0.0 else levels.formal
        if not order > LEAST_ORDER:
            words.append(f"changes of {one.name} do not fall")
            continue
        count = float(np.ceil(float(log(last / tolerance)) / (order * float(log(ratio)))))
        value, needed = float(levels.values[-1]) / float(power(ratio, count)), rows * float(power(growth, count))
        unit = behind(levels.varied.units or levels.model.time_unit.text)
        words.append(
            f"{one.name} would need a {levels.varied.name} of about {value:.2g}{unit}: {_extent(study, needed)}"
        )
        known, why = len(changes) > 2 and abs(order - levels.formal) <= STEADY, bounds.exceeded(study, needed)
        words[-1] += f", {why}" if why else ""
        beyond = beyond or (known and bool(why))
    return "; ".join(words), beyond


def _ratio(study: Study) -> float:
    """Return how much finer the next level is."""
    values = study.levels.values
    return float(values[-2] / values[-1]) if len(values) > 1 else study.levels.varied.ratio


def _growth(study: Study) -> float:
    """Return how many times the rows of the last level the next one has."""
    if study.levels.varied is STEPS:
        return _ratio(study)
    if study.levels.varied is RTOLS and len(study.runs) > 1:
        return max(1.0, float(study.runs[-1].sizes["step"]) / float(study.runs[-2].sizes["step"]))
    return 1.0


def _bytes_of_row(study: Study) -> float:
    """Return how many bytes a row of a level's record has."""
    run = study.runs[-1]
    return float(sum(one.dtype.itemsize for one in run.variables.values() if one.dims[:1] == ("step",)))


def _extent(study: Study, rows: float) -> str:
    """Write rows, and how large they are."""
    return f"{rows:.2g} rows ({said(rows * _bytes_of_row(study))})"

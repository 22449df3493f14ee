"""The size of the next level of a refinement, and of the level that would reach a wanted change."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.arrays import log, power
from xdynamics.evidence.refining.judgements import STEADY
from xdynamics.evidence.refining.levels import RTOLS, STEPS
from xdynamics.evidence.refining.study import Study, numbers_by_name
from xdynamics.runtime.free_memory import ROOM, free_memory, size_text
from xdynamics.units import unit_suffix

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

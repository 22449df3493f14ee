"""Records that are not a whole run: a selection of one, or data derived from one."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics.faults import InputError
from xdynamics.record.named_rows import rows_named
from xdynamics.schema import (
    CHOSEN,
    DERIVED,
    DERIVED_FROM,
    EVENTS,
    EVIDENCE,
    KEEP_EVERY,
    LEFT_OUT_ATOL,
    LOG,
    LOGGED,
    RUNS,
    SELECTION,
    SELECTION_OF,
    STEPS,
)
from xdynamics.shapes.naming import internal_text

if TYPE_CHECKING:
    import xarray as xr

COMPLETED = (
    "`xdynamics complete RUN.nc -o WHOLE.nc`, or xdynamics.complete(run) in Python, marches it again to its whole log"
)
RARE = f"one in {{0}} (keep_every = {{0}}): {COMPLETED}"


def is_derived(attributes: Mapping[Any, Any]) -> bool:
    """Whether a record is marked as made from a run by anything but a march."""
    return DERIVED in attributes


def is_selection(attributes: Mapping[Any, Any]) -> bool:
    """Whether a record is marked as an unchanged part of a run."""
    return SELECTION_OF in attributes and not is_derived(attributes)


def is_evidence(attributes: Mapping[Any, Any]) -> bool:
    """Whether a record is marked as evidence, made to judge runs."""
    return EVIDENCE in attributes and not is_derived(attributes)


def is_run(attributes: Mapping[Any, Any]) -> bool:
    """Whether a record is a run or a part of one, as it was marched."""
    return EVIDENCE not in attributes and not is_derived(attributes)


def is_whole(attributes: Mapping[Any, Any]) -> bool:
    """Whether a record should have all that a run has."""
    return is_run(attributes) and not is_selection(attributes)


def has_its_rows(run: xr.Dataset) -> bool:
    """Whether a run has the rows that its events name; `isel` and the like keep the attributes of the whole."""
    parts = {"time": STEPS, "event_time": EVENTS, "event_detector": EVENTS, "event_row_before": EVENTS}
    if "run_outcome" not in run.attrs or any(
        name not in run or run[name].dims != (dim,) for name, dim in parts.items()
    ):
        return False
    times, rows = run["time"].values, rows_named(run, "event_row_before")
    return bool((rows >= 0).all()) and times.size > 0 and np.array_equal(times[rows], run["event_time"].values)


def rows_apart(attributes: Mapping[Any, Any]) -> int:
    """Return how far apart the kept rows of a run's grid are: 1 where all are kept."""
    return int(attributes.get(KEEP_EVERY, 1))


def check_every_row(attributes: Mapping[Any, Any], subject: str) -> None:
    """Check that a record has every row, for evidence that needs them all.

    Raises
    ------
    InputError
        Naming what needs them, and the remedy.
    """
    if (every := rows_apart(attributes)) > 1:
        raise InputError(f"{subject} needs every row of the march, and this record has {RARE.format(every)}")


def log_description(attributes: Mapping[Any, Any]) -> str:
    """Describe which columns of its log a record has, and what adds the others; empty if it has all."""
    if LOG not in attributes:
        return ""
    which = (
        f"'{attributes[LOG]}'"
        if attributes[LOG] != CHOSEN
        else f"[{', '.join(map(repr, str(attributes.get(LOGGED, '')).split()))}]"
    )
    return f"it was marched with log = {which}: {COMPLETED}"


def check_every_column(attributes: Mapping[Any, Any], subject: str) -> None:
    """Check that a record has every column, for evidence that needs them all.

    Raises
    ------
    InputError
        Naming what needs them, and the remedy.
    """
    if missing_columns := log_description(attributes):
        raise InputError(f"{subject} needs all columns of a run's log, and this record has not: {missing_columns}")


def with_article(kind: str) -> str:
    """Return a kind of evidence as a sentence names it: a budget, an extension, events.

    Examples
    --------
    >>> with_article("diagnosis"), with_article("events"), with_article("envelope")
    ('a diagnosis', 'events', 'an envelope')
    """
    several = kind.endswith("s") and not kind.endswith(("ss", "is"))
    return kind if several else f"{'an' if kind[:1] in 'aeio' else 'a'} {kind}"


def kind_description(attributes: Mapping[Any, Any]) -> str:
    """Describe a record that is not a whole run; empty for one that is."""
    if is_derived(attributes):
        return f"derived data, no run: {attributes[DERIVED]}; from run {attributes.get(DERIVED_FROM, 'unknown')}"
    if is_evidence(attributes):
        runs = len(str(attributes.get(RUNS, "")).split())
        run_count = "1 run" if runs == 1 else f"{runs} runs"
        return f"evidence, no run: {f'{with_article(attributes[EVIDENCE])} from {run_count}' if runs else attributes[EVIDENCE]}"
    if is_selection(attributes):
        return f"a selection of run {attributes[SELECTION_OF]}: {attributes.get(SELECTION, 'a part')}"
    return ""


def left_out_atols(attributes: Mapping[Any, Any]) -> dict[str, tuple[float, str]]:
    """Return the absolute tolerances, in SI units, and the units of variables that a selection left out.

    Raises
    ------
    InputError
        If the attribute cannot be read.
    """
    text = str(attributes.get(LEFT_OUT_ATOL, "{}"))
    try:
        return {internal_text(str(name)): (float(size), str(units)) for name, (size, units) in json.loads(text).items()}
    except (ValueError, TypeError, AttributeError, RecursionError):
        raise InputError(f"attribute '{LEFT_OUT_ATOL}' is {text[:40]!r}, needs tolerances and units by name") from None


def ending_words(attributes: Mapping[Any, Any]) -> tuple[str, str]:
    """Return how a run ended, as one sentence, and the remarks that follow it; without a word of either an empty text.

    Examples
    --------
    >>> ending_words({"run_outcome": "completed", "run_outcome_text": "reached t = 2 s; stiff: radau_iia takes fewer steps"})
    ('completed: reached t = 2 s', 'stiff: radau_iia takes fewer steps')
    """
    sentence, _, remarks = str(attributes.get("run_outcome_text", "")).partition("; ")
    return ": ".join(filter(None, (str(attributes.get("run_outcome", "")), sentence))), remarks

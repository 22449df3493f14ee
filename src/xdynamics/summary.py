"""What a person wants to know first of a run, in lines of text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import Any

import numpy as np
import xarray as xr

from xdynamics.faults import escaped
from xdynamics.record.kinds import is_evidence, is_run, is_selection, is_whole, said_of
from xdynamics.record.words import words_of
from xdynamics.schema import CROSSING, EVENT_KINDS, EVENTS, EVIDENCE, SAMPLES, STEPS, SWEEP, TRIALS

MOST_EVENTS = 20
# kind of evidence -> the room that says what it tells
TOLD = {
    "companion": "evidence.companion", "comparison": "evidence.comparing.comparison",
    "diagnosis": "evidence.diagnosing.diagnosis", "ledger": "evidence.validating.ledger",
    "limiting case": "evidence.validating.limiting", "refinement": "evidence.refining.refinement",
    "budget": "budgeting.told", "certificate": "budgeting.certificate", "fit": "budgeting.fitted", "sweep": "sweeping.told",
    **dict.fromkeys(("contrast", "convergence", "influences", "precision", "sensitivities", "sobol indices"), "sweeping.surveyed"),
}  # fmt: skip
LONGEST = 400  # characters of a setting that are shown


def summary(run: xr.Dataset) -> list[str]:
    """Describe a run in lines: outcome, method, counts, end state, energy band, events.

    Of a selection the rows that events name are not there; what its run came to is said of the run.
    """
    used = run.attrs
    if is_evidence(used):
        return [escaped(line) for line in _evidence(run)]
    if not is_whole(used):
        return [escaped(line) for line in _partly(run)]
    lines = [
        used["title"],
        f"outcome   {used['run_outcome']}: {used['run_outcome_text']}",
        f"method    {used['solver_method']} (order {used['solver_order']}), {_steps(used)}",
        f"log       {_counts(run)}",
        f"end       {', '.join(_end(run))}",
    ]
    if "total_energy" in run:
        energy, units = run["total_energy"].values, run["total_energy"].attrs["units"]
        band, change = energy.max() - energy.min(), energy[-1] - energy[0]
        lines.append(
            f"energy    {energy[0]:.9g} {units} at the start, band {band:.3g} {units}, end minus start {change:.3g} {units}"
        )
    return [escaped(line) for line in (*lines, *_events(run))]


def _evidence(found: xr.Dataset) -> Iterator[str]:
    """Say what evidence tells."""
    kind = str(found.attrs[EVIDENCE])
    yield str(found.attrs.get("title", kind))
    if kind != SWEEP:
        yield f"kind      {said_of(found.attrs)}"
    if kind in TOLD:
        yield from import_module(f"xdynamics.{TOLD[kind]}").lines_of(found)


def _partly(run: xr.Dataset) -> Iterator[str]:
    used = run.attrs
    yield str(used.get("title", "a record without a title"))
    yield f"kind      {said_of(used)}"
    if is_selection(used):
        yield f"of run    {used['solver_method']}, {used['run_outcome']}: {used['run_outcome_text']}"
    yield f"log       {', '.join(f'{size} rows of {dim}' for dim, size in run.sizes.items()) or 'no rows'}"


def details(run: xr.Dataset) -> list[str]:
    """Describe a run whole: its summary, parameters with their descriptions, settings and digests, a line each."""
    lines = [*summary(run), *(["parameters"] if is_run(run.attrs) else [])]
    for name, one in run.data_vars.items():
        if one.attrs.get("role") == "parameter" and not one.dims:
            uncertainty = f" ± {one.attrs['uncertainty']:g}" if "uncertainty" in one.attrs else ""
            first, *more = str(one.attrs["long_name"]).split("\n")
            lines.append(f"  {name} = {float(one):.12g}{uncertainty} {one.attrs['units']}   {first}")
            lines += [f"    {line}" for line in more]
    lines.append("settings and evidence")
    keys = [
        key for key in run.attrs if key.startswith(("solver_", "precision", "math_", "model_d", "force_d", "content_d"))
    ]
    keys += [
        key for key in ("date_created", "xdynamics_version", "python_version", "numba_version") if key in run.attrs
    ]
    lines += [f"  {key} = {shortened(run.attrs[key])}" for key in keys]
    return [escaped(line) for line in lines]


def shortened(value: Any) -> str:
    """Cut the equations of methods with many stages; the archive has them whole."""
    text = str(value)
    return text if len(text) <= LONGEST else f"{text[:LONGEST]} … ({len(text)} characters)"


def _steps(used: Mapping[str, Any]) -> str:
    """Say how steps were chosen."""
    if used["solver_step_control"] == "fixed":
        return f"step {float(used['solver_step'])!r} s"
    if used["solver_step_control"] == "given":
        return "steps as given"
    return f"adaptive, rtol {float(used['solver_rtol']):g}, {used['run_force_evaluations']} force evaluations"


def _counts(run: xr.Dataset) -> str:
    words = {STEPS: "rows", TRIALS: "rejected trials", EVENTS: "events", SAMPLES: "force samples"}
    return ", ".join(f"{run.sizes.get(dim, 0)} {word}" for dim, word in words.items())


def _end(run: xr.Dataset) -> Iterator[str]:
    yield f"t = {float(run['time'][-1]):.12g} s"
    for name, one in run.data_vars.items():
        if one.dims == (STEPS,) and one.attrs.get("role") in ("coordinate", "velocity", "state"):
            yield f"{name} = {float(one[-1]):.9g} {one.attrs['units']}"


def _events(run: xr.Dataset) -> Iterator[str]:
    names, kinds = words_of(run["event_detector"]), words_of(run["event_kind"])
    rows = np.asarray(run["event_row_before"])
    coordinates = [
        str(name) for name, one in run.data_vars.items() if one.attrs.get("role") in ("coordinate", "velocity")
    ]
    for i, row in enumerate(rows[:MOST_EVENTS]):
        time, doubt = float(run["event_time"][i]), float(run["event_time_uncertainty"][i])
        state = ", ".join(f"{name} = {float(run[name][row]):.9g} {run[name].attrs['units']}" for name in coordinates)
        kind = "" if kinds[i] == EVENT_KINDS[CROSSING] else f" ({kinds[i]})"
        yield f"event     {names[i]}{kind} at t = {time:.15g} s, located within {doubt:.2g} s: {state}"
    if len(rows) > MOST_EVENTS:
        yield f"event     … and {len(rows) - MOST_EVENTS} more"

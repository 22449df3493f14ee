"""Cycles of a coordinate: periods, phases against a reference, amplitudes, enclosed areas, and turning points.

A turning point is a time within a step at which the velocity of the coordinate passes zero.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import archive, schema
from xdynamics.dynamics.recorded_steps import model_of_record
from xdynamics.dynamics.shortened_steps import StepInterpolator
from xdynamics.evidence.chunks import Chunks, Unread, with_roles
from xdynamics.evidence.companion import Companion, check_whole, reached_only
from xdynamics.evidence.diagnosing.conservation import ROLE
from xdynamics.evidence.diagnosing.cycles import TURN, Cycles, check_coordinate, cycles
from xdynamics.evidence.evidence_dataset import attrs_of
from xdynamics.evidence.stage_tasks import Task, march_task
from xdynamics.faults import InputError
from xdynamics.methods.scheme import REINTEGRATE
from xdynamics.model import Model
from xdynamics.model.assemblies import SECOND, assemblies
from xdynamics.record import check_kind
from xdynamics.record.flag_words import time_unit_of
from xdynamics.record.unfolding import find_column, get_column
from xdynamics.schema import CYCLE
from xdynamics.units import parse_quantity, parse_unit, time_in, unit_suffix

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

TURNS = "turn"  # dimension
HALVINGS = 60  # of a step
DEEPEST, MOST_PLACES = 6, 500  # of the halvings whose places are evaluated at once, and of these places


def turn_variables(rows: Chunks, name: str, functions: Mapping[str, Callable[..., float]] | None) -> dict[str, Any]:
    """Return times and places of a coordinate's turns as variables of a Dataset."""
    speed, turn_rows, signs = schema.velocity(name), [np.zeros(0, np.int64)], [np.zeros(0)]
    for part in rows.parts("time", speed):
        time, v, numbers = part.columns["time"], part.columns[speed], part.row_numbers
        passed = np.flatnonzero((numbers[:-1] >= part.first) & (v[:-1] * v[1:] < 0.0) & (np.diff(time) > 0.0))
        turn_rows.append(numbers[passed])
        signs.append(np.sign(v[passed]))
    rows_before, sign = np.concatenate(turn_rows), np.concatenate(signs)
    low, high = rows.values_at("time", np.stack([rows_before, rows_before + 1]))
    run, _ = rows.nearby_record(np.concatenate([rows_before, rows_before + 1]))
    points = np.zeros(0)
    if rows_before.size:
        interpolator = StepInterpolator.of_run(run, functions, REINTEGRATE)

        def not_yet(times: Floats) -> NDArray[np.bool_]:
            velocities: Floats = interpolator.values_of(interpolator.states_at(times.ravel(), after_event=False), speed)
            return sign * velocities.reshape(times.shape) > 0.0

        high = _bisect_turns(low, high, not_yet, 1 if rows.model.assemblies else DEEPEST)
        points = interpolator.values_of(interpolator.states_at(high, after_event=False), name)
    units = str(get_column(rows.run, name).attrs["units"])
    located = f"time at which {name} turns, located with steps of the run's own method"
    return {
        "turning_time": ((TURNS,), high, attrs_of(time_unit_of(rows.run).text, located, ROLE)),
        "turning_point": ((TURNS,), points, attrs_of(units, f"{name} at the turning point", ROLE)),
    }


def _bisect_turns(low: Floats, high: Floats, not_yet: Callable[[Floats], NDArray[np.bool_]], deepest: int) -> Floats:
    """Return the least known time behind each zero.

    The middles of several halvings are evaluated at once, whichever halves will be kept: asking takes longer than
    evaluating, but of many links. They are those of one halving after the other, to the bit.
    """
    columns, depth = np.arange(low.size), deepest
    while depth > 1 and (2**depth - 1) * low.size > MOST_PLACES:
        depth -= 1
    for _ in range(HALVINGS // depth):
        lows, highs, middles = low[None], high[None], []
        for _ in range(depth):
            middles.append((lows + highs) / 2.0)
            halves = (lows, middles[-1]), (middles[-1], highs)
            lows, highs = (np.stack(half, axis=1).reshape(-1, low.size) for half in halves)
        later, half_index = not_yet(np.concatenate(middles)), np.zeros(low.size, np.int64)
        for level in range(depth):
            # the middles of a level stand behind those of all levels above, one less than its own number
            half_index = 2 * half_index + later[2**level - 1 + half_index, columns]
        low, high = lows[half_index, columns], highs[half_index, columns]
    return high


Functions = Mapping[str, Callable[..., float]]

EXACT, MOST_STEPS = ("dop853", 1e-12), 1_000_000  # of the march that is the reference of phases
COLLIDING = (
    f"no run by {EXACT[0]} with rtol {EXACT[1]:g} was computed: of bodies that strike each other it takes many times as long,"
    " and soon parts from any other run"
)
PARTS = 64  # of a cycle, from which its area is computed


def count_coordinate_cycles(
    rows: Chunks, coordinate: str | None, level: Any, functions: Functions | None
) -> Cycles | None:
    """Count the cycles of one coordinate.

    Raises
    ------
    InputError
        If the level has another dimension than the coordinate.
    """
    run = rows.run
    names = with_roles(run, ("coordinate",))
    if coordinate is None and not names:
        return None
    name = coordinate or next(iter(rows.model.elements.statement.coordinates))
    if level is not None and (coordinate_variable := find_column(run, name)) is not None:
        unit = parse_unit(str(coordinate_variable.attrs["units"]))
        quantity = parse_quantity(level)
        if isinstance(level, str) and quantity.unit.dimension != unit.dimension:
            raise InputError(f"level is {level!r}, needs the unit '{unit.text}' of '{name}'")
        level = quantity.si / float(unit.factor) if isinstance(level, str) else quantity.value
    if isinstance(rows, Unread):
        check_coordinate(run, name)
        crossings = np.full(rows.listed_count + 1, np.nan)
        return Cycles(name, np.nan if level is None else level, crossings, crossings, "", 0)
    return cycles(rows, name, level=level, functions=functions)


def reference_times(
    rows: Chunks,
    coordinate_cycles: Cycles,
    reference: Any,
    tighter: Companion | None,
    exact: xr.Dataset | None,
    functions: Functions | None,
) -> tuple[Floats, str]:
    """Return the times of the reference's crossings, and describe the reference.

    Without one it is a run that is nearly exact; the companion, if that does not reach the end.

    Raises
    ------
    InputError
        If the reference is no positive period.
    """
    n, unit = len(coordinate_cycles.times), time_unit_of(rows.run)
    if isinstance(reference, str | float | int):
        period = time_in(unit, reference, "reference")
        if not period > 0.0:
            raise InputError(f"reference is {reference!r}, needs a positive period")
        return np.array(
            [coordinate_cycles.times[0] + period * k for k in range(n)]
        ), f"a period of {period!r}{unit_suffix(unit)}"
    if isinstance(rows, Unread):
        return coordinate_cycles.times, ""
    if reference is not None:
        check_kind(reference)
        check_whole(reference)
        crossings = cycles(reference, coordinate_cycles.name, level=coordinate_cycles.level, functions=functions).times
        return _padded_with_nan(crossings, n), f"the run {archive.digest_of_run(reference)}"
    if tighter is None:
        return np.full(n, np.nan), "none"
    end = float(tighter.run["time"][-1])
    if exact is None or float(exact["time"][-1]) < end - EXACT[1] * max(1.0, abs(end)):
        exact, source = tighter.run, f"the run with {tighter.tightening}"
        source += f" ({COLLIDING})" if _collide(rows.model) else ""
    else:
        source = f"{EXACT[0]} with rtol {EXACT[1]:g}"
    return _padded_with_nan(
        cycles(exact, coordinate_cycles.name, level=coordinate_cycles.level, functions=functions).times, n
    ), source


def exact_march(run: xr.Dataset, functions: Functions | None) -> Task | None:
    """Return the task that marches a run's model by a method of high order; None if that refuses it.

    The phase of a method may be of another order than its states, so it cannot be extrapolated. For bodies that strike each
    other there is none: every stage of every step would solve for all forces of contact, of a motion that is chaotic.
    """
    model = model_of_record(run, functions)
    if _collide(model):
        return None
    try:
        return march_task(
            model,
            method=EXACT[0],
            rtol=EXACT[1],
            atol=EXACT[1] if "atol" in model.run else None,
            max_steps=MOST_STEPS,
            **{"until": float(run.attrs["solver_until"]), **reached_only(run)},
            force_samples="none",
        )
    except InputError:
        return None


def _collide(model: Model) -> bool:
    """Whether a contact has links between moving bodies."""
    return any(
        leaf.end == SECOND for assembly in assemblies(model) for leaf in assembly.pattern_inputs[: assembly.coordinates]
    )


def _padded_with_nan(values: Floats, size: int) -> Floats:
    return np.concatenate([values[:size], np.full(max(0, size - len(values)), np.nan)])


def cycle_variables(
    rows: Chunks, coordinate_cycles: Cycles, reference: Floats, turning: Mapping[str, Any], functions: Functions | None
) -> dict[str, Any]:
    """Return the variables along `cycle`."""
    run, name, spans = rows.run, coordinate_cycles.name, coordinate_cycles.periods
    positions, speeds = _parts_of_cycles(rows, coordinate_cycles, functions)
    area = spans * np.mean(speeds**2, axis=0) if spans.size else np.zeros(0)
    amplitude = _amplitudes(positions, coordinate_cycles, turning) if spans.size else np.zeros(0)
    with np.errstate(invalid="ignore"):
        offsets = TURN * (reference[1:] - coordinate_cycles.times[1:]) / np.diff(reference)
    units, speed = (str(get_column(run, column_name).attrs["units"]) for column_name in (name, schema.velocity(name)))
    uncertainties, seconds, dims = coordinate_cycles.uncertainties, time_unit_of(run).text, (CYCLE,)
    return {
        "cycle_time": (
            dims,
            coordinate_cycles.times[1:],
            attrs_of(
                seconds, f"end of the cycle, where {name} rises through {level_text(coordinate_cycles, units)}", ROLE
            ),
        ),
        "period": (
            dims,
            coordinate_cycles.periods,
            attrs_of(seconds, "time from one located crossing of the level to the next", ROLE),
        ),
        "period_uncertainty": (
            dims,
            uncertainties[1:] + uncertainties[:-1],
            attrs_of(seconds, "uncertainty of the period from locating its two crossings", "error"),
        ),
        "phase_offset": (
            dims,
            offsets,
            attrs_of("rad", "phase at the end of the cycle minus that of the reference; negative: the run lags", ROLE),
        ),
        "amplitude": (dims, amplitude, attrs_of(units, f"half the peak-to-peak range of {name} over the cycle", ROLE)),
        "phase_space_area": (
            dims,
            area,
            attrs_of(
                parse_unit(f"{units} {speed}").text,
                f"area enclosed in the plane of {name} and its velocity: time integral of the velocity squared over the cycle",
                ROLE,
            ),
        ),
    }


def _amplitudes(positions: Floats, coordinate_cycles: Cycles, turning: Mapping[str, Any]) -> Floats:
    """Return half the range of each cycle, by positions within it and its turning points."""
    amplitude: Floats = np.ptp(positions, axis=0) / 2.0
    for k, (begin, end) in enumerate(
        pairwise(np.searchsorted(turning["turning_time"][1], coordinate_cycles.times).tolist())
    ):
        if end > begin:
            amplitude[k] = max(amplitude[k], float(np.ptp(turning["turning_point"][1][begin:end])) / 2.0)
    return amplitude


def _parts_of_cycles(rows: Chunks, coordinate_cycles: Cycles, functions: Functions | None) -> Floats:
    """Return positions and velocities at the beginnings of equal parts of every cycle."""
    # the mean over equal parts of a whole period is as accurate as its samples: the area is the integral of v**2
    parts = coordinate_cycles.times[:-1] + coordinate_cycles.periods * (np.arange(PARTS) / PARTS)[:, None]
    states_of_parts = np.zeros((2, *parts.shape))
    for stretch, stretch_rows in rows.stretches():
        time = np.asarray(stretch["time"])
        in_stretch = (parts >= time[stretch_rows[0]]) & (
            parts < time[stretch_rows[-1] + 1] if stretch_rows[-1] + 1 < time.size else True
        )
        if in_stretch.any():
            steps = StepInterpolator.of_run(stretch, functions, REINTEGRATE)
            states = steps.states_at(parts[in_stretch], after_event=True)
            names = coordinate_cycles.name, schema.velocity(coordinate_cycles.name)
            states_of_parts[:, in_stretch] = [steps.values_of(states, name) for name in names]
    return states_of_parts


def level_text(coordinate_cycles: Cycles, units: str) -> str:
    """Write the level that cycles rise through; it may be known only later."""
    return "its level" if np.isnan(coordinate_cycles.level) else f"{coordinate_cycles.level:.9g} {units}"


def limit_occurrences(variables: Mapping[str, Any], count: int | None) -> dict[str, Any]:
    """Return variables with as many cycles and turns as are to be listed: the first ones, or nan behind the last."""
    if count is None:
        return dict(variables)
    return {
        name: (dims, _padded_with_nan(values, count) if dims in ((CYCLE,), (TURNS,)) else values, attributes)
        for name, (dims, values, attributes) in variables.items()
    }

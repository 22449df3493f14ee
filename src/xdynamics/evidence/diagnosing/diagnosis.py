"""Diagnosis of a run: energy, momentum, cycles, extremes, and the time up to which it can be believed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import archive, schema
from xdynamics.dynamics.shortened_steps import model_of, sampled
from xdynamics.evidence.chunks import Chunks, with_roles
from xdynamics.evidence.companion import Companion, check_whole, companion_of, global_error
from xdynamics.evidence.diagnosing import chaos
from xdynamics.evidence.diagnosing.conservation import ROLE, bands, conserved, spans
from xdynamics.evidence.diagnosing.cycles import TURN, Cycles, cycles
from xdynamics.evidence.diagnosing.extremes import extremes_of, sought
from xdynamics.evidence.evidence_dataset import about, exhibit
from xdynamics.evidence.runs import march
from xdynamics.evidence.scaling import scale_of, scaled
from xdynamics.expressions import dimension_of, free_names, parse
from xdynamics.faults import InputError, Ledger
from xdynamics.methods.scheme import REINTEGRATE
from xdynamics.model.motion import constants, evaluated_many, tables_of
from xdynamics.record import check, check_kind
from xdynamics.record.flag_words import time_unit
from xdynamics.record.kinds import check_every_column, check_every_row
from xdynamics.schema import CYCLE, STEPS
from xdynamics.units import Unit, parse_quantity, parse_unit, time_in, unit_suffix
from xdynamics.units.digits import digits

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]
Functions = Mapping[str, Callable[..., float]]

BELIEVED = 0.1  # of the range of a quantity: the largest error with which it is still believed
EXACT, MOST_STEPS = ("dop853", 1e-12), 1_000_000  # of the march that is the reference of phases
PARTS = 64  # of a cycle, from which its area is computed
LOOKED_AT = 400  # times at which a run is compared with its companion
KEPT = ("solver_method", "solver_step", "solver_rtol", "model_digest")  # attributes of the run
UNTOLD, LONGEST = 6, 9  # digits in lines: of numbers without an uncertainty, and at most of those with one


def diagnose(
    run: xr.Dataset,
    *,
    of: str | None = None,
    level: str | float | None = None,
    reference: xr.Dataset | str | float | None = None,
    exact: Mapping[str, str] | None = None,
    companion: bool = True,
    lyapunov: bool | int = False,
    functions: Functions | None = None,
) -> xr.Dataset:
    """Diagnose a run from its record.

    Parameters
    ----------
    run : xarray.Dataset
        A run record. Of one in chunks each chunk is read once, in order; columns that are needed again are kept as long
        as they take no more MB than $XDYNAMICS_REMEMBERED_LIMIT (256), and else read again.
    of : str, optional
        The coordinate whose cycles are counted; by default the first one.
    level : str or float, optional
        A cycle begins when the coordinate rises through this level. Without it 0, the middle of the coordinate's range,
        or that of its smallest swing: the first that it rises through twice, and half as often as it has maxima.
        Attributes name it (`level`, `level_rule`), the number of `maxima`, and in `cycle_doubt` whether these are more
        than the rises.
    reference : xarray.Dataset, str or float, optional
        What phases are offset from: another run, or a period like ``"2 s"``; without it one more run of the
        model by `dop853` at a tolerance of 1e-12, or the companion if that does not reach the end.
    exact : mapping of str to str, optional
        Closed forms by coordinate, velocity or state, in the model's own language: ``{"x": "A*cos(w*t)"}``.
    companion : bool
        Whether to march these additional runs.
    lyapunov : bool or int
        Whether to compute all Lyapunov exponents, by the variational equations along the run (16 if there are more than
        64 variables); or how many of the largest. They need a run that is much longer than 1/exponent. Contacts that
        hold, dry friction and impacts of several contacts at once are refused.
    functions : mapping of str to callable, optional
        The Python functions that the model's forces call.

    Returns
    -------
    xarray.Dataset
        Without a dimension: `energy_band` (largest less least total energy), `energy_drift` (its mean over the last
        cycle less that over the first; without cycles, at the end less at the start), `band_y` and `drift_y` of every
        declared observable y and, as `momentum_x`, of every generalised momentum; for every coordinate, velocity,
        state, energy, observable, force and contact force `maximum_y`, `maximum_y_time`, `maximum_y_rule` (a flag:
        sampled, interpolated, located by an event), `maximum_y_uncertainty`, and the same for `minimum_y`; with closed
        forms `largest_residual_y` and `rms_residual_y`, and both scaled, `scaled_largest_residual_y` and
        `scaled_rms_residual_y`, by `residual_scale_y`, the largest expected size (one expected value may be 0);
        with a companion `believed_until`, the time up to which no coordinate, velocity or state is further from the
        solution than a tenth of its range; on request `lyapunov_exponent` (the largest), `lyapunov_time` (1 over it;
        inf if it is not above twice its uncertainty or has grown less than a thousandfold) and `finite_time_growth`, of
        the change of the start that grows most until the run's end, with `lyapunov_exponents`, `lyapunov_uncertainty`
        along `exponent`: of coordinates, velocities and states, not of time. Along `cycle`: `cycle_time`, `period`,
        `phase_offset` (negative if the run lags the reference), `amplitude`, `phase_space_area`. Along `turn`:
        `turning_time`, `turning_point`. Along `step`: `residual_y` and `scaled_residual_y`.

    Raises
    ------
    InputError
        If the Dataset is not a run record, or something that is requested is not in the run.

    Examples
    --------
    >>> import xdynamics as xd
    >>> model = xd.Model.from_toml("data/models/harmonic_oscillator.toml")
    >>> found = diagnose(xd.simulate(model, step="50 ms", until="20 s"))
    >>> found.period.values.round(3).tolist()
    [3.14, 3.14, 3.14, 3.14, 3.14]
    """
    check_kind(run)
    check(run, whole=False, values=False)
    check_every_row(run.attrs, "a diagnosis")
    check_every_column(run.attrs, "a diagnosis")
    title, digest = f"diagnosis of {run.attrs['title']}", archive.digest_of_run(run)
    model = model_of(run, functions)
    rows = Chunks(run, model)
    if lyapunov is not False and rows.is_stored:
        raise InputError("Lyapunov exponents need a run in memory, and this one is read in chunks; load() it first")
    attributes: dict[str, Any] = {name: run.attrs[name] for name in KEPT if name in run.attrs}
    if reference is not None:
        check_whole(run)  # cycles are counted from the start
    tighter = companion_of(run, functions) if companion else None
    variables = dict(bands(rows))
    counted = _cycles(rows, of, level, functions)
    variables |= dict(conserved(rows, counted, functions))
    if counted is not None:
        attributes |= {
            "coordinate": counted.name,
            "level": counted.level,
            "level_units": str(run[counted.name].attrs["units"]),
        }
        attributes |= {"level_rule": counted.rule, "maxima": counted.maxima}
        attributes |= {"cycle_doubt": counted.doubt} if counted.doubt else {}
        ideal, source = _reference(counted, reference, time_unit(run), tighter, functions)
        turns = _turns(rows, counted.name, functions)
        variables |= _along_cycles(rows, counted, ideal, turns, functions) | turns
        attributes["reference"] = source
    variables |= extremes_of(rows, sought(run), functions)
    variables |= dict(_residuals(rows, {} if exact is None else exact))
    if exact:
        variables["time"] = ((STEPS,), rows.at("time", np.arange(rows.size)), dict(run["time"].attrs))
    if tighter is not None:
        variables |= _believed(rows, tighter)
        attributes["companion"] = tighter.said
    digests = [digest, *([archive.digest_of_run(tighter.run)] if tighter is not None else [])]
    if lyapunov is not False:
        check_whole(run)
        variables |= chaos.lyapunov(run, functions, wanted=lyapunov)
    return exhibit("diagnosis", title, digests, variables, attributes)


def _cycles(rows: Chunks, of: str | None, level: Any, functions: Functions | None) -> Cycles | None:
    """Count the cycles of one coordinate."""
    run = rows.run
    names = with_roles(run, ("coordinate",))
    if of is None and not names:
        return None
    name = of or names[0]
    if level is not None and name in run.variables:
        unit = parse_unit(str(run[name].attrs["units"]))
        quantity = parse_quantity(level)
        if isinstance(level, str) and quantity.unit.dimension != unit.dimension:
            raise InputError(f"level is {level!r}, needs the unit '{unit.text}' of '{name}'")
        level = quantity.si / float(unit.factor) if isinstance(level, str) else quantity.value
    return cycles(rows, name, level=level, functions=functions)


def _reference(
    counted: Cycles, reference: Any, unit: Unit, tighter: Companion | None, functions: Functions | None
) -> tuple[Floats, str]:
    """Return the times of the reference's crossings, and describe the reference."""
    n = len(counted.times)
    if isinstance(reference, str | float | int):
        period = time_in(unit, reference, "reference")
        if not period > 0.0:
            raise InputError(f"reference is {reference!r}, needs a positive period")
        return np.array([counted.times[0] + period * k for k in range(n)]), f"a period of {period!r}{unit_suffix(unit)}"
    if reference is not None:
        check_kind(reference)
        check_whole(reference)
        crossings = cycles(reference, counted.name, level=counted.level, functions=functions).times
        return _filled(crossings, n), f"the run {archive.digest_of_run(reference)}"
    if tighter is None:
        return np.full(n, np.nan), "none"
    exact, source = _nearly_exact(tighter)
    return _filled(cycles(exact, counted.name, level=counted.level, functions=functions).times, n), source


def _nearly_exact(tighter: Companion) -> tuple[xr.Dataset, str]:
    """March the model once more by a method of high order; return the companion if that does not reach the end.

    The phase of a method may be of another order than its states, so it cannot be extrapolated.
    """
    end = float(tighter.run["time"][-1])
    try:
        model = model_of(tighter.of, tighter.functions)
        exact = march(
            model,
            method=EXACT[0],
            rtol=EXACT[1],
            atol=EXACT[1] if "atol" in model.run else None,
            max_steps=MOST_STEPS,
            until=float(tighter.of.attrs["solver_until"]),
            force_samples="none",
        )
    except InputError:
        return tighter.run, f"the run with {tighter.said}"
    if float(exact["time"][-1]) < end - EXACT[1] * max(1.0, abs(end)):
        return tighter.run, f"the run with {tighter.said}"
    return exact, f"{EXACT[0]} with rtol {EXACT[1]:g}"


def _filled(values: Floats, size: int) -> Floats:
    return np.concatenate([values[:size], np.full(max(0, size - len(values)), np.nan)])


def _along_cycles(
    rows: Chunks, counted: Cycles, reference: Floats, turns: Mapping[str, Any], functions: Functions | None
) -> dict[str, Any]:
    """Return the variables along `cycle`."""
    run, name, spans = rows.run, counted.name, counted.periods
    # the mean over equal parts of a whole period is as accurate as its samples: the area is the integral of v**2
    parts = counted.times[:-1] + spans * (np.arange(PARTS) / PARTS)[:, None]
    positions, speeds = np.zeros((2, *parts.shape))
    for stretch, here in rows.stretches():
        time = np.asarray(stretch["time"])
        inside = (parts >= time[here[0]]) & (parts < time[here[-1] + 1] if here[-1] + 1 < time.size else True)
        if not inside.any():
            continue
        states = sampled(stretch, parts[inside], after=True, rule=REINTEGRATE, functions=functions)
        positions[inside], speeds[inside] = (np.asarray(states[column]) for column in (name, schema.velocity(name)))
    area = spans * np.mean(speeds**2, axis=0) if spans.size else np.zeros(0)
    amplitude = np.ptp(positions, axis=0) / 2.0 if spans.size else np.zeros(0)
    for k, (begin, end) in enumerate(pairwise(np.searchsorted(turns["turning_time"][1], counted.times).tolist())):
        if end > begin:
            amplitude[k] = max(amplitude[k], float(np.ptp(turns["turning_point"][1][begin:end])) / 2.0)
    with np.errstate(invalid="ignore"):
        offsets = TURN * (reference[1:] - counted.times[1:]) / np.diff(reference)
    units, speed = (str(run[variable].attrs["units"]) for variable in (name, schema.velocity(name)))
    uncertainties, seconds = counted.uncertainties, time_unit(run).text
    dims = (CYCLE,)
    return {
        "cycle_time": (
            dims,
            counted.times[1:],
            about(seconds, f"end of the cycle: {name} rises through {counted.level:.9g} {units}", ROLE),
        ),
        "period": (dims, counted.periods, about(seconds, "from one located crossing to the next", ROLE)),
        "period_uncertainty": (
            dims,
            uncertainties[1:] + uncertainties[:-1],
            about(seconds, "what the location of both crossings is uncertain by", "error"),
        ),
        "phase_offset": (
            dims,
            offsets,
            about("rad", "phase at the end of the cycle less that of the reference; below 0 behind it", ROLE),
        ),
        "amplitude": (dims, amplitude, about(units, f"half of what {name} goes up and down, to located turns", ROLE)),
        "phase_space_area": (
            dims,
            area,
            about(
                str(parse_unit(f"{units} {speed}").text),
                f"area that {name} and its velocity go round: the velocity squared, over the cycle",
                ROLE,
            ),
        ),
    }


def _turns(rows: Chunks, name: str, functions: Functions | None) -> dict[str, Any]:
    """Locate where a coordinate turns: its velocity passes zero within a step."""
    speed, turned, signs = schema.velocity(name), [np.zeros(0, np.int64)], [np.zeros(0)]
    for part in rows.parts("time", speed):
        time, v, numbers = part.columns["time"], part.columns[speed], part.numbers
        passed = np.flatnonzero((numbers[:-1] >= part.first) & (v[:-1] * v[1:] < 0.0) & (np.diff(time) > 0.0))
        turned.append(numbers[passed])
        signs.append(np.sign(v[passed]))
    before, sign = np.concatenate(turned), np.concatenate(signs)
    low, high = rows.at("time", np.stack([before, before + 1]))
    run, _ = rows.near(np.concatenate([before, before + 1]))
    for _ in range(60 if before.size else 0):
        middle = (low + high) / 2.0
        states = sampled(run, middle, after=False, rule=REINTEGRATE, functions=functions)
        same = sign * np.asarray(states[speed]) > 0.0
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    points = (
        np.asarray(sampled(run, high, after=False, rule=REINTEGRATE, functions=functions)[name])
        if before.size
        else np.zeros(0)
    )
    units = str(run[name].attrs["units"])
    return {
        "turning_time": (
            ("turn",),
            high,
            about(time_unit(run).text, f"when {name} turns, located by steps of the run's own method", ROLE),
        ),
        "turning_point": (("turn",), points, about(units, f"{name} where it turns", ROLE)),
    }


def _residuals(rows: Chunks, exact: Mapping[str, str]) -> Iterator[tuple[str, Any]]:
    """Yield the residuals of a run against closed forms at its accepted states."""
    if not isinstance(exact, Mapping):
        raise InputError(f"exact is {str(exact)[:40]!r}, needs closed forms by name, like {{'x': 'A*cos(w*t)'}}")
    run, model = rows.run, rows.model
    for name, text in exact.items():
        if name not in model.units or name not in run.variables:
            raise InputError(f"exact names '{name}'; there are {', '.join(model.units)}")
        computed, expected = _beside_closed_form(rows, name, text)
        residual = computed - expected
        units = str(run[name].attrs["units"])
        yield f"residual_{name}", ((STEPS,), residual, about(units, f"{name} less {text}", "residual"))
        yield (
            f"largest_residual_{name}",
            ((), float(np.max(np.abs(residual))), about(units, f"largest size of residual_{name}", "residual")),
        )
        yield (
            f"rms_residual_{name}",
            (
                (),
                float(np.sqrt(np.mean(residual**2))),
                about(units, f"root of the mean square of residual_{name}", "residual"),
            ),
        )
        scale_text = f"largest size of {text} at the accepted times; where that is 0, of {name} as computed"
        scale = scale_of(expected, computed)
        yield from scaled("residual", name, residual, scale, (STEPS,), units, scale_text, ("largest", "rms")).items()


def _beside_closed_form(rows: Chunks, name: str, text: str) -> tuple[Floats, Floats]:
    """Return a variable, and an expression of time and parameters in its unit, at the accepted times.

    Raises
    ------
    InputError
        If the expression cannot be read, reads anything else, or has another dimension.
    """
    ledger, model = Ledger(f"exact '{name}'"), rows.model
    with ledger.entry(repr(text)[:60]):
        tree = model.expanded(parse(text))
        dimension = dimension_of(tree, model.dimensions)
        if read := sorted(free_names(tree) & {*model.units, *model.drives}):
            raise InputError(f"reads '{read[0]}', which is what is computed; a closed form is of t and parameters")
        if dimension != model.units[name].dimension:
            raise InputError(f"has units '{dimension}', needs '{model.units[name].text}'")
    ledger.raise_faults()
    computed, expected = np.zeros((2, rows.size))
    for part in rows.parts("time", *model.units):
        times, here = part.own("time"), slice(part.first, part.first + part.count)
        state = {variable: part.own(variable) * float(unit.factor) for variable, unit in model.units.items()}
        values = evaluated_many(model, [tree], state | {"t": times}, constants(model), tables_of(model))[0]
        computed[here], expected[here] = (
            part.own(name),
            np.broadcast_to(values, times.shape) / float(model.units[name].factor),
        )
    return computed, expected


def _believed(rows: Chunks, tighter: Companion) -> dict[str, Any]:
    """Return the time up to which every coordinate, velocity and state is known to a tenth of its range."""
    run = rows.run
    end = min(float(rows.at("time", rows.size - 1)), float(tighter.run["time"][-1]))
    looked_at = _evenly(lambda: _calm(rows, end))
    times = rows.at("time", looked_at)
    near, _ = rows.near(looked_at)
    states = tighter.beside(sampled(near, times, after=True, rule=REINTEGRATE, functions=tighter.functions))
    lost = np.zeros(times.size, bool)
    for name, (least, most) in spans(rows, with_roles(run, ("coordinate", "velocity", "state"))).items():
        span = most - least
        lost |= np.abs(np.asarray(states[global_error(name)])) > BELIEVED * span if span > 0.0 else False
    stays = lost & np.append(lost[1:], lost[-1:])  # a single time may lie between two occurrences of the same impact
    until = float(times[int(np.argmax(stays))]) if stays.any() else end
    long_name = (
        "time up to which no coordinate, velocity or state is further from the solution than a tenth of its range"
    )
    return {"believed_until": ((), until, about(time_unit(run).text, long_name, ROLE))}


def _calm(rows: Chunks, end: float) -> Iterator[Rows]:
    """Yield the rows up to a time that are at no event: there two runs may be on different sides, however well they agree."""
    for part in rows.parts("time", "row_kind"):
        at_event = np.isin(part.own("row_kind"), (schema.EVENT_BEFORE, schema.EVENT_AFTER))
        yield part.first + np.flatnonzero(~at_event & (part.own("time") <= end))


def _evenly(parts: Callable[[], Iterable[Rows]]) -> Rows:
    """Choose some of all rows, evenly by their number."""
    count = sum(part.size for part in parts())
    places, passed, chosen = np.unique(np.linspace(0, count - 1, LOOKED_AT).astype(np.int64)), 0, []
    for part in parts():
        chosen.append(part[places[(places >= passed) & (places < passed + part.size)] - passed])
        passed += part.size
    return np.concatenate(chosen)


def cycles_said(found: xr.Dataset) -> str:
    """Describe which coordinate's cycles are counted, and through which level; older diagnoses name no rule."""
    attributes = found.attrs
    rule = f", {attributes['level_rule']}" if "level_rule" in attributes else ""
    return (
        f"{attributes['coordinate']}, each from one rise through"
        f" {float(attributes['level']):.6g}{unit_suffix(str(attributes['level_units']))}{rule}, to the next"
    )


def lines_of(found: xr.Dataset) -> Iterator[str]:
    """Describe a diagnosis, line by line."""
    for name, variable in found.data_vars.items():
        if not variable.dims and variable.attrs["role"] in (ROLE, "residual") and name not in chaos.IN_WORDS:
            rule, units = f"{name}_rule", "" if variable.attrs["units"] == "1" else f" {variable.attrs['units']}"
            shown = f", {str(found[rule].attrs['flag_meanings']).split()[int(found[rule])]}" if rule in found else ""
            over = schema.scaled(str(name))
            shown += (
                f", scaled {float(found[over]):.3g} by {_scale_in_words(found, str(name))}" if over in found else ""
            )
            yield f"{name} = {float(variable):.{_digits_of(found, str(name))}g}{units}{shown}"
    yield from chaos.exponents_in_words(found)
    if "cycle_doubt" in found.attrs:
        yield f"attention: {found.attrs['cycle_doubt']}"
    if CYCLE in found.dims and found.sizes[CYCLE]:
        yield f"cycles of {cycles_said(found)}: {found.sizes[CYCLE]}, phases beside {found.attrs['reference']}"
        for name in ("period", "phase_offset", "amplitude", "phase_space_area"):
            variable = found[name]
            first, last = (
                f"{float(variable[k]):.{_digits_of(found, name, k)}g}{unit_suffix(variable.attrs['units'])}"
                for k in (0, -1)
            )
            yield f"{name} = {first} in the first cycle, {last} in the last"


def _digits_of(diagnosis: xr.Dataset, name: str, cycle: int | None = None) -> int:
    """Return the number of digits of a diagnosed number: six, or as many as its uncertainty justifies."""
    key = f"{name}_uncertainty"
    if key not in diagnosis:
        return UNTOLD
    value, uncertainty = (
        float(variable if cycle is None else variable[cycle]) for variable in (diagnosis[name], diagnosis[key])
    )
    return min(digits(value, uncertainty=uncertainty), LONGEST)


def _scale_in_words(diagnosis: xr.Dataset, norm: str) -> str:
    """Write the scale of a residual's norm."""
    scale = diagnosis[schema.scale("residual", norm.partition("_residual_")[2])]
    return f"{float(scale):.6g}{'' if scale.attrs['units'] == '1' else ' ' + scale.attrs['units']}"


SUMMARIES = {"diagnosis": lines_of}

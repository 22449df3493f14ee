"""What a run tells of itself: energy, momentum, cycles, extremes, and until when it can be believed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import reduce
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import archive, schema
from xdynamics.digits import digits
from xdynamics.dynamics.inside import model_of, sampled
from xdynamics.evidence.companion import Companion, check_whole, companion_of, global_error
from xdynamics.evidence.diagnosing import chaos
from xdynamics.evidence.diagnosing.cycles import TURN, Cycles, cycles
from xdynamics.evidence.diagnosing.extremes import extremes_of, sought
from xdynamics.evidence.exhibit import about, exhibit
from xdynamics.evidence.marching import march
from xdynamics.evidence.observing import comparable, evaluated_on, tree_of
from xdynamics.evidence.scaling import scale_of, scaled
from xdynamics.expressions import Binary, Name, Node, dimension_of, free_names, parse
from xdynamics.faults import InputError, Ledger
from xdynamics.methods.scheme import REINTEGRATE
from xdynamics.model import Model
from xdynamics.model.motion import constants, evaluated_many, tables_of
from xdynamics.record import check, check_kind
from xdynamics.record.kinds import check_every_column, check_every_row
from xdynamics.record.words import time_unit
from xdynamics.schema import CYCLE, STEPS
from xdynamics.units import Unit, behind, parse_quantity, parse_unit, spell, time_in

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
Functions = Mapping[str, Callable[..., float]]

ROLE = "diagnostic"
BELIEVED = 0.1  # of the range of a quantity: what it may be off, and still be believed
EXACT, MOST_STEPS = ("dop853", 1e-12), 1_000_000  # of the march that phases are told by
PARTS = 64  # of a cycle, at which an area is looked at
MEANT = 512  # of a cycle, besides accepted states, by which a mean is taken
LOOKED_AT = 400  # times at which a run is held against its companion
KEPT = ("solver_method", "solver_step", "solver_rtol", "model_digest")  # attributes of the run
UNTOLD, LONGEST = 6, 9  # digits in lines of what nothing tells the uncertainty of, and of what something does
BANDED = ("energy", "observable")  # roles of what may be conserved


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
        A run record. Of dask arrays, bands and sampled extremes are lazy, and nothing else is there.
    of : str, optional
        The coordinate whose cycles are counted; the first one without it.
    level : str or float, optional
        Which level a cycle begins with the rise through. Without it 0, the middle of the coordinate's range, or that of its
        smallest swing: the first that it rises through twice, and half as often as it has maxima. Attributes say which
        (`level`, `level_rule`), how many `maxima` there are, and in `cycle_doubt` where these are more than the rises.
    reference : xarray.Dataset, str or float, optional
        What phases are offset from: another run, or a period like ``"2 s"``; without it one more run of the
        model by `dop853` at a tolerance of 1e-12, or where that does not come to the end the companion.
    exact : mapping of str to str, optional
        Closed forms by coordinate, velocity or state, in the model's own language: ``{"x": "A*cos(w*t)"}``.
    companion : bool
        Whether to march that one more run.
    lyapunov : bool or int
        Whether to find all Lyapunov exponents, by the variational equations along the run (of more than 64 variables 16);
        or how many of the largest.
        They need a run that is much longer than 1/exponent. Contacts that hold, dry friction and impacts of several
        contacts at once are refused.
    functions : mapping of str to callable, optional
        The Python functions that the model's forces call.

    Returns
    -------
    xarray.Dataset
        Without a dimension: `energy_band` (largest less least total energy), `energy_drift` (its mean over the last
        cycle less that over the first; without cycles, at the end less at the start), `band_y` and `drift_y` of every
        declared observable y and, as `momentum_x`, of every generalised momentum; for every coordinate, velocity,
        state, energy, observable, force and contact force `maximum_y`, `maximum_y_time`, `maximum_y_rule` (a flag: sampled, interpolated, located by an event),
        `maximum_y_uncertainty`, and so for `minimum_y`; with closed forms `largest_residual_y` and `rms_residual_y`,
        and both scaled, `scaled_largest_residual_y` and `scaled_rms_residual_y`, by `residual_scale_y`, the largest
        expected size (one expected value may be 0);
        with a companion `believed_until`, the time up to which no coordinate, velocity or state is further from the solution
        than a tenth of its range; on request `lyapunov_exponent` (the largest), `lyapunov_time` (1 over it; inf where it
        is not above twice its uncertainty or has grown less than a thousandfold) and `finite_time_growth`, of the start
        that grows most until the run's end, with `lyapunov_exponents` and `lyapunov_uncertainty` along `exponent`: of coordinates, velocities and states, not of
        time. Along `cycle`: `cycle_time`, `period`, `phase_offset` (behind the reference below 0),
        `amplitude`, `phase_space_area`. Along `turn`: `turning_time`, `turning_point`. Along `step`: `residual_y` and
        `scaled_residual_y`.

    Raises
    ------
    InputError
        If the Dataset is no run record, or something that is asked for is none of the run's.

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
    if any(run[name].chunks is not None for name in run.data_vars):
        if lyapunov is not False:
            raise InputError("Lyapunov exponents need a run in memory, and this one is read in chunks; load() it first")
        return exhibit("diagnosis", title, [digest], dict(_bands(run)), {})
    model = model_of(run, functions)
    told: dict[str, Any] = {name: run.attrs[name] for name in KEPT if name in run.attrs}
    if reference is not None:
        check_whole(run)  # cycles are counted from the start
    beside = companion_of(run, functions) if companion else None
    variables = dict(_bands(run))
    found = _cycles(run, of, level, functions)
    variables |= dict(_conserved(run, model, found, functions))
    if found is not None:
        told |= {"coordinate": found.name, "level": found.level, "level_units": str(run[found.name].attrs["units"])}
        told |= {"level_rule": found.rule, "maxima": found.maxima}
        told |= {"cycle_doubt": found.doubt} if found.doubt else {}
        ideal, said = _reference(found, reference, time_unit(run), beside, functions)
        turns = _turns(run, found.name, functions)
        variables |= _along_cycles(run, found, ideal, turns, functions) | turns
        told["reference"] = said
    variables |= extremes_of(run, sought(run), functions)
    variables |= dict(_residuals(run, model, {} if exact is None else exact))
    if exact:
        variables["time"] = ((STEPS,), np.asarray(run["time"]), dict(run["time"].attrs))
    if beside is not None:
        variables |= _believed(run, beside)
        told["companion"] = beside.said
    digests = [digest, *([archive.digest_of_run(beside.run)] if beside is not None else [])]
    if lyapunov is not False:
        check_whole(run)
        variables |= chaos.lyapunov(run, functions, wanted=lyapunov)
    return exhibit("diagnosis", title, digests, variables, told)


def _bands(run: xr.Dataset) -> Iterator[tuple[str, Any]]:
    """Yield how far what may be conserved goes up and down, lazily where it is lazy."""
    for name in _with_roles(run, BANDED):
        one, units = run[name].variable, str(run[name].attrs["units"])
        yield _band(name), ((), (one.max() - one.min()).data, about(units, f"largest less least {name} of the accepted states", ROLE))  # fmt: skip
    if any(run[name].chunks is not None for name in run.data_vars):
        for name in _with_roles(run, ("coordinate", "velocity", "state")):
            one, units = run[name].variable, str(run[name].attrs["units"])
            for word, value in (("maximum", one.max()), ("minimum", one.min())):
                yield (
                    f"{word}_{name}",
                    ((), value.data, about(units, f"{word} of {name} among the accepted states", ROLE)),
                )


def _band(name: str) -> str:
    return "energy_band" if name == "total_energy" else f"band_{name}"


def _conserved(run: xr.Dataset, model: Model, found: Cycles | None, functions: Functions | None) -> Iterator[tuple[str, Any]]:  # fmt: skip
    """Yield how far what may be conserved drifts, and momenta."""
    known = comparable(model)
    for name in _with_roles(run, BANDED):
        units, tree = parse_unit(str(run[name].attrs["units"])), tree_of(model, name) if name in known else None
        drift, said = _drift(run, model, np.asarray(run[name]) * float(units.factor), tree, found, functions)
        key = "energy_drift" if name == "total_energy" else f"drift_{name}"
        yield key, ((), drift / float(units.factor), about(units.text, f"{name}: {said}", ROLE))
    coordinates = list(model.coordinates)
    if not coordinates or model.python_functions:
        return
    rows, time = np.arange(run.sizes[STEPS]), np.asarray(run["time"])
    states = {name: np.asarray(run[name]) for name in model.units}
    entries = {place: model.expanded(entry) for place, entry in model.statement.mass_entries.items()}
    for i, name in enumerate(coordinates):
        terms: list[Node] = [Binary("*", mass, Name(schema.velocity(coordinates[j]))) for (k, j), mass in entries.items() if k == i]  # fmt: skip
        tree = reduce(lambda one, other: Binary("+", one, other), terms)
        (momentum,) = evaluated_on(run, model, [tree], states, time, rows)
        mass = dimension_of(model.expanded(model.statement.mass_entries[i, i]), model.dimensions)
        units = spell(mass * model.dimensions[schema.velocity(name)])
        drift, said = _drift(run, model, momentum, tree, found, functions)
        yield (
            f"band_momentum_{name}",
            ((), float(np.ptp(momentum)), about(units.text, f"largest less least momentum of {name}, (M v)", ROLE)),
        )
        yield f"drift_momentum_{name}", ((), drift, about(units.text, f"momentum of {name}: {said}", ROLE))


def _drift(run: xr.Dataset, model: Model, values: Floats, tree: Node | None, found: Cycles | None, functions: Functions | None) -> tuple[float, str]:  # fmt: skip
    """Return how far a quantity has gone since its beginning, what swings within a cycle apart: its end less its start."""
    if found is None or len(found.times) < 3:
        return float(values[-1] - values[0]), "at the end less at the start"
    ends = found.times.tolist()
    first, last = (_mean(run, model, values, tree, (a, b), functions) for a, b in (ends[:2], ends[-2:]))
    return last - first, "mean over the last cycle less that over the first"


def _mean(run: xr.Dataset, model: Model, values: Floats, tree: Node | None, span: tuple[float, float], functions: Functions | None) -> float:  # fmt: skip
    """Return the mean over time: of accepted states, and of what is evaluated on states between, joined by straight lines."""
    (begin, end), time = span, np.asarray(run["time"])
    inner = np.flatnonzero((time > begin) & (time < end))
    times = np.linspace(begin, end, MEANT + 1)
    if tree is None:
        between, rows = np.interp(times, time, values), np.searchsorted(time, times, side="right") - 1
    else:
        states = sampled(run, times, after=True, rule=REINTEGRATE, functions=functions)
        rows = np.asarray(states["row"])
        (between,) = evaluated_on(run, model, [tree], {name: np.asarray(states[name]) for name in model.units}, times, rows)  # fmt: skip
    order = np.lexsort((np.concatenate([rows + 0.5, inner]), np.concatenate([times, time[inner]])))
    t, y = (np.concatenate(pair)[order] for pair in ((times, time[inner]), (between, values[inner])))
    return float(np.trapezoid(y, t) / (end - begin))


def _cycles(run: xr.Dataset, of: str | None, level: Any, functions: Functions | None) -> Cycles | None:
    """Count the cycles of one coordinate."""
    names = _with_roles(run, ("coordinate",))
    if of is None and not names:
        return None
    name = of or names[0]
    if level is not None and name in run.variables:
        unit = parse_unit(str(run[name].attrs["units"]))
        given = parse_quantity(level)
        if isinstance(level, str) and given.unit.dimension != unit.dimension:
            raise InputError(f"level is {level!r}, needs the unit '{unit.text}' of '{name}'")
        level = given.si / float(unit.factor) if isinstance(level, str) else given.value
    return cycles(run, name, level=level, functions=functions)


def _reference(found: Cycles, reference: Any, unit: Unit, beside: Companion | None, functions: Functions | None) -> tuple[Floats, str]:  # fmt: skip
    """Return the times of the reference's crossings, and what it is."""
    n = len(found.times)
    if isinstance(reference, str | float | int):
        period = time_in(unit, reference, "reference")
        if not period > 0.0:
            raise InputError(f"reference is {reference!r}, needs a positive period")
        return np.array([found.times[0] + period * k for k in range(n)]), f"a period of {period!r}{behind(unit)}"
    if reference is not None:
        check_kind(reference)
        check_whole(reference)
        other = cycles(reference, found.name, level=found.level, functions=functions).times
        return _filled(other, n), f"the run {archive.digest_of_run(reference)}"
    if beside is None:
        return np.full(n, np.nan), "none"
    near, said = _nearly_exact(beside)
    return _filled(cycles(near, found.name, level=found.level, functions=functions).times, n), said


def _nearly_exact(beside: Companion) -> tuple[xr.Dataset, str]:
    """March the model once more by a method of high order, where that comes to the end; else the companion has to do.

    The phase of a method may be of another order than its states, so that it cannot be extrapolated.
    """
    end = float(beside.run["time"][-1])
    try:
        model = model_of(beside.of, beside.functions)
        near = march(model, method=EXACT[0], rtol=EXACT[1], atol=EXACT[1] if "atol" in model.run else None, max_steps=MOST_STEPS, until=float(beside.of.attrs["solver_until"]), force_samples="none")  # fmt: skip
    except InputError:
        return beside.run, f"the run with {beside.said}"
    if float(near["time"][-1]) < end - EXACT[1] * max(1.0, abs(end)):
        return beside.run, f"the run with {beside.said}"
    return near, f"{EXACT[0]} with rtol {EXACT[1]:g}"


def _filled(values: Floats, size: int) -> Floats:
    return np.concatenate([values[:size], np.full(max(0, size - len(values)), np.nan)])


def _along_cycles(
    run: xr.Dataset, found: Cycles, other: Floats, turns: Mapping[str, Any], functions: Functions | None
) -> dict[str, Any]:
    """Return what there is one of in each cycle."""
    name, spans = found.name, found.periods
    # of a whole period the mean of equal parts is as good as the samples are: the area is that of v over time
    parts = found.times[:-1] + spans * (np.arange(PARTS) / PARTS)[:, None]
    states = sampled(run, parts.ravel(), after=True, rule=REINTEGRATE, functions=functions)
    moved, speeds = (np.asarray(states[one]).reshape(parts.shape) for one in (name, schema.velocity(name)))
    area = spans * np.mean(speeds**2, axis=0) if spans.size else np.zeros(0)
    size = np.ptp(moved, axis=0) / 2.0 if spans.size else np.zeros(0)
    for k, (begin, end) in enumerate(pairwise(np.searchsorted(turns["turning_time"][1], found.times).tolist())):
        if end > begin:
            size[k] = max(size[k], float(np.ptp(turns["turning_point"][1][begin:end])) / 2.0)
    with np.errstate(invalid="ignore"):
        behind = TURN * (other[1:] - found.times[1:]) / np.diff(other)
    units, speed = (str(run[one].attrs["units"]) for one in (name, schema.velocity(name)))
    doubts, seconds = found.uncertainties, time_unit(run).text
    each = (CYCLE,)
    return {
        "cycle_time": (each, found.times[1:], about(seconds, f"end of the cycle: {name} rises through {found.level:.9g} {units}", ROLE)),
        "period": (each, found.periods, about(seconds, "from one located crossing to the next", ROLE)),
        "period_uncertainty": (each, doubts[1:] + doubts[:-1], about(seconds, "what the location of both crossings is uncertain by", "error")),
        "phase_offset": (each, behind, about("rad", "phase at the end of the cycle less that of the reference; below 0 behind it", ROLE)),
        "amplitude": (each, size, about(units, f"half of what {name} goes up and down, to located turns", ROLE)),
        "phase_space_area": (each, area, about(str(parse_unit(f"{units} {speed}").text), f"area that {name} and its velocity go round: the velocity squared, over the cycle", ROLE)),
    }  # fmt: skip


def _turns(run: xr.Dataset, name: str, functions: Functions | None) -> dict[str, Any]:
    """Locate where a coordinate turns: its velocity passes zero within a step."""
    time, v = np.asarray(run["time"]), np.asarray(run[schema.velocity(name)])
    rows = np.flatnonzero((v[:-1] * v[1:] < 0.0) & (np.diff(time) > 0.0))
    low, high, sign = time[rows], time[rows + 1], np.sign(v[rows])
    for _ in range(60 if rows.size else 0):
        middle = (low + high) / 2.0
        before = sign * np.asarray(sampled(run, middle, after=False, rule=REINTEGRATE, functions=functions)[schema.velocity(name)]) > 0.0  # fmt: skip
        low, high = np.where(before, middle, low), np.where(before, high, middle)
    points = np.asarray(sampled(run, high, after=False, rule=REINTEGRATE, functions=functions)[name]) if rows.size else np.zeros(0)  # fmt: skip
    units = str(run[name].attrs["units"])
    return {
        "turning_time": (("turn",), high, about(time_unit(run).text, f"when {name} turns, located by steps of the run's own method", ROLE)),
        "turning_point": (("turn",), points, about(units, f"{name} where it turns", ROLE)),
    }  # fmt: skip


def _residuals(run: xr.Dataset, model: Model, exact: Mapping[str, str]) -> Iterator[tuple[str, Any]]:
    """Yield how far a run is from closed forms at its accepted states."""
    if not isinstance(exact, Mapping):
        raise InputError(f"exact is {str(exact)[:40]!r}, needs closed forms by name, like {{'x': 'A*cos(w*t)'}}")
    for name, text in exact.items():
        if name not in model.units or name not in run.variables:
            raise InputError(f"exact names '{name}'; there are {', '.join(model.units)}")
        expected = closed_form(run, model, name, text)
        off = np.asarray(run[name]) - expected
        units = str(run[name].attrs["units"])
        yield f"residual_{name}", ((STEPS,), off, about(units, f"{name} less {text}", "residual"))
        yield (
            f"largest_residual_{name}",
            ((), float(np.max(np.abs(off))), about(units, f"largest size of residual_{name}", "residual")),
        )
        yield f"rms_residual_{name}", ((), float(np.sqrt(np.mean(off**2))), about(units, f"root of the mean square of residual_{name}", "residual"))  # fmt: skip
        said = f"largest size of {text} at the accepted times; where that is 0, of {name} as computed"
        scale = scale_of(expected, np.asarray(run[name]))
        yield from scaled("residual", name, off, scale, (STEPS,), units, said, ("largest", "rms")).items()


def closed_form(run: xr.Dataset, model: Model, name: str, text: str) -> Floats:
    """Evaluate an expression of time and parameters at the accepted times, in the unit of a variable."""
    ledger = Ledger(f"exact '{name}'")
    with ledger.entry(repr(text)[:60]):
        tree = model.expanded(parse(text))
        found = dimension_of(tree, model.dimensions)
        if read := sorted(free_names(tree) & {*model.units, *model.drives}):
            raise InputError(f"reads '{read[0]}', which is what is computed; a closed form is of t and parameters")
        if found != model.units[name].dimension:
            raise InputError(f"has units '{found}', needs '{model.units[name].text}'")
    ledger.settle()
    times = np.asarray(run["time"])
    state = {one: np.asarray(run[one]) * float(own.factor) for one, own in model.units.items()} | {"t": times}
    values = evaluated_many(model, [tree], state, constants(model), tables_of(model))[0]
    return np.broadcast_to(values, times.shape) / float(model.units[name].factor)


def _believed(run: xr.Dataset, beside: Companion) -> dict[str, Any]:
    """Return the time up to which every coordinate and velocity is known to a tenth of its range."""
    time = np.asarray(run["time"])
    end = min(float(time[-1]), float(beside.run["time"][-1]))
    # beside an event the two runs are on both sides of it, however well they agree
    calm = np.flatnonzero(
        ~np.isin(np.asarray(run["row_kind"]), (schema.EVENT_BEFORE, schema.EVENT_AFTER)) & (time <= end)
    )
    rows = calm[np.unique(np.linspace(0, len(calm) - 1, LOOKED_AT).astype(np.int64))]
    states = beside.beside(sampled(run, time[rows], after=True, rule=REINTEGRATE, functions=beside.functions))
    names = _with_roles(run, ("coordinate", "velocity", "state"))
    lost = np.zeros(rows.size, bool)
    for name in names:
        span = float(np.ptp(np.asarray(run[name])))
        lost |= np.abs(np.asarray(states[global_error(name)])) > BELIEVED * span if span > 0.0 else False
    stays = lost & np.append(lost[1:], lost[-1:])  # once may be between two impacts that are one
    until = float(time[rows[int(np.argmax(stays))]]) if stays.any() else end
    said = "time up to which no coordinate, velocity or state is further from the solution than a tenth of its range"
    return {"believed_until": ((), until, about(time_unit(run).text, said, ROLE))}


def _with_roles(run: xr.Dataset, roles: tuple[str, ...]) -> list[str]:
    return [str(name) for name, one in run.data_vars.items() if one.attrs.get("role") in roles and one.dims == (STEPS,)]


def cycles_said(found: xr.Dataset) -> str:
    """Say of which coordinate cycles are, and through which level; what an older diagnosis did not say is left out."""
    used = found.attrs
    rule = f", {used['level_rule']}" if "level_rule" in used else ""
    return f"{used['coordinate']}, each from one rise through {float(used['level']):.6g}{behind(str(used['level_units']))}{rule}, to the next"


def lines_of(found: xr.Dataset) -> Iterator[str]:
    """Say what a diagnosis found, in lines."""
    for name, one in found.data_vars.items():
        if not one.dims and one.attrs["role"] in (ROLE, "residual") and name not in chaos.IN_WORDS:
            rule, units = f"{name}_rule", "" if one.attrs["units"] == "1" else f" {one.attrs['units']}"
            shown = f", {str(found[rule].attrs['flag_meanings']).split()[int(found[rule])]}" if rule in found else ""
            over = schema.scaled(str(name))
            shown += (
                f", scaled {float(found[over]):.3g} by {_scale_in_words(found, str(name))}" if over in found else ""
            )
            yield f"{name} = {float(one):.{_digits_of(found, str(name))}g}{units}{shown}"
    yield from chaos.exponents_in_words(found)
    if "cycle_doubt" in found.attrs:
        yield f"attention: {found.attrs['cycle_doubt']}"
    if CYCLE in found.dims and found.sizes[CYCLE]:
        yield f"cycles of {cycles_said(found)}: {found.sizes[CYCLE]}, phases beside {found.attrs['reference']}"
        for name in ("period", "phase_offset", "amplitude", "phase_space_area"):
            one = found[name]
            first, last = (
                f"{float(one[k]):.{_digits_of(found, name, k)}g}{behind(one.attrs['units'])}" for k in (0, -1)
            )
            yield f"{name} = {first} in the first cycle, {last} in the last"


def _digits_of(found: xr.Dataset, name: str, cycle: int | None = None) -> int:
    """Return how many digits a number of a diagnosis is written with: six, or as its own uncertainty says."""
    of = f"{name}_uncertainty"
    if of not in found:
        return UNTOLD
    value, doubt = (float(one if cycle is None else one[cycle]) for one in (found[name], found[of]))
    return min(digits(value, uncertainty=doubt), LONGEST)


def _scale_in_words(found: xr.Dataset, norm: str) -> str:
    """Say what the norm of a residual is scaled by."""
    scale = found[schema.scale("residual", norm.partition("_residual_")[2])]
    return f"{float(scale):.6g}{'' if scale.attrs['units'] == '1' else ' ' + scale.attrs['units']}"

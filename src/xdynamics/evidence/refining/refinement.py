"""One model over steps, tolerances or rules: what its numbers come to, at which order, and how sure they are."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import archive
from xdynamics.digits import digits
from xdynamics.evidence.evidence_dataset import about, exhibit
from xdynamics.evidence.observables import observables_of
from xdynamics.evidence.refining.defects import step_defects
from xdynamics.evidence.refining.family import ROLE, family
from xdynamics.evidence.refining.forecast import MOST_ROWS, Bounds, obstacle
from xdynamics.evidence.refining.levels import FEWEST, Levels
from xdynamics.evidence.refining.study import ENERGY_RANGE, PERIOD, PHASE, Study
from xdynamics.faults import InputError
from xdynamics.files import made_folder
from xdynamics.kernels.layout import layout_of
from xdynamics.model import Model
from xdynamics.record.flag_words import time_unit, words_of
from xdynamics.record.size import memory_asked
from xdynamics.schema import AT, AT_TIME, LEVEL, OCCURRENCE
from xdynamics.units import Quantity, behind, parse_quantity, parse_unit

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

MOST_SHOWN = 3  # occurrences of one event, in words


def refine(
    model: Model,
    *,
    method: str | None = None,
    steps: Sequence[str | float] | None = None,
    rtols: Sequence[float] | None = None,
    time_tolerances: Sequence[str | float] | None = None,
    rules: Sequence[str] | None = None,
    at: Sequence[str | float] | str | float | None = None,
    observables: Sequence[str] | None = None,
    until_change: Mapping[str, str | float] | None = None,
    defects: bool = False,
    keep: str | Path | None = None,
    most_rows: float | None = None,
    memory: str | float | None = None,
    **asked: Any,
) -> xr.Dataset:
    """March a model with one step, tolerance or rule after the other, and compare at common physical times.

    Parameters
    ----------
    model : Model
    method : str, optional
        As for `simulate`, like everything in `asked`; the same for all levels.
    steps, rtols, time_tolerances, rules : sequence
        What is varied, one of them, from coarse to fine, at least two levels: steps like ``["10 ms", "5 ms"]``; relative
        tolerances, with an `atol` that goes with each in proportion (what is given is that of the first; where none is, it follows the sizes of the variables); how well every
        event, contact and switch is located; ``["interpolant", "reintegrate"]``, by which states between accepted ones
        and events are found.
    at : times, optional
        Where to compare; by default the earliest end of a level's run. Where a time is an accepted one in every level,
        nothing is interpolated.
    observables : sequence of str, optional
        Coordinates, velocities, states, energies, declared observables; by default all coordinates, velocities, states.
        Also `energy_range`, and for a coordinate x `period_x`, the mean period between located crossings, and `phase_x`.
    until_change : mapping of str to quantity, optional
        Go on with finer levels, 24 at most, until no number of these changes by more than its tolerance from one level
        to the next: ``{"y": "10 m", "event_time_apex": "1 ms"}``. One level to begin with is enough then. Where the next
        level would not fit the bounds below, or by the observed order the needed one would not, none is added, and
        `stopped` says what would be needed.
    defects : bool
        Whether to add the largest local error of a step beside the error that came together.
    keep : str or Path, optional
        A folder that the run of each level is streamed to, as `level_0.nc` and so on, in bounded memory.
    most_rows : float, optional
        Rows that a level may have at most that is added; ten millions where nothing is asked for.
    memory : str or float, optional
        The most that a level may take in memory: ``"2 GB"``, or bytes; by default what is free.
    **asked
        Further settings, as for `simulate`.

    Returns
    -------
    xarray.Dataset
        Over `level`, from coarse to fine: `step_size`, `rtol`, `time_tolerance` or `rule`, `run_digest`, `run_outcome`.
        Over `level` and `at`, for each observable y: y, `difference_y` (to the next finer level), `scaled_difference_y`
        (the same over the largest value in the finest run), `order_y` (signed, of a level with its neighbours),
        `interpolation_error_y`, `gate_y` (whether that is smaller than the difference). Over `at`: `verdict_y`,
        `limit_y`, `uncertainty_y` (of the finest level's value, at about 95 %) and by which rule. The same over
        `occurrence` of `event_time_<name>`, of which the location is what interpolation is to states, and of the states
        after each event, `after_<name>_y`; `event_count_<name>` over `level`. Of rules, which are no numbers, there are
        differences alone. With `defects`, `step_defect_y` over `level`.

    Raises
    ------
    InputError
        If there are not two levels that get finer, a setting is wrong, or a time is not in every run.

    Notes
    -----
    The order is that of the method in its step, and 1 in a tolerance, to which errors at the end are proportional. What
    is said of each number, and by which rule it is uncertain: `xdynamics.evidence.refining.convergence`.

    Examples
    --------
    >>> import xdynamics as xd
    >>> model = xd.Model.from_toml("data/models/harmonic_oscillator.toml")
    >>> study = refine(model, method="rk4", steps=["40 ms", "20 ms", "10 ms", "5 ms"], at=["1 s"], observables=["x"])
    >>> study.order_x.values.round(1).ravel().tolist()
    [nan, 4.0, 4.0, nan]
    >>> study.verdict_x.attrs["flag_meanings"].split()[int(study.verdict_x[0])]
    'asymptotic'
    """
    if not isinstance(model, Model):
        raise InputError(f"model is {str(model)[:60]!r}, needs a Model; read a file with Model.from_toml")
    given = {"steps": steps, "rtols": rtols, "time_tolerances": time_tolerances, "rules": rules}
    shared = asked | ({"method": method} if method else {}) | ({"memory": memory} if memory is not None else {})
    bounds = _bounds(most_rows, memory)
    folder = None if keep is None else made_folder(keep)
    levels = Levels.of(model, given, shared, fewest=1 if until_change else FEWEST, keep=folder)
    names = tuple(model.units) if observables is None else _known(model, observables)
    study = Study(levels, [levels.marched(k) for k in range(len(levels.values))], names, at)
    wanted = _tolerances(until_change or {}, study)
    changing, limit = list(wanted), ""
    while wanted and (changing := _changing(study, wanted)) and not (limit := obstacle(study, wanted, bounds)):
        try:
            further = study.finer()
            further.check_reached(study.times)
        except (InputError, MemoryError, OSError) as error:  # what no march can use, or the machine has no room for
            limit = str(error) or "there is no memory for it"
            break
        study = further
    if len(study.runs) < FEWEST:
        raise InputError(f"a study needs {FEWEST} levels, and there is no second one: {limit}")
    told = {"stopped": _stopped(changing, len(study.runs), limit)} if wanted else {}
    return _dataset(study, told, defects=defects)


def _bounds(most_rows: float | None, memory: str | float | None) -> Bounds:
    """Read what a level may take."""
    if most_rows is not None and not (isinstance(most_rows, int | float) and most_rows >= FEWEST):
        raise InputError(f"most_rows is {most_rows!r}, needs a number of rows")
    return Bounds(MOST_ROWS if most_rows is None else float(most_rows), memory_asked(memory))


def _changing(study: Study, wanted: Mapping[str, float]) -> list[str]:
    """Name what changed by more than its tolerance from the last level but one to the last."""
    if len(study.runs) < FEWEST:
        return list(wanted)
    last = {one.name: np.abs(one.changes[:, -2]) for one in study.numbers() if one.name in wanted}
    return [name for name, tolerance in wanted.items() if not (last.get(name, np.array([np.nan])) <= tolerance).all()]


def _dataset(study: Study, told: Mapping[str, Any], *, defects: bool) -> xr.Dataset:
    """Gather everything."""
    levels, runs, varied = study.levels, study.runs, study.levels.varied
    digests = [archive.digest_of_run(run) for run in runs]
    outcomes = [str(run.attrs["run_outcome"]) for run in runs]
    variables: dict[str, Any] = {
        varied.name: ((LEVEL,), levels.values, about(varied.units or levels.model.time_unit.text, varied.said, ROLE)),
        "run_digest": ((LEVEL,), np.array(digests), about("1", "content digest of the level's run", "digest")),
        "run_outcome": ((LEVEL,), np.array(outcomes), about("1", "outcome of the level's run", "outcome")),
        AT_TIME: ((AT,), study.times, about(levels.model.time_unit.text, "time of comparison", "time")),
    }
    for one in study.watched():
        more = family(one, levels, int(runs[-1].attrs["run_accepted_steps"]))
        if taken := sorted({*more} & {*variables}):
            raise InputError(f"'{taken[0]}' is a name of the model, and of what is said of its numbers; leave it out of observables=[…]")  # fmt: skip
        variables |= more
    for name, rows in study.met().items():
        counts = np.array([len(one) for one in rows])
        variables[f"event_count_{name}"] = ((LEVEL,), counts, about("1", f"how often {name} was met", ROLE))
    if defects:
        variables |= _defects(study)
    variables["model_toml"] = ((), np.array(levels.model.to_toml()), about("1", "the whole model as TOML", "model"))
    method = str(runs[0].attrs["solver_method"])
    return exhibit("refinement", f"refinement of {levels.model.name}, by {method}", digests, variables, {
        "solver_method": method, "varied": varied.name, "asked": json.dumps(levels.asked, default=str, sort_keys=True), "formal_order": levels.formal, "model_digest": levels.model.digest,
        "norm": "absolute differences of neighbouring levels; scaled ones over the stated scale", **told,
    })  # fmt: skip


def _defects(study: Study) -> dict[str, Any]:
    """Return the largest local error of a step of every level."""
    found = [step_defects(run, functions=study.levels.model.functions) for run in study.runs]
    names = [name for name in found[-1] if name in study.names]
    return {
        f"step_defect_{name}": ((LEVEL,), np.array([float(np.max(np.abs(one[name]))) for one in found]), about(str(study.runs[-1][name].attrs["units"]), f"largest difference of {name} between one step and sixteen in its place, among steps spread over the run: the local error beside that which came together", ROLE))
        for name in names
    }  # fmt: skip


def _known(model: Model, names: Sequence[str]) -> tuple[str, ...]:
    """Refuse what cannot be looked at."""
    if isinstance(names, str):
        names = [names]
    more = [ENERGY_RANGE] if "total_energy" in layout_of(model).derived else []
    more += [kind + name for name in model.coordinates for kind in (PERIOD, PHASE)]
    known = (*observables_of(model), *more)
    for name in names:
        if name not in known:
            raise InputError(f"observable '{name}' is none of the model's; there are {', '.join(known)}")
    return tuple(names)


def _tolerances(asked: Mapping[str, Any], study: Study) -> dict[str, float]:
    """Read until which change of each number levels are added, in its unit."""
    if asked and not study.levels.ordered:
        raise InputError("until_change goes on with finer levels, and rules have none")
    units = {one.name: one.units for one in study.numbers()} if asked else {}
    found = {}
    for name, given in asked.items():
        if name not in units:
            raise InputError(f"until_change names '{name}'; there are {', '.join(units)}")
        one, unit = parse_quantity(given), parse_unit(units[name])
        bare = not isinstance(given, str | Quantity)
        if not bare and one.unit.dimension != unit.dimension:
            raise InputError(f"until_change of '{name}' is {given!r}, needs the unit '{units[name]}'")
        found[name] = one.value if bare else one.si / float(unit.factor)
        if not found[name] > 0.0:
            raise InputError(f"until_change of '{name}' is {given!r}, needs a positive one")
    return found


def _stopped(changing: list[str], count: int, limit: str) -> str:
    """Say why no further level was added."""
    if changing:
        return f"after {count} levels, with {', '.join(changing)} still changing by more than its tolerance: no finer level, {limit}"
    return f"every change under its tolerance from level {count - 2} to level {count - 1}"


def lines_of(study: xr.Dataset) -> list[str]:
    """Say what a refinement found, in lines."""
    varied = str(study.attrs["varied"])
    levels = ", ".join(f"{one:.6g}" if study[varied].dtype.kind == "f" else str(one) for one in study[varied].values)
    units = study[varied].attrs["units"]
    lines = [f"levels    {varied} {levels}{'' if units == '1' else f' {units}'}"]
    outcomes = dict.fromkeys(map(str, study["run_outcome"].values))
    lines.append(f"outcomes  {', '.join(outcomes)}")
    lines.append("±         numerical, at about 95 %; what parameters and the start are uncertain by is not in it")
    for name in [str(one) for one in study.data_vars if f"difference_{one}" in study]:
        lines += _of_number(study, name)
    return lines + ([f"stopped   {study.attrs['stopped']}"] if "stopped" in study.attrs else [])


def _of_number(study: xr.Dataset, name: str) -> Iterator[str]:
    """Say what became of one number at its first and last place."""
    one = study[name]
    places = [dim for dim in one.dims if dim != LEVEL]
    units = "" if one.attrs["units"] == "1" else f" {one.attrs['units']}"
    count = study.sizes[places[0]] if places else 1
    for k in range(count if places != [OCCURRENCE] else min(count, MOST_SHOWN)):
        here = {places[0]: k} if places else {}
        value = float(one.isel(here)[-1])
        where = (
            ""
            if not places
            else f" at t = {float(study[AT_TIME][k]):.9g}{behind(time_unit(study))}"
            if places[0] == AT
            else f" [{k + 1}]"
        )
        if np.isnan(value):
            yield f"{name}{where} is not there in the finest level"
            continue
        if f"verdict_{name}" not in study:
            yield f"{name}{where} = {value:.12g}{units}, changed by {float(study[f'difference_{name}'].isel(here)[-2]):.3g}{units}"
            continue
        order = float(study[f"order_{name}"].isel(here)[-2]) if study.sizes[LEVEL] > FEWEST else np.nan
        verdict = words_of(study[f"verdict_{name}"].isel(here))[0]
        uncertainty = float(study[f"uncertainty_{name}"].isel(here))
        shown = f", order {order:.3g}" if np.isfinite(order) else ""
        yield f"{name}{where} = {value:.{digits(value, uncertainty=uncertainty)}g} ± {uncertainty:.2g}{units}{shown}, {verdict}"
    if places == [OCCURRENCE] and count > MOST_SHOWN:
        yield f"{name}: {count - MOST_SHOWN} further occurrences are in the record"

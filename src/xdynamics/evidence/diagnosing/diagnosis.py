"""Diagnosis of a run: energy, momentum, cycles, extremes, and the time up to which it can be believed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics import archive, record, schema
from xdynamics.dynamics.recorded_steps import model_of_record
from xdynamics.evidence.audit import audit, audited_columns, gate_lines, gates_of
from xdynamics.evidence.chunks import Chunks, Unread, with_roles
from xdynamics.evidence.companion import Companion, Tighter, check_whole, tighter_of
from xdynamics.evidence.diagnosing import chaos
from xdynamics.evidence.diagnosing.conservation import (
    ROLE,
    bands,
    belief_variables,
    closed_form_residuals,
    conservation_variables,
)
from xdynamics.evidence.diagnosing.continuity import continuity, continuity_lines
from xdynamics.evidence.diagnosing.extremes import extremes_of, has_many_elements, sought_names
from xdynamics.evidence.diagnosing.phases import (
    count_coordinate_cycles,
    cycle_variables,
    exact_march,
    limit_occurrences,
    reference_times,
    turn_variables,
)
from xdynamics.evidence.evidence_dataset import (
    NOT_CHECKED,
    Gate,
    attrs_of,
    evidence_dataset,
    gate_variables,
    relative_uncertainty,
    stated_value,
)
from xdynamics.evidence.runs import prepare_record
from xdynamics.evidence.stages import Stage, requested_count, subject_of, task_of, task_of_runs
from xdynamics.faults import InputError
from xdynamics.march import March
from xdynamics.model import Model
from xdynamics.record import check, check_kind, shapes_of, unfold
from xdynamics.record.folding import fold, labelled, model_dimensions
from xdynamics.record.schemas import check_every_column, check_every_row
from xdynamics.record.unfolding import get_column
from xdynamics.schema import CYCLE, SAMPLES, STEPS
from xdynamics.units import unit_suffix
from xdynamics.units.digits import UNESTIMATED, UNKNOWN, digits

if TYPE_CHECKING:
    import xarray as xr

Functions = Mapping[str, Callable[..., float]]

KEPT = ("solver_method", "solver_step", "solver_rtol", "model_digest")  # attributes of the run
NOT_FOLLOWED = ("force", "energy", "observable", "error")  # roles of columns that exponents do not need
SAID = {
    "level": "what the coordinate rises through where a cycle begins",
    "level_rule": "why it is this level",
    "maxima": "how often the coordinate turns from rising to falling",
    "reference": "what phases are offset from",
    "cycle_doubt": "why cycles may not be what they are taken for; empty if nothing is doubted",
    "continuity_rule": "which steps were recomputed, or why none was",
}
LONGEST = 9  # digits in lines of numbers whose uncertainty is known
RELATIVE = "relative_uncertainty"  # attribute: what tolerances and uncertain inputs leave open of a number
RANGES = {"band_": "band", "drift_": "drift", "minimum_": "least", "maximum_": "greatest"}  # columns of the table
OF_RANGES = ("maximum_", "minimum_", "band_", "drift_")
SAMPLED = "sampled"  # of an extreme: at a row, where others are interpolated between rows or located


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
    occurrences: int | None = None,
    compute: bool = True,
) -> xr.Dataset:
    """Diagnose a run from its record.

    Parameters
    ----------
    run : xarray.Dataset
        A run record. Of one in chunks each chunk is read once, in order; columns that are needed again are kept as long
        as they take no more MB than $XDYNAMICS_REMEMBERED_LIMIT (256), and else read again. With ``compute=False`` it may
        be one that `simulate` described and that is still to be marched.
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
        64 variables); or how many of the largest. Of a run in chunks times, states, accelerations and flags are read whole. They need a run that is much longer than 1/exponent. Contacts that
        hold, dry friction and impacts of several contacts at once are refused.
    functions : mapping of str to callable, optional
        The Python functions that the model's forces call.
    occurrences : int, optional
        How many cycles and turns to list, from the first; nan where there are fewer. By default all.
    compute : bool
        Whether to march and read at once. If False, the Dataset has dask arrays, with one task for each additional run,
        and for the run itself if it is still to be marched; with coordinates that needs `occurrences`.

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
        whether steps, recomputed from the rows they started from, lead to the rows they led to, `continuity_verdict`
        (passed, failed, not_checked), of each variable that they change how far the furthest is off and what rounding
        explains, `continuity_defect_y` and `continuity_bound_y`, and when it starts, `continuity_time`;
        with a companion `believed_until`, the time up to which no coordinate, velocity or state is further from the
        solution than a tenth of its range (as far as a second march can tell: it marches the same way, and would miss
        the same event); along `gate`, of a model with acting events or contacts, `gate_name`, `gate_verdict` and
        `gate_reason`: whether anything in the record contradicts the model (`events_met`, `contacts_admissible`); on request `lyapunov_exponent` (the largest), `lyapunov_time` (1 over it;
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
    if task_of(run) is None:
        check(run, whole=False, values=False)
    check_every_row(run.attrs, "a diagnosis")
    check_every_column(run.attrs, "a diagnosis")
    if reference is not None or lyapunov is not False:
        check_whole(run)  # cycles are counted, and changes followed, from the start
    if not isinstance(of, str | None):
        raise InputError(f"of is {of!r}, needs the name of a coordinate")
    request = DiagnosisRequest(
        of, level, reference, exact, lyapunov, functions, requested_count(occurrences, "occurrences")
    )
    tighter = tighter_of(run, functions) if companion else None
    needs = [tighter.task] if tighter is not None else []
    by_exact = reference is None and tighter is not None and bool(with_roles(run, ("coordinate",)))
    exact_run = exact_march(run, functions) if by_exact else None
    needs += [exact_run] if exact_run is not None else []
    call = partial(_diagnosed, request, tighter)
    task = task_of_runs("diagnosis", call, (run,), *request.words, needs=tuple(needs))
    stage = Stage(task, partial(_diagnosis_template, request, tighter, run), ("gate_name",))
    return _with_run_labels(stage.result(compute=compute), run)


def _diagnosis_template(request: DiagnosisRequest, tighter: Tighter | None, run: xr.Dataset) -> xr.Dataset:
    """Return a diagnosis before its run is marched or read.

    Raises
    ------
    InputError
        If the run has coordinates, and no number of cycles is given.
    """
    if request.occurrences is None and with_roles(run, ("coordinate",)):
        raise InputError(
            "how many cycles a run has is known only once it is computed and read; give the number to list, like"
            " occurrences=10"
        )
    return _blank_diagnosis(request, run, model_of_record(run, request.functions), tighter)


def foreseen_diagnosis(march: March, occurrences: int) -> xr.Dataset:
    """Return the diagnosis of a march's run before it begins: zeros, with names, dimensions and units."""
    run = record.foreseen(march)
    request = DiagnosisRequest(functions=march.model.functions, occurrences=occurrences)
    return _with_run_labels(_blank_diagnosis(request, run, march.model, Tighter(march.model, {}, 1.0, "")), run)


def _blank_diagnosis(request: DiagnosisRequest, run: xr.Dataset, model: Model, tighter: Tighter | None) -> xr.Dataset:
    rows = Unread(unfold(run), model, request.occurrences or 0)
    companion = None if tighter is None else tighter.to_companion(rows.run, rows.run, request.functions)
    return _diagnosis_dataset(request, rows, companion, None, ())


def _with_run_labels(diagnosis: xr.Dataset, run: xr.Dataset) -> xr.Dataset:
    """Return a diagnosis with the labels of the run's dimensions."""
    return labelled(fold(diagnosis, shapes_of(run))) if model_dimensions(run) else diagnosis


@dataclass(frozen=True)
class DiagnosisRequest:
    """The arguments of a diagnosis; see `diagnose`."""

    coordinate: str | None = None
    level: str | float | None = None
    reference: xr.Dataset | str | float | None = None
    exact: Mapping[str, str] | None = None
    lyapunov: bool | int = False
    functions: Functions | None = None
    occurrences: int | None = None

    @property
    def words(self) -> list[Any]:
        """All that a diagnosis depends on besides runs, to be compared as it is printed."""
        reference = self.reference
        reference_name = reference if isinstance(reference, str | float | int | None) else subject_of(reference)
        return [self.coordinate, self.level, reference_name, self.exact, self.lyapunov, self.occurrences]


def _diagnosed(request: DiagnosisRequest, tighter: Tighter | None, run: xr.Dataset, *marched: xr.Dataset) -> xr.Dataset:
    """Diagnose a run beside a tighter and a nearly exact one, where they are marched."""
    functions = request.functions
    model = model_of_record(run, functions)
    run = prepare_record(run, functions)
    if request.exact or request.lyapunov is not False or not has_many_elements(run, model):
        run, marched = unfold(run), tuple(map(unfold, marched))
    further_runs = iter(marched)
    tighter_companion = None if tighter is None else tighter.to_companion(run, next(further_runs), functions)
    digests = [
        archive.digest_of_run(entry) for entry in (run, *([] if tighter_companion is None else [tighter_companion.run]))
    ]
    rows = Chunks(run, model)
    return _diagnosis_dataset(request, rows, tighter_companion, next(further_runs, None), digests)


def _diagnosis_dataset(
    request: DiagnosisRequest,
    rows: Chunks,
    tighter: Companion | None,
    exact_run: xr.Dataset | None,
    digests: Sequence[str],
) -> xr.Dataset:
    """Return the Dataset of a diagnosis; for rows that cannot be read yet, its template."""
    run, functions = rows.run, request.functions
    attributes: dict[str, Any] = {name: run.attrs[name] for name in KEPT if name in run.attrs}
    attributes[RELATIVE] = relative_uncertainty(run, rows.model)
    variables = dict(bands(rows))
    steps, remade = continuity(rows, functions)
    rule: dict[str, Any] = {"continuity_rule": remade}
    units = ""
    coordinate_name = request.coordinate and rows.model.shapes.internal_name(request.coordinate)
    coordinate_cycles = count_coordinate_cycles(rows, coordinate_name, request.level, functions)
    variables |= dict(conservation_variables(rows, coordinate_cycles, functions))
    if coordinate_cycles is not None:
        ideal, source = reference_times(rows, coordinate_cycles, request.reference, tighter, exact_run, functions)
        turning = turn_variables(rows, coordinate_cycles.name, functions)
        variables |= cycle_variables(rows, coordinate_cycles, ideal, turning, functions) | turning
        units = str(get_column(run, coordinate_cycles.name).attrs["units"])
        attributes |= {"coordinate": coordinate_cycles.name, "level_units": units}
        rule |= {
            "level": coordinate_cycles.level,
            "level_rule": coordinate_cycles.rule,
            "maxima": coordinate_cycles.maxima,
            "reference": source,
            "cycle_doubt": coordinate_cycles.doubt,
        }
    attributes |= {name: value for name, value in rule.items() if value != ""}
    if isinstance(rows, Unread):  # attributes that are not known yet are variables
        variables |= {
            name: ((), value, attrs_of(units if name == "level" else "1", SAID[name], "rule"))
            for name, value in rule.items()
        }
    variables = limit_occurrences(variables, request.occurrences)
    names = with_roles(run, schema.INTEGRATED) if model_dimensions(run) else sought_names(run, rows.model)
    variables |= extremes_of(rows, names, functions)
    variables |= steps
    variables |= dict(closed_form_residuals(rows, {} if request.exact is None else request.exact))
    if request.exact:
        variables["time"] = ((STEPS,), rows.values_at("time", np.arange(rows.size)), dict(run["time"].attrs))
    gates = [Gate(name, NOT_CHECKED, "") for name in gates_of(rows.model)]
    if gates and not isinstance(rows, Unread):
        audited = audited_columns(run, rows.model)
        gates = audit(rows.load_variables(audited) if rows.is_stored else audited, functions)
    if gates:
        variables |= gate_variables(gates, "what is asked of the record")
    if tighter is not None:
        variables |= belief_variables(rows, tighter)
        attributes["companion"] = tighter.tightening
    if request.lyapunov is not False:
        variables |= _lyapunov_variables(rows, request)
    return evidence_dataset(
        "diagnosis", f"diagnosis of {run.attrs['title']}", digests, variables, attributes, shapes=rows.model.shapes
    )


def _lyapunov_variables(rows: Chunks, request: DiagnosisRequest) -> dict[str, Any]:
    """Return the Lyapunov exponents of a run; of a run in chunks the necessary columns are loaded."""
    run, exponent_count = rows.run, request.lyapunov
    if isinstance(rows, Unread):
        return chaos.describe_exponents(str(run["time"].attrs["units"]), rows.model, exponent_count=exponent_count)
    if rows.is_stored:
        run = run.drop_dims(SAMPLES, errors="ignore")
        run = rows.load_variables(run.drop_vars([name for name in run if run[name].attrs.get("role") in NOT_FOLLOWED]))
    return chaos.lyapunov(run, request.functions, exponent_count=exponent_count)


def cycles_text(diagnosis: xr.Dataset) -> str:
    """Describe which coordinate's cycles are counted, and through which level; older diagnoses name no rule."""
    level, rule = float(stated_value(diagnosis, "level")), stated_value(diagnosis, "level_rule")
    why = f", {rule}" if rule is not None else ""
    return (
        f"{diagnosis.attrs['coordinate']}, each from one rise through"
        f" {level:.6g}{unit_suffix(str(diagnosis.attrs['level_units']))}{why}, to the next"
    )


def cycle_count(diagnosis: xr.Dataset) -> int:
    """Return how many of the cycles that are listed there are."""
    # by numpy: xarray would import dask to find out that the numbers are not one of its arrays
    return int(np.count_nonzero(~np.isnan(diagnosis["period"].values))) if CYCLE in diagnosis.dims else 0


def diagnosis_lines(diagnosis: xr.Dataset) -> Iterator[str]:
    """Describe a diagnosis: how far each quantity ranged as a table, then line by line."""
    table_lines, tabulated = _range_table(diagnosis)
    yield from table_lines
    for name, variable in diagnosis.data_vars.items():
        is_described = name in tabulated or name in chaos.IN_WORDS
        if not variable.dims and variable.attrs["role"] in (ROLE, "residual") and not is_described:
            rule = f"{name}_rule"
            rule_text = (
                f", {str(diagnosis[rule].attrs['flag_meanings']).split()[int(diagnosis[rule])]}"
                if rule in diagnosis
                else ""
            )
            scaled_name = schema.scaled_name(str(name))
            rule_text += (
                f", scaled {float(diagnosis[scaled_name]):.3g} by {_scale_in_words(diagnosis, str(name))}"
                if scaled_name in diagnosis
                else ""
            )
            yield f"{name} = {diagnosed(diagnosis, str(name))}{rule_text}"
    yield from continuity_lines(diagnosis)
    yield from gate_lines(diagnosis)
    yield from chaos.exponents_in_words(diagnosis)
    if doubt := stated_value(diagnosis, "cycle_doubt"):
        yield f"attention: {doubt}"
    if count := cycle_count(diagnosis):
        yield f"cycles of {cycles_text(diagnosis)}: {count}, phases beside {stated_value(diagnosis, 'reference')}"
        for name in ("period", "phase_offset", "amplitude", "phase_space_area"):
            if np.isnan(diagnosis[name].values[:count]).all():
                yield f"{name} is unknown: the reference has fewer cycles, or none was computed"
                continue
            first, last = (diagnosed(diagnosis, name, k) for k in (0, count - 1))
            yield f"{name} = {first} in the first cycle, {last} in the last"


def _range_table(diagnosis: xr.Dataset) -> tuple[list[str], set[str]]:
    """Return band, drift, least and greatest value of each quantity, in columns; and the names of what is tabulated there."""
    cells: dict[str, dict[str, str]] = {}
    tabulated: set[str] = set()
    for name, (quantity, column) in _ranges(diagnosis):
        text = diagnosed(diagnosis, name)
        tabulated |= {name}
        time, rule = f"{name}_time", f"{name}_rule"
        if time in diagnosis:
            text += f" at {diagnosed(diagnosis, time)}"
            tabulated |= {time}
        if rule in diagnosis and str(diagnosis[rule].attrs["flag_meanings"]).split()[int(diagnosis[rule])] == SAMPLED:
            text += f", {SAMPLED}"
        cells.setdefault(quantity, {})[column] = text
    if not cells:
        return [], tabulated
    columns = [column for column in RANGES.values() if any(column in row for row in cells.values())]
    rows = [
        ["", *columns],
        *([quantity, *(row.get(column, "") for column in columns)] for quantity, row in cells.items()),
    ]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ], tabulated


def _ranges(diagnosis: xr.Dataset) -> Iterator[tuple[str, tuple[str, str]]]:
    """Yield the names of bands, drifts and extremes without a dimension, with quantity and column."""
    for name, variable in diagnosis.data_vars.items():
        text = {"energy_band": "band_total_energy", "energy_drift": "drift_total_energy"}.get(str(name), str(name))
        prefix = next((prefix for prefix in RANGES if text.startswith(prefix)), "")
        is_detail = text.endswith(("_time", "_rule", "_uncertainty"))
        if prefix and not variable.dims and variable.attrs["role"] == ROLE and not is_detail:
            yield str(name), (text.removeprefix(prefix), RANGES[prefix])


def diagnosed(diagnosis: xr.Dataset, name: str, cycle: int | None = None) -> str:
    """Write a diagnosed number, or that of a cycle, with its unit and as many digits as its uncertainty justifies."""
    variable = diagnosis[name]
    value = float(variable if cycle is None else variable[cycle])
    return f"{value:.{_digits_of(diagnosis, name, cycle)}g}{unit_suffix(str(variable.attrs['units']))}"


def _digits_of(diagnosis: xr.Dataset, name: str, cycle: int | None = None) -> int:
    """Return the number of digits of a diagnosed number: six, or as many as its uncertainty justifies."""
    numbers = [name, f"{name}_uncertainty"] if f"{name}_uncertainty" in diagnosis else [name]
    value, *uncertainties = (float(diagnosis[key] if cycle is None else diagnosis[key][cycle]) for key in numbers)
    doubt = float(diagnosis.attrs.get(RELATIVE, UNKNOWN)) * max(abs(value), _range_of(diagnosis, name))
    digit_count = digits(value, uncertainty=max(doubt, *uncertainties) if uncertainties else doubt)
    return min(digit_count, LONGEST if uncertainties else UNESTIMATED)


def _range_of(diagnosis: xr.Dataset, name: str) -> float:
    """Return the largest size in the run of the quantity that an extreme, a band or a drift belongs to; 0 if it has none."""
    quantity = "total_energy" if name in ("energy_band", "energy_drift") else name
    for prefix in OF_RANGES:
        quantity = quantity.removeprefix(prefix)
    sizes = [f"{prefix}{quantity}" for prefix in OF_RANGES]
    return max((abs(float(diagnosis[size])) for size in sizes if size in diagnosis), default=0.0)


def _scale_in_words(diagnosis: xr.Dataset, norm: str) -> str:
    """Write the scale of a residual's norm."""
    scale = diagnosis[schema.scale_name("residual", norm.partition("_residual_")[2])]
    return f"{float(scale):.6g}{'' if scale.attrs['units'] == '1' else ' ' + scale.attrs['units']}"


SUMMARIES = {"diagnosis": diagnosis_lines}

"""The validation ledger: runs compared with closed forms, in the order that reveals faults soonest."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import archive
from xdynamics.evidence.event_matching import met
from xdynamics.evidence.evidence_dataset import about, exhibit
from xdynamics.evidence.observables import observables_of, observe
from xdynamics.evidence.runs import march
from xdynamics.evidence.scaling import ROLE as SCALED
from xdynamics.evidence.scaling import over, scale_of
from xdynamics.evidence.stages import Stage, Task, inputs_of, lazy, march_task, remembered
from xdynamics.evidence.validating.impacts import checks_of
from xdynamics.expressions import dimension_of, text_of
from xdynamics.faults import InputError
from xdynamics.march.outcomes import GOOD
from xdynamics.methods import METHODS
from xdynamics.methods.steppers import DIFFERENCES, TimeStepping
from xdynamics.model import Model
from xdynamics.model.closed_forms import BAND, ORDER, UNSCALED, exact_from
from xdynamics.model.motion import constants, evaluated_many
from xdynamics.model.parts import Validation
from xdynamics.record.circumstances import xdynamics_version
from xdynamics.record.flag_words import time_unit, words_of
from xdynamics.runtime.cached_properties import cached_property
from xdynamics.schema import CASE, RESIDUAL_SCALE, SCALED_RESIDUAL, STEPS, flags, velocity
from xdynamics.units import Quantity, parse_unit, time_in, unit_suffix

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

CASES = Path(__file__).with_name("cases")
VERDICTS = ("passed", "failed", "refused")
PASSED, FAILED, REFUSED = range(len(VERDICTS))
EPS = float(np.finfo(float).eps)
SLACK = 0.5  # of an order, by which halved steps may fall short: a defect costs a whole order
FINER = {1: 1 / 20, 2: 1 / 4, 3: 1 / 2}  # times the step of a case, by the order of a method
NEAR = 1e-12  # of the span: accepted times that agree but for rounding
TENTH = 10  # a band is compared between the first and the last tenth
BAND_AT_MOST, ORDER_AT_MOST = 0.2, 0.5  # of the largest value, the most that a bound may be
WIDER = 1.5  # times its first part, the most that a band may be in its last one
ROLE = "validation"
EXACT_CASES = "validation ledger: exact cases"  # title
OF_IMPACTS = {"impact": 5}  # lines of the law of impacts of the ledger's own cases
SCALE_RULE = (
    "largest size of the closed form where it is compared (of an event's time from the start), never its value at one"
    " time, which may pass zero; where it is 0 throughout, largest size of what was computed"
)


def validate(
    methods: Sequence[str] | str | Model | None = None,
    model: Model | None = None,
    *,
    impacts: int | None = None,
    compute: bool = True,
) -> xr.Dataset:
    """Compare methods with exact cases, or a model with its own closed forms and the law of its contacts.

    Parameters
    ----------
    methods : sequence of str, optional
        Names of methods; by default all, or with a model the one of its `[run]`.
    model : Model, optional
        A model with closed forms, ``[validation.<name>]``; by default the ledger's own cases: zero force, constant
        acceleration, linear drag, linear oscillator, a long oscillation, zero coupling, normal modes alone and
        together, a drive of time, impact, resting contact, dry friction, unit scaling.
    impacts : int, optional
        How many relations of impacts to list of a model with contacts; where a run has fewer they are refused. By
        default as many as it has.
    compute : bool
        Whether to march at once. If False, the Dataset has dask arrays, with one task for each case and method. A model
        with contacts needs `impacts` then.

    Returns
    -------
    xarray.Dataset
        Along `case`, stage by stage: `case_name`, `case_method`, `case_stage`, `case_relation` (the closed form),
        `case_observable`, `case_where` (times, or an event), `case_norm`, `residual` and `bound` (in `case_units`),
        `scaled_residual` over `residual_scale` (the largest expected size, in `case_units`; one expected value may be
        0), `case_bound_rule`, `verdict` (a flag: passed failed refused), `case_note`, `case_run` (content digest).

    Raises
    ------
    InputError
        If a method is not known, or the model has neither a closed form nor contacts.

    Notes
    -----
    Bounds are derived. `rounding`: for each of n steps as many roundings of the largest value as the method has
    evaluations, plus two; for a coordinate also those of its velocity over the whole time, and at an event the
    uncertainty of its location. `order`: the error with twice the step over 2**(p - 1/2): halving the step divides
    it by 2**p, so a method that has lost one order does not pass; at most half the largest value. `band`: for
    symplectic methods, in the last tenth 1.5 times the largest error in the first tenth, at most a fifth of the value.
    `unscaled`: rounding, compared with the same march in SI units.

    Examples
    --------
    >>> found = validate(["velocity_verlet"])
    >>> sorted({VERDICTS[one] for one in found.verdict.values})
    ['passed', 'refused']
    """
    if isinstance(methods, Model) and model is None:
        methods, model = None, methods
    names = _names(methods, model, impacts)
    cases = _own(names) if model is None else _of_model(model, names, impacts)
    title = EXACT_CASES if model is None else f"validation of {model.name}"
    if compute:
        return _dataset([row for case in cases for row in case.rows()], title)
    return lazy(ledger_stage(cases, title))


def _names(methods: Any, model: Any, impacts: Any) -> list[str] | None:
    """Check the arguments of `validate`, and return the names of methods, if there are any."""
    if methods is not None and not isinstance(methods, str | Sequence):
        raise InputError(f"methods is {str(methods)[:40]!r}, needs names of methods")
    if model is not None and not isinstance(model, Model):
        raise InputError(f"model is {str(model)[:60]!r}, needs a Model; read a file with Model.from_toml")
    if impacts is not None and (isinstance(impacts, bool) or not isinstance(impacts, int) or impacts < 0):
        raise InputError(f"impacts is {impacts!r}, needs a non-negative whole number")
    names = [methods] if isinstance(methods, str) else None if methods is None else list(methods)
    for name in names or ():
        if name not in METHODS:
            raise InputError(f"method {name!r} is not known; there are {', '.join(METHODS)}")
    return names


def _own(methods: Sequence[str] | None) -> list[Case]:
    """Return the ledger's own cases by methods."""
    return [
        Case(model, method, stage, f"{name}.", OF_IMPACTS.get(name, 0))
        for stage, (name, model) in enumerate(_own_cases(), 1)
        for method in methods or METHODS
    ]


def _of_model(model: Model, methods: Sequence[str] | None, impacts: int | None) -> list[Case]:
    """Return the cases of a model by methods.

    Raises
    ------
    InputError
        If it has neither a closed form nor contacts, or no method.
    """
    if not model.validation and not model.contacts:
        raise InputError(
            f"model '{model.name}' has no closed form, and no contacts; write one as [validation.<name>] with"
            " expression, bound"
        )
    chosen = methods or [str(model.run["method"])] if "method" in model.run or methods else []
    if not chosen:
        raise InputError(f"model '{model.name}' has no method in its [run]; give methods=[…]")
    return [Case(model, method, impacts=impacts) for method in chosen]


def ledger_stage(cases: Sequence[Case], title: str) -> Stage:
    """Return a ledger before it is computed, one task for each case and method."""
    tasks = tuple(case.task() for case in cases)
    template = _dataset([row for case in cases for row in case.blank()], title)
    return Stage(template, Task.of("ledger", partial(_of_tasks, title), tasks), ("case_method", "case_stage"))


def own_ledger(methods: Sequence[str]) -> Stage:
    """Return the ledger of exact cases by methods, before it is computed."""
    return ledger_stage(_own(methods), EXACT_CASES)


def _of_tasks(title: str, *rows: Sequence[Row]) -> xr.Dataset:
    return _dataset([row for case in rows for row in case], title)


@lru_cache(maxsize=1)
def _own_cases() -> list[tuple[str, Model]]:
    """Read the ledger's own cases, in their order."""
    return [(path.stem.partition("_")[2], Model.from_toml(path)) for path in sorted(CASES.glob("*.toml"))]


@dataclass(frozen=True)
class Row:
    """One line of the ledger."""

    name: str
    method: str
    stage: int
    relation: str
    observable: str
    where: str
    rule: str
    units: str = "1"
    norm: str = "largest absolute difference"
    residual: float = np.nan
    bound: float = np.nan
    scale: float = np.nan
    note: str = ""
    run: str = ""

    @property
    def verdict(self) -> int:
        """Index into `VERDICTS`; a residual of nan has failed."""
        if self.note and np.isnan(self.bound):
            return REFUSED
        return PASSED if self.residual <= self.bound else FAILED


@dataclass(frozen=True)
class Case:
    """One model by one method.

    Attributes
    ----------
    model : Model
    method : str
    stage : int
        Of the ledger; 0 for a model's own closed forms.
    prefix : str
        Of the names of its lines.
    impacts : int, optional
        How many lines of the law of impacts there are where the method locates them; None for as many as the run has.
    """

    model: Model
    method: str
    stage: int = 0
    prefix: str = ""
    impacts: int | None = None

    def task(self) -> Task:
        """Return the task that marches it.

        Raises
        ------
        InputError
            If the number of its lines is not known.
        """
        if self.impacts is None and self.model.contacts:
            raise InputError(
                f"how many relations of impacts a run of '{self.model.name}' has is not known before marching; give the"
                " number to list, like impacts=10 (refused where there are fewer), or 0 for none"
            )
        asked = Marched(self.model, self.method, own=self.stage > 0).asked
        words = (
            self.stage,
            self.prefix,
            self.impacts,
            self.method,
            self.model.digest,
            inputs_of(asked),
            xdynamics_version(),
        )
        return Task.of("case", partial(_rows_of, self), (), *words)

    def rows(self, marched: Callable[..., xr.Dataset] = march) -> Iterator[Row]:
        """Yield the lines of the ledger, of runs that are marched when they are first needed."""
        runs = Marched(self.model, self.method, own=self.stage > 0, marched=marched)
        for row, case in self._forms():
            why = runs.refusal(case)
            yield replace(row, note=why) if why else runs.filled(row, case)
        if self.model.contacts and (self.impacts != 0 or self.stage):
            lines = [*_of_impacts(runs, self.prefix, self.stage)]
            missing = [] if self.impacts is None or self.stage else self._missing(self.impacts - len(lines))
            yield from [*lines, *missing][: None if self.stage else self.impacts]

    def blank(self) -> Iterator[Row]:
        """Yield as many lines, before anything is marched."""
        yield from (row for row, _ in self._forms())
        if self.model.contacts:
            runs = Marched(self.model, self.method, own=self.stage > 0)
            located = not (runs.refused or isinstance(runs.method.stepper, TimeStepping))
            yield from self._missing(self.impacts or 0 if located or not self.stage else 1)

    def _missing(self, count: int) -> list[Row]:
        """Return lines in the place of relations that a run does not have."""
        law = next(iter(self.model.contacts.values())).law
        relation, note = f"law of impacts '{law}'", "the run has no further relation of impacts"
        where = "contacts", "every impact", "rounding"
        return [Row(f"{self.prefix}impacts", self.method, self.stage, relation, *where, note=note)] * max(0, count)

    def _forms(self) -> Iterator[tuple[Row, Validation]]:
        """Yield every closed form, with its line as far as it is known."""
        for name, case in self.model.validation.items():
            where = f"at {case.event} {case.occurrence}" if case.event else _times_in_words(case, self.model)
            rule = str(case.bound) if isinstance(case.bound, str) else "given"
            relation = text_of(case.expression)
            yield Row(f"{self.prefix}{name}", self.method, self.stage, relation, case.quantity, where, rule), case


def _of_impacts(marched: Marched, prefix: str, stage: int) -> Iterator[Row]:
    """Yield the lines of the impacts of a model's own run, checked against the law of its contacts."""
    law, method = next(iter(marched.model.contacts.values())).law, marched.method
    row = Row(f"{prefix}impacts", method.name, stage, f"law of impacts '{law}'", "contacts", "every impact", "rounding")
    if marched.refused or isinstance(method.stepper, TimeStepping):
        why = f"the method refuses: {'; '.join(marched.refused)}" if marched.refused else "the method locates no events"
        yield replace(row, note=why)
        return
    checks = list(checks_of(marched.run, marched.model))
    if not checks and not stage:
        yield replace(row, note="the run has no impact")
    for check in checks:
        yield replace(
            row,
            name=f"{row.name}.{check.name}",
            relation=check.relation,
            observable=check.observable,
            where=check.where or row.where,
            units=check.units,
            residual=check.residual,
            bound=check.bound,
            note=check.note,
            run=archive.digest_of_run(marched.run),
            norm="largest, measured by its bound",
        )


def _times_in_words(case: Validation, model: Model) -> str:
    if case.times:
        return "t = " + ", ".join(f"{time:.9g}" for time in case.times) + unit_suffix(model.time_unit)
    prefix = "the last tenth of " if case.bound == BAND else ""
    return f"{prefix}accepted states up to {model.run.get('until', 'the end')}"


class Marched:
    """The runs of one model by one method, each marched when first needed."""

    def __init__(self, model: Model, method: str, *, own: bool, marched: Callable[..., xr.Dataset] = march) -> None:
        self.model, self.method, self.marched = model, METHODS[method], marched
        refused, by_differences = (self.method.refusals(model, by_differences=allowed) for allowed in (False, True))
        self.refused = by_differences
        self.asked: dict[str, Any] = {"method": method}
        if refused and not by_differences:
            self.asked["jacobian"] = DIFFERENCES
        if own:  # the ledger's cases: with steps so small that a low order is accurate too
            self.asked["step"] = time_in(model.time_unit, model.run["step"], "step") * FINER.get(self.method.order, 1.0)

    def refusal(self, case: Validation) -> str:
        """Return why a case does not apply to the method; empty if it does."""
        if self.refused:
            return f"the method refuses: {'; '.join(self.refused)}"
        if case.bound == BAND and not self.method.symplectic:
            return "the method is not symplectic: it claims no band"
        if case.event and isinstance(self.method.stepper, TimeStepping):
            return "the method locates no events"
        return ""

    @cached_property
    def run(self) -> xr.Dataset:
        """The run with the steps of the model's `[run]`."""
        return self.marched(self.model, **self.asked)

    @cached_property
    def coarse(self) -> xr.Dataset:
        """The run with twice the step.

        Raises
        ------
        InputError
            If the run has chosen steps.
        """
        if self.run.attrs["solver_step_control"] != "fixed":
            raise InputError(
                f"a bound by '{ORDER}' needs a fixed step in [run]; model '{self.model.name}' has chosen ones"
            )
        return self.marched(self.model, **self.asked | {"step": 2.0 * float(self.run.attrs["solver_step"])})

    @cached_property
    def unscaled(self) -> xr.Dataset:
        """The run without scales."""
        settings = {key: value for key, value in self.model.run.items() if key != "scales"}
        return self.marched(self.model, **settings | self.asked | {"scales": {}})

    def filled(self, row: Row, case: Validation) -> Row:
        """Return a line with its residual, bound and scale.

        Raises
        ------
        InputError
            If the closed form or the run does not fit the case.
        """
        run = self.run
        row = replace(row, units=_units(run, case), run=archive.digest_of_run(run))
        self.check_dimension(case, row.units)
        end = float(run["time"][-1])
        if run.attrs["run_outcome"] not in GOOD or max(case.times, default=end) > end:
            why = f"the run ended before: {run.attrs['run_outcome_text']}"
            return replace(row, residual=np.inf, bound=0.0, note=why)
        if not case.event and not case.times:
            row = replace(
                row,
                where=(
                    f"{'the last tenth of ' * (case.bound == BAND)}accepted states up to"
                    f" {end:.9g}{unit_suffix(time_unit(run))}"
                ),
            )
        try:
            residual, expected = self.residual(run, case), self.expected(run, case)
            if case.bound == BAND:
                part = max(1, len(residual) // TENTH)
                most = BAND_AT_MOST * float(np.max(np.abs(run[case.quantity])))
                bound = min(WIDER * float(np.max(residual[:part])), most) + self.rounding(case)
                residual, expected = residual[-part:], expected[-part:]
            else:
                bound = self.bound(case)
        except LookupError as error:
            return replace(row, residual=np.inf, bound=0.0, note=str(error.args[0]))
        if case.bound == UNSCALED:
            here, there = (np.asarray(record[case.quantity]) for record in (run, self.unscaled))
            if here.shape != there.shape:
                return replace(row, residual=np.inf, bound=bound, note=f"{len(here)} rows, unscaled {len(there)}")
            residual, expected = np.abs(here - there), there
        scale = float(scale_of(expected, residual))  # where 0 is expected, the residual is the computed value
        return replace(row, residual=float(np.max(residual)), bound=bound, scale=scale)

    def check_dimension(self, case: Validation, units: str) -> None:
        """Refuse a closed form in another unit than the quantity it is compared with.

        Raises
        ------
        InputError
            Naming both.
        """
        dimension = dimension_of(self.model.expanded(case.expression), self.model.dimensions)
        if dimension != parse_unit(units).dimension:
            raise InputError(
                f"closed form {text_of(case.expression)!r} has units '{dimension}', needs '{units}' of"
                f" '{case.quantity}'"
            )

    def bound(self, case: Validation) -> float:
        """Return the most that a residual may be, in the record's unit."""
        if isinstance(case.bound, Quantity):
            return float(case.bound.si / parse_unit(_units(self.run, case)).factor)
        if case.bound == UNSCALED:
            return 2.0 * self.rounding(case)
        by_order = case.bound == ORDER or exact_from(case.bound) > self.method.order
        if not by_order:
            return self.rounding(case)
        halved = float(2.0 ** (self.method.order - SLACK))
        most = ORDER_AT_MOST * float(np.max(np.abs(self.true(self.run, case))))
        return min(float(np.max(self.residual(self.coarse, case))) / halved, most) + self.rounding(case)

    def rounding(self, case: Validation) -> float:
        """Return a bound of the rounding error, plus the uncertainty of location at an event."""
        run, name = self.run, case.quantity
        steps, span = run.sizes[STEPS], float(run["time"][-1] - run["time"][0])
        size = float(np.max(np.abs(run["time" if name == "t" else name])))
        if name in self.model.coordinates:
            size += span * float(np.max(np.abs(run[velocity(name)])))
        error = (self.method.evaluations + 2) * steps * EPS * size
        if case.event:
            k, row = _met(run, case)
            uncertainty = float(run["event_time_uncertainty"][k])
            rates = {
                **{coordinate: velocity(coordinate) for coordinate in self.model.coordinates},
                **{velocity(coordinate): f"a_{coordinate}" for coordinate in self.model.coordinates},
            }
            error += (
                uncertainty
                if name == "t"
                else uncertainty * abs(float(run[rates[name]][row - 1]))
                if name in rates
                else 0.0
            )
        return error

    def residual(self, run: xr.Dataset, case: Validation) -> Floats:
        """Return absolute differences from the closed form, in the record's unit.

        Raises
        ------
        LookupError
            If the event was not met that often.
        """
        name, times = case.quantity, self._times(run, case)
        if case.event:
            values = times if name == "t" else run[name].values[_met(run, case)[1] :][:1]
        elif case.times:
            values = self._at(run, name, times)
        else:
            values = run[name].values
        return np.abs(values - self._exact(case, times) / float(parse_unit(_units(run, case)).factor))

    def _times(self, run: xr.Dataset, case: Validation) -> Floats:
        """Return the times at which a closed form is compared."""
        if case.event:
            return np.asarray(run["event_time"].values[_met(run, case)[0] :][:1])
        return np.array(case.times) if case.times else np.asarray(run["time"].values)

    def true(self, run: xr.Dataset, case: Validation) -> Floats:
        """Return the closed form at the times of a case, or all along the run, in the record's unit."""
        times = np.array(case.times) if case.times else run["time"].values
        return self._exact(case, times) / float(parse_unit(_units(run, case)).factor)

    def expected(self, run: xr.Dataset, case: Validation) -> Floats:
        """Return the closed form where it is compared, in the record's unit; a time counts from the start."""
        origin = float(run["time"][0]) if case.quantity == "t" else 0.0
        return self._exact(case, self._times(run, case)) / float(parse_unit(_units(run, case)).factor) - origin

    def _exact(self, case: Validation, times: Floats) -> Floats:
        tree = self.model.expanded(case.expression)
        return np.broadcast_to(
            evaluated_many(self.model, [tree], {"t": times}, constants(self.model), ())[0], times.shape
        )

    def _at(self, run: xr.Dataset, name: str, times: Floats) -> Floats:
        """Return a quantity at times; quantities that are not observables are known at accepted times only."""
        if name in observables_of(self.model):
            return observe(run, self.model, [name], times)[name][0]
        accepted = run["time"].values
        rows = np.searchsorted(accepted, times + NEAR * (accepted[-1] - accepted[0]), side="right") - 1
        if (np.abs(accepted[rows] - times) > NEAR * (accepted[-1] - accepted[0])).any():
            raise InputError(f"'{name}' is known at accepted states alone; give times that are, or leave them out")
        values: Floats = run[name].values[rows]
        return values


def _met(run: xr.Dataset, case: Validation) -> tuple[int, int]:
    """Return the index of an event, and the row of the state after it."""
    occurrences = met(run).get(case.event, ())
    if len(occurrences) < case.occurrence:
        raise LookupError(f"{case.event} was met {len(occurrences)} times")
    k = int(occurrences[case.occurrence - 1])
    return k, int(run["event_row_after"][k])


def _units(run: xr.Dataset, case: Validation) -> str:
    """Return the unit of a quantity in a record."""
    if case.quantity == "t":
        return time_unit(run).text
    if case.quantity not in run.variables or run[case.quantity].dims != (STEPS,):
        raise InputError(
            f"quantity '{case.quantity}' is nothing that the run has along '{STEPS}'; name one by quantity = …, without"
            " it the name of the table is one"
        )
    return str(run[case.quantity].attrs["units"])


def _rows_of(case: Case) -> list[Row]:
    """Return the lines of a case, in a task; runs that other stages need too are marched once."""
    return [*case.rows(lambda model, **asked: remembered(march_task(model, **asked)))]


def _dataset(rows: Sequence[Row], title: str) -> xr.Dataset:
    words = {
        "case_name": ("name", "case and closed form"),
        "case_method": ("method", "method"),
        "case_relation": ("relation", "closed form of time and parameters"),
        "case_observable": ("observable", "what is compared"),
        "case_where": ("where", "where it is compared"),
        "case_norm": ("norm", "norm of the residual"),
        "case_units": ("units", "unit of residual and bound"),
        "case_bound_rule": ("rule", "how the bound is derived"),
        "case_note": ("note", "why a case was refused, or what was missing"),
        "case_run": ("run", "content digest of the run"),
    }
    variables: dict[str, Any] = {
        name: ((CASE,), np.array([getattr(row, key) for row in rows]), about("1", long_name, ROLE))
        for name, (key, long_name) in words.items()
    }
    numbers = about("1", "", ROLE) | {"comment": "in the unit that case_units names"}
    variables |= {
        "case_stage": (
            (CASE,),
            np.array([row.stage for row in rows]),
            about("1", "stage of the ledger; 0 of a model's own closed forms", ROLE),
        ),
        "residual": (
            (CASE,),
            np.array([row.residual for row in rows]),
            numbers | {"long_name": "largest difference from the closed form"},
        ),
        "bound": ((CASE,), np.array([row.bound for row in rows]), numbers | {"long_name": "the most that it may be"}),
        RESIDUAL_SCALE: ((CASE,), np.array([row.scale for row in rows]), numbers | {"long_name": SCALE_RULE}),
        SCALED_RESIDUAL: (
            (CASE,),
            over(*np.array([(row.residual, row.scale) for row in rows]).reshape(-1, 2).T),
            about("1", "residual over residual_scale", SCALED) | {"scale_rule": SCALE_RULE},
        ),
        "verdict": (
            (CASE,),
            np.array([row.verdict for row in rows], np.int8),
            about("1", "what became of the case", "flag") | flags(dict(enumerate(VERDICTS))),
        ),
    }
    runs = [digest for digest in dict.fromkeys(row.run for row in rows) if digest]
    return exhibit("ledger", title, runs, variables, {})


def lines_of(ledger: xr.Dataset) -> Iterator[str]:
    """Describe a ledger line by line: each failed case, and how many passed."""
    words = words_of(ledger["verdict"])
    for k, word in enumerate(words):
        entry = {
            name: str(ledger[f"case_{name}"][k].item())
            for name in ("name", "method", "observable", "where", "units", "note")
        }
        if word == "failed":
            residual, bound, scale, over_scale = (
                float(ledger[name][k]) for name in ("residual", "bound", RESIDUAL_SCALE, SCALED_RESIDUAL)
            )
            numbers = f"residual {residual:.3g} {entry['units']}, bound {bound:.3g} {entry['units']}"
            numbers += f", scaled {over_scale:.3g} by {scale:.3g} {entry['units']}" if np.isfinite(scale) else ""
            yield (
                f"failed    {entry['name']} by {entry['method']}: {entry['observable']}, {entry['where']}:"
                f" {numbers}{'; ' if entry['note'] else ''}{entry['note']}"
            )
        elif word == "refused" and not int(ledger["case_stage"][k]):
            yield f"refused   {entry['name']} by {entry['method']}: {entry['note']}"
    counts = ", ".join(f"{words.count(word)} {word}" for word in VERDICTS)
    methods = dict.fromkeys(str(entry) for entry in ledger["case_method"].values)
    yield f"ledger    {len(words)} cases of {len(methods)} methods: {counts}"

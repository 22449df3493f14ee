"""The validation ledger: runs compared with closed forms, in the order that reveals faults soonest.

A motion without a closed form is compared with proven bounds, to within the error that a method's order promises.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.evidence.enclosing.enclosure import COMPLETED, enclosure_request
from xdynamics.evidence.kept_results import Keep
from xdynamics.evidence.stage_tasks import Task, remembered, setting_words
from xdynamics.evidence.stages import Stage
from xdynamics.evidence.validating.case_runs import NEAR, ORDER_AT_MOST, CaseRuns, times_in_words
from xdynamics.evidence.validating.impacts import checks_of
from xdynamics.evidence.validating.ledger_rows import MOST_ALONE, ROWS, LedgerRow, ledger_dataset, of_worst
from xdynamics.expressions import text_of
from xdynamics.faults import InputError
from xdynamics.kernels.layout import layout_of
from xdynamics.march.configuration import rerun
from xdynamics.march.outcomes import GOOD
from xdynamics.methods import METHODS, unknown_method
from xdynamics.model import Model, check_model
from xdynamics.model.parts import Validation
from xdynamics.model.statement import ORDER
from xdynamics.record import unfold
from xdynamics.record.provenance import xdynamics_version
from xdynamics.record.unfolding import get_column
from xdynamics.schema import AT_TIME, bounds_of
from xdynamics.shapes.blocks import Block

if TYPE_CHECKING:
    import xarray as xr

Rows = NDArray[np.int64]
Floats = NDArray[np.float64]

RELATION = "proven bounds"
PARTS = 8  # of the span of a run, at whose ends it is compared: at one time alone an error may pass zero


def rows_of_bounds(model: Model, method: str, prefix: str, stage: int) -> list[LedgerRow]:
    """Return the lines as far as they are known before anything is marched or proven: of many elements one together."""
    where, norm = f"accepted states at eighths of the time to {model.run.get('until', 'the end')}", "largest distance"
    names: list[tuple[str, int]] = []
    for block in layout_of(model).used.blocks:
        names += [(block.name, block.size)] if block.size > MOST_ALONE else [(name, 1) for name in block.elements()]
    row = LedgerRow("", method, stage, RELATION, "", where, ORDER, norm=f"{norm} from the bounds")
    return [replace(row, name=f"{prefix}{name}", observable=name, elements=size) for name, size in names]


def beside_bounds(runs: CaseRuns, prefix: str, stage: int) -> Iterator[LedgerRow]:
    """Yield a line for each coordinate, velocity and state of a model's run, or the worst of many elements of one.

    The bound is that of `order`: how far the run with twice the step is outside, over 2**(p - 1/2), and rounding.
    """
    rows = rows_of_bounds(runs.model, runs.method.name, prefix, stage)
    if runs.refused:
        yield from (replace(row, note=f"the method refuses: {'; '.join(runs.refused)}") for row in rows)
        return
    start = float(runs.model.statement.initial["t"].si)
    times = [start + (runs.end - start) * k / PARTS for k in range(1, PARTS)]
    tube: xr.Dataset = remembered(enclosure_request(runs.model, at=[*times, runs.end]).task())
    if tube.attrs["outcome"] != COMPLETED:
        yield from (replace(row, note=str(tube.attrs["outcome_text"])) for row in rows)
        return
    yield from (_bounded_row(row, runs, tube) for row in rows)


def _bounded_row(row: LedgerRow, runs: CaseRuns, tube: xr.Dataset) -> LedgerRow:
    """Return a line with its residual, bound and scale."""
    run, name = runs.run, row.observable
    row = replace(row, units=str(get_column(run, name).attrs["units"]), run=runs.digest)
    if run.attrs["run_outcome"] not in GOOD or float(run["time"][-1]) != runs.end:
        why = f"the run ended before: {run.attrs['run_outcome_text']}"
        return replace(row, residual=np.inf, bound=0.0, note=why)
    common = np.flatnonzero((_rows_at(run, tube) >= 0) & (_rows_at(runs.coarse, tube) >= 0))
    values, high = get_column(run, name).values, get_column(tube, bounds_of(name)[1]).values
    largest_value, scale = (np.max(np.abs(numbers), axis=0) for numbers in (values, high))
    halved = _distance_outside(runs.coarse, name, tube, common) / runs.by_order
    bound = np.minimum(halved, ORDER_AT_MOST * largest_value) + runs.rounding_of(name)
    block = Block.from_shapes(name, "", runs.model.shapes)
    return of_worst(row, block, _distance_outside(run, name, tube, common), bound, scale)


def _rows_at(run: xr.Dataset, tube: xr.Dataset) -> Rows:
    """Return the rows of a run that are at the times of a tube; -1 where it has none."""
    accepted, times = run["time"].values, tube[AT_TIME].values
    near = NEAR * (accepted[-1] - accepted[0])
    rows = np.searchsorted(accepted, times + near, side="right") - 1
    return np.where(np.abs(accepted[rows] - times) <= near, rows, -1)


def _distance_outside(run: xr.Dataset, name: str, tube: xr.Dataset, common: Rows) -> Floats:
    """Return the largest distance of each element of a run from the bounds, at some of their times; 0 within."""
    values = get_column(run, name).values[_rows_at(run, tube)[common]]
    low, high = (get_column(tube, bound).values[common] for bound in bounds_of(name))
    distances: Floats = np.max(np.maximum(np.maximum(low - values, values - high), 0.0), axis=0)
    return distances


CASES = Path(__file__).with_name("cases")
EXACT_CASES = "validation ledger: exact cases"  # title
OF_IMPACTS = {"impact": 5}  # lines of the law of impacts of the ledger's own cases
OF_BOUNDS = ("proven_motion",)  # those that are compared with proven bounds


def validate(
    methods: Sequence[str] | str | Model | None = None,
    model: Model | None = None,
    *,
    step: str | float | None = None,
    until: str | float | None = None,
    rtol: float | None = None,
    occurrences: int | None = None,
    proven: bool = False,
    keep: str | Path | None = None,
    compute: bool = True,
) -> xr.Dataset:
    """Compare methods with exact cases, or a model with its own closed forms, the law of its contacts, and proven bounds.

    Parameters
    ----------
    methods : sequence of str, optional
        Names of methods; by default all, or with a model the one of its `[run]`.
    model : Model, optional
        A model with closed forms, ``[validation.<name>]``; by default the ledger's own cases: zero force, constant
        acceleration, linear drag, linear oscillator, a long oscillation, zero coupling, normal modes alone and
        together, a drive of time, impact, resting contact, dry friction, unit scaling, a motion within proven bounds.
    step, until, rtol : str or float, optional
        With which a model is marched in the place of what its `[run]` says; a step in the place of a tolerance too.
    occurrences : int, optional
        How many relations of impacts to list of a model with contacts; where a run has fewer they are refused. By
        default as many as it has.
    proven : bool
        Whether to compare the last values of a model's run, with a fixed step, with bounds that `enclose` proves.
    keep : str or Path, optional
        A folder in which the lines of each case are kept as soon as they are known, or ``"s3://bucket/folder"``: the
        same call continues a ledger that was interrupted.
    compute : bool
        Whether to march at once. If False, the Dataset has dask arrays, with one task for each case and method. A model
        with contacts needs `occurrences` then.

    Returns
    -------
    xarray.Dataset
        Along `case`, stage by stage: `case_name`, `case_method`, `case_stage`, `case_relation` (the closed form),
        `case_observable`, `case_elements` (over 100 elements of one
        quantity are one case; `case_worst_element` is the one whose residual is the largest part of its bound,
        `case_elements_failed` says how many are above theirs), `case_where` (times, or an event), `case_norm`, `residual` and `bound` (in `case_units`),
        of the bound `bound_closed_form` and `bound_start` (below), `scaled_residual` over `residual_scale` (the largest expected size, in `case_units`; one expected value may be
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
    `unscaled`: rounding, compared with the same march in SI units. Each but the last, if it is not given, has two more
    parts for the rounding of expressions, which near a zero of a sine is as large as near its summit: what the closed
    form is off from itself with 31 digits (cross products, and values across a jump or a pole, left out), and what the
    expressions of `[initial]` are, of which another march tells how far it has come at the end.

    Examples
    --------
    >>> from xdynamics.record.flag_words import words_of_flag
    >>> found = validate(["velocity_verlet"])
    >>> sorted({*words_of_flag(found.verdict)})
    ['passed', 'refused']
    """
    if isinstance(methods, Model) and model is None:
        methods, model = None, methods
    names = _method_names(methods, model, occurrences)
    marched = {"step": step, "until": until, "rtol": rtol}
    if model is not None:
        model = rerun(model, **marched)
    elif supplied_names := [name for name, value in marched.items() if value is not None]:
        raise InputError(
            f"{' and '.join(supplied_names)} {'is' if len(supplied_names) == 1 else 'are'} for a model, and none is given: the ledger's own cases have their own"
        )
    cases = _ledger_cases(names) if model is None else _model_cases(model, names, occurrences, proven=proven is True)
    title = EXACT_CASES if model is None else f"validation of {model.name}"
    return ledger_stage(cases, title, Keep.of(keep)).result(compute=compute)


def _method_names(methods: Any, model: Any, occurrences: Any) -> list[str] | None:
    """Check the arguments of `validate`, and return the names of methods, if there are any."""
    if methods is not None and not isinstance(methods, str | Sequence):
        raise InputError(f"methods is {str(methods)[:40]!r}, needs names of methods")
    if model is not None:
        check_model(model)
    if occurrences is not None and (type(occurrences) is not int or occurrences < 0):
        raise InputError(f"occurrences is {occurrences!r}, needs a non-negative whole number")
    names = [methods] if isinstance(methods, str) else None if methods is None else list(methods)
    return None if names is None else _known_methods(names)


def _known_methods(names: list[str]) -> list[str]:
    """Return names of methods, all of which there are."""
    for name in names:
        if name not in METHODS:
            raise InputError(f"{unknown_method(name, METHODS)}there are {', '.join(METHODS)}")
    return names


def _ledger_cases(methods: Sequence[str] | None) -> list[Case]:
    """Return the ledger's own cases by methods."""
    return [
        Case(model, method, stage, f"{name}.", OF_IMPACTS.get(name, 0), proven=name in OF_BOUNDS)
        for stage, (name, model) in enumerate(_own_cases(), 1)
        for method in methods or METHODS
    ]


def _model_cases(model: Model, methods: Sequence[str] | None, occurrences: int | None, *, proven: bool) -> list[Case]:
    """Return the cases of a model by methods.

    Raises
    ------
    InputError
        If it has neither a closed form nor contacts, or no method that is known.
    """
    if not (model.elements.validation or model.elements.contacts or proven):
        raise InputError(
            f"model '{model.name}' has no closed form, and no contacts; write one as [validation.<name>] with"
            " expression, bound, or compare it with proven bounds: proven=True (--proven)"
        )
    chosen_methods = methods or (_known_methods([str(model.run["method"])]) if "method" in model.run else [])
    if not chosen_methods:
        raise InputError(f"model '{model.name}' has no method in its [run]; give methods=[…]")
    return [Case(model, method, occurrences=occurrences, proven=proven) for method in chosen_methods]


def ledger_stage(cases: Sequence[Case], title: str, keep: Keep | None = None) -> Stage:
    """Return a ledger, one task for each case and method."""
    tasks = tuple(case.task if keep is None else keep.task(case.task, ROWS) for case in cases)
    task = Task.of("ledger", partial(_ledger_of_cases, title), tasks)
    return Stage(
        task, lambda: _ledger_of_cases(title, *(case.blank() for case in cases)), ("case_method", "case_stage")
    )


def own_ledger(methods: Sequence[str], keep: Keep | None = None) -> Stage:
    """Return the ledger of exact cases by methods."""
    return ledger_stage(_ledger_cases(methods), EXACT_CASES, keep)


def _ledger_of_cases(title: str, *cases: Iterable[LedgerRow]) -> xr.Dataset:
    return ledger_dataset([row for rows in cases for row in rows], title)


@lru_cache(maxsize=1)
def _own_cases() -> list[tuple[str, Model]]:
    """Read the ledger's own cases, in their order."""
    return [(path.stem.partition("_")[2], Model.from_toml(path)) for path in sorted(CASES.glob("*.toml"))]


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
    occurrences : int, optional
        How many lines of the law of impacts there are where the method locates them; None for as many as the run has.
    proven : bool
        Whether its end is compared with proven bounds.
    """

    model: Model
    method: str
    stage: int = 0
    prefix: str = ""
    occurrences: int | None = None
    proven: bool = False

    @property
    def task(self) -> Task:
        """The task that marches it, and gives the lines of the ledger."""
        march_settings = CaseRuns(self.model, self.method, is_ledger_case=self.stage > 0).march_settings
        words = (
            self.stage,
            self.prefix,
            self.occurrences,
            self.proven,
            self.method,
            self.model.digest,
            setting_words(march_settings),
            xdynamics_version(),
            *(function.digest for function in self.model.python_functions),
        )
        return Task.of("case", partial(_case_rows, self), (), *words)

    def rows(self) -> Iterator[LedgerRow]:
        """Yield the lines of the ledger, of runs that are marched when they are first needed."""
        runs = CaseRuns(self.model, self.method, is_ledger_case=self.stage > 0)
        for row, case in self._forms():
            why = runs.refusal(case)
            yield replace(row, note=why) if why else runs.complete_row(row, case)
        if self.proven:
            yield from beside_bounds(runs, self.prefix, self.stage)
        if self.model.elements.contacts and (self.occurrences != 0 or self.stage):
            lines = [*_impact_rows(runs, self.prefix, self.stage)]
            missing = (
                [] if self.occurrences is None or self.stage else self._missing_rows(self.occurrences - len(lines))
            )
            yield from [*lines, *missing][: None if self.stage else self.occurrences]

    def blank(self) -> Iterator[LedgerRow]:
        """Yield as many lines, before anything is marched.

        Raises
        ------
        InputError
            If their number is not known.
        """
        if self.occurrences is None and self.model.elements.contacts:
            raise InputError(
                f"how many relations of impacts a run of '{self.model.name}' has is not known before it is computed; give the"
                " number to list, like occurrences=10 (refused where there are fewer), or 0 for none"
            )
        yield from (row for row, _ in self._forms())
        if self.proven:
            yield from rows_of_bounds(self.model, self.method, self.prefix, self.stage)
        if self.model.elements.contacts:
            runs = CaseRuns(self.model, self.method, is_ledger_case=self.stage > 0)
            located = not runs.refused and runs.method.stepper.locates
            yield from self._missing_rows(self.occurrences or 0 if located or not self.stage else 1)

    def _missing_rows(self, count: int) -> list[LedgerRow]:
        """Return ledger rows that stand for relations of impacts which a run does not have."""
        law = next(iter(self.model.elements.contacts.values())).law
        relation, note = f"law of impacts '{law}'", "the run has no further relation of impacts"
        where = "contacts", "every impact", "rounding"
        return [LedgerRow(f"{self.prefix}impacts", self.method, self.stage, relation, *where, note=note)] * max(
            0, count
        )

    def _forms(self) -> Iterator[tuple[LedgerRow, Validation]]:
        """Yield every closed form, with its line as far as it is known."""
        for name, case, elements in self._closed_forms_by_name():
            where = f"at {case.event} {case.occurrence}" if case.event else times_in_words(case, self.model)
            rule = str(case.bound) if isinstance(case.bound, str) else "given"
            relation = text_of(case.expression)
            row = LedgerRow(f"{self.prefix}{name}", self.method, self.stage, relation, case.quantity, where, rule)
            yield replace(row, elements=elements), case

    def _closed_forms_by_name(self) -> Iterator[tuple[str, Validation, int]]:
        """Yield closed forms by their names, and for how many elements each is: of many together, of few one by one."""
        for name, form in self.model.statement.validation.items():
            quantity, event = map(self.model.shapes.internal_name, (form.quantity, form.event))
            block = Block.from_shapes(quantity, "", self.model.shapes)
            if block.size > MOST_ALONE:
                yield name, replace(form, quantity=quantity, event=event), block.size
            else:
                names = block._replace(name=name).elements()
                yield from ((element_name, self.model.elements.validation[element_name], 1) for element_name in names)


def _impact_rows(marched: CaseRuns, prefix: str, stage: int) -> Iterator[LedgerRow]:
    """Yield the lines of the impacts of a model's own run, checked against the law of its contacts."""
    law, method = next(iter(marched.model.elements.contacts.values())).law, marched.method
    row = LedgerRow(
        f"{prefix}impacts", method.name, stage, f"law of impacts '{law}'", "contacts", "every impact", "rounding"
    )
    if marched.refused or not method.stepper.locates:
        why = f"the method refuses: {'; '.join(marched.refused)}" if marched.refused else "the method locates no events"
        yield replace(row, note=why)
        return
    checks = list(checks_of(unfold(marched.run), marched.model))
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
            run=marched.digest,
            norm="largest, measured by its bound",
        )


def _case_rows(case: Case) -> list[LedgerRow]:
    return [*case.rows()]

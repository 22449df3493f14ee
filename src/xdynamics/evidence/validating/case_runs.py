"""The runs of one ledger case by one method: residuals from closed forms, and the bounds of these residuals.

Rounding of a closed form and of the start is measured by a second evaluation with 31 digits.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import archive
from xdynamics.elementary.bounds import EPS
from xdynamics.evidence.evidence_dataset import event_rows_by_name, scale_of
from xdynamics.evidence.observables import is_observable, observe
from xdynamics.evidence.observed_quantities import parameters_read_by
from xdynamics.evidence.stage_tasks import march_task, remembered
from xdynamics.evidence.validating.ledger_rows import MOST_ALONE, LedgerRow, of_worst
from xdynamics.expressions import Call, Node, dimension_of, free_names, text_of
from xdynamics.expressions.tree import every
from xdynamics.faults import InputError
from xdynamics.march.outcomes import GOOD
from xdynamics.methods import METHODS
from xdynamics.methods.steppers import DIFFERENCES
from xdynamics.model import Model
from xdynamics.model.element_numbers import ElementNumbers
from xdynamics.model.elementwise import in_si
from xdynamics.model.kinks import JUMPING
from xdynamics.model.motion import constants, evaluate_over_states
from xdynamics.model.parts import Validation
from xdynamics.model.statement import BAND, ORDER, UNSCALED, exact_from
from xdynamics.record.flag_words import time_unit_of
from xdynamics.record.named_rows import rows_named
from xdynamics.record.unfolding import find_column, get_column, whole_of
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.schema import AT, STEPS, acceleration, velocity
from xdynamics.shapes import Extent, at_element
from xdynamics.shapes.blocks import Block, Blocks
from xdynamics.shapes.evaluation import evaluate_elements, rounding_errors
from xdynamics.shapes.naming import join_element_name, split_element_name
from xdynamics.units import Quantity, parse_unit, time_in, unit_suffix

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

MAGNIFIED = 2.0**20  # times its rounding, by which a start is moved: what a march makes of it stands out of its own
NEAR_JUMP = 2.0**-26  # of the largest value: what is further off by rounding is on another side of a jump
_APART = frozenset((*JUMPING, "atan2"))  # functions of which rounding may take another side
PIECE = 1 << 18  # numbers of a closed form that are evaluated together: each has dozens of intermediate results


def start_without_rounding(model: Model) -> Model | None:
    """Return a model whose start is moved from its own to that of its expressions, `MAGNIFIED` times as far.

    None where no start is given by an expression, or rounding did nothing to any.
    """
    elements = model.elements
    if not any(values.tree is not None for values in model.statement.starting.values()):
        return None
    errors = ElementNumbers(model.statement, model.shapes).rounding_at_start(
        elements.statement.parameters, elements.statement.initial
    )
    initial = {}
    for name, rounding_error in errors.items():
        block = Blocks.from_names("", [name], model.shapes)
        start = in_si(elements.statement.initial, block).reshape(rounding_error.shape)
        tree = model.statement.starting[name].tree
        error = (
            rounding_error
            if tree is None
            else without_jumps(tree, rounding_error, float(np.max(np.abs(start), initial=0.0)))
        )
        if error.any():
            moved_start = start - MAGNIFIED * error
            unit = elements.statement.initial[block.blocks[0].first].unit
            initial[name] = {"unit": unit.text, "value": (moved_start / float(unit.factor)).tolist()}
    return model.replace(initial=initial) if initial else None


def without_jumps(tree: Node, errors: Any, size: float) -> Any:
    """Return rounding errors of an expression, with 0 where rounding crossed a jump or a pole.

    Parameters
    ----------
    tree : Node
    errors : ndarray
    size : float
        The largest value that is expected.
    """
    jumps = any(isinstance(part, Call) and part.function in _APART for part in every(tree))
    return np.where(np.abs(errors) <= (NEAR_JUMP if jumps else 2.0) * size, errors, 0.0)


def rounding_of_form(
    model: Model, case: Validation, block: Block, times: Floats, exact_values: Floats, size: float
) -> Any:
    """Return the most that rounding did to a closed form at some times, of each element, in SI units.

    Parameters
    ----------
    model : Model
    case : Validation
    block : Block
        The elements; without dimensions there is one number.
    times : ndarray, shape (k,), s
    exact_values : ndarray, shape (k, ...)
        The closed form in floats.
    size : float
        The largest value of the quantity along the run.
    """
    if block.dims:
        tree = model.expanded(case.expression)
        input_values = parameters_read_by(model, [tree]) or constants(model)
    else:
        tree, input_values = model.elements.expanded(case.expression), constants(model)
        input_values = {name: input_values[name] for name in free_names(tree) & input_values.keys()}
    if free_names(tree) - input_values.keys() - {"t"}:
        return 0.0
    shapes, count = model.shapes, max(1, PIECE // block.size)
    largest_error: Any = 0.0
    for first in range(0, len(times), count):
        part = slice(first, first + count)
        part_times = times[part]
        part_shapes = replace(
            shapes, dims={**shapes.dims, "t": (AT,)}, extents={**shapes.extents, AT: Extent(AT, len(part_times))}
        )
        values = np.moveaxis(exact_values[part], 0, -1)
        errors = rounding_errors(tree, (*block.dims, AT), {**input_values, "t": part_times}, part_shapes, values, AT)
        errors = without_jumps(tree, errors, size)
        largest_error = np.maximum(largest_error, np.max(np.abs(errors), axis=-1))
    return largest_error


SLACK = 0.5  # of an order, by which halved steps may fall short: a defect costs a whole order
FINER = {1: 1 / 20, 2: 1 / 4, 3: 1 / 2}  # times the step of a case, by the order of a method
NEAR = 1e-12  # of the span: accepted times that agree but for rounding
TENTH = 10  # a band is compared between the first and the last tenth
BAND_AT_MOST, ORDER_AT_MOST = 0.2, 0.5  # of the largest value, the most that a bound may be
WIDER = 1.5  # times its first part, the most that a band may be in its last one


class CaseRuns:
    """The runs of one model by one method, each marched when first needed; those that other stages need too once."""

    def __init__(self, model: Model, method: str, *, is_ledger_case: bool) -> None:
        self.model, self.method = model, METHODS[method]
        refused, by_differences = (self.method.refusals(model, by_differences=allowed) for allowed in (False, True))
        self.refused = by_differences
        self.march_settings: dict[str, Any] = {"method": method}
        if refused and not by_differences:
            self.march_settings["jacobian"] = DIFFERENCES
        self._observations: list[tuple[xr.Dataset, tuple[float, ...], dict[str, Floats]]] = []
        if is_ledger_case:  # the ledger's cases: with steps so small that a low order is accurate too
            self.march_settings["step"] = time_in(model.time_unit, model.run["step"], "step") * FINER.get(
                self.method.order, 1.0
            )

    def refusal(self, case: Validation) -> str:
        """Return why a case does not apply to the method; empty if it does."""
        if self.refused:
            return f"the method refuses: {'; '.join(self.refused)}"
        if case.bound == BAND and not self.method.symplectic:
            return "the method is not symplectic: it claims no band"
        if case.event and not self.method.stepper.locates:
            return "the method locates no events"
        return ""

    def marched(self, model: Model | None = None, **settings: Any) -> xr.Dataset:
        """March the model, or another one; a quantity with dimensions is one variable."""
        return whole_of(remembered(march_task(model or self.model, **settings)))

    @cached_property
    def run(self) -> xr.Dataset:
        """The run with the steps of the model's `[run]`."""
        return self.marched(**self.march_settings)

    @cached_property
    def digest(self) -> str:
        """The content digest of the run."""
        return archive.digest_of_run(self.run)

    @property
    def end(self) -> float:
        """The time up to which the model's `[run]` asks to march, s."""
        return time_in(self.model.time_unit, self.model.run["until"], "until")

    @property
    def by_order(self) -> float:
        """The least factor by which halving the step reduces an error."""
        return float(2.0 ** (self.method.order - SLACK))

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
        return self.marched(**self.march_settings | {"step": 2.0 * float(self.run.attrs["solver_step"])})

    @cached_property
    def unscaled(self) -> xr.Dataset:
        """The run without scales."""
        settings = {key: value for key, value in self.model.run.items() if key != "scales"}
        return self.marched(**settings | self.march_settings | {"scales": {}})

    @cached_property
    def moved_start_run(self) -> xr.Dataset | None:
        """The run from a start without rounding, by `MAGNIFIED` times as much; None where that is none, or is refused."""
        try:
            model = start_without_rounding(self.model)
            return None if model is None else self.marched(model, **self.march_settings)
        except InputError:  # a body at rest on a floor may be inside it by then
            return None

    def complete_row(self, row: LedgerRow, case: Validation) -> LedgerRow:
        """Return a line with its residual, bound and scale: of a quantity with dimensions those of its worst element.

        Raises
        ------
        InputError
            If the closed form or the run does not fit the case.
        """
        run = self.run
        row = replace(row, units=_quantity_unit(run, case), run=self.digest)
        self.check_dimension(case, row.units)
        end = float(run.variables["time"][-1])
        if run.attrs["run_outcome"] not in GOOD or max(case.times, default=end) > end:
            why = f"the run ended before: {run.attrs['run_outcome_text']}"
            return replace(row, residual=np.inf, bound=0.0, note=why)
        if not case.event and not case.times:
            row = replace(
                row,
                where=(
                    f"{'the last tenth of ' * (case.bound == BAND)}accepted states up to"
                    f" {end:.9g}{unit_suffix(time_unit_of(run))}"
                ),
            )
        try:
            residual, expected = self.residual(run, case), self.expected(run, case)
            if case.bound == BAND:
                part = max(1, len(residual) // TENTH)
                band_limit = BAND_AT_MOST * _largest_by_element(get_column(run, case.quantity).values)
                bound = np.minimum(WIDER * np.max(residual[:part], axis=0), band_limit) + self.rounding(case)
                residual, expected = residual[-part:], expected[-part:]
            else:
                bound = self.bound(case)
            of_form, of_start = self.rounding_of_expressions(case)
        except LookupError as error:
            return replace(row, residual=np.inf, bound=0.0, note=str(error.args[0]))
        if case.bound == UNSCALED:
            scaled_values, unscaled_values = (
                get_column(record, case.quantity).values for record in (run, self.unscaled)
            )
            if scaled_values.shape != unscaled_values.shape:
                return replace(
                    row,
                    residual=np.inf,
                    bound=bound,
                    note=f"{len(scaled_values)} rows, unscaled {len(unscaled_values)}",
                )
            residual, expected = np.abs(scaled_values - unscaled_values), unscaled_values
        scale = scale_of(expected, residual)  # where 0 is expected, the residual is the computed value
        bound = bound + of_form + of_start
        return of_worst(row, self._element_block(case), np.max(residual, axis=0), bound, scale, of_form, of_start)

    def _element_block(self, case: Validation) -> Block:
        """Return the elements that are compared together: of one element, or without dimensions, that alone."""
        return Block.from_shapes(case.quantity, "", self.model.shapes)

    def check_dimension(self, case: Validation, units: str) -> None:
        """Refuse a closed form in another unit than the quantity it is compared with.

        Raises
        ------
        InputError
            Naming both.
        """
        first_expression = at_element(
            case.expression, dict.fromkeys(self._element_block(case).dims, 0), self.model.shapes
        )
        dimension = dimension_of(self.model.elements.expanded(first_expression), self.model.elements.dimensions)
        if dimension != parse_unit(units).dimension:
            raise InputError(
                f"closed form {text_of(case.expression)!r} has units '{dimension}', needs '{units}' of"
                f" '{case.quantity}'"
            )

    def bound(self, case: Validation) -> Any:
        """Return the most that a residual may be, of each element, in the record's unit."""
        if isinstance(case.bound, Quantity):
            return float(case.bound.si / parse_unit(_quantity_unit(self.run, case)).factor)
        if case.bound == UNSCALED:
            return 2.0 * self.rounding(case)
        by_order = case.bound == ORDER or exact_from(case.bound) > self.method.order
        if not by_order:
            return self.rounding(case)
        order_limit = ORDER_AT_MOST * _largest_by_element(self.true(self.run, case))
        halved = np.max(self.residual(self.coarse, case), axis=0) / self.by_order
        return np.minimum(halved, order_limit) + self.rounding(case)

    def rounding_of(self, name: str) -> Any:
        """Return a bound of the rounding error of a quantity, of each element."""
        run = self.run
        steps, span = run.sizes[STEPS], float(run.variables["time"][-1] - run.variables["time"][0])
        size = _largest_by_element(get_column(run, "time" if name == "t" else name).values)
        if split_element_name(name)[0] in self.model.statement.coordinates:
            size = size + span * _largest_by_element(get_column(run, velocity(name)).values)
        return (self.method.evaluations + 2) * steps * EPS * size

    def rounding(self, case: Validation) -> Any:
        """Return a bound of the rounding error of each element, plus the uncertainty of location at an event."""
        run, name, error = self.run, case.quantity, self.rounding_of(case.quantity)
        if case.event:
            k, row = _event_index_and_row(run, case)
            uncertainty = float(run.variables["event_time_uncertainty"][k])
            rate = self._rate_of(name)
            if name == "t":
                error = error + uncertainty
            elif rate:
                error = error + uncertainty * np.abs(get_column(run, rate).values[row - 1])
        return error

    def rounding_of_expressions(self, case: Validation) -> tuple[Any, Any]:
        """Return each element's rounding error of a closed form, and the march's response to that of the start.

        The second is found by another march, from a start that is moved by a multiple of its rounding. Where steps or
        events of that are others, it is left out, as both are of bounds that are given or that know of no closed form.
        """
        if isinstance(case.bound, Quantity) or case.bound == UNSCALED:
            return 0.0, 0.0
        run, factor = self.run, float(parse_unit(_quantity_unit(self.run, case)).factor)
        times = self._comparison_times(run, case)
        size = factor * float(
            np.max(_largest_by_element(get_column(run, "time" if case.quantity == "t" else case.quantity).values))
        )
        exact = self._closed_form_values(case, times)
        of_form = rounding_of_form(self.model, case, self._element_block(case), times, exact, size) / factor
        if self.moved_start_run is None or self.moved_start_run.attrs["run_outcome"] not in GOOD:
            return of_form, 0.0
        kinds, moved_kinds = (record.variables["row_kind"].values for record in (run, self.moved_start_run))
        if not np.array_equal(kinds, moved_kinds):
            return of_form, 0.0
        try:
            deviation, moved_deviation = (self._deviation(record, case) for record in (run, self.moved_start_run))
        except LookupError:
            return of_form, 0.0
        return of_form, _largest_by_element(
            moved_deviation - deviation
        ) / MAGNIFIED if deviation.shape == moved_deviation.shape else 0.0

    def _rate_of(self, name: str) -> str:
        """Return the recorded rate of a coordinate or velocity, or of an element of one; of others nothing."""
        quantity_name, labels = split_element_name(name)
        coordinates = self.model.statement.coordinates
        rates = {coordinate: velocity(coordinate) for coordinate in coordinates} | {
            velocity(coordinate): acceleration(coordinate) for coordinate in coordinates
        }
        return join_element_name(rates[quantity_name], labels) if quantity_name in rates else ""

    def residual(self, run: xr.Dataset, case: Validation) -> Floats:
        """Return absolute differences from the closed form, in the record's unit.

        Raises
        ------
        LookupError
            If the event was not met that often.
        """
        return np.abs(self._deviation(run, case))

    def _deviation(self, run: xr.Dataset, case: Validation) -> Floats:
        """Return differences from the closed form, in the record's unit."""
        name, times = case.quantity, self._comparison_times(run, case)
        if case.event:
            values = times if name == "t" else get_column(run, name).values[_event_index_and_row(run, case)[1] :][:1]
        elif case.times:
            values = self._values_at(run, name, times)
        else:
            values = get_column(run, name).values
        return np.asarray(
            values - self._closed_form_values(case, times) / float(parse_unit(_quantity_unit(run, case)).factor)
        )

    def _comparison_times(self, run: xr.Dataset, case: Validation) -> Floats:
        """Return the times at which a closed form is compared."""
        if case.event:
            return np.asarray(run.variables["event_time"].values[_event_index_and_row(run, case)[0] :][:1])
        return np.array(case.times) if case.times else np.asarray(run.variables["time"].values)

    def true(self, run: xr.Dataset, case: Validation) -> Floats:
        """Return the closed form at the times of a case, or all along the run, in the record's unit."""
        times = np.array(case.times) if case.times else run.variables["time"].values
        return self._closed_form_values(case, times) / float(parse_unit(_quantity_unit(run, case)).factor)

    def expected(self, run: xr.Dataset, case: Validation) -> Floats:
        """Return the closed form where it is compared, in the record's unit; a time counts from the start."""
        origin = float(run.variables["time"][0]) if case.quantity == "t" else 0.0
        return (
            self._closed_form_values(case, self._comparison_times(run, case))
            / float(parse_unit(_quantity_unit(run, case)).factor)
            - origin
        )

    def _closed_form_values(self, case: Validation, times: Floats) -> Floats:
        """Evaluate a closed form at times: shape (times, ...), SI."""
        block, constant_values = self._element_block(case), constants(self.model)
        if not block.dims:
            tree = self.model.elements.expanded(case.expression)
            return np.broadcast_to(
                evaluate_over_states(self.model, [tree], {"t": times}, constant_values, ())[0], times.shape
            )
        tree, shapes = self.model.expanded(case.expression), self.model.shapes
        dims, extents = {**shapes.dims, "t": (AT,)}, {**shapes.extents, AT: Extent(AT, len(times))}
        input_values = {"t": times, **(parameters_read_by(self.model, [tree]) or constant_values)}
        element_values = evaluate_elements(
            tree, (*block.dims, AT), input_values, replace(shapes, dims=dims, extents=extents), AT
        )
        return np.moveaxis(element_values, -1, 0)

    def _observed_values(self, run: xr.Dataset, name: str, times: tuple[float, ...]) -> Floats:
        """Return a quantity at times; the quantities of all closed forms at these times are evaluated at once."""
        for observed_run, observed_times, values in self._observations:
            if observed_run is run and observed_times == times and name in values:
                return values[name]
        cases = self.model.statement.validation.values()
        case_names = [
            element_name for case in cases if case.times == times for element_name in self._observed_together(case)
        ]
        names = dict.fromkeys([name, *(word for word in case_names if is_observable(self.model, word))])
        observations = observe(run, self.model, [*names], np.array(times))
        self._observations.append((run, times, {observed: values for observed, (values, _) in observations.items()}))
        return observations[name][0]

    def _observed_together(self, case: Validation) -> Iterable[str]:
        """Return the names to evaluate for a closed form: its quantity if that is large, else its elements."""
        block = Block.from_shapes(self.model.shapes.internal_name(case.quantity), "", self.model.shapes)
        return [block.name] if block.size > MOST_ALONE and is_observable(self.model, block.name) else block.elements()

    def _values_at(self, run: xr.Dataset, name: str, times: Floats) -> Floats:
        """Return a quantity at times; quantities that are not observables are known at accepted times only."""
        if is_observable(self.model, name):
            return self._observed_values(run, name, tuple(times.tolist()))
        block = Block.from_shapes(name, "", self.model.shapes)
        if block.dims and is_observable(self.model, block.first):
            of_elements = [
                self._observed_values(run, element_name, tuple(times.tolist())) for element_name in block.elements()
            ]
            return np.stack(of_elements, axis=-1).reshape(-1, *block.shape)
        accepted = run.variables["time"].values
        rows = np.searchsorted(accepted, times + NEAR * (accepted[-1] - accepted[0]), side="right") - 1
        if (np.abs(accepted[rows] - times) > NEAR * (accepted[-1] - accepted[0])).any():
            raise InputError(f"'{name}' is known at accepted states alone; give times that are, or leave them out")
        values: Floats = get_column(run, name).values[rows]
        return values


def _largest_by_element(values: Floats) -> Any:
    """Return the largest size of each element along the first axis."""
    return np.max(np.abs(values), axis=0)


def _event_index_and_row(run: xr.Dataset, case: Validation) -> tuple[int, int]:
    """Return the index of an event, and the row of the state after it."""
    occurrences = event_rows_by_name(run).get(case.event, ())
    if len(occurrences) < case.occurrence:
        raise LookupError(f"{case.event} was met {len(occurrences)} times")
    k = int(occurrences[case.occurrence - 1])
    return k, int(rows_named(run, "event_row_after")[k])


def _quantity_unit(run: xr.Dataset, case: Validation) -> str:
    """Return the unit of a quantity in a record."""
    if case.quantity == "t":
        return time_unit_of(run).text
    variable = find_column(run, case.quantity)
    if variable is None or variable.dims[:1] != (STEPS,):
        raise InputError(
            f"quantity '{case.quantity}' is not recorded along '{STEPS}'; name one by quantity = …; without"
            " that key the name of the table is taken for it"
        )
    return str(variable.attrs["units"])


def times_in_words(case: Validation, model: Model) -> str:
    """Describe the times at which a closed form is compared."""
    if case.times:
        return "t = " + ", ".join(f"{time:.9g}" for time in case.times) + unit_suffix(model.time_unit)
    prefix = "the last tenth of " if case.bound == BAND else ""
    return f"{prefix}accepted states up to {model.run.get('until', 'the end')}"

"""Steps of a record repeated, but shortened to end at any time within them: from the record alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import record, schema
from xdynamics.dynamics.recorded_steps import (
    AcceptedTimes,
    RowLinks,
    blockwise,
    check_rows_follow,
    check_steps_meet,
    links_read,
    locate_steps,
    model_of_record,
    row_links,
    slack,
    stack_columns,
    step_columns,
    values_along,
)
from xdynamics.elementary import kept_set
from xdynamics.elementary.arrays import flattened_rows
from xdynamics.faults import InputError
from xdynamics.kernels import Law, Layout, law_of
from xdynamics.kernels.law import FORCE_SAMPLES, ROW_ENERGIES
from xdynamics.march import Settings
from xdynamics.march.dense_output import past_of, posed_inside, states_within
from xdynamics.march.initial_run import rest_of_time
from xdynamics.march.memory import LARGE
from xdynamics.march.past import Past
from xdynamics.march.settings import ENDS
from xdynamics.methods import METHODS, method_of
from xdynamics.methods.scheme import DOUBLE_DOUBLE, PLAIN, REINTEGRATE
from xdynamics.methods.steppers import EXACT
from xdynamics.model import Model
from xdynamics.model.reactions import reactions
from xdynamics.model.switches import STEPPED_OVER
from xdynamics.record.arguments import precision_of, recorded_scales
from xdynamics.record.folding import is_chunked, model_dimensions
from xdynamics.record.provenance import interpolation_attributes, interpolation_orders
from xdynamics.record.run_columns import state_names
from xdynamics.record.schemas import RARE, log_description, rows_apart
from xdynamics.record.unfolding import shapes_of
from xdynamics.runtime.lazy_imports import cached_property, load_dask_whole
from xdynamics.schema import AT, AT_TIME, LEFT_OVER, STEPS
from xdynamics.shapes.blocks import Block
from xdynamics.units import unit_suffix

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
PIECE = 1 << 21  # numbers that are found together
ROUTE = (
    "its distance from two steps of the run's method from the archived state before to the wanted time, extrapolated"
    " with one: how far it is from the solution through that state"
)


def sample_in_steps(
    run: xr.Dataset,
    times: Floats,
    *,
    after_event: bool,
    rule: str,
    functions: Mapping[str, Callable[..., float]] | None,
    model: Model | None = None,
) -> xr.Dataset:
    """Evaluate a run at times within it; see `sample`. Its model is not read again from its text where it is given.

    Raises
    ------
    InputError
        If a time lies outside the run, rows are missing, or the Dataset is not a run record.
    """
    return StepInterpolator.of_run(run, functions, rule, model).states_at(times, after_event=after_event)


@dataclass(frozen=True)
class StepInterpolator:
    """A record's model and method, ready to evaluate states inside its steps."""

    run: xr.Dataset
    functions: Mapping[str, Callable[..., float]]
    rule: str
    cached_model: Model | None = None  # where the record's model is at hand

    @classmethod
    def of_run(cls, run: Any, functions: Any, rule: str, model: Model | None = None) -> StepInterpolator:
        """Check that a Dataset is a complete run record, in the units of its model.

        Raises
        ------
        InputError
            Naming what is missing or differs.
        """
        load_dask_whole()
        record.check_kind(run)
        if rule != REINTEGRATE and precision_of(run.attrs) == DOUBLE_DOUBLE:
            raise InputError(
                f"rule is '{rule}', and the interpolant of a run of precision 'double_double' is of single floats; take"
                f" '{REINTEGRATE}'"
            )
        if run.attrs["solver_method"] not in METHODS:
            raise InputError(f"the record's method '{run.attrs['solver_method']}' is not known to this version")
        if not isinstance(functions, Mapping | None):
            raise InputError(f"functions are {str(functions)[:40]!r}, need a mapping of names to functions")
        interpolator = cls(run, functions or {}, rule, model)
        for quantity in interpolator.quantities:
            name, units = quantity.name, interpolator.model.elements.units[quantity.first].text
            if name not in run.variables:
                record.check_elements(record.whole_of(run), interpolator.model.shapes.parse_element(name)[1])
                remedy = log_description(run.attrs) or "sample the whole record"
                raise InputError(f"the record has no variable '{name}' of its model; {remedy}")
            if run.variables[name].attrs.get("units") != units:
                raise InputError(
                    f"'{name}' is in {run.variables[name].attrs.get('units')!r}, needs '{units}' as it was recorded;"
                    " convert what was sampled"
                )
        return interpolator

    @cached_property
    def model(self) -> Model:
        """The record's model, read from its text where it is not at hand."""
        model = self.cached_model or model_of_record(self.run, self.functions)
        model.require_functions()
        return model

    @cached_property
    def settings(self) -> Settings:
        """Settings of the march, as far as one step needs them."""
        attributes, start = self.run.attrs, self.model.statement.initial["t"].si
        method = method_of(attributes["solver_method"], int(attributes["solver_order"]))
        # the same force samples as in the run, so that its law is compiled already
        samples = attributes.get("solver_force_samples") == "all"
        return Settings(
            method,
            start,
            estimator=str(attributes["solver_estimator"]),
            samples=samples,
            scales=recorded_scales(self.run),
            jacobian=str(attributes.get("solver_jacobian", EXACT)),
            summation=str(attributes.get("solver_summation", PLAIN)),
            switches=str(attributes.get("solver_switches", STEPPED_OVER)),
            math_functions=kept_set(attributes.get("math_functions")),
            precision=precision_of(attributes),
            sliding=str(attributes.get("solver_sliding", ENDS)),
        )

    @cached_property
    def layout(self) -> Layout:
        """The layout of the march's numbers."""
        return self.settings.layout(self.model)

    @cached_property
    def quantities(self) -> tuple[Block, ...]:
        """The variables of the record: quantities with dimensions at once, or elements where the record has these."""
        used = self.layout.used
        return used.blocks if model_dimensions(self.run) else tuple(Block(name, "") for name in used)

    @property
    def takes_quantities(self) -> bool:
        """Whether states can be evaluated from quantities with dimensions: all of their elements are there, in order."""
        sizes, labels = model_dimensions(self.run), shapes_of(self.run).extents
        extents = {extent.name: extent for block in self.layout.used.blocks for extent in block.extents}
        return all(block.name in self.run.variables for block in self.layout.used.blocks) and all(
            sizes.get(dim) == self.run.sizes.get(dim) == extent.size and labels[dim].labels == extent.labels
            for dim, extent in extents.items()
        )

    @cached_property
    def law(self) -> Law:
        """The compiled law: that of the run, or where force samples are large that of one whose log holds states alone."""
        are_large = 8 * self.layout.sample_width * self.settings.scheme.samples >= LARGE
        unread = frozenset({FORCE_SAMPLES, ROW_ENERGIES} if are_large else ())
        return law_of(self.layout, sampled=self.settings.samples, unread=unread)

    def states_at(self, times: Floats, *, after_event: bool) -> xr.Dataset:
        """Evaluate the run at times within it, as `sample_in_steps` does: for those who ask again and again."""
        return self.dataset(times, *locate_steps(self._times, times, after_event=after_event))

    def values_of(self, states: xr.Dataset, name: str) -> Floats:
        """Return a quantity of the state, or one element of it, at states that were evaluated."""
        state_variables = {str(key): variable for key, variable in states.variables.items()}
        numbers: Floats = np.asarray(self.layout.used.values_of(state_variables, name))
        return numbers

    def errors_of(self, states: xr.Dataset, name: str) -> Floats:
        """Return the error of a quantity of the state, or of one element of it, at states that were evaluated."""
        errors = {block.name: states.variables[schema.error(block.name)] for block in self.quantities}
        numbers: Floats = np.asarray(self.layout.used.values_of(errors, name))
        return numbers

    @cached_property
    def _times(self) -> AcceptedTimes:
        return AcceptedTimes(self.run.variables["time"])

    def dataset(self, times: Floats, rows: NDArray[np.int64], starts: Floats, ends: Floats) -> xr.Dataset:
        """Gather the states of the steps, and evaluate them at times."""
        where = np.stack([times, starts, ends, rows])
        if any(self.run.variables[quantity.name].chunks for quantity in self.quantities):
            state_numbers = blockwise(self._evaluated, where, self._columns(rows), self._height, self._links_later)
        else:
            state_numbers = self._in_pieces(where, rows)
        return self.described(times, rows, state_numbers)

    def _in_pieces(self, where: Floats, rows: NDArray[np.int64]) -> Floats:
        """Evaluate states in pieces, which are written right into the result: no second full array is made."""
        count, max_columns = rows.size, max(1, PIECE // self._height)
        if count <= max_columns:
            return self._evaluated(where, stack_columns(self._columns(rows)), self._links)
        # posed once for all pieces, as this allocates the arrays of a run
        run = posed_inside(self.model, self.settings, self.law, reintegrated=self.rule == REINTEGRATE)
        # in Fortran order a single column is contiguous, and states are written right into it
        state_numbers = np.empty((self._height, count), order="F" if max_columns == 1 else "C")
        for first in range(0, count, max_columns):
            piece = slice(first, first + max_columns)
            columns = stack_columns(self._columns(rows[piece]))
            room = state_numbers[:, piece]
            part = self._evaluated(
                where[:, piece], columns, self._links, run=run, state_room=room if max_columns == 1 else None
            )
            if part is not room:
                room[:] = part
        return state_numbers

    def blank(self, times: Floats) -> xr.Dataset:
        """Return the result of `dataset` at some times, without its values; the times may be unknown, nan."""
        return self.described(times, np.zeros(times.size, np.int64), np.full((self._height, times.size), np.nan))

    @property
    def _height(self) -> int:
        return (2 + self.layout.is_doubled) * self.layout.used.size

    def described(self, times: Floats, rows: NDArray[np.int64], numbers: Any) -> xr.Dataset:
        """Return states and errors at times as a Dataset."""
        import xarray as xr

        # fastpath: xarray would import dask to find out that the numbers are not one of its arrays
        run, variables, size, first = self.run, {}, self.layout.used.size, 0
        for quantity, (name, described, error, error_described) in zip(
            self.quantities, self._descriptions, strict=True
        ):
            dims = (AT, *quantity.dims)
            state_values, of_error, of_rest = (values_along(numbers, k * size + first, quantity) for k in range(3))
            first += quantity.size
            variables[schema.name_without_clash((AT_TIME,), name)] = xr.Variable(
                dims, state_values, described, fastpath=True
            )
            variables[error] = xr.Variable(dims, of_error, error_described, fastpath=True)
            if self.layout.is_doubled:
                left = {
                    "units": described["units"],
                    "long_name": f"what a float does not hold of {name}: the number is {name} + {schema.rest_name(name)}",
                    "role": LEFT_OVER,
                }
                variables[schema.rest_name(name)] = xr.Variable(dims, of_rest, left, fastpath=True)
        time_attributes = {
            "units": str(run.variables["time"].attrs["units"]),
            "long_name": "wanted time",
            "role": "time",
        }
        variables[AT_TIME] = xr.Variable((AT,), times, time_attributes | schema.AXIS, fastpath=True)
        row_attributes = {"units": "1", "long_name": "row of the run from which the step goes", "role": "index"}
        variables["row"] = xr.Variable((AT,), rows, row_attributes, fastpath=True)
        attributes = {key: run.attrs[key] for key in _KEPT if key in run.attrs}
        attributes |= interpolation_attributes(self.settings.scheme, self.model, self.rule) | {"error_estimate": ROUTE}
        return xr.Dataset(variables, attrs=attributes).set_coords(AT_TIME)

    @cached_property
    def _descriptions(self) -> list[tuple[str, dict[str, Any], str, dict[str, Any]]]:
        """Name and attributes of each quantity of the state, and of its error."""
        layout, scheme, descriptions = self.layout, self.settings.scheme, []
        orders = interpolation_orders(scheme, layout, self.rule)
        for quantity in self.quantities:
            name = quantity.name
            recorded, error = self.run.variables[name].attrs, schema.error(name)
            rule = {
                "interpolation": scheme.interpolation(self.model, self.rule),
                "interpolation_order": orders[layout.used.block(name).name],
                "ancillary_variables": error,
            }
            described = {key: recorded[key] for key in ("units", "long_name", "role")} | rule
            of_error = {"units": recorded["units"], "long_name": f"error of {name}: {ROUTE}", "role": "error"}
            descriptions.append((name, described, error, of_error))
        return descriptions

    def _columns(self, rows: NDArray[np.int64]) -> list[Any]:
        """Gather size, regime, contacts and initial state of every step; and its final state if the method needs it."""
        following = np.minimum(rows + 1, self.run.sizes[STEPS] - 1)
        by_element = not model_dimensions(self.run)
        columns_with_rows = step_columns(self.model, self.settings, rows, following, by_element=by_element)
        return [self.run.variables[name].isel({STEPS: column_rows}) for name, column_rows in columns_with_rows]

    @cached_property
    def _links(self) -> RowLinks | None:
        return row_links(self.model, links_read(self.run, self.model))

    def _links_later(self) -> Any:
        from dask.delayed import delayed

        return delayed(row_links)(self.model, links_read(self.run, self.model))

    def _evaluated(
        self, where: Floats, columns: Floats, links: RowLinks | None, *, with_errors: bool = True, **more: Any
    ) -> Floats:
        """Evaluate states and, if they are to be judged, their errors.

        Rows of `where` are wanted time, start, end, and row; of `columns` step, regime, contacts, the state at its start and
        perhaps at its end. `more` is what else `states_within` takes.
        """
        every, unit = rows_apart(self.run.attrs), unit_suffix(str(self.run.variables["time"].attrs["units"]))
        check_steps_meet(where[:3], columns[0], slack(self.run), unit, every)
        numbers = self.run.variables.get(schema.STEP_NUMBER.name)
        if numbers is not None and not is_chunked(numbers) and every == 1:
            check_rows_follow(where, numbers, unit)
        reintegrated = self.rule == REINTEGRATE
        return states_within(
            self.model,
            self.settings,
            self.law,
            where[:3],
            columns,
            self._factors,
            reintegrated=reintegrated,
            with_distances=with_errors,
            past=self._past if self.model.delays else None,
            links=None if links is None else links.links_at(where[3]),
            **more,
        )

    @cached_property
    def _past(self) -> Past:
        """The steps of the complete run, for delayed values."""
        contact_states = state_names(self.model, by_element=not model_dimensions(self.run))
        used = (quantity.name for quantity in self.quantities)
        names = ("time", "step_size", "regime", "row_kind", *contact_states, *used)
        columns = stack_columns([self.run.variables[name].astype(float) for name in names])
        time, every = columns[0], rows_apart(self.run.attrs)
        unit = unit_suffix(str(self.run.variables["time"].attrs["units"]))
        start = self.model.statement.initial["t"].si
        if every > 1 or time[0] != start:
            recorded_words = RARE.format(every) if every > 1 else f"those from t = {float(time[0])!r}{unit} on"
            raise InputError(
                f"delayed values are of every row from the start at t = {start!r}{unit} on, and this record has {recorded_words}; sample"
                " the whole record"
            )
        check_steps_meet(np.stack([time[1:], time[:-1], time[1:]]), columns[1, 1:], slack(self.run), unit, every)
        return past_of(self.model, self.settings, self.law, columns, self._factors)

    def defects(
        self, rows: NDArray[np.int64], parts: int, shifts: Mapping[str, Floats] | None = None
    ) -> dict[str, Floats]:
        """Return one step from each row less `parts` short steps instead, by variable, in recorded units.

        `shifts`, shape (k, ...) or (1, ...), are added to what the parts start from: to the rests where numbers have such.
        """
        time, used, low_parts = np.asarray(self.run["time"]), self.layout.used, None
        columns, links = stack_columns(self._columns(rows)), self._links
        n, first, doubled = len(used), 3 + self._touching, self.layout.is_doubled
        slid = 0 if self.layout.is_doubled else len(self.layout.shares)
        start, end = time[rows], time[rows + 1]
        if shifts is not None:
            of_step = [np.asarray(shifts[quantity.name]) for quantity in self.quantities]
            columns[first + doubled * n :][:n] += np.concatenate([flattened_rows(part).T for part in of_step])
        inner = columns[first : first + n].copy()
        # the last border is the object `end` itself, which is recognised below by identity
        borders = [*(start + (end - start) * (k / parts) for k in range(parts)), end]
        for low, high in pairwise(borders):
            if parts > 1:  # a whole step is of its recorded size, which is not end - start to the bit
                columns[0] = high - low
            columns[first : first + n] = inner
            if doubled and high is end:  # as the march had it, which is not what the float is written as
                low_parts = np.asarray(self.run.variables[schema.REST_TIME.name])[rows + 1]
            of_start = slice(0, len(columns) if doubled else first + n)
            steps = np.vstack([columns[of_start], columns[len(columns) - slid :]]) if slid else columns[of_start]
            state_numbers = self._evaluated(
                np.stack([high, low, high, rows]), steps, links, with_errors=False, low_parts=low_parts
            )
            inner, columns[2] = state_numbers[:n], schema.STEP  # only the first part follows an event
            if doubled:
                columns[first + n : first + 2 * n] = state_numbers[2 * n :]
                columns[first + 2 * n] = [rest_of_time(time) for time in high.tolist()]
        names, first_row_of = [quantity.name for quantity in self.quantities], self.layout.used.offset_of
        defects = stack_columns([self.run.variables[name][rows + 1] for name in names]) - inner
        if doubled:
            defects += (
                stack_columns([self.run.variables[schema.rest_name(name)][rows + 1] for name in names])
                - columns[first + n : first + 2 * n]
            )
        return {
            quantity.name: values_along(defects, first_row_of(quantity.name), quantity) for quantity in self.quantities
        }

    @property
    def _touching(self) -> int:
        return len(reactions(self.model))

    @cached_property
    def _factors(self) -> Floats:
        """Factors from internal to recorded numbers, one row per number; a single row if all are equal."""
        factors = record.factors(self.layout, self.settings.scales)[:, np.newaxis]
        return factors[:1] if (factors == factors[0]).all() else factors


_KEPT = ("title", "solver_method", "solver_order", "solver_estimator", "model_digest", "force_digest", "content_digest")

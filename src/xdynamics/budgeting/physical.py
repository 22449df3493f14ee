"""Physical errors of a number: uncertain parameters, initial values, measured tables, declared discrepancies.

Slopes of the number by every uncertain input come from the variational equations of its run, or from differences.

The uncertainties of a measured table act row by row, and as one error common to all rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.budgeting.measurand import TIME, Measurand, Target
from xdynamics.budgeting.term import COPIES, COVERED, PHYSICAL, ROUNDING, RUN, ErrorSource, Term, stated_source
from xdynamics.dynamics.path import NO_MAP, steps_over_impacts
from xdynamics.dynamics.saltation import FlowStates, SimultaneousEvents, with_ticks
from xdynamics.dynamics.variational import (
    LARGEST,
    Equations,
    NotVariedError,
    Variations,
    first_contact_rows,
    followed_start,
    gauss,
    refuse_delays,
)
from xdynamics.elementary.arrays import dot, product
from xdynamics.elementary.bounds import EPS
from xdynamics.faults import InputError
from xdynamics.kernels.layout import layout_of
from xdynamics.model import Model
from xdynamics.model.drive_arguments import CLOCK
from xdynamics.model.drives import Table
from xdynamics.model.grammar import SECTIONS
from xdynamics.model.motion import variables
from xdynamics.model.parts import Parameter
from xdynamics.model.uncertainty import Discrepancy, cholesky_factor, correlation_matrix, normal_quantile
from xdynamics.record import unfold
from xdynamics.record.flag_words import words_of_flag
from xdynamics.record.named_rows import rows_named
from xdynamics.sweeping.axes import INITIAL_PREFIX
from xdynamics.units import NUMBERS, Unit, coherent

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

NEAR = 1e-9  # of a value at the start: what digits of it leave


def variational_slopes(run: xr.Dataset, model: Model, target: Target, inputs: Sequence[str]) -> dict[str, float]:
    """Return the slope of a number by uncertain inputs, both in their own units.

    Raises
    ------
    NotVariedError
        If the variational equations do not cover the run, its contacts or its forces.
    """
    changes = _integrate_changes(run, model, target, tuple(inputs))
    factor = float(target.units(run).factor)
    units = [float(model.uncertain[name].quantity.unit.factor) for name in inputs]
    if not np.isfinite(changes).all():
        raise NotVariedError("the equations have no finite solution")
    return {name: float(change) * unit / factor for name, change, unit in zip(inputs, changes, units, strict=True)}


def _integrate_changes(run: xr.Dataset, model: Model, target: Target, inputs: tuple[str, ...]) -> Floats:
    """Integrate along the run, from event to event, to the number; return its slopes in SI units."""
    if target.extreme is not None:
        raise NotVariedError("an extreme is where the run has it")
    _check_points(model, inputs)
    path = with_ticks(Variations(run, _variational_equations(run, model, inputs), int(run.attrs["solver_order"])))
    change, row, occurrences, first_touches = (
        path.from_start(_initial_changes(path, inputs)),
        0,
        0,
        first_contact_rows(run),
    )
    for row_before, row_after, names in _event_instants(run):
        if target.at is not None and float(run["time"][row_before]) > target.at:
            break
        _check_open(first_touches, row_before)
        change = path.carried_change(change, row, row_before)
        met = SimultaneousEvents(path, np.array([row_before]), np.array([row_after]), names, change[None])
        occurrences += names.count(target.event)
        if target.event in names and occurrences >= target.occurrence:
            return _changes_at_event(met, target)
        change, row = met.changes_after()[0], row_after
    assert target.at is not None  # noqa: S101 - a number at an event was found in the run before
    last = int(np.searchsorted(run["time"].values, target.at, side="right")) - 1
    _check_open(first_touches, last)
    change = path.carried_change(change, row, last, target.at)
    return _quantity_changes(_changes_at_time(path, last, target.at, change), target)


def _check_points(model: Model, inputs: Sequence[str]) -> None:
    """Refuse tables that jump at points whose times the inputs move."""
    if not (point_inputs := sorted(model.read_by_points.intersection(inputs))):
        return
    for name, drive in model.elements.drives.items():
        if drive.argument != CLOCK and drive.jumps:
            raise NotVariedError(f"'{name}' jumps at times that follow '{point_inputs[0]}'")


def _check_open(first_touches: Mapping[str, int], row: int) -> None:
    """Refuse contacts that are not open up to a row."""
    if closed_contacts := [name for name, first in first_touches.items() if first <= row]:
        raise NotVariedError(f"'{closed_contacts[0]}' is not open all the time")


def _variational_equations(run: xr.Dataset, model: Model, inputs: tuple[str, ...]) -> Equations:
    """Return the variational equations of a model; refuse models without them, or with too many."""
    if model.frictions:
        raise NotVariedError("friction elements slip or stick all the time")
    if model.assemblies:
        raise NotVariedError("impacts of many links have no map of states")
    if steps_over_impacts(run, model):
        raise NotVariedError(f"{run.attrs['solver_method']} locates no impacts")
    refuse_delays(model)
    if model.python_functions:
        raise NotVariedError("a force or event is written in Python")
    if model.constraints and (model.elements.contacts or any(event.reset for event in model.elements.events.values())):
        raise NotVariedError("constraints answer to impacts and resets, of which there is no map of states")
    equations = Equations(model, inputs)
    if equations.size * len(gauss(int(run.attrs["solver_order"]) // 2 + 2)[0]) > LARGEST:
        raise NotVariedError(f"{equations.size} variables are too many")
    return equations


def _initial_changes(path: Variations, inputs: tuple[str, ...]) -> Floats:
    """Return the initial change: 1 for the varied initial value, or the slopes of expressions at the start."""
    model = path.equations.model
    names, followed = variables(model), model.slopes_at_start(inputs)
    change = np.array(
        [
            [
                float(name == input_name and input_name in model.elements.starts)
                + followed.get((name, input_name), 0.0)
                for input_name in inputs
            ]
            for name in names
        ]
    )
    return _follow_constraints(path, inputs, change) if model.constraints else change


def _follow_constraints(path: Variations, inputs: tuple[str, ...], change: Floats) -> Floats:
    """Return the initial change as it is where the start follows constraints."""
    model = path.equations.model
    state = {name: float(value[0]) for name, value in path.row(np.zeros(1, np.int64)).items()}
    if any(
        abs(state[name] - model.elements.statement.initial[name].si) > NEAR * abs(state[name])
        for name in variables(model)
    ):
        raise NotVariedError("the start is moved to where constraints hold")
    followed = followed_start(model, inputs, state, change)
    if followed is None:
        raise NotVariedError("an input moves the start from where constraints hold; see [initial] consistent")
    return followed


def _event_instants(run: xr.Dataset) -> Iterator[tuple[int, int, tuple[str, ...]]]:
    """Yield the rows on both sides of every instant with events, and the names of the events."""
    if not run.sizes.get("event", 0):
        return
    detectors, kinds = (words_of_flag(run[name]) for name in ("event_detector", "event_kind"))
    rows = [rows_named(run, name).tolist() for name in ("event_row_before", "event_row_after")]
    groups: dict[tuple[int, int], list[str]] = {}
    for row_before, row_after, name, kind in zip(*rows, detectors, kinds, strict=True):
        groups.setdefault((row_before, row_after), []).append(name)
        if kind in NO_MAP:
            groups[row_before, row_after].append(f"{kind} of {name}")
    for (row_before, row_after), names in groups.items():
        yield row_before, row_after, tuple(names)


def _changes_at_event(met: SimultaneousEvents, target: Target) -> Floats:
    """Return the slopes of a number at an event."""
    time = met.time_of(target.event)
    if target.quantity == TIME:
        return np.asarray(time[0])
    return _quantity_changes(
        met.flow_before_event(time) if target.side == "before" else met.flow_after_event(time), target
    )


def _changes_at_time(path: Variations, last: int, time: float, change: Floats) -> FlowStates:
    """Return the state at a time and its changes."""
    row = np.array([last])
    flow = SimultaneousEvents(path, row, row, (), change[None]).flow_before_event(np.zeros((1, change.shape[1])))
    state = path.states(np.array([time]), np.array([last]))
    return FlowStates(flow.model, state, flow.changes)


def _quantity_changes(flow: FlowStates, target: Target) -> Floats:
    """Return the change of a coordinate, velocity, state, energy or observable."""
    if target.quantity in flow.changes:
        return np.asarray(flow.changes[target.quantity][0])
    derived = layout_of(flow.model).derived
    if target.quantity not in derived:
        raise InputError(f"quantity is {target.quantity!r}")
    return np.asarray(flow.change(derived[target.quantity])[0])


DISCREPANCY = "discrepancy"
SHIFTS = 4.0 ** np.arange(-3, 5)  # changes of an input for a slope, in standard uncertainties
CENTRAL_PAIR = 2  # index of the pair of neighbouring shifts at one standard uncertainty
WIDEST, NARROWEST = 1e-2, 1e-9  # relative limits of shifts: wider only up to the uncertainty, narrower never
NOISE = 64.0 * EPS  # relative to the number, over a shift; a smaller slope counts as zero
SIDES = np.array([-3.0, -2.0, -1.0, 1.0, 2.0, 3.0])
WEIGHTS = np.array([-1.0, 9.0, -45.0, 45.0, -9.0, 1.0]) / 60.0  # of the sixth-order slope from these sides
AGREED = 0.02  # relative, within which variational equations and differences agree
BY_DIFFERENCES = (
    "slope by central differences of sixth order over {0:.3g} of its uncertainties; another spacing gives {1:.1g} of"
    " the slope more or less"
)
BY_EQUATIONS = (
    "slope by variational equations on the run's steps; central differences of sixth order over {0:.3g} of its"
    " uncertainties give {1:.1g} of the slope more or less"
)
BY_EQUATIONS_ALONE = (
    "slope by variational equations on the run's steps; differences over {0:.3g} of its uncertainties are rounding"
)
NO_SLOPE = "no slope but rounding's"


@dataclass(frozen=True)
class Slope:
    """How a number changes with an input, per the input's own unit.

    Attributes
    ----------
    value : float
    off : float
        How far it may be off.
    rule : str
        How it was found.
    """

    value: float
    off: float
    rule: str


def input_source(measurand: Measurand, names: Sequence[str]) -> ErrorSource:
    """Return the errors of uncertain parameters and initial values: a term for each of the named ones."""
    blank = partial(_blank_input_terms, measurand.model, names)
    return ErrorSource(tuple(names), (RUN, ROUNDING, COPIES), partial(_input_terms, measurand, names), blank)


def _input_terms(
    measurand: Measurand, names: Sequence[str], run: xr.Dataset, rounding: Sequence[Term], numbers: Floats
) -> list[Term]:
    """Return the terms of inputs, from the number in their copies; slopes that are rounding alone are zero."""
    slopes = _input_slopes(measurand, names, run, rounding[0].bound, numbers)
    return [_input_term(name, measurand.model.uncertain[name], slopes[name]) for name in names]


def _blank_input_terms(model: Model, names: Sequence[str], _unit: Unit) -> list[Term]:
    unknown = Slope(np.nan, np.nan, "")
    return [_input_term(name, model.uncertain[name], unknown) for name in names]


def _input_term(name: str, parameter: Parameter, slope: Slope) -> Term:
    """Return the term of an input by its slope."""
    factor = float(parameter.quantity.unit.factor)
    assert parameter.spread is not None  # noqa: S101
    size = parameter.spread.size.si / factor if parameter.spread.bounded else COVERED * parameter.uncertainty
    return Term(
        name,
        PHYSICAL,
        abs(slope.value) * parameter.uncertainty,
        (abs(slope.value) + slope.off) * size,
        slope.rule,
        slope.value / factor,
        parameter.uncertainty * factor,
        coherent(parameter.quantity.unit),
        slope.off / factor,
    )


def _input_slopes(
    measurand: Measurand, names: Sequence[str], run: xr.Dataset, rounding: float, numbers: Floats
) -> dict[str, Slope]:
    """Return the slope by every input: from variational equations where differences over its uncertainty agree.

    Where they disagree by more than rounding, the response is not linear over the uncertainty, and the differences are used.
    """
    by_differences = difference_slopes(measurand, names, rounding, numbers)
    try:
        by_equations, remark = variational_slopes(unfold(run), measurand.model, measurand.target, names), ""
    except NotVariedError as error:
        by_equations, remark = {}, f"; no variational equations: {error}"
    slopes = {}
    for name, (slope, slope_error, shift, smallest_slope, march_rounding) in by_differences.items():
        exact = by_equations.get(name, slope)
        distance = abs(exact - slope)
        if not slope:
            significant = abs(exact) > smallest_slope
            slopes[name] = (
                Slope(exact, slope_error, BY_EQUATIONS_ALONE.format(shift))
                if significant
                else Slope(0.0, slope_error, NO_SLOPE)
            )
        elif not by_equations:
            slopes[name] = Slope(slope, slope_error, BY_DIFFERENCES.format(shift, slope_error / abs(slope)) + remark)
        elif distance <= AGREED * abs(slope):
            slopes[name] = Slope(exact, distance, BY_EQUATIONS.format(shift, distance / abs(exact)))
        elif distance <= march_rounding:
            slopes[name] = Slope(exact, distance, BY_EQUATIONS_ALONE.format(shift))
        else:
            remark = f"; the variational equations, of the smallest changes, give {exact:.3g}"
            slopes[name] = Slope(
                slope, max(slope_error, distance), BY_DIFFERENCES.format(shift, slope_error / abs(slope)) + remark
            )
    return slopes


def shifted_copies(measurand: Measurand, names: Sequence[str]) -> xr.DataArray:
    """Return the number where each input is changed by its shifts, to both sides, lazy."""
    model = measurand.model
    inputs = {name: model.uncertain[name] for name in names}
    values = {
        name: np.full((len(inputs), len(SHIFTS), len(SIDES)), entry.quantity.value) for name, entry in inputs.items()
    }
    for i, (name, entry) in enumerate(inputs.items()):
        # unusable shifts march the unchanged model; their sizes are nan, so that no slope comes of them
        values[name][i] += np.multiply.outer(np.nan_to_num(_input_shifts(entry)), SIDES)
    axes = {
        "input": {
            input_axis_name(model, name): _with_unit_attribute(entry.ravel(), inputs[name])
            for name, entry in values.items()
        }
    }
    return measurand.numbers(axes, time_tolerance=measurand.sharp)


def difference_slopes(
    measurand: Measurand, names: Sequence[str], rounding: float, numbers: Floats
) -> dict[str, tuple[float, float, float, float, float]]:
    """Return for every input its slope from copies side by side, its error, the relative shift, and two rounding errors.

    The first of these is that of the numbers themselves, the second that of the marches to them.

    Starting from a shift of one standard uncertainty, wider and narrower ones are tried as long as neighbours agree
    better: the widest suffer from curvature, the narrowest from rounding.

    Raises
    ------
    InputError
        If the quantity vanishes within the uncertainty of an input, as an event that no longer happens.
    """
    parameters = {name: measurand.model.uncertain[name] for name in names}
    sizes = np.array([_input_shifts(entry) for entry in parameters.values()])
    numbers = numbers.reshape(len(parameters), len(SHIFTS), len(SIDES))
    slopes_by_name, weighted_rounding = {}, float(np.sum(np.abs(WEIGHTS))) * rounding
    for i, (name, entry) in enumerate(parameters.items()):
        slopes = dot(numbers[i], WEIGHTS) / sizes[i]
        distances = np.abs(np.diff(slopes))
        if not np.isfinite(distances).any():
            smallest = float(3.0 * np.nanmin(sizes[i]))
            raise InputError(
                f"{measurand.target.description} no longer exists where '{name}' is changed by {smallest:.3g}"
                f" {entry.quantity.unit.text}, less than its uncertainty of {entry.uncertainty:.3g}: a budget,"
                " which is of small changes, does not apply; draw the inputs in a sweep"
            )
        k = _best_pair(distances)
        slope, size = float(slopes[k + 1]), float(sizes[i][k + 1])
        smallest = NOISE * float(np.nanmax(np.abs(numbers[i]))) / size
        # a number that is bent at its own value has a slope of nearly 0 too, and changes by more than rounding
        changes = float(np.ptp(numbers[i][k + 1])) > 2.0 * rounding
        noise = smallest if changes else max(smallest, weighted_rounding / size)
        doubt, share = float(distances[k]), size / entry.uncertainty
        if abs(slope) <= noise:  # and no more between neighbours, the narrower of which is noisier
            slope, doubt = 0.0, 0.0 if doubt <= 8.0 * noise else doubt
        slopes_by_name[name] = slope, doubt, share, smallest, weighted_rounding / size
    return slopes_by_name


def _input_shifts(parameter: Parameter) -> Floats:
    """Return the shifts of an input; nan for shifts that are too large or too small relative to it."""
    value, sizes = abs(parameter.quantity.value), parameter.uncertainty * SHIFTS
    usable = (sizes <= max(parameter.uncertainty, WIDEST * value)) & (sizes >= NARROWEST * value)
    if not usable.any():  # known better than floating-point numbers resolve
        sizes, usable = NARROWEST * value * SHIFTS, SHIFTS <= 1.0
    return np.where(usable, sizes, np.nan)


def _best_pair(differences: Floats) -> int:
    """Return the pair of neighbours that agrees best, descending from the one at the input's own uncertainty."""
    finite = np.flatnonzero(np.isfinite(differences)).tolist()
    start = min(finite, key=lambda k: abs(k - CENTRAL_PAIR))
    best = start
    for direction in (1, -1):
        k = start
        while k + direction in finite and differences[k + direction] < differences[k]:
            k += direction
        best = k if differences[k] < differences[best] else best
    return best


def input_axis_name(model: Model, name: str) -> str:
    """Return the name of an axis over an input; for an initial value it differs from the variable's."""
    return f"{INITIAL_PREFIX}{name}" if name in model.elements.starts else name


def _with_unit_attribute(values: Floats, parameter: Parameter) -> Any:
    import xarray as xr

    return xr.DataArray(values, attrs={"units": parameter.quantity.unit.text})


def discrepancy_source(measurand: Measurand) -> list[ErrorSource]:
    """Return the discrepancy that the model declares for the quantity, if any."""
    declared = measurand.model.elements.discrepancy.get(measurand.target.quantity)
    return [] if declared is None else [stated_source(measurand, DISCREPANCY, partial(_discrepancy, declared))]


def _discrepancy(declared: Discrepancy, unit: Unit) -> Term:
    standard = declared.standard.si / float(unit.factor)
    return Term(DISCREPANCY, PHYSICAL, standard, COVERED * standard, declared.description or "declared in the model")


def covariance(model: Model, terms: list[Term]) -> Floats:
    """Return the covariance of the terms' contributions, shape (n, n), with the model's correlations of inputs."""
    root = np.array([_signed_contribution(term) for term in terms])[:, None] * _correlation_root(model, terms)
    return product(root, root.T)


def combined_variance(model: Model, terms: list[Term]) -> float:
    """Return the variance of the terms together: a sum of squares, never negative where terms cancel."""
    total_contribution = dot(
        np.array([_signed_contribution(term) for term in terms]), _correlation_root(model, terms).T
    )
    return float(dot(total_contribution, total_contribution))


def _correlation_root(model: Model, terms: list[Term]) -> Floats:
    """Return the root of the correlation matrix; terms that are not inputs are independent."""
    names = [term.name for term in terms]
    return cholesky_factor(correlation_matrix(names, model.elements.correlations))


def _signed_contribution(term: Term) -> float:
    return -term.standard if term.sensitivity < 0.0 else term.standard


COMMON = "_common"  # suffix to the name of a table, for what is common to all rows
MAX_ROWS = 256  # with a slope for each
PAIRS, CONTROLS = 32, 4  # of drawn tables: where slopes do not suffice, and to check that they do
SLOPE_AGREEMENT = 0.02  # relative to a standard uncertainty, within which slopes count as exact
LEAST = 2.0**-54
SIGNS = np.array([1.0, -1.0])
PARTS = np.array([-1.0, -2.0 / 3.0, -1.0 / 3.0, 1.0 / 3.0, 2.0 / 3.0, 1.0])  # of a standard uncertainty
SIDE_WEIGHTS = np.array([-1.0, 9.0, -45.0, 45.0, -9.0, 1.0]) / 20.0  # of the sixth-order slope from these


def table_sources(measurand: Measurand) -> Iterator[ErrorSource]:
    """Yield the errors of measured tables with uncertainties: of their rows, and of all rows together."""
    for name, drive in measurand.model.elements.drives.items():
        copies, table = TableCopies(measurand, name, drive.table), drive.table
        for suffix, term, sizes in (
            ("", independent_rows_term, table.uncertainty),
            (COMMON, common_term, table.common),
        ):
            if sizes is not None and sizes.any():
                call = partial(term, copies, sizes)
                yield ErrorSource.of_one(name + suffix, PHYSICAL, (), call, measurand.seed, unit=NUMBERS)


@dataclass(frozen=True)
class TableCopies:
    """Copies of a model that differ in one measured table.

    Attributes
    ----------
    measurand : Measurand
    name : str
        Name of the drive.
    table : Table
    """

    measurand: Measurand
    name: str
    table: Table

    def number(self, change: Floats) -> float:
        """March the model with its table changed by so much, SI; return the number."""
        model = self.measurand.model
        declared = SECTIONS["drives"].write(model.elements.drives[self.name], model.time_unit)
        text = _table_text(self.table, self.table.value + change)
        drive_entries = {key: value for key, value in declared.items() if key not in ("column", "gaps")}
        changed = model.replace(drives={self.name: drive_entries | {"csv": text}})
        return self.measurand.number(changed, time_tolerance=self.measurand.sharp)

    def odd(self, change: Floats) -> float:
        """Return half the difference of the number between a change and its opposite."""
        return (self.number(change) - self.number(-change)) / 2.0


def independent_rows_term(copies: TableCopies, sizes: Floats) -> Term:
    """Return the term of independent rows: from the slope of each, where drawn tables agree with them.

    Otherwise, or with too many rows, it is the standard deviation over drawn tables, known as well as so few allow.
    """
    rows, unchanged_number = np.flatnonzero(sizes), copies.number(np.zeros(sizes.size))
    rng = np.random.default_rng(copies.measurand.seed)
    points = normal_quantile(np.maximum(rng.random((PAIRS, sizes.size)), LEAST))

    def drawn_changes(pairs: int) -> Floats:
        """Return the changes of the number with drawn tables, and with their opposites."""
        return np.array(
            [[copies.number(sign * point * sizes) - unchanged_number for sign in SIGNS] for point in points[:pairs]]
        )

    reason = f"{rows.size} rows are more than {MAX_ROWS}"
    if rows.size <= MAX_ROWS:
        effects = np.array([copies.odd(np.where(np.arange(sizes.size) == i, sizes, 0.0)) for i in rows.tolist()])
        standard = float(np.sqrt(np.sum(effects**2)))
        expected_changes = np.multiply.outer(dot(points[:CONTROLS, rows], effects), SIGNS)
        distance = float(np.sqrt(np.mean((drawn_changes(CONTROLS) - expected_changes) ** 2)))
        if distance <= standard / np.sqrt(2.0 * PAIRS):  # more accurate than draws
            relative_distance = distance / standard if standard else 0.0
            rule = (
                f"rows are independent: slopes by all {rows.size}; {2 * CONTROLS} tables with every row drawn are"
                f" {relative_distance:.1g} of it off"
            )
            doubt = distance if relative_distance > SLOPE_AGREEMENT else 0.0
            return Term(copies.name, PHYSICAL, standard, COVERED * standard, rule, standard_doubt=doubt)
        reason = f"it is not in proportion with the rows, by whose slopes it were {standard:.3g}"
    standard = float(np.sqrt(np.mean(drawn_changes(PAIRS) ** 2)))
    rule = f"rows are independent: {2 * PAIRS} tables with every row drawn from its uncertainty; {reason}"
    # of a linear effect both tables of a pair give the same
    return Term(
        copies.name, PHYSICAL, standard, COVERED * standard, rule, standard_doubt=standard / np.sqrt(2.0 * PAIRS)
    )


def common_term(copies: TableCopies, sizes: Floats) -> Term:
    """Return the term of an error common to all rows: one input that shifts the complete table.

    If every row has the same uncertainty, it is that one, with its unit; otherwise the input is a pure number with an
    uncertainty of 1.
    """
    numbers = np.array([copies.number(part * sizes) for part in PARTS])
    effect = float(dot(numbers, SIDE_WEIGHTS))
    doubt = abs(effect - float(numbers[-1] - numbers[0]) / 2.0)
    uniform = bool((sizes == sizes[0]).all())
    size, unit = (float(sizes[0]), coherent(copies.table.value_unit)) if uniform else (1.0, NUMBERS)
    rule = (
        "common to all rows: slope by central differences of sixth order over its uncertainty; over all of it"
        f" {doubt / abs(effect) if effect else 0.0:.1g} of the slope more or less"
    )
    return Term(
        copies.name + COMMON,
        PHYSICAL,
        abs(effect),
        COVERED * (abs(effect) + doubt),
        rule,
        effect / size,
        size,
        unit,
        doubt / size,
    )


def _table_text(table: Table, values: Floats) -> str:
    """Write a table with other values, in its own units."""
    factors = [float(unit.factor) for unit in (table.argument_unit, table.value_unit)]
    head = f"argument [{table.argument_unit.text}],value [{table.value_unit.text}]"
    rows = (
        f"{x!r},{y!r}"
        for x, y in zip((table.argument / factors[0]).tolist(), (values / factors[1]).tolist(), strict=True)
    )
    return "\n".join([head, *rows, ""])

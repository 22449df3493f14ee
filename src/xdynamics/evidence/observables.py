"""Observables of a run at any times within it, with their interpolation errors."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import compress
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.dynamics.shortened_steps import sample_in_steps
from xdynamics.elementary import kept_set
from xdynamics.evidence.observed_quantities import ObservedQuantities, parameters_read_by
from xdynamics.expressions import Binary, Name, Node, free_names
from xdynamics.faults import InputError
from xdynamics.kernels.layout import Layout, layout_of
from xdynamics.methods.scheme import REINTEGRATE
from xdynamics.model import Function, Model
from xdynamics.model.constraints import Assignment
from xdynamics.model.motion import constants, drive_pieces, evaluate_over_states, motion, potentials
from xdynamics.model.reactions import (
    ALIKE,
    NORMAL,
    PIVOT_NOISE,
    gram_trees,
    holding_flag,
    may_be_indeterminate,
    mode_number,
    reactions,
    share_number,
    sharing_pairs,
)
from xdynamics.model.regime_model import RegimeModel
from xdynamics.model.regimes import REGIME_NUMBER
from xdynamics.model.sliding import SlidingModel, sided_model, sliding_model, surfaces
from xdynamics.model.switches import switch_side
from xdynamics.record.folding import quantity_names
from xdynamics.record.run_columns import state_name
from xdynamics.record.schemas import log_description
from xdynamics.record.unfolding import find_column, get_column
from xdynamics.shapes.blocks import Block
from xdynamics.shapes.naming import DOT
from xdynamics.units import parse_unit

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]
TreesOf = Callable[[Model], Sequence[Node]]


def observables_of(model: Model) -> tuple[str, ...]:
    """Name the observables at any time: coordinates, velocities, states, energies, declared observables."""
    layout = layout_of(model)
    return (
        *layout.used,
        *(name for block in _observed_blocks(layout) for name in block.elements()),
    )


def quantities_of(model: Model) -> tuple[str, ...]:
    """Name the observables at any time, quantities with dimensions at once."""
    layout = layout_of(model)
    return tuple(block.name for block in (*layout.used.blocks, *_observed_blocks(layout)))


def _observed_blocks(layout: Layout) -> list[Block]:
    """Return energies and declared observables."""
    return [
        block
        for block in layout.computed.blocks
        if block.first not in {*layout.rate_terms, *layout.gaps, *layout.constraint_outputs}
    ]


def is_observable(model: Model, name: str) -> bool:
    """Whether a name is one of `observables_of` or of `quantities_of` a model."""
    layout = layout_of(model)
    if DOT not in name:
        return name in quantities_of(model)
    return name in layout.used or (
        name in layout.computed and name not in {*layout.rate_terms, *layout.constraint_outputs, *layout.gaps}
    )


def is_comparable(model: Model, name: str) -> bool:
    """Whether a quantity, or an element of one, can be observed; see `comparable`."""
    if not reactions(model) or not is_observable(model, name):
        return is_observable(model, name)
    layout = layout_of(model)
    if layout.used.find_offset(name) is not None:
        return True
    elements = (name,) if DOT in name else layout.computed.block(name).elements()
    return {*elements} <= {*comparable(model)}


def comparable(model: Model) -> tuple[str, ...]:
    """Name the observables that read no accelerations, which contacts change within a step."""
    layout, observables = layout_of(model), observables_of(model)
    if not reactions(model):
        return observables
    accelerations = {*layout.accelerations}
    return tuple(
        name for name in observables if name in layout.used or not free_names(layout.derived[name]) & accelerations
    )


def observe(
    run: xr.Dataset, model: Model, names: Sequence[str], times: Floats, rule: str = REINTEGRATE
) -> dict[str, tuple[Floats, Floats]]:
    """Return values of observables at times, and their errors by interpolation of the state, in recorded units.

    Returns
    -------
    dict of str to (ndarray, ndarray), shape (k, ...)
        Of a quantity with dimensions, which a record may be asked for that has it as one variable, along these.

    Raises
    ------
    InputError
        If a name is not an observable of the model, or a time is outside the run.
    """
    for name in names:
        if not is_observable(model, name):
            available_names = quantity_names(observables_of(model))
            raise InputError(f"observable '{name}' is none of the model's; there are {', '.join(available_names)}")
    states = sample_in_steps(run, times, after_event=True, rule=rule, functions=model.functions, model=model)
    used = layout_of(model).used
    stored = [str(name) for name in states.variables if schema.error(str(name)) in states.variables]
    state_values, state_errors = (
        {name: states.variables[name_rule(name)].values for name in stored} for name_rule in (str, schema.error)
    )
    integrated = [name for name in names if name in states.variables or name in used]
    values = {name: (used.values_of(state_values, name), used.values_of(state_errors, name)) for name in integrated}
    derived_names = [name for name in names if name not in values]
    return values | _evaluate_derived(
        run, model, derived_names, (state_values, state_errors), (states[schema.AT_TIME].values, states["row"].values)
    )


def _evaluate_derived(
    run: xr.Dataset,
    model: Model,
    names: list[str],
    states: tuple[dict[str, Floats], dict[str, Floats]],
    where: tuple[Floats, Rows],
) -> dict[str, tuple[Floats, Floats]]:
    """Evaluate energies and declared observables, and how much the error of each state variable moves them."""
    if changed := [name for name in names if not is_comparable(model, name)]:
        raise InputError(
            f"observable '{changed[0]}' reads accelerations, which contacts change; ask for what it is made of"
        )
    if not names:
        return {}
    times, rows = where
    regimes = run.variables["regime"].values[rows].astype(float) if "regime" in run.variables else np.zeros(rows.size)
    evaluator = ObservedQuantities.of(model, names, times, regimes, kept_set(run.attrs.get("math_functions")))
    blocks = _derived_blocks(model, names)
    units = [float(parse_unit(str(get_column(run, name).attrs["units"])).factor) for name in names]
    factors = np.repeat(units, [block.size for block in blocks])[:, np.newaxis]
    values, errors = (
        _by_elements(run, model, blocks, states, times, rows) if evaluator is None else evaluator.with_errors(*states)
    )
    lines = np.cumsum([block.size for block in blocks])[:-1]
    parts = [zip(*(np.split(numbers / factors, lines) for numbers in (values, errors)), strict=True)]
    return {
        name: (block_values.T.reshape(-1, *block.shape), block_errors.T.reshape(-1, *block.shape))
        for name, block, (block_values, block_errors) in zip(names, blocks, *parts, strict=True)
    }


def _derived_blocks(model: Model, names: Sequence[str]) -> list[Block]:
    """Return the blocks of energies and observables; a single element has a block of its own."""
    computed = layout_of(model).computed
    return [computed.block(name) if DOT not in name else Block(name, "derived") for name in names]


def _by_elements(
    run: xr.Dataset,
    model: Model,
    blocks: Sequence[Block],
    states: tuple[dict[str, Floats], dict[str, Floats]],
    times: Floats,
    rows: Rows,
) -> tuple[Floats, Floats]:
    """Evaluate the elements of quantities one by one at states, and how much the error of each number moves them."""
    layout = layout_of(model)
    trees = [layout.derived[name] for block in blocks for name in (block.elements() if block.dims else (block.name,))]
    state_values, state_errors = (
        {name: layout.used.values_of(numbers, name) for name in layout.used} for numbers in states
    )

    def evaluate_trees(state: Mapping[str, Floats]) -> Floats:
        return np.stack(evaluate_at_states(run, model, trees, state, times, rows))

    values = evaluate_trees(state_values)
    displacements = (
        np.abs(evaluate_trees(state_values | {variable: state_values[variable] + state_errors[variable]}) - values)
        for variable in layout.used
        if state_errors[variable].any()
    )
    return values, sum(displacements, np.zeros(values.shape))


def tree_of(model: Model, name: str) -> Node:
    """Return the expression of a recorded energy, observable, force, acceleration, rate or reaction."""
    return layout_of(model).derived.get(name, Name(name))


def evaluate_quantity(
    run: xr.Dataset, model: Model, name: str, states: Mapping[str, Floats], times: Floats, rows: Rows
) -> Floats:
    """Evaluate one recorded quantity at states inside steps, in SI units; see `evaluate_at_states`.

    What a model with dimensions sums over many elements is evaluated as arrays; shape (numbers, k) of a quantity that has
    dimensions itself.
    """
    evaluator = _quantity_evaluator(run, model, [name], times, rows)
    if evaluator is not None:
        values = evaluator.of_states(states)
        return values if name in model.shapes.dims else values[0]
    return evaluate_at_states(run, model, [tree_of(model, name)], states, times, rows)[0]


def potentials_on(
    run: xr.Dataset, model: Model, states: Mapping[str, Floats], times: Floats, rows: Rows
) -> dict[str, Floats]:
    """Evaluate the potential energy of each force term that has one, in joules, at states as in `evaluate_at_states`."""
    evaluator = _quantity_evaluator(run, model, ["potential_energy"], times, rows)
    if evaluator is not None:
        return {name: numbers[0] for name, numbers in evaluator.of_trees(potentials(model), states).items()}
    trees = potentials(model.elements)
    return dict(zip(trees, evaluate_at_states(run, model, [*trees.values()], states, times, rows), strict=True))


def rate_on(
    run: xr.Dataset, model: Model, name: str, states: Mapping[str, Floats], times: Floats, rows: Rows
) -> Floats:
    """Evaluate the rate of one recorded quantity along the motion, in SI units; see `evaluate_quantity`."""
    evaluator = _quantity_evaluator(run, model, [name], times, rows)
    rates = None if evaluator is None else evaluator.rates(states)
    if rates is not None:
        rate_values: Floats = rates[0]
        return rate_values

    def trees_of(marched: Model) -> list[Node]:
        return [marched.elements.rate_of(tree_of(marched, name))]

    return evaluate_at_states(run, model, trees_of(model), states, times, rows, trees_of=trees_of)[0]


def state_rates(
    run: xr.Dataset, model: Model, states: Mapping[str, Floats], times: Floats, rows: Rows
) -> dict[str, Floats] | None:
    """Evaluate the rates of all variables along the motion by their quantities, shape (numbers, k), in SI units over seconds.

    None where they are to be evaluated one by one: see `ObservedQuantities`.
    """
    evaluator = _quantity_evaluator(run, model, (), times, rows)
    return None if evaluator is None else evaluator.state_rates(states)


def knows_state_rates(run: xr.Dataset, model: Model) -> bool:
    """Whether `state_rates` are known of a run."""
    evaluator = _quantity_evaluator(run, model, (), np.zeros(0), np.zeros(0, np.int64))
    return evaluator is not None and evaluator.knows_rates


def momenta_on(
    run: xr.Dataset, model: Model, name: str, states: Mapping[str, Floats], times: Floats, rows: Rows
) -> Floats:
    """Evaluate the mass of a coordinate with dimensions times its velocity at states inside steps: (numbers, k), SI."""
    evaluator, speed = _quantity_evaluator(run, model, (), times, rows), schema.velocity(name)
    number = [*model.statement.coordinates].index(name)
    mass = model.expanded(model.statement.mass[number][number])
    parameter_values = parameters_read_by(model, [mass])
    assert evaluator is not None and parameter_values is not None  # noqa: S101, PT018 - the rates of the state are known
    evaluator = replace(evaluator, values={**evaluator.values, **parameter_values})
    return evaluator.of_trees({speed: Binary("*", mass, Name(speed))}, states)[speed]


def _quantity_evaluator(
    run: xr.Dataset, model: Model, names: Sequence[str], times: Floats, rows: Rows
) -> ObservedQuantities | None:
    regimes = run.variables["regime"].values[rows].astype(float) if "regime" in run.variables else np.zeros(rows.size)
    return ObservedQuantities.of(model, names, times, regimes, kept_set(run.attrs.get("math_functions")))


@lru_cache(maxsize=512)
def rate_tree(model: Model, name: str) -> Node | None:
    """Return the time derivative of a recorded variable along the motion; None if contacts, Python or delays affect it."""
    elements = model.elements
    if name in elements.statement.coordinates:
        return elements.rates[name]
    if reactions(model) or model.python_functions or model.delays:
        return None
    if name in elements.units:
        return elements.rates[name]
    terms = _motion_terms(model)
    tree = layout_of(model).derived.get(name, terms.get(name))
    if tree is None or isinstance(tree, Function) or not free_names(tree).isdisjoint(terms):
        return None
    return elements.rate_of(tree)


@lru_cache(maxsize=16)
def _motion_terms(model: Model) -> Mapping[str, Node | Function]:
    """Return the assignments of the motion by name; with many elements each is made on look-up."""
    return {term.name: term.value for term in motion(model.elements)}


def evaluate_at_states(
    run: xr.Dataset,
    model: Model,
    trees: Sequence[Node],
    states: Mapping[str, Floats],
    times: Floats,
    rows: Rows,
    parts: Sequence[slice] | None = None,
    read: Sequence[Assignment] | None = None,
    trees_of: TreesOf | None = None,
) -> list[Floats]:
    """Evaluate expressions on states inside steps: also of forces, accelerations and contact forces.

    Parameters
    ----------
    run : xarray.Dataset
        For regimes, and for the mode of each contact and friction element after a row.
    model : Model
    trees : sequence of Node
        With definitions expanded.
    states : mapping of str to ndarray, shape (k,)
        Coordinates, velocities and first-order states, in recorded units: those at least that the expressions read.
    times : ndarray, shape (k,), s
    rows : ndarray of int, shape (k,)
        Along `step`, from which each step starts.
    parts : sequence of slice, optional
        Of the states: those at which each expression is wanted. What several of them read is evaluated once.
    read : sequence of Assignment, optional
        Those of the motion that the expressions read, if they are known.
    trees_of : callable, optional
        Returns the expressions of a model that slides along switches: rates are others there.

    Returns
    -------
    list of ndarray, shape (k,), or of each part
        In SI units.

    Raises
    ------
    InputError
        If the record lacks the columns of contacts or friction elements.
    """
    names = reaction_columns(model)
    if missing := [name for name in names if find_column(run, name) is None]:
        raise InputError(
            f"what is computed between rows needs {', '.join(missing)};"
            f" {log_description(run.attrs) or 'take the whole record'}"
        )
    columns = {name: get_column(run, name).values for name in names}
    columns |= {name: run.variables[name].values for name in ("regime", *share_columns(model)) if name in run.variables}
    following = np.minimum(rows + 1, run.sizes[schema.STEPS] - 1)
    functions = kept_set(run.attrs.get("math_functions"))
    return evaluate_inside_steps(
        model, trees, states, times, (rows, following), columns, functions, read=read, parts=parts, trees_of=trees_of
    )


def evaluate_inside_steps(
    model: Model,
    trees: Sequence[Node],
    states: Mapping[str, Floats],
    times: Floats,
    ends: tuple[Rows, Rows],
    columns: Mapping[str, Any],
    math_functions: str,
    parameters: Mapping[str, Floats] | None = None,
    read: Sequence[Assignment] | None = None,
    parts: Sequence[slice] | None = None,
    trees_of: TreesOf | None = None,
) -> list[Floats]:
    """Evaluate expressions on states inside steps of one run, or of many in concatenated columns; see `evaluate_at_states`.

    `ends` are the rows from which each step starts, and at which it ends; `parameters` those that differ between runs, SI;
    `read` the assignments of the motion that the expressions read, if they are known.
    """
    rows, following = ends
    regimes = columns["regime"][rows].astype(float) if "regime" in columns else np.zeros(rows.size)
    inputs = {
        name: states[name] * float(model.elements.units[name].factor) for name in states if name in model.elements.units
    }
    inputs |= {"t": times, REGIME_NUMBER: regimes} | dict(parameters or {})
    if reactions(model):
        modes = modes_behind(model, columns, rows, following)
        if may_be_indeterminate(model):
            grams = evaluate_over_states(
                model, gram_trees(model), inputs | modes, constants(model), drive_pieces(model), math_functions
            )
            modes |= shares_of_forces(modes, grams, [holding_flag(reaction) for reaction in reactions(model)])
        inputs |= modes
    values = evaluate_over_states(
        model, trees, inputs, constants(model), drive_pieces(model), math_functions, read, parts
    )
    places = [slice(0, rows.size)] * len(values) if parts is None else parts
    results = [np.array(np.broadcast_to(value, rows[part].shape)) for value, part in zip(values, places, strict=True)]
    for slid, steps in _slid_groups(model, columns, rows):
        part_inputs = {name: value[steps] for name, value in inputs.items()}
        part_inputs |= _sides(slid, part_inputs)
        slid_trees = trees if trees_of is None else trees_of(slid)
        values = evaluate_over_states(
            slid, slid_trees, part_inputs, constants(slid), drive_pieces(slid), math_functions
        )
        for result, value, part in zip(results, values, places, strict=True):
            inside = (steps >= part.start) & (steps < part.stop)
            result[steps[inside] - part.start] = np.broadcast_to(value, steps.shape)[inside]
    return results


def share_columns(model: Model) -> tuple[str, ...]:
    """Name the shares of what a motion may slide along: where they are numbers, forces are those along it."""
    return () if model.shapes.dims else tuple(schema.share_of(surface.name) for surface in surfaces(sided_model(model)))


def _slid_groups(model: Model, columns: Mapping[str, Any], rows: Rows) -> Iterator[tuple[SlidingModel, Rows]]:
    """Yield each model that slides in some steps, and which of them."""
    names = [name for name in share_columns(model) if name in columns]
    if not names:
        return
    slides = ~np.isnan([columns[name][rows] for name in names])
    base, groups = sided_model(model), np.unique(slides[:, slides.any(axis=0)], axis=1)
    assert isinstance(base, RegimeModel)  # noqa: S101 - others have no shares
    for group in groups.T:
        slid = [surface for surface in surfaces(base) if schema.share_of(surface.name) in compress(names, group)]
        yield sliding_model(base, slid), np.flatnonzero((slides == group[:, np.newaxis]).all(axis=0))


def _sides(model: RegimeModel, inputs: Mapping[str, Floats]) -> dict[str, Floats]:
    """Return the sides of switches at states."""
    plain, numbered = model.plain, [(i, switch) for i, switch in enumerate(model.switches) if not switch.drive]
    trees = [switch.function for _, switch in numbered]
    values = evaluate_over_states(plain, trees, inputs, constants(plain), drive_pieces(plain))
    return {
        switch_side(i): np.where(np.asarray(value) == 0.0, switch.at_zero, np.sign(value))
        for (i, switch), value in zip(numbered, values, strict=True)
    }


def reaction_columns(model: Model, *, by_element: bool = True) -> list[str]:
    """Name the columns that the modes of contacts and friction elements follow from: of elements, or of quantities."""
    names = [name for element in reactions(model) for name in (state_name(element), element.name)]
    return names if by_element else [*quantity_names(names)]


def modes_behind(model: Model, columns: Mapping[str, Any], rows: Rows, led_to: Rows) -> dict[str, Floats]:
    """Return the mode of each reaction after rows as numbers, as a march appends them to the parameters.

    Parameters
    ----------
    model : Model
    columns : mapping of str to ndarray
        State and force of every contact and friction element.
    rows, led_to : ndarray of int, shape (k,)
        Rows of the columns from which each step starts, and at which it ends.
    """
    modes = {share_number(k, j): np.zeros(rows.size) for k, j in sharing_pairs(model)}
    for reaction in reactions(model):
        state, force = columns[state_name(reaction)][rows], columns[reaction.name]
        if reaction.sort == NORMAL:
            modes[holding_flag(reaction)], modes[mode_number(reaction)] = (
                (state != schema.OPEN).astype(float),
                np.zeros(rows.size),
            )
        else:
            modes[holding_flag(reaction)] = (state == schema.STICKING).astype(float)
            modes[mode_number(reaction)] = (state == schema.FORWARD).astype(float) - (state == schema.BACKWARD)
        # one that the law of forces cannot have share is released, so its force is 0
        modes[holding_flag(reaction)] *= (force[rows] != 0.0) | (force[led_to] != 0.0)
    return modes


def shares_of_forces(modes: Mapping[str, Floats], grams: Sequence[Floats], flags: Sequence[str]) -> dict[str, Floats]:
    """Return the flags of reactions that hold, and the shares of those whose rows follow from rows before them.

    A march finds them at events by `march.contacts.active_set.find_spare`, from the same factors L D L^T.

    Parameters
    ----------
    modes : mapping of str to ndarray
        Those of `modes_behind`, in which a flag may stand for a reaction that needs not hold.
    grams : sequence of ndarray
        Effect of a unit of each reaction on the row of each, row by row, at each state.
    flags : sequence of str
        Names of the flags, in the order of reactions.
    """
    n, factors, pivots, shares = len(flags), dict[tuple[int, int], Floats](), list[Floats](), dict[str, Floats]()
    for i, flag in enumerate(flags):
        for j in range(i):
            left = grams[i * n + j] - sum(factors[i, k] * factors[j, k] * pivots[k] for k in range(j))
            factors[i, j] = np.divide(left, pivots[j], out=np.zeros_like(pivots[j]), where=pivots[j] > 0.0)
        diagonal = grams[i * n + i]
        pivot = diagonal - sum(factors[i, k] ** 2 * pivots[k] for k in range(i))
        holds = modes[flag] == 1.0
        noise = sum(PIVOT_NOISE * factors[i, k] ** 2 * grams[k * n + k] for k in range(i))
        needed = holds & (pivot > np.maximum(ALIKE * diagonal, noise))
        pivots.append(np.where(needed, pivot, 0.0))
        shares[flag] = needed.astype(float)
        along: dict[int, Floats] = {}
        for j in reversed(range(i)):
            along[j] = np.where(pivots[j] > 0.0, factors[i, j] - sum(factors[k, j] * along[k] for k in along), 0.0)
            share = along[j] * grams[j * n + j] / diagonal
            shares[share_number(i, j)] = np.where(holds & ~needed, share, 0.0)
    return shares

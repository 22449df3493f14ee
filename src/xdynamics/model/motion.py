"""M a = F as trees: every quantity of one force evaluation, each after those that it reads.

Compiled laws are printed from these assignments, and the same assignments are evaluated where a single state is
examined: in a linearisation, in the search for a failure. No other place states how a force becomes an acceleration.

Of a model with dimensions they are as many as there are quantities; what they are at each element is what the model of
its elements says. Kinetic and potential energy are trees too, and derivatives of the motion along a direction.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache, reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary import NAME
from xdynamics.expressions import Along, Binary, Name, Node, Number, derivative, expand, free_names
from xdynamics.expressions.calculus import ONE, ZERO
from xdynamics.expressions.evaluation import evaluate, evaluate_many
from xdynamics.faults import InputError, ModelError
from xdynamics.model.constraints import (
    Assignment,
    conditions,
    keep_conditions,
    mass_factors,
    multiplier_assignments,
    solve_mass,
)
from xdynamics.model.delays import in_history, is_before, slope_before, value_at_start, value_before
from xdynamics.model.drive_arguments import CLOCK, table_in_time
from xdynamics.model.drives import piece_coefficients, value_and_slope
from xdynamics.model.elements import Elements
from xdynamics.model.elementwise import Elementwise, in_si
from xdynamics.model.model import Model
from xdynamics.model.parts import Drive, Function
from xdynamics.model.reactions import free_acceleration, mode_names, reaction_assignments, reactions, unloaded
from xdynamics.model.regime_model import switch_inputs, watched_by
from xdynamics.model.regimes import REGIME_NUMBER, in_some
from xdynamics.model.switches import Switch, where_it_decides
from xdynamics.reaction_names import constraint_force
from xdynamics.schema import acceleration, force, rate, velocity
from xdynamics.shapes import Shapes, dims_of
from xdynamics.shapes.blocks import Blocks
from xdynamics.shapes.gradient import derivative as derivative_along
from xdynamics.units import CONSTANTS, TIME, UNSCALED, Dimension, Scales, constant

ALONG_A_MARCH = "has delayed values, which are known along a run alone, and not at a state by itself"
Table = tuple[NDArray[np.float64], NDArray[np.float64]]
_PROBES = ((0.7310, 0.3176), (1.2391, 0.5143), (0.4127, 0.8869))  # first number of an odd state, and ratio to the next
_ODD = 1e-9  # of a kinetic energy: what is odd in velocities, or left without them, and rounding


def variables(model: Model) -> tuple[str, ...]:
    """Return the variables of the motion: coordinates, velocities, first-order states."""
    elements = model.elements
    return (
        *elements.statement.coordinates,
        *(velocity(name) for name in elements.statement.coordinates),
        *elements.statement.states,
    )


def first_regime(model: Model) -> int:
    """Return the number of the regime that the motion begins in."""
    return list(model.regimes).index(model.regime) if model.regimes else 0


def unbound(name: str) -> str:
    """Name the acceleration that a coordinate has without constraints."""
    return f"_unbound_{name}"


def drive_slope(drive: str) -> str:
    """Name the derivative of a drive by its argument."""
    return f"_slope_{drive}"


def moves_by_quantities(model: Model) -> bool:
    """Whether the motion is one of quantities along their dimensions; else it is written for each element.

    Elements alone have full masses, constraints, contacts of few, sides of switches, delays and functions in Python.
    """
    elements = model.elements
    by_element = (
        elements.contacts,
        elements.frictions,
        elements.constraints,
        model.python_functions,
        model.delays,
        watched_by(model),
        not has_diagonal_mass(model),
    )
    return not model.shapes.dims or not any(by_element)


def has_diagonal_mass(model: Model) -> bool:
    """Whether each quantity has a mass of its own, as it was written: not derived from a Lagrangian, and not full."""
    return model.statement.lagrangian is None and not model.elements.mass_is_full


@lru_cache(maxsize=64)
def motion(model: Model) -> tuple[Assignment, ...]:
    """Write force terms, accelerations and rates of quantities; of `model.elements` for every element.

    A diagonal mass divides; a full one is factored as L D L^T (Golub and Van Loan, Matrix Computations, 4th ed.,
    section 4.1.2). A mass that is not positive gives nan, which ends a run. Contacts and friction elements add their
    forces to the free accelerations.
    """
    if not moves_by_quantities(model):
        return motion(model.elements)
    coordinates = model.statement.coordinates
    assignments = [*_force_terms(model), *mass_factors(model)]
    tied = conditions(model)
    free_of_reactions = free_acceleration if reactions(model) else acceleration
    acceleration_name = unbound if tied else free_of_reactions
    assignments += solve_mass(
        model, {acceleration_name(name): total for name, total in _summed_force_terms(model).items()}
    )
    if tied:
        assignments += multiplier_assignments(model)
        assignments += keep_conditions(
            model,
            {name: Name(unbound(name)) for name in coordinates},
            [condition.bias for condition in tied],
            {name: free_of_reactions(name) for name in coordinates},
            [unloaded(condition) if reactions(model) else constraint_force(condition.name) for condition in tied],
        )
    assignments += reaction_assignments(model)
    rates = {rate(name): model.expanded(state.rate) for name, state in model.statement.states.items()}
    assignments += (Assignment(name, tree) for name, tree in rates.items())
    dims = motion_shapes(model).dims
    return tuple(item._replace(dims=dims.get(item.name, ())) for item in assignments)


def _force_terms(model: Model) -> Iterator[Assignment]:
    """Write every force term; in a regime in which it does not act it is 0, whatever its value would be."""
    for term, components in forces_by_coordinate(model).items():
        for name, component in components.items():
            target = force(term, name)
            if isinstance(component, Function) and acts_always(model, term):
                yield Assignment(target, component)
            elif isinstance(component, Function):
                yield Assignment(f"_any_{target}", component)
                yield Assignment(target, in_regimes(model, term, Name(f"_any_{target}")))
            else:
                yield Assignment(target, in_regimes(model, term, model.expanded(component)))


@lru_cache(maxsize=64)
def forces_by_coordinate(model: Model) -> Mapping[str, Mapping[str, Node | Function]]:
    """Return every force term by the coordinates on which it acts: derived from a Lagrangian, for elements."""
    if not model.shapes.dims or model.statement.lagrangian is not None:
        return model.elements.force_components
    elements = Elements(model.statement, model.shapes)
    return {term: elements.force_by_coordinate(part) for term, part in model.statement.forces.items()}


@lru_cache(maxsize=64)
def motion_shapes(model: Model) -> Shapes:
    """Return the shapes of a model with those of its force components, and of the slopes of its tables."""
    dims_by_name = model.shapes.dims
    if not dims_by_name:
        return model.shapes
    names = {drive_slope(name): dims_by_name.get(name, ()) for name in model.statement.drives}
    names |= {
        force(term, name): dims_by_name.get(name, ())
        for term, parts in forces_by_coordinate(model).items()
        for name in parts
    }
    return replace(model.shapes, dims={**dims_by_name, **{name: dims for name, dims in names.items() if dims}})


def acts_always(model: Model, term: str) -> bool:
    """Whether a force term acts in every regime."""
    return all(term in regime.forces for regime in model.regimes.values())


def in_regimes(model: Model, term: str, tree: Node) -> Node:
    """Return a tree of a force term as it is in the current regime: itself, or 0."""
    if acts_always(model, term):
        return tree
    return in_some(tree, [i for i, regime in enumerate(model.regimes.values()) if term in regime.forces])


def decides(model: Model, switch: Switch) -> Node:
    """Return 1 where a switch has an effect, else 0: on other sides of a `where`, and in other regimes."""
    indicator = where_it_decides(switch, {}, ONE, ZERO)
    return in_regimes(model, switch.owner, indicator) if switch.owner in model.elements.forces else indicator


@lru_cache(maxsize=64)
def constant_names(model: Model) -> Blocks:
    """Return the names of `constants`, of which no value is made."""
    parameter_blocks, past_names = _parameter_names(model), _past_constants(model, UNSCALED) if model.delays else ()
    further_names = (
        *CONSTANTS,
        "pi",
        *model.statement.calendar,
        *past_names,
        *mode_names(model),
        *switch_inputs(model),
    )
    return parameter_blocks + Blocks.from_names(
        "constant", [name for name in dict.fromkeys(further_names) if name not in parameter_blocks]
    )


def _parameter_names(model: Model) -> Blocks:
    parameters = model.elements.statement.parameters
    return parameters.names if isinstance(parameters, Elementwise) else Blocks.from_names("parameter", parameters)


@lru_cache(maxsize=64)
def constants(model: Model, scales: Scales = UNSCALED) -> Mapping[str, float]:
    """Return parameters, unit constants, pi, and the modes of open contacts, in the order of a law's `p`.

    They are in SI units over the scales. A march that closes a contact changes the modes, which come last.
    """
    dimensions = model.elements.dimensions
    values = {
        name: part.si / scales.si_factor(dimensions[name]) for name, part in model.elements.statement.parameters.items()
    }
    return values | _unit_constants(model, scales) | dict.fromkeys([*mode_names(model), *switch_inputs(model)], 0.0)


@lru_cache(maxsize=64)
def constant_values(model: Model, scales: Scales = UNSCALED) -> NDArray[np.float64]:
    """Return the values of `constants`, without one of each element of a parameter by its name."""
    blocks = _parameter_names(model)
    values, first = in_si(model.elements.statement.parameters, blocks), 0
    for block in blocks.blocks:
        values[first : first + block.size] /= scales.si_factor(model.dimensions[block.name])
        first += block.size
    further_values = [
        *_unit_constants(model, scales).values(),
        *[0.0] * len([*mode_names(model), *switch_inputs(model)]),
    ]
    values = np.append(values, further_values)
    # cached, so that all callers share one array
    values.flags.writeable = False
    return values


def _unit_constants(model: Model, scales: Scales) -> dict[str, float]:
    """Return unit constants, pi, and the constants that delayed values read."""
    dimensions = model.elements.dimensions
    values = {name: float(constant(name).factor) / scales.si_factor(dimensions[name]) for name in CONSTANTS}
    values["pi"] = math.pi
    values |= {name: float(constant(name).factor) / scales.si_factor(TIME) for name in model.statement.calendar}
    return values | _past_constants(model, scales) if model.delays else values


def _past_constants(model: Model, scales: Scales) -> dict[str, float]:
    """Return the constants that delayed values read: flags of times before the start, and the values there."""
    elements = model.elements
    history_flags = {in_history(i): 1.0 for i in range(len(model.delays))}
    names = [name for name in elements.moving if name not in model.history]
    return history_flags | {
        value_at_start(name): elements.statement.initial[name].si / scales.si_factor(elements.dimensions[name])
        for name in sorted(names)
    }


@lru_cache(maxsize=16)
def drive_pieces(model: Model, scales: Scales = UNSCALED) -> tuple[Table, ...]:
    """Return the pieces of every drive, in SI units over the scales.

    Raises
    ------
    ModelError
        If a slope between two points of a table overflows.
    """
    elements = model.elements
    tables = []
    for name, drive in elements.drives.items():
        argument = drive.table.argument / scales.si_factor(drive.table.argument_unit.dimension)
        value = drive.table.value / scales.si_factor(elements.dimensions[name])
        of_time = elements.looked_up_at[name] == CLOCK
        with np.errstate(all="ignore"):  # checked below, where the position is known
            tables.append(piece_coefficients(argument, value, drive.interpolation, drive.outside, of_time=of_time))
        _check_pieces(name, drive, tables[-1])
        if of_time and drive.argument != CLOCK:
            tree, constant_numbers = elements.expanded(drive.argument), constants(model, scales)
            rate_in_time = evaluate(derivative(tree, {"t": ONE}), constant_numbers)
            tables[-1] = table_in_time(tables[-1], rate_in_time, evaluate(tree, {**constant_numbers, "t": 0.0}))
    return tuple(tables)


def _check_pieces(name: str, drive: Drive, pieces: Table) -> None:
    """Refuse a table whose slope between two of its points overflows."""
    inner = pieces[1][:, 1:-1]
    wrong = np.flatnonzero(~np.isfinite(inner).all(axis=0))
    if wrong.size:
        argument, value = drive.table.argument, drive.table.value
        with np.errstate(all="ignore"):
            steep = np.flatnonzero(~np.isfinite(np.diff(value) / np.diff(argument)))
        first = int([*steep, *wrong][0])  # one bad slope of a spline spoils them all
        last = first + 1
        raise ModelError(
            f"drive '{name}': table '{drive.table.name}' goes from {value[first]:.6g} at {argument[first]:.15g} to"
            f" {value[last]:.6g} at {argument[last]:.15g} (SI units), where the slopes of interpolation"
            f" '{drive.interpolation}' overflow; give points that lie further apart or nearer in value"
        )


def motion_inputs(
    model: Model, state: Mapping[str, float], constant_numbers: Mapping[str, float], tables: Iterable[Table]
) -> dict[str, float]:
    """Return the inputs of the motion's assignments at one state: constants, state, regime, drives and slopes.

    Parameters
    ----------
    model : Model
    state : mapping of str to float
        A number for `t`, every coordinate, velocity and first-order state; the regime, if it is not the first.
    constant_numbers : mapping of str to float
        `constants` in the same units.
    tables : iterable of (ndarray, ndarray)
        Each drive's `piece_coefficients`, in the same units.

    Raises
    ------
    InputError
        If the model has delayed values, which no state by itself gives.
    """
    if model.delays:
        raise InputError(f"the model '{model.name}' {ALONG_A_MARCH}")
    values = dict(constant_numbers) | {name: state[name] for name in ("t", *variables(model))}
    values[REGIME_NUMBER] = state.get(REGIME_NUMBER, float(first_regime(model)))
    for (name, argument), table in zip(model.elements.looked_up_at.items(), tables, strict=True):
        pair = value_and_slope(table, evaluate(argument, values), of_time=argument == CLOCK)
        values[name], values[drive_slope(name)] = map(float, pair)
    return values


def evaluate_motion(
    model: Model, state: Mapping[str, float], constant_numbers: Mapping[str, float], tables: Iterable[Table]
) -> dict[str, float]:
    """Evaluate forces, accelerations and rates at one state, by the operations of a compiled law.

    Parameters
    ----------
    model, state, constant_numbers, tables
        As for `motion_inputs`.

    Returns
    -------
    dict of str to float
        All values by name, including drives.
    """
    values = motion_inputs(model, state, constant_numbers, tables)
    for assignment in motion(model.elements):
        values[assignment.name] = _assignment_value(model, assignment.value, values)
    return values


def evaluate_over_states(
    model: Model,
    trees: Sequence[Node],
    state: Mapping[str, Any],
    constant_numbers: Mapping[str, float],
    tables: Iterable[Table],
    math_functions: str = NAME,
    read: Sequence[Assignment] | None = None,
    parts: Sequence[slice] | None = None,
) -> list[Any]:
    """Evaluate expressions at many states at once, as `evaluate_motion` would, with only those assignments that they read.

    Parameters
    ----------
    model : Model
    trees : sequence of Node
        With definitions expanded.
    state : mapping of str to ndarray, shape (k,)
        For `t`, every coordinate, velocity and first-order state, and the regime.
    constant_numbers, tables
        As for `evaluate_motion`.
    math_functions : str
        The set of elementary functions.
    read : sequence of Assignment, optional
        The result of `assignments_read`, if it is available.
    parts : sequence of slice, optional
        Of the states: those at which each expression is wanted. What several of them read is evaluated once.

    Raises
    ------
    InputError
        If they read delayed values, which no states by themselves give.
    """
    values: dict[str, Any] = dict(constant_numbers) | dict(state)
    read = assignments_read(model, trees) if read is None else read
    names = _names_in(trees, read) if model.delays or model.drives else set[str]()
    for (name, argument), table in zip(model.elements.looked_up_at.items(), tables, strict=True):
        if names & {name, drive_slope(name)}:  # the state of a table that is not read may not be known
            x = evaluate_many(argument, values, math_functions)
            values[name], values[drive_slope(name)] = value_and_slope(table, x, of_time=argument == CLOCK)
    if any(map(is_before, names)):
        raise InputError(f"the model '{model.name}' {ALONG_A_MARCH}")
    for item in read:
        if isinstance(item.value, Function):
            # without otypes vectorize calls once more to learn the type, and fails where there are no states
            call = np.vectorize(model.functions[item.value.name], otypes=[float])
            values[item.name] = call(*(values[name] for name in item.value.arguments))
        else:
            values[item.name] = evaluate_many(item.value, values, math_functions)
    values_by_tree = [values] * len(trees) if parts is None else [_PartialValues(values, part) for part in parts]
    return [
        evaluate_many(item, tree_values, math_functions)
        for item, tree_values in zip(trees, values_by_tree, strict=True)
    ]


def _names_in(trees: Iterable[Node], read: Iterable[Assignment]) -> set[str]:
    """Return the names that some expressions and assignments read."""
    values = [*trees, *(item.value for item in read)]
    return set().union(*(set(it.arguments) if isinstance(it, Function) else free_names(it) for it in values))


class _PartialValues(dict[str, Any]):
    """The values at some of the states, each taken when it is first read."""

    def __init__(self, values: Mapping[str, Any], part: slice) -> None:
        super().__init__()
        self._values, self._part = values, part

    def __contains__(self, name: object) -> bool:
        return name in self._values

    def __missing__(self, name: str) -> Any:
        value = self._values[name]
        self[name] = value[self._part] if np.ndim(value) else value
        return self[name]


def assignments_read(model: Model, trees: Iterable[Node]) -> list[Assignment]:
    """Return the assignments of the motion that expressions without definitions depend on, in order."""
    needed = set().union(*(free_names(item) for item in trees))
    assignments: list[Assignment] = []
    if needed <= _unassigned_names(model) or needed.isdisjoint(_assigned(model)):
        return assignments
    for item in reversed(motion(model.elements)):
        if item.name in needed:
            assignments.append(item)
            needed |= {*item.value.arguments} if isinstance(item.value, Function) else free_names(item.value)
    return assignments[::-1]


@lru_cache(maxsize=64)
def _unassigned_names(model: Model) -> frozenset[str]:
    """Name the inputs of the motion, without writing its assignments, which takes long for many bodies."""
    return frozenset(("t", REGIME_NUMBER, *variables(model), *model.elements.statement.parameters, *CONSTANTS, "pi"))


@lru_cache(maxsize=512)
def _assigned(model: Model) -> frozenset[str]:
    """Name the targets of the motion's assignments."""
    return frozenset(item.name for item in motion(model.elements))


def _assignment_value(model: Model, value: Node | Function, values: Mapping[str, float]) -> float:
    if isinstance(value, Function):
        return float(model.functions[value.name](*(values[name] for name in value.arguments)))
    return evaluate(value, values)


def _summed_force_terms(model: Model) -> dict[str, Node]:
    """Add the force terms of each coordinate, in their order."""
    totals: dict[str, Node] = {}
    for term, components in forces_by_coordinate(model).items():
        for name in components:
            addend = Name(force(term, name))
            totals[name] = Binary("+", totals[name], addend) if name in totals else addend
    return {name: totals.get(name, ZERO) for name in model.statement.coordinates}


def energies(model: Model) -> dict[str, Node]:
    """Return kinetic energy and, where a force has a potential, potential and total energy."""
    if not has_diagonal_mass(model):
        model = model.elements
    moving = list(map(velocity, model.statement.coordinates))
    kinetic = kinetic_as_written(model) or _sum_trees(
        _sum_over_elements(
            model,
            Binary(
                "*",
                Binary("/", model.expanded(entry), Number(2.0)),
                Binary("*", Name(moving[i]), Name(moving[j])),
            ),
        )
        for (i, j), entry in model.statement.mass_entries.items()
    )
    terms = potentials(model)
    if not terms:
        return {"kinetic_energy": kinetic}
    potential = _sum_trees(terms.values())
    total = Binary("+", kinetic, potential)
    return {"kinetic_energy": kinetic, "potential_energy": potential, "total_energy": total}


@lru_cache(maxsize=64)
def kinetic_as_written(model: Model) -> Node | None:
    """Return the kinetic energy of a Lagrangian that has more than v.M.v/2: what moves by itself, as a driven pivot does.

    It is asked at odd states whether it is even in the velocities, and 0 without them.
    """
    elements = model.elements
    if elements.statement.lagrangian is None:
        return None
    tree = elements.expanded(elements.statement.lagrangian.kinetic)
    speeds = [*map(velocity, elements.statement.coordinates)]
    for state in probe_states(model):
        mirrored = state | {name: -state[name] for name in speeds}
        try:
            value, other, at_rest = (
                evaluate(tree, entry) for entry in (state, mirrored, state | dict.fromkeys(speeds, 0.0))
            )
        except (ArithmeticError, KeyError, ValueError):
            continue
        if not max(abs(value - other), abs(at_rest)) <= _ODD * abs(value):
            return tree
    return None


def probe_states(model: Model) -> Iterator[dict[str, float]]:
    """Yield three odd states, with odd parameters, at which expressions are compared."""
    for value, ratio in _PROBES:
        state = dict(constants(model)) | {"t": value}
        for name in (*variables(model), *model.elements.statement.parameters):
            value = (value * ratio + 0.3) % 1.0  # noqa: PLW2901
            state[name] = value
        yield state


def potentials(model: Model) -> dict[str, Node]:
    """Return the potential energy of each force term that has one: their sum, in this order, is the potential energy."""
    statement = model.statement
    return {
        name: in_regimes(model, name, _sum_over_elements(model, model.expanded(force.potential)))
        for name, force in statement.forces.items()
        if force.potential is not None
    }


def _sum_over_elements(model: Model, tree: Node) -> Node:
    dims = dims_of(tree, model.shapes) if model.shapes.dims else ()
    return Along("sum", (tree,), dims) if dims else tree


def _sum_trees(terms: Iterable[Node]) -> Node:
    return reduce(lambda total, term: Binary("+", total, term), terms)


def state_quantities(model: Model) -> list[str]:
    """Return the quantities of a state, as a force evaluation uses them."""
    shaped = model.statement
    return [*shaped.coordinates, *map(velocity, shaped.coordinates), *shaped.states]


def change_name(name: str) -> str:
    """Name the derivative of a quantity along a direction of the state; of one of the state itself the direction."""
    return f"_change_{name}"


def shapes_of_changes(model: Model) -> Shapes:
    """Return the shapes of a model with those of its changes."""
    shapes = motion_shapes(model)
    names = [*state_quantities(model), *(item.name for item in motion(model))]
    dims = {change_name(name): shapes.dims[name] for name in names if name in shapes.dims}
    return replace(shapes, dims={**shapes.dims, **dims})


def changes_of_quantities(model: Model) -> list[Assignment]:
    """Return the derivatives of the results of `motion` along a direction of the state, by the chain rule."""
    shapes, changes = shapes_of_changes(model), list[Assignment]()
    rates: dict[str, Node] = {name: Name(change_name(name)) for name in state_quantities(model)}
    for item in motion(model):
        rate_tree = derivative_along(item.tree, rates, shapes)
        changes.append(Assignment(change_name(item.name), rate_tree, item.dims))
        if rate_tree != ZERO:
            rates[item.name] = Name(change_name(item.name))
    return changes


def events_of_quantities(model: Model) -> list[Assignment]:
    """Return the function of each event, and 1 for events located otherwise: ticks, links of contacts."""
    functions = list[Assignment]()
    for name, event in model.statement.events.items():
        assert not isinstance(event.function, Function)  # noqa: S101 - asked before
        tree = ONE if event.every is not None else model.expanded(event.function)
        functions.append(Assignment(name, tree, model.shapes.dims.get(name, ())))
    return [*functions, *(Assignment(name, ONE) for name in model.assemblies)]


def rates_of_quantities(model: Model, quantities: Sequence[Assignment]) -> list[Assignment] | None:
    """Return the time derivatives of expressions along the motion.

    None where they read a table for each element that is looked up at anything but a time: only elements say at what.
    """
    shaped, rates = model.statement, dict[str, Node](t=ONE)
    for name in shaped.coordinates:
        rates |= {name: Name(velocity(name)), velocity(name): Name(acceleration(name))}
    rates |= {name: Name(rate(name)) for name in shaped.states}
    for name in shaped.drives:
        if model.elements.looked_up_at[model.shapes.first(name)] == CLOCK:
            rates[name] = Name(drive_slope(name))
        elif not model.shapes.dims.get(name):
            rates[name] = model.elements.rates[name]
        elif any(name in free_names(item.tree) for item in quantities):
            return None
    shapes = motion_shapes(model)
    return [
        Assignment(f"_rate_of_{item.name}", derivative_along(item.tree, rates, shapes), item.dims)
        for item in quantities
    ]


def delayed_names(model: Model) -> dict[str, tuple[int, str]]:
    """Return every name of a delayed value, of its time derivative, or of its time: the delay, and what is delayed."""
    delay_by_name: dict[str, tuple[int, str]] = {}
    for delay in range(len(model.delays)):
        delay_by_name[value_before(delay, "t")] = delay, "t"
        for name in (*model.elements.moving, *model.elements.drives):
            value = value_before(delay, name)
            delay_by_name |= {value: (delay, name), slope_before(value): (delay, name)}
    return delay_by_name


def delayed_dimensions(model: Model) -> dict[str, Dimension]:
    """Return the dimension of every name of a delayed value."""
    return {
        name: model.elements.dimensions[owner]
        for name, (delay, owner) in delayed_names(model).items()
        if name == value_before(delay, owner)
    }


def delayed_quantities(model: Model) -> list[str]:
    """Return the coordinates, velocities and states that are delayed somewhere, in their order."""
    elements = model.elements
    calls = model.statement.delayed
    read = {name for call in calls for name in free_names(expand(call.arguments[0], elements.definitions))}
    arguments = [elements.expanded(elements.drives[name].argument) for name in elements.drives if name in read]
    read |= {name for tree in arguments for name in free_names(tree)}
    return [name for name in elements.units if name in read]


def before_start(model: Model, name: str, delay: int) -> Node:
    """Return what something was before the start, at the time of a delay."""
    if name not in model.history:
        return Name(value_at_start(name))
    return expand(model.history[name], {**model.elements.definitions, "t": Name(value_before(delay, "t"))})

"""The functions of a model's law: forces, their derivatives, event functions, energies and observables."""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

from xdynamics.expressions import Node
from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.jets import Expansion, Motion, UnexpandedError, expansion
from xdynamics.kernels.law_names import LawNames, call_python_function
from xdynamics.kernels.layout import Layout
from xdynamics.kernels.nest_indices import UnprintedError
from xdynamics.kernels.nests import Nests, Result
from xdynamics.kernels.program import (
    AT,
    DEVIATION,
    Compute,
    EngineCall,
    Instruction,
    Load,
    Location,
    Loop,
    Operand,
    Program,
    StoreTo,
    loop_element,
)
from xdynamics.model import Function, Model
from xdynamics.model.derivatives import derivative_assignments, jacobian_names
from xdynamics.model.detectors import argument_motion, differentiated_reactions, function_rate, python_values
from xdynamics.model.mass import Assignment
from xdynamics.model.motion import constant_names, decides, drive_slope, motion
from xdynamics.model.reactions import reaction_table
from xdynamics.model.regime_model import watched_by
from xdynamics.model.whole import (
    QuantityTree,
    change_name,
    changes_of_quantities,
    events_of_quantities,
    motion_of_quantities,
    motion_shapes,
    prints_quantities,
    rates_of_quantities,
    shapes_of_changes,
)
from xdynamics.model.whole_numbers import with_whole_numbers
from xdynamics.schema import ENERGIES
from xdynamics.shapes import at_element
from xdynamics.shapes.blocks import Blocks


def forces(layout: Layout, *, arrays: bool = False) -> Program:
    """Write M a = F: the results of a force evaluation follow the state that it used.

    With `arrays`, what loops read of the results of others they read from arrays of the program, not from `z`.
    """
    about = "Accelerations, rates, force components and drives of a state."
    # what contacts of many links add to accelerations
    last = (EngineCall(len(constant_names(layout.model))),) if layout.model.assemblies else ()
    if (nests := _in_loops(layout, arrays=arrays)) is not None:
        return Program("forces", about, (*nests.lines, *last), local=nests.local, tables=nests.tables)
    return replace(elements := forces_by_elements(layout), about=about, body=(*elements.body, *last))


def forces_by_elements(layout: Layout) -> Program:
    """Write the forces of a model element by element."""
    lines = write_assignments(layout, motion(layout.model))
    for name in layout.evaluation:
        lines.store(Location("z", layout.record.offset_of(name)), lines.operand_of(name))
    return Program("forces", "", tuple(lines.lines))


def has_loops(model: Model) -> bool:
    """Whether the law of a model with dimensions is printed in loops; else its elements are written out."""
    written_out = model.contacts or model.frictions or model.constraints or model.python_functions or watched_by(model)
    return prints_quantities(model) and not written_out


def _in_loops(layout: Layout, *, arrays: bool) -> Nests | None:
    """Write the motion of a model with dimensions in loops; None of one whose elements are written out."""
    if not has_loops(layout.model):
        return None
    try:
        nests, read = _motion_in_loops(layout, frozenset())
        return _motion_in_loops(layout, read)[0] if arrays and read else nests
    except UnprintedError:
        return None


def _motion_in_loops(layout: Layout, staged_names: frozenset[str]) -> tuple[Nests, frozenset[str]]:
    """Write the motion in loops, some results to arrays too; return also those that other loops read."""
    names, record, shapes = LawNames(layout, layout.used), layout.record, motion_shapes(layout.model)
    drives, motion_of, read = layout.model.shaped.drives, [*motion_of_quantities(layout.model)], set[str]()
    result_names = [*drives, *(name for name, *_ in motion_of)]
    result_locations = {name: Location("z", record.offset_of(shapes.first(name))) for name in result_names}

    def first_location(name: str) -> Location:
        if name in result_locations:
            read.add(name)
        return result_locations.get(name) or names.first_location(name)

    nests, results = Nests(shapes, names, first_location), []
    for name, dims, tree in motion_of:
        results.append((name, dims, tree, result_locations[name]))
        if name in staged_names:
            result_locations[name] = _new_array(nests, name, dims)
            results.append((name, dims, tree, result_locations[name]))
    for name in layout.drives:
        nests.outermost.store(Location("z", record.offset_of(name)), nests.outermost.operand_of(name))
    for name in drives:
        if name in staged_names:
            result_locations[name] = _stage_drive(nests, name)
    nests.results(results)
    return nests, frozenset(read)


def _new_array(nests: Nests, name: str, dims: tuple[str, ...]) -> Location:
    """Return the first place of a new array of a program, for a quantity with dimensions."""
    location = Location(f"of_{name}")
    nests.local[location.array] = math.prod(nests.shapes.shape(dims))
    return location


def _stage_drive(nests: Nests, name: str) -> Location:
    """Look up a drive of each element, before all loops; return where the first is."""
    dims = nests.shapes.dims[name]
    location = _new_array(nests, name, dims)
    for i, element_numbers in enumerate(nests.shapes.index_combinations(dims)):
        value = nests.outermost.operand_of(nests.shapes.element_at(name, element_numbers))
        nests.outermost.store(replace(location, offset=i), value)
    return location


def _state_nests(layout: Layout) -> Nests:
    """Return what writes expressions of everything in a state of the march."""
    names, model, places = LawNames(layout, layout.record), layout.model, dict[str, Location]()

    def first_location(name: str) -> Location:
        if name.removeprefix(drive_slope("")) not in model.shaped.drives:
            return names.first_location(name)
        if name not in places:
            places[name] = _stage_drive(nests, name)
        return places[name]

    nests = Nests(motion_shapes(model) if has_loops(model) else model.shapes, names, first_location)
    return nests


def _write_derived(nests: Nests, layout: Layout, first: int, left_out: Container[str] = ()) -> None:
    """Write energies, observables and gaps to `z`, of a model with dimensions in loops; some may be left out."""
    if has_loops(layout.model):
        results, column = [], first
        for name, (dims, tree) in layout.derived_quantities.items():
            if name not in left_out:
                results.append((name, dims, tree, Location("z", column)))
            column += math.prod(layout.model.shapes.shape(dims))
        with suppress(UnprintedError):
            _state_nests(layout).results(results)  # of lines that are thrown away
            nests.results(results)
            return
    lines = nests.outermost
    for i, (name, tree) in enumerate(layout.derived.items()):
        if name not in left_out:
            lines.store(Location("z", first + i), lines.value(tree))


def expanded(layout: Layout, degree: int) -> Expansion:
    """Write the Taylor coefficients of the motion to `w`; where loops have none, those of the elements one by one."""
    coordinates, states = layout.coordinates.size, layout.states.size
    motion_of = Motion(coordinates, states)
    with suppress(UnexpandedError):
        return expansion(forces(layout, arrays=True), motion_of, degree, fused=not layout.is_doubled)
    return expansion(forces_by_elements(layout), motion_of, degree, fused=not layout.is_doubled)


def linearised(layout: Layout, array: str = "e", first: int = 0) -> Program:
    """Write the forces with their exact derivatives, which go to `e`, or to another array from `first` on."""
    model = layout.model
    lines = write_assignments(layout, (*motion(model), *derivative_assignments(model)))
    for name in layout.evaluation:
        lines.store(Location("z", layout.record.offset_of(name)), lines.operand_of(name))
    for i, name in enumerate(jacobian_names(model).values()):
        lines.store(Location(array, first + i), lines.operand_of(name))
    return Program("linearised", "What `forces` gives, and its derivatives by the state.", tuple(lines.lines))


def changes(layout: Layout, first: int) -> Program:
    """Write the derivatives of forces along a direction, which begins at `first` in `w`: to `z`, as forces are.

    The state is one at which forces were evaluated. One product with the Jacobian, however many entries it has.
    """
    about = "Derivatives along a direction of what `forces` gives."
    record, quantities = layout.record, changes_of_quantities(layout.model)
    shapes, names = shapes_of_changes(layout.model), LawNames(layout, record)

    def location_of(name: str) -> Location | None:
        if not name.startswith(change_name("")):
            return names.location_of(name)
        number = record.offset_of(name.removeprefix(change_name("")))
        return Location("w", first + number) if number < layout.used.size else Location("z", number)

    def first_location(name: str) -> Location:
        location = location_of(shapes.first(name))
        assert location is not None  # noqa: S101 - what expressions name was checked
        return location

    def find(lines: Assignments, name: str) -> Operand:
        location = location_of(name)
        return names(lines, name) if location is None else lines.load(location)

    nests = Nests(shapes, find, first_location)
    try:
        nests.results((name, dims, tree, first_location(name)) for name, dims, tree in quantities)
    except UnprintedError:
        nests = Nests(shapes, find, first_location)
        for name, dims, tree in quantities:
            for i, element_numbers in enumerate(shapes.index_combinations(dims)):
                element_place = replace(first_location(name), offset=first_location(name).offset + i)
                nests.outermost.store(element_place, nests.outermost.value(at_element(tree, element_numbers, shapes)))
    return Program("changes", about, tuple(nests.lines), local=nests.local, tables=nests.tables)


def events(layout: Layout) -> Program:
    """Write the event functions."""
    about = "The function of every event."
    if has_loops(layout.model) and (program := _of_wholes("detect", about, layout, events_of_quantities(layout.model))):
        return program
    trees = [detector.looked_at for detector in layout.watched]
    return _program_of_trees("detect", about, layout, trees, python_values(layout.model))


def event_rates(layout: Layout) -> Program:
    """Write the time derivatives of the event functions along the motion, and those of the observables."""
    model, about = layout.model, "The time derivatives of event functions and observables."
    if has_loops(model):
        observed = [(block.name, *layout.derived_quantities[block.name]) for block in layout.followed.blocks]
        rates = rates_of_quantities(model, [*events_of_quantities(model), *observed])
        if rates is not None and (program := _of_wholes("slopes", about, layout, rates)):
            return program
    trees = [function_rate(model, entry) for entry in layout.watched]
    trees += (model.rate_of(model.observables[name]) for name in layout.followed)
    for name in layout.tracked:
        trees += argument_motion(model, name)
    return _program_of_trees(
        "slopes", about, layout, trees, {entry.name: entry.value for entry in differentiated_reactions(model)}
    )


def _of_wholes(name: str, about: str, layout: Layout, quantities: Iterable[QuantityTree]) -> Program | None:
    """Write quantities to `z`, one after the other, in loops; None where their elements are to be written out."""
    nests, results, count = _state_nests(layout), list[Result](), 0
    for quantity, dims, tree in quantities:
        results.append((quantity, dims, tree, Location("z", count)))
        count += math.prod(layout.model.shapes.shape(dims))
    try:
        nests.results(results)
    except UnprintedError:
        return None
    return Program(name, about, tuple(nests.lines), local=nests.local, tables=nests.tables, sound=(0, count))


def touching(layout: Layout) -> Program:
    """Write the numbers of contacts and friction elements at a state, one table after another."""
    trees = [tree for part in reaction_table(layout.model) for tree in part]
    inner = {assignment.name: assignment.value for assignment in motion(layout.model)} if layout.reactions else {}
    about = "Gaps, rates, coefficients and matrices of contacts and friction."
    return _program_of_trees("touching", about, layout, trees, inner, layout.used)


def values_of(layout: Layout, trees: Iterable[Node]) -> Program:
    """Write expressions of a state, and of what forces and accelerations are there."""
    inner = {assignment.name: assignment.value for assignment in motion(layout.model)}
    return _program_of_trees("values", "Values of expressions at a state.", layout, trees, inner, layout.used)


def resets(layout: Layout) -> Program:
    """Write what events set the state to, in the order of `Layout.resets`, then what controllers do."""
    model = layout.model
    trees = []
    for name, target in layout.resets:
        tree = model.expanded(model.events[name].reset[target])
        trees.append(tree if model.events[name].every is None else with_whole_numbers(tree))
    trees += [with_whole_numbers(model.expanded(change.value)) for change in layout.ticking]
    about = "What events and controllers set the state to." if layout.ticking else "What events set the state to."
    return _program_of_trees("resets", about, layout, trees)


def derived(layout: Layout) -> Program:
    """Write energies, observables and gaps of a state; of smooth switches the function and whether it decides."""
    nests, count = _state_nests(layout), len(layout.derived)
    lines = nests.outermost
    _write_derived(nests, layout, 0)
    for switch in layout.smooth:
        for tree in (switch.function, decides(layout.model, switch)):
            lines.store(Location("z", count), lines.value(tree))
            count += 1
    about = "Energies, observables and gaps of a state."
    return Program("derived", about, tuple(nests.lines), local=nests.local, tables=nests.tables, sound=(0, count))


def _write_passages(lines: Assignments, layout: Layout, first: int, reached: Operand) -> None:
    """Write for each switch declared smooth its side, how often it was passed, and when first."""
    for i, switch in enumerate(layout.smooth):
        places = [Location("w", first + 3 * i + k) for k in range(3)]
        side, count, time = (lines.load(location) for location in places)
        value, matters = lines.value(switch.function), lines.value(decides(layout.model, switch))
        below = lines.compute("less", lines.compute("multiply", side, value), 0.0)
        passed = lines.compute("choose", reached, lines.compute("choose", below, matters, 0.0), 0.0)
        new = lines.compute("less", lines.compute("subtract", count, passed), 0.0)
        lines.store(places[1], lines.compute("add", count, passed))
        lines.store(places[2], lines.compute("choose", new, lines.operand_of("t"), time))
        now = lines.compute("choose", lines.compute("less", value, 0.0), -1.0, side)
        now = lines.compute("choose", lines.compute("more", value, 0.0), 1.0, now)
        lines.store(places[0], lines.compute("multiply", now, matters))


def row(layout: Layout, memory: int, *, energies: bool = True) -> Program:
    """Write a row of the log: the state with energies and observables, and for a step its error and its effort.

    `memory` is where in `w` the numbers of switches declared smooth begin; without `energies` their places keep
    whatever they hold, and are not judged.
    """
    first = len(("time", "step_size"))
    nests = _state_nests(layout)
    lines = nests.outermost
    step = lines.load(Location("at", AT.index("h")))
    lines.store(Location("z", 0), lines.operand_of("t"))
    lines.store(Location("z", 1), step)
    state_copy = Load("_kept", loop_element("y")), StoreTo(loop_element("z", first), "_kept")
    copied = Loop("i", layout.state.size, state_copy)
    first += layout.state.size
    left_out = [] if energies else [name for name in layout.derived if name in ENERGIES]
    _write_derived(nests, layout, first, left_out)
    sound = (first + len(left_out), len(layout.derived) - len(left_out))
    first += len(layout.derived)
    body: list[Instruction] = [copied]
    if layout.errors:
        lines.store(Location("z", first), lines.load(Location("at", AT.index("norm"))))
        reached = lines.compute("more", step, 0.0)  # a row reached by a step, which has an error
        error = (
            Load("_error", loop_element("e")),
            Compute("_made", "choose", (reached, "_error", 0.0)),
            StoreTo(loop_element("z", first + 1), "_made"),
        )
        body.append(Loop("i", layout.used.size, error))
        first += layout.errors.size
    if layout.effort:
        lines.store(Location("z", first), lines.load(Location("at", AT.index("turns"))))
        first += layout.effort.size
    if layout.deviations:
        lines.store(Location("z", first), lines.load(Location("at", DEVIATION)))
        first += layout.deviations.size
    if layout.low_parts:
        low_start = layout.used.size + layout.evaluation.size
        lines.store(Location("z", first), lines.load(Location("at", len(AT) + AT.index("t"))))
        left = Load("_rest", loop_element("y", low_start)), StoreTo(loop_element("z", first + 1), "_rest")
        body.append(Loop("i", layout.used.size, left))
    if layout.smooth:
        _write_passages(lines, layout, memory, lines.compute("more", step, 0.0))
    body[0:0] = lines.lines
    return Program(
        "row", "A row of the log.", tuple(body), local=nests.local, tables=nests.tables, sound=sound, spread=True
    )


def _program_of_trees(
    name: str,
    about: str,
    layout: Layout,
    trees: Iterable[Node],
    inner: Mapping[str, Any] | None = None,
    state_blocks: Blocks | None = None,
) -> Program:
    lines = Assignments(LawNames(layout, layout.record if state_blocks is None else state_blocks, inner or {}))
    count = 0
    for count, tree in enumerate(trees, start=1):
        lines.store(Location("z", count - 1), lines.value(tree))
    return Program(name, about, tuple(lines.lines), sound=(0, count))


def write_assignments(
    layout: Layout,
    assignments: Iterable[Assignment],
    *,
    state: str = "y",
    time: str = "t",
    prefix: str = "_",
    operands: Mapping[str, Operand] | None = None,
) -> Assignments:
    """Write assignments, whose expressions read what is in a state, constants and tables besides each other.

    They read the state from one of the arrays, the time from one of the numbers of `at`, and what is given by name.
    """
    lines = Assignments(LawNames(layout, layout.used, None, state, time), prefix)
    for name, value in (operands or {}).items():
        lines.name(name, value)
    for assignment in assignments:
        if isinstance(assignment.value, Function):
            lines.name(assignment.name, call_python_function(lines, assignment.value))
        else:
            lines.assign(assignment.name, assignment.value)
    return lines

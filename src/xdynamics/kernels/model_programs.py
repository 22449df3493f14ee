"""The functions of a model's law: forces, their derivatives, event functions, energies and observables.

A name in an expression is read from the state, the constants, a table, or the march's past.
"""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

from xdynamics.expressions import Node, derivative
from xdynamics.expressions.calculus import ONE
from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.jets import Expansion, Motion, UnexpandedError, expansion
from xdynamics.kernels.layout import Layout, past_degree
from xdynamics.kernels.nest_loops import UnprintedError
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
from xdynamics.model.constraints import Assignment
from xdynamics.model.delays import argument_before, in_history, value_before
from xdynamics.model.detectors import argument_motion, differentiated_reactions, function_rate, python_values
from xdynamics.model.drive_arguments import CLOCK
from xdynamics.model.kinks import with_whole_numbers
from xdynamics.model.linearisation import derivative_assignments, jacobian_names
from xdynamics.model.motion import (
    before_start,
    change_name,
    changes_of_quantities,
    constant_names,
    decides,
    delayed_names,
    drive_slope,
    events_of_quantities,
    motion,
    motion_shapes,
    moves_by_quantities,
    rates_of_quantities,
    shapes_of_changes,
)
from xdynamics.model.reactions import reaction_table
from xdynamics.model.regime_model import watched_by
from xdynamics.model.regimes import REGIME_NUMBER
from xdynamics.schema import ENERGIES
from xdynamics.shapes import at_element
from xdynamics.shapes.blocks import Blocks

PYTHON = "python_"  # prefix of the names of functions passed in


def call_python_function(lines: Assignments, function: Function) -> Operand:
    """Call a function that was passed in."""
    return lines.compute(PYTHON + function.name, *(lines.operand_of(argument) for argument in function.arguments))


class LawNames:
    """Resolves the names in a law's expressions: in `at`, in the state, among the constants, in a table.

    Any other name is computed where it first occurs, from the assignments `inner`.
    """

    def __init__(
        self,
        layout: Layout,
        state_blocks: Blocks,
        inner: Mapping[str, Any] | None = None,
        state: str = "y",
        time: str = "t",
    ) -> None:
        self._state, self._time = state, time
        self._layout = layout
        self._known = state_blocks
        self._inner = inner or {}
        self._kept = {switch.drive for switch in watched_by(layout.model)}
        self._drives = {name: i for i, name in enumerate(layout.drives)}
        self._constants = constant_names(layout.model)
        self._delayed = delayed_names(layout.model)

    def _delayed_value(self, lines: Assignments, name: str, delay: int, owner: str) -> Operand:
        """Write a delayed value, its time derivative, or its time: from the march's past or, before the start, its history."""
        layout, model, clock = self._layout, self._layout.model, value_before(delay, "t")
        if name == clock:
            return lines.compute("subtract", lines.operand_of("t"), lines.value(model.delays[delay]))
        derived = name != value_before(delay, owner)
        if owner in self._drives:
            argument, number = (
                lines.value(argument_before(model.elements.looked_up_at[owner], model.elements.moving, delay)),
                self._drives[owner],
            )
            piece = lines.compute("find_piece", argument, number)
            return lines.compute("slope_at" if derived else "value_at", argument, piece, number)
        where = lines.operand_of(clock), len(layout.drives) + delay, layout.used.offset_of(owner), layout.used.size
        past = lines.compute("past_slope_at" if derived else "past_at", *where, past_degree(layout))
        tree = before_start(model, owner, delay)
        history_value = lines.value(derivative(tree, {clock: ONE}) if derived else tree)
        return lines.compute(
            "choose", lines.compute("more", lines.operand_of(in_history(delay)), 0.0), history_value, past
        )

    def location_of(self, name: str) -> Location | None:
        """Return where a number is, or the first of a quantity with dimensions."""
        if name in ("t", REGIME_NUMBER):
            return Location("at", AT.index(self._time if name == "t" else "regime"))
        if name not in self._drives and (index := self._known.find_offset(name)) is not None:
            return Location(self._state, index)
        index = self._constants.find_offset(name)
        return None if index is None else Location("p", index)

    def first_location(self, name: str) -> Location:
        """Return where the numbers of a quantity with dimensions begin."""
        location = self.location_of(motion_shapes(self._layout.model).first(name))
        assert location is not None  # noqa: S101 - what expressions name was checked
        return location

    def __call__(self, lines: Assignments, name: str) -> Operand:
        """Return the operand of a name where it first occurs."""
        if (location := self.location_of(name)) is not None:
            return lines.load(location, name)
        if name in self._inner:
            inner = self._inner[name]
            return call_python_function(lines, inner) if isinstance(inner, Function) else lines.value(inner)
        if (delayed := self._delayed.get(name)) is not None:
            return self._delayed_value(lines, name, *delayed)
        drive = name.removeprefix(drive_slope(""))
        number, argument = self._drives[drive], self._layout.model.elements.looked_up_at[drive]
        argument_value = lines.value(argument)
        operation = "value_at" if drive == name else "slope_at"
        # where the march lands on ends of pieces, one piece holds throughout a step: a jump falls between steps
        if argument == CLOCK or (drive in self._kept and self._layout.model.elements.drives[drive].outside != "error"):
            return lines.compute(operation, argument_value, lines.compute("piece_of", number), number)
        looked_up = lines.compute(
            operation, argument_value, lines.compute("find_piece", argument_value, number), number
        )
        if drive not in self._kept:
            return looked_up
        # outside the table there is no piece: the lookup is nan, and stays nan times 0
        value = lines.compute(operation, argument_value, lines.compute("piece_of", number), number)
        return lines.compute("add", value, lines.compute("multiply", 0.0, looked_up))


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
    lines = write_assignments(layout, motion(layout.model.elements))
    for name in layout.evaluation:
        lines.store(Location("z", layout.record.offset_of(name)), lines.operand_of(name))
    return Program("forces", "", tuple(lines.lines))


def has_loops(model: Model) -> bool:
    """Whether the law of a model with dimensions is printed in loops; else its elements are written out."""
    return bool(model.shapes.dims) and moves_by_quantities(model)


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
    drives, motion_of, read = layout.model.statement.drives, motion(layout.model), set[str]()
    result_names = [*drives, *(item.name for item in motion_of)]
    result_locations = {name: Location("z", record.offset_of(shapes.first(name))) for name in result_names}

    def first_location(name: str) -> Location:
        if name in result_locations:
            read.add(name)
        return result_locations.get(name) or names.first_location(name)

    nests, results = Nests(shapes, names, first_location), []
    for item in motion_of:
        results.append((item.name, item.dims, item.tree, result_locations[item.name]))
        if item.name in staged_names:
            result_locations[item.name] = _new_array(nests, item.name, item.dims)
            results.append((item.name, item.dims, item.tree, result_locations[item.name]))
    for name in layout.drives:
        nests.outermost.store(Location("z", record.offset_of(name)), nests.outermost.operand_of(name))
    for name in drives:
        if name in staged_names:
            result_locations[name] = _stage_drive(nests, name)
    nests.results(results)
    return nests, frozenset(read)


def _new_array(nests: Nests, name: str, dims: tuple[str, ...]) -> Location:
    """Return the first location of a new array of a program, for a quantity with dimensions."""
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
    """Return the writer of expressions of all numbers in a state of the march."""
    names, model, places = LawNames(layout, layout.record), layout.model, dict[str, Location]()

    def first_location(name: str) -> Location:
        if name.removeprefix(drive_slope("")) not in model.statement.drives:
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
            # tried elsewhere first: a failure halfway would leave its lines in `nests`
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
    lines = write_assignments(layout, (*motion(model.elements), *derivative_assignments(model)))
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
        nests.results((item.name, item.dims, item.tree, first_location(item.name)) for item in quantities)
    except UnprintedError:
        nests = Nests(shapes, find, first_location)
        for item in quantities:
            begin = first_location(item.name)
            for i, element_numbers in enumerate(shapes.index_combinations(item.dims)):
                value = nests.outermost.value(at_element(item.tree, element_numbers, shapes))
                nests.outermost.store(replace(begin, offset=begin.offset + i), value)
    return Program("changes", about, tuple(nests.lines), local=nests.local, tables=nests.tables)


def events(layout: Layout) -> Program:
    """Write the event functions."""
    about = "The function of every event."
    if has_loops(layout.model) and (
        program := _quantity_program("detect", about, layout, events_of_quantities(layout.model))
    ):
        return program
    trees = [detector.looked_at for detector in layout.watched]
    return _program_of_trees("detect", about, layout, trees, python_values(layout.model))


def event_rates(layout: Layout) -> Program:
    """Write the time derivatives of the event functions along the motion, and those of the observables."""
    model, about = layout.model, "The time derivatives of event functions and observables."
    if has_loops(model):
        observed = [
            Assignment(block.name, tree, dims)
            for block in layout.followed.blocks
            for dims, tree in [layout.derived_quantities[block.name]]
        ]
        rates = rates_of_quantities(model, [*events_of_quantities(model), *observed])
        if rates is not None and (program := _quantity_program("slopes", about, layout, rates)):
            return program
    trees = [function_rate(model, entry) for entry in layout.watched]
    trees += (model.elements.rate_of(model.elements.observables[name]) for name in layout.followed)
    for name in layout.tracked:
        trees += argument_motion(model, name)
    return _program_of_trees(
        "slopes", about, layout, trees, {entry.name: entry.value for entry in differentiated_reactions(model)}
    )


def _quantity_program(name: str, about: str, layout: Layout, quantities: Iterable[Assignment]) -> Program | None:
    """Write quantities to `z`, one after the other, in loops; None where their elements are to be written out."""
    nests, results, count = _state_nests(layout), list[Result](), 0
    for item in quantities:
        results.append((item.name, item.dims, item.tree, Location("z", count)))
        count += math.prod(layout.model.shapes.shape(item.dims))
    try:
        nests.results(results)
    except UnprintedError:
        return None
    return Program(name, about, tuple(nests.lines), local=nests.local, tables=nests.tables, sound=(0, count))


def touching(layout: Layout) -> Program:
    """Write the numbers of contacts and friction elements at a state, one table after another."""
    trees = [tree for part in reaction_table(layout.model) for tree in part]
    inner = (
        {assignment.name: assignment.value for assignment in motion(layout.model.elements)} if layout.reactions else {}
    )
    about = "Gaps, rates, coefficients and matrices of contacts and friction."
    return _program_of_trees("touching", about, layout, trees, inner, layout.used)


def values_of(layout: Layout, trees: Iterable[Node]) -> Program:
    """Write expressions of a state, and of its forces and accelerations."""
    inner = {assignment.name: assignment.value for assignment in motion(layout.model.elements)}
    return _program_of_trees("values", "Values of expressions at a state.", layout, trees, inner, layout.used)


def resets(layout: Layout) -> Program:
    """Write the values that events set, in the order of `Layout.resets`, then those of controllers."""
    model = layout.model
    trees = []
    for name, target in layout.resets:
        tree = model.elements.expanded(model.elements.events[name].reset[target])
        trees.append(tree if model.elements.events[name].every is None else with_whole_numbers(tree))
    trees += [with_whole_numbers(model.elements.expanded(change.value)) for change in layout.ticking]
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
    # before the loops, which read `reached`
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
    """Write assignments, whose expressions read a state, constants, tables and earlier assignments.

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

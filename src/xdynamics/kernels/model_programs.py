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
from xdynamics.kernels.law_names import LawNames, called
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
    Loop,
    Operand,
    Place,
    Program,
    StoreTo,
    element,
)
from xdynamics.model import Function, Model
from xdynamics.model.derivatives import jacobian, slopes
from xdynamics.model.detectors import argument_motion, followed, function_rate, python_values
from xdynamics.model.mass import Assignment
from xdynamics.model.motion import constant_names, decides, motion, slope
from xdynamics.model.reactions import table
from xdynamics.model.regime_model import watched_by
from xdynamics.model.whole import (
    Quantity,
    change,
    changes_of_wholes,
    events_of_wholes,
    has_wholes,
    motion_of_wholes,
    rates_of_wholes,
    shapes_of,
    shapes_of_changes,
)
from xdynamics.model.whole_numbers import with_whole_numbers
from xdynamics.schema import ENERGIES
from xdynamics.shapes import at
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
    lines = assigned(layout, motion(layout.model))
    for name in layout.evaluation:
        lines.store(Place("z", layout.record.place(name)), lines.named(name))
    return Program("forces", "", tuple(lines.lines))


def has_loops(model: Model) -> bool:
    """Whether the law of a model with dimensions is printed in loops; else its elements are written out."""
    written_out = model.contacts or model.frictions or model.constraints or model.python_functions or watched_by(model)
    return has_wholes(model) and not written_out


def _in_loops(layout: Layout, *, arrays: bool) -> Nests | None:
    """Write the motion of a model with dimensions in loops; None of one whose elements are written out."""
    if not has_loops(layout.model):
        return None
    try:
        nests, read = _motion_in_loops(layout, frozenset())
        return _motion_in_loops(layout, read)[0] if arrays and read else nests
    except UnprintedError:
        return None


def _motion_in_loops(layout: Layout, apart: frozenset[str]) -> tuple[Nests, frozenset[str]]:
    """Write the motion in loops, some results to arrays too; return also those that other loops read."""
    names, record, shapes = LawNames(layout, layout.used), layout.record, shapes_of(layout.model)
    drives, motion_of, read = layout.model.shaped.drives, [*motion_of_wholes(layout.model)], set[str]()
    known = [*drives, *(name for name, *_ in motion_of)]
    written = {name: Place("z", record.place(shapes.first(name))) for name in known}

    def first(name: str) -> Place:
        if name in written:
            read.add(name)
        return written.get(name) or names.first(name)

    nests, results = Nests(shapes, names, first), []
    for name, dims, tree in motion_of:
        results.append((name, dims, tree, written[name]))
        if name in apart:
            written[name] = _array(nests, name, dims)
            results.append((name, dims, tree, written[name]))
    for name in layout.drives:
        nests.outermost.store(Place("z", record.place(name)), nests.outermost.named(name))
    for name in drives:
        if name in apart:
            written[name] = _looked_up(nests, name)
    nests.results(results)
    return nests, frozenset(read)


def _array(nests: Nests, name: str, dims: tuple[str, ...]) -> Place:
    """Return the first place of a new array of a program, for a quantity with dimensions."""
    place = Place(f"of_{name}")
    nests.local[place.array] = math.prod(nests.shapes.shape(dims))
    return place


def _looked_up(nests: Nests, name: str) -> Place:
    """Look up a drive of each element, before all loops; return where the first is."""
    dims = nests.shapes.dims[name]
    place = _array(nests, name, dims)
    for i, here in enumerate(nests.shapes.places(dims)):
        value = nests.outermost.named(nests.shapes.element(name, here))
        nests.outermost.store(replace(place, offset=i), value)
    return place


def _of_states(layout: Layout) -> Nests:
    """Return what writes expressions of everything in a state of the march."""
    names, model, places = LawNames(layout, layout.record), layout.model, dict[str, Place]()

    def first(name: str) -> Place:
        if name.removeprefix(slope("")) not in model.shaped.drives:
            return names.first(name)
        if name not in places:
            places[name] = _looked_up(nests, name)
        return places[name]

    nests = Nests(shapes_of(model) if has_loops(model) else model.shapes, names, first)
    return nests


def _derived(nests: Nests, layout: Layout, first: int, left_out: Container[str] = ()) -> None:
    """Write energies, observables and gaps to `z`, of a model with dimensions in loops; some may be left out."""
    if has_loops(layout.model):
        results, place = [], first
        for name, (dims, tree) in layout.wholes.items():
            if name not in left_out:
                results.append((name, dims, tree, Place("z", place)))
            place += math.prod(layout.model.shapes.shape(dims))
        with suppress(UnprintedError):
            _of_states(layout).results(results)  # of lines that are thrown away
            nests.results(results)
            return
    lines = nests.outermost
    for i, (name, tree) in enumerate(layout.derived.items()):
        if name not in left_out:
            lines.store(Place("z", first + i), lines.value(tree))


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
    lines = assigned(layout, (*motion(model), *slopes(model)))
    for name in layout.evaluation:
        lines.store(Place("z", layout.record.place(name)), lines.named(name))
    for i, name in enumerate(jacobian(model).values()):
        lines.store(Place(array, first + i), lines.named(name))
    return Program("linearised", "What `forces` gives, and its derivatives by the state.", tuple(lines.lines))


def changes(layout: Layout, first: int) -> Program:
    """Write the derivatives of forces along a direction, which begins at `first` in `w`: to `z`, as forces are.

    The state is one at which forces were evaluated. One product with the Jacobian, however many entries it has.
    """
    about = "Derivatives along a direction of what `forces` gives."
    record, quantities = layout.record, changes_of_wholes(layout.model)
    shapes, names = shapes_of_changes(layout.model), LawNames(layout, record)

    def place(name: str) -> Place | None:
        if not name.startswith(change("")):
            return names.place(name)
        number = record.place(name.removeprefix(change("")))
        return Place("w", first + number) if number < layout.used.size else Place("z", number)

    def of_first(name: str) -> Place:
        found = place(shapes.first(name))
        assert found is not None  # noqa: S101 - what expressions name was checked
        return found

    def find(lines: Assignments, name: str) -> Operand:
        found = place(name)
        return names(lines, name) if found is None else lines.load(found)

    nests = Nests(shapes, find, of_first)
    try:
        nests.results((name, dims, tree, of_first(name)) for name, dims, tree in quantities)
    except UnprintedError:
        nests = Nests(shapes, find, of_first)
        for name, dims, tree in quantities:
            for i, here in enumerate(shapes.places(dims)):
                element_place = replace(of_first(name), offset=of_first(name).offset + i)
                nests.outermost.store(element_place, nests.outermost.value(at(tree, here, shapes)))
    return Program("changes", about, tuple(nests.lines), local=nests.local, tables=nests.tables)


def events(layout: Layout) -> Program:
    """Write the event functions."""
    about = "The function of every event."
    if has_loops(layout.model) and (program := _of_wholes("detect", about, layout, events_of_wholes(layout.model))):
        return program
    trees = [detector.looked_at for detector in layout.watched]
    return _returning("detect", about, layout, trees, python_values(layout.model))


def event_rates(layout: Layout) -> Program:
    """Write the time derivatives of the event functions along the motion, and those of the observables."""
    model, about = layout.model, "The time derivatives of event functions and observables."
    if has_loops(model):
        observed = [(own.name, *layout.wholes[own.name]) for own in layout.followed.blocks]
        rates = rates_of_wholes(model, [*events_of_wholes(model), *observed])
        if rates is not None and (program := _of_wholes("slopes", about, layout, rates)):
            return program
    trees = [function_rate(model, entry) for entry in layout.watched]
    trees += (model.rate_of(model.observables[name]) for name in layout.followed)
    for name in layout.tracked:
        trees += argument_motion(model, name)
    return _returning("slopes", about, layout, trees, {entry.name: entry.value for entry in followed(model)})


def _of_wholes(name: str, about: str, layout: Layout, quantities: Iterable[Quantity]) -> Program | None:
    """Write quantities to `z`, one after the other, in loops; None where their elements are to be written out."""
    nests, results, count = _of_states(layout), list[Result](), 0
    for quantity, dims, tree in quantities:
        results.append((quantity, dims, tree, Place("z", count)))
        count += math.prod(layout.model.shapes.shape(dims))
    try:
        nests.results(results)
    except UnprintedError:
        return None
    return Program(name, about, tuple(nests.lines), local=nests.local, tables=nests.tables, sound=(0, count))


def touching(layout: Layout) -> Program:
    """Write the numbers of contacts and friction elements at a state, one table after another."""
    trees = [tree for part in table(layout.model) for tree in part]
    inner = {assignment.name: assignment.value for assignment in motion(layout.model)} if layout.reactions else {}
    about = "Gaps, rates, coefficients and matrices of contacts and friction."
    return _returning("touching", about, layout, trees, inner, layout.used)


def values_of(layout: Layout, trees: Iterable[Node]) -> Program:
    """Write expressions of a state, and of what forces and accelerations are there."""
    inner = {assignment.name: assignment.value for assignment in motion(layout.model)}
    return _returning("values", "Values of expressions at a state.", layout, trees, inner, layout.used)


def resets(layout: Layout) -> Program:
    """Write what events set the state to, in the order of `Layout.resets`, then what controllers do."""
    model = layout.model
    trees = []
    for name, target in layout.resets:
        tree = model.expanded(model.events[name].reset[target])
        trees.append(tree if model.events[name].every is None else with_whole_numbers(tree))
    trees += [with_whole_numbers(model.expanded(change.value)) for change in layout.ticking]
    about = "What events and controllers set the state to." if layout.ticking else "What events set the state to."
    return _returning("resets", about, layout, trees)


def derived(layout: Layout) -> Program:
    """Write energies, observables and gaps of a state; of smooth switches the function and whether it decides."""
    nests, count = _of_states(layout), len(layout.derived)
    lines = nests.outermost
    _derived(nests, layout, 0)
    for switch in layout.smooth:
        for tree in (switch.function, decides(layout.model, switch)):
            lines.store(Place("z", count), lines.value(tree))
            count += 1
    about = "Energies, observables and gaps of a state."
    return Program("derived", about, tuple(nests.lines), local=nests.local, tables=nests.tables, sound=(0, count))


def _passed(lines: Assignments, layout: Layout, first: int, reached: Operand) -> None:
    """Write for each switch declared smooth its side, how often it was passed, and when first."""
    for i, switch in enumerate(layout.smooth):
        places = [Place("w", first + 3 * i + k) for k in range(3)]
        side, count, time = (lines.load(place) for place in places)
        value, matters = lines.value(switch.function), lines.value(decides(layout.model, switch))
        below = lines.compute("less", lines.compute("multiply", side, value), 0.0)
        passed = lines.compute("choose", reached, lines.compute("choose", below, matters, 0.0), 0.0)
        new = lines.compute("less", lines.compute("subtract", count, passed), 0.0)
        lines.store(places[1], lines.compute("add", count, passed))
        lines.store(places[2], lines.compute("choose", new, lines.named("t"), time))
        now = lines.compute("choose", lines.compute("less", value, 0.0), -1.0, side)
        now = lines.compute("choose", lines.compute("more", value, 0.0), 1.0, now)
        lines.store(places[0], lines.compute("multiply", now, matters))


def row(layout: Layout, memory: int, *, energies: bool = True) -> Program:
    """Write a row of the log: the state with energies and observables, and for a step its error and its effort.

    `memory` is where in `w` the numbers of switches declared smooth begin; without `energies` their places keep
    whatever they hold, and are not judged.
    """
    first = len(("time", "step_size"))
    nests = _of_states(layout)
    lines = nests.outermost
    step = lines.load(Place("at", AT.index("h")))
    lines.store(Place("z", 0), lines.named("t"))
    lines.store(Place("z", 1), step)
    kept = Load("_kept", element("y")), StoreTo(element("z", first), "_kept")
    copied = Loop("i", layout.state.size, kept)
    first += layout.state.size
    left_out = [] if energies else [name for name in layout.derived if name in ENERGIES]
    _derived(nests, layout, first, left_out)
    sound = (first + len(left_out), len(layout.derived) - len(left_out))
    first += len(layout.derived)
    body: list[Instruction] = [copied]
    if layout.errors:
        lines.store(Place("z", first), lines.load(Place("at", AT.index("norm"))))
        reached = lines.compute("more", step, 0.0)  # a row reached by a step, which has an error
        error = (
            Load("_error", element("e")),
            Compute("_made", "choose", (reached, "_error", 0.0)),
            StoreTo(element("z", first + 1), "_made"),
        )
        body.append(Loop("i", layout.used.size, error))
        first += layout.errors.size
    if layout.effort:
        lines.store(Place("z", first), lines.load(Place("at", AT.index("turns"))))
        first += layout.effort.size
    if layout.deviations:
        lines.store(Place("z", first), lines.load(Place("at", DEVIATION)))
        first += layout.deviations.size
    if layout.rests:
        rest = layout.used.size + layout.evaluation.size
        lines.store(Place("z", first), lines.load(Place("at", len(AT) + AT.index("t"))))
        left = Load("_rest", element("y", rest)), StoreTo(element("z", first + 1), "_rest")
        body.append(Loop("i", layout.used.size, left))
    if layout.smooth:
        _passed(lines, layout, memory, lines.compute("more", step, 0.0))
    body[0:0] = lines.lines
    return Program(
        "row", "A row of the log.", tuple(body), local=nests.local, tables=nests.tables, sound=sound, spread=True
    )


def _returning(
    name: str,
    about: str,
    layout: Layout,
    trees: Iterable[Node],
    inner: Mapping[str, Any] | None = None,
    known: Blocks | None = None,
) -> Program:
    lines = Assignments(LawNames(layout, layout.record if known is None else known, inner or {}))
    count = 0
    for count, tree in enumerate(trees, start=1):
        lines.store(Place("z", count - 1), lines.value(tree))
    return Program(name, about, tuple(lines.lines), sound=(0, count))


def assigned(
    layout: Layout,
    assignments: Iterable[Assignment],
    *,
    state: str = "y",
    time: str = "t",
    prefix: str = "_",
    given: Mapping[str, Operand] | None = None,
) -> Assignments:
    """Write assignments, whose expressions read what is in a state, constants and tables besides each other.

    They read the state from one of the arrays, the time from one of the numbers of `at`, and what is given by name.
    """
    lines = Assignments(LawNames(layout, layout.used, None, state, time), prefix)
    for name, value in (given or {}).items():
        lines.name(name, value)
    for assignment in assignments:
        if isinstance(assignment.value, Function):
            lines.name(assignment.name, called(lines, assignment.value))
        else:
            lines.assign(assignment.name, assignment.value)
    return lines

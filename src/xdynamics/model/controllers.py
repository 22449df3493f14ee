"""Sampled controllers: their sections in a model file, the values they hold between ticks, and their ticks.

At a tick a controller changes its outputs and its states, each of which has keys of its own in a model file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache
from itertools import pairwise
from math import ceil, floor, lcm
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import Binary, Call, Name, Node, Number, expand, parse
from xdynamics.expressions.parser import with_unit_names
from xdynamics.faults import InputError, brief_repr
from xdynamics.model.kinds import EXPRESSION, LIMIT, QUANTITY, UNIT, Kind, Source
from xdynamics.model.parts import Controller, ControllerState, Event, Output, State
from xdynamics.model.section import DESCRIPTION, NEEDED, Key, Section
from xdynamics.units import NONE, NUMBERS, Quantity, Unit
from xdynamics.units.unit import decimal_text, exact_value

OUTPUT = Section(
    "what a controller puts out: it holds between ticks",
    "output",
    (
        Key("unit", UNIT, "of the output", NEEDED),
        Key("start", QUANTITY, "what holds before the first tick takes effect", NEEDED),
        Key(
            "value",
            EXPRESSION.with_unit("that unit"),
            "what it is set to at a tick, from what holds just before",
            NEEDED,
        ),
        Key("minimum", LIMIT.with_unit("that unit"), "what it is limited to from below", "none"),
        Key("maximum", LIMIT.with_unit("that unit"), "what it is limited to from above", "none"),
        DESCRIPTION,
    ),
    "",
    make=Output,
)
MEMORY = Section(
    "what a controller remembers from tick to tick",
    "state",
    (
        Key("unit", UNIT, "of the state", NEEDED),
        Key("start", QUANTITY, "what holds before the first tick", NEEDED),
        Key(
            "next",
            EXPRESSION.with_unit("that unit"),
            "what it is set to at a tick, from what holds just before",
            NEEDED,
        ),
        DESCRIPTION,
    ),
    "",
    make=ControllerState,
)


def entries_of(section: Section) -> Kind:
    """Return the kind of values that are a table of entries, each with the keys of a section."""
    keys_text = ", ".join(f"{key.name}{'' if key.default == NEEDED else ' (optional)'}" for key in section.keys)

    def read_entries(value: Any, key: str, source: Source) -> dict[str, Any]:
        if not isinstance(value, Mapping):
            raise InputError(f"{key} is {brief_repr(value)}, needs a table of names, each with {keys_text}")
        entries = {}
        for name, entry in value.items():
            try:
                entries[str(name)] = section.read(str(name), entry, source)
            except InputError as error:
                raise InputError(f"{section.entry} '{name}': {error}") from None
        return entries

    def write_entries(parts: Mapping[str, Any], time: Unit) -> dict[str, Any]:
        return {name: section.write(part, time) for name, part in parts.items()}

    return Kind(f"table of {section.entry}s, each with {keys_text}", read_entries, write_entries, {})


MOST_TICKS = 10_000_000  # of a run
Start = TypeVar("Start")  # a quantity, or an array of one for each of many runs
MOST_ACTIONS = 62  # each is a bit of a number at every tick
MOST_PENDING = 100  # values of one output on their way
EXACT = 1 << 53  # whole numbers up to here are floats
EVERY = "every"  # the name of its period in the expressions of a controller
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class TickChange:
    """A number that a controller's action sets: the value of an expression of the state just before the tick."""

    action: int
    target: str
    value: Node


@dataclass(frozen=True)
class Action:
    """A time at which a controller computes values, or delayed values take effect; s after the start."""

    owner: str
    first: Fraction
    every: Fraction


def controller_states(controllers: Mapping[str, Controller], time: Unit) -> dict[str, State]:
    """Return everything that controllers hold between ticks, as first-order states at rest."""
    held_entries: dict[str, tuple[Unit, str]] = {}
    for owner, controller in controllers.items():
        for name, output in controller.outputs.items():
            held_entries[name] = (
                output.unit,
                output.description or f"output of controller {owner}, held between its ticks",
            )
            for waiting in pending(name, controller):
                held_entries[waiting] = output.unit, f"computed by controller {owner} for {name}, in effect later"
        for name, memory in controller.states.items():
            held_entries[name] = memory.unit, memory.description or f"state of controller {owner}, changed at its ticks"
    return {name: State(unit, zero_rate(name, time), about) for name, (unit, about) in held_entries.items()}


def zero_rate(name: str, time: Unit) -> Node:
    """Return the rate of something that changes at ticks alone."""
    nothing = Binary("*", Number(0.0), Name(name))
    return nothing if time.dimension == NONE else Binary("/", nothing, Name("second"))


def start_values(controllers: Mapping[str, Controller]) -> dict[str, Quantity]:
    """Return the outputs and states of controllers before their first ticks."""
    values: dict[str, Quantity] = {}
    for controller in controllers.values():
        outputs = {name: output.start for name, output in controller.outputs.items()}
        values |= with_pending(outputs, {"": controller})
        values |= {name: memory.start for name, memory in controller.states.items()}
    return values


def with_pending(values: Mapping[str, Start], controllers: Mapping[str, Controller]) -> dict[str, Start]:
    """Return values at the start, each output followed by what waits for it and begins with the same value."""
    waiting = {name: values[output] for name, output in pending_outputs(controllers).items() if output in values}
    return {**values, **waiting}


def starting_from(controller: Controller, initial: Mapping[str, Quantity]) -> Controller:
    """Return a controller that holds the values at the start of a model before its first tick."""
    outputs = {name: replace(part, start=initial.get(name, part.start)) for name, part in controller.outputs.items()}
    states = {name: replace(part, start=initial.get(name, part.start)) for name, part in controller.states.items()}
    return replace(controller, outputs=outputs, states=states)


def pending(output: str, controller: Controller) -> list[str]:
    """Return the names of values of an output that are computed and not yet in effect, the newest first."""
    if controller.delay is None:
        return []
    count = ceil(exact_time(controller.delay) / exact_time(controller.every))
    return [f"{output}_pending"] if count == 1 else [f"{output}_pending_{i + 1}" for i in range(count)]


def pending_outputs(controllers: Mapping[str, Controller]) -> dict[str, str]:
    """Return the output of each value that is computed and not yet in effect; at the start it is that of the output."""
    return {
        waiting: output
        for controller in controllers.values()
        for output in controller.outputs
        for waiting in pending(output, controller)
    }


def check_in_effect(name: str, controllers: Mapping[str, Controller]) -> None:
    """Refuse a start of a value that is not yet in effect, which no text of a model has.

    Raises
    ------
    InputError
        Naming the output, whose start it has.
    """
    if name in (outputs := pending_outputs(controllers)):
        raise InputError(f"'{name}' is computed and in effect later, and starts as its output; set '{outputs[name]}'")


def tick_changes(controllers: Mapping[str, Controller]) -> tuple[TickChange, ...]:
    """Return the changes by every action, in the order of `actions`."""
    return tuple(_yield_changes(controllers))


def _yield_changes(controllers: Mapping[str, Controller]) -> Iterator[TickChange]:
    number = 0
    for controller in controllers.values():
        every = {EVERY: as_tree(controller.every)}
        for name, output in controller.outputs.items():
            waiting = pending(name, controller)
            yield TickChange(number, (waiting or [name])[0], expand(limited_value(output), every))
            for newer, older in pairwise(waiting):
                yield TickChange(number, older, Name(newer))
        for name, memory in controller.states.items():
            yield TickChange(number, name, expand(memory.next, every))
        number += 1
        if controller.delay is not None:
            for name in controller.outputs:
                yield TickChange(number, name, Name(pending(name, controller)[-1]))
            number += 1


def as_tree(quantity: Quantity) -> Node:
    """Return a quantity as an expression."""
    plain = quantity.unit.text == NUMBERS.text
    return parse(decimal_text(quantity.value) if plain else with_unit_names(str(quantity)))


def limited_value(output: Output) -> Node:
    """Return the value of an output within its bounds."""
    value = output.value
    if output.minimum is not None:
        value = Call("max", (value, output.minimum))
    return value if output.maximum is None else Call("min", (value, output.maximum))


def actions(controllers: Mapping[str, Controller]) -> tuple[Action, ...]:
    """Return the times at which controllers compute, and at which delayed outputs take effect."""
    timed_actions = []
    for name, controller in controllers.items():
        every, first = exact_time(controller.every), exact_time(controller.phase) if controller.phase else Fraction(0)
        timed_actions.append(Action(f"controller '{name}'", first, every))
        if controller.delay is not None:
            turns = len(pending(next(iter(controller.outputs)), controller)) - 1
            timed_actions.append(
                Action(f"controller '{name}'", first + exact_time(controller.delay) - turns * every, every)
            )
    return tuple(timed_actions)


def exact_time(quantity: Quantity) -> Fraction:
    """Return a time in seconds, as it is written."""
    return exact_value(quantity.value) * quantity.unit.factor


def alarms(events: Mapping[str, Event]) -> tuple[Action, ...]:
    """Return when periodic events are met, in their order."""
    timed_actions = []
    for name, event in events.items():
        if event.every is not None:
            first = event.every if event.phase is None else event.phase
            timed_actions.append(Action(f"event '{name}'", exact_time(first), exact_time(event.every)))
    return tuple(timed_actions)


def faults_of_ticks(timed_actions: Sequence[Action], start: Fraction, end: Fraction, second: str) -> list[str]:
    """Return why something cannot act in a run from one time to another, in `second`; none if all can."""
    faults = []
    for action in timed_actions:
        late = action.first > action.every and action.first > end - start
        if late or action.every > end - start:
            clause = (
                f"first acts {float(action.first)!r}{second} after"
                if late
                else f"acts every {float(action.every)!r}{second} from"
            )
            faults.append(
                f"{action.owner} {clause} the start, and the run takes {float(end - start)!r}{second}; run"
                " longer, or have it act sooner"
            )
    count = sum(_tick_count(action, start, end) for action in timed_actions)
    if count > MOST_TICKS:
        faults.append(
            f"{_owners(timed_actions)} act {count} times in the run, {MOST_TICKS} at most; have them act less often"
        )
    return faults


def _owners(timed_actions: Sequence[Action]) -> str:
    return " and ".join(dict.fromkeys(f"{action.owner.split()[0]}s" for action in timed_actions))


def _tick_count(action: Action, start: Fraction, end: Fraction) -> int:
    return max(0, floor((end - start - action.first) / action.every) + 1)


@lru_cache(maxsize=8)
def ticks(timed_actions: tuple[Action, ...], start: Fraction, end: Fraction) -> tuple[Floats, NDArray[np.int64]]:
    """Return the times of all ticks of a run, ascending, and the actions at each, as bits of a number.

    Every time is the float nearest to an exact multiple, whatever else ticks.
    """
    counts = [_tick_count(action, start, end) for action in timed_actions]
    times = [
        _multiples(start + action.first, action.every, count)
        for action, count in zip(timed_actions, counts, strict=True)
    ]
    bits = [np.full(count, 1 << number, np.int64) for number, count in enumerate(counts)]
    instants, where = np.unique(np.concatenate(times), return_inverse=True)
    masks = np.zeros(len(instants), np.int64)
    # actions may share an instant: indexed assignment in place would keep the bit of the last alone
    np.bitwise_or.at(masks, where, np.concatenate(bits))
    for array in (instants, masks):
        # cached, so that all callers share the arrays
        array.flags.writeable = False
    return instants, masks


def exact_ticks(timed_actions: tuple[Action, ...], start: Fraction, end: Fraction) -> Iterator[Fraction]:
    """Yield the exact times of ticks, action by action."""
    for action in timed_actions:
        for k in range(_tick_count(action, start, end)):
            yield start + action.first + k * action.every


def _multiples(first: Fraction, every: Fraction, count: int) -> Floats:
    """Return first + k*every for k from 0 on, each correctly rounded."""
    divisor = lcm(first.denominator, every.denominator)
    begin, step = int(first * divisor), int(every * divisor)
    # of whole numbers that floats hold exactly only the quotient is rounded; so it is by Python where they are larger
    if max(abs(begin), abs(begin + step * count), divisor) < EXACT:
        return np.array((begin + step * np.arange(count)) / divisor)
    return np.array([(begin + step * k) / divisor for k in range(count)])


def trees_of(controller: Controller) -> Iterator[tuple[str, Node | None]]:
    """Yield the expressions of a controller, each with the name that it sets."""
    for name, output in controller.outputs.items():
        yield from ((name, tree) for tree in (output.value, output.minimum, output.maximum))
    yield from ((name, memory.next) for name, memory in controller.states.items())


def with_trees(controller: Controller, make_tree: Callable[[Node], Node]) -> Controller:
    """Return a controller with other expressions in the places of its own."""

    def limit(tree: Node | None) -> Node | None:
        return None if tree is None else make_tree(tree)

    outputs = {
        name: replace(part, value=make_tree(part.value), minimum=limit(part.minimum), maximum=limit(part.maximum))
        for name, part in controller.outputs.items()
    }
    states = {name: replace(part, next=make_tree(part.next)) for name, part in controller.states.items()}
    return replace(controller, outputs=outputs, states=states)


def check_controllers(controllers: Mapping[str, Any]) -> None:
    """Check what no single controller shows: that there are no more actions than bits, and no delay of many periods.

    Raises
    ------
    InputError
    """
    for name, controller in controllers.items():
        if controller.delay is not None and controller.delay.si > MOST_PENDING * controller.every.si:
            raise InputError(
                f"controller '{name}': delay is '{controller.delay}', over {MOST_PENDING} times its period of"
                f" '{controller.every}'; give it a shorter delay, or fewer ticks"
            )
    if len(controllers) > MOST_ACTIONS // 2:
        raise InputError(f"has {len(controllers)} controllers, {MOST_ACTIONS // 2} at most")

"""The parts of a model, each a frozen record of an entry of the file."""

from __future__ import annotations

import hashlib
import inspect
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from xdynamics.expressions import Node
from xdynamics.faults import InputError
from xdynamics.model.drive_arguments import CLOCK
from xdynamics.model.drives import Table
from xdynamics.model.uncertainty import Spread
from xdynamics.units import Quantity, Unit

DIRECTIONS = ("rising", "falling", "either")
ACTIONS = ("record", "stop", "switch", "reset")
RECORD = ACTIONS[0]
STRIKE = "impact"  # the action of an event that is read as a contact
ROOT_STATES = ("reintegrate", "interpolant")
TANGENTIALS = ("frictionless", "coulomb")
IMPACT_LAWS = NEWTON, POISSON, SEQUENTIAL, ENERGETIC = ("newton", "poisson", "sequential", "energetic")
APPROACH = "approach_speed"  # the name by which a coefficient of restitution reads how fast a gap closes


@dataclass(frozen=True)
class Coordinate:
    """A coordinate of the motion, with its dimensions."""

    unit: Unit
    description: str = ""
    dims: tuple[str, ...] = ()


@dataclass(frozen=True)
class Parameter:
    """A constant of the model, or a value at the start, with its distribution if known."""

    quantity: Quantity
    spread: Spread | None = None
    description: str = ""

    @property
    def si(self) -> float:
        """The value in SI units."""
        return self.quantity.si

    @property
    def uncertainty(self) -> float:
        """The standard uncertainty in the value's own unit; 0 if none is known."""
        return 0.0 if self.spread is None else self._in_own_unit(self.spread.standard)

    @property
    def half_width(self) -> float | None:
        """Half the width between the bounds in the value's own unit; None where the model states no bounds."""
        return self._in_own_unit(self.spread.size) if self.spread is not None and self.spread.bounded else None

    def _in_own_unit(self, size: Quantity) -> float:
        return float(size.unit.factor / self.quantity.unit.factor) * size.value


@dataclass(frozen=True)
class Fitted:
    """The data that the parameters of a model were fitted to, and whether the residuals support the fit."""

    data: str = ""
    adequate: bool = True
    description: str = ""


@dataclass(frozen=True)
class Authorship:
    """Authors and terms of a model and its runs, in ACDD's words, which enter no computation."""

    creator: str = ""
    institution: str = ""
    license: str = ""
    id: str = ""
    references: str = ""
    comment: str = ""

    @classmethod
    def from_attributes(cls, attributes: Mapping[Any, Any]) -> Authorship:
        """Read the authorship from the attributes of a record."""
        return cls(**{name: str(attributes[key]) for name, key in _IN_ACDD.items() if key in attributes})

    @property
    def attributes(self) -> dict[str, str]:
        """The attributes of a record that state the authorship (ACDD 1.3, CF 1.11)."""
        return {_IN_ACDD[name]: text for name, text in vars(self).items() if text}


NOBODY = Authorship()
_IN_ACDD = {"creator": "creator_name"} | {
    name: name for name in ("institution", "license", "id", "references", "comment")
}


@dataclass(frozen=True)
class State:
    """A first-order state beside the motion; `smooth` as in `Force`.

    Its rate is an expression, or the sum of one and of terms by name, of which those that regimes list act in these
    alone. `own_rate` is then what stands beside the terms, and `acting` the terms as they are in the current regime. Of a
    rate that reads accelerations `own_rate` is what was written, and `rate` has the forces over the masses.
    """

    unit: Unit
    rate: Node
    description: str = ""
    smooth: bool = False
    dims: tuple[str, ...] = ()
    terms: Mapping[str, Node] = field(default_factory=dict)
    own_rate: Node | None = None
    acting: Mapping[str, Node] = field(default_factory=dict)

    @property
    def written_rate(self) -> Node | None:
        """The rate as it was written: without the terms, and with accelerations by their names."""
        return self.own_rate if self.terms or self.own_rate is not None else self.rate


@dataclass(frozen=True)
class Function:
    """A force component or event function in Python: a numba-compilable function of declared names, SI in and out.

    The source is evidence and is never run: to march a model that was read from a file, the function itself
    is passed, and its digest is compared first.
    """

    name: str
    arguments: tuple[str, ...]
    source: str
    digest: str
    callable: Callable[..., float] | None = field(default=None, compare=False)

    @classmethod
    def from_callable(cls, function: Callable[..., float]) -> Function:
        """Describe a Python function.

        Raises
        ------
        InputError
            If its source cannot be found, it does not take plain positional arguments, has no plain name, or reads
            variables of an enclosing function.
        """
        name = getattr(function, "__name__", repr(function))
        plain: Any = getattr(function, "py_func", function)
        try:
            source = textwrap.dedent(inspect.getsource(plain))
            parameters = inspect.signature(plain).parameters
        except (OSError, TypeError):
            raise InputError(f"function {name!r} has no source that can be kept; define it in a file") from None
        if any(parameter.kind is not parameter.POSITIONAL_OR_KEYWORD for parameter in parameters.values()):
            raise InputError(f"function {name!r} must take plain arguments named like the model's quantities")
        if not name.isidentifier() or not name.isascii():
            raise InputError(f"function {name!r} needs a plain name; a lambda has none")
        if plain.__code__.co_freevars:
            free = ", ".join(plain.__code__.co_freevars)
            raise InputError(
                f"function {name!r} takes {free} from around it, which its source does not show; make it a parameter"
            )
        return cls(name, tuple(parameters), source, hashlib.sha256(source.encode()).hexdigest(), function)


@dataclass(frozen=True)
class Force:
    """A force term: a potential, or a component per coordinate.

    If it is declared smooth, zeros in the arguments of its `abs`, `sign`, `min`, `max`, `where` are stepped over. Over a
    relation, a component is the force on the first end of a link, and its opposite that on the second.
    """

    potential: Node | None = None
    components: Mapping[str, Node | Function] = field(default_factory=dict)
    description: str = ""
    smooth: bool = False
    over: str = ""


@dataclass(frozen=True)
class Drive:
    """Measured data that the forces read, as a function of an expression of time, coordinates, velocities and states."""

    table: Table
    argument: Node = CLOCK
    interpolation: str = "linear"
    outside: str = "error"
    description: str = ""
    dims: tuple[str, ...] = ()

    @property
    def jumps(self) -> bool:
        """Whether its value jumps at some point of its table, or at an end."""
        return self.interpolation == "previous" or self.outside == "zero" or self.table.duplicates != ""


@dataclass(frozen=True)
class Event:
    """A scalar function of the state whose zeros are located, and the action taken there.

    Its attributes are the keys of `[events]`; `reset` is the key `set`. A touch counts in the direction from which the
    function approaches zero. A function in Python has no derivative and no bounds: it is sampled, and slopes are
    differences. A periodic event has no function whose zeros are looked for: it is met `every` so often, the first time
    `phase` after the start, or one period.
    """

    function: Node | Function = CLOCK
    direction: str = "either"
    action: str = "record"
    time_tolerance: Quantity | None = None
    description: str = ""
    to: str = ""
    reset: Mapping[str, Node] = field(default_factory=dict)
    count: int = 1
    root_state: str = "reintegrate"
    unit: Unit | None = None
    position_tolerance: Quantity | None = None
    every: Quantity | None = None
    phase: Quantity | None = None

    @property
    def searched(self) -> Node | Function | None:
        """The function whose zeros are looked for; none of a periodic event."""
        return self.function if self.every is None else None


@dataclass(frozen=True)
class Output:
    """An output of a controller: a value that is constant between ticks, limited if bounds are given."""

    unit: Unit
    start: Quantity
    value: Node
    minimum: Node | None = None
    maximum: Node | None = None
    description: str = ""


@dataclass(frozen=True)
class ControllerState:
    """A state of a controller from tick to tick: an integral, a filtered value, a count."""

    unit: Unit
    start: Quantity
    next: Node
    description: str = ""


@dataclass(frozen=True)
class Controller:
    """A sampled controller, which acts at its ticks: every `every` from `phase` after the start on.

    Its attributes are the keys of `[controllers]`. All of its values are computed from what holds just before a tick;
    what it puts out changes `delay` later.
    """

    every: Quantity
    outputs: Mapping[str, Output]
    states: Mapping[str, ControllerState] = field(default_factory=dict)
    phase: Quantity | None = None
    delay: Quantity | None = None
    description: str = ""


MOST_REACTIONS = 24  # forces of contacts and friction that are written out: their equations grow as the cube


@dataclass(frozen=True)
class Contact:
    """A unilateral contact: motion is possible only where its gap is not negative.

    Its attributes are the keys of `[contacts]`. The gradient of `gap` is the normal; `restitution` may read
    `approach_speed`.
    """

    gap: Node
    restitution: Node
    tangential: str = "frictionless"
    slip: Node | None = None
    friction: Node | None = None
    static: Node | None = None
    time_tolerance: Quantity | None = None
    rest_height: Quantity | None = None
    law: str = "newton"
    description: str = ""
    position_tolerance: Quantity | None = None


@dataclass(frozen=True)
class Friction:
    """Dry friction with true stick under a known load: a force along the derivative of `slip` by the velocities.

    Its attributes are the keys of `[frictions]`.
    """

    slip: Node
    kinetic: Node
    static: Node
    time_tolerance: Quantity | None = None
    description: str = ""


@dataclass(frozen=True)
class Constraint:
    """A condition that a motion keeps at every time, by a force along its derivative by the velocities.

    Its attributes are the keys of `[constraints]`, of which one is given: `holds` is zero at all positions (holonomic),
    `rolls` a combination of velocities that is zero (rolling without slipping).
    """

    holds: Node | None = None
    rolls: Node | None = None
    description: str = ""

    @property
    def condition(self) -> Node:
        """The expression that is zero."""
        tree = self.rolls if self.holds is None else self.holds
        assert tree is not None  # noqa: S101 - one of them was read
        return tree


@dataclass(frozen=True)
class Observable:
    """A further recorded expression, its unit, if one is chosen, and its description."""

    expression: Node
    unit: Unit | None = None
    description: str = ""


ORIGIN = "origin"  # the point 0, 0 of a plane


@dataclass(frozen=True)
class Pictured:
    """The contents of figures of a motion, by the keys of `[figure]`."""

    plane: tuple[tuple[Node, Node], ...] = ()
    bodies: tuple[str, ...] = ()
    links: tuple[tuple[str, str], ...] = ()
    springs: tuple[tuple[str, str], ...] = ()
    threads: tuple[tuple[str, str], ...] = ()
    section: Node | None = None
    wrap: tuple[str, ...] = ()


@dataclass(frozen=True)
class Validation:
    """The expected value of a quantity of a run.

    Its attributes are the keys of `[validation]`: `times` in s, compared at every accepted state if there are none;
    `bound` a quantity or a word for how it is derived; `occurrence` from 1, and 0 without an event.
    """

    expression: Node
    quantity: str
    times: tuple[float, ...]
    bound: str | Quantity
    event: str = ""
    occurrence: int = 0
    description: str = ""


@dataclass(frozen=True)
class Regime:
    """The force terms that act during a regime, and the terms of rates."""

    forces: tuple[str, ...] = ()
    description: str = ""
    terms: tuple[str, ...] = ()

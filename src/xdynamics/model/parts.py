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
from xdynamics.model.drives import Table
from xdynamics.model.uncertainty import Spread
from xdynamics.units import Quantity, Unit

DIRECTIONS = ("rising", "falling", "either")
ACTIONS = ("record", "stop", "switch", "reset")
STRIKE = "impact"  # the action of an event that is read as a contact
ROOT_STATES = ("reintegrate", "interpolant")
TANGENTIALS = ("frictionless", "coulomb")
IMPACT_LAWS = NEWTON, POISSON, SEQUENTIAL, ENERGETIC = ("newton", "poisson", "sequential", "energetic")
APPROACH = "approach_speed"  # the name by which a coefficient of restitution reads how fast a gap closes


@dataclass(frozen=True)
class Coordinate:
    """A coordinate of the motion; its shape is () until there are block coordinates."""

    unit: Unit
    description: str = ""
    shape: tuple[int, ...] = ()


@dataclass(frozen=True)
class Parameter:
    """A constant of the model, or a value at the start, with its distribution if known."""

    quantity: Quantity
    spread: Spread | None = None
    description: str = ""

    @property
    def uncertainty(self) -> float:
        """The standard uncertainty in the value's own unit; 0 if none is known."""
        if self.spread is None:
            return 0.0
        standard = self.spread.standard
        return float(standard.unit.factor / self.quantity.unit.factor) * standard.value


@dataclass(frozen=True)
class Fitted:
    """The data that the parameters of a model were fitted to, and whether the residuals support the fit."""

    data: str = ""
    adequate: bool = True
    description: str = ""


@dataclass(frozen=True)
class State:
    """A first-order state beside the motion; `smooth` as in `Force`."""

    unit: Unit
    rate: Node
    description: str = ""
    smooth: bool = False


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
    def of(cls, function: Callable[..., float]) -> Function:
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
                f"function {name!r} takes {free} from around it, which its source does not tell; make it a parameter"
            )
        return cls(name, tuple(parameters), source, hashlib.sha256(source.encode()).hexdigest(), function)


@dataclass(frozen=True)
class Force:
    """A force term: a potential, or a component per coordinate.

    If it is declared smooth, zeros in the arguments of its `abs`, `sign`, `min`, `max`, `where` are stepped over.
    """

    potential: Node | None = None
    components: Mapping[str, Node | Function] = field(default_factory=dict)
    description: str = ""
    smooth: bool = False


@dataclass(frozen=True)
class Drive:
    """Measured data that the forces read, as a function of time, a coordinate or a velocity."""

    table: Table
    argument: str = "t"
    interpolation: str = "linear"
    outside: str = "error"
    description: str = ""


@dataclass(frozen=True)
class Event:
    """A scalar function of the state whose zeros are located, and the action taken there.

    Attributes
    ----------
    function : Node or Function
        One in Python has no derivative and no bounds: it is sampled, and slopes are differences.
    direction : {"rising", "falling", "either"}
        A touch counts if the function approaches zero from the matching side.
    action : {"record", "stop", "switch", "reset"}
    time_tolerance : Quantity, optional
        How well it is located; by default as in the settings of the run.
    position_tolerance : Quantity, optional
        How far from zero its function may be at the accepted state, in its own unit; by default what the time tolerance
        leaves.
    description : str
    to : str
        The regime that a switch leads to.
    reset : mapping of str to Node
        New values of coordinates, velocities or states, from those before.
    count : int
        The occurrence from which on to act.
    root_state : {"reintegrate", "interpolant"}
        Whether it is located on shortened steps of the method, or on the interpolant of the full step.
    unit : Unit, optional
        The unit of what a function in Python returns (in SI); by default a pure number.
    """

    function: Node | Function
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


@dataclass(frozen=True)
class Contact:
    """A unilateral contact: motion is possible only where its gap is not negative.

    Attributes
    ----------
    gap : Node
        Of coordinates and time; its gradient is the normal.
    restitution : Node
        The coefficient, a number or an expression, of `approach_speed` too.
    tangential : {"frictionless", "coulomb"}
    slip : Node, optional
        Velocity along the surface, of a contact with friction.
    friction, static : Node, optional
        Coefficients while it slips, and up to which it sticks.
    time_tolerance : Quantity, optional
        Of impacts, rest and take-off; by default as in the settings of the run.
    position_tolerance : Quantity, optional
        How large the gap may be at the accepted state of an impact; by default what the time tolerance leaves.
    rest_height : Quantity, optional
        Bounces lower than this may be skipped into rest; by default 1e-9 of the largest gap so far.
    law : {"newton", "poisson", "sequential", "energetic"}
        Of impacts, including simultaneous ones.
    description : str
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

    Attributes
    ----------
    slip : Node
        Relative velocity, linear in velocities.
    kinetic, static : Node
        Size of the force while it slips, and the largest force that sticking holds.
    time_tolerance : Quantity, optional
        Of stick and slip; by default as in the settings of the run.
    description : str
    """

    slip: Node
    kinetic: Node
    static: Node
    time_tolerance: Quantity | None = None
    description: str = ""


@dataclass(frozen=True)
class Observable:
    """How an observable is recorded: its unit, if one is chosen, and its description."""

    unit: Unit | None = None
    description: str = ""


@dataclass(frozen=True)
class Pictured:
    """What figures show of a motion.

    Attributes
    ----------
    plane : tuple of (Node, Node)
        Positions of bodies, across and up.
    section : Node, optional
        The period of the Poincare section.
    wrap : tuple of str
        Angles that are drawn within half a turn to either side.
    """

    plane: tuple[tuple[Node, Node], ...] = ()
    section: Node | None = None
    wrap: tuple[str, ...] = ()


@dataclass(frozen=True)
class Validation:
    """The expected value of a quantity of a run.

    Attributes
    ----------
    expression : Node
        Its closed form, of time and parameters.
    quantity : str
        A coordinate, velocity, state, energy, observable, contact force; at an event `t` too, its time.
    times : tuple of float, s
        Where it is compared; if empty, at every accepted state.
    bound : str or Quantity
        The largest deviation allowed, or a word for how it is derived.
    event : str
        The event after which it is compared.
    occurrence : int
        Which occurrence of the event, from 1.
    description : str
    """

    expression: Node
    quantity: str
    times: tuple[float, ...]
    bound: str | Quantity
    event: str = ""
    occurrence: int = 1
    description: str = ""


@dataclass(frozen=True)
class Regime:
    """The force terms that act during a regime."""

    forces: tuple[str, ...]
    description: str = ""

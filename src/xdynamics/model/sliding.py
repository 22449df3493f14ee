"""Motion along switches that both sides drive back to: Filippov's convex combination, as trees.

Where the forces of either side drive the motion back to a switch it slides along it; where those of two regimes drive it
back to the events between them, along these. Its forces are then the
combination f = f- + u (f+ - f-) of those of both sides with which the function of the switch stays zero, 0 <= u <= 1
(Filippov, Differential Equations with Discontinuous Righthand Sides, 1988, chapter 2; equivalent control: Utkin, Sliding
Modes in Control and Optimization, 1992). The share u follows from the state: it solves g'(u) = 0, which is linear in u.

Forces that jump with a position act on its velocity alone: the switch has relative degree 2 (Levant, Int. J. Control 58,
1993). Along it both function and rate are zero, and the share follows from g''(u) = 0.

A model that slides is one whose forces are these combinations. It is smooth, so that whatever marches, samples or
differentiates a model does so with it; the share has a detector, which is zero where the motion leaves the switch.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

from xdynamics.expressions import CALLED_ALONE, Binary, Call, Node, Number, expand
from xdynamics.expressions.calculus import ONE, ZERO
from xdynamics.expressions.evaluation import evaluate
from xdynamics.expressions.tree import every
from xdynamics.model.accelerations import read_accelerations
from xdynamics.model.model import Model
from xdynamics.model.motion import motion, probe_states, variables
from xdynamics.model.parts import ACTIONS, Event, Function
from xdynamics.model.regime_model import RegimeModel, regime_model, watched_by
from xdynamics.model.regimes import REGIME_NUMBER
from xdynamics.model.switches import LOCATED, Switch, switch_side
from xdynamics.runtime.lazy_imports import cached_property

REFERENCE = "Filippov, Differential Equations with Discontinuous Righthand Sides, 1988, chapter 2"
TO_REGIME = ACTIONS[2]
MOST_AT_ONCE = 3  # surfaces that a motion slides along at a time
_EQUAL = 1e-12  # of ratios at probes

Probes = Sequence[Mapping[str, float]]  # states, with parameters, at which expressions are compared


@dataclass(frozen=True)
class Surface:
    """What a motion may slide along: switches, and events between two regimes, whose functions are equal up to a factor.

    Attributes
    ----------
    name : str
        Of the first event or switch.
    function : Node
        Its function; the share is that of the side where it is positive.
    switches : tuple of (int, int)
        Numbers of the switches, with the sign of the factor.
    events : tuple of (int, int)
        Numbers of the events that switch to and fro between two regimes, in the same way.
    regimes : tuple of (int, int), optional
        Numbers of the regimes of the negative and of the positive side.
    number : int
        Of the regime in which the motion slides, behind those of the model; -1 without regimes.
    rate : Node, optional
        The rate of the function, if the function has relative degree 2: forces act on its rate alone, as on the velocity
        of a mass. The motion rests on such a switch, or moves within it, where the rate is zero, too.
    rate_switches : tuple of (int, int)
        Numbers of the switches whose functions are equal to the rate up to a factor, in the same way.
    """

    name: str
    function: Node
    switches: tuple[tuple[int, int], ...]
    events: tuple[tuple[int, int], ...] = ()
    regimes: tuple[int, int] | None = None
    number: int = -1
    rate: Node | None = None
    rate_switches: tuple[tuple[int, int], ...] = ()

    @property
    def sliding_variable(self) -> Node:
        """What the share keeps at zero: the function or, where forces act on its rate alone, that rate."""
        return self.function if self.rate is None else self.rate

    def detectors(self, model: Model) -> tuple[tuple[int, int], ...]:
        """Return the numbers of its detectors, events before switches: models that slide have nothing between them."""
        first = len(model.elements.events)
        return (*self.events, *((first + i, factor) for i, factor in (*self.switches, *self.rate_switches)))


@lru_cache(maxsize=64)
def surfaces(model: Model) -> tuple[Surface, ...]:
    """Return what a motion may slide along: switches at which a force or rate jumps, and events between two regimes.

    Not points of tables, not what masses and friction switch at, and nothing of models with dimensions, contacts,
    constraints, controllers or tables that jump.
    """
    if isinstance(model, SlidingModel):
        return surfaces(model.base)
    if not (isinstance(model, RegimeModel) and model.slides):
        return ()
    elements = model.elements
    statement = model.statement
    if model.shapes.dims or elements.contacts or statement.frictions or elements.constraints or model.assemblies:
        return ()
    # what changes forces at a time without an event would change shares: ticks, and tables that jump
    jumps = any(drive.jumps for drive in elements.drives.values())
    if model.python_functions or model.delays or statement.controllers or jumps or read_accelerations(statement):
        return ()
    groups, probes = list[_Group](), [*probe_states(model)]
    for i, (name, event) in enumerate(elements.events.items()):
        if isinstance(event.function, Function) or not _switches_in_one_direction(event):
            continue
        if elements.reads(event.function) & {*variables(model)}:
            group, factor = _group_of(probes, groups, elements.expanded(event.function), name)
            group.events.append((i, factor))
    groups = [group for group in groups if _regimes_beside(model, group)]
    for i, switch in enumerate(watched_by(model)):
        if _may_be_slid_along(model, switch):
            group, factor = _group_of(probes, groups, switch.function, switch.name)
            group.switches.append((i, factor))
    return tuple(_surface_of(model, probes, groups, k) for k in range(len(groups)))


def _surface_of(model: RegimeModel, probes: Probes, groups: Sequence[_Group], k: int) -> Surface:
    """Return the surface of a group, of regimes or of switches; of a function of positions with its rate."""
    group = groups[k]
    name, function, switches = group.name, group.function, tuple(group.switches)
    if group.events:
        between = _regimes_beside(model, group), len(model.regimes) + k
        return Surface(name, function, switches, tuple(group.events), *between)
    rate = model.elements.rate_of(function)
    driven = {item.name for item in motion(model.elements)}
    if driven & model.elements.reads(rate):
        return Surface(name, function, switches)
    rate_switches = [
        (i, factor * sign)
        for other in groups
        if (sign := 0 if other.events else _sign_of_factor(probes, rate, other.function))
        for i, factor in other.switches
    ]
    return Surface(name, function, switches, rate=rate, rate_switches=tuple(rate_switches))


@dataclass
class _Group:
    """Switches and events whose functions are equal up to a factor."""

    name: str
    function: Node
    switches: list[tuple[int, int]] = field(default_factory=list)
    events: list[tuple[int, int]] = field(default_factory=list)


def _group_of(probes: Probes, groups: list[_Group], function: Node, name: str) -> tuple[_Group, int]:
    """Return the group of a function, a new one if there is none yet, and the sign of its factor there."""
    for group in groups:
        if factor := _sign_of_factor(probes, group.function, function):
            return group, factor
    groups.append(_Group(name, function))
    return groups[-1], 1


def _switches_in_one_direction(event: Event) -> bool:
    acts = event.action == TO_REGIME and event.every is None and event.count == 1
    return acts and event.direction != "either"


def _may_be_slid_along(model: Model, switch: Switch) -> bool:
    """Whether a force or rate jumps at a switch, and forces drive its function: not time, and not over zero by a jump."""
    moves = model.elements.reads(switch.function) & {*variables(model)}
    called = {node.function for node in every(switch.function) if isinstance(node, Call)}
    called.add(switch.name.rpartition(".")[2].partition("_")[0])
    owners = {*model.statement.forces, *model.statement.states}
    return bool(switch.jumps and moves and not switch.drive and switch.owner in owners and not called & {*CALLED_ALONE})


def _regimes_beside(model: Model, group: _Group) -> tuple[int, int] | None:
    """Return the regimes on either side of a function, if its events lead to one on each; None of other events."""
    events, numbers = [*model.elements.events.values()], {name: i for i, name in enumerate(model.regimes)}
    sides: dict[int, set[int]] = {-1: set(), 1: set()}
    for i, factor in group.events:
        sides[factor * (1 if events[i].direction == "rising" else -1)].add(numbers[events[i].to])
    (negative, *more), (positive, *further) = (sorted(sides[side]) or [-1] for side in (-1, 1))
    if more or further or -1 in (negative, positive) or negative == positive:
        return None
    return negative, positive


def _sign_of_factor(probes: Probes, first: Node, second: Node) -> int:
    """Return the sign of the factor between two functions; 0 if they are not equal up to one, whatever the parameters are."""
    if first == second:
        return 1
    ratios = set[float]()
    for values in probes:
        try:
            ratios.add(evaluate(second, values) / evaluate(first, values))
        except (ArithmeticError, KeyError, ValueError):
            return 0
    least, most = min(ratios), max(ratios)
    if not abs(most - least) <= _EQUAL * abs(most) or most == 0.0:
        return 0
    return 1 if most > 0.0 else -1


def sided_model(model: Model, located: str = LOCATED) -> Model:
    """Return the model on the sides of its switches and regimes, of which its motion may slide along some."""
    # by position, as `Settings.layout` asks: what is cached is one model
    return regime_model(model, located, True)  # noqa: FBT003


@lru_cache(maxsize=64)
def may_slide_along_switches(model: Model, located: str = LOCATED) -> bool:
    """Whether a model has switches or regimes that its motion may slide along, where switches are treated so."""
    return not model.shapes.dims and bool(surfaces(sided_model(model, located)))


class SlidingModel(RegimeModel):
    """A model on the sides of its switches, but on the convex combination of those that it slides along.

    Parameters
    ----------
    model : RegimeModel
    weights : mapping of Surface to Node
        The share of the positive side: an expression of the state, 0 or 1.
    """

    def __init__(self, model: RegimeModel, weights: Mapping[Surface, Node]) -> None:
        self.weights, self.base = dict(weights), model
        super().__init__(model.plain, model.switches, model.located, slides=model.slides)
        if any(surface.regimes for surface in weights):  # whose forces have shares, and act in every regime
            acting = tuple(self.statement.forces)
            self.regimes = {name: replace(regime, forces=acting) for name, regime in self.regimes.items()}

    @cached_property
    def digest(self) -> str:
        """The digest of the model, and what it slides along."""
        return f"{self.base.digest} {self._shares_text}"

    @cached_property
    def form(self) -> str:
        """The form of the model, and what it slides along: it is another program."""
        return f"{self.base.form}\n# shares: {self._shares_text}\n"

    @cached_property
    def _shares_text(self) -> str:
        fixed: dict[Node, str] = {ZERO: "0", ONE: "1"}
        return ", ".join(f"{surface.name} {fixed.get(weight, 'slides')}" for surface, weight in self.weights.items())

    def _one_sided_tree(self, owner: str, tree: Node) -> Node:
        mixed = super()._one_sided_tree(owner, tree)
        for surface, weight in self.weights.items():
            minus, plus = (self._on_side(owner, mixed, surface, side) for side in (-1, 1))
            if weight == ONE or minus == plus:
                mixed = plus
            elif weight == ZERO:
                mixed = minus
            elif minus == ZERO:
                mixed = Binary("*", weight, plus)
            else:
                mixed = Binary("+", minus, Binary("*", weight, Binary("-", plus, minus)))
        return mixed

    def _on_side(self, owner: str, tree: Node, surface: Surface, side: int) -> Node:
        if surface.regimes:
            number = surface.regimes[(1 + side) // 2]
            tree = expand(tree, {REGIME_NUMBER: Number(float(number))})
            regime = [*self.plain.statement.regimes.values()][number]
            if owner in self.plain.statement.forces and owner not in regime.forces:
                return ZERO
        switches = (*surface.switches, *surface.rate_switches)
        return expand(tree, {switch_side(i): Number(float(side * factor)) for i, factor in switches})


def sliding_model(model: RegimeModel, along: Sequence[Surface]) -> SlidingModel:
    """Return a model that slides along some surfaces."""
    return SlidingModel(model, dict(zip(along, shares(model, tuple(along)), strict=True)))


@lru_cache(maxsize=64)
def shares(model: RegimeModel, along: tuple[Surface, ...]) -> tuple[Node, ...]:
    """Return the shares with which the functions of some surfaces stay zero, as expressions of the state.

    Of several surfaces they solve linear equations, by Gaussian elimination: forces are sums of what each switches.
    """
    base = arm_rates(model, along, ())
    matrix: list[list[Node]] = [[ZERO] * len(along) for _ in along]
    for k, surface in enumerate(along):
        for j, (rate, rate_there) in enumerate(zip(base, arm_rates(model, along, (surface,)), strict=True)):
            matrix[j][k] = Binary("-", rate_there, rate)
    right: list[Node] = [Binary("-", ZERO, rate) for rate in base]
    n = len(along)
    for p in range(n):
        for i in range(p + 1, n):
            factor = Binary("/", matrix[i][p], matrix[p][p])
            for j in range(p + 1, n):
                matrix[i][j] = Binary("-", matrix[i][j], Binary("*", factor, matrix[p][j]))
            right[i] = Binary("-", right[i], Binary("*", factor, right[p]))
    solved: list[Node] = [ZERO] * n
    for i in reversed(range(n)):
        total = right[i]
        for j in range(i + 1, n):
            total = Binary("-", total, Binary("*", matrix[i][j], solved[j]))
        solved[i] = Binary("/", total, matrix[i][i])
    return tuple(solved)


@lru_cache(maxsize=64)
def arm_rates(model: RegimeModel, of: tuple[Surface, ...], positive: tuple[Surface, ...]) -> tuple[Node, ...]:
    """Return the rates of the sliding variables of surfaces, where all but some of these are on their negative side."""
    arm = SlidingModel(model, {surface: ONE if surface in positive else ZERO for surface in of})
    known: dict[str, Node] = {}
    for item in motion(arm.elements):
        assert not isinstance(item.value, Function)  # noqa: S101 - a model with one has no surfaces
        known[item.name] = expand(item.value, known)
    return tuple(expand(arm.elements.rate_of(surface.sliding_variable), known) for surface in of)


def slid_along(model: Model) -> tuple[Surface, ...]:
    """Return what a model slides along."""
    return tuple(model.weights) if isinstance(model, SlidingModel) else ()

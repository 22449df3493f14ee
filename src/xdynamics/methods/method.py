"""What a method is: its update equations, which are also the code that runs, and what is known of it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from xdynamics.expressions import Node, free_names, parse
from xdynamics.faults import InputError
from xdynamics.model import Model, Trait, traits_of

SCALARS = ("t", "t1", "h")

_EVALUATION = re.compile(r"(a\w*), (r\w*) = f\(([^,]+), (q\w*), (v\w*), (x\w*)\)")


@dataclass(frozen=True)
class Evaluation:
    """``a1, r1 = f(t1, q1, v1, x1)``: accelerations and rates at one time and one state."""

    acceleration: str
    rate: str
    time: str
    position: str
    velocity: str
    state: str

    def text(self, *, motion: bool, states: bool) -> str:
        """Print it with the vectors that a model has."""
        results = [name for name, shown in ((self.acceleration, motion), (self.rate, states)) if shown]
        used = [self.time, *([self.position, self.velocity] if motion else []), *([self.state] if states else [])]
        return f"{', '.join(results)} = f({', '.join(used)})"


@dataclass(frozen=True)
class Statement:
    """``v1 = v + h*a``: one vector from vectors of the same length."""

    target: str
    expression: Node
    source: str

    @property
    def of_states(self) -> bool:
        """Whether it advances the first-order states (x, r) and not the motion (q, v, a)."""
        return self.target[0] in "xr"

    @property
    def vectors(self) -> set[str]:
        """The vectors it reads; what is left are scalars."""
        return free_names(self.expression) - set(SCALARS)

    def text(self, *, motion: bool, states: bool) -> str:
        """Print it, or nothing where the model has no such vectors."""
        return self.source if (states if self.of_states else motion) else ""


@dataclass(frozen=True)
class Method:
    """A time-stepping method.

    The update is written in vectors: q, v, a of the motion and x, r of the first-order states at the start of a step
    of size h from t to t1; the same letters with 1 at its end; ``f`` solves M a = F and evaluates the rates. These
    lines are the code: each is written out by component and compiled, and they are what a record quotes.

    Attributes
    ----------
    name : str
        The literature's name.
    order : int
        Order of the global error of a smooth problem.
    symplectic : bool
    evaluations : int
        Force evaluations a step, when the last one serves the next step.
    update : str
        The lines above.
    words : str
        The order of the update in words.
    refuses : tuple of Trait
        Models the method is not defined for.
    reference : str
    synonyms : tuple of str
    interpolation : str
        The dense output that belongs to it, with its order.
    """

    name: str
    order: int
    symplectic: bool
    evaluations: int
    update: str
    words: str
    reference: str
    refuses: tuple[Trait, ...] = ()
    synonyms: tuple[str, ...] = ()
    interpolation: str = "none"

    @cached_property
    def statements(self) -> tuple[Statement | Evaluation, ...]:
        """The update, line by line."""
        return tuple(_read(line.strip()) for line in self.update.strip().splitlines())

    def equations(self, model: Model | None = None) -> str:
        """Return the update equations as one line, with the vectors that a model has."""
        motion = model is None or bool(model.coordinates)
        states = model is None or bool(model.states)
        texts = [one.text(motion=motion, states=states) for one in self.statements]
        return "; ".join(text for text in texts if text)

    def refusals(self, model: Model) -> list[str]:
        """Say why the method cannot march a model; empty if it can."""
        traits = traits_of(model)
        return [f"it is not defined for {trait} ({traits[trait]})" for trait in self.refuses if trait in traits]


def method_named(name: str, model: Model, methods: Mapping[str, Method]) -> Method:
    """Look a method up for a model.

    Raises
    ------
    InputError
        If there is no such method, or it refuses the model; names the methods that fit.
    """
    fitting = ", ".join(one.name for one in methods.values() if not one.refusals(model)) or "none"
    if name not in methods:
        raise InputError(f"method {name!r} is not known; these fit this model: {fitting}")
    refusals = methods[name].refusals(model)
    if refusals:
        raise InputError(
            f"method '{name}' refuses the model '{model.name}': {'; '.join(refusals)}; these fit: {fitting}"
        )
    return methods[name]


def _read(line: str) -> Statement | Evaluation:
    if found := _EVALUATION.fullmatch(line):
        return Evaluation(*found.groups())
    target, expression = line.split(" = ")
    return Statement(target, parse(expression), line)

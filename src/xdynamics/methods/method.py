"""Time-stepping methods: their update equations, which are also the code that runs, and their properties.

A method is read by name. An unknown name is answered with methods of similar spelling, with synonyms, and with the
names that other programs use.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches

from xdynamics.faults import InputError
from xdynamics.methods.lines import HERMITE, Interpolant, Line, Solve, printed_lines, read_lines
from xdynamics.methods.steppers import DIFFERENCES, LINES, Stepper
from xdynamics.model import Model, Trait, traits_of
from xdynamics.runtime.lazy_imports import cached_property

# of models whose accelerations depend on velocities or states
MOVING = {Trait.VELOCITY_DEPENDENT, Trait.COUPLED_STATES, Trait.COUPLED_MASS}

MOST = 3  # methods that a message names
# what other programs call a method, or one that serves in its place
ELSEWHERE = {
    "radau_iia": (
        "bdf",
        "lsoda",
        "vode",
        "cvode",
        "ode15s",
        "ode23s",
        "rosenbrock",
        "implicit_euler",
        "backward_euler",
    ),
    "dormand_prince": ("rkf45", "tsit5", "rkdp", "runge_kutta_fehlberg"),
    "bogacki_shampine": ("rk23", "ode23"),
    "dop853": ("ode113", "rk8", "adams", "dopri8"),
    "midpoint": ("rk2",),
    "heun": ("rk2", "trapezoid"),
    "rk4": ("runge_kutta",),
    "velocity_verlet": ("stormer", "newmark", "symplectic"),
    "forest_ruth": ("yoshida4", "symplectic4"),
}


def similar(name: str, synonyms_by_method: Mapping[str, Sequence[str]]) -> str:
    """Return the question whether one of some methods was meant, as a part of a message; empty if none is like it.

    Parameters
    ----------
    name : str
        That is the name of none of them.
    synonyms_by_method : mapping of str to sequence of str
        The methods that may be taken, with their synonyms.

    Examples
    --------
    >>> similar("RK4", {"rk4": ()}), similar("ode15s", {"rk4": (), "radau_iia": ()})
    ("did you mean 'rk4'? ", "did you mean 'radau_iia'? ")
    """
    word = _letters_and_digits(name)
    synonyms = {
        key: [*map(_letters_and_digits, (*also, *ELSEWHERE.get(key, ())))] for key, also in synonyms_by_method.items()
    }
    candidate_lists = (
        [key for key in synonyms_by_method if word in (_letters_and_digits(key), *synonyms[key])],
        [key for key in synonyms_by_method if word in _letters_and_digits(key)],
        [key for key in synonyms_by_method if any(word in synonym for synonym in synonyms[key])],
        get_close_matches(name.lower(), [*synonyms_by_method], n=1),
    )
    meant = next(filter(None, candidate_lists), []) if len(word) > 1 else []
    return f"did you mean {' or '.join(repr(key) for key in meant[:MOST])}? " if meant else ""


def _letters_and_digits(name: str) -> str:
    """Return a name without capitals and signs."""
    return re.sub("[^a-z0-9]", "", name.lower())


@dataclass(frozen=True)
class Method:
    """A time-stepping method.

    The update is written in vectors: q, v, a of the motion and x, r of the first-order states at the start of a step
    of size h from t to t1; the same letters with 1 at its end; ``f`` solves M a = F and evaluates the rates. These
    lines are the code: each is written out by component and compiled, and a record quotes them. The first letter of a
    name tells the kind of vector.

    Attributes
    ----------
    name : str
        The name in the literature.
    order : int
        Order of the global error of a smooth problem.
    symplectic : bool
    evaluations : int
        Force evaluations per step, if the last one serves the next step; for an implicit method those of one iteration.
    update : str
        The lines above.
    words : str
        The sequence of the update in words.
    refuses : tuple of Trait
        Traits of models for which the method is not defined.
    reference : str
    synonyms : tuple of str
    estimate : str
        Lines that give ``qe, ve, xe``, the local error by an embedded formula; empty if there is none.
    estimate_order : int
        Order of the embedded formula: the estimate falls as h**(estimate_order + 1).
    interpolant : Interpolant
        The state inside a step.
    stepper : Stepper
        How its steps are made.
    symmetric : bool
        Whether a step of size -h undoes one of size h: the method is its own adjoint, impacts aside (Hairer, Lubich, Wanner, section V.1).
    constrained_update : str
        The update for models with constraints, where it has impulses of constraints in it: by them a symplectic method
        stays symplectic. Otherwise the update itself, with accelerations that obey the constraints.
    moving_update : str
        The update for models whose accelerations depend on velocities or states, where these take lines of their own.
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
    estimate: str = ""
    estimate_order: int = 0
    interpolant: Interpolant = HERMITE
    symmetric: bool = False
    stepper: Stepper = LINES
    constrained_update: str = ""
    moving_update: str = ""

    @cached_property
    def statements(self) -> tuple[Line, ...]:
        """The update, line by line."""
        return read_lines(self.update)

    def lines(self, model: Model) -> tuple[Line, ...]:
        """Return the lines of a step of a model."""
        update = self._update_of(model)
        return self.statements if update == self.update else read_lines(update)

    def _update_of(self, model: Model) -> str:
        if model.constraints and self.constrained_update:
            return self.constrained_update
        return self.moving_update if self.moving_update and MOVING & traits_of(model).keys() else self.update

    @property
    def solves(self) -> tuple[Solve, ...]:
        """The equations that a step solves; those of an implicit method."""
        return tuple(line for line in self.statements if isinstance(line, Solve))

    @cached_property
    def solver(self) -> str:
        """The solver of a step's equations: `steppers.NOTHING`, `NEWTON` or `SIMPLIFIED`."""
        return self.stepper.solver(self.statements)

    def equations(self, model: Model | None = None) -> str:
        """Return the update equations as one line, with the vectors that a model has."""
        return printed_lines(self.update if model is None else self._update_of(model), model)

    @property
    def has_orders(self) -> bool:
        """Whether there are methods of this name of many orders."""
        return self.stepper.foresees

    def refusals(self, model: Model, *, by_differences: bool = False) -> list[str]:
        """List why the method cannot march a model, perhaps with derivatives by differences; empty if it can."""
        traits = traits_of(model) if self.refuses else {}
        refused = [trait for trait in self.refuses if trait in traits]
        if by_differences and DIFFERENCES in self.stepper.jacobians:
            refused = [trait for trait in refused if trait not in (Trait.PYTHON_FORCES, Trait.CONTACTS)]
        return [
            *(f"it is not defined for {trait} ({traits[trait]})" for trait in refused),
            *self._refusals_of_delays(model),
            *self.stepper.refusals(model),
        ]

    def _refusals_of_delays(self, model: Model) -> list[str]:
        """List why the method cannot read its own past: its steps read none, or would by too low an order."""
        if not model.delays:
            return []
        if self.stepper != LINES:
            return ["its steps do not read delayed values"]
        if self.order > self.interpolant.order + 1:
            left = f"errors of h**{self.interpolant.order + 1}, which would be all that is left of it"
            return [f"it is of order {self.order}, and delayed values are interpolated with {left}"]
        return []


def unknown_method(name: str, methods: Mapping[str, Method]) -> str:
    """Return the beginning of a message that a method is unknown, with the methods that may have been meant."""
    return f"method {name!r} is not known; {similar(name, {key: method.synonyms for key, method in methods.items()})}"


def method_named(name: str, model: Model, methods: Mapping[str, Method], *, by_differences: bool = False) -> Method:
    """Look up a method by name for a model, perhaps with derivatives by differences.

    Raises
    ------
    InputError
        If there is no such method, or it refuses the model; with the methods that fit.
    """
    refusals = methods[name].refusals(model, by_differences=by_differences) if name in methods else []
    if name in methods and not refusals:
        return methods[name]
    fitting = [method.name for method in methods.values() if not method.refusals(model)]
    fitting += [
        f"{method.name} with jacobian = 'differences'"
        for method in methods.values()
        if method.name not in fitting and not method.refusals(model, by_differences=True)
    ]
    fits = ", ".join(fitting) or "none"
    if name not in methods:
        meant = unknown_method(name, {key: methods[key] for key in fitting if key in methods})
        raise InputError(f"{meant}these fit this model: {fits}")
    raise InputError(f"method '{name}' refuses the model '{model.name}': {'; '.join(refusals)}; these fit: {fits}")

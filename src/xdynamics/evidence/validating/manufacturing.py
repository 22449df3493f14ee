"""Manufactured solutions: the force that makes a wanted trajectory exact."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping

from xdynamics.expressions import Binary, Node, dimension_of, free_names, parse, text_of
from xdynamics.expressions.calculus import ONE, ZERO, add, derivative, expand, multiply
from xdynamics.expressions.evaluation import evaluate
from xdynamics.faults import InputError, Ledger
from xdynamics.model import Model
from xdynamics.model.closed_forms import ORDER
from xdynamics.model.motion import constants
from xdynamics.model.parts import Function
from xdynamics.schema import velocity

TERM = "manufactured"


def manufactured(model: Model, trajectory: Mapping[str, str]) -> Model:
    """Return a model whose exact solution is a wanted trajectory, with closed forms that state it.

    One more force is added, ``manufactured``, of time alone: M a of the trajectory less all other forces on it.
    First-order states get such a term in their rates. The other forces act as before: any fault in their code, or in
    the order of a method for them, shows in the residual.

    Parameters
    ----------
    model : Model
        Without contacts, friction, regimes, functions in Python, or drives of anything but time.
    trajectory : mapping of str to str
        For every coordinate and first-order state an expression of time and parameters, like ``{"x": "A*sin(w*t)"}``.

    Returns
    -------
    Model
        With `forces.manufactured`, initial values on the trajectory, and `validation` of every coordinate, velocity and
        state by the order of the method.

    Raises
    ------
    InputError
        If the trajectory is incomplete or has another unit, or the model is not of this kind.

    Notes
    -----
    Roache, Verification and Validation in Computational Science and Engineering (1998), chapter 3.

    Examples
    --------
    >>> import xdynamics as xd
    >>> pendulum = xd.Model.from_toml("data/models/pendulum.toml")
    >>> known = manufactured(pendulum, {"theta": "radian*sin(2*t/second)"})
    >>> found = xd.validate(["rk4"], known)
    >>> found.verdict.values.tolist()
    [0, 0]
    """
    _check(model, trajectory)
    ledger = Ledger("manufactured solution")
    wanted: dict[str, Node] = {}
    for name, text in trajectory.items():
        with ledger.entry(f"'{name}'"):
            tree = model.expanded(parse(text))
            dimension, needed = dimension_of(tree, model.dimensions), model.units[name].dimension
            if dimension != needed:
                raise InputError(f"{text!r} has units '{dimension}', needs '{needed}'")
            if moving := sorted(free_names(tree) & {*model.units, *model.drives}):
                raise InputError(f"{text!r} reads '{moving[0]}'; a trajectory is of t and parameters")
            wanted[name] = tree
    ledger.raise_faults()
    along = wanted | {velocity(name): _rate(wanted[name]) for name in model.coordinates}
    document = tomllib.loads(model.to_toml())
    forces = {name: text_of(force) for name, force in _missing(model, along).items()}
    if forces:
        document.setdefault("forces", {})[TERM] = forces | {"description": "makes the wanted trajectory exact"}
    for name, state in model.states.items():
        correction = _less(_rate(wanted[name]), expand(model.expanded(state.rate), along))
        document["states"][name]["rate"] = text_of(add(state.rate, correction))
    begin = dict(constants(model)) | {"t": model.initial["t"].si}
    for name, tree in along.items():
        unit = model.units[name]
        document["initial"][name] = f"{evaluate(tree, begin) / float(unit.factor)!r} {unit.text}"
    document["validation"] = {name: {"expression": text_of(tree), "bound": ORDER} for name, tree in along.items()}
    return Model.from_text(_text_of(document))


def _check(model: Model, trajectory: Mapping[str, str]) -> None:
    """Refuse models and trajectories that no force of time alone can make exact."""
    if not isinstance(model, Model):
        raise InputError(f"model is {str(model)[:60]!r}, needs a Model")
    kinds = {
        "dimensions": model.shapes.extents,
        "contacts": model.contacts,
        "frictions": model.frictions,
        "regimes": model.regimes,
        "functions in Python": model.python_functions,
    }
    for kind, members in kinds.items():
        if members:
            raise InputError(f"model '{model.name}' has {kind}; a manufactured solution is of a model without")
    for name, drive in model.drives.items():
        if drive.argument != "t":
            raise InputError(
                f"drive '{name}' is of '{drive.argument}'; a manufactured solution takes drives of time alone"
            )
    if TERM in model.forces:
        raise InputError(f"model '{model.name}' has a force '{TERM}' already")
    needed = [*model.coordinates, *model.states]
    faults = [f"'{name}' has no trajectory" for name in needed if name not in trajectory]
    faults += [
        f"'{name}' is no coordinate or state; there are {', '.join(needed)}"
        for name in trajectory
        if name not in needed
    ]
    if faults:
        raise InputError(f"manufactured solution: {'; '.join(faults)}", tuple(faults))


def _missing(model: Model, along: Mapping[str, Node]) -> dict[str, Node]:
    """Return M a less all forces, on the trajectory, by coordinate."""
    forces: dict[str, Node] = dict.fromkeys(model.coordinates, ZERO)
    places = list(model.coordinates)
    for (i, j), entry in model.statement.mass_entries.items():
        inertia = multiply(expand(model.expanded(entry), along), _rate(along[velocity(places[j])]))
        forces[places[i]] = add(forces[places[i]], inertia)
    for components in model.force_components.values():
        for name, component in components.items():
            assert not isinstance(component, Function)  # noqa: S101 - refused above
            forces[name] = _less(forces[name], expand(model.expanded(component), along))
    return forces


def _rate(tree: Node) -> Node:
    return derivative(tree, {"t": ONE})


def _less(left: Node, right: Node) -> Node:
    return left if right == ZERO else Binary("-", left, right)


def _text_of(statement: Mapping[str, object]) -> str:
    """Print a statement as TOML."""
    return Model(**statement).to_toml()

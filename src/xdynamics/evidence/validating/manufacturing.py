"""Manufactured solutions: from a wanted trajectory, the force that makes it exact."""

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
    """Return a model of which a wanted trajectory is the exact solution, and that says so in its own closed forms.

    To the forces comes one more term, ``manufactured``, of time alone: M a of the trajectory less all other forces on it.
    First-order states get such a term in their rates. The other forces act as before: what is wrong in their code, or in
    the order of a method for them, is seen in the residual, whatever they are.

    Parameters
    ----------
    model : Model
        Without contacts, friction, regimes, functions in Python, and drives of anything but time.
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
        If the trajectory leaves something out, has another unit, or the model is none of these.

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
            found, needed = dimension_of(tree, model.dimensions), model.units[name].dimension
            if found != needed:
                raise InputError(f"{text!r} has units '{found}', needs '{needed}'")
            if moving := sorted(free_names(tree) & {*model.units, *model.drives}):
                raise InputError(f"{text!r} reads '{moving[0]}'; a trajectory is of t and parameters")
            wanted[name] = tree
    ledger.settle()
    along = wanted | {velocity(name): _rate(wanted[name]) for name in model.coordinates}
    said = tomllib.loads(model.to_toml())
    forces = {name: text_of(one) for name, one in _missing(model, along).items()}
    if forces:
        said.setdefault("forces", {})[TERM] = forces | {"description": "makes the wanted trajectory exact"}
    for name, state in model.states.items():
        rest = _less(_rate(wanted[name]), expand(model.expanded(state.rate), along))
        said["states"][name]["rate"] = text_of(add(state.rate, rest))
    begin = dict(constants(model)) | {"t": model.initial["t"].si}
    for name, tree in along.items():
        unit = model.units[name]
        said["initial"][name] = f"{evaluate(tree, begin) / float(unit.factor)!r} {unit.text}"
    said["validation"] = {name: {"expression": text_of(tree), "bound": ORDER} for name, tree in along.items()}
    return Model.from_text(_text_of(said))


def _check(model: Model, trajectory: Mapping[str, str]) -> None:
    """Refuse what no force of time alone can make exact."""
    if not isinstance(model, Model):
        raise InputError(f"model is {str(model)[:60]!r}, needs a Model")
    kinds = {"contacts": model.contacts, "frictions": model.frictions, "regimes": model.regimes, "functions in Python": model.python_functions}  # fmt: skip
    for kind, ones in kinds.items():
        if ones:
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
    faults += [f"'{name}' is no coordinate or state; there are {', '.join(needed)}" for name in trajectory if name not in needed]  # fmt: skip
    if faults:
        raise InputError(f"manufactured solution: {'; '.join(faults)}", tuple(faults))


def _missing(model: Model, along: Mapping[str, Node]) -> dict[str, Node]:
    """Return M a less all forces, on the trajectory, by coordinate."""
    found: dict[str, Node] = dict.fromkeys(model.coordinates, ZERO)
    places = list(model.coordinates)
    for (i, j), entry in model.statement.mass_entries.items():
        turned = multiply(expand(model.expanded(entry), along), _rate(along[velocity(places[j])]))
        found[places[i]] = add(found[places[i]], turned)
    for parts in model.force_components.values():
        for name, one in parts.items():
            assert not isinstance(one, Function)  # noqa: S101 - refused above
            found[name] = _less(found[name], expand(model.expanded(one), along))
    return found


def _rate(tree: Node) -> Node:
    return derivative(tree, {"t": ONE})


def _less(left: Node, right: Node) -> Node:
    return left if right == ZERO else Binary("-", left, right)


def _text_of(said: Mapping[str, object]) -> str:
    """Print a statement as TOML."""
    return Model(**said).to_toml()

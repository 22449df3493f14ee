"""What acts in some regimes alone: trees that are zero in the others."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

from xdynamics.expressions import Call, Compare, Name, Node, Number
from xdynamics.expressions.calculus import ZERO, sum_of_terms
from xdynamics.model.parts import Regime, State

REGIME_NUMBER = "_regime"  # the name by which trees read the number of the current regime, from 0


def in_some(tree: Node, numbers: Iterable[int]) -> Node:
    """Return a tree that is itself in the regimes of some numbers, else 0."""
    selected: Node = ZERO
    for i in sorted(numbers, reverse=True):
        selected = Call("where", (Compare("==", Name(REGIME_NUMBER), Number(float(i))), tree, selected))
    return selected


def with_regimes(state: State, regimes: Mapping[str, Regime]) -> State:
    """Return a state whose rate has each term in the regimes that list it; terms that none lists act always."""
    if not state.terms:
        return state
    listed = {name for regime in regimes.values() for name in regime.terms}
    acting = {
        name: in_some(tree, [i for i, regime in enumerate(regimes.values()) if name in regime.terms])
        if name in listed
        else tree
        for name, tree in state.terms.items()
    }
    own = [] if state.own_rate is None else [state.own_rate]
    return replace(state, rate=sum_of_terms([*own, *acting.values()]), acting=acting)

"""Solving with the mass matrix, as trees: M u = right, by division or by the factors L D L^T."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import reduce

from xdynamics.expressions import Binary, Call, Name, Node
from xdynamics.model.model import Model
from xdynamics.model.parts import Function


@dataclass(frozen=True)
class Assignment:
    """``name = value``; the value is an expression without definitions, or a function written in Python."""

    name: str
    value: Node | Function


def mass_factors(model: Model) -> Iterator[Assignment]:
    """Write what solving with the mass needs: its diagonal, or the factors of M = L D L^T."""
    if not model.mass_is_full:
        for i in range(len(model.statement.coordinates)):
            yield Assignment(f"_m{i}", Call("positive", (model.expanded(model.mass[i][i]),)))
        return
    mass = [[model.expanded(entry) for entry in row] for row in model.mass]
    for i, row in enumerate(mass):
        for j in range(i):
            products = (product_of_names(f"_l{i}_{k}", f"_l{j}_{k}", f"_d{k}") for k in range(j))
            yield Assignment(f"_l{i}_{j}", Binary("/", subtract_terms(row[j], products), Name(f"_d{j}")))
        products = (product_of_names(f"_l{i}_{k}", f"_l{i}_{k}", f"_d{k}") for k in range(i))
        yield Assignment(f"_d{i}", Call("positive", (subtract_terms(row[i], products),)))


def solve_mass(model: Model, rows: Mapping[str, Node], names: Iterable[str] | None = None) -> Iterator[Assignment]:
    """Solve M u = right for the unknowns, by division or forward and back through the factors."""
    unknowns, right = list(rows), list(rows.values())
    if not model.mass_is_full:
        row_of = {name: i for i, name in enumerate(model.statement.coordinates)}
        for name, unknown, tree in zip(
            model.statement.coordinates if names is None else names, unknowns, right, strict=True
        ):
            yield Assignment(unknown, Binary("/", tree, Name(f"_m{row_of[name]}")))
        return
    n = len(unknowns)
    z = [f"_z{i}_{unknown}" for i, unknown in enumerate(unknowns)]
    for i in range(n):
        yield Assignment(z[i], subtract_terms(right[i], (product_of_names(f"_l{i}_{k}", z[k]) for k in range(i))))
    for i in reversed(range(n)):
        back_products = (product_of_names(f"_l{k}_{i}", unknowns[k]) for k in range(i + 1, n))
        yield Assignment(unknowns[i], subtract_terms(Binary("/", Name(z[i]), Name(f"_d{i}")), back_products))


def product_of_names(*names: str) -> Node:
    """Multiply named numbers, one after the other."""
    operands: list[Node] = [Name(name) for name in names]
    return reduce(lambda left, right: Binary("*", left, right), operands)


def subtract_terms(tree: Node, terms: Iterable[Node]) -> Node:
    """Subtract terms, one after the other."""
    return reduce(lambda left, right: Binary("-", left, right), terms, tree)

"""Energies in sympy's indexed symbols as a model: what is indexed has dimensions, a sum over an index is one along them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from xdynamics.expressions import Along, Call, Compare, Element, Name, Node, Number, text_of
from xdynamics.faults import InputError
from xdynamics.model.symbolic import TERM, Trees
from xdynamics.schema import velocity


def are_energies(equations: Any) -> bool:
    """Whether something is an expression of sympy, or some of them, and no object with equations."""
    try:
        from sympy import Expr
    except ImportError:
        return False
    return isinstance(equations, Expr | tuple | list)


def sections_of_energies(energies: Any, sections: Mapping[str, Any]) -> dict[str, Any]:
    """Return the sections of a model from its energies.

    Parameters
    ----------
    energies : sympy expression, or two of them
        The potential energy, beside `mass` in the sections; or kinetic and potential energy.
    sections : mapping
        Of a model: `dimensions` with their numbers of elements, `coordinates` and `parameters` with their `dims`, …

    Raises
    ------
    InputError
        If an index is not of a sum, leaves its dimension, or belongs to a symbol without dimensions.
    """
    trees = IndexedTrees(sections)
    if not isinstance(energies, tuple | list):
        if "mass" not in sections:
            raise InputError("the potential energy alone needs mass=…; or give kinetic and potential energy")
        force = {TERM: {"potential": text_of(trees.tree(energies))}}
        return {"name": "from sympy"} | dict(sections) | {"forces": force | dict(sections.get("forces", {}))}
    if len(energies) != 2:
        raise InputError(f"{len(energies)} energies are given, needs two: the kinetic and the potential energy")
    kinetic, potential = (text_of(trees.tree(energy)) for energy in energies)
    return {"name": "from sympy"} | dict(sections) | {"lagrangian": {"kinetic": kinetic, "potential": potential}}


class IndexedTrees(Trees):
    """Converts sympy's trees with indexed symbols.

    Parameters
    ----------
    sections : mapping
        With the dimensions of symbols.
    """

    def __init__(self, sections: Mapping[str, Any]) -> None:
        super().__init__({})
        self._sizes = {
            str(dim): size if isinstance(size, int) else len(size)
            for dim, size in sections.get("dimensions", {}).items()
        }
        self._dims: dict[str, tuple[str, ...]] = {}
        for section in ("coordinates", "parameters", "states"):
            for name, entry in sections.get(section, {}).items():
                dims = entry.get("dims", ()) if isinstance(entry, Mapping) else ()
                self._dims[name] = (dims,) if isinstance(dims, str) else tuple(dims)
                if section == "coordinates":
                    self._dims[velocity(name)] = self._dims[name]
        self._bound: dict[Any, tuple[str, int, int]] = {}  # of each index of a sum its dimension and its range

    def tree(self, one: Any) -> Node:
        """Convert an expression of sympy; an `InputError` where the language of expressions has no such node."""
        import sympy

        if isinstance(one, sympy.Sum):
            return self._sum_along(one)
        if isinstance(one, sympy.Indexed):
            return self._element(one)
        if one in self._bound:
            return Along("index", (), (self._bound[one][0],))
        return super().tree(one)

    def _sum_along(self, one: Any) -> Node:
        """Convert a sum, the innermost index first."""
        for index, low, high in one.limits:
            if not (low.is_Integer and high.is_Integer):
                raise InputError(f"the sum over {index} goes from {low} to {high}, needs whole numbers")
            self._bound[index] = self._dimension(one.function, index), int(low), int(high)
        dims = [self._bound[index][0] for index, _, _ in one.limits]
        if len(set(dims)) < len(dims):
            raise InputError(f"{one} sums twice along '{dims[0]}'; say who acts on whom by a relation")
        tree = self.tree(one.function)
        for index, _, _ in one.limits:
            dim, low, high = self._bound.pop(index)
            last, place = self._sizes[dim] - 1, Along("index", (), (dim,))
            if not 0 <= low <= high <= last:
                raise InputError(f"the sum over {index} goes from {low} to {high}, and '{dim}' from 0 to {last}")
            for operator, bound, end in ((">=", low, 0), ("<=", high, last)):
                if bound != end:
                    tree = Call("where", (Compare(operator, place, Number(float(bound))), tree, Number(0.0)))
            tree = Along("sum", (tree,), (dim,))
        return tree

    def _dimension(self, summed: Any, index: Any) -> str:
        """Return the dimension along which an index counts."""
        import sympy

        found = {
            dims[place]
            for one in summed.atoms(sympy.Indexed)
            if len(dims := self._own(one)) == len(one.indices)
            for place, entry in enumerate(one.indices)
            if index in entry.free_symbols
        }
        if len(found) != 1:
            along = f"along {' and '.join(sorted(found))}" if found else "of no symbol"
            raise InputError(f"the index {index} is {along}; it needs to count along one dimension")
        return found.pop()

    def _own(self, one: Any) -> tuple[str, ...]:
        """Return the dimensions of an indexed symbol."""
        name = str(one.base.label)
        if not (dims := self._dims.get(name, ())):
            raise InputError(
                f"'{name}' is indexed, and has no dimensions; give it dims in coordinates or parameters:"
                f' "{name}": {{"dims": ["site"], …}}'
            )
        return dims

    def _element(self, one: Any) -> Node:
        """Convert an indexed symbol: to one element, or to the value at the place of a sum, perhaps some places on."""
        name, dims = str(one.base.label), self._own(one)
        if len(one.indices) != len(dims):
            raise InputError(f"{one} has {len(one.indices)} indices, and '{name}' the dimensions {', '.join(dims)}")
        if all(index.is_Integer for index in one.indices):
            return Element(name, tuple(map(int, one.indices)))
        tree: Node = Name(name)
        for index, dim in zip(one.indices, dims, strict=True):
            counted = [bound for bound in self._bound if bound in index.free_symbols]
            on = index - counted[0] if len(counted) == 1 else index
            if not on.is_Integer or self._bound[counted[0]][0] != dim:
                raise InputError(
                    f"{one} has the index {index}, needs that of a sum along '{dim}', or one some places on"
                )
            _, low, high = self._bound[counted[0]]
            if not (low + on >= 0 and high + on < self._sizes[dim]):
                raise InputError(
                    f"{one} goes from {low + on} to {high + on}, and '{dim}' from 0 to {self._sizes[dim] - 1}"
                )
            if on:
                tree = Along("roll", (tree,), (dim,), -int(on))
        return tree

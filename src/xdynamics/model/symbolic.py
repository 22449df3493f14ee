"""Equations of motion and energies from sympy as a model: trees are converted node by node, never as text.

Equations of motion come from `sympy.physics.mechanics`. Energies may have indexed symbols: an indexed symbol is a
quantity with dimensions, a sum over an index is a sum along a dimension.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

from xdynamics.expressions import Along, Binary, Call, Compare, Element, Name, Negative, Node, Number, text_of
from xdynamics.faults import InputError
from xdynamics.schema import velocity

FUNCTIONS = {
    "sin": "sin",
    "cos": "cos",
    "tan": "tan",
    "asin": "asin",
    "acos": "acos",
    "atan": "atan",
    "atan2": "atan2",
    "sinh": "sinh",
    "cosh": "cosh",
    "tanh": "tanh",
    "exp": "exp",
    "log": "log",
    "Abs": "abs",
    "sign": "sign",
    "Min": "min",
    "Max": "max",
    "floor": "floor",
    "ceiling": "ceil",
    "Mod": "mod",
}
TERM = "motion"  # the force term that holds the right-hand side


def sections_of(equations: Any, sections: Mapping[str, Any]) -> dict[str, Any]:
    """Return the sections of a model from equations of motion and further sections.

    Parameters
    ----------
    equations : LagrangesMethod or KanesMethod
        Of `sympy.physics.mechanics`, its equations formed.
    sections : mapping
        Further sections of a model file: `coordinates` with the unit of each, `parameters`, `initial`, and any other.

    Raises
    ------
    InputError
        If sympy is not installed, the object is neither of these, its speeds are not derivatives of coordinates, it
        contains something the language of expressions does not have, or a coordinate lacks a unit.
    """
    try:
        from sympy.physics.mechanics import KanesMethod, LagrangesMethod, dynamicsymbols
    except ImportError:
        raise InputError("Model.from_sympy needs sympy: pip install 'xdynamics[sympy]'") from None
    if not isinstance(equations, KanesMethod | LagrangesMethod):
        raise InputError(
            f"equations are {str(equations)[:60]!r}, need a LagrangesMethod or KanesMethod of sympy.physics.mechanics, or"
            " energies in indexed symbols"
        )
    time = dynamicsymbols._t  # noqa: SLF001 - sympy's own name for the time of dynamic symbols
    coordinates = list(equations.q)
    speeds = [coordinate.diff(time) for coordinate in coordinates]
    mass, forcing = (_by_kane if isinstance(equations, KanesMethod) else _by_lagrange)(equations, speeds)
    names = {coordinate: str(coordinate.func) for coordinate in coordinates}
    names |= {speed: velocity(names[coordinate]) for coordinate, speed in zip(coordinates, speeds, strict=True)} | {
        time: "t"
    }
    trees = Trees(names)
    rows = [[text_of(trees.convert(entry)) for entry in mass.row(i)] for i in range(len(coordinates))]
    forces = {
        names[coordinate]: text_of(trees.convert(entry)) for coordinate, entry in zip(coordinates, forcing, strict=True)
    }
    units = sections.get("coordinates", {})
    if missing := [names[coordinate] for coordinate in coordinates if names[coordinate] not in units]:
        raise InputError(f'coordinates need a unit for \'{missing[0]}\': coordinates={{"{missing[0]}": "m"}}')
    if TERM in sections.get("forces", {}):
        raise InputError(f"forces has '{TERM}', which is what the equations are called; rename it")
    motion_sections = {
        "coordinates": {names[coordinate]: units[names[coordinate]] for coordinate in coordinates},
        "mass": {"matrix": rows},
    }
    motion_sections["forces"] = {TERM: forces} | dict(sections.get("forces", {}))
    return {"name": "from sympy"} | dict(sections) | motion_sections


def _by_kane(equations: Any, speeds: Sequence[Any]) -> tuple[Any, Any]:
    """Return mass matrix and forcing in derivatives of the coordinates."""
    from sympy import simplify

    derivatives = equations.kindiffdict()
    if any(
        simplify(derivatives[speed] - generalised_speed) != 0
        for speed, generalised_speed in zip(speeds, equations.u, strict=True)
    ):
        raise InputError(
            "the generalised speeds of KanesMethod are no time derivatives of its coordinates; choose u = q'"
        )
    renamed = dict(zip(equations.u, speeds, strict=True))
    return equations.mass_matrix.xreplace(renamed), equations.forcing.xreplace(renamed)


def _by_lagrange(equations: Any, _: Sequence[Any]) -> tuple[Any, Any]:
    """Return mass matrix and forcing, which are in derivatives of the coordinates."""
    if equations.coneqs:
        raise InputError("LagrangesMethod has constraints; choose coordinates without")
    try:
        return equations.mass_matrix, equations.forcing
    except ValueError:
        raise InputError("LagrangesMethod has no equations yet; call form_lagranges_equations() first") from None


class Trees:
    """Converts sympy's trees: dynamic symbols by the names given, other symbols by their own."""

    def __init__(self, names: Mapping[Any, str]) -> None:
        self._names = names

    def convert(self, expression: Any) -> Node:
        """Convert an expression of sympy.

        Raises
        ------
        InputError
            If the language of expressions does not have a node.
        """
        import sympy

        if expression in self._names:
            return Name(self._names[expression])
        if expression is sympy.pi:
            return Name("pi")
        if expression.is_Symbol:
            return Name(str(expression.name))
        if expression.is_Number:
            return self._convert_number(expression)
        if expression.is_Add:
            return self._convert_sum(expression.as_ordered_terms())
        if expression.is_Mul:
            return self._convert_product(expression)
        if expression.is_Pow:
            return self._convert_power(*expression.as_base_exp())
        name = FUNCTIONS.get(type(expression).__name__)
        if name is None:
            raise InputError(f"the equations hold {str(expression)[:60]!r}, which the language of expressions has not")
        return Call(name, tuple(self.convert(argument) for argument in expression.args))

    def _convert_number(self, number: Any) -> Node:
        if number.is_negative:
            return Negative(self._convert_number(-number))
        if number.is_Rational and number.q != 1:
            return Binary("/", Number(float(number.p)), Number(float(number.q)))
        if not number.is_finite:
            raise InputError(f"the equations hold the number {number}")
        return Number(float(number))

    def _convert_sum(self, terms: list[Any]) -> Node:
        total = self.convert(terms[0])
        for term in terms[1:]:
            sign = "-" if term.could_extract_minus_sign() else "+"
            total = Binary(sign, total, self.convert(-term if sign == "-" else term))
        return total

    def _convert_product(self, product: Any) -> Node:
        import sympy

        if product.could_extract_minus_sign():
            return Negative(self.convert(-product))
        above, below = sympy.fraction(product)
        numerator: Node | None = None
        for factor in [item for item in above.as_ordered_factors() if item != 1]:
            tree = self.convert(factor)
            numerator = tree if numerator is None else Binary("*", numerator, tree)
        numerator = Number(1.0) if numerator is None else numerator
        return numerator if below == 1 else Binary("/", numerator, self.convert(below))

    def _convert_power(self, base: Any, exponent: Any) -> Node:
        import sympy

        if base is sympy.E:
            return Call("exp", (self.convert(exponent),))
        if exponent == sympy.Rational(1, 2):
            return Call("sqrt", (self.convert(base),))
        if exponent == -1:
            return Binary("/", Number(1.0), self.convert(base))
        if not exponent.is_Rational:
            raise InputError(
                f"the equations hold the power {str(base**exponent)[:60]!r}; an exponent has to be a number"
            )
        return Binary("**", self.convert(base), self._convert_number(exponent))


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
        force = {TERM: {"potential": text_of(trees.convert(energies))}}
        model_sections: dict[str, Any] = {"forces": force | dict(sections.get("forces", {}))}
        return {"name": "from sympy"} | dict(sections) | trees.relations() | model_sections
    if len(energies) != 2:
        raise InputError(f"{len(energies)} energies are given, needs two: the kinetic and the potential energy")
    kinetic, potential = (text_of(trees.convert(energy)) for energy in energies)
    model_sections = {"lagrangian": {"kinetic": kinetic, "potential": potential}}
    return {"name": "from sympy"} | dict(sections) | trees.relations() | model_sections


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
        self._ends: dict[Any, tuple[str, str]] = {}  # of each index of a sum over pairs its end and the relation
        self._declared = dict(sections.get("relations", {}))

    def relations(self) -> dict[str, Any]:
        """Return the section of relations, with those of sums over pairs."""
        return {"relations": self._declared} if self._declared else {}

    def convert(self, expression: Any) -> Node:
        """Convert an expression of sympy; an `InputError` where the language of expressions has no such node."""
        import sympy
        from sympy.matrices.expressions.matexpr import MatrixElement

        if isinstance(expression, sympy.Sum):
            return self._sum_along(expression)
        if isinstance(expression, sympy.Indexed | MatrixElement):
            return self._convert_element(expression)
        if isinstance(expression, sympy.MatrixExpr) and expression.shape == (1, 1):
            return self.convert(expression.as_explicit()[0, 0])
        if expression in self._ends:
            return self._value_at_end(Along("index", (), (self._bound[expression][0],)), expression)
        if expression in self._bound:
            return Along("index", (), (self._bound[expression][0],))
        return super().convert(expression)

    def _sum_along(self, expression: Any) -> Node:
        """Convert a sum, the innermost index first; over two indices of one dimension as one over pairs."""
        limits, function = [*expression.limits], expression.function
        for low, high in combinations(limits, 2):
            if (dim := self._index_dimension(function, low[0])) == self._index_dimension(function, high[0]):
                remaining_limits = [limit for limit in limits if limit not in (low, high)]
                return self._over_pairs(
                    type(expression)(function, *remaining_limits) if remaining_limits else function, low, high, dim
                )
        for index, low, high in limits:
            if not (low.is_Integer and high.is_Integer):
                raise InputError(f"the sum over {index} goes from {low} to {high}, needs whole numbers")
            self._bound[index] = self._index_dimension(function, index), int(low), int(high)
        tree = self.convert(function)
        for index, _, _ in limits:
            dim, low, high = self._bound.pop(index)
            last, index_tree = self._sizes[dim] - 1, Along("index", (), (dim,))
            if not 0 <= low <= high <= last:
                raise InputError(
                    f"the sum over {index} goes from {low} to {high}, and '{dim}' from 0 to {last}; sum over fewer"
                )
            for operator, bound, end in ((">=", low, 0), ("<=", high, last)):
                if bound != end:
                    tree = Call("where", (Compare(operator, index_tree, Number(float(bound))), tree, Number(0.0)))
            tree = Along("sum", (tree,), (dim,))
        return tree

    def _over_pairs(self, function: Any, first_limits: Any, second_limits: Any, dim: str) -> Node:
        """Convert a sum over two indices of a dimension: over every two once, or over all of both.

        The second is two of the first where exchanging the indices changes nothing, and the sum with both alike.
        """
        from sympy import Sum

        last = self._sizes[dim] - 1
        i, j, diagonal = first_limits[0], second_limits[0], 0
        if tuple(first_limits[1:]) == tuple(second_limits[1:]) == (0, last):
            exchanged = function.xreplace({i: j, j: i})
            function, diagonal = (
                2 * function if exchanged == function else function + exchanged,
                _diagonal_summand(function, i, j),
            )
        elif _is_before(second_limits, first_limits, last):
            i, j = j, i
        elif not _is_before(first_limits, second_limits, last):
            ranges = [f"{index} from {low} to {high}" for index, low, high in (first_limits, second_limits)]
            raise InputError(
                f"the sums over {' and '.join(ranges)} are both along '{dim}'; let one go from 0 to {last - 1} and the other"
                f" from its next to {last}, or both from 0 to {last}"
            )
        relation = next((name for name, entry in self._declared.items() if entry == {"of": dim}), f"{dim}_pair")
        self._declared.setdefault(relation, {"of": dim})
        self._bound |= {i: (dim, 0, last), j: (dim, 0, last)}
        self._ends |= {i: ("first", relation), j: ("second", relation)}
        tree: Node = Along("sum", (self.convert(function),), (relation,))
        for index in (i, j):
            del self._bound[index], self._ends[index]
        return Binary("+", tree, self.convert(Sum(diagonal, (i, 0, last)))) if diagonal else tree

    def _value_at(self, tree: Node, number: int, dim: str, expression: Any) -> Node:
        """Return the values at one element of a dimension."""
        size = self._sizes[dim]
        if not -size <= number < size:
            raise InputError(f"{expression} has the index {number}, and '{dim}' goes from 0 to {size - 1}")
        is_element = Compare("==", Along("index", (), (dim,)), Number(float(number % size)))
        return Along("sum", (Call("where", (is_element, tree, Number(0.0))),), (dim,))

    def _value_at_end(self, tree: Node, index: Any) -> Node:
        """Return a value at the end of a pair whose index is given, or at the index of a sum."""
        end, relation = self._ends.get(index, ("", ""))
        return Along(end, (tree,), (relation,)) if end else tree

    def _index_dimension(self, summed: Any, index: Any) -> str:
        """Return the dimension along which an index counts."""
        import sympy
        from sympy.matrices.expressions.matexpr import MatrixElement

        index_dims = {
            dims[position]
            for symbol in summed.atoms(sympy.Indexed, MatrixElement)
            if len(dims := self._symbol_dims(symbol)) == len(_symbol_indices(symbol, dims))
            for position, entry in enumerate(_symbol_indices(symbol, dims))
            if index in entry.free_symbols
        }
        if len(index_dims) != 1:
            direction_text = f"along {' and '.join(sorted(index_dims))}" if index_dims else "of no symbol"
            raise InputError(f"the index {index} is {direction_text}; it needs to count along one dimension")
        return index_dims.pop()

    def _symbol_dims(self, symbol: Any) -> tuple[str, ...]:
        """Return the dimensions of an indexed symbol."""
        name = _symbol_name(symbol)
        if not (dims := self._dims.get(name, ())):
            raise InputError(
                f"'{name}' is indexed, and has no dimensions; give it dims in coordinates or parameters:"
                f' "{name}": {{"dims": ["site"], …}}'
            )
        shape = tuple(self._sizes[dim] for dim in dims)
        if not hasattr(symbol, "base") and tuple(symbol.parent.shape) not in (shape, (*shape, 1)):
            raise InputError(
                f"'{name}' is a matrix of {symbol.parent.shape}, and its dimensions {', '.join(dims)} have {shape}"
            )
        return dims

    def _convert_element(self, symbol: Any) -> Node:
        """Convert an indexed symbol: to one element, or to the value at an index of a sum, perhaps shifted."""
        from sympy import Mod

        name, dims = _symbol_name(symbol), self._symbol_dims(symbol)
        indices = _symbol_indices(symbol, dims)
        if len(indices) != len(dims):
            raise InputError(f"{symbol} has {len(indices)} indices, and '{name}' the dimensions {', '.join(dims)}")
        if all(index.is_Integer for index in indices):
            return Element(name, tuple(map(int, indices)))
        tree: Node = Name(name)
        for index, dim in zip(indices, dims, strict=True):
            if index.is_Integer:
                tree = self._value_at(tree, int(index), dim, symbol)
                continue
            ring = isinstance(index, Mod) and index.args[1] == self._sizes[dim]
            index_expression = index.args[0] if ring else index
            sum_indices = [bound for bound in self._bound if bound in index_expression.free_symbols]
            offset = index_expression - sum_indices[0] if len(sum_indices) == 1 else index_expression
            if not sum_indices or not offset.is_Integer or self._bound[sum_indices[0]][0] != dim:
                raise InputError(
                    f"{symbol} has the index {index}, needs that of a sum along '{dim}', or one some places on"
                )
            _, low, high = self._bound[sum_indices[0]]
            if not ring and not (low + offset >= 0 and high + offset < self._sizes[dim]):
                raise InputError(
                    f"{symbol} goes from {low + offset} to {high + offset}, and '{dim}' from 0 to {self._sizes[dim] - 1}; sum over"
                    f" fewer, or write Mod({index}, {self._sizes[dim]}) in the brackets, of a ring"
                )
            if offset:
                tree = Along("roll", (tree,), (dim,), -int(offset))
            tree = self._value_at_end(tree, sum_indices[0])
        return tree


def _symbol_name(symbol: Any) -> str:
    """Return the name of an indexed symbol, or of a matrix of which this is an element."""
    return str(symbol.base.label) if hasattr(symbol, "base") else str(symbol.parent.name)


def _symbol_indices(symbol: Any, dims: tuple[str, ...]) -> tuple[Any, ...]:
    """Return the indices of an element; of a matrix with one column, or row, that along it."""
    indices = tuple(symbol.indices) if hasattr(symbol, "base") else (symbol.i, symbol.j)
    return (
        indices[:1]
        if len(dims) == 1 and len(indices) == 2 and not hasattr(symbol, "base") and indices[1] == 0
        else indices
    )


def _is_before(first_limits: Any, second_limits: Any, last: int) -> bool:
    """Whether two sums go over every two elements once, the index of the first before that of the second."""
    (i, *of_i), (j, *of_j) = first_limits, second_limits
    return (of_j == [i + 1, last] and of_i in ([0, last - 1], [0, last])) or (
        of_i == [0, j - 1] and of_j in ([1, last], [0, last])
    )


def _diagonal_summand(function: Any, i: Any, j: Any) -> Any:
    """Return a summand with both indices alike.

    Raises
    ------
    InputError
        If it is not finite.
    """
    import sympy

    summand = function.xreplace({j: i}).replace(
        lambda part: isinstance(part, sympy.Sum) and part.function == 0, lambda _: sympy.Integer(0)
    )
    if summand.has(sympy.zoo, sympy.nan, sympy.oo):
        raise InputError(f"the sum over {i} and {j} is not finite where they are alike; begin {j} at {i} + 1")
    return summand

"""Equations of motion from `sympy.physics.mechanics` as a model: trees are converted node by node, never as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from xdynamics.expressions import Binary, Call, Name, Negative, Node, Number, text_of
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

"""Equations of motion of `sympy.physics.mechanics` as a model: their trees are taken over node by node, never as text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from xdynamics.expressions import Binary, Call, Name, Negative, Node, Number, text_of
from xdynamics.faults import InputError
from xdynamics.schema import velocity

FUNCTIONS = {
    "sin": "sin", "cos": "cos", "tan": "tan", "asin": "asin", "acos": "acos", "atan": "atan", "atan2": "atan2",
    "sinh": "sinh", "cosh": "cosh", "tanh": "tanh", "exp": "exp", "log": "log", "Abs": "abs", "sign": "sign",
    "Min": "min", "Max": "max",
}  # fmt: skip
TERM = "motion"  # the force term that holds the right-hand side


def sections_of(equations: Any, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the sections of a model that equations of motion and what else is given make.

    Parameters
    ----------
    equations : LagrangesMethod or KanesMethod
        Of `sympy.physics.mechanics`, its equations formed.
    given : mapping
        Further sections of a model file: `coordinates` with the unit of each, `parameters`, `initial`, and any other.

    Raises
    ------
    InputError
        If sympy is not there, the object is none of these, its speeds are no derivatives of coordinates, or it holds what
        the language of expressions has not.
    """
    try:
        import sympy
        from sympy.physics.mechanics import KanesMethod, LagrangesMethod, dynamicsymbols
    except ImportError:
        raise InputError("Model.from_sympy needs sympy: pip install 'xdynamics[sympy]'") from None
    if not isinstance(equations, KanesMethod | LagrangesMethod):
        raise InputError(f"equations are {str(equations)[:60]!r}, need a LagrangesMethod or KanesMethod of sympy.physics.mechanics")  # fmt: skip
    time = dynamicsymbols._t  # noqa: SLF001 - sympy's own name for the time of dynamic symbols
    coordinates = list(equations.q)
    speeds = [one.diff(time) for one in coordinates]
    if isinstance(equations, KanesMethod):
        known = equations.kindiffdict()
        if [sympy.simplify(known[speed] - own) for speed, own in zip(speeds, equations.u, strict=True)] != [0] * len(speeds):  # fmt: skip
            raise InputError(
                "the generalised speeds of KanesMethod are no time derivatives of its coordinates; choose u = q'"
            )
        renamed = dict(zip(equations.u, speeds, strict=True))
        mass, forcing = equations.mass_matrix.xreplace(renamed), equations.forcing.xreplace(renamed)
    else:
        if equations.coneqs:
            raise InputError("LagrangesMethod has constraints; choose coordinates without")
        try:
            mass, forcing = equations.mass_matrix, equations.forcing
        except ValueError:
            raise InputError("LagrangesMethod has no equations yet; call form_lagranges_equations() first") from None
    names = {one: str(one.func) for one in coordinates}
    names |= {speed: velocity(names[one]) for one, speed in zip(coordinates, speeds, strict=True)} | {time: "t"}
    taken = _Taken(names)
    rows = [[text_of(taken.tree(entry)) for entry in mass.row(i)] for i in range(len(coordinates))]
    forces = {names[one]: text_of(taken.tree(entry)) for one, entry in zip(coordinates, forcing, strict=True)}
    told = given.get("coordinates", {})
    if missing := [names[one] for one in coordinates if names[one] not in told]:
        raise InputError(f'coordinates need a unit for \'{missing[0]}\': coordinates={{"{missing[0]}": "m"}}')
    if TERM in given.get("forces", {}):
        raise InputError(f"forces has '{TERM}', which is what the equations are called; rename it")
    own = {"coordinates": {names[one]: told[names[one]] for one in coordinates}, "mass": {"matrix": rows}}
    own["forces"] = {TERM: forces} | dict(given.get("forces", {}))
    return {"name": "from sympy"} | dict(given) | own


class _Taken:
    """Takes sympy's trees over: dynamic symbols by their names, parameters as they are called."""

    def __init__(self, names: Mapping[Any, str]) -> None:
        self._names = names

    def tree(self, one: Any) -> Node:
        """Return a tree of the language.

        Raises
        ------
        InputError
            If a node is none of the language.
        """
        import sympy

        if one in self._names:
            return Name(self._names[one])
        if one is sympy.pi:
            return Name("pi")
        if one.is_Symbol:
            return Name(str(one.name))
        if one.is_Number:
            return self._number(one)
        if one.is_Add:
            return self._sum(one.as_ordered_terms())
        if one.is_Mul:
            return self._product(one)
        if one.is_Pow:
            return self._power(*one.as_base_exp())
        name = FUNCTIONS.get(type(one).__name__)
        if name is None:
            raise InputError(f"the equations hold {str(one)[:60]!r}, which the language of expressions has not")
        return Call(name, tuple(self.tree(each) for each in one.args))

    def _number(self, one: Any) -> Node:
        if one.is_negative:
            return Negative(self._number(-one))
        if one.is_Rational and one.q != 1:
            return Binary("/", Number(float(one.p)), Number(float(one.q)))
        if not one.is_finite:
            raise InputError(f"the equations hold the number {one}")
        return Number(float(one))

    def _sum(self, terms: list[Any]) -> Node:
        found = self.tree(terms[0])
        for term in terms[1:]:
            sign = "-" if term.could_extract_minus_sign() else "+"
            found = Binary(sign, found, self.tree(-term if sign == "-" else term))
        return found

    def _product(self, one: Any) -> Node:
        import sympy

        if one.could_extract_minus_sign():
            return Negative(self.tree(-one))
        above, below = sympy.fraction(one)
        found: Node | None = None
        for factor in [each for each in above.as_ordered_factors() if each != 1]:
            tree = self.tree(factor)
            found = tree if found is None else Binary("*", found, tree)
        found = Number(1.0) if found is None else found
        return found if below == 1 else Binary("/", found, self.tree(below))

    def _power(self, base: Any, exponent: Any) -> Node:
        import sympy

        if base is sympy.E:
            return Call("exp", (self.tree(exponent),))
        if exponent == sympy.Rational(1, 2):
            return Call("sqrt", (self.tree(base),))
        if exponent == -1:
            return Binary("/", Number(1.0), self.tree(base))
        if not exponent.is_Rational:
            raise InputError(
                f"the equations hold the power {str(base**exponent)[:60]!r}; an exponent has to be a number"
            )
        return Binary("**", self.tree(base), self._number(exponent))

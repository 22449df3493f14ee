"""One source of error of a number, and its size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from fractions import Fraction
from math import inf, isfinite, nan, sqrt
from typing import Any

from xdynamics.budgeting.measurand import Target
from xdynamics.evidence.kept_results import ResultForm
from xdynamics.faults import InputError
from xdynamics.units import Dimension, Quantity, Unit, parse_quantity, parse_unit, time_in

NUMERICAL, PHYSICAL = "numerical", "physical"
KINDS = (NUMERICAL, PHYSICAL)
BOUNDED = sqrt(3.0)  # standard uncertainties in a bound: a rectangular distribution (JCGM 100:2008, 4.3.7)
COVERED = 2.0  # standard uncertainties taken as the bound of a term without one


@dataclass(frozen=True)
class Term:
    """A term of a budget, in the unit of its number.

    Attributes
    ----------
    name : str
        Name of a parameter or an initial value, or a word such as ``truncation``.
    kind : {"numerical", "physical"}
    standard : float
        The standard uncertainty that it contributes.
    bound : float
        Its largest contribution; two standard uncertainties for a term without a bound.
    rule : str
        How it was found.
    sensitivity : float
        Of the number to the input, per SI unit of the input; nan without such an input.
    input_uncertainty : float
        Of the input, in SI units.
    input_unit : Unit, optional
    sensitivity_doubt : float
        How far the sensitivity may be off, in its unit.
    standard_doubt : float
        How far the standard uncertainty may be off, being from few draws, or from slopes that draws do not fully
        confirm.
    """

    name: str
    kind: str
    standard: float
    bound: float
    rule: str
    sensitivity: float = nan
    input_uncertainty: float = nan
    input_unit: Unit | None = None
    sensitivity_doubt: float = nan
    standard_doubt: float = 0.0

    @classmethod
    def bounded(cls, name: str, kind: str, bound: float, rule: str) -> Term:
        """Return a term with a known bound."""
        return cls(name, kind, bound / BOUNDED, bound, rule)

    @classmethod
    def unknown(cls, name: str, kind: str, rule: str) -> Term:
        """Return a term of which nothing bounds the size."""
        return cls(name, kind, inf, inf, rule)


def _terms_as_lists(terms: Sequence[Term]) -> list[Any]:
    """Return terms as lists of texts and numbers."""
    rows = [[getattr(term, entry.name) for entry in fields(Term)] for term in terms]
    return [[_unit_as_list(entry) if isinstance(entry, Unit) else entry for entry in row] for row in rows]


def _terms_of_lists(rows: Sequence[Sequence[Any]]) -> list[Term]:
    names = [entry.name for entry in fields(Term)]
    entries: list[list[Any]] = [
        [_unit_of_list(entry) if isinstance(entry, list) else entry for entry in row] for row in rows
    ]
    return [Term(**dict(zip(names, row, strict=True))) for row in entries]


def _unit_as_list(unit: Unit) -> list[Any]:
    return [unit.text, [*map(str, unit.dimension.powers)], str(unit.factor)]


def _unit_of_list(entry: Sequence[Any]) -> Unit:
    text, powers, factor = entry
    return Unit(text, Dimension(tuple(map(Fraction, powers))), Fraction(factor))


TERMS = ResultForm(_terms_as_lists, _terms_of_lists)


@dataclass(frozen=True)
class Declared:
    """A term that the author of a budget declares, for one number only.

    Parameters
    ----------
    name : str
    quantity : str
        As in the budget, like `at`, or `event` and `occurrence`: terms of another number are refused.
    standard : str or Quantity
        Standard uncertainty of the quantity: ``"1 mm"``.
    at : str or float, s, optional
    event : str, optional
    occurrence : int
    kind : {"numerical", "physical"}
    description : str
    """

    name: str
    quantity: str
    standard: str | Quantity
    at: str | float | None = None
    event: str = ""
    occurrence: int = 1
    kind: str = PHYSICAL
    description: str = ""

    def term(self, target: Target, unit: Unit) -> Term:
        """Return it as a term of a budget.

        Raises
        ------
        InputError
            If it is of another quantity, unit, time or event, or its name, kind or size is wrong.
        """
        if not isinstance(self.name, str) or not self.name:
            raise InputError(f"a declared term is named {self.name!r}, needs a word")
        moment = None if self.at is None else time_in(parse_unit(target.second), self.at, f"at of term '{self.name}'")
        stated_number, required = (
            (self.quantity, moment, self.event, self.occurrence),
            (target.quantity, target.at, target.event, target.occurrence),
        )
        if stated_number != required:
            description = Target(
                self.quantity, moment, self.event, self.occurrence, target.side, target.second
            ).description
            raise InputError(
                f"term '{self.name}' is of {description}, and the budget of {target.description}: propagate it there first"
            )
        size = self.standard if isinstance(self.standard, Quantity) else parse_quantity(self.standard, difference=True)
        if size.unit.dimension != unit.dimension:
            raise InputError(f"term '{self.name}' is {size}, and {target.description} has the unit '{unit.text}'")
        if self.kind not in KINDS:
            raise InputError(f"term '{self.name}' is of the kind {self.kind!r}; there are {', '.join(KINDS)}")
        standard = size.si / float(unit.factor) if isfinite(size.value) else nan
        if not 0.0 <= standard < inf:
            raise InputError(f"term '{self.name}' is {size}, needs a non-negative number")
        return Term(self.name, self.kind, standard, COVERED * standard, self.description or "declared")

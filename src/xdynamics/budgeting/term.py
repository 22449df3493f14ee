"""Terms of an error budget: one source of error of a number, and its size.

Each source of error is computed alone, left out, or combined with others into a budget.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from fractions import Fraction
from functools import partial
from math import inf, isfinite, nan, sqrt
from typing import TYPE_CHECKING, Any

from xdynamics.budgeting.measurand import Measurand, Target
from xdynamics.evidence.kept_results import ResultForm
from xdynamics.evidence.stage_tasks import Gathered, Task
from xdynamics.faults import InputError
from xdynamics.shapes import Shapes
from xdynamics.units import Dimension, Quantity, Unit, parse_quantity, parse_unit, time_in

if TYPE_CHECKING:
    import xarray as xr

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
        """Return the stated uncertainty as a term of a budget.

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


RUN, NUMBER, COMPARED, ROUNDING, COPIES = "run", "number", "levels", "rounding", "copies"  # what sources share
OWN = "own run"  # what a budget says of the run


@dataclass(frozen=True)
class ErrorSource:
    """A source of error, which gives one term or, of all inputs together, several.

    Attributes
    ----------
    names : tuple of str
        Of its terms.
    needs : tuple of str
        What it takes of that which sources share: the run, the number in it, the number in finer levels, the terms of
        rounding, the number in copies with changed inputs.
    terms : callable
        From these to the terms.
    blank : callable
        From the unit of the number to the terms as far as they are known before anything is marched.
    inputs : tuple
        What else the terms depend on, besides the measurand.
    """

    names: tuple[str, ...]
    needs: tuple[str, ...]
    terms: Callable[..., Sequence[Term]]
    blank: Callable[[Unit], Sequence[Term]]
    inputs: tuple[Any, ...] = ()

    @classmethod
    def of_one(
        cls,
        name: str,
        kind: str,
        needs: tuple[str, ...],
        term: Callable[..., Term],
        *inputs: Any,
        unit: Unit | None = None,
    ) -> ErrorSource:
        """Return a source of one term; `unit` is that of its input, if it has one."""
        return cls(
            (name,),
            needs,
            partial(_as_term_list, term),
            partial(_as_term_list, partial(_blank_term, name, kind, unit)),
            inputs,
        )

    def task(self, measurand: Measurand, shared_tasks: Mapping[str, Task | Gathered]) -> Task:
        """Return the task that computes the terms, alone."""
        needs = tuple(shared_tasks[name] for name in self.needs)
        words = (self.names, *measurand.inputs, *self.inputs)
        if measurand.keep is None:
            return Task.of(self.names[0], self.terms, needs, *words)
        # what is needed follows from the number; and blocks that are there already have other names than those to come
        task = replace(Task.of(self.names[0], self.terms, (), shared_tasks[NUMBER].name, *words), needs=needs)
        return measurand.keep.task(task, TERMS)


def _as_term_list(term: Callable[..., Term], *needs: Any) -> list[Term]:
    return [term(*needs)]


def _blank_term(name: str, kind: str, input_unit: Unit | None, _unit: Unit) -> Term:
    return Term(name, kind, nan, nan, "", input_unit=input_unit)


def stated_source(measurand: Measurand, name: str, term: Callable[[Unit], Term]) -> ErrorSource:
    """Return a source whose term is stated, and follows from the unit of the number."""
    stated_terms = partial(_as_term_list, term)
    return ErrorSource((name,), (RUN,), partial(_stated_terms, stated_terms, measurand.target), stated_terms, (name,))


def _stated_terms(terms: Callable[[Unit], list[Term]], target: Target, run: xr.Dataset) -> list[Term]:
    return terms(target.units(run))


def names_left_out(names: Sequence[str], shapes: Shapes, only: Any, exclusions: Any) -> frozenset[str]:
    """Return which terms of a budget are left out, by the names that are wanted or not wanted.

    A name is that of a term, or of a quantity with dimensions, whose elements are meant.

    Raises
    ------
    InputError
        If a name is no term of the budget, or no term is left.
    """
    only_names, excluded_names = (_read_names(only, shapes, "only"), _read_names(exclusions, shapes, "without"))
    for keyword, term_names in (("only", only_names), ("without", excluded_names)):
        for name in term_names or ():
            if name not in names:
                raise InputError(
                    f"{keyword} names '{name}', which is no term of this budget; there are {', '.join(names)}"
                )
    if only_names is not None and excluded_names is not None:
        raise InputError("only and without are both given; name the terms that are wanted, or those that are not")
    left_out = frozenset(excluded_names or ()) if only_names is None else frozenset(names) - {*only_names}
    if left_out >= {*names}:
        raise InputError(f"no term is left of the budget; there are {', '.join(names)}")
    return left_out


def _read_names(names: Any, shapes: Shapes, keyword: str) -> Collection[str] | None:
    row = [names] if isinstance(names, str) else names
    if row is None:
        return None
    if not isinstance(row, Collection) or not all(isinstance(name, str) for name in row):
        raise InputError(f"{keyword} is {str(names)[:60]!r}, needs names of terms, like ['roundoff']")
    return [element for name in row for element in shapes.elements(shapes.internal_name(name, f"{keyword} names"))]

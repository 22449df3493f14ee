"""Sources of error of a number: each is computed alone, left out, or put together with others into a budget."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import nan
from typing import TYPE_CHECKING, Any

from xdynamics.budgeting.measurand import Measurand, Target
from xdynamics.budgeting.term import TERMS, Term
from xdynamics.evidence.stage_tasks import Gathered, Task
from xdynamics.faults import InputError
from xdynamics.shapes import Shapes
from xdynamics.units import Unit

if TYPE_CHECKING:
    import xarray as xr

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

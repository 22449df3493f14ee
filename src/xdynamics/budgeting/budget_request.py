"""What an error budget is asked for, read and checked, and the sources of error that it has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from xdynamics.budgeting.measurand import Measurand, Target
from xdynamics.budgeting.numerical import numerical_sources
from xdynamics.budgeting.physical import discrepancy_source, input_source
from xdynamics.budgeting.random_draws import Propagation
from xdynamics.budgeting.sources import ErrorSource, names_left_out, stated_source
from xdynamics.budgeting.tabulated import table_sources
from xdynamics.budgeting.term import PHYSICAL, Declared, Term
from xdynamics.evidence.kept_results import Keep
from xdynamics.faults import InputError
from xdynamics.model import Model, check_model
from xdynamics.runtime.cached_properties import cached_property
from xdynamics.sweeping.sweep import json_value

COVERAGE = 0.95
MIN_DRAWS = 100


@dataclass(frozen=True)
class BudgetRequest:
    """What a budget is asked for.

    Attributes
    ----------
    measurand : Measurand
    declared : tuple of Declared
    draws : int
    coverage : float
    digits : int
    inadequate_fit : bool
    left_out : tuple of str
        Names of terms.
    proven : bool
        Whether the number is compared with proven bounds.
    """

    measurand: Measurand
    declared: tuple[Declared, ...]
    draws: int
    coverage: float
    digits: int
    inadequate_fit: bool
    left_out: tuple[str, ...] = ()
    proven: bool = False

    @property
    def target(self) -> Target:
        """What is taken of the run."""
        return self.measurand.target

    @property
    def words(self) -> tuple[Any, ...]:
        """Everything that the budget depends on, for the name of its task."""
        request_words = (
            self.declared,
            self.draws,
            self.measurand.seed,
            self.coverage,
            self.digits,
            self.inadequate_fit,
            self.left_out,
            self.proven,
        )
        return (*self.measurand.inputs, *request_words)

    @property
    def inputs(self) -> list[str]:
        """Uncertain parameters and initial values that are not left out."""
        return [name for name in self.measurand.model.uncertain if name not in self.left_out]

    @cached_property
    def sources(self) -> list[ErrorSource]:
        """Its sources of error: of the march, of the model, and declared ones."""
        measurand = self.measurand
        sources = [
            *numerical_sources(measurand),
            *([input_source(measurand, self.inputs)] if self.inputs else []),
            *table_sources(measurand),
            *discrepancy_source(measurand),
            *(stated_source(measurand, term.name, partial(term.term, measurand.target)) for term in self.declared),
        ]
        return [source for source in sources if not {*source.names} <= {*self.left_out}]

    @property
    def names(self) -> list[str]:
        """The names of all terms.

        Raises
        ------
        InputError
            If two have the same name.
        """
        names = [name for source in self.sources for name in source.names]
        if repeated := sorted({name for name in names if names.count(name) > 1}):
            in_model = repeated[0] not in {term.name for term in self.declared}
            remedy = f"rename the model's '{repeated[0]}'" if in_model else "give the declared one another name"
            raise InputError(f"the budget has two terms '{repeated[0]}'; {remedy}")
        return names

    def propagation(self, value: float, terms: Sequence[Term]) -> Propagation:
        """Return what is drawn: inputs of the model, and other physical terms."""
        added_uncertainties = [
            term.standard for term in terms if term.kind == PHYSICAL and term.name not in self.inputs
        ]
        return Propagation(self.measurand, self.inputs, value, added_uncertainties)


def budget_request(
    model: Model,
    quantity: str,
    *,
    at: Any = None,
    event: Any = None,
    occurrence: Any = 1,
    side: Any = "before",
    terms: Any = (),
    draws: int = 0,
    seed: int = 0,
    coverage: float = COVERAGE,
    digits: int = 1,
    inadequate_fit: bool = False,
    only: Any = None,
    without: Any = None,
    proven: bool = False,
    keep: Any = None,
    **settings: Any,
) -> BudgetRequest:
    """Read and check the arguments of `error_budget`.

    Raises
    ------
    InputError
        If one is wrong, or the model was fitted inadequately.
    """
    check_model(model)
    _check_draw_settings(draws, seed, coverage, digits)
    _check_fit(model, inadequate_fit)
    target = Target.from_arguments(model, quantity, at, event, occurrence, side)
    marched = {name: json_value(name, entry) for name, entry in settings.items() if entry is not None}
    declared = tuple(map(_checked_declared, (terms,) if isinstance(terms, Declared) else terms or ()))
    full_request = BudgetRequest(
        Measurand(model, target, marched, seed, Keep.of(keep)),
        declared,
        draws,
        coverage,
        digits,
        inadequate_fit is True,
        proven=proven is True,
    )
    names = full_request.names
    left_out = names_left_out(names, model.shapes, only, without)
    return (
        replace(full_request, left_out=tuple(name for name in names if name in left_out)) if left_out else full_request
    )


def _check_fit(model: Model, inadequate_fit: Any) -> None:
    if model.fit is not None and not model.fit.adequate and inadequate_fit is not True:
        raise InputError(
            f"the model was fitted to '{model.fit.data}', and the fit is not adequate: {model.fit.description}. Fit it"
            " again, from other starts or with another model, or ask for the budget all the same: inadequate_fit=True"
            " (--inadequate-fit)"
        )


def _check_draw_settings(draws: Any, seed: Any, coverage: Any, digits: Any) -> None:
    if isinstance(digits, bool) or digits not in (1, 2):
        raise InputError(f"digits is {digits!r}; there are 1, 2")
    if isinstance(draws, bool) or not isinstance(draws, int) or not (draws == 0 or draws >= MIN_DRAWS):
        raise InputError(f"draws is {draws!r}, needs 0 for none, or a whole number from {MIN_DRAWS} on")
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise InputError(f"seed is {seed!r}, needs a non-negative whole number")
    if isinstance(coverage, bool) or not isinstance(coverage, int | float) or not 0.0 < coverage < 1.0:
        raise InputError(f"coverage is {coverage!r}, needs a number between 0 and 1, like 0.95")


def _checked_declared(term: Any) -> Declared:
    if not isinstance(term, Declared):
        raise InputError(f"terms has {str(term)[:60]!r}, needs Declared(name, quantity, standard, at=…)")
    return term

"""Sums of values times factors that stay the same: one operation a term, and none until a number is asked for.

Of high orders a coefficient is small beside the state, so that its rounding does not matter, and what matters is how long
the next one waits for it: ``-(k*x + c*(2*x*y))/m`` is two products there, by factors that are computed once in a step.
"""

from __future__ import annotations

from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.program import Operand

Form = dict[Operand, Operand]  # factors by the values that they belong to
MOST_TERMS = 3  # of a form: what many others are made of is summed once


class LinearForms:
    """Sums that are written when they are needed, and names for them until then.

    Parameters
    ----------
    lines : Assignments

    Attributes
    ----------
    still : set of Operand
        Values that do not change with time: those of factors.
    exact : bool
        Whether products of factors are to be exact; sums are written where they are not.
    """

    def __init__(self, lines: Assignments) -> None:
        self.lines = lines
        self.still: set[Operand] = set()
        self.exact = True
        self._forms: dict[Operand, Form] = {}
        self._written: dict[Operand, Operand] = {}
        self._ages: dict[Operand, int] = {}

    def linear_form(self, operation: str, *arguments: Operand) -> Operand | None:
        """Name what an operation gives, without a line of it; None of one that is not linear."""
        match operation, arguments:
            case "negative", (value,):
                return self.scale_form(value, -1.0)
            case (("add" | "subtract"), (first, second)):
                return self._add_forms(first, second, 1.0 if operation == "add" else -1.0)
            case "multiply", (still, value) if self._stays(still):
                return self.scale_form(value, still)
            case "multiply", (value, still) if self._stays(still):
                return self.scale_form(value, still)
        return None

    def scale_form(self, value: Operand, factor: Operand) -> Operand:
        """Name the product of a value and what stays the same."""
        form = self._form_of(value)
        if not all(self.can_multiply(term_factor, factor) for term_factor in form.values()) or (
            len(form) > 1 and not self.can_multiply(0.0, factor)
        ):
            value = self.write_value(value)
        return self._name_form(
            {term: self.multiply_factors(term_factor, factor) for term, term_factor in self._form_of(value).items()}
        )

    def can_multiply(self, first: Operand, second: Operand) -> bool:
        """Whether factors may be multiplied."""
        return not self.exact or not {1.0, -1.0, 2.0, 0.5}.isdisjoint((first, second))

    def multiply_factors(self, first: Operand, second: Operand) -> Operand:
        """Multiply factors."""
        for left, right in ((first, second), (second, first)):
            if left == 1.0:
                return right
            if left == -1.0:
                return self._constant_product("negative", right)
        return self._constant_product("multiply", first, second)

    def write_value(self, value: Operand) -> Operand:
        """Return a value itself, whose sum is written if none was before: what is newest comes last."""
        if value not in self._forms:
            return value
        if value not in self._written:
            total: Operand = 0.0
            for term, factor in sorted(self._forms[value].items(), key=lambda item: self._ages.get(item[0], -1)):
                total = self._add_term(term, factor, total)
            self._written[value] = self.note_age(total)
        return self._written[value]

    def write_if_long(self, value: Operand) -> Operand:
        """Return a value that several others are multiples of: a sum is written once for all of them."""
        return self.write_value(value) if len(self._form_of(value)) > 1 else value

    def note_age(self, value: Operand) -> Operand:
        """Remember when a value was written."""
        self._ages.setdefault(value, len(self._ages))
        return value

    def _stays(self, value: Operand) -> bool:
        return not isinstance(value, str) or value in self.still

    def _constant_product(self, operation: str, *factors: Operand) -> Operand:
        value = self.lines.compute(operation, *factors)
        self.still.add(value)
        return value

    def _form_of(self, value: Operand) -> Form:
        if value in self._written:
            return {self._written[value]: 1.0}
        return self._forms.get(value) or ({} if value == 0.0 else {value: 1.0})

    def _name_form(self, form: Form) -> Operand:
        if not form:
            return 0.0
        (value, factor), *further_terms = form.items()
        if not further_terms and factor == 1.0:
            return value
        name = f"form {len(self._forms)}"
        self._forms[name] = form
        return name

    def _add_forms(self, first: Operand, second: Operand, sign: float) -> Operand:
        terms = *self._form_of(first), *self._form_of(second)
        if len({*terms}) > MOST_TERMS or (self.exact and len({*terms}) < len(terms)):
            first, second = self.write_value(first), self.write_value(second)
        form = dict(self._form_of(first))
        for value, factor in self._form_of(second).items():
            signed_factor = self.multiply_factors(factor, sign)
            form[value] = self._constant_product("add", form[value], signed_factor) if value in form else signed_factor
        return self._name_form({value: factor for value, factor in form.items() if factor != 0.0})

    def _add_term(self, value: Operand, factor: Operand, total: Operand) -> Operand:
        compute = self.lines.compute
        if total == 0.0:
            return (
                value
                if factor == 1.0
                else compute("negative", value)
                if factor == -1.0
                else compute("multiply", value, factor)
            )
        if factor in (1.0, -1.0):
            return compute("add" if factor == 1.0 else "subtract", total, value)
        return compute("fma", value, factor, total)

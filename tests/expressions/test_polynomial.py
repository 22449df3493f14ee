"""Expressions as polynomials in one of their names."""

from __future__ import annotations

import pytest

from xdynamics.expressions import parse, text_of
from xdynamics.expressions.calculus import polynomial_coefficients
from xdynamics.expressions.evaluation import evaluate


@pytest.mark.parametrize("text", ["a + s*(b + (1 - s)*c)", "-(s - a)**3/b", "(a*s - b)*(s - c)*s", "a - s", "a*b/c"])
def test_coefficients_have_the_value_of_the_expression(text: str) -> None:
    """Assert that the sum of the terms is the expression's value."""
    values = {"a": 1.25, "b": -0.5, "c": 3.0, "s": 0.375}
    terms = polynomial_coefficients(parse(text), "s")
    assert sum(evaluate(term, values) * values["s"] ** k for k, term in enumerate(terms)) == evaluate(
        parse(text), values
    )
    assert not any("s" in text_of(term) for term in terms)


@pytest.mark.parametrize("text", ["sin(s)", "a/s", "s**0.5", "s**-1"])
def test_what_is_no_polynomial(text: str) -> None:
    """Assert that a name in a function, a divisor or another power is refused, with the expression."""
    with pytest.raises(ValueError, match="is no polynomial in s"):
        polynomial_coefficients(parse(text), "s")

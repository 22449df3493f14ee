"""What is said of values and uncertainties that were meant as expressions of the element."""

from __future__ import annotations

import re

import numpy as np
import pytest

import xdynamics as xd

CHAIN = """
name = "chain"
[dimensions]
site = 5
[coordinates]
u = {{ unit = "m", dims = ["site"] }}
[parameters]
k = "1 N m-1"
c = {entry}
[mass]
u = "1*kilogram"
[forces.spring]
u = "-k*u"
[initial]
u = "{start}"
"""
OF_SITES = '{{ dims = ["site"], {} }}'


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        (
            OF_SITES.format('value = "2*index(site"'),
            "expression '2*index(site' cannot be read at column 13: ')' is missing",
        ),
        (OF_SITES.format('value = "twice(index(site))"'), "function 'twice' is not known"),
        (
            OF_SITES.format('value = "1/index(site)"'),
            "model 'chain': parameter 'c': '1/index(site)' is inf at c[0], and needs finite numbers; index counts from 0",
        ),
        (OF_SITES.format('value = "log(3 - index(site))"'), "'log(3 - index(site))' is -inf at c[3], and needs finite"),
        (
            OF_SITES.format('value = "2*index(site)", uncertainty = "0.1*index(site)"'),
            "uncertainty is the expression '0.1*index(site)'; write one number with a unit for all elements, or a list",
        ),
        (
            OF_SITES.format('value = [1, 2, 3, 4, 5], half_width = "0.1*index(site"'),
            "half_width is the expression '0.1*index(site'; write one number",
        ),
        (
            '"2*k"',
            "'2*k' is an expression, needs a number with a unit, like '0.145 kg'; what follows from parameters is a",
        ),
        ('{ value = "1 N", uncertainty = "0.1*k" }', "uncertainty: quantity '0.1*k' has '*' after its number; write a"),
    ],
)
def test_expressions_that_are_no_values_are_named(entry: str, message: str) -> None:
    """Assert what is said of brackets, functions, numbers that are infinite, and sizes by expression."""
    with pytest.raises(xd.InputError, match=re.escape(message)):
        xd.Model.from_text(CHAIN.format(entry=entry, start="0 m"))


def test_an_open_bracket_at_the_start_is_named() -> None:
    """Assert that a start that is meant as an expression is read as one."""
    with pytest.raises(
        xd.InputError, match=re.escape("initial value 'u': expression '2*index(site*metre' cannot be read")
    ):
        xd.Model.from_text(CHAIN.format(entry='"1 N"', start="2*index(site*metre"))


def test_the_largest_of_all_elements_is_read_at_the_start() -> None:
    """Assert that `max` and `min` along a dimension are read in starts and values, as `sum` is."""
    wrap = "cos(0.3*index(site))"
    text = CHAIN.format(
        entry='{ dims = ["site"], value = "(1 + index(site))/max(1 + index(site), site)" }',
        start=f"metre*{wrap}/max({wrap}, site)*min(c, site)",
    )
    start = xd.simulate(xd.Model.from_text(text), method="rk4", step=0.1, until=0.1).u.values[0]
    found = np.cos(0.3 * np.arange(5))
    np.testing.assert_allclose(start, found / found.max() / 5.0, rtol=1e-15)

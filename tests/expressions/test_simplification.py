"""Expressions in print: the same value, fewer signs."""

from __future__ import annotations

import random

import pytest

import xdynamics as xd
from cases.command_line import call
from cases.problems import MODELS
from xdynamics.expressions import derivative, parse, text_of
from xdynamics.expressions.calculus import ONE
from xdynamics.expressions.evaluation import evaluate
from xdynamics.expressions.latex import printed_simply, simplified

SIMPLER = {
    "-(k*(2*x)/2)": "-k*x",
    "a + -(3*b)": "a - 3*b",
    "0*a + 1*b": "b",
    "3*x**2/6": "x**2/2",
    "a - (b - x)": "a - b + x",
    "2*(3*(a + 1*b))": "6*(a + b)",
    "a/(b/x)": "a*x/b",
    "-a*-b": "a*b",
    "-(-(x**1))": "x",
    "sin(2*x/2)": "sin(x)",
    "a/(sqrt(x)*sqrt(x)**2)": "a/sqrt(x)**3",
    "2*(x + 2)/2": "x + 2",
    "a*(1 + 1)/(50 + 1)": "2*a/51",
    "x*(1 - 2)": "-x",
}
AS_WRITTEN = ["a/b/2", "a/(2*b)", "0.5*a*x**2", "where(x > 0*metre, a, b)", "x/0", "1e+300*1e+300*x", "(-x)**2"]
VALUES = {"a": 1.7, "b": -0.3, "k": 4.1, "x": 0.83, "metre": 1.0}


@pytest.mark.parametrize("text", SIMPLER)
def test_signs_and_numbers_are_drawn_together(text: str) -> None:
    """Assert the printed text, that reading it gives the printed tree, and that its value is the same."""
    simple = simplified(parse(text))
    assert (printed_simply(parse(text)), text_of(simple)) == (SIMPLER[text], SIMPLER[text])
    assert parse(SIMPLER[text]) == simple
    assert evaluate(simple, VALUES) == pytest.approx(evaluate(parse(text), VALUES), rel=1e-15)


@pytest.mark.parametrize("text", AS_WRITTEN)
def test_what_is_simple_stays(text: str) -> None:
    """Assert that what is no longer than its simplified form is printed as it was written."""
    assert printed_simply(parse(text)) == text


def test_derivatives_keep_their_values() -> None:
    """Assert that of 200 random expressions and their derivatives the simplified form has the same value."""
    dice = random.Random(1)

    def grown(depth: int) -> str:
        if depth == 0:
            return dice.choice(["a", "b", "x", "2", "3", "0.5", "x**2", "k", "1", "0"])
        left, right = grown(depth - 1), grown(depth - 1)
        return dice.choice(
            [
                f"({left} + {right})",
                f"({left} + 2)*x",
                f"({left} - {right})",
                f"({left})*({right})",
                f"-({left})/4",
                f"sin({left})",
            ]
        )

    for _ in range(200):
        tree = parse(grown(4))
        for each in (tree, derivative(tree, {"x": ONE})):
            assert evaluate(simplified(each), VALUES) == pytest.approx(evaluate(each, VALUES), rel=1e-11, abs=1e-11)


def test_check_prints_simply_and_the_model_stays() -> None:
    """Assert that `check` prints a spring's force as one would write it, and that the digest knows nothing of it."""
    path = MODELS / "harmonic_oscillator.toml"
    assert "force     spring of x = -k*x\n" in call("check", path).output
    model = xd.Model.from_toml(path)
    assert text_of(model.force_components["spring"]["x"]) == "-(k*(2*x)/2)"

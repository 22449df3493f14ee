"""Expressions: reading, printing, dimensions, derivatives held against sympy.

Expressions as polynomials in one of their names.
Expressions in print: the same value, fewer signs.
"""

from __future__ import annotations

import math
import random

import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st

import xdynamics as xd
from cases.command_line import call
from cases.problems import MODELS
from xdynamics.expressions import (
    Binary,
    Call,
    Compare,
    Name,
    Negative,
    Node,
    Number,
    derivative,
    digest,
    dimension_of,
    expand,
    free_names,
    latex,
    parse,
    text_of,
)
from xdynamics.expressions.calculus import ONE, polynomial_coefficients
from xdynamics.expressions.evaluation import evaluate
from xdynamics.expressions.latex import printed_simply, simplified
from xdynamics.faults import InputError
from xdynamics.units import parse_unit

KNOWN = {
    name: parse_unit(unit).dimension
    for name, unit in {
        "m": "kg",
        "c": "kg m-1",
        "y": "m",
        "v_y": "m s-1",
        "t": "s",
        "metre": "m",
        "theta": "rad",
    }.items()
}

numbers = st.floats(0, 1e12, allow_nan=False).map(Number)
names = st.sampled_from(["x", "y", "v_y", "pi"]).map(Name)


def grown(inner: st.SearchStrategy[Node]) -> st.SearchStrategy[Node]:
    """Trees one level higher."""
    return st.one_of(
        inner.map(Negative),
        st.tuples(st.sampled_from("+-*/"), inner, inner).map(lambda one: Binary(*one)),
        st.tuples(inner, st.sampled_from(["2", "3", "-1", "0.5", "3/2", "-2"])).map(
            lambda one: Binary("**", one[0], parse(one[1]))
        ),
        st.tuples(st.sampled_from(["sin", "sqrt", "abs", "exp"]), inner).map(lambda one: Call(one[0], (one[1],))),
        st.tuples(st.sampled_from(["min", "atan2", "hypot"]), inner, inner).map(lambda one: Call(one[0], one[1:])),
        st.tuples(st.sampled_from(["<", ">=", "!="]), inner, inner, inner, inner).map(
            lambda one: Call("where", (Compare(*one[:3]), *one[3:]))
        ),
    )


trees = st.recursive(st.one_of(numbers, names), grown, max_leaves=12)


@pytest.mark.dear
@given(trees)
@settings(max_examples=300)
def test_print_and_parse_gives_the_same_tree(tree: Node) -> None:
    """Assert that printing loses nothing."""
    assert parse(text_of(tree)) == tree


@given(st.text(alphabet="xyv_12.+-*/(),<= sincowherep", max_size=60))
@settings(max_examples=500)
def test_any_text_is_an_expression_or_an_input_error(text: str) -> None:
    """Assert that nothing else is ever raised."""
    try:
        parse(text)
    except InputError:
        return


@pytest.mark.parametrize(
    "text",
    [
        "9**9**9",
        "a;b",
        "__import__('os')",
        "x.real",
        "lambda: 0",
        "(" * 50,
        "-" * 1999 + "1",
        "1e999",
        "x if y else z",
        "a**b",
        "where(1,2,3)",
        "sin()",
        "a and b",
        "[1]",
        "x<y",
        "9" * 1990,
        "x**17",
        "x" * 2001,
        "x\ny",
        "",
        "open(x)",
        "min(x)",
        "1j",
        "0x10**2 + f(2)",
        "x**-(17)",
        "sin(x, y=1)",
        "sin(*x)",
        "True",
        "é",
        "x:=2",
        "1_000 +",
        "min(x, y, *z)",
    ],
    ids=lambda one: one[:14],
)
def test_hostile_text_ends_in_one_error(text: str) -> None:
    """Assert that what is no part of the language is refused."""
    with pytest.raises(InputError, match="expression"):
        parse(text)


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("c*v_y*abs(v_y)", "N"),
        ("y/(1*metre)", "1"),
        ("sqrt(y*y)", "m"),
        ("y**(1/2)*y**0.5", "m"),
        ("where(y > 0, y, 2*y)", "m"),
        ("atan2(y, 2*y)", "rad"),
        ("min(y, 2*y, 3*y)", "m"),
        ("sign(v_y)*y", "m"),
        ("0*metre + y", "m"),
        ("sin(theta)", "1"),
    ],
)
def test_dimension(text: str, unit: str) -> None:
    """Assert the dimension of expressions."""
    assert dimension_of(parse(text), KNOWN) == parse_unit(unit).dimension


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("y + v_y", r"'\+' joins 'y' in 'm' with 'v_y' in 'm s-1' \(column 5\)"),
        ("sin(y)", "'sin' needs a pure number, got 'y' in 'm'"),
        ("y > 0", "stands in 'where' alone"),
        ("where(y > 1, y, y)", "'>' joins 'y' in 'm' with '1' in '1'"),
        ("v_z*t", "'v_z' .column 1. is not declared; did you mean 'v_y'"),
        ("hypot(y, t)", "'hypot' joins"),
        ("exp(t)", "pure number"),
    ],
)
def test_wrong_dimension_names_term_and_units(text: str, message: str) -> None:
    """Assert that the error names the term, both units and the column."""
    with pytest.raises(InputError, match=message):
        dimension_of(parse(text), KNOWN)


def to_sympy(node: Node) -> sympy.Expr:
    """Build sympy's tree node by node, never from text."""
    match node:
        case Number():
            return sympy.Float(node.value, 30)
        case Name():
            return sympy.Symbol(node.name, real=True)
        case Negative():
            return -to_sympy(node.operand)
        case Binary():
            left, right = to_sympy(node.left), to_sympy(node.right)
            return {"+": left + right, "-": left - right, "*": left * right, "/": left / right, "**": left**right}[
                node.operator
            ]
        case Call(function="abs"):
            return sympy.Abs(to_sympy(node.arguments[0]))
        case Call(function="hypot"):
            x, y = map(to_sympy, node.arguments)
            return sympy.sqrt(x**2 + y**2)
        case Call():
            function = {"min": sympy.Min, "max": sympy.Max}.get(node.function) or getattr(sympy, node.function)
            return function(*map(to_sympy, node.arguments))
    raise TypeError(node)


SMOOTH = [
    "k*x**2/2",
    "sin(x)*cos(y)",
    "exp(-x/y)",
    "log(x + y)",
    "sqrt(x*y)",
    "x**3/(1 + x**2)",
    "tan(x)",
    "asin(x/3)",
    "acos(x/3)",
    "atan(x*y)",
    "atan2(x, y)",
    "sinh(x)",
    "cosh(x)",
    "tanh(x)",
    "hypot(x, y)",
    "abs(-x)*x",
    "x**-1.5",
    "(x + 1)**(3/2)",
    "-m/sqrt(x**2 + y**2)",
    "x/y/x",
    "x - (y - x)",
    "2**-1*x",
]


@pytest.mark.parametrize("text", SMOOTH)
def test_derivative_agrees_with_sympy(text: str) -> None:
    """Assert that the rules give what a computer-algebra system gives, at a point."""
    tree = parse(text)
    point = {sympy.Symbol(name, real=True): value for name, value in {"x": 0.7, "y": 1.3, "k": 2.0, "m": 1.5}.items()}
    mine = to_sympy(derivative(tree, {"x": Number(1.0)})).evalf(20, subs=point)
    theirs = sympy.diff(to_sympy(tree), sympy.Symbol("x", real=True)).evalf(20, subs=point)
    assert math.isclose(mine, theirs, rel_tol=1e-14, abs_tol=1e-15)


def test_derivative_of_choices_takes_the_branch() -> None:
    """Assert the derivative of min, max, where and sign."""
    one = {"x": Number(1.0)}
    assert text_of(derivative(parse("max(x, 2*x)"), one)) == "where(x >= 2*x, 1, 2)"
    assert text_of(derivative(parse("where(y > 0, x**2, 3)"), one)) == "where(y > 0, 2*x, 0)"
    assert derivative(parse("sign(x)"), one) == Number(0.0)


def test_derivative_in_time_follows_the_chain() -> None:
    """Assert that rates of several names add up."""
    rates = {"t": Number(1.0), "y": Name("v_y")}
    assert text_of(derivative(parse("y - t*g"), rates)) == "v_y - g"


def test_expansion_is_bounded() -> None:
    """Assert that definitions that double one another end in an error, at once."""
    doubling = {f"d{n}": parse(f"d{n - 1} + d{n - 1}") for n in range(1, 60)} | {"d0": parse("x")}
    with pytest.raises(InputError, match="expand"):
        expand(parse("d59"), doubling)


def test_digest_is_of_what_is_said() -> None:
    """Assert that spaces do not count and a sign does."""
    assert digest(parse("a+b")) == digest(parse("a  +  b")) != digest(parse("a-b"))
    assert free_names(parse("a + sin(b)")) == {"a", "b"}


def test_latex_is_drawn_by_matplotlib() -> None:
    """Assert that the LaTeX of a rich expression is in matplotlib's subset."""
    from matplotlib.mathtext import MathTextParser

    text = latex(parse("where(x_1 >= 0, -alpha*sqrt(x_1)/2, abs(omega)**2)*atan2(y, 3) - (a - b)"))
    assert MathTextParser("path").parse(f"${text}$").width > 0


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

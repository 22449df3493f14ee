"""Expressions: reading, printing, dimensions, derivatives held against sympy."""

from __future__ import annotations

import math

import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st

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

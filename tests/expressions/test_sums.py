"""Sums and products of any length: one meaning wherever a tree is walked, and a clear end to nesting."""

from __future__ import annotations

import copy
import pickle
from functools import lru_cache, reduce
from operator import add, mul

import numpy as np
import pytest

import xdynamics as xd
from cases.bench import Bench
from cases.problems import particle
from xdynamics.expressions import (
    Binary,
    Name,
    Number,
    derivative,
    derivatives,
    dimension_of,
    expand,
    free_names,
    latex,
    limits_domain,
    parse,
    size,
    text_of,
)
from xdynamics.expressions.calculus import MOST_LEVELS, ONE
from xdynamics.expressions.evaluation import evaluate
from xdynamics.expressions.parser import DEEPEST
from xdynamics.faults import InputError
from xdynamics.kernels import law_of, layout_of
from xdynamics.kernels.law import CONTROL
from xdynamics.methods.scheme import Scheme
from xdynamics.units import parse_unit

LENGTHS = (41, 3000)  # by the chunk, and deeper than Python nests calls
PLACES = ("force", "potential", "observable", "definition")


def factors(n: int) -> list[float]:
    """Numbers of many sizes, none the double of another's neighbour, so that their order shows in the last bits."""
    return [1.0 + (7 * i % 1013) / 997 for i in range(n)]


@lru_cache
def summed(n: int, place: str) -> xd.Model:
    """A particle with a sum of n different terms in one place of its model."""
    terms = [f"{factor!r}*F*x/d" for factor in factors(n)]
    total = " + ".join(terms)
    more: dict[str, object] = {"parameters": {"m": "2 kg", "F": "5 N", "d": "1 m"}}
    if place == "force":
        more["forces"] = {"push": {"x": total}}
    elif place == "potential":
        more["forces"] = {"push": {"potential": " - ".join(terms).replace("*x", "*x**2/2")}}
    elif place == "observable":
        more["observables"] = {"total": total}
    else:
        more["definitions"] = {"total": total}
        more["forces"] = {"push": {"x": "total"}}
    return particle(**more)


def expected(n: int, place: str) -> float:
    """The sum from left to right, at x = 1 m and F = 5 N."""
    if place == "potential":  # the derivative of each term is half of 2 x
        first, *rest = [factor * 5.0 * 2.0 / 2.0 for factor in factors(n)]
        return -reduce(lambda so_far, term: so_far - term, rest, first)
    return reduce(add, [factor * 5.0 for factor in factors(n)])


@pytest.mark.every(11)
@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("n", LENGTHS)
def test_a_sum_is_added_from_the_left(n: int, place: str) -> None:
    """Assert that a force, a potential, an observable and a definition of n terms have the bits of a loop."""
    run = xd.simulate(summed(n, place), method="rk4", step="1e-9 s", until="2e-9 s")
    found = run["total" if place == "observable" else "force_push_x"]
    assert float(found[0]) == expected(n, place)
    assert xd.Model.from_text(run.model_toml.values.item()) == summed(n, place)


@pytest.mark.every(3)
@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("n", LENGTHS)
def test_printed_python_of_a_long_sum_is_machine_code(n: int, place: str) -> None:
    """Assert that the printed law runs, and computes every number that the compiled one does."""
    law = law_of(layout_of(summed(n, place), Scheme(xd.METHODS["rk4"], "none")), sampled=True)
    compiled, printed = (Bench(law, 1, np.array([[1.3], [0.7]]), np.array([1e-3])) for _ in range(2))
    for address, key in zip(law.addresses_inside[len(CONTROL) :], law.plain[len(CONTROL) :], strict=True):
        compiled.call(int(address))
        printed.call_plainly(int(key))
    for mine, other in zip(compiled.arrays(), printed.arrays(), strict=True):
        assert mine.tobytes() == other.tobytes()


@pytest.mark.dear
def test_every_walk_takes_a_chain_in_a_loop() -> None:
    """Assert that 10,000 terms and 10,000 factors are read, printed, compared, sized, measured and evaluated."""
    for sign, join in ((" + ", add), ("*", mul)):
        text = "x" + f"{sign}1.0000001" * 10_000
        tree = parse(text)
        assert parse(text_of(tree)) == tree != parse(text + " - x")
        assert hash(parse(text)) == hash(tree)
        assert size(tree) == 20_001
        assert free_names(tree) == {"x"}
        assert not limits_domain(tree)
        assert len(latex(tree)) > 10_000
        assert dimension_of(tree, {"x": parse_unit("1").dimension}) == parse_unit("1").dimension
        assert evaluate(tree, {"x": 1.5}) == reduce(join, [1.0000001] * 10_000, 1.5)
        assert expand(parse("d - 1"), {"d": tree}) == Binary("-", tree, Number(1.0))
    assert derivative(parse("x" + " + 1.5" * 10_000), {"x": ONE}) == ONE


@pytest.mark.dear
def test_a_long_tree_is_copied_and_pickled() -> None:
    """Assert that copies are equal, columns included, and are not nested deeper than they say."""
    tree = parse("sin(a" + " + b*c" * 10_000 + ")")
    for again in (pickle.loads(pickle.dumps(tree)), copy.deepcopy(tree)):
        assert again == tree
        assert again.arguments[0].right.column == tree.arguments[0].right.column
    assert len(repr(tree)) < 200_000


def test_a_long_sum_inside_functions_has_its_number() -> None:
    """Assert that a chain is evaluated in parts wherever it stands, in the branch of a choice too."""
    total = "(x" + " + x" * 2000 + ")"
    assert evaluate(parse(f"where({total} > 2000, -sqrt({total} - 1), 1)"), {"x": 1.0}) == -(2000.0**0.5)


@pytest.mark.dear
def test_a_gradient_differentiates_each_term_by_what_it_mentions() -> None:
    """Assert that a potential of 5,000 bonds has the derivatives of its neighbours, and in no time that grows as N^2."""
    n = 5_000
    tree = parse(" + ".join(f"k*(q{i + 1} - q{i})**2/2" for i in range(n)))
    found = derivatives(tree, {f"q{i}": {f"q{i}": ONE} for i in range(n + 1)})
    assert list(found) == [f"q{i}" for pair in range(1) for i in (1, 0)] + [f"q{i}" for i in range(2, n + 1)]
    assert text_of(found["q7"]) == "k*(2*(q7 - q6))/2 - k*(2*(q8 - q7))/2"
    assert found["q7"] == derivative(parse("k*(q7 - q6)**2/2 + k*(q8 - q7)**2/2"), {"q7": ONE})


@pytest.mark.parametrize(
    ("opening", "closing"), [("(", ")"), ("sin(", ")"), ("-", ""), ("x - (", ")"), ("max(1, ", ")")]
)
def test_nesting_ends_with_its_depth_and_a_remedy(opening: str, closing: str) -> None:
    """Assert that what is nested, not long, is refused, and that one level less is read."""
    parse(opening * DEEPEST + "x" + closing * DEEPEST)
    with pytest.raises(InputError, match=f"over {DEEPEST} levels .* name the inner ones in definitions"):
        parse(opening * (DEEPEST + 1) + "x" + closing * (DEEPEST + 1))


def nested(levels: int) -> xd.Model:
    """A particle whose force is a sine of a sine of a sine, by definitions of three levels each."""
    definitions = {f"d{i}": f"1 + sin(d{i + 1})/2" for i in range(levels // 3)} | {f"d{levels // 3}": "x/d"}
    parameters = {"m": "2 kg", "F": "5 N", "d": "1 m"}
    return particle(parameters=parameters, definitions=definitions, forces={"push": {"x": "-F*d0"}})


@pytest.mark.parametrize("method", ["velocity_verlet", "implicit_midpoint"])
def test_a_force_may_be_nested_through_definitions_to_the_limit(method: str) -> None:
    """Assert that definitions close to the limit are differentiated and marched, and printed as Python that runs."""
    model = nested(MOST_LEVELS - 5)
    run = xd.simulate(model, method=method, step="1 ms", until="3 ms")
    law = law_of(layout_of(model, Scheme(xd.METHODS[method], "none")), sampled=True)
    assert run.attrs["run_outcome"] == "completed"
    assert len(law.plain) == len(law.addresses)
    with pytest.raises(xd.ModelError, match="nested too deeply; shorten the chain"):
        nested(MOST_LEVELS + 5)


@pytest.mark.parametrize(
    "text", ["2**3**2", "-x**2", "2*-x", "x**-1.5", "a - b - c", "a/b*c", "- -x", "+x - +y", "x**2*y**(1/2)"]
)
def test_precedence_is_that_of_python(text: str) -> None:
    """Assert that a text means what Python computes."""
    values = {"x": 1.7, "y": 2.3, "a": 3.1, "b": 0.7, "c": 1.9}
    if text == "2**3**2":
        with pytest.raises(InputError, match="exponent must be a constant"):
            parse(text)
        return
    assert evaluate(parse(text), values) == pytest.approx(eval(text, {}, values), rel=1e-15)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x y", r"at column 3: 'y' has no operator before it"),
        ("x + ", r"at column 4: the expression ends too early"),
        ("(x", r"at column 3: '\)' is missing"),
        ("x + * y", r"at column 5: '\*' is out of place"),
        ("2x", "at column 1: no word, number or sign"),
        ("1 < x < 2", "a comparison has two sides"),
        ("sin(x > 1)", "a comparison stands in 'where' alone"),
        ("x if y", "'if' has no operator before it"),
        ("max(1, x", r"'\)' is missing"),
    ],
)
def test_what_cannot_be_read_says_where(text: str, said: str) -> None:
    """Assert the column and the word that stands there."""
    with pytest.raises(InputError, match=said):
        parse(text)


def test_columns_are_those_of_the_text() -> None:
    """Assert that an operand's column is its own and that of a chain where it begins, parentheses included."""
    tree = parse("(a + b)*c - sin( d )")
    assert isinstance(tree, Binary)
    assert (tree.column, tree.left.column, tree.left.left.column, tree.right.column) == (1, 1, 2, 13)
    assert tree.right.arguments == (Name("d"),)
    assert tree.right.arguments[0].column == 18

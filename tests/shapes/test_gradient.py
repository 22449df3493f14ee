"""Derivatives of expressions with dimensions are those of the same expressions written out, element by element.

Rounding of expressions with dimensions: they less the same with 31 digits, against numbers of 40 digits.
"""

from __future__ import annotations

import numpy as np
import pytest
import sympy
from mpmath import mp, mpf

import xdynamics as xd
from xdynamics.expressions import Along, Name, Node, derivatives, parse, text_of
from xdynamics.expressions.calculus import ONE, ZERO, derivative, negative
from xdynamics.expressions.evaluation import evaluate
from xdynamics.faults import InputError, ModelError
from xdynamics.model import Model
from xdynamics.shapes import Extent, Relation, Shapes, at_element, dims_of, resolve_min_max, split_element_name
from xdynamics.shapes.evaluation import evaluate_elements, rounding_errors
from xdynamics.shapes.gradient import derivative as rate_with_dimensions
from xdynamics.shapes.gradient import gradient
from xdynamics.shapes.trees import sum_terms

DIMS = {
    "a": (),
    "u": ("site",),
    "w": ("site",),
    "k": ("bond",),
    "m": ("body",),
    "r": ("body", "axis"),
    "s": ("site", "axis"),
    "e": ("axis",),
    "h": ("wall",),
}
SHAPES = Shapes(
    {
        "body": Extent("body", 4, ("Sun", "Earth", "Moon", "Mars")),
        "axis": Extent("axis", 3, ("x", "y", "z")),
        "site": Extent("site", 5),
        "wall": Extent("wall", 2),
    },
    {
        "pair": Relation("pair", "body", "body", *np.triu_indices(4, 1)),
        "bond": Relation("bond", "site", "site", np.array([3, 0, 4, 3]), np.array([0, 1, 3, 4])),
        "touch": Relation("touch", "body", "wall", np.array([0, 1, 1, 3]), np.array([1, 1, 0, 0])),
    },
    DIMS | {f"v_{name}": dims for name, dims in DIMS.items()},
)
POTENTIALS = [
    "a**2*sum(u, site) + a",
    "a + u",
    "-a*first(m, pair)*second(m, pair)/norm(second(r, pair) - first(r, pair), axis)",
    "m*first(m*r, pair)*second(m, pair)*a",
    "k*(second(u, bond) - first(u, bond) - a)**2/2",
    "k*exp(-(second(u, bond) - first(u, bond)))*second(sin(u), bond)",
    "first(r, touch)*second(h, touch)**3",
    "first(m, pair)*a + first(a*m, touch)*second(h, touch)",
    "(u - roll(u, site, 1))**2/2 + (u - roll(u, site, -7))**4/4",
    "(shift(u, site, 1, a) - u)**2*w",
    "(shift(u, site, -2, w) - u)**2",
    "shift(u, site, 2, s)*s",
    "shift(u, site, 0, a)*w + shift(u, site, 9, a*u) + shift(w, site, -9, u)",
    "sum(shift(u, site, 1, 0) + shift(u, site, -1, 0), site)",
    "sum(roll(u, site, 2), site) + mean(u, site)*u",
    "mean(s*w, site, axis)*a + sum(s*e, axis, site)**2",
    "min(u*w, site)*max(s, site, axis) + min(s, axis)",
    "norm(r, axis)*m + norm(r, body, axis)",
    "dot(r, e, axis)*m + dot(r, a, body)*e",
    "dot(cross(r, e*a, axis), m*e, axis) + cross(e, a, axis)",
    "u[0]**2*u[-1] + r[Earth, y]*m + s[2, z]*s",
    "first(norm(r, axis)**2/m, pair)*norm(second(r, pair), axis)/norm(second(r, pair) - first(r, pair), axis)",
    "where(u > w, u*w, a*w) + where(a > 0, u, a) + where(index(site) >= 2, u, w)",
    "min(u, w, a) + max(u, a*w, w, u*w)",
    "sin(u)*cos(w) + tan(a)/cosh(u) + sinh(u)*tanh(w) + exp(a*u) + log(2 + u**2) + sqrt(3 + w)",
    "asin(u/4) + acos(w/4) + atan(a*u) + atan2(u, w) + hypot(u, a) + abs(u - w) + sign(u)*u",
    "(u + 5)**-1.5*index(site) + size(body)*m**3 - -(-(m**0.5)) + pi*m",
    "m*take(r, axis, 1) + take(take(r, axis, 2)**2, body, size(body) - 1)*u",
    "e*take(u*w, site, mod(2*index(axis), size(site)))",
]


def written_out(tree: Node) -> list[Node]:
    """Return what an expression is at every element."""
    return [at_element(tree, place, SHAPES) for place in SHAPES.index_combinations(dims_of(tree, SHAPES))]


TAKEN = (
    "take(u, site, size(site) - 1 - index(site))*w",
    "sum(take(u**2*a, site, mod(2*index(site), size(site))), site)",
)


def numbers(seed: int) -> dict[str, float]:
    """Return a number for every element of every name."""
    random = np.random.default_rng(seed)
    names = [name for quantity in SHAPES.dims for name in SHAPES.elements(quantity)]
    return {"pi": np.pi} | dict(zip(names, random.uniform(0.3, 1.7, len(names)).tolist(), strict=True))


@pytest.mark.parametrize("text", POTENTIALS)
def test_gradient(text: str) -> None:
    """Assert that a gradient is that of the sum written out, and has no dimension that its quantity lacks."""
    tree, values = resolve_min_max(parse(text), SHAPES), numbers(1)
    found = gradient(tree, DIMS, SHAPES)
    elements = [name for quantity in DIMS for name in SHAPES.elements(quantity)]
    expected = derivatives(sum_terms(written_out(tree)), {name: {name: ONE} for name in elements})
    assert not {name.split("·")[0] for name in expected} - found.keys()
    for name, one in found.items():
        assert set(dims_of(one, SHAPES)) <= set(DIMS[name])
        for place in SHAPES.index_combinations(DIMS[name]):
            value = evaluate(expected.get(SHAPES.element_at(name, place), ZERO), values)
            assert evaluate(at_element(one, place, SHAPES), values) == pytest.approx(value, rel=1e-13, abs=1e-13)


@pytest.mark.parametrize("text", [*POTENTIALS, *TAKEN])
def test_rate(text: str) -> None:
    """Assert that a rate is that of each element written out."""
    tree, values = resolve_min_max(parse(text), SHAPES), numbers(2)
    found = rate_with_dimensions(tree, {name: Name(f"v_{name}") for name in DIMS}, SHAPES)
    assert set(dims_of(found, SHAPES)) <= set(dims_of(tree, SHAPES))
    elements = [name for quantity in DIMS for name in SHAPES.elements(quantity)]
    rates = {name: Name(f"v_{name}") for name in elements}
    for place in SHAPES.index_combinations(dims_of(tree, SHAPES)):
        expected = evaluate(derivative(at_element(tree, place, SHAPES), rates), values)
        assert evaluate(at_element(found, place, SHAPES), values) == pytest.approx(expected, rel=1e-12, abs=1e-13)


@pytest.mark.parametrize("text", [*POTENTIALS, *TAKEN])
def test_rate_of_uniform_quantities(text: str) -> None:
    """Assert that rates may have fewer dimensions than what they are rates of."""
    tree, values = resolve_min_max(parse(text), SHAPES), numbers(3)
    found = rate_with_dimensions(tree, {name: parse("a**2") for name in ("u", "r", "m", "h")}, SHAPES)
    elements = [name for quantity in ("u", "r", "m", "h") for name in SHAPES.elements(quantity)]
    for place in SHAPES.index_combinations(dims_of(tree, SHAPES)):
        expected = evaluate(derivative(at_element(tree, place, SHAPES), dict.fromkeys(elements, parse("a**2"))), values)
        assert evaluate(at_element(found, place, SHAPES), values) == pytest.approx(expected, rel=1e-12, abs=1e-13)


@pytest.mark.every(3)
@pytest.mark.parametrize("text", POTENTIALS)
def test_gradient_of_gradient(text: str) -> None:
    """Assert that what links give to their ends is differentiated as well."""
    tree, values = resolve_min_max(parse(text), SHAPES), numbers(4)
    first = gradient(tree, ("u", "r", "m"), SHAPES)
    for one in first.values():
        found = gradient(one, ("u", "r", "m", "a"), SHAPES)
        elements = [name for quantity in ("u", "r", "m", "a") for name in SHAPES.elements(quantity)]
        expected = derivatives(sum_terms(written_out(one)), {name: {name: ONE} for name in elements})
        for name in elements:
            quantity, _ = split_element_name(name)
            place = next(p for p in SHAPES.index_combinations(DIMS[quantity]) if SHAPES.element_at(quantity, p) == name)
            value = evaluate(expected.get(name, ZERO), values)
            own = evaluate(at_element(found.get(quantity, ZERO), place, SHAPES), values)
            assert own == pytest.approx(value, rel=1e-11, abs=1e-11)


def test_rate_of_a_gradient() -> None:
    """Assert that the rate of what links give to their ends is what the rates give."""
    tree, values = parse("k*(second(u, bond) - first(u, bond))**3"), numbers(5)
    force = gradient(tree, {"u"}, SHAPES)["u"]
    rate = rate_with_dimensions(force, {"u": Name("v_u")}, SHAPES)
    for place in SHAPES.index_combinations(("site",)):
        rates = {name: Name(f"v_{name}") for name in SHAPES.elements("u")}
        expected = evaluate(derivative(at_element(force, place, SHAPES), rates), values)
        assert evaluate(at_element(rate, place, SHAPES), values) == pytest.approx(expected, rel=1e-13)


def test_against_computer_algebra() -> None:
    """Assert that the force of springs between neighbours in a ring is sympy's."""
    u = sympy.symbols("u0:5")
    potential = sum((u[i] - u[i - 1]) ** 4 / 4 + sympy.sin(u[i]) for i in range(5))
    tree = parse("(u - roll(u, site, 1))**4/4 + sin(u)")
    found, values = gradient(tree, {"u"}, SHAPES)["u"], numbers(6)
    given = {symbol: values[f"u·{i}"] for i, symbol in enumerate(u)}
    for i, symbol in enumerate(u):
        own = evaluate(at_element(found, {"site": i}, SHAPES), values)
        assert own == pytest.approx(float(potential.diff(symbol).subs(given)), rel=1e-13)


def test_links_give_once() -> None:
    """Assert that a force over pairs is one sum over links, with opposites at both ends, and divides once."""
    text = "-a*first(m, pair)*second(m, pair)/norm(second(r, pair) - first(r, pair), axis)"
    force = gradient(negative(parse(text)), {"r"}, SHAPES)["r"]
    assert isinstance(force, Along)
    assert (force.function, force.dims, dims_of(force, SHAPES)) == ("onto", ("pair",), ("body", "axis"))
    first, second = map(text_of, force.arguments)
    assert second == f"-({first})" or second == f"-{first}" or first == f"-{second}" or first == f"-({second})"
    assert text_of(at_element(force, {"body": 3, "axis": 0}, SHAPES)).count("/") == 3


def test_length_is_that_of_the_expression() -> None:
    """Assert that a gradient is as long as its expression, however many elements there are."""
    tree = parse("u*roll(u, site, 1)*exp(-u**2)")
    few, many = (Shapes({"site": Extent("site", n)}, {}, {"u": ("site",)}) for n in (3, 1_000_000))
    assert text_of(gradient(tree, {"u"}, many)["u"]) == text_of(gradient(tree, {"u"}, few)["u"])


def test_choices_by_index_are_made() -> None:
    """Assert that what an expression is at an element has no choice left that its number decides."""
    tree = parse("where(index(site) < 2, where(index(axis) == 1, s, a), where(u > 0, u, w))")
    assert text_of(at_element(tree, {"site": 1, "axis": 1}, SHAPES)) == "s·1·y"
    assert text_of(at_element(tree, {"site": 1, "axis": 2}, SHAPES)) == "a"
    assert text_of(at_element(tree, {"site": 2, "axis": 1}, SHAPES)) == "where(u·2 > 0, u·2, w·2)"


@pytest.mark.dear
def test_long_sum() -> None:
    """Assert that a sum of thousands of terms is no nesting."""
    tree = parse(" + ".join(["u*w", *(f"{i}*u*a" for i in range(2, 2000))]))
    assert dims_of(gradient(tree, {"w"}, SHAPES)["w"], SHAPES) == ("site",)
    assert dims_of(gradient(tree, {"u"}, SHAPES)["u"], SHAPES) == ("site",)


def test_nothing_to_depend_on() -> None:
    """Assert that quantities without influence are left out."""
    assert gradient(parse("u*w + sign(m)*0"), {"u", "m", "r"}, SHAPES).keys() == {"u"}
    assert rate_with_dimensions(parse("sum(u, site) + size(body)"), {"w": Name("v_w")}, SHAPES) == ZERO


def test_what_is_taken_along_itself_has_no_gradient() -> None:
    """Assert that a potential which takes elements of a dimension by its own index is refused, with force and remedy."""
    with pytest.raises(InputError, match=r"is in a potential, .*; use shift or roll, or write the force out"):
        gradient(parse(TAKEN[1]), ("u",), SHAPES)
    chain = """
name = "mirror"
[dimensions]
site = 4
[coordinates]
u = { unit = "m", dims = ["site"] }
[mass]
u = "1*kilogram"
[forces.mirrored]
potential = "1*newton/metre*u*take(u, site, size(site) - 1 - index(site))"
[initial]
u = "1 m"
"""
    with pytest.raises(ModelError, match=r"^model 'mirror': force 'mirrored': 'take\(u, site, "):
        Model.from_text(chain)


N = 7
MODEL = f"""
name = "chain"
[dimensions]
site = {N}
axis = 3
[relations.link]
of = "site"
neighbours = 1
[coordinates]
u = {{ unit = "1", dims = ["site"] }}
[mass]
u = "1"
[initial]
u = "0 1"
[definitions]
value = "VALUE"
"""


def wave(i: int) -> mpf:
    """Return the sine of a part of pi."""
    return mp.sin(mp.pi * (i + 1) / (N + 1))


def crossed(a: list[mpf], b: list[mpf], c: list[mpf]) -> mpf:
    """Return the determinant of three vectors, the third times the cross product of the others."""
    return mp.det(mp.matrix([a, b, c]))


SINES = "sin(pi*(index(site) + 1)/(size(site) + 1))"
CASES = {
    SINES: wave,
    f"{SINES}**3 - 1/3": lambda i: wave(i) ** 3 - mpf(1) / 3,
    f"-sqrt({SINES}) + abs(1/(index(site) - 9))": lambda i: -mp.sqrt(wave(i)) + abs(mpf(1) / (i - 9)),
    f"shift({SINES}, site, 1, 1/3) - {SINES}": lambda i: (wave(i - 1) if i else mpf(1) / 3) - wave(i),
    f"roll({SINES}, site, -1)*exp(1/7)": lambda i: wave((i + 1) % N) * mp.exp(mpf(1) / 7),
    f"{SINES}*sum({SINES}, site)": lambda i: wave(i) * sum(map(wave, range(N))),
    f"{SINES} + mean({SINES}, site)": lambda i: wave(i) + sum(map(wave, range(N))) / N,
    f"{SINES}/norm({SINES}, site)": lambda i: wave(i) / mp.sqrt(sum(wave(k) ** 2 for k in range(N))),
    f"{SINES}*dot({SINES}, index(site)/3, site)": lambda i: wave(i) * sum(wave(k) * k for k in range(N)) / 3,
    f"{SINES} - max({SINES} - 1/3, site)": lambda i: wave(i) - (wave(3) - mpf(1) / 3),
    f"where({SINES} < 0.5, min({SINES}, 0.1), {SINES}/3)": lambda i: (
        min(wave(i), mpf(0.1)) if i in (0, 6) else wave(i) / 3
    ),
    f"norm(second({SINES}, link) - first({SINES}, link), link)*{SINES}": (
        lambda i: wave(i) * mp.sqrt(sum((wave(k + 1) - wave(k)) ** 2 for k in range(N - 1)))
    ),
    f"dot(cross({SINES}*(index(axis) + 1/3)**2, cos({SINES} + index(axis)), axis), 1/(index(axis) + 3), axis)": (
        lambda i: crossed(
            [wave(i) * (k + mpf(1) / 3) ** 2 for k in range(3)],
            [mp.cos(wave(i) + k) for k in range(3)],
            [mpf(1) / (k + 3) for k in range(3)],
        )
    ),
}


@pytest.mark.parametrize("text", CASES)
def test_rounding_is_known_to_its_own_digits(text: str) -> None:
    """Assert that what rounding did is known to 12 digits of a spacing."""
    model = xd.Model.from_text(MODEL.replace("VALUE", text))
    tree, shapes = model.statement.definitions["value"], model.shapes
    found = evaluate_elements(tree, ("site",), {"pi": np.pi}, shapes)
    errors = rounding_errors(tree, ("site",), {"pi": np.pi}, shapes, found)
    with mp.workdps(40):
        true = [float(mpf(float(value)) - CASES[text](i)) for i, value in enumerate(found)]
    assert np.abs(errors).max() > 0.0
    np.testing.assert_allclose(errors, true, rtol=0.0, atol=1e-28)

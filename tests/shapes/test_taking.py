"""Elements taken by number: what is refused, and what a Jacobian has of them."""

from __future__ import annotations

import pytest

import xdynamics as xd
from xdynamics.expressions import parse, text_of
from xdynamics.expressions.dimensions import dimension_of
from xdynamics.faults import InputError
from xdynamics.shapes import Extent, Shapes, at_element, dims_of
from xdynamics.shapes.dependence import Dependence
from xdynamics.shapes.evaluation import evaluate_elements
from xdynamics.units import parse_unit

SHAPES = Shapes({"site": Extent("site", 4), "row": Extent("row", 2)}, {}, {"u": ("site",), "w": ("row", "site")})


def test_a_jacobian_has_what_is_taken() -> None:
    """Assert that every element depends on the one that it takes, and on no other."""
    tree = parse("take(u, site, mod(index(site) + 1, size(site)))")
    rows, columns = Dependence(SHAPES, {"u": 0}, 4).pairs(tree, ("site",))
    assert (rows.tolist(), columns.tolist()) == ([0, 1, 2, 3], [1, 2, 3, 0])


def test_dimensions_and_units() -> None:
    """Assert that the dimension of the number comes for the one taken along, the unit is the value's, and text is read."""
    tree = parse("take(w, site, 2*index(row) + 1)")
    assert dims_of(tree, SHAPES) == ("row",)
    assert dimension_of(tree, {"w": parse_unit("m").dimension}) == parse_unit("m").dimension
    assert parse(text_of(tree)) == tree


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("take(u, site, u)", r"the number of the element is 'u', which may be written with index\(dimension\), size"),
        ("take(u, row, 0)", r"goes along 'row', and 'u' has the dimensions: site"),
        ("take(u, place, 0)", r"'place' is no dimension"),
        ("take(u, site, index(site) - 1)", r"takes element -1 of 'site', needs whole numbers from 0 to 3; mod\("),
        ("take(u, site, 4)", r"takes element 4 of 'site'"),
        ("take(u, site, index(site)/2)", r"takes element 0.5 of 'site'"),
        ("take(u, site)", r"'take' is written take\(a, dimension, number\); number of arguments here: 2"),
    ],
)
def test_what_cannot_be_taken(text: str, fault: str) -> None:
    """Assert that a number of no element is refused, naming it and the remedy."""
    with pytest.raises(InputError, match=fault):
        _taken(text)


def _taken(text: str) -> None:
    tree = parse(text)
    for place in SHAPES.index_combinations(dims_of(tree, SHAPES)):
        at_element(tree, place, SHAPES)


def test_arrays_are_refused_alike() -> None:
    """Assert that values of all elements at once are refused where one is."""
    with pytest.raises(InputError, match=r"takes element 4 of 'site'"):
        evaluate_elements(parse("take(u, site, index(site) + 2)"), ("site",), {"u": [0.0] * 4}, SHAPES)


@pytest.mark.parametrize("place", ["forces", "observables"])
def test_halves_are_refused_by_name(place: str) -> None:
    """Assert that a model whose element is taken by a number that is none is refused, and which expression takes it."""
    taken = "take(w, site, index(site)/2)"
    given = {"forces": {"f": {"u": taken}}} if place == "forces" else {"observables": {"o": taken}}
    of = "force 'f' of 'u'" if place == "forces" else "observable 'o'"
    said = rf"^model 'halves': {of}: .* takes element 0.5 of 'site', needs whole numbers from 0 to 2; mod\("
    with pytest.raises(xd.ModelError, match=said):
        xd.Model(
            name="halves",
            dimensions={"site": 3},
            coordinates={"u": {"unit": "m", "dims": ["site"]}},
            parameters={"w": {"dims": ["site"], "value": "1 + index(site)", "unit": "N"}},
            mass={"u": "1*kilogram"},
            initial={"u": "0 m"},
            **given,
        )


def test_numbers_alone_go_in_loops() -> None:
    """Assert that what reads no quantity with dimensions is no sum of a million terms written one after the other."""
    n = 1000
    model = xd.Model(
        name="series",
        dimensions={"row": n, "column": n},
        coordinates={"x": "m"},
        mass={"x": "1*kilogram"},
        initial={"x": "2 m"},
        observables={"o": "x*sum(index(row)*index(column), row, column)"},
    )
    run = xd.simulate(model, method="rk4", step="1 s", until="1 s")
    assert run.o.values.tolist() == [2.0 * (n * (n - 1) / 2) ** 2] * 2

"""The page of help on quantities with dimensions."""

from __future__ import annotations

from collections.abc import Iterator

from xdynamics.documenting.folding import folded
from xdynamics.expressions.parser import FORMS

MEANINGS = {
    "sum": "over one dimension, or several: sum(a, body, axis); ascending, one addition after the other",
    "mean": "sum over number of elements",
    "min": "the least, where the last argument is a dimension: min(a, body); min(a, b) compares as ever",
    "max": "the greatest, likewise",
    "norm": "sqrt of the sum of squares",
    "dot": "sum of products",
    "cross": "where the dimension has three elements; it keeps it",
    "first": "a value of the first element of each link",
    "second": "a value of the second element of each link",
    "shift": "the value n places before, as xarray's; beyond the end it is fill, in the unit of a: 0*metre",
    "roll": "the value n places before, in a ring",
    "take": "the element of that number, made of index, size and numbers",
    "index": "number of an element, from 0",
    "size": "how many elements there are",
}
MODEL = """\
[dimensions]
body = ["Sun", "Jupiter", "Saturn"]        # labels, or a number of elements: site = 100
axis = ["x", "y", "z"]
[relations.pair]
of = "body"                                # every two; or neighbours = 1: each with the next
[coordinates]
r = { unit = "m", dims = ["body", "axis"] }
[parameters]
m = { dims = ["body"], values = { Sun = "2e30 kg", Jupiter = "1.9e27 kg", Saturn = "5.7e26 kg" } }
G = "6.6743e-11 N m2 kg-2"
[mass]
r = "m"                                    # over body, the same for every axis
[forces.gravity]
over = "pair"                              # or r = "…": the force on the first of each
potential = "-G*first(m, pair)*second(m, pair)/norm(second(r, pair) - first(r, pair), axis)"
[initial]
r = { table = "planets.csv", columns = ["x", "y", "z"] }   # rows by a column `body`, or in order
""".splitlines()


CLOSING = (
    "What is assigned may have no dimension more than its place: what is missing is the same for every element.",
    "In [mass], matrix = [[…], …] has an entry for every two quantities: it is of the elements that agree in what both have.",
    "A potential is summed over its dimensions. Events, contacts and frictions with dimensions are one for each element.",
    "Values: a list (of lists), values = { label = … }, a table, or an expression of index(…) and, at the start, parameters.",
    "An element is named the same way elsewhere: --quantity 'u[3]', --axis 'm[Sun]=1:2:5 kg', parameters={'m[Sun]': …}.",
)


def shapes_page() -> Iterator[str]:
    """Explain dimensions, relations, and what expressions do along them."""
    yield from folded(
        "A quantity may have named dimensions, and expressions are joined by their names, as arrays of xarray are."
    )
    yield from (f"  {line}" for line in MODEL)
    yield "In expressions stand, besides what `xdynamics help language` has,"
    width = max(map(len, FORMS.values()))
    for name, form in FORMS.items():
        yield from folded(f"  {form:{width}}  {MEANINGS[name]}", width + 4)
    yield f"  {'r[Jupiter, x], u[-1]':{width}}  one element, by labels or numbers, in the order of the dimensions"
    for line in CLOSING:
        yield from folded(line)

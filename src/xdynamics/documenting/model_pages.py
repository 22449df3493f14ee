"""Help pages on parts of a model: bodies, constraints, delays, joints, quantities with dimensions.

The pages on bodies, constraints and joints stand before the keys of their section. The page on delayed values stands
before the section that states the values before the start. Lines are no wider than a window usually is.
"""

from __future__ import annotations

from collections.abc import Iterator
from textwrap import wrap

from xdynamics.documenting.pages import page_text
from xdynamics.expressions.parser import FORMS

WIDTH = 100  # of a line


def wrapped_lines(text: str, hang: int = 0) -> list[str]:
    """Return lines of at most `WIDTH` characters, those after the first indented by `hang`; no word is broken.

    Examples
    --------
    >>> wrapped_lines("  name  " + "many " * 20, 8)
    ['  name  many many many many many many many many many many many many many many many many many many', '        many many']
    """
    return wrap(text, WIDTH, subsequent_indent=" " * hang, break_long_words=False, break_on_hyphens=False)


def page_before(text: str, section: Iterator[str]) -> Iterator[str]:
    """Yield the text of a page by the name of its file, and then the keys of a section."""
    yield from page_text(text).splitlines()
    yield from section


MEANINGS = {
    "sum": "the sum over one dimension, or several: sum(a, body, axis), added in ascending order",
    "mean": "the sum over the number of elements",
    "min": "the least element, if the last argument is a dimension; min(a, b) compares two values",
    "max": "the greatest element, likewise",
    "norm": "the square root of the sum of squares",
    "dot": "the sum of products",
    "cross": "the vector product along a dimension of three elements, which the result keeps",
    "first": "the value of a at the first end of each link",
    "second": "the value of a at the second end of each link",
    "shift": "the value n places earlier, as in xarray; beyond the end fill, in the unit of a, like 0*metre",
    "roll": "the value n places earlier, the dimension closed into a ring",
    "take": "the element with that number, an expression of index, size and whole numbers",
    "index": "the number of each element, from 0",
    "size": "how many elements there are",
}
MODEL = """\
name = "Sun and two planets"
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
[initial]                                  # a row for each body, a column for each axis
r = { unit = "astronomical_unit", value = [[0, 0, 0], [5.2, 0, 0], [0, 9.58, 0]] }
v_r = { unit = "m s-1", value = [[0, 0, 0], [0, 13060, 0], [-9680, 0, 0]] }
[run]
method = "yoshida6"
step = "30 day"
until = "30 year"
""".splitlines()


CLOSING = (
    "An expression may have only the dimensions of what it is written for; along those it lacks it is the same for all elements.",
    "In [mass], matrix = [[…], …] has an entry for every two coordinates; it couples elements whose shared dimensions agree.",
    "A potential is summed over its dimensions. An event, contact or friction with dimensions stands for one per element.",
    (
        'So discs in a box have [contacts.floor] gap = "take(r, axis, 1) - R", one for each, and [contacts.discs] gap ='
        ' "norm(second(r, pair) - first(r, pair), axis) - 2*R", one for each pair. With friction, slip is the velocity of'
        " the second minus that of the first across the line between them, counterclockwise, minus R*(first(v_theta, pair) +"
        " second(v_theta, pair))/radian. Pictures and films draw bodies where one coordinate has them along a dimension and"
        " their two or three axes along another."
    ),
    (
        "Each located event adds two rows to the record, with the states of all elements: n elements with an event each make 2*n*n"
        " numbers of each quantity; a run that needs more memory than there is ends with an error. So log what is needed"
        " (log = ['u[0]'], in Python too), stream it to a file (-o, path=…), or take one event for all, whose function is"
        " max(…, dimension), min or sum: it is located where the first of them crosses."
    ),
    (
        "Besides its record and 20 MB, a march of many masses in one dimension takes some 80 bytes for each by velocity_verlet,"
        " 110 by rk4, 165 by dormand_prince, 225 by dop853; of which velocities and accelerations of stages still to"
        " be read take 48, 72 and 128. A state by radau_iia takes 336: factors of a real and a complex band of three 104, derivatives and their places 60,"
        " stages 72 and a state for them 16, states at both ends 32, errors, tolerances and sizes 28, a row of the log 24. In a"
        " band of n below the diagonal and m above it the factors take 24*(2*n + m + 1) + 8: for a field in two dimensions"
        " they are by far the largest part, and a march without room for them is refused before it begins."
    ),
    (
        "Values are a list (of lists), values = { label = … } (of two dimensions { label = { label = … } }), an expression of"
        " index(…), beside a unit where it is a pure number, at the start an expression of parameters too, or a table:"
        ' r = { table = "planets.csv", columns = ["x", "y", "z"] }, whose rows are matched by a column `body` of labels, one for'
        " each, or taken in order."
    ),
    (
        "The table of a relation has the columns first and second; each other column that forces use is declared as a parameter along"
        ' the relation: k = { dims = ["spring"], table = "springs.csv", column = "k" }.'
    ),
    (
        "In Python they may also be NumPy arrays, DataFrames in place of tables, and DataArrays, which have their unit in the"
        " attribute units and may stand in any order of dimensions and labels: model.replace(initial={'r': run.r.isel(step=-1)})."
    ),
    (
        "refine reports the states after each event: after_ground_r are those of the element that the event is of, and"
        " all_after_ground_r(level, occurrence, event_body, body, axis) those of all elements at the event of each, up to a"
        " million numbers; beyond, the attribute left_out says what to ask for."
    ),
    "Elsewhere an element is named by its labels or by its numbers from 0, of which -1 is the last: --quantity 'u[-1]', --axis 'm[Sun]=1:2:5 kg', model.replace(parameters={'m[Sun]': …}); a reset sets one by set = { 'v_u[3]' = \"…\" }, and in an event with dimensions each its own of what is set whole.",
)


def shapes_page() -> Iterator[str]:
    """Explain dimensions, relations, and expressions along them."""
    yield from wrapped_lines(
        "A quantity may have named dimensions. Expressions broadcast by these names, as xarray does. A whole model:"
    )
    yield from (f"  {line}" for line in MODEL)
    yield "Besides what `xdynamics help language` lists, expressions may use:"
    width = max(map(len, FORMS.values()))
    for name, form in FORMS.items():
        yield from wrapped_lines(f"  {form:{width}}  {MEANINGS[name]}", width + 4)
    yield f"  {'r[Jupiter, x], u[-1]':{width}}  one element, by labels or numbers, in the order of the dimensions"
    for line in CLOSING:
        yield from wrapped_lines(line)

"""Models with named dimensions: what they are as single elements, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import xdynamics as xd
from xdynamics.expressions import parse, text_of
from xdynamics.expressions.evaluation import evaluate
from xdynamics.model import Function, given_values
from xdynamics.model.csv_sheet import Sheet
from xdynamics.model.links import Links
from xdynamics.model.motion import constant_names, constant_values, constants
from xdynamics.shapes import Extent, Relation, Shapes, at_element
from xdynamics.shapes.extents import every_two
from xdynamics.units import UNSCALED, Scales, parse_quantity, unit

PLANETS = """
name = "three bodies"
[dimensions]
body = ["Sun", "Jupiter", "Saturn"]
axis = ["x", "y"]
[relations.pair]
of = "body"
[coordinates]
r = { unit = "m", dims = ["body", "axis"] }
[parameters]
G = "1 N m2 kg-2"
m = { dims = ["body"], values = { Sun = "10 kg", Jupiter = "1 kg", Saturn = "500 g" } }
[mass]
r = "m"
[definitions]
distance = "norm(second(r, pair) - first(r, pair), axis)"
[forces.gravity]
over = "pair"
potential = "-G*first(m, pair)*second(m, pair)/distance"
[initial]
r = { value = [[0, 0], [1, 0], [0, 3]], unit = "m" }
v_r = { value = [[0, 0], [0, 3], [-1.5, 0]], unit = "m s-1" }
[events.far]
function = "norm(r, axis) - 2*metre"
[observables]
momentum = "sum(m*v_r, body)"
"""
CHAIN = """
name = "chain"
[dimensions]
site = 6
[relations.spring]
of = "site"
neighbours = 1
[coordinates]
u = { unit = "m", dims = ["site"] }
[parameters]
k = "4 N m-1"
A = "0.1 m"
m = { dims = ["site"], value = [1, 1, 2, 1, 1, 1], unit = "kg" }
[mass]
u = "m"
[forces.springs]
over = "spring"
u = "k*(second(u, spring) - first(u, spring))"
[initial]
u = "A*sin(pi*(index(site) + 1)/(size(site) + 1))"
"""


def changed(text: str, old: str, new: str) -> str:
    """Return a model with other words, which must be there."""
    assert old in text
    return text.replace(old, new)


def test_a_model_is_written_as_it_was_stated() -> None:
    """Assert that the text of a model keeps its dimensions, and reads back as the same model with the same elements."""
    for text in (PLANETS, CHAIN):
        model = xd.Model.from_text(text)
        again = xd.Model.from_text(model.to_toml())
        assert again == model
        assert again.elements.statement == model.elements.statement
    assert '"dims" = ["site"]' in model.to_toml()
    assert "u·" not in model.to_toml()


def test_elements_have_values_by_label_and_in_one_unit() -> None:
    """Assert that each element has its own number, converted to the unit of the first."""
    model = xd.Model.from_text(PLANETS)
    assert [model.parameters[f"m·{label}"].quantity.value for label in ("Sun", "Jupiter", "Saturn")] == [10.0, 1.0, 0.5]
    assert model.initial["r·Saturn·y"].value == 3.0
    assert text_of(model.elements.definitions["distance·2"]) == (
        "sqrt((r·Saturn·x - r·Jupiter·x)**2 + (r·Saturn·y - r·Jupiter·y)**2)"
    )


def test_numbers_of_a_list_are_taken_as_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that floats of a list keep their last digit, and none of them is read as a quantity or as a fraction."""
    listed = [0.1, 1e-300, 2.5e300, 1 / 3, 7.0, 1.1]
    read: list[object] = []
    monkeypatch.setattr(given_values, "parse_quantity", lambda entry: read.append(entry) or parse_quantity(entry))
    model = xd.Model.from_text(changed(CHAIN, "[1, 1, 2, 1, 1, 1]", str(listed)))
    assert [model.parameters[f"m·{i}"].quantity.value for i in range(6)] == listed
    assert not any(isinstance(entry, float) for entry in read)
    monkeypatch.setattr("xdynamics.units.unit.Fraction", None)
    assert [unit.read_decimal(repr(number)) for number in listed] == listed


def test_a_cross_product_is_right_handed() -> None:
    """Assert that x times y is z, cyclically."""
    axis = Extent("axis", 3, ("x", "y", "z"))
    shapes = Shapes({"axis": axis}, {}, {"a": ("axis",), "b": ("axis",)})
    texts = [text_of(at_element(parse("cross(a, b, axis)"), {"axis": i}, shapes)) for i in range(3)]
    assert texts == ["a·y*b·z - a·z*b·y", "a·z*b·x - a·x*b·z", "a·x*b·y - a·y*b·x"]


def test_the_force_of_a_link_has_its_opposite() -> None:
    """Assert that components over a relation act on both ends, added in the order of links, like those of a potential."""
    model = xd.Model.from_text(CHAIN)
    component = model.elements.force_components["springs"]["u·1"]
    assert not isinstance(component, Function)
    assert text_of(component) == "-(k*(u·1 - u·0)) + k*(u·2 - u·1)"
    potential = changed(
        CHAIN,
        'u = "k*(second(u, spring) - first(u, spring))"\n[i',
        'potential = "k*(second(u, spring) - first(u, spring))**2/2"\n[i',
    )
    other = xd.Model.from_text(potential)
    start = {name: quantity.si for name, quantity in model.elements.statement.initial.items()} | {"k": 4.0}
    for name, tree in other.elements.force_components["springs"].items():
        written = model.elements.force_components["springs"][name]
        assert not isinstance(tree, Function)
        assert not isinstance(written, Function)
        pair = evaluate(tree, start), evaluate(written, start)
        assert pair[0] == pytest.approx(pair[1], rel=1e-14, abs=1e-16)


def test_keys_of_elements_are_quoted() -> None:
    """Assert that what is said of single elements, in sections with a key for each, reads back from a model's text."""
    uncertain = changed(PLANETS, 'Saturn = "500 g" }', 'Saturn = "500 g" }, uncertainty = "0.1 kg"')
    sections = '[correlations]\n"m[Sun]" = { "m[Jupiter]" = 0.5 }\n[discrepancy."r[Sun, x]"]\nstandard = "1 mm"\n'
    model = xd.Model.from_text(uncertain + sections)
    again = xd.Model.from_text(model.to_toml())
    assert again == model
    assert again.elements.statement.correlations == {("m·Sun", "m·Jupiter"): 0.5}
    assert again.elements.statement.discrepancy["r·Sun·x"].standard.si == 1e-3


def test_an_element_that_no_longer_rests_is_in_the_text() -> None:
    """Assert that a velocity of one element, of which none was written, is marched and archived, and is not that of before."""
    still = xd.Model.from_text(CHAIN)
    moved = still.replace(initial={"v_u[1]": "1 ± 0.1 m s-1"})
    assert moved.digest != still.digest
    again = xd.Model.from_text(moved.to_toml())
    assert moved.statement.at_rest == again.statement.at_rest == ()
    assert still.statement.at_rest == ("v_u",)
    for model in (moved, again):
        assert [*model.uncertain] == ["v_u·1"]
        assert [model.initial[f"v_u[{i}]"].value for i in range(3)] == [0.0, 1.0, 0.0]
    runs = [xd.simulate(model, method="rk4", step="10 ms", until="20 ms") for model in (still, moved, again)]
    assert [run.v_u.values[0, 1] for run in runs] == [0.0, 1.0, 1.0]
    assert again == moved


def test_events_of_elements_are_replaced_by_quantity() -> None:
    """Assert that an event along a dimension is replaced and dropped whole, and that one of its elements is no entry."""
    model = xd.Model.from_text(PLANETS)
    nearer = model.replace(events={"far": {"function": "norm(r, axis) - metre"}})
    assert [*nearer.elements.events] == ["far·Sun", "far·Jupiter", "far·Saturn"]
    assert not model.replace(events={"far": None}).events
    with pytest.raises(xd.ModelError, match=r"event 'far\[Sun\]': a name is a letter"):
        model.replace(events={"far[Sun]": {"function": "metre"}})


def test_values_at_the_start_follow_the_parameters_they_read() -> None:
    """Assert that another amplitude starts another motion, and that an element that was set itself stays."""
    model = xd.Model.from_text(CHAIN)
    twice = model.replace(parameters={"A": "0.2 m"})
    assert twice.initial["u·2"].value == pytest.approx(2 * model.initial["u·2"].value, rel=1e-15)
    assert xd.Model.from_text(twice.to_toml()) == twice
    moved = model.replace(initial={"u[2]": "0.5 m"})
    assert moved.initial["u·2"].value == 0.5
    louder = {"A": twice.parameters["A"]}
    for other in (
        moved.replace(parameters={"A": "0.2 m"}),
        moved.with_statement(moved.renumbered(louder, {})),
        moved.with_statement(replace(moved.statement, parameters=moved.statement.parameters | louder)),
    ):
        assert other.initial == moved.initial  # what was written down as numbers follows nothing any more
        assert xd.Model.from_text(other.to_toml()).initial == other.initial
    assert xd.Model.from_text(moved.to_toml()).initial == moved.initial


def test_elements_and_wholes_are_replaced() -> None:
    """Assert that one element, a list, and an expression take the place of a parameter's values."""
    model = xd.Model.from_text(CHAIN)
    for new, numbers in (
        ({"m[3]": "3 kg"}, [1, 1, 2, 3, 1, 1]),
        ({"m": [1, 2, 3, 4, 5, 6]}, [1, 2, 3, 4, 5, 6]),
        ({"m": {"dims": ["site"], "value": "2*kilogram*(index(site) + 1)"}}, [2, 4, 6, 8, 10, 12]),
    ):
        other = model.replace(parameters=new)
        assert [other.parameters[f"m·{i}"].quantity.value for i in range(6)] == numbers
        assert xd.Model.from_text(other.to_toml()) == other


def test_a_table_of_links_is_read_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a model reads the text of its links once, and labels in another order give other links."""
    read: list[str] = []
    of = Sheet.from_text
    monkeypatch.setattr(Sheet, "from_text", lambda name, text: read.append(name) or of(name, text))
    text = CHAIN.replace("neighbours = 1", 'csv = "first,second\\n0,5\\n3,1\\n"')
    assert text != CHAIN
    relation = next(iter(xd.Model.from_text(text).shapes.relations.values()))
    assert (relation.first.tolist(), relation.second.tolist()) == ([0, 3], [5, 1])
    assert len(read) == 1
    links = Links(of="body", csv="first,second\nSun,Moon\n")
    ends = [
        links.relation("pair", {"body": Extent("body", 3, labels)})
        for labels in (("Sun", "Moon", "Mars"), ("Moon", "Mars", "Sun"))
    ]
    assert [(int(one.first[0]), int(one.second[0])) for one in ends] == [(0, 1), (2, 0)]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('["Sun", "Jupiter", "Saturn"]', '["Sun", "Sun", "Saturn"]', "dimension 'body': has the label 'Sun' twice"),
        ('["x", "y"]', '["1", "2"]', "has the label '1'; a label is made of .* and is no number"),
        ("[relations.pair]", "[relations.class]", "relation 'class': 'class' is a word of Python; choose another name"),
        ('["x", "y"]', "0", "dimension 'axis': has 0 elements, needs 1 to 1000000"),
        ('["x", "y"]', "2000000000", "dimension 'axis': has 2000000000 elements"),
        (
            '"body", "axis"]',
            '"body", "axes"]',
            "coordinate 'r': 'axes' is no dimension or relation; there are pair, body, axis",
        ),
        ('"body", "axis"]', '"body", "body"]', "coordinate 'r': dims has one of body, body twice"),
        ('of = "body"', 'of = "bodies"', "relation 'pair': 'bodies' is no dimension; there are: body, axis"),
        ('of = "body"', 'of = "body"\nneighbours = 2\nring = true', "neighbours is 2 in a ring of 3 elements"),
        (
            '["x", "y"]\n[relations.pair]',
            '4\n[relations.loop]\nof = "axis"\nneighbours = 2\nring = true\n[relations.pair]',
            "neighbours is 2 in a ring of 4 elements",
        ),
        ('of = "body"', 'of = "body"\ncsv = "first,second\\nSun,Sun\\n"', "line 2: links 'Sun' with itself"),
        (
            'of = "body"',
            'of = "body"\ncsv = "first,second\\nSun,Jupiter\\nJupiter,Sun\\n"',
            "line 3: the link of line 2 is there again",
        ),
        (
            'of = "body"',
            'of = "body"\ncsv = "first,second\\nSun,Mars\\n"',
            "line 2: dimension 'body' has no element Mars",
        ),
        ('of = "body"', 'of = "body"\ncsv = "first,second\\nSun\\n"', "line 2: it has 1 cells, the header 2"),
        (
            'of = "body"',
            'of = "body"\ncsv = "first,second\\n"',
            "has no link, .*: table 'pair.csv' has a header and no rows",
        ),
        ('["Sun", "Jupiter", "Saturn"]', '["Sun"]', "relation 'pair': has no link, .*: 'body' has one element"),
        ('"500 g"', '"500 s"', "parameter 'm': has '500 s' beside values in 'kg'"),
        (
            'values = { Sun = "10 kg", Jupiter = "1 kg", Saturn = "500 g" }',
            'csv = "body,m [kg]\\nSun,1\\nSun,2\\nSaturn,1\\n"',
            "line 3: 'Sun' is there twice",
        ),
        (', Saturn = "500 g"', "", "parameter 'm': values lacks Saturn"),
        ("Saturn =", "Mars =", "parameter 'm': values has 'Mars', no element of 'body'"),
        (
            "[[0, 0], [1, 0], [0, 3]]",
            "[[0, 0], [1, 0]]",
            "initial value 'r': value has 2 along 'body', needs 3 elements",
        ),
        (
            "[[0, 0], [1, 0], [0, 3]]",
            "[[0, 1, 0], [0, 0, 3]]",
            "initial value 'r': value has 2 along 'body', needs 3 elements; lists are nested in the order of dims: turn them",
        ),
        ("[[0, 0], [1, 0], [0, 3]]", "[[0, 0], [1, 0], [0, nan]]", "nan is not finite"),
        ("sum(m*v_r, body)", "r[Satrun, x]", "has no element Satrun; .* did you mean Saturn?"),
        ("sum(m*v_r, body)", "r[3, x]", "dimension 'body' has no element 3"),
        ("sum(m*v_r, body)", "r[Sun]", "'r' has the dimensions body, axis; write an entry for each$"),
        (
            "sum(m*v_r, body)",
            "r[y]",
            r"write an entry for each, or for all along body dot\(r, e, axis\), where \[parameters\] e = .*value = \[0, 1\] }$",
        ),
        (
            "sum(m*v_r, body)",
            "r[x, Sun]",
            "x is an element of 'axis', but stands where one is expected of 'body'; in brackets the dimensions are body, axis",
        ),
        ("sum(m*v_r, body)", "sum(G, body)", "goes along 'body', and 'G' has the dimensions: none"),
        ("sum(m*v_r, body)", "cross(r, v_r, axis)", "goes along 'axis' of 2 elements, and needs 3"),
        ("sum(m*v_r, body)", "shift(r, body, 1, 1*second)", "'shift' joins 'r' in 'm' with '1\\*second' in 's'"),
        ("sum(m*v_r, body)", "shift(r, body, 0.5, 0*metre)", "the number of places is a whole literal"),
        ("sum(m*v_r, body)", "first(r, body)", "'body' is no relation; there are: pair"),
        (
            'r = "m"',
            'r = "distance*kilogram/metre"',
            "mass of 'r': 'distance\\*kilogram/metre' has the dimension 'pair', and it needs body, axis",
        ),
        ("first(m, pair)*", "m*kilogram/kilogram*", "potential of 'gravity': has the dimension 'body' beside 'pair'"),
        ("G*first", "G*2*metre*first", "potential of 'gravity' has units 'kg m3 s-2'"),
        ('over = "pair"', 'over = "pairs"', "force 'gravity' is over 'pairs', which is no relation; there are: pair"),
        ("sum(m*v_r, body)", "sum(m*v_r, site)", "'site' is no dimension or relation"),
        (
            "norm(r, axis) -",
            "norm(m, axis) -",
            "event 'far': 'norm\\(m, axis\\)' \\(column 1\\) goes along 'axis', and 'm' has the dimensions: body",
        ),
        (
            'r = { value = [[0, 0], [1, 0], [0, 3]], unit = "m" }',
            'r = "index(body)*G"',
            "initial value of 'r' has units 'kg-1 m3 s-2', needs 'm'",
        ),
        (
            'r = { value = [[0, 0], [1, 0], [0, 3]], unit = "m" }',
            'r = { table = "x.csv", columns = ["a"] }',
            "columns names 1, needs 2, one for each of 'axis'",
        ),
        (
            'r = { value = [[0, 0], [1, 0], [0, 3]], unit = "m" }',
            'r = { csv = "a [m],b [m]\\n1,2\\n", columns = ["a", "b"] }',
            "has 1 rows, and 'body' has 3 elements",
        ),
    ],
)
def test_what_is_refused_names_the_remedy(old: str, new: str, message: str) -> None:
    """Assert that a wrong dimension, label, link, table or unit is named, in one line."""
    with pytest.raises(xd.ModelError, match=message):
        xd.Model.from_text(changed(PLANETS, old, new))


def test_ends_of_links_are_labels_or_numbers() -> None:
    """Assert that a table of links says by numbers what it says by labels, and a word of Python is no dimension."""
    by_labels, by_numbers = (
        xd.Model.from_text(changed(PLANETS, 'of = "body"', f'of = "body"\ncsv = "first,second\\n{ends}\\n"'))
        for ends in ("Saturn,Sun", "2,0")
    )
    for model in (by_labels, by_numbers):
        relation = model.shapes.relations["pair"]
        assert [relation.first.tolist(), relation.second.tolist()] == [[2], [0]]
    with pytest.raises(xd.ModelError, match="^model 'chain': dimension 'class': 'class' is a word of Python"):
        xd.Model.from_text(CHAIN.replace("site", "class"))


def test_dimensions_have_names_of_their_own() -> None:
    """Assert that a dimension is not called like a coordinate, or like a dimension of the record."""
    with pytest.raises(xd.ModelError, match="dimension 'step': 'step' is a dimension of the record"):
        xd.Model.from_text(CHAIN.replace("site", "step"))
    for name, owner in (("site_label", "dimension 'site'"), ("spring_first", "relation 'spring'")):
        with pytest.raises(xd.ModelError, match=f"{owner} and parameter '{name}' both claim the name '{name}'"):
            xd.Model.from_text(CHAIN.replace("A =", f'{name} = "1 m"\nA ='))
    with pytest.raises(xd.ModelError, match="parameter 'v_u' and coordinate 'u' both claim the name 'v_u'"):
        xd.Model.from_text(CHAIN.replace("m = {", 'v_u = { dims = ["site"], value = 1 }\nm = {'))
    with pytest.raises(xd.ModelError, match="relation 'u' and coordinate 'u' have one name; rename one"):
        xd.Model.from_text(CHAIN.replace("spring]", "u]").replace("spring)", "u)").replace('"spring"', '"u"'))


def test_members_of_a_sweep_start_where_their_parameters_say() -> None:
    """Assert that values at the start follow arrays of parameters to the bit of single models, and slopes know it."""
    model = xd.Model.from_text(CHAIN.replace('unit = "m", dims = ["site"]', 'unit = "mm", dims = ["site"]'))
    amplitudes = np.array([0.1, 0.2, 0.37])
    starts = model.started({"A": amplitudes}, {})
    assert {*starts} == {f"u·{i}" for i in range(6)}
    for i, amplitude in enumerate(amplitudes):
        alone = model.replace(parameters={"A": float(amplitude)})
        assert [float(starts[name][i]) for name in starts] == [alone.initial[name].si for name in starts]
    assert model.started({"k": amplitudes}, {}) == {}
    settings = {"method": "dop853", "rtol": 1e-10, "until": 1.0}
    uncertain = model.replace(parameters={"A": "0.1 ± 0.01 m"})
    budget = xd.error_budget(uncertain, quantity="u·2", at="1 s", **settings)
    slope = float(budget.sensitivity[budget.term_name.values.tolist().index("A")])
    assert slope == pytest.approx(float(budget.value) / 0.1, rel=1e-6)  # the motion is linear in it


CART = """
name = "pendulums on a cart"
[dimensions]
bob = ["a", "b", "c"]
[coordinates]
x = "m"
theta = { unit = "rad", dims = ["bob"] }
[parameters]
M = "2 kg"
m = { dims = ["bob"], value = [0.3, 0.2, 0.1], unit = "kg" }
l = { dims = ["bob"], value = [1.0, 0.5, 0.25], unit = "m" }
g = "9.81 m s-2"
[mass]
matrix = [["M + sum(m, bob)", "m*l*cos(theta)/radian"], ["m*l*cos(theta)/radian", "m*l**2/radian**2"]]
[forces.centrifugal]
x = "sum(m*l*sin(theta)*v_theta**2, bob)/radian**2"
[forces.weight]
potential = "-sum(m*g*l*cos(theta), bob)"
[initial]
x = "0 m"
theta = { unit = "rad", value = [0.5, -1.0, 2.0] }
"""


def test_a_mass_matrix_has_blocks() -> None:
    """Assert that an entry between two blocks is of their elements, and that pendulums move their cart as numpy's solve says."""
    model = xd.Model.from_text(CART)
    assert xd.Model.from_text(model.to_toml()) == model
    entries = {place: text_of(entry) for place, entry in model.elements.statement.mass_entries.items()}
    assert {(0, 0), (0, 1), (1, 0), (0, 3), (3, 3)} <= {*entries}
    assert not {(1, 2), (2, 1), (2, 3)} & {*entries}
    assert entries[0, 2] == entries[2, 0] == "m·b*l·b*cos(theta·b)/radian"
    m, l, angle, speed = np.array([[0.3, 0.2, 0.1], [1.0, 0.5, 0.25], [0.5, -1.0, 2.0], [0.0, 0.0, 0.0]])
    mass = np.zeros((4, 4))
    mass[0, 0], mass[1:, 1:] = 2.0 + m.sum(), np.diag(m * l**2)
    mass[0, 1:] = mass[1:, 0] = m * l * np.cos(angle)
    right = np.append(np.sum(m * l * np.sin(angle) * speed**2), -m * 9.81 * l * np.sin(angle))
    run = xd.simulate(model, method="rk4", step="1 ms", until="1 ms")
    found = np.append(run.a_x.values[0], run.a_theta.values[0])
    assert np.allclose(found, np.linalg.solve(mass, right), rtol=1e-13)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('[["M + sum(m, bob)"', '[["M + m"', r"mass of 'x': 'M \+ m' has the dimension 'bob', and it needs none"),
        ('["m*l*cos(theta)/radian", "m*', '["2*m*l*cos(theta)/radian", "m*', "mass matrix is not symmetric: entry"),
    ],
)
def test_entries_of_a_mass_matrix_have_the_dimensions_of_both(old: str, new: str, message: str) -> None:
    """Assert that an entry with a dimension of neither block, and one without its mirror image, are refused."""
    with pytest.raises(xd.ModelError, match=message):
        xd.Model.from_text(changed(CART, old, new))


FLOOR = """
name = "balls"
[dimensions]
ball = 3
[coordinates]
y = { unit = "m", dims = ["ball"] }
[parameters]
h = "-1 m"
[mass]
y = "1*kilogram"
[contacts.floor]
gap = "y - h"
restitution = 0
[initial]
y = "3*metre"
"""


@pytest.mark.parametrize("gap", ["y - 0.1*metre*mod(index(ball), 2)", "where(index(ball) > 1, y - h, y)", "y + abs(h)"])
def test_gaps_may_choose_by_numbers_of_elements(gap: str) -> None:
    """Assert that what reads numbers of elements, or parameters, alone is no kink, and what reads coordinates is."""
    xd.Model.from_text(changed(FLOOR, "y - h", gap))
    with pytest.raises(xd.ModelError, match="gap has a kink or a jump"):
        xd.Model.from_text(changed(FLOOR, "y - h", gap.replace("index(ball)", "y/metre").replace("abs(h)", "abs(y)")))


def test_constants_in_a_row_are_those_by_name() -> None:
    """Assert that a law's constants without the names of elements are to the bit those by name, in any scales."""
    spread = PLANETS.replace(
        "[mass]", 'q = { dims = ["body"], value = [1, 2, 4], unit = "uC", uncertainty = "1 nC" }\n[mass]'
    )
    changed = xd.Model.from_text(spread).replace(parameters={"m[Jupiter]": "3 kg", "G": "2 N m2 kg-2"})
    for model in (xd.Model.from_text(PLANETS), xd.Model.from_text(spread), changed):
        for scales in (UNSCALED, Scales(length=3.0, time=7.0, mass=0.1)):
            by_name = np.array([*constants(model, scales).values()])
            assert constant_values(model, scales).tobytes() == by_name.tobytes()
            assert constant_names(model) == tuple(constants(model, scales))


def test_links_of_every_two_are_known_as_such() -> None:
    """Assert it of links that are declared so, and of tables of them by what they are; with a link changed, not."""
    relations = xd.Model.from_text(PLANETS).shapes.relations
    first, second = np.triu_indices(5, 1)
    told = Relation("pair", "body", "body", first, second)
    others = (second, first), (first, second[[1, 0, *range(2, 10)]]), (first[[0, 4, 2, 3, 1, *range(5, 10)]], second)
    assert relations["pair"].is_of_every_two
    assert told.is_of_every_two
    assert not any(Relation("pair", "body", "body", *ends).is_of_every_two for ends in others)
    assert not Relation("pair", "body", "wall", first, second).is_of_every_two
    assert [ends.tolist() for ends in every_two(5)] == [first.tolist(), second.tolist()]


def test_links_between_two_dimensions_pull_both_ends() -> None:
    """Assert that the same force, written of both coordinates, is that of its potential: opposite at the second ends."""
    stretch = "(second(w, hung) - first(u, hung))"
    acts = {"u": f"k*{stretch}", "w": f"k*{stretch}"}
    first, second = np.array([1.0, 2.0, 4.0]), np.array([-3.0, 0.5])
    sections = {
        "name": "hung",
        "dimensions": {"bead": 3, "wall": ["low", "high"]},
        "relations": {"hung": {"from": "bead", "to": "wall"}},
        "coordinates": {"u": {"unit": "m", "dims": ["bead"]}, "w": {"unit": "m", "dims": ["wall"]}},
        "parameters": {"k": {"dims": ["hung"], "value": "1 + index(hung)", "unit": "N m-1"}},
        "mass": {"u": "1*kilogram", "w": "2*kilogram"},
        "initial": {"u": {"value": first.tolist(), "unit": "m"}, "w": {"value": second.tolist(), "unit": "m"}},
        "run": {"method": "rk4", "step": "0.1 s", "until": "1 s"},
    }
    pulls = np.arange(1.0, 7.0).reshape(3, 2) * (second - first[:, None])
    for force in ({"potential": f"0.5*k*{stretch}**2"}, acts):
        run = xd.simulate(xd.Model(**sections, forces={"s": {"over": "hung", **force}}))
        np.testing.assert_allclose(run.force_s_u[0], pulls.sum(1), rtol=1e-15)
        np.testing.assert_allclose(run.force_s_w[0], -pulls.sum(0), rtol=1e-15)
        momentum = run.v_u.sum("bead") + 2.0 * run.v_w.sum("wall")
        assert float(abs(momentum).max()) < 1e-13


@pytest.mark.parametrize(
    ("acts", "said"),
    [
        (
            {"u": "f"},
            "acts on 'u' alone, .* at the second end .* where 'w' moves along 'wall'; .* w = \"f\", which acts opp",
        ),
        (
            {"w": "f"},
            "acts on 'w' alone, .* at the first end .* where 'u' moves along 'bead'; .* u = \"f\", which acts on",
        ),
        (
            {"u": "f", "w": "-f"},
            'pushes both ends of each link the same way: .* write the same of both, w = "f" as u = "f"',
        ),
        ({"u": "f", "w": "k*(first(u, hung) - second(w, hung))"}, "pushes both ends of each link the same way"),
        ({"u": "f", "w": "2*f - 3*f"}, None),
        ({"u": "f", "w": "0*f"}, None),
        ({"u": "f", "w": "f"}, None),
    ],
)
def test_a_force_between_two_dimensions_has_its_opposite(acts: dict[str, str], said: str | None) -> None:
    """Assert that a force on one end where both move is refused with the remedy, and a record of it still read."""
    sections: dict[str, object] = {
        "name": "hung",
        "initial": {"u": "0 m", "w": "1 m"},
        "dimensions": {"bead": 3, "wall": ["low", "high"]},
        "relations": {"hung": {"from": "bead", "to": "wall"}},
        "coordinates": {"u": {"unit": "m", "dims": ["bead"]}, "w": {"unit": "m", "dims": ["wall"]}},
        "parameters": {"k": "1 N m-1"},
        "definitions": {"f": "k*(second(w, hung) - first(u, hung))"},
        "mass": {"u": "1*kilogram", "w": "2*kilogram"},
    }
    both = xd.Model(**sections, forces={"s": {"over": "hung", "u": "f", "w": "f"}})  # type: ignore[arg-type]
    text = both.to_toml().replace('u = "f"\nw = "f"\n', "".join(f'{name} = "{tree}"\n' for name, tree in acts.items()))
    assert {*xd.Model.from_record(text).statement.forces["s"].components} == {*acts}
    for make in (
        lambda: xd.Model(**sections, forces={"s": {"over": "hung", **acts}}),
        lambda: xd.Model.from_text(text),
        lambda: both.replace(forces={"s": {"over": "hung", **acts}}),
    ):
        if said is None:
            make()
            continue
        with pytest.raises(xd.ModelError, match=said):
            make()


@pytest.mark.parametrize("labels", [["p", "q", "s"], 3])
def test_an_element_is_replaced_and_swept_by_its_number(labels: list[str] | int) -> None:
    """Assert that numbers, from the front or the end, are those of the elements, and that others are told with all."""
    sections: dict[str, object] = {
        "name": "three",
        "dimensions": {"b": labels},
        "coordinates": {"y": {"unit": "m", "dims": ["b"]}},
        "parameters": {"m": {"dims": ["b"], "value": [1.0, 2.0, 4.0], "unit": "kg"}},
        "mass": {"y": "m"},
        "forces": {"push": {"y": "1*newton"}},
        "initial": {"y": "0 m"},
    }
    model = xd.Model(**sections)
    changed = model.replace(parameters={"m[-1]": 5.0, "m[0]": "3 kg"}, initial={"v_y[-2]": "7 m s-1"})
    assert [part.quantity.si for part in changed.parameters.values()] == [3.0, 2.0, 5.0]
    assert [changed.initial[name].si for name in changed.shapes.elements("v_y")] == [0.0, 7.0, 0.0]
    swept = xd.sweep(model, axes={"m[-1]": [4.0, 8.0]}, method="rk4", step="1 s", until="2 s", keep=["end"])
    np.testing.assert_allclose(swept.end_y, [[2.0, 1.0, 0.5], [2.0, 1.0, 0.25]], rtol=1e-15)
    for name in ("m[3]", "m[-4]"):
        with pytest.raises(
            xd.ModelError, match=r"dimension 'b' has no element (3|-4); it has the (labels p, q, s|elements 0 to 2)"
        ):
            model.replace(parameters={name: 1.0})
    with pytest.raises(
        xd.ModelError, match=r"'m\[z\]': dimension 'b' has no element z; it has the (labels p, q, s|elements 0 to 2)"
    ):
        model.replace(parameters={"m[z]": 1.0})

"""Elements that are named by their number, from the front or from the end, wherever a quantity's name is taken.

Blocks: what stands where in an array.
Relations of dimensions: which are of every two elements.
Elements taken by number: what is refused, and what a Jacobian has of them.
"""

from __future__ import annotations

import pickle
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.cli import main
from xdynamics.expressions import parse, text_of
from xdynamics.expressions.dimensions import dimension_of
from xdynamics.faults import InputError
from xdynamics.kernels import layout_of
from xdynamics.shapes import Extent, Shapes, at_element, dims_of
from xdynamics.shapes.blocks import Block, Blocks
from xdynamics.shapes.dependence import Dependence
from xdynamics.shapes.evaluation import evaluate_elements
from xdynamics.shapes.extents import Relation, every_two
from xdynamics.units import parse_unit

TEXT = """
name = "Three on springs"
[dimensions]
site = LABELS
[coordinates]
u = { unit = "m", dims = ["site"] }
[parameters]
m = { dims = ["site"], value = [1.0, 2.0, 4.0], unit = "kg", uncertainty = "0.1 kg" }
k = "4 N m-1"
[mass]
u = "m"
[forces.spring]
u = "-k*u"
[initial]
u = "0.5 m"
[events.middle]
function = "u"
direction = "falling"
[events.turn]
function = "v_u[2]"
action = "reset"
set = { "v_u[LAST]" = "0*metre/second" }
[validation.closed]
quantity = "u[LAST]"
expression = "0.5*metre*cos(sqrt(k/m[LAST])*t)"
times = ["0.5 s"]
bound = "1e-2 m"
[run]
step = "0.05 s"
until = "2 s"
[discrepancy]
u = "1 mm"
"""
MARCH: dict[str, Any] = {"method": "velocity_verlet", "step": "0.05 s", "until": "2 s"}
DATA = {"time [s]": [0.2, 0.4, 0.6, 0.8], "u[LAST] [m]": [0.49, 0.46, 0.41, 0.34]}


def model(last: str = "-1", labels: str = "3") -> xd.Model:
    """Return three oscillators, the last of which is named in its file in some way."""
    return xd.Model.from_text(TEXT.replace("LAST", last).replace("LABELS", labels))


def swept(name: Callable[[str], str]) -> xr.Dataset:
    """Sweep the last mass, and keep numbers of the last coordinate."""
    keep = [name("u"), name("maximum_u"), name("event_time_middle")]
    return xd.sweep(model(), axes={name("m"): ["4 kg", "8 kg"]}, keep=keep, times=["1 s"], **MARCH)


def drawn(name: Callable[[str], str]) -> xr.Dataset:
    """Draw the last mass from a range, and as it is declared."""
    draws = xd.Draws(2, {name("m"): ("4 kg", "5 kg")}), xd.Draws(2, [name("m")], "declared")
    return xr.merge(
        [xd.sweep(model(), axes={f"d{i}": draw}, keep=["end"], **MARCH) for i, draw in enumerate(draws)],
        compat="override",
    )


def refined(name: Callable[[str], str]) -> xr.Dataset:
    """Refine the last coordinate until it changes by little."""
    asked = {"at": ["1 s"], "observables": [name("u")], "until_change": {name("u"): "1 mm"}}
    return xd.refine(model(), method="velocity_verlet", steps=["0.1 s", "0.05 s", "0.025 s"], until="2 s", **asked)


def budgeted(name: Callable[[str], str]) -> xr.Dataset:
    """Budget the time at which the last one passes its middle, by its own mass alone."""
    return xd.error_budget(model(), "t", event=name("middle"), only=[name("m")], **MARCH)


def fitted(name: Callable[[str], str]) -> xr.Dataset:
    """Fit the last mass to what was measured of the last coordinate."""
    data = {name("u") + " [m]" if "u" in title else title: column for title, column in DATA.items()}
    return xd.fit(model(), data, [name("m")], bounds={name("m"): ("1 kg", "9 kg")}, **MARCH)


def diagnosed(name: Callable[[str], str]) -> xr.Dataset:
    """Diagnose the last coordinate beside a closed form."""
    run = xd.simulate(model(), **MARCH | {"until": "8 s"})
    return xd.diagnose(run, of=name("u"), exact={name("u"): "0.5*metre*cos(t/second)"}, reference="6 s")


@pytest.mark.parametrize("verb", [swept, drawn, refined, budgeted, fitted, diagnosed])
def test_every_verb_takes_the_last_element_by_either_number(verb: Callable[..., xr.Dataset]) -> None:
    """Assert that -1 is 2 wherever a name is given, and that -4 and 3 are refused with what there is."""
    xr.testing.assert_equal(verb("{}[-1]".format), verb("{}[2]".format))
    for number in ("-4", "3", "x", "0, 1", ""):
        with pytest.raises(
            xd.InputError, match=r"dimension 'site' has no element \S+; it has the elements 0 to 2|an entry"
        ):
            verb(f"{{}}[{number}]".format)


def test_files_take_numbers_from_the_end() -> None:
    """Assert that a reset and a closed form of -1 are those of 2, and of a label; a file keeps what it says."""
    runs = [
        xd.simulate(entry, **MARCH | {"until": "4 s"}) for entry in (model(), model("2"), model("c", '["a", "b", "c"]'))
    ]
    assert runs[0].sizes["event"] == 5
    for run in runs[1:]:
        assert run.u.values.tobytes() == runs[0].u.values.tobytes()
    ledgers = [xd.validate(["velocity_verlet"], entry) for entry in (model(), model("2"))]
    assert [ledger.case_observable.item() for ledger in ledgers] == ["u[2]", "u[2]"]
    assert ledgers[0].residual.item() == ledgers[1].residual.item() < 1e-4
    assert '"v_u[-1]" = ' in model().to_toml()
    assert 'quantity = "u[-1]"' in model().to_toml()
    with pytest.raises(xd.ModelError, match=r"'v_u\[-4\]': dimension 'site' has no element -4"):
        model("-4")


def test_the_command_line_sets_the_last_element(tmp_path: Path) -> None:
    """Assert that --set and --only take -1, and say what there is for -4."""
    path, archive = tmp_path / "three.toml", tmp_path / "run.nc"
    path.write_text(model().to_toml())
    call = ["run", str(path), "--method", "rk4", "--step", "0.1 s", "--until", "1 s", "-o", str(archive)]
    assert CliRunner().invoke(main, [*call, "--set", "m[-1]=8 kg"]).exit_code == 0
    assert xd.open_run(archive).m.values.tolist() == [1.0, 2.0, 8.0]
    refused = CliRunner().invoke(main, [*call, "--set", "m[-4]=8 kg"])
    assert "--set 'm[-4]': dimension 'site' has no element -4; it has the elements 0 to 2" in refused.output
    drawn = CliRunner().invoke(main, ["plot", str(archive), "--only", "u[-1]", "-o", str(tmp_path / "u.png")])
    assert drawn.exit_code == 0


@pytest.mark.parametrize("target", ["u[", "u[0", "u[0]x", "u]"])
def test_targets_without_both_brackets(target: str) -> None:
    """Assert that a reset of what is only nearly an element is refused by its name."""
    text = model().to_toml().replace('"v_u[-1]" =', f'"{target}" =')
    with pytest.raises(xd.ModelError, match=f"event 'turn' sets '{re.escape(target)}', which is no coordinate"):
        xd.Model.from_text(text)


def test_one_element_by_two_numbers() -> None:
    """Assert that two values for one element are refused, where one of them would be lost."""
    with pytest.raises(xd.ModelError, match=r"\[initial\] names 'u\[2\]' twice"):
        model().replace(initial={"u[-1]": "2 m", "u[2]": "3 m"})
    with pytest.raises(xd.ModelError, match=r"\[parameters\] names 'm\[c\]' twice"):
        model("c", '["a", "b", "c"]').replace(parameters={"m[c]": "2 kg", "m[2]": "3 kg"})
    with pytest.raises(xd.InputError, match=r"draws have 'm\[2\]' twice"):
        xd.sweep(model(), {"d": xd.Draws(2, {"m[2]": ("4 kg", "5 kg"), "m[-1]": ("1 kg", "2 kg")})}, **MARCH)
    with pytest.raises(xd.InputError, match=r"ranges have 'm\[2\]' twice"):
        xd.sobol_indices(model(), ["m[2]", "m[-1]"], quantity="end_u[2]", draws=4, **MARCH)
    with pytest.raises(xd.InputError, match=r"until_change names 'u\[2\]' twice"):
        xd.refine(
            model(), method="rk4", steps=["0.1 s", "0.05 s"], until="1 s", until_change={"u[2]": "1 m", "u[-1]": "1 mm"}
        )


@pytest.mark.parametrize(
    ("pairs", "message"),
    [
        ('"m[-1]" = { "m[2]" = 0.3 }', r"m\[-1\] and m\[2\]: a number with itself has 1"),
        ('"m[0]" = { "m[2]" = 0.3 }\n"m[-1]" = { "m[0]" = 0.4 }', r"m\[-1\] and m\[0\]: are there twice"),
        ('"m[0]" = { "m[3]" = 0.3 }', r"'m\[3\]': dimension 'site' has no element 3"),
    ],
)
def test_correlations_of_elements(pairs: str, message: str) -> None:
    """Assert that pairs are judged by the elements that are meant, and that the section is named."""
    with pytest.raises(xd.ModelError, match=f"model 'Three on springs': correlations: {message}"):
        xd.Model.from_text(f"{model().to_toml()}\n[correlations]\n{pairs}\n")


def test_discrepancies_of_elements() -> None:
    """Assert that the discrepancy of an element that is not there, or there twice, is refused with its section."""
    text = model().to_toml()
    for names, message in ((("u[3]",), "has no element 3"), (("u[2]", "u[-1]"), "twice")):
        entries = "\n".join(f'"{name}" = {{ standard = "1 mm" }}' for name in names)
        with pytest.raises(xd.ModelError, match=rf"'Three on springs': discrepancy: names 'u\[\d\]'.* {message}"):
            xd.Model.from_text(text.replace('u = { "standard" = "1.0 mm" }', entries))


def test_names_that_are_no_text() -> None:
    """Assert that numbers in the place of names are refused with what is needed."""
    run = xd.simulate(model(), **MARCH)
    with pytest.raises(xd.InputError, match="of is 5, needs the name of a coordinate"):
        xd.diagnose(run, of=5)  # type: ignore[arg-type]
    for only in ([5], 5):
        with pytest.raises(
            xd.InputError, match=re.escape(f"only is {only!r}, needs kinds of panels and names in a list")
        ):
            xd.plot(run, only=only)  # type: ignore[arg-type]


def test_blocks_stand_one_after_another() -> None:
    """Assert that places follow from the shapes of the blocks before, also in arrays joined from others."""
    random = np.random.default_rng(1)
    shapes = [tuple(random.integers(0, 4, size=random.integers(0, 3)).tolist()) for _ in range(20)]
    blocks = [Block(f"b{k}", "state", tuple("ij"[: len(shape)]), shape) for k, shape in enumerate(shapes)]
    joined = Blocks(blocks[:7]) + Blocks(blocks[7:])
    places = np.cumsum([0, *(int(np.prod(shape)) for shape in shapes)])
    assert [joined.offset_of(block.name) for block in joined.blocks] == places[:-1].tolist()
    assert joined.size == len(joined) == places[-1]


def test_numbers_are_found_by_their_names() -> None:
    """Assert that every number of blocks has a name, by which it is found, and that no other name is."""
    body, axis = Extent("body", 2, ("Sun", "Moon")), Extent("axis", 3)
    blocks = Blocks([Block("t", "time"), Block("r", "coordinate", ("body", "axis"), (2, 3), (body, axis))])
    assert tuple(blocks) == ("t", *(f"r·{label}·{k}" for label in ("Sun", "Moon") for k in range(3)))
    assert [blocks.index(name) for name in blocks] == [*range(7)] == [blocks.find_offset(blocks[k]) for k in range(7)]
    assert blocks[-1] == "r·Moon·2"
    assert blocks.renamed("velocity", "v_{}".format).offset_of("v_r·Moon·0") == 4
    for name in ("r", "r·Sun", "r·Sun·3", "r·Sun·03", "r·Sun·²", "r·Mars·0", "s·Sun·0", 0):
        assert name not in blocks


def test_copies_have_the_same_blocks() -> None:
    """Assert that blocks are the same after a trip to another process."""
    blocks = Blocks([Block("r", "coordinate", ("body",), (3,)), Block("s", "state")])
    copy = pickle.loads(pickle.dumps(blocks))
    assert (copy, copy.blocks, copy.size, copy.offset_of("s")) == (blocks, blocks.blocks, 4, 3)


def test_a_state_has_its_variables_first() -> None:
    """Assert the order of roles in a state of the march, and that a single number has the shape of none."""
    record = layout_of(xd.Model.from_toml(MODELS / "double_pendulum.toml")).record
    roles = list(dict.fromkeys(block.role for block in record.blocks))
    assert roles == ["coordinate", "velocity", "acceleration", "force"]
    assert {block.shape for block in record.blocks} == {()}
    assert record.size == len(record)


def relation(first: list[int], second: list[int], target: str = "body", *, made_so: bool = False) -> Relation:
    """Return a relation from bodies to a dimension."""
    ends = (np.array(numbers, np.int64) for numbers in (first, second))
    return Relation("pair", "body", target, *ends, of_every_two=made_so)


@pytest.mark.parametrize("n", [3, 4, 7, 100])
@pytest.mark.parametrize("made_so", [False, True])
def test_every_two_are_counted(n: int, made_so: bool) -> None:
    """Assert that n(n - 1)/2 links, in their order, are of every two, and that one fewer or one more are not."""
    first, second = (numbers.tolist() for numbers in every_two(n))
    assert len(first) == n * (n - 1) // 2
    assert relation(first, second, made_so=made_so).is_of_every_two
    assert not relation(first[:-1], second[:-1], made_so=made_so).is_of_every_two
    assert not relation([*first, 0], [*second, n - 1], made_so=made_so).is_of_every_two
    assert not relation(first, second, "wall", made_so=made_so).is_of_every_two


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ([0], [1]),  # two elements, written out
        ([0, 1, 2], [1, 2, 0]),  # a ring
        ([0, 1, 0], [1, 2, 2]),  # in another order
        ([0, 0, 1], [1, 2, 3]),  # of four
    ],
)
def test_other_links_are_not_of_every_two(first: list[int], second: list[int]) -> None:
    """Assert that links of the number of pairs are compared with these, one by one."""
    assert not relation(first, second).is_of_every_two


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
    """Assert that what reads no quantity with dimensions is no sum of ninety thousand terms written one after the other."""
    n = 300
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

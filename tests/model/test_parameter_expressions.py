"""Values for elements stay in a model's text as they were given, and are the same model as their numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from xdynamics.archive import segments
from xdynamics.march import March
from xdynamics.march.configuration import settings_for
from xdynamics.record import identity, is_of

CHAIN = """
name = "springs on walls"
[dimensions]
site = 5
cell = 2
[coordinates.u]
dims = ["site"]
unit = "m"
[parameters]
m = "1 kg"
k = { dims = ["site"], value = "3 + 2*index(site)", unit = "N m-1", description = "stiffness" }
c = { dims = ["site"], value = "0.1*index(site)*newton*second/metre", uncertainty = "0.01 N s m-1" }
d = { dims = ["site"], value = "0.5 N m-1" }
[mass]
u = "m"
[forces.spring]
u = "-(k + d)*u - c*v_u"
[initial]
u = "0.1 m"
v_u = { value = "-0.2 m s-1", uncertainty = "1 mm s-1" }
"""
SETTINGS: dict[str, Any] = {"until": "0.1 s", "step": "0.01 s", "method": "heun"}
MODEL = xd.Model.from_text(CHAIN)
NUMBERED = xd.Model(**MODEL.written_out())


LINKS = """
name = "bonds"
[dimensions]
site = ["a", "b", "c"]
axis = ["x", "y"]
[relations.bond]
of = "site"
csv = "first,second,k [N m-1]\\na,b,1\\nb,c,2\\n"
table = "bonds.csv"
[coordinates.r]
dims = ["site", "axis"]
unit = "m"
[parameters]
m = { dims = ["site", "axis"], values = { a = { x = "1 kg", y = "2 kg" }, c = [5, 6], b = "3 kg" }, unit = "kg" }
[mass]
r = "m"
[forces.bonds]
over = "bond"
potential = "k*norm(second(r, bond) - first(r, bond), axis)**2/2"
[initial]
r = { values = { a = [0, 1], b = { y = 3, x = 2 }, c = 4 }, unit = "m" }
"""


def lines(model: xd.Model, name: str) -> str:
    """What the text of a model says of an entry."""
    return "".join(line for line in model.to_toml().splitlines() if line.startswith(f"{name} = {{"))


def test_values_stay_as_they_are_given() -> None:
    """Assert that the text has the expressions and the numbers of all elements, and reads back as itself."""
    assert lines(MODEL, "k").count("3 + 2*index(site)") == lines(MODEL, "c").count("0.1*index(site)") == 1
    assert '"value" = 0.5' in lines(MODEL, "d")
    assert '"value" = 0.1' in lines(MODEL, "u")
    assert xd.Model.from_text(MODEL.to_toml()).to_toml() == MODEL.to_toml()


def test_a_record_has_the_numbers() -> None:
    """Assert the numbers of an expression beside a unit, and of one that all elements have."""
    run = xd.simulate(MODEL, **SETTINGS)
    np.testing.assert_array_equal(run.k, [3.0, 5.0, 7.0, 9.0, 11.0])
    np.testing.assert_array_equal(run.d, [0.5] * 5)
    assert (run.k.units, run.d.units, run.k.long_name) == ("N m-1", "N m-1", "stiffness")
    assert [MODEL.parameters[f"c·{i}"].uncertainty for i in range(5)] == [0.01] * 5


@pytest.mark.parametrize(
    ("name", "value"), [("k[2]", 7.5), ("c[0]", 1.0), ("d[4]", 0.25), ("k[2]", "7.0000000000000000001 N/m")]
)
def test_an_element_with_another_value_makes_numbers(name: str, value: float | str) -> None:
    """Assert numbers for all elements, those of the record, and the text as it was where the element has its own again."""
    other = MODEL.replace(parameters={name: value})
    assert "[" in lines(other, name[0]).partition('"value"')[2]
    assert {key for key in "kcdu" if lines(other, key) != lines(MODEL, key)} == {name[0]}
    assert xd.Model.from_text(other.to_toml()) == other
    own = MODEL.parameters[f"{name[0]}·{name[2]}"].quantity.value
    assert other.replace(parameters={name: own}) == MODEL


def test_the_start_of_an_element_makes_numbers() -> None:
    """Assert that the start of one element is written out alone."""
    other = MODEL.replace(initial={"u[1]": 0.2})
    assert '"value" = [0.1, 0.2, 0.1, 0.1, 0.1]' in lines(other, "u")
    assert lines(other, "v_u") == lines(MODEL, "v_u")
    assert other.replace(initial={"u[1]": 0.1}) == MODEL


@pytest.mark.parametrize(
    ("value", "text", "unit"),
    [
        ("2*index(site)", '"2*index(site)"', "N m-1"),
        ("2*index(site)*newton/metre", '"2*index(site)*newton/metre"', "kg s-2"),
        (3.0, "3.0", "N m-1"),
        ("3 N/cm", "300.0", "N m-1"),
        ([1, 2, 3, 4, 5], "[1.0, 2.0, 3.0, 4.0, 5.0]", "N m-1"),
        ("3 ± 1 N/m", "3.0", "N m-1"),
    ],
)
def test_another_value_takes_the_unit(value: Any, text: str, unit: str) -> None:
    """Assert that numbers and expressions of pure numbers take the unit of the entry, as single numbers do."""
    other = MODEL.replace(parameters={"k": value})
    assert f'"value" = {text}' in lines(other, "k")
    assert other.parameters["k·0"].quantity.unit.text == unit
    assert ("uncertainty" in lines(other, "k")) == ("±" in str(value))


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ("2*index(site)*newton", r"k = '2\*index\(site\)\*newton' has units 'kg m s-2 \(N\)', needs 'kg s-2', or none"),
        ("2*index(cell)", r"parameter 'k': '2\*index\(cell\)' has the dimension 'cell', and it needs site; reduce it"),
        ("2*m", r"parameter 'k': '2\*m' reads 'm'; a parameter by an expression is of constants and index"),
        ("1/index(site)", r"parameter 'k': '1/index\(site\)' is inf at k\[0\], and needs finite numbers"),
        ("3 s", r"parameter 'k': has '3 s' beside values in 'N m-1'; elements of one quantity need one unit"),
    ],
)
def test_wrong_values_are_told(value: str, said: str) -> None:
    """Assert that each says what is wrong and what is needed."""
    with pytest.raises(xd.ModelError, match=said):
        MODEL.replace(parameters={"k": value})


def test_a_unit_twice_is_told() -> None:
    """Assert that a unit beside an expression that has one is refused."""
    with pytest.raises(
        xd.ModelError, match=r"parameter 'c': has unit 'N' beside '.*', which has units 'kg s-1' itself"
    ):
        xd.Model.from_text(CHAIN.replace("uncertainty", 'unit = "N", uncertainty'))


def test_a_unit_stands_beside_an_expression_of_a_start() -> None:
    """Assert that pure numbers are in that unit, in a text of the model too, and that no other expression is."""
    start = 'u = { value = "2*sin(index(site) + m/kilogram)", unit = "mm" }'
    model = xd.Model.from_text(CHAIN.replace('u = "0.1 m"', start))
    for each in (model, xd.Model.from_text(model.to_toml())):
        run = xd.simulate(each, **SETTINGS)
        np.testing.assert_allclose(run.u[0], 2e-3 * np.sin(np.arange(5.0) + 1.0), rtol=1e-15)
    with pytest.raises(xd.ModelError, match=r"initial value of 'u' has units 'm kg', needs 'm'|'kg m', needs 'm'"):
        xd.Model.from_text(CHAIN.replace('u = "0.1 m"', 'u = { value = "m*index(site)", unit = "mm" }'))
    with pytest.raises(xd.ModelError, match="has uncertainty beside an expression; give it to the parameters"):
        xd.Model.from_text(CHAIN.replace('u = "0.1 m"', start.replace("unit", 'uncertainty = "1 mm", unit')))


def test_a_model_of_numbers_is_the_same() -> None:
    """Assert that runs of both texts are identical, and each of either model; not with another last bit."""
    assert NUMBERED != MODEL
    runs = [xd.simulate(model, **SETTINGS) for model in (MODEL, NUMBERED)]
    marches = [March(model, settings_for(model, **SETTINGS)) for model in (MODEL, NUMBERED)]
    assert all(is_of(run, march) for run in runs for march in marches)
    assert identity(marches[0]) == identity(marches[1])
    told = xd.compare(*runs).attrs
    assert (told["identical"], told["settings"], told["parameters"], told["initial"], told["cause"]) == (
        1,
        "",
        "",
        "",
        "",
    )
    other = NUMBERED.replace(parameters={"d[1]": np.nextafter(0.5, 1.0)})
    assert not is_of(runs[0], March(other, settings_for(other, **SETTINGS)))
    told = xd.compare(runs[0], xd.simulate(other, **SETTINGS)).attrs
    assert told["identical"] == 0
    assert [line.partition(":")[0] for line in told["parameters"].splitlines()] == ["d"]


@pytest.mark.parametrize("pair", [(MODEL, NUMBERED), (NUMBERED, MODEL)])
def test_a_run_goes_on_by_the_other_text(
    pair: tuple[xd.Model, xd.Model], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert that segments of a run that broke off are resumed by either text, to the same rows, from where it was."""
    monkeypatch.setattr(segments, "EVERY", 0.0)
    monkeypatch.setattr(segments, "SHARE", 0.0)
    monkeypatch.setattr(segments.Segments, "patience", float("inf"))
    monkeypatch.setattr("xdynamics.archive.segments.BLOCK_ROWS", 100)
    path, asked = tmp_path / "run.nc", SETTINGS | {"until": "10 s"}

    def cut(_done: float, t: float, _rows: int) -> None:
        if t > 6.0:
            raise KeyError

    with pytest.raises(KeyError):
        xd.simulate(pair[0], **asked, path=path, progress=cut)
    seen: list[float] = []
    run = xd.simulate(pair[1], **asked, path=path, resume=True, progress=lambda _done, t, _rows: seen.append(t))
    assert min(seen) > 4.0
    np.testing.assert_array_equal(run.u, xd.simulate(pair[0], **asked).u)
    run.close()
    before = path.stat()
    xd.simulate(pair[0], **asked, path=path, resume=True).close()  # which is over: nothing is marched
    assert path.stat() == before
    assert xd.reproduce(path).attrs["identical"] == 1


@pytest.mark.parametrize("pair", [(MODEL, NUMBERED), (NUMBERED, MODEL)])
def test_members_are_added_by_the_other_text(pair: tuple[xd.Model, xd.Model], tmp_path: Path) -> None:
    """Assert that members of one text stay, and that all have the numbers of those marched at once."""
    asked = {"until": "0.1 s", "step": "0.01 s", "method": "heun", "keep": ["end", "log"]}
    xd.sweep(pair[0], {"k[2]": [1.0, 7.0]}, path=tmp_path, **asked).close()
    files = {file: file.stat().st_mtime_ns for file in tmp_path.rglob("*.nc") if file.name != "catalogue.nc"}
    added = xd.sweep(pair[1], {"k[2]": [1.0, 7.0, 9.0]}, path=tmp_path, **asked)
    assert len(files) == 2
    assert all(file.stat().st_mtime_ns == then for file, then in files.items())
    np.testing.assert_array_equal(
        added.end_u, xd.sweep(pair[1], {"k[2]": [1.0, 7.0, 9.0]}, **asked | {"keep": "end"}).end_u
    )
    own = xd.member(added, **{"k[2]": 7.0})
    assert own.model_toml.values.item() == pair[0].to_toml()
    with pytest.raises(xd.InputError, match="its model is another"):
        xd.sweep(pair[1].replace(parameters={"d[1]": 0.6}), {"k[2]": [1.0, 7.0]}, path=tmp_path, **asked)


def test_one_element_is_fitted_and_budgeted() -> None:
    """Assert that the model of a fit has the numbers, that of a budget all as given, and that the fit finds its number."""
    run = xd.simulate(MODEL.replace(parameters={"k[2]": 7.5}), **SETTINGS)
    found = xd.fit(MODEL, run[["time", "u"]], ["k[2]"], **SETTINGS)
    assert found.estimate.item() == pytest.approx(7.5, rel=1e-7)
    fitted = xd.Model.from_text(found.model_toml.values.item())
    assert fitted.parameters["k·2"].quantity.value == found.estimate.item()
    assert "[" in lines(fitted, "k").partition('"value"')[2]
    assert [lines(fitted, name) for name in "cd"] == [lines(MODEL, name) for name in "cd"]
    budget = xd.error_budget(MODEL, "u[2]", at="0.1 s", **SETTINGS)
    assert budget.model_toml.values.item() == MODEL.to_toml()


def test_values_by_label_in_two_dimensions() -> None:
    """Assert tables in a table, lists and one number in it, in the order of the labels."""
    model = xd.Model.from_text(LINKS.replace("k*norm", "newton/metre*norm"))
    assert [model.parameters[f"m·{at}·{axis}"].quantity.value for at in "abc" for axis in "xy"] == [1, 2, 3, 3, 5, 6]
    assert [model.initial[f"r·{at}·{axis}"].value for at in "abc" for axis in "xy"] == [0, 1, 2, 3, 4, 4]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "",
            "",
            r"name 'k' is not declared; table 'bonds.csv' of relation 'bond' has the columns first, second, k: write",
        ),
        ("{ x = ", "{ z = ", "parameter 'm': values has 'z', no element of 'axis'"),
        (', y = "2 kg"', "", "parameter 'm': values lacks y; give one for each element of 'axis'"),
        ("[5, 6]", "[5, 6, 7]", "parameter 'm': value has 3 along 'axis', needs 2 elements"),
        (", c = 4", "", "initial value 'r': values lacks c; give one for each element of 'site'"),
        ('b = "3 kg"', 'b = "3 s"', "parameter 'm': has '3 s' beside values in 'kg'"),
    ],
)
def test_wrong_tables_are_told(old: str, new: str, said: str) -> None:
    """Assert that each names the label or the column, and what is needed."""
    with pytest.raises(xd.ModelError, match=said):
        xd.Model.from_text(LINKS.replace(old, new) if old else LINKS)

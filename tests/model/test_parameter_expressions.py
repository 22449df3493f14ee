"""Values for elements stay in a model's text as they were given, and are the same model as their numbers.

Values at the start that follow parameters: swept, fitted and budgeted with them, slopes included.
What is said of values and uncertainties that were meant as expressions of the element.
"""

from __future__ import annotations

import re
from math import cos, pi, sin
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
    """Assert numbers for all elements, those of the record, which stay numbers where the element has its own again."""
    other = MODEL.replace(parameters={name: value})
    assert "[" in lines(other, name[0]).partition('"value"')[2]
    assert {key for key in "kcdu" if lines(other, key) != lines(MODEL, key)} == {name[0]}
    assert xd.Model.from_text(other.to_toml()) == other
    again = other.replace(parameters={name: MODEL.parameters[name].quantity.value})
    assert again.parameters == MODEL.parameters
    assert again == xd.Model.from_text(other.to_toml()).replace(
        parameters={name: again.parameters[name].quantity.value}
    )


def test_the_start_of_an_element_makes_numbers() -> None:
    """Assert that the start of one element is written out alone."""
    other = MODEL.replace(initial={"u[1]": 0.2})
    assert '"value" = [0.1, 0.2, 0.1, 0.1, 0.1]' in lines(other, "u")
    assert lines(other, "v_u") == lines(MODEL, "v_u")
    assert other.replace(initial={"u[1]": 0.1}).initial == MODEL.initial
    faster = MODEL.replace(initial={"v_u[1]": 0.2})
    assert xd.Model.from_text(faster.to_toml()).initial["v_u[1]"].value == 0.2


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


SPRING = """
name = "spring"
[coordinates]
x = "m"
[parameters]
v0 = "2.0 ± 0.1 m s-1"
L = "0.5 ± 0.01 m"
phi0 = "30 ± 1 degree"
[mass]
x = "1*kilogram"
[forces.spring]
x = "-4*newton/metre*x"
[states.charge]
unit = "C"
rate = "-charge/second"
[initial]
t = "0 s"
x = "L*sin(phi0)"
v_x = "v0"
charge = "3*coulomb*L/metre"
"""
START_SETTINGS = {"method": "dop853", "rtol": 1e-12, "until": "1.1 s"}


def spring(**parameters: str) -> xd.Model:
    """A mass on a spring, of 2 rad s-1, with a start that follows parameters."""
    return xd.Model.from_text(SPRING).replace(parameters=parameters)


def test_the_start_follows() -> None:
    """Assert values at the start of the model, of one with another parameter, and of one read again."""
    run = xd.simulate(spring(), method="rk4", step="10 ms", until="0.1 s")
    assert [float(run[name][0]) for name in ("x", "v_x", "charge")] == pytest.approx([0.25, 2.0, 1.5], rel=1e-15)
    other = spring(L="1 m", v0="36 km h-1")
    run = xd.simulate(other, method="rk4", step="10 ms", until="0.1 s")
    assert [float(run[name][0]) for name in ("x", "v_x", "charge")] == pytest.approx([0.5, 10.0, 3.0], rel=1e-15)
    assert xd.Model.from_text(other.to_toml()) == other


@pytest.mark.parametrize(
    ("name", "slope"),
    [
        ("v0", sin(2.0) / 2.0),
        ("L", cos(2.0) * sin(pi / 6.0)),
        ("phi0", cos(2.0) * 0.5 * cos(pi / 6.0)),
    ],
)
def test_slopes_follow_too(name: str, slope: float) -> None:
    """Assert slopes of a budget at 1 s by the closed form, from variational equations."""
    budget = xd.error_budget(spring(), quantity="x", at="1 s", **START_SETTINGS)
    term = budget.isel(term=list(budget.term_name.values).index(name))
    assert str(term.term_rule.values).startswith("slope by variational equations")
    assert float(term.sensitivity) == pytest.approx(slope, rel=1e-10)  # of SI units


def test_members_and_fits_start_by_their_own() -> None:
    """Assert ends of a sweep over what the start follows, by the closed form."""
    sweep = xd.sweep(spring(), axes={"L": ["0.5 m", "1 m"]}, keep=["end"], method="dop853", rtol=1e-12, until="1 s")
    assert sweep.end_x.values == pytest.approx([length / 2 * cos(2.0) + sin(2.0) for length in (0.5, 1.0)], rel=1e-10)


def test_a_start_is_fitted_through_its_parameter(tmp_path: Path) -> None:
    """Assert that a length comes back from positions of the closed form."""
    times = np.linspace(0.0, 1.0, 12)
    rows = "".join(f"{t!r},{0.35 * cos(2 * t) + sin(2 * t)!r}\n" for t in times.tolist())
    (tmp_path / "x.csv").write_text(f"time [s],x [m]\n{rows}")
    fitted = xd.fit(spring(), tmp_path / "x.csv", ["L"], **START_SETTINGS)
    assert float(fitted.estimate[0]) == pytest.approx(0.7, rel=1e-9)


@pytest.mark.parametrize(
    ("start", "fault"),
    [
        ('x = "L*phi0/second"', "initial value of 'x'"),
        ('x = "v_x*second"', "a value at the start is of parameters"),
        ('x = "w"', "'w'"),
        ('x = "L*sin("', "x"),
    ],
)
def test_a_wrong_start_is_told(start: str, fault: str) -> None:
    """Assert one error that names the value."""
    with pytest.raises(xd.ModelError) as caught:
        xd.Model.from_text(SPRING.replace('x = "L*sin(phi0)"', start))
    assert fault in str(caught.value)


CHAIN_OF_VALUES = """
name = "chain"
[dimensions]
site = 5
[coordinates]
u = {{ unit = "m", dims = ["site"] }}
[parameters]
k = "1 N m-1"
c = {entry}
[mass]
u = "1*kilogram"
[forces.spring]
u = "-k*u"
[initial]
u = "{start}"
"""
OF_SITES = '{{ dims = ["site"], {} }}'


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        (
            OF_SITES.format('value = "2*index(site"'),
            "expression '2*index(site' cannot be read at column 13: ')' is missing",
        ),
        (OF_SITES.format('value = "twice(index(site))"'), "function 'twice' is not known"),
        (
            OF_SITES.format('value = "1/index(site)"'),
            "model 'chain': parameter 'c': '1/index(site)' is inf at c[0], and needs finite numbers; index counts from 0",
        ),
        (OF_SITES.format('value = "log(3 - index(site))"'), "'log(3 - index(site))' is -inf at c[3], and needs finite"),
        (
            OF_SITES.format('value = "2*index(site)", uncertainty = "0.1*index(site)"'),
            "uncertainty is the expression '0.1*index(site)'; write one number with a unit for all elements, or a list",
        ),
        (
            OF_SITES.format('value = [1, 2, 3, 4, 5], half_width = "0.1*index(site"'),
            "half_width is the expression '0.1*index(site'; write one number",
        ),
        (
            '"2*k"',
            "'2*k' is an expression, needs a number with a unit, like '0.145 kg'; what follows from parameters is a",
        ),
        ('{ value = "1 N", uncertainty = "0.1*k" }', "uncertainty: quantity '0.1*k' has '*' after its number; write a"),
    ],
)
def test_expressions_that_are_no_values_are_named(entry: str, message: str) -> None:
    """Assert what is said of brackets, functions, numbers that are infinite, and sizes by expression."""
    with pytest.raises(xd.InputError, match=re.escape(message)):
        xd.Model.from_text(CHAIN_OF_VALUES.format(entry=entry, start="0 m"))


def test_an_open_bracket_at_the_start_is_named() -> None:
    """Assert that a start that is meant as an expression is read as one."""
    with pytest.raises(
        xd.InputError, match=re.escape("initial value 'u': expression '2*index(site*metre' cannot be read")
    ):
        xd.Model.from_text(CHAIN_OF_VALUES.format(entry='"1 N"', start="2*index(site*metre"))


def test_the_largest_of_all_elements_is_read_at_the_start() -> None:
    """Assert that `max` and `min` along a dimension are read in starts and values, as `sum` is."""
    wrap = "cos(0.3*index(site))"
    text = CHAIN_OF_VALUES.format(
        entry='{ dims = ["site"], value = "(1 + index(site))/max(1 + index(site), site)" }',
        start=f"metre*{wrap}/max({wrap}, site)*min(c, site)",
    )
    start = xd.simulate(xd.Model.from_text(text), method="rk4", step=0.1, until=0.1).u.values[0]
    found = np.cos(0.3 * np.arange(5))
    np.testing.assert_allclose(start, found / found.max() / 5.0, rtol=1e-15)

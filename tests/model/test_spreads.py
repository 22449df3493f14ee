"""What a model says of how far its numbers may be off: read, checked, written back, drawn."""

from __future__ import annotations

from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.stats
import xarray as xr

import xdynamics as xd
from xdynamics.model.uncertainty import Spread, normal_quantile
from xdynamics.units import parse_quantity

TOML = """
name = "uncertain"
[coordinates]
x = "m"
[parameters]
m = { value = "1 kg", uncertainty = "2 g" }
k = { value = 4, unit = "N m-1", half_width = 0.3, description = "spring" }
c = { value = "0.1 N s m-1", uncertainty = 0.01, distribution = "t", degrees_of_freedom = 9 }
p = { value = "1 m", half_width = "1 cm", distribution = "arcsine" }
q = { value = "1 m", half_width = "1 cm", distribution = "triangular" }
[mass]
x = "m"
[forces]
spring = { x = "-k*x" }
damping = { x = "-c*v_x" }
drive = { x = "push" }
[drives.push]
table = "push.csv"
csv = '''
t [s],push [N],u(push) [mN]
0,1,20
10,2,30
'''
[initial]
x = { value = "1 m", uncertainty = "3 mm", description = "as released" }
v_x = "0 m s-1"
[observables]
stretch = "x - p"
[correlations]
m = { x = 0.5 }
[discrepancy]
x = { standard = "1 mm", description = "the table is not quite level" }
stretch = "2 mm"
t = "1 ms"
[run]
method = "rk4"
step = "10 ms"
until = "1 s"
"""


def model(**replaced: str) -> xd.Model:
    """The model above, a line replaced."""
    text = TOML
    for old, new in replaced.items():
        text = text.replace(next(line for line in TOML.split("\n") if line.startswith(f"{old} =")), f"{old} = {new}")
    return xd.Model.from_text(text)


PARSEC = 3.0856775814913673e16  # m; IAU 2015, resolution B2, note 4


def with_parameter(entry: dict[str, Any]) -> xd.Model:
    """Return a model of two sites with a parameter p that nothing reads."""
    return xd.Model(
        name="scales",
        dimensions={"site": 2},
        coordinates={"x": {"unit": "m", "dims": ["site"]}},
        parameters={"m": "1 kg", "p": entry},
        mass={"x": "m"},
        initial={"x": "0 m", "v_x": "0 m s-1"},
    )


def test_standard_uncertainties_follow_from_bounds() -> None:
    """Assert JCGM 101:2008, 6.4: half widths over the square roots of 3, 6 and 2; correlations, discrepancies, tables."""
    found = {name: value.uncertainty for name, value in model().uncertain.items()}
    assert found == pytest.approx(
        {"m": 2e-3, "k": 0.3 / sqrt(3), "c": 0.01, "p": 0.01 / sqrt(2), "q": 0.01 / sqrt(6), "x": 3e-3}
    )
    assert model().correlations == {("m", "x"): 0.5}
    assert {name: value.standard.si for name, value in model().discrepancy.items()} == {
        "x": 1e-3,
        "stretch": 2e-3,
        "t": 1e-3,
    }
    doubt = model().drives["push"].table.uncertainty
    assert doubt is not None
    assert doubt.tolist() == [0.02, 0.03]
    assert model().initial["x"].si == 1.0


def test_what_is_said_is_written_back() -> None:
    """Assert that a model read from its own text is the same, and that no program knows of uncertainties."""
    one = model()
    assert xd.Model.from_text(one.to_toml()) == one
    assert xd.Model.from_text(one.to_toml()).elements.starts == one.elements.starts
    bare = {"m": '"1 kg"', "k": '"4 N m-1"', "x": '"1 m"'}
    assert (
        one.form
        == xd.Model.from_text(
            TOML.replace('m = { value = "1 kg", uncertainty = "2 g" }', f"m = {bare['m']}").replace(
                "m = { x = 0.5 }", ""
            )
        ).form
    )
    changed = one.replace(parameters={"k": 5.0}, initial={"x": 2.0})
    assert (changed.parameters["k"].uncertainty, changed.starts["x"].uncertainty) == pytest.approx(
        (0.3 / sqrt(3), 3e-3)
    )
    assert (changed.initial["x"].si, changed.starts["x"].description) == (2.0, "as released")


@pytest.mark.parametrize(
    ("key", "text", "said"),
    [
        ("m", '{ value = "1 kg", uncertainty = "2 s" }', "uncertainty is in 's', the value in 'kg'"),
        ("m", '{ value = "1 kg", uncertainty = -1 }', "needs to be non-negative"),
        ("m", '{ value = "1 kg", uncertainty = 1, half_width = 2 }', "write one"),
        ("m", '{ value = "1 kg", distribution = "normal" }', "no uncertainty or half_width"),
        ("m", '{ value = "1 kg", half_width = 1, distribution = "normal" }', "has no bounds"),
        ("m", '{ value = "1 kg", uncertainty = 1, distribution = "cauchy" }', "there are normal, rectangular"),
        ("c", '{ value = "1 N s m-1", uncertainty = 1, distribution = "t" }', "degrees_of_freedom is None"),
        ("c", '{ value = "1 N s m-1", uncertainty = 1, distribution = "t", degrees_of_freedom = 2 }', "over 2"),
        ("k", '{ value = "4 N m-1", uncertainty = 1, degrees_of_freedom = 9 }', "has none"),
        ("stretch", '"2 kg"', "standard has units 'kg', needs 'm'"),
        ("t", '"-1 ms"', "needs to be non-negative"),
    ],
)
def test_contradictions_are_named(key: str, text: str, said: str) -> None:
    """Assert one clear error for each."""
    old = '"2 mm"' if key == "stretch" else '"1 ms"' if key == "t" else None
    with pytest.raises(xd.ModelError, match=said):
        xd.Model.from_text(TOML.replace(f"{key} = {old}", f"{key} = {text}")) if old else model(**{key: text})


@pytest.mark.parametrize(
    ("correlations", "said"),
    [
        ("m = { k = 0.5 }", "'k', which is rectangular"),
        ("m = { v_x = 0.5 }", "'v_x', which is no parameter or initial value with an uncertainty"),
        ("m = { m = 0.5 }", "a number with itself"),
        ("m = { x = 1.5 }", "no number from -1 to 1"),
        ("m = { x = 0.5 }\nx = { m = 0.5 }", "are there twice"),
        ("m = 0.5", "must be a table"),
    ],
)
def test_correlations_that_cannot_be_are_named(correlations: str, said: str) -> None:
    """Assert one clear error for each."""
    with pytest.raises(xd.ModelError, match=said):
        xd.Model.from_text(TOML.replace("m = { x = 0.5 }", correlations))


def test_correlations_that_contradict_each_other_are_refused() -> None:
    """Assert that three numbers cannot each be against both others."""
    text = TOML.replace(
        'k = { value = 4, unit = "N m-1", half_width = 0.3', 'k = { value = 4, unit = "N m-1", uncertainty = 0.3'
    )
    with pytest.raises(xd.ModelError, match="contradict each other"):
        xd.Model.from_text(text.replace("m = { x = 0.5 }", "m = { x = -0.9, k = -0.9 }\nx = { k = -0.9 }"))


def test_tables_with_uncertainties(tmp_path: Path) -> None:
    """Assert that a third column is the second's, by name and unit, and that wide tables keep it with its own."""
    for header, row, said in [
        ("t [s],push [N],u(pull) [N]", "0,1,1", "has 2 columns of values"),
        ("t [s],push [N],u(push) [m]", "0,1,1", "uncertainties are in 'm'"),
        ("t [s],push [N],u(push) [N]", "0,1,-1", "the uncertainty -1.0 is negative"),
        ("t [s],push [N],u(push) [N]", "0,1", "has 2 cells, the header 3"),
    ]:
        with pytest.raises(xd.ModelError, match=said):
            xd.Model.from_text(TOML.replace("t [s],push [N],u(push) [mN]", header).replace("0,1,20", row))
    wide = tmp_path / "wide.csv"
    wide.write_text("t [s],one [N],u(one) [mN],two [N]\n0,1,20,3\n10,2,30,4\n")
    found = xd.sweep(model(), {"push": wide})
    assert found["push"].values.tolist() == ["one", "two"]
    assert found["push_table"].values.tolist()[0] == "t [s],one [N],u(one) [mN]\n0,1,20\n10,2,30\n"


def test_quantiles_are_those_of_scipy() -> None:
    """Assert the normal quantile to 1e-14 from 1e-300 on, and every distribution's against scipy's."""
    points = np.concatenate([np.random.default_rng(0).random(10_000), 10.0 ** -np.linspace(1, 300, 1000)])
    assert normal_quantile(points) == pytest.approx(scipy.stats.norm.ppf(points), rel=1e-14, abs=1e-16)
    inner = np.linspace(0.001, 0.999, 999)
    known: dict[str, Any] = {
        "rectangular": scipy.stats.uniform(-sqrt(3), 2 * sqrt(3)),
        "triangular": scipy.stats.triang(0.5, -sqrt(6), 2 * sqrt(6)),
        "arcsine": scipy.stats.arcsine(-sqrt(2), 2 * sqrt(2)),
        "t": scipy.stats.t(9, scale=sqrt(7 / 9)),
    }
    for name, right in known.items():
        freedom = 9.0 if name == "t" else None
        one = Spread(parse_quantity("1 m"), name, bounded=False, degrees_of_freedom=freedom)
        assert one.quantiles(inner) == pytest.approx(right.ppf(inner), rel=1e-12, abs=1e-12)
        assert right.std() == pytest.approx(1.0)


@pytest.mark.dear
def test_draws_are_those_that_the_model_declares() -> None:
    """Assert means, deviations, correlations and bounds of what is drawn, and that the seed decides."""
    names = ["m", "k", "c", "p", "q", "x"]
    draws = xd.Draws(40_000, names, design="declared", seed=4)
    found = xd.sweep(model(), {"draw": draws}, until="20 ms", step="10 ms")
    values = {name: found[f"initial_{name}" if name == "x" and "initial_x" in found else name].values for name in names}
    for name, value in model().uncertain.items():
        assert values[name].mean() == pytest.approx(value.quantity.value, abs=5 * value.uncertainty / 200)
        assert values[name].std() == pytest.approx(value.uncertainty, rel=0.02)
    assert np.corrcoef(values["m"], values["x"])[0, 1] == pytest.approx(0.5, abs=0.02)
    assert abs(np.corrcoef(values["m"], values["k"])[0, 1]) < 0.02
    assert np.abs(values["k"] - 4.0).max() <= 0.3
    again = xd.sweep(model(), {"draw": draws}, until="20 ms", step="10 ms")
    assert again.k.values.tolist() == values["k"].tolist()
    with pytest.raises(xd.InputError, match="'v_x' has no uncertainty"):
        xd.sweep(model(), {"draw": xd.Draws(8, ["v_x"], design="declared")})


BONDS = "bond,k [N/m],u(k) [mN/m]\n1,20,1000\n0,10,500\n2,5,0\n"
TRIANGLE = f"""
name = "triangle"
[dimensions]
body = ["A", "B", "C"]
axis = ["x", "y"]
[relations.bond]
of = "body"
[coordinates]
r = {{ unit = "m", dims = ["body", "axis"] }}
[parameters]
k = {{ dims = ["bond"], table = "bonds.csv", csv = {BONDS!r} }}
[mass]
r = "1*kilogram"
[forces.bonds]
over = "bond"
potential = "0.5*k*(norm(second(r, bond) - first(r, bond), axis) - 1*metre)**2"
[initial]
r = {{ table = "start.csv", columns = ["x", "y"], csv = "x [m],y [mm],u(y) [um]\\n0,0,10\\n2,0,20\\n1,1000,30\\n" }}
""".replace("'bond,", '"bond,').replace("2,5,0\\n'", '2,5,0\\n"')


def test_tables_of_elements_have_uncertainties_beside_the_values() -> None:
    """Assert that u(k) goes with its row and unit, that a column without has none, and that both are written back."""
    model = xd.Model.from_text(TRIANGLE)
    assert xd.Model.from_text(model.to_toml()) == model
    found = [value.uncertainty for value in model.uncertain.values()]  # of k, then of y by bodies
    assert found == pytest.approx([0.5, 1.0, 1e-5, 2e-5, 3e-5], abs=1e-20)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            'dims = ["bond"]',
            'dims = ["bond"], uncertainty = 1',
            r"has uncertainty, and table 'bonds.csv' has a column 'u\(k\)'",
        ),
        ("u(k) [mN/m]", "u(k) [mN]", r"column 'u\(k\)' is in 'mN', the first in 'N m-1'"),
        (
            "u(k)",
            "u_common(k)",
            r"a column 'u_common\(k\)', which drives alone have; what is common to all elements is a",
        ),
        ("0,10,500", "0,10,-500", "needs to be non-negative"),
        ("0,10,500", "0,10,", r"column 'u\(k\) \[mN/m\]' has a gap"),
    ],
)
def test_wrong_uncertainties_of_elements_are_refused(old: str, new: str, said: str) -> None:
    """Assert that a size too many, in another unit, of all together, negative or left out is refused."""
    assert old in TRIANGLE
    with pytest.raises(xd.ModelError, match=said):
        xd.Model.from_text(TRIANGLE.replace(old, new))


@pytest.mark.parametrize(
    ("entry", "values", "sizes"),
    [
        ({"value": [1.0, 2], "unit": "pc", "uncertainty": [0.5, 1]}, (PARSEC, 2 * PARSEC), (PARSEC / 2, PARSEC)),
        ({"value": [1.0, 2], "unit": "kpc", "uncertainty": 1}, (1e3 * PARSEC, 2e3 * PARSEC), (1e3 * PARSEC,) * 2),
        ({"value": ["1 pc", 2.0], "unit": "pc", "half_width": ["1 pc", "1 m"]}, (PARSEC, 2 * PARSEC), (PARSEC, 1.0)),
        ({"values": {0: 1.0, 1: 2.0}, "unit": "pc", "uncertainty": "1 m"}, (PARSEC, 2 * PARSEC), (1.0, 1.0)),
        ({"value": [20.0, 21], "unit": "°C", "uncertainty": ["0.5 °C", 1]}, (293.15, 294.15), (0.5, 1.0)),
        ({"value": ["20 °C", "21 °C"], "uncertainty": ["0.5 °C", "1 K"]}, (293.15, 294.15), (0.5, 1.0)),
    ],
)
def test_elements_are_given_on_scales(
    entry: dict[str, Any], values: tuple[float, ...], sizes: tuple[float, ...]
) -> None:
    """Assert that a list may be in what one value may be in, its bare uncertainties too, of which an offset is no part."""
    model = with_parameter({"dims": ["site"], **entry})
    parts = [part for name, part in model.parameters.items() if name.startswith("p")]
    assert tuple(part.quantity.si for part in parts) == values
    assert tuple(part.spread.size.si for part in parts if part.spread) == sizes
    assert xd.Model.from_text(model.to_toml()) == model


def test_a_bare_uncertainty_is_on_the_scale_of_its_value() -> None:
    """Assert that a tenth beside one parsec is a tenth of it, and no tenth of a metre."""
    part = with_parameter({"value": 1.0, "unit": "pc", "uncertainty": 0.5}).parameters["p"]
    assert part.spread is not None
    assert (part.quantity.si, part.spread.size.si) == (PARSEC, PARSEC / 2)


MASSES = """
name = "masses on springs"
dimensions = { site = 3 }
coordinates = { u = { unit = "m", dims = ["site"] } }
parameters = { m = { dims = ["site"], value = [1, 2, 3], unit = "kg" }, k = "10 N m-1", A = "0.5 m" }
mass = { u = "m" }
forces = { springs = { u = "-k*u" } }
initial = { u = "A*m/kilogram" }
run = { method = "dop853", rtol = 1e-10, until = "1 s" }
"""
T5 = {"value": "1 kg", "uncertainty": "0.1 kg", "distribution": "t", "degrees_of_freedom": 5}
HALF = {"value": "1 kg", "half_width": "10 g"}


@pytest.mark.parametrize(
    "replaced",
    [
        {"m[1]": "2000 ± 100 g"},
        {"m[1]": "2 ± 0.1 kg", "m[2]": "3 kg ± 20 g"},
        {"m[0]": HALF, "m[1]": HALF},
        {"m[0]": HALF, "m[1]": "2 ± 0.1 kg"},
        {"m[0]": HALF | {"distribution": "triangular"}, "m[2]": HALF},
        {"m[0]": T5, "m[2]": "3 ± 0.2 kg"},
        {"m[0]": "1 ± 0.1 kg", "m[1]": "2 ± 0.1 kg", "m[2]": "3 ± 0.1 kg"},
    ],
)
def test_each_element_has_its_own_uncertainty(replaced: dict[str, Any], tmp_path: Path) -> None:
    """Assert kind, unit and distribution of each in the text, which reads back as the same model, and in an archive."""
    model = xd.Model.from_text(MASSES).replace(parameters=replaced)
    again = xd.Model.from_text(model.to_toml())
    assert again == model
    parts, known = again.elements.statement.parameters, model.elements.statement.parameters
    for name in ("m·0", "m·1", "m·2"):
        assert parts[name] == known[name]
    standards = {"m[0]": 0.01 / 3.0**0.5 if replaced.get("m[0]") == HALF else None, "m[1]": 0.1}
    for name, standard in standards.items():
        if isinstance(replaced.get(name), str) or (name == "m[0]" and standard):
            assert known[model.shapes.internal_name(name)].uncertainty == pytest.approx(standard or 0.1, rel=1e-15)
    xd.save(xd.simulate(model), tmp_path / "run.nc")
    assert xd.reproduce(tmp_path / "run.nc").attrs["identical"] == 1


def test_expressions_at_the_start_follow_before_elements_are_replaced() -> None:
    """Assert that of a start by an expression other elements have the new parameters, in one replacement or in two."""
    model = xd.Model.from_text(MASSES)
    both = model.replace(parameters={"m[1]": "5 kg"}, initial={"u[0]": "1 m"})
    in_turn = model.replace(parameters={"m[1]": "5 kg"}).replace(initial={"u[0]": "1 m"})
    for one in (both, in_turn):
        assert [one.initial[f"u[{i}]"].value for i in range(3)] == [1.0, 2.5, 1.5]
    assert both == in_turn
    assert model.replace(initial={"v_u[1]": "0 m s-1"}) == model


def test_replaced_elements_keep_their_dimension() -> None:
    """Assert that numbers with another dimension are refused, and that those without unit have that of the entry."""
    grams = xd.Model.from_text(MASSES.replace("[1, 2, 3]", "[1000, 2000, 3000]").replace('"kg" }, k', '"g" }, k'))
    part = grams.replace(parameters={"m[0]": "700 ± 5"}).elements.statement.parameters["m·0"]
    assert (part.si, part.uncertainty, part.quantity.unit.text) == (0.7, 5.0, "g")
    for value in ("7 ± 1 s", {"value": 7, "unit": "s"}, {"value": "7 s", "uncertainty": "1 s"}):
        with pytest.raises(xd.ModelError, match=r"parameter 'm\[0\]': has units 's', needs 'kg'"):
            grams.replace(parameters={"m[0]": value})
    number = xr.DataArray(0.25, attrs={"units": "kg"})
    assert grams.replace(parameters={"m[0]": number}).elements.statement.parameters["m·0"].si == 0.25
    assert grams.replace(parameters={"A": xr.DataArray(7.0, attrs={"units": "mm"})}).parameters["A"].si == 0.007


@pytest.mark.parametrize(("value", "size"), [([1, 2, 4], 0.01), ("2 kg", 0.01), ("2 ± 0.3 kg", 0.3)])
def test_a_replaced_quantity_keeps_its_uncertainty(value: Any, size: float) -> None:
    """Assert that of all elements together, as of a number, the uncertainty stays unless there is another."""
    model = xd.Model.from_text(MASSES.replace('unit = "kg" }, k', 'unit = "kg", uncertainty = "10 g" }, k'))
    parts = model.replace(parameters={"m": value}).elements.statement.parameters
    assert [parts[f"m·{i}"].uncertainty for i in range(3)] == [size] * 3


def test_an_array_with_a_unit_is_on_no_other_scale() -> None:
    """Assert that kelvins stay kelvins where the file has degrees Celsius, and that a bare number is one of these."""
    room = xd.Model.from_text(MASSES.replace('A = "0.5 m"', 'A = "0.5 m", T = "20 degC"'))
    for value, kelvins in (
        (25.0, 298.15),
        (xr.DataArray(25.0), 298.15),
        (xr.DataArray(298.0, attrs={"units": "K"}), 298.0),
    ):
        assert room.replace(parameters={"T": value}).parameters["T"].si == pytest.approx(kelvins, rel=1e-15)


def test_distributions_are_nested_as_the_values_are() -> None:
    """Assert that lists of distributions have one for each element, in the dimensions of the quantity."""
    text = MASSES.replace(
        'unit = "kg" }, k', 'unit = "kg", uncertainty = ["1 g", "2 g", "3 g"], distribution = {} }, k'
    )
    parts = xd.Model.from_text(
        text.replace("{} }", '["normal", "triangular", "normal"] }')
    ).elements.statement.parameters
    assert [parts[f"m·{i}"].spread.distribution for i in range(3)] == ["normal", "triangular", "normal"]
    for wrong, said in (
        ('["normal", "triangular"]', "distribution has 2 along 'site', needs 3"),
        ('[["normal"]]', "has 1 along"),
    ):
        with pytest.raises(xd.ModelError, match=said):
            xd.Model.from_text(text.replace("{} }", wrong + " }"))

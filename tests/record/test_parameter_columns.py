"""Parameters with dimensions in a record, made whole: as they are made of their elements."""

from __future__ import annotations

import pytest

import xdynamics as xd
from xdynamics.record import folded_columns
from xdynamics.units.unit import Rounded

MODEL = """
name = "three bodies"
[dimensions]
b = ["first_one", "other", "last"]
axis = ["x", "y"]
[coordinates]
r = { unit = "m", dims = ["b", "axis"] }
[parameters]
m = { dims = ["b"], values = { first_one = "1 g", other = "0.10000000000000000123456 g", last = "3 g" }, description = "masses" }
w = { dims = ["b", "axis"], value = "(1 + 0.1*index(b) + index(axis))*gram" }
u = { dims = ["b"], value = [1, 2, 3], unit = "km", uncertainty = "1 m" }
k = "0.1 N m-1"
[mass]
r = "m + w"
[forces.spring]
r = "-k*r"
[initial]
r = "metre*(1 + index(b))"
v_r = "0*metre/second"
"""


def test_parameters_whole_are_those_of_their_elements(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that variables and values are the same, to the bit, without the short way."""
    found = []
    for _ in range(2):
        model = xd.Model.from_text(MODEL)
        entries = folded_columns.parameter_variables(model)
        values = [(variable, variable.attributes, getattr(value, "tolist", float)()) for variable, value in entries]
        found.append(values)
        monkeypatch.setattr(folded_columns, "parameter_numbers", lambda *_: None)
    assert found[0] == found[1]
    assert [variable.dims for variable, *_ in found[0]] == [(), ("b",), ("b", "axis"), ("b",)]


def test_elements_keep_the_digits_beyond_a_float() -> None:
    """Assert that a parameter by label is as exact as one by itself."""
    model = xd.Model.from_text(MODEL)
    single = xd.Model.from_text(MODEL.replace('k = "0.1 N', 'k = "0.10000000000000000123456 N'))
    by_label, alone = model.parameters["m·other"].quantity.value, single.parameters["k"].quantity.value
    assert isinstance(by_label, Rounded)
    assert isinstance(alone, Rounded)
    assert by_label.exact == alone.exact


def test_an_uncertainty_says_which_one_it_is() -> None:
    """Assert the standard uncertainty of each distribution, its unit, and the width between bounds where that is stated."""
    model = xd.Model.from_text(
        """
        name = "Spring"
        coordinates.x = "m"
        mass.x = "m"
        forces.spring.x = "-k*x"
        forces.pull.x = "a*c"
        initial = { x = "1 m", v_x = "0 m s-1" }
        [parameters]
        m = "0.5 ± 0.005 kg"
        k = { value = "3 N m-1", half_width = "30 N km-1" }
        a = { value = "2 N", uncertainty = 0.1, distribution = "t", degrees_of_freedom = 9 }
        c = 1.0
        """
    )
    run = xd.simulate(model, method="rk4", step="10 ms", until="0.1 s")
    said = {
        name: {word: value for word, value in run[name].attrs.items() if word.startswith("uncertainty")}
        for name in "mkac"
    }
    assert said["m"] == {
        "uncertainty": 0.005,
        "uncertainty_kind": "standard",
        "uncertainty_units": "kg",
        "uncertainty_distribution": "normal",
    }
    assert said["k"] == {
        "uncertainty": pytest.approx(0.03 / 3**0.5, rel=1e-15),
        "uncertainty_kind": "standard",
        "uncertainty_units": "N m-1",
        "uncertainty_distribution": "rectangular",
        "uncertainty_half_width": pytest.approx(0.03, rel=1e-15),
    }
    assert said["a"]["uncertainty_distribution"] == "t"
    assert said["a"]["uncertainty_degrees_of_freedom"] == 9.0
    assert said["c"] == {}

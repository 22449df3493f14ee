"""What a model says of its own sections: by the names of its file, and never changed in place."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.faults import DOT
from xdynamics.model import Model


@pytest.fixture(scope="module")
def planets() -> Model:
    """Return a model with labels along both dimensions."""
    return Model.from_toml(MODELS / "outer_solar_system.toml")


@pytest.mark.parametrize("name", ["outer_solar_system", "heat", "bicycle", "rough_pile", "kepler"])
def test_sections_have_the_names_of_the_file(name: str) -> None:
    """Assert one entry with its dimensions for what moves, and one for each number, in as many as are marched."""
    model = Model.from_toml(MODELS / f"{name}.toml")
    whole = {**model.coordinates, **model.states}
    assert {own: part.dims for own, part in whole.items()} == {own: model.shapes.dims.get(own, ()) for own in whole}
    assert sum(len(model.shapes.elements(own)) for own in whole) == sum(
        len(part) for part in (model.statement.coordinates, model.statement.states)
    )
    for section in (model.coordinates, model.states, model.parameters, model.initial):
        assert not [own for own in section if DOT in own]
        assert DOT not in repr(section)
    assert {own: model.initial[own] for own in model.initial} == dict(model.initial)
    assert [*model.initial.values()] == [*model.statement.initial.values()]
    assert [*model.parameters.values()] == [*model.statement.parameters.values()]


def test_elements_are_asked_for_by_label_or_number(planets: Model) -> None:
    """Assert that every way to name an element gives its value, and that what is not there is named with a remedy."""
    assert planets.initial["r[Jupiter, x]"] == planets.initial["r[1, 0]"] == planets.initial["r[-5, x]"]
    assert "r[Jupiter, w]" not in planets.initial
    for name, said in (
        ("r", r"'r' is along body, axis; ask for an element, like 'r\[Sun, x\]'"),
        ("r[Venus, x]", "no element Venus; it has the labels Sun, Jupiter"),
        ("q", r"there is no 'q' in the section initial; there are t, r\[Sun, x\]"),
    ):
        with pytest.raises(KeyError, match=said):
            planets.initial[name]
    with pytest.raises(KeyError, match="there is no 'x' in the section coordinates; there are r"):
        planets.coordinates["x"]


@pytest.mark.parametrize(
    ("section", "change"),
    [
        ("parameters", lambda part: part.__setitem__("G", 1.0)),
        ("initial", lambda part: part.update({"r[Sun, x]": 1.0})),
        ("parameters", lambda part: part.pop("G")),
        ("coordinates", lambda part: part.clear()),
        ("states", lambda part: part.setdefault("T", 1.0)),
        ("initial", lambda part: part.__delitem__("t")),
        ("initial", lambda part: part.__ior__({"t": 1.0})),
    ],
)
def test_no_section_is_changed_in_place(section: str, change: Callable[[Any], Any], planets: Model) -> None:
    """Assert that a change ends in words that say what to call, and changes nothing."""
    before = dict(getattr(planets, section))
    with pytest.raises(
        xd.ModelError, match=rf"{section} of a model cannot be changed in place; model\.replace\({section}="
    ):
        change(getattr(planets, section))
    assert dict(getattr(planets, section)) == before


def test_a_replaced_model_has_sections_of_its_own(planets: Model) -> None:
    """Assert that the new value is in the new model alone, and that sections are joined as dictionaries are."""
    other = planets.replace(parameters={"G": 2.0}, initial={"r[Sun, x]": 3.0})
    assert (other.parameters["G"].quantity.value, other.initial["r[Sun, x]"].value) == (2.0, 3.0)
    assert planets.initial["r[Sun, x]"].value == 0.0
    assert (planets.initial | {"t": None})["t"] is ({"t": 0} | planets.initial | {"t": None})["t"]


def test_switches_leave_what_a_model_says_as_it_is() -> None:
    """Assert that a run whose rate of a state has a switch is recorded with the rate as it was written."""
    model = Model(
        name="tank",
        coordinates={},
        parameters={"c": "1 s-1"},
        states={"w": {"unit": "m", "rate": "-c*abs(w - 0.5*metre)"}},
        initial={"w": "1 m"},
    )
    run = xd.simulate(model, method="dormand_prince", rtol=1e-6, until="1 s")
    assert run["model_toml"].values.item() == model.to_toml()
    assert "_side" not in model.to_toml()

"""What a model says of its own sections: by the names of its file, and never changed in place.

Who stands for a model and its runs: attributes of every record, outside of every digest.
A bare number keeps the scale that the file states the quantity on: `replace`, axes, `--set`, `--until`.
Entries of a model that are changed, added and taken away.
Names that records have since schema 2: no new model has them, and archives with them open and run as they did.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import xdynamics as xd
from cases.problems import MODELS
from cases.verdicts import verified
from xdynamics.cli import main
from xdynamics.faults import DOT
from xdynamics.model import Model
from xdynamics.sweeping.axes import column_of


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
        len(part) for part in (model.elements.statement.coordinates, model.elements.statement.states)
    )
    for section in (model.coordinates, model.states, model.parameters, model.initial):
        assert not [own for own in section if DOT in own]
        assert DOT not in repr(section)
    assert {own: model.initial[own] for own in model.initial} == dict(model.initial)
    assert [*model.initial.values()] == [*model.elements.statement.initial.values()]
    assert [*model.parameters.values()] == [*model.elements.statement.parameters.values()]


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


BALL = """
name = "ball"
coordinates = { y = "m" }
parameters = { m = "1 kg", g = "9.81 m s-2" }
mass = { y = "m" }
forces.gravity.potential = "m*g*y"
initial = { y = "1 m", v_y = "0 m s-1" }
run = { method = "velocity_verlet", step = "10 ms", until = "0.2 s" }
"""
ABOUT = """
[about]
creator = "A. Noether"
institution = "Göttingen"
license = "CC-BY-4.0"
id = "doi:10.1000/182"
references = "lesson 4"
comment = "second series"
"""
TOLD = {
    "creator_name": "A. Noether",
    "institution": "Göttingen",
    "license": "CC-BY-4.0",
    "id": "doi:10.1000/182",
    "references": "lesson 4",
    "comment": "second series",
}


def told(run: object) -> dict[str, str]:
    """Return what a record says of who stands for it."""
    return {name: text for name, text in getattr(run, "attrs", {}).items() if name in TOLD}


def test_a_model_file_tells_it_of_every_record(tmp_path: Path) -> None:
    """Assert the attributes of a run, of its archive, of what is made of it and of a sweep, with the digests of the model alone."""
    model, plain = xd.Model.from_text(BALL + ABOUT), xd.Model.from_text(BALL)
    run = xd.simulate(model)
    assert told(run) == told(xd.simulate(model.replace(parameters={"g": 9.8}))) == TOLD
    assert (model.digest, xd.content_digest(run)) == (plain.digest, xd.content_digest(xd.simulate(plain)))
    assert "about" not in model.to_toml()
    path = xd.save(run, tmp_path / "run.nc")
    opened = xd.open_run(path)
    assert told(opened) == TOLD
    assert xd.reproduce(path).attrs["identical"] == 1
    assert told(xd.extend(opened, until="0.4 s")) == TOLD
    assert told(xd.complete(xd.simulate(model, log=["y"]))) == TOLD
    assert told(xd.sweep(model, {"g": [9.8, 9.9]})) == TOLD
    assert told(xd.simulate(plain)) == {}


def test_save_tells_it_too(tmp_path: Path) -> None:
    """Assert keywords of `save` over what the model said, in an archive with the same digest; the run itself stays."""
    run = xd.simulate(xd.Model.from_text(BALL + ABOUT))
    digest = verified(xd.save(run, tmp_path / "run.nc"))
    path = xd.save(run, tmp_path / "noted.nc", creator="B. Russell", comment="third series")
    assert verified(path) == digest
    assert told(xd.open_run(path)) == TOLD | {"creator_name": "B. Russell", "comment": "third series"}
    assert told(run) == TOLD


@pytest.mark.parametrize("wrong", ["", "  ", 3, None, ["A", "B"]])
def test_what_is_no_text_is_refused(wrong: object, tmp_path: Path) -> None:
    """Assert one line and no file; none at all for what is not given."""
    run = xd.simulate(xd.Model.from_text(BALL))
    if wrong is None:
        assert xd.save(run, tmp_path / "run.nc", license=wrong).exists()
        return
    with pytest.raises(xd.InputError, match="license is .*, needs a text"):
        xd.save(run, tmp_path / "run.nc", license=wrong)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            'about = { who = "x" }',
            "key 'who' is not known; there are creator, institution, license, id, references, comment",
        ),
        ('about = "me"', r"\[about\] must be a table of names, got 'me'"),
    ],
)
def test_what_is_wrong_in_a_model_file_is_named(text: str, said: str) -> None:
    """Assert one error that names it."""
    with pytest.raises(xd.ModelError, match=said):
        xd.Model.from_text(BALL + text)


ROOM = """
name = "a room that cools"
states.T = { unit = "K", rate = "-(T - outside)/tau" }
parameters = { outside = "20 degC", tau = "2 month", far = "2 pc", warm = "68 degF", age = "3 light_year" }
initial = { T = "80 degC" }
run = { method = "rk4", step = "1 h", until = "10 h" }
"""
ROOMS = """
name = "rooms that cool"
dimensions.room = 3
states.T = { unit = "K", dims = ["room"], rate = "-(T - outside)/tau" }
parameters = { outside = { dims = ["room"], value = __VALUE__ }, tau = "2 h" }
initial = { T = "80 degC" }
run = { method = "rk4", step = "1 h", until = "10 h" }
"""
SI = {
    "outside": (25.0, 298.15),
    "tau": (3.0, 3 * 30.4375 * 86400.0),
    "far": (1.0, 3.0856775814913673e16),
    "warm": (50.0, 283.15),
    "age": (1.0, 9460730472580800.0),
}


@pytest.fixture(scope="module")
def room() -> xd.Model:
    return xd.Model.from_text(ROOM)


@pytest.mark.parametrize("name", SI)
@pytest.mark.parametrize("kind", [float, np.float64, np.array])
def test_a_replaced_number_is_on_the_scale_of_the_file(room: xd.Model, name: str, kind: Any) -> None:
    """Assert the SI value of a bare number in the place of one in °C, °F, months, parsecs and light-years."""
    number, si = SI[name]
    assert room.replace(parameters={name: kind(number)}).elements.statement.parameters[name].si == pytest.approx(
        si, rel=1e-15
    )


def test_a_start_is_too(room: xd.Model) -> None:
    """Assert the same of the start, and that a unit that is written counts."""
    assert room.replace(initial={"T": 10}).initial["T"].si == 283.15
    assert room.replace(parameters={"outside": "25 K"}).elements.statement.parameters["outside"].si == 25.0


def test_it_is_once_more_where_it_was_replaced(room: xd.Model) -> None:
    """Assert that a model made by replacing keeps the scale, and one that was archived has its own unit."""
    again = room.replace(parameters={"outside": 25}).replace(parameters={"outside": 30})
    assert again.elements.statement.parameters["outside"].si == pytest.approx(303.15)
    kept = xd.Model.from_text(room.to_toml()).replace(parameters={"outside": 25})
    assert kept.elements.statement.parameters["outside"].si == 25.0  # its text says kelvins


@pytest.mark.parametrize(
    "values",
    [
        "20:30:3",
        "20:30:3 degC",
        "20, 25, 30",
        "20, 25, 30 degC",
        [20, 25.0, 30],
        np.array([20.0, 25.0, 30.0]),
        "68:86:3 degF",
    ],
)
def test_an_axis_is_on_the_scale_of_the_file(room: xd.Model, values: Any) -> None:
    """Assert values of an axis as a range, a list, numbers and an array."""
    column = column_of(room, "outside", values)
    assert column.values.tolist() == pytest.approx([293.15, 298.15, 303.15])
    assert column.unit.text == "K"


@pytest.mark.parametrize(
    "value", ['"20 degC"', '["20 degC", 20, 20.0]', '20, unit = "degC"', '[20, 20, 20], unit = "degC"']
)
def test_elements_are_on_the_scale_of_the_file(value: str) -> None:
    """Assert the same of quantities with dimensions: as they are read, replaced whole, by element, and along an axis."""
    model = xd.Model.from_text(ROOMS.replace("__VALUE__", value))
    assert {entry.si for entry in model.elements.statement.parameters.values() if entry.quantity.unit.text == "K"} == {
        293.15
    }
    whole = model.replace(parameters={"outside": [25, 30, 35]})
    names = [model.shapes.internal_name(f"outside[{i}]") for i in range(3)]
    assert [whole.elements.statement.parameters[name].si for name in names] == pytest.approx([298.15, 303.15, 308.15])
    one = model.replace(parameters={"outside[1]": 25})
    assert one.elements.statement.parameters[names[1]].si == 298.15
    assert column_of(model, "outside[1]", [25.0]).values.tolist() == [298.15]


def marched(folder: Path, *arguments: str) -> Any:
    """Run the model at the command line."""
    (folder / "room.toml").write_text(ROOM)
    return CliRunner().invoke(main, ["run", str(folder / "room.toml"), "-o", str(folder / "run.nc"), *arguments])


def test_the_command_line_follows_the_same_rule(tmp_path: Path) -> None:
    """Assert `--set` in °C, and `--until` and `--step` in the hours that the file says."""
    done = marched(tmp_path, "--set", "outside=25", "--until", "20", "--step", "2")
    assert done.exit_code == 0, done.output
    with xd.open_run(tmp_path / "run.nc") as run:
        assert float(run.outside) == 298.15
        assert float(run.time[-1]) == 20 * 3600.0
        assert float(run.step_size[1]) == 7200.0


@pytest.mark.parametrize("text", ["nan", "1e999", "ten", "1 kg", "-"])
def test_what_is_no_time_is_refused(tmp_path: Path, text: str) -> None:
    """Assert one line, and no file, for an end that is none."""
    done = marched(tmp_path, "--until", text)
    assert done.exit_code == 2
    assert "until" in done.output
    assert not (tmp_path / "run.nc").exists()


def test_thirty_digits_of_a_parsec() -> None:
    """Assert that a length in parsecs is known to 31 digits, like any other, and keeps them in the model's text."""
    from fractions import Fraction

    from xdynamics.units import parse_quantity
    from xdynamics.units.unit import exact_value

    pi = Fraction("3.14159265358979323846264338327950288419716939937510")
    exact = Fraction("1.9") * 648000 / pi * 149597870700
    quantity = parse_quantity("1.9 parsec")
    assert abs(exact_value(quantity.value) / exact - 1) < Fraction(1, 10**45)
    assert abs(exact_value(parse_quantity(str(quantity)).value) / exact - 1) < Fraction(1, 10**38)


REPLACED_BALL = xd.Model.from_toml(MODELS / "thrown_ball.toml")
PLANETS = xd.Model.from_toml(MODELS / "outer_solar_system.toml")
APEX = {"function": "v_y", "direction": "falling"}


def test_an_event_is_added_and_taken_away() -> None:
    """Assert that it is located at the top, that the first model stays as it was, and that None takes one away."""
    model = REPLACED_BALL.replace(events={"apex": APEX})
    assert [*model.elements.statement.events] == ["landing", "apex"]
    assert [*REPLACED_BALL.elements.statement.events] == ["landing"]
    run = xd.simulate(model, until="3 s")
    top = run.dynamics.events("apex")
    assert abs(float(top.before_v_y[0])) < 1e-9
    assert float(top.before_y[0]) == pytest.approx(float(run.y.max()), abs=1e-12)
    fewer = model.replace(events={"landing": None})
    assert [*fewer.elements.statement.events] == ["apex"]
    assert fewer == xd.Model.from_text(fewer.to_toml())


def test_settings_a_name_and_a_force() -> None:
    """Assert a step in the place of a tolerance, another name and description, and a force that acts."""
    model = REPLACED_BALL.replace(
        run={"method": "rk4", "step": "10 ms"}, name="drop", description="without drag", forces={"drag": None}
    )
    assert model.run == {"method": "rk4", "step": "10 ms", "until": REPLACED_BALL.run["until"]}
    assert (model.name, model.elements.statement.description) == ("drop", "without drag")
    wind = model.replace(forces={"wind": {"x": "0.1*newton"}})
    run = xd.simulate(wind, until="1 s")
    assert run.force_wind_x.values.tolist() == [0.1] * run.sizes["step"]
    assert float(run.a_x[0]) == pytest.approx(0.1 / 0.145, rel=1e-15)
    assert REPLACED_BALL.replace(run={"until": None}).run == {
        key: value for key, value in REPLACED_BALL.run.items() if key != "until"
    }


def test_a_model_with_dimensions_likewise() -> None:
    """Assert a name and settings of a model whose quantities have elements."""
    model = PLANETS.replace(run={"rtol": 1e-6}, name="planets")
    assert (model.name, model.run["rtol"]) == ("planets", 1e-6)
    assert "step" not in model.run
    assert model.statement.coordinates.keys() == PLANETS.statement.coordinates.keys()


@pytest.mark.parametrize("speed", [20.0, "20 m s-1", "72 km h-1"])
def test_a_start_is_found_by_shooting(speed: Any) -> None:
    """Assert that numbers, bare or with units, and numbers of numpy are values at the start, as root finders give them."""
    import numpy as np

    for value in (speed, np.float64(speed) if isinstance(speed, float) else speed):
        run = xd.simulate(REPLACED_BALL.replace(initial={"v_x": value}), until="0.1 s")
        assert float(run.v_x[0]) == pytest.approx(20.0, rel=1e-15)


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "parameter": ({"parameters": {"mass": "1 kg"}}, "parameters has no entry 'mass'; there are: m, g, c, angle"),
    "start": ({"initial": {"z": "1 m"}}, "initial has no entry 'z'"),
    "none there": ({"events": {"apex": None}}, "events has no entry 'apex'; there are: landing"),
    "setting": ({"run": {"nodes": ["1 s"]}}, "has no setting 'nodes'"),
    "unit": ({"run": {"step": "1 m"}}, "step"),
    "section": ({"foo": {"a": 1}}, "foo has no entry 'a'"),
    "text for a section": ({"events": "apex"}, "events has no entries to replace"),
    "number for a name": ({"name": 3}, "is no text; write it in quotes"),
    "event": ({"events": {"apex": {"function": "w"}}}, "'w'"),
    "event without a function": ({"events": {"apex": {}}}, "apex"),
    "a parameter that is used": ({"parameters": {"g": None}}, "'g'"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_said(case: str) -> None:
    """Assert one error that names it."""
    sections, words = WRONG[case]
    with pytest.raises(xd.ModelError, match=words):
        REPLACED_BALL.replace(**sections)


SPRING = """
name = "spring"
[coordinates]
x = "m"
[parameters]
m = "1 kg"
k = "4 N m-1"
{name} = "2 m"
[mass]
x = "m"
[forces.spring]
x = "-k*x"
[initial]
x = "1 m"
v_x = "0 m s-1"
"""
REFUSED = (
    "closed_time",
    "at_time",
    "document",
    "energy_balance",
    "energy_balance_verdict",
    "work_spring",
    "solver_mine",
    "switch_share_spring_abs",
)


@pytest.mark.parametrize("name", REFUSED)
def test_a_name_of_records_is_refused(name: str) -> None:
    """Assert one line that names it, in a file and from Python, and that a record with it is read."""
    text = SPRING.format(name=name)
    with pytest.raises(xd.ModelError, match=f"parameter '{name}': the record of a run has that name; rename it"):
        xd.Model.from_text(text)
    assert name in xd.Model.from_record(text).elements.statement.parameters


@pytest.mark.parametrize("name", ["document", "point", "member"])
def test_a_dimension_of_records_is_refused(name: str) -> None:
    """Assert one line that names it."""
    with pytest.raises(xd.ModelError, match=f"dimension '{name}'"):
        xd.Model(
            name="two",
            dimensions={name: 2},
            states={"y": {"unit": "1", "rate": "-y/(1*second)", "dims": [name]}},
            initial={"y": "1"},
        )


@pytest.mark.parametrize("name", ["work_done", "step_length", "work_of_spring", "share"])
def test_names_beside_them_are_free(name: str) -> None:
    """Assert that what only resembles them is a name as every other."""
    assert name in xd.Model.from_text(SPRING.format(name=name)).elements.statement.parameters


@pytest.mark.parametrize("value", ["3", "true", '["A", "B"]'])
def test_what_is_no_text_of_an_author_is_refused(value: str) -> None:
    """Assert one line for authors and descriptions that are numbers or lists, which were written as Python shows them."""
    with pytest.raises(xd.ModelError, match=r"about: .* is no text; write it in quotes"):
        xd.Model.from_text(SPRING.format(name="b") + f"[about]\ncreator = {value}\n")

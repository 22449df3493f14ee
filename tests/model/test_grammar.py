"""The words of a model file: one table that the reader and the help have, with examples that are read."""

from __future__ import annotations

import tomllib
from typing import Any

import pytest

import xdynamics as xd
from xdynamics.model.grammar import HEAD, NEEDED, SECTIONS

APART = ("lagrangian", "history")  # stands for masses; is of delays, which go with neither bodies nor constraints
WHOLE_SECTIONS = [name for name in SECTIONS if name not in APART]
WHOLE = 'name = "whole"\ndescription = "every word"\n' + "".join(SECTIONS[name].example for name in WHOLE_SECTIONS)


def words(value: Any) -> set[str]:
    """Every key that stands anywhere in a TOML value."""
    if isinstance(value, list):
        return set().union(*map(words, value))
    return {*value}.union(*map(words, value.values())) if isinstance(value, dict) else set()


@pytest.mark.dear
def test_the_examples_are_one_model_and_march() -> None:
    """Assert that the examples of all sections, put together, are read, written, read again, and marched."""
    model = xd.Model.from_text(WHOLE)
    assert xd.Model.from_text(model.to_toml()).to_toml() == model.to_toml()
    bare = {key: load for key, load in tomllib.loads(WHOLE).items() if key not in ("contacts", "frictions")}
    bare["run"] = {
        key: value for key, value in bare["run"].items() if key != "precision"
    }  # which goes with fewer words
    run = xd.simulate(xd.Model(**bare), until="0.6 s")
    assert run.attrs["run_outcome"] == "completed"
    assert run["speed_of_it"].attrs["units"] == "km h-1"
    assert run["speed_of_it"].attrs["long_name"] == "as on a speedometer"
    assert float(run["speed_of_it"][-1]) == pytest.approx(3.6 * float(run["v_x"][-1]), rel=1e-15)


@pytest.mark.parametrize("section", SECTIONS)
def test_every_key_has_an_example(section: str) -> None:
    """Assert that each key of a section stands in its example, and is explained."""
    about = SECTIONS[section]
    shown = words(tomllib.loads(about.example)[section])
    silent = {"unit"} if section in ("parameters", "initial", "events") else set()
    silent |= {"quantity"} & set(about.fixed_keys)
    assert (
        set(about.fixed_keys) - silent - shown - {key.name for key in about.keys if key.takes == "distribution"}
        <= SPREADS
    )
    assert all(key.about and key.takes for key in about.keys)


SPREADS = {"uncertainty", "half_width", "distribution", "degrees_of_freedom"}


@pytest.mark.parametrize("section", [one for one in SECTIONS if SECTIONS[one].entry])
def test_other_keys_are_refused_by_the_same_table(section: str) -> None:
    """Assert that a key that is not in the table is named, with those that are."""
    statement = tomllib.loads(WHOLE + ("" if section in WHOLE_SECTIONS else SECTIONS[section].example))
    if not any(isinstance(one, dict) for one in statement[section].values()) or section == "forces":
        return
    entry = next(name for name, value in statement[section].items() if isinstance(value, dict))
    statement[section][entry]["no_such_key"] = 1
    with pytest.raises(xd.ModelError, match="key 'no_such_key' is not known"):
        xd.Model(**statement)


def test_what_is_needed_is_told() -> None:
    """Assert that a needed key that is left out is named, and that the head has its own."""
    assert [one.name for one in HEAD if one.default == NEEDED] == ["name"]
    with pytest.raises(xd.ModelError, match="state 'fuel': key 'rate' is missing"):
        xd.Model(name="x", states={"fuel": {"unit": "kg"}})
    with pytest.raises(xd.ModelError, match="drive 'pull': key 'table' is missing; name a CSV file there, or give its"):
        xd.Model(name="x", drives={"pull": {"argument": "t"}})


def test_velocities_begin_at_rest_where_nothing_is_said() -> None:
    """Assert that an initial velocity that is not there is 0, in the record, and not there in the model as it is written."""
    model = xd.Model(
        name="still",
        coordinates={"x": "mm"},
        mass={"x": "1*kilogram"},
        forces={"pull": {"x": "1*newton"}},
        initial={"x": "1 mm"},
    )
    assert "v_x" not in model.to_toml()  # nor is it given in what is archived
    run = xd.simulate(model, method="rk4", step=0.1, until=1.0)
    assert float(run["v_x"][0]) == 0.0
    with pytest.raises(xd.ModelError, match="initial value of 'x' is missing"):
        xd.Model(name="x", coordinates={"x": "m"}, mass={"x": "1*kilogram"}, forces={"pull": {"x": "1*newton"}})


def test_an_observable_in_a_unit_of_another_kind() -> None:
    """Assert that the unit of an observable has to be one of its dimension."""
    with pytest.raises(xd.ModelError, match="observable 'v': has units 'm s-1', and is to be in 'km'"):
        xd.Model(
            name="x",
            coordinates={"x": "m"},
            mass={"x": "1*kilogram"},
            forces={"pull": {"x": "1*newton"}},
            initial={"x": "0 m"},
            observables={"v": {"expression": "v_x", "unit": "km"}},
        )


def test_a_table_in_the_file_needs_no_name() -> None:
    """Assert that csv alone is enough."""
    model = xd.Model(
        name="x",
        states={"q": {"unit": "N s", "rate": "pull"}},
        drives={"pull": {"csv": "t [s],pull [N]\n0,1\n2,1\n"}},
        initial={"q": "0 N s"},
    )
    assert model.drives["pull"].table.name == "pull.csv"

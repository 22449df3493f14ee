"""Whether two marches are the same: every word that their bits hang on, and which of them differ."""

from __future__ import annotations

from typing import Any

import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import oscillator, particle
from xdynamics.march import March
from xdynamics.march.configuration import settings_for
from xdynamics.record import identity, is_of, same_settings, word_differences

CHOSEN = {"method": "dormand_prince", "rtol": 1e-6}


def march(model: xd.Model | None = None, **asked: Any) -> March:
    """A march of the oscillator that is not begun."""
    model = model or oscillator().model
    return March(model, settings_for(model, **{"method": "velocity_verlet", "until": 1.0, "step": 0.1} | asked))


def test_every_word_of_a_march_has_its_name() -> None:
    """Assert that settings stand under their own names, what is in groups behind the group's, and nothing that was not given."""
    found = identity(march(step=None, atol={"x": "1 mm", "v_x": "2 mm s-1"}, scales={"length": "3 m"}, **CHOSEN))
    expected = {
        "method": "dormand_prince",
        "until": "1.0",
        "rtol": "1e-06",
        "atol.x": "0.001",
        "atol.v_x": "0.002",
        "safety": "0.9",
        "scales.length": "3.0",
        "estimator": "'embedded'",
        "nodes": "()",
        "model.parameters.k": "'4.0 N m-1'",
        "math_functions": "xdynamics 2",
    }
    assert {name: found.get(name) for name in expected} == expected
    assert {"version", "law"} <= set(found)
    assert not [name for name in found if name.startswith(("units", "tolerances", "pacing", "step", "."))]


@pytest.mark.parametrize("length", [58, 59])
def test_a_long_word_is_its_beginning_and_its_digest(length: int) -> None:
    """Assert that of more than 60 characters, quotes counted, no more than the start is kept, and that any change is seen."""
    words = [identity(march(particle(description="x" * length + end))) for end in ("", "y")]
    if length == 58:
        assert words[0]["model.description"] == f"'{'x' * 58}'"
    else:
        digest = "2e72cb43f466d585"
        assert words[0]["model.description"] == f"'{'x' * 19}… (61 characters, sha256 {digest})"
    assert [one.split()[0] for one in word_differences(*words)] == ["model.description"]


@pytest.mark.parametrize(
    ("kept", "here", "said"),
    [
        ({"until": "1"}, {"until": "1"}, []),
        ({"until": "1", "step": "2"}, {"until": "3", "step": "2"}, ["until was 1 and is 3"]),
        ({"step": "2"}, {"nodes": "4"}, ["step was 2 and is not given", "nodes was not given and is 4"]),
        ({"law": "a", "step": "2"}, {"law": "b", "step": "3"}, ["step was 2 and is 3"]),
        ({"law": "a", "step": "2"}, {"law": "b", "step": "2"}, ["law was a and is b"]),
    ],
)
def test_what_differs_is_said(kept: dict[str, str], here: dict[str, str], said: list[str]) -> None:
    """Assert both values of each word that differs; the law's digest only where nothing else explains it."""
    assert word_differences(kept, here) == said


def test_a_finished_record_is_of_its_march() -> None:
    """Assert that the settings are another matter, and that model, law, version and end are not."""
    run, one = xd.simulate(oscillator().model, step=0.1, until=1.0), march(step=0.05)
    assert is_of(run, one)

    def other(**attributes: str) -> xr.Dataset:
        return run.assign_attrs(attributes)

    for name in ("model_digest", "force_digest", "xdynamics_version"):
        assert not is_of(other(**{name: "another"}), one), name
    assert not is_of(other(run_outcome="interrupted"), one)
    assert is_of(other(run_outcome="step_limit"), one)


def test_tolerances_may_be_named_or_not() -> None:
    """Assert that marches are the same where every variable has the same tolerance, however it was told."""
    names = ("x", "v_x")
    bare, named, wider, none = (
        march(**{"step": None} | CHOSEN | more).settings
        for more in (
            {"atol": 1e-6},
            {"atol": {"x": "1 um", "v_x": "1 um s-1"}},
            {"atol": {"x": "2 um"}},
            {"rtol": None, "step": 0.1, "method": "rk4"},
        )
    )
    assert same_settings(bare, named, names)
    assert same_settings(none, none, names)
    assert not same_settings(bare, march(step=None, **CHOSEN).settings, names)  # those follow their variables
    assert not same_settings(bare, wider, names)
    assert not same_settings(bare, none, names)
    assert not same_settings(bare, march(step=None, until=2.0, **CHOSEN).settings, names)

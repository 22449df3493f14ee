"""Energies of many elements that a record leaves out: they are not computed, and all else has the same bits."""

from __future__ import annotations

import numpy as np
import pytest

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.kernels.law import ROW_ENERGIES, law_of
from xdynamics.kernels.model_programs import row
from xdynamics.march.configuration import settings_for

CLUSTER = """
name = "cluster"
[dimensions]
body = 20
axis = ["x", "y", "z"]
[relations.pair]
of = "body"
[coordinates]
r = { unit = "m", dims = ["body", "axis"] }
[parameters]
G = "1 N m2 kg-2"
m = "1 kg"
[mass]
r = "m"
[forces.gravity]
over = "pair"
potential = "-G*m*m/norm(second(r, pair) - first(r, pair), axis)"
[initial]
r = "9*metre*(sin(1.7*(3*index(body) + index(axis) + 1)))"
[observables]
farthest = { unit = "m", expression = "max(norm(r, axis), body)" }
[events.outside]
function = "max(norm(r, axis), body) - 20*metre"
direction = "rising"
"""
FAST = """
name = "fast"
[dimensions]
body = 3
[coordinates]
x = { unit = "m", dims = ["body"] }
[parameters]
m = "1e200 kg"
F = "1e254 N"
[mass]
x = "m"
[forces.push]
x = "F"
[initial]
x = "0*metre*index(body)"
"""
ASKED = {"method": "velocity_verlet", "step": 0.01, "until": 3.0}


def test_all_else_has_the_bits_of_the_whole_log() -> None:
    """Assert states, events with observables, and the law's text of a record with energies."""
    model = xd.Model.from_text(CLUSTER)
    whole = xd.simulate(model, **ASKED, log="full")
    for log in ("states", ["r", "farthest"]):
        run = xd.simulate(model, **ASKED, log=log)
        assert "total_energy" not in run
        assert run.sizes["event"] == whole.sizes["event"] > 0
        for name, variable in run.variables.items():
            if name not in ("end_memory", "force_source"):
                assert variable.values.tobytes() == whole.variables[name].values.tobytes(), name
        assert str(run["force_source"].values) == str(whole["force_source"].values)
        assert xd.content_digest(xd.complete(run)) == xd.content_digest(whole)


def test_energies_that_are_not_recorded_are_not_computed() -> None:
    """Assert one quotient for each term of the force alone, and those of the energy where it is asked for."""
    model = xd.Model.from_text(CLUSTER)
    layout = settings_for(model, **ASKED).layout(model)
    texts = [law_of(layout, sampled=False, unread=unread).text() for unread in (frozenset(), frozenset({ROW_ENERGIES}))]
    assert texts[0].count("fdiv") > texts[1].count("fdiv")
    assert "total_energy" not in law_of(layout, sampled=False, unread=frozenset({ROW_ENERGIES})).text()
    whole, without = (row(layout, 0, energies=energies).sound for energies in (True, False))
    assert whole is not None
    assert without == (whole[0] + 3, whole[1] - 3)  # what is not written is not judged


@pytest.mark.filterwarnings("ignore:overflow encountered")  # of laws that are not compiled
@pytest.mark.parametrize("log", ["full", ["kinetic_energy"]])
def test_an_energy_that_is_not_finite_ends_a_march_that_records_it(log: str | list[str]) -> None:
    """Assert that 3 m a^2 t^2/2 beyond the largest float ends a run with energies before 1.1 s, and no other."""
    model = xd.Model.from_text(FAST)
    run = xd.simulate(model, **ASKED, log=log)
    assert run.attrs["run_outcome"] == "nonfinite_observable"
    assert 1.0 < run["time"][-1] < 1.1  # 1.5e308 t^2 is 1.8e308 at 1.095 s
    states = xd.simulate(model, **ASKED, log="states")
    assert states.attrs["run_outcome"] == "completed"
    np.testing.assert_allclose(states["x"][-1], 4.5e54, rtol=1e-12)


def test_impacts_of_many_bodies_are_judged_by_energies_that_are_not_recorded() -> None:
    """Assert a run of states alone that has the impacts of the whole log, which are judged by kinetic energies."""
    model = xd.Model.from_toml(MODELS / "granular_box.toml")
    asked = {"method": "velocity_verlet", "step": "1 ms", "until": "0.2 s"}
    whole, states = (xd.simulate(model, **asked, log=log) for log in ("full", "states"))
    assert states.attrs["run_outcome"] == whole.attrs["run_outcome"] == "completed"
    assert states.sizes["event"] == whole.sizes["event"] > 0
    assert states["r"].values.tobytes() == whole["r"].values.tobytes()

"""The ledger of impacts: that true runs pass, and that every wrong number in a record is found by the line that it belongs to."""

from __future__ import annotations

import tomllib
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.contacts import ball, cradle
from cases.impacts import random_rod
from xdynamics.evidence.validating.impacts import checks_of
from xdynamics.model.parts import IMPACT_LAWS
from xdynamics.record.flag_words import words_of_flag


def failed(run: Any, model: xd.Model) -> set[str]:
    """The names of the relations that a run breaks."""
    return {check.name for check in checks_of(run, model) if not check.note and not check.residual <= check.bound}


@pytest.mark.cases(200)
@pytest.mark.filterwarnings("ignore:.*energy was created")
def test_rods_of_every_law_pass(case: int) -> None:
    """Assert that impulses, rates, friction and energies of a rod's impact are those of its law, by any law."""
    rod, law = random_rod(case), IMPACT_LAWS[case % len(IMPACT_LAWS)]
    found = list(checks_of(rod.struck(law), rod.model(law)))
    assert [one.name for one in found] == [
        "impulse_x",
        "impulse_y",
        "impulse_theta",
        "kinetic_energy",
        "floor.direction",
        "floor.restitution",
        "floor.friction",
        "floor.energy_lost",
    ]
    assert all(bool(one.note) == (law in ("poisson", "energetic") and one.name == "floor.restitution") for one in found)
    assert not {one.name for one in found if not one.note and not one.residual <= one.bound}


WRONG = {
    "an impulse along x that is too large": (
        "event_impulse_x",
        1.0 + 1e-6,
        {"impulse_x", "kinetic_energy", "floor.direction", "floor.energy_lost"},
    ),
    "one of the other sign": (
        "event_impulse_y",
        -1.0,
        {"impulse_y", "kinetic_energy", "floor.direction", "floor.energy_lost"},
    ),
    "an energy of the other sign": ("event_energy_lost", -1.0, {"floor.energy_lost"}),
    "an energy without its half": ("event_energy_lost", 2.0, {"floor.energy_lost"}),
    "no energy": ("event_energy_lost", 0.0, {"floor.energy_lost"}),
    "a kinetic energy without its half": ("kinetic_energy", 2.0, {"kinetic_energy"}),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_a_wrong_number_is_found(wrong: str) -> None:
    """Assert that a factor or sign in the record breaks the relations that it is in."""
    rod, (name, factor, broken) = random_rod(3), WRONG[wrong]
    run = rod.struck("newton")
    changed = run.assign({name: run[name] * factor})
    changed[name].attrs = run[name].attrs
    assert failed(changed, rod.model("newton")) == broken
    assert not failed(run, rod.model("newton"))


@pytest.mark.parametrize(
    ("changed", "broken"),
    [({"restitution": "e/2 + 0.1"}, {"floor.restitution"}), ({"friction": "mu/3"}, {"floor.friction"})],
)
def test_another_law_than_the_models_is_found(changed: dict[str, str], broken: set[str]) -> None:
    """Assert that a run is not that of another coefficient."""
    rod = random_rod(0)
    assert failed(rod.struck("newton"), rod.model("newton", **changed)) == broken


def test_velocities_behind_an_impact_are_looked_at() -> None:
    """Assert that a velocity of another row breaks impulse, restitution and energies."""
    model = ball(0.5)
    run = xd.simulate(model, method="dop853", rtol=1e-9, until=1.0)
    speeds = run.v_y.copy()
    speeds[int(run.event_row_after[0])] *= 1.0 + 1e-9
    assert failed(run.assign(v_y=speeds), model) == {
        "impulse_y",
        "kinetic_energy",
        "floor.restitution",
        "floor.energy_lost",
    }


def test_a_model_with_contacts_is_validated_by_its_own_run() -> None:
    """Assert the lines of a model that has no closed form, each with relation, unit, event, bound and verdict."""
    table = tomllib.loads(ball(0.5).to_toml()) | {"run": {"method": "dop853", "rtol": 1e-9, "until": "2 s"}}
    found = xd.validate(model=xd.Model(**table))
    assert found.case_name.values.tolist() == [
        f"impacts.{name}"
        for name in ("impulse_y", "kinetic_energy", "floor.direction", "floor.restitution", "floor.energy_lost")
    ]
    assert set(words_of_flag(found.verdict)) == {"passed"}
    assert found.case_units.values.tolist() == ["kg m s-1", "J", "1", "m s-1", "J"]
    assert all("impacts, worst at event" in str(one) for one in found.case_where.values)
    assert (found.bound.values > 0.0).all()
    assert (found.bound.values < 1e-9).all()
    table["run"]["until"] = "0.1 s"
    none = xd.validate(model=xd.Model(**table))
    assert (none.case_note.values.tolist(), words_of_flag(none.verdict)) == (["the run has no impact"], ["refused"])


def test_a_method_that_locates_nothing_is_refused() -> None:
    """Assert that Moreau's steps, whose impulses are of whole steps, are no case."""
    table = tomllib.loads(ball(0.5).to_toml()) | {"run": {"method": "moreau_jean", "step": "1 ms", "until": "1 s"}}
    found = xd.validate(model=xd.Model(**table))
    assert found.case_note.values.tolist() == ["the method locates no events"]
    assert not np.isfinite(found.bound.values).any()


@pytest.mark.parametrize("tolerance", [None, "1e-9 s", "1e-14 s"])
def test_bounds_are_rounding_and_what_is_located(tolerance: str | None) -> None:
    """Assert the bounds of one impact of a ball: 256 roundings of all terms, and what acts within the time tolerance."""
    table = tomllib.loads(ball(0.5).to_toml())
    if tolerance:
        table["contacts"]["floor"]["time_tolerance"] = tolerance
    model = xd.Model(**table)
    run = xd.simulate(model, method="rk4", step=0.01, until=0.6)
    assert run.sizes["event"] == 1
    rows, share = [int(run[f"event_row_{side}"][0]) for side in ("before", "after")], 256 * np.finfo(float).eps
    time = max([float(run.attrs["solver_time_tolerance"])] + ([float(tolerance.split()[0])] if tolerance else []))
    m = float(run.event_impulse_y[0]) / float(run.v_y[rows[1]] - run.v_y[rows[0]])
    speeds, pulls = (sum(abs(float(run[name][row])) for row in rows) for name in ("v_y", "a_y"))
    impulse = abs(float(run.event_impulse_y[0]))
    bound = share * (m * speeds + impulse) + time * m * pulls
    found = {check.name: check for check in checks_of(run, model)}
    rate = 2.0 * share * speeds + time * pulls
    wanted = {
        "impulse_y": bound,
        "kinetic_energy": bound * speeds,
        "floor.direction": share,
        "floor.restitution": rate,
        "floor.energy_lost": impulse * rate,
    }
    assert {name: value.bound for name, value in found.items()} == pytest.approx(wanted, rel=1e-6, abs=0.0)


@pytest.mark.parametrize("law", ["newton", "sequential", "poisson"])
def test_balls_that_are_struck_together_pass(law: str) -> None:
    """Assert that of contacts beside one another none is held to its coefficient alone, and that parting balls are no fault."""
    model = cradle(law, 0.5)
    run = xd.simulate(model, method="rk4", step=0.05, until=1.5)
    assert run.sizes["event"] >= 1
    found = {check.name: check for check in checks_of(run, model)}
    assert not failed(run, model)
    notes = {name for name, value in found.items() if value.note}
    assert notes == ({"first.energy_lost", "second.energy_lost"} if law == "sequential" else set())
    assert all(value.residual >= 0.0 for name, value in found.items() if name not in notes)


def test_a_contact_that_is_struck_alone_is_held_to_its_energy_by_every_law() -> None:
    """Assert that a ball by sequential impacts is compared, and a wrong energy found."""
    model = ball(0.5, law="sequential")
    run = xd.simulate(model, method="rk4", step=0.05, until=0.6)
    assert not failed(run, model)
    wrong = run.assign(event_energy_lost=run.event_energy_lost * 1.001)
    wrong.event_energy_lost.attrs = run.event_energy_lost.attrs
    assert failed(wrong, model) == {"floor.energy_lost"}

"""Impacts of many bodies with friction: each law against single bodies in closed form, and energy that is created."""

from __future__ import annotations

import math
import warnings
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.impacts import Rod, integrated, random_rod, rods_together
from xdynamics.model.parts import IMPACT_LAWS

PARADOX = Rod(1.0, 1 / 12, 0.5, math.pi / 4, 0.5, 1.0, (0.5, -1.0, 0.0))  # see `contacts.test_impact_laws`
COUNT = 40


def struck(rods: list[Rod], law: str, **more: Any) -> xr.Dataset:
    """Return the run of rods until each has been struck once, or more often."""
    last = max(rod.before for rod in rods)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", xd.AccuracyWarning)
        return xd.simulate(
            rods_together(rods, law), method="velocity_verlet", step=last / 2.9, until=1.01 * last, **more
        )


def first_impact(run: xr.Dataset, k: int) -> int:
    """Return the number of the first event of a rod."""
    return int(np.flatnonzero(run.event_rod.values == k)[0])


def after(run: xr.Dataset, k: int) -> np.ndarray:
    """Return the velocities of a rod in the row behind its first impact."""
    row = int(run.event_row_after[first_impact(run, k)])
    return np.array([float(run[f"v_{name}"][row, k]) for name in ("x", "y", "theta")])


@pytest.mark.dear
@pytest.mark.every(5)
@pytest.mark.parametrize("law", IMPACT_LAWS)
def test_rods_are_struck_as_each_alone(law: str) -> None:
    """Assert velocities and energies of rods of all shapes that strike a rough floor by each law, those of single rods."""
    rods = [random_rod(case) for case in range(100, 100 + COUNT)]
    run = struck(rods, law)
    assert run.attrs["run_outcome"] == "completed"
    for k, rod in enumerate(rods[::4]):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", xd.AccuracyWarning)
            one = rod.struck(law)
        row = int(one.event_row_after[0])
        alone = np.array([float(one[f"v_{name}"][row]) for name in ("x", "y", "theta")])
        size = np.abs(alone).max() + np.abs(rod.speeds).max()
        assert np.abs(after(run, 4 * k) - alone).max() <= 1e-10 * size
        lost = float(run.event_energy_lost[first_impact(run, 4 * k)])
        assert lost == pytest.approx(float(one.event_energy_lost[0]), abs=1e-9 * rod.kinetic(np.array(rod.speeds)))


@pytest.mark.dear
def test_the_energetic_law_of_many_is_its_definition() -> None:
    """Assert velocities of rods to 1e-9 of an integration over the impulse."""
    rods = [random_rod(case) for case in range(100, 100 + COUNT)]
    run = struck(rods, "energetic")
    for k, rod in enumerate(rods[::4]):
        exact = integrated(rod.rows, rod.mass, np.array(rod.speeds), rod.mu, rod.e)
        assert np.abs(after(run, 4 * k) - exact).max() <= 1e-9 * (np.abs(rod.speeds).max() + np.abs(exact).max())


@pytest.mark.parametrize("law", ["newton", "sequential"])
def test_energy_that_many_create_is_spoken_against(law: str) -> None:
    """Assert Kane's paradox of one rod among others that lose more: the rod, the time and 7/64 J are named."""
    calm = Rod(*{**vars(PARADOX), "e": 0.0}.values())
    rods = [calm] * COUNT
    rods[17] = PARADOX
    model, asked = rods_together(rods, law), {"method": "velocity_verlet", "step": "100 us", "log": "full"}
    said = (
        r"energy was created in an impact at event 17 \('floor' of rod 17, t = 5e-05 s, event_energy_lost = -0\.109 J\)"
    )
    with pytest.warns(xd.AccuracyWarning, match=said):
        run = xd.simulate(model, until="100 us", time_tolerance="1e-15 s", **asked)
    assert float(run.event_energy_lost[17]) == pytest.approx(-7 / 64, rel=1e-10)
    assert float(run.event_energy_lost.sum()) > 7.0
    assert "law = 'poisson' and law = 'energetic' do not" in run.attrs["run_outcome_text"]
    with pytest.warns(xd.AccuracyWarning, match="energy was created"):
        longer = xd.extend(run, until="200 us")
    assert longer.attrs["run_outcome_text"].partition(";")[2] == run.attrs["run_outcome_text"].partition(";")[2]


def test_links_that_share_an_impact_are_refused_the_energetic_law() -> None:
    """Assert that three balls in a row are named, with laws that have an answer, where two links are struck at once."""
    places = [*np.arange(3) * 1.0, *(10.0 + 2.0 * np.arange(27))]
    speeds = [1.0, 0.0, -1.0, *[0.0] * 27]
    model = xd.Model(
        name="row",
        dimensions={"ball": 30},
        relations={"pair": {"of": "ball", "neighbours": 1}},
        coordinates={"x": {"unit": "m", "dims": ["ball"]}},
        parameters={"m": "1 kg"},
        mass={"x": "m"},
        forces={},
        contacts={
            "balls": {
                "gap": "second(x, pair) - first(x, pair) - 1*metre",
                "restitution": 0.5,
                "law": "energetic",
            }
        },
        initial={"x": {"unit": "m", "value": places}, "v_x": {"unit": "m s-1", "value": speeds}},
    )
    run = xd.simulate(model, until="1 ms", method="velocity_verlet", step="1 ms")
    assert run.attrs["run_outcome"] == "contact_undetermined"
    assert "'balls' of ball 1 and 2 and another one touch at once" in run.attrs["run_outcome_text"]
    assert "choose law = 'poisson' or 'sequential'" in run.attrs["run_outcome_text"]

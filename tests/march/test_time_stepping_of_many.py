"""Moreau's time-stepping over contacts of many bodies: closed forms, contacts that are written out, and heaps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import xdynamics as xd
from xdynamics.evidence.comparing.bits import compare_reproduction
from xdynamics.schema import CONTACT_ARITHMETIC

Floats = NDArray[np.float64]
G, MU, E, H = 9.81, 0.3, 0.5, 1e-3
STEPPED = {"method": "moreau_jean", "step": "1 ms"}
PILE = Path(__file__).parents[2] / "data/models/rough_pile.toml"


def balls(places: Floats, contacts: dict[str, Any], parameters: dict[str, Any] | None = None, **more: Any) -> xd.Model:
    """Return balls on a line each, of 1 to 2 kg, which begin at rest."""
    count = len(places)
    return xd.Model(
        name="balls",
        dimensions={"ball": count},
        coordinates={"y": {"unit": "m", "dims": ["ball"]}},
        parameters={
            "m": {"dims": ["ball"], "value": np.linspace(1.0, 2.0, count).tolist(), "unit": "kg"},
            "g": f"{G} m s-2",
        }
        | (parameters or {}),
        mass={"y": "m"},
        forces={"weight": {"y": "-m*g"}},
        contacts=contacts,
        initial={
            "y": {"unit": "m", "value": places.tolist()},
            "v_y": {"unit": "m s-1", "value": [0.0] * count},
        },
        **more,
    )


def test_balls_of_a_column_carry_those_above() -> None:
    """Assert forces in thirty balls at rest on each other: between any two the weight above, and no rate is left."""
    depth = {"dims": ["ball"], "unit": "m", "value": [0.0] + [1.0] * 29}  # under all but the first
    model = balls(
        np.zeros(30),
        {
            "floor": {"gap": "y + depth", "restitution": E},
            "balls": {"gap": "second(y, next) - first(y, next)", "restitution": E},
        },
        {"depth": depth},
        relations={"next": {"of": "ball", "neighbours": 1}},
    )
    run = xd.simulate(model, until="20 ms", **STEPPED)
    last = run.closed_step.values == run.sizes["step"] - 1
    m = np.linspace(1.0, 2.0, 30)
    weights = G * np.cumsum(m[::-1])[::-1]
    assert run.closed_force.values[last] == pytest.approx(weights, rel=1e-9)
    assert np.abs(run.v_y.values).max() < 1e-12
    assert np.abs(run.closed_force_residual.values).max() < 1e-9


def test_balls_bounce_as_one_that_is_written_out_does() -> None:
    """Assert that forty balls over a floor have the digits of a model of one of them, at rest in the end."""
    places = np.linspace(0.2, 1.0, 40)
    run = xd.simulate(balls(places, {"floor": {"gap": "y", "restitution": E}}), until="1.5 s", **STEPPED)
    for k in (0, 17, 39):
        alone = xd.Model(
            name="ball",
            coordinates={"y": {"unit": "m"}},
            parameters={"m": f"{float(run.m[k])!r} kg", "g": f"{G} m s-2"},
            mass={"y": "m"},
            forces={"weight": {"y": "-m*g"}},
            contacts={"floor": {"gap": "y", "restitution": E}},
            initial={"y": f"{float(places[k])!r} m", "v_y": "0 m s-1"},
        )
        one = xd.simulate(alone, until="1.5 s", **STEPPED)
        assert run.y.values[:, k] == pytest.approx(one.y.values, rel=1e-12, abs=1e-14)
        assert run.contact_force_floor.values[:, k] == pytest.approx(one.contact_force_floor.values, rel=1e-9, abs=1e-9)
    assert run.sizes["event"] == 0
    assert run.contact_force_floor.values[-1, :10] == pytest.approx(G * np.linspace(1.0, 2.0, 40)[:10], rel=1e-12)


def test_blocks_slide_and_stick() -> None:
    """Assert that thirty blocks stop after v^2/(2*mu*g), with mu*m*g until then and none afterwards."""
    v = np.linspace(0.3, 0.9, 30)
    model = xd.Model(
        name="blocks",
        dimensions={"block": 30},
        coordinates={name: {"unit": "m", "dims": ["block"]} for name in ("x", "y")},
        parameters={"m": "2 kg", "g": f"{G} m s-2"},
        mass={"x": "m", "y": "m"},
        forces={"weight": {"y": "-m*g"}},
        contacts={
            "floor": {"gap": "y", "restitution": 0, "tangential": "coulomb", "slip": "v_x", "friction": MU},
        },
        initial={
            "x": "0*metre*index(block)",
            "y": "0*metre*index(block)",
            "v_x": {"unit": "m s-1", "value": v.tolist()},
            "v_y": "0*metre/second*index(block)",
        },
    )
    run = xd.simulate(model, until="0.4 s", **STEPPED)
    assert run.x.values[-1] == pytest.approx(v**2 / (2 * MU * G), abs=2 * MU * G * H**2)
    assert np.abs(run.v_x.values[-1]).max() < 1e-14
    drag = run.friction_force_floor.values
    assert drag[1:50] == pytest.approx(np.full((49, 30), -MU * 2 * G), rel=1e-12)
    assert np.abs(drag[-1]).max() < 1e-9
    does = run.closed_friction_state
    words = dict(zip(does.attrs["flag_values"].tolist(), does.attrs["flag_meanings"].split(), strict=True))
    told = {words[int(value)] for value in does.values[run.closed_step.values == run.sizes["step"] - 1]}
    first = {words[int(value)] for value in does.values[run.closed_step.values == 1]}
    assert told == {"sticking"}
    assert first.isdisjoint(told)


@pytest.fixture(scope="module")
def pile() -> xd.Model:
    """The rough pile of the data folder."""
    return xd.Model.from_text(PILE.read_text())


@pytest.fixture(scope="module")
def heap(pile: xd.Model) -> Any:
    """Its run by time-stepping, until it lies."""
    return xd.simulate(pile, method="moreau_jean", step="2 ms", until="1.2 s")


def test_a_heap_comes_to_rest(heap: Any) -> None:
    """Assert that the discs lie still, that floor and walls carry them, that friction is within its cone, energy falls."""
    assert heap.attrs["run_outcome"] == "completed"
    last = heap.closed_step.values == heap.sizes["step"] - 1
    contact, force = heap.closed_contact.values[last], heap.closed_force.values[last]
    names = heap.closed_contact.attrs["flag_meanings"].split()
    drag = heap.closed_friction_force.values[last]
    assert max(np.abs(heap[name].values[-1]).max() for name in ("v_x", "v_y", "v_theta")) < 1e-9
    assert force[contact == names.index("floor")].sum() + sum(
        drag[contact == names.index(wall)].sum() for wall in ("left", "right")
    ) == pytest.approx(float((heap.force_weight_y.values[-1] * -1).sum()), rel=1e-8)
    assert (np.abs(heap.closed_friction_force.values) <= 0.4 * heap.closed_force.values * (1 + 1e-9)).all()
    assert heap.closed_gap.values.min() > -0.01
    # directions turn while a step lasts, which is of second order in it
    assert np.diff(heap.total_energy.values).max() < 1e-5 * float(heap.total_energy[0])
    assert float(heap.total_energy[-1]) < 0.6 * float(heap.total_energy[0])


@pytest.mark.dear
def test_a_hundred_rough_discs_come_to_rest() -> None:
    """Assert that a heap of more links than pivots are for lies still, and that floor and walls carry it."""
    text = (
        PILE.read_text()
        .replace("disc = 24", "disc = 100")
        .replace('width = { value = "0.7 m"', 'width = { value = "1.505 m"')
    )
    wider = text.replace("disc), 6)", "disc), 13)").replace("disc)/6)", "disc)/13)")
    run = xd.simulate(xd.Model.from_text(wider), until="2 s", **STEPPED)
    assert run.attrs["run_outcome"] == "completed"
    last = run.closed_step.values == run.sizes["step"] - 1
    assert last.sum() > 128  # four unknowns each are more than 512
    assert max(np.abs(run[name].values[-1]).max() for name in ("v_x", "v_y", "v_theta")) < 1e-9
    names = run.closed_contact.attrs["flag_meanings"].split()
    contact, force = run.closed_contact.values[last], run.closed_force.values[last]
    drag = run.closed_friction_force.values[last]
    lifted = force[contact == names.index("floor")].sum() + sum(
        drag[contact == names.index(wall)].sum() for wall in ("left", "right")
    )
    mass = 25 * np.pi * run.radius.values**2
    assert lifted == pytest.approx(9.80665 * mass.sum(), rel=1e-7)


def test_a_heap_is_marched_again_from_its_record(pile: xd.Model, heap: Any, tmp_path: Path) -> None:
    """Assert the bits of a run that is extended, completed from its states, and reproduced; rows as samples give them."""
    part = xd.simulate(pile, method="moreau_jean", step="2 ms", until="0.3 s")
    whole = heap.isel(step=slice(0, 176))
    longer = xd.extend(part, until="0.35 s")
    assert np.array_equal(longer.x.values, whole.x.values)
    assert np.array_equal(longer.v_theta.values, whole.v_theta.values)
    states = xd.simulate(pile, method="moreau_jean", step="2 ms", until="0.3 s", log="states")
    assert xd.content_digest(xd.complete(states)) == xd.content_digest(part)
    xd.save(part, tmp_path / "part.nc")
    assert xd.reproduce(tmp_path / "part.nc").attrs["identical"] == 1
    samples = xd.sample(part, part.time.values[[40, 90, 150]])
    assert samples.y.values == pytest.approx(part.y.values[[40, 90, 150]], abs=1e-12)


def test_a_record_names_how_its_impulses_were_solved_for(heap: Any) -> None:
    """Assert that an archive of another way to solve for them is compared by its numbers, and that the reason is told."""
    assert "paths" in heap.attrs[CONTACT_ARITHMETIC]
    former = heap.copy()
    del former.attrs[CONTACT_ARITHMETIC]
    told = compare_reproduction(former, heap)
    assert told.attrs["identical"] == 1
    assert told.attrs["arithmetic"].startswith(
        "the archive has forces of contacts by 'one after the other, in the order of their declaration'"
    )
    assert compare_reproduction(heap, heap).attrs["arithmetic"] == ""
    smooth = balls(np.array([0.0, 1.0]), {"floor": {"gap": "y", "restitution": E}})
    assert CONTACT_ARITHMETIC not in xd.simulate(smooth, until="2 ms", **STEPPED).attrs


def test_laws_of_located_impacts_are_refused() -> None:
    """Assert that steps, which have Newton's law, are not recorded as of another one."""
    for law in ("poisson", "sequential", "energetic"):
        model = balls(np.linspace(0.2, 1.0, 40), {"floor": {"gap": "y", "restitution": E, "law": law}})
        with pytest.raises(xd.InputError, match=f"'moreau_jean' .* has Newton's law .* law = '{law}' is for"):
            xd.simulate(model, until="10 ms", **STEPPED)


def test_bodies_that_overlap_at_the_start_are_refused() -> None:
    """Assert that time-stepping begins apart, too."""
    model = balls(np.linspace(-0.01, 1.0, 40), {"floor": {"gap": "y", "restitution": E}})
    run = xd.simulate(model, until="10 ms", **STEPPED)
    assert run.attrs["run_outcome"] == "contact_penetrated"
    assert "begin apart" in run.attrs["run_outcome_text"]


def test_states_inside_steps_have_the_forces_of_the_record(heap: Any) -> None:
    """Assert that states are on parabolas between rows, that a heap at rest stays there, and that rows are met to the bit."""
    rows = heap.isel(step=slice(20, 24))
    start, end, h = rows.isel(step=0), rows.isel(step=1), 2e-3
    parts = np.array([0.25, 0.5, 0.9])
    found = xd.sample(heap, float(start.time) + parts * h)
    for k, part in enumerate(parts):
        assert found.v_x.values[k] == pytest.approx((1 - part) * start.v_x.values + part * end.v_x.values, abs=1e-12)
    at_rest = xd.sample(heap, [1.1991, 1.1997])
    for name in ("x", "y", "theta"):
        assert at_rest[name].values == pytest.approx(np.stack([heap[name].values[-1]] * 2), abs=1e-9)
    met = xd.sample(heap, heap.time.values[[30, 333]])
    assert np.array_equal(met.v_theta.values, heap.v_theta.values[[30, 333]])


def test_a_record_says_when_its_forces_act(pile: xd.Model, heap: Any) -> None:
    """Assert that forces are said to be means, gaps not to be held, and states inside steps to share impulses; else not."""
    said = [heap[name].attrs["long_name"] for name in ("closed_force", "closed_friction_force", "contact_force_floor")]
    assert all(", mean over the step before the row, positive" in words for words in said[:2])
    assert ", mean over the step before the row" in said[2]
    assert "held at zero, not it" in heap.closed_gap.attrs["long_name"]
    assert "rate" in heap.closed_force_residual.attrs["long_name"]
    assert "share of its time" in heap.attrs["solver_interpolation"]
    located = xd.simulate(pile, method="velocity_verlet", step="1 ms", until="3 ms")
    assert "mean" not in located.closed_force.attrs["long_name"]
    assert located.closed_gap.attrs["long_name"] == "gap of the link, which is held at zero"
    assert "share" not in located.attrs["solver_interpolation"]


def test_its_picture_and_diagnosis_tell_what_contacts_took(pile: xd.Model, heap: Any) -> None:
    """Assert that the panel of energies names contacts, and that turns and extremes are found without more solutions."""
    titles = [axes.get_title(loc="left") for axes in xd.plot(heap, only="energy").axes]
    assert any("contacts" in title for title in titles), titles
    assert not any("alone" in title for title in titles)
    short = xd.simulate(pile, method="moreau_jean", step="2 ms", until="0.3 s")
    diagnosis = xd.diagnose(short)
    assert (diagnosis.continuity_defect_x <= diagnosis.continuity_bound_x).all()
    assert int(diagnosis.continuity_steps) == 150
    keep = ["maximum_y", "minimum_v_x"]
    sweep = xd.sweep(pile, {"mu": [0.4]}, method="moreau_jean", step="2 ms", until="0.3 s", keep=keep).isel(mu=0)
    for name in (f"{word}{end}" for word in keep for end in ("", "_time", "_rule", "_uncertainty")):
        np.testing.assert_array_equal(sweep[name].values, diagnosis[name].values, err_msg=name)
    assert (sweep.maximum_y_rule == 0).all()  # accepted states alone

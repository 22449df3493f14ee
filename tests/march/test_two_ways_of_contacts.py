"""Contacts over few links are written out, those over many are found as the march goes: two programs, one motion."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import xdynamics as xd

DX, DY = "(second(x, pair) - first(x, pair))", "(second(y, pair) - first(y, pair))"
DISTANCE = f"sqrt({DX}**2 + {DY}**2)"
ALONG = f"({DX}*(second(v_y, pair) - first(v_y, pair)) - {DY}*(second(v_x, pair) - first(v_x, pair)))/{DISTANCE}"


def rough(slip: str, friction: float) -> dict[str, Any]:
    """Return the keys of Coulomb's friction."""
    return {"tangential": "coulomb", "slip": slip, "friction": friction, "static": friction + 0.1}


def box(seed: int, count: int, law: str, *, rubs: bool, falls: bool, unused: str) -> xd.Model:
    """Return discs in a square box that strike each other and its walls."""
    draw = np.random.default_rng(seed)
    places = np.array([[0.3, 0.4], [0.9, 0.5], [0.6, 1.1]])[:count] + draw.uniform(-0.1, 0.1, (count, 2))
    speeds, restitution = draw.normal(0.0, 3.0, (count, 2)), float(draw.uniform(0.4, 1.0))
    shared = {"restitution": restitution, "law": law}
    contacts = {"discs": {"gap": f"{DISTANCE} - 2*radius"} | shared | (rough(ALONG, 0.3) if rubs else {})}
    for name, across in (("x", "y"), ("y", "x")):
        for side, gap in (("low", f"{name} - radius"), ("high", f"width - radius - {name}")):
            contacts[f"{side}_{name}"] = {"gap": gap} | shared | (rough(f"v_{across}", 0.2) if rubs else {})
    columns = {"x": places[:, 0], "y": places[:, 1], "v_x": speeds[:, 0], "v_y": speeds[:, 1]}
    return xd.Model(
        name="box",
        dimensions={"disc": count},
        relations={"pair": {"of": "disc"}},
        coordinates={name: {"unit": "m", "dims": ["disc"]} for name in "xy"},
        parameters={
            "m": {"dims": ["disc"], "unit": "kg", "value": draw.uniform(0.5, 2.0, count).tolist()},
            "radius": "0.1 m",
            "width": "1.5 m",
            "g": "9.81 m s-2",
            unused: "1 m",  # laws are kept by the names that they may read
        },
        mass={"x": "m", "y": "m"},
        forces={"weight": {"y": "-m*g"}} if falls else {},
        contacts=contacts,
        initial={
            name: {"unit": "m s-1" if "_" in name else "m", "value": column.tolist()}
            for name, column in columns.items()
        },
    )


CASES = [(1, 2, "newton", True, False), (2, 2, "poisson", True, True), (3, 3, "newton", False, True)]


@pytest.mark.dear
@pytest.mark.parametrize(("seed", "count", "law", "rubs", "falls"), CASES)
def test_few_links_move_as_many_do(
    seed: int, count: int, law: str, rubs: bool, falls: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert that discs in a box are at the same places after a second, by the same impacts."""
    asked: dict[str, Any] = {"method": "dop853", "rtol": 1e-11, "until": "1 s"}
    few = box(seed, count, law, rubs=rubs, falls=falls, unused="few")
    monkeypatch.setattr("xdynamics.model.elements.MOST_REACTIONS", 0)
    many = box(seed, count, law, rubs=rubs, falls=falls, unused="many")
    assert not few.assemblies
    assert many.assemblies
    one, other = (xd.simulate(model, **asked) for model in (few, many))
    assert one.attrs["run_outcome"] == other.attrs["run_outcome"] == "completed"
    assert one.sizes["event"] > 2
    for name in ("x", "y", "v_x", "v_y"):
        assert np.abs(one[name].values[-1] - other[name].values[-1]).max() < 1e-8
    first = slice(3)
    assert other.event_time.values[first] == pytest.approx(one.event_time.values[first], abs=1e-9)
    for name in ("event_impulse_first_x", "event_impulse_second_y", "event_energy_lost"):
        assert other[name].values[first] == pytest.approx(one[name].values[first], abs=1e-8)

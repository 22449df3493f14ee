"""Which events a step holds, and of what kind: nothing is missed, nothing is seen that is not there."""

from __future__ import annotations

import math
import tomllib
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.march import March, march_many
from xdynamics.march.configuration import settings_for
from xdynamics.schema import CLUSTER, CROSSING, EVENT_KINDS, JUMP, POLE, REASON_ERROR, TOUCH

T = "t/(1*second)"
ACCURATE = [name for name, one in xd.METHODS.items() if one.order >= 4]


def clock(
    function: str,
    *,
    direction: str = "either",
    action: str = "record",
    start: float = 0.0,
    until: float = 1.0,
    **asked: Any,
) -> xr.Dataset:
    """A particle that moves freely, and an event that only time tells of."""
    model = xd.Model(
        name="clock",
        coordinates={"x": "m"},
        parameters={"m": "1 kg"},
        mass={"x": "m"},
        forces={},
        initial={"t": f"{start!r} s", "x": "0 m", "v_x": "1 m s-1"},
        events={"e": {"function": function, "direction": direction, "action": action}},
    )
    return xd.simulate(model, until=until, **({"method": "rk4", "step": 0.1} | asked))


CLASSES: dict[str, tuple[str, dict[str, Any], list[float], int]] = {  # function, settings, times, kind
    "two roots in one step": (f"({T} - 0.52)*({T} - 0.57)", {}, [0.52, 0.57], CROSSING),
    "five roots in one step": (
        f"({T}-0.51)*({T}-0.53)*({T}-0.55)*({T}-0.57)*({T}-0.59)",
        {},
        [0.51, 0.53, 0.55, 0.57, 0.59],
        CROSSING,
    ),
    "touch": (f"({T} - 0.55)**2", {}, [0.55], TOUCH),
    "touch from below": (f"-({T} - 0.55)**2", {}, [0.55], TOUCH),
    "near miss by 1e-6": (f"({T} - 0.55)**2 + 1e-6", {}, [], CROSSING),
    "near pair by 1e-6": (f"({T} - 0.55)**2 - 1e-6", {}, [0.549, 0.551], CROSSING),
    "zero at the start": (T, {}, [], CROSSING),
    "zero at the start without slope": (f"{T}**2", {}, [], CROSSING),
    "zero at the start, and again": (f"{T}*({T} - 0.04)", {}, [0.04], CROSSING),
    "zero at a step's end": (f"{T} - 0.5", {}, [0.5], CROSSING),
    "touch at a step's end": (f"({T} - 0.5)**2", {}, [0.5], TOUCH),
    "zero at the final time": (f"{T} - 1", {}, [1.0], CROSSING),
    "touch at the final time": (f"({T} - 1)**2", {}, [1.0], TOUCH),
    "cubic root": (f"({T} - 0.55)**3", {}, [0.55], CLUSTER),
    "scaled by 1e200": (f"1e200*({T} - 0.55)", {}, [0.55], CROSSING),
    "scaled by 1e-200": (f"1e-200*({T} - 0.55)", {}, [0.55], CROSSING),
    "pair scaled by 1e-300": (f"1e-300*(({T} - 0.52)*({T} - 0.57))", {}, [0.52, 0.57], CROSSING),
    "jump": (f"where({T} < 0.55, -1, 1)", {}, [0.55], JUMP),
    "jump up and down again": (f"where(abs({T} - 0.55) < 0.01, 1, -1)", {}, [0.54, 0.56], JUMP),
    "sign": (f"sign({T} - 0.553)", {}, [0.553], JUMP),
    "kink over zero": (f"abs({T} - 0.55) - 0.02", {}, [0.53, 0.57], CROSSING),
    "kink at zero": (f"abs({T} - 0.55)", {}, [0.55], TOUCH),
    "crossing at a kink": (f"max({T} - 0.55, 3*({T} - 0.55))", {}, [0.55], CROSSING),
    "pole": (f"1/({T} - 0.553)", {}, [0.553], POLE),
    "pole without a change of sign": (f"1/({T} - 0.553)**2", {}, [], POLE),
    "slow, behind the year 30": (
        f"({T} - 1e9 - 0.52)*({T} - 1e9 - 0.57)",
        {"start": 1e9, "until": 1e9 + 1},
        [1e9 + 0.52, 1e9 + 0.57],
        CROSSING,
    ),
    "318 in ten seconds": (f"sin(100*{T})", {"until": 10.0}, [k * math.pi / 100 for k in range(1, 319)], CROSSING),
    "63 in a step": (
        f"sin(100*{T})",
        {"until": 10.0, "step": 2.0},
        [k * math.pi / 100 for k in range(1, 319)],
        CROSSING,
    ),
    "three touches": (f"cos(2*{T}) - 1", {"until": 10.0}, [math.pi, 2 * math.pi, 3 * math.pi], TOUCH),
    "rising alone": (f"sin(10*{T})", {"direction": "rising"}, [math.pi / 5], CROSSING),
    "falling alone": (f"sin(10*{T})", {"direction": "falling"}, [math.pi / 10, 3 * math.pi / 10], CROSSING),
    "flat to every order": (
        f"exp(-1/({T} - 0.55)**2) - 1e-30",
        {},
        [0.55 - 30**-0.5 * math.log(10) ** -0.5, 0.55 + 30**-0.5 * math.log(10) ** -0.5],
        CROSSING,
    ),
    "steep": (f"tanh(1e9*({T} - 0.553))", {}, [0.553], CROSSING),
    "two closer than their tolerance": (f"({T} - 0.55)*({T} - 0.55 - 1e-14)", {}, [0.55], TOUCH),
}


@pytest.mark.every(7)
@pytest.mark.parametrize(
    "asked", [{}, {"step": 0.37}, {"method": "dop853", "step": None, "rtol": 1e-6}], ids=["rk4", "long", "adaptive"]
)
@pytest.mark.parametrize("name", CLASSES)
def test_classes_of_events(name: str, asked: dict[str, Any]) -> None:
    """Assert time and kind of every event, whatever the steps."""
    function, settings, times, kind = CLASSES[name]
    found = clock(function, **(asked | settings if "step" not in settings else settings))
    assert found.attrs["run_outcome"] == "completed"
    assert found.event_time.values == pytest.approx(times, rel=1e-15, abs=2e-8 if kind in (TOUCH, CLUSTER) else 2e-12)
    assert {EVENT_KINDS[one] for one in found.event_kind.values} <= {EVENT_KINDS[kind]}
    off, doubt = np.abs(found.event_time.values - times), found.event_time_uncertainty.values
    assert (off <= doubt + 4e-16 * np.abs(times)).all()


def corner(first: float, second: float, *, speed: float = 1.0, **asked: Any) -> xr.Dataset:
    """A particle that flies into a corner of two walls."""
    model = xd.Model(
        name="corner",
        coordinates={"x": "m", "y": "m"},
        parameters={"m": "1 kg"},
        mass={"x": "m", "y": "m"},
        forces={},
        initial={"x": "0 m", "v_x": f"{speed!r} m s-1", "y": "0 m", "v_y": f"{speed!r} m s-1"},
        events={"one": {"function": f"x - {first!r}*metre"}, "other": {"function": f"y - {second!r}*metre"}},
    )
    return xd.simulate(model, until=1.0, **asked)


KINDS_OF_STEP: list[dict[str, Any]] = [
    {"method": "rk4", "step": 0.1},
    {"method": "rk4", "step": 0.37},
    {"method": "dop853", "rtol": 1e-6},
]


@pytest.mark.parametrize("asked", KINDS_OF_STEP, ids=["rk4", "long", "adaptive"])
@pytest.mark.parametrize("apart", [0.0, 1e-13, -1e-13])
def test_two_walls_at_once(apart: float, asked: dict[str, Any]) -> None:
    """Assert that walls reached within the time tolerance are one group in declared order, whichever is nearer."""
    run = corner(0.553, 0.553 + apart, **asked)
    assert run.event_detector.values.tolist() == [0, 1]
    assert len(set(run.event_row_before.values)) == 1
    assert run.event_time.values == pytest.approx([0.553, 0.553], abs=1.1e-12)


@pytest.mark.parametrize("asked", KINDS_OF_STEP, ids=["rk4", "long", "adaptive"])
def test_thin_slab_at_high_speed(asked: dict[str, Any]) -> None:
    """Assert that two walls a micrometre apart are both met at 10 km/s, one after the other."""
    run = corner(5003.300001, 5003.3, speed=1e4, **asked)
    assert run.event_detector.values.tolist() == [1, 0]
    assert run.event_time.values == pytest.approx([0.50033, 0.5003300001], rel=1e-14)


@pytest.mark.every(3)
@pytest.mark.parametrize("unit", ["nm", "m", "Gm"])
def test_events_at_any_scale(unit: str) -> None:
    """Assert that the same motion in other lengths has the same events at the same times, to rounding."""
    functions = {"near": "x - c", "wave": "sin(x/A) - 0.3", "product": "x*v_x", "angle": "atan2(x, c)"}
    model = xd.Model(
        name="scale",
        coordinates={"x": unit},
        parameters={"m": "1 kg", "k": "4 N m-1", "c": f"0.999 {unit}", "A": f"1 {unit}"},
        mass={"x": "m"},
        forces={"spring": {"x": "-k*x"}},
        initial={"x": f"1 {unit}", "v_x": f"0 {unit} s-1"},
        events={name: {"function": function} for name, function in functions.items()},
    )
    run = xd.simulate(model, method="dop853", rtol=1e-9, until=10.0)
    counts = [int((run.event_detector.values == i).sum()) for i in range(4)]
    assert counts == [7, 6, 12, 6]
    times = run.event_time.values[run.event_detector.values == 3]
    assert times == pytest.approx(math.pi / 4 + math.pi / 2 * np.arange(6), abs=1e-8)


def swinging(*levels: float, **asked: Any) -> xr.Dataset:
    """The oscillator cos 2t, watched at some levels."""
    statement = tomllib.loads((MODELS / "harmonic_oscillator.toml").read_text(encoding="utf-8"))
    statement |= {"events": {f"e{i}": {"function": f"x - {level!r}*metre"} for i, level in enumerate(levels)}}
    return xd.simulate(xd.Model(**statement), **asked)


@pytest.mark.every(3)
@pytest.mark.parametrize("asked", [{"rtol": 1e-6}, {"step": 0.05}], ids=["adaptive", "fixed"])
@pytest.mark.parametrize("method", ACCURATE)
def test_crossings_near_the_crest(method: str, asked: dict[str, Any]) -> None:
    """Assert that the oscillator crosses levels right below its crest 80 times in 40 periods, each where it does."""
    doubled = {"estimator": "step_doubling"} if "rtol" in asked and not xd.METHODS[method].estimate else {}
    levels = (0.97, 0.99, 0.999)
    run = swinging(*levels, method=method, until=40 * math.pi, **asked, **doubled)
    for i, level in enumerate(levels):
        mine = run.event_detector.values == i
        half, turns = math.acos(level) / 2, np.arange(40) * math.pi
        assert run.event_time.values[mine] == pytest.approx(
            np.ravel([turns + half, turns + math.pi - half], "F"), abs=2e-3
        )
        assert run.event_direction.values[mine].tolist() == [-1, 1] * 40


def test_event_inside_a_rejected_trial() -> None:
    """Assert that an event in a trial that the error test rejects is found in the steps behind it, once."""
    run = swinging(0.2, method="dop853", rtol=1e-9, step=3.0, until=3.0)
    failed = run.trial_reason.values == REASON_ERROR
    reach = (run.trial_time + run.trial_step_size).values[failed].max()
    times = [math.acos(0.2) / 2, math.pi - math.acos(0.2) / 2]
    assert reach > times[-1]
    assert run.event_time.values == pytest.approx(times, abs=1e-8)


def test_a_log_has_room_for_the_most_laborious_step() -> None:
    """Assert that steps near a border, with events that chatter and touch, never write behind a log of few rows."""
    functions = (f"sqrt(0.55 - {T})", f"sin(1/({T} - 0.5499))", f"({T} - 0.5499)**2", f"sin(3000*{T})")
    model = xd.Model(
        name="laborious",
        coordinates={"x": "m"},
        parameters={"m": "1 kg"},
        mass={"x": "m"},
        forces={},
        initial={"x": "0 m", "v_x": "1 m s-1"},
        events={f"e{i}": {"function": function} for i, function in enumerate(functions)},
    )
    march = March(model, settings_for(model, method="rk4", step=0.1, until=0.54))
    assert max(block.trials - len(block.log.trials) for block in march.blocks(7)) <= 0


@pytest.mark.parametrize(
    ("asked", "doubt"), [({"method": "rk4", "step": 0.07}, 2e-12), ({"method": "dop853", "rtol": 1e-8}, 1e-4)]
)
def test_a_tank_is_empty_where_its_law_ends(asked: dict[str, Any], doubt: float) -> None:
    """Assert that h' = -2 sqrt(h) stops where it has no law any more; with an error of h, its root tells the time's."""
    model = xd.Model(
        name="tank",
        states={"h": {"unit": "1", "rate": "-2*sqrt(h)/second"}},
        initial={"h": "1"},
        events={"empty": {"function": "h", "direction": "falling", "action": "stop"}},
    )
    run = xd.simulate(model, until=3.0, **asked)
    assert run.attrs["run_outcome"] == "stopped_by_event"
    assert EVENT_KINDS[run.event_kind.values[0]] == "touch"
    assert float(run.h[-1]) < 1e-15
    assert 1e-16 < float(run.event_time_uncertainty[0]) < doubt


def test_runs_one_behind_the_other_forget_the_last() -> None:
    """Assert that where an event is armed does not depend on the run that was marched in the same place before."""
    model = xd.Model(
        name="free",
        coordinates={"x": "m"},
        parameters={"m": "1 kg", "c": "1e-12 m"},
        mass={"x": "m"},
        forces={},
        initial={"x": "0 m", "v_x": "1 m s-1"},
        events={"e": {"function": "x - c"}},
    )
    settings = settings_for(model, method="rk4", step=0.5, until=10.0)
    both = march_many(model, settings, parameters={"c": [5.0, 1e-12]})
    alone = march_many(model, settings, parameters={"c": [1e-12]})
    assert len(alone.events_of(0)) == 1
    assert both.events_of(1).tobytes() == alone.events_of(0).tobytes()

"""Which events a step holds, and of what kind: nothing is missed, nothing is seen that is not there."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from xdynamics.schema import CLUSTER, CROSSING, EVENT_KINDS, JUMP, POLE, TOUCH

T = "t/(1*second)"
EXPLICIT = [name for name, one in xd.METHODS.items() if one.order >= 4 and not one.implicit]


def clock(function: str, *, direction: str = "either", action: str = "record", start: float = 0.0, until: float = 1.0, **asked: Any) -> xr.Dataset:  # fmt: skip
    """A particle that moves freely, and an event that only time tells of."""
    model = xd.Model(
        name="clock", coordinates={"x": "m"}, parameters={"m": "1 kg"}, mass={"x": "m"}, forces={},
        initial={"t": f"{start!r} s", "x": "0 m", "v_x": "1 m s-1"},
        events={"e": {"function": function, "direction": direction, "action": action}},
    )  # fmt: skip
    return xd.simulate(model, until=until, **({"method": "rk4", "step": 0.1} | asked))


CLASSES: dict[str, tuple[str, dict[str, Any], list[float], int]] = {  # function, settings, times, kind
    "two roots in one step": (f"({T} - 0.52)*({T} - 0.57)", {}, [0.52, 0.57], CROSSING),
    "five roots in one step": (f"({T}-0.51)*({T}-0.53)*({T}-0.55)*({T}-0.57)*({T}-0.59)", {}, [0.51, 0.53, 0.55, 0.57, 0.59], CROSSING),
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
    "slow, behind the year 30": (f"({T} - 1e9 - 0.52)*({T} - 1e9 - 0.57)", {"start": 1e9, "until": 1e9 + 1}, [1e9 + 0.52, 1e9 + 0.57], CROSSING),
    "318 in ten seconds": (f"sin(100*{T})", {"until": 10.0}, [k * math.pi / 100 for k in range(1, 319)], CROSSING),
    "63 in a step": (f"sin(100*{T})", {"until": 10.0, "step": 2.0}, [k * math.pi / 100 for k in range(1, 319)], CROSSING),
    "three touches": (f"cos(2*{T}) - 1", {"until": 10.0}, [math.pi, 2 * math.pi, 3 * math.pi], TOUCH),
    "rising alone": (f"sin(10*{T})", {"direction": "rising"}, [math.pi / 5], CROSSING),
    "falling alone": (f"sin(10*{T})", {"direction": "falling"}, [math.pi / 10, 3 * math.pi / 10], CROSSING),
    "flat to every order": (f"exp(-1/({T} - 0.55)**2) - 1e-30", {}, [0.55 - 30 ** -0.5 * math.log(10) ** -0.5, 0.55 + 30 ** -0.5 * math.log(10) ** -0.5], CROSSING),
    "steep": (f"tanh(1e9*({T} - 0.553))", {}, [0.553], CROSSING),
    "two closer than their tolerance": (f"({T} - 0.55)*({T} - 0.55 - 1e-14)", {}, [0.55], TOUCH),
}  # fmt: skip


@pytest.mark.parametrize("asked", [{}, {"step": 0.37}, {"method": "dop853", "step": None, "rtol": 1e-6}], ids=["rk4", "long", "adaptive"])  # fmt: skip
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

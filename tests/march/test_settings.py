"""The settings of a march, made by hand: every fault with its value and what is needed, at the very bound."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.problems import oscillator, particle
from xdynamics.march.configuration import settings_for
from xdynamics.march.settings import Pacing, Settings, given_times
from xdynamics.march.tolerances import LEAST_RTOL, Tolerances
from xdynamics.methods.steppers import EXACT
from xdynamics.model.motion import variables
from xdynamics.shapes.blocks import Block, Blocks
from xdynamics.units import Scales, Unit, parse_unit

METHODS = xd.METHODS
MODEL = oscillator().model
UNITS = {name: MODEL.units[name] for name in variables(MODEL)}
EVERY = {"x": 1e-6, "v_x": 1e-6}


def faults_of(model: xd.Model = MODEL, method: str = "dormand_prince", **asked: Any) -> tuple[str, ...]:
    """Return what is said of settings; nothing if a march can use them."""
    try:
        Settings(METHODS[method], **{"until": 1.0, "step": 0.1} | asked).check(model)
    except xd.InputError as error:
        return error.faults
    return ()


def pulled_back(x: float) -> float:
    """Return a force in SI units, in Python."""
    return -x


def tolerances(rtol: float = 1e-6, atol: dict[str, float] | None = None, bare: float | None = None) -> Tolerances:
    """Tolerances of the oscillator."""
    return Tolerances(rtol, EVERY if atol is None else atol, UNITS, bare)


CHOSEN: dict[str, Any] = {"tolerances": tolerances(), "estimator": "embedded"}


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"until": 0.0}, "until is 0.0 s, needs a time after the start at t = 0.0 s"),
        ({"until": -1.0}, "until is -1.0 s, needs a time after the start at t = 0.0 s"),
        ({"until": math.nan}, "until is nan s, needs a time after the start at t = 0.0 s"),
        ({"until": math.inf}, "until is inf s, needs a time after the start at t = 0.0 s"),
        ({"step": 0.0}, "step is 0.0 s, needs a positive time"),
        ({"step": math.inf}, "step is inf s, needs a positive time"),
        ({"step": 2.0**-54}, "step 5.551115123125783e-17 s makes over 2**53 steps to 1.0 s; take a longer one"),
        ({"step": ()}, "step has no entry, needs positive times"),
        ({"step": (0.5, math.inf)}, "step has inf s, needs positive times"),
        ({"step": (0.5, 0.0, -2.0)}, "step has 0.0 s, needs positive times"),
        ({"step": (0.5, 0.25)}, "step has 2 steps up to t = 0.75 s, needs to reach until = 1.0 s"),
        ({"nodes": (0.0,)}, "nodes has 0.0 s, needs times between the start at t = 0.0 s and until = 1.0 s"),
        ({"nodes": (0.5, 1.0)}, "nodes has 1.0 s, needs times between the start at t = 0.0 s and until = 1.0 s"),
        ({"keep_every": 0}, "keep_every is 0, needs a whole number from 1, every row, to 2**53"),
        ({"keep_every": 2**53 + 1}, f"keep_every is {2**53 + 1}, needs a whole number from 1, every row, to 2**53"),
        ({"time_tolerance": 0.0}, "time_tolerance is 0.0 s, needs a positive time"),
        ({"time_tolerance": math.inf}, "time_tolerance is inf s, needs a positive time"),
        ({"math_functions": "sin"}, "math_functions is 'sin'; there are 'xdynamics 1', 'xdynamics 2'"),
        (
            {"event_root_method": "guess"},
            "event_root_method is 'guess'; there are 'earliest first', 'earliest first by Hermite', 'one by one'",
        ),
        ({"jacobian": "guess"}, "jacobian is 'guess'; there are exact, differences"),
        ({"jacobian": "differences"}, "jacobian = 'differences' is for radau_iia, and the method is 'dormand_prince'"),
        ({"summation": "exact"}, "summation is 'exact'; there are plain, compensated"),
        ({"switches": "ignored"}, "switches is 'ignored'; there are 'located', 'landed on', 'stepped over'"),
        (
            {"estimator": "guess"},
            "estimator is 'guess'; there are none, embedded, step_doubling, step_doubling_extrapolated",
        ),
        ({"pacing": Pacing(safety=1.0)}, "safety is 1.0, needs a number between 0 and 1"),
        ({"pacing": Pacing(safety=0.0)}, "safety is 0.0, needs a number between 0 and 1"),
        ({"pacing": Pacing(growth_limits=(0.0, 5.0))}, "growth_limits are (0.0, 5.0), need 0 < least < 1 < greatest"),
        ({"pacing": Pacing(growth_limits=(1.0, 5.0))}, "growth_limits are (1.0, 5.0), need 0 < least < 1 < greatest"),
        ({"pacing": Pacing(growth_limits=(0.2, 1.0))}, "growth_limits are (0.2, 1.0), need 0 < least < 1 < greatest"),
        (
            {"pacing": Pacing(growth_limits=(0.2, math.inf))},
            "growth_limits are (0.2, inf), need 0 < least < 1 < greatest",
        ),
        ({"pacing": Pacing(min_step=-1.0)}, "min_step is -1.0 s, needs a non-negative time"),
        ({"pacing": Pacing(max_step=0.0)}, "max_step is 0.0 s, needs a positive time"),
        ({"pacing": Pacing(min_step=0.5, max_step=0.25)}, "min_step is 0.5 s, needs to be at most max_step = 0.25 s"),
        ({"pacing": Pacing(min_step=1.5)}, "min_step is 1.5 s, needs to be at most the span of 1.0 s"),
        ({"pacing": Pacing(max_steps=0)}, "max_steps is 0, needs a positive number"),
        (CHOSEN | {"estimator": "none"}, "tolerances need an error estimate; take estimator = 'step_doubling'"),
        (
            CHOSEN | {"pacing": Pacing(max_step=0.05)},
            "step, the first one, is 0.1 s, needs to be from min_step = 0.0 s to max_step = 0.05 s",
        ),
        (
            CHOSEN | {"pacing": Pacing(min_step=0.2)},
            "step, the first one, is 0.1 s, needs to be from min_step = 0.2 s to max_step = inf s",
        ),
        (
            CHOSEN | {"tolerances": tolerances(1.0)},
            "rtol is 1.0, needs a number from 10 eps = 2.22e-15, below which rounding is as large, to 1",
        ),
        (
            CHOSEN | {"tolerances": tolerances(atol={"x": math.inf})},
            "atol of 'x' is inf, needs a finite non-negative number",
        ),
        (CHOSEN | {"tolerances": tolerances(bare=-1.0)}, "atol is -1.0, needs a finite non-negative number"),
        (CHOSEN | {"tolerances": tolerances(atol={"z": 1.0})}, "atol names 'z', which is none of x, v_x"),
        (
            CHOSEN | {"tolerances": tolerances(atol={"v_x": 0.0})},
            "atol of 'v_x' is 0 and v_x starts at 0: its error would have no scale; give it a positive one",
        ),
    ],
)
def test_one_fault(asked: dict[str, Any], said: str) -> None:
    """Assert that each fault is said alone, in these words."""
    assert faults_of(**asked) == (said,)


@pytest.mark.parametrize(
    ("method", "asked", "said"),
    [
        ("rk4", {"estimator": "embedded"}, "method 'rk4' has no embedded formula; take estimator = 'step_doubling'"),
        (
            "radau_iia",
            {"summation": "compensated"},
            "summation = 'compensated' is for methods that add to the state, and 'radau_iia' does not",
        ),
        (
            "rk4",
            {"tolerances": tolerances(1e-13), "estimator": "step_doubling"},
            (
                f"rtol is 1e-13, for which a step of 'rk4' would need {1e-13 ** (5 / 4):.3g}, less than rounding;"
                f" take {LEAST_RTOL ** (4 / 5):.2g} or more, step_doubling_extrapolated or a method of higher order"
            ),
        ),
    ],
)
def test_one_fault_of_a_method(method: str, asked: dict[str, Any], said: str) -> None:
    """Assert what is said of settings that another method would take."""
    assert faults_of(method=method, **asked) == (said,)
    assert faults_of(method=method) == ()


@pytest.mark.parametrize(
    "asked",
    [
        {"step": None},
        {"step": 2.0**-53},
        {"step": 5.0},
        {"step": (0.5, 0.5)},
        {"step": (0.1,) * 10},
        {"step": (0.75, 0.5)},
        {"nodes": (0.25, 0.5)},
        {"keep_every": 1},
        {"keep_every": 2**53},
        {"math_functions": "xdynamics 1"},
        {"event_root_method": "one by one"},
        {"event_root_method": "earliest first by Hermite"},
        {"summation": "compensated"},
        {"switches": "located everywhere"},
        {"pacing": Pacing(min_step=1.0)},
        {"pacing": Pacing(min_step=0.25, max_step=0.25)},
        {"pacing": Pacing(max_steps=1)},
        CHOSEN | {"pacing": Pacing(max_step=0.1)},
        CHOSEN | {"pacing": Pacing(min_step=0.1)},
        CHOSEN | {"step": (0.5, 0.5), "estimator": "none"},
        CHOSEN | {"step": (0.5, 0.5), "pacing": Pacing(max_step=0.1)},
        CHOSEN | {"tolerances": tolerances(LEAST_RTOL)},
        CHOSEN | {"tolerances": tolerances(atol={"x": 0.0})},
        CHOSEN | {"tolerances": tolerances(atol={"v_x": 1.0}, bare=0.0)},
    ],
)
def test_settings_at_their_bounds(asked: dict[str, Any]) -> None:
    """Assert that what lies on a bound is taken."""
    assert faults_of(**asked) == ()


def test_the_start_counts() -> None:
    """Assert that a span is from the start, wherever that is."""
    late = MODEL.replace(initial={"t": 3.0})
    assert faults_of(late, until=3.5) == ()
    assert faults_of(late, until=3.0) == ("until is 3.0 s, needs a time after the start at t = 3.0 s",)
    assert faults_of(late, until=4.0, step=(0.5, 0.5)) == ()
    assert faults_of(late, until=4.0, step=2.0**-53) == ()
    assert faults_of(late, until=4.0, pacing=Pacing(min_step=1.5)) == (
        "min_step is 1.5 s, needs to be at most the span of 1.0 s",
    )
    said = "nodes has 0.5 s, needs times between the start at t = 3.0 s and until = 4.0 s"
    assert faults_of(late, until=4.0, nodes=(0.5, 3.5)) == (said,)
    with pytest.raises(xd.InputError, match=r"^until is 1.0 s, needs a time after the start at t = 3.0 s$"):
        Settings(METHODS["rk4"], until=1.0, step=0.1, pacing=Pacing(min_step=0.5)).check(late)


def test_several_faults_are_numbered() -> None:
    """Assert that all of them are said at once, in the order in which they are checked."""
    settings = Settings(METHODS["rk4"], until=1.0, step=0.0, keep_every=0, math_functions="sin")
    with pytest.raises(xd.InputError) as raised:
        settings.check(MODEL)
    head, *faults = str(raised.value).splitlines()
    assert head == f"the run of '{MODEL.name}' cannot be set up:"
    assert [fault.strip()[:18] for fault in faults] == [
        "1. step is 0.0 s, ",
        "2. math_functions ",
        "3. keep_every is 0",
    ]
    assert [fault.split()[0] for fault in raised.value.faults] == ["step", "math_functions", "keep_every"]


def test_scales_where_there_is_none() -> None:
    """Assert that time is not scaled where it is a pure number, and a function in Python is not scaled at all."""
    decay = {"z": {"unit": "1", "rate": "-z"}}
    pure = xd.Model(name="pure", time={"unit": "1"}, states=decay, initial={"z": "1"})
    said = "the scale of time is 2.0 s, and the model's time is a pure number: leave it out"
    assert faults_of(pure, scales=Scales(time=2.0)) == (said,)
    assert faults_of(pure, scales=Scales(length=2.0)) == faults_of(scales=Scales(time=2.0)) == ()
    python = particle(pulled_back)
    assert faults_of(python, scales=Scales(length=2.0)) == (
        "scales do not go with functions in Python, which are written in SI units",
    )
    assert faults_of(python) == ()


def test_given_times() -> None:
    """Assert sums one after the other, and that one that differs from the end by rounding alone is the end."""
    assert given_times(1.0, (0.5, 0.25), 3.0) == [1.5, 1.75]
    tenths = given_times(0.0, (0.1,) * 10, 1.0)
    assert tenths[:3] == [0.1, 0.2, 0.1 + 0.1 + 0.1]
    assert tenths[-2] + 0.1 != tenths[-1] == 1.0
    slack = 4 * 2**-52 * 2 * 8.0  # of two steps, near the larger of both ends
    assert given_times(-8.0, (3.0, 4.0 + slack), -1.0)[-1] == -1.0
    assert given_times(-8.0, (3.0, 4.0 + 1.5 * slack), -1.0)[-1] == -1.0 + 1.5 * slack
    assert given_times(1.0, (3.0, 4.0 - slack), 8.0)[-1] == 8.0


def test_tolerances_of_a_variable() -> None:
    """Assert that its own goes first, then that of all in its unit, else none."""
    units = {"x": parse_unit("mm"), "v_x": parse_unit("m s-1")}
    some = Tolerances(1e-6, {"x": 0.5}, units)
    assert (some.atol_of("x"), some.atol_of("v_x")) == (0.5, None)
    bare = Tolerances(1e-6, {"v_x": 0.5}, units, 2.0)
    assert (bare.atol_of("x"), bare.atol_of("v_x")) == (2e-3, 0.5)
    assert hash(some) == hash(Tolerances(1e-6, {"x": 0.5}, {}))
    assert hash(some) != hash(bare)


def test_tolerances_of_blocks() -> None:
    """Assert the same of every number of blocks, and that a name that none has is left out."""
    units: dict[str, Unit] = {"x": parse_unit("mm"), "v_x": parse_unit("m s-1")}
    blocks = Blocks([Block("x", "coordinate"), Block("v_x", "velocity")])
    some = Tolerances(1e-6, {"v_x": 0.5, "elsewhere": 3.0}, units)
    assert np.array_equal(some.of_all(blocks), [np.nan, 0.5], equal_nan=True)
    assert Tolerances(1e-6, {"v_x": 0.5}, units, 2.0).of_all(blocks).tolist() == [2e-3, 0.5]


def test_what_settings_say() -> None:
    """Assert the words that settings answer by."""
    plain = Settings(METHODS["dormand_prince"], until=1.0)
    assert (plain.partial, plain.adaptive, plain.locates_one_by_one, plain.scheme.jacobian) == (
        False,
        False,
        False,
        EXACT,
    )
    assert plain.located_within(None) == 1e-12
    chosen = settings_for(MODEL, method="dormand_prince", until=1.0, rtol=1e-6, keep_every=2)
    assert (chosen.partial, chosen.adaptive, chosen.estimator) == (True, True, "embedded")
    assert Settings(METHODS["rk4"], 1.0, log="states").partial
    assert not Settings(METHODS["rk4"], 1.0, step=(0.5, 0.5), tolerances=tolerances()).adaptive
    assert Settings(METHODS["rk4"], 1.0, event_root_method="one by one").locates_one_by_one
    scheme = Settings(METHODS["rk4"], 1.0, estimator="step_doubling", summation="compensated").scheme
    assert (scheme.method.name, scheme.estimator, scheme.summation) == ("rk4", "step_doubling", "compensated")


@pytest.mark.parametrize(
    ("log", "states", "samples"),
    [("full", True, True), ("states", True, False), (("x",), False, False), (("x", "sample_x"), False, True)],
)
def test_what_a_log_keeps(log: str | tuple[str, ...], states: bool, samples: bool) -> None:
    """Assert which logs have every state, and which may have force samples; with rows left out none has every state."""
    settings = Settings(METHODS["rk4"], 1.0, log=log)
    assert (settings.keeps_states, settings.keeps_samples) == (states, samples)
    assert not Settings(METHODS["rk4"], 1.0, log=log, keep_every=2).keeps_states


def test_the_layout_of_a_march() -> None:
    """Assert that it is of the model with sides of switches where these are located, and by the method's scheme."""
    kinked = particle("-newton*abs(x)/metre")
    for switches, count in (("located", 1), ("stepped over", 0)):
        settings = Settings(METHODS["rk4"], 1.0, switches=switches)
        layout = settings.layout(kinked)
        assert (len(layout.watched), layout.scheme) == (count, settings.scheme)

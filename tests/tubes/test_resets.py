"""Tubes through events that set the state, against closed forms."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest

import xdynamics as xd
from xdynamics.kernels.layout import layout_of
from xdynamics.tubes import interval_problem_of
from xdynamics.tubes.boxes import AffineImage
from xdynamics.tubes.crossings import Reset
from xdynamics.tubes.functions import Functions


def ball(half_width: float = 0.0, new: str = "-v_y/2", *, e: str = '"0.5"', potential: str = "m*g*y") -> xd.Model:
    """Return a ball that falls from 1 m with 10 m/s2, and has half its speed after each bounce."""
    start = f'{{ value = "1 m", half_width = {half_width} }}' if half_width else '"1 m"'
    return xd.Model.from_text(
        f"""name = "ball"
[coordinates]
y = {{ unit = "m" }}
[parameters]
m = "1 kg"
g = "10 m s-2"
e = {e}
[mass]
y = "m"
[forces.gravity]
potential = "{potential}"
[initial]
t = "0 s"
y = {start}
v_y = "0 m s-1"
[events.bounce]
function = "y"
direction = "falling"
action = "reset"
set = {{ v_y = "{new}" }}
"""
    )


def closed_form(t: mp.mpf, height: mp.mpf, e: mp.mpf) -> tuple[mp.mpf, mp.mpf]:
    """Return place and velocity."""
    begin, y, v = mp.mpf(0), height, mp.mpf(0)
    while True:
        lasting = (v + mp.sqrt(v * v + 20 * y)) / 10
        if t <= begin + lasting:
            since = t - begin
            return y + v * since - 5 * since * since, v - 10 * since
        begin, y, v = begin + lasting, mp.mpf(0), -e * (v - 10 * lasting)


@pytest.mark.parametrize("half_width", [0.0, 0.015625])
def test_bounces_of_a_set(half_width: float) -> None:
    """Assert that closed forms of starts and restitutions within bounds are inside before, while and after they bounce."""
    uncertain = half_width > 0.0
    model = ball(half_width, "-e*v_y", e='{ value = "0.5", half_width = 0.002 }' if uncertain else '"0.5"')
    bounces = [mp.sqrt(mp.mpf(1 + side) / 5) for side in (-half_width, half_width)]
    times = sorted([0.25, *(float(time) for time in bounces), float(sum(bounces) / 2), 0.6, 0.8, 0.85])
    tube = xd.enclose(model, at=times)
    assert tube.attrs["outcome"] == "completed", tube.attrs["outcome_text"]
    with mp.workdps(40):
        for k, time in enumerate(times):
            ends = [
                closed_form(mp.mpf(time), 1 + mp.mpf(side) * half_width, mp.mpf("0.5") + mp.mpf(e) / 500 * uncertain)
                for side in np.linspace(-1.0, 1.0, 9)
                for e in np.linspace(-1.0, 1.0, 5)
            ]
            for i, name in enumerate(("y", "v_y")):
                low, high, values = (
                    float(tube[f"lower_{name}"][k]),
                    float(tube[f"upper_{name}"][k]),
                    [s[i] for s in ends],
                )
                if float(min(bounces)) < time < float(max(bounces)) or time not in map(float, bounces):
                    assert low <= min(values), (time, name)
                    assert max(values) <= high, (time, name)
    assert high - low <= 1e-12 + 3.0 * (max(values) - min(values))


def test_two_bounces() -> None:
    """Assert that two bounces hold their exact times, and energy is a quarter after each."""
    tube = xd.enclose(ball(), until="1.1 s")
    assert tube.event_detector.values.tolist() == [0, 0]
    with mp.workdps(40):
        first = mp.sqrt(mp.mpf(1) / 5)
        for k, exact in enumerate([first, 2 * first]):
            assert float(tube.lower_event_time[k]) <= exact <= float(tube.upper_event_time[k])
    low, high = float(tube.lower_total_energy[-1]), float(tube.upper_total_energy[-1])
    assert low <= 10.0 / 16.0 <= high < low + 1e-11


def test_reset_and_switch_at_one_zero() -> None:
    """Assert that events of one function act together, as of a stage that is dropped while the next is lit."""
    model = xd.Model.from_toml("data/models/staged_rocket.toml")
    tube = xd.enclose(model, until="28 s")
    assert tube.attrs["outcome"] == "completed", tube.attrs["outcome_text"]
    run = xd.simulate(model, method="dop853", rtol=1e-13, until="28 s")
    for name in ("y", "v_y", "m", "flow"):
        value = float(run[name][-1])
        slack = 1e-11 * abs(value)
        assert float(tube[f"lower_{name}"][-1]) - slack <= value <= float(tube[f"upper_{name}"][-1]) + slack, name
        assert float(tube[f"upper_{name}"][-1] - tube[f"lower_{name}"][-1]) <= 1e-9 * (1.0 + abs(value)), name


def test_function_that_is_set() -> None:
    """Assert that an event whose own function it sets is ready behind it on the side where it is set to."""
    tube = xd.enclose(ball(new='0*v_y", y = "y + 1*metre'), until="1 s")
    assert tube.sizes["event"] == 2
    with mp.workdps(30):
        assert float(tube.lower_event_time[1]) <= 2 * mp.sqrt(mp.mpf(1) / 5) <= float(tube.upper_event_time[1])


@pytest.mark.parametrize(("rtol", "order"), [(1e-16, 20), (1e-3, 4)])
def test_reset_that_is_not_linear(rtol: float, order: int) -> None:
    """Assert that what is lost before a reset, be it much, is carried through what it sets: the speed squared."""
    model = ball(new="v_y*v_y/4*second/metre", potential="m*g*y*y/(2*metre)")
    tube = xd.enclose(model, at=["0.7 s"], rtol=rtol, order=order)
    with mp.workdps(30):
        w = mp.sqrt(10)
        exact = mp.mpf(10) / 4 * mp.cos(w * mp.mpf("0.7") - mp.pi / 2)
        low, high = float(tube.lower_v_y[0]), float(tube.upper_v_y[0])
        assert low <= exact <= high
        assert high - low < (1e-12 if rtol < 1e-9 else 0.1)


def test_reset_of_a_wide_image() -> None:
    """Assert that the image of a set after a reset holds what is set from either end of the image before."""
    model = ball(new="v_y*v_y/4*second/metre")
    problem = interval_problem_of(model)
    squared = Functions(problem, layout_of(model), [model.expanded(model.events["bounce"].reset["v_y"])])
    image = np.array([[1.0, -3.0], [1.5, -2.0]])
    seen = AffineImage(image, np.zeros((2, 2, 4)), np.zeros((2, 4)))
    held = problem.constants.values_from(problem.regime, 0.0)
    found = Reset(squared, (1,)).image_after(problem.time, seen, image, held).image
    assert found[:, 0].tolist() == [1.0, 1.5]
    assert found[0, 1] <= 1.0 < 2.25 <= found[1, 1] < 2.6


def test_what_is_not_proven() -> None:
    """Assert that bounces without end, and what is set by the clock, are ended or refused in words."""
    tube = xd.enclose(ball(), until="2 s")
    assert tube.attrs["outcome"] == "not_proven"
    assert tube.attrs["proven_until"] < 3 * float(mp.sqrt(mp.mpf(1) / 5))
    with pytest.raises(xd.InputError, match="what event 'bounce' sets reads t; write it in coordinates"):
        xd.enclose(ball(new="-v_y*t/second"), until="2 s")

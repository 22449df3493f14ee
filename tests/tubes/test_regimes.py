"""Tubes through switches of regimes, against closed forms on either side."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest

import xdynamics as xd


def pushed(
    half_width: float = 0.0, *, events: str = "", regimes: str = "", x: str = "0 m", forces: str = ""
) -> xd.Model:
    """Return a mass that is pushed with 3 N up to x = 2 m, and pulled back with 1 N from there."""
    start = f'{{ value = "{x}", half_width = {half_width} }}' if half_width else f'"{x}"'
    return xd.Model.from_text(
        f"""name = "pushed"
[coordinates]
x = {{ unit = "m" }}
[parameters]
m = "1 kg"
push = "3 N"
pull = "1 N"
[mass]
x = "m"
[forces.push]
x = "push"
[forces.pull]
x = "-pull"
{forces}
[regimes.pushed]
forces = ["push"]
[regimes.pulled]
forces = ["pull"]
{regimes}
[observables]
work = "push*x"
[initial]
t = "0 s"
x = {start}
v_x = "0 m s-1"
[events.let_go]
function = "x - 2*metre"
direction = "rising"
action = "switch"
to = "pulled"
{events}"""
    )


def closed_form(t: mp.mpf, start: mp.mpf) -> tuple[mp.mpf, mp.mpf]:
    """Return place and velocity."""
    first = mp.sqrt(2 * (2 - start) / 3)
    if t <= first:
        return start + 3 * t * t / 2, 3 * t
    return 2 + 3 * first * (t - first) - (t - first) ** 2 / 2, 3 * first - (t - first)


@pytest.mark.parametrize("half_width", [0.0, 0.0625])
def test_switch_where_all_motions_pass(half_width: float) -> None:
    """Assert that closed forms from the whole set are inside before, at and after a switch, and the tube hardly wider."""
    model, last = pushed(half_width), 3.0
    passes = [mp.sqrt(mp.mpf(2) * (2 - mp.mpf(x)) / 3) for x in (half_width, -half_width)]
    times = sorted([0.5, *(float(time) for time in passes), float(sum(passes) / 2), 1.25, 2.0, last])
    tube = xd.enclose(model, at=times)
    assert tube.attrs["outcome"] == "completed", tube.attrs["outcome_text"]
    with mp.workdps(40):
        members = [[closed_form(mp.mpf(t), mp.mpf(x)) for t in times] for x in np.linspace(-half_width, half_width, 9)]
        for k, time in enumerate(times):
            for i, name in enumerate(("x", "v_x")):
                values = [member[k][i] for member in members]
                low, high = float(tube[f"lower_{name}"][k]), float(tube[f"upper_{name}"][k])
                assert low <= min(values), (time, name)
                assert max(values) <= high, (time, name)
        spread = max(values) - min(values)
    assert high - low <= 1e-13 + 3.0 * spread
    assert float(tube.lower_event_time[0]) <= passes[0] <= passes[1] <= float(tube.upper_event_time[0])
    assert float(tube.upper_event_time[0] - tube.lower_event_time[0]) <= 1e-14 + 1.2 * float(passes[1] - passes[0])


BACK = '[events.back]\nfunction = "x - 2*metre"\ndirection = "falling"\naction = "switch"\nto = "pushed"\n'


def test_to_and_fro() -> None:
    """Assert that each of five switches between two regimes at one place is proven around its exact time."""
    tube = xd.enclose(pushed(events=BACK), until="20 s")
    assert tube.attrs["outcome"] == "completed"
    assert "events change every motion 5 times" in tube.attrs["summary"]
    with mp.workdps(40):
        first = 2 / mp.sqrt(3)  # then 6 times as long by 1 N, twice by 3 N
        for k, passed in enumerate([1, 7, 9, 15, 17]):
            assert float(tube.lower_event_time[k]) <= passed * first <= float(tube.upper_event_time[k]), k
            assert float(tube.upper_event_time[k] - tube.lower_event_time[k]) < 1e-10
    rows = tube.time.values
    assert {float(time) for time in tube.upper_event_time.values} <= {*rows.tolist()}


STOP = '[events.turn]\nfunction = "v_x"\ndirection = "falling"\naction = "stop"\n'
LATE = '[events.late]\nfunction = "x - 1*metre"\naction = "switch"\nto = "pulled"\ncount = 2\n'
CLOCK = '[events.clock]\nfunction = "t - 0.75*second"\naction = "switch"\nto = "pulled"\n'
DOWN = '[events.down]\nfunction = "x - 3*metre"\naction = "record"\n'


def test_stop() -> None:
    """Assert that bounds end before the first motion stops, and hold its times and states."""
    tube = xd.enclose(pushed(0.0625, events=STOP), at=["1 s", "20 s"])
    assert tube.attrs["outcome"] == "completed"
    assert "before the first motion stops at 'turn'" in tube.attrs["outcome_text"]
    ends = [4 * float(mp.sqrt(2 * (2 - x) / 3)) for x in (0.0625, -0.0625)]
    assert float(tube.lower_event_time[1]) <= ends[0] <= ends[1] <= float(tube.upper_event_time[1])
    assert tube.attrs["proven_until"] <= ends[0]
    assert np.isnan(tube.upper_x.values).tolist() == [False, True]


def test_events_beside_a_switch() -> None:
    """Assert that an event counts once it has been met twice, one of time switches at it, and records go on behind a switch."""
    tube = xd.enclose(pushed(events=CLOCK + DOWN), until="3 s")
    assert tube.attrs["outcome"] == "completed"
    at, speed = 1.5 * 0.75**2, 3 * 0.75
    assert abs(float(tube.lower_v_x[-1]) - (speed - (3 - 0.75))) < 1e-13
    assert [float(tube.lower_event_time[0]) <= 0.75 <= float(tube.upper_event_time[0]), at < 2.0] == [True, True]
    counted = xd.enclose(pushed(events=LATE), until="7 s")
    assert counted.attrs["outcome"] == "completed"
    assert counted.event_detector.values.tolist() == [1, 0]
    falls = xd.enclose(pushed(0.01, events=DOWN), until="9 s")
    first = float(mp.sqrt(mp.mpf(4) / 3))
    apex, high = first + 3 * first, 2 + (3 * first) ** 2 / 2
    for k, exact in ((1, apex - np.sqrt(2 * (high - 3))), (2, apex + np.sqrt(2 * (high - 3)))):
        assert float(falls.lower_event_time[k]) <= exact <= float(falls.upper_event_time[k])


REFUSING = {
    "too wide": (pushed(0.9), "let_go"),
    "in either order": (
        pushed(events='[events.fast]\nfunction = "v_x - 2*sqrt(3)*metre/second"\naction = "switch"\nto = "pushed"\n'),
        "'fast' may be passed while 'let_go' acts",
    ),
    "starts at zero": (pushed(x="2 m"), "'let_go' may be zero at the start"),
    "starts on both sides": (
        pushed(0.0625, events=CLOCK.replace("t - 0.75*second", "t + x*second/metre")),
        "event 'clock' may be zero at the start",
    ),
    "touches": (
        pushed(events=CLOCK.replace("t - 0.75*second", "(x - 1*metre)**2")),
        "whether every motion passes 'clock', and once, cannot be told",
    ),
}


@pytest.mark.parametrize("name", REFUSING)
def test_where_a_switch_is_not_proven(name: str) -> None:
    """Assert that a proof ends, with its reason, where not all motions are known to pass, or in which order."""
    model, words = REFUSING[name]
    tube = xd.enclose(model, until="3 s")
    assert tube.attrs["outcome"] == "not_proven"
    assert words in tube.attrs["outcome_text"]
    assert tube.attrs["proven_until"] < 2.0


def test_forces_that_drive_back() -> None:
    """Assert that an event of either direction acts once where the other regime drives motions back to where they came from."""
    tube = xd.enclose(pushed(events=CLOCK.replace("t - 0.75*second", "v_x - 2*metre/second")), until="1.4 s")
    assert (tube.attrs["outcome"], tube.sizes["event"]) == ("completed", 1)
    with mp.workdps(30):
        exact = 2 - (mp.mpf("1.4") - mp.mpf(2) / 3)
        assert float(tube.lower_v_x[-1]) <= exact <= float(tube.upper_v_x[-1])


@pytest.mark.dear
def test_members_that_march_in_floats_are_inside() -> None:
    """Assert that 200 starts at random, with drag and switches to and fro, end between the bounds."""
    drag = " - 0.05*kilogram/second*v_x"
    forces = {"push": {"x": f"push{drag}"}, "pull": {"x": f"-pull{drag}"}}
    model, until = pushed(0.02, events=BACK).replace(forces=forces), "9 s"
    tube = xd.enclose(model, at=[until])
    assert tube.attrs["outcome"] == "completed", tube.attrs["outcome_text"]
    starts = np.random.default_rng(32).uniform(-0.02, 0.02, 200)
    members = xd.sweep(model, {"x": starts}, keep=["end"], method="dop853", rtol=1e-13, until=until).load()
    for name in ("x", "v_x"):
        values, slack = members[f"end_{name}"].values, 1e-10
        assert (float(tube[f"lower_{name}"][0]) - slack <= values).all()
        assert (values <= float(tube[f"upper_{name}"][0]) + slack).all()
        assert float(tube[f"upper_{name}"][0] - tube[f"lower_{name}"][0]) < 15.0 * np.ptp(
            values
        )  # 11.7: what the start has to do with the time of a switch is lost

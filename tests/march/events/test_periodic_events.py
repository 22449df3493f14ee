"""Periodic events: met at exact multiples without a search, with the actions of any other event."""

from __future__ import annotations

from math import cos, sin
from pathlib import Path

import numpy as np
import pytest

import xdynamics as xd

KICKS = '[events.kick]\nevery = "0.3 s"\naction = "reset"\nset = { v_x = "v_x + push" }\n'


def spring(events: str = KICKS, more: str = "") -> xd.Model:
    """A mass on a spring, of 2 rad s-1, which events push."""
    return xd.Model.from_text(f"""
name = "spring"
[coordinates]
x = "m"
[parameters]
k = "4.0 ± 0.01 N m-1"
push = "0.5 ± 0.01 m s-1"
[mass]
x = "1*kilogram"
[forces.spring]
x = "-k*x"
{more}
{events}
[initial]
x = "1 m"
v_x = "0 m s-1"
""")


def exact(kicks: int, push: float = 0.5, k: float = 4.0) -> tuple[float, float]:
    """Position and velocity after some kicks: turns and pushes, joined."""
    w, x, v = k**0.5, 1.0, 0.0
    c, s = cos(0.3 * w), sin(0.3 * w)
    for _ in range(kicks):
        x, v = x * c + v / w * s, -w * x * s + v * c + push
    return x, v


@pytest.mark.parametrize(
    ("method", "settings", "off"),
    [
        ("rk4", {"step": "10 ms"}, 1e-7),
        ("velocity_verlet", {"step": "1 ms"}, 1e-5),
        ("dop853", {"rtol": 1e-12}, 1e-11),
        ("radau_iia", {"rtol": 1e-10}, 1e-9),
        ("taylor", {"rtol": 1e-14}, 1e-13),
    ],
)
def test_kicks_come_at_their_times(method: str, settings: dict[str, object], off: float) -> None:
    """Assert the exact map from kick to kick, and times that are the floats nearest to multiples."""
    run = xd.simulate(spring(), method=method, until="3 s", **settings)
    assert run.event_time.values.tolist() == [3 * k / 10 for k in range(1, 11)]
    assert [float(run.x[-1]), float(run.v_x[-1])] == pytest.approx(exact(10), abs=off)
    before, after = run.event_row_before.values, run.event_row_after.values
    np.testing.assert_allclose(run.v_x.values[after] - run.v_x.values[before], 0.5, rtol=1e-15)
    assert not run.event_residual.values.any()
    assert run.event_detector.attrs["functions"] == "kick: every 0.3 s"
    assert run.attrs["run_outcome"] == "completed"


def test_the_first_is_after_its_phase() -> None:
    """Assert times with a phase, also none and one longer than a period, and that the third stops the run."""
    for phase, times in (("0.1 s", [0.1, 0.4, 0.7]), ("0.5 s", [0.5, 0.8, 1.1]), ("0 s", [0.0, 0.3, 0.6])):
        model = spring(f'[events.end]\nevery = "0.3 s"\nphase = "{phase}"\naction = "stop"\ncount = 3\n')
        run = xd.simulate(model, method="rk4", step="70 ms", until="2 s")
        assert run.event_time.values == pytest.approx(times, abs=1e-15)
        assert float(run.time[-1]) == run.event_time.values[-1]
        assert run.attrs["run_outcome"] == "stopped_by_event"


def test_several_meet_at_one_time() -> None:
    """Assert one pair of rows for a periodic event, one that is located, and a tick of a controller at the same time."""
    more = '[controllers.hold]\nevery = "0.25 s"\noutputs = { u = { unit = "m", start = "0 m", value = "x" } }\n'
    events = (
        '[events.look]\nevery = "0.25 s"\n[events.other]\nevery = "0.5 s"\n[events.half]\nfunction = "t - second/2"\n'
    )
    run = xd.simulate(spring(events, more), method="rk4", step="30 ms", until="1 s")
    names = run.event_detector.attrs["flag_meanings"].split()
    met = [(names[i], float(t)) for i, t in zip(run.event_detector.values, run.event_time.values, strict=True)]
    assert met == [
        ("look", 0.25),
        ("look", 0.5),
        ("other", 0.5),
        ("half", 0.5),
        ("look", 0.75),
        ("look", 1.0),
        ("other", 1.0),
    ]
    assert np.unique(run.event_row_before).size == 4
    held = {float(t): float(u) for t, u in zip(run.time.values, run.u.values, strict=True)}  # of the later row
    assert [held[t] for t in (0.25, 0.5, 0.75)] == run.x.values[run.event_row_after.values[[0, 1, 4]]].tolist()


def test_forces_change_at_its_times() -> None:
    """Assert a switch of regimes every half second: free flight, then under the spring, exactly."""
    events = '[events.on]\nevery = "1 s"\nphase = "0.5 s"\naction = "switch"\nto = "held"\n'
    regimes = (
        '[regimes.free]\nforces = ["still"]\n[regimes.held]\nforces = ["spring"]\n[forces.still]\nx = "0*newton"\n'
    )
    run = xd.simulate(spring(events, regimes), method="dop853", rtol=1e-12, until="1.2 s")
    assert float(run.x[-1]) == pytest.approx(cos(2 * 0.7), abs=1e-12)


def test_slopes_pass_through_it() -> None:
    """Assert slopes of a budget by variational equations, with what a reset does to a change, by those of the map."""
    settings = {"method": "dop853", "rtol": 1e-12, "until": "3 s"}
    budget = xd.error_budget(spring(), quantity="x", at="2.95 s", **settings)
    for name, value in (("push", 0.5), ("k", 4.0)):
        term = budget.isel(term=list(budget.term_name.values).index(name))
        sides = []
        for d in (1e-4, -1e-4):
            x, v = exact(9, **{name: value + d})
            w = (4.0 + d if name == "k" else 4.0) ** 0.5
            sides.append(x * cos(0.25 * w) + v / w * sin(0.25 * w))
        assert float(term.sensitivity) == pytest.approx((sides[0] - sides[1]) / 2e-4, rel=1e-7)
        assert str(term.term_rule.values).startswith("slope by variational equations")


@pytest.mark.parametrize("at", ["1.2 s", "1.3 s"])
def test_it_goes_on_and_is_reproduced(at: str, tmp_path: Path) -> None:
    """Assert the bits of a whole run of one that ended at a kick, or between two, and of an archive's rerun."""
    whole = xd.simulate(spring(), method="rk4", step="130 ms", until="3 s")
    part = xd.simulate(spring(), method="rk4", step="130 ms", until=at)
    further = xd.extend(part, until="3 s")
    assert float(further.x[-1]) == pytest.approx(float(whole.x[-1]), abs=1e-13)
    assert further.event_time.values.tolist() == whole.event_time.values.tolist()
    xd.save(further, tmp_path / "run.nc")
    assert xd.reproduce(tmp_path / "run.nc").attrs["identical"] == 1
    assert xd.Model.from_text(spring().to_toml()) == spring()


def test_members_and_double_doubles_are_kicked_alike() -> None:
    """Assert the bits of single runs in a sweep, and the map to 1e-27 with 31 digits."""
    pushes = ["0.1 m s-1", "0.2 m s-1", "0.3 m s-1"]
    settings = {"method": "rk4", "step": "50 ms", "until": "1 s"}
    sweep = xd.sweep(spring(), axes={"push": pushes}, keep=["end", "event_count_kick"], **settings)
    for i, push in enumerate(pushes):
        alone = xd.simulate(spring().replace(parameters={"push": push}), **settings)
        assert float(sweep.end_x[i]) == float(alone.x[-1])
    assert sweep.event_count_kick.values.tolist() == [3, 3, 3]
    fine = xd.simulate(spring(), method="taylor", rtol=1e-28, until="0.9 s", precision="double_double")
    assert abs(float(fine.rest_event_time[0]) - 1.1102230246251565e-17) < 1e-32  # 3/10 less its float


@pytest.mark.parametrize(
    ("events", "fault"),
    [
        ('[events.a]\nevery = "0 s"', "every is '0.0 s', needs a positive time"),
        ('[events.a]\nevery = "-1 s"', "every is '-1.0 s', needs a positive time"),
        ('[events.a]\nevery = "1 m"', "every is '1.0 m', needs a positive time"),
        ('[events.a]\nevery = "inf s"', "inf"),
        ('[events.a]\nevery = "1"', "event 'a': every is '1.0 1', needs a time in 's'"),
        ('[events.a]\nevery = "1 s"\nphase = "-1 s"', "phase is '-1.0 s', needs a time that is not negative"),
        ('[events.a]\nevery = "1 s"\nfunction = "x"', "every and function are both given"),
        ('[events.a]\nevery = "1 s"\ndirection = "rising"', "every and direction are both given"),
        ('[events.a]\nphase = "1 s"\nfunction = "x"', "key 'phase' is for a periodic event; give every too"),
        (
            '[events.a]\naction = "stop"',
            "key 'function' is missing; give an expression whose zeros are located, or every",
        ),
        ('[events.a]\nevery = "1 s"\naction = "reset"', "action 'reset' needs the key 'set'"),
    ],
)
def test_a_wrong_period_is_told(events: str, fault: str) -> None:
    """Assert one error that names the event, the key and its value."""
    with pytest.raises(xd.ModelError, match="'a'") as caught:
        spring(events)
    assert fault in str(caught.value)


@pytest.mark.parametrize(
    ("every", "fault"),
    [
        ("2 s", "event 'a' acts every 2.0 s from the start, and the run takes 1.0 s; run longer"),
        ("1 ns", "events act 1000000000 times in the run, 10000000 at most; have them act less often"),
    ],
)
def test_a_period_that_does_not_suit_the_run_is_told(every: str, fault: str) -> None:
    """Assert that a period longer than the run, or far too short, is refused before the march."""
    with pytest.raises(xd.InputError) as caught:
        xd.simulate(spring(f'[events.a]\nevery = "{every}"'), method="rk4", step="10 ms", until="1 s")
    assert fault in str(caught.value)

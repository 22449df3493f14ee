"""Tubes of models with measured tables over time, against closed forms piece by piece."""

from __future__ import annotations

from pathlib import Path

import mpmath as mp
import numpy as np
import pytest

import xdynamics as xd
from xdynamics.model.motion import drive_pieces

POINTS = "time [s],f [1]\n0,0.5\n0.3,2\n0.7,-1\n1.1,0.25\n1.6,1\n"


def relaxed(
    folder: Path,
    interpolation: str,
    outside: str = "hold",
    argument: str = "t",
    events: str = "",
    speed: str = '"2"',
    points: str = POINTS,
) -> xd.Model:
    """Return x' = -x + f(t) with a measured f, and an observable that reads it."""
    (folder / "f.csv").write_text(points, encoding="utf-8")
    (folder / "model.toml").write_text(
        f"""name = "relaxed"
[parameters]
speed = {speed}
[states.x]
unit = "1"
rate = "(f - x)/second"
[drives.f]
table = "f.csv"
argument = "{argument}"
interpolation = "{interpolation}"
outside = "{outside}"
[observables]
lag = "f - x"
[initial]
t = "0 s"
x = {{ value = "1", half_width = 0.01 }}
{events}""",
        encoding="utf-8",
    )
    return xd.Model.from_toml(str(folder / "model.toml"))


def closed_form(model: xd.Model, end: float, start: mp.mpf) -> mp.mpf:
    """Return x at a time, piece by piece: x = P(u) + (x0 - P(0))*exp(-u), P + P' being the piece."""
    origins, powers = drive_pieces(model)[0]
    x, now = start, mp.mpf(0)
    while now < end:
        piece = int(np.searchsorted(origins[1:], float(now), side="right"))
        until = mp.mpf(min(end, float(origins[piece + 1]) if piece + 1 < len(origins) else end))
        c3, c2, c1, c0 = (mp.mpf(float(c)) for c in powers[:, piece])
        particular = [c3, c2 - 3 * c3, c1 - 2 * (c2 - 3 * c3), c0 - (c1 - 2 * (c2 - 3 * c3))]
        first, last = (mp.polyval(particular, time - mp.mpf(float(origins[piece]))) for time in (now, until))
        x, now = last + (x - first) * mp.exp(now - until), until
    return x


@pytest.mark.parametrize("interpolation", ["previous", "linear", "pchip", "cubic"])
def test_linear_system_with_a_table(tmp_path: Path, interpolation: str) -> None:
    """Assert that the closed form of either end of the starts is at the tube's own ends, after and between points of a table."""
    model = relaxed(tmp_path, interpolation)
    times = [0.2, 0.3, 0.9, 1.6, 2.0]
    tube = xd.enclose(model, at=times)
    assert tube.attrs["outcome"] == "completed"
    assert "tables the polynomials of floats that runs look up" in tube.attrs["summary"]
    with mp.workdps(40):
        for k, time in enumerate(times):
            low, high = (closed_form(model, time, mp.mpf(text)) for text in ("0.99", "1.01"))
            assert 0.0 <= low - float(tube.lower_x[k]) < 1e-14, time
            assert 0.0 <= float(tube.upper_x[k]) - high < 1e-14, time


def test_steps_land_on_points(tmp_path: Path) -> None:
    """Assert that no step crosses a point of a table, where an observable that reads it has the values of both sides."""
    tube = xd.enclose(relaxed(tmp_path, "previous"), until="2 s", order=8, rtol=1e-6)
    times = tube.time.values.tolist()
    assert {0.0, 0.3, 0.7, 1.1, 1.6, 2.0} <= {*times}
    at = times.index(0.3)
    assert float(tube.upper_lag[at] - tube.lower_lag[at]) > 1.5  # f goes from 0.5 to 2 there
    assert float(tube.upper_lag[at - 1] - tube.lower_lag[at - 1]) < 0.03


def test_argument_that_is_linear_in_time(tmp_path: Path) -> None:
    """Assert that a table of 2*t is passed twice as fast."""
    once = xd.enclose(relaxed(tmp_path, "linear"), at=["0.2 s"])
    twice = relaxed(tmp_path, "linear", argument="speed*t")
    tube = xd.enclose(twice, at=["0.5 s"])
    with mp.workdps(40):
        assert float(tube.lower_x[0]) <= closed_form(twice, 0.5, mp.mpf(1)) <= float(tube.upper_x[0])
    assert abs(float(tube.lower_x[0] - once.lower_x[0])) > 0.01


def test_table_that_ends(tmp_path: Path) -> None:
    """Assert that a proof goes to a table's last point, and says that nothing is known beyond it."""
    tube = xd.enclose(relaxed(tmp_path, "cubic", outside="error"), until="3 s")
    assert (tube.attrs["outcome"], tube.attrs["proven_until"]) == ("not_proven", 1.6)
    assert "the table of drive 'f' goes no further" in tube.attrs["outcome_text"]


def test_event_that_jumps(tmp_path: Path) -> None:
    """Assert that a function that jumps from above zero to below has no zero that is told, and that a steady one has."""
    events = (
        '[events.met]\nfunction = "f"\naction = "record"\n[events.half]\nfunction = "f - 0.25"\naction = "record"\n'
    )
    jumping = xd.enclose(relaxed(tmp_path, "previous", events=events), until="2 s")
    assert jumping.sizes["event"] == 0
    assert "before t = 0.7 s, after which a zero could not be told from none" in jumping.attrs["events_text"]
    steady = xd.enclose(relaxed(tmp_path, "linear", events=events), until="0.9 s")
    assert steady.sizes["event"] == 2
    zero = 0.3 + 0.4 * 2.0 / 3.0
    assert abs(float(steady.lower_event_time[1]) - zero) < 1e-13


def test_event_that_jumps_for_some(tmp_path: Path) -> None:
    """Assert that zeros are not told where a table's jump takes some motions over zero, and leaves others on their side."""
    events = '[events.met]\nfunction = "x - f + t/second"\naction = "record"\n'
    points = "time [s],f [1]\n0,0.5\n0.3,1.1704\n2,1\n"  # at 0.3 s x is 0.8704 in the middle, and 0.0074 more or less
    tube = xd.enclose(relaxed(tmp_path, "previous", events=events, points=points), until="1 s")
    assert "before t = 0.3 s, after which a zero could not be told from none" in tube.attrs["events_text"]


@pytest.mark.parametrize(
    ("argument", "speed", "words"),
    [
        (
            "x*second",
            '"2"',
            r"drive 'f' is a table of 'x\*second', whose points are met at times that are not known before",
        ),
        ("speed*t", '{ value = "2", half_width = 0.1 }', "the times of a table's points depend on 'speed'"),
    ],
)
def test_tables_that_are_refused(tmp_path: Path, argument: str, speed: str, words: str) -> None:
    """Assert that a table of a state, or with points at times that are uncertain, is refused in words."""
    model = relaxed(tmp_path, "linear", argument=argument, speed=speed)
    with pytest.raises(xd.InputError, match=words):
        xd.enclose(model, until="1 s")

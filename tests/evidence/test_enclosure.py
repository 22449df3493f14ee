"""Proven bounds as datasets: their names, their words, their files; and what no bounds are proven of."""

from __future__ import annotations

from pathlib import Path
from unittest import mock

import mpmath as mp
import numpy as np
import pytest

import xdynamics as xd
from cases.command_line import call
from cases.smooth_models import of_rate, oscillator
from cases.stages import assert_described, assert_same_bits
from xdynamics.evidence.enclosing.tube import split_box
from xdynamics.tubes import Flow

SHORT = {"until": "0.5 s", "order": 12, "rtol": 1e-10}


def test_bounds_after_steps_and_at_times() -> None:
    """Assert that bounds after every step, and at times within steps, hold the closed form in the units declared."""
    model = oscillator(x="20 cm").replace(initial={"x": {"value": "20 cm", "half_width": "1 mm"}})
    steps, wanted = xd.enclose(model, **SHORT), xd.enclose(model, at=["0.1 s", "0 s", "0.4 s"], order=12)
    assert (steps.lower_x.dims, wanted.lower_x.dims, steps.lower_x.attrs["units"]) == (("step",), ("at",), "m")
    assert float(steps.time[-1]) == 0.5
    assert wanted.at_time.values.tolist() == [0.1, 0.0, 0.4]
    for tube, times in ((steps, steps.time.values), (wanted, wanted.at_time.values)):
        for x in (0.199, 0.2, 0.201):
            exact = x * np.cos(2.0 * times), -2.0 * x * np.sin(2.0 * times)
            for name, values in zip(("x", "v_x"), exact, strict=True):
                assert (tube[f"lower_{name}"].values <= values + 1e-16).all()
                assert (tube[f"upper_{name}"].values >= values - 1e-16).all()
    assert (steps.upper_x - steps.lower_x).max() < 2.01e-3


def test_units_are_rounded_outward() -> None:
    """Assert that bounds in millimetres hold the closed form to 30 digits."""
    model = oscillator().replace(initial={"x": "1 m"})
    sections = {"coordinates": {"x": {"unit": "mm"}}, "parameters": {"m": "1 kg", "k": "4 N m-1"}}
    model = xd.Model(
        name="mm", mass={"x": "m"}, forces={"s": {"potential": "k*x**2/2"}}, initial={"x": "1 m"}, **sections
    )
    tube = xd.enclose(model, at="0.3 s")
    with mp.workdps(30):
        exact = 1000 * mp.cos(mp.mpf("0.6"))
        assert float(tube.lower_x[0]) <= exact <= float(tube.upper_x[0])
    assert (tube.lower_x.attrs["units"], float(tube.upper_x[0] - tube.lower_x[0]) < 1e-10) == ("mm", True)


def test_what_is_proven_is_said() -> None:
    """Assert that the record says whose motions exist until when, what is an interval, and what is a number although uncertain."""
    parameters = {"m": {"value": "1 kg", "uncertainty": 0.1}, "k": {"value": "4 N m-1", "half_width": "0.1 N m-1"}}
    model = oscillator().replace(parameters=parameters)
    tube = xd.enclose(model, **SHORT)
    assert tube.attrs["summary"].startswith(
        "For every k within its half_width, and all else as written, the motion exists"
    )
    assert "from t = 0.0 s to 0.5 s" in tube.attrs["summary"]
    assert "Standard uncertainties, of m, are no bounds" in tube.attrs["summary"]
    assert (tube.attrs["proven"], tube.attrs["outcome"], tube.attrs["proven_until"]) == (1, "completed", 0.5)


def test_where_no_further_step_is_proven() -> None:
    """Assert that bounds end before a corner, with a reason, and that none is told at a later time."""
    tube = xd.enclose(of_rate("1 + abs(x - 1)"), at=["0.25 s", "0.75 s"], order=8, rtol=1e-9)
    assert tube.attrs["outcome"] == "not_proven"
    assert 0.5 < tube.attrs["proven_until"] < float(mp.log(2))
    assert "abs" in tube.attrs["outcome_text"] or "comparison" in tube.attrs["outcome_text"]
    assert np.isnan(tube.upper_x.values).tolist() == [False, True]


def test_archive_and_command_line(tmp_path: Path) -> None:
    """Assert that the command writes what the function returns, says the bounds, and ends with 1 where they end early."""
    model = tmp_path / "model.toml"
    model.write_text(oscillator().to_toml(), encoding="utf-8")
    done = call("enclose", str(model), "--at", "0.25 s", "--order", "12", "-o", str(tmp_path / "tube.nc"))
    assert done.exit_code == 0
    assert "  x         0.8775825618903" in done.output
    assert "  x         0.8775825618903" in call("show", tmp_path / "tube.nc").output
    again = xd.enclose(oscillator(), at="0.25 s", order=12)
    with xd.open_run(tmp_path / "tube.nc") as tube:
        assert tube.attrs["summary"] == again.attrs["summary"]
        for name in again.variables:
            assert tube[name].identical(again[name]), name
    early = call("enclose", str(model), "--until", "9 s", "--max-steps", "1")
    assert early.exit_code == 1
    assert "no bounds are proven after t = " in early.output


def turning(**uncertain: object) -> xd.Model:
    """Return an oscillator whose turning points are events."""
    events = '[events.turn]\nfunction = "v_x"\naction = "record"\n'
    return xd.Model.from_text(f"{oscillator(**uncertain).to_toml()}\n{events}")


@pytest.mark.parametrize("listed", [0, 1, 3])
def test_a_proof_is_a_task(listed: int) -> None:
    """Assert that bounds are described before they are proven, as one task, and come out with the bits of those proven at once."""
    asked = {"at": ["0.25 s", "3.5 s"], "order": 10, "rtol": 1e-8, "occurrences": listed}
    with mock.patch.object(Flow, "until", side_effect=AssertionError("it is proven")):
        stage = xd.enclose(turning(), **asked, compute=False)
    assert len({name for name in dict(stage.__dask_graph__()) if str(name).startswith("enclosure-")}) == 1
    eager = xd.enclose(turning(), **asked)
    assert_described(stage, eager)
    assert_same_bits(stage, eager)
    words = eager.event_detector.values.tolist()
    assert words == [0, 0, -1][:listed]
    assert np.isnan(eager.lower_event_time.values).tolist() == [word < 0 for word in words]


def test_a_wide_set_in_parts() -> None:
    """Assert that what is proven of eight parts holds every motion, with its event, and is told, where the whole is too wide."""
    wide = {"k": {"value": "4 N m-1", "half_width": "1 N m-1"}, "x": {"value": "1 m", "half_width": "0.1 m"}}
    asked = {"at": ["2.5 s"], "order": 12, "rtol": 1e-9}
    whole, parts = xd.enclose(oscillator(**wide), **asked), xd.enclose(turning(**wide), **asked, parts=8)
    k, x = np.linspace(3.0, 5.0, 101)[:, None], np.linspace(0.9, 1.1, 11)
    ends, turns = x * np.cos(np.sqrt(k) * 2.5), np.pi / np.sqrt(k)
    for tube in (whole, parts):
        assert float(tube.lower_x[0]) <= ends.min()
        assert float(tube.upper_x[0]) >= ends.max()
    assert float(whole.upper_x[0] - whole.lower_x[0]) > 5.0 * np.ptp(ends)
    assert float(parts.upper_x[0] - parts.lower_x[0]) < 1.25 * np.ptp(ends)
    assert parts.sizes["event"] == 1
    assert float(parts.lower_event_time[0]) <= turns.min() <= turns.max() <= float(parts.upper_event_time[0])
    assert parts.attrs["solver_parts"] == 8
    assert "steps of 8 parts of the set" in parts.attrs["outcome_text"]


def test_parts_make_the_whole() -> None:
    """Assert that parts share the numbers at which they are cut, that the widest beside its size is cut, and all is in one."""
    start = np.array([[1.0, -3.0, 2.0], [2.0, 3.0, 2.0]])
    parts = split_box(start, 5)
    assert len(parts) == 5
    assert sum(float(np.prod((part[1] - part[0])[:2])) for part in parts) == 6.0
    assert {tuple(part[:, 2].tolist()) for part in parts} == {(2.0, 2.0)}
    assert sorted({float(end) for part in parts for end in part[:, 1]})[:3] == [-3.0, -1.5, 0.0]


def test_zeros_that_not_all_parts_have() -> None:
    """Assert that a zero which the motions of one part alone have is not told, and from when zeros are not known."""
    model = oscillator(x={"value": "1 m", "half_width": "0.5 m"})
    model = xd.Model.from_text(f'{model.to_toml()}\n[events.far]\nfunction = "x + 1*metre"\naction = "record"\n')
    tube = xd.enclose(model, at=["2 s"], order=12, rtol=1e-9, parts=8)
    assert tube.sizes["event"] == 0
    assert "0 times in its direction before t = 1." in tube.attrs["events_text"]
    assert float(tube.lower_x[0]) <= 0.5 * np.cos(4.0) * 3.0


def test_a_part_that_is_not_proven_ends_the_whole() -> None:
    """Assert that bounds end where those of the first part do, and are unknown later, though others go on."""
    model = of_rate("sqrt(1 + x)").replace(initial={"x": {"value": "0", "half_width": 1.5}})
    tube = xd.enclose(model, at=["0 s", "0.5 s"], order=6, parts=4)
    assert (tube.attrs["outcome"], tube.attrs["proven_until"]) == ("not_proven", 0.0)
    assert np.isnan(tube.lower_x.values).tolist() == [False, True]


def test_what_a_description_needs() -> None:
    """Assert that times, the number of zeros, and a model that can be enclosed are asked for before anything is proven."""
    for asked, words in (
        ({"until": "1 s"}, "how many steps a proof takes is not known in advance; give the times"),
        ({"at": ["1 s"]}, "how often 'turn' is met is not known in advance"),
        ({"at": ["1 s"], "occurrences": -1}, "occurrences is -1, needs"),
    ):
        with pytest.raises(xd.InputError, match=words):
            xd.enclose(turning(), **asked, compute=False)
    with pytest.raises(xd.InputError, match="cannot be enclosed: contact 'floor'"):
        xd.enclose(xd.Model.from_toml("data/models/bouncing_ball.toml"), at=["1 s"], compute=False)


BAD: list[tuple[dict[str, object], str]] = [
    ({"until": "0 s"}, "until is 0.0 s, needs a finite time after the start"),
    ({"until": "-1 s"}, "until is -1.0 s"),
    ({"until": "1 m"}, "until"),
    ({"at": "2 s", "until": "1 s"}, "at has 2.0 s, and the enclosure goes from 0.0 s to 1.0 s"),
    ({"at": "-2 s", "until": "1 s"}, "at has -2.0 s"),
    ({"until": "1 s", "order": 1}, "order is 1, needs a whole number from 3 to 60"),
    ({"until": "1 s", "order": 200}, "order is 200, needs"),
    ({"until": "1 s", "order": 7.5}, "order is 7.5, needs"),
    ({"until": "1 s", "rtol": 0.5}, "rtol is 0.5, needs a number from 1e-20 to 0.001"),
    ({"until": "1 s", "max_steps": 0}, "max_steps is 0, needs a positive whole number"),
    ({"at": "1 s", "parts": 0}, "parts is 0, needs a whole number from 1 to 10000"),
    ({"at": "1 s", "parts": 2.5}, "parts is 2.5, needs"),
    ({"until": "1 s", "parts": 2}, "parts are joined at times that all of them have; give them"),
    ({}, "has no until in its"),
]


@pytest.mark.parametrize(("asked", "words"), BAD)
def test_wrong_settings(asked: dict[str, object], words: str) -> None:
    """Assert that a wrong setting is named with its value and what is needed."""
    with pytest.raises(xd.InputError, match=words):
        xd.enclose(oscillator(), **asked)


REFUSED = {
    "bouncing_ball": "contact 'floor' ends the smooth motion; enclose a model without it",
    "granular_box": "contact 'walls' ends the smooth motion",
    "stick_slip_belt": "friction 'belt' ends the smooth motion",
    "cart_spring": "drive 'restoring' is a table of 'x', whose points are met at times that are not known before; write it as",
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_no_bounds_are_proven_of(name: str) -> None:
    """Assert that a model with impacts, resets or tables is refused in a line that says which, and what to do."""
    with pytest.raises(xd.InputError, match=REFUSED[name]):
        xd.enclose(xd.Model.from_toml(f"data/models/{name}.toml"), until="1 s")


def force(x: float) -> float:
    """Return a force in Python."""
    return -4.0 * x


@pytest.mark.parametrize(
    "section", [{"forces": {"spring": {"x": force}}}, {"events": {"met": {"function": force, "unit": "m"}}}]
)
def test_python_functions_are_refused(section: dict[str, object]) -> None:
    """Assert that a force or an event function in Python is refused by its name."""
    known: dict[str, object] = {"coordinates": {"x": {"unit": "m"}}, "parameters": {"m": "1 kg"}, "mass": {"x": "m"}}
    model = xd.Model(name="in Python", **known, initial={"x": "1 m"}, **section)
    with pytest.raises(xd.InputError, match="nothing is known of the Python function force between two of its values"):
        xd.enclose(model, until="1 s")


def test_sets_too_wide_for_a_domain() -> None:
    """Assert that a start that reaches below the domain of a root is an outcome at the start, with its reason."""
    model = of_rate("sqrt(1 + x)").replace(initial={"x": {"value": "0", "half_width": 2.0}})
    tube = xd.enclose(model, until="1 s", order=6)
    assert (tube.attrs["outcome"], tube.attrs["proven_until"]) == ("not_proven", 0.0)
    assert "sqrt is not defined" in tube.attrs["outcome_text"]

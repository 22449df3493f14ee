"""Transients that are left out: of bifurcation diagrams, and of the sections of runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.command_line import call
from xdynamics.figures.transients import Transient, without_transient
from xdynamics.schema import OCCURRENCE
from xdynamics.sweeping.collection import NUMBER

KICKED: dict[str, Any] = {
    "name": "kicked",
    "coordinates": {"x": "m"},
    "parameters": {"w": "2 s-1"},
    "mass": {"x": "1*kilogram"},
    "forces": {"spring": {"x": "-9*newton/metre*x"}, "drive": {"x": "cos(w*t)*newton"}},
    "initial": {"x": "0.1 m"},
    "events": {"section": {"function": "sin(w*t/2)"}},
    "figure": {"section": "2*pi/w"},
    "run": {"method": "rk4", "step": "20 ms", "until": "20 s"},
}


@pytest.fixture(scope="module")
def diagram() -> xr.Dataset:
    """Five sections of each of three members, with their times."""
    keep = ["after_section_x", "event_time_section"]
    return xd.sweep(xd.Model(**KICKED), {"w": "2:4:3 s-1"}, keep=keep, occurrences=5).compute()


def points(figure: Any) -> tuple[str, np.ndarray]:
    """Title and dots of the bifurcation diagram."""
    titles = {axes.get_title(loc="left"): axes for axes in figure.axes}
    (title,) = [title for title in titles if title.startswith("bifurcation diagram")]
    dots = np.asarray(titles[title].lines[0].get_xydata())
    return title, dots[np.isfinite(dots[:, 1])]


@pytest.mark.dear
def test_the_first_occurrences_of_a_diagram_are_left_out(diagram: xr.Dataset) -> None:
    """Assert the dots of a sweep that kept the later occurrences alone, counted from the first of the run, and the words."""
    later = xd.sweep(xd.Model(**KICKED), {"w": "2:4:3 s-1"}, keep=["after_section_x"], occurrences=(2, 5))
    title, dots = points(xd.plot(diagram, transient=2))
    assert title == "bifurcation diagram: after_section_x after the first 2"
    assert points(xd.plot(diagram))[1].shape == (15, 2)
    assert np.array_equal(dots, points(xd.plot(later))[1])
    assert np.array_equal(dots, points(xd.plot(later, transient=1))[1])
    assert points(xd.plot(later, transient="4"))[1].shape == (3, 2)


def test_what_is_before_a_time_is_left_out(diagram: xr.Dataset) -> None:
    """Assert dots of the events from that time on: w t = 2 pi n, so that n = 1, 2 and 3 or 4 are earlier than 6.5 s."""
    dots = points(xd.plot(diagram, transient="6500 ms"))[1]
    assert [int((dots[:, 0] == w).sum()) for w in (2.0, 3.0, 4.0)] == [3, 2, 1]
    left = diagram.after_section_x.values[diagram.event_time_section.values >= 6.5]
    assert np.array_equal(dots[:, 1], left)


@pytest.mark.dear
def test_a_section_of_a_run_leaves_out_as_many_periods(tmp_path: Path) -> None:
    """Assert six periods of pi in 20 s, four after two of them or after 7 s, from Python and from the command line."""
    run = xd.simulate(xd.Model(**KICKED))
    for transient, count in ((0, 6), (2, 4), ("7 s", 4), (None, 6)):
        axes = xd.plot(run, only="section", transient=transient).axes[0]
        assert len(axes.lines[0].get_xdata()) == count
    xd.save(run, tmp_path / "run.nc")
    drawn = call("plot", tmp_path / "run.nc", "--only", "section", "--transient", "2", "-o", tmp_path / "run.svg")
    assert (drawn.exit_code, (tmp_path / "run.svg").exists()) == (0, True)


@pytest.mark.parametrize(
    ("transient", "said"),
    [
        (5, r"transient is 5, and the sweep keeps occurrences 1 to 5: nothing is left"),
        (-1, r"transient is -1, needs a whole number"),
        (2.5, r"transient is 2\.5, needs a whole number of occurrences or periods, like 100, or a time, like '200 s'"),
        (True, r"transient is True, needs a whole number"),
        ("-3", r"transient is '-3', needs a whole number"),
        ("3 m", r"transient '3 m' has units 'm', needs 's'"),
        ("soon", r"transient: quantity 'soon' does not start with a finite number"),
        ("1 day", r"transient is 1 day, and the sweep keeps no occurrence after it"),
    ],
)
def test_transients_that_leave_nothing_are_refused(diagram: xr.Dataset, transient: Any, said: str) -> None:
    """Assert a message that says what was given and what is there."""
    with pytest.raises(xd.InputError, match=said):
        xd.plot(diagram, transient=transient)


def test_what_has_no_transient_is_refused(diagram: xr.Dataset) -> None:
    """Assert the remedy for sweeps without occurrences or times, runs without a section, and other evidence."""
    with pytest.raises(xd.InputError, match=r"keeps no times of the event of after_section_x: .* keep event_time_"):
        xd.plot(diagram.drop_vars("event_time_section"), transient="3 s")
    ends = xd.sweep(xd.Model(**KICKED), {"w": "2:4:3 s-1"}, keep=["end"], until="1 s")
    with pytest.raises(xd.InputError, match="keeps none but the first: keep more"):
        xd.plot(ends, transient=3)
    run = xd.simulate(xd.Model(**KICKED))
    with pytest.raises(
        xd.InputError, match=r"transient is 9, and the section has 6 periods, the last at t = 18\.8496 s"
    ):
        xd.plot(run, transient=9)
    plain = xd.simulate(xd.Model(**{**KICKED, "figure": {}}))
    with pytest.raises(xd.InputError, match=r"its model names none; .* section = \"2\*pi/w\""):
        xd.plot(plain, transient=9)
    with pytest.raises(xd.InputError, match="transient is for figures of sweeps"):
        xd.plot(xd.compare(run, run), transient=9)


def test_as_many_occurrences_are_left_out_as_are_said() -> None:
    """Assert that of five occurrences those behind the second are left, by their numbers."""
    sweep = xr.Dataset({"after_section_x": ((OCCURRENCE,), np.arange(5.0)), NUMBER: ((OCCURRENCE,), np.arange(1, 6))})
    assert without_transient(sweep, Transient(2))[NUMBER].values.tolist() == [3, 4, 5]

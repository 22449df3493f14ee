"""Times of many seconds in figures: ticks at whole years or days, drawn where the record has them."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

import xdynamics as xd
from xdynamics.figures.marks import at_time, label_time
from xdynamics.record.long_times import long_unit

YEAR = 365.25 * 86_400.0


def times(latest: float, units: str = "s") -> xr.DataArray:
    """A run's times up to one."""
    return xr.DataArray(np.linspace(0.0, latest, 11), dims="step", attrs={"units": units})


@pytest.mark.parametrize(
    ("latest", "units", "unit"),
    [
        (40 * YEAR, "s", "years"),
        (20 * 86_400.0, "s", "days"),
        (1e5, "s", "hours"),
        (1e4, "s", "s"),
        (1e12, "1", "1"),
        (0.0, "s", "s"),
    ],
)
def test_units_of_long_times(latest: float, units: str, unit: str) -> None:
    """Assert years, days and hours where a run lasts five of them, seconds below, and no unit where the model has none."""
    assert long_unit(times(latest, units))[0] == unit


def test_ticks_stand_at_whole_years() -> None:
    """Assert that lines stay in seconds, ticks are multiples of a Julian year that are labelled so, and the axis says how long it is."""
    time = times(547 * YEAR)
    axes = Figure().subplots()
    axes.plot(time, time)
    label_time(axes, time)
    axes.figure.draw_without_rendering()
    ticks = axes.get_xticks() / YEAR
    assert ticks == pytest.approx(np.round(ticks), abs=1e-9)
    assert [label.get_text() for label in axes.get_xticklabels()] == [f"{tick:g}" for tick in np.round(ticks)]
    assert axes.get_xlabel() == "time (years of 31\u2009557\u2009600 s)"
    assert axes.lines[0].get_xdata()[-1] == 547 * YEAR


def test_moments_are_written_in_years() -> None:
    """Assert 5.5 years, where a film's clock has that many seconds of a long run."""
    assert at_time(times(547 * YEAR), 5.5 * YEAR, 4) == "t = 5.5 years"


def test_zoomable_figures_have_the_same_ticks() -> None:
    """Assert labels in days below the lines of a free mass, whose values stay in seconds."""
    pytest.importorskip("plotly")
    model = xd.Model(
        name="m",
        coordinates={"x": {"unit": "m"}},
        parameters={"m": "1 kg"},
        mass={"x": "m"},
        initial={"x": "0 m", "v_x": "1 m s-1"},
    )
    run = xd.simulate(model, method="rk4", step="1 h", until="20 d")
    page = xd.plot(run, only="x").interactive().figure
    axis = page.layout.xaxis
    assert axis.title.text.startswith("time (days of")
    assert [f"{tick / 86_400.0:g}" for tick in axis.tickvals] == [*axis.ticktext]
    assert max(page.data[0].x) == 20 * 86_400.0

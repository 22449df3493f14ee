"""Residuals beside their scale in diagnose, compare and validate: one scale for all times, stated, and never a zero crossed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from click.testing import CliRunner

import xdynamics as xd
from xdynamics.cli import main
from xdynamics.evidence.comparing.comparison_summary import comparison_lines
from xdynamics.evidence.diagnosing.diagnosis import diagnosis_lines as lines_of_diagnosis
from xdynamics.evidence.evidence_dataset import divide_by_scale, scale_of, scaled_variables
from xdynamics.evidence.validating.ledger_rows import ledger_lines as lines_of_ledger


def swing(
    amplitude: float = 1.0, middle: float = 0.0, unit: str = "m", step: float = 0.05, until: float = 3.0, k: float = 4.0
) -> xr.Dataset:
    """An oscillation about a point, in a unit, from its turn at the start."""
    model = xd.Model(
        name="swing",
        coordinates={"x": unit},
        parameters={"m": "1 kg", "k": f"{k!r} N m-1", "c": f"{middle!r} m", "A": f"{amplitude!r} m"},
        mass={"x": "m"},
        forces={"spring": {"potential": "k/2*(x - c)**2"}},
        initial={"x": f"{middle + amplitude!r} m", "v_x": "0 m s-1"},
        events={"through": {"function": "x - c"}},
    )
    return xd.simulate(model, method="rk4", step=step, until=until)


@pytest.mark.every(3)
@pytest.mark.cases(400)
def test_scales_of_random_oscillations(case: int) -> None:
    """Assert that residuals of closed forms that pass zero are finite over one scale, the largest expected size."""
    draw = np.random.default_rng(case)
    size, middle = 10.0 ** draw.uniform(-6, 6), draw.choice([0.0, 1.0, -0.5])
    amplitude = float(size * draw.uniform(0.5, 2.0))
    unit, factor = [("m", 1.0), ("mm", 1e-3), ("km", 1e3)][case % 3]
    run = swing(amplitude, float(middle * size), unit, until=float(draw.uniform(0.1, 3.0)))
    found = xd.diagnose(run, companion=False, exact={"x": "c + A*cos(sqrt(k/m)*t)"})
    expected = (middle * size + amplitude * np.cos(2.0 * run.time.values)) / factor
    assert found.residual_scale_x.attrs["units"] == unit
    assert float(found.residual_scale_x) == pytest.approx(np.abs(expected).max(), rel=1e-12)
    off = run.x.values - expected
    assert found.scaled_residual_x.values == pytest.approx(off / np.abs(expected).max(), rel=1e-6, abs=1e-14)
    assert float(found.scaled_largest_residual_x) == np.abs(found.scaled_residual_x.values).max()
    assert float(found.scaled_rms_residual_x) == pytest.approx(
        np.sqrt(np.mean(off**2)) / np.abs(expected).max(), rel=1e-6, abs=1e-14
    )


@pytest.mark.parametrize(
    ("expected", "computed", "scale"),
    [([0.0, -3.0], [1.0, 5.0], 3.0), ([0.0, 0.0], [1e-9, -2e-9], 2e-9), ([0.0], [0.0], 0.0), ([5e-324], [1.0], 5e-324)],
)
def test_the_scale_is_what_is_expected(expected: list[float], computed: list[float], scale: float) -> None:
    """Assert that what is computed is a scale only where nothing but 0 is expected."""
    assert float(scale_of(np.array(expected), np.array(computed))) == scale


def test_nothing_over_nothing_is_nothing() -> None:
    """Assert that a residual of 0 of what is 0 throughout is 0 of its scale, and that what is missing stays missing."""
    assert divide_by_scale(np.array([0.0, 0.0]), np.float64(0.0)).tolist() == [0.0, 0.0]
    assert np.isnan(divide_by_scale(np.array([np.nan]), np.float64(2.0))).all()


@pytest.mark.parametrize("scale", [5e-324, 1e-300, 0.25, 4.0, 1e300])
def test_every_scale_divides(scale: float) -> None:
    """Assert that a residual as large as its scale is 1 of it, however small the scale is."""
    assert divide_by_scale(np.array([scale, -scale]), np.float64(scale)).tolist() == [1.0, -1.0]


def test_the_largest_norm_is_the_largest_size() -> None:
    """Assert that of residuals of both signs and sizes the norm is the size of the largest, over the scale."""
    found = scaled_variables(
        "residual", "y", np.array([0.1, -0.3, 0.2]), np.float64(2.0), ("step",), "m", "y", ("largest", "rms")
    )
    assert float(found["scaled_largest_residual_y"][1]) == 0.15
    assert float(found["scaled_rms_residual_y"][1]) == pytest.approx(np.sqrt(0.14 / 3) / 2, rel=1e-15)


def test_runs_in_two_units() -> None:
    """Assert that the scale of two runs is the largest value of the first, in its units, whatever the second's are."""
    first, second = swing(2.0, unit="mm"), swing(2.0, unit="m", step=0.02, k=4.1)
    found = xd.compare(first, second, times=[0.5, 1.0, 1.5])
    values = 2000.0 * np.cos(2.0 * np.array([0.5, 1.0, 1.5]))
    assert found.difference_scale_x.attrs["units"] == "mm"
    assert float(found.difference_scale_x) == pytest.approx(np.abs(values).max(), rel=1e-4)
    assert found.scaled_difference_x.values == pytest.approx(
        found.difference_x.values / float(found.difference_scale_x)
    )
    assert found.scaled_difference_x.attrs["units"] == "1"
    assert "never its value at one time" in found.difference_scale_x.attrs["scale_rule"]


def test_times_of_events_are_scaled_by_the_time_since_the_start() -> None:
    """Assert that a shift of all times by a constant does not change what the difference of an event's time is scaled by."""
    first, second = swing(), swing(k=4.1)
    found = xd.compare(first, second)
    last = float(first.event_time[min(first.sizes["event"], second.sizes["event"]) - 1])
    assert float(found.difference_scale_event_time_through) == last
    assert found.scaled_difference_event_time_through.values == pytest.approx(
        found.difference_event_time_through.values / last
    )


def test_what_was_measured_is_the_scale_of_data() -> None:
    """Assert the scale of data, their scaled residuals and the scaled root of the mean square."""
    run = swing(2.0)
    data = pd.DataFrame({"time [s]": run.time.values, "x [cm]": 100.0 * run.x.values + 3.0})
    found = xd.compare(run, data)
    assert float(found.difference_scale_x) == pytest.approx(2.03, rel=1e-12)
    assert found.scaled_difference_x.values == pytest.approx(0.03 / 2.03, rel=1e-9)
    assert float(found.scaled_rms_difference_x) == pytest.approx(0.03 / 2.03, rel=1e-9)


def test_lazy_runs_have_lazy_scales(tmp_path: Path) -> None:
    """Assert that scales of runs behind dask arrays come out as those in memory."""
    run, other = swing(), swing(k=4.1)
    paths = [xd.save(one, tmp_path / f"{k}.nc") for k, one in enumerate((run, other))]
    found = xd.compare(*(xd.open_run(path).chunk({"step": 10}) for path in paths), times=[0.5, 1.0])
    assert found.difference_scale_x.chunks is not None
    whole = xd.compare(run, other, times=[0.5, 1.0])
    assert float(found.difference_scale_x) == float(whole.difference_scale_x)
    assert found.scaled_difference_x.values.tolist() == whole.scaled_difference_x.values.tolist()


FALL = """
name = "fall"
[coordinates]
y = "mm"
[parameters]
m = "1 kg"
g = "10 m s-2"
[mass]
y = "m"
[forces.gravity]
potential = "m*g*y"
[initial]
t = "5 s"
y = "2 m"
v_y = "0 m s-1"
[events.landing]
function = "y"
action = "stop"
[run]
method = "velocity_verlet"
step = "10 ms"
until = "7 s"
[validation.y]
expression = "2*metre - g*(t - 5*second)**2/2"
bound = "1 mm"
times = ["5.1 s", "5.3 s"]
[validation.landing]
quantity = "t"
event = "landing"
expression = "5*second + sqrt(4*metre/g)"
bound = "1 ms"
[validation.wrong]
quantity = "v_y"
expression = "-2*g*(t - 5*second)"
bound = "1 mm s-1"
times = ["5.5 s"]
[validation.nothing]
quantity = "y"
event = "landing"
expression = "0*metre"
bound = "1 mm"
"""


def test_ledgers_have_scales() -> None:
    """Assert the scale of each case in its units: the largest expected, of an event's time from the start, of 0 what came out."""
    found = xd.validate(xd.Model.from_text(FALL))
    assert found.residual_scale.values[:3] == pytest.approx([1950.0, np.sqrt(0.4), 1e4], rel=1e-12)
    assert float(found.residual_scale[3]) == float(found.residual[3])
    assert found.scaled_residual.values[2] == pytest.approx(0.5, rel=1e-9)
    assert found.scaled_residual.attrs["units"] == "1"
    assert "never its value at one time" in found.scaled_residual.attrs["scale_rule"]
    assert found.residual_scale.attrs["comment"] == found.residual.attrs["comment"]
    line = next(one for one in lines_of_ledger(found) if one.startswith("failed"))
    assert line.endswith("residual 5e+03 mm s-1, bound 1 mm s-1, scaled 0.5 by 1e+04 mm s-1")


def test_the_ledgers_own_cases_are_scaled() -> None:
    """Assert that each case that was marched has a scale, and that scaled residuals are the residuals over it."""
    found = xd.validate("velocity_verlet")
    marched = (found.case_run.values != "") & (
        found.case_norm.values == "largest absolute difference"
    )  # impacts: by bounds
    scale, residual = found.residual_scale.values, found.residual.values
    bounded = np.array([norm.endswith("from the bounds") for norm in found.case_norm.values])
    assert np.isfinite(scale[marched | bounded]).all()
    assert bounded.any()
    assert np.isnan(scale[~(marched | bounded)]).all()
    assert found.scaled_residual.values[scale > 0] == pytest.approx(
        (residual / np.where(scale > 0, scale, 1))[scale > 0]
    )


@pytest.mark.dear
def test_lines_say_the_scale(tmp_path: Path) -> None:
    """Assert that tables of the command line have scaled residuals and their scale beside the absolute ones."""
    run, other = swing(), swing(k=4.1)
    assert any(
        " m, scaled " in line and " by 1 m" in line
        for line in lines_of_diagnosis(xd.diagnose(run, companion=False, exact={"x": "A*cos(sqrt(k/m)*t)"}))
    )
    assert any(line.startswith("x ") and line.endswith(" of 1 m") for line in comparison_lines(xd.compare(run, other)))
    paths = [str(xd.save(one, tmp_path / f"{k}.nc")) for k, one in enumerate((run, other))]
    said = CliRunner().invoke(main, ["compare", *paths]).output
    assert " of 1 m" in said

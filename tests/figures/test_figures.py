"""Figures: what is drawn is what is recorded."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import xdynamics as xd
from cases.problems import MODELS, oscillator
from xdynamics.figures.curves import has_chords, refined_line, thinned_rows


@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
def test_every_format_is_written_and_names_its_run(tmp_path: Path, ending: str) -> None:
    """Assert that a file of each format begins as such a file does, has title and digest of the run, and no date."""
    run = xd.simulate(oscillator().model, step=0.01, until=5.0)
    xd.save(run, tmp_path / "run.nc")
    archived = xd.open_run(tmp_path / "run.nc")
    path = tmp_path / f"run.{ending}"
    xd.plot(archived, path)
    start = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}[ending]
    assert path.read_bytes().startswith(start)
    assert archived.attrs["content_digest"].encode() in path.read_bytes().replace(b"\\\n", b"")
    assert archived.attrs["title"].encode() in path.read_bytes()
    assert b"CreationDate" not in path.read_bytes()
    assert b"<dc:date>" not in path.read_bytes()


def test_axes_have_units_and_recorded_times() -> None:
    """Assert labels, and that the trajectory is drawn against recorded time."""
    run = xd.simulate(oscillator().model, step=0.01, until=5.0)
    axes = [axis for axis in xd.plot(run).axes if axis.get_visible()]
    assert [axis.get_title(loc="left").split(" (")[0].split(",")[0] for axis in axes] == [
        "trajectory",
        "velocity",
        "phase portrait",
        "total energy less its start",
    ]
    assert axes[0].get_ylabel() == "x (m)"
    assert axes[0].get_xlabel() == "time (s)"
    assert np.isin(run.time.values, axes[0].lines[0].get_xdata()).all()


def test_events_are_marked_by_name() -> None:
    """Assert that each kind of event is named on the trajectory."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "ball_drag.toml"), step="5 ms")
    assert [text.get_text() for text in xd.plot(run).axes[0].texts] == ["apex", "ground"]


def test_units_are_not_mixed_on_one_axis() -> None:
    """Assert that an angle and a length have panels of their own."""
    model = xd.Model(
        name="mixed",
        coordinates={"x": "m", "theta": "rad"},
        parameters={"m": "1 kg", "J": "1 kg m2"},
        mass={"x": "m", "theta": "J"},
        initial={"x": "0 m", "v_x": "1 m s-1", "theta": "0 rad", "v_theta": "1 rad s-1"},
    )
    run = xd.simulate(model, method="midpoint", step=0.1, until=1.0)
    labels = [axis.get_ylabel() for axis in xd.plot(run, panels="all").axes]
    assert labels[:4] == ["x (m)", "theta (rad)", "v_x (m s⁻¹)", "v_theta (rad s⁻¹)"]


@given(arrays(float, st.integers(5000, 30_000), elements=st.floats(-1e6, 1e6), fill=st.just(0.0)))
@pytest.mark.dear
def test_thinning_keeps_least_and_greatest(values: np.ndarray) -> None:
    """Assert that thinning keeps the extremes, the ends and the order, and at most 4,002 rows."""
    rows = thinned_rows(values)
    assert len(rows) <= 4002
    assert (np.diff(rows) > 0).all()
    assert rows[0] == 0
    assert rows[-1] == len(values) - 1
    assert values[rows].min() == values.min()
    assert values[rows].max() == values.max()


@pytest.mark.parametrize("name", ["run.gif", "run", "nowhere/run.png"])
def test_wrong_target(tmp_path: Path, name: str) -> None:
    """Assert that another ending and a missing folder are refused before anything is drawn."""
    with pytest.raises(xd.InputError, match="figure"):
        xd.plot(xr.Dataset(), tmp_path / name)


def test_what_is_no_run_is_not_drawn() -> None:
    """Assert that a figure needs recorded times."""
    with pytest.raises(xd.InputError, match="plot needs a run record"):
        xd.plot(xr.Dataset())


@pytest.mark.dear
def test_events_of_rows_that_are_left_out_are_not_marked() -> None:
    """Assert that a part of a run is drawn, though its events name rows of the whole."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "ball_drag.toml"), step="0.1 s", until="5 s")
    assert xd.plot(run).axes[0].texts
    assert not xd.plot(run.isel(step=slice(3))).axes[0].texts
    with pytest.raises(xd.InputError, match="variable 'event_detector' has the value 99"):
        xd.plot(run.assign(event_detector=run.event_detector * 0 + 99))


def test_lines_between_few_states_bend_as_the_motion_does() -> None:
    """Assert that what is drawn between long steps is the motion: states of the method's own steps, to the bit."""
    run = xd.simulate(oscillator().model, method="dop853", rtol=1e-9, until=5.0)
    times, values = refined_line(run, "x") or (np.zeros(0), np.zeros(0))
    assert run.sizes["step"] < 60
    assert len(times) > 1000
    assert (values == xd.sample(run, times).x.values).all()
    assert ((refined_line(run, "v_x") or ([], []))[1] == xd.sample(run, times).v_x.values).all()


def test_a_record_that_is_not_enough_for_its_steps_is_drawn_by_polynomials() -> None:
    """Assert Hermite's polynomials where rows were edited, near the motion, and through every row."""
    run = xd.simulate(oscillator().model, method="dop853", rtol=1e-9, until=5.0)
    other = run.assign(x=run.x * 1.1, v_x=run.v_x * 1.1, a_x=run.a_x * 1.1)
    times, values = refined_line(other, "x") or (np.zeros(0), np.zeros(0))
    assert np.abs(values - 1.1 * xd.sample(run, times).x.values).max() < 2e-5
    assert np.isin(other.x.values, values).all()
    assert has_chords(other, "total_energy", exact=True)


def test_nothing_is_drawn_between_rows_that_are_left_out() -> None:
    """Assert straight lines where the step from row to row is not the one recorded, and where rows are many."""
    run = xd.simulate(oscillator().model, method="dop853", rtol=1e-9, until=5.0)
    assert refined_line(run.isel(step=slice(None, None, 3)), "x") is None
    assert refined_line(run.drop_vars("v_x"), "x") is None
    titles = [axis.get_title(loc="left") for axis in xd.plot(run.isel(step=slice(None, None, 3))).axes]
    assert titles[0] == "trajectory; straight between rows"
    assert refined_line(xd.simulate(oscillator().model, step=0.001, until=5.0), "x") is None


@pytest.mark.dear
def test_contacts_are_marked_on_their_own_lines() -> None:
    """Assert names with what happens, on the coordinate that a gap reads, and a panel of the impulses."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "ball_in_box.toml"), until=1.8)
    axes = {axis.get_title(loc="left"): axis for axis in reversed(xd.plot(run).axes)}
    assert {text.get_text() for text in axes["trajectory"].texts} == {
        "ceiling impact ×3",
        "right impact",
        "floor impact ×2",
        "left impact",
    }
    marked = [line for line in axes["trajectory"].lines if line.get_marker() == "v"]
    walls = {round(float(one), 6) for line in marked for one in line.get_ydata()}
    assert walls == {0.0, 1.0}
    assert len(axes["impulses of impacts"].collections) == 2
    assert "contact and friction" not in axes  # nothing ever stays


def test_long_outcomes_are_whole_or_end_in_dots() -> None:
    """Assert that the text below is broken into lines, not cut."""
    run = xd.simulate(oscillator().model, step=0.01, until=1.0)
    figure = xd.plot(run.assign_attrs(run_outcome_text="word " * 400))
    told = figure._supxlabel.get_text()
    assert told.count("\n") == 2
    assert told.endswith("…")


def test_energies_are_drawn_where_their_total_changes_by_rounding_alone() -> None:
    """Assert three energies and how constant their sum is, not a picture of rounding; its change where it has one."""
    model = xd.Model.from_toml(MODELS / "relay_oscillator.toml")
    run = xd.simulate(model, until="10 s")
    (axes,) = xd.plot(run, only="energy").axes
    part = float(np.ptp(run.total_energy.values) / np.abs(run.kinetic_energy.values).max())
    assert axes.get_title(loc="left") == f"energy, total constant to {part:.0e} (relative)"
    assert len(axes.lines) == 3
    changed = run.assign(total_energy=run.total_energy * (1.0 + 1e-9 * np.arange(run.sizes["step"])))
    assert xd.plot(changed, only="energy").axes[0].get_title(loc="left").startswith("total energy less its start")


def test_lines_over_a_histogram_say_what_they_are() -> None:
    """Assert the median and both ends of 95 % of the members, named."""
    drawn = xd.Draws(32, {"k": ("1 N m-1", "2 N m-1")}, seed=1)
    sweep = xd.sweep(oscillator().model, {"draw": drawn}, step=0.1, until=1.0, keep=["end"]).compute()
    axes = next(axes for axes in xd.plot(sweep).axes if axes.get_ylabel() == "members")
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["median", "95 % between"]
    places = [float(line.get_xdata()[0]) for line in axes.lines]
    assert places == np.quantile(sweep.end_x.values, [0.5, 0.025, 0.975]).tolist()


def test_kinks_that_nobody_named_are_not_marked() -> None:
    """Assert that a plot of a thrown ball marks its events, and not where the modulus of its speed turns; a jump is."""
    model = xd.Model.from_toml(MODELS / "ball_drag.toml")
    texts = {"drag": {"y": "-c*v_y*abs(v_y)"}}
    run = xd.simulate(model.replace(forces=texts), method="dop853", rtol=1e-9)
    assert any("drag.abs" in str(word) for word in run.event_detector.attrs["flag_meanings"].split())
    written = {text.get_text() for axes in xd.plot(run).axes for text in axes.texts}
    assert {"ground"} <= {part for text in written for part in text.split(", ")}
    assert not any("drag.abs" in text for text in written)
    relay = xd.simulate(xd.Model.from_toml(MODELS / "relay_oscillator.toml"))
    legends = [axes.get_legend() for axes in xd.plot(relay).axes]
    assert any("relay.sign" in text.get_text() for legend in legends if legend for text in legend.get_texts())


def test_measured_data_stand_beside_a_run_as_pandas_has_them(tmp_path: Path) -> None:
    """Assert that a DataFrame is drawn over the same variable, and that the file names the run alone."""
    run = xd.simulate(oscillator().model, step=0.01, until=5.0)
    data = pd.DataFrame({"time [s]": [1.0, 2.0, 3.0], "x [m]": [0.1, 0.2, 0.3]})
    figure = xd.plot(run, tmp_path / "both.png", only="x", beside=data)
    assert any(np.array_equal(line.get_ydata(), data["x [m]"]) for line in figure.axes[0].lines)
    assert figure.about == f"{run.attrs['title']}: content_digest {xd.content_digest(run)}"

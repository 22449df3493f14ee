"""Figures of evidence: what was asked for first, no numbers at rounding, digits as far as they are known."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases import smooth_models as smooth
from cases.problems import MODELS, oscillator
from xdynamics.evidence.grid_axes import vanishing
from xdynamics.figures.comparison import fit_panels as panels_of_fit
from xdynamics.figures.ledger import panels_of as panels_of_ledger
from xdynamics.figures.refinement import foot_of, is_informative


@pytest.mark.dear
def test_a_refinement_draws_what_was_asked_for() -> None:
    """Assert six panels of a rocket at most, none of burnt fuel, hidden switches last, values with their uncertainty."""
    rocket = xd.Model.from_toml(MODELS / "rocket_c6.toml")
    study: xr.Dataset = xd.refine(rocket, steps=["40 ms", "20 ms", "10 ms"], occurrences=1)
    assert "difference_fuel" in study
    assert not is_informative(study, "fuel")
    axes = [axis for axis in xd.plot(study).axes if axis.get_visible()]
    titles = [axis.get_title(loc="left") for axis in axes]
    assert len(titles) == 6
    assert not any(title.startswith("fuel") or "pad." in title for title in titles)
    assert titles[0].startswith("y at t = ")
    assert all(" ± " in title for title in titles)


@pytest.mark.dear
def test_switches_hidden_in_forces_come_last() -> None:
    """Assert that the time of an apex stands before that of the zero of an abs, though both are the same instant."""
    ball = xd.Model(
        name="ball",
        coordinates={"y": "m"},
        parameters={"m": "1 kg", "c": "0.1 kg m-1"},
        mass={"y": "m"},
        forces={"weight": {"y": "-m*9.81*metre/second**2"}, "drag": {"y": "-c*v_y*abs(v_y)"}},
        initial={"y": "0 m", "v_y": "10 m s-1"},
        events={"apex": {"function": "v_y", "direction": "falling", "action": "record"}},
    )
    study = xd.refine(ball, method="midpoint", steps=["40 ms", "20 ms", "10 ms"], occurrences=1, until="1 s")
    named = [axis.get_title(loc="left").split(" = ")[0] for axis in xd.plot(study).axes if axis.get_visible()]
    assert named[2:5] == ["time of apex", "y after apex", "time of drag.abs"]
    lines = [line.split(" = ")[0] for line in repr(study.dynamics).splitlines()]
    assert lines.index("event_time_apex [1]") < lines.index("event_time_drag.abs [1]")
    stopped = ball.replace(events={"apex": {"function": "v_y", "direction": "falling", "action": "stop"}})
    study = xd.refine(stopped, method="midpoint", steps=["40 ms", "20 ms", "10 ms"], occurrences=1, until="1 s")
    titles = [axis.get_title(loc="left") for axis in xd.plot(study).axes if axis.get_visible()]
    assert titles[0].startswith("time of apex = ")
    assert titles[3].endswith(
        " s = 0 m s-1"
    )  # the end, where the apex is: zero but for rounding, and no uncertainty is known


def panels(figure: Any) -> dict[str, Any]:
    """The visible axes by their titles."""
    return {
        axes.get_title(loc="left"): axes for axes in figure.axes if axes.get_visible() and axes.get_title(loc="left")
    }


def test_modes_are_shapes() -> None:
    """Assert masses in phase and against each other, at the frequencies of two equal masses on three springs."""
    drawn = panels(xd.plot(xd.modes(xd.Model.from_toml(MODELS / "coupled_masses.toml"))))
    assert [title.split(":")[1].split(",")[0] for title in drawn] == [" 2 rad s⁻¹", " 3 rad s⁻¹"]
    together, against = (axes.lines[1].get_ydata() for axes in drawn.values())
    assert np.asarray(together) == pytest.approx([1.0, 1.0], rel=1e-12)
    assert np.asarray(against)[0] == pytest.approx(-np.asarray(against)[1], rel=1e-12)


def test_modes_of_one_quantity_name_it_once() -> None:
    """Assert that elements stand below, and their quantity below the axis."""
    chain = xd.Model(
        name="chain",
        dimensions={"bead": ["left", "middle", "right"]},
        relations={"next": {"of": "bead", "neighbours": 1}},
        coordinates={"tilt": {"unit": "degree", "dims": ["bead"]}},
        mass={"tilt": "1*kilogram*metre**2"},
        forces={
            "twist": {"over": "next", "potential": "1*joule*(second(tilt, next) - first(tilt, next))**2"},
            "anchor": {"potential": "1*joule*tilt**2"},
        },
        initial={"tilt": {"unit": "degree", "value": [0, 0, 0]}},
    )
    axes = xd.plot(xd.modes(chain)).axes[0]
    assert [label.get_text() for label in axes.get_xticklabels()] == ["left", "middle", "right"]
    assert axes.get_xlabel() == "tilt"


def test_modes_of_a_lattice_are_maps() -> None:
    """Assert the shape over both dimensions, the first across, in colours that part at zero."""
    square = xd.Model(
        name="membrane",
        dimensions={"row": 7, "column": 8},
        coordinates={"w": {"unit": "m", "dims": ["row", "column"]}},
        mass={"w": "1*kilogram"},
        forces={
            f"along_{dim}": {"w": f"1*newton/metre*(shift(w, {dim}, 1, 0*metre) - 2*w + shift(w, {dim}, -1, 0*metre))"}
            for dim in ("row", "column")
        },
        initial={"w": "0*metre*index(row)*index(column)"},
    )
    found = xd.modes(square)
    axes = xd.plot(found).axes[1]
    mesh = axes.collections[0]
    assert (np.asarray(mesh.get_array()) == found["shape_w"].values[1].T).all()
    assert mesh.get_clim() == (-1.0, 1.0)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("row, counted from 0", "column, counted from 0")
    assert axes.child_axes[0].get_ylabel() == "w (m)"


@pytest.mark.dear
def test_the_distance_of_two_runs_is_on_a_logarithmic_scale() -> None:
    """Assert a straight line of slope 1 for runs that part as exp(t)."""
    hill = xd.Model(
        name="hill",
        coordinates={"x": "m"},
        mass={"x": "1*kilogram"},
        forces={"push": {"x": "x*newton/metre"}},
        initial={"x": "1e-3 m", "v_x": "1e-3 m s-1"},
    )
    given = {"method": "dop853", "rtol": 1e-11, "until": "5 s"}
    near = hill.replace(initial={"x": "1.001e-3 m", "v_x": "1.001e-3 m s-1"})
    table = xd.compare(xd.simulate(hill, **given), xd.simulate(near, **given), times="0:5:11 s")
    assert len(panels(xd.plot(table))) == 4  # of x, v_x, and energies
    axes = panels(xd.plot(table))["distance of the runs"]
    assert axes.get_yscale() == "log"
    time, apart = (np.asarray(one) for one in axes.lines[0].get_data())
    assert np.polyfit(time, np.log(apart), 1)[0] == pytest.approx(1.0, abs=1e-6)


@pytest.fixture(scope="module")
def throws() -> xr.Dataset:
    """Throws of 9 angles and 9 speeds, until they land."""
    throw = xd.Model(
        name="throw",
        coordinates={"x": "m", "y": "m"},
        parameters={"angle": "45 degree", "v": "10 m s-1"},
        mass={"x": "1*kilogram", "y": "1*kilogram"},
        forces={"weight": {"y": "-9.81*newton"}},
        initial={"x": "-(v*second/metre - 10)**2*metre", "y": "0 m", "v_x": "v*cos(angle)", "v_y": "v*sin(angle)"},
        events={"ground": {"function": "y", "direction": "falling", "action": "stop"}},
    )
    axes_of = {"angle": "25:65:9 degree", "v": "8:12:9 m s-1"}
    return xd.sweep(throw, axes_of, keep=["end", "event_count_ground"], method="rk4", step="10 ms", until="5 s")


@pytest.mark.dear
def test_maps_have_contours_and_their_optimum(throws: xr.Dataset) -> None:
    """Assert lines of equal value, and the throw of greatest range near 45 degrees marked where it is."""
    title, axes = next((title, axes) for title, axes in panels(xd.plot(throws)).items() if title.startswith("end_x"))
    assert "greatest ▲" in title
    assert "m at angle 45 degree, v 11.0 m s⁻¹" in title
    assert any(type(item).__name__ == "QuadContourSet" for item in axes.collections)


def test_a_foot_counts_many_numbers_that_are_zero(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that of 200 elements which rounding leaves of zero ten are named."""
    model = xd.Model(
        name="rest",
        coordinates={"x": "m"},
        parameters={"m": "1 kg"},
        mass={"x": "m"},
        forces={"push": {"x": "1*newton"}},
        initial={"x": "0 m"},
    )
    sweep = xd.sweep(model, {"m": ["1 kg", "2 kg"]}, keep=["end"], method="rk4", step=0.1, until=0.2)
    monkeypatch.setattr("xdynamics.figures.sweep.vanishing", lambda _: [f"end_u[{k}]" for k in range(200)])
    foot = xd.plot(sweep).get_supxlabel().replace("\n", " ")
    assert foot.endswith("end_u[8], end_u[9] and 190 more")


@pytest.mark.dear
def test_what_rounding_leaves_of_zero_is_no_map(throws: xr.Dataset) -> None:
    """Assert that heights at landing are said to be zero and not drawn, but for those of nanometres, which are none."""
    drawn = xd.plot(throws)
    assert np.ptp(throws["end_y"].values) > 0.0
    assert {*panels(drawn)} & {"end_y", "end_v_y"} == {"end_v_y"}
    assert drawn.get_supxlabel().endswith("; zero to rounding: end_y")
    far = throws.assign(end_y=throws["end_y"] + 1e-9)
    assert vanishing(far) == []
    assert "end_y" in panels(xd.plot(far))


@pytest.mark.dear
def test_maps_of_whole_numbers_and_of_noise_have_no_contours(throws: xr.Dataset) -> None:
    """Assert a map of counts, and no lines where all but one row is noise beside that row."""
    count, speed = throws["event_count_ground"], throws["end_v_x"]
    noise = np.random.default_rng(1).normal(0.0, 1e-6, speed.shape)
    noise[:, 0] = 5.0 * (-1.0) ** np.arange(9)
    given = {"event_count_ground": count.copy(data=np.arange(81).reshape(9, 9)), "end_v_x": speed.copy(data=noise)}
    drawn = panels(xd.plot(throws.assign(given)))
    lined = [
        name for name, axes in drawn.items() if "QuadContourSet" in {type(item).__name__ for item in axes.collections}
    ]
    assert {name.split("\n")[0] for name in lined} == {"end_x", "end_v_y"}
    assert "event_count_ground" in drawn


def test_section_values_over_a_parameter_are_a_bifurcation_diagram() -> None:
    """Assert a dot for every occurrence above its value of the parameter."""
    model = xd.Model.from_toml(MODELS / "impact_oscillator_section.toml")
    grid = xd.sweep(model, {"w": "2.5:2.9:3 s-1"}, keep=["after_section_x"], occurrences=[2, 5], until="20 s")
    ((title, axes),) = [one for one in panels(xd.plot(grid)).items() if one[0].startswith("bifurcation")]
    assert title == "bifurcation diagram: after_section_x after the first 2"
    assert len({*np.asarray(axes.lines[0].get_xdata()).tolist()}) == 3


@pytest.mark.dear
def test_runs_of_a_sweep_are_drawn_together(tmp_path: Path) -> None:
    """Assert a line for each of few members; of many a band with their median, nothing where all are over."""
    asked: dict[str, Any] = {"method": "rk4", "step": 0.1, "keep": ["log"]}
    until = [1.0, 2.0] + [1.5] * 28
    grid = xd.sweep(
        oscillator().model, {"run": {"k": np.linspace(1.0, 2.0, 30), "until": until}}, path=tmp_path, **asked
    )
    logs = xd.open_logs(grid, "0:2.5:6 s")
    few = xd.plot(logs.isel(run=slice(4)))
    assert [len(axes.lines) for axes in few.axes] == [4, 4]
    assert few.texts[-1].get_text() == "4 members, a line each"
    many = panels(xd.plot(logs))
    assert [*many] == ["x", "v_x"]
    (band,), middle = many["x"].collections, many["x"].lines[0]
    held = logs.x.values
    assert middle.get_ydata()[:4].tolist() == np.nanmedian(held[:, :4], axis=0).tolist()
    assert np.isnan(middle.get_ydata()[5])
    assert band.get_paths()[0].vertices[:, 1].min() == pytest.approx(np.nanquantile(held[:, :5], 0.025, axis=0).min())
    assert len(many["x"].lines) == 1 + 24
    assert all("(" in axes.get_ylabel() for axes in many.values())


def test_a_refinement_over_words_has_no_order() -> None:
    """Assert that no dashed line is told of where there is none."""
    ball = xd.Model.from_toml(MODELS / "bouncing_ball.toml")
    study = xd.refine(ball, rules=["interpolant", "reintegrate"], method="euler_cromer", step="20 ms", until="1 s")
    foot = xd.plot(study).texts[-1].get_text()
    assert "nan" not in foot
    assert "dashed" not in foot


def test_noise_that_is_alone_is_drawn_as_the_zero_that_it_is(throws: xr.Dataset) -> None:
    """Assert one colour for heights at landing where nothing else is kept: axes and parameters say what is small."""
    alone = throws.drop_vars(
        [name for name in throws.data_vars if str(name).startswith("end_") and name not in ("end_y", "end_time")]
    )
    assert vanishing(alone) == ["end_y"]
    (axes,) = [axes for title, axes in panels(xd.plot(alone)).items() if title.startswith("end_y")]
    assert not axes.collections[0].get_array().any()


def test_a_run_is_drawn_inside_its_tube(tmp_path: Path) -> None:
    """Assert bands of coordinates and energies, a run inside about their middle, and that nothing else is drawn there."""
    model = smooth.oscillator(x={"value": "1 m", "half_width": "1 mm"})
    tube = xd.enclose(model, until="1 s", order=10, rtol=1e-8)
    run = xd.simulate(model, method="rk4", step="5 ms", until="1 s")
    figure = xd.plot(tube, tmp_path / "tube.png", beside=run)
    drawn = panels(figure)
    assert [title.split(",")[0] for title in drawn] == [
        "x",
        "v_x",
        "kinetic_energy",
        "potential_energy",
        "total_energy",
    ]
    low, high, inside = (line.get_ydata() for line in next(iter(drawn.values())).lines)
    assert ((low < inside) & (inside < high)).all()
    assert (tmp_path / "tube.png").stat().st_size > 10_000
    with pytest.raises(xd.InputError, match="what is drawn inside proven bounds is a run"):
        xd.plot(tube, beside=tube)


CHAIN = """
name = "chain"
[dimensions]
site = 8
[coordinates]
u = { unit = "m", dims = ["site"] }
[parameters]
k = "4 N m-1"
[mass]
u = "1*kilogram"
[forces.springs]
u = "k*(shift(u, site, 1, 0*metre) + shift(u, site, -1, 0*metre) - 2*u)"
[initial]
u = "0.1*metre*sin(3*pi*(index(site) + 1)/(size(site) + 1))"
[run]
method = "velocity_verlet"
step = "0.1 s"
until = "4 s"
"""


def test_a_comparison_draws_the_elements_that_part_farthest() -> None:
    """Assert that lines are those of the largest differences, with a unit, and that each panel names its element."""
    chain = xd.Model.from_text(CHAIN)
    table = xd.compare(xd.simulate(chain), xd.simulate(chain, step="50 ms"))
    largest = np.abs(table["difference_u"]).max("at").values
    order = [f"u[{number}]" for number in np.argsort(-largest, kind="stable")]
    drawn = panels(xd.plot(table))
    distance, *apart = drawn.values()
    assert [text.get_text() for text in distance.get_legend().get_texts()] == order[:6] != sorted(order[:6])
    assert distance.get_ylabel() == "|difference of u| (m)"
    assert "the farthest 6 of 8" in distance.get_title(loc="left")
    assert np.nanmax(distance.lines[0].get_ydata()) == largest.max()
    titles = [axes.get_title(loc="left") for axes in apart]
    assert len({*titles}) == 3
    assert titles[0].startswith(f"{order[0]}, second run minus first")
    assert titles[1].startswith("v_u[")


def test_elements_of_a_sweep_share_a_panel() -> None:
    """Assert one panel for the ends of eight elements and one for their velocities, a line for each, on one scale."""
    table = xd.sweep(xd.Model.from_text(CHAIN), {"k": ["1 N m-1", "2 N m-1", "3 N m-1"]}, keep=["end", "maximum_u"])
    drawn = panels(xd.plot(table))
    assert {*drawn} - {"maximum_u"} == {"end_u", "end_v_u"}
    assert all("_time" not in str(line.get_label()) for axes in drawn.values() for line in axes.lines)
    lines = drawn["end_u"].lines
    assert [line.get_label() for line in lines] == [f"end_u[{number}]" for number in range(8)]
    assert (np.stack([line.get_ydata() for line in lines], -1) == table["end_u"].values).all()


def test_elements_of_a_sweep_over_two_axes_share_a_panel() -> None:
    """Assert four maps of eight elements with their numbers on one scale in one panel, and what is left out."""
    axes_of = {"k": ["1 N m-1", "2 N m-1", "3 N m-1"], "until": ["0.5 s", "1 s"]}
    table = xd.sweep(xd.Model.from_text(CHAIN), axes_of, keep=["end"])
    figure = xd.plot(table)
    titles = [axes.get_title(loc="left").strip() for axes in figure.axes if axes.get_title(loc="left")]
    assert titles == ["end_u, 4 of 8 elements", "end_v_u, 4 of 8 elements"]
    assert "k (N m⁻¹)" in {axes.get_xlabel() for axes in figure.axes}
    maps = {axes.get_title(): axes.collections[0] for axes in figure.axes if axes.get_title()}
    for number in (0, 2, 5, 7):
        drawn = maps[f"end_u[{number}]"]
        assert (drawn.get_array() == table["end_u"].values[..., number].T).all()
        assert drawn.get_clim() == maps["end_u[0]"].get_clim()


def test_elements_of_a_refinement_share_a_panel() -> None:
    """Assert a line for each of eight elements with its differences, names of the three that differ most, and verdicts."""
    model = xd.Model.from_text(CHAIN.replace("sin(3*pi", "sin(2.5*pi"))
    steps = ["0.02 s", "0.01 s", "0.005 s", "0.0025 s"]
    study = xd.refine(model, method="velocity_verlet", steps=steps, at=["0.5 s", "1 s"], observables=["u"])
    figure = xd.plot(study)
    (axes,) = figure.axes
    changes = np.abs(study["difference_u"].isel(at=-1).values[:-1])
    order = [*np.argsort(-changes.max(axis=0), kind="stable")]
    names = [text.get_text().split(",")[0] for text in axes.get_legend().get_texts()]
    assert names == [f"u[{number}]" for number in order[:3]]
    found = [np.asarray(line.get_ydata()) for line in axes.lines if line.get_linestyle() == "-"]
    assert len(found) == 8
    for number in range(8):
        assert any(line.shape == (3,) and (line == changes[:, number]).all() for line in found)
    title = " ".join(axes.get_title(loc="left").split())
    assert title == "u at t = 1 s, 8 elements: 8 asymptotic"
    assert "; grey: elements that differ less than the 3 named" in " ".join(figure.texts[-1].get_text().split())


def test_numbers_that_do_not_differ_have_no_panel() -> None:
    """Assert that beside a number that differs by rounding those are left out and named that do not, or have no value."""
    ball = xd.Model(
        name="ball",
        coordinates={"y": "m", "z": "m"},
        parameters={"m": "1 kg", "a": "2 m s-2"},  # all that y is at steps of powers of two has no rounding
        mass={"y": "m", "z": "m"},
        forces={"push": {"y": "m*a", "z": "1e-13*newton*sin(3*t/second)"}},
        initial={"y": "0 m", "v_y": "1 m s-1", "z": "0.1 m", "v_z": "0.3 m s-1"},
    )
    steps = ["0.25 s", "0.125 s", "0.0625 s"]
    study = xd.refine(ball, method="velocity_verlet", steps=steps, at=["1 s"], until="1 s", observables=["y", "z"])
    assert not study["difference_y"][:-1].any()
    assert study["difference_z"][:-1].any()
    (axes,) = [axis for axis in xd.plot(study).axes if axis.get_visible()]
    assert axes.get_title(loc="left").startswith("z at t = 1 s")
    finest = study.assign(z=study.z.copy(data=np.array([[7.0], [8.0], [9.0]])))
    assert xd.plot(finest).axes[0].get_title(loc="left").startswith("z at t = 1 s = 9")
    assert foot_of(study).endswith("; not drawn, as levels do not differ: y")
    assert "grey" not in foot_of(study)
    assert foot_of(study.assign(y=study.y * np.nan)).endswith("dashed: order 2; without a value: y")
    left, right = axes.get_xlim()
    assert left <= 0.0625 < 0.25 <= right
    still = study.drop_vars([name for name in study.data_vars if str(name).endswith("z")])
    said = {text.get_text() for axis in xd.plot(still).axes for text in axis.texts}
    assert said == {"no difference between levels"}


def test_modes_of_many_elements_have_whole_numbers_below() -> None:
    """Assert no tick between two elements."""
    axes = xd.plot(xd.modes(xd.Model.from_text(CHAIN.replace("= 8", "= 20")))).axes[0]
    assert {float(tick) % 1.0 for tick in axes.get_xticks()} == {0.0}


def test_one_cycle_is_drawn_as_what_it_is() -> None:
    """Assert the period itself, and not its difference from itself, where a run has one cycle; with its unit typeset."""
    model = xd.Model.from_text(CHAIN.replace("= 8", "= 1"))
    found = xd.diagnose(xd.simulate(model, method="rk4", step="0.01 s", until="4.5 s"))
    assert found.sizes["cycle"] == 1
    period = next(axes for axes in xd.plot(found).axes if axes.get_title(loc="left").startswith("period"))
    assert period.lines[0].get_ydata()[0] == float(found["period"][0])
    assert "less its start" not in period.get_title(loc="left")


def test_units_in_titles_are_typeset() -> None:
    """Assert powers as such in the titles of areas of cycles."""
    found = xd.diagnose(
        xd.simulate(xd.Model.from_text(CHAIN.replace("= 8", "= 1")), method="rk4", step="0.01 s", until="9 s")
    )
    titles = [axes.get_title(loc="left") for axes in xd.plot(found).axes]
    (area,) = (title for title in titles if title.startswith("phase_space_area"))
    assert area.endswith("m² s⁻¹")


def test_a_ledger_of_one_method_shows_how_close_each_case_comes() -> None:
    """Assert a dot for each residual over its bound, a failed one red, a circle where there is none, nothing where refused."""
    names, verdicts = np.array([f"T[{k}]" for k in range(130)]), np.zeros(130, np.int8)
    residuals, bounds = np.full(130, 2e-3), np.full(130, 1e-1)
    residuals[1], verdicts[1] = 0.5, 1
    residuals[2], bounds[2] = 0.0, 0.0
    residuals[3], bounds[3], verdicts[3] = np.nan, np.nan, 2
    ledger = xr.Dataset(
        {
            "case_name": ("case", names),
            "case_method": ("case", np.full(130, "rk4")),
            "residual": ("case", residuals),
            "bound": ("case", bounds),
            "verdict": ("case", verdicts, {"flag_values": [0, 1, 2], "flag_meanings": "passed failed refused"}),
        }
    )
    figure, axes = plt.subplots()
    panels_of_ledger(ledger)[0](axes)
    sound, failed, none = axes.lines[1:]
    assert np.array_equal(sound.get_xdata(), np.full(127, 0.02))
    assert (failed.get_xdata().tolist(), failed.get_ydata().tolist()) == ([5.0], [1.5])
    assert none.get_ydata().tolist() == [2.5]
    assert len(axes.get_yticks()) == 44
    assert axes.get_ylim() == (130.0, 0.0)
    plt.close(figure)


def test_a_fit_to_few_times_says_that_its_line_is_straight_between() -> None:
    """Assert the word in the legend, and none of it where there are many times; and the residuals beside it."""
    for count, label in ((4, "fitted model, straight between the times"), (200, "fitted model")):
        at = np.linspace(0.0, 1.0, count)
        columns = {name: ("at", at, {"units": "m"}) for name in ("y", "measured_y", "residual_y")}
        fit = xr.Dataset({**columns, "at_time": ("at", at, {"units": "s"})})
        figure, axes = plt.subplots()
        panels_of_fit(fit)[0](axes)
        assert [text.get_text() for text in axes.get_legend().get_texts()] == ["measured", label]
        axes.clear()
        panels_of_fit(fit)[1](axes)
        assert np.array_equal(axes.lines[0].get_ydata(), at)
        plt.close(figure)


def test_compared_grids_are_drawn_by_their_uncertainty() -> None:
    """Assert a panel for each number that differs by more than rounding, maps over two axes, lines over one, points of words."""
    model = xd.Model.from_toml(MODELS / "ball_drag.toml")
    axes = {"vt": "20:60:3 m s-1", "v_y": "10:20:4 m s-1"}
    asked = {"keep": ["event_time_ground", "end_y"], "method": "heun", "step": ["20 ms", "10 ms"]}
    steps = {"step": asked.pop("step")}
    grids = [
        xd.sweep(model.replace(parameters={"g": g}), axes | steps, **asked) for g in ("9.80665 m s-2", "9.7 m s-2")
    ]
    found = xd.compare(*grids).compute()
    figure = xd.plot(found)
    drawn = [axis for axis in figure.axes if axis.get_title(loc="left")]
    assert [axis.get_title(loc="left").split(",")[0] for axis in drawn] == ["end_time"] * 2 + ["event_time_ground"] * 2
    assert "parameters: g: 9.80665 m s-2 | 9.7 m s-2" in "".join(text.get_text() for text in figure.texts)
    lines = xd.plot(found.isel(v_y=1, solver_step=1))
    assert [axis.get_title(loc="left") for axis in lines.axes] == [
        f"{name}: 3 of 3 differ" for name in ("end_time", "event_time_ground")
    ]
    grid = xd.sweep(model, {"method": ["heun", "rk4", "midpoint"]}, keep=["event_time_ground"], step="20 ms")
    points = xd.plot(xd.contrast(grid, "method", reference="rk4"))
    assert [label.get_text() for label in points.axes[0].get_yticklabels()] == ["heun", "midpoint"]


def test_errors_of_single_steps_have_panels_of_their_own() -> None:
    """Assert a panel for each unit of the defects, beside their order, one above that of the method."""
    study = xd.refine(
        xd.Model.from_toml(MODELS / "harmonic_oscillator.toml"),
        steps=["100 ms", "50 ms", "25 ms"],
        method="rk4",
        until="1 s",
        defects=True,
    )
    figure = xd.plot(study)
    titles = [axis.get_title(loc="left") for axis in figure.axes]
    assert titles.count("largest error of a single step") == 2
    legend = figure.axes[titles.index("largest error of a single step")].get_legend()
    assert [text.get_text() for text in legend.get_texts()] == ["x", "order 5"]


def test_a_pareto_front_lies_below_the_lines_of_methods() -> None:
    """Assert one broad line for each problem, of the runs that none betters, and its name once in the legend."""
    model = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
    axes = {"method": ["heun", "rk4"], "step": ["100 ms", "50 ms", "25 ms"], "k": [4.0, 9.0]}
    found = xd.precision(model, axes, until="2 s", keep=["end_x"])
    axis = xd.plot(found).axes[0]
    broad = [line for line in axis.lines if line.get_linewidth() > 5.0]
    assert len(broad) == 2
    names = [text.get_text() for text in axis.get_legend().get_texts()]
    assert names[:2] == ["Pareto front", "heun, k = 4 N m-1"]

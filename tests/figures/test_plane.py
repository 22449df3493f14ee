"""Pictures of the plane, of many variables, of drives, beside other runs; films."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure
from PIL import Image

import xdynamics as xd
from cases.command_line import call
from cases.problems import MODELS
from xdynamics.figures.animation import drawn_frames
from xdynamics.figures.marks import typeset
from xdynamics.figures.plane import views
from xdynamics.figures.scenes import scene_of


@pytest.fixture(scope="module")
def orbit() -> xr.Dataset:
    """An ellipse, by few steps."""
    return xd.simulate(xd.Model.from_toml(MODELS / "kepler.toml"), method="dop853", rtol=1e-7, until="13 s")


def titles(figure: Any) -> list[str]:
    """What stands above the panels."""
    return [axis.get_title(loc="left") for axis in figure.axes if axis.get_visible() and axis.get_title(loc="left")]


def test_an_orbit_is_drawn_as_one(orbit: xr.Dataset) -> None:
    """Assert that two lengths are a plane with one scale, and that the line bends: it keeps to the ellipse between rows."""
    axes = xd.plot(orbit).axes[0]
    assert axes.get_title(loc="left") == "the plane (dot: start)"
    assert axes.get_aspect() == 1.0
    x, y = (np.asarray(one) for one in axes.lines[0].get_data())
    assert len(x) > 5 * orbit.sizes["step"]
    assert np.abs((x + 0.6) ** 2 + y**2 / (1 - 0.6**2) - 1.0).max() < 2e-3


def test_positions_that_a_model_names() -> None:
    """Assert the bobs of a double pendulum where its rods put them."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "double_pendulum.toml"), method="dop853", rtol=1e-9)
    (view,) = views(run)
    upper, lower = view
    assert np.hypot(upper.x, upper.y) == pytest.approx(np.ones(upper.x.size), rel=1e-12)
    assert np.hypot(lower.x - upper.x, lower.y - upper.y) == pytest.approx(np.full(upper.x.size, 0.7), rel=1e-12)
    assert upper.units == "m"


def test_three_coordinates_are_seen_from_three_sides() -> None:
    """Assert three views of a motion in space, and none of angles."""
    space = xd.Model(
        name="space",
        coordinates=dict.fromkeys("xyz", "m"),
        mass=dict.fromkeys("xyz", "1*kilogram"),
        forces={"pull": {letter: f"-{letter}*newton/metre" for letter in "xyz"}},
        initial={"x": "1 m", "y": "2 m", "z": "0 m", "v_z": "1 m s-1"},
    )
    run = xd.simulate(space, method="rk4", step=0.1, until=3.0)
    assert [(one.across, one.up) for (one,) in views(run)] == [("x", "y"), ("x", "z"), ("y", "z")]
    assert views(xd.simulate(xd.Model.from_toml(MODELS / "pendulum.toml"), until="1 s")) == []


@pytest.mark.parametrize(
    ("figure", "said"),
    [
        ({"plane": "x"}, "needs two expressions"),
        ({"plane": [["x", "y", "z"]]}, "needs two expressions"),
        (
            {"plane": [["x", "y"], ["x", "v_y"]]},
            "pair 2 of plane: is across in 'm' and up in 'm s-1', the first in 'm', 'm'",
        ),
        ({"plane": ["x", "q"]}, "'q'"),
        ({"plan": []}, "key 'plan' is not known"),
    ],
)
def test_planes_that_are_none(figure: dict[str, Any], said: str) -> None:
    """Assert that a plane of other units, names or shapes is refused."""
    with pytest.raises(xd.ModelError, match=said):
        xd.Model(
            name="x",
            coordinates={"x": "m", "y": "m"},
            mass={"x": "1*kilogram", "y": "1*kilogram"},
            initial={"x": "0 m", "y": "0 m"},
            figure=figure,
        )


def test_phase_planes_of_states_and_of_expressions() -> None:
    """Assert states by twos, each on its own scale, and a plane of unlike expressions of states and velocities."""

    def prey(_: Any, y: Any) -> Any:
        return [y[0] * (1.0 - y[1]), y[1] * (y[0] - 1.0)]

    run = xd.solve(prey, (0, 10), [2.0, 1.0], "DOP853", rtol=1e-8)
    figure = xd.plot([run, xd.solve(prey, (0, 10), [1.5, 1.0], "DOP853", rtol=1e-8)])
    axes = next(axis for axis in figure.axes if axis.get_title(loc="left").startswith("phase plane"))
    assert axes.get_aspect() == "auto"
    x, y = (np.asarray(one) for one in axes.lines[0].get_data())
    constant = x - np.log(x) + y - np.log(y)  # of Lotka and Volterra
    assert np.ptp(constant) < 1e-6
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert labels == [f"{axes.get_xlabel()}(0) = {start}" for start in (2, 1.5)]
    model = xd.Model.from_toml(MODELS / "pendulum.toml")
    text = model.to_toml().replace(
        "[run]", '[figure]\nplane = ["v_theta*second/(2*radian)", "cos(theta)*metre"]\n\n[run]'
    )
    (view,) = views(xd.simulate(xd.Model.from_text(text), until="1 s"))
    assert (view[0].units, view[0].up_units, view[0].is_space) == ("1", "m", False)


@pytest.mark.dear
def test_many_variables_are_a_map() -> None:
    """Assert that a chain of 20 is drawn in colours with a bar, and no panel has twenty lines."""
    names = [f"x{k}" for k in range(20)]
    chain = xd.Model(
        name="chain",
        coordinates=dict.fromkeys(names, "m"),
        mass=dict.fromkeys(names, "1*kilogram"),
        initial=dict.fromkeys(names, "0 m") | {"v_x0": "1 m s-1"},
        forces={"springs": {"potential": " + ".join(f"(x{k + 1} - x{k})**2*newton/metre" for k in range(19))}},
    )
    figure = xd.plot(xd.simulate(chain, method="velocity_verlet", step=0.05, until=5.0))
    assert titles(figure) == [
        "trajectory, 20 rows, one per variable",
        "velocity, 20 rows, one per variable",
        "total energy less its start, 0.5 J",
    ]
    assert max(len(axis.lines) for axis in figure.axes) < 3


@pytest.mark.dear
def test_time_is_logarithmic_where_rows_ask_for_it() -> None:
    """Assert a logarithmic axis of Robertson's reaction, whose rows stand at decades, and none of an orbit's."""

    def reaction(_: Any, y: Any) -> Any:
        return [-0.04 * y[0] + 1e4 * y[1] * y[2], 0.04 * y[0] - 1e4 * y[1] * y[2] - 3e7 * y[1] ** 2, 3e7 * y[1] ** 2]

    run = xd.solve(reaction, (0, 1e5), [1.0, 0.0, 0.0], "Radau", rtol=1e-6, atol=1e-9)
    panels = [axis for axis in xd.plot(run, panels="all").axes if axis.get_visible()]
    over_time = [axis for axis in panels if axis.get_xlabel().startswith("time")]
    assert all(axis in over_time or axis.get_title("left").startswith("phase") for axis in panels)
    assert {axis.get_xscale() for axis in over_time} == {"log"}
    assert xd.plot(xd.simulate(xd.Model.from_toml(MODELS / "rocket_c6.toml"))).axes[0].get_xscale() == "linear"


@pytest.mark.dear
def test_drives_and_exchanged_energy() -> None:
    """Assert that a thrust is drawn through its own points, and energies where a drag takes of them."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "rocket_c6.toml"))
    axes = next(axis for axis in xd.plot(run).axes if axis.get_title(loc="left").startswith("measured drives"))
    assert axes.get_ylabel() == "thrust (N)"
    assert float(np.max(axes.lines[0].get_ydata())) == 14.09
    ball = xd.simulate(xd.Model.from_toml(MODELS / "ball_drag.toml"))
    axes = next(axis for axis in xd.plot(ball).axes if axis.get_title(loc="left") == "energy, changed by forces")
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["kinetic", "potential", "total"]


@pytest.mark.dear
def test_panels_and_variables_that_are_chosen(orbit: xr.Dataset) -> None:
    """Assert kinds, names, variables that are drawn when named alone, and what is none."""
    assert titles(xd.plot(orbit, only="plane")) == ["the plane (dot: start)"]
    assert [axis.get_ylabel() for axis in xd.plot(orbit, only=["x"]).axes] == ["x (m)"]
    assert xd.plot(orbit, only="a_x").axes[0].get_ylabel() == "a_x (m s⁻²)"
    with pytest.raises(xd.InputError, match="only has 'speed'; there are plane, "):
        xd.plot(orbit, only=["speed"])
    with pytest.raises(xd.InputError, match="only, panels and beside are for figures of a run"):
        xd.plot(xd.refine(xd.Model.from_toml(MODELS / "pendulum.toml"), steps=["20 ms", "10 ms"], at=["1 s"]), only="x")


def test_beside_a_run(orbit: xr.Dataset, tmp_path: Path) -> None:
    """Assert that another run and measured points stand in the run's unit, with bars, and what has nothing in common is refused."""
    path = tmp_path / "bench.csv"
    path.write_text("time [ms];x [cm];u(x) [cm]\n0;40;1\n1000;-62,9;1\n")
    other = xd.simulate(xd.Model.from_toml(MODELS / "kepler.toml"), method="euler_cromer", step="20 ms", until="13 s")
    axes = xd.plot(orbit, only=["x"], beside=[path, other]).axes[0]
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert labels == ["dop853, rtol 1e-07", "euler_cromer, step 0.02 s", "measured, bench.csv"]
    points = next(line for line in axes.lines if line.get_marker() == "+")
    assert points.get_ydata() == pytest.approx([0.4, -0.629])
    (tmp_path / "other.csv").write_text("time [s],q [m]\n0,1\n")
    with pytest.raises(xd.InputError, match="column .q .m.. is no quantity of the model, which has"):
        xd.plot(orbit, beside=tmp_path / "other.csv")
    (tmp_path / "other.csv").write_text("time [s],x [kg]\n0,1\n")
    with pytest.raises(xd.InputError, match="is in 'kg', the run has it in 'm'"):
        xd.plot(orbit, beside=tmp_path / "other.csv")


@pytest.mark.dear
def test_size_ground_and_the_command_line(orbit: xr.Dataset, tmp_path: Path) -> None:
    """Assert inches and dots, a dark ground, and that wrong ones are named."""
    run = xd.save(orbit, tmp_path / "orbit.nc")
    done = call(
        "plot", run, "-o", tmp_path / "a.png", "--only", "plane,energy", "--size", "6x4", "--dpi", "50", "--dark"
    )
    assert done.exit_code == 0, done.output
    with Image.open(tmp_path / "a.png") as image:
        assert image.size == (300, 200)
        assert image.convert("L").getpixel((2, 2)) < 40
    assert call("plot", run, "-o", tmp_path / "b.pdf", "--with", run).exit_code == 0
    assert (tmp_path / "b.pdf").read_bytes().startswith(b"%PDF")
    for wrong, said in (
        (["--size", "6"], "like 8x5"),
        (["--size", "0x5"], "from 1 to 100"),
        (["--dpi", "5"], "from 20 to 1200"),
        (["--only", "z"], "only has 'z'"),
        (["--only", "z,energy,w"], "only has 'z', 'w'; there are"),
        (["--with", "no.csv"], "table 'no.csv' is not in"),
    ):
        done = call("plot", run, "-o", tmp_path / "c.png", *wrong)
        assert (done.exit_code, said in done.output) == (2, True), done.output
        assert not (tmp_path / "c.png").exists()


@pytest.mark.dear
def test_a_film(orbit: xr.Dataset, tmp_path: Path) -> None:
    """Assert frames of a film, and that no plane, another ending, or a wrong number is named."""
    run = xd.save(orbit, tmp_path / "orbit.nc")
    assert call("animate", run, "-o", tmp_path / "orbit.gif", "--seconds", "0.4").exit_code == 0
    with Image.open(tmp_path / "orbit.gif") as film:
        assert film.n_frames == 10
    assert call("animate", run, "-o", tmp_path / "orbit.html", "--seconds", "0.4").exit_code == 0
    assert (tmp_path / "orbit.html").read_text().count("iVBORw0KGgo") == 10
    pendulum = xd.simulate(xd.Model.from_toml(MODELS / "pendulum.toml"), until="1 s")
    with pytest.raises(xd.InputError, match="the run has no plane to be seen in"):
        pendulum.dynamics.animate(tmp_path / "p.gif")
    for given, said in (
        ({"path": tmp_path / "o.avi"}, "there are .gif, .mp4, .html"),
        ({"seconds": -1}, "need a number up to 600"),
        ({"rate": 0}, "from 1 to 100"),
        ({"path": tmp_path / "no" / "o.gif"}, "film"),
    ):
        with pytest.raises(xd.InputError, match=said):
            xd.animate(orbit, **{"path": tmp_path / "o.gif"} | given)
    assert not (tmp_path / "o.gif").exists()


def test_a_film_draws_what_moves_over_what_stands(tmp_path: Path) -> None:
    """Assert that a frame drawn over the still picture is the one drawn whole, and that the film is as long as the motion is high."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "thrown_ball.toml"))
    scene = scene_of(run, None)
    assert scene is not None
    width, height = scene.size
    assert 1.5 < width / height < 3.0  # 80 m far and 25 m high
    figure = Figure(figsize=scene.size, dpi=50)
    axes = figure.subplots()
    scene.start(axes)
    frames = [*drawn_frames(figure, lambda frame: scene.move_to(0.5 * (frame + 1)), 3)]
    moved = scene.move_to(1.5)
    for artist in moved:
        artist.set_animated(False)
    figure.savefig(tmp_path / "whole.png")
    with Image.open(tmp_path / "whole.png") as whole:
        assert np.abs(np.asarray(whole.convert("RGB"), int) - np.asarray(frames[2], int)).max() < 60
    film = xd.animate(run, seconds=0.2)
    with pytest.raises(xd.InputError, match="the film was not written: give animate a path"):
        film.__fspath__()


@pytest.mark.parametrize(
    ("units", "shown"),
    [
        ("m s-1", "m s⁻¹"),
        ("kg m2 s-2", "kg m² s⁻²"),
        ("1", "1"),
        ("rad s-1", "rad s⁻¹"),
        ("mm", "mm"),
        ("s-12", "s⁻¹²"),
    ],
)
def test_units_in_print(units: str, shown: str) -> None:
    """Assert powers above the line."""
    assert typeset(units) == shown


@pytest.mark.dear
def test_runs_in_one_plane(orbit: xr.Dataset) -> None:
    """Assert that other orbits stand in the plane and beside the energy, by name."""
    other = xd.simulate(xd.Model.from_toml(MODELS / "kepler.toml"), method="euler_cromer", step="20 ms", until="13 s")
    named = ["dop853, rtol 1e-07", "euler_cromer, step 0.02 s"]
    for axes in xd.plot([orbit, other]).axes:
        labels = [text.get_text() for text in axes.get_legend().get_texts()]
        count = 2 if axes.get_title(loc="left").startswith(("trajectory", "velocity", "phase")) else 1
        assert labels[:: count or 1] if count == 1 else len(labels) == 4
        assert (labels if count == 1 else [label.split(", ", 1)[1] for label in labels[::2]]) == named
    given = xd.plot({"exact": orbit, "first order": other}, only=["plane", "energy", "phase", "steps"])
    assert [axes.get_legend().get_texts()[0].get_text() for axes in given.axes] == [
        "exact",
        "x, exact",
        "exact",
        "exact",
    ]
    for wrong, said in (([], "got no record"), ([1], "got int, needs Datasets")):
        with pytest.raises(xd.InputError, match=said):
            xd.plot(wrong)
    with pytest.raises(xd.InputError, match="the run has no plane to be seen in; name it"):
        xd.plot(xd.simulate(xd.Model.from_toml(MODELS / "pendulum.toml"), until="1 s"), only="plane")


@pytest.mark.dear
def test_bodies_keep_their_colours_beside_another_run() -> None:
    """Assert that of several bodies each has one colour in all runs, which differ by dashes and are all named."""
    model = xd.Model.from_toml(MODELS / "figure_eight.toml")
    runs = {name: xd.simulate(model, method=name, step="50 ms", until="1 s") for name in ("rk4", "velocity_verlet")}
    (axes,) = xd.plot(runs, only="plane").axes
    assert [text.get_text() for text in axes.get_legend().get_texts()] == [
        "body 0",
        "body 1",
        "body 2",
        "rk4",
        "velocity_verlet",
    ]
    lines = [line for line in axes.lines if np.size(line.get_xdata()) > 1]
    own, others = ([line.get_color() for line in lines if line.get_linestyle() == style] for style in ("-", "--"))
    assert len({*own}) == 3
    assert own == others


def test_a_size_that_is_too_small_is_refused(orbit: xr.Dataset) -> None:
    """Assert that panels which would lie on one another are refused with the remedy, and one alone fits."""
    with pytest.raises(
        xd.InputError, match="size 4x3 leaves 2 by 1.5 inches for each of 4 panels, needs 2.4 by 1.6; draw fewer"
    ):
        xd.plot(orbit, size=(4, 3))
    assert tuple(xd.plot(orbit, only="plane", size=(4, 3)).get_size_inches()) == (4.0, 3.0)


def driven(**more: Any) -> xd.Model:
    """A damped oscillator that settles into its drive, as an angle that goes round."""
    given: dict[str, Any] = {
        "name": "driven",
        "time": {"unit": "1"},
        "coordinates": {"theta": "degree"},
        "parameters": {"w": "2"},
        "mass": {"theta": "1"},
        "forces": {
            "spring": {"theta": "-4*(theta - 3*t)"},
            "damping": {"theta": "-2*(v_theta - 3)"},
            "drive": {"theta": "cos(w*t)"},
        },
        "initial": {"theta": "0 degree", "v_theta": "3"},
        "figure": {"section": "2*pi/w", "wrap": ["theta"]},
        "run": {"method": "dop853", "rtol": 1e-10, "until": "60"},
    }
    return xd.Model(**given | more)


@pytest.mark.dear
def test_a_section_has_a_dot_in_each_period() -> None:
    """Assert velocities of the section against the closed form, 3 + cos(w t)/2 once it has settled, and angles that are wrapped."""
    axes = next(
        axis
        for axis in xd.plot(xd.simulate(driven())).axes
        if axis.get_title(loc="left").startswith("Poincare section, 19 periods of 3.142")
    )
    position, speed = axes.lines[0].get_data()
    assert len(position) == 19
    assert np.abs(position).max() <= 180.0
    assert np.asarray(speed)[-3:] == pytest.approx(np.full(3, np.degrees(3.5)), rel=1e-6)


def test_wrapped_angles_are_torn_where_they_jump() -> None:
    """Assert that no line joins both sides of half a turn."""
    axes = xd.plot(xd.simulate(driven()), only="trajectory").axes[0]
    values = np.asarray(axes.lines[-1].get_ydata())
    assert np.nanmax(np.abs(values)) <= 180.0
    assert np.isnan(values).sum() > 20
    assert np.nanmax(np.abs(np.diff(values))) < 180.0


@pytest.mark.parametrize(
    ("figure", "said"),
    [
        ({"section": "w"}, None),
        ({"section": "2*second"}, "figure: section: has units 's', needs a period in '1'"),
        ({"section": "theta"}, "section: reads 'theta'; a period is of parameters"),
        ({"wrap": ["x"]}, "wrap has 'x', which is no angle"),
        ({"wrap": "theta"}, "wrap is 'theta', needs a list of angles"),
    ],
)
def test_sections_that_are_none(figure: dict[str, Any], said: str | None) -> None:
    """Assert that a period of another unit, or of what moves, and no angle, are refused."""
    if said is None:
        assert xd.Model.from_text(driven(figure=figure).to_toml()) == driven(figure=figure)
        return
    with pytest.raises(xd.ModelError, match=said):
        driven(figure=figure)


def fastened(**figure: Any) -> xd.Model:
    """A mass beside a wall, in the plane."""
    return xd.Model(
        name="fastened",
        coordinates={"x": "cm", "y": "cm"},
        parameters={"A": "1 cm"},
        mass={"x": "1*kilogram", "y": "1*kilogram"},
        forces={"weight": {"y": "-9.81*newton"}},
        initial={"x": "10 cm", "y": "20 cm", "v_x": "100 cm s-1"},
        contacts={
            "floor": {"gap": "y - A*sin(t/second)", "restitution": 0.5},
            "wall": {"gap": "0.3*metre - x", "restitution": 1.0},
        },
        figure={"plane": ["x", "y"], "bodies": ["ball"]} | figure,
        run={"method": "rk4", "step": "2 ms", "until": "0.4 s"},
    )


def test_films_have_rods_springs_walls_and_floors() -> None:
    """Assert a rod from the origin to the ball, a zigzag as long, a wall where its gap closes, a floor that moves."""
    run = xd.simulate(fastened(links=[["origin", "ball"]], springs=[["ball", "origin"]]))
    scene = scene_of(run, None)
    assert scene is not None
    axes = Figure(figsize=scene.size).subplots()
    scene.start(axes)
    wall = next(item for item in axes.collections if type(item).__name__ == "QuadContourSet" and item.filled is False)
    (line,) = (path.vertices for path in wall.get_paths() if len(path.vertices))
    assert line[:, 0] == pytest.approx(np.full(len(line), 0.3), abs=1e-12)
    for now in (0.1, 0.3):
        moved = scene.move_to(now)
        place = np.asarray(moved[-1].get_offsets())[0]
        (rod,), (spring,), (floor,) = (part.get_segments() for part in moved[1:4])
        assert rod == pytest.approx(np.array([[0.0, 0.0], place]))
        assert spring[[0, -1]] == pytest.approx(np.array([place, [0.0, 0.0]]))
        assert len(spring) > 10
        assert floor[:, 1] == pytest.approx(np.full(len(floor), 0.01 * np.sin(now)), abs=1e-9)


def test_a_ball_that_only_falls_is_filmed_upright() -> None:
    """Assert a film of one height, with the floor, and that an angle alone has none."""
    scene = scene_of(xd.simulate(xd.Model.from_toml(MODELS / "bouncing_ball.toml"), until="1 s"), None)
    assert scene is not None
    axes = Figure(figsize=scene.size).subplots()
    scene.start(axes)
    assert any(type(item).__name__ == "QuadContourSet" for item in axes.collections)
    scene.move_to(0.0)
    assert np.asarray(scene.move_to(0.0)[-1].get_offsets())[0] == pytest.approx([0.0, 1.0])


@pytest.mark.parametrize(
    ("figure", "said"),
    [
        (
            {"links": [["origin", "bob"]]},
            "figure: links has 'bob'; there are ball, origin, and others are named by bodies",
        ),
        ({"springs": ["origin", "ball"]}, "springs is .*, needs pairs of names, like"),
        ({"threads": "ball"}, "threads is 'ball', needs pairs of names"),
        ({"bodies": ["a", "b"]}, "figure: bodies names 2, plane has 1 pairs"),
    ],
)
def test_links_of_films_that_are_none(figure: dict[str, Any], said: str) -> None:
    """Assert that an unknown end, another shape and a wrong number of bodies are refused; and that links come back from TOML."""
    with pytest.raises(xd.ModelError, match=said):
        fastened(**figure)
    model = fastened(threads=[["origin", "ball"]])
    assert xd.Model.from_text(model.to_toml()) == model


def test_observables_are_drawn_where_nothing_moves() -> None:
    """Assert that a calibration, whose only state stands still, shows the number that it is about."""
    figure = xd.plot(xd.simulate(xd.Model.from_toml(MODELS / "mass_calibration.toml")))
    assert [axes.get_ylabel() for axes in figure.axes] == ["dm (10⁻⁶ kg)"]


def test_a_plane_of_states_that_the_model_names_is_drawn_once() -> None:
    """Assert the named plane and the two others, and a comparison whose title and cause have no unit of numbers."""
    spiral = xd.Model(
        name="Spiral",
        time={"unit": "1"},
        states={word: {"unit": "1", "rate": rate} for word, rate in (("x", "y"), ("y", "-x"), ("z", "-z"))},
        initial={"x": "1", "y": "0", "z": "1"},
        figure={"plane": ["x", "z"]},
    )
    asked = {"method": "rk4", "step": "0.1", "until": "2"}
    run, other = (xd.simulate(model, **asked) for model in (spiral, spiral.replace(initial={"x": "1.5"})))
    drawn = [(axes.get_xlabel(), axes.get_ylabel()) for axes in xd.plot(run, only=["plane", "phase"]).axes]
    assert sorted(drawn)[-3:] == [("x", "y"), ("x", "z"), ("y", "z")]
    apart = xd.compare(run, other)
    assert apart.attrs["title"] == "Spiral, by rk4, two runs"
    assert apart.attrs["cause"] == "initial: x: 1.0 | 1.5"
    assert apart.attrs["parted"] == "t = 0: x by 0.5, beyond an interpolation error of 0"


def test_many_variables_of_two_runs_are_named_once() -> None:
    """Assert that three variables keep their colours in both runs, and that the legend has each of the five names once."""
    decay = xd.Model(
        name="Decay",
        time={"unit": "1"},
        parameters={"k": "1"},
        states={word: {"unit": "1", "rate": f"-k*{word}"} for word in "abc"},
        initial={"a": "1", "b": "2", "c": "3"},
    )
    asked = {"method": "rk4", "step": "0.1", "until": "2"}
    slow, fast = (xd.simulate(model, **asked) for model in (decay, decay.replace(parameters={"k": "2"})))
    axes = xd.plot({"slow": slow, "fast": fast}, only=["state"]).axes[0]
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["a", "b", "c", "slow", "fast"]
    solid, dashed = (
        [line.get_color() for line in axes.lines if line.get_linestyle() == style] for style in ("-", "--")
    )
    assert solid[:3] == dashed[:3]
    assert len({*dashed[:3]}) == 3

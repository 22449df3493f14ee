"""What pictures of many bodies are framed on, how they name bodies, and how they write powers of ten."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from xdynamics.figures.framing import frame_of
from xdynamics.figures.marks import contrast_ratio, legible
from xdynamics.figures.scenes import scene_of
from xdynamics.record import unfold

FREE = """
name = "free bodies"
[dimensions]
body = {count}
axis = {axes}
[coordinates]
r = {{ unit = "m", dims = ["body", "axis"] }}
[mass]
r = "1*kilogram"
[forces.none]
r = "0*newton"
[initial]
r = {{ unit = "m", value = {places} }}
v_r = {{ unit = "m s-1", value = {speeds} }}
[run]
method = "velocity_verlet"
step = "0.1 s"
until = "10 s"
"""


def flight(
    count: int, dims: int = 2, fast: dict[int, float] | None = None, scale: float = 1.0, depth: float = 0.4
) -> Any:
    """A run of bodies on a circle that move by 1 m in 10 s, some of them faster."""
    angles = 2.0 * np.pi * np.arange(count) / count
    places = scale * np.stack([np.cos(angles), np.sin(angles), depth * np.sin(2.0 * angles)][:dims], axis=-1)
    speeds = 0.1 * places * np.array([(fast or {}).get(body, 1.0) for body in range(count)])[:, None]
    text = FREE.format(count=count, axes=[*"xyz"][:dims], places=places.tolist(), speeds=speeds.tolist())
    return xd.simulate(xd.Model.from_text(text))


def title_of(axes: Any) -> str:
    """The title in one line."""
    return " ".join(axes.get_title(loc="left").split())


def test_bodies_that_fly_off_do_not_shrink_the_others() -> None:
    """Assert a frame of those that stay, which one leaves when its own motion says so; its name stands in the frame."""
    (axes,) = xd.plot(flight(10, fast={0: 40.0}), only="plane").axes
    low, high = axes.get_xlim()
    assert -2.6 < low < -2.0 < 1.618 < high < 1.9
    when = (high - 1.0) / 4.0  # x = 1 + 4 t
    assert title_of(axes).endswith(f"; body 0 leaves the frame at t = {when:.3g} s")
    ends = {text.get_text(): text.xy for text in axes.texts}
    assert 1.0 < ends["0"][0] <= high
    (axes,) = xd.plot(flight(10), only="plane").axes
    assert "leave" not in title_of(axes)


@pytest.mark.parametrize(
    ("fast", "said"), [(2, "these leave the frame: body 0 at t ="), (4, "4 of 12 leave the frame, body")]
)
def test_several_bodies_that_fly_off_are_named(fast: int, said: str) -> None:
    """Assert each of a few with its time, of more the first and the last."""
    (axes,) = xd.plot(flight(12, fast={3 * body: 40.0 + body for body in range(fast)}), only="plane").axes
    assert said in title_of(axes).replace("these leave the frame: body 3", "these leave the frame: body 0")


def test_bodies_that_come_back_stay_in_the_frame() -> None:
    """Assert the whole for an orbit far out, for one that turns back, and where more than a third fly off."""
    times = np.linspace(0.0, 1.0, 101)
    still = [np.stack([k + 0.1 * times, 0.0 * times]) for k in range(5)]
    far = np.stack([60.0 * np.cos(times), 60.0 * np.sin(times)])
    back = np.stack([200.0 * times * (1.2 - times), times])
    gone = [np.stack([k + 100.0 * times, times]) for k in range(4)]
    for others in ([far], [back], gone):
        paths = [*still, *others]
        frame = frame_of(paths, [times] * len(paths))
        assert not frame.leaving
        assert frame.limits[0, 1] == max(path[0].max() for path in paths)
    assert frame_of([*still, gone[0]], [times] * 6).leaving[0][0] == 5


def test_space_and_films_are_framed_alike() -> None:
    """Assert in space a path that ends at the frame, and a film whose axes hold those that stay, with a word of who left."""
    run = flight(10, 3, fast={0: 40.0})
    (axes, _) = xd.plot(run, only="space").axes
    assert "body 0 leaves the frame at t = " in title_of(axes)
    first = np.array(axes.lines[0].get_data_3d())
    assert np.nanmax(first[0]) <= axes.get_xlim()[1] < 2.1
    assert np.isnan(first[:, -1]).all()
    scene = scene_of(unfold(run).copy(deep=False), None)
    assert scene is not None
    figure = xd.plot(run, only="plane")
    said = scene.start(figure.axes[0])
    assert "; body 0 leaves the frame at t = " in said
    assert figure.axes[0].get_xlim()[1] < 2.2


def test_a_flat_motion_in_space_has_room_for_its_ticks() -> None:
    """Assert that a side of a hundredth is stretched to a quarter, which its axis says, with three ticks at most."""
    run = flight(5, 3, depth=0.01)
    (axes,) = (each for each in xd.plot(run, only="space").axes if each.name == "3d")
    across, away, up = axes.get_box_aspect()
    assert up == pytest.approx(max(across, away) / 4.0, rel=1e-9)
    assert (axes.get_xlabel(), axes.get_zlabel()) == ("r[x]", "r[z], not to scale")
    low, high = axes.get_zlim()
    assert len([tick for tick in axes.get_zticks() if low <= tick <= high]) <= 3


def test_more_bodies_than_names_have_a_scale_of_colours() -> None:
    """Assert for 70 bodies a scale from the first to the last with the colours of their paths, in the plane and in space."""
    run = flight(70, 3)
    for kind in ("plane", "space"):
        figure = xd.plot(run, only=kind)
        axes = figure.axes[0]
        (bar,) = axes.child_axes or figure.axes[1:2]
        assert [text.get_text() for text in bar.get_yticklabels()] == ["0", "14", "28", "41", "55", "69"]
        assert bar.get_ylabel() == "body"
        shades = bar.collections[-1].get_cmap().colors
        assert shades == [line.get_color() for line in axes.lines if line.get_linestyle() == "-"]


def test_bodies_that_are_not_drawn_are_counted() -> None:
    """Assert the number of bodies left out in the titles of the plane and of space."""
    run = flight(203, 3)
    for kind in ("plane", "space"):
        axes = xd.plot(run, only=kind).axes[0]
        assert "the first 200 of 203 bodies" in title_of(axes)
        assert len([line for line in axes.lines if line.get_linestyle() == "-"]) == 200


@pytest.mark.parametrize("dark", [False, True])
def test_bodies_can_be_told_from_the_paper(dark: bool) -> None:
    """Assert a contrast of 3 of every path and of 4.5 of every name on a light and on a dark sheet."""
    figure = xd.plot(flight(24), only="plane", dark=dark)
    (axes,) = figure.axes
    paper = axes.get_facecolor()
    for line in axes.lines:
        assert contrast_ratio(line.get_color(), paper) >= 3.0
    assert len(axes.texts) == 24
    for text in axes.texts:
        assert contrast_ratio(text.get_color(), paper) >= 4.5


def test_a_colour_is_changed_as_far_as_needed() -> None:
    """Assert a colour kept where it is legible; else the least contrast asked for, to two of 255 steps of a shade."""
    assert legible("#1f5a96", 3.0, "white") == "#1f5a96"
    for paper in ("white", "black"):
        for colour in ("#f0f921", "#7a7a7a", "#20204a", "#e8e8e8"):
            found = contrast_ratio(legible(colour, 4.5, paper), paper)
            assert found >= 4.5
            assert found < 4.7 or legible(colour, 4.5, paper) == colour


@pytest.mark.parametrize(("scale", "power"), [(1e-12, "10⁻¹² "), (1e12, "10¹² "), (1.0, "")])
def test_powers_of_ten_stand_in_labels(scale: float, power: str) -> None:
    """Assert a power of ten before the unit, and none beside the ticks, for positions of 1e-12 m and of 1e12 m."""
    figure = xd.plot(flight(3, 3, scale=scale), panels="all")
    labels = {axes.get_xlabel() for axes in figure.axes} | {axes.get_ylabel() for axes in figure.axes}
    assert f"r[x] ({power}m)" in labels
    (space,) = (axes for axes in figure.axes if axes.name == "3d")
    assert f"in space, in {power}m" in title_of(space)
    for axes in figure.axes:
        if axes.name != "3d":
            for axis in (axes.xaxis, axes.yaxis):
                axis.get_major_formatter().format_ticks(axis.get_majorticklocs())
                assert not (axis.offsetText.get_visible() and axis.get_major_formatter().get_offset())


@pytest.mark.parametrize("discs", [False, True])
def test_names_go_along_in_a_film(discs: bool) -> None:
    """Assert that each of twelve bodies has its number at its dot or amid its disc, at every time."""
    run = unfold(flight(12)).copy(deep=False)
    scene: Any = scene_of(run, None)
    scene.radii = np.full(12, 0.1) if discs else scene.radii
    axes = xd.plot(run, only="plane").axes[0]
    for text in [*axes.texts]:
        text.remove()
    scene.start(axes)
    for now in (0.0, 5.0):
        scene.move_to(now)
        angles = 2.0 * np.pi * np.arange(12) / 12
        places = (1.0 + 0.1 * now) * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        assert [text.get_text() for text in axes.texts] == [*map(str, range(12))]
        for text, place in zip(axes.texts, places, strict=True):
            box = text.get_window_extent()
            away = np.array([(box.x0 + box.x1) / 2.0, (box.y0 + box.y1) / 2.0]) - axes.transData.transform(place)
            assert np.hypot(*away) < (2.0 if discs else 20.0)


def test_colours_of_many_bodies_are_said_in_a_film() -> None:
    """Assert from which to which body colours go, of those that are drawn."""
    scene = scene_of(unfold(flight(203)).copy(deep=False), None)
    assert scene is not None
    said = scene.start(xd.plot(flight(3), only="plane").axes[0])
    assert ", the first 200 of 203 bodies" in said
    assert "colours from body 0 to 199" in said

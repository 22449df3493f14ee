"""Films of bodies that turn: where their lines are, what stands for their inertia, when the picture goes along."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

import xdynamics as xd
from xdynamics.figures.bodies_scene import Mechanism, ellipses, projected
from xdynamics.figures.scenes import scene_of
from xdynamics.record import unfold

HINGED = """
name = "hinged rod"
[bodies.rod]
mass = "2 kg"
inertia = ["0.2 kg m2", "0.2 kg m2", "0.002 kg m2"]
points = { tip = ["0 m", "0 m", "-0.5 m"] }
initial = { position = ["0 m", "0 m", "-0.5 m"], angular_velocity = ["1 rad s-1", "0 rad s-1", "0 rad s-1"], velocity = ["0 m s-1", "0.5 m s-1", "0 m s-1"] }
[joints.pin]
hinge = ["rod", "space"]
at = [["0 m", "0 m", "0.5 m"], ["0 m", "0 m", "0 m"]]
axis = [1, 0, 0]
[forces.weight]
potential = "19.62*newton*rod_r[z]"
"""
THROWN = """
name = "thrown"
[bodies.box]
mass = "1 kg"
inertia = ["1 g m2", "2 g m2", "2 g m2"]
points = { corner = ["0.1 m", "0 m", "0 m"] }
initial = { velocity = ["9 m s-1", "0 m s-1", "0 m s-1"] }
"""


def filmed(text: str) -> Mechanism:
    """The scene of a run of a second."""
    scene = scene_of(unfold(xd.simulate(xd.Model.from_text(text), method="rk4", step="10 ms", until="1 s")), None)
    assert isinstance(scene, Mechanism)
    return scene


@pytest.mark.parametrize("turned", [Rotation.identity(), Rotation.from_euler("xyz", [0.3, 0.7, 1.1])])
def test_the_ellipsoid_has_the_inertia(turned: Rotation) -> None:
    """Assert that ellipses are on that whose mass of even density has the moments: m (b**2 + c**2)/5, and so on."""
    halves, mass = np.array([0.3, 0.2, 0.1]), 2.0
    principal = np.diag(mass / 5.0 * (np.sum(halves**2) - halves**2))
    axes = turned.as_matrix()
    own = ellipses(axes @ principal @ axes.T, mass) @ axes
    assert np.sum((own / halves) ** 2, axis=-1) == pytest.approx(np.ones(own.shape[:2]), rel=1e-12)
    assert np.abs(own).reshape(-1, 3).max(axis=0) == pytest.approx(halves, rel=1e-12)


def test_lines_go_from_the_centre_to_points_and_joints() -> None:
    """Assert that a hinged rod is drawn from its centre to its tip and to the hinge, which rests."""
    scene = filmed(HINGED)
    axes = Figure().subplots()
    assert scene.start(axes) == ""
    for now in (0.0, 0.31, 1.0):
        _, lines, dots = scene.move_to(now)
        tip, hinge, *rest = lines.get_segments()
        assert len(rest) == 3
        assert hinge[0] == pytest.approx(dots.get_offsets()[0])
        assert np.abs(hinge[1]).max() < 1e-4  # straight between points of curves
        assert tip[1] == pytest.approx(2.0 * tip[0], abs=1e-4)
        low, high = np.array([axes.get_xlim(), axes.get_ylim()]).T
        assert ((np.concatenate(lines.get_segments()) > low) & (np.concatenate(lines.get_segments()) < high)).all()


def test_whoever_goes_far_is_followed() -> None:
    """Assert that a thrown box stays in the middle of the picture, with a trail behind it."""
    scene = filmed(THROWN)
    assert scene.follows_bodies
    assert scene.start(Figure().subplots()) == ", going along"
    trails, _, dots = scene.move_to(0.5)
    assert dots.get_offsets()[0] == pytest.approx([0.0, 0.0], abs=1e-12)
    (trail,) = trails.get_segments()
    assert trail[0] == pytest.approx(projected(np.array([-0.81, 0.0, 0.0])), abs=0.1)
    assert not filmed(HINGED).follows_bodies


def test_joints_have_panels_in_the_place_of_their_multipliers() -> None:
    """Assert that reactions of joints are drawn, bent between rows, and multipliers of them only by name."""
    run = xd.simulate(xd.Model.from_text(HINGED), method="rk4", step="50 ms", until="1 s")
    panels = [axes for axes in xd.plot(run, only=["constraint"]).axes if axes.get_visible()]
    assert [axes.get_title(loc="left") for axes in panels] == ["forces and torques in joints"]
    assert max(len(line.get_xdata()) for line in panels[0].lines) > 2 * run.sizes["step"]
    named = xd.plot(run, only=["constraint_force_pin_point"]).axes
    assert named[0].get_title(loc="left").startswith("multiplier")

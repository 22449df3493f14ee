"""Constraints: motions on them against closed forms, published digits and discrete laws; what cannot be kept is refused."""

from __future__ import annotations

import math
import warnings
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.special import ellipj, ellipk

import xdynamics as xd
from xdynamics.documenting.plain_text import equation_lines
from xdynamics.march.configuration import settings_for
from xdynamics.march.outcome_text import ending
from xdynamics.march.runner import March
from xdynamics.methods import METHODS, ConstraintImpulse
from xdynamics.methods.lines import read_lines
from xdynamics.model.linearisation import linearise
from xdynamics.model.motion import constants, evaluate_motion

LENGTH, GRAVITY, MASS = 1.5, 9.81, 2.0
ROD = """
name = "rod"
[coordinates]
x = "m"
y = "m"
[parameters]
m = "2 kg"
L = "1.5 m"
g = "9.81 m s-2"
[mass]
x = "m"
y = "m"
[forces.weight]
potential = "m*g*y"
[constraints.rod]
holds = "sqrt(x**2 + y**2) - L"
[initial]
x = "1.5 m"
y = "0 m"
"""
HINGED = """
name = "hinged rod"
[bodies.rod]
mass = "2 kg"
inertia = ["0.2 kg m2", "0.2 kg m2", "0.002 kg m2"]
points = { top = ["0 m", "0 m", "0.5 m"] }
[bodies.rod.initial]
position = ["0 m", "0.5 m", "0 m"]
attitude = { axis = [1, 0, 0], angle = "90 degree" }
[parameters]
g = "9.81 m s-2"
[forces.weight]
potential = "rod_mass*g*rod_r[z]"
[constraints.pin]
holds = "point(rod, top)"
[constraints.across]
holds = "dot(direction(rod, [1, 0, 0]), where(index(axis) > 0, where(index(axis) > 1, 0, 1), 0), axis)"
[constraints.along]
holds = "dot(direction(rod, [1, 0, 0]), where(index(axis) > 1, 1, 0), axis)"
"""


def rod(old: str = "", new: str = "") -> xd.Model:
    """A mass on a rod, let go from the horizontal; perhaps with another line."""
    assert old in ROD
    return xd.Model.from_text(ROD.replace(old, new) if old else ROD)


def swing(t: Any) -> tuple[Any, Any]:
    """Angle from the vertical and its rate of a pendulum let go at 90 degrees (Landau, Lifshitz, Mechanics, section 11)."""
    omega, m = math.sqrt(GRAVITY / LENGTH), 0.5
    sn, cn, _, _ = ellipj(ellipk(m) - omega * np.asarray(t), m)
    return 2 * np.arcsin(math.sqrt(m) * sn), -2 * math.sqrt(m) * omega * cn


def off(run: xr.Dataset) -> float:
    """How far the end of a run of the rod is from the closed form."""
    angle, _ = swing(run.time.values[-1])
    return float(np.hypot(run.x[-1] - LENGTH * np.sin(angle), run.y[-1] + LENGTH * np.cos(angle)))


@pytest.mark.parametrize(("method", "rtol"), [("dop853", 1e-11), ("dormand_prince", 1e-11), ("taylor", 1e-11)])
def test_a_rod_is_a_pendulum(method: str, rtol: float) -> None:
    """Assert that motion, force and residuals are those of the pendulum."""
    run = xd.simulate(rod(), method=method, rtol=rtol, until="5 s")
    angle, rate = swing(run.time)
    assert abs(run.x - LENGTH * np.sin(angle)).max() < 2e-9
    tension = MASS * (GRAVITY * np.cos(angle) + LENGTH * rate**2)
    assert abs(run.constraint_force_rod + tension).max() < 1e-7  # along the gradient, which points outwards
    assert abs(run.constraint_residual_rod).max() < 1e-11
    assert abs(run.constraint_rate_rod).max() < 1e-11
    assert (run.constraint_rank == 1).all()
    assert 0.0 < run.constraint_projection.max() < 1e-6


@pytest.mark.parametrize(
    ("method", "order"),
    [
        ("rk4", 4),
        ("midpoint", 2),
        ("euler_cromer", 1),
        ("velocity_verlet", 2),
        ("position_verlet", 2),
        ("forest_ruth", 4),
    ],
)
def test_orders_survive_constraints(method: str, order: int) -> None:
    """Assert that the error at the end falls as the method's order says."""
    errors = [off(xd.simulate(rod(), method=method, step=2.0 / n, until="2 s")) for n in (128, 256)]
    assert math.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.35)


def test_position_verlet_is_rattle() -> None:
    """Assert that half drifts with impulses along the gradient before them are what a few lines of NumPy give."""

    def drift(q: Any, v: Any, h: float) -> tuple[Any, Any]:
        """Move to where the rod is as long as it is, by an impulse along it."""
        along, u = q / np.linalg.norm(q), 0.0
        for _ in range(30):
            moved = q + h * (v + u * along)
            u -= (np.linalg.norm(moved) - LENGTH) / h / (moved @ along / LENGTH)
        return q + h * (v + u * along), v + u * along

    q, v, h = np.array([LENGTH, 0.0]), np.zeros(2), 0.01
    for _ in range(100):
        q, v = drift(q, v, h / 2)
        q, v = drift(q, v + h * np.array([0.0, -GRAVITY]), h / 2)
        v = v - q * (q @ v) / LENGTH**2
    run = xd.simulate(rod(), method="position_verlet", step=h, until="1 s")
    assert [*run.x.values[-1:], *run.y.values[-1:]] == pytest.approx(q, rel=0, abs=1e-13)
    assert [*run.v_x.values[-1:], *run.v_y.values[-1:]] == pytest.approx(v, rel=0, abs=1e-12)


@pytest.mark.dear
def test_rattle_keeps_energy() -> None:
    """Assert that energy neither grows nor falls over a million steps: no trend beyond what it goes to and fro."""
    run = xd.simulate(rod(), method="velocity_verlet", step="2 ms", until="2000 s", keep_every=10)
    energy = (
        run.total_energy.values.reshape(100, -1)[:, :-1]
        if run.sizes["step"] % 100 == 0
        else run.total_energy.values[:-1].reshape(100, -1)
    )
    means = energy.mean(axis=1)
    slope = np.polyfit(np.arange(100), means, 1)[0] * 100
    assert abs(slope) < 1e-3 * np.ptp(energy)


def test_a_start_is_consistent_or_moved() -> None:
    """Assert that a start off the rod is refused with the nearest one on it, and moved there on request."""
    with pytest.raises(
        xd.ModelError, match=r"'rod' is 0\.1 m at the start.*x = 1\.5 m; write it, or \[initial\] consistent"
    ):
        rod('x = "1.5 m"', 'x = "1.6 m"')
    moved = rod('x = "1.5 m"', 'consistent = true\nx = "1.6 m"\nv_x = "1 m s-1"')
    run = xd.simulate(moved, method="dop853", rtol=1e-11, until="1 s")
    assert run.x.values[0] == pytest.approx(1.5, rel=1e-14)
    assert run.v_x.values[0] == pytest.approx(0.0, abs=1e-14)
    assert off(run) < 1e-9
    assert xd.Model.from_text(moved.to_toml()) == moved


@pytest.mark.parametrize("method", ["rk4", "velocity_verlet", "radau_iia"])
@pytest.mark.parametrize(("mass", "what"), [("0*m", "'y' has no mass"), ("x", "its mass matrix is singular")])
def test_a_mass_that_does_not_resist_is_told(method: str, mass: str, what: str) -> None:
    """Assert one line where constraints act on what has no mass, or on masses of which only a sum counts."""
    together = {"y": "0*m"} if mass == "0*m" else {}
    model = xd.Model(
        name="massless end",
        coordinates={"x": "m", "y": "m"},
        parameters={"m": "1 kg"},
        mass={"x": "m", **together} if together else {"matrix": [["m", "m"], ["m", "m"]]},
        constraints={"joined": {"holds": "x - y"}},
        forces={"spring": {"x": "-4*newton/metre*x"}},
        initial={"x": "1 m", "y": "1 m"},
    )
    with pytest.raises(xd.InputError, match=f"{what} at the start, and constraints act by what masses resist them"):
        xd.simulate(model, method=method, step="10 ms", until="1 s")


WRONG = {
    ('holds = "sqrt(x**2 + y**2) - L"', 'holds = "x > 0*metre"'): "compares.*contacts",
    ('holds = "sqrt(x**2 + y**2) - L"', 'holds = "v_x"'): "reads the velocity 'v_x'.*rolls",
    ('holds = "sqrt(x**2 + y**2) - L"', 'holds = "x*L + y"'): "joins",
    ('holds = "sqrt(x**2 + y**2) - L"', 'holds = "abs(x) - L"'): "kink",
    ('holds = "sqrt(x**2 + y**2) - L"', 'holds = "L - 1.5*metre"'): "zero gradient",
    ('holds = "sqrt(x**2 + y**2) - L"', 'rolls = "v_x**2/L"'): "not linear in v_x",
    ('holds = "sqrt(x**2 + y**2) - L"', 'rolls = "x"'): "depends on no velocity",
    ('holds = "sqrt(x**2 + y**2) - L"', ""): "neither is given",
    (
        '[initial]\nx = "1.5 m"\ny = "0 m"',
        '[constraints.line]\nholds = "y"\n[initial]\nx = "1.5 m"\ny = "0 m"',
    ): "no freedom to move",
    (
        '[initial]\nx = "1.5 m"',
        '[constraints.far]\nholds = "sqrt(x**2 + y**2) - 2*L"\n[initial]\nx = "1.5 m"',
    ): "contradict",
    ('[initial]\nx = "1.5 m"', '[initial]\nconsistent = 1\nx = "1.5 m"'): "true or false",
    ('x = "1.5 m"\ny', 'x = "0 m"\ny'): "no gradient at the start",
}


@pytest.mark.parametrize(("old", "new", "said"), [(*pair, said) for pair, said in WRONG.items()])
def test_what_cannot_be_kept_is_refused(old: str, new: str, said: str) -> None:
    """Assert that each is refused in words when the model is read."""
    with pytest.raises(xd.ModelError, match=said):
        rod(old, new)


@pytest.mark.parametrize("method", ["ruth3", "pefrl", "dprkn6"])
def test_methods_without_impulses_refuse(method: str) -> None:
    """Assert that methods whose order constraints would take refuse them."""
    with pytest.raises(xd.InputError, match="constraints, which its order does not survive"):
        xd.simulate(rod(), method=method, step="10 ms", until="1 s")


def test_a_condition_that_another_implies_changes_nothing() -> None:
    """Assert that rank tells of it, and that the motion is the same."""
    twice = rod("[initial]", '[constraints.again]\nholds = "(x**2 + y**2 - L**2)/(2*L)"\n[initial]')
    run, alone = (xd.simulate(model, method="dop853", rtol=1e-10, until="2 s") for model in (twice, rod()))
    assert (run.constraint_rank == 1).all()
    assert off(run) < 1e-8
    both = run.constraint_force_rod + run.constraint_force_again
    assert both.values[-1] == pytest.approx(alone.constraint_force_rod.values[-1], rel=1e-7)


@pytest.mark.parametrize("share", ["1e-4", "0"])
def test_what_is_all_but_implied_is_said(share: str) -> None:
    """Assert that a condition with too small a share of its own to be kept is named, and one with none is not."""
    model = xd.Model(
        name="all but implied",
        coordinates=dict.fromkeys("xyz", "m"),
        mass=dict.fromkeys("xyz", "1*kilogram"),
        forces={"push": {"z": "1*newton"}},
        constraints={"first": {"holds": "x"}, "again": {"holds": f"2*x + {share}*z"}},
        initial=dict.fromkeys("xyz", "0 m"),
    )
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        xd.simulate(model, method="rk4", step="0.1 s", until="1 s")
    said = [str(warning.message) for warning in caught]
    assert [("again" in text, "all but implied" in text) for text in said] == ([(True, True)] if share != "0" else [])


def test_a_skate_runs_in_a_circle() -> None:
    """Assert that a blade below the centre of mass, which slips along itself alone, turns on a circle at a steady speed.

    Neimark and Fufaev, Dynamics of Nonholonomic Systems, 1972, chapter III: v and the rate of turn are constant.
    """
    model = xd.Model.from_text("""
        name = "skate"
        coordinates = { x = "m", y = "m", phi = "rad" }
        [parameters]
        m = "2 kg"
        J = "3 kg m2"
        [mass]
        x = "m"
        y = "m"
        phi = "J/radian**2"
        [constraints.blade]
        rolls = "v_y*cos(phi) - v_x*sin(phi)"
        [initial]
        x = "0 m"
        y = "0 m"
        phi = "0 rad"
        v_x = "1.5 m s-1"
        v_y = "0 m s-1"
        v_phi = "0.5 rad s-1"
    """)
    run = xd.simulate(model, method="dop853", rtol=1e-11, until="10 s")
    angle, radius = 0.5 * run.time, 3.0
    assert abs(run.x - radius * np.sin(angle)).max() < 1e-9
    assert abs(run.y - radius * (1 - np.cos(angle))).max() < 1e-9
    assert abs(run.constraint_force_blade - 2.0 * 1.5 * 0.5).max() < 1e-9
    assert "constraint_residual_blade" not in run


def test_impacts_respect_constraints() -> None:
    """Assert that a mass on a rod leaves a wall at the speed that it came with, along the rod's circle."""
    model = rod("[initial]", '[contacts.wall]\ngap = "x + 0.5*metre"\nrestitution = 1.0\n[initial]')
    run = xd.simulate(model, method="dop853", rtol=1e-11, until="2 s")
    assert run.sizes["event"] >= 1
    before, after = int(run.event_row_before[0]), int(run.event_row_after[0])
    assert run.v_x.values[after] == pytest.approx(-run.v_x.values[before], rel=1e-12)
    assert run.v_y.values[after] == pytest.approx(-run.v_y.values[before], rel=1e-12)
    assert abs(run.constraint_rate_rod).max() < 1e-11
    assert float(np.ptp(run.total_energy.values)) < 1e-8


def test_lanes_have_the_bits_of_single_runs() -> None:
    """Assert that members marched side by side end as single runs do."""
    masses = [1.0, 2.0, 3.0, 4.0, 5.0]
    grid = xd.sweep(
        rod(), {"g": masses}, method="dop853", rtol=1e-9, until="3 s", keep=["end_x", "maximum_constraint_force_rod"]
    )
    for mass, end in zip(masses, grid.end_x.values, strict=True):
        single = xd.simulate(rod('g = "9.81', f'g = "{mass}'), method="dop853", rtol=1e-9, until="3 s")
        assert single.x.values[-1] == end


def test_a_hinge_of_a_body_makes_a_physical_pendulum() -> None:
    """Assert that a rod pinned at its end, and kept across one axis, swings as its moment about the pivot says."""
    run = xd.simulate(xd.Model.from_text(HINGED), method="rk4", step="4 ms", until="1 s")
    omega, m = math.sqrt(2 * 9.81 * 0.5 / 0.7), 0.5
    sn = ellipj(ellipk(m) - omega * run.time.values, m)[0]
    angle = 2 * np.arcsin(math.sqrt(m) * sn)
    assert abs(run.rod_r.sel(axis="y") - 0.5 * np.sin(angle)).max() < 1e-8
    assert abs(run.rod_r.sel(axis="z") + 0.5 * np.cos(angle)).max() < 1e-8
    assert (run.constraint_rank == 5).all()
    assert run.constraint_force_pin.dims == ("step", "axis")
    assert abs(run.constraint_residual_pin).max() < 1e-11


def test_conditions_that_imply_each_other_share_their_force() -> None:
    """Assert that multipliers are those of least norm, in units of what each moves alone, whatever their scale."""
    holds = ["x - y", "y - z", "2*(x - z)", "5*(x + y - 2*z)/(3*metre)", "w - x*metre/(1*metre)"]
    mass = {"x": 1.0, "y": 2.0, "z": 4.0, "w": 3.0}
    forces = {"x": 3.0, "y": -1.0, "z": 0.5, "w": 2.0}
    model = xd.Model(
        name="welded",
        coordinates=dict.fromkeys(mass, "m"),
        parameters={f"m_{name}": f"{value} kg" for name, value in mass.items()},
        mass={name: f"m_{name}" for name in mass},
        forces={"pull": {name: f"{value}*newton" for name, value in forces.items()}},
        constraints={f"weld{k}": {"holds": text} for k, text in enumerate(holds)},
        initial=dict.fromkeys(mass, "0 m"),
    )
    run = xd.simulate(model, method="rk4", step="0.1 s", until="1 s")
    rows = np.array([[1, -1, 0, 0], [0, 1, -1, 0], [2, 0, -2, 0], [5 / 3, 5 / 3, -10 / 3, 0], [-1, 0, 0, 1]])
    free = np.array(list(forces.values())) / np.array(list(mass.values()))
    matrix = rows / np.array(list(mass.values())) @ rows.T
    alone = np.sqrt(matrix.diagonal())
    least = np.linalg.pinv(matrix / np.outer(alone, alone), rcond=1e-10) @ (-rows @ free / alone) / alone
    for k, force in enumerate(least):
        np.testing.assert_allclose(run[f"constraint_force_weld{k}"], force, rtol=1e-12)
    assert (run.constraint_rank == 3).all()
    np.testing.assert_allclose(run.a_x, sum(forces.values()) / 10.0, rtol=1e-13)
    lines = list(equation_lines(model))
    assert sum("implied at the start by those before it" in line for line in lines) == 2


def test_a_violated_start_of_a_member_is_an_outcome() -> None:
    """Assert that a start that constraints do not hold at ends a run in words, whoever made it so."""
    march = March(rod(), settings_for(rod(), method="rk4", step=0.01, until=1.0))
    march.run.y[0] = 1.6
    list(march.blocks())
    assert "do not hold at the start" in ending(march).text


def test_multipliers_have_a_panel() -> None:
    """Assert that a picture of a run has the multipliers, alone where they are asked for."""
    run = xd.simulate(rod(), method="rk4", step="10 ms", until="1 s")
    panels = xd.plot(run, only="constraint").axes
    assert next(axes.get_title(loc="left") for axes in panels).startswith("multipliers of constraints")


def test_derivatives_of_constrained_accelerations() -> None:
    """Assert that the Jacobian, in which rows turn with the state, is that of differences."""
    model = rod("[initial]", '[initial]\nv_y = "2 m s-1"\nv_x = "0 m s-1"')
    state = {name: model.initial[name].si for name in ("t", "x", "y", "v_x", "v_y")}
    found = linearise(model, state).jacobian
    names = ("x", "y", "v_x", "v_y")

    def slopes(moved: dict[str, float]) -> np.ndarray:
        """Rates of the state, by the assignments of the motion."""
        values = evaluate_motion(model, moved, constants(model), [])
        return np.array([moved["v_x"], moved["v_y"], values["a_x"], values["a_y"]])

    for i, name in enumerate(names):
        near, far = ({**state, name: state[name] + sign * 1e-6} for sign in (-1, 1))
        assert found[:, i] == pytest.approx((slopes(far) - slopes(near)) / 2e-6, rel=1e-6, abs=1e-7)


def test_resets_are_put_back() -> None:
    """Assert that velocities set at an event obey the rod in the row behind it."""
    model = rod(
        "[initial]", '[events.kick]\nfunction = "x"\naction = "reset"\nset = { v_y = "1*metre/second" }\n[initial]'
    )
    run = xd.simulate(model, method="dop853", rtol=1e-10, until="1.5 s")
    assert run.sizes["event"] == 1
    behind = int(run.event_row_after[0])
    assert abs(float(run.constraint_rate_rod[behind])) < 1e-11
    assert run.constraint_projection[behind] > 1e-3


def test_radau_stays_on_constraints() -> None:
    """Assert that an implicit method whose steps the engine makes is projected, too."""
    run = xd.simulate(rod(), method="radau_iia", rtol=1e-7, until="1 s")
    assert abs(run.constraint_residual_rod).max() < 1e-11
    assert abs(run.constraint_rate_rod).max() < 1e-11
    assert off(run) < 1e-5


def test_a_hinge_is_found_from_a_start_that_is_off() -> None:
    """Assert that attitudes are moved to where a hinge holds, in the message and by the march."""
    text = HINGED.replace("axis = [1, 0, 0], angle", "axis = [1, 0.01, 0.02], angle")
    with pytest.raises(xd.ModelError, match="the nearest state where it holds is"):
        xd.Model.from_text(text)
    run = xd.simulate(
        xd.Model.from_text(text + "[initial]\nconsistent = true\n"), method="rk4", step="5 ms", until="0.05 s"
    )
    for name in ("pin", "across", "along"):
        assert abs(run[f"constraint_residual_{name}"]).max() < 1e-11


def test_a_floor_takes_the_load_of_a_rod() -> None:
    """Assert that the multiplier is that beside the force of a contact that rests: here none is left."""
    resting = rod(
        '[initial]\nx = "1.5 m"\ny = "0 m"',
        '[contacts.floor]\ngap = "y + 0.9*metre"\nrestitution = 0.0\n[initial]\nx = "1.2 m"\ny = "-0.9 m"',
    )
    run = xd.simulate(resting, method="rk4", step="10 ms", until="0.1 s")
    assert abs(run.contact_force_floor - MASS * GRAVITY).max() < 1e-10
    assert abs(run.constraint_force_rod).max() < 1e-10


def test_a_trial_leaves_its_start_as_it_was() -> None:
    """Assert that two half steps begin where the whole one did: impulses change copies of velocities."""
    run = xd.simulate(rod(), method="position_verlet", estimator="step_doubling", rtol=1e-5, until="1 s")
    assert run.sizes["trial"] >= 0
    assert off(run) < 1e-3
    assert float(run.error_norm.max()) <= 1.0


def test_impulses_change_no_vector_of_the_start() -> None:
    """Assert that lines with impulses move copies: the start of a step serves other trials, too."""
    lines = [line for method in METHODS.values() for line in read_lines(method.constrained_update)]
    moved = {name for line in lines if isinstance(line, ConstraintImpulse) for name in (line.position, line.velocity)}
    assert moved
    assert not moved & {"q", "v"}


@pytest.mark.parametrize("key", ["friction", "load", "static"])
def test_rolling_with_a_limit_is_dry_friction(key: str) -> None:
    """Assert that a force of friction beside `rolls` is refused with what to write in its place."""
    rolling = f'rolls = "v_x - L*v_y/metre"\n{key} = "0.3"'
    with pytest.raises(xd.ModelError, match=rf"{key} is no key.*\[frictions\], with slip = 'v_x - L\*v_y/metre'"):
        rod('holds = "sqrt(x**2 + y**2) - L"', rolling)


def test_events_are_located_on_interpolants_of_constrained_steps() -> None:
    """Assert when a pendulum hangs down, by a method whose interpolant needs the end of the step, where the rod holds."""
    low = rod("[initial]", '[events.low]\nfunction = "x"\nroot_state = "interpolant"\n[initial]')
    run = xd.simulate(low, method="dop853", rtol=1e-10, until="3 s")
    quarter = float(ellipk(0.5)) / math.sqrt(GRAVITY / LENGTH)
    assert run.event_time.values == pytest.approx([quarter, 3 * quarter], rel=1e-9)

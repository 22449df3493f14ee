"""Linearisation, modes and time scales, against differences and closed forms.

Modes of motions that are kept by constraints, against those of the same motions in free coordinates.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner

import xdynamics as xd
from cases.problems import MODELS, oscillator, particle
from cases.stages import assert_same_bits
from cases.verdicts import verified
from xdynamics.cli import main
from xdynamics.documenting.summary import summary
from xdynamics.evidence.modes import modes
from xdynamics.expressions.evaluation import evaluate
from xdynamics.model.linearisation import force_totals, initial_state, linearise
from xdynamics.model.motion import variables

GRAVITY = 9.8  # of the pendulum of 1 m, m s-2
# states off the beaten track: everything moves, drives have slopes
STATES = {
    "double_pendulum": {"v_th1": 1.3, "v_th2": -2.1},
    "rocket_c6": {"t": 0.7, "y": 40.0, "v_y": 60.0, "fuel": 0.006},
    "cart_spring": {"x": 0.043, "v_x": 0.4},
    "kepler": {"x": 0.3, "y": -0.7, "v_x": 1.1, "v_y": 0.2},
}


def loaded(name: str) -> xd.Model:
    """A model of data/models."""
    return xd.Model.from_toml(MODELS / f"{name}.toml")


def slope(model: xd.Model, state: dict[str, float]) -> np.ndarray:
    """d/dt (q, v, x) by the compiled march: what it records of a state that a run starts from."""
    given = {name: f"{value!r} {unit}" for name, value, unit in si(model, state)}
    run = xd.simulate(model.replace(initial=given), method="forward_euler", step=1e-9, until=state["t"] + 1e-9)
    n = list(model.elements.statement.coordinates)
    names = (
        [f"v_{one}" for one in n]
        + [f"a_{one}" for one in n]
        + [f"rate_{one}" for one in model.elements.statement.states]
    )
    return np.array([to_si(run, name) for name in names])


def si(model: xd.Model, state: dict[str, float]) -> list[tuple[str, float, str]]:
    """A state with its SI units."""
    units = {name: str(model.elements.dimensions[name]).split(" (")[0] for name in state}
    return [(name, value, units[name]) for name, value in state.items()]


def to_si(run: xr.Dataset, name: str) -> float:
    """The first recorded number of a variable; fuel is in g."""
    return float(run[name][0]) * (1e-3 if run[name].attrs["units"].startswith("g") else 1.0)


@pytest.mark.parametrize("name", STATES)
def test_the_jacobian_is_the_slope_of_the_compiled_forces(name: str) -> None:
    """Assert every entry against central differences of what a march evaluates."""
    model = loaded(name)
    state = initial_state(model) | STATES[name]
    found, names = linearise(model, state).jacobian, variables(model)
    for j, by in enumerate(names):
        h = 1e-5 * max(abs(state[by]), 0.01)
        ahead, behind = (slope(model, state | {by: state[by] + sign * h}) for sign in (1, -1))
        differences = (ahead - behind) / (2 * h)
        assert found[:, j] == pytest.approx(differences, rel=2e-5, abs=1e-6 * np.abs(found).max()), by


def test_stiffness_rebuilds_the_jacobian() -> None:
    """Assert that M^-1 K stands in the rows of the accelerations, mass variation included."""
    model = loaded("double_pendulum")
    found = linearise(model, initial_state(model) | STATES["double_pendulum"])
    assert np.linalg.solve(found.mass, -found.stiffness) == pytest.approx(found.jacobian[2:, :2], rel=1e-12)


def test_a_state_that_lacks_a_number_is_refused() -> None:
    """Assert that what is missing is named."""
    with pytest.raises(
        xd.InputError, match="'Kepler ellipse of eccentricity 0.6' has no y, v_y; give SI numbers for t"
    ):
        linearise(loaded("kepler"), {"t": 0.0, "x": 1.0, "v_x": 0.0})


def test_force_totals_are_sums_over_the_terms() -> None:
    """Assert that the whole force of a coordinate is what its terms add up to."""
    model = loaded("coupled_masses")
    values = initial_state(model) | {"k": 4.0, "kc": 2.5}
    assert [evaluate(total, values) for total in force_totals(model).values()] == [-6.5, 2.5]


def test_coupled_masses_have_their_closed_form() -> None:
    """Assert sqrt(k/m) = 2 and sqrt((k + 2 kc)/m) = 3 s-1, in phase and opposed."""
    found = modes(loaded("coupled_masses"))
    assert found.frequency.values == pytest.approx([2.0, 3.0], rel=1e-14)
    assert found.period.values == pytest.approx([math.pi, 2 * math.pi / 3], rel=1e-14)
    assert found.shape_x1.values / found.shape_x2.values == pytest.approx([1.0, -1.0], rel=1e-13)
    assert np.abs([found.shape_x1, found.shape_x2]).max(axis=0) == pytest.approx([1.0, 1.0], abs=0)
    assert found.eigenvalue_imag.values == pytest.approx([-2.0, 2.0, -3.0, 3.0], rel=1e-14)
    assert float(found.fastest_time_scale) == pytest.approx(1 / 3)


def test_the_double_pendulum_at_rest_has_its_closed_form() -> None:
    """Assert w**2 of small swings: the roots of det(K - w**2 M) = 0, by the quadratic formula."""
    found = modes(loaded("double_pendulum"), at={"th1": "0 rad", "th2": "0 degree"})
    m1, m2, l1, l2, g = 1.0, 0.8, 1.0, 0.7, 9.80665
    a, b, c = m1 * l1 * l2, -(m1 + m2) * g * (l1 + l2), (m1 + m2) * g * g
    squares = [(-b + sign * math.sqrt(b * b - 4 * a * c)) / (2 * a) for sign in (-1, 1)]
    assert found.frequency.values == pytest.approx(np.sqrt(squares), rel=1e-12)
    assert found.shape_th1.attrs["units"] == "rad"


def test_damping_shows_in_the_eigenvalues() -> None:
    """Assert l = -1/tau for the drag of a bead and 0 for its position, and no oscillation."""
    found = modes(loaded("linear_drag"))
    assert found.eigenvalue_real.values == pytest.approx([0.0, -10.0], rel=1e-14)
    assert found.frequency.values.tolist() == [0.0]
    assert found.period.values.tolist() == [math.inf]


def test_what_falls_over_has_no_frequency() -> None:
    """Assert nan for a pendulum on its head, and the rate at which it falls."""
    found = modes(loaded("pendulum"), at={"theta": "180 degree", "v_theta": 0})
    assert np.isnan(found.frequency.values).all()
    assert found.eigenvalue_real.values.max() == pytest.approx(math.sqrt(GRAVITY), rel=1e-9)


@pytest.mark.dear
def test_states_alone_have_eigenvalues_and_no_modes() -> None:
    """Assert that a model without coordinates is linearised too."""
    model = xd.Model(
        name="decay", parameters={"k": "5 s-1"}, states={"n": {"unit": "mol", "rate": "-k*n"}}, initial={"n": "1 mol"}
    )
    found = modes(model)
    assert found.sizes["mode"] == 0
    assert found.eigenvalue_real.values.tolist() == [-5.0]
    assert of(found, "forward_euler", "largest_stable_step") == pytest.approx(0.4, rel=1e-9)
    assert np.isnan(of(found, "euler_cromer", "largest_stable_step"))
    rates = {"slow": "1", "fast": "1.5"}
    both = xd.Model(
        name="decays",
        states={n: {"unit": "mol", "rate": f"-{k}*{n}/(1*second)"} for n, k in rates.items()},
        initial=dict.fromkeys(rates, "1 mol"),
    )
    assert of(modes(both), "rk4", "suggested_step") == pytest.approx(2 * math.pi / 20, rel=1e-12)  # of the slowest
    growing = xd.Model(
        name="grows",
        states={"up": {"unit": "mol", "rate": "2*up/second"}, "down": {"unit": "mol", "rate": "-0.1*down/second"}},
        initial={"up": "1 mol", "down": "1 mol"},
    )
    assert of(modes(growing), "rk4", "suggested_step") == pytest.approx(
        2 * math.pi / 2 / 20, rel=1e-12
    )  # of what grows


def of(found: xr.Dataset, method: str, name: str) -> float:
    """What a variable says of a method."""
    names = found.method_name.attrs["flag_meanings"].split()
    return float(found[name][names.index(method)])


def test_steps_of_methods_are_those_of_the_fastest_mode() -> None:
    """Assert 2/w and 0 for the largest stable step, and a twentieth of the period as suggestion."""
    found = modes(loaded("coupled_masses"))
    assert of(found, "velocity_verlet", "largest_stable_step") == pytest.approx(2 / 3, rel=1e-9)
    assert of(found, "velocity_verlet", "suggested_step") == pytest.approx(2 * math.pi / 3 / 20, rel=1e-12)
    assert of(found, "forward_euler", "largest_stable_step") == 0.0
    assert of(found, "forward_euler", "suggested_step") == pytest.approx(0.01 / (2 * math.pi) / 3, rel=1e-4)


@pytest.mark.dear
def test_a_row_of_a_record_is_taken_in_its_units() -> None:
    """Assert that the state of a run in degrees gives the stiffness there: w**2 = g/l cos(theta)."""
    model = loaded("pendulum").replace(initial={"theta": "40 degree"})
    run = xd.simulate(model, method="velocity_verlet", step="10 ms", until="0.3 s")
    run["theta"] = (run.theta * 180 / math.pi).assign_attrs(run.theta.attrs | {"units": "degree"})
    for row in (0, 7, -1):
        angle = math.radians(float(run.theta[row]))
        found = modes(run, row=row)
        assert float(found.frequency[0]) == pytest.approx(math.sqrt(GRAVITY * math.cos(angle)), rel=1e-12)
        assert float(found.time) == float(run.time[row])


def test_every_variable_says_what_it_is() -> None:
    """Assert units, a long name and a role on all of a model with angles, states and drives."""
    for name in ("rocket_c6", "double_pendulum"):
        for variable in modes(loaded(name)).data_vars.values():
            assert {"units", "long_name", "role"} <= set(variable.attrs)


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"row": 3}, "row 3 is not among the run's 3; needs 0 to 2, or -3 to -1"),
        ({"row": "last"}, "row 'last' is not among the run's 3"),
        ({"at": {"z": 1}}, "initial has no entry 'z'; there are"),
        ({"at": {"x": "1 s"}}, "x = '1 s' has units 's', needs 'm'"),
    ],
)
def test_a_wrong_place_is_refused(asked: dict[str, object], message: str) -> None:
    """Assert that rows and values that do not exist are named with those that do."""
    run = xd.simulate(oscillator().model, step=0.5, until=1.0)
    with pytest.raises(xd.InputError, match=message):
        modes(run, **asked)


def test_what_cannot_be_linearised_is_refused() -> None:
    """Assert a reason for a Dataset that is no record, a row of a model, and a derivative that is infinite."""
    with pytest.raises(xd.InputError, match="this is no run record"):
        modes(xr.Dataset())
    with pytest.raises(xd.InputError, match=r"needs a Model or a run record, got 'ball\.nc'"):
        modes("ball.nc")
    with pytest.raises(xd.InputError, match="row is 2, but a model has no rows"):
        modes(oscillator().model, row=2)
    with pytest.raises(xd.InputError, match="the rate of v_x has the derivative -?inf by x; choose another state"):
        modes(particle("-sqrt(x*metre)*newton/metre"), at={"x": "0 m"})


def push(x: float) -> float:
    """A force in Python."""
    return -2.0 * x


def test_forces_in_python_have_no_derivative() -> None:
    """Assert that the function is named."""
    with pytest.raises(xd.InputError, match="forces written in Python, 'push', which have no derivative"):
        modes(particle(forces={"push": {"x": push}}))


@pytest.mark.parametrize(("x", "fits"), [(-1.0, True), (0.5, True), (2.0, True), (-1.01, False), (2.01, False)])
def test_no_modes_beyond_a_table(x: float, fits: bool) -> None:
    """Assert stiffness from a table's slope wherever it reaches, its ends among them, and that it is named beyond."""
    model = xd.Model(
        name="bent",
        coordinates={"x": "m"},
        mass={"x": "1*kilogram"},
        initial={"x": f"{x!r} m", "v_x": "0 m s-1"},
        drives={"f": {"table": "f.csv", "argument": "x", "csv": "x [m],f [N]\n-1,4\n2,-8\n"}},
        forces={"table": {"x": "f"}},
    )
    if fits:
        assert xd.modes(model).frequency.values == pytest.approx([2.0])
        return
    with pytest.raises(xd.InputError, match=f"drive 'f' has no value at x = {x!r}, its table reaches from -1 to 2"):
        xd.modes(model)


def test_an_element_of_the_state_is_replaced() -> None:
    """Assert the frequencies sqrt(3k/m)*abs(u) of two masses on cubic springs, one of them moved by its element's name."""
    model = xd.Model(
        name="cubic springs",
        dimensions={"site": 2},
        coordinates={"u": {"unit": "m", "dims": ["site"]}},
        parameters={"k": "3 N m-3", "m": "1 kg"},
        mass={"u": "m"},
        forces={"spring": {"u": "-k*u**3"}},
        initial={"u": {"unit": "m", "value": [1, 1]}},
    )
    found = xd.modes(model, at={"u[1]": "2 m"})
    assert sorted(found.frequency.values.tolist()) == pytest.approx([3.0, 6.0], rel=1e-13)


@pytest.mark.parametrize("name", ["coupled_masses", "truss", "heat"])
def test_modes_are_kept_as_evidence(name: str, tmp_path: Path) -> None:
    """Assert that modes are saved and opened again, of a run with the digest of the run that they are of."""
    run = xd.simulate(loaded(name), until=1e-3)
    found = modes(run, row=-1)
    opened = xd.open_run(xd.save(found, tmp_path / "modes.nc"))
    assert opened.equals(found)
    assert opened.attrs["evidence"] == "modes"
    assert opened.attrs["runs"] == verified(xd.save(run, tmp_path / "run.nc"))
    lazily = modes(run, row=-1, compute=False).compute()
    assert xd.open_run(xd.save(lazily, tmp_path / "lazily.nc")).equals(found)
    with pytest.raises(xd.InputError, match="these are not the modes as they were made"):
        xd.save(found.assign(fastest_time_scale=found["fastest_time_scale"] * 2.0), tmp_path / "edited.nc")


@pytest.mark.parametrize(
    ("c", "said"),
    [
        ("0", []),
        ("1", ["damped    0.866 rad s-1 decaying at 0.5 s-1"]),
        ("4", ["decays    2 without oscillation"]),
    ],
)
def test_damping_is_told_beside_undamped_frequencies(c: str, said: list[str]) -> None:
    """Assert what a mass of 1 kg on 1 N/m turns at and decays by without, with little, and with too much damping."""
    model = xd.Model(
        name="damped",
        coordinates={"x": "m"},
        parameters={"m": "1 kg", "k": "1 N m-1", "c": f"{c} kg s-1"},
        mass={"x": "m"},
        forces={"spring": {"x": "-k*x"}, "damper": {"x": "-c*v_x"}},
        initial={"x": "1 m", "v_x": "0 m s-1"},
    )
    lines = summary(modes(model))
    assert "modes     1; undamped frequency 1 rad s-1; the longest period is 6.283 s" in lines
    assert [line for line in lines if line.startswith(("damped", "decays"))] == said


def test_modes_are_told_in_words() -> None:
    """Assert frequencies, rigid motions, growth, and the steps to begin with of two masses and of a balanced pendulum."""
    lines = "\n".join(summary(modes(loaded("coupled_masses"))))
    assert "modes     2; undamped frequencies 2, 3 rad s-1; the longest period is 3.142 s" in lines
    assert "growth" not in lines
    assert "0.039 s to begin with by midpoint, heun" in lines
    balanced = "\n".join(summary(modes(loaded("balanced_pendulum"))))
    assert "modes     2; 1 rigid motion; 1 does not oscillate" in balanced
    assert "growth    4.589 s-1" in balanced
    assert "growth" not in "\n".join(summary(modes(loaded("toda_chain"))))  # 1e-8 of a double zero is rounding


def test_the_command_prints_frequencies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert a row a mode above the summary, about a row of an archived run too, and one line for what has no rows."""
    monkeypatch.chdir(tmp_path)
    model = str(MODELS / "coupled_masses.toml")
    done = CliRunner().invoke(main, ["modes", model, "-o", "modes.nc"])
    assert done.exit_code == 0, done.output
    lines = done.output.splitlines()
    assert lines[2].split()[:2] == ["frequency", "[rad"]
    assert [line.split()[0] for line in lines[3:5]] == ["2", "3"]
    xd.simulate(xd.Model.from_toml(model), until="0.1 s", path="run.nc")
    assert "about     the state at t = 0.1 s" in CliRunner().invoke(main, ["modes", "run.nc", "--row", "-1"]).output
    for wrong in (
        ["modes", model, "--row", "2"],
        ["modes", "run.nc", "--row", "1000000"],
        ["modes", model, "--set", "foo=1"],
    ):
        done = CliRunner().invoke(main, wrong)
        assert done.exit_code == 2
        assert done.output.startswith("xdynamics: ")


ROLLING = """
name = "disc on a spring"
[coordinates]
x = "m"
theta = "rad"
[parameters]
m = "3 kg"
R = "0.2 m"
k = "8 N m-1"
[mass]
x = "m"
theta = "m*R**2/2"
[forces.spring]
potential = "k*x**2/2"
[constraints.contact]
rolls = "v_x - R*v_theta/(1*radian)"
[initial]
x = "0 m"
theta = "0 rad"
"""
HANGING = """
name = "hanging body"
[bodies.rod]
mass = "2 kg"
inertia = ["0.2 kg m2", "0.3 kg m2", "0.15 kg m2"]
points = { top = ["0 m", "0 m", "0.5 m"] }
[bodies.rod.initial]
position = ["0 m", "0 m", "-0.5 m"]
[parameters]
g = "9.81 m s-2"
[forces.weight]
potential = "rod_mass*g*rod_r[z]"
[constraints.pin]
holds = "point(rod, top)"
"""


def two_rods(copies: int = 1) -> xd.Model:
    """Two masses on rods, hanging, in Cartesian coordinates; the second rod perhaps written several times."""
    rods = {"upper": {"holds": "(x1**2 + y1**2 - l1**2)/(2*l1)"}}
    rods |= {f"lower{k}": {"holds": "((x2 - x1)**2 + (y2 - y1)**2 - l2**2)/(2*l2)"} for k in range(copies)}
    return xd.Model(
        name="rods",
        coordinates=dict.fromkeys(("x1", "y1", "x2", "y2"), "m"),
        parameters={"m1": "1 kg", "m2": "2 kg", "l1": "1 m", "l2": "0.7 m", "g": "9.8 m s-2"},
        mass={"x1": "m1", "y1": "m1", "x2": "m2", "y2": "m2"},
        forces={"weight": {"potential": "g*(m1*y1 + m2*y2)"}},
        constraints=rods,
        initial={"x1": "0 m", "x2": "0 m", "y1": "-1 m", "y2": "-1.7 m"},
    )


@pytest.mark.parametrize("copies", [1, 2])
def test_rods_have_the_modes_of_their_angles(copies: int) -> None:
    """Assert that two hanging rods have both frequencies and shapes of a double pendulum, also if one is held twice."""
    m1, m2, l1, l2, g = 1.0, 2.0, 1.0, 0.7, 9.8
    mass = np.array([[(m1 + m2) * l1**2, m2 * l1 * l2], [m2 * l1 * l2, m2 * l2**2]])
    squares, angles = np.linalg.eig(np.linalg.solve(mass, np.diag([(m1 + m2) * g * l1, m2 * g * l2])))
    order = np.argsort(squares)
    found = xd.modes(two_rods(copies))
    np.testing.assert_allclose(found.frequency, np.sqrt(squares[order]), rtol=1e-12)
    ratio = l2 / l1 * angles[1, order] / angles[0, order] + 1.0
    np.testing.assert_allclose(found.shape_x2 / found.shape_x1, ratio, rtol=1e-11)
    assert abs(found.shape_y2).max() < 1e-15
    turning = np.sort(abs(found.eigenvalue_imag))
    np.testing.assert_allclose(turning, np.repeat(np.sqrt(squares[order]), 2), rtol=1e-12)
    assert abs(found.eigenvalue_real).max() < 1e-13


def test_stable_steps_are_those_of_the_modes() -> None:
    """Assert that velocity Verlet is stable up to 2 over the faster frequency of two rods."""
    found = xd.modes(two_rods())
    names = found.method_name.attrs["flag_meanings"].split()
    limit = dict(zip(names, found.largest_stable_step.values, strict=True))
    assert limit["velocity_verlet"] == pytest.approx(2.0 / float(found.frequency[-1]), rel=1e-9)


def test_a_rolling_disc_is_half_as_heavy_again() -> None:
    """Assert that rolling couples a disc's spin to its motion: w**2 = k/(1.5 m), and one eigenvalue is a position."""
    found = xd.modes(xd.Model.from_text(ROLLING))
    frequency = math.sqrt(8.0 / 4.5)
    assert found.frequency.values == pytest.approx([frequency], rel=1e-13)
    assert float(found.shape_theta[0] / found.shape_x[0]) == pytest.approx(5.0, rel=1e-13)
    assert sorted(abs(found.eigenvalue_imag.values)) == pytest.approx([0.0, frequency, frequency], rel=1e-12, abs=1e-12)


def test_a_hanging_body_swings_in_two_planes() -> None:
    """Assert that a body held at a point has the eigenvalues of both its physical pendulums, and nothing else that moves."""
    found = xd.modes(xd.Model.from_text(HANGING))
    squares = np.sort(found.eigenvalue_imag.values**2)
    about = [2 * 9.81 * 0.5 / (moment + 2 * 0.25) for moment in (0.3, 0.2)]
    assert squares[-4:] == pytest.approx(np.repeat(about, 2), rel=1e-9)
    assert abs(squares[:-4]).max() < 1e-9
    assert abs(found.eigenvalue_real).max() < 1e-6
    assert found.frequency.values == pytest.approx([0.0, *np.sqrt(about)], rel=1e-12)
    shapes = found.shape_rod_turn.values
    np.testing.assert_allclose(abs(shapes), np.eye(3)[[2, 1, 0]], atol=1e-12)


def test_modes_of_a_constrained_model_are_described_before_they_are_computed() -> None:
    """Assert that sizes are known at once, and that a row of a run gives as many modes."""
    model = two_rods()
    lazily = xd.modes(model, compute=False)
    assert (lazily.sizes["mode"], lazily.sizes["eigenvalue"]) == (2, 4)
    found = xd.modes(model)
    assert lazily.compute().assign_attrs(found.attrs).identical(found)  # the date aside
    run = xd.simulate(xd.Model.from_toml(MODELS / "four_bar.toml"), until="0.5 s")
    assert xd.modes(run, row=-1).sizes["mode"] == 1


def test_modes_of_an_unmarched_run_of_many_elements_are_those_of_the_run() -> None:
    """Assert the numbers and dimensions of the marched run's modes, about a row that is read later."""
    chain = xd.Model.from_toml(MODELS / "toda_chain.toml")
    asked: dict[str, Any] = {"method": "velocity_verlet", "step": 0.05, "until": 1.0}
    assert_same_bits(
        modes(xd.simulate(chain, **asked, compute=False), row=3, compute=False),
        modes(xd.simulate(chain, **asked), row=3),
    )


@pytest.mark.parametrize("faster", [1.0, 100.0])
def test_eigenvalues_of_what_moves_are_rates(faster: float) -> None:
    """Assert that a moving pendulum has eigenvalues of its frequency, no growth, and a hundredfold if all is as fast."""
    model = xd.Model(
        name="rod",
        coordinates={"x": "m", "y": "m"},
        parameters={"g": f"{9.8 * faster**2} m s-2"},
        mass={"x": "1*kilogram", "y": "1*kilogram"},
        forces={"weight": {"potential": "1*kilogram*g*y"}},
        constraints={"rod": {"holds": "hypot(x, y) - 1*metre"}},
        initial={"x": "0.6 m", "y": "-0.8 m", "v_x": f"{2.4 * faster} m s-1", "v_y": f"{1.8 * faster} m s-1"},
    )
    found = xd.modes(model)
    np.testing.assert_allclose(found.eigenvalue_imag, float(found.frequency[0]) * np.array([-1.0, 1.0]), rtol=1e-12)
    assert abs(found.eigenvalue_real).max() < 1e-12 * faster
    assert float(found.frequency[0]) == pytest.approx(faster * math.sqrt(9.8 * 0.8), rel=1e-12)  # as of the angle


def test_velocities_follow_displacements_of_what_moves() -> None:
    """Assert the eigenvalues of a moving pendulum with drag along x alone, by the linear equation of its angle."""
    model = xd.Model(
        name="rod",
        coordinates={"x": "m", "y": "m"},
        parameters={"g": "9.8 m s-2", "c": "0.5 kg s-1"},
        mass={"x": "1*kilogram", "y": "1*kilogram"},
        forces={"weight": {"potential": "1*kilogram*g*y"}, "drag": {"x": "-c*v_x"}},
        constraints={"rod": {"holds": "hypot(x, y) - 1*metre"}},
        initial={"x": "0.6 m", "y": "-0.8 m", "v_x": "2.4 m s-1", "v_y": "1.8 m s-1"},
    )
    found = xd.modes(model)
    values = found.eigenvalue_real.values + 1j * found.eigenvalue_imag.values
    # theta'' = -g sin(theta) - c cos(theta)**2 theta' at sin(theta) = 0.6, theta' = 3/s
    assert values.sum() == pytest.approx(-0.5 * 0.8**2, rel=1e-12)
    assert values.prod() == pytest.approx(9.8 * 0.8 - 0.5 * 2 * 0.6 * 0.8 * 3.0, rel=1e-12)

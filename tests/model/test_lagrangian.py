"""Models by their energies: against hand-written equations, against sympy's, and what no Lagrangian is."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import sympy
from sympy.physics.mechanics import KanesMethod, LagrangesMethod, Particle, Point, ReferenceFrame, dynamicsymbols

import xdynamics as xd
from cases.command_line import call
from cases.problems import MODELS
from xdynamics.model.motion import constants, drive_pieces, evaluate_motion, variables

COMMON = {"m": "0.7 kg", "l": "1.3 m", "g": "9.81 m s-2", "k": "40 N m-1"}
ANGLES = {"theta": "rad", "phi": "rad"}
START = {"theta": "1 rad", "phi": "0 rad", "v_phi": "2 rad s-1"}
DOUBLE = {
    "name": "double",
    "coordinates": {"th1": "rad", "th2": "rad"},
    "parameters": {"m1": "1 kg", "m2": "0.8 kg", "l1": "1 m", "l2": "0.7 m", "g": "9.80665 m s-2"},
    "lagrangian": {
        "kinetic": "m1*(l1*v_th1)**2/2 + m2*((l1*v_th1)**2 + (l2*v_th2)**2 + 2*l1*l2*v_th1*v_th2*cos(th1 - th2))/2",
        "potential": "-(m1 + m2)*g*l1*cos(th1) - m2*g*l2*cos(th2)",
    },
    "initial": {"th1": "120 degree", "th2": "-10 degree"},
}
SPHERICAL = {
    "name": "spherical pendulum",
    "coordinates": ANGLES,
    "parameters": COMMON,
    "initial": START,
    "lagrangian": {"kinetic": "m*l**2*(v_theta**2 + sin(theta)**2*v_phi**2)/2", "potential": "-m*g*l*cos(theta)"},
}
ELASTIC = {
    "name": "elastic pendulum",
    "coordinates": {"r": "m", "theta": "rad"},
    "parameters": COMMON,
    "lagrangian": {"kinetic": "m*(v_r**2 + (r*v_theta)**2)/2", "potential": "k*(r - l)**2/2 - m*g*r*cos(theta)"},
    "initial": {"r": "1.5 m", "theta": "0.5 rad"},
}
TOP = {
    "name": "heavy top",
    "coordinates": {"theta": "rad", "phi": "rad", "psi": "rad"},
    "parameters": COMMON | {"A": "0.02 kg m2", "C": "0.01 kg m2"},
    "lagrangian": {
        "kinetic": "A*(v_theta**2 + (sin(theta)*v_phi)**2)/2 + C*spin**2/2",
        "potential": "m*g*l*cos(theta)",
    },
    "definitions": {"spin": "v_psi + v_phi*cos(theta)"},
    "initial": {"theta": "0.4 rad", "phi": "0 rad", "psi": "0 rad", "v_psi": "150 rad s-1"},
}
ROTATING = {  # a bead on a hoop that turns with a given rate, and a pivot that shakes: terms with v once, and with t
    "name": "shaken hoop",
    "coordinates": {"theta": "rad"},
    "parameters": COMMON | {"w": "3 s-1", "a": "0.1 m"},
    "lagrangian": {
        "kinetic": "m*((l*v_theta)**2 + (w*l*sin(theta))**2)/2 - m*l*v_theta*sin(theta)*a*w*cos(w*t)",
        "potential": "-m*g*l*cos(theta)",
    },
    "initial": {"theta": "1 rad"},
}


def by_sympy(given: dict[str, Any], state: dict[str, float]) -> list[float]:
    """Accelerations by sympy's LagrangesMethod, of the same texts."""
    t = dynamicsymbols._t
    names = {name: dynamicsymbols(name) for name in given["coordinates"]}
    known: dict[str, Any] = {f"v_{name}": one.diff(t) for name, one in names.items()} | names | {"t": t}
    known |= {name: sympy.Symbol(name) for name in given["parameters"]}
    for name, text in given.get("definitions", {}).items():
        known[name] = sympy.sympify(text, locals=known)
    energies = {key: sympy.sympify(text, locals=known) for key, text in given["lagrangian"].items()}
    method = LagrangesMethod(energies["kinetic"] - energies["potential"], list(names.values()))
    method.form_lagranges_equations()
    values = {sympy.Symbol(name): xd.Model(**given).parameters[name].quantity.si for name in given["parameters"]}
    values |= {one.diff(t): state[f"v_{name}"] for name, one in names.items()}
    values |= {one: state[name] for name, one in names.items()} | {t: state["t"]}
    mass, forcing = (
        np.array(one.xreplace(values).evalf().tolist(), float) for one in (method.mass_matrix, method.forcing)
    )
    found: list[float] = np.linalg.solve(mass, forcing)[:, 0].tolist()
    return found


@pytest.mark.dear
@pytest.mark.parametrize("given", [DOUBLE, SPHERICAL, ELASTIC, TOP, ROTATING], ids=lambda one: one["name"])
def test_accelerations_are_those_of_sympy(given: dict[str, Any]) -> None:
    """Assert accelerations at random states against another derivation of the same energies."""
    model, rng = xd.Model(**given), np.random.default_rng(5)
    for _ in range(5):
        state = {name: float(rng.uniform(0.3, 1.4)) for name in ("t", *variables(model))}
        found = evaluate_motion(model, state, constants(model), drive_pieces(model))
        assert [found[f"a_{name}"] for name in model.elements.statement.coordinates] == pytest.approx(
            by_sympy(given, state), rel=1e-10
        )


def test_a_double_pendulum_is_the_hand_written_one() -> None:
    """Assert the same motion, energies and order of magnitude of work as the model that has its terms by hand."""
    asked = {"method": "dop853", "rtol": 1e-11, "until": "2 s"}
    derived, written = xd.Model(**DOUBLE), xd.Model.from_toml(MODELS / "double_pendulum.toml")
    one, other = (xd.simulate(model, **asked) for model in (derived, written))
    for name in ("th1", "th2", "v_th1", "total_energy"):
        assert float(one[name][-1]) == pytest.approx(float(other[name][-1]), rel=1e-8)
    assert "force_inertia_th1" in one
    assert "force_potential_th2" in one


def test_a_steady_precession_of_the_top() -> None:
    """Assert the fast top's rate of precession, m g l/(C w), and that energy and both momenta stay (Goldstein, 5.7)."""
    given = TOP | {
        "initial": {"theta": "0.4 rad", "phi": "0 rad", "psi": "0 rad", "v_psi": "1000 rad s-1", "v_phi": "0 rad s-1"},
        "observables": {"p_psi": "C*spin", "p_phi": "A*sin(theta)**2*v_phi + C*spin*cos(theta)"},
    }
    run = xd.simulate(xd.Model(**given), method="dop853", rtol=1e-12, until="2 s")
    rate = float(run.phi[-1] - run.phi[0]) / 2.0
    model = xd.Model(**given)
    m, g, length, inertia = (model.parameters[name].quantity.si for name in ("m", "g", "l", "C"))
    assert rate == pytest.approx(m * g * length / (inertia * 1000.0), rel=0.01)
    for name in ("p_psi", "p_phi"):
        assert float(abs(run[name] - run[name][0]).max()) < 1e-9 * abs(float(run[name][0]))


@pytest.mark.dear
def test_it_is_stored_shown_and_read_again(tmp_path: Any) -> None:
    """Assert that the file keeps the energies, the record the whole, `check` the equations, and other forces stay."""
    given = SPHERICAL | {
        "forces": {"drag": {"theta": "-0.1*newton*metre*second*v_theta"}},
        "run": {"method": "dop853", "rtol": 1e-8, "until": "1 s"},
    }
    model = xd.Model(**given)
    text = model.to_toml()
    assert "[lagrangian]" in text
    assert "[mass]" not in text
    assert "inertia" not in text
    assert xd.Model.from_text(text) == model
    path = tmp_path / "spherical.toml"
    path.write_text(text)
    lines = call("check", path).output
    assert "motion    m*l**2*" in lines
    assert "force     inertia of phi = " in lines
    assert "force     potential of theta = -m*g*l*sin(theta)" in lines
    run = xd.save(xd.simulate(model), tmp_path / "run.nc")
    assert xd.reproduce(run).attrs["identical"] == 1


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"lagrangian": {"potential": "0*joule"}}, "lagrangian: key 'kinetic' is missing"),
        ({"lagrangian": {"kinetic": "m*l*(v_theta**2 + v_phi**2)"}}, "kinetic energy has units 'kg m s-2"),
        (
            {"lagrangian": {"kinetic": "m*l**2*abs(v_theta)*v_theta"}},
            "kinetic is not quadratic in velocities: its second derivative by v_theta",
        ),
        (
            {"lagrangian": {"kinetic": "m*l**2*(v_theta**2 + v_phi**2)", "potential": "m*l**2*v_theta**2"}},
            "potential of 'potential' depends on a velocity",
        ),
        ({"lagrangian": {"kinetic": "m*l**2*v_psi**2"}}, "kinetic reads 'v_psi'"),
        ({"lagrangian": {"kinetic": "m*l**2*v_theta**2"}}, "kinetic does not read v_phi, so that 'phi' has no inertia"),
        ({"mass": {"theta": "m*l**2", "phi": "m*l**2"}}, r"stands beside \[mass\]"),
        ({"forces": {"inertia": {"theta": "0*newton*metre"}}}, "makes a force 'inertia'"),
        ({"lagrangian": {"kinetic": "m*l**2*v_theta**2", "momentum": "1"}}, "key 'momentum' is not known"),
    ],
)
def test_what_is_no_lagrangian_is_named(change: dict[str, Any], said: str) -> None:
    """Assert that each fault is told with what was needed."""
    with pytest.raises(xd.ModelError, match=said):
        xd.Model(**SPHERICAL | change)


Q, M, L, G, C = dynamicsymbols("q"), *sympy.symbols("m l g c")
SYMBOLS = {
    "coordinates": {"q": "rad"},
    "parameters": {"m": "1 kg", "l": "2 m", "g": "9.81 m s-2"},
    "initial": {"q": "1 rad"},
}


def pendulum(potential: Any = None) -> LagrangesMethod:
    """Sympy's plane pendulum."""
    method = LagrangesMethod(
        M * L**2 * Q.diff() ** 2 / 2 + M * G * L * sympy.cos(Q) if potential is None else potential, [Q]
    )
    method.form_lagranges_equations()
    return method


def test_equations_of_lagrange_from_sympy() -> None:
    """Assert that the model of sympy's equations moves like the one by its energies."""
    asked = {"method": "dop853", "rtol": 1e-11, "until": "3 s"}
    other = xd.Model(name="own", lagrangian={"kinetic": "m*(l*v_q)**2/2", "potential": "-m*g*l*cos(q)"}, **SYMBOLS)
    one, two = (xd.simulate(model, **asked) for model in (xd.Model.from_sympy(pendulum(), **SYMBOLS), other))
    assert float(one.q[-1]) == pytest.approx(float(two.q[-1]), rel=1e-9)


@pytest.mark.dear
def test_equations_of_kane_from_sympy() -> None:
    """Assert a cart with a pendulum by Kane's method against its Lagrangian."""
    x, theta, u, w = dynamicsymbols("x theta u w")
    frame, origin = ReferenceFrame("N"), Point("O")
    origin.set_vel(frame, 0)
    cart = origin.locatenew("C", x * frame.x)
    cart.set_vel(frame, u * frame.x)
    bob = cart.locatenew("P", L * sympy.sin(theta) * frame.x - L * sympy.cos(theta) * frame.y)
    bob.set_vel(frame, (u + L * w * sympy.cos(theta)) * frame.x + L * w * sympy.sin(theta) * frame.y)
    kane = KanesMethod(frame, q_ind=[x, theta], u_ind=[u, w], kd_eqs=[u - x.diff(), w - theta.diff()])
    kane.kanes_equations(
        [Particle("cart", cart, M), Particle("bob", bob, M)], [(bob, -M * G * frame.y), (cart, -C * u * frame.x)]
    )
    given = {
        "parameters": SYMBOLS["parameters"] | {"c": "0.3 kg s-1"},
        "coordinates": {"x": "m", "theta": "rad"},
        "initial": {"x": "0 m", "theta": "1 rad"},
    }
    energies = {
        "kinetic": "m*v_x**2/2 + m*((v_x + l*v_theta*cos(theta))**2 + (l*v_theta*sin(theta))**2)/2",
        "potential": "-m*g*l*cos(theta)",
    }
    own = xd.Model(name="own", lagrangian=energies, forces={"bearing": {"x": "-c*v_x"}}, **given)
    one, two = (
        xd.simulate(model, method="dop853", rtol=1e-11, until="3 s")
        for model in (xd.Model.from_sympy(kane, **given), own)
    )
    assert float(one.x[-1]) == pytest.approx(float(two.x[-1]), rel=1e-8)


@pytest.mark.parametrize(
    ("equations", "change", "said"),
    [
        (lambda: 5, {}, "need a LagrangesMethod or KanesMethod"),
        (lambda: LagrangesMethod(Q.diff() ** 2, [Q]), {}, "has no equations yet"),
        (pendulum, {"coordinates": {}}, "coordinates need a unit for 'q'"),
        (pendulum, {"forces": {"motion": {"q": "0*newton"}}}, "forces has 'motion'"),
        (pendulum, {"parameters": {"m": "1 kg"}}, "name 'l' .*is not declared"),
        (
            lambda: pendulum(M * L**2 * Q.diff() ** 2 / 2 + M * G * L * sympy.gamma(Q)),
            {},
            "hold .*gamma.*, which the language",
        ),
    ],
)
def test_what_cannot_be_taken_over(equations: Any, change: dict[str, Any], said: str) -> None:
    """Assert that foreign objects, functions and missing units are named."""
    with pytest.raises(xd.InputError, match=said):
        xd.Model.from_sympy(equations(), **SYMBOLS | change)

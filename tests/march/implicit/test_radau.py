"""Radau IIA as RADAU5 makes it: coefficients, order, tolerances, what is kept from step to step, dense output.

Steps of Radau IIA where links close and hold: solved to rounding, whoever chooses them.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import mpmath as mp
import numpy as np
import pytest
import xarray as xr
from adaptive_problems import PROBLEMS
from stiff_problems import STIFF, chain

import xdynamics as xd
from cases.plain import made_by_hand, plain
from cases.problems import EPS, MODELS
from xdynamics.kernels import linear
from xdynamics.march import March, march_many
from xdynamics.march.configuration import settings_for
from xdynamics.march.engine import engine
from xdynamics.march.implicit import radau as march_radau
from xdynamics.march.implicit.radau import MOST_SETTLING, SETTLED
from xdynamics.march.log import LOG_COUNTS, allocate
from xdynamics.march.memory import changing_arrays, put_back
from xdynamics.methods import implicit

# what keeps an absolute tolerance below the smallest component
SMALL = {"hires": 1e-4, "robertson": 1e-8, "van_der_pol": 1.0}
# of scipy 1.17.1's Radau at rtol = 1e-6 with the same tolerances: Jacobians, factorisations
PEER = {"hires": (75, 232), "robertson": (132, 494), "van_der_pol": (122, 430)}


def stiff(name: str, tolerance: float) -> xr.Dataset:
    """March a problem of the test set to its end."""
    asked = {"rtol": tolerance, "atol": tolerance * SMALL[name], "until": STIFF[name].end, "force_samples": "none"}
    run = xd.simulate(STIFF[name].model(), method="radau_iia", **asked)
    assert run.attrs["run_outcome"] == "completed"
    return run


def falling_off() -> xd.Model:
    """The fall y' = -y**3/2, whose solution is 1/sqrt(1 + t)."""
    states = {"y": {"unit": "1", "rate": "-y**3/(2*tau)"}}
    return xd.Model(name="falling off", parameters={"tau": "1 s"}, states=states, initial={"y": "1"})


def error(run: xr.Dataset) -> float:
    """Its largest relative error."""
    return float(np.abs(run.y * np.sqrt(1 + (run.time if "time" in run else run.at_time)) - 1).max())


def relative(name: str, run: xr.Dataset) -> float:
    """The largest relative error of the last state."""
    return float(np.abs(STIFF[name].last_of(run) / np.array(STIFF[name].reference) - 1).max())


# ---------------------------------------------------------------------------------------------------- coefficients


def test_coefficients_take_the_method_apart() -> None:
    """Assert against 40 digits that T**-1 A**-1 T is the block of gamma, alpha and beta, and T**-1 inverts T."""
    with mp.workdps(40):
        s = mp.sqrt(6)
        a = mp.matrix(
            [
                [(88 - 7 * s) / 360, (296 - 169 * s) / 1800, (-2 + 3 * s) / 225],
                [(296 + 169 * s) / 1800, (88 + 7 * s) / 360, (-2 - 3 * s) / 225],
                [(16 - s) / 36, (16 + s) / 36, mp.mpf(1) / 9],
            ]
        )
        t, inverse = mp.matrix(implicit.T), mp.matrix(implicit.T_INVERSE)
        block = mp.matrix(
            [
                [implicit.GAMMA, 0, 0],
                [0, implicit.ALPHA, -implicit.BETA],
                [0, implicit.BETA, implicit.ALPHA],
            ]
        )
        assert mp.mnorm(inverse * a**-1 * t - block) < 64 * EPS
        assert mp.mnorm(inverse * t - mp.eye(3)) < 16 * EPS
        nodes = [(4 - s) / 10, (4 + s) / 10, mp.mpf(1)]
        weights = [(-13 - 7 * s) / 3, (-13 + 7 * s) / 3, -mp.mpf(1) / 3]
        assert [float(node) for node in nodes] == pytest.approx(implicit.NODES, rel=EPS)
        assert [float(weight) for weight in weights] == pytest.approx(implicit.ERROR, rel=EPS)


@pytest.mark.parametrize(("n", "band"), [(1, 1), (2, 2), (7, 7), (9, 2)])
def test_factors_solve(n: int, band: int) -> None:
    """Assert that the real and the complex system, full or banded, are solved as numpy solves them, rows exchanged."""
    random = np.random.default_rng(n)
    there = np.abs(np.subtract.outer(np.arange(n), np.arange(n))) < band
    real = random.normal(size=(n, n)) * there
    turned = (random.normal(size=(n, n)) + 1j * random.normal(size=(n, n))) * there
    right = random.normal(size=n) + 1j * random.normal(size=n)
    matrix = np.concatenate([one.T.ravel() for one in (real, turned.real, turned.imag)])
    pivots, first, both = np.zeros(6 * n, np.int64), right.real.copy(), np.concatenate([right.real, right.imag])
    assert plain(linear.factorise)(matrix, pivots, n)
    assert plain(linear.factorise_complex)(matrix, pivots, n)
    plain(linear.substitute)(matrix, pivots, first, n)
    plain(linear.substitute_complex)(matrix, pivots, both, n)
    assert first == pytest.approx(np.linalg.solve(real, right.real), rel=1e-10)
    assert both[:n] + 1j * both[n:] == pytest.approx(np.linalg.solve(turned, right), rel=1e-10)


@pytest.mark.parametrize("bad", [0.0, np.nan, np.inf])
def test_singular_matrices_are_told(bad: float) -> None:
    """Assert that a matrix without an inverse, or with a number that is none, is not taken apart."""
    matrix, pivots = np.full(3 * 4, bad), np.zeros(12, np.int64)
    assert not plain(linear.factorise)(matrix, pivots, 2)
    assert not plain(linear.factorise_complex)(matrix, pivots, 2)


# ------------------------------------------------------------------------------------------- order, dense output


def test_order_five_on_a_nonlinear_problem() -> None:
    """Assert the slope of the error on the grid of y' = -y**3/2."""
    steps = [0.1, 0.05, 0.025]
    errors = [error(xd.simulate(falling_off(), method="radau_iia", step=h, until=2.0)) for h in steps]
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(5, abs=0.15)


def test_the_interpolant_is_the_collocation_polynomial() -> None:
    """Assert that inside a step the state is cubic, and that its slope at the nodes is what the rate says there."""
    h = 0.25
    run = xd.simulate(falling_off(), method="radau_iia", step=h, until=0.5)
    inner = np.linspace(0.02, 0.98, 7)
    found = xd.sample(run, h + h * inner, rule="interpolant").y.values
    cubic = np.polynomial.Polynomial.fit(inner, found, 3)
    nodes = np.array(implicit.NODES)
    assert np.abs(cubic(inner) - found).max() < 8 * EPS
    assert np.abs(cubic([0.0, 1.0]) - run.y.values[1:3]).max() < 64 * EPS
    assert cubic.deriv()(nodes) / h == pytest.approx(-(cubic(nodes) ** 3) / 2, rel=1e-12)


@pytest.mark.parametrize(("rule", "order"), [("reintegrate", 5), ("interpolant", 4)])
def test_order_inside_steps(rule: str, order: int) -> None:
    """Assert that the error inside steps falls as that of the ends, or as h**4 by the cubic of order 3."""
    steps, errors = [0.1, 0.05, 0.025], []
    for h in steps:
        run = xd.simulate(falling_off(), method="radau_iia", step=h, until=2.0)
        found = xd.sample(run, run.time.values[:-1] + 0.3 * h, rule=rule)
        errors.append(error(found))
    assert found.attrs["solver_interpolation_order"] == {"reintegrate": 5, "interpolant": 3}[rule]
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(order, abs=0.15)


def test_samples_of_a_stiff_run_meet_its_states() -> None:
    """Assert that steps solved again, with other iterations, end in the accepted states but for the last spacing of time."""
    run = stiff("van_der_pol", 1e-6)
    for rule in ("reintegrate", "interpolant"):
        found = xd.sample(run, np.nextafter(run.time.values[1:], 0.0), rule=rule)
        moved = np.abs(run.v_x.values[1:]) * np.spacing(run.time.values[1:])
        assert (np.abs(found.x.values - run.x.values[1:]) <= 1.01 * moved + 8 * EPS).all()


def test_what_is_missing_at_the_end_counts_as_error() -> None:
    """Assert that a step that ends beside the accepted state is bent to it, late, and says by how much."""
    run = xd.simulate(falling_off(), method="radau_iia", step=0.25, until=0.25)
    moved = run.assign(y=run.y + 1e-6 * (run.time > 0))
    moved["y"].attrs = run.y.attrs
    del moved.attrs["origin"]  # nobody knows that it was edited
    found, before = (xd.sample(one, [0.125, np.nextafter(0.25, 0.0)]) for one in (moved, run))
    assert (found.y - before.y).values == pytest.approx([1e-6 / 64, 1e-6], rel=1e-6)
    assert (found.error_y - before.error_y).values == pytest.approx([1e-6 / 64, 1e-6], rel=1e-6)


# ----------------------------------------------------------------------------------------------------- tolerances


@pytest.mark.parametrize("name", ["brusselator", "arenstorf"])
def test_error_is_proportional_to_the_tolerance(name: str) -> None:
    """Assert the slope of the error at the end over the tolerance, from 1e-4 to 1e-10."""
    problem, tolerances = PROBLEMS[name], 10.0 ** -np.arange(4, 11)
    errors = []
    for tolerance in tolerances:
        asked = {"rtol": tolerance, "atol": tolerance, "until": problem.end, "force_samples": "none"}
        errors.append(problem.error(problem.last_of(xd.simulate(problem.model(), method="radau_iia", **asked))))
    assert np.polyfit(np.log(tolerances), np.log(errors), 1)[0] == pytest.approx(1, abs=0.1)


def test_the_inner_tolerance_is_recorded_and_marched_with() -> None:
    """Assert the rule in words, and its numbers in the run: 0.1 rtol**(4/5), with atol in the same ratio."""
    model = falling_off()
    march = March(model, settings_for(model, method="radau_iia", rtol=1e-5, atol=1e-7, until=1.0))
    assert march.run.plan[0].rtol == pytest.approx(1e-5, rel=4 * EPS)  # 0.1*(1e-5)**0.8
    march = March(model, settings_for(model, method="radau_iia", rtol=1e-10, atol=1e-12, until=1.0))
    assert march.run.plan[0].rtol == pytest.approx(1e-9, rel=4 * EPS)
    assert march.run.atol[0] == pytest.approx(1e-11, rel=4 * EPS)
    run = xd.simulate(model, method="radau_iia", rtol=1e-5, atol=1e-7, until=1.0)
    assert "0.1*rtol**(4/5) in the place of rtol" in run.attrs["solver_error_norm"]
    assert run.attrs["solver_controller"].startswith("predictive")
    assert run.attrs["solver_rtol"] == 1e-5


def test_step_doubling_has_the_rule_of_every_method() -> None:
    """Assert that with another estimate the inner tolerance, and the controller, are those of any method of order 5."""
    model = falling_off()
    asked = {"method": "radau_iia", "rtol": 1e-6, "until": 1.0, "estimator": "step_doubling"}
    assert March(model, settings_for(model, **asked)).run.plan[0].rtol == pytest.approx(1e-6**1.2, rel=4 * EPS)
    run = xd.simulate(model, **asked)
    assert run.attrs["solver_controller"].startswith("PI")
    assert error(run) < 1e-6


def test_many_runs_have_the_bits_of_each_alone() -> None:
    """Assert it for tolerances of their own, of which the inner ones follow, and one absolute one for all."""
    model, rtols = STIFF["hires"].model(), [1e-5, 3e-6, 1e-7]
    asked = {"method": "radau_iia", "atol": {"y1": 1e-9}, "until": 300.0, "force_samples": "none"}
    found = march_many(model, settings_for(model, rtol=1e-5, **asked), rtols=rtols)
    for k, rtol in enumerate(rtols):
        alone = xd.simulate(model, rtol=rtol, **asked)
        assert [float(alone[name].values[-1]) for name in model.elements.statement.states] == found.state[k].tolist()
        assert alone.sizes["step"] == found.rows[k]


# ------------------------------------------------------------------------------------------------- what is kept


@pytest.mark.parametrize(
    ("sizes", "verdict"),
    [
        ([1e-9], march_radau.OPEN),  # one correction does not say how the next ones fall
        ([1.0, 0.05, 1e-3], march_radau.DONE),
        ([1.0, 0.995], march_radau.IN_VAIN),
        ([1.0, 0.7], march_radau.IN_VAIN),  # 0.7**7 would not be small enough
        ([1.0, np.nan], march_radau.IN_VAIN),
        ([3e-3, 2e-3], march_radau.DONE),  # below 10 eps/rtol it is rounding that no longer falls
    ],
)
def test_iterations_are_judged_by_their_corrections(sizes: list[float], verdict: int) -> None:
    """Assert what is said of the last of some corrections, in units of the error that is allowed, for rtol = 1e-12."""
    run = made_by_hand()
    run.plan[0].adaptive, run.plan[0].rtol, run.kept[0].eta = 1, 1e-12, 1e6
    told = [plain(march_radau.judge_iteration)(run, size, turn) for turn, size in enumerate(sizes, start=1)]
    assert told == [march_radau.OPEN] * (len(sizes) - 1) + [verdict]


@pytest.mark.parametrize("name", STIFF)
def test_derivatives_and_factors_are_kept(name: str) -> None:
    """Assert that Jacobians and factorisations are at most 1.5 times those of scipy, and the digits those of the test set."""
    run = stiff(name, 1e-6)
    jacobians, factorisations = PEER[name]
    assert run.attrs["run_jacobian_evaluations"] <= 1.5 * jacobians
    assert run.attrs["run_factorisations"] <= 1.5 * factorisations
    assert relative(name, run) < 2e-6


@pytest.mark.parametrize("name", STIFF)
def test_digits_of_the_test_set(name: str) -> None:
    """Assert 1e-12 at the end of HIRES and of Robertson's reactions at 1e11; near it for Van der Pol at mu = 1000.

    There what rounding adds is as large: 1e-12 to 6e-12 for tolerances next to each other.
    """
    assert relative(name, stiff(name, 1e-12)) < (1e-11 if name == "van_der_pol" else 1e-12)


def test_a_linear_chain_is_linearised_once() -> None:
    """Assert that 50 masses on springs need one Jacobian, and the factors of few step sizes."""
    problem = chain(50, 5.0)
    run = xd.simulate(problem.model(), method="radau_iia", rtol=1e-5, until=problem.end)
    assert run.attrs["run_jacobian_evaluations"] == 1
    assert run.attrs["run_factorisations"] < run.sizes["step"] / 5
    energy = run.total_energy.values if "total_energy" in run else run.kinetic_energy.values
    assert np.isfinite(energy).all()


def test_fixed_steps_are_solved_to_rounding() -> None:
    """Assert that a given step with kept derivatives leads where the same step, begun anew, leads."""
    model = STIFF["van_der_pol"].model()
    whole = xd.simulate(model, method="radau_iia", step=1.0, until=60.0)
    assert whole.attrs["run_jacobian_evaluations"] < 60
    for k in (1, 30, 58):
        start = {"x": f"{whole.x.values[k].item()!r} m", "v_x": f"{whole.v_x.values[k].item()!r} m s-1"}
        again = xd.simulate(model.replace(initial=start), method="radau_iia", step=1.0, until=1.0)
        assert again.x.values[1] == pytest.approx(whole.x.values[k + 1], rel=8 * EPS)
        assert again.v_x.values[1] == pytest.approx(whole.v_x.values[k + 1], rel=1e-12)


@pytest.mark.parametrize("more", [{}, {"jacobian": "differences"}], ids=["exact", "differences"])
def test_long_steps_follow_the_iterates(more: dict[str, str]) -> None:
    """Assert that steps of 100 s over Van der Pol's slow phase, where derivatives at the start do not serve, are made."""
    run = xd.simulate(STIFF["van_der_pol"].model(), method="radau_iia", step=100.0, until=700.0, **more)
    assert run.attrs["run_outcome"] == "completed"
    assert run.x.values[-1] == pytest.approx(1.342891731283, rel=1e-5)


def test_equations_without_a_solution_end_the_run() -> None:
    """Assert that a given step without a solution is an outcome and a rejected trial, and a chosen one is shortened."""
    states = {"y": {"unit": "1", "rate": "exp(y)/tau"}}
    model = xd.Model(name="bursting", parameters={"tau": "1 s"}, states=states, initial={"y": "0"})
    run = xd.simulate(model, method="radau_iia", step=3.0, until=9.0)
    assert run.attrs["run_outcome"] == "equations_unsolved"
    assert "Newton's method" in run.attrs["run_outcome_text"]
    assert (run.sizes["step"], run.sizes["trial"]) == (1, 1)
    run = xd.simulate(model, method="radau_iia", rtol=1e-6, step=3.0, until=0.9, max_step=10.0)
    assert run.attrs["run_outcome"] == "completed"
    reasons = run.trial_reason.attrs["flag_meanings"].split()
    assert "newton_solve" in {reasons[one] for one in run.trial_reason.values}
    assert run.y[-1].item() == pytest.approx(-np.log(0.1), rel=1e-5)


@pytest.mark.parametrize("name", STIFF)
def test_a_stiff_march_goes_on_from_its_bytes(name: str) -> None:
    """Assert that a march put into another run at any of its rows ends with the same bytes: what is kept is in them."""

    def march() -> March:
        model = STIFF[name].model()
        return March(model, settings_for(model, method="radau_iia", rtol=1e-4, atol=1e-8, until=STIFF[name].end))

    def marched(one: March, rows: int = 1 << 40) -> bytes:
        log = allocate(one.layout, 5000, sampled=int(one.run.plan[0].samples))
        log.follow(*(int(one.now[name]) for name in LOG_COUNTS))
        log.lend(one.run)
        engine().march(one.run, rows)
        return b"".join(part.tobytes() for part in changing_arrays(one.run).values())

    whole = march()
    expected = marched(whole)
    for row in np.linspace(1, int(whole.now.rows) - 2, 9).astype(int).tolist():
        first, second = march(), march()
        marched(first, row)
        put_back(second.run, changing_arrays(first.run))
        assert marched(second) == expected


PLAIN = """
import sys
import xdynamics as xd
from stiff_problems import STIFF
from cases.problems import MODELS
asked = {"method": "radau_iia", "rtol": 1e-4, "atol": 1e-7}
print(xd.content_digest(xd.simulate(STIFF["van_der_pol"].model(), until=400.0, **asked)))
print(xd.content_digest(xd.simulate(STIFF["hires"].model(), until=20.0, **asked)))
print(xd.content_digest(xd.simulate(STIFF["van_der_pol"].model(), method="radau_iia", step=100.0, until=300.0)))
print(xd.content_digest(xd.simulate(STIFF["hires"].model(), until=2.0, jacobian="differences", **asked)))
print(xd.content_digest(xd.simulate(xd.Model.from_toml(MODELS / "pendulum.toml"), until=2.2, **asked)))
run = xd.simulate(xd.Model.from_toml(MODELS / "pendulum.toml"), until=0.6, estimator="step_doubling", **asked)
print(xd.content_digest(run), xd.sample(run, [0.1, 0.5]).to_array().values.tobytes().hex())
"""


@pytest.mark.dear
def test_compiled_equals_plain_python() -> None:
    """Assert the same digests without numba: chosen and given steps, events, step doubling, dense output."""
    folders = [str(Path(__file__).parents[2]), str(Path(__file__).parents[2] / "benchmarks")]
    command = [sys.executable, "-c", f"import sys; sys.path += {folders!r}\n{PLAIN}"]
    told: list[Any] = [
        subprocess.run(command, env=os.environ | more, capture_output=True, text=True, check=True).stdout.split()
        for more in ({}, {"NUMBA_DISABLE_JIT": "1"})
    ]
    assert len(told[0]) == 7
    assert told[0] == told[1]


# -------------------------------------------------------------------------------------------------- by differences


def pushed(method: str, **asked: Any) -> xr.Dataset:
    """March a stiff damper whose force is written in Python, with a state beside it."""

    def damper(x: float, v_x: float, y: float) -> float:
        return -1000.0 * (v_x + x * x) - y

    statement = {
        "name": "damper",
        "coordinates": {"x": "m"},
        "parameters": {"m": "2 kg", "tau": "1 s"},
        "mass": {"x": "m"},
        "forces": {"damper": {"x": damper}},
        "states": {"y": {"unit": "1", "rate": "-y/tau"}},
        "initial": {"x": "1 m", "v_x": "0 m s-1", "y": "1"},
    }
    return xd.simulate(xd.Model(**statement), method=method, until=2.0, **asked)


def test_python_forces_by_differences() -> None:
    """Assert that forces in Python are marched by differences, recorded as such, and reach what an explicit method does."""
    run = pushed("radau_iia", rtol=1e-8, jacobian="differences")
    explicit = pushed("dop853", rtol=1e-10)
    assert run.attrs["run_outcome"] == "completed"
    assert run.attrs["solver_jacobian"] == "differences"
    assert run.sizes["step"] < explicit.sizes["step"] / 5
    for name in ("x", "v_x", "y"):
        assert run[name].values[-1] == pytest.approx(explicit[name].values[-1], abs=1e-8)


def test_differences_cost_what_they_save_otherwise() -> None:
    """Assert the same digits as with exact derivatives on HIRES, in as many steps, and the evaluations that it costs."""
    asked = {"rtol": 1e-6, "atol": 1e-10, "until": STIFF["hires"].end, "force_samples": "none", "method": "radau_iia"}
    exact, found = (
        xd.simulate(STIFF["hires"].model(), jacobian=jacobian, **asked) for jacobian in ("exact", "differences")
    )
    assert relative("hires", found) < 1e-6
    assert found.sizes["step"] == pytest.approx(exact.sizes["step"], rel=0.05)
    spent = 8 * found.attrs["run_jacobian_evaluations"]
    assert found.attrs["run_force_evaluations"] - spent == pytest.approx(exact.attrs["run_force_evaluations"], rel=0.05)


def test_a_run_by_differences_is_reproduced_and_sampled(tmp_path: Path) -> None:
    """Assert that an archive knows the choice."""
    asked = {"rtol": 1e-6, "until": 1.0, "jacobian": "differences", "method": "radau_iia"}
    xd.simulate(STIFF["van_der_pol"].model(), path=tmp_path / "run.nc", **asked)
    assert xd.reproduce(tmp_path / "run.nc").attrs["identical"] == 1
    assert np.isfinite(xd.sample(xd.open_run(tmp_path / "run.nc"), [0.3, 0.7]).x).all()


def test_refusals_name_the_choice() -> None:
    """Assert that forces in Python are refused with the remedy, and what the choice is not for, by name."""
    with pytest.raises(xd.InputError, match="radau_iia with jacobian = 'differences'"):
        pushed("radau_iia", rtol=1e-6)
    with pytest.raises(xd.InputError, match="forces written in Python"):
        pushed("implicit_midpoint", step=0.1, jacobian="differences")
    with pytest.raises(xd.InputError, match="jacobian = 'differences' is for radau_iia, and the method is 'midpoint'"):
        pushed("midpoint", step=0.1, jacobian="differences")
    with pytest.raises(xd.InputError, match="jacobian is 'guessed'; there are exact, differences"):
        xd.simulate(falling_off(), method="radau_iia", step=0.1, until=1.0, jacobian="guessed")


G = 9.80665


def discs(places: list[list[float]], side: str = "0*metre", width: float = 99.0, **initial: Any) -> xd.Model:
    """Discs of 1 kg and radius 0.1 m in a box, whose side walls are moved by `side`."""
    count = len(places)
    return xd.Model(
        name="discs in a box",
        dimensions={"disc": count, "axis": ["x", "y"]},
        relations={"pair": {"of": "disc"}},
        coordinates={"r": {"unit": "m", "dims": ["disc", "axis"]}},
        parameters={"g": f"{G} m s-2", "m": "1 kg", "radius": "0.1 m"}
        | {"across": {"dims": ["axis"], "value": [1, 0], "unit": "1"}}
        | {"width": {"dims": ["axis"], "value": [width, 99.0], "unit": "m"}},
        mass={"r": "m"},
        forces={"weight": {"potential": "m*g*sum(r*(1 - across), axis)"}},
        contacts={
            "walls": {"gap": f"r - radius - across*({side})", "restitution": 0.4},
            "far_walls": {"gap": f"width - radius - r + across*({side})", "restitution": 0.4},
            "discs": {"gap": "norm(second(r, pair) - first(r, pair), axis) - 2*radius", "restitution": 0.4},
        },
        initial={"r": {"unit": "m", "value": places}} | initial,
    )


def met(run: xr.Dataset) -> list[tuple[int, ...]]:
    """Return what happened to which link, in order."""
    names = ("event_detector", "event_kind", "event_pair", "event_disc", "event_axis")
    return list(zip(*(run[name].values.tolist() for name in names), strict=True))


@pytest.mark.parametrize("rtol", [1e-3, 1e-4])
def test_loose_tolerances_locate_impacts(rtol: float) -> None:
    """Assert that discs that fall hit the floor at sqrt(2 h/g), each located though the error test asks for little.

    Iterations that end as soon as the error test allows lead to a state that jumps as the step is shortened.
    """
    heights = 0.05 + 0.01 * np.arange(9)
    model = discs([[1.0 + k, 0.1 + height] for k, height in enumerate(heights.tolist())])
    run = xd.simulate(model, method="radau_iia", rtol=rtol, until="0.17 s")
    first = [float(run.event_time.values[run.event_disc.values == disc][0]) for disc in range(9)]
    assert run.attrs["run_outcome"] == "completed"
    assert np.abs(first - np.sqrt(2.0 * heights / G)).max() < 2e-12
    assert (run.attrs["solver_newton_tolerance"], run.attrs["solver_newton_most_iterations"]) == (
        SETTLED,
        MOST_SETTLING,
    )
    assert "closed contacts" in run.attrs["solver_equations_solved_by"]


@pytest.mark.parametrize("step", ["2 ms", "3 ms"])
def test_held_discs_have_the_size_of_what_holds_them(step: str) -> None:
    """Assert that a pyramid between walls that swing slowly is where an explicit method has it, in every step.

    Its velocities of 1e-7 m/s and less are what is left of g h, 2e-2 m/s, which closed links keep from the discs.
    """
    wide, high = 0.22, float(np.sqrt(0.04 - 0.11**2))
    places = [[0.1 + wide * (j + k / 2), 0.1 + high * k] for k in range(3) for j in range(3 - k)]
    speed = {"unit": "m s-1", "value": [[1e-4, 0.0]] * 6}
    model = discs(places, "(1e-4*metre)*sin(t/second)", 0.2 + 2 * wide, v_r=speed)
    settings: dict[str, Any] = {"step": step, "until": "0.24 s"}
    run, peer = (xd.simulate(model, method=method, **settings) for method in ("radau_iia", "dop853"))
    assert run.attrs["run_outcome"] == "completed"
    assert np.array_equal(run.time.values, peer.time.values)
    assert np.abs(run.r.values - peer.r.values).max() < 1e-13
    assert np.abs(run.v_r.values - peer.v_r.values).max() < 1e-13


@pytest.mark.dear
@pytest.mark.parametrize("steps", [{"step": "2 ms"}, {"step": "1 ms"}, {"rtol": 1e-4}])
def test_a_box_of_discs_comes_to_rest(steps: dict[str, Any]) -> None:
    """Assert that impacts are those of an explicit method one by one, that energy is balanced, and that discs rest."""
    model = xd.Model.from_toml(MODELS / "granular_box.toml")
    run = xd.simulate(model, method="radau_iia", until="1 s", **steps)
    peer = xd.simulate(model, method="dop853", step="2 ms", until="0.26 s")
    many = peer.sizes["event"]
    energy, lost = run.total_energy.values, float(run.event_energy_lost.sum())
    assert run.attrs["run_outcome"] == "completed"
    assert met(run)[:many] == met(peer)
    assert many > 100
    assert np.abs(run.event_time.values[:many] - peer.event_time.values).max() < 1e-9
    assert abs(energy[-1] - energy[0] + lost) < (1e-7 if "rtol" in steps else 1e-10) * energy[0]
    assert np.abs(run.v_r.values[-1]).max() < 1e-12

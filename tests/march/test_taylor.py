"""The method `taylor`: its order and steps, what its records say, what it refuses, what comes of its polynomial.

Random models with dimensions by Taylor series: loops side by side against the elements written out one by one.
Bodies with dimensions move alike in nanometres and femtoseconds, in metres, and in petametres and petaseconds.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray

import xdynamics as xd
from cases.array_programs import compiled, in_python
from cases.random_shapes import random_shapes
from xdynamics.kernels.jets import Expansion, Motion, expansion
from xdynamics.kernels.layout import Layout
from xdynamics.kernels.model_programs import expanded, forces_by_elements
from xdynamics.march.configuration import settings_for
from xdynamics.methods.taylor import MOST_ORDER, of_order, order_for
from xdynamics.model.motion import constants
from xdynamics.schema import SERIES_ARITHMETIC

MODELS = Path(__file__).parents[2] / "data" / "models"
W = 2.0  # rad/s
MASS = 1.7724538509055159  # near no quotient of small whole numbers: by 1.3 quotients are rounded with a bias of 1/26
GIVEN = {"method": "taylor", "force_samples": "none"}


@lru_cache
def oscillator(*, watched: bool = False) -> xd.Model:
    """A mass on a spring, perhaps watched for its passages."""
    return xd.Model(
        name="oscillator",
        coordinates={"x": "m"},
        parameters={"m": "1 kg", "k": "4 N m-1"},
        mass={"x": "m"},
        forces={"spring": {"potential": "k*x**2/2"}},
        initial={"x": "1 m", "v_x": "0 m s-1"},
        events={"passage": {"function": "x"}} if watched else {},
    )


@lru_cache
def model(name: str) -> xd.Model:
    """A model of the repository."""
    return xd.Model.from_toml(MODELS / f"{name}.toml")


def error(**asked: Any) -> float:
    """The largest error of an oscillator over ten seconds."""
    run = xd.simulate(oscillator(), **GIVEN, until=10.0, **asked)
    return float(np.abs(run.x - np.cos(W * run.time)).max())


def test_order_follows_from_the_tolerance() -> None:
    """Assert the rule of Jorba and Zou, what records say of it, and that a given order stays."""
    for rtol, order in ((1e-3, 5), (1e-6, 8), (1e-9, 12), (1e-12, 15), (1e-15, 19)):
        assert order_for(rtol) == order == int(np.ceil(1 - np.log(rtol) / 2))
    run = xd.simulate(oscillator(), **GIVEN, rtol=1e-9, until=1.0)
    assert run.attrs["solver_order"] == 12
    assert run.attrs["solver_order_choice"] == "ceil(1 - ln(rtol)/2)"
    assert "sum(h**i*q_i, i = 1 ... 12)" in run.attrs["solver_update_equations"]
    given = xd.simulate(oscillator(), **GIVEN, rtol=1e-9, order=20, until=1.0)
    assert (given.attrs["solver_order"], given.attrs["solver_order_choice"]) == (20, "given")
    assert given.sizes["step"] < run.sizes["step"]


def test_error_is_proportional_to_the_tolerance() -> None:
    """Assert that the error falls as a power of the tolerance near 1, whatever the orders."""
    rtols = 10.0 ** -np.arange(4, 13)
    slope = np.polyfit(np.log(rtols), np.log([error(rtol=rtol) for rtol in rtols]), 1)[0]
    assert 0.85 < slope < 1.15


@pytest.mark.parametrize("order", [2, 3, 7, 14])
def test_given_steps_have_the_order(order: int) -> None:
    """Assert that on a grid the error falls with the power of the order, and the estimate with one more."""
    steps = np.array([0.8, 0.4]) if order > 10 else np.array([0.1, 0.05])
    runs = [xd.simulate(oscillator(), **GIVEN, step=step, order=order, until=4.8) for step in steps]
    errors, estimates = (
        [f(run) for run in runs]
        for f in (lambda run: np.abs(run.x - np.cos(W * run.time)).max(), lambda run: np.abs(run.error_x).max())
    )
    powers = [np.log2(float(pair[0]) / float(pair[1])) for pair in (errors, estimates)]
    # an even series has an error of the next power in one of position and velocity
    assert order - 0.1 < powers[0] < order + 1.1
    assert order + 0.9 < powers[1] < order + 2.1


def test_long_runs_lose_digits_as_a_random_walk() -> None:
    """Assert that rounding of 20,000 steps stays near its square root: that of sums is carried along."""
    run = xd.simulate(oscillator(), **GIVEN, step=0.25, order=20, until=5000.0, log=["x"])
    assert np.abs(run.x - np.cos(W * run.time)).max() < 20 * np.sqrt(20_000) * 2.0**-53
    plain = xd.simulate(oscillator(), **GIVEN, step=0.25, order=20, until=5000.0, summation="plain", log=["x"])
    assert plain.attrs["solver_summation"] == "plain"
    assert run.attrs["solver_summation"] == "compensated"


@pytest.mark.dear
def test_rounding_of_a_million_steps_grows_as_the_square_root_of_their_number() -> None:
    """Assert Brouwer's law for eight frequencies, and that after 10**6 steps 14 digits are left."""
    names = [f"x{i}" for i in range(8)]
    stiffnesses = {f"k{i}": f"{1.0 + 0.137 * i:.3f} N m-1" for i in range(8)}
    springs = xd.Model(
        name="springs",
        coordinates=dict.fromkeys(names, "m"),
        parameters={"m": f"{MASS!r} kg", **stiffnesses},
        mass=dict.fromkeys(names, "m"),
        forces={"springs": {name: f"-k{i}*{name}" for i, name in enumerate(names)}},
        initial={**dict.fromkeys(names, "1 m"), **{f"v_{name}": "0 m/s" for name in names}},
    )
    asked: dict[str, Any] = {"order": 20, "step": 0.25, "until": 250_000.0, "keep_every": 500, "estimator": "none"}
    run = xd.simulate(springs, method="taylor", force_samples="none", **asked)
    assert run.attrs["run_accepted_steps"] == 1_000_000
    errors = []
    with mpmath.workdps(30):
        for name, stiffness in zip(names, stiffnesses.values(), strict=True):
            w = mpmath.sqrt(mpmath.mpf(float(stiffness.split()[0])) / mpmath.mpf(MASS))  # as the march has them
            rows = zip(run.time.values.tolist(), run[name].values.tolist(), strict=True)
            errors.append([float(mpmath.cos(w * t) - x) for t, x in rows])
    steps, error = run.time.values / 0.25, np.sqrt(np.mean(np.square(errors), axis=0))
    late = steps > 1000
    exponent = np.polyfit(np.log(steps[late]), np.log(error[late]), 1)[0]
    assert 0.4 < exponent < 0.6  # 0.49; 1 where roundings have a bias
    assert error[-1] < 0.2 * np.sqrt(1e6) * 2.0**-53  # 0.09: sums are compensated


def test_a_step_that_is_too_long_is_a_rejected_trial() -> None:
    """Assert that a given first step is judged by the estimate, and repeated from the same series."""
    run = xd.simulate(oscillator(), **GIVEN, rtol=1e-9, step=3.0, until=5.0)
    assert run.sizes["trial"] >= 1
    assert run.trial_step_size[0] == 3.0
    assert run.trial_error_norm[0] > 1.0
    assert run.trial_reason[0] == run.trial_reason.attrs["flag_meanings"].split().index("error_test")
    assert (run.error_norm <= 1.0).all()
    assert np.abs(run.x - np.cos(W * run.time)).max() < 1e-8


def test_its_polynomial_is_its_dense_output() -> None:
    """Assert that between states the polynomial is the step that is shortened, to rounding."""
    run = xd.simulate(oscillator(), **GIVEN, rtol=1e-12, until=5.0)
    times = np.linspace(0.0, 5.0, 41)
    for rule in ("reintegrate", "interpolant"):
        inside = xd.sample(run, times, rule=rule)
        assert np.abs(inside.x.values - np.cos(W * times)).max() < 1e-12


def test_events_are_isolated_on_the_polynomial() -> None:
    """Assert that passages of long steps are found with few substeps, and all of them."""
    asked = {**GIVEN, "rtol": 1e-12, "order": 30, "until": 20.0}
    run = xd.simulate(oscillator(watched=True), **asked)
    assert run.step_size.max() > 1.5  # several passages in a step
    exact = (np.arange(run.sizes["event"]) + 0.5) * np.pi / W
    assert run.sizes["event"] == int(20.0 * W / np.pi + 0.5)
    assert np.abs(run.event_time - exact).max() < 1e-12
    assert run.event_substeps.mean() < 12


@pytest.mark.every(3)
@pytest.mark.parametrize(
    "name", ["pendulum", "double_pendulum", "staged_rocket", "stick_slip_belt", "bouncing_ball", "relay_oscillator"]
)
def test_models_end_where_another_method_ends(name: str) -> None:
    """Assert that drives, regimes, full masses, held contacts and friction come out as by another method of high order."""
    ends = [
        xd.simulate(model(name), method=method, rtol=1e-10, force_samples="none") for method in ("taylor", "dop853")
    ]
    assert ends[0].attrs["run_outcome"] == ends[1].attrs["run_outcome"]
    assert ends[0].sizes.get("event", 0) == ends[1].sizes.get("event", 0)
    for coordinate in model(name).elements.statement.coordinates:
        first, second = (run[coordinate].values for run in ends)
        assert first[-1] == pytest.approx(second[-1], abs=1e-7 * max(np.abs(second).max(), 1e-9))


def test_archives_reproduce_and_runs_go_on(tmp_path: Path) -> None:
    """Assert that a record is repeated to the bit from its file, and that an extended run is the longer one."""
    asked = {"method": "taylor", "rtol": 1e-11}
    run = xd.simulate(model("pendulum"), **asked, until=4.0)
    xd.save(run, tmp_path / "run.nc")
    assert xd.reproduce(tmp_path / "run.nc").attrs["identical"] == 1
    fixed = xd.simulate(oscillator(), method="taylor", order=13, step="0.1 s", until="2 s")
    xd.save(fixed, tmp_path / "fixed.nc")
    assert xd.reproduce(tmp_path / "fixed.nc").attrs["identical"] == 1
    longer = xd.extend(fixed, until="3 s")
    whole = xd.simulate(oscillator(), method="taylor", order=13, step="0.1 s", until="3 s")
    assert longer.x.values.tobytes() == whole.x.values.tobytes()


def test_archives_of_other_arithmetic_are_told_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a record whose coefficients were rounded in another way is not the same, and why is said."""
    with monkeypatch.context() as former:
        former.setattr("xdynamics.march.equation_solvers.FUSED", "products and sums rounded one by one")
        run = xd.simulate(oscillator(), method="taylor", order=13, step="0.1 s", until="2 s")
        xd.save(run, tmp_path / "former.nc")
    again = xd.reproduce(tmp_path / "former.nc")
    assert again.attrs["identical"] == 0
    assert "the archive has Taylor series by 'products and sums rounded one by one', here" in again.attrs["arithmetic"]


@pytest.mark.parametrize(
    ("name", "order", "digest"), [("pendulum", 32, "c917008331bf"), ("kepler", 24, "f0c9fe6e5d3c")]
)
def test_programs_of_31_digits_stay_those_of_archives(name: str, order: int, digest: str) -> None:
    """Assert that what is written out, and the order of sums in loops, are those that archives of 1a49bc80 have."""
    asked: dict[str, Any] = {"order": order, "step": 0.01, "until": 0.02, "precision": "double_double"}
    assert xd.simulate(model(name), method="taylor", **asked).attrs["force_digest"].startswith(digest)


def test_sums_of_elements_in_loops_are_another_arithmetic() -> None:
    """Assert that the record of a chain tells its sums from those of a model without dimensions."""
    chain, single = (
        xd.simulate(of, method="taylor", order=6, step=0.01, until=0.05, log="states").attrs[SERIES_ARITHMETIC]
        for of in (model("toda_chain"), oscillator())
    )
    assert "the terms j and k - j of a sum are added to two sums" in chain
    assert chain.startswith(f"{single}; in loops over elements")


def test_sweeps_have_states_inside_steps() -> None:
    """Assert that members that march side by side are sampled as single runs are, to the bit."""
    stiffnesses, times = [f"{k:.3f} N m-1" for k in np.linspace(3.0, 5.0, 70)], ["0.37 s", "1.9 s"]
    asked: dict[str, Any] = {"method": "taylor", "rtol": 1e-10, "until": "2 s"}
    grid = xd.sweep(oscillator(), axes={"k": stiffnesses}, keep=["end", "x"], times=times, **asked)
    for i in (0, 41):
        run = xd.simulate(oscillator().replace(parameters={"k": stiffnesses[i]}), **asked)
        assert grid.x.values[i].tobytes() == xd.sample(run, times).x.values.tobytes()
        assert float(grid.end_x[i]) == float(run.x[-1])


def test_what_it_refuses() -> None:
    """Assert that orders of other methods, too low and too high ones, and contacts of many links are refused in words."""
    asked = {"until": 1.0, "step": 0.1}
    with pytest.raises(xd.InputError, match="order is 5, and 'rk4' is of order 4; order is for taylor"):
        xd.simulate(oscillator(), method="rk4", order=5, **asked)
    with pytest.raises(
        xd.InputError, match="order is 1, needs to be at least 2: a step is chosen by the last two terms"
    ):
        xd.simulate(oscillator(), method="taylor", order=1, **asked)
    with pytest.raises(xd.InputError, match=f"order is 200, needs to be at most {MOST_ORDER}"):
        xd.simulate(oscillator(), method="taylor", order=200, **asked)
    with pytest.raises(xd.InputError, match=r"order is 2\.5, needs a whole number"):
        xd.simulate(oscillator(), method="taylor", order=2.5, **asked)
    with pytest.raises(xd.InputError, match="no series of the forces of contacts of many links"):
        xd.simulate(model("granular_box"), method="taylor", rtol=1e-6, until=0.01)


def test_equations_are_those_of_the_order() -> None:
    """Assert that a method of an order says so in every part."""
    method = of_order(17)
    assert (method.order, method.estimate_order, method.interpolant.degree) == (17, 17, 17)
    assert method.equations().count("i = 1 ... 17") == 4
    assert method.estimate.count("/18") == 3


def test_forces_of_several_dimensions_have_their_series() -> None:
    """Assert that bodies of two dimensions, whose forces are summed in loops of their own, swing by the exponential."""
    n, k = (6, 7), 4.0  # N/m, from each of the six to the mean of the seven, and to the origin
    two = xd.Model.from_text("""
name = "two groups"
[dimensions]
one = 6
peer = 7
[coordinates]
x = { unit = "m", dims = ["one"] }
y = { unit = "m", dims = ["peer"] }
[parameters]
k = "4 N m-1"
[mass]
x = "1*kilogram"
y = "2*kilogram"
[forces.between]
x = "-k*(x - mean(y, peer))"
y = "-k*(y - mean(x, one))"
[forces.back]
x = "-k*x"
[initial]
x = "0.1*metre*index(one)"
y = "0.2*metre - 0.1*metre*index(peer)**2"
""")
    run = xd.simulate(two, **GIVEN, rtol=1e-12, until=3.0)
    matrix = np.diag([-2 * k] * n[0] + [-k / 2] * n[1])
    matrix[: n[0], n[0] :], matrix[n[0] :, : n[0]] = k / n[1], k / 2 / n[0]
    start = np.concatenate([0.1 * np.arange(6.0), 0.2 - 0.1 * np.arange(7.0) ** 2])
    values, vectors = np.linalg.eig(matrix)
    end = vectors @ (np.cos(np.sqrt(-values) * 3.0) * np.linalg.solve(vectors, start))
    np.testing.assert_allclose(np.concatenate([run.x[-1], run.y[-1]]), end, rtol=0, atol=1e-10)
    assert run.sizes["step"] < 50


DEGREE = 5


def coefficients(found: Expansion, layout: Layout, *, plain: bool = False, abreast: int = 1) -> NDArray[np.float64]:
    """The coefficients of a model's state at its start."""
    given, n = constants(layout.model), layout.coordinates.size
    y, w = np.zeros(layout.record.size), np.zeros(found.memory)
    for begin, name in ((0, "place"), (n, "speed")):
        y[begin : begin + n] = [value for key, value in given.items() if key.startswith(name)]
    call = in_python(found.program) if plain else compiled(found.program, abreast=abreast)
    call(y=y, w=w, p=np.array([*given.values()]), at=np.zeros(8))
    return w[: (DEGREE + 1) * layout.used.size].reshape(DEGREE + 1, -1)


@pytest.mark.cases(141)
def test_loops_have_the_series_of_elements_one_by_one(case: int) -> None:
    """Assert the same to rounding, and with 4, 8 or 16 rows at once what plain Python has to the bit."""
    model = xd.Model.from_text(random_shapes(case))
    layout = settings_for(model, method="taylor", step="1 s", until="1 s").layout(model)
    found, motion = expanded(layout, DEGREE), Motion(layout.coordinates.size, layout.states.size)
    single = expansion(forces_by_elements(layout), motion, DEGREE, written_out=False)
    loops, wanted = (coefficients(each, layout, plain=True) for each in (found, single))
    assert np.isfinite(wanted).all()
    assert (np.abs(loops - wanted) <= 1e-11 * np.abs(wanted).max(axis=1, keepdims=True)).all()
    assert coefficients(found, layout, abreast=(4, 8, 16)[case % 3]).tobytes() == loops.tobytes()


UNITS = {"one": ("m", "s"), "small": ("nm", "fs"), "large": ("Pm", "Ps")}


def discs(length: str, time: str) -> xd.Model:
    """Three discs between four walls."""
    gap = "norm(second(r, pair) - first(r, pair), axis) - 2*R"
    return xd.Model(
        name="discs",
        dimensions={"disc": ["a", "b", "c"], "axis": ["x", "y"]},
        relations={"pair": {"of": "disc"}},
        coordinates={"r": {"unit": length, "dims": ["disc", "axis"]}},
        parameters={"m": "1 kg", "R": f"0.1 {length}", "W": f"1 {length}"},
        mass={"r": "m"},
        contacts={
            "low": {"gap": "r - R", "restitution": 0.9},
            "high": {"gap": "W - R - r", "restitution": 0.9},
            "discs": {"gap": gap, "restitution": 1},
        },
        initial={
            "t": f"0 {time}",
            "r": {"unit": length, "value": [[0.2, 0.2], [0.5, 0.5], [0.8, 0.2]]},
            "v_r": {"unit": f"{length} {time}-1", "value": [[0.9, 0.35], [-0.2, 0.15], [-0.6, 0.5]]},
        },
    )


def ring(length: str, time: str) -> xd.Model:
    """A ring of masses on hardening springs, each with an event where it passes its rest."""
    stretch = "(second(u, bond) - first(u, bond))"
    return xd.Model(
        name="ring",
        dimensions={"site": 8},
        relations={"bond": {"of": "site", "neighbours": 1, "ring": True}},
        coordinates={"u": {"unit": length, "dims": ["site"]}},
        parameters={"m": "1 kg", "k": f"1 kg {time}-2", "A": f"0.1 {length}"},
        mass={"u": "m"},
        forces={"spring": {"over": "bond", "potential": f"0.5*k*{stretch}**2*(1 + ({stretch}/A)**2)"}},
        events={"rest": {"function": "u", "direction": "rising"}},
        initial={
            "t": f"0 {time}",
            "u": "A*sin(2*pi*index(site)/size(site) + 1)",
            "v_u": {"unit": f"{length} {time}-1", "value": 0},
        },
    )


@lru_cache
def marched(make: str, units: str) -> xr.Dataset:
    """Return a run of two units of time, by what is default but for the relative tolerance."""
    length, time = UNITS[units]
    model = {"discs": discs, "ring": ring}[make](length, time)
    return xd.simulate(model, method="dop853", rtol=1e-9, until=f"{2 if make == 'discs' else 10} {time}")


@pytest.mark.parametrize("units", [name for name in UNITS if name != "one"])
@pytest.mark.parametrize(("make", "name", "events"), [("discs", "r", 8), ("ring", "u", 12)])
def test_a_motion_is_the_same_in_any_units(make: str, name: str, events: int, units: str) -> None:
    """Assert the rows, the events, their times, and the last state in the model's units as in metres and seconds."""
    run, one = marched(make, units), marched(make, "one")
    assert run.attrs["run_outcome"] == "completed"
    assert run.sizes["step"] == one.sizes["step"]
    assert run.sizes["event"] == one.sizes["event"] == events
    second = {"small": 1e-15, "large": 1e15}[units]
    assert float(run.time[-1]) == pytest.approx(second * float(one.time[-1]), rel=1e-15)
    assert np.abs(run[name].values[-1] - one[name].values[-1]).max() < 1e-13
    assert np.abs(run.event_time.values / second - one.event_time.values).max() < 1e-11

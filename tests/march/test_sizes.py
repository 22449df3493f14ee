"""Tolerances that follow the size of each variable: the same steps in all units, from rest and from zero, in lanes and again.

The same answer in any units and scales; what the tolerances did not control is said.
"""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner

import xdynamics as xd
from cases.problems import EPS
from xdynamics.cli import main
from xdynamics.elementary.numbers import maximum_of_two, minimum_of_two
from xdynamics.march import tolerance_sizes
from xdynamics.march.configuration import settings_for
from xdynamics.march.ensemble import march_many
from xdynamics.schema import ATOL_FOLLOWS
from xdynamics.units import parse_unit

UNITS = {
    "m": ("m", "nm", "km", "astronomical_unit", "Gm", "um"),
    "s": ("s", "ms", "us", "h", "d"),
    "kg": ("kg", "g", "mg", "t"),
}
METHODS = ("dop853", "dormand_prince", "bogacki_shampine", "radau_iia", "rk4", "dprkn6")


class Units:
    """Quantities of a problem whose length, time and mass are so large, in units drawn for each."""

    def __init__(self, rng: np.random.Generator | None) -> None:
        self.rng = rng
        self.large = {unit: 10.0 ** rng.uniform(-9, 9) if rng else 1.0 for unit in UNITS}

    def unit(self, **powers: int) -> str:
        """Draw a unit."""
        chosen = {name: self.rng.choice(names) if self.rng else name for name, names in UNITS.items()}
        return (
            " ".join(f"{chosen[name]}{'' if power == 1 else power}" for name, power in powers.items() if power) or "1"
        )

    def __call__(self, value: float, **powers: int) -> str:
        """Write a quantity."""
        unit = self.unit(**powers)
        factor = float(parse_unit(unit).factor)
        for name, power in powers.items():
            value *= self.large[name] ** power
        return f"{float(value) / factor!r} {unit}"


def oscillator(rng: np.random.Generator, of: Units) -> xd.Model:
    """A damped oscillator with a cubic spring, from rest."""
    k, c, b = rng.uniform(0.5, 4, 3)
    return xd.Model(
        name="oscillator",
        coordinates={"x": {"unit": of.unit(m=1)}},
        mass={"x": "m"},
        parameters={
            "m": of(1.0, kg=1),
            "k": of(k, kg=1, s=-2),
            "c": of(0.1 * c, kg=1, s=-1),
            "b": of(b, kg=1, m=-2, s=-2),
        },
        forces={"all": {"x": "-k*x - c*v_x - b*x**3"}},
        initial={"x": of(rng.uniform(0.3, 2), m=1), "v_x": of(0.0, m=1, s=-1)},
    )


def orbit(rng: np.random.Generator, of: Units) -> xd.Model:
    """A body on an ellipse, from the end of an axis."""
    return xd.Model(
        name="orbit",
        coordinates={"x": {"unit": of.unit(m=1)}, "y": {"unit": of.unit(m=1)}},
        mass={"x": "m", "y": "m"},
        parameters={"m": of(1.0, kg=1), "mu": of(1.0, m=3, s=-2)},
        forces={"gravity": {"potential": "-m*mu/sqrt(x**2 + y**2)"}},
        initial={
            "x": of(1.0, m=1),
            "y": of(0.0, m=1),
            "v_x": of(0.0, m=1, s=-1),
            "v_y": of(rng.uniform(0.7, 1.2), m=1, s=-1),
        },
    )


def thrown(rng: np.random.Generator, of: Units) -> xd.Model:
    """A ball thrown from zero, with drag."""
    speed = of(rng.uniform(1, 5), m=1, s=-1)
    return xd.Model(
        name="ball",
        coordinates={"x": {"unit": of.unit(m=1)}, "y": {"unit": of.unit(m=1)}},
        mass={"x": "m", "y": "m"},
        parameters={"m": of(1.0, kg=1), "g": of(1.0, m=1, s=-2), "c": of(rng.uniform(0.01, 0.3), kg=1, m=-1)},
        forces={"weight": {"y": "-m*g"}, "drag": {"x": "-c*v_x*hypot(v_x, v_y)", "y": "-c*v_y*hypot(v_x, v_y)"}},
        initial={"x": of(0.0, m=1), "y": of(0.0, m=1), "v_x": speed, "v_y": of(3.0, m=1, s=-1)},
    )


def cart(rng: np.random.Generator, of: Units) -> xd.Model:
    """A cart at zero that a pendulum drives, an angle beside a length, and what the motion heats."""
    return xd.Model(
        name="cart",
        coordinates={"x": {"unit": of.unit(m=1)}, "theta": {"unit": "rad"}},
        mass={"x": "m", "theta": "m*l**2"},
        parameters={
            "m": of(1.0, kg=1),
            "l": of(1.0, m=1),
            "k": of(rng.uniform(0.5, 3), kg=1, s=-2),
            "g": of(1.0, m=1, s=-2),
        },
        forces={
            "spring": {"x": "-k*x"},
            "weight": {"theta": "-m*g*l*sin(theta)"},
            "drive": {"x": "0.3*k*l*sin(theta)"},
        },
        initial={"x": of(0.0, m=1), "theta": "0.7 rad", "v_x": of(0.0, m=1, s=-1), "v_theta": of(0.0, s=-1)},
    )


def circuit(rng: np.random.Generator, of: Units) -> xd.Model:
    """A tank that fills from zero, and a second one behind it: first-order states alone."""
    return xd.Model(
        name="tanks",
        parameters={
            "tau": of(1.0, s=1),
            "flow": of(rng.uniform(0.5, 2), kg=1, s=-1),
            "share": f"{rng.uniform(0.1, 0.9)} 1",
        },
        states={
            "a": {"unit": of.unit(kg=1), "rate": "flow - a/tau"},
            "b": {"unit": of.unit(kg=1), "rate": "a/tau - share*b/tau"},
        },
        initial={"a": of(0.0, kg=1), "b": of(0.0, kg=1)},
    )


def chain(rng: np.random.Generator, of: Units) -> xd.Model:
    """A row of masses, of which the first alone is away from its place."""
    n = int(rng.integers(3, 9))
    names = [f"u{i}" for i in range(n)]
    pulls = {
        name: "-k*(2*" + name + "".join(f" - {names[j]}" for j in (i - 1, i + 1) if 0 <= j < n) + ")"
        for i, name in enumerate(names)
    }
    starts = {name: of(1.0 if i == 0 else 0.0, m=1) for i, name in enumerate(names)} | {
        f"v_{name}": of(0.0, m=1, s=-1) for name in names
    }
    return xd.Model(
        name="chain",
        coordinates={name: {"unit": of.unit(m=1)} for name in names},
        mass=dict.fromkeys(names, "m"),
        parameters={"m": of(1.0, kg=1), "k": of(1.0, kg=1, s=-2)},
        forces={"springs": pulls},
        initial=starts,
    )


PROBLEMS = (oscillator, orbit, thrown, cart, circuit, chain)


def problem(case: int) -> tuple[type, str, float]:
    """Return a problem, a method that takes it, and a tolerance."""
    rng = np.random.default_rng(case)
    made = PROBLEMS[case % len(PROBLEMS)]
    methods = [method for method in METHODS if not (method == "dprkn6" and made in (oscillator, thrown, circuit))]
    return made, str(rng.choice(methods)), 10.0 ** rng.uniform(-8, -4)


@pytest.mark.every(3)
@pytest.mark.cases(600)
def test_steps_are_the_same_in_all_units(case: int) -> None:
    """Assert that a problem has the same steps, to rounding, however large it is and whatever its units."""
    made, method, rtol = problem(case)
    own = Units(np.random.default_rng(case + 10_000))
    runs = [
        xd.simulate(
            made(np.random.default_rng(case), of), method=method, rtol=rtol, until=of(5.0, s=1), force_samples="none"
        )
        for of in (Units(None), own)
    ]
    first, second = runs
    assert {run.attrs["run_outcome"] for run in runs} == {"completed"}
    chosen = [float(run.attrs["solver_first_step"]) for run in runs]
    assert chosen[1] / own.large["s"] == pytest.approx(chosen[0], rel=1e-8)
    if method == "radau_iia":  # whose iterations take one turn more or less where rounding decides
        assert abs(first.sizes["step"] - second.sizes["step"]) <= 2
        return
    assert dict(first.sizes) == dict(second.sizes)
    # an estimate of 1e-8 of a value has eight digits that are no rounding
    np.testing.assert_allclose(second.time.values / own.large["s"], first.time.values, rtol=0, atol=5e-4)


@pytest.mark.cases(200)
def test_what_was_used_is_recorded(case: int) -> None:
    """Assert that the last tolerance of every variable is the rule's, made again from the rows alone."""
    made, method, rtol = problem(case)
    of = Units(np.random.default_rng(case))
    run = xd.simulate(
        made(np.random.default_rng(case), of), method=method, rtol=rtol, until=of(5.0, s=1), force_samples="none"
    )
    used, kinds = float(run.attrs["solver_rtol_used"]), {}
    for name, variable in run.data_vars.items():
        if variable.attrs.get("role") in ("coordinate", "velocity", "state"):
            unit = parse_unit(variable.attrs["units"])
            largest = float(abs(variable).max()) * float(unit.factor)
            kinds.setdefault((variable.attrs["role"], str(unit.dimension)), []).append((name, largest))
    for found in kinds.values():
        top = max(largest for _, largest in found)
        for name, largest in found:
            about = run[name].attrs
            assert about["atol_rule"] == ATOL_FOLLOWS
            assert about["atol"] * float(parse_unit(about["units"]).factor) == pytest.approx(
                about["atol_si"], rel=1e-12
            )
            expected = max(used * largest, max(1e-6 * used, 10 * np.finfo(float).eps) * top)
            assert about["atol_si"] == pytest.approx(expected, rel=1e-9)


def spread_out(n: int, time: float) -> np.ndarray:
    """Return where the masses of `chain` are, by their modes."""
    squares, shapes = np.linalg.eigh(2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    return np.asarray(shapes @ (np.cos(np.sqrt(squares) * time) * shapes[0]))


@pytest.mark.cases(100)
@pytest.mark.filterwarnings("ignore::xdynamics.faults.AccuracyWarning")
def test_defaults_are_as_accurate_in_every_unit(case: int) -> None:
    """Assert that the error stays in proportion to the tolerance, of the closed form of a chain that starts at zero, in any unit."""
    rng = np.random.default_rng(case)
    of, rtol = Units(np.random.default_rng(case + 1)), 10.0 ** rng.uniform(-11, -4)
    method = str(rng.choice(("dop853", "dormand_prince", "dprkn6", "radau_iia")))
    model = chain(rng, of)
    run = xd.simulate(model, method=method, rtol=rtol, until=of(10.0, s=1), force_samples="none")
    exact = spread_out(len(model.elements.statement.coordinates), 10.0)
    found = [
        float(run[name][-1]) * float(coordinate.unit.factor) / of.large["m"]
        for name, coordinate in model.elements.statement.coordinates.items()
    ]
    assert np.abs(found - exact).max() < 100 * rtol + 1e-13
    # the last mass has moved a millionth of what the first one did, say, and is known to a part of that
    assert abs(found[-1] - exact[-1]) < 1e3 * rtol * max(abs(exact[-1]), 1e-3) + 1e-13


RESTING = {
    "a pendulum upside down": ("-9.8*sin(x)*newton", np.pi, 0.0),
    "a spring that is not stretched": ("-x*newton/metre", 0.0, 0.0),
    "no force at all": ("0*newton", 0.0, 1.0),
    "a body dropped at zero": ("-9.8*newton", 0.0, 0.0),
    "drag from rest": ("9.8*newton - v_x**2*0.1*kilogram/metre", 0.0, 0.0),
    "a force that begins": ("9.8*newton*max(0, t/second - 1)", 0.0, 0.0),
    "a force that grows from an unstable place": ("x*newton/metre", 1e-300, 0.0),
    "a root at its end": ("newton*sqrt(x/metre)", 0.0, 0.0),
}


@pytest.mark.every(11)
@pytest.mark.parametrize("rtol", [1e-4, 1e-8, 1e-12])
@pytest.mark.parametrize("method", ["dop853", "heun", "radau_iia"])
@pytest.mark.parametrize("name", RESTING)
def test_starts_without_a_size(name: str, method: str, rtol: float) -> None:
    """Assert that what starts at rest, at zero, or at what rounding leaves of zero comes to its end in few steps."""
    text, x, v = RESTING[name]
    if (method == "heun" and rtol < 1e-4) or (method == "radau_iia" and "sqrt" in text):
        return  # its order is too low; it has no derivative there
    angle = "sin" in text
    model = xd.Model(
        name=name,
        coordinates={"x": "rad" if angle else "m"},
        parameters={"m": "1 kg m2" if angle else "1 kg"},
        mass={"x": "m"},
        forces={"all": {"x": text.replace("newton", "newton*metre") if angle else text}},
        initial={"x": f"{x!r} {'rad' if angle else 'm'}", "v_x": f"{v!r} {'s-1' if angle else 'm s-1'}"},
    )
    run = xd.simulate(model, method=method, rtol=rtol, until="5 s", max_steps=40_000, force_samples="none")
    assert run.attrs["run_outcome"] == "completed", run.attrs["run_outcome_text"]


@pytest.mark.cases(60)
def test_lanes_follow_as_single_runs_do(case: int) -> None:
    """Assert that runs side by side, whose tolerances follow their variables, have the bits of runs alone."""
    rng = np.random.default_rng(case)
    made = (oscillator, orbit, thrown, cart, circuit, chain)[case % 6]
    model, method = made(rng, Units(None)), ("dop853", "bogacki_shampine", "heun")[case % 3]
    name = next(iter((*model.elements.statement.coordinates, *model.elements.statement.states)))
    starts, rtols = rng.uniform(-1, 1, 24) * (rng.random(24) < 0.8) + 1e-3, 10.0 ** rng.uniform(-9, -4, 24)
    settings = settings_for(model, method=method, rtol=1e-6, until="3 s", force_samples="none")
    given = {"initial": {name: starts}, "rtols": rtols}
    abreast = march_many(model, settings, **given, lanes=8)
    single = march_many(model, settings, **given, lanes=1)
    assert abreast.ends["rows"].tolist() == single.ends["rows"].tolist()
    assert np.array_equal(abreast.state, single.state)
    assert np.array_equal(abreast.largest, single.largest)
    for i in (0, 23):
        start = {name: f"{float(starts[i])!r} {'m' if model.coordinates else 'kg'}"}
        run = xd.simulate(
            model.replace(initial=start), method=method, rtol=float(rtols[i]), until="3 s", force_samples="none"
        )
        assert run.sizes["step"] == single.ends["rows"][i]
        assert float(run[name][-1]) == single.state[i, single.layout.used.index(name)]


def same(one: xr.Dataset, other: xr.Dataset) -> None:
    """Hold two records to one digest."""
    assert xd.content_digest(one) == xd.content_digest(other)


@pytest.mark.every(11)
@pytest.mark.parametrize("atol", [None, {"x": "1 nm"}, 1e-9])
@pytest.mark.parametrize("method", ["dop853", "rk4", "radau_iia"])
def test_archives_march_again_with_what_was_used(tmp_path: Path, method: str, atol: object) -> None:
    """Assert that followed, mixed and given tolerances are reproduced, streamed, extended, replayed and tightened."""
    model = orbit(np.random.default_rng(1), Units(None))
    asked = {"method": method, "rtol": 1e-7, "atol": atol}
    run = xd.simulate(model, **asked, until="4 s")
    follows = [name for name in ("x", "y", "v_x", "v_y") if "atol_rule" in run[name].attrs]
    assert follows == ([] if atol == 1e-9 else ["x", "y", "v_x", "v_y"][atol is not None :])
    assert ("solver_atol_rule" in run.attrs) == bool(follows)
    streamed = xd.simulate(model, **asked, until="4 s", path=tmp_path / "run.nc")
    same(streamed, run)
    assert xd.reproduce(tmp_path / "run.nc").attrs["identical"] == 1
    same(xd.extend(run, until="6 s"), xd.simulate(model, **asked, until="6 s", nodes=["4 s"]))
    part = run.drop_vars("x")
    xd.save(part, tmp_path / "part.nc")
    assert xd.reproduce(tmp_path / "part.nc").attrs["identical"] == 1
    beside = xd.companion(run, ["4 s"])
    assert 0.0 < abs(float(beside.global_error_x[0])) < 1e-3
    if method != "radau_iia":
        replayed = xd.simulate(model, **asked, step=run.step_size.values[1:], until="4 s")
        assert np.array_equal(replayed.x, run.x)
        assert np.array_equal(replayed.error_norm, run.error_norm, equal_nan=True)
        assert replayed.y.attrs["atol_si"] == run.y.attrs["atol_si"]


def test_errors_go_with_the_tolerances() -> None:
    """Assert that a refinement over tolerances of a model in metres that moves by nanometres is in proportion."""
    of = Units(None)
    of.large["m"] = 1e-9
    study = xd.refine(
        orbit(np.random.default_rng(2), of), method="dop853", rtols=[1e-5, 1e-6, 1e-7, 1e-8], until="5 s", at=["5 s"]
    )
    assert float(abs(study.difference_x[-2, 0])) < 1e-9 * 1e-5


# ------------------------------------------------------------------------------------------------------------ the parts

RTOL = 1e-4


@pytest.fixture
def plain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Phases as Python has them, and forces that are a matrix: what is compiled has no way in from Python."""
    printed = getattr(tolerance_sizes._tolerance, "py_func", tolerance_sizes._tolerance)
    for name, function in (("_greatest", maximum_of_two), ("_least", minimum_of_two)):
        monkeypatch.setitem(printed.__globals__, name, function)
    for name in (
        "_tolerance",
        "tops_of",
        "natural_sizes",
        "time_at",
        "estimate_fastest_rate",
        "recurrence_root",
        "state_slope",
        "variable_size",
        "own_size",
        "first_direction",
        "direction_after",
    ):
        function = getattr(tolerance_sizes, name)
        monkeypatch.setattr(tolerance_sizes, name, getattr(function, "py_func", function))

    def evaluate(run: Any, t: float, state: np.ndarray) -> None:
        assert t == 3.0
        used = run.plan[0].used
        state[used:] = run.matrix @ state[:used]

    monkeypatch.setattr(tolerance_sizes, "evaluate_forces", evaluate)


def linear(start: list[float], matrix: list[list[float]], coordinates: int, kinds: list[int]) -> Any:
    """A march that is about to begin: accelerations and rates are a matrix times coordinates, velocities and states."""
    used, whole = len(start), np.array(matrix, float)
    plan = SimpleNamespace(coordinates=coordinates, used=used, rtol=RTOL, floor=1e-6 * RTOL, rest=0.5, follows=1)
    run = SimpleNamespace(
        plan=[plan],
        now=[SimpleNamespace(t=3.0)],
        matrix=whole,
        kinds=np.array(kinds),
        tops=np.zeros(2 * (max(kinds) + 1) + 1),
    )
    run.y, run.probe = (np.concatenate([start, whole @ start]) for _ in "yp")
    run.turning, run.largest, run.atol, run.adaptive_atol = (
        np.zeros(4 * used),
        np.abs(start),
        np.full(used, -1.0),
        np.ones(used, bool),
    )
    return run


def sizes(run: Any) -> list[float]:
    """Return the size of each variable."""
    return [tolerance_sizes.variable_size(run, run.y, i) for i in range(run.plan[0].used)]


def begun(run: Any) -> float:
    """Give sizes to a start."""
    function = tolerance_sizes.begin_sizes
    return float(getattr(function, "py_func", function)(run))


@pytest.mark.usefixtures("plain")
def test_parts_tolerances_follow_the_largest_so_far() -> None:
    """Assert rtol times each size, a millionth of the largest of its kind at least, and given ones as they are."""
    run = linear([3.0, 1e-9, -5.0, 0.0], [[0.0] * 4] * 4, 0, [0, 0, 1, 1])
    run.adaptive_atol[3] = False
    getattr(tolerance_sizes.settle_tolerances, "py_func", tolerance_sizes.settle_tolerances)(run)
    assert run.atol == pytest.approx([3.0 * RTOL, 3e-6 * RTOL, 5.0 * RTOL, -1.0])


@pytest.mark.usefixtures("plain")
@pytest.mark.parametrize("w", [0.05, 5.0, 2e3])
@pytest.mark.parametrize("start", [2.0, -3e-7])
def test_parts_an_oscillator_from_rest(w: float, start: float) -> None:
    """Assert the first step of 1/w, and velocities of w times the place: the size of what is at rest."""
    run = linear([start, 0.0], [[-(w**2), 0.0]], 1, [0, 1])
    assert begun(run) == pytest.approx(1 / w, rel=1e-6)
    size = abs(start) * np.array([1.0, w])
    assert run.atol == pytest.approx(RTOL * size, rel=1e-6)
    assert run.largest == pytest.approx(size * [1.0, 1e-6], rel=1e-6)


@pytest.mark.usefixtures("plain")
@pytest.mark.parametrize(
    ("matrix", "coordinates", "rate"),
    [
        ([[-2.0, 0.0], [0.0, -50.0]], 0, 50.0),
        ([[0.0, 3.0], [-3.0, 0.0]], 0, 3.0),
        ([[0.0, 4.0], [4.0, 0.0]], 0, 4.0),
        ([[-7.0, 0.0], [0.0, -7.0]], 0, 7.0),
        ([[0.0, 0.0]], 1, 0.0),
        ([[-9.0, -8.0]], 1, 4.0 + math.sqrt(7.0)),
        ([[-9.0, -2.0]], 1, 3.0),
        ([[0.0, -6.0]], 1, 6.0),
        ([[math.nan, 0.0]], 1, 0.0),
    ],
)
def test_parts_the_fastest_rate_is_an_eigenvalue(
    matrix: list[list[float]], coordinates: int, rate: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert the largest size of an eigenvalue: two decays, a turning, a saddle, drag and damping, and none of free flight."""
    run = linear([1.5, 0.75], matrix, coordinates, [0, 1] if coordinates else [0, 0])
    monkeypatch.setattr(tolerance_sizes, "variable_size", lambda _run, _y, i: (2.0, 1.0)[i])
    assert tolerance_sizes.estimate_fastest_rate(run, 3.0, run.y) == pytest.approx(
        rate, rel=1e-3 if rate > 6.5 and coordinates else 1e-9
    )


@pytest.mark.usefixtures("plain")
def test_parts_a_time_of_state_and_slopes() -> None:
    """Assert size over slope of states, the root of place over acceleration, speed over acceleration at 0, and their least, by kinds."""
    for start, matrix, coordinates, kinds, time in (
        ([4.0, -1.0], [[0.0, 2.0], [0.0, 0.0]], 0, [0, 1], 2.0),
        ([4.0, -1.0], [[0.0, 2.0], [0.0, 0.0]], 0, [0, 0], 2.0),
        ([4.0, 10.0], [[0.0, 2.0], [0.0, -1.0]], 0, [0, 1], 0.2),
        ([8.0, 0.0], [[-0.25, 0.0]], 1, [0, 1], 2.0),
        ([0.0, 3.0], [[0.0, -0.5]], 1, [0, 1], 2.0),
        ([8.0, 40.0], [[-0.25, 0.0]], 1, [0, 1], 2.0),
        ([1e6, 1.0], [[0.0, 0.0]], 1, [0, 1], 50.0),
        ([0.0, 0.0], [[0.0, 0.0]], 1, [0, 1], 0.5),
    ):
        run = linear(start, matrix, coordinates, kinds)
        assert tolerance_sizes.time_at(run, run.y) == pytest.approx(time), (start, matrix)


@pytest.mark.usefixtures("plain")
def test_parts_natural_sizes_are_what_a_time_would_make() -> None:
    """Assert places and speeds after a time of the motion's own, a thousandth of their kind at least."""
    run = linear([8.0, 0.0, 0.0, 0.0], [[-0.25, 0, 0, 0], [0.0, 0, 0, 0]], 2, [0, 0, 1, 1])
    assert tolerance_sizes.natural_sizes(run, run.y) == pytest.approx(2.0)
    assert sizes(run) == pytest.approx([8.0, 8e-3, 4.0, 4e-3])
    assert run.turning[:4].tolist() == [0.0] * 4
    still = linear([8.0, 0.0], [[0.0, 0.0]], 1, [0, 1])
    assert tolerance_sizes.natural_sizes(still, still.y) == 0.5
    assert sizes(still) == pytest.approx([8.0, 16e-3])
    pushed = linear([0.0, 0.0], [[0.0, 0.0]], 1, [0, 1])
    pushed.y[2] = -4.0
    assert tolerance_sizes.natural_sizes(pushed, pushed.y) == 0.5
    assert sizes(pushed) == pytest.approx([1.0, 2.0])
    falling = linear([0.0, 3.0], [[0.0, -0.5]], 1, [0, 1])
    assert tolerance_sizes.natural_sizes(falling, falling.y) == pytest.approx(2.0)
    assert sizes(falling) == pytest.approx([6.0, 3.0])


@pytest.mark.usefixtures("plain")
def test_parts_derivatives_are_over_the_sizes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert the Jacobian of slopes by the state, each over its size, as a rounding of differences leaves it."""
    run = linear([1.5, 0.75, 2.0], [[-9.0, -2.0, 1.0], [0.5, 3.0, -4.0]], 1, [0, 1, 2])
    size = np.array([2.0, 1.0, 0.25])
    monkeypatch.setattr(tolerance_sizes, "variable_size", lambda _run, _y, i: size[i])
    found = np.full((4, 3), np.nan)
    getattr(tolerance_sizes.fill_derivatives, "py_func", tolerance_sizes.fill_derivatives)(run, 3.0, run.y, found)
    whole = np.array([[0.0, 1.0, 0.0], [-9.0, -2.0, 1.0], [0.5, 3.0, -4.0]])
    assert found[1:] == pytest.approx(whole * size / size[:, None], rel=1e-9)


ADAPTIVE = ("dormand_prince", "dop853", "radau_iia")


def spring(unit: str = "m", rate: float = 1.0, **initial: str) -> xd.Model:
    """A mass on a spring, at rest a length unit from where it rests."""
    return xd.Model(
        name="spring",
        coordinates={"x": {"unit": unit}},
        parameters={"m": "1 kg", "k": f"{rate**2!r} N m-1"},
        mass={"x": "m"},
        forces={"spring": {"x": "-k*x"}},
        initial={"x": f"1 {unit}", "v_x": f"0 {unit} s-1"} | initial,
    )


def charge() -> xd.Model:
    """A capacitor of 5 pC that discharges."""
    return xd.Model(
        name="capacitor",
        parameters={"tau": "1 s"},
        states={"q": {"unit": "C", "rate": "-q/tau"}},
        initial={"q": "5 pC"},
    )


def marched(model: xd.Model, **asked: Any) -> xr.Dataset:
    return xd.simulate(model, **{"method": "dop853", "until": "20 s", "force_samples": "none"} | asked)


def test_what_tolerances_do_not_control_is_said() -> None:
    """Assert that an oscillation of 1 nm within a given 1e-6 m is called what it is, with both numbers; none at rest, none by defaults."""
    model = spring("m", x="1 nm")
    said = r"did not control x \(largest value .*e-0[789] m, atol 1e-06 m\), v_x \(.* m s-1, atol 1e-06 m s-1\)"
    with pytest.warns(xd.AccuracyWarning, match=said):
        run = marched(model, atol=1e-6)
    assert run.attrs["run_outcome"] == "completed"
    assert "; the tolerances did not control x (" in run.attrs["run_outcome_text"]
    with pytest.warns(xd.AccuracyWarning, match=r"control q \(largest value .* C, atol 1e-06 C\)"):
        marched(charge(), atol=1e-6)
    for controlled in (marched(spring("m", x="0 m"), atol=1e-6), marched(model), marched(charge())):
        assert controlled.attrs["run_outcome_text"] == "reached t = 20 s"


def test_the_command_says_it_once(tmp_path: Path) -> None:
    """Assert one line with the outcome, by `run` and by `show`, and none on the error stream."""
    (tmp_path / "small.toml").write_text(spring("m", x="1 nm").to_toml())
    archive = str(tmp_path / "small.nc")
    done = CliRunner().invoke(
        main,
        ["run", str(tmp_path / "small.toml"), "-o", archive, "--method", "dop853", "--until", "9 s", "--atol", "1e-6"],
    )
    shown = CliRunner().invoke(main, ["show", archive])
    assert done.output.count("did not control") == shown.output.count("did not control") == 1
    assert done.stderr == ""


def test_loose_tolerances_are_meant_so() -> None:
    """Assert that a value a hundred times its absolute tolerance is no surprise where the relative one is as loose."""
    assert marched(spring(), rtol=1e-2, atol=1e-2).attrs["run_outcome_text"] == "reached t = 20 s"


@pytest.mark.parametrize(("unit", "factor"), [("nm", 1e-9), ("mm", 1e-3), ("km", 1e3)])
def test_bare_tolerances_are_in_declared_units(unit: str, factor: float) -> None:
    """Assert that a run of one unit of length is the same in every unit but for rounding, by default and by a bare number."""
    metres = marched(spring("m"))
    given = marched(spring("m"), rtol=1e-6, atol=1e-6)
    for asked in ({}, {"rtol": 1e-6, "atol": 1e-6}, {"rtol": 1e-6, "atol": {"x": "1e-6", "v_x": f"1e-6 {unit} s-1"}}):
        run, same = marched(spring(unit), **asked), given if asked else metres
        # by default it is the relative one times the size, which is the largest value of all rows
        sizes = [1.0, 1.0] if asked else [float(np.abs(run[name]).max()) for name in ("x", "v_x")]
        used = [run[name].attrs["atol"] for name in ("x", "v_x")]
        assert used == pytest.approx([1e-6 * size for size in sizes], rel=4 * EPS)
        assert run.x.attrs["atol_si"] == pytest.approx(1e-6 * factor, rel=EPS)
        assert run.sizes["step"] == same.sizes["step"]
        assert float(run.x[-1]) == pytest.approx(float(same.x[-1]), abs=1e-11)


def test_bare_tolerances_are_in_the_scales_of_a_march(tmp_path: Path) -> None:
    """Assert that a bare number counts in scaled units, and that its archive is reproduced."""
    scales = {"length": "4 m", "time": "0.5 s"}
    run = xd.simulate(spring(), method="dop853", until="20 s", scales=scales, path=tmp_path / "run.nc", atol=1e-9)
    assert run.x.attrs["atol_si"] == 4e-9
    assert run.v_x.attrs["atol_si"] == pytest.approx(8e-9, rel=EPS)
    assert xd.reproduce(tmp_path / "run.nc").attrs["identical"] == 1


def test_archives_in_other_units_are_reproduced(tmp_path: Path) -> None:
    """Assert that tolerances are taken from an archive to the bit, whatever the unit of the variable."""
    xd.simulate(spring("nm"), method="dormand_prince", until="20 s", rtol=3e-7, path=tmp_path / "run.nc")
    assert xd.reproduce(tmp_path / "run.nc").attrs["identical"] == 1


@pytest.mark.parametrize("method", ADAPTIVE)
@pytest.mark.parametrize("x", [1.0, 0.0])
def test_steps_do_not_depend_on_the_time_scale(method: str, x: float) -> None:
    """Assert the same steps, to the bit, of motions a millionfold slower and faster by powers of two."""
    found = []
    for rate in (2.0**-20, 1.0, 2.0**20):
        model = spring("m", rate, x=f"{x} m", v_x=f"{(1 - x) * rate!r} m s-1")
        atol = {"x": 2.0**-20, "v_x": 2.0**-20 * rate}
        run = marched(model, method=method, rtol=1e-6, atol=atol, until=8.0 / rate)
        found.append(run.step_size.values * rate)
    assert found[0].tolist() == found[1].tolist() == found[2].tolist()


@pytest.mark.parametrize("scales", [{"time": "1 us"}, {"time": "1000 s"}, {"length": "1 nm", "mass": "1e6 kg"}])
def test_steps_do_not_depend_on_scales(scales: dict[str, str]) -> None:
    """Assert the same steps but for rounding with scales, where the tolerances have units."""
    asked = {"rtol": 1e-8, "atol": {"x": "1e-8 m", "v_x": "1e-8 m s-1"}}
    plain, scaled = marched(spring(), **asked), marched(spring(), scales=scales, **asked)
    # the estimate of the first step is rounding alone, and the next step follows from it
    assert scaled.step_size.values == pytest.approx(plain.step_size.values, rel=1e-3)
    assert float(scaled.x[-1]) == pytest.approx(float(plain.x[-1]), abs=1e-12)


def test_first_steps_do_not_depend_on_the_end() -> None:
    """Assert it for motions that begin with a slope."""
    first, second = (marched(spring(), rtol=1e-8, until=until) for until in (10.0, 1000.0))
    assert first.attrs["solver_first_step"] == second.attrs["solver_first_step"]
    assert np.array_equal(first.x.values[:20], second.x.values[:20])


def test_a_start_at_rest_finds_its_time_scale() -> None:
    """Assert a first step near those that follow, though the velocity's tolerance is far too small for it."""
    run = marched(spring("m", 1e6), rtol=1e-8, until=2e-5)
    assert run.step_size.values[1] > 1e-3 * run.step_size.values.max()


def swing(rate: float, length: float) -> xd.Model:
    """A pendulum of any length and time scale, by the arc it goes."""
    return xd.Model(
        name="swing",
        coordinates={"x": {"unit": "m"}},
        parameters={"m": "1 kg", "k": f"{rate**2!r} N m-1", "L": f"{length!r} m"},
        mass={"x": "m"},
        forces={"gravity": {"x": "-k*L*sin(x/L)"}},
        initial={"x": f"{length!r} m", "v_x": "0 m s-1"},
    )


@pytest.mark.every(5)
@pytest.mark.parametrize("method", xd.METHODS)
def test_every_method_is_blind_to_units(method: str) -> None:
    """Assert the same bits of a motion of nanometres in microseconds, and of gigametres in megaseconds, by powers of two."""
    found = set()
    for rate, length in ((1.0, 1.0), (2.0**20, 2.0**-30), (2.0**-20, 2.0**30)):
        asked = {"method": method, "until": 3.0 / rate, "force_samples": "none"}
        tolerances = {"rtol": 1e-4, "atol": {"x": 1e-4 * length, "v_x": 1e-4 * length * rate}}
        fixed = xd.simulate(swing(rate, length), step=2.0**-6 / rate, **asked)
        chosen = xd.simulate(swing(rate, length), **tolerances, **asked)
        found.add(((fixed.x.values / length).tobytes(), (chosen.x.values / length).tobytes()))
    assert len(found) == 1

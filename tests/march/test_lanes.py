"""Runs side by side in vector code: each has the bits that it has alone, for any number of lanes.

The same bits of whole runs on other machines: another C library, processors with and without wide vectors.
Threads: whatever is marched, sampled or marched in numbers at once comes out as it does alone.
"""

from __future__ import annotations

import contextlib
import io
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from llvmlite import binding as llvm

import xdynamics as xd
from cases.problems import MODELS, ROOT, particle
from xdynamics.kernels import law_of
from xdynamics.march import Runs, march_many
from xdynamics.march.configuration import settings_for
from xdynamics.march.settings import Settings
from xdynamics.march.simd_ensemble import LANE_ROWS, lanes_for
from xdynamics.methods import METHODS

N = 37
COMPARED = ("time", "state", "status", "rows", "trials", "evaluations", "largest", "ends", "events")


def asked(model: xd.Model, **more: Any) -> Settings:
    """Settings without force samples."""
    return settings_for(model, force_samples="none", **more)


def assert_same(one: Runs, other: Runs) -> None:
    """Assert that two results agree in every bit, the last rows of the logs included."""
    for name in COMPARED:
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes(), name
    assert one.log_block.log.rows.tobytes() == other.log_block.log.rows.tobytes()


def duffing(*, damped: bool = True) -> xd.Model:
    """Return an oscillator with a cubic spring, damped or not."""
    damping = {"damping": {"x": "-c*v_x"}} if damped else {}
    return xd.Model(
        name="duffing",
        coordinates={"x": {"unit": "m"}},
        parameters={"m": "1 kg", "k": "0.5 N m-3", "c": "0.1 N s m-1"},
        mass={"x": "m"},
        forces={"spring": {"potential": "newton/metre*x**2/2"}, "cubic": {"x": "-k*x**3"}} | damping,
        initial={"x": "1 m", "v_x": "0 m s-1"},
    )


@pytest.mark.every(5)
@pytest.mark.parametrize("method", [name for name, one in METHODS.items() if not one.solves and one.stepper.locates])
@pytest.mark.parametrize("lanes", [2, 8])
def test_every_explicit_method(method: str, lanes: int) -> None:
    """Assert the bits of one lane, on a grid and, with an embedded formula, with chosen steps."""
    model = duffing(damped=not METHODS[method].refusals(duffing()))
    ways = [{"step": 0.03}] + ([{"rtol": 1e-7, "atol": 1e-9}] if METHODS[method].estimate else [])
    given = {"parameters": {"k": np.linspace(0.0, 8.0, N)}, "initial": {"x": np.linspace(0.5, 2.0, N)}}
    for way in ways:
        settings = asked(model, method=method, until=4.0, **way)
        alone = march_many(model, settings, lanes=1, **given)
        assert_same(march_many(model, settings, lanes=lanes, **given), alone)


@pytest.mark.every(7)
@pytest.mark.parametrize(
    ("name", "varied", "more"),
    [
        ("kepler", "x", {"method": "dop853", "rtol": 1e-9, "until": 6.0}),
        ("kepler", "x", {"method": "dprkn6", "rtol": 1e-7, "until": 6.0}),
        ("kepler", "x", {"method": "taylor", "rtol": 1e-11, "until": 6.0}),
        ("double_pendulum", "theta1", {"method": "taylor", "rtol": 1e-8, "atol": 1e-10, "until": 2.0}),
        ("pendulum", "theta", {"method": "dormand_prince", "rtol": 1e-6, "until": 3.0}),
        ("double_pendulum", "theta1", {"method": "dop853", "rtol": 1e-8, "until": 2.0}),
        ("coupled_masses", "x1", {"method": "yoshida6", "step": 0.01, "until": 2.0}),
        (
            "cart_spring",
            "x",
            {"method": "pefrl", "step": 0.011, "until": 2.0, "scales": {"time": "3 s"}, "switches": "stepped over"},
        ),
    ],
)
def test_models_with_angles_tables_and_scales(name: str, varied: str, more: dict[str, Any]) -> None:
    """Assert the bits of one lane for models in the data folder."""
    model = xd.Model.from_toml(MODELS / f"{name}.toml")
    settings = asked(model, **more)
    start = next(
        (one for one in (varied, varied.replace("1", "_1")) if one in model.initial), settings.layout(model).used[0]
    )
    if settings.layout(model).watched:
        pytest.skip("looks for events")
    values = model.initial[start].si + np.linspace(0.0, 0.2, N) * (abs(model.initial[start].si) or 1.0)
    alone = march_many(model, settings, lanes=1, initial={start: values})
    for lanes in (3, 16):
        assert_same(march_many(model, settings, lanes=lanes, initial={start: values}), alone)


def driven() -> xd.Model:
    """Return a particle that a measured force pushes, with jumps in time."""
    return xd.Model(
        name="driven",
        coordinates={"x": {"unit": "m"}},
        parameters={"m": "1 kg"},
        mass={"x": "m"},
        forces={"push": {"x": "push"}, "spring": {"potential": "newton/metre*x**2/2"}},
        drives={
            "push": {
                "table": "p.csv",
                "csv": "t [s],p [N]\n0,0\n0.5,1\n0.6,-1\n1.7,2\n3,0\n",
                "interpolation": "previous",
            }
        },
        initial={"x": "1 m", "v_x": "0 m s-1"},
    )


@pytest.mark.parametrize(
    "way",
    [
        {"method": "dop853", "rtol": 1e-8},
        {"method": "heun", "step": 0.07},
        {"method": "taylor", "rtol": 1e-8},
        {"method": "taylor", "rtol": 1e-8, "step": 0.01},
        {"method": "taylor", "step": 0.07, "order": 9},
    ],
)
def test_nodes_of_drives(way: dict[str, Any]) -> None:
    """Assert the bits of one lane where the march lands on breakpoints, and on nodes that are asked for."""
    model = driven()
    settings = asked(model, until=2.9, nodes=[0.55, 1.0, 1.0000001], **way)
    given = {"initial": {"x": np.linspace(-1.0, 1.0, N)}}
    assert_same(march_many(model, settings, lanes=4, **given), march_many(model, settings, lanes=1, **given))


def test_members_that_fail_and_members_that_are_over_at_once() -> None:
    """Assert that forces that become infinite, step limits and first steps beyond the end end one lane alone."""
    model = particle("F/where(x > 5*metre, 0, 1)")
    settings = asked(model, method="dop853", rtol=1e-6, until=3.0)
    given = {"initial": {"x": np.linspace(-30.0, 6.0, N)}}
    alone = march_many(model, settings, lanes=1, **given)
    assert len({*alone.outcomes}) > 1
    assert_same(march_many(model, settings, lanes=8, **given), alone)
    limited = asked(duffing(), method="dop853", rtol=1e-9, until=30.0, max_steps=60)
    given = {"parameters": {"k": np.linspace(0.0, 50.0, N)}}
    alone = march_many(duffing(), limited, lanes=1, **given)
    assert {*alone.outcomes} >= {"step_limit"}
    assert_same(march_many(duffing(), limited, lanes=8, **given), alone)


def test_series_that_fail_more_often_than_a_log_of_a_lane_holds() -> None:
    """Assert that a step is chosen once where coefficients overflow: each rejected trial shortens the one before."""
    settings = asked(duffing(), method="taylor", order=20, rtol=1e-9, atol=1e-6, until=1.0, max_steps=2000)
    given = {"initial": {"x": np.array([0.1, 0.5, 1e100, 1.0, 2.0])}}
    alone = march_many(duffing(), settings, lanes=1, **given)
    assert alone.trials[2] > 4 * LANE_ROWS
    assert_same(march_many(duffing(), settings, lanes=4, **given), alone)


@pytest.mark.parametrize(
    "way",
    [
        {"rtol": 1e-9, "atol": 1e-9},
        {"rtol": 1e-9},
        {"rtol": 1e-9, "order": 2, "max_steps": 300},
        {"rtol": 1e-6, "order": 30, "step": 3.0},
        {"step": 0.1},
    ],
)
def test_taylor_series_side_by_side(way: dict[str, Any]) -> None:
    """Assert that lanes are taken, and the bits of one lane, with tolerances that follow, and trials that are rejected."""
    settings = asked(duffing(), method="taylor", until=6.0, log="full", **way)
    law = law_of(settings.layout(duffing()), sampled=False)
    assert lanes_for(law, settings, N, 8) == 8
    given = {"parameters": {"k": np.linspace(0.0, 8.0, N)}, "initial": {"x": np.linspace(0.5, 2.0, N)}}
    alone = march_many(duffing(), settings, lanes=1, logs=True, **given)
    assert_same(march_many(duffing(), settings, lanes=8, logs=True, **given), alone)
    if way.get("step") == 3.0:
        assert alone.trials.sum() > 0
    one = march_many(
        duffing(),
        settings,
        lanes=8,
        logs=True,
        **{kind: {k: v[5:6] for k, v in of.items()} for kind, of in given.items()},
    )
    assert one.state.tobytes() == alone.state[5:6].tobytes()


def test_steps_and_tolerances_of_their_own() -> None:
    """Assert that each lane has its own step or tolerance, with any number of threads."""
    model = duffing()
    judged = asked(model, method="dormand_prince", rtol=1e-6, until=9.0)
    rtols = np.geomspace(1e-3, 1e-10, N)
    alone = march_many(model, judged, lanes=1, rtols=rtols)
    assert_same(march_many(model, judged, lanes=8, rtols=rtols, threads=2), alone)
    grid = asked(model, method="rk4", step=0.1, until=2.0)
    steps = np.linspace(0.01, 0.3, N)
    assert_same(march_many(model, grid, lanes=8, steps=steps), march_many(model, grid, lanes=1, steps=steps))


@pytest.mark.every(7)
@pytest.mark.parametrize("seed", range(6))
def test_random_forces(seed: int) -> None:
    """Assert the bits of one lane for forces put together at random from the functions of the language."""
    random = np.random.default_rng(seed)
    X, V = "(x/metre)", "(v_x*second/metre)"
    parts = [
        f"sin(3*{X})",
        f"exp(-{X}**2)",
        f"cos({V})",
        f"tanh({X}*{V})",
        f"atan2({X}, 1 + {V}**2)",
        f"log(1 + {X}**2)",
        f"hypot({X}, {V})",
        f"sqrt(1 + {X}**2)",
        f"min({X}, {V})",
        f"where({X} > 0.3, 1, -0.5)",
        f"abs({V})",
        f"{X}**3",
        "t/second",
    ]
    chosen = random.choice(parts, 4, replace=False)
    text = " + ".join(f"{float(w)!r}*{part}" for w, part in zip(random.normal(size=4), chosen, strict=True))
    model = xd.Model(
        name="random",
        coordinates={"x": {"unit": "m"}},
        parameters={"m": "1 kg", "k": "4 N m-1"},
        mass={"x": "m"},
        forces={"spring": {"potential": "k*x**2/2"}, "strange": {"x": f"newton*({text})", "smooth": True}},
        initial={"x": "0.3 m", "v_x": "0 m s-1"},
        observables={"power": "v_x*k*x"},
    )
    given = {"initial": {"x": random.uniform(-1.0, 1.0, N)}, "parameters": {"k": random.uniform(1.0, 9.0, N)}}
    settings = asked(model, method="dop853", rtol=1e-8, until=5.0)
    assert_same(march_many(model, settings, lanes=16, **given), march_many(model, settings, lanes=1, **given))


def watched(name: str) -> xd.Model:
    """Return a model of the data folder."""
    return xd.Model.from_toml(MODELS / f"{name}.toml")


@pytest.mark.every(11)
@pytest.mark.parametrize(
    ("name", "more"),
    [
        ("bouncing_ball", {"method": "velocity_verlet", "step": 0.01, "until": 10.0}),
        ("bouncing_ball", {"method": "dop853", "rtol": 1e-7, "until": 10.0}),
        ("ball_drag", {"method": "heun", "rtol": 1e-5}),
        ("ball_in_box", {"method": "dormand_prince", "rtol": 1e-7, "until": 3.0}),
        ("impact_oscillator", {"method": "dop853", "rtol": 1e-8, "until": 5.0}),
        ("moving_table", {"method": "dop853", "rtol": 1e-7, "until": 2.0}),
        ("block_on_incline", {"method": "dormand_prince", "rtol": 1e-7, "until": 2.0}),
        ("stick_slip_belt", {"method": "dormand_prince", "rtol": 1e-6, "until": 5.0}),
        ("relay_oscillator", {"method": "dormand_prince", "rtol": 1e-7, "until": 5.0}),
        ("staged_rocket", {"method": "dormand_prince", "rtol": 1e-7}),
        ("rocket_c6", {"method": "heun", "rtol": 1e-4}),
        ("bouncing_ball", {"method": "taylor", "rtol": 1e-9, "until": 10.0}),
        ("impact_oscillator", {"method": "taylor", "rtol": 1e-9, "until": 5.0}),
        ("relay_oscillator", {"method": "taylor", "rtol": 1e-7, "until": 5.0}),
        ("woodpecker", {"method": "dormand_prince", "rtol": 1e-6, "until": 0.3}),
    ],
)
def test_events_contacts_and_switches(name: str, more: dict[str, Any]) -> None:
    """Assert the bits of one lane, every event with its bracket, rates and impulses among them."""
    model = watched(name)
    settings = asked(model, **more)
    start = settings.layout(model).used[0]
    values = model.initial[start].si + np.linspace(0.0, 0.02, N) * (abs(model.initial[start].si) or 1.0)
    alone = march_many(model, settings, lanes=1, initial={start: values})
    for lanes in (2, 16):
        found = march_many(model, settings, lanes=lanes, initial={start: values})
        assert_same(found, alone)
        assert found.log_block.log.rates.tobytes() == alone.log_block.log.rates.tobytes()
        assert found.log_block.log.impulses.tobytes() == alone.log_block.log.impulses.tobytes()


DETECTORS = 10


def crowded() -> xd.Model:
    """Return an oscillator with ten detectors, whose places are parameters, and a floor that it bounces on."""
    places = {f"p{i}": f"{0.1 * i} m" for i in range(DETECTORS)}
    events = {
        f"e{i}": {"function": f"x - p{i}", "direction": ["rising", "falling", "either"][i % 3]}
        for i in range(DETECTORS)
    }
    return xd.Model(
        name="crowded",
        coordinates={"x": {"unit": "m"}},
        parameters={"m": "1 kg", "depth": "0.9 m", **places},
        mass={"x": "m"},
        forces={"spring": {"potential": "newton/metre*x**2/2"}},
        initial={"x": "1 m", "v_x": "0 m s-1"},
        events=events,
        contacts={"floor": {"gap": "x + depth", "restitution": 0.8}},
    )


@pytest.mark.cases(100)
def test_many_events_close_together(case: int) -> None:
    """Assert the bits of one lane of members with dense events and impacts, logs and ends alone, for several numbers of lanes."""
    draw, model = np.random.default_rng(case), crowded()
    width = 10.0 ** draw.uniform(-6.0, 0.0, N)  # of the stretch in which all detectors of a member are
    given = {f"p{i}": draw.uniform(-0.7, 0.7) + width * draw.uniform(-0.5, 0.5, N) for i in range(DETECTORS)}
    given = {"parameters": given | {"depth": draw.uniform(0.2, 1.5, N)}}
    adaptive = case // 20 % 2 == 0  # of every twentieth case some are
    way = {"method": "dop853", "rtol": 1e-8, "atol": 1e-8} if adaptive else {"method": "rk4", "step": 0.05}
    settings = asked(model, until=7.0, **way)
    lanes, logs = int(draw.choice([2, 4, 8])), bool(draw.integers(2))
    assert lanes_for(law_of(settings.layout(model), sampled=False), settings, N, lanes) == lanes
    alone = march_many(model, settings, lanes=1, logs=logs, **given)
    assert len(alone.events) > 10 * N
    assert_same(march_many(model, settings, lanes=lanes, logs=logs, **given), alone)


@pytest.mark.every(11)
@pytest.mark.parametrize(
    "function",
    [
        "x - 0.2*metre",
        "sin(3*x/metre) - 0.5",
        "x*v_x",
        "x/(2*metre + x) - 0.1",
        "exp(-x/metre) - 0.9",
        "x**2 - 0.3*metre**2",
        "min(x, 0.4*metre) - 0.1*metre",
        "abs(v_x) - 0.5*metre/second",
        "cos(t/second) - 0.3",
        "-x*abs(x)",
        "tanh(v_x*second/metre) - 0.2",
    ],
)
def test_event_functions_in_lanes(function: str) -> None:
    """Assert that a lane looks no less closely than the single march, for the operations that are written for lanes."""
    model = xd.Model(
        name="watched",
        coordinates={"x": {"unit": "m"}},
        parameters={"m": "1 kg", "k": "4 N m-1"},
        mass={"x": "m"},
        forces={"spring": {"potential": "k*x**2/2"}},
        initial={"x": "0.7 m", "v_x": "0.1 m s-1"},
        events={"met": {"function": function}},
    )
    given = {"parameters": {"k": np.linspace(1.0, 30.0, N)}}
    for way in ({"method": "velocity_verlet", "step": 0.02}, {"method": "dop853", "rtol": 1e-9}):
        settings = asked(model, until=6.0, **way)
        alone = march_many(model, settings, lanes=1, **given)
        assert len(alone.events) > N
        assert_same(march_many(model, settings, lanes=8, **given), alone)


# a model that uses every function of the language, another by two methods; constraints, a body, a controller, links
PROGRAM = """
import xdynamics as xd
every = xd.Model(
    name="every function", coordinates={"x": "1", "y": "1"}, states={"w": {"unit": "1", "rate": "c*(log(2 + cosh(x)) - w**1.7/3 + min(x, y, 0) + max(x, 0.1) + where(x > y, sqrt(abs(x)), 1))"}}, parameters={"k": "1 s-2", "c": "1 s-1"},
    mass={"x": "1", "y": "1"},
    forces={
        "first": {"x": "-k*(sin(x) + tanh(y) + 0.1*tan(y/2) + atan2(x, 2 + y) + sign(x)*hypot(x, y)/9)"},
        "second": {"y": "-k*(asin(x/9) + acos(y/9) - 1.5 + atan(y) + sinh(x/3)*exp(-x**2) + abs(y)**(1/3)*cos(3*y))"},
    },
    initial={"x": "1.1", "y": "0.3", "v_x": "0 s-1", "v_y": "-0.7 s-1", "w": "1"},
)
runs = [xd.simulate(every, method=one, until="20 s", **how) for one, how in (("dop853", {"rtol": 1e-9, "atol": 1e-9}), ("rk4", {"step": "10 ms"}), ("taylor", {"rtol": 1e-9, "atol": 1e-9}))]
for name in ("double_pendulum",):
    model = xd.Model.from_toml(f"data/models/{name}.toml")
    runs += [xd.simulate(model, method="dormand_prince", rtol=1e-8, atol=1e-8), xd.simulate(model, method="midpoint")]
for name, until in (("four_bar", "0.3 s"), ("heavy_top", "0.1 s"), ("cart_pid", "1 s")):  # constraints, a body, a controller
    runs.append(xd.simulate(xd.Model.from_toml(f"data/models/{name}.toml"), until=until))
cluster = xd.Model(
    name="every two of 18 bodies",
    dimensions={"body": 18, "axis": 2},
    coordinates={"r": {"unit": "m", "dims": ["body", "axis"]}},
    parameters={"k": "1 N m2", "m": {"dims": ["body"], "unit": "kg", "value": [1 + i / 7 for i in range(18)]}},
    mass={"r": "m"},
    relations={"pair": {"of": "body"}},
    forces={"pull": {"over": "pair", "potential": "-k/norm(second(r, pair) - first(r, pair), axis)"}},
    initial={"r": "(index(body) + 1)*(index(body)*index(axis) + 1)*metre"},
)
runs.append(xd.simulate(cluster, method="taylor", rtol=1e-9, atol=1e-9, until="1 s"))
import hashlib
import numpy as np
from xdynamics.march import march_many
from xdynamics.march.configuration import settings_for
told = settings_for(every, method="dop853", rtol=1e-9, atol=1e-9, until="9 s", force_samples="none")
abreast = march_many(every, told, initial={"x": np.linspace(0.9, 1.3, 40)}, lanes=8)
print(*map(xd.content_digest, runs), hashlib.sha256(abreast.log_block.log.rows.tobytes() + abreast.ends.tobytes()).hexdigest())
"""
# together by default; each alone, which tells them apart, with --whole
ELSEWHERE = {
    "any x86-64, with a C library without AVX2 and fma": {
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX2_Usable,-FMA_Usable",
        "TARGET": "x86-64",
    },
    "a C library without AVX2 and fma": {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX2_Usable,-FMA_Usable"},
    "any x86-64": {"TARGET": "x86-64"},
    "AVX2": {"TARGET": "haswell"},
}
AT_A_TARGET = """
import os
from xdynamics.kernels import machine
if os.environ.get("TARGET"):
    machine.processor = lambda: ("", os.environ["TARGET"], "")
"""


def digests(**environment: str) -> str:
    """Digests of the runs, marched in a process of its own; code is kept by its processor."""
    done = subprocess.run(
        [sys.executable, "-c", AT_A_TARGET + PROGRAM],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
        env={**os.environ, **environment},
    )
    return done.stdout


@pytest.fixture(scope="module")
def here() -> str:
    """What this machine gives, in this process."""
    with contextlib.chdir(ROOT), contextlib.redirect_stdout(io.StringIO()) as told:
        exec(PROGRAM, {})
    return told.getvalue()


@pytest.mark.every(2)
@pytest.mark.parametrize("where", ELSEWHERE)
def test_digests_are_the_same(where: str, here: str, request: pytest.FixtureRequest) -> None:
    """Assert equal digests of models with every function of the language, constraints, a body, a controller, and links side by side."""
    if len(ELSEWHERE[where]) == 1 and not request.config.getoption("--whole"):
        pytest.skip("with --whole: one difference alone")
    if not llvm.get_process_triple().startswith("x86_64"):
        pytest.skip("another architecture")
    if where == "AVX2" and not llvm.get_host_cpu_features().get("avx2"):
        pytest.skip("this machine has no AVX2")
    assert len(here.split()) == 10
    assert digests(**ELSEWHERE[where]) == here


CERTIFIED = """
import sys
import xdynamics as xd
ball = xd.Model.from_toml("data/models/ball_drag.toml")
if len(sys.argv) > 2:
    xd.recheck(sys.argv[1])
else:
    xd.save(xd.certify(ball, "y", at="1 s", draws=200, method="dop853", rtol=1e-6), sys.argv[1])
"""
NARROW = {
    "OPENBLAS_CORETYPE": "Prescott",
    "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR AVX2 FMA3 AVX512F AVX512_SKX",
} | ELSEWHERE["a C library without AVX2 and fma"]


@pytest.mark.dear
def test_a_certificate_comes_out_again_elsewhere(tmp_path: Path) -> None:
    """Assert every bit of a budget, draws and verdicts where numpy, BLAS and the C library have no wide vectors."""
    for more in ([], ["again"]):
        environment = {**os.environ, **(NARROW if more else {})}
        subprocess.run(
            [sys.executable, "-W", "ignore", "-c", CERTIFIED, str(tmp_path / "c.nc"), *more],
            check=True,
            cwd=ROOT,
            env=environment,
        )


NAMES = ("kepler", "ball_drag", "double_pendulum", "rocket_c6")


def work(number: int) -> str:
    """March, sample and march many of one model of four, by a law that may be compiled by several threads at once."""
    model = xd.Model.from_toml(MODELS / f"{NAMES[number % 4]}.toml")
    method = ("dop853", "rk4", "heun")[number % 3]
    run = xd.simulate(model, method=method, rtol=1e-7, until=2.5)
    found = xd.sample(run, np.linspace(0.0, float(run.time[-1]), 50))
    settings = settings_for(model, method=method, rtol=1e-6, until=1.0)
    name = settings.layout(model).used[0]
    runs = march_many(model, settings, initial={name: model.elements.statement.initial[name].si + 1e-3 * np.arange(20)})
    return (
        xd.content_digest(run)
        + str(float(sum(found[name].values.sum() for name in found.data_vars)))
        + repr(runs.state.sum())
    )


@pytest.mark.dear
def test_eight_threads(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Assert that eight threads over a cache without laws give what one gives."""
    from xdynamics.kernels import law
    from xdynamics.march.engine import engine

    engine()
    alone = [work(number) for number in range(12)]
    monkeypatch.setenv("XDYNAMICS_CACHE", str(tmp_path))
    law.law_of.cache_clear()
    with ThreadPoolExecutor(8) as pool:
        together = list(pool.map(work, list(range(12)) * 4))
    assert together == alone * 4

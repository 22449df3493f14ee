"""Models with many coordinates keep what their motions keep.

Many runs in one call: each is the run that it is alone.
Logs whose rows have many numbers: these stand side by side, and the record does not show it.
"""

from __future__ import annotations

import subprocess
import sys
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from large_problems import BODIES, chain, fput, outer_solar_system, toda
from numpy.typing import NDArray

import xdynamics as xd
from cases.problems import EPS, MODELS, particle
from xdynamics.march import March, Runs, march_many
from xdynamics.march.configuration import settings_for
from xdynamics.march.log import log_of
from xdynamics.march.settings import Settings
from xdynamics.model.linearisation import initial_state, linearise
from xdynamics.stability import surely_stable

CHAINED = 1000

CHAIN = """
name = "A long chain"
[dimensions]
site = {n}
[relations.spring]
of = "site"
neighbours = 1
[coordinates]
u = {{ unit = "m", dims = ["site"] }}
[parameters]
m = "1 kg"
k = "1 N m-1"
A = "1 m"
[mass]
u = "m"
[forces.springs]
over = "spring"
potential = "k*(second(u, spring) - first(u, spring))**2/2"
[initial]
u = "A*sin(2*pi*index(site)/1000)"
v_u = "0*A/second"
[run]
method = "velocity_verlet"
step = "0.05 s"
until = "0.15 s"
"""


def drift(run: xr.Dataset, name: str) -> float:
    """The largest change of a quantity over its size at the start."""
    values = run[name].values
    return float(np.max(np.abs(values - values[0])) / abs(values[0]))


def mode_energy(run: xr.Dataset, n: int, k: int) -> NDArray[np.float64]:
    """The energy of the k-th linear mode of n unit masses between walls."""
    i = np.arange(1, n + 1)
    shape = np.sqrt(2 / (n + 1)) * np.sin(np.pi * k * i / (n + 1))
    q, v = (sum(a * run[f"{prefix}u{j}"].values for a, j in zip(shape, i, strict=True)) for prefix in ("", "v_"))
    return (v**2 + (2 * np.sin(np.pi * k / (2 * (n + 1))) * q) ** 2) / 2


def test_fput_returns_to_its_first_mode() -> None:
    """Assert that energy leaves the first mode for the second and third and is back, at 98 %, after 157 of its periods."""
    run = xd.simulate(fput(), method="yoshida6", step="0.5 s", until="10400 s", force_samples="none")
    total = float(run.total_energy[0])
    first, second, third = (mode_energy(run, 32, k) / total for k in (1, 2, 3))
    assert drift(run, "total_energy") < 1e-6
    assert first.min() < 0.1
    assert (second.max(), third.max()) == pytest.approx((0.87, 0.69), abs=0.01)
    back = int(np.argmax(np.where(run.time.values > 5000, first, 0)))
    assert first[back] > 0.97
    assert float(run.time[back]) == pytest.approx(157 * 2 * np.pi / (2 * np.sin(np.pi / 66)), rel=0.05)


@pytest.mark.dear
def test_toda_lattice_keeps_its_integrals() -> None:
    """Assert that momentum is kept to rounding, energy and Flaschka's cubic integral to the order of the method."""
    run = xd.simulate(toda(), method="yoshida8", step="0.05 s", until="50 s", force_samples="none")
    assert np.ptp((run.q1 - run.q0).values) > 1.0  # far from linear
    assert drift(run, "momentum") < 100 * 100 * EPS
    assert drift(run, "total_energy") < 1e-13
    assert drift(run, "cubic") < 1e-13
    coarse, fine = (
        xd.simulate(toda(), method="velocity_verlet", step=step, until="50 s", force_samples="none")
        for step in ("0.1 s", "0.05 s")
    )
    for name in ("total_energy", "cubic"):
        assert drift(coarse, name) / drift(fine, name) == pytest.approx(4.0, rel=0.05)


def test_outer_solar_system_keeps_energy_and_angular_momentum() -> None:
    """Assert over 200,000 days that a symplectic method keeps angular momentum to rounding and energy to its order."""
    model = outer_solar_system()
    assert len(model.elements.statement.coordinates) == 3 * len(BODIES) == 18
    verlet, yoshida = (
        xd.simulate(model, method=method, step=step, until="200000 s", force_samples="none")
        for method, step in (("velocity_verlet", "200 s"), ("yoshida8", "50 s"))
    )
    for run in (verlet, yoshida):
        assert max(drift(run, f"angular_momentum_{axis}") for axis in "xyz") < 4000 * EPS
    assert drift(verlet, "total_energy") == pytest.approx(2e-3, rel=0.1)
    assert drift(yoshida, "total_energy") < 1e-12
    early, late = (float(verlet.total_energy[part].mean()) for part in (slice(0, 500), slice(500, None)))
    assert early == pytest.approx(late, rel=2e-4)  # it swings and does not drift


@pytest.mark.dear
@pytest.mark.parametrize("method", ["velocity_verlet", "dop853"])
def test_a_thousand_masses_keep_their_energy(method: str) -> None:
    """Assert that a long chain is one record of all its coordinates, from Python and from its file alike."""
    model = chain(CHAINED)
    asked = {"step": "0.01 s"} if method == "velocity_verlet" else {"rtol": 1e-10, "atol": 1e-10}
    # far from the mass that is struck there is hardly any motion; what there is has an error in proportion, 2e-7 of u8,
    # which is 2e-9 after 2 s, where its absolute tolerance is 1e-10: no warning
    run = xd.simulate(model, method=method, until="2 s", **asked)
    u = np.array(
        [run.variables[f"u{i}"].values for i in range(CHAINED)]
    )  # a DataArray of each would take ten times as long
    energy = run.kinetic_energy.values + (np.diff(u, axis=0) ** 2).sum(axis=0) / 2 + (u[0] ** 2 + u[-1] ** 2) / 2
    assert energy == pytest.approx(1.0, rel=1e-4)
    assert xd.Model.from_text(run.model_toml.values.item()) == model


def test_a_diagonal_mass_is_not_looked_at_off_its_diagonal() -> None:
    """Assert that the entries of a mass given by coordinate are as many as its coordinates."""
    model = chain(CHAINED)
    assert len(model.elements.statement.mass_entries) == CHAINED
    assert not model.elements.mass_is_full


@pytest.mark.every(2)
@pytest.mark.parametrize(("step", "sure"), [(0.99, True), (1.01, False)])
def test_a_chain_is_stable_without_eigenvalues(step: float, sure: bool) -> None:
    """Assert that the row sums of the stiffness, 4 k/m, bound its frequencies, and Verlet's limit of 2 is held to them."""
    model = chain(CHAINED)
    jacobian = linearise(model, initial_state(model)).jacobian
    assert surely_stable(jacobian, xd.METHODS["velocity_verlet"], CHAINED, step) is sure
    jacobian[CHAINED, CHAINED] = -0.1
    assert not surely_stable(jacobian, xd.METHODS["velocity_verlet"], CHAINED, step)


@pytest.mark.dear
def test_rows_longer_than_the_stack_holds() -> None:
    """Assert that 150,000 sites of a chain are marched as NumPy marches them: arrays of a law this long are on the heap."""
    n, steps, h = 150_000, 3, 0.05
    model = xd.Model.from_text(CHAIN.format(n=n))
    run = xd.simulate(model, log="states")
    u, v = np.sin(2.0 * np.pi * np.arange(n) / 1000.0), np.zeros(n)

    def force(u: np.ndarray) -> np.ndarray:
        pull = np.diff(u)
        return np.append(pull, 0.0) - np.append(0.0, pull)

    a = force(u)
    for _ in range(steps):
        v = v + h / 2 * a
        u = u + h * v
        a = force(u)
        v = v + h / 2 * a
    assert run.sizes["step"] == steps + 1
    assert np.abs(run.u.values[-1] - u).max() < 1e-13
    assert np.abs(run.v_u.values[-1] - v).max() < 1e-13


@pytest.mark.dear
def test_a_log_of_states_holds_little_else() -> None:
    """Assert that a run of 100,000 sites takes its log and some 120 numbers a site, and keeps no state twice."""
    n = 100_000
    model = xd.Model.from_text(CHAIN.format(n=n))
    xd.simulate(model, log="states", until="0.05 s")
    tracemalloc.start()
    try:
        run = xd.simulate(model, log="states", until="1 s")
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    log = 2 * 8 * n * run.sizes["step"]
    assert peak < log + 140e6  # of which 44 MB are zeros that nothing touches
    assert run.end_memory.size < 10 * n


PEAK = """
import resource
import xdynamics as xd

def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024

def records(text):
    model = xd.Model.from_text(text)
    {made}

records({small!r})
before = peak()
held = records({large!r})
print(peak() - before, sum(run.nbytes for run in held) / 2**20)
"""
# what is held in the end, and MB beside it at most; of a file nothing is held
MADE = {
    "states": ('return [xd.simulate(model, log="states")]', 100.0),
    "all columns": ('return [xd.simulate(model, log="full")]', 100.0),
    "in a file": ('return [xd.simulate(model, log="full", path="run.nc")]', 100.0),
    "completed": ('run = xd.simulate(model, log="states"); return [run, xd.complete(run)]', 130.0),
    "sampled": ('run = xd.simulate(model, log="states"); return [run, xd.sample(run, ["0.07 s"])]', 190.0),
}


@pytest.mark.dear
@pytest.mark.parametrize(("made", "beside"), MADE.values(), ids=MADE)
def test_a_million_elements_take_little_more_than_their_records(made: str, beside: float, tmp_path: Path) -> None:
    """Assert that reading and marching 10^6 masses takes the record and 13 numbers for each, wherever it is largest.

    Peak of resident memory, over that of a process after a small run. Where it is largest, six of them are the state that
    a step leads to, with forces and what rounding carries; the one that it leads from is in the record at the end. What is
    made of a record reads its model again, and to sample it a step and its two halves are marched.
    """
    small, large = (CHAIN.format(n=n) for n in (1000, 1_000_000))
    words = [sys.executable, "-c", PEAK.format(made=made, small=small, large=large)]
    said = subprocess.run(words, capture_output=True, text=True, check=True, cwd=tmp_path).stdout
    taken, record = map(float, said.split())
    assert record > 120.0
    assert taken < record + beside


ROD = """
name = "A rod of many cells"
[dimensions]
cell = {n}
[states.T]
unit = "K"
dims = ["cell"]
rate = "(shift(T, cell, -1, 0*kelvin) - 2*T + shift(T, cell, 1, 0*kelvin))/second"
[initial]
T = "kelvin*sin(2*pi*index(cell)/1000)"
[run]
method = "radau_iia"
rtol = 1e-4
atol = {{ T = "1e-4 K" }}
until = "1e4 s"
"""


@pytest.mark.dear
def test_a_million_cells_by_radau_take_forty_numbers_each(tmp_path: Path) -> None:
    """Assert that the heat equation of 10^6 cells takes its record and 43 numbers a cell: 12 are factors, 9 of stages."""
    made = 'return [xd.simulate(model, log="states")]'
    words = [sys.executable, "-c", PEAK.format(made=made, small=ROD.format(n=1000), large=ROD.format(n=1_000_000))]
    run = subprocess.run(words, capture_output=True, text=True, check=True, cwd=tmp_path)
    taken, record = map(float, run.stdout.split())
    assert record > 120.0
    assert taken < record + 330.0


WRITE = """
import sys
import xdynamics as xd

for i, text in enumerate(sys.argv[1:]):
    xd.simulate(xd.Model.from_text(text), log="states", path=f"{i}.nc").close()
"""
AGAIN = """
import resource
import xdynamics as xd

peaks = []
for name in ("0.nc", "1.nc"):
    assert xd.reproduce(name).attrs["identical"] == 1
    peaks.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
print(peaks[1] - peaks[0])
"""


@pytest.mark.dear
def test_a_million_elements_by_an_expression_are_reproduced(tmp_path: Path) -> None:
    """Assert that an archive with 10^6 masses by an expression has it as a text, and the peak of memory to repeat it."""
    mass = 'm = { dims = ["site"], value = "(1 + 0.1*index(site))*kilogram" }'
    texts = [CHAIN.format(n=n).replace('m = "1 kg"', mass) for n in (1000, 1_000_000)]
    subprocess.run([sys.executable, "-c", WRITE, *texts], check=True, cwd=tmp_path)
    said = subprocess.run([sys.executable, "-c", AGAIN], capture_output=True, text=True, check=True, cwd=tmp_path)
    with xd.open_run(tmp_path / "1.nc") as run:
        assert len(run.model_toml.values.item()) < 1000
        assert float(said.stdout) < run.nbytes / 2**20 + 210.0


def test_states_left_to_the_record_are_those_that_were_copied(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert the same record, fastest rates too, whether a march copies some of its rows, and steps their samples, or not."""
    model = xd.Model.from_text(
        CHAIN.format(n=50)
        .replace('A = "1 m"', 'A = "1 m"\nlimit = "0.15 m"')
        .replace(
            "k*(second(u, spring) - first(u, spring))**2/2",
            "k*(second(u, spring) - first(u, spring))**2/2 + k*(second(u, spring) - first(u, spring))**4/limit**2",
        )
    )
    copied = xd.simulate(model, log="states", until="6 s")
    monkeypatch.setattr("xdynamics.record.run_dataset.WIDE", 1)
    monkeypatch.setattr("xdynamics.record.run_dataset.WIDEST", 1)
    monkeypatch.setattr("xdynamics.march.runner.LARGE", 1)
    left = xd.simulate(model, log="states", until="6 s")
    # that of another row than the first
    assert copied.attrs["run_h_omega_largest"] > 1.01 * copied.attrs["run_h_omega_start"]
    volatile = {name: left.attrs[name] for name in ("history", "date_created", "origin")}
    assert left.identical(copied.assign_attrs(volatile))


@pytest.mark.dear
def test_what_does_not_fit_is_refused_before_it_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that elements, and a march of them, for which there is no memory, are refused with both figures."""
    text = CHAIN.format(n=1_000_000)
    wide = text.replace("[relations", "column = 1_000_000\n[relations").replace(
        'dims = ["site"]', 'dims = ["site", "column"]'
    )
    with pytest.raises(xd.ModelError, match=r"'u': has 1000000000000 elements along site, column, which take 240 TB"):
        xd.Model.from_text(wide)
    model = xd.Model.from_text(text)
    monkeypatch.setattr("xdynamics.record.run_dataset.free_memory", lambda: 1e8)
    with pytest.raises(
        xd.InputError, match=r"a run of 2000000 numbers by velocity_verlet takes about .* 80 MB of memory"
    ):
        xd.simulate(model)


N = 40


def alone(model: xd.Model, settings: Settings) -> tuple[March, np.ndarray, np.ndarray]:
    """March one run; return it with its rows and events."""
    march = March(model, settings)
    blocks = list(march.blocks())
    rows = np.concatenate([block.log.rows[:, : block.rows] for block in blocks], axis=1)
    return march, rows, np.concatenate([block.log.events[: block.events] for block in blocks])


def asked(model: xd.Model, **more: Any) -> Settings:
    """Settings without force samples."""
    return settings_for(model, force_samples="none", **more)


@pytest.mark.every(7)
@pytest.mark.parametrize(
    ("name", "more"),
    [
        ("ball_drag", {"method": "dop853", "rtol": 1e-8}),
        ("ball_drag", {"method": "midpoint", "step": 0.01}),
        ("kepler", {"method": "dprkn6", "rtol": 1e-7, "until": 3.0}),
        ("pendulum", {"method": "implicit_midpoint", "step": 0.05, "until": 3.0}),
        ("rocket_c6", {"method": "heun", "rtol": 1e-4, "until": 4.0}),
        ("block_on_incline", {"method": "dormand_prince", "rtol": 1e-7, "until": 2.0}),
        ("ball_in_box", {"method": "dormand_prince", "rtol": 1e-7, "until": 2.0}),
        ("stick_slip_belt", {"method": "dormand_prince", "rtol": 1e-6, "until": 3.0}),
        (
            "cart_spring",
            {"method": "pefrl", "rtol": 1e-5, "estimator": "step_doubling", "until": 2.0, "scales": {"time": "3 s"}},
        ),
    ],
)
def test_each_run_has_the_bits_that_it_has_alone(name: str, more: dict[str, Any]) -> None:
    """Assert states, counts, outcomes, events and whole logs of every member, with parameters and starts of their own."""
    model = xd.Model.from_toml(MODELS / f"{name}.toml")
    settings, random = asked(model, **more), np.random.default_rng(3)
    parameter, start = next(iter(model.elements.statement.parameters)), settings.layout(model).used[0]
    values = model.parameters[parameter].quantity.si * random.uniform(0.9, 1.1, N)
    starts = model.initial[start].si + random.uniform(0.0, 1e-3, N)
    runs = march_many(model, settings, parameters={parameter: values}, initial={start: starts}, logs=True)
    for i in range(0, N, 13):
        changed = {
            "parameters": {parameter: f"{float(values[i])!r} {_si(model, parameter)}"},
            "initial": {start: f"{float(starts[i])!r} {_si(model, start)}"},
        }
        march, rows, events = alone(model.replace(**changed), settings)
        assert rows.tobytes() == runs.log_of(i).tobytes()
        assert events.tobytes() == runs.events_of(i).tobytes()
        counts = [int(march.now[name]) for name in ("status", "rows", "trials", "evaluations")]
        assert counts == [int(one[i]) for one in (runs.status, runs.rows, runs.trials, runs.evaluations)]
        assert runs.outcomes[i] == march.outcome.word
    assert len(np.unique(runs.state, axis=0)) == N


def _si(model: xd.Model, name: str) -> str:
    """SI unit of a parameter or initial value."""
    from xdynamics.units import spell

    return spell(model.elements.dimensions[name]).text


def test_steps_and_tolerances_of_their_own() -> None:
    """Assert that each run takes its own step or tolerance."""
    model = particle("-F*x/(1*metre)")
    runs = march_many(model, asked(model, method="midpoint", step=0.1, until=1.0), steps=[0.1, 0.05, 0.03])
    assert runs.rows.tolist() == [11, 21, 35]
    judged = asked(model, method="dormand_prince", rtol=1e-3, atol=1e-9, until=9.0)
    runs = march_many(model, judged, rtols=[1e-3, 1e-6, 1e-9])
    assert (
        runs.state[1].tobytes()
        == alone(model, asked(model, method="dormand_prince", rtol=1e-6, atol=1e-9, until=9.0))[0].run.y[:2].tobytes()
    )
    assert runs.rows[0] < runs.rows[1] < runs.rows[2]
    runs = march_many(
        model, asked(model, method="dormand_prince", rtol=1e-3, until=9.0), rtols=[1e-9]
    )  # and atol with it
    assert (
        runs.state[0].tobytes()
        == alone(model, asked(model, method="dormand_prince", rtol=1e-9, until=9.0))[0].run.y[:2].tobytes()
    )


def test_each_run_begins_on_its_grid() -> None:
    """Assert that from a start that is no round number the first step of every run is the grid's, to the bit."""
    model = particle("F*t/second", initial={"t": "0.3 s", "x": "1 m", "v_x": "0 m s-1"})
    settings = asked(model, method="midpoint", step=0.1, until=1.1)
    runs = march_many(model, settings, parameters={"F": [5.0, 5.0, 5.0]}, logs=True)
    _, rows, _ = alone(model, settings)
    assert rows[1, 1] == 0.1
    assert [runs.log_of(i).tobytes() for i in range(3)] == [rows.tobytes()] * 3


@pytest.fixture(scope="module")
def bouncing() -> tuple[xd.Model, Settings, np.ndarray]:
    """A ball thrown at many speeds."""
    model = xd.Model.from_toml(MODELS / "ball_drag.toml")
    return model, asked(model, method="heun", rtol=1e-6), np.linspace(5.0, 30.0, 3000)


@pytest.mark.dear
def test_threads_and_logs_change_nothing(bouncing: tuple[xd.Model, Settings, np.ndarray]) -> None:
    """Assert that the result is that of one thread without logs, events that overflow the log included."""
    model, settings, speeds = bouncing
    found = [
        march_many(model, settings, initial={"v_y": speeds}, threads=n, logs=logs)
        for n, logs in ((1, False), (2, False), (4, True))
    ]
    for other in found[1:]:
        for name in ("time", "state", "status", "rows", "trials", "evaluations", "events", "first_event"):
            assert getattr(other, name).tobytes() == getattr(found[0], name).tobytes(), name
    assert len(found[0].events) == found[0].first_event[-1] > 4000
    with pytest.raises(xd.InputError, match="no logs were kept; run with logs=True"):
        found[0].log_of(0)


def test_a_run_that_fails_is_a_member_with_its_outcome() -> None:
    """Assert that one bad run ends as it does alone, and the others go on."""
    model = particle("F/where(x > 5*metre, 0, 1)")
    runs = march_many(model, asked(model, method="midpoint", step=0.1, until=0.5), initial={"x": [1.0, 4.9, 2.0]})
    assert runs.outcomes == ["completed", "nonfinite_state", "completed"]
    assert isinstance(runs, Runs)
    assert np.isfinite(runs.state).all()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"parameters": {"q": [1.0]}}, "parameter 'q' is none of m, F"),
        ({"initial": {"t": [1.0]}}, "initial value 't' is none of x, v_x"),
        ({"parameters": {"m": [1.0, float("nan")]}}, "parameter 'm' of run 1 is nan, needs a finite number"),
        ({"steps": [0.1, -0.1]}, "step of run 1 is -0.1, needs a positive time"),
        ({"rtols": [1e-3]}, "rtols are for chosen or judged steps"),
        ({"parameters": {"m": [1.0]}, "initial": {"x": [1.0, 2.0]}}, "arrays have 1, 2 numbers; all need the same"),
        ({"parameters": {"m": []}}, r"parameter 'm' has the shape \(0,\), needs one number for each run"),
        ({"parameters": {"m": [[1.0]]}}, r"parameter 'm' has the shape \(1, 1\)"),
        ({"parameters": {"m": ["heavy"]}}, r"parameter 'm' is \['heavy'\], needs one number for each run"),
        ({"steps": [1e-17]}, r"a run with step 1e-17: step 1e-17 s makes over 2\*\*53 steps"),
        ({}, "nothing varies; give parameters, initial, steps or rtols"),
    ],
)
def test_wrong_arrays_are_named(given: dict[str, Any], message: str) -> None:
    """Assert that every fault is told by its array, run and value."""
    model = particle("F")
    with pytest.raises(xd.InputError, match=message):
        march_many(model, asked(model, method="midpoint", step=0.1, until=1.0), **given)


def test_first_steps_and_starts_are_held_to_what_one_run_is() -> None:
    """Assert that limits of chosen steps and a scale for every error are asked of every member."""
    model = particle("F")
    limited = asked(model, method="dormand_prince", rtol=1e-3, max_step=0.1, until=1.0)
    with pytest.raises(xd.InputError, match="a run with step 3.0: step, the first one, is 3.0 s, needs to be from"):
        march_many(model, limited, steps=[0.05, 3.0])
    bare = asked(model, method="dormand_prince", rtol=1e-3, atol={"x": 0.0, "v_x": 1e-9}, until=1.0)
    with pytest.raises(xd.InputError, match="atol of 'x' is 0 and a run starts at x = 0"):
        march_many(model, bare, initial={"x": [1.0, 0.0]})


ROW_OF_SITES = """
name = "chain"
[dimensions]
site = 26
[relations.spring]
of = "site"
neighbours = 1
[coordinates]
u = { unit = "mm", dims = ["site"] }
[mass]
u = "2*kilogram"
[forces.springs]
over = "spring"
potential = "kilogram/second**2*(second(u, spring) - first(u, spring))**2/2"
[initial]
u = "metre*sin(index(site))"
[observables]
stretch = "u[1] - u[0]"
"""
PASSAGE = """
[events.passage]
function = "u[3]"
direction = "either"
action = "record"
"""
ASKED: dict[str, dict[str, Any]] = {
    "all of a grid": {"method": "rk4", "step": "0.1 s", "until": "1 s", "force_samples": "all"},
    "events of chosen steps": {"method": "bogacki_shampine", "rtol": 1e-4, "atol": 1e-6, "until": "3 s"},
    "states": {"method": "velocity_verlet", "step": "0.1 s", "until": "1 s", "log": "states"},
    "one in three": {"method": "velocity_verlet", "step": "0.1 s", "until": "1 s", "keep_every": 3},
}


def test_numbers_of_a_row_stand_side_by_side() -> None:
    """Assert that a step writes one piece of memory, and that narrow rows keep their columns in one piece each."""
    wide, narrow = (xd.Model.from_text(ROW_OF_SITES.replace("site = 26", f"site = {n}")) for n in (26, 5))
    for model, order in ((wide, "F"), (narrow, "C")):
        march = March(model, settings_for(model, method="velocity_verlet", step="0.1 s", until="1 s"))
        for block in march.blocks():
            assert block.log.rows.shape[1] > 10
            for table in (block.log.rows, block.log.samples):
                assert table.flags["F_CONTIGUOUS"] is (order == "F")
                assert table.flags["C_CONTIGUOUS"] is (order == "C")


@pytest.mark.parametrize("asked", ASKED.values(), ids=ASKED)
def test_a_record_does_not_show_the_order_of_its_log(asked: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a march, one stopped and gone on, and its lone columns have the bits that logs by columns give."""
    watched = asked["method"] == "bogacki_shampine"
    model = xd.Model.from_text(ROW_OF_SITES + PASSAGE if watched else ROW_OF_SITES)

    def runs() -> list[xr.Dataset]:
        half = xd.simulate(model, **asked)
        return [half, xd.extend(half, until="4 s")]

    usual = runs()
    assert (usual[0].sizes["event"] > 0) is watched
    assert usual[0].step_size.values.flags["C_CONTIGUOUS"]
    monkeypatch.setattr("xdynamics.march.log.is_wide", lambda _: False)
    for run, other in zip(usual, runs(), strict=True):
        assert set(run.variables) == set(other.variables)
        for name, values in run.variables.items():
            np.testing.assert_array_equal(values.values, other[name].values, strict=True)


@pytest.mark.parametrize("asked", ASKED.values(), ids=ASKED)
def test_rows_of_a_million_numbers_are_streamed_one_by_one(
    asked: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert that a stream of such rows has one log of one row, two where rows are left out, and the bits of others."""
    watched, rows = asked["method"] == "bogacki_shampine", list[int]()
    model = xd.Model.from_text(ROW_OF_SITES + PASSAGE if watched else ROW_OF_SITES)
    usual = xd.simulate(model, **asked, path=tmp_path / "usual.nc")

    def counted(layout: Any, settings: Any, count: int, *more: Any) -> Any:
        rows.append(count)
        return log_of(layout, settings, count, *more)

    monkeypatch.setattr("xdynamics.archive.segments.WIDE_NUMBERS", 1)
    monkeypatch.setattr("xdynamics.march.runner.log_of", counted)
    with usual, xd.simulate(model, **asked, path=tmp_path / "run.nc") as run:
        assert [count for count in rows if count] == [1] * (1 + ("keep_every" in asked))
        assert run.attrs["content_digest"] == usual.attrs["content_digest"]

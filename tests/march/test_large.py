"""Models with many coordinates keep what their motions keep."""

from __future__ import annotations

import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from large_problems import BODIES, chain, fput, outer_solar_system, toda
from numpy.typing import NDArray

import xdynamics as xd
from cases.problems import EPS
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
    assert len(model.statement.coordinates) == 3 * len(BODIES) == 18
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
    assert len(model.statement.mass_entries) == CHAINED
    assert not model.mass_is_full


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
        xd.InputError, match=r"a march of 2000000 numbers by velocity_verlet takes about .* 80 MB of memory"
    ):
        xd.simulate(model)

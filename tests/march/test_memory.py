"""The bytes of a run are all that a march needs to go on, in another process too.

What a march takes for each element is what it says before it begins, and no more than was counted.
Fields are marched without names of their elements, and without large arrays of what their Jacobians have where.
Marches of one model with equal settings, which begin with copies of the same numbers.
"""

from __future__ import annotations

import hashlib
import subprocess
import sys
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.problems import MODELS, particle
from xdynamics.documenting.manual import manual_text
from xdynamics.kernels import layout_of
from xdynamics.kernels.newton_matrix import pattern_of
from xdynamics.march import March
from xdynamics.march.configuration import settings_for
from xdynamics.march.dense_output import posed_inside
from xdynamics.march.engine import engine
from xdynamics.march.initial_run import addresses_of, pose_run
from xdynamics.march.log import LOG_COUNTS, allocate, log_of
from xdynamics.march.memory import changing_arrays, put_back
from xdynamics.march.run import ARRAYS, Lifetime, Run
from xdynamics.march.runner import recurs
from xdynamics.record.run_dataset import sizes_of_march

KINDS: dict[str, dict[str, Any]] = {
    "fixed": {"step": 0.02},
    "adaptive": {"rtol": 1e-3, "atol": 1e-4},
    "doubled": {"rtol": 2e-3, "atol": 2e-3, "estimator": "step_doubling"},
    "extrapolated": {"step": 0.05, "estimator": "step_doubling_extrapolated"},
    "given": {"step": [0.01, 0.02, 0.03] * 40},
}
CASES = [(name, kind) for name in xd.METHODS for kind in KINDS]


def march_of(method: str, kind: str) -> March:
    """A march with events, drives and nodes where the method takes them."""
    rocket = xd.Model.from_toml(MODELS / "rocket_c6.toml")
    name = "pendulum" if xd.METHODS[method].solves or xd.METHODS[method].refusals(rocket) else "rocket_c6"
    model = xd.Model.from_toml(MODELS / f"{name}.toml")
    return March(model, settings_for(model, method=method, until=2.2, **KINDS[kind]))


def marched(march: March, first: int = 1 << 40) -> bytes:
    """March into a log that holds all; return the bytes of the log from a row on, and of the end."""
    log = allocate(march.layout, 20_000, sampled=int(march.run.plan[0].samples))
    log.follow(*(int(march.now[name]) for name in LOG_COUNTS))
    log.lend(march.run)
    engine().march(march.run, first)
    return logged(march, log) + bytes_of(march)


def bytes_of(march: March) -> bytes:
    """Return all that a march changes but its log."""
    return b"".join(one.tobytes() for one in changing_arrays(march.run).values())


def logged(march: March, log: Any) -> bytes:
    """Return the bytes of the log's rows."""
    counts = [int(march.now[name] - log.base[0][name]) for name in LOG_COUNTS]
    parts = (log.rows[:, : counts[0]], log.trials[: counts[1]], log.events[: counts[2]], log.samples[:, : counts[3]])
    return b"".join(np.ascontiguousarray(part.T).tobytes() for part in parts)


@pytest.mark.every(37)
@pytest.mark.parametrize(("method", "kind"), CASES)
def test_a_march_goes_on_from_its_bytes(method: str, kind: str) -> None:
    """Assert that a march that is stopped at a random row and put into another run ends with the same bytes."""
    whole = march_of(method, kind)
    marched(whole)
    rows = int(whole.now.rows)
    assert rows > 5
    row = int(np.random.default_rng(rows + len(method)).integers(1, rows - 1))
    first, second = march_of(method, kind), march_of(method, kind)
    marched(first, row)
    put_back(second.run, changing_arrays(first.run))
    marched(second)
    assert bytes_of(second) == bytes_of(whole)


OTHER = """
import hashlib, pickle, sys
from test_memory import march_of, marched, put_back
for method, kind, memory in pickle.load(sys.stdin.buffer):
    march = march_of(method, kind)
    put_back(march.run, memory)
    print(hashlib.sha256(marched(march)).hexdigest())
"""


@pytest.mark.dear
def test_in_another_process_too() -> None:
    """Assert the same of 20 methods and kinds of step whose second half is marched by a process of its own."""
    import pickle

    given, expected = [], []
    for method, kind in CASES[:: len(CASES) // 20]:
        whole, half = march_of(method, kind), march_of(method, kind)
        marched(whole)
        marched(half, int(whole.now.rows) // 2)
        given.append((method, kind, changing_arrays(half.run)))
        expected.append(hashlib.sha256(marched(half)).hexdigest())
    command = [
        sys.executable,
        "-c",
        f"import sys; sys.path += [{str(Path(__file__).parent)!r}, {str(Path(__file__).parents[1])!r}]\n{OTHER}",
    ]
    told = subprocess.run(command, input=pickle.dumps(given), capture_output=True, check=True).stdout.decode().split()
    assert told == expected


def test_a_memory_goes_back_into_a_march_that_went_on() -> None:
    """Assert that a run whose log is half full takes an earlier memory, and goes on from there to the same bytes."""
    march = march_of("midpoint", "fixed")
    blocks = march.blocks(20)
    next(blocks)
    early = changing_arrays(march.run)
    for _ in range(3):
        next(blocks)
    put_back(march.run, early)
    marched(march)
    whole = march_of("midpoint", "fixed")
    marched(whole)
    assert bytes_of(march) == bytes_of(whole)


def test_a_memory_of_another_form_is_refused() -> None:
    """Assert that the first array that has another form is named, and nothing is changed."""
    march, other = march_of("midpoint", "fixed"), march_of("rk4", "fixed")
    before = bytes_of(march)
    with pytest.raises(xd.InputError, match=r"the run's '\w+' has another form than here"):
        put_back(march.run, changing_arrays(other.run))
    assert bytes_of(march) == before


@pytest.mark.parametrize(
    ("name", "until"), [("woodpecker", 0.3), ("block_on_incline", 2.0), ("granular_box", 0.2), ("rocket_c6", 1.0)]
)
def test_every_number_of_the_log_is_written(name: str, until: float) -> None:
    """Assert that rows, trials and events have the same bytes, whatever was in the memory that they are written to."""
    model = xd.Model.from_toml(MODELS / f"{name}.toml")
    settings = settings_for(model, until=until)
    logs = []
    for filling in (0x00, 0xA5):
        march = March(model, settings)
        log = allocate(march.layout, 5_000, sampled=int(march.run.plan[0].samples))
        for part in ("rows", "trials", "events", "samples"):
            getattr(log, part).view(np.uint8)[...] = filling
        log.lend(march.run)
        engine().march(march.run, 1 << 40)
        assert march.now.events > log.base[0]["events"]
        logs.append(logged(march, log))
    assert logs[0] == logs[1]


CELLS = 4000
BLOCK = 64  # numbers that are looked at together
NOT_COUNTED = (Lifetime.LOG, Lifetime.ADDRESS)


def rod(cells=CELLS):
    """Return a rod in which heat is conducted."""
    return xd.Model(
        name="rod",
        dimensions={"cell": cells},
        states={
            "T": {
                "unit": "K",
                "dims": ["cell"],
                "rate": "(shift(T, cell, -1, 0*kelvin) - 2*T + shift(T, cell, 1, 0*kelvin))/second",
            }
        },
        initial={"T": "kelvin*(2 + sin(index(cell)))"},
    )


def written(run):
    """Return the bytes of a march's arrays that something was written to, each memory once."""
    found, places = 0, set()
    for name, array in ARRAYS.items():
        values = getattr(run, name)
        if array.owner or array.lifetime in NOT_COUNTED or values.dtype.names or values.ctypes.data in places:
            continue
        places.add(values.ctypes.data)
        numbers = values.reshape(-1)
        blocks = np.add.reduceat(numbers != 0, np.arange(0, numbers.size, BLOCK)) if numbers.size else np.zeros(0)
        found += np.count_nonzero(blocks) * BLOCK * values.itemsize
    return found


@pytest.mark.parametrize("tolerances", [{"rtol": 1e-4, "atol": 1e-6}, {"rtol": 1e-4}])
def test_radau_takes_for_a_cell_what_is_told(tolerances, monkeypatch):
    """Assert that a march writes to 95 to 101 % of the bytes that are told, 312 for a cell."""
    monkeypatch.setattr("xdynamics.march.memory.LARGE", 1)  # what a start alone needs is given back
    model = rod()
    march = March(model, settings_for(model, method="radau_iia", until="3 s", **tolerances))
    told = sizes_of_march(march)
    for _block in march.blocks():
        pass
    assert march.accepted > 2
    beside = sum(told.values()) - told["a row of the log"]
    assert 0.95 * beside < written(march.run) < 1.01 * beside
    assert beside / CELLS == pytest.approx(
        312.0, abs=0.5
    )  # factors 104, derivatives 60, stages 72 and 16, states 32, errors 28
    assert f"takes {sum(told.values()) / CELLS:.0f}: factors" in " ".join(
        manual_text("shapes.md").replace("`", "").split()
    )


def test_what_would_not_fit_is_named_before_the_march(monkeypatch):
    """Assert that a wide band, whose factors are the most, is refused with its size, the largest part and a remedy."""
    model = xd.Model.from_text(PLATE)
    monkeypatch.setattr("xdynamics.record.run_dataset.free_memory", lambda: 1e8)
    with pytest.raises(xd.InputError) as caught:
        xd.simulate(model, method="radau_iia", rtol=1e-4, until="1 s")
    said = str(caught.value)
    assert "a run of 12100 numbers by radau_iia takes about 99 MB" in said
    # 24*12100*331 bytes: of 110 above the diagonal, 110 below, and 110 for row exchanges
    assert "96 MB of it factors of a real and a complex matrix" in said
    assert "80 MB of memory can be had" in said
    assert "a method that solves no equations" in said
    assert xd.simulate(model, method="rk4", step="0.1 s", until="0.1 s").sizes["step"] == 2


PLATE = """
name = "plate"
[dimensions]
row = 110
column = 110
[states.T]
unit = "K"
dims = ["row", "column"]
rate = "(shift(T, row, -1, 0*kelvin) + shift(T, row, 1, 0*kelvin) - 4*T + shift(T, column, -1, 0*kelvin) + shift(T, column, 1, 0*kelvin))/second"
[initial]
T = "kelvin*sin(index(row))"
"""


CHAIN = """
name = "chain"
[dimensions]
site = {n}
[coordinates]
u = {{ unit = "m", dims = ["site"] }}
[parameters]
m = "1 kg"
k = "100 N m-1"
[mass]
u = "m"
[relations.spring]
of = "site"
neighbours = 1
[forces.springs]
over = "spring"
potential = "k*(second(u, spring) - first(u, spring))**2/2"
[initial]
u = "sin(pi*(index(site) + 1)/(size(site) + 1))*metre"
"""
RULES = {"float64": ("reintegrate", "interpolant"), "double_double": ("reintegrate",)}
INSIDE = [0.034, 0.0, 0.015, 0.03, 0.0151, 0.05, 0.027, 0.001]


@pytest.fixture
def one_by_one(monkeypatch):
    """Have samples found as those of many elements are, each time by itself; return the runs in which they are."""
    made = []

    def posed(*arguments, **keywords):
        made.append(posed_inside(*arguments, **keywords))
        return made[-1]

    monkeypatch.setattr("xdynamics.dynamics.shortened_steps.PIECE", 1)
    monkeypatch.setattr("xdynamics.dynamics.shortened_steps.LARGE", 1)
    monkeypatch.setattr("xdynamics.dynamics.shortened_steps.posed_inside", posed)
    return made


def test_a_sample_takes_the_two_states_of_a_step_beside_its_result(one_by_one):
    """Assert 12 numbers a site, u, v, its acceleration and what rounding carries, before and after, whatever the times."""
    sites = 10_000
    run = xd.simulate(
        xd.Model.from_text(CHAIN.format(n=sites)), method="velocity_verlet", step=0.01, until=0.05, log="states"
    )
    xd.sample(run, 0.034)
    one_by_one.clear()
    peaks = []
    for times in ([0.034] * 2, [0.034, 0.015, 0.0151, 0.027] * 5):
        tracemalloc.start()
        held = xd.sample(run, times).nbytes
        peaks.append(tracemalloc.get_traced_memory()[1] - held)
        tracemalloc.stop()
    assert written(one_by_one[0]) / sites == pytest.approx(96.0, rel=0.05)
    assert abs(peaks[1] - peaks[0]) < 8 * sites


def test_a_sample_by_radau_keeps_no_force_samples(one_by_one):
    """Assert what a march of the equations takes, without tolerances that follow, and the end of the whole step."""
    run = xd.simulate(rod(), method="radau_iia", rtol=1e-4, atol=1e-6, until="3 s")
    xd.sample(run, [0.3, 1.5])
    assert written(one_by_one[0]) / CELLS == pytest.approx(296.0, rel=0.05)


@pytest.mark.parametrize(
    "settings",
    [
        {"method": "velocity_verlet", "step": 0.01},
        {"method": "radau_iia", "rtol": 1e-4},
        {"method": "rk4", "step": 0.01, "precision": "double_double"},
    ],
    ids=lambda settings: "_".join(map(str, settings.values())),
)
def test_samples_found_one_by_one_have_the_same_bits(settings, request):
    """Assert that states and errors are those that are found together, at accepted times too, in any order."""
    run = xd.simulate(xd.Model.from_text(CHAIN.format(n=7)), until=0.05, **settings)
    together = [xd.sample(run, INSIDE, rule=rule) for rule in RULES[settings.get("precision", "float64")]]
    request.getfixturevalue("one_by_one")
    apart = [xd.sample(run, INSIDE, rule=rule) for rule in RULES[settings.get("precision", "float64")]]
    for one, other in zip(together, apart, strict=True):
        assert one.identical(other)


def test_a_refinement_holds_one_record_at_a_time(monkeypatch):
    """Assert the bits of levels that are all held, in more memory, and 2,983 bytes a site over the result."""
    sites = 3000
    model = xd.Model.from_text(CHAIN.format(n=sites))
    asked = {"method": "velocity_verlet", "until": 0.04, "at": [0.04, 0.025], "observables": ["u"]}
    monkeypatch.setenv("XDYNAMICS_REMEMBERED_LIMIT", "0")
    xd.refine(model, steps=[0.01, 0.005], **asked)

    def refined():
        tracemalloc.start()
        study = xd.refine(model, steps=[0.01, 0.005, 0.0025], **asked)
        beside = (tracemalloc.get_traced_memory()[1] - study.nbytes) / sites
        tracemalloc.stop()
        return study, beside

    study, beside = refined()
    assert beside < 1.1 * 2983.0
    monkeypatch.setattr("xdynamics.evidence.refining.subjects.StudyQuantities.foreseen", False)
    held, more = refined()
    assert more > beside
    assert set(study.variables) == set(held.variables)
    for name, variable in study.variables.items():
        assert variable.identical(held.variables[name])


FIELD = """
name = "A rod of many cells"
[dimensions]
cell = {cells}
[parameters]
rate = "1 s-1"
[states.T]
unit = "K"
dims = ["cell"]
rate = "rate*(shift(T, cell, -1, 0*kelvin) - 2*T + shift(T, cell, 1, 0*kelvin))"
[initial]
T = "kelvin*sin(2*pi*index(cell)/1000)"
[run]
method = "radau_iia"
rtol = 1e-6
until = "0.5 s"
"""


def field(cells: int) -> xd.Model:
    """Return the model with a number of cells."""
    return xd.Model.from_text(FIELD.format(cells=cells))


@pytest.mark.parametrize("asked", [{}, {"atol": {"T": "1e-9 K"}}, {"atol": 1e-9}], ids=["none", "block", "bare"])
def test_a_march_makes_no_names_of_elements(asked: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a field is read, checked, marched by Radau and judged without the names of its cells."""

    def names(name: str, extents: tuple[object, ...]) -> Iterator[str]:
        assert not extents, f"the names of the elements of '{name}' are made"
        return iter([name])

    model = field(2000)
    monkeypatch.setattr("xdynamics.shapes.blocks.element_names", names)
    monkeypatch.setattr("xdynamics.shapes.extents.element_names", names)
    run = xd.simulate(model, **asked)
    assert run.sizes["step"] > 2
    assert run.attrs["run_outcome"] == "completed"


def test_a_tolerance_of_a_block_stays_one() -> None:
    """Assert that a tolerance of a whole field is one number, and that of an element beside it counts before."""
    model = field(2000)
    given = settings_for(model, atol={"T[3]": "1e-3 K", "T": "1e-9 K"}).tolerances
    assert given is not None
    assert dict(given.atol) == {"T": 1e-9, "T·3": 1e-3}
    assert (given.atol_of("T·3"), given.atol_of("T·4")) == (1e-3, 1e-9)
    atols = given.of_all(layout_of(model).used)
    assert atols[3] == 1e-3
    assert set(np.delete(atols, 3).tolist()) == {1e-9}


def test_a_tolerance_of_a_block_is_that_of_each_element(tmp_path: Path) -> None:
    """Assert the same record, which says the same tolerance, whether all elements are named or their block; and a rerun."""
    model = field(20)
    block = xd.simulate(model, atol={"T": "1e-9 K"})
    elements = xd.simulate(model, atol={f"T[{i}]": "1e-9 K" for i in range(20)})
    assert block.T.attrs["atol"] == elements.T.attrs["atol"] == 1e-9
    assert xd.content_digest(block) == xd.content_digest(elements)
    xd.save(block, tmp_path / "field.nc")
    assert xd.reproduce(tmp_path / "field.nc").attrs["identical"] == 1
    assert xd.simulate(model).sizes["step"] != block.sizes["step"]


def test_the_pattern_of_a_field_takes_few_bytes_a_cell() -> None:
    """Assert that the pattern of a tridiagonal Jacobian is 24 bytes a cell and is found in at most 160 (340 in 64 bits)."""
    cells = 100_000
    layout = layout_of(field(cells))
    tracemalloc.start()
    try:
        pattern = pattern_of(layout)
        held, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(pattern.entries) == 3 * cells - 2
    assert pattern.entries.nbytes == 8 * len(pattern.entries)
    assert held < 32 * cells
    assert peak < 160 * cells


BEGINNINGS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("harmonic_oscillator", {"method": "velocity_verlet", "step": 0.05}),
    ("harmonic_oscillator", {"method": "taylor", "rtol": 1e-9}),
    ("kepler", {"method": "dop853", "rtol": 1e-9, "atol": 1e-9}),
    ("kepler", {"method": "radau_iia", "rtol": 1e-6}),
)


def marches(name: str, asked: dict[str, Any]) -> tuple[March, March]:
    """Two marches alike, of which the first is over."""
    model = xd.Model.from_toml(MODELS / f"{name}.toml")
    settings = settings_for(model, until=3.0, **asked)
    assert recurs(model, settings, settings.layout(model))
    first, second = March(model, settings), March(model, settings)
    assert sum(block.rows for block in first.blocks()) > 5
    return first, second


def filled(run: Run) -> dict[str, Any]:
    """The arrays that have elements, but for the log, of which there is none yet."""
    arrays = {name: getattr(run, name) for name in ARRAYS}
    return {name: array for name, array in arrays.items() if array.size and not name.startswith("log_")}


@pytest.mark.parametrize(("name", "asked"), BEGINNINGS)
def test_beginning(name: str, asked: dict[str, Any]) -> None:
    """Assert that a march begins with the bits it is posed with, whatever another did before, on a line of the cache."""
    _, march = marches(name, asked)
    law, settings = march.law, march.settings
    alone = pose_run(march.model, settings, law, log_of(march.layout, settings, 0), addresses_of(law))
    found, expected = filled(march.run), filled(alone)
    assert found.keys() == expected.keys()
    assert not [key for key, array in expected.items() if array.tobytes() != found[key].tobytes()]
    assert (march.run.w.ctypes.data * bool(march.run.w.size)) % 64 == 0


@pytest.mark.parametrize(("name", "asked"), BEGINNINGS)
def test_memory_of_its_own(name: str, asked: dict[str, Any]) -> None:
    """Assert that marches share no number, for compiled code too: each changes its own state alone."""
    first, second = marches(name, asked)
    own, others = filled(first.run), filled(second.run)
    assert not [key for key in own if np.shares_memory(own[key], others[key])]
    before = {key: array.tobytes() for key, array in own.items()}
    assert second.run.y.tobytes() != before["y"]
    assert sum(block.rows for block in second.blocks()) > 5
    assert second.run.y.tobytes() == before["y"]
    assert {key: array.tobytes() for key, array in own.items()} == before


def test_times_as_they_are_written() -> None:
    """Assert that settings that are equal as floats only begin each with its own numbers."""
    model = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml").replace(initial={"t": "-1 s"})
    ends = [xd.simulate(model, method="rk4", step=0.25, until=end).time.values[-1] for end in (0.0, -0.0)]
    assert np.signbit(ends).tolist() == [False, True]
    third = [
        xd.simulate(model, method="rk4", step=0.25, until=end, precision="double_double")
        for end in (f"{1 / 3!r} s", "0.33333333333333333333 s")
    ]
    assert third[0].rest_time.values[-1] != third[1].rest_time.values[-1]


@pytest.mark.parametrize(("count", "is_kept"), [(63, True), (64, False)])
def test_many_parameters(count: int, is_kept: bool) -> None:
    """Assert that little is kept of each model: of 64 parameters at most, each time by the values of the model."""
    own = {"m": "1 kg", "k": {"dims": ["spring"], "value": np.ones(count), "unit": "N m-1"}}
    model = particle(
        name="springs",
        dimensions={"spring": count},
        parameters=own,
        forces={"pull": {"x": "-sum(k, spring)*x"}},
        initial={"x": "1 m", "v_x": "0 m s-1"},
    )
    settings = settings_for(model, method="rk4", step=0.01, until=0.1)
    assert recurs(model, settings, settings.layout(model)) == is_kept

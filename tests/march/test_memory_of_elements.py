"""What a march takes for each element is what it says before it begins, and no more than was counted."""

import tracemalloc

import numpy as np
import pytest

import xdynamics as xd
from xdynamics.documenting.model_pages import shapes_page
from xdynamics.march import March
from xdynamics.march.configuration import settings_for
from xdynamics.march.dense_output import posed_inside
from xdynamics.march.run import ARRAYS, Lifetime
from xdynamics.record.run_dataset import sizes_of_march

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
    assert f"takes {sum(told.values()) / CELLS:.0f}: factors" in " ".join(shapes_page())


def test_what_would_not_fit_is_named_before_the_march(monkeypatch):
    """Assert that a wide band, whose factors are the most, is refused with its size, the largest part and a remedy."""
    model = xd.Model.from_text(PLATE)
    monkeypatch.setattr("xdynamics.record.run_dataset.free_memory", lambda: 1e8)
    with pytest.raises(xd.InputError) as caught:
        xd.simulate(model, method="radau_iia", rtol=1e-4, until="1 s")
    said = str(caught.value)
    assert "a march of 12100 numbers by radau_iia takes about 99 MB" in said
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

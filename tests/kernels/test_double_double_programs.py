"""Programs of sums of two floats: as machine code and as printed Python one computation, to the bit."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

import xdynamics as xd
from cases.bench import Bench
from cases.problems import MODELS
from xdynamics.kernels import law_of, layout_of
from xdynamics.kernels.law import CONTROL
from xdynamics.methods.scheme import DOUBLE_DOUBLE, Scheme

CHEAP = [("kepler", "velocity_verlet"), ("driven", "velocity_verlet")]
DEAR = [(name, method) for name in ("kepler", "driven") for method in ("rk4", "heun", "dop853", "taylor")]
FUNCTIONS = "sin(u)*cos(u) + exp(-u) + log(1 + u*u) + sqrt(1 + u*u) + atan2(u, 2) + tanh(u) + abs(u) + (1 + u*u)**(1/3)"
MARCHED = """
import xdynamics as xd
model = xd.Model(
    name="driven", coordinates={"x": {"unit": "mm"}}, parameters={"k": "0.1 N m-1", "m": "0.3 kg", "w": "1.1 s-1"},
    mass={"x": "m"}, forces={"spring": {"x": "-k*x + 0.01*newton*sin(w*t)"}},
    events={"middle": {"function": "x", "action": "reset", "set": {"v_x": "-0.9*v_x"}}},
    initial={"x": "1.1 mm", "v_x": "-12.3 mm s-1"})
run = xd.simulate(model, until="0.25 s", method="rk4", step="0.1 s", precision="double_double")
print(run.sizes["event"], xd.content_digest(run))
"""


def driven() -> xd.Model:
    """Return a point under a force of most functions of the language, with a table, an event and what it sets."""
    table = {"table": "p.csv", "csv": "t [s],pull [N]\n0,0\n0.1,3\n0.4,1\n9,0\n"}
    return xd.Model(
        name="driven",
        coordinates={"x": "m"},
        parameters={"m": "0.3 kg"},
        mass={"x": "m"},
        forces={
            "all": {"x": f"0.1*newton*({FUNCTIONS.replace('u', 'x/metre')}) + pull*where(v_x > 0*metre/second, 1, 3)"}
        },
        drives={"pull": table},
        events={"gate": {"function": "x - 0.3*metre", "action": "reset", "set": {"v_x": "-0.9*v_x"}}},
        observables={"height": "x**2/metre"},
        initial={"x": "0.1 m", "v_x": "0.7 m s-1"},
    )


@pytest.mark.parametrize(("name", "method"), [*CHEAP, *(pytest.param(*case, marks=pytest.mark.dear) for case in DEAR)])
def test_printed_python_has_the_bits_of_machine_code(name: str, method: str) -> None:
    """Assert that every program of a law fills every array alike, with numbers that have rests."""
    model = driven() if name == "driven" else xd.Model.from_toml(MODELS / f"{name}.toml")
    one = law_of(layout_of(model, Scheme(xd.METHODS[method], precision=DOUBLE_DOUBLE)), sampled=True)
    states = np.array([[one.layout.model.initial[used].si + 0.01] for used in one.layout.used])
    compiled, printed = (Bench(one, 1, states, np.array([0.01])) for _ in range(2))
    before = compiled.p.tobytes()
    for address, key in zip(one.addresses_inside[len(CONTROL) :], one.plain[len(CONTROL) :], strict=True):
        compiled.call(int(address))
        printed.call_plainly(int(key))
    for mine, other in zip(compiled.arrays(), printed.arrays(), strict=True):
        assert mine.tobytes() == other.tobytes()
    assert compiled.p.tobytes() == before
    distance = one.layout.used.size + one.layout.evaluation.size
    ends, rests = compiled.z[: one.layout.used.size, 0], compiled.z[distance : distance + one.layout.used.size, 0]
    assert np.all(rests)
    assert np.all(np.abs(rests) <= np.spacing(np.abs(ends)) / 2)


@pytest.mark.dear
def test_a_march_has_the_same_bits_without_a_compiler() -> None:
    """Assert equal digests of a march with a root and a reset in it."""
    said = [
        subprocess.run(
            [sys.executable, "-c", MARCHED], env=os.environ | more, capture_output=True, text=True, check=True
        ).stdout.split()
        for more in ({}, {"NUMBA_DISABLE_JIT": "1"})
    ]
    assert said[0] == said[1]
    assert said[0][0] == "1"

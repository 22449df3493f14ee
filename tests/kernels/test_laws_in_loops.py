"""The law of a model with dimensions, printed with loops, has the bits of its elements written out."""

from __future__ import annotations

import numpy as np
import pytest

import xdynamics as xd
from cases.array_programs import compiled, in_python
from xdynamics.kernels import layout_of, model_programs
from xdynamics.kernels.program import AT, Loop, Program, Reduction
from xdynamics.model import Model
from xdynamics.model.motion import constants

CHAIN = """
name = "chain"
[dimensions]
site = 21
[relations.spring]
of = "site"
neighbours = 1
[coordinates]
u = { unit = "m", dims = ["site"] }
[parameters]
k = "4 N m-1"
b = { dims = ["spring"], value = "newton/metre**3*(1 + index(spring))" }
A = "0.1 m"
m = { dims = ["site"], value = "kilogram*(1 + 0.1*index(site))" }
[mass]
u = "m"
[definitions]
stretch = "second(u, spring) - first(u, spring)"
[forces.springs]
over = "spring"
potential = "k*stretch**2/2 + b*stretch**4/4"
[forces.ends]
potential = "k*(u[0] + u[-1])*(u - stretch[3])/2"
[forces.drag]
u = "-0.1*kilogram/second*v_u*index(site)"
[observables]
stretching = "stretch"
furthest = "max(u, site)"
[initial]
u = "A*sin(pi*(index(site) + 1)/(size(site) + 1))"
"""
BODIES = """
name = "bodies"
[dimensions]
body = 11
axis = ["x", "y", "z"]
[relations.pair]
of = "body"
[coordinates]
r = { unit = "m", dims = ["body", "axis"] }
theta = "rad"
[parameters]
G = "1 N m2 kg-2"
s = "0.1 m"
inertia = "2 kg m2 rad-2"
m = { dims = ["body"], value = "kilogram*(1 + 0.1*index(body))" }
[mass]
r = "m"
theta = "inertia"
[definitions]
distance = "sqrt(norm(second(r, pair) - first(r, pair), axis)**2 + s**2)"
[forces.gravity]
over = "pair"
potential = "-G*first(m, pair)*second(m, pair)/distance"
[forces.thrust]
r = "where(index(axis) < 1, 1*newton, 0*newton)*t/second + sin(theta/radian)*newton"
[forces.twist]
potential = "inertia*theta**2/(2*second**2) + newton*r[3, y]*theta/radian"
[regimes.on]
forces = ["gravity", "thrust", "twist"]
[regimes.off]
forces = ["gravity", "twist"]
[observables]
momentum = "sum(m*v_r, body)"
spin = "sum(m*cross(r, v_r, axis), body)"
[initial]
r = "metre*sin(3*index(body) + index(axis))*where(index(axis) > 1, 0, 1)"
theta = "1 rad"
"""
TRUSS = """
name = "truss"
[dimensions]
node = ["a", "b", "c", "d", "e", "lonely"]
axis = ["x", "y"]
[relations.bar]
of = "node"
table = "bars.csv"
csv = "first,second\\na,b\\nd,b\\nb,c\\ne,a\\nc,d\\nd,e\\na,c\\nb,e\\ne,c\\n"
[coordinates]
r = { unit = "m", dims = ["node", "axis"] }
[parameters]
stiffness = { dims = ["bar"], value = [1, 2, 3, 4, 5, 6, 7, 8, 9], unit = "N m-1" }
m = { dims = ["node"], values = { a = "1 kg", b = "2 kg", c = "1 kg", d = "1 kg", e = "3 kg", lonely = "1 kg" } }
[mass]
r = "m"
[definitions]
length = "norm(second(r, bar) - first(r, bar), axis)"
[forces.bars]
over = "bar"
potential = "stiffness*(length - 1*metre)**2/2"
[forces.dampers]
over = "bar"
r = "0.1*newton*second/metre*(second(v_r, bar) - first(v_r, bar))"
[observables]
length_of_bars = "length"
[initial]
r = "metre*(index(node) + 1)*cos(2*index(node) + index(axis))"
"""
REACTION = """
name = "reaction and diffusion"
[dimensions]
row = 5
cell = 17
[parameters]
D = "2 s-1"
feed = { dims = ["cell"], value = "(1 + index(cell))/second" }
[drives.bath]
table = "bath.csv"
csv = "t [s],bath [1]\\n0,1\\n5,2\\n9,0\\n"
[definitions]
around = "shift(a, cell, 1, bath) + roll(a, row, 1) + shift(a, cell, -1, 0) + roll(a, row, -1) - 4*a"
[states.a]
unit = "1"
dims = ["row", "cell"]
rate = "D*around + feed*a*(1 - a)*b - mean(a, cell)/second"
[states.b]
unit = "1"
dims = ["cell"]
rate = "(max(a, row) - b)/second"
smooth = true
[observables]
whole = "sum(a*b, row, cell)"
profile = "norm(a, row)"
[initial]
a = "sin(index(row)) + exp(-index(cell))"
b = "index(cell)/10"
"""
MODELS = {"chain": CHAIN, "bodies": BODIES, "truss": TRUSS, "reaction": REACTION}


def has_loops(program: Program) -> bool:
    """Whether loops were printed, which make a program shorter than its elements."""
    return any(isinstance(line, Loop | Reduction) for line in program.body)


def arrays(model: Model, runs: int = 1) -> dict[str, np.ndarray]:
    """Return numbers for a program of a model, each run's its own; a number of the state is -0.0."""
    layout, random = layout_of(model), np.random.default_rng(3)
    y = random.uniform(0.5, 1.5, (layout.record.size, runs))
    y[1] = -0.0
    p = np.array([*constants(model).values()])[:, None] * np.linspace(1, 1.1, runs)
    at = np.zeros((len(AT), runs))
    at[0], at[1] = 1.5, 1.5
    z = np.full((layout.record.size + layout.row.size, runs), np.nan)
    flat = {"y": y, "p": p, "at": at, "z": z}
    return {name: np.ascontiguousarray(array if runs > 1 else array[:, 0]) for name, array in flat.items()}


def both(name: str, which: str, monkeypatch: pytest.MonkeyPatch) -> tuple[Model, Program, Program]:
    """Return a program of a model in loops and with its elements written out."""
    text = MODELS[name]
    if name == "reaction":  # tables are tested with marches
        text = text.replace('[drives.bath]\ntable = "bath.csv"\ncsv = "t [s],bath [1]\\n0,1\\n5,2\\n9,0\\n"\n', "")
        text = text.replace("[parameters]", '[parameters]\nbath = "2"')
    model = xd.Model.from_text(text)
    write = getattr(model_programs, which)
    loops = write(layout_of(model))
    monkeypatch.setattr(model_programs, "has_loops", lambda _: False)
    elements = write(layout_of(model))
    assert has_loops(loops)
    assert not has_loops(elements)
    return model, loops, elements


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("which", ["forces", "derived"])
@pytest.mark.parametrize("abreast", [0, 1, 4, 8, 16])
def test_bits(name: str, which: str, abreast: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that forces, energies and observables have the same bits, also in Python."""
    model, loops, elements = both(name, which, monkeypatch)
    found, expected = arrays(model), arrays(model)
    compiled(elements)(**expected)
    if abreast:
        compiled(loops, abreast=abreast)(**found)
    else:
        in_python(loops)(**found)
    np.testing.assert_array_equal(found["z"].view(np.int64), expected["z"].view(np.int64))
    assert np.isfinite(found["z"]).sum() > 20 or which == "derived"


@pytest.mark.parametrize("name", MODELS)
def test_runs_side_by_side(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that lanes of runs have the bits of the elements written out."""
    model, loops, elements = both(name, "forces", monkeypatch)
    found, expected = arrays(model, 4), arrays(model, 4)
    compiled(loops, runs=4)(**found)
    compiled(elements, runs=4)(**expected)
    np.testing.assert_array_equal(found["z"].view(np.int64), expected["z"].view(np.int64))

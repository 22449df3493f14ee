"""The law of a model with dimensions, printed with loops, has the bits of its elements written out."""

from __future__ import annotations

import numpy as np
import pytest

import xdynamics as xd
from cases.array_programs import compiled, in_python
from cases.shaped_laws import MODELS
from xdynamics.kernels import law_of, layout_of, model_programs
from xdynamics.kernels.machine import AS_WRITTEN
from xdynamics.kernels.program import AT, Loop, Program, Reduction
from xdynamics.march.configuration import settings_for
from xdynamics.model import Model
from xdynamics.model.motion import constants


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


@pytest.mark.every(13)
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


@pytest.mark.every(3)
@pytest.mark.parametrize("name", MODELS)
def test_runs_side_by_side(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that lanes of runs have the bits of the elements written out."""
    model, loops, elements = both(name, "forces", monkeypatch)
    found, expected = arrays(model, 4), arrays(model, 4)
    compiled(loops, runs=4)(**found)
    compiled(elements, runs=4)(**expected)
    np.testing.assert_array_equal(found["z"].view(np.int64), expected["z"].view(np.int64))


def test_loops_over_elements_are_compiled_as_written() -> None:
    """Assert that the law of a chain is as long for any number of its elements, and that LLVM is to unroll no loop."""
    lines = []
    for n in (104, 1000):  # what is left of them beside eight abreast is as long
        model = xd.Model.from_text(MODELS["chain"].replace("site = 21", f"site = {n}"))
        settings = settings_for(model, method="rk4", step=0.1, until=1.0)
        text = law_of(settings.layout(model), sampled=False).text()
        assert text.startswith(AS_WRITTEN)
        lines.append(text.count("\n"))
    assert lines[0] == lines[1]


def test_the_greatest_of_a_dimension_has_series_by_its_elements() -> None:
    """Assert that `taylor` marches the largest of a row of states, whose loops keep no coefficients of the greatest so far."""
    text = """
name = "greatest"
[dimensions]
cell = 5
[states.a]
unit = "1"
dims = ["cell"]
rate = "-a*index(cell)/second"
[states.b]
unit = "1"
rate = "max(a, cell)/second"
smooth = true
[initial]
a = "1 + index(cell)/10"
b = "0"
"""
    # the last, 1.4*exp(-4 t), is above all others until 0.07 s
    run = xd.simulate(xd.Model.from_text(text), method="taylor", step=1e-3, until=0.05)
    assert float(run.b[-1]) == pytest.approx(1.4 * (1 - np.exp(-0.2)) / 4, rel=1e-12)

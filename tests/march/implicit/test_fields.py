"""Fields by implicit methods: derivatives group by group, matrices kept as bands."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.integrate import solve_ivp

import xdynamics as xd
from cases.shaped_laws import MODELS
from xdynamics.kernels import layout_of, newton_matrix
from xdynamics.kernels.newton_matrix import pattern_of
from xdynamics.march import March, equation_solvers
from xdynamics.march.configuration import settings_for
from xdynamics.march.run import ARRAYS
from xdynamics.model import Model

HEAT = """
name = "rod"
[dimensions]
cell = {cells}
[states.T]
unit = "K"
dims = ["cell"]
rate = "(size(cell) + 1)**2*(shift(T, cell, 1, 0*kelvin) - 2*T + shift(T, cell, -1, 0*kelvin))/second"
[initial]
T = "1*kelvin*sin(pi*(index(cell) + 1)/(size(cell) + 1))"
"""
BRUSSELATOR = """
name = "Brusselator"
[dimensions]
cell = {cells}
[parameters]
alpha = "0.02"
[definitions]
spread = "alpha*(size(cell) + 1)**2"
[states.u]
unit = "1"
dims = ["cell"]
rate = "(1 + u**2*w - 4*u + spread*(shift(u, cell, 1, 1) - 2*u + shift(u, cell, -1, 1)))/second"
[states.w]
unit = "1"
dims = ["cell"]
rate = "(3*u - u**2*w + spread*(shift(w, cell, 1, 3) - 2*w + shift(w, cell, -1, 3)))/second"
[initial]
u = "1 + sin(2*pi*(index(cell) + 1)/(size(cell) + 1))"
w = "3"
"""
WIDTHS = {"chain": (1, 1), "ring": (4, 4), "rod": (1, 1), "Brusselator": (2, 2)}
METHOD = {"method": "radau_iia", "force_samples": "none"}


def text_of(name: str, cells: int = 40) -> str:
    """Return the text of a model."""
    return MODELS[name] if name in MODELS else {"rod": HEAT, "Brusselator": BRUSSELATOR}[name].format(cells=cells)


@pytest.mark.parametrize("name", WIDTHS)
def test_narrow_bands(name: str) -> None:
    """Assert that fields stand side by side, and that a ring is folded, with few numbers above and below the diagonal."""
    model = Model.from_text(text_of(name).replace("(u[0] + u[-1])*(u - stretch[3])/2", "u**2/2"))
    pattern = pattern_of(layout_of(model))
    band = pattern.band
    assert band is not None
    assert (band.lower, band.upper) <= WIDTHS[name]
    assert sorted(band.order.tolist()) == list(range(len(band.order)))
    assert len(pattern.groups) - 1 <= 2 * (band.lower + band.upper + 1)  # of a coordinate and its velocity


def run_of_elements(name: str, monkeypatch: pytest.MonkeyPatch, **asked: Any) -> xr.Dataset:
    """March a model with derivatives of single elements and matrices that are kept whole."""
    for module in (equation_solvers, newton_matrix):
        monkeypatch.setattr(module, "is_compressed", lambda _: False)
    monkeypatch.setattr("xdynamics.kernels.line_writing.is_compressed", lambda _: False)
    another = text_of(name).replace("[dimensions]", "[dimensions]\nanother = 2")  # a law of its own
    return xd.simulate(Model.from_text(another), **asked)


@pytest.mark.every(17)
@pytest.mark.parametrize("jacobian", ["exact", "differences"])
@pytest.mark.parametrize("name", ["chain", "bodies", "truss", "ring", "rod", "Brusselator"])
def test_as_elements(name: str, jacobian: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a run is that with derivatives of single elements, but for what Newton's iterations leave."""
    asked = {**METHOD, "rtol": 1e-9, "until": 0.3, "jacobian": jacobian}
    found = xd.simulate(Model.from_text(text_of(name)), **asked)
    expected = run_of_elements(name, monkeypatch, **asked)
    assert found.attrs["run_outcome"] == expected.attrs["run_outcome"] == "completed"
    assert found.sizes["step"] == expected.sizes["step"]
    for quantity in ("u", "r", "a", "T", "w"):
        if quantity in found:
            np.testing.assert_allclose(found[quantity], expected[quantity], rtol=1e-8, atol=1e-9)


@pytest.mark.dear
@pytest.mark.every(7)
@pytest.mark.parametrize(
    ("name", "method"),
    [
        *((name, "implicit_midpoint") for name in ("chain", "ring", "rod", "Brusselator")),
        *((name, "implicit_velocity_verlet") for name in ("truss", "ring")),
    ],
)
def test_newton_as_elements(name: str, method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that Newton's method takes the same iterations with bands as with whole matrices, to the same digits."""
    asked = {"method": method, "step": 0.01, "until": 0.2, "force_samples": "none"}
    found = xd.simulate(Model.from_text(text_of(name)), **asked)
    expected = run_of_elements(name, monkeypatch, **asked)
    assert found.attrs["run_outcome"] == expected.attrs["run_outcome"] == "completed"
    np.testing.assert_array_equal(found.newton_iterations, expected.newton_iterations)
    for quantity in {"u", "r", "v_r", "theta", "a", "T", "w"} & {*found}:
        np.testing.assert_allclose(found[quantity], expected[quantity], rtol=1e-13, atol=1e-13)


@pytest.mark.every(2)
@pytest.mark.parametrize("cells", [200, 2000])
def test_heat_by_the_midpoint_rule(cells: int) -> None:
    """Assert the discrete law: the longest mode shrinks by (1 - z)/(1 + z) a step; room and groups do not grow faster."""
    model, step = Model.from_text(HEAT.format(cells=cells)), 0.01
    asked = {"method": "implicit_midpoint", "step": step, "until": 0.1, "force_samples": "none", "log": "states"}
    run = xd.simulate(model, **asked)
    half = 2 * (cells + 1) ** 2 * np.sin(np.pi / (2 * (cells + 1))) ** 2 * step
    mode = np.sin(np.pi * np.arange(1, cells + 1) / (cells + 1))
    np.testing.assert_allclose(run["T"][-1], mode * ((1 - half) / (1 + half)) ** 10, rtol=0, atol=1e-10)
    march = March(model, settings_for(model, **asked))
    assert march.run.matrix.size == 4 * cells
    assert march.run.groups.size == 1 + 3


@pytest.mark.parametrize("cells", [6, 100, 1000])
@pytest.mark.parametrize("rtol", [1e-6, 1e-9])
def test_heat(cells: int, rtol: float) -> None:
    """Assert that the longest mode of a rod decays as its closed form, in as many steps whatever the cells."""
    run = xd.simulate(Model.from_text(HEAT.format(cells=cells)), **METHOD, rtol=rtol, until=0.1)
    rate = 4 * (cells + 1) ** 2 * np.sin(np.pi / (2 * (cells + 1))) ** 2
    mode = np.sin(np.pi * np.arange(1, cells + 1) / (cells + 1))
    np.testing.assert_allclose(run["T"][-1], mode * np.exp(-rate * 0.1), rtol=0, atol=20 * rtol)
    assert run.sizes["step"] < 100


def test_brusselator_of_more_cells_takes_as_many_steps() -> None:
    """Assert that steps, Jacobians and factorisations of a Brusselator do not grow with its cells."""
    counts = []
    for cells in (50, 200):
        run = xd.simulate(Model.from_text(BRUSSELATOR.format(cells=cells)), **METHOD, rtol=1e-6, until=10.0)
        counts.append(
            [run.sizes["step"], *(run.attrs[f"run_{name}"] for name in ("jacobian_evaluations", "factorisations"))]
        )
    assert np.abs(np.diff(counts, axis=0)).max() <= 4


def spread_out(cells: int, until: float) -> np.ndarray:
    """Return the end of a Brusselator by scipy's DOP853, which is explicit and knows nothing of bands, at 1e-12."""
    places, factor = np.arange(1, cells + 1) / (cells + 1), 0.02 * (cells + 1) ** 2

    def rates(_t: float, y: np.ndarray) -> np.ndarray:
        u, w = y[:cells], y[cells:]
        wide_u, wide_w = np.concatenate([[1.0], u, [1.0]]), np.concatenate([[3.0], w, [3.0]])
        du = 1 + u**2 * w - 4 * u + factor * (wide_u[:-2] - 2 * u + wide_u[2:])
        return np.concatenate([du, 3 * u - u**2 * w + factor * (wide_w[:-2] - 2 * w + wide_w[2:])])

    start = np.concatenate([1 + np.sin(2 * np.pi * places), np.full(cells, 3.0)])
    return solve_ivp(rates, (0.0, until), start, "DOP853", rtol=1e-12, atol=1e-12).y[:, -1]


@pytest.mark.every(3)
@pytest.mark.parametrize(("cells", "until"), [(50, 10.0), (100, 2.0), (200, 0.5)])
def test_brusselators_have_the_digits_of_another_program(cells: int, until: float) -> None:
    """Assert both fields of 50, 100 and 200 cells to 1e-9 against an explicit method of order 8."""
    model = Model.from_text(BRUSSELATOR.format(cells=cells))
    run = xd.simulate(model, **METHOD, rtol=1e-11, atol=1e-11, until=until)
    found = np.concatenate([run.u.values[-1], run.w.values[-1]])
    assert np.abs(found - spread_out(cells, until)).max() < 1e-9


def test_fields_of_2000_cells_cost_in_proportion() -> None:
    """Assert that a reaction-diffusion equation of more cells takes as many steps, and memory for every cell added."""
    counts, sizes = [], []
    for cells in (500, 1000, 2000):
        model = Model.from_text(BRUSSELATOR.format(cells=cells))
        march = March(model, settings_for(model, **METHOD, rtol=1e-4, atol=1e-6, until=0.1))
        for _ in march.blocks():
            pass
        counts.append([int(march.accepted), int(march.now.evaluations)])
        sizes.append(sum(getattr(march.run, name).nbytes for name in ARRAYS if not name.startswith("log_")))
    assert np.ptp(counts, axis=0).max() <= 4
    added = np.diff(sizes) / [500, 1000]
    assert added[1] == pytest.approx(added[0], rel=0.01)
    assert added[1] < 6000.0  # bytes a cell, of two unknowns and their bands

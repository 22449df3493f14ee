"""Fields by Radau IIA in one run: time a step and cell, and seconds of scipy's Radau and of CVODE's over ours.

python tests/benchmarks/fields.py

The heat equation is judged by its closed form. scipy is given the sparsity of its Jacobian; CVODE (BDF of scikit-sundae,
left out where that is not installed) the width of its band. Each is given the loosest of a row of tolerances that leads to
an error below the one asked for. Of the Brusselator (Hairer, Wanner, Solving ODEs II, section IV.10) there are times, and of
the implicit midpoint rule with fixed steps its time a step and cell, on bands too.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.sparse import diags_array

import xdynamics as xd
from xdynamics.march import March
from xdynamics.march.configuration import settings_for

try:
    from sksundae.cvode import CVODE
except ImportError:
    CVODE = None

Floats = Any
END = 0.1
TOLERANCES = [10.0**-k for k in np.arange(3.0, 12.6, 0.5)]
HEAT = """
name = "rod"
[dimensions]
cell = {cells}
[states.T]
unit = "K"
dims = ["cell"]
rate = "(size(cell) + 1)**2*(shift(T, cell, 1, 0*kelvin) - 2*T + shift(T, cell, -1, 0*kelvin))/second"
[initial]
T = "1*kelvin*(sin(pi*(index(cell) + 1)/(size(cell) + 1)) + sin(5*pi*(index(cell) + 1)/(size(cell) + 1))/4)"
"""
BRUSSELATOR = """
name = "Brusselator"
[dimensions]
cell = {cells}
[definitions]
spread = "0.02*(size(cell) + 1)**2"
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


class Rod:
    """The heat equation of a number of cells."""

    def __init__(self, cells: int) -> None:
        self.cells, places = cells, np.arange(1, cells + 1) / (cells + 1)
        self.modes = [(k, share * np.sin(k * np.pi * places)) for k, share in ((1, 1.0), (5, 0.25))]
        self.start = sum(mode for _, mode in self.modes)
        self.model = xd.Model.from_text(HEAT.format(cells=cells))

    def error(self, found: Floats) -> float:
        """Return the largest error at the end."""
        square = 4 * (self.cells + 1) ** 2
        rates = [square * np.sin(k * np.pi / (2 * (self.cells + 1))) ** 2 for k, _ in self.modes]
        exact = sum(mode * np.exp(-rate * END) for rate, (_, mode) in zip(rates, self.modes, strict=True))
        return float(np.abs(found - exact).max())

    def rates(self, _t: float, y: Floats) -> Floats:
        """Return the rates, as fast as NumPy can."""
        found = -2.0 * y
        found[1:] += y[:-1]
        found[:-1] += y[1:]
        found *= (self.cells + 1) ** 2
        return found

    def ours(self, tolerance: float) -> tuple[Floats, int]:
        """March by Radau IIA; return the end and the number of steps."""
        return marched(self.model, tolerance, END)

    def scipy(self, tolerance: float) -> tuple[Floats, int]:
        """March by scipy's Radau with the sparsity of the Jacobian."""
        sparsity = diags_array([1.0, 1.0, 1.0], offsets=[-1, 0, 1], shape=(self.cells, self.cells))
        given = {"rtol": tolerance, "atol": tolerance, "jac_sparsity": sparsity}
        found = solve_ivp(self.rates, (0.0, END), self.start, "Radau", t_eval=[END], **given)
        return found.y[:, -1], found.nfev

    def cvode(self, tolerance: float) -> tuple[Floats, int]:
        """March by CVODE's BDF with a band."""

        def rates(t: float, y: Floats, found: Floats) -> None:
            found[:] = self.rates(t, y)

        given = {"rtol": tolerance, "atol": tolerance, "method": "BDF", "linsolver": "band", "lband": 1, "uband": 1}
        found = CVODE(rates, **given, max_num_steps=100_000).solve([0.0, END], self.start)
        return found.y[-1], found.nfev


def marched(model: Any, tolerance: float, end: float) -> tuple[Floats, int]:
    """March a model by Radau IIA, with a log of its rows, and without the making of a record."""
    return timed(model, {"method": "radau_iia", "rtol": tolerance, "atol": tolerance, "until": end})


def timed(model: Any, asked: dict[str, Any]) -> tuple[Floats, int]:
    """March a model, and note the seconds that blocks alone take."""
    march = March(model, settings_for(model, force_samples="none", **asked))
    begin = time.perf_counter()
    for _ in march.blocks():
        pass
    SECONDS.append(time.perf_counter() - begin)
    return march.run.y[: march.layout.used.size].copy(), march.accepted


def best(run: Callable[[], Any], times: int = 3) -> tuple[Any, float]:
    """Return what it gives, and the least seconds that it takes."""
    seconds = []
    for _ in range(times):
        begin = time.perf_counter()
        found = run()
        seconds.append(time.perf_counter() - begin)
    return found, min(seconds)


def reached(rod: Rod, march: Callable[[float], tuple[Floats, int]], wanted: float) -> tuple[float, float, float, int]:
    """Return tolerance, error, seconds and steps, of the others evaluations, of the loosest march below an error."""
    for tolerance in TOLERANCES:
        if rod.error(march(tolerance)[0]) <= wanted:
            break
    SECONDS.clear()
    (found, steps), seconds = best(lambda: march(tolerance))
    return tolerance, rod.error(found), min(SECONDS, default=seconds), steps


def compared(cells: int, wanted: float) -> None:
    """Print one rod at one error: ours, and the others' seconds over ours."""
    rod = Rod(cells)
    tolerance, error, seconds, steps = reached(rod, rod.ours, wanted)
    each = 1e9 * seconds / steps / cells
    print(
        f"{cells:6} {wanted:7.0e}  ours    {tolerance:8.1e} {error:8.1e} {1e3 * seconds:9.2f} ms {steps:5} steps, {each:6.0f} ns a step and cell"
    )
    for name, march in {"scipy": rod.scipy, **({"CVODE": rod.cvode} if CVODE else {})}.items():
        tolerance, error, theirs, calls = reached(rod, march, wanted)
        print(
            f"{'':15} {name:7} {tolerance:8.1e} {error:8.1e} {1e3 * theirs:9.2f} ms {calls:5} calls, {theirs / seconds:6.1f} times ours"
        )


def main() -> None:
    """Print the table."""
    marched(Rod(10).model, 1e-3, END)
    print(" cells   error          tolerance    error      seconds")
    for cells in (1000, 4000, 10_000):
        for wanted in (1e-6, 1e-9):
            compared(cells, wanted)
    print("Brusselator to 10 s at a tolerance of 1e-6")
    for cells in (50, 100, 200, 1000, 2000):
        model = xd.Model.from_text(BRUSSELATOR.format(cells=cells))
        SECONDS.clear()
        _, steps = best(lambda model=model: marched(model, 1e-6, 10.0))[0]
        seconds = min(SECONDS)
        print(
            f"{cells:6} {1e3 * seconds:9.2f} ms {steps:5} steps, {1e9 * seconds / steps / cells:6.0f} ns a step and cell"
        )
    print("heat by the implicit midpoint rule, 100 steps of 1 ms")
    for cells in (100, 1000, 10_000):
        rod = Rod(cells)
        SECONDS.clear()
        found, steps = best(
            lambda rod=rod: timed(rod.model, {"method": "implicit_midpoint", "step": 1e-3, "until": END})
        )[0]
        seconds = min(SECONDS)
        print(
            f"{cells:6} {1e3 * seconds:9.2f} ms {steps:5} steps, {1e9 * seconds / steps / cells:6.0f} ns a step and cell,"
            f" error {rod.error(found):.1e}"
        )


SECONDS: list[float] = []  # of marches alone

if __name__ == "__main__":
    main()

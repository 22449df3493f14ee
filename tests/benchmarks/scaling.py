"""How what a user waits for grows with what there is of it, as exponents: rows, elements, scalars, events, links, members, draws.

python tests/benchmarks/scaling.py [name ...]

Each line has the CPU time of some sizes, without what the first of them compiles, and the exponent between the last two: 1 is
linear. What is timed is whole: the march with its Dataset, a sweep or budget computed, for scalars the archive as well.
"""

from __future__ import annotations

import math
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

from many_bodies import CHAIN
from mechanisms import linkage
from shaped_growth import least
from start import OSCILLATOR

import xdynamics as xd

SAWTOOTH = """
name = "sawtooth"
[states.s]
unit = "m"
rate = "1*metre/second"
[initial]
s = "0 m"
[events.full]
function = "s - 1*metre"
direction = "rising"
action = "reset"
set = { s = "0*metre" }
"""


def rows(count: int) -> None:
    """March an oscillator by given steps."""
    xd.simulate(xd.Model.from_text(OSCILLATOR), method="rk4", step=1e-3, until=count * 1e-3)


def elements(count: int) -> None:
    """March a chain for a hundred steps."""
    xd.simulate(xd.Model.from_text(CHAIN.format(n=count)), method="velocity_verlet", step=1e-2, until=1.0)


def scalars(count: int) -> None:
    """March so many coordinates with names of their own for a hundred steps, save and open the record."""
    names = [f"q{i}" for i in range(count)]
    model = xd.Model(
        name="scalars",
        coordinates=dict.fromkeys(names, "m"),
        mass=dict.fromkeys(names, "1*kilogram"),
        forces={"spring": {name: f"-4*newton/metre*{name}" for name in names}},
        initial=dict.fromkeys(names, "1 m") | {f"v_{name}": "0 m s-1" for name in names},
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scalars.nc"
        xd.save(xd.simulate(model, method="velocity_verlet", step=1e-2, until=1.0), path)
        xd.open_run(path).load().close()


def events(count: int) -> None:
    """March a sawtooth that is set back so many times."""
    xd.simulate(xd.Model.from_text(SAWTOOTH), method="rk4", step=0.1, until=count + 0.5)


def links(count: int) -> None:
    """March so many loops of parallel cranks for a tenth of a second, by radau_iia."""
    xd.simulate(linkage(count), method="radau_iia", rtol=1e-6, until=0.1, force_samples="none")


def members(count: int) -> None:
    """Sweep a stiffness."""
    values = [1.0 + i / count for i in range(count)]
    xd.sweep(
        xd.Model.from_text(OSCILLATOR), {"k": values}, keep=["end_x"], method="rk4", step=1e-2, until=1.0
    ).compute()


def draws(count: int) -> None:
    """Propagate the uncertainty of a stiffness."""
    budget = xd.error_budget(
        xd.Model.from_text(OSCILLATOR), "x", at="1 s", draws=count, method="rk4", step=1e-2, until=1.0
    )
    budget.compute()


AXES: dict[Callable[[int], None], tuple[int, ...]] = {
    rows: (10_000, 100_000, 1_000_000),
    elements: (1_000, 10_000, 100_000),
    scalars: (25, 50, 100, 200),
    events: (1_000, 10_000, 100_000),
    links: (4, 8, 16),
    members: (10_000, 100_000, 1_000_000),
    draws: (1_000, 10_000, 100_000),
}


def main() -> None:
    """Print a line for each axis."""
    wanted = sys.argv[1:]
    for call, sizes in AXES.items():
        if wanted and call.__name__ not in wanted:
            continue
        took = [least(partial(call, size)) for size in sizes]
        exponent = math.log(took[-1] / took[-2]) / math.log(sizes[-1] / sizes[-2])
        each = ", ".join(f"{size:,}: {length:.3g} s" for size, length in zip(sizes, took, strict=True))
        print(f"{call.__name__:9} {exponent:5.2f}   {each}", flush=True)


if __name__ == "__main__":
    main()

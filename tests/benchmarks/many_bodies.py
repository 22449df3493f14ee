"""What forces with dimensions cost: gravity between every two bodies, and a chain of springs, printed in loops.

python tests/benchmarks/many_bodies.py

From the potential as text: seconds to differentiate it and to write loops, seconds to compile them, and nanoseconds of
one evaluation for every two bodies, or for every coordinate of the chain, with neighbouring elements side by side. Then
seconds to read whole models and to march ten steps, compiling included.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from cases.array_programs import bound
from xdynamics import Model, simulate
from xdynamics.expressions import parse
from xdynamics.expressions.calculus import negative
from xdynamics.kernels.machine import vector_lanes
from xdynamics.kernels.nests import Nests
from xdynamics.kernels.program import Location, Program
from xdynamics.shapes import Extent, Relation, Shapes, gradient

ABREAST, OPERATIONS, ROUNDS = vector_lanes() // 2, 2_000_000, 7
GRAVITY = "-G*first(m, pair)*second(m, pair)/norm(second(r, pair) - first(r, pair), axis)"
SPRINGS = "k*(second(r, pair) - first(r, pair))**2/2 + k*(second(r, pair) - first(r, pair))**4/4"
CHAIN = """
name = "chain"
[dimensions]
site = {n}
[relations.spring]
of = "site"
neighbours = 1
[coordinates]
u = {{ unit = "m", dims = ["site"] }}
[parameters]
k = "4 N m-1"
m = "1 kg"
[mass]
u = "m"
[forces.springs]
over = "spring"
potential = "k*(second(u, spring) - first(u, spring))**2/2"
[initial]
u = "0.1*metre*sin(pi*(index(site) + 1)/(size(site) + 1))"
"""

CLUSTER = """
name = "cluster"
[dimensions]
body = {n}
axis = ["x", "y", "z"]
[relations.pair]
of = "body"
[coordinates]
r = {{ unit = "m", dims = ["body", "axis"] }}
[parameters]
G = "1 N m2 kg-2"
m = "1 kg"
[mass]
r = "m"
[forces.gravity]
over = "pair"
potential = "-G*m*m/norm(second(r, pair) - first(r, pair), axis)"
[initial]
r = {{ unit = "m", value = {start} }}
"""


def program(shapes: Shapes, potential: str, dims: tuple[str, ...]) -> Program:
    """Return the force of a potential on `r`, whose numbers stand before masses and a constant in `p`."""
    size = int(np.prod(shapes.shape(dims)))
    places = {"r": 0, "m": size, "G": size + shapes.extent(dims[0]).size, "k": size}
    nests = Nests(
        shapes,
        lambda lines, name: lines.load(Location("p", places[name]), name),
        lambda name: Location("p", places[name]),
    )
    force = gradient(negative(parse(potential)), {"r"}, shapes)["r"]
    nests.results([("force", dims, force, Location("z"))])
    return Program("force", "The force.", tuple(nests.lines), local=nests.local, tables=nests.tables)


def bodies(n: int) -> tuple[Shapes, str, tuple[str, ...], float]:
    """Return shapes, potential and dimensions of bodies, and how many pairs there are."""
    pair = Relation("pair", "body", "body", *np.triu_indices(n, 1))
    dims = {"m": ("body",), "r": ("body", "axis")}
    shapes = Shapes({"body": Extent("body", n), "axis": Extent("axis", 3)}, {"pair": pair}, dims)
    return shapes, GRAVITY, ("body", "axis"), n * (n - 1) / 2


def chain(n: int) -> tuple[Shapes, str, tuple[str, ...], float]:
    """Return the same of a chain, and how many coordinates there are."""
    pair = Relation("pair", "site", "site", np.arange(n - 1), np.arange(1, n))
    return Shapes({"site": Extent("site", n)}, {"pair": pair}, {"r": ("site",)}), SPRINGS, ("site",), float(n)


def table(
    title: str, case: Callable[[int], tuple[Shapes, str, tuple[str, ...], float]], numbers: tuple[int, ...]
) -> None:
    """Print seconds and nanoseconds by number of elements."""
    print(f"{title:>12}{'written in':>14}{'compiled in':>14}{'evaluated in':>16}")
    for n in numbers:
        shapes, potential, dims, count = case(n)
        begin = time.perf_counter()
        one = program(shapes, potential, dims)
        written = time.perf_counter()
        size, random = int(np.prod(shapes.shape(dims))), np.random.default_rng(n)
        call = bound(one, abreast=ABREAST, p=random.normal(size=size + n + 1), z=np.zeros(size))
        done = time.perf_counter()
        many, least = max(1, int(OPERATIONS / count)), np.inf
        for _ in range(ROUNDS):
            start = time.perf_counter()
            for _ in range(many):
                call()
            least = min(least, (time.perf_counter() - start) / many / count)
        print(f"{n:12}{written - begin:12.3f} s{done - written:12.3f} s{1e9 * least:13.2f} ns")


def main() -> None:
    """Print the tables."""
    table("bodies", bodies, (10, 30, 100, 300, 1000))
    table("chain", chain, (10, 30, 100, 1000, 10_000))
    print(f"{'chain':>12}{'read in':>14}{'marched in':>14}")
    for n in (10, 30, 100, 300):
        begin = time.perf_counter()
        model = Model.from_text(CHAIN.format(n=n))
        read = time.perf_counter()
        simulate(model, until="0.1 s", step="0.01 s", method="velocity_verlet")
        print(f"{n:12}{read - begin:12.3f} s{time.perf_counter() - read:12.3f} s")


if __name__ == "__main__":
    main()

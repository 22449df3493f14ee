"""Random models with dimensions: bodies in a plane or in space, links of every kind, laws of distance and forces of their own."""

from __future__ import annotations

import random

D = "norm(second(r, s) - first(r, s), axis)"
RELATIONS = ("", "neighbours = 1", "neighbours = 1\nring = true", "neighbours = 2", "table")
POTENTIALS = (
    f"k*({D}/l - 1)**2*l**2/2",
    f"-k*l**3/{D}",
    f"k*l**2*((l/{D})**6 - (l/{D})**3)",
    f"-k*l**3/sqrt({D}**2 + l**2)",
    f"k*{D}**3/l",
    f"k*l**2*({D}/l)**1.5",
    f"k*l**2*sin({D}/l)*exp(-{D}/l)",
    f"stiffness*{D}**2/2",
    f"k*l**2*sqrt({D}/l)*first(m, s)/second(m, s)",
)
LINKED = (f"b*(second(v_r, s) - first(v_r, s))*({D}/l)**2", f"b*(second(v_r, s) - first(v_r, s))*l/{D}")
OWN = (
    "-k*(r - mean(r, site))",
    "-b*v_r",
    "-b*norm(v_r, axis)*v_r*tau/l",
    "-k*r*(l/norm(r, axis))**3",
    "k*(roll(r, site, 1) - r)",
    "k*(shift(r, site, 1, 0) - r)*cos(t/tau)",
    "-k*r*index(site)/10",
    "-k*r/(1 + norm(r, axis)**2/l**2)",
    "-charge*k*sqrt(l**2 + norm(r, axis)**2)*r/l",
)


def random_shapes(seed: int) -> str:
    """Return the text of a model of 3 to 18 bodies: near points of a lattice, some of them at rest, some without charge."""
    chosen = random.Random(seed)
    n, axes = chosen.choice((3, 4, 8, 9, 17, 18)), chosen.choice((2, 3))
    relation = chosen.choice(RELATIONS)
    if relation == "table":
        pairs = chosen.sample([(i, j) for i in range(n) for j in range(i)], n if n > 3 else 2)
        relation = 'csv = "first,second\\n' + "".join(f"{i},{j}\\n" for i, j in pairs) + '"'
    forces = [f'over = "s"\npotential = "{law}"' for law in chosen.sample(POTENTIALS, chosen.choice((1, 2)))]
    forces += [f'over = "s"\nr = "{law}"' for law in chosen.sample(LINKED, chosen.choice((0, 1)))]
    forces += [f'r = "{law}"' for law in chosen.sample(OWN, chosen.choice((0, 1, 2)))]
    places = [[1.3 * (i // 5**k % 5) + chosen.uniform(0.4, 0.9) for k in range(axes)] for i in range(n)]
    speeds = [[chosen.choice((0.0, 1.0)) * chosen.uniform(-0.5, 0.5) for _ in range(axes)] for _ in range(n)]
    masses, charges = ([chosen.choice(some) for _ in range(n)] for some in ((0.5, 1.1, 2.0), (-1.0, 0.0, 0.7)))
    return f"""
name = "random shapes"
[dimensions]
site = {n}
axis = {axes}
[relations.s]
of = "site"
{relation}
[coordinates]
r = {{ unit = "m", dims = ["site", "axis"] }}
[parameters]
k = "1.5 N m-1"
l = "1 m"
b = "0.3 N s m-1"
tau = "1 s"
m = {{ dims = ["site"], value = {masses}, unit = "kg" }}
charge = {{ dims = ["site"], value = {charges} }}
stiffness = {{ dims = ["s"], value = "newton/metre*(1 + 0.1*index(s))" }}
place = {{ dims = ["site", "axis"], value = {places}, unit = "m" }}
speed = {{ dims = ["site", "axis"], value = {speeds}, unit = "m s-1" }}
[mass]
r = "m"
[initial]
r = "place"
v_r = "speed"
""" + "".join(f"[forces.f{i}]\n{force}\n" for i, force in enumerate(forces))

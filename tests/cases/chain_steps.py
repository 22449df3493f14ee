"""Steps of explicit methods for a chain of few masses as programs, and what they leave in every array."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

import xdynamics as xd
from xdynamics.elementary import NAME
from xdynamics.kernels import Law, law_of
from xdynamics.kernels.program import Program
from xdynamics.kernels.python_text import python_of, python_of_set
from xdynamics.march.configuration import settings_for

SITES = 7
CHAIN = f"""
name = "chain"
[dimensions]
site = {SITES}
[relations.spring]
of = "site"
neighbours = 1
[coordinates]
u = {{ unit = "m", dims = ["site"] }}
[parameters]
m = "1 kg"
k = "3 N m-1"
[mass]
u = "m"
[forces.springs]
over = "spring"
potential = "k*(second(u, spring) - first(u, spring))**2/2"
[forces.ground]
u = "-0.1*k*u"
[initial]
u = "metre*sin(index(site))"
v_u = "0*metre/second"
"""
FOLLOWERS = """s = "metre"
[states.s]
unit = "m"
dims = ["site"]
rate = "(u - s)/second"
"""
EXPLICIT = [name for name, method in xd.METHODS.items() if not method.solves and not method.stepper.foresees]


def chain_law(name: str, *, sampled: bool) -> Law:
    """Return the law of a chain by a method, with first-order states where it takes them."""
    with_states = not xd.METHODS[name].symplectic and name != "dprkn6"
    model = xd.Model.from_text(CHAIN + FOLLOWERS * with_states)
    return law_of(settings_for(model, method=name, step=0.1, until=1.0).layout(model), sampled=sampled)


def lengths_of(law: Law) -> dict[str, int]:
    """Return the numbers of the arrays that a state and its error are in."""
    layout = law.layout
    return {"y": layout.record.size, "z": layout.record.size, "e": layout.used.size}


def left_by(law: Law, programs: Sequence[Program], name: str) -> dict[str, Any]:
    """Run a program of a law, of which some may be written otherwise, and return all arrays after it."""
    sizes = {"at": 16, "y": 0, "p": 50, "tables": 1, "pieces": 1, "z": 0, "e": 0, "samples": 5000}
    return executed(programs, name, sizes | lengths_of(law) | {"w": max(1, law.memory)})


def executed(programs: Sequence[Program], name: str, sizes: dict[str, int]) -> dict[str, Any]:
    """Run one of some programs in Python, and return all arrays after it."""
    scope: dict[str, Any] = {**python_of_set(NAME), "_empty": lambda count: np.full(count, np.nan)}
    exec("\n".join(map(python_of, programs)), scope)
    numbers = np.random.default_rng(1)
    arrays = {array: numbers.normal(size=count) for array, count in sizes.items()}
    arrays["at"][:5] = 0.3, 0.4, 0.1, 0.5, 0.0
    arrays["p"] = np.abs(arrays["p"]) + 0.5
    scope[name](*arrays.values())
    return arrays

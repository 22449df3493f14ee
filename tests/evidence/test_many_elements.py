"""Verbs on quantities of many elements: what they make does not grow with the number of elements."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd

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
[mass]
u = "1*kilogram"
[forces.springs]
over = "spring"
potential = "k*(second(u, spring) - first(u, spring))**2/2"
[initial]
u = "0.1*metre*sin(pi*(index(site) + 1)/(size(site) + 1))"
[run]
method = "velocity_verlet"
step = "0.1 s"
until = "0.4 s"
"""
FEW, MANY = 8, 80
TIMES = [0.13, 0.31]

Verb = Callable[[xr.Dataset], Any]
VERBS: dict[str, Verb] = {
    "sample": lambda run: xd.sample(run, TIMES),
    "sample of chunks": lambda run: xd.sample(run.chunk({"step": 2}), TIMES),
    "simulate at times": lambda run: xd.simulate(model_of(run), times=TIMES),
    "simulate at times, lazily": lambda run: xd.simulate(model_of(run), times=TIMES, compute=False),
    "extend": lambda run: xd.extend(run, until="0.6 s"),
    "complete": xd.complete,
}


def chain(n: int) -> xr.Dataset:
    """March a chain."""
    return xd.simulate(xd.Model.from_text(CHAIN.format(n=n)))


def model_of(run: xr.Dataset) -> xd.Model:
    """Read the model of a run."""
    return xd.Model.from_text(str(run.model_toml.values))


@pytest.mark.parametrize("name", VERBS)
def test_variables_are_of_quantities(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that as many variables are made for many elements as for few."""
    made = []
    original = xr.Variable.__init__
    runs = [chain(n) for n in (FEW, FEW, MANY)]  # the first loads what is loaded once

    def counted(self: Any, *arguments: Any, **keywords: Any) -> None:
        made.append(1)
        original(self, *arguments, **keywords)

    monkeypatch.setattr(xr.Variable, "__init__", counted)
    counts = []
    for run in runs:
        made.clear()
        VERBS[name](run)
        counts.append(len(made))
    assert counts[1] == counts[2] > 0


def test_states_at_times_are_described_with_their_dimensions() -> None:
    """Assert that states at times have elements before they are marched, too, and the same values as at once."""
    model = xd.Model.from_text(CHAIN.format(n=FEW).replace("= 8", '= ["a", "b", "c", "d", "e", "f", "g", "h"]'))
    described = xd.simulate(model, times=TIMES, compute=False)
    at_once = xd.simulate(model, times=TIMES)
    assert described.u.dims == ("at", "site")
    assert described.u.sel(site="c").values.tobytes() == at_once.u.sel(site="c").values.tobytes()
    assert {*at_once.variables} <= {*described.variables}


def test_elements_in_another_order_are_sampled_by_their_labels() -> None:
    """Assert that each element of a record is repeated as itself wherever it stands."""
    model = xd.Model.from_text(CHAIN.format(n=FEW).replace("= 8", '= ["a", "b", "c", "d", "e", "f", "g", "h"]'))
    run = xd.simulate(model)
    turned = xd.sample(run.isel(site=slice(None, None, -1)), TIMES)
    assert turned.sel(site=list("abcdefgh")).u.values.tobytes() == xd.sample(run, TIMES).u.values.tobytes()


def test_dimensions_in_another_order_are_sampled() -> None:
    """Assert that a record is sampled to the same bits where elements stand before rows."""
    run = chain(FEW)
    turned = xd.sample(run.transpose("site", ...), TIMES)
    assert turned.u.dims == ("at", "site")
    assert np.array_equal(turned.u, xd.sample(run, TIMES).u)

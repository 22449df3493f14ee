"""Verbs on quantities of many elements: what they make does not grow with the number of elements."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from xdynamics.documenting.plain_text import model_lines
from xdynamics.evidence import observables, observed_quantities
from xdynamics.record.unfolding import unfold

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
CLOSED_FORM = """
[validation.u]
expression = "0.1*metre*sin(pi*(index(site) + 1)/(size(site) + 1))"
bound = "1 cm"
times = ["0 s", "0.01 s"]
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
    return xd.Model.from_text(run.model_toml.values.item())


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


LOOKING_UP: dict[str, Callable[[xr.Dataset, Path], Any]] = {
    "compare": lambda run, _: xd.compare(run, xd.simulate(model_of(run), step="0.05 s"), times=TIMES),
    "refine": lambda run, _: xd.refine(model_of(run), steps=["0.2 s", "0.1 s", "0.05 s"], at=["0.4 s"]),
    "validate": lambda run, _: xd.validate(model=validated(model_of(run))),
    "plot": lambda run, folder: xd.plot(run, folder / "chain.png"),
}


def validated(model: xd.Model) -> xd.Model:
    """Return a chain with a closed form for the start of every mass."""
    return xd.Model.from_text(model.to_toml() + CLOSED_FORM)


@pytest.mark.parametrize("name", ["compare", "refine", "validate", pytest.param("plot", marks=pytest.mark.dear)])
def test_variables_are_looked_up_at_once(name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Assert that no element is taken from a Dataset by its name, each of which would walk over all variables."""
    looked_up = []
    original = xr.Dataset.__getitem__

    def counted(self: Any, key: Any) -> Any:
        looked_up.append(key)
        return original(self, key)

    monkeypatch.setattr(xr.Dataset, "__getitem__", counted)
    counts = []
    for n in (FEW, MANY):
        run = chain(n)
        looked_up.clear()
        LOOKING_UP[name](run, tmp_path)
        counts.append(len(looked_up))
    assert counts[0] >= counts[1] > 0


def test_a_diagnosis_takes_no_columns_for_elements(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that no more columns are taken out of a record for many elements than for few."""
    taken = []
    original = xr.Dataset._construct_dataarray

    def counted(self: xr.Dataset, name: str) -> xr.DataArray:
        taken.append(name)
        return original(self, name)

    monkeypatch.setattr(xr.Dataset, "_construct_dataarray", counted)
    counts = []
    for n in (4, 32):
        run = xd.simulate(xd.Model.from_text(CHAIN.format(n=n)), method="rk4", step="0.05 s", until="10 s")
        taken.clear()
        xd.diagnose(run)
        counts.append(len(taken))
    assert counts[0] >= counts[1] > 0


OBSERVED = (
    CHAIN
    + """
[observables]
span = "max(u, site) - min(u, site)"
squares = "u*u"
second_one = "u[2]*t/second + sum(u[1]*index(site), site)"
"""
)


def test_observables_of_quantities_are_those_of_their_elements(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that values have the bits of one element after the other, and errors agree.

    Slopes halfway are exact for sums of squares; where neighbours join, what is left out is k times the product of their
    errors for each spring, k = 4 N/m.
    """
    run = xd.simulate(xd.Model.from_text(OBSERVED.format(n=FEW)))
    finer = xd.simulate(model_of(run), step="0.03 s")
    whole = xd.compare(run, finer)
    with monkeypatch.context() as changed:
        changed.setattr(observables.ObservedQuantities, "of", lambda *_: None)
        single = xd.compare(run, finer)
    joined = FEW * 4.0 * whole.interpolation_error_u.max().item() ** 2
    for name in ("kinetic_energy", "potential_energy", "total_energy", "span", "squares", "second_one"):
        difference, error = f"difference_{name}", f"interpolation_error_{name}"
        assert whole[difference].values.tobytes() == single[difference].values.tobytes(), name
        assert np.abs(whole[difference]).max() > 0.0
        rounding = 8 * FEW * np.finfo(float).eps * np.abs(run[name]).max().item()
        bound = rounding + (joined if name in ("potential_energy", "total_energy") else 0.0)
        assert np.abs(whole[error] - single[error]).max().item() < bound < 0.01 * whole[error].max().item(), name
    for error in ("interpolation_error_squares", "interpolation_error_span"):
        assert whole[error].values.tobytes() == single[error].values.tobytes(), error


BODIES = """
name = "bodies"
[dimensions]
body = {n}
axis = 2
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
[forces.drag]
r = "-0.3*v_r*kilogram/second"
[initial]
r = "metre*(index(body)*size(axis) + index(axis))**1.5"
v_r = "0.2*metre/second*sin(index(body) + 2*index(axis))"
[run]
method = "rk4"
step = "0.1 s"
until = "0.4 s"
"""


def test_errors_of_energies_take_as_many_evaluations_for_many_elements(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that the energy of bodies is not evaluated once for each of their numbers."""
    evaluations = []
    original = observed_quantities.evaluate_elements

    def counted(*arguments: Any) -> Any:
        evaluations.append(1)
        return original(*arguments)

    monkeypatch.setattr(observed_quantities, "evaluate_elements", counted)
    counts = []
    for n in (3, 12):
        run = xd.simulate(xd.Model.from_text(BODIES.format(n=n)))
        evaluations.clear()
        xd.compare(run, xd.simulate(model_of(run), step="0.05 s"), times=TIMES)
        counts.append(len(evaluations))
    assert counts[0] == counts[1] > 0


@pytest.mark.parametrize("text", [BODIES.format(n=5), OBSERVED.format(n=FEW)], ids=["bodies", "chain"])
def test_rates_of_energies_are_those_of_their_elements(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that rates of energies of whole quantities are those of the trees of all elements."""
    model = xd.Model.from_text(text)
    run = unfold(xd.simulate(model))
    times, rows = run.time.values, np.arange(run.sizes["step"])
    states = {name: run[name].values for name in model.elements.units}
    for name in ("kinetic_energy", "potential_energy"):
        whole = observables.rate_on(run, model, name, states, times, rows)
        with monkeypatch.context() as changed:
            changed.setattr(observables.ObservedQuantities, "of", lambda *_: None)
            single = observables.rate_on(run, model, name, states, times, rows)
        assert np.abs(whole - single).max() < 1e-13 * np.abs(single).max()
        assert np.abs(single).max() > 0.0


def test_energies_are_evaluated_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that the energy of a chain is not taken apart into the terms of its elements."""

    def refused(*_: Any, **__: Any) -> None:
        raise AssertionError

    run = chain(FEW)
    finer = xd.simulate(model_of(run), step="0.03 s")
    monkeypatch.setattr(observables, "evaluate_at_states", refused)
    assert "difference_total_energy" in xd.compare(run, finer)


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


def test_a_checked_model_has_lines_of_its_first_elements() -> None:
    """Assert that many elements take a line more than seven, which are all told."""
    few, more, many = ([*model_lines(xd.Model.from_text(CHAIN.format(n=n)))] for n in (7, 8, 30))
    assert sum(line.startswith("motion") for line in few) == 7
    assert more.count("… and 2 more elements") == 2
    assert sum(line.startswith("motion") for line in more) == 6
    assert len(many) == len(few)  # six elements, and how many there are besides, of motion and of force
    assert many.count("… and 24 more elements") == 2
    assert "v_u: [initial]" in many[0]
    (start,) = (line for line in many if line.startswith("start"))
    assert "u[5] = " in start
    assert start.endswith("… and 24 more elements")


TOLD_BODIES = """
name = "bodies"
dimensions = {{ body = {n}, axis = ["x", "y", "z"] }}
coordinates.r = {{ unit = "m", dims = ["body", "axis"] }}
parameters = {{ G = "1 m3 kg-1 s-2", m = "1 kg" }}
mass.r = "m"
relations.pair.of = "body"
forces.gravity = {{ over = "pair", potential = "-G*m*m/norm(second(r, pair) - first(r, pair), axis)" }}
initial.r = "1*metre*(sin(index(body)*(1 + index(axis))) + 3*index(body))"
events.far = {{ function = "max(norm(r, axis), body) - 1000*metre" }}
"""


def test_a_checked_model_of_many_bodies_is_told_as_it_is_written(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that forces and functions of very many terms are not written out, nor their derivatives sought."""
    few = [*model_lines(xd.Model.from_text(TOLD_BODIES.format(n=3)))]
    assert sum(line.startswith("force     gravity of r[") for line in few) == 6
    assert any(line.startswith("scales    at the start: fastest time constant") for line in few)
    monkeypatch.setattr("xdynamics.documenting.plain_text.checked_linearisation", pytest.fail)
    many = [*model_lines(xd.Model.from_text(TOLD_BODIES.format(n=120)))]
    assert "force     gravity by the potential -G*m*m/norm(second(r, pair) - first(r, pair), axis) of each pair" in many
    assert "event     far: max(norm(r, axis), body) - 1000*metre = 0, either: record" in many
    assert "the forces have 129600 derivatives by the state, over 100000" in "\n".join(many)
    assert max(map(len, many)) < 1000
    chain = "\n".join(model_lines(xd.Model.from_text(CHAIN.format(n=2001))))
    assert "there are 2001 accelerations and rates, over 2000; xd.modes(model) takes its time" in chain

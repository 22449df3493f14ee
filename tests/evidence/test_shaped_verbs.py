"""Verbs that take elements and blocks by name: tolerances, budgets, manufactured solutions, modes, companions, more time."""

from __future__ import annotations

import os
import re
import signal
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd

CHAIN = """
name = "chain"
[dimensions]
site = ["a", "b", "c"]
[relations.spring]
of = "site"
neighbours = 1
[coordinates]
u = { unit = "m", dims = ["site"] }
[states.T]
unit = "K"
dims = ["site"]
rate = "(roll(T, site, 1) - T)/second"
[parameters]
k = { dims = ["spring"], value = [4, 5], unit = "N m-1" }
m = { dims = ["site"], value = [1, 2, 1], unit = "kg", uncertainty = [0.01, 0.02, 0.01] }
c = { value = "3 N m-1", uncertainty = "0.1 N m-1" }
[mass]
u = "m"
[forces.springs]
over = "spring"
potential = "k*(second(u, spring) - first(u, spring))**2/2"
[forces.held]
u = "-c*(u + u[b]/10)"
[initial]
u = { value = [1, 0, 0.2], unit = "m" }
T = "2 K"
[run]
method = "rk4"
step = "20 ms"
until = "1 s"
"""
PAIR = """
name = "Two masses, each on a spring"
[dimensions]
body = ["a", "b"]
[coordinates]
x = { unit = "m", dims = ["body"] }
[parameters]
k = { dims = ["body"], values = { a = "1 N m-1", b = "4 N m-1" } }
[mass]
x = "1*kilogram"
[forces.springs]
x = "-k*x"
[initial]
x = "1 m"
[run]
method = "dop853"
until = "1 s"
"""
WANTED = {"u": "metre*sin((1 + 0.1*index(site))*t/second)", "T": "kelvin*exp(-t/second)*(1 + index(site))"}


@pytest.fixture(scope="module")
def chain() -> xd.Model:
    return xd.Model.from_text(CHAIN)


def test_manufactured_solutions_of_links_and_fields(chain: xd.Model) -> None:
    """Assert that every element passes by the order of the method, and none where the springs are others."""
    known = xd.manufactured(chain, WANTED)
    assert xd.Model.from_text(known.to_toml()).digest == known.digest
    found = xd.validate(["rk4"], known)
    assert {"u[a]", "v_u[c]", "T[b]"} <= {*found.case_name.values.tolist()}
    assert (found.verdict == 0).all()
    wrong = xd.Model.from_text(known.to_toml().replace("(second(u, spring) - first(u, spring))**2/2", "metre**2/1"))
    assert (xd.validate(["rk4"], wrong).verdict != 0).sum() == 6


@pytest.mark.parametrize(
    ("trajectory", "said"),
    [
        ({"u": "metre*sin(t/second)"}, r"has the dimensions \(\), needs those of 'u', \(site\); index of a dimension"),
        ({"u": "second*index(site)"}, "has units 's', needs 'm'"),
        ({"u": "u*index(site)"}, "reads 'u'; a trajectory is of t and parameters"),
        ({"u": "metre*index(body)"}, "'body' is no dimension or relation"),
        ({"r": "metre"}, "'u' has no trajectory; 'T' has no trajectory; 'r' is no coordinate or state; there are u, T"),
    ],
)
def test_trajectories_are_checked(chain: xd.Model, trajectory: dict[str, str], said: str) -> None:
    """Assert one sentence for what a trajectory lacks."""
    given = trajectory if "r" in trajectory else {"T": WANTED["T"], **trajectory}
    with pytest.raises(xd.InputError, match=said):
        xd.manufactured(chain, given)


def test_an_element_has_a_tolerance_of_its_own() -> None:
    """Assert that it counts before that of its block, whichever comes first, and that a message names blocks."""
    pair = xd.Model.from_text(PAIR)
    for atol in ({"x[b]": "1 um", "x": "1 mm"}, {"x": "1 mm", "x[ b ]": "1 um"}):
        run = xd.simulate(pair, rtol=1e-9, atol=atol)
        assert run.x.attrs["atol"].tolist() == [1e-3, 1e-6]
    said = "; there are x and its elements, as x[a], v_x and its elements, as v_x[a]"
    for name, message in {
        "q": f"atol names 'q'{said}",
        "x[q]": "atol names 'x[q]': dimension 'body' has no element q",
    }.items():
        with pytest.raises(xd.InputError, match=re.escape(message)):
            xd.simulate(pair, atol={name: "1 um"})


@pytest.mark.dear
def test_budgets_are_of_elements_or_blocks(chain: xd.Model) -> None:
    """Assert that terms are chosen by element and by block, and that all of a block are its elements together."""
    one = xd.error_budget(chain, "u[a]", at="1 s", only=["m[a]", "c"])
    assert one.term_name.values.tolist() == ["c", "m[a]"]
    block = xd.error_budget(chain, "u[a]", at="1 s", only="m")
    assert block.term_name.values.tolist() == ["m[a]", "m[b]", "m[c]"]
    assert float(block.standard_uncertainty[0]) == float(one.standard_uncertainty[1])
    with pytest.raises(xd.InputError, match=re.escape("only names 'm[q]': dimension 'site' has no element q")):
        xd.error_budget(chain, "u[a]", at="1 s", only="m[q]")


def test_modes_are_along_the_dimension() -> None:
    """Assert frequencies, and that each mode is of one mass alone."""
    found = xd.modes(xd.Model.from_text(PAIR))
    assert found.shape_x.dims == ("mode", "body")
    assert found.frequency.values == pytest.approx([1.0, 2.0], rel=1e-12)  # rad s-1
    np.testing.assert_allclose(np.abs(found.shape_x), np.eye(2), atol=1e-15)


def test_companions_keep_dimensions() -> None:
    """Assert that the errors of all elements are those of the closed form."""
    pair = xd.Model.from_text(PAIR)
    run = xd.simulate(pair, rtol=1e-6)
    beside = xd.companion(run)
    assert beside.global_error_x.dims == ("at", "body")
    error = run.x[-1] - np.cos([1.0, 2.0])
    assert beside.global_error_x[-1].values == pytest.approx(error.values, rel=0.2, abs=1e-12)


def test_more_time_is_the_longer_run(tmp_path: Path) -> None:
    """Assert that steps of a grid that are added are those of one march, in memory and in a file."""
    pair = xd.Model.from_text(PAIR)
    asked = {"method": "rk4", "step": "0.125 s"}
    longer = xd.simulate(pair, until="2 s", **asked)
    extended = xd.extend(xd.simulate(pair, **asked), until="2 s", path=tmp_path / "pair.nc")
    assert extended.x.dims == ("step", "body")
    with xd.open_run(tmp_path / "pair.nc") as read:
        for found in (extended, read):
            np.testing.assert_array_equal(found.x.sel(body="b"), longer.x.sel(body="b"))


@pytest.mark.dear
def test_certificates_are_of_elements(chain: xd.Model, tmp_path: Path) -> None:
    """Assert the terms, gates and value of one element's certificate, and that a file of it is checked again."""
    found = xd.certify(chain, "u[b]", at="1 s", draws=0)
    terms = found.term_name.values.tolist()
    assert terms[4:] == ["c", "m[a]", "m[b]", "m[c]"]
    assert set(found.gate_verdict.values.tolist()) <= {0, 2}
    fine = xd.simulate(chain, method="dop853", rtol=1e-12, step=None)
    assert abs(float(found.value) - float(fine.u.sel(site="b")[-1])) <= float(found.numerical_bound)
    xd.save(found, tmp_path / "certificate.nc")
    assert xd.recheck(tmp_path / "certificate.nc").attrs["result"] == found.attrs["result"]


def test_whole_quantities_have_no_certificate(chain: xd.Model) -> None:
    """Assert that one of several elements is asked for, and which there are, where a block or none is named."""
    with pytest.raises(xd.InputError, match=re.escape("; 'u' has the elements u[a], u[b], u[c]: name one")):
        xd.certify(chain, "u", at="1 s", draws=0)
    with pytest.raises(
        xd.InputError, match=re.escape("'u[q]': dimension 'site' has no element q; it has the labels a, b, c")
    ):
        xd.certify(chain, "u[q]", at="1 s", draws=0)
    data = xd.sample(xd.simulate(chain), times=[0.5, 1.0])
    with pytest.raises(
        xd.InputError, match=re.escape("'k[7]': dimension 'spring' has no element 7; it has the elements 0 to 1")
    ):
        xd.fit(chain, xr.Dataset({"u": (("time", "site"), data.u.values, {"units": "m"})}), ["k[7]"])


@pytest.mark.dear
def test_links_and_masses_are_fitted(chain: xd.Model) -> None:
    """Assert that the stiffness of one link and the mass of one site are found again from motions of all, or of one."""
    asked = {"method": "dop853", "rtol": 1e-10, "step": None}
    moments = np.linspace(0.0, 1.0, 11)
    seen = xd.sample(xd.simulate(chain, **asked), times=moments).u.values
    data = xr.Dataset(
        {"u": (("time", "site"), seen, {"units": "m"})},
        {"time": ("time", moments, {"units": "s"}), "site": ["a", "b", "c"]},
    )
    away = chain.replace(parameters={"k[0]": "3 N m-1", "m[a]": "1.3 kg"})
    found = xd.fit(away, data, ["m[a]", "k[0]"], **asked)
    assert found.parameter_name.values.tolist() == ["m[a]", "k[0]"]
    assert found.estimate.values == pytest.approx([1.0, 4.0], rel=1e-6)


BALLS = """
name = "balls"
[dimensions]
ball = 25
[coordinates]
y = { unit = "m", dims = ["ball"] }
[mass]
y = "1*kilogram"
[forces.weight]
y = "-9.81*newton"
[contacts.floor]
gap = "y"
restitution = 0.5
[initial]
y = "(1 + index(ball))*0.01*metre"
"""


@pytest.mark.dear
@pytest.mark.parametrize(("text", "until"), [(CHAIN, "20 s"), (BALLS, "0.4 s")], ids=["chain", "balls"])
def test_runs_of_elements_are_resumed(text: str, until: str, tmp_path: Path) -> None:
    """Assert that a run of elements, and one of many contacts, that was stopped goes on from its file to the same bits."""
    model, path = xd.Model.from_text(text), tmp_path / "run.nc"
    method, step = ("rk4", "1 ms") if text == CHAIN else ("velocity_verlet", "20 us")
    asked = {"method": method, "step": step, "until": until}
    whole = xd.simulate(model, **asked)

    def interrupt(*_told: object) -> None:
        os.kill(os.getpid(), signal.SIGINT)

    stopped = xd.simulate(model, **asked, path=path, progress=interrupt)
    assert stopped.attrs["run_outcome"] == "interrupted"
    assert 1 < stopped.sizes["step"] < whole.sizes["step"]
    stopped.close()
    resumed = xd.simulate(model, **asked, path=path, resume=True)
    assert resumed.attrs["content_digest"] == xd.content_digest(whole)

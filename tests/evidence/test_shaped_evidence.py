"""Evidence of models with dimensions: every verb takes elements as people write them, and returns them as one variable.

Verbs that take elements and blocks by name: tolerances, budgets, manufactured solutions, modes, companions, more time.
"""

from __future__ import annotations

import os
import re
import signal
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.documenting.summary import summary
from xdynamics.evidence.diagnosing import extremes
from xdynamics.expressions import parse
from xdynamics.figures.bodies_scene import BodiesScene
from xdynamics.figures.scenes import Profile, scene_of
from xdynamics.record import unfold

# oscillators of their own, of which everything is known in closed form
SPRINGS = """
name = "Two masses, each on a spring"
[dimensions]
body = ["a", "b"]
[coordinates]
x = { unit = "m", dims = ["body"] }
[parameters]
m = "1 kg"
k = { dims = ["body"], values = { a = "1 N m-1", b = "4 N m-1" } }
A = "1 m"
[mass]
x = "m"
[forces.springs]
x = "-k*x"
[initial]
x = "A"
v_x = { unit = "m s-1", value = [0.0, 0.0] }
[run]
method = "dop853"
rtol = 1e-10
until = "3 s"
"""
FORM = {"x": "A*cos(sqrt(k/m)*t)"}
TIMES = np.linspace(0.1, 2.9, 29)


@pytest.fixture(scope="module")
def springs() -> xd.Model:
    return xd.Model.from_text(SPRINGS)


@pytest.fixture(scope="module")
def run(springs: xd.Model) -> xr.Dataset:
    return xd.simulate(springs)


@pytest.mark.dear
def test_closed_forms_and_cycles_of_elements(run: xr.Dataset) -> None:
    """Assert residuals of a form with dimensions and of one element, and the period of the element that is asked for."""
    found = xd.diagnose(run, exact=FORM, of="x[b]")
    assert found.largest_residual_x.dims == ("body",)
    assert (found.largest_residual_x < 1e-8).all()
    assert found.attrs["coordinate"] == "x[b]"
    one = xd.diagnose(run, exact={"x[a]": "A*cos(sqrt(k[a]/m)*t)"}, companion=False)
    assert float(one.largest_residual_x.sel(body="a")) < 1e-8
    assert np.isnan(one.largest_residual_x.sel(body="b"))
    with pytest.raises(xd.InputError, match=r"has the dimension 'body', which x\[a\] does not have; reduce it"):
        xd.diagnose(run, exact={"x[a]": "A*cos(sqrt(k/m)*t)"})


def test_long_names_say_elements_as_people_write_them(run: xr.Dataset) -> None:
    """Assert brackets in evidence of one element, and whole names, and no dots, where a variable has all of them."""
    found = xd.diagnose(run, of="x[b]", companion=False)
    assert found.cycle_time.long_name.startswith("end of the cycle, where x[b] rises through ")
    landing = "\n[events.turn]\nfunction = 'v_x'\ndirection = 'rising'\naction = 'record'\n"
    numbered = SPRINGS.replace('["a", "b"]', "2").replace(
        'values = { a = "1 N m-1", b = "4 N m-1" }', "value = [1, 4], unit = 'N m-1'"
    )
    model = xd.Model.from_text(numbered + landing)
    refined = xd.refine(model, rtols=[1e-5, 1e-6, 1e-7], until="4 s")
    assert refined.limit_after_turn_x.long_name == "limit of after_turn_x as rtol tends to zero"
    assert not [name for each in (found, refined) for name in each.variables if "·" in each[name].long_name]


def test_a_comparison_names_the_element_that_parts_first(springs: xd.Model, run: xr.Dataset) -> None:
    """Assert that of two masses the one whose spring differs is named, in the sentence and in a line of each quantity."""
    models = springs, springs.replace(parameters={"k[b]": "4.001 N m-1"})
    found = xd.compare(*(xd.simulate(model, method="rk4", step="0.1 s") for model in models), times=TIMES)
    assert ": x[b] by " in found.attrs["parted"]
    assert "[b]', row 0: " in found.attrs["first_difference"]
    loose = xd.simulate(springs, rtol=1e-9)
    assert "', attribute 'atol': " in xd.compare(run, loose, times=TIMES).attrs["first_difference"]
    lines = [line for line in summary(found) if line.startswith("x[")]
    assert len(lines) == 1
    assert lines[0].startswith("x[b] ")
    assert (found.difference_x.sel(body="a") == 0.0).all()


def test_a_closed_form_is_read_once_for_all_elements(run: xr.Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a form of a quantity is parsed once, that an element's own form stands beside it, and what is refused."""
    texts = []
    module = "xdynamics.evidence.diagnosing.conservation"
    monkeypatch.setattr(f"{module}.parse", lambda text: texts.append(text) or parse(text))
    found = xd.diagnose(run, exact=FORM | {"v_x[b]": "-A*sqrt(k[b]/m)*sin(sqrt(k[b]/m)*t)"}, companion=False)
    assert len(texts) == 2
    assert (found.largest_residual_x < 1e-8).all()
    for form, message in (
        ({"x": "x"}, r"reads 'x\[a\]', which is what is computed"),
        ({"x": "A*t"}, "has units 'm s', needs 'm'"),
        ({"x[a]": "A*index(body)"}, "has the dimension 'body', which x\\[a\\] does not have"),
        ({"z": "A"}, "exact names 'z'; there are x, v_x"),
    ):
        with pytest.raises(xd.InputError, match=message):
            xd.diagnose(run, exact=form, companion=False)


def test_summaries_name_elements(run: xr.Dataset, tmp_path: Path) -> None:
    """Assert that what a record says of an extreme is named as its variable is, not within the brackets."""
    text = xd.report(tmp_path / "page", extremes=xd.diagnose(run))
    row = next(line for line in text.splitlines() if line.startswith("x[b] "))
    assert len(re.findall(r" at [0-9.]+ s", row)) == 2
    assert "b_time]" not in text


@pytest.mark.parametrize("elements", [["k"], ["k[a]", "k[b]"]])
def test_fits_of_elements(springs: xd.Model, elements: list[str]) -> None:
    """Assert that a quantity stands for its elements, and that data with dimensions are read by labels."""
    values = np.stack([np.cos(3.0 * TIMES), np.cos(1.5 * TIMES)], axis=-1)
    data = xr.Dataset(
        {"x": (("time", "body"), values, {"units": "m"})},
        {"time": ("time", TIMES, {"units": "s"}), "body": ["b", "a"]},
    )
    bounds = {elements[-1]: ("0.1 N m-1", "20 N m-1")}
    found = xd.fit(springs, data, elements, bounds=bounds)
    assert found.parameter_name.values.tolist() == ["k[a]", "k[b]"]
    assert found.estimate.values == pytest.approx([2.25, 9.0], rel=1e-7)
    assert found.residual_x.dims == ("at", "body")
    fitted = xd.Model.from_text(found.model_toml.item())
    assert fitted.parameters["k[a]"].quantity.value == pytest.approx(2.25, rel=1e-7)
    assert [*fitted.elements.statement.correlations] == [("k·a", "k·b")]
    with pytest.raises(xd.InputError, match=r"the Dataset has 1 elements of 'body', needs all 2, or a coordinate"):
        xd.fit(springs, data.drop_vars("body").isel(body=[0]), elements)


def test_located_times_of_elements_are_refined(springs: xd.Model) -> None:
    """Assert that time tolerances are refined where events are along a dimension."""
    model = springs.replace(events={"through": {"function": "x", "direction": "falling"}})
    found = xd.refine(
        model, time_tolerances=["1e-3 s", "1e-5 s", "1e-7 s"], method="dormand_prince", rtol=1e-9, until="1.5 s"
    )
    assert found.event_time_through.sizes["body"] == 2


def test_columns_of_elements(springs: xd.Model, run: xr.Dataset, tmp_path: Path) -> None:
    """Assert that a table of an instrument names elements in brackets, beside units in brackets."""
    table = tmp_path / "bench.csv"
    rows = [f"{t},{1e3 * np.cos(2.0 * t)},0.1" for t in TIMES.tolist()]
    table.write_text("\n".join(["time [s],x[b] [mm],u(x[b]) [mm]", *rows]), encoding="utf-8")
    beside = xd.compare(run, table)
    assert abs(float(beside.rms_difference_x.sel(body="b"))) < 1e-8
    assert np.isnan(beside.rms_difference_x.sel(body="a"))
    found = xd.fit(springs, table, ["k[b]"])
    assert float(found.estimate[0]) == pytest.approx(4.0, rel=1e-7)
    table.write_text("time [s],x[c] [mm]\n0,1\n1,1", encoding="utf-8")
    with pytest.raises(xd.InputError, match=r"column 'x\[c\] \[mm\]' is no quantity of the model, which has x, v_x"):
        xd.compare(run, table)


def test_influences_are_of_each_element(springs: xd.Model) -> None:
    """Assert that a stiffness changes its own mass alone, and that the spread between masses is no influence."""
    axes = {"k[a]": ["1 N m-1", "2 N m-1"], "A": ["1 m", "2 m"]}
    shares = xd.influences(xd.sweep(springs, axes, keep=["end_x"])).main_effect_end_x
    assert shares.dims == ("sweep_axis", "body")
    assert float(shares.sel(body="b")[0]) == pytest.approx(0.0, abs=1e-12)
    assert float(shares.sel(body="b")[1]) == pytest.approx(1.0)
    ends = np.cos(3.0 * np.sqrt([1.0, 2.0]))[:, None] * np.array([1.0, 2.0])
    assert float(shares.sel(body="a")[0]) == pytest.approx(ends.mean(1).var() / ends.var(), rel=1e-6)


@pytest.mark.dear
def test_shares_and_limits_of_elements(springs: xd.Model) -> None:
    """Assert Sobol's indices and a limiting case of elements."""
    ranges = {"k[a]": ["1 N m-1", "2 N m-1"], "A": ["1 m", "2 m"]}
    shares = xd.sobol_indices(springs, ranges, "end_x[b]", draws=16)
    assert shares.parameter_name.values.tolist() == ["k[a]", "A"]
    assert shares.total_order.values == pytest.approx([0.0, 1.0], abs=0.2)
    levels = ["3 N m-1", "3.9 N m-1", "3.99 N m-1"]
    found = xd.limiting(springs, "k[b]", levels, "4 N m-1", at="1 s", observables=["x"])
    assert found.approached_x.dims == ("at", "body")
    assert float(found.limit_x.sel(body="b")[0]) == pytest.approx(np.cos(2.0), abs=1e-8)


def test_shares_of_whole_quantities(springs: xd.Model) -> None:
    """Assert that shares of all elements are those of each alone, that a stiffness acts on its own mass, and nan where none does."""
    ranges = {"k[a]": ["1 N m-1", "2 N m-1"], "A": ["1 m", "2 m"]}
    whole, alone = (xd.sobol_indices(springs, ranges, quantity, draws=16) for quantity in ("end_x", "end_x[a]"))
    assert whole.first_order_interval.dims == ("parameter", "body", "bound")
    np.testing.assert_array_equal(whole.total_order.sel(body="a"), alone.total_order)
    np.testing.assert_allclose(whole.total_order_interval.sel(body="a"), alone.total_order_interval, rtol=1e-12, atol=0)
    assert abs(float(whole.total_order.sel(body="b")[0])) < 1e-12
    assert "A of end_x[b]: first order" in "\n".join(summary(whole))
    asked = {"method": "rk4", "step": "0.1 s"}  # chosen steps would let one mass move the other
    still = xd.sobol_indices(springs, {"k[a]": ranges["k[a]"]}, "end_x", draws=16, **asked).first_order
    assert still.isnull().values.tolist() == [[False, True]]


def test_surveys_keep_labels(springs: xd.Model) -> None:
    """Assert that what is made of a sweep is selected by label, as the sweep is, and survives an archive."""
    sweep = xd.sweep(springs, {"A": ["1 m", "2 m", "3 m"]}, keep=["end_x"])
    slopes = xd.sensitivities(sweep, compute=True)
    assert float(slopes.slope_end_x_A.sel(body="b")[0]) == pytest.approx(np.cos(6.0), rel=1e-6)
    assert "body" in xd.contrast(sweep, "A").coords


def test_dimensions_of_evidence_are_taken() -> None:
    """Assert that a model's dimension has no name that evidence has a dimension of."""
    with pytest.raises(xd.ModelError, match="'turn' is a dimension of the record"):
        xd.Model.from_text(SPRINGS.replace("body", "turn"))


@pytest.mark.parametrize(("name", "lines"), [("truss", 10), ("figure_eight", 0)])
def test_bodies_move_with_their_links(name: str, lines: int) -> None:
    """Assert that links of a table are lines between bodies, where these are, and that every two bodies have none."""
    model = xd.Model.from_toml(MODELS / f"{name}.toml")
    run = xd.simulate(model, until="0.1 s")
    scene = scene_of(unfold(run), None)
    assert isinstance(scene, BodiesScene)
    axes = Figure().subplots()
    scene.start(axes)
    _, *links, _ = scene.move_to(float(run.time[-1]))
    assert len(links) == (2 if lines else 0)  # bars, and hangers from fixed places
    ends = {tuple(np.round(ends, 12).ravel()) for each in links for ends in each.get_segments()}
    r = run.r.values[-1]
    bars = np.stack([run.bar_first, run.bar_second], axis=-1).tolist() if lines else []
    wanted = {tuple(np.round(r[bar].ravel(), 12)) for bar in bars}
    if lines:
        hung = zip(run.hanger_first.values, run.hanger_second.values, strict=True)
        wanted |= {tuple(np.round([*r[joint], *run.place.values[support]], 12)) for joint, support in hung}
    assert (len(ends), ends) == (lines, wanted)


def test_a_field_has_a_film(tmp_path: Path) -> None:
    """Assert that a field is drawn between recorded states, and that its film is written."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "heat.toml"), until="100 s")
    scene = scene_of(unfold(run), None)
    assert isinstance(scene, Profile)
    axes = Figure().subplots()
    scene.start(axes)
    times = run.time.values
    (line,) = scene.move_to(0.25 * times[2] + 0.75 * times[3])
    assert line.get_ydata() == pytest.approx(0.25 * run["T"].values[2] + 0.75 * run["T"].values[3])
    film = xd.animate(run, tmp_path / "heat.gif", seconds=0.3, rate=10, dpi=40)
    assert Path(str(film)).stat().st_size > 1000


def test_models_are_shown_by_their_quantities(springs: xd.Model) -> None:
    """Assert that a cell of a notebook shows a quantity once, with its dimensions."""
    assert repr(springs) == "<xdynamics.Model 'Two masses, each on a spring': x(body); forces springs>"


SPEEDING = """
name = "bodies that speed up beside an oscillator"
[dimensions]
body = 3
[coordinates]
x = "m"
z = { unit = "m", dims = ["body"] }
[parameters]
a = { dims = ["body"], unit = "m s-2", value = [1.0, -2.0, 4.0] }
m = { dims = ["body"], unit = "kg", value = [1.0, 3.0, 0.5] }
[mass]
x = "1*kilogram"
z = "m"
[forces.spring]
x = "-x*newton/metre"
[forces.thrust]
z = "m*a"
[observables]
speed = "v_z"
[initial]
x = "1 m"
z = "0 m"
[run]
method = "rk4"
step = "50 ms"
until = "20 s"
"""


@pytest.mark.parametrize("most", [extremes.MOST_NAMES, 0])
def test_drifts_are_the_last_cycle_less_the_first(monkeypatch: pytest.MonkeyPatch, most: int) -> None:
    """Assert by elements, and side by side, that speeds a t and momenta m a t grow by what is between cycles."""
    monkeypatch.setattr(extremes, "MOST_NAMES", most)
    found = xd.diagnose(xd.simulate(xd.Model.from_text(SPEEDING)), of="x", companion=False)
    assert found.sizes["cycle"] == 2
    rate, mass, between = np.array([1.0, -2.0, 4.0]), np.array([1.0, 3.0, 0.5]), found.period.values.mean()
    np.testing.assert_allclose(found.drift_speed, rate * between, rtol=1e-12)
    np.testing.assert_allclose(found.drift_momentum_z, mass * rate * between, rtol=1e-12)
    assert between == pytest.approx(2.0 * np.pi, rel=1e-6)
    assert found.maximum_x.dims == ()
    assert float(found.maximum_x) == pytest.approx(1.0, rel=1e-6)


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

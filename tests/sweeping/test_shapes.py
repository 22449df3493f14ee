"""Sweeps of models with dimensions: what is kept of elements is one variable, labelled; axes vary elements or wholes.

Sweeps whose members have numbers of 31 digits: each as it is when marched alone.
Sweeps of bodies with many contacts: members go on where the log that they share is full of impacts or closed links.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.problems import MODELS
from xdynamics import archive
from xdynamics.documenting.summary import summary
from xdynamics.faults import DOT
from xdynamics.march import simd_ensemble
from xdynamics.march.configuration import unthinned_settings_for
from xdynamics.sweeping.kept_quantities import keeping_of
from xdynamics.sweeping.members import digest_of_end

SUN = {"mu[Sun]": "2.9e-4:3e-4:3 astronomical_unit3 d-2"}
COARSE = {"method": "dop853", "rtol": 1e-6, "until": "2000 day"}
ESCAPE = """
name = "Escapes"
[dimensions]
body = ["a", "b"]
[coordinates]
x = { unit = "m", dims = ["body"] }
[parameters]
m = { dims = ["body"], value = [1.0, 2.0], unit = "kg" }
f = "1 N"
edge = "1 m"
[mass]
x = "m"
[forces.push]
x = "f"
[events.escape]
function = "x - edge"
direction = "rising"
action = "stop"
[initial]
x = { unit = "m", value = [0.0, 0.9] }
v_x = { unit = "m s-1", value = [0.0, 0.0] }
[run]
method = "dop853"
rtol = 1e-9
until = "10 s"
"""


@pytest.fixture(scope="module")
def planets() -> xd.Model:
    return xd.Model.from_toml(MODELS / "outer_solar_system.toml")


@pytest.fixture(scope="module")
def escapes() -> xd.Model:
    return xd.Model.from_text(ESCAPE)


@pytest.mark.dear
def test_elements_are_one_variable(planets: xd.Model) -> None:
    """Assert dims and labels of ends, times and extremes; nothing is named by the dot, and nothing is marched for it."""
    keep = ["end", "maximum_r[Jupiter,x]", "momentum", "r"]
    found = xd.sweep(planets, SUN, keep=keep, times=["0 day", "1000 day"], **COARSE)
    assert found.end_r.dims == ("mu[Sun]", "body", "axis")
    assert found.r.dims == ("mu[Sun]", "at", "body", "axis")
    assert found.momentum.dims == ("mu[Sun]", "at", "axis")
    assert not [name for name in found.variables if DOT in str(name)]
    assert all(found[name].chunks for name in ("end_r", "maximum_r", "r", "run_digest"))
    largest = found.maximum_r.compute()
    assert np.isfinite(largest.sel(body="Jupiter", axis="x")).all()
    assert int(largest.notnull().sum()) == 3


@pytest.mark.dear
def test_member_is_the_folded_run(planets: xd.Model) -> None:
    """Assert a member's last row, marched again, against its end; its value may be given in another unit."""
    found = xd.sweep(planets, {"mu[Sun]": ["1.32e20 m3 s-2", "1.33e20 m3 s-2"]}, **COARSE).compute()
    run = xd.member(found, **{"mu[Sun]": "1.33e20 m3 s-2"})
    assert np.array_equal(run.r[-1], found.end_r[1])
    assert found["mu[Sun]"].attrs["units"] == "astronomical_unit3 d-2"


def test_a_whole_and_an_element_at_the_start(planets: xd.Model) -> None:
    """Assert that all elements have the value of an axis named as their quantity, against models with it."""
    axes = {"initial_v_r": ["0 m/s", "10 m/s"], "mu[Jupiter]": ["3e-7 astronomical_unit3 d-2"]}
    found = xd.sweep(planets, axes, **COARSE | {"until": "20 day"}).compute()  # they fall into the sun
    assert "mu[Jupiter]" not in found.mu.attrs["elements"]
    run = xd.member(found, initial_v_r="10 m/s")
    assert len(set(run.v_r[0].values.ravel().tolist())) == 1
    assert np.array_equal(run.r[-1], found.end_r[1, 0])


def test_events_of_elements(escapes: xd.Model) -> None:
    """Assert the time of every element's event, and the name of the one that ended each run."""
    found = xd.sweep(escapes, {"m[b]": [0.1, 100.0]}, keep=["event_time_escape", "event_count_escape"]).compute()
    assert found.event_time_escape.dims == ("m[b]", "body")
    assert found.run_stopped_by.values.tolist() == ["escape[b]", "escape[a]"]
    assert found.event_time_escape.sel(body="a").isnull().values.tolist() == [True, False]
    assert found.event_count_escape.values.tolist() == [[0, 1], [1, 0]]


@pytest.mark.every(2)
@pytest.mark.parametrize("name", ["grid", "grid.zarr"])
def test_catalogues_hold_wholes(escapes: xd.Model, tmp_path: Path, name: str) -> None:
    """Assert what is opened against what was marched in memory, labels and all."""
    asked = {"axes": {"m[b]": [0.1, 100.0]}, "keep": ["end", "x", "event_time_escape"], "times": [0.1, 0.2]}
    if name.endswith("zarr"):
        pytest.importorskip("zarr")
    xd.sweep(escapes, **asked, path=tmp_path / name)
    with xd.open_sweep(tmp_path / name) as found:
        there = xd.sweep(escapes, **asked).compute()
        for word in ("end_x", "x", "event_time_escape", "run_stopped_by", "run_digest", "body", "m[b]"):
            assert found[word].dims == there[word].dims, word
            np.testing.assert_array_equal(found[word].values, there[word].values)
        assert float(xd.member(found, **{"m[b]": 0.1}).x[-1, 1]) == float(found.end_x[0, 1])


def test_members_are_added(escapes: xd.Model, tmp_path: Path) -> None:
    """Assert that a longer axis of an element keeps what was marched."""
    xd.sweep(escapes, {"m[b]": [1.0, 2.0]}, path=tmp_path).close()
    longer = xd.sweep(escapes, {"m[b]": [1.0, 2.0, 3.0]}, path=tmp_path)
    assert np.array_equal(longer.end_x, xd.sweep(escapes, {"m[b]": [1.0, 2.0, 3.0]}).end_x)


@pytest.mark.dear
def test_whole_runs(escapes: xd.Model, tmp_path: Path) -> None:
    """Assert rows of all members, and archived runs at common times, with their dimensions."""
    found = xd.sweep(escapes, {"m[b]": [1.0, 2.0]}, keep=["log"], path=tmp_path)
    rows, logs = xd.ragged(found), xd.open_logs(found, [0.1, 0.2], names=["x", "v_x[a]"])
    assert rows.x.dims == ("row", "body")
    assert logs.x.dims == ("m[b]", "at", "body")
    assert float(logs.v_x.sel(body="a")[0, 1]) == pytest.approx(0.2)
    assert logs.v_x.sel(body="b").isnull().all()
    run = xd.member(found, **{"m[b]": 2.0})
    assert np.array_equal(run.x.sel(body="a"), rows.x.sel(body="a")[-run.sizes["step"] :])
    run.close()


@pytest.mark.parametrize(
    ("axes", "keep", "said"),
    [
        ({"m[c]": [1.0]}, "end", r"'m\[c\]': dimension 'body' has no element c; it has the labels a, b"),
        ({"m[a]": ["1 s"]}, "end", "has 1.0 s, needs the unit 'kg'"),
        ({"body": {"m[a]": [1.0], "m[b]": [2.0]}}, "end", "is a dimension of the model"),
        ({"m": [1.0], "m[a]": [2.0]}, "end", r"'m\[a\]' varies along both 'm' and 'm\[a\]'"),
        (
            {"m[a]": [1.0]},
            "end_x[c]",
            r"keep has 'end_x\[c\]': dimension 'body' has no element c; it has the labels a, b",
        ),
        ({"m[a]": [1.0]}, "after_escape_x", "keep has 'after_escape_x', which no run"),
    ],
)
def test_what_is_refused(escapes: xd.Model, axes: dict[str, object], keep: str, said: str) -> None:
    """Assert that names and values are refused in a line, elements named as people write them."""
    with pytest.raises(xd.InputError, match=said) as caught:
        xd.sweep(escapes, axes, keep=[keep])
    assert DOT not in str(caught.value)


@pytest.mark.parametrize(("names", "drawn"), [(["m[b]"], ["m[b]"]), (["m"], ["m[a]", "m[b]"])])
def test_draws_of_declared_elements(names: list[str], drawn: list[str]) -> None:
    """Assert that elements are drawn by their names as people write them, and all of a quantity by its own."""
    text = ESCAPE.replace('unit = "kg" }', 'unit = "kg", uncertainty = [0.01, 0.02] }')
    found = xd.sweep(xd.Model.from_text(text), {"draw": xd.Draws(64, names, design="declared")})
    assert [str(name) for name in found.coords if str(name).startswith("m[")] == drawn
    assert float(found["m[b]"].std()) == pytest.approx(0.02, rel=0.3)
    with pytest.raises(
        xd.InputError, match=r"axis 'draw': 'm\[c\]': dimension 'body' has no element c; it has the labels a, b"
    ):
        xd.sweep(xd.Model.from_text(text), {"draw": xd.Draws(4, ["m[c]"], design="declared")})


CROSSED = """
name = "crossed"
[dimensions]
site = 3
[coordinates]
u = { unit = "m", dims = ["site"] }
q = "m"
[parameters]
c = "1 N m-1"
[mass]
u = "1*kilogram"
q = "1*kilogram"
[forces.springs]
u = "-c*u*(1 + index(site))"
q = "-1*newton"
[events.passes]
function = "q + 0.5*metre"
direction = "falling"
[initial]
u = "metre*(1 + index(site))"
q = "0 m"
"""


@pytest.mark.parametrize("head", ["after", "before"])
@pytest.mark.parametrize("occurrences", [1, 2])
def test_a_whole_quantity_at_an_event_is_that_of_the_member(head: str, occurrences: int) -> None:
    """Assert the state of all elements at an event, one dimension more where several occurrences are kept, nan where none is."""
    model, asked = xd.Model.from_text(CROSSED), {"method": "rk4", "step": "10 ms"}
    word = f"{head}_passes_u"
    more = {"occurrences": occurrences} if occurrences > 1 else {}
    for until, is_met in (("1.5 s", True), ("0.5 s", False)):
        sweep = xd.sweep(model, {"c": ["1 N m-1", "2 N m-1"]}, keep=[word], until=until, **asked, **more)
        ends = sweep[word].compute()
        assert ends.dims == sweep[word].dims == ("c", *(["occurrence"] if more else []), "site")
        first = ends.isel(occurrence=0).values if more else ends.values
        for k, value in enumerate(("1 N m-1", "2 N m-1")):
            run = xd.simulate(model.replace(parameters={"c": value}), until=until, **asked)
            if is_met:
                row = int(run[f"event_row_{head}"][0])
                assert first[k].tobytes() == run.u.values[row].tobytes()
            else:
                assert np.isnan(first[k]).all()
        if more:
            assert np.isnan(ends.isel(occurrence=1).values).all()


def test_extremes_of_whole_quantities_are_those_of_elements() -> None:
    """Assert every number against sweeps asked for single elements, and against `diagnose`."""
    chain = """
name = "chain"
dimensions = { site = 5 }
coordinates = { u = { unit = "m", dims = ["site"] } }
mass = { u = "1*kilogram*(1 + 0.1*index(site))" }
parameters = { k = "1 N m-1", c = { value = [1, 2, 3, 4, 5], unit = "kg s-1", dims = ["site"] } }
definitions = { stretch = "shift(u, site, -1, 0*metre) - u" }
observables = { product = "c*u*v_u" }
[forces]
spring = { potential = "sum(0.5*k*stretch**2, site)" }
drag = { u = "-0.01*c*v_u" }
[initial]
u = "0.1*metre*sin(pi*(index(site) + 1)/6)"
v_u = "0.1*metre/second*(index(site) - 1.5)"
"""
    model, heads = xd.Model.from_text(chain), [f"maximum_{name}" for name in ("u", "v_u", "product")]
    asked = {"method": "dop853", "rtol": 1e-7, "until": "9 s"}
    axes = {"k": ["1 N m-1", "2 N m-1"]}
    whole = xd.sweep(model, axes, keep=heads, **asked).compute()
    told = xd.diagnose(xd.simulate(model.replace(parameters={"k": "2 N m-1"}), keep_every=1, **asked), companion=False)
    for head in heads:
        assert (whole[f"{head}_rule"] == 1).any(), head  # some are between accepted states
        for end in ("", "_time", "_uncertainty"):
            assert whole[f"{head}{end}"].values[1].tobytes() == told[f"{head}{end}"].values.tobytes(), (head, end)
        for i in range(5):
            alone = xd.sweep(model, axes, keep=[f"{head}[{i}]"], **asked).compute()
            for end in ("", "_time", "_rule", "_uncertainty"):
                ours, its = whole[f"{head}{end}"].values[:, i], alone[f"{head}{end}"].values[:, i]
                assert ours.tobytes() == its.tobytes(), (head, i, end)


def test_marches_read_one_name_of_each_element() -> None:
    """Assert that what extremes of many elements read grows with their number, not with its square."""
    text = CROSSED.replace("site = 3", "site = 40")
    model = xd.Model.from_text(text)
    kept = keeping_of(["maximum_u"], None, 1).variables(
        model, unthinned_settings_for(model, method="rk4", step="10 ms", until="1 s")
    )
    for variable in kept:
        assert variable.log_columns == tuple(f"u{DOT}{i}" for i in range(40))
    assert len({id(variable.motion) for variable in kept}) == 1


BOTH = ["float64", "double_double"]
UNTIL: dict[str, Any] = {"method": "rk4", "until": "1 s"}
AXES = {"precision": BOTH, "k": ["0.1 N m-1", "0.7 N m-1"], "step": ["0.1 s", "0.3 s"]}
CELLS = [(precision, k, step) for precision in BOTH for k in AXES["k"] for step in AXES["step"]]
SWING = xd.Model(
    name="swing",
    coordinates={"x": {"unit": "mm"}},
    parameters={"k": "0.1 N m-1", "m": "0.3 kg"},
    mass={"x": "m"},
    forces={"spring": {"x": "-k*x"}},
    events={"middle": {"function": "x", "action": "reset", "set": {"v_x": "-0.9*v_x"}}},
    initial={"x": "0.2 mm", "v_x": "-1.1 mm s-1"},
)


def alone(precision: str, k: str, step: str) -> Any:
    """March one of the members by itself."""
    return xd.simulate(SWING.replace(parameters={"k": k}), precision=precision, step=step, **UNTIL)


def test_members_are_the_runs_that_are_marched_alone() -> None:
    """Assert digests, states at times, extremes and event times of those of `simulate`, and that rests make a difference."""
    kept = ["end", "x", "maximum_x", "event_time_middle"]
    swept = xd.sweep(SWING, AXES, keep=kept, times=["0.33 s"], check=1.0, **UNTIL).compute()
    for precision, k, step in CELLS:
        run = alone(precision, k, step)
        cell = swept.sel(solver_precision=precision, k=float(k.split()[0]), solver_step=float(step.split()[0]))
        assert str(cell.run_digest.values) == digest_of_end(run, ["x", "v_x"])
        assert float(cell.x[0]) == float(xd.sample(run, ["0.33 s"]).x[0])
        assert float(cell.event_time_middle) == float(run.event_time[0])
        assert float(cell.maximum_x) == float(xd.diagnose(run, companion=False).maximum_x)
    assert (swept.x.sel(solver_precision=BOTH[0]) != swept.x.sel(solver_precision=BOTH[1])).any()


def test_values_keep_the_digits_that_were_written(tmp_path: Path) -> None:
    """Assert that a value of 25 digits is that of the run marched alone with it, in its rests, and not the nearest float's."""
    k = "0.1000000000000000055511151 N m-1"  # 6e-17 from a tenth, which is the same float
    swept = xd.sweep(SWING, {"k": [k, "0.7 N m-1"]}, precision=BOTH[1], step="0.3 s", path=tmp_path / "grid", **UNTIL)
    rest = float(xd.member(swept, k=0.1).rest_x[-1])
    exact, near = (float(alone(BOTH[1], value, "0.3 s").rest_x[-1]) for value in (k, "0.1 N m-1"))
    assert rest == exact != near


@pytest.mark.dear
def test_archives_of_members_have_their_rests(tmp_path: Path) -> None:
    """Assert that whole runs of a grid are those of `simulate`, to the digest, and that rows of all are put together."""
    axes = AXES | {"step": ["0.3 s"]}
    swept = xd.sweep(SWING, axes, keep=["end", "log"], path=tmp_path / "grid", **UNTIL)
    for precision, k, step in CELLS[1::2]:
        member, run = xd.member(swept, precision=precision, k=k, step=step), alone(precision, k, step)
        assert archive.digest_of_run(member) == archive.digest_of_run(run)
        assert ("rest_x" in member) == (precision == BOTH[1])
    rows = xd.ragged(swept)
    np.testing.assert_array_equal(rows.x.values[-run.sizes["step"] :], run.x.values)


def test_an_order_follows_the_tolerance_of_each_member() -> None:
    """Assert that tolerances along an axis give each member its own order, in one task too, and are judged by precision."""
    asked: dict[str, Any] = {"method": "taylor", "until": "1 s"}
    xd.sweep(SWING, {"rtol": [1e-4, 1e-13], "k": AXES["k"]}, check=1.0, members_per_task=4, **asked).compute()
    swept = xd.sweep(SWING, {"rtol": [1e-16, 1e-17]}, check=1.0, precision=BOTH[1], order=6, **asked)
    assert (swept.run_outcome == "completed").all()
    with pytest.raises(xd.InputError, match="rtol = 1e-17 1: rtol is 1e-17, needs a number from 10 eps = 2.22e-15"):
        xd.sweep(SWING, {"precision": BOTH, "rtol": [1e-6, 1e-17]}, **asked)


RESTITUTIONS = [0.0, 0.5]
COUNT = 30  # more contacts than are written out one by one


def falling(restitution: float) -> xd.Model:
    """Return balls that fall on a floor from different heights."""
    return xd.Model(
        name="hail",
        dimensions={"ball": COUNT},
        coordinates={"y": {"unit": "m", "dims": ["ball"]}},
        parameters={"m": "1 kg", "e": str(restitution)},
        mass={"y": "m"},
        forces={"weight": {"y": "-9.80665*m*metre/second**2"}},
        contacts={"floor": {"gap": "y", "restitution": "e"}},
        initial={"y": {"unit": "m", "value": np.linspace(0.01, 0.05, COUNT).tolist()}},
    )


@pytest.mark.parametrize("keep", [["end"], ["end", "maximum_kinetic_energy"]])
def test_members_go_on_where_their_log_is_full(monkeypatch: pytest.MonkeyPatch, keep: list[str]) -> None:
    """Assert the bits of single runs, in logs with room for a part of the impacts and of the rows of closed links."""
    rows = simd_ensemble.FEWEST_ROWS
    monkeypatch.setattr(simd_ensemble, "LOG_ROWS", rows)
    asked = {"method": "velocity_verlet", "step": "2 ms", "until": "0.4 s"}
    found = xd.sweep(falling(0.5), {"e": RESTITUTIONS}, keep=keep, **asked).load()
    assert found.attrs["comment"].startswith("members are marched one after the other")
    assert any(line.startswith("remark    members are marched one after the other") for line in summary(found))
    for k, restitution in enumerate(RESTITUTIONS):
        run = xd.simulate(falling(restitution), **asked)
        assert run.sizes["step"] > 2 * rows
        assert run.sizes["closed"] > 2 * COUNT * rows
        for name in ("y", "v_y"):
            assert np.array_equal(found[f"end_{name}"].values[k], run[name].values[-1])
    assert run.sizes["event"] > rows + 3 * COUNT


def test_states_at_times_are_those_of_single_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert the bits of `sample` of each run of a heap that rubs, whose steps go on with the closed links of their rows."""
    monkeypatch.setattr(simd_ensemble, "LOG_ROWS", simd_ensemble.FEWEST_ROWS)  # of a member there are several logs
    pile, frictions = xd.Model.from_toml(MODELS / "rough_pile.toml"), ["0.4", "0.35"]
    times, until = np.linspace(0.005, 0.245, 49), "0.25 s"
    found = xd.sweep(pile, {"mu": frictions}, keep=["theta", "v_theta"], times=times, until=until).load()
    for k, friction in enumerate(frictions):
        run = xd.simulate(pile.replace(parameters={"mu": friction}), until=until)
        assert run.sizes["step"] > 2 * simd_ensemble.FEWEST_ROWS
        expected = xd.sample(run, times)
        for name in ("theta", "v_theta"):
            assert np.array_equal(found[name].values[k], expected[name].values)


def test_members_are_checked_and_marched_again(tmp_path: Path) -> None:
    """Assert that members of bodies with contacts of single links pass the check, and are runs with the bits of the ends."""
    box = xd.Model.from_toml(MODELS / "balls_in_box.toml")
    axis = {"m[a]": ["0.9 kg", "1 kg"]}
    for keep, path in ((["end"], None), (["end"], tmp_path / "ends"), (["end", "log"], tmp_path / "logs")):
        found = xd.sweep(box, axis, keep=keep, until="0.5 s", check=1.0, path=path).load()
        run = xd.member(found, **{"m[a]": "0.9 kg"})
        assert run.r.dims == ("step", "disc", "axis")
        assert np.array_equal(found.end_r.values[0], run.r.values[-1])
        assert str(found.run_digest.values[0]) != str(found.run_digest.values[1])

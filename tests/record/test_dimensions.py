"""Records of models with dimensions: what verbs return has them, what files hold too, and what verbs take."""

from functools import cache
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.cf_checker import strict_faults
from cases.problems import MODELS
from cases.verdicts import verified
from xdynamics.record.unfolding import unfold

THREE = """
name = "three bodies"
[dimensions]
body = ["Sun", "Jupiter", "Saturn"]
axis = ["x", "y"]
[coordinates]
r = { unit = "astronomical_unit", dims = ["body", "axis"] }
[parameters]
G = "6.6743e-11 m3 kg-1 s-2"
m = { dims = ["body"], values = { Sun = "1.98847e30 kg", Jupiter = "1.8982e27 kg", Saturn = "5.6834e26 kg" } }
[mass]
r = "m"
[relations.pair]
of = "body"
[forces.gravity]
over = "pair"
potential = "-G*first(m, pair)*second(m, pair)/norm(second(r, pair) - first(r, pair), axis)"
[initial]
r = { value = [[0, 0], [5.2, 0], [0, 9.58]], unit = "astronomical_unit" }
v_r = { value = [[0, 0], [0, 13.06], [-9.6, 0]], unit = "km s-1" }
[observables]
distance = "norm(second(r, pair) - first(r, pair), axis)"
[events.across]
function = "r[Jupiter, x]"
[events.low]
function = "norm(r, axis) - 10*r[Saturn, x]"
[run]
method = "dop853"
rtol = 1e-8
until = "2e8 s"
"""
BALLS = """
name = "balls"
[dimensions]
ball = 3
[coordinates]
y = { unit = "m", dims = ["ball"] }
[parameters]
m = "1 kg"
g = "9.81 m s-2"
[mass]
y = "m"
[forces.gravity]
potential = "m*g*y"
[initial]
y = "(1 + 0.5*index(ball))*metre"
[contacts.floor]
gap = "y"
restitution = 0.8
[run]
method = "dop853"
rtol = 1e-8
until = "1.2 s"
"""


@cache
def model(text=THREE):
    """A model with dimensions."""
    return xd.Model.from_text(text)


@cache
def run(text=THREE):
    """Its run."""
    return xd.simulate(model(text))


def test_a_record_has_one_variable_for_a_quantity():
    """Assert the dimensions of what a record holds, and that no element has a variable of its own."""
    dims = {name: run()[name].dims for name in ("r", "a_r", "error_r", "force_gravity_r", "sample_r", "m", "distance")}
    assert dims == {
        "r": ("step", "body", "axis"),
        "a_r": ("step", "body", "axis"),
        "error_r": ("step", "body", "axis"),
        "force_gravity_r": ("step", "body", "axis"),
        "sample_r": ("sample", "body", "axis"),
        "m": ("body",),
        "distance": ("step", "pair"),
    }
    assert not [name for name in run().variables if "·" in str(name)]
    assert run().attrs["model_dimensions"] == "pair(3) body(3) axis(2)"


def test_elements_are_selected_by_label():
    """Assert that labels select, and select what the element is."""
    chosen = run().r.sel(body="Jupiter", axis="x")
    assert float(chosen[0]) == pytest.approx(5.2)
    assert np.array_equal(chosen, unfold(run())["r·Jupiter·x"])


@pytest.mark.every(2)
@pytest.mark.parametrize("text", [THREE, BALLS])
def test_an_archive_holds_the_dimensions(tmp_path, text):
    """Assert that a run saved, streamed and made again has one digest, labels as in memory, and every value."""
    xd.save(run(text), tmp_path / "saved.nc")
    opened = xd.open_run(tmp_path / "saved.nc")
    streamed = xd.simulate(model(text), path=tmp_path / "streamed.nc")
    assert verified(tmp_path / "saved.nc") == xd.content_digest(run(text)) == xd.content_digest(streamed)
    assert {*opened.indexes} == {*run(text).indexes}
    for name, variable in run(text).variables.items():
        assert opened[name].dims == variable.dims
        assert np.array_equal(opened[name].values, variable.values, equal_nan=variable.dtype.kind == "f")
    assert xd.reproduce(tmp_path / "saved.nc").attrs["identical"] == 1


def test_the_backend_opens_with_labels(tmp_path):
    """Assert that xarray's own way of opening gives labels as an index."""
    xd.save(run(), tmp_path / "run.nc")
    with xr.open_dataset(tmp_path / "run.nc", engine="xdynamics") as opened:
        assert opened.r.sel(body="Saturn", axis="y")[0] == 9.58


@pytest.mark.dear
def test_archives_pass_the_strict_check(tmp_path):
    """Assert that archives with dimensions, labels, links and elements of events are clean under the strict CF check."""
    pytest.importorskip("compliance_checker")
    archives = [tmp_path / "three.nc", tmp_path / "balls.nc"]
    for archive, text in zip(archives, (THREE, BALLS), strict=True):
        xd.save(run(text), archive)
    assert not strict_faults(archives, tmp_path / "report.txt")


def test_an_event_names_its_element():
    """Assert that an impact tells which ball it is of, and a detector without dimensions that it has none."""
    assert run(BALLS).event_detector.attrs["flag_meanings"] == "floor"
    assert run(BALLS).event_ball.values.tolist() == [0, 1, 2, 0]
    first = run().event_detector.values.tolist().index(0)
    assert run().event_body.values[first] == -1
    assert run().event_body.attrs["flag_meanings"] == "none Sun Jupiter Saturn"


@pytest.mark.parametrize("number", [-1, 100])
def test_an_event_of_no_detector_is_refused(number):
    """Assert that an edited record names the event whose number no detector has."""
    other = run(BALLS).copy(deep=True)
    other.event_detector.values[2] = number
    with pytest.raises(xd.InputError, match=f"'event_detector' is {number} at event 2, and its flag_values are 0"):
        unfold(other)


def test_contacts_of_elements():
    """Assert that what a contact does is recorded along its elements."""
    assert run(BALLS).contact_force_floor.dims == ("step", "ball")
    assert run(BALLS).event_impulse_y.dims == ("event", "ball")
    assert run(BALLS).contact_gap_floor.attrs["long_name"] == "gap of contact floor"


def test_verbs_carry_dimensions_along():
    """Assert that what is made of a run has its dimensions, opened or in memory."""
    assert xd.sample(run(), [1e7, 2e7]).error_v_r.dims == ("at", "body", "axis")
    assert xd.diagnose(run()).maximum_r.dims == ("body", "axis")
    assert xd.modes(model()).shape_r.dims == ("mode", "body", "axis")
    assert xd.compare(run(), run()).difference_r.dims == ("at", "body", "axis")


def test_lazy_rows_stay_lazy(tmp_path):
    """Assert that chunks of an opened run give the states of the run in memory."""
    xd.save(run(), tmp_path / "run.nc")
    lazy = xd.sample(xd.open_run(tmp_path / "run.nc").chunk(step=5), [1e7, 2e7])
    assert lazy.r.chunks is not None
    assert np.array_equal(lazy.r.compute(), xd.sample(run(), [1e7, 2e7]).r)


def test_a_longer_run_is_one_run():
    """Assert that a run that is extended has the bits of one march."""
    longer = xd.extend(run(), until=2.5e8)
    assert xd.content_digest(longer) == xd.content_digest(xd.simulate(model(), until=2.5e8, nodes=[2e8]))


@pytest.mark.parametrize("log", ["states", ["r", "v_r[Jupiter, x]"]])
def test_a_log_of_some_is_completed(log):
    """Assert that a log of states, or of elements, becomes the whole one; elements that it leaves out are not recorded."""
    some = xd.simulate(model(), log=log)
    assert xd.content_digest(xd.complete(some)) == xd.content_digest(run())
    if log != "states":
        assert some.attrs["solver_log_variables"] == "r v_r[Jupiter,x]"
        assert some.v_r.shape[1:] == (1, 1)
        assert some.r.shape == run().r.shape
        kept = some.v_r.sel(logged_body="Jupiter", logged_axis="x")
        assert np.array_equal(kept, run().v_r.sel(body="Jupiter", axis="x"))


def test_tolerances_of_quantities_and_elements():
    """Assert that a tolerance is taken by a quantity and by an element, kept for each, and given again."""
    given = {"r": "1 km", "v_r[Sun, x]": "1 mm s-1"}
    judged = xd.simulate(model(), rtol=1e-6, atol=given)
    assert judged.r.attrs["atol_si"] == 1e3
    assert judged.v_r.attrs["atol_si"][0] == 1e-3
    assert judged.v_r.attrs["atol_follows"].tolist() == [0, 1, 1, 1, 1, 1]
    again = xd.extend(judged, until=2.1e8)
    assert again.v_r.attrs["atol_si"][0] == 1e-3


def test_a_part_of_a_run_is_a_selection(tmp_path):
    """Assert that rows of a run with dimensions are saved as what they are."""
    xd.save(run().isel(step=slice(0, 5)), tmp_path / "part.nc")
    assert "5 of" in xd.open_run(tmp_path / "part.nc").attrs["selection"]


def test_messages_name_elements_as_people_do():
    """Assert that a message has brackets, and a list of columns the quantities."""
    with pytest.raises(
        xd.InputError,
        match=r"log names 'rr'.*there are time, step_size, row_kind, step_number, regime, r, v_r,.* and \d+ more$",
    ):
        xd.simulate(model(), log=["rr"])
    with pytest.raises(xd.InputError, match=r"r\[Sun, x\]"):
        xd.simulate(model(), atol={"q": 1.0})


@pytest.mark.parametrize("log", ["states", ["r[Sun, x]"], ["r", "total_energy"]])
def test_what_is_left_of_a_run_is_whole_again(tmp_path, log):
    """Assert that a thinned archive of some columns, or elements, is reproduced, and completed to the bits of all of them."""
    asked = {"rtol": 1e-6, "method": "dormand_prince", "step": None}
    xd.save(xd.simulate(model(), **asked, log=log, keep_every=3), tmp_path / "part.nc")
    assert xd.reproduce(tmp_path / "part.nc").attrs["identical"] == 1
    whole, full = xd.complete(tmp_path / "part.nc"), xd.simulate(model(), **asked)
    assert {*whole.variables} == {*full.variables}
    assert all(whole[name].values.tobytes() == full[name].values.tobytes() for name in ("r", "v_r", "total_energy"))


def test_single_elements_are_kept_where_nothing_happens(tmp_path):
    """Assert that some elements of a run without events, in memory and in a file, are those of the full log."""
    full, log = xd.simulate(model(), until="1e7 s"), ["r[Sun, x]", "v_r[Saturn, y]"]
    assert full.sizes["event"] == 0
    for path in (None, tmp_path / "run.nc"):
        with xd.simulate(model(), until="1e7 s", log=log, path=path) as kept:
            assert (kept.r.attrs["elements"], kept.v_r.attrs["elements"]) == ("r[Sun,x]", "v_r[Saturn,y]")
            assert kept.logged_body.attrs["long_name"] == "which body: its label"
            assert (kept.logged_body.values.tolist(), kept.logged_axis.values.tolist()) == (
                ["Sun", "Saturn"],
                ["x", "y"],
            )
            assert kept.r[:, 0, 0].values.tobytes() == full.r[:, 0, 0].values.tobytes()
            assert kept.v_r[:, 1, 1].values.tobytes() == full.v_r[:, 2, 1].values.tobytes()
            assert np.isnan(kept.r[:, 1:]).all()


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("r[Moon, x]", "r\\[Moon, x\\]': dimension 'body' has no element Moon; it has the labels Sun, Jupiter, Saturn"),
        ("v_r[Sun]", "'v_r' needs an entry for each of its dimensions, body, axis, and 1 were given"),
        ("r[Sun, x, y]", "'r' needs an entry for each of its dimensions, body, axis, and 3 were given"),
        ("rr[Sun, x]", r"log names 'rr\[Sun, x\]', which is no column of this run's log"),
    ],
)
def test_elements_that_are_not_there(name, said):
    """Assert that an element that cannot be logged is named with what there is."""
    with pytest.raises(xd.InputError, match=said):
        xd.simulate(model(), log=["v_r", name])


def test_numbered_elements_keep_their_numbers():
    """Assert that of a dimension without labels the kept elements are selected by their numbers, a step being their size."""
    text = """
name = "Masses"
[dimensions]
site = 40
[coordinates]
u = { unit = "m", dims = ["site"] }
[parameters]
m = "1 kg"
k = { value = "1 + index(site)", unit = "N m-1", dims = ["site"] }
[mass]
u = "m"
[forces.spring]
u = "-k*u"
[initial]
u = "1 m"
"""
    asked = {"method": "velocity_verlet", "step": "0.01 s", "until": "1 s"}
    model = xd.Model.from_text(text)
    some, full = xd.simulate(model, **asked, log=["u[7]", "u[31]", "v_u[31]"]), xd.simulate(model, **asked)
    assert some.u.shape == (101, 2)
    assert some.logged_site.attrs["long_name"] == "which site: its number"
    assert some.k.shape == (40,)
    assert some.u.sel(logged_site=31).values.tobytes() == full.u[:, 31].values.tobytes()
    assert np.isnan(some.v_u.sel(logged_site=7)).all()
    last = xd.simulate(model, **asked, log=["u[-9]", "u[31]", "v_u[ -9 ]"])
    assert last.logged_site.values.tolist() == [31]
    assert last.v_u.sel(logged_site=31).values.tobytes() == full.v_u[:, 31].values.tobytes()
    with pytest.raises(
        xd.InputError, match=r"'u\[-41\]': dimension 'site' has no element -41; it has the elements 0 to 39"
    ):
        xd.simulate(model, **asked, log=["u[-41]"])


def test_tolerances_take_elements_that_are_counted_from_the_end() -> None:
    """Assert that the last element has its tolerance by either number, and that both at once, or none such, are refused."""
    model = xd.Model.from_toml(MODELS / "fermi_pasta_ulam.toml")
    asked: dict[str, Any] = {"method": "dormand_prince", "step": None, "rtol": 1e-6, "until": "1 s", "keep_every": 1}
    runs = [xd.simulate(model, **asked, atol={"u": "1 mm", name: "1 um"}) for name in ("u[31]", "u[-1]", "u[ -1 ]")]
    assert runs[0].u.attrs["atol"].tolist() == [1e-3] * 31 + [1e-6]
    assert all(run.u.attrs["atol"].tolist() == runs[0].u.attrs["atol"].tolist() for run in runs)
    with pytest.raises(xd.InputError, match=r"atol names 'u\[-33\]': dimension 'site' has no element -33"):
        xd.simulate(model, **asked, atol={"u[-33]": "1 um"})
    with pytest.raises(xd.InputError, match=r"atol names 'u\[31\]' twice"):
        xd.simulate(model, **asked, atol={"u[-1]": "1 um", "u[31]": "1 mm"})


@pytest.mark.dear
def test_numbers_of_elements_are_refined_and_budgeted():
    """Assert that a refinement of a quantity has its dimensions, and a budget is of an element as people write it."""
    steps = ["2e6 s", "1e6 s", "5e5 s"]
    refined = xd.refine(model(), method="rk4", steps=steps, at=[1e8], observables=["r", "v_r[Sun, x]"])
    assert refined.difference_r.dims == ("level", "at", "body", "axis")
    assert refined.v_r.attrs["elements"] == "v_r[Sun,x]"
    budget = xd.error_budget(model(), quantity="r[Jupiter, x]", at=1e8)
    states = xd.sample(run(), 1e8).r.sel(body="Jupiter", axis="x")
    assert float(budget.value) == pytest.approx(float(states[0]), rel=1e-6)
    assert "r[Jupiter, x]" in budget.attrs["title"]


def test_elements_of_events_and_of_contacts_of_many_share_a_column() -> None:
    """Assert which ball each apex and each impact is of, in closed form, where both stand along one dimension."""
    count = 30
    speeds = 1.0 + 0.01 * np.arange(count)
    model = xd.Model(
        name="balls",
        dimensions={"ball": count},
        coordinates={"y": {"unit": "m", "dims": ["ball"]}},
        parameters={"m": "1 kg", "g": "10 m s-2"},
        mass={"y": "m"},
        forces={"weight": {"y": "-m*g"}},
        contacts={"floor": {"gap": "y", "restitution": "1"}},
        events={"apex": {"function": "v_y", "direction": "falling"}},
        initial={"y": {"value": [0.01] * count, "unit": "m"}, "v_y": {"value": speeds.tolist(), "unit": "m s-1"}},
    )
    assert model.assemblies  # links of many
    run = xd.simulate(model, method="velocity_verlet", step=0.01, until=0.28)
    words = np.array(run.event_detector.attrs["flag_meanings"].split())[run.event_detector.values]
    times = {"apex": speeds / 10.0, "floor": (speeds + np.sqrt(speeds**2 + 0.2)) / 10.0}
    assert {*words.tolist()} == {*times}
    for word, ball, time in zip(words, run.event_ball.values, run.event_time.values, strict=True):
        assert time == pytest.approx(times[word][ball], abs=1e-9)


def test_accelerations_that_contacts_change_are_not_compared() -> None:
    """Assert that an observable along a dimension that reads them is refused, and one that does not is compared."""
    model = xd.Model(
        name="balls",
        dimensions={"ball": 2},
        coordinates={"y": {"unit": "m", "dims": ["ball"]}},
        parameters={"m": "1 kg", "g": "10 m s-2"},
        mass={"y": "m"},
        forces={"weight": {"y": "-m*g"}},
        contacts={"floor": {"gap": "y", "restitution": "1"}},
        observables={"pull": "m*a_y", "push": "m*v_y"},
        initial={"y": {"value": [1.0, 2.0], "unit": "m"}},
    )
    asked = {"method": "velocity_verlet", "until": "0.2 s", "occurrences": 0}
    study = xd.refine(model, steps=[0.02, 0.01], observables=["push"], **asked)
    assert study.push.values[-1].ravel() == pytest.approx([-2.0, -2.0])
    with pytest.raises(xd.InputError, match="'pull' reads accelerations, which contacts change"):
        xd.refine(model, steps=[0.02, 0.01], observables=["pull"], **asked)

"""Columns of the record: the same quantities, whatever units and scales they were marched and are reported in.

Rows of a million numbers are put where the record has them, and their log is filled again.
Parameters with dimensions in a record, made whole: as they are made of their elements.
Quantities with dimensions: one variable each in a record, one for each element to who computes with them.
"""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.driven_swing import swing
from cases.problems import linear_drag, particle
from xdynamics.march import March
from xdynamics.march.configuration import settings_for
from xdynamics.record import columns, factors, folded_columns
from xdynamics.record.folding import fold, labelled, model_dimensions, unlabelled
from xdynamics.record.unfolding import as_recorded, unfold
from xdynamics.shapes import Extent, Relation, Shapes
from xdynamics.shapes.blocks import Block
from xdynamics.units import Scales, parse_unit
from xdynamics.units.unit import Rounded


def test_every_column_is_the_same_in_other_units_and_scales() -> None:
    """Assert that each number of the record, in SI, hangs neither on the unit that it is reported in nor on scales."""
    one, other = swing("m"), swing("mm", scales={"length": "3 m", "time": "0.7 s", "mass": "5 kg"})
    assert list(one.variables) == list(other.variables)
    assert (one.sizes["event"], one.x.attrs["units"], other.x.attrs["units"]) == (5, "m", "mm")
    for name in one.variables:
        if one[name].dtype.kind == "U" or name == "end_memory":  # in the march's own numbers
            continue
        units = [run[name].attrs.get("units", run["event_time"].attrs["units"]) for run in (one, other)]
        first, second = (
            run[name].values * float(parse_unit(unit).factor) for run, unit in zip((one, other), units, strict=True)
        )
        assert first.shape == second.shape, name
        size = np.max(np.abs(first[np.isfinite(first)]), initial=0.0)
        close = 1e-4 if "error" in name or "uncertainty" in name else 1e-7
        assert np.allclose(first, second, rtol=0.0, atol=close * size, equal_nan=True), name
        if "atol" in one[name].attrs:
            assert one[name].attrs["atol_si"] == pytest.approx(1e-8)
            assert other[name].attrs["atol_si"] == pytest.approx(1e-8)
            assert other[name].attrs["atol"] == pytest.approx(
                1e-8 / float(parse_unit(other[name].attrs["units"]).factor)
            )


def test_columns_are_what_they_say() -> None:
    """Assert relations between columns that no unit makes true by itself: forces, works, brackets, rows, steps."""
    run = swing("m")
    m, k, c = 2.0, 3.0, 0.1
    assert run.force_spring_x.values == pytest.approx(-k * run.x.values)
    assert run.force_drag_x.values == pytest.approx(-c * run.v_x.values)
    assert m * run.a_x.values == pytest.approx((run.force_spring_x + run.force_drag_x + run.force_pull_x).values)
    assert run.rate_work.values == pytest.approx((run.force_pull_x * run.v_x).values)
    assert run.power.values == pytest.approx(c * run.v_x.values**2)
    assert run.potential_energy.values == pytest.approx(k * run.x.values**2 / 2)
    moved = run.row_kind.values != 3
    assert np.diff(run.time.values)[moved[1:]] == pytest.approx(run.step_size.values[1:][moved[1:]])
    before, after = run.event_row_before.values, run.event_row_after.values
    assert (after == before + 1).all()
    assert (run.time.values[before] == run.event_time.values).all()
    assert (run.time.values[after] == run.event_time.values).all()
    functions = np.where(run.event_detector.values == 0, run.x.values[before], run.v_x.values[before] - 0.2)
    assert run.event_residual.values == pytest.approx(functions, abs=1e-15)
    bounds = run.event_time_bounds.values
    assert (bounds[:, 1] == run.event_time.values).all()
    assert ((np.diff(bounds, axis=1)[:, 0] > 0) | (run.event_residual.values == 0)).all()
    assert (np.diff(bounds, axis=1) <= 1e-3).all()
    assert not run.event_impulse_x.values.any()
    assert not run.event_offset_x.values.any()


def test_a_run_keeps_what_it_goes_on_from() -> None:
    """Assert that the last state stands first in the numbers at the end, and that they have names."""
    run = swing("m")
    assert run.end_memory.attrs["names"].startswith("y[9] now.t ")
    assert run.end_memory.values[:2].tolist() == [run.x.values[-1], run.v_x.values[-1]]


def test_only_what_a_run_has_is_in_its_record() -> None:
    """Assert that given steps, tolerances and samples are kept where there are any."""
    steps = [0.1, 0.2, 0.3, 0.4]
    run = swing("m", rtol=None, atol=None, step=steps, until=1.0)
    assert run.given_step_size.values.tolist() == steps
    assert "given_step_size" not in swing("m", rtol=None, atol=None, step=0.1, until=1.0)
    assert "atol" not in run.x.attrs
    assert {"sample_x", "sample_pull", "sample_force_drag_x"} <= set(run.variables)
    assert not {"sample_x", "sample_time"} & set(swing("m", force_samples="none").variables)


def test_variables_say_what_they_are() -> None:
    """Assert the words of each kind of variable, the model's own where it has some."""
    run = swing("m")
    expected = {
        "m": "parameter m",
        "x": "coordinate x",
        "v_x": "velocity of x",
        "a_x": "acceleration of x",
        "work": "state work",
        "rate_work": "rate of work",
        "force_drag_x": "component of force drag along x",
        "power": "observable power",
        "error_x": "estimated local error of x in the step to this state",
        "sample_x": "x used in the force evaluation",
        "sample_pull": "pull looked up in the force evaluation",
        "sample_force_drag_x": "force_drag_x given by the force evaluation",
        "total_energy": "kinetic and potential energy",
        "event_impulse_x": "contact impulse along x",
    }
    assert {name: run[name].attrs["long_name"] for name in expected} == expected
    roles = {
        "m": "parameter",
        "x": "coordinate",
        "v_x": "velocity",
        "a_x": "acceleration",
        "work": "state",
        "rate_work": "rate",
        "force_drag_x": "force",
        "power": "observable",
        "error_x": "error",
        "sample_x": "sample",
        "total_energy": "energy",
    }
    assert {name: run[name].attrs["role"] for name in roles} == roles
    told = xd.Model(
        name="told",
        coordinates={"x": {"unit": "m", "description": "way"}},
        mass={"x": "m"},
        parameters={
            "m": {"value": 2, "unit": "kg", "uncertainty": "5 g", "description": "load"},
            "k": {"value": 1, "unit": "s-1", "uncertainty": 0.5},
        },
        states={"q": {"unit": "C", "rate": "-k*q", "description": "charge"}},
        forces={"drag": {"x": "-m*k*v_x", "description": "air"}},
        observables={"inertia": "m*a_x"},
        initial={"x": "0 m", "v_x": "1 m s-1", "q": "1 C"},
    )
    run = xd.simulate(told, method="rk4", step=0.1, until=1.0)
    words = {"x": "way", "m": "load", "q": "charge", "force_drag_x": "component of force air along x"}
    assert {name: run[name].attrs["long_name"] for name in words} == words
    assert (run.m.attrs["uncertainty"], run.k.attrs["uncertainty"]) == (0.005, 0.5)
    assert run.inertia.attrs["units"] == "N"
    assert run.inertia.values == pytest.approx(run.force_drag_x.values)


def test_events_say_what_found_them() -> None:
    """Assert names, functions, directions, actions and tolerances of events, and units by event where they differ."""
    about = swing("m").event_detector.attrs
    assert (about["flag_meanings"], about["flag_values"].tolist()) == ("low fast", [0, 1])
    assert about["functions"] == "low: x; fast: v_x - 0.2*metre/second"
    assert about["directions"] == "low: falling; fast: either"
    assert about["actions"] == "low: record; fast: record"
    assert about["time_tolerances"] == "low: 1.0 ms; fast: 1.0 ms"
    residual = swing("m").event_residual.attrs
    assert (residual["units"], residual["comment"]) == ("1", "SI unit by event: low m, fast m s-1")


def test_a_model_without_events_or_with_one_unit() -> None:
    """Assert that without an event the flag has one word, and that one unit is said as one."""
    past = {"function": "x - 2*metre", "direction": "rising", "time_tolerance": "1 ms"}
    none, one = (
        xd.simulate(particle(events=events), method="rk4", step=0.1, until=1.0) for events in ({}, {"past": past})
    )
    about = none.event_detector.attrs
    assert (about["flag_meanings"], about["flag_values"].tolist()) == ("none", [0])
    assert "functions" not in about
    assert (none.event_residual.attrs["units"], one.event_residual.attrs["units"]) == ("1", "m")
    assert "comment" not in one.event_residual.attrs


def test_a_norm_is_kept_where_it_judged() -> None:
    """Assert that a method that estimates its errors keeps them, and their norm with tolerances alone."""
    judged, fixed = swing("m"), swing("m", rtol=None, atol=None, step=0.1)
    plain = swing("m", rtol=None, atol=None, step=0.1, method="rk4")
    for run, there in ((judged, {"error_x", "error_norm"}), (fixed, {"error_x"}), (plain, set())):
        assert {"error_x", "error_norm"} & set(run.variables) == there
    iterated = swing("m", rtol=None, atol=None, step=0.1, method="implicit_midpoint").newton_iterations
    assert iterated.dtype == np.int32
    assert (iterated.values[1:] > 0).any()
    assert "newton_iterations" not in plain


def test_uncertainty_of_an_event_is_the_sum_of_its_parts() -> None:
    """Assert each part, and that half a spacing of t is the least."""
    run = swing("m")
    bracket, residual, interpolation = (
        run[f"event_time_uncertainty_{name}"].values for name in ("bracket", "residual", "interpolation")
    )
    assert bracket == pytest.approx(np.diff(run.event_time_bounds.values, axis=1)[:, 0])
    rows = run.event_row_before.values
    slopes = np.where(run.event_detector.values == 0, run.v_x.values[rows], run.a_x.values[rows])
    assert residual == pytest.approx(np.abs(run.event_residual.values / slopes))
    assert not interpolation.any()
    assert run.event_time_uncertainty.values == pytest.approx(bracket + residual)


def test_an_event_is_located_no_nearer_than_half_a_spacing_of_time() -> None:
    """Assert the least uncertainty where nothing else is unsure, and an infinite one where the function does not move."""
    past = {"function": "x - 3*metre", "direction": "rising", "time_tolerance": "1 ms"}
    model = particle(events={"past": past})
    march = March(model, settings_for(model, method="rk4", step=0.5, until=1.0))
    (block,) = march.blocks()
    take = {column.variable.name: column.take for column in columns(march)}["event_time_uncertainty"]
    event = block.log.events[:1]
    event["left"], event["residual"], event["slope"] = event["time"], 0.0, 0.0
    assert take(block).tolist() == [np.spacing(event["time"][0]) / 2]
    event["residual"] = 1e-9
    assert take(block).tolist() == [np.inf]


def test_rejected_trials_name_where_they_began() -> None:
    """Assert that row, time, size, norm and reason of a trial belong together."""
    run = swing("m", scales={"time": "7 s"}, step=0.5)
    rows = run.trial_step.values
    assert rows[0] == 0 < rows[-1]
    assert (run.trial_time.values == run.time.values[rows]).all()
    assert (run.trial_step_size.values[0], run.trial_error_norm.dims) == (pytest.approx(0.5), ("trial",))
    assert (run.trial_error_norm.values[run.trial_reason.values == 0] > 1).all()


def test_factors_lead_from_the_numbers_of_a_march_to_those_of_its_record() -> None:
    """Assert that scales are in them, and the units that the model declares."""
    scales = Scales.parse({"length": "3 m", "time": "0.5 s"})
    layout = settings_for(linear_drag().model, method="rk4", step=0.1, until=1.0).layout(linear_drag().model)
    assert [*layout.used] == ["y", "v_y"]
    assert factors(layout, scales) == pytest.approx([3000.0, 6000.0])


CHAIN = """
name = "chain"
[dimensions]
site = 5
[relations.spring]
of = "site"
neighbours = 1
[coordinates]
u = { unit = "m", dims = ["site"] }
[mass]
u = "kilogram"
[forces.springs]
over = "spring"
potential = "kilogram/second**2*(second(u, spring) - first(u, spring))**2/2"
[initial]
u = "metre*sin(index(site))"
"""


def test_wide_columns_have_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that one row a block, in one log, and an extension behind it, give the record of many rows a block."""
    model = xd.Model.from_text(CHAIN)

    def runs() -> list[xr.Dataset]:
        half = xd.simulate(model, method="velocity_verlet", step="0.1 s", until="1 s", log="states")
        return [half, xd.extend(half, until="2 s")]

    usual = runs()
    monkeypatch.setattr("xdynamics.record.run_dataset.WIDE", 1)
    monkeypatch.setattr("xdynamics.march.runner.RECYCLED_NUMBERS", 1)
    for run, other in zip(usual, runs(), strict=True):
        assert run.sizes["step"] in (11, 21)
        for name, values in run.variables.items():
            np.testing.assert_array_equal(values.values, other[name].values, strict=True)


def test_elements_are_not_named_where_no_name_is_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that reading and marching makes no names of single elements: of 10^6 these take 150 MB each time."""
    named: list[str] = []
    elements = Block.elements
    monkeypatch.setattr(Block, "elements", lambda block: named.append(block.name) or elements(block))
    xd.simulate(xd.Model.from_text(CHAIN), method="velocity_verlet", step="0.1 s", until="0.2 s", log="states")
    assert named == []


MODEL = """
name = "three bodies"
[dimensions]
b = ["first_one", "other", "last"]
axis = ["x", "y"]
[coordinates]
r = { unit = "m", dims = ["b", "axis"] }
[parameters]
m = { dims = ["b"], values = { first_one = "1 g", other = "0.10000000000000000123456 g", last = "3 g" }, description = "masses" }
w = { dims = ["b", "axis"], value = "(1 + 0.1*index(b) + index(axis))*gram" }
u = { dims = ["b"], value = [1, 2, 3], unit = "km", uncertainty = "1 m" }
k = "0.1 N m-1"
[mass]
r = "m + w"
[forces.spring]
r = "-k*r"
[initial]
r = "metre*(1 + index(b))"
v_r = "0*metre/second"
"""


def test_parameters_whole_are_those_of_their_elements(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that variables and values are the same, to the bit, without the short way."""
    found = []
    for _ in range(2):
        model = xd.Model.from_text(MODEL)
        entries = folded_columns.parameter_variables(model)
        values = [(variable, variable.attributes, getattr(value, "tolist", float)()) for variable, value in entries]
        found.append(values)
        monkeypatch.setattr(folded_columns, "parameter_numbers", lambda *_: None)
    assert found[0] == found[1]
    assert [variable.dims for variable, *_ in found[0]] == [(), ("b",), ("b", "axis"), ("b",)]


def test_elements_keep_the_digits_beyond_a_float() -> None:
    """Assert that a parameter by label is as exact as one by itself."""
    model = xd.Model.from_text(MODEL)
    single = xd.Model.from_text(MODEL.replace('k = "0.1 N', 'k = "0.10000000000000000123456 N'))
    by_label, alone = model.parameters["m·other"].quantity.value, single.parameters["k"].quantity.value
    assert isinstance(by_label, Rounded)
    assert isinstance(alone, Rounded)
    assert by_label.exact == alone.exact


def test_an_uncertainty_says_which_one_it_is() -> None:
    """Assert the standard uncertainty of each distribution, its unit, and the width between bounds where that is stated."""
    model = xd.Model.from_text(
        """
        name = "Spring"
        coordinates.x = "m"
        mass.x = "m"
        forces.spring.x = "-k*x"
        forces.pull.x = "a*c"
        initial = { x = "1 m", v_x = "0 m s-1" }
        [parameters]
        m = "0.5 ± 0.005 kg"
        k = { value = "3 N m-1", half_width = "30 N km-1" }
        a = { value = "2 N", uncertainty = 0.1, distribution = "t", degrees_of_freedom = 9 }
        c = 1.0
        """
    )
    run = xd.simulate(model, method="rk4", step="10 ms", until="0.1 s")
    said = {
        name: {word: value for word, value in run[name].attrs.items() if word.startswith("uncertainty")}
        for name in "mkac"
    }
    assert said["m"] == {
        "uncertainty": 0.005,
        "uncertainty_kind": "standard",
        "uncertainty_units": "kg",
        "uncertainty_distribution": "normal",
    }
    assert said["k"] == {
        "uncertainty": pytest.approx(0.03 / 3**0.5, rel=1e-15),
        "uncertainty_kind": "standard",
        "uncertainty_units": "N m-1",
        "uncertainty_distribution": "rectangular",
        "uncertainty_half_width": pytest.approx(0.03, rel=1e-15),
    }
    assert said["a"]["uncertainty_distribution"] == "t"
    assert said["a"]["uncertainty_degrees_of_freedom"] == 9.0
    assert said["c"] == {}


DIMS = {"r": ("body", "axis"), "m": ("body",), "u": ("site",), "distance": ("pair",), "height": ("body",)}
SHAPES = Shapes(
    {
        "body": Extent("body", 3, ("Sun", "Jupiter", "Saturn_V")),
        "axis": Extent("axis", 2, ("x", "y")),
        "site": Extent("site", 4),
    },
    {"pair": Relation("pair", "body", "body", np.array([0, 0, 1]), np.array([1, 2, 2]))},
    {**DIMS, "v_r": DIMS["r"], "ground": ("body",), "bell": ()},
)
STEPS, EVENTS = 5, 2


def variable(dims, name, role="coordinate", **more):
    """A variable of random numbers, drawn from its name."""
    shape = [{"step": STEPS, "event": EVENTS}[dim] for dim in dims]
    values = np.random.default_rng(list(name.encode())).normal(size=shape)
    return xr.Variable(dims, values, {"units": "m", "long_name": f"{role} {name}", "role": role, **more})


def elements():
    """A Dataset whose variables are elements."""
    along = {
        f"{word}{name}": ("step",) for name in SHAPES.elements("r") for word in ("", "v_", "error_", "force_gravity_")
    }
    along |= dict.fromkeys((*SHAPES.elements("u"), *SHAPES.elements("distance")), ("step",))
    along |= {f"event_{name}{tail}": ("event",) for name in SHAPES.elements("height") for tail in ("", "_uncertainty")}
    along |= dict.fromkeys(SHAPES.elements("m"), ())
    variables = {name: variable(dims, name) for name, dims in along.items()}
    return xr.Dataset(variables | {"time": variable(("step",), "time")}, attrs={"title": "all"}).set_coords("time")


def test_names_become_dimensions():
    """Assert that elements are one variable, its dimensions after those of the elements, in the model's order."""
    folded = fold(elements(), SHAPES)
    dims = {str(name): one.dims for name, one in folded.data_vars.items()}
    assert dims == {
        "r": ("step", "body", "axis"),
        "v_r": ("step", "body", "axis"),
        "error_r": ("step", "body", "axis"),
        "force_gravity_r": ("step", "body", "axis"),
        "u": ("step", "site"),
        "distance": ("step", "pair"),
        "event_height": ("event", "body"),
        "event_height_uncertainty": ("event", "body"),
        "m": ("body",),
    }
    assert folded.attrs["model_dimensions"] == "pair(3) body(3) axis(2) site(4)"
    assert model_dimensions(folded) == {"pair": 3, "body": 3, "axis": 2, "site": 4}


def test_folding_keeps_every_value():
    """Assert that every element is in its place, bit for bit."""
    whole, folded = elements(), labelled(fold(elements(), SHAPES))
    for body in ("Sun", "Jupiter", "Saturn_V"):
        for axis in "xy":
            assert np.array_equal(folded.v_r.sel(body=body, axis=axis), whole[f"v_r·{body}·{axis}"])
    assert np.array_equal(folded.u[:, 2], whole["u·2"])


def test_unfolding_is_the_inverse():
    """Assert that a folded Dataset gives back its elements, with what is said of each."""
    whole = elements()
    back = unfold(labelled(fold(whole, SHAPES)))
    assert set(back.variables) == set(whole.variables)
    assert set(back.coords) == {"time"}
    for name, one in whole.variables.items():
        assert np.array_equal(back[name].values, one.values)
        assert back[name].dims == one.dims
        assert back[name].attrs["units"] == "m"


def test_elements_are_views():
    """Assert that nothing is copied where elements are taken, and that the Dataset that they are of is known."""
    folded = fold(elements(), SHAPES)
    back = unfold(folded)
    assert np.shares_memory(back["r·Jupiter·y"].data, folded.r.data)
    assert as_recorded(back) is folded


def test_what_has_no_elements_stays_as_it_is():
    """Assert that a Dataset without dimensions of a model is handed through."""
    plain = xr.Dataset({"y": variable(("step",), "y")})
    assert fold(plain, SHAPES) is plain
    assert unfold(plain) is plain
    assert labelled(plain) is plain


@pytest.mark.parametrize(
    ("name", "missing"), [("force_pull_r", 0.0), ("sample_force_pull_r", 0.0), ("error_r", np.nan)]
)
def test_elements_that_are_not_there(name, missing):
    """Assert that a force is zero where it does not act, and that all else is not known."""
    one = xr.Dataset({f"{name}·Jupiter·x": variable(("step",), "f")})
    folded = labelled(fold(one, SHAPES))[name]
    assert np.array_equal(folded.sel(body="Jupiter", axis="x"), one[f"{name}·Jupiter·x"])
    assert np.array_equal(folded.sel(body="Sun"), np.full((STEPS, 2), missing), equal_nan=True)


def test_elements_that_were_left_out_stay_so():
    """Assert that what a log left out is not taken for a value."""
    kept = xr.Dataset({f"r·{name}·x": variable(("step",), name) for name in ("Sun", "Saturn_V")})
    folded = fold(kept, SHAPES)
    assert folded.r.attrs["elements"] == "r[Sun,x] r[Saturn_V,x]"
    assert set(unfold(folded).data_vars) == set(kept.data_vars)


def test_attributes_of_elements():
    """Assert that what differs between elements is kept for each of them, and what does not once."""
    starts = {"u·0": {"atol": 1.0}, "u·1": {"atol": 2.0}, "u·2": {}, "u·3": {"atol": 3.0, "atol_rule": "follows"}}
    whole = xr.Dataset({name: variable(("step",), name, smooth=1, **own) for name, own in starts.items()})
    folded = fold(whole, SHAPES)
    assert folded.u.attrs["long_name"] == "coordinate u"
    assert folded.u.attrs["smooth"] == 1
    assert np.array_equal(folded.u.attrs["atol"], [1.0, 2.0, np.nan, 3.0], equal_nan=True)
    back = unfold(folded)
    assert [back[name].attrs.get("atol") for name in starts] == [1.0, 2.0, None, 3.0]
    assert ["atol_rule" in back[name].attrs for name in starts] == [False, False, False, True]


def test_one_tolerance_for_all_is_one_number():
    """Assert that equal numbers are not listed."""
    folded = fold(xr.Dataset({f"u·{i}": variable(("step",), "u", atol=0.5) for i in range(4)}), SHAPES)
    assert folded.u.attrs["atol"] == 0.5


def test_labels_are_an_index_in_memory_and_text_in_a_file():
    """Assert that labels go from one form to the other and back."""
    folded = fold(elements(), SHAPES)
    there = labelled(folded)
    assert there.indexes["body"].tolist() == ["Sun", "Jupiter", "Saturn_V"]
    assert "body_label" not in there
    assert "site" not in there.variables
    assert unlabelled(there).identical(folded)
    assert folded.body_label.attrs["role"] == "label"


def test_ends_of_a_relation():
    """Assert that a relation says which elements it links, by number and by label."""
    folded = fold(elements(), SHAPES)
    assert (folded.pair_first.values.tolist(), folded.pair_second.values.tolist()) == ([0, 0, 1], [1, 2, 2])
    assert folded.pair_first.attrs["flag_meanings"] == "Sun Jupiter Saturn_V"


def test_dask_stays_dask():
    """Assert that lazy elements are folded and unfolded without being computed."""
    lazy = fold(elements().chunk(step=2), SHAPES)
    assert lazy.r.chunks == ((2, 2, 1), (3,), (2,))
    assert unfold(lazy)["r·Sun·y"].chunks == ((2, 2, 1),)
    assert lazy.compute().identical(fold(elements(), SHAPES))


def test_dimensions_before_those_of_elements():
    """Assert that a variable gives the same elements wherever its own dimensions stand."""
    folded = fold(elements(), SHAPES)
    back = unfold(folded.transpose("body", "step", ...))
    assert np.array_equal(back["r·Jupiter·y"], folded.r.values[:, 1, 1])


def test_a_stored_variable_is_read_once_for_all_elements(tmp_path):
    """Assert that elements of a file are read together, and rows of them too."""
    path = tmp_path / "folded.nc"
    fold(elements(), SHAPES)[["r", "u"]].to_netcdf(path)
    whole = elements()
    with xr.open_dataset(path) as stored:
        back = unfold(stored)
        assert "numpy" not in type(back["u·1"].variable._data).__module__
        shared = back["u·1"].variable._data.array.shared
        for i in range(4):
            assert np.array_equal(back[f"u·{i}"][np.array([0, 3])], whole[f"u·{i}"][[0, 3]])
            assert np.array_equal(back[f"u·{i}"][1:3], whole[f"u·{i}"][1:3])
        assert len(shared._read) == 2
        assert np.array_equal(back["r·Saturn_V·x"], whole["r·Saturn_V·x"])


def test_events_of_elements():
    """Assert that the detector of an event names the element, and nothing where it has none."""
    words = {"flag_values": np.array([0, 1], np.int8), "flag_meanings": "ground bell", "role": "flag"}
    about = {"units": "1", "long_name": "which", "role": "flag"}
    folded = xr.Dataset(
        {
            "event_detector": ("event", np.array([0, 1, 0], np.int8), words | {"detector_dimensions": "ground: body"}),
            "event_body": ("event", np.array([2, -1, 0], np.int8), about),
            "m": ("body", np.ones(3)),
        },
        attrs={"model_dimensions": "body(3)"},
    )
    detector = unfold(folded)["event_detector"]
    assert detector.attrs["flag_meanings"] == "ground·0 ground·1 ground·2 bell"
    assert detector.values.tolist() == [2, 3, 0]


@pytest.mark.parametrize("name", ["r·Moon·x", "r·Sun", "q·Sun", "u·4", "r·Sun·x·y"])
def test_names_that_are_no_elements(name):
    """Assert that a name with a dot that is none of the model's elements is left alone."""
    one = xr.Dataset({name: variable(("step",), "f")})
    assert fold(one, SHAPES) is one

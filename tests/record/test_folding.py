"""Quantities with dimensions: one variable each in a record, one for each element to who computes with them."""

import numpy as np
import pytest
import xarray as xr

from xdynamics.record.folding import fold, labelled, model_dimensions, unlabelled
from xdynamics.record.unfolding import as_recorded, unfold
from xdynamics.shapes import Extent, Relation, Shapes

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

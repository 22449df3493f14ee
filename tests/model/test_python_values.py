"""Values for elements from Python: arrays of numpy and xarray, tables of pandas, in any order of labels and dimensions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import xdynamics as xd

PLACES = np.arange(6.0).reshape(3, 2)
BODIES = ["a", "b", "c"]


def bodies(mass: Any, start: Any, **others: Any) -> xd.Model:
    """Three free bodies in a plane."""
    return xd.Model(
        name="bodies",
        dimensions={"body": BODIES, "axis": ["x", "y"]},
        coordinates={"r": {"unit": "m", "dims": ["body", "axis"]}},
        parameters={"m": mass} | others,
        mass={"r": "m"},
        initial={"r": start},
    )


def labelled(values: Any, units: str, **coords: Any) -> xr.DataArray:
    """An array with labels along its dimensions, in their order."""
    return xr.DataArray(values, dims=[*coords], coords=coords, attrs={"units": units})


LISTED = bodies({"dims": ["body"], "value": [1.0, 2.0, 3.0], "unit": "kg"}, {"value": PLACES.tolist(), "unit": "m"})


@pytest.mark.parametrize(
    ("mass", "start"),
    [
        ({"dims": ["body"], "value": np.array([1, 2, 3]), "unit": "kg"}, {"value": PLACES, "unit": "m"}),
        (
            labelled([1.0, 2.0, 3.0], "kg", body=BODIES),
            xr.DataArray(PLACES, dims=("body", "axis"), attrs={"units": "m"}),
        ),
        (labelled([3, 1, 2], "kg", body=["c", "a", "b"]), labelled(PLACES.T, "m", axis=["x", "y"], body=BODIES)),
        (
            {"dims": ["body"], "value": labelled([2.0, 1.0, 3.0], "kg", body=["b", "a", "c"])},
            {"value": labelled(PLACES[:, ::-1], "m", body=BODIES, axis=["y", "x"])},
        ),
        (
            {"dims": ["body"], "table": pd.DataFrame({"body": ["c", "a", "b"], "m [kg]": [3.0, 1.0, 2.0]})},
            {"table": pd.DataFrame(PLACES, columns=["x [m]", "y [m]"]), "columns": ["x", "y"]},
        ),
        (
            {"dims": ["body"], "table": {"body": np.array(["b", "c", "a"]), "m [kg]": [2, 3, 1]}},
            {
                "table": pd.DataFrame(
                    PLACES[::-1], columns=["x [m]", "y [m]"], index=pd.Index(["c", "b", "a"], name="body")
                ),
                "columns": ["x", "y"],
            },
        ),
    ],
)
def test_arrays_say_what_lists_say(mass: Any, start: Any) -> None:
    """Assert that the model is that of lists, whatever the order of labels, dimensions and rows."""
    model = bodies(mass, start)
    assert model.statement.arrays["m"].numbers == (1.0, 2.0, 3.0)
    assert [model.initial[f"r·{body}·x"].value for body in BODIES] == [0.0, 2.0, 4.0]
    assert model == LISTED
    assert xd.Model.from_text(model.to_toml()) == LISTED


def test_a_run_goes_on_from_the_last_row_of_another() -> None:
    """Assert that what a record has at a row is a value at the start, and of a parameter by `replace`."""
    run = xd.simulate(LISTED, method="rk4", step="1 s", until="2 s")
    assert bodies({"dims": ["body"], "value": [1.0, 2.0, 3.0], "unit": "kg"}, run.r.isel(step=-1)) == LISTED
    turned = run.m.isel(body=[2, 0, 1])
    assert LISTED.replace(parameters={"m": turned}, initial={"r": run.r.isel(step=0).transpose()}) == LISTED


def test_uncertainties_are_arrays_too() -> None:
    """Assert that an uncertainty for each element, in a unit of its own, is that of a list."""
    listed = {"dims": ["body"], "value": [1.0, 2.0, 3.0], "unit": "kg"}
    spread = labelled([30.0, 10.0, 20.0], "g", body=["c", "a", "b"])
    by_array, by_list = (bodies(listed | {"uncertainty": sizes}, "0 m") for sizes in (spread, ["10 g", "20 g", "30 g"]))
    assert by_array == by_list
    assert bodies(listed | {"half_width": np.array([0.1, 0.2, 0.3])}, "0 m") == bodies(
        listed | {"half_width": [0.1, 0.2, 0.3]}, "0 m"
    )


@pytest.mark.parametrize(
    ("mass", "said"),
    [
        (xr.DataArray([1.0, 2.0, 3.0], dims="body"), "value is a DataArray without units; set its attribute 'units'"),
        (labelled([1.0, 2.0, 3.0], "kg", rock=BODIES), "'rock' is no dimension or relation; there are body, axis"),
        (
            {"dims": ["body"], "value": labelled([1.0, 2.0, 3.0], "kg", rock=BODIES)},
            "value is a DataArray along rock, needs body; rename or reduce it",
        ),
        (
            labelled([1.0, 2.0, 3.0], "kg", body=["a", "b", "z"]),
            "labels a, b, z along 'body', needs each of a, b, c exactly once; 'c' is not",
        ),
        (
            labelled([1.0, 2.0, 3.0], "kg", body=["a", "b", "b"]),
            "labels a, b, b along 'body', needs each of a, b, c exactly once; 'b' is not",
        ),
        (labelled(np.ones(4), "kg", body=[*BODIES, "d"]), "value has the label 'd' along 'body', which has a, b, c"),
        (labelled(np.ones(3), "stone", body=BODIES), "unit 'stone' is not known"),
        (
            {"dims": ["body"], "value": labelled(np.ones(3), "g", body=BODIES), "unit": "kg"},
            "unit is 'kg', and the DataArray has units 'g'; leave one out",
        ),
        (
            {"dims": ["body"], "value": np.array([1j, 2, 3]), "unit": "kg"},
            "numbers of the kind complex128, needs real ones",
        ),
        ({"dims": ["body"], "value": np.array([1, np.nan, 3]), "unit": "kg"}, "quantity nan is not finite"),
        ({"dims": ["body"], "value": np.ones((3, 2)), "unit": "kg"}, "value has more dimensions than body"),
        ({"dims": ["body"], "value": np.array([1, True, 3], object), "unit": "kg"}, "value has True, needs numbers"),
        (
            {"dims": ["body"], "table": 7},
            "table is a int, needs the name of a CSV file, a DataFrame, or columns by name",
        ),
    ],
)
def test_arrays_that_do_not_fit_are_named(mass: Any, said: str) -> None:
    """Assert that dimensions, labels, units and kinds that do not fit are refused in one line."""
    with pytest.raises(xd.ModelError, match=f"parameter 'm': .*{said}") as refusal:
        bodies(mass, "0 m")
    assert "\n" not in str(refusal.value)
